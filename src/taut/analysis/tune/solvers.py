"""The ways to solve a tuning problem: SciPy's optimisers, and what is made of where they end."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from scipy.optimize import Bounds, NonlinearConstraint, differential_evolution, minimize

from taut.analysis.tune.problem import Problem, Stopped
from taut.analysis.tune.result import Measured, Trial, Tuned
from taut.base.errors import count_of
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.loop import Loop

__all__ = ["solved"]

MEMBERS: Final = 8  # of a population, for each number that is searched for
LEAST: Final = 12
FAR: Final = 1e6  # stands for a cost that is none
TOLERANCE: Final = 1e-5


def solved(problem: Problem, method: str, seed: int, held_out: dict[str, Loop]) -> Tuned:
    """What a method finds; of what ends it early, a sentence, and the best so far."""
    ended = ""
    try:
        if method == "gradient":
            _gradient(problem)
        else:
            _search(problem, seed)
    except Stopped as stopped:
        ended = str(stopped)
    except KeyboardInterrupt:
        ended = f"interrupted after {count_of(len(problem.history), 'trial')}; this is the best of them"
    except Exception as wrong:
        if not problem.history or isinstance(wrong, (AssertionError, MemoryError)):
            raise
        count = count_of(len(problem.history), "trial")
        ended = f"ended by {type(wrong).__name__}: {wrong}, after {count}; this is the best of them"
    finally:
        problem.restore()
    return _result(problem, method, ended, held_out)


def _search(problem: Problem, seed: int) -> None:
    space = problem.space
    size = max(LEAST, MEMBERS * space.size)

    def cost(x: Float64Array) -> float:
        found = problem.answer(x).cost
        return found if math.isfinite(found) else FAR

    def slacks(x: Float64Array) -> Float64Array:
        return problem.answer(x).slacks

    constraints: Any = NonlinearConstraint(slacks, 0.0, np.inf) if problem.constraints else ()
    differential_evolution(
        cost, [(0.0, 1.0)] * space.size, x0=space.start, rng=np.random.default_rng(seed), constraints=constraints,
        init=_population(space.start, size, seed), polish=False, tol=TOLERANCE, maxiter=1000,
    )  # fmt: skip


def _population(start: Float64Array, size: int, seed: int) -> Float64Array:
    """(size, m) of which half is near the start, where people begin with what is not far off."""
    rng = np.random.default_rng([seed, 1])
    members = rng.random((size, len(start)))
    near = np.clip(start + 0.15 * rng.standard_normal((size // 2, len(start))), 0.0, 1.0)
    members[: size // 2] = near
    members[0] = start
    return members


def _gradient(problem: Problem) -> None:
    space = problem.space

    def cost(x: Float64Array) -> tuple[float, Float64Array]:
        found = problem.answer(x)
        assert found.gradient is not None
        return (found.cost if math.isfinite(found.cost) else FAR), found.gradient

    constraints: list[Any] = []
    if problem.constraints:
        constraints = [
            {
                "type": "ineq",
                "fun": lambda x: problem.answer(x).slacks,
                "jac": lambda x: problem.answer(x).slack_gradients,
            }
        ]
    minimize(
        cost, space.start, jac=True, method="SLSQP", bounds=Bounds(np.zeros(space.size), np.ones(space.size)),
        constraints=constraints, options={"ftol": 1e-7, "maxiter": 200},
    )  # fmt: skip


def _result(problem: Problem, method: str, ended: str, held_out: dict[str, Loop]) -> Tuned:
    space = problem.space
    start = Trial(parameters=space.first, cost=1.0, slack=0.0)
    best = problem.best
    notices = [ended] if ended else []
    kept = bool(problem.history) and problem.history[0].ok  # the first trial is the start
    if best is None or (kept and best.cost >= 1.0):
        best = start
        if kept:
            notices.append("no trial was better than the start, which is kept")
        else:
            notices.append("no trial kept to the constraints, nor did the start, which is what there is")
            missed = problem.missed()
            notices += [f"the nearest of them: {missed}"] if missed else []
    else:
        if not kept:
            lacks = (
                "keep to the constraints" if math.isfinite(problem.history[0].cost) else "have a cost, asked again"
            )
            notices.append(f"the start did not {lacks}; this is the best that does")
        notices += space.at_bounds(best.parameters)
    loops = {**problem.loops, **held_out}
    firsts = {name: {path: np.array(loop.parameters[path]) for path in space.paths} for name, loop in loops.items()}
    tables: list[tuple[Measured, ...]] = []
    try:
        for values in (space.first, best.parameters):
            rows = []
            for name, loop in loops.items():
                for path, value in values.items():
                    loop.parameters[path] = value
                rows.append(problem.measured(name, loop, held_out=name in held_out, after=values))
            tables.append(tuple(rows))
        first = next(iter(problem.loops.values()))
        side = first.side
        law = side.single_law.bound({path: np.array(x) for path, x in subtree(dict(first.parameters), "law").items()})
    finally:
        for name, loop in loops.items():
            for path, value in firsts[name].items():
                loop.parameters[path] = value
    return Tuned(
        law=law,
        parameters=best.parameters,
        start=space.first,
        cost=best.cost,
        history=tuple(problem.history),
        before=tables[0],
        after=tables[1],
        notices=(*problem.sentences(), *notices),
        method=method,
    )
