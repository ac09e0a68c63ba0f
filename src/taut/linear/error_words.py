"""Error dynamics in words: the reports that are printed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from taut.base.types import Float64Array
from taut.control.sensing.filters import LowPass
from taut.linear.poles import GONE

if TYPE_CHECKING:
    from taut.linear.error_dynamics import ErrorDynamics
    from taut.linear.sampled import VelocityKind
    from taut.linear.sampled_errors import SampledErrorDynamics

__all__ = ["equation", "number", "of_continuous", "of_sampled", "pole"]

MOST_POLES = 8
WIDTH = 17  # of the first column
LONG = "too lightly damped to be followed to its end"


def number(value: float | None, unit: str = "") -> str:
    """A number of four digits with its unit; words for what is not one."""
    if value is None or math.isnan(value):
        return "none"
    if math.isinf(value):
        return "without end"
    return f"{value:.4g} {unit}".rstrip()


def pole(s: complex, digits: int = 4) -> str:
    """-2 +- 3j for the upper one of a pair, -2 for a real one."""
    return f"{s.real:.{digits}g}" if s.imag == 0.0 else f"{s.real:.{digits}g} +- {abs(s.imag):.{digits}g}j"


def equation(coefficients: Float64Array) -> str:
    """0.5 s^2 + 2.1 s + 2.205 = 0."""
    order = len(coefficients) - 1
    text = ""
    for k, a in enumerate(coefficients.tolist()):
        power = order - k
        if a == 0.0:
            continue
        size = "" if abs(a) == 1.0 and power else f"{abs(a):.5g}"
        s = "" if power == 0 else "s" if power == 1 else f"s^{power}"
        sign = ("-" if a < 0.0 else "") if not text else (" - " if a < 0.0 else " + ")
        text += f"{sign}{size}{' ' if size and s else ''}{s}"
    return f"{text} = 0"


def of_continuous(d: ErrorDynamics) -> str:
    """The report of error dynamics."""
    lines = [f"error dynamics {equation(np.asarray(d.coefficients))}"]
    case = f", {d.case}" if d.order == 2 and d.stable else ""
    lines.append(_row("stable" if d.stable else "not stable", d.routh.sentence.partition(": ")[2] + case))
    lines.append(_row("poles", f"{_poles(d.poles)} 1/s"))
    if d.order == 2 and not math.isnan(d.zeta):
        damped = f", omega_d {number(d.omega_d, 'rad/s')}" if d.omega_d else ""
        lines.append(_row("zeta, omega_n", f"{number(d.zeta)}, {number(d.omega_n, 'rad/s')}{damped}"))
    elif d.order > 2:
        pairs = ", ".join(f"{z:.3g} at {w:.4g} rad/s" for z, w in _modes(d.poles, d.damping_ratios))
        lines.append(_row("zeta, omega_n", pairs))
    if d.stable:
        lines.append(_row("time constant", f"{number(d.time_constant, 's')}, of the slowest pole"))
        lines += _step(d)
        exact = LONG if math.isnan(d.settling_time) else f"{number(d.settling_time, 's')} exactly"
        lines.append(_row("settling, 2 %", f"{exact}; 4 tau: {number(d.settling_by_rule, 's')}"))
    lines += _steady(d)
    if d.joint is not None:
        gains = f"kp = {d.kp:.6g}, kd = {d.kd:.6g}, ki = {d.ki:.6g}"
        bound = f"stable for 0 <= ki < {number(d.largest_ki)}" if d.largest_ki else "no ki is stable with these"
        lines.append(_row("gains", f"{gains}; {bound}"))
    return "\n".join(lines)


def of_sampled(d: SampledErrorDynamics) -> str:
    """The report of sampled error dynamics."""
    book = "stable" if d.continuous.stable else "not stable"
    here = "stable" if d.stable else "not stable"
    late = f", {number(1e3 * d.delay, 'ms')} late" if d.delay else ""
    lines = [f"error dynamics {equation(np.asarray(d.continuous.coefficients))}"]
    lines[0] += f" at {d.rate:g} Hz, velocity {_velocity(d.velocity)}{late}{_steps(d)}"
    lines.append(_row(here, f"largest pole {d.radius:.6g} in z; in the book {book}"))
    some = np.abs(d.poles) > GONE
    lines.append(_row("poles in z", _poles(d.poles[some], 6)))
    lines.append(_row("poles as s", f"{_poles(d.s_poles[some])} 1/s; in the book {_poles(d.continuous.poles)} 1/s"))
    pairs = ", ".join(f"{z:.3g} at {w:.4g} rad/s" for z, w in _modes(d.s_poles[some], d.damping_ratios[some]))
    lines.append(_row("zeta, omega_n", pairs))
    if d.stable:
        lines += _step(d)
        ticks = f"{d.settling_ticks} ticks, {number(d.settling_time, 's')}" if d.settling_ticks is not None else LONG
        lines.append(_row("settling, 2 %", f"{ticks}; book: {number(d.continuous.settling_time, 's')}"))
    rate, delay = d.lowest_stable_rate, d.largest_stable_delay
    lowest = "at no rate" if math.isinf(rate) else f"from {number(rate, 'Hz')} on"
    lines.append(_row("stable", f"{lowest} with this delay; at this rate {_late(delay)}"))
    return "\n".join(lines)


def _steps(d: SampledErrorDynamics) -> str:
    """The steps in which the joint moves; nothing where it moves all the time."""
    if d.integrator == "exact":
        return ""
    return f", in {f'{d.substeps} steps' if d.substeps > 1 else 'one step'} of {d.integrator} a period"


def _late(delay: float) -> str:
    if delay == 0.0:
        return "with no delay"
    return f"up to {number(1e3 * delay, 'ms')} of delay" if math.isfinite(delay) else "with any delay"


def _row(name: str, text: str) -> str:
    return f"  {name.ljust(WIDTH)}{text}"


def _step(d: ErrorDynamics | SampledErrorDynamics) -> list[str]:
    peak = f" at {number(d.step.peak_time, 's')}" if not math.isnan(d.step.peak_time) else ""
    return [_row("step", f"overshoot {number(d.overshoot, '%')}{peak}, rise {number(d.step.rise_time, 's')}")]


def _steady(d: ErrorDynamics) -> list[str]:
    """What is left in the end, of what is known of it."""
    if not d.stable:
        return []
    found = []
    if d.reference is not None:
        found = [f"{to} {number(d.steady_state_error(to), 'rad')}" for to in ("step", "ramp", "parabola")]
    if d.disturbance is not None:
        found.append(f"constant disturbance {number(d.steady_state_error('disturbance'), 'rad')}")
    return [_row("error left of 1", ", ".join(found))] if found else []


def _modes(poles: NDArray[np.complex128], ratios: Float64Array) -> list[tuple[float, float]]:
    upper = poles.imag >= 0.0
    return list(zip(ratios[upper].tolist(), np.abs(poles[upper]).tolist(), strict=True))[:MOST_POLES]


def _poles(poles: NDArray[np.complex128], digits: int = 4) -> str:
    shown = [pole(complex(each), digits) for each in poles if each.imag >= 0.0]
    more = f" and {len(shown) - MOST_POLES} more" if len(shown) > MOST_POLES else ""
    return f"{', '.join(shown[:MOST_POLES])}{more}"


def _velocity(velocity: VelocityKind) -> str:
    if isinstance(velocity, str):
        return {"measured": "measured", "difference": "differenced"}[velocity]
    kind = "measured" if isinstance(velocity, LowPass) else "differenced"
    if velocity.cutoff is None:
        return kind
    return f"{kind} and filtered at {float(np.max(velocity.cutoff)):g} Hz"
