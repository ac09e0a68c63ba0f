"""Trajectories of task space: paths of the tool as functions of time, with `at(t)` and `rows(times)`.

Before its start a trajectory rests at its first pose, after its end at its last. Twists and accelerations are the
exact rates of the pose, in world axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from taut.base.checks import finite_scalar, one_of, positive_scalar, vector
from taut.base.errors import RangeError, UsageError
from taut.base.types import ArrayLike, Float64Array, Rotation, Vector3
from taut.control.trajectories.task_reference import TaskMotion
from taut.control.trajectories.timing import Scaling, ScalingKind, Size, Timing, timed
from taut.maths.spatial import exp_rows, left_jacobian_inverse, rotation_log, to_body_rates
from taut.trace.pose import Pose

__all__ = ["Circle", "Line", "Screw", "Steady", "checked_pose", "task_rows", "turn_between"]

HALF_TURN: Final = 1e-9  # [rad] a rotation this close to pi has two ways
NO_PART: Final = 1e-6  # a component of a unit vector this small counts as none
DEGREES: Final = 30.0  # [rad] from which on a round number is one of degrees
FLAT: Final = 1e-6  # [m] how far from the circle's plane its centre may be
STRAIGHT: Final = 1e-9  # sine of an angle below which three points are on one line
ORIENTATIONS: Final = ("keep", "turn")


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """A straight line of the tool's origin, while the orientation turns about one axis (slerp).

    p = p_0 + s (p_1 - p_0) and R = R_0 exp(s log(R_0^T R_1)), with s(t) from 0 to 1.

    A rotation by exactly pi has two ways. The one is taken whose axis, in the axes of T0, has a positive x; where it
    has none, a positive y; else a positive z. To go the other way, go by a pose in between.

    Args:
        T0: First pose.
        T1: Last pose; it may be the first one.
        duration: [s]; what the limits need if left out. Afterwards: how long it takes.
        velocity: (linear, angular) largest speeds [m/s, rad/s].
        acceleration: (linear, angular) largest accelerations [m/s^2, rad/s^2].
        scaling: "quintic", which is minimum jerk; "cubic", whose acceleration jumps at both ends; or "trapezoidal",
            the fastest under limits, with a third of the time each for ramp, cruise and ramp where only a duration is
            given.

    Raises:
        UsageError: No Pose, neither a duration nor both limits, another scaling.
        ShapeError, RangeError: Limits that are no pair or not above zero; a duration shorter than they allow.

    Example:
        >>> line = Line(T0=Pose([0.4, 0.0, 0.3]), T1=Pose([0.4, 0.2, 0.3]), duration=2.0)
        >>> line.at(1.0).p.tolist(), line.at(1.0).twist[1].round(4).item()
        ([0.4, 0.1, 0.3], 0.1875)
    """

    T0: Pose
    T1: Pose
    duration: float | None = None  # [s]
    velocity: ArrayLike | None = None  # (2,) [m/s, rad/s]
    acceleration: ArrayLike | None = None  # (2,) [m/s^2, rad/s^2]
    scaling: ScalingKind = "quintic"

    def __post_init__(self) -> None:
        T0, T1 = checked_pose("T0", self.T0), checked_pose("T1", self.T1)
        turn = turn_between(T0.R, T1.R)
        _keep(self, Size(length=_norm(T1.p - T0.p), bend=0.0, turn=_norm(turn)), _turn=turn)

    def at(self, t: float) -> TaskMotion:
        """The sample at time t [s]."""
        return _one(self.rows(_instant(t)))

    def rows(self, times: Float64Array) -> TaskMotion:
        """Samples at many times, as arrays (k, ...)."""
        s, way, turn = self._timing.at(times), self.T1.p - self.T0.p, self._turn  # type: ignore[attr-defined]
        R = self.T0.R @ exp_rows(s[0][:, np.newaxis] * turn)
        p = self.T0.p + s[0][:, np.newaxis] * way
        return _moving(s, p, np.broadcast_to(way, p.shape), np.zeros_like(p), R, self.T0.R @ turn)


@dataclass(frozen=True, kw_only=True, eq=False)
class Screw:
    """A screw motion: the tool keeps one body twist from T0 to T1, but for its speed.

    T = T_0 exp(s log(T_0^-1 T_1)), with s(t) from 0 to 1: the tool turns about an axis in space and slides along it,
    and its origin follows a helix. Without rotation it is a straight line. Of two ways by exactly pi it
    goes that of `Line`.

    Args:
        T0: First pose.
        T1: Last pose; it may be the first one.
        duration: [s]; what the limits need if left out. Afterwards: how long it takes.
        velocity: (linear, angular) largest speeds of the tool's origin and of its rotation [m/s, rad/s].
        acceleration: (linear, angular) largest accelerations, of the origin across its way included [m/s^2, rad/s^2].
        scaling: "quintic", "cubic" or "trapezoidal", as of `Line`.

    Raises:
        UsageError: No Pose, neither a duration nor both limits, another scaling.
        ShapeError, RangeError: Limits that are no pair or not above zero; a duration shorter than they allow.

    Example:
        >>> screw = Screw(T0=Pose([1.0, 0.0, 0.0]), T1=Pose([0.0, 1.0, 0.5], rpy=[0, 0, np.pi / 2]), duration=2.0)
        >>> screw.at(1.0).p.round(4).tolist()  # on a quarter of a helix about the z axis
        [0.7071, 0.7071, 0.25]

    References:
        Lynch and Park, Modern Robotics (2017), section 9.2.1 (straight-line paths in SE(3)).
    """

    T0: Pose
    T1: Pose
    duration: float | None = None  # [s]
    velocity: ArrayLike | None = None  # (2,) [m/s, rad/s]
    acceleration: ArrayLike | None = None  # (2,) [m/s^2, rad/s^2]
    scaling: ScalingKind = "quintic"

    def __post_init__(self) -> None:
        T0, T1 = checked_pose("T0", self.T0), checked_pose("T1", self.T1)
        w = turn_between(T0.R, T1.R)
        v = left_jacobian_inverse(w) @ (T0.R.T @ (T1.p - T0.p))
        size = Size(length=_norm(v), bend=_norm(np.cross(w, v)), turn=_norm(w))
        _keep(self, size, _turn=w, _slide=v)

    def at(self, t: float) -> TaskMotion:
        """The sample at time t [s]."""
        return _one(self.rows(_instant(t)))

    def rows(self, times: Float64Array) -> TaskMotion:
        """Samples at many times, as arrays (k, ...)."""
        s, R0 = self._timing.at(times), self.T0.R  # type: ignore[attr-defined]
        w, v = self._turn, self._slide  # type: ignore[attr-defined]  # set in __post_init__
        along = s[0][:, np.newaxis]
        R = R0 @ exp_rows(along * w)
        # The left Jacobian of a vector is the right one of its opposite.
        moved, _ = to_body_rates(-along * w, np.broadcast_to(v, (len(times), 3)), np.zeros((len(times), 3)))
        p = self.T0.p + (along * moved) @ R0.T
        return _moving(s, p, R @ v, R @ np.cross(w, v), R, R0 @ w)


@dataclass(frozen=True, kw_only=True, eq=False)
class Circle:
    """A circle, or an arc of one, from where the tool is at the start.

    Args:
        T0: First pose; its origin is on the circle.
        centre: (3,) [m].
        axis: (3,) normal of the circle's plane, of any length; the tool goes about it by the right-hand rule.
        angle: [rad] how far; a whole turn by default, negative for the other way round, more for more turns.
        orientation: "keep" the first orientation, or "turn" with the circle.
        duration: [s]; what the limits need if left out. Afterwards: how long it takes.
        velocity: (linear, angular) largest speeds [m/s, rad/s].
        acceleration: (linear, angular) largest accelerations, towards the centre included [m/s^2, rad/s^2].
        scaling: "quintic", "cubic" or "trapezoidal", as of `Line`.

    Raises:
        UsageError: No Pose, neither a duration nor both limits, another word.
        ShapeError: A wrong number of entries.
        RangeError: No axis, a centre that is T0 itself or off the plane, a duration shorter than the limits allow.

    Example:
        >>> ring = Circle(T0=Pose([0.5, 0.0, 0.3]), centre=[0.4, 0.0, 0.3], axis=[0, 0, 1], duration=4.0)
        >>> ring.at(2.0).p.round(6).tolist(), round(ring.radius, 6)
        ([0.3, 0.0, 0.3], 0.1)
        >>> arc = Circle.through(T0=Pose([0.5, 0.0, 0.3]), via=[0.4, 0.1, 0.3], end=[0.3, 0.0, 0.3], duration=1.0)
        >>> round(arc.angle, 9) == round(np.pi, 9)
        True
    """

    T0: Pose
    centre: ArrayLike  # (3,) [m]
    axis: ArrayLike  # (3,)
    angle: float = 2.0 * np.pi  # [rad]
    orientation: Literal["keep", "turn"] = "keep"
    duration: float | None = None  # [s]
    velocity: ArrayLike | None = None  # (2,) [m/s, rad/s]
    acceleration: ArrayLike | None = None  # (2,) [m/s^2, rad/s^2]
    scaling: ScalingKind = "quintic"

    def __post_init__(self) -> None:
        T0 = checked_pose("T0", self.T0)
        centre, axis = vector("centre", self.centre, 3, unit="m"), vector("axis", self.axis, 3)
        angle = finite_scalar("angle", self.angle, unit="rad")
        if abs(angle) >= DEGREES and abs(angle) % 5.0 == 0.0:
            raise RangeError(
                f"angle must be in radians; got {angle:g}, which is {abs(angle) / (2.0 * np.pi):.3g} turns; if it is "
                f"in degrees, np.radians({angle:g}) converts it",
                name="angle",
                value=angle,
                rule="radians",
            )
        one_of("orientation", self.orientation, ORIENTATIONS)
        if not axis.any():
            raise RangeError("axis must have a direction; got zeros", name="axis", rule="not zero")
        axis = axis / np.abs(axis).max()
        axis = axis / _norm(axis)
        off = float(axis @ (T0.p - centre))
        nearest = centre + off * axis
        if abs(off) > FLAT:
            raise RangeError(
                f"centre must be in the plane through T0 that the axis is normal to; it is {abs(off):.3g} m off, and "
                f"the nearest point is {nearest.round(6).tolist()}",
                name="centre",
                value=off,
                rule="in the plane",
            )
        spoke = T0.p - nearest
        if _norm(spoke) < FLAT:
            raise RangeError(
                "centre is where the circle starts, so that it has no radius; give another point",
                name="centre",
                rule="a radius",
            )
        for name, value in (("centre", nearest), ("axis", axis), ("angle", angle)):
            object.__setattr__(self, name, value)
        length, turn = abs(angle) * _norm(spoke), abs(angle) if self.orientation == "turn" else 0.0
        _keep(self, Size(length=length, bend=abs(angle) * length, turn=turn), _spoke=spoke)

    @classmethod
    def through(
        cls,
        *,
        T0: Pose,
        via: ArrayLike,
        end: ArrayLike,
        orientation: Literal["keep", "turn"] = "keep",
        duration: float | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        scaling: ScalingKind = "quintic",
    ) -> Circle:
        """The arc from T0 through one point to another.

        Args:
            T0: First pose.
            via: (3,) a point in between [m].
            end: (3,) the last point [m].
            orientation: As above, like what follows.
            duration: [s].
            velocity: (linear, angular) [m/s, rad/s].
            acceleration: (linear, angular) [m/s^2, rad/s^2].
            scaling: "quintic", "cubic" or "trapezoidal".

        Raises:
            RangeError: Points that are the same, or on one line.
        """
        checked_pose("T0", T0)
        b, c = (vector(name, x, 3, unit="m") - T0.p for name, x in (("via", via), ("end", end)))
        normal = np.cross(b, c)
        if _norm(normal) <= STRAIGHT * _norm(b) * _norm(c):
            raise RangeError(
                "via and end must make a circle with T0: three different points that are not on one line; for a "
                "straight line take taut.trajectories.Line",
                name="via",
                rule="three points of a circle",
            )
        centre = np.cross((b @ b) * c - (c @ c) * b, normal) / (2.0 * (normal @ normal))
        axis = normal / _norm(normal)
        x, y = -centre, np.cross(axis, -centre)
        angle = float(np.arctan2((c - centre) @ y, (c - centre) @ x)) % (2.0 * np.pi)
        return cls(
            T0=T0,
            centre=T0.p + centre,
            axis=axis,
            angle=angle,
            orientation=orientation,
            duration=duration,
            velocity=velocity,
            acceleration=acceleration,
            scaling=scaling,
        )

    @property
    def radius(self) -> float:
        """[m]."""
        return _norm(self._spoke)  # type: ignore[attr-defined]

    def at(self, t: float) -> TaskMotion:
        """The sample at time t [s]."""
        return _one(self.rows(_instant(t)))

    def rows(self, times: Float64Array) -> TaskMotion:
        """Samples at many times, as arrays (k, ...)."""
        s, turn = self._timing.at(times), self.angle * np.asarray(self.axis)  # type: ignore[attr-defined]
        turned = exp_rows(s[0][:, np.newaxis] * turn)
        spoke = turned @ self._spoke  # type: ignore[attr-defined]
        p, way = np.asarray(self.centre) + spoke, np.cross(turn, spoke)
        if self.orientation == "turn":
            return _moving(s, p, way, np.cross(turn, way), turned @ self.T0.R, turn)
        R = np.broadcast_to(self.T0.R, turned.shape)
        return _moving(s, p, way, np.cross(turn, way), R, np.zeros(3))


# -------------------------------------------------------------------- what they share


def checked_pose(name: str, pose: object) -> Pose:
    """A pose that a caller hands in.

    Raises:
        UsageError: It is none.
    """
    if not isinstance(pose, Pose):
        raise UsageError(f"{name} must be a taut.Pose(p=..., rpy=...); got {type(pose).__name__}", name=name)
    return pose


def turn_between(R0: Rotation, R1: Rotation) -> Vector3:
    """(3,) the rotation vector from R0 to R1, in the axes of R0 [rad]; by pi the way that `Line` states."""
    w = np.asarray(rotation_log(R0.T @ R1), dtype=np.float64)
    angle = _norm(w)
    if np.pi - angle < HALF_TURN:
        lead = next(x for x in w / angle if abs(x) > NO_PART)
        if lead < 0.0:
            return w * (1.0 - 2.0 * np.pi / angle)
    return w


def task_rows(p: Float64Array, R: Float64Array, twist: Float64Array, acceleration: Float64Array) -> TaskMotion:
    """Samples from arrays (k, 3), (k, 3, 3), (k, 6), (k, 6) in world axes."""
    return TaskMotion.of({"p": p, "R": R, "twist": twist, "acceleration": acceleration})


def _moving(
    scaling: Scaling, p: Float64Array, way: Float64Array, bend: Float64Array, R: Float64Array, turn: Vector3
) -> TaskMotion:
    """Motion along a path, whose rotation per unit of s is constant in the world.

    Args:
        scaling: s and its two rates.
        p: (k, 3) [m].
        way: (k, 3) dp/ds [m].
        bend: (k, 3) d^2p/ds^2 [m].
        R: (k, 3, 3).
        turn: (3,) [rad].
    """
    _, rate, second = (x[:, np.newaxis] for x in scaling)
    turns = np.broadcast_to(turn, p.shape)
    twist = rate * np.hstack([way, turns])
    acceleration = second * np.hstack([way, turns]) + rate**2 * np.hstack([bend, np.zeros_like(bend)])
    return task_rows(p, R, twist, acceleration)


def _keep(trajectory: Line | Screw | Circle, size: Size, **values: Any) -> None:
    """The timing of a trajectory, and what follows from its fields."""
    limits = trajectory.duration, trajectory.velocity, trajectory.acceleration
    timing: Timing = timed(type(trajectory).__name__, size, trajectory.scaling, *limits)
    object.__setattr__(trajectory, "_timing", timing)
    object.__setattr__(trajectory, "duration", timing.duration)
    for name, value in values.items():
        object.__setattr__(trajectory, name, value)


def _instant(t: float) -> Float64Array:
    return np.array([finite_scalar("t", t, unit="s")])


def _one(rows: TaskMotion) -> TaskMotion:
    return task_rows(rows.p[0], rows.R[0], rows.twist[0], rows.acceleration[0])


def _norm(x: Float64Array) -> float:
    return float(np.linalg.norm(x))


@dataclass(frozen=True, kw_only=True, eq=False)
class Steady:
    """A motion at a constant velocity without an end, which starts from rest.

    v(t) = V (3 u^2 - 2 u^3) with u = t / ramp, and V from then on. With a phase's guard it is a guarded move: "down
    at 20 mm/s until 2 N" is

        Phase(law, lambda x: Steady(T0=x.T(), velocity=[0, 0, -0.02]), until=lambda x: taut.guards.contact(x, 2.0))

    Args:
        T0: First pose.
        velocity: (3,) of the tool's origin, world axes [m/s].
        angular: (3,) angular velocity, world axes [rad/s]; none if left out.
        ramp: Time to come up to speed [s].

    Raises:
        UsageError: No Pose.
        ShapeError: A wrong number of entries.
        RangeError: No velocity at all, a ramp that is not above zero.

    Example:
        >>> down = Steady(T0=Pose([0.4, 0.0, 0.3]), velocity=[0.0, 0.0, -0.02], ramp=0.1)
        >>> down.at(1.05).p.round(6).tolist(), down.at(1.05).twist[2].item()
        ([0.4, 0.0, 0.28], -0.02)
    """

    T0: Pose
    velocity: ArrayLike = (0.0, 0.0, 0.0)  # (3,) [m/s]
    angular: ArrayLike = (0.0, 0.0, 0.0)  # (3,) [rad/s]
    ramp: float = 0.1  # [s]

    def __post_init__(self) -> None:
        checked_pose("T0", self.T0)
        for name, unit in (("velocity", "m/s"), ("angular", "rad/s")):
            object.__setattr__(self, name, vector(name, getattr(self, name), 3, unit=unit))
        if not np.any(self.velocity) and not np.any(self.angular):
            raise RangeError("velocity or angular must be above zero, or nothing moves; got zeros", name="velocity")
        object.__setattr__(self, "ramp", positive_scalar("ramp", self.ramp, unit="s"))

    def at(self, t: float) -> TaskMotion:
        """The sample at time t [s]."""
        rows = self.rows(np.array([finite_scalar("t", t, unit="s")]))
        return TaskMotion.of({name: getattr(rows, name)[0] for name in TaskMotion.fields(1)})

    def rows(self, times: Float64Array) -> TaskMotion:
        """Samples at many times, as arrays (k, ...)."""
        u = np.clip(times / self.ramp, 0.0, 1.0)[:, np.newaxis]
        late = np.maximum(times - self.ramp, 0.0)[:, np.newaxis]
        way = self.ramp * u**3 * (1.0 - 0.5 * u) + late  # [s] at full speed
        speed, rate = u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u) / self.ramp
        V = np.concatenate([np.asarray(self.velocity), np.asarray(self.angular)])
        return TaskMotion.of(
            {
                "p": self.T0.p + way * V[:3],
                "R": exp_rows(way * V[3:]) @ self.T0.R,
                "twist": speed * V,
                "acceleration": rate * V,
            }
        )
