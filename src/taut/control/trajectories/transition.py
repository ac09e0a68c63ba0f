"""A motion from one state to another, moving or at rest: of the joints, or of the tool."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from taut.base.errors import RangeError, ShapeError
from taut.base.fields import Field, Part
from taut.base.types import Float64Array
from taut.control.trajectories.reference import JointMotion, Sample, stacked
from taut.control.trajectories.task_reference import TaskMotion, piece_ends, quintic_between, tool_motion
from taut.control.trajectories.timing import GRID, MAX_OF_MOTION, Motion
from taut.maths.spatial import to_body_rates

DURATIONS: Final = np.geomspace(1e-2, 1e3, 250)  # durations that are tried, over the time scale of the motion
SPARSE: Final = 50  # one instant of the grid in so many is looked at first
NOWHERE: Final = 1e-3  # [s] time scale of a motion that goes nowhere
KEPT: Final = 1.0 + 1e-9  # [-] of a limit: rounding of a start that is at it
CLOSE: Final = 1e-12  # [-] of a duration


class Transition(Motion[Sample]):
    """From a state to another: position, velocity and acceleration begin and end as those of both, exactly.

    Law:          joints: q(t) a polynomial of degree 5 for each
                  tool: p(t) likewise; R(t) = R_0 exp(r(t)) with r(t) likewise, and with the twists of both states
                  where the start accelerates towards a limit of speed, its acceleration may fade to zero first,
                  linearly, in the time in which half of the room up to the limit is used

    It changes the goal in mid-motion without a jump: begin with the sample of the motion before, `start=old.at(t)`,
    or with what is measured. The duration is given, or the shortest in which the limits hold, within 1e-9 of joints.
    Position limits are not known: from a fast start it may overshoot. Afterwards it rests at the goal.

    Args:
        start: Where it begins: a JointMotion or a TaskMotion, with its rates.
        goal: Where it ends, a sample of the same kind; at rest if it states no rates.
        duration: [s], in place of the limits. Afterwards: how long it takes.
        velocity: (n,) or scalar largest speeds [rad/s | m/s]; of the tool (linear, angular) [m/s, rad/s].
        acceleration: Largest accelerations, likewise.

    Raises:
        UsageError: Samples of different kinds; neither a duration nor both limits.
        ShapeError: Other numbers of joints or of limits.
        RangeError: Limits that no duration keeps, as where it starts faster than they allow.

    Example:
        >>> old = Transition(start=JointMotion(q=[0.0]), goal=JointMotion(q=[1.0]), duration=1.0)
        >>> new = Transition(start=old.at(0.5), goal=JointMotion(q=[-1.0]), velocity=2.0, acceleration=20.0)
        >>> old.at(0.5).v.tolist(), new.at(0.0).v.round(9).tolist(), new.at(new.duration).q.round(9).tolist()
        ([1.875], [1.875], [-1.0])
    """

    start: Part[Sample] = Part(Sample)  # type: ignore[type-abstract]
    goal: Part[Sample] = Part(Sample)  # type: ignore[type-abstract]
    duration: Field = Field(unit="s", above=0.0, maximum=MAX_OF_MOTION, optional=True, run_time=False)
    velocity: Field = Field(unit="rad/s | m/s", shape="n", above=0.0, optional=True)
    acceleration: Field = Field(unit="rad/s^2 | m/s^2", shape="n", above=0.0, optional=True)

    def check(self) -> None:
        kind = type(self.start)
        if kind not in (JointMotion, TaskMotion) or type(self.goal) is not kind:
            kinds = f"{kind.__name__} and {type(self.goal).__name__}"
            self.refuse("goal", f"and start must be two JointMotions or two TaskMotions; got {kinds}")
        if isinstance(self.start, JointMotion) and len(self.start.q) != len(getattr(self.goal, "q", ())):
            self.refuse("goal", "must have as many joints as start", ShapeError)
        given = [getattr(self, name) is not None for name in ("duration", "velocity", "acceleration")]
        if given not in ([True, False, False], [False, True, True]):
            self.refuse("", "needs duration [s], or velocity and acceleration")
        start, goal = self._ends()
        knots, states = [0.0, self.duration], [start, goal]
        if self.duration is None:
            knots, states = self._shortest(start, goal)
        made = np.array(states).reshape(len(states), 3, -1)
        self.__dict__.update(_states=made, _knots=np.array(knots, dtype=np.float64), duration=float(knots[-1]))

    def rows(self, times: Float64Array) -> Sample:
        knots, states = self.__dict__["_knots"], self.__dict__["_states"]
        i = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
        h = knots[i + 1] - knots[i]
        x = np.clip((times - knots[i]) / h, 0.0, 1.0)
        y = np.array(quintic_between(x, h, *(states[i + end].swapaxes(0, 1) for end in (0, 1))))
        y[1:, (times < 0.0) | (times > knots[-1])] = 0.0
        if isinstance(self.start, JointMotion):
            return JointMotion.of(dict(zip("qva", y, strict=True)))
        assert isinstance(self.start, TaskMotion)
        return TaskMotion.of(tool_motion(self.start.R, y))

    def _ends(self) -> Float64Array:
        """(2, 3, groups, size) value, rate and acceleration of the coordinates at start and goal.

        A group is what has a limit in common: a joint, the tool's position, or its rotation vector from the start.
        """
        both: Any = stacked([self.start, self.goal])
        if isinstance(both, JointMotion):
            return np.stack([both.q, both.v, both.a], axis=1)[..., np.newaxis]
        return piece_ends(both.stated()).reshape(2, 3, 2, 3)

    def _shortest(self, start: Float64Array, goal: Float64Array) -> tuple[list[float], list[Float64Array]]:
        """Knots, and the states at these: it goes to the goal at once, or after its acceleration has faded."""
        tool, m = isinstance(self.start, TaskMotion), start.shape[1]
        if tool and (np.shape(self.velocity), np.shape(self.acceleration)) != ((2,), (2,)):
            self.refuse("velocity", "and acceleration of the tool must be (linear, angular)", ShapeError)
        self.check_size(m)
        limits = np.stack([np.broadcast_to(limit, (m,)) for limit in (self.velocity, self.acceleration)])
        routes = [([0.0], [start]), *_faded(start, limits)]
        shortest = [_fastest(states[-1], goal, limits) for _, states in routes]
        found = [
            ([*knots, knots[-1] + T], [*states, goal])
            for (knots, states), (T, _) in zip(routes, shortest, strict=True)
            if T is not None
        ]
        if not found:
            exceeded = shortest[-1][1]
            kind, group = divmod(int(np.argmax(exceeded)), m)
            who = ("linear", "angular")[group] if tool else f"joint {group}"
            self.refuse(
                ("velocity", "acceleration")[kind],
                f"is a limit that no duration keeps: from this start {who} reaches {exceeded.max():.4g} times it at "
                "least; give larger limits, or a slower start",
                RangeError,
            )
        return min(found, key=lambda each: each[0][-1])


def _size(x: Float64Array) -> Float64Array:
    return np.asarray(np.linalg.norm(x, axis=-1))


def _faded(start: Float64Array, limits: Float64Array) -> list[tuple[list[float], list[Float64Array]]]:
    """The state in which the acceleration of the start is zero, after it, and when; empty for none, or no room."""
    y, v, a = start
    room, acceleration = limits[0] - _size(v), _size(a)
    if not acceleration.any() or (room <= 0.0).any() or (acceleration > KEPT * limits[1]).any():
        return []
    t = float(np.min(room[acceleration > 0.0] / acceleration[acceleration > 0.0]))
    return [([0.0, t], [start, np.array([y + v * t + a * t**2 / 3.0, v + 0.5 * a * t, 0.0 * a])])]


def _fastest(start: Float64Array, goal: Float64Array, limits: Float64Array) -> tuple[float | None, Float64Array]:
    """The shortest duration between two states in which the limits hold, None where none does [s].

    The other result is how much they are exceeded at best, (2, groups) over the limits.
    """
    from scipy.optimize import brentq

    def used(T: Float64Array, x: Float64Array) -> Float64Array:
        """(k, instants, 2, groups) what is used of the limits at x, for durations T (k,)."""
        ends = (state.reshape(3, 1, -1) for state in (start, goal))
        y = np.array(quintic_between(np.tile(x, len(T)), np.repeat(T, len(x)), *ends))  # type: ignore[arg-type]
        if start.shape[2] == 3:
            y[1:, :, 3:] = to_body_rates(*y[:, :, 3:])
        sizes = np.linalg.norm(y[1:].reshape(2, len(T), len(x), *start.shape[1:]), axis=-1)
        return np.asarray(np.moveaxis(sizes, 0, 2) / limits)

    def excess(T: float) -> Float64Array:
        """(2, groups) the most that is used: the top of a parabola through the largest one and those beside it."""
        y = used(np.array([T]), GRID)[0].reshape(len(GRID), -1)
        k, each = y.argmax(axis=0), np.arange(y.shape[1])
        before, top, after = (y[np.clip(k + i, 0, len(y) - 1), each] for i in (-1, 0, 1))
        bend, inside = 2.0 * top - before - after, (k > 0) & (k < len(y) - 1)
        more = np.divide((after - before) ** 2, 8.0 * bend, out=np.zeros_like(top), where=inside & (bend > 0.0))
        return np.asarray(top + more).reshape(2, -1)

    def over(T: float) -> float:
        return float(excess(T).max()) - KEPT

    far, fast = _size(goal[0] - start[0]), _size(np.maximum(np.abs(start[1]), np.abs(goal[1])))
    scale = float(np.max([far / limits[0], np.sqrt(far / limits[1]), fast / limits[1]])) or NOWHERE
    tried = scale * DURATIONS
    rough = used(tried, GRID[::SPARSE]).max(axis=(1, 2, 3))
    for k in np.flatnonzero(rough <= KEPT).tolist():
        if over(tried[k]) <= 0.0:
            short, long = tried[[max(k - 1, 0), k]].tolist()
            return float(brentq(over, short, long, xtol=CLOSE * long)) if over(short) > 0.0 else short, np.zeros(0)
    return None, excess(float(tried[np.argmin(rough)]))
