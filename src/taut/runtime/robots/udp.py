"""A robot on UDP: docs/your_arm.md describes its packets, and has a robot's side in fifty lines."""

from __future__ import annotations

import contextlib
import ctypes
import json
import secrets
import socket
import struct
import time
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.base.checks import instance_of, whole_number
from taut.base.errors import TautError, UsageError
from taut.base.types import Float64Array
from taut.codegen.servo_loop import struct_of
from taut.codegen.udp_link import BUFFER, HEADER, UDP, udp_code
from taut.maths.snapshot import measurement_shapes
from taut.runtime.robots.driver import DriverError, NativeCalls, RobotDriver, RobotInfo

MAGIC: Final = b"taut"
VERSION: Final = 1
HEAD: Final = struct.Struct("<4sBBHQqqq")  # magic, version, kind, joints; session, sequence, time [ns], mode
HELLO, INFO, BUSY, STATE, LISTEN, COMMAND, BYE = range(1, 8)
STOPPED: Final = 2  # modes: 0 not controlled, 1 controlled, 2 stopped as no command came, above: stopped by itself
MODES: Final = {str(STOPPED): "no command reached it in time"}
TRIES: Final = 5  # of a hello
HELLO_TIME: Final = 0.1  # [s] for the answer to each
FIRST: Final = 1.0  # [s] for the first state
NEXT_WITHIN: Final = 1.4  # [periods] after the last state the next one is missed, where the robot keeps the time
KINDS: Final = {"measures": list, "adds": list, "joint_names": list, "load": list, "facts": dict}
COUNTS: Final = ("received", "lost", "late", "doubled", "malformed", "extrapolated")


