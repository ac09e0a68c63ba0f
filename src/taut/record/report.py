"""taut.report: a run or a result as one HTML file that needs no other file, no network and no script."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import os
import re
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.errors import UsageError, count_of
from taut.base.plot_style import short
from taut.base.result import Content, Result, Table, cell_text
from taut.record.info import ScenarioInfo, versions
from taut.record.log.files import checked_target, written_aside
from taut.record.plain import plain
from taut.record.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESOLUTION: Final = 120  # [dots per inch]
MIN_TICKS_OF_REPORT: Final = 2
LATE: Final = 1.5  # periods between two ticks that follow each other
MAX_VALUE_LETTERS: Final = 400  # of a value
STYLE: Final = """
:root { color-scheme: light dark; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 1rem; font: 1rem/1.5 system-ui, sans-serif; }
h1 { font-size: 1.4rem; line-height: 1.25; }
h2 { font-size: 1.1rem; margin: 2rem 0 .5rem; border-bottom: 1px solid #8886; }
h1, p { overflow-wrap: anywhere; }
.fault { border-left: .3rem solid #d33; padding-left: .8rem; }
.wide, pre { overflow-x: auto; }
.wide, figure { margin: .5rem 0 1rem; }
table { border-collapse: collapse; font-size: .875rem; }
caption { text-align: left; font-weight: 600; }
th, td { padding: .2rem .7rem .2rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid #8886; }
.n { text-align: right; font-variant-numeric: tabular-nums; }
td.n { white-space: nowrap; }
.w { min-width: 6.5rem; }
.note { font-size: .875rem; }
pre { background: #8882; padding: .7rem; font-size: .8rem; }
.again { white-space: pre-wrap; overflow-wrap: anywhere; }
figure img { width: 100%; min-width: 40rem; background: #fff; display: block; }
@media print {
  .wide, pre { overflow: visible; }
  table { font-size: 7.5pt; }
  th, td, pre { overflow-wrap: anywhere; white-space: pre-wrap; }
  figure img { min-width: 0; max-height: 24cm; width: auto; max-width: 100%; }
  figure, tr { break-inside: avoid; }
}
"""
POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
FOLDERS: Final = re.compile(
    r"(?<![\w.~/\\:])(?:~|[A-Za-z]:)?[/\\](?:[^\s/\\'\"<>:]+[/\\])+|file:///?(?:[^\s/'\"<>]+/)*"
)


def report(x: object, path: str | os.PathLike[str], *, title: str = "", repeat: str = "") -> Path:
    """Write a report: numbers, pictures, settings, versions, and how to do it again, in one HTML file.

    The file needs no other file, no network and no script. It names files without their folders, and no machine.

    Args:
        x: A `taut.Run`; or a result, as of `taut.design` or `taut.doctor`: anything with a `content()`.
        path: Where to, ending in .html, in a folder that exists. What is there stays until the new file is whole.
        title: A title, instead of the usual one.
        repeat: How to do it again; a run of a scenario knows its command.

    Raises:
        UsageError: Nothing that can be reported; a run without two ticks.
        FileError: Another suffix, no such folder, a disk that is full.

    Example:
        >>> import taut, tempfile
        >>> d = taut.error_dynamics(M=0.5, b=0.1, kd=2.0, zeta=1.0)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = report(d, f"{folder}/gains.html", title="Critical damping")
        ...     "<h1>Critical damping</h1>" in file.read_text(encoding="utf-8")
        True
    """
    target = checked_target("report", path, (".html", ".htm"))
    if not isinstance(x, (Run, Result)):
        got = x.__name__ if isinstance(x, type) else type(x).__name__
        raise UsageError(f"a report is of a taut.Run or of a result, which has content(); got {got}", name="x")
    content = x.content()
    content = dataclasses.replace(content, title=title or content.title, repeat=repeat or content.repeat)
    with written_aside("report", target) as aside:
        aside.write_text(html_of(content), encoding="utf-8", errors="replace")
    return target


def content_of_run(run: Run) -> Content:
    """The content of the report of a run; UsageError if it has no two ticks."""
    if len(run) < MIN_TICKS_OF_REPORT:
        raise UsageError(
            f"a report needs a run of {MIN_TICKS_OF_REPORT} ticks at least; got {len(run)}: {run.outcome}", name="run"
        )
    info, scenario = run.info, run.info.scenario
    title = f"{short(info.law or 'a law', 100)} on {info.plant or 'a plant'}"
    if scenario is not None:
        title = f"{scenario.name}: {scenario.law}{f', case {scenario.case!r}' if scenario.case else ''}"
    span = float(run.t[-1] - run.t[0])
    return Content(
        title=title,
        summary=(
            f"{len(run)} ticks at {run.rate:g} Hz, {span:g} s, {count_of(run.n, 'joint')}. "
            f"{str(run.outcome)[:1].upper()}{str(run.outcome)[1:]}.",
        ),
        faults=faults_of(run),
        tables=tuple(_tables(run)),
        figures={"The run over time": run.plot},
        settings=_settings(run),
        texts={"Scenario": scenario.text} if scenario is not None and scenario.text else {},
        repeat=_missing(run) if scenario is None else _command(scenario),
        versions=info.versions,
    )


def faults_of(run: Run) -> tuple[str, ...]:
    """Why a run is no whole one: a fault, gaps."""
    faults = [] if run.outcome.ok else [f"{run.outcome}. The numbers below are those of what came before."]
    gaps = np.flatnonzero(np.diff(run.t) > LATE / run.rate)
    if gaps.size:
        first = f"from t = {run.t[gaps[0]]:g} to {run.t[gaps[0] + 1]:g} s"
        count = "a gap," if gaps.size == 1 else f"{gaps.size} gaps, the first"
        faults.append(f"The run has {count} {first}; numbers that are sums or means leave them out.")
    return tuple(faults)


def _tables(run: Run) -> Iterator[Table]:
    yield from run.metrics.content().tables
    if run.info.phases:
        windows = [(w.name, w.start, w.end, w.ended) for w in run.phases]
        yield Table(title="Phases", columns=("phase", "start [s]", "end [s]", "what ended it"), rows=windows)


def _settings(run: Run) -> dict[str, str]:
    """What is known of a run, as text by name."""
    info = run.info
    said: dict[str, Any] = {
        "law": info.law,
        "arm of the controller": info.arm,
        "plant": info.plant,
        "limits of the controller": info.command_limits,
        "sensing": info.sensing,
        "reference": f"{type(run.reference).described()}, tick by tick in the log",
        "start": f"q = {_value(run.q[0])}, v = {_value(run.v[0])}",
        "command": run.kind,
        "seed": info.seed,
        "events": "; ".join(f"at {event.t:g} s: {_value(event.set)}" for event in info.events) or "none",
    }
    said = {name: value for name, value in said.items() if value not in (None, "")}
    said |= {f"{name} limits of the arm": values for name, values in info.limits.items() if values}
    return {name: _value(value) for name, value in (said | dict(info.parameters)).items()}


def _missing(run: Run) -> str:
    """What a run that was made in Python does not record and a repeat needs, a line each."""
    info = run.info
    arm, other = info.controller_arm, info.plant_arm
    own = () if other is None else tuple(field.name for field in dataclasses.fields(other))
    differs = [name for name in own if plain(getattr(arm, name, None)) != plain(getattr(other, name))]
    lines = [
        "The report alone does not repeat this run. Make again:",
        f"the law{f' {info.law}' if info.law else ''}, with its gains, sensing and limits: see the settings",
        f"the plant{f' {info.plant}' if info.plant else ''}, with its friction, drives, sensors, contacts and scene",
        "the reference, whose samples are in the log",
        f"the arm of the controller{', which is in the log' if arm else ''}",
        f"the arm of the plant{', which is in the log' if other else ''}",
        "your own functions and events",
    ]
    if differs and arm is not None:
        lines[-2] += f" and differs in {', '.join(differs)}"
    return "\n  ".join([*lines, *(["the seed"] if info.seed is None else [])])


def _command(scenario: ScenarioInfo) -> str:
    """The command that repeats a run of a scenario."""
    if ".py:" in scenario.law:
        return f"taut run {scenario.name} --law {scenario.law} --gain NAME=VALUE   # the gains of the law above"
    return (
        f"taut run {scenario.name}" if scenario.built_in else f"taut run {scenario.name}.toml   # with the text above"
    )


def _value(value: Any) -> str:
    """A value in one line, with six digits."""
    rounded = json.loads(json.dumps(plain(value)), parse_float=lambda digits: float(f"{float(digits):.6g}"))
    return short(value if isinstance(value, str) else json.dumps(rounded, ensure_ascii=False), MAX_VALUE_LETTERS)


def html_of(content: Content) -> str:
    """The whole file."""
    return "\n".join(_lines(content))


def _text(text: str) -> str:
    """A text as HTML, its files without folders; what no page can hold is shown as a question mark."""
    kept = "".join(
        letter if letter.isprintable() or letter in "\n\t" else "\N{REPLACEMENT CHARACTER}" for letter in text
    )
    return escape(without_folders(kept))


def _lines(content: Content) -> Iterator[str]:
    yield "<!DOCTYPE html>"
    yield '<html lang="en">'
    yield '<head><meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f'<meta http-equiv="Content-Security-Policy" content="{escape(POLICY)}">'
    yield '<meta name="generator" content="taut">'
    yield f"<title>{_text(content.title)}</title>"
    yield f"<style>{STYLE}</style></head>"
    yield "<body><main>"
    yield f"<h1>{_text(content.title)}</h1>"
    for fault in content.faults:
        yield f'<p class="fault"><b>Fault:</b> {_text(fault)}</p>'
    for sentence in content.summary:
        yield f"<p>{_text(sentence)}</p>"
    if content.tables:
        yield "<h2>Numbers</h2>"
    for table in content.tables:
        yield from _table(table)
    for note in content.notes:
        yield f"<p>{_text(note)}</p>"
    if content.figures:
        yield "<h2>Pictures</h2>"
    for title, draw in content.figures.items():
        yield _picture(title, draw())
    if content.settings:
        yield "<h2>Settings</h2>"
        yield from _pairs("setting", "value", content.settings)
    for title, text in content.texts.items():
        yield f"<h2>{_text(title)}</h2>"
        yield f'<pre tabindex="0">{_text(text)}</pre>'
    if content.repeat:
        yield "<h2>How to repeat it</h2>"
        yield f'<pre class="again">{_text(content.repeat)}</pre>'
    yield "<h2>Versions</h2>"
    yield from _pairs("program", "version", content.versions or versions())
    yield "</main></body>"
    yield "</html>\n"


def _pairs(name: str, value: str, pairs: Mapping[str, str]) -> Iterator[str]:
    yield from _table(Table(columns=(name, value), rows=list(pairs.items())))


def _table(table: Table) -> Iterator[str]:
    """A table that scrolls by itself where the page is narrow."""
    label = f' role="region" aria-label="{_text(table.title)}"' if table.title else ""
    yield f'<div class="wide" tabindex="0"{label}><table>'
    if table.title:
        yield f"<caption>{_text(table.title)}</caption>"
    classes = ["w" if words else "n" for words in table.text_columns]
    heads = [_text(head).replace("_", "_<wbr>") for head in table.columns]  # names of joints are long
    pairs = zip(classes, heads, strict=True)
    yield "<thead><tr>" + "".join(f'<th class="{kind}" scope="col">{head}</th>' for kind, head in pairs)
    yield "</tr></thead><tbody>"
    for row in table.rows:
        cells = zip(classes, map(cell_text, row), strict=True)
        yield "<tr>" + "".join(f'<td class="{kind}">{_text(text)}</td>' for kind, text in cells) + "</tr>"
    yield "</tbody></table></div>"
    if table.note:
        yield f'<p class="note">{_text(table.note)}</p>'


def _picture(title: str, figure: Figure) -> str:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=RESOLUTION, facecolor="white", metadata={"Software": None})
    encoded = base64.b64encode(data.getvalue()).decode()
    title = _text(title)
    return (
        f'<figure><div class="wide" tabindex="0"><img alt="{title}" src="data:image/png;base64,{encoded}"></div>'
        f"<figcaption>{title}</figcaption></figure>"
    )


def without_folders(text: str) -> str:
    """A text whose files have their names alone: their folders are private.

    Example:
        >>> without_folders("stopped at /home/anna/laws/mine.py:12 after 3 m/s, 1/2 of ~/work/a.toml")
        'stopped at mine.py:12 after 3 m/s, 1/2 of a.toml'
    """
    return FOLDERS.sub("", text)
