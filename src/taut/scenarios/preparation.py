"""[preparation]: what happens before a run and changes what is run: a reference learned or inverted, an arm identified."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, Final

from taut.analysis.comparison import Experiment
from taut.analysis.flexible_joints import stable_inversion
from taut.analysis.identification.excitation import excitation
from taut.analysis.identification.identify import identify
from taut.analysis.learning import LearningLaw, NormOptimal, PDLearning, learn
from taut.arm.description import Arm
from taut.base.errors import UsageError, quoted_list
from taut.base.fields import Declared, Field, Part, Whole
from taut.codegen.engine import EngineChoice
from taut.control.law import Law
from taut.control.lawside import LawSide
from taut.control.tasks.task import Task
from taut.control.trajectories.reference import JointMotion
from taut.controller import Controller
from taut.scenarios.reading import Table, of_kind, read, reads

Change = Callable[[Experiment, Controller], Experiment]
BY: Final = {"norm-optimal": NormOptimal, "pd": PDLearning}


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """A change of an experiment that depends on its law, made before each run of it."""

    table: Table
    change: Change

    def __call__(self, experiment: Experiment, law: Law | Task, engine: EngineChoice) -> Experiment:
        with self.table.blamed("kind"):
            return replace(self.change(experiment, experiment.controller(law, engine)), preparation=None)

    def __str__(self) -> str:
        return ", ".join(f"{key} {value}" for key, value in self.table.values.items())


@reads(LearningLaw)
def _learning_law(table: Table, key: str) -> LearningLaw:
    return of_kind(BY, table.table(key))  # type: ignore[no-any-return]


class Learning(Declared):
    """The reference that `taut.analysis.learn` learns in so many trials of the run, with other noise in each."""

    by: Part[LearningLaw] = Part(LearningLaw)
    trials: Whole = Whole(10, minimum=1)

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
    """The reference of `taut.analysis.stable_inversion`, with the motion `lead` later."""

    lead: Field = Field(unit="s", minimum=0.0)

    def __call__(self, experiment: Experiment, ctrl: Controller) -> Experiment:
        plant: Any = experiment.plant  # which is checked there
        inverted = stable_inversion(ctrl, plant, experiment.reference, lead=float(self.lead))
        return replace(experiment, reference=inverted)


def _identification(table: Table, arm: Arm) -> Change:
    """The controllers' arm as `taut.analysis.identify` finds it while the law follows `taut.analysis.excitation`."""
    motion = read(excitation, table, others=["kind"], arm=arm)
    what = {"what": table.get("what")} if "what" in table else {}

    def change(experiment: Experiment, ctrl: Controller) -> Experiment:
        events = tuple(event for event in experiment.events if event.t == 0.0)
        duration, start = float(motion.duration), {"q0": None, "v0": None}
        record = replace(experiment, reference=motion, duration=duration, events=events, **start).run(ctrl)
        if not record.outcome.ok:
            raise UsageError(f"the excitation ended early: {record.outcome.message}", name="kind")
        return replace(experiment, arm=identify(record, arm, **what).arm)

    return change


KINDS: Final = ("learning", "identification", "inversion")


def read_preparation(table: Table, arm: Arm, sides: Iterable[LawSide]) -> Preparation:
    """[preparation] of laws of joint motion: its kind, and arguments as of Python. Raises ScenarioError."""
    table.need("kind", f"kind, one of {quoted_list(KINDS)}")
    for side in sides:
        if side.task is not None or side.law.reference is not JointMotion:
            follows = "has phases" if side.task is not None else f"follows {side.law.reference.described()}"
            raise table.error(f"is for laws of joint motion, and {side.title} {follows}; leave [preparation] out")
    kind = table.choice("kind", KINDS)
    if kind == "identification":
        return Preparation(table=table, change=_identification(table, arm))
    change = read({"learning": Learning, "inversion": Inversion}[kind], table, others=["kind"])
    if isinstance(change, Learning):
        with table.table("by").blamed():
            change.by.check_size(arm.joint_names)
    return Preparation(table=table, change=change)
