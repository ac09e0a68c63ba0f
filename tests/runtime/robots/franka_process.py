"""A Franka for tests in a process of its own, as seen from the process that started it."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Self

import numpy as np

import taut
from taut.runtime.realtime.robot import Robot

SERVER = Path(__file__).with_name("franka_server.py")
BOUND = 300.0  # [s] after which it ends by itself


def own_address(number: int = 0) -> str:
    """A loopback address that no other process of this machine takes: the vendor's ports are fixed."""
    pid = os.getpid()
    return f"127.{64 + number}.{(pid >> 7) % 255}.{1 + pid % 128}"


class FrankaProcess:
    """`franka_server.py` at an address of its own."""

    def __init__(self, number: int = 0) -> None:
        self.address = own_address(number)
        self.process = subprocess.Popen(
            [sys.executable, str(SERVER), self.address, str(BOUND)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.events: list[dict[str, Any]] = []
        self._new: queue.Queue[dict[str, Any]] = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._new.put(json.loads(line))

    def order(self, name: str, *given: Any) -> None:
        assert self.process.stdin is not None
        print(json.dumps([name, *given]), file=self.process.stdin, flush=True)

    def wait_for(self, event: str, timeout: float = 20.0) -> dict[str, Any]:
        """The next event of that name."""
        while True:
            found = self._new.get(timeout=timeout)
            self.events.append(found)
            if found["event"] == event:
                return found

    def look(self) -> dict[str, Any]:
        """Its true state."""
        self.order("look")
        return self.wait_for("state")

    def close(self) -> None:
        self.process.kill()  # our own child
        self.process.wait()
        self._reader.join()
        for stream in (self.process.stdin, self.process.stdout):
            assert stream is not None
            stream.close()

    def __enter__(self) -> Self:
        self.wait_for("ready")
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def following(name: str, robot: Robot, franka: FrankaProcess, seconds: float) -> tuple[taut.Controller, Any, float]:
    """A controller with its reference from where the robot is, and the height of the table [m]."""
    arm, q = robot.arm, robot.q
    here = taut.snapshot(arm, q).T()
    aside = here.p + np.array([0.0, 0.05, 0.0])
    law: taut.Law
    reference: Any
    height = -1.0
    if name == "joint":
        law = taut.laws.ComputedTorque(kp=400.0, kd=40.0)
        reference = taut.trajectories.Sine(center=q, amplitude=np.full(arm.n, 0.1), frequency=0.5)
    elif name == "cartesian":
        law = taut.laws.Impedance(K=(800.0, 40.0), zeta=1.0)
        reference = taut.trajectories.Circle(T0=here, centre=aside, axis=[0.0, 0.0, 1.0], duration=seconds)
    else:
        height = franka.look()["p"][2] - 0.004  # the tool comes down on it
        law = taut.laws.HybridMotionForce(
            constraint=taut.Constraint(lambda T: T.p[2] - height, one_sided=True),
            motion=taut.laws.TaskComputedTorque(kp=400.0, kd=40.0), kfp=0.3, kfi=5.0, kdamp=300.0,
        )  # fmt: skip
        stroke = taut.trajectories.Line(T0=here, T1=taut.Pose(aside, R=here.R), duration=0.5 * seconds)
        reference = taut.pressing(stroke, 10.0)
    franka.order("table", height)
    return taut.compile(law, arm, rate=robot.rate, adds=robot.adds), reference, height
