"""Judgement of a sampled loop: stability, distance from its limit, least stable direction, and the gains to blame.

The map of one period is the compiled loop that simulates it, differentiated by central differences, without limits,
noise, quantisation and dry friction, which has no slope in sliding and hides instability only until a joint breaks
free.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from taut.base.errors import RangeError, TautError, UsageError
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.control.combine import all_laws
from taut.control.gains import Gain
from taut.control.laws.joint import FrictionCompensation
from taut.control.laws.other_topics.adaptive import Adaptive
from taut.control.lawside import LawSide
from taut.linear.linear_system import Complex, LinearSystem, Mode, balancing
from taut.linear.linearise import NEWTON_STEPS, acting_states, equilibrium, pose_at
from taut.linear.period import EMPTY, STEP, Derivative, Period, Point, model_in_place_of
from taut.loop import AnyPlant, HasLawSide, Loop
from taut.maths.snapshot import snapshot

ROUNDING: Final = 1e-9  # [-] of a modulus of one
MIN_MOBILITY: Final = 1e-9  # [-] of the largest mobility of the tool: an axis with less does not move
FINE: Final = 0.01  # [-] of the largest stable factor on a gain
MIN_FACTOR, MAX_FACTOR = 2.0**-14, 2.0**14  # [-] on a gain, between which a limit is searched
DIGITS: Final = 3  # of a factor, and of a gain times it, rounded down: what is printed is no more than what was tried
SHOWN: Final = 0.2  # [-] the smallest fraction of a mode that a sentence names
MORE_STEPS: Final = 20  # of Newton's method from an equilibrium to that of other gains
HUGE: Final = 1e12  # a limit that is never reached
DRY: Final = ("coulomb", "static", "load_motor", "load_external", "load_motor_static", "load_external_static")
VISCOUS: Final = "plant.friction.viscous"
EFFICIENCY: Final = "actuation.transmission.efficiency"
OBSERVER: Final = "sensing.observer.bandwidth"
OBSERVER_WIDTH: Final = "sensing.observer.width"
RIPPLE: Final = "actuation.ripple.amplitude"
AXES: Final = tuple(f"{kind} {axis}" for kind in ("translation", "rotation") for axis in "xyz")

Changes = Mapping[str, Any]
"""Parameters by path that differ from those of the loop."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement(Result):
    """Stability of a sampled loop about its equilibrium next to a start pose; no limits, dry friction or ripple.

    A motor's ripple makes many equilibria close to one another, every other one unstable: motion passes them.

    Args:
        system: The linear model from tick to tick, of the states on which the joints' motion depends.
        stable: Whether deviations do not grow, within the error of central differences.
        decay_rate: Slowest decay of what does not stay where it is put [1/s]; negative for growth.
        joints: Fraction of each joint in the least stable mode, by name, the largest first; empty for a stable run.
        tool: Fraction of each axis of the tool in it, by kinetic energy (world axes), likewise.
        largest: Largest factor on a gain, by path, with which the loop is stable, others unchanged. Of an unstable
            loop for all gains with such a factor ("law": on all of them, where only that helps), of a stable loop for
            those asked for; infinite without a limit.
        gains: The gains of `largest`, by path.
        relies_on: Friction of the plant that keeps deviations from growing: viscous friction without which a stable
            loop is unstable; dry friction that holds an unstable loop while it is at rest.
        plant: Name of the plant.
    """

    system: LinearSystem
    stable: bool
    decay_rate: float
    joints: Mapping[str, float]
    tool: Mapping[str, float]
    largest: Mapping[str, float]
    gains: Mapping[str, Float64Array]
    relies_on: tuple[str, ...]
    plant: str

    @property
    def radius(self) -> float:
        """Spectral radius of the one-period map [-]."""
        return self.system.radius

    @property
    def direction(self) -> str:
        """The least stable mode in words: joints and axes of the tool with more than 20 % of it."""
        joints = ", ".join(f"'{name}'" for name, part in self.joints.items() if part >= SHOWN)
        tool = ", ".join(name for name, part in self.tool.items() if part >= SHOWN)
        return (f"joint {joints}" + (f" (tool: {tool})" if tool else "")) if joints else "the law's memory"

    @property
    def message(self) -> str:
        """The verdict and the remedy in one sentence."""
        where = f"at the start pose, judged with {self.plant} at {1.0 / self.system.period:g} Hz"
        friction = " and ".join(self.relies_on)
        if self.stable:
            return f"the sampled loop is stable {where}" + (f"; it relies on {friction}" if friction else "")
        hidden = f"; {friction} hides it at rest" if friction else ""
        growth = f"deviations of {self.direction} grow with {-self.decay_rate:.3g} 1/s"
        radius = f"(spectral radius {self.radius:.6g})"
        return f"the sampled loop is unstable {where}: {growth} {radius}{hidden}; {self._remedy}"

    @property
    def _remedy(self) -> str:
        if not self.largest:
            return "no smaller gain that was tried makes it stable; change the law, its gains or the rate"
        if "law" in self.largest:
            return f"lowering one gain alone does not make it stable; multiplying all by {self.largest['law']:g} does"
        gains = " or ".join(f"{path} = {_times(x, self.gains[path])}" for path, x in self.largest.items())
        return f"the largest gain that is stable is {gains}, the others as they are; use less, or a higher rate"

    def content(self) -> Content:
        """The verdict, the least stable mode and the largest stable gains."""
        numbers = {
            ("least stable mode by joint", "joint", "fraction [-]"): self.joints,
            ("least stable mode by axis of the tool", "axis", "fraction [-]"): self.tool,
            ("largest stable factors", "gain", "factor [-]"): self.largest,
        }
        return Content(
            title="judgement of the sampled loop",
            summary=(self.message,) if self.stable else (),
            faults=() if self.stable else (self.message,),
            tables=[
                Table(title=title, columns=columns, rows=[*parts.items()])
                for (title, *columns), parts in numbers.items()
                if parts
            ],
        )


