"""The command line: what it prints, its exit status, and what it refuses."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest

import taut
from taut.analysis.comparison import Experiment
from taut.cli.command import Answer
from taut.cli.main import COMMANDS as ALL
from taut.cli.main import _parser, main
from taut.scenarios.scenario import built_in_scenarios, load_scenario

LAW = '''
import taut


class Spring(taut.Law):
    """A spring.

    Law:          tau = k e
    Closed loop:  M a + k e = 0
    """

    k: taut.Gain = taut.Gain(unit="N m/rad")

    def command(self, x, ref):
        return taut.Torque(spring=self.k @ (ref.q - x.q))


class Fails(taut.Law):
    def command(self, x, ref):
        raise ValueError("no")


class Moves(taut.Law):
    def command(self, x, ref):
        return taut.Velocity(hold=0.0 * x.q)


broken = 1
'''


@pytest.mark.parametrize("command", [["scenarios"], ["arms"], ["laws"], ["check", "planar2"], ["bench", "one_joint"]])
def test_every_listing_prints_text_and_json(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 0
    assert capsys.readouterr().out.strip()
    assert main([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)


def test_export_writes_the_law_that_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "firmware"
    assert main(["export", "one_joint_pid", "--out", str(out)]) == 2
    assert "has the laws 'PD', 'PID'; none was named; give --law NAME" in capsys.readouterr().err
    assert not out.exists()
    assert main(["export", "one_joint_pid", "--law", "PID", "--out", str(out), "--real", "float", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["files"] == [
        str(out / name) for name in ("ctrl.h", "ctrl.c", "ctrl_test.c", "Makefile", "CMakeLists.txt")
    ]
    assert "float ki;  /* law.ki [N m/(rad s) | N/(m s)] */" in (out / "ctrl.h").read_text(encoding="utf-8")
    (tmp_path / "own.py").write_text(LAW, encoding="utf-8")
    assert (
        main(
            ["export", "one_joint_pid", "--law", f"{tmp_path / 'own.py'}:Spring", "--gain", "k=2", "--out", str(out)]
        )
        == 0
    )


def test_the_laws_are_listed_with_equation_closed_loop_and_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["laws", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["ComputedTorque"]["law"][0].endswith("eq. 10.19, 10.21")
    assert rows["ComputedTorque"]["gains"] == {"kp": "1/s^2", "kd": "1/s", "ki": "1/s^3"}
    assert (rows["PID"]["reference"], rows["Impedance"]["reference"], rows["Posture"]["reference"]) == (
        "JointMotion", "TaskMotion", "none"
    )  # fmt: skip
    assert {"kfp", "kfi", "kdamp", "e_int_max"} <= set(rows["ForceControl"]["gains"])  # some need a feedback
    whole = next(row for row in rows["ForceControl"]["law"] if row.startswith("the damping is implicit"))
    assert whole.endswith("the strongest damper that a torque held over a tick can be")  # continued on three lines
    assert rows["EnergyTank"]["reference"] == "that of the law that it holds"
    assert {"NormalEstimate", "LossOfContact", "SideBySide", "Sum"} <= set(rows)
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
        (["rnu"], "taut: argument COMMAND: invalid choice: 'rnu'"),
        (["run"], "taut: the following arguments are required: SCENARIO; taut run --help lists what it takes\n"),
        (
            ["run", "panda_paylod"],
            "taut: taut has no scenario 'panda_paylod'; did you mean 'panda_payload' or 'panda_pushed'? (or give the path of a .toml file)",
        ),
        (["run", "nothing/here.toml"], "taut: scenario 'nothing/here.toml' does not exist"),
        (["run", "one_joint_pid", "--engine", "fast"], "taut: argument --engine: invalid choice: 'fast'"),
        (["run", "one_joint_pid", "--gain", "kp=1"], "taut: --gain is for a law of your own"),
        (["run", "one_joint_pid", "--law", "law.txt:Law"], "taut: --law takes FILE.py:CLASS; got 'law.txt:Law'"),
        (["run", "one_joint_pid", "--law", "gone.py:Law"], "taut: law file 'gone.py' does not exist"),
        (["bench", "panda2"], "taut: taut has no arm 'panda2'; did you mean 'panda'"),
        (["run", "a" * 5000], "taut: taut has no scenario 'aaaa"),
        (["run", "a" * 5000 + ".toml"], "taut: scenario 'aaaa"),
        (["run", "a/" + "b" * 5000], "taut: scenario 'a/bbbb"),
        (["run", "tests\0/a.toml"], r"taut: scenario 'tests\x00/a.toml' does not exist"),
        (["run", "nothing/here.**"], "taut: scenario 'nothing/here.**' does not exist"),
        (["run", "."], "taut: scenario '.' is a folder; name a file in it\n"),
        (["run", "./"], "taut: scenario '.' is a folder; name a file in it\n"),
        (["run", __file__], f"taut: scenario '{__file__}' is no valid TOML: "),
        (["check", "planer2"], "taut: taut has no arm 'planer2'; did you mean 'planar2'"),
        (["check", "no/such.urdf"], "taut: model 'no/such.urdf' does not exist"),
        (["check", __file__], f"taut: model '{__file__}' is neither a .urdf nor an MJCF .xml file"),
        (["run", "one_joint_pid", "--law", ""], "taut: --law takes FILE.py:CLASS; got ''"),
        (
            ["sweep", "geared_force", "--law", "x"],
            "taut: scenario 'geared_force' has the law 'ForceControl'; got 'x'; leave --law",
        ),
        (
            ["sweep", "one_joint_pid", "--law", "x"],
            "taut: scenario 'one_joint_pid' has the laws 'PD', 'PID'; got 'x'; gi",
        ),
        (
            ["sweep", "one_joint_pid", "--law", "PD", "--vary", "law.kp=1:2", "--vary", "law.kp=3:4"],
            "taut: --vary must be given once for each path; got 'law.kp' twice",
        ),
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


def test_a_report_on_a_broken_model_is_on_standard_output(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for text in ("<robot name='x'><link name='a'/><link name='a'/></robot>", "<robot", "<sdf/>"):
        file = tmp_path / "x.urdf"
        file.write_text(text)
        assert main(["check", str(file)]) == 2
        said = capsys.readouterr()
        assert "problem" in said.out
        assert said.err == ""


def test_check_keeps_json_on_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "nope", "--json"]) == 2
    said = capsys.readouterr()
    assert "taut has no arm 'nope'" in json.loads(said.out)["problems"][0]["message"]
    assert said.err == ""


@pytest.mark.parametrize("width", [60, 80, 100])
def test_the_laws_are_running_text_as_wide_as_the_terminal(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    assert main(["laws"]) == 0
    text = capsys.readouterr().out
    lines = text.splitlines()
    assert width - 10 < max(map(len, lines)) <= width
    told = " ".join(text.split())
    assert "kd e_dot (eq. 10.6, figure 10.8)" in told
    assert 'puts M(q)^-1 f(v) on the right; + FrictionCompensation(at="meas") takes it away' in told
    assert "gains kp [1/s^2], kd [1/s], ki [1/s^3]" in told
    assert "follows JointMotion" in told


class TestValuesOfAScenario:
    def told(self, capsys: pytest.CaptureFixture[str], *words: str, status: int = 0) -> dict[str, Any]:
        assert main(["run", "one_joint_pid", *words, "--json"]) == status
        out: dict[str, Any] = json.loads(capsys.readouterr().out)
        return out

    def test_one_number_changes_by_its_path_in_the_file_or_as_a_parameter(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        out = ("--out", str(tmp_path))
        plain = self.told(capsys, *out)["metrics"]
        one = self.told(capsys, *out, "--set", "laws.PD.kp=4", status=1)["metrics"]
        both = self.told(capsys, *out, "--set", "law.kp=4", "--set", "run.seed=3", status=1)["metrics"]
        assert plain["PID"] == one["PID"]
        assert plain["PD"] != one["PD"] == both["PD"]
        assert plain["PID"] != both["PID"]

    @pytest.mark.parametrize(
        ("words", "path", "near"),
        [
            ("law.kpp=4", "law.kpp", "did you mean 'law.kp'"),
            ("run.duraton=4", "[run]", "did you mean 'duration'?"),
            ("plant.payloads.mass=1", "[plant]", "did you mean 'payload' or 'link_payloads'?"),
            ("title.x=1", "title", ""),
            ("plant.sensors.position.noise=-1", "[plant.sensors.position]", "noise"),
            ("law.kp", "--set", "NAME=VALUE"),
        ],
    )
    def test_a_path_or_value_that_is_none_is_one_sentence(
        self, words: str, path: str, near: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(["run", "one_joint_pid", "--out", str(tmp_path / "out"), "--set", words]) == 2
        said = capsys.readouterr().err
        assert path in said
        assert near in said
        assert said.count("\n") == 1
        assert not (tmp_path / "out").exists()

    def test_the_gain_of_a_phase_is_named_by_its_phase(self) -> None:
        scenario = load_scenario("touch_and_press", values={"law.approach.kp": 77.0})
        assert scenario.experiment.events[0].set == {"law.approach.kp": 77.0}

    def test_the_file_of_a_scenario_is_printed(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["scenarios", "one_joint_pid"]) == 0
        text = built_in_scenarios()["one_joint_pid"].read_text(encoding="utf-8")
        assert capsys.readouterr().out == text.rstrip() + "\n"


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
            ("broken", ["k=1"], "has no law 'broken'; it has 'Spring', 'Fails', 'Moves'"),
            ("Spring", ["k"], "argument --gain: takes NAME=VALUE such as kp=100 or kp=[100,50]; got 'k'"),
            ("Spring", ["k=-1"], "k must be >= 0 [N m/rad]; got -1.0"),
            ("Spring", ["j=1"], "Spring has no field 'j'"),
            ("Spring", [], "Spring needs k [N m/rad]"),
            ("Spring", ["k=nan"], "k must be finite [N m/rad]; got nan"),
            ("Spring", ["k=-inf"], "k must be finite [N m/rad]; got -inf"),
            ("Spring", ["k=soft"], "k must be numbers [N m/rad]; got 'soft'"),
            ("Spring", ["k=1", "k=2"], "argument --gain: must be given once for each name; got 'k' twice"),
            ("Spring", ["k=" + "[" * 5000], "k must be numbers [N m/rad]; got '[[[["),
            ("Spring", ["k=" + "9" * 5000], "k must be numbers [N m/rad]; got '9999"),
            ("Spring", ["k=1", "self=2"], "of '{file}' cannot be made: "),
            (
                "Spring",
                ["k=[1, 2, 3]"],
                "taut: --law {file}:Spring: k must be a number, (1,) or (1, 1) [N m/rad] for 1 joint",
            ),
            ("Fails", [], "taut: --law {file}:Fails: Fails fails on plain numbers, at rest at home: ValueError: no"),
            (
                "Moves",
                [],
                "[plant] Moves gives velocity commands and plant 'RigidPlant(one_joint)' takes torque commands",
            ),
        ],
    )
    def test_what_does_not_fit_is_refused(
        self, name: str, gains: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "my_law.py"
        file.write_text(LAW)
        flags = [flag for gain in gains for flag in ("--gain", gain)]
        assert main(["run", "one_joint_pid", "--law", f"{file}:{name}", *flags, "--out", str(tmp_path / "o")]) == 2
        said = capsys.readouterr()
        assert message.replace("{file}", str(file)) in said.err
        assert said.err.count("\n") == 1
        assert said.out == ""
        assert not (tmp_path / "o").exists()

    @pytest.mark.parametrize(
        ("code", "words"),
        [
            ("raise SystemExit(3)", "fails: SystemExit: 3"),
            ("import sys; sys.exit()", "fails: SystemExit"),
            ("raise GeneratorExit", "fails: GeneratorExit"),
            ("raise ValueError('two\\nlines')", "fails: ValueError: two lines"),
            ("def f(:", "fails: SyntaxError: invalid syntax"),
            ("import taut\n\nclass A(taut.Law):\n    pass", "law A has no command(self, x, ref)"),
        ],
    )
    def test_a_file_that_ends_the_process_or_fails_is_one_sentence(
        self, code: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "my_law.py"
        file.write_text(code)
        assert main(["run", "one_joint_pid", "--law", f"{file}:Law"]) == 2
        said = capsys.readouterr().err
        assert words in said
        assert f"law file '{file}'" in said
        assert said.count("\n") == 1

    def test_an_interrupt_while_a_file_is_read_stays_one(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "my_law.py"
        file.write_text("raise KeyboardInterrupt")
        assert main(["run", "one_joint_pid", "--law", f"{file}:Law"]) == 1
        assert capsys.readouterr().err == "taut: interrupted\n"

    def test_its_scenario_must_be_right_all_the_same(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "my_law.py"
        file.write_text(LAW)
        text = built_in_scenarios()["one_joint_pid"].read_text()
        for old, new, message in (
            ('shown = "PID"', 'shown = "x"', "[outputs] shown must be one of 'PD', 'PID'; got 'x'"),
            ('law = "PD"', 'law = "x"', "[pass 2] law must be one of 'PD', 'PID'; got 'x'"),
            (
                'metric = "final_error"',
                'metric = "x"',
                "[pass 1] metric must name what is measured: a run has no metric 'x'",
            ),
        ):
            case = tmp_path / "case.toml"
            case.write_text(text.replace(old, new))
            assert main(["run", str(case), "--law", f"{file}:Spring", "--gain", "k=1"]) == 2
            assert message in capsys.readouterr().err

    def test_a_file_that_fails_is_named_with_its_error(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "my_law.py"
        file.write_text("import nothing_at_all\n")
        assert main(["run", "one_joint_pid", "--law", f"{file}:Law"]) == 2
        assert "fails: ModuleNotFoundError: No module named 'nothing_at_all'" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["run", "scenarios", "arms", "laws", "check", "bench"])
def test_help_names_the_commands_flags_and_exit_statuses(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["--help"], [command, "--help"]):
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert ended.value.code == 0
        said = capsys.readouterr().out
        assert "0  done" in said
        assert "2  the request was wrong" in said
        assert command in said
        assert max(map(len, said.splitlines())) <= 100
    assert "--json" in said


def test_every_command_that_prints_a_result_takes_json() -> None:
    """As DESIGN says; what `run` gives is looked at with the scenarios."""
    actions = [action for action in _parser()._actions if isinstance(action.choices, dict)]
    commands = actions[0].choices
    assert set(commands) == {
        "run", "scenarios", "export", "arms", "laws", "check", "doctor", "design", "compare", "report", "repair",
        "replay", "bench", "book", "bringup", "sweep",
    }  # fmt: skip
    assert all("--json" in command._option_string_actions for command in commands.values())


def test_a_name_that_is_a_file_here_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text("title = 'mine'")
    assert main(["run", "mine"]) == 2
    assert capsys.readouterr().err.endswith("(or give the path of a .toml file)\n")


def test_a_warning_is_one_line_without_our_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def warn(*_: object) -> Answer:
        warnings.warn("this may take\nlong", RuntimeWarning, stacklevel=2)
        return Answer(text="", data=None)

    commands = tuple(dataclasses.replace(each, run=warn) if each.name == "arms" else each for each in ALL)
    monkeypatch.setattr("taut.cli.main.COMMANDS", commands)
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert main(["arms"]) == 0
    assert capsys.readouterr().err == "taut: this may take\\nlong\n"


def test_the_installed_command_and_the_module_are_the_same() -> None:
    done = subprocess.run([sys.executable, "-m", "taut", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("taut 0.")


def test_a_reader_that_goes_away_is_no_error() -> None:
    code = f"{sys.executable} -m taut laws --json | head -1"
    done = subprocess.run(["sh", "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""


COMMANDS = {
    "laws": ["laws"],
    "json": ["arms", "--json"],
    "help": ["run", "--help"],
    "run": ["run", "one_joint_pid", "--json"],
}


def taut_to(out: int, words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """The command with a standard output."""
    command = [sys.executable, "-W", "ignore", "-m", "taut", *words]
    return subprocess.run(
        command, stdout=out, stderr=subprocess.PIPE, text=True, cwd=folder, check=False, timeout=120
    )


@pytest.mark.part(1)
@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_an_output_that_cannot_be_written_is_one_sentence(words: list[str], tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    with Path("/dev/full").open("w") as full:
        done = taut_to(full.fileno(), words, tmp_path)
    assert done.returncode == 1
    assert done.stderr == "taut: standard output cannot be written: No space left on device\n"
    assert words[0] != "run" or "--help" in words or (tmp_path / "out/one_joint_pid/one_joint_pid.json").exists()


def test_a_reader_that_goes_away_changes_no_exit_status(tmp_path: Path) -> None:
    """The scenario runs to its end, and reaches its figures, or does not."""
    text = built_in_scenarios()["one_joint_pid"].read_text(encoding="utf-8").replace('plot = "one_joint_pid.png"', "")
    (tmp_path / "reached.toml").write_text(text, encoding="utf-8")
    (tmp_path / "missed.toml").write_text(text.replace("max = 0.002", "max = 1e-9"), encoding="utf-8")
    for scenario, status in (("reached.toml", 0), ("missed.toml", 1)):
        reader, writer = os.pipe()
        os.close(reader)
        done = taut_to(writer, ["run", scenario], tmp_path)
        os.close(writer)
        assert (done.returncode, done.stderr) == (status, "")


@pytest.mark.parametrize("module", ["taut.cli.run", "taut.cli.analysis", "taut.arm.load", "numpy"])
def test_ctrl_c_while_modules_load_gives_no_traceback(module: str) -> None:
    code = f"""
