"""Judgement of a sampled loop about the pose at which it starts: stable or not, in which direction, by which gain.

The map of one control period is the compiled loop that simulates it; its derivative is taken by central differences.
Dry friction is left out of the map, in the plant and in its compensation: it has no slope while a joint slides, and
a joint that sticks hides an unstable loop only until a push sets it free. Limits and noise are left out too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np

from taut.base.errors import TautError
from taut.base.types import Float64Array
from taut.codegen.coordinates import BlockCoordinates
from taut.control.describe import all_laws
from taut.control.laws.friction import FrictionCompensation
from taut.control.lawside import LawSide
from taut.loop import AnyPlant, HasLawSide, Loop
from taut.maths.snapshot import snapshot
from taut.plant.rigid import RigidPlant
from taut.runtime.fused import FusedRun, Period
from taut.runtime.stand_in import has_steps, stand_in

__all__ = ["Judgement", "judge", "judged"]

EMPTY: Final[Mapping[str, Any]] = MappingProxyType({})
STEP: Final = 1e-6  # [-] of a state's size, of central differences
REST: Final = 1e-11  # [-] of a state's size in a period: the loop rests
NEWTON_STEPS: Final = 20
REACH: Final = 0.5  # [rad | m] between the start pose and the equilibrium, as in `taut.linearise`
RANK: Final = 1e-9  # [-] of the largest singular value: a motion below it is free, and rests where it is
ROUNDING: Final = 1e-9  # [-] of a modulus of one
FACTORS: Final = 2.0 ** -np.arange(1, 15)  # [-] of a gain, at which a stable loop is looked for
BALANCING: Final = 12  # sweeps
FINE: Final = 0.01  # [-] of the largest stable factor
PART: Final = 0.2  # [-] the least part in a mode that a sentence names
HUGE: Final = 1e12  # a limit that is never reached
DRY: Final = ("coulomb", "static", "load_motor", "load_external", "load_motor_static", "load_external_static")
VISCOUS: Final = "plant.friction.viscous"
EFFICIENCY: Final = "actuation.transmission.efficiency"
AXES: Final = tuple(f"{kind} {axis}" for kind in ("translation", "rotation") for axis in "xyz")

Map = Callable[[Float64Array], Float64Array]
"""Memory before a control period -> memory after it."""
Changes = Mapping[str, Any]
"""Parameters by path that differ from those of the run."""


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Stability of a sampled loop about its equilibrium next to the start pose, without limits and dry friction.

    Args:
        dt: Control period [s].
        radius: Spectral radius of the one-period map [-].
        unstable: Whether it is above one by more than the map is known.
        joints: Of an unstable loop: part of each joint in the mode that grows fastest, by name, the largest first.
        tool: Part of each axis of the tool in it, by kinetic energy (world axes), likewise.
        largest: Of an unstable loop: the largest factor on a gain, by path, with which the loop is stable, the others
            as they are; on all of them, "law", where only that helps; empty where nothing does.
        gains: The gains as they are, by path.
        relies_on: Friction of the plant that keeps deviations from growing: viscous friction without which a stable
            loop is unstable; dry friction that holds an unstable loop while it is at rest.
        plant: Name of the plant that it was judged with.
    """

    dt: float
    radius: float
    unstable: bool
    joints: Mapping[str, float]
    tool: Mapping[str, float]
    largest: Mapping[str, float]
    gains: Mapping[str, Float64Array]
    relies_on: tuple[str, ...]
    plant: str

    @property
    def message(self) -> str:
        """The verdict, and what to do about it, in one sentence."""
        on = f"; it relies on {' and '.join(self.relies_on)}" if self.relies_on else ""
        if not self.unstable:
            return f"the sampled loop is stable at the start pose, {self._judged_with}{on}"
        hidden = f"; {' and '.join(self.relies_on)} hides it at rest" if self.relies_on else ""
        joints = ", ".join(f"'{name}'" for name, part in self.joints.items() if part >= PART)
        tool = ", ".join(name for name, part in self.tool.items() if part >= PART)
        where = f" along joint {joints}" + (f" (tool: {tool})" if tool else "") if joints else " in the law's memory"
        return (
            f"the sampled loop is unstable at the start pose, {self._judged_with}: deviations{where} grow "
            f"{self._growth}{hidden}; {self._remedy}"
        )

    @property
    def _judged_with(self) -> str:
        return f"judged with {self.plant} at {1.0 / self.dt:g} Hz"

    @property
    def _growth(self) -> str:
        if self.radius > 1.1:
            return f"{self.radius:.3g} times a period (spectral radius)"
        return f"by a factor e in {self.dt / np.log(self.radius):.3g} s (spectral radius 1 + {self.radius - 1.0:.2g})"

    @property
    def _remedy(self) -> str:
        if not self.largest:
            return "no smaller gain that was tried makes it stable; change the law, its gains or the rate"
        if "law" in self.largest:
            return f"no single smaller gain makes it stable, and all gains times {self.largest['law']:.3g} do"
        gains = " or ".join(f"{path} = {_times(x, self.gains[path])}" for path, x in self.largest.items())
        return f"the largest gain that is stable is {gains}, the others as they are; use less, or a higher rate"

    def json(self) -> dict[str, Any]:
        """As plain values, for the record of a run."""
        return {
            "stable": not self.unstable,
            "radius": float(f"{self.radius:.9g}"),
            "joints": {name: round(part, 3) for name, part in self.joints.items() if part >= PART},
            "tool": {name: round(part, 3) for name, part in self.tool.items() if part >= PART},
            "largest": dict(self.largest),
            "relies_on": list(self.relies_on),
            "plant": self.plant,
            "message": self.message,
        }


