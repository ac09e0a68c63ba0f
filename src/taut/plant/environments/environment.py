"""What touches the tool of a plant: ready-made, or a class of the user's own on the same base; and disturbances."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final, Self

import numpy as np

from taut.base.errors import ShapeError, UsageError, quoted_list
from taut.base.fields import Declared
from taut.base.paths import subtree
from taut.base.types import Array, ArrayLike, Float64Array, Twist, Vector, Wrench
from taut.maths import dynamics as dyn
from taut.maths.model import Model
from taut.trace import math as tm
from taut.trace.pose import Pose

Values = Mapping[str, Any]


class Environment(Declared):
    """Base of what touches the tool, and of your own: declared fields, and one pure function.

    The wrench is that of the environment on the arm, force first, in world axes at the tool's origin. Each `Field` is
    a parameter of the plant by its path, environment.stiffness, checked by its declaration whenever it changes. A
    subclass writes `wrench`; what remembers something writes `start` too, and what oscillates or brakes fast writes
    `rates`, from which the plant knows whether its steps are short enough. `Environments` lets several act together.

    Example:
        >>> from taut.environments import Environment, Field
        >>> class Wind(Environment):
        ...     force: Field = Field(unit="N", shape=3)
        ...
        ...     def wrench(self, T_WE, twist, t, memory, parameters, dt):
        ...         return np.concatenate([parameters["force"], np.zeros(3)]), {}
        >>> sorted(Wind(force=[1.0, 0.0, 0.0]).parameters())
        ['force']
    """

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start, from the tool's pose: none."""
        return {}

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the new memory."""
        raise NotImplementedError

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """How fast the tool oscillates in it [rad/s], and how fast its damping brakes the tool [1/s]; by default 0.

        Args:
            mobility: (6, 6) acceleration of the tool per wrench, Lambda^-1; zero for a tool that nothing moves.
            parameters: Current values by name.
        """
        return 0.0, 0.0


class Environments(Environment):
    """Several environments at once, which act on the tool together.

    Law:          F_ext = F_1 + F_2 + ...

    Args:
        parts: The environments by name; a run-time parameter is environment.NAME.stiffness.

    Raises:
        UsageError: No part, or one that is no environment.

    Example:
        >>> import taut
        >>> rope, water = taut.environments.Spring(stiffness=300.0), taut.environments.Damper(damping=20.0)
        >>> both = Environments(rope=rope, water=water)
        >>> sorted(both.parameters())
        ['rope.stiffness', 'water.damping']
    """

    parts: ClassVar[Mapping[str, Environment]]

    def __init__(self, **parts: Environment) -> None:
        if not parts:
            raise UsageError(
                "taut.environments.Environments needs one part at least: "
                "taut.environments.Environments(wall=taut.environments.StiffWall(...))"
            )
        for name, part in parts.items():
            require_environment(name, part)
        self.__dict__.update(parts=dict(parts), _specified=frozenset())

    def declared_parts(self) -> dict[str, Declared]:
        """The environments by name."""
        return dict(self.parts)

    def _with_parts(self, parts: Mapping[str, Any]) -> Self:
        return self._replaced({"parts": {**self.parts, **parts}})

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start, from the tool's pose."""
        started = {name: part.start(T_WE) for name, part in self.parts.items()}
        return {f"{name}.{key}": x for name, memory in started.items() for key, x in memory.items()}

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the new memory."""
        total: Any = np.zeros(6)
        after: dict[str, Any] = {}
        for name, part in self.parts.items():
            before = subtree(memory, name)
            wrench, new = _sound(part, part.wrench(T_WE, twist, t, before, subtree(parameters, name), dt), before)
            total = total + wrench
            after |= {f"{name}.{key}": x for key, x in new.items()}
        return total, after

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """Of all parts at once, which act side by side."""
        found = [part.rates(mobility, subtree(parameters, name)) for name, part in self.parts.items()]
        return float(np.sqrt(sum(omega**2 for omega, _ in found))), float(sum(damping for _, damping in found))

    def __repr__(self) -> str:
        return f"Environments({', '.join(f'{name}={part!r}' for name, part in self.parts.items())})"


def require_environment(name: str, what: object) -> None:
    """Refuse what is no environment."""
    if not isinstance(what, Environment):
        got = what.__name__ if isinstance(what, type) else type(what).__name__
        raise UsageError(
            f"{name} must be a taut.environments.Environment, or a class on that base; got {got}", name=name
        )
    if type(what).wrench is Environment.wrench:
        raise UsageError(f"{type(what).__name__} has no wrench(T_WE, twist, t, memory, parameters, dt)", name=name)


def touch(
    environment: Environment, model: Model, q: Vector, v: Vector, memory: Values, parameters: Values, t: Any, dt: Any
) -> tuple[Array, dict[str, Any]]:
    """(6,) F_ext at a state of an arm, and the environment's memory after a step of dt, by name."""
    given = environment.wrench(dyn.pose(model, q), dyn.twist(model, q, v), t, memory, parameters, dt)
    return _sound(environment, given, memory)


