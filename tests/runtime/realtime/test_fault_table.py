"""Every fault that the loop can see ends in a defined torque within one tick, named, latched, and can be recovered."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from virtual_robot import Fault, Setup, VirtualRobot, stop_torque

import taut
from taut.codegen.servo_loop import STATUS, TABLE
from taut.control.faults import CODES, FAULTS, fault_of
from taut.runtime.realtime.feeding import References, references_of
from taut.runtime.realtime.sets import Table
from taut.trace import math as tm

ARMS = ("one_joint", "planar2", "gantry3", "ur10", "panda")
AT = 100  # ticks after the start
ROUNDING = 1e-9  # relative to the largest torque
STATED = {"tau": 300.0, "tau_dot": 3000.0, "v": 3.0, "lower": -7.0, "upper": 7.0, "deceleration": 10.0}
JOINT = -1  # the last joint of each arm
REPOSITORY = Path(__file__).parents[3]


class NanAfter(taut.Law):
    """A law that breaks down in its command or in its memory."""

    after: taut.Gain = taut.Gain(0.1)  # [s]
    value: taut.Gain = taut.Gain(1.0)  # times infinity, less infinity: NaN
    memory_breaks: bool = False
    total: taut.Memory = taut.Memory(0.0)

    def command(self, x: Any, ref: Any, memory: Any, dt: Any) -> Any:
        bad = tm.where(x.t >= self.after.as_array() - 1e-9, self.value.as_array() * np.inf, 0.0)
        ok = taut.Torque(g=x.h, D=-2.0 * x.v, bad=0.0 * x.q if self.memory_breaks else tm.array([bad] * x.n))
        return ok, {"total": memory.total + (bad * x.q if self.memory_breaks else 0.0 * x.q)}


def stated(arm: taut.Arm, **limits: Any) -> taut.SafetyLimits:
    """The arm's own limits, or some where it has none."""
    own = {"tau": arm.effort, "tau_dot": 10.0 * arm.effort, "v": arm.velocity, "lower": arm.lower, "upper": arm.upper}
    finite = {name: np.where(np.isfinite(x), x, STATED[name]) for name, x in own.items()}
    return taut.SafetyLimits.of(arm, **{**finite, **limits})


@cache
def setup(name: str, **limits: Any) -> Setup:
    arm = taut.load_arm(name)
    made = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm, rate=1000.0)
    return Setup(made, stated(arm, **limits))


def moving(of: Setup, speed: float = 0.3) -> References:
    """A motion of every joint, at that part of its speed limit in tick AT."""
    arm = of.arm
    v = speed * np.broadcast_to(of.limits.v, arm.n)
    k = np.arange(400) / of.rate
    ramp = np.minimum(k / (AT / of.rate), 1.0)
    s = np.cumsum(ramp) / of.rate
    motion = taut.trajectories.Samples(times=k, q=arm.home + s[:, None] * v)
    return references_of(of.ctrl, motion, arm.home, None)


def started(of: Setup, *faults: Fault, speed: float = 0.3, **more: Any) -> VirtualRobot:
    robot = VirtualRobot(of, faults, **more)
    robot.start(references=moving(of, speed), over=0.005)
    return robot


def fault_tick(robot: VirtualRobot) -> int:
    """The first tick with a fault, since the start."""
    faults = robot.rows("safe.fault")
    return int(np.argmax(faults > 0)) if faults[-1] > 0 else -1


def in_table(bar: Any, kind: str, code: str, ticks: int = 0) -> None:
    """A row of the table that `make bars` prints."""
    seen = "in its tick" if ticks == 0 else f"after {ticks} ticks"
    bar(f"fault: {kind}", f"{code} ({CODES[code]}), seen {seen}; the stop's torque in that tick, latched, recovered")


