"""What a scenario says of its runs: the declared sections [run], [[event]], [outputs] and [[pass]]."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from taut.arm.description import Arm
from taut.base.errors import RangeError, ShapeError, UnknownNameError, UsageError, quoted_list, unknown_name
from taut.base.fields import REQUIRED, Declaration, Declared, Field, Refusal
from taut.record.metrics import METRICS
from taut.runtime.events import Event
from taut.scenarios.reading import read
from taut.scenarios.toml import Table, shown

__all__ = ["FILES", "Outputs", "PassFigure", "RunSection", "Text", "Whole", "read_event"]

FILES: Final = {
    "plot": (".png", ".pdf", ".svg"),
    "video": (".gif", ".mp4"),
    "log": (".mcap",),
    "csv": (".csv",),
}
MAX_NAME: Final = 200  # bytes of a file's name; systems take 255, and a file is written under a longer one first


class Text(Declaration[Any]):
    """A text; with suffixes the name of a file that ends in one of them."""

    def __init__(self, *suffixes: str, default: Any = REQUIRED, optional: bool = False, doc: str = "") -> None:
        super().__init__(default, optional=optional, doc=doc)
        self.suffixes = suffixes

    def rule(self) -> str:
        return f"a file name ending in {' or '.join(self.suffixes)}" if self.suffixes else "a text in quotes"

    def checked(self, value: Any, owner: Any = None, joints: Any = None) -> str:  # noqa: ARG002
        if not isinstance(value, str):
            raise Refusal(UsageError, self.name, f"must be a text in quotes; got {shown(value)}", value)
        if self.suffixes:
            path = Path(value)
            if path.name != value or path.suffix not in self.suffixes or not value.isprintable():
                raise Refusal(UsageError, self.name, f"must be {self.rule()}; got {value!r}", value)
            if len(value.encode()) > MAX_NAME:
                size = len(value.encode())
                raise Refusal(RangeError, self.name, f"must be a file name of at most {MAX_NAME} bytes; got {size}")
        return value


class Whole(Declaration[int]):
    """A whole number."""

    def __init__(self, *, minimum: int, maximum: float = math.inf, default: Any = REQUIRED, doc: str = "") -> None:
        super().__init__(default, doc=doc)
        self.minimum, self.maximum = minimum, maximum

    def rule(self) -> str:
        most = f" and <= {self.maximum}" if self.maximum < math.inf else ""
        return f"a whole number >= {self.minimum}{most}"

    def checked(self, value: Any, owner: Any = None, joints: Any = None) -> int:  # noqa: ARG002
        if isinstance(value, bool) or not isinstance(value, int) or not self.minimum <= value <= self.maximum:
            raise Refusal(RangeError, self.name, f"must be {self.rule()}; got {shown(value)}", value)
        return value


class Metric(Declaration[Any]):
    """The name of a metric of a run, or of several, each once."""

    def __init__(self, *, several: bool = False, doc: str = "") -> None:
        super().__init__(optional=several, doc=doc)
        self.several = several

    def rule(self) -> str:
        return "names of metrics, each once" if self.several else "the name of a metric"

    def checked(self, value: Any, owner: Any = None, joints: Any = None) -> Any:  # noqa: ARG002
        names = value if self.several else [value]
        if not isinstance(names, (list, tuple)) or not all(isinstance(name, str) for name in names):
            what = 'an array of texts such as ["rms_error", "stuck_time"]' if self.several else "a text in quotes"
            raise Refusal(UsageError, self.name, f"must be {what}; got {shown(value)}", value)
        if not 0 < len(names) == len(set(names)):
            raise Refusal(
                UsageError, self.name, f"must name one metric at least, each once; got {list(names)}", value
            )
        for name in names:
            if name not in METRICS:
                raise Refusal(
                    UnknownNameError,
                    self.name,
                    f"must name what is measured: {unknown_name('a run', 'metric', name, METRICS)}",
                    value,
                )
        return tuple(names) if self.several else value


class Window(Declaration[Any]):
    """A part of a run, [start, end] in seconds."""

    unit = "s"

    def rule(self) -> str:
        return "[start, end] with 0 <= start < end [s]"

    def checked(self, value: Any, owner: Any = None, joints: Any = None) -> tuple[float, float]:  # noqa: ARG002
        numbers = isinstance(value, (list, tuple)) and len(value) == 2 and all(type(x) in (int, float) for x in value)
        if not numbers or not 0.0 <= value[0] < value[1] < math.inf:
            raise Refusal(ShapeError, self.name, f"must be {self.rule()}; got {shown(value)}", value)
        return float(value[0]), float(value[1])


class Start(Declaration[Any]):
    """A state at the start: a number or one per joint; for positions "home" too."""

    def __init__(self, unit: str, *, home: bool = False, doc: str = "") -> None:
        super().__init__(optional=True, doc=doc)
        self.unit, self.home = unit, home

    def rule(self) -> str:
        return 'numbers, one per joint, or "home"' if self.home else "a number or an array of numbers"

    def checked(self, value: Any, owner: Any = None, joints: Any = None) -> Any:  # noqa: ARG002
        if (value == "home" and self.home) or (isinstance(value, (int, float, list)) and not isinstance(value, bool)):
            return value
        raise Refusal(UsageError, self.name, f"must be {self.rule()}; got {shown(value)}", value)


class RunSection(Declared):
    """[run]: how long each run takes, from where, and with which noise."""

    duration: Field = Field(unit="s", above=0.0)
    seed: Whole = Whole(minimum=0, default=0, doc="of the noise")
    q0: Start = Start("rad | m", home=True, doc="positions at the start; the plant's home if left out")
    v0: Start = Start("rad/s | m/s", doc="velocities at the start")

    def values(self, arm: Arm) -> dict[str, Any]:
        """The fields of a scenario, for an arm."""
        q0 = arm.home if isinstance(self.q0, str) else self.q0
        return {"duration": float(self.duration), "seed": self.seed, "q0": q0, "v0": self.v0}


class Outputs(Declared):
    """[outputs]: the files that a scenario makes, and what its table and pictures show."""

    plot: Text = Text(*FILES["plot"], optional=True)
    video: Text = Text(*FILES["video"], optional=True)
    log: Text = Text(*FILES["log"], optional=True)
    csv: Text = Text(*FILES["csv"], optional=True)
    shown: Text = Text(optional=True, doc="the law whose video, log and table are made; the last if left out")
    shown_case: Text = Text(optional=True, doc="the case; the last if left out")
    columns: Metric = Metric(several=True, doc="metrics in the table and the plot")
    joint: Text = Text(optional=True, doc="whose numbers and motion these are; all joints together if left out")
    window: Window = Window(optional=True, doc="of the run that the table is about")


class PassFigure(Declared):
    """[[pass]]: a bound on a metric that decides whether a scenario passes."""

    law: Text = Text()
    metric: Metric = Metric()
    case: Text = Text(optional=True, doc="every case if left out")
    joint: Text = Text(optional=True, doc="all joints together if left out")
    part: Text = Text(optional=True, doc="of laws side by side the one, or of a task the phase, that it is about")
    min: Field = Field(optional=True)
    max: Field = Field(optional=True)
    window: Window = Window(optional=True, doc="of the run that it is about")

    def check(self) -> None:
        """There is a bound, and room between both."""
        if self.min is None and self.max is None:
            self.refuse("", "needs min, max or both")
        low, high = self.bounds
        if low > high:
            self.refuse("min", f"must be <= max, which is {high:g}; got {low:g}", RangeError)

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and largest value that passes."""
        return -math.inf if self.min is None else float(self.min), math.inf if self.max is None else float(self.max)


