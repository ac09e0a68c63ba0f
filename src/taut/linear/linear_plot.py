"""Pictures of a linear loop: its poles in the planes of z and s, its sensitivities, the compliance of its tool."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from taut.base.types import Float64Array
from taut.linear.margins import frequency_grid
from taut.record.plots.style import DASHED, INK, WIDTH, colour, legend_above, prepared

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from taut.linear.linear_loop import LinearLoop

__all__ = ["plot"]

HEIGHT: Final = 6.0
MOST: Final = 8  # joints in one picture
AXES: Final = ("x", "y", "z")


def plot(lin: LinearLoop) -> Figure:
    """Poles in z and s, |S| at each joint's command, and the tool's compliance along the world's axes."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    axes = figure.subplots(2, 2)
    _plane_of_z(axes[0, 0], lin)
    _plane_of_s(axes[0, 1], lin)
    omega = frequency_grid(lin.dt, np.abs(np.angle(lin.poles)) / lin.dt)[:-1]
    _sensitivities(axes[1, 0], lin, omega)
    _compliance(axes[1, 1], lin, omega)
    handles = [Line2D([], [], color=colour(i), label=name, linewidth=1.5) for i, name in enumerate(lin.joints[:MOST])]
    legend_above(figure, handles)
    return figure


def _plane_of_z(ax: Axes, lin: LinearLoop) -> None:
    prepared(ax, "poles, z", "Im z", "Re z")
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    ax.plot(np.cos(turn), np.sin(turn), color=INK, linewidth=0.8)
    ax.plot(lin.poles.real, lin.poles.imag, "x", color=INK, markersize=5.0)
    ax.set_aspect("equal", adjustable="datalim")


def _plane_of_s(ax: Axes, lin: LinearLoop) -> None:
    prepared(ax, "modes, s = log z / dt", "Im s [rad/s]", "Re s [1/s]")
    for mode in lin.modes:
        i = lin.joints.index(mode.joint) if mode.joint is not None else None
        line = colour(i) if i is not None and i < MOST else INK
        ax.plot([mode.s.real] * 2, [mode.s.imag, -mode.s.imag], "x", color=line, markersize=5.0)
    ax.axvline(0.0, color=INK, linewidth=0.8)
    s = np.array([mode.s for mode in lin.modes])
    slow = float(np.abs(s[s != 0.0]).min(initial=1.0))
    knee = 10.0 ** np.ceil(np.log10(slow))  # between the two logarithmic halves
    ax.set_xscale("symlog", linthresh=knee)
    ax.set_yscale("symlog", linthresh=knee)
    ax.set_xlim(1.6 * min(float(s.real.min(initial=0.0)), -knee), max(1.6 * float(s.real.max(initial=0.0)), knee))
    high = 1.6 * max(float(np.abs(s.imag).max(initial=0.0)), knee)
    ax.set_ylim(-high, high)


def _sensitivities(ax: Axes, lin: LinearLoop, omega: Float64Array) -> None:
    prepared(ax, "sensitivity |S| at each command", "", "omega [rad/s]")
    S = np.abs(lin.input_sensitivity(omega))
    for i in range(min(len(lin.joints), MOST)):
        ax.loglog(omega, S[:, i, i], color=colour(i), linewidth=1.3)
    ax.axhline(1.0, color=INK, linewidth=0.8, linestyle=DASHED)


def _compliance(ax: Axes, lin: LinearLoop, omega: Float64Array) -> None:
    prepared(ax, "the tool's |X / F| along x, y, z of the world", "[m/N]", "omega [rad/s]")
    if not any(name.startswith("disturbance.wrench") for name in lin.inputs):
        return
    Y = np.abs(lin.frequency_response(omega, input="disturbance.wrench", output="tip.p"))
    if not Y.any():
        ax.text(0.5, 0.5, "no force moves it", transform=ax.transAxes, ha="center", color=INK)
        return
    for i, style in enumerate(("solid", DASHED, (0.0, (1.0, 1.5)))):
        if Y[:, i, i].max() > 0.0:
            ax.loglog(omega, Y[:, i, i], color=INK, linewidth=1.2, linestyle=style, label=AXES[i])
    ax.legend(fontsize=7.0, frameon=False)