def check_stop(
    robot: VirtualRobot,
    code: str,
    tick: int,
    *,
    joint: str | None,
    lost: Any = (),
    contrary: bool = False,
    again: bool = True,
) -> None:
    """The torque in the tick of the fault, what is latched, the limits ever after, rest, and recovery."""
    of, arm = robot.setup, robot.setup.arm
    k = fault_tick(robot)
    assert k == tick
    fault = robot.acting.fault()
    assert fault is not None
    assert (fault.name, fault.code, fault.joint) == (code, CODES[code], joint)
    assert fault.tick == robot._began + k
    command, q, v = (robot.rows(name) for name in ("command", "q", "v"))
    q_seen, v_seen = q[k].copy(), v[k].copy()
    if len(lost):
        by_position = np.clip((q[k] - q[k - 1]) * of.rate, -np.abs(v[k]), np.abs(v[k]))
        q_seen[lost], v_seen[lost] = q[k - 1][lost], (by_position if contrary else v[k - 1])[lost]
    tau = stop_torque(of, command[k - 1], q_seen, v_seen, v[k - 1], lost)
    np.testing.assert_allclose(command[k], tau, rtol=0.0, atol=ROUNDING * max(1.0, np.abs(tau).max()))
    np.testing.assert_array_equal(robot.sent[k], command[k])
    robot.run(400)
    faults, command = robot.rows("safe.fault"), robot.rows("command")
    assert (faults[k:] == CODES[code]).all()
    assert np.isfinite(command).all()
    assert (np.abs(command) <= np.asarray(of.limits.tau) + ROUNDING).all()
    steps = np.abs(np.diff(command[:k], axis=0)) / (np.asarray(of.limits.tau_dot) / of.rate)
    assert steps.max() <= 1.0 + ROUNDING
    true = robot._true.views["v"]
    held = [i for i in range(arm.n) if i not in np.arange(arm.n)[list(lost)]]
    assert np.abs(true[held]).max(initial=0.0) < (0.05 if len(lost) else 0.01), true
    # Recovery: nothing is latched any more, and the law acts as before.
    robot.schedule.clear()
    robot.recover()
    robot.run(5)
    assert robot.acting.fault() is None
    if again:
        robot.start(over=0.02)
        robot.run(50)
        assert robot.acting.fault() is None
        assert robot.row("safe.mode") == 1.0


def drop(x: Any, before: Any) -> Any:
    return np.zeros_like(x)


SENSORS: dict[
    str, tuple[Fault, str, int, bool]
] = {  # what is falsified, the code, ticks until it is seen, contradiction
    "q is NaN": (Fault("q", lambda x, b: np.nan, JOINT, AT), "sensor_not_finite", 0, False),
    "q is infinite": (Fault("q", lambda x, b: np.inf, JOINT, AT), "sensor_not_finite", 0, False),
    "q is NaN for one tick": (Fault("q", lambda x, b: np.nan, JOINT, AT, 1), "sensor_not_finite", 0, False),
    "q is 1e9": (Fault("q", lambda x, b: 1e9, JOINT, AT), "sensor_not_finite", 0, False),
    "v is NaN": (Fault("v", lambda x, b: np.nan, JOINT, AT), "sensor_not_finite", 0, False),
    "v is minus infinity": (Fault("v", lambda x, b: -np.inf, JOINT, AT), "sensor_not_finite", 0, False),
    "q jumps by 0.2": (Fault("q", lambda x, b: x + 0.2, JOINT, AT), "sensor_jump", 0, False),
    "q jumps by 0.2 for one tick": (Fault("q", lambda x, b: x - 0.2, JOINT, AT, 1), "sensor_jump", 0, False),
    "q reads zero": (Fault("q", lambda x, b: x - 1.0, JOINT, AT), "sensor_jump", 0, False),
    "q stands still": (Fault("q", lambda x, b: b, JOINT, AT), "sensor_inconsistent", 30, True),
    "v stands still": (Fault("v", lambda x, b: 0.0 * x, JOINT, AT), "sensor_inconsistent", 30, True),
    "v has the wrong sign": (Fault("v", lambda x, b: -x, JOINT, AT), "sensor_inconsistent", 30, True),
    "v is too large": (Fault("v", lambda x, b: 3.0 * x, JOINT, AT), "sensor_inconsistent", 60, True),
}


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("kind", SENSORS)
def test_a_sensor_fails(kind: str, arm: str, bar: Any) -> None:
    fault, code, within, contrary = SENSORS[kind]
    of = setup(arm)
    robot = started(of, fault)
    robot.run(AT + within + 1)
    k = fault_tick(robot)
    assert AT <= k <= AT + within
    check_stop(robot, code, k, joint=of.arm.joint_names[JOINT], lost=[JOINT], contrary=contrary)
    in_table(bar, kind, code, k - AT)


