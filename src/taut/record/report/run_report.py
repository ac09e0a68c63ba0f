"""The report of a run: its figures and what they mean, its pictures, what it was done with."""

from __future__ import annotations

import ast
import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from taut import laws
from taut.base.errors import TautError, UsageError, count_of
from taut.base.plot_style import short
from taut.base.result import Content, Table
from taut.control.law import Law
from taut.control.sensing.sensing import Sensing
from taut.record.info import LIMITS, OPTIONS, PHASES, SCENARIO, VERSIONS, stated
from taut.record.run import Run

__all__ = ["faults_of", "law_in_python", "law_of_text", "content_of_run"]

FEWEST_TICKS: Final = 2
PLANTS: Final = ("RigidPlant", "MujocoPlant")
LATE: Final = 1.5  # periods between two ticks that follow each other
LONGEST: Final = 400  # letters of a value


def content_of_run(run: Run, *, log: str = "run.mcap") -> Content:
    """What the report of a run holds.

    Args:
        run: The run.
        log: What its log is called, for the lines that repeat it.

    Raises:
        UsageError: It has no two ticks.
    """
    if len(run) < FEWEST_TICKS:
        raise UsageError(
            f"a report needs a run of {FEWEST_TICKS} ticks at least; got {len(run)}: {run.outcome}", name="run"
        )
    info = run.info
    scenario: Mapping[str, Any] = info.get(SCENARIO, {})
    law = short(str(info.get("law", "a law")), 100)
    title = f"{law} on {info.get('plant', 'a plant')}"
    if scenario:
        case = f", case '{scenario['case']}'" if scenario.get("case") else ""
        title = f"{scenario['name']}: {scenario['law']}{case}"
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
        texts={"Scenario": str(scenario["text"])} if scenario.get("text") else {},
        repeat=_repeat(run, scenario, log),
        versions=dict(info.get(VERSIONS, {})),
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
    if PHASES in run.info:
        windows = [(w.name, w.start, w.end, w.ended) for w in run.phases]
        yield Table(title="Phases", columns=("phase", "start [s]", "end [s]", "what ended it"), rows=windows)


def _settings(run: Run) -> dict[str, str]:
    """What is known of a run, as text by name."""
    info = run.info
    wanted = run.reference
    said: dict[str, Any] = {
        "law": info.get("law"),
        "arm of the controller": info.get("arm"),
        "plant": info.get("plant"),
        "limits of the controller": info.get("command_limits"),
        "sensing": info.get("sensing"),
        "reference": f"{type(wanted).described()}, tick by tick in the log",
        "start": f"q = {_value(run.q[0])}, v = {_value(run.v[0])}",
        "command": run.kind,
        "seed": info.get("seed"),
        "events": "; ".join(f"at {e['t']:g} s: {_value(e['set'])}" for e in info.get("events", [])) or "none",
    }
    for name, values in info.get(LIMITS, {}).items():
        if values:
            said[f"{name} limits of the arm"] = _value(values)
    said |= dict(info.get("parameters", {}))
    return {name: _value(value) for name, value in said.items() if value is not None}


def _value(value: Any) -> str:
    """A value in one line: three digits more than anybody reads, and no end of zeros."""
    plain = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
    text = plain if isinstance(plain, str) else json.dumps(_rounded(plain), ensure_ascii=False)
    return short(text, LONGEST)


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else str(value)
    if isinstance(value, (list, tuple)):
        return [_rounded(item) for item in value]
    return {key: _rounded(item) for key, item in value.items()} if isinstance(value, dict) else value


# -------------------------------------------------------------------- doing it again


