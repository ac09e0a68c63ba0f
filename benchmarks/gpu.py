"""Batches and sweeps on a GPU: the numbers are compared with those of the CPU, then timed, beside the GPU's own peak.

    python gpu.py

Without a GPU it says so, and ends with status 1. Goals: a tick of 4096 impedance laws of seven joints in 0.1 ms, and
200 million steps a second of a Panda in its closed loop, both in single precision.
"""

from __future__ import annotations

import ctypes
import dataclasses
import re
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rivals
from rich.console import Console
from rich.table import Table
from sweep import VARY, panda

import taut
from taut.analysis.sweeps.chunks import LaneRuns, runner_of
from taut.base.errors import TautError
from taut.codegen import cuda
from taut.codegen.llvm import WARP
from taut.codegen.native import ptx

LAWS = {
    "computed torque": taut.laws.ComputedTorque(kp=100.0, kd=20.0),
    "impedance, B": taut.laws.Impedance(K=(400.0, 20.0), B=(40.0, 4.0)),
    "impedance, zeta": taut.laws.Impedance(K=(400.0, 20.0), zeta=1.0),
}
CHAINS, REPEATS = 16, 8  # products and sums that do not wait for each other, and how often in a turn


def peak_text() -> str:
    """A kernel that does nothing but fused products and sums in registers."""
    body = [f" %c{j}.0 = phi float [%x, %entry], [%c{j}.{REPEATS}, %turn]" for j in range(CHAINS)]
    for r in range(REPEATS):
        products = ((f"%c{j}.{r + 1}", f"%c{j}.{r}") for j in range(CHAINS))
        body += [f" {new} = call float @llvm.fma.f32(float {old}, float {old}, float %x)" for new, old in products]
    sums = [f" %s{j + 1} = fadd float %s{j}, %c{j}.{REPEATS}" for j in range(CHAINS)]
    lines = "\n".join(body), "\n".join(sums)
    return f"""
define ptx_kernel void @peak(i64 %turns, ptr %out) {{
entry:
 %b = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
 %t = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
 %first = mul i32 %b, {WARP}
 %i = add i32 %first, %t
 %k = zext i32 %i to i64
 %x = uitofp i32 %i to float
 br label %turn
turn:
 %n = phi i64 [0, %entry], [%n1, %turn]
{lines[0]}
 %n1 = add i64 %n, 1
 %on = icmp slt i64 %n1, %turns
 br i1 %on, label %turn, label %end
end:
 %s0 = fadd float %x, %x
{lines[1]}
 %place = getelementptr float, ptr %out, i64 %k
 store float %s{CHAINS}, ptr %place
 ret void
}}
declare float @llvm.fma.f32(float, float, float)
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
"""


def seconds(work: Callable[[], object], rounds: int) -> float:
    """Of one of many that are queued one behind the other."""
    gpu = cuda.gpu()
    work()
    gpu.call("cuStreamSynchronize", cuda.stream())
    began = time.perf_counter()
    for _ in range(rounds):
        work()
    gpu.call("cuStreamSynchronize", cuda.stream())
    return (time.perf_counter() - began) / rounds


def peak(warps: int, turns: int, rounds: int) -> float:
    """Fused products and sums a second, in single precision."""
    gpu = cuda.gpu()
    [kernel] = gpu.functions(ptx(peak_text(), ("peak",)), "peak")
    out = gpu.room((warps * WARP,), np.dtype(np.float32))
    numbers = [ctypes.c_int64(x) for x in (turns, out.address)]
    return (
        warps * WARP * turns * CHAINS * REPEATS / seconds(lambda: gpu.launch(kernel, warps * WARP, *numbers), rounds)
    )


def there(array: Any) -> cuda.DeviceArray:
    """A copy of an array on the GPU, row by row, as a simulator has it."""
    memory, itemsize = cuda.gpu().copy(array), array.itemsize
    strides = tuple(itemsize * int(np.prod(array.shape[i + 1 :])) for i in range(array.ndim))
    return cuda.DeviceArray(cuda.gpu(), memory.address, array.shape, strides, array.dtype, memory)


