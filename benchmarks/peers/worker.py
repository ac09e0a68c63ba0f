"""The process of one peer: it makes cases and times them, asked in lines of JSON. It needs NumPy alone.

A peer's module has `CASES`: by kind of case a function `(task, **case) -> Case`. Errors are desired minus actual, and
6-vectors have the linear part first.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import sys
import time
import timeit
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

Array = Any
BURST = 0.03  # [s] of processor time that a case takes in a round, or one call


@dataclass(frozen=True)
class Case:
    """Something to be timed.

    Args:
        call: Does `steps` steps (ticks, or steps of the loop) and returns what they gave.
        steps: Of all samples together.
        how: The interface in a few words.
    """

    call: Callable[[], Any]
    steps: int
    how: str


class Task:
    """The arms, the states, the laws and the motion that all share, read from a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        data = json.loads((folder / "task.json").read_text())
        self.kp, self.kd, self.dt = data["kp"], data["kd"], data["dt"]
        self.impedance = {name: np.array(value) for name, value in data["impedance"].items()}
        self.robots = data["robots"]
        self.payload = {name: np.array(value) for name, value in data["payload"].items()}
        self.gains = np.array(data["gains"])  # (samples, 3): kp, kd, mass of the payload

    def urdf(self, robot: str) -> str:
        """Path of a robot's description."""
        return str(self.folder / f"{robot}.urdf")

    def states(self, robot: str) -> list[tuple[Array, ...]]:
        """(q, v, q_des, v_des, a_des), some times over."""
        return [tuple(np.array(row) for row in rows) for rows in self.robots[robot]["states"]]

    def targets(self) -> list[tuple[Array, ...]]:
        """(p, R, twist, acceleration) of the tool, one for each state of the Panda, along the world's axes."""
        return [tuple(np.array(part) for part in target) for target in self.robots["panda"]["targets"]]

    def sine(self, robot: str) -> tuple[Array, Array, Array]:
        """Center, amplitude and angular frequency of the motion that every loop follows."""
        center, amplitude, omega = (np.array(row) for row in self.robots[robot]["sine"])
        return center, amplitude, omega

    def motion(self, robot: str) -> Callable[[float], tuple[Array, Array, Array]]:
        """That motion: q, v, a at a time."""
        center, amplitude, omega = self.sine(robot)

        def at(t: float) -> tuple[Array, Array, Array]:
            s, c = np.sin(omega * t), np.cos(omega * t)
            return center + amplitude * s, amplitude * omega * c, -amplitude * omega * omega * s

        return at


def ticks(task: Task, robot: str, law: Callable[..., Array], how: str) -> Case:
    """A law of joints at each of the states, one call a tick."""
    states = task.states(robot)
    return Case(lambda: [law(*state) for state in states], len(states), how)


def tool_ticks(task: Task, law: Callable[..., Array], how: str) -> Case:
    """A law of the tool at each of the states, one call a tick."""
    rows = [(q, v, *target) for (q, v, *_), target in zip(task.states("panda"), task.targets(), strict=True)]
    return Case(lambda: [law(*row) for row in rows], len(rows), how)


def loop(
    task: Task, robot: str, law: Callable[..., Array], acceleration: Callable[..., Array], steps: int, how: str
) -> Case:
    """A closed loop in Python: law, forward dynamics of the loaded arm, semi-implicit Euler."""
    wanted = task.motion(robot)

    def call() -> Array:
        q, v, _ = wanted(0.0)
        for k in range(steps):
            tau = law(q, v, *wanted(k * task.dt))
            v = v + task.dt * acceleration(q, v, tau)
            q = q + task.dt * v
        return q

    return Case(call, steps, how)


def rotation_vector(R: Array) -> Array:
    """Logarithm of a rotation that is not near half a turn."""
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    angle = math.acos(min(1.0, max(-1.0, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))))
    return (0.5 if angle < 1e-7 else 0.5 * angle / math.sin(angle)) * w


def impedance(
    task: Task, M: Array, h: Array, J: Array, Jdot_v: Array, p: Array, R: Array, q: Array, v: Array, target: Sequence
) -> Array:
    """Impedance of the tool with a posture in its null space, as one writes it in NumPy around any model's terms."""
    p_des, R_des, V_des, a_des = target
    par = task.impedance
    error = np.concatenate([p_des - p, rotation_vector(R_des @ R.T)])
    Minv = np.linalg.inv(M)
    Lambda = np.linalg.inv(J @ Minv @ J.T)
    F = Lambda @ (a_des - Jdot_v) + par["B"] * (V_des - J @ v) + par["K"] * error
    posture = M @ (par["kp"] * (par["rest"] - q) - par["kd"] * v)
    return J.T @ F + h + posture - J.T @ (Lambda @ (J @ (Minv @ posture)))


class Cases:
    """The cases of a process, each made once and then timed in turns."""

    def __init__(self, task: Task, kinds: Mapping[str, Callable[..., Case]]) -> None:
        self._task, self._kinds = task, kinds
        self._timers: dict[str, tuple[timeit.Timer, int, int]] = {}

    def made(self, case: Mapping[str, Any]) -> dict[str, Any]:
        """What the case gives, how many steps that took, and the processor time until then [s]."""
        began, rest = time.process_time(), dict(case)
        made = self._kinds[rest.pop("kind")](self._task, **rest)
        result = np.asarray(made.call(), dtype=float)
        first = time.process_time() - began
        timer = timeit.Timer(made.call, timer=time.process_time)
        n, spent = 1, timer.timeit(1)
        while spent < 0.3 * BURST:
            n *= 2
            spent = timer.timeit(n)
        self._timers[str(case)] = timer, max(1, round(n * BURST / spent)), made.steps
        return {"result": result, "how": made.how, "steps": made.steps, "first": first}

    def turn(self, case: Mapping[str, Any]) -> dict[str, float]:
        """Processor time of one step [s]."""
        timer, n, steps = self._timers[str(case)]
        return {"seconds": timer.timeit(n) / n / steps}


def main() -> None:
    """`python worker.py MODULE FOLDER PACKAGE...`: first the versions, then an answer to each request."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the peer prints does not get among the answers

    def answer(make: Callable[[], dict[str, Any]]) -> None:
        try:
            found = make()
        except Exception as error:  # whatever it is, it is what happened to this peer
            traceback.print_exc()
            found = {"error": " ".join(f"{type(error).__name__}: {error}".split())[:200]}
        print(json.dumps(found, default=lambda array: array.tolist()), file=out, flush=True)

    cases: list[Cases] = []

    def start() -> dict[str, Any]:
        module = importlib.import_module(sys.argv[1])
        cases.append(Cases(Task(Path(sys.argv[2])), module.CASES))
        return {name: version(name) for name in sys.argv[3:]}

    answer(start)
    for line in sys.stdin:
        request = json.loads(line)
        answer(lambda request=request: getattr(cases[0], request["verb"])(request["case"]))


if __name__ == "__main__":
    main()
