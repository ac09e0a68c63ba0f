"""Comparison of laws on one experiment: figures of each, with noise and with true arms that differ from the model."""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import TautError, UsageError, count_of, unknown_name
from taut.base.fields import Declared, Field, Whole
from taut.base.result import Cell, Content, Result, Table, plain
from taut.base.types import ArrayLike
from taut.codegen.engine import EngineChoice
from taut.control.law import Law
from taut.control.limits import Limits
from taut.control.sensing import Sensing
from taut.control.tasks.task import Task
from taut.control.trajectories.reference import Reference
from taut.controller import Controller, compile
from taut.loop import Loop
from taut.plant.rigid import RigidPlant
from taut.plant.sensors import Sensors
from taut.record.comparison_plot import compare as compare_runs
from taut.record.metrics import METRICS
from taut.record.run import Run
from taut.runtime.events import Event
from taut.runtime.host import PlantBase
from taut.runtime.simulate import Plant, run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Numbers: TypeAlias = dict[str, dict[str, float]]
"""Figures by name and unit: {"rms_error": {"rad": 0.1}}."""

MAX_LAWS: Final = 8  # in one table
LAST_FRACTION: Final = 0.2  # last fraction of a run, whose RMS error is the steady error
NOISE: Final[Mapping[str, float]] = {"position": 1e-5, "velocity": 1e-3}
"""Standard deviations [rad | m], [rad/s | m/s] for a plant without noise, where none is given."""

ERRORS: Final = {
    "rms_error": "peak_error",
    "task_rms": "task_peak",
    "task_rms_rotation": "task_peak_rotation",
    "normal_force_error_rms": "normal_force_error_peak",
    "force_error_rms": "force_error_peak",
    "moment_error_rms": "moment_error_peak",
}
"""RMS and peak of each error that a run may have; the first that it has is its main error."""
SPENT: Final = ("effort", "peak_torque", "saturation_time", "chatter")
DERIVED: Final = {
    "steady_error": "RMS of the main error (of joints, else of the tool, else of its force) over the last fifth",
    "noise_error": "increase of the RMS of the main error by the noise of the sensors",
    "noise_chatter": "increase of the chatter by the noise of the sensors",
    "model_median": "RMS of the main error with true arms that differ from the model: the median",
    "model_worst": "RMS of the main error with true arms that differ from the model: the largest; infinite where a "
    "run with one of them failed",
}
FIGURES: Final = (*(name for pair in ERRORS.items() for name in pair), *SPENT, *DERIVED)


class WrongModel(Declared):
    """Spread of the true arm about the model that the controllers have.

    The arm of trial k, from 0 on, is `arm.perturbed(seed=seed + k, mass=mass, ...)` with up to `payload` kg more.

    Example:
        >>> WrongModel(mass=0.1)
        WrongModel(mass=0.1)
    """

    mass: Field = Field(0.0, minimum=0.0, maximum=1.0)  # relative spread of each mass (log-normal)
    com: Field = Field(0.0, unit="m", minimum=0.0, maximum=1.0)  # spread of each centre of mass
    inertia: Field = Field(0.0, minimum=0.0, maximum=1.0)  # relative spread of the sizes of the bodies
    friction: Field = Field(0.0, minimum=0.0, maximum=1.0)  # relative spread of viscous and dry friction
    payload: Field = Field(0.0, unit="kg", minimum=0.0)  # largest additional payload
    trials: Whole = Whole(5, minimum=1, maximum=1000)  # number of arms that are drawn
    seed: Whole = Whole(0)  # of the first arm

    def check(self) -> None:
        """At least one spread is above zero."""
        if not any((self.mass, self.com, self.inertia, self.friction, self.payload)):
            self.refuse("", "needs one of mass, com, inertia, friction and payload above zero")

    def described(self) -> str:
        """The spreads in words."""
        spreads = {name: float(getattr(self, name)) for name in self.declared if name not in ("trials", "seed")}
        units = {"com": "m", "payload": "kg"}
        sizes = (f"{x:g} {units[name]}" if name in units else f"{100.0 * x:g} %" for name, x in spreads.items() if x)
        names = (name for name, x in spreads.items() if x)
        words = ", ".join(f"{name} {size}" for name, size in zip(names, sizes, strict=True))
        return f"{count_of(self.trials, 'true arm')}, spread {words}, seed {self.seed}"

    def arms(self, arm: Arm) -> Iterator[Arm]:
        """The true arm of each trial."""
        spreads = {name: float(getattr(self, name)) for name in ("mass", "com", "inertia", "friction")}
        for seed in range(self.seed, self.seed + self.trials):
            more = float(self.payload * np.random.default_rng([seed, 1]).random())
            load, true = arm.payload, arm.perturbed(seed=seed, **spreads)
            yield true.with_payload(load.mass + more, load.com, load.inertia) if self.payload else true


