"""Comparison: laws on one experiment, side by side, in the figures of figure 10.12."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.analysis.compare.numbers import FIGURES, Numbers, main_error, of_model, of_noise, of_run
from taut.analysis.compare.setting import Plant, Setting, blamed
from taut.analysis.compare.truth import PlantChange, WrongModel, is_noisy
from taut.analysis.compare.words import comparison_text
from taut.base.errors import RangeError, UsageError, count_of, unknown_name
from taut.base.types import ArrayLike
from taut.control.law import Law
from taut.controller import Controller
from taut.plant.sensors.sensors import Sensors
from taut.record.info import PHASES, stated
from taut.record.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.record.report.page import Page

__all__ = ["Comparison", "Entry", "compare_laws", "require_runs", "settings_of"]

MOST: Final = 8  # laws in one table
FEWEST_TICKS: Final = 10  # of a run whose last fifth is to say anything
LATE: Final = 1.5  # periods between two ticks that follow each other
NOISE: Final[Mapping[str, float]] = {"position": 1e-5, "velocity": 1e-3}
"""Standard deviations [rad | m], [rad/s | m/s] where a plant has no noise and none is stated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Entry:
    """One law of a comparison, or one recorded run."""

    name: str
    law: str  # with its gains, as text
    run: Run
    numbers: Numbers  # figure -> unit -> number
    trials: tuple[Run, ...] = ()  # with true arms that differ

    @property
    def failed(self) -> bool:
        """Whether the run did not go to its end."""
        return not self.run.outcome.ok

    def number(self, figure: str) -> float:
        """A figure to rank by: the largest over its units; infinite of a run that failed or has none."""
        values = self.numbers.get(figure, {}).values()
        return max(values, default=math.inf)

    def json(self) -> dict[str, Any]:
        """As plain values; None where a run with another arm failed."""
        return {
            "law": self.law,
            "outcome": self.run.outcome.json(),
            "metrics": {
                name: {unit: value if math.isfinite(value) else None for unit, value in values.items()}
                for name, values in self.numbers.items()
            },
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Laws on one experiment: print it for the table, `plot()` it, hand it to `taut.report`.

    Args:
        title: What was compared on.
        entries: The laws, in their ranking if there is one, by name.
        by: The figures that they are ranked by, the first one first; the next decides between equals.
        notes: What the table says of noise and model.
        repeat: How to make it again.
        settings: What is known of the experiment, as text by name.
        texts: Longer texts by their title, such as the scenario's.
    """

    title: str
    entries: Mapping[str, Entry]
    by: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    repeat: str = ""
    settings: Mapping[str, str]
    texts: Mapping[str, str]

    @property
    def runs(self) -> dict[str, Run]:
        """The run of each law, by its name."""
        return {name: entry.run for name, entry in self.entries.items()}

    @property
    def ranking(self) -> tuple[str, ...]:
        """Names, the best first; none where nothing was asked to rank by."""
        return tuple(self.entries) if self.by else ()

    @property
    def ok(self) -> bool:
        """Whether every law's run went to its end."""
        return not any(entry.failed for entry in self.entries.values())

    def plot(self) -> Figure:
        """Errors and torques side by side over time, and the figures as bars, as a matplotlib Figure.

        Raises:
            UsageError: No run has anything to draw.
        """
        from taut.analysis.compare.plot import plot

        return plot(self)

    def report(self) -> str:
        """The table as text, with what it says of noise, model and ranking below."""
        return comparison_text(self)

    def report_page(self) -> Page:
        """What `taut.report` makes of it."""
        from taut.analysis.compare.report import page_of_comparison

        return page_of_comparison(self)

    def json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "comparison": self.title,
            "laws": {name: entry.json() for name, entry in self.entries.items()},
            "ranking": list(self.ranking),
            "by": list(self.by),
            "notes": list(self.notes),
            "ok": self.ok,
        }

    def __str__(self) -> str:
        return self.report()


