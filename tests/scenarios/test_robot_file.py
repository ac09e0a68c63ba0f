"""Robots of the command line: addresses, drivers of your own, and robot files; what is refused before anything is sent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import taut
from taut.cli.main import main
from taut.errors import TautError
from taut.robots import DriverError
from taut.runtime.realtime.connect import hello_of
from taut.scenarios.on_robot import robot_named

ARM = taut.load_arm("planar2")
MOTORS = '[motors]\ntypes = ["DM4310", "DM4310"]'
DRIVER = """
import taut
from taut.robots import RobotDriver, RobotInfo


class Still(RobotDriver):
    def __init__(self, address, *, q=0.0):
        self.address, self.q = address, q

    def open(self):
        return RobotInfo(name=f"still at {self.address}", n=2, rate=200.0, takes="torque")

    def read(self, measured):
        measured["q"][:] = self.q
        measured["v"][:] = 0.0

    def begin(self): ...
    def write(self, command): ...
    def end(self): ...
    def close(self): ...
"""


def written(folder: Path, text: str) -> str:
    file = folder / "arm.toml"
    file.write_text(text, encoding="utf-8")
    return str(file)


def test_a_robot_file_has_the_arguments_of_connect(tmp_path: Path) -> None:
    options = "[options]\nq = 0.25\n[limits]\nv = 0.5\ntool_speed = 0.3\npower = 'none'"
    (tmp_path / "driver.py").write_text(DRIVER, encoding="utf-8")
    given = robot_named(written(tmp_path, f"robot = 'driver.py:Still'\naddress = 'here'\n{options}"), ARM)
    assert given["limits"].v == 0.5
    assert given["limits"].tool_speed == 0.3
    np.testing.assert_array_equal(given["limits"].tau, ARM.effort)  # the arm's where they are not stated
    with taut.connect(arm=ARM, **given) as robot:
        assert robot.info.name == "still at here"
        np.testing.assert_array_equal(robot.q, 0.25)
    given = robot_named(written(tmp_path, "robot = 'ur://10.0.0.2'\noptions = { command = 'torque' }"), ARM)
    assert hello_of(arm=ARM, **given)["options"] == {"command": "torque"}


@pytest.mark.parametrize(
    "text",
    [
        "motors = {}",
        "robot = 3",
        "robot = '10.0.0.2'",
        "robot = 'can://can0'",
        "robot = 'no_such.py:Mine'",
        "robot = 'ur://10.0.0.2'\naddress = '10.0.0.3'",
        "robot = 'ur://10.0.0.2'\noptions = 3",
        "robot = 'ur://10.0.0.2'\ncommand = 'torque'",
        f"robot = 'ur://10.0.0.2'\n{MOTORS}",
        f"robot = 'can://can0'\n{MOTORS}\nrates = 300",
        f"robot = 'can://can0'\n{MOTORS}\nrate = 3000",
        f"robot = 'can://can0'\n{MOTORS}\n[limits]\ntau = 3\nv = 60",
        "robot = 'ur://10.0.0.2'\nlimits = { speed = 1.0 }",
        "robot = ",
    ],
)
def test_a_robot_file_that_is_wrong_is_refused(text: str, tmp_path: Path) -> None:
    with refused(TautError):
        hello_of(arm=ARM, **robot_named(written(tmp_path, text), ARM))


@pytest.mark.parametrize(("place", "words"), [("Other", "no class 'Other'"), ("RobotInfo", "no class 'RobotInfo'")])
def test_a_driver_file_without_that_driver_is_refused(place: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "driver.py").write_text(DRIVER, encoding="utf-8")
    with pytest.raises(DriverError, match=words):
        taut.connect(f"{tmp_path}/driver.py:{place}", ARM)


@pytest.mark.parametrize("robot", ["172.16.0.2", "frank://172.16.0.2", "can://can0", "no_such.toml"])
def test_both_commands_refuse_an_address_alike_before_anything_else(
    robot: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "panda_springs", "--robot", robot]) == 2
    said = capsys.readouterr().err
    assert "bringup" not in said
    assert main(["bringup", robot, "--scenario", "panda_springs", "--yes"]) == 2
    assert capsys.readouterr().err == said
