"""What the tool holds and what holds the tool: handles and hands, masses with a motion of their own in a grip."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from taut.base.checks import finite_array
from taut.base.errors import UsageError
from taut.base.quantity import Quantity
from taut.base.types import ArrayLike, Float64Array, Twist, Vector3, Wrench
from taut.plant.environments.environment import Environment, Environments, added
from taut.plant.environments.numbers import keep_axes, replaced
from taut.plant.environments.prescribed import BandNoise, Oscillation, Will
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["Hand", "Handle"]

Values = Mapping[str, Any]
GRIP: Final = 300.0  # [rad/s]
HELD: Final[Mapping[str, Quantity]] = {
    "mass": Quantity(
        unit="kg", rule="> 0", instead="without mass it is a taut.environments.Spring and a taut.environments.Damper"
    ),
    "damping": Quantity(unit="N s/m", rule=">= 0"),
    "stiffness": Quantity(unit="N/m", rule=">= 0"),
    "grip": Quantity(unit="rad/s", rule="> 0", instead="not to hold it leave it out"),
}
WANTED: Final = ("motion", "force")


def _numbers(held: Handle | Hand) -> dict[str, Float64Array]:
    out = {name: np.asarray(getattr(held, name)) for name in HELD}
    return out if held.at is None else out | {"at": np.asarray(held.at)}


def _keep(held: Handle | Hand) -> None:
    keep_axes(held, "damping", "stiffness")
    if held.at is not None:
        object.__setattr__(held, "at", finite_array(f"{held.title}.at", held.at, shape=(3,), unit="m"))


def _start(held: Handle | Hand, T_WE: Pose) -> dict[str, Any]:
    """It starts at rest where the tool is."""
    memory: dict[str, Any] = {"p": T_WE.p, "v": np.zeros(3)}
    return memory if held.at is not None else memory | {"at": T_WE.p}


def _held(
    T_WE: Pose, twist: Twist, memory: Values, parameters: Values, dt: Any, wanted: Vector3, force: Vector3
) -> tuple[Wrench, dict[str, Any]]:
    """The wrench of a mass in a grip, and its motion after a step: semi-implicit, its damping at the step's end."""
    m, k, b, omega = (parameters[name] for name in ("mass", "stiffness", "damping", "grip"))
    p, v = memory["p"], memory["v"]
    at = parameters["at"] if "at" in parameters else memory["at"]
    grip = m * omega * (omega * (T_WE.p - p) + (twist[:3] - v))
    v_new = (m * v + dt * (grip + k * (at + wanted - p) + force)) / (m + dt * b)
    return tm.array([*(-grip), 0.0, 0.0, 0.0]), {**memory, "p": p + dt * v_new, "v": v_new}


def _rates(mobility: Float64Array, parameters: Values) -> tuple[float, float]:
    """Of the grip between tool and mass, and of the spring behind it."""
    m, omega = float(parameters["mass"]), float(parameters["grip"])
    both = float(np.linalg.eigvalsh(mobility[:3, :3]).max()) + 1.0 / m
    behind = float(np.max(parameters["stiffness"])) / m
    return float(np.sqrt(m * omega**2 * both + behind)), m * omega * both


@dataclass(frozen=True, kw_only=True, eq=False)
class Handle:
    """A handle (m, b, k) that the tool holds by its middle: a mass, with damper and spring to the world.

    Law:          mass a_h + damping v_h + stiffness (p_h - at) = f_grip,  F_ext = -f_grip
                  f_grip = mass grip^2 (p - p_h) + mass grip (v - v_h)
    Closed loop:  below the grip's frequency, of an arm without forces: (mass + Lambda) a + damping v + stiffness
                  (p - at) = 0

    The handle has a motion of its own, p_h and v_h, and the grip is a stiff spring and damper: a mass that answered
    to the tool's acceleration in the same instant would be an algebraic loop in every engine but one's own. What is
    felt differs from a rigid grip by (omega / grip)^2, 0.4 % at 20 rad/s. The handle has inertia, and no weight: give
    that to the arm's payload.

    Stable while omega^2 dt^2 + 2 dt delta < 4, with omega^2 = grip^2 (1 + mass / Lambda) + stiffness / mass and
    delta = grip (1 + mass / Lambda); steps with more than 2 are refused.

    Args:
        mass: [kg].
        damping: (3,) in world axes or scalar [N s/m].
        stiffness: (3,) in world axes or scalar [N/m].
        at: (3,) where its spring is at rest [m]; where the tool starts if left out.
        grip: Natural frequency of the mass in the grip of a tool that rests [rad/s].

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite, no mass.

    Example:
        >>> sorted(Handle(mass=1.0, damping=5.0, stiffness=200.0).parameters())
        ['damping', 'grip', 'mass', 'stiffness']

    References:
        Chapter, section 10.5 impedance control.
    """

    title: ClassVar[str] = "handle"
    quantities: ClassVar[Mapping[str, Quantity]] = HELD

    mass: ArrayLike
    damping: ArrayLike = 0.0
    stiffness: ArrayLike = 0.0
    at: ArrayLike | None = None
    grip: ArrayLike = GRIP

    def __post_init__(self) -> None:
        _keep(self)

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        return _numbers(self)

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start: at rest where the tool is."""
        return _start(self, T_WE)

    def wrench(
        self,
        T_WE: Pose,
        twist: Twist,
        t: Any,  # noqa: ARG002
        memory: Values,
        parameters: Values,
        dt: Any,
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the handle's motion after the step."""
        return _held(T_WE, twist, memory, parameters, dt, np.zeros(3), np.zeros(3))

    def changed(self, name: str, value: ArrayLike) -> Handle:
        """The same with another value of a parameter, checked as when it was made."""
        return replaced(self, name, value)

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """How fast tool and handle swing in the grip [rad/s], and how fast it brakes that [1/s]."""
        return _rates(mobility, parameters)

    def __add__(self, other: Environment) -> Environments:
        return added(self, other)