def compare_laws(
    laws: Mapping[str, Law],
    settings: Setting | Mapping[str, Setting] | None,
    *,
    runs: Mapping[str, Run],
    by: Sequence[str] = (),
    noise: Mapping[str, ArrayLike] | None = None,
    model: WrongModel | None = None,
    say: Callable[[str], None] | None = None,
    repeat: str = "",
    title: str = "",
) -> Comparison:
    """Run laws on an experiment, and measure them.

    Every law is compiled and checked before the first one runs.

    Args:
        laws: By name.
        settings: The experiment; or one for each law, which differ in their references. None for runs alone.
        runs: Recorded runs by name, which stand beside the laws with the figures that a run alone has.
        by: Figures to rank by.
        noise: Standard deviation by sensor to compare with; where it is left out that of the plant, and where that
            has none, 1e-5 rad of positions and 1e-3 rad/s of velocities. An empty one leaves these rows out.
        model: By how much the true arm may differ; None leaves these rows out.
        say: Takes a line of progress.
        repeat: How to make it again.
        title: A title; the name of the experiment if left out.

    Raises:
        UsageError: Nothing to compare, more than eight, a run that cannot be compared.
        UnknownNameError: No such figure, no such sensor.
        TautError: A law that cannot be compiled or does not fit.
    """
    say = say or _quiet
    names = [*laws, *runs]
    if not 0 < len(names) <= MOST:
        raise UsageError(f"a comparison has 1 to {MOST} laws and runs; got {len(names)}", name="laws")
    for figure in by:
        if figure not in FIGURES:
            raise unknown_name("a comparison", "figure", figure, FIGURES)
    for name, one in runs.items():
        require_runs(name, one)
    of_law = dict.fromkeys(laws, settings) if settings is None or isinstance(settings, Setting) else dict(settings)
    ready = {name: _Ready(name, law, _given(of_law[name]), noise, model) for name, law in laws.items()}
    entries = [one.entry(say) for one in ready.values()]
    entries += [
        Entry(name=name, law=str(one.info.get("law", "")), run=one, numbers=of_run(one)) for name, one in runs.items()
    ]
    if by:
        entries.sort(key=lambda entry: (entry.failed, [entry.number(figure) for figure in by]))
    first = next(iter(ready.values()), None)
    return Comparison(
        title=title or (first.setting.name if first else count_of(len(runs), "recorded run")),
        entries={entry.name: entry for entry in entries},
        by=tuple(by),
        notes=() if first is None else first.notes,
        repeat=repeat,
        settings={} if first is None else settings_of(first.setting),
        texts={} if first is None else first.setting.texts,
    )


def _quiet(_: str) -> None:
    return None


def _given(setting: Setting | None) -> Setting:
    if setting is None:
        raise UsageError("laws are compared on a scenario or a taut.Loop; got none", name="on")
    return setting


