"""The report of a run: its figures and what they mean, its pictures, what it was done with."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from taut.base.errors import UsageError, count_of
from taut.base.plot_style import short
from taut.base.result import Content, Table
from taut.record.info import ScenarioInfo
from taut.record.plain import plain
from taut.record.run import Run

__all__ = ["content_of_run", "faults_of"]

MIN_TICKS_OF_REPORT: Final = 2
LATE: Final = 1.5  # periods between two ticks that follow each other
MAX_VALUE_LETTERS: Final = 400  # of a value


def content_of_run(run: Run) -> Content:
    """What the report of a run holds.

    Args:
        run: The run.

    Raises:
        UsageError: It has no two ticks.
    """
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
        repeat="" if scenario is None else _command(scenario),
        versions=info.versions,
    )


def faults_of(run: Run) -> tuple[str, ...]:
    """Why a run is no whole one: a fault, gaps."""
    return tuple(_faults(run))


def _faults(run: Run) -> Iterator[str]:
    if not run.outcome.ok:
        yield f"{run.outcome}. The numbers below are those of what came before."
    gaps = np.flatnonzero(np.diff(run.t) > LATE / run.rate)
    if gaps.size:
        first = f"from t = {run.t[gaps[0]]:g} to {run.t[gaps[0] + 1]:g} s"
        count = "a gap," if gaps.size == 1 else f"{gaps.size} gaps, the first"
        yield f"The run has {count} {first}; numbers that are sums or means leave them out."


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