def judged(
    ctrl: HasLawSide, plant: AnyPlant, q: Float64Array, run: FusedRun | None, changes: Mapping[str, Any] = EMPTY
) -> Judgement | str:
    """The judgement of a run at its start: of its own loop, or of one with the same arm as a smooth model plant.

    Args:
        ctrl: The controller, or the loop.
        plant: What it runs against.
        q: (n,) the start pose [rad | m].
        run: The run of a model plant, before it begins; None for an engine or a robot.
        changes: Parameters by path that events change at the start; a run has them already.
    """
    if ctrl.engine != "native":
        return "not judged: plain Python is for debugging, and the loop is judged where it is compiled"
    if run is not None and not has_steps(plant):
        return judge(run, ctrl.side, plant.name)
    try:
        loop = _stand_in_loop(ctrl, plant)
        for path, value in {**plant.parameters, **ctrl.parameters, **changes}.items():
            if path in loop.parameters:
                loop.parameters[path] = value
        made = FusedRun(loop, q, np.zeros_like(q), 0, (), {})
    except TautError as error:
        return f"not judged: {error}"
    same = isinstance(plant, RigidPlant)
    name = f"{plant.name} without steps" if same else f"{loop.plant.name} in place of {plant.name}"
    return judge(made, ctrl.side, name)


# One for each plant, so that a controller which runs again on it is not traced again; a loop does not hold its key.
_STAND_INS: Final[WeakKeyDictionary[AnyPlant, Loop]] = WeakKeyDictionary()


def _stand_in_loop(ctrl: HasLawSide, plant: AnyPlant) -> Loop:
    try:
        known = _STAND_INS.get(plant)
    except TypeError:  # a plant of the user's own that has no hash
        return _made_loop(ctrl, plant)
    if known is None or known.side is not ctrl.side:
        known = _STAND_INS[plant] = _made_loop(ctrl, plant)
    return known


def _made_loop(ctrl: HasLawSide, plant: AnyPlant) -> Loop:
    side = ctrl.side
    return Loop(_Side(side, side.parameters, ctrl.engine), stand_in(plant, side.needs), duration=side.dt)


@dataclass(frozen=True)
class _Side:
    """A controller as a loop takes it."""

    side: LawSide
    parameters: Mapping[str, Float64Array]
    engine: str


