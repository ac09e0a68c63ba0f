"""Sweeps against single runs, of one core and two, and docs/images/sweep.png.

docs/benchmarks.md shows the figures, beside those of peers: `make bench-peers`.
Here: python sweep.py ROUNDS, or python sweep.py million (seconds and megabytes).
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import rivals
from matplotlib.backends.backend_agg import FigureCanvasAgg

import taut
from taut.analysis.sweeps.chunks import runner_of
from taut.codegen.functions import DOUBLE, SINGLE
from taut.codegen.loop import known_loop
from taut.codegen.native import host_lanes
from taut.runtime.events import Schedule
from taut.runtime.ongoing import FusedRun

TICKS, RUN_TICKS, RUNS = 1000, 2000, 20
CHUNK = 1024
VARY = {"law.kp": taut.uniform(50.0, 400.0), "law.kd": taut.uniform(10.0, 60.0)}
VARY |= {"plant.payload.mass": taut.uniform(0.0, 2.0)}


def panda(ticks: int = TICKS) -> taut.Loop:
    """Computed torque on a Panda with a payload that the law does not know: 1 kHz, nothing in contact."""
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), rivals.ARM)
    ref = taut.trajectories.Sine(center=rivals.CENTER, amplitude=rivals.AMPLITUDE, frequency=rivals.FREQUENCY)
    loaded = rivals.ARM.with_payload(1.0, rivals.PAYLOAD_COM)
    return taut.Loop(ctrl, taut.RigidPlant(loaded, friction=None), ref, duration=(ticks - 1) * ctrl.dt)


def scalar(loop: taut.Loop) -> Callable[[], object]:
    """The library's own loop over the same ticks, everything recorded."""
    schedule = Schedule(loop.side, loop.plant, loop.parameters, (), loop.ticks)
    fused = FusedRun(loop, np.array(rivals.CENTER), np.zeros(7), 0, schedule)
    state = fused._state.copy()
    fused.go(lambda _: None, None)
    code, out = known_loop(loop), np.zeros_like(fused.tape.output_rows)
    assert code is not None
    code.expect(None)
    return lambda: code.run(fused.tape.input_rows, fused._values, state.copy(), out)


def speed(work: Callable[[], object], steps: int, clock: Callable[[], float]) -> float:
    began = clock()
    work()
    return 1e-6 * steps / max(clock() - began, 1e-9)


def both(work: Callable[[], object]) -> None:
    """The same work in two threads at once."""
    other = threading.Thread(target=work)
    other.start()
    work()
    other.join()


def measured(rounds: int) -> dict[str, list[float]]:
    """Million steps a second of each case, round by round."""
    loop, longer = panda(), panda(RUN_TICKS)
    found = taut.sweep(loop, VARY, samples=CHUNK, q0=rivals.CENTER)
    plans = {real: dataclasses.replace(found.plan, real=real) for real in ("double", "float")}
    lanes = {real: runner_of(plan, loop) for real, plan in plans.items()}
    chunk = {real: lambda runner=runner: runner.results(0, CHUNK) for real, runner in lanes.items()}
    core, wall = time.thread_time, time.perf_counter

    def runs() -> None:
        for _ in range(RUNS):
            taut.run(longer, q0=rivals.CENTER)

    cases = {
        "scalar": (scalar(loop), TICKS, core),
        "double": (chunk["double"], CHUNK * TICKS, core),
        "float": (chunk["float"], CHUNK * TICKS, core),
        "double, wall": (chunk["double"], CHUNK * TICKS, wall),
        "double, two threads, wall": (lambda: both(chunk["double"]), 2 * CHUNK * TICKS, wall),
        "double, two threads, each": (lambda: both(chunk["double"]), 2 * CHUNK * TICKS, time.process_time),
        "taut.run": (runs, RUNS * RUN_TICKS, core),
    }
    for work, _, _ in cases.values():
        work()
    out: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(rounds):
        for name, case in cases.items():
            out[name].append(speed(*case))
    return out


