"""TaskMotion: what a law of task space follows; between samples of it, and from one motion to another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np

from taut.base.checks import instance_of, one_of, read_only, vector
from taut.base.types import Array, ArrayLike, Float64Array
from taut.control.trajectories.reference import Rows, Sample, Shapes
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import exp_rows, from_body_rates, log_rows, rotated, to_body_rates
from taut.trace.pose import Pose

Axes = Literal["world", "tool"]
FRAMES: Final[tuple[Axes, ...]] = ("world", "tool")


@dataclass(frozen=True, slots=True, init=False, eq=False)
class TaskMotion(Sample):
    """Desired pose, twist and acceleration of the tool.

    Frames:
        `pose` is T_WD, of the desired tool frame D in the world. With frame="world" `twist` is the velocity of D's
        origin and its angular velocity, in world axes, and `acceleration` the rate of both. With frame="tool" they
        are the body twist of D and the rate of its numbers, as the textbook's are; they are kept in world axes.

    Args:
        pose: Where the tool is to be.
        twist: (6,) linear part first [m/s, rad/s]; zero if left out.
        acceleration: (6,) linear part first [m/s^2, rad/s^2]; zero if left out.
        frame: The axes of twist and acceleration, "world" or "tool".

    Raises:
        UsageError: No Pose, or another frame.
        ShapeError, RangeError: Not six numbers, or not finite ones.

    Example:
        >>> pose = Pose([0.4, 0.0, 0.3], rpy=[0.0, np.pi, 0.0])
        >>> ref = TaskMotion(pose=pose, twist=[0, 0, 1, 0, 0, 0], frame="tool")
        >>> ref.twist.round(6).tolist()
        [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]

    References:
        Section 10.2.3 task space motion control.
    """

    _shapes: ClassVar[Shapes] = {"p": (3,), "R": (3, 3), "twist": (6,), "acceleration": (6,)}

    p: Array  # (3,) [m]
    R: Array  # (3, 3)
    twist: Array  # (6,) world axes
    acceleration: Array  # (6,) world axes

    def __init__(
        self,
        *,
        pose: Pose,
        twist: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        frame: Axes = "world",
    ) -> None:
        instance_of("ref.pose", pose, Pose, "a taut.Pose")
        one_of("frame", frame, FRAMES)
        V = np.zeros(6) if twist is None else vector("ref.twist", twist, 6, unit="m/s, rad/s")
        rate = vector("ref.acceleration", np.zeros(6) if acceleration is None else acceleration, 6)
        if frame == "tool":
            rate = rotated(pose.R, rate) + np.append(np.cross(pose.R @ V[3:], pose.R @ V[:3]), np.zeros(3)) + 0.0
            V = rotated(pose.R, V) + 0.0
        for name, value in (("p", pose.p), ("R", pose.R), ("twist", V), ("acceleration", rate)):
            object.__setattr__(self, name, read_only(value))

    @property
    def pose(self) -> Pose:
        """T_WD, where the tool is to be."""
        return Pose.of(self.R, self.p)

    @classmethod
    def between(cls, times: Float64Array, knots: Float64Array, rows: Rows) -> dict[str, Float64Array]:
        """At rest before the first knot and after the last.

        Between them position and rotation vector are quintics with the given velocities and accelerations at both
        ends: slerp where both rotate at the mean rate. Twist and acceleration are the rates of that motion.
        """
        if len(knots) == 1:
            zero = np.zeros((len(times), 6))
            places = np.zeros(len(times), dtype=np.intp)
            return {"p": rows["p"][places], "R": rows["R"][places], "twist": zero, "acceleration": zero.copy()}
        i = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
        h = knots[i + 1] - knots[i]
        y = np.array(quintic_between(np.clip((times - knots[i]) / h, 0.0, 1.0), h, *piece_ends(rows)[:, :, i]))
        y[1:, (times < knots[0]) | (times > knots[-1])] = 0.0
        return tool_motion(rows["R"][i], y)

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> TaskMotion:
        T, zero = x.T(tool), np.zeros(6)
        return cls.of({"p": T.p, "R": T.R, "twist": zero, "acceleration": zero})

    def __repr__(self) -> str:
        if self.p.dtype == object:
            return "TaskMotion(<traced>)"
        return (
            f"TaskMotion(pose={self.pose!r}, twist={self.twist.tolist()}, acceleration={self.acceleration.tolist()})"
        )


Offset = tuple[Float64Array, Float64Array, Float64Array]
"""A vector and its two rates, a row for each time."""


def tool_motion(R: Float64Array, y: Float64Array) -> dict[str, Float64Array]:
    """The fields at positions and rotation vectors from R, with their rates: y (3, k, 6)."""
    (p, v, a), r = y[:, :, :3], y[:, :, 3:]
    R = R @ exp_rows(r[0])
    omega, alpha = (rotated_rows(R, part) for part in to_body_rates(*r))
    return {"p": p, "R": R, "twist": np.hstack([v, omega]), "acceleration": np.hstack([a, alpha])}


def quintic_between(x: Float64Array, h: Float64Array | float, start: Offset, end: Offset) -> Offset:
    """The quintic, and its two rates, with value, rate, acceleration (k, m) at x = 0 and 1; h [s] between them."""
    x, h = x[:, np.newaxis], np.asarray(h, dtype=np.float64).reshape(-1, 1)
    (y0, v0, a0), (y1, v1, a1) = start, end
    v0, v1, a0, a1 = v0 * h, v1 * h, a0 * h**2, a1 * h**2
    change = y1 - y0
    c3 = 10.0 * change - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15.0 * change + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
    c5 = 6.0 * change - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1
    y = y0 + x * (v0 + x * (0.5 * a0 + x * (c3 + x * (c4 + x * c5))))
    rate = v0 + x * (a0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))
    return y, rate / h, (a0 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5))) / h**2


def linear_rates(rows: Rows) -> Offset:
    """Position, velocity and acceleration of the tool's origin at the knots, each (k, 3)."""
    return rows["p"], rows["twist"][:, :3], rows["acceleration"][:, :3]


