"""A simulated arm of MIT-type motors at the other end of a CAN bus, in a process of its own.

Its motors decode the published frames by code of their own, run kp and kd at their own rate over a RigidPlant, and
reply. Time goes with the frames: a burst of frames begins a period of the host, however late it comes, so that nothing
depends on the machine's speed. The bus needs its time for each frame; commands win over replies, as by their ids.

`python can_arm.py ARM RATE` prints the channel, then answers each line of JSON with one.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import struct
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

import taut
import taut.robots

HERE: Final = Path(__file__).parent
INNER: Final = 4000.0  # [Hz] of the loop in the motors
FRAME: Final = 135e-6  # [s] on a bus of 1 Mbit/s, with the most stuff bits
FD_FRAME: Final = 34e-6 + 113e-6 / 5.0  # [s] likewise of CAN FD, with a data phase of 5 Mbit/s
KP, KD = 500.0, 5.0
DISABLED, ENABLED, LOST = 0, 1, 0xD
NEVER: Final = 1_000_000
# p_max, v_max, t_max, gear ratio, rotor inertia [kg m^2], as published
MOTORS: Final = {
    "DM8009": (12.5, 45.0, 54.0, 9.0, 1.95e-4),
    "DM4340": (12.5, 10.0, 28.0, 40.0, 2.0e-5),
    "DM4310": (12.5, 30.0, 10.0, 10.0, 1.8e-5),
}
TYPES: Final = {
    "planar2": ["DM8009", "DM4340"],
    "seven": ["DM8009", "DM8009", "DM4340", "DM4340", "DM4310", "DM4310", "DM4310"],
}
SIGNS: Final = {"planar2": [1.0, -1.0], "seven": [1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0]}
OFFSETS: Final = {"planar2": [0.3, -1.2], "seven": [0.0, 0.1, -0.4, 1.0, 0.0, 0.2, -0.1]}

ROBOT: Final = """
robot = "can://{channel}"

[motors]
types = ["DM8009", "DM4340"]
sign = {sign}
offset = [0.3, -1.2]
rate = 500
interface = "loopback"
missed = 250

[limits]
missed = 250
v = 3.0
"""
SCENARIO: Final = """
title = "Two joints move on the bus"
run = { duration = 1.0 }
reference = { kind = "set-point", q = [0.55, 1.55] }
outputs = { log = "reach.mcap" }

[arm]
model = "planar2"
joint_values = { effort = [50.0, 25.0], velocity = 6.0, lower = [-2.0, 0.0], upper = [2.0, 2.5] }
gears = { ratio = [9.0, 40.0], motor_inertia = [1.95e-4, 2e-5] }

[laws.pd]
law = "GravityPID"
kp = [80.0, 40.0]
kd = [4.0, 2.0]
wrapped_by = { law = "ViaMit" }

