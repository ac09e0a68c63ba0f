"""What feedback carries that it should not: wrong signs, gravity, payloads, dry friction, constant loads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from taut.base.types import Array, Float64Array
from taut.record.sticking import RESTING, stuck
from taut.study.diagnosis_case import Case, tail
from taut.study.diagnosis_finding import Finding, Number, Picture
from taut.study.diagnosis_model import Fit

__all__ = ["load_findings", "sign_findings"]

MOST: Final = 0.98  # of what friction leaves of the residual, in squares, that a load has to explain: all but 2 %
HALF: Final = 0.5  # of gravity: who gives more of it compensates it
LEAST_LOAD: Final = 0.05  # of the largest gravity torque: a smaller payload is none
LEAST_GRAVITY: Final = 0.01  # of the effort: arms with less have no gravity to speak of
REVERSED: Final = 1.5  # d = 2 tau where a joint turns against its torque; 0 where it does not
AGAINST: Final = -0.5  # sum P . e over sum |P . e|, which is positive for a spring that answers the error
EXACT: Final = 1e-9  # of P in squares that is no multiple of the error: rounding
AWAY: Final = 3.0  # times as far from the target at the end as at the start
SLACK: Final = 1.5  # times the friction fitted in motion: static friction, and what the fit misses
TORQUE_CHANGE: Final = 0.01  # of the effort: a free joint would have moved
UNSURE: Final = 0.1  # of the residual, in squares: where a fit leaves more, its friction is none to go by
STUCK: Final = 0.1  # of the time in which its reference moves; a rest after each reversal is less


def sign_findings(case: Case) -> Iterator[Finding]:
    """Terms that push away from the target, and joints that turn against their torque.

    By itself: the error of a joint grew to three times what it was, and the spring pushes along: of all joints
    together sum P . e is negative, which it is for no positive definite kp, nor for M kp in the kinetic measure; or
    P of a joint is a negative multiple of its error exactly. With a model: of a joint that turns against its torque,
    tau - (M a + h) = 2 tau; a factor above 1.5 with nine tenths of it explained.
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
                    curves={"P": _unit(P[:, i]), "error": _unit(e[:, i])},
                ),
            )
            return
    if case.model is None:
        return
    tau, d = run.tau[case.model.ticks], case.model.residual
    factor = np.sum(tau * d, axis=0) / np.maximum(np.sum(tau**2, axis=0), np.finfo(np.float64).tiny)
    left = np.sum((d - factor * tau) ** 2, axis=0) / np.maximum(np.sum(d**2, axis=0), np.finfo(np.float64).tiny)
    for i in np.flatnonzero((factor > REVERSED) & (left < 0.1) & grown):
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


def _unit(y: Float64Array) -> Float64Array:
    return y / max(float(np.abs(y).max()), np.finfo(np.float64).tiny)


def load_findings(case: Case) -> Iterator[Finding]:
    """Gravity, payload, friction and whatever else feedback carries at rest or along the motion."""
    if not case.of_torque or case.in_contact:
        return
    fit = case.fit
    of_load = None if fit is None else _load(case, fit)
    if of_load is not None:
        yield of_load
    for finding in (_sticks(case, fit), None if of_load is not None else _sags(case, fit)):
        if finding is not None:
            yield finding


# -------------------------------------------------------------------- gravity and payload


def _load(case: Case, fit: Fit) -> Finding | None:
    """Gravity twice, gravity not at all, or another payload.

    tau + J^T F_ext - (M a + C v + g) is what acted beyond the model. It is fitted by part of -g (somebody else gives
    gravity), by a payload, and by friction, see `ArmModel.fit`; a load has to explain all but 2 % of what friction
    leaves. The law compensates gravity where its terms hold more than half of g.
    """
    model = case.model
    assert model is not None
    g = model.gravity
    largest = float(np.abs(g / case.size).max())
    if largest < LEAST_GRAVITY:
        return None
    given = np.zeros_like(g)
    for name in ("gravity", "nonlinear", "force_nonlinear"):
        if name in case.run.terms:
            given = given + case.run.terms[name][model.ticks]
    weight = case.size**2
    by_law = float(np.sum(given * g / weight) / np.sum(g * g / weight))
    holds = fit.explained >= MOST
    by_plant = fit.gravity if fit.kind == "gravity" and holds else 0.0
    if by_law >= HALF and by_plant >= HALF:
        return _gravity_twice(case, by_law, by_plant, -fit.load)
    if by_law < HALF and by_plant < HALF:
        return _no_gravity(case, by_law, g)
    heavy = float(np.abs(fit.load / case.size).max()) >= LEAST_LOAD * largest
    if by_law >= HALF and fit.kind == "payload" and holds and heavy and abs(fit.mass) > 3.0 * fit.mass_error:
        return _payload(case, fit)
    return None


