"""A folder of a sweep: a Parquet file for each chunk that is done, and what the sweep is."""

from __future__ import annotations

import importlib
import json
import math
import os
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.analysis.sweeps.chunks import Results
from taut.analysis.sweeps.plan import Plan
from taut.base.errors import FileError, missing_extra
from taut.record.log.files import written_aside

ABOUT: Final = "sweep.json"


def parquet() -> Any:
    """pyarrow, with its Parquet files."""
    try:
        importlib.import_module("pyarrow.parquet")
        return importlib.import_module("pyarrow")
    except ImportError as cause:
        raise missing_extra("a sweep with out=, which writes Parquet files,", "pyarrow", "sweep") from cause


class Memory:
    """The chunks of one sweep in memory."""

    def __init__(self, samples: int) -> None:
        self._columns: dict[str, Any] = {}
        self._done = np.zeros(samples, dtype=bool)

    def has(self, first: int) -> bool:
        """Whether the chunk that begins with a sample is there."""
        return bool(self._done[first])

    def write(self, results: Results) -> None:
        """Keep the results of a chunk."""
        for name, column in results.columns.items():
            if name not in self._columns:
                self._columns[name] = np.empty((len(self._done), *np.shape(column)[1:]), dtype=column.dtype)
            self._columns[name][results.table["sample"]] = column
        self._done[results.table["sample"]] = True

    def table(self) -> dict[str, Any]:
        """The columns of all that is done, by name."""
        if self._done.all():
            return self._columns
        return {name: column[self._done] for name, column in self._columns.items()}


class Store:
    """Chunks of one sweep in a folder; a file appears whole or not at all.

    Raises:
        MissingExtraError: pyarrow is not installed.
        FileError: The folder cannot be used, or holds another sweep.
    """

    def __init__(self, folder: str | os.PathLike[str], plan: Plan, size: int) -> None:
        self.arrow, self.folder, self._firsts = parquet(), Path(folder), range(0, plan.samples, size)
        self._shapes = {each.path: each.shape for each in plan.varied if each.shape}
        about = {"sweep": plan.digest, "samples": plan.samples, "seed": plan.seed, "chunk": size}
        about |= {"varied": {each.path: repr(each.drawn or "listed") for each in plan.varied}}
        file = self.folder / ABOUT
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else None
            if known is None:
                with written_aside("sweep", file) as aside:
                    aside.write_text(json.dumps(about, indent=1), encoding="utf-8")
        except (OSError, ValueError) as cause:
            raise FileError(
                f"the folder '{folder}' of the sweep cannot be used: {cause}", name=str(folder)
            ) from cause
        if known is not None and known != about:
            raise FileError(
                f"the folder '{folder}' holds another sweep, of another loop, seed, number of samples or other "
                "settings; name another folder",
                name=str(folder),
            )

    def has(self, first: int) -> bool:
        """Whether the chunk that begins with a sample is there."""
        return self._file("chunk", first).exists()

    def write(self, results: Results) -> None:
        """Keep the results of a chunk; its table last, which makes it done."""
        first = int(results.table["sample"][0])
        for kind, columns in (("rows", results.rows), ("chunk", results.columns)):
            if columns:
                flat = {name: x for key, column in columns.items() for name, x in _flat(key, column)}
                with written_aside("sweep", self._file(kind, first)) as aside:
                    self.arrow.parquet.write_table(self.arrow.table(flat), aside)

    def table(self) -> dict[str, Any]:
        """The columns of all that is done, by name."""
        parts = [self.arrow.parquet.read_table(self._file("chunk", k)) for k in self._firsts if self.has(k)]
        if not parts:
            return {}
        whole = self.arrow.concat_tables(parts)
        columns = {name: np.asarray(whole[name].to_numpy()) for name in whole.column_names}
        for path, shape in self._shapes.items():
            columns[path] = np.stack([columns.pop(name) for name in _entries(path, shape)], axis=1).reshape(
                -1, *shape
            )
        return columns

    def _file(self, kind: str, first: int) -> Path:
        return self.folder / f"{kind}-{first:010d}.parquet"


def _entries(name: str, shape: tuple[int, ...]) -> list[str]:
    return [f"{name}[{i}]" for i in range(math.prod(shape))]


def _flat(name: str, column: Any) -> list[tuple[str, Any]]:
    """A column, or one for each entry."""
    if np.ndim(column) < 2:
        return [(name, column)]
    names = _entries(name, np.shape(column)[1:])
    return list(zip(names, np.reshape(column, (len(column), len(names))).T, strict=True))
