"""What to do about an oscillation, with the numbers that the run shows of it."""

from __future__ import annotations

import math

import numpy as np

from taut.base.types import Float64Array
from taut.study.diagnosis_case import Case
from taut.study.diagnosis_finding import Number
from taut.study.diagnosis_lines import Swing, without_trend

__all__ = ["less_delay", "less_integral", "lower_gain", "more_damping"]


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


def more_damping(case: Case, found: Swing) -> str:
    """The damping of zeta = 0.7, for the stiffness and inertia that the swing shows."""
    k, d, m = _stiff_and_damped(case, found)
    units = f"{case.run.effort_units[found.joint]} s/{case.run.units[found.joint]}"
    if k <= 0.0 or m <= 0.0:
        return "raise the damping (kd, B or zeta); it does next to no work on this oscillation"
    return (
        f"raise the damping of '{case.run.joint_names[found.joint]}' from {max(d, 0.0):.3g} to "
        f"{2.0 * 0.7 * math.sqrt(k * m):.3g} {units} for zeta = 0.7"
    )


def less_integral(case: Case, found: Swing) -> str:
    """The bound of the integral, (b + kd) kp / M, whatever the swing is: it is that of the gains and the arm."""
    run, i, w = case.run, found.joint, found.window
    k, d, _ = _stiff_and_damped(case, found)
    m = _moved(case, found)
    if k <= 0.0 or m <= 0.0 or case.error is None:
        return "lower ki: the integral feeds this oscillation"
    rate = _slope(np.diff(run.terms["I"][w, i]) / case.dt, case.error[w, i][1:])
    b = 0.0 if case.fit is None else float(case.fit.viscous[i])
    return (
        f"lower ki: as torques it is {Number(rate)} at '{run.joint_names[i]}', and it must stay under "
        f"(b + kd) kp / M = {Number((b + max(d, 0.0)) * k / m)}"
    )


def _moved(case: Case, found: Swing) -> float:
    """The inertia that a joint's torque moves in its oscillation, the other joints swinging with it: (M q)_i / q_i.

    Without a model, that of M s^3 + d s^2 + k s + ki = 0 at the s of the oscillation.
    """
    run, i, w = case.run, found.joint, found.window
    if case.model is not None:
        return _slope(run.q[w] @ case.model.mass_matrix(w.start)[i], run.q[w, i])
    k, d, _ = _stiff_and_damped(case, found)
    s = complex(found.line.growth, found.line.omega)
    ki = 0.0 if case.error is None else _slope(np.diff(run.terms["I"][w, i]) / case.dt, case.error[w, i][1:])
    return float((-(d * s**2 + k * s + ki) / s**3).real)


def less_delay(case: Case, found: Swing) -> str:
    """What the phase between command and torque says of the delay, and what it allows."""
    run, i, w, omega = case.run, found.joint, found.window, found.line.omega
    turn = np.exp(-1j * omega * run.t[w]) * np.hanning(w.stop - w.start)
    asked, given = (complex(np.sum(without_trend(x[w, i : i + 1])[:, 0] * turn)) for x in (run.command, run.tau))
    late = (-np.angle(given / asked) if asked else 0.0) % (2.0 * math.pi) / omega
    _, d, m = _stiff_and_damped(case, found)
    m = _moved(case, found) if case.model is not None else m
    most = math.pi * m / (6.0 * (late + 0.5 * case.dt))
    slow = f"the drives give the torque {1e3 * late:.3g} ms late: make them faster, or lower "
    if d <= most:
        return f"{slow}kp and kd of '{run.joint_names[i]}', or what else feeds this oscillation late"
    return (
        f"{slow}the damping of '{run.joint_names[i]}' from {d:.3g} to {most:.3g} {run.effort_units[i]} "
        f"s/{run.units[i]} (60 deg of phase margin) and kp with its square"
    )


def lower_gain(case: Case, found: Swing, term: str) -> str:
    """What a sampled loop bears of the gain that feeds a swing."""
    run, i = case.run, found.joint
    _, d, m = _stiff_and_damped(case, found)
    if term == "D" and case.model is not None:
        return (
            f"lower kd, or raise the rate: the damping of '{run.joint_names[i]}' is {d:.3g}, and a sampled loop "
            f"bears 2 M / T = {2.0 * m / case.dt:.3g} {run.effort_units[i]} s/{run.units[i]} at most, less with a "
            "filter or differenced velocities"
        )
    return f"lower the gain of {term} to a half, or raise the rate from {run.rate:g} Hz: it feeds this oscillation"
