"""Friction of joints: its law, on numbers or symbols, and dry friction of coupled joints, with real sticking."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.friction import AT_REST, FRICTION_FIELDS, Friction
from taut.base.types import ArrayLike, Vector
from taut.trace import math as tm
from taut.trace.linalg import LTDL

REST: Final = 1e-12  # [rad/s | m/s] of a joint that friction holds is rounding: it rests, and sgn(v) is 0
MIN_SPEED: Final = 1e-150  # [rad/s | m/s] a speed below it is rest: 1 / x would overflow in a derivative
MAX_LOG_POWER: Final = 6.7  # exp(-exp(6.7)) is zero in floating point; beyond it a power would only overflow
FRICTION_SWEEPS: Final = (
    6  # of projected Gauss-Seidel, half of them before the joints that are held are solved for exactly
)


@dataclass(frozen=True, kw_only=True)
class DryFriction:
    """What dry friction does in one step."""

    v: Vector  # (n,) velocities after it
    f: Vector  # (n,) its torques [N m | N]; zero for joints without any
    at_rest: Vector  # (n,) 1.0 for the joints that it holds, else 0.0
    residual: Any  # largest torque by which a further sweep would change it [N m | N]


def dry_friction(
    factors: LTDL,  # of the mass matrix, with implicit damping if any
    v_free: Vector,  # (n,) velocities that the step would give without dry friction
    low: Vector,  # (n,) largest friction against positive motion [N m | N]
    high: Vector,  # (n,) the same against negative motion
    guess: Vector,  # (n,) friction torques of the last step
    dt: Any,  # [s]
    *,
    joints: Sequence[int],  # those with dry friction
    stop: Vector | None = None,  # (n,) torques that would stop all joints, where at hand
    sweeps: int = FRICTION_SWEEPS,
) -> DryFriction:
    """Velocities after dry friction, and the friction torques that give them.

    A joint sticks at zero velocity as long as the torque for that stays within its limits; else it slips under the
    full limit. For coupled joints this is a complementarity problem in the velocities,

        v = v_free + dt M^-1 f
        f_i = -low_i where v_i > 0,   f_i = high_i where v_i < 0,   -low_i <= f_i <= high_i where v_i = 0

    solved by a fixed number of projected Gauss-Seidel sweeps, so that it is straight-line code. Where friction can
    stop every joint at once it does, exactly; else the sweeps start from the last step's torques. Half of them find
    which joints stick; these are then solved for together, exactly, and the other half corrects what that moved.
    """
    n, k = len(low), len(joints)
    W = factors.inverse()
    response = [[W[i, j] for j in joints] for i in joints]
    inverse = [1.0 / response[a][a] for a in range(k)]
    # In impulses p = dt f: p_a = c_a - sum of R_ab p_b brings joint a to rest, the others held.
    c = [-v_free[i] * inverse[a] for a, i in enumerate(joints)]
    R = [[response[a][b] * inverse[a] for b in range(k)] for a in range(k)]
    least, most = [-low[i] * dt for i in joints], [high[i] * dt for i in joints]
    if stop is not None and k == n:
        halt = [stop[i] * dt for i in joints]
    else:
        halt = list(tm.solve_spd(tm.array(response), -tm.array([v_free[i] for i in joints])))
    within = tm.array([(halt[a] >= least[a]) & (halt[a] <= most[a]) for a in range(k)])
    all_stop = np.all(within)
    p = [_within(tm.where(all_stop, halt[a], guess[i] * dt), least[a], most[a]) for a, i in enumerate(joints)]

    def stopping(a: int) -> Any:
        """The impulse that brings joint a to rest."""
        # The newest one comes last: only its product waits for the one before.
        total = c[a]
        for b in (*range(a + 1, k), *range(a)):
            total = total - R[a][b] * p[b]
        return total

    def sweep(count: int) -> None:
        for _ in range(count):
            for a in range(k):
                p[a] = _within(stopping(a), least[a], most[a])

    if k == 1:
        sweep(1)
    else:
        sweep(sweeps // 2)
        p = [
            _within(x, least[a], most[a])
            for a, x in enumerate(_held_exactly(response, joints, v_free, p, least, most))
        ]
        sweep(sweeps - sweeps // 2)
    v, f, at_rest = list(v_free), [0.0] * n, [0.0] * n
    residual: Any = 0.0
    for a, i in enumerate(joints):
        # What is left to rest is the velocity; of a joint that friction holds it is rounding.
        total = stopping(a)
        held = (p[a] > least[a]) & (p[a] < most[a])
        v[i] = response[a][a] * (p[a] - total)
        v[i] = tm.where(held & (tm.abs(v[i]) < REST), 0.0, v[i])
        at_rest[i] = tm.where(held, 1.0, 0.0)
        f[i] = p[a] / dt
        if k > 1:
            residual = tm.maximum(residual, tm.abs(_within(total, least[a], most[a]) - p[a]))
    for i in set(range(n)) - set(joints):
        for a, j in enumerate(joints):
            v[i] = v[i] + W[i, j] * p[a]
    return DryFriction(v=tm.array(v), f=tm.array(f), at_rest=tm.array(at_rest), residual=residual / dt)


def _held_exactly(
    response: list[list[Any]], joints: Sequence[int], v_free: Vector, p: list[Any], least: list[Any], most: list[Any]
) -> list[Any]:
    """Impulses that bring all joints to rest which are within their limits now, the others staying at theirs."""
    k = len(p)
    held = [tm.where((p[a] > least[a]) & (p[a] < most[a]), 1.0, 0.0) for a in range(k)]
    slipping = [p[a] - held[a] * p[a] for a in range(k)]
    A: list[list[Any]] = [[0.0] * k for _ in range(k)]
    rhs = []
    for a, i in enumerate(joints):
        total = v_free[i]
        for b in range(k):
            total = total + response[a][b] * slipping[b]
        for b in range(a):
            A[a][b] = A[b][a] = held[a] * held[b] * response[a][b]
        A[a][a] = tm.where(held[a] > 0.5, response[a][a], 1.0)
        rhs.append(tm.where(held[a] > 0.5, -total, p[a]))
    return list(tm.solve_spd(tm.array(A), tm.array(rhs)))


def _within(x: Any, least: Any, most: Any) -> Any:
    """x within its bounds, in two instructions; `clip` heeds the sign of zero too, and takes three times as long."""
    return tm.where(x < least, least, tm.where(x > most, most, x))


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
        return cls.of({name: getattr(friction, name) for name in FRICTION_FIELDS}, friction)

    @staticmethod
    def names(structure: Friction) -> tuple[str, ...]:
        """The fields that are there: any value that is not zero, at rest one that differs from that in motion."""
        return tuple(name for name in FRICTION_FIELDS if _there(name, structure))

    @property
    def dry(self) -> bool:
        return self.coulomb is not None or self.static is not None or self.loaded

    @property
    def loaded(self) -> bool:
        names = ("load_motor", "load_external", "load_motor_static", "load_external_static")
        return any(getattr(self, name) is not None for name in names)

    @property
    def falls(self) -> bool:
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
    """(n,) s, the fraction of the excess of static friction that acts: 1 at rest, towards 0 with speed.

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
    """x^exponent for x >= 0, at most exp(MAX_LOG_POWER), without NaN in it or in its derivative."""
    if exponent is None:
        return x * x
    above = x > MIN_SPEED
    size = tm.exp(tm.minimum(exponent * tm.log(tm.where(above, x, 1.0)), MAX_LOG_POWER))
    power: Vector = tm.where(above, size, 0.0)
    return power


