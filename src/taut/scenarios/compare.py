"""taut.compare and taut.analysis.grade: laws, runs and scenarios by name, by text or as objects."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeAlias

from taut.analysis.comparison import Comparison, Experiment, WrongModel, compare_laws
from taut.analysis.grading import GRADE_TOLERANCE, Grade, grade_law
from taut.base.errors import UsageError, quoted_list, unknown_name
from taut.base.types import ArrayLike
from taut.control.combine import title
from taut.control.law import Law
from taut.loop import Loop
from taut.record.run import Run
from taut.scenarios.scenario import Scenario, load_scenario
from taut.scenarios.sections import law_of_text

Item: TypeAlias = Law | Run | str
Where: TypeAlias = str | Loop | Scenario
USUAL: Final = WrongModel(mass=0.2, friction=0.2)


def compare(
    laws: Sequence[Item | tuple[str, Item]] | Mapping[str, Item] | None = None,
    on: Where | None = None,
    *,
    case: str | None = None,
    by: str | Sequence[str] = (),
    noise: bool = True,
    model: WrongModel | None = USUAL,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
) -> Comparison:
    """Laws side by side on one experiment, in the figures of figure 10.12.

    Error (RMS, peak, and RMS of the last fifth), the integral of tau^2, peak torque, the time in which a limit cut
    the command, chatter (total variation of tau per second); what noise of the sensors adds to error and chatter; and
    the error with true arms that differ from the model, the median and the worst of them.

    Args:
        laws: Laws, texts such as "PID(kp=100, kd=20)" or "stiff: PID(kp=900, kd=60)", names of laws of the scenario,
            and recorded runs; by name, or in a list in which no two have the same. The scenario's own laws if left
            out, or if there are only runs. All laws follow the kind of reference that the scenario or loop has.
        on: A built-in scenario by its name, the path of a .toml file, or a `taut.Loop`, whose plant, reference,
            sensing and limits every law gets. Left out for runs alone.
        case: Which of the scenario's cases, where it has any.
        by: A figure to rank by, or several, of which the next decides between equals: "rms_error", "effort",
            "noise_chatter", "model_worst", ..., or any metric of a run; the smallest is the best.
        noise: Whether to compare the plant's own noise with none; or where it has none, 1e-5 rad of positions and
            1e-3 rad/s of velocities.
        model: By how much the true arm may differ; 20 % in masses and friction if left out; None: no such figures.
        q0: (n,) where every run starts [rad | m]; the scenario's, or of a loop the arm's home, if left out.
        v0: (n,) with which velocity; likewise.

    Raises:
        UsageError: Two laws of one name, more than eight, nothing to compare; a recorded run too short, or of a
            task; a law that cannot be compiled or does not fit.
        UnknownNameError: No such scenario, case, law or figure.

    Example:
        >>> import taut
        >>> both = ["PID(kp=2.205, kd=2)", "GravityPID(kp=2.205, kd=2)"]
        >>> table = compare(both, "one_joint_pid", by="rms_error", model=None, noise=False)
        >>> table.ranking
        ('GravityPID(kp=2.205, kd=2)', 'PID(kp=2.205, kd=2)')
        >>> sorted(table.entries["PID(kp=2.205, kd=2)"].numbers)[:3]
        ['chatter', 'effort', 'peak_error']

    References:
        Chapter, section 10.2.2.2 and figure 10.12.
    """
    if model is not None and not isinstance(model, WrongModel):
        raise UsageError(f"model must be a taut.analysis.WrongModel(mass=0.2), or None; got {model!r}", name="model")
    experiment, own = _experiment(on, case, q0=q0, v0=v0)
    items = _named(own if laws is None else laws, own)
    if experiment is not None and own and all(isinstance(item, Run) for item in items.values()):
        items = _named([*own.items(), *items.items()], own)
    of_law = {name: item for name, item in items.items() if isinstance(item, Law)}
    if of_law and experiment is None:
        raise UsageError(
            "laws are compared on a scenario or a taut.Loop: taut.compare(laws, 'one_joint_pid')", name="on"
        )
    return compare_laws(
        of_law,
        experiment if of_law else None,
        runs={name: item for name, item in items.items() if isinstance(item, Run)},
        by=[by] if isinstance(by, str) else list(by),
        noise=noise,
        model=model,
    )


def grade(
    law: Item,
    reference: Law | str,
    on: Where,
    *,
    case: str | None = None,
    tolerance: float = GRADE_TOLERANCE,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
) -> Grade:
    """A law against a reference law: each figure with pass or fail, and where their commands differ, in which term.

    A figure passes within the tolerance of the reference's, above or below. Then both get the states of the
    reference's own run, tick by tick: the largest difference of their commands passes within the tolerance of the
    reference's largest command, and is reported with joint, time and terms that differ.

    Args:
        law: A law, or its text.
        reference: The law that it should match.
        on: As of `taut.compare`.
        case: As of `taut.compare`.
        tolerance: Relative; 5 % if left out.
        q0: As of `taut.compare`.
        v0: As of `taut.compare`.

    Raises:
        UsageError: A law that cannot be compiled or does not fit; a reference law whose own run fails.
        TautError: As of `taut.compare`.

    Example:
        >>> graded = grade("PID(kp=3, kd=2)", "PID(kp=2.205, kd=2)", "one_joint_pid")
        >>> graded.ok, graded.wrong_term, round(graded.terms[0].size / graded.terms[0].reference - 3 / 2.205 + 1, 9)
        (False, 'P', 0.0)
    """
    experiment, own = _experiment(on, case, q0=q0, v0=v0)
    if experiment is None:
        raise UsageError("a law is graded on a scenario or a taut.Loop; got none", name="on")
    (mine, student), (other, wanted) = (next(iter(_named([one], own).items())) for one in (law, reference))
    if not isinstance(student, Law) or not isinstance(wanted, Law):
        raise UsageError("grade takes two laws; got a run", name="law")
    return grade_law(
        (mine if mine != other else f"{mine} (graded)", student), (other, wanted), experiment, tolerance=tolerance
    )


def _experiment(
    on: Where | None, case: str | None, **changes: ArrayLike | None
) -> tuple[Experiment | None, Mapping[str, Law]]:
    """The experiment with what is different in it, and the laws that it has itself."""
    if on is None:
        return None, {}
    laws: Mapping[str, Law] = {}
    if isinstance(on, (str, Scenario)):
        scenario = _case_of(load_scenario(on) if isinstance(on, str) else on, case)
        experiment = scenario.experiment
        laws = {name: law for name, law in scenario.laws.items() if isinstance(law, Law)}
        if len(laws) < len(scenario.laws):
            raise UsageError(
                f"{experiment.name} is a task, whose phases have their own references; compare a phase of recorded "
                "runs, taut.load_run('a.mcap').phase(name)",
                name="on",
            )
    elif isinstance(on, Loop):
        experiment = Experiment.of(on)
        if case is not None:
            raise UsageError("case is for a scenario that has cases; leave it out", name="case")
    else:
        raise UsageError(
            f"laws are compared on a scenario's name, a .toml file or a taut.Loop; got {type(on).__name__}", name="on"
        )
    given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
    return dataclasses.replace(experiment, **given), laws


def _case_of(scenario: Scenario, case: str | None) -> Scenario:
    name = scenario.experiment.name
    if not scenario.cases:
        if case is not None:
            raise UsageError(f"{name} has no cases; leave case out", name="case")
        return scenario
    if case is None:
        raise UsageError(f"{name} has cases; take one of {quoted_list(scenario.cases)}", name="case")
    if case not in scenario.cases:
        raise unknown_name(name, "case", case, scenario.cases)
    return scenario.cases[case]


def _named(
    items: Sequence[Item | tuple[str, Item]] | Mapping[str, Item], own: Mapping[str, Law]
) -> dict[str, Law | Run]:
    if isinstance(items, str) or not isinstance(items, (Sequence, Mapping)):
        raise UsageError(
            "laws are given in a list or by name: ['PID(kp=100, kd=20)', taut.laws.PID(kp=...)]", name="laws"
        )
    out: dict[str, Law | Run] = {}
    for i, item in enumerate(items.items() if isinstance(items, Mapping) else items, start=1):
        label, value = item if isinstance(item, tuple) else ("", item)
        name, law = _law_or_run(value, own, f"run {i}")
        name = label or name
        if name in out:
            raise UsageError(
                f"two laws are called '{name}'; give each a name: 'stiff: PID(kp=900)' in a text, or "
                "{'stiff': law, 'soft': law}",
                name="laws",
            )
        out[name] = law
    return out


def _law_or_run(item: object, own: Mapping[str, Law], run: str) -> tuple[str, Law | Run]:
    if isinstance(item, Law):
        return title(item), item
    if isinstance(item, Run):
        return run, item
    if not isinstance(item, str):
        raise UsageError(f"compare takes laws, their texts, and runs; got {type(item).__name__}", name="laws")
    if item in own:
        return item, own[item]
    if "(" not in item:
        raise unknown_name(
            "the experiment", "law", item, own, hint="or write one with its gains, such as PID(kp=100, kd=20)"
        )
    return law_of_text(item)