def judge(loop: Loop, *, at: ArrayLike | None = None, gains: Iterable[str] = ()) -> Judgement:
    """Judge a sampled loop about the equilibrium next to a start pose, its reference held there.

    Law:    x[k+1] = f(x[k]), A = df/dx where f(x) = x; stable where no eigenvalue of A is outside the unit circle

    Args:
        loop: The loop, with its present parameters.
        at: (n,) start pose [rad | m]; home if left out.
        gains: Paths of gains whose largest stable factor is found of a stable loop too.

    Raises:
        RangeError: No equilibrium near, or a map without a derivative.
        UsageError: A command that depends on nothing measured.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint").with_friction(taut.Friction())
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=100.0, kd=2000.0), arm)
        >>> found = taut.analysis.judge(taut.Loop(ctrl, taut.RigidPlant(arm), duration=1.0))
        >>> found.stable, [*found.largest]
        (False, ['law.kd'])
    """
    return _judged_at(loop, loop.plant, pose_at(loop, at), EMPTY, tuple(gains))


def judge_start(
    ctrl: HasLawSide, plant: AnyPlant, q: Float64Array, changes: Changes = EMPTY, *, phase: int = 0
) -> Judgement | str:
    """The judgement of a run at its start q (n,), or a sentence why there is none.

    An engine or a robot is judged with a model plant of the same arm; `changes` are parameters of events at t = 0.
    Of a task it is that of the first phase, or of another one, which then begins at q.
    """
    if ctrl.engine != "native":
        return "not judged: plain Python is for debugging, and the loop is judged where it is compiled"
    values = {**plant.parameters, **ctrl.parameters, **changes}
    key = q.tobytes(), tuple((path, np.asarray(value).tobytes()) for path, value in values.items())
    if isinstance(ctrl, Loop) and ctrl.kept.verdict is not None and ctrl.kept.verdict[0] == key:
        known: Judgement | str = ctrl.kept.verdict[1]
        return known
    try:
        verdict: Judgement | str = _judged_at(ctrl, plant, q, changes, phase=phase)
    except (TautError, np.linalg.LinAlgError) as error:
        verdict = f"not judged: {error}"
    if isinstance(ctrl, Loop):
        ctrl.kept.verdict = key, verdict  # a loop that runs again as it was is not judged again
    return verdict


