"""Bring-up: what is wrong with a robot is found before a law acts on it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from mujoco_robot import MujocoRobot
from refusals import refused

import taut
from taut.cli.main import main
from taut.runtime.realtime import bringup, robot
from taut.runtime.realtime.bringup import BringUp, bring_up, passed_before, remember
from taut.runtime.realtime.connect import hello_of

RATE = 100.0  # [Hz] at which also a busy machine keeps the time


@pytest.fixture(autouse=True)
def shorter(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"READ": 0.5, "SHADOW": 0.2, "PROBE_STEP": 0.03, "AVERAGED": 0.1, "SPEED": 0.3}.items():
        monkeypatch.setattr(bringup, name, value)


def brought_up(
    model: str,
    address: str | None = None,
    *,
    ask: Callable[[str], bool] = lambda _: True,
    away: float = 0.1,
    **options: object,
) -> BringUp:
    """A bring-up of a simulated robot with the model of an arm."""
    arm = taut.load_arm(model)
    options = {"rate": RATE, **options}
    with taut.connect(MujocoRobot, arm, address=address or model, options=options) as robot:
        return bring_up(robot, start=arm.home + away, ask=ask)


def steps_of(done: BringUp) -> dict[str, bool]:
    return {step.name: step.ok for step in done.steps}


def test_a_robot_that_is_its_model_passes_and_is_where_it_was_sent() -> None:
    asked: list[str] = []
    done = brought_up("planar2", ask=lambda question: bool(asked.append(question)) or True)
    assert done.passed
    assert list(steps_of(done)) == ["states", "kinematics", "load", "gravity", "shadow", "signs", "slow motion"]
    assert len(asked) == len(done.steps)
    assert done.json()["faults"] == []


@pytest.mark.long
def test_what_was_not_compared_stands_beside_passed() -> None:
    """Joints that stick in dry friction beside one that does not; with nothing missing, only that it passed."""
    whole, sticking = brought_up("planar2"), brought_up("planar2", friction=[0.0, 1.0])
    assert whole.passed
    assert whole.missing == ()
    assert whole.content().title.endswith("passed")
    assert sticking.passed
    assert sticking.missing == ("signs of joint2",)
    assert sticking.content().title.endswith("passed; not compared: signs of joint2")


def test_a_robot_that_loses_its_periods_names_the_rule_and_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bringup, "MISSED", -0.01)  # no robot is that good
    (step,) = brought_up("planar2").steps
    assert not step.ok
    assert "of 100 Hz" in step.found
    assert "wired" in step.found
    assert step.table is not None
    assert ["mass of the end effector [kg]", 0.5] in step.table.rows


def test_a_torque_of_the_wrong_sign_is_found_and_given_back() -> None:
    done = brought_up("gantry3", flipped=1)
    assert not done.passed
    assert not done.steps[-1].ok
    assert "'y'" in done.steps[-1].found
    assert list(steps_of(done))[:5] == ["states", "kinematics", "load", "gravity", "shadow"]


def test_a_load_that_the_arm_does_not_have_stops_before_anything_is_sent() -> None:
    done = brought_up("planar2", payload=1.0)
    assert steps_of(done) == {"states": True, "kinematics": True, "load": True, "gravity": False}
    done = brought_up("planar2", payload=1.0, known=1.0)
    assert steps_of(done) == {"states": True, "kinematics": True, "load": False}


def test_signs_are_tested_without_judging_the_loop_at_each_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes longer than a step, in which nobody would see a joint that runs away."""
    judged: list[object] = []
    monkeypatch.setattr(robot, "require_stable", lambda *given: judged.append(given))
    done = brought_up("planar2", ask=lambda question: "slowly" not in question)
    assert steps_of(done)["signs"]
    assert len(judged) == 2  # in shadow, and before the first step


def test_nothing_goes_on_after_no() -> None:
    done = brought_up("one_joint", ask=lambda question: "sign" not in question)
    assert not done.passed
    assert [step.ok for step in done.steps] == [True] * 5 + [False]


@pytest.mark.long
def test_torques_tell_an_fr3_from_a_panda() -> None:
    """The other way round, and over the vendor's protocol, with those of a Franka."""
    model, robot = "fr3", "panda"
    own, other = brought_up(robot), brought_up(model, robot)
    assert own.passed
    assert steps_of(other) == {**dict.fromkeys(steps_of(own), True), "gravity": False}
    assert f"'{robot}'" in other.steps[-1].found


@pytest.mark.long
@pytest.mark.parametrize(("model", "flipped"), [("panda", 5), ("ur10", 0), ("xarm7", 6), ("kinova", 2)])
def test_a_wrong_sign_is_found_on_other_arms(model: str, flipped: int) -> None:
    done = brought_up(model, flipped=flipped)
    assert not done.passed  # by the signs, or in the slow motion where each joint sticks at 0.5 N m
    assert f"'{taut.load_arm(model).joint_names[flipped]}'" in done.steps[-1].found


def test_a_pass_is_for_an_address_an_arm_and_its_load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    arm = taut.load_arm("planar2")
    here, other = (hello_of(f"udp://127.0.0.1:{port}", arm) for port in (4000, 4001))
    assert not passed_before(here, arm)
    remember(here, arm)
    assert passed_before(here, arm)
    assert not passed_before(other, arm)
    assert not passed_before({**here, "options": {"missed": 30}}, arm)
    assert not passed_before(here, arm.with_payload(0.5))
    assert not passed_before(here, taut.load_arm("planar3"))
    assert len(json.loads((tmp_path / "taut" / "bringup.json").read_text())) == 1


def test_a_scenario_on_a_robot_without_a_bring_up_names_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert main(["run", "panda_payload", "--robot", "franka://127.0.0.9"]) == 2
    assert "taut bringup franka://127.0.0.9 --scenario panda_payload" in capsys.readouterr().err


def test_the_arm_or_a_scenario_is_needed() -> None:
    assert main(["bringup", "franka://127.0.0.9"]) == 2
    with refused(taut.errors.UsageError):
        from taut.cli.robots import _asked

        _asked("move")
