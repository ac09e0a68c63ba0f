"""Non-smooth points of a loop: which branch of each a linear model is of (limits, stiction, contact, other kinds)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.limits import LIMIT_TERMS
from taut.linear.equilibrium import Flags
from taut.linear.loop_map import LoopMap, beside
from taut.linear.period import Derivative, Point
from taut.plant.rigid import RigidPlant

__all__ = ["Slopes", "branches_of", "smooth"]

LIMITED: Final = 1e-9  # [N m | N | rad/s] of a limit's term above which the limit acts
SLIDING: Final = 1e-9  # [rad/s | m/s] above which a joint slides
APART: Final = 1e-6  # [-] of a state's size: distance of the slopes on each side
NEARER: Final = 3e-8  # [-] likewise, where a non-smooth point lies between
DIFFERENT: Final = 1e-2  # [-] of the larger slope: the difference of two branches
FLAT: Final = 3e-5  # [-] a smaller slope is zero: curves have slopes of that size so far off
FARTHER: Final = 3.0  # [-] times the distance: slopes of a curve differ by as much more, those of two branches do not
CURVED: Final = 2.0  # [-] times the difference: a curve
MAX_SENTENCES: Final = 6


def branches_of(map_: LoopMap, at: Point, found: Derivative, slopes: Slopes) -> tuple[str, ...]:
    """Sentences about each non-smooth point, and the branch that the model is of."""
    record, memory = map_.recorded(found), map_.memory.views(at.memory)
    out = [f"quantisation of {path} counts by its mean slope" for path in map_.steps]
    out += _limits(map_, record)
    out += _sticking(map_, memory, map_.parameters.views(at.parameters))
    out += _flags(map_, record, memory)
    return (*out, *_others(map_, at, found, slopes))


@dataclass(frozen=True, kw_only=True, eq=False)
class Slopes:
    """Slopes of the memory by some states, upwards and downwards, at a small distance: (k, k) each, row by state."""

    states: list[int]
    up: Float64Array
    down: Float64Array
    least: Float64Array  # (k,) of each column: a smaller difference of slopes is rounding
    curved: Flags  # (k, k) whether slopes differ as those of a curve do: the more the larger the distance

    @classmethod
    def at(cls, map_: LoopMap, at: Point, found: Derivative, states: list[int], apart: float = APART) -> Slopes:
        """By differences on each side, at a distance."""
        up, down = _slopes(map_, at, found, states, states, apart)
        # Rounding of an entry of the memory over a step is no second branch.
        scale = np.minimum(np.abs(up).max(axis=0, initial=0.0), np.abs(down).max(axis=0, initial=0.0))
        curved = np.zeros(up.shape, dtype=bool)
        out = cls(states=states, up=up, down=down, least=DIFFERENT * scale + FLAT, curved=curved)
        rows = np.flatnonzero(out.differ(up, down).any(axis=1))
        if len(rows):
            ends = _slopes(map_, at, found, [states[i] for i in rows], states, FARTHER * apart)
            curved[rows] = np.abs(ends[0] - ends[1]) > CURVED * np.abs(up - down)[rows]
        return out

    def among(self, states: list[int]) -> Slopes:
        """Those of some states."""
        kept = [self.states.index(i) for i in states]
        both = np.ix_(kept, kept)
        parts = {name: getattr(self, name)[both] for name in ("up", "down", "curved")}
        return dataclasses.replace(self, states=states, least=self.least[kept], **parts)

    def differ(self, one: Float64Array, other: Float64Array) -> Flags:
        """(k, k) where two kinds of slopes differ."""
        out: Flags = np.abs(one - other) > np.maximum(DIFFERENT * np.maximum(np.abs(one), np.abs(other)), self.least)
        return out

    def misses(self, found: Derivative) -> bool:
        """Whether a derivative is not that of the motion beside it, which is smooth."""
        A = found.A[np.ix_(self.states, self.states)].T
        return bool((self.differ(A, self.up) & self.differ(A, self.down) & ~self.differ(self.up, self.down)).any())


def _slopes(
    map_: LoopMap, at: Point, found: Derivative, moved: list[int], states: list[int], apart: float
) -> tuple[Float64Array, Float64Array]:
    """(m, k) slopes of the states by those that are moved, upwards and downwards, by differences at a distance."""
    coordinates = map_.state_coordinates
    values = coordinates.numbers(at.memory)
    steps = apart * (1.0 + np.abs(values[moved]))
    moves = coordinates.basis(at.memory)[moved] * steps[:, np.newaxis]
    after = map_.after(at, at.memory + np.concatenate([moves, -moves]))
    each = coordinates.read(found.memory, after - found.memory)[:, states] / np.tile(steps, 2)[:, np.newaxis]
    return each[: len(moved)], -each[len(moved) :]


def _near(map_: LoopMap, at: Point, found: Derivative, states: list[int]) -> bool:
    """Whether a derivative that misses the slopes is right at a smaller distance."""
    return not Slopes.at(map_, at, found, states, NEARER).misses(found)


def smooth(map_: LoopMap, at: Point, found: Derivative, states: list[int]) -> tuple[Derivative, Slopes]:
    """The derivative, as the mean of two points beside it where the point is non-smooth by rounding alone.

    At rest a law may compare two energies that are both zero but for rounding.
    """
    slopes = Slopes.at(map_, at, found, states)
    if not slopes.misses(found) or _near(map_, at, found, states):
        return found, slopes
    mean = beside(map_, at, found, states)
    return (found if slopes.misses(mean) else mean), slopes


def _limits(map_: LoopMap, record: Mapping[str, Any]) -> list[str]:
    names, units = map_.side.arm.joint_names, map_.side.arm.units
    out = []
    for term in LIMIT_TERMS:
        cut = record.get(f"terms.{term}")
        if cut is None:
            continue
        for i in np.flatnonzero(np.abs(cut) > LIMITED):
            kind = map_.side.probe.kind
            unit = {"torque": "N m" if units[i] == "rad" else "N", "velocity": f"{units[i]}/s"}.get(kind, units[i])
            out.append(
                f"joint '{names[i]}' is at its {term.replace('_', ' ')}, which reduces the command by "
                f"{abs(cut[i]):.3g} {unit}"
            )
    return out


def _sticking(map_: LoopMap, memory: Mapping[str, Any], numbers: Mapping[str, Any]) -> list[str]:
    plant = map_.plant
    if not isinstance(plant, RigidPlant) or not plant.parts.drivetrain.dry or "plant.friction" not in memory:
        return []
    v = memory.get("plant.v_motor", memory["plant.v"])
    names = plant.arm.joint_names
    dry = np.zeros(plant.arm.n)
    for path in ("plant.friction.coulomb", "plant.friction.static"):
        dry = dry + np.abs(numbers.get(path, 0.0))
    held = [names[i] for i in np.flatnonzero((np.abs(v) < SLIDING) & (dry > 0.0))]
    slipping = [names[i] for i in np.flatnonzero((np.abs(v) >= SLIDING) & (dry > 0.0))]
    out = [f"dry friction holds joint '{name}' (stiction): a small force does not move it" for name in held]
    return out + [f"joint '{name}' slides, with dry friction of one sign" for name in slipping]


def _flags(map_: LoopMap, record: Mapping[str, Any], memory: Mapping[str, Any]) -> list[str]:
    out = [f"sensor {name} is at its limit" for name, on in subtree(record, "saturated").items() if np.any(on > 0.5)]
    on = memory.get("plant.contact.on")
    if on is not None:
        rows = [str(i) for i in np.flatnonzero(np.atleast_1d(on) > 0.5)]
        free = [str(i) for i in np.flatnonzero(np.atleast_1d(on) <= 0.5)]
        out += [f"contact rows {', '.join(rows)} hold, and do not open"] if rows else []
        out += [f"contact rows {', '.join(free)} are open, and do not close"] if free else []
    notices = map_.side.notices
    return out + [notices[path] for path in notices if path in memory and np.any(np.asarray(memory[path]) != 0.0)]


def _others(map_: LoopMap, at: Point, found: Derivative, slopes: Slopes) -> list[str]:
    """States whose slopes on the two sides differ, so that the model is of one branch or of neither."""
    names = [map_.state_coordinates.names[i] for i in slopes.states]
    A = found.A[np.ix_(slopes.states, slopes.states)].T
    differ = slopes.differ(slopes.up, slopes.down) & ~slopes.curved
    if not differ.any() and slopes.misses(found):
        if not _near(map_, at, found, slopes.states):
            return ["the loop is non-smooth here, and the model is of neither branch"]
        missed = slopes.differ(A, slopes.up) & slopes.differ(A, slopes.down)
        name = names[int(np.argmax(missed.any(axis=1)))]
        return [
            f"the loop is non-smooth near here, {APART:g} of {name} away or less, as where a law limits the rate of "
            "a jump; the model is of smaller deviations"
        ]
    out = []
    for i in np.flatnonzero(differ.any(axis=1)):
        apart = np.where(differ[i], np.abs(slopes.up[i] - slopes.down[i]), 0.0)
        k = int(np.argmax(apart))
        out.append(
            f"the loop is non-smooth in {names[i]}: upwards the slope of {names[k]} is {slopes.up[i, k]:.3g}, "
            f"downwards {slopes.down[i, k]:.3g}; the model has {A[i, k]:.3g}"
        )
    more = len(out) - MAX_SENTENCES
    return out if more <= 0 else [*out[:MAX_SENTENCES], f"and {more} non-smooth points more"]
