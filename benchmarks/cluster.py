"""What a chunk costs on Ray, and from that what a billion loops need: the numbers of docs/cluster.md.

It needs Ray: .venv-extras/bin/python benchmarks/cluster.py [samples] [price of a core for an hour]
"""

from __future__ import annotations

import contextlib
import os
import pickle
import resource
import subprocess
import sys
import tempfile
import time
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import taut
from taut.analysis.sweeps import sweep as front
from taut.analysis.sweeps.chunks import runner_of
from taut.codegen.native import cores

TICKS, CHUNK, BILLION = 1000, 1024, 1_000_000_000
CENTER = [0.0, -0.3, 0.0, -1.8, 0.0, 1.5, 0.7]
VARY = {"law.kp": taut.uniform(50.0, 400.0), "law.kd": taut.uniform(10.0, 60.0)}
VARY |= {"plant.payload.mass": taut.uniform(0.0, 2.0)}
CLUSTER = Path(__file__).parents[1] / "tests" / "extras" / "ray_cluster.py"


def panda(ticks: int) -> taut.Loop:
    """Computed torque on a Panda with a payload that the law does not know, at 1 kHz: the loop of sweep.py."""
    arm = taut.load_arm("panda").with_joints(viscous=0.0)
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    frequency = [0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5]
    ref = taut.trajectories.Sine(center=CENTER, amplitude=0.3, frequency=frequency)
    plant = taut.RigidPlant(arm.with_payload(1.0, [0.0, 0.0, 0.05]), friction=None)
    return taut.Loop(ctrl, plant, ref, duration=(ticks - 1) * ctrl.dt)


def used(below: int | None = None) -> float:
    """Processor time [s] of this process and of children that ended; or of all processes below one that runs."""
    if below is None:
        of = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(each.ru_utime + each.ru_stime for each in of)
    parents, times = dict[int, int](), dict[int, float]()
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (folder / "stat").read_text().rpartition(")")[2].split()
            parents[int(folder.name)] = int(words[1])
            times[int(folder.name)] = (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def inside(pid: int) -> bool:
        return pid == below or (pid in parents and inside(parents[pid]))

    return sum(seconds for pid, seconds in times.items() if inside(pid))


@dataclass(frozen=True, kw_only=True)
class Timed:
    """A sweep and its times [s]."""

    found: Any
    first: float  # from the call to the first chunk
    chunk: float  # by the clock, from chunk to chunk
    work: float  # of processors for a chunk: of the cluster, or of this process without one
    side: float  # of processors on this side, in all


def timed(loop: taut.Loop, samples: int, cluster: int | None = None, **where: Any) -> Timed:
    """A sweep on a cluster below a process, or here."""
    last, marks = -(-samples // CHUNK), list[tuple[float, float]]()
    count, write = 0, front.Memory.write

    def watched(self: Any, results: Any) -> None:
        nonlocal count
        count += 1
        if count in (1, last):
            marks.append((time.perf_counter(), used(cluster)))
        write(self, results)

    front.Memory.write = watched  # type: ignore[method-assign]
    try:
        before, began = used(), time.perf_counter()
        found = taut.sweep(loop, VARY, samples=samples, q0=CENTER, progress=False, **where)
    finally:
        front.Memory.write = write  # type: ignore[method-assign]
    clock, work = (np.subtract(marks[-1], marks[0]) / max(1, last - 1)).tolist()
    return Timed(found=found, first=marks[0][0] - began, chunk=clock, work=work, side=used() - before)


def equal(a: Any, b: Any) -> bool:
    return all(np.asarray(a.table[name]).tolist() == np.asarray(b.table[name]).tolist() for name in a.table)


def main() -> None:
    samples = int(float(sys.argv[1])) if len(sys.argv) > 1 else 200 * CHUNK
    price = float(sys.argv[2]) if len(sys.argv) > 2 else 0.04
    folder = tempfile.TemporaryDirectory()
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": uuid.uuid4().hex, "RAY_USAGE_STATS_ENABLED": "0"}
    os.environ |= {"TAUT_CACHE_DIR": folder.name, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    pipe, loop, n = subprocess.PIPE, panda(TICKS), cores()
    with subprocess.Popen([sys.executable, str(CLUSTER)], stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL) as own:
        assert own.stdout is not None
        on = {"ray": own.stdout.readline().decode().split()[1], "cluster": own.pid}
        cold, warm, alone = timed(loop, 2, **on), timed(loop, 2, **on), timed(loop, 2, workers=1)
        short = panda(2)  # chunks of two ticks: what is left is Ray and this side
        timed(short, 64, **on)  # which compiles it
        start, empty = timed(short, 64, **on), timed(short, samples, **on)
        here, there = timed(loop, samples, workers=n), timed(loop, samples, **on)
    size = len(pickle.dumps(runner_of(here.found.plan, loop).results(0, CHUNK)))
    chunks, driver = BILLION / CHUNK, (empty.side - start.side) / (samples / CHUNK)
    print(f"""{n} cores, {samples} samples in chunks of {CHUNK}; equal tables: {equal(here.found, there.found)}
plan, once for each node                 {len(pickle.dumps(here.found.plan)) / 1e3:9.1f} kB
results of a chunk                       {size / 1e3:9.1f} kB
a chunk of next to no work, by the clock {1e3 * empty.chunk:9.2f} ms
the driver's side of it, processor time  {1e3 * driver:9.2f} ms
Ray's side of it, processor time         {1e3 * empty.work:9.2f} ms
a chunk of whole loops, processor time   {1e3 * there.work:9.1f} ms on Ray, {1e3 * here.work:.1f} ms in threads
the same by the clock                    {1e3 * there.chunk:9.1f} ms on Ray, {1e3 * here.chunk:.1f} ms in threads
call to first result                     {cold.first:9.2f} s, {warm.first:.2f} s with all in the cache
the same in threads                      {alone.first:9.2f} s
""")
    hours, busy = chunks * there.work / 3600.0, chunks * driver / 3600.0
    print(f"a billion loops, computed from these: {hours:.1f} core-hours, {hours * price:.2f} at {price:g} for each;")
    print(f"the driver is busy for {busy:.2f} h: one sweep feeds {hours / busy:.0f} cores;")
    print(f"{chunks * size / 1e9:.0f} GB of results come to it")


if __name__ == "__main__":
    main()
