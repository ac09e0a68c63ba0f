"""The stories of docs/joints.md: what they print is what the page says, and what theory says."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.cli.main import main
from taut.scenarios.scenario import load_scenario

PAGE = Path(__file__).parents[2] / "docs" / "joints.md"
DIGITS = 0.02  # another processor may round otherwise, and what sticks, sticks a tick later
TITLES = {
    "RMS error": "rms_error",
    "peak error": "peak_error",
    "stuck": "stuck_time",
    "reversal error": "reversal_error",
    "peak torque": "peak_torque",
}


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Metrics of a story by case and law, for the joint that it is about."""

    @cache
    def run(name: str) -> dict[tuple[str, ...], dict[str, float]]:
        folder = tmp_path_factory.mktemp(name)
        assert main(["run", name, "--out", str(folder)]) == 0
        metrics = json.loads((folder / f"{name}.json").read_text())
        joint = load_scenario(name).outputs.joint
        by_law = {
            (case, law): m for case, laws in metrics.items() if "duration" not in laws for law, m in laws.items()
        }
        by_law |= {(law,): m for law, m in metrics.items() if "duration" in m}
        return {key: {name: m[name]["joints"][joint] for name in TITLES.values()} for key, m in by_law.items()}

    return run


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["so101_servo", "panda_geared"])
def test_the_table_on_the_page_is_the_one_that_is_printed(name: str, told: Any) -> None:
    _, _, after = PAGE.read_text(encoding="utf-8").partition(f"$ taut run {name}\n```\n\n```text\n")
    _, _, heads, *rows = [re.split(" {2,}", line.strip()) for line in after.partition("\n```")[0].splitlines()]
    page: dict[tuple[str, ...], dict[str, float]] = defaultdict(dict)
    for first, *cells in rows:
        for head, cell in zip(heads, cells, strict=True):
            metric, law = (first, head) if first.partition(" [")[0] in TITLES else (head, first)
            if metric.partition(" [")[0] in TITLES:
                page[tuple(law.split(": "))][TITLES[metric.partition(" [")[0]]] = float(cell)
    assert list(page) == list(told(name))
    for key, numbers in page.items():
        for metric, number in numbers.items():
            assert told(name)[key][metric] == pytest.approx(number, rel=DIGITS, abs=1e-5), (key, metric)


def test_what_friction_leaves_of_a_pd_servo_is_what_theory_says(told: Any) -> None:
    metrics, kp, mu, b, v = told("so101_servo"), 8.0, 0.0524, 0.0591, 0.1 * 2.0 * np.pi * 0.1
    step = 2.0 * np.pi / 4096.0
    assert mu / kp - step < metrics[("PD + g",)]["reversal_error"] < (mu + b * v) / kp + step
    assert metrics[("PD + g + f ref",)]["reversal_error"] < 0.1 * (mu + b * v) / kp + 1.5 * step
    assert metrics[("PD + g + f ref",)]["rms_error"] < 0.5 * metrics[("PD + g + f meas",)]["rms_error"]


def test_what_friction_makes_of_a_turn_falls_with_the_inertia_and_grows_with_the_gear(told: Any) -> None:
    """A step d against I (s + w)^3 / s makes e = d t^2 / (2 I) exp(-w t), whose peak is 2 d / (I w^2) exp(-2)."""
    metrics, omega = told("panda_geared"), 10.0
    for case, ratio in (("direct", 1.0), ("G = 100", 100.0)):
        arm = load_scenario("panda_geared").cases[case].experiment.arm
        inertia = float(arm.rotor_inertia[0] / taut.drives.rotor_share(arm)[0])
        wanted = 2.0 * (2.0 * 0.02 * ratio) / (inertia * omega**2) * np.exp(-2.0)
        assert metrics[(case, "feedforward + PID")]["reversal_error"] == pytest.approx(wanted, rel=0.03)


def test_a_geared_joint_hardly_feels_a_payload(told: Any) -> None:
    peaks = {case: numbers["peak_error"] for (case, _), numbers in told("panda_geared").items()}
    assert peaks["direct, 2 kg"] > 10.0 * peaks["G = 100, 2 kg"]
    assert peaks["direct, 2 kg"] > 100.0 * peaks["direct"]
    assert peaks["G = 100, 2 kg"] < 3.0 * peaks["G = 100"]


def test_the_gains_of_the_geared_case_are_those_of_the_same_poles() -> None:
    for case in load_scenario("panda_geared").cases.values():
        inertia = float(case.experiment.arm.rotor_inertia[0] / taut.drives.rotor_share(case.experiment.arm)[0])
        law: Any = case.laws["feedforward + PID"]
        gains = {
            key: float(np.ravel(value)[0])
            for key, value in taut.compile(law, case.experiment.arm).parameters.items()
            if "PID.k" in key
        }
        wanted = {"kp": 300.0 * inertia, "kd": 30.0 * inertia, "ki": 1000.0 * inertia}
        assert {key.rpartition(".")[2]: value for key, value in gains.items()} == pytest.approx(wanted, rel=1e-3)
