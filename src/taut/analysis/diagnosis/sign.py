"""Wrong signs: terms that push away from the target, and joints that turn against their torque."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from taut.analysis.diagnosis.case import Case
from taut.analysis.diagnosis.finding import Finding, Number, Picture, in_parts
from taut.base.types import Array, Float64Array

__all__ = ["sign_findings"]

REVERSED: Final = 1.5  # d = 2 tau where a joint turns against its torque; 0 where it does not
AGAINST: Final = -0.5  # sum P . e over sum |P . e|, which is positive for a spring that answers the error
EXACT: Final = 1e-9  # of P in squares that is no multiple of the error: rounding
BACKWARDS: Final = -0.9  # the same of damping, which may come late
AWAY: Final = 3.0  # times as far from the target at the end as at the start
UNLIKE: Final = 0.1  # of the residual, in squares, that is no multiple of the torque
LEAST: Final = 16  # ticks, which a joint that runs away may leave
LEAST_CHANGE: Final = 0.01  # of the effort: a torque that changes less says nothing of a sign


def sign_findings(case: Case) -> Iterator[Finding]:
    """Terms that push away from the target, and joints that turn against their torque.

    By itself: the error of a joint grew to three times what it was, and the spring pushes along: of all joints
    together sum P . e is negative, which it is for no positive definite kp, nor for M kp in the kinetic measure; or
    P of a joint is a negative multiple of its error exactly. So it is of damping and the speed of the error. With a
    model: of a joint that turns against its torque,
    tau - (M a + h) = 2 tau; a factor above 1.5 with nine tenths of it explained, of the torque and of what changes in
    it, for a residual in a hold says nothing of signs. A residual that a load explains is that of a load.
    """
    e, run = case.error, case.run
    if e is None or not case.of_torque:
        return
    ends = max(1, len(run) // 20)
    grown = np.abs(e[-ends:]).mean(axis=0) > AWAY * np.abs(e[:ends]).mean(axis=0) + case.tolerance
    for name, answered, words, remedy in (
        (
            "P",
            e,
            "the spring of {0} pushes away from the target",
            "the error round: e = wanted - actual, tau = + kp e",
        ),
        ("D", case.error_rate, "the damping of {0} drives it on", "the damping round: tau = + kd (v_wanted - v)"),
    ):
        i = None if answered is None else _wrong_way(case, name, answered, grown)
        if i is None or answered is None:
            continue
        joint, work = run.joint_names[i], run.terms[name] * answered
        over = float(np.sum(work[:, i]) / np.sum(answered[:, i] ** 2))
        unit = f"{run.effort_units[i]}{' s' if name == 'D' else ''}/{run.units[i]}"
        of = "error" if name == "P" else "error in speed"
        yield Finding(
            name="wrong sign",
            term=name,
            joint=joint,
            share=1.0,
            evidence={f"work of {name} on the {of}": Number(100.0 * _part(work), "% of its size")}
            | {f"{name} over {of}": Number(over, unit)},
            text=f"{words.format(repr(joint))}, and the error grows",
            remedy=f"turn the sign of {remedy}",
            picture=Picture(
                title=f"{name} and {of} of {joint}, each in parts of its largest",
                ylabel="[1]",
                t=run.t,
                curves={name: in_parts(run.terms[name][:, i]), of: in_parts(answered[:, i])},
            ),
        )
        return
    if case.model is None or len(run) < LEAST or _is_a_load(case):
        return
    tau, d = run.tau[case.model.ticks], case.model.residual
    factor, left = _multiple(d, tau)
    turned, unlike = _multiple(d - d.mean(axis=0), tau - tau.mean(axis=0))  # a load that is constant changes nothing
    lively = np.std(tau, axis=0) > LEAST_CHANGE * case.size
    against = (factor > REVERSED) & (left < UNLIKE) & (turned > REVERSED) & (unlike < UNLIKE) & lively
    for k in np.flatnonzero(against & grown):
        i = int(k)
        joint = run.joint_names[i]
        yield Finding(
            name="wrong sign",
            term="command",
            joint=joint,
            share=1.0,
            evidence={"residual over torque": Number(float(factor[i])), "of it unexplained": Number(float(left[i]))},
            text=f"'{joint}' turns against its torque",
            remedy="turn round the sign of the joint's torque, or of its encoder, in the drive",
            picture=Picture(
                title=f"torque of {joint}, and what its motion needs",
                ylabel=f"[{run.effort_units[i]}]",
                t=run.t[case.model.ticks],
                curves={"torque": tau[:, i], "needed by the model": case.model.motion[:, i]},
            ),
        )
        return


def _part(work: Float64Array) -> float:
    """-1 to 1: the work of a term, of its size."""
    return float(np.sum(work)) / max(float(np.sum(np.abs(work))), np.finfo(np.float64).tiny)


def _wrong_way(case: Case, name: str, answered: Float64Array, grown: Array) -> int | None:
    """The joint that a term pushes on the wrong way, if its error grows.

    Of joints in which the term is a negative multiple of what it answers exactly, by itself or over the inertia, else
    of those of a term that takes work from the joints together, the one with most of it.
    """
    if name not in case.run.terms:
        return None
    given = case.run.terms[name]
    work = given * answered
    alone = _negative_multiple(given, answered)
    if not (alone & grown).any() and case.model is not None and grown.any() and _part(work) < 0.0:
        alone = _negative_multiple(
            np.linalg.solve(case.model.mass_matrices, given[:, :, np.newaxis])[:, :, 0], answered
        )
    bad = alone & grown
    if not bad.any() and _part(work) < (AGAINST if name == "P" else BACKWARDS):
        bad = grown
    if not bad.any():
        return None
    return int(np.argmin(np.where(bad, np.sum(work / case.size, axis=0), np.inf)))


def _negative_multiple(y: Array, x: Float64Array) -> Array:
    """(n,) whether a column is one of the other by a negative number, to rounding."""
    k, left = _multiple(y, x)
    return np.asarray((k < 0.0) & (left <= EXACT))


def _is_a_load(case: Case) -> bool:
    """Whether gravity that somebody else gives, or a payload, explains what is beyond the model."""
    fit = case.fit
    return fit is not None and fit.kind in ("gravity", "payload") and fit.holds


def _multiple(y: Array, x: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(n,) of each column the least squares of y = k x, and what it leaves of y, in squares."""
    tiny = np.finfo(np.float64).tiny
    k = np.sum(x * y, axis=0) / np.maximum(np.sum(x**2, axis=0), tiny)
    return k, np.sum((y - k * x) ** 2, axis=0) / np.maximum(np.sum(y**2, axis=0), tiny)
