"""A motion from one state to another, moving or at rest: of the joints, or of the tool."""

from __future__ import annotations

from typing import Final, NoReturn, TypeAlias

import numpy as np
from numpy.polynomial import polynomial

from taut.base.errors import RangeError, ShapeError
from taut.base.fields import Field, Part
from taut.base.types import Float64Array
from taut.control.trajectories.reference import JointMotion, Rows, Sample
from taut.control.trajectories.task_reference import TaskMotion, between, linear_rates, pieces, quintic_between
from taut.control.trajectories.timing import GRID, MAX_OF_MOTION, Motion
from taut.maths.spatial import exp_rows, to_body_rates
from taut.trace.pose import Pose

Ends: TypeAlias = tuple[Float64Array, Float64Array, Float64Array]
ROUGHLY: Final = np.linspace(0.0, 1.0, 33)  # where the first estimate of the extremes is taken
DURATIONS: Final = np.geomspace(1e-2, 1e3, 250)  # durations that are tried, over the time scale of the motion
BISECTIONS: Final = 25
NOWHERE: Final = 1e-3  # [s] time scale of a motion that goes nowhere
NO_TERM: Final = 1e-15  # [-] of a polynomial: a last coefficient below it is rounding
KEPT: Final = 1.0 + 1e-9  # [-] of a limit: rounding of a start that is at it