def _at_ticks(case: Case, load: Float64Array) -> Float64Array:
    """(k, n) of what is known at some ticks, at all of them."""
    assert case.model is not None
    at = case.run.t[case.model.ticks]
    return np.column_stack([np.interp(case.run.t, at, column) for column in load.T])


def _worst(case: Case, load: Float64Array) -> int:
    return int(np.argmax(np.sqrt(np.mean(load**2, axis=0)) / case.size))


def _picture(case: Case, load: Float64Array, i: int, name: str) -> Picture:
    unit = case.run.effort_units[i]
    curves = {"feedback": case.feedback[:, i], name: load[:, i]}
    return Picture(title=f"{case.run.joint_names[i]}", ylabel=f"[{unit}]", t=case.run.t, curves=curves)


def _gravity_twice(case: Case, by_law: float, by_plant: float, g: Float64Array) -> Finding:
    load = _at_ticks(case, -g)
    i = _worst(case, load)
    run = case.run
    term = "gravity" if "gravity" in run.terms else "nonlinear"
    return Finding(
        name="gravity twice",
        term=term,
        joint=run.joint_names[i],
        share=case.share_of(load),
        evidence={
            "of gravity by the law": Number(100.0 * by_law, "%"),
            "of gravity by the plant": Number(100.0 * by_plant, "%"),
            "steady error": Number(float(case.steady_error[i]), run.units[i]),
        },
        text="the plant gives gravity itself, and the law adds it again; feedback pushes it back down",
        remedy="compile with adds=plant.adds (or adds={'gravity'}), or take a law without gravity, such as PID",
        picture=_picture(case, load, i, "gravity that is too much"),
    )


def _no_gravity(case: Case, by_law: float, g: Float64Array) -> Finding | None:
    """Feedback carries more than half of it, and an error is left that counts."""
    load = _at_ticks(case, g)
    share = case.share_of(load)
    if share < HALF or case.error is None:
        return None
    rms = np.sqrt(np.mean(case.error**2, axis=0))
    left = np.where(case.settled > 0.0, np.abs(case.steady_error), rms)
    if not (left > case.tolerance).any():
        return None
    i = int(np.argmax(left / case.tolerance))
    run = case.run
    return Finding(
        name="gravity not compensated",
        term="P",
        joint=run.joint_names[i],
        share=share,
        evidence={
            "of gravity by the law": Number(100.0 * by_law, "%"),
            "gravity torque": Number(float(np.abs(load[:, i]).max()), run.effort_units[i]),
            "error": Number(float(left[i]), run.units[i]),
        },
        text="neither law nor plant compensates gravity: the arm sags until the spring holds it",
        remedy="take GravityPID or ComputedTorque, or add an integral, ki > 0",
        picture=_picture(case, load, i, "gravity"),
    )


def _payload(case: Case, fit: Fit) -> Finding:
    load, run = _at_ticks(case, fit.load), case.run
    i = _worst(case, load)
    assert case.model is not None
    told = float(case.model.payload[0])
    mass = told + fit.mass
    first = told * case.model.payload[1] + fit.moment
    centre = first / mass if abs(mass) > 3.0 * fit.mass_error else np.zeros(3)
    off = np.linalg.norm(centre) > 1e-3
    where = f", com=({', '.join(f'{x:.3f}' for x in centre)}) m in the tool frame" if off else ""
    return Finding(
        name="wrong payload",
        term="gravity" if "gravity" in run.terms else "nonlinear",
        joint=run.joint_names[i],
        share=case.share_of(load),
        evidence={
            "declared": Number(told, "kg"),
            "beyond it": Number(fit.mass, "kg"),
            "standard error": Number(fit.mass_error, "kg"),
            "of the residual explained": Number(100.0 * fit.explained, "%"),
        },
        text=f"the torques are those of an arm with {fit.mass:+.3g} kg at its tool beyond what the law was told",
        remedy=f"declare the payload: arm.with_payload({mass:.3g}{where}), or ctrl.parameters['model.payload.mass']",
        picture=_picture(case, load, i, "payload that is not declared"),
    )


