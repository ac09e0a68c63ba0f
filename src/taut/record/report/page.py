"""Reports of results that do not describe themselves in `content()` yet. It goes when the last of them does."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from taut.base import result
from taut.base.plot_style import short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Page", "Picture", "Table", "content_of_other"]

HEADING: Final = 100  # letters of a title
CLAUSE: Final = re.compile(r"[,;:] ")  # where a longer one may end


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table with a head."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    note: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A figure, and what it shows in words."""

    title: str
    figure: Figure


@dataclass(frozen=True, kw_only=True, eq=False)
class Page:
    """A report before it is a file."""

    title: str
    summary: Sequence[str] = ()
    faults: Sequence[str] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    settings: Mapping[str, str] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    repeat: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)


def content_of_other(x: Any) -> result.Content | None:
    """The description of what has `report_page()`, `plot()` or `report()`; None of all else."""
    if isinstance(x, type):
        return None
    if hasattr(x, "report_page"):
        page = x.report_page()
        values = {name: value for name, value in vars(page).items() if name not in ("tables", "pictures")}
        return result.Content(
            **values,
            tables=[
                result.Table(title=one.title, columns=one.heads, rows=one.rows, note=one.note) for one in page.tables
            ],
            figures={one.title: partial(getattr, one, "figure") for one in page.pictures},
        )
    if not (hasattr(x, "report") or hasattr(x, "plot")):
        return None
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(x).__name__)
    kind = name[:1].upper() + name[1:].lower()
    words = x.report() if hasattr(x, "report") else str(x)
    return result.Content(
        title=_heading(kind, words),
        figures={kind: x.plot} if hasattr(x, "plot") else {},
        texts={"In words": words},
    )


def _heading(kind: str, words: str) -> str:
    """A title: what it is and its first line, of a long one its first clauses; the head of a table is none."""
    first = words.partition("\n")[0].strip()
    if not first or "  " in first:
        return kind
    title = first[:1].upper() + first[1:] if kind.lower() in first.lower() else f"{kind}: {first}"
    while len(title) > HEADING and (ends := list(CLAUSE.finditer(title))):
        title = title[: ends[-1].start()]
    return short(title, HEADING)
