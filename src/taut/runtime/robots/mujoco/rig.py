"""An arm inside a MuJoCo model: its numbers, what touches it, and what goes wrong.

Left to itself MuJoCo writes MUJOCO_LOG.TXT into the working folder, sets every motor to zero when one command is not
finite, and puts a diverged simulation back to its start.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from taut.arm.description import Arm
from taut.base.errors import MatchError
from taut.base.types import Float64Array
from taut.maths.model import Adds
from taut.record.info import POSES, Around
from taut.runtime.host import PlantBase

if TYPE_CHECKING:
    import mujoco

    from taut.runtime.robots.mujoco.scene import SceneView

PRESSED: Final = "contact.normal_force"  # column of a run
WAY_OUT: Final = "Try smaller gains, a higher rate or a smaller timestep"
NOTHING = np.zeros(6)
NOTHING.flags.writeable = False

Index: TypeAlias = slice | NDArray[np.intp]
"""Positions in one of MuJoCo's arrays; a slice where they follow one another, since that is faster."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """An arm in a simulation: ours or the user's."""

    arm: Arm
    model: mujoco.MjModel
    data: mujoco.MjData
    joints: tuple[int, ...]  # (n,) ids, in the arm's order
    tool_bodies: Index  # the bodies that what touches the tool pushes on
    tool_body: int  # the body whose frame p_tool is given in
    p_tool: Float64Array  # (3,) [m] origin of the tool
    adds: Adds

    @cached_property
    def q(self) -> Index:
        """(n,) where the arm's positions are in qpos."""
        return index([int(self.model.jnt_qposadr[j]) for j in self.joints])

    @cached_property
    def v(self) -> Index:
        """(n,) where its velocities are in qvel, qacc and qfrc_*."""
        return index(list(self.dofs))

    @cached_property
    def dofs(self) -> tuple[int, ...]:
        """(n,) the same as numbers."""
        return tuple(int(self.model.jnt_dofadr[j]) for j in self.joints)


def index(numbers: list[int]) -> Index:
    """Positions as a slice where they allow it."""
    first = numbers[0]
    if numbers == list(range(first, first + len(numbers))):
        return slice(first, first + len(numbers))
    return np.array(numbers, dtype=np.intp)


def _nothing(_: str) -> None:
    """Takes the place of MuJoCo's writing to stderr and to a file."""


class Guard:
    """Context in which MuJoCo writes no warnings, save to a listener of the user, and never resets a simulation."""

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
    """Watches one simulation."""

    def __init__(self, rig: Rig) -> None:
        import mujoco

        model, kinds = rig.model, mujoco.mjtWarning
        self._text, self._warnings = mujoco.mju_warningText, rig.data.warning
        self._counts: np.ndarray[tuple[int], np.dtype[np.int32]] = rig.data.warning.number  # a view
        dofs = {dof: i for i, dof in enumerate(rig.dofs)}
        controls = {
            int(model.actuator_ctrladr[a]): rig.joints.index(int(model.actuator_trnid[a, 0]))
            for a in range(model.nactuator)
            if int(model.actuator_trnid[a, 0]) in rig.joints
        }
        self._joint_of: dict[int, dict[int, int]] = {
            int(kinds.mjWARN_BADQPOS): {int(model.jnt_qposadr[j]): i for i, j in enumerate(rig.joints)},
            int(kinds.mjWARN_BADQVEL): dofs,
            int(kinds.mjWARN_BADQACC): dofs,
            int(kinds.mjWARN_BADCTRL): controls,
        }  # by the number that MuJoCo gives with the warning
        self.start()

    def start(self) -> None:
        """Forget what was before."""
        self._before = self._counts.copy()
        self._seen = self._before.tobytes()

    def trouble(self) -> tuple[str, int | None] | None:
        """Fault in the last step, in words, and the joint of the arm; None without one."""
        # MuJoCo looks for NaN and for what is huge in every step, and counts what it finds.
        if self._counts.tobytes() == self._seen:
            return None
        new = {int(kind): int(self._warnings[kind].lastinfo) for kind in np.flatnonzero(self._counts > self._before)}
        if not new:
            return "somebody put MuJoCo's data back to its start while the run was going on", None
        joints = [self._joint_of.get(kind, {}).get(number) for kind, number in new.items()]
        words = " ".join(self._text(kind, number).strip() for kind, number in new.items())
        return f"{words} {WAY_OUT}", next((joint for joint in joints if joint is not None), None)


class Wrench:
    """The wrench of everything outside the arm on the body that carries the tool.

    MuJoCo adds up contacts, equality constraints and xfrc_applied for each body, torque first, about the centre of
    mass of the whole tree. Weight and inertia are no part of it, as they are of what its force sensors give.
    """

    def __init__(self, rig: Rig) -> None:
        import mujoco

        self._rig, self._post = rig, mujoco.mj_rnePostConstraint
        data, body = rig.data, rig.tool_body
        self._forces: Float64Array = data.cfrc_ext
        self._nothing = np.zeros((len(self._forces[rig.tool_bodies]), 6)).tobytes()
        self._centre: Float64Array = data.subtree_com[rig.model.body_rootid[body]]
        self._p: Float64Array = data.xpos[body]
        self._R: Float64Array = data.xmat[body].reshape(3, 3)

    def of_environment(self) -> Float64Array:
        """(6,) F_ext of the last step, force first, in world axes at the tool's origin; read-only."""
        if not self._rig.data.flg_rnepost:  # no sensor of the model asked for it
            self._post(self._rig.model, self._rig.data)
        rows = self._forces[self._rig.tool_bodies]
        if rows.tobytes() == self._nothing:
            return NOTHING
        torque, force = np.split(rows.sum(axis=0), 2)
        arm = self._centre - self._p - self._R @ self._rig.p_tool  # from the tool's origin to that centre
        F_ext: Float64Array = np.concatenate([force, torque + np.cross(arm, force)])
        return F_ext