[plant]
takes = "mit"
"""


def load(name: str) -> taut.Arm:
    """One of the two arms, with the rotors of its motors."""
    if name == "seven":
        arm = taut.load_arm(HERE / "seven.urdf", tool="link7", home=[0.2, 0.7, -0.1, 1.1, 0.1, -0.3, 0.2])
    else:
        arm = taut.load_arm(name).with_joints(
            effort=[50.0, 25.0], velocity=6.0, lower=[-2.0, 0.0], upper=[2.0, 2.5], viscous=0.05
        )
    _, _, _, ratio, inertia = np.transpose([MOTORS[kind] for kind in TYPES[name]])
    return arm.with_gears(ratio=ratio, motor_inertia=inertia)


def motors(name: str, **more: Any) -> taut.robots.CanMotors:
    """What the host is given for it."""
    given = {"types": TYPES[name], "sign": SIGNS[name], "offset": OFFSETS[name], "interface": "loopback"}
    return taut.robots.CanMotors(**{**given, **more})


class Plant:
    """The arm with its motors' loops, in native code, a tick of INNER at a time."""

    def __init__(self, arm: taut.Arm) -> None:
        plant, dt = taut.RigidPlant(arm, takes="mit"), 1.0 / INNER
        values = plant.parameters
        start = {
            path: np.asarray(x, dtype=np.float64)
            for path, x in plant.start(arm.home, 0.0 * arm.home, values, dt).items()
        }
        ends = np.cumsum([0, *(x.size for x in start.values())])
        self._places = {path: slice(ends[i], ends[i + 1]) for i, path in enumerate(start)}
        self._start = np.concatenate([x.ravel() for x in start.values()])

        def tick(state: Any, command: Any) -> Any:
            memory = {path: state[self._places[path]].reshape(x.shape) for path, x in start.items()}
            after = plant.advance(plant.command(command, memory, 0.0), values, dt)
            return taut.math.array([number for path in start for number in np.ravel(taut.math.array(after[path]))])

        self._tick = taut.native(tick, state=len(self._start), command=(5, arm.n))
        self.command = np.zeros((5, arm.n))
        self.reset()

    def reset(self) -> None:
        self._state = self._start.copy()

    def advance(self, ticks: int) -> None:
        for _ in range(ticks):
            self._state = self._tick(self._state, self.command)

    @property
    def q(self) -> Any:
        return self._state[self._places["q"]]

    @property
    def v(self) -> Any:
        return self._state[self._places["v"]]


class Motor:
    """What one motor knows: five numbers of the last command, its registers, its status."""

    def __init__(self, own: int, reply: int, kind: str, sign: float, offset: float) -> None:
        self.own, self.reply, self.sign, self.offset = own, reply, sign, offset
        p, v, t, *_ = MOTORS[kind]
        self.registers: dict[int, float] = {7: reply, 8: own, 9: 0, 10: 1, 21: p, 22: v, 23: t}
        self.status, self.commands = DISABLED, 0
        # Of whatever was sent before: a spring of 300 N m/rad to 1 rad, which must not act when it is enabled.
        self.command = np.array([1.0, 0.0, 300.0, 1.0, 0.0])

    def take(self, data: bytes) -> None:
        """A frame to its id."""
        if data[:7] == b"\xff" * 7 and data[7] >= 0xFB:
            if data[7] == 0xFC and self.status == DISABLED:
                self.status = ENABLED
            elif data[7] == 0xFB or (data[7] == 0xFD and self.status == ENABLED):
                self.status = DISABLED
            return
        p, v, t = (self.registers[i] for i in (21, 22, 23))
        fields = (
            (data[0] << 8 | data[1], 16, -p, p),
            (data[2] << 4 | data[3] >> 4, 12, -v, v),
            ((data[3] & 15) << 8 | data[4], 12, 0.0, KP),
            (data[5] << 4 | data[6] >> 4, 12, 0.0, KD),
            ((data[6] & 15) << 8 | data[7], 12, -t, t),
        )
        self.command = np.array([code / (2**bits - 1) * (high - low) + low for code, bits, low, high in fields])
        self.commands += 1

    def acting(self) -> Any:
        """(5,) its command as the joint sees it."""
        if self.status != ENABLED:
            return np.zeros(5)
        q, v, kp, kd, tau = self.command
        return np.array([self.offset + self.sign * q, self.sign * v, kp, kd, self.sign * tau])

    def state(self, q: float, v: float, status: int, reversed_speed: bool) -> bytes:
        """Its reply; fields are cut off, as published, not rounded."""
        p_max, v_max, t_max = (self.registers[i] for i in (21, 22, 23))
        command = self.acting()
        tau = command[2] * (command[0] - q) + command[3] * (command[1] - v) + command[4]
        values = (
            (self.sign * (q - self.offset), p_max, 16),
            (self.sign * v, v_max, 12),
            (self.sign * tau, t_max, 12),
        )
        codes = [int((min(max(x, -m), m) + m) * (2**bits - 1) / (2.0 * m)) for x, m, bits in values]
        if reversed_speed:
            codes[1] = 4095 - codes[1]
        position, speed, torque = codes
        return bytes([self.own & 15 | status << 4, position >> 8, position & 255, speed >> 4,
                      (speed & 15) << 4 | torque >> 8, torque & 255, 31, 42])  # fmt: skip


