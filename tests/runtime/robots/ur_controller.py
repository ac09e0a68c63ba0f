"""A test server in place of a UR controller: the RTDE, script and dashboard ports, as far as ur_rtde's clients use them.

Messages are those of the vendor's RTDE guide. Of the control script that the client uploads, its command loop is played
here: the registers by which it takes servoj, speedj, direct_torque, stops and the watchdog, and answers.
"""

from __future__ import annotations

import json
import os
import selectors
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import taut

RATE, LIFE = 500.0, 120.0
VECTOR6, VECTOR3 = "VECTOR6D", "VECTOR3D"
TYPES = {VECTOR6: "6d", VECTOR3: "3d", "DOUBLE": "d", "UINT32": "I", "INT32": "i"}
OUTPUTS = {
    "timestamp": "DOUBLE", "actual_q": VECTOR6, "actual_qd": VECTOR6, "actual_TCP_force": VECTOR6,
    "actual_TCP_pose": VECTOR6, "robot_mode": "INT32", "runtime_state": "UINT32",
    "robot_status_bits": "UINT32", "safety_status_bits": "UINT32", "payload": "DOUBLE", "payload_cog": VECTOR3,
}  # fmt: skip
BASE = np.diag([-1.0, -1.0, 1.0])  # the controller's base in the URDF's base_link
SERVOJ, SPEEDJ, TORQUE, SPEED_STOP, SERVO_STOP, STOPJ, WATCHDOG, STOP_SCRIPT = 11, 9, 66, 15, 16, 34, 35, 255
REALTIME = (SERVOJ, SPEEDJ, TORQUE)


def type_of(name: str) -> str:
    if name.startswith(("output_int", "input_int")):
        return "INT32"
    if name.startswith(("output_double", "input_double")):
        return "DOUBLE"
    return VECTOR6 if name == "external_force_torque" else OUTPUTS.get(name, "NOT_FOUND")


