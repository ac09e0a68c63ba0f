"""Robots in processes of their own: verbs, faults of driver and process, what is refused, what stays."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faulty_driver import FaultyDriver
from integrating_driver import IntegratingDriver
from refusals import refused
from test_fault_table import stated

import taut
from taut.control.safety import SafeSide
from taut.linear.judgement import Judgement, judge_start
from taut.robots import DriverError, Robot, RobotError, Timing
from taut.runtime.realtime.bringup import remember
from taut.runtime.realtime.connect import hello_of
from taut.runtime.realtime.robot import HOLD, RobotPlant

ARM = taut.load_arm("planar2")
L = taut.laws
CT = L.ComputedTorque(kp=100.0, kd=20.0)
STIFF = L.ComputedTorque(kp=6.5e4, kd=30.0)  # kp must be below 2 kd / dt under a torque that is held
WHOLE = bool(os.environ.get("TAUT_BARS"))


SLOW = """
import sys, time
sys.path.insert(0, {here!r})
from faulty_driver import FaultyDriver
from integrating_driver import IntegratingDriver
class Slow(FaultyDriver):
    noted = False
    def write(self, command):
        super().write(command)
        if not self.noted and abs(self.v).max() > 0.15:
            self.noted = True
            self._note("write")
    def close(self):
        super().close()
        time.sleep(1.0)
"""
CLOSING_IS_PRINTED = """
import contextlib, sys
import taut
import taut.runtime.realtime.robot as module
real = module.uninterrupted
@contextlib.contextmanager
def printed():
    with real():
        print("closing", flush=True)
        yield
