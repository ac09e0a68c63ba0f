"""The parent's end of a robot's loop: its processes, the messages to them, and what they share."""

from __future__ import annotations

import contextlib
import inspect
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from taut.base.errors import MatchError, UsageError, unknown_name
from taut.codegen.servo_loop import STATUS, STATUS_WORDS
from taut.runtime.realtime.shared import Shared, environment
from taut.runtime.robots.driver import DriverError, RobotDriver, RobotInfo

WATCHDOG: Final = 0.08  # [s] without a tick after which the loop's process is ended; acts within 0.1
PATIENCE: Final = 30.0  # [s] for the answer of the loop's process, which may be connecting to a robot
SCHEMES: Final[Mapping[str, tuple[str, str]]] = {
    "franka": ("taut.runtime.robots.franka", "FrankaDriver"),
    "udp": ("taut.runtime.robots.udp", "UdpDriver"),
    "ur": ("taut.runtime.robots.ur", "UrDriver"),
    "can": ("taut.runtime.robots.can", "CanDriver"),
}


class LinkLostError(DriverError):
    """The loop's process is gone."""


class Link:
    """A loop's process, its watchdog, and the status that they share."""

    def __init__(self, hello: Mapping[str, Any], *, partner: Link | None = None) -> None:
        self.status = Shared.create(STATUS_WORDS)
        self.words = self.status.view
        self._closed = False
        self.failure: tuple[int, str] | None = None  # code and text of a driver's fault
        ours, theirs = socket.socketpair()
        self._env = environment()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "taut.runtime.realtime.process", str(theirs.fileno())],
                pass_fds=[theirs.fileno()], env=self._env, stdin=subprocess.DEVNULL,
            )  # fmt: skip
        self._mail = Connection(ours.detach())
        self._watchdog: subprocess.Popen[str] | None = None
        try:
            shared = {"partner": partner.status.name} if partner is not None else {}
            self._send({**hello, "status": self.status.name, **shared})
            self.info, self.notes = self._answer("info")
            self._watch()
        except BaseException:
            self.close()
            raise

    def _watch(self) -> None:
        arguments = [self.status.name, str(self.process.pid), str(WATCHDOG)]
        self._watchdog = subprocess.Popen(
            [sys.executable, "-m", "taut.runtime.realtime.watchdog", *arguments],
            stdout=subprocess.PIPE, text=True, env=self._env, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        assert self._watchdog.stdout is not None
        self._watchdog.stdout.readline()

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

    def _send(self, message: Any) -> None:
        try:
            self._mail.send(message)
        except (OSError, ValueError) as cause:
            raise LinkLostError("the loop's process is gone; connect again", kind="process_died") from cause

    def tell(self, kind: str, given: Any = None) -> None:
        """A message that is not answered."""
        self._send((kind, given))

    def ask(self, kind: str, given: Any = None) -> Any:
        """A message, and the answer to it. Raises DriverError with the error of the loop's process."""
        self._send((kind, given))
        return self._answer("done")[1]

    def _answer(self, kind: str) -> tuple[Any, ...]:
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            if self._mail.poll(0.05):
                try:
                    message = self._mail.recv()
                except (EOFError, OSError):
                    break
                if message[0] == kind:
                    return tuple(message[1:])
                self._note(message)
                if message[0] == "error":
                    raise DriverError(message[2], kind=message[1])
            elif not self.alive:
                break
        else:
            raise DriverError(f"the loop's process did not answer within {PATIENCE:g} s", kind="driver")
        raise LinkLostError("the loop's process died; connect again", kind="process_died")

    def _note(self, message: tuple[Any, ...]) -> None:
        if message[0] == "fault":
            self.failure = message[1], message[2]

    def hear(self) -> None:
        """Take messages that nobody asked for."""
        with contextlib.suppress(EOFError, OSError):
            while self._mail.poll(0):
                self._note(self._mail.recv())

    def close(self) -> None:
        """End the processes, the robot's motion first."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(DriverError):
            self.tell("close")
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(3.0)
        if self.alive:
            self.process.kill()
            self.process.wait()
        self.words[STATUS["dead"]] = 1
        if self._watchdog is not None:
            self._watchdog.wait()
            assert self._watchdog.stdout is not None
            self._watchdog.stdout.close()
        self._mail.close()
        self.status.close()


def driver_of(robot: str | type[RobotDriver], address: str | None) -> dict[str, Any]:
    """Where the loop's process finds a driver, from an address such as franka://172.16.0.2 or a class in a file."""
    if isinstance(robot, str):
        scheme, separator, rest = robot.partition("://")
        if not separator or not rest:
            raise UsageError(
                f"an address is scheme://address, such as franka://172.16.0.2 ({', '.join(SCHEMES)}); got {robot!r}",
                name="robot",
            )
        if scheme not in SCHEMES:
            raise unknown_name("connect", "kind of robot", scheme, SCHEMES)
        module, name = SCHEMES[scheme]
        return {"module": module, "class": name, "address": rest}
    file = None
    with contextlib.suppress(TypeError, OSError):
        file = inspect.getfile(robot)
    if file is None or not Path(file).is_file():
        raise UsageError(
            f"{robot.__name__} stands in no file, and the loop's process imports a driver from one: write it into a "
            "module (.py) and import it from there",
            name="robot",
        )
    return {
        "module": robot.__module__,
        "class": robot.__qualname__,
        "file": str(Path(file).resolve()),
        "address": address or "",
    }


def checked_info(values: Mapping[str, Any], n: int, arm: str) -> RobotInfo:
    """What a robot declared, for an arm of n joints. Raises MatchError."""
    info = RobotInfo(**values)
    if info.n != n:
        raise MatchError(
            f"{info.name} has {info.n} joints and arm '{arm}' has {n}; load the arm that is connected", name="arm"
        )
    return info