def piece_ends(rows: Rows) -> Float64Array:
    """(2, 3, k, 6) position and rotation vector from each knot with their rates: at the knot, and at the next one."""
    R = rows["R"]
    omega, alpha = (_rotated_back(R, rows[name][:, 3:]) for name in ("twist", "acceleration"))
    reach = log_rows(R[:-1].transpose(0, 2, 1) @ R[1:])
    turns = (np.zeros_like(reach), omega[:-1], alpha[:-1]), (reach, *from_body_rates(reach, omega[1:], alpha[1:]))
    p = np.array(linear_rates(rows))
    return np.concatenate([[p[:, :-1], p[:, 1:]], turns], axis=-1)


def differences(times: Float64Array, p: Float64Array, R: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Twists and accelerations (k, 6) from poses alone: central differences, one-sided at the ends."""
    if len(times) == 1:
        return np.zeros((1, 6)), np.zeros((1, 6))
    h = np.diff(times)[:, np.newaxis]
    slopes = log_rows(R[:-1].transpose(0, 2, 1) @ R[1:]) / h  # in the axes of both ends
    omega = np.vstack([slopes[:1], (h[1:] * slopes[:-1] + h[:-1] * slopes[1:]) / (h[1:] + h[:-1]), slopes[-1:]])
    twist = np.hstack([np.gradient(p, times, axis=0), rotated_rows(R, omega)])
    return twist, np.gradient(twist, times, axis=0)


def offset(old: Rows, new: Rows) -> tuple[Offset, Offset]:
    """The offset of an old motion from a new one at one instant: of the position, and of the rotation as exp(r)."""
    linear = tuple(a - b for a, b in zip(linear_rates(old), linear_rates(new), strict=True))
    back = new["R"].transpose(0, 2, 1) @ old["R"]
    omega, alpha = (_rotated_back(old["R"], old[name][:, 3:]) for name in ("twist", "acceleration"))
    omega_new, alpha_new = (_rotated_back(new["R"], new[name][:, 3:]) for name in ("twist", "acceleration"))
    seen, seen_rate = _rotated_back(back, omega_new), _rotated_back(back, alpha_new)
    # In the axes of the old one, with w = omega - seen: seen' = seen_rate - w x seen.
    w = omega - seen
    r = log_rows(back)
    return linear, (r, *from_body_rates(r, w, alpha - seen_rate + np.cross(w, seen)))  # type: ignore[return-value]


def faded(rows: Rows, x: Float64Array, duration: float, start: tuple[Offset, Offset]) -> dict[str, Float64Array]:
    """A motion (k, ...) by field with an `offset` that fades in `duration` [s]: full at x = 0, none from x = 1 on."""
    none = (np.zeros((1, 3)),) * 3
    p, v, a = quintic_between(x, duration, start[0], none)
    r = quintic_between(x, duration, start[1], none)
    turn = exp_rows(r[0])
    w, w_rate = to_body_rates(*r)
    seen, seen_rate = (
        _rotated_back(turn, _rotated_back(rows["R"], rows[name][:, 3:])) for name in ("twist", "acceleration")
    )
    R = rows["R"] @ turn
    omega, alpha = rotated_rows(R, seen + w), rotated_rows(R, seen_rate + w_rate - np.cross(w, seen))
    return {
        "p": rows["p"] + p,
        "R": R,
        "twist": np.hstack([rows["twist"][:, :3] + v, omega]),
        "acceleration": np.hstack([rows["acceleration"][:, :3] + a, alpha]),
    }


def rotated_rows(R: Float64Array, x: Float64Array) -> Float64Array:
    """R x, row by row."""
    out: Float64Array = np.einsum("kij,kj->ki", R, x)
    return out


def _rotated_back(R: Float64Array, x: Float64Array) -> Float64Array:
    """R^T x, row by row."""
    out: Float64Array = np.einsum("kji,kj->ki", R, x)
    return out
