"""via_joint_space: a law of joint motion that follows the motion of the tool (section 10.2.3, the first option)."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from taut.base.fields import Choice, Field
from taut.base.types import Array, ArrayLike, Matrix, Vector
from taut.control.closed_loop import ClosedLoop
from taut.control.command import Command
from taut.control.gains import Gain, Memory, MemoryView
from taut.control.law import Law, call
from taut.control.trajectories.reference import JointMotion, Sample
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths import dynamics as dyn
from taut.maths.ik import (
    DIRECTIONS,
    TINY,
    Directions,
    IkOutcome,
    Resolved,
    Task,
    damping_near_singularity,
    shortened,
    task_of,
)
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm
from taut.trace.graph import LARGEST

PULL: Final = 1.0  # [1/s] rate at which redundant joints go to their posture
DAMPING: Final = 0.1  # [-] of J J^T at a singularity, as the singular value that it is the square of
RISE: Final = 0.1  # [s] in which the speed of joints that catch up is reached from rest
ARRIVED: Final = 1e-5  # [m, rad] an error under which the tool's target is met
MOVING: Final = 1e-3  # fraction of full speed above which joints catch up
MIN_DIVISOR: Final = 1e-30  # keeps a quotient finite


class ViaJointSpace(Law):
    """Task-space motion by inverse kinematics: holds a law of joint motion and gives it the joints' motion.

    Law:          q_des = f^-1(T_des), by a damped Newton step from the last solution             eq. 10.28
                  v_des = J^-1 V_des                                                              eq. 10.29
                  a_des = J^-1 (V_des-dot - J-dot v_des)                                          eq. 10.30
                  then that of the law it holds, at this q_des, v_des, a_des
    Closed loop:  that of the law it holds, around these: e_ddot + kd e_dot + kp e = 0 of ComputedTorque
                  the tool's error is J e to first order, so its directions are coupled by J
                  the error of q_des is c |q_pred - q*|^2, c about 1 [1/rad], with q_pred the last solution
                    extrapolated by v_des and a_des, whose error is dt^3/6 times the joints' jerk

    J^-1 is the inverse, for redundant joints the pseudo-inverse, with too few least squares (a radian counts as much
    as a third of the reach). Redundant joints go to `posture`, where they started if it is left out, at 1/s: closed
    paths of the tool then end as closed paths of the joints.

    A joint approaches its limit no faster than the remaining distance over 0.1 s; the others make up for it as well
    as they can. Near a singularity J J^T is damped, by at most 0.1^2 (dimensionless), not at all beyond twice that;
    v_des as a whole never exceeds the arm's own speed limits.

    A target that jumps, or starts elsewhere, is approached at no more than `speed`, reached from rest in 0.1 s, with
    v_des in agreement; one that moves without a twist is followed with a lag, an unreachable one as far as possible.
    A run's `run.extra["law.ik_error"]` (k, 2) is the remaining error [m, rad], `run.extra["law.ik_outcome"]` the
    `taut.dynamics.IkOutcome.of(...)` of each tick; after a step `ctrl.memory` has both.

    Args:
        inner: A law of joint motion, or a sum of them.
        tool: The frame that is to follow; the arm's tool if left out.
        directions: "all" six; "position"; "pointing", for tools that may spin: position, and where z points.
        posture: (n,) where redundant joints go; where they started if left out.
        speed: Of joints that catch up with a target which jumped.

    References:
        Section 10.2.3 task space motion control, equations 10.28 to 10.30.
        Nakamura and Hanafusa, J. Dynamic Systems, Measurement and Control 108 (1986).
    """

    reference: ClassVar[type[Sample]] = TaskMotion
    inner: Law
    tool: str | None = None
    directions: Choice[Directions] = Choice(*DIRECTIONS)
    posture: Field = Field(unit="rad | m", shape="n", optional=True, run_time=False)
    speed: Gain = Gain(1.0, unit="rad/s | m/s", accepts=("scalar",), above=0.0)
    q_des = Memory(unit="rad | m", record=True)
    ik_error = Memory((0.0, 0.0), unit="m, rad", record=True)
    ik_outcome = Memory(record=True, doc="how the tick ended, IkOutcome.of(...)")

    def check(self) -> None:
        if self.inner.reference is not JointMotion:
            follows = f"{type(self.inner).__name__} follows a {self.inner.reference.__name__}"
            self.refuse("inner", f"must be a law of joint motion, such as ComputedTorque; {follows}")

    def seen_by(self, child: str, x: Snapshot, ref: Any) -> tuple[Snapshot, Any]:  # noqa: ARG002
        """The law that it holds begins with a rest where the arm is."""
        return x, JointMotion.at_rest(x, None)

    def start(self, x: Snapshot, ref: TaskMotion) -> dict[str, Any]:  # noqa: ARG002
        zero = np.zeros(x.n)
        return {
            "q_des": x.q,
            "v_des": zero,
            "a_des": zero,
            "v_asked": zero,
            "held": zero,
            "pace": 0.0,
            "posture": x.q if self.posture is None else self.posture * np.ones(x.n),
            "ik_error": np.zeros(2),
            "ik_outcome": IkOutcome.SOLVED.code,
        }

    def closed_loop(self, x: Snapshot) -> ClosedLoop | None:
        """That of the law of joints that it holds."""
        inner = self.inner.closed_loop(x)
        return inner and inner.held_by(lambda law, _: replace(self, inner=law), alone=inner.alone or self.inner)

    def command(self, x: Snapshot, ref: TaskMotion, memory: MemoryView, dt: Any) -> tuple[Command, dict[str, Any]]:
        motion, own = self._joint_motion(x, ref, memory, dt)
        command, after = call(self.inner, x, motion, memory["inner"], dt)
        return command, {**own, "inner": after}

    def _joint_motion(
        self, x: Snapshot, ref: TaskMotion, memory: MemoryView, dt: Any
    ) -> tuple[JointMotion, dict[str, Any]]:
        """What the inner law is to follow, and what is remembered."""
        arm, task = x.arm, task_of(x.arm, self.tool, self.directions)
        q, held = memory.q_des, memory.held
        # Towards a limit no faster than the way that is left over the rise; from beyond one only back.
        slowest, fastest = (tm.minimum(arm.lower, q) - q) / RISE, (tm.maximum(arm.upper, q) - q) / RISE
        free = 1.0 - tm.abs(held)
        up, down = (tm.where(np.isfinite(x), s, 0.0) for x, s in ((arm.upper, fastest), (arm.lower, slowest)))
        forced = tm.where(held > 0.0, up, tm.where(held < 0.0, down, 0.0))  # joints without limits are never held
        onward = dt * shortened(memory.v_des + 0.5 * dt * memory.a_des, arm.velocity)
        q_pred = q + tm.clip(onward, dt * slowest, dt * fastest)
        seen = self._seen(x, q_pred, ref, task, free)
        ahead = seen.step
        share, pace = self._paced(ahead, memory.pace, arm.velocity, dt)
        moved = shortened(q_pred - q + share * ahead, arm.velocity * dt)
        q_new = q + tm.clip(moved, dt * slowest, dt * fastest)

        speeds, rates, wish, slowed = self._rates(x, q_pred, ref, task, seen, free, forced, memory.posture)
        pushed = wish + seen.J.T @ seen.solved.multipliers(seen.e) / dt  # where a held joint would go
        wish = tm.where(free > 0.5, speeds + share * ahead / dt, pushed)
        held = tm.where(wish > fastest, 1.0, tm.where(wish < slowest, -1.0, 0.0))
        v = tm.clip(speeds, slowest, fastest)
        a = tm.where(held > 0.0, -fastest / RISE, tm.where(held < 0.0, -slowest / RISE, rates))

        left = tm.array(task.left(seen.T, ref.pose, dyn.jacobian(x.model, q_pred, self.tool) @ (q_new - q_pred)))
        new = {
            "q_des": q_new,
            "v_des": v,
            "a_des": a,
            "held": held,
            "pace": pace,
            "posture": memory.posture,
            "ik_error": left,
            "ik_outcome": _outcome(left, held, seen.damping, (q_new - q) / (dt * self.speed.as_array()), task),
        }
        # Where joints catch up, or may not go as fast as they should, the rate of what is asked is what it is.
        asked = shortened(v + (q_new - q_pred) / dt, arm.velocity)
        limited = tm.where(share < 1.0, 1.0, tm.where(slowed < 1.0, 1.0, 0.0))
        seen_rate = shortened((asked - memory.v_asked) / dt, arm.velocity / RISE)
        new["v_asked"] = asked
        return JointMotion.of({"q": q_new, "v": asked, "a": tm.where(limited > 0.5, seen_rate, a)}), new

    def _seen(self, x: Snapshot, q: Vector, ref: TaskMotion, task: Task, free: Vector) -> _Seen:
        """One Newton step from q, and what it was made of."""
        T = dyn.pose(x.model, q, self.tool)
        J, e = task.seen(T, dyn.jacobian(x.model, q, self.tool)), task.error(T, ref.pose)
        damping = damping_near_singularity(J, free, DAMPING)
        solved = Resolved(J, free, damping + tm.norm(e) + TINY)
        return _Seen(T=T, J=J, e=e, damping=damping, solved=solved, step=solved(e))

    def _paced(self, ahead: Vector, pace: Any, velocity: Vector, dt: Any) -> tuple[Any, Any]:
        """Fractions of the way and of full speed in this tick, on a straight way with ramps of the time RISE."""
        time = tm.maximum(
            MIN_DIVISOR, functools.reduce(tm.maximum, tm.abs(ahead) / tm.minimum(self.speed.as_array(), velocity))
        )
        fastest = tm.minimum(tm.minimum(1.0, pace + dt / RISE), tm.sqrt(2.0 * time / RISE))
        share = tm.minimum(1.0, fastest * dt / time)
        return share, share * time / dt

    def _rates(
        self,
        x: Snapshot,
        q: Vector,
        ref: TaskMotion,
        task: Task,
        seen: _Seen,
        free: Vector,
        forced: Vector,
        posture: Array,
    ) -> tuple[Vector, Vector, Vector, Any]:
        """Equations 10.29 and 10.30 for the free joints; the others move as they must.

        Velocities and accelerations of the joints, velocities where held joints would go, each (n,); the fraction of
        the speed that equation 10.29 asks for.
        """
        arm, T, J = x.arm, seen.T, seen.J
        solve = Resolved(J, free, seen.damping + TINY)
        b = task.seen(T, ref.twist) - J @ forced
        redundant = task.size < x.n
        towards = PULL * arm.difference(posture, q)
        null = free * shortened(towards, tm.minimum(self.speed.as_array(), arm.velocity)) if redundant else None
        fast = solve(b, null) + forced
        push = J.T @ solve.multipliers(b, null)
        wish = push + (towards if redundant else forced)
        worst = functools.reduce(tm.maximum, tm.abs(fast) / arm.velocity)
        slowed = 1.0 / tm.maximum(1.0, worst)
        v = slowed * fast
        J_W = dyn.jacobian(x.model, q, self.tool)
        # No number in the random states of a compile's check, where a joint without a speed limit may be held.
        onward = tm.where(tm.abs(v) <= LARGEST, v, 0.0)
        J_W_rate = tm.jacobian(lambda s: dyn.jacobian(x.model, q + s[0] * onward, self.tool), [0.0])[..., 0]
        J_rate = task.seen_rate(T, J_W[3:] @ v, J_W, J_W_rate)
        wanted = task.seen_rate(T, J_W[3:] @ v, slowed * ref.twist, slowed * slowed * ref.acceleration)
        if redundant:
            null = free * (J_rate.T @ (slowed * solve.multipliers(b, null)) - PULL * v)
        a = solve(wanted - J_rate @ v + J @ (forced / RISE), null)
        return v, shortened(a, arm.velocity / RISE), wish, slowed


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """The tool's error at some joint positions, and a damped Newton step from there."""

    T: Any
    J: Matrix  # rows of the task, without dimension
    e: Array
    damping: Any  # near a singularity
    solved: Resolved
    step: Vector  # (n,)


