"""Batch: n controllers of one law, stepped together in lanes on the arrays of a simulator; made by `ctrl.batch`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import prod
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import numpy as np

from taut.base.checks import float_array, one_of, whole_number
from taut.base.errors import ShapeError, TautError, UsageError, unknown_name
from taut.base.paths import Named, Parameters
from taut.codegen.functions import DOUBLE, SINGLE, Real
from taut.codegen.lanes.loop import LANE_TICKS
from taut.codegen.lanes.rows import LANE_FRESH, TIME, RowArrays, RowCode, row_step
from taut.codegen.llvm import Lanes
from taut.codegen.native import cores, host_lanes
from taut.codegen.program import Block, Program, trace
from taut.control.lawside import LawSide
from taut.control.trajectories.reference import Sample
from taut.controller.calls import sample_arguments, step_arguments
from taut.controller.kernel import DT, SideFunctions

if TYPE_CHECKING:
    from taut.controller.controller import Controller

Device = Literal["cpu", "cuda"]
RealName = Literal["double", "float"]


class Batch:
    """n controllers of one law, stepped together. Made by `ctrl.batch`.

    Arrays have a row for each lane, as simulators have them: q (n, joints). They are read and written where they
    are, be they NumPy's, torch's, JAX's or Warp's. Rows may lie any distance apart, and an array without lanes,
    (joints,), serves all. In double precision each lane has the bits of `ctrl.step`.

    With device="cuda" they are in the memory of the first GPU, as `finite`, `memory` and a command are that `step`
    makes; a sample, a mask and parameters may also be on the CPU. A tick is queued, on torch's current stream where
    torch uses the GPU, or else on the legacy default stream.

    A lane in which a number is not finite gets NaN for its command, its memory stays as it was before the tick, and
    `finite` is False for it. No other lane sees it.

    What `ctrl.step` checks where a run begins is left out: angles in degrees, gains too large for the pose, rotations
    that are none. A blend of limits takes up no change of parameters.
    """

    finite: Any
    """(n,) whether all numbers of each lane were finite in the last tick."""
    memory: Mapping[str, Any]
    """The memory of the lanes itself by path, (n, ...), to read and to write. lane.ticks counts ticks since the
    start; where lane.fresh is 1 the next tick starts the rest from what is measured then."""
    parameters: Parameters
    """Parameters by path, (n, ...) of each lane or (...) of all. What is set is checked, and copied."""

    def __init__(self, ctrl: Controller, n: int, device: Device, real: RealName, threads: int | None) -> None:
        self.n = whole_number("n", n, minimum=1)
        self.threads = cores() if threads is None else whole_number("threads", threads, minimum=1)
        one_of("device", device, ("cpu", "cuda"))
        one_of("real", real, ("double", "float"))
        self.side: LawSide = ctrl.side
        if device == "cuda" and threads is not None:
            raise UsageError("threads are those of the CPU; leave them out with device='cuda'", name="threads")
        if self.side.task is not None:
            raise UsageError(
                "a batch is for a law, whose reference is written from outside; the references of a task are made by "
                "Python as its phases begin: make a batch of the law of each phase",
                name="batch",
            )
        if ctrl.engine != "native":
            raise UsageError("a batch is native code; compile the law with engine='native'", name="batch")
        program = ctrl.program
        start = trace(SideFunctions(self.side, record=False).start, program.inputs, program.parameters, Block())
        real_kind = SINGLE if real == "float" else DOUBLE
        self.dtype = np.dtype(real_kind.dtype)
        self._arrays: Any = arrays_of(device, real_kind, program, start, self.n)
        self.finite = self._arrays.finite
        remembered = self._arrays.code.memory
        rows = self._arrays.room((remembered.size,))
        self._arrays.put("memory", rows)
        self.memory = Named("the batch", "memory entry", self._arrays.views(remembered, rows))
        self._shapes = {**program.inputs.shapes, **program.outputs.shapes}
        for path, shape in program.inputs.shapes.items():  # of a law that follows nothing; no torque is held
            if path != TIME:
                zero = np.eye(3, dtype=self.dtype) if shape == (3, 3) else np.zeros(shape, self.dtype)
                self._arrays.put(path, self._arrays.sent(path, zero), per_lane=False)
        self._command, *others = program.outputs.fields
        for field in others:
            self._arrays.put(field.path, self._arrays.room(field.shape))
        period = np.asarray(ctrl.dt, dtype=self.dtype)
        self._arrays.put(DT, self._arrays.sent(DT, period), per_lane=False)
        self.parameters = LaneParameters(self.side, self._arrays, self.dtype, dict(ctrl.parameters))
        self.reset()

    def __repr__(self) -> str:
        return f"Batch(n={self.n}, {self.side.law!r}, {self.side.arm!r}, {self.dtype})"

    def __reduce__(self) -> NoReturn:
        raise UsageError("a batch cannot be copied or pickled; make another one: ctrl.batch(n)", name="batch")

    def step(
        self,
        q: Any,
        v: Any = None,
        ref: Sample | Mapping[str, Any] | None = None,
        *,
        F_ext: Any = None,
        tau_meas: Any = None,
        q_motor: Any = None,
        v_motor: Any = None,
        a_tip: Any = None,
        out: Any = None,
    ) -> Any:
        """One tick of all lanes.

        Args:
            q: (n, joints) measured positions [rad | m].
            v: (n, joints) measured velocities [rad/s | m/s]; left out where sensing makes them from positions.
            ref: One sample for all lanes, or arrays by the names of its fields, all of them: q, v and a (n, joints)
                of a JointMotion; p (n, 3), R (n, 3, 3), twist and acceleration (n, 6) of a TaskMotion.
            F_ext: (n, 6) as in `ctrl.step`; this and what follows where the law needs it.
            tau_meas: (n, joints) [N m | N].
            q_motor: (n, joints) [rad | m].
            v_motor: (n, joints) [rad/s | m/s].
            a_tip: (n, 3) [m/s^2].
            out: (n, joints) where the command goes, which may be q itself, or other columns of its array; a new array
                of NumPy's, or on the GPU, if left out.

        Returns:
            The command, `out`: (n, joints), or (n, 5, joints) of a law that gives a MitCommand.

        Raises:
            UsageError: An array in other memory, of another type, read-only as `out`, or with gaps in a row. On the
                CPU, an `out` with rows that overlap, each other or those of other lanes in what is read.
            ShapeError: An array of another shape.
        """
        others = {"F_ext": F_ext, "tau_meas": tau_meas, "q_motor": q_motor, "v_motor": v_motor, "a_tip": a_tip}
        given, _ = step_arguments(self.side, (), {"q": q, "v": v, **others})
        reference = reference_arrays(self.side, ref, self.dtype)
        if not isinstance(ref, Mapping):
            reference = {path: self._arrays.sent(path, value) for path, value in reference.items()}
        for name, value in (given | reference).items():
            self._take(name, value)
        result = self._arrays.room(self._command.shape) if out is None else out
        self._take(self._command.path, result, name="out")
        if out is not None and self.n > 1 and not self._arrays.strided:
            self._require_apart((*given, *(reference if isinstance(ref, Mapping) else ())))
        self._arrays.run(self.threads)
        return result

    def reset(self, mask: Any = None) -> None:
        """Start memory anew, in the next tick: in all lanes, or where the mask (n,) of truth values is True."""
        given = np.ones(self.n, dtype=np.bool_) if mask is None else mask
        lanes = given if isinstance(given, np.ndarray) else self._arrays.array("mask", given)
        if lanes.shape != (self.n,) or lanes.dtype != np.bool_:
            raise ShapeError(
                f"mask must have shape ({self.n},) of truth values; got shape {lanes.shape} of {lanes.dtype}",
                name="mask",
            )
        lanes = self._arrays.sent("mask", lanes, per_lane=True) if lanes is given else lanes
        self._arrays.begin(self.memory[LANE_FRESH], self.memory[LANE_TICKS], lanes)

    def _require_apart(self, inputs: Iterable[str]) -> None:
        """UsageError where a row of `out` is one that another lane reads: lanes are computed group by group."""
        out = self._arrays.kept[self._command.path]
        for name in inputs:
            both = self._arrays.kept[name], out
            if np.shares_memory(*both) and len({(x.ctypes.data, x.shape, x.strides) for x in both}) > 1:
                raise UsageError(
                    f"out shares memory with {name}, in other rows; give {name} itself, other columns of its array, "
                    "or another array",
                    name="out",
                )

    def _take(self, path: str, value: Any, name: str = "") -> None:
        """Point the code to an array of a caller, which is checked; one of NumPy's that it has already stays."""
        if value is self._arrays.kept.get(path):
            return
        array, shape, who = self._arrays.array(name or path, value), self._shapes[path], name or path
        if array.dtype != self.dtype:
            other = {"float32": "float", "float64": "double"}.get(str(array.dtype))
            way = f", or make the batch with real='{other}'" if other else ""
            raise UsageError(
                f"{who} must be {self.dtype}, as this batch computes; got {array.dtype}; convert it{way}",
                name=who,
                value=str(array.dtype),
            )
        whole = (self.n, *shape)
        if array.shape != whole and (name or array.shape != shape):
            either = "" if name else f", or {shape} for all lanes"
            raise ShapeError(f"{who} must have shape {whole}{either}; got shape {array.shape}", name=who)
        if name and not array.flags.writeable:
            raise UsageError(
                f"{who} is read-only, or its library does not state that it is not (of Warp on the CPU give "
                "out.numpy()); give an array that can be written, or leave it out",
                name=who,
            )
        lead = array.ndim - len(shape)
        step = row_step(array.shape[lead:], array.strides[lead:], array.itemsize)
        if step is None or not (step == array.itemsize or self._arrays.strided) or not array.flags.aligned:
            raise UsageError(
                f"{who} has gaps within a row, or is not aligned: strides {array.strides} in bytes, of "
                f"{array.itemsize} a number; rows may lie apart, but the numbers of each side by side: "
                "make it contiguous",
                name=who,
                value=array.strides,
            )
        if name and not self._arrays.strided and self.n > 1 and abs(array.strides[0]) < prod(shape) * array.itemsize:
            raise UsageError(f"{who} has rows that overlap; give an array with a row for each lane", name=who)
        self._arrays.put(path, array, per_lane=bool(lead))


