"""taut.tune: parameters that minimise a cost of closed loops within constraints, by the exact gradient of runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from scipy.optimize import Bounds, minimize

from taut.analysis.run_gradient import RunGradient, RunSlopes
from taut.base.checks import finite_array, one_of, positive_scalar, whole_number
from taut.base.errors import NumericalError, RangeError, ShapeError, UsageError, count_of, unknown_name
from taut.base.paths import subtree
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.noise import MAX_SEED
from taut.control.law import Law
from taut.control.limits import Limits
from taut.control.trajectories.reference import Trajectory
from taut.linear.period import RESOLUTION
from taut.loop import Loop, state_at_start

Loops: TypeAlias = Loop | Sequence[Loop] | Mapping[str, Loop]
Slope: TypeAlias = tuple[float, Float64Array]
"""A number, and (m,) its derivatives."""

FACTOR: Final = 10.0  # from the start down and up to the bounds, where none are given
AT_BOUND: Final = 1e-6  # of the distance of the bounds
CONSTRAINT_TOLERANCE: Final = 1e-6  # relative; what the optimiser leaves
COST_TOLERANCE: Final = 1e-7  # relative; where the optimiser stops
NO_COST: Final = 1e6  # stands for the cost of a run that diverges


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopFigures:
    """The runs of a loop with some parameters: means over the seeds, and of torque and rate the largest."""

    name: str
    cost: float
    rms_error: float  # of the joints or of the tool [rad | m]; NaN where the law follows no motion
    effort: float  # integral of tau^2 [(N m)^2 s]
    torque: float  # largest fraction of the torque limits; NaN without
    rate: float  # largest fraction of the limits of the torque rate; NaN without
    chatter: float  # total variation of the torques per second [N m/s]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One evaluation.

    Args:
        parameters: By path.
        cost: Mean over all loops of the cost over that at the start, or the largest cost of any loop over the largest
            at the start; infinite where a run diverges.
        slacks: By constraint, what remains of it, relative: 0 at the limit, negative beyond.
        figures: Of each loop.
        costs: (k,) the mean; of the worst, each loop's.
        gradients: (k, m) their derivatives by the parameters as numbers from 0 to 1 between their bounds.
        slack_gradients: (c, m) of the slacks.
    """

    parameters: Mapping[str, Float64Array]
    cost: float
    slacks: Mapping[str, float]
    figures: tuple[LoopFigures, ...]
    costs: Float64Array
    gradients: Float64Array
    slack_gradients: Float64Array

    @property
    def ok(self) -> bool:
        """Whether it has a cost and keeps to the constraints."""
        return math.isfinite(self.cost) and min(self.slacks.values(), default=0.0) >= -CONSTRAINT_TOLERANCE


@dataclass(frozen=True, kw_only=True, eq=False)
class Tuned(Result):
    """What `taut.tune` found. Print it for the parameters, the figures before and after, and notes.

    Args:
        law: The law with its new gains.
        parameters: The best that keep to the constraints, by path; those of the start if none is better.
        start: The parameters at the start.
        cost: Of the best, over that of the start: 1 where nothing was gained.
        history: Every trial in order, the start first.
        before: Each loop with the parameters of the start.
        after: Each loop with the best ones.
        notes: Parameters at their bounds, runs that diverged, an end too soon, constraints that are missed.
    """

    law: Law
    parameters: Mapping[str, Float64Array]
    start: Mapping[str, Float64Array]
    cost: float
    history: tuple[Trial, ...]
    before: tuple[LoopFigures, ...]
    after: tuple[LoopFigures, ...]
    notes: tuple[str, ...]

    @property
    def ratios(self) -> dict[str, float]:
        """Cost after over cost before, of each loop by name."""
        return {b.name: a.cost / b.cost for b, a in zip(self.before, self.after, strict=True)}

    def content(self) -> Content:
        """The parameters, and the figures of each loop before and after."""
        values = [
            (name, float(before), float(after))
            for path in self.parameters
            for name, before, after in zip(
                _entries(path, self.start[path]), self.start[path].flat, self.parameters[path].flat, strict=True
            )
        ]
        figures = [
            (
                each.name,
                when,
                *(each.cost, each.rms_error, each.effort, each.torque, each.rate, each.chatter),
            )
            for both in zip(self.before, self.after, strict=True)
            for when, each in zip(("before", "after"), both, strict=True)
        ]
        columns = ["loop", "", "cost", "RMS error [rad | m]", "effort [(N m)^2 s]"]
        columns += ["torque, of limit", "rate, of limit", "chatter [N m/s]"]
        return Content(
            title=f"tuning: cost {self.cost:.4g} of that at the start, after {count_of(len(self.history), 'trial')}",
            tables=[
                Table(title="parameters", columns=("parameter", "before", "after"), rows=values),
                Table(title="loops", columns=columns, rows=figures),
            ],
            notes=self.notes,
        )


