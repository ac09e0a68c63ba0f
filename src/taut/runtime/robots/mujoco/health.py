"""What goes wrong inside MuJoCo: noticed at once, said in words, and nothing written beside the run.

Left to itself MuJoCo writes MUJOCO_LOG.TXT into the working folder, sets every motor to zero when one command is not
finite, and puts a diverged simulation back to its start.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from taut.base.types import Float64Array
from taut.runtime.robots.mujoco.rig import Rig

if TYPE_CHECKING:
    import mujoco

__all__ = ["Guard", "Health"]

HUGE: Final = 1e10  # what MuJoCo itself calls huge, in qpos, qvel, qacc and ctrl
WAY_OUT: Final = "try smaller gains, a higher rate or a smaller timestep"
SAID: Final = {
    "mjWARN_INERTIA": "the mass matrix is singular; a body has no inertia",
    "mjWARN_CONTACTFULL": "MuJoCo has no room for more contacts; simplify the scene",
    "mjWARN_CNSTRFULL": "MuJoCo has no room for more constraints; simplify the scene",
    "mjWARN_BADQPOS": f"a position is not finite; {WAY_OUT}",
    "mjWARN_BADQVEL": f"a velocity is not finite; {WAY_OUT}",
    "mjWARN_BADQACC": f"an acceleration is not finite; {WAY_OUT}",
    "mjWARN_BADCTRL": f"a command is beyond {HUGE:g} or not finite, and MuJoCo set every motor to zero; {WAY_OUT}",
}


def _nothing(_: str) -> None:
    """Takes the place of MuJoCo's writing to stderr and to a file."""


class Guard:
    """While it is held MuJoCo writes no warnings out, and never puts a diverged simulation back to its start.

    A listener that somebody else has set for the warnings stays.

    Args:
        option: The options of the model.
    """

    def __init__(self, option: mujoco.MjOption) -> None:
        import mujoco

        self._option = option
        self._autoreset = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self._listener, self._listen = mujoco.get_mju_user_warning, mujoco.set_mju_user_warning

    def __enter__(self) -> None:
        self._flags = self._option.disableflags
        self._option.disableflags = self._flags | self._autoreset
        self._mine = self._listener() is None
        if self._mine:
            self._listen(_nothing)

    def __exit__(self, *_: object) -> None:
        self._option.disableflags = self._flags
        if self._mine:
            self._listen(None)


class Health:
    """Watches one simulation.

    Args:
        rig: The arm in the simulation.
    """

    def __init__(self, rig: Rig) -> None:
        import mujoco

        self._rig = rig
        self._joint_of = {dof: i for i, dof in enumerate(rig.dofs)}
        data = rig.data
        self._acceleration: Float64Array = data.qacc  # views: MuJoCo writes into them
        self._velocity: Float64Array = data.qvel
        self._counts: np.ndarray[tuple[int], np.dtype[np.int32]] = data.warning.number
        self._kinds = [mujoco.mjtWarning(i).name for i in range(len(self._counts))]
        self.start()

    def start(self) -> None:
        """Forget what was before."""
        self._before = self._counts.copy()
        self._seen = self._before.tobytes()

    def trouble(self) -> tuple[str, int | None] | None:
        """What went wrong in the last step, and the joint of the arm; None if nothing did."""
        # MuJoCo looks for NaN and for what is huge in every step, and counts what it finds.
        return None if self._counts.tobytes() == self._seen else self._in_words()

    def _in_words(self) -> tuple[str, int | None]:
        for values, what, per in ((self._acceleration, "acceleration", "s^2"), (self._velocity, "velocity", "s")):
            size = np.where(np.isfinite(values), np.abs(values), np.inf)
            dof = int(np.argmax(size))
            if size[dof] >= HUGE:
                joint = self._joint_of.get(dof)
                of = self._owner(dof) if joint is None else "its"
                unit = "" if joint is None else f" {self._rig.arm.units[joint]}/{per}"
                reached = f"reached {values[dof]:.3g}{unit}" if np.isfinite(values[dof]) else "is no longer finite"
                return f"{of} {what} {reached}; {WAY_OUT}", joint
        new = [kind for kind, n, before in zip(self._kinds, self._counts, self._before, strict=True) if n > before]
        if not new:
            return "somebody put MuJoCo's data back to its start while the run was going on", None
        joint = self._commanded() if "mjWARN_BADCTRL" in new else None
        return "; ".join(SAID.get(kind, kind) for kind in new), joint

    def _owner(self, dof: int) -> str:
        model = self._rig.model
        name = model.joint(int(model.dof_jntid[dof])).name or model.body(int(model.dof_bodyid[dof])).name
        return f"'{name}' is not of the arm, and its" if name else "a body of the scene went wrong: its"

    def _commanded(self) -> int | None:
        """The joint of the arm whose motor had the command that MuJoCo did not take."""
        import mujoco

        model, warning = self._rig.model, self._rig.data.warning[mujoco.mjtWarning.mjWARN_BADCTRL]
        actuator = int(np.flatnonzero(model.actuator_ctrladr <= warning.lastinfo)[-1])
        driven = int(model.actuator_trnid[actuator, 0])
        return self._rig.joints.index(driven) if driven in self._rig.joints else None