def dry_limit(
    values: FrictionValues,
    v: Vector,  # (n,) [rad/s | m/s]
    at_rest: ArrayLike | None = None,  # (n,) whether a joint sticks; by its speed alone if left out
    tau_motor: ArrayLike = 0.0,  # (n,) torque of the motor at the joint [N m | N]
    tau_load: ArrayLike = 0.0,  # (n,) by weight, motion and contact [N m | N]; at rest -tau_motor
) -> Vector:
    """(n,) the largest dry friction [N m | N]: what acts in motion, and the limit of what acts at rest.

    Law:  d = coulomb + (static - coulomb) s + load + s excess
          load = |load_external tau_load - load_motor tau_motor|
          excess: the same with load_external_static - load_external, load_motor_static - load_motor
          s: see `stribeck_share`

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
    values: FrictionValues, v: Vector, tau_motor: ArrayLike = 0.0, tau_load: ArrayLike = 0.0, width: Any = None
) -> Vector:
    """(n,) torque of friction on joints that move [N m | N]; dry friction is zero at v = 0, see `dry_limit`.

    Law:  f = -viscous v - d(v) sgn(v), or with a width [rad/s | m/s] of the sign -viscous v - d(v) tanh(v / width)
    """
    f: Vector = tm.zeros(np.shape(v))
    if values.viscous is not None:
        f = f - values.viscous * v
    if values.dry:
        sign = tm.sign(v) if width is None else tm.tanh(v / width)
        f = f - sign * dry_limit(values, v, None, tau_motor, tau_load)
    return f