def judge(run: FusedRun, side: LawSide, plant: str) -> Judgement | str:
    """Judge the loop of a run about the equilibrium next to its start pose, its reference held there.

    Law:          x(k+1) = f(x(k)), A = df/dx where f(x) = x; unstable where abs(eig(A)) > 1

    Args:
        run: The run, before it begins.
        side: The law side of its loop.
        plant: What the plant is called.

    Returns:
        The judgement; a sentence why there is none: no equilibrium within reach, or a map without a derivative.
    """
    try:
        with np.errstate(all="ignore"):  # numbers that no float can hold are refused where the run meets them
            return _judged(run, side, plant)
    except np.linalg.LinAlgError:
        return "not judged: the derivative of a period is no matrix that has eigenvalues"


def _judged(run: FusedRun, side: LawSide, plant: str) -> Judgement | str:
    period = run.period()
    left_out = _left_out(side, period.values)
    after = period.after(left_out)
    rest = _equilibrium(period, after, after(period.start))  # what begins in the first tick has begun
    if isinstance(rest, str):
        return rest
    A, error, kept, memory = rest
    z, slack, left, right = _eigenvalues(A, error)
    unstable = bool(_unstable(z, slack))
    nearby = memory + STEP * period.coordinates.basis(memory).sum(axis=0)
    elsewhere = after(nearby)
    if np.array_equal(period.command(memory), period.command(nearby)):
        return "not judged: nothing that is measured changes the command"

    def stable_with(changed: Changes) -> bool:
        after = period.after({**left_out, **changed})
        if np.array_equal(after(nearby), elsewhere):
            return not unstable  # the gains of a phase that does not act, say
        found = _equilibrium(period, after, memory)
        return not isinstance(found, str) and not _unstable(*_eigenvalues(*found[:2])[:2])

    joints: dict[str, float] = {}
    tool: dict[str, float] = {}
    largest: dict[str, float] = {}
    relies_on: tuple[str, ...] = ()
    if unstable:
        worst = int(np.argmax(np.abs(z)))
        joints, tool = _directions(period, kept, memory, left[:, worst], right[:, worst])
        largest = _largest_gains(_gains(side, period.values), stable_with)
        dry = {path: period.values[path] for path in left_out if _is_dry(path)}
        if any(np.any(dry[path] != left_out[path]) for path in dry) and stable_with(dry):
            relies_on = ("dry friction",)
    elif VISCOUS in period.values and np.any(period.values[VISCOUS]):
        without = {VISCOUS: np.zeros_like(period.values[VISCOUS])}
        relies_on = () if stable_with(without) else ("the viscous friction of the joints",)
    return Judgement(
        dt=period.dt,
        radius=float(np.abs(z).max()),
        unstable=unstable,
        joints=joints,
        tool=tool,
        largest=largest,
        gains={path: period.values[path] for path in largest if path != "law"},
        relies_on=relies_on,
        plant=plant,
    )


def _left_out(side: LawSide, values: Changes) -> dict[str, Any]:
    """Parameters that leave limits and dry friction out of a loop, those of its compensation included."""
    out = {path: np.full_like(values[path], path == EFFICIENCY) for path in values if _is_dry(path)}
    out |= {f"limits.{name}": HUGE for name in ("tau", "tau_dot", "v") if f"limits.{name}" in values}
    for path, law in all_laws(side.law, "law"):
        if isinstance(law, FrictionCompensation):
            out[f"{path}.width"] = HUGE
    return out


def _is_dry(path: str) -> bool:
    return path == EFFICIENCY or (path.startswith("plant.friction.") and path.rpartition(".")[2] in DRY)


# -------------------------------------------------------------------- the derivative of a period