class _Ready:
    """A law with all that it will run against, compiled and checked."""

    def __init__(
        self,
        name: str,
        law: Law,
        setting: Setting,
        noise: Mapping[str, ArrayLike] | None,
        model: WrongModel | None,
    ) -> None:
        self.name, self.law, self.setting = name, law, setting
        self._ctrl: Controller = setting.controller(name, law)
        self._model = model
        self._quiet, self._stated = setting.noisy and noise is None, noise
        self._default = noise is None
        if noise is None and not setting.noisy:
            self._stated = {sensor: value for sensor, value in NOISE.items() if _has(setting, sensor)}
        self._other = None if noise == {} else self._plant(PlantChange(noise={} if self._quiet else self._stated))

    def _plant(self, change: PlantChange) -> Plant | None:
        """Another plant; None where there is no way to make one."""
        another = self.setting.another_plant
        if another is None and self._stated and not self._default:
            raise UsageError(
                f"noise cannot be given to {self.setting.plant.name}, which cannot be made anew; give it sensors "
                "with noise, or leave noise out",
                name="noise",
            )
        return None if another is None else another(change)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the rows of noise and model are about."""
        if self.setting.another_plant is None:
            return (f"no rows of noise and of a wrong model: {self.setting.plant.name} cannot be made anew",)
        said = []
        if self._other is not None and self._quiet:
            said.append("noise: the sensors as they are, against the same without noise")
        elif self._other is not None:
            words = ", ".join(f"{name} {np.max(np.asarray(value)):g}" for name, value in (self._stated or {}).items())
            said.append(f"noise: sensors with a standard deviation of {words}, against those of the plant")
        if self._model is not None:
            said.append(f"wrong model: {self._model.text()}; the true arm differs, the controller's does not")
        return tuple(said)

    def entry(self, say: Callable[[str], None]) -> Entry:
        """Run it, and everything that it is to be measured against."""
        say(f"running {self.name} ...")
        one = self._run()
        numbers: dict[str, Mapping[str, float]] = dict(of_run(one))
        trials: list[Run] = []
        if one.outcome.ok and self._other is not None:
            say(f"running {self.name} {'without' if self._quiet else 'with'} noise ...")
            other = self._run(self._other)
            numbers |= of_noise(one, other) if self._quiet else of_noise(other, one)
        if one.outcome.ok and self._model is not None and self.setting.another_plant is not None:
            for trial in range(self._model.trials):
                say(f"running {self.name} with another arm, {trial + 1} of {self._model.trials} ...")
                trials.append(self._run(self.setting.another_plant(PlantChange(error=self._model, trial=trial))))
            numbers |= of_model(trials, main_error(numbers))
        return Entry(name=self.name, law=repr(self.law), run=one, numbers=numbers, trials=tuple(trials))

    def _run(self, plant: Plant | None = None) -> Run:
        with blamed(self.name):
            return self.setting.run(self._ctrl, plant)


def _has(setting: Setting, sensor: str) -> bool:
    return getattr(setting.sensors, sensor) is not None


def settings_of(setting: Setting) -> dict[str, str]:
    """What is known of an experiment, as text by name."""
    noisy = [name for name in Sensors.declared if is_noisy(setting.sensors, name)]
    return {
        "arm of the controllers": setting.arm.name,
        "plant": setting.plant.name,
        "rate": f"{setting.rate:g} Hz",
        "duration": f"{setting.duration:g} s",
        "reference": type(setting.reference).__name__,
        "limits": "none" if setting.limits is None else stated(setting.limits),
        "sensing": stated(setting.sensing),
        "noise of": ", ".join(noisy) or "nothing",
        "seed": str(setting.seed),
        "events": "; ".join(f"at {event.t:g} s {dict(event.set)}" for event in setting.events) or "none",
        **{path: str(np.asarray(value).tolist()) for path, value in setting.parameters.items()},
    }


def require_runs(name: str, run: object) -> None:
    """A recorded run that can be compared: whole, long enough, without gaps.

    Raises:
        UsageError: It is not.
    """
    if not isinstance(run, Run):
        raise UsageError(f"'{name}' must be a law or a taut.Run; got {type(run).__name__}", name=name)
    if PHASES in run.info:
        phases = ", ".join(dict.fromkeys(window.name for window in run.phases))
        raise UsageError(
            f"run '{name}' is one of a task, whose phases ({phases}) follow each its own; compare one of them, "
            "run.phase(name)",
            name=name,
        )
    if not run.outcome.ok:
        raise UsageError(
            f"run '{name}' did not go to its end, so that its figures are not those of the others: {run.outcome}",
            name=name,
        )
    if len(run) < FEWEST_TICKS:
        raise UsageError(
            f"run '{name}' is too short to compare: {len(run)} ticks, of {FEWEST_TICKS} at least", name=name
        )
    gaps = np.flatnonzero(np.diff(run.t) > LATE / run.rate)
    if gaps.size:
        count = "a gap," if gaps.size == 1 else f"{gaps.size} gaps, the first"
        raise UsageError(
            f"run '{name}' has {count} from t = {run.t[gaps[0]]:g} to {run.t[gaps[0] + 1]:g} s; "
            "compare a stretch without one, run.between(start, end)",
            name=name,
        )
    if not all(np.isfinite(values).all() for values in (run.q, run.v, run.tau)):
        raise RangeError(f"run '{name}' has numbers that are not finite; it cannot be compared", name=name)
