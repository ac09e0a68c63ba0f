"""The native loop: its time, samples, parameters, blends and limits; on a virtual clock, or tick by tick."""

from __future__ import annotations

import ctypes
import gc
import itertools
import sys
import threading
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from test_fault_table import moving, setup, started, stated
from virtual_robot import Fault, FlatOut, Setup, VirtualRobot

import taut
from taut.codegen import native
from taut.codegen.servo_loop import CONTROLS, FUNCTIONS, SET, STATUS, TABLE
from taut.runtime.realtime.feeding import References, time_outs
from taut.runtime.realtime.process import LEAD
from taut.runtime.realtime.sets import Table
from taut.trace import math as tm

ROUNDING = 1e-9
LAWS: dict[str, taut.Law] = {
    "velocity": taut.laws.VelocityPI(kp=5.0),
    "position": taut.laws.JointPosition(),
    "mit": taut.laws.ViaMit(law=taut.laws.ComputedTorque(kp=100.0, kd=20.0), kp_motor=20.0, kd_motor=1.0),
}
TIMES = {"signal.age", "loop.time", "loop.late", "loop.compute", "loop.driver"}  # columns
STREAM = References(tables=[Table(rows=None, stream=True)])


class TorqueOf(taut.Law):
    """The torque that stands in the reference's acceleration."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(wanted=ref.a)


class Torn(taut.Law):
    """Remembers the largest difference within a sample, or within the parameters, all of which should be equal."""

    a: taut.Gain = taut.Gain(0.0)
    b: taut.Gain = taut.Gain(0.0)
    c: taut.Gain = taut.Gain(0.0)
    worst: taut.Memory = taut.Memory(0.0)
    changes: taut.Memory = taut.Memory(0.0)
    last: taut.Memory = taut.Memory(0.0)

    def command(self, x: Any, ref: Any, memory: Any, dt: Any) -> Any:
        a, b, c = (gain.as_array() for gain in (self.a, self.b, self.c))
        numbers = [*ref.q, *ref.v, *ref.a]
        apart = [tm.abs(one - numbers[0]) for one in numbers] + [tm.abs(a - b), tm.abs(b - c)]
        worst = memory.worst
        for one in apart:
            worst = tm.maximum(worst, one)
        changed = tm.where((ref.q[0] < memory.last) | (ref.q[0] > memory.last), 1.0, 0.0)
        after = {"worst": worst, "changes": memory.changes + changed, "last": ref.q[0]}
        return taut.Torque(g=x.g), after


class Ticks:
    """The compiled tick alone, on blocks that a test writes."""

    def __init__(self, of: Setup) -> None:
        made = of.made
        self.code = native.link(made.code, FUNCTIONS)
        self.inputs, self.memory, self.outputs = made.inputs.zeros(), made.memory.zeros(), made.outputs.zeros()
        self.parameters, self.new, self.scratch = (
            made.packed(of.ctrl.parameters),
            self.memory.copy(),
            self.memory.copy(),
        )
        self.i, self.m = made.inputs.views(self.inputs), made.memory.views(self.memory)
        self.o, self.p = made.outputs.views(self.outputs), made.parameters.views(self.parameters)
        call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 5)
        places = [x.ctypes.data for x in (self.inputs, self.parameters, self.memory, self.new)]
        kernel, start = (call(self.code[name]) for name in FUNCTIONS)
        self._tick = lambda: kernel(*places, self.outputs.ctypes.data)
        self._start = lambda: start(*places, self.scratch.ctypes.data)
        for name in ("control", "over", "hold_after", "stop_after"):
            self.i[f"signal.{name}"][...] = 1.0
        self.m["safe.started"][...] = self.m["safe.phase"][...] = 1.0

    def tick(self) -> None:
        self._tick()
        self.memory[:] = self.new

    def start(self) -> None:
        self._start()
        self.memory[:] = self.scratch


# Time


def lead_at(rate: float) -> int:
    """[ns] before its deadlines at which a loop's process lets it wake."""
    return round(1e9 * min(LEAD[0], LEAD[1] / rate))


