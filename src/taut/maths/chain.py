"""Chain: the joints from the base to one frame, and where they put it, for many joint positions at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taut.arm.description import BASE
from taut.base.types import Float64Array, Matrix3, Point3
from taut.maths.model import Model

__all__ = ["Chain", "Link"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Link:
    """One joint of a chain, with its axis on z."""

    joint: int
    prismatic: bool
    R: Matrix3  # orientation in the frame before, at q = 0
    p: Point3  # [m]


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """What is between the world and one frame of an arm: plain numbers, which a log can keep."""

    frame: str
    n: int  # joints of the arm, not all of which need be in the chain
    R_WB: Matrix3
    p_WB: Point3  # [m]
    links: tuple[Link, ...]
    R: Matrix3  # of the frame behind the last link
    p: Point3  # [m]

    @classmethod
    def of(cls, model: Model, frame: str | None) -> Chain:
        """The chain to a frame of an arm; to its tool if none is named."""
        body, R, p = model.placement(frame)
        links = []
        while body != BASE:
            joint = model.joints[body]
            links.append(Link(joint=body, prismatic=joint.prismatic, R=joint.R, p=joint.p))
            body = joint.parent
        name = model.arm.frame(frame).name
        return cls(frame=name, n=model.n, R_WB=model.R_WB, p_WB=model.p_WB, links=tuple(reversed(links)), R=R, p=p)

    def poses(self, q: Float64Array) -> tuple[Float64Array, Float64Array]:
        """R (k, 3, 3) and p (k, 3) of the frame in the world, at joint positions (k, n)."""
        return self._walked(q)[0]

    def jacobians(self, q: Float64Array) -> Float64Array:
        """(k, 6, n) Jacobians of the frame, linear part first, world axes: J_WE_W."""
        (_, p), axes = self._walked(q)
        J = np.zeros((len(q), 6, self.n))
        for link, (z, origin) in zip(self.links, axes, strict=True):
            J[:, :3, link.joint] = z if link.prismatic else np.cross(z, p - origin)
            if not link.prismatic:
                J[:, 3:, link.joint] = z
        return J

    def _walked(
        self, q: Float64Array
    ) -> tuple[tuple[Float64Array, Float64Array], list[tuple[Float64Array, Float64Array]]]:
        """The frame, and the axis and origin of each joint on the way, all in the world."""
        R, p = np.broadcast_to(self.R_WB, (len(q), 3, 3)), np.broadcast_to(self.p_WB, (len(q), 3))
        axes = []
        for link in self.links:
            p, R = p + R @ link.p, R @ link.R
            z, x = R[:, :, 2], q[:, link.joint]
            axes.append((z, p))
            if link.prismatic:
                p = p + z * x[:, np.newaxis]
            else:
                R = _turned_about_z(R, x)
        return (R @ self.R, p + R @ self.p), axes


def _turned_about_z(R: Float64Array, angle: Float64Array) -> Float64Array:
    c, s = np.cos(angle)[:, np.newaxis], np.sin(angle)[:, np.newaxis]
    x, y = R[:, :, 0], R[:, :, 1]
    return np.stack([c * x + s * y, c * y - s * x, R[:, :, 2]], axis=2)