class Normals:
    """The normal forces, without friction, of the contacts on the tool's body and on all that a weld ties to it."""

    def __init__(self, rig: Rig) -> None:
        import mujoco

        self._model, self._data, self._force_of = rig.model, rig.data, mujoco.mj_contactForce
        bodies = set(np.arange(rig.model.nbody)[rig.tool_bodies].tolist())
        bodies |= _welded(rig.model, bodies)
        self._ours: set[int] = {g for g in range(rig.model.ngeom) if int(rig.model.geom_bodyid[g]) in bodies}
        self._six = np.zeros(6)

    def of_contacts(self) -> Float64Array:
        """(3,) that force of the last step, world axes."""
        out, contacts = np.zeros(3), self._data.contact
        for i in range(self._data.ncon):
            first, second = contacts.geom[i]
            sign = (int(second) in self._ours) - (int(first) in self._ours)  # normals point from first to second
            if sign:
                self._force_of(self._model, self._data, i, self._six)
                out += sign * self._six[0] * contacts.frame[i, :3]
        return out


def _welded(model: mujoco.MjModel, bodies: set[int]) -> set[int]:
    """Bodies that welds of a scene tie to some, and those that they carry."""
    import mujoco

    pairs = [
        {int(model.eq_obj1id[i]), int(model.eq_obj2id[i])}
        for i in range(model.neq)
        if int(model.eq_type[i]) == mujoco.mjtEq.mjEQ_WELD and int(model.eq_objtype[i]) == mujoco.mjtObj.mjOBJ_BODY
    ]
    out = {body for pair in pairs if pair & bodies for body in pair - bodies if body}
    for body in range(1, model.nbody):  # parents come first
        if int(model.body_parentid[body]) in out:
            out.add(body)
    return out


class PlantInMujoco(PlantBase):
    """An arm in a simulation by MuJoCo, ours or the user's."""

    def __init__(self, rig: Rig, name: str, view: SceneView | None) -> None:
        import mujoco

        super().__init__(rig.arm)
        self.adds = rig.adds
        self._rig, self._name, self._view = rig, name, view
        self._qpos, self._qvel = rig.data.qpos, rig.data.qvel  # views, looked up once
        self._health, self._guard, self._wrench = Health(rig), Guard(rig.model.opt), Wrench(rig)
        self._mj_step = mujoco.mj_step
        self._substeps = 1
        self._silence()

    def _silence(self) -> None:
        """Set all forces to zero, as before the first step."""
        n = self.arm.n
        self._tau, self._cut, self._F_ext, self._told = np.zeros(n), np.zeros(n), np.zeros(6), False

    @property
    def name(self) -> str:
        """Name of the plant in messages."""
        return self._name

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model."""
        return self._rig.model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's state, and what it computed last."""
        return self._rig.data

    def state(self) -> tuple[Float64Array, Float64Array]:
        """(n,) the true position and velocity."""
        return self._qpos[self._rig.q].copy(), self._qvel[self._rig.v].copy()

    def _put_state(self, q: Float64Array, v: Float64Array) -> None:
        self._qpos[self._rig.q], self._qvel[self._rig.v] = q, v
        self._health.start()
        self._silence()

    def trouble(self) -> tuple[str, int | None] | None:
        """Fault in the last period, in words, and the joint; None without one."""
        return self._health.trouble()

    def _poses(self) -> dict[str, Float64Array]:
        """The column of the bodies of the scene that move, if there are some."""
        return {} if self._view is None or not self._view.moves else {POSES: self._view.poses(self._rig.data)}

    def around(self) -> Around:
        """Objects around the arm, for films."""
        return Around() if self._view is None else self._view.around

    def _warn_of_cut(self, limits: str, instead: str) -> None:
        """Warn, once in a run, that joints do not get all the torque that was asked for."""
        if self._told or not self._cut.any():
            return
        self._told = True
        i = int(np.argmax(np.abs(self._cut)))
        warnings.warn(
            f"{self.name}: joint '{self.arm.joint_names[i]}' got {self._tau[i]:.4g} of the "
            f"{self._tau[i] + self._cut[i]:.4g} {self.arm.joints[i].effort_unit} asked for, because of {limits}; the "
            f"run's column tau_cut has what was cut off; give {instead}",
            RuntimeWarning,
            stacklevel=3,
        )

    def __repr__(self) -> str:
        return self.name


def whole_steps(name: str, dt: float, timestep: float, setting: str) -> int:
    """The time steps in a control period."""
    steps = dt / timestep
    if not 1 <= round(steps) <= 1000 or abs(steps - round(steps)) > 1e-9 * steps:
        raise MatchError(
            f"plant '{name}': the control period must be a whole number of time steps; {dt:g} s is {steps:.6g} times "
            f"{timestep:g} s; use {setting}={dt / max(1, math.ceil(steps)):.9g}, or another rate",
            name="timestep",
            value=timestep,
        )
    return round(steps)
