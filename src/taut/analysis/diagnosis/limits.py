"""Limits that cut or are exceeded, integrals that wind up, jumps at the start, singularities, late periods."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from taut.analysis.diagnosis.case import Case
from taut.analysis.diagnosis.finding import Finding, Number, Picture
from taut.base.types import Array, Float64Array
from taut.control.limiting import LIMIT_TERMS
from taut.maths.singularity import BORDER, sizes_of

__all__ = ["beyond_limits_findings", "limit_findings", "period_findings"]

OFTEN: Final = 0.05  # of the run in which a limit cuts while the error is there
GAINED: Final = 0.1  # of the largest feedback that the integral gained while the command was cut
JUMP: Final = 0.25  # of the effort: 25 ms of the rate that Limits.of(arm, rate=True) allows
OF_PEAK: Final = 0.5  # of the run's largest feedback that is there in the first tick
AMPLIFIED: Final = 3.0  # times the feedback, near a singularity, of that elsewhere
GIVES_UP: Final = ("singularity", "reach")  # terms of what a law does not ask for there
NONE: Final = 1e-9  # of a limit: rounding
TICKS_BEYOND: Final = 3  # above a limit: fewer may be a peak that a drive gives
LATE: Final = 1.5  # periods
LATE_SHARE: Final = 0.01  # of the periods
REMEDIES: Final = {
    "torque_limit": "ask for less acceleration or load, or take an arm or gains that need less torque",
    "rate_limit": "follow a trajectory of bounded jerk in place of a step, or raise tau_dot to what the drives bear",
    "speed_limit": "give the motion more time, or raise v to what the joints bear",
    "torque": "give the controller the limits that the drives have, limits=taut.Limits(tau=...), and ask for less",
}


def limit_findings(case: Case) -> Iterator[Finding]:
    """Saturation, wind-up, jumps at the start and singularities."""
    winding = _winds_up(case)
    for finding in (winding, _saturates(case), _jumps(case), _loses_rank(case)):
        if finding is not None:
            yield finding


# -------------------------------------------------------------------- saturation


def _cuts(case: Case) -> dict[str, Float64Array]:
    """(k, n) what each limit took; "torque" is what the drives did not give, at their own limit."""
    run = case.run
    out = {name: run.terms[name] for name in LIMIT_TERMS if name in run.terms}
    if case.of_torque:
        out["torque"] = case.pinned
    return out


def _saturates(case: Case) -> Finding | None:
    """A limit that cuts in a twentieth of the ticks and more while there is an error that counts.

    Of several limits, the one that took most, in squares over the effort of each joint. Limits of the drives show as
    torques that stay at their largest while more is asked for.
    """
    run = case.run
    best: tuple[float, str, Float64Array] | None = None
    for name, cut in _cuts(case).items():
        acting = (cut != 0.0) & (case.off > 0.0)
        if acting.mean(axis=0).max() < OFTEN:
            continue
        took = float(np.sum((cut * acting / case.size) ** 2)) / case.effort
        if best is None or took > best[0]:
            best = took, name, cut
    if best is None:
        return None
    took, name, cut = best
    acting = (cut != 0.0) & (case.off > 0.0)
    i = int(np.argmax(np.sum((cut * acting / case.size) ** 2, axis=0)))
    joint, unit = run.joint_names[i], run.command_units[i]
    asked = (
        float(np.abs(run.command[:, i] - cut[:, i]).max())
        if name != "torque"
        else float(np.abs(run.command[:, i]).max())
    )
    given = float(np.abs(run.tau[:, i]).max() if name == "torque" else np.abs(run.command[:, i]).max())
    return Finding(
        name="saturates",
        term=name,
        joint=joint,
        share=min(1.0, took),
        evidence={
            "cut in": Number(100.0 * float(acting[:, i].mean()), "% of the run"),
            "asked for at most": Number(asked, unit),
            "given at most": Number(given, unit),
        },
        text=f"the {name.replace('_', ' ')} cuts '{joint}' in {100.0 * acting[:, i].mean():.0f} % of the run, while "
        "it is off its target",
        remedy=REMEDIES[name],
        picture=Picture(
            title=f"{joint}: what was asked for and what was given (shaded: cut)",
            ylabel=f"[{unit}]",
            t=run.t,
            curves={
                "asked for": run.command[:, i] - (cut[:, i] if name != "torque" else 0.0),
                "given": run.tau[:, i] if name == "torque" else run.command[:, i],
            },
            marked=acting[:, i].astype(np.float64),
        ),
    )


def beyond_limits_findings(case: Case) -> Iterator[Finding]:
    """Joint torques above the effort limit of the arm, in three ticks or more: a plant without limits gave them."""
    run, effort = case.run, case.arm_effort
    over = np.abs(run.tau) > (1.0 + NONE) * effort
    if not case.of_torque or (over.sum(axis=0) < TICKS_BEYOND).all():
        return
    i = int(np.argmax(np.max(np.abs(run.tau), axis=0) / effort))
    joint, unit, largest = run.joint_names[i], run.effort_units[i], float(np.abs(run.tau[:, i]).max())
    part = (np.abs(run.tau) - effort)[over] / np.broadcast_to(effort, run.tau.shape)[over]
    yield Finding(
        name="beyond limits",
        term="command",
        joint=joint,
        share=min(1.0, float(np.sum(part**2)) / case.effort),
        evidence={
            "largest torque": Number(largest, unit),
            "effort limit of the arm": Number(float(effort[i]), unit),
            "beyond it in": Number(100.0 * float(over[:, i].mean()), "% of the run"),
        },
        text=f"'{joint}' receives up to {Number(largest, unit)}, and the arm's effort limit is "
        f"{Number(float(effort[i]), unit)}: the real arm cannot repeat this run",
        remedy="compile with limits=taut.Limits.of(arm), and lower the gains or the demanded motion until that does "
        "not cut",
        picture=Picture(
            title=f"{joint}: torque (shaded: beyond the limit)",
            ylabel=f"[{unit}]",
            t=run.t,
            curves={"torque": run.tau[:, i]},
            levels={"limit": float(effort[i])},
            marked=over[:, i].astype(np.float64),
        ),
    )


def _winds_up(case: Case) -> Finding | None:
    """An integral that grew into a limit, and then carried the joint beyond its target.

    While the command was cut the I term gained, in the direction of the cut, a tenth of the largest feedback or more;
    when an error that counts first changed sign it still held half of that gain; and the joint went on by more than
    what counts as an error.
    """
    run = case.run
    if "I" not in run.terms or case.error is None:
        return None
    integral, cuts = run.terms["I"], _cuts(case)
    cut = np.asarray(sum(cuts.values(), np.zeros_like(run.q)))
    best: tuple[float, int, float, float, int] | None = None
    for i in range(case.n):
        into = -np.sign(cut[1:, i])
        away = [each for each in _swings(case.error[:, i]) if case.off[each[0] : each[1], i].any()]
        for first, at, _ in away[:1]:  # later ones are those of a swing
            way = float(np.sign(case.error[first, i]))
            rises = np.diff(integral[first : at + 1, i]) * way
            gained = float(np.sum(np.maximum(rises, 0.0) * (into[first:at] == way)))
            beyond = float(np.max(-way * case.error[at:, i]))
            if gained < GAINED * float(np.abs(case.feedback[:, i]).max()) or beyond <= case.tolerance[i]:
                continue
            if way * integral[at, i] < 0.5 * gained:
                continue
            if best is None or gained / case.size[i] > best[0]:
                best = gained / case.size[i], i, gained, beyond, at
    if best is None:
        return None
    _, i, gained, beyond, at = best
    part = np.zeros_like(run.q)
    part[:, i] = integral[:, i]
    joint = run.joint_names[i]
    return Finding(
        name="winds up",
        term="I",
        joint=joint,
        share=min(1.0, float(np.sum((part / case.size) ** 2)) / case.effort),
        evidence={
            "gained while cut": Number(gained, run.effort_units[i]),
            "beyond the target": Number(beyond, run.units[i]),
            "cut in": Number(100.0 * float((cut[:, i] != 0.0).mean()), "% of the run"),
            "back at the target after": Number(float(run.t[at] - run.t[0]), "s"),
        },
        text=f"the integral of '{joint}' grows by {gained:.3g} {run.effort_units[i]} while the command is cut, and "
        f"carries the joint {beyond:.3g} {run.units[i]} beyond its target",
        remedy="anti_windup='clamping' or 'back-calculation' in the law, or a motion within the limits",
        picture=Picture(
            title=f"{joint}: integral and error, each in parts of its largest (shaded: cut)",
            ylabel="[1]",
            t=run.t,
            curves={
                "I": integral[:, i] / np.abs(integral[:, i]).max(),
                "error": case.error[:, i] / np.abs(case.error[:, i]).max(),
            },
            marked=(cut[:, i] != 0.0).astype(np.float64),
        ),
    )


def _swings(error: Float64Array) -> Iterator[tuple[int, int, int]]:
    """Where an error of one sign begins, where it changes sign, and where that one ends."""
    ticks = np.flatnonzero(error)
    turns = ticks[1:][np.diff(np.sign(error[ticks])) != 0.0]
    edges = [*(ticks[:1].tolist() if len(ticks) else []), *turns.tolist(), len(error)]
    yield from zip(edges, edges[1:], edges[2:], strict=False)


# -------------------------------------------------------------------- the start


def _jumps(case: Case) -> Finding | None:
    """A first tick in which feedback gives a quarter of the effort at once, and half of all that it ever gives.

    Before it the arm was held by what the model's terms give, so that the jump is what feedback adds after limits. A
    quarter of the effort is 25 ms of the rate that `Limits.of(arm, rate=True)` allows. Of an arm whose effort nobody
    stated no torque is a jump.
    """
    run = case.run
    if case.limits_of_effort is None:
        return None
    given = case.given
    first = np.abs(given[0]) / case.size
    peak = np.max(np.abs(given), axis=0) / case.size
    bad = (first >= JUMP) & (first >= OF_PEAK * peak)
    if "blend" in run.terms and np.any(run.terms["blend"][0]):
        return None
    if not bad.any():
        return None
    i = int(np.argmax(bad * first))
    below = np.flatnonzero(np.abs(given[:, i]) < 0.5 * abs(given[0, i]))
    end = int(below[0]) if below.size else len(run)
    part = np.zeros_like(run.q)
    part[:end, bad] = case.feedback[:end, bad]
    term = max(case.feedback_terms, key=lambda name: abs(case.feedback_terms[name][0, i]))
    joint, unit = run.joint_names[i], run.effort_units[i]
    away = "for its target is elsewhere"
    known = {}
    if case.error is not None and abs(case.error[0, i]) > case.tolerance[i]:
        known = {"error at the start": Number(float(case.error[0, i]), run.units[i])}
        away = f"for the reference starts {case.error[0, i]:.3g} {run.units[i]} away"
    elif term == "D":
        away = "for the reference starts with another velocity than the arm"
    k = float(first[i])
    instead = (
        f", or limits=taut.Limits(blend={max(0.1, 0.2 * k):.2g})"
        if k <= 1.0
        else f"; or lower the gains: {term} asks for {Number(k)} times the effort limit in the first tick"
    )
    return Finding(
        name="jumps at start",
        term=term,
        joint=joint,
        share=case.share_of(part),
        evidence={
            "jump": Number(float(given[0, i]), unit),
            "of the effort": Number(100.0 * float(first[i]), "%"),
            **known,
        },
        text=f"'{joint}' gets {given[0, i]:.3g} {unit} at once, {away}",
        remedy=f"start the reference where the arm is (a trajectory from the measured position){instead}",
        picture=Picture(
            title=f"{joint}: feedback from the first tick on",
            ylabel=f"[{unit}]",
            t=run.t[: max(64, 2 * end)],
            curves={name: value[: max(64, 2 * end), i] for name, value in case.feedback_terms.items()},
        ),
    )


# -------------------------------------------------------------------- singularities


def _loses_rank(case: Case) -> Finding | None:
    """A task that comes so near a singularity that the arm shows it.

    The smallest singular value of J falls under the border that the laws themselves use (`sizes_of`: 0.1, less for
    an arm that reaches less than 0.9 m), and there the law gives something up (`singularity`, `reach`), or feedback
    is three times as large as elsewhere while the error counts, or a joint goes faster than its limit there alone.
    """
    run = case.run
    if not case.of_task:
        return None
    least = run.task.min_singular_value
    border = BORDER * min(1.0, case.length / 0.9) if case.model is None else sizes_of(case.model.arm).border
    near = least < border
    if not near.any():
        return None
    weighed = np.sum((case.feedback / case.size) ** 2, axis=1)
    name = next((name for name in GIVES_UP if np.any(run.terms.get(name, 0.0))), "singularity")
    gives_up = run.terms.get(name, np.zeros_like(run.q))
    # what the law leaves out must be something beside its feedback
    left_out = np.sum((gives_up / case.size) ** 2, axis=1)
    active = bool(np.any(left_out[near] > 0.01 * max(float(weighed.max()), np.finfo(np.float64).tiny)))
    elsewhere = float(weighed[~near].mean()) if (~near).any() else 0.0
    louder = (~near).any() and float(weighed[near].mean()) > AMPLIFIED**2 * elsewhere
    fast = _too_fast(case, near)
    if not (active or fast is not None or (louder and case.off[near].any())):
        return None
    if active:
        term, more = name, f"; what the law leaves out there is its term '{name}'"
    else:
        term, more = ("feedforward" if fast is not None and "feedforward" in run.terms else "P"), ""
    speeds = {} if fast is None else {"joint speed there": Number(100.0 * fast[1], "% of its limit")}
    robust = "" if active else "use singularity='robust', "
    k = int(np.argmin(least))
    direction = np.linalg.svd(run.task.J[k])[0][:, len(run.task.J[k].T) - 1 if run.n < 6 else 5]
    i = int(np.argmax(np.max(np.abs(case.feedback[near]), axis=0) / case.size)) if fast is None else fast[0]
    return Finding(
        name="loses rank",
        term=term,
        joint=run.joint_names[i],
        share=float(weighed[near].sum()) / case.effort,
        evidence={
            "smallest singular value": Number(float(least[k])),
            "border": Number(border),
            "at": Number(float(run.t[k]), "s"),
            "near it for": Number(float(near.sum()) * case.dt, "s"),
            **speeds,
        },
        text=f"the Jacobian nearly loses the direction ({', '.join(f'{x:.2f}' for x in direction)}) "
        f"at t = {run.t[k]:.3g} s{more}",
        remedy=f"lead the path where the smallest singular value stays above {border:.2g}, {robust}"
        "or take a law of joint space (via_joint_space) for this stretch",
        picture=Picture(
            title="smallest singular value of J",
            ylabel="[1]",
            t=run.t,
            curves={"least singular value": least},
            levels={"border": border},
            marked=near.astype(np.float64),
        ),
    )


def _too_fast(case: Case, near: Array) -> tuple[int, float] | None:
    """The joint that is fastest near a singularity, and its speed over its limit, if none is beyond it elsewhere."""
    known = case.run.info.get("limits", {}).get("velocity", {})
    most = np.array([known.get(joint, np.nan) for joint in case.run.joint_names])
    if np.isnan(most).any():
        return None
    used = np.abs(case.run.v) / most
    elsewhere = float(used[~near].max()) if (~near).any() else 0.0
    i = int(np.argmax(used[near].max(axis=0)))
    there = float(used[near, i].max())
    return (i, there) if there > 1.0 >= elsewhere else None


# -------------------------------------------------------------------- the clock


def period_findings(t: Float64Array, rate: float) -> Iterator[Finding]:
    """Periods that are longer than one and a half of the nominal one: one in a hundred, or any of two and more."""
    periods = np.diff(t) * rate
    late = periods > LATE
    if not late.any() or (late.mean() < LATE_SHARE and periods.max() < 2.0):
        return
    yield Finding(
        name="runs late",
        term="period",
        joint=None,
        share=float(late.mean()),
        of="the periods",
        evidence={
            "late": Number(100.0 * float(late.mean()), "% of the periods"),
            "longest": Number(1e3 * float(periods.max()) / rate, "ms"),
            "nominal": Number(1e3 / rate, "ms"),
            "mean": Number(1e3 * float(periods.mean()) / rate, "ms"),
        },
        text=f"{int(late.sum())} of {len(periods)} periods are longer than {LATE:g} nominal ones, the longest "
        f"{1e3 * periods.max() / rate:.3g} ms",
        remedy=f"compile for a rate that the clock keeps, {rate / float(np.quantile(periods, 0.99)):.0f} Hz, or give "
        "the loop a core and a real-time priority of its own",
        picture=Picture(
            title="periods",
            ylabel="[ms]",
            t=t[1:],
            curves={"period": 1e3 * np.diff(t)},
            levels={"nominal": 1e3 / rate},
        ),
    )
