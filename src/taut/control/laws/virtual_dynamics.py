"""The virtual mass, spring and damper of admittance control, about a reference pose: equation 10.48 once and for all.

Everything here is in the axes of one frame and about relative motion: X from the reference to the tool, (p - p_ref,
log(R R_ref^T)), and U the velocity that belongs to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.types import Matrix, Rotation, Twist, Vector3, Wrench
from taut.control.gains import GainValue
from taut.control.laws.compliance import GainFrame, modal_damping
from taut.control.laws.spring import Bound, pulled
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.spatial import left_jacobian_inverse, rotated, rotation_exp, rotation_log
from taut.trace import math as tm

__all__ = ["Body", "Model", "answered", "damping_matrix", "integrated", "moved"]


ROUNDING: Final = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Where the virtual mass is and how it moves; in world axes."""

    p: Vector3
    R: Rotation
    twist: Twist

    def offset(self, ref: TaskMotion) -> Twist:
        """(6,) X, from the reference to here [m, rad]."""
        return tm.array([*(self.p - ref.p), *rotation_log(self.R @ ref.R.T)])

    def velocity(self, ref: TaskMotion) -> Twist:
        """(6,) U, less that of the reference, which is carried along with the rotation from it [m/s, rad/s]."""
        return self.twist - self.carried(ref, ref.twist)

    def carried(self, ref: TaskMotion, rate: Twist) -> Twist:
        """A twist of the reference as the tool would have it if it were fixed to the reference at its offset."""
        return tm.array([*rate[:3], *(self.R @ (ref.R.T @ rate[3:]))])

    def acceleration(self, ref: TaskMotion, relative: Twist) -> Twist:
        """(6,) of the tool, from the rate of U."""
        turning = self.carried(ref, ref.twist)[3:]
        bent = tm.cross(self.velocity(ref)[3:], turning)
        return relative + self.carried(ref, ref.acceleration) + tm.array([0.0, 0.0, 0.0, *bent])


def moved(body: Body, ref: TaskMotion, mean: Twist, after: Twist, dt: Any) -> Body:
    """The body after a tick, from the mean of U over it and U at its end, beside a reference that moves on.

    One Newton step keeps the rotation a rotation: what rounding adds in a tick is squared away in the next.
    """
    turn = rotation_exp(dt * mean[3:])
    step = ref.twist + 0.5 * dt * ref.acceleration
    carried = rotation_exp(dt * body.carried(ref, step)[3:])
    R = turn @ carried @ body.R
    R = 1.5 * R - 0.5 * (R @ (R.T @ R))
    end = ref.twist + dt * ref.acceleration
    turned = turn @ body.carried(ref, end)[3:]
    twist = after + tm.array([*end[:3], *turned])
    return Body(p=body.p + dt * (mean[:3] + step[:3]), R=R, twist=twist)


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """D U-dot + B U + K X = F, in the axes that D, B and K have.

    The spring pulls down the gradient of X . K X / 2, A^T K X with X-dot = A U; with one stiffness for all directions
    of a rotation, and axes that do not turn, that is K X itself.
    """

    D: Matrix  # (6, 6) [kg, kg m^2]
    B: Matrix  # (6, 6) [N s/m, N m s/rad]
    K: Matrix  # (6, 6) [N/m, N m/rad]
    bound: Bound | None = None  # of the spring
    turning: bool = False  # whether the axes are those of the tool, and turn with it

    def _rates(self, X: Twist) -> Matrix:
        """(6, 6) rate of X per U: the rotation vector's, and that of axes that turn under it."""
        A = tm.eye(6)
        inverse = left_jacobian_inverse(X[3:])
        A[3:, 3:] = inverse.T if self.turning else inverse
        if self.turning:
            A[:3, 3:] = tm.skew(X[:3])
        return A

    def pull(self, X: Twist) -> Wrench:
        """(6,) of the spring on the body [N, N m]."""
        force = self.K @ X if self.bound is None else self.bound.force(self.K, X)
        return pulled(-X, -force, turning=self.turning)

    def rate(self, X: Twist, U: Twist, F: Wrench) -> Twist:
        """(6,) U-dot = D^-1 (F - B U - K X), equation 10.50."""
        solved: Twist = tm.solve_spd(self.D, F - self.B @ U + self.pull(X))
        return solved

    def energy(self, X: Twist, U: Twist) -> Any:
        """[J] in the mass and the spring."""
        X = X if self.bound is None else self.bound.stretch(X)
        return 0.5 * (U @ (self.D @ U) + X @ (self.K @ X))

    def step(self, X: Twist, U: Twist, F: Wrench, dt: Any) -> Twist:
        """(6,) the mean of U over a tick, by the implicit midpoint rule; U after it is 2 mean - U.

        D (U+ - U) / dt = F - B mean - grad(X + mean dt / 2): of the linear part the energy changes by exactly
        dt (F . mean - mean . B mean), and of a rotation with one stiffness for all axes by no more, for half the
        squared angle curves less than it does in the plane.
        """
        A = self._rates(X)
        S = (2.0 / dt) * self.D + self.B + (0.5 * dt) * (A.T @ self.K @ A)
        mean: Twist = tm.solve_spd(S, (2.0 / dt) * (self.D @ U) + F + self.pull(X))
        return mean

    def share(self, allowed: Any, X: Twist, U: Twist) -> Any:
        """What of U leaves no more energy than is allowed [J]; below zero where the spring alone has more."""
        spring = self.energy(X, tm.zeros(6))
        kinetic = self.energy(X, U) - spring
        moves = kinetic > 0.0
        share = tm.sqrt(tm.clip((allowed - spring) / tm.where(moves, kinetic, 1.0), 0.0, 1.0))
        return tm.where(spring > allowed * (1.0 + ROUNDING), -1.0, tm.where(moves, share, 1.0))


