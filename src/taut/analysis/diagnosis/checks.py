"""The checks of the doctor: their tests, and one table of their thresholds, causes and remedies."""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np

from taut.analysis.diagnosis.check import Check, ExaminedRun, Finding, Threshold
from taut.analysis.diagnosis.spectrum import chatter, oscillation
from taut.base.types import Array, Float64Array
from taut.maths.singularity import BORDER, sizes_of
from taut.record.metrics import stuck

TINY: Final = float(np.finfo(np.float64).tiny)
MIN_CONTACT_TICKS: Final = 32
MOTION_FAULTS: Final = ("wrong sign", "contact bounce")
OSCILLATIONS: Final = ("oscillation", "stick-slip", "backlash")
LOADS: Final = ("gravity compensated twice", "gravity not compensated", "wrong payload")


def wrong_sign(run: ExaminedRun) -> Finding | None:
    """P or D does negative work on its error while that grows, or a joint moves against its torque.

    Positive definite gains do positive work on all errors together; against its torque tau - (M a + h) = 2 tau.
    """
    e, limit = run.error, run.threshold
    assert e is not None
    ends = max(1, len(e) // 20)
    grown = (
        np.abs(e[-ends:]).mean(axis=0) > limit["growth of the error"] * np.abs(e[:ends]).mean(axis=0) + run.tolerance
    )
    for term, of in (("P", e), ("D", run.error_rate)):
        if of is None or term not in run.run.terms:
            continue
        value, work = run.run.terms[term], run.run.terms[term] * of
        bad = grown & (np.abs(value).max(axis=0) > 0.1 * limit["torque change"] * run.scale)
        if bad.any() and work.sum() < -limit["work against the error"] * np.abs(work).sum():
            i = int(np.argmin(np.where(bad, np.sum(work / run.scale, axis=0), np.inf)))
            unit = f"{run.run.effort_units[i]}{' s' if term == 'D' else ''}/{run.run.units[i]}"
            return run.finding(term, i, 1.0, {"gain": (_multiple(value, of)[0][i], unit)})
    if run.model is None or run.fit is None or run.fit.kind != "none":
        return None
    tau, residual = run.run.tau[run.model.ticks], run.model.residual
    bad = grown & (np.std(tau, axis=0) > limit["torque change"] * run.scale)
    for y, x in ((residual - residual.mean(axis=0), tau - tau.mean(axis=0)), (residual, tau)):
        slope, unexplained = _multiple(y, x)
        bad &= (slope > 1.5) & (unexplained < limit["unexplained"])  # 2 where it moves against its torque, else 0
    i = int(np.argmax(bad))
    return run.finding("command", i, 1.0, {"residual over torque": (slope[i], "1")}) if bad.any() else None


def _multiple(y: Array, x: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(n,) k of each column by least squares of y = k x, and the part of y in squares that it leaves."""
    k = np.sum(x * y, axis=0) / np.maximum(np.sum(x**2, axis=0), TINY)
    return k, np.sum((y - k * x) ** 2, axis=0) / np.maximum(np.sum(y**2, axis=0), TINY)


def _load(run: ExaminedRun) -> tuple[str, Float64Array]:
    """The load that the law does not compensate: name of its check or "", and its torque (k, n)."""
    fit, model, limit = run.fit, run.model, run.threshold
    none = "", np.zeros_like(run.run.q)
    if fit is None or model is None:
        return none
    g = model.gravity / run.scale
    if np.abs(g).max() < limit["torque change"]:
        return none
    terms = [run.run.terms[name] for name in ("gravity", "nonlinear", "force_nonlinear") if name in run.run.terms]
    held = np.asarray(sum(terms, np.zeros_like(run.run.q)))[model.ticks] / run.scale
    by_law = float(np.sum(held * g) / np.sum(g * g))
    load = run.at_all_ticks(model.gravity if by_law < 0.5 and fit.kind != "gravity" else fit.load)
    if by_law < 0.5:
        error = np.zeros(run.n) if run.error is None else np.sqrt(np.mean(run.error**2, axis=0))
        off = np.where(run.settled, np.abs(run.steady_error), error) > run.tolerance
        missing = fit.kind != "gravity" and run.fraction_of(load) >= 0.5 and off.any()
        return ("gravity not compensated", load) if missing else none
    if fit.kind == "gravity" and run.fraction_of(load) >= limit["part"]:
        return "gravity compensated twice", load
    heavy = np.abs(fit.load / run.scale).max() >= limit["part"] * np.abs(g).max()
    return ("wrong payload", load) if fit.kind == "payload" and heavy else none


def load(run: ExaminedRun, name: str) -> Finding | None:
    """Gravity that is compensated twice or not at all, or an undeclared payload, which the feedback then holds."""
    found, torque = _load(run)
    fit = run.fit
    if found != name or fit is None or run.model is None:
        return None
    term = "P" if name == "gravity not compensated" else "gravity" if "gravity" in run.run.terms else "nonlinear"
    i = int(np.argmax(np.sqrt(np.mean(torque**2, axis=0)) / run.scale))
    evidence = {"largest torque": (np.abs(torque[:, i]).max(), "torque")}
    if name != "wrong payload":
        evidence["gravity by the plant"] = (100.0 * fit.gravity, "%")
        return run.finding(term, i, run.fraction_of(torque), evidence)
    beyond, mass = fit.mass - run.model.payload[0], "0"
    evidence |= {
        "beyond the declared": (beyond, "kg"),
        "standard error": (np.sqrt(max(fit.covariance[0, 0], 0.0)), "kg"),
    }
    if fit.mass > 0.01 * abs(beyond):
        evidence |= {f"centre {axis}": (x, "m") for axis, x in zip("xyz", fit.centre, strict=True)}
        error = np.sqrt(np.maximum(np.linalg.eigvalsh(fit.covariance[1:, 1:])[-1], 0.0))
        evidence["standard error of the centre"] = (error, "m")
        mass = f"{fit.mass:.3g}, com=({', '.join(f'{x + 0.0:.3f}' for x in fit.centre.round(3))})"
    remedy = f"declare the payload: arm.with_payload({mass}), com in the tool frame"
    return run.finding(term, i, run.fraction_of(torque), evidence, remedy=remedy)


def _unmodelled(run: ExaminedRun) -> tuple[Float64Array, Float64Array]:
    """(k, n) torque that neither model nor load explains, which friction holds at rest; (n,) fitted dry friction."""
    fit = run.fit
    if run.model is None or fit is None:
        return run.feedback, np.zeros(run.n)
    known = float(fit.unexplained <= run.threshold["unexplained"])
    viscous = known * fit.viscous * run.run.v[run.model.ticks + 1]
    name, torque = _load(run)
    torque = torque if name in ("wrong payload", "gravity compensated twice") else np.zeros_like(torque)
    return run.at_all_ticks(run.model.residual - viscous) - torque, known * fit.coulomb


def _held_by_friction(run: ExaminedRun) -> Array:
    """(n,) joints that end off their target and are held there by dry friction.

    The torque beyond model and load is within the dry friction shown in motion; or the joint rests and hardly moved.
    """
    record, limit, end = run.run, run.threshold, run.end
    assert run.error is not None
    beyond, dry = _unmodelled(run)
    carried, feedback = beyond[end].mean(axis=0), run.feedback[end].mean(axis=0)
    by_friction = (np.abs(feedback - carried) < np.abs(carried)) & (np.abs(carried) <= limit["dry friction"] * dry)
    at_rest = run.resting[end].all(axis=0)
    still = at_rest & (np.ptp(record.q, axis=0) <= run.tolerance)
    still |= at_rest & (False if run.fit is None else ~run.fit.moved)
    off = np.abs(run.error[end].mean(axis=0)) > run.tolerance
    at_target = np.any(run.reference_speed[end]) | ~off
    return np.asarray(~at_target & (still | (by_friction & (at_rest | run.settled))))


def stiction(run: ExaminedRun) -> Finding | None:
    """Dry friction holds a joint off its target: at the end of the run, or for a tenth of the commanded motion."""
    record, (beyond, dry), ended = run.run, _unmodelled(run), _held_by_friction(run)
    assert run.error is not None
    held = ended & (np.cumprod(run.resting[::-1], axis=0)[::-1] > 0)
    on_the_way = stuck(record)
    if on_the_way is not None:
        stops = (on_the_way > 0.0) & run.off_target
        moving = np.sum(np.abs(run.reference_speed) > 0.0, axis=0)
        held |= stops & (stops.sum(axis=0) >= np.maximum(run.threshold["at rest"] * moving, 1.0))
    if not held.any():
        held[run.end] |= ended  # it still creeps
    if not held.any():
        return None
    i = int(np.argmax(np.sum((beyond * held / run.scale) ** 2, axis=0)))
    rest = held[:, i]
    evidence = {
        "time at rest": (rest.sum() * run.dt, "s"),
        "error": (np.abs(run.error[rest, i]).max(), "joint"),
        "torque without motion": (np.abs(beyond[rest, i]).max(), "torque"),
        **({"fitted dry friction": (dry[i], "torque")} if dry[i] > 0.0 else {}),
    }
    fraction = run.fraction_of(beyond * held)
    if fraction < run.threshold["effect"]:
        return None
    return run.finding("friction", i, fraction, evidence)


def steady_state_error(run: ExaminedRun) -> Finding | None:
    """A joint settles off its target, held by the feedback against a constant load that nothing else explains.

    Not a load are a push by the environment (an impedance yields to it), a cut command, and stiction.
    """
    end, limit = run.end, run.threshold
    held, pushed = run.feedback[end].mean(axis=0), run.external[end].mean(axis=0)
    balance = np.sum(held * pushed / run.scale**2) / max(np.sum((held / run.scale) ** 2), TINY)
    if _load(run)[0] or abs(1.0 + balance) < 0.2:
        return None
    bad = (np.abs(run.steady_error) > run.tolerance) & (np.abs(held + pushed) > 0.2 * np.abs(held))
    bad &= (np.abs(held) > limit["torque change"] * run.scale) & ~_held_by_friction(run)
    bad &= np.mean([np.any(cut[end], axis=0) for cut in run.cuts.values()] or [0.0], axis=0) < limit["part"]
    if run.model is not None:  # what the motion of other joints needs is no constant load
        needed = run.at_all_ticks(run.model.motion - run.model.gravity)[end].mean(axis=0)
        bad &= np.abs(needed) < 0.5 * np.abs(held)
    if not bad.any():
        return None
    i = int(np.argmax(bad * np.abs(held) / run.scale))
    stiffness = f"{run.run.effort_units[i]}/{run.run.units[i]}"
    evidence = {
        "steady-state error": (run.steady_error[i], "joint"),
        "constant load": (held[i], "torque"),
        "stiffness": (abs(held[i] / run.steady_error[i]), stiffness),
    }
    return run.finding("P", i, run.fraction_of(np.zeros_like(run.run.q) + np.where(bad, held, 0.0)), evidence)


def saturation(run: ExaminedRun) -> Finding | None:
    """A limit of the controller or of the drives cuts the command while there is an error above the tolerance."""
    record, taken = run.run, {}
    for name, cut in run.cuts.items():
        acting = (cut != 0.0) & run.off_target
        if acting.mean(axis=0).max() >= run.threshold["part"]:
            taken[name] = np.sum((cut * acting / run.scale) ** 2, axis=0)
    if not taken:
        return None
    term = max(taken, key=lambda name: float(taken[name].sum()))
    i = int(np.argmax(taken[term]))
    acting = (run.cuts[term][:, i] != 0.0) & run.off_target[:, i]
    applied = (record.tau if term == "torque" else record.command)[:, i]
    evidence = {
        "time cut": (100.0 * acting.mean(), "% of the run"),
        "applied": (np.abs(applied).max(), record.command_units[i]),
    }
    return run.finding(term, i, taken[term].sum() / run.effort, evidence)


def wind_up(run: ExaminedRun) -> Finding | None:
    """The integral grows in the direction of a cut, holds half of it at the target, and carries the joint past it."""
    record, error, best, largest = run.run, run.error, None, 0.0
    if "I" not in record.terms or error is None:
        return None
    integral, cut = record.terms["I"], np.asarray(sum(run.cuts.values(), np.zeros_like(record.q)))
    for i in range(run.n):
        above = np.flatnonzero(run.off_target[:, i])
        first = int(above[0]) if len(above) else len(record) - 1
        sign = float(np.sign(error[first, i]))
        past = np.flatnonzero(sign * error[first:, i] < 0.0)
        if not len(past):
            continue
        at = first + int(past[0])
        rises = np.maximum(np.diff(integral[first : at + 1, i]) * sign, 0.0)
        gained = float(np.sum(rises * (sign * cut[first + 1 : at + 1, i] < 0.0)))
        overshoot = float(np.max(-sign * error[at:, i]))
        enough = gained >= run.threshold["effect"] * np.abs(run.feedback[:, i]).max()
        kept = overshoot > run.tolerance[i] and sign * integral[at, i] >= 0.5 * gained
        if enough and kept and gained / run.scale[i] > largest:
            largest, best = gained / run.scale[i], (i, gained, overshoot)
    if best is None:
        return None
    i, gained, overshoot = best
    evidence = {"gained while cut": (gained, "torque"), "overshoot": (overshoot, "joint")}
    fraction = run.energy(integral * (np.arange(run.n) == i)) / run.effort
    return run.finding("I", i, fraction, evidence)


def effort_exceeded(run: ExaminedRun) -> Finding | None:
    """Joint torques above the effort limit of the arm, which only a simulation without limits gives."""
    ratio = np.abs(run.run.tau) / run.arm_effort
    over = ratio > 1.0 + 1e-9
    if (over.sum(axis=0) < 3).all():  # a drive may give a peak
        return None
    i = int(np.argmax(ratio.max(axis=0)))
    evidence = {
        "largest torque": (np.abs(run.run.tau[:, i]).max(), "torque"),
        "effort limit": (run.arm_effort[i], "torque"),
    }
    fraction = np.sum(np.where(over, ratio - 1.0, 0.0) ** 2) / run.effort
    return run.finding("command", i, fraction, evidence)


def torque_jump(run: ExaminedRun) -> Finding | None:
    """The feedback starts with a quarter of the effort limit, and half of all that it ever gives."""
    record, feedback = run.run, np.abs(run.feedback) / run.scale
    bad = (feedback[0] >= run.threshold["jump"]) & (feedback[0] >= 0.5 * feedback.max(axis=0))
    if not bad.any() or ("blend" in record.terms and np.any(record.terms["blend"][0])):
        return None
    i = int(np.argmax(bad * feedback[0]))
    below = np.flatnonzero(feedback[:, i] < 0.5 * feedback[0, i])
    end = int(below[0]) if below.size else len(record)
    part = np.where(bad & (np.arange(len(record)) < end)[:, np.newaxis], run.feedback, 0.0)
    evidence = {
        "jump": (run.feedback[0, i], "torque"),
        "relative to the effort limit": (100.0 * feedback[0, i], "%"),
    }
    term = max(run.feedback_terms, key=lambda name: abs(run.feedback_terms[name][0, i]))
    return run.finding(term, i, run.fraction_of(part), evidence, window=slice(0, max(64, 2 * end)))


def singularity(run: ExaminedRun) -> Finding | None:
    """The smallest singular value of J falls below the laws' limit, and the law or a joint's speed shows it."""
    if not run.of_task:
        return None
    record, sigma = run.run, run.run.task.min_singular_value
    border = BORDER * min(1.0, run.length / 0.9) if run.model is None else sizes_of(run.model.arm).border
    near = sigma < border
    if not near.any():
        return None
    energy = np.sum((run.feedback / run.scale) ** 2, axis=1)
    given_up = {
        name: run.energy(record.terms[name][near]) for name in ("singularity", "reach") if name in record.terms
    }
    term = max(given_up, key=lambda name: given_up[name], default="P")
    speed_limit = record.info.limits.get("velocity", {})
    used = np.abs(record.v) / np.array([speed_limit.get(joint, np.inf) for joint in record.joint_names])
    fast = used[near].max() > 1.0 >= used[~near].max(initial=0.0)
    if not given_up.get(term, 0.0) > 1e-3 * float(energy[near].sum()):
        if not fast:
            return None
        term = "feedforward" if fast and "feedforward" in record.terms else "P"
    k = int(np.argmin(sigma))
    i = int(np.argmax((used[near] if fast else np.abs(run.feedback[near]) / run.scale).max(axis=0)))
    evidence = {
        "smallest singular value": (sigma[k], "1"),
        "limit": (border, "1"),
        "time": (record.t[k], "s"),
    }
    fraction = energy[near].sum() / run.effort
    return run.finding(term, i, fraction, evidence, signals={"smallest singular value of J": sigma})


def wrong_surface(run: ExaminedRun) -> Finding | None:
    """In contact, phi of a hybrid law's constraint is not zero, unless the law estimates the surface's normal."""
    record, limit = run.run, run.threshold
    laws = [name.removesuffix(".phi") for name, phi in record.extra.items() if name.endswith(".phi")]
    laws = [law for law in laws if not np.isnan(record.extra[f"{law}.phi"]).any()]
    if len(laws) != 1 or not run.presses or f"{laws[0]}.normal" in record.extra:
        return None
    phi = record.extra[f"{laws[0]}.phi"].reshape(len(record), -1)
    contact = record.extra.get(f"{laws[0]}.lost", np.zeros(len(record))) == 0.0
    if "one_sided" in record.terms:
        force = record.extra.get("F_ext", np.zeros((len(record), 6)))[:, :3]
        contact &= np.linalg.norm(force, axis=1) > limit["contact force"]
    if contact.sum() < MIN_CONTACT_TICKS:
        return None
    rms = np.sqrt(np.mean(phi[contact] ** 2, axis=0))
    row = int(np.argmax(rms))
    forces = [value for name, value in run.feedback_terms.items() if name.startswith("force_")]
    fraction = run.energy(np.asarray(sum(forces, np.zeros_like(record.q)))) / run.effort
    if rms[row] < limit["phi"] or ("one_sided" not in record.terms and fraction < limit["effect"]):
        return None
    p, y = record.task.p[contact], phi[contact, row]
    slope = np.linalg.norm(np.linalg.lstsq(p - p.mean(axis=0), y - y.mean(), rcond=0.2)[0])
    straight = phi.shape[1] == 1 and np.linalg.norm(np.ptp(p, axis=0)) > 0.02 and slope < 0.8  # a stroke of 2 cm
    evidence = {
        "RMS of phi": (rms[row], "m | rad"),
        **({"tilt along the path": (np.degrees(np.arcsin(slope)), "deg")} if straight else {}),
    }
    return run.finding("constraint", None, fraction, evidence, signals={"phi [m | rad]": phi[:, row]})


def contact_bounce(run: ExaminedRun) -> Finding | None:
    """While a law presses, the contact opens again and again."""
    record, limit = run.run, run.threshold
    column = next((name for name in ("contact.normal_force", "F_ext") if name in record.extra), None)
    if column is None or not run.presses:
        return None
    force = np.linalg.norm(record.extra[column][:, :3], axis=1)
    ticks = np.flatnonzero(force > limit["contact force"])
    if len(ticks) < MIN_CONTACT_TICKS:
        return None
    window = slice(int(ticks[0]), int(ticks[-1]) + 1)
    mean = force[window].mean()
    is_open = force < 0.1 * mean
    openings = int(np.sum(is_open[window][1:] & ~is_open[window][:-1]))
    if is_open[window].mean() < limit["part"]:
        return None
    evidence = {
        "openings": (openings / ((window.stop - window.start) * run.dt), "1/s"),
        "mean force": (mean, "N"),
        "largest force": (force.max(), "N"),
    }
    shown = {"contact force [N]": force}
    return run.finding(
        "contact", None, is_open[window].mean(), evidence, of="the time in contact", signals=shown, window=window
    )


def late_periods(run: ExaminedRun) -> Finding | None:
    """Periods that are longer than the controller was compiled for."""
    rate, limit = run.run.rate, run.threshold
    periods = np.diff(run.run.t, prepend=run.run.t[0] - run.dt) * rate
    late = periods > limit["period"]
    if late.mean() < limit["effect"]:
        return None
    evidence = {
        "late": (100.0 * late.mean(), "% of the periods"),
        "longest": (1e3 * periods.max() / rate, "ms"),
        "nominal": (1e3 / rate, "ms"),
        "sustainable rate": (rate / np.quantile(periods, 0.99), "Hz"),
    }
    signals = {"period [ms]": 1e3 * periods / rate}
    return run.finding("period", None, late.mean(), evidence, of="the periods", signals=signals)


SHARED: Final = (
    Threshold("ticks", 16, "ticks", "fewer show nothing but that a loop left its limits"),
    Threshold("duration", 0.2, "s", "a shorter run has no end that it settles at, and too few poses for a fit"),
    Threshold("error", 0.02, "of the commanded motion", "the 2 % band of a settling time"),
    Threshold("error at the tool", 1e-3, "m", "a millimetre at the tool of a stretched arm"),
    Threshold("effect", 0.01, "of the feedback effort", "what explains less is not why a run is as it is"),
    Threshold("part", 0.05, "of gravity, of the work on an oscillation, of time", "less is an error of the model"),
    Threshold("torque change", 0.01, "of the effort limit", "a torque that changes less does not move a joint"),
    Threshold("model accuracy", 0.01, "of the largest gravity torque", "of a well-known arm"),
    Threshold("explained by the load", 0.995, "of the squares", "a payload comes near to a heavier link too"),
    Threshold("centre of mass", 0.25, "of the arm's length", "a load further from the tool is not at the tool"),
    Threshold("unexplained", 0.1, "of the squares", "a fit that leaves more says nothing of signs and friction"),
    Threshold("dry friction", 1.5, "of the fitted one", "static friction is larger than that of motion"),
    Threshold("contact force", 1.0, "N", "noise and inertia of the tool measure less"),
)
"""Thresholds that several checks share."""

CHECKS: Final = (
    Check(
        name="wrong sign",
        test=wrong_sign,
        needs=("torque", "error"),
        thresholds=(
            Threshold("growth of the error", 3.0, "of its start", "a corrected error does not grow threefold"),
            Threshold("work against the error", 0.6, "of its size", "positive gains do positive work unless late"),
        ),
        cause="{term} acts in the wrong direction at '{joint}', and the error grows",
        remedy={
            "P": "reverse the sign of the error: e = desired - actual, tau = + kp e",
            "D": "reverse the sign of the damping: tau = + kd (v_desired - v)",
            "command": "reverse the sign of the torque of '{joint}', or of its encoder, in the drive",
        },
    ),
    Check(
        name="oscillation",
        test=partial(oscillation, kind="oscillation"),
        needs=("torque",),
        thresholds=(
            Threshold("damping ratio", 0.1, "1", "below it a decay to 2 % takes more than six periods"),
            Threshold("part of the variance", 0.5, "1", "of the feedback of a joint that is one sinusoid"),
            Threshold("frequency", 0.3, "rad per period", "below it the sampling does not matter"),
        ),
        cause="the feedback of '{joint}' oscillates, and {term} is responsible",
        remedy={
            "D": "lower the damping (kd, B or zeta) or raise the rate: the damping itself feeds it",
            "I": "lower ki: it must stay below (b + kd) kp / M",
            "delay": "the drives apply the torque late: make them faster, or lower kd and kp",
            "transmission": "the joint yields between motor and link: lower kd and kp, or measure at the motor",
            "torque": "demand less than the drives' limit: what it takes away comes late",
            "": "lower the gain of {term}, or raise the rate",
        },
        follows=(*MOTION_FAULTS, "late periods", "singularity"),
    ),
    Check(
        name="stick-slip",
        test=partial(oscillation, kind="stick-slip"),
        needs=("torque",),
        thresholds=(
            Threshold("at rest", 0.1, "of the time", "a rest after each reversal of a reference is shorter"),
        ),
        cause="'{joint}' sticks until the feedback breaks it away, and then overshoots",
        remedy={
            "friction": "take FrictionCompensation(at='ref') with the true friction, a Dither, or more damping",
            "I": "lower ki, stop the integral within the tolerance, or add FrictionCompensation(at='ref')",
        },
        follows=MOTION_FAULTS,
    ),
    Check(
        name="backlash",
        test=partial(oscillation, kind="backlash"),
        needs=("torque",),
        thresholds=(Threshold("third harmonic", 0.1, "of the first", "of the acceleration: a spring gives less"),),
        cause="the link of '{joint}' moves freely between two teeth in each cycle",
        remedy="lower kp (its bound is 2 friction / backlash), measure at the motor, or preload the gear",
        follows=MOTION_FAULTS,
    ),
    Check(
        name="chatter",
        test=chatter,
        needs=("length", "torque"),
        thresholds=(
            Threshold("band", 0.05, "of the rate", "faster than any motion that a loop controls"),
            Threshold("torque rate", 10.0, "effort limits per second", "what Limits.of(arm, rate=True) allows"),
        ),
        cause="the torque of '{joint}' has {total variation} of noise above {lowest frequency}",
        remedy={
            "D": "low-pass the velocity, sensing=taut.Sensing(velocity=taut.sensors.Difference(cutoff=...)), take a "
            "finer encoder, or lower kd",
            "friction": "take FrictionCompensation(at='ref'), or a larger width",
            "": "low-pass what {term} is computed from, or lower its gain",
        },
        follows=(*MOTION_FAULTS, "singularity", "saturation"),
    ),
    Check(
        name="gravity compensated twice",
        test=partial(load, name="gravity compensated twice"),
        needs=("length", "torque", "model"),
        cause="the plant compensates gravity itself, and the law does so again: the feedback holds the difference",
        remedy="compile with adds=plant.adds (or adds={{'gravity'}}), or take a law without gravity, such as PID",
        follows=("wrong sign",),
    ),
    Check(
        name="gravity not compensated",
        test=partial(load, name="gravity not compensated"),
        needs=("length", "torque", "model", "error"),
        cause="neither law nor plant compensates gravity: the feedback of '{joint}' holds {largest torque}",
        remedy="take GravityPID or ComputedTorque, or add an integral, ki > 0",
        follows=("wrong sign",),
    ),
    Check(
        name="wrong payload",
        test=partial(load, name="wrong payload"),
        needs=("length", "torque", "model"),
        cause="the torques are those of an arm with {beyond the declared} at its tool beyond the declared payload",
        remedy="",
        follows=("wrong sign",),
    ),
    Check(
        name="stiction",
        test=stiction,
        needs=("length", "torque", "error"),
        cause="dry friction holds '{joint}' at rest off its target, against {torque without motion}",
        remedy="add FrictionCompensation(at='ref') where the reference moves, an integral, RaisedGains or a Dither",
        follows=(*MOTION_FAULTS, *OSCILLATIONS, *LOADS, "wrong surface"),
    ),
    Check(
        name="steady-state error",
        test=steady_state_error,
        needs=("length", "torque", "error"),
        cause="'{joint}' settles {steady-state error} off its target, where the feedback balances a constant load of "
        "{constant load} that the model does not have (where the motion shows no friction, that may be it)",
        remedy="model the load, raise the stiffness above {stiffness}, or add 0 < ki < (b + kd) kp / M",
        follows=(*MOTION_FAULTS, *OSCILLATIONS, "stiction", "wrong surface"),
    ),
    Check(
        name="wind-up",
        test=wind_up,
        needs=("error",),
        cause="the integral of '{joint}' grows by {gained while cut} while the command is cut, and carries the joint "
        "{overshoot} past its target",
        remedy="Integral(anti_windup='clamping') in the law, or a motion within the limits",
        follows=(*MOTION_FAULTS, "oscillation", "stick-slip", "wrong surface"),
    ),
    Check(
        name="saturation",
        test=saturation,
        cause="the {term} cuts the command of '{joint}' to {applied} for {time cut}, while it is off its target",
        remedy={
            "torque_limit": "demand less acceleration or load, or take an arm or gains that need less torque",
            "rate_limit": "follow a trajectory of bounded jerk, or raise tau_dot to what the drives allow",
            "speed_limit": "give the motion more time, or raise v to what the joints allow",
            "torque": "give the controller the limits of the drives, limits=taut.Limits(tau=...), and demand less",
        },
        follows=(*MOTION_FAULTS, *("late periods", "singularity", "oscillation", "backlash", "wind-up", "chatter")),
    ),
    Check(
        name="effort limit exceeded",
        test=effort_exceeded,
        needs=("torque",),
        cause="'{joint}' receives up to {largest torque}, beyond the arm's effort limit of {effort limit}",
        remedy="compile with limits=taut.Limits.of(arm), and demand less until they do not cut",
        follows=(
            *(*MOTION_FAULTS, *LOADS, *OSCILLATIONS, "stiction", "steady-state error"),
            *("saturation", "wind-up", "torque jump at the start", "singularity"),
        ),
    ),
    Check(
        name="torque jump at the start",
        test=torque_jump,
        needs=("torque", "effort"),
        thresholds=(
            Threshold("jump", 0.25, "of the effort limit", "25 ms of the rate that Limits.of(arm, rate=True) allows"),
        ),
        cause="the feedback of '{joint}' starts with {jump}, {relative to the effort limit} of its effort limit",
        remedy="start the reference where the arm is (a trajectory from the measured position), lower the gains, or "
        "limit the change of the torque with limits=taut.Limits(blend=...)",
        follows=(*MOTION_FAULTS, "singularity"),
    ),
    Check(
        name="singularity",
        test=singularity,
        cause="the smallest singular value of J is {smallest singular value} at {time}: a singularity is near",
        remedy="plan the path where it stays above {limit}, use singularity='robust', or take a law of joint space "
        "(via_joint_space) for this part",
        follows=("wrong sign",),
    ),
    Check(
        name="wrong surface",
        test=wrong_surface,
        thresholds=(Threshold("phi", 2e-3, "m | rad", "a fifth of what a hybrid law tolerates at its start"),),
        cause="the surface is not where the law states it, or it yields: in contact phi has an RMS of {RMS of phi}",
        remedy="state the constraint where the tool touches, take NormalEstimate(law=...), or lower the gains",
        follows=("wrong sign",),
    ),
    Check(
        name="contact bounce",
        test=contact_bounce,
        cause="the contact opens {openings}, with forces up to {largest force} for {mean force} on average",
        remedy="lower kfp and kfi, raise kdamp, or press with a compliant tool; in MuJoCo give the surface "
        'priority="1" solimp="0 0.9 0.002 0.5 1", so that its force grows with the depth',
        follows=("wrong sign",),
    ),
    Check(
        name="late periods",
        test=late_periods,
        thresholds=(Threshold("period", 1.5, "of the nominal", "what a loop tolerates now and then"),),
        cause="{late} are late, the longest is {longest} for {nominal}",
        remedy="compile for {sustainable rate}, or give the loop a core and a real-time priority of its own",
    ),
)
"""The checks of `taut.doctor`, in the order in which they are made."""
