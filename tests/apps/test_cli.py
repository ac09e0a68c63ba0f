"""The command line: what it prints, its exit status, and what it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from taut.apps.cli import main

LAW = '''
import taut


class Spring(taut.Law):
    """A spring.

    Law:          tau = k e
    Closed loop:  M a + k e = 0
    """

    k: taut.Gain  # [N m/rad]

    def command(self, x, ref):
        return taut.Torque(spring=self.k @ (ref.q - x.q))


broken = 1
'''


@pytest.mark.parametrize("command", [["scenarios"], ["arms"], ["laws"], ["check", "planar2"], ["bench", "one_joint"]])
def test_every_listing_prints_text_and_json(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 0
    assert capsys.readouterr().out.strip()
    assert main([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)


def test_the_laws_are_listed_with_equation_closed_loop_and_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["laws", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["ComputedTorque"]["law"][0].endswith("eq. 10.19, 10.21")
    assert rows["ComputedTorque"]["gains"] == {"kp": "1/s^2", "kd": "1/s", "ki": "1/s^3"}
    assert rows["VelocityPI"]["command"] == "velocity"
    assert all(row["law"] and row["closed_loop"] for row in rows.values())


def test_check_exits_with_two_when_something_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "x.urdf"
    file.write_text('<robot name="x">\n<link name="a"/>\n<link name="a"/>\n</robot>')
    assert main(["check", str(file), "--json"]) == 2
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] is False
    assert set(report["problems"][0]) == {"object", "attribute", "line", "message"}
    assert report["problems"][0]["line"] == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rnu"], "taut: taut: argument COMMAND: invalid choice: 'rnu'"),
        ([], "taut: taut: the following arguments are required: COMMAND"),
        (["run"], "taut: taut run: the following arguments are required: SCENARIO"),
        (
            ["run", "panda_paylod"],
            "taut: taut has no scenario 'panda_paylod'; did you mean 'panda_payload'? (or give the path of a .toml file)",
        ),
        (["run", "nothing/here.toml"], "taut: scenario 'nothing/here.toml' does not exist"),
        (["run", "one_joint_pid", "--engine", "fast"], "taut: taut run: argument --engine: invalid choice: 'fast'"),
        (["run", "one_joint_pid", "--gain", "kp=1"], "taut: --gain is for a law of your own"),
        (["run", "one_joint_pid", "--law", "law.txt:Law"], "taut: --law takes FILE.py:CLASS; got 'law.txt:Law'"),
        (["run", "one_joint_pid", "--law", "gone.py:Law"], "taut: law file 'gone.py' does not exist"),
        (["bench", "panda2"], "taut: taut has no arm 'panda2'; did you mean 'panda'"),
    ],
)
def test_a_wrong_request_is_one_sentence_and_exit_status_two(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.err.startswith(message)
    assert said.err.count("\n") == 1
    assert said.out == ""


class TestALawOfTheUsersOwn:
    def test_it_takes_the_place_of_the_scenarios_laws(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "my_law.py"
        file.write_text(LAW)
        place = f"{file}:Spring"
        assert (
            main(["run", "one_joint_pid", "--law", place, "--gain", "k=2.0", "--out", str(tmp_path), "--json"]) == 0
        )
        assert list(json.loads(capsys.readouterr().out)["metrics"]) == [place]

    @pytest.mark.parametrize(
        ("name", "gains", "message"),
        [
            ("Sprin", ["k=1"], "has no law 'Sprin'; did you mean 'Spring'?"),
            ("broken", ["k=1"], "has no law 'broken'; it has 'Spring'"),
            ("Spring", ["k"], "--gain takes NAME=VALUE such as kp=100 or kp=[100,50]; got 'k'"),
            ("Spring", ["k=-1"], "k must be >= 0 [N m/rad]; got -1.0"),
            ("Spring", ["j=1"], "Spring has no gain 'j'"),
            ("Spring", [], "Spring needs k [N m/rad]"),
            ("Spring", ["k=soft"], "k must be numbers [N m/rad]; got 'soft'"),
        ],
    )
    def test_what_does_not_fit_is_refused(
        self, name: str, gains: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "my_law.py"
        file.write_text(LAW)
        flags = [flag for gain in gains for flag in ("--gain", gain)]
        assert main(["run", "one_joint_pid", "--law", f"{file}:{name}", *flags, "--out", str(tmp_path / "o")]) == 2
        assert message in capsys.readouterr().err

    def test_a_file_that_fails_is_named_with_its_error(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "my_law.py"
        file.write_text("import nothing_at_all\n")
        assert main(["run", "one_joint_pid", "--law", f"{file}:Law"]) == 2
        assert "fails: ModuleNotFoundError: No module named 'nothing_at_all'" in capsys.readouterr().err


def test_the_installed_command_and_the_module_are_the_same() -> None:
    done = subprocess.run([sys.executable, "-m", "taut", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("taut 0.")


def test_a_reader_that_goes_away_is_no_error() -> None:
    code = f"{sys.executable} -m taut laws --json | head -1"
    done = subprocess.run(["sh", "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""
