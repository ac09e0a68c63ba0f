"""taut bringup and taut run --robot: what they refuse before anything is sent, faults, Ctrl-C, and arms that may fall."""

from __future__ import annotations

import json
import os
import pty
import select
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import can_arm
import numpy as np
import pytest
from can_arm import CanArm
from ur_controller import controller

import taut
from taut.cli.main import main
from taut.runtime.realtime import bringup
from taut.runtime.realtime.bringup import remember
from taut.runtime.realtime.connect import hello_of
from taut.scenarios.on_robot import robot_named
from taut.scenarios.scenario import load_scenario

pytestmark = pytest.mark.xdist_group("robots")
SOFT: Final = """
[laws.soft]
law = "GravityPID"
kp = [40.0, 20.0]
kd = [3.0, 1.5]
wrapped_by = { law = "ViaMit" }
"""
UNSTABLE: Final = """
[laws.hard]
law = "GravityPID"
kp = [80.0, 40.0]
kd = [4.0, 90.0]
wrapped_by = { law = "ViaMit", kp_motor = 0.0, kd_motor = 0.0 }
"""
LATER: Final = '\n[[event]]\nt = 0.5\nset = { "law.kd" = [4.0, 90.0] }\n'
SLOW_TOOL: Final = "v = 3.0\ntool_speed = 0.35"
FAST: Final = 'reference = { kind = "quintic", q0 = [0.5, 1.5], q1 = [0.9, 1.5], duration = 0.8 }'  # up to 0.94 rad/s
BY_HOST: Final = [f"--set=laws.pd.wrapped_by.{gain}_motor=0.0" for gain in ("kp", "kd")]

LAW: Final = """
import taut


class Spring(taut.Law):
    k: taut.Gain = taut.Gain(unit="N m/rad")
    d: taut.Gain = taut.Gain(unit="N m s/rad")

    def command(self, x, ref):
        return taut.Torque(gravity=x.g, spring=self.k @ x.difference(ref.q) - self.d @ x.v)
"""


@pytest.fixture(scope="module")
def sim() -> Iterator[CanArm]:
    with CanArm("planar2") as sim:
        yield sim


@pytest.fixture(autouse=True)
def shorter(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"READ": 0.5, "SHADOW": 0.2, "SPEED": 0.3}.items():
        monkeypatch.setattr(bringup, name, value)


class Place:
    """A folder with a robot file and a scenario, whose bring-up has passed."""

    def __init__(self, folder: Path, sim: CanArm) -> None:
        self.folder, self.sim, self.file, self.scenario = folder, sim, folder / "arm.toml", folder / "reach.toml"
        sim(reset=True, rules=[])
        self.write()

    def write(self, more: str = "", *, limits: str = "", fast: bool = False) -> None:
        """The files, with more in the scenario, and other limits."""
        robot = can_arm.ROBOT.format(channel=self.sim.channel, sign="[1, -1]").replace("v = 3.0", limits or "v = 3.0")
        self.file.write_text(robot, encoding="utf-8")
        lines = [FAST if fast and line.startswith("reference") else line for line in can_arm.SCENARIO.splitlines()]
        self.scenario.write_text("\n".join(lines) + more, encoding="utf-8")

    def passes(self) -> None:
        """As after a bring-up."""
        arm = load_scenario(str(self.scenario)).experiment.arm
        remember(hello_of(arm=arm, **robot_named(str(self.file), arm)), arm)

    def run(self, *more: str) -> list[str]:
        return ["run", str(self.scenario), "--robot", str(self.file), "--out", str(self.folder / "out"), *more]

    def bringup(self, *more: str) -> list[str]:
        return ["bringup", str(self.file), "--scenario", str(self.scenario), *more]

    def logs(self) -> list[Path]:
        return sorted((self.folder / "out" / "robot").glob("*.mcap"))


@pytest.fixture
def place(tmp_path: Path, sim: CanArm, monkeypatch: pytest.MonkeyPatch) -> Place:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    place = Place(tmp_path, sim)
    place.passes()
    return place


class Person:
    """Standard input of a person who answers, and notes what the motors are at each question."""

    def __init__(self, sim: CanArm, answers: list[str]) -> None:
        self.sim, self.answers, self.seen = sim, answers, list[list[int]]()

    def isatty(self) -> bool:
        return True

    def readline(self) -> str:
        self.seen.append(self.sim()["status"])
        return self.answers.pop(0) + "\n"


