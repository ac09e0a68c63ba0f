"""ctrl.batch of 4096 laws against the scalar tick, one core: the table of docs/tensors.md.

`make bench` runs it, as `python batch.py` in this folder does. Each figure is a median of ratios of interleaved
rounds in the time of one thread, so that other work on the machine does not count; each case computes for the same
time in its turn. States and gains differ in every lane; putting them into lanes, and the checks of all numbers, are
part of it.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from timing import Timing, interleaved

import taut
from taut.codegen.functions import DOUBLE, SINGLE
from taut.codegen.native import host_lanes

N, ROUNDS = 4096, 15
ARM = taut.load_arm("panda")
LAWS: dict[str, tuple[Any, dict[str, float]]] = {
    "computed torque": (taut.laws.ComputedTorque(kp=100.0, kd=20.0), {}),
    "impedance, B": (taut.laws.Impedance(K=(400.0, 20.0), B=(40.0, 4.0)), {}),
    "impedance, zeta": (taut.laws.Impedance(K=(400.0, 20.0), zeta=1.0), {"double": 3.5, "float": 5.5}),
}


def cases(ctrl: taut.Controller) -> dict[str, Any]:
    """The scalar tick N times, a batch of doubles and one of floats; the last with as many operations as one lane."""
    rng = np.random.default_rng(0)
    q, v = ARM.home + 0.3 * rng.standard_normal((N, 7)), 0.3 * rng.standard_normal((N, 7))
    ref = ctrl.side.at_rest(ARM.home)
    k = ctrl.bind()
    k.q[:], k.v[:] = q[0], v[0]
    for name in ref.fields(7):
        getattr(k.ref, name)[...] = getattr(ref, name)
    out: dict[str, Any] = {"scalar": k.tick}
    for real, dtype in (("double", np.float64), ("float", np.float32)):
        batch = ctrl.batch(N, real=real, threads=1)
        for path, value in ctrl.parameters.items():
            if path.startswith("law."):
                batch.parameters[path] = np.multiply.outer(rng.uniform(0.7, 1.4, N), value)
        fields = {name: np.asarray(getattr(ref, name), dtype) for name in ref.fields(7)}
        wanted = {name: np.tile(value, (N, *[1] * value.ndim)) for name, value in fields.items()}
        given = {"q": q.astype(dtype), "v": v.astype(dtype), "ref": wanted, "out": np.empty((N, 7), dtype)}
        batch.step(**given)
        assert batch.finite.all()
        out[real] = lambda batch=batch, given=given: batch.step(**given)
    return out


def deviation(ctrl: taut.Controller) -> float:
    """Largest difference of a torque in single precision [N m] relative to the largest torque, over random states."""
    rng, few, many = np.random.default_rng(1), ctrl.batch(N, real="float"), ctrl.batch(N)
    q, v = ARM.home + 0.3 * rng.standard_normal((N, 7)), 0.3 * rng.standard_normal((N, 7))
    ref = ctrl.side.at_rest(ARM.home)
    exact, rounded = many.step(q, v, ref), few.step(q.astype(np.float32), v.astype(np.float32), ref)
    return float(np.abs(exact - rounded).max() / np.abs(exact).max())


def main() -> int:
    """Measure, print, and name the targets that are missed."""
    title = f"{N} laws on the Panda, one core, {host_lanes(DOUBLE)} doubles or {host_lanes(SINGLE)} floats a lane"
    table = Table(
        "law",
        "operations",
        "scalar tick, ns",
        "double, ns; factor",
        "float, ns; factor",
        "float is off by",
        title=title,
    )
    figures, missed = {}, []
    for name, (law, bars) in LAWS.items():
        ctrl = taut.compile(law, ARM)
        found: dict[str, Timing] = interleaved(cases(ctrl), rounds=ROUNDS, clock=time.thread_time)
        cells = []
        for real in ("double", "float"):
            factor = N * found[real].times_faster_than(found["scalar"])
            cells.append(f"{found[real].median / N * 1e9:.0f}; {factor:.1f}")
            figures[f"batch, {name}, {real}"] = {"value": factor, "bar": bars.get(real)}
            missed += [f"{name}, {real}"] if factor < bars.get(real, 0.0) else []
        off = deviation(ctrl)
        table.add_row(name, str(ctrl.operations), f"{found['scalar'].median * 1e9:.0f}", *cells, f"{off:.1e}")
    Console(width=120).print(table)
    Path("out").mkdir(exist_ok=True)
    Path("out/batch.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    print(f"targets missed: {', '.join(missed)}" if missed else "all targets are met")
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