def tune(
    loops: Loops,
    paths: Sequence[str],
    *,
    cost: str | Mapping[str, float] = "tracking",
    bounds: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    limits: Limits | None = None,
    chatter: float | None = None,
    q0: ArrayLike | None = None,
    seeds: Sequence[int] = (0,),
    evaluations: int = 300,
    over: Literal["mean", "worst"] = "mean",
) -> Tuned:
    """Gains, or any parameters, that minimise a cost of closed loops within constraints.

    Law:          minimise the mean over loops and seeds of cost / cost at the start, parameters between their bounds,
                  with |tau| <= limits.tau, |tau's change in a tick| <= limits.tau_dot dt, and a chatter of at most
                  `chatter` times that at the start
                  over="worst": minimise s, with the cost of each loop <= s times the largest at the start

    SciPy's SLSQP minimises it, with the exact derivative of the simulated loop (forward mode, native code). Limits of
    the controller itself always hold; those given here are not set in it. Ctrl-C ends the search with the best.

    Args:
        loops: One or more loops that share the parameters, and begin with them; they stay as they are. Loops with
            other plants are a set for which gains are chosen, such as samples of a sweep, `found.loop(i)`.
        paths: Such as ("law.kp", "law.kd"), "sensing.velocity.cutoff"; one number, or one per joint.
        cost: "tracking", "rotation", "effort" or "speed", the mean square of the error of joints or of the tool's
            position, of its rotation, of the torques or the velocities; or weights of them, {"tracking": 1.0,
            "effort": 1e-6}.
        bounds: By path (low, high), logarithmic if both are positive; a tenth and ten times the start if left out.
        limits: To keep within: `taut.Limits.of(arm)`; None for none.
        chatter: Largest chatter over that at the start: 1.0 for no more; None for any.
        q0: (n,) where runs start [rad | m]; home, or where a reference of joints starts, if left out.
        seeds: Of the noise in the runs.
        evaluations: Largest number of trials.
        over: "mean" of the loops, or the "worst" of them, for gains that hold on each.

    Raises:
        UsageError, RangeError, ShapeError, UnknownNameError: An invalid argument; encoders or amplifiers with steps,
            which have no derivative; a start that diverges.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=5.0, kd=0.5), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[1.0]), duration=1.0)
        >>> tuned = taut.tune(loop, ("law.kd",))
        >>> tuned.cost < 0.9, bool(tuned.parameters["law.kd"] > 1.0)
        (True, True)

    References:
        Griewank and Walther, Evaluating Derivatives (2008). Kraft, DFVLR-FB 88-28 (1988), on SLSQP.
    """
    evaluations = whole_number("evaluations", evaluations, minimum=1)
    if not seeds:
        raise UsageError("seeds must have one number at least; got none", name="seeds")
    if limits is not None and not isinstance(limits, Limits):
        raise UsageError(
            f"limits must be taut.Limits(...), such as taut.Limits.of(arm); got {type(limits).__name__}",
            name="limits",
        )
    named = _named(loops)
    if not named:
        raise UsageError("tune needs one loop at least; got none", name="loops")
    return _Problem(
        space=_Space(next(iter(named.values())), paths, bounds or {}),
        loops=named,
        cost=cost,
        limits={} if limits is None else {"tau": limits.tau, "tau_dot": limits.tau_dot},
        chatter=None if chatter is None else positive_scalar("chatter", chatter),
        q0=q0,
        seeds=[whole_number("seeds", seed, maximum=MAX_SEED) for seed in seeds],
        evaluations=evaluations,
        over=one_of("over", over, ("mean", "worst")),
    ).solved()


def _named(loops: Loops) -> dict[str, Loop]:
    """Loops by name; those without are numbered."""
    if isinstance(loops, Loop):
        loops = {"loop": loops}
    named = dict(loops) if isinstance(loops, Mapping) else {f"loop {i}": loop for i, loop in enumerate(loops)}
    for loop in named.values():
        if not isinstance(loop, Loop):
            raise UsageError(f"loops must be taut.Loop(ctrl, plant, ref, duration=...); got {loop!r}", name="loops")
        steps = next((path for path in loop.parameters if path.endswith(RESOLUTION)), None)
        if steps is not None:
            raise UsageError(f"the steps of {steps} have no derivative; tune with a plant without it", name="loops")
    return named


