"""A Franka on the vendor's own client, over the vendor's protocol on loopback: franky-sim as it is, and our server."""

from __future__ import annotations

import functools
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import refusals
from refusals import refused

import taut
from taut.errors import MatchError
from taut.runtime.realtime.bringup import bring_up
from taut.runtime.realtime.robot import Robot
from taut.runtime.realtime.status import RobotError
from taut.runtime.robots.driver import DriverError

pytest.importorskip("pylibfranka")
from runtime.robots.franka_poisoned import PoisonedDriver
from runtime.robots.franka_process import FrankaProcess, following, own_address

pytestmark = pytest.mark.xdist_group("robots")  # one robot serves all
# Of the joints of franky-sim's MuJoCo model, which the real robot compensates and the simulator does not.
ROTORS = np.array([0.195, 0.195, 0.195, 0.195, 0.074, 0.074, 0.074])  # [kg m^2]
STICTION = np.array([1.137, 1.137, 1.137, 1.137, 0.763, 0.44, 0.248])  # [N m]
VISCOUS = 0.21  # [N m s/rad]
KP = 400.0  # [1/s^2]
STALL = 0.015  # [s] without a turn on the processor
PLAIN = """
import contextlib, os, sys, threading
threading.Timer(120.0, os._exit, (0,)).start()
with contextlib.suppress(OSError): os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(70))
sys.argv = ["franky-sim", "-s", "mujoco", "--hostname", sys.argv[1]]
from franky_sim.run_server import main
main()
"""


class Rig(FrankaProcess):
    """The server with a robot connected to it."""

    connected: Robot | None = None

    def __init__(self, arm: taut.Arm) -> None:
        super().__init__()
        self.arm = arm

    @property
    def robot(self) -> Robot:
        if self.connected is None:
            self.connected = taut.connect(PoisonedDriver, self.arm, address=self.address)
        return self.connected

    def leave(self) -> None:
        if self.connected is not None:
            self.connected.close()
        self.connected = None

    def reset(self) -> None:
        """The robot idle and without errors; connected again where it was lost."""
        for name, *given in (("push", *[0.0] * 6), ("mode", None), ("thresholds",), ("table", -1.0)):
            self.order(name, *given)
        if self.connected is not None and not self.connected.link.alive:
            self.leave()
        if self.robot.fault is not None or self.robot.call("state")["mode"] != "Idle":
            self.robot.recover()
        self.robot.stop()
        self.look()  # and what it said before is read

    def stalled(self) -> bool:
        """Whether this machine let the server or the loop wait."""
        late = self.robot.timing().late.max() if self.robot.link.alive else 0.0
        return bool(max(late, self.look()["slowest"]) > STALL)

    def close(self) -> None:
        self.leave()
        super().close()


def steady(test: Callable[..., None]) -> Callable[..., None]:
    """The test, twice more where it failed while the machine stalled."""

    @functools.wraps(test)
    def attempts(rig: Rig, **given: Any) -> None:
        for last in (False, False, True):
            refusals.said.pop(refusals.current, None)
            rig.reset()
            try:
                return test(rig, **given)
            except (AssertionError, RobotError, DriverError):
                if last or not rig.stalled():
                    raise
        return None

    return attempts


@pytest.fixture(scope="module")
def arm() -> taut.Arm:
    return taut.load_arm("fr3").with_joints(rotor_inertia=ROTORS)


@pytest.fixture(scope="module")
def rig(arm: taut.Arm) -> Iterator[Rig]:
    with Rig(arm) as rig:
        yield rig


@pytest.fixture(scope="module")
def ctrl(rig: Rig, arm: taut.Arm) -> taut.Controller:
    return tracking(rig.robot, arm)


def tracking(robot: Robot, arm: taut.Arm) -> taut.Controller:
    law = taut.laws.ComputedTorque(kp=KP, kd=2.0 * np.sqrt(KP))
    return taut.compile(law, arm, rate=robot.rate, adds=robot.adds)


