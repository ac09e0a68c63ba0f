"""Sections 10.4 and 10.4.1: what may be specified, natural and artificial constraints, the eraser of figure 10.16."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from taut.analysis.constraints.natural_constraints import ConstraintTable, natural_constraints
from taut.analysis.constraints.specification import check_specification
from taut.base.plot_style import INK, SMALL, colour
from taut.base.types import Float64Array
from taut.book.drawing import arrow, canvas, words
from taut.book.page import Entry, Page, row
from taut.maths.constraints.constraint import Constraint
from taut.trace.pose import Pose

__all__ = ["ENTRIES"]

B_ENV: Final = [[2.0, 1.0], [1.0, 1.0]]  # the chapter's damper


def sec_10_4() -> Page:
    given = check_specification({"F1": 3.0, "V1": 1.0}, B=B_ENV)
    got = given.quantities
    V2 = 3.0 - 2.0 * 1.0
    dependent = check_specification(["F1", "2 V1 + V2"], B=B_ENV)
    rank = np.linalg.matrix_rank(np.vstack([B_ENV[0], [2.0, 1.0]]))
    rows = (
        row("F1 = 3, V1 = 1 may be chosen", "0 or 1", given.ok, 1.0, "the chapter", states="yes"),
        row("then V2 is", "m/s", got["V2"], V2, "F1 = 2 V1 + V2, solved", states="determined by B_env"),
        row("and F2 is", "N", got["F2"], 1.0 + V2, "F2 = V1 + V2", states="determined by B_env"),
        row(
            "F1 and 2 V1 + V2 may be chosen",
            "0 or 1",
            dependent.ok,
            rank == 2,
            "rank of the two rows",
            states="no: the same direction",
        ),
    )
    return Page(rows=rows, note="Chosen: the values of F1 and V1.")


def eraser() -> Constraint:
    """The eraser's face on the chalkboard of figure 10.16: three rows."""
    return Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0], face=[0.0, 0.0, -1.0])


def counted(name: str, found: ConstraintTable, motions: int, forces: int, states: str) -> list[Any]:
    """Rows of how many motions and forces may be chosen."""
    return [
        row(f"{name}: motions that may be chosen", "", found.motions, motions, "the chapter", states=states),
        row(f"{name}: forces that may be chosen", "", found.forces, forces, "the chapter"),
    ]


def sec_10_4_1() -> Page:
    door = Constraint.hinge(point=[0.5, 0.2, 0.3], axis=[0.0, 0.0, 1.0], T=Pose([0.4, 0.1, 0.3]))
    chalk = Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])
    sharp = Constraint(lambda T: T.p[2], one_sided=True)
    at = Pose([0.4, 0.1, 0.0])
    rows = [
        *counted("cabinet door", natural_constraints(door, at=Pose([0.4, 0.1, 0.3])), 1, 5, "1 + 5"),
        *counted("chalk on a board", natural_constraints(chalk, at=at), 5, 1, "5 + 1"),
        *counted("chalk that sticks", natural_constraints(sharp, at=at, mode="stick", friction=0.3), 3, 3, "3 + 3"),
        *counted("chalk pulled away", natural_constraints(sharp, at=at, mode="apart"), 6, 0, "6 + 0"),
    ]
    return Page(rows=tuple(rows))


def fig_10_16() -> Page:
    found = natural_constraints(eraser(), at=Pose([0.4, 0.1, 0.0]))
    rows = counted("eraser", found, 3, 3, "3 + 3")
    wanted = {
        "phi_x-dot = 0": "F_phi_x",
        "phi_y-dot = 0": "F_phi_y",
        "F_phi_z = 0": "phi_z-dot",
        "F_x = 0": "x-dot",
        "F_y = 0": "y-dot",
        "z-dot = 0": "F_z",
    }
    table = {row.natural: row.artificial for row in found.rows}
    for natural, artificial in wanted.items():
        there = table.get(natural) == artificial
        rows.append(
            row(
                f"row {natural} beside {artificial}",
                "0 or 1",
                there,
                1.0,
                "the chapter's table",
                states=f"{natural}, {artificial} = ...",
            )
        )
    return Page(
        rows=tuple(rows),
        figure=board(),
        note="The frames are as in the chapter: {s} on the board, {b} on the eraser.",
    )


def board() -> Any:
    """The chalkboard and the eraser, with their frames, in a parallel projection."""
    figure, ax = canvas(8.0, 4.2, 0.85)
    view = (
        Rotation.from_euler("zyx", [0.0, 0.0, -62.0], degrees=True).as_matrix()
        @ Rotation.from_euler("z", 28.0, degrees=True).as_matrix()
    )

    def seen(points: Any) -> Float64Array:
        flat = np.atleast_2d(points) @ view.T
        return np.column_stack([2.1 + 2.3 * flat[:, 0], 1.1 + 2.3 * flat[:, 1]])

    def patch(corners: Any, fill: str) -> None:
        ax.fill(*seen(corners).T, facecolor=fill, edgecolor=INK, linewidth=0.9)

    def axes_at(T: Pose, name: str) -> None:
        o = np.asarray(T.p)
        for k, letter in enumerate("xyz"):
            start, end = seen([o, o + 0.45 * np.asarray(T.R)[:, k]])
            arrow(ax, (float(start[0]), float(start[1])), (float(end[0]), float(end[1])), ink=colour(k), width=1.6)
            far = seen(o + 0.52 * np.asarray(T.R)[:, k])[0]
            words(ax, float(far[0]), float(far[1]), letter)
        place = seen(o - 0.1 * np.asarray(T.R)[:, 0] - 0.1 * np.asarray(T.R)[:, 1])[0]
        words(ax, float(place[0]), float(place[1]), f"{{{name}}}")

    patch([[-0.3, -0.5, 0.0], [2.1, -0.5, 0.0], [2.1, 1.0, 0.0], [-0.3, 1.0, 0.0]], "#E9F0EA")
    b = Pose([1.25, 0.3, 0.12], rpy=[0.0, 0.0, 0.3])
    half = np.array([0.28, 0.14, 0.12])
    for k, sign, fill in (
        (0, 1.0, "#C8B89A"),
        (0, -1.0, "#C8B89A"),
        (1, 1.0, "#D6C8AC"),
        (1, -1.0, "#D6C8AC"),
        (2, 1.0, "#E4D9C2"),
    ):
        outwards = sign * np.asarray(b.R)[:, k]
        if (view @ outwards)[2] > 0.0:  # towards who looks
            i, j = (axis for axis in range(3) if axis != k)
            face = np.zeros((4, 3))
            face[:, k], face[:, i], face[:, j] = sign, [-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0]
            patch(np.asarray(b.p) + (face * half) @ np.asarray(b.R).T, fill)
    axes_at(Pose([0.0, 0.0, 0.0]), "s")
    axes_at(b, "b")
    words(ax, 5.6, 1.15, "chalkboard", size=SMALL)
    return figure


ENTRIES: Final = (
    Entry(id="sec-10.4", title="what may be specified against a damper", make=sec_10_4),
    Entry(id="sec-10.4.1", title="natural and artificial constraints", make=sec_10_4_1),
    Entry(id="fig-10.16", title="the eraser on the chalkboard", make=fig_10_16),
)