class Transition(Motion[Sample]):
    """From a state to another: position, velocity and acceleration begin and end as those of both, exactly.

    Law:          joints: q(t) a polynomial of degree 5 for each
                  tool: p(t) likewise; R(t) = R_0 exp(r(t)) with r(t) likewise, and with the twists of both states
                  where the start accelerates towards a limit of speed, its acceleration fades to zero first,
                  linearly, in the time in which half of the room up to the limit is used

    It changes the goal in mid-motion without a jump: begin with the sample of the motion before, `start=old.at(t)`,
    or with what is measured, `start=taut.JointMotion(q=x.q, v=x.v)`. The duration is given, or it is the shortest of
    those tried in which the limits hold. Speeds and accelerations are checked at the extremes of the polynomials,
    those of the tool's rotation at 2001 instants. Position limits are not known: from a fast start it may overshoot.
    After the duration it rests at the goal, also if that is to move.

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
        >>> (new.at(0.0).v - old.at(0.5).v).item(), new.at(new.duration).q.round(9).tolist()
        (0.0, [-1.0])
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
        at_once: tuple[tuple[Sample, ...], Float64Array] = (self.start, self.goal), np.array([0.0, self.duration])
        through, knots = self._shortest() if self.duration is None else at_once
        self.__dict__.update(_rows=_stacked(through), _knots=knots, duration=float(knots[-1]))

    def rows(self, times: Float64Array) -> Sample:
        knots, rows = self.__dict__["_knots"], self.__dict__["_rows"]
        if isinstance(self.start, TaskMotion):
            return TaskMotion.of(between(times, knots, rows))
        i = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
        h = (knots[i + 1] - knots[i])[:, np.newaxis]
        x = np.clip((times - knots[i]) / h[:, 0], 0.0, 1.0)
        q, v, a = quintic_between(x, h, *(tuple(rows[name][i + end] for name in "qva") for end in (0, 1)))
        outside = (times < 0.0) | (times > knots[-1])
        v[outside] = a[outside] = 0.0
        return JointMotion.of({"q": q, "v": v, "a": a})

    def _shortest(self) -> tuple[tuple[Sample, ...], Float64Array]:
        """The states that it goes through, and when: at once to the goal, or after its acceleration has faded."""
        limits = self._limits()
        found: list[tuple[tuple[Sample, ...], Float64Array]] = []
        for through, times in [((self.start,), [0.0]), *self._faded(limits)]:
            exceeded, T = self._fastest(through[-1], limits)
            found += [((*through, self.goal), np.array([*times, times[-1] + T]))] if T else []
        if not found:
            self._never(exceeded)
        return min(found, key=lambda each: float(each[1][-1]))

    @property
    def _groups(self) -> list[list[int]]:
        """The coordinates that have a limit in common: each joint alone, or position and rotation of the tool."""
        if isinstance(self.start, JointMotion):
            return [[i] for i in range(len(self.start.q))]
        return [[0, 1, 2], [3, 4, 5]]

    def _limits(self) -> Float64Array:
        """(2, groups) of speed and acceleration: of each joint; of the tool linear and angular."""
        tool, m = isinstance(self.start, TaskMotion), len(self._groups)
        for name in ("velocity", "acceleration"):
            shape = np.shape(getattr(self, name))
            if shape not in (((2,),) if tool else ((), (1,), (m,))):
                wanted = "(linear, angular), shape (2,)" if tool else f"a number, or shape ({m},)"
                self.refuse(name, f"must be {wanted}; got shape {shape}", ShapeError)
        return np.stack([np.broadcast_to(limit, (m,)) for limit in (self.velocity, self.acceleration)])

    def _faded(self, limits: Float64Array) -> list[tuple[tuple[Sample, ...], list[float]]]:
        """The start, the state in which its acceleration is zero, and when; empty for none, or no room."""
        (_, v, a), _ = _ends(_stacked((self.start, self.goal)))
        speed, acceleration = (
            np.array([np.linalg.norm(part[0, group]) for group in self._groups]) for part in (v, a)
        )
        room = limits[0] - speed
        if not acceleration.any() or (room <= 0.0).any() or (acceleration > KEPT * limits[1]).any():
            return []
        time = float(np.min(room[acceleration > 0.0] / acceleration[acceleration > 0.0]))
        y, rate = v[0] * time + a[0] * time**2 / 3.0, v[0] + 0.5 * a[0] * time
        if isinstance(self.start, JointMotion):
            return [((self.start, JointMotion(q=self.start.q + y, v=rate)), [0.0, time])]
        assert isinstance(self.start, TaskMotion)
        R = self.start.R @ exp_rows(y[np.newaxis, 3:])[0]
        turning = to_body_rates(y[np.newaxis, 3:], rate[np.newaxis, 3:], np.zeros((1, 3)))
        omega, alpha = (R @ part[0] for part in turning)
        twist, slowing = np.append(rate[:3], omega), np.append(np.zeros(3), alpha)
        middle = TaskMotion(pose=Pose(p=self.start.p + y[:3], R=R), twist=twist, acceleration=slowing)
        return [((self.start, middle), [0.0, time])]

    def _fastest(self, start: Sample, limits: Float64Array) -> tuple[Float64Array, float | None]:
        """The shortest duration from a state to the goal in which the limits hold, and None where none does [s].

        The other number is how much they are exceeded at best, (2, groups) over the limits.
        """
        ends = _ends(_stacked((start, self.goal)))
        groups, tool = self._groups, isinstance(start, TaskMotion)

        def rates(T: Float64Array) -> tuple[Float64Array, Float64Array]:
            c = _coefficients(T, *ends)
            first, second = polynomial.polyder(c) / T, polynomial.polyder(c, 2) / T**2
            return first, second

        def excess(T: float) -> Float64Array:
            found = np.array([[_peak(rate[:, group]) for group in groups] for rate in rates(np.array(T))])
            if tool:
                found[:, 1] = _turning(_coefficients(np.array(T), *ends)[:, 3:], T)
            out: Float64Array = found / limits
            return out

        (y0, v0, _), (y1, v1, _) = ends
        far, fast = (
            np.array([np.linalg.norm(each[0, group]) for group in groups])
            for each in (y1 - y0, np.maximum(np.abs(v0), np.abs(v1)))
        )
        times = far / limits[0], np.sqrt(far / limits[1]), fast / limits[1]
        tried: Float64Array = np.asarray(DURATIONS * (float(np.max(times)) or NOWHERE))
        looks: list[Float64Array] = [
            np.asarray(polynomial.polyval(ROUGHLY, rate)) for rate in rates(tried[:, np.newaxis])
        ]
        rough = np.zeros(len(tried))
        for look, row in zip(looks, limits, strict=True):
            for group, limit in zip(groups, row, strict=True):
                rough = np.maximum(rough, _longest(look[:, group], axis=1) / limit)
        for k in map(int, np.flatnonzero(rough <= KEPT)):
            if excess(tried[k]).max() <= KEPT:
                long, short = float(tried[k]), float(tried[max(k - 1, 0)])
                for _ in range(BISECTIONS):
                    middle = 0.5 * (long + short)
                    long, short = (middle, short) if excess(middle).max() <= KEPT else (long, middle)
                return np.zeros(0), long
        return excess(float(tried[np.argmin(rough)])), None

    def _never(self, excess: Float64Array) -> NoReturn:
        kind, group = divmod(int(np.argmax(excess)), excess.shape[1])
        name = ("velocity", "acceleration")[kind]
        where = ("linear", "angular")[group] if isinstance(self.start, TaskMotion) else f"joint {group}"
        self.refuse(
            name,
            f"is kept by no duration: from this start {where} takes {excess.max():.4g} times its limit at least; "
            "give larger limits, or a slower start",
            RangeError,
        )


def _stacked(samples: tuple[Sample, ...]) -> Rows:
    """The fields of some samples as rows."""
    return {name: np.stack([getattr(sample, name) for sample in samples]) for name in samples[0].fields(1)}


def _ends(rows: Rows) -> tuple[Ends, Ends]:
    """Value, rate and acceleration (1, m) at two states; of the tool the position, then the rotation vector."""
    if "q" in rows:
        first, last = (tuple(rows[name][[i]] for name in "qva") for i in (0, 1))
        return first, last  # type: ignore[return-value]  # three each
    turns = pieces(np.array([0.0, 1.0]), rows)
    first, last = (
        tuple(np.hstack([part[[i]], turn]) for part, turn in zip(linear_rates(rows), turns[i], strict=True))
        for i in (0, 1)
    )
    return first, last  # type: ignore[return-value]  # three each


def _coefficients(T: Float64Array, start: Ends, end: Ends) -> Float64Array:
    """(6, m) of the quintics over x = t / T, lowest first; (6, k, m) for durations (k, 1)."""
    (y0, v0, a0), (y1, v1, a1) = (tuple(part[0] * T**k for k, part in enumerate(ends)) for ends in (start, end))
    d, e, f = y1 - y0 - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
    c3, c4, c5 = 10.0 * d - 4.0 * e + 0.5 * f, -15.0 * d + 7.0 * e - f, 6.0 * d - 3.0 * e + 0.5 * f
    return np.stack(np.broadcast_arrays(y0, v0, 0.5 * a0, c3, c4, c5))


def _longest(values: Float64Array, axis: int = 0) -> Float64Array:
    """Largest length of vectors along an axis, of those along the last one."""
    out: Float64Array = np.sqrt(np.max(np.sum(values**2, axis=axis), axis=-1))
    return out


def _peak(c: Float64Array) -> Float64Array:
    """Largest length for x in [0, 1], exactly: where its square has an extreme."""
    square = sum(polynomial.polymul(each, each) for each in c.T)
    slope = polynomial.polytrim(polynomial.polyder(square), tol=NO_TERM * float(np.max(np.abs(square))))
    roots = polynomial.polyroots(slope).real if len(slope) > 1 else np.zeros(0)
    return _longest(np.asarray(polynomial.polyval(np.clip(np.append(roots, (0.0, 1.0)), 0.0, 1.0), c)))


def _turning(c: Float64Array, T: float) -> list[Float64Array]:
    """Largest angular speed and acceleration of the rotation by a vector of polynomials c (6, 3)."""
    r, r1, r2 = (np.asarray(polynomial.polyval(GRID, polynomial.polyder(c, k)).T / T**k) for k in range(3))
    return [_longest(part.T) for part in to_body_rates(r, r1, r2)]