class Arm:
    """All motors of an arm, and the bus."""

    def __init__(self, name: str, rate: float, ids: list[int], replies: list[int]) -> None:
        import can
        from loopback_can import LoopbackBus

        self.can, self.bus = can, LoopbackBus.waiting()
        self.arm = load(name)
        self.plant = Plant(self.arm)
        self.rows = list(zip(ids, replies, TYPES[name], SIGNS[name], OFFSETS[name], strict=True))
        self.period = 1.0 / rate
        self.rules: list[list[Any]] = []  # kind, joint, first period, number of periods, and what the kind needs
        self.start, self.ticks, self.frame = 0.0, 0, FRAME
        self.reset()

    def reset(self) -> None:
        """As after it was switched on, at its home pose; time goes on."""
        self.motors = [Motor(*row) for row in self.rows]
        self.late: list[tuple[float, Any]] = []
        self.due = [0.0] * len(self.motors)
        self.free, self.k, self.last = self.start, 0, NEVER
        self.plant.reset()

    def rule(self, kind: str, joint: int) -> Any:
        """What a rule of this kind states for this joint in this period, or None."""
        for name, which, first, count, *more in self.rules:
            if name == kind and which in (joint, -1) and first <= self.k < first + count:
                return more[0] if more else True
        return None

    def until(self, t: float) -> None:
        """The plant, and the motors' loops, until a time; an arm whose motors are all disabled stands on its support."""
        ticks = round(t * INNER) - self.ticks
        if ticks > 0:
            self.ticks += ticks
            if any(motor.status == ENABLED for motor in self.motors):
                self.plant.command[:] = np.array([motor.acting() for motor in self.motors]).T
                self.plant.advance(ticks)

    def send(self, own: int, data: bytes, due: float = 0.0) -> None:
        message = self.can.Message(arbitration_id=own, data=data, is_extended_id=False)
        if due <= self.start + self.period:
            self.bus.send(message)
        else:
            self.late.append((due, message))

    def burst(self, i: int) -> None:
        """A frame for motor i: the first of a period, where the one before had another motor behind it."""
        if i <= self.last and self.last != NEVER:
            n = len(self.motors)
            self.free = max(self.free, self.start) + 2 * n * self.frame
            self.start, self.k = self.start + self.period, self.k + 1
            self.until(self.start)
            now = [message for due, message in self.late if due <= self.start + self.period]
            self.late = [(due, message) for due, message in self.late if due > self.start + self.period]
            for message in now:
                self.bus.send(message)
            if self.rule("error_frame", -1):
                self.bus.send(self.can.Message(arbitration_id=4, is_error_frame=True, dlc=8, data=bytes(8)))
            if self.rule("stranger", -1):
                self.bus.send(self.can.Message(arbitration_id=0x123, data=bytes(8), is_extended_id=False))
        self.last = i

    def take(self, message: Any) -> None:
        own, data, self.frame = message.arbitration_id, bytes(message.data), FD_FRAME if message.is_fd else FRAME
        asks = own == 0x7FF
        target = data[0] | data[1] << 8 if asks else own
        found = [i for i, motor in enumerate(self.motors) if motor.own == target]
        if not found:
            return
        i, motor = found[0], self.motors[found[0]]
        if asks and data[2] in (0x33, 0x55):
            form = "<f" if data[3] in (21, 22, 23) else "<I"
            if data[2] == 0x55:
                motor.registers[data[3]] = struct.unpack(form, data[4:])[0]
            value = motor.registers[data[3]]
            if not self.rule("mute", i):
                self.send(motor.reply, data[:4] + struct.pack(form, value if form == "<f" else int(value)))
            return
        self.burst(i)
        began, n = max(self.free, self.start), len(self.motors)
        self.until(began + (i + 1) * self.frame)
        if not asks and not self.rule("lose_command", i):
            motor.take(data)
        code = self.rule("error", i)
        if code is not None:
            motor.status = code
        if self.rule("lose_reply", i) or self.rule("mute", i):
            return
        due = began + (n + i + 1) * self.frame + self.period * (self.rule("late", i) or 0)
        self.due[i] = due = max(due, self.due[i])  # frames of one motor stay in order
        q, v = self.plant.q[i], self.plant.v[i]
        if not any(motor.status == ENABLED for motor in self.motors):
            v = 0.0
        raw = self.rule("raw", i)
        state = motor.state(q, v, motor.status, bool(self.rule("reversed", i))) if raw is None else bytes(raw)
        self.send(motor.reply, state, due)

    def silence(self, wait: float) -> None:
        """Time without frames, by the wall's clock: motors that have a timeout disable themselves."""
        for motor in self.motors:
            if self.rule("watch", -1) and motor.status == ENABLED and 0 < motor.registers[9] * 50e-6 < wait:
                motor.status = LOST

    def answer(self, asked: dict[str, Any]) -> dict[str, Any]:
        if asked.get("reset"):
            self.reset()
        if "rules" in asked:
            self.rules, self.k = asked["rules"], 0
        for i, register, value in asked.get("registers", []):
            self.motors[i].registers[register] = value
        if "period" in asked:
            self.period = asked["period"]
        measured = {"q": self.plant.q.tolist(), "v": self.plant.v.tolist()}
        each = {"status": [motor.status for motor in self.motors], "commands": [m.commands for m in self.motors],
                "sent": [motor.acting().tolist() for motor in self.motors],
                "timeout": [motor.registers[9] for motor in self.motors]}  # fmt: skip
        return {**measured, **each, "k": self.k, "late": len(self.late)}

    def run(self) -> None:
        """Until standard input is closed."""
        quiet = 0.0
        while True:
            ready, _, _ = select.select([self.bus.socket, sys.stdin], [], [], 0.02)
            quiet = 0.0 if self.bus.socket in ready else quiet + 0.02 * (not ready)
            self.silence(quiet)
            while (message := self.bus.recv(0)) is not None:
                self.take(message)
            if sys.stdin in ready:
                line = sys.stdin.readline()
                if not line:
                    return
                print(json.dumps(self.answer(json.loads(line))), flush=True)


