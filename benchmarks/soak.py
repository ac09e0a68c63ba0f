"""A robot's loop at 1 kHz for a minute beside a busy program and the log process: `make soak`, or `soak.py SECONDS`.

`python soak.py rounds` compares the native loop in five rounds of 10 s beside that program, with as many calm ones.

The time of computing is judged: its 99.9th percentile stays under 10 us where the loop is native code throughout,
and under 100 us where a driver is Python code that keeps the time. Lateness depends on the machine, and is printed
beside it.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import taut
from taut.robots import RobotDriver, RobotInfo

BARS = {"native": 10.0, "python": 100.0}  # [us] 99.9th percentile of computing
PERCENTILES = (50.0, 99.0, 99.9, 100.0)
NAMES = ("compute", "late", "driver")
GROWTH = 512.0  # [KiB] of the loop's process


class Paced(RobotDriver):
    """Joints without mass in Python code that keeps the time."""

    def __init__(self, address: str) -> None:  # noqa: ARG002
        self.q, self.next = np.array(taut.load_arm("panda").home), 0

    def open(self) -> RobotInfo:
        self.next = time.monotonic_ns()
        return RobotInfo(name="joints", n=7, rate=1000.0, takes="torque", paced_by="robot", adds=("gravity",))

    def read(self, measured: Mapping[str, Any]) -> None:
        self.next = max(self.next + 1_000_000, time.monotonic_ns())
        time.sleep(max(0.0, 1e-9 * (self.next - time.monotonic_ns())))
        measured["q"][:] = self.q

    def write(self, command: Any) -> None: ...
    def begin(self) -> None: ...
    def end(self) -> None: ...
    def close(self) -> None: ...


def memory(pid: int) -> tuple[float, int]:
    """Resident memory [KiB] and open files of a process."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    resident = next(line for line in status.splitlines() if line.startswith("VmRSS"))
    return float(resident.split()[1]), len(list(Path(f"/proc/{pid}/fd").iterdir()))


def soak(kind: str, seconds: float, *, busy: bool = True) -> dict[str, Any]:
    """The times of all ticks of a loop, and how its process grew; calm where this program is not busy."""
    arm = taut.load_arm("panda")
    target: Any = taut.RigidPlant(arm) if kind == "native" else Paced
    data = {str(i): [0.1 * i] * 20 for i in range(2000)}
    with TemporaryDirectory() as folder, taut.connect(target, arm, log=folder if busy else None) as robot:
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm, rate=robot.rate, adds=robot.adds)
        robot.start(ctrl)
        robot.wait(1.0)
        acting, pid = robot.acting, robot.link.process.pid
        before, lost = memory(pid), robot.link.word("lost")
        seen, times = int(acting.ring.header[0]), {name: list[Any]() for name in NAMES}
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            if busy:
                json.dumps(data)
            else:
                time.sleep(0.05)
            rows, missed = acting.ring.read(seen, acting.ring.capacity)
            seen += missed + len(rows)
            for name, values in times.items():
                values.append(acting.column(rows, f"loop.{name}").copy())
        after = memory(pid)
        robot.check()
        lost = robot.link.word("lost") - lost
    all_times = {name: 1e6 * np.concatenate(values) for name, values in times.items()}
    found = {
        name: dict(zip(("p50", "p99", "p99.9", "max"), np.percentile(x, PERCENTILES).round(2).tolist(), strict=True))
        for name, x in all_times.items()
    }
    return {
        "kind": kind, "ticks": len(all_times["late"]), "lost": lost, **found,
        "overruns": int((all_times["compute"] > 1000.0).sum()), "bar [us]": BARS[kind],
        "growth [KiB]": after[0] - before[0], "files": after[1] - before[1], "notes": list(robot.link.notes),
        "load of the machine": os.getloadavg()[0] / (os.cpu_count() or 1),
    }  # fmt: skip


def rounds(count: int = 5, seconds: float = 10.0) -> None:
    """The 50th and 99th percentiles of computing, calm and beside a busy program, and their ratios in each round."""
    pairs = [[soak("native", seconds, busy=busy)["compute"] for busy in (False, True)] for _ in range(count)]
    for name in ("p50", "p99"):
        values = np.array([[one[name] for one in pair] for pair in pairs])
        calm, beside = np.median(values, axis=0)
        ratio = float(np.median(values[:, 1] / values[:, 0]))
        print(f"{name} of computing, {count} rounds: calm {calm:.1f} us, busy {beside:.1f} us, ratio {ratio:.2f}")


def main() -> int:
    """Print the figures, and 0 where the bars hold."""
    if sys.argv[1:] == ["rounds"]:
        rounds()
        return 0
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    results = [soak(kind, seconds) for kind in BARS]
    for result in results:
        print(json.dumps(result, indent=1))
    held = [r["compute"]["p99.9"] < r["bar [us]"] and r["growth [KiB]"] < GROWTH and r["files"] == 0 for r in results]
    out = Path(__file__).parents[1] / "out"
    out.mkdir(exist_ok=True)
    (out / "soak.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    print("held" if all(held) else "NOT held")
    return 0 if all(held) else 1


if __name__ == "__main__":
    import soak as module  # the loop's process imports the driver from a module

    sys.exit(module.main())
