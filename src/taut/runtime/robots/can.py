"""CanDriver: an arm of MIT-type motors on a CAN bus, by the frames that Damiao publishes for its motors.

References:
    Katz, A low cost modular actuator for dynamic robots, MIT (2018): the frame of five numbers.
    Damiao, manuals of its motors; Enactic, openarm_can (2025): identifiers, registers, ranges.
    Davis, Burns, Bril, Lukkien, Controller area network schedulability analysis (2007), equation 1: stuff bits.
    ISO 11898-1 (2015): CAN FD.
"""

from __future__ import annotations

import contextlib
import math
import struct
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.arm.description import Arm
from taut.base.errors import MatchError, RangeError, ShapeError, missing_extra, unknown_name
from taut.base.fields import Declared, Field, Plain
from taut.base.types import Float64Array
from taut.control.safety import SafetyLimits
from taut.runtime.robots.driver import DriverError, RobotDriver, RobotInfo

RANGES: Final[Mapping[str, tuple[float, float, float]]] = {  # p_max [rad], v_max [rad/s], t_max [N m]
    "DM3507": (12.5, 50.0, 5.0),
    "DM4310": (12.5, 30.0, 10.0),
    "DM4310_48V": (12.5, 50.0, 10.0),
    "DM4340": (12.5, 10.0, 28.0),
    "DM6006": (12.5, 45.0, 20.0),
    "DM8006": (12.5, 45.0, 40.0),
    "DM8009": (12.5, 45.0, 54.0),
    "DM10010": (12.5, 20.0, 200.0),
    "DM10010L": (12.5, 25.0, 200.0),
}
RANGE_REGISTERS: Final = {"PMAX": 21, "VMAX": 22, "TMAX": 23}
ROW_NAMES: Final = ("q", "v", "kp", "kd", "tau")
TOP_CODES: Final = np.array([[0xFFFF], [0xFFF], [0xFFF], [0xFFF], [0xFFF]])
MOTOR_GAINS: Final = (500.0, 5.0)  # [N m/rad], [N m s/rad] the largest kp and kd of a frame, of every type
HOLD: Final = (1.0, 0.05)  # [1/rad], [s/rad] kp and kd over t_max with which a motor holds by itself
HOLD_AVERAGE: Final = 0.1  # [s] over which it takes its torque: that of one tick has the steps of the velocity in it
CLASSIC_BITS: Final = (98 + 97 // 4 + 13, 0)  # of a frame of eight bytes, at most: the stuffed part, and the end
FD_BITS: Final = (17 + 4 + 13, 69 + 17 + 21 + 6)  # the same of CAN FD, in the arbitration and in the data phase
BROADCAST: Final = 0x7FF  # registers, and requests for a state
ENABLE, DISABLE, CLEAR = (b"\xff" * 7 + bytes([last]) for last in (0xFC, 0xFD, 0xFB))
READ_REGISTER, WRITE_REGISTER, REFRESH = 0x33, 0x55, 0xCC
TIMEOUT_REGISTER, MODE_REGISTER = 9, 10
TIMEOUT_UNIT: Final = 50e-6  # [s]
LEAST_PERIODS: Final = 3.0  # [periods] of a motor, at least, that waits for a command
MIT_MODE: Final = 1
ENABLED: Final = 1
CAUSES: Final = {
    0x0: "disabled", 0x8: "overvoltage", 0x9: "undervoltage", 0xA: "overcurrent", 0xB: "MOSFETs too hot",
    0xC: "coils too hot", 0xD: "communication lost", 0xE: "overload",
}  # fmt: skip
ANSWER: Final = 0.1  # [s] for the answer to a request, and for frames of another program
ATTEMPTS: Final = 3  # of a request
REST_STEPS: Final = 1.5  # steps of the velocity field that a motor at rest may show


class CanMotors(Declared):
    """The MIT-type motors of an arm on one CAN bus, a value for each joint, and the bus.

    Law:          tau(t) = kp (p - p(t)) + kd (v - v(t)) + tau in each motor, at its own rate
    Frames:       q = offset + sign p, v and tau likewise, of a joint and its motor

    Args:
        types: Of the motors: DM4310, DM4340, DM8009, ...
        id: CAN identifiers of commands; 1, 2, ... if left out.
        master_id: CAN identifiers of replies; id + 0x10 if left out.
        sign: 1, or -1 for a motor that turns against its joint.
        offset: Position of the joint where the motor reads zero [rad].
        ranges: (n, 3) of position [rad], velocity [rad/s] and torque [N m] in a frame, if they are not the types':
            settings of the motors, which are read and compared when the arm is connected.
        bitrate: Of the bus, in the arbitration phase [bit/s].
        data_bitrate: Of the data phase of CAN FD [bit/s]; classic frames if left out.
        rate: Of commands and states [Hz]; one period in the shortest whole number of milliseconds if left out.
        timeout: Time without commands after which a motor disables itself while the arm is controlled [s].
        missed: Replies of a motor missing in a row that end the motion.
        interface: Adapter, by python-can's name: socketcan, pcan, slcan, ...

    Raises:
        UnknownNameError, ShapeError: A type that is unknown; not a value for each motor.
        RangeError: A rate that the bus cannot keep; two motors with one identifier.

    Example:
        >>> motors = CanMotors(types=["DM8009", "DM8009", "DM4340", "DM4340", "DM4310", "DM4310", "DM4310"])
        >>> round(1e3 * motors.exchange, 2), motors.control_rate, round(motors.bus_load, 3)
        (1.89, 500.0, 0.945)
    """

    types: Plain[tuple[str, ...]] = Plain(convert=tuple)
    id: Field = Field(shape="n", minimum=1.0, maximum=0x7FE, optional=True, run_time=False)
    master_id: Field = Field(shape="n", minimum=1.0, maximum=0x7FE, optional=True, run_time=False)
    sign: Field = Field(1.0, shape="n", minimum=-1.0, maximum=1.0, run_time=False)
    offset: Field = Field(0.0, unit="rad", shape="n", run_time=False)
    ranges: Field = Field(shape=("n", 3), above=0.0, optional=True, run_time=False)
    bitrate: Field = Field(1e6, unit="bit/s", above=0.0, run_time=False)
    data_bitrate: Field = Field(unit="bit/s", above=0.0, optional=True, run_time=False)
    rate: Field = Field(unit="Hz", above=0.0, optional=True, run_time=False)
    timeout: Field = Field(0.1, unit="s", above=0.0, maximum=TIMEOUT_UNIT * 0xFFFFFFFF, run_time=False)
    missed: Field = Field(20.0, minimum=1.0, run_time=False)
    interface: str = "socketcan"

    def check(self) -> None:
        if not self.n:
            self.refuse("types", "must name the type of each motor, at least one", ShapeError)
        for name in self.types:
            if name not in RANGES:
                raise unknown_name("CanMotors", "type of motor", name, RANGES)
        self.check_size(self.n)
        if self.ranges is not None and len(self.ranges) != self.n:
            self.refuse("ranges", f"must have shape ({self.n}, 3); got {np.shape(self.ranges)}", ShapeError)
        if not np.all(np.abs(self.sign) == 1.0):
            self.refuse("sign", f"must be 1 or -1 for each joint; got {np.asarray(self.sign).tolist()}", RangeError)
        if len({*self.ids}) < self.n or len(self.replies) < self.n:
            self.refuse("id", "and master_id must differ from motor to motor, as 1, 2, ... do", RangeError)
        if both := {*self.ids} & {reply for reply, _ in self.replies}:
            self.refuse("id", f"and master_id must differ: replies at {min(both):#x} command a motor", RangeError)
        if self.data_bitrate is not None and not self.data_bitrate >= self.bitrate:
            self.refuse(
                "data_bitrate", f"must be >= bitrate, {self.bitrate:g}; got {self.data_bitrate:g}", RangeError
            )
        if self.bus_load > 1.0:
            self.refuse(
                "rate",
                f"must be <= {1.0 / self.exchange:.0f} Hz: a command and a reply of {self.n} motors take "
                f"{1e3 * self.exchange:.3g} ms on this bus; got {self.control_rate:g} Hz, a bus load of "
                f"{100.0 * self.bus_load:.0f} %", RangeError,
            )  # fmt: skip
        if self.timeout * self.control_rate < LEAST_PERIODS:
            self.refuse(
                "timeout",
                f"must be >= {LEAST_PERIODS / self.control_rate:.3g} s, {LEAST_PERIODS:g} periods, or motors give up "
                f"between commands; got {self.timeout:g}", RangeError,
            )  # fmt: skip

    @property
    def n(self) -> int:
        """Number of motors."""
        return len(self.types)

    @property
    def exchange(self) -> float:
        """Time of a command and a reply of each motor on the bus [s], with the most stuff bits."""
        arbitration, data = CLASSIC_BITS if self.data_bitrate is None else FD_BITS
        return 2.0 * self.n * float(arbitration / self.bitrate + data / (self.data_bitrate or math.inf))

    @property
    def control_rate(self) -> float:
        """Of commands and states [Hz]."""
        return float(self.rate or 1e3 / math.ceil(1e3 * self.exchange))

    @property
    def bus_load(self) -> float:
        """Fraction of the time in which the bus is busy, at most."""
        return self.exchange * self.control_rate

    @property
    def ids(self) -> list[int]:
        """CAN identifiers of commands."""
        return [int(x) for x in (np.arange(1, self.n + 1) if self.id is None else self.per_joint("id"))]

    @property
    def replies(self) -> dict[tuple[int, int], int]:
        """The motor of a reply, by CAN identifier and the four bits of its own in it."""
        given = np.add(self.ids, 0x10) if self.master_id is None else self.per_joint("master_id")
        return {(int(reply), own & 0xF): i for i, (own, reply) in enumerate(zip(self.ids, given, strict=True))}

    def per_joint(self, name: str) -> Float64Array:
        """(n,) a field."""
        return np.broadcast_to(np.asarray(getattr(self, name), dtype=np.float64), (self.n,))

    @cached_property
    def highest(self) -> Float64Array:
        """(5, n) largest q, v, kp, kd, tau of a frame."""
        p, v, t = np.array([RANGES[kind] for kind in self.types] if self.ranges is None else self.ranges).T
        kp, kd = (np.full(self.n, gain) for gain in MOTOR_GAINS)
        return np.array([p, v, kp, kd, t])

    @cached_property
    def lowest(self) -> Float64Array:
        """(5, n) smallest q, v, kp, kd, tau of a frame."""
        least: Float64Array = self.highest * np.array([[-1.0], [-1.0], [0.0], [0.0], [-1.0]])
        return least

    @cached_property
    def steps(self) -> Float64Array:
        """(5, n) resolution of q, v, kp, kd, tau."""
        resolution: Float64Array = (self.highest - self.lowest) / TOP_CODES
        return resolution

    def encoded(self, command: Float64Array) -> tuple[list[bytes], NDArray[np.int64]]:
        """Frames of a command (5, n) of the motors; without frames, (k, 2) row and motor of what is out of range.

        16 bits of q, then 12 each of v, kp, kd, tau. What rounding q and v changes of the torque is made good in tau.
        """
        exact = (command - self.lowest) / self.steps
        outside = np.argwhere(~((exact >= -0.5) & (exact <= TOP_CODES + 0.5)))
        if len(outside):
            return [], outside
        codes = np.rint(np.clip(exact, 0, TOP_CODES)).astype(np.int64)
        change = command - (self.lowest + codes * self.steps)
        kp, kd = codes[2:4] * self.steps[2:4]
        exact[4] += (kp * change[0] + kd * change[1]) / self.steps[4]
        codes[4] = np.rint(np.clip(exact[4], 0, TOP_CODES[4]))
        words = (q << 48 | v << 36 | kp << 24 | kd << 12 | tau for q, v, kp, kd, tau in codes.T.tolist())
        return [word.to_bytes(8, "big") for word in words], outside

    def options(self, arm: Arm, limits: SafetyLimits) -> dict[str, Any]:
        """What the driver is given; MatchError or RangeError where arm, limits and motors do not fit."""
        if arm.n != self.n:
            raise MatchError(f"arm '{arm.name}' has {arm.n} joints and motors has {self.n} types", name="motors")
        sign, offset = self.per_joint("sign"), self.per_joint("offset")
        for name, row in {"tau": 4, "v": 1, "lower": 0, "upper": 0}.items():
            given = getattr(limits, name)
            limit = np.broadcast_to(math.inf if given is None else given, (self.n,))
            at_motor = limit if row else sign * (limit - offset)
            for i in np.flatnonzero(~(np.abs(at_motor) <= self.highest[row])):
                there = f" ({at_motor[i]:g} at the motor)" if row == 0 else ""
                raise RangeError(
                    f"limits.{name} of joint '{arm.joint_names[i]}' must be in the range of its motor, a "
                    f"{self.types[i]} with +-{self.highest[row, i]:g}; got {limit[i]:g}{there}; "
                    f"state {name} in [limits] of a robot file, or limits=taut.SafetyLimits.of(arm, {name}=...)",
                    name=name, joint=arm.joint_names[i], value=float(limit[i]),
                )  # fmt: skip
        return {"motors": {name: getattr(self, name) for name in self.specified}, "joints": arm.joint_names}


class CanDriver(RobotDriver):
    """MIT-type motors on a CAN bus: `taut.connect("can://can0", arm, motors=taut.robots.CanMotors(...))`.

    In each period each motor gets a command and replies with its state in that instant: a command acts on what was
    measured a period before. While the arm is not controlled, the motors are only asked for their states. After
    `end` each motor holds where it is, by its own gains and the torque of its last 0.1 s, until it is disabled.

    Args:
        address: python-can's channel: can0, /dev/ttyACM0, ...
        motors: Fields of CanMotors.
        joints: Names, for messages.
    """

    def __init__(self, address: str, *, motors: Mapping[str, Any], joints: Sequence[str]) -> None:
        self._address, self._joints, self._motors = address, tuple(joints), CanMotors(**motors)
        self._n, self._ids, self._replies = (m := self._motors).n, m.ids, m.replies
        self._bus: Any = None
        self._codes = np.zeros((3, m.n), dtype=np.int64)  # of position, velocity and torque
        self._status, self._hot = [0] * m.n, [(0, 0)] * m.n  # temperatures [degree C] of MOSFETs and coils
        self._fresh, self._age, self._lost = np.zeros(m.n, dtype=bool), np.zeros(m.n), np.zeros(m.n, dtype=np.int64)
        self._values: dict[tuple[int, int], bytes] = {}  # by motor and register
        self._tau, self._count = np.zeros(m.n), 0  # of the motors, averaged over the last commands; their number
        self._idle = [(BROADCAST, self._request(i, REFRESH)) for i in range(m.n)]  # what is sent without control
        self._controls = self._begun = self._holds = False
        self._strangers, self._error_frames, self._others = set[int](), 0, -1  # the motor that others command
        self._sign, self._offset = m.per_joint("sign"), m.per_joint("offset")

    def open(self) -> RobotInfo:
        try:
            import can
        except ImportError as cause:
            raise missing_extra("can://", "python-can", "can") from cause
        self._can, m = can, self._motors
        fd: dict[str, Any] = {} if m.data_bitrate is None else {"fd": True, "data_bitrate": int(m.data_bitrate)}
        self._kind = {"is_extended_id": False, "is_fd": bool(fd), "bitrate_switch": bool(fd)}
        opened = partial(can.Bus, channel=self._address, interface=m.interface, bitrate=int(m.bitrate), **fd)
        self._bus = self._on_bus(opened)
        self._listen(time.monotonic() + ANSWER)
        self._require_alone()
        for (name, register), ours in zip(RANGE_REGISTERS.items(), m.highest[[0, 1, 4]], strict=True):
            own = self._register(register, "<f")
            self._require(
                np.abs(own - ours) < 1e-3 * ours,
                f"{name} is {own.tolist()} in register {register}, and motors has {ours.tolist()}; state ranges= as "
                "they are, or set the register", "rejected",
            )  # fmt: skip
        mode = self._register(MODE_REGISTER) == MIT_MODE
        self._require(mode, f"not in MIT mode; set register {MODE_REGISTER} to {MIT_MODE}", "rejected")
        self._timeouts = self._register(TIMEOUT_REGISTER)
        self._ask_states()
        names = zip(self._joints, self._status, strict=True)
        errors = [f"'{joint}': {_cause(status)}" for joint, status in names if status not in (0, ENABLED)]
        return RobotInfo(
            name=f"CAN arm at {self._address}", n=m.n, rate=m.control_rate, takes="mit", measures=("v", "tau_meas"),
            silence=float(m.timeout), delay=1.0 / m.control_rate, at_rest=REST_STEPS * float(m.steps[1].max()),
            holds=False, joint_names=self._joints, gains=MOTOR_GAINS, facts={"errors": ", ".join(errors)},
        )  # fmt: skip

    def read(self, measured: Mapping[str, Float64Array]) -> None:
        self._listen()
        if not self._controls:
            self._send(self._idle)
        self._lost += ~self._fresh
        self._age = np.where(self._fresh, 0, self._age + 1)
        self._fresh[:] = False
        self._require_alone()
        if self._holds:
            self._require_status(ENABLED)
        self._require(self._age < self._motors.missed, f"no reply for {self._age.max():g} periods", "silent")
        # Motors cut a value off to its step, of which the middle is the best estimate: zero is read at rest.
        values = self._motors.lowest[[0, 1, 4]] + (self._codes + 0.5) * self._motors.steps[[0, 1, 4]]
        for name, value in zip(("q", "v", "tau_meas"), self._sign * values, strict=True):
            measured[name][:] = value
        measured["q"] += self._offset

    def begin(self) -> None:
        self._ask_states()
        self._require_status(0, ENABLED)
        self._register(TIMEOUT_REGISTER, write=np.full(self._n, self._motors.timeout / TIMEOUT_UNIT))
        self._begun = True
        self._tau = (self._motors.lowest[4] + (self._codes[2] + 0.5) * self._motors.steps[4]).astype(np.float64)
        self._hold()  # in place of whatever command a motor had before; one that holds keeps its torque
        self._send([*((own, ENABLE) for own in self._ids), *self._idle])
        self._wait(lambda: all(self._status))
        self._require_status(ENABLED)
        self._controls, self._holds, self._age[:], self._count = True, True, 0, 0

    def write(self, command: Float64Array) -> None:
        motor = command.copy()
        motor[0] -= self._offset
        motor[[0, 1, 4]] *= self._sign
        frames, outside = self._motors.encoded(motor)
        for row, i in outside:
            low, high = self._motors.lowest[row, i], self._motors.highest[row, i]
            reason = f"{ROW_NAMES[row]} = {motor[row, i]:g} is out of its range, {low:g} to {high:g}"
            self._require(np.arange(self._n) != i, reason, "rejected")
        self._count = min(self._count + 1, math.ceil(HOLD_AVERAGE * self._motors.control_rate))
        self._tau += (motor[4] - self._tau) / self._count
        self._send(zip(self._ids, frames, strict=True))

    def end(self) -> None:
        self._controls = False
        self._hold()
        requests = (self._request(i, WRITE_REGISTER, TIMEOUT_REGISTER, t) for i, t in enumerate(self._timeouts))
        self._send((BROADCAST, request) for request in requests)

    def recover(self) -> None:
        self._ask_states()
        self._send([(own, CLEAR) for own, status in zip(self._ids, self._status, strict=True) if status > ENABLED])
        self._age[:], self._others = 0, -1
        self._ask_states()
        self._require_status(0, ENABLED)
        self._require_alone()
        self._holds = all(self._status)

    def call(self, name: str, arguments: Mapping[str, Any]) -> Any:
        """`hold`: enable them; `enabled`; `motors`: status, temperatures [degree C], lost replies; error frames."""
        if name == "enabled":
            return ENABLED in self._status
        if name == "hold":
            if not self._controls:
                self.begin()
                self.end()
        elif name != "motors":
            return super().call(name, arguments)
        rows = zip(self._joints, self._status, self._hot, self._lost.tolist(), strict=True)
        joints = {j: {"status": s, "t_mos": hot[0], "t_coil": hot[1], "lost": k} for j, s, hot, k in rows}
        return {**joints, "error_frames": self._error_frames}

    def close(self) -> None:
        if self._bus is not None:
            with contextlib.suppress(DriverError):
                self._send([(own, DISABLE) for own in self._ids if self._begun])
            self._bus.shutdown()

    def _hold(self) -> None:
        """Let each motor hold where it is; one that is disabled, when it is enabled, and without more torque."""
        m = self._motors
        q = m.lowest[0] + (self._codes[0] + 0.5) * m.steps[0]
        tau = np.where(np.equal(self._status, ENABLED), self._tau, 0.0)
        kp, kd = (np.minimum(factor * m.highest[4], most) for factor, most in zip(HOLD, MOTOR_GAINS, strict=True))
        self._idle = [*zip(self._ids, m.encoded(np.array([q, 0.0 * q, kp, kd, tau]))[0], strict=True)]
        self._send(self._idle)

    def _on_bus(self, act: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return act(*arguments)
        except (self._can.CanError, OSError, ValueError, NotImplementedError) as cause:
            reason = f"the CAN bus at {self._address} ({self._motors.interface}) failed: {cause}"
            raise DriverError(reason, kind="disconnected") from cause

    def _send(self, frames: Iterable[tuple[int, bytes]]) -> None:
        for own, data in frames:
            self._on_bus(self._bus.send, self._can.Message(arbitration_id=own, data=data, **self._kind))

    def _listen(self, until: float = 0.0) -> None:
        """Take the frames that have arrived, and those that arrive until a time; the newest state is kept."""
        while (message := self._on_bus(self._bus.recv, max(0.0, until - time.monotonic()))) is not None:
            data = bytes(message.data)
            if message.is_error_frame or len(data) < 8:
                self._error_frames += 1
                continue
            if message.arbitration_id in self._ids:
                self._others = self._ids.index(message.arbitration_id)
                continue
            i = self._replies.get((message.arbitration_id, data[0] & 0xF))
            if i is None:
                self._strangers.add(message.arbitration_id)
            elif data[:2] == self._ids[i].to_bytes(2, "little") and data[2] in (READ_REGISTER, WRITE_REGISTER):
                self._values[i, data[3]] = data[4:]
            else:
                word = int.from_bytes(data, "big")
                self._codes[:, i] = word >> 40 & 0xFFFF, word >> 28 & 0xFFF, word >> 16 & 0xFFF
                self._status[i], self._hot[i], self._fresh[i] = data[0] >> 4, (data[6], data[7]), True

    def _wait(self, done: Callable[[], Any]) -> None:
        """Listen until something is so, or an answer would have come."""
        until = time.monotonic() + ANSWER
        while not done() and time.monotonic() < until:
            self._listen(time.monotonic() + 1e-3)

    def _ask(self, request: Callable[[int], bytes], answered: Callable[[], NDArray[np.bool_]], what: str) -> None:
        """Send requests until each motor has answered."""
        for _ in range(ATTEMPTS):
            self._send([(BROADCAST, request(int(i))) for i in np.flatnonzero(~answered())])
            self._wait(lambda: answered().all())
        self._require(answered(), f"no answer{what}", "silent")

    def _ask_states(self) -> None:
        self._fresh[:] = False
        self._ask(lambda i: self._request(i, REFRESH), lambda: self._fresh, "")

    def _register(self, register: int, form: str = "<I", write: Float64Array | None = None) -> Float64Array:
        """(n,) a register of each motor, after it was written if `write` is given."""
        self._values.clear()
        kind, given = (READ_REGISTER, np.zeros(self._n)) if write is None else (WRITE_REGISTER, write)
        self._ask(
            lambda i: self._request(i, kind, register, given[i]),
            lambda: np.array([(i, register) in self._values for i in range(self._n)]), f" about register {register}",
        )  # fmt: skip
        return np.array([struct.unpack(form, self._values[i, register])[0] for i in range(self._n)])

    def _request(self, i: int, kind: int, register: int = 0, value: float = 0.0) -> bytes:
        return struct.pack("<HBBI", self._ids[i], kind, register, round(value))

    def _require_alone(self) -> None:
        self._require(np.arange(self._n) != self._others, "another program commands it; end that first", "busy")

    def _require_status(self, *allowed: int) -> None:
        good = np.array([status in allowed for status in self._status])
        causes = [_cause(status) for status in self._status if status not in allowed]
        self._require(good, ", ".join(causes), "robot_error")

    def _require(self, good: NDArray[np.bool_], what: str, kind: str) -> None:
        """DriverError that names the joints and motors of which something is not so."""
        if not good.all():
            names = [f"'{j}' (0x{own:02X}, replies 0x{reply:02X})"
                     for j, own, (reply, _) in zip(self._joints, self._ids, self._replies, strict=True)]  # fmt: skip
            which = np.flatnonzero(~good)
            who, first = ", ".join(names[i] for i in which), self._joints[which[0]]
            others = f"; others here reply by {', '.join(map(hex, self._strangers))}" * bool(self._strangers)
            raise DriverError(f"motor of {who}: {what}{others if kind == 'silent' else ''}", kind=kind, joint=first)


def _cause(status: int) -> str:
    """Why a motor of that status is not enabled."""
    return CAUSES.get(status, f"error 0x{status:X}")
