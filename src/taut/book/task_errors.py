"""Section 10.2.3: three choices of the error of a pose, and the ways along which they lead."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from taut.base.plot_style import DASHED, INK, colour, prepared
from taut.base.types import Float64Array
from taut.book.drawing import legend, panels
from taut.book.oracle import panda
from taut.book.page import Entry, Page, Row, row
from taut.book.simulation import simulated
from taut.control.laws.task import TaskComputedTorque
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import snapshot
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from taut.control.laws.task_error import ErrorKind

__all__ = ["ENTRIES"]

SHIFT, TURN = np.array([0.05, 0.15, -0.05]), np.array([0.0, 0.7, 0.4])  # [m], rotation vector [rad], chosen
KP, KD = 100.0, 20.0  # [1/s^2], [1/s]
ALONE: Final = "(1 + 10 t) exp(-10 t) of what was to go"


def screw(T0: Pose, T1: Pose) -> Float64Array:
    """(k, 3) the tool's origin on the one screw motion from a pose to another, by SciPy's logm and expm."""
    one, other = T0.matrix, T1.matrix
    log = np.real(logm(np.linalg.solve(one, other)))
    return np.array([(one @ expm(s * log))[:3, 3] for s in np.linspace(0.0, 1.0, 400)])


def aside(way: Float64Array) -> Float64Array:
    """(k,) how far a way is from the straight line along SHIFT [m]."""
    ahead = SHIFT / np.linalg.norm(SHIFT)
    moved = way - way[0]
    return np.asarray(np.linalg.norm(moved - np.outer(moved @ ahead, ahead), axis=1))


def choices() -> Page:
    arm = panda()
    T0 = snapshot(arm, arm.home).T()
    T1 = Pose(np.asarray(T0.p) + SHIFT, R=np.asarray(T0.R) @ Rotation.from_rotvec(TURN).as_matrix())
    bow = aside(screw(T0, T1))
    rows: list[Row] = []
    figure, (ax,) = panels(1, 2.6)
    prepared(ax, "the tool on its way to another place and orientation", "aside of a straight line [mm]", "way [mm]")
    kinds: tuple[ErrorKind, ...] = ("body", "space", "decoupled")
    for k, kind in enumerate(kinds):
        law = TaskComputedTorque(kp=KP, kd=KD, error=kind, null=None, singularity="plain")
        out = simulated(law, arm, TaskMotion(pose=T1), duration=1.5)
        off = aside(out.task.p)
        name = f"{kind}: farthest from a straight line"
        if kind == "decoupled":
            turned = Rotation.from_matrix(np.swapaxes(np.asarray(out.task.R), 1, 2) @ np.asarray(T1.R)).magnitude()
            at = round(0.2 * out.rate)
            wanted = np.linalg.norm(TURN) * (1.0 + 10.0 * 0.2) * math.exp(-10.0 * 0.2)
            claim = "decouples rotational and linear terms"
            rows += [
                row(name, "m", off.max(), 0.0, "each by itself: straight", near=2e-4, states=claim),
                row(f"{kind}: angle left after 0.2 s", "rad", turned[at], wanted, ALONE, rel=0.02, states=claim),
                row(
                    f"{kind}: way left after 0.2 s", "m", np.linalg.norm(np.asarray(T1.p) - out.task.p[at]),
                    wanted / np.linalg.norm(TURN) * np.linalg.norm(SHIFT), ALONE, rel=0.02, states=claim,
                ),
            ]  # fmt: skip
        else:
            rows.append(row(name, "m", off.max(), bow.max(), "the screw motion between both poses", rel=0.01))
        way = np.linalg.norm(out.task.p - out.task.p[0], axis=1)
        ax.plot(1e3 * way, 1e3 * off, color=colour(k), linewidth=1.4, linestyle=DASHED if k == 1 else "-", label=kind)
    ax.axhline(0.0, color=INK, linewidth=0.6)
    legend(ax)
    note = (
        "The errors of body and space lead the tool along the screw motion from one pose to the other, the third "
        "straight ahead. Chosen: a Panda, kp = 100, kd = 20, 0.17 m and 0.81 rad."
    )
    return Page(rows=tuple(rows), figure=figure, note=note)


ENTRIES: Final = (Entry(id="sec-10.2.3", title="three choices of the error", make=choices, part="choices"),)
