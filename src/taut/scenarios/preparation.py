"""[preparation]: what changes an experiment before its runs: a reference learned or inverted, an arm identified."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

from taut.analysis import NormOptimal, PDLearning, excitation, identify, learn, stable_inversion
from taut.analysis.comparison import Experiment
from taut.analysis.learning import LearningLaw
from taut.base.errors import UsageError, quoted_list
from taut.base.fields import Declared, Field, Part, Whole
from taut.codegen.engine import EngineChoice
from taut.control.law import Law
from taut.control.lawside import LawSide
from taut.control.tasks.task import Task
from taut.control.trajectories.joint import Fourier
from taut.control.trajectories.reference import JointMotion
from taut.controller import Controller
from taut.scenarios.reading import Table, of_kind, read, reads

LEARNING_LAWS: Final[Mapping[str, type[LearningLaw]]] = {"norm-optimal": NormOptimal, "pd": PDLearning}
PREPARATIONS: Final = ("learning", "identification", "inversion")
MAX_PREPARED_TICKS: Final = 100_000  # of a motion, whose responses or regressors are kept: a gigabyte


@reads(LearningLaw)
def _learning_law(table: Table, key: str) -> LearningLaw:
    return of_kind(LEARNING_LAWS, table.table(key))  # type: ignore[no-any-return]


class Learning(Declared):
    """The reference that `taut.analysis.learn` learns in so many trials of the run, with other noise in each."""

    by: Part[LearningLaw] = Part(LearningLaw)
    trials: Whole = Whole(10, minimum=1, maximum=1000)

    def length(self, experiment: Experiment) -> float:
        return experiment.duration

    def __call__(self, experiment: Experiment, ctrl: Controller) -> Experiment:
        found = learn(
            ctrl,
            experiment.plant,
            experiment.reference,
            by=self.by,
            duration=experiment.duration,
            trials=self.trials,
            q0=experiment.q0,
            v0=experiment.v0,
            seed=experiment.seed + 1,
            events=experiment.events,
        )
        if found.faults:
            raise UsageError(found.faults[-1], name="by")
        return replace(experiment, reference=found.reference)


class Inversion(Declared):
    """The reference of `taut.analysis.stable_inversion` for the plant as it is, whose motion begins after `lead`."""

    lead: Field = Field(unit="s", minimum=0.0)

    def length(self, experiment: Experiment) -> float:
        return float(self.lead) + float(getattr(experiment.reference, "duration", 0.0))

    def __call__(self, experiment: Experiment, ctrl: Controller) -> Experiment:
        plant: Any = experiment.plant  # of a class that is checked there
        inverted = stable_inversion(ctrl, plant, experiment.reference, lead=float(self.lead))
        return replace(experiment, reference=inverted)


@dataclass(frozen=True, kw_only=True)
class Identification:
    """The controllers' arm as `taut.analysis.identify` finds it while the law follows `taut.analysis.excitation`."""

    motion: Fourier
    what: Mapping[str, Any]  # to find, if it is stated

    def length(self, experiment: Experiment) -> float:  # noqa: ARG002
        return float(self.motion.duration)

    def __call__(self, experiment: Experiment, ctrl: Controller) -> Experiment:
        events = tuple(event for event in experiment.events if event.t == 0.0)
        record = replace(
            experiment, reference=self.motion, duration=self.length(experiment), q0=None, v0=None, events=events
        )
        done = record.run(ctrl)
        if not done.outcome.ok:
            raise UsageError(f"the excitation ended early: {done.outcome.message}", name="kind")
        return replace(experiment, arm=identify(done, experiment.arm, **self.what).arm)


Change: TypeAlias = Learning | Inversion | Identification
"""What a preparation does: the experiment of a controller, changed; its length is that of the motion it needs [s]."""


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """A change of an experiment that depends on its law, made before the runs of that law."""

    table: Table
    change: Change

    def __call__(self, experiment: Experiment, law: Law | Task, engine: EngineChoice) -> Experiment:
        with self.table.blamed("kind"):
            return replace(self.change(experiment, experiment.controller(law, engine)), preparation=None)

    def __str__(self) -> str:
        return ", ".join(f"{key} = {value}" for key, value in self.table.values.items())


def read_preparation(table: Table, experiment: Experiment, sides: Iterable[LawSide]) -> Preparation:
    """[preparation] of laws of joint motion: its kind, and arguments as in Python. Raises ScenarioError."""
    table.need("kind", f"kind, one of {quoted_list(PREPARATIONS)}")
    kind, arm, rate = table.choice("kind", PREPARATIONS), experiment.arm, experiment.rate
    for side in sides:
        if side.task is not None or side.law.reference is not JointMotion:
            follows = "has phases" if side.task is not None else f"follows {side.law.reference.described()}"
            raise table.error(f"is for laws of joint motion, and {side.title} {follows}; leave [preparation] out")
    change: Change
    if kind == "identification":
        motion = read(excitation, table, others=["kind"], arm=arm)
        change = Identification(motion=motion, what={"what": table.get("what")} if "what" in table else {})
    else:
        change = read({"learning": Learning, "inversion": Inversion}[kind], table, others=["kind"])
    if isinstance(change, Learning):
        with table.table("by").blamed():
            change.by.check_size(arm.joint_names)
    if (length := change.length(experiment)) * rate > MAX_PREPARED_TICKS:
        raise table.error(
            f"takes motions of at most {MAX_PREPARED_TICKS / rate:g} [s] at {rate:g} Hz; got {length:g}"
        )
    return Preparation(table=table, change=change)
