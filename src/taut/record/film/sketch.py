"""Schematic pictures of an arm by matplotlib, for machines without OpenGL."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from taut.base.types import Float64Array
from taut.record.film.skeleton import Skeleton, View
from taut.record.plots.style import COLOURS, INK

__all__ = ["sketches"]

DPI: Final = 100.0
LINK: Final = "#8A8F96"


def sketches(
    skeleton: Skeleton, wanted: Float64Array, view: View, size: tuple[int, int]
) -> Iterator[np.ndarray[Any, np.dtype[np.uint8]]]:
    """One picture (height, width, 3) per frame: links as lines, joints as dots, the tool's way.

    Args:
        skeleton: The arm at k joint positions.
        wanted: (k, 3) [m] where the tool should go, or (0, 3).
        view: From where to look.
        size: Width and height in pixels.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width, height = size
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    canvas = FigureCanvasAgg(figure)
    ax: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
    _frame(ax, view)
    ax.text2D(0.975, 0.965, "schematic", transform=ax.transAxes, fontsize=8.0, color="#777777", ha="right", va="top")
    points = skeleton.points()
    if len(wanted):
        ax.plot(*wanted.T, color=INK, linewidth=0.9, linestyle="--")
    trail = ax.plot([], [], [], color=COLOURS[1], linewidth=1.6)[0]
    bones = [ax.plot([], [], [], color=LINK, linewidth=5.0, solid_capstyle="round")[0] for _ in skeleton.bones]
    joints = ax.plot([], [], [], linestyle="none", marker="o", markersize=7.0, color=COLOURS[0])[0]
    tool = ax.plot([], [], [], linestyle="none", marker="D", markersize=5.0, color=COLOURS[1])[0]
    for k in range(len(points)):
        trail.set_data_3d(*skeleton.tool[: k + 1].T)
        for line, (a, b) in zip(bones, skeleton.bones, strict=True):
            line.set_data_3d(*points[k, [a + 1, b + 1]].T)
        joints.set_data_3d(*points[k, 1:-1].T)
        tool.set_data_3d(*points[k, -1:].T)
        canvas.draw()  # type: ignore[no-untyped-call]
        yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()  # type: ignore[no-untyped-call]


def _frame(ax: Any, view: View) -> None:
    """A cube around what is seen, and a grid for the floor."""
    low, high = view.centre - view.radius, view.centre + view.radius
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_zlim(low[2], high[2])
    ax.set_box_aspect((1.0, 1.0, 1.0), zoom=1.45)
    ax.view_init(elev=-view.elevation, azim=view.azimuth - 180.0)
    ax.set_axis_off()
    height = max(view.floor, low[2])
    for s in np.linspace(-1.0, 1.0, 9):
        x, y = view.centre[:2] + s * view.radius
        ax.plot([x, x], [low[1], high[1]], [height, height], color="#DDDDDD", linewidth=0.6, zorder=0)
        ax.plot([low[0], high[0]], [y, y], [height, height], color="#DDDDDD", linewidth=0.6, zorder=0)
