"""The wrist's sensor: between its axes and the world's, and the wrench of what hangs beyond it.

A sensor between flange and tool reads the wrench that everything beyond it puts on the arm: contact, and the weight
and inertia of tool and payload. Wrenches are force first, in world axes at the tool's origin, in the sensor's at its
own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import UsageError
from taut.base.types import Array, Float64Array, Matrix, Vector3, Wrench
from taut.maths import dynamics as dyn
from taut.maths.model import Model, RigidBody
from taut.trace import math as tm
from taut.trace.math import cross
from taut.trace.pose import snapped


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorPlace:
    """Where a sensor S stands on the tool's body: its pose in the tool's frame E."""

    R_ES: Float64Array  # (3, 3)
    p_ES: Float64Array  # (3,) [m]

    def in_sensor(self, F_W: Wrench, R_WE: Matrix) -> Array:
        """(6,) in the sensor's axes at its origin, of a wrench in world axes at the tool's origin."""
        R_WS, r = R_WE @ self.R_ES, R_WE @ self.p_ES
        f = F_W[:3]
        return tm.array([*(R_WS.T @ f), *(R_WS.T @ (F_W[3:] - cross(r, f)))])

    def in_world(self, F_S: Wrench, R_WE: Matrix) -> Array:
        """(6,) in world axes at the tool's origin, of a wrench in the sensor's axes at its origin."""
        R_WS, r = R_WE @ self.R_ES, R_WE @ self.p_ES
        f = R_WS @ F_S[:3]
        return tm.array([*f, *(R_WS @ F_S[3:] + cross(r, f))])

    def from_tool(self, body: RigidBody) -> RigidBody:
        """A body that is given in the tool's frame, in the sensor's."""
        return body.seen_from(self.R_ES.T, -self.R_ES.T @ self.p_ES)

    def motion(self, model: Model, q: Array, v: Array, a: Array) -> tuple[Vector3, Vector3, Vector3, Vector3]:
        """Gravity, acceleration of the sensor's origin, angular velocity and angular acceleration, in its axes."""
        R_WE, J = dyn.pose(model, q).R, dyn.jacobian(model, q)
        rates = J @ a + dyn.jacobian_rate_v(model, q, v)
        omega, alpha, r = (J @ v)[3:], rates[3:], R_WE @ self.p_ES
        linear = rates[:3] + cross(alpha, r) + cross(omega, cross(omega, r))
        R_SW = (R_WE @ self.R_ES).T
        return R_SW @ model.arm.gravity, R_SW @ linear, R_SW @ omega, R_SW @ alpha


def sensor_place(arm: Arm, frame: str | None, owner: str) -> SensorPlace:
    """Place of the sensor `owner` at a frame of the body that carries the tool; at the tool if none is named."""
    tool, place = arm.frame(), arm.frame(frame)
    if place.body != tool.body:
        raise UsageError(
            f"{owner}.frame must move with the tool '{arm.tool}'; got '{place.name}', which has a joint between it "
            "and the tool; name a frame of the last body",
            name="frame",
            value=frame,
        )
    T_ES = tool.placement.inverse() @ place.placement
    if place.name == tool.name:
        return SensorPlace(R_ES=np.eye(3), p_ES=np.zeros(3))
    return SensorPlace(R_ES=snapped(T_ES.R), p_ES=np.asarray(T_ES.p, dtype=np.float64))


def load_wrench(
    body: RigidBody,
    g: Vector3,  # (3,) [m/s^2], in the frame's axes like all that follows
    a: Vector3 | None = None,  # (3,) of the frame's origin [m/s^2]; None for a frame at rest
    omega: Vector3 | None = None,  # (3,) [rad/s]
    alpha: Vector3 | None = None,  # (3,) [rad/s^2]
) -> Array:
    """(6,) wrench that a body's weight and inertia put on what carries it, at the frame's origin, in its axes.

    Law:          f = m (g - a_c),  n = c x m (g - a) - I alpha - omega x I omega
    """
    if a is None or omega is None or alpha is None:
        return tm.array([*(body.m * g), *cross(body.h, g)])
    apparent_gravity = g - a
    force = body.m * apparent_gravity - cross(alpha, body.h) - cross(omega, cross(omega, body.h))
    moment = cross(body.h, apparent_gravity) - body.I @ alpha - cross(omega, body.I @ omega)
    return tm.array([*force, *moment])