import os, signal, sys
class Interrupts:
    def find_spec(self, name, *_):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupts())
from taut.cli.main import main
sys.exit(main(["check", "planar2"]))
"""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode in (1, -signal.SIGINT)
    assert done.stderr in ("", "taut: interrupted\n")
    assert done.stdout == ""


def test_an_interrupted_run_names_the_log_of_what_it_did(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Experiment.run

    def interrupted(self: Experiment, ctrl: taut.Controller, log: Path | None) -> taut.Run:
        if log is None:
            return run(self, ctrl)
        log.touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(Experiment, "run", interrupted)
    assert main(["run", "panda_payload", "--out", str(tmp_path), "--set", "run.duration=0.1"]) == 1
    (log,) = tmp_path.glob("*.partial.mcap")
    assert capsys.readouterr().err.splitlines()[-1] == f"taut: interrupted; the run until then is in {log}"


def test_without_a_command_the_help_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "commands:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "place"),
    [
        (["run", "one_joint_pid", "--set", "law.kp=-2"], "--set: law.kp must be >= 0"),
        (["run", "one_joint_pid", "--set", "run.q0=[30]"], "q0[0] (joint 'joint1') must be an angle in radians"),
        (["design", "PID", "planar2", "--at", "30,45"], "at[0] (joint 'joint1') must be an angle in radians"),
    ],
)
def test_a_wrong_value_is_named_by_what_the_user_wrote(
    words: list[str], place: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    assert place in capsys.readouterr().err


def test_the_command_line_leaves_ctrl_c_to_python() -> None:
    """Who imports it has the handler of signals that was there before."""
    code = "import signal; import taut.cli.main; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"


BROKEN_OFF = """
import os, signal, taut