def _equilibrium(
    period: Period, after: Map, memory: Float64Array
) -> tuple[Float64Array, Float64Array, list[int], Float64Array] | str:
    """A at the equilibrium near a memory, by Newton, its error and states, and the memory; why there is none."""
    coordinates = period.coordinates
    places = coordinates.places["plant.q"]
    first = period.numbers(memory)[places]
    for _ in range(NEWTON_STEPS):
        here = after(memory)
        A = _differences(period, after, memory, here, STEP)
        if not np.isfinite(A).all():
            return "not judged: a period of the loop is not finite at the start pose"
        kept = _acting(A, coordinates)
        residual = coordinates.difference(here, memory)
        sizes = 1.0 + np.abs(period.numbers(memory))
        if (np.abs(residual) <= REST * sizes)[kept].all():
            far = _differences(period, after, memory, here, 2.0 * STEP)
            block = np.ix_(kept, kept)
            return ((4.0 * A - far) / 3.0)[block], np.abs(A - far)[block], kept, memory
        by = np.zeros(len(coordinates))
        by[kept] = np.linalg.lstsq((np.eye(len(A)) - A)[np.ix_(kept, kept)], residual[kept], rcond=RANK)[0]
        longest = float(np.abs(by[places]).max(initial=0.0))
        memory = coordinates.moved(memory, by * min(1.0, REACH / max(longest, 1e-300)))
        off = np.abs(period.numbers(memory)[places] - first)
        if not off.max(initial=0.0) < REACH:
            return f"not judged: the loop does not rest within {REACH:g} rad (or m) of the start pose"
    return "not judged: the loop does not rest near the start pose"


def _differences(period: Period, after: Map, memory: Float64Array, here: Float64Array, step: float) -> Float64Array:
    """(N, N) derivative of the memory after a period by that before it, by central differences of a step."""
    coordinates = period.coordinates
    steps = step * (1.0 + np.abs(period.numbers(memory)))[:, np.newaxis]
    moves = steps * coordinates.basis(memory)
    ends = np.stack([after(memory + move) - after(memory - move) for move in moves])
    return np.asarray((coordinates.read(here, ends) / (2.0 * steps)).T)


def _acting(A: Float64Array, coordinates: BlockCoordinates) -> list[int]:
    """States on which the joints' motion depends, now or later; no constants and no clock, which nothing drives."""
    joints = np.zeros(len(A), dtype=bool)
    for path in ("plant.q", "plant.v"):
        joints[coordinates.places[path]] = True
    acting = joints
    for _ in range(len(A)):
        acting = acting | (A[acting] != 0.0).any(axis=0)
    constant = (np.count_nonzero(A, axis=1) == 1) & (np.abs(np.diag(A) - 1.0) < STEP)
    return np.flatnonzero(joints | (acting & ~constant)).tolist()


def _eigenvalues(A: Float64Array, error: Float64Array) -> tuple[Any, Float64Array, Any, Any]:
    """Eigenvalues of A, how far each is uncertain by the error of A, left and right eigenvectors."""
    scale = np.ones(len(A))
    for _ in range(BALANCING):  # Osborne's: rows and columns of one size, so that rounding is of all states alike
        sizes = np.abs(A * scale / scale[:, np.newaxis])
        np.fill_diagonal(sizes, 0.0)
        rows, columns = sizes.sum(axis=1), sizes.sum(axis=0)
        both = (rows > 0.0) & (columns > 0.0)
        scale[both] *= (rows[both] / columns[both]) ** 0.25
    balanced = A * scale / scale[:, np.newaxis]
    z, right = np.linalg.eig(balanced)
    try:
        left = np.linalg.inv(right).conj().T
    except np.linalg.LinAlgError:  # of poles that coincide there are too few eigenvectors
        left = np.linalg.pinv(right).conj().T
    left /= np.linalg.norm(left, axis=0)
    aligned = np.abs(np.einsum("ij,ij->j", left.conj(), right))
    rounding = np.finfo(float).eps / STEP * max(1.0, float(np.abs(balanced).max()))
    noise = rounding + float(np.linalg.norm(error * scale / scale[:, np.newaxis], 2))
    slack = ROUNDING + noise / np.maximum(aligned, 1e-300)
    return z, np.minimum(slack, np.sqrt(noise)), left, right


