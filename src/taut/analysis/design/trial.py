"""A design tried: steps of the sampled loop in each direction, by its linear model and simulated in full."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from taut import laws
from taut.analysis.design.asked import six_by_six
from taut.analysis.design.bandwidth import bandwidth_of, bandwidth_seen
from taut.analysis.design.coupled import Coupled
from taut.analysis.design.directions import Direction, designed_part, fed_forward
from taut.analysis.design.disturbed import runs_from
from taut.analysis.design.motion import Motion
from taut.arm.description import Arm
from taut.arm.friction import Friction
from taut.base.types import ArrayLike, Float64Array
from taut.control.law import Law
from taut.control.sensing.filters import LowPass
from taut.control.sensing.sensing import Sensing
from taut.control.sensing.velocity import Difference
from taut.control.trajectories.force_reference import TaskForce
from taut.control.trajectories.reference import Hold, JointMotion, Sample, as_reference
from taut.control.trajectories.task_reference import TaskMotion
from taut.controller import Controller, compile
from taut.linear.error_dynamics import ErrorDynamics
from taut.linear.linear_loop import LinearLoop
from taut.linear.linearise import linearise, rest_of
from taut.linear.loop_map import Point, finite_derivative, loop_map, starting
from taut.linear.sampled import VelocityKind
from taut.linear.second_order_response import zeta_of_overshoot
from taut.loop import DT, Loop
from taut.maths.adds import Adds
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotation_exp
from taut.plant.drives.actuation import Actuation
from taut.plant.environments.push import Push
from taut.plant.environments.springs import Spring
from taut.plant.rigid import RigidPlant
from taut.record.run import Run
from taut.record.step import step_response
from taut.runtime.simulate import run as simulate
from taut.trace.pose import Pose

__all__ = ["ANYWHERE", "Bench", "Numbers", "Response", "numbers_of_poles", "zeta_seen"]

ANYWHERE: Final = 1e3  # [rad | m] from the reference: an equilibrium is taken wherever it is
SMALL: Final = 1e-4  # [m | rad] a step for which a loop is as good as linear
DRIVE: Final = 1e4  # [rad/s] of drives that are as good as ideal
LONGER: Final = 2.5  # times the settling time that was designed for
WHOLE: Final = 1.2  # times that: the least that shows where an error settles
SHORTEST, LONGEST = 30, 40_000  # ticks
ROUNDING: Final = 1e-9  # of a pole: a smaller imaginary part is none
PAIRED: Final = 1e-6  # of a pole: as near is its conjugate
HELD: Final = 1e-9  # of the step: below it an error is rounding
ENDS: Final = 0.9  # of a step's run: an error that is least after it falls all the time
FAINT: Final = 1e-6  # of the largest singular value: below it a drive's own pole is not told from rounding
SEEN: Final = 0.1  # [%] of overshoot that tells a damping ratio
NOTHING: Final = np.zeros(6)
REFERENCES: Final[dict[type[Sample], tuple[str, ...]]] = {JointMotion: ("ref.q",), TaskForce: ("ref.F_world",)}


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """How an error dies away; NaN where that has no meaning, infinite where it does not.

    Args:
        zeta: Damping ratio, of the slowest pair; 1 for a single pole.
        omega_n: Natural frequency of that pair, or the pole [rad/s].
        overshoot: Of a step [%].
        settling: Exact 2 % settling time of a step [s].
        bandwidth: Where a sine of the reference is first followed with half of the power [rad/s].
    """

    zeta: float
    omega_n: float
    overshoot: float
    settling: float
    bandwidth: float = math.nan

    @classmethod
    def designed(cls, dynamics: ErrorDynamics) -> Numbers:
        """In continuous time."""
        zeta, omega_n = numbers_of_poles(dynamics.poles)
        return cls(
            zeta=zeta, omega_n=omega_n, overshoot=dynamics.overshoot, settling=dynamics.settling_time,
            bandwidth=bandwidth_of(dynamics),
        )  # fmt: skip


def numbers_of_poles(s: Any) -> tuple[float, float]:
    """Damping ratio and natural frequency: of the slowest complex pair, else of the slowest two poles.

    Of one pole they are 1 and its rate. A pole of a sampled loop that changes its sign from tick to tick has no
    partner; it counts as one that swings where it is the slowest.
    """
    s = np.asarray(s, dtype=np.complex128)
    s = s[np.argsort(-s.real)]
    bent = np.abs(s.imag) > ROUNDING * np.abs(s)
    paired = np.array([bent[k] and np.any(np.abs(s - s[k].conjugate()) < PAIRED * abs(s[k])) for k in range(len(s))])
    paired[:1] |= bent[:1]
    if paired.any():
        pole = complex(s[np.argmax(paired)])
        return float(-pole.real / abs(pole)), abs(pole)
    rates = -s.real[:2]
    if len(rates) == 1:
        return 1.0, float(abs(rates[0]))
    product = float(np.prod(rates))
    if product <= 0.0:
        return math.nan, math.nan
    return float(rates.sum() / (2.0 * math.sqrt(product))), math.sqrt(product)


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """What a step of the reference in one direction does.

    Args:
        t: (k,) [s].
        e: (k,) the error along it, of a step of 1.
        e_dot: (k,) its rate.
        q: (k, n) the joints, for a step of 1.
        v: (k, n) their speeds, likewise.
        command: (k, n) what is commanded, less what holds the arm, likewise.
        integral: Whether the law integrates the error.
        second: Whether the rate of the error is a state.
        pushed: (k,) what is commanded along it.
        late: How many commands before a tick count in it: under way, or for what is measured a tick late.
        kept: How many numbers a filter of the velocity keeps.
        order: Of the error dynamics that were designed.
        whole: Whether it was followed for as long as what was designed takes to settle.
        summed: (k,) the integral of the error, where it is known to be more than the sum over the ticks.
        swings: Whether drives follow a swing of the law's own, of which the command of a tick is a state.
    """

    t: Float64Array
    e: Float64Array
    e_dot: Float64Array
    q: Float64Array
    v: Float64Array
    command: Float64Array
    integral: bool
    second: bool
    pushed: Float64Array
    late: int
    kept: int
    order: int
    whole: bool
    summed: Float64Array | None = None
    swings: bool = False

    @property
    def numbers(self) -> Numbers:
        """What fits it."""
        zeta, omega_n = numbers_of_poles(self.poles) if np.isfinite(self.e).all() else (math.nan, math.nan)
        step = step_response(self.t, self.e)
        creeps = np.isfinite(self.e).all() and int(np.argmin(self.e)) >= ENDS * len(self.e)
        overshoot = 0.0 if creeps else step.overshoot
        return Numbers(
            zeta=zeta, omega_n=omega_n, overshoot=overshoot if self.whole else math.nan,
            settling=step.settling_time if self.whole else math.nan,
            bandwidth=bandwidth_seen(1.0 - self.e, float(self.t[1])),
        )  # fmt: skip

    @property
    def poles(self) -> Any:
        """[1/s] as many as were designed, the slowest: of the map from tick to tick that fits all its states.

        These are error, rate, integral, and the commands that are under way or in a filter; by least squares.
        """
        dt = float(self.t[1])
        states = [self.e]
        if self.second:
            states.append(self.e_dot * dt)
        if self.integral:
            states.append(np.concatenate([[0.0], np.cumsum(self.e)[:-1]]) if self.summed is None else self.summed)
        lags = range(0 if self.swings else 1, self.late + self.kept + 1)  # a filter shows in the commands before
        states += [np.concatenate([np.zeros(lag), self.pushed[: len(self.pushed) - lag]]) for lag in lags]
        unknown = self.late + 2 if self.swings else 0  # ticks, till the first command of the law has moved the arm
        X = np.column_stack(states)[self.kept + unknown :]
        if lags:
            X = np.diff(X, axis=0)  # what is commanded in the end, against a weight or a spring, is no state
        live = int(np.flatnonzero(np.abs(self.e) > HELD)[-1]) + 1 if np.any(np.abs(self.e) > HELD) else len(X)
        X = X[: max(min(live, len(X)), len(states) + 3)]
        scale = np.abs(X).max(axis=0)
        X = X / np.where(scale > 0.0, scale, 1.0)
        A, *_ = np.linalg.lstsq(X[:-1], X[1:], rcond=FAINT if self.swings else None)
        if len(A) == 2 and not lags:
            return _pair(float(np.trace(A)), float(np.linalg.det(A)), dt)
        z = np.linalg.eigvals(A).astype(np.complex128)
        z = z[np.argsort(-np.abs(z))]
        last = z[min(self.order, len(z)) - 1]
        with np.errstate(divide="ignore"):
            return np.log(z[np.abs(z) >= np.abs(last) * (1.0 - PAIRED)]) / dt


def _pair(trace: float, det: float, dt: float) -> Any:
    """log(z) / dt of z^2 - trace z + det, well conditioned where the two meet."""
    if det <= 0.0:
        with np.errstate(divide="ignore"):
            return np.log(np.roots([1.0, -trace, det]).astype(np.complex128)) / dt
    cosine = 0.5 * trace / math.sqrt(det)
    sigma = -0.5 * math.log(det) / dt
    turn = np.arccos(complex(cosine)) / dt
    return np.array([-sigma + 1j * turn, -sigma - 1j * turn])


class Bench:
    """A law on its arm, to be tried: compiled once, in the plant that the design is for.

    All is about the equilibrium of the sampled loop under the arm's weight, which a law without gravity compensation
    has elsewhere than at its reference; a plant that adds gravity itself carries the weight here too.

    Args:
        law: With its gains.
        arm: The arm.
        rate: [Hz].
        delay: [s] whole periods from the tick to the torque.
        velocity: How velocity is measured.
        friction: "arm" or None.
        at: Where it is tried.
        contact: Stiffness of a spring that holds the tool where it starts, for laws of force.
        like: A plant whose integrator moves the arm, and which may carry its weight; None for the exact hold, an arm
            that moves all the time.
    """

    def __init__(
        self,
        law: Law,
        arm: Arm,
        *,
        rate: float,
        delay: float,
        velocity: VelocityKind,
        friction: Literal["arm"] | None,
        at: tuple[Snapshot, ...],
        contact: ArrayLike | None = None,
        like: RigidPlant | None = None,
    ) -> None:
        self.law = designed_part(law) if _alone(law) else law
        sensing = Sensing() if velocity == "measured" else Sensing(velocity=velocity)
        self._rate, self._sensing, self._late = rate, sensing, round(delay * rate)
        filtered = isinstance(velocity, (LowPass, Difference)) and velocity.cutoff is not None
        self._kept: int = velocity.order if filtered and not isinstance(velocity, str) else 0
        if self.law.reference is TaskForce:
            self._late += 1  # what is measured is a tick old
        self.carried = like is not None and Adds.of(like.adds).gravity
        adds = ("gravity",) if self.carried else ()
        self.ctrl: Controller = compile(self.law, arm, rate=rate, sensing=sensing, adds=adds)
        probe = self.ctrl.side.probe
        self.kind, self.arm = probe.kind, arm
        self.uncompensated = (
            probe.kind == "torque" and not self.carried and ("gravity" not in probe.used or fed_forward(self.law))
        )
        drives = Actuation(delay=delay, bandwidth=None if probe.kind == "torque" else DRIVE)
        self.contact = None if contact is None else six_by_six("contact", contact)
        felt: Any = Push(peak=NOTHING, duration=1.0) if "F_ext" in self.ctrl.needs else None
        if self.contact is not None:
            felt = Spring(stiffness=self.contact)
        rubbed = self.arm.with_friction(Friction(viscous=self.arm.viscous if friction else 0.0))
        driven = probe.kind != "torque"
        self.motion = Motion.like(like, rubbed, at, 1.0 / rate, self.contact, driven=driven)
        self.plant = RigidPlant(
            self.arm if driven else rubbed,
            friction="arm" if driven else friction,
            takes=probe.kind,  # type: ignore[arg-type]  # the kinds of commands are those of plants
            actuation=drives,
            environment=felt,
            adds=adds,
            integrator=self.motion.integrator,
            substeps=self.motion.substeps,
        )
        if not isinstance(velocity, LowPass) and velocity != "measured" and not self.motion.one_step:
            self._late += 1  # the torque of the tick before, which bends the way that is differenced
        self.swings = driven and isinstance(self.law, laws.Admittance)
        self.loop = Loop(self.ctrl, self.plant, duration=1.0)
        self.integral = any(
            np.any(value) for path, value in self.law.parameters().items() if path.rpartition(".")[2] in ("ki", "kfi")
        )

    def for_plant(self, arm: Arm, plant: RigidPlant) -> Controller:
        """The same controller for a plant of its own, its weight included."""
        return compile(self.law, arm, rate=self._rate, sensing=self._sensing, adds=plant.adds)

    def set_gains(self, law: Law) -> None:
        """The same law with other gains of the same shapes."""
        self.law = designed_part(law) if _alone(law) else law
        for path, value in self.law.parameters().items():
            self.loop.parameters[f"law.{path}"] = value

    def linear(self, q: Float64Array) -> LinearLoop:
        """The linear model about the equilibrium with the reference at a pose."""
        self.loop.ref, self.loop.duration = Hold(), 1.0
        return linearise(self.loop, at=q, within=ANYWHERE)

    def resting(self, q: Float64Array) -> Point:
        """That equilibrium itself."""
        self.loop.ref, self.loop.duration = Hold(), 1.0
        return rest_of(self.loop, loop_map(self.loop), q, ANYWHERE).point

    def radius_at(self, rest: Point, lin: LinearLoop, rate: float) -> float:
        """The largest modulus of a pole of the loop about an equilibrium, at another rate with the same gains."""
        map_, parameters = loop_map(self.loop), rest.parameters.copy()
        map_.parameters.views(parameters)[DT][...] = 1.0 / rate
        found = finite_derivative(map_, dataclasses.replace(rest, parameters=parameters))
        keep = [map_.state_coordinates.names.index(name) for name in lin.states]
        return float(np.abs(np.linalg.eigvals(found.A[np.ix_(keep, keep)])).max())

    def ticks(self, directions: tuple[Direction, ...]) -> int:
        """How many ticks show all of them settle."""
        longest = max((d.settling for d in directions), default=0.0)
        wanted = LONGER * longest * self.ctrl.rate if math.isfinite(longest) else 1000.0
        return int(np.clip(wanted, SHORTEST, LONGEST))

    def designed(self, directions: tuple[Direction, ...]) -> tuple[Numbers, ...]:
        """In continuous time; where directions are coupled, what fits the steps of all joints, read at the ticks."""
        ticks, dt = self.ticks(directions), 1.0 / self.ctrl.rate
        return tuple(
            Numbers.designed(d.dynamics) if d.coupled is None else _of_coupled(d, d.coupled, dt, ticks).numbers
            for d in directions
        )

    def predicted(self, lin: LinearLoop, x: Snapshot, directions: tuple[Direction, ...]) -> tuple[Response, ...]:
        """Steps of the linear model."""
        if not directions:
            return ()
        ticks, n = self.ticks(directions), x.n
        B, D = self._of_reference(lin)
        U = np.array([self._moved(x, d) for d in directions]).T  # (m, directions)
        state = np.zeros((len(lin.states), len(directions)))
        places = {name: list(lin.rows(name)) for name in ("q", "v", "command")}
        out = {name: np.zeros((ticks + 1, n, len(directions))) for name in places}
        for k in range(ticks + 1):
            y = lin.C @ state + D @ U
            for name, rows in places.items():
                out[name][k] = y[rows]
            state = lin.A @ state + B @ U
        t = np.linspace(0.0, ticks * lin.dt, ticks + 1)
        return tuple(
            self._response(d, t, out["q"][:, :, i], out["v"][:, :, i], out["command"][:, :, i])
            for i, d in enumerate(directions)
        )

    def simulated(self, q: Float64Array, x: Snapshot, directions: tuple[Direction, ...]) -> tuple[Response, ...]:
        """Small steps of the whole nonlinear loop from where it rests, less what it does there without one."""
        ticks, rest, inputs = self.ticks(directions), self.resting(q), []
        for d in directions:
            self.loop.ref = as_reference(self._target(q, x, d, SMALL))
            inputs.append(starting(self.loop, loop_map(self.loop), q).inputs)
        without, *seen = runs_from(self.loop, rest, [rest.inputs, *inputs], ticks + 1)
        t = np.linspace(0.0, ticks / self.ctrl.rate, ticks + 1)
        return tuple(
            self._response(d, t, *((run[name] - without[name]) / SMALL for name in ("q", "v", "command")))
            for d, run in zip(directions, seen, strict=True)
        )

    def step(self, loop: Loop, q: Float64Array, x: Snapshot, direction: Direction, size: float, ticks: int) -> Run:
        """A step of the reference from a pose, of an arm at rest where the weight takes it there."""
        loop.ref = as_reference(self._target(q, x, direction, size))
        loop.duration = ticks / self.ctrl.rate
        return simulate(loop, q0=x.q, progress=False)

    def _response(
        self, d: Direction, t: Float64Array, q: Float64Array, v: Float64Array, command: Float64Array
    ) -> Response:
        return Response(
            t=t, e=1.0 - q @ d.row, e_dot=-(v @ d.row), q=q, v=v, command=command, integral=self.integral,
            second=self.kind == "torque" or self.swings,
            pushed=command @ (d.column if self.kind == "torque" else d.row),
            late=self._late, kept=self._kept, order=d.dynamics.order,
            whole=_whole(d, t), swings=self.swings,
        )  # fmt: skip

    def _of_reference(self, lin: LinearLoop) -> tuple[Float64Array, Float64Array]:
        names: tuple[str, ...] = ("ref.p", "ref.rotation")
        if self.law.reference in REFERENCES:
            names = REFERENCES[self.law.reference]
        columns = [i for name in names for i in lin.columns(name)]
        return lin.B[:, columns], lin.D[:, columns]

    def _moved(self, x: Snapshot, d: Direction) -> Float64Array:
        """How the reference goes along a direction: joints, or the tool in world axes."""
        if self.law.reference is JointMotion:
            return d.column if d.step is None else d.step
        if self.law.reference is TaskForce:
            return self._pressed(x, d)
        return np.asarray(x.J(self.law.controlled_frame) @ d.column)

    def _pressed(self, x: Snapshot, d: Direction) -> Float64Array:
        """(6,) the wrench that holds the contact's spring where a motion of 1 along a direction takes it."""
        way = np.asarray(x.J(self.law.controlled_frame) @ d.column)
        assert self.contact is not None
        return np.asarray(self.contact @ way)

    def _target(self, q: Float64Array, x: Snapshot, d: Direction, size: float) -> Sample:
        moved = size * self._moved(x, d)
        if self.law.reference is TaskForce:
            return TaskForce(F_app=moved)
        if self.law.reference is JointMotion:
            return JointMotion(q=q + moved)
        T = x.T(self.law.controlled_frame)
        turn = np.asarray(rotation_exp(moved[3:]), dtype=np.float64)
        return TaskMotion(pose=Pose.of(turn @ np.asarray(T.R), np.asarray(T.p) + moved[:3]))