def _repeat(run: Run, scenario: Mapping[str, Any], log: str) -> str:
    """A command, or lines of Python that read the log."""
    if scenario:
        own = f" --law {scenario['law']} --gain NAME=VALUE   # the gains of the law above"
        file = scenario["name"] if scenario.get("built_in") else f"{scenario['name']}.toml"
        words = "" if scenario.get("built_in") else "   # a file with the text above"
        return f"taut run {file}{own if '.py:' in str(scenario['law']) else words}"
    info = run.info
    missing = [f"# - {what}" for what in _missing(run)]
    if missing:
        return "\n".join(["# The log alone does not repeat this run. It does not hold:", *missing])
    parameters, options = info["parameters"], info[OPTIONS]["options"]
    kind = str(info["plant"]).partition("(")[0]
    limits = [path for path in parameters if path.startswith("limits.")]
    words = ", ".join(f'{path.partition(".")[2]}=known["{path}"]' for path in limits)
    given = f", limits=taut.Limits({words})" if limits else ""
    given += ", adds=plant.adds" if "adds" in options else ""
    start = f"q0=old.q[0], v0=old.v[0], seed={info.get('seed', 0)}"
    if info.get("events"):
        start += ', events=[taut.Event(**event) for event in old.info["events"]]'
    loop = "taut.Loop(ctrl, plant, Recorded(), duration=old.t[-1])"
    lines = [
        "import taut",
        "",
        f'old = taut.load_run("{log}")   # the log of this run, of run.save("{log}")',
        'known = old.info["parameters"]',
        "arm, true_arm = old.arms   # of the controller and of the plant",
        f"plant = taut.{kind}({', '.join(['true_arm', *(f'{name}={value!r}' for name, value in options.items())])})",
        f"law = {law_in_python(str(info['law']))}",
        f"ctrl = taut.compile(law, arm, rate={run.rate!r}{given})",
        "",
        "",
        "class Recorded:   # what the run followed, tick by tick",
        "    def at(self, t):",
        "        kind, k = type(old.reference), min(round(t * old.rate), len(old) - 1)",
        "        return kind.of({name: getattr(old.reference, name)[k] for name in kind.fields(old.n)})",
        "",
        "",
        *(
            [
                "plant.set_parameters({path: value for path, value in known.items() if path in plant.parameters})",
                "for path in set(known) & set(ctrl.parameters):",
                "    ctrl.parameters[path] = known[path]",
                f"run = taut.run(ctrl, plant, Recorded(), duration=old.t[-1], {start})",
            ]
            if kind == "MujocoPlant"
            else [
                f"loop = {loop}",
                "for path in set(known) & set(loop.parameters):",
                "    loop.parameters[path] = known[path]",
                f"run = taut.run(loop, {start})",
            ]
        ),
    ]
    return "\n".join(lines)


def _missing(run: Run) -> Iterator[str]:
    """What a run does not hold of itself, without which lines that read its log would make another one."""
    info = run.info
    try:
        _ = run.arms
    except UsageError:
        yield "the arms of controller and plant"
    text, made = str(info.get("law")), info.get(OPTIONS, {})
    if law_of_text(text) is None:
        yield f"the law beyond its text, {short(text, LONGEST)}"
    if str(info.get("sensing")) != stated(Sensing()):
        yield f"sensing= of taut.compile beyond its text, {info.get('sensing')}"
    if str(info.get("plant")).partition("(")[0] not in PLANTS or made.get("options") is None:
        yield f"the plant, {info.get('plant')}"
    elif made["others"]:
        yield f"what the plant was given as {', '.join(f'{name}=' for name in made['others'])}"
    if run.t[0] > 0.5 / run.rate:
        yield f"what came before t = {run.t[0]:g} s"


def law_of_text(text: str) -> Law | None:
    """The law that prints as this text, of those of taut.laws; None where it is more than its text says."""
    try:
        law = _built(ast.parse(text, mode="eval").body)
    except (TautError, SyntaxError, ValueError, TypeError, AttributeError, RecursionError, MemoryError):
        return None
    return law if isinstance(law, Law) and repr(law) == text else None


def _built(node: ast.expr) -> Any:
    """A law, a sum of laws, or plain values, and nothing else: the text of a log is not run."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _built(node.left) + _built(node.right)
    if not isinstance(node, ast.Call):
        return ast.literal_eval(node)
    if not isinstance(node.func, ast.Name) or node.func.id not in laws.__all__ or node.args:
        raise ValueError(ast.unparse(node))
    return getattr(laws, node.func.id)(**{str(word.arg): _built(word.value) for word in node.keywords})


def law_in_python(law: str) -> str:
    """The law's text with the package before the names that are ours; dots where the text does not make the law."""
    if law_of_text(law) is None:
        return f"...   # {short(' '.join(law.split()), LONGEST)}"
    return re.sub(r"\b([A-Z]\w*)(?=\()", lambda m: f"taut.laws.{m[1]}" if m[1] in laws.__all__ else m[1], law)
