"""Rotations and rigid motions: logarithm, exponential, adjoint and their rates, for floats and symbols.

6-vectors have the linear part first. Everything is smooth through the identity and accurate up to rotations by pi,
where the axis has two signs and one is chosen. Of many rotations R = exp(r), one a row, the body rate is omega =
J_r(r) r_dot and its own rate alpha = J_r(r) r_ddot + J_r_dot r_dot, with the right Jacobian J_r of SO(3): both
directions, for rotation vectors shorter than 2 pi.

References:
    Lynch and Park, Modern Robotics (2017), chapter 3; Barfoot, State Estimation for Robotics (2017), section 7.1.5.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from taut.base.types import Float64Array, Matrix, Rotation, Twist, Vector3
from taut.trace import math as tm
from taut.trace.pose import Pose, quaternion

SERIES_BELOW: Final = 1e-4  # [rad^2] square of an angle below which a series is more accurate than the formula
SERIES_BELOW_OF_RATES: Final = 1e-3  # [rad^2] likewise of the rates of its coefficients


def rotated(R: Rotation, six: Any) -> Twist:
    """(6,) a twist, wrench or acceleration given in the axes of B, in those of A: both parts turned by R_AB."""
    return tm.array([*(R @ six[:3]), *(R @ six[3:])])


def rotated_matrix(R: Rotation, C: Matrix) -> Matrix:
    """(6, 6) of one set of axes in another, block by block: an inertia, a stiffness, a mobility."""
    out = tm.zeros((6, 6))
    for i in (0, 3):
        for j in (0, 3):
            out[i : i + 3, j : j + 3] = R @ C[i : i + 3, j : j + 3] @ R.T
    return out


def _half_angle(R: Rotation) -> tuple[Vector3, Any, Any]:
    """Rotation vector of R, its square, and 1 - (angle / 2) / tan(angle / 2)."""
    w, vector = quaternion(R)
    s2 = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
    small = s2 < SERIES_BELOW / 4.0
    s = tm.sqrt(tm.where(small, 1.0, s2))
    ratio = tm.where(small, 0.0, tm.atan2(s, w) / s)  # half angle over its sine
    x2 = s2 / (w * w + s2)  # sin^2: asin(x) / x = 1 + x^2/6 + 3 x^4/40 + 15 x^6/336
    ratio = tm.where(small, 1.0 + x2 * (1.0 / 6.0 + x2 * (3.0 / 40.0 + x2 * (15.0 / 336.0))), ratio)
    return 2.0 * ratio * vector, s2, 1.0 - ratio * w


def rotation_log_and_curve(R: Rotation) -> tuple[Vector3, Any]:
    """(3,) rotation vector w of R, and c of its rates: J^-1 f = f - w x f / 2 + c w x (w x f), see `turned_back`."""
    w, _, defect = _half_angle(R)
    return w, _curve(w[0] * w[0] + w[1] * w[1] + w[2] * w[2], defect)


def turned_back(w: Vector3, c: Any, f: Vector3, sign: float = 1.0) -> Vector3:
    """(3,) inverse left Jacobian of the rotation vector w times f; with sign -1 the right one."""
    turned = tm.cross(w, f)
    out: Vector3 = f - 0.5 * sign * turned + c * tm.cross(w, turned)
    return out


def rotation_log(R: Rotation) -> Vector3:
    """(3,) rotation vector of R [rad]: axis times angle, at most pi long."""
    return _half_angle(R)[0]


def _sines(angle2: Any) -> tuple[Any, Any, Any]:
    """sin(a)/a, (1 - cos a)/a^2 and (a - sin a)/a^3 from a^2."""
    small = angle2 < SERIES_BELOW
    safe = tm.where(small, 1.0, angle2)
    angle = tm.sqrt(safe)
    sine, cosine = tm.sin(angle), tm.cos(angle)
    series = (
        1.0 - angle2 * (1.0 / 6.0 - angle2 * (1.0 / 120.0)),
        0.5 - angle2 * (1.0 / 24.0 - angle2 * (1.0 / 720.0)),
        1.0 / 6.0 - angle2 * (1.0 / 120.0 - angle2 * (1.0 / 5040.0)),
    )
    exact = (sine / angle, (1.0 - cosine) / safe, (angle - sine) / (safe * angle))
    a, b, c = (tm.where(small, near, far) for near, far in zip(series, exact, strict=True))
    return a, b, c


def rotation_exp(w: Vector3) -> Rotation:
    """(3, 3) rotation by the vector w [rad] (Rodrigues)."""
    a, b, _ = _sines(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    W = tm.skew(w)
    return tm.eye(3) + a * W + b * (W @ W)  # type: ignore[no-any-return]


def _curve(angle2: Any, defect: Any) -> Any:
    """(1 - (a/2) / tan(a/2)) / a^2, from a^2 and its numerator."""
    small = angle2 < SERIES_BELOW
    series = 1.0 / 12.0 + angle2 * (1.0 / 720.0 + angle2 * (1.0 / 30240.0))
    return tm.where(small, series, defect / tm.where(small, 1.0, angle2))


def curve(w: Vector3) -> Any:
    """c of `turned_back` for a rotation vector w, |w| up to pi."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    half = 0.5 * tm.sqrt(tm.where(angle2 < SERIES_BELOW, 1.0, angle2))
    return _curve(angle2, 1.0 - half * tm.cos(half) / tm.sin(half))


