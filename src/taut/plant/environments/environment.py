"""What touches the tool of a plant: ready-made, or a class of the user's own with the methods of `Environment`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from taut.base.checks import finite_array, float_array
from taut.base.errors import ShapeError, UsageError, quoted_list
from taut.base.fields import Declared
from taut.base.paths import subtree
from taut.base.types import Array, ArrayLike, Float64Array, Twist, Vector, Wrench
from taut.maths import dynamics as dyn
from taut.maths.model import Model
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = [
    "Environment",
    "EnvironmentBase",
    "Environments",
    "ReadyEnvironment",
    "added",
    "applied",
    "checked_change",
    "fastest",
    "require_environment",
    "started",
    "touch",
]

Values = Mapping[str, Any]
NO_RATES: Final = (0.0, 0.0)
METHODS: Final = ("parameters", "start", "wrench")


@runtime_checkable
class Environment(Protocol):
    """What touches the tool. A frozen dataclass of numbers, with a pure function for the wrench.

    The wrench is that of the environment on the arm, force first, in world axes at the tool's origin.
    """

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        ...

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start, from the tool's pose."""
        ...

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the new memory."""
        ...


@runtime_checkable
class ReadyEnvironment(Environment, Protocol):
    """What the environments that come with taut know of themselves beyond that."""

    def changed(self, path: str, value: ArrayLike) -> Environment:
        """The same with another value of a parameter, checked as when it was made."""
        ...

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """Natural frequency of the tool in it [rad/s], and how fast its damping alone brakes the tool [1/s].

        Args:
            mobility: (6, 6) acceleration of the tool per wrench, Lambda^-1; zero for a tool that nothing moves.
            parameters: Current values by name.
        """
        ...


class EnvironmentBase(Declared):
    """Base of the environments that come with taut, and of your own: declared fields, and one pure function.

    Each `Field` is a parameter of the plant by its path, environment.stiffness, checked by its declaration whenever
    it changes. A subclass writes `wrench`; what remembers something writes `start` too, and what oscillates or brakes
    fast writes `rates`, from which the plant knows whether its steps are short enough.

    Example:
        >>> from taut.environments import EnvironmentBase, Field
        >>> class Wind(EnvironmentBase):
        ...     force: Field = Field(unit="N", shape=3)
        ...
        ...     def wrench(self, T_WE, twist, t, memory, parameters, dt):
        ...         return np.concatenate([parameters["force"], np.zeros(3)]), {}
        >>> sorted(Wind(force=[1.0, 0.0, 0.0]).parameters())
        ['force']
    """

    def start(self, T_WE: Pose) -> dict[str, Any]:  # noqa: ARG002
        """Memory at the start, from the tool's pose: none."""
        return {}

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, force first, in world axes at the tool's origin; and the new memory."""
        raise NotImplementedError

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:  # noqa: ARG002
        """How fast the tool oscillates in it [rad/s], and how fast its damping brakes the tool [1/s]: not at all.

        Args:
            mobility: (6, 6) acceleration of the tool per wrench, Lambda^-1.
            parameters: Current values by name.
        """
        return NO_RATES

    def __add__(self, other: Environment) -> Environments:
        return added(self, other)


@dataclass(frozen=True, init=False, eq=False)
class Environments:
    """Several environments at once, which the tool feels together.

    Law:          F_ext = F_1 + F_2 + ...

    `spring + damper` makes one too, whose parts have the names of their classes; a run-time parameter is then
    environment.Spring.stiffness.

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

    parts: Mapping[str, Environment]

    def __init__(self, **parts: Environment) -> None:
        if not parts:
            raise UsageError(
                "taut.environments.Environments needs one part at least: "
                "taut.environments.Environments(wall=taut.environments.StiffWall(...))"
            )
        for name, part in parts.items():
            require_environment(name, part)
        object.__setattr__(self, "parts", dict(parts))

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        return {f"{name}.{key}": x for name, part in self.parts.items() for key, x in part.parameters().items()}

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start, from the tool's pose."""
        return {f"{name}.{key}": x for name, part in self.parts.items() for key, x in started(part, T_WE).items()}

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

    def changed(self, path: str, value: ArrayLike) -> Environments:
        """The same with another value of a parameter, checked as when it was made."""
        head, _, rest = path.partition(".")
        part = self.parts[head]
        if isinstance(part, ReadyEnvironment):
            return Environments(**{**self.parts, head: part.changed(rest, value)})
        finite_array(f"environment.{path}", value)  # one of the user's own, which knows no more of itself
        return self

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """Of all parts at once, which act side by side."""
        found = [
            part.rates(mobility, subtree(parameters, name)) if isinstance(part, ReadyEnvironment) else NO_RATES
            for name, part in self.parts.items()
        ]
        return float(np.sqrt(sum(omega**2 for omega, _ in found))), float(sum(damping for _, damping in found))

    def __add__(self, other: Environment) -> Environments:
        return added(self, other)


