"""A robot's native loop in this process, on a virtual clock, with a model plant that a schedule of faults falsifies."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import taut
from taut.codegen.program import Block
from taut.codegen.servo_loop import LOOP, STATUS, STATUS_WORDS, servo_code, servo_module, struct_of
from taut.control.safety import SafeSide
from taut.maths.snapshot import snapshot
from taut.runtime.realtime.acting import Acting
from taut.runtime.realtime.feeding import References
from taut.runtime.realtime.process import Calls, LoadedSet, PlantDriver
from taut.runtime.realtime.robot import HOLD
from taut.runtime.realtime.sets import ServoSet, compiled_plant
from taut.runtime.robots.driver import RobotDriver, RobotInfo

CLOCK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.c_void_p)
SLEEP = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
NUMBER = ctypes.CFUNCTYPE(ctypes.c_int)
KILL = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.c_int)
READ = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)


class Float64Block:
    """Named arrays in one flat one."""

    def __init__(self, shapes: Any) -> None:
        block = Block.of(shapes)
        self.flat = block.zeros()
        self.views = block.views(self.flat)


@dataclass(frozen=True)
class Fault:
    """One line of a schedule: what is falsified, from which tick after the start on, and for how many."""

    what: str  # a measurement; "late" [periods]
    change: Callable[[Any, Any], Any]  # of the measurement, and what it was before the fault
    joint: int | None = None  # all where left out
    tick: int = 50
    ticks: int = 10**9


class VirtualClock:
    """Time that moves only where something takes it."""

    def __init__(self) -> None:
        self.ns = 10**12
        self.wakes = list[int]()  # [ns] of each deadline
        self.late = 0  # [ns] of the next wake
        self.step = 0  # [ns] that each look at it takes
        self.clocks = list[int]()  # that were asked
        self.get = self._get
        self._kept = (
            CLOCK(lambda clock, at: self.get(clock, at)),
            SLEEP(self._sleep),
            NUMBER(lambda: 7),
            KILL(lambda *_: 0),
        )
        names = ("clock_gettime", "clock_nanosleep", "getppid", "kill")
        self.symbols = {
            name: int(ctypes.cast(one, ctypes.c_void_p).value or 0)
            for name, one in zip(names, self._kept, strict=True)
        }

    def _get(self, clock: int, at: int) -> int:
        self.clocks.append(clock)
        self.ns += self.step
        words = (ctypes.c_int64 * 2).from_address(at)
        words[0], words[1] = divmod(self.ns, 10**9)
        return 0

    def _sleep(self, _: int, __: int, at: int, ___: int) -> int:
        words = (ctypes.c_int64 * 2).from_address(at)
        until = words[0] * 10**9 + words[1]
        self.wakes.append(until)
        self.ns = max(self.ns, until) + self.late
        self.late = 0
        return 0


@dataclass
class Setup:
    """An arm under a law and safety limits, compiled once for many runs."""

    ctrl: taut.Controller
    limits: taut.SafetyLimits
    measures: tuple[str, ...] = ("v",)
    plant: Any = None
    adds: tuple[str, ...] = ()
    torque_rate: float = 0.0
    made: ServoSet = field(init=False)

    def __post_init__(self) -> None:
        self.arm, self.rate = self.ctrl.arm, self.ctrl.rate
        self.plant = taut.RigidPlant(self.arm) if self.plant is None else self.plant
        safe = SafeSide(side=self.ctrl.side, limits=self.limits, measures=self.measures, torque_rate=self.torque_rate)
        safe.check()
        self.made = ServoSet(safe)
        self.started: dict[bytes, Any] = {}

    def plant_set(self, q: Any, v: Any) -> Any:
        key = np.concatenate([q, v]).tobytes()
        if key not in self.started:
            self.started[key] = compiled_plant(self.plant, q, v, self.rate)
        return self.started[key]


class VirtualRobot:
    """The loop of one robot: `start`, then `run` so many ticks."""

    def __init__(
        self,
        setup: Setup,
        schedule: Sequence[Fault] = (),
        *,
        q0: Any = None,
        v0: Any = None,
        driver: RobotDriver | None = None,
        host_paced: bool = True,
        group: Any = None,
        lead: int = 0,  # [ns]; the clock then goes on while the loop looks at it
    ) -> None:
        self.setup, self.schedule, self.clock = setup, list(schedule), VirtualClock()
        self.clock.step, self.lead = lead // 10, lead
        n = setup.arm.n
        self.status, self.group = (
            np.zeros(STATUS_WORDS, dtype=np.int64),
            np.zeros(1, np.int64) if group is None else group,
        )
        self.code = servo_module(self.clock.symbols)
        self.measured = Float64Block(setup.made.safe.measured)
        self._command = np.zeros((5, n) if setup.ctrl.side.probe.mit else n)
        made = None
        if driver is None:
            made = setup.plant_set(
                np.array(setup.arm.home if q0 is None else q0, float), np.zeros(n) if v0 is None else v0
            )
            info = RobotInfo(name="plant", n=n, rate=setup.rate, takes=setup.plant.takes, measures=setup.measures)
            driver = PlantDriver(made, info)
        self._true = Float64Block(made["measured"] if made is not None else setup.made.safe.measured)
        self.calls = Calls(driver, self._true.views, self._command)
        self.driver = driver
        calls = (self.code["plant_read"], self.code["plant_write"]) if made else (self.calls.read, self.calls.write)
        self._plant = [READ(call) for call in calls]
        self._kept = READ(self._read), READ(self._write)
        read, write = (int(ctypes.cast(one, ctypes.c_void_p).value or 0) for one in self._kept)
        self.words = struct_of(LOOP, {
            "status": self.status.ctypes.data, "read": read, "write": write, "user": 0,
            "measured": self.measured.flat.ctypes.data, "period": round(1e9 / setup.rate),
            "host_paced": int(host_paced), "group": self.group.ctypes.data, "lead": lead,
        })  # fmt: skip
        self._loop = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(self.code["loop"])
        self._end, self._began, self._sets = 0, 10**12, list[Any]()
        self.acting: Acting
        self.sent = list[Any]()  # commands that went out
        self.before: dict[str, Any] = {}
        self.install(begins=False)
        self.run(3)  # idle

    @property
    def ticks(self) -> int:
        return int(self.status[STATUS["ticks"]])

    def install(
        self, setup: Setup | None = None, references: References = HOLD, *, begins: bool = True, over: float = 0.2,
        sends: bool = True, parameters: Any = None,
    ) -> Acting:  # fmt: skip
        """Give the loop another law."""
        setup = self.setup if setup is None else setup
        values = setup.ctrl.parameters if parameters is None else parameters
        acting = Acting(setup.made, references, values, number=len(self._sets) + 1, sends=sends, over=over)
        loaded = LoadedSet(setup.made.message(acting, begins=begins))
        self._sets.append((acting, loaded))
        word = "set" if self.words[LOOP["set"]] == 0 else "next"
        self.words[LOOP[word]] = loaded.address
        self.acting = acting
        return acting

    def start(self, setup: Setup | None = None, references: References = HOLD, **more: Any) -> Acting:
        """Take control with a law."""
        acting = self.install(setup, references, **more)
        self.status[STATUS["control"]], self.status[STATUS["hold"]] = 1, 0
        self._began = self.ticks
        return acting

    def run(self, ticks: int) -> int:
        """So many ticks, or less where a read or write fails: what the loop returns."""
        self._end = self.ticks + ticks
        self.status[STATUS["quit"]] = 0
        if self.words[LOOP["deadline"]] == 0:
            self.words[LOOP["deadline"]] = self.words[LOOP["last"]] = self.clock.ns
        return int(self._loop(self.words.ctypes.data))

    def recover(self) -> None:
        """What the loop's process does between two ticks."""
        self.status[STATUS["control"]] = 0
        self.status[STATUS["recover"]] += 1
        self.words[LOOP["known"]] = self.group[0]

    def row(self, path: str, tick: int = -1) -> Any:
        """A number of a tick of the law that acts."""
        return self.acting.column(self.acting.rows(), path)[tick]

    def rows(self, path: str) -> Any:
        return self.acting.column(self.acting.rows(), path)

    @property
    def k(self) -> int:
        """Ticks since the start."""
        return self.ticks - self._began

    def _read(self, _: int, __: int) -> int:
        failed = self._plant[0](self.calls.user, self._true.flat.ctypes.data)
        self.measured.flat[:] = 0.0
        for name, view in self._true.views.items():
            if name in self.measured.views:
                self.measured.views[name][...] = view
        for one in self.schedule:
            inside = one.tick <= self.k < one.tick + one.ticks
            if one.what == "late":
                late = self.lead + round(one.change(0, 0) * 1e9 / self.setup.rate)
                self.clock.late = late if inside else self.clock.late
                continue
            view = self.measured.views[one.what]
            if self.k == one.tick - 1:
                self.before[one.what] = view.copy()
            if inside:
                place = slice(None) if one.joint is None else one.joint
                view[place] = one.change(view[place], self.before.get(one.what, view)[place])
        if self.ticks + 1 >= self._end:
            self.status[STATUS["quit"]] = 1
        return int(failed)

    def _write(self, _: int, command: int) -> int:
        size = self._command.size
        self.sent.append(np.array((ctypes.c_double * size).from_address(command)).reshape(self._command.shape))
        return int(self._plant[1](self.calls.user, command))


