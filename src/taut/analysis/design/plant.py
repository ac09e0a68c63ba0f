"""What a design does on a plant of the user's own: whether that loop is stable, and whether its steps settle."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from taut.analysis.design.limits import DesignLimit, Tried, growth
from taut.analysis.design.trial import ANYWHERE, Numbers
from taut.base.errors import TautError
from taut.base.types import Float64Array
from taut.linear.linearise import Linearisation, linearise
from taut.loop import Loop

__all__ = ["plant_limits"]

GROWS: Final = 1e-9  # in a tick: less is rounding, or of what dry friction or play lets go


def plant_limits(tried: Tried, on_plant: tuple[Numbers | None, ...], step: Float64Array) -> Iterator[DesignLimit]:
    """Whether the loop is stable on the plant, with all that is wrong with it, and whether its steps settle there.

    Args:
        tried: What limits are read off.
        on_plant: What the steps did.
        step: (k,) the steps.
    """
    if tried.plant is None:
        return
    lin = _model(tried)
    if lin is not None and lin.radius > 1.0 + GROWS:
        worst = max(lin.modes, key=lambda mode: abs(mode.pole))
        yield DesignLimit(
            name="on plant", value=lin.radius, limit=1.0, unit="", ok=False,
            sentence=(
                f"on plant= the loop {growth(lin.radius)} in a tick, a swing of {worst.omega_n:.4g} rad/s; ask for a "
                "slower design, or another plant"
            ),
        )  # fmt: skip
        return
    late = [k for k, each in enumerate(on_plant) if each is not None and not math.isfinite(each.settling)]
    if late:
        d, size = tried.directions[late[0]], float(step[late[0]]) * tried.directions[late[0]].per_unit
        yield DesignLimit(
            name="on plant", value=math.inf, limit=tried.predicted[late[0]].numbers.settling, unit="s", ok=False,
            sentence=(
                f"on plant= a step of {size:.3g} {d.unit} along {d.name} is not within 2 % for good after "
                f"{float(tried.predicted[late[0]].t[-1]):.3g} s: it swings, sticks, or rests elsewhere"
            ),
        )  # fmt: skip
        return
    if not on_plant:
        return
    k = int(np.argmax([math.nan if each is None else each.settling for each in on_plant]))
    seen, expected = on_plant[k], tried.predicted[k].numbers.settling
    assert seen is not None
    yield DesignLimit(
        name="on plant", value=seen.settling, limit=expected, unit="s", ok=True,
        sentence=(
            f"on plant= all steps settle, that along {tried.directions[k].name} last, after {seen.settling:.4g} s, "
            f"where {expected:.4g} s are predicted"
        ),
    )  # fmt: skip


def _model(tried: Tried) -> Linearisation | None:
    """The linear model on the plant; None where it rests nowhere near, or has none."""
    assert tried.plant is not None
    loop = Loop(tried.bench.for_plant(tried.arm, tried.plant), tried.plant, duration=1.0)
    try:
        return linearise(loop, at=tried.q, within=ANYWHERE)
    except TautError:
        return None
