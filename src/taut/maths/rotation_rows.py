"""Many rotations at once, one a row: logarithm, exponential, and the rates of what turns along a rotation vector.

With R = exp(r), the body rate is omega = J_r(r) r_dot and its own rate alpha = J_r(r) r_ddot + J_r_dot r_dot, where
J_r is the right Jacobian of SO(3). Both ways are here, for rotation vectors shorter than 2 pi.

References:
    Barfoot, State Estimation for Robotics (2017), section 7.1.5.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from taut.base.types import Float64Array
from taut.maths.spatial import rotation_log

__all__ = ["exp_rows", "from_body_rates", "log_rows", "to_body_rates"]

SMALL: Final = 1e-3  # below this square of an angle [rad^2] a series is more accurate than the formula

Coefficients = tuple[Float64Array, Float64Array, Float64Array, Float64Array]


def log_rows(R: Float64Array) -> Float64Array:
    """(k, 3) rotation vectors of rotations (k, 3, 3) [rad]: at most pi long."""
    return np.ascontiguousarray(rotation_log(np.moveaxis(R, 0, -1)).T, dtype=np.float64)


def exp_rows(r: Float64Array) -> Float64Array:
    """(k, 3, 3) rotations by the vectors r (k, 3) [rad]."""
    angle2 = np.sum(r * r, axis=1)[:, np.newaxis, np.newaxis]
    b, _, _, _ = (x[:, np.newaxis] for x in _coefficients(r))
    a = np.sinc(np.sqrt(angle2) / np.pi)
    x, y, z = r.T
    zero = np.zeros_like(x)
    K = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    out: Float64Array = np.eye(3) + a * K + b * (K @ K)
    return out


def to_body_rates(r: Float64Array, r1: Float64Array, r2: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Body rate and its rate, each (k, 3), of exp(r) whose vector has the rates r1 and r2."""
    b, c, _, _ = _coefficients(r)
    turned, bent = np.cross(r, r1), np.cross(r, r2)
    omega = r1 - b * turned + c * np.cross(r, turned)
    return omega, r2 - b * bent + c * np.cross(r, bent) + _left_over(r, r1)


def from_body_rates(r: Float64Array, omega: Float64Array, alpha: Float64Array) -> tuple[Float64Array, Float64Array]:
    """The rates r1 and r2 of the vector r of a rotation with that body rate, and rate of it: the other way round."""
    r1 = _unbent(r, omega)
    return r1, _unbent(r, alpha - _left_over(r, r1))


def _left_over(r: Float64Array, r1: Float64Array) -> Float64Array:
    """The rate of J_r times r1."""
    _, c, b_rate, c_rate = _coefficients(r)
    turned, growth = np.cross(r, r1), 2.0 * np.sum(r * r1, axis=1)[:, np.newaxis]
    out: Float64Array = c * np.cross(r1, turned) + growth * (c_rate * np.cross(r, turned) - b_rate * turned)
    return out


def _unbent(r: Float64Array, x: Float64Array) -> Float64Array:
    """The inverse of J_r times x."""
    angle2 = np.sum(r * r, axis=1)[:, np.newaxis]
    small = angle2 < SMALL
    safe = np.where(small, 1.0, angle2)
    half = 0.5 * np.sqrt(safe)
    d = (1.0 - half / np.tan(half)) / safe
    d = np.where(small, 1.0 / 12.0 + angle2 * (1.0 / 720.0 + angle2 * (1.0 / 30240.0 + angle2 / 1209600.0)), d)
    turned = np.cross(r, x)
    out: Float64Array = x + 0.5 * turned + d * np.cross(r, turned)
    return out


def _coefficients(r: Float64Array) -> Coefficients:
    """b = (1 - cos a) / a^2 and c = (a - sin a) / a^3 of each angle, and their rates by a^2: (k, 1) each."""
    x = np.sum(r * r, axis=1)[:, np.newaxis]
    small = x < SMALL
    safe = np.where(small, 1.0, x)
    angle = np.sqrt(safe)
    a = np.sin(angle) / angle
    b = 2.0 * (np.sin(0.5 * angle) / angle) ** 2
    c = (1.0 - a) / safe
    exact = b, c, 0.5 * (a - 2.0 * b) / safe, 0.5 * (b - 3.0 * c) / safe
    near = (
        1 / 2 - x * (1 / 24 - x * (1 / 720 - x / 40320)),
        1 / 6 - x * (1 / 120 - x * (1 / 5040 - x / 362880)),
        -1 / 24 + x * (1 / 360 - x * (1 / 13440 - x / 907200)),
        -1 / 120 + x * (1 / 2520 - x * (1 / 120960 - x / 9979200)),
    )
    b, c, b_rate, c_rate = (np.where(small, left, right) for left, right in zip(near, exact, strict=True))
    return b, c, b_rate, c_rate
