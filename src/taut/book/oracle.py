"""What is expected of arms with several joints: two links written out by hand, and MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Final

import numpy as np
from scipy.linalg import expm

from taut.arm.description import Arm
from taut.arm.load import load_arm
from taut.base.types import ArrayLike, Float64Array
from taut.runtime.robots.mujoco.plant import MujocoPlant

__all__ = ["TWO_LINKS", "Engine", "TwoLinks", "engine", "held_radius", "panda", "two_links"]

G: Final = 9.81  # [m/s^2]


@cache
def two_links() -> Arm:
    """`planar2` without friction."""
    return load_arm("planar2").with_joints(viscous=0.0)


@cache
def panda() -> Arm:
    """The Panda of the catalogue without friction."""
    return load_arm("panda").with_joints(viscous=0.0, coulomb=0.0)


def held_radius(mass: float, damping: float, K: float, B: float, rate: float) -> float:
    """Largest modulus of the poles of a mass under u = -K x - B v, held over a tick, with v differenced."""
    T = 1.0 / rate
    held = expm(np.array([[0.0, 1.0, 0.0], [0.0, -damping / mass, 1.0 / mass], [0.0, 0.0, 0.0]]) * T)
    loop = np.zeros((3, 3))  # of x, v and the x before
    loop[:2, :2], loop[2, 0] = held[:2, :2], 1.0
    loop[:2] -= np.outer(held[:2, 2], [K + B / T, 0.0, -B / T])
    return float(np.abs(np.linalg.eigvals(loop)).max())


@dataclass(frozen=True, kw_only=True)
class TwoLinks:
    """Two solid rods on two hinges in a vertical plane, by the equations that every textbook has."""

    m1: float = 4.0  # [kg]
    m2: float = 2.0
    L1: float = 0.5  # [m]
    L2: float = 0.4
    radius: float = 0.03

    @property
    def inertias(self) -> tuple[float, float]:
        """About their own centres [kg m^2]."""
        about = [m * (3.0 * self.radius**2 + L**2) / 12.0 for m, L in ((self.m1, self.L1), (self.m2, self.L2))]
        return about[0], about[1]

    def M(self, q: Float64Array) -> Float64Array:
        """(2, 2) mass matrix."""
        I1, I2 = self.inertias
        c1, c2, cos = 0.5 * self.L1, 0.5 * self.L2, math.cos(q[1])
        both = I2 + self.m2 * (c2**2 + self.L1 * c2 * cos)
        first = I1 + self.m1 * c1**2 + I2 + self.m2 * (self.L1**2 + c2**2 + 2.0 * self.L1 * c2 * cos)
        return np.array([[first, both], [both, I2 + self.m2 * c2**2]])

    def M_rate(self, q: Float64Array, v: Float64Array) -> Float64Array:
        """(2, 2) d M / dt."""
        k = -self.m2 * self.L1 * 0.5 * self.L2 * math.sin(q[1]) * v[1]
        return np.array([[2.0 * k, k], [k, 0.0]])

    def Cv(self, q: Float64Array, v: Float64Array) -> Float64Array:
        """(2,) Coriolis and centripetal torques."""
        k = self.m2 * self.L1 * 0.5 * self.L2 * math.sin(q[1])
        return np.array([-k * (2.0 * v[0] * v[1] + v[1] ** 2), k * v[0] ** 2])

    def g(self, q: Float64Array) -> Float64Array:
        """(2,) gravity torques."""
        second = self.m2 * G * 0.5 * self.L2 * math.cos(q[0] + q[1])
        return np.array([(0.5 * self.m1 + self.m2) * self.L1 * G * math.cos(q[0]) + second, second])

    def h(self, q: Float64Array, v: Float64Array) -> Float64Array:
        """(2,) C v + g."""
        return self.Cv(q, v) + self.g(q)

    def tip(self, q: Float64Array) -> Float64Array:
        """(2,) x and z of the tool."""
        a, b = q[0], q[0] + q[1]
        return np.array(
            [self.L1 * math.cos(a) + self.L2 * math.cos(b), self.L1 * math.sin(a) + self.L2 * math.sin(b)]
        )

    def J(self, q: Float64Array) -> Float64Array:
        """(2, 2) of x and z of the tool."""
        a, b = q[0], q[0] + q[1]
        x2, z2 = -self.L2 * math.sin(b), self.L2 * math.cos(b)
        return np.array([[-self.L1 * math.sin(a) + x2, x2], [self.L1 * math.cos(a) + z2, z2]])

    def Jdot_v(self, q: Float64Array, v: Float64Array) -> Float64Array:
        """(2,) J-dot v."""
        a, b, w = q[0], q[0] + q[1], v[0] + v[1]
        one, two = self.L1 * v[0] ** 2, self.L2 * w**2
        return np.array([-one * math.cos(a) - two * math.cos(b), -one * math.sin(a) - two * math.sin(b)])

    def ik(self, tip: Float64Array) -> Float64Array:
        """(2,) the joints, the elbow below the line to the tool."""
        square = float(tip @ tip)
        cos = (square - self.L1**2 - self.L2**2) / (2.0 * self.L1 * self.L2)
        elbow = math.acos(cos)
        reach = math.atan2(self.L2 * math.sin(elbow), self.L1 + self.L2 * cos)
        return np.array([math.atan2(tip[1], tip[0]) - reach, elbow])


TWO_LINKS: Final = TwoLinks()


class Engine:
    """An arm in MuJoCo at one state: mass matrix, bias, and pose and Jacobian of the tool."""

    def __init__(self, arm: Arm) -> None:
        self._plant = MujocoPlant(arm)

    def at(self, q: ArrayLike, v: ArrayLike) -> EngineState:
        """A state."""
        import mujoco

        model = self._plant.model
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        return EngineState(model, data)


class EngineState:
    """What MuJoCo says of a state."""

    def __init__(self, model: Any, data: Any) -> None:
        self._model, self._data = model, data

    @cached_property
    def M(self) -> Float64Array:
        """(n, n) mass matrix."""
        import mujoco

        M = np.zeros((self._model.nv, self._model.nv))
        mujoco.mj_fullM(self._model, self._data, M)
        return M

    @property
    def h(self) -> Float64Array:
        """(n,) C v + g."""
        return np.array(self._data.qfrc_bias)

    @property
    def p(self) -> Float64Array:
        """(3,) of the tool."""
        return np.array(self._data.site_xpos[-1])

    @property
    def R(self) -> Float64Array:
        """(3, 3) of the tool."""
        return np.array(self._data.site_xmat[-1]).reshape(3, 3)

    def _jacobian(self, data: Any) -> Float64Array:
        import mujoco

        linear, angular = np.zeros((3, self._model.nv)), np.zeros((3, self._model.nv))
        mujoco.mj_jacSite(self._model, data, linear, angular, self._model.nsite - 1)
        return np.vstack([linear, angular])

    @cached_property
    def J(self) -> Float64Array:
        """(6, n) of the tool, linear part first, world axes."""
        return self._jacobian(self._data)

    @cached_property
    def Jdot_v(self) -> Float64Array:
        """(6,) J-dot v, by central differences along the motion."""
        import mujoco

        step, rows = 1e-5, []
        for sign in (1.0, -1.0):
            data = mujoco.MjData(self._model)
            data.qpos[:] = self._data.qpos + sign * step * self._data.qvel
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_comPos(self._model, data)
            rows.append(self._jacobian(data))
        rate: Float64Array = (rows[0] - rows[1]) / (2.0 * step) @ self._data.qvel
        return rate

    @cached_property
    def Lambda(self) -> Float64Array:
        """(6, 6) inertia at the tool."""
        made: Float64Array = np.linalg.inv(self.J @ np.linalg.solve(self.M, self.J.T))
        return made


@cache
def engine() -> Engine:
    """The Panda in MuJoCo."""
    return Engine(panda())