def left_jacobian_inverse(w: Vector3) -> Matrix:
    """(3, 3) inverse left Jacobian, |w| up to pi: the rate of w of a rotation exp(w) per angular velocity."""
    W = tm.skew(w)
    c = curve(w)
    return tm.eye(3) - 0.5 * W + c * (W @ W)  # type: ignore[no-any-return]


def adjoint(T: Pose) -> Matrix:
    """(6, 6) Ad of T_AB: takes a twist of B's numbers to A's, linear part first."""
    out = tm.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = T.R
    out[:3, 3:] = tm.skew(T.p) @ T.R
    return out


def pose_log(T: Pose) -> Twist:
    """(6,) the constant twist that leads from the identity to T in one second [m, rad]."""
    w, c = rotation_log_and_curve(T.R)
    return tm.array([*turned_back(w, c, T.p), *w])


def moved(T: Pose, step: Twist) -> Pose:
    """T after a small step of a world-aligned twist, to first order: by it functions of poses are differentiated."""
    return Pose.of(T.R + tm.skew(step[3:]) @ T.R, T.p + step[:3])


def pose_log_rate(xi: Twist) -> Matrix:
    """(6, 6) rate of xi = log T per spatial twist V of T, T-dot = [V] T: the inverse left Jacobian of SE(3)."""
    v, w = xi[:3], xi[3:]
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    _, b, c = _sines(angle2)
    small = angle2 < SERIES_BELOW
    safe = tm.where(small, 1.0, angle2)
    d = tm.where(small, 1.0 / 24.0 - angle2 / 720.0, (0.5 - b) / safe)  # (a^2/2 + cos a - 1) / a^4
    e = tm.where(small, 1.0 / 120.0 - angle2 / 2520.0, 0.5 * (d + 3.0 * (c - 1.0 / 6.0) / safe))
    V, W = tm.skew(v), tm.skew(w)
    WV, VW = W @ V, V @ W
    WVW = WV @ W
    Q = 0.5 * V + c * (WV + VW + WVW) + d * (W @ WV + VW @ W - 3.0 * WVW) + e * (WVW @ W + W @ WVW)
    inverse = left_jacobian_inverse(w)
    out = tm.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = inverse
    out[:3, 3:] = -(inverse @ Q @ inverse)
    return out


Coefficients = tuple[Float64Array, Float64Array, Float64Array, Float64Array]


def log_rows(R: Float64Array) -> Float64Array:
    """(k, 3) rotation vectors of rotations (k, 3, 3) [rad]: at most pi long."""
    return np.ascontiguousarray(rotation_log(np.moveaxis(R, 0, -1)).T, dtype=np.float64)


def exp_rows(r: Float64Array) -> Float64Array:
    """(k, 3, 3) rotations by the vectors r (k, 3) [rad]."""
    from scipy.spatial.transform import Rotation as Rotations

    return np.asarray(Rotations.from_rotvec(r).as_matrix(), dtype=np.float64)


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
    turned = np.cross(r, x)
    out: Float64Array = x + 0.5 * turned + curve(r.T)[:, np.newaxis] * np.cross(r, turned)
    return out


def _coefficients(r: Float64Array) -> Coefficients:
    """b = (1 - cos a) / a^2 and c = (a - sin a) / a^3 of each angle, and their rates by a^2: (k, 1) each."""
    x = np.sum(r * r, axis=1)[:, np.newaxis]
    small = x < SERIES_BELOW_OF_RATES
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
