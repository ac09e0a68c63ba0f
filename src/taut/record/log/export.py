"""A run as a table (CSV): one column per number, such as q.elbow, terms.P.elbow, or extra.F_ext.0 without a joint."""

from __future__ import annotations

import csv
import itertools
import os
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taut.record.log.files import checked_target, written_aside

if TYPE_CHECKING:
    from taut.record.run import Run


def column_names(run: Run) -> dict[str, list[str]]:
    """The name of each number of a tick, by the array of `run.arrays()` that it is in."""
    grown = type(run.reference).fields(run.n + 1)  # six entries of a twist are no joints of an arm with six
    fixed = {f"reference.{name}" for name, shape in grown.items() if shape != (run.n + 1,)}
    out = {}
    for name, array in run.arrays().items():
        of_joints = array.shape[1:] == (run.n,) and not name.startswith("extra.") and name not in fixed
        axes = [run.joint_names] if of_joints else map(range, array.shape[1:])
        out[name] = [".".join([name, *map(str, place)]) for place in itertools.product(*axes)]
    return out


def to_csv(run: Run, path: str | os.PathLike[str]) -> Path:
    """A table with one header line; every number has as many digits as it takes to read it back exactly."""
    target = checked_target("table", path, (".csv",))
    rows = np.hstack([array.reshape(len(run), prod(array.shape[1:])) for array in run.arrays().values()])
    with written_aside("table", target) as aside, aside.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(itertools.chain(*column_names(run).values()))
        writer.writerows(row.tolist() for row in rows)
    return target
