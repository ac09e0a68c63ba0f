"""The inertial numbers of the arm that a controller was compiled for, as a log keeps them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm

__all__ = ["DYNAMICS", "arm_numbers", "with_numbers"]

DYNAMICS: Final = "dynamics"  # in run.info


def arm_numbers(arm: Arm) -> dict[str, Any]:
    """Gravity [m/s^2], mass [kg], centre [m] and inertia [kg m^2] of each body, rotor inertia of each joint."""
    return {
        "gravity": arm.gravity.tolist(),
        "bodies": [
            [body.mass, *np.ravel(body.com).tolist(), *np.ravel(body.inertia).tolist()] for body in arm.bodies
        ],
        "rotor_inertia": arm.rotor_inertia.tolist(),
        "gear": arm.gear.tolist(),
    }


def with_numbers(arm: Arm, numbers: Mapping[str, Any]) -> Arm | None:
    """An arm of the same joints with those numbers; None where they are not of such an arm.

    Example:
        >>> from taut import load_arm
        >>> arm = load_arm("planar2")
        >>> other = with_numbers(arm, arm_numbers(arm.with_gravity([0.0, 0.0, 0.0])))
        >>> other.gravity.tolist()
        [0.0, 0.0, 0.0]
    """
    if arm_numbers(arm) == numbers:
        return arm
    rows = np.array(numbers["bodies"], dtype=np.float64)
    if rows.shape != (len(arm.bodies), 13):
        return None
    bodies = tuple(
        dataclasses.replace(body, mass=float(row[0]), com=row[1:4], inertia=row[4:].reshape(3, 3))
        for body, row in zip(arm.bodies, rows, strict=True)
    )
    changed = dataclasses.replace(arm, bodies=bodies, gravity=np.array(numbers["gravity"], dtype=np.float64))
    return changed.with_joints(rotor_inertia=numbers["rotor_inertia"], gear=numbers["gear"])
