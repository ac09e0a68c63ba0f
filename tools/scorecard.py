"""Run the commands of the scorecard in docs/reliability.md and print how many of its rows hold.

Every row is written to out/scorecard.json. A row that is stated to hold and whose tests fail does not.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROW = re.compile(r"^\| (\d+) \| (.+?) \| (held|in part|not built|not measured) \| (.*?) \| (.*?) \|$", re.MULTILINE)


def rows() -> list[dict[str, str]]:
    """Number, fault, state, figure and command of each row."""
    text = (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8")
    names = ("row", "fault", "state", "figure", "command")
    return [dict(zip(names, found, strict=True)) for found in ROW.findall(text)]


def tests_of(row: dict[str, str]) -> list[str]:
    """What the row's command gives to pytest."""
    return [word for part in re.findall(r"`pytest ([^`]*)`", row["command"]) for word in part.split()]


def main() -> int:
    """Run each row's tests in full: 0 if every row that is stated to hold does."""
    table, failed = rows(), []
    for row in table:
        tests = tests_of(row)
        if tests:
            command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadgroup", *tests]
            done = subprocess.run(command, cwd=ROOT, env={**os.environ, "TAUT_BARS": "1"}, stdout=subprocess.DEVNULL)
            row["passed"] = done.returncode == 0
            failed += [] if row["passed"] else [row]
        print(f"{row['row']:>2}  {row['state']:<12}  {'' if row.get('passed', True) else 'FAILED  '}{row['fault']}")
    held = sum(row["state"] == "held" and row.get("passed", True) for row in table)
    out = ROOT / "out"
    out.mkdir(exist_ok=True)
    (out / "scorecard.json").write_text(json.dumps(table, indent=1), encoding="utf-8")
    print(f"{held} of {len(table)} rows held, {sum(row['state'] == 'not built' for row in table)} not built")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
