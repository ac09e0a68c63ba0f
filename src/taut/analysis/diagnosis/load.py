"""What feedback carries that it should not: gravity, payloads, dry friction, constant loads."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Final

import numpy as np

from taut.analysis.diagnosis.case import Case, tail
from taut.analysis.diagnosis.finding import Finding, Number, Picture, in_parts
from taut.analysis.diagnosis.fit import KNOWN, Fit
from taut.analysis.diagnosis.phases import SHORT
from taut.base.types import Array, Float64Array
from taut.record.metrics import RESTING, stuck

__all__ = ["load_findings"]

HALF: Final = 0.5  # of gravity: who gives more of it compensates it
LEAST_LOAD: Final = 0.05  # of the largest gravity torque: a smaller payload is none
NOTHING: Final = 0.01  # of the mass that is missing: what is left of it is none
LEAST_SHARE: Final = 0.05  # of the feedback, that gravity which is given twice is
LEAST_GRAVITY: Final = 0.01  # of the effort: arms with less have no gravity to speak of
SLACK: Final = 1.5  # times the friction fitted in motion: static friction, and what the fit misses
TORQUE_CHANGE: Final = 0.01  # of the effort: a free joint would have moved
UNSURE: Final = 0.1  # of the residual, in squares: where a fit leaves more, its friction is none to go by
OFTEN: Final = 0.05  # of the end of a run, in which a limit cuts
STUCK: Final = 0.1  # of the time in which its reference moves; a rest after each reversal is less


def load_findings(case: Case) -> Iterator[Finding]:
    """Gravity, payload, friction and whatever else feedback carries at rest or along the motion."""
    if not case.of_torque or case.in_contact or len(case.run) < SHORT:
        return
    fit = case.fit
    of_load = None if fit is None else _load(case, fit)
    if of_load is not None:
        yield of_load
    beyond = _beyond(case, fit, of_load)
    sticks = _sticks(case, fit, beyond)
    if sticks is not None:
        if of_load is not None and not _carries(case, of_load.name)[case.run.joint_names.index(str(sticks.joint))]:
            sticks = dataclasses.replace(sticks, apart=frozenset({of_load.name}))
        yield sticks
    sags = None if of_load is not None else _sags(case, fit, beyond)
    if sags is not None:
        yield sags


def _carries(case: Case, name: str) -> Array:
    """(n,) whether a load that was found is half and more of what a joint's feedback holds at the end of the run."""
    assert case.model is not None
    assert case.fit is not None
    load = case.model.gravity if name == "gravity not compensated" else case.fit.load
    end = tail(case.run)
    held = np.abs(case.feedback[end].mean(axis=0))
    return np.asarray(np.abs(_at_ticks(case, load)[end].mean(axis=0)) >= HALF * held)


# -------------------------------------------------------------------- gravity and payload