def batch_row(law: taut.Law, real: Any, n: int, rounds: int) -> tuple[float, float]:
    """Seconds of a tick of n laws, and the largest difference from the CPU's doubles, of the largest torque."""
    ctrl, rng = taut.compile(law, rivals.ARM), np.random.default_rng(0)
    dtype = np.float32 if real == "float" else np.float64
    q, v = (x.astype(dtype) for x in (ctrl.arm.home + 0.3 * rng.standard_normal((n, 7)), rng.standard_normal((n, 7))))
    ref = ctrl.side.at_rest(ctrl.arm.home)
    here, batch = ctrl.batch(n), ctrl.batch(n, device="cuda", real=real)
    for path, value in ctrl.parameters.items():
        if path.startswith("law."):
            gains = np.multiply.outer(rng.uniform(0.7, 1.4, n), value)
            here.parameters[path] = batch.parameters[path] = gains
    q_there, v_there, out = there(q), there(v), there(np.zeros((n, 7), dtype))
    batch.step(q_there, v_there, ref, out=out)
    exact = here.step(q.astype(np.float64), v.astype(np.float64), ref)
    off = float(np.abs(out.numpy() - exact).max() / np.abs(exact).max())
    return seconds(lambda: batch.step(q_there, v_there, ref, out=out), rounds), off


def loop_row(real: str, samples: int, ticks: int) -> tuple[float, float, int]:
    """Steps a second of the closed loop: kernels with their copies, and the whole sweep; operations of a tick."""
    loop, kernels = panda(ticks), []
    few = taut.sweep(loop, VARY, samples=WARP, q0=rivals.CENTER)
    again = taut.sweep(loop, VARY, samples=WARP, q0=rivals.CENTER, device="cuda")
    for name, column in few.table.items():
        np.testing.assert_array_equal(again.table[name], column, err_msg=name)
    plan = dataclasses.replace(few.plan, real=real, device="cuda", samples=samples)
    runner = runner_of(plan, loop)
    assert isinstance(runner, LaneRuns)
    run = runner._code._run

    def timed(*arguments: Any) -> None:
        began = time.perf_counter()
        run(*arguments)
        kernels.append(time.perf_counter() - began)

    runner.results(0, samples)
    runner._code._run = timed
    began = time.perf_counter()
    runner.results(0, samples)
    whole, steps = time.perf_counter() - began, samples * ticks
    blocks = re.split(r"^\$.*:$", cuda.loop_kernel(runner._code), flags=re.M)
    operations = max(len(re.findall(r"^\t\w+\.rn[\w.]*\.f(?:32|64)", block, re.M)) for block in blocks)
    return steps / sum(kernels), steps / whole, operations


def main(n: int = 4096, samples: int = 65_536, ticks: int = 1000, rounds: int = 200, warps: int = 16_384) -> int:
    """Compare, measure and print."""
    try:
        cuda.gpu()
    except TautError as reason:
        print(reason)
        return 1
    name = cuda.gpu().call("cuDeviceGetName", 100, 0)
    table = Table("law", "real", "tick, ms", "off by", title=f"{n} laws of a Panda on {name.decode().rstrip(chr(0))}")
    for title, law in LAWS.items():
        for real in ("double", "float"):
            spent, off = batch_row(law, real, n, rounds)
            table.add_row(title, real, f"{1e3 * spent:.4f}", f"{off:.1e}")
    most = peak(warps, 1000 if warps > 1000 else 1, 5)
    second = Table(
        "real", "million steps/s, kernels", "whole sweep", "operations a tick", "of peak",
        title=f"{samples} loops of a Panda, {ticks} ticks; peak {1e-12 * most:.2f} T fma/s, float",
    )  # fmt: skip
    for real in ("double", "float"):
        kernels, whole, operations = loop_row(real, samples, ticks)
        part = f"{kernels * operations / most:.0%}" if real == "float" else ""
        second.add_row(real, f"{1e-6 * kernels:.1f}", f"{1e-6 * whole:.1f}", str(operations), part)
    for each in (table, second):
        Console(width=110).print(each)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
