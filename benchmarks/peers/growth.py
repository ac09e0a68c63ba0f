"""How the cost of taut grows: with joints, laws, lanes, threads and samples."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
import run
import sweep
from task import arm_of
from timing import interleaved

import taut
from taut.codegen.functions import DOUBLE, SINGLE
from taut.codegen.native import host_lanes

SAMPLES: Final = (1, 10, 100, 1000, 10_000)
STIFFNESS: Final = {"K": (800.0, 30.0)}
POSTURE: Final = taut.laws.Posture()
LAWS: Final = {
    "PID": taut.laws.PID(kp=100.0, ki=10.0, kd=20.0),
    "GravityPID": taut.laws.GravityPID(kp=100.0, ki=10.0, kd=20.0),
    "ComputedTorque": taut.laws.ComputedTorque(kp=100.0, kd=20.0),
    "Adaptive, payload": taut.laws.Adaptive(lam=10.0, k=10.0, gamma=5.0, max_payload=2.0),
    "Impedance(K, B), null=None": taut.laws.Impedance(**STIFFNESS, B=(50.0, 3.0), null=None),
    "Impedance(K, B)": taut.laws.Impedance(**STIFFNESS, B=(50.0, 3.0), null=POSTURE),
    "Impedance(K, zeta)": taut.laws.Impedance(**STIFFNESS, zeta=0.7, null=POSTURE),
    "TaskComputedTorque": taut.laws.TaskComputedTorque(kp=100.0, kd=20.0, null=POSTURE),
}


def laws(rounds: int) -> list[list[Any]]:
    """Name, operations and bound tick [us] of each law on the Panda, at home and at rest."""
    arm = arm_of("panda")
    ctrls = {name: taut.compile(law, arm) for name, law in LAWS.items()}
    bound = {name: ctrl.bind() for name, ctrl in ctrls.items()}
    for each in bound.values():
        each.q[:] = arm.home
        if "q" in dir(each.ref):
            each.ref.q[:] = arm.home
        else:
            T = taut.snapshot(arm, arm.home).T()
            each.ref.p[:], each.ref.R[:] = T.p, T.R
    times = interleaved({name: each.tick for name, each in bound.items()}, rounds=rounds, budget=0.03)
    return [[name, ctrl.operations, 1e6 * times[name].median] for name, ctrl in ctrls.items()]


def samples(rounds: int) -> list[list[float]]:
    """Samples, and the time of a sweep of them on all cores from the call to the table [s]."""
    loop, seconds = sweep.panda(), dict[int, list[float]]()
    for count in SAMPLES * rounds:
        began = time.perf_counter()
        taut.sweep(loop, sweep.VARY, samples=count, q0=sweep.rivals.CENTER, metrics=["rms_error"], progress=False)
        seconds.setdefault(count, []).append(time.perf_counter() - began)
    return [[count, statistics.median(values)] for count, values in seconds.items()]


def million() -> list[float]:
    """Seconds and megabytes of a million loops of 1 s, in a process of their own."""
    command = [sys.executable, str(Path(sweep.__file__)), "million"]
    out = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    return [float(x) for x in out.split()[-2:]]


def measured(rounds: int) -> dict[str, Any]:
    """All of it."""
    lanes = sweep.measured(rounds)
    return {
        "lanes": {"double": host_lanes(DOUBLE), "float": host_lanes(SINGLE)},
        "speeds": {name: float(np.median(values)) for name, values in lanes.items()},  # million steps a second
        "ratios": sweep.ratios(lanes),
        "laws": laws(rounds),
        "joints": run.size_figures(),
        "samples": samples(rounds),
        "million": million(),
    }
