"""Springs, dampers and walls between the tool and the world."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.base.checks import finite_array
from taut.base.errors import RangeError, UsageError
from taut.base.fields import Declared, Field, Part
from taut.base.types import ArrayLike, Float64Array, Twist, Wrench
from taut.maths.spatial import left_jacobian_inverse, rotated, rotation_log
from taut.plant.environments.environment import Environment, applied, fastest
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["Damper", "Spring", "StiffWall"]

Values = Mapping[str, Any]
TINY: Final = 1e-12  # [m] a cord that is shorter has no direction


def pose_or_point(place: Pose | ArrayLike) -> Pose:
    """A pose; a point has the axes of the world."""
    if isinstance(place, str):
        raise UsageError(f"at must be a taut.Pose or a point (3,) [m]; got {place!r}", name="at")
    return place if isinstance(place, Pose) else Pose(finite_array("at", place, shape=(3,), unit="m"))


def unit_vector(direction: ArrayLike) -> Float64Array:
    """(3,) a direction of unit length."""
    normal = finite_array("normal", direction, shape=(3,))
    length = float(np.linalg.norm(normal))
    if length < 1e-9:
        raise RangeError(f"normal must have a length, as [0, 0, 1] for a floor; got {normal.tolist()}", name="normal")
    out: Float64Array = normal / length
    return out


class Spring(Environment):
    """A spring between the tool and a place in the world.

    Law:          F_ext = -dU/dx of U = 1/2 e^T stiffness e, with e = (p, phi) the position of the tool's origin and
                  the rotation vector of its axes, seen from the place and in its axes; so that it gives back what it
                  got, for any stiffness and any way
    Closed loop:  of mass Lambda at the tool, and nothing else: omega^2 = eig(Lambda^-1 stiffness)

    In semi-implicit steps it neither loses nor gains in the long run, but its energy oscillates by the fraction
    omega dt / 2; it is stable while omega^2 dt^2 < 4, and steps with more than 2 are refused.

    Args:
        stiffness: One number of the position alone [N/m], (linear, angular) [N/m, N m/rad], six, or a matrix (6, 6),
            in the axes of `at`.
        at: Where it is at rest: a Pose, or a point [m] for the axes of the world; where the tool starts if left out.
        slack: Free length [m] of a cord: one that pulls beyond it and never pushes. For one number of stiffness.

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite, a matrix that is not symmetric.
        UsageError: A free length of a spring with several stiffnesses.

    Example:
        >>> import taut
        >>> spring = Spring(stiffness=(500.0, 20.0), at=taut.Pose([0.4, 0.0, 0.3]))
        >>> sorted(spring.parameters())
        ['stiffness']
    """

    stiffness: Field = Field(unit="N/m | N m/rad", shape=6, accepts=("scalar", "pair", "matrix"), minimum=0.0)
    at: Part[Pose | None] = Part(Pose, optional=True, convert=pose_or_point)
    slack: Field = Field(unit="m", minimum=0.0, optional=True)

    def check(self) -> None:
        """A cord has one stiffness."""
        if self.slack is not None and np.ndim(self.stiffness):
            self.refuse(
                "slack", "is the free length of a cord of one stiffness [N/m]; leave it out, or give stiffness 300"
            )

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start: where the tool is, if that is where it is at rest."""
        return {} if self.at is not None else {"p": T_WE.p, "R": T_WE.R}

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the memory as it was."""
        K = parameters["stiffness"]
        at_rest, R_WA = (memory["p"], memory["R"]) if self.at is None else (self.at.p, self.at.R)
        way = T_WE.p - at_rest
        if np.ndim(K) == 0:
            if self.slack is not None:
                length = tm.maximum(tm.norm(way), TINY)
                way = way * tm.maximum(1.0 - parameters["slack"] / length, 0.0)
            return tm.array([*(-K * way), 0.0, 0.0, 0.0]), dict(memory)
        phi = rotation_log(R_WA.T @ T_WE.R)
        pull = applied(K, tm.array([*(R_WA.T @ way), *phi]))
        moment = left_jacobian_inverse(phi).T @ pull[3:]
        return rotated(R_WA, tm.array([*(-pull[:3]), *(-moment)])), dict(memory)

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """Natural frequency of the tool in it [rad/s]; it has no damping."""
        return float(np.sqrt(fastest(mobility, parameters["stiffness"]))), 0.0


class Damper(Environment):
    """A damper between the tool and the world, as of a liquid that rests.

    Law:          F_ext = -damping V, with V the twist of the tool at its origin
    Closed loop:  of mass Lambda at the tool, and nothing else: V = exp(-Lambda^-1 damping t) V0

    In semi-implicit steps it is stable while eig(Lambda^-1 damping) dt < 2; steps with more than 1 are refused.

    Args:
        damping: One number of the position alone [N s/m], (linear, angular) [N s/m, N m s/rad], six, or a matrix
            (6, 6), in world axes.

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite, a matrix that is not symmetric.

    Example:
        >>> Damper(damping=(20.0, 0.5)).parameters()["damping"].tolist()
        [20.0, 20.0, 20.0, 0.5, 0.5, 0.5]
    """

    damping: Field = Field(unit="N s/m | N m s/rad", shape=6, accepts=("scalar", "pair", "matrix"), minimum=0.0)

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm."""
        return -applied(parameters["damping"], twist), {}

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """How fast it brakes the tool [1/s]."""
        return 0.0, fastest(mobility, parameters["damping"])


