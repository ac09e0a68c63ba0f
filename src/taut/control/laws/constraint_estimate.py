"""Estimating the direction of a surface from force and motion: the first remedy of section 10.4.2 for a wrong one."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

from taut.base.errors import UsageError
from taut.base.types import Rotation, Vector3
from taut.control.command import Command
from taut.control.gains import Gain, GainValue, Memory
from taut.control.law import Law, MemoryView
from taut.control.trajectories.reference import Sample
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.rows import ConstraintRows
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotated
from taut.trace import math as tm

__all__ = ["NEVER", "NormalEstimate", "turn_between", "turned_rows"]

NEVER: Final = 1e-24  # keeps a root from zero, where it has no slope


class NormalEstimate(Law):
    """Where the surface of a hybrid law really faces, from force and motion: `HybridMotionForce(estimate=...)`.

    Law:          n_hat = (n_0 + tilt) / |n_0 + tilt|, with the stated normal n_0 and tilt at right angles to it
                  tilt-dot = rate w (seen - tilt)
                    seen = g / (n_0 . g) - n_0,  g = F_ext - (F_ext . s) s,  s = v / |v|
                    v is the velocity of the tool over the surface
                    w = 1 where the tool slides and presses, 0 below `speed` or `force` and beyond the angle `most`
    Closed loop:  tilt - tilt_true falls as exp(-rate integral(w dt)), whatever the arm does, for nothing of the
                    estimate is in `seen`. 15 degrees become 1 in 2.8 / rate of sliding, 0.34 s with rate = 8
                  The contact gives N n - mu N s with an unknown mu. A sliding tool moves in the surface, n . s = 0,
                    so g = N n: friction is in F_ext and not in g, and one direction of sliding shows both tilts, that
                    across it by the force, that along it by the motion alone
                  White noise of d_F and d_v in each tick leaves sqrt(rate dt / 2) (d_F / N, d_v / |v|) rad across and
                    along the motion; a constant force that is no contact's, such as a bias, leaves its share of N
                  n_hat turns by less than 2 rate tan(most) a second, and not at all where the tool rests or is free

    What is estimated is a rotation of the whole constraint about where the tool touches: rows of a face turn with it,
    and a curved surface bends as it is stated to. Where the true surface is elsewhere on a curve the tilt changes on
    the way, at a rate w_n, and the estimate is w_n / rate behind.

    Frames:
        World axes. Of a surface that moves, what moves along n_0 is counted: one that moves in its own plane drags by
        friction where nothing says so.

    Args:
        rate: Of the estimate.
        speed: Of sliding, below which nothing is believed; from twice that on everything is.
        force: Likewise, of pressing.
        most: Largest angle between the stated and the true normal; believed in full up to half its tangent.

    Example:
        >>> import taut
        >>> law = taut.laws.HybridMotionForce(
        ...     constraint=taut.Constraint.plane(point=[0, 0, 0.1], normal=[0, 0, 1]),
        ...     motion=taut.laws.TaskComputedTorque(kp=100.0, kd=20.0),
        ...     kfi=5.0,
        ...     estimate=NormalEstimate(rate=8.0),
        ... )

    References:
        Section 10.4.2 hybrid motion-force control, what to do about wrong constraints. Yoshikawa and Sudou (1993),
        IEEE Transactions on Robotics and Automation 9 (2), normals from force and motion.
    """

    ignores_reference = True
    rate: Gain = Gain(8.0, size=0)  # [1/s]
    speed: Gain = Gain(0.02, size=0, minimum=1e-6)  # [m/s]
    force: Gain = Gain(1.0, size=0, minimum=1e-6)  # [N]
    most: Gain = Gain(0.6, size=0, minimum=1e-3, maximum=1.2)  # [rad]
    tilt: Memory = Memory((0.0, 0.0, 0.0))  # [1] (3,) tangent of the angle, across the stated normal
    normal: Memory = Memory((0.0, 0.0, 0.0))  # [1] (3,) n_hat, world axes

    recorded = ("normal",)

    def command(
        self,
        x: Snapshot,  # noqa: ARG002
        ref: Sample,  # noqa: ARG002
        memory: MemoryView,  # noqa: ARG002
        dt: float,  # noqa: ARG002
    ) -> tuple[Command, dict[str, object]]:
        raise UsageError(
            "NormalEstimate gives no torque; a hybrid law holds it: taut.laws.HybridMotionForce(..., "
            "estimate=taut.laws.NormalEstimate())",
            name="NormalEstimate",
        )

    def updated(self, tilt: Vector3, n_0: Vector3, v: Vector3, F: Vector3, dt: Any) -> Vector3:
        """(3,) the tilt after a tick.

        Args:
            tilt: (3,) the last one.
            n_0: (3,) stated normal, away from the surface.
            v: (3,) of the tool's origin over the surface [m/s].
            F: (3,) of the environment on the tool [N].
            dt: [s].
        """
        flat = _across(n_0, v)
        speed = tm.sqrt(flat @ flat + NEVER)
        g = F - v * ((v @ F) / (v @ v + NEVER))
        N = n_0 @ g
        seen = _across(n_0, g) / tm.maximum(N, self.force[()])
        # A tool that comes or goes is among what is too steep: g . v = 0, so |seen| >= |n_0 . v| / speed.
        steep = _within(tm.sqrt(seen @ seen + NEVER), tm.tan(self.most[()]))
        w = _above(speed, self.speed) * _above(N, self.force) * steep
        old = _across(n_0, tilt)
        out: Vector3 = old + (1.0 - tm.exp(-self.rate[()] * w * dt)) * (seen - old)
        return out


def _across(n: Vector3, v: Vector3) -> Vector3:
    out: Vector3 = v - (n @ v) * n
    return out


def _above(value: Any, least: GainValue) -> Any:
    """0 below `least`, 1 from twice that on."""
    return tm.clip(value / least[()] - 1.0, 0.0, 1.0)


def _within(tangent: Any, steepest: Any) -> Any:
    """1 up to half of the steepest, 0 beyond it."""
    return tm.clip(2.0 - 2.0 * tangent / steepest, 0.0, 1.0)


def turn_between(n_0: Vector3, n: Vector3) -> Rotation:
    """(3, 3) the smallest rotation that takes one unit vector to another, less than a half turn away."""
    w = tm.cross(n_0, n)
    W = tm.skew(w)
    out: Rotation = tm.eye(3) + W + (W @ W) / (1.0 + n_0 @ n)
    return out


def turned_rows(constraint: Constraint, x: Snapshot, R: Rotation) -> ConstraintRows:
    """Rows of a constraint of one frame whose surface is turned by R about where the frame is."""
    assert constraint.frame is not None
    (frame,) = constraint.frame
    seen = constraint.at(x.turned(R, frame))
    assert seen.A is not None
    return dataclasses.replace(seen, A=tm.array([rotated(R, row) for row in seen.A]))