def _entries(path: str, values: Float64Array) -> list[str]:
    """A name for each entry of a parameter."""
    return [f"{path}[{i}]" for i in range(values.size)] if values.ndim else [path]


class _Space:
    """Parameters by path as x from 0 to 1 between their bounds, logarithmic where both bounds are positive."""

    def __init__(self, loop: Loop, paths: Sequence[str], bounds: Mapping[str, tuple[ArrayLike, ArrayLike]]) -> None:
        if isinstance(paths, str) or not paths:
            raise UsageError(
                f"paths must be names of parameters, such as ('law.kp', 'law.kd'); got {paths!r}", name="paths"
            )
        for path in bounds:
            if path not in paths:
                raise unknown_name("paths", "parameter", path, paths)
        self.start = {path: np.array(loop.parameters[path]) for path in paths}
        pairs = [_bounds_of(path, value, bounds.get(path)) for path, value in self.start.items()]
        self._low, self._high = (np.concatenate(column) for column in zip(*pairs, strict=True))
        self._log = self._low > 0.0
        self._from, to = self._to_scale(self._low), self._to_scale(self._high)
        self._span = to - self._from

    def _to_scale(self, flat: Float64Array) -> Float64Array:
        return np.where(self._log, np.log(np.where(self._log, flat, 1.0)), flat)

    def scaled(self, values: Mapping[str, Float64Array]) -> Float64Array:
        """(m,) the numbers of parameters."""
        flat = np.concatenate([np.ravel(values[path]) for path in self.start])
        return np.asarray((self._to_scale(flat) - self._from) / self._span)

    def _flat(self, x: Float64Array) -> Float64Array:
        linear = self._from + x * self._span
        return np.clip(np.where(self._log, np.exp(np.where(self._log, linear, 0.0)), linear), self._low, self._high)

    def _by_path(self, rows: Float64Array) -> dict[str, Float64Array]:
        """(..., m) numbers as (..., shape) for each path."""
        parts = np.split(rows, np.cumsum([value.size for value in self.start.values()])[:-1], axis=-1)
        return {
            path: part.reshape((*rows.shape[:-1], *value.shape))
            for (path, value), part in zip(self.start.items(), parts, strict=True)
        }

    def values(self, x: Float64Array) -> dict[str, Float64Array]:
        """The parameters."""
        return self._by_path(self._flat(x))

    def directions(self, x: Float64Array) -> dict[str, Float64Array]:
        """By path (m, ...) the derivative by each number."""
        return self._by_path(np.diag(self._span * np.where(self._log, self._flat(x), 1.0)))

    def at_bounds(self, values: Mapping[str, Float64Array]) -> list[str]:
        """A sentence for each parameter that ends at a bound."""
        entries = [name for path, value in self.start.items() for name in _entries(path, value)]
        ends = zip(entries, self.scaled(values), strict=True)
        return [
            f"{name} ends at its {'low' if x <= AT_BOUND else 'high'} bound; bounds= moves it"
            for name, x in ends
            if not AT_BOUND < x < 1.0 - AT_BOUND
        ]


def _bounds_of(
    path: str, value: Float64Array, bounds: tuple[ArrayLike, ArrayLike] | None
) -> tuple[Float64Array, Float64Array]:
    """(m,) the low and the high bounds of a parameter."""
    if value.ndim > 1:
        raise ShapeError(
            f"{path} is a matrix, which taut.tune would not keep symmetric and positive; give the law one number per "
            "joint or direction",
            name=path,
        )
    if bounds is None:
        if np.any(value <= 0.0):
            raise UsageError(
                f"{path} is {float(np.min(value)):g}, from which no bounds follow; give bounds={{'{path}': (low, "
                "high)}",
                name="bounds",
            )
        return np.ravel(value) / FACTOR, np.ravel(value) * FACTOR
    low, high = (np.ravel(finite_array(f"bounds of {path}", np.broadcast_to(side, value.shape))) for side in bounds)
    if np.any(low >= high) or np.any(np.ravel(value) < low) or np.any(np.ravel(value) > high):
        raise RangeError(
            f"bounds of {path} must have low < high and the start {value.tolist()!r} between them; got {bounds!r}",
            name="bounds",
        )
    return low, high