class StiffWall(Environment):
    """A half-space that the tool's origin can be pressed into: a stiff surface that pushes and never pulls.

    Law:          N = max(0, stiffness d + s damping d_dot) where the depth d is above 0, else 0
                  s rises smoothly from 0 to 1 while d goes from 0 to onset, so that N begins without a jump
                  F_ext = N normal - min(sliding_damping, friction N / |v_t|) v_t, with v_t the speed along it
    Closed loop:  of mass Lambda pressed in deeper than onset, and nothing else:
                  d_ddot + (damping / Lambda) d_dot + (stiffness / Lambda) d = 0

    Coulomb friction is one that creeps: below the speed friction N / sliding_damping it is viscous.

    Stable while (stiffness dt^2 + 2 damping dt) / Lambda < 4; steps with more than 2 are refused. A wall that takes
    the state at the beginning of each step may give back more than it got, at most stiffness (v dt)^2 / 2 in a
    contact; with damping >= stiffness dt / 2, as for Colgate's sampled wall, it does not.

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

    point: Field = Field(unit="m", shape=3)
    normal: Field = Field(unit="1", shape=3, convert=unit_vector)
    stiffness: Field = Field(unit="N/m", above=0.0, hint="for free space leave the wall out")
    damping: Field = Field(0.0, unit="N s/m", minimum=0.0)
    onset: Field = Field(1e-4, unit="m", above=0.0, hint="1e-6 is nearly none")
    friction: Field = Field(unit="1", minimum=0.0, optional=True)
    sliding_damping: Field = Field(300.0, unit="N s/m", above=0.0, hint="for no friction leave friction out")

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name; without friction none of it."""
        own = Declared.parameters(self)
        return own if self.friction is not None else {name: x for name, x in own.items() if name != "sliding_damping"}

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
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

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """Natural frequency of the tool in it [rad/s], and how fast it brakes the tool [1/s]."""
        n = np.asarray(parameters["normal"])
        across, flat = np.zeros((6, 6)), np.zeros((6, 6))
        across[:3, :3] = np.outer(n, n)
        damping = parameters["damping"] * across
        if self.friction is not None:
            flat[:3, :3] = np.eye(3) - np.outer(n, n)
            damping = damping + parameters["sliding_damping"] * flat
        omega = np.sqrt(fastest(mobility, parameters["stiffness"] * across))
        return float(omega), fastest(mobility, damping)