@pytest.mark.parametrize("early", [False, True])
@pytest.mark.parametrize("rate", [1000.0, 125.0])
def test_every_missed_period_is_counted_and_the_grid_is_kept(rate: float, early: bool) -> None:
    arm = taut.load_arm("planar2")
    of = Setup(
        taut.compile(taut.laws.ComputedTorque(kp=4.0, kd=4.0), arm, rate=rate), stated(arm, v=None, missed=1e6)
    )
    rng = np.random.default_rng(0)
    late = {20: 1.5, 40: 3.0, 60: 20.0, 80: 100.0} | {
        100 + 2 * k: float(x) for k, x in enumerate(rng.integers(0, 90, 200) / 10)
    }
    schedule = [Fault("late", lambda *_, x=x: x, tick=k, ticks=1) for k, x in late.items()]
    robot = VirtualRobot(of, schedule, lead=lead_at(rate) if early else 0)
    robot.start()
    robot.run(600)
    lost = robot.rows("loop.lost")
    expected = np.zeros(600)
    for k, x in late.items():
        expected[k + 1] = np.floor(round(x * 1e9 / rate) / round(1e9 / rate))
    np.testing.assert_array_equal(lost, expected)
    assert robot.status[STATUS["lost"]] == expected.sum()
    wakes = np.diff(robot.clock.wakes)
    assert not (wakes % round(1e9 / rate)).any()  # the grid
    assert (wakes > 0).all()  # no burst
    assert {*robot.clock.clocks} == {1}  # CLOCK_MONOTONIC, which no clock step moves
    np.testing.assert_allclose(robot.rows("loop.late")[21], 1.5 / rate, rtol=0.02 if early else 1e-6)
    on_time = robot.rows("loop.late")[:20]
    assert (on_time >= 0.0).all()
    assert (on_time <= 1e-9 * robot.clock.step).all()
    assert robot.acting.fault() is None


def test_of_a_robot_that_keeps_the_time_gaps_between_states_are_counted() -> None:
    of = setup("planar2", v=None, missed=1e6)
    gaps = {10: 1.0, 20: 1.4, 30: 2.0, 40: 3.6, 50: 101.0}  # [periods]

    class Paced(VirtualRobot):
        def _read(self, a: int, b: int) -> int:
            self.clock.ns += round(1e6 * gaps.get(self.k, 1.0))
            return super()._read(a, b)

    robot = Paced(of, host_paced=False)
    robot.start()
    robot.run(100)
    assert not robot.clock.wakes
    lost = robot.rows("loop.lost")
    assert {int(k): int(lost[k]) for k in np.flatnonzero(lost)} == {30: 1, 40: 3, 50: 100}


@pytest.mark.parametrize("early", [False, True])
def test_computing_that_takes_longer_than_a_period_is_an_overrun(early: bool) -> None:
    robot = started(setup("planar2"), lead=lead_at(1000.0) if early else 0)
    clock, times = robot.clock, iter([0] * 30 + [2_500_000] + [0] * 30)

    def slow(_: int, at: int) -> int:
        clock.ns += next(times) if robot.status[STATUS["where"]] == 2 else clock.step  # where the tick ends
        words = (ctypes.c_int64 * 2).from_address(at)
        words[0], words[1] = divmod(clock.ns, 10**9)
        return 0

    clock.get = slow
    robot.run(50)
    assert robot.status[STATUS["overruns"]] == 1
    assert robot.rows("loop.compute").max() == pytest.approx(2.5e-3)
    assert robot.rows("loop.lost").sum() == 1


class Counted:
    """The kernel of a law that was installed, in whose warm-ups all that it writes is NaN."""

    def __init__(self, robot: VirtualRobot) -> None:
        loaded, self.ticks, self.warm_ups = robot._sets[-1][1], 0, 0
        call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 5)
        kernel = call(loaded.code["kernel"])

        def counted(*blocks: int) -> None:
            kernel(*blocks)
            warms = robot.status[STATUS["where"]] == 0
            if warms:
                loaded.blocks["new"][:] = loaded.blocks["outputs"][:] = np.nan
            self.warm_ups += warms
            self.ticks += not warms

        self._kept = call(counted)
        loaded.words[SET["kernel"]] = ctypes.cast(self._kept, ctypes.c_void_p).value


