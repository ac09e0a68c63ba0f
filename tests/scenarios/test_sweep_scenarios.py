"""Sweeps of scenarios: success by their pass criteria, and samples written as scenarios that run to the same bits."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.analysis.sweeps.sweep import Sweep
from taut.cli.main import main
from taut.errors import UsageError
from taut.scenarios.run import value_of
from taut.scenarios.scenario import Scenario, load_scenario
from taut.scenarios.sweep import sweep_scenario, write_sample

U = taut.uniform
BASE = """
title = "A \\"planar\\" arm"
[arm]
model = "planar2"
[laws."the PD, soft"]
law = "ComputedTorque"
kp = [40.0, 30.0]
kd = 6
[laws.other]
law = "PID"
kp = 1
kd = 0.5
[control]
rate = 500
"""
RIGID = """
[plant]
kind = "rigid"
[plant.sensors.position]
noise = 1e-4
"""
MUJOCO = """
[plant]
kind = "mujoco"
[plant.payload]
mass = 0.25
"""
SINE = """
[reference]
kind = "sine"
relative_to_home = true
center = [0.1, -0.1]
amplitude = 0.2
frequency = [0.5, 1.5]
[run]
duration = 0.2
q0 = "home"
"""
PASS = """
[outputs]
shown = "other"
plot = "x.png"
[[pass]]
law = "the PD, soft"
metric = "rms_error"
max = 0.13
[[pass]]
law = "the PD, soft"
metric = "peak_error"
joint = "joint2"
window = [0.05, 0.1]
max = 0.12
[[pass]]
law = "other"
metric = "rms_error"
max = 1e-9
[[event]]
t = 0.0
set = { "law.kd" = 7.0 }
"""
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "rigid, a reference about home": (
        RIGID + SINE + PASS,
        {
            "law.kp[1]": U(20.0, 80.0), "plant.payload.mass": U(0.0, 2.0), "ref.center[0]": U(-0.3, 0.3),
            "ref.amplitude": U(0.1, 0.3), "v0": U([-1.0, -1.0], [1.0, 1.0]), "sensors.position.noise": U(1e-5, 1e-3),
        },
    ),
    "MuJoCo": (MUJOCO + SINE + PASS, {"law.kp": U(20.0, 80.0), "plant.payload.mass": U(0.0, 2.0)}),
}  # fmt: skip
LAW = "the PD, soft"


def scenario_of(text: str, folder: Path) -> Scenario:
    file = folder / "base.toml"
    file.write_text(BASE + text, encoding="utf-8")
    return load_scenario(str(file))


def same_bits(sample: taut.Run, file: Path, own: Any = None) -> None:
    """`taut run` of a file is the run of the sample."""
    again = load_scenario(str(file), own)
    assert len(again.trials) == 1
    law = next(iter(again.laws.values()))
    run = again.experiment.run(again.experiment.controller(law))
    assert list(run.arrays()) == list(sample.arrays())
    for name, rows in run.arrays().items():
        assert rows.tobytes() == sample.arrays()[name].tobytes(), name
    assert run.metrics.json() == sample.metrics.json()


@pytest.mark.part(1)
@pytest.mark.parametrize("case", CASES)
def test_any_sample_as_a_scenario_is_its_run_to_the_last_bit(case: str, tmp_path: Path) -> None:
    text, vary = CASES[case]
    scenario = scenario_of(text, tmp_path)
    found = sweep_scenario(scenario, LAW, vary, samples=8, seed=4, workers=1)
    rms, peak = found.plan.numbers[0], found.plan.numbers[-1]
    assert (rms, peak) == ("rms_error", "peak_error of 'joint2' from 0.05 to 0.1 s")
    (tmp_path / "elsewhere").mkdir()
    for sample in {found.worst, 0, 5}:
        run = found.run(sample)
        own = [each for each in scenario.figures if each.law == LAW]
        for name, figure in zip((rms, peak), own, strict=True):
            assert found.table[name][sample] == pytest.approx(value_of(figure, run), rel=1e-12)
        good = value_of(own[0], run) <= 0.13 and value_of(own[1], run) <= 0.12
        assert found.succeeded[sample] == good
        file = write_sample(scenario, LAW, found, sample, tmp_path / "elsewhere" / f"{sample}.toml")
        assert list(load_scenario(str(file)).laws) == [LAW]
        same_bits(run, file)


def test_a_value_that_is_given_wins_over_an_event_at_the_start(tmp_path: Path) -> None:
    scenario_of(RIGID + SINE + PASS, tmp_path)
    scenario = load_scenario(str(tmp_path / "base.toml"), values={"law.kd": 9.0, "plant.payload.mass": 1.0})
    subject = sweep_scenario(scenario, LAW, {}, samples=1).plan.subject
    assert np.all(subject.parameters["law.kd"] == 9.0)
    (tmp_path / "set.toml").write_text((BASE + RIGID + SINE + PASS).replace("7.0", "9.0"), encoding="utf-8")
    loaded = load_scenario(str(tmp_path / "set.toml"), values={"plant.payload.mass": 1.0})
    runs = [one.experiment.run(one.experiment.controller(one.laws[LAW])).q.tobytes() for one in (scenario, loaded)]
    assert runs[0] == runs[1]


def test_a_task_is_judged_by_its_phases_and_written_with_them(tmp_path: Path) -> None:
    phases = """