def _judged_at(
    ctrl: HasLawSide, plant: AnyPlant, q: Float64Array, changes: Changes, limits: tuple[str, ...] | None = None,
    *, phase: int = 0,
) -> Judgement:  # fmt: skip
    """The judgement of a loop, or of a controller with a model plant in place of its plant."""
    loop, name = (ctrl, plant.name) if isinstance(ctrl, Loop) else (_model_loop(ctrl, plant), "")
    changes = {path: value for path, value in changes.items() if path in loop.parameters}
    if not name:
        name = plant.name if plant.name == loop.plant.name else f"{loop.plant.name} in place of {plant.name}"
    with np.errstate(all="ignore"):  # numbers that no float can hold are refused where a run meets them
        return _judged(Period(loop, q, changes, phase), name, limits)


# One for each plant, so that a controller which runs again on it is not traced again; a loop does not hold its key.
_LOOPS: Final[WeakKeyDictionary[AnyPlant, Loop]] = WeakKeyDictionary()


def _model_loop(ctrl: HasLawSide, plant: AnyPlant) -> Loop:
    """The loop of the same controller with a model plant, and the same parameters."""
    side = ctrl.side
    try:
        loop = _LOOPS.get(plant)
    except TypeError:  # a plant of the user's own that has no hash
        loop = None
    if loop is None or loop.side is not side:
        loop = Loop(ctrl, model_in_place_of(plant, side), duration=side.dt)
        with contextlib.suppress(TypeError):
            _LOOPS[plant] = loop
    for path, value in {**plant.parameters, **ctrl.parameters}.items():
        if path in loop.parameters:
            loop.parameters[path] = value
    return loop


def uncertain_eigenvalues(A: Float64Array, error: Float64Array | float = 0.0) -> tuple[Complex, Float64Array]:
    """(n,) eigenvalues of the derivative of a period, and how far each is uncertain by the error and by rounding.

    To first order |dz| <= |y| |dA| |x| with left and right eigenvectors y and x; equal eigenvalues move farther, as a
    sample of such errors shows.
    """
    scale = balancing(A)
    A, error = (X * scale / scale[:, np.newaxis] for X in (A, error * np.ones_like(A)))
    z, right = np.linalg.eig(A)
    error = error + np.finfo(float).eps / STEP * max(1.0, float(np.abs(A).max()))
    first = np.sum(np.abs(np.linalg.pinv(right)) * (error @ np.abs(right)).T, axis=1)
    sample = np.linalg.eigvals(A + error * np.random.default_rng(0).uniform(-1.0, 1.0, A.shape))
    moved = np.abs(z[:, np.newaxis] - sample).min(axis=1)
    return z.astype(np.complex128), ROUNDING + np.minimum(first, np.sqrt(np.linalg.norm(error, 2))) + 2.0 * moved


@dataclass(frozen=True, kw_only=True, eq=False)
class _Model:
    """The derivative of a period at its equilibrium, of some states."""

    found: Derivative
    A: Float64Array  # (n, n) of the states
    states: NDArray[np.intp]  # (n,) their places among the period's
    z: Complex  # (n,) eigenvalues
    slack: Float64Array  # (n,) uncertainty of each by the error of A

    @classmethod
    def at(cls, period: Period, start: Point, steps: int = NEWTON_STEPS) -> _Model:
        """At the equilibrium next to a start, by central differences of two steps (Richardson)."""
        found, coordinates = equilibrium(period, start, steps=steps), period.state_coordinates
        acting = acting_states(found, period.tolerance)
        for path in ("plant.q", "plant.v"):
            acting[coordinates.places[path]] = True
        states = np.flatnonzero(acting)
        block = np.ix_(states, states)
        near, far = found.A[block], period.derivative(found.at, 2.0 * STEP).A[block]
        A = (4.0 * near - far) / 3.0
        z, slack = uncertain_eigenvalues(A, error=np.abs(near - far))
        return cls(found=found, A=A, states=states, z=z, slack=slack)

    @property
    def grows(self) -> bool:
        """Whether a deviation grows for certain."""
        return bool((np.abs(self.z) > 1.0 + self.slack).any())

    def worst(self, system: LinearSystem) -> Mode:
        """The least stable mode; a position that stays where it is put only where there is no other."""

        def moves(mode: Mode) -> bool:
            return bool(abs(mode.pole - 1.0) > self.slack[np.argmin(np.abs(self.z - mode.pole))])

        return next(filter(moves, system.modes), system.modes[0])