def acts(sim: CanArm, gain: float = 80.0) -> bool:
    """Whether the first motor has a gain, that of the law 'pd' if left out; 54 where it holds by itself."""
    return bool(abs(sim()["sent"][0][2] - gain) < 1.0)


def once_it_acts(sim: CanArm, then: Callable[[], Any]) -> threading.Thread:
    """Do something 0.2 s after the law 'pd' has begun."""

    def wait() -> None:
        until = time.monotonic() + 60.0
        while not acts(sim) and time.monotonic() < until:
            time.sleep(0.01)
        time.sleep(0.2)
        then()

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    return thread


class TestWhatIsRefusedBeforeAnythingIsSent:
    @pytest.mark.part(1)
    @pytest.mark.parametrize(
        ("more", "limits", "words"),
        [
            (UNSTABLE, "", "law 'hard': the sampled loop is unstable"),
            (LATER, "", "law 'pd': the sampled loop is unstable"),
            ("", "v = 3.0\ntau = [5.0, 25.0]", "law 'pd': limits.tau of joint 'joint1'"),
        ],
        ids=["law", "event", "tau"],
    )
    def test_a_law_behind_others_an_event_and_limits_below_gravity(
        self, more: str, limits: str, words: str, place: Place, capsys: pytest.CaptureFixture[str]
    ) -> None:
        place.write(more, limits=limits)
        assert main(place.run("--yes", *BY_HOST)) == 2
        assert words in capsys.readouterr().err
        truth = place.sim()
        assert truth["commands"] == [0, 0]
        assert truth["status"] == [0, 0]
        assert not place.logs()

    def test_a_value_from_the_start_is_what_is_checked(
        self, place: Place, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(place.run("--yes", *BY_HOST, "--set", "law.kd=[4.0,90.0]")) == 2
        assert "law 'pd': the sampled loop is unstable" in capsys.readouterr().err
        assert place.sim()["commands"] == [0, 0]

    def test_an_arm_that_falls_where_nobody_can_be_asked(
        self, place: Place, capsys: pytest.CaptureFixture[str]
    ) -> None:
        for words in (place.run(), place.bringup()):
            assert main(words) == 2
            assert "--yes" in capsys.readouterr().err
            assert place.sim()["status"] == [0, 0]
            assert place.sim()["commands"] == [0, 0]


class TestAFault:
    def test_is_the_outcome_of_a_run_that_ends_there_and_no_other_law_acts(
        self, place: Place, capsys: pytest.CaptureFixture[str]
    ) -> None:
        place.write(SOFT, limits=SLOW_TOOL, fast=True)
        assert main(place.run("--yes", "--json")) == 1
        done = json.loads(capsys.readouterr().out)
        outcome = done["outcomes"]["pd"]
        assert outcome["kind"] == "stopped"
        assert outcome["message"].startswith("tool_speed (32)")
        assert outcome["joint"] is None
        assert list(done["metrics"]) == ["pd"]
        assert done["ended"] == "not run: soft, as pd stopped"
        assert taut.load_run(done["outputs"]["log"]).outcome.message == outcome["message"]
        assert Path(done["outputs"]["metrics"]).exists()
        of_robot = taut.load_run(done["logs"]["pd"])
        assert str(place.folder / "out" / "robot") in done["logs"]["pd"]
        assert of_robot.extra["safe.fault"][outcome["tick"]] == 32.0  # its last tick, and the first that has it
        assert of_robot.extra["safe.fault"][outcome["tick"] - 1] == 0.0
        assert len(of_robot) > outcome["tick"] + 1  # the controlled stop

    def test_of_a_motor_is_one_too(self, place: Place, capsys: pytest.CaptureFixture[str]) -> None:
        thread = once_it_acts(place.sim, lambda: place.sim(rules=[["error", 1, 1, 1, 0xA]]))
        assert main(place.run("--yes")) == 1
        thread.join()
        said = capsys.readouterr().out
        assert "robot_error (52)" in said
        assert "overcurrent" in said
        assert "RMS error" in said
        assert str(place.logs()[-1]) in said
        run = taut.load_run(place.folder / "out" / "reach.mcap")
        assert run.outcome.kind == "stopped"
        assert "overcurrent" in run.outcome.message
        assert 0.1 < run.t[-1] < 0.9

    def test_before_anything_moves_is_all_that_is_reported(
        self, place: Place, capsys: pytest.CaptureFixture[str]
    ) -> None:
        place.sim(rules=[["error", 1, 0, 10**6, 0x9]])
        assert main(place.run("--yes")) == 1
        said = capsys.readouterr().out.splitlines()
        assert said[1] == "no log: no law was run"
        assert said[2].startswith("not run: pd, as motor of 'joint2'")
        assert "undervoltage" in said[2]
        assert len(said) == 4  # and the file of metrics

    @pytest.mark.long
    def test_in_the_motion_to_the_start_leaves_what_ran_before(
        self, place: Place, capsys: pytest.CaptureFixture[str]
    ) -> None:
        def fail() -> None:  # in the motion back to the start
            while not acts(place.sim, 54.0):
                time.sleep(0.005)
            while acts(place.sim, 54.0):
                time.sleep(0.005)
            place.sim(rules=[["error", 1, 10, 1, 0xA]])

        place.write(SOFT, limits="v = 1.0")
        thread = once_it_acts(place.sim, fail)
        assert main(place.run("--yes", "--json")) == 1
        thread.join()
        done = json.loads(capsys.readouterr().out)
        assert done["outcomes"]["pd"]["kind"] == "completed"
        assert list(done["outcomes"]) == ["pd"]
        assert done["ended"].startswith("not run: soft, as ")
        assert "overcurrent" in done["ended"]


class TestAnArmThatFalls:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("fault", [False, True])
    def test_is_held_until_it_is_supported(
        self, fault: bool, place: Place, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        place.write(limits=SLOW_TOOL if fault else "v = 3.0", fast=True)
        person = Person(place.sim, ["", "n", "y"])
        monkeypatch.setattr(sys, "stdin", person)
        assert main(place.run()) == int(fault)
        assert person.seen == [[1, 1]] * 3
        assert capsys.readouterr().err.count("is it supported? [y/N]") == 3
        assert place.sim()["status"] == [0, 0]

    @pytest.mark.long
    def test_is_let_go_without_a_question_where_its_motors_are_off(
        self, place: Place, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        place.write(UNSTABLE)
        monkeypatch.setattr(sys, "stdin", Person(place.sim, []))
        assert main(place.run()) == 2
        monkeypatch.setattr(sys, "stdin", person := Person(place.sim, ["y", "y", "n"]))
        assert main(place.bringup()) == 1
        assert person.seen == [[0, 0]] * 3
        assert "supported" not in capsys.readouterr().err

    def test_is_asked_for_after_a_step_that_was_declined(
        self, place: Place, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr(sys, "stdin", person := Person(place.sim, ["y", "y", "y", "y", "n", "n", "y"]))
        assert main(place.bringup()) == 1
        assert person.seen == [[0, 0]] * 4 + [[1, 1]] * 3
        assert capsys.readouterr().err.count("is it supported? [y/N]") == 2
        assert place.sim()["status"] == [0, 0]


def said_until(terminal: int, words: str, seconds: float = 30.0) -> str:
    """What a process writes to its terminal, until there are these words."""
    text, until = "", time.monotonic() + seconds
    while words not in text and select.select([terminal], [], [], max(0.0, until - time.monotonic()))[0]:
        text += os.read(terminal, 10_000).decode()
    return text


def test_ctrl_c_stops_the_arm_names_the_log_and_asks_for_a_support(place: Place, tmp_path: Path) -> None:
    paths = os.pathsep.join([str(can_arm.HERE), *filter(None, sys.path)])
    ours, theirs = pty.openpty()
    program = "import sys; from taut.cli.main import main; sys.exit(main(sys.argv[1:]))"
    with subprocess.Popen(
        [sys.executable, "-c", program, *place.run("--set", "run.duration=30.0")],
        stdin=theirs, stdout=theirs, stderr=theirs, env={**os.environ, "PYTHONPATH": paths},
    ) as process:  # fmt: skip
        try:
            once_it_acts(place.sim, lambda: process.send_signal(signal.SIGINT)).join()
            time.sleep(0.1)  # the controlled stop takes half a second and more
            process.send_signal(signal.SIGINT)
            said_until(ours, "is it supported? [y/N]")
            truth = place.sim()
            assert truth["status"] == [1, 1]
            assert np.abs(truth["v"]).max() < 0.05
            os.write(ours, b"n\n")
            said_until(ours, "is it supported? [y/N]")
            assert place.sim()["status"] == [1, 1]
            os.write(ours, b"y\n")
            said = said_until(ours, ".mcap")
            assert process.wait(30.0) == 1
        finally:
            process.kill()
            os.close(theirs)
    assert f"interrupted; what was logged until then is in {place.logs()[-1]}" in "".join(said.split("\r\n"))
    assert place.sim()["status"] == [0, 0]
    run = taut.load_run(place.logs()[-1])
    assert 0.1 < run.t[-1] < 10.0
    assert run.extra["safe.mode"][-1] == 0.0  # the controlled stop


@pytest.mark.long
def test_a_bring_up_has_the_values_and_the_law_of_the_run_that_asks_for_it(
    place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    changed = ["--set", "arm.payload.mass=1.0", "--set", 'title="with a load"', "--set", "law.kp=[50.0, 30.0]"]
    assert main(place.run("--yes", *changed)) == 2
    said = capsys.readouterr().err
    assert "its load of 1 kg" in said
    again = ["bringup", *shlex.split(said.split("taut bringup ")[1])]
    assert again == [*place.bringup(), *changed]
    assert main([*again, "--yes", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["faults"][0].startswith("gravity")  # the simulated arm has no load

    (place.folder / "my_law.py").write_text(LAW, encoding="utf-8")
    own = ["--law", f"{place.folder}/my_law.py:Spring", "--gain", "k=40.0", "--gain", "d=2.0"]
    assert main(["bringup", str(place.file), "--arm", "planar2", "--yes", *own]) == 2
    assert "--scenario" in capsys.readouterr().err


def test_a_law_of_torques_of_a_users_own_acts_by_the_host_on_motors(
    place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    place.passes()
    file = place.folder / "my_law.py"
    file.write_text(LAW, encoding="utf-8")
    own = ["--law", f"{file}:Spring", "--gain", "k=40.0", "--gain", "d=2.0", "--set", "run.duration=0.3"]
    assert main(place.run("--yes", *own)) == 0
    assert str(place.logs()[-1]) in capsys.readouterr().out
    run = taut.load_run(place.logs()[-1])
    assert {"gravity", "spring"} <= set(run.terms)
    assert not run.extra["mit"][:, 2:4].any()  # kp and kd of the motors


@pytest.mark.long
def test_a_rate_that_is_not_the_robots_is_named(place: Place, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(place.run("--yes", "--set", "run.duration=0.1")) == 0
    said = capsys.readouterr()
    assert said.err == "taut: [control] rate = 1000 Hz is not used on a robot: this one has 500 Hz\n"
    assert str(place.logs()[-1]) in said.out


UR: Final = """
robot = "ur://127.0.0.23"
options = { command = "torque" }
limits = { missed = 1000000 }                   # the test server is a Python program
"""
UR_SCENARIO: Final = """
title = "A UR10 that carries something moves"
run = { duration = 0.5, q0 = [0.05, -1.52, 1.62, -1.52, -1.52, 0.05] }
reference = { kind = "quintic", q0 = [0.05, -1.52, 1.62, -1.52, -1.52, 0.05], q1 = "home", duration = 0.5 }

[arm]
model = "ur10"
payload = { mass = 1.0 }

[laws.pd]
law = "ComputedTorque"
kp = 100.0
kd = 20.0

[plant]
adds = ["gravity"]
"""


@pytest.mark.long
def test_a_ur_that_takes_torques_is_brought_up_and_runs_a_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for name, value in {"AVERAGED": 0.1, "MISSED": 1.0}.items():  # the machine may be busy
        monkeypatch.setattr(bringup, name, value)
    robot, scenario = tmp_path / "ur.toml", tmp_path / "reach.toml"
    robot.write_text(UR, encoding="utf-8")
    scenario.write_text(UR_SCENARIO, encoding="utf-8")
    heavier = ["--set", "arm.payload.mass=1.5", "--json"]
    with controller("127.0.0.23", arm="ur10", payload=1.5, patience=20.0):
        assert main(["bringup", str(robot), "--scenario", str(scenario), "--yes", *heavier]) == 0
        found = " ".join(json.loads(capsys.readouterr().out)["summary"])
        assert "6 of 6 joints gave way to the side they were pushed to" in found
        run = ["run", str(scenario), "--robot", str(robot), "--out", str(tmp_path / "out")]
        assert main([*run, *heavier]) == 0  # and nobody is asked
    done: Any = taut.load_run(json.loads(capsys.readouterr().out)["logs"]["pd"])
    assert np.abs(done.q[0] - done.reference.q[0]).max() < 0.01
    assert np.abs(done.q[-1] - taut.load_arm("ur10").home).max() < 0.01
