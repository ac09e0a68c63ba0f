"""taut.linearise: the exact linear model of a loop about an equilibrium or along a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, overload

import numpy as np

from taut.arm.angles import require_radians
from taut.base.checks import finite_array, positive_scalar, read_only
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.paths import subtree
from taut.base.result import Content, Result
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.feed import ReferenceFeed
from taut.control.trajectories.reference import Hold, Sample
from taut.linear.equilibrium import WITHIN, Rest, driven_states, equilibrium, observed_states
from taut.linear.linear_system import Complex, LinearSystem, Mode
from taut.linear.loop_map import LoopMap, beside, finite_derivative, loop_map, starting
from taut.linear.margins import Margins
from taut.linear.non_smooth import branches_of, smooth
from taut.linear.period import Derivative, Point
from taut.loop import Loop

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.record.run import Run

__all__ = ["Linearisation", "linearise", "rest_of"]

SAME: Final = 1e-9  # [rad | m] between a run and its repetition
AT_REST: Final = 1e-8  # [rad | m] a smaller displacement is rounding
NO_EFFECT: Final = "nothing depends on it"
NOT_DRIVEN: Final = "nothing moves it"
JOINT_STATES: Final = ("plant.q", "plant.v", "plant.q_motor", "plant.v_motor")


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearisation(Result):
    """The linear system of a loop about one point, and the point.

    States, inputs and outputs are deviations from the point, by path and index: "plant.q[0]", "law.e_int[2]"; a
    rotation has three, a small rotation vector in world axes. An input is held until the next tick. Inputs: the
    reference, "disturbance.command" (added to the law's command, before the drives), "disturbance.torque" (on the
    joints), "disturbance.wrench" (on the tool, force first, world axes), noise (1 is one standard deviation),
    parameters. Outputs: q, v and the tool's pose and twist (world axes), true at the tick, and the law's command.
    Against a reference that is held, the error of an output is minus its deviation.

    Args:
        system: The linear system; `lin.poles`, `lin.stable`, `lin.A`, ... are its own.
        joints: Names of the arm's joints.
        q: (n,) joint positions of the point [rad | m].
        t: Its time [s]; 0 at an equilibrium.
        moved: (n,) displacement of the joints from `at=` to the equilibrium (droop); zero along a run.
        branches: Sentences: non-smooth points, and the branch of each that the model is of.
        left_out: States without which the model is complete, with the reason.
        drifting: States that go on changing there without any effect, and by how much in a period.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0)
        >>> lin = taut.linearise(loop, at=arm.home)
        >>> [round(mode.s.real, 2) for mode in lin.modes], lin.states
        ([-9.09, -11.11], ('plant.q[0]', 'plant.v[0]'))

    References:
        Astrom and Wittenmark, Computer-controlled systems (1997), chapter 3.
    """

    system: LinearSystem
    joints: tuple[str, ...]
    q: Float64Array
    t: float = 0.0
    moved: Float64Array
    branches: tuple[str, ...] = ()
    left_out: Mapping[str, str]
    drifting: Mapping[str, float]

    # -------------------------------------------------------------------- the system's own

    @property
    def A(self) -> Float64Array:
        """(n, n)."""
        return self.system.A

    @property
    def B(self) -> Float64Array:
        """(n, m)."""
        return self.system.B

    @property
    def C(self) -> Float64Array:
        """(p, n)."""
        return self.system.C

    @property
    def D(self) -> Float64Array:
        """(p, m)."""
        return self.system.D

    @property
    def dt(self) -> float:
        """Period [s]."""
        assert self.system.dt is not None
        return self.system.dt

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the n states."""
        return self.system.states

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the m inputs."""
        return self.system.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the p outputs."""
        return self.system.outputs

    @property
    def poles(self) -> Complex:
        """(n,) poles in z, the slowest decay first."""
        return self.system.poles

    @property
    def radius(self) -> float:
        """Spectral radius [-]."""
        return self.system.radius

    @property
    def stable(self) -> bool:
        """Whether all deviations decay, but for positions that stay where they are put."""
        return self.system.stable

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The modes, the slowest first."""
        return self.system.modes

    def columns(self, input: str) -> list[int]:
        """Places of an input, by its name or that of its group."""
        return self.system.columns(input)

    def rows(self, output: str) -> list[int]:
        """Places of an output, likewise."""
        return self.system.rows(output)

    def frequency_response(self, omega: ArrayLike, *, input: str, output: str) -> Complex:
        """`LinearSystem.frequency_response`."""
        return self.system.frequency_response(omega, input=input, output=output)

    def margins(self) -> Margins:
        """Margins of the loop opened at each joint's command, the others closed, and at all at once (disk)."""
        found = self.system.margins()
        named = zip(found.signals, self.joints, strict=True)
        return replace(found, signals=tuple(replace(each, signal=joint) for each, joint in named))

    def joint_of(self, mode: Mode) -> str | None:
        """The joint whose position and velocity take most part in a mode; None where no joint takes part."""
        parts = np.zeros(len(self.joints))
        for name, part in mode.participation.items():
            head, _, index = name.partition("[")
            if head in JOINT_STATES:
                parts[int(index[:-1])] += part
        return self.joints[int(np.argmax(parts))] if parts.any() else None

    def to_control(self) -> Any:
        """The system as `control.StateSpace` of python-control."""
        return self.system.to_control()

    def content(self) -> Content:
        """The system's content, with the point and its non-smooth elements."""
        of_system, i = self.system.content(), int(np.argmax(np.abs(self.moved)))
        place = f"at t = {self.t:g} s of a run" if self.t else "about an equilibrium"
        summary = [*of_system.summary, f"q = {np.round(self.q, 4).tolist()}"]
        if np.abs(self.moved).max(initial=0.0) > AT_REST:
            summary.append(f"joint '{self.joints[i]}' moved {self.moved[i]:.4g} from at= until the loop rested")
        tables = list(of_system.tables)
        if self.stable:
            tables[1] = self.margins().table()
        drifts = [f"{name} changes by {x:.3g} in each period, without effect" for name, x in self.drifting.items()]
        return replace(
            of_system, title=f"{of_system.title}, {place}", summary=summary, tables=tables,
            notes=[*self.branches, *drifts],
        )  # fmt: skip

    def plot(self) -> Figure:
        """Step response, poles, Bode and Nyquist diagram of the loop at each joint's command."""
        return self.system.plot()


