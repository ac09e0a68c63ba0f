"""What a design cannot be: which limit is in the way, and the nearest that can be met."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.maths.snapshot import Snapshot
from taut.study.design_asked import Asked, plain
from taut.study.design_directions import Direction, designed_part, fed_forward, weight_gradient
from taut.study.design_gains import Case, gains_for
from taut.study.design_limits import DesignLimit, growth
from taut.study.design_result import AtPose
from taut.study.design_trial import Bench, Numbers, Response
from taut.study.linear_loop import LinearLoop

__all__ = ["LEAST", "Refusals", "TriedAt", "kept_of"]

HALVINGS: Final = 40
SLOWEST: Final = 1e-7  # of an error in a tick: less cannot be told from none, for rounding splits a pair so far
STAYS: Final = 1e-12  # of the fastest pole: one that is slower is of what nothing draws back
LEAST_FACTOR: Final = 1e-16  # of what was asked: slower is not searched
SLOWER: Final = 1e-3  # of what is stable: slower is not searched for more damping
LEAST: Final = 0.5  # of a damping ratio that the book has: what a sampled loop must keep
MOST: Final = 0.9  # what one that is named as possible keeps, where one can
BARELY: Final = 0.55  # what it keeps where none can
FASTER: Final = 2.0**10  # of what was asked: faster is not searched for one that does not fall over
BELOW: Final = 0.99  # of a border: what is named as possible
CLOSE: Final = 1e-3  # of a border
NEAR: Final = 1e-2  # of one of damping, each trial of which is a simulation

TriedAt = tuple[AtPose, tuple[Direction, ...], tuple[Numbers, ...], tuple[Response, ...]]
"""A pose, its directions, what they are by the book, and steps of the linear model along them."""


class Refusals:
    """What refuses a design, and looks for the nearest that it would take.

    Args:
        case: The law, the arm and what was asked.
        bench: Where it is tried.
        at: What a model at a pose does.
    """

    def __init__(self, case: Case, bench: Bench, at: Callable[[Snapshot, LinearLoop], TriedAt]) -> None:
        self.case, self.bench, self._at = case, bench, at
        self._shares: dict[float, float] = {}

    # ---------------------------------------------------------------- what is in the way

    def require_pace(self, poles: Sequence[Any]) -> None:
        """What takes less of an error away in a tick than rounding sets poles apart cannot be told from standing."""
        rates = [rate for s in poles for rate in -s.real if rate > STAYS * np.abs(s).max()]
        slowest = float(min(rates, default=math.inf)) / self.bench.ctrl.rate
        if slowest < SLOWEST:
            raise RangeError(
                f"{self._what} cannot be tried at {self._where}: its slowest pole takes {slowest:.2g} of an error "
                f"away in a tick, and rounding hides less than {SLOWEST:g}; ask for a faster design, or a lower rate",
                name=self._name,
                value=slowest,
                rule=f">= {SLOWEST:g} in a tick",
            )

    def unstable(self, models: list[LinearLoop]) -> RangeError:
        """Some model is not stable."""
        radius = max(lin.radius for lin in models)
        why, nearest = "", self._nearest
        if self._falls():
            why = (
                ", for its kp is less than the weight's gradient dg/dq takes off it, which FeedForward compensates "
                "along the reference only, at any rate"
            )
            nearest = self._upwards
        return RangeError(
            f"{self._what} cannot be met: at {self._where} the sampled loop {growth(radius)} in a tick{why}; "
            f"{nearest()}",
            name=self._name,
            value=radius,
            rule="stable",
        )

    def undamped(self, kept: float) -> RangeError:
        """What the sampled loop keeps of the damping is too little."""
        return RangeError(
            f"{self._what} cannot be met: the sampled loop keeps {100.0 * kept:.2g} % of the damping ratio at "
            f"{self._where}; {self._nearest()}",
            name=self._name,
            value=kept,
            rule=f">= {LEAST:g} of the damping ratio",
        )

    def step(self, limit: DesignLimit, step: Float64Array, again: Callable[[], DesignLimit]) -> RangeError:
        """A step that was asked for is too much.

        Args:
            limit: Of the torque or of the speed that it takes.
            step: As it was given.
            again: The same limit for the gains that the bench has by then.
        """
        share = limit.limit / limit.value
        nearest = plain(step * share * BELOW)
        first = share if limit.name == "speed" else math.sqrt(share)
        factor = None  # a slower pole of a force presses as hard
        if self.case.asked.force is None:
            factor = _largest(lambda f: self._share(f) >= LEAST and again().ok, first, first * SLOWER, NEAR)
        can = "" if factor is None or not self._slower(factor) else f"{self._slower(factor)} can, or "
        return RangeError(
            f"step = {plain(step)} cannot be met: {limit.sentence}; {can}a step of {nearest}{'' if can else ' can'}",
            name="step",
            value=limit.value,
            rule=f"<= {limit.limit:.4g}",
        )

    # ---------------------------------------------------------------- the nearest that can

    def _nearest(self) -> str:
        """The way out: the fastest design that is taken; with an integral, else the largest one that is."""
        stable = _largest(lambda f: self._models(self.case.asked.faster(f)) is not None)
        if stable is not None:
            for share in (MOST, BARELY):
                good = partial(self._keeps, share)
                factor = _largest(good, min(stable, 1.0), max(stable * SLOWER, LEAST_FACTOR), NEAR)
                if factor is not None and self._slower(factor):
                    return self._can(factor, stable)
        if self.case.asked.integral:
            part = _largest(lambda f: self._kept(self._integrated(f)) >= BARELY, close=NEAR)
            if part is not None:
                return f"the nearest that can has integral = {part * self.case.asked.integral:.4g}"
        return "no slower design can either; raise the rate, or ask for another damping"

    def _falls(self) -> bool:
        """Whether the arm falls over, as one above the horizontal does with too small a kp."""
        law = self.bench.law
        if not fed_forward(law):
            return False
        part: Any = designed_part(law)
        return any(np.linalg.eigvalsh(part.kp.matrix(x.n) + weight_gradient(x))[0] <= 0.0 for x in self.case.at)

    def _upwards(self) -> str:
        """The slowest design that does not fall over."""
        other = "GravityPID compensates the weight where the arm is"
        low, high = 1.0, 2.0
        while not self._keeps(BARELY, high):
            low, high = high, 2.0 * high
            if high > FASTER:
                return f"no faster design of it can either; {other}"
        while high / low > 1.0 + NEAR:
            middle = math.sqrt(low * high)
            low, high = (low, middle) if self._keeps(BARELY, middle) else (middle, high)
        return f"the nearest that can has {self._slower(high / BELOW)}; {other}"

    def _can(self, factor: float, stable: float) -> str:
        kept = self._share(factor)
        with_ = f", which keeps {100.0 * min(kept, 1.0):.0f} % of the damping ratio" if math.isfinite(kept) else ""
        border = "" if stable <= factor * (1.0 + 2.0 * CLOSE) else f"; it is stable up to {self._slower(stable)}"
        return f"the nearest that can has {self._slower(factor)}{with_}{border}"

    def _integrated(self, factor: float) -> Asked:
        return dataclasses.replace(self.case.asked, integral=self.case.asked.integral * factor)

    def _models(self, asked: Asked) -> list[LinearLoop] | None:
        """The models of another design; None where there is none, or one is not stable."""
        try:
            self.bench.set_gains(gains_for(dataclasses.replace(self.case, asked=asked)))
            models = [self.bench.linear(np.asarray(x.q)) for x in self.case.at]
        except RangeError:
            return None
        return models if all(lin.stable for lin in models) else None

    def _kept(self, asked: Asked) -> float:
        """The least share of a damping ratio that another design keeps; below none where it is refused."""
        models = self._models(asked)
        if models is None:
            return -math.inf
        tried = [self._at(x, lin) for x, lin in zip(self.case.at, models, strict=True)]
        try:
            self.require_pace([d.dynamics.poles for _, directions, _, _ in tried for d in directions])
        except RangeError:
            return -math.inf
        return kept_of(tried)

    def _share(self, factor: float) -> float:
        return self._kept(self.case.asked.faster(factor))

    def _keeps(self, share: float, factor: float) -> bool:
        if factor not in self._shares:
            self._shares[factor] = self._share(factor)
        return self._shares[factor] >= share

    # ---------------------------------------------------------------- words

    @property
    def _what(self) -> str:
        return ", ".join(f"{name} = {plain(value)}" for name, value in self.case.asked.given.items())

    @property
    def _name(self) -> str:
        return next(iter(self.case.asked.speeds), "K")

    def _slower(self, factor: float) -> str:
        """What changes in a design that is so much faster, in words."""
        asked, slower = self.case.asked.given, self.case.asked.faster(factor).given
        changed = [name for name in slower if np.any(np.asarray(slower[name]) != np.asarray(asked[name]))]
        return " and ".join(f"{name} = {plain(slower[name])}" for name in changed)

    @property
    def _where(self) -> str:
        delay = float(self.bench.plant.actuation.delay)
        velocity = self.bench.ctrl.side.sensing.velocity
        cutoff = None if isinstance(velocity, str) else getattr(velocity, "cutoff", None)
        parts = [f"{self.bench.ctrl.rate:g} Hz"]
        if delay:
            parts.append(f"{1e3 * delay:g} ms of delay")
        if cutoff is not None:
            parts.append(f"a low-pass of {float(np.min(cutoff)):g} Hz in the velocity")
        if not self.bench.motion.exact:
            parts.append(f"{self.bench.motion.steps}, as plant= has it,")
        return " and ".join(parts)


def kept_of(tried: Sequence[TriedAt]) -> float:
    """The least share of a damping ratio that the sampled loop keeps of what the book has, over all poses.

    More than one counts as one: what creeps in the book and creeps less in the loop has lost nothing.
    """
    least = math.inf
    for _, _, designed, predicted in tried:
        for book, response in zip(designed, predicted, strict=True):
            if book.zeta > 0.0:
                least = min(least, response.numbers.zeta / min(book.zeta, 1.0))
    return least


def _largest(
    good: Callable[[float], bool], start: float = 1.0, least: float = LEAST_FACTOR, close: float = CLOSE
) -> float | None:
    """The largest factor up to a start at which a design is good, a little below the border; None for none."""
    low = high = start * BELOW
    while not good(low):
        low, high = 0.5 * low, low
        if low < least:
            return None
    if low == high:
        return low
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if good(middle) else (low, middle)
        if high / low < 1.0 + close:
            break
    return BELOW * low