def _whole(d: Direction, t: Float64Array) -> bool:
    return not t[-1] < WHOLE * d.settling < math.inf


def _of_coupled(d: Direction, coupled: Coupled, dt: float, ticks: int) -> Response:
    """A step in continuous time along a direction that others go along with."""
    t, none = np.linspace(0.0, ticks * dt, ticks + 1), np.zeros((ticks + 1, len(d.row)))
    e, e_dot, summed = (rows @ d.row for rows in coupled.response(d.column, dt, ticks))
    return Response(
        t=t, e=e, e_dot=e_dot, q=none, v=none, command=none, integral=bool(np.any(coupled.Ki)), second=True,
        pushed=none[:, 0], late=0, kept=0, order=d.dynamics.order, whole=_whole(d, t), summed=summed,
    )  # fmt: skip


def zeta_seen(run: Run, x: Snapshot, d: Direction, size: float) -> Numbers:
    """What a step did on a plant with whatever is wrong with it: damping by its overshoot, where it has one."""
    e = 1.0 - (run.q - x.q) @ d.row / size
    if not run.outcome.ok or not np.isfinite(e).all():
        return Numbers(zeta=math.nan, omega_n=math.nan, overshoot=math.nan, settling=math.inf)
    seen = step_response(run.t, e)
    zeta = zeta_of_overshoot(seen.overshoot) if SEEN < seen.overshoot < 100.0 else math.nan
    return Numbers(zeta=zeta, omega_n=math.nan, overshoot=seen.overshoot, settling=seen.settling_time)


def _alone(law: Law) -> bool:
    """Whether the part that is designed is tried without what holds it."""
    part = designed_part(law)
    return (
        part is not law and len(law.children()) != 0 and type(law).__name__ in ("ViaJointSpace", "HybridMotionForce")
    )
