"""Phase: one step of a task: a law, what it follows, and the guards that end it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, Final, Protocol, TypeAlias, runtime_checkable

import numpy as np

from taut.base.checks import finite_array, finite_scalar, one_of, positive_scalar, unit_vector, whole_number
from taut.base.errors import RangeError, ShapeError, UsageError, unknown_name
from taut.base.types import ArrayLike
from taut.control.combine import all_laws
from taut.control.law import Law
from taut.control.trajectories.reference import JointMotion, Reference, as_reference
from taut.control.trajectories.task_reference import FRAMES, Axes, TaskMotion
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotation_log
from taut.trace import math as tm
from taut.trace.array import has_symbols
from taut.trace.pose import Pose
from taut.trace.scalar import Condition

STOP: Final = "stop"
CONTACT: Final = 1.0  # [N] a force that counts as contact, for laws that never start without
# of the memory of a task
OWN_WORDS: Final = (STOP, "phase", "next", "ticks", "ended", "begin", "lasted", "energy", "seen")
PhaseReference: TypeAlias = Reference | Callable[[Snapshot], Reference] | None


class GuardView:
    """The arm and the phase at one instant, for a guard: all quantities of the snapshot, and five of the phase.

    Args:
        x: The snapshot.
        elapsed: Time since the phase began [s].
        ref: The sample that the law of the phase follows.
        begin: The arm where it was when the phase began, at rest.
        tool: The frame that the law of the phase controls; None for the arm's tool.
        energy: A function that gives x.energy, accounted for where it is called.
    """

    __slots__ = ("_energy", "_x", "begin", "elapsed", "ref", "tool")

    def __init__(
        self, x: Snapshot, *, elapsed: Any, ref: Any, begin: Snapshot, tool: str | None, energy: Callable[[], Any]
    ) -> None:
        self._x = x
        self._energy = energy
        self.elapsed = elapsed
        self.ref = ref
        self.begin = begin
        self.tool = tool

    @property
    def energy(self) -> Any:
        """Work of the controller's torque since the phase began, less what lifted the arm's weight [J]."""
        return self._energy()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if not hasattr(Snapshot, name):
            known = [word for word in (*dir(Snapshot), *self.__slots__) if not word.startswith("_")]
            raise AttributeError(str(unknown_name("the snapshot x", "quantity", name, known)), name=name, obj=None)
        return getattr(self._x, name)


Seen: TypeAlias = Snapshot | GuardView
"""Argument of the functions below; where contact is checked no phase has begun yet, so it is a plain snapshot."""


def contact(x: Seen, force: float, direction: ArrayLike | None = None, frame: Axes = "world") -> Any:
    """Guard: whether the contact force at the tool exceeds a threshold.

    Args:
        x: The snapshot of a guard; it must have F_ext.
        force: [N].
        direction: (3,) of any length: only the force on the arm in this direction counts; its size if left out.
        frame: The axes of the direction.

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
    along = unit_vector("direction", direction)
    axes = along if frame == "world" else x.T().R @ along
    return axes @ F > force


def no_contact(x: Seen, force: float, direction: ArrayLike | None = None, frame: Axes = "world") -> Any:
    """Guard: whether the contact force at the tool is below a threshold [N]; the opposite of `contact`."""
    return ~contact(x, force, direction, frame)


def collision(x: Seen, threshold: ArrayLike) -> Any:
    """Guard: whether the estimated external torque of a joint exceeds its threshold.

    Args:
        x: The snapshot of a guard; its sensing has an observer.
        threshold: Scalar or (n,) [N m | N]: above what a wrong model alone makes of the motion, as of
            `taut.analysis.collision_threshold(run)`.

    Example:
        >>> import taut
        >>> law = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
        >>> go = taut.Phase(law, unless=lambda x: collision(x, [2.0, 1.0]), otherwise="float")
        >>> task = [go, taut.Phase(taut.laws.GravityCompensation(), name="float")]
    """
    bound = finite_array("threshold", threshold, unit="N m | N")
    if bound.shape not in ((), (x.n,)) or np.any(bound <= 0.0):
        raise RangeError(
            f"threshold must be one number or {x.n}, > 0 [N m | N]; got {bound.tolist()}; make it by "
            "taut.analysis.collision_threshold(run)",
            name="threshold",
        )
    return reduce(tm.maximum, tm.abs(x.tau_ext) - bound) > 0.0


