"""What a hybrid law is asked to follow: a motion along a constraint, and forces against it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, ClassVar, Final, Self

import numpy as np

from taut.base.checks import finite_array, finite_scalar, read_only, vector
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import Array, ArrayLike, Float64Array
from taut.control.trajectories.reference import Hold, JointMotion, Sample, Trajectory
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot

__all__ = ["MOST_ROWS", "HybridMotion", "hybrid_kind", "pressing"]

MOST_ROWS: Final = 12  # of all constraints at once
FORCES: Final = {"press": (1,), "lam": (MOST_ROWS,), "F_app": (6,), "given": (1,)}


class HybridMotion(Sample):
    """A motion, and the forces that the arm is to apply against its constraints; `taut.pressing` makes them.

    Fields are those of the motion, and the forces, which add up:
        press (1,) [N] into the surface of the first row, lam (12,) the multipliers of eq. 10.40 row by row, and F_app
        (6,) a wrench [N, N m] of the arm on the environment at the tool, in world axes. given (1,) tells how many
        multipliers were given, 0 where none were.
    """

    __slots__ = ("F_app", "_motion", "given", "lam", "press")
    kind: ClassVar[type[Sample]] = TaskMotion

    press: Array
    lam: Array
    F_app: Array
    given: Array

    def __init__(self, motion: Sample, press: Array, lam: Array, F_app: Array, given: Array) -> None:
        self._motion, self.press, self.lam, self.F_app, self.given = motion, press, lam, F_app, given
        for name in self.kind.fields(0):  # where the call path finds them
            setattr(self, name, getattr(motion, name))

    @property
    def motion(self) -> Sample:
        """The motion without the forces."""
        return self._motion

    @classmethod
    def described(cls) -> str:
        return f"HybridMotion of a {cls.kind.described()}, from taut.pressing(...)"

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:
        return {**cls.kind.fields(n), **FORCES}

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        return cls(cls.kind.of(values), *(values[name] for name in FORCES))

    @classmethod
    def between(
        cls, times: Float64Array, knots: Float64Array, rows: Mapping[str, Float64Array]
    ) -> dict[str, Float64Array]:
        forces = {name: rows[name] for name in FORCES}
        motion = {name: values for name, values in rows.items() if name not in FORCES}
        return {**cls.kind.between(times, knots, motion), **super().between(times, knots, forces)}

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:
        """To stay, and to apply no force."""
        return cls(cls.kind.at_rest(x, tool), *(np.zeros(shape) for shape in FORCES.values()))

    def __repr__(self) -> str:
        if self.F_app.dtype == object:
            return "HybridMotion(<traced>)"
        given = {name: np.asarray(getattr(self, name)) for name in FORCES if name != "given"}
        forces = [f"{name}={values.squeeze().tolist()}" for name, values in given.items() if np.any(values)]
        return f"pressing({', '.join([repr(self.motion), *forces])})"


@cache
def hybrid_kind(motion: type[Sample]) -> type[HybridMotion]:
    """The kind of sample that holds this kind of motion."""
    return type("HybridMotion", (HybridMotion,), {"__slots__": tuple(motion.fields(0)), "kind": motion})


OF_TASK, OF_JOINTS = hybrid_kind(TaskMotion), hybrid_kind(JointMotion)  # so that logs find them


class Pressing:
    """A trajectory of motion, with forces, as one trajectory."""

    def __init__(
        self,
        motion: Sample | Trajectory,
        press: float | Callable[[float], float],
        lam: Array,
        F_app: Array,
        given: Array,
    ) -> None:
        self._motion, self._press, self._lam, self._F_app, self._given = motion, press, lam, F_app, given

    def at(self, t: float) -> Sample:
        """The sample at time t [s]."""
        motion = self._motion if isinstance(self._motion, Sample) else self._motion.at(t)
        press = _checked_press(self._press(t), t) if callable(self._press) else self._press
        return hybrid_kind(type(motion))(motion, np.array([press]), self._lam, self._F_app, self._given)

    @property
    def motion(self) -> Sample | Trajectory:
        """The motion without the forces."""
        return self._motion

    @property
    def presses(self) -> bool:
        """Whether it asks for a press, if only later."""
        return callable(self._press) or self._press > 0.0

    @property
    def rows(self) -> Callable[[Float64Array], Sample] | None:
        """Samples at many times at once, where the motion gives them so: much faster than one by one."""
        of_motion: Callable[[Float64Array], Sample] | None = getattr(self._motion, "rows", None)
        if of_motion is None:
            return None

        def rows(times: Float64Array) -> Sample:
            motion, k = of_motion(times), len(times)
            given = [self._press(float(t)) if callable(self._press) else self._press for t in times]
            press = np.array([_checked_press(value, float(t)) for value, t in zip(given, times, strict=True)])
            others = (np.tile(values, (k, 1)) for values in (self._lam, self._F_app, self._given))
            return hybrid_kind(type(motion))(motion, press[:, np.newaxis], *others)

        return rows

    @property
    def duration(self) -> float | None:
        """[s] of the motion, where it has one."""
        return getattr(self._motion, "duration", None)


def pressing(
    motion: Sample | Hold | Trajectory,
    press: float | Callable[[float], float] = 0.0,
    *,
    lam: ArrayLike | None = None,
    F_app: ArrayLike | None = None,
) -> HybridMotion | Pressing:
    """A motion along a constraint, and forces against it: what `taut.laws.HybridMotionForce` follows.

    Args:
        motion: Where the tool, or the joints, are to be: a sample, or a trajectory such as `taut.trajectories.Line`.
        press: Force into the surface of the first row [N], at least 0; a number, or a function of time [s]. That row
            must be one-sided.
        lam: (k,) multipliers of eq. 10.40, F_app = A^T lam, in place of press, one for each row of the constraint;
            pressing on a contact they are < 0.
        F_app: (6,) wrench of the arm on the environment [N, N m], at the tool in world axes, in place of press. It
            must lie in the range of A^T.

    Returns:
        A sample where motion and press are one, else a trajectory.

    Raises:
        UsageError: No motion; more than one of press, lam, F_app.
        RangeError: A negative press, numbers that are not finite.
        ShapeError: Another size.

    Example:
        >>> import taut
        >>> pose = taut.Pose([0.4, 0.0, 0.1])
        >>> pressing(taut.TaskMotion(pose=pose), 10.0).press.item()
        10.0
    """
    taken = motion.sample if isinstance(motion, Hold) else motion
    if isinstance(taken, (HybridMotion, Pressing)):
        raise UsageError(
            "pressing takes a motion alone, and this one has forces already; give it once", name="motion"
        )
    if not isinstance(taken, (Sample, Trajectory)):
        raise UsageError(
            "pressing takes a motion such as taut.TaskMotion(pose=...) or taut.trajectories.Line(...); got "
            + ("a hold without its sample" if isinstance(motion, Hold) else type(motion).__name__),
            name="motion",
        )
    given = [
        name
        for name, some in (("press", press != 0.0), ("lam", lam is not None), ("F_app", F_app is not None))
        if some
    ]
    if len(given) > 1:
        raise UsageError(f"pressing takes one of press, lam and F_app; got {' and '.join(given)}", name=given[1])
    full, count = np.zeros(MOST_ROWS), 0
    if lam is not None:
        rows = finite_array("lam", lam, unit="N, N m")
        if rows.ndim != 1 or not 1 <= len(rows) <= MOST_ROWS:
            raise ShapeError(
                f"lam must be (k,), one for each row of the constraint; got shape {rows.shape}", name="lam"
            )
        full[: len(rows)], count = rows, len(rows)
    wrench = np.zeros(6) if F_app is None else vector("F_app", F_app, 6, unit="N, N m")
    force = press if callable(press) else _checked_press(press)
    if isinstance(taken, Sample) and not callable(force):
        kind = hybrid_kind(type(taken))
        return kind(taken, read_only([force]), read_only(full), read_only(wrench), read_only([float(count)]))
    return Pressing(taken, force, read_only(full), read_only(wrench), read_only([float(count)]))


def _checked_press(value: object, t: float | None = None) -> float:
    force = finite_scalar("press", value, unit="N")
    if force < 0.0:
        when = "" if t is None else f" at t = {t:g} s"
        raise RangeError(
            f"press must be >= 0 [N], the force into the surface; got {force:g}{when}; a contact cannot pull, and "
            "for a constraint that holds both ways give lam=",
            name="press",
            value=force,
            rule=">= 0",
        )
    return force
