"""Universal Robots by `ur_rtde`; written without a real controller: docs/ur.md states what was tested."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from taut.base.checks import one_of
from taut.base.errors import missing_extra
from taut.base.types import Float64Array
from taut.runtime.robots.driver import DriverError, RobotDriver, RobotInfo

RTDE, DASHBOARD = 30004, 29999  # ports
TORQUE: Final = {5: (5, 26, 0), 10: (10, 12, 1)}  # from here on direct_torque has scales of friction compensation
PAYLOAD: Final = (5, 6, 0)
WATCHDOG_RATE: Final = 20.0  # [Hz] slower commands end the controller's program
POLL: Final = 1e-4  # [s] between two looks for a new state
SILENT_POLLS: Final = 600  # without one until the robot is silent: 0.06 s; the loop's watchdog acts after 0.07
UR_ANSWER: Final = 2.0  # [s] for an answer, or for a connection to end
ACCELERATION: Final = 40.0  # [rad/s^2] largest of speedj; the loop's limits are lower
LOOKAHEAD, GAIN = 0.1, 300.0  # [s], [-] of servoj: the vendor's defaults
STOP_DECELERATION: Final = 10.0  # [rad/s^2] of the stop at the end
RUNNING, PLAYING = 7, 2  # robot mode, runtime state
STOPS: Final = {  # bits of the safety status in which the arm does not move
    2: "a protective stop", 4: "a safeguard stop", 5: "an emergency stop", 6: "an emergency stop",
    7: "an emergency stop", 8: "a safety violation", 9: "a fault", 10: "a stop for safety",
}  # fmt: skip
TO_BASE_LINK: Final = np.diag([-1.0, -1.0, 1.0])  # base_link of a URDF is the controller's base, rotated about z


class UrDriver(RobotDriver):
    """A Universal Robots arm through the vendor's RTDE interface.

    Args:
        address: Its address.
        command: What it takes: "position" (servoj), "velocity" (speedj) or "torque" (direct_torque, to which the
            controller adds gravity; from PolyScope 5.26 or X 10.12.1).
    """

    def __init__(self, address: str, *, command: str = "position") -> None:
        self._address = address
        self._command = one_of("command", command, ("position", "velocity", "torque"))
        self._receive: Any = None
        self._control: Any = None
        self._lost, self._time = False, 0.0

    def open(self) -> RobotInfo:
        self._version = version = _version(self._address)
        text = ".".join(map(str, version))
        least = TORQUE.get(version[0], (5, 26, 0))
        if self._command == "torque" and version < least:
            raise DriverError(
                f"direct_torque needs PolyScope {'.'.join(map(str, least))}, and {self._address} has {text}; "
                'options={"command": "velocity"}, in a robot file options = { command = "velocity" }',
                kind="rejected",
            )  # fmt: skip
        self._rate = 500.0 if version[0] >= 5 else 125.0
        self._variables = [
            "timestamp", "actual_q", "actual_qd", "actual_TCP_force", "actual_TCP_pose", "robot_mode",
            "runtime_state", "safety_status_bits", *["payload", "payload_cog"] * (version >= PAYLOAD),
        ]  # fmt: skip
        self._connect()
        receive = self._receive
        known = version >= PAYLOAD
        return RobotInfo(
            name=f"UR at {self._address}", n=6, rate=self._rate, takes=self._command,  # type: ignore[arg-type]
            measures=("v", "F_ext"), adds=("gravity",) if self._command == "torque" else (), paced_by="robot",
            load=(receive.getPayload(), tuple(receive.getPayloadCog())) if known else None,
            silence=1.0 / WATCHDOG_RATE, delay=1.0 / self._rate,  # assumed: a command acts in its next cycle
            facts={"T_BE": _pose(receive.getActualTCPPose()).tolist(), "version": text},
        )  # fmt: skip

    def _connect(self) -> None:
        module = _module("rtde_receive")
        self._receive = module.RTDEReceiveInterface(self._address, self._rate, self._variables)
        self._lost = False

    def read(self, measured: Mapping[str, Float64Array]) -> None:
        receive = self._receive
        for _ in range(0 if self._lost else SILENT_POLLS):
            now = receive.getTimestamp()
            if now != self._time:
                break
            time.sleep(POLL)
        else:
            kind, self._lost = "silent" if receive.isConnected() else "disconnected", True
            raise DriverError(f"UR at {self._address} sends no state", kind=kind)
        self._time = now
        measured["q"][:], measured["v"][:] = receive.getActualQ(), receive.getActualQd()
        measured["F_ext"][:] = (np.reshape(receive.getActualTCPForce(), (2, 3)) @ TO_BASE_LINK).ravel()
        if self._control is not None:
            self._require_ready()

    def _require_ready(self) -> None:
        """Raises DriverError where the robot cannot move, or the program has ended that moves it."""
        bits, mode = self._receive.getSafetyStatusBits(), self._receive.getRobotMode()
        for bit, what in STOPS.items():
            if bits >> bit & 1:
                raise DriverError(f"UR at {self._address} is in {what}")
        if mode != RUNNING:
            raise DriverError(f"UR at {self._address} is in robot mode {mode}: power it on and release its brakes")
        if self._control is not None and self._receive.getRuntimeState() != PLAYING:
            raise DriverError(f"the program on the UR at {self._address} has ended")

    def begin(self) -> None:
        self._require_ready()
        client = _module("rtde_control").RTDEControlInterface
        dt, zero = 1.0 / self._rate, [0.0] * 6  # no friction compensation
        try:
            self._control = control = client(self._address, self._rate)
            send: dict[str, tuple[Callable[[list[float]], bool], Callable[[float], bool]]] = {
                "position": (lambda q: control.servoJ(q, 0.0, 0.0, dt, LOOKAHEAD, GAIN), control.servoStop),
                "velocity": (lambda v: control.speedJ(v, ACCELERATION, dt), control.speedStop),
                "torque": (lambda tau: control.directTorque(tau, zero, zero), control.stopJ),
            }
            self._send, self._stop = send[self._command]
            if not control.setWatchdog(WATCHDOG_RATE):
                raise RuntimeError("it refused the watchdog")
            self._until(lambda: self._receive.getRuntimeState() == PLAYING)  # which comes by another line
        except (RuntimeError, ValueError) as cause:
            self.end()
            kind = "busy" if "in use" in str(cause) else "rejected"
            raise DriverError(f"UR at {self._address} gives no control: {cause}", kind=kind) from cause

    def _until(self, holds: Callable[[], bool]) -> None:
        until = time.monotonic() + UR_ANSWER
        while not holds() and time.monotonic() < until:
            time.sleep(POLL)

    def write(self, command: Float64Array) -> None:
        if not self._send(command.tolist()):
            time.sleep(5.0 / self._rate)  # until the other connection shows why
            self._require_ready()
            raise DriverError(f"UR at {self._address} took no command", kind="rejected")

    def end(self) -> None:
        control, self._control = self._control, None
        if control is None:
            return
        if not self._lost and self._receive.getRuntimeState() == PLAYING:
            with contextlib.suppress(Exception):  # a program that ends meanwhile stops the arm too
                self._stop(STOP_DECELERATION)
                control.stopScript()
        _dropped(control, 0.0 if self._lost else UR_ANSWER)

    def recover(self) -> None:
        """Unlock a protective stop, by the dashboard server of CB3 and e-Series; connect anew where it was lost."""
        if self._lost:
            _version(self._address)
            _dropped(self._receive, 0.0)
            self._connect()
        if self._stopped() and self._version[0] < 10:
            try:
                with (
                    socket.create_connection((self._address, DASHBOARD), UR_ANSWER) as port,
                    port.makefile() as lines,
                ):
                    lines.readline()  # its name
                    port.sendall(b"unlock protective stop\n")
                    answer = lines.readline().strip()
            except OSError as cause:
                raise DriverError(f"no dashboard server answers at {self._address}", kind="rejected") from cause
            if "releasing" not in answer.lower():
                raise DriverError(f"UR at {self._address} stays in a protective stop: {answer}", kind="rejected")
            self._until(lambda: not self._stopped())
        self._require_ready()

    def _stopped(self) -> bool:
        """Whether it is in a protective stop."""
        return bool(self._receive.getSafetyStatusBits() >> 2 & 1)

    def close(self) -> None:
        self.end()
        if self._receive is not None:
            _dropped(self._receive, 0.0 if self._lost else UR_ANSWER)


def _module(name: str) -> Any:
    """A module of ur_rtde."""
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as cause:
        raise missing_extra("ur://", "ur_rtde", "ur") from cause


def _dropped(interface: Any, patience: float) -> None:
    """End a connection, and wait for it [s]: the client itself waits without a limit for a robot that is gone."""
    thread = threading.Thread(target=interface.disconnect, daemon=True)
    thread.start()
    thread.join(patience)


def _version(address: str) -> tuple[int, int, int]:
    """PolyScope's version, by the RTDE protocol. Raises DriverError where none answers."""
    try:
        with socket.create_connection((address, RTDE), UR_ANSWER) as port, port.makefile("rb") as answers:
            port.sendall(struct.pack(">HBH", 5, ord("V"), 2) + struct.pack(">HB", 3, ord("v")))
            accepted, found = answers.read(4), answers.read(19)
            if len(found) == 19 and accepted[3]:
                major, minor, fix, _ = struct.unpack(">4I", found[3:])
                return major, minor, fix
    except OSError as cause:
        raise DriverError(f"no UR answers at {address}", kind="disconnected") from cause
    raise DriverError(f"what answers at {address} is no UR", kind="rejected")


def _pose(values: list[float]) -> Float64Array:
    """(4, 4) pose of the TCP in base_link, from position and rotation vector in the controller's base."""
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    T[:3, :3] = TO_BASE_LINK @ Rotation.from_rotvec(values[3:]).as_matrix()
    T[:3, 3] = TO_BASE_LINK @ values[:3]
    return T