def energy(x: GuardView, bound: float) -> Any:
    """Guard: whether the controller has given more energy than a bound to the arm and to what the arm touches.

    Law:          x.energy = sum tau[k] (q[k+1] - q[k]) - (U(q) - U(q_begin)) > bound, with U of the weights: exact
                  for a torque that is held, after limits, whatever the velocity does within a tick

    A law of springs and dampers about a reference at rest never gives more than the springs stored when the phase
    began, where damping makes up for the hold. What a moving reference asks for is given as well. The torque is the
    commanded one at the measured positions: energy that drives and sensors add by their delay is not seen.

    Args:
        x: The snapshot of a guard, in a task of torques.
        bound: [J], such as the largest x.energy of a run without trouble, which a task with this guard records as
            `run.extra["energy"]`.

    Example:
        >>> import taut
        >>> law = taut.laws.GravityPID(kp=10.0, kd=1.0)
        >>> task = [taut.Phase(law, unless=lambda x: energy(x, 2.0))]

    References:
        Hannaford and Ryu, Time-domain passivity control of haptic interfaces, IEEE Transactions on Robotics and
        Automation 18 (2002): the passivity observer.
    """
    return x.energy > finite_scalar("bound", bound, unit="J", minimum=0.0)


def reached(
    x: Seen,
    target: Pose | TaskMotion | JointMotion,
    *,
    q: float | None = None,
    position: float | None = None,
    rotation: float | None = None,
    tool: str | None = None,
) -> Any:
    """Guard: whether the arm has reached a target.

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
    wanted: Any = getattr(target, "motion", target)  # of a sample of motion and force
    if not isinstance(wanted, (Pose, TaskMotion, JointMotion)):
        raise UsageError(
            f"a guard compares with a taut.Pose, TaskMotion or JointMotion; got {type(target).__name__}",
            name="target",
        )
    fitting = {"q"} if isinstance(wanted, JointMotion) else {"position", "rotation"}
    if not given or not given.keys() <= fitting:
        raise UsageError(
            f"a {type(wanted).__name__} is reached within {' or '.join(f'{name}=' for name in sorted(fitting))}; got "
            f"{', '.join(f'{name}=' for name in given) or 'none of them'}",
            name="target",
        )
    if isinstance(wanted, JointMotion):
        off = tm.abs(x.difference(wanted.q))
        return reduce(tm.maximum, off) <= given["q"]
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
    """Guard: whether the arm has reached its reference and, with `v`, is nearly at rest.

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
    return (reduce(tm.maximum, tm.abs(x.v)) <= finite_scalar("v", v, unit="rad/s | m/s")) & near


def moved(x: GuardView, distance: float, tool: str | None = None) -> Any:
    """Guard: whether the origin of the tool, or of another frame, is a distance [m] from where the phase began."""
    distance = finite_scalar("distance", distance, unit="m", minimum=0.0)
    frame = x.tool if tool is None else tool
    return tm.norm(x.T(frame).p - x.begin.T(frame).p) >= distance


@dataclass(frozen=True, kw_only=True, eq=False)
class Lasting:
    """A guard that has to hold for several consecutive ticks. Made by `taut.guards.lasting`."""

    guard: Callable[[Any], Any]
    ticks: int

    def __call__(self, x: Seen) -> Any:
        """The condition in one tick alone."""
        return self.guard(x)


Guard: TypeAlias = Callable[[Any], Any] | Lasting


