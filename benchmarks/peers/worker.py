"""What the process of a peer does: it answers requests on standard input, one line of JSON each. NumPy alone is needed.

The module of a peer has `CASES`: for each kind of case a function `(task, **case) -> Case`; a case that it raises
is reported in its words. Errors of the arms are desired minus actual, 6-vectors have the linear part first.
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np

Array = Any


@dataclass(frozen=True)
class Case:
    """Something to be timed.

    Args:
        call: Does `steps` steps (ticks, steps of the loop) and returns what they gave.
        steps: Of all samples together.
        how: The interface and the integrator in a few words.
    """

    call: Callable[[], Any]
    steps: int
    how: str


class Task:
    """The arm, the states, the laws and the motion that all share, read from a folder."""

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
        return tuple(np.array(row) for row in self.robots[robot]["sine"])

    def motion(self, robot: str) -> Callable[[float], tuple[Array, Array, Array]]:
        """That motion: q, v, a at a time."""
        center, amplitude, omega = self.sine(robot)

        def at(t: float) -> tuple[Array, Array, Array]:
            s, c = np.sin(omega * t), np.cos(omega * t)
            return center + amplitude * s, amplitude * omega * c, -amplitude * omega * omega * s

        return at


def ticks(task: Task, law: Callable[..., Array], how: str, robot: str = "panda") -> Case:
    """A law of joints at each of the states, one call a tick."""
    states = task.states(robot)

    def call() -> list[Array]:
        return [law(q, v, q_des, v_des, a_des) for q, v, q_des, v_des, a_des in states]

    return Case(call, len(states), how)


def task_ticks(task: Task, law: Callable[..., Array], how: str) -> Case:
    """A law of the tool at each of the states, one call a tick."""
    rows = [(q, v, *target) for (q, v, *_), target in zip(task.states("panda"), task.targets(), strict=True)]

    def call() -> list[Array]:
        return [law(q, v, p, R, V, a) for q, v, p, R, V, a in rows]

    return Case(call, len(rows), how)


def loop(
    task: Task,
    robot: str,
    law: Callable[..., Array],
    acceleration: Callable[..., Array],
    steps: int,
    how: str,
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


def versions(names: Sequence[str]) -> dict[str, str]:
    return {name: version(name) for name in names}


def answers(task: Task, cases: Mapping[str, Callable[..., Case]]) -> Iterator[dict[str, Any]]:
    """One answer for each request."""
    timers: dict[str, tuple[timeit.Timer, int]] = {}
    for line in sys.stdin:
        request = json.loads(line)
        key = json.dumps(request["case"])
        case = dict(request["case"])
        if "budget" in request:
            timer, steps = timers[key]
            wall = time.perf_counter()
            n = request["n"]
            core = timer.timeit(n)
            yield {"core": core / n / steps, "wall": (time.perf_counter() - wall) / n / steps}
            continue
        try:
            began = time.process_time()
            made = cases[case.pop("kind")](task, **case)
            result = np.asarray(made.call(), dtype=float)
            ready = time.process_time() - began
            timer = timeit.Timer(made.call, timer=time.process_time)
            n, spent = 1, timer.timeit(1)
            while spent < 0.3 * request["burst"]:
                n *= 2
                spent = timer.timeit(n)
            timers[key] = timer, made.steps
            n = max(1, round(n * request["burst"] / spent))
            yield {"result": result.tolist(), "how": made.how, "n": n, "ready": ready, "steps": made.steps}
        except Exception as error:  # noqa: BLE001  # whatever it is, it is what happened to this peer
            traceback.print_exc()
            yield {"error": " ".join(f"{type(error).__name__}: {error}".split())[:200]}


def main() -> None:
    """`python worker.py MODULE FOLDER PACKAGE...`: first the versions, then an answer for each request."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the peer prints does not get among the answers
    sys.path.insert(0, str(Path(__file__).parent))
    module = importlib.import_module(sys.argv[1])
    print(json.dumps({"versions": versions(sys.argv[3:])}), file=out, flush=True)
    for answer in answers(Task(Path(sys.argv[2])), module.CASES):
        print(json.dumps(answer), file=out, flush=True)


if __name__ == "__main__":
    main()
