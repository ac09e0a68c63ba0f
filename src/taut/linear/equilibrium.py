"""Where a loop rests: the fixed point of its map, by Newton with the exact derivative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.linear.loop_map import Derivative, LoopMap, Point, finite_derivative

__all__ = ["Flags", "Rest", "moving_states", "resting", "telling"]

Flags = NDArray[np.bool_]

MOST: Final = 60  # steps of Newton
STILL: Final = 1e-10  # of a memory's size, and absolute below one
DUST: Final = 1e-13  # likewise: a residual that is all rounding, of which no step can be made
TOLD: Final = 1e-7  # likewise: what drifts by less is rounding
LONGEST: Final = 0.3  # [rad | m] of a joint in one step of Newton
RANK: Final = 1e-9  # of the largest singular value: below it a motion is free, and stays where it is
SHOWS: Final = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Rest:
    """A point at which a loop rests, as far as anything shows."""

    point: Point
    found: Derivative
    drifting: dict[str, float]  # what goes on changing without an effect, by how much in a period


def telling(A: Float64Array, C: Float64Array) -> Flags:
    """(n,) whether a state has an effect on an output, now or later."""
    shows: Flags = (C != 0.0).any(axis=0)
    while True:
        more = shows | (A[shows] != 0.0).any(axis=0)
        if (more == shows).all():
            return shows
        shows = more


def moving_states(A: Float64Array, B: Float64Array) -> Flags:
    """(n,) whether an input has an effect on a state, now or later."""
    moves: Flags = (B != 0.0).any(axis=1)
    while True:
        more = moves | (A[:, moves] != 0.0).any(axis=1)
        if (more == moves).all():
            return moves
        moves = more


def resting(map_: LoopMap, start: Point, within: float) -> Rest:
    """The nearest point to a start at which the loop rests with the same inputs and parameters.

    Args:
        map_: The loop's map.
        start: Where to begin: inputs, parameters, and the memory of the first tick.
        within: [rad | m] how far from there a joint may be.

    Raises:
        RangeError: There is none so near; the message names a joint and how far it is off.
    """
    memory, coordinates = start.memory, map_.state_coordinates
    joints = coordinates.places["plant.q"]
    step = np.full(len(coordinates), np.inf)
    at, found = start, finite_derivative(map_, start)
    for _ in range(MOST):
        solved = telling(found.A, found.C) & ~_standing(found)
        scale = 1.0 + np.abs(coordinates.read(memory, memory[np.newaxis])[0])
        wrong = np.abs(found.residual) / scale
        settled = (np.abs(step) / scale)[solved].max(initial=0.0) < STILL and _rests(found, solved, wrong)
        if settled or wrong[solved].max(initial=0.0) < DUST:
            return _at_rest(map_, at, found, wrong, start, within)
        step = np.zeros(len(coordinates))
        step[solved] = _newton(found, solved, scale)
        longest = float(np.abs(step[joints]).max(initial=0.0))
        if longest > LONGEST:
            step *= LONGEST / longest
        # What has no effect, and no Newton, just follows.
        memory = coordinates.moved(np.where(_expanded(map_, solved), memory, found.memory), step)
        at = Point(inputs=start.inputs, parameters=start.parameters, memory=memory)
        found = finite_derivative(map_, at)
    raise _never(map_, start, at, found)


def _expanded(map_: LoopMap, states: Flags) -> Flags:
    """(size,) which numbers of the memory belong to some states."""
    basis = map_.state_coordinates.basis(np.ones(map_.memory.size))
    numbers: Flags = (basis[states] != 0.0).any(axis=0)
    return numbers


def _standing(found: Derivative) -> Flags:
    """(n,) states that nothing moves, such as where a spring was fixed."""
    eye = np.eye(len(found.A))
    still: Flags = (eye == found.A).all(axis=1) & (found.B == 0.0).all(axis=1) & (found.residual == 0.0)
    return still


def _newton(found: Derivative, solved: Flags, scale: Float64Array) -> Float64Array:
    """The shortest step that makes the residual of some states zero, to first order."""
    sizes = scale[solved]
    matrix = (found.A - np.eye(len(found.A)))[np.ix_(solved, solved)] * sizes
    rows = np.abs(matrix).max(axis=1)
    weights = 1.0 / np.where(rows > 0.0, rows, 1.0)
    step, *_ = np.linalg.lstsq(matrix * weights[:, np.newaxis], -found.residual[solved] * weights, rcond=RANK)
    return np.asarray(step * sizes)


def _rests(found: Derivative, solved: Flags, wrong: Float64Array) -> bool:
    """Whether nothing changes that shows, in this period and in those that follow."""
    drift = np.where(solved & (wrong > STILL), found.residual, 0.0)
    if not drift.any():
        return True
    size = float(np.abs(drift).max())
    shown = float(np.abs(found.C @ drift).max(initial=0.0))
    return shown <= SHOWS * size and float(np.abs(found.A @ drift - drift)[solved].max()) <= SHOWS * size


def _at_rest(map_: LoopMap, at: Point, found: Derivative, wrong: Float64Array, start: Point, within: float) -> Rest:
    q, q0 = (map_.memory.views(point.memory)["plant.q"] for point in (at, start))
    off = np.abs(q - q0)
    i = int(np.argmax(off))
    if off[i] > within:
        arm = map_.side.arm
        raise RangeError(
            f"not an equilibrium: from at= joint '{arm.joint_names[i]}' goes {off[i]:.4g} {arm.units[i]} until "
            f"the loop rests, and {within:g} is the most; the nearest is q = {np.round(q, 4).tolist()}; ask there, "
            "or hold the arm at at= with gravity compensation or higher gains",
            name="at",
            joint=arm.joint_names[i],
            value=float(off[i]),
            rule=f"an equilibrium within {within:g}",
        )
    names = map_.state_coordinates.names
    # What only had to follow once, such as a command that holds until the next, does not change again.
    later = map_.after(at, found.memory[np.newaxis])[0]
    again = np.abs(map_.state_coordinates.difference(later, found.memory))
    drifting = {
        names[j]: float(found.residual[j])
        for j in np.flatnonzero((wrong > TOLD) & (again > TOLD))
        if not names[j].startswith("plant.work.") and names[j] != "plant.t"
    }
    return Rest(point=at, found=found, drifting=drifting)


def _never(map_: LoopMap, start: Point, at: Point, found: Derivative) -> RangeError:
    """The sentence of a loop that rests nowhere near."""
    arm, names = map_.side.arm, map_.state_coordinates.names
    places = map_.state_coordinates.places
    of_joints = np.abs(found.residual[places["plant.v"]]) / map_.dt  # what is left to accelerate
    i = int(np.argmax(of_joints))
    q, q0 = (map_.memory.views(point.memory)["plant.q"][i] for point in (at, start))
    if of_joints[i] > STILL:
        unit = f"{arm.units[i]}/s^2"
        return RangeError(
            f"not an equilibrium, and none is near: after {MOST} steps of Newton joint '{arm.joint_names[i]}' is "
            f"{q - q0:.4g} {arm.units[i]} away from at= and still accelerates with {of_joints[i]:.3g} {unit}; what "
            "drives it is held by nothing there (gravity, a limit that is reached, a target out of reach)",
            name="at",
            joint=arm.joint_names[i],
            value=float(of_joints[i]),
            rule="an equilibrium",
        )
    wrong = np.abs(found.residual)
    wrong[~telling(found.A, found.C)] = 0.0
    name = names[int(np.argmax(wrong))]
    return RangeError(
        f"not an equilibrium: '{name}' does not settle, it changes by {wrong.max():.3g} in a period, and the arm "
        "follows it; linearise along a run instead, along=run",
        name=name,
        value=float(wrong.max()),
        rule="an equilibrium",
    )