def damping_matrix(D: GainValue, K: GainValue, zeta: GainValue) -> Matrix:
    """(6, 6) the damping that gives every mode of (D, K) the ratio zeta; of diagonal ones 2 zeta sqrt(D K)."""
    z: Any = zeta.as_array()
    if D.ndim < 2 and K.ndim < 2:
        diagonal: Matrix = np.eye(6) * (2.0 * z * tm.sqrt(D.as_array() * K.as_array()))
        return diagonal
    factors, stiffness = tm.factor_spd(D.matrix(6)), K.matrix(6)
    return tm.stack([modal_damping(factors, stiffness, z, axis) for axis in np.eye(6)])


def _axes(frame: GainFrame, body: Body, ref: TaskMotion) -> Rotation | None:
    """R_WC of the axes of the gains; None stands for the world's."""
    return {"world": None, "task": ref.R, "tool": body.R}[frame]


def _in_axes(R: Rotation | None, six: Any) -> Any:
    return six if R is None else rotated(R.T, six)


def _to_world(R: Rotation | None, six: Any) -> Any:
    return six if R is None else rotated(R, six)


def answered(model: Model, frame: GainFrame, body: Body, ref: TaskMotion, F: Wrench) -> Twist:
    """(6,) the acceleration of a body that the model would give it, world axes: equation 10.50."""
    R = _axes(frame, body, ref)
    X, U = _in_axes(R, body.offset(ref)), _in_axes(R, body.velocity(ref))
    return body.acceleration(ref, _to_world(R, model.rate(X, U, _in_axes(R, F))))


def integrated(model: Model, frame: GainFrame, body: Body, ref: TaskMotion, F: Wrench, dt: Any) -> tuple[Twist, Body]:
    """(6,) mean acceleration over a tick, world axes, and the body after it.

    Where D or K differ between directions that turn, the midpoint rule is off by the third order of dt. What would be
    energy out of nothing is taken from the velocity; if that is not enough, as it may be where a tick is longer than
    the swing, the body stays where it is.

    Args:
        model: Mass, damper and spring.
        frame: The axes of its numbers.
        body: Where it is.
        ref: What it is tied to, which goes on as it moves now.
        F: (6,) on the body, world axes [N, N m].
        dt: Length of the tick [s].
    """
    R = _axes(frame, body, ref)
    X, U, F = (_in_axes(R, six) for six in (body.offset(ref), body.velocity(ref), F))
    mean = model.step(X, U, F, dt)
    allowed = model.energy(X, U) + dt * (F @ mean - mean @ (model.B @ mean))
    new = moved(body, ref, _to_world(R, mean), _to_world(R, 2.0 * mean - U), dt)
    beside = _later(ref, dt)
    R = _axes(frame, new, beside)
    share = model.share(allowed, _in_axes(R, new.offset(beside)), _in_axes(R, new.velocity(beside)))
    still = moved(body, ref, np.zeros(6), np.zeros(6), dt)
    stays = share < 0.0
    carried = new.carried(beside, beside.twist)
    twist = tm.where(stays, still.twist, carried + share * (new.twist - carried))
    p, turned = tm.where(stays, still.p, new.p), tm.where(stays, still.R, new.R)
    return (twist - body.twist) / dt, Body(p=p, R=turned, twist=twist)


def _later(ref: TaskMotion, dt: Any) -> TaskMotion:
    """A reference that goes on as it does, a tick later."""
    mean = ref.twist + 0.5 * dt * ref.acceleration
    return TaskMotion.of(
        {
            "p": ref.p + dt * mean[:3],
            "R": rotation_exp(dt * mean[3:]) @ ref.R,
            "twist": ref.twist + dt * ref.acceleration,
            "acceleration": ref.acceleration,
        }
    )