def fault_within(robot: Robot, seconds: float) -> Any:
    """The fault that comes."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if robot.fault is not None:
            return robot.fault
        time.sleep(2e-3)
    raise AssertionError("no fault came")


def goes_on(robot: Robot, ctrl: taut.Controller) -> bool:
    """Whether a robot that has recovered takes a law."""
    robot.recover()
    robot.start(ctrl)
    robot.wait(0.05)
    return robot.status.state == "running"


def assert_tracks(robot: Robot, arm: taut.Arm, path: Any) -> None:
    """The error of computed torque is that of friction alone, which the simulators do not compensate as robots do."""
    run = robot.run()
    last = run.t > run.t[-1] - 1.0
    reference = np.array([path.at(float(t)).q for t in run.t[last]])
    friction = STICTION + VISCOUS * np.abs(run.v[last]).max(axis=0)  # [N m]
    M = taut.snapshot(arm, arm.home).M
    error = np.abs(run.q[last] - reference).max(axis=0)
    assert np.all(error < 1.5 * np.abs(np.linalg.inv(M)) @ friction / KP + 1e-3), error
    assert np.all(error[:4] < 0.015)  # gravity that is added twice, or never, would be 0.05


# Three laws, and franky-sim as it is.


def test_computed_torque_tracks_on_franky_sim_as_it_is(arm: taut.Arm) -> None:
    address = own_address(1)
    simulator = subprocess.Popen([sys.executable, "-c", PLAIN, address], stdout=subprocess.PIPE, text=True)
    try:
        assert simulator.stdout is not None
        assert any(address in line for line in simulator.stdout)  # it listens
        with taut.connect(f"franka://{address}", arm) as robot:
            assert robot.info.facts["mode"] == "Idle"
            ctrl = tracking(robot, arm)
            path = taut.trajectories.Sine(center=robot.q, amplitude=np.full(arm.n, 0.1), frequency=0.5)
            for last in (False, False, True):
                robot.start(ctrl, path, duration=4.0)
                try:
                    robot.wait(2.2)  # 2 s of its clock
                except RobotError as error:
                    if last or error.fault.name != "deadline":  # the machine had no time for it
                        raise
                    robot.recover()
                else:
                    break
            assert_tracks(robot, arm, path)
            assert robot.stop().outcome.ok
    finally:
        simulator.kill()
        simulator.communicate()


@steady
def test_computed_torque_tracks_a_sine(rig: Rig, arm: taut.Arm) -> None:
    ctrl, path, _ = following("joint", rig.robot, rig, 2.0)
    rig.robot.start(ctrl, path, duration=4.0)
    rig.robot.wait(2.0)
    assert_tracks(rig.robot, arm, path)


@steady
def test_an_impedance_gives_way_by_its_stiffness(rig: Rig) -> None:
    ctrl, _, _ = following("cartesian", rig.robot, rig, 2.0)
    rig.robot.start(ctrl)
    rig.robot.wait(0.5)
    before = np.array(rig.look()["p"])
    rig.order("push", 0.0, 30.0, 0.0, 0.0, 0.0, 0.0)
    rig.robot.wait(1.5)
    moved = np.array(rig.look()["p"]) - before
    assert np.abs(moved - [0.0, 30.0 / 800.0, 0.0]).max() < 0.005  # 3 N of friction in the joints
    rig.robot.stop()
    assert rig.look()["error"] is None  # it ended without a step of the torque, which is 9 N m here


@steady
def test_hybrid_control_presses_on_a_table_and_slides(rig: Rig, arm: taut.Arm) -> None:
    ctrl, stroke, height = following("hybrid", rig.robot, rig, 2.0)
    before = rig.look()["p"]
    rig.robot.start(ctrl, stroke)
    rig.robot.wait(2.0)
    found = rig.look()
    assert abs(found["wrench"][2] + 10.0) < 0.7  # on the table, while it creeps
    assert abs(found["p"][2] - height) < 1e-3
    assert abs(found["p"][1] - before[1] - 0.05) < 0.01
    pressed = rig.robot.run().extra["F_ext"][-500:, 2]
    assert np.all(np.abs(pressed - 10.0) < 1.5)


# The wrench, the load, the gripper.


@steady
def test_a_push_is_measured_with_its_sign_at_the_tool_in_base_axes(rig: Rig, ctrl: taut.Controller) -> None:
    push = np.array([5.0, -10.0, 15.0, 0.5, -1.0, 0.7])  # the server's stiffness frame is another than the tool's
    rig.order("push", *push)
    rig.robot.start(ctrl)
    rig.robot.wait(0.1)
    assert np.abs(rig.robot.run().extra["F_ext"][-1] - push).max() < 1e-4  # states are in single precision


@steady
def test_the_robot_compensates_the_load_that_it_is_told(rig: Rig, arm: taut.Arm, ctrl: taut.Controller) -> None:
    robot = rig.robot
    com = [0.02, -0.03, 0.05]  # [m] in the frame of the tool
    load = taut.Payload(mass=1.0, com=com, inertia=[0.002, 0.003, 0.004, 0.0, 0.001, 0.0])
    T = np.array(robot.info.facts["F_T_EE"]).reshape(4, 4)
    at_flange = T[:3, :3] @ com + T[:3, 3]
    q = robot.q
    rig.order("carry", 1.0, *at_flange)
    robot.set_load(load)
    try:
        assert robot.info.load == (1.0, tuple(com))
        assert np.abs(np.array(rig.look()["load"]) - [1.0, *at_flange]).max() < 1e-6
        with refused(MatchError):  # a controller whose arm carries nothing
            robot.start(ctrl)
        robot.start(tracking(robot, arm.with_payload(1.0, com=com)))
        robot.wait(0.5)
        # Were it compensated twice, or never: 4.6 N m at joint 4.
        assert np.abs(rig.look()["torque"]).max() < 1.2
        assert np.abs(robot.q - q).max() < 5e-3
    finally:
        rig.order("carry", -1.0, *at_flange)
        if robot.fault is not None:
            robot.recover()
        robot.stop()
        robot.set_load(taut.Payload())


@steady
def test_the_gripper_moves_while_the_arm_is_controlled(rig: Rig, ctrl: taut.Controller) -> None:
    robot = rig.robot
    robot.start(ctrl)
    assert robot.call("move", width=0.05) is None
    assert robot.gripper.status["busy"]
    with refused(DriverError):
        robot.gripper.move(0.06)
    while robot.gripper.status["busy"]:
        robot.wait(0.02)
    found = robot.gripper.move(0.06)
    assert found["succeeded"]
    assert abs(found["width"] - 0.06) < 2e-3  # it still creeps
    assert found["max_width"] == pytest.approx(0.08)
    with refused(DriverError):
        robot.gripper.move(0.086)
    assert robot.gripper.move(0.084, speed=0.2)["succeeded"]  # a hand estimates its largest width
    robot.call("grasp", width=0.03, force=20.0, epsilon_inner=1e-9, epsilon_outer=1e-9)  # nothing is that exact
    while robot.gripper.status["busy"]:
        robot.wait(0.02)
    assert "ommand" in robot.gripper.status["error"]
    assert robot.status.state == "running"


THRESHOLDS: dict[str, Any] = {
    "lower_torque": [20.0] * 7, "upper_torque": [20.0] * 7, "lower_force": [20.0] * 6, "upper_force": [20.0] * 6,
}  # fmt: skip
WRONG: tuple[tuple[str, dict[str, Any]], ...] = (
    ("sing", {}),
    ("grasp", {"width": 0.0}),
    ("look", {"deep": 1.0}),
    ("state", {"deep": 1.0}),
    ("collision", {}),
    ("move", {"width": -1.0}),
    ("move", {"width": np.nan}),
    ("move", {"width": "a"}),
    ("move", {"width": 0.02, "speed": 0.0}),
    ("grasp", {"width": 0.02, "force": -5.0}),
    ("grasp", {"width": 0.02, "force": 5.0, "epsilon_inner": -1e-3}),
    ("collision", {**THRESHOLDS, "lower_torque": [20.0] * 6}),
    ("collision", {**THRESHOLDS, "upper_torque": [np.nan] * 7}),
    ("collision", {**THRESHOLDS, "lower_force": [-1.0] * 6}),
    ("collision", {**THRESHOLDS, "upper_force": "strong"}),
    ("collision", {**THRESHOLDS, "lower_force": [20.0, 20.0, 30.0, 20.0, 20.0, 20.0]}),
)


def test_a_function_that_it_does_not_have_or_wrong_arguments(rig: Rig) -> None:
    rig.reset()
    for name, arguments in WRONG:
        with refused(DriverError) as error:
            rig.robot.call(name, **arguments)
        assert error.value.kind == "rejected"
    assert rig.look()["thresholds"] is None


# Faults in a motion, and how it goes on.


@steady
def test_a_collision_ends_the_motion_until_it_is_cleared(rig: Rig, ctrl: taut.Controller) -> None:
    robot = rig.robot
    force, torque = [15.0] * 6, [100.0] * 7
    limits = {"lower_torque": torque, "upper_torque": torque, "lower_force": force, "upper_force": force}
    robot.call("collision", **limits)
    robot.start(ctrl)
    with refused(DriverError):
        robot.call("collision", **limits)
    robot.wait(0.1)
    rig.order("push", 0.0, 20.0, 0.0, 0.0, 0.0, 0.0)
    fault = fault_within(robot, 1.0)
    assert fault.name == "robot_error"
    assert "cartesian_reflex" in fault.message
    assert robot.call("state")["errors"] == '["cartesian_reflex"]'
    with pytest.raises(RobotError):
        robot.start(ctrl)
    robot.recover()
    with refused(DriverError):  # while it is pushed
        robot.start(ctrl)
    rig.order("push", *[0.0] * 6)
    assert goes_on(robot, ctrl)


@pytest.mark.parametrize("mode", ["kUserStopped", "kOther"])
@steady
def test_a_mode_that_ends_a_motion(rig: Rig, ctrl: taut.Controller, mode: str) -> None:
    """The user stop, which the client names, and a mode that comes without a word."""
    robot = rig.robot
    robot.start(ctrl)
    robot.wait(0.1)
    rig.order("mode", mode)
    fault = fault_within(robot, 1.0)
    assert fault.name == "robot_error"
    assert "release the user stop" in fault.message
    assert robot.call("state")  # it answers: no end of a motion is awaited that has ended
    if mode == "kUserStopped":
        with refused(DriverError):
            robot.recover()
    rig.order("mode", None)
    rig.look()
    assert goes_on(robot, ctrl)


@pytest.mark.parametrize("value", ["nan", "-inf", "1e200"])
@steady
def test_a_torque_that_is_not_finite_is_never_sent(rig: Rig, ctrl: taut.Controller, value: str) -> None:
    robot = rig.robot
    robot.start(ctrl)
    robot.wait(0.05)
    robot.call("poison", joint=2, value=value)
    fault = fault_within(robot, 1.0)
    assert fault.name == "rejected"
    assert "joint 3" in fault.message
    found, until = rig.look(), time.monotonic() + 2.0
    while found["moving"] and time.monotonic() < until:  # the loop is about to end it
        found = rig.look()
    assert not found["moving"]  # the motion is ended, and not by a reflex
    assert found["error"] is None
    assert np.all(np.abs(found["torque"]) < 100.0)
    assert goes_on(robot, ctrl)


@steady
def test_a_jump_of_the_torque_that_the_robot_refuses(rig: Rig, ctrl: taut.Controller) -> None:
    rig.robot.start(ctrl)
    rig.robot.wait(0.05)
    rig.robot.call("poison", joint=0, value="5.0")
    fault = fault_within(rig.robot, 1.0)
    assert fault.name == "robot_error"
    assert "controller_torque_discontinuity" in fault.message


@steady
def test_states_that_stay_away_for_12_ms_are_counted(rig: Rig, ctrl: taut.Controller) -> None:
    rig.robot.start(ctrl)
    rig.robot.wait(0.1)
    rig.order("gap", 12)
    rig.robot.wait(0.1)
    assert rig.robot.run().extra["loop.lost"].max() >= 11
    assert rig.robot.status.state == "running"


@steady
def test_states_that_stay_away_for_30_ms_end_the_motion(rig: Rig, ctrl: taut.Controller) -> None:
    rig.robot.start(ctrl)
    rig.robot.wait(0.1)
    rig.order("gap", 30)
    assert rig.wait_for("stopped")["missed"] == 21  # commands, of states that did not come
    fault = fault_within(rig.robot, 1.0)
    assert fault.name == "robot_error"
    assert "communication_constraints_violation" in fault.message
    assert goes_on(rig.robot, ctrl)


@steady
def test_a_robot_whose_clock_stands_for_40_ms_is_held(rig: Rig, ctrl: taut.Controller) -> None:
    robot = rig.robot
    robot.start(ctrl)
    robot.wait(0.1)
    rig.order("pause", 0.04)
    assert fault_within(robot, 1.0).name == "deadline"
    robot.stop()
    modes = robot.run().extra["safe.mode"]
    assert modes[0] == 1.0
    assert modes[-1] == 0.0  # the controlled stop
    assert rig.look()["error"] is None
    assert goes_on(robot, ctrl)


@pytest.mark.part(2)
@pytest.mark.parametrize("mode", ["kGuiding", "kUserStopped", "kOther", "kAutomaticErrorRecovery"])
@steady
def test_a_robot_in_another_mode_is_not_moved(rig: Rig, ctrl: taut.Controller, mode: str) -> None:
    rig.order("mode", mode)
    rig.look()
    with refused(DriverError) as error:
        rig.robot.start(ctrl)
    assert error.value.kind == "rejected"
    assert not rig.look()["moving"]
    if mode == "kUserStopped":
        with refused(DriverError):
            rig.robot.recover()
    rig.order("mode", None)
    rig.look()
    assert goes_on(rig.robot, ctrl)


# Connections. The last of them leaves nothing of the server.


def test_nobody_listens(arm: taut.Arm) -> None:
    with refused(DriverError) as error:
        taut.connect(f"franka://{own_address(2)}", arm)
    assert error.value.kind == "disconnected"


@steady
def test_a_second_client_is_told_so(rig: Rig, arm: taut.Arm) -> None:
    with refused(DriverError) as error:
        taut.connect(f"franka://{rig.address}", arm)
    assert error.value.kind == "busy"
    assert rig.robot.fault is None


def test_another_version_of_the_interface(rig: Rig, arm: taut.Arm) -> None:
    rig.leave()
    rig.order("version", 9)
    with refused(DriverError) as error:
        taut.connect(f"franka://{rig.address}", arm)
    assert error.value.kind == "rejected"
    rig.order("version", None)


def test_an_arm_on_a_wall_gets_no_wrench_in_the_axes_of_its_base(rig: Rig, arm: taut.Arm) -> None:
    rig.leave()
    R = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    with refused(MatchError):
        taut.connect(f"franka://{rig.address}", arm.mounted(taut.Pose([0.0, 0.0, 1.0], R=R)))


@pytest.mark.long
def test_what_the_page_shows_runs(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    rig.leave()
    page = (Path(__file__).parents[3] / "docs" / "franka.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```py\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    exec(block.replace("172.16.0.2", rig.address), {})
    assert "running" in capsys.readouterr().out


@pytest.mark.part(2)
@pytest.mark.parametrize("loss", ["loop_stopped", "loop_killed", "robot_stopped", "robot_killed"])
def test_what_is_lost_ends_the_motion(rig: Rig, ctrl: taut.Controller, loss: str) -> None:
    rig.reset()
    robot = rig.robot
    robot.start(ctrl)
    robot.wait(0.1)
    pid = robot.link.process.pid if loss.startswith("loop") else rig.process.pid
    begun = time.monotonic()
    os.kill(pid, signal.SIGSTOP if loss.endswith("stopped") else signal.SIGKILL)
    if loss.startswith("loop"):  # its torque acts for 20 more periods, then the robot brakes
        stopped = rig.wait_for("stopped")
        assert stopped["error"] == "communication_constraints_violation"
        assert stopped["missed"] == 21
        assert stopped["time"] - begun < 0.5
    fault = fault_within(robot, 2.0)
    assert time.monotonic() - begun < 0.5  # the client alone would take 1 s; make soak asks for 0.1 s
    assert "connect again" in fault.message
    # A loop that is stopped while it waits for the robot looks like a robot that is silent.
    names = {"loop_stopped": ("silent", "watchdog"), "loop_killed": ("process_died",)}
    assert fault.name in names.get(loss, ("silent",))
    with pytest.raises(RobotError):
        robot.recover()
    if loss == "robot_stopped":
        os.kill(pid, signal.SIGCONT)
        assert rig.wait_for("stopped")["error"] == "communication_constraints_violation"
    if loss == "loop_stopped":
        rig.leave()
        with refused(DriverError):  # until it is cleared
            rig.robot.start(ctrl)
        assert goes_on(rig.robot, ctrl)


@pytest.mark.long
def test_bring_up_tells_a_panda_from_an_fr3(arm: taut.Arm) -> None:
    """The server's arm is an FR3 whose joints have dry friction, which the robot does not compensate there."""
    with FrankaProcess() as franka:
        for name, passed in (("fr3", True), ("panda", False)):
            with taut.connect(f"franka://{franka.address}", taut.load_arm(name)) as robot:
                done = bring_up(robot, start=arm.home, ask=lambda _: True)
            assert done.passed is passed, done
        assert done.steps[-1].name == "gravity"
        assert "'fr3' fits better" in done.steps[-1].found