def _load(case: Case, fit: Fit) -> Finding | None:
    """Gravity twice, gravity not at all, or another payload.

    tau + J^T F_ext - (M a + C v + g) is what acted beyond the model. It is fitted by part of -g (somebody else gives
    gravity), by a payload, and by friction, see `fit_of`; a load has to explain all but 2 % of what friction leaves,
    a payload with a centre of its own all but half a percent. The law compensates gravity where its terms hold more
    than half of g.
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
    by_plant = fit.gravity if fit.kind == "gravity" and fit.holds else 0.0
    if by_law >= HALF and by_plant >= HALF:
        return _gravity_twice(case, by_law, by_plant, -fit.load)
    if by_law < HALF and by_plant < HALF:
        return _no_gravity(case, by_law, g)
    heavy = float(np.abs(fit.load / case.size).max()) >= LEAST_LOAD * largest
    if by_law >= HALF and fit.kind == "payload" and fit.holds and heavy:
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


def _gravity_twice(case: Case, by_law: float, by_plant: float, g: Float64Array) -> Finding | None:
    """Feedback carries it; where friction would have to, there is none of it."""
    load = _at_ticks(case, -g)
    i = _worst(case, load)
    if case.share_of(load) < LEAST_SHARE:
        return None
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
    bad = (left > case.tolerance) & _carries(case, "gravity not compensated")  # dry friction may hold the others
    i = int(np.argmax(left / case.tolerance * (bad if bad.any() else 1.0)))
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
    told = fit.told
    beyond = fit.mass - told
    when = "" if fit.taken is None else f", from {fit.taken:.3g} s on"
    when = when if fit.dropped is None else f", until {fit.dropped:.3g} s"
    then = " then" if when else ""
    centre: dict[str, Number] = {}
    call, more, and_centre = f"arm.with_payload({fit.mass:.3g})", "", ""
    if fit.mass <= NOTHING * abs(beyond):
        call = "arm.with_payload(0)"
    else:
        centre = {f"centre {axis}": Number(float(x), "m") for axis, x in zip("xyz", fit.centre, strict=True)}
        values, ways = np.linalg.eigh(fit.centre_error)
        blur = np.sqrt(np.maximum(values, 0.0))
        centre["standard error of the centre"] = Number(float(blur.max()), "m")
        if np.linalg.norm(fit.centre) > 1e-3:
            call = f"arm.with_payload({fit.mass:.3g}, com={_vector(fit.centre, 3)})"
            call += ", com in m in the tool frame"
            and_centre = " and ['model.payload.com']"
        more = _not_known(ways[:, blur > KNOWN].T)
    return Finding(
        name="wrong payload",
        term="gravity" if "gravity" in run.terms else "nonlinear",
        joint=run.joint_names[i],
        share=case.share_of(load),
        evidence={
            "declared": Number(told, "kg"),
            "beyond it": Number(beyond, "kg"),
            "standard error": Number(fit.mass_error, "kg"),
            "of the residual explained": Number(100.0 * fit.explained, "%"),
            **centre,
        },
        text=f"the torques are those of an arm with {beyond:+.3g} kg at its tool beyond what the law was told{when}",
        remedy=f"declare the payload{then}: {call}, or ctrl.parameters['model.payload.mass']{and_centre}{more}",
        picture=_picture(case, load, i, "payload that is not declared"),
    )


def _vector(x: Float64Array, digits: int) -> str:
    return f"({', '.join(f'{value + 0.0:.{digits}f}' for value in np.round(x, digits))})"


def _not_known(ways: Float64Array) -> str:
    """The directions of the tool frame (k, 3) in which the run does not tell where a payload's centre is."""
    if len(ways) == 0:
        return ""
    named = " and ".join(_vector(way * np.sign(way[np.argmax(np.abs(way))]), 2) for way in ways)
    return (
        f"; its centre along {named} of the tool frame is not known from this run: motion that turns the tool "
        "against its weight tells it"
    )


def _stiffness(case: Case, i: int) -> float:
    """Steady feedback over steady error of a joint [N m/rad | N/m]."""
    at = tail(case.run)
    assert case.error is not None
    return abs(float(case.feedback[at, i].mean())) / max(abs(float(case.error[at, i].mean())), 1e-300)


def _beyond(case: Case, fit: Fit | None, of_load: Finding | None) -> Float64Array:
    """(k, n) torque that neither the model nor a load that was found explains: what friction takes up at rest.

    Without a model the feedback, which then holds what the motion of other joints asks for as well.
    """
    if case.model is None or fit is None:
        return case.feedback
    known = fit.viscous * case.run.v[case.model.ticks + 1] if fit.left <= UNSURE else np.zeros_like(fit.load)
    if of_load is not None and of_load.name in ("wrong payload", "gravity twice"):
        known = known + fit.load
    return _at_ticks(case, case.model.residual - known)


def _dry(fit: Fit | None, i: int) -> float:
    """Dry friction that the motion of a joint showed [N m | N]; zero where it showed none."""
    return float(fit.coulomb[i]) if fit is not None and fit.left <= UNSURE else 0.0


def _sticks(case: Case, fit: Fit | None, beyond: Float64Array) -> Finding | None:
    """A joint that rests (|v| < 1e-4) off its target for want of torque against dry friction.

    At a set-point it rests in the last tenth of the run with an error that counts, and one of these holds: it never
    moved; its torque changed while it rested by more than 1 % of the effort; what the feedback carries beyond loads
    is within the dry friction that its motion showed. On the way it rests for a tenth of the time in which its
    reference moves, off it.
    """
    run = case.run
    at_rest = _sticking(case, fit, beyond)
    if case.error is None or not at_rest.any():
        return None
    part = beyond * at_rest
    i = int(np.argmax(np.sum((part / case.size) ** 2, axis=0)))
    share, rest = case.share_of(part), at_rest[:, i]
    held = rest > 0.0
    joint, unit = run.joint_names[i], run.effort_units[i]
    most = float(np.abs(part[held, i]).max())
    error = float(np.abs(case.error[held, i]).max())
    known = _dry(fit, i) > 0.0
    dry = _dry(fit, i) or most
    integral = "" if np.any(run.terms.get("I", np.zeros_like(run.q))[:, i]) else "an integral, "
    moves = bool(np.any(case.moving_reference))  # where a reference never does, its sign is nothing to go by
    by_reference = f"FrictionCompensation(at='ref') with {dry:.3g} {unit} of Coulomb friction, " if moves else ""
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
        remedy=f"add {by_reference}{integral}RaisedGains or a Dither; kp alone would leave up to {dry:.3g} "
        f"{unit} / kp",
        picture=Picture(
            title=f"{joint}: error, and feedback in parts of its largest (shaded: at rest)",
            ylabel="[1]",
            t=run.t,
            curves={"error": in_parts(case.error[:, i]), "feedback": in_parts(case.feedback[:, i])},
            marked=rest,
        ),
    )