@pytest.mark.parametrize("rate", [100.0, 1000.0, 20_000.0])
def test_a_warm_up_changes_nothing(rate: float) -> None:
    """Through a stream, changes of gains, another law, a fault and its recovery: rows and commands bit for bit."""
    arm = taut.load_arm("planar2")
    laws = [taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=10.0), taut.laws.GravityPID(kp=50.0, kd=8.0)]
    setups = [Setup(taut.compile(law, arm, rate=rate), stated(arm, v=None)) for law in laws]
    kept = []
    for lead in (0, lead_at(rate)):
        robot = VirtualRobot(setups[0], lead=lead)
        rows = []
        for of in setups:
            acting = robot.start(of, STREAM, over=0.01)
            acting.controls.time_out(1e9, 1e9)
            counted = Counted(robot)
            for k in range(5):
                acting.controls.fill(0, np.resize(arm.home + 0.01 * k, (4, 6)))
                acting.controls.set({"law.kp": np.array(90.0 + k)}, 0.001)
                robot.run(7)
            robot.schedule[:] = [Fault("q", lambda x, b: np.nan, 1, robot.k + 2, 3)]
            robot.run(10)
            assert acting.fault() is not None
            robot.recover()
            robot.run(10)
            assert acting.fault() is None
            assert counted.ticks == 55
            assert counted.warm_ups == (54 if lead else 0)  # it is installed behind the first one's
            columns = sorted(acting.made.columns().keys() - TIMES)
            rows += [(path, robot.rows(path).tobytes()) for path in columns]
        kept.append([*rows, ("sent", np.array(robot.sent).tobytes())])
    assert kept[0] == kept[1]


def test_a_tick_that_woke_late_is_not_delayed_by_a_warm_up() -> None:
    robot = started(setup("planar2", missed=1e6), lead=lead_at(1000.0))
    robot.run(1)
    counted = Counted(robot)
    late = {2: -0.02, 4: 0.5, 6: 2.5}  # [periods] behind its deadline: within the time of a tick of it
    robot.schedule[:] = [Fault("late", lambda *_, x=x: x, tick=robot.k + k, ticks=1) for k, x in late.items()]
    robot.run(10)
    assert (counted.ticks, counted.warm_ups) == (10, 7)


# Samples and parameters


def test_a_sample_that_is_being_written_is_not_taken() -> None:
    of = setup("planar2")
    robot = VirtualRobot(of)
    acting = robot.start(references=STREAM)
    acting.controls.time_out(1e9, 1e9)
    acting.controls.fill(0, np.full((1, 6), 0.2))  # before the law begins: void
    robot.run(1)
    acting.controls.fill(0, np.full((1, 6), 0.3))
    robot.run(2)
    entry = acting.controls._entry(0)
    entry[TABLE["lock"]] += 1  # the parent was stopped in the middle of it
    entry[TABLE["first"]] += 1
    entry[TABLE["version"]] += 1
    robot.run(3)
    assert (robot.rows("ref.q")[1:] == 0.3).all()
    entry[TABLE["first"]] -= 1
    entry[TABLE["lock"]] += 1
    acting.controls.fill(0, np.full((1, 6), 0.4))
    robot.run(1)
    assert (robot.row("ref.q") == 0.4).all()
    acting.controls.words[CONTROLS["parameters"]] += 1
    acting.controls.views["law.kp"][...] = 7.0
    robot.run(3)
    assert robot.row("parameters.law.kp") == 100.0
    acting.controls.words[CONTROLS["parameters"]] += 1
    robot.run(1)
    assert robot.row("parameters.law.kp") == 7.0