@dataclass(frozen=True, kw_only=True, eq=False)
class Experiment:
    """Everything in a closed loop except its law."""

    name: str  # for messages
    arm: Arm  # as the controllers know it
    rate: float  # [Hz]
    sensing: Sensing  # of the controllers
    limits: Limits | None  # of the controllers; None for none
    plant: Plant  # the true one
    reference: Reference
    duration: float  # [s]
    q0: ArrayLike | None = None  # (n,) [rad | m]; home if left out
    v0: ArrayLike | None = None  # (n,) [rad/s | m/s]
    seed: int = 0  # of all noise
    events: tuple[Event, ...] = ()  # changes of parameters
    parameters: Mapping[str, ArrayLike] = field(default_factory=dict)  # by path, from the start
    texts: Mapping[str, str] = field(default_factory=dict)  # longer texts by title
    preparation: Callable[[Experiment, Law | Task, EngineChoice], Experiment] | None = (
        None  # before the runs of a law
    )

    @classmethod
    def of(cls, loop: Loop) -> Experiment:
        """The experiment of a loop, with its changed parameters except those of its law."""
        side, plant = loop.side, loop.plant
        before = {**side.parameters, **plant.parameters}
        changed = {
            path: value
            for path, value in loop.parameters.items()
            if not path.startswith("law.") and not np.array_equal(value, before[path])
        }
        return cls(
            name="the loop",
            arm=side.arm,
            rate=side.rate,
            sensing=side.sensing,
            limits=side.limits,
            plant=plant,
            reference=loop.ref,
            duration=loop.duration,
            parameters=changed,
        )

    @property
    def sensors(self) -> Sensors:
        """The plant's sensors; ideal ones of a plant that does not declare any."""
        sensors = getattr(self.plant, "sensors", None)
        return sensors if isinstance(sensors, Sensors) else Sensors()

    def prepared(self, law: Law | Task, engine: EngineChoice = "auto") -> Experiment:
        """The experiment of a law after its preparation: a learned or inverted reference, an identified arm."""
        return self if self.preparation is None else self.preparation(self, law, engine)

    def controller(self, law: Law | Task, engine: EngineChoice = "auto") -> Controller:
        """The law, compiled for this experiment."""
        return compile(
            law,
            self.arm,
            rate=self.rate,
            sensing=self.sensing,
            limits=self.limits,
            adds=self.plant.adds,
            engine=engine,
        )

    def run(self, ctrl: Controller, plant: Plant | None = None, log: Path | None = None) -> Run:
        """A run of a controller, against another plant if one is given."""
        start = (Event(t=0.0, set=self.parameters),) if self.parameters else ()
        return run(
            ctrl,
            plant or self.plant,
            None if ctrl.side.task is not None else self.reference,
            duration=self.duration,
            q0=self.q0,
            v0=self.v0,
            seed=self.seed,
            events=(*start, *self.events),
            log=log,
        )

    @property
    def settings(self) -> dict[str, str]:
        """The settings as text by name."""
        return {
            "arm of the controllers": self.arm.name,
            "plant": self.plant.name,
            "rate": f"{self.rate:g} Hz",
            "duration": f"{self.duration:g} s",
            "reference": type(self.reference).__name__,
            **({} if self.preparation is None else {"preparation": str(self.preparation)}),
            "limits": "none" if self.limits is None else str(self.limits),
            "sensing": str(self.sensing),
            "noise of": ", ".join(_noisy(self.sensors)) or "no sensor",
            "seed": str(self.seed),
            "events": "; ".join(f"at {event.t:g} s {dict(event.set)}" for event in self.events) or "none",
            **{path: str(np.asarray(value).tolist()) for path, value in self.parameters.items()},
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Entry:
    """One law of a comparison, or one recorded run, with its figures by name and unit."""

    name: str
    law: str  # with its gains, as text
    run: Run
    numbers: Numbers

    def number(self, figure: str) -> float:
        """A figure to rank by: the largest over its units; infinite of a run that failed or has none."""
        return max(self.numbers.get(figure, {}).values(), default=math.inf)


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison(Result):
    """Laws on one experiment: print it for the table, `plot()` it, hand it to `taut.report`.

    Args:
        title: What they were compared on.
        entries: The laws by name, in their ranking if there is one.
        by: The figures that they are ranked by, the first one first; the next decides between equals.
        notes: What the figures of noise and model rely on.
        settings: Of the experiment, as text by name.
        texts: Longer texts by title, such as that of a scenario.
    """

    title: str
    entries: Mapping[str, Entry]
    by: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    settings: Mapping[str, str]
    texts: Mapping[str, str]

    @property
    def runs(self) -> dict[str, Run]:
        """The run of each law, by its name."""
        return {name: entry.run for name, entry in self.entries.items()}

    @property
    def ranking(self) -> tuple[str, ...]:
        """Names, the best first; none where no figure was given to rank by."""
        return tuple(self.entries) if self.by else ()

    @property
    def ok(self) -> bool:
        """Whether every law's run went to its end."""
        return all(run.outcome.ok for run in self.runs.values())

    def content(self) -> Content:
        """A row for each figure and unit, a column for each law."""
        entries = self.entries.values()
        shown = [name for name in dict.fromkeys((*FIGURES, *self.by)) if self._units(name)]
        rows: list[Sequence[Cell]] = [
            (title_of(name), unit, *(entry.numbers.get(name, {}).get(unit, math.nan) for entry in entries))
            for name in shown
            for unit in self._units(name)
        ]
        ranked = f"ranked by {', then '.join(map(title_of, self.by))}: {', '.join(self.ranking)}"
        return Content(
            title=f"Comparison on {self.title}",
            faults=[f"{name}: {run.outcome}" for name, run in self.runs.items() if not run.outcome.ok],
            summary=[ranked] if self.by else [],
            tables=[Table(title="figures", columns=("figure", "unit", *self.entries), rows=rows)],
            notes=self.notes,
            figures={"Errors, torques and figures of each law": self._draw}
            if any(map(len, self.runs.values()))
            else {},
            settings={**{f"law '{entry.name}'": entry.law for entry in entries}, **self.settings},
            texts={
                "What the figures are": "\n".join(
                    f"{title_of(name)}: {DERIVED[name] if name in DERIVED else METRICS[name].meaning(2)}"
                    for name in shown
                ),
                **self.texts,
            },
        )

    def json(self) -> dict[str, Any]:
        """The result as plain data, with the figures by law, name and unit."""
        numbers = {
            law: {name: {unit: plain(value) for unit, value in each.items()} for name, each in entry.numbers.items()}
            for law, entry in self.entries.items()
        }
        return {**super().json(), "numbers": numbers}

    def _draw(self) -> Figure:
        """Errors and torques over time, and the figures as bars."""
        entries = {name: entry for name, entry in self.entries.items() if len(entry.run)}
        first = dict.fromkeys(filter(None, (main_error(entry.numbers) for entry in entries.values())))
        bars = {}
        for name in (*first, "effort", "chatter", "noise_chatter", "model_worst"):
            for unit in self._units(name):
                bars[f"{title_of(name)} [{unit}]"] = [
                    entry.numbers.get(name, {}).get(unit, math.nan) for entry in entries.values()
                ]
        return compare_runs(
            {name: entry.run for name, entry in entries.items()}, title=self.title, bars=bars, torques=True
        )

    def _units(self, figure: str) -> list[str]:
        """The units that a figure has for any law."""
        return [*dict.fromkeys(unit for entry in self.entries.values() for unit in entry.numbers.get(figure, {}))]


def title_of(figure: str) -> str:
    """What a figure is called in tables and plots."""
    return METRICS[figure].title if figure in METRICS else figure.replace("_", " ")


def compare_laws(
    laws: Mapping[str, Law],  # by name
    experiment: Experiment | None,  # of the laws; None for recorded runs alone
    *,
    runs: Mapping[str, Run],
    by: Sequence[str] = (),  # figures to rank by
    noise: bool = True,  # also with the noise of the sensors: the plant's own, or NOISE
    model: WrongModel | None = None,  # None to skip
) -> Comparison:
    """Run laws on an experiment, and measure them; all are compiled before the first one runs."""
    if not 0 < len(laws) + len(runs) <= MAX_LAWS:
        raise UsageError(f"a comparison has 1 to {MAX_LAWS} laws and runs; got {len(laws) + len(runs)}", name="laws")
    for figure in by:
        if figure not in FIGURES and figure not in METRICS:
            known = dict.fromkeys([*FIGURES, *METRICS])
            raise unknown_name("a comparison", "figure", figure, known, hint="taut.analysis.METRICS has all metrics")
    for name, recorded in runs.items():
        _check_recorded(name, recorded)
    entries: list[Entry] = []
    notes: tuple[str, ...] = ()
    if experiment is not None:
        ready = {}
        for name, law in laws.items():
            with blamed(name):
                one = experiment.prepared(law)
                ready[name] = one, one.controller(law)
        variants = _Variants.of(experiment, noise, model)
        notes = variants.notes
        for name, law in laws.items():
            with blamed(name):
                done, numbers = variants.figures(*ready[name], by)
            entries.append(Entry(name=name, law=repr(law), run=done, numbers=numbers))
    entries += [
        Entry(name=name, law=one.info.law, run=one, numbers=figures_of(one, by)) for name, one in runs.items()
    ]
    if by:
        entries.sort(key=lambda entry: (not entry.run.outcome.ok, [entry.number(figure) for figure in by]))
    return Comparison(
        title=experiment.name if experiment else count_of(len(runs), "recorded run"),
        entries={entry.name: entry for entry in entries},
        by=tuple(by),
        notes=notes,
        settings=experiment.settings if experiment else {},
        texts=experiment.texts if experiment else {},
    )


@dataclass(frozen=True, kw_only=True)
class _Variants:
    """The plants that every law of a comparison also runs against: one with other noise, some with another arm."""

    quiet: Plant | None = None  # in place of the experiment's own plant, for the figures of noise
    noisy: Plant | None = None
    trials: tuple[Plant, ...] = ()
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, experiment: Experiment, noise: bool, model: WrongModel | None) -> _Variants:
        plant, sensors, notes = experiment.plant, experiment.sensors, []
        if not isinstance(plant, (RigidPlant, PlantBase)) or plant.like() is None:  # one of the user's own
            return cls(notes=(f"no figures of noise and of a wrong model: {plant.name} cannot be made anew",))
        quiet: Plant | None = None
        noisy: Plant | None = None
        if noise and _noisy(sensors):
            quiet = plant.like(sensors=with_noise(sensors, dict.fromkeys(_noisy(sensors), 0.0)))
            notes.append("noise: the sensors as they are, against the same without noise")
        elif noise:
            deviations = {name: value for name, value in NOISE.items() if getattr(sensors, name) is not None}
            noisy = plant.like(sensors=with_noise(sensors, deviations))
            units = {"position": "rad | m", "velocity": "rad/s | m/s"}
            words = ", ".join(f"{value:g} {units[name]} of {name}" for name, value in deviations.items())
            notes.append(f"noise: sensors with standard deviations of {words}, against those of the plant")
        trials: tuple[Plant, ...] = ()
        if model is not None:
            trials = tuple(plant.like(arm=arm) for arm in model.arms(plant.arm))
            notes.append(f"wrong model: {model.described()}; the controller's model stays as it is")
        return cls(quiet=quiet, noisy=noisy, trials=trials, notes=tuple(notes))

    def figures(self, experiment: Experiment, ctrl: Controller, by: Sequence[str]) -> tuple[Run, Numbers]:
        """The run of a controller, and its figures, those with the other plants included."""
        done = experiment.run(ctrl)
        numbers = figures_of(done, by)
        error = main_error(numbers)
        if not done.outcome.ok:
            return done, numbers
        if self.noisy is not None or self.quiet is not None:
            quiet, noisy = (
                numbers if plant is None else figures_of(experiment.run(ctrl, plant))
                for plant in (self.quiet, self.noisy)
            )
            for name, of in {"noise_error": error, "noise_chatter": "chatter"}.items():
                if of in noisy and of in quiet:
                    numbers[name] = {unit: value - quiet[of][unit] for unit, value in noisy[of].items()}
        if self.trials and error is not None:
            found = [figures_of(experiment.run(ctrl, plant)).get(error, {}) for plant in self.trials]
            spread = {unit: [each.get(unit, math.inf) for each in found] for unit in numbers[error]}
            numbers["model_median"] = {unit: statistics.median(values) for unit, values in spread.items()}
            numbers["model_worst"] = {unit: max(values) for unit, values in spread.items()}
        return done, numbers


