"""The parent's end of a robot's loop: its processes, the messages to them, and what they share."""

from __future__ import annotations

import contextlib
import inspect
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from taut.base.checks import readable_file
from taut.base.errors import UsageError, unknown_name
from taut.codegen.servo_loop import STATUS, STATUS_WORDS
from taut.runtime.realtime.shared import Shared, environment
from taut.runtime.robots.driver import DriverError, RobotDriver, RobotInfo

ANSWER_TIME: Final = 30.0  # [s] for the answer of the loop's process, which may be connecting to a robot
CLOSING: Final = 8.0  # [s] for its end, with a controlled stop before it
WAITS: Final = {
    "hello": "the driver's open()", "set": "the driver's begin()", "end": "the driver's end()",
    "recover": "the driver's recover()", "load": "the driver's set_load()", "call": "the driver's call()",
}  # fmt: skip
ONE_THREAD: Final = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
SCHEMES: Final[Mapping[str, tuple[str, str]]] = {
    "franka": ("taut.runtime.robots.franka", "FrankaDriver"),
    "udp": ("taut.runtime.robots.udp", "UdpDriver"),
    "ur": ("taut.runtime.robots.ur", "UrDriver"),
    "can": ("taut.runtime.robots.can", "CanDriver"),
}


class Link:
    """A loop's process, which has a watchdog, and the status that they share."""

    def __init__(self, partner: Link | None = None) -> None:
        self.status = Shared.create(STATUS_WORDS)
        self.words = self.status.view
        self.group: Shared = Shared.create(1) if partner is None else partner.group
        self.failure: tuple[int, str] | None = None  # code and text of a driver's fault
        self._owner, self._closed, self._shares = os.getpid(), False, partner is not None
        self._alone, self._asked = threading.RLock(), 0  # of the messages
        ours, theirs = socket.socketpair()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "taut.runtime.realtime.process", str(theirs.fileno())],
                pass_fds=[theirs.fileno()], env={**environment(), **ONE_THREAD},
                stdin=subprocess.DEVNULL, start_new_session=True,  # what a terminal sends is not for it
            )  # fmt: skip
        self._mail = Connection(ours.detach())

    def open(self, hello: Mapping[str, Any]) -> RobotInfo:
        """Connect to the robot. Raises DriverError."""
        info, self.notes = self.ask("hello", {**hello, "status": self.status.name, "group": self.group.name})
        return RobotInfo(**info)

    def word(self, name: str) -> int:
        """A word of the status."""
        return int(self.words[STATUS[name]])

    def set_word(self, name: str, value: int) -> None:
        self.words[STATUS[name]] = value

    @property
    def released(self) -> bool:
        """Whether it is closed."""
        return self._closed

    @property
    def alive(self) -> bool:
        """Whether the loop's process is there."""
        return self.process.poll() is None

    @property
    def silence(self) -> float:
        """Time since the last tick [s]."""
        return 1e-9 * (time.monotonic_ns() - self.word("heartbeat"))

    def ask(self, kind: str, given: Any = None, within: float = ANSWER_TIME) -> Any:
        """A message, and the answer to it. Raises DriverError with the error of the loop's process."""
        with self._alone:
            self.hear()
            self._asked += 1
            self._send((kind, given, self._asked))
            return self._answer(kind, self._asked, within)

    def _send(self, message: Any) -> None:
        try:
            self._mail.send(message)
        except (OSError, ValueError) as cause:
            raise DriverError("the loop's process is gone; connect again", kind="process_died") from cause

    def _answer(self, kind: str, number: int, within: float) -> Any:
        """The answer to the request of a number; those to earlier ones, which Ctrl-C ended, are dropped."""
        until = time.monotonic() + within
        with contextlib.suppress(EOFError, OSError):
            while self._mail.poll(0.05) or self.alive:
                if self._mail.poll(0):
                    message = self._mail.recv()
                    if message[0] == "fault":
                        self.failure = message[1], message[2]
                    elif message[1] == number and message[0] == "error":
                        raise DriverError(message[3], kind=message[2])
                    elif message[1] == number:
                        return message[2]
                if time.monotonic() > until:
                    raise DriverError(f"{WAITS[kind]} did not return within {within:g} s", kind="driver")
        raise DriverError("the loop's process died; connect again", kind="process_died")

    def hear(self) -> None:
        """Take what nobody asked for: a fault."""
        if not self._alone.acquire(blocking=False):
            return  # who waits for an answer takes it
        with contextlib.suppress(EOFError, OSError):
            while self._mail.poll(0):
                message = self._mail.recv()
                self.failure = (message[1], message[2]) if message[0] == "fault" else self.failure
        self._alone.release()

    def close(self) -> bool:
        """End the process, the robot's motion first; False in another process than the one that made it."""
        if self._closed or os.getpid() != self._owner:
            return self._closed
        self._closed = True
        with contextlib.suppress(DriverError):
            self._send(("close", None, 0))
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(CLOSING)
        if self.alive:
            self.process.kill()
            self.process.wait()
        self._mail.close()
        self.status.close()
        if not self._shares:
            self.group.close()
        return True


def driver_of(robot: str | type[RobotDriver], address: str | None) -> dict[str, Any]:
    """Where the loop's process finds a driver, from franka://172.16.0.2, FILE.py:CLASS, or a class in a file."""
    if isinstance(robot, str):
        path, _, name = robot.rpartition(":")
        if path.endswith(".py"):
            place = readable_file("driver file", path).resolve()
            return {"module": place.stem, "class": name, "address": address or "", "file": str(place)}
        scheme, separator, rest = robot.partition("://")
        if not separator or not rest:
            raise UsageError(
                f"a robot is scheme://address, such as franka://172.16.0.2 ({', '.join(SCHEMES)}), or a driver of "
                f"your own, FILE.py:CLASS; got {robot!r}",
                name="robot",
            )
        if scheme not in SCHEMES:
            raise unknown_name("connect", "kind of robot", scheme, SCHEMES)
        if address is not None:
            raise UsageError(
                f"address= is for a driver of your own, and {robot} has one; leave it out", name="address"
            )
        module, name = SCHEMES[scheme]
        return {"module": module, "class": name, "address": rest}
    file = None
    with contextlib.suppress(TypeError, OSError):
        file = inspect.getfile(robot)
    if file is None or not Path(file).is_file() or robot.__module__ == "__main__" or "." in robot.__qualname__:
        raise UsageError(
            f"{robot.__name__} is not at the top of a module, and the loop's process imports a driver from one: "
            "write it into a file of its own (.py) and import it from there",
            name="robot",
        )
    return {"module": robot.__module__, "class": robot.__qualname__, "address": address or ""}
