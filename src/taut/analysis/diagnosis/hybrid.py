"""Contact of laws that press: the error along the constraint, a surface elsewhere, a contact that bounces."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.analysis.diagnosis.finding import Finding, Number, Picture
from taut.base.types import Float64Array
from taut.control.trajectories.force_reference import HybridMotion
from taut.record.run import Run

if TYPE_CHECKING:
    from taut.analysis.diagnosis.case import Case

__all__ = ["along_error", "bounce_findings", "surface_findings"]

BY_ACCELERATION: Final = ("TaskComputedTorque", "ComputedTorque")  # laws of motion whose kp is one of accelerations
TOUCHING: Final = 1.0  # [N] that counts as contact
ELSEWHERE: Final = 2e-3  # [m | rad] RMS of phi in contact: a fifth of what the law bears where a run starts
FEWEST: Final = 32  # ticks in contact
LONG: Final = 0.02  # [m] a stroke that shows a tilt
MAIN: Final = 0.2  # of its main direction: where a stroke goes less, it shows no tilt
STEEPEST: Final = 0.8  # sine of a tilt: more is no surface that was meant
LEAST_SHARE: Final = 0.01  # of the feedback's effort: less is not why a run is as it is
OPENINGS: Final = 10  # of a contact: a landing has fewer
UNEVEN: Final = 0.25  # standard deviation of the force over its mean
STRAIGHT: Final = 0.5  # of the variance of phi along the stroke, that a tilt explains


@dataclass(frozen=True, kw_only=True)
class _Hybrid:
    """Where the record of a hybrid law is in a run: of the law itself, or of a phase of a task."""

    path: str  # "law", "law.erase"
    motion: str  # name of the class of its law of motion

    @classmethod
    def of(cls, run: Run) -> _Hybrid | None:
        if not isinstance(run.reference, HybridMotion):
            return None
        paths = [name.removesuffix(".phi") for name in run.extra if name.endswith(".phi")]
        known = [path for path in paths if not np.isnan(run.extra[f"{path}.phi"]).any()]
        if len(known) != 1:
            return None
        (path,) = known
        phase = path.rpartition(".")[2]
        text = str(run.info.get("law", ""))
        start = max(text.find(f"{phase}: HybridMotionForce("), 0) if "." in path else 0
        found = re.search(r"HybridMotionForce\(.*?\bmotion=(\w+)\(", text[start:])
        return cls(path=path, motion="" if found is None else found[1])


def along_error(run: Run, M: Float64Array) -> Float64Array | None:
    """(k, n) the joint motion that would take away what a hybrid law has to correct along its constraint.

    Its term P holds just that: tau_P = M kp e for computed torque, with e along the constraint. What the reference
    asks for against the constraint is no error, and is not in it.

    Args:
        run: The run.
        M: (k, n, n) its mass matrices.

    Returns:
        None where the law of motion is another, whose kp is no number.
    """
    law = _Hybrid.of(run)
    if law is None or law.motion not in BY_ACCELERATION or "P" not in run.terms:
        return None
    kp = np.asarray(run.info.get("parameters", {}).get(f"{law.path}.motion.kp", np.nan), dtype=np.float64)
    if kp.shape != () or not kp > 0.0:
        return None
    return np.asarray(np.linalg.solve(M, run.terms["P"][:, :, np.newaxis])[:, :, 0] / kp)


def surface_findings(case: Case) -> Iterator[Finding]:
    """A surface that is not where the law states it: pressed, with the tool elsewhere than phi = 0.

    phi of the law's own constraint, at the poses of the run, in the ticks in which the tool is in contact: what
    holds both ways always is, a surface where 1 N and more is measured and contact is not lost. Its RMS in a row is
    2 mm (2 mrad of a row of angles) or more. Along a stroke of 2 cm a straight line through phi shows the tilt. What
    holds both ways counts where the force that answers it is a part of the feedback. A law that estimates the normal
    was told that it is not well known.
    """
    run, law = case.run, _Hybrid.of(case.run)
    if law is None or f"{law.path}.lost" not in run.extra or f"{law.path}.normal" in run.extra:
        return
    phi = run.extra[f"{law.path}.phi"]
    phi = phi.reshape(len(run), -1)
    held = run.extra[f"{law.path}.lost"] == 0.0
    if "one_sided" in run.terms:
        if "F_ext" not in run.extra:
            return
        held &= np.linalg.norm(run.extra["F_ext"][:, :3], axis=1) > TOUCHING
    if held.sum() < FEWEST:
        return
    off = np.sqrt(np.mean(phi[held] ** 2, axis=0))
    row = int(np.argmax(off))
    if off[row] < ELSEWHERE:
        return
    unit = "m" if phi.shape[1] == 1 and "one_sided" in run.terms else "m or rad"
    y = phi[held, row]
    tilt = _tilt(run.task.p[held], y) if unit == "m" else None
    leaning = {} if tilt is None else {"tilt along the stroke": Number(math.degrees(tilt), "deg")}
    forces = [value for name, value in case.feedback_terms.items() if name.startswith("force_")]
    pressed = np.asarray(sum(forces, np.zeros_like(run.q)))
    share = min(1.0, float(np.sum((pressed / case.size) ** 2)) / case.effort)
    if "one_sided" not in run.terms and share < LEAST_SHARE:
        return
    which = "the surface is" if phi.shape[1] == 1 else f"what row {row} of the constraint states is"
    yield Finding(
        name="wrong surface",
        term="constraint",
        joint=None,
        share=share,
        evidence={
            "mean of phi in contact": Number(float(y.mean()), unit),
            "RMS": Number(float(off[row]), unit),
            **leaning,
        },
        text=f"{which} not where the law says, or gives way: in contact phi is {y.mean():.3g} in the mean, from "
        f"{y.min():.3g} to {y.max():.3g} {unit}",
        remedy="state the constraint where the tool meets it, taut.laws.NormalEstimate(law=...) for a normal that "
        "is not well known, or lower gains of force and motion and kdamp, which bear it",
        picture=Picture(
            title="phi of the law's constraint (shaded: in contact)",
            ylabel=f"[{unit}]",
            t=run.t,
            curves={"phi" if phi.shape[1] == 1 else f"phi of row {row}": phi[:, row]},
            marked=held.astype(np.float64),
        ),
    )


def bounce_findings(case: Case) -> Iterator[Finding]:
    """A contact that opens and closes all the time while a law presses.

    Between the first tick and the last one in which 1 N and more is measured, the force falls below a tenth of its
    mean ten times and more, and its standard deviation is a quarter of its mean.
    """
    run = case.run
    column = next((name for name in ("contact.normal_force", "F_ext") if name in run.extra), None)
    if column is None or not (case.of_hybrid or case.of_force):
        return
    force = np.linalg.norm(run.extra[column][:, :3], axis=1)
    ticks = np.flatnonzero(force > TOUCHING)
    if len(ticks) < FEWEST:
        return
    force, t = force[ticks[0] : ticks[-1] + 1], run.t[ticks[0] : ticks[-1] + 1]
    mean, varies = float(force.mean()), float(force.std())
    open_ = (force < 0.1 * mean).astype(np.float64)
    openings = int(np.sum(np.diff(open_) > 0.0))
    if openings < OPENINGS or varies < UNEVEN * mean:
        return
    often = openings / max(float(t[-1] - t[0]), case.dt)
    in_mujoco = str(run.info.get("plant", "")).startswith("MujocoPlant")
    soft = 'priority="1" solimp="0 0.9 0.002 0.5 1"'
    yield Finding(
        name="bounces",
        term="contact",
        joint=None,
        share=float(open_.mean()),
        of="the time in contact",
        evidence={
            "openings": Number(often, "1/s"),
            "mean force": Number(mean, "N"),
            "standard deviation": Number(varies, "N"),
            "largest force": Number(float(force.max()), "N"),
        },
        text=f"the contact opens {often:.0f} times a second, with forces up to {force.max():.3g} N for {mean:.3g} N "
        "in the mean",
        remedy=f"give the geom of the surface {soft}, so that the force grows with the depth (by default MuJoCo "
        "pushes with nearly all of it from the first micrometre), or lower kfp and kfi"
        if in_mujoco
        else "lower kfp and kfi, raise kdamp, or press with a tool that gives way",
        picture=Picture(title="measured contact force", ylabel="[N]", t=t, curves={"force": force}, marked=open_),
    )


def _tilt(p: Float64Array, y: Float64Array) -> float | None:
    """[rad] by which a surface leans against the stated one along the way of the tool; None where it shows none."""
    way = p - p.mean(axis=0)
    if float(np.linalg.norm(np.ptp(p, axis=0))) < LONG:
        return None
    slope = np.linalg.lstsq(way, y - y.mean(), rcond=MAIN)[0]
    left = y - y.mean() - way @ slope
    if float(np.sum(left**2)) > (1.0 - STRAIGHT) * float(np.sum((y - y.mean()) ** 2)):
        return None
    steep = float(np.linalg.norm(slope))
    return math.asin(steep) if steep < STEEPEST else None
