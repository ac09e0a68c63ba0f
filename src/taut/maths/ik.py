"""Inverse kinematics: the error of a pose, its rows of J, and steps of a damped search; for floats and symbols.

Rows are dimensionless: metres are divided by a length of the arm, so that they compare with radians. A mask `free` of
ones and zeros leaves out joints.

References:
    Section 10.2.3, equations 10.28 to 10.30. Nakamura and Hanafusa, J. Dynamic Systems, Measurement and Control 108
    (1986): damping near singularities. Nocedal and Wright, Numerical Optimization (2006), section 10.3:
    Levenberg-Marquardt.
"""

from __future__ import annotations

import enum
import functools
import math
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from taut.arm.description import Arm
from taut.arm.reach import reach
from taut.base.types import Array, Float64Array, Matrix, Vector
from taut.maths import dynamics as dyn
from taut.maths.model import Model, model_of
from taut.maths.spatial import rotation_log
from taut.trace import math as tm
from taut.trace.linalg import LTDL
from taut.trace.pose import Pose

Directions = Literal["all", "pointing", "position"]
SIZES: Final[dict[Directions, int]] = {"all": 6, "pointing": 5, "position": 3}
DIRECTIONS: Final = tuple(SIZES)
TINY: Final = 1e-12
LENGTH_OF_REACH: Final = 1.0 / 3.0  # one radian counts as much as a third of the reach
MAX_SEARCH_STEP: Final = 1.0  # [rad | m]
MAX_POSTURE_STEP: Final = 0.2  # [rad | m] along the free motion, where the task is followed to first order
POSTURE_DAMPING: Final = 1e-6  # for a chain with fewer directions than rows; too little to matter to others


class IkOutcome(enum.Enum):
    """How a search for joint positions ended."""

    SOLVED = "the tool is at the target"
    AT_LIMIT = "a joint is at its limit, and the others cannot make up for it"
    SINGULAR = "the arm is singular or stretched out, and what is left of the error lies where its joints do not lead"
    CATCHING_UP = "the target is further away than the joints may go in a tick; they are on their way"
    OUT_OF_REACH = "no start that was tried leads to the target; this is as near as the arm got"
    FEWER_JOINTS = (
        "the joints move the tool in fewer directions than were asked for; what is left of the error is least"
    )
    STALLED = "the error still fell when the steps were used up"

    @property
    def code(self) -> float:
        """The outcome as a number, which a memory can keep."""
        return float(list(IkOutcome).index(self))

    @classmethod
    def of(cls, code: float) -> IkOutcome:
        return list(cls)[round(float(code))]


@dataclass(frozen=True, kw_only=True)
class Task:
    """Frame and directions of a target: "all" is position and rotation vector in world axes.

    "position" is the first three, "pointing" the position and the two rotations about the frame's own x and y that
    align its z axis.
    """

    frame: str | None
    directions: Directions
    rows: tuple[int, ...]  # of the directions, those in which any joint moves the frame
    rank: int  # in how many directions joints move it, away from singularities
    length: float  # [m] that counts as much as a radian

    @property
    def asked(self) -> int:
        return SIZES[self.directions]

    @property
    def size(self) -> int:
        return len(self.rows)

    def seen(self, T: Pose, six: Array) -> Array:
        """The rows of a twist (6,) or of J (6, n), given in world axes."""
        linear = six[:3] / self.length
        if self.directions == "position":
            return tm.stack([linear[i] for i in self.rows])
        angular = six[3:] if self.directions == "all" else (T.R.T @ six[3:])[:2]
        both = [*linear, *angular]
        return tm.stack([both[i] for i in self.rows])

    def seen_rate(self, T: Pose, omega: Array, six: Array, six_rate: Array) -> Array:
        """The rate of `seen(T, six)` while the frame turns at omega (3,), in world axes."""
        if self.directions != "pointing":
            return self.seen(T, six_rate)
        turned = np.asanyarray(tm.skew(omega) @ six[3:])
        return self.seen(T, tm.stack([*six_rate[:3], *(six_rate[3:] - turned)]))

    def error(self, T: Pose, T_des: Pose) -> Array:
        """(rows,) desired minus actual, without dimension."""
        linear, angular = self.parts(T, T_des)
        both = [*(linear / self.length), *angular]
        return tm.array([both[i] for i in self.rows])

    def left(self, T: Pose, T_des: Pose, moved: Array) -> tuple[Any, Any]:
        """Lengths [m], [rad] of the error after a small further motion `moved` (6,) [m, rad], in world axes."""
        linear, angular = self.parts(T, T_des)
        if self.directions == "position":
            return tm.norm(linear - moved[:3]), 0.0
        turned = moved[3:] if self.directions == "all" else (T.R.T @ moved[3:])[:2]
        return tm.norm(linear - moved[:3]), tm.norm(angular - turned)

    def parts(self, T: Pose, T_des: Pose) -> tuple[Array, Array]:
        """(3,) [m] and (3,), (2,) or (0,) [rad]: desired minus actual."""
        linear = T_des.p - T.p
        if self.directions == "all":
            return linear, rotation_log(T_des.R @ T.R.T)
        if self.directions == "position":
            return linear, np.zeros(0)
        return linear, _turn_to(T.R.T @ T_des.R[:, 2])


