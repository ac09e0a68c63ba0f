"""Forces in scenarios: references, windows, metrics, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.control.trajectories.samples import Chunk
from taut.scenarios.run import run_scenario
from taut.scenarios.scenario import load_scenario

GOOD = """
title = "a gantry presses"
[arm]
model = "gantry3"
[laws.press]
law = "ForceControl"
kfp = 0.2
kfi = 3.0
kdamp = [100.0, 1.0]
null = "none"
[plant]
friction = "none"
[plant.environment]
spring = { kind = "spring", stiffness = 5000.0 }
damper = { kind = "damper", damping = 200.0 }
[reference]
kind = "force"
F_app = [0, 0, -10, 0, 0, 0]
[run]
duration = 1.0
[outputs]
window = [0.5, 1.0]
columns = ["force_error_rms"]
[[pass]]
law = "press"
metric = "force_error_rms"
window = [0.5, 1.0]
max = 0.1
"""


def load(tmp_path: Path, *changes: tuple[str, str]) -> Any:
    text = GOOD
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "mine.toml"
    file.write_text(text, encoding="utf-8")
    return load_scenario(str(file))


def test_a_figure_of_a_window_is_that_of_the_window(tmp_path: Path) -> None:
    result = run_scenario(load(tmp_path), tmp_path, say=lambda text: None)
    assert result.ok
    one = next(iter(result.runs.values()))
    assert one.metrics.force_error_rms > 0.1 > one.between(0.5, 1.0).metrics.force_error_rms
    assert "from 0.5 to 1 s" in str(result)
    without = load(tmp_path, ("window = [0.5, 1.0]\nmax", "max"))
    missed = run_scenario(without, tmp_path, say=lambda text: None).missed
    assert len(missed) == 1
    assert "force_error_rms must be <= 0.1; got" in missed[0]


def test_samples_of_force_go_straight_from_one_to_the_next(tmp_path: Path) -> None:
    samples = """kind = "force-samples"
times = [0, 1]
frame = "tool"
F_app = [[0, 0, 0, 0, 0, 0], [0, 0, 4, 0, 0, 0.5]]"""
    reference = load(tmp_path, ('kind = "force"\nF_app = [0, 0, -10, 0, 0, 0]', samples)).experiment.reference
    assert isinstance(reference, Chunk)
    np.testing.assert_allclose(reference.at(0.5).F_tool, [0, 0, 2, 0, 0, 0.25])  # type: ignore[attr-defined]


BROKEN = [
    (("F_app = [0, 0, -10, 0, 0, 0]", "F_app = -10"), "reference.F_app"),
    (("F_app = [0, 0, -10, 0, 0, 0]", "F_app = [0, 0, -10]"), "reference.F_app"),
    (("F_app = [0, 0, -10, 0, 0, 0]", 'F_app = [0, 0, -10, 0, 0, 0]\nframe = "task"'), "reference.frame"),
    (('kind = "force"\nF_app = [0, 0, -10, 0, 0, 0]', 'kind = "force-samples"\ntimes = [0, 1]\nF_app = [0, 1]'), "reference.F_app"),
    (('kind = "force"\nF_app = [0, 0, -10, 0, 0, 0]', 'kind = "set-point"\nq = [0, 0, 0]'), "reference.kind"),
    (("window = [0.5, 1.0]\nmax", "window = [0.5, 2.0]\nmax"), "pass 1.window"),
    (("window = [0.5, 1.0]\nmax", "window = [0.5]\nmax"), "pass 1.window"),
    (("window = [0.5, 1.0]\ncolumns", "window = [1.0, 0.5]\ncolumns"), "outputs.window"),
    (("kfp = 0.2", 'feedback = "none"\nkfp = 0.2'), "laws.press.kfp"),
    (("[plant.environment]\nspring = { kind = \"spring\", stiffness = 5000.0 }\ndamper = { kind = \"damper\", damping = 200.0 }\n", ""), "plant"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "path"), BROKEN, ids=lambda x: x if isinstance(x, str) else "")
def test_what_does_not_fit_is_refused_with_its_place(tmp_path: Path, change: tuple[str, str], path: str) -> None:
    with pytest.raises(taut.TautError) as told:
        load(tmp_path, change)
    assert told.value.name == path