[arm]
model = "planar2"
[[phases]]
name = "go"
law = { law = "GravityPID", kp = 40.0, kd = 8.0 }
reference = { kind = "set-point", q = [0.6, 1.5] }
until = { elapsed = 0.05 }
[[phases]]
name = "stay"
law = { law = "GravityPID", kp = 90.0, kd = 8.0 }
[plant]
kind = "rigid"
[run]
duration = 0.1
[[pass]]
law = "task"
part = "stay"
metric = "final_error"
max = 0.01
"""
    file = tmp_path / "task.toml"
    file.write_text(phases, encoding="utf-8")
    scenario = load_scenario(str(file))
    vary = {"law.go.kp": U(20.0, 60.0), "plant.payload.mass": U(0.0, 1.0)}
    found = sweep_scenario(scenario, "task", vary, samples=3, workers=1)
    assert "final_error of 'stay'" in found.plan.numbers
    assert np.isfinite(found.table["final_error of 'stay'"]).all()
    same_bits(found.run(2), write_sample(scenario, "task", found, 2, tmp_path / "worst.toml"))


def test_the_command_ends_in_files_whose_worst_case_has_the_same_metric(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, own = tmp_path / "out", tmp_path / "own.py"
    own.write_text(
        "import taut\n\n\nclass Spring(taut.Law):\n    k: taut.Gain = taut.Gain(unit='N m/rad')\n\n"
        "    def command(self, x, ref):\n        return taut.Torque(P=self.k @ (ref.q - x.q), D=-2.0 * x.v)\n"
    )
    words = ["--law", f"{own}:Spring", "--gain", "k=3"]
    more = ["--set", "run.duration=0.2", "--vary", "law.k=1:9", "--vary", "q0=-1.5:0", "--samples", "64"]
    assert (
        main(["sweep", "one_joint_pid", *words, *more, "--metric", "rms_error", "--out", str(folder), "--json"]) == 0
    )
    data = json.loads(capsys.readouterr().out)
    assert sorted(data["outputs"]) == ["bands", "report", "shares", "worst"]
    assert all(Path(file).stat().st_size > 0 for file in data["outputs"].values())
    assert "sample" in Path(data["outputs"]["report"]).read_text(encoding="utf-8")
    assert data["success"] == {"rate": 1.0, "interval": [pytest.approx(0.9440, abs=1e-3), 1.0]}
    assert main(["run", data["outputs"]["worst"], *words, "--out", str(tmp_path / "run"), "--json"]) == 0
    ran = json.loads(capsys.readouterr().out)["metrics"][f"{own}:Spring"]
    scenario = load_scenario("one_joint_pid", {words[1]: _spring(own)}, values={"run.duration": 0.2})
    vary = {"law.k": U(1.0, 9.0), "q0": U(-1.5, 0.0)}
    found: Sweep = sweep_scenario(scenario, words[1], vary, samples=64, metrics=["rms_error"])
    assert found.worst == data["worst"]
    assert ran == found.run(found.worst).metrics.json()
    assert main(["run", data["outputs"]["worst"], "--out", str(tmp_path / "run")]) == 2  # its law is not in the file
    assert "--law FILE.py:CLASS" in capsys.readouterr().err


def _spring(file: Path) -> taut.Law:
    from taut.cli.command import load_law

    return load_law(f"{file}:Spring", {"k": 3})


def test_what_no_scenario_holds_has_a_sentence(tmp_path: Path) -> None:
    text = RIGID + SINE
    events = scenario_of(text + '[[event]]\nt = 0.1\nset = { "plant.payload.mass" = 1.0 }\n', tmp_path)
    with refused(UsageError):
        sweep_scenario(events, LAW, {}, samples=2)
    learned = (
        "[preparation]\nkind = 'learning'\ntrials = 1\nby = { kind = 'pd', Lp = 0.1, Ld = 0.01, cutoff = 1.0 }\n"
    )
    prepared = scenario_of(text + learned, tmp_path)
    found = sweep_scenario(prepared, LAW, {}, samples=2)
    with refused(UsageError):
        write_sample(prepared, LAW, found, 1, tmp_path / "worst.toml")
    assert not (tmp_path / "worst.toml").exists()
    cubic = (
        SINE.replace("sine", "cubic")
        .replace("center", "q0 = 'home'\nq1")
        .replace("amplitude = 0.2", "duration = 0.1")
    )
    cubic = cubic.replace("frequency = [0.5, 1.5]\n", "")
    moving = scenario_of(RIGID + cubic, tmp_path)
    found = sweep_scenario(moving, LAW, {"ref.q1[0]": U(0.0, 0.3)}, samples=2)
    same_bits(found.run(1), write_sample(moving, LAW, found, 1, tmp_path / "worst.toml"))