class BrokenOff(taut.Law):
    k: taut.Gain

    def command(self, x, ref):
        if float(x.t) > 0.3:
            os.kill(os.getpid(), signal.{signal})
        return taut.Torque(spring=self.k @ (ref.q - x.q))
"""


@pytest.mark.part(1)
@pytest.mark.parametrize(("name", "status"), [("SIGINT", 1), ("SIGKILL", -9)])
def test_a_run_that_is_broken_off_leaves_its_log(name: str, status: int, tmp_path: Path) -> None:
    law = tmp_path / "law.py"
    law.write_text(BROKEN_OFF.replace("{signal}", name), encoding="utf-8")
    scenario = tmp_path / "mine.toml"
    built_in = built_in_scenarios()["one_joint_pid"].read_text(encoding="utf-8")
    scenario.write_text(built_in.replace('plot = "one_joint_pid.png"', 'log = "mine.mcap"'), encoding="utf-8")
    words = ["run", str(scenario), "--law", f"{law}:BrokenOff", "--gain", "k=2", "--engine", "float", "--out", "out"]
    done = taut_to(subprocess.DEVNULL, words, tmp_path)
    assert done.returncode == status
    assert "Traceback" not in done.stderr
    log = taut.load_run(tmp_path / "out/mine.partial.mcap")
    assert 0 < len(log) <= 301
    assert log.outcome.kind == "stopped"