def _judged(period: Period, plant: str, limits: tuple[str, ...] | None = None) -> Judgement:
    """The judgement; without the direction of a stable mode, and without limits of gains, where `limits` is None."""
    values = period.values(period.start)
    left_out = without_dry_friction(period.side, values)
    start = period.changed(period.start, left_out)
    begun = period.after(start, start.memory)  # memories that begin in the first tick have begun
    model = _Model.at(period, dataclasses.replace(start, memory=begun))
    coordinates, point = period.state_coordinates, model.found.at
    nearby = point.memory + STEP * coordinates.basis(point.memory).sum(axis=0)
    if np.array_equal(period.command(point), period.command(dataclasses.replace(point, memory=nearby))):
        raise UsageError("nothing that is measured changes the command")
    elsewhere = period.after(point, nearby)
    stable, n = not model.grows, period.arm.n

    acting = period.only(model.states)  # a gain times a number makes no other state act

    def stable_with(changed: Changes, period: Period = period) -> bool:
        other = period.changed(point, {**left_out, **changed})
        if np.array_equal(period.after(other, nearby), elsewhere):
            return stable  # the gains of a phase that does not act, say
        try:
            return not _Model.at(period, other, MORE_STEPS).grows
        except RangeError:
            return False

    def largest(*paths: str) -> float:
        def holds(factor: float) -> bool:
            return stable if factor == 1.0 else stable_with({path: factor * values[path] for path in paths}, acting)

        return float(_rounded_down(largest_factor(holds, FINE, MAX_FACTOR)))

    names = coordinates.names
    system = LinearSystem(
        A=model.A, C=model.found.C[:, model.states], dt=period.dt, states=[names[i] for i in model.states],
        outputs=[f"{name}[{i}]" for name in ("q", "v", "command") for i in range(n)],
    )  # fmt: skip
    worst = model.worst(system)
    joints: Mapping[str, float] = {}
    tool: Mapping[str, float] = {}
    if limits is not None or not stable:
        x = snapshot(period.arm, coordinates.numbers(point.memory)[coordinates.places["plant.q"]])
        joints, tool = directions(system, worst, period.arm.joint_names, np.asarray(x.M), np.asarray(x.J()))
    gains, relies_on = _gains(period.side, values), ""
    if stable:
        factors = {path: largest(path) for path in limits or ()}
        if np.any(values.get(VISCOUS, 0.0)) and not stable_with({VISCOUS: np.zeros_like(values[VISCOUS])}):
            relies_on = "the viscous friction of the joints"
    else:
        factors = {path: factor for path in gains if (factor := largest(path))}
        if not factors and len(gains) > 1 and (factor := largest(*gains)):
            factors = {"law": factor}
        dry = {path: values[path] for path in left_out if _is_dry(path)}
        if any(np.any(dry[path] != left_out[path]) for path in dry) and stable_with(dry):
            relies_on = "dry friction"
    return Judgement(
        system=system,
        stable=stable,
        decay_rate=-worst.s.real,
        joints=joints,
        tool=tool,
        largest=factors,
        gains={path: values[path] for path in factors if path != "law"},
        relies_on=(relies_on,) if relies_on else (),
        plant=plant,
    )


