"""Admittance control: section 10.5.2 of the chapter, equation 10.50."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np

from taut.base.checks import one_of
from taut.base.errors import RangeError, UsageError
from taut.base.types import Float64Array, Matrix, Vector, Wrench
from taut.control.closed_loop import ClosedLoop
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain
from taut.control.law import Law, MemoryView, call
from taut.control.laws.compliance import FRAMES, GainFrame, check_damping, check_inertia, check_sensor, wrench_at
from taut.control.laws.spring import Bound
from taut.control.laws.task import check_error_max
from taut.control.laws.tool_loop import tool_loop
from taut.control.laws.virtual_dynamics import Body, Model, answered, damping_matrix, integrated
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["Admittance"]

ModelKind = Literal["own", "measured"]
MODELS: Final[tuple[ModelKind, ...]] = ("own", "measured")


class Admittance(Law):
    """Admittance control: a measured wrench moves a virtual mass, damper and spring, and the arm follows it.

    Law:          V-dot_m = D^-1 (F_ext - B V_m - K X_m)                                            eq. 10.50
                  X_m, V_m the offset and velocity of the model from the reference pose; the inner law is asked for
                  the model's pose, twist and V-dot_m, as eq. 10.31 is; where it gives torques they are less J^T F_ext
                  model="own": pose and twist of the model are its own, integrated by the implicit midpoint rule
                  model="measured", the chapter's form: they are those measured in this tick
    Closed loop:  D V-dot + B V + K X = F_ext                                                       eq. 10.48
                  model="own": of the model exactly, at any rate; of the tool as far as the inner law follows it. Its
                    lag t turns the impedance Z(j w) by w t: a mass is felt as D cos(w t) with damping -w D sin(w t)
                  model="measured": of the tool, where the inner law gives torques and its model is exact. What that
                    model and friction do not know adds to F_ext, and nothing draws the tool back: with K = 0 it
                    drifts. Held over a tick it needs B above K dt / 2
                  every lag t between hand and motion turns the stiffness k of a contact into damping -k t, which B
                    and the contact's own must outweigh: t is 1.5 ticks, the filter's 1 / (2 pi cutoff) and what of
                    the inner law's lag is not led. So it is while sqrt(k / D) is below a quarter of the drive's
                    bandwidth; a smaller D needs up to twice that and more
                  without - J^T F_ext a hand would move the tool past the model, by (kp Lambda)^-1 F_ext

    With F_ext = 0 the energy of model="own" about a resting reference, V D V / 2 + X K X / 2, never grows, however
    long the tick; with it, by no more than F_ext does on the model. The measured wrench is a tick old, and
    `taut.Sensing(F_ext=taut.sensors.LowPass(...))` filters it. Integrating the measured state over a tick, as the
    chapter
    does before eq. 10.31, would make the inner law see an error of its own making, and show D / (1 + kd dt) and the
    damping B - kp dt D: model="measured" asks for the acceleration alone.

    Frames:
        frame= names the axes of D, B and K: "world", "task" (of the reference pose) or "tool". X is (p - p_ref, the
        rotation vector of R R_ref^T). F_ext is taken at the tool that is controlled.

    Args:
        inner: What makes the arm follow a TaskMotion: `TaskComputedTorque` for torques, `TaskVelocity` and
            `TaskPosition` for arms whose drives close these loops.
        D: Virtual inertia: (linear, angular), (6,) or (6, 6).
        K: Stiffness; none if left out: the tool stays where it is led.
        B: Damping; or zeta.
        zeta: Damping ratio of every mode of D and K, in place of B.
        model: "own" or "measured".
        frame: Axes of D, B and K.
        error_max: (2,) largest offset that the spring answers [m, rad], smoothly; no bound if left out.
        deadband: (force, moment) below which the measured wrench counts for nothing [N, N m]; beyond it, for what is
            above.
        tool: The frame that is controlled; the arm's tool if left out.

    Raises:
        RangeError: An inertia that is not positive; gains that the rate cannot follow.
        UsageError: B and zeta, or neither; an inner law that does not follow a TaskMotion.

    Example:
        >>> import taut
        >>> inner = taut.laws.TaskVelocity(kp=5.0)
        >>> law = Admittance(D=(10.0, 1.0), B=(40.0, 4.0), inner=inner)
        >>> taut.compile(law, taut.load_arm("ur10")).needs
        ('v', 'F_ext')

    References:
        Section 10.5.2 admittance control algorithm. Hogan and Buerger (2005), impedance and interaction control,
        in the Robotics and Automation Handbook; Keemink, van der Kooij and Stienen (2018), IJRR 37 (11).
    """

    reference = TaskMotion
    inner: Law
    D: Gain = Gain(size=6, pairs=True, scalar=False)  # [kg, kg m^2]
    K: Gain = Gain((0.0, 0.0), size=6, pairs=True, scalar=False)  # [N/m, N m/rad]
    B: Gain = Gain(size=6, pairs=True, scalar=False, optional=True)  # [N s/m, N m s/rad]
    zeta: Gain = Gain(optional=True, size=0)  # [-]
    model: ModelKind = "own"
    frame: GainFrame = "world"
    error_max: Gain = Gain(optional=True, size=2)  # [m, rad]
    deadband: Gain = Gain(optional=True, size=2, scalar=False)  # [N, N m]
    tool: str | None = None

    def __post_init__(self) -> None:
        one_of("model", self.model, MODELS)
        one_of("frame", self.frame, FRAMES)
        _check_inner(self.inner, self.tool)
        check_damping(self)
        check_inertia(self.D)
        check_error_max(self.error_max if self.gives("error_max") else None, "decoupled")

    def check_rate(self, rate: float) -> None:
        check_inertia(self.D)
        check_error_max(self.error_max if self.gives("error_max") else None, "decoupled")
        D, B, K = (np.asarray(x, dtype=np.float64) for x in (self.D.matrix(6), self._damping(), self.K.matrix(6)))
        if self.model == "own":
            _check_own(D, B, K, rate)
        else:
            _check_measured(D, B, K, rate)

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_sensor(x, self.tool)

    def _damping(self) -> Matrix:
        return damping_matrix(self.D, self.K, self.zeta) if self.gives("zeta") else self.B.matrix(6)

    def start(self, x: Snapshot, ref: TaskMotion) -> Mapping[str, Any]:  # noqa: ARG002
        if self.model == "measured":
            return {}
        T = x.T(self.tool)
        return {"p": T.p, "R": T.R, "twist": x.twist(self.tool)}

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """D V-dot + B V + K X = 0."""
        return tool_loop(
            self, x, lambda g: replace(self, K=g.K, B=None, zeta=g.zeta), inertia=self.D.matrix(6), stiffness=True
        )

    def command(
        self, x: Snapshot, ref: TaskMotion, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        after: dict[str, object] = {}
        if self.model == "own":
            body = Body(p=memory.p, R=memory.R, twist=memory.twist)
            acceleration, new = integrated(self._model(), self.frame, body, ref, self._felt(x), dt)
            after |= {"p": new.p, "R": new.R, "twist": new.twist}
        else:
            T = x.T(self.tool)
            body = Body(p=T.p, R=T.R, twist=x.twist(self.tool))
            acceleration = answered(self._model(), self.frame, body, ref, self._felt(x))
        command, after["inner"] = call(self.inner, x, _motion(body, acceleration), memory["inner"], dt)
        if isinstance(command, Torque):
            command = Torque(command.terms + Terms(wrench=-(x.J().T @ x.F_ext)))
        elif self.model == "measured":
            raise UsageError(
                f"model='measured' is for an inner law that gives torques, and {type(self.inner).__name__} gives a "
                f"{command.kind}, whose drive would show D divided by bandwidth times period; take model='own'",
                name="model",
            )
        return command, after

    def _felt(self, x: Snapshot) -> Wrench:
        """(6,) what moves the virtual mass, at the tool that is controlled, in world axes."""
        F = wrench_at(x, self.tool)
        if not self.gives("deadband"):
            return F
        force, moment = (_beyond(part, self.deadband[k]) for k, part in enumerate((F[:3], F[3:])))
        return tm.array([*force, *moment])

    def _model(self) -> Model:
        return Model(
            D=self.D.matrix(6),
            B=self._damping(),
            K=self.K.matrix(6),
            bound=Bound.of(self.error_max) if self.gives("error_max") else None,
            turning=self.frame == "tool",
        )


def _motion(body: Body, acceleration: Vector) -> TaskMotion:
    return TaskMotion.of({"p": body.p, "R": body.R, "twist": body.twist, "acceleration": acceleration})


def _beyond(part: Vector, width: Any) -> Vector:
    """(3,) what of a force is beyond a deadband, in its direction."""
    square = part[0] * part[0] + part[1] * part[1] + part[2] * part[2]
    outside = square > width * width
    size = tm.sqrt(tm.where(outside, square, 1.0))
    share = tm.where(outside, 1.0 - width / size, 0.0)
    return share * part  # type: ignore[no-any-return]


# -------------------------------------------------------------------- checks


def _check_inner(inner: object, tool: str | None) -> None:
    if not isinstance(inner, Law) or inner.reference is not TaskMotion:
        got = f"{type(inner).__name__}, which follows a {inner.reference.__name__}" if isinstance(inner, Law) else ""
        raise UsageError(
            "inner must be a law that follows a TaskMotion, such as taut.laws.TaskVelocity(kp=5.0); got "
            f"{got or type(inner).__name__}",
            name="inner",
        )
    theirs = inner.controlled_frame
    if theirs != tool:
        raise UsageError(
            f"Admittance moves the frame {_frame(tool)} and its inner law {_frame(theirs)}; give both the same tool=",
            name="tool",
        )


def _frame(name: str | None) -> str:
    return "of the arm's tool" if name is None else f"'{name}'"


def _check_own(D: Float64Array, B: Float64Array, K: Float64Array, rate: float) -> None:
    """The model must be slower than the rate: D >= B dt / 2 + K dt^2 / 4, so that nothing turns round in a tick."""
    dt = 1.0 / rate
    L = np.linalg.cholesky(D)
    inverse = np.linalg.inv(L)
    most = float(np.linalg.eigvalsh(inverse @ (0.5 * dt * B + 0.25 * dt * dt * K) @ inverse.T)[-1])
    if most > 1.0 + 1e-9:
        raise RangeError(
            f"D is too small for {rate:g} Hz: it must be >= B dt / 2 + K dt^2 / 4 in every direction, or the virtual "
            f"mass turns round within a tick; make it {most:.3g} times larger, B and K smaller, or the rate higher",
            name="D",
            value=most,
            rule=">= B dt / 2 + K dt^2 / 4",
        )


def _check_measured(D: Float64Array, B: Float64Array, K: Float64Array, rate: float) -> None:
    """The loop of the chapter's form, sampled and held, must not grow."""
    dt = 1.0 / rate
    hold = np.vstack([0.5 * dt * dt * np.eye(6), dt * np.eye(6)])
    drift = np.block([[np.eye(6), dt * np.eye(6)], [np.zeros((6, 6)), np.eye(6)]])
    feedback = np.linalg.solve(D, np.hstack([K, B]))
    radius = float(np.abs(np.linalg.eigvals(drift - hold @ feedback)).max())
    if radius > 1.0 + 1e-6:
        raise RangeError(
            f"with model='measured' the loop sampled at {rate:g} Hz grows by the factor {radius:.6g} in a tick; B "
            "must be above K dt / 2 and well below 2 D / dt: change B, or take model='own'",
            name="B",
            value=radius,
            rule="<= 1",
        )
