"""taut compare: what it prints, its exit status, and what it refuses before anything runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import taut
from taut.analysis.comparison import WrongModel, with_noise
from taut.cli.main import main
from taut.scenarios.scenario import load_scenario

SCENARIO = """
[arm]
model = "one_joint"

[laws.PD]
law = "PID"
kp = 2.205
kd = 2.0

[laws.PID]
law = "PID"
kp = 2.205
kd = 2.0
ki = 1.0

[plant]
kind = "{kind}"
{more}

[reference]
kind = "set-point"
q = [0.0]

[run]
duration = 0.5
"""
STUDENT = '''
import taut


class Student(taut.Law):
    """A PD controller with a slip: kd where kp belongs."""

    kp: taut.Gain = taut.Gain(unit="N m/rad")
    kd: taut.Gain  # [N m s/rad]

    def command(self, x, ref):
        return taut.Torque(P=self.kd @ x.difference(ref.q), D=self.kd @ (ref.v - x.v), I=0.0 * x.q)
'''


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(SCENARIO.format(kind="rigid", more=""))
    (tmp_path / "student.py").write_text(STUDENT)
    return tmp_path


def test_the_laws_of_a_scenario_are_compared_as_text_json_and_picture(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["compare", "short.toml", "--by", "effort", "--model", "friction=0.2", "trials=1"]
    assert main([*words, "--report", "compared.html"]) == 0
    told = capsys.readouterr().out
    assert "ranked by effort: " in told
    assert "1 true arm, spread friction 20 %, seed 0" in told
    assert "<svg" in (here / "compared.html").read_text() or "<img" in (here / "compared.html").read_text()
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    rows = {row["figure"]: row for row in found["tables"]["figures"]}
    effort = {name: value for name, value in rows["effort"].items() if name not in ("figure", "unit")}
    assert list(effort) == sorted(effort, key=lambda name: effort[name])
    assert rows["model worst"]["PD"] > 0.0
    assert found["numbers"]["PD"]["model_worst"]["rad"] == rows["model worst"]["PD"]


def test_a_students_law_is_graded(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["compare", "short.toml", "--law", "student.py:Student", "--gain", "kp=4", "--gain", "kd=2"]
    assert main([*words, "--reference", "PID(kp=4, kd=2)"]) == 1
    told = capsys.readouterr().out
    assert "failed, with a tolerance of 5 %" in told
    assert "P                joint1" in told
    assert main([*words, "--reference", "PD", "--tolerance", "0.6", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    commands = next(rows for title, rows in found["tables"].items() if title.startswith("largest differences"))
    assert [row["command or term"] for row in commands][:2] == ["command", "P"]


def test_recorded_runs_stand_beside_laws_and_alone(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm = taut.load_arm("one_joint")
    ctrl = taut.compile(taut.laws.PID(kp=3.0, kd=2.0), arm)
    taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.0]), duration=0.5).save("measured.mcap")
    plain = ["--json", "--model"]
    assert main(["compare", "--run", "measured.mcap", *plain]) == 0
    alone = json.loads(capsys.readouterr().out)["tables"]["figures"]
    assert main(["compare", "short.toml", "--laws", "PD", "--run", "measured.mcap", *plain]) == 0
    both = json.loads(capsys.readouterr().out)["tables"]["figures"]
    assert list(both[0]) == ["figure", "unit", "PD", "measured"]
    measured = {row["figure"]: row["measured"] for row in both}
    assert all(measured[row["figure"]] == row["measured"] for row in alone)
    assert main(["compare", "short.toml", "--run", "measured.mcap", *plain]) == 0
    assert list(json.loads(capsys.readouterr().out)["tables"]["figures"][0])[2:] == ["PD", "PID", "measured"]
    run = taut.load_run("measured.mcap")
    with refused(taut.errors.UsageError):
        taut.compare({"PD": run}, "short.toml")
    loop = taut.Loop(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.0]), duration=0.5)
    assert list(taut.compare({"a": run}, loop).entries) == ["a"]


def test_a_plant_in_mujoco_is_made_anew_with_noise_and_another_arm(here: Path) -> None:
    more = "gears = { ratio = 10.0, motor_inertia = 1e-3 }\n[plant.sensors.position]\noffset = 0.1"
    for kind in ("rigid", "mujoco"):
        (here / "geared.toml").write_text(SCENARIO.format(kind=kind, more=more))
        scenario = load_scenario("geared.toml")
        for _ in range(2):
            experiment = scenario.experiment
            *_, arm = WrongModel(mass=0.3, friction=0.2, trials=5).arms(experiment.plant.arm)
            sensors = with_noise(experiment.plant.sensors, {"position": 1e-3})
            plant = experiment.plant.like(arm=arm, sensors=sensors)
            true = experiment.plant.arm.perturbed(seed=4, mass=0.3, friction=0.2)
            assert plant.arm.bodies[0].mass == true.bodies[0].mass
            assert plant.arm.rotor_inertia.tolist() == true.rotor_inertia.tolist() == [0.1]
            assert {
                path: float(np.max(x)) for path, x in plant.parameters.items() if path.startswith("sensors.")
            } == {
                "sensors.position.offset": 0.1,
                "sensors.position.noise": 1e-3,
            }


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "taut has no scenario 'nowhere'"),
        (["short.toml", "--laws", "PDI(kp=1)"], "taut.laws has no law 'PDI'; did you mean 'PID'?"),
        (["short.toml", "--laws", "PD", "PD"], "two laws are called 'PD'; give each a name"),
        (["short.toml", "--laws", "a: PID(kp=1)", "a: PID(kp=2)"], "two laws are called 'a'"),
        (["short.toml", "--laws", "other"], "the experiment has no law 'other'; it has 'PD', 'PID'"),
        (["short.toml", "--by", "rms"], "a comparison has no figure 'rms'"),
        (["short.toml", "--report", "no/x.html"], "report 'no/x.html' needs the folder 'no', which does not exist"),
        (["short.toml", "--report", "x.doc"], "the report's name must end in .html or .htm; got 'x.doc'"),
        (["short.toml", "--case", "a"], "scenario 'short.toml' has no cases; leave case out"),
        (["short.toml", "--model", "mass"], "--model: takes NAME=VALUE such as kp=100 or kp=[100,50]; got 'mass'"),
        (["short.toml", "--model", "mass=nan"], "mass must be finite"),
        (
            ["short.toml", "--laws", "PD", "--reference", "PD", "--tolerance", "-0.05"],
            "tolerance must be > 0; got -0.05",
        ),
        (["short.toml", "--model", "mas=1"], "WrongModel has no field 'mas'; did you mean 'mass'?"),
        (["short.toml", "--set", "law.kq=1"], "has no parameter 'law.kq'"),
        (["short.toml", "--gain", "kp=1"], "--gain is for one law of your own"),
        (["short.toml", "--tolerance", "0.1"], "--tolerance is for a grade"),
        (["short.toml", "--reference", "PD"], "--reference grades one law"),
        (["short.toml", "--laws", "PD", "--reference", "PD", "--by", "effort"], "--by is for a comparison"),
        (["short.toml", "--run", "no.mcap"], "log 'no.mcap' does not exist"),
        ([], "compare takes a scenario, recorded runs (--run FILE.mcap), or both"),
        (["touch_and_press"], "scenario 'touch_and_press' is a task, whose phases have their own references"),
        (["touch_and_press", "--laws", "PID(kp=3)"], "scenario 'touch_and_press' is a task"),
        (["one_joint_pid", "--laws", "TaskComputedTorque(kp=1, kd=1)"], "the law follows TaskMotion"),
    ],
)
def test_a_wrong_request_is_one_sentence_and_nothing_is_written(
    words: list[str], message: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(here.iterdir())
    assert main(["compare", *words]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert message in told.err
    assert told.err.count("\n") == 1
    assert sorted(here.iterdir()) == before


def test_a_law_that_fails_ends_with_status_one(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "short.toml", "--laws", "PD", "wild: PID(kp=1e12, kd=1e9)", "--model"]) == 1
    assert "wild: the simulation diverged" in capsys.readouterr().out