def arrays_of(device: Device, real: Real, program: Program, start: Program, n: int) -> Any:
    """The code and the arrays of n lanes where they are to be."""
    if device == "cpu":
        return RowArrays(RowCode(program, Lanes(host_lanes(real), real), start=start), n)
    from taut.codegen.cuda import CudaArrays

    return CudaArrays(RowCode(program, Lanes(1, real, thread=True), start=start), n)


def reference_arrays(side: LawSide, ref: Sample | Mapping[str, Any] | None, dtype: Any) -> dict[str, Any]:
    """Arrays by the path of the input that they fill, of one sample or of arrays by the names of its fields."""
    if not isinstance(ref, Mapping):
        sample = sample_arguments(side, ref)
        return {path: np.ascontiguousarray(value, dtype=dtype) for path, value in sample.items()}
    fields = side.law.reference.fields(side.arm.n)
    for name in ref:
        if name not in fields:
            raise unknown_name("ref", "field", name, fields)
    missing = [name for name in fields if name not in ref]
    if missing:
        raise UsageError(
            f"ref needs {', '.join(fields)}; got no {', '.join(missing)}; an array without lanes, such as zeros, "
            "serves all",
            name=f"ref.{missing[0]}",
        )
    return {f"ref.{name}": value for name, value in ref.items()}


