"""Trajectories of the tool, with the exact rates of the pose in world axes."""

from __future__ import annotations

from abc import abstractmethod
from typing import Final, Literal

import numpy as np

from taut.base.errors import RangeError
from taut.base.fields import Choice, Field, Part
from taut.base.types import Float64Array, Rotation, Vector3
from taut.control.trajectories.reference import Rows
from taut.control.trajectories.task_reference import TaskMotion
from taut.control.trajectories.timing import Motion, ScalingKind, Size, Timing
from taut.maths.spatial import exp_rows, rotation_log
from taut.trace.pose import Pose

HALF_TURN_TOLERANCE: Final = 1e-9  # [rad] a rotation this close to pi has two directions
NO_COMPONENT: Final = 1e-6  # a component of a unit vector this small counts as none
DEGREES: Final = 30.0  # [rad] from which on a round number is one of degrees
IN_PLANE: Final = 1e-6  # [m] largest distance of the centre from the circle's plane


class TaskPath(Motion[TaskMotion]):
    """Base of the motions of the tool from rest to rest along a path, in a duration, or as fast as limits allow.

    A subclass states its `size` and `along(s)`, the path and its derivatives by s from 0 to 1.
    """

    T0: Part[Pose] = Part(Pose)
    duration: Field = Field(unit="s", above=0.0, optional=True, run_time=False)
    velocity: Field = Field(unit="m/s, rad/s", shape=2, accepts=("pair",), above=0.0, optional=True)
    acceleration: Field = Field(unit="m/s^2, rad/s^2", shape=2, accepts=("pair",), above=0.0, optional=True)
    scaling: Choice[ScalingKind] = Choice("quintic", "cubic", "trapezoidal")

    def check(self) -> None:
        self.__dict__["_timing"] = timing = self._timed(self.prepared())
        self.__dict__["duration"] = timing.duration

    @abstractmethod
    def prepared(self) -> Size:
        """Check and keep what follows from the fields; the size of the path."""

    @abstractmethod
    def along(self, s: Float64Array) -> Rows:
        """The path at s (k, 1): p, R, and its derivatives by s in world axes: way, bend, turn, each (k, 3)."""

    def _timed(self, size: Size) -> Timing:
        if self.duration is not None and self.velocity is self.acceleration is None:
            return Timing.lasting(self.scaling, self.duration, max(size.length, size.turn, size.bend))
        if self.duration is not None or self.velocity is None or self.acceleration is None:
            self.refuse("", "needs duration [s], or velocity and acceleration, each (linear, angular)")
        return Timing.fastest(self.scaling, size, self.velocity, self.acceleration)

    def rows(self, times: Float64Array) -> TaskMotion:
        s, rate, second = (x[:, np.newaxis] for x in self.__dict__["_timing"].at(times))
        path = self.along(s)
        by_s = np.hstack(np.broadcast_arrays(path["way"], path["turn"]))
        bend = np.hstack([path["bend"], np.zeros_like(path["bend"])])
        twist, acceleration = rate * by_s, second * by_s + rate**2 * bend
        return TaskMotion.of({"p": path["p"], "R": path["R"], "twist": twist, "acceleration": acceleration})


class Line(TaskPath):
    """A straight line of the tool's origin, while the orientation rotates about one axis (slerp).

    p = p_0 + s (p_1 - p_0) and R = R_0 exp(s log(R_0^T R_1)), with s(t) from 0 to 1.

    For a rotation by exactly pi the axis, in the axes of T0, is that of a positive x; where x is zero, of a positive
    y; else of a positive z. For the other direction go by a pose in between.

    Args:
        T0: First pose.
        T1: Last pose; it may be the first one.
        duration: [s], in place of the limits. Afterwards: how long it takes.
        velocity: (linear, angular) largest speeds [m/s, rad/s].
        acceleration: (linear, angular) largest accelerations [m/s^2, rad/s^2].
        scaling: "quintic", which is minimum jerk; "cubic", whose acceleration jumps at both ends; or "trapezoidal",
            the fastest under limits; of a duration alone, ramps and cruise take a third each.

    Raises:
        UsageError: No Pose, not a duration or both limits, another scaling.
        ShapeError, RangeError: Limits that are no pair or not above zero.

    Example:
        >>> line = Line(T0=Pose([0.4, 0.0, 0.3]), T1=Pose([0.4, 0.2, 0.3]), duration=2.0)
        >>> line.at(1.0).p.tolist(), line.at(1.0).twist[1].round(4).item()
        ([0.4, 0.1, 0.3], 0.1875)
    """

    T1: Part[Pose] = Part(Pose)

    def prepared(self) -> Size:
        self.__dict__["_turn"] = turn = _rotation_between(self.T0.R, self.T1.R)
        return Size(length=_norm(self.T1.p - self.T0.p), bend=0.0, turn=_norm(turn))

    def along(self, s: Float64Array) -> Rows:
        turn, R0 = self.__dict__["_turn"], self.T0.R
        way = np.broadcast_to(self.T1.p - self.T0.p, (len(s), 3))
        p, R = self.T0.p + s * way, R0 @ exp_rows(s * turn)
        return {"p": p, "R": R, "way": way, "bend": np.zeros_like(p), "turn": R0 @ turn}