def lasting(guard: Callable[[Any], Any], *, ticks: int) -> Lasting:
    """A guard that has to hold in consecutive ticks, so that a spike of a sensor does not end a phase.

    Args:
        guard: A function of the snapshot.
        ticks: Their number, from 1 on; the count begins anew with each phase.

    Raises:
        UsageError, RangeError: Not a function, or one that counts itself; a wrong number of ticks.

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
    """The result of a guard as one condition; UsageError or ShapeError, which name `who`, where it is not."""
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


@runtime_checkable
class KnowsContact(Protocol):
    """A law that can determine whether the arm is in contact."""

    def touches(self, x: Snapshot) -> Any:
        """Whether the arm is in contact, as a condition."""
        ...

    def contact_state(self, x: Snapshot) -> str:
        """Distance, force and their limits, in words."""
        ...


@dataclass(frozen=True, eq=False)
class Phase:
    """One phase of a task: a law, what it follows, and when it ends. A task is a list of them.

    A law starts in the tick in which its phase begins, with its integrators at zero and its memory afresh, also where
    a phase is entered again. Guards are evaluated in each tick, on its measurements; what they decide acts from the
    next tick on. Where several hold, `unless` comes before `until`, and both before `timeout`.

    A guard is a function of the snapshot that gives one condition: `lambda x: taut.guards.contact(x, 2.0)`. Besides
    what a law sees it may ask for `x.elapsed`, the time in the phase [s], `x.ref`, the sample that its law follows,
    and `x.begin`, the arm where the phase began. It is traced like a law: combine conditions with & | ~.

    A law that controls forces never starts without contact: where there is none when its phase begins, the arm is
    held for that tick and the task goes on as `otherwise` says.

    Args:
        law: What controls the arm.
        reference: A sample, hold, trajectory, stream or chunk, whose time counts from the begin of the phase; or a
            function of the snapshot at its begin that gives one: `lambda x: taut.trajectories.Line(T0=x.T(), ...)`. A
            hold of the state at the begin if left out.
        until: Guard that ends the phase successfully.
        unless: Guard that detects a fault.
        timeout: Longest time in the phase [s].
        otherwise: What follows `unless` and `timeout`: "stop", or the name or number of a phase.
        then: What follows `until`: the next phase, after the last one "stop", if left out.
        name: Its name, as in the path of a gain: law.approach.kp; phase1, phase2, ... if left out.
        contact: Threshold of contact for a law that needs it: a force [N], or a guard; 1.0 N if left out, and for
            a law that knows its surface, such as HybridMotionForce, to be on it.

    Raises:
        UsageError: Not a law, a reference that is none, a guard that is no function.
        RangeError: A timeout or a force that is not above zero.

    Example:
        >>> import taut
        >>> law = taut.laws.TaskComputedTorque(kp=100.0, kd=20.0)
        >>> down = lambda x: taut.trajectories.Steady(T0=x.T(), velocity=[0.0, 0.0, -0.02])
        >>> Phase(law, down, name="approach", until=lambda x: taut.guards.contact(x, 2.0), timeout=5.0).name
        'approach'
    """

    law: Law
    reference: PhaseReference = None
    until: Guard | None = None
    unless: Guard | None = None
    timeout: float | None = None  # [s]
    otherwise: str | int = STOP
    then: str | int | None = None
    name: str | None = None
    contact: float | Guard | None = None  # [N]

    def __post_init__(self) -> None:
        if not isinstance(self.law, Law):
            raise UsageError(f"a phase takes a law such as taut.laws.PID(kp=...); got {self.law!r}", name="law")
        word = self.name is None or (isinstance(self.name, str) and self.name.isidentifier())
        if not word or self.name in OWN_WORDS:
            raise UsageError(
                f"the name of a phase must be a word of letters, digits and _, as it stands in the paths of gains, "
                f"and none of {', '.join(OWN_WORDS)}; got {self.name!r}",
                name="name",
            )
        for guard in ("until", "unless"):
            value = getattr(self, guard)
            if value is not None and not callable(value):
                raise UsageError(
                    f"{guard} must be a function of the snapshot, such as lambda x: taut.guards.contact(x, 2.0); got "
                    f"{value!r}",
                    name=guard,
                )
        if self.timeout is not None:
            object.__setattr__(self, "timeout", positive_scalar("timeout", self.timeout, unit="s"))
        if isinstance(self.contact, Lasting):
            raise UsageError(
                "one tick decides on contact, so lasting(...) is no use; give the guard in it", name="contact"
            )
        if self.contact is not None and not callable(self.contact):
            positive_scalar("contact", self.contact, unit="N")
        if self.reference is not None and not callable(self.reference):
            as_reference(self.reference)

    @property
    def needs_contact(self) -> bool:
        """Whether its law, or one that it holds, never starts without contact."""
        return any(law.needs_contact for _, law in all_laws(self.law))

    def in_contact(self, x: Snapshot) -> Any:
        """Whether there is contact, as a condition."""
        if callable(self.contact):
            return self.contact(x)
        holds: list[Any] = [law.touches(x) for _, law in all_laws(self.law) if isinstance(law, KnowsContact)]
        force = self.contact if self.contact is not None else None if holds else CONTACT
        if force is not None:
            holds.append(contact(x, force))
        return reduce(lambda a, b: a & b, holds)

    def contact_state(self, x: Snapshot) -> str:
        """Why there is no contact, in words with numbers; empty for a user's guard."""
        if callable(self.contact):
            return ""
        said = [law.contact_state(x) for _, law in all_laws(self.law) if isinstance(law, KnowsContact)]
        if self.contact is not None or not said:
            force = CONTACT if self.contact is None else self.contact
            said.append(f"{np.linalg.norm(x.F_ext[:3]):.3g} N measured, and contact is {force:g} N or more")
        return ", ".join(said)


def named_phases(task: Sequence[Phase]) -> dict[str, Phase]:
    """The phases of a task by name."""
    if not task:
        raise UsageError("a task needs one phase at least; got an empty list", name="task")
    named: dict[str, Phase] = {}
    for i, phase in enumerate(task):
        if not isinstance(phase, Phase):
            raise UsageError(f"a task is a list of taut.Phase; entry {i} is a {type(phase).__name__}", name="task")
        name = phase.name or f"phase{i + 1}"
        if name in named:
            raise UsageError(f"two phases of a task are called '{name}'; give one another name=", name="name")
        named[name] = phase
    for name, phase in named.items():
        for word, target in (("otherwise", phase.otherwise), ("then", phase.then)):
            known = (STOP, *named, *range(len(named)), *((None,) if word == "then" else ()))
            if isinstance(target, bool) or target not in known:
                raise unknown_name(f"phase '{name}': {word}: the task", "phase", str(target), [*named, STOP])
    return named