class FlatOut:
    """The loop of a model plant as fast as it goes, in native code alone."""

    def __init__(self, of: Setup, references: References = HOLD) -> None:
        n = of.arm.n
        self.acting = Acting(of.made, references, of.ctrl.parameters, number=1, sends=True, over=0.2)
        self.loaded = LoadedSet(of.made.message(self.acting, begins=True))
        made = of.plant_set(of.arm.home, np.zeros(n))
        made = {**made, "layout": {**made["layout"], "period": 10**15}}
        self._plant = PlantDriver(made, RobotInfo(name="plant", n=n, rate=of.rate, takes="torque"))
        self._measured = Float64Block(made["measured"])
        assert list(made["measured"]) == list(of.made.safe.measured)
        calls = Calls(self._plant, self._measured.views, np.zeros(n))
        self.status, self._group = np.zeros(STATUS_WORDS, np.int64), np.zeros(1, np.int64)
        self.status[STATUS["control"]] = 1
        self._words = struct_of(LOOP, {
            "status": self.status.ctypes.data, "read": calls.read, "write": calls.write, "user": calls.user,
            "measured": self._measured.flat.ctypes.data, "period": 10**15, "group": self._group.ctypes.data,
            "set": self.loaded.address, "last": time.monotonic_ns(),
        })  # fmt: skip
        self._loop = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(servo_code()["loop"])
        self.memory = of.made.memory.views(self.loaded.blocks["memory"])

    def run(self, ticks: int) -> None:
        """At least so many."""
        self.status[STATUS["quit"]] = 0
        until = self.status[STATUS["ticks"]] + ticks

        def end() -> None:
            while self.status[STATUS["ticks"]] < until:
                time.sleep(0.002)
            self.status[STATUS["quit"]] = 1

        ender = threading.Thread(target=end)
        ender.start()
        self._loop(self._words.ctypes.data)
        ender.join()


