"""Friction of joints: one set of parameters for every law of figure 10.14, and for friction that grows with load."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from taut.base.checks import entry_names, finite_array, read_only
from taut.base.errors import RangeError, ShapeError
from taut.base.types import ArrayLike, Float64Array

# What stands at rest, and what it must not be less than: the same in motion.
AT_REST: Final = {"static": "coulomb", "load_motor_static": "load_motor", "load_external_static": "load_external"}

FRICTION_UNITS: Final = {
    "viscous": "N m s/rad | N s/m",
    "coulomb": "N m | N",
    "static": "N m | N",
    "stribeck": "rad/s | m/s",
    "stribeck_shape": "1",
    "load_motor": "1",
    "load_external": "1",
    "load_motor_static": "1",
    "load_external_static": "1",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Friction:
    """Friction of joints, each number a scalar or one per joint. Which are zero decides the law of figure 10.14.

    Law:          f = -viscous v - d sgn(v) where a joint moves; at rest f is what holds it, |f| <= d(0)
                  d(v) = coulomb + (static - coulomb) s(v) + load
                  s(v) = exp(-(|v| / stribeck)^stribeck_shape), the Stribeck effect; s = 1 at rest, and
                  where stribeck = 0 s = 0 as soon as a joint moves
                  load = |load_external tau_load - load_motor tau_motor|, with its own excess at rest that fades
                  with s(v); tau_motor is the motor's torque at the joint, tau_load what weight, motion and
                  contact put on it, which at rest is -tau_motor

    The laws of figure 10.14 by their parameters: (a) viscous; (b) coulomb; (c) viscous and coulomb; (d) coulomb and a
    larger static; (e) these and viscous; (f) these and stribeck. `taut book fig-10.14` draws them. Friction
    is that of the joint's own axis, at the output of gears.

    Args:
        viscous: Friction per speed [N m s/rad | N s/m].
        coulomb: Dry friction in motion, the chapter's b_kinetic [N m | N].
        static: Dry friction at rest, the break-away torque, b_static [N m | N]; as in motion if left out.
        stribeck: Speed over which dry friction falls from static to coulomb [rad/s | m/s]; 0 for at once.
        stribeck_shape: Exponent of that fall [1]: 2 is a Gaussian, 1 an exponential.
        load_motor: Dry friction per torque of the motor [1].
        load_external: Dry friction per torque of the load [1].
        load_motor_static: The same at rest [1]; as in motion if left out.
        load_external_static: The same at rest [1]; as in motion if left out.

    Raises:
        RangeError: A negative number, or less friction at rest than in motion.
        ShapeError: Neither one number nor one per joint, or for another number of joints than the others.

    Example:
        >>> Friction(coulomb=0.5, static=0.8).static.tolist()
        0.8

    References:
        Chapter, section 10.2.1.4 and figure 10.14. Armstrong-Helouvry, Dupont and Canudas de Wit, A survey of
        models, analysis tools and compensation methods for the control of machines with friction, Automatica 30
        (1994). Duclusaud, Passault, Padois and Ly, Extended friction models for the physics simulation of servo
        actuators (2024), for what grows with load.
    """

    viscous: ArrayLike = 0.0
    coulomb: ArrayLike = 0.0
    static: ArrayLike | None = None
    stribeck: ArrayLike = 0.0
    stribeck_shape: ArrayLike = 2.0
    load_motor: ArrayLike = 0.0
    load_external: ArrayLike = 0.0
    load_motor_static: ArrayLike | None = None
    load_external_static: ArrayLike | None = None

    def __post_init__(self) -> None:
        kept: dict[str, Float64Array] = {}
        for name, unit in FRICTION_UNITS.items():
            given = getattr(self, name)
            if given is None and name in AT_REST:
                kept[name] = kept[AT_REST[name]]
                continue
            above = 0.0 if name == "stribeck_shape" else -math.inf
            values = finite_array(f"friction.{name}", given, unit=unit, minimum=0.0, above=above)
            if values.ndim > 1 or not values.size:
                raise ShapeError(
                    f"friction.{name} must be one number or one per joint; got shape {values.shape}", name=name
                )
            kept[name] = values
        sizes = {len(values) for values in kept.values() if values.ndim}
        if len(sizes) > 1:
            raise ShapeError(
                f"the numbers of a friction are for one arm; got some for {sorted(sizes)} joints", name="friction"
            )
        for name, moving in AT_REST.items():
            check_at_rest(kept[name], kept[moving], name)
        for name, values in kept.items():
            object.__setattr__(self, name, read_only(values))

    @property
    def dry(self) -> bool:
        """Whether there is any dry friction."""
        return bool(np.any(self.static)) or self.loaded

    @property
    def loaded(self) -> bool:
        """Whether it grows with load."""
        return bool(np.any(self.load_motor_static)) or bool(np.any(self.load_external_static))

    @property
    def falls(self) -> bool:
        """Whether it is larger at rest than in motion."""
        return any(bool(np.any(np.asarray(getattr(self, name)) > getattr(self, AT_REST[name]))) for name in AT_REST)


FRICTION_FIELDS: Final = tuple(field.name for field in fields(Friction))


def check_at_rest(at_rest: ArrayLike, moving: ArrayLike, name: str, prefix: str = "friction.") -> None:
    """Friction at rest is no less than friction in motion."""
    rest, kinetic = np.broadcast_arrays(np.asarray(at_rest, dtype=np.float64), np.asarray(moving, dtype=np.float64))
    wrong = np.argwhere(np.atleast_1d(rest < kinetic))
    if len(wrong):
        index = tuple(int(i) for i in wrong[0]) if rest.ndim else ()
        other = AT_REST[name]
        raise RangeError(
            f"{entry_names(prefix + name, list(index))} must be >= {prefix}{other}: friction at rest is no less "
            f"than in motion; got {float(rest[index]):g} < {float(kinetic[index]):g} [{FRICTION_UNITS[name]}]",
            name=name,
            value=float(rest[index]),
            rule=f">= {other}",
        )
