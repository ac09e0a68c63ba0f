"""A compiled tick for the loop's process: object code and layout, as plain data, with what the parent writes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.codegen import native
from taut.codegen.engine import Flat, verified
from taut.codegen.llvm import declarations, kernel
from taut.codegen.program import Block, Values, trace
from taut.codegen.servo_loop import CONTROL_WORDS, CONTROLS, ROW_HEAD, TABLE
from taut.control.safety import NEVER, SIGNALS, SafeSide, safe_shapes
from taut.control.trajectories.reference import Sample
from taut.loop import ModelPlant
from taut.plant.environments.environment import of_plant
from taut.runtime.realtime.shared import Shared

if TYPE_CHECKING:
    from taut.runtime.realtime.acting import Acting

DT: Final = "dt"
MADE_ROWS: Final = 120_000  # room for the samples of phases whose references are made where they begin
FUNCTIONS: Final = ("kernel", "start")
PLANT_FUNCTIONS: Final = ("step", "substep", "measure")


class ServoSet:
    """A safe side, compiled for the loop's process."""

    def __init__(self, safe: SafeSide, parameters: Mapping[str, Float64Array]) -> None:
        self.safe = safe
        side = safe.side
        n = side.arm.n
        self.fields = side.law.reference.fields(n)
        self.inputs = Block.of(
            {"t": (), **safe.measured}
            | {f"ref.{name}": shape for name, shape in self.fields.items()}
            | {f"signal.{name}": () for name in SIGNALS}
        )
        self.parameters = Block.of({path: value.shape for path, value in side.parameters.items()} | {DT: ()})
        self.memory = Block.of(safe.memory_shapes)
        self.values = self.parameters.pack({**side.parameters, **parameters, DT: side.dt})
        blocks = self.inputs, self.parameters, self.memory
        program, starter = trace(self._tick, *blocks), trace(self._start, *blocks)
        self.outputs, self.operations = program.outputs, program.operations
        self.digest = program.content + starter.content

        def text() -> str:
            return "\n".join([declarations(), kernel(program, "kernel"), kernel(starter, "start")])

        verify = verified(type(side.law).__name__, self._tick, program, self._samples)
        self.code = native.object_code(b"servo" + self.digest, text, FUNCTIONS, verify)

    def _tick(self, inputs: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:
        return self.safe.tick(inputs, parameters, memory, parameters[DT])

    def _start(self, inputs: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:
        new = self.safe.start(inputs, parameters, memory)
        return {path: new[path] for path in self.memory.shapes}, memory

    def _samples(self) -> list[Flat]:
        """States near home at which both engines are compared."""
        rng, out = np.random.default_rng(0), list[Flat]()
        home = self.safe.side.arm.home
        for _ in range(3):
            inputs, memory = (0.3 * rng.standard_normal(block.size) for block in (self.inputs, self.memory))
            views, remembered = self.inputs.views(inputs), self.memory.views(memory)
            for view in (views["q"], remembered["safe.q"], remembered["safe.q_stop"], views.get("ref.q")):
                if view is not None:
                    view += home
            for name in SIGNALS:
                views[f"signal.{name}"][...] = 0.0
            for name in ("hold_after", "stop_after", "over", "valid"):
                views[f"signal.{name}"][...] = 1.0
            for name in ("fault", "blind", "value", "index"):
                remembered[f"safe.{name}"][...] = 0.0
            remembered["safe.started"][...] = remembered["safe.mode"][...] = 1.0
            out.append((inputs, self.values, memory))
        return out

    @property
    def reference_size(self) -> int:
        """Doubles of a sample."""
        return sum(field.size for field in self.inputs.fields if field.path.startswith("ref."))

    @property
    def row_size(self) -> int:
        """Doubles of a row of the ring."""
        return len(ROW_HEAD) + sum(block.size for block, _ in self.row)

    def memory_at_start(self, command: Float64Array) -> Float64Array:
        """Memory before the first tick, of a robot that holds a command (n,)."""
        flat = self.memory.zeros()
        self.memory.views(flat)["safe.tau"][...] = command
        self.memory.views(flat)["safe.phase"][...] = 1.0
        return flat

    def layout(self) -> dict[str, Any]:
        """Sizes and offsets for the loop's process, by the names of `codegen.servo_loop.SET`."""
        memory = {field.path: field.offset for field in self.memory.fields}
        n = self.safe.side.arm.n
        return {
            "memory_size": self.memory.size,
            "safe_size": Block.of(safe_shapes(n)).size,
            "input_size": self.inputs.size,
            "output_size": self.outputs.size,
            "parameter_size": self.parameters.size,
            "reference_size": self.reference_size,
            "measured_size": Block.of(self.safe.measured).size,
            "t_at": 0,
            "measured_at": self.inputs.field("q").offset,
            "reference_at": next(f.offset for f in self.inputs.fields if f.path.startswith("ref.")),
            "signals_at": self.inputs.field(f"signal.{SIGNALS[0]}").offset,
            "command_at": self.outputs.field("mit" if "mit" in self.outputs.shapes else "command").offset,
            "fault_at": self.outputs.field("safe.fault").offset,
            "next_at": memory.get("law.next", -1) if self.safe.side.task is not None else -1,
            "ticks_at": memory.get("law.ticks", -1) if self.safe.side.task is not None else -1,
            "row_size": self.row_size,
            "dt": self.safe.side.dt,
        }

    def message(self, acting: Acting, command: Float64Array, *, begins: bool) -> dict[str, Any]:
        """What the loop's process is told of it; `command` is what a robot that was not controlled holds."""
        return {
            "code": self.code,
            "layout": self.layout(),
            "ring": acting.ring.name,
            "controls": acting.controls.shared.name,
            "memory": self.memory_at_start(command),
            "parameters": self.values,
            "places": acting.controls.layout(),
            "number": acting.number,
            "begins": int(begins),
            "sends": int(acting.sends),
            "rotations": [f.offset for f in self.inputs.fields if f.path.startswith("ref.") and f.shape == (3, 3)],
        }

    def columns(self) -> dict[str, tuple[int, tuple[int, ...]]]:
        """Offset and shape of every number of a row, by path; parameters.* and memory.* as the tick began with."""
        out: dict[str, tuple[int, tuple[int, ...]]] = {f"loop.{name}": (i, ()) for i, name in enumerate(ROW_HEAD)}
        first = len(ROW_HEAD)
        for block, prefix in self.row:
            out |= {prefix + field.path: (first + field.offset, field.shape) for field in block.fields}
            first += block.size
        return out

    @property
    def row(self) -> tuple[tuple[Block, str], ...]:
        """The blocks of a row, and what is before their paths."""
        return (self.inputs, ""), (self.parameters, "parameters."), (self.memory, "memory."), (self.outputs, "")


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """The samples of a phase: rows of the reference; "stream", or None where they are made when the phase begins."""

    rows: Float64Array | None  # (k, reference_size); k = 0: hold
    stream: bool = False


class Controls:
    """What the parent writes while the loop runs: samples, parameters, tables; without locks."""

    def __init__(self, made: ServoSet, tables: list[Table]) -> None:
        size, count = made.reference_size, made.parameters.size
        self._made, self._count = made, len(tables)
        self.reference_at = CONTROL_WORDS
        self.parameters_at = self.reference_at + size
        self.tables_at = self.parameters_at + count
        self.rows_at = self.tables_at + len(TABLE) * len(tables)
        known = sum(len(table.rows) for table in tables if table.rows is not None)
        makes = any(table.rows is None and not table.stream for table in tables)
        self._room, self._used, self._fixed = known + MADE_ROWS * makes, 0, 0
        self.shared = Shared.create(self.rows_at + self._room * size)
        self.words, self.numbers = self.shared.words, self.shared.numbers
        self.views = made.parameters.views(self.numbers[self.parameters_at : self.tables_at])
        self.numbers[self.parameters_at : self.tables_at] = made.values
        self.time_out(NEVER, NEVER)
        for k, table in enumerate(tables):
            entry = self._entry(k)
            entry[TABLE["arrived"]] = -1
            entry[TABLE["dynamic"]] = table.rows is None and not table.stream
            if table.stream:
                entry[TABLE["length"]] = -1
            elif table.rows is not None and len(table.rows):
                self.fill(k, table.rows)
        self._fixed = self._used  # rows that are made later come behind these

    def waits(self, k: int) -> bool:
        """Whether the phase k has begun and has no samples yet."""
        if not 0 <= k < self._count:
            return False
        entry = self._entry(k)
        return bool(entry[TABLE["dynamic"]] and entry[TABLE["length"]] == 0)

    def _entry(self, k: int) -> Any:
        first = self.tables_at + len(TABLE) * k
        return self.words[first : first + len(TABLE)]

    def fill(self, k: int, rows: Float64Array) -> None:
        """The samples of table k, which the loop takes from its next tick on."""
        size = self._made.reference_size
        if self._used + len(rows) > self._room:  # those of phases that ended are not needed any more
            self._used = self._fixed
        if self._used + len(rows) > self._room:
            raise RangeError(
                f"the reference of a phase has {len(rows)} ticks, more than {MADE_ROWS}", name="reference"
            )
        first = self._used
        target = self.numbers[self.rows_at + first * size : self.rows_at + (first + len(rows)) * size]
        target[:] = rows.ravel()
        self._used = first + len(rows)
        entry = self._entry(k)
        entry[TABLE["first"]] = first
        entry[TABLE["length"]] = len(rows)  # last: then it is there

    def time_out(self, hold_after: float, stop_after: float) -> None:
        """Ages of a stream's sample [s] after which the loop holds, and after which it stops."""
        self.numbers[CONTROLS["hold_after"]], self.numbers[CONTROLS["stop_after"]] = hold_after, stop_after

    def send(self, sample: Sample) -> None:
        """A sample of the stream."""
        flat = [np.ravel(getattr(sample, name)) for name in self._made.fields]
        words = self.shared.view
        words[CONTROLS["sample"]] += 1
        self.numbers[self.reference_at : self.parameters_at] = np.concatenate(flat)
        words[CONTROLS["received"]] = time.monotonic_ns()
        words[CONTROLS["sample"]] += 1

    def set(self, values: Mapping[str, Float64Array], over: float) -> None:
        """New values of parameters by path, which come in within `over` [s]; all in one tick."""
        self.numbers[CONTROLS["over"]] = max(over, self._made.safe.side.dt)
        self.words[CONTROLS["parameters"]] += 1
        for path, value in values.items():
            self.views[path][...] = value
        self.words[CONTROLS["parameters"]] += 1

    def layout(self) -> dict[str, int]:
        """Where things lie, in words."""
        return {"reference": self.reference_at, "new_parameters": self.parameters_at, "tables": self.tables_at,
                "table_rows": self.rows_at, "table_count": (self.rows_at - self.tables_at) // len(TABLE)}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class PlantSet:
    """A model plant, compiled as a robot for the loop's process."""

    code: bytes
    layout: dict[str, Any]
    parameters: Float64Array
    memory: Float64Array
    input_size: int
    measured: dict[str, tuple[int, ...]]

    @classmethod
    def of(cls, plant: ModelPlant, q: Float64Array, v: Float64Array, rate: float) -> PlantSet:
        """The plant at its true state."""
        dt = 1.0 / rate
        values = {path: np.asarray(value, dtype=np.float64) for path, value in plant.parameters.items()}
        state = {path: np.asarray(x, dtype=np.float64) for path, x in plant.start(q, v, values, dt).items()}
        n = plant.arm.n
        inputs = Block.of({"command": (5, n) if plant.takes == "mit" else (n,), "t": ()})
        parameters, memory = (
            Block.of({p: v.shape for p, v in values.items()}),
            Block.of({p: np.shape(x) for p, x in state.items()}),
        )
        noise = {name: np.zeros(shape) for name, shape in plant.noise.items()}
        names = ("q", *sorted(plant.measures))

        def advance(i: Values, p: Values, m: Values, command: bool) -> tuple[Values, Values]:
            after = plant.command(i["command"], m, i["t"]) if command else m
            return {}, plant.advance(after, {**p, **of_plant({})}, dt / plant.substeps)

        def measure(i: Values, p: Values, m: Values) -> tuple[Values, Values]:  # noqa: ARG001
            seen = plant.measure(m, noise, p)
            return {name: seen[name] for name in names}, m

        functions: dict[str, Callable[..., Any]] = {
            "step": partial(advance, command=True), "substep": partial(advance, command=False), "measure": measure,
        }  # fmt: skip
        programs = {name: trace(function, inputs, parameters, memory) for name, function in functions.items()}
        content = b"plant" + b"".join(program.content for program in programs.values())

        def text() -> str:
            return "\n".join([declarations(), *(kernel(program, name) for name, program in programs.items())])

        return cls(
            code=native.object_code(content, text, PLANT_FUNCTIONS),
            layout={
                "repeats": plant.substeps - 1,
                "command_size": inputs.size - 1,
                "memory_size": memory.size,
                "dt": dt,
            },
            parameters=parameters.pack(values),
            memory=memory.pack(state),
            input_size=inputs.size,
            measured=dict(programs["measure"].outputs.shapes),
        )
