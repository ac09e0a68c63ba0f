"""The law of joint friction, on numbers or symbols: how much dry friction there is at a speed and under a load.

What a friction has not got is None, and costs nothing where the law is compiled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.friction import AT_REST, FRICTION_FIELDS, Friction
from taut.base.types import ArrayLike, Vector
from taut.trace import math as tm

__all__ = ["FrictionValues", "dry_limit", "friction_torque", "stribeck_share"]

LEAST: Final = 1e-150  # a speed below it is rest: 1 / x would overflow in a derivative
MOST: Final = 6.7  # exp(-exp(6.7)) is zero in floating point; beyond it a power would only overflow


@dataclass(frozen=True, kw_only=True)
class FrictionValues:
    """The numbers of a `Friction` as arrays or symbols; None for what is zero, or at rest as in motion."""

    viscous: Any = None  # [N m s/rad | N s/m]
    coulomb: Any = None  # [N m | N]
    static: Any = None  # [N m | N]; None is as in motion
    stribeck: Any = None  # [rad/s | m/s]; None is a fall at once
    stribeck_shape: Any = None  # [1]; None is 2, a square
    load_motor: Any = None  # [1]
    load_external: Any = None  # [1]
    load_motor_static: Any = None  # [1]; None is as in motion
    load_external_static: Any = None  # [1]; None is as in motion

    @classmethod
    def of(cls, values: Mapping[str, Any], structure: Friction) -> FrictionValues:
        """Those of `values`, by name, that `structure` has; what it has not is not looked up."""
        return cls(**{name: values[name] for name in cls.names(structure)})

    @classmethod
    def fixed(cls, friction: Friction) -> FrictionValues:
        """A friction's own numbers."""
        return cls.of({name: getattr(friction, name) for name in FRICTION_FIELDS}, friction)

    @staticmethod
    def names(structure: Friction) -> tuple[str, ...]:
        """The fields that are there: any value that is not zero, at rest one that differs from that in motion."""
        return tuple(name for name in FRICTION_FIELDS if _there(name, structure))

    @property
    def dry(self) -> bool:
        """Whether there is any dry friction."""
        return self.coulomb is not None or self.static is not None or self.loaded

    @property
    def loaded(self) -> bool:
        """Whether it grows with load."""
        names = ("load_motor", "load_external", "load_motor_static", "load_external_static")
        return any(getattr(self, name) is not None for name in names)

    @property
    def falls(self) -> bool:
        """Whether it is larger at rest than in motion."""
        return any(getattr(self, name) is not None for name in AT_REST)


def _there(name: str, structure: Friction) -> bool:
    value = np.asarray(getattr(structure, name))
    if name in AT_REST:
        return bool(np.any(value > getattr(structure, AT_REST[name])))
    if name == "stribeck":
        return structure.falls and bool(np.any(value))
    if name == "stribeck_shape":
        return _there("stribeck", structure) and bool(np.any(value != 2.0))
    return bool(np.any(value))


def stribeck_share(values: FrictionValues, v: Vector, at_rest: ArrayLike | None = None) -> Vector:
    """(n,) s, the share of the excess of static friction that is there: 1 at rest, towards 0 with speed.

    Law:  s = exp(-(|v| / stribeck)^stribeck_shape); where stribeck = 0, 0 as soon as a joint moves
    """
    moving: Any = tm.zeros(np.shape(v))
    if values.stribeck is not None:
        smooth = values.stribeck > 0.0
        ratio = tm.abs(v) / tm.where(smooth, values.stribeck, 1.0)
        moving = tm.where(smooth, tm.exp(-_power(ratio, values.stribeck_shape)), 0.0)
    s: Vector = moving if at_rest is None else tm.where(at_rest, 1.0, moving)
    return s


def _power(x: Vector, exponent: Any) -> Vector:
    """x^exponent for x >= 0, at most exp(MOST), without NaN in it or in its derivative."""
    if exponent is None:
        return x * x
    above = x > LEAST
    size = tm.exp(tm.minimum(exponent * tm.log(tm.where(above, x, 1.0)), MOST))
    power: Vector = tm.where(above, size, 0.0)
    return power


def dry_limit(
    values: FrictionValues,
    v: Vector,
    at_rest: ArrayLike | None = None,
    tau_motor: ArrayLike = 0.0,
    tau_load: ArrayLike = 0.0,
) -> Vector:
    """(n,) the largest dry friction [N m | N]: what acts in motion, and at rest what a joint can be held with.

    Law:  d = coulomb + (static - coulomb) s + load + s excess
          load = |load_external tau_load - load_motor tau_motor|
          excess: the same with load_external_static - load_external, load_motor_static - load_motor
          s: see `stribeck_share`

    Args:
        values: The friction.
        v: (n,) speeds [rad/s | m/s].
        at_rest: (n,) where friction holds a joint, true or false; if left out s is that of the speed alone.
        tau_motor: (n,) torque of the motor at the joint [N m | N].
        tau_load: (n,) what weight, motion and contact put on the joint [N m | N]; at rest -tau_motor.

    Example:
        >>> friction = FrictionValues.fixed(Friction(coulomb=1.0, static=2.0, stribeck=0.1))
        >>> dry_limit(friction, np.array([0.0, 0.1, 1.0])).round(4).tolist()
        [2.0, 1.3679, 1.0]
    """
    d: Vector = tm.zeros(np.shape(v))
    if values.coulomb is not None:
        d = d + values.coulomb
    load = _load(values.load_motor, values.load_external, tau_motor, tau_load)
    if load is not None:
        d = d + load
    if not values.falls:
        return d
    s = stribeck_share(values, v, at_rest)
    if values.static is not None:
        d = d + s * _excess(values.static, values.coulomb)
    motor = _excess(values.load_motor_static, values.load_motor)
    external = _excess(values.load_external_static, values.load_external)
    excess = _load(motor, external, tau_motor, tau_load)
    return d if excess is None else d + s * excess


def _excess(at_rest: Any, moving: Any) -> Any:
    if at_rest is None or moving is None:
        return at_rest
    return at_rest - moving


def _load(motor: Any, external: Any, tau_motor: ArrayLike, tau_load: ArrayLike) -> Any:
    """|external tau_load - motor tau_motor|, or None where both are absent."""
    if motor is None and external is None:
        return None
    if motor is None:
        return tm.abs(external * tau_load)
    if external is None:
        return tm.abs(motor * tau_motor)
    return tm.abs(external * tau_load - motor * tau_motor)


def friction_torque(
    values: FrictionValues, v: Vector, tau_motor: ArrayLike = 0.0, tau_load: ArrayLike = 0.0
) -> Vector:
    """(n,) the torque of friction on joints that move [N m | N]; of dry friction nothing at v = 0.

    Law:  f = -viscous v - d(v) sgn(v)

    What acts at v = 0 the law of friction alone does not say: it is what holds the joint, up to `dry_limit`.
    """
    f: Vector = tm.zeros(np.shape(v))
    if values.viscous is not None:
        f = f - values.viscous * v
    if values.dry:
        f = f - tm.sign(v) * dry_limit(values, v, None, tau_motor, tau_load)
    return f
