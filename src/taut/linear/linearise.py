"""taut.linearise: the exact linear model of a loop about an equilibrium, and its non-smooth points."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.parts import require_radians
from taut.base.checks import finite_array, positive_scalar, read_only
from taut.base.errors import UsageError
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.control.limits import LIMIT_TERMS
from taut.control.trajectories.reference import Hold, Sample
from taut.linear.equilibrium import WITHIN, Flags, Rest, driven_states, equilibrium, observed_states
from taut.linear.linear_system import LinearSystem, OperatingPoint
from taut.linear.period import Derivative, LoopMap, Point, beside, loop_map, starting
from taut.loop import Loop
from taut.plant.rigid import RigidPlant

__all__ = ["linearise", "rest_of"]

NO_EFFECT: Final = "nothing depends on it"
NOT_DRIVEN: Final = "nothing moves it"
LIMITED: Final = 1e-9  # [N m | N | rad/s] of a limit's term above which the limit acts
SLIDING: Final = 1e-9  # [rad/s | m/s] above which a joint slides
APART: Final = 1e-6  # [-] of a state's size: distance of the slopes on each side
NEARER: Final = 3e-8  # [-] likewise, where a non-smooth point lies between
DIFFERENT: Final = 1e-2  # [-] of the larger slope: the difference of two branches
FLAT: Final = 3e-5  # [-] a smaller slope is zero: curves have slopes of that size so far off
FARTHER: Final = 3.0  # [-] times the distance: slopes of a curve differ by as much more, those of two branches do not
CURVED: Final = 2.0  # [-] times the difference: a curve
MAX_SENTENCES: Final = 6


def linearise(loop: Loop, *, at: ArrayLike | None = None, within: float = WITHIN) -> LinearSystem:
    """The linear model of a loop from tick to tick, with all its memory: filters, delays, integrals, substeps.

    Law:    x[k+1] = f(x[k], u[k]), A = df/dx, B = df/du, exactly, of the loop as it is simulated

    The program of the loop is differentiated, and compiled once for a loop. From the state in which a run begins at
    `at`, Newton's method finds where the loop rests, its reference held. A law without gravity compensation droops,
    one with an integral does not: `lin.point.moved`. Memory that goes on changing without any effect, such as an
    integral with ki = 0, is named in `lin.point.drifting`.

    States, inputs and outputs are deviations from that point, by path and index: "plant.q[0]", "law.e_int[2]"; a
    rotation has three, a small rotation vector in world axes. An input is held until the next tick. Inputs: the
    reference, "disturbance.command" (added to the law's command, before the drives), "disturbance.torque" (on the
    joints), "disturbance.wrench" (on the tool, force first, world axes), noise (1 is one standard deviation).
    Outputs: q, v and the tool's pose and twist (world axes), true at the tick, and the law's command. Against a
    reference that is held, the error of an output is minus its deviation.

    A non-smooth point, such as a limit that is reached or stiction, has a derivative on each branch;
    `lin.point.branches` states which one the model is of. Quantisation of encoders and amplifiers counts by its mean
    slope.

    Args:
        loop: The loop. Its parameters count as they are now.
        at: (n,) joint positions to begin at [rad | m]; home if left out.
        within: Maximum distance of the equilibrium from `at` [rad | m].

    Raises:
        RangeError: No equilibrium near `at`: the joint and its distance.
        UsageError: A reference that moves; a task of phases.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.PID(kp=100.0, kd=20.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0)
        >>> lin = taut.linearise(loop, at=[0.3, 0.5])
        >>> lin.stable, lin.point.moved.round(3).tolist()  # droop: only the error balances the weight
        (True, [-0.229, -0.034])

    References:
        Astrom and Wittenmark, Computer-controlled systems (1997), chapter 3. Griewank and Walther, Evaluating
        Derivatives (2008), chapter 3. Khalil, Nonlinear systems (2002), section 1.2.
    """
    map_ = loop_map(loop)
    rest = rest_of(loop, map_, at, within)
    return _model(map_, rest, start=_pose(loop, at))


def rest_of(loop: Loop, map_: LoopMap, at: ArrayLike | None, within: float) -> Rest:
    """The equilibrium of a loop near joint positions, its reference held."""
    q = _pose(loop, at)
    within = positive_scalar("within", within, unit="rad | m")
    if not isinstance(loop.ref, (Sample, Hold)):
        raise UsageError(
            f"an equilibrium needs a reference that is held, and that of this loop is a {type(loop.ref).__name__}; "
            "make the loop with a sample or taut.hold()",
            name="loop",
        )
    return equilibrium(map_, starting(loop, map_, q), within)


def _pose(loop: Loop, at: ArrayLike | None) -> Float64Array:
    """(n,) joint positions of the start: home if nothing is given."""
    arm = loop.plant.arm
    if at is None:
        return arm.home
    q = finite_array("at", at, shape=(arm.n,), joints=arm.joint_names, unit="rad | m")
    require_radians("at", q, arm)
    return q


def _model(map_: LoopMap, rest: Rest, start: Float64Array) -> LinearSystem:
    """The states that matter, and their matrices."""
    point, found = rest.point, rest.found
    names, outputs = map_.state_coordinates.names, map_.output_coordinates.names
    # Of all states first: where a law is non-smooth by rounding alone, its branch at the very point may differ from
    # that beside it, so that some states seem to have no effect.
    whole, slopes = smooth(map_, point, found, list(range(len(names))))
    observed, driven = observed_states(whole.A, whole.C), driven_states(whole.A, whole.B)
    needed = observed & driven
    for path in ("plant.q", "plant.v"):  # also of an arm in stiction
        needed[map_.state_coordinates.places[path]] = True
    keep = [int(i) for i in np.flatnonzero(needed)]
    slopes = slopes.among(keep)
    if whole is not found:
        nearer = beside(map_, point, found, keep)  # the fewer states are moved, the more exact
        found = whole if slopes.misses(nearer) else nearer
    left = {name: NOT_DRIVEN if observed[i] else NO_EFFECT for i, name in enumerate(names) if not needed[i]}
    q = np.array(map_.memory.views(point.memory)["plant.q"])
    return LinearSystem(
        A=found.A[np.ix_(keep, keep)], B=found.B[keep], C=found.C[:, keep], D=found.D, dt=map_.dt,
        states=[names[i] for i in keep], inputs=map_.input_coordinates.names, outputs=outputs,
        point=OperatingPoint(
            joints=map_.side.arm.joint_names, q=read_only(q), moved=read_only(q - start),
            branches=branches_of(map_, point, found, slopes), left_out=left, drifting=rest.drifting,
        ),
    )  # fmt: skip


# -------------------------------------------------------------------- non-smooth points


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
