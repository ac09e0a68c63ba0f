"""taut.inverse_kinematics: joint positions that bring the tool to a pose, by native steps."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.parts import TURN, require_radians
from taut.base.checks import instance_of, one_of, positive_scalar, require_range, vector
from taut.base.errors import RangeError, count_of
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.kernel import NativeFunction, native
from taut.maths import dynamics as dyn
from taut.maths.ik import DIRECTIONS, Directions, IkOutcome, Task, posture_step, search_step, task_of
from taut.maths.model import model_of
from taut.trace.pose import Pose

STEPS: Final = 100  # of a search from one start
FLAT_SLOPE: Final = 1e-9  # slope of the error, without dimension, under which it does not fall any more
STUBBORN: Final = 1e5  # damping at which no step was better for long
POSTURE_STEPS: Final = 60
WATCHED: Final = 20  # steps in which the cost must fall by something
FALLING: Final = 0.999
NEARLY_SINGULAR: Final = 1e-2  # singular value, without dimension: the arm is stretched out, or about to be
ROUNDING: Final = 1e-9  # [rad | m] by which a position may be beyond a limit that was written with few digits
NEAREST_POSTURE_STEP: Final = (
    1e-9  # [rad | m] a step along the free motion under which the posture is the nearest one
)


@dataclass(frozen=True, kw_only=True, eq=False)
class IkResult:
    """Joint positions, and how the search for them ended."""

    q: Float64Array  # (n,) [rad | m]
    outcome: IkOutcome
    error: tuple[float, float]  # what is left: [m], [rad], in the directions that were asked for
    iterations: int  # of all starts together
    starts: int
    held: tuple[str, ...]  # joints at a limit that keep the tool from the target

    @property
    def ok(self) -> bool:
        """True where the tool is at the target, within the tolerance."""
        return self.outcome is IkOutcome.SOLVED

    @property
    def sentence(self) -> str:
        """The outcome in words and numbers."""
        linear, angular = self.error
        names = ", ".join(repr(name) for name in self.held)
        at = f" ({names})" if self.held and not self.ok else ""
        return (
            f"{self.outcome.value}{at}: {linear:.3g} m and {angular:.3g} rad are left after {self.iterations} steps "
            f"from {count_of(self.starts, 'start')}"
        )


def inverse_kinematics(
    arm: Arm,
    pose: Pose,
    *,
    q0: ArrayLike | None = None,
    frame: str | None = None,
    posture: ArrayLike | None = None,
    directions: Directions = "all",
    tolerance: tuple[float, float] = (1e-6, 1e-6),
    restarts: int = 50,
    seed: int = 0,
) -> IkResult:
    """Joint positions that bring a frame of the arm to a pose.

    Law:
        Levenberg-Marquardt steps dq = (J^T J + mu |e| I)^-1 J^T e, accepted where |e| falls; a joint at a limit that
        the gradient J^T e would drive beyond it is held. Redundant arms then move in the null space to the position
        nearest to the posture. Joints with a range above one turn end within half a turn of q0 where their limits
        allow.

    Args:
        arm: The arm.
        pose: T_WD, the target of the frame.
        q0: (n,) start of the search [rad | m]; home if left out. Further starts are random.
        frame: The frame; the arm's tool if left out.
        posture: (n,) what redundant arms stay near to [rad | m]; q0 if left out.
        directions: "all" six; "position"; "pointing", for tools that may spin: position, and where z points.
        tolerance: Largest error of position [m] and of rotation [rad].
        restarts: Number of random starts that are tried where q0 does not lead to the target.
        seed: Of the random starts.

    Returns:
        The positions, the outcome, the remaining error. A target that is out of reach is an outcome, no error.

    Raises:
        UsageError, UnknownNameError: Not an arm, not a pose, unknown directions, no such frame.
        ShapeError: q0 or posture of another size.
        RangeError: Positions that are not finite, in degrees, or beyond the limits; a tolerance that is not positive.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> target = taut.snapshot(arm, q=[0.3, 1.0]).T()
        >>> found = taut.inverse_kinematics(arm, target, q0=[0.2, 0.8])
        >>> found.ok, found.q.round(6).tolist()
        (True, [0.3, 1.0])

    References:
        Section 10.2.3, equation 10.28. Bertsekas, SIAM J. Control and Optimization 20 (1982): projected Newton.
    """
    instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
    instance_of("pose", pose, Pose, "a taut.Pose")
    one_of("directions", directions, DIRECTIONS)
    search = _search_of(arm, arm.frame(frame).name, directions)
    start = search.checked("q0", arm.home if q0 is None else q0)
    wanted = start if posture is None else search.checked("posture", posture)
    linear, angular = tolerance
    within = positive_scalar("tolerance[0]", linear, unit="m"), positive_scalar("tolerance[1]", angular, unit="rad")
    require_range("restarts", restarts, minimum=0.0)
    found = search.from_starts(pose, start, wanted, within, int(restarts), seed)
    if found.ok and search.posture is not None:
        found = search.to_posture(search.posture, found, wanted, pose, within)
    elif found.outcome is IkOutcome.OUT_OF_REACH and search.has_fewer_joints(found.q):
        found = replace(found, outcome=IkOutcome.FEWER_JOINTS)
    return replace(found, q=search.turned(found.q, start))


class _Search:
    """The native steps for one arm, frame and choice of directions."""

    def __init__(self, arm: Arm, frame: str, directions: Directions) -> None:
        self.arm = arm
        self.task: Task = task_of(arm, frame, directions)
        self.turns = TURN * np.array([unit == "rad" for unit in arm.units])  # (n,) what a whole turn is
        n = arm.n
        self.lower, self.upper = np.array(arm.lower), np.array(arm.upper)
        model, task, lower, upper = model_of(arm), self.task, self.lower, self.upper
        self.search = native(
            lambda state, target: search_step(model, task, state, target, lower, upper),
            state=2 * n + 6,
            target=12 + n,
        )
        self.posture: NativeFunction | None = None
        if task.size < n:
            self.posture = native(
                lambda state, target: posture_step(model, task, state, target, lower, upper),
                state=2 * n + 4,
                target=12 + n,
            )

    def checked(self, name: str, value: ArrayLike) -> Float64Array:
        """Joint positions that the arm may have."""
        arm = self.arm
        q = vector(name, value, arm.n, unit="rad | m", joints=arm.joint_names)
        beyond = (q < self.lower - ROUNDING) | (q > self.upper + ROUNDING)
        if beyond.any():
            require_radians(name, q, arm)
            i = int(np.argmax(beyond))
            raise RangeError(
                f"{name}[{i}] (joint '{arm.joint_names[i]}') must be between its limits {self.lower[i]:.4g} and "
                f"{self.upper[i]:.4g} [{arm.units[i]}]; got {q[i]:g}",
                name=name,
                joint=arm.joint_names[i],
                value=float(q[i]),
                rule="within limits",
            )
        return np.clip(q, self.lower, self.upper)

    def from_starts(
        self,
        pose: Pose,
        q0: Float64Array,
        posture: Float64Array,
        within: tuple[float, float],
        restarts: int,
        seed: int,
    ) -> IkResult:
        """The first start that leads to the target, else the best."""
        target = np.concatenate([pose.p, pose.R.ravel(), posture])
        best = self._from(q0, target, within)
        if best.ok or not restarts:
            return best
        rng = np.random.default_rng(seed)
        low, high = np.maximum(self.lower, q0 - math.pi), np.minimum(self.upper, q0 + math.pi)
        low, high = np.where(self.lower > -np.inf, self.lower, low), np.where(self.upper < np.inf, self.upper, high)
        iterations, starts = best.iterations, 1
        for _ in range(restarts):
            found = self._from(rng.uniform(low, high), target, within)
            iterations, starts = iterations + found.iterations, starts + 1
            if self._cost(found) < self._cost(best):
                best = found
            if found.ok:
                break
        return replace(best, iterations=iterations, starts=starts)

    def _cost(self, found: IkResult) -> float:
        """The square of the error, without dimension."""
        return (found.error[0] / self.task.length) ** 2 + found.error[1] ** 2

    def _from(self, q: Float64Array, target: Float64Array, within: tuple[float, float]) -> IkResult:
        n, step = self.arm.n, self.search.call
        state = np.concatenate([q, q, [math.inf, 1.0, 0.0, 0.0, 0.0, 0.0]])
        linear, angular = within
        done = level = False
        count, before = 0, math.inf
        while not done and count < STEPS:
            state = step(state, target)
            count += 1
            trust, left, turn, slope = state[2 * n + 1 : 2 * n + 5].tolist()
            level = slope < FLAT_SLOPE or trust > STUBBORN
            if count % WATCHED == 0:
                cost = float(state[2 * n])
                level, before = level or cost > FALLING * before, cost
            done = level or (left < linear and turn < angular)
        q, error = state[:n].copy(), (float(state[2 * n + 2]), float(state[2 * n + 3]))
        solved = error[0] < linear and error[1] < angular
        at = ((q <= self.lower) | (q >= self.upper)) & (not solved and state[2 * n + 5] > 0.0)
        held = tuple(name for name, there in zip(self.arm.joint_names, at, strict=True) if there)
        outcome = IkOutcome.AT_LIMIT if held else IkOutcome.OUT_OF_REACH
        if solved or not level:
            outcome = IkOutcome.SOLVED if solved else IkOutcome.STALLED
        return IkResult(q=q, outcome=outcome, error=error, iterations=count, starts=1, held=held)

    def has_fewer_joints(self, q: Float64Array) -> bool:
        """True where the joints move the tool in fewer directions than requested, and in all of those at q."""
        model, task = model_of(self.arm), self.task
        rows = task.seen(dyn.pose(model, q, task.frame), dyn.jacobian(model, q, task.frame))
        return task.rank < task.asked and np.linalg.matrix_rank(rows, tol=NEARLY_SINGULAR) == task.rank

    def to_posture(
        self, native: NativeFunction, found: IkResult, posture: Float64Array, pose: Pose, within: tuple[float, float]
    ) -> IkResult:
        """The posture nearest to the wanted one that keeps the tool at the target."""
        n, step = self.arm.n, native.call
        posture = found.q + self.arm.difference(posture, found.q)
        target = np.concatenate([pose.p, pose.R.ravel(), posture])
        state = np.concatenate([found.q, np.zeros(n + 4)])
        best, error, count, first = found.q, found.error, 0, math.inf
        for _ in range(POSTURE_STEPS):
            before = state
            state = step(state, target)
            count += 1
            left, turn, away, moved = state[2 * n :].tolist()  # the first three of the state before this step
            first = min(first, away) if count == 1 else first
            if left < within[0] and turn < within[1] and away <= first:
                best, error = before[:n], (left, turn)
            if moved < NEAREST_POSTURE_STEP:
                break
        return replace(found, q=best.copy(), error=error, iterations=found.iterations + count)

    def turned(self, q: Float64Array, q0: Float64Array) -> Float64Array:
        """q with whole turns taken off hinges, towards q0, where limits allow."""
        turned = q - self.turns * np.round((q - q0) / TURN)
        return np.where((turned >= self.lower) & (turned <= self.upper), turned, q)


@functools.lru_cache(maxsize=32)
def _search_of(arm: Arm, frame: str, directions: Directions) -> _Search:
    return _Search(arm, frame, directions)