# -------------------------------------------------------------------- friction, and what else is constant


def _stiffness(case: Case, i: int) -> float:
    """Steady feedback over steady error of a joint [N m/rad | N/m]."""
    at = tail(case.run)
    assert case.error is not None
    return abs(float(case.feedback[at, i].mean())) / max(abs(float(case.error[at, i].mean())), 1e-300)


def _sticks(case: Case, fit: Fit | None) -> Finding | None:
    """A joint that rests (|v| < 1e-4) off its target for want of torque against dry friction.

    At a set-point it rests in the last tenth of the run with an error that counts, and one of these holds: it never
    moved; its torque changed while it rested by more than 1 % of the effort; what the feedback carries beyond loads
    is within the dry friction that its motion showed. On the way it rests for a tenth of the time in which its
    reference moves, off it.
    """
    run = case.run
    at_rest = _sticking(case, fit)
    if case.error is None or not at_rest.any():
        return None
    part = _carried(case, fit) * at_rest
    i = int(np.argmax(np.sum((part / case.size) ** 2, axis=0)))
    share, rest = case.share_of(part), at_rest[:, i]
    held = rest > 0.0
    joint, unit = run.joint_names[i], run.effort_units[i]
    most = float(np.abs(part[held, i]).max())
    error = float(np.abs(case.error[held, i]).max())
    known = fit is not None and fit.coulomb[i] > 0.0
    dry = float(fit.coulomb[i]) if fit is not None and known else most
    return Finding(
        name="sticks",
        term="friction",
        joint=joint,
        share=share,
        evidence={
            "rests for": Number(float(held.sum()) * case.dt, "s"),
            "error there": Number(error, run.units[i]),
            "torque that does not move it": Number(most, unit),
            **({"dry friction fitted": Number(dry, unit)} if known else {}),
        },
        text=f"'{joint}' rests off its target while the feedback pushes it: dry friction holds it",
        remedy=f"add FrictionCompensation(at='ref') with {dry:.3g} {unit} of Coulomb friction, an integral, or "
        f"RaisedGains; kp alone would leave up to {dry:.3g} {unit} / kp",
        picture=Picture(
            title=f"{joint}: error, and feedback in parts of its largest (shaded: at rest)",
            ylabel="[1]",
            t=run.t,
            curves={"error": _unit(case.error[:, i]), "feedback": _unit(case.feedback[:, i])},
            marked=rest,
        ),
    )


def _carried(case: Case, fit: Fit | None) -> Float64Array:
    """(k, n) feedback without the loads that are known: gravity that the law does not give, and what was fitted."""
    out = case.feedback
    if case.model is not None and fit is not None:
        names = [name for name in ("gravity", "nonlinear", "force_nonlinear") if name in case.run.terms]
        given = sum((case.run.terms[name] for name in names), np.zeros_like(out))
        by_plant = fit.load if fit.explained >= MOST else np.zeros_like(fit.load)
        at_rest = case.model.gravity - given[case.model.ticks]
        out = out - _at_ticks(case, at_rest + by_plant)
    return out


def _sticking(case: Case, fit: Fit | None) -> Float64Array:
    """(k, n) 1.0 where a joint sticks."""
    run = case.run
    resting = np.abs(run.v) < RESTING
    on_the_way = stuck(run)
    out = np.zeros_like(run.q)
    for i in range(case.n):
        if on_the_way is not None and not np.isnan(on_the_way[0, i]):
            moving = np.abs(case.moving_reference[:, i]) > 0.0
            held = (on_the_way[:, i] > 0.0) & (case.off[:, i] > 0.0)
            if held.sum() >= STUCK * moving.sum():
                out[:, i] = held
        if _held_at_the_end(case, fit, i, resting[:, i]):
            out[:, i] = np.maximum(out[:, i], np.cumprod(resting[::-1, i])[::-1])
    return out


