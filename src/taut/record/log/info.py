"""The entries of run.info: what each has to be, so that whoever reads one need not look again."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from taut.arm.description import Arm
from taut.arm.rules import indefinite
from taut.base.types import Float64Array
from taut.control.tasks.task import ENDED
from taut.control.trajectories.compound import PhaseSample
from taut.record.felt import FELT
from taut.record.film.surroundings import AROUND, Around
from taut.record.metrics import LIMITS
from taut.record.part import PARTS
from taut.record.phases import PHASES
from taut.record.report.arm_numbers import DYNAMICS, arm_from_json
from taut.record.report.page import VERSIONS
from taut.record.report.plant_options import OPTIONS
from taut.record.task import TOOL

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = ["wrong_entry"]

Check: TypeAlias = Callable[[Any], bool]

COLUMNS: Final[Mapping[str, tuple[int, ...]]] = {"F_ext": (6,), "phase": (), "phase_ended": ()}
PAYLOAD: Final[Mapping[str, tuple[int, ...]]] = {"mass": (), "com": (3,), "inertia": (6,)}
LARGEST: Final = 1e12  # of a length, mass or gain, in SI units
ROTATION: Final = 1e-6  # how far R R^T may be from 1


def wrong_entry(run: Run) -> str | None:
    """The first entry of a run's info, or further column, that is not what `taut.run` records; None if all are."""
    for name, shape in COLUMNS.items():
        if name in run.extra and run.extra[name].shape[1:] != shape:
            return name
    for name, check in _entries(run).items():
        try:
            if name in run.info and not check(run.info[name]):
                return name
        except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError):
            return name
    return None


def _entries(run: Run) -> dict[str, Check]:
    values = _each_value(_array)
    return {
        "rate": lambda value: _array(value, ()) and 0.0 < value < math.inf,
        "duration": lambda value: _array(value, ()),
        "seed": lambda value: type(value) is int and value >= 0,
        "law": _text,
        "arm": _text,
        "plant": _text,
        "parameters": lambda value: values(value) and _payload(value),
        "events": lambda value: (
            type(value) is list and all(_array(e["t"], ()) and values(e["set"]) and _payload(e["set"]) for e in value)
        ),
        LIMITS: _each_value(_each_value(lambda value: _array(value, ()))),
        VERSIONS: _each_value(_text),
        "scenario": lambda value: not value or all(_text(value[key]) for key in ("name", "law", "case", "text")),
        DYNAMICS: lambda value: _dynamics(value, run.n),
        OPTIONS: _options,
        "stability": _stability,
        AROUND: lambda value: bool(Around.of_json(value)),
        PARTS: _each_value(lambda value: _of_law(value, len(value["joints"])) and _joints(value["joints"], run)),
        PHASES: lambda value: _phases(value, run),
        TOOL: lambda value: _chain(value, run.n),
        FELT: _felt,
    }


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _each_value(check: Check) -> Check:
    return lambda value: isinstance(value, dict) and all(map(check, value.values()))


def _array(value: Any, shape: tuple[int, ...] | None = None, *, finite: bool = False) -> bool:
    """Numbers in a rectangular array, of a shape where one is given."""
    array = np.asarray(value)
    fits = array.dtype.kind in "iuf" and (shape is None or array.shape == shape)
    return fits and (not finite or bool((np.abs(array) < LARGEST).all()))


def _rotation(value: Any) -> bool:
    if not _array(value, (3, 3), finite=True):
        return False
    R: Float64Array = np.asarray(value, dtype=np.float64)
    return bool(np.abs(R @ R.T - np.eye(3)).max() < ROTATION and np.linalg.det(R) > 0.0)


def _place(value: Mapping[str, Any], R: str = "R", p: str = "p") -> bool:
    return _rotation(value[R]) and _array(value[p], (3,), finite=True)


def _chain(value: Mapping[str, Any], n: int) -> bool:
    links = all(
        type(link["joint"]) is int and 0 <= link["joint"] < n and type(link["prismatic"]) is bool and _place(link)
        for link in value["links"]
    )
    return links and _text(value["frame"]) and value["n"] == n and _place(value) and _place(value, "R_WB", "p_WB")


def _felt(value: Mapping[str, Any]) -> bool:
    square = all(_array(value[name], (6, 6), finite=True) for name in ("D", "B", "K"))
    return square and bool(np.linalg.eigvalsh(value["D"])[0] > 0.0)


def _of_law(value: Mapping[str, Any], n: int) -> bool:
    return _chain(value[TOOL], n) and (FELT not in value or _felt(value[FELT]))


def _joints(names: Any, run: Run) -> bool:
    return bool(names) and all(name in run.joint_names for name in names) and len(set(names)) == len(names)


def _payload(value: Mapping[str, Any]) -> bool:
    paths = ((f"model.payload.{name}", shape) for name, shape in PAYLOAD.items())
    return all(path not in value or _array(value[path], shape, finite=True) for path, shape in paths)


def _dynamics(value: Mapping[str, Any], n: int) -> bool:
    arms = [arm_from_json(value[name]) for name in ("controller", "plant")]
    return all(arm is not None and arm.n == n and _possible(arm) for arm in arms)


def _possible(arm: Arm) -> bool:
    """Bodies whose mass matrix is positive definite."""
    numbers = [np.r_[body.mass, body.com, body.inertia.ravel()] for body in arm.bodies]
    return _array(numbers, finite=True) and indefinite(arm) is None


def _options(value: Mapping[str, Any]) -> bool:
    others, options = value["others"], value["options"]
    return (others is None or all(map(_text, others))) and (options is None or isinstance(options, dict))


def _stability(value: Mapping[str, Any]) -> bool:
    return value["stable"] in (None, True, False) and _text(value["message"])


def _phases(value: Mapping[str, Any], run: Run) -> bool:
    followed: set[str | None] | None = None
    if isinstance(run.reference, PhaseSample):
        followed = {None, *(part.name for part in run.reference.parts)}
    phases = all(
        _of_law(phase, run.n) and (followed is None or phase["follows"] in followed) for phase in value.values()
    )
    codes = set(np.unique(run.extra["phase"]).tolist()), set(np.unique(run.extra["phase_ended"]).tolist())
    return phases and codes[0] <= set(range(len(value) + 1)) and codes[1] <= {0, *ENDED}
