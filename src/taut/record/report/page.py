"""What a report is made of, as plain values: tables, pictures, settings, and how to do it again."""

from __future__ import annotations

import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from importlib import metadata
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["VERSIONS", "Page", "Picture", "Reportable", "Table", "stated", "versions", "without_folders"]

VERSIONS: Final = "versions"  # in run.info: of the programs that made it
PACKAGES: Final = ("numpy", "llvmlite", "mujoco")
FOLDERS: Final = re.compile(
    r"(?<![\w.~/\\:])(?:~|[A-Za-z]:)?[/\\](?:[^\s/\\'\"<>:]+[/\\])+|file:///?(?:[^\s/'\"<>]+/)*"
)


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table with a head."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1  # columns of words, which stand first; the others are numbers
    note: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A figure, and what it shows in words."""

    title: str
    figure: Figure


@dataclass(frozen=True, kw_only=True, eq=False)
class Page:
    """A report before it is a file.

    Args:
        title: What was run, compared or designed.
        summary: Sentences that stand first.
        faults: What went wrong, if anything; they stand above all else.
        tables: Numbers.
        pictures: Figures.
        settings: What it was done with, as text by name.
        texts: Longer texts by their title, such as a scenario.
        repeat: How to do it again: a command, or lines of Python.
        versions: Of the programs that it was done with; those that make the report if left out.
    """

    title: str
    summary: Sequence[str] = ()
    faults: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    settings: Mapping[str, str] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    repeat: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)


@runtime_checkable
class Reportable(Protocol):
    """What says itself what its report holds."""

    def report_page(self) -> Page:
        """The page."""
        ...


@cache
def versions() -> Mapping[str, str]:
    """The versions of taut and of what it computes with, and the kind of machine."""
    from taut import __version__

    found = {"taut": __version__}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    found["Python"] = platform.python_version()
    found["platform"] = f"{platform.system()} {platform.machine()}"
    return found


def stated(x: object) -> str:
    """What a frozen dataclass states, in one line: its fields that are not None."""
    if not is_dataclass(x) or isinstance(x, type):
        return str(x.tolist()) if isinstance(x, np.ndarray) else str(x)
    found = {part.name: getattr(x, part.name) for part in fields(x)}
    words = [
        f"{name} = {type(value).__name__}({stated(value)})" if is_dataclass(value) else f"{name} = {stated(value)}"
        for name, value in found.items()
        if value is not None
    ]
    return ", ".join(words) or "none"


def without_folders(text: str) -> str:
    """A text whose files have their names alone: where they lie is nobody's business.

    Example:
        >>> without_folders("stopped at /home/anna/laws/mine.py:12 after 3 m/s, 1/2 of ~/work/a.toml")
        'stopped at mine.py:12 after 3 m/s, 1/2 of a.toml'
    """
    return FOLDERS.sub("", text)