def _held_at_the_end(case: Case, fit: Fit | None, i: int, resting: Array) -> bool:
    run, end = case.run, tail(case.run)
    if case.error is None or np.any(np.abs(case.moving_reference[end]) > 0.0) or not resting[end].all():
        return False
    if abs(float(case.error[end, i].mean())) <= case.tolerance[i]:
        return False
    if resting.all():
        return True
    first = len(run) - int(np.cumprod(resting[::-1]).sum())
    change = float(np.ptp(case.feedback[first:, i]))
    crept = _stiffness(case, i) * np.ptp(run.q[first:, i])  # what a spring says of a joint that still moves
    if change > TORQUE_CHANGE * case.size[i] and crept < 0.5 * change:
        return True
    if fit is None or fit.coulomb[i] <= 0.0 or fit.left > UNSURE:
        return False
    carried = float(_carried(case, fit)[end, i].mean())
    load = float(case.feedback[end, i].mean()) - carried
    return abs(load) < abs(carried) <= SLACK * float(fit.coulomb[i])


def _balanced(case: Case, held: Float64Array, pushed: Float64Array) -> bool:
    """Whether what the environment gives in the direction of the feedback balances it within a fifth.

    In the measure of M^-1, in which a constraint takes nothing from what a hybrid law gives along it.
    """
    last = max(len(case.run) - 1, 0)
    inverse = np.diag(1.0 / case.size**2) if case.model is None else np.linalg.inv(case.model.mass_matrix(last))
    size = float(held @ inverse @ held)
    return size > 0.0 and bool(np.any(pushed)) and abs(1.0 + float(held @ inverse @ pushed) / size) < 0.2


def _sags(case: Case, fit: Fit | None) -> Finding | None:
    """A steady error of joints at rest that the feedback holds, whatever the load is.

    What the environment gives (F_ext) is no load: an impedance gives way to it by design, so that a joint whose
    feedback balances J^T F_ext within a fifth is left out; so are all where that of the whole arm does, and one that
    dry friction holds. Of a hybrid law it is the feedback of its motion that is looked at.
    """
    run = case.run
    bad = np.abs(case.steady_error) > case.tolerance
    if case.error is None or not bad.any():
        return None
    end = tail(run)
    held = case.feedback_of_motion[end].mean(axis=0)
    pushed = case.pushed[end].mean(axis=0)
    bad &= np.abs(held + pushed) > 0.2 * np.abs(held)
    if _balanced(case, held, pushed):
        return None
    resting = np.abs(run.v) < RESTING
    bad &= np.array([not _held_at_the_end(case, fit, i, resting[:, i]) for i in range(case.n)])
    bad &= np.abs(held) > LEAST_GRAVITY * case.size
    if case.model is not None:  # what the motion of other joints asks for is no load
        late = case.model.ticks >= end.start
        moved = np.abs((case.model.motion - case.model.gravity)[late].mean(axis=0)) if late.any() else 0.0 * held
        bad &= moved < HALF * np.abs(held)
    if not bad.any():
        return None
    i = int(np.argmax(bad * np.abs(held) / case.size))
    part = np.zeros_like(run.q)
    part[:, bad] = held[bad]
    k = _stiffness(case, i)
    joint, unit = run.joint_names[i], run.effort_units[i]
    want = abs(float(held[i])) / float(case.tolerance[i])
    sure = fit is not None and fit.left <= UNSURE
    or_friction = "" if sure else ", or where dry friction holds it: its motion does not tell which"
    integral = "" if "I" in run.terms else "; or an integral, 0 < ki < (b + kd) kp / M"
    return Finding(
        name="sags",
        term="P",
        joint=joint,
        share=case.share_of(part),
        evidence={
            "steady error": Number(float(case.steady_error[i]), run.units[i]),
            "constant load": Number(float(held[i]), unit),
            "stiffness": Number(k, f"{unit}/{run.units[i]}"),
        },
        text=f"'{joint}' rests where its spring balances a constant load that the model does not have{or_friction}",
        remedy=f"model the load of {held[i]:.3g} {unit}; or a stiffness of {want:.3g} {unit}/{run.units[i]} to bring "
        f"the error under {case.tolerance[i]:.2g} {run.units[i]}{integral}",
        picture=Picture(
            title=f"{joint}: error",
            ylabel=f"[{run.units[i]}]",
            t=run.t,
            curves={"error": case.error[:, i]},
            levels={"steady": float(case.steady_error[i]), "tolerated": float(case.tolerance[i])},
        ),
    )
