"""The scorecard of docs/reliability.md: all rows are there, and what their commands name exists."""

from __future__ import annotations

import importlib.util
from pathlib import Path

ROOT = Path(__file__).parents[1]
SPEC = importlib.util.spec_from_file_location("scorecard", ROOT / "tools" / "scorecard.py")
assert SPEC is not None
assert SPEC.loader is not None
scorecard = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scorecard)


def test_every_row_is_there_once_and_names_tests_that_exist() -> None:
    table = scorecard.rows()
    assert [int(row["row"]) for row in table] == list(range(1, 37))
    for row in table:
        tests = scorecard.tests_of(row)
        assert all((ROOT / test).is_file() for test in tests), row["row"]
        assert bool(tests) == (row["state"] in ("held", "in part") and row["row"] != "29")
