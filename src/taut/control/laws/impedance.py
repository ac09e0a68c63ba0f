"""Impedance control: section 10.5 of the chapter, equations 10.46 to 10.49."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final, Literal

import numpy as np

from taut.base.checks import finite_array, one_of, require_at_least, symmetric_psd
from taut.base.errors import MatchError, RangeError, UsageError, count_of
from taut.base.types import Array, Matrix, Vector, Wrench
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, GainValue
from taut.control.law import Law, MemoryView
from taut.control.laws.compliance import (
    FRAMES,
    Compliance,
    GainFrame,
    check_damping,
    check_frame,
    check_inertia,
    check_sensor,
    modal_damping,
    six_gains,
    spring,
    wrench_at,
)
from taut.control.laws.null_space import Posture
from taut.control.laws.spring import Bound
from taut.control.laws.targets import RATE, asked_of, eased, out_of_reach, within_speed
from taut.control.laws.task import check_error_max, check_free, check_null, note_null, null_torque
from taut.control.laws.task_error import ERRORS, Coordinates, ErrorKind, check_coordinates, dimensions
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot
from taut.maths.task_inertia import TaskInertia
from taut.trace import math as tm
from taut.trace.linalg import factor_spd

__all__ = ["Impedance", "Stiffness"]

Feedback = Literal["wrench", "acceleration"]
FEEDBACKS: Final[tuple[Feedback, ...]] = ("wrench", "acceleration")
Coriolis = Literal["cancel", "keep"]
CORIOLIS: Final[tuple[Coriolis, ...]] = ("cancel", "keep")
LOST: Final = 1e-9  # of the largest: below it a direction is not there
OWN: Final = "; leave D out for the arm's own inertia"
HEAVY: Final = 10.0  # times the arm's mass, which no direction of its tool is made heavier than


class Impedance(Law):
    """Impedance control: the tool answers a wrench like a mass, a damper and a spring.

    Law:          without D   tau = J^T (Lambda (a_des - J-dot v) + B V_e + K X_e) + h
                  feedback="wrench", D with a wrist sensor:  a = D^-1 (F_ext + B V_e + K X_e)
                    tau = J^T (Lambda (a_des + a - J-dot v) - F_ext) + h
                  feedback="acceleration", the chapter's form, with V-dot of the tick before:
                    tau = J^T (Lambda (V-dot - J-dot v) + D (a_des - V-dot) + B V_e + K X_e) + h          eq. 10.49
    Closed loop:  D V_e-dot + B V_e + K X_e = -F_ext, with an exact model and no friction; without D the arm's own
                    Lambda(q) stands in its place                                              eq. 10.46, 10.48
                  with X_des at rest the deviation x = -X_e obeys D x_ddot + B x_dot + K x = F_ext
                  a tracking error is what F_ext makes, K^-1 F_ext at rest, and what the model does not know
                  feedback="acceleration" is an algebraic loop, closed a tick late: stable where the eigenvalues of
                    Lambda^-1 (D + B dt / 2) are above 0 and below 2, and refused elsewhere: where a run starts, and
                    where the arm is when gains change
                  a sampled loop is passive at constant gains and X_des with B and friction of K dt / 2 and more
                  coriolis="keep" leaves C v where it is: then without D the energy of arm and spring falls at the
                    rate V . B V, which that of the cancelled form does about rest only

    The wrench of the spring is the gradient of X_e . K X_e / 2, so that a stiffness that differs by direction gains
    nothing along a closed path; it is K X_e itself where X_e is along an axis of K. With zeta= the damping is
    designed at each pose from K and the inertia that is felt, D or Lambda(q): zeta is the damping ratio of each mode.

    Without error_max, to a target that is certainly out of reach, the torque is that of the spring alone, eased to
    0.05 of the reach, 0.3 rad, on joints that settle at 5/s within their speed limits: the term `reach`, else zero.

    Frames:
        frame= names the axes of K, B and D: "world", "task" (of the reference pose) or "tool".

    Args:
        K: Stiffness: (linear, angular), (6,) or (6, 6), or a function of the pose, which needs `tank`.
        B: Damping, likewise, and without need of a tank; or zeta.
        zeta: Damping ratio of every mode, in place of B.
        D: Inertia to be felt, as K; that of the arm if left out.
        feedback: With D, what makes the difference: "wrench", a wrist sensor, or "acceleration".
        error: "decoupled", "body", "space" or "coordinates": see `taut.laws.TaskComputedTorque`.
        coordinates: With error="coordinates": what is controlled.
        error_max: (2,) largest error that the spring answers [m, rad], smoothly; what it takes is the term `bound`.
            The bounded spring too is the gradient of an energy.
        tank: Energy that is kept for changes of K and D [J]: they bring in no more than is there. New values come in
            over `settle` seconds, as far as the tank pays for them; it starts full, and what damping takes from the
            arm fills it again, up to that much. Without it a new K acts at once, jump and energy included. In a run
            it is the further column `law.energy` [J].
        settle: Time constant of such changes [s].
        coriolis: "cancel" or "keep".
        null: A law for the motion that the task leaves free; None to leave it free.
        tool: The frame that is controlled; the arm's tool if left out.

    References:
        Section 10.5 impedance control. Hogan (1985), ASME J. Dynamic Systems 107. Ferraguti, Secchi and Fantuzzi
        (2013), IEEE ICRA, on the tank.
    """

    reference = TaskMotion
    recorded: ClassVar[tuple[str, ...]] = ("energy",)
    K: Gain = Gain(size="dimensions", pairs=True, scalar=False, function=True)  # [N/m, N m/rad]
    B: Gain = Gain(size="dimensions", pairs=True, scalar=False, optional=True, function=True)  # [N s/m, N m s/rad]
    zeta: Gain = Gain(optional=True, size=0)  # [-]
    D: Gain = Gain(size="dimensions", pairs=True, scalar=False, optional=True, function=True)  # [kg, kg m^2]
    feedback: Feedback = "wrench"
    frame: GainFrame = "world"
    error: ErrorKind = "decoupled"
    coordinates: Coordinates | None = None
    error_max: Gain = Gain(optional=True, size=2, minimum=1e-9)  # [m, rad]
    tank: Gain = Gain(optional=True, size=0)  # [J]
    settle: Gain = Gain(0.1, minimum=1e-6, size=0, where=("tank", ...))  # [s]
    coriolis: Coriolis = "cancel"
    null: Law | None = Posture()
    tool: str | None = None

    def __post_init__(self) -> None:
        one_of("error", self.error, ERRORS)
        one_of("feedback", self.feedback, FEEDBACKS)
        one_of("frame", self.frame, FRAMES)
        one_of("coriolis", self.coriolis, CORIOLIS)
        check_frame(self.frame, self.error)
        check_coordinates(self.error, self.coordinates, type(self).__name__)
        check_error_max(self.error_max if self.gives("error_max") else None, self.error)
        check_null(self.null)
        note_null(self)
        check_damping(self)
        if self.gives("D"):
            check_inertia(self.D, OWN)
        elif not self.has("D") and self.feedback != "wrench":
            raise UsageError(
                f"feedback='{self.feedback}' is for an inertia D to be felt, and this Impedance has none; give D, or "
                "leave feedback out",
                name="feedback",
            )
        changing = [name for name in ("K", "D") if callable(getattr(self, name))]
        if changing and not self.gives("tank"):
            raise UsageError(
                f"{changing[0]} as a function of the pose needs tank= [J], which keeps it from bringing in energy at "
                "its borders; a wall or a groove is a law to add: + taut.laws.VirtualWall(...)",
                name="tank",
            )

    @property
    def dimensions(self) -> int:
        """Entries of the error: 6, or those of the coordinates."""
        return dimensions(self.error, self.coordinates)

    def check_rate(self, rate: float) -> None:  # noqa: ARG002
        if self.gives("D"):
            check_inertia(self.D, OWN)

    def has(self, gain: str) -> bool:
        """Whether K, B or D is there, as numbers or as a function of the pose."""
        return getattr(self, gain) is not None

    def gain_at(self, gain: str, x: Snapshot) -> GainValue:
        """K, B or D at a pose."""
        given: Any = getattr(self, gain)
        return six_gains(given(x.T(self.tool)), self.dimensions, gain) if callable(given) else given

    def inertia_of(self, x: Snapshot, J: Matrix) -> TaskInertia:
        """The arm's inertia at the tool, bounded where a direction is nearly lost."""
        return TaskInertia.bounded(J, x.M_factors, HEAVY * sum(body.mass for body in x.arm.bodies))

    def check_state(self, x: Snapshot, rate: float) -> None:
        """The algebraic loop of feedback="acceleration" is stable where 0 < eig(Lambda^-1 (D + B dt / 2)) < 2.

        That of feedback="wrench" needs its sensor on the link that is controlled.
        """
        for name in ("K", "B", "D"):
            if callable(getattr(self, name)):
                _check_given(name, np.asarray(self.gain_at(name, x).as_array(), dtype=np.float64))
        ref = TaskMotion.at_rest(x, self.tool)
        felt = Compliance.of(self.error, self.frame, x, ref, self.tool, self.coordinates)
        check_directions(x, self.tool, felt.error.J)
        check_free(self, x, self.dimensions)
        if self.has("D") and self.feedback == "wrench":
            check_sensor(x, self.tool)
        self.check_change(x, rate)

    def check_change(self, x: Snapshot, rate: float) -> None:
        """0 < eig(Lambda^-1 (D + B dt / 2)) < 2, where feedback="acceleration" needs it."""
        if not self.has("D") or self.feedback == "wrench":
            return
        ref = TaskMotion.at_rest(x, self.tool)
        felt = Compliance.of(self.error, self.frame, x, ref, self.tool, self.coordinates)
        inverse = felt.error.J @ x.M_factors.solve(felt.error.J.T)
        size = self.dimensions
        K, D = self.gain_at("K", x).matrix(size), self.gain_at("D", x).matrix(size)
        if self.has("B"):
            B = self.gain_at("B", x).matrix(size)
        else:
            zeta, factors = self.zeta.as_array(), factor_spd(D)
            B = np.column_stack([modal_damping(factors, K, zeta, column) for column in np.eye(size)])
        sizes, axes = np.linalg.eigh(0.5 * (inverse + inverse.T))
        U = axes[:, sizes > LOST * sizes[-1]]  # the directions that the arm can move in at all
        ratios = np.linalg.eigvals(U.T @ inverse @ U @ (U.T @ felt.matrix_outwards(D + B * (0.5 / rate)) @ U))
        low, high = float(np.min(ratios.real)), float(np.max(ratios.real))
        if not 0.0 < low <= high < 2.0:
            raise RangeError(
                "feedback='acceleration' uses the acceleration of the tick before, which is stable where the "
                "eigenvalues of Lambda^-1 (D + B dt / 2) are above 0 and below 2; at this pose they are "
                f"{low:.3g} to {high:.3g}; {_way_out(low, high, self.has('B'))}, or take feedback='wrench' with "
                "a wrist sensor",
                name="D",
                value=high,
                rule="0 < eig(Lambda^-1 (D + B dt / 2)) < 2",
            )

    def start(self, x: Snapshot, ref: TaskMotion) -> Mapping[str, Any]:
        memory: dict[str, Any] = {}
        if self.gives("tank"):
            memory["K_now"] = self.gain_at("K", x).as_array()
            memory["energy"] = self.tank.as_array()
            if self.has("D"):
                memory["D_now"] = self.gain_at("D", x).as_array()
        if self.has("D") and self.feedback == "acceleration":
            felt = Compliance.of(self.error, self.frame, x, ref, self.tool, self.coordinates)
            memory["V_last"] = felt.error.J @ x.v
        return memory

    def command(
        self, x: Snapshot, ref: TaskMotion, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        felt = Compliance.of(self.error, self.frame, x, ref, self.tool, self.coordinates)
        error, after = felt.error, dict[str, object]()
        inertia = self.inertia_of(x, error.J)
        K, D = self.gain_at("K", x), self.gain_at("D", x) if self.has("D") else None
        bound = Bound.of(self.error_max) if self.gives("error_max") else None
        if self.gives("tank"):
            K, D, share = self._paid(felt, bound, K, D, memory, dt)
            after |= {"K_now": K.as_array()} | ({} if D is None else {"D_now": D.as_array()})
        damping = self._damping(x, felt, K, D, inertia)
        if self.gives("tank"):
            after["energy"] = self._filled(memory.energy, share, self._braked(x, felt, damping), dt)
        wrench = spring(felt, K, bound).mapped(felt.wrench) + Terms(D=damping)
        cancels = self.coriolis == "cancel"
        motion = Terms(feedforward=error.acceleration)
        if cancels:
            motion = motion + Terms(nonlinear=-error.Jdot_v)
        if D is None:
            F = wrench.mapped(felt.outwards) + inertia.Lambda @ motion
        elif self.feedback == "wrench":
            F_ext = _at_frame(self, x, inertia)
            solved = factor_spd(D.matrix(self.dimensions))
            a = (wrench + Terms(sensor=felt.inwards(F_ext))).mapped(solved.solve).mapped(felt.outwards)
            F = inertia.Lambda @ (a + motion) - Terms(sensor=F_ext)
        else:
            V = error.J @ x.v
            V_dot = (V - memory.V_last) / dt
            after["V_last"] = V
            lag = felt.outwards(D @ felt.inwards(error.acceleration - V_dot))
            F = wrench.mapped(felt.outwards) + Terms(inertia=lag)
            F = F + inertia.Lambda @ (motion + Terms(inertia=V_dot) - Terms(feedforward=error.acceleration))
        away = None if bound is not None else out_of_reach(x, ref, self.tool, asked_of(self.error, self.coordinates))
        rest = Terms(nonlinear=x.h if cancels else x.g)
        if away is not None:
            pull = eased(away, away.clear, felt.X) * felt.outwards(felt.wrench(K @ felt.X))
            calm = within_speed(x, inertia, pull)
            F = F.up_to(F.total + away.clear * (calm - F.total), "reach")
            rest = rest + Terms(reach=-(away.clear * RATE) * (x.M @ x.v))
        tau = error.J.T @ F + rest
        if self.null is not None:
            after["null"] = memory["null"]
        if self.null is not None and x.n > self.dimensions:  # else there is no free motion
            free, after["null"] = null_torque(self.null, x, ref, memory["null"], dt, inertia)
            tau = tau + (free if away is None else (1.0 - away.clear) * free)
        return Torque(tau), after

    def _damping(
        self, x: Snapshot, felt: Compliance, K: GainValue, D: GainValue | None, inertia: TaskInertia
    ) -> Vector:
        """(k,) B V_e in the axes of the gains."""
        if self.has("B"):
            out: Vector = self.gain_at("B", x) @ felt.V
            return out
        matrix = felt.matrix_inwards(inertia.Lambda) if D is None else D.matrix(self.dimensions)
        return modal_damping(factor_spd(matrix), K.matrix(self.dimensions), self.zeta.as_array(), felt.V)

    def _paid(
        self, felt: Compliance, bound: Bound | None, K: GainValue, D: GainValue | None, memory: MemoryView, dt: Any
    ) -> tuple[GainValue, GainValue | None, Any]:
        """The gains after this tick on their way to new ones, as far as the tank pays; and what it paid [J]."""
        settled = dt / tm.maximum(self.settle.as_array(), dt)
        dK = GainValue((K.as_array() - memory.K_now) * settled, "K")
        X = felt.X if bound is None else bound.stretch(felt.X)
        cost = 0.5 * (X @ (dK @ X))
        dD = None
        if D is not None:
            dD = GainValue((D.as_array() - memory.D_now) * settled, "D")
            cost = cost + 0.5 * (felt.V @ (dD @ felt.V))
        short = cost > memory.energy
        share = tm.where(short, memory.energy / tm.where(short, cost, 1.0), 1.0)
        paid = share * cost  # what comes back when gains fall fills it
        now = GainValue(memory.K_now + share * dK.as_array(), "K")
        return now, None if dD is None else GainValue(memory.D_now + share * dD.as_array(), "D"), paid

    def _braked(self, x: Snapshot, felt: Compliance, damping: Vector) -> Any:
        """[W] what the damper takes from the arm, at most what it turns into heat; X_des at work fills nothing."""
        return tm.minimum(felt.V @ damping, -(felt.inwards(felt.error.J @ x.v) @ damping))

    def _filled(self, energy: Any, paid: Any, dissipated: Any, dt: Any) -> Any:
        """[J] in the tank after this tick."""
        return tm.clip(energy - paid + tm.maximum(dissipated, 0.0) * dt, 0.0, self.tank.as_array())


def _at_frame(law: Impedance, x: Snapshot, inertia: TaskInertia) -> Wrench:
    """The measured wrench in the coordinates of the error."""
    F = wrench_at(x, law.tool)
    if law.error == "body":
        R = x.T(law.tool).R
        return tm.array([*(R.T @ F[:3]), *(R.T @ F[3:])])
    if law.error == "space":
        return tm.array([*F[:3], *(F[3:] + tm.cross(x.T(law.tool).p, F[:3]))])
    if law.error == "coordinates":
        out: Array = inertia.wrench(x.J(law.tool).T @ F)
        return out
    return F


def _way_out(low: float, high: float, given: bool) -> str:
    """What would do; a designed B falls with the root of D only."""
    if low <= 0.0:
        return "make D and B positive in every direction"
    share = 1.9 / high if given else (1.9 / high) ** 2
    return f"{'D and B' if given else 'D'} times {np.floor(100.0 * share) / 100.0:g} would do there"


def _check_given(name: str, values: Array) -> None:
    """What a function of the pose gives where a run starts is as good as numbers would be.

    Raises:
        RangeError: It is not finite, not symmetric, not positive.
    """
    finite_array(name, values)
    if values.ndim == 2:
        symmetric_psd(name, values)
    else:
        require_at_least(name, values, 0.0)
    if name == "D":
        check_inertia(GainValue(values, name), OWN)


def check_directions(x: Snapshot, tool: str | None, J: Matrix) -> None:
    """An arm may lack one direction of its tool, and those that a planar arm never has, but no more.

    Raises:
        MatchError: It lacks more.
    """
    rows = [i for i in range(len(J)) if np.any(J[i] != 0.0)]
    sizes = np.linalg.svd(np.asarray(J, dtype=np.float64)[rows], compute_uv=False)
    body = x.model.placement(tool)[0]
    moving = len(x.arm.ancestors(body)) if body >= 0 else 0
    lost = len(rows) - min(len(rows), moving)
    if lost > 1 and len(rows) - int(np.sum(sizes > LOST * sizes[0])) > 1:
        name = tool or x.arm.tool
        raise MatchError(
            f"frame '{name}' of '{x.arm.name}' is moved by {count_of(moving, 'joint')}, and is asked for "
            f"{len(rows)} directions; control another frame, or what it can do: error='coordinates', "
            "coordinates=taut.Coordinates.position()",
            name="tool",
        )


class Stiffness(Law):
    """Stiffness control: a spring alone, with the arm's weight compensated.

    Law:          tau = J^T K X_e + g(q) - kd v                                  eq. 10.49 with K only
    Closed loop:  M a + C v + kd v = J^T (K X_e + F_ext): F_ext = -K X_e at rest
                  the energy of arm and spring falls at the rate v . kd v, and stays with kd = 0

    To a target that is certainly out of reach the spring is eased, without error_max, to 0.05 of the reach, 0.3 rad:
    the term `reach`, else zero.

    Frames:
        frame= names the axes of K: "world", "task" (of the reference pose) or "tool".

    Args:
        K: Stiffness: (linear, angular), (6,) or (6, 6).
        kd: Joint damping.
        error: "decoupled", "body", "space" or "coordinates": see `taut.laws.TaskComputedTorque`.
        coordinates: With error="coordinates": what is controlled.
        error_max: (2,) largest error that the spring answers [m, rad]; what it takes is the term `bound`.
        tool: The frame that is controlled; the arm's tool if left out.

    References:
        Section 10.5 impedance control. Salisbury (1980), IEEE CDC, active stiffness control.
    """

    reference = TaskMotion
    K: Gain = Gain(size="dimensions", pairs=True, scalar=False)  # [N/m, N m/rad]
    kd: Gain = Gain(0.0)  # [N m s/rad | N s/m]
    frame: GainFrame = "world"
    error: ErrorKind = "decoupled"
    coordinates: Coordinates | None = None
    error_max: Gain = Gain(optional=True, size=2, minimum=1e-9)  # [m, rad]
    tool: str | None = None

    def __post_init__(self) -> None:
        one_of("error", self.error, ERRORS)
        one_of("frame", self.frame, FRAMES)
        check_frame(self.frame, self.error)
        check_coordinates(self.error, self.coordinates, type(self).__name__)
        check_error_max(self.error_max if self.gives("error_max") else None, self.error)

    @property
    def dimensions(self) -> int:
        """Entries of the error: 6, or those of the coordinates."""
        return dimensions(self.error, self.coordinates)

    def command(self, x: Snapshot, ref: TaskMotion) -> Command:
        felt = Compliance.of(self.error, self.frame, x, ref, self.tool, self.coordinates)
        bound = Bound.of(self.error_max) if self.gives("error_max") else None
        wrench = spring(felt, self.K, bound).mapped(felt.wrench).mapped(felt.outwards)
        away = out_of_reach(x, ref, self.tool, asked_of(self.error, self.coordinates))
        if away is not None and bound is None:
            wrench = wrench.up_to(eased(away, away.clear, felt.X) * wrench.total, "reach")
        return Torque(felt.error.J.T @ wrench + Terms(gravity=x.g, D=-(self.kd @ x.v)))
