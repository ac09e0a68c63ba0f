"""Admittance control: section 10.5.2 of the chapter, equation 10.50."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from taut.base.errors import UsageError
from taut.base.fields import Choice
from taut.base.types import Float64Array, Matrix, Rotation, Twist, Vector, Vector3, Wrench
from taut.control.closed_loop import ApparentImpedance, ClosedLoop
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, GainValue, MemoryView, require_at_most
from taut.control.law import Law, call
from taut.control.laws.task_error import FRAMES, GainFrame, inwards, outwards, pulled
from taut.control.laws.task_space import (
    Bound,
    TaskSpace,
    check_damping,
    check_sensor,
    modal_damping,
    task_gain,
    tool_loop,
    wrench_at,
)
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import left_jacobian_inverse, rotation_exp, rotation_log
from taut.trace import math as tm

ModelKind = Literal["own", "measured"]
SOLVE_ROUNDING: Final = 1e-12


class Admittance(Law):
    """Admittance control: a measured wrench moves a virtual mass, damper and spring, and the arm follows it.

    Law:          V-dot_m = D^-1 (F_ext - B V_m - K X_m)                                            eq. 10.50
                  X_m, V_m: offset and velocity of the virtual model relative to the reference pose; the inner law
                  follows the model's pose, twist and V-dot_m, as in eq. 10.31; its torques are reduced by J^T F_ext
                  model="own": the model has a state of its own, integrated by the implicit midpoint rule
                  model="measured", the chapter's form: its pose and twist are those measured in this tick
    Closed loop:  D V-dot + B V + K X = F_ext                                                       eq. 10.48
                  model="own": for the model exactly, at any rate; for the tool as well as the inner law tracks. Its
                    lag t rotates the impedance Z(j w) by w t: apparent mass D cos(w t), damping -w D sin(w t)
                  model="measured": for the tool, where the inner law gives torques and its arm model is exact. Model
                    errors and friction add to F_ext without restoring force: with K = 0 the tool drifts. The
                    zero-order hold needs B above K dt / 2
                  a total lag t between force and motion turns a contact stiffness k into damping -k t, which B and
                    the contact's damping must exceed: t is 1.5 ticks, the filter's 1 / (2 pi cutoff) and the part of
                    the inner law's lag that `lead` does not compensate. This holds while sqrt(k / D) is below a
                    quarter of the drive's bandwidth; a smaller D may need twice that damping or more
                  without - J^T F_ext a hand would move the tool past the model, by (kp Lambda)^-1 F_ext

    With F_ext = 0 the energy of model="own" about a resting reference, V D V / 2 + X K X / 2, never grows, however
    long the tick; with it, by no more than F_ext does on the model. The measured wrench is a tick old, and
    `taut.Sensing(F_ext=taut.sensors.LowPass(...))` filters it. Integrating the measured state over a tick, as before
    eq. 10.31, would show D / (1 + kd dt) and B - kp dt D: model="measured" asks for the acceleration alone.

    Frames:
        frame= names the axes of D, B and K: "world", "task" (of the reference pose) or "tool". X is (p - p_ref, the
        rotation vector of R R_ref^T). F_ext is taken at the tool that is controlled.

    Args:
        inner: Follows a TaskMotion: `TaskComputedTorque`, or for drives `TaskVelocity`, `TaskPosition`.
        D: Virtual inertia: (linear, angular), (6,) or (6, 6).
        K: Stiffness; none if left out: the tool stays where it is led.
        B: Damping; or zeta.
        zeta: Damping ratio of every mode of D and K, in place of B.
        model: "own" or "measured".
        frame: Axes of D, B and K.
        error_max: (2,) largest offset that the spring answers [m, rad], smoothly; no bound if left out.
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
    D: Gain = task_gain(unit="kg, kg m^2", shape=6)
    K: Gain = task_gain((0.0, 0.0), unit="N/m, N m/rad", shape=6)
    B: Gain = task_gain(unit="N s/m, N m s/rad", shape=6, optional=True)
    zeta: Gain = Gain(unit="1", shape="scalar", optional=True)
    model: Choice[ModelKind] = Choice("own", "measured")
    frame: Choice[GainFrame] = Choice(*FRAMES)
    error_max: Gain = Gain(unit="m, rad", shape=2, accepts=("pair",), above=0.0, optional=True)
    tool: str | None = None

    def check(self) -> None:
        inner, tool = self.inner, self.inner.controlled_frame
        if inner.reference is not TaskMotion:
            follows = f"{type(inner).__name__} follows a {inner.reference.__name__}"
            self.refuse("inner", f"must be a law that follows a TaskMotion, such as TaskVelocity; {follows}")
        if tool != self.tool:
            self.refuse("tool", f"must be that of the inner law, {tool or 'the tool of the arm'}; got {self.tool}")
        check_damping(self, self.K, self.B, self.zeta, self.D)

    def check_rate(self, rate: float) -> None:
        D, B, K = (np.asarray(x, dtype=np.float64) for x in (self.D.matrix(6), self._damping(), self.K.matrix(6)))
        if self.model == "own":
            _check_own(D, B, K, rate)
        else:
            _check_measured(D, B, K, rate)

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_sensor(x, self.tool)

    def _damping(self) -> Matrix:
        return damping_matrix(self.D, self.K, self.zeta) if self.zeta is not None else self.B.matrix(6)

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

    def apparent_impedance(self, x: Snapshot) -> ApparentImpedance:
        return TaskSpace.of(self).at(x).impedance(self.D.matrix(6), self._damping(), self.K.matrix(6))

    def command(
        self, x: Snapshot, ref: TaskMotion, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        after: dict[str, object] = {}
        if self.model == "own":
            body = Body(p=memory.p, R=memory.R, twist=memory.twist)
            acceleration, new = integrated(self._model(), self.frame, body, ref, wrench_at(x, self.tool), dt)
            after |= {"p": new.p, "R": new.R, "twist": new.twist}
        else:
            T = x.T(self.tool)
            body = Body(p=T.p, R=T.R, twist=x.twist(self.tool))
            acceleration = answered(self._model(), self.frame, body, ref, wrench_at(x, self.tool))
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

    def _model(self) -> Model:
        return Model(
            D=self.D.matrix(6),
            B=self._damping(),
            K=self.K.matrix(6),
            bound=Bound.of(self.error_max) if self.error_max is not None else None,
            turning=self.frame == "tool",
        )


def _motion(body: Body, acceleration: Vector) -> TaskMotion:
    return TaskMotion.of({"p": body.p, "R": body.R, "twist": body.twist, "acceleration": acceleration})


# In the axes of one frame and about relative motion: X from the reference to the tool, (p - p_ref, log(R R_ref^T)),
# and U the velocity that belongs to it.


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Where the virtual mass is and how it moves; in world axes."""

    p: Vector3
    R: Rotation
    twist: Twist

    def offset(self, ref: TaskMotion) -> Twist:
        """(6,) X, from the reference to here [m, rad]."""
        return tm.array([*(self.p - ref.p), *rotation_log(self.R @ ref.R.T)])

    def velocity(self, ref: TaskMotion) -> Twist:
        """(6,) U, less that of the reference, which is carried along with the rotation from it [m/s, rad/s]."""
        return self.twist - self.carried(ref, ref.twist)

    def carried(self, ref: TaskMotion, rate: Twist) -> Twist:
        """A twist of the reference as the tool would have it if it were fixed to the reference at its offset."""
        return tm.array([*rate[:3], *(self.R @ (ref.R.T @ rate[3:]))])

    def acceleration(self, ref: TaskMotion, relative: Twist) -> Twist:
        """(6,) of the tool, from the rate of U."""
        turning = self.carried(ref, ref.twist)[3:]
        bent = tm.cross(self.velocity(ref)[3:], turning)
        return relative + self.carried(ref, ref.acceleration) + tm.array([0.0, 0.0, 0.0, *bent])


def moved(body: Body, ref: TaskMotion, mean: Twist, after: Twist, dt: Any) -> Body:
    """The body after a tick, from mean and end of U, beside a moving reference; a Newton step keeps R a rotation."""
    turn = rotation_exp(dt * mean[3:])
    step = ref.twist + 0.5 * dt * ref.acceleration
    carried = rotation_exp(dt * body.carried(ref, step)[3:])
    R = turn @ carried @ body.R
    R = 1.5 * R - 0.5 * (R @ (R.T @ R))
    end = ref.twist + dt * ref.acceleration
    turned = turn @ body.carried(ref, end)[3:]
    twist = after + tm.array([*end[:3], *turned])
    return Body(p=body.p + dt * (mean[:3] + step[:3]), R=R, twist=twist)


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """D U-dot + B U + A^T K X = F in the axes of D, B and K; A^T K X is the gradient of X . K X / 2, X-dot = A U."""

    D: Matrix  # (6, 6) [kg, kg m^2]
    B: Matrix  # (6, 6) [N s/m, N m s/rad]
    K: Matrix  # (6, 6) [N/m, N m/rad]
    bound: Bound | None = None  # of the spring
    turning: bool = False  # whether the axes are those of the tool, and turn with it

    def _rates(self, X: Twist) -> Matrix:
        """(6, 6) rate of X per U: the rotation vector's, and that of axes that turn under it."""
        A = tm.eye(6)
        inverse = left_jacobian_inverse(X[3:])
        A[3:, 3:] = inverse.T if self.turning else inverse
        if self.turning:
            A[:3, 3:] = tm.skew(X[:3])
        return A

    def pull(self, X: Twist) -> Wrench:
        """(6,) of the spring on the body [N, N m]."""
        force = self.K @ X if self.bound is None else self.bound.force(self.K, X)
        return pulled(-X, -force, turning=self.turning)

    def rate(self, X: Twist, U: Twist, F: Wrench) -> Twist:
        """(6,) U-dot = D^-1 (F - B U - K X), equation 10.50."""
        solved: Twist = tm.solve_spd(self.D, F - self.B @ U + self.pull(X))
        return solved

    def energy(self, X: Twist, U: Twist) -> Any:
        """[J] in the mass and the spring."""
        X = X if self.bound is None else self.bound.stretch(X)
        return 0.5 * (U @ (self.D @ U) + X @ (self.K @ X))

    def step(self, X: Twist, U: Twist, F: Wrench, dt: Any) -> Twist:
        """(6,) the mean of U over a tick, by the implicit midpoint rule; U after it is 2 mean - U.

        D (U+ - U) / dt = F - B mean - grad(X + mean dt / 2): the energy changes by at most dt (F . mean - mean . B
        mean).
        """
        A = self._rates(X)
        S = (2.0 / dt) * self.D + self.B + (0.5 * dt) * (A.T @ self.K @ A)
        mean: Twist = tm.solve_spd(S, (2.0 / dt) * (self.D @ U) + F + self.pull(X))
        return mean

    def share(self, allowed: Any, X: Twist, U: Twist) -> Any:
        """Fraction of U that leaves no more energy than allowed [J]; below zero where the spring alone has more."""
        spring = self.energy(X, tm.zeros(6))
        kinetic = self.energy(X, U) - spring
        moves = kinetic > 0.0
        share = tm.sqrt(tm.clip((allowed - spring) / tm.where(moves, kinetic, 1.0), 0.0, 1.0))
        return tm.where(spring > allowed * (1.0 + SOLVE_ROUNDING), -1.0, tm.where(moves, share, 1.0))


def damping_matrix(D: GainValue, K: GainValue, zeta: GainValue) -> Matrix:
    """(6, 6) the damping that gives every mode of (D, K) the ratio zeta; of diagonal ones 2 zeta sqrt(D K)."""
    z: Any = zeta.as_array()
    if D.ndim < 2 and K.ndim < 2:
        diagonal: Matrix = np.eye(6) * (2.0 * z * tm.sqrt(D.as_array() * K.as_array()))
        return diagonal
    factors, stiffness = tm.factor_spd(D.matrix(6)), K.matrix(6)
    return tm.stack([modal_damping(factors, stiffness, z, axis) for axis in np.eye(6)])


def _axes(frame: GainFrame, body: Body, ref: TaskMotion) -> Rotation | None:
    """R_WC of the axes of the gains; None stands for the world's."""
    return {"world": None, "task": ref.R, "tool": body.R}[frame]


def answered(model: Model, frame: GainFrame, body: Body, ref: TaskMotion, F: Wrench) -> Twist:
    """(6,) the acceleration of a body that the model would give it, world axes: equation 10.50."""
    R = _axes(frame, body, ref)
    X, U = inwards(R, body.offset(ref)), inwards(R, body.velocity(ref))
    return body.acceleration(ref, outwards(R, model.rate(X, U, inwards(R, F))))


def integrated(model: Model, frame: GainFrame, body: Body, ref: TaskMotion, F: Wrench, dt: Any) -> tuple[Twist, Body]:
    """(6,) mean acceleration over a tick under F (6,), world axes, and the body after it.

    Where D or K differ by direction the midpoint rule is off by the third order of dt: energy that it would create is
    taken from the velocity, or, where that is not enough, the body stays where it is.
    """
    R = _axes(frame, body, ref)
    X, U, F = (inwards(R, six) for six in (body.offset(ref), body.velocity(ref), F))
    mean = model.step(X, U, F, dt)
    allowed = model.energy(X, U) + dt * (F @ mean - mean @ (model.B @ mean))
    new = moved(body, ref, outwards(R, mean), outwards(R, 2.0 * mean - U), dt)
    beside = _later(ref, dt)
    R = _axes(frame, new, beside)
    share = model.share(allowed, inwards(R, new.offset(beside)), inwards(R, new.velocity(beside)))
    still = moved(body, ref, np.zeros(6), np.zeros(6), dt)
    stays = share < 0.0
    carried = new.carried(beside, beside.twist)
    twist = tm.where(stays, still.twist, carried + share * (new.twist - carried))
    p, turned = tm.where(stays, still.p, new.p), tm.where(stays, still.R, new.R)
    return (twist - body.twist) / dt, Body(p=p, R=turned, twist=twist)


def _later(ref: TaskMotion, dt: Any) -> TaskMotion:
    """A reference that goes on as it does, a tick later."""
    mean = ref.twist + 0.5 * dt * ref.acceleration
    return TaskMotion.of(
        {
            "p": ref.p + dt * mean[:3],
            "R": rotation_exp(dt * mean[3:]) @ ref.R,
            "twist": ref.twist + dt * ref.acceleration,
            "acceleration": ref.acceleration,
        }
    )


def _check_own(D: Float64Array, B: Float64Array, K: Float64Array, rate: float) -> None:
    """The model must be slower than the rate: D >= B dt / 2 + K dt^2 / 4, so that nothing reverses within a tick."""
    dt = 1.0 / rate
    L = np.linalg.cholesky(D)
    inverse = np.linalg.inv(L)
    most = float(np.linalg.eigvalsh(inverse @ (0.5 * dt * B + 0.25 * dt * dt * K) @ inverse.T)[-1])
    name, why = f"(B dt / 2 + K dt^2 / 4) / D at {rate:g} Hz", "or the virtual mass reverses within a tick"
    require_at_most(name, most, 1.0 + 1e-9, "1", f"{why}: make D larger, B and K smaller, or the rate higher")


def _check_measured(D: Float64Array, B: Float64Array, K: Float64Array, rate: float) -> None:
    """The loop of the chapter's form, sampled and held, must not grow."""
    dt = 1.0 / rate
    hold = np.vstack([0.5 * dt * dt * np.eye(6), dt * np.eye(6)])
    drift = np.block([[np.eye(6), dt * np.eye(6)], [np.zeros((6, 6)), np.eye(6)]])
    feedback = np.linalg.solve(D, np.hstack([K, B]))
    radius = float(np.abs(np.linalg.eigvals(drift - hold @ feedback)).max())
    name, why = f"the growth in a tick of model='measured' at {rate:g} Hz", "or the loop is unstable"
    require_at_most(name, radius, 1.0 + 1e-6, "1", f"{why}: B must be above K dt / 2 and well below 2 D / dt")
