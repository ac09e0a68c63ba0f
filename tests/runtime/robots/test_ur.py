"""A UR through ur_rtde, the vendor-protocol client of PyPI, over sockets; the controller is a test server of our own."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from ur_controller import SERVO_STOP, SPEED_STOP, STOP_SCRIPT, STOPJ, WATCHDOG, controller

import taut
from taut.base.errors import UsageError
from taut.robots import DriverError, RobotError, RobotInfo
from taut.runtime.robots.ur import UrDriver

pytestmark = pytest.mark.xdist_group("robots")
ADDRESS = "127.0.0.21"  # the client's ports are fixed
PUSH = np.array([6.0, 4.0, -9.0, 1e-3, 2e-3, 3e-3])


@pytest.fixture(scope="module")
def ur10() -> Iterator[None]:
    """A controller that takes its time where this process, which has no real-time priority, does."""
    with controller(ADDRESS, arm="ur10", F_ext=PUSH.tolist(), payload=1.5, patience=20.0):
        yield


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, which may be slow, a late state is not silence."""
    monkeypatch.setattr("taut.runtime.robots.ur.SILENT_POLLS", 50_000)


def asked(line: str) -> str:
    """The answer of the dashboard port."""
    with socket.create_connection((ADDRESS, 29999)) as port, port.makefile("rw") as text:
        text.readline()
        text.write(line + "\n")
        text.flush()
        return text.readline()


def configure(**options: Any) -> None:
    asked("configure " + json.dumps(options))


@contextmanager
def opened(command: str = "position") -> Iterator[tuple[UrDriver, RobotInfo, dict[str, Any]]]:
    with closing(UrDriver(ADDRESS, command=command)) as driver:
        info = driver.open()
        measured = {"q": np.zeros(6), "v": np.zeros(6), "F_ext": np.zeros(6)}
        driver.read(measured)
        yield driver, info, measured


@pytest.mark.parametrize(
    ("command", "stop"),
    [
        ("torque", STOPJ),
        ("position", SERVO_STOP),
        pytest.param("velocity", SPEED_STOP, marks=pytest.mark.long),  # as the loop below
    ],
)
def test_commands_reach_the_controller_and_its_program_is_stopped_at_the_end(
    command: str, stop: int, ur10: None
) -> None:
    arm, count = taut.load_arm("ur10"), 60
    with opened(command) as (driver, info, measured):
        assert (info.rate, info.takes, info.paced_by) == (500.0, command, "robot")
        assert info.adds == (("gravity",) if command == "torque" else ())
        assert info.load == (1.5, (0.0, 0.0, 0.0))
        T, start = taut.snapshot(arm, arm.home).T(), measured["q"].copy()
        assert np.allclose(info.facts["T_BE"], np.vstack([np.column_stack([T.R, T.p]), [0, 0, 0, 1]]), atol=1e-12)
        assert np.allclose(measured["F_ext"], PUSH)
        driver.begin()
        for k in range(count):
            driver.read(measured)
            ramp = start + 0.1 * (k + 1) / 500.0
            driver.write({"torque": np.zeros(6), "velocity": np.full(6, 0.1), "position": ramp}[command])
            if command == "torque" and np.abs(measured["q"] - start).max() > 0.01:
                break
        driver.end()
        moved = measured["q"] - start
        if command == "torque":  # gravity is compensated, so the push alone moves it, and in its direction
            assert np.abs(moved).max() > 1e-3
            assert PUSH @ (np.asarray(taut.snapshot(arm, start).J()) @ moved) > 0.0
        elif command == "velocity":
            assert np.allclose(measured["v"], 0.1)
        else:
            assert moved.min() > 0.0
            assert moved.max() < 0.1 * count / 500.0
        assert json.loads(asked("log"))[-3:] == [WATCHDOG, stop, STOP_SCRIPT]


def test_a_program_without_commands_is_ended_by_its_watchdog(ur10: None) -> None:
    configure(patience=1.0)
    with opened() as (driver, _, measured):
        driver.begin()
        until = time.monotonic() + 5.0
        with refused(DriverError) as ended:
            while time.monotonic() < until:  # reads without a write
                driver.read(measured)
        assert ended.value.kind == "robot_error"
    configure(patience=20.0)