def without_dry_friction(side: LawSide, values: Changes) -> dict[str, Any]:
    """Parameters that leave limits, dry friction, that of its compensation too, and ripple out of a loop.

    Estimates of an adaptive law stay as they are: of the many equilibria with others none is the one to judge.
    """
    out = {path: np.full_like(values[path], path == EFFICIENCY) for path in values if _is_dry(path)}
    if RIPPLE in values:
        out[RIPPLE] = np.zeros_like(values[RIPPLE])
    out |= {f"limits.{name}": HUGE for name in ("tau", "tau_dot", "v") if f"limits.{name}" in values}
    out |= {OBSERVER_WIDTH: HUGE} if OBSERVER_WIDTH in values else {}
    for path, law in all_laws(side.law, "law"):
        if isinstance(law, FrictionCompensation):
            out[f"{path}.width"] = HUGE
        if isinstance(law, Adaptive):
            out |= {f"{path}.{name}": 0.0 for name in ("gamma", "gamma_friction") if f"{path}.{name}" in values}
    return out


def _is_dry(path: str) -> bool:
    return path == EFFICIENCY or (path.startswith("plant.friction.") and path.rpartition(".")[2] in DRY)


def directions(
    system: LinearSystem, mode: Mode, joints: Sequence[str], M: Float64Array, J: Float64Array
) -> tuple[dict[str, float], dict[str, float]]:
    """Fractions of the joints, and of the tool's world axes by kinetic energy, in a mode; the largest first."""
    sides = ("q", "v", "q_motor", "v_motor")  # link and motor of an elastic joint
    of_joints = [sum(mode.participation.get(f"plant.{x}[{i}]", 0.0) for x in sides) for i in range(len(joints))]
    velocity = np.abs(J @ mode.shape[system.state_places("plant.q")]) ** 2  # of a mode, v = (z - 1) q / dt
    mobility = np.diag(J @ np.linalg.solve(M, J.T))
    energy = np.divide(velocity, mobility, out=np.zeros(6), where=mobility > MIN_MOBILITY * mobility.max(initial=0.0))
    parts = energy / (float(energy.sum()) or 1.0)
    return (
        {joints[i]: float(of_joints[i]) for i in np.argsort(-np.array(of_joints))},
        {AXES[i]: float(parts[i]) for i in np.argsort(-parts)},
    )


def largest_factor(holds: Callable[[float], bool], tolerance: float, max_factor: float) -> float:
    """The first limit of factors that hold, from 1 on by factors of 2 and by bisection; 0 or infinite without one."""
    low, high = 1.0, 1.0
    if holds(1.0):
        while holds(high := 2.0 * low):
            low = high
            if low >= max_factor:
                return math.inf
    else:
        while not holds(low := 0.5 * high):
            high = low
            if high < MIN_FACTOR:
                return 0.0
    while high / low > 1.0 + tolerance:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _gains(side: LawSide, values: Changes) -> dict[str, Any]:
    """Gains by path: those of the law that are 0 or more, so no points, axes or data of the arm; an observer's."""
    of_law = (path for path, value in values.items() if path.startswith("law.") and np.any(value))
    fields = {path: side.law.find(path[len("law.") :])[1] for path in of_law}
    found = {path: values[path] for path, field in fields.items() if isinstance(field, Gain) and field.minimum == 0.0}
    return found | ({OBSERVER: values[OBSERVER]} if OBSERVER in values else {})


def _rounded_down(values: Any, digits: int = DIGITS) -> Any:
    unit = 10.0 ** (np.floor(np.log10(np.clip(values, 1e-300, 1e300))) - digits + 1.0)
    return np.where(np.isfinite(values), np.floor(values / unit + 1e-9) * unit, values)[()]


def _times(factor: float, value: Any) -> str:
    """A gain times a factor: the number, (linear, angular), or numbers of joints; of a matrix the factor alone."""
    flat = factor * np.asarray(value, dtype=float)
    if flat.ndim == 2:
        return f"{factor:.3g} times what it is"
    if flat.shape == (6,) and np.ptp(flat[:3]) == np.ptp(flat[3:]) == 0.0:
        flat = flat[[0, 3]]
    numbers = ", ".join(f"{x:.4g}" for x in np.atleast_1d(_rounded_down(flat, DIGITS + 1)))
    return numbers if flat.size == 1 else f"({numbers})"
