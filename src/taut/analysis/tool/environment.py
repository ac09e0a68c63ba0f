"""What a tool may touch, as an impedance: alone, and joined to a loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from taut.base.checks import finite_array
from taut.base.errors import ShapeError, UsageError
from taut.base.quantity import Quantity, keep_quantities
from taut.base.types import ArrayLike, Float64Array
from taut.linear.frequency import Complex
from taut.loop import Loop
from taut.maths import dynamics as dyn
from taut.maths.model import model_of
from taut.plant.environments.environment import Environment, Environments, added
from taut.plant.environments.hands import Handle
from taut.plant.environments.springs import Damper, Spring
from taut.plant.rigid import RigidPlant
from taut.trace.pose import Pose

__all__ = ["TipEnvironment", "environment_at", "joined"]


@dataclass(frozen=True, kw_only=True)
class TipEnvironment:
    """A mass, damper and spring along one direction, as the impedance that it has by itself.

    Law:          F = Z X, Z = mass s^2 + damping s + stiffness, and Y = 1 / Z

    Args:
        mass: [kg], or [kg m^2] about an axis.
        damping: [N s/m | N m s/rad].
        stiffness: [N/m | N m/rad].

    Raises:
        ShapeError, RangeError: Not one number each, negative, not finite.
        UsageError: All of them are zero: that is no environment.

    Example:
        >>> wall = TipEnvironment(damping=20.0, stiffness=2000.0)
        >>> wall.Z(100.0).tolist()
        [(2000+2000j)]

    References:
        Section 10.5. Hogan, Impedance control, J. Dynamic Systems, Measurement and Control 107 (1985).
    """

    title: ClassVar[str] = "environment"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "mass": Quantity(unit="kg", rule=">= 0"),
        "damping": Quantity(unit="N s/m", rule=">= 0"),
        "stiffness": Quantity(unit="N/m", rule=">= 0"),
    }

    mass: ArrayLike = 0.0
    damping: ArrayLike = 0.0
    stiffness: ArrayLike = 0.0

    def __post_init__(self) -> None:
        keep_quantities(self)
        for name in self.quantities:
            if np.ndim(getattr(self, name)):
                raise ShapeError(
                    f"environment.{name} must be one number, along the direction that is looked at; got shape "
                    f"{np.shape(getattr(self, name))}",
                    name=name,
                )
        if not any(np.any(getattr(self, name)) for name in self.quantities):
            raise UsageError("an environment needs a mass, a damping or a stiffness above zero", name="environment")

    def Z(self, omega: ArrayLike) -> Complex:
        """(k,) F / X [N/m | N m/rad]."""
        s = 1j * np.atleast_1d(finite_array("omega", omega, unit="rad/s"))
        m, b, k = (np.asarray(getattr(self, name), dtype=np.float64) for name in self.quantities)
        return np.asarray(m * s * s + b * s + k, dtype=np.complex128)

    def Y(self, omega: ArrayLike) -> Complex:
        """(k,) X / F [m/N | rad/(N m)]; infinite where nothing resists."""
        return inverse(self.Z(omega))


def inverse(values: Complex) -> Complex:
    """(k,) 1 / values, infinite where they are zero and zero where they are infinite."""
    out = np.zeros(len(values), dtype=np.complex128)
    out[values == 0.0] = np.inf
    some = np.isfinite(values) & (values != 0.0)
    out[some] = 1.0 / values[some]
    return out


def environment_at(loop: Loop, q: Float64Array, mass: float, damping: ArrayLike, stiffness: ArrayLike) -> Environment:
    """A handle where there is mass, else a spring and a damper, at rest where the tool is at joint positions.

    Args:
        loop: The loop.
        q: (n,) [rad | m].
        mass: [kg].
        damping: A number or (3,) in world axes [N s/m]; without mass also (linear, angular), six or (6, 6).
        stiffness: Likewise [N/m].
    """
    T: Pose = dyn.pose(model_of(loop.plant.arm), q)
    if mass:
        return Handle(mass=mass, damping=damping, stiffness=stiffness, at=T.p)
    kept = {"spring.stiffness": stiffness, "damper.damping": damping}
    six = {name: _six(finite_array(name, value)) for name, value in kept.items()}
    # The numbers of a spring are in the axes of the place where it is at rest.
    spring = six["spring.stiffness"]
    if spring.shape in ((2,), (6,), (6, 6)):
        Spring(stiffness=spring)  # refuses what is none
        turn = np.kron(np.eye(2), np.asarray(T.R, dtype=np.float64))
        world = spring if spring.ndim == 2 else np.diag(np.repeat(spring, 6 // len(spring)))
        spring = turn.T @ world @ turn
        spring = 0.5 * (spring + spring.T)
    return Spring(stiffness=spring, at=T) + Damper(damping=six["damper.damping"])


def _six(values: Float64Array) -> Float64Array:
    """Three numbers as six of which the last are zero."""
    return np.append(values, np.zeros(3)) if values.shape == (3,) else values


@dataclass(frozen=True)
class _Kept:
    """A controller as a loop takes it."""

    side: Any
    parameters: Mapping[str, Float64Array]
    engine: str


def joined(loop: Loop, more: Environment) -> Loop:
    """The same loop with something more at its tool, and all its parameters as they are.

    Raises:
        UsageError: A plant of another kind.
    """
    plant = loop.plant
    if not isinstance(plant, RigidPlant):
        raise UsageError(f"only a taut.RigidPlant takes another environment; got {plant.name}", name="loop")
    old = plant.environment
    new = dataclasses.replace(plant, environment=more if old is None else added(old, more))
    out = Loop(_Kept(loop.side, loop.side.parameters, loop.engine), new, loop.ref, duration=loop.duration)
    inside = "" if old is None or isinstance(old, Environments) else f"{type(old).__name__}."
    for path, value in loop.parameters.items():
        head, _, rest = path.partition(".")
        out.parameters[f"environment.{inside}{rest}" if head == "environment" else path] = value
    return out
