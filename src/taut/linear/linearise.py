"""taut.linearise: the equilibrium of a loop, its exact linear model there, and non-smooth points."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taut.arm.parts import require_radians
from taut.base.checks import finite_array, positive_scalar, read_only
from taut.base.errors import RangeError, UsageError
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.control.limits import LIMIT_TERMS
from taut.control.trajectories.reference import Hold, Sample
from taut.linear.linear_system import LinearSystem, OperatingPoint
from taut.linear.period import (
    RESOLUTION,
    Derivative,
    LoopMap,
    PeriodMap,
    Point,
    beside,
    finite_derivative,
    loop_map,
    mean_of,
    start_of,
)
from taut.loop import DT, Loop

Flags = NDArray[np.bool_]

WITHIN: Final = 0.5  # [rad | m] between the start pose and the equilibrium at most
NEWTON_STEPS: Final = 60
REST_CHANGE: Final = 1e-10  # [-] of a state's size per period: the loop rests
MAX_NEWTON_STEP: Final = 0.3  # [rad | m] of a joint in one step of Newton's method
RANK: Final = 1e-9  # [-] of the largest singular value: a motion below it is free, and stays where it is
EFFECT: Final = 1e-9  # [-] of a drift: the smallest effect on an output

NO_EFFECT: Final = "nothing depends on it"
NOT_DRIVEN: Final = "nothing moves it"
LIMITED: Final = 1e-9  # [N m | N | rad/s] of a limit's term above which the limit acts
SLIDING: Final = 1e-9  # [rad/s | m/s] above which a joint slides
DIFFERENT: Final = 1e-2  # [-] of the larger slope: the difference of two branches
FLAT: Final = 3e-5  # [-] a smaller slope is zero


def linearise(loop: Loop, *, at: ArrayLike | None = None, within: float = WITHIN) -> LinearSystem:
    """The linear model of a loop from tick to tick, with all its memory: filters, delays, integrals, substeps.

    Law:    x[k+1] = f(x[k], u[k]), A = df/dx, B = df/du, exactly, of the loop as it is simulated

    From the state in which a run begins at `at`, Newton's method finds the equilibrium with the reference held. A law
    without gravity compensation droops, one with an integral does not: `lin.point.moved`. Memory that keeps changing
    without any effect, such as an integral with ki = 0, is left out.

    States, inputs and outputs are deviations from that point, by path and index: "plant.q[0]", "law.e_int[2]"; a
    rotation has three, a small rotation vector in world axes. An input is held until the next tick. Inputs: the
    reference, "disturbance.command" (added to the law's command, before the drives), "disturbance.torque" (on the
    joints), "disturbance.wrench" (on the tool, force first, world axes), noise (1 is one standard deviation).
    Outputs: q, v and the tool's pose and twist (world axes), true at the tick, and the law's command. With the
    reference held, the error of an output is minus its deviation.

    A non-smooth point, such as a limit that is reached or stiction, has a derivative on each branch;
    `lin.point.branches` states which one the model is of. Quantisation counts by its mean slope.

    Args:
        loop: The loop, with its present parameters.
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
    return _model(map_, rest_of(loop, map_, at, within), start=pose_at(loop, at))


def rest_of(loop: Loop, map_: LoopMap, at: ArrayLike | None, within: float) -> Derivative:
    """The equilibrium of a loop near joint positions, its reference held."""
    q = pose_at(loop, at)
    within = positive_scalar("within", within, unit="rad | m")
    if not isinstance(loop.ref, (Sample, Hold)):
        raise UsageError(
            f"an equilibrium needs a reference that is held, and that of this loop is a {type(loop.ref).__name__}; "
            "make the loop with a sample or taut.hold()",
            name="loop",
        )
    loop.side.check_start(q, {**loop.parameters, DT: loop.dt}, loop.ref)
    return equilibrium(map_, start_of(loop, map_.inputs, map_.parameters, q, loop.ref)[1], within)


def pose_at(loop: Loop, at: ArrayLike | None) -> Float64Array:
    """(n,) joint positions of a start, checked: home by default."""
    arm = loop.plant.arm
    if at is None:
        return arm.home
    q = finite_array("at", at, shape=(arm.n,), joints=arm.joint_names, unit="rad | m")
    require_radians("at", q, arm)
    return q


