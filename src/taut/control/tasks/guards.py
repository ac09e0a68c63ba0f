"""Guards: when a phase of a task ends. Pure functions of the snapshot that give one condition."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from taut.base.checks import finite_scalar, one_of, vector, whole_number
from taut.base.errors import RangeError, ShapeError, UsageError, unknown_name
from taut.base.types import ArrayLike
from taut.control.trajectories.reference import JointMotion
from taut.control.trajectories.task_reference import FRAMES, Axes, TaskMotion
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotation_log
from taut.trace import math as tm
from taut.trace.array import has_symbols
from taut.trace.pose import Pose
from taut.trace.scalar import Condition

__all__ = [
    "Guard",
    "GuardView",
    "Lasting",
    "condition",
    "contact",
    "lasting",
    "moved",
    "no_contact",
    "reached",
    "settled",
]


class GuardView:
    """The arm and the phase at one instant, for a guard: all quantities of the snapshot, and four of the phase.

    Args:
        x: The snapshot.
        elapsed: Time since the phase began [s].
        ref: The sample that the law of the phase follows.
        begin: The arm where it was when the phase began, at rest.
        tool: The frame that the law of the phase controls; None for the arm's tool.
    """

    __slots__ = ("_x", "begin", "elapsed", "ref", "tool")

    def __init__(self, x: Snapshot, *, elapsed: Any, ref: Any, begin: Snapshot, tool: str | None) -> None:
        self._x = x
        self.elapsed = elapsed
        self.ref = ref
        self.begin = begin
        self.tool = tool

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if not hasattr(Snapshot, name):
            known = [word for word in (*dir(Snapshot), *self.__slots__) if not word.startswith("_")]
            raise AttributeError(str(unknown_name("the snapshot x", "quantity", name, known)), name=name, obj=None)
        return getattr(self._x, name)


Seen: TypeAlias = Snapshot | GuardView
"""What the functions below take: where contact is needed a phase has not begun yet, and there is a snapshot alone."""


def contact(x: Seen, force: float, direction: ArrayLike | None = None, frame: Axes = "world") -> Any:
    """Guard: whether something touches the tool with more than a force.

    Args:
        x: The snapshot of a guard; it must have F_ext.
        force: [N].
        direction: (3,) where the force on the arm must point, of any length: its part in this direction counts. The
            whole force, whatever its direction, if left out.
        frame: The axes of the direction.

    Returns:
        A condition.

    Example:
        >>> import taut
        >>> law = taut.laws.GravityPID(kp=10.0, kd=1.0)
        >>> task = [taut.Phase(law, until=lambda x: contact(x, 2.0, direction=[0, 0, 1]), timeout=1.0)]
    """
    force = finite_scalar("force", force, unit="N", minimum=0.0)
    one_of("frame", frame, FRAMES)
    F = x.F_ext[:3]
    if direction is None:
        return tm.norm(F) > force
    along = vector("direction", direction, 3)
    length = float(np.linalg.norm(along))
    if length == 0.0:
        raise RangeError("direction must have a length; got zeros", name="direction", rule="not zero")
    axes = along / length if frame == "world" else x.T().R @ (along / length)
    return axes @ F > force


def no_contact(x: Seen, force: float, direction: ArrayLike | None = None, frame: Axes = "world") -> Any:
    """Guard: whether nothing touches the tool with more than a force; the opposite of `contact`.

    Args:
        x: The snapshot of a guard, with F_ext.
        force: The force [N].
        direction: (3,) as of `contact`.
        frame: The axes of the direction.
    """
    return ~contact(x, force, direction, frame)


def reached(
    x: Seen,
    target: Pose | TaskMotion | JointMotion,
    *,
    q: float | None = None,
    position: float | None = None,
    rotation: float | None = None,
    tool: str | None = None,
) -> Any:
    """Guard: whether the arm is where it is to be.

    Args:
        x: The snapshot.
        target: A pose or a task motion, for which `position`, `rotation` or both are given; a joint motion, for `q`.
        q: Largest error of any joint [rad | m].
        position: Largest distance from the target [m].
        rotation: Largest angle to it [rad].
        tool: The frame that is compared; that of the phase's law if left out.

    Raises:
        UsageError: No tolerance, or one that the target has no meaning for.
    """
    tolerances = {"q": q, "position": position, "rotation": rotation}
    given = {name: finite_scalar(name, value, minimum=0.0) for name, value in tolerances.items() if value is not None}
    wanted, fitting = _wanted(target)
    if not given or not given.keys() <= fitting:
        raise UsageError(
            f"a {type(wanted).__name__} is reached within {' or '.join(f'{name}=' for name in sorted(fitting))}; got "
            f"{', '.join(f'{name}=' for name in given) or 'none of them'}",
            name="target",
        )
    if isinstance(wanted, JointMotion):
        off = tm.abs(x.difference(wanted.q))
        return _largest(off) <= given["q"]
    T = x.T(x.tool if tool is None and isinstance(x, GuardView) else tool)
    near: Any = np.bool_(True)
    if "position" in given:
        near = (tm.norm(wanted.p - T.p) <= given["position"]) & near
    if "rotation" in given:
        near = (tm.norm(rotation_log(T.R.T @ wanted.R)) <= given["rotation"]) & near
    return near


def settled(
    x: GuardView,
    *,
    q: float | None = None,
    position: float | None = None,
    rotation: float | None = None,
    v: float | None = None,
) -> Any:
    """Guard: whether the arm is where its reference is, and, with `v`, all but at rest.

    Args:
        x: The snapshot of a guard, in a phase whose law follows a motion.
        q: Largest error of any joint, for a law of joint motion [rad | m].
        position: Largest distance of the tool, for one of task motion [m].
        rotation: Largest angle of the tool [rad].
        v: Largest speed of any joint [rad/s | m/s].

    Raises:
        UsageError: No tolerance, or one that the reference has no meaning for.
    """
    near = reached(x, x.ref, q=q, position=position, rotation=rotation)
    if v is None:
        return near
    return (_largest(tm.abs(x.v)) <= finite_scalar("v", v, unit="rad/s | m/s")) & near


def moved(x: GuardView, distance: float, tool: str | None = None) -> Any:
    """Guard: whether the tool's origin is at least a distance away from where it was when the phase began.

    Args:
        x: The snapshot of a guard.
        distance: [m].
        tool: The frame; that of the phase's law if left out.
    """
    distance = finite_scalar("distance", distance, unit="m", minimum=0.0)
    frame = x.tool if tool is None else tool
    return tm.norm(x.T(frame).p - x.begin.T(frame).p) >= distance


def _wanted(target: Any) -> tuple[Any, set[str]]:
    """Where a target is, and which tolerances have a meaning there."""
    wanted = getattr(target, "motion", target)  # of a sample of motion and force
    if isinstance(wanted, JointMotion):
        return wanted, {"q"}
    if isinstance(wanted, (Pose, TaskMotion)):
        return wanted, {"position", "rotation"}
    raise UsageError(
        f"a guard can tell whether a taut.Pose, TaskMotion or JointMotion is reached; got {type(target).__name__}",
        name="target",
    )


def _largest(values: Any) -> Any:
    out = values[0]
    for i in range(1, len(values)):
        out = tm.maximum(out, values[i])
    return out


# -------------------------------------------------------------------- guards that count


@dataclass(frozen=True, kw_only=True, eq=False)
class Lasting:
    """A guard that has to hold for some ticks on end. Made by `taut.guards.lasting`."""

    guard: Callable[[Any], Any]
    ticks: int

    def __call__(self, x: Seen) -> Any:
        """The condition in one tick alone."""
        return self.guard(x)


Guard: TypeAlias = Callable[[Any], Any] | Lasting


def lasting(guard: Callable[[Any], Any], *, ticks: int) -> Lasting:
    """A guard that has to hold in some ticks on end, so that a spike of a sensor does not end a phase.

    Args:
        guard: A function of the snapshot.
        ticks: How many; the count begins anew with each phase.

    Raises:
        UsageError: Not a function, or one that counts itself.
        RangeError: A number of ticks that is no whole number from 1 on.

    Example:
        >>> touch = lasting(lambda x: contact(x, 2.0), ticks=5)
        >>> touch.ticks
        5
    """
    if not callable(guard) or isinstance(guard, Lasting):
        raise UsageError(
            f"lasting takes a guard, such as lambda x: taut.guards.contact(x, 2.0); got {guard!r}", name="guard"
        )
    return Lasting(guard=guard, ticks=whole_number("ticks", ticks, minimum=1))


def condition(result: Any, who: str) -> Any:
    """What a guard gave, as one condition.

    Args:
        result: What it gave.
        who: What it is, for messages.

    Raises:
        UsageError: It is no condition.
        ShapeError: It is more than one.
    """
    if isinstance(result, (bool, np.bool_)):
        return np.bool_(result)
    if isinstance(result, Condition):
        return result
    if isinstance(result, np.ndarray) and (result.dtype == bool or has_symbols(result)):
        if result.ndim:
            raise ShapeError(
                f"{who} must give one condition; got an array of shape {result.shape}; combine them with & or |, or "
                "compare taut.math.norm(...)",
                name="guard",
            )
        return condition(result[()], who)
    shown = "None; did it forget its return?" if result is None else f"{type(result).__name__}"
    if isinstance(result, Lasting):
        shown = "taut.guards.lasting(...), which stands around the whole guard"
    raise UsageError(f"{who} must give a condition, such as x.F_ext[2] > 2.0; got {shown}", name="guard")
