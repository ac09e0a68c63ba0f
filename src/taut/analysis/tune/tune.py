"""taut.tune: gains that make a cost of the closed loop small, by search or by its gradient, within constraints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, Literal

import numpy as np

from taut.analysis.tune.costs import Tick
from taut.analysis.tune.problem import Problem
from taut.analysis.tune.result import Trial, Tuned
from taut.analysis.tune.solvers import solved
from taut.base.checks import finite_scalar, one_of, positive_scalar
from taut.base.errors import RangeError, UsageError
from taut.base.types import ArrayLike
from taut.control.limits import Limits
from taut.loop import Loop

__all__ = ["Tick", "Trial", "Tuned", "tune"]

METHODS: Final = ("search", "gradient")
LARGEST_MARGIN: Final = 2.0  # of a loop that any gain and 90 degrees leave stable


def tune(
    loops: Loop | Sequence[Loop] | Mapping[str, Loop],
    paths: Sequence[str],
    *,
    cost: str | Mapping[str, float] | Callable[[Any], Any] = "tracking",
    method: Literal["search", "gradient"] = "search",
    bounds: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    limits: Limits | None = None,
    chatter: float | None = None,
    margin: float | None = None,
    q0: ArrayLike | None = None,
    seeds: Sequence[int] = (0,),
    seed: int = 0,
    evaluations: int = 300,
    held_out: Mapping[str, Loop] | Sequence[Loop] = (),
    progress: Callable[[Trial], bool | None] | None = None,
) -> Tuned:
    """Gains, or any parameters, with which a cost of closed loops is small, within constraints.

    Law:          minimise the mean over loops and seeds of cost / cost at the start, parameters between their bounds,
                  with |tau| <= limits.tau, |tau's change in a tick| <= limits.tau_dot dt, a chatter of at most
                  `chatter` times that at the start, and a disk margin of the linear loop of at least `margin`

    "search" is SciPy's differential evolution, for any cost; "gradient" is SciPy's SLSQP with the exact derivative of
    the loop as it is simulated, forward mode, every tick in native code, for costs that are a mean over the ticks.
    Limits of the controller itself always hold; those given here are not touched.

    Args:
        loops: One or more loops that share the parameters: paths to follow, payloads, plants. Their parameters are
            the start, and are what they were when it is done.
        paths: Such as ("law.kp", "law.kd"), "sensing.velocity.cutoff"; one number, or one per joint.
        cost: "tracking", "turning", "effort" or "speed", or weights of them, {"tracking": 1.0, "effort": 1e-6}; or a
            function: with "search" of the run, `cost(run)`, with "gradient" of a tick, `cost(tick)`, written with
            `taut.math` (see `Tick`), whose mean counts.
        method: "search" or "gradient".
        bounds: By path (low, high); a tenth and ten times the start if left out. Where both are above zero it is
            searched on a logarithmic scale.
        limits: To keep within: `taut.Limits.of(arm)`; None for none.
        chatter: Largest chatter in parts of that at the start: 1.0 for no more; None for any.
        margin: Least size alpha of the disk margin at the start of the run, 0 to 2 (see `LinearSystem.margins`).
        q0: (n,) where runs start [rad | m]; home, or where a reference of joints starts, if left out.
        seeds: Of the noise in the runs.
        seed: Of the search.
        evaluations: The most trials.
        held_out: Loops on which before and after are compared, and nothing is tuned.
        progress: Called with each trial; True ends the tuning.

    Raises:
        UsageError, RangeError, ShapeError, UnknownNameError: What has no meaning, by name; a start that has no cost.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=5.0, kd=0.5), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[1.0]), duration=1.0)
        >>> tuned = taut.tune(loop, ("law.kd",), method="gradient")
        >>> tuned.cost < 0.9, bool(tuned.parameters["law.kd"] > 1.0)
        (True, True)

    References:
        Griewank and Walther, Evaluating Derivatives (2008). Storn and Price, Differential evolution, J. Global
        Optimization 11 (1997). Kraft, DFVLR-FB 88-28 (1988), on SLSQP.
    """
    one_of("method", method, METHODS)
    if isinstance(evaluations, bool) or not isinstance(evaluations, int) or evaluations < 1:
        raise RangeError(f"evaluations must be a whole number >= 1; got {evaluations!r}", name="evaluations")
    for each in (*seeds, seed):
        if isinstance(each, bool) or not isinstance(each, (int, np.integer)) or each < 0:
            raise RangeError(f"seeds must be whole numbers >= 0; got {each!r}", name="seeds")
    if not len(seeds):
        raise UsageError("seeds must have one number at least", name="seeds")
    if limits is not None and not isinstance(limits, Limits):
        raise UsageError(
            f"limits must be taut.Limits(...), such as taut.Limits.of(arm); got {type(limits).__name__}",
            name="limits",
        )
    problem = Problem(
        named(loops, "loops"),
        paths,
        cost=cost,
        gradient=method == "gradient",
        bounds=bounds,
        limits=limits,
        chatter=None if chatter is None else positive_scalar("chatter", chatter),
        margin=None if margin is None else _margin(margin),
        q0=q0,
        seeds=tuple(int(each) for each in seeds),
        evaluations=evaluations,
        progress=progress,
    )
    return solved(problem, method, seed, named(held_out, "held_out"))


def _margin(given: float) -> float:
    margin = finite_scalar("margin", given)
    if not 0.0 < margin <= LARGEST_MARGIN:
        raise RangeError(
            f"margin is the least alpha of the disk margin, above 0 and at most {LARGEST_MARGIN:g}; got {given!r}",
            name="margin",
        )
    return margin


def named(loops: Loop | Sequence[Loop] | Mapping[str, Loop], name: str) -> dict[str, Loop]:
    """Loops by name; those without are numbered.

    Raises:
        UsageError: Something else, or none where some are needed.
    """
    if isinstance(loops, Loop):
        out = {"loop": loops}
    elif isinstance(loops, Mapping):
        out = dict(loops)
    else:  # one thing that is no loop is refused below
        out = {f"loop {i}": each for i, each in enumerate(loops if isinstance(loops, Iterable) else (loops,))}
    for each in out.values():
        if not isinstance(each, Loop):
            raise UsageError(f"{name} must be taut.Loop(ctrl, plant, ref, duration=...); got {each!r}", name=name)
    if not out and name == "loops":
        raise UsageError("tune needs a loop at least", name="loops")
    return out
