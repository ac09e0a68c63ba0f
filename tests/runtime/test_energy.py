"""What an arm under impedance control gives back, pushed or touching passive things, on both sides of the passive region."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from energy_cases import HELD, PUSHED, Bench, Case

ARMS = ("ur10", "xarm7", "panda", "kinova")  # the last one only when all was written
EACH = 60


@pytest.mark.bars
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_inside_the_region_no_arm_gives_energy_and_outside_the_report_has_said_so(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    """Of a measured velocity against pushes below 20 Hz, of a differenced one against every passive thing."""
    count = share(EACH * len(ARMS))
    cases: list[Case] = []
    for i, name in enumerate(ARMS):
        seeds = range(i * EACH, min(count, (i + 1) * EACH))
        if seeds:
            bench = Bench(name)
            cases += [bench.case(seed) for seed in seeds]
    for kind in (PUSHED, HELD):
        inside, outside = (
            [one for one in cases if one.kind == kind and one.inside is side] for side in (True, False)
        )
        assert len(inside) >= 3
        for one in inside:
            assert one.stable
            assert one.safe
            assert one.finished
            assert not one.gave, one
        gave = [one for one in outside if one.gave]
        assert len(gave) >= 0.2 * len(outside)
        assert not any(one.safe for one in outside), "the report speaks outside"
        name = f"impedance at the tool of {len(ARMS)} arms, {kind}: gave energy inside the passive region; outside it"
        bar(name, f"0 of {len(inside)}; {len(gave)} of {len(outside)}, all told before")