class CanArm:
    """The process, as a test sees it."""

    def __init__(
        self, name: str, rate: float = 500.0, ids: list[int] | None = None, replies: list[int] | None = None
    ) -> None:
        n = len(TYPES[name])
        ids = ids or list(range(1, n + 1))
        words = [name, str(rate), json.dumps(ids), json.dumps(replies or [i + 0x10 for i in ids])]
        paths = os.pathsep.join(path or str(Path.cwd()) for path in [str(HERE), *sys.path])
        self.process = subprocess.Popen(
            [sys.executable, "-W", "ignore", str(HERE / "can_arm.py"), *words],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": paths},
        )  # fmt: skip
        self.channel, self._alone = self._line().strip(), threading.Lock()
        self.arm, self.name, self.rate = load(name), name, rate

    def _line(self) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"the simulated arm ended with {self.process.wait()}")
        return line

    def __call__(self, **asked: Any) -> dict[str, Any]:
        """Tell it something: rules=[...], reset=True; what is true then."""
        assert self.process.stdin is not None
        with self._alone:
            self.process.stdin.write(json.dumps(asked) + "\n")
            self.process.stdin.flush()
            answer: dict[str, Any] = json.loads(self._line())
        return answer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait(5.0)
        self.process.stdout.close()


if __name__ == "__main__":
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(70))
    simulated = Arm(sys.argv[1], float(sys.argv[2]), json.loads(sys.argv[3]), json.loads(sys.argv[4]))
    print(simulated.bus.channel, flush=True)
    simulated.run()
    simulated.bus.shutdown()
