"""Trajectories of joints: sine, point to point, spline."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np

from taut.base.checks import read_only
from taut.base.errors import NumericalError, ShapeError, missing_extra
from taut.base.fields import Field
from taut.base.types import Float64Array
from taut.control.trajectories.reference import JointMotion
from taut.control.trajectories.samples import Sampled, stated_times
from taut.control.trajectories.timing import MAX_OF_MOTION, Motion, ScalingKind, Timing

POSITION, SPEED, ACCELERATION, JERK = "rad | m", "rad/s | m/s", "rad/s^2 | m/s^2", "rad/s^3 | m/s^3"


class JointTrajectory(Motion[JointMotion]):
    """Base of trajectories whose fields have one number for each joint; one alone stands for all."""

    def check(self) -> None:
        names = [name for name, field in self.declared.items() if isinstance(field, Field) and field.shape == "n"]
        values = {name: np.asarray(getattr(self, name)) for name in names}
        shape = next((value.shape for value in values.values() if value.ndim), (1,))
        for name, value in values.items():
            if value.ndim and value.shape != shape:
                self.refuse(name, f"must have shape {shape}, like the others; got {value.shape}", ShapeError)
            self.__dict__[name] = read_only(np.broadcast_to(value, shape))


class Sine(JointTrajectory):
    """q(t) = center + amplitude sin(2 pi frequency t + phase), each joint on its own.

    Args:
        center: (n,) [rad | m].
        amplitude: (n,) or scalar [rad | m].
        frequency: (n,) or scalar [Hz].
        phase: (n,) or scalar [rad].

    Example:
        >>> Sine(center=[0.0], amplitude=1.0, frequency=0.25).at(1.0).q.tolist()
        [1.0]
    """

    center: Field = Field(unit=POSITION, shape="n")
    amplitude: Field = Field(unit=POSITION, shape="n")
    frequency: Field = Field(unit="Hz", shape="n")
    phase: Field = Field(0.0, unit="rad", shape="n")

    def rows(self, times: Float64Array) -> JointMotion:
        omega = 2.0 * np.pi * self.frequency
        angle = times[:, np.newaxis] * omega + self.phase
        sine = np.sin(angle)
        q = self.center + self.amplitude * sine
        v = self.amplitude * omega * np.cos(angle)
        a = -self.amplitude * omega**2 * sine
        return JointMotion.of({"q": q, "v": v, "a": a, "j": -(omega**2) * v, "s": -(omega**2) * a})


class Fourier(JointTrajectory):
    """q(t) = q0 + sum over l of cosines_l (cos(l w t) - 1) + sines_l sin(l w t), w = 2 pi frequency; periodic.

    `taut.analysis.excitation` designs one for an arm.

    Args:
        q0: (n,) where it starts, and ends after whole periods [rad | m].
        cosines: (h, n) amplitudes of the harmonics l = 1 ... h [rad | m].
        sines: (h, n) the same of the sines.
        frequency: Of the first harmonic [Hz].
        duration: [s]; it rests at its last position then.

    Example:
        >>> Fourier(q0=[1.0], cosines=[[0.0]], sines=[[0.5]], frequency=0.25, duration=4.0).at(1.0).q.tolist()
        [1.5]

    References:
        Swevers, Ganseman, Tukel, De Schutter and Van Brussel, IEEE Trans. Robotics and Automation 13 (1997).
    """

    q0: Field = Field(unit=POSITION, shape="n")
    cosines: Field = Field(unit=POSITION, shape=("k", "n"))
    sines: Field = Field(unit=POSITION, shape=("k", "n"))
    frequency: Field = Field(unit="Hz", shape="scalar", above=0.0)
    duration: Field = Field(unit="s", shape="scalar", above=0.0)

    def check(self) -> None:
        super().check()
        for name in ("cosines", "sines"):
            if (got := getattr(self, name).shape) != (wanted := (len(self.cosines), len(self.q0))):
                self.refuse(name, f"must have shape {wanted}, a row for each harmonic; got {got}", ShapeError)

    def rows(self, times: Float64Array) -> JointMotion:
        t = np.clip(times, 0.0, float(self.duration))
        inside = (t == times)[:, np.newaxis]
        omega = 2.0 * np.pi * float(self.frequency) * np.arange(1, len(self.cosines) + 1)
        c, s = np.cos(np.outer(t, omega)), np.sin(np.outer(t, omega))
        q = self.q0 + (c - 1.0) @ self.cosines + s @ self.sines
        v = (c * omega) @ self.sines - (s * omega) @ self.cosines
        a = -(c * omega**2) @ self.cosines - (s * omega**2) @ self.sines
        return JointMotion.of({"q": q, "v": v * inside, "a": a * inside})


class PointToPoint(JointTrajectory):
    """Base of the motions from rest to rest in which all joints start and stop together: q0 + s (q1 - q0)."""

    q0: Field = Field(unit=POSITION, shape="n")
    q1: Field = Field(unit=POSITION, shape="n")

    def check(self) -> None:
        super().check()
        self.__dict__["_timing"] = self.timing(np.abs(self.q1 - self.q0))

    @abstractmethod
    def timing(self, distance: Float64Array) -> Timing:
        """The timing of s, from how far each joint goes [rad | m]."""

    def rows(self, times: Float64Array) -> JointMotion:
        timing: Timing = self.__dict__["_timing"]
        scaling = [*timing.at(times), *timing.jerk_and_snap(times)]
        distance = self.q1 - self.q0
        rows = {name: distance * s[:, np.newaxis] for name, s in zip("qvajs", scaling, strict=False)}
        return JointMotion.of({**rows, "q": self.q0 + rows["q"]})


class InTime(PointToPoint):
    """Base of the polynomials of a given duration."""

    scaling: ClassVar[ScalingKind]
    duration: Field = Field(unit="s", above=0.0, run_time=False)

    def timing(self, distance: Float64Array) -> Timing:
        return Timing.lasting(self.scaling, float(self.duration), float(distance.max()))


class Cubic(InTime):
    """From rest at q0 to rest at q1 in `duration` seconds, s = 3 x^2 - 2 x^3; the acceleration jumps at both ends.

    Args:
        q0: (n,) [rad | m].
        q1: (n,) [rad | m].
        duration: [s].
    """

    scaling: ClassVar[ScalingKind] = "cubic"


class Quintic(InTime):
    """From rest at q0 to rest at q1 in `duration` seconds, s = 10 x^3 - 15 x^4 + 6 x^5: minimum jerk.

    Args:
        q0: (n,) [rad | m].
        q1: (n,) [rad | m].
        duration: [s].

    Example:
        >>> Quintic(q0=[0.0], q1=[2.0], duration=1.0).at(0.5).q.tolist()
        [1.0]
    """

    scaling: ClassVar[ScalingKind] = "quintic"


class Septic(InTime):
    """From rest at q0 to rest at q1 in `duration` seconds, s = 35 x^4 - 84 x^5 + 70 x^6 - 20 x^7: minimum snap.

    Its jerk is continuous and its snap finite: what laws of flexible joints need, `taut.laws.MotorSidePD` for one.

    Args:
        q0: (n,) [rad | m].
        q1: (n,) [rad | m].
        duration: [s].

    Example:
        >>> Septic(q0=[0.0], q1=[2.0], duration=1.0).at(0.5).s.tolist()
        [0.0]
    """

    scaling: ClassVar[ScalingKind] = "septic"


class Trapezoidal(PointToPoint):
    """From rest to rest with bounded speed and acceleration; all joints start and stop together.

    The slowest joint runs at its limits, the others are scaled to it. `duration` is the time that it takes [s].

    Args:
        q0: (n,) [rad | m].
        q1: (n,) [rad | m].
        velocity: (n,) or scalar, largest speed [rad/s | m/s].
        acceleration: (n,) or scalar, largest acceleration [rad/s^2 | m/s^2].
    """

    velocity: Field = Field(unit=SPEED, shape="n", above=0.0)
    acceleration: Field = Field(unit=ACCELERATION, shape="n", above=0.0)

    def timing(self, distance: Float64Array) -> Timing:
        with np.errstate(divide="ignore", over="ignore"):
            rate, second = (float(np.min(limit / distance)) for limit in (self.velocity, self.acceleration))
        return Timing.trapezoid(rate, second, float(distance.max()))

    @property
    def duration(self) -> float:
        """Time from start to stop [s]."""
        return float(self.__dict__["_timing"].duration)


class JerkLimited(JointTrajectory):
    """From rest to rest, time-optimal under limits of speed, acceleration and jerk (Ruckig).

    Args:
        q0: (n,) [rad | m].
        q1: (n,) [rad | m].
        velocity: (n,) or scalar [rad/s | m/s].
        acceleration: (n,) or scalar [rad/s^2 | m/s^2].
        jerk: (n,) or scalar [rad/s^3 | m/s^3].

    Raises:
        MissingExtraError: Ruckig is not installed.

    References:
        Berscheid and Kroeger, Jerk-limited real-time trajectory generation, RSS 2021.
    """

    q0: Field = Field(unit=POSITION, shape="n")
    q1: Field = Field(unit=POSITION, shape="n")
    velocity: Field = Field(unit=SPEED, shape="n", above=0.0)
    acceleration: Field = Field(unit=ACCELERATION, shape="n", above=0.0)
    jerk: Field = Field(unit=JERK, shape="n", above=0.0)

    def check(self) -> None:
        super().check()
        try:
            import ruckig
        except ImportError as cause:
            raise missing_extra("a jerk-limited trajectory", "ruckig", "ruckig") from cause
        n = len(self.q0)
        task, plan = ruckig.InputParameter(n), ruckig.Trajectory(n)
        task.current_position, task.target_position = self.q0.tolist(), self.q1.tolist()
        task.max_velocity, task.max_acceleration = self.velocity.tolist(), self.acceleration.tolist()
        task.max_jerk = self.jerk.tolist()
        try:
            planned = ruckig.Ruckig(n).calculate(task, plan) in (ruckig.Result.Working, ruckig.Result.Finished)
        except ruckig.RuckigError:  # numbers that it cannot work with, such as limits of 1e-300
            planned = False
        if not planned:
            raise NumericalError(
                "Ruckig found no jerk-limited trajectory; relax the limits, in rad or m and seconds",
                name="JerkLimited",
            )
        self.__dict__["_plan"] = plan

    @property
    def duration(self) -> float:
        """Time from start to stop [s]."""
        return float(self.__dict__["_plan"].duration)

    def rows(self, times: Float64Array) -> JointMotion:
        end, plan = self.duration, self.__dict__["_plan"]
        rows = [plan.at_time(float(t))[:3] for t in np.clip(times, 0.0, end)]
        q, v, a = (np.array([row[k] for row in rows]) for k in range(3))
        a[(times < 0.0) | (times > end)] = 0.0
        return JointMotion.of({"q": q, "v": v, "a": a})


class Spline(Sampled[JointMotion]):
    """A cubic spline through points, at rest at both ends; position, velocity and acceleration are continuous.

    Args:
        times: (k,) [s], increasing, k >= 2.
        points: (k, n) joint positions [rad | m].
    """

    times: Field = stated_times()
    points: Field = Field(unit=POSITION, shape=("k", "n"), minimum=-MAX_OF_MOTION, maximum=MAX_OF_MOTION)

    def check(self) -> None:
        from scipy.interpolate import CubicSpline

        if len(self.points) != len(self.times) or len(self.times) < 2:
            rule = f"must have a row for each time, and two at least; got {len(self.points)} for {len(self.times)}"
            self.refuse("points", f"{rule} times", ShapeError)
        self.__dict__["_spline"] = CubicSpline(self.times, self.points, bc_type="clamped")

    def rows(self, times: Float64Array) -> JointMotion:
        t = np.clip(times, self.times[0], self.times[-1])
        spline: Any = self.__dict__["_spline"]
        inside = (t == times)[:, np.newaxis]
        return JointMotion.of({"q": spline(t), "v": spline(t, 1) * inside, "a": spline(t, 2) * inside})
