"""What to do about an oscillation, with the numbers that the run shows of it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from taut.analysis.diagnosis.case import Case
from taut.analysis.diagnosis.finding import Number
from taut.analysis.diagnosis.lines import Swing, without_trend
from taut.analysis.diagnosis.mode import Mode
from taut.base.types import Float64Array

__all__ = ["less_delay", "less_integral", "lower_gain", "more_damping"]

WANTED: Final = 0.7  # damping ratio
OWN: Final = 1e-6  # of D in squares that is no multiple of the joint's own speed: rounding


def _slope(y: Float64Array, x: Float64Array) -> float:
    """Least squares of y = k x, both about their trends."""
    y, x = without_trend(y[:, np.newaxis])[:, 0], without_trend(x[:, np.newaxis])[:, 0]
    return float(np.sum(y * x) / max(float(np.sum(x * x)), np.finfo(np.float64).tiny))


def _stiff_and_damped(case: Case, found: Swing) -> tuple[float, float, float]:
    """Stiffness, damping and inertia of a joint in its oscillation: k = -P / q, d = -D / v, m = k / omega^2."""
    run, i, w = case.run, found.joint, found.window
    k = -_slope(run.terms["P"][w, i], run.q[w, i]) if "P" in run.terms else 0.0
    d = -_slope(run.terms["D"][w, i], run.v[w, i]) if "D" in run.terms else 0.0
    if case.model is not None:
        return k, d, float(case.model.inertia_felt(w.start)[i])
    return k, d, abs(k) / found.line.omega**2


def _of_own_speed(case: Case, found: Swing) -> bool:
    """Whether a joint's damping answers its own speed alone, and no other's."""
    run, i, w = case.run, found.joint, found.window
    if "D" not in run.terms:
        return False
    d, v = (without_trend(x[w, i : i + 1])[:, 0] for x in (run.terms["D"], run.v))
    return float(np.sum((d - _slope(d, v) * v) ** 2)) <= OWN * float(np.sum(d**2))


def _units(case: Case, found: Swing) -> str:
    return f"{case.run.effort_units[found.joint]} s/{case.run.units[found.joint]}"


def _turned_round(case: Case, found: Swing, d: float) -> str:
    """Of damping that drives."""
    joint = case.run.joint_names[found.joint]
    return f"turn the sign of the damping round: that of '{joint}' is {d:.3g} {_units(case, found)}, which drives it"


def more_damping(case: Case, found: Swing) -> str:
    """The damping of zeta = 0.7, for the stiffness and inertia that the swing shows.

    Of a mode with the stiffness k and the damping d, over its inertia, zeta = d / (2 sqrt(k)): all gains of damping
    times 0.7 / zeta give it. Where there is none, that of the joint alone.
    """
    joint, units = case.run.joint_names[found.joint], _units(case, found)
    mode = Mode(case=case, found=found)
    k, d, m = _stiff_and_damped(case, found)
    if mode.damping < 0.0 and d < 0.0:
        return _turned_round(case, found, d)
    if mode.stiffness > 0.0 and mode.damping > 0.0 and d > 0.0:
        times = 2.0 * WANTED * math.sqrt(mode.stiffness) / mode.damping
        if times <= 1.0:
            return "raise the damping (kd, B or zeta), or take away what brings work into this oscillation"
        return (
            f"raise the damping {Number(times)} times (kd, B or zeta), that of '{joint}' from {d:.3g} to "
            f"{times * d:.3g} {units} for zeta = {WANTED:g}"
        )
    if k <= 0.0 or m <= 0.0:
        return "raise the damping (kd, B or zeta); it does next to no work on this oscillation"
    return (
        f"raise the damping of '{joint}' from {max(d, 0.0):.3g} to {2.0 * WANTED * math.sqrt(k * m):.3g} {units} for "
        f"zeta = {WANTED:g}"
    )


def less_integral(case: Case, found: Swing) -> str:
    """The bound of the integral, (b + kd) kp / M, whatever the swing is: it is that of the gains and the arm."""
    run, i, w = case.run, found.joint, found.window
    mode = Mode(case=case, found=found)
    if case.error is None:
        return "lower ki: the integral feeds this oscillation"
    rate = _slope(np.diff(run.terms["I"][w, i]) / case.dt, case.error[w, i][1:])
    if case.model is None:
        k, d, _ = _stiff_and_damped(case, found)
        m = _moved(case, found)
        bound = max(d, 0.0) * k / m if m > 0.0 else 0.0
    else:
        part = (max(mode.friction, 0.0) + max(mode.damping, 0.0)) * mode.stiffness / mode.integral
        bound = rate * part if mode.integral > 0.0 else 0.0
        if rate <= 0.0 < part:
            return f"lower ki, to {0.5 * part:.2g} of what it is: then it is half of its bound, (b + kd) kp / M"
    if not (rate > 0.0 and bound > 0.0):
        return "lower ki: the integral feeds this oscillation"
    units = f"{run.effort_units[i]}/({run.units[i]} s)"
    return (
        f"lower ki, to {0.5 * bound / rate:.2g} of what it is for half of its bound: at '{run.joint_names[i]}' it is "
        f"{Number(rate)} {units}, and it must stay under (b + kd) kp / M = {Number(bound)}"
    )


def _moved(case: Case, found: Swing) -> float:
    """The inertia of M s^3 + d s^2 + k s + ki = 0 at the s of the oscillation, where no model tells it."""
    run, i, w = case.run, found.joint, found.window
    k, d, _ = _stiff_and_damped(case, found)
    s = complex(found.line.growth, found.line.omega)
    ki = 0.0 if case.error is None else _slope(np.diff(run.terms["I"][w, i]) / case.dt, case.error[w, i][1:])
    return float((-(d * s**2 + k * s + ki) / s**3).real)


def less_delay(case: Case, found: Swing) -> str:
    """What the phase between command and torque says of the delay, and what it allows."""
    mode, joint = Mode(case=case, found=found), case.run.joint_names[found.joint]
    _, d, m = _stiff_and_damped(case, found)
    most = math.pi / (6.0 * (mode.late + 0.5 * case.dt))
    times = most / mode.damping if mode.damping > 0.0 else most * m / d if mode.M is None and d > 0.0 else math.inf
    slow = f"the drives give the torque {1e3 * mode.late:.3g} ms late: make them faster, or lower "
    if not times < 1.0:
        return f"{slow}kp and kd of '{joint}', or what else feeds this oscillation late"
    of_joint = f", that of '{joint}' from {d:.3g} to {times * d:.3g} {_units(case, found)}" if d > 0.0 else ""
    return (
        f"{slow}the damping to {times:.2g} of what it is{of_joint} (60 deg of phase margin), and kp to {times**2:.2g}"
    )


def lower_gain(case: Case, found: Swing, term: str) -> str:
    """What a sampled loop bears of the gain that feeds a swing."""
    run, i = case.run, found.joint
    _, d, m = _stiff_and_damped(case, found)
    mode = Mode(case=case, found=found)
    if term != "D" or case.model is None:
        return (
            f"lower the gain of {term} to a half, or raise the rate from {run.rate:g} Hz: it feeds this oscillation"
        )
    most, now = 2.0 / case.dt, mode.damping_in_all
    if now < 0.0 and d < 0.0:
        return _turned_round(case, found, d)
    beyond = now / most
    own = _of_own_speed(case, found) and d > 2.0 * m / case.dt
    if own:
        beyond = max(beyond, d / (2.0 * m / case.dt))
    lower = f"lower kd to {min(0.5, 0.5 / beyond):.2g} of what it is" if beyond > 0.0 else "lower kd to a half"
    less = "less with a filter or differenced velocities"
    if own:
        return (
            f"{lower}, or raise the rate: the damping of '{run.joint_names[i]}' is {d:.3g}, and a sampled loop "
            f"bears 2 M / T = {2.0 * m / case.dt:.3g} {_units(case, found)} at most, {less}"
        )
    if not now > most:
        return f"{lower}, or raise the rate from {run.rate:g} Hz: it feeds this oscillation"
    return (
        f"{lower}, or raise the rate: it is {Number(now)} 1/s of the inertia that it moves, and a sampled loop bears "
        f"2 / T = {Number(most)} 1/s at most, {less}"
    )