class _Stopped(Exception):  # noqa: N818  # no error: what ends an optimiser
    """The trials are used up."""


@dataclass(kw_only=True, eq=False)
class _Problem:
    """Cost and constraints of loops that share parameters, with their derivatives."""

    space: _Space
    loops: Mapping[str, Loop]
    cost: str | Mapping[str, float]
    limits: Mapping[str, ArrayLike | None]
    chatter: float | None
    q0: ArrayLike | None
    seeds: Sequence[int]
    evaluations: int
    over: str

    def __post_init__(self) -> None:
        paths = tuple(self.space.start)
        self._gradients = {name: RunGradient(loop, paths, self.cost) for name, loop in self.loops.items()}
        self._trials: dict[bytes, Trial] = {}  # by the point, in the order of the trials
        self._failures: list[str] = []
        self._first: dict[str, LoopFigures] = {}  # of each loop at the start

    def solved(self) -> Tuned:
        """The best parameters."""
        space, x0, notes = self.space, self.space.scaled(self.space.start), []
        worst, m, slacks = len(self._trial(x0).costs) > 1, len(x0), len(self._trial(x0).slacks)

        def cost(x: Float64Array) -> tuple[float, Float64Array]:  # x, and s behind it where the worst is minimised
            if worst:
                return float(x[m]), np.eye(m + 1)[m]
            trial = self._trial(x)
            return min(trial.cost, NO_COST), trial.gradients[0]

        def room(x: Float64Array) -> Float64Array:
            trial = self._trial(x[:m])
            left = x[m] - np.minimum(trial.costs, NO_COST) if worst else []
            return np.array([*left, *trial.slacks.values()])

        def room_slopes(x: Float64Array) -> Float64Array:
            trial = self._trial(x[:m])
            if not worst:
                return trial.slack_gradients
            rows = np.vstack([-trial.gradients, trial.slack_gradients])
            return np.hstack([rows, np.r_[np.ones(len(trial.costs)), np.zeros(slacks)][:, np.newaxis]])

        ends = Bounds(np.zeros(m + worst), np.r_[np.ones(m), [NO_COST] * worst])
        constraints = [{"type": "ineq", "fun": room, "jac": room_slopes}] if worst or slacks else []
        try:
            minimize(
                cost, np.r_[x0, [1.0] * worst], jac=True, method="SLSQP", bounds=ends, constraints=constraints,
                options={"ftol": COST_TOLERANCE, "maxiter": 200},
            )  # fmt: skip
        except _Stopped:
            notes.append(f"ended after {count_of(self.evaluations, 'trial')}, which evaluations= allows")
        except KeyboardInterrupt:
            notes.append(f"interrupted after {count_of(len(self._trials), 'trial')}; this is the best of them")
        history = tuple(self._trials.values())
        best = min((trial for trial in history if trial.ok), key=lambda trial: trial.cost, default=history[0])
        if self._failures:
            notes.append(f"{count_of(len(self._failures), 'trial')} failed, the first: {self._failures[0]}")
        if not best.ok:
            nearest = max((trial for trial in history if trial.figures), key=lambda trial: min(trial.slacks.values()))
            what, slack = min(nearest.slacks.items(), key=lambda pair: pair[1])
            notes.append(f"no trial keeps to the constraints; the nearest misses the {what} by {-slack:.3g} of it")
        elif best is history[0]:
            notes.append("no trial was better than the start, which is kept")
        else:
            notes += space.at_bounds(best.parameters)
        first = next(iter(self.loops.values()))
        values = {path: np.array(value) for path, value in {**first.parameters, **best.parameters}.items()}
        return Tuned(
            law=first.side.single_law.bound(subtree(values, "law")),
            parameters=best.parameters,
            start=space.start,
            cost=best.cost,
            history=history,
            before=history[0].figures,
            after=best.figures,
            notes=tuple(notes),
        )

    def _trial(self, x: Float64Array) -> Trial:
        """Cost and constraints at a point."""
        x = np.clip(np.asarray(x, dtype=np.float64), 0.0, 1.0)
        if (known := self._trials.get(x.tobytes())) is not None:
            return known
        if len(self._trials) >= self.evaluations:
            raise _Stopped
        start = next(iter(self._trials.values()), None)
        try:
            trial = self._evaluated(x)
        except (RangeError, NumericalError) as cause:  # a run that diverges, a rate that a gain does not fit
            if start is None:
                raise RangeError(
                    f"the start needs a finite cost above 0: {cause}; begin with parameters that are stable",
                    name="cost",
                ) from cause
            self._failures.append(str(cause).split(";")[0])
            trial = Trial(
                parameters=self.space.values(x), cost=math.inf, slacks=dict.fromkeys(start.slacks, -1.0), figures=(),
                costs=np.full(len(start.costs), np.inf), gradients=0.0 * start.gradients,
                slack_gradients=0.0 * start.slack_gradients,
            )  # fmt: skip
        self._trials[x.tobytes()] = trial
        return trial

    def _evaluated(self, x: Float64Array) -> Trial:
        figures, costs = [], []
        slacks: dict[str, Slope] = {}
        for name, loop in self.loops.items():
            runs = self._runs(name, loop, x)
            each = self._figures(name, runs)
            first = self._first.setdefault(name, each)
            if not math.isfinite(each.cost) or first.cost <= 0.0:
                raise RangeError(f"the cost of '{name}' is {each.cost:g}")
            figures.append(each)
            costs.append(_mean([run.mean_cost() for run in runs]))
            slacks |= {f"{what} of '{name}'": slack for what, slack in self._slacks(loop, runs, first)}
        scales = [each.cost for each in self._first.values()]
        if self.over == "worst":
            scales = [max(scales)] * len(scales)
        costs = [_scaled(each, 1.0 / scale) for each, scale in zip(costs, scales, strict=True)]
        judged = costs if self.over == "worst" else [_mean(costs)]
        return Trial(
            parameters=self.space.values(x),
            cost=max(value for value, _ in judged),
            slacks={what: value for what, (value, _) in slacks.items()},
            figures=tuple(figures),
            costs=np.array([value for value, _ in judged]),
            gradients=np.array([slopes for _, slopes in judged]),
            slack_gradients=np.array([slopes for _, slopes in slacks.values()]).reshape(len(slacks), len(x)),
        )

    def _runs(self, name: str, loop: Loop, x: Float64Array) -> list[RunSlopes]:
        """A run for each seed, from where the reference starts, if that is one of joints."""
        first = loop.ref.at(0.0) if isinstance(loop.ref, Trajectory) else None
        q, v = state_at_start(loop.plant.arm, getattr(first, "q", None) if self.q0 is None else self.q0, None)
        values, directions = self.space.values(x), self.space.directions(x)
        return [self._gradients[name].at(values, directions, q, v, seed) for seed in self.seeds]

    def _figures(self, name: str, runs: Sequence[RunSlopes]) -> LoopFigures:
        tau, tau_dot = self.limits.get("tau"), self.limits.get("tau_dot")
        return LoopFigures(
            name=name,
            cost=_mean([run.mean_cost() for run in runs])[0],
            rms_error=float(np.mean([np.sqrt(np.mean(run.error**2)) for run in runs])),
            effort=float(np.mean([run.dt * np.sum(run.tau[:-1] ** 2) for run in runs])),
            torque=max(run.largest(tau)[0] for run in runs),
            rate=max(run.largest(tau_dot, rate=True)[0] for run in runs),
            chatter=_mean([run.chatter() for run in runs])[0],
        )

    def _slacks(self, loop: Loop, runs: Sequence[RunSlopes], first: LoopFigures) -> Iterator[tuple[str, Slope]]:
        """What remains of each constraint of a loop, relative, with its derivatives."""
        for what, name in (("torque limit", "tau"), ("limit of the torque rate", "tau_dot")):
            limit, own = self.limits.get(name), loop.parameters.get(f"limits.{name}")
            if limit is None or (own is not None and np.all(own <= np.asarray(limit) * (1.0 + CONSTRAINT_TOLERANCE))):
                continue  # the controller keeps to it
            used, slopes = max((run.largest(limit, rate=name == "tau_dot") for run in runs), key=lambda pair: pair[0])
            yield what, (1.0 - used, -slopes)
        if self.chatter is not None:
            used, slopes = _scaled(_mean([run.chatter() for run in runs]), 1.0 / (self.chatter * first.chatter))
            yield "chatter", (1.0 - used, -slopes)


def _mean(pairs: Sequence[Slope]) -> Slope:
    values, slopes = zip(*pairs, strict=True)
    return float(np.mean(values)), np.mean(slopes, axis=0)


def _scaled(pair: Slope, factor: float) -> Slope:
    return factor * pair[0], factor * pair[1]