module.uninterrupted = printed
"""
MOVING = """
arm = taut.load_arm('planar2')
limits = taut.SafetyLimits.of(arm, missed=1e6)
robot = taut.connect({driver!r} + ':Slow', arm, limits=limits, address='here', options={options})
ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm, rate=1000.0, adds=robot.adds)
robot.start(ctrl, taut.trajectories.Sine(center=robot.q, amplitude=[0.3, 0.3], frequency=1.0), duration=60.0)
"""
MOVE = """
reference = { kind = "sine", center = [0.5, 0.5], amplitude = [0.3, 0.3], frequency = 1.0 }
run = { duration = 60.0, q0 = [0.5, 0.5] }
arm = { model = "planar2" }
plant = { adds = ["gravity"] }
laws.ct = { law = "ComputedTorque", kp = 100.0, kd = 20.0 }
"""


def processes_of(pid: int) -> list[int]:
    """Its children, and theirs."""
    found = map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())
    return [one for child in found for one in (child, *processes_of(child))]


def limits(**more: Any) -> taut.SafetyLimits:
    return stated(ARM, missed=1e6, **more)  # the machine may be busy


def patient(robot: Robot) -> Robot:
    """A robot that a stall of a busy machine does not end."""
    robot.link.set_word("patience", 10**10)
    return robot


def compiled(robot: Robot, law: Any = CT, **more: Any) -> taut.Controller:
    return taut.compile(law, robot.arm, rate=robot.rate, adds=robot.adds, **more)


def wait_for(condition: Callable[[], bool], within: float = 10.0) -> float:
    """Time until it holds [s]."""
    began = time.monotonic()
    while not condition():
        assert time.monotonic() < began + within
        time.sleep(0.0005)
    return time.monotonic() - began


@pytest.fixture(scope="module")
def plant() -> Iterator[Robot]:
    """Two links in a process of their own."""
    with patient(taut.connect(taut.RigidPlant(ARM), limits=limits())) as robot:
        yield robot


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Robot, Path]]:
    """A robot with a driver in Python, and what it writes down."""
    log = tmp_path_factory.mktemp("driver") / "log"
    options = {"log": str(log)}
    with patient(taut.connect(FaultyDriver, ARM, limits=limits(), address="here", options=options)) as robot:
        yield robot, log


def events(log: Path) -> list[str]:
    return [line.split()[0] for line in log.read_text(encoding="utf-8").splitlines()]


@pytest.fixture
def calm(plant: Robot) -> Iterator[Robot]:
    yield plant
    with contextlib.suppress(taut.TautError):
        plant.recover()
    plant.stop()


class TestVerbs:
    def test_a_law_starts_where_the_arm_is_without_a_jump_of_torque(self, calm: Robot) -> None:
        calm.start(compiled(calm))
        calm.wait(0.1)
        run = calm.stop()
        g = np.asarray(taut.snapshot(ARM, run.q[0]).g)
        np.testing.assert_allclose(run.command[0], g, atol=1e-6)
        assert np.abs(np.diff(run.command, axis=0)).max() < 1e-3
        assert np.abs(run.q - run.q[0]).max() < 1e-6
        assert run.outcome.kind == "completed"
        assert calm.status.state == "idle"

    def test_moves_and_switches_and_stops(self, calm: Robot) -> None:
        here = calm.q
        change = np.array([0.15, -0.1])
        calm.move_to(here + change, speed=0.4)
        assert np.abs(calm.q - here - change).max() < 5e-3
        assert calm.status.state == "running"
        calm.switch(compiled(calm, L.GravityPID(kp=50.0, kd=8.0)), over=0.05)
        calm.wait(0.1)
        calm.hold()
        wait_for(lambda: calm.status.state == "holding")
        calm.start(compiled(calm))  # a hold does not outlast the next start
        calm.wait(0.02)
        assert calm.status.state == "running"
        with refused(taut.errors.UsageError):
            calm.shadow(compiled(calm))
        assert isinstance(calm.stop(), taut.Run)
        with refused(taut.errors.UsageError):
            calm.switch(compiled(calm))

    def test_a_shadow_sends_nothing_and_the_start_after_it_does_not_jump(self, calm: Robot) -> None:
        here = calm.q
        calm.shadow(compiled(calm, L.PID(kp=100.0, kd=5.0)), taut.JointMotion(q=here + 0.5))
        calm.wait(0.05)
        assert calm.status.state == "shadow"
        run = calm.run()
        assert not run.extra["loop.sent"].any()
        assert np.abs(run.command[-1]).max() > 10.0
        np.testing.assert_array_equal(calm.q, here)
        calm.start(compiled(calm))
        calm.wait(0.02)
        run = calm.run()
        assert run.extra["loop.sent"].all()
        np.testing.assert_allclose(run.command[0], np.asarray(taut.snapshot(ARM, here).g), atol=1e-6)

    def test_parameters_change_while_it_runs_and_come_in_smoothly(self, calm: Robot) -> None:
        calm.start(compiled(calm, L.ComputedTorque(kp=100.0, kd=20.0)), taut.JointMotion(q=calm.q + 0.02))
        calm.wait(0.05)
        paths = dict(calm.parameters)
        calm.parameters.update({"law.kp": 200.0, "model.payload.mass": 0.5})
        for path, value in paths.items():
            calm.parameters[path] = value  # every path is settable
        calm.parameters["law.kp"] = 60.0
        calm.wait(0.05)
        run = calm.run()
        assert run.extra["parameters.law.kp"][-1] == 60.0
        assert {100.0, 200.0, 60.0} >= {*np.unique(run.extra["parameters.law.kp"])}
        both = run.extra["parameters.law.kp"] == 200.0
        np.testing.assert_array_equal(run.extra["parameters.model.payload.mass"][both], 0.5)  # both in one tick
        steps = np.abs(np.diff(run.command, axis=0))
        assert steps.max() < 0.5
        with refused(taut.errors.RangeError):
            calm.parameters["law.kp"] = -1.0
        with pytest.raises(taut.errors.RangeError) as found:
            calm.parameters["law.kd"] = 5000.0
        assert found.value.name == "law"
        with refused(taut.errors.UnknownNameError):
            calm.parameters["law.kpp"] = 1.0
        assert calm.parameters["law.kd"] == 20.0

    def test_timing_is_in_the_record(self, calm: Robot) -> None:
        calm.start(compiled(calm))
        calm.wait(0.05)
        timing = Timing.of(calm.stop())
        assert len(timing.compute) >= 40
        assert 0.0 < timing.share < 0.5
        assert (timing.late >= 0.0).all()
        assert len(timing.plot().axes) == 3
        assert "periods missed" in str(timing)
        assert "timing" in calm.status.json()
        assert len(repr(calm.status)) < 250
        assert f"RobotStatus({calm.status.state}" in repr(calm.status)
        with refused(taut.errors.UsageError):
            Timing.of(taut.run(taut.compile(CT, ARM), taut.RigidPlant(ARM), duration=0.01))

    def test_a_fault_carries_its_last_ticks(self, calm: Robot) -> None:
        calm.start(compiled(calm))
        calm.wait(0.1)
        fast = L.ComputedTorque(kp=3000.0, kd=4.0)
        calm.start(compiled(calm, fast), taut.JointMotion(q=calm.q + 0.099), over=0.0)
        with pytest.raises(RobotError) as found:
            calm.wait(1.0)
        assert found.value.fault.name == "speed"
        run = found.value.run
        assert 10 < len(run) <= 1000
        faults = run.extra["safe.fault"]
        assert faults[-1] == found.value.fault.code == 31
        assert np.argmax(faults > 0) > 0
        assert run.outcome.joint == found.value.joint
        with pytest.raises(RobotError):
            calm.start(compiled(calm))
        calm.recover()
        assert calm.status.state == "idle"
        assert calm.run().outcome.message.startswith("speed (31)")  # it ended so, whatever was cleared


KINDS = ("silent", "disconnected", "robot_error", "busy", "ValueError")


class TestDriverFaults:
    @pytest.mark.parametrize("where", ["read", "write"])
    @pytest.mark.parametrize("kind", KINDS)
    def test_every_exception_ends_the_motion(
        self, driven: tuple[Robot, Path], where: str, kind: str, bar: Any
    ) -> None:
        robot, log = driven
        robot.start(compiled(robot))
        robot.wait(0.01)
        robot.call("fail", **{where: kind})
        with pytest.raises(RobotError) as found:
            robot.wait(1.0)
        assert found.value.fault.name == ("driver" if kind == "ValueError" else kind)
        wait_for(lambda: events(log)[-1] == "end")
        ticks = robot.link.word("ticks")
        time.sleep(0.005)
        assert robot.link.word("ticks") == ticks  # nothing is sent any more
        assert len(found.value.run)
        robot.recover()
        assert events(log)[-1] == "recover"
        robot.start(compiled(robot))
        robot.wait(0.01)
        robot.stop()
        assert events(log)[-2:] == ["begin", "end"]
        bar(
            f"fault: {kind} in the driver's {where}",
            "nothing more is sent, control is given back; latched, recovered",
        )

    def test_a_robot_that_does_not_begin_goes_on_to_be_read(self, driven: tuple[Robot, Path]) -> None:
        robot, log = driven
        robot.call("fail", begin="rejected")
        with pytest.raises(DriverError):
            robot.start(compiled(robot))
        assert events(log)[-1] == "end"
        assert robot.status.state == "idle"
        ticks = robot.link.word("ticks")
        wait_for(lambda: robot.link.word("ticks") > ticks + 5)
        robot.start(compiled(robot))
        robot.wait(0.01)
        robot.stop()

    def test_a_payload_that_the_robot_does_not_compensate_is_refused_while_it_runs(self) -> None:
        options = {"load": (0.0, (0.0, 0.0, 0.0))}
        with patient(taut.connect(FaultyDriver, ARM, limits=limits(), address="here", options=options)) as robot:
            robot.start(compiled(robot))
            with refused(taut.errors.MatchError):
                robot.parameters.update({"model.payload.mass": 2.0})

    def test_an_end_that_fails_is_raised_by_the_stop(self, driven: tuple[Robot, Path]) -> None:
        robot, _ = driven
        robot.start(compiled(robot))
        robot.call("fail", end="robot_error")
        with pytest.raises(DriverError, match="failed in end"):
            robot.stop()
        assert robot.status.state == "idle"

    def test_what_a_driver_never_writes_is_no_measurement(self) -> None:
        robot = taut.connect(FaultyDriver, ARM, limits=limits(), address="here", options={"rebinds": True})
        with robot, pytest.raises(RobotError) as found:
            robot.hold()
        assert found.value.fault.name == "sensor_not_finite"

    def test_a_robot_that_is_moved_by_hand_starts_without_a_jump(self, driven: tuple[Robot, Path]) -> None:
        robot, _ = driven
        q = robot.q
        for k in range(6):
            robot.call("place", q=q + 0.004 * k)
            time.sleep(0.06)
        robot.start(compiled(robot))
        robot.wait(0.02)
        assert np.abs(robot.stop().command[:5]).max() < 1e-6

    def test_an_answer_that_nobody_waits_for_any_more_is_not_taken_for_another(
        self, driven: tuple[Robot, Path]
    ) -> None:
        robot, _ = driven
        robot.call("grasp")
        robot.link._send(("call", ("gripper", {}), 0))  # as Ctrl-C leaves one
        assert robot.call("push", v=0.0) is None

    def test_a_gripper_is_the_drivers(self, driven: tuple[Robot, Path]) -> None:
        robot, _ = driven
        robot.start(compiled(robot))
        assert robot.gripper.grasp(0.02, 20.0)["width"] == 0.02
        with pytest.raises(DriverError):
            robot.call("dance")
        assert robot.status.state == "running"
        with refused(taut.errors.UsageError):
            robot.set_load(taut.Payload(mass=1.0))
        robot.stop()
        robot.set_load(taut.Payload(mass=1.0))
        assert robot.arm.payload.mass == 1.0
        with refused(taut.errors.MatchError):
            robot.start(taut.compile(CT, ARM, rate=robot.rate, adds=robot.adds))
        robot.set_load(taut.Payload(mass=0.0))

    def test_a_robot_without_a_gripper_is_named(self, calm: Robot) -> None:
        with refused(DriverError):
            calm.gripper.move(0.02)


class TestProcess:
    """The loop's process is ended from outside within 100 ms; `make bars` asks for that figure."""

    @pytest.fixture
    def acting(self, tmp_path: Path) -> Iterator[tuple[Robot, Path]]:
        log = tmp_path / "log"
        options = {"log": str(log)}
        robot = taut.connect(
            FaultyDriver, ARM, limits=limits(), address="here", options=options, log=tmp_path / "logs"
        )
        robot.start(compiled(robot))
        robot.wait(0.05)
        yield robot, log
        robot.close()

    @pytest.mark.parametrize("how", ["hang in read", "hang in write", "stopped", "killed"])
    def test_a_loop_that_does_not_tick_is_ended(self, acting: tuple[Robot, Path], how: str, bar: Any) -> None:
        robot, log = acting
        pid = robot.link.process.pid
        if how.startswith("hang"):
            robot.call("fail", **{how.split()[-1]: "hang"})
        else:
            os.kill(pid, signal.SIGSTOP if how == "stopped" else signal.SIGKILL)
        wait_for(lambda: robot.link.process.poll() is not None)
        took = robot.link.silence  # since the last tick
        assert took < (0.1 if WHOLE else 1.0)
        name = {"hang in read": "silent", "killed": "process_died"}.get(how, "watchdog")
        with pytest.raises(RobotError) as found:
            robot.check()
        assert found.value.fault.name == name or (how == "stopped" and found.value.fault.name == "silent")
        assert len(found.value.run) > 10
        with pytest.raises(RobotError):
            robot.recover()
        assert robot.status.state == "gone"
        robot.close()
        (file,) = (log.parent / "logs").iterdir()
        assert taut.load_run(file).outcome.kind == "stopped"
        assert taut.load_run(file).outcome.message.startswith(found.value.fault.name)
        bar(
            f"a loop that is {how.replace('hang', 'hung')}: ended from outside, after the last tick [ms]",
            f"{1e3 * took:.0f}",
        )

    def test_without_its_watchdog_the_loop_stops(self, acting: tuple[Robot, Path]) -> None:
        robot, _ = acting
        children = Path(f"/proc/{robot.link.process.pid}/task/{robot.link.process.pid}/children").read_text()
        (watchdog,) = map(int, children.split())
        os.kill(watchdog, signal.SIGKILL)
        with pytest.raises(RobotError) as found:
            robot.wait(5.0)
        assert found.value.fault.name == "unwatched"
        with pytest.raises(RobotError):
            robot.recover()  # the watchdog is still dead

    def test_without_its_parent_the_arm_stops_and_everything_ends(self, tmp_path: Path) -> None:
        log, here = tmp_path / "log", Path(__file__).parent
        program = (
            f"import sys, time; sys.path.insert(0, {str(here)!r})\n"
            "import taut; from faulty_driver import FaultyDriver\n"
            "arm = taut.load_arm('planar2')\n"
            f"robot = taut.connect(FaultyDriver, arm, address='here', options={{'log': {str(log)!r}}})\n"
            "ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm, rate=1000.0, adds=robot.adds)\n"
            "robot.start(ctrl, taut.trajectories.Sine(center=robot.q, amplitude=[0.3, 0.3], frequency=1.0), duration=9.0)\n"
            "print(robot.link.process.pid, flush=True)\ntime.sleep(100)\n"
        )
        parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
        try:
            assert parent.stdout is not None
            pid = int(parent.stdout.readline())
            time.sleep(0.3)
        finally:
            parent.kill()
            parent.wait()
            parent.stdout.close()
        wait_for(lambda: not Path(f"/proc/{pid}").exists() or "Z" in Path(f"/proc/{pid}/stat").read_text().split()[2])
        lines = [line.split() for line in log.read_text(encoding="utf-8").splitlines()]
        assert [line[0] for line in lines] == ["begin", "end", "close"]
        assert max(abs(float(v)) for v in lines[1][1:]) < 0.02  # it stood when control ended

    @pytest.mark.parametrize("ending", ["with", "no with", "command line"])
    @pytest.mark.part(1)
    def test_more_than_one_ctrl_c_does_not_keep_the_arm_from_its_stop(
        self, ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
        log, driver, here = tmp_path / "log", tmp_path / "slow.py", Path(__file__).parent
        driver.write_text(SLOW.format(here=str(here)), encoding="utf-8")
        options = {"log": str(log)}
        if ending == "command line":
            (tmp_path / "move.toml").write_text(MOVE, encoding="utf-8")
            (tmp_path / "robot.toml").write_text(
                f"robot = 'slow.py:Slow'\naddress = 'here'\noptions = {{ log = '{log}' }}\nlimits = {{ missed = 1e6 }}\n"
            )
            remember(hello_of(f"{driver}:Slow", ARM, address="here", options=options), ARM)
            program = (
                f"from taut.cli.main import main\nsys.exit(main({['run', 'move.toml', '--robot', 'robot.toml']}))"
            )
        else:
            program = MOVING.format(driver=str(driver), options=options)
            program += "with robot:\n    robot.wait(60.0)\n" if ending == "with" else "robot.wait(60.0)\n"
        parent = subprocess.Popen(
            [sys.executable, "-c", CLOSING_IS_PRINTED + program], cwd=tmp_path,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            wait_for(lambda: log.exists() and "write" in log.read_text(), 60.0)
            children = processes_of(parent.pid)
            parent.send_signal(signal.SIGINT)
            assert parent.stdout is not None
            assert parent.stdout.readline() == "closing\n"
            parent.send_signal(signal.SIGINT)
            for event in ("end", "close"):  # which takes its time
                wait_for(lambda event=event: event in events(log))
                parent.send_signal(signal.SIGINT)
            _, errors = parent.communicate(timeout=30.0)
        finally:
            parent.kill()
            parent.communicate()
        assert len(children) == (3 if ending == "command line" else 2)  # the loop's, its watchdog, the log's
        assert not [pid for pid in children if Path(f"/proc/{pid}").exists()]
        lines = [line.split() for line in log.read_text(encoding="utf-8").splitlines()]
        assert [line[0] for line in lines] == ["begin", "write", "end", "close"]
        assert max(abs(float(v)) for v in lines[1][1:]) > 0.1  # it moved
        assert max(abs(float(v)) for v in lines[2][1:]) < 0.02  # it stood when control ended
        assert errors.count("Traceback") == (ending != "command line"), errors
        assert errors.count("KeyboardInterrupt") == (ending != "command line"), errors

    def test_ctrl_c_while_a_robot_is_closed_comes_behind_it(self) -> None:
        program = (
            "import signal\nfrom taut.runtime.realtime.shared import uninterrupted\n"
            "with uninterrupted():\n    with uninterrupted():\n        signal.raise_signal(signal.SIGINT)\n"
            "    print('closed', flush=True)\nprint('not reached')"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
        assert (done.stdout, done.returncode) == ("closed\n", -signal.SIGINT)

    @pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGKILL])
    def test_two_robots_stop_together(self, acting: tuple[Robot, Path], how: signal.Signals) -> None:
        robot, _ = acting
        with taut.connect(FaultyDriver, ARM, limits=limits(), address="there", together=robot) as other:
            other.start(compiled(other))
            other.wait(0.02)
            robot.call("fail", read="robot_error")
            with pytest.raises(RobotError) as found:
                other.wait(2.0)
            assert found.value.fault.name == "partner"
            with pytest.raises(taut.errors.UsageError, match="recover it first"):
                other.recover()
            robot.recover()
            other.recover()
            for one in (robot, other):  # each with a fault of its own: either may come first
                one.start(compiled(one))
                one.call("fail", read="robot_error")
                with pytest.raises(RobotError):
                    one.wait(2.0)
            robot.recover()
            other.recover()
            other.start(compiled(other))
            robot.start(compiled(robot))
            robot.wait(0.02)
            os.kill(other.link.process.pid, how)
            with pytest.raises(RobotError) as found:
                robot.wait(2.0)
            assert found.value.fault.name == "partner"


@pytest.mark.long
def test_a_slow_robot_is_not_taken_for_a_dead_one(tmp_path: Path) -> None:
    """And has one log, though its ticks are further apart than the looks of the log process."""
    with taut.connect(taut.RigidPlant(ARM), limits=limits(), rate=8.0, log=tmp_path) as robot:
        robot.start(compiled(robot, L.ComputedTorque(kp=4.0, kd=4.0)))
        robot.wait(1.0)
        assert robot.status.state == "running"
    (file,) = tmp_path.iterdir()
    assert len(taut.load_run(file)) > 6


class TestMisuse:
    def test_of_addresses_and_robots(self, tmp_path: Path) -> None:
        for wrong in ("172.16.0.2", "frnka://1", "franka://", "can://can0"):
            with refused(taut.TautError):
                taut.connect(wrong, ARM)
        with refused(taut.errors.UsageError):
            taut.connect(3)  # type: ignore[arg-type]
        with refused(taut.TautError):
            taut.connect(FaultyDriver)
        with refused(taut.TautError):
            taut.connect(taut.RigidPlant(ARM), limits=taut.Limits(tau=3.0))  # type: ignore[arg-type]
        with refused(taut.errors.RangeError):
            taut.connect(taut.RigidPlant(ARM), rate=0.001)
        with pytest.raises(DriverError):  # a period of 100 ns
            taut.connect(taut.RigidPlant(ARM), rate=1e7)

        class Local(FaultyDriver):
            pass

        with refused(taut.errors.UsageError):
            taut.connect(Local, ARM)
        script = tmp_path / "script.py"
        script.write_text(
            "import taut\nfrom taut.robots import RobotDriver\nclass Mine(RobotDriver):\n    pass\n"
            "try:\n    taut.connect(Mine, taut.load_arm('planar2'))\nexcept taut.errors.UsageError as e:\n    print(e)\n",
            encoding="utf-8",
        )
        done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60)
        assert done.stdout.startswith("Mine is not at the top of a module")

    def test_of_a_robot_that_is_not_ready_or_another_one(self) -> None:
        for options in ({"refuses": "disconnected"}, {"n": 3}, {"takes": "tork"}):
            with refused(taut.TautError):
                taut.connect(FaultyDriver, ARM, address="here", options=options)
        with refused(taut.TautError):
            taut.connect("udp://127.0.0.1:4000", ARM, options={"speed": 1.0})
        for wrong in ({"options": {"speed": lambda: 0.0}}, {"options": [1]}, {"rate": 500.0}, {"together": "here"}):
            with pytest.raises(taut.errors.UsageError, match=next(iter(wrong))):
                taut.connect("udp://127.0.0.1:4000", ARM, **wrong)  # type: ignore[arg-type]

    def test_of_limits(self, calm: Robot) -> None:
        S = taut.SafetyLimits
        bounded = ARM.with_joints(velocity=2.0, effort=[50.0, 20.0], lower=-1.0, upper=2.0)
        for wrong in (
            {"v": 100.0},
            {"tau": 30.0},
            {"lower": -1.5},
            {"upper": [1.0, 2.1]},
            {"deceleration": [1.0, 0.8]},
            {"tau_dot": [99.0, 100.0]},
        ):
            with refused(taut.errors.RangeError):
                taut.connect(taut.RigidPlant(bounded), limits=S.of(bounded, **wrong))
        outside = S.of(ARM, box=((0.0, 0.0, -1.0), (0.1, 0.1, 1.0)))
        for limits in (outside, S.of(ARM, tau=(5.0, 2.0))):
            with taut.connect(taut.RigidPlant(ARM), limits=limits) as robot:
                with refused(taut.errors.RangeError):
                    robot.hold()
                assert robot.status.state == "idle"
        for wrong in (
            {"lower": 1.0, "upper": -1.0},
            {"lower": -0.1, "upper": 0.1, "soft": 0.2},
            {"box": ((0.0, 0.0, 0.0), (1.0, -1.0, 1.0))},
            {"tau": -1.0},
            {"tau": np.nan},
            {"deceleration": 0.0},
        ):
            with refused(taut.TautError):
                S(**wrong)  # type: ignore[arg-type]
        side = compiled(calm).side
        for wrong in ({"tau": (1.0, 2.0, 3.0)}, {"tool_force": 10.0}, {"tau": 0.5}, {"contact": 3.0}):
            safe = SafeSide(side=side, limits=S(**wrong), measures=("v",))  # type: ignore[arg-type]
            with refused(taut.TautError):
                safe.check()
                safe.check_pose(ARM.home)
        speeds = taut.compile(L.VelocityPI(kp=5.0), ARM).side
        with refused(taut.errors.UsageError):
            SafeSide(side=speeds, limits=S(power=10.0), measures=("v",)).check()

    def test_of_controllers(self, calm: Robot) -> None:
        other = taut.load_arm("planar3")
        for ctrl in (
            taut.compile(CT, ARM, rate=500.0),
            taut.compile(CT, other),
            taut.compile(L.VelocityPI(kp=5.0), ARM),
            taut.compile(CT, ARM, adds=("gravity",)),
            3,
        ):
            with refused(taut.TautError):
                calm.start(ctrl)  # type: ignore[arg-type]
        with pytest.raises(
            taut.errors.RangeError
        ) as found:  # unstable as a sampled loop; at which joint, the pose decides
            calm.start(compiled(calm, L.ComputedTorque(kp=100.0, kd=3000.0)))
        assert found.value.name == "law"
        for unstable in (
            STIFF,
            [taut.Phase(CT, name="one", until=lambda x: x.elapsed > 9.0), taut.Phase(STIFF, name="two")],
        ):
            with pytest.raises(taut.errors.RangeError, match=r"unstable .* largest gain .*kp = (5\.9|6\.0)\d*e\+04"):
                calm.start(compiled(calm, unstable))
        calm.require(compiled(calm, L.ComputedTorque(kp=5.5e4, kd=30.0)))
        here, far = calm.q, calm.q + np.array([0.5, 0.0])
        for ref in (
            taut.JointMotion(q=far),
            taut.trajectories.Quintic(q0=far, q1=here, duration=1.0),
            taut.trajectories.Samples(times=[0.0, 0.5, 0.501], q=[here, here, far]),
            taut.JointMotion(q=here, v=[2.0, 0.0]),
            taut.trajectories.Quintic(q0=here, q1=here + 0.5, duration=0.1),
        ):
            with refused(taut.errors.RangeError):
                calm.start(compiled(calm), ref)
        with pytest.raises(taut.errors.RangeError, match=r"must stay within limits\.upper; it is .* beyond after"):
            calm.start(compiled(calm), taut.trajectories.Quintic(q0=here, q1=[8.0, 0.0], duration=60.0))
        T = taut.snapshot(ARM, here).T()
        for pose, name in (
            (taut.Pose.of(T.R, T.p + 0.3 * np.eye(3)[1]), "p"),
            (taut.Pose.of(T.R @ np.diag([-1.0, -1.0, 1.0]), T.p), "R"),
        ):
            with pytest.raises(taut.errors.RangeError, match=f"ref.{name} must be within 0.1.* of where the arm is"):
                calm.start(compiled(calm, L.Impedance(K=(500.0, 10.0), zeta=1.0)), taut.TaskMotion(pose=pose))
        with refused(taut.errors.RangeError):
            calm.move_to(here, speed=1.0)
        with refused(taut.errors.RangeError):
            calm.move_to([90.0, 0.0])
        with refused(taut.errors.ShapeError):
            calm.move_to([0.1])
        assert calm.link.word("control") == 0  # nothing was sent
        assert calm.status.state == "idle"

    def test_of_a_start_elsewhere_is_known_before_the_arm_is_there(self, calm: Robot) -> None:
        away, ctrl = ARM.home + np.array([0.5, 0.0]), compiled(calm)
        path = taut.trajectories.Quintic(q0=away, q1=ARM.home, duration=1.0)
        calm.require(ctrl, path, q=away)
        for wrong in (
            lambda: calm.require(ctrl, path),
            lambda: calm.require(compiled(calm, L.ComputedTorque(kp=100.0, kd=3000.0)), path, q=away),
            lambda: calm.require(ctrl, L.ComputedTorque, q=away),
            lambda: calm.require(ctrl, path, q=[0.5]),
        ):
            with pytest.raises(taut.TautError):
                wrong()  # type: ignore[no-untyped-call]
        assert calm.status.state == "idle"

    def test_after_it_is_closed(self) -> None:
        robot = taut.connect(taut.RigidPlant(ARM))
        robot.close()
        robot.close()
        for use in (
            lambda: robot.start(taut.compile(CT, ARM)),
            robot.stop,
            robot.hold,
            robot.recover,
            robot.run,
            lambda: robot.q,
            lambda: robot.status,
            lambda: robot.call("x"),
            lambda: taut.connect(taut.RigidPlant(ARM), together=robot),
        ):
            with pytest.raises(taut.errors.UsageError):
                use()  # type: ignore[no-untyped-call]

    def test_a_stop_during_a_start_wins(self, calm: Robot) -> None:
        raised = list[BaseException]()
        ctrl = compiled(calm, L.Impedance(K=(300.0, 20.0), zeta=0.7))

        def start() -> None:
            try:
                calm.start(ctrl)
            except BaseException as error:
                raised.append(error)

        thread = threading.Thread(target=start)
        thread.start()
        time.sleep(0.01)
        calm.stop()
        thread.join()
        assert calm.link.word("control") == 0
        assert [type(error) for error in raised] == [taut.errors.UsageError]

    @pytest.mark.parametrize("verb", ["stop", "hold", "move_to"])
    def test_a_motion_that_another_verb_ends_says_so(self, calm: Robot, verb: str) -> None:
        raised, goal = list[BaseException](), calm.q + 0.5

        def move() -> None:
            try:
                calm.move_to(goal, speed=0.1)
            except BaseException as error:
                raised.append(error)

        thread = threading.Thread(target=move)
        thread.start()
        wait_for(lambda: calm.status.state == "running")
        getattr(calm, verb)(*[calm.q] * (verb == "move_to"))
        thread.join()
        assert "ended by another verb" in str(raised[0])

    def test_starts_from_two_threads_follow_each_other(self, calm: Robot) -> None:
        ctrls = [compiled(calm, L.ComputedTorque(kp=k, kd=20.0)) for k in (50.0, 60.0)]
        threads = [threading.Thread(target=calm.start, args=(ctrl,)) for ctrl in ctrls]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        calm.wait(0.02)
        assert calm.status.state == "running"
        assert float(calm.parameters["law.kp"]) == calm.run().extra["parameters.law.kp"][-1]