def test_what_a_controller_does_not_allow_is_refused_before_anything_moves(
    ur10: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    with refused(UsageError):
        UrDriver(ADDRESS, command="force")
    with refused(DriverError) as found, closing(UrDriver("127.0.0.22")) as driver:
        driver.open()
    assert found.value.kind == "disconnected"
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "rtde_receive", None)
        with refused(taut.errors.MissingExtraError), opened():
            pass
    configure(version=[5, 25, 1], remote=False)
    with refused(DriverError) as found, opened("torque"):
        pass
    assert found.value.kind == "rejected"
    with opened() as (driver, _, _):
        for options, kind in (
            ({}, "rejected"),  # remote control is off
            ({"remote": True, "in_use": True}, "busy"),
            ({"in_use": False, "robot_mode": 3}, "robot_error"),
        ):
            configure(**options)
            time.sleep(0.05)
            with refused(DriverError) as found:
                driver.begin()
            assert found.value.kind == kind
    assert json.loads(asked("log")) == []
    configure(robot_mode=7, version=[5, 26, 0])


def test_an_arm_moves_by_the_loop(ur10: None) -> None:
    arm = taut.load_arm("ur10")
    limits = taut.SafetyLimits.of(arm, missed=10**6)  # the test server is a Python program
    with taut.connect(f"ur://{ADDRESS}", arm, options={"command": "velocity"}, limits=limits) as robot:
        goal = robot.q + 0.03
        robot.move_to(goal, speed=0.2)
        run = robot.stop()
    assert np.abs(run.q[-1] - goal).max() < 5e-3
    assert np.allclose(run.extra["F_ext"], PUSH)


@pytest.mark.long
def test_the_code_of_the_page_moves_the_arm(ur10: None) -> None:
    text = (Path(__file__).parents[3] / "docs" / "ur.md").read_text(encoding="utf-8")
    code = next(block for block in re.findall(r"```text\n(.*?)```", text, re.DOTALL) if "taut.connect" in block)
    names: dict[str, Any] = {"taut": taut}
    exec(code.replace("192.168.1.10", ADDRESS), names)
    with opened() as (_, _, measured):
        assert np.abs(measured["q"] - names["arm"].home).max() < 5e-3


def test_a_protective_stop_is_unlocked_by_recover_if_the_controller_allows_it(ur10: None) -> None:
    with opened("velocity") as (driver, _, measured):
        for allowed in (True, False):
            configure(protective_stop_at=0.05, stays_locked=not allowed)
            driver.begin()
            with refused(DriverError) as stopped:
                while True:
                    driver.read(measured)
                    driver.write(np.full(6, 0.02))
            assert stopped.value.kind == "robot_error"
            driver.end()
            driver.read(measured)  # it is still read
            if allowed:
                driver.recover()
                continue
            with refused(DriverError) as locked:
                driver.recover()
            assert locked.value.kind == "rejected"
            with pytest.raises(DriverError):
                driver.begin()
        configure(stays_locked=False)
        driver.recover()


@pytest.mark.long
def test_a_protective_stop_ends_the_motion_recover_unlocks_it_and_a_frozen_controller_is_silent() -> None:
    address, arm = "127.0.0.24", taut.load_arm("ur5")
    limits = taut.SafetyLimits.of(arm, missed=100)
    with (
        controller(address, arm="ur5", protective_stop_at=0.1, patience=3.0) as process,
        taut.connect(f"ur://{address}", arm, options={"command": "torque"}, limits=limits) as robot,
    ):
        with pytest.raises(RobotError) as stopped:
            robot.move_to(arm.home + 0.2, speed=0.1)
        assert stopped.value.fault.name == "robot_error"
        robot.recover()
        robot.move_to(robot.q + 0.02, speed=0.2)
        assert robot.status.state == "running"
        os.kill(process.pid, signal.SIGSTOP)
        since = time.monotonic()
        with pytest.raises(RobotError) as frozen:
            robot.wait(5.0)
        assert frozen.value.fault.name in ("silent", "watchdog")  # the loop's own, where it was faster
        assert time.monotonic() - since < 2.0
        os.kill(process.pid, signal.SIGCONT)
