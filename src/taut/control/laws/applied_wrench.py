"""A wrench on the environment beside a law of motion of the tool, where no surface is known."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from taut.base.errors import RangeError, UsageError
from taut.base.fields import Choice
from taut.base.types import Matrix, Wrench
from taut.control.combine import Wrapper, bare
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, MemoryView
from taut.control.laws.constraints import known_samples
from taut.control.laws.task_error import FRAMES, GainFrame, outwards
from taut.control.trajectories.force_reference import OF_TASK, HybridMotion, Pressing
from taut.control.trajectories.reference import Reference, Sample
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

PARTS: Final = (slice(0, 3), slice(3, 6))  # force and moment
NEVER: Final = 1e-24  # keeps a root from zero, where it has no slope


class AppliedWrench(Wrapper):
    """A law of motion of the tool, and a wrench that the arm applies to the environment beside it.

    Law:          tau = tau_law + J^T (F - d (u . V) u), force and moment each, with F = F_app of the reference,
                    u = F / |F|, V the tool's twist less that of the reference, d = |F| / speed
                  d <= 1 / (2 dt u . Lambda^-1 u), so that a tick never takes more speed along u than there is
    Closed loop:  of an `Impedance` without D  Lambda V_e-dot + B V_e + K X_e = -F_ext - F + d (u . V) u
                  in contact at rest the environment gets F, and K X_e beside it: F alone where K is zero along u
                  without contact the tool goes on along u until K holds it; where K is zero, from rest, at `speed` at
                  most, less with a B; the forces of the law across u, and another inertia later on, are not in that

    The reference is `taut.pressing(motion, F_app=...)`; a chunk or a trajectory of these changes in time. It needs no
    sensor and no contact: the force is as exact as the arm's gravity is known and its friction small. A known
    reference is refused where a single tick of it would give more than half of `speed`.

    Frames:
        F_app is at the origin of the tool that the law controls, in the axes that `frame` names: "world", "task" (of
        the reference pose) or "tool".

    Args:
        law: A law of torques that follows a TaskMotion, such as `taut.laws.Impedance(K=, B=)` without D.
        speed: (linear, angular) largest speed along the wrench without contact.
        frame: "world", "task" or "tool".

    Raises:
        UsageError: Another law; a reference that presses by press or lam, which need a surface.

    Example:
        >>> import taut
        >>> soft = taut.laws.Impedance(K=[500, 500, 0, 30, 30, 30], B=[60, 60, 20, 4, 4, 4])
        >>> ctrl = taut.compile(AppliedWrench(law=soft, speed=(0.05, 0.2)), taut.load_arm("panda"))
        >>> here = taut.TaskMotion(pose=taut.snapshot(ctrl.arm, ctrl.arm.home).T())
        >>> ref = taut.pressing(here, F_app=[0, 0, -10.0, 0, 0, 0])
        >>> out = taut.run(ctrl, taut.RigidPlant(ctrl.arm), ref, duration=0.3)  # without contact
        >>> bool(taut.snapshot(ctrl.arm, out.q[-1]).T().p[2] > here.pose.p[2] - 0.3 * 0.05)
        True

    References:
        Hogan (1985), ASME J. Dynamic Systems 107, on a force beside an impedance.
    """

    speed: Gain = Gain(unit="m/s, rad/s", shape=2, accepts=("pair",), above=0.0)
    frame: Choice[GainFrame] = Choice(*FRAMES)

    def check(self) -> None:
        super().check()
        law = bare(self.law)
        if self.law.reference is not TaskMotion:
            self.refuse("law", f"must follow a TaskMotion, such as Impedance; got {type(law).__name__}")
        if vars(law).get("D") is not None:
            self.refuse("law", "must have the arm's own inertia, by which the wrench acts; leave its D out")
        self.__dict__["reference"] = OF_TASK

    def at_rest(self, x: Snapshot) -> Sample:
        return OF_TASK.at_rest(x, self.controlled_frame)

    def check_references(self, x: Snapshot, ref: Reference, rate: float) -> None:
        """A known reference has a wrench that a tick can brake, and nothing that needs a surface."""
        mobility = np.asarray(_mobility(x, x.J(self.controlled_frame)))
        for t, sample in known_samples(ref):
            if not isinstance(sample, HybridMotion):
                return
            if np.any(sample.press) or np.any(sample.given) or (isinstance(ref, Pressing) and ref.presses):
                raise UsageError(
                    "AppliedWrench knows no surface, which press and lam are for; give F_app= to pressing",
                    name="press",
                )
            F = np.asarray(self._wrench(x, sample))
            for part, most, unit in zip(PARTS, self.speed.as_array(), ("m/s", "rad/s"), strict=True):
                gained = 2.0 / rate * float(np.linalg.norm(mobility[part, part] @ F[part]))
                if gained > most:
                    raise RangeError(
                        f"F_app at t = {t:g} s accelerates the free tool by {0.5 * gained:.3g} {unit} in a tick, and "
                        f"half of speed is the maximum, {0.5 * most:g} {unit}; give a larger speed, a smaller "
                        "wrench, or a higher rate",
                        name="speed",
                        value=gained,
                    )

    def _wrench(self, x: Snapshot, ref: HybridMotion) -> Wrench:
        """(6,) F_app in world axes."""
        motion: Any = ref.motion
        R = {"world": None, "task": motion.R, "tool": x.T(self.controlled_frame).R}[self.frame]
        return outwards(R, ref.F_app)

    def command(self, x: Snapshot, ref: HybridMotion, memory: MemoryView, dt: Any) -> tuple[Command, dict[str, Any]]:
        tau, after = self.inner_torque(x, ref.motion, memory, dt)
        motion: Any = ref.motion
        F, J = self._wrench(x, ref), x.J(self.controlled_frame)
        V, mobility, wrench = J @ x.v - motion.twist, _mobility(x, J), []
        for part, speed in zip(PARTS, (self.speed[0], self.speed[1]), strict=True):
            length = tm.sqrt(F[part] @ F[part] + NEVER)
            u = F[part] / length
            fastest = 0.5 / (dt * (u @ (mobility[part, part] @ u)) + NEVER)
            wrench.extend(F[part] - tm.minimum(length / speed, fastest) * (u @ V[part]) * u)
        return Torque(tau + Terms(applied=J.T @ tm.array(wrench))), after


def _mobility(x: Snapshot, J: Matrix) -> Matrix:
    """(6, 6) Lambda^-1 = J M^-1 J^T, acceleration of the tool per wrench."""
    out: Matrix = J @ x.M_factors.solve(J.T)
    return out