@pytest.mark.parametrize("arm", ["planar2", "panda"])
def test_every_number_that_is_measured_fails(arm: str, bar: Any) -> None:
    """NaN and infinity in each entry of each measurement: a finite torque, and the sensor by name, in that tick."""
    of, count = feeling(arm, "force"), 0
    names = [(name, i) for name, shape in of.made.safe.measured.items() for i in range(int(np.prod(shape)))]
    robot = VirtualRobot(of)
    for name, i in names:
        for value in (np.nan, np.inf, -np.inf):
            robot.schedule[:] = [Fault(name, lambda x, b, value=value: value, i, 3, 3)]
            robot.status[STATUS["control"]], robot._began = 1, robot.ticks
            robot.run(6)
            fault = robot.acting.fault()
            assert fault is not None
            assert (fault.name, fault.tick) == ("sensor_not_finite", robot._began + 3)
            assert fault.message.startswith(name)
            assert fault.joint == (None if name == "F_ext" else of.arm.joint_names[i])
            robot.recover()
            robot.run(3)
            assert robot.acting.fault() is None
            count += 1
    assert np.isfinite(robot.sent).all()
    bar(f"NaN and infinity in each measurement of {arm}: not stopped and named in that tick", f"0 of {count}")


@pytest.mark.parametrize("arm", ["planar2", "gantry3"])
@pytest.mark.parametrize("kind", ["command", "memory"])
@pytest.mark.parametrize("value", ["NaN", "infinite"])
def test_a_law_breaks_down(value: str, kind: str, arm: str, bar: Any) -> None:
    of = broken(arm, kind == "memory")
    robot = VirtualRobot(of)
    numbers = dict(of.ctrl.parameters) | {"law.value": np.array(0.0 if value == "NaN" else 1.0)}
    robot.start(over=0.005, parameters=numbers)
    robot.run(AT + 1)
    k = fault_tick(robot)
    assert k == AT
    assert robot.row("safe.mode") == 0.0
    first = of.arm.joint_names[0] if kind == "command" else None
    check_stop(robot, "law_not_finite", AT, joint=first, again=False)
    in_table(bar, f"the {kind} of a law is {value}", "law_not_finite")


@cache
def broken(name: str, memory: bool) -> Setup:
    arm = taut.load_arm(name)
    return Setup(taut.compile(NanAfter(memory_breaks=memory), arm, rate=1000.0), stated(arm))


LIMITED: dict[str, tuple[str, dict[str, Any], str]] = {  # the arm, its limits, the code
    "faster than a joint's limit": ("panda", {"v": 0.5}, "speed"),
    "faster than a slide's limit": ("gantry3", {"v": (0.25, 1.0, 1.0)}, "speed"),
    "near an upper limit": ("ur10", {"upper": (0.1, *[6.2] * 5)}, "position"),
    "near a lower limit": ("planar2", {"lower": (0.5, 1.5)}, "position"),
    "the tool is too fast": ("planar2", {"tool_speed": 0.3}, "tool_speed"),
    "the tool leaves its box": ("planar2", {"box": ((-9.0, -9.0, -9.0), (9.0, 9.0, 9.0))}, "workspace"),
    "too much power": ("gantry3", {"power": 5.0}, "power"),
}


@pytest.mark.parametrize("kind", LIMITED)
def test_a_limit_is_met(kind: str, bar: Any) -> None:
    name, limits, code = LIMITED[kind]
    if code == "workspace":
        p = np.asarray(taut.snapshot(taut.load_arm(name), taut.load_arm(name).home).T().p)
        limits = {"box": (tuple(p - 0.02), tuple(p + 0.02))}
    of = setup(name, **limits)
    robot = VirtualRobot(of)
    robot.start(
        references=moving(setup(name), 0.6 if code == "speed" else -0.3 if "lower" in limits else 0.3), over=0.005
    )
    robot.run(390)
    k = fault_tick(robot)
    assert k > 0
    fault = robot.acting.fault()
    assert fault is not None
    check_stop(robot, code, k, joint=fault.joint, again=False)
    in_table(bar, kind, code)
    q = robot.rows("q")
    assert (q <= np.asarray(of.limits.upper) + 1e-3).all()  # it stands before its limit
    assert (q >= np.asarray(of.limits.lower) - 1e-3).all()


