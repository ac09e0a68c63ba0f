"""Exports: a run as NumPy arrays, a pandas table, a CSV, MATLAB or NumPy file.

One number is one column, called after its array and its joint: q.elbow, v.elbow, tau.elbow, command.elbow,
terms.P.elbow, reference.q.elbow. Entries that belong to no joint are numbered: extra.F_ext.0.
"""

from __future__ import annotations

import itertools
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.errors import MissingExtraError, UsageError
from taut.base.paths import unflatten
from taut.base.types import Float64Array
from taut.record.log.files import checked_target, written_aside
from taut.record.log.messages import columns_of
from taut.record.progress import Progress

if TYPE_CHECKING:
    import pandas as pd

    from taut.record.run import Run

__all__ = ["arrays", "column_names", "to_csv", "to_mat", "to_npz", "to_pandas"]

ROWS: Final = 4096  # lines of a CSV that are written at a time


def arrays(run: Run) -> dict[str, Float64Array]:
    """Every array of a run by name, one row per tick: t, q, v, tau, command, terms.P, reference.q, extra.F_ext."""
    return columns_of(run)


def column_names(run: Run) -> dict[str, list[str]]:
    """Names of the numbers in one row of each array."""
    out = {}
    grown = type(run.reference).fields(run.n + 1)  # six entries of a twist are no joints of an arm with six
    fixed = {f"reference.{name}" for name, shape in grown.items() if shape != (run.n + 1,)}
    for name, array in columns_of(run).items():
        if array.shape[1:] == (run.n,) and not name.startswith("extra.") and name not in fixed:
            out[name] = [f"{name}.{joint}" for joint in run.joint_names]
        elif array.ndim == 1:
            out[name] = [name]
        else:
            places = itertools.product(*map(range, array.shape[1:]))
            out[name] = [".".join([name, *map(str, place)]) for place in places]
    return out


def units_of(run: Run) -> dict[str, list[str]]:
    """Unit of each number in one row of each array; empty where it is not known."""
    known: dict[str, tuple[str, ...]] = {
        "t": ("s",),
        "q": run.units,
        "v": tuple(f"{unit}/s" for unit in run.units),
        "tau": run.effort_units,
        "command": run.command_units,
        "reference.q": run.units,
        "reference.v": tuple(f"{unit}/s" for unit in run.units),
        "reference.a": tuple(f"{unit}/s^2" for unit in run.units),
        "reference.p": ("m",) * 3,
        "reference.twist": ("m/s",) * 3 + ("rad/s",) * 3,
        "reference.acceleration": ("m/s^2",) * 3 + ("rad/s^2",) * 3,
        "extra.F_ext": ("N",) * 3 + ("N m",) * 3,
        "extra.sensed.q": run.units,
        "extra.sensed.v": tuple(f"{unit}/s" for unit in run.units),
        "extra.sensed.F_ext": ("N",) * 3 + ("N m",) * 3,
        "extra.sensed.tau_meas": run.effort_units,
        "extra.sensed.q_motor": run.units,
        "extra.sensed.v_motor": tuple(f"{unit}/s" for unit in run.units),
        "extra.sensed.a_tip": ("m/s^2",) * 3,
        "extra.tau_cut": run.effort_units,
    }
    known |= {f"terms.{name}": run.command_units for name in run.terms}
    if len(set(run.effort_units)) == 1:  # the largest one of any joint
        known["extra.friction_residual"] = run.effort_units[:1]
    out = {}
    for name, columns in column_names(run).items():
        work = name.startswith("extra.work.")  # of the joints, or of what touches the tool
        units = ("J",) * len(columns) if work else known.get(name, ())
        out[name] = list(units) if len(units) == len(columns) else [""] * len(columns)
    return out


def _table(run: Run) -> tuple[list[str], list[str], list[Float64Array]]:
    """Names, units, and the arrays (k, columns) of a table, the time first."""
    names, units = column_names(run), units_of(run)
    tables = [array.reshape(len(run), len(names[name])) for name, array in columns_of(run).items()]
    return [*itertools.chain(*names.values())], [*itertools.chain(*units.values())], tables


def to_pandas(run: Run) -> pd.DataFrame:
    """A table with the time as index; `table.attrs["units"]` has the unit of each column."""
    try:
        import pandas as pd
    except ImportError as cause:
        raise MissingExtraError(
            "run.to_pandas() needs the package 'pandas', which is not installed; pip install pandas installs it",
            name="pandas",
        ) from cause
    names, units, tables = _table(run)
    frame = pd.DataFrame(np.hstack(tables[1:]), columns=names[1:], index=pd.Index(run.t, name="t"))
    frame.attrs["units"] = dict(zip(names, units, strict=True))
    return frame


def to_csv(run: Run, path: str | os.PathLike[str], *, progress: bool | None = None) -> Path:
    """A table with one header line; every number has as many digits as it takes to read it back exactly."""
    target = checked_target("table", path, (".csv",))
    names, units, tables = _table(run)
    header = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]
    with written_aside("table", target) as aside, aside.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(map(_quoted, header)) + "\n")
        with Progress(len(run), progress, "writing") as bar:
            for first in range(0, len(run), ROWS):
                rows = np.hstack([table[first : first + ROWS] for table in tables]).tolist()
                file.writelines(",".join(map(repr, row)) + "\n" for row in rows)
                bar.advance(len(rows))
    return target


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(c in name for c in ',"\n\r') else name


def to_npz(run: Run, path: str | os.PathLike[str]) -> Path:
    """An archive of the arrays, and of joint_names and units; it needs no pickle to be read."""
    target = checked_target("archive", path, (".npz",))
    words = {"joint_names": np.array(run.joint_names), "units": np.array(run.units)}
    with written_aside("archive", target) as aside, aside.open("wb") as file:
        np.savez(file, allow_pickle=False, **columns_of(run), **words)
    return target


def to_mat(run: Run, path: str | os.PathLike[str]) -> Path:
    """A MATLAB file with the struct `run`: run.t, run.q, run.terms.P, run.reference.q, run.joint_names, run.units."""
    from scipy.io import savemat

    target = checked_target("MATLAB file", path, (".mat",))
    fields: dict[str, Any] = unflatten(_with_matlab_names(columns_of(run)))
    fields["joint_names"] = np.array(run.joint_names, dtype=object)
    fields["units"] = np.array(run.units, dtype=object)
    fields["outcome"] = str(run.outcome)
    with written_aside("MATLAB file", target) as aside, aside.open("wb") as file:
        savemat(file, {"run": fields}, long_field_names=True, oned_as="column")
    return target


def _with_matlab_names(columns: dict[str, Float64Array]) -> dict[str, Float64Array]:
    """Columns by paths that MATLAB takes: letters, digits and underscores, a letter first."""
    out = {}
    for path, array in columns.items():
        parts = ["".join(c if c.isascii() and c.isalnum() else "_" for c in part) for part in path.split(".")]
        name = ".".join(part if part[:1].isalpha() else f"x{part}" for part in parts)
        if name in out:
            raise UsageError(f"'{path}' and another column both become '{name}' in MATLAB; rename one", name=path)
        out[name] = array
    return out