def figures_of(run: Run, more: Sequence[str] = ()) -> Numbers:
    """The figures that a run alone has, and more of its metrics; none of a run that failed.

    Of laws side by side, which have their own references, an error is the largest of theirs.
    """
    if not run.outcome.ok or len(run) < 2:
        return {}
    errors = [name for pair in ERRORS.items() for name in pair]
    names = dict.fromkeys([*errors, *SPENT, *(name for name in more if name in METRICS)])
    numbers = {name: _by_unit(run, name, parts=name in errors) for name in names}
    error = main_error(numbers)
    if error is not None:
        last = run.between(run.t[-1] - LAST_FRACTION * (run.t[-1] - run.t[0]), run.t[-1])
        numbers["steady_error"] = _by_unit(last, error, parts=True)
    return {name: found for name, found in numbers.items() if found}


def _by_unit(run: Run, name: str, *, parts: bool) -> dict[str, float]:
    """A metric by unit, where it has a meaning; the largest of the parts of a run of laws side by side."""
    found: dict[str, float] = {}
    for part in ([run.part(part) for part in run.info.parts] if parts else []) or [run]:
        for unit, value in part.metrics.by_unit(name).items():
            if not math.isnan(value):
                found[unit] = max(found.get(unit, value), value)
    return found


def main_error(numbers: Mapping[str, Mapping[str, float]]) -> str | None:
    """The first RMS error that there is: of joints, of the tool, of its force."""
    return next((name for name in ERRORS if numbers.get(name)), None)


def with_noise(sensors: Sensors, noise: Mapping[str, float]) -> Sensors:
    """Sensors with another standard deviation of their noise, by the sensor's name; zero for none."""
    changed = {
        name: dataclasses.replace(getattr(sensors, name), noise=value if value or name != "wrench" else None)
        for name, value in noise.items()
    }
    return dataclasses.replace(sensors, **changed)


def _noisy(sensors: Sensors) -> list[str]:
    """Names of the sensors that have noise."""
    there = ((name, getattr(sensors, name)) for name in Sensors.declared)
    return [name for name, sensor in there if sensor is not None and "noise" in sensor.parameters()]


def _check_recorded(name: str, run: object) -> None:
    if not isinstance(run, Run):
        raise UsageError(f"'{name}' must be a law or a taut.Run; got {type(run).__name__}", name=name)
    if run.info.phases:
        raise UsageError(
            f"run '{name}' is one of a task, whose phases have their own references; compare one of them, "
            f"run.phase('{run.phases[0].name}')",
            name=name,
        )


@contextmanager
def blamed(name: str) -> Iterator[None]:
    """Errors about a law name it, as UsageError."""
    try:
        yield
    except TautError as cause:
        raise UsageError(f"law '{name}': {cause}", name=name) from cause
