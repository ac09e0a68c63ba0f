"""Laws of task-space motion: section 10.2.3 of the chapter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np

from taut.base.checks import one_of, require_positive
from taut.base.errors import MatchError, ShapeError, UsageError, count_of
from taut.base.types import Vector
from taut.control.closed_loop import ClosedLoop
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, GainValue, Memory
from taut.control.law import Law, MemoryView, call
from taut.control.laws.integral import ANTI_WINDUP, AntiWindup, check_tracking, integrated
from taut.control.laws.null_space import Posture
from taut.control.laws.spring import Bound
from taut.control.laws.targets import asked_of, eased, out_of_reach
from taut.control.laws.task_error import ERRORS, Coordinates, ErrorKind, check_coordinates, dimensions, task_error
from taut.control.laws.tool_loop import tool_loop
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.singularity import ResolvedMotion, resolve
from taut.maths.snapshot import Snapshot
from taut.maths.task_inertia import TaskInertia
from taut.trace import math as tm

__all__ = ["TaskComputedTorque", "check_error_max", "check_free", "check_null", "note_null", "null_torque"]


Singularity = Literal["robust", "plain"]
SINGULARITY: Final[tuple[Singularity, ...]] = ("robust", "plain")


class TaskComputedTorque(Law):
    """Task-space feedback linearisation (computed torque of the end-effector).

    Law:          tau = J^T Lambda (a_des + kp X_e + ki int(X_e) + kd V_e - J-dot v) + h(q, v)          eq. 10.31
                  Lambda = (J M^-1 J^T)^-1, J^T (Lambda (.) + eta) with eta = J^-T h - Lambda J-dot v
    Closed loop:  V_e-dot + kd V_e + kp X_e + ki int(X_e) = 0, with an exact model and no friction, where V_e is
                  error="decoupled": p_des - p and the rotation vector of R_des R^T, world axes: the tool's origin
                    goes straight and its rotation turns about one axis; V_e = X_e-dot for the origin exactly, for the
                    rotation to first order at a target that does not turn
                  error="body": log(T^-1 T_des), the desired acceleration transported into the tool's frame,
                    Ad a_des + ad_{V_e} (Ad V_des): X_e-dot = V_e to first order about any target, turning or not
                  error="space": log(T_des T^-1): X_e-dot = V_e to first order at a resting target only
                  error="coordinates": y(T_des) - y(T), whose rate is V_e exactly: linear everywhere but where y
                    itself is singular
                  so omega_n = sqrt(kp), zeta = kd / (2 sqrt(kp)) for ki = 0
                  a sampled loop tends to this as dt falls

    The spring kp X_e may be bounded: error_max=(linear, angular) puts X_e / sqrt(1 + r^2) in the place of X_e,
    part by part, with r the length of the part over its error_max; what the bound takes is the term `bound`.

    Near singularities, with singularity="robust", what the arm cannot do is given up along the direction that is
    nearly lost, its joints are kept within their limits, and the motion that this leaves is damped at the rate kd:
    the term `singularity`. So it is on the way to a target that is certainly out of reach, and without error_max one
    that is out by a tenth of the reach and more pulls no harder than 0.05 of the reach, 0.3 rad would. Elsewhere
    nothing is changed. With "plain" Lambda is (J M^-1 J^T + damping I)^-1.

    Frames:
        World axes at the tool for "decoupled", the tool's own for "body", the world's origin for "space".

    Args:
        error: "decoupled", "body", "space" or "coordinates".
        coordinates: With error="coordinates": what is controlled.
        error_max: (2,) largest error that the spring answers [m, rad]; no bound if left out.
        null: A law for the motion that the task leaves free, `Posture()` if not said, None for none: its torque
            goes through the dynamically consistent projector, I - J^T Lambda J M^-1, which the tool does not feel.
        tool: The frame that is controlled; the arm's tool if left out.
        singularity: "robust" or "plain".
        damping: With "plain", a constant damping [1/kg, 1/(kg m^2)].

    References:
        Section 10.2.3 task space motion control. Khatib (1987), IEEE Journal of Robotics and Automation 3 (1).
    """

    reference = TaskMotion
    kp: Gain = Gain(size="dimensions", pairs=True)  # [1/s^2]
    kd: Gain = Gain(size="dimensions", pairs=True)  # [1/s]
    ki: Gain = Gain(0.0, size="dimensions", pairs=True)  # [1/s^3]
    e_int: Memory = Memory(0.0)  # [m s, rad s]
    error: ErrorKind = "decoupled"
    coordinates: Coordinates | None = None
    error_max: Gain = Gain(optional=True, size=2, minimum=1e-9)  # [m, rad]
    null: Law | None = Posture()
    tool: str | None = None
    anti_windup: AntiWindup = "clamping"
    tracking: Gain = Gain(10.0, where=("anti_windup", "back-calculation"))  # [1/s]
    singularity: Singularity = "robust"
    damping: Gain = Gain(0.0, size=0, where=("singularity", "plain"))  # [1/kg, 1/(kg m^2)]
    held: Memory = Memory(0.0)  # how far the limits of a singularity still act

    def __post_init__(self) -> None:
        one_of("singularity", self.singularity, SINGULARITY)
        one_of("error", self.error, ERRORS)
        one_of("anti_windup", self.anti_windup, ANTI_WINDUP)
        check_coordinates(self.error, self.coordinates, type(self).__name__)
        check_error_max(self.error_max if self.gives("error_max") else None, self.error)
        check_null(self.null)
        note_null(self)

    @property
    def dimensions(self) -> int:
        """Entries of the error: 6, or those of the coordinates."""
        return dimensions(self.error, self.coordinates)

    def check_rate(self, rate: float) -> None:
        check_tracking(self.anti_windup, self.tracking, rate)

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_free(self, x, self.dimensions)

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """V_e-dot + kd V_e + kp X_e + ki int(X_e) = 0."""
        return tool_loop(self, x, lambda g: replace(self, kp=g.K, kd=g.D, ki=g.Ki), inertia=np.eye(self.dimensions))

    def command(
        self, x: Snapshot, ref: TaskMotion, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        error = task_error(self.error, x, ref, self.tool, self.coordinates)
        cut = error.J @ tm.solve_spd(x.M_factors, x.tau_cut) if self.anti_windup != "none" else None
        scheme, tracking = self.anti_windup, self.tracking
        e_int = integrated(memory.e_int, error.X, x, dt, scheme, self.ki, tracking, cut=cut)
        a = Terms(feedforward=error.acceleration, P=self.kp @ error.X, I=self.ki @ e_int, D=self.kd @ error.V)
        a = a + Terms(nonlinear=-error.Jdot_v)
        if self.gives("error_max"):
            a = a + Terms(bound=self.kp @ (Bound.of(self.error_max).error(error.X) - error.X))
        after: dict[str, object] = {"e_int": e_int, "held": memory.held}
        if self.null is not None:
            after["null"] = memory["null"]
        inertia: TaskInertia | ResolvedMotion
        if self.singularity == "plain":
            inertia = TaskInertia.of(error.J, x.M_factors, self.damping.as_array()[()])
            tau = error.J.T @ (inertia.Lambda @ a)
        else:
            J, asked = error.J, a.total
            away = out_of_reach(x, ref, self.tool, asked_of(self.error, self.coordinates))
            if away is not None and x.n >= self.dimensions and not self.gives("error_max"):
                asked = asked - (1.0 - eased(away, away.far, error.X)) * (self.kp @ error.X)
            if self.error == "space":  # what is nearly lost, and how dear it is, is told at the tool
                p, J = x.T(self.tool).p, x.J(self.tool)
                a, asked = a.mapped(lambda b: _at_point(p, b)), _at_point(p, asked)
            clear = 0.0 if away is None else away.clear
            inertia = resolve(x, J, asked, rate=settling(self.kd), held=memory.held, beyond=clear)
            tau = inertia.scale * (x.M @ a.mapped(inertia.of).up_to(inertia.accelerations, "singularity"))
            after["held"] = inertia.held
        tau = tau + Terms(nonlinear=x.h)
        if self.null is not None and x.n > self.dimensions:  # else there is no free motion
            free, after["null"] = null_torque(self.null, x, ref, memory["null"], dt, inertia)
            tau = tau + free
        return Torque(tau), after


def _at_point(p: Vector, a: Vector) -> Vector:
    """(6,) what acts at the world's origin, at the point p of the same body."""
    return tm.array([*(a[:3] - tm.cross(p, a[3:])), *a[3:]])