def added(first: Environment, second: Environment) -> Environments:
    """Two environments at once; sums are flattened, and parts have the names of their classes."""
    parts: dict[str, Environment] = {}
    for each in (first, second):
        require_environment("a part of a sum", each)
        named = each.parts if isinstance(each, Environments) else {type(each).__name__: each}
        for name, part in named.items():
            k, unique = 1, name
            while unique in parts:
                k += 1
                unique = f"{name}{k}"
            parts[unique] = part
    return Environments(**parts)


def require_environment(name: str, what: object) -> None:
    """Refuse what is no environment.

    Raises:
        UsageError: It is none.
    """
    if not isinstance(what, Environment) or isinstance(what, type):
        got = what.__name__ if isinstance(what, type) else type(what).__name__
        raise UsageError(
            f"{name} must have parameters(), start(T_WE) and wrench(...), see taut.environments.Environment; "
            f"got {got}",
            name=name,
        )
    who = type(what).__name__
    missing = [method for method in METHODS if _of_base(type(what), method)]
    if missing:
        raise UsageError(
            f"{who} takes {quoted_list(missing)} from its base, which has no more than the names; write them in the "
            "class",
            name=name,
        )
    for key, value in _by_name(f"{who}.parameters()", what.parameters()).items():
        float_array(f"{who}.parameters()['{key}']", value)


def _of_base(kind: type, method: str) -> bool:
    """Whether a class has a method from a base that only names it."""
    own = getattr(kind, method, None)
    return own is getattr(Environment, method) or (method == "wrench" and own is EnvironmentBase.wrench)


def started(environment: Environment, T_WE: Pose) -> dict[str, Any]:
    """The memory of an environment at the start, by name."""
    return dict(_by_name(f"{type(environment).__name__}.start(T_WE)", environment.start(T_WE)))


def _by_name(what: str, values: object) -> Mapping[str, Any]:
    """What a method of the user's gave, if it is a dict by name."""
    if not isinstance(values, Mapping) or not all(isinstance(key, str) for key in values):
        got = "a dict with other keys" if isinstance(values, Mapping) else type(values).__name__
        raise UsageError(f"{what} must give a dict by name, {{}} for nothing; got {got}", name=what)
    return values


def checked_change(environment: Environment, path: str, value: ArrayLike) -> Float64Array:
    """A new value of a parameter, by its path below "environment", in the shape that it has.

    Raises:
        ShapeError: Another shape.
        RangeError: Not finite, or against the rule of its environment.
    """
    old = environment.parameters()[path]
    if isinstance(environment, Environments):
        head, _, rest = path.partition(".")
        owner, name = environment.parts[head], rest
    else:
        owner, name = environment, path
    if isinstance(owner, Environments):
        return checked_change(owner, name, value)
    if isinstance(owner, EnvironmentBase):
        new = np.asarray(owner.changed(name, value, name=f"environment.{path}").parameters()[name])
    elif isinstance(owner, ReadyEnvironment):
        new = np.asarray(owner.changed(name, value).parameters()[name])
    else:
        new = finite_array(f"environment.{path}", value)
    if new.shape == (6,) and old.shape == (6, 6):
        new = np.diag(new)
    if new.shape != old.shape and not (new.ndim == 0 and old.shape == (3,)):
        whole = f"environment.{path}"
        raise ShapeError(
            f"{whole} has shape {old.shape}; got shape {new.shape}; make the plant with a value of the new shape",
            name=whole,
        )
    return np.broadcast_to(new, old.shape)


def touch(
    environment: Environment, model: Model, q: Vector, v: Vector, memory: Values, parameters: Values, t: Any, dt: Any
) -> tuple[Array, dict[str, Any]]:
    """(6,) F_ext at a state of an arm, and the environment's memory after it, by name.

    Args:
        environment: What touches the tool.
        model: The constants of the arm.
        q: (n,) positions.
        v: (n,) velocities.
        memory: The environment's, by name.
        parameters: Its parameters by name.
        t: Time [s].
        dt: Length of the step that begins [s].

    Raises:
        ShapeError: A wrench of another shape.
        UsageError: Memory under other names than before.
    """
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