class UdpDriver(RobotDriver):
    """A robot that speaks the packets of docs/your_arm.md. Reads and writes are native code.

    Of the states that have arrived the newest by its number is taken. Where there is none the last one is continued
    at constant velocity, for at most `missed` reads in a row.

    Args:
        address: HOST:PORT.
        missed: Reads in a row without a state that end the motion, as the fault `silent`.
    """

    def __init__(self, address: str, *, missed: int = 20) -> None:
        whole_number("missed", missed, minimum=1)
        self._address, self._missed = f"udp://{address}", missed
        host, _, port = address.rpartition(":")
        if not host or not port.isdigit():
            raise UsageError(f"a robot on UDP is udp://HOST:PORT; got {self._address!r}", name="address")
        try:
            place = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(*place[:3])
            self._socket.connect(place[4])
        except (OSError, OverflowError) as cause:
            raise DriverError(f"{self._address} cannot be reached: {cause}", kind="disconnected") from cause

    def open(self) -> RobotInfo:
        session, declared = self._greet()
        self._info = info = self._declared(declared)
        size = sum(int(np.prod(measurement_shapes(info.n)[name])) for name in ("q", *info.measures))
        if size > BUFFER - HEADER:
            raise DriverError(f"a state of {info.name} has {size} numbers, over {BUFFER - HEADER}", kind="rejected")
        kept, self._flat, packet, sent = self._buffers = np.zeros((4, BUFFER))
        pace = NEXT_WITHIN / info.rate if info.paced_by == "robot" else 0.0
        heads = {STATE: "state_head", LISTEN: "listen_head", COMMAND: "command_head"}
        self._words = struct_of(UDP, {
            "socket": self._socket.fileno(), "wait": round(1e9 * pace), "step": pace or 1.0 / info.rate,
            "packet": packet.ctypes.data, "sent": sent.ctypes.data, "kept": kept.ctypes.data, "state_size": size,
            "command_size": info.n * (5 if info.takes == "mit" else 1), "n": info.n, "limit": self._missed,
            **{name: int.from_bytes(self._head(kind, 0, info.n)[:8], "little") for kind, name in heads.items()},
        })  # fmt: skip
        code, user = udp_code(), int(self._words.ctypes.data)
        function = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)
        self._read, self._write = (function(code[name]) for name in ("udp_read", "udp_write"))
        self._calls = NativeCalls(read=code["udp_read"], write=code["udp_write"], user=user, failure=self._failure)
        self._begin_session(session)
        return info

    def read(self, measured: Mapping[str, Float64Array]) -> None:
        failed = self._read(self._calls.user, self._flat.ctypes.data)
        parts = np.split(self._flat, np.cumsum([view.size for view in measured.values()]))
        for view, part in zip(measured.values(), parts, strict=False):
            view[...] = part.reshape(view.shape)
        if failed:
            raise self._failure()

    def write(self, command: Float64Array) -> None:
        self._write(self._calls.user, command.ctypes.data)

    def native(self) -> NativeCalls:
        return self._calls

    def begin(self) -> None:
        if self._words[UDP["mode"]] >= STOPPED:
            raise self._failure()
        self._words[UDP["controls"]] = 1

    def end(self) -> None:
        self._words[UDP["controls"]] = 0
        self._post(LISTEN)

    def recover(self) -> None:
        """A new session, in which the robot forgets why it stopped, if it can."""
        session, declared = self._greet()
        if self._declared(declared) != self._info:
            raise DriverError(f"{self._info.name} is another robot now; connect again", kind="rejected")
        self._begin_session(session)

    def call(self, name: str, arguments: Mapping[str, Any]) -> Any:
        """Only `counts`: of packets in this session, and the longest round trip [s]."""
        if name != "counts" or arguments:
            return super().call(name, arguments)
        counts = {count: int(self._words[UDP[count]]) for count in COUNTS}
        return {**counts, "round_trip": 1e-9 * int(self._words[UDP["round_trip"]])}

    def close(self) -> None:
        if hasattr(self, "_words"):
            self._post(BYE)
        self._socket.close()

    def _head(self, kind: int, session: int, n: int, sequence: int = 0) -> bytes:
        return HEAD.pack(MAGIC, VERSION, kind, n, session, sequence, time.monotonic_ns(), 0)

    def _post(self, kind: int) -> None:
        self._words[UDP["out"]] += 1
        session, number = int(self._words[UDP["session"]]), int(self._words[UDP["out"]])
        with contextlib.suppress(OSError):  # a robot that is gone
            self._socket.send(self._head(kind, session, self._info.n, number))

    def _greet(self) -> tuple[int, bytes]:
        """The number of a new session, and what the robot declares."""
        session = secrets.randbits(62)
        for _ in range(TRIES):
            until = time.monotonic() + HELLO_TIME
            with contextlib.suppress(OSError):
                self._socket.send(self._head(HELLO, session, 0))
            while (remaining := until - time.monotonic()) > 0.0:
                self._socket.settimeout(remaining)
                try:
                    data = self._socket.recv(65536)
                except OSError:  # nothing within this time, or nobody listens
                    time.sleep(max(0.0, until - time.monotonic()))
                    continue
                if len(data) < HEAD.size or not data.startswith(MAGIC):
                    continue
                _, version, kind, _, number, *_ = HEAD.unpack_from(data)
                if version != VERSION:
                    raise DriverError(
                        f"the robot at {self._address} speaks version {version} of the packets, and taut version "
                        f"{VERSION}; update the older one", kind="rejected",
                    )  # fmt: skip
                if number == session and kind == BUSY:
                    raise DriverError(f"another client has the robot at {self._address}; close it first", kind="busy")
                if number == session and kind == INFO:
                    return session, data[HEAD.size :]
        raise DriverError(
            f"nobody answers at {self._address} within {TRIES * HELLO_TIME:g} s; is the robot's program running?",
            kind="disconnected",
        )

    def _declared(self, data: bytes) -> RobotInfo:
        """What a robot declares, in JSON."""
        try:
            given = json.loads(data)
        except (ValueError, RecursionError):
            given = None
        if not isinstance(given, dict):
            raise DriverError(f"{self._address} declares itself with what is no JSON object", kind="rejected")
        try:
            for name, kind in KINDS.items():
                instance_of(name, given.get(name, kind()), kind, "a list" if kind is list else "an object")
            given |= {name: tuple(given[name]) for name in ("measures", "adds", "joint_names") if name in given}
            if given.get("load"):
                given["load"] = (given["load"][0], tuple(given["load"][1:]))
            info = RobotInfo(**{"measures": ("v",), **given})
            modes = info.facts.get("modes", {})
            instance_of("facts.modes", modes, dict, "an object")
        except (TypeError, TautError) as cause:
            raise DriverError(f"{self._address} declares what no robot is: {cause}", kind="rejected") from cause
        self._modes = MODES | modes
        if info.measures[:1] != ("v",):
            raise DriverError(f"a state of {info.name} must be q, v, ...: measures begins with 'v'", kind="rejected")
        return info

    def _begin_session(self, session: int) -> None:
        """Forget what was before, and wait for the first state."""
        for name in ("out", "newest", "window", "mode", "missed", "controls", *COUNTS, "round_trip"):
            self._words[UDP[name]] = 0
        self._words[UDP["session"]] = session
        until = time.monotonic() + FIRST
        while not self._words[UDP["received"]]:
            self._read(self._calls.user, self._flat.ctypes.data)
            time.sleep(1e-3)
            if time.monotonic() > until:
                others = int(self._words[UDP["malformed"]])
                raise DriverError(
                    f"{self._info.name} sent no state of {self._info.n} joints and {self._info.measures} within "
                    f"{FIRST:g} s, and {others} other packets", kind="rejected" if others else "silent",
                )  # fmt: skip
        self._words[UDP["missed"]] = 0

    def _failure(self) -> DriverError:
        name, mode, missed = self._info.name, int(self._words[UDP["mode"]]), int(self._words[UDP["missed"]])
        if missed >= self._missed:
            return DriverError(f"{name} sent no state for {missed} periods", kind="silent")
        return DriverError(f"{name} stopped by itself: {self._modes.get(str(mode), f'mode {mode}')}")
