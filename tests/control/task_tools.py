"""What tests of task space share: smooth motions of an arm and of a target, with their rates in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

import taut
from taut.base.types import Float64Array
from taut.maths.spatial import rotation_exp

Array = Float64Array


@dataclass(frozen=True)
class JointPath:
    """q(t) = q0 + sum of sines, with its rates."""

    q0: Array
    size: Array
    omega: Array
    phase: Array

    @classmethod
    def random(cls, arm: taut.Arm, rng: np.random.Generator) -> JointPath:
        return cls(
            np.array(arm.home) + 0.3 * rng.standard_normal(arm.n),
            rng.uniform(0.1, 0.5, arm.n),
            rng.uniform(0.5, 2.0, arm.n),
            rng.uniform(0.0, 6.0, arm.n),
        )

    def at(self, t: float) -> tuple[Array, Array, Array]:
        s, c = np.sin(self.omega * t + self.phase), np.cos(self.omega * t + self.phase)
        return self.q0 + self.size * s, self.size * self.omega * c, -self.size * self.omega**2 * s


@dataclass(frozen=True)
class Target:
    """R(t) = exp(a t) R0 exp(b t) and p(t) = p0 + c t + d sin t: angular velocity a + exp(a t) R0 b, world axes."""

    p0: Array
    R0: Array
    a: Array
    b: Array
    c: Array
    d: Array

    @classmethod
    def random(cls, T: taut.Pose, rng: np.random.Generator, away: float = 0.5) -> Target:
        """One that starts near a pose."""
        a, b, c, d = rng.standard_normal((4, 3))
        R = rotation_exp(away * rng.standard_normal(3)) @ T.R
        return cls(T.p + 0.5 * away * rng.standard_normal(3), R, a, b, c, d)

    def at(self, t: float) -> taut.TaskMotion:
        turned = rotation_exp(self.a * t) @ self.R0
        w, w_dot = self.a + turned @ self.b, np.cross(self.a, turned @ self.b)
        pose = taut.Pose.of(turned @ rotation_exp(self.b * t), self.p0 + self.c * t + self.d * np.sin(t))
        return taut.TaskMotion(
            pose=pose,
            twist=[*(self.c + self.d * np.cos(t)), *w],
            acceleration=[*(-self.d * np.sin(t)), *w_dot],
        )


def se3(T: taut.Pose) -> pin.SE3:
    return pin.SE3(np.array(T.R), np.array(T.p))
