"""taut.linearise: a loop about an equilibrium or along a run, exactly, by automatic differentiation."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, overload

import numpy as np

from taut.arm.angles import require_radians
from taut.base.checks import finite_array, positive_scalar
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.reference import Hold, Sample
from taut.linear.equilibrium import Rest, moving_states, resting, telling
from taut.linear.linear_loop import LinearLoop
from taut.linear.loop_map import Derivative, LoopMap, Point, beside, finite_derivative, loop_map, starting
from taut.linear.sides import sides_of, smooth
from taut.loop import Loop
from taut.record.run import Run
from taut.runtime.fused import FusedRun

__all__ = ["linearise", "rest_of"]

WITHIN: Final = 0.5  # [rad | m]
SAME: Final = 1e-9  # [rad | m] between a run and its repetition
UNSEEN: Final = "nothing depends on it"
UNMOVED: Final = "nothing moves it"


@overload
def linearise(
    loop: Loop, *, at: ArrayLike | None = None, with_respect_to: str | Iterable[str] = (), within: float = WITHIN
) -> LinearLoop: ...
@overload
def linearise(
    loop: Loop, *, along: Run, times: ArrayLike, with_respect_to: str | Iterable[str] = ()
) -> tuple[LinearLoop, ...]: ...
def linearise(
    loop: Loop,
    *,
    at: ArrayLike | None = None,
    along: Run | None = None,
    times: ArrayLike | None = None,
    with_respect_to: str | Iterable[str] = (),
    within: float = WITHIN,
) -> LinearLoop | tuple[LinearLoop, ...]:
    """The linear model of a loop from tick to tick, with all its memory: filters, delays, integrals, substeps.

    Derivatives are exact, of the loop as it is simulated: they are taken of its program, compiled once for a loop
    and a choice of parameters, and called for each direction.

    At an equilibrium: from the state that a run begins with at `at`, Newton finds where the loop rests, its reference
    held. A law without gravity compensation sags, one with an integral does not; `lin.moved` says how far. Memory
    that goes on changing without any effect, such as an integral with ki = 0, is named in `lin.drifting`.

    Along a run of this loop: about the state of each time, which the loop passes through; a model says how a small
    deviation there grows in one period.

    A kink, such as a limit that is reached or a joint that sticks, has a derivative on each side; `lin.sides` says
    on which side of what the model stands. Steps of encoders and amplifiers count by their mean slope.

    Args:
        loop: The loop. Its parameters count as they are now.
        at: (n,) joint positions to begin at [rad | m]; home if left out.
        along: A run of this loop, from its own start, without events.
        times: (k,) or one [s], with `along`: of the ticks nearest to them.
        with_respect_to: Paths of parameters that are inputs of the model too: "law.kp", "plant.payload.mass".
        within: [rad | m] how far from `at` the equilibrium may be.

    Returns:
        The model at the equilibrium; along a run, one for each time.

    Raises:
        RangeError: No equilibrium near `at`: by how much it is not, and which joint; a time outside of the run.
        UsageError: A reference that moves and no `along`; a run of another loop.
        UnknownNameError: No such parameter.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.PID(kp=100.0, kd=20.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0)
        >>> lin = taut.linearise(loop, at=[0.3, 0.5])
        >>> lin.stable, lin.moved.round(3).tolist()  # it sags, for nothing holds its weight but the error
        (True, [-0.229, -0.034])

    References:
        Griewank and Walther, Evaluating Derivatives (2008), chapter 3. Khalil, Nonlinear systems (2002), section 1.2.
    """
    map_ = loop_map(loop, with_respect_to)
    if along is not None:
        if at is not None:
            raise UsageError("give at= for an equilibrium or along= for a run, not both", name="along")
        if times is None:
            raise UsageError("along= needs times=, the instants of the run to linearise at [s]", name="times")
        return _along(loop, map_, along, times)
    if times is not None:
        raise UsageError("times= goes with along=run; an equilibrium has no time", name="times")
    rest = rest_of(loop, map_, at, within)
    return _model(map_, rest.point, rest.found, start=_pose(loop, at), drifting=rest.drifting)


def rest_of(loop: Loop, map_: LoopMap, at: ArrayLike | None, within: float) -> Rest:
    """Where a loop rests near joint positions, its reference held."""
    q = _pose(loop, at)
    within = positive_scalar("within", within, unit="rad | m")
    if not isinstance(loop.ref, (Sample, Hold)):
        raise UsageError(
            f"an equilibrium needs a reference that stays, and that of this loop is a {type(loop.ref).__name__}; "
            "make the loop with a sample or taut.hold(), or linearise along a run: along=run, times=...",
            name="loop",
        )
    return resting(map_, starting(loop, map_, q), within)


def _pose(loop: Loop, at: ArrayLike | None) -> Float64Array:
    """(n,) where to begin: home if nothing is given."""
    arm = loop.plant.arm
    if at is None:
        return arm.home
    q = finite_array("at", at, shape=(arm.n,), joints=arm.joint_names, unit="rad | m")
    require_radians("at", q, arm)
    return q


def _along(loop: Loop, map_: LoopMap, run: Run, times: ArrayLike) -> tuple[LinearLoop, ...]:
    if not isinstance(run, Run):  # callers without a type checker
        raise UsageError(f"along= takes a taut.Run; got {type(run).__name__}", name="along")
    wanted = finite_array("times", times, unit="s")
    if wanted.ndim > 1 or not wanted.size:
        raise ShapeError(f"times must be one time or (k,) of them [s]; got shape {wanted.shape}", name="times")
    ticks = np.rint(np.atleast_1d(wanted) / loop.dt).astype(int)
    for time, tick in zip(np.atleast_1d(wanted), ticks, strict=True):
        if not 0 <= tick < len(run):
            raise RangeError(
                f"times must be within the run, 0 to {run.t[-1]:g} s; got {time:g} s",
                name="times",
                value=float(time),
                rule="within the run",
            )
    if map_.steps:
        raise UsageError(
            f"along a run there is no mean slope of steps, and the plant has some ({', '.join(map_.steps)}); "
            "linearise a loop and a run whose plant has none",
            name="along",
        )
    if run.info.get("events"):
        raise UsageError("along= takes a run without events; a change of parameters is another loop", name="along")
    # A run keeps no memory of filters and integrals: its ticks are taken once more.
    again = FusedRun(loop, run.q[0], run.v[0], int(run.info["seed"]), (), dict(run.info))
    again.go(lambda _: None, None)
    rows, values = again.tape.input_rows, map_.values(loop.parameters)
    inputs = np.zeros(map_.inputs.size)
    inputs[: rows.shape[1]] = rows[0]
    memory = map_.start(run.q[0], run.v[0], inputs, values)
    models: dict[int, LinearLoop] = {}
    for k in range(int(ticks.max()) + 1):
        point = Point(
            inputs=np.append(rows[k], np.zeros(map_.inputs.size - rows.shape[1])), parameters=values, memory=memory
        )
        if k in ticks:
            off = np.abs(map_.memory.views(memory)["plant.q"] - run.q[k])
            if off.max() > SAME:
                i = int(np.argmax(off))
                raise UsageError(
                    f"along= must be a run of this loop; its joint '{loop.side.arm.joint_names[i]}' is {off[i]:.3g} "
                    f"away from this loop's at t = {run.t[k]:g} s; run the loop anew: along=taut.run(loop)",
                    name="along",
                    joint=loop.side.arm.joint_names[i],
                )
            found = finite_derivative(map_, point)
            q = map_.memory.views(memory)["plant.q"]
            models[k] = _model(map_, point, found, start=q, t=float(run.t[k]))
        memory = map_.after(point, memory[np.newaxis])[0]
    return tuple(models[int(k)] for k in ticks)


def _model(
    map_: LoopMap,
    point: Point,
    found: Derivative,
    *,
    start: Float64Array,
    t: float = 0.0,
    drifting: dict[str, float] | None = None,
) -> LinearLoop:
    """The states that matter, and their matrices."""
    names, outputs = map_.state_coordinates.names, map_.output_coordinates.names
    # Of all states first: on a kink that only rounding sees, the law may take another way at the very point, so that
    # some seem to have no effect.
    whole, slopes = smooth(map_, point, found, list(range(len(names))))
    seen, moved = telling(whole.A, whole.C), moving_states(whole.A, whole.B)
    needed = seen & moved
    for path in ("plant.q", "plant.v"):  # also of an arm that sticks
        needed[map_.state_coordinates.places[path]] = True
    keep = [int(i) for i in np.flatnonzero(needed)]
    slopes = slopes.among(keep)
    if whole is not found:
        nearer = beside(map_, point, found, keep)  # the fewer are moved, the more exact
        found = whole if slopes.misses(nearer) else nearer
    left = {name: UNMOVED if seen[i] else UNSEEN for i, name in enumerate(names) if not needed[i]}
    q = np.array(map_.memory.views(point.memory)["plant.q"])
    return LinearLoop(
        A=_frozen(found.A[np.ix_(keep, keep)]),
        B=_frozen(found.B[keep]),
        C=_frozen(found.C[:, keep]),
        D=_frozen(found.D),
        dt=map_.dt,
        states=tuple(names[i] for i in keep),
        inputs=map_.input_names,
        outputs=outputs,
        joints=map_.side.arm.joint_names,
        q=_frozen(q),
        t=t,
        moved=_frozen(q - start),
        sides=sides_of(map_, point, found, slopes),
        left_out=left,
        drifting={} if drifting is None else drifting,
    )


def _frozen(array: Float64Array) -> Float64Array:
    out = np.ascontiguousarray(array)
    out.flags.writeable = False
    return out