def _unstable(z: Any, slack: Float64Array) -> bool:
    return bool((np.abs(z) > 1.0 + slack).any())


# -------------------------------------------------------------------- direction and gains


def _directions(
    period: Period, kept: list[int], memory: Float64Array, left: Any, right: Any
) -> tuple[dict[str, float], dict[str, float]]:
    """Parts of the joints, and of the axes of the tool, in a mode."""
    arm, places = period.arm, period.coordinates.places
    parts = np.zeros(len(period.coordinates))
    parts[kept] = np.abs(left) * np.abs(right)
    of_joints = sum((parts[places[path]] for path in ("plant.q", "plant.v")), np.zeros(arm.n))
    total = float(parts.sum()) or 1.0
    joints = {arm.joint_names[i]: float(of_joints[i] / total) for i in np.argsort(-of_joints)}
    shape = np.zeros(len(period.coordinates), dtype=np.complex128)
    shape[kept] = right
    q = period.numbers(memory)[places["plant.q"]]
    x = snapshot(arm, q)
    J = np.asarray(x.J())
    velocity = np.abs(J @ shape[places["plant.q"]]) ** 2  # of a mode, v = (z - 1) q / dt in every joint
    mobility = np.diag(J @ np.linalg.solve(np.asarray(x.M), J.T))
    energy = np.divide(velocity, mobility, out=np.zeros(6), where=mobility > RANK * mobility.max(initial=0.0))
    whole = float(energy.sum()) or 1.0
    return joints, {AXES[i]: float(energy[i] / whole) for i in np.argsort(-energy)}


def _gains(side: LawSide, values: Changes) -> dict[str, Any]:
    """The gains of the law by path: its parameters that are 0 or more, and so no points, axes or bounds."""
    of_law = {path: value for path, value in values.items() if path.startswith("law.") and np.any(value)}
    return {
        path: value
        for path, value in of_law.items()
        if getattr(side.law.find(path[len("law.") :])[1], "minimum", 0.0) == 0.0
    }


def _largest_gains(gains: Changes, stable_with: Callable[[Changes], bool]) -> dict[str, float]:
    """The largest factor on each gain that alone makes an unstable loop stable; else "law": the one on all."""
    out: dict[str, float] = {}
    for path in gains:
        factor = _largest_factor(lambda f, path=path: stable_with({path: f * gains[path]}))  # type: ignore[misc]
        if factor is not None:
            out[path] = factor
    if out or len(gains) < 2:
        return out
    factor = _largest_factor(lambda f: stable_with({path: f * value for path, value in gains.items()}))
    return {} if factor is None else {"law": factor}


def _largest_factor(stable_at: Callable[[float], bool]) -> float | None:
    """The largest factor below one at which a loop is stable, of those tried, in three digits; None for none."""
    high = 1.0
    for low in FACTORS.tolist():
        if stable_at(low):
            break
        high = low
    else:
        return None
    while high / low > 1.0 + FINE:
        middle = float(f"{np.sqrt(low * high):.3g}")
        if not low < middle < high:
            break
        low, high = (middle, high) if stable_at(middle) else (low, middle)
    return float(low)


def _times(factor: float, value: Any) -> str:
    """A gain times a factor: the number, (linear, angular), or numbers of joints; of a matrix the factor alone."""
    flat = factor * np.asarray(value, dtype=float)
    if flat.ndim == 2:
        return f"{factor:.3g} times what it is"
    if flat.shape == (6,) and np.ptp(flat[:3]) == np.ptp(flat[3:]) == 0.0:
        flat = flat[[0, 3]]
    digits = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(flat), 1e-300))) - 3.0)
    down = np.floor(flat / digits + 1e-9) * digits  # what is printed is no more than what was tried
    numbers = ", ".join(f"{x:.4g}" for x in np.atleast_1d(down))
    return numbers if flat.size == 1 else f"({numbers})"
