"""Robot: a robot or a model plant whose loop runs in a process of its own. Made by `taut.connect`."""

from __future__ import annotations

import contextlib
import dataclasses
import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from taut.arm.description import Arm, Payload
from taut.arm.parts import short_way
from taut.base.checks import finite_array, instance_of, require_range
from taut.base.errors import MatchError, RangeError, TautError, UsageError
from taut.base.paths import Parameters
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.servo_loop import ROW_HEAD
from taut.control.faults import CODES, Fault, fault_of
from taut.control.safety import SafeSide, SafetyLimits
from taut.control.trajectories.joint import Trapezoidal
from taut.control.trajectories.reference import JointMotion, Sample
from taut.controller import Controller
from taut.linear.judgement import Judgement, judge_start
from taut.loop import check_fit
from taut.maths.snapshot import snapshot
from taut.record.run import Run
from taut.runtime.realtime.acting import Acting
from taut.runtime.realtime.feeding import NO_ROWS, Feeder, References, references_of, time_outs
from taut.runtime.realtime.link import Link
from taut.runtime.realtime.sets import ServoSet, Table
from taut.runtime.realtime.status import RobotError, RobotStatus, percentiles
from taut.runtime.robots.driver import DriverError, RobotInfo

BLEND: Final = 0.2  # [s] in which another law, or new parameters, come in
THERE: Final = 2e-3  # [rad | m] from the goal of move_to
SETTLE: Final = 3.0  # [s] for a controlled stop, and for the last part of move_to
AT_REST: Final = 0.01  # [rad/s | m/s]
LOOK: Final = 0.02  # [s] between two looks at what is latched
SAME_LOAD: Final = 0.05  # [kg]
LATER: Final = 3  # ticks after which a request has surely been seen


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotPlant:
    """A robot as the checks of controller and plant see it."""

    name: str
    arm: Arm
    takes: str
    measures: frozenset[str]
    adds: Any
    parameters: Mapping[str, Float64Array] = dataclasses.field(default_factory=dict)
    distorts: frozenset[str] = frozenset()

    def checked_parameter(self, path: str, value: ArrayLike) -> Float64Array:
        raise UsageError(f"robot '{self.name}' has no parameter {path!r}", name=path, value=value)

    def check_together(self, values: Mapping[str, ArrayLike]) -> None:
        """A robot has no parameters."""


class RobotParameters(Parameters):
    """Parameters of the law that acts, by path; new values are blended in within 0.2 s."""

    def __init__(self, robot: Robot, ctrl: Controller) -> None:
        super().__init__("the robot's law", {path: np.array(value) for path, value in ctrl.parameters.items()})
        self._robot, self._ctrl = robot, ctrl

    def __setitem__(self, path: str, value: ArrayLike) -> None:
        checked = self._ctrl.side.checked_parameter(path, value)
        self._ctrl.side.check_change(self._robot.q, self._values, {path: checked})
        self._values[path] = checked
        self._robot.acting.controls.set({path: checked}, BLEND)