def _sound(environment: Environment, given: Any, before: Values) -> tuple[Any, dict[str, Any]]:
    """The wrench and the memory that an environment gave, if it gave these."""
    who = type(environment).__name__
    if not isinstance(given, (tuple, list)) or len(given) != 2 or not isinstance(given[1], Mapping):
        raise UsageError(
            f"{who}.wrench must give the wrench and the new memory: return F, {{}}; got {type(given).__name__}",
            name=who,
        )
    wrench, after = given
    if np.shape(wrench) != (6,):
        raise ShapeError(f"{who}.wrench must give shape (6,), force first; got shape {np.shape(wrench)}", name=who)
    if set(after) != set(before):
        raise UsageError(
            f"{who}.wrench must give back the memory that {who}.start made, {quoted_list(sorted(before))}; got "
            f"{quoted_list(sorted(after)) or 'none'}",
            name=who,
        )
    return wrench, dict(after)


def applied(gain: Array, six: Any) -> Array:
    """(6,) a stiffness or damping, of the position alone where it is one number, times a displacement or twist."""
    if np.ndim(gain) == 0:
        return tm.array([*(gain * six[:3]), 0.0, 0.0, 0.0])
    return gain @ six if np.ndim(gain) == 2 else gain * six  # type: ignore[no-any-return]


def fastest(mobility: Float64Array, gain: ArrayLike) -> float:
    """The largest eigenvalue of mobility times a stiffness [1/s^2] or a damping [1/s]."""
    values = np.asarray(gain, dtype=np.float64)
    if values.ndim == 0:
        values = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * values
    matrix = np.diag(values) if values.ndim == 1 else values
    return float(np.max(np.linalg.eigvals(mobility @ matrix).real, initial=0.0))


# Disturbances act on a loop from outside, beside its environment, in a study of it: inputs of a tick, held constant,
# that a loop takes where it is given them; a run has none.

COMMAND: Final = "disturbance.command"  # (n,) added to what the law commands, before the drives
TORQUE: Final = "disturbance.torque"  # (n,) on the joints [N m | N]
WRENCH: Final = "disturbance.wrench"  # (6,) on the tool, force first, in world axes [N, N m]


def disturbance_shapes(n: int) -> dict[str, tuple[int, ...]]:
    """The shape of each, for an arm of n joints."""
    return {COMMAND: (n,), TORQUE: (n,), WRENCH: (6,)}


def of_plant(inputs: Values) -> dict[str, Any]:
    """Those of a tick's inputs that act behind the drives, which a plant takes among its parameters."""
    return {path: inputs[path] for path in (TORQUE, WRENCH) if path in inputs}


def joint_forces(model: Model, q: Vector, wrench: Array | None, parameters: Values) -> Array | None:
    """(n,) what a wrench at the tool, and a disturbance, put on the joints; None where there is neither."""
    torque: Array | None = parameters.get(TORQUE)
    if wrench is None:
        return torque
    force: Array = dyn.jacobian(model, q).T @ wrench
    return force if torque is None else force + torque