def _turn_to(z: Array) -> Array:
    """(2,) the shortest turn about x and y that brings the axis z to the direction given [rad]."""
    square = z[0] * z[0] + z[1] * z[1]
    small = square < 1e-16
    sine = tm.sqrt(tm.where(small, 1.0, square))
    angle = tm.atan2(sine, z[2])
    ahead = tm.where(small, tm.where(z[2] > 0.0, 1.0, 0.0), angle / sine)
    behind = tm.where(small, tm.where(z[2] > 0.0, 0.0, np.pi), 0.0)  # straight behind every turn is as short
    return tm.array([-z[1] * ahead + behind, z[0] * ahead])


@functools.lru_cache(maxsize=128)
def task_of(arm: Arm, frame: str | None, directions: Directions) -> Task:
    """The task, with the rows that this arm has. Found at a few random positions."""
    model, reached = model_of(arm), reach(arm)
    length = LENGTH_OF_REACH * reached if 0.0 < reached < math.inf else 1.0
    whole = Task(frame=frame, directions=directions, rows=tuple(range(SIZES[directions])), rank=0, length=length)
    rng = np.random.default_rng(0)
    found = []
    for _ in range(3):
        q = rng.uniform(np.maximum(arm.lower, -3.0), np.minimum(arm.upper, 3.0))
        found.append(whole.seen(dyn.pose(model, q, frame), dyn.jacobian(model, q, frame)))
    moved = np.abs(np.array(found)).max(axis=(0, 2)) > TINY
    rank = max(int(np.linalg.matrix_rank(rows, tol=1e-6)) for rows in found)
    rows = tuple(int(i) for i in np.flatnonzero(moved))
    return Task(frame=frame, directions=directions, rows=rows, rank=rank, length=length)


class Resolved:
    """x with J x = b by least squares, |x - null| least: one factorisation for many b, over the free joints.

    x = null + J^T (J J^T + damping)^-1 (b - J null) for more joints than rows, else x = (J^T J + damping)^-1 J^T b.
    """

    def __init__(self, J: Matrix, free: Vector, damping: Any) -> None:
        self._J, self._free, self._Jf = J, free, J * free
        self._factors = LTDL(_normal(self._Jf, free, damping))

    def multipliers(self, b: Array, null: Array | None = None) -> Array:
        """What J^T is applied to: its transpose says where each joint would go, free or not."""
        if not _redundant(self._J):
            rest: Vector = b - self._J @ self(b)
            return rest
        return self._factors.solve(b if null is None else b - self._Jf @ null)

    def __call__(self, b: Array, null: Array | None = None) -> Vector:
        """(n,) x; `null`, which only redundant arms heed, is where the free motion goes."""
        if not _redundant(self._J):
            x: Vector = self._free * self._factors.solve(self._Jf.T @ b)
        else:
            x = self._Jf.T @ self.multipliers(b, null)
            if null is not None:
                x = x + self._free * null
        return x


def _redundant(J: Matrix) -> bool:
    rows, columns = J.shape
    return bool(rows < columns)


def _normal(Jf: Matrix, free: Vector, damping: Any) -> Matrix:
    A = Jf @ Jf.T if _redundant(Jf) else Jf.T @ Jf
    for i in range(len(A)):
        A[i, i] = A[i, i] + damping + (0.0 if _redundant(Jf) else 1.0 - free[i])
    return A


