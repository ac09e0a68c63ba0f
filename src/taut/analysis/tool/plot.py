"""Bode of a tool's impedance: asked dashed, predicted as a line, measured as points."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from taut.record.plots.style import DASHED, INK, SMALL, WIDTH, colour, prepared

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.analysis.tool.response import TipMeasurement, TipResponse

__all__ = ["plot"]

HEIGHT: Final = 4.6
DECADES: Final = 4.0
POINTS: Final = 400


def plot(tip: TipResponse, measured: TipMeasurement | None) -> Figure:
    """Size and phase of Z over frequency."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    prepared(above, "impedance at the tool, Z = F / X", f"|Z| [{tip.unit}]")
    prepared(below, "", "phase of Z [deg]", "frequency [Hz]")
    omega = np.pi / tip.lin.dt * np.logspace(-DECADES, 0.0, POINTS)[:-1]
    for Z, style, shade, name in (
        (tip.Z(omega), "solid", colour(0), "predicted, of the sampled loop"),
        *([] if tip.asked is None else [(tip.asked_Z(omega), DASHED, INK, "asked")]),
    ):
        above.loglog(omega / (2.0 * np.pi), np.abs(Z), color=shade, linestyle=style, linewidth=1.4, label=name)
        below.semilogx(omega / (2.0 * np.pi), np.degrees(np.unwrap(np.angle(Z))), color=shade, linestyle=style)
    if measured is not None:
        hertz = measured.omega / (2.0 * np.pi)
        above.loglog(hertz, np.abs(measured.Z), "o", color=colour(1), markersize=4.0, label="measured, a sine sweep")
        turn = np.interp(measured.omega, omega, np.unwrap(np.angle(tip.Z(omega))))
        phase = np.angle(measured.Z)
        phase += 2.0 * np.pi * np.round((turn - phase) / (2.0 * np.pi))
        below.semilogx(hertz, np.degrees(phase), "o", color=colour(1), markersize=4.0)
    above.legend(fontsize=SMALL, frameon=False)
    return figure