@overload
def linearise(
    loop: Loop, *, at: ArrayLike | None = None, with_respect_to: str | Iterable[str] = (), within: float = WITHIN
) -> Linearisation: ...
@overload
def linearise(
    loop: Loop, *, along: Run, times: ArrayLike, with_respect_to: str | Iterable[str] = ()
) -> tuple[Linearisation, ...]: ...
def linearise(
    loop: Loop,
    *,
    at: ArrayLike | None = None,
    along: Run | None = None,
    times: ArrayLike | None = None,
    with_respect_to: str | Iterable[str] = (),
    within: float = WITHIN,
) -> Linearisation | tuple[Linearisation, ...]:
    """The linear model of a loop from tick to tick, with all its memory: filters, delays, integrals, substeps.

    Law:    x[k+1] = f(x[k], u[k]), A = df/dx, B = df/du, exactly, of the loop as it is simulated

    The program of the loop is differentiated, compiled once for a loop and a choice of parameters.

    At an equilibrium: from the state in which a run begins at `at`, Newton's method finds where the loop rests, its
    reference held. A law without gravity compensation droops, one with an integral does not: `lin.moved`. Memory that
    goes on changing without any effect, such as an integral with ki = 0, is named in `lin.drifting`.

    Along a run of this loop: about the state at each time; the product of the models carries a small deviation to the
    end.

    A non-smooth point, such as a limit that is reached or stiction, has a derivative on each branch; `lin.branches`
    states which one the model is of. Quantisation of encoders and amplifiers counts by its mean slope.

    Args:
        loop: The loop. Its parameters count as they are now.
        at: (n,) joint positions to begin at [rad | m]; home if left out.
        along: A run of this loop, from its own start, without events.
        times: (k,) or one [s], with `along`: of the ticks nearest to them.
        with_respect_to: Paths of parameters that are inputs of the model too: "law.kp", "plant.payload.mass".
        within: Maximum distance of the equilibrium from `at` [rad | m].

    Returns:
        The model at the equilibrium; along a run, one for each time.

    Raises:
        RangeError: No equilibrium near `at`: the joint and its distance; a time outside of the run.
        UsageError: A reference that moves and no `along`; a run of another loop.
        UnknownNameError: No such parameter.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.PID(kp=100.0, kd=20.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0)
        >>> lin = taut.linearise(loop, at=[0.3, 0.5])
        >>> lin.stable, lin.moved.round(3).tolist()  # droop: only the error balances the weight
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
    """The equilibrium of a loop near joint positions, its reference held."""
    q = _pose(loop, at)
    within = positive_scalar("within", within, unit="rad | m")
    if not isinstance(loop.ref, (Sample, Hold)):
        raise UsageError(
            f"an equilibrium needs a reference that is held, and that of this loop is a {type(loop.ref).__name__}; "
            "make the loop with a sample or taut.hold(), or linearise along a run: along=run, times=...",
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


def _along(loop: Loop, map_: LoopMap, run: Run, times: ArrayLike) -> tuple[Linearisation, ...]:
    if not hasattr(run, "info"):  # callers without a type checker
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
    if run.info.events:
        raise UsageError("along= takes a run without events; a change of parameters is another loop", name="along")
    # A run keeps no memory of filters and integrals: its ticks are taken once more.
    rows, values = _inputs_of(loop, map_, run), map_.values(loop.parameters)
    memory = map_.start(run.q[0], run.v[0], rows[0], values)
    models: dict[int, Linearisation] = {}
    for k in range(int(ticks.max()) + 1):
        point = Point(inputs=rows[k], parameters=values, memory=memory)
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


def _inputs_of(loop: Loop, map_: LoopMap, run: Run) -> Float64Array:
    """(ticks, size) time, reference and noise of each tick of a run, as `taut.run` made them."""
    side, rows = loop.side, np.zeros((len(run), map_.inputs.size))
    views = map_.inputs.views(rows)
    views["t"][...] = run.t
    for name, column in subtree(views, "noise").items():
        column[...] = np.random.default_rng([run.info.seed or 0, *name.encode()]).standard_normal(column.shape)
    feed = ReferenceFeed(loop.ref, side.law.reference, side.arm, loop.dt, side.at_rest(run.q[0]))
    if feed.next_question(0) is not None:
        raise UsageError(
            "along= takes a run whose reference does not depend on it; this one streams from a source", name="along"
        )
    feed.fill(subtree(views, "ref"), 0, lambda: None)
    return rows


def _model(
    map_: LoopMap,
    point: Point,
    found: Derivative,
    *,
    start: Float64Array,
    t: float = 0.0,
    drifting: Mapping[str, float] | None = None,
) -> Linearisation:
    """The states that matter, and their matrices."""
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
    system = LinearSystem(
        A=found.A[np.ix_(keep, keep)], B=found.B[keep], C=found.C[:, keep], D=found.D, dt=map_.dt,
        states=[names[i] for i in keep], inputs=map_.input_names, outputs=outputs,
    )  # fmt: skip
    return Linearisation(
        system=system,
        joints=map_.side.arm.joint_names,
        q=read_only(q),
        t=t,
        moved=read_only(q - start),
        branches=branches_of(map_, point, found, slopes),
        left_out=left,
        drifting={} if drifting is None else drifting,
    )