TURN = np.array([[np.cos(0.12), -np.sin(0.12), 0.0], [np.sin(0.12), np.cos(0.12), 0.0], [0.0, 0.0, 1.0]])
POSE: dict[str, Any] = {  # of a reference at rest, and how it jumps
    "a joint": lambda x: {"q": np.asarray(x.q) + 0.11 * np.eye(7)[3]},
    "the tool": lambda x: {"p": np.asarray(x.T().p) - 0.11 * np.eye(3)[1]},
    "the tool's axes": lambda x: {"R": np.asarray(x.T().R) @ TURN},
}


@pytest.mark.parametrize("kind", POSE)
def test_a_reference_jumps(kind: str, bar: Any) -> None:
    arm = taut.load_arm("panda")
    law = (
        taut.laws.ComputedTorque(kp=100.0, kd=20.0) if kind == "a joint" else taut.laws.Impedance(K=(500, 30), zeta=1)
    )
    of = Setup(taut.compile(law, arm, rate=1000.0), stated(arm))
    x = taut.snapshot(arm, arm.home)
    fields = {name: np.asarray(getattr(of.ctrl.side.at_rest(arm.home), name)) for name in of.made.fields}
    rows = [np.concatenate([np.ravel({**fields, **more}[name]) for name in fields]) for more in ({}, POSE[kind](x))]
    robot = VirtualRobot(of)
    robot.start(references=References(tables=[Table(rows=np.repeat(rows, [AT, 50], axis=0))]), over=0.005)
    robot.run(AT + 1)
    check_stop(robot, "reference_jump", AT, joint="panda_joint4" if kind == "a joint" else None, again=False)
    in_table(bar, f"the reference of {kind} jumps by 0.11", "reference_jump")


class Effort(taut.Law):
    """A constant torque."""

    torque: taut.Gain = taut.Gain(minimum=-np.inf)

    def command(self, x: Any, ref: Any) -> Any:
        return taut.Torque(all=self.torque.as_array())


def light_arm() -> taut.Arm:
    """Two light links whose motors have 50 and 25 N m."""
    arm = taut.load_arm("planar2").with_joints(effort=[50.0, 25.0], velocity=6.0)
    return arm.with_gears(ratio=[9.0, 40.0], motor_inertia=[1.95e-4, 2e-5])


@pytest.mark.parametrize("name", ["light", "planar2", "gantry3", "ur10", "panda", "panda within 1000 N m/s", "panda late",
                                  "light late", "ur10 late"])  # fmt: skip
def test_joints_at_their_full_effort_come_to_rest(name: str, share: Callable[[int], int], bar: Any) -> None:
    """Stopped where they pass their speed limits, with torques that must turn round."""
    arm, rng = light_arm() if "light" in name else taut.load_arm(name.partition(" ")[0]), np.random.default_rng(0)
    limits, most, rest = stated(arm), 0.0, 0.0
    most_torque = np.broadcast_to(np.asarray(limits.tau), arm.n)
    count = share(40)
    for _ in range(count):
        signs = rng.choice([-1.0, 1.0], arm.n) if rng.random() < 0.5 else np.eye(arm.n)[rng.integers(arm.n)]
        ctrl = taut.compile(Effort(torque=signs * most_torque), arm, rate=rng.choice([500.0, 1000.0]))
        delay = taut.drives.Actuation(delay=1.0 / ctrl.rate if "late" in name else 0.0)
        plant = taut.RigidPlant(arm, actuation=delay)
        robot = VirtualRobot(Setup(ctrl, limits, plant=plant, torque_rate=1000.0 if "within" in name else 0.0))
        robot.start(over=0.05)
        robot.run(round(2.0 * ctrl.rate))
        k, v = fault_tick(robot), np.abs(robot.rows("v")) / np.asarray(limits.v)
        assert k > 0
        assert v[-1].max() < 1e-3
        most = max(most, v[k:].max())
        rest = max(rest, (np.flatnonzero((v[k:] > 1e-2).any(axis=1))[-1] + 1) / ctrl.rate)
    assert most < (
        5.0 if name == "ur10 late" else 2.3 if name != "light" else 1.1
    )  # UR10's file has no rotor inertia
    assert rest < 1.0
    bar(f"{name} at full effort, stopped at its speed limits: peak over the limit [-], at rest after [s]",
        f"{most:.2f}, {rest:.2f}")  # fmt: skip


