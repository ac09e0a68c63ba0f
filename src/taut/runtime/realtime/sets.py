"""A compiled tick for the loop's process: object code and layout, as plain data, with what the parent writes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
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
from taut.codegen.servo_loop import CONTROLS, FUNCTIONS, PLANT_FUNCTIONS, ROW_HEAD, TABLE
from taut.control.safety import NO_TIME_OUT, SIGNALS, SafeSide, safe_shapes
from taut.loop import ModelPlant
from taut.plant.environments.environment import of_plant
from taut.runtime.realtime.shared import Shared

if TYPE_CHECKING:
    from taut.runtime.realtime.acting import Acting

DT: Final = "dt"
NO_ROWS: Final = np.zeros((0, 1))
MADE_ROWS: Final = 30_000  # of a reference that is made where its phase begins, or of a stream's chunk


class ServoSet:
    """A safe side, compiled for the loop's process."""

    def __init__(self, safe: SafeSide) -> None:
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
            for name in ("hold_after", "stop_after", "over", "valid", "control"):
                views[f"signal.{name}"][...] = 1.0
            for name in ("fault", "blind", "value", "index"):
                remembered[f"safe.{name}"][...] = 0.0
            remembered["safe.started"][...] = remembered["safe.mode"][...] = 1.0
            out.append((inputs, self.packed({}), memory))
        return out

    @property
    def reference_size(self) -> int:
        """Doubles of a sample."""
        return sum(field.size for field in self.inputs.fields if field.path.startswith("ref."))

    @property
    def row_size(self) -> int:
        """Doubles of a row of the ring."""
        return len(ROW_HEAD) + sum(block.size for block, _ in self.row)

    def packed(self, parameters: Mapping[str, Float64Array]) -> Float64Array:
        """The parameters that the tick takes: those that the law was made with, but for these."""
        side = self.safe.side
        return self.parameters.pack({**side.parameters, **parameters, DT: side.dt})

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

    def message(self, acting: Acting, *, begins: bool) -> dict[str, Any]:
        """What the loop's process gets of it."""
        return {
            "code": self.code,
            "layout": self.layout(),
            "ring": acting.ring.name,
            "controls": acting.controls.shared.name,
            "parameters": acting.controls.values.copy(),
            "places": acting.controls.layout(),
            "number": acting.number,
            "begins": int(begins),
            "sends": int(acting.sends),
        }

    def columns(self) -> dict[str, tuple[int, tuple[int, ...]]]:
        """Offset and shape of every number of a row, by path; parameters.* and memory.* as they were before it."""
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
    """The samples of a phase: rows of the reference, none to hold; None where they are made when it has begun."""

    rows: Float64Array | None  # (k, reference_size)
    stream: bool = False  # whether they grow stale