def stop_torque(
    setup: Setup, before: Any, q: Any, v: Any, v_before: Any, lost: Any = (), q_ref: Any = None, v_ref: Any = None
) -> Any:
    """(n,) torque of the controlled stop in its first tick, by the formula of `docs/safety.md`, in plain NumPy."""
    arm, limits, dt = setup.arm, setup.limits, 1.0 / setup.rate
    brake = np.broadcast_to(setup.made.safe.deceleration, arm.n)
    v_from = np.clip(v, v_before - 10.0 * brake * dt, v_before + 10.0 * brake * dt)
    v_from[list(lost)] = v[list(lost)]
    change = np.clip(20.0 * dt * v_from, -brake * dt * dt / 0.05, brake * dt * dt / 0.05)
    omega = min(20.0, 0.05 * setup.rate)
    a = 2.0 * omega * (v_from - change - v) + omega**2 * 0.5 * dt * (2.0 * v_from - change)
    a[list(lost)] = 0.0
    x = snapshot(arm, q, v)
    h = np.asarray(x.h) - (np.asarray(x.g) if "gravity" in setup.adds else 0.0)
    tau = np.asarray(x.M) @ (a - change / dt) + h
    for limit, sign in ((limits.upper, 1.0), (limits.lower, -1.0)):
        room = sign * (np.asarray(limit) - q)
        fast = np.maximum(sign * v - 10.0 * np.maximum(room, 0.0), 0.0) * (room < np.asarray(limits.soft))
        fast[list(lost)] = 0.0
        tau = tau - sign * min(50.0, 0.25 * setup.rate) * np.diag(np.asarray(x.M)) * fast
    if setup.torque_rate:
        tau = np.clip(tau, before - setup.torque_rate * dt, before + setup.torque_rate * dt)
    return tau if limits.tau is None else np.clip(tau, -np.asarray(limits.tau), np.asarray(limits.tau))