@cache
def feeling(name: str, what: str) -> Setup:
    """An arm that measures a force, or estimates torques, and is pushed at its tool."""
    arm = taut.load_arm(name)
    if what == "force":
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm, rate=1000.0)
        return Setup(ctrl, stated(arm, tool_force=15.0), measures=("F_ext", "v"))
    sensing = taut.Sensing(velocity="measured", observer=taut.sensors.MomentumObserver(bandwidth=50.0))
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm, rate=1000.0, sensing=sensing)
    push = taut.environments.Push(peak=[30.0, 20.0, 0.0], t=0.1, duration=0.05, shape="rectangular")
    return Setup(ctrl, stated(arm, contact=3.0), plant=taut.RigidPlant(arm, environment=push))


def test_a_force_at_the_tool_is_too_large(bar: Any) -> None:
    push = Fault("F_ext", lambda x, b: x + np.array([0.0, 16.0, 0.0, 0.0, 0.0, 0.0]), None, AT)
    robot = started(feeling("planar2", "force"), push)
    robot.run(AT + 1)
    check_stop(robot, "force", AT, joint=None)
    in_table(bar, "a force of 16 N at the tool, limit 15", "force")


@pytest.mark.parametrize("field", ["nan", "inf"])
def test_a_force_sensor_fails(field: str, bar: Any) -> None:
    robot = started(feeling("planar2", "force"), Fault("F_ext", lambda x, b: float(field), 4, AT))
    robot.run(AT + 1)
    check_stop(robot, "sensor_not_finite", AT, joint=None)
    in_table(bar, f"F_ext is {field}", "sensor_not_finite")


@pytest.mark.parametrize("arm", ["planar2", "panda"])
def test_a_contact_is_found_by_the_torques(arm: str, bar: Any) -> None:
    of = feeling(arm, "contact")
    robot = VirtualRobot(of)
    robot.start()
    robot.run(200)
    k = fault_tick(robot)
    assert 100 <= k <= 130
    fault = robot.acting.fault()
    assert fault is not None
    assert fault.value is not None
    assert 0.0 < fault.value < 3.0
    bar(f"a push of 36 N on {arm}, threshold 3 N m: controlled stop after [ms]", k - 100)
    check_stop(robot, "contact", k, joint=fault.joint, again=False)
    in_table(bar, "a push of 36 N, threshold 3 N m", "contact", k - 100)


def test_a_stream_stops(bar: Any) -> None:
    of = setup("planar2")
    robot = VirtualRobot(of)
    acting = robot.start(references=References(tables=[Table(rows=None, stream=True)]))
    acting.controls.time_out(0.02, 0.03)
    for k in range(AT):
        if k % 10 == 0:
            send(robot, of.arm.home + 1e-4 * k)
        robot.run(1)
    assert robot.acting.fault() is None
    robot.run(60)
    k = fault_tick(robot)
    assert k in (120, 121)  # sent before tick 90, which sees it with no age; older than 30 ms
    assert (robot.rows("reference.v")[112:120] == 0.0).all()  # held
    check_stop(robot, "stream_stopped", k, joint=None, again=False)
    in_table(bar, "a stream stops", "stream_stopped")


def send(robot: VirtualRobot, q: Any) -> None:
    """A sample of a stream, at the time of the virtual clock."""
    acting = robot.acting
    row = np.concatenate([q, np.zeros(2 * len(q))])[None]
    acting.controls.fill(0, row)
    acting.controls._entry(0)[TABLE["received"]] = robot.clock.ns + 10**6  # of the coming tick


def test_periods_are_missed(bar: Any) -> None:
    of = setup("planar2")
    robot = started(
        of, Fault("late", lambda *_: 20.5, tick=AT, ticks=1), Fault("late", lambda *_: 21.5, tick=AT + 50, ticks=1)
    )
    robot.run(AT + 100)
    # The clock is late after the read of tick AT, so that the tick behind it comes late.
    assert list(robot.rows("loop.lost")[[AT + 1, AT + 51]]) == [20.0, 21.0]
    assert fault_tick(robot) == AT + 51
    assert robot.acting.fault().name == "deadline"  # type: ignore[union-attr]
    in_table(bar, "21 periods are missed", "deadline")