def _outcome(left: Array, held: Vector, damping: Any, motion: Vector, task: Task) -> Any:
    """The code of how a tick ended."""
    rest = IkOutcome.FEWER_JOINTS if task.rank < task.asked else IkOutcome.STALLED
    code = tm.where(damping > 0.0, IkOutcome.SINGULAR.code, rest.code)
    code = tm.where(np.sum(tm.abs(held)) > 0.5, IkOutcome.AT_LIMIT.code, code)
    code = tm.where(tm.norm(motion) > MOVING, IkOutcome.CATCHING_UP.code, code)
    return tm.where(tm.maximum(left[0], left[1]) < ARRIVED, IkOutcome.SOLVED.code, code)


def via_joint_space(
    law: Law,
    *,
    tool: str | None = None,
    directions: Directions = "all",
    posture: ArrayLike | None = None,
    speed: ArrayLike = 1.0,
) -> ViaJointSpace:
    """A law that follows the motion of the tool, of one that follows the motion of the joints: see `ViaJointSpace`.

    Raises:
        UsageError: Not a law of joint motion; unknown directions.
        RangeError, ShapeError: Numbers out of range, or of another shape.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar3")
        >>> law = taut.via_joint_space(taut.laws.ComputedTorque(kp=100.0, kd=20.0))
        >>> ctrl = taut.compile(law, arm)
        >>> goal = taut.TaskMotion(pose=taut.snapshot(arm, arm.home + 0.2).T())
        >>> run = taut.run(ctrl, taut.RigidPlant(arm), goal, duration=2.0)
        >>> bool(np.abs(run.q[-1] - arm.home - 0.2).max() < 1e-3)
        True
    """
    return ViaJointSpace(inner=law, tool=tool, directions=directions, posture=posture, speed=speed)