class Controls:
    """What the parent writes while the loop runs: samples, parameters; without locks that the loop waits for."""

    def __init__(
        self, made: ServoSet, tables: Sequence[Table], parameters: Mapping[str, Float64Array], over: float
    ) -> None:
        size, count = made.reference_size, made.parameters.size
        self._made, self._count, self._alone = made, len(tables), threading.Lock()
        self.parameters_at = len(CONTROLS)
        self.tables_at = self.parameters_at + count
        self.rows_at = self.tables_at + len(TABLE) * len(tables)
        known = sum(len(table.rows) for table in tables if table.rows is not None)
        # What is made later goes in turns into two halves behind these, so that none is written that is being read.
        self._turn, self._known = 0, known
        made_later = any(table.rows is None for table in tables)
        self.shared = Shared.create(self.rows_at + (known + 2 * MADE_ROWS * made_later) * size)
        self.words, self.numbers = self.shared.words, self.shared.numbers
        self.values = self.numbers[self.parameters_at : self.tables_at]
        self.values[:] = made.packed(parameters)
        self.views = made.parameters.views(self.values)
        self.time_out(NO_TIME_OUT, NO_TIME_OUT)
        self._blend_within(over)
        first = 0
        for k, table in enumerate(tables):
            entry = self._entry(k)
            entry[TABLE["arrived"]], entry[TABLE["stream"]] = -1, table.stream
            entry[TABLE["fixed"]] = table.rows is not None
            if table.rows is not None and len(table.rows):
                self._write(entry, table.rows, first, -1)
                first += len(table.rows)

    def ticks(self, k: int) -> int:
        """Ticks of phase k, as of the last one."""
        return int(self._entry(k)[TABLE["ticks"]])

    def waits(self, k: int) -> bool:
        """Whether phase k has no samples yet."""
        entry = self._entry(k)
        return bool(entry[TABLE["version"]] == entry[TABLE["voided"]])

    def _entry(self, k: int) -> Any:
        first = self.tables_at + len(TABLE) * k
        return self.words[first : first + len(TABLE)]

    def fill(self, k: int, rows: Float64Array, arrived: int = -1) -> None:
        """The samples of phase k from now on; `arrived` is the tick of the phase that the first row is for."""
        if len(rows) > MADE_ROWS:
            raise RangeError(
                f"the reference of a phase has {len(rows)} ticks, more than {MADE_ROWS}", name="reference"
            )
        with self._alone:
            self._turn = 1 - self._turn
            self._write(self._entry(k), rows, self._known + MADE_ROWS * self._turn, arrived)

    def _write(self, entry: Any, rows: Float64Array, first: int, arrived: int) -> None:
        size = self._made.reference_size
        self.numbers[self.rows_at + first * size :][: rows.size] = rows.ravel()
        entry[TABLE["lock"]] += 1
        entry[TABLE["first"]], entry[TABLE["length"]], entry[TABLE["arrived"]] = first, len(rows), arrived
        entry[TABLE["received"]] = time.monotonic_ns()
        entry[TABLE["version"]] += 1
        entry[TABLE["lock"]] += 1

    def time_out(self, hold_after: float, stop_after: float) -> None:
        """Ages of a stream's samples [s] after which the loop holds, and after which it stops."""
        self.numbers[CONTROLS["hold_after"]], self.numbers[CONTROLS["stop_after"]] = hold_after, stop_after

    def set(self, values: Mapping[str, Float64Array], over: float) -> None:
        """New values of parameters by path, which come in within `over` [s]; all in one tick."""
        with self._alone:
            self._blend_within(over)
            self.words[CONTROLS["parameters"]] += 1
            for path, value in values.items():
                self.views[path][...] = value
            self.words[CONTROLS["parameters"]] += 1

    def _blend_within(self, over: float) -> None:
        self.numbers[CONTROLS["over"]] = max(over, self._made.safe.side.dt)

    def layout(self) -> dict[str, int]:
        """Where things lie, in words."""
        return {"new_parameters": self.parameters_at, "tables": self.tables_at, "table_rows": self.rows_at,
                "table_count": self._count}  # fmt: skip


def compiled_plant(plant: ModelPlant, q: Float64Array, v: Float64Array, rate: float) -> dict[str, Any]:
    """A model plant in its true state, compiled as a robot: what the loop's process gets of it."""
    dt = 1.0 / rate
    values = {path: np.asarray(value, dtype=np.float64) for path, value in plant.parameters.items()}
    state = {path: np.asarray(x, dtype=np.float64) for path, x in plant.start(q, v, values, dt).items()}
    n = plant.arm.n
    inputs = Block.of({"command": (5, n) if plant.takes == "mit" else (n,), "t": ()})
    parameters, memory = (Block.of({path: x.shape for path, x in part.items()}) for part in (values, state))
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

    layout = {"repeats": plant.substeps - 1, "command_size": inputs.size - 1, "memory_size": memory.size,
              "dt": dt, "period": round(1e9 * dt)}  # fmt: skip
    return {
        "code": native.object_code(content, text, PLANT_FUNCTIONS),
        "layout": layout,
        "parameters": parameters.pack(values),
        "memory": memory.pack(state),
        "input_size": inputs.size,
        "measured": dict(programs["measure"].outputs.shapes),
    }