def test_another_robot_stops(bar: Any) -> None:
    of, group = setup("planar2"), np.zeros(1, np.int64)
    one, two, three = (VirtualRobot(of, group=group) for _ in range(3))
    one.start(references=moving(of), over=0.005)
    two.start(references=moving(of), over=0.005)
    for _ in range(AT):
        assert [robot.run(1) for robot in (one, two, three)] == [0, 0, 0]
    one.schedule.append(Fault("q", lambda x, b: np.nan, 0, AT))
    for robot in (one, two, three):
        robot.run(1)
    assert one.acting.fault().name == "sensor_not_finite"  # type: ignore[union-attr]
    check_stop(two, "partner", AT, joint=None)
    in_table(bar, "another robot of the group stops", "partner")
    three.run(5)
    assert three.acting.fault() is None  # it is not controlled
    one.schedule.clear()
    one.run(5)
    one.recover()
    one.run(5)
    assert one.acting.fault() is None  # neither stops the other again
    assert two.acting.fault() is None


def test_the_watchdog_does_not_look(bar: Any) -> None:
    robot = started(setup("planar2"))
    robot.status[STATUS["armed"]], robot.status[STATUS["watched"]] = 1, robot.clock.ns + AT * 10**6 - 5 * 10**8
    robot.run(AT + 2)
    check_stop(robot, "unwatched", AT, joint=None, again=False)
    in_table(bar, "the watchdog does not look", "unwatched")


# Faults that nobody can name at once: what follows is bounded, or named when it is seen


@cache
def pressing() -> Setup:
    """A Panda that presses on a wall with a wrist sensor."""
    arm = taut.load_arm("panda")
    law = taut.laws.ForceControl(kfp=0.2, kfi=5.0, kdamp=(80.0, 5.0), e_int_max=(10.0, 1.0))
    at = np.asarray(taut.snapshot(arm, arm.home).T().p)
    wall = taut.environments.StiffWall(point=at, normal=[0.0, 0.0, 1.0], stiffness=1e4, damping=50.0)
    plant = taut.RigidPlant(arm, environment=wall)
    return Setup(
        taut.compile(law, arm, rate=1000.0),
        stated(arm, tool_speed=0.3, tool_force=60.0),
        plant=plant,
        measures=("F_ext", "v"),
    )


WRIST: dict[
    str, tuple[Callable[[Any, Any], Any], tuple[str, ...]]
] = {  # what the sensor reads, faults that may follow
    "biased by 5 N": (lambda x, b: x + np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0]), ("",)),
    "saturated at 12 N": (lambda x, b: np.clip(x, -12.0, 12.0), ("",)),
    "saturated at 5 N": (lambda x, b: np.clip(x, -5.0, 5.0), ("", "force", "tool_speed")),
    "unplugged": (lambda x, b: 0.0 * x, ("", "force", "tool_speed")),
    "stuck": (lambda x, b: b, ("", "force", "tool_speed")),
    "of the wrong sign": (lambda x, b: -x, ("", "force", "tool_speed")),
}


@pytest.mark.parametrize("kind", WRIST)
def test_a_wrong_force_is_bounded_or_named(kind: str) -> None:
    change, codes = WRIST[kind]
    of = pressing()
    robot = VirtualRobot(of, [Fault("F_ext", change, None, 400)])
    press = taut.TaskForce(F_app=[0.0, 0.0, -10.0, 0.0, 0.0, 0.0])
    robot.start(references=references_of(of.ctrl, taut.hold(press), of.arm.home, None))
    robot.run(400)
    assert abs(robot._true.views["F_ext"][2] - 10.0) < 2.0
    forces, twists = [], []
    for _ in range(120):
        robot.run(10)
        forces.append(abs(robot._true.views["F_ext"][2]))
        x = taut.snapshot(of.arm, robot._true.views["q"], robot._true.views["v"])
        twists.append(np.linalg.norm(np.asarray(x.twist())[:3]))
    fault = robot.acting.fault()
    assert (fault.name if fault else "") in codes
    assert max(forces) < 70.0
    assert max(twists) < 0.35


