"""PlantBase: a plant with a state of its own, such as a physics engine, stepped tick by tick."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from taut.arm.description import Arm
from taut.base.errors import unknown_name
from taut.base.paths import PlantParameters
from taut.base.types import ArrayLike, Float64Array
from taut.plant.sensors import Sensors
from taut.record.info import Around


class PlantBase(ABC):
    """Base of a plant of your own: another simulator, a recorded system, a model in a few lines.

    `taut.run` puts it into a state, and then in each tick measures and advances it by one control period. A subclass
    writes `reset`, `state` and `advance`; the rest has values of a plant with ideal sensors that takes torques.

    Args:
        arm: The true arm; the controller's may differ.

    Example:
        >>> import numpy as np
        >>> import taut
        >>> class Slider(taut.PlantBase):
        ...     def reset(self, q, v, dt, seed):
        ...         self.q, self.v, self.dt = q.copy(), v.copy(), dt
        ...
        ...     def state(self):
        ...         return self.q, self.v
        ...
        ...     def advance(self, command):
        ...         self.v = self.v + self.dt * command / 2.0
        ...         self.q = self.q + self.dt * self.v
        ...         return command
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.PID(kp=8.0, kd=8.0), arm)
        >>> out = taut.run(ctrl, Slider(arm), taut.JointMotion(q=[0.5]), duration=10.0, q0=[0.0])
        >>> bool(abs(out.q[-1, 0] - 0.5) < 1e-3)
        True
    """

    takes: str = "torque"
    """The command: "torque", "velocity", "position", or "mit": (5, n) rows q, v, kp, kd and tau of a MitCommand."""
    measures: frozenset[str] = frozenset({"v"})
    """Measurements besides positions."""
    distorts: frozenset[str] = frozenset()
    """The measurements that differ from the truth."""
    adds: Any = ()
    """Components that it adds to a torque command itself, such as ("gravity",)."""
    real: bool = False
    """True where commands move a real arm: a run with an unstable loop is then refused, not begun with a warning."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm

    @property
    def name(self) -> str:
        """Name of the plant in messages."""
        return f"{type(self).__name__}({self.arm.name})"

    @abstractmethod
    def reset(self, q: Float64Array, v: Float64Array, dt: float, seed: int) -> None:
        """Put the plant into a state, and prepare it for control periods of dt [s]; any noise is the seed's."""

    @abstractmethod
    def state(self) -> tuple[Float64Array, Float64Array]:
        """(n,) the true position and velocity."""

    @abstractmethod
    def advance(self, command: Float64Array) -> Float64Array:
        """One control period under a command; (n,) the torque that acted on the joints."""

    def measure(self) -> dict[str, Float64Array]:
        """Readings of the sensors: q, and whatever `measures` names."""
        q, v = self.state()
        return {"q": q.copy(), "v": v.copy()}

    def trouble(self) -> tuple[str, int | None] | None:
        """Fault in the last period, in words, and the joint; None without one."""
        return None

    def extra(self) -> dict[str, Any]:
        """Further columns of the record, by name; the same names in every tick."""
        return {}

    def like(self, *, arm: Arm | None = None, sensors: Sensors | None = None) -> Any:  # noqa: ARG002
        """A plant of the same arguments but these, as comparisons need; None where there is no making another."""
        return None

    def around(self) -> Around:
        """Objects around the arm, for films."""
        return Around()

    @property
    def parameters(self) -> Mapping[str, Float64Array]:
        """Run-time parameters by path."""
        return PlantParameters(f"plant '{self.name}'", "parameter", {})

    def checked_parameter(self, path: str, value: ArrayLike) -> Float64Array:  # noqa: ARG002
        """A new value of a parameter, checked but not set; UnknownNameError where there is no such parameter."""
        raise unknown_name(f"plant '{self.name}'", "parameter", path, self.parameters)

    def check_together(self, values: Mapping[str, ArrayLike]) -> None:  # noqa: B027  (nothing to refuse)
        """Refuse values by path that do not go together, each of which is right by itself."""

    def set_parameters(self, values: Mapping[str, ArrayLike]) -> None:
        """Give parameters new values, each checked, and all together."""
        for path, value in values.items():
            self.checked_parameter(path, value)