def damping_near_singularity(J: Matrix, free: Vector, largest: Any) -> Any:
    """Damping (to be added to J J^T) that is largest^2 at a singularity and exactly zero from s = 2 largest on.

    s = trace((J J^T)^-1)^-1/2 lies between 0.4 of the smallest singular value and that value.
    """
    inverse = LTDL(_normal(J * free, free, TINY)).inverse()
    total = inverse[0, 0]
    for i in range(1, len(inverse)):
        total = total + inverse[i, i]
    near = tm.maximum(0.0, 1.0 - 1.0 / (total * (4.0 * largest * largest + TINY)))
    return largest * largest * near * near


def held_joints(q: Vector, wish: Vector, lower: Float64Array, upper: Float64Array) -> Vector:
    """(n,) 1 for a joint that stands at a limit and would go beyond it, else 0."""
    low, high = tm.where(q <= lower, 1.0, 0.0), tm.where(q >= upper, 1.0, 0.0)
    held: Vector = low * tm.where(wish < 0.0, 1.0, 0.0) + high * tm.where(wish > 0.0, 1.0, 0.0)
    return held


def shortened(x: Vector, longest: Any) -> Vector:
    """x, made shorter as a whole until no entry is above `longest`."""
    ratio = tm.abs(x) / longest
    worst = ratio[0]
    for i in range(1, len(ratio)):
        worst = tm.maximum(worst, ratio[i])
    short: Vector = x / tm.maximum(1.0, worst)
    return short


def search_step(
    model: Model, task: Task, state: Array, target: Array, lower: Float64Array, upper: Float64Array
) -> Array:
    """One step of a Levenberg-Marquardt search with limits (projected Newton): a new state from an old one.

    State: (best q, tried q, cost of the best, damping, linear error, angular error, slope, limited).
    Target: (p, R row by row, posture).
    """
    n = model.n
    kept, tried, cost, trust = state[:n], state[n : 2 * n], state[2 * n], state[2 * n + 1]
    T_des = Pose.of(target[3:12].reshape(3, 3), target[:3])
    e = task.error(dyn.pose(model, tried, task.frame), T_des)
    better = (tm.array([e @ e]) < cost)[0]
    q = tm.where(better, tried, kept)
    trust = tm.clip(tm.where(better, 0.25 * trust, 6.0 * trust), 1e-6, 1e6)
    T = dyn.pose(model, q, task.frame)
    J, e = task.seen(T, dyn.jacobian(model, q, task.frame)), task.error(T, T_des)
    gradient = J.T @ e
    held = held_joints(q, gradient, lower, upper)
    free = 1.0 - held
    step = Resolved(J, free, trust * tm.norm(e) + TINY)(e)
    linear, angular = task.parts(T, T_des)
    slope, limited = tm.norm(free * gradient), np.sum(held)
    turn = tm.norm(angular) if len(angular) else 0.0
    new = tm.clip(q + shortened(step, MAX_SEARCH_STEP), lower, upper)
    return tm.array([*q, *new, e @ e, trust, tm.norm(linear), turn, slope, limited])


def posture_step(
    model: Model, task: Task, state: Array, target: Array, lower: Float64Array, upper: Float64Array
) -> Array:
    """One step towards the posture among the positions that keep the tool where it is to be.

    State: (q, held joints, linear error, angular error distance to the posture of the q before; step size).
    """
    n = model.n
    q, held = state[:n], state[n : 2 * n]
    T_des = Pose.of(target[3:12].reshape(3, 3), target[:3])
    T = dyn.pose(model, q, task.frame)
    J, e = task.seen(T, dyn.jacobian(model, q, task.frame)), task.error(T, T_des)
    free, wanted = 1.0 - held, target[12:] - q
    solve = Resolved(J, free, POSTURE_DAMPING)
    step = shortened(solve(e, free * wanted), MAX_POSTURE_STEP)
    wish = wanted + J.T @ solve.multipliers(e, free * wanted)
    new = tm.clip(q + step, lower, upper)
    held = held_joints(new, wish, lower, upper)
    linear, angular = task.parts(T, T_des)
    turn = tm.norm(angular) if len(angular) else 0.0
    return tm.array([*new, *held, tm.norm(linear), turn, tm.norm(wanted), tm.norm(new - q)])