class Controller:
    def __init__(self, given: dict[str, Any]) -> None:
        self.given = given
        self.arm = taut.load_arm(given["arm"])
        self.known = self.arm.with_payload(given.get("payload", 0.0))
        self.q, self.v = self.arm.home.copy(), np.zeros(6)
        self.plant = taut.MujocoPlant(self.known, adds=("gravity",))  # which direct_torque compensates
        self.plant.reset(self.q, self.v, 1.0 / RATE, 0)
        home = taut.snapshot(self.arm, self.q)
        self.push, pose = np.asarray(home.J()).T @ np.array(given.get("F_ext", [0.0] * 6)), home.T()
        rotation = Rotation.from_matrix(BASE @ np.asarray(pose.R)).as_rotvec()
        self.values = {"actual_TCP_pose": np.concatenate([BASE @ np.asarray(pose.p), rotation])}  # where it began
        self.registers: dict[str, float] = {}
        self.runtime, self.safety, self.ready, self.executing = 1, 1, 0, False
        self.move, self.watchdog, self.written, self.time = 0, 0.0, 0.0, 0.0
        self.outputs: dict[Any, Any] = {}
        self.inputs: dict[Any, list[list[str]]] = {}
        self.started: set[Any] = set()
        self.held: Any = None  # the client that has the input registers
        self.log: list[int] = []

    # The arm -----------------------------------------------------------------------------------------------------

    def doubles(self, first: int, count: int = 6) -> Any:
        return np.array([self.registers.get(f"input_double_register_{first + i}", 0.0) for i in range(count)])

    def step(self) -> None:
        """One control step of the script, the watchdog and the arm."""
        self.time += 1.0 / RATE
        if "protective_stop_at" in self.given and self.move and self.since > self.given["protective_stop_at"]:
            self.safety, self.runtime = 1 << 2 | 1 << 10, 1
            del self.given["protective_stop_at"]
        if self.watchdog and self.time - self.written > self.given.get("patience", 1.0) / self.watchdog:
            self.runtime = 1
        if self.runtime == 2:
            self.script()
        if self.runtime != 2:
            self.move, self.watchdog = 0, 0.0
        force = np.array(self.given.get("F_ext", [0.0] * 6))
        if self.move == TORQUE:  # from home, or from where torques left it; the push acts as at home
            self.plant.advance(self.doubles(0) + self.push)
            self.q, self.v = (np.array(part) for part in self.plant.state())
        else:
            wanted = np.zeros(6)
            if self.move == SERVOJ:
                wanted = (self.doubles(0) - self.q) / max(self.doubles(9, 1)[0], 0.03)
            elif self.move == SPEEDJ:
                change = self.doubles(6, 1)[0] / RATE
                wanted = self.v + np.clip(self.doubles(0) - self.v, -change, change)
            self.v = np.clip(wanted, -3.14, 3.14)
            self.q = self.q + self.v / RATE
        self.values |= {
            "timestamp": self.time, "actual_q": self.q, "actual_qd": self.v, "robot_mode": self.given.get("robot_mode", 7),
            # As the vendor reports it: the environment's force on the robot, in the axes of the controller's base.
            "actual_TCP_force": np.concatenate([BASE @ force[:3], BASE @ force[3:]]),
            "runtime_state": self.runtime, "robot_status_bits": 3, "safety_status_bits": self.safety,
            "payload": self.given.get("payload", 0.0), "payload_cog": np.zeros(3), "output_int_register_0": self.ready,
        }  # fmt: skip

    def script(self) -> None:
        """One turn of the command loop of the script: register 0 commands, output register 0 answers."""
        command = int(self.registers.get("input_int_register_0", 0))
        if command in REALTIME:
            self.since = self.since if self.move else 0.0
            self.since += 1.0 / RATE
            self.move, self.ready = command, 1
        elif command == 0:
            self.executing, self.ready = False, 1
        elif not self.executing:
            self.log.append(command)
            self.executing, self.ready = True, 2
            if command in (SPEED_STOP, SERVO_STOP, STOPJ):
                self.move = 0
            elif command == WATCHDOG:
                self.watchdog = self.doubles(0, 1)[0]
            elif command == STOP_SCRIPT:
                self.runtime, self.ready = 1, 0

    # The ports ---------------------------------------------------------------------------------------------------

    def rtde(self, line: socket.socket, kind: int, data: bytes) -> bytes | None:
        """The answer to a message of the RTDE port."""
        if kind == ord("V"):
            return bytes([int(struct.unpack(">H", data)[0] == 2)])
        if kind == ord("v"):
            return struct.pack(">4I", *self.given.get("version", [5, 26, 0]), 0)
        if kind == ord("O"):
            names = [name for name in data[8:].decode().split(",") if name]
            self.outputs[line] = names, struct.Struct(">B" + "".join(TYPES[type_of(name)] for name in names))
            return bytes([1]) + ",".join(map(type_of, names)).encode()
        if kind == ord("I"):
            names = [name for name in data.decode().split(",") if name]
            taken = self.held not in (None, line) or self.given.get("in_use", False)
            self.held = line if not taken else self.held
            self.inputs.setdefault(line, []).append(names)
            types = ["IN_USE" if taken else type_of(name) for name in names]
            return bytes([len(self.inputs[line])]) + ",".join(types).encode()
        if kind in (ord("S"), ord("P")):
            (self.started.add if kind == ord("S") else self.started.discard)(line)
            return b"\x01"
        if kind == ord("U"):
            names = self.inputs[line][data[0] - 1]
            values = struct.unpack(">" + "".join(TYPES[type_of(name)] for name in names), data[1:])
            if VECTOR6 not in map(type_of, names):
                self.registers.update(zip(names, values, strict=True))
            if "input_int_register_0" in names:
                self.written = self.time
        return None

    def state(self, line: socket.socket) -> bytes:
        names, layout = self.outputs[line]
        out: list[Any] = []
        for name in names:
            value = self.values.get(name, 0)
            out += list(value) if isinstance(value, np.ndarray) else [value]
        return message(ord("U"), layout.pack(1, *out))

    def dashboard(self, line: str) -> str:
        if line == "unlock protective stop":
            if self.given.get("stays_locked"):
                return (
                    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause before unlocking"
                )
            self.safety = 1
            return "Protective stop releasing"
        if line.startswith("configure "):  # of the tests
            self.given, self.log = {**self.given, **json.loads(line.partition(" ")[2])}, []
        answers = {
            "log": json.dumps(self.log), "PolyscopeVersion": "URSoftware {}.{}.{}.1 (Jan 01 2026)".format(*self.given.get("version", [5, 26, 0])),
            "get serial number": "20260000001", "is in remote control": str(self.given.get("remote", True)).lower(),
            "close safety popup": "closing safety popup", "stop": "Stopped",
        }  # fmt: skip
        return answers.get(line, f"could not understand: {line}")