def torn_reads(ticks: int) -> tuple[float, float, float]:
    """Largest difference within samples and parameters, samples seen, ticks: while two threads write each."""
    arm = taut.load_arm("one_joint")
    of = Setup(
        taut.compile(Torn(), arm, rate=1000.0), taut.SafetyLimits(deceleration=5.0), measures=("tau_meas", "v")
    )
    loop = FlatOut(of, STREAM)
    controls, done = loop.acting.controls, threading.Event()
    controls.time_out(1e9, 1e9)

    def samples() -> None:
        for k in itertools.count(1):
            controls.fill(0, np.full((1, 3), float(k)))
            if done.is_set():
                return

    def gains() -> None:
        for k in itertools.count(1):
            controls.set(dict.fromkeys(("law.a", "law.b", "law.c"), np.array(float(k))), 0.001)
            if done.is_set():
                return

    writers = [threading.Thread(target=write) for write in (samples, samples, gains, gains)]
    for thread in writers:
        thread.start()
    try:
        loop.run(ticks)
    finally:
        done.set()
        for thread in writers:
            thread.join()
    memory = loop.memory
    return float(memory["law.worst"]), float(memory["law.changes"]), float(loop.status[STATUS["ticks"]])


def test_no_read_is_torn(share: Callable[[int], int], bar: Any) -> None:
    worst, seen, ticks = torn_reads(share(10_000_000) // (1 if share(10) == 10 else 5))
    assert worst == 0.0
    assert seen > (100 if share(10) == 10 else 3)
    bar("samples and parameters that four threads write meanwhile: torn, of the loop's reads", f"0 of {int(ticks)}")


# Blends and limits


@cache
def torque_of(name: str, **limits: Any) -> Setup:
    arm = taut.load_arm(name)
    return Setup(taut.compile(TorqueOf(), arm, rate=1000.0), stated(arm, **limits))


@pytest.mark.parametrize("arm", ["panda", "gantry3"])
def test_every_limit_holds_for_any_command_and_state(arm: str, share: Callable[[int], int], bar: Any) -> None:
    of, rng = torque_of(arm, tool_speed=2.0), np.random.default_rng(1)
    ticks, n, limits = Ticks(of), of.arm.n, of.limits
    tau, step = np.asarray(limits.tau), np.asarray(limits.tau_dot) / of.rate
    count = share(500_000) // (1 if share(10) == 10 else 5)
    broken = 0
    i, m = ticks.i, ticks.m
    i["signal.valid"][...] = 1.0
    for block in range(count // 1000):
        wild = 10.0 ** rng.uniform(-3.0, 9.0, (1000, 1))
        q, v, a = (rng.standard_normal((1000, n)) * x for x in (2.0, 3.0, wild))
        before = rng.uniform(-1.5, 1.5, (1000, n)) * tau  # of ten thousand, a third is beyond the limit
        mode, codes = rng.integers(0, 2, 1000), np.where(rng.random(1000) < 0.3, 31, 0)
        if block % 3 == 0:
            q[rng.integers(0, 1000, 50)] = np.nan
            a[rng.integers(0, 1000, 50)] = np.inf
            v[rng.integers(0, 1000, 50)] = -np.inf
        out, acts = np.zeros((1000, n)), np.zeros((1000, 1))
        for k in range(1000):
            i["q"][:], i["v"][:], i["ref.a"][:], m["safe.tau"][:] = q[k], v[k], a[k], before[k]
            m["safe.mode"][...], m["safe.fault"][...] = mode[k], codes[k]
            m["safe.q"][:], m["safe.v"][:], m["safe.blind"][:] = 1.0, 0.0, 0.0
            ticks._tick()
            out[k], acts[k] = ticks.o["command"], ticks.o["safe.mode"]
        of_tick = np.where(acts > 0.5, step, np.inf)  # a stop has no rate of its own
        low, high = np.maximum(before - of_tick, -tau), np.minimum(before + of_tick, tau)
        low, high = np.minimum(low, tau), np.maximum(high, -tau)  # beyond the magnitude: that wins over the rate
        slack = ROUNDING * tau
        broken += int((~((low - slack <= out) & (out <= high + slack))).sum())
    assert broken == 0
    bar(
        f"random commands and states of {arm} under safety limits, a third of them violated: broken",
        f"0 of {count * n}",
    )


@pytest.mark.parametrize("arm", ["ur10", "gantry3", "one_joint"])
def test_start_switch_and_changes_begin_at_the_torque_that_is_sent(
    arm: str, share: Callable[[int], int], bar: Any
) -> None:
    of, rng = setup(arm, tau=1e9, tau_dot=1e9, v=1e3, lower=-1e3, upper=1e3), np.random.default_rng(2)
    ticks, n = Ticks(of), of.arm.n
    worst, i, m = {"start": 0.0, "gains": 0.0, "payload": 0.0}, ticks.i, ticks.m
    i["signal.over"][...], i["signal.valid"][...] = 0.2, 1.0
    for _ in range(share(3000)):
        q, v, sent = rng.standard_normal(n), rng.standard_normal(n), 50.0 * rng.standard_normal(n)
        i["q"][:], i["v"][:], m["safe.q"][:], m["safe.v"][:], m["safe.tau"][:] = q, v, q, v, sent
        i["ref.q"][:], i["ref.v"][:] = q + rng.uniform(-0.09, 0.09, n), rng.standard_normal(n)
        m["safe.mode"][...] = m["safe.fault"][...] = m["safe.blind"][...] = 0.0
        i["signal.begin"][...] = 1.0
        ticks.start()
        ticks.tick()
        worst["start"] = max(worst["start"], np.abs(ticks.o["command"] - sent).max())
        i["signal.begin"][...] = 0.0
        ticks.tick()
        for name, path, value in (
            ("gains", "law.kp", rng.uniform(0.0, 900.0)),
            ("payload", "model.payload.mass", rng.uniform(0.0, 5.0)),
        ):
            before = ticks.o["command"].copy()
            ticks.p[path][...], i["signal.changed"][...] = value, 1.0
            ticks.tick()
            worst[name] = max(worst[name], np.abs(ticks.o["command"] - before).max())
            i["signal.changed"][...] = 0.0
            ticks.tick()
    scale = 1e3  # [N m | N] of the commands
    assert worst["start"] < ROUNDING * scale
    assert worst["gains"] < 1e-3 * 1e3 * scale * 1e-3, worst
    bar(f"first torque of a law on {arm} against the last one that was sent [N m]", f"{worst['start']:.1e}")


@pytest.mark.parametrize("takes", ["velocity", "position", "mit"])
@pytest.mark.parametrize("fault", ["speed", "sensor_not_finite", "hold"])
def test_commands_of_every_kind_stop_without_a_jump(takes: str, fault: str) -> None:
    arm, law = taut.load_arm("planar2"), LAWS[takes]
    actuation = None if takes == "mit" else taut.drives.Actuation(bandwidth=50.0)
    plant = taut.RigidPlant(arm, takes=takes, **({} if actuation is None else {"actuation": actuation}))  # type: ignore[arg-type]
    of = Setup(taut.compile(law, arm, rate=1000.0), stated(arm, v=1.0, deceleration=5.0), plant=plant)
    robot = VirtualRobot(of)
    robot.start(references=moving(of, 0.5), over=0.01)
    robot.run(150)
    if fault == "speed":
        robot.schedule.append(Fault("v", lambda x, b: x + 0.65, 0, robot.k, 1))
    if fault == "sensor_not_finite":
        robot.schedule.append(Fault("q", lambda x, b: np.nan, 1, robot.k))
    if fault == "hold":
        robot.status[STATUS["hold"]] = 1
    robot.run(600)
    sent, kind = np.array(robot.sent), robot.acting.fault()
    assert (kind is None) == (fault == "hold")
    assert kind is None or (kind.name, kind.joint) == (fault, arm.joint_names[1 if fault != "speed" else 0])
    assert np.isfinite(sent).all()
    assert robot.row("safe.mode") == 0.0
    coasts = takes == "mit" and fault == "sensor_not_finite"  # a joint without feedback, and without friction
    assert np.abs(robot._true.views["v"]).max() < (0.3 if coasts else 0.01)
    if takes == "velocity":
        assert np.abs(np.diff(sent, axis=0)).max() <= 2.0 * 5.0 * 1e-3 + ROUNDING
    if takes == "position":
        assert np.abs(np.diff(sent, axis=0)).max() <= 1.0 * 1e-3 + ROUNDING
        k = int(np.argmax(robot.rows("safe.mode") < 0.5))
        assert np.abs(np.diff(sent, 2, axis=0))[k + 1 :].max() <= 5.0 * 1e-6 + ROUNDING  # the deceleration
    if takes == "mit":
        assert not sent[-1][2:4].any()  # no stiffness in the motors that positions could be wrong for


def test_a_stream_is_held_after_two_periods_and_stopped_after_three() -> None:
    for period, hold, stop in ((0.001, 0.002, 0.05), (0.02, 0.04, 0.06), (0.021, 0.042, 0.063), (0.1, 0.2, 0.3)):
        assert time_outs(period) == pytest.approx((hold, stop))


def test_a_trajectory_and_a_hold_never_grow_stale() -> None:
    loop = FlatOut(taut_setup())
    loop.run(20_000)
    assert loop.status[STATUS["latched"]] == 0
    assert loop.status[STATUS["ticks"]] >= 20_000


@cache
def taut_setup() -> Setup:
    arm = taut.load_arm("planar2")
    return Setup(
        taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm), stated(arm), measures=("tau_meas", "v")
    )


# What stays


def test_nothing_stays_of_a_fault_after_recovery(share: Callable[[int], int], bar: Any) -> None:
    of = setup("planar2")
    robot, clean, rng = VirtualRobot(of, q0=[0.4, 0.9]), VirtualRobot(of, q0=[0.4, 0.9]), np.random.default_rng(3)
    kinds = (
        ("q", np.nan), ("q", np.inf), ("v", np.nan), ("v", 50.0), ("q", 0.5), ("v", -np.inf),
    )  # fmt: skip
    views = [of.made.memory.views(one._sets[0][1].blocks["memory"]) for one in (clean, robot)]
    last = (
        "safe.index",
        "safe.value",
        "safe.phase",
        "safe.q_stop",
        "safe.q",
    )  # of the last fault; of a blend that is over; times
    count = share(1000)
    for k in range(count):
        what, value = kinds[k % len(kinds)]
        joint = int(rng.integers(2))
        now = robot.ticks - robot._began
        robot.schedule[:] = [
            Fault(what, lambda x, b, value=value: x + value, joint, now + 2, int(rng.integers(1, 4)))
        ]
        robot.run(8)
        assert robot.acting.fault() is not None, (what, value)
        robot.recover()
        robot.run(3)
        assert robot.acting.fault() is None
        clean.run(1)
        for path in views[0]:
            if path not in last and not path.startswith("law"):
                np.testing.assert_array_equal(views[0][path], views[1][path], err_msg=path)
    bar("recoveries from faults of six kinds: memory that differs from that of an untouched loop", f"0 of {count}")


def test_armed_ticks_allocate_nothing(share: Callable[[int], int], bar: Any) -> None:
    """Of a driver in Python, whose read and write do not: neither does the loop."""
    of = taut_setup()
    loop = FlatOut(of)
    loop.run(1000)
    gc.collect()
    before, collections = sys.getallocatedblocks(), sum(one["collections"] for one in gc.get_stats())
    ticks = int(loop.status[STATUS["ticks"]])
    loop.run(share(1_000_000) // (1 if share(10) == 10 else 2))
    after = sys.getallocatedblocks()
    assert abs(after - before) < 200  # of the thread that ends it
    assert sum(one["collections"] for one in gc.get_stats()) == collections
    bar(
        "armed ticks of the native loop: collections, objects more",
        f"0, 0 in {int(loop.status[STATUS['ticks']]) - ticks}",
    )
