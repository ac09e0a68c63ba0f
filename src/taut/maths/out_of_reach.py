"""Targets that are certainly out of an arm's reach: spheres which points of its tool can never leave.

A pose within all of them may still be out of reach; one outside of any of them is.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

import numpy as np

from taut.arm.reach import reach
from taut.base.types import Array, Float64Array, Vector3
from taut.maths.chain import Chain
from taut.maths.model import Model
from taut.trace import math as tm

__all__ = ["Asked", "Beyond", "Sphere", "distance_beyond", "spheres"]

Asked = Literal["pose", "position"]
CLEAR: Final = (1.0, 1.01)  # of the radius: where a target begins to count as out of reach, and where in full
FAR: Final = (1.1, 1.2)
PARALLEL: Final = 1e-6  # of the sine between two axes


@dataclass(frozen=True, kw_only=True, eq=False)
class Sphere:
    """Where a point of the tool can be, whatever the joints do within their limits."""

    centre: Float64Array  # (3,) origin of the first joint on the chain, in the world [m]
    point: Float64Array  # (3,) in the tool's frame [m]
    radius: float  # [m]


@functools.lru_cache(maxsize=64)
def spheres(model: Model, frame: str | None, asked: Asked) -> tuple[Sphere, ...]:
    """Of the tool's origin and, where its orientation is asked for too, of a point on the last joint's axis.

    That point is the one nearest to the axis before: of a wrist whose axes meet, their centre.
    """
    chain = Chain.of(model, frame)
    if not chain.links:
        return ()
    points = [np.zeros(3)]
    if asked == "pose" and len(chain.links) > 1 and not chain.links[-1].prismatic:
        points.append(chain.R.T @ (_nearest_to_axis_before(chain) - chain.p))
    centre = chain.p_WB + chain.R_WB @ chain.links[0].p
    found = [Sphere(centre=centre, point=p, radius=reach(model.arm, chain.frame, p)) for p in points]
    return tuple(sphere for sphere in found if 0.0 < sphere.radius < np.inf)


def _nearest_to_axis_before(chain: Chain) -> Float64Array:
    """(3,) the point of the last axis that is nearest to the one before, in the last link's own frame."""
    last = chain.links[-1]
    if chain.links[-2].prismatic:
        return np.zeros(3)
    axis, origin = last.R[2], -last.R.T @ last.p  # of the joint before
    away = 1.0 - axis[2] ** 2
    along = 0.0 if away < PARALLEL**2 else (origin[2] - axis[2] * (origin @ axis)) / away
    return np.array([0.0, 0.0, along])


@dataclass(frozen=True, kw_only=True, eq=False)
class Beyond:
    """How clearly a target is out of reach: 0 where it is within all spheres, 1 where it is clearly not."""

    clear: Any  # full from a hundredth of a radius outside of one on
    far: Any  # none up to a tenth outside, full from a fifth on
    reach: float  # [m] of the tool's origin

    @classmethod
    def of(cls, all_of: tuple[Sphere, ...], p: Vector3, R: Array) -> Self:
        """That of a pose."""
        past: Any = 1.0
        for sphere in all_of:
            way = p + R @ sphere.point - sphere.centre if sphere.point.any() else p - sphere.centre
            past = tm.maximum(past, (way @ way) * (1.0 / sphere.radius**2))
        return cls(clear=_ramp(past, *CLEAR), far=_ramp(past, *FAR), reach=all_of[0].radius)


def _ramp(square: Any, start: float, full: float) -> Any:
    """0 where a square is below start^2, 1 above full^2, smooth between."""
    s = tm.clip((square - start**2) * (1.0 / (full**2 - start**2)), 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def distance_beyond(of: tuple[Sphere, ...], p: Float64Array, R: Float64Array) -> Float64Array:
    """(k,) how far at least poses p (k, 3), R (k, 3, 3) are out of reach [m]; 0 and less where nothing says so."""
    ways = [np.linalg.norm(p + R @ s.point - s.centre, axis=1) - s.radius for s in of]
    return np.max(ways, axis=0) if ways else np.full(len(p), -np.inf)
