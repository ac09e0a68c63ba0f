"""Robot: a robot or a model plant whose loop runs in a process of its own. Made by `taut.connect`."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import threading
import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from taut.arm.description import Arm, Payload
from taut.arm.parts import inertia_matrix, short_way
from taut.base.checks import finite_array, finite_scalar, instance_of, require_range
from taut.base.errors import MatchError, RangeError, TautError, UsageError
from taut.base.paths import Parameters
from taut.base.types import ArrayLike, Float64Array
from taut.control.faults import CODES, Fault, fault_of
from taut.control.safety import SafeSide, SafetyLimits
from taut.control.trajectories.joint import Trapezoidal
from taut.control.trajectories.reference import JointMotion, Sample
from taut.control.trajectories.samples import Chunk
from taut.controller import Controller
from taut.linear.judgement import Judgement, judge_start
from taut.loop import check_fit
from taut.plant.actuation import Actuation
from taut.record.run import Run
from taut.runtime.realtime.acting import Acting
from taut.runtime.realtime.feeding import Feeder, References, references_of, require_fitting
from taut.runtime.realtime.link import CLOSING, Link
from taut.runtime.realtime.logger import LogProcess
from taut.runtime.realtime.ring import ENDED
from taut.runtime.realtime.sets import NO_ROWS, ServoSet, Table
from taut.runtime.realtime.shared import uninterrupted
from taut.runtime.realtime.status import RobotError, RobotStatus, Timing
from taut.runtime.robots.driver import DriverError, RobotInfo

BLEND: Final = 0.2  # [s] in which another law, or new parameters, come in
THERE: Final = 5e-3  # [rad | m] from the goal of move_to
SETTLE: Final = 3.0  # [s] for a controlled stop
ARRIVAL: Final = 10.0  # [s] for the last part of move_to: dry friction gives way to an integral
FASTEST_MOVE: Final = 0.9  # [-] of the speed limits, of move_to
STANDING: Final = 0.01  # [rad/s | m/s]
AT_REST: Final = 0.5  # [s] of standing, before motors hold by themselves with the torque that they have then
LOOK: Final = 0.02  # [s] between two looks at what is latched
SAME_LOAD: Final = 0.05  # [kg]
LOAD_HINT: Final = "robot.set_load(arm.payload), or load the arm with what is there: payload in a scenario's [arm]"
LATER: Final = 3  # ticks after which a request has surely been seen
SILENT: Final = 0.5  # [s] after which a state is no news
HOLD: Final = References(tables=[Table(rows=NO_ROWS)])


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
    gains: tuple[float, float] = (math.inf, math.inf)  # largest kp, kd of its motors
    integrator: str = "rk4"  # exact under a command that is held, where the robot is judged by its model
    actuation: Actuation = dataclasses.field(default_factory=Actuation)

    def checked_parameter(self, path: str, value: ArrayLike) -> Float64Array:
        raise UsageError(f"robot '{self.name}' has no parameter {path!r}", name=path, value=value)

    def check_together(self, values: Mapping[str, ArrayLike]) -> None:
        """A robot has no parameters."""


class RobotParameters(Parameters):
    """Parameters of the law that acts, by path; new values are blended in within 0.2 s."""

    def __init__(self, robot: Robot, ctrl: Controller, acting: Acting) -> None:
        super().__init__("the robot's law", {path: np.array(value) for path, value in ctrl.parameters.items()})
        self._robot, self._ctrl, self._acting = robot, ctrl, acting

    def __setitem__(self, path: str, value: ArrayLike) -> None:
        self.update({path: value})

    def update(self, other: Any = (), /, **values: ArrayLike) -> None:
        """New values that come in together, as for a dict; refused where the sampled loop would be unstable here."""
        robot, side = self._robot, self._ctrl.side
        checked = {path: side.checked_parameter(path, value) for path, value in dict(other, **values).items()}
        side.check_change(robot.q, self._values, checked)
        if "model.payload.mass" in checked:
            robot.require_load(float(checked["model.payload.mass"]))
        require_stable(self._ctrl, robot.plant, robot.q, {**self._values, **checked})
        self._values |= checked
        self._acting.controls.set(checked, BLEND)


class Gripper:
    """The gripper of a robot: functions of its driver. Each returns what it came to, such as the width, when it ends.

    The arm goes on meanwhile; a fault of it is raised as RobotError.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def move(self, width: float, *, speed: float = 0.05) -> dict[str, Any]:
        """Open or close to a width [m], at a speed [m/s]."""
        return self._ended("move", width=width, speed=speed)

    def grasp(self, width: float, force: float, *, speed: float = 0.05) -> dict[str, Any]:
        """Close on something of a width [m] until there is a force [N], at a speed [m/s]."""
        return self._ended("grasp", width=width, force=force, speed=speed)

    def home(self) -> dict[str, Any]:
        """Find the largest width."""
        return self._ended("homing")

    @property
    def status(self) -> dict[str, Any]:
        """What it does now, by the driver's words: `busy`, `error`, `width` [m]."""
        try:
            return dict(self._robot.call("gripper"))
        except DriverError as error:
            if error.kind != "rejected":
                raise
            raise DriverError(f"{self._robot.info.name} has no gripper: {error}", kind="rejected") from error

    def _ended(self, name: str, **arguments: float) -> dict[str, Any]:
        _ = self.status  # raises where there is no gripper
        self._robot.call(name, **arguments)
        while (status := self.status).get("busy"):
            self._robot.wait(LOOK)
        if status.get("error"):
            raise DriverError(f"the gripper failed to {name}: {status['error']}", kind="rejected")
        return status


