"""Pose: where a frame is. One constructor, whose keyword names the order of the rotation's numbers."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from taut.base.checks import finite_array, read_only, vector
from taut.base.errors import RangeError, UsageError
from taut.base.types import Array, ArrayLike, Float64Array, Rotation, Vector3
from taut.trace import math as tm
from taut.trace.array import traced_array

ROTATION_TOLERANCE: Final = 1e-6  # how far R^T R may be from the identity
QUATERNION_TOLERANCE: Final = 1e-3  # how far the norm may be from 1; inside, it is normalised
SNAP: Final = 1e-11  # rotation entries this close to 0 are meant to be exact


class Pose:
    """Position and orientation of one frame in another, T_AB.

    Frames:
        `T_AB` is the pose of B in A; inner letters cancel: T_AC = T_AB @ T_BC.

    Args:
        p: (3,) [m] origin of B in A; zero if left out.
        xyzw: (4,) unit quaternion, scalar last.
        wxyz: (4,) unit quaternion, scalar first.
        R: (3, 3) rotation matrix; its columns are B's axes in A.
        rpy: (3,) [rad] roll, pitch, yaw about fixed x, y, z (URDF's convention).

    Raises:
        ShapeError: Wrong number of entries.
        RangeError: Not finite, a quaternion that is not of unit length, a matrix that is no rotation.
        UsageError: More than one description of the rotation.

    Example:
        >>> T_WE = Pose(p=[0.4, 0.0, 0.3], rpy=[0.0, math.pi, 0.0])
        >>> bool(np.allclose((T_WE @ T_WE.inverse()).p, 0.0))
        True
    """

    __slots__ = ("R", "p")

    p: Vector3
    R: Rotation

    def __init__(
        self,
        p: ArrayLike = (0.0, 0.0, 0.0),
        *,
        xyzw: ArrayLike | None = None,
        wxyz: ArrayLike | None = None,
        R: ArrayLike | None = None,
        rpy: ArrayLike | None = None,
    ) -> None:
        given = [
            word for word, value in (("xyzw", xyzw), ("wxyz", wxyz), ("R", R), ("rpy", rpy)) if value is not None
        ]
        if len(given) > 1:
            raise UsageError(f"a pose takes one rotation; got {' and '.join(given)}; keep one", name=given[1])
        if R is not None:
            rotation = _checked_rotation(finite_array("R", R, shape=(3, 3)))
        elif xyzw is not None:
            x, y, z, w = vector("xyzw", xyzw, 4)
            rotation = _from_quaternion("xyzw", w, x, y, z)
        elif wxyz is not None:
            w, x, y, z = vector("wxyz", wxyz, 4)
            rotation = _from_quaternion("wxyz", w, x, y, z)
        elif rpy is not None:
            rotation = _from_rpy(*_radians(vector("rpy", rpy, 3, unit="rad")))
        else:
            rotation = np.eye(3)
        self._set(vector("p", p, 3, unit="m"), _frozen(rotation))

    def _set(self, p: Array, R: Array) -> None:
        object.__setattr__(self, "p", p)
        object.__setattr__(self, "R", R)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError("a Pose cannot be changed; make a new one")

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (self.R, self.p)

    @classmethod
    def of(cls, R: Rotation, p: Vector3) -> Pose:
        """A pose from a valid rotation and position, symbols too; not copied, and read-only through the pose."""
        pose = object.__new__(cls)
        pose._set(_view(p), _view(R))
        return pose

    @classmethod
    def identity(cls) -> Pose:
        """The pose of a frame in itself."""
        return cls()

    @classmethod
    def from_matrix(cls, T: ArrayLike) -> Pose:
        """A pose from a homogeneous matrix (4, 4)."""
        matrix = finite_array("T", T, shape=(4, 4))
        if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-9, rtol=0.0):
            raise RangeError(
                f"T[3] must be (0, 0, 0, 1); got {tuple(matrix[3].tolist())}; "
                "a homogeneous matrix has the position in its last column",
                name="T",
            )
        return cls(matrix[:3, 3], R=matrix[:3, :3])

    def kept(self) -> Pose:
        """The same pose on arrays of its own, for what outlives whoever made it."""
        return _rebuilt(self.R, self.p)

    @property
    def matrix(self) -> Array:
        """(4, 4) homogeneous matrix."""
        T: Array = np.full((4, 4), 0.0, dtype=np.result_type(self.R.dtype, self.p.dtype))
        T[:3, :3], T[:3, 3], T[3, 3] = self.R, self.p, 1.0
        return traced_array(T) if T.dtype == object else T

    @property
    def wxyz(self) -> Float64Array:
        """(4,) unit quaternion, scalar first, with w >= 0."""
        w, vector = quaternion(np.asarray(self.R, dtype=np.float64))
        return np.array([w, *vector])

    @property
    def xyzw(self) -> Float64Array:
        """(4,) unit quaternion, scalar last, with w >= 0."""
        return np.roll(self.wxyz, -1)

    @property
    def rpy(self) -> Float64Array:
        """(3,) [rad] roll, pitch, yaw; at pitch +-pi/2 roll is set to zero."""
        R = np.asarray(self.R, dtype=np.float64)
        cos_pitch = math.hypot(R[0, 0], R[1, 0])
        pitch = math.atan2(-R[2, 0], cos_pitch)
        if cos_pitch < 1e-9:
            return np.array([0.0, pitch, math.atan2(-R[0, 1], R[1, 1])]) + 0.0
        return np.array([math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])]) + 0.0

    def __matmul__(self, other: Pose) -> Pose:
        if not isinstance(other, Pose):
            return NotImplemented
        return Pose.of(self.R @ other.R, self.R @ other.p + self.p)

    def inverse(self) -> Pose:
        """T_BA from T_AB."""
        return Pose.of(self.R.T, -(self.R.T @ self.p))

    def act(self, point: ArrayLike) -> Vector3:
        """A point given in B, expressed in A: R x + p."""
        moved: Vector3 = self.R @ np.asanyarray(point) + self.p
        return moved

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Pose):
            return NotImplemented
        return bool(np.array_equal(self.R, other.R) and np.array_equal(self.p, other.p))

    def __hash__(self) -> int:
        return hash((self.R.tobytes(), self.p.tobytes()))

    def __repr__(self) -> str:
        if self.R.dtype == object or self.p.dtype == object:
            return "Pose(<traced>)"
        p, rpy = (np.array2string(x, precision=6, separator=", ") for x in (self.p, self.rpy))
        return f"Pose(p={p}, rpy={rpy})"


def _view(array: Array) -> Array:
    """The same numbers or symbols, as an array that nobody can write to."""
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array


def _rebuilt(R: Float64Array, p: Float64Array) -> Pose:
    """A pose on copies, as of a pickle, whose arrays are writeable."""
    return Pose.of(read_only(R), read_only(p))


def axis_angle(axis: Array, angle: float) -> Float64Array:
    """Rotation by `angle` [rad] about the unit vector `axis` (Rodrigues)."""
    K = tm.skew([float(a) for a in axis])
    R: Float64Array = np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * (K @ K)
    return R


def snapped(R: Float64Array) -> Float64Array:
    """R with entries that are 0 but for rounding set exactly, and +-1 where an axis lies along another.

    Exact zeros vanish from a traced law (a fifth of it on the Panda). 1 - 1e-11 alone is 4e-6 rad, not rounding.
    """
    out: Float64Array = np.where(np.abs(R) < SNAP, 0.0, R)
    along = np.count_nonzero(out, axis=1) == 1
    out[along] = np.sign(out[along])
    return out


def _radians(rpy: Float64Array) -> Float64Array:
    """Angles of more than two turns are degrees."""
    far = np.abs(rpy) > 4.0 * math.pi
    if far.any():
        k = int(np.argmax(far))
        raise RangeError(
            f"rpy[{k}] must be an angle in rad; got {rpy[k]:g}, which looks like degrees; use np.radians(...)",
            name="rpy",
            value=float(rpy[k]),
            rule="radians",
        )
    return rpy


def _frozen(rotation: Float64Array) -> Float64Array:
    rotation = snapped(rotation)
    rotation.flags.writeable = False
    return rotation


def _checked_rotation(R: Float64Array) -> Float64Array:
    error = float(np.abs(R.T @ R - np.eye(3)).max())
    if error > ROTATION_TOLERANCE:
        raise RangeError(
            f"R must be orthonormal; R^T R differs from the identity by {error:.2g}; "
            "orthonormalise it or give a quaternion",
            name="R",
            value=error,
            rule="orthonormal",
        )
    if np.linalg.det(R) < 0.0:
        raise RangeError(
            "R must be right-handed; its determinant is -1, so it mirrors; change the sign of one axis",
            name="R",
            value=-1.0,
            rule="right-handed",
        )
    return R


def _from_quaternion(name: str, w: float, x: float, y: float, z: float) -> Float64Array:
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        raise RangeError(
            f"{name} must have length 1; its length is {norm:.6g}; divide it by its length",
            name=name,
            value=norm,
            rule="unit length",
        )
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _from_rpy(roll: float, pitch: float, yaw: float) -> Float64Array:
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quaternion(R: Rotation) -> tuple[Any, Vector3]:
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
