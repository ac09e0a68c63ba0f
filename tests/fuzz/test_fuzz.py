"""A hundred mutants of every kind of file that taut reads; `make fuzz` takes ten thousand."""

from __future__ import annotations

import pytest
from fuzz import tried
from fuzz_kinds import KINDS


@pytest.mark.parametrize("kind", KINDS)
def test_mutants_are_read_or_refused_with_an_error_of_ours(kind: str) -> None:
    tally = tried(kind, range(100), timed=False)
    assert tally.faults == []
    assert tally.accepted + tally.refused == 100
    assert tally.accepted > 5  # mutants that are too wild would show nothing
