"""A robot's loop at 1 kHz for a minute beside a busy program and the log process: `make soak`, or `soak.py SECONDS`.

`soak.py c SECONDS` and `soak.py sweep SECONDS` compare in five interleaved rounds the native loop, which has its log
process, with a plain loop in C (soak.c, gcc -O2) that computes the same tick, checks and limits included; and the
same beside a sweep on the other core with the loop alone, without sweep and log.

The time of computing is judged: its 99.9th percentile stays under 10 us where the loop is native code throughout,
and under 100 us where a driver is Python code that keeps the time. Lateness depends on the machine, and is printed
beside it, with what the system took from the loop's thread meanwhile.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import taut
from taut.codegen.c import DOUBLE, body, prelude
from taut.codegen.program import trace
from taut.codegen.servo_loop import ROW_HEAD
from taut.robots import Robot, RobotDriver, RobotInfo

HERE = Path(__file__).parent
BARS = {"native": 10.0, "python": 100.0}  # [us] 99.9th percentile of computing
RATIOS = {"c": 1.5, "sweep": 1.25}
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}
NAMES = ("compute", "late", "driver", "lost")
GROWTH = 512.0  # [KiB] of the loop's process
ROUNDS, PERIOD = 5, 1000.0  # [us]
Times = dict[str, Any]  # of all ticks, by name [us]


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
        measured["q"][:], measured["v"][:] = self.q, 0.0

    def write(self, command: Any) -> None: ...
    def begin(self) -> None: ...
    def end(self) -> None: ...
    def close(self) -> None: ...


@contextmanager
def acting(kind: str, log: str | None = None, core: int | None = None) -> Iterator[Robot]:
    """A Panda under computed torque, which no missed period ends; `core` is where the loop's thread runs."""
    arm = taut.load_arm("panda")
    target: Any = taut.RigidPlant(arm) if kind == "native" else Paced
    with taut.connect(target, arm, limits=taut.SafetyLimits.of(arm, missed=1e9), log=log) as robot:
        robot.link.set_word("patience", 10**10)  # of the watchdog [ns]
        if core is not None:
            os.sched_setaffinity(robot.link.process.pid, {core})
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm, rate=robot.rate, adds=robot.adds)
        robot.start(ctrl)
        robot.wait(1.0)
        yield robot


def scheduled(pid: int) -> tuple[float, float]:
    """How long the loop's thread was on a processor, and was ready but not on one [us]."""
    ran, waited, _ = map(float, Path(f"/proc/{pid}/task/{pid}/schedstat").read_text(encoding="utf-8").split())
    return 1e-3 * ran, 1e-3 * waited


def counters(pid: int) -> dict[str, float]:
    """What the system counts of the loop's process, and of its thread."""
    process, thread = Path(f"/proc/{pid}"), Path(f"/proc/{pid}/task/{pid}")
    resident = re.findall(r"VmRSS:\s+(\d+)", (process / "status").read_text(encoding="utf-8"))
    stat = (thread / "stat").read_text(encoding="utf-8").rpartition(") ")[2].split()
    ran, waited = scheduled(pid)
    stolen = int(Path("/proc/stat").read_text(encoding="utf-8").split(maxsplit=9)[8])
    return {
        "memory [KiB]": float(resident[0]),
        "files": len(list((process / "fd").iterdir())),
        "page faults": int(stat[7]) + int(stat[9]),
        "on a processor [ms]": 1e-3 * ran,
        "ready, but not on one [ms]": 1e-3 * waited,
        "taken from the machine by its host [ms]": 1e3 * stolen / os.sysconf("SC_CLK_TCK"),
    }


def ticks(robot: Robot, seconds: float, work: Callable[[], object]) -> Times:
    """The times of all ticks, while this program works; and how long the thread waited around each [us]."""
    law, times = robot.acting, {name: list[Any]() for name in (*NAMES, "waited")}
    seen, until, pid = int(law.ring.header[0]), time.monotonic() + seconds, robot.link.process.pid
    before = scheduled(pid)[1]
    while time.monotonic() < until:
        work()
        rows, missed = law.ring.read(seen, law.ring.capacity)
        seen += missed + len(rows)
        waited = scheduled(pid)[1]
        times["waited"].append(np.full(len(rows), waited - before))
        before = waited
        for name in NAMES:
            times[name].append(law.column(rows, f"loop.{name}") * (1.0 if name == "lost" else 1e6))
    robot.check()
    return {name: np.concatenate(values) for name, values in times.items()}


def soak(kind: str, seconds: float) -> dict[str, Any]:
    """The figures of a loop beside a busy program, and how its counters grew."""
    data = {str(i): [0.1 * i] * 20 for i in range(2000)}
    with TemporaryDirectory() as folder, acting(kind, folder) as robot:
        before = counters(robot.link.process.pid)
        times = ticks(robot, seconds, lambda: json.dumps(data))
        grown = {name: x - before[name] for name, x in counters(robot.link.process.pid).items()}
        notes = list(robot.link.notes)
    over = np.flatnonzero(times["compute"] > PERIOD)
    return {
        "kind": kind, "ticks": len(times["late"]), "lost": int(times["lost"].sum()),
        **{name: {key: round(float(np.percentile(times[name], x)), 2) for key, x in PERCENTILES.items()}
           for name in NAMES[:3]},
        "bar [us]": BARS[kind], "ticks above it": int((times["compute"] > BARS[kind]).sum()),
        "overruns [tick, us, waited around it]": [
            [int(k), *(round(float(times[name][k])) for name in ("compute", "waited"))] for k in over
        ],
        "meanwhile": grown, "notes": notes, "load of the machine": os.getloadavg()[0] / (os.cpu_count() or 1),
    }  # fmt: skip


