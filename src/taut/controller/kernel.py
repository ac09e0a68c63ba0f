"""The compiled part of a control side: its tick as a function of blocks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from taut.base.errors import NumericalError, RangeError, TautError, UsageError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen import native
from taut.codegen.engine import Engine, Flat
from taut.codegen.kernel import Blocks, Call, Kernel
from taut.codegen.program import Block, Values, failure
from taut.control.command import WildTerm, wild_term
from taut.control.lawside import HELD, KNOWN, LawSide, Probe
from taut.control.trajectories.reference import Sample
from taut.maths.snapshot import measurement_shapes

DT: Final = "dt"  # the period stands beside the parameters, so that code serves every rate


class SideFunctions:
    """Tick and start of a control side as functions of blocks."""

    def __init__(self, side: LawSide, *, record: bool, sensed: tuple[str, ...] = ()) -> None:
        self._side = side
        self._record = record
        self._sensed = sensed

    def tick(self, inputs: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:
        """One tick: the command, what is recorded, and new memory."""
        tick = self._side.tick(self._measured(inputs), self._sample(inputs), memory, parameters, parameters[DT])
        out = {} if tick.mit is None else {"mit": tick.mit}
        out["command"] = tick.command
        if self._record:
            out |= {f"terms.{name}": value for name, value in tick.terms.items()}
        out |= {f"sensed.{name}": tick.seen[name] for name in self._sensed}
        if self._record:
            out |= {name: tick.seen[name] for name in self._side.sensing.tells}
            out |= {column: tick.memory[path] for column, path in self._side.recorded.items()}
        return out, tick.memory

    def start(self, inputs: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:  # noqa: ARG002
        """The memory in the first tick, as outputs."""
        return self._side.start(self._measured(inputs), self._sample(inputs), parameters), {}

    def last_tick(self, kernel: Kernel, parameters: Float64Array) -> dict[str, Float64Array]:
        """The last tick of a kernel once more, on floats, with all that it can give."""
        layout, blocks = kernel.blocks.layout, kernel.blocks
        inputs = layout["inputs"].views(blocks.seen.copy())
        inputs["t"][...] = (kernel.count - 1) * self._side.dt
        with np.errstate(all="ignore"):
            given = inputs, layout["parameters"].views(parameters), layout["memory"].views(blocks.before)
            outputs, _ = self.tick(*given)
        return {name: np.array(value, dtype=np.float64) for name, value in outputs.items()}

    def _measured(self, inputs: Values) -> dict[str, Any]:
        zero = np.zeros(self._side.arm.n)
        return {"v": zero, **{name: inputs[name] for name in inputs if not name.startswith("ref.")}}

    def _sample(self, inputs: Values) -> Sample:
        return self._side.law.reference.of(subtree(inputs, "ref"))


def reference_shapes(side: LawSide) -> dict[str, tuple[int, ...]]:
    """The inputs that the sample of the reference fills, by path."""
    return {f"ref.{name}": shape for name, shape in side.law.reference.fields(side.arm.n).items()}


def kernel_of(
    side: LawSide,
    engine: Engine,
    *,
    slow: Callable[..., Any] | None,
    first: Callable[[], None],
    failed: Callable[[], Any],
    record: bool = False,
    sensed: tuple[str, ...] = (),
    level: int | None = None,
) -> Kernel:
    """A control side as a kernel with blocks of its own; see `Kernel` for what is passed on."""
    n, probe, sizes = side.arm.n, _probed(side), measurement_shapes(side.arm.n)
    ref_shapes = reference_shapes(side)
    held = {KNOWN: (), HELD: (n,)} if "limits.tau_applied" in probe.shapes else {}
    inputs = Block.of({"t": (), "q": (n,), **{name: sizes[name] for name in side.takes}, **ref_shapes, **held})
    outputs: dict[str, tuple[int, ...]] = {"mit": (5, n)} if probe.mit else {}  # the first one is what a step returns
    outputs["command"] = (n,)
    outputs |= {f"terms.{name}": (n,) for name in probe.terms} if record else {}
    outputs |= {f"sensed.{name}": sizes[name] for name in sensed}
    if record:
        outputs |= dict.fromkeys(side.sensing.tells, ())
        outputs |= {column: probe.shapes[path] for column, path in side.recorded.items()}
    parameters = Block.of({path: value.shape for path, value in side.parameters.items()} | {DT: ()})
    blocks = Blocks(inputs, parameters, Block.of(probe.shapes), Block.of(outputs))
    parameters.pack({**side.parameters, DT: side.dt}, blocks.parameters)
    for path, shape in ref_shapes.items():
        if shape == (3, 3):  # a rotation that nobody has written yet
            inputs.views(blocks.inputs)[path][...] = np.eye(3)
    functions = SideFunctions(side, record=record, sensed=sensed)
    return Kernel(
        engine,
        functions.tick,
        functions.start,
        blocks,
        first=first,
        failed=failed,
        call=None if slow is None else _call_of(side, slow),
        what=type(side.law).__name__,
        samples=lambda: _random_samples(side, blocks),
        time="t",
        dt=side.dt,
        level=level,
    )


def recording_kernel(side: LawSide, engine: Engine, sensed: tuple[str, ...], ticks: int | None) -> Kernel:
    """A kernel that gives every term in every tick and starts by itself; for few ticks it is compiled quickly."""
    kernel: Kernel

    def first() -> None:
        kernel.start()
        kernel.tick()

    def failed() -> None:
        raise not_finite(side, kernel)

    level = native.level_for(ticks)
    kernel = kernel_of(side, engine, slow=None, first=first, failed=failed, record=True, sensed=sensed, level=level)
    return kernel


def _call_of(side: LawSide, slow: Callable[..., Any]) -> Call:
    """Arguments of `step`: positions, velocities, and the sample of a law; a task makes its samples itself."""
    return Call(
        arguments=("q", "v") if side.sensing.needs_velocity else ("q",),
        slow=slow,
        keywords=tuple(name for name in side.takes if name != "v"),
        reference=side.law.reference if side.task is None else None,
        slots=tuple(reference_shapes(side)) if side.task is None else (),
    )


def _probed(side: LawSide) -> Probe:
    """Results of a first run on plain numbers; a law that fails there is reported in a sentence."""
    try:
        with np.errstate(all="ignore"):
            return side.probe
    except TautError:
        raise
    except Exception as cause:
        name = side.title
        raise UsageError(f"{name} fails on plain numbers, at rest at home: {failure(cause)}", name=name) from cause


def _random_samples(side: LawSide, blocks: Blocks) -> list[Flat]:
    """States near home at which compiled code is compared with the float run: three, and two of each phase."""
    rng, samples = np.random.default_rng(0), []
    phases = 0 if side.task is None else len(side.task.names)
    for k in range(max(3, 2 * phases)):
        inputs, memory = (0.3 * rng.standard_normal(block.size) for block in (blocks.inputs, blocks.memory))
        views = blocks.layout["inputs"].views(inputs)
        for name in ("q", "q_motor", "ref.q"):
            if name in views:
                views[name] += side.arm.home
        if phases:  # each phase in its first tick and in another one
            remembered = blocks.layout["memory"].views(memory)
            remembered["law.next"][...], remembered["law.ticks"][...] = k // 2 % phases, k % 2
        samples.append((inputs, blocks.parameters.copy(), memory))
    return samples


def not_finite(side: LawSide, kernel: Kernel) -> TautError:
    """The error that names the number that is not finite in a tick."""
    joints, blocks = side.arm.joint_names, kernel.blocks
    try:
        side.check_finite(blocks.views("inputs"), kernel.count)
    except RangeError as error:
        return error
    bad = np.flatnonzero(~np.isfinite(blocks.views("outputs")["command"]))
    term = _wild_term(side, kernel) if bad.size else None
    joint = joints[term.joint if term is not None else int(bad[0])] if bad.size else None
    who = f"the {side.probe.kind} of joint '{joint}'" if joint is not None else "its new memory"
    who += "" if term is None else f", of which the term '{term.name}' is {term.value}"
    return NumericalError(
        f"{side.title} gives numbers that are not finite in tick {kernel.count}: {who}; its memory stays as it was "
        "before that tick",
        name=side.title if term is None else f"terms.{term.name}",
        joint=joint,
        value=None if term is None else term.value,
    )


def _wild_term(side: LawSide, kernel: Kernel) -> WildTerm | None:
    """The term of the tick that failed which is not finite, seen in the tick once more on floats."""
    views = (kernel.blocks.views(name) for name in ("inputs", "parameters", "memory"))
    copies: list[dict[str, Float64Array]] = [{path: value.copy()[()] for path, value in v.items()} for v in views]
    try:
        with np.errstate(all="ignore"):
            outputs, _ = SideFunctions(side, record=True).tick(*copies)
    except Exception:  # plain Python raises where compiled code gives infinity: then the joint has to do
        return None
    return wild_term(subtree(outputs, "terms"))
