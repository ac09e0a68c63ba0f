"""Exported C against taut's machine code on this machine, and instructions, stack and size on a Cortex-M7 in QEMU.

`make firmware` runs it: it needs gcc; clang, and gcc-arm-none-eabi with qemu-system-arm, where they are there. Each
figure of time is a median of ratios of interleaved rounds, both called from the same loop in C at the same states.
"""

from __future__ import annotations

import ctypes
import re
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import taut

HERE = Path(__file__).parent / "cortex_m7"
ARM = ["arm-none-eabi-gcc", "-mcpu=cortex-m7", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv5-d16", "-O2"]
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
LOADED = taut.load_arm("panda").with_payload(1.0)
BOARD = taut.Constraint.plane(point=taut.snapshot(LOADED, LOADED.home).T().p, normal=[0.0, 0.0, 1.0])
LAWS = {
    "computed torque": taut.laws.ComputedTorque(kp=100.0, kd=20.0),
    "impedance, B": taut.laws.Impedance(K=(400.0, 20.0), B=(40.0, 4.0)),
    "impedance, zeta": taut.laws.Impedance(K=(400.0, 20.0), zeta=1.0),
    "hybrid, one row": taut.laws.HybridMotionForce(
        constraint=BOARD, motion=taut.laws.TaskComputedTorque(kp=400.0, kd=40.0), kfi=5.0, kdamp=10.0
    ),
}
TIMED = """
#include "ctrl.c"
#define AGAIN __asm__ volatile("" ::: "memory")  /* or the compiler does it once */
typedef void (*kernel)(const double *, const double *, const double *, double *, double *);
void exported(int count, const ctrl_inputs *in, const ctrl_parameters *p, const ctrl_memory *m, double *out)
{
    ctrl_memory next;
    for (int k = 0; k < count; k++) { tick(in, p, m, &next, (ctrl_outputs *)(void *)out); AGAIN; }
}
void whole(int count, const ctrl_inputs *in, const ctrl_parameters *p, ctrl_memory *m, double *out)
{
    for (int k = 0; k < count; k++) { ctrl_step(in, p, m, (ctrl_outputs *)(void *)out); AGAIN; }
}
void machine(int count, kernel f, const double *in, const double *p, const double *m, double *next, double *out)
{
    for (int k = 0; k < count; k++) f(in, p, m, next, out);
}
"""
ROUNDS, TICKS = 15, 20_000


def at_home(ctrl: taut.Controller) -> tuple[np.ndarray, ...]:
    """The controller's own blocks after a tick at home, and room for the next memory."""
    k, home = ctrl.bind(), taut.snapshot(ctrl.arm, ctrl.arm.home).T()
    k.q[:] = ctrl.arm.home
    for name, value in (("q", ctrl.arm.home), ("p", home.p), ("R", home.R)):
        if hasattr(k.ref, name):
            getattr(k.ref, name)[:] = value
    k.tick()
    blocks = ctrl._kernel.blocks
    return blocks.inputs, blocks.parameters, blocks.memory, blocks.memory.copy(), blocks.outputs


def ratios(ctrl: taut.Controller, compiler: str, folder: Path) -> tuple[float, float, float]:
    """Times of the exported tick, and of the step with its checks, over that of machine code; the last in ns."""
    taut.export_c(ctrl, folder)
    (folder / "timed.c").write_text(TIMED, encoding="utf-8")
    library = folder / f"{compiler}{ctrl.operations}.so"  # a name of its own, or the first one stays loaded
    flags = ["-std=gnu99", "-O2", "-march=native", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-o", str(library), str(folder / "timed.c"), "-lm"], check=True)
    code = ctypes.CDLL(str(library))
    inputs, parameters, memory, new, outputs = (ctypes.c_void_p(x.ctypes.data) for x in at_home(ctrl))
    kernel = ctypes.c_void_p(ctrl._kernel.module["kernel"])
    calls = {
        "exported": lambda: code.exported(TICKS, inputs, parameters, memory, outputs),
        "whole": lambda: code.whole(TICKS, inputs, parameters, memory, outputs),
        "machine": lambda: code.machine(TICKS, kernel, inputs, parameters, memory, new, outputs),
    }
    took: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            began = time.perf_counter()
            call()
            took[name].append((time.perf_counter() - began) / TICKS)
    exported, whole = (
        statistics.median(a / b for a, b in zip(took[name], took["machine"], strict=True))
        for name in ("exported", "whole")
    )
    return exported, whole, 1e9 * statistics.median(took["machine"])


def on_cortex_m7(ctrl: taut.Controller, real: str, folder: Path) -> tuple[int, int, int, float]:
    """Instructions a step, bytes of stack and of code, largest difference from Python [N m] in QEMU."""
    taut.export_c(ctrl, folder, real=real)
    test = (
        (folder / "ctrl_test.c").read_text(encoding="utf-8").replace("int main(void)", "static int self_test(void)")
    )
    (folder / "main.c").write_text(test + (HERE / "measure.c").read_text(encoding="utf-8"), encoding="utf-8")
    subprocess.run([*ARM, *STRICT, "-c", "ctrl.c"], cwd=folder, check=True)
    link = ["-std=gnu99", "--specs=rdimon.specs", "-T", str(HERE / "layout.ld"), str(HERE / "start.c")]
    subprocess.run([*ARM, *link, "main.c", "ctrl.o", "-lm", "-o", "ctrl.elf"], cwd=folder, check=True)
    size = subprocess.run(["arm-none-eabi-size", "ctrl.o"], cwd=folder, check=True, capture_output=True, text=True)
    qemu = ["qemu-system-arm", "-M", "mps2-an500", "-nographic", "-semihosting", "-icount", "shift=0"]
    run = subprocess.run(
        [*qemu, "-kernel", "ctrl.elf"], cwd=folder, check=False, capture_output=True, text=True, timeout=60
    )
    found = re.search(r"at most (\S+) off.*instructions (\d+), stack (\d+), failed 0", run.stdout, re.DOTALL)
    if found is None:
        raise SystemExit(f"the self-test failed on the Cortex-M7: {run.stdout} {run.stderr}")
    return int(found[2]), int(found[3]), int(size.stdout.splitlines()[1].split()[0]), float(found[1])


def main() -> None:
    """Both tables."""
    console = Console(width=110)
    compilers = [name for name in ("gcc", "clang") if shutil.which(name)]
    table = Table("law", "operations", "machine code [ns]", *(f"{each}: tick, step [x]" for each in compilers))
    table.title = "exported C at -O2 -march=native over taut's machine code; step: with checks, memory kept"
    with tempfile.TemporaryDirectory() as folder:
        for name, law in LAWS.items():
            ctrl = taut.compile(law, LOADED)
            found = [ratios(ctrl, compiler, Path(folder)) for compiler in compilers]
            cells = (f"{tick:.2f}, {step:.2f}" for tick, step, _ in found)
            table.add_row(name, str(ctrl.operations), f"{found[0][2]:.0f}", *cells)
        console.print(table)
        if not (shutil.which(ARM[0]) and shutil.which("qemu-system-arm")):
            console.print("Cortex-M7: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm")
            return
        table = Table("law", "real", "instructions a step", "stack [B]", "code [B]", "off Python [N m]")
        table.title = "Cortex-M7 in QEMU, -O2; limits of torque, checks of all numbers included"
        for name, law in LAWS.items():
            ctrl = taut.compile(law, LOADED, limits=taut.Limits.of(LOADED))
            for real in ("float", "double"):
                count, stack, size, off = on_cortex_m7(ctrl, real, Path(folder))
                table.add_row(name, real, f"{count:,}", f"{stack:,}", f"{size:,}", f"{off:.2g}")
        console.print(table)


if __name__ == "__main__":
    main()
