"""References of a scenario: [reference], and [[phases]], each with its law, its reference and its guards."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

import taut
from taut.arm.description import Arm
from taut.arm.parts import require_radians
from taut.base.checks import finite_array, finite_scalar
from taut.base.errors import TautError, quoted_list
from taut.base.fields import Declared, Field, Part, Whole
from taut.base.types import Array, ArrayLike, Float64Array
from taut.control.law import Law
from taut.control.tasks.phase import (
    Guard,
    GuardView,
    Phase,
    PhaseReference,
    collision,
    contact,
    lasting,
    moved,
    no_contact,
    settled,
)
from taut.control.tasks.task import Task
from taut.control.trajectories.force_reference import TaskForce, hybrid_kind, pressing
from taut.control.trajectories.reference import Hold, JointMotion, Reference, Stream
from taut.control.trajectories.samples import Chunk
from taut.control.trajectories.task_reference import Axes, TaskMotion
from taut.maths.snapshot import Snapshot, snapshot
from taut.maths.spatial import rotation_exp
from taut.scenarios.reading import Table, arguments, read
from taut.scenarios.sections import read_law
from taut.trace.pose import Pose
from taut.trajectories import (
    Circle,
    Cubic,
    JerkLimited,
    Line,
    Quintic,
    Samples,
    Septic,
    Sine,
    Spline,
    Steady,
    TaskSamples,
    Transition,
    Trapezoidal,
)

POSITIONS: Final = ("q", "q0", "q1", "center", "points")  # of the joints, which may be "home"
POSE_KEYS: Final = ("pose", "T0", "T1", "T")  # of the tool, which may be "home"
TOOL_POINTS: Final = ("centre",)  # of the tool
ROTATIONS: Final = ("xyzw", "wxyz", "rpy", "R")
FORCES: Final = ("press", "lam", "F_app")  # that a motion applies, as of taut.pressing
HYBRID_MOTION: Final = hybrid_kind(TaskMotion)


def _hold() -> Hold:
    return Hold()


def _force_samples(*, times: ArrayLike, F_app: ArrayLike, frame: Axes = "world") -> Chunk:
    """Wrenches at stated times with straight lines in between."""
    rows = finite_array("F_app", F_app, shape=(np.size(np.asarray(times, dtype=object)), 6))
    return taut.chunk(times, [TaskForce(F_app=row, frame=frame) for row in rows])


def _displaced(T0: Pose, *, p: ArrayLike, duration: float | None = None) -> TaskMotion | Line:
    """A displacement from where a phase begins: in a straight line within a duration, or at once."""
    T1 = Pose(T0.p + Pose(p).p, R=T0.R)
    return TaskMotion(pose=T1) if duration is None else Line(T0=T0, T1=T1, duration=duration)


TONES: Final = 3
NOISE_BAND: Final = (0.1, 0.5)  # [Hz]
ONSET: Final = 0.7  # [s] in which the motion sets in


class SamplePolicy(Declared):
    """A stand-in for a learned policy: each period a chunk of poses along a smooth random path, no two alike."""

    T: Part[Pose] = Part(Pose)  # the pose that it moves about
    period: Field = Field(0.1, unit="s", above=0.0)
    ahead: Whole = Whole(4, minimum=1)  # how many periods a chunk reaches
    size: Field = Field((0.08, 0.2), unit="m, rad", shape=2, minimum=0.0)  # RMS of the path in each direction
    disagreement: Field = Field(
        (0.003, 0.01),
        unit="m, rad",
        shape=2,
        minimum=0.0,  # standard deviation of a chunk, in each direction
    )
    seed: Whole = Whole(0)  # of path and disagreement

    def __call__(self, x: Snapshot) -> Chunk:
        """The chunk of the period in which the snapshot is taken."""
        number = round(float(x.t) / self.period)
        noise = np.random.default_rng([self.seed, 1 + number]).standard_normal(6)
        offset = noise * np.repeat(self.disagreement, 3) if number else np.zeros(6)  # it starts where the tool is
        times = self.period * np.arange(self.ahead + 1, dtype=np.float64)
        return taut.chunk(times, [self._pose(row) for row in self._path(number * self.period + times) + offset])

    def _path(self, t: Float64Array) -> Float64Array:
        """(k, 6) offsets from T, from rest at t = 0 on [m, rad]."""
        rng = np.random.default_rng([self.seed, 0])
        f, phase = rng.uniform(*NOISE_BAND, (TONES, 6)), rng.uniform(0.0, 2.0 * np.pi, (TONES, 6))
        waves = np.sin(2.0 * np.pi * f * t[:, np.newaxis, np.newaxis] + phase).sum(axis=1) * np.sqrt(2.0 / TONES)
        onset: Float64Array = -np.expm1(-((t / ONSET) ** 2))
        path: Float64Array = onset[:, np.newaxis] * waves * np.repeat(self.size, 3)
        return path

    def _pose(self, offset: Float64Array) -> Pose:
        R: Array = rotation_exp(offset[3:]) @ self.T.R
        return Pose(self.T.p + offset[:3], R=R)


FORCE_KINDS: Final[Mapping[str, Callable[..., Any]]] = {"force": TaskForce, "force-samples": _force_samples}
KINDS: Final[Mapping[str, Callable[..., Any]]] = {
    "hold": _hold,
    "set-point": JointMotion,
    "cubic": Cubic,
    "quintic": Quintic,
    "septic": Septic,
    "trapezoidal": Trapezoidal,
    "jerk-limited": JerkLimited,
    "sine": Sine,
    "spline": Spline,
    "samples": Samples,
    "pose": TaskMotion,
    "line": Line,
    "circle": Circle,
    "task-samples": TaskSamples,
    "policy": SamplePolicy,
    **FORCE_KINDS,
}
FROM_BEGIN: Final[Mapping[str, Callable[..., Any]]] = {"steady": Steady, "by": _displaced}
"""Motions of the tool from where a phase begins."""
TRANSITION: Final = "transition"
GOALS: Final[Mapping[type, str]] = {JointMotion: "set-point", TaskMotion: "pose"}
"""The kind of the goal of a transition, by what its law follows."""


def read_reference(table: Table, arm: Arm, home: Float64Array, laws: Mapping[str, Law]) -> Reference:
    """[reference]: a hold, a set-point or a trajectory of joints, tool or force; `home` (n,) is its "home"."""
    if not table.values:
        return Hold()
    table.need("kind")
    if table.get("kind") in (TRANSITION, *FROM_BEGIN):
        raise table.error(f"'{table.get('kind')}' begins where a phase begins; put it into one of [[phases]]", "kind")
    word = table.choice("kind", KINDS)
    kind = KINDS[word]
    forces = {} if word in FORCE_KINDS else _forces(table)
    motion: Any
    own, start = table.without(*forces), _Home(table, arm, home, laws)
    others = ["kind", *(["relative_to_home"] if arguments(kind).keys() & _OF_HOME.keys() else [])]
    if "file" in table and kind in (Samples, TaskSamples):
        path = table.file_of("file", "CSV file")
        motion = start.moved(read(kind.from_csv, own, others=["file", *others], blame="file", path=path))
    else:
        made = start.made(kind)
        policy = ["blend"] if kind is SamplePolicy else []
        motion = read(kind, own, others=[*others, *made, *policy], blame="kind", **made)
        if isinstance(motion, SamplePolicy):
            with table.blamed():
                motion = Stream(period=float(motion.period), source=motion, blend=table.get("blend"))
    start.check(motion)
    with table.blamed("press"):
        return pressing(motion, **forces) if forces else motion


def _forces(table: Table) -> dict[str, Any]:
    """The forces that a motion applies: press, lam or F_app; empty if none is stated."""
    return {name: table.get(name) for name in FORCES if name in table}


class _Home:
    """Positions, poses and points of a [reference], which may be "home" or relative to it.

    Of a relative pose p is added to the position at home, and the rotation is by the world's axes, about the tool.
    """

    def __init__(self, table: Table, arm: Arm, q: Float64Array, laws: Mapping[str, Law]) -> None:
        self.table, self.arm, self.q, self.laws = table, arm, q, laws
        self.relative = table.get("relative_to_home", False)
        if not isinstance(self.relative, bool):
            raise table.error(f"must be true or false; got {self.relative!r}", "relative_to_home")

    @property
    def T(self) -> Pose:
        """The pose at home of the frame that all laws control."""
        frames = {law.controlled_frame for law in self.laws.values()}
        if len(frames) > 1:
            named = sorted(frame or "the arm's tool" for frame in frames)
            raise self.table.error(
                f"is for laws that control one frame, and these control {' and '.join(named)}; give them the same "
                "tool, or put them in scenarios of their own"
            )
        return snapshot(self.arm, self.q).T(next(iter(frames), None))

    def made(self, kind: Callable[..., Any]) -> dict[str, Any]:
        """The positions, poses and points that are written, in the world; T0 and T are at home if left out."""
        known = arguments(kind)
        out = {name: reader(self, name) for name, reader in _OF_HOME.items() if name in known and name in self.table}
        return out | {name: self.T for name in ("T0", "T") if name in known and name not in out}

    def _position(self, key: str) -> Any:
        written = self.table.get(key)
        if written == "home":
            return self.q
        with self.table.blamed(key):
            numbers = finite_array(key, written, unit="rad | m")
        if numbers.ndim:
            self._check_size(key, numbers)
        return self.q + numbers if self.relative else written

    def _pose(self, key: str) -> Pose:
        return self.T if self.table.get(key) == "home" else self._placed(self.table.table(key))

    def _poses(self, key: str) -> list[Pose]:
        return [self._placed(each) for each in self.table.tables(key)]

    def _point(self, key: str) -> Any:
        written = self.table.get(key)
        if not self.relative:
            return written
        with self.table.blamed(key):
            return self.T.p + finite_array(key, written, shape=(3,), unit="m")

    def _placed(self, table: Table) -> Pose:
        if not self.relative:  # where a zero is a place, and the identity an orientation, that few arms can take
            table.need("p", "its position p")
            if not any(word in table for word in ROTATIONS):
                raise table.error(f"needs its orientation: one of {quoted_list(ROTATIONS)}")
        return self._in_world(read(Pose, table))

    def _in_world(self, pose: Pose) -> Pose:
        return Pose(self.T.p + pose.p, R=pose.R @ self.T.R) if self.relative else pose

    def moved(self, samples: Samples | TaskSamples) -> Samples | TaskSamples:
        with self.table.blamed("file"):
            if isinstance(samples, Samples):
                return dataclasses.replace(samples, q=self.q + samples.q) if self.relative else samples
            return dataclasses.replace(samples, poses=[self._in_world(pose) for pose in samples.poses])

    def check(self, motion: Any) -> None:
        """Positions are of this arm, and in radians."""
        for name in POSITIONS:
            if name in arguments(type(motion)):
                positions = np.asarray(getattr(motion, name))
                self._check_size(name, positions)
                with self.table.blamed("kind"):
                    require_radians(name, positions, self.arm)

    def _check_size(self, name: str, positions: Float64Array) -> None:
        count = positions.shape[-1] if positions.ndim else 1
        if count != self.arm.n:
            raise self.table.error(f"must have one entry for each of the {self.arm.n} joints; got {count}", name)


_OF_HOME: Final[Mapping[str, Callable[[_Home, str], Any]]] = {
    **dict.fromkeys(POSITIONS, _Home._position),
    **dict.fromkeys(POSE_KEYS, _Home._pose),
    **dict.fromkeys(TOOL_POINTS, _Home._point),
    "poses": _Home._poses,
}


TASK: Final = "task"  # what the law of a task is called in tables and in [[pass]]


def read_phases(root: Table, arm: Arm, home: Float64Array) -> Task:
    """The task of a scenario, with `home` (n,) as what "home" means in a reference [rad | m]."""
    phases = [_phase(table, arm, home) for table in root.tables("phases")]
    try:
        return Task.of(phases)
    except TautError as cause:
        raise root.error(f"[[phases]]: {cause}") from cause


def _phase(table: Table, arm: Arm, home: Float64Array) -> Phase:
    law = read_law(table.table("law", required=True))
    made: dict[str, Any] = {
        "law": law,
        "reference": _phase_reference(table.table("reference"), law, arm, home),
        **{word: _guard(table.table(word)) for word in ("until", "unless") if word in table},
    }
    phase: Phase = read(Phase, table, others=made, **made)
    return phase


def _phase_reference(table: Table, law: Law, arm: Arm, home: Float64Array) -> PhaseReference:
    """A reference as in [reference], or a motion of the tool from where the phase begins."""
    name = table.choice("kind", (*KINDS, *FROM_BEGIN, TRANSITION))
    if name == TRANSITION:
        return _transition(table, law, arm, home)
    kind = FROM_BEGIN.get(name)
    if kind is None:
        return read_reference(table, arm, home, {TASK: law}) if table.values else None
    forces = _forces(table)
    own = table.without(*forces)
    if law.reference is not HYBRID_MOTION and (forces or law.reference is not TaskMotion):
        raise table.error(
            f"is for a law of {'forces' if forces else 'the tool'}, and {type(law).__name__} follows a "
            f"{law.reference.described()}",
            next(iter(forces), "kind"),
        )

    def motion(T0: Pose) -> Reference:
        begun = read(kind, own, others=["kind"], T0=T0)
        with table.blamed():
            return pressing(begun, **forces) if law.reference is HYBRID_MOTION else begun

    motion(Pose(np.zeros(3)))  # tried at once, so that an error names its key
    return lambda x: motion(x.T(law.controlled_frame))


def _transition(table: Table, law: Law, arm: Arm, home: Float64Array) -> Callable[[Snapshot], Reference]:
    """To a set-point of joints or tool, from the state in which a phase begins, moving or at rest."""
    if law.reference not in GOALS:
        raise table.error(f"is for a law of motion; {type(law).__name__} follows {law.reference.described()}", "kind")
    timing = {name: table.get(name) for name in ("duration", "velocity", "acceleration") if name in table}
    own = table.without(*timing).merged({"kind": GOALS[law.reference]}, table.file)
    goal: Any = read_reference(own, arm, home, {TASK: law})
    joints, tool = law.reference is JointMotion, law.controlled_frame

    def motion(x: Snapshot) -> Reference:
        start = JointMotion(q=x.q, v=x.v) if joints else TaskMotion(pose=x.T(tool), twist=x.J(tool) @ x.v)
        with table.blamed(made="Transition"):
            return Transition(start=start, goal=goal, **timing)

    motion(snapshot(arm, home))  # tried at once, so that an error names its key
    return motion


CONDITIONS: Final[Mapping[str, Callable[[GuardView, Any, Mapping[str, Any]], Any]]] = {
    "collision": lambda x, threshold, axes: collision(x, threshold),  # noqa: ARG005
    "contact": lambda x, force, axes: contact(x, force, **axes),
    "no_contact": lambda x, force, axes: no_contact(x, force, **axes),
    "moved": lambda x, distance, axes: moved(x, distance),  # noqa: ARG005
    "elapsed": lambda x, duration, axes: x.elapsed >= finite_scalar("elapsed", duration, unit="s"),  # noqa: ARG005
    "settled": lambda x, tolerances, axes: settled(x, **tolerances),  # noqa: ARG005
}
AXES: Final = ("direction", "frame")  # of a contact


def _guard(table: Table) -> Guard:
    """One condition or several, all of which have to hold; `ticks` for how many ticks on end."""
    conditions = {word: value for word, value in table.values.items() if word in CONDITIONS}
    axes = {name: table.get(name) for name in AXES if name in table}
    table.only((*CONDITIONS, "ticks", *(AXES if conditions.keys() & {"contact", "no_contact"} else ())))
    table.table("settled").only(name for name in arguments(settled) if name != "x")
    if not conditions:
        raise table.error(f"needs a condition, such as {{ contact = 2.0 }}: one or more of {quoted_list(CONDITIONS)}")

    def guard(x: GuardView) -> Any:
        holds: Any = np.bool_(True)
        for word, value in conditions.items():
            holds = CONDITIONS[word](x, value, axes) & holds
        return holds

    with table.blamed():
        return lasting(guard, ticks=table.get("ticks")) if "ticks" in table else guard