class Robot:
    """A robot whose loop runs in a process of its own, under safety limits. Close it, or use it with `with`.

    Nothing moves before `start`, `move_to` or `hold`. A fault ends every law in the controlled stop of
    `taut.SafetyLimits`, within one tick, and is latched: every verb raises it as RobotError until `recover()`.

    Args:
        link: Its processes.
        info: What it declared.
        arm: Its model.
        limits: Its safety limits.
        holder: The controller that holds and that `move_to` moves by.
    """

    def __init__(self, link: Link, info: RobotInfo, arm: Arm, limits: SafetyLimits, holder: Controller) -> None:
        self.link, self.info, self.arm, self.limits = link, info, arm, limits
        self.holder = holder
        self._plant = RobotPlant(
            name=info.name, arm=arm, takes=info.takes, measures=frozenset(info.measures), adds=holder.adds
        )
        self._number = 0
        self._all: list[Acting] = []
        self._feeder: Feeder | None = None
        self.parameters: RobotParameters
        """Parameters of the law that acts, by path; settable while it runs."""
        hold = References(tables=[Table(rows=NO_ROWS)], streams={})
        self._install(holder, hold, begins=False, sends=True)
        # Also where the program ends without closing it.
        self._finalizer = weakref.finalize(self, _freed, link, self._all)

    @property
    def adds(self) -> Any:
        """What the robot adds to a torque itself, for `taut.compile(adds=)`."""
        return self._plant.adds

    @property
    def rate(self) -> float:
        """Ticks per second [Hz], for `taut.compile(rate=)`."""
        return self.info.rate

    def start(
        self, ctrl: Controller, ref: object = None, *, duration: float | None = None, over: float = BLEND
    ) -> None:
        """Let a controller act, from where the arm is.

        Args:
            ctrl: Made by `taut.compile(..., rate=robot.rate, adds=robot.adds)`, of a law or a task.
            ref: A sample, hold, trajectory, stream or chunk; a hold of where the arm is if left out. None for a task.
            duration: How much of a trajectory without an end is followed [s]; then the last sample stays.
            over: Time in which its command comes in, from the one that is sent now [s].

        Raises:
            MatchError, UsageError, RangeError: Controller, robot and reference do not fit, or the sampled loop is
                unstable here; nothing was sent.
            RobotError: A fault is latched.
        """
        self.check()
        references = self._checked(ctrl, ref, duration)
        verdict = judge_start(ctrl, self._plant, self.q)
        if isinstance(verdict, Judgement) and not verdict.stable:
            raise RangeError(f"{verdict.message} (nothing was sent to {self.info.name})", name="law")
        if not self.link.word("control"):
            self._begin()
        self._install(ctrl, references, begins=True, sends=True, over=over)
        self.link.set_word("hold", 0)

    def switch(
        self, ctrl: Controller, ref: object = None, *, duration: float | None = None, over: float = BLEND
    ) -> None:
        """Another controller in place of the one that acts, whose command fades into it within `over` [s]."""
        if not self.link.word("control"):
            raise UsageError("nothing acts that could be switched; use start", name="switch")
        self.start(ctrl, ref, over=over, duration=duration)

    def shadow(self, ctrl: Controller, ref: object = None, *, duration: float | None = None) -> None:
        """Let a controller run on the live state and send nothing; its commands are in `robot.run()`."""
        self.check()
        if self.link.word("control"):
            raise UsageError("shadow is for a robot that is not controlled now; stop it first", name="shadow")
        self._install(ctrl, self._checked(ctrl, ref, duration), begins=True, sends=False)

    def move_to(self, q: ArrayLike, *, speed: float = 0.2) -> None:
        """Move the joints to q (n,) [rad | m], at most at `speed` times its speed limit; returns when there."""
        arm = self.arm
        goal = finite_array("q", q, shape=(arm.n,), joints=arm.joint_names, unit="rad | m")
        i = int(np.argmax(np.maximum(arm.lower - goal, goal - arm.upper)))
        require_range(
            f"q of joint '{arm.joint_names[i]}'",
            goal[i],
            unit=arm.units[i],
            minimum=float(arm.lower[i]),
            maximum=float(arm.upper[i]),
        )
        require_range("speed", np.asarray(speed, dtype=np.float64), above=0.0, maximum=1.0)
        here = self.q
        there = here + short_way(goal - here, arm.continuous)
        v_max = np.where(np.isfinite(arm.velocity), arm.velocity, 1.0) * speed
        if np.abs(there - here).max() > THERE:
            path = Trapezoidal(q0=here, q1=there, velocity=v_max, acceleration=2.0 * v_max)
            self.start(self.holder, path)
            self.wait(float(path.duration))
        else:
            self.start(self.holder, JointMotion(q=there))
        until = time.monotonic() + SETTLE
        while np.abs(self.q - there).max() > THERE and time.monotonic() < until:
            self.wait(LOOK)

    def hold(self) -> None:
        """The controlled stop, from the next tick on: brake, then hold where the arm is."""
        self.check()
        if not self.link.word("control"):
            self._begin()
        self.link.set_word("hold", 1)

    def stop(self) -> Run:
        """The controlled stop; when the arm stands, give control back to the robot. The record of the last law."""
        if self.link.word("control") and self.link.alive:
            self.link.set_word("hold", 1)
            until = time.monotonic() + SETTLE
            time.sleep(LATER / self.rate)
            while self.link.alive and time.monotonic() < until and np.abs(self._last("v", LATER)).max() > AT_REST:
                time.sleep(LOOK)
        self._end_feeding()
        run = self.run()
        with contextlib.suppress(DriverError):
            if self.link.word("control"):
                self.link.ask("end")
        return run

    def recover(self) -> None:
        """Clear what is latched, in the robot too. It is then as after `taut.connect`."""
        if not self.link.alive:
            raise RobotError(self.fault or fault_of(CODES["process_died"], 0))
        hold = References(tables=[Table(rows=NO_ROWS)], streams={})
        self._install(self.holder, hold, begins=False, sends=True, recovers=True)
        self._pause()

    def stream(self, *, period: float) -> Callable[[Sample], None]:
        """The function that sends a sample to the law that acts, which was started with `taut.stream(period=)`.

        Where none came for two periods the loop holds; after three (and 50 ms at least, for a period of 20 ms or
        less) it stops with the fault `stream_stopped`.
        """
        require_range("period", np.asarray(period, dtype=np.float64), above=0.0, unit="s")
        controls = self._all[-1].controls

        def send(sample: Sample) -> None:
            controls.send(sample)
            controls.time_out(*time_outs(period))

        return send

    def wait(self, duration: float) -> None:
        """Wait while the loop runs [s]; a fault is raised as soon as it is seen."""
        until = time.monotonic() + duration
        while True:
            self.check()
            remaining = until - time.monotonic()
            if remaining <= 0.0:
                return
            time.sleep(min(LOOK, remaining))

    def check(self) -> None:
        """Raise what is latched, as RobotError; and what a source or a phase's reference raised."""
        fault = self.fault
        if fault is not None:
            raise RobotError(fault)
        if self._feeder is not None and self._feeder.error is not None:
            raise self._feeder.error

    def call(self, name: str, **arguments: Any) -> Any:
        """A function of the robot's driver, such as its gripper's; between motions."""
        return self.link.ask("call", (name, arguments))

    def set_load(self, payload: Payload) -> None:
        """Tell the robot its load, which it compensates from then on; between motions."""
        instance_of("payload", payload, Payload, "a taut.Payload, such as arm.payload")
        self.link.ask("load", (payload.mass, np.array(payload.com), np.array(payload.inertia)))
        x, y, z = (float(value) for value in payload.com)
        self.info = dataclasses.replace(self.info, load=(float(payload.mass), (x, y, z)))

    @property
    def acting(self) -> Acting:
        """The law that ticks: the one sent last may not have begun yet."""
        number = self.link.word("running")
        return next((one for one in reversed(self._all) if one.number == number), self._all[-1])

    @property
    def q(self) -> Float64Array:
        """(n,) the newest measured positions [rad | m]."""
        newest: Float64Array = self._last("q")[-1]
        return newest

    @property
    def v(self) -> Float64Array:
        """(n,) the newest measured velocities [rad/s | m/s]."""
        newest: Float64Array = self._last("v")[-1]
        return newest

    @property
    def fault(self) -> Fault | None:
        """What is latched, or None."""
        link = self.link
        if link.released:
            raise UsageError(f"the connection to {self.info.name} is closed; taut.connect again", name="robot")
        link.hear()
        if link.failure is not None:
            code, text = link.failure
            return fault_of(code, link.word("ticks"), detail=text)
        if not link.alive:
            return fault_of(link.word("fault") or CODES["process_died"], link.word("ticks"))
        return self.acting.fault()

    @property
    def status(self) -> RobotStatus:
        """What the loop does now."""
        fault, link, acting = self.fault, self.link, self.acting
        rows = acting.rows()
        runs = len(rows) and acting.column(rows, "safe.mode")[-1] > 0.5
        state = "running" if runs else "holding"
        if not link.word("control"):
            state = "idle" if acting.sends else "shadow"
        state = "gone" if not link.alive else "fault" if fault is not None else state
        return RobotStatus(
            state=state,
            fault=fault,
            t=float(acting.column(rows, "t")[-1]) if len(rows) else 0.0,
            q=self._last("q")[-1],
            v=self._last("v")[-1],
            command=self._last("command")[-1],
            ticks=link.word("ticks"),
            lost=link.word("lost"),
            overruns=link.word("overruns"),
            compute=percentiles(acting.column(rows, "loop.compute")),
            driver=percentiles(acting.column(rows, "loop.driver")),
            notes=tuple(link.notes),
        )

    def run(self) -> Run:
        """The record of the law that acts, or acted last: its last 8000 ticks."""
        return self.acting.run(self.info.name, self.arm, self.fault)

    def timing(self) -> dict[str, Float64Array]:
        """Of the ticks that are kept: late, compute, driver [s], and the periods lost before each."""
        rows = self.acting.rows()
        return {name: self.acting.column(rows, f"loop.{name}").copy() for name in ROW_HEAD[2:]}

    def close(self) -> None:
        """Stop, and end the loop's process."""
        if self.link.released:
            return
        with contextlib.suppress(TautError):
            self.stop()
        self._end_feeding()
        self._finalizer()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Robot({self.info.name}, {self.arm!r}, rate={self.rate:g})"

    def _pause(self) -> None:
        time.sleep(LATER / self.rate)

    def _begin(self) -> None:
        self.link.set_word("hold", 0)
        self.link.ask("begin")
        self._pause()

    def _last(self, path: str, count: int = 1) -> Float64Array:
        """The last rows of a column; velocities from positions where none are measured."""
        until = time.monotonic() + SETTLE
        while time.monotonic() < until:
            acting = self.acting
            rows = acting.rows(max(count, 2))
            if len(rows):
                if path in acting.columns:
                    return acting.column(rows, path)[-count:]
                q = acting.column(rows, "q")
                return (np.diff(q, axis=0, prepend=q[:1]) * self.rate)[-count:]
            self._require_alive()
            time.sleep(1e-3)
        raise DriverError(f"{self.info.name} sent no state within {SETTLE:g} s", kind="silent")

    def _require_alive(self) -> None:
        self.link.hear()
        if not self.link.alive or self.link.failure is not None:
            self.check()

    def _checked(self, ctrl: Controller, ref: object, duration: float | None) -> References:
        """What feeds a controller that fits this robot, whose loop is stable here."""
        instance_of("ctrl", ctrl, Controller, "a controller from taut.compile")
        name, q = self.info.name, self.q
        check_fit(ctrl.side, self._plant)
        if abs(ctrl.rate - self.rate) > 1e-6 * self.rate:
            raise MatchError(
                f"{name} takes commands at {self.rate:g} Hz and the controller was compiled for {ctrl.rate:g} Hz; "
                "taut.compile(..., rate=robot.rate)",
                name="rate",
            )
        load, mass = self.info.load, float(ctrl.arm.payload.mass)
        if load is not None and "gravity" in self.info.adds and abs(load[0] - mass) > SAME_LOAD:
            raise MatchError(
                f"{name} compensates a load of {load[0]:g} kg and the controller's arm carries {mass:g} kg; "
                "robot.set_load(arm.payload), or load the arm with what is there",
                name="load",
            )
        return references_of(ctrl, ref, q, duration)

    def _install(
        self,
        ctrl: Controller,
        references: References,
        *,
        begins: bool,
        sends: bool,
        over: float = BLEND,
        recovers: bool = False,
    ) -> None:
        """Send a compiled tick, wait until it acts, and feed it."""
        self._end_feeding()
        safe = SafeSide(side=ctrl.side, limits=self.limits, measures=tuple(self.info.measures))
        safe.check()
        made = ServoSet(safe, dict(ctrl.parameters))
        self._number += 1
        acting = Acting(made, references.tables, number=self._number, sends=sends, over=over)
        first = self._command_at_start(made)
        self.link.tell("set", made.message(acting, first, begins=begins))
        if recovers:  # with the tick that holds already waiting: another one might latch the same again
            self.link.ask("recover")
            self.link.failure = None
        for old in self._all[:-2]:
            old.close()
        self._all[:] = [*self._all[-2:], acting]
        self.parameters = RobotParameters(self, ctrl)
        until = time.monotonic() + SETTLE
        while self.link.word("running") != self._number and time.monotonic() < until:
            self._require_alive()
            time.sleep(5e-4)
        feeder = Feeder(acting, references)
        if feeder.needed:
            self._feeder = feeder
            feeder.start()

    def _command_at_start(self, made: ServoSet) -> Float64Array:
        """The command from which limits begin, of a robot that was not controlled."""
        side = made.safe.side
        if not self._all:
            return np.zeros(side.arm.n) if side.probe.kind != "position" else side.arm.home.copy()
        if side.probe.kind == "position":
            return self.q
        if side.probe.kind == "velocity":
            return np.zeros(side.arm.n)
        return np.array(snapshot(side.arm, self.q, np.zeros(side.arm.n)).g) * float(not side.adds.gravity)

    def _end_feeding(self) -> None:
        if self._feeder is not None:
            self._feeder.end()
            self._feeder = None


def _freed(link: Link, acting: list[Acting]) -> None:
    """End the processes and free the memory of a robot."""
    link.close()
    for one in acting:
        one.close()
