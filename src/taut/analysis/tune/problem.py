"""The problem that tuning solves: cost, constraints and, where wanted, their gradients, for a point of a box."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.analysis.tune.costs import Raised, asked, largest, named_costs, of_run, stage_of, traced
from taut.analysis.tune.gradient import TangentLoop
from taut.analysis.tune.result import Measured, Trial
from taut.analysis.tune.space import Space
from taut.base.errors import NumericalError, RangeError, UsageError, count_of
from taut.base.types import ArrayLike, Float64Array
from taut.control.limits import Limits
from taut.control.trajectories.reference import Hold
from taut.linear.linearise import linearise
from taut.loop import Loop, state_at_start
from taut.record.run import Run
from taut.runtime.simulate import run as simulate

__all__ = ["Answer", "Problem", "Stopped"]

ROUNDING: Final = 1e-9  # of a limit
TICK: Final = "a taut.analysis.Tick: t, q, v, tau, command, ref, e, turned, pose, loop"
WHAT: Final = {"tau": "the torque", "tau_dot": "the torque rate", "chatter": "the chatter"}
SHIFT: Final = 1e-5  # of a bound's width, for the gradient of a margin


class Stopped(Exception):  # noqa: N818  # no error: what ends an optimiser
    """Enough: by the callback, or because the trials are used up."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """What a point has.

    Args:
        cost: Over that of the start; infinite where a run diverges, NaN where the cost is.
        slacks: (c,) what is left of each constraint, in parts of it.
        gradient: (m,) of the cost; None where none is wanted.
        slack_gradients: (c, m).
    """

    cost: float
    slacks: Float64Array
    gradient: Float64Array | None = None
    slack_gradients: Float64Array | None = None


class Problem:
    """Cost and constraints of loops that share parameters.

    Raises:
        UsageError, RangeError, ShapeError, UnknownNameError: What has no meaning, by name; a start without a cost.
    """

    def __init__(
        self,
        loops: dict[str, Loop],
        paths: Sequence[str],
        *,
        cost: str | Mapping[str, float] | Callable[[Any], Any],
        gradient: bool,
        bounds: Mapping[str, tuple[ArrayLike, ArrayLike]] | None,
        limits: Limits | None,
        chatter: float | None,
        margin: float | None,
        q0: ArrayLike | None,
        seeds: tuple[int, ...],
        evaluations: int,
        progress: Callable[[Trial], bool | None] | None,
    ) -> None:
        self.loops, self.seeds, self.limits, self.chatter, self.margin = loops, seeds, limits, chatter, margin
        first = next(iter(loops.values()))
        self.space = Space(first, paths, bounds)
        self._firsts = {
            name: {path: np.array(loop.parameters[path]) for path in self.space.paths} for name, loop in loops.items()
        }
        self.weights = None if callable(cost) else named_costs(first, cost)
        self._cost = cost
        self._q0 = q0
        self._evaluations, self._progress = evaluations, progress
        self.history: list[Trial] = []
        self._slacks: list[Float64Array] = []  # of each trial
        self.notices: dict[str, tuple[int, str]] = {}
        self._known: dict[bytes, Answer] = {}
        self._tangents: dict[str, TangentLoop] = {}
        if gradient:
            stages = {
                name: stage_of(loop, traced(cost) if callable(cost) else self.weights or {})
                for name, loop in loops.items()
            }
            self._tangents = {name: TangentLoop(loop, self.space.paths, stages[name]) for name, loop in loops.items()}
        self.scales: dict[str, tuple[float, float]] = {}  # cost and chatter of each loop at the start
        self._measure_start()

    # ---------------------------------------------------------------- the start

    def _measure_start(self) -> None:
        for name, loop in self.loops.items():
            self._set(loop, self.space.first)
            try:
                each = self.measured(name, loop, held_out=False)
            except Raised as raised:
                method, takes = ("gradient", TICK) if self._tangents else ("search", "a taut.Run")
                raise UsageError(
                    f"{raised.what} at the start, of '{name}' with {_places(self.space.first)}: {raised}; it must be "
                    f"a finite number above 0 there, and with method='{method}' it is a function of {takes}",
                    name="cost",
                ) from raised.__cause__
            if not math.isfinite(each.cost) or each.cost <= 0.0:
                raise RangeError(
                    f"the cost of '{name}' at the start is {each.cost:g}, so that there is nothing to compare with; "
                    "it must be a finite number above 0: begin with parameters that are stable, or change the cost",
                    name="cost",
                    value=each.cost,
                )
            self.scales[name] = each.cost, each.chatter

    def at_start(self, loop: Loop) -> tuple[Float64Array, Float64Array]:
        """Where runs of a loop start: where its reference does, if that is one of joints."""
        if self._q0 is not None or not hasattr(loop.ref, "at"):
            return state_at_start(loop.plant.arm, self._q0, None)
        sample = loop.ref.at(0.0)
        q = getattr(sample, "q", None)
        return state_at_start(loop.plant.arm, q, None)

    def _set(self, loop: Loop, values: Mapping[str, Float64Array]) -> None:
        for path, value in values.items():
            loop.parameters[path] = value

    def restore(self) -> None:
        """Give the loops their own parameters again."""
        for name, loop in self.loops.items():
            self._set(loop, self._firsts[name])

    # ---------------------------------------------------------------- runs

    def _run(self, loop: Loop, seed: int) -> Run:
        q, v = self.at_start(loop)
        return simulate(loop, q0=q, v0=v, seed=seed, progress=False)

    def _cost_of(self, run: Run, loop: Loop) -> float:
        if self.weights is not None:
            return of_run(run, self.weights)
        assert callable(self._cost)
        if self._tangents:
            return self._mean_stage(run, loop)
        return asked(self._cost, run)

    def _mean_stage(self, run: Run, loop: Loop) -> float:
        """A cost of ticks, on the numbers of a run."""
        assert callable(self._cost)
        stage, kind = stage_of(loop, self._cost), loop.side.law.reference
        rows = {name: np.asarray(getattr(run.reference, name)) for name in kind.fields(run.n)}
        total = 0.0
        for k, t in enumerate(run.t):
            inputs = {"t": t, **{f"ref.{name}": row[k] for name, row in rows.items()}}
            record = {"q": run.q[k], "v": run.v[k], "tau": run.tau[k], "command": run.command[k]}
            total += asked(lambda given: stage(*given), (inputs, record))
        return total / len(run.t)

    def measured(
        self, name: str, loop: Loop, *, held_out: bool, after: Mapping[str, Float64Array] | None = None
    ) -> Measured:
        """What a loop does with the parameters that it has, mean over the seeds; of torque and rate the largest.

        Args:
            name: Of the loop.
            loop: The loop.
            held_out: Whether nothing is tuned for it.
            after: The parameters, where all trials are over: a cost that raises is then NaN, and a sentence.

        Raises:
            Raised: The cost raises.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # a run that grows may hold huge numbers
            table = np.array([self._numbers(self._run(loop, seed), loop, after) for seed in self.seeds])
            means = table.mean(axis=0)
        return Measured(
            name=name, held_out=held_out, cost=float(means[0]), rms_error=float(means[1]), effort=float(means[2]),
            torque=float(table[:, 3].max()), rate=float(table[:, 4].max()), chatter=float(means[5]),
        )  # fmt: skip

    def _numbers(self, run: Run, loop: Loop, after: Mapping[str, Float64Array] | None) -> list[float]:
        """Cost, RMS error, effort, shares of torque and rate, chatter of one run; no cost where it diverges."""
        if not run.outcome.ok:
            return [math.inf] + [math.nan] * 5
        error = run.error if run.error is not None else run.task.position_error if _of_tool(run) else None
        rms = math.nan if error is None else float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
        effort, chatter = (float(getattr(run.metrics, name).sum()) for name in ("effort", "chatter"))
        try:
            cost = self._cost_of(run, loop)
        except Raised as raised:
            if after is None:
                raise
            cost = math.nan
            self._notice(f"{raised.what} in the table of before and after", after, str(raised))
        return [cost, rms, effort, *self._shares(run.tau, loop), chatter]

    def _shares(self, tau: Float64Array, loop: Loop) -> tuple[float, float]:
        """Of the limits of torque and of its rate; NaN where there are none."""
        if self.limits is None:
            return math.nan, math.nan
        n = loop.plant.arm.n
        most, rate = (
            None if each is None else np.broadcast_to(np.asarray(each, dtype=np.float64), (n,))
            for each in (self.limits.tau, self.limits.tau_dot)
        )
        return (
            math.nan if most is None else largest(tau, most),
            math.nan if rate is None else largest(np.diff(tau, axis=0) / loop.dt, rate),
        )

    # ---------------------------------------------------------------- a point

    def answer(self, x: Float64Array) -> Answer:
        """Cost and constraints at a point between 0 and 1.

        Raises:
            Stopped: The callback says so, or the trials are used up.
        """
        x = np.clip(np.asarray(x, dtype=np.float64), 0.0, 1.0)
        key = x.tobytes()
        if key in self._known:
            return self._known[key]
        if len(self.history) >= self._evaluations:
            raise Stopped(f"ended after {count_of(self._evaluations, 'trial')}, which evaluations= allows")
        parameters = self.space.by_path(x)
        try:
            found = self._with_gradients(x) if self._tangents else self._plain(x)
        except (RangeError, NumericalError) as wrong:  # a rate that a gain does not fit, a run that diverges
            found = self._without(str(wrong).split(";")[0][:120], parameters)
        except Raised as raised:
            found = self._without(raised.what, parameters, str(raised))
        if math.isnan(found.cost):
            self._notice("the cost was NaN", parameters)
        self._known[key] = found
        slack = float(found.slacks.min(initial=1.0))
        trial = Trial(parameters=parameters, cost=found.cost, slack=slack)
        self.history.append(trial)
        self._slacks.append(found.slacks)
        if self._progress is not None and self._progress(trial):
            raise Stopped(f"ended by progress after {count_of(len(self.history), 'trial')}")
        return found

    def _notice(self, what: str, parameters: Mapping[str, Float64Array], more: str = "") -> None:
        count, first = self.notices.get(what, (0, ""))
        self.notices[what] = count + 1, first or _places(parameters) + (f": {more}" if more else "")

    def _without(self, why: str, parameters: Mapping[str, Float64Array], more: str = "") -> Answer:
        self._notice(why, parameters, more)
        count = len(self._names())
        m = self.space.size
        wanted = bool(self._tangents)
        return Answer(
            cost=math.inf,
            slacks=np.full(count, -1.0),
            gradient=np.zeros(m) if wanted else None,
            slack_gradients=np.zeros((count, m)) if wanted else None,
        )

    def _kept_anyway(self, loop: Loop, name: str) -> bool:
        """Whether the loop's own controller cuts what would be beyond a limit, so that it constrains nothing."""
        own, most = loop.parameters.get(f"limits.{name}"), getattr(self.limits, name)
        return own is not None and most is not None and bool(np.all(own <= np.asarray(most) * (1.0 + ROUNDING)))

    def _limited(self, loop: Loop) -> tuple[str, ...]:
        """Which limits constrain a loop: tau, tau_dot."""
        if self.limits is None:
            return ()
        given = [name for name in ("tau", "tau_dot") if getattr(self.limits, name) is not None]
        return tuple(name for name in given if not self._kept_anyway(loop, name))

    def _names(self) -> list[str]:
        """Of the constraints."""
        more = ["chatter"] * (self.chatter is not None) + ["margin"] * (self.margin is not None)
        return [f"{name} of {title}" for title, loop in self.loops.items() for name in (*self._limited(loop), *more)]

    def _plain(self, x: Float64Array) -> Answer:
        values, costs, slacks = self.space.by_path(x), [], []
        for name, loop in self.loops.items():
            self._set(loop, values)
            found = self.measured(name, loop, held_out=False)
            if math.isinf(found.cost):
                return self._without("a run diverged", values)
            costs.append(found.cost / self.scales[name][0])
            shares = {"tau": found.torque, "tau_dot": found.rate}
            slacks += [1.0 - shares[limit] for limit in self._limited(loop)]
            if self.chatter is not None:
                slacks.append(1.0 - found.chatter / (self.chatter * self.scales[name][1]))
            if self.margin is not None:
                slacks.append(self._margin(loop) - self.margin)
        return Answer(cost=float(np.mean(costs)), slacks=np.array(slacks))

    def _margin(self, loop: Loop) -> float:
        """The disk margin where the run starts, held there."""
        kept, q = loop.ref, self.at_start(loop)[0]
        try:
            loop.ref = Hold()
            return float(linearise(loop, at=q).margins().disk.alpha)
        finally:
            loop.ref = kept

    # ---------------------------------------------------------------- gradients

    def _with_gradients(self, x: Float64Array) -> Answer:
        values, ways, m = self.space.by_path(x), self.space.ways(x), self.space.size
        costs, gradients = [], []
        slacks: list[float] = []
        slack_ways: list[Float64Array] = []
        for name, loop in self.loops.items():
            self._set(loop, values)
            q, v = self.at_start(loop)
            cost, way, chatter, chatter_way = 0.0, np.zeros(m), 0.0, np.zeros(m)
            torque, rate = (-math.inf, np.zeros(m)), (-math.inf, np.zeros(m))
            for seed in self.seeds:
                along = self._tangents[name].along(ways, q, v, seed)
                cost += float(along.stage.mean())
                way = way + along.stage_ways.mean(axis=1)
                steps, step_ways = np.diff(along.tau, axis=0), np.diff(along.tau_ways, axis=1)
                seconds = len(steps) * loop.dt
                chatter += float(np.abs(steps).sum()) / seconds
                chatter_way = chatter_way + (np.sign(steps) * step_ways).sum(axis=(1, 2)) / seconds
                if self.limits is not None:
                    torque = _worse(torque, along.tau, along.tau_ways, self.limits.tau)
                    rate = _worse(rate, steps / loop.dt, step_ways / loop.dt, self.limits.tau_dot)
            count, (first, chattered) = len(self.seeds), self.scales[name]
            costs.append(cost / count / first)
            gradients.append(way / count / first)
            shares = {"tau": torque, "tau_dot": rate}
            for limit in self._limited(loop):
                slacks.append(1.0 - shares[limit][0])
                slack_ways.append(-shares[limit][1])
            if self.chatter is not None:
                slacks.append(1.0 - chatter / count / (self.chatter * chattered))
                slack_ways.append(-chatter_way / count / (self.chatter * chattered))
            if self.margin is not None:
                slacks.append(self._margin(loop) - self.margin)
                slack_ways.append(self._margin_way(loop, x))
                self._set(loop, values)
        return Answer(
            cost=float(np.mean(costs)),
            slacks=np.array(slacks),
            gradient=np.mean(gradients, axis=0),
            slack_gradients=np.array(slack_ways).reshape(len(slacks), m),
        )

    def _margin_way(self, loop: Loop, x: Float64Array) -> Float64Array:
        """(m,) by central differences: a margin is a number of the linear model, which is quick."""
        out = np.zeros(len(x))
        for i in range(len(x)):
            sides = []
            for shift in (SHIFT, -SHIFT):
                moved = x.copy()
                moved[i] = np.clip(moved[i] + shift, 0.0, 1.0)
                self._set(loop, self.space.by_path(moved))
                sides.append((moved[i], self._margin(loop)))
            out[i] = (sides[0][1] - sides[1][1]) / (sides[0][0] - sides[1][0])
        return out

    # ---------------------------------------------------------------- the best

    @property
    def constraints(self) -> int:
        """Number of constraints."""
        return len(self._names())

    @property
    def best(self) -> Trial | None:
        """The least cost of those that keep to the constraints."""
        kept = [trial for trial in self.history if trial.ok]
        return min(kept, key=lambda trial: trial.cost, default=None)

    def missed(self) -> str:
        """Which constraint the trial misses that keeps to them best, and by how much; nothing where none ran."""
        ran = [k for k, trial in enumerate(self.history) if math.isfinite(trial.cost)]
        if not ran or not self.constraints:
            return ""
        k = max(ran, key=lambda i: self.history[i].slack)
        i = int(np.argmin(self._slacks[k]))
        name, slack = self._names()[i], float(self._slacks[k][i])
        kind, _, loop = name.partition(" of ")
        if kind == "margin":
            assert self.margin is not None
            words = f"the disk margin of '{loop}' is {self.margin + slack:.4g} where {self.margin:g} is asked for"
        else:
            words = f"{WHAT[kind]} of '{loop}' is {1.0 - slack:.4g} times what is allowed"
        return f"{words}, with {_places(self.history[k].parameters)}"

    def sentences(self) -> list[str]:
        """What happened on the way."""
        return [
            f"{what}, {count_of(count, 'time')}, first at {where}" for what, (count, where) in self.notices.items()
        ]


def _places(parameters: Mapping[str, Float64Array]) -> str:
    """Where that was."""
    return ", ".join(f"{path} = {np.array2string(np.asarray(x), precision=5)}" for path, x in parameters.items())


def _of_tool(run: Run) -> bool:
    return hasattr(run.reference.motion, "pose")


def _worse(
    before: tuple[float, Float64Array], rows: Float64Array, ways: Float64Array, limits: ArrayLike | None
) -> tuple[float, Float64Array]:
    """The larger of two shares of a limit, each with its derivative where it is largest."""
    if limits is None:
        return before
    most = np.broadcast_to(np.asarray(limits, dtype=np.float64), rows.shape[1:])
    share = np.abs(rows) / most
    k, i = np.unravel_index(int(np.argmax(share)), share.shape)
    if share[k, i] <= before[0]:
        return before
    return float(share[k, i]), np.sign(rows[k, i]) * ways[:, k, i] / most[i]
