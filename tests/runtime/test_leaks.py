"""Runs, loops and controllers release their code: nothing is left of them when their owner goes."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.codegen import native
from taut.codegen.native import NativeModule

WHOLE = bool(os.environ.get("TAUT_BARS"))  # `make bars`
ARM = taut.load_arm("one_joint")
LAW = taut.laws.GravityPID(kp=2.0, kd=1.0)
WARM = 130  # runs after which Python's and LLVM's own tables are as large as they become
MORE_MAPS = 100  # of memory: a linker of 64 libraries has some that are waiting to be released
MORE_MEMORY = 20_000  # [kB]

linux = pytest.mark.skipif(sys.platform != "linux", reason="counts what Linux shows in /proc")


def maps() -> int:
    return len(Path("/proc/self/maps").read_text(encoding="utf-8").splitlines())


def resident() -> int:
    """Memory in use [kB]: what the allocator holds for later is given back first."""
    ctypes.CDLL(None).malloc_trim(0)
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1])


def modules() -> int:
    """Native libraries that are alive."""
    return sum(isinstance(thing, NativeModule) for thing in gc.get_objects())


@pytest.fixture
def no_collector() -> Iterator[None]:
    """What is released is released at once, without the collector of cycles."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def phases() -> list[taut.Phase]:
    return [
        taut.Phase(LAW, taut.JointMotion(q=[0.1]), until=lambda x: x.elapsed > 0.004, name="go"),
        taut.Phase(LAW, name="rest"),
    ]


@pytest.mark.part(1)
@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize("law", [LAW, phases()], ids=["law", "task"])
def test_a_loop_goes_with_its_last_owner(law: Any, engine: Any, no_collector: None) -> None:
    ctrl, plant = taut.compile(law, ARM, engine=engine), taut.RigidPlant(ARM)
    before = modules()
    loop = taut.Loop(ctrl, plant, duration=0.01)
    first = taut.run(loop)
    assert modules() == before + (engine == "native")
    gone = weakref.ref(loop)
    del loop
    assert gone() is None
    kept = engine == "native" and law is LAW  # with the controller, for its last plant; not of a user's guard
    again = taut.run(taut.Loop(ctrl, plant, duration=0.01))
    np.testing.assert_array_equal(again.q, first.q)
    assert modules() == before + kept
    taut.run(ctrl, taut.RigidPlant(ARM), duration=0.01)
    assert modules() == before + kept
    gone = weakref.ref(ctrl.side)
    del ctrl
    gc.collect()
    assert gone() is None
    assert modules() <= before


def test_a_run_leaves_nothing_behind(no_collector: None) -> None:
    ctrl, plant = taut.compile(LAW, ARM), taut.RigidPlant(ARM)
    taut.run(ctrl, plant, duration=0.002)
    before = modules()
    for _ in range(5):
        taut.run(ctrl, plant, duration=0.002)
        assert modules() == before


def grows(step: Callable[[], object], times: int) -> tuple[int, int]:
    """How many maps and how much memory [kB] so many steps leave, after some to get warm."""
    for _ in range(WARM):
        step()
    gc.collect()
    at = maps(), resident()
    for _ in range(times):
        step()
    gc.collect()
    return maps() - at[0], resident() - at[1]


@pytest.mark.long
@linux
@pytest.mark.bars
def test_runs_in_one_process_hold_a_constant_memory(bar: Callable[[str, object], None]) -> None:
    """Each once left two maps, of which a process has 65,530."""
    ctrl, plant = taut.compile(LAW, ARM), taut.RigidPlant(ARM)
    runs = 100_000 if WHOLE else 150
    more_maps, more_memory = grows(lambda: taut.run(ctrl, plant, duration=0.002), runs)
    bar(
        "row 19: short runs in one process, more memory maps, more memory [kB]", f"{runs}, {more_maps}, {more_memory}"
    )
    assert more_maps < MORE_MAPS
    assert more_memory < MORE_MEMORY


@linux
@pytest.mark.bars
@pytest.mark.skipif(not WHOLE, reason="some hundred compiles would not show in the memory of a process")
def test_compiles_in_one_process_hold_a_constant_memory(bar: Callable[[str, object], None]) -> None:
    """Each once left 9 kB in LLVM's linker."""
    compiles = 10_000
    more_maps, more_memory = grows(lambda: taut.compile(LAW, ARM), compiles)
    bar(
        "row 19: compiles in one process, more memory maps, more memory [kB]",
        f"{compiles}, {more_maps}, {more_memory}",
    )
    assert more_maps < MORE_MAPS
    assert more_memory < MORE_MEMORY


def test_code_outlives_the_linker_that_made_it() -> None:
    """A linker is left for a new one after 64 libraries, and goes with the last of them."""
    functions = [taut.native(lambda x, k=k: k * x, x=2) for k in range(1, 4)]
    linkers = native._jit.cache_info().misses
    for _ in range(130):
        taut.native(lambda x: 0.5 * x, x=2)
    gc.collect()
    assert native._jit.cache_info().misses - linkers >= 2
    for k, function in enumerate(functions, start=1):
        np.testing.assert_array_equal(function(np.array([1.0, -2.0])), [k, -2.0 * k])
    del functions, function
    gc.collect()
    np.testing.assert_array_equal(taut.native(lambda x: 3.0 * x, x=2)(np.ones(2)), [3.0, 3.0])
