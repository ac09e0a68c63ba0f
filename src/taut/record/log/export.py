"""A run as a table (CSV): one column per number, such as q.elbow, terms.P.elbow, or extra.F_ext.0 without a joint."""

from __future__ import annotations

import csv
import itertools
import os
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.record.log.files import checked_target, written_aside
from taut.record.log.writing import columns_of
from taut.record.progress import Progress

if TYPE_CHECKING:
    from taut.record.run import Run

ROWS: Final = 4096  # lines of a CSV that are written at a time
WRENCH: Final = ("N",) * 3 + ("N m",) * 3


def _columns(run: Run) -> dict[str, tuple[list[str], tuple[str, ...]]]:
    """Of each array the names of the numbers in one row, and their units where they are known."""
    known = {
        "t": ("s",),
        "q": run.units,
        "v": tuple(f"{unit}/s" for unit in run.units),
        "a": tuple(f"{unit}/s^2" for unit in run.units),
        "tau": run.effort_units,
        "tau_cut": run.effort_units,
        "tau_meas": run.effort_units,
        "command": run.command_units,
        "F_ext": WRENCH,
        "a_tip": ("m/s^2",) * 3,
        "p": ("m",) * 3,
        "twist": ("m/s",) * 3 + ("rad/s",) * 3,
        "acceleration": ("m/s^2",) * 3 + ("rad/s^2",) * 3,
    }
    out = {}
    grown = type(run.reference).fields(run.n + 1)  # six entries of a twist are no joints of an arm with six
    fixed = {f"reference.{name}" for name, shape in grown.items() if shape != (run.n + 1,)}
    for name, array in columns_of(run).items():
        if array.shape[1:] == (run.n,) and not name.startswith("extra.") and name not in fixed:
            names = [f"{name}.{joint}" for joint in run.joint_names]
        else:
            places = itertools.product(*map(range, array.shape[1:]))
            names = [".".join([name, *map(str, place)]) for place in places]
        units = run.command_units if name.startswith("terms.") else known.get(name.rpartition(".")[2], ())
        units = ("J",) * len(names) if name.startswith("extra.work.") else units
        out[name] = (names, units if len(units) == len(names) else ("",) * len(names))
    return out


def to_csv(run: Run, path: str | os.PathLike[str], *, progress: bool | None = None) -> Path:
    """A table with one header line; every number has as many digits as it takes to read it back exactly."""
    target = checked_target("table", path, (".csv",))
    header = [
        f"{name} [{unit}]" if unit else name
        for names, units in _columns(run).values()
        for name, unit in zip(names, units, strict=True)
    ]
    tables = [array.reshape(len(run), prod(array.shape[1:])) for array in columns_of(run).values()]
    with written_aside("table", target) as aside, aside.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        with Progress(len(run), progress, "writing") as bar:
            for first in range(0, len(run), ROWS):
                rows = np.hstack([table[first : first + ROWS] for table in tables]).tolist()
                writer.writerows(rows)
                bar.advance(len(rows))
    return target
