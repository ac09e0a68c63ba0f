"""The declaration of a metric, and the metrics of a run as a mapping from their names to numbers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, TypeVar

import numpy as np

from taut.base.checks import read_only
from taut.base.errors import ShapeError, UsageError, unknown_name
from taut.base.paths import Named
from taut.base.result import Content, Result, Table
from taut.base.types import Float64Array

if TYPE_CHECKING:
    from taut.record.run import Run

Numbers: TypeAlias = Float64Array | float
Together: TypeAlias = "Literal['sum', 'largest', 'norm'] | Callable[[Run, Sequence[int]], float]"
Needs: TypeAlias = Literal["", "set-point", "joint motion", "task motion", "force", "press"]
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
        needs: What the reference has to ask for, so that a scenario can refuse it elsewhere.
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
    needs: Needs = ""
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

    @property
    def per_unit(self) -> bool:
        """Whether joints in rad and joints in m have no common number of it."""
        return "{" in self.unit

    def meaning(self, joints: int = 1) -> str:
        """What it is, and how it is put together for several joints."""
        words = f"the {self.together}" if isinstance(self.together, str) else "that of all together"
        return f"{self.doc}; for all joints {words}" if self.per_joint and joints > 1 else self.doc

    def units_of(self, run: Run) -> tuple[str, ...]:
        """Unit of each joint's number."""
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


class JointsTogether(Mapping[str, float]):
    """One number of each metric for some joints together."""

    def __init__(self, metrics: Metrics, joints: Sequence[int] | None) -> None:
        self._metrics, self._joints = metrics, joints

    def __getitem__(self, name: str) -> float:
        return self._metrics._together(name, self._joints)

    def __iter__(self) -> Iterator[str]:
        return (name for name, one in METRICS.items() if self._joints is None or one.per_joint)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __repr__(self) -> str:
        return repr(dict(self))


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
        self._run = dataclasses.replace(
            run
        )  # not the run itself, which keeps its metrics: no circle holds its arrays
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
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self._run.joint_names

    @property
    def duration(self) -> float:
        """Time from the first tick to the last [s]."""
        return float(self._run.t[-1] - self._run.t[0]) if len(self._run) else 0.0

    @property
    def setpoint(self) -> bool:
        """Whether the reference asks for one position of the joints throughout."""
        return self._run.is_setpoint

    @property
    def overall(self) -> Mapping[str, float]:
        """One number of each for all joints together; NaN where joints of different units have none."""
        return JointsTogether(self, None)

    @cached_property
    def groups(self) -> Mapping[str, Mapping[str, float]]:
        """The same for the joints of each unit: {"rad": {"rms_error": ...}, "m": {"rms_error": ...}}."""
        units = self._run.units
        joints = {unit: [i for i, each in enumerate(units) if each == unit] for unit in dict.fromkeys(units)}
        of_unit = {unit: JointsTogether(self, places) for unit, places in joints.items()}
        return Named("a run", "group of joints, by unit,", of_unit)

    def _together(self, name: str, joints: Sequence[int] | None) -> float:
        one, values = _declared(name), self[name]
        if not isinstance(values, np.ndarray):
            return values
        if joints is None and one.per_unit and len(self.groups) > 1:
            return np.nan
        return one.of_joints(self._run, values, range(self._run.n) if joints is None else joints)

    def unit(self, name: str, group: str | None = None) -> str:
        """Unit of a metric, of a group if one is named; of joints with different units, both."""
        one = _declared(name)
        if not one.per_joint:
            return one.unit
        places = zip(self._run.units, one.units_of(self._run), strict=True)
        return " | ".join(dict.fromkeys(unit for of, unit in places if group in (None, of)))

    def by_unit(self, name: str, joint: str | None = None) -> dict[str, float]:
        """A metric by its unit: of one joint; or the overall number, or one for each group where there is none."""
        one, values = _declared(name), self[name]
        if joint is not None and isinstance(values, np.ndarray):
            i = self.joint_names.index(joint)
            return {one.units_of(self._run)[i]: float(values[i])}
        if len(self.groups) == 1 or not one.per_unit:
            return {self.unit(name): self.overall[name]}
        return {self.unit(name, group): numbers[name] for group, numbers in self.groups.items()}

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
        """As plain values: {"duration", "setpoint", "rms_error": {"unit", "overall", "groups", "joints"}, ...}."""
        out: dict[str, Any] = {"duration": {"unit": "s", "overall": self.duration}, "setpoint": self.setpoint}
        for name, values in self.items():
            out[name] = {"unit": self.unit(name), "overall": _plain(self.overall[name])}
            if isinstance(values, np.ndarray):
                out[name]["groups"] = {
                    group: {"unit": self.unit(name, group), "overall": _plain(numbers[name])}
                    for group, numbers in self.groups.items()
                }
                out[name]["joints"] = dict(zip(self.joint_names, map(_plain, values.tolist()), strict=True))
        return out


def _declared(name: str) -> Metric:
    if name not in METRICS:
        raise unknown_name("a run", "metric", name, METRICS)
    return METRICS[name]


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
