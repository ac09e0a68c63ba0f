"""The equilibrium of a loop: the fixed point of its one-period map, by Newton's method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.linear.period import Derivative, PeriodMap, Point, finite_derivative

__all__ = [
    "NEWTON_STEPS",
    "WITHIN",
    "Flags",
    "Rest",
    "driven_states",
    "equilibrium",
    "observed_states",
    "standing_states",
]

Flags = NDArray[np.bool_]

WITHIN: Final = 0.5  # [rad | m] between the start pose and the equilibrium at most
NEWTON_STEPS: Final = 60
REST_CHANGE: Final = 1e-10  # [-] of a state's size per period: the loop rests
DRIFT: Final = 1e-7  # [-] likewise: a drift that is named
MAX_NEWTON_STEP: Final = 0.3  # [rad | m] of a joint in one step of Newton's method
RANK: Final = 1e-9  # [-] of the largest singular value: a motion below it is free, and stays where it is
EFFECT: Final = 1e-9  # [-] of a drift: the smallest effect on an output


@dataclass(frozen=True, kw_only=True, eq=False)
class Rest:
    """An equilibrium: a point at which nothing changes that has an effect.

    Args:
        point: The point.
        found: The derivative there.
        drifting: States that go on changing without any effect, and by how much in a period.
    """

    point: Point
    found: Derivative
    drifting: Mapping[str, float]


def observed_states(A: Float64Array, C: Float64Array) -> Flags:
    """(n,) whether a state has an effect on an output, now or later."""
    observed: Flags = (C != 0.0).any(axis=0)
    while True:
        more = observed | (A[observed] != 0.0).any(axis=0)
        if (more == observed).all():
            return observed
        observed = more


def driven_states(A: Float64Array, B: Float64Array) -> Flags:
    """(n,) whether an input has an effect on a state, now or later."""
    driven: Flags = (B != 0.0).any(axis=1)
    while True:
        more = driven | (A[:, driven] != 0.0).any(axis=1)
        if (more == driven).all():
            return driven
        driven = more


def standing_states(found: Derivative, tolerance: float) -> Flags:
    """(n,) states that nothing changes, such as the rest position of a spring."""
    eye = np.eye(len(found.A))
    still: Flags = (
        (np.abs(found.A - eye) <= tolerance * eye).all(axis=1)
        & (found.B == 0.0).all(axis=1)
        & (found.residual == 0.0)
    )
    return still


def equilibrium(map_: PeriodMap, start: Point, within: float = WITHIN, steps: int = NEWTON_STEPS) -> Rest:
    """The nearest point to a start at which the loop rests with the same inputs and parameters.

    Args:
        map_: The map of a period.
        start: Inputs, parameters, and the memory of the first tick.
        within: Maximum distance of a joint from the start [rad | m].
        steps: Steps of Newton's method at most.

    Raises:
        RangeError: There is none so near; the message names a joint and its distance.
    """
    memory, coordinates = start.memory, map_.state_coordinates
    joints = coordinates.places["plant.q"]
    step = np.full(len(coordinates), np.inf)
    at, found = start, finite_derivative(map_, start)
    for _ in range(steps):
        solved = observed_states(found.A, found.C) & ~standing_states(found, map_.tolerance)
        scale = 1.0 + np.abs(coordinates.numbers(memory))
        wrong = np.abs(found.residual) / scale
        settled = (np.abs(step) / scale)[solved].max(initial=0.0) < REST_CHANGE and _rests(found, solved, wrong)
        if settled or wrong[solved].max(initial=0.0) < map_.rest:
            return _at_rest(map_, at, found, wrong, start, within)
        step = np.zeros(len(coordinates))
        step[solved] = _newton(found, solved, scale)
        longest = float(np.abs(step[joints]).max(initial=0.0))
        if longest > MAX_NEWTON_STEP:
            step *= MAX_NEWTON_STEP / longest
        # A state without an effect, which Newton's method does not solve for, follows the period.
        memory = coordinates.moved(np.where(_expanded(map_, solved), memory, found.memory), step)
        at = Point(inputs=start.inputs, parameters=start.parameters, memory=memory)
        found = finite_derivative(map_, at)
    raise _never(map_, start, at, found, steps)


def _expanded(map_: PeriodMap, states: Flags) -> Flags:
    """(size,) numbers of the memory that belong to some states."""
    basis = map_.state_coordinates.basis(np.ones(map_.memory.size))
    numbers: Flags = (basis[states] != 0.0).any(axis=0)
    return numbers


def _newton(found: Derivative, solved: Flags, scale: Float64Array) -> Float64Array:
    """The shortest step that makes the residual of some states zero, to first order."""
    sizes = scale[solved]
    matrix = (found.A - np.eye(len(found.A)))[np.ix_(solved, solved)] * sizes
    rows = np.abs(matrix).max(axis=1)
    weights = 1.0 / np.where(rows > 0.0, rows, 1.0)
    step, *_ = np.linalg.lstsq(matrix * weights[:, np.newaxis], -found.residual[solved] * weights, rcond=RANK)
    return np.asarray(step * sizes)


def _rests(found: Derivative, solved: Flags, wrong: Float64Array) -> bool:
    """Whether nothing changes that has an effect, in this period and in those that follow."""
    drift = np.where(solved & (wrong > REST_CHANGE), found.residual, 0.0)
    if not drift.any():
        return True
    size = float(np.abs(drift).max())
    shown = float(np.abs(found.C @ drift).max(initial=0.0))
    return shown <= EFFECT * size and float(np.abs(found.A @ drift - drift)[solved].max()) <= EFFECT * size


def _at_rest(map_: PeriodMap, at: Point, found: Derivative, wrong: Float64Array, start: Point, within: float) -> Rest:
    q, q0 = (map_.memory.views(point.memory)["plant.q"] for point in (at, start))
    off = np.abs(q - q0)
    i = int(np.argmax(off))
    if off[i] > within:
        arm = map_.side.arm
        raise RangeError(
            f"not an equilibrium: from at= joint '{arm.joint_names[i]}' moves {off[i]:.4g} {arm.units[i]} until "
            f"the loop rests, and {within:g} is the maximum; the nearest is q = {np.round(q, 4).tolist()}; start "
            "there, or hold the arm at at= with gravity compensation or higher gains",
            name="at",
            joint=arm.joint_names[i],
            value=float(off[i]),
            rule=f"an equilibrium within {within:g}",
        )
    names = map_.state_coordinates.names
    # A state that had to follow once, such as the command held until the next tick, does not change again.
    later = map_.after(at, found.memory[np.newaxis])[0]
    again = np.abs(map_.state_coordinates.difference(later, found.memory))
    drifting = {
        names[j]: float(found.residual[j])
        for j in np.flatnonzero((wrong > DRIFT) & (again > DRIFT))
        if not names[j].startswith("plant.work.") and names[j] != "plant.t"
    }
    return Rest(point=at, found=found, drifting=drifting)


def _never(map_: PeriodMap, start: Point, at: Point, found: Derivative, steps: int) -> RangeError:
    """The error of a loop without an equilibrium near."""
    arm, names = map_.side.arm, map_.state_coordinates.names
    places = map_.state_coordinates.places
    of_joints = np.abs(found.residual[places["plant.v"]]) / map_.dt  # acceleration that remains
    i = int(np.argmax(of_joints))
    q, q0 = (map_.memory.views(point.memory)["plant.q"][i] for point in (at, start))
    if of_joints[i] > REST_CHANGE:
        unit = f"{arm.units[i]}/s^2"
        return RangeError(
            f"not an equilibrium, and none is near: after {steps} steps of Newton's method joint "
            f"'{arm.joint_names[i]}' is {q - q0:.4g} {arm.units[i]} away from at= and still accelerates with "
            f"{of_joints[i]:.3g} {unit}; the load on it is not balanced there (gravity, a limit that is reached, a "
            "target out of reach)",
            name="at",
            joint=arm.joint_names[i],
            value=float(of_joints[i]),
            rule="an equilibrium",
        )
    wrong = np.abs(found.residual)
    wrong[~observed_states(found.A, found.C)] = 0.0
    name = names[int(np.argmax(wrong))]
    return RangeError(
        f"not an equilibrium: '{name}' does not settle, it changes by {wrong.max():.3g} in a period, and the arm "
        "follows it; begin at= another pose, or run the loop until it rests",
        name=name,
        value=float(wrong.max()),
        rule="an equilibrium",
    )
