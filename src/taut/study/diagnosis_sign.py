"""Wrong signs: terms that push away from the target, and joints that turn against their torque."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from taut.base.types import Float64Array
from taut.study.diagnosis_case import Case
from taut.study.diagnosis_finding import Finding, Number, Picture, in_parts

__all__ = ["sign_findings"]

REVERSED: Final = 1.5  # d = 2 tau where a joint turns against its torque; 0 where it does not
AGAINST: Final = -0.5  # sum P . e over sum |P . e|, which is positive for a spring that answers the error
EXACT: Final = 1e-9  # of P in squares that is no multiple of the error: rounding
AWAY: Final = 3.0  # times as far from the target at the end as at the start
UNLIKE: Final = 0.1  # of the residual, in squares, that is no multiple of the torque
LEAST: Final = 16  # ticks, which a joint that runs away may leave
LEAST_CHANGE: Final = 0.01  # of the effort: a torque that changes less says nothing of a sign


def sign_findings(case: Case) -> Iterator[Finding]:
    """Terms that push away from the target, and joints that turn against their torque.

    By itself: the error of a joint grew to three times what it was, and the spring pushes along: of all joints
    together sum P . e is negative, which it is for no positive definite kp, nor for M kp in the kinetic measure; or
    P of a joint is a negative multiple of its error exactly. With a model: of a joint that turns against its torque,
    tau - (M a + h) = 2 tau; a factor above 1.5 with nine tenths of it explained, of the torque and of what changes in
    it, for a residual in a hold says nothing of signs. A residual that a load explains is that of a load.
    """
    e, run = case.error, case.run
    if e is None or not case.of_torque:
        return
    ends = max(1, len(run) // 20)
    grown = np.abs(e[-ends:]).mean(axis=0) > AWAY * np.abs(e[:ends]).mean(axis=0) + case.tolerance
    if "P" in run.terms:
        P = run.terms["P"]
        work = P * e
        together = float(np.sum(work)) / max(float(np.sum(np.abs(work))), np.finfo(np.float64).tiny)
        each = np.sum(work, axis=0) / np.maximum(np.sum(e**2, axis=0), np.finfo(np.float64).tiny)
        left = np.sum((P - each * e) ** 2, axis=0)
        alone = (each < 0.0) & (left <= EXACT * np.sum(P**2, axis=0))
        for i in np.flatnonzero((alone | (together < AGAINST)) & grown):
            joint = run.joint_names[i]
            yield Finding(
                name="wrong sign",
                term="P",
                joint=joint,
                share=1.0,
                evidence={"P . e of |P| |e|": Number(together), "P over error": Number(float(each[i]))},
                text=f"the spring of '{joint}' pushes away from the target, and the error grows",
                remedy="turn the sign of the error round: e = wanted - actual, tau = + kp e",
                picture=Picture(
                    title=f"spring and error of {joint}, each in parts of its largest",
                    ylabel="[1]",
                    t=run.t,
                    curves={"P": in_parts(P[:, i]), "error": in_parts(e[:, i])},
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
    for i in np.flatnonzero(against & grown):
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


def _is_a_load(case: Case) -> bool:
    """Whether gravity that somebody else gives, or a payload, explains what is beyond the model."""
    fit = case.fit
    return fit is not None and fit.kind in ("gravity", "payload") and fit.holds


def _multiple(y: Float64Array, x: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(n,) of each column the least squares of y = k x, and what it leaves of y, in squares."""
    tiny = np.finfo(np.float64).tiny
    k = np.sum(x * y, axis=0) / np.maximum(np.sum(x**2, axis=0), tiny)
    return k, np.sum((y - k * x) ** 2, axis=0) / np.maximum(np.sum(y**2, axis=0), tiny)
