"""taut.compare and taut.analysis.grade: laws, runs and scenarios by name, by text or as objects."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Final, TypeAlias

import numpy as np

from taut.analysis.compare.compare import Comparison, compare_laws
from taut.analysis.compare.grading import TOLERANCE, Grade, grade_law
from taut.analysis.compare.setting import Setting, setting_of, task_refused
from taut.analysis.compare.truth import WrongModel
from taut.base.errors import UsageError, quoted_list, unknown_name
from taut.base.types import ArrayLike
from taut.control.describe import title
from taut.control.law import Law
from taut.control.tasks.task import Task
from taut.control.trajectories.reference import as_reference
from taut.loop import Loop
from taut.record.report.run_report import law_in_python
from taut.record.run import Run
from taut.scenarios.laws import law_of_text
from taut.scenarios.scenario import Scenario, load_scenario

__all__ = ["USUAL", "compare", "grade"]

Given: TypeAlias = Law | Run | str
Where: TypeAlias = str | Loop | Scenario | Setting
USUAL: Final = WrongModel(mass=0.2, friction=0.2)


def compare(
    laws: Sequence[Given] | Mapping[str, Given] | None = None,
    on: Where | None = None,
    *,
    case: str | None = None,
    by: str | Sequence[str] = (),
    noise: Mapping[str, ArrayLike] | None = None,
    model: WrongModel | None = USUAL,
    references: Mapping[str, object] | None = None,
    parameters: Mapping[str, ArrayLike] | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    seed: int | None = None,
    engine: str = "auto",
    say: Callable[[str], None] | None = None,
    repeat: str = "",
) -> Comparison:
    """Laws side by side on one experiment, in the figures of figure 10.12.

    Error (RMS, peak, and RMS of the last fifth), the integral of tau^2, peak torque, the share of ticks in which a
    limit cut the command, chatter (total variation of tau per second); what noise of the sensors adds to error and
    chatter; and the error with true arms that differ from the model, the median and the worst of them.

    Args:
        laws: Laws, texts such as "PID(kp=100, kd=20)" or "stiff: PID(kp=900, kd=60)", names of laws of the scenario,
            and recorded runs; by name, or in a list in which no two have the same. The scenario's own laws if left
            out, or if there are only runs. Laws follow the reference of the scenario or loop, so that they must be of
            its kind.
        on: A built-in scenario by its name, the path of a .toml file, or a `taut.Loop`, whose plant, reference,
            sensing and limits every law gets. Left out for runs alone.
        case: Which of the scenario's cases, where it has any.
        by: A figure to rank by, or several, of which the next decides between equals: "rms_error", "effort",
            "noise_chatter", "model_worst", ...; the smallest is the best.
        noise: Standard deviation by sensor, {"position": 1e-5}, to compare with the plant as it is; where it is left
            out the plant's own noise against none, or where that has none, 1e-5 rad of positions and 1e-3 rad/s of
            velocities. {} leaves these rows out.
        model: By how much the true arm may differ; 20 % in masses and friction if left out; None leaves the rows out.
        references: References of laws that follow another kind, by the law's name.
        parameters: Values by path that every loop gets, such as {"plant.payload.mass": 1.0}.
        q0: (n,) where every run starts [rad | m]; the scenario's, or of a loop the arm's home, if left out.
        v0: (n,) with which velocity; likewise.
        seed: Of the noise; the scenario's if left out.
        engine: Of the controllers.
        say: Takes a line of progress.
        repeat: How to make it again, for a report, such as a command.

    Raises:
        UsageError: Two laws of one name, more than eight, nothing to compare; a run that ended early, is too short
            or has gaps; a law that cannot be compiled or does not fit.
        MatchError: A law that follows another kind of reference.
        UnknownNameError: No such scenario, case, law, figure, sensor or parameter.

    Example:
        >>> import taut
        >>> both = ["PID(kp=2.205, kd=2)", "GravityPID(kp=2.205, kd=2)"]
        >>> table = compare(both, "one_joint_pid", by="rms_error", model=None, noise={})
        >>> table.ranking
        ('GravityPID(kp=2.205, kd=2)', 'PID(kp=2.205, kd=2)')
        >>> sorted(table.entries["PID(kp=2.205, kd=2)"].numbers)[:3]
        ['chatter', 'effort', 'peak_error']

    References:
        Chapter, section 10.2.2.2 and figure 10.12.
    """
    if not isinstance(by, (str, Sequence)):
        raise UsageError(f"by names a figure, or several: by='rms_error'; got {by!r}", name="by")
    _check_options(model, {"noise": noise, "references": references, "parameters": parameters})
    setting, own = _where(on, case)
    given = _named(own if laws is None else laws, own)
    if setting is not None and given and not any(isinstance(value, Law) for value in given.values()):
        given = {**_beside(own, given), **given}
    of_law = {name: value for name, value in given.items() if isinstance(value, Law)}
    recorded = {name: value for name, value in given.items() if isinstance(value, Run)}
    if setting is not None:
        setting = _changed(setting, parameters, q0, v0, seed, engine)
    elif of_law:
        raise UsageError(
            "laws are compared on a scenario or a taut.Loop: taut.compare(laws, 'one_joint_pid')", name="on"
        )
    for name in references or {}:
        if name not in of_law:
            raise unknown_name("the comparison", "law", name, of_law)
    return compare_laws(
        of_law,
        setting if setting is None else {name: _with_reference(setting, name, references) for name in of_law},
        runs=recorded,
        by=[by] if isinstance(by, str) else list(by),
        noise=noise,
        model=model,
        say=say,
        repeat=repeat
        or _again(
            "compare",
            given,
            on,
            {
                "case": case,
                "by": by or None,
                "noise": noise,
                "model": model,
                "references": references,
                "parameters": parameters,
                "q0": q0,
                "v0": v0,
                "seed": seed,
            },
        ),
    )


def grade(
    law: Given,
    reference: Law | str,
    on: Where | None,
    *,
    case: str | None = None,
    tolerance: float = TOLERANCE,
    parameters: Mapping[str, ArrayLike] | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    seed: int | None = None,
    engine: str = "auto",
    say: Callable[[str], None] | None = None,
    repeat: str = "",
) -> Grade:
    """A law against a reference law: each figure with pass or fail, and where their commands differ, in which term.

    Both run on the experiment. A figure passes within the tolerance of the reference's, above or below. Then both
    get the states of the reference's own run, tick by tick: the largest difference of their commands there passes
    within the tolerance of the reference's largest command, and is reported with joint, time and terms that differ.

    Args:
        law: A law, or its text.
        reference: What it is to do the same as.
        on: As of `taut.compare`.
        case: As of `taut.compare`.
        tolerance: A share; 5 % if left out.
        parameters: As of `taut.compare`.
        q0: As of `taut.compare`.
        v0: As of `taut.compare`.
        seed: As of `taut.compare`.
        engine: As of `taut.compare`.
        say: As of `taut.compare`.
        repeat: As of `taut.compare`.

    Raises:
        UsageError: A law that cannot be compiled or does not fit; a reference law whose own run fails.
        TautError: As of `taut.compare`.

    Example:
        >>> graded = grade("PID(kp=3, kd=2)", "PID(kp=2.205, kd=2)", "one_joint_pid")
        >>> graded.ok, graded.wrong_term, round(graded.terms[0].size / graded.terms[0].reference - 3 / 2.205 + 1, 9)
        (False, 'P', 0.0)
    """
    _check_options(None, {"parameters": parameters})
    setting, own = _where(on, case)
    if setting is None:
        raise UsageError("a law is graded on a scenario or a taut.Loop; got none", name="on")
    setting = _changed(setting, parameters, q0, v0, seed, engine)
    named = [next(iter(_named([one], own).items())) for one in (law, reference)]
    (mine, student), (other, wanted) = named
    for name, value in named:
        if not isinstance(value, Law):
            raise UsageError(f"grade takes two laws; got a {type(value).__name__} '{name}'", name=name)
    assert isinstance(student, Law)
    assert isinstance(wanted, Law)
    mine = mine if mine != other else f"{mine} (graded)"
    both = {mine: student, other: wanted}
    return grade_law(
        (mine, student),
        (other, wanted),
        setting,
        tolerance=tolerance,
        say=say or (lambda _: None),
        repeat=repeat
        or _again(
            "grade",
            both,
            on,
            {"case": case, "tolerance": tolerance, "parameters": parameters, "q0": q0, "v0": v0, "seed": seed},
        ),
    )


def _check_options(model: object, by_name: Mapping[str, object]) -> None:
    """What a caller without a type checker mixes up."""
    if model is not None and not isinstance(model, WrongModel):
        raise UsageError(f"model must be a taut.analysis.WrongModel(mass=0.2), or None; got {model!r}", name="model")
    for name, given in by_name.items():
        if given is not None and not (isinstance(given, Mapping) and all(isinstance(key, str) for key in given)):
            raise UsageError(f"{name} must be given by name, {{name: value}}; got {given!r}", name=name)


def _beside(own: Mapping[str, Law], runs: Mapping[str, object]) -> Mapping[str, Law]:
    """The laws of a scenario, which recorded runs alone stand beside."""
    if not own:
        raise UsageError(
            "recorded runs alone are compared without a loop, which has no law by a name; leave it out, or name laws",
            name="on",
        )
    for name in own:
        if name in runs:
            raise UsageError(f"a law of the scenario and a run are both called '{name}'; name the run", name="laws")
    return own


def _again(verb: str, laws: Mapping[str, Law | Run], on: Where | None, options: Mapping[str, object]) -> str:
    """The lines of Python that do it again; what the reader has to fill in stands as dots."""
    lines = ["import taut", ""]
    if on is not None and not isinstance(on, str):
        lines.append("on = ...   # the taut.Loop or scenario of the settings above")
    names = {name: f"law_{i}" for i, name in enumerate(laws, start=1)}
    for name, law in laws.items():
        made = law_in_python(repr(law)) if isinstance(law, Law) else "...   # the recorded run"
        lines.append(f"{names[name]} = {made}")
    by_name = ", ".join(f"{name!r}: {word}" for name, word in names.items())
    given = f"{{{by_name}}}" if verb == "compare" else ", ".join(names.values())
    where = "on" if on is not None and not isinstance(on, str) else repr(on)
    usual = {"model": USUAL, "tolerance": TOLERANCE}
    changed = {name: value for name, value in options.items() if value is not usual.get(name)}
    stated = "".join(f", {name}={_option(value)}" for name, value in changed.items())
    return "\n".join([*lines, f"print(taut.{verb}({given}, {where}{stated}))"])


def _option(value: object) -> str:
    """An option as Python writes it, arrays as lists."""
    if isinstance(value, WrongModel):
        return f"taut.analysis.{value!r}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name!r}: {_option(one)}" for name, one in value.items()) + "}"
    return repr(value.tolist() if isinstance(value, np.ndarray) else value)


def _changed(
    setting: Setting,
    parameters: Mapping[str, ArrayLike] | None,
    q0: ArrayLike | None,
    v0: ArrayLike | None,
    seed: int | None,
    engine: str,
) -> Setting:
    """The experiment with what was asked to be different in it."""
    return dataclasses.replace(
        setting,
        parameters={**setting.parameters, **(parameters or {})},
        q0=setting.q0 if q0 is None else q0,
        v0=setting.v0 if v0 is None else v0,
        seed=setting.seed if seed is None else seed,
        engine=engine,
    )


def _with_reference(setting: Setting, name: str, references: Mapping[str, object] | None) -> Setting:
    if not references or name not in references:
        return setting
    return dataclasses.replace(setting, reference=as_reference(references[name]))


def _where(on: Where | None, case: str | None) -> tuple[Setting | None, Mapping[str, Law]]:
    """The experiment, and the laws that it has itself."""
    if isinstance(on, str):
        on = load_scenario(on)
    if isinstance(on, Scenario):
        chosen = _case_of(on, case)
        laws: dict[str, Law] = {}
        for label, law in chosen.laws.items():
            if isinstance(law, Task):
                raise UsageError(task_refused(chosen.source, law.names), name="on")
            laws[label] = law
        return _setting(chosen, case), laws
    if case is not None:
        raise UsageError("case is for a scenario that has cases; leave it out", name="case")
    if isinstance(on, Loop):
        return setting_of(on), {}
    if on is None or isinstance(on, Setting):
        return on, {}
    raise UsageError(
        f"laws are compared on a scenario's name, a .toml file or a taut.Loop; got {type(on).__name__}", name="on"
    )


def _case_of(scenario: Scenario, case: str | None) -> Scenario:
    if not scenario.cases:
        if case is not None:
            raise UsageError(f"{scenario.source} has no cases; leave case out", name="case")
        return scenario
    if case is None:
        raise UsageError(f"{scenario.source} has cases; take one of {quoted_list(scenario.cases)}", name="case")
    if case not in scenario.cases:
        raise unknown_name(scenario.source, "case", case, scenario.cases)
    return scenario.cases[case]


def _setting(scenario: Scenario, case: str | None) -> Setting:
    """The experiment of a scenario."""
    named = scenario.source.endswith(f": case '{case}'")  # those of a spread are not
    return Setting(
        name=scenario.source if case is None or named else f"{scenario.source}: case '{case}'",
        arm=scenario.arm,
        rate=scenario.rate,
        sensing=scenario.sensing,
        limits=scenario.limits,
        plant=scenario.plant,
        another_plant=scenario.another_plant,
        reference=scenario.reference,
        duration=scenario.duration,
        q0=scenario.q0,
        v0=scenario.v0,
        seed=scenario.seed,
        events=scenario.events,
        texts={"Scenario": scenario.text},
    )


def _named(given: Sequence[Given] | Mapping[str, Given], own: Mapping[str, Law]) -> dict[str, Law | Run]:
    """Laws and runs by name, no two of the same."""
    if isinstance(given, (str, Law, Run)) or not isinstance(given, (Sequence, Mapping)):
        raise UsageError(
            "laws are given in a list or by name: ['PID(kp=100, kd=20)', taut.laws.PID(kp=...)]", name="laws"
        )
    out: dict[str, Law | Run] = {}
    items = given.items() if isinstance(given, Mapping) else [(None, one) for one in given]
    for i, (label, one) in enumerate(items, start=1):
        name, value = _one(one, own, i)
        name = name if label is None else label
        if name in out:
            raise UsageError(
                f"two laws are called '{name}'; give each a name: 'stiff: PID(kp=900)' in a text, or "
                "{'stiff': law, 'soft': law}",
                name="laws",
            )
        out[name] = value
    return out


def _one(given: Given, own: Mapping[str, Law], number: int) -> tuple[str, Law | Run]:
    if isinstance(given, Law):
        return title(given), given
    if isinstance(given, Run):
        return f"run {number}", given
    if not isinstance(given, str):
        raise UsageError(f"compare takes laws, their texts, and runs; got {type(given).__name__}", name="laws")
    if given in own:
        return given, own[given]
    if "(" not in given:
        raise unknown_name(
            "the experiment", "law", given, own, hint="or write one with its gains, such as PID(kp=100, kd=20)"
        )
    return law_of_text(given)
