"""Rig: an arm inside a MuJoCo model, and where its numbers stand there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from taut.arm.description import Arm
from taut.base.types import Float64Array
from taut.maths.adds import Adds

if TYPE_CHECKING:
    import mujoco

__all__ = ["Index", "Rig", "index"]

Index: TypeAlias = slice | NDArray[np.intp]
"""Positions in one of MuJoCo's arrays; a slice where they follow one another, since that is faster."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """An arm in a simulation: ours or the user's."""

    arm: Arm
    model: mujoco.MjModel
    data: mujoco.MjData
    joints: tuple[int, ...]  # (n,) ids, in the arm's order
    q: Index  # (n,) in qpos
    v: Index  # (n,) in qvel, qacc, qfrc_*
    dofs: tuple[int, ...]  # (n,) the same as numbers
    tool_bodies: Index  # the bodies that what touches the tool pushes on
    tool_body: int  # the body whose frame p_tool is given in
    p_tool: Float64Array  # (3,) [m] origin of the tool
    adds: Adds
    own_geoms: int = 0  # of the world's geoms, how many are the arm's, which come first


def index(numbers: list[int]) -> Index:
    """Positions as a slice where they allow it."""
    first = numbers[0]
    if numbers == list(range(first, first + len(numbers))):
        return slice(first, first + len(numbers))
    return np.array(numbers, dtype=np.intp)
