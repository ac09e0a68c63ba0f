"""The declaration of a metric, and the metrics of a run as a mapping from their names to numbers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, TypeVar

import numpy as np

from taut.base.checks import read_only
from taut.base.errors import ShapeError, UsageError, unknown_name
from taut.base.result import Content, Result, Table
from taut.base.types import Float64Array

if TYPE_CHECKING:
    from taut.record.run import Run

Numbers: TypeAlias = Float64Array | float
Together: TypeAlias = "Literal['sum', 'largest', 'norm'] | Callable[[Run, Sequence[int]], float]"
Compute: TypeAlias = "Callable[[Run], Float64Array | float | None]"
F = TypeVar("F", bound="Callable[[Run], Float64Array | float | None]")


def _nothing(run: Run) -> None:
    """The number of a metric that is not declared yet."""


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One number of a run, or one of each joint: declared by a function of the run that it decorates.

    Every run has it from then on, in `run.metrics` and all that is made of it. The function gives None or NaN where
    it has no meaning.

    Args:
        unit: Its unit. Per joint, {q} stands for rad or m, {tau} for N m or N, {command} for the command's unit.
        name: How it is asked for; the function's name if left out.
        title: What it is called in tables and plots; the name in words if left out.
        doc: What it is, in a sentence; the first sentence of the function's docstring if left out.
        per_joint: Whether the function gives (n,) numbers, one for each joint; else it gives one, of the arm or tool.
        together: Of several joints: their sum, the largest with its sign, their norm, or a function.
        compute: The function; given by decorating it.

    Raises:
        UsageError: Another metric has that name, or `Metrics` has an attribute of it.

    Example:
        >>> import taut
        >>> @taut.analysis.Metric(unit="m")
        ... def tool_travel(run: taut.Run) -> float:
        ...     \"\"\"Length of the path of the tool's origin.\"\"\"
        ...     return float(np.linalg.norm(np.diff(run.task.p, axis=0), axis=1).sum())
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=50.0, kd=10.0), arm)
        >>> run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.3, 0.8]), duration=0.1)
        >>> run.metrics.tool_travel > 0.0
        True
    """

    unit: str
    name: str = ""
    title: str = ""
    doc: str = ""
    per_joint: bool = False
    together: Together = "largest"
    compute: Compute = _nothing

    def __call__(self, function: F) -> F:
        """Declare the metric that a function computes; the function itself."""
        name = self.name or function.__name__
        before = METRICS.get(name)
        again = before is not None and _place(before.compute) == _place(function)  # a file that is read once more
        if (before is not None and not again) or hasattr(Metrics, name):
            raise UsageError(f"a run has '{name}' already; give your metric another name", name="name")
        doc = self.doc or (function.__doc__ or name).strip().partition("\n\n")[0].rstrip(".")
        title = self.title or name.replace("_", " ")
        METRICS[name] = dataclasses.replace(self, name=name, title=title, doc=doc, compute=function)
        return function

    def meaning(self, joints: int = 1) -> str:
        """What it is, and how it is put together for several joints."""
        words = f"for all joints the {self.together}" if isinstance(self.together, str) else "all joints together"
        return f"{self.doc}; {words}" if self.per_joint and joints > 1 else self.doc

    def units_of(self, run: Run) -> tuple[str, ...]:
        """Unit of each joint's number, or of the one number."""
        if not self.per_joint:
            return (self.unit,)
        rows = zip(run.units, run.effort_units, run.command_units, strict=True)
        texts = (self.unit.format(q=q, tau=tau, command=command) for q, tau, command in rows)
        return tuple(text.replace("(N)^2", "N^2") for text in texts)

    def of(self, run: Run) -> Numbers:
        """The number of a run, or (n,) those of its joints; ShapeError if the function gives something else."""
        shape = (run.n,) if self.per_joint else ()
        with np.errstate(over="ignore", invalid="ignore"):  # a run that diverged may hold huge numbers
            found = self.compute(run) if len(run) else None
        values = np.full(shape, np.nan) if found is None else np.asarray(found, dtype=np.float64)
        if values.shape != shape:
            rule = "(n,) numbers, one for each joint," if self.per_joint else "one number"
            raise ShapeError(f"metric '{self.name}' must give {rule} of a run; got shape {values.shape}")
        return read_only(values) if self.per_joint else float(values)

    def of_joints(self, run: Run, values: Float64Array, joints: Sequence[int]) -> float:
        """The number of some joints together, of (n,) each one's."""
        chosen = values[list(joints)]
        with np.errstate(over="ignore", invalid="ignore"):
            if not isinstance(self.together, str):
                return float(self.together(run, joints)) if len(run) else np.nan
            if self.together == "sum":
                return float(np.sum(chosen))
            if self.together == "norm":
                return float(np.sqrt(np.sum(chosen**2)))
        known = chosen[~np.isnan(chosen)]
        return float(known[np.argmax(np.abs(known))]) if known.size else np.nan


