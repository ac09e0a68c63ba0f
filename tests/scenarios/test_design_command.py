"""taut design: the command prints what the function finds, and refuses in one sentence."""

from __future__ import annotations

import contextlib
import io
import json
import shlex
from pathlib import Path

import pytest
from refusals import refused

import taut
from taut.base.errors import TautError
from taut.cli.analysis import DESIGN
from taut.cli.main import main

HYBRID = (
    "HybridMotionForce(constraint={'kind': 'plane', 'point': [0.0, 0.0, -0.1], 'normal': [0, 0, 1]}, "
    "motion=TaskComputedTorque(kp=1, kd=1))"
)
PLANT = """
[arm]
model = "planar2"

[control]
rate = 500

[plant]
kind = "rigid"
friction = "none"
integrator = "rk4"
[plant.actuation]
delay = 0.008
"""


def test_the_command_prints_the_design(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "PID", "one_joint", "--zeta", "1", "--omega_n", "10"]) == 0
    d = taut.design(taut.laws.PID, taut.load_arm("one_joint"), zeta=1.0, omega_n=10.0)
    assert capsys.readouterr().out == f"{d}\n"


def test_json_has_gains_numbers_and_limits(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["design", "Impedance", "planar2", "--K", "400,20", "--zeta", "0.7", "--json"]
    assert main([*words, "--at", "-0.3,0.8"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["gains"]["K"] == [400.0] * 3 + [20.0] * 3
    assert {row["number"] for row in found["tables"]["asked and got"]} == {"K", "zeta"}
    assert {row["limit"] for row in found["tables"]["limits"]} >= {"largest step", "delay margin"}


def test_what_is_missed_ends_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["design", "GravityPID", "planar2", "--at", "0.3,0.8", "--overshoot", "5", "--settling", "0.5"]
    assert main(words) == 1
    assert "settling is missed" in capsys.readouterr().out
    assert main([*words, "--coupled", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["met"] is True
    assert main(["design", "PID", "one_joint", "--at", "1.5708", "--zeta", "1", "--omega_n", "1"]) == 1  # falls over


def test_a_law_that_holds_others_is_written_with_them(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["gantry3", "--zeta", "1", "--omega_n", "10", "--force", "5", "--json"]
    assert main(["design", HYBRID, *words]) == 0
    assert json.loads(capsys.readouterr().out)["gains"]["kfi"] == [[5.0]]


def test_a_plant_in_a_file_is_the_one_that_the_loop_is_judged_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(PLANT)
    words = ["design", "ComputedTorque", "--plant", str(file), "--at", "0.3,0.8", "--zeta", "0.3", "--omega_n", "30"]
    assert main([*words, "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert "500 Hz" in found["title"]
    assert all(row["got"] < 0.2 for row in found["tables"]["asked and got"] if row["number"] == "zeta")


def test_the_examples_of_the_help_succeed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    examples = DESIGN.more.partition("\n\n")[0].replace("\\\n", "").splitlines()[1:]
    for line in examples:
        command, _, file = line.partition(" > ")
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            assert main(shlex.split(command)[1:]) == 0, line
        if file:
            Path(file).write_text(printed.getvalue())


def test_a_plant_that_dry_friction_holds_is_refused() -> None:
    arm = taut.load_arm("one_joint").with_joints(coulomb=0.5)
    with refused(TautError):
        taut.design(taut.laws.PID, arm, zeta=1.0, omega_n=10.0, plant=taut.RigidPlant(arm))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["PIDD", "--zeta", "1"], "taut design has no law 'PIDD'; did you mean 'PID'?"),
        (["PID", "--zeta", "one"], "--zeta: must be a number, or numbers"),
        (["PID", "--zeta", ""], "--zeta: must be a number, or numbers"),
        (["Impedance", "--K", "-800,30", "--zeta", "1"], "K[0] must be >= 0"),
        (["PID", "--zeta", "nan", "--omega_n", "5"], "zeta must be finite"),
        (["PID", "--zeta", "1", "--omega_n", "5", "--rate", "nan"], "rate must be finite [Hz]; got nan"),
        (["HybridMotionForce", "--zeta", "1"], "constraint"),
        (["HybridMotionForce(constraint={)", "--zeta", "1"], "a law is written as PID(kp=100, kd=20)"),
        (["PID", "--zeta", "1", "--omega_n", "5", "--at", "0,0"], "at must have shape (7,)"),
        (["PID", "--zeta", "1", "--omega_n", "5", "--plant", "none.toml"], "none.toml"),
    ],
)
def test_a_wrong_request_is_one_sentence_and_status_2(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", *words]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert len(err.strip().splitlines()) == 1