def settling(kd: GainValue) -> Any:
    """The rate at which joints come to rest where the task does not move them: the largest of kd, at least 1/s."""
    entries = kd.as_array()
    most: Any = 1.0
    for entry in np.diagonal(entries) if entries.ndim == 2 else entries.ravel():
        most = tm.maximum(most, entry)
    return most


def check_error_max(error_max: GainValue | None, error: str) -> None:
    """A bound of the spring is positive, and for errors that have a linear and an angular part.

    Raises:
        ShapeError: It is not two numbers.
        UsageError: It is given for coordinates.
        RangeError: It is not positive.
    """
    if error_max is None:
        return
    if error_max.shape != (2,):
        raise ShapeError(
            "error_max needs one number for metres and one for radians, error_max=(linear, angular) [m, rad]; got "
            f"shape {error_max.shape}",
            name="error_max",
        )
    if error == "coordinates":
        raise UsageError(
            "error_max=(linear, angular) bounds the errors of a pose, and error='coordinates' has others; leave "
            "it out",
            name="error_max",
        )
    require_positive("error_max", np.asarray(error_max.as_array()), unit="m, rad")


def check_null(null: object) -> None:
    """What moves the free motion is a law that follows no reference.

    Raises:
        UsageError: It is none, or follows one.
    """
    if null is None:
        return
    if not isinstance(null, Law):
        raise UsageError(f"null holds a law such as taut.laws.Posture(); got {type(null).__name__}", name="null")
    if not null.ignores_reference:
        raise UsageError(
            f"null holds a law that follows no reference, such as taut.laws.Posture(), and {type(null).__name__} "
            f"follows a {null.reference.__name__}",
            name="null",
        )


