"""Designs of force: the swing and the slow pole of the force on a contact, mode by mode."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import eigh

from taut.analysis.design.directions import Direction, numbered
from taut.analysis.design.place import at_tool
from taut.base.types import Float64Array
from taut.linear.error_dynamics import ErrorDynamics
from taut.linear.joint_gains import JointGains
from taut.maths.snapshot import Snapshot

__all__ = ["force_directions"]


def force_directions(law: Any, x: Snapshot, spring: Float64Array) -> tuple[Direction, ...]:
    """The modes of the arm's inertia on a contact's spring (6, 6), each with its swing and its slow pole.

    Law:  Lambda F_e-ddot + kdamp F_e-dot + (1 + kfp) contact F_e + kfi contact int(F_e) = 0, F_e = F_des - contact x
    """
    place, eye = at_tool(law, x), np.eye(6)
    fed = place.inside((eye + law.kfp.matrix(6)) @ spring)
    pulled, damping = place.inside(law.kfi.matrix(6) @ spring), place.inside(law.kdamp.matrix(6))
    squares, modes = eigh(fed, place.Lambda)
    found: list[Direction] = []
    for square, mode in zip(squares, modes.T, strict=True):
        moved = place.U @ mode
        i = int(np.argmax(np.abs(moved)))
        kd, ki = (float(mode @ C @ mode) for C in (damping, pulled))
        found.append(
            Direction(
                name=numbered(f"{'force' if i < 3 else 'moment'} {place.names[i]}", found),
                unit="N" if i < 3 else "N m",
                row=place.rows.T @ (place.Lambda @ mode) * moved[i],
                column=place.back @ mode / moved[i],
                dynamics=ErrorDynamics.of_gains(JointGains(M=1.0, kp=float(square), kd=kd, ki=ki)),
                axis=i,
                per_unit=float(spring[i, i]),
            )
        )
    return tuple(found)