METRICS: Final[dict[str, Metric]] = {}
"""Every metric by its name: those of taut, and those that a user's file declares."""


def _place(function: object) -> tuple[object, object]:
    return getattr(function, "__module__", None), getattr(function, "__qualname__", None)


class Metrics(Mapping[str, "Float64Array | float"], Result):
    """How well a run went, in numbers: a mapping from names to one number, or (n,) one of each joint.

    `metrics.rms_error` is `metrics["rms_error"]`. NaN (null in JSON) where a number has no meaning: overshoot where
    the reference is not constant, an error of joints where the reference is one of the task, the fraction of a limit
    that the arm does not state, ... `taut.analysis.METRICS` has what each is, with its unit; `taut.analysis.Metric`
    declares one of your own.

    Args:
        run: The run that they are of.
    """

    def __init__(self, run: Run) -> None:
        self._run = dataclasses.replace(run)  # a run keeps its metrics: without a circle its arrays are freed
        self._values: dict[str, Numbers] = {}

    def __getitem__(self, name: str) -> Numbers:
        if name not in self._values:
            self._values[name] = _declared(name).of(self._run)
        return self._values[name]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in METRICS:
            raise AttributeError(str(unknown_name("a run", "metric", name, METRICS)))
        return self[name]

    def __iter__(self) -> Iterator[str]:
        return iter(METRICS)

    def __len__(self) -> int:
        return len(METRICS)

    def __eq__(self, other: object) -> bool:
        return self is other  # numbers may be arrays, and NaN

    def __hash__(self) -> int:
        return id(self)

    @property
    def duration(self) -> float:
        """Time from the first tick to the last [s]."""
        return float(self._run.t[-1] - self._run.t[0]) if len(self._run) else 0.0

    def unit(self, name: str) -> str:
        """Unit of a metric; of joints with different units, both."""
        return " | ".join(dict.fromkeys(_declared(name).units_of(self._run)))

    def by_unit(self, name: str, joint: str | None = None) -> dict[str, float]:
        """A metric by its unit: one number for all joints that share a unit, or that of one joint."""
        one, values = _declared(name), self[name]
        if not isinstance(values, np.ndarray):
            return {one.unit: values}
        units = one.units_of(self._run)
        if joint is not None:
            i = self._run.joint_names.index(joint)
            return {units[i]: float(values[i])}
        places = {unit: [i for i, each in enumerate(units) if each == unit] for unit in dict.fromkeys(units)}
        return {unit: one.of_joints(self._run, values, joints) for unit, joints in places.items()}

    def overall(self, name: str) -> float:
        """A metric as one number for all joints; NaN where joints of different units have none."""
        numbers = list(self.by_unit(name).values())
        return numbers[0] if len(numbers) == 1 else np.nan

    def content(self) -> Content:
        """Two tables: of the whole arm, and joint by joint."""
        run = self._run
        whole = [
            (METRICS[name].title, value, unit, METRICS[name].meaning(run.n))
            for name in METRICS
            for unit, value in self.by_unit(name).items()
            if not math.isnan(value)
        ]
        tables = [Table(title="Whole arm", columns=("metric", "value", "unit", "what it is"), rows=whole)]
        if run.n > 1:
            each = {name: self[name] for name, one in METRICS.items() if one.per_joint}
            rows = [
                (METRICS[name].title, self.unit(name), *values.tolist())
                for name, values in each.items()
                if isinstance(values, np.ndarray) and not np.isnan(values).all()
            ]
            tables.append(Table(title="Joint by joint", columns=("metric", "unit", *run.joint_names), rows=rows))
        return Content(title="Metrics", tables=tables)

    def json(self) -> dict[str, Any]:
        """As plain values: {"duration", "rms_error": {"unit", "overall", "by_unit", "joints"}, ...}."""
        out: dict[str, Any] = {"duration": {"unit": "s", "overall": self.duration}}
        for name, values in self.items():
            out[name] = {"unit": self.unit(name), "overall": _plain(self.overall(name))}
            if isinstance(values, np.ndarray):
                out[name]["by_unit"] = {unit: _plain(number) for unit, number in self.by_unit(name).items()}
                out[name]["joints"] = dict(zip(self._run.joint_names, map(_plain, values.tolist()), strict=True))
        return out


def _declared(name: str) -> Metric:
    if name not in METRICS:
        raise unknown_name("a run", "metric", name, METRICS)
    return METRICS[name]


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