def ratio(found: dict[str, list[float]], name: str, over: str) -> float:
    return statistics.median(a / b for a, b in zip(found[name], found[over], strict=True))


def picture(file: Path) -> None:
    """Where the error of computed torque comes from: a payload that it does not know."""
    found = taut.sweep(panda(), VARY, samples=4000, q0=rivals.CENTER).table
    figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
    points = axes.scatter(
        found["plant.payload.mass"], 1e3 * found["rms_error"], c=found["law.kp"], s=4, cmap="viridis"
    )
    axes.set(xlabel="payload that the law does not know [kg]", ylabel="RMS error [mrad]", yscale="log")
    figure.colorbar(points, label="kp [1/s²]")
    figure.savefig(file, dpi=130)


def answers(file: Path) -> None:
    """A Panda that holds its pose under a payload that its law does not know: bands above shares."""
    panda = taut.load_arm("panda")
    kp, kd = [600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0], [50.0, 50.0, 50.0, 20.0, 20.0, 20.0, 10.0]
    ctrl = taut.compile(taut.laws.GravityPID(kp=kp, kd=kd), panda)
    loop = taut.Loop(ctrl, taut.RigidPlant(panda), taut.JointMotion(q=panda.home), duration=2.0)
    vary = {
        "plant.payload.mass": taut.uniform(0.0, 3.0),
        "plant.payload.com": taut.uniform([-0.1, -0.1, 0.0], [0.1, 0.1, 0.2]),
        "law.kp[3]": taut.uniform(200.0, 800.0),
        "q0": taut.uniform(panda.home - 0.1, panda.home + 0.1),
    }
    bounds = {"final_error": (0.0, 0.03)}
    found = taut.sweep(loop, vary, samples=2000, metrics=["final_error"], success=bounds)
    print(found)
    drawn = []
    for draw in found.content().figures.values():
        canvas = FigureCanvasAgg(draw())
        canvas.figure.set_dpi(130)
        canvas.draw()
        drawn.append(np.asarray(canvas.buffer_rgba())[..., :3])
    width = max(image.shape[1] for image in drawn)
    padded = [np.pad(x, ((0, 0), (0, width - x.shape[1]), (0, 0)), constant_values=255) for x in drawn]
    plt.imsave(file, np.vstack(padded))


def ratios(found: dict[str, list[float]]) -> dict[str, float]:
    """What lanes and threads bring, as medians over the rounds."""
    return {
        "double lanes over the scalar loop, one core": ratio(found, "double", "scalar"),
        "float lanes over the scalar loop, one core": ratio(found, "float", "scalar"),
        "two threads over one": ratio(found, "double, two threads, wall", "double, wall"),
        "two threads over one, by processor time": 2.0 * ratio(found, "double, two threads, each", "double"),
    }


def million(samples: int = 1_000_000) -> tuple[float, float]:
    """Time of a million loops of 1 s [s], and the peak memory of a process that does nothing else [MB]."""
    began = time.perf_counter()
    found = taut.sweep(panda(), VARY, samples=samples, q0=rivals.CENTER, metrics=["rms_error"])
    assert found.completed.all()
    took, status = time.perf_counter() - began, Path("/proc/self/status").read_text(encoding="utf-8")
    peak = next(line for line in status.splitlines() if line.startswith("VmHWM"))  # ru_maxrss has the parent's too
    return took, float(peak.split()[1]) / 1024.0


def main() -> None:
    if sys.argv[1:] == ["million"]:
        print(*million())
        return
    found = measured(int(sys.argv[1]) if len(sys.argv) > 1 else 7)
    print(f"lanes of this processor: {host_lanes(DOUBLE)} double, {host_lanes(SINGLE)} float\n")
    for name, values in found.items():
        print(f"{name:28s} {statistics.median(values):8.3f} M steps/s")
    for name, value in ratios(found).items():
        print(f"{name:45s} {value:6.2f}")
    images = Path(__file__).parents[1] / "docs" / "images"
    picture(images / "sweep.png")
    answers(images / "sweep_answers.png")


if __name__ == "__main__":
    main()
