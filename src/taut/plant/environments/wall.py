"""A stiff wall before the tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from taut.base.checks import finite_array, read_only
from taut.base.errors import RangeError
from taut.base.quantity import Quantity
from taut.base.types import ArrayLike, Float64Array, Twist, Wrench
from taut.plant.environments.environment import Environment, Environments, added
from taut.plant.environments.numbers import fastest, keep_axes, replaced
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["StiffWall"]

Values = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class StiffWall:
    """A half-space that the tool's origin can be pressed into: a stiff surface that pushes and never pulls.

    Law:          N = max(0, stiffness d + s damping d_dot) where the depth d is above 0, else 0
                  s rises smoothly from 0 to 1 while d goes from 0 to onset, so that N begins without a jump
                  F_ext = N normal - min(sliding_damping, friction N / |v_t|) v_t, with v_t the speed along it
    Closed loop:  of mass Lambda pressed in deeper than onset, and nothing else:
                  d_ddot + (damping / Lambda) d_dot + (stiffness / Lambda) d = 0

    Coulomb friction is one that creeps: below the speed friction N / sliding_damping it is viscous.

    Stable while (stiffness dt^2 + 2 damping dt) / Lambda < 4; steps with more than 2 are refused. A wall that is felt
    at the beginning of each step only may give back more than it got, at most stiffness (v dt)^2 / 2 in a contact;
    with damping >= stiffness dt / 2, as for Colgate's sampled wall, it does not.

    Args:
        point: (3,) [m] any point of its surface, in world axes.
        normal: (3,) its direction towards free space, of any length, in world axes.
        stiffness: [N/m].
        damping: [N s/m].
        onset: Depth [m] at which damping and friction are all there.
        friction: Coefficient of Coulomb friction; none if left out.
        sliding_damping: How steeply friction rises with speed [N s/m].

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite; a normal without length.

    Example:
        >>> wall = StiffWall(point=[0.5, 0.0, 0.0], normal=[-1.0, 0.0, 0.0], stiffness=1e4, damping=100.0)
        >>> sorted(wall.parameters())
        ['damping', 'normal', 'onset', 'point', 'stiffness']

    References:
        Colgate and Schenkel, Passivity of a class of sampled-data systems, Journal of Robotic Systems 14 (1997).
        Hunt and Crossley, Coefficient of restitution interpreted as damping in vibroimpact, ASME Journal of Applied
        Mechanics 42 (1975).
    """

    title: ClassVar[str] = "wall"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "stiffness": Quantity(unit="N/m", rule="> 0", instead="for free space leave the wall out"),
        "damping": Quantity(unit="N s/m", rule=">= 0"),
        "onset": Quantity(unit="m", rule="> 0", instead="1e-6 is nearly none"),
        "friction": Quantity(unit="1", rule=">= 0"),
        "sliding_damping": Quantity(unit="N s/m", rule="> 0", instead="for no friction leave friction out"),
    }

    point: ArrayLike
    normal: ArrayLike
    stiffness: ArrayLike
    damping: ArrayLike = 0.0
    onset: ArrayLike = 1e-4
    friction: ArrayLike | None = None
    sliding_damping: ArrayLike = 300.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", finite_array("wall.point", self.point, shape=(3,), unit="m"))
        normal = finite_array("wall.normal", self.normal, shape=(3,))
        length = float(np.linalg.norm(normal))
        if length < 1e-9:
            raise RangeError(
                f"wall.normal must have a length, as [0, 0, 1] for a floor; got {normal.tolist()}", name="normal"
            )
        object.__setattr__(self, "normal", read_only(normal / length))
        keep_axes(self)

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        names = ["point", "normal", "stiffness", "damping", "onset"]
        names += [] if self.friction is None else ["friction", "sliding_damping"]
        return {name: np.asarray(getattr(self, name)) for name in names}

    def start(self, T_WE: Pose) -> dict[str, Any]:  # noqa: ARG002
        """It remembers nothing."""
        return {}

    def wrench(
        self,
        T_WE: Pose,
        twist: Twist,
        t: Any,  # noqa: ARG002
        memory: Values,  # noqa: ARG002
        parameters: Values,
        dt: Any,  # noqa: ARG002
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm."""
        p, n, v = parameters, parameters["normal"], twist[:3]
        depth, inwards = n @ (p["point"] - T_WE.p), -(n @ v)
        share = tm.clip(depth / p["onset"], 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        N = tm.where(depth > 0.0, tm.maximum(p["stiffness"] * depth + share * p["damping"] * inwards, 0.0), 0.0)
        force = N * n
        if self.friction is not None:
            along = v + inwards * n
            speed = tm.maximum(tm.norm(along), 1e-12)
            force = force - tm.minimum(share * p["sliding_damping"], p["friction"] * N / speed) * along
        return tm.array([*force, 0.0, 0.0, 0.0]), {}

    def changed(self, name: str, value: ArrayLike) -> StiffWall:
        """The same with another value of a parameter, checked as when it was made."""
        return replaced(self, name, value)

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """How fast the tool swings in it [rad/s], and how fast it brakes the tool [1/s]."""
        n = np.asarray(parameters["normal"])
        across, flat = np.zeros((6, 6)), np.zeros((6, 6))
        across[:3, :3] = np.outer(n, n)
        damping = parameters["damping"] * across
        if self.friction is not None:
            flat[:3, :3] = np.eye(3) - np.outer(n, n)
            damping = damping + parameters["sliding_damping"] * flat
        omega = np.sqrt(fastest(mobility, parameters["stiffness"] * across))
        return float(omega), fastest(mobility, damping)

    def __add__(self, other: Environment) -> Environments:
        return added(self, other)