def c_loop(folder: Path, core: int) -> Path:
    """The program of soak.c, with the tick and the numbers of a loop that acts."""
    with acting("native", core=core) as robot:
        made, row = robot.acting.made, robot.acting.rows(1)[0]
    blocks = {"inputs": made.inputs, "parameters": made.parameters, "memory": made.memory}
    program = trace(made._tick, *blocks.values())
    first, lines = len(ROW_HEAD), [prelude(DOUBLE, program)]
    for name, block in (*blocks.items(), ("recorded", made.outputs)):
        numbers = ", ".join(float(x).hex() for x in row[first : first + block.size])
        lines.append(f"static double {name}[{block.size}] = {{{numbers}}};")
        first += block.size
    lines.append(f"enum {{ MEMORY = {made.memory.size}, OUTPUTS = {made.outputs.size} }};")
    heads = ", ".join([*(f"const double *{name}" for name in blocks), "double *new", "double *outputs"])
    lines += [f"static void tick({heads})", "{", *body(program, DOUBLE, lambda block, k: f"{block}[{k}]"), "}"]
    (folder / "tick.h").write_text("\n".join(lines), encoding="utf-8")
    command = ["gcc", "-std=gnu99", "-O2", "-march=native", f"-I{folder}", str(HERE / "soak.c"), "-lm"]
    subprocess.run([*command, "-o", str(folder / "soak")], check=True)
    return folder / "soak"


def in_c(program: Path, seconds: float, core: int) -> Times:
    command = ["taskset", "-c", str(core), str(program), str(round(1e6 * seconds / PERIOD))]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
    late, compute = 1e-3 * np.frombuffer(done.stdout, dtype=np.int64).reshape(-1, 2).T
    return {"late": late, "compute": compute}


def native(seconds: float, core: int, *, log: bool = True, swept: int | None = None) -> Times:
    """The native loop, beside a sweep on the core `swept`."""
    command = ["taskset", "-c", str(swept), sys.executable, __file__, "load"]
    load = None if swept is None else subprocess.Popen(command)
    try:
        with TemporaryDirectory() as folder, acting("native", folder if log else None, core) as robot:
            return ticks(robot, seconds, lambda: time.sleep(0.05))
    finally:
        if load is not None:
            load.kill()
            load.wait()


def load() -> None:
    """Sweeps of a Panda without end."""
    arm = taut.load_arm("panda")
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    while True:
        taut.sweep(ctrl, {"law.kp": taut.uniform(50.0, 400.0)}, taut.RigidPlant(arm), samples=1024, duration=1.0)


def compare(kind: str, seconds: float) -> bool:
    """Print percentiles of both sides, medians of the rounds, and their ratios; whether those of computing hold."""
    cores, held = sorted(os.sched_getaffinity(0)), True
    with TemporaryDirectory() as folder:
        if kind == "c":
            program = c_loop(Path(folder), cores[0])
            sides = {"taut": lambda: native(seconds, cores[0]), "C": lambda: in_c(program, seconds, cores[0])}
        else:
            sides = {
                "beside a sweep and the log": lambda: native(seconds, cores[0], swept=cores[-1]),
                "alone": lambda: native(seconds, cores[0], log=False),
            }
        rounds = [[measure() for measure in sides.values()] for _ in range(ROUNDS)]
    print(f"{ROUNDS} rounds of {seconds:g} s: {' over '.join(sides)}")
    for name, parts in {"computing": ["compute"], "deadline to command": ["late", "compute"]}.items():
        for key in ("p50", "p99"):
            values = [[np.percentile(sum(x[p] for p in parts), PERCENTILES[key]) for x in both] for both in rounds]
            ratio = float(np.median(np.divide(*np.transpose(values))))
            first, second = np.median(values, axis=0)
            print(f"{key} of {name}: {first:.2f} us, {second:.2f} us, ratio {ratio:.2f}")
            held &= ratio <= RATIOS[kind] or (kind == "sweep" and name != "computing")
    return held


def main() -> int:
    """Print the figures, and 0 where the bars hold."""
    kind = sys.argv[1] if sys.argv[1:] and sys.argv[1].isalpha() else ""
    seconds = float(sys.argv[-1]) if sys.argv[1:] and sys.argv[-1] != kind else 10.0 if kind else 60.0
    if kind == "load":
        load()
    if kind:
        held = compare(kind, seconds)
    else:
        results = [soak(one, seconds) for one in BARS]
        print(json.dumps(results, indent=1))
        held = all(
            one["compute"]["p99.9"] < one["bar [us]"]
            and one["meanwhile"]["memory [KiB]"] < GROWTH
            and one["meanwhile"]["files"] == 0
            for one in results
        )
        out = HERE.parent / "out"
        out.mkdir(exist_ok=True)
        (out / "soak.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
    print("held" if held else "NOT held")
    return 0 if held else 1


if __name__ == "__main__":
    import soak as module  # the loop's process imports the driver from a module

    sys.exit(module.main())