def message(kind: int, data: bytes) -> bytes:
    return struct.pack(">HB", len(data) + 3, kind) + data


class Server:
    """The three ports in one thread, at absolute deadlines of the control step."""

    def __init__(self, controller: Controller, address: str) -> None:
        self.controller, self.selector = controller, selectors.DefaultSelector()
        self.rest: dict[Any, bytes] = {}
        for port in (30004, 30003, 29999):
            listener = socket.create_server((address, port))
            listener.setblocking(False)
            self.selector.register(listener, selectors.EVENT_READ, ("accept", port))

    def take(self, line: socket.socket, port: int) -> None:
        try:
            data = line.recv(65536)
        except OSError:
            data = b""
        c = self.controller
        if not data:
            self.selector.unregister(line)
            c.started.discard(line)
            c.held = None if c.held is line else c.held
            line.close()
            return
        data = self.rest.pop(line, b"") + data
        if port == 30003:  # the control script: what it does is played by the controller
            c.runtime, c.ready, c.executing, c.move = 2, 0, False, 0
            c.registers["input_int_register_0"] = 0
        elif port == 29999:
            *lines, rest = data.decode().split("\n")
            for one in lines:
                line.sendall((c.dashboard(one.strip()) + "\n").encode())
            self.rest[line] = rest.encode()
        else:
            while len(data) >= 3 and len(data) >= (size := struct.unpack_from(">H", data)[0]):
                answer = c.rtde(line, data[2], data[3:size])
                if answer is not None:
                    line.sendall(message(data[2], answer))
                data = data[size:]
            self.rest[line] = data

    def run(self) -> None:
        deadline, end = time.monotonic(), time.monotonic() + LIFE
        while time.monotonic() < end:
            deadline = max(deadline + 1.0 / RATE, time.monotonic() - 1.0 / RATE)  # a late step is not made up for
            while (left := deadline - time.monotonic()) > 0.0:
                for key, _ in self.selector.select(left):
                    what, port = key.data
                    if what == "accept":
                        line, _ = key.fileobj.accept()
                        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                        self.selector.register(line, selectors.EVENT_READ, ("line", port))
                        if port == 29999:
                            line.sendall(b"Connected: Universal Robots Dashboard Server\n")
                    else:
                        self.take(key.fileobj, port)
            self.controller.step()
            for line in list(self.controller.started):
                try:
                    line.sendall(self.controller.state(line))
                except OSError:
                    self.controller.started.discard(line)


@contextmanager
def controller(address: str, **given: Any) -> Iterator[subprocess.Popen[str]]:
    """The process of a controller.

    Options: arm, payload [kg], F_ext at its tool; version; remote: whether remote control is on; robot_mode; in_use:
    whether another client has the registers; stays_locked; protective_stop_at [s] of a motion; patience of its watchdog,
    as a factor.
    """
    words = [sys.executable, __file__, address, json.dumps(given)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


if __name__ == "__main__":
    with suppress(OSError):  # where it is allowed, a busy machine does not make a state late
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(70))
    made = Controller(json.loads(sys.argv[2]))
    made.step()
    server = Server(made, sys.argv[1])
    print("ready", flush=True)
    server.run()
