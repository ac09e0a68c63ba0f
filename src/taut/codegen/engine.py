"""The two engines, machine code and plain Python on floats: which one runs, and that both give the same numbers."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from taut.base.checks import one_of
from taut.base.errors import TraceError, UsageError
from taut.base.types import Float64Array
from taut.codegen import native
from taut.codegen.native import NativeModule
from taut.codegen.program import Block, Function, Program

Engine: TypeAlias = Literal["native", "float"]
EngineChoice: TypeAlias = Literal["auto", "native", "float"]
ENGINES: Final[tuple[EngineChoice, ...]] = ("auto", "native", "float")
VERIFY_TOLERANCE = 1e-9  # relative to the largest number of the result; far above rounding, far below a fault
ULPS = 4.0  # by which inputs are moved to see how large rounding becomes where a state makes it large
TRIALS, LARGER = 3, 100.0  # times what they show is rounding too

EMPTY: Final = Block()
Flat: TypeAlias = tuple[Float64Array, Float64Array, Float64Array]
"""Inputs, parameters and memory."""
Bools: TypeAlias = NDArray[np.bool_]
Evaluate: TypeAlias = Callable[[Float64Array, Float64Array, Float64Array, Float64Array, Float64Array], None]
"""One evaluation on flat arrays: inputs, parameters and memory are read, new memory and outputs are written."""


@dataclass(frozen=True, eq=False)
class Steps:
    """A step and its substeps as pure functions of three blocks: what both engines run."""

    step: Function  # (inputs, parameters, memory) -> (outputs, new memory)
    inputs: Block
    parameters: Block
    memory: Block
    substep: Function | None = None  # `repeats` times after the step; its outputs do not count
    repeats: int = 0
    start: Function | None = None  # (inputs with "start.*", parameters, none) -> (the memory in the first tick, none)
    start_inputs: Block = EMPTY


def best_engine() -> Engine:
    """Machine code, or plain Python where llvmlite is missing."""
    return "native" if native.available() else "float"


def chosen_engine(engine: EngineChoice) -> Engine:
    """The engine that a caller asks for; "auto" is the best, with a warning where that is plain Python."""
    one_of("engine", engine, ENGINES)
    if engine == "float" or native.available():
        return "float" if engine == "float" else "native"
    if engine == "native":
        raise UsageError(
            "engine='native' needs llvmlite, which is not installed; pip install llvmlite, or engine='float'",
            name="engine",
        )
    native.warn_of_plain_python()
    return "float"


def plain(
    function: Function, inputs: Block, parameters: Block, memory: Block, *, new: Block, outputs: Block
) -> Evaluate:
    """A function run as plain Python on floats. It is given copies that it cannot change."""

    def evaluate(*flat: Float64Array) -> None:
        blocks = zip((inputs, parameters, memory), flat[:3], strict=True)
        given = ({path: _frozen(value) for path, value in block.views(part).items()} for block, part in blocks)
        with np.errstate(all="ignore"):
            results, after = function(*given)
        new.pack(after, flat[3])
        outputs.pack(results, flat[4])

    return evaluate


def _frozen(x: Float64Array) -> Float64Array:
    out = x.copy()
    out.flags.writeable = False
    return out if out.ndim else out[()]


def machine_code(address: int) -> Evaluate:
    """A compiled kernel."""
    function = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 5)(address)

    def evaluate(*flat: Float64Array) -> None:
        function(*(part.ctypes.data for part in flat))

    return evaluate


def verified(
    what: str,
    function: Function,
    program: Program,
    samples: Callable[[], Sequence[Flat]],
    name: str = "kernel",
) -> Callable[[NativeModule], None]:
    """A check that the compiled kernel gives what the function gives on plain floats, and that two runs agree."""
    blocks = program.inputs, program.parameters, program.memory
    evaluate = plain(function, *blocks, new=program.memory, outputs=program.outputs)

    def results_of(run: Evaluate, sample: Sequence[Float64Array]) -> list[Float64Array]:
        outputs, new = program.outputs.zeros(), sample[2].copy()
        run(sample[0], sample[1], sample[2], new, outputs)
        return [outputs, new]

    def by_rounding(sample: Flat, expected: list[Float64Array]) -> list[Float64Array]:
        """Change of the results by rounding alone: near a singularity it exceeds any fixed tolerance."""
        rng, moved = np.random.default_rng(0), [np.zeros_like(part) for part in expected]
        for _ in range(TRIALS):
            near = [x * (1.0 + ULPS * np.finfo(float).eps * rng.uniform(-1.0, 1.0, x.shape)) for x in sample]
            for largest, part, value in zip(moved, results_of(evaluate, near), expected, strict=True):
                np.maximum(largest, np.nan_to_num(np.abs(part - value), posinf=0.0), out=largest)
        return moved

    def check(module: NativeModule) -> None:
        for k, sample in enumerate(samples()):
            compiled, results = results_of(machine_code(module[name]), sample), results_of(evaluate, sample)
            again = results_of(evaluate, sample) if k == 0 else results
            if not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(results, again, strict=True)):
                raise TraceError(
                    f"{what}: two runs of the same code differ; a law must give the same at the same inputs: no "
                    "random numbers, no clock, no state outside its memory",
                    rule="a pure function",
                )
            if any(_differ(got, expected).any() for got, expected in zip(compiled, results, strict=True)):
                allowed = by_rounding(sample, results)
                for got, expected, rounding in zip(compiled, results, allowed, strict=True):
                    _require_same(what, got, expected, _differ(got, expected, LARGER * rounding))

    return check


def _differ(got: Float64Array, expected: Float64Array, rounding: Float64Array | float = 0.0) -> Bools:
    scale = max(1.0, float(np.abs(expected[np.isfinite(expected)]).max(initial=0.0)))
    atol = np.broadcast_to(VERIFY_TOLERANCE * scale + rounding, expected.shape)
    return ~np.isclose(got, expected, rtol=0.0, atol=atol, equal_nan=True)


def _require_same(what: str, got: Float64Array, expected: Float64Array, wrong: Bools) -> None:
    if wrong.any():
        raise TraceError(
            f"{what}: compiled code and plain Python differ, {got[wrong][0]:.6g} and "
            f"{expected[wrong][0]:.6g}; it does something else when it is traced, or it makes rounding "
            "errors large, such as by the root of a difference that is zero",
            rule="agrees with the plain run",
        )