def require_one(table: Table, key: str, name: str | None, known: Iterable[str]) -> None:
    """A name that a section gives is one of those that there are.

    Raises:
        ScenarioError: It is not.
    """
    if name is not None and name not in known:
        raise table.error(f"must be one of {quoted_list(known)}; got {name!r}", key)


def require_case(table: Table, key: str, name: str | None, cases: list[str]) -> None:
    """The name of a case is one of those that there are.

    Raises:
        ScenarioError: It is not.
    """
    if name is not None and not cases:
        raise table.error(f"is for a scenario with cases, [cases.{name!r}]; leave it out", key)
    require_one(table, key, name, cases)


def read_event(table: Table) -> Event:
    """An event that sets parameters, or one that pushes."""
    if "push" not in table:
        values = table.get("set")
        example = '{ "law.kp" = 150.0 }'
        if "set" in table and (not isinstance(values, dict) or not values):
            raise table.error(f"must be a table such as {example}; got {shown(values)}", "set")
        for path, value in (values or {}).items():
            if isinstance(value, dict):
                raise table.error(f"must have each path in quotes, such as {example}; got a table '{path}'", "set")
        return read(Event, table)  # type: ignore[no-any-return]
    if "set" in table:
        raise table.error("sets parameters or pushes; got both set and push; write two events")
    table.only(("t", "push"))
    table.need("t")
    push = table.table("push")
    of = push.get("of", "environment")
    if not isinstance(of, str):
        raise push.error(f'must be the path of a push, such as "environment.push"; got {of!r}', "of")
    with table.blamed("t"):
        Event.push(t=table.get("t"))
    return read(Event.push, push, t=table.get("t"))  # type: ignore[no-any-return]
