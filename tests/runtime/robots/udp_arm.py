"""The arm of docs/your_arm.md in a process of its own, behind a network that loses, doubles and delays packets."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

PAGE = Path(__file__).parents[3] / "docs" / "your_arm.md"
LIFE = 60.0  # [s] of the process, at most


def of_page() -> dict[str, Any]:
    """The names of `my_arm.py` on the page."""
    text = re.search(r"^```python\n# my_arm.py\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    names: dict[str, Any] = {"__name__": "my_arm"}
    exec(compile(text[1], "my_arm.py", "exec"), names)
    return names


def delays(
    seed: int, lost: float = 0.0, doubled: float = 0.0, delayed: float = 0.0, by: int = 5
) -> Iterator[list[int]]:
    """The fate of each packet: after how many packets each of its copies arrives; none of a lost one."""
    rng = np.random.default_rng(seed)
    while True:
        copies = 0 if rng.random() < lost else 1 + int(rng.random() < doubled)
        yield [int(rng.integers(1, by + 1)) if rng.random() < delayed else 0 for _ in range(copies)]


class Lossy:
    """A socket whose packets have these fates, in both directions."""

    def __init__(self, sock: socket.socket, network: dict[str, Any]) -> None:
        self._socket = sock
        self._fates = [delays(**{**network, "seed": network["seed"] + way}) for way in (0, 1)]
        self._waiting: list[list[tuple[int, Any]]] = [[], []]
        self._count, self._arrived = [0, 0], deque[Any]()
        self.settimeout = sock.settimeout

    def _pass(self, way: int, packet: Any) -> list[Any]:
        """The packets that come out where one goes in."""
        self._count[way] += 1
        now = self._count[way]
        self._waiting[way] += [(now + delay, packet) for delay in next(self._fates[way])]
        due = [one for at, one in self._waiting[way] if at <= now]
        self._waiting[way] = [(at, one) for at, one in self._waiting[way] if at > now]
        return due

    def sendto(self, data: bytes, client: Any) -> None:
        for one in self._pass(0, (data, client)):
            self._socket.sendto(*one)

    def recvfrom(self, size: int) -> Any:
        while not self._arrived:
            self._arrived += self._pass(1, self._socket.recvfrom(size))
        return self._arrived.popleft()


def serve_by_own_clock(sock: Any, arm: Any, info: dict[str, Any], seconds: float) -> None:
    """A robot that keeps the time: it sends a state each period, and takes the newest command."""
    names = of_page()
    head, kinds = names["HEAD"], names
    n, session, newest, sent, mode, client, heard, their_time = info["n"], 0, 0, 0, 0, None, 0.0, 0
    tick, end = time.monotonic(), time.monotonic() + seconds
    while time.monotonic() < end:
        tick = max(tick + 1.0 / info["rate"], time.monotonic() - 0.1)
        while (left := tick - time.monotonic()) > 0.0:
            sock.settimeout(left)
            try:
                packet, place = sock.recvfrom(2048)
            except TimeoutError:
                break
            _, _, kind, _, theirs, number, sent_at, _ = head.unpack_from(packet)
            if kind == kinds["HELLO"]:
                session, newest, sent, mode, client = theirs, 0, 0, 0, place
                sock.sendto(
                    head.pack(b"taut", 1, kinds["INFO"], n, theirs, 0, 0, 0) + json.dumps(info).encode(), place
                )
            elif theirs == session and number > newest:
                newest, heard, their_time = number, time.monotonic(), sent_at
                if kind == kinds["COMMAND"]:
                    mode = 1
                    arm.torque(np.frombuffer(packet, "<f8", offset=head.size))
                else:
                    mode, client = 0, None if kind == kinds["BYE"] else client
                    arm.brake()
        if mode == 1 and time.monotonic() - heard > 0.1:
            mode = 2
            arm.brake()
        if client is not None:
            sent += 1
            state = head.pack(b"taut", 1, kinds["STATE"], n, session, sent, their_time, mode)
            sock.sendto(state + np.concatenate(arm.state()).tobytes(), client)


@contextmanager
def simulated(name: str, port: int = 0, **options: Any) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """The process of an arm, and its port. Options: `network` of both directions; `info`; `nan_after` states."""
    words = [sys.executable, __file__, json.dumps({"name": name, "port": port, **options})]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process, int(process.stdout.readline())
        finally:
            process.kill()


def main() -> None:
    given = json.loads(sys.argv[1])
    names = of_page()
    with suppress(OSError):  # where it is allowed, a busy machine does not make a state late
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(70))
    arm = names["Arm"](given["name"])
    if "nan_after" in given:
        left, states = given["nan_after"], arm.state

        def state() -> Any:
            nonlocal left
            left -= not arm.braked
            q, v = states()
            return (q, v) if left > 0 else (q * np.array([1.0] * (len(q) - 1) + [np.nan]), v)

        arm.state = state
    n = arm.model.n
    info = {"name": f"simulated {given['name']}", "n": n, "rate": 1000.0, "takes": "torque", **given.get("info", {})}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", given["port"]))
        print(sock.getsockname()[1], flush=True)
        wire = Lossy(sock, given["network"]) if "network" in given else sock
        serve = serve_by_own_clock if info.get("paced_by") == "robot" else names["serve"]
        serve(wire, arm, info, LIFE)


if __name__ == "__main__":
    main()
