"""Virtual objects: walls, grooves and balls in the air, as laws that add to others.

Each is a spring, whose force is the gradient of its energy and begins from zero at the surface, with a damper that
acts inside only. What it adds to a law is J^T f, the torque of a force at the tool's origin.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Vector, Vector3
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, GainValue
from taut.control.law import Law
from taut.control.trajectories.reference import Sample
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

NEAR: Final = 1e-9  # [m] from the centre of a ball, where no direction leads out


class VirtualWall(Law):
    """A wall in the air: it pushes the tool back, out of the half-space behind it. Add it to another law.

    Law:          tau = J^T n max(0, K d - B s n . v),  d = n . (point - p) the depth, s = min(d / fade, 1)
    Closed loop:  that of the law it adds to, with K d n on the tool as long as d > 0; it never pulls

    The spring is the gradient of K d^2 / 2; damping fades in over the first `fade` of depth. Sampled with the period
    T it is passive where the arm's own damping along the normal is at least K T / 2 + B.

    Args:
        point: A point of the wall, world axes.
        normal: Towards the free side; any length.
        fade: Depth over which the damping comes in.
        tool: The frame whose origin it is for; the arm's tool if left out.

    Example:
        >>> import taut
        >>> law = taut.laws.GravityCompensation() + VirtualWall(point=[0, 0, 0.2], normal=[0, 0, 1], K=2e3, B=10.0)
        >>> ctrl = taut.compile(law, taut.load_arm("panda"))

    References:
        Section 10.5 impedance control, the virtual environments of figure 10.17. Colgate and Schenkel (1997), Journal
        of Robotic Systems 14 (1), on passivity.
    """

    ignores_reference = True
    point: Gain = Gain(unit="m", shape=3, accepts=(), minimum=-np.inf)
    normal: Gain = Gain(unit="1", shape=3, accepts=(), minimum=-np.inf)
    K: Gain = Gain(shape="scalar", unit="N/m")
    B: Gain = Gain(0.0, shape="scalar", unit="N s/m")
    fade: Gain = Gain(1e-3, unit="m", shape="scalar", above=0.0)
    tool: str | None = None

    def check(self) -> None:
        _check_direction(self, "normal")

    def command(self, x: Snapshot, ref: Sample) -> Command:  # noqa: ARG002
        n = _unit(self.normal)
        depth = n @ (self.point.as_array() - x.T(self.tool).p)
        return _pushed(x, self.tool, n, depth, self.K, self.B, self.fade, "wall")


class VirtualGroove(Law):
    """A groove in the air: it draws the tool to a line, along which it is free. Add it to another law.

    Law:          tau = -J^T P (K (p - point) + B v),  P = I - u u^T across the direction u
    Closed loop:  that of the law it adds to, with the spring K and the damper B across the line

    The spring is the gradient of K r . r / 2 with r = P (p - point). Sampled with the period T it is passive where
    the arm's own damping across the line is at least K T / 2 + B.

    Args:
        point: A point of the line, world axes.
        direction: Of the line; any length.
        tool: The frame whose origin it is for; the arm's tool if left out.

    References:
        Section 10.5 impedance control. Rosenberg (1993), IEEE VRAIS, virtual fixtures.
    """

    ignores_reference = True
    point: Gain = Gain(unit="m", shape=3, accepts=(), minimum=-np.inf)
    direction: Gain = Gain(unit="1", shape=3, accepts=(), minimum=-np.inf)
    K: Gain = Gain(shape="scalar", unit="N/m")
    B: Gain = Gain(0.0, shape="scalar", unit="N s/m")
    tool: str | None = None

    def check(self) -> None:
        _check_direction(self, "direction")

    def command(self, x: Snapshot, ref: Sample) -> Command:  # noqa: ARG002
        u, J = _unit(self.direction), x.J(self.tool)[:3]
        offset, v = x.T(self.tool).p - self.point.as_array(), J @ x.v
        spring = -self.K.as_array() * (offset - (u @ offset) * u)
        damper = -self.B.as_array() * (v - (u @ v) * u)
        return Torque(J.T @ Terms(groove=spring, groove_damping=damper))


class VirtualBall(Law):
    """A soft ball in the air: it keeps the tool's origin out of it, or in it with inside=True. Add it to another law.

    Law:          tau = J^T n max(0, K d - B s n . v),  d = radius - r at the distance r from the center, n outwards
                  inside=True: d and n have the other sign;  s = min(d / fade, 1)
    Closed loop:  that of the law it adds to, with K d n on the tool as long as d > 0; it never pulls

    The spring is the gradient of K d^2 / 2; damping fades in over the first `fade` of depth. Sampled with the period
    T it is passive where the arm's own damping is at least K T / 2 + B; but at the very center of a ball that keeps
    out, where its push of K radius reverses at once.

    Args:
        center: Of the ball, world axes.
        radius: Of the ball.
        fade: Depth over which the damping comes in.
        inside: Whether the tool is kept in it.
        tool: The frame whose origin it is for; the arm's tool if left out.

    References:
        Section 10.5 impedance control, the virtual environments of figure 10.17.
    """

    ignores_reference = True
    center: Gain = Gain(unit="m", shape=3, accepts=(), minimum=-np.inf)
    radius: Gain = Gain(shape="scalar", unit="m")
    K: Gain = Gain(shape="scalar", unit="N/m")
    B: Gain = Gain(0.0, shape="scalar", unit="N s/m")
    fade: Gain = Gain(1e-3, unit="m", shape="scalar", above=0.0)
    inside: bool = False
    tool: str | None = None

    def command(self, x: Snapshot, ref: Sample) -> Command:  # noqa: ARG002
        offset = x.T(self.tool).p - self.center.as_array()
        far = tm.sqrt(offset @ offset + NEAR * NEAR)
        n, depth = offset / far, self.radius.as_array() - far
        if self.inside:
            n, depth = -n, -depth
        return _pushed(x, self.tool, n, depth, self.K, self.B, self.fade, "ball")


def _pushed(
    x: Snapshot, tool: str | None, n: Vector3, depth: Any, K: GainValue, B: GainValue, fade: GainValue, name: str
) -> Torque:
    """The torque of a spring of the depth and of a damper inside, along n, that never pull."""
    J = x.J(tool)[:3]
    inside = tm.maximum(depth, 0.0)
    spring = K.as_array() * inside
    damper = -B.as_array() * tm.minimum(inside / fade.as_array(), 1.0) * (n @ (J @ x.v))
    damper = tm.maximum(damper, -spring)
    along: Vector = J.T @ n
    return Torque(Terms(**{name: along * spring, f"{name}_damping": along * damper}))


def _unit(direction: GainValue) -> Vector3:
    d = direction.as_array()
    return d / tm.sqrt(d @ d)  # type: ignore[no-any-return]


def _check_direction(law: Law, name: str) -> None:
    """A direction has a length."""
    values = np.asarray(getattr(law, name), dtype=np.float64)
    if float(np.linalg.norm(values)) < NEAR:
        law.refuse(name, f"must be a direction, of any length but zero; got {values.tolist()}", RangeError)