class LaneParameters(Parameters):
    """Parameters of a batch by path, of all lanes or of each; new values are checked as those of a controller."""

    def __init__(self, side: LawSide, arrays: Any, dtype: Any, values: dict[str, Any]) -> None:
        super().__init__("the batch", {})
        self._side, self._arrays, self._dtype, self._n = side, arrays, dtype, arrays.n
        for path, value in values.items():
            self._store(path, value, per_lane=False)

    def __setitem__(self, path: str, value: Any) -> None:
        shape = self._side.parameters[self._known(path)].shape
        tensor = hasattr(value, "__dlpack_device__")
        array = float_array(path, self._arrays.host(path, value) if tensor else value)
        if array.shape == (self._n, *shape):
            self._check_rows(path, array)
            self._store(path, array, per_lane=True)
        elif array.ndim > len(shape):
            joints = self._side.arm.n
            scalar = shape == () and array.shape == (self._n, joints) and path.startswith("law.")
            way = f"; compile the law with a gain for each joint, such as [100.0] * {joints}" if scalar else ""
            raise ShapeError(
                f"{path} must have shape {(self._n, *shape)}, or {shape} for all lanes, as it was compiled; got "
                f"shape {array.shape}{way}",
                name=path,
            )
        else:
            self._store(path, self._side.checked_parameter(path, array), per_lane=False)

    def _store(self, path: str, value: Any, *, per_lane: bool) -> None:
        self._values[path] = array = np.array(value, dtype=self._dtype, order="C")
        self._arrays.put(path, self._arrays.sent(path, array, per_lane=per_lane), per_lane=per_lane)

    def _check_rows(self, path: str, rows: Any) -> None:
        """A parameter of each lane: entries by their smallest and largest, matrices one by one."""
        check, entries = self._side.checked_parameter, rows.ndim < 3 and not path.endswith("inertia")
        try:
            for row in (rows.min(axis=0), rows.max(axis=0)) if entries else ():
                check(path, row)
        except TautError:
            entries = False  # the lane that it is; ends of several lanes together need not be a value of one
        for lane, row in enumerate(() if entries else rows):
            try:
                check(path, row)
            except TautError as cause:
                raise cause.about("", f"lane {lane}: ") from None
