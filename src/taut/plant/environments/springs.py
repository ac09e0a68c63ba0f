"""Springs and dampers between the tool and the world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from taut.base.checks import one_of
from taut.base.errors import UsageError
from taut.base.quantity import Quantity
from taut.base.types import Array, ArrayLike, Float64Array, Twist, Wrench
from taut.maths.spatial import left_jacobian_inverse, rotated, rotation_log
from taut.plant.environments.environment import Environment, Environments, added
from taut.plant.environments.numbers import Place, applied, fastest, kept_pose, replaced, spatial
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["Damper", "Spring"]

Values = Mapping[str, Any]
FRAMES: Final[tuple[Literal["world", "tool"], ...]] = ("world", "tool")
TINY: Final = 1e-12  # [m] a cord that is shorter has no direction


@dataclass(frozen=True, kw_only=True, eq=False)
class Spring:
    """A spring between the tool and a place in the world.

    Law:          F_ext = -dU/dx of U = 1/2 e^T stiffness e, with e = (p, phi) the position of the tool's origin and
                  the rotation vector of its axes, seen from the place and in its axes; so that it gives back what it
                  got, for any stiffness and any way
    Closed loop:  of mass Lambda at the tool, and nothing else: omega^2 = eig(Lambda^-1 stiffness)

    In semi-implicit steps it neither loses nor gains in the long run, but for a swing of its energy by the share
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
        ['at.p', 'at.xyzw', 'stiffness']
    """

    stiffness: ArrayLike
    at: Place = None
    slack: ArrayLike | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "stiffness", spatial("spring.stiffness", self.stiffness, "N/m", "N m/rad"))
        object.__setattr__(self, "at", kept_pose("spring.at", self.at))
        if self.slack is None:
            return
        slack = Quantity(unit="m", rule=">= 0").checked("spring.slack", self.slack)
        if np.ndim(self.stiffness) or slack.ndim:
            raise UsageError(
                "spring.slack is one number, the free length of a cord of one stiffness [N/m]; leave it out, or give "
                "stiffness=300.0",
                name="slack",
            )
        object.__setattr__(self, "slack", slack)

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        out = {"stiffness": np.asarray(self.stiffness)}
        if isinstance(self.at, Pose):
            out |= {"at.p": np.asarray(self.at.p), "at.xyzw": self.at.xyzw}
        return out if self.slack is None else out | {"slack": np.asarray(self.slack)}

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start: where the tool is, if that is where it is at rest."""
        return {} if self.at is not None else {"p": T_WE.p, "R": T_WE.R}

    def wrench(
        self,
        T_WE: Pose,
        twist: Twist,  # noqa: ARG002
        t: Any,  # noqa: ARG002
        memory: Values,
        parameters: Values,
        dt: Any,  # noqa: ARG002
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the memory as it was."""
        K = parameters["stiffness"]
        at_rest = memory["p"] if self.at is None else parameters["at.p"]
        way = T_WE.p - at_rest
        if np.ndim(K) == 0:
            if self.slack is not None:
                length = tm.maximum(tm.norm(way), TINY)
                way = way * tm.maximum(1.0 - parameters["slack"] / length, 0.0)
            return tm.array([*(-K * way), 0.0, 0.0, 0.0]), dict(memory)
        R_WA = memory["R"] if self.at is None else _rotation(parameters["at.xyzw"])
        phi = rotation_log(R_WA.T @ T_WE.R)
        pull = applied(K, tm.array([*(R_WA.T @ way), *phi]))
        moment = left_jacobian_inverse(phi).T @ pull[3:]
        return rotated(R_WA, tm.array([*(-pull[:3]), *(-moment)])), dict(memory)

    def changed(self, name: str, value: ArrayLike) -> Spring:
        """The same with another value of a parameter, checked as when it was made."""
        if name == "at.p" and isinstance(self.at, Pose):
            return replaced(self, "at", Pose(value, R=self.at.R))  # type: ignore[arg-type]
        if name == "at.xyzw" and isinstance(self.at, Pose):
            return replaced(self, "at", Pose(self.at.p, xyzw=value))  # type: ignore[arg-type]
        return replaced(self, name, value)

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """How fast the tool swings in it [rad/s]; it has no damping."""
        return float(np.sqrt(fastest(mobility, parameters["stiffness"]))), 0.0

    def __add__(self, other: Environment) -> Environments:
        return added(self, other)


def _rotation(xyzw: Array) -> Array:
    """(3, 3) of a quaternion of unit length."""
    v = tm.skew(xyzw[:3])
    return tm.eye(3) + 2.0 * (xyzw[3] * v + v @ v)  # type: ignore[no-any-return]


@dataclass(frozen=True, kw_only=True, eq=False)
class Damper:
    """A damper between the tool and the world, as of a liquid that rests.

    Law:          F_ext = -damping V, with V the twist of the tool at its origin
    Closed loop:  of mass Lambda at the tool, and nothing else: V = exp(-Lambda^-1 damping t) V0

    In semi-implicit steps it is stable while eig(Lambda^-1 damping) dt < 2; steps with more than 1 are refused.

    Args:
        damping: One number of the position alone [N s/m], (linear, angular) [N s/m, N m s/rad], six, or a matrix
            (6, 6).
        frame: The axes that it is given in: "world", or "tool" for those that turn with the tool.

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite, a matrix that is not symmetric.
        UsageError: Other axes.

    Example:
        >>> Damper(damping=(20.0, 0.5)).parameters()["damping"].tolist()
        [20.0, 20.0, 20.0, 0.5, 0.5, 0.5]
    """

    damping: ArrayLike
    frame: Literal["world", "tool"] = "world"

    def __post_init__(self) -> None:
        object.__setattr__(self, "damping", spatial("damper.damping", self.damping, "N s/m", "N m s/rad"))
        one_of("damper.frame", self.frame, FRAMES)

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        return {"damping": np.asarray(self.damping)}

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
        if self.frame == "world":
            return -applied(parameters["damping"], twist), {}
        return rotated(T_WE.R, -applied(parameters["damping"], rotated(T_WE.R.T, twist))), {}

    def changed(self, name: str, value: ArrayLike) -> Damper:
        """The same with another value of a parameter, checked as when it was made."""
        return replaced(self, name, value)

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """How fast it brakes the tool [1/s]."""
        if self.frame == "world":
            return 0.0, fastest(mobility, parameters["damping"])
        return 0.0, fastest(mobility, _bound(parameters["damping"]))

    def __add__(self, other: Environment) -> Environments:
        return added(self, other)


def _bound(gain: ArrayLike) -> Float64Array:
    """(6,) a damping in world axes that is no less than this one, however the tool is turned."""
    values = np.asarray(gain, dtype=np.float64)
    if values.ndim < 2:
        return np.repeat([values[:3].max(), values[3:].max()], 3) if values.ndim else values
    blocks = [np.linalg.eigvalsh(values[i : i + 3, i : i + 3]).max() for i in (0, 3)]
    return 2.0 * np.repeat(blocks, 3)  # of a positive matrix, twice its blocks is no less than it