def _sticking(case: Case, fit: Fit | None, beyond: Float64Array) -> Float64Array:
    """(k, n) 1.0 where a joint sticks."""
    run = case.run
    resting = np.abs(run.v) < RESTING
    on_the_way = stuck(run)
    out, creeping = np.zeros_like(run.q), np.zeros_like(run.q)
    for i in range(case.n):
        if on_the_way is not None and not np.isnan(on_the_way[0, i]):
            moving = np.abs(case.moving_reference[:, i]) > 0.0
            held = (on_the_way[:, i] > 0.0) & (case.off[:, i] > 0.0)
            if held.sum() >= STUCK * moving.sum():
                out[:, i] = held
        if _held_at_the_end(case, fit, beyond, i, resting[:, i]):
            out[:, i] = np.maximum(out[:, i], np.cumprod(resting[::-1, i])[::-1])
            creeping[tail(run), i] = 1.0
    return out if out.any() else creeping


def _held_at_the_end(case: Case, fit: Fit | None, beyond: Float64Array, i: int, resting: Array) -> bool:
    run, end = case.run, tail(case.run)
    if case.error is None or np.any(np.abs(case.moving_reference[end]) > 0.0):
        return False
    if abs(float(case.error[end, i].mean())) <= case.tolerance[i]:
        return False
    carried = float(beyond[end, i].mean())
    load = float(case.feedback[end, i].mean()) - carried
    by_friction = abs(load) < abs(carried) <= SLACK * _dry(fit, i)
    if not resting[end].all():
        return by_friction and bool(case.settled[i])  # it creeps to where friction holds it
    if by_friction or np.ptp(run.q[:, i]) <= case.tolerance[i] or not (fit is None or fit.seen[i]):
        return True  # it never moved by what counts as an error, or stopped at once, as under no constant load
    first = len(run) - int(np.cumprod(resting[::-1]).sum())
    change = float(np.ptp(case.feedback[first:, i]))
    crept = _stiffness(case, i) * np.ptp(run.q[first:, i])  # what a spring says of a joint that still moves
    return bool(change > TORQUE_CHANGE * case.size[i] and crept < 0.5 * change)


def _balanced(case: Case, held: Float64Array, pushed: Float64Array) -> bool:
    """Whether what the environment gives in the direction of the feedback balances it within a fifth.

    In the measure of M^-1, in which a constraint takes nothing from what a hybrid law gives along it.
    """
    last = max(len(case.run) - 1, 0)
    inverse = np.diag(1.0 / case.size**2) if case.model is None else np.linalg.inv(case.model.mass_matrix(last))
    size = float(held @ inverse @ held)
    return size > 0.0 and bool(np.any(pushed)) and abs(1.0 + float(held @ inverse @ pushed) / size) < 0.2


def _sags(case: Case, fit: Fit | None, beyond: Float64Array) -> Finding | None:
    """A steady error of joints at rest that the feedback holds, whatever the load is.

    What the environment gives (F_ext) is no load: an impedance gives way to it by design, so that a joint whose
    feedback balances J^T F_ext within a fifth is left out; so are all where that of the whole arm does, one that
    dry friction holds, and one whose command is cut, which its spring does not hold. Of a hybrid law it is the
    feedback of its motion that is looked at.
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
    bad &= np.array([not _held_at_the_end(case, fit, beyond, i, resting[:, i]) for i in range(case.n)])
    bad &= np.abs(held) > LEAST_GRAVITY * case.size
    bad &= ((case.cut[end] != 0.0) | (case.pinned[end] != 0.0)).mean(axis=0) < OFTEN  # else a limit balances the load
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
        remedy=f"model the load of {held[i]:.3g} {unit}; or a stiffness of {Number(want)} {unit}/{run.units[i]} to "
        f"bring the error under {case.tolerance[i]:.2g} {run.units[i]}{integral}",
        picture=Picture(
            title=f"{joint}: error",
            ylabel=f"[{run.units[i]}]",
            t=run.t,
            curves={"error": case.error[:, i]},
            levels={"steady": float(case.steady_error[i]), "tolerated": float(case.tolerance[i])},
        ),
    )