@pytest.mark.parametrize("name", ["planar2", "panda", "ur10", "kinova", "xarm7"])
@pytest.mark.parametrize("rate", [500.0, 1000.0])
@pytest.mark.part(2)
def test_a_robot_is_judged_as_it_moves_under_a_torque_that_is_held(name: str, rate: float) -> None:
    """e'' + kd e' + kp e = 0 with a torque held for dt is stable for kp < 2 kd / dt, kd < 2 / dt."""
    arm = taut.load_arm(name).with_friction(taut.Friction())
    plant = RobotPlant(name="a robot", arm=arm, takes="torque", measures=frozenset({"v"}), adds=())
    for kd in (30.0, 200.0):
        for part in (0.97, 1.03):
            ctrl = taut.compile(L.ComputedTorque(kp=part * 2.0 * kd * rate, kd=kd), arm, rate=rate)
            verdict = judge_start(ctrl, plant, arm.home + 0.1)
            assert isinstance(verdict, Judgement)
            assert verdict.stable == (part < 1.0)


def test_a_robot_of_speeds_is_judged_with_drives_as_fast_as_its_loop() -> None:
    """v = kp e held for dt, and ideal drives: stable for kp < 2 / dt, 1000 1/s here."""
    arm = taut.load_arm("ur10")
    with taut.connect(IntegratingDriver, arm, limits=taut.SafetyLimits.of(arm, missed=1e6)) as robot:
        for kp in (100.0, 1500.0):
            seen = taut.Sensing(velocity="difference")
            ctrl = taut.compile(L.VelocityPI(kp=kp), arm, rate=robot.rate, sensing=seen)
            with contextlib.nullcontext() if kp < 1000.0 else refused(taut.errors.RangeError):
                robot.require(ctrl)