class Robot:
    """A robot whose loop runs in a process of its own, under safety limits. Close it, or use it with `with`.

    Nothing moves before `start`, `move_to` or `hold`. A fault ends every law in the controlled stop of
    `taut.SafetyLimits`, within one tick, and is latched: every verb raises it as RobotError until `recover()`. All
    verbs may be called from several threads; `stop` acts at once, and ends a `start` that is under way.

    Args:
        link: Its process.
        info: What it declared.
        arm: Its model.
        limits: Its safety limits.
        holders: Makes the controller that holds and that `move_to` moves by.
        log: The process that logs, or None.
        partner: A robot whose faults stop this one, and the other way round.
    """

    def __init__(
        self, link: Link, info: RobotInfo, arm: Arm, limits: SafetyLimits,
        holders: Callable[[RobotInfo, Arm], Controller], log: LogProcess | None = None, partner: Robot | None = None,
    ) -> None:  # fmt: skip
        self._together: weakref.WeakSet[Robot] = weakref.WeakSet() if partner is None else partner._together
        self._together.add(self)
        self.link, self.limits, self._holders, self._log = link, limits, holders, log
        self.parameters: RobotParameters
        """Parameters of the law that acts, by path; settable while it runs."""
        self._number, self._stops, self._verbs = 0, 0, threading.RLock()
        self._all: list[Acting] = []
        self._feeder: Feeder | None = None
        self._know(info, arm)
        # Also where the program ends without closing it.
        self._finalizer = weakref.finalize(self, freed, link, log, self._all)

    def _know(self, info: RobotInfo, arm: Arm) -> None:
        """Take what the robot is and carries, and hold accordingly."""
        self.info, self.arm, self.holder = info, arm, self._holders(info, arm)
        torques = info.takes in ("torque", "mit")  # else drives as fast as the loop: slower ones allow less
        self.plant = RobotPlant(
            name=info.name, arm=arm, takes=info.takes, measures=frozenset(info.measures), adds=self.holder.adds,
            actuation=Actuation(delay=info.delay, bandwidth=None if torques else info.rate), gains=info.gains,
        )  # fmt: skip
        self._holding = self._compiled(self.holder)
        self._act(self.holder, self._holding, HOLD, begins=False)

    @property
    def adds(self) -> Any:
        """What the robot adds to a torque itself, for `taut.compile(adds=)`."""
        return self.plant.adds

    @property
    def rate(self) -> float:
        """Ticks per second [Hz], for `taut.compile(rate=)`."""
        return self.info.rate

    @property
    def gripper(self) -> Gripper:
        """The robot's gripper, where its driver has one."""
        return Gripper(self)

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
        self._begin(ctrl, ref, duration, over=over)

    def switch(
        self, ctrl: Controller, ref: object = None, *, duration: float | None = None, over: float = BLEND
    ) -> None:
        """Another controller in place of the one that acts, whose command fades into it within `over` [s]."""
        self._require_no_fault()
        if not self.link.word("control"):
            raise UsageError("nothing acts that could be switched; use start", name="switch")
        self._begin(ctrl, ref, duration, over=over)

    def shadow(self, ctrl: Controller, ref: object = None, *, duration: float | None = None) -> None:
        """Let a controller run on the live state and send nothing; its commands are in `robot.run()`."""
        self.check()
        if self.link.word("control"):
            raise UsageError("shadow is for a robot that is not controlled now; stop it first", name="shadow")
        self._begin(ctrl, ref, duration, sends=False)

    def require(
        self, ctrl: Controller, ref: object = None, *, duration: float | None = None, q: ArrayLike | None = None
    ) -> None:
        """Everything that `start` checks and refuses, for an arm at q (n,) [rad | m], where it is if left out."""
        self.check()
        here = self.q if q is None else finite_array("q", q, shape=(self.arm.n,), unit="rad | m")
        self._checked(ctrl, ref, duration, here, sends=True)

    def move_to(self, q: ArrayLike, *, speed: float = 0.2) -> None:
        """Move the joints to q (n,) [rad | m], at most at `speed` times their speed limits; returns when there.

        `speed` is at most 0.9: what is measured varies about the reference, and beyond the limit it is a fault.

        Raises:
            DriverError: They are not there 10 s after they should be.
            UsageError: Another verb ended it.
        """
        self._require_no_fault()
        arm = self.arm
        goal = finite_array("q", q, shape=(arm.n,), joints=arm.joint_names, unit="rad | m")
        own, none = self.limits, np.full(arm.n, np.inf)
        low = np.maximum(arm.lower, -none if own.lower is None else own.lower)
        high = np.minimum(arm.upper, none if own.upper is None else own.upper)
        i = int(np.argmax(np.maximum(low - goal, goal - high)))
        name = f"q of joint '{arm.joint_names[i]}'"
        require_range(name, goal[i], unit=arm.units[i], minimum=float(low[i]), maximum=float(high[i]))
        require_range("speed", np.asarray(finite_scalar("speed", speed)), above=0.0, maximum=FASTEST_MOVE)
        here = self.q
        there = here + short_way(goal - here, arm.continuous)
        most = arm.velocity if own.v is None else np.minimum(arm.velocity, own.v)
        v_max = np.where(np.isfinite(most), most, 1.0) * speed
        ref: Any = JointMotion(q=there)
        if np.abs(there - here).max() > THERE:
            ref = Trapezoidal(q0=here, q1=there, velocity=v_max, acceleration=2.0 * v_max)
        stops = self._stops
        ours = self._begin(self.holder, ref, None)
        arrives = time.monotonic() + float(getattr(ref, "duration", 0.0))
        while (apart := np.abs(self.q - there)).max() > THERE or time.monotonic() < arrives:
            if (ours, stops) != (self._number, self._stops):
                raise UsageError("move_to was ended by another verb, before the arm was there", name="move_to")
            if time.monotonic() > arrives + ARRIVAL:
                name = arm.joint_names[int(np.argmax(apart))]
                away = f"joint '{name}' is still {apart.max():.3g} away from its goal"
                raise DriverError(f"{away}; free the arm, or raise limits.tau", kind="rejected")
            self.wait(LOOK)

    def hold(self) -> None:
        """The controlled stop, from the next tick on: brake, then hold where the arm is.

        Raises RangeError where it is not controlled yet and its limits do not carry it here.
        """
        self._require_no_fault()
        self._stops += 1
        self.link.set_word("hold", 1)
        with self._verbs:
            if not self.link.word("control"):
                self._holding.safe.check_pose(self.q)
                self._act(self.holder, self._holding, HOLD, begins=False, controls=True)

    def stop(self) -> Run:
        """The controlled stop; when the arm stands, give control back to the robot. The record of the last law.

        Raises DriverError where the driver fails to give it back; a fault is in the record.
        """
        self._require_open()
        self._stand()
        with self._verbs:
            self._end_feeding()
            run = self.run()
            if self.link.word("control"):
                with contextlib.suppress(DriverError):
                    self._stand()
            if self.link.word("control") and self.link.alive:
                self.link.ask("end")
            return run

    def recover(self) -> None:
        """Clear what is latched, in the robot too. It is then as after `taut.connect`.

        Raises:
            DriverError: The robot is not ready: its cause is still there.
            RobotError: The loop has the cause again at once, or its process is gone.
        """
        self._require_open()
        fault, partner = self.fault, CODES["partner"]
        for other in self._together if fault is not None and fault.code == partner else ():
            cause = None if other is self or other.link.released else other.fault
            if cause is not None and cause.code != partner:
                who = other.info.name
                raise UsageError(f"{who} stopped both: {cause}; recover it first, or close it", name="recover")
        if not self.link.alive or (fault is not None and fault.code == CODES["unwatched"]):
            self.check()  # only a new connection helps
        self._stand()
        with self._verbs:
            self._end_feeding()
            self.link.ask("recover")
            self.link.failure = None
            self._pause()
        self.check()

    def stream(self, *, period: float) -> Callable[[Sample | Chunk], None]:
        """The function that sends samples or chunks to the law that acts, started with `taut.stream(period=)`.

        Where none came for two periods the loop holds; after three (and 50 ms at least, for a period of 20 ms or
        less) it stops with the fault `stream_stopped`.
        """
        self._require_open()
        feeder = self._feeder
        declared = [] if feeder is None else feeder.periods
        if feeder is None or not any(abs(period - one) <= 1e-9 for one in declared):
            stated = f"with a period of {declared[0]:g} s" if declared else "without a stream to be sent"
            hint = f"start it with taut.stream(period={period:g})"
            raise UsageError(f"the law that acts was started {stated}; {hint}", name="period")

        def send(sample: Sample | Chunk) -> None:
            if feeder is not self._feeder:
                raise UsageError("the law of this stream does not act any more; robot.stream() again", name="stream")
            self.check()
            feeder.send(sample)

        return send

    def wait(self, duration: float) -> None:
        """Wait while the loop runs [s]; a fault is raised as soon as it is seen."""
        until = time.monotonic() + finite_scalar("duration", duration, unit="s", minimum=0.0)
        while True:
            self.check()
            remaining = until - time.monotonic()
            if remaining <= 0.0:
                return
            time.sleep(min(LOOK, remaining))

    def check(self) -> None:
        """Raise what is latched, as RobotError; and what a source or a phase's reference raised."""
        self._require_no_fault()
        if self._feeder is not None and self._feeder.error is not None:
            raise self._feeder.error

    def _require_no_fault(self) -> None:
        fault = self.fault
        if fault is not None:
            acting = self.acting
            raise RobotError.of(fault, acting.run(self.info.name, self.arm, fault, acting.last_rows))

    def call(self, name: str, **arguments: Any) -> Any:
        """A function of the robot's driver, such as its collision thresholds; it runs between two ticks."""
        self._require_open()
        return self.link.ask("call", (name, arguments))

    def set_load(self, payload: Payload) -> None:
        """Tell the robot its load: it compensates it and `robot.arm` carries it; where it is not controlled."""
        self._require_open()
        instance_of("payload", payload, Payload, "a taut.Payload, such as arm.payload")
        if self.link.word("control"):
            raise UsageError("the load is set while nothing acts; robot.stop() first", name="set_load")
        inertia = np.array(inertia_matrix(payload.inertia))
        self.link.ask("load", (payload.mass, np.array(payload.com), inertia))
        x, y, z = (float(value) for value in payload.com)
        info = dataclasses.replace(self.info, load=(float(payload.mass), (x, y, z)))
        with self._verbs:
            self._know(info, self.arm.with_payload(payload.mass, com=payload.com, inertia=payload.inertia))

    @property
    def acting(self) -> Acting:
        """The law that ticks: the one sent last may not have begun yet."""
        self._require_open()
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
        self._require_open()
        link, acting = self.link, self.acting
        link.hear()
        if link.failure is not None:
            code, text = link.failure
            fault: Fault | None = fault_of(code, link.word("ticks"), detail=text)
        elif not link.alive:
            fault = fault_of(link.word("fault") or CODES["process_died"], link.word("ticks"))
        else:
            fault = acting.fault()
        acting.ended = acting.ended or fault
        return fault

    @property
    def status(self) -> RobotStatus:
        """What the loop does now."""
        fault, link, acting = self.fault, self.link, self.acting
        with contextlib.suppress(TautError):
            self._last("t")  # a law's first tick may be under way
        rows, n = acting.rows(), self.arm.n
        runs = len(rows) and acting.column(rows, "safe.mode")[-1] > 0.5
        state = ("running" if runs else "holding") if link.word("control") else "shadow" if runs else "idle"
        state = "gone" if not link.alive else "fault" if fault is not None else state
        return RobotStatus(
            state=state,
            fault=fault,
            t=float(acting.column(rows, "t")[-1]) if len(rows) else 0.0,
            **{
                name: acting.column(rows, name)[-1] if len(rows) else np.full(n, np.nan)
                for name in ("q", "v", "command")
            },
            ticks=link.word("ticks"),
            lost=link.word("lost"),
            overruns=link.word("overruns"),
            timing=self.timing(),
            dropped=0 if self._log is None else self._log.dropped,
            notes=(*link.notes, *self.info.facts.get("notes", ())),
        )

    def run(self) -> Run:
        """The record of the law that acts, or acted last: its last 8000 ticks."""
        return self.acting.run(self.info.name, self.arm, self.fault or self.acting.ended)

    def timing(self) -> Timing:
        """Lateness and computing time of the ticks that are kept, and what the driver takes."""
        return Timing.of(self.run())

    def close(self) -> None:
        """Stop, and end the loop's process. Ctrl-C waits meanwhile."""
        if self.link.released:
            return
        with uninterrupted():
            with contextlib.suppress(TautError):
                self._stand()
                if self.link.word("control"):
                    self.link.ask("end", within=CLOSING)
            self._finalizer()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Robot({self.info.name}, {self.arm!r}, rate={self.rate:g})"

    def _require_open(self) -> None:
        if self.link.released:
            raise UsageError(f"the connection to {self.info.name} is closed; taut.connect again", name="robot")

    def _pause(self) -> None:
        time.sleep(LATER / self.rate)

    def _stand(self) -> None:
        """The controlled stop, also of a law that is just being started, until the arm stands or the loop ends."""
        self._stops += 1
        self.link.set_word("hold", 1)
        self._pause()
        until, ticks = time.monotonic() + SETTLE, LATER if self.info.holds else round(AT_REST * self.rate)
        while self.link.word("control") and self.link.failure is None and self.link.alive:
            self.link.set_word("hold", 1)
            if np.abs(self._last("v", ticks)).max() < max(STANDING, self.info.at_rest) or time.monotonic() > until:
                return
            time.sleep(LOOK)

    def _last(self, path: str, count: int = 1) -> Float64Array:
        """The last rows of a column. Raises DriverError or RobotError where the robot is silent."""
        until = time.monotonic() + SETTLE
        while time.monotonic() < until:
            acting = self.acting
            rows = acting.rows(count)
            if len(rows) and (self.link.silence < SILENT + LATER / self.rate or not self.link.alive):
                return acting.column(rows, path)
            self.link.hear()
            if not self.link.alive or self.link.failure is not None:
                self.check()
            time.sleep(1e-3)
        raise self._silent()

    def _silent(self) -> DriverError:
        return DriverError(f"{self.info.name} sent no state within {SETTLE:g} s", kind="silent")

    def _begin(
        self, ctrl: Controller, ref: object, duration: float | None, *, sends: bool = True, over: float = BLEND
    ) -> int:
        """Let a controller act that fits this robot and is stable here; its number."""
        self._require_no_fault()
        finite_scalar("over", over, unit="s", minimum=0.0)
        if duration is not None:
            finite_scalar("duration", duration, unit="s", above=0.0)
        stops = self._stops
        with self._verbs:
            made, references = self._checked(ctrl, ref, duration, self.q, sends)
            if self._stops != stops:
                raise UsageError("the robot was stopped while it started", name="start")
            self.link.set_word("hold", 0)
            self._act(ctrl, made, references, begins=True, sends=sends, controls=sends, over=over)
            return self._number

    def _checked(
        self, ctrl: Controller, ref: object, duration: float | None, q: Float64Array, sends: bool
    ) -> tuple[ServoSet, References]:
        """The compiled tick, and what feeds it, of a controller that fits this robot and is stable at q."""
        instance_of("ctrl", ctrl, Controller, "a controller from taut.compile")
        name = self.info.name
        check_fit(ctrl.side, self.plant)
        if abs(ctrl.rate - self.rate) > 1e-6 * self.rate:
            rates = f"takes commands at {self.rate:g} Hz and the controller was compiled for {ctrl.rate:g} Hz"
            raise MatchError(f"{name} {rates}; taut.compile(..., rate=robot.rate)", name="rate")
        self.require_load(float(ctrl.parameters["model.payload.mass"]))
        references = references_of(ctrl, ref, q, duration)
        made = self._holding if ctrl is self.holder else self._compiled(ctrl)
        if sends:
            require_fitting(ctrl.side, references, q, self.limits)
            made.safe.check_pose(q)
        require_stable(ctrl, self.plant, q)
        return made, references

    def require_load(self, mass: float) -> None:
        """MatchError for a payload's mass [kg] of a controller that is another one than the robot compensates."""
        load = self.info.load
        if load is not None and "gravity" in self.info.adds and abs(load[0] - mass) > SAME_LOAD:
            loads = f"compensates a load of {load[0]:g} kg and the controller's arm carries {mass:g} kg"
            raise MatchError(f"{self.info.name} {loads}; {LOAD_HINT}", name="load")

    def _compiled(self, ctrl: Controller) -> ServoSet:
        safe = SafeSide(
            side=ctrl.side, limits=self.limits, measures=tuple(self.info.measures), at_rest=self.info.at_rest,
            torque_rate=self.info.torque_rate,
        )  # fmt: skip
        safe.check()
        return ServoSet(safe)

    def _act(
        self, ctrl: Controller, made: ServoSet, references: References, *, begins: bool, sends: bool = True,
        controls: bool = False, over: float = BLEND,
    ) -> None:  # fmt: skip
        """Send a compiled tick, with which control may begin; wait until it acts, and feed it."""
        self._end_feeding()
        self._number += 1
        acting = Acting(made, references, ctrl.parameters, number=self._number, sends=sends, over=over)
        if self._log is not None:
            self._log.follow(acting, self.info.name, self.arm, ctrl.side.title if begins else "hold")
        try:
            controls = controls and not self.link.word("control")
            self.link.ask("set", {**made.message(acting, begins=begins), "control": controls})
        except BaseException:
            acting.ring.header[ENDED] = 1
            acting.close()
            raise
        self._all.append(acting)
        self.parameters = RobotParameters(self, ctrl, acting)
        self._feeder = Feeder(acting, references)
        self._feeder.start()
        until = time.monotonic() + SETTLE
        while self.link.word("running") != self._number:
            self.check()
            if time.monotonic() > until:
                raise self._silent()
            time.sleep(5e-4)
        for old in self._all[:-1]:
            old.ring.header[ENDED] = 1
            if self._log is None or old.ring.done:
                old.close()
                self._all.remove(old)

    def _end_feeding(self) -> None:
        if self._feeder is not None:
            self._feeder.end()
            self._feeder = None


def require_stable(ctrl: Controller, plant: RobotPlant, q: Float64Array, values: Mapping[str, Any] = {}) -> None:
    """RangeError for a sampled loop that is known to be unstable at q, with these values of its parameters.

    Of a task each phase is judged, as if it began there.
    """
    ctrl.side.require_gains(q, {**ctrl.parameters, **values}, plant.gains)
    for k, phase in enumerate(("",) if ctrl.side.task is None else ctrl.side.task.names):
        verdict = judge_start(ctrl, plant, q, values, phase=k)
        if isinstance(verdict, Judgement) and not verdict.stable:
            where = f"in phase '{phase}' " if phase else ""
            raise RangeError(f"{where}{verdict.message} (nothing was sent to {plant.name})", name="law")


def freed(link: Link, log: LogProcess | None, acting: list[Acting]) -> None:
    """End the processes and free the memory of a robot; not in a child of the program that made it."""
    with uninterrupted():
        if link.close():
            if log is not None:
                log.close()
            for one in acting:
                one.close()
