"""Figures of a linear system: poles, step response, Bode and Nyquist diagram."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.plot_style import DASHED, INK, SMALL, WIDTH, colour, prepared
from taut.linear.performance import BAND, frequency_grid, powers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from taut.linear.linear_system import LinearSystem

PLOT_POINTS: Final = 600  # of a continuous step response
MARGIN: Final = 1.15  # [-] of the farthest pole: the size of its axes
SETTLED: Final = 1.3  # [-] settling times that a step response shows
NYQUIST_SIZE: Final = 2.5  # [-] of the Nyquist diagram about -1
ROW_HEIGHT: Final = 1.35  # [inch] of a row of panels


def figure_of(system: LinearSystem) -> Figure:
    """Step response, poles, Bode and Nyquist diagram of a system: those for which it has the signals."""
    from matplotlib.figure import Figure as NewFigure

    signals = {*system.inputs, *system.outputs}
    step, loop = {"ref.q[0]", "q[0]"} <= signals, {"disturbance.command[0]", "command[0]"} <= signals
    panels: list[Any] = [["step" if step else "poles", "poles"]] * 2
    panels += [["size", "nyquist"], ["phase", "nyquist"]] * loop
    figure = NewFigure(figsize=(WIDTH, len(panels) * ROW_HEIGHT), dpi=150, layout="constrained", facecolor="white")
    axes = figure.subplot_mosaic(panels)
    _draw_poles(axes["poles"], system)
    if step:
        _draw_step(axes["step"], system)
    if loop:
        _draw_bode(axes["size"], axes["phase"], system)
        _draw_nyquist(axes["nyquist"], system)
    return figure


def pole_axes(ax: Axes, shown: NDArray[np.complex128], dt: float | None) -> None:
    """Axes for poles with equal scales; the unstable half-plane is tinted, the unit circle drawn."""
    name = "s [1/s]" if dt is None else "z"
    prepared(ax, f"poles in {name[0]}", f"Im {name}", f"Re {name}")
    ax.axhline(0.0, color=INK, linewidth=0.6)
    ax.axvline(0.0, color=INK, linewidth=0.6)
    if dt is None:
        size = MARGIN * max(float(np.abs(shown).max(initial=0.0)), 1e-9)
        right = max(0.25 * size, MARGIN * float(shown.real.max(initial=0.0)))
        height = max(0.6 * size, MARGIN * float(np.abs(shown.imag).max(initial=0.0)))
        ax.axvspan(0.0, right, color=colour(1), alpha=0.10, linewidth=0.0)
        ax.set_xlim(min(-size, -right), right)
        ax.set_ylim(-height, height)
    else:
        circle = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 200))
        ax.plot(circle.real, circle.imag, color=INK, linewidth=0.9)
        size = MARGIN * max(1.0, float(np.abs(shown).max(initial=0.0)))
        ax.set_xlim(-size, size)
        ax.set_ylim(-size, size)
    ax.set_aspect("equal", adjustable="box")


def _draw_poles(ax: Axes, system: LinearSystem) -> None:
    pole_axes(ax, system.poles, system.dt)
    ax.plot(system.poles.real, system.poles.imag, "x", color=colour(0), markersize=6.0, markeredgewidth=1.5)


def _draw_step(ax: Axes, system: LinearSystem) -> None:
    """The error after a unit step of the first joint's reference."""
    found = system.step()
    settles = bool(np.isfinite(found.settling_time))
    settled = found.settling_time if settles else 10.0 / max(float(system.omega_n.min()), 1e-3)
    h = system.dt or SETTLED * settled / PLOT_POINTS
    sampled = system if system.dt else system.zoh(h)
    count = max(2, min(int(SETTLED * settled / h) + 1, 10 * PLOT_POINTS))
    column, row = sampled.columns("ref.q[0]")[0], sampled.rows("q[0]")[0]
    start = sampled.B[:, column]  # a step adds up the impulse response
    later = np.cumsum(powers(sampled.C[row], sampled.A, count - 1) @ start)
    y = sampled.D[row, column] + np.concatenate([[0.0], later])
    title = f", settled after {settled:.3g} s (dashed)" if settles else ""
    prepared(ax, f"step response{title}", "q / reference", "t [s]")
    ax.axhspan(1.0 - BAND, 1.0 + BAND, color=colour(2), alpha=0.25, linewidth=0.0)
    ax.axhline(1.0, color=INK, linewidth=0.6)
    ax.plot(h * np.arange(count), y, color=colour(0), linewidth=1.5)
    if settles:
        ax.axvline(settled, color=colour(1), linewidth=1.0, linestyle=DASHED)


def _loops(system: LinearSystem) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """(k,) frequencies and (k, n) L at each command."""
    omega = frequency_grid(system.dt, system.omega_n)
    S = np.diagonal(system.sensitivity(omega), axis1=1, axis2=2)
    return omega, 1.0 / S - 1.0


def _draw_bode(size: Axes, phase: Axes, system: LinearSystem) -> None:
    omega, L = _loops(system)
    prepared(size, "Bode diagram of the open loop", "|L|", "")
    prepared(phase, "", "phase [deg]", "omega [rad/s]")
    for i, name in enumerate(system.outputs[k] for k in system.rows("command")):
        size.loglog(omega, np.abs(L[:, i]), color=colour(i), linewidth=1.3, label=name)
        angle = (np.degrees(np.angle(L[:, i])) + 270.0) % 360.0 - 270.0
        angle[1:][np.abs(np.diff(angle)) > 180.0] = np.nan  # no line where it wraps
        phase.semilogx(omega, angle, color=colour(i), linewidth=1.3)
    size.axhline(1.0, color=INK, linewidth=0.8, linestyle=DASHED)
    phase.axhline(-180.0, color=INK, linewidth=0.8, linestyle=DASHED)


def _draw_nyquist(ax: Axes, system: LinearSystem) -> None:
    _, L = _loops(system)
    prepared(ax, "Nyquist diagram", "Im L", "Re L")
    circle = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 200))
    ax.plot(circle.real, circle.imag, color=INK, linewidth=0.6, linestyle=DASHED)
    for i in range(L.shape[1]):
        name = system.outputs[system.rows("command")[i]]
        ax.plot(L[:, i].real, L[:, i].imag, color=colour(i), linewidth=1.3, label=name)
    ax.plot(-1.0, 0.0, "+", color=colour(1), markersize=8.0, markeredgewidth=1.5)
    if L.shape[1] > 1:
        ax.legend(fontsize=SMALL, frameon=False, labelcolor=INK, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    ax.set_xlim(-NYQUIST_SIZE, NYQUIST_SIZE - 1.0)
    ax.set_ylim(-NYQUIST_SIZE, NYQUIST_SIZE)
    ax.set_aspect("equal", adjustable="box")
