"""Where an arm's joints and its tool are, frame by frame, and from where to look at it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from taut.arm.description import BASE, Arm
from taut.base.types import Float64Array, Rotation
from taut.maths import dynamics
from taut.maths.model import model_of
from taut.trace.pose import axis_angle

__all__ = ["Skeleton", "View", "upright"]

FIELD_OF_VIEW: Final = 45.0  # [deg] of the camera, upwards
MARGIN: Final = 1.25  # of the picture around the arm
FREE: Final = 0.25  # of the radius: room under an arm that would reach into the ground
SMALLEST: Final = 0.05  # [m] radius of what is looked at
PARALLEL: Final = 1e-3


@dataclass(frozen=True, kw_only=True)
class View:
    """A camera that looks at a point, in a world whose z axis points up."""

    centre: Float64Array  # (3,) [m]
    radius: float  # [m] of a ball about the centre that is all seen
    azimuth: float  # [deg] of the direction of view, from x towards y
    elevation: float  # [deg] of the direction of view, upwards
    floor: float  # [m] height of the floor

    def distance(self, width: int, height: int) -> float:
        """[m] from the camera to the centre, so that a picture of this size shows the ball."""
        half = math.radians(0.5 * FIELD_OF_VIEW)
        half = min(half, math.atan(math.tan(half) * width / height))
        return self.radius / math.sin(half)


@dataclass(frozen=True, kw_only=True, eq=False)
class Skeleton:
    """Origins of an arm's bodies and its tool, for many joint positions.

    Frames: a world whose z axis points up, whatever the arm's own world looks like.
    """

    arm: Arm
    origins: Float64Array  # (k, n, 3) [m] of each joint's body
    tool: Float64Array  # (k, 3) [m]
    base: Float64Array  # (3,) [m]

    @classmethod
    def of(cls, arm: Arm, q: Float64Array) -> Skeleton:
        """At joint positions (k, n)."""
        model, R = model_of(arm), upright(arm)
        origins = np.empty((len(q), arm.n, 3))
        tool = np.empty((len(q), 3))
        frame = model.placement(None)
        for k, row in enumerate(q):
            links = dynamics.link_poses(model, row)
            for i, (_, p) in enumerate(links):
                origins[k, i] = p
            R_W, p_W = (model.R_WB, model.p_WB) if frame[0] == BASE else links[frame[0]]
            tool[k] = R_W @ frame[2] + p_W
        return cls(arm=arm, origins=origins @ R.T, tool=tool @ R.T, base=R @ arm.T_WB.p)

    @cached_property
    def bones(self) -> list[tuple[int, int]]:
        """Pairs of points that a link joins: numbers of joints, -1 for the base, n for the tool."""
        pairs = [(joint.parent, i) for i, joint in enumerate(self.arm.joints)]
        return [*pairs, (self.arm.frame().body, self.arm.n)]

    def points(self) -> Float64Array:
        """(k, n + 2, 3) [m]: the base, the joints, the tool. Point i + 1 is joint i."""
        base = np.broadcast_to(self.base, (len(self.tool), 1, 3))
        return np.concatenate([base, self.origins, self.tool[:, np.newaxis]], axis=1)

    def view(self) -> View:
        """A view of all that the arm does."""
        points = self.points().reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        centre = 0.5 * (low + high)
        radius = max(SMALLEST, float(np.linalg.norm(points - centre, axis=1).max()))
        azimuth, elevation = self._direction()
        buried = self.origins[..., 2].min() < 0.02 * radius or self.tool[:, 2].min() < -0.02 * radius
        floor = min(0.0, float(low[2])) - FREE * radius if buried else 0.0
        return View(centre=centre, radius=MARGIN * radius, azimuth=azimuth, elevation=elevation, floor=floor)

    def _direction(self) -> tuple[float, float]:
        """Azimuth and elevation [deg]: across the plane of an arm that moves in one, else from ahead and above."""
        hinges = [i for i, joint in enumerate(self.arm.joints) if joint.kind != "prismatic"]
        model = model_of(self.arm)
        links = dynamics.link_poses(model, np.zeros(self.arm.n))
        axes = np.array([upright(self.arm) @ links[i][0][:, 2] for i in hinges])
        if not hinges or np.abs(np.cross(axes, axes[0])).max() > PARALLEL:
            return 145.0, -20.0
        axis = axes[0]
        if abs(axis[2]) > 0.7:
            return 90.0, -60.0
        ahead = axis if axis[1] > 0.0 or (axis[1] == 0.0 and axis[0] < 0.0) else -axis  # x goes to the right
        return math.degrees(math.atan2(ahead[1], ahead[0])), -8.0


def upright(arm: Arm) -> Rotation:
    """(3, 3) turns the arm's world so that gravity pulls along -z; the identity without gravity."""
    size = float(np.linalg.norm(arm.gravity))
    if size == 0.0:
        return np.eye(3)
    up = -arm.gravity / size
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    if sine < PARALLEL:
        return np.eye(3) if up[2] > 0.0 else np.diag([1.0, -1.0, -1.0])
    return axis_angle(axis / sine, math.atan2(sine, up[2]))
