"""Draw docs/images/task_errors.png, and print the tables of docs/task_errors.md: four errors, one large motion.

Run it in this folder: `python task_errors.py [FOLDER]`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import taut
from taut.base.plot_style import COLOURS, DASHED, INK, SMALL, WIDTH, prepared
from taut.maths.spatial import pose_log, rotation_exp, rotation_log

Array = NDArray[np.float64]
IMAGES = Path(__file__).parent.parent / "docs" / "images"

ARM = taut.load_arm("panda").with_joints(viscous=0.0, coulomb=0.0)
SHIFT = np.array([-0.05, 0.38, 0.11])  # [m] 0.4 m long
AXIS, ANGLE = np.array([0.6, 0.0, 0.8]), np.radians(120.0)
GAINS = {  # by what their row is called
    "kp = 25": {"kp": 25.0, "kd": 10.0},
    "kp = (49, 16)": {"kp": (49.0, 16.0), "kd": (14.0, 8.0)},
}
START = taut.snapshot(ARM, ARM.home).T()
GOAL = taut.Pose.of(rotation_exp(ANGLE * AXIS) @ START.R, START.p + SHIFT)
RPY = taut.Coordinates.position_and_rpy()
KINDS = {
    "decoupled": {},
    "body": {"error": "body"},
    "space": {"error": "space"},
    "coordinates": {"error": "coordinates", "coordinates": RPY},
}


@dataclass(frozen=True)
class Path3:
    """What the tool did."""

    t: Array
    p: Array  # (k, 3) [m]
    angle: Array  # (k,) [rad] left to turn
    aside: Array  # (k,) [m] from the straight line
    tilt: Array  # (k,) [rad] of the rotation that is left against the axis of the whole
    screw: Array  # (k,) [m, rad] of log(T^-1 T_goal) off its first direction, relative
    tau: float  # [N m]


def main() -> None:
    """Run the four, draw them and print what they did."""
    mpl.use("Agg")
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    done = {
        row: {name: followed(taut.laws.TaskComputedTorque(**gains, **kind)) for name, kind in KINDS.items()}
        for row, gains in GAINS.items()
    }
    picture(done).savefig(folder / "task_errors.png", dpi=150)
    for row, paths in done.items():
        table = Table(
            "error", "way [m]", "aside [mm]", "axis tilts [deg]", "off the screw", "torque [N m]", title=row
        )
        for name, path in paths.items():
            table.add_row(
                name,
                f"{np.linalg.norm(np.diff(path.p, axis=0), axis=1).sum():.3f}",
                f"{1e3 * path.aside.max():.1f}",
                f"{np.degrees(np.nanmax(path.tilt)):.1f}",
                f"{path.screw.max():.3f}",
                f"{path.tau:.0f}",
            )
        Console(width=110).print(table)


def followed(law: taut.Law) -> Path3:
    """The closed loop from home to the goal, a step in pose."""
    ctrl = taut.compile(law, ARM)
    out = taut.run(ctrl, taut.RigidPlant(ARM), taut.TaskMotion(pose=GOAL), duration=2.5, progress=False)
    assert out.outcome.ok, out.outcome
    rows = slice(None, None, 10)
    poses = [taut.snapshot(ARM, q).T() for q in out.q[rows]]
    p = np.array([T.p for T in poses])
    left = np.array([rotation_log(GOAL.R @ T.R.T) for T in poses])
    angle = np.linalg.norm(left, axis=1)
    cosine = np.where(
        angle > np.radians(2.0), left @ AXIS / np.maximum(angle, 1e-9), np.nan
    )  # the axis of what counts
    along = SHIFT / np.linalg.norm(SHIFT)
    off = p - START.p
    aside = np.linalg.norm(off - np.outer(off @ along, along), axis=1)
    screws = np.array([pose_log(T.inverse() @ GOAL) for T in poses])
    first = screws[0] / np.linalg.norm(screws[0])
    rest = np.linalg.norm(screws - np.outer(screws @ first, first), axis=1) / np.linalg.norm(screws[0])
    return Path3(
        t=out.t[rows],
        p=p,
        angle=angle,
        aside=aside,
        tilt=np.arccos(np.clip(cosine, -1.0, 1.0)),
        screw=rest,
        tau=float(np.abs(out.tau).max()),
    )


def picture(done: dict[str, dict[str, Path3]]) -> Figure:
    """A row for each choice of gains: the path, its distance from the straight line, what is left to turn."""
    figure = Figure(figsize=(WIDTH, 4.9), layout="constrained", facecolor="white")
    rows = figure.subplots(len(done), 3, width_ratios=[1.25, 1.0, 1.0])
    for axes, (gains, paths) in zip(rows, done.items(), strict=True):
        seen, aside, turned = axes
        prepared(seen, f"path from the front, {gains}", "z [m]", "y [m]")
        prepared(aside, "distance from the line", "[mm]", "t [s]")
        first = gains == next(iter(done))
        prepared(turned, "rotation still to go" if first else "tilt of its axis", "[deg]", "t [s]")
        ends(seen)
        for name, colour, width in zip(paths, COLOURS, (2.8, 2.8, 1.2, 1.2), strict=False):  # some lie on others
            path, line = paths[name], {"color": colour, "linewidth": width, "label": name}
            seen.plot(path.p[:, 1], path.p[:, 2], **line)
            aside.plot(path.t, 1e3 * path.aside, **line)
            turned.plot(path.t, np.degrees(path.angle if first else path.tilt), **line)
        seen.set_aspect("equal", adjustable="datalim")
        for ax in (aside, turned):
            ax.set_xlim(0.0, 2.0)
            ax.set_ylim(bottom=0.0)
    handles, labels = rows[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=5, fontsize=SMALL, frameon=False, labelcolor=INK)
    return figure


def ends(ax: Axes) -> None:
    """Start, goal and the straight line between them."""
    line = np.array([START.p, GOAL.p])
    ax.plot(line[:, 1], line[:, 2], color=INK, linewidth=0.9, linestyle=DASHED, zorder=5, label="straight line")
    for p, word, marker in ((START.p, "start", "o"), (GOAL.p, "goal", "s")):
        ax.plot(p[1], p[2], marker, color=INK, markersize=4.5, zorder=6)
        place = {"xytext": (0, 7), "textcoords": "offset points", "ha": "left" if word == "start" else "center"}
        ax.annotate(word, (p[1], p[2]), fontsize=SMALL, color=INK, **place)


if __name__ == "__main__":
    main()