@pytest.mark.parametrize("arm", ["planar2", "ur10"])
def test_measurements_that_are_five_milliseconds_old_are_borne(arm: str) -> None:
    of, past = setup(arm), {"q": list[Any](), "v": list[Any]()}

    def old(name: str) -> Callable[[Any, Any], Any]:
        def change(x: Any, _: Any) -> Any:
            past[name].append(x.copy())
            return past[name][max(0, len(past[name]) - 6)]

        return change

    robot = started(of, *(Fault(name, old(name), None, 0) for name in ("q", "v")))
    robot.run(380)
    assert robot.acting.fault() is None
    e = robot.rows("reference.q") - robot.rows("q")
    assert np.abs(e).max() < 0.02


def test_a_load_that_is_dropped_is_borne_or_named() -> None:
    """A Panda that carries 2 kg and knows it loses them: a push of 20 N upwards for good."""
    for contact, names in ((None, {""}), (4.0, {"contact"})):
        arm = taut.load_arm("panda").with_payload(2.0, [0.0, 0.0, 0.0])
        lost = taut.environments.Push(peak=[0.0, 0.0, 19.6], t=0.1, duration=10.0, shape="rectangular")
        observer = None if contact is None else taut.sensors.MomentumObserver(bandwidth=50.0)
        sensing = taut.Sensing(velocity="measured", observer=observer)
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=225.0, kd=30.0), arm, rate=1000.0, sensing=sensing)
        limits = stated(arm) if contact is None else stated(arm, contact=contact)
        robot = VirtualRobot(Setup(ctrl, limits, plant=taut.RigidPlant(arm, environment=lost)))
        robot.start()
        robot.run(700)
        fault = robot.acting.fault()
        assert (fault.name if fault else "") in names
        assert np.abs(robot.rows("q") - arm.home).max() < 0.25


@pytest.mark.parametrize("arm", [*ARMS, "panda with an observer"])
def test_a_healthy_robot_raises_no_alarm(arm: str, share: Callable[[int], int], bar: Any) -> None:
    """Motions up to nine tenths of the limits, with noisy sensors."""
    of, rng = observed() if " " in arm else setup(arm), np.random.default_rng(4)
    n, limits = of.arm.n, of.limits
    noise = [
        Fault("q", lambda x, b: x + 2e-5 * rng.standard_normal(n), None, 0),
        Fault("v", lambda x, b: x + 3e-3 * rng.standard_normal(n), None, 0),
    ]
    count = share(20)
    for _ in range(count):
        robot = VirtualRobot(of, noise)
        low, high = np.asarray(limits.lower) + 0.2, np.asarray(limits.upper) - 0.2
        room = np.minimum(0.8, 0.5 * np.maximum(high - low, 0.1))
        goal = np.clip(of.arm.home + rng.uniform(-room, room), low, high)
        v = 0.9 * np.broadcast_to(limits.v, n)
        path = taut.trajectories.Trapezoidal(q0=of.arm.home, q1=goal, velocity=v, acceleration=2.0 * v)
        robot.start(references=references_of(of.ctrl, path, of.arm.home, None), over=0.05)
        robot.run(round(1000 * float(path.duration)) + 100)
        assert robot.acting.fault() is None
        assert np.abs(robot.row("q") - goal).max() < 0.03
    bar(f"motions of a healthy {arm} at nine tenths of its limits, noisy: false alarms", f"0 of {count}")


@cache
def observed() -> Setup:
    """A Panda whose contact threshold is 3 N m, and nothing touches it."""
    of = copy.copy(feeling("panda", "contact"))
    of.plant, of.started = taut.RigidPlant(of.arm), {}
    return of


def test_every_code_has_words_a_remedy_and_a_place_in_the_page() -> None:
    page = (REPOSITORY / "docs" / "safety.md").read_text(encoding="utf-8")
    for code, kind in FAULTS.items():
        assert f"| {code} | `{kind.name}` |" in page, kind.name
        fault = fault_of(code, 3, who="joint 'elbow'", value=1.5)
        assert str(fault).startswith(f"{kind.name} ({code}) in tick 3: ")
        assert "{" not in fault.message