class Circle(TaskPath):
    """A circle about an axis, or an arc of one, from where the tool is at the start.

    Args:
        T0: First pose; its origin is on the circle.
        centre: (3,) [m].
        axis: (3,) normal of the circle's plane, of any length; the tool goes about it by the right-hand rule.
        angle: [rad]; a whole turn by default, negative for the other direction, more for several turns.
        orientation: "keep" the first orientation, or "turn" with the circle.
        duration: [s], in place of the limits. Afterwards: how long it takes.
        velocity: (linear, angular) largest speeds [m/s, rad/s].
        acceleration: (linear, angular) largest accelerations, towards the centre included [m/s^2, rad/s^2].
        scaling: "quintic", "cubic" or "trapezoidal", as of `Line`.

    Raises:
        UsageError: No Pose, not a duration or both limits, another word.
        ShapeError, RangeError: A wrong number of entries; no axis, a centre that is T0 itself or off the plane.

    Example:
        >>> ring = Circle(T0=Pose([0.5, 0.0, 0.3]), centre=[0.4, 0.0, 0.3], axis=[0, 0, 1], duration=4.0)
        >>> ring.at(2.0).p.round(6).tolist(), round(ring.radius, 6)
        ([0.3, 0.0, 0.3], 0.1)
    """

    centre: Field = Field(unit="m", shape=3)
    axis: Field = Field(shape=3)
    angle: Field = Field(2.0 * np.pi, unit="rad", run_time=False)
    orientation: Choice[Literal["keep", "turn"]] = Choice("keep", "turn")

    def prepared(self) -> Size:
        angle, axis = self.angle, self.axis
        if abs(angle) >= DEGREES and abs(angle) % 5.0 == 0.0:
            rule = f"must be in radians; got {angle:g}; if it is in degrees, np.radians({angle:g}) converts it"
            self.refuse("angle", rule, RangeError)
        if not axis.any():
            self.refuse("axis", "must have a direction; got zeros", RangeError)
        axis = axis / np.abs(axis).max()
        axis = axis / _norm(axis)
        off = float(axis @ (self.T0.p - self.centre))
        if abs(off) > IN_PLANE:
            rule = f"must be in the plane through T0 that the axis is normal to; it is {abs(off):.3g} m off"
            self.refuse("centre", rule, RangeError)
        centre = self.centre + off * axis
        spoke = self.T0.p - centre
        if _norm(spoke) < IN_PLANE:
            rule = "is where the circle starts, so that it has no radius; give another point"
            self.refuse("centre", rule, RangeError)
        self.__dict__.update(centre=centre, axis=axis, _spoke=spoke)
        length = abs(angle) * _norm(spoke)
        return Size(length=length, bend=abs(angle) * length, turn=abs(angle) if self.orientation == "turn" else 0.0)

    @property
    def radius(self) -> float:
        """[m]."""
        return _norm(self.__dict__["_spoke"])

    def along(self, s: Float64Array) -> Rows:
        turn = self.angle * self.axis
        turned = exp_rows(s * turn)
        spoke = turned @ self.__dict__["_spoke"]
        way = np.cross(turn, spoke)
        path = {"p": self.centre + spoke, "way": way, "bend": np.cross(turn, way)}
        if self.orientation == "turn":
            return {**path, "R": turned @ self.T0.R, "turn": turn}
        return {**path, "R": np.broadcast_to(self.T0.R, turned.shape), "turn": np.zeros(3)}


class Steady(Motion[TaskMotion]):
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
        ShapeError, RangeError: A wrong number of entries; no velocity at all, a ramp that is not above zero.

    Example:
        >>> down = Steady(T0=Pose([0.4, 0.0, 0.3]), velocity=[0.0, 0.0, -0.02], ramp=0.1)
        >>> down.at(1.05).p.round(6).tolist(), down.at(1.05).twist[2].item()
        ([0.4, 0.0, 0.28], -0.02)
    """

    T0: Part[Pose] = Part(Pose)
    velocity: Field = Field((0.0, 0.0, 0.0), unit="m/s", shape=3)
    angular: Field = Field((0.0, 0.0, 0.0), unit="rad/s", shape=3)
    ramp: Field = Field(0.1, unit="s", above=0.0, run_time=False)

    def check(self) -> None:
        if not self.velocity.any() and not self.angular.any():
            self.refuse("velocity", "or angular must be above zero, or nothing moves; got zeros", RangeError)

    def rows(self, times: Float64Array) -> TaskMotion:
        u = np.clip(times / self.ramp, 0.0, 1.0)[:, np.newaxis]
        late = np.maximum(times - self.ramp, 0.0)[:, np.newaxis]
        way = self.ramp * u**3 * (1.0 - 0.5 * u) + late  # [s] at full speed
        speed, rate = u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u) / self.ramp
        V = np.concatenate([self.velocity, self.angular])
        p, R = self.T0.p + way * V[:3], exp_rows(way * V[3:]) @ self.T0.R
        return TaskMotion.of({"p": p, "R": R, "twist": speed * V, "acceleration": rate * V})


def _rotation_between(R0: Rotation, R1: Rotation) -> Vector3:
    """(3,) the rotation vector from R0 to R1, in the axes of R0 [rad]; by pi in the direction that `Line` states."""
    w = np.asarray(rotation_log(R0.T @ R1), dtype=np.float64)
    angle = _norm(w)
    if np.pi - angle < HALF_TURN_TOLERANCE:
        lead = next(x for x in w / angle if abs(x) > NO_COMPONENT)
        if lead < 0.0:
            return w * (1.0 - 2.0 * np.pi / angle)
    return w


def _norm(x: Float64Array) -> float:
    return float(np.linalg.norm(x))