def note_null(law: Law) -> None:
    """Keep in mind whether a law was given its `null`, which the law bound to other gains does not show."""
    object.__setattr__(law, "_null_given", vars(law)["null"] is not vars(type(law))["null"])


def check_free(law: Law, x: Snapshot, dimensions: int) -> None:
    """A law that is given for the free motion needs one; that which is there unsaid does nothing without.

    Raises:
        MatchError: The task leaves nothing free.
    """
    null = vars(law)["null"]
    if vars(law)["_null_given"] and null is not None and x.n <= dimensions:
        raise MatchError(
            f"null={type(null).__name__}(...) is for motion that the task leaves free, and with "
            f"{count_of(x.n, 'joint')} '{x.arm.name}' has none beside {dimensions} directions; leave null out",
            name="null",
        )


def null_torque(
    null: Law, x: Snapshot, ref: Any, memory: Any, dt: Any, inertia: TaskInertia | ResolvedMotion
) -> tuple[Terms, dict[str, Any]]:
    """The torque of a law for the free motion, through the dynamically consistent projector, as one term."""
    own = x.with_own_record()
    command, after = call(null, own, ref, memory, dt)
    if not isinstance(command, Torque):
        raise UsageError(
            f"null holds a law that gives a torque, and {type(null).__name__} gives a {command.kind}", name="null"
        )
    twice = sorted(own.used & {"gravity", "coriolis", "friction"})
    if twice:
        raise UsageError(
            f"null: {type(null).__name__} compensates {twice[0]}, which the law around it adds already; use a law "
            "without, such as taut.laws.Posture()",
            name="null",
        )
    x.used.update(own.used)
    return Terms(null=inertia.project(command.total)), after
