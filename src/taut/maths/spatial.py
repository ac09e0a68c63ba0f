"""Rotations and rigid motions: logarithm, exponential, adjoint and their rates, for floats and symbols.

6-vectors have the linear part first. Everything is smooth through the identity and accurate up to rotations by pi,
where the axis has two signs and one is chosen.

References:
    Lynch and Park, Modern Robotics (2017), chapter 3; Barfoot, State Estimation for Robotics (2017), section 7.1.5.
"""

from __future__ import annotations

from typing import Any, Final

from taut.base.types import Matrix, Rotation, Twist, Vector3
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = [
    "adjoint",
    "curve",
    "left_jacobian",
    "left_jacobian_inverse",
    "moved",
    "pose_exp",
    "pose_log",
    "pose_log_rate",
    "rotated",
    "rotated_matrix",
    "rotation_exp",
    "rotation_log",
    "rotation_log_and_curve",
    "turned_back",
]

SMALL: Final = 1e-4  # below this square of an angle [rad^2] a series is more accurate than the formula


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


# -------------------------------------------------------------------- rotations


def _quaternion(R: Rotation) -> tuple[Any, Vector3]:
    """Scalar part >= 0 and vector part of a rotation, by Shepperd's method: nothing cancels near pi."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    d = [trace, *(2.0 * R[i, i] - trace for i in range(3))]
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    xy, xz, yz = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    rows = [[1.0 + d[0], x, y, z], [x, 1.0 + d[1], xy, xz], [y, xy, 1.0 + d[2], yz], [z, xz, yz, 1.0 + d[3]]]
    best, chosen = d[0], rows[0]
    for k in range(1, 4):
        better = d[k] > best
        best = tm.where(better, d[k], best)
        chosen = [tm.where(better, new, old) for new, old in zip(rows[k], chosen, strict=True)]
    scale = 0.5 / tm.sqrt(1.0 + best)
    scale = tm.where(chosen[0] < 0.0, -scale, scale)
    w, a, b, c = (entry * scale for entry in chosen)
    return w, tm.array([a, b, c])


def _half_angle(R: Rotation) -> tuple[Vector3, Any, Any]:
    """Rotation vector of R, its square, and 1 - (angle / 2) / tan(angle / 2)."""
    w, vector = _quaternion(R)
    s2 = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
    small = s2 < SMALL / 4.0
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
    small = angle2 < SMALL
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


def left_jacobian(w: Vector3) -> Matrix:
    """(3, 3) J with: exp(w + dw) = exp(J dw) exp(w) to first order. The right one is its transpose."""
    _, b, c = _sines(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    W = tm.skew(w)
    return tm.eye(3) + b * W + c * (W @ W)  # type: ignore[no-any-return]


def _curve(angle2: Any, defect: Any) -> Any:
    """(1 - (a/2) / tan(a/2)) / a^2, from a^2 and its numerator."""
    small = angle2 < SMALL
    series = 1.0 / 12.0 + angle2 * (1.0 / 720.0 + angle2 * (1.0 / 30240.0))
    return tm.where(small, series, defect / tm.where(small, 1.0, angle2))


def curve(w: Vector3) -> Any:
    """c of `turned_back` for a rotation vector w, |w| up to pi."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    half = 0.5 * tm.sqrt(tm.where(angle2 < SMALL, 1.0, angle2))
    return _curve(angle2, 1.0 - half * tm.cos(half) / tm.sin(half))


def left_jacobian_inverse(w: Vector3) -> Matrix:
    """(3, 3) inverse of `left_jacobian`, for |w| up to pi: the rate of w of a rotation that turns at J dw."""
    W = tm.skew(w)
    c = curve(w)
    return tm.eye(3) - 0.5 * W + c * (W @ W)  # type: ignore[no-any-return]


# -------------------------------------------------------------------- rigid motions


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


def pose_exp(xi: Twist) -> Pose:
    """The pose after one second of the constant twist xi [m, rad]."""
    v, w = xi[:3], xi[3:]
    a, b, c = _sines(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    W = tm.skew(w)
    square = W @ W
    return Pose.of(tm.eye(3) + a * W + b * square, v + b * (W @ v) + c * (square @ v))


def moved(T: Pose, step: Twist) -> Pose:
    """T after a small step of a world-aligned twist, to first order: by it functions of poses are differentiated."""
    return Pose.of(T.R + tm.skew(step[3:]) @ T.R, T.p + step[:3])


def pose_log_rate(xi: Twist) -> Matrix:
    """(6, 6) rate of xi = log T per spatial twist V of T, T-dot = [V] T: the inverse left Jacobian of SE(3)."""
    v, w = xi[:3], xi[3:]
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    _, b, c = _sines(angle2)
    small = angle2 < SMALL
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