def test_the_doctor_leaves_the_controlled_stop_to_itself(calm: Robot) -> None:
    """A law that followed well and was stopped on its way is healthy: where the arm stands is not its target."""
    calm.move_to(ARM.home, speed=0.5)
    path = taut.trajectories.Quintic(q0=calm.q, q1=calm.q + 0.6, duration=2.0)
    calm.start(compiled(calm), path)
    calm.wait(1.0)
    calm.hold()
    calm.wait(2.0)
    run = calm.stop()
    calm.recover()
    assert (run.extra["safe.mode"] < 0.5).sum() > 1500
    assert not taut.doctor(run).findings


def test_many_starts_leave_nothing_behind(calm: Robot, share: Callable[[int], int], bar: Any) -> None:
    pid = calm.link.process.pid
    made = calm._compiled(ctrl := compiled(calm))

    def counts() -> tuple[int, int, int, int]:
        fds = [len(list(Path(f"/proc/{k}/fd").iterdir())) for k in (pid, os.getpid())]
        maps = [len(Path(f"/proc/{k}/maps").read_text().splitlines()) for k in (pid, os.getpid())]
        return (*fds, *maps)  # type: ignore[return-value]

    def again(times: int) -> None:
        for k in range(times):
            calm._act(ctrl, made, HOLD, begins=True, controls=True)
            if k % 5 == 0:
                calm.stop()

    again(10)
    before = counts()
    count = share(1000)
    again(count)
    after = counts()
    assert np.abs(np.subtract(after, before)).max() <= 6, (before, after)
    bar(
        f"{count} starts of a law on a robot: file descriptors and memory maps more",
        f"{max(np.subtract(after, before))}",
    )