def _model(map_: LoopMap, found: Derivative, start: Float64Array) -> LinearSystem:
    """The states that matter, and their matrices."""
    names, outputs = map_.state_coordinates.names, map_.output_coordinates.names
    # Of all states first: where a law is non-smooth by rounding alone, its branch at the very point may differ from
    # that beside it, so that some states seem to have no effect.
    whole, _ = _smooth(map_, found, range(len(names)))
    observed, driven = observed_states(whole.A, whole.C), observed_states(whole.A.T, whole.B.T)
    needed = observed & driven
    for path in ("plant.q", "plant.v"):  # also of an arm in stiction
        needed[map_.state_coordinates.places[path]] = True
    keep = [int(i) for i in np.flatnonzero(needed)]
    found, non_smooth = _smooth(map_, found, keep)  # the fewer states are moved, the more exact
    left = {name: NOT_DRIVEN if observed[i] else NO_EFFECT for i, name in enumerate(names) if not needed[i]}
    q = np.array(map_.memory.views(found.at.memory)["plant.q"])
    return LinearSystem(
        A=found.A[np.ix_(keep, keep)], B=found.B[keep], C=found.C[:, keep], D=found.D, dt=map_.dt,
        states=[names[i] for i in keep], inputs=map_.input_coordinates.names, outputs=outputs,
        point=OperatingPoint(
            joints=map_.side.arm.joint_names, q=read_only(q), moved=read_only(q - start),
            branches=(*_branches(map_, found), *non_smooth), left_out=left,
        ),
    )  # fmt: skip


def _smooth(map_: LoopMap, found: Derivative, states: Sequence[int]) -> tuple[Derivative, list[str]]:
    """The derivative, and sentences about states in which the derivatives to either side differ.

    Where those agree but differ from that at the point, it is non-smooth by rounding alone (two energies of zero at
    rest): their mean is the derivative. A length of zero counts by its mean slope too.
    """
    sides, block = beside(map_, found.at, states), np.ix_(states, states)
    A, one, other = (x.A[block].T for x in (found, *sides))  # a row for each state that is moved
    least = (
        DIFFERENT * np.minimum(np.abs(one).max(axis=0, initial=0.0), np.abs(other).max(axis=0, initial=0.0)) + FLAT
    )

    def differ(x: Float64Array, y: Float64Array) -> Flags:
        flags: Flags = np.abs(x - y) > np.maximum(DIFFERENT * np.maximum(np.abs(x), np.abs(y)), least)
        return flags

    apart = differ(one, other)
    if (differ(A, one) & differ(A, other) & ~apart).any():
        return mean_of(found, sides), []
    names, out = [map_.state_coordinates.names[i] for i in states], []
    for i in np.flatnonzero((apart & differ(A, 0.5 * (one + other))).any(axis=1)):
        k = int(np.argmax(np.abs(one[i] - other[i])))
        out.append(
            f"the loop is non-smooth in {names[i]}: to one side the slope of {names[k]} is {one[i, k]:.3g}, to the "
            f"other {other[i, k]:.3g}; the model has {A[i, k]:.3g}"
        )
    return found, out


def _branches(map_: LoopMap, found: Derivative) -> list[str]:
    """Sentences about known non-smooth elements, and the branch of each that the model is of."""
    record, memory = map_.recorded(found), map_.memory.views(found.at.memory)
    numbers, joints = map_.parameters.views(found.at.parameters), map_.side.arm.joint_names
    out = [f"quantisation of {path} counts by its mean slope" for path in numbers if path.endswith(RESOLUTION)]
    for term in LIMIT_TERMS:
        cut = np.abs(record.get(f"terms.{term}", np.zeros(len(joints)))) > LIMITED
        out += [f"joint '{joints[i]}' is at its {term.replace('_', ' ')}" for i in np.flatnonzero(cut)]
    if "plant.friction" in memory:
        v = memory.get("plant.v_motor", memory["plant.v"])
        dry = sum(np.abs(numbers.get(f"plant.friction.{kind}", 0.0)) for kind in ("coulomb", "static"))
        held = (np.abs(v) < SLIDING) & (dry > 0.0)
        out += [f"dry friction holds joint '{joints[i]}' (stiction)" for i in np.flatnonzero(held)]
    out += [
        f"{'drives are' if name == 'drives' else f'sensor {name} is'} at the limit"
        for name, on in subtree(record, "saturated").items()
        if np.any(on > 0.5)
    ]
    rows = np.atleast_1d(memory.get("plant.contact.on", ())) > 0.5
    out += [f"contact row {i} is {'closed' if on else 'open'}, and stays so" for i, on in enumerate(rows)]
    notices = map_.side.notices
    return out + [notices[path] for path in notices if np.any(np.asarray(memory.get(path, 0.0)) != 0.0)]