@dataclass(frozen=True, kw_only=True, eq=False)
class Hand:
    """A hand with a will of its own, which holds the tool.

    Law:          mass a_h + damping v_h + stiffness (p_h - at - motion(t)) = f_grip + force(t),  F_ext = -f_grip
                  f_grip = mass grip^2 (p - p_h) + mass grip (v - v_h)
    Closed loop:  below the grip's frequency, of an arm without forces, at omega:
                  (p - at) (stiffness - (mass + Lambda) omega^2 + j omega damping) = stiffness motion + force

    As of `taut.environments.Handle`, the mass moves by itself in a stiff grip.

    Args:
        mass: [kg].
        damping: (3,) in world axes or scalar [N s/m].
        stiffness: (3,) in world axes or scalar [N/m].
        motion: Where it wants to be, counted from `at` [m]: a taut.environments.Oscillation or a
        taut.environments.BandNoise.
        force: What it pushes with besides [N]: the same.
        at: (3,) where it rests [m]; where the tool starts if left out.
        grip: Natural frequency of the mass in the grip of a tool that rests [rad/s].

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite, no mass.
        UsageError: A motion or force of another kind.

    Example:
        >>> wave = Oscillation(amplitude=[0.02, 0.0, 0.0], frequency=1.0)
        >>> hand = Hand(mass=1.0, damping=20.0, stiffness=300.0, motion=wave)
        >>> sorted(hand.parameters())[-3:]
        ['motion.frequency', 'motion.phase', 'stiffness']
    """

    title: ClassVar[str] = "hand"
    quantities: ClassVar[Mapping[str, Quantity]] = HELD

    mass: ArrayLike
    damping: ArrayLike
    stiffness: ArrayLike
    motion: Oscillation | BandNoise | None = None
    force: Oscillation | BandNoise | None = None
    at: ArrayLike | None = None
    grip: ArrayLike = GRIP

    def __post_init__(self) -> None:
        _keep(self)
        for name in WANTED:
            will = getattr(self, name)
            if will is not None and not isinstance(will, (Oscillation, BandNoise)):
                raise UsageError(
                    f"hand.{name} must be taut.environments.Oscillation(...) or "
                    f"taut.environments.BandNoise(...); got {type(will).__name__}",
                    name=name,
                )

    def _wills(self) -> dict[str, Will]:
        return {name: getattr(self, name) for name in WANTED if getattr(self, name) is not None}

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        out = _numbers(self)
        for name, will in self._wills().items():
            out |= {f"{name}.{key}": value for key, value in will.parameters().items()}
        return out

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start: at rest where the tool is, with the phases of its will."""
        return _start(self, T_WE) | {f"{name}.phases": will.start() for name, will in self._wills().items()}

    def wrench(
        self,
        T_WE: Pose,
        twist: Twist,
        t: Any,  # noqa: ARG002
        memory: Values,
        parameters: Values,
        dt: Any,
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the hand's motion after the step."""
        wants: dict[str, Any] = dict.fromkeys(WANTED, np.zeros(3))
        phases: dict[str, Any] = {}
        for name, will in self._wills().items():
            p = {key: parameters[f"{name}.{key}"] for key in will.parameters()}
            wants[name] = will.value(memory[f"{name}.phases"], p)
            phases[f"{name}.phases"] = memory[f"{name}.phases"] + dt * will.rates(p)
        wrench, after = _held(T_WE, twist, memory, parameters, dt, wants["motion"], wants["force"])
        return wrench, after | phases

    def changed(self, name: str, value: ArrayLike) -> Hand:
        """The same with another value of a parameter, checked as when it was made."""
        return replaced(self, name, value)

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """How fast tool and hand swing in the grip [rad/s], and how fast it brakes that [1/s]."""
        return _rates(mobility, parameters)

    def __add__(self, other: Environment) -> Environments:
        return added(self, other)