def observed_states(A: Float64Array, C: Float64Array) -> Flags:
    """(n,) whether a state has an effect on an output, now or later; with A^T and B^T: whether an input has on it."""
    observed: Flags = (C != 0.0).any(axis=0)
    while True:
        more = observed | (A[observed] != 0.0).any(axis=0)
        if (more == observed).all():
            return observed
        observed = more


def acting_states(found: Derivative, tolerance: float) -> Flags:
    """(n,) states that have an effect, without those that nothing changes, such as the rest position of a spring."""
    eye = np.eye(len(found.A))
    still: Flags = (
        (np.abs(found.A - eye) <= tolerance * eye).all(axis=1)
        & (found.B == 0.0).all(axis=1)
        & (found.residual == 0.0)
    )
    return observed_states(found.A, found.C) & ~still


def equilibrium(map_: PeriodMap, start: Point, within: float = WITHIN, steps: int = NEWTON_STEPS) -> Derivative:
    """The derivative at the nearest equilibrium to a start, where no state changes that has an effect.

    By Newton's method; RangeError if none is `within` [rad | m].
    """
    memory, coordinates = start.memory, map_.state_coordinates
    joints = coordinates.places["plant.q"]
    step = np.full(len(coordinates), np.inf)
    found = finite_derivative(map_, start)
    line = map_.memory.shapes.get("plant.delay", ())
    for _ in range(line[0] if len(line) == 3 else 0):  # the motors' gains that are on their way multiply the rest
        memory = np.where(_expanded(map_, acting_states(found, map_.tolerance)), memory, found.memory)
        found = finite_derivative(map_, dataclasses.replace(start, memory=memory))
    for _ in range(steps):
        solved = acting_states(found, map_.tolerance)
        scale = 1.0 + np.abs(coordinates.numbers(memory))
        wrong = np.abs(found.residual) / scale
        settled = (np.abs(step) / scale)[solved].max(initial=0.0) < REST_CHANGE and _rests(found, solved, wrong)
        if settled or wrong[solved].max(initial=0.0) < map_.rest:
            return _within(map_, found, start, within)
        step = np.zeros(len(coordinates))
        step[solved] = _newton(found, solved, scale)
        longest = float(np.abs(step[joints]).max(initial=0.0))
        if longest > MAX_NEWTON_STEP:
            step *= MAX_NEWTON_STEP / longest
        # A state without an effect, which Newton's method does not solve for, follows the period.
        memory = coordinates.moved(np.where(_expanded(map_, solved), memory, found.memory), step)
        found = finite_derivative(map_, dataclasses.replace(start, memory=memory))
    raise _never(map_, found)


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


def _within(map_: PeriodMap, found: Derivative, start: Point, within: float) -> Derivative:
    q, q0 = (map_.memory.views(point.memory)["plant.q"] for point in (found.at, start))
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
    return found


def _never(map_: PeriodMap, found: Derivative) -> RangeError:
    """The error of a loop without an equilibrium near, with the state that changes most."""
    wrong = np.where(observed_states(found.A, found.C), np.abs(found.residual), 0.0)
    value, name = float(wrong.max()), map_.state_coordinates.names[int(np.argmax(wrong))]
    return RangeError(
        f"not an equilibrium, and none is near: after all steps of Newton's method '{name}' still changes by "
        f"{value:.3g} in a period; the load is not balanced there (gravity, a limit that is reached, a target out of "
        "reach); begin at= another pose",
        name="at",
        value=value,
        rule="an equilibrium",
    )
