"""Simulation: run a controller against a plant and record what happens."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import whole_number
from taut.base.errors import RangeError, StabilityWarning, UsageError, warn
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.noise import MAX_SEED
from taut.control.combine import SideBySide
from taut.control.law import Law
from taut.control.lawside import LawSide
from taut.control.tasks.phase import Phase
from taut.control.tasks.task import Task
from taut.control.trajectories.reference import Hold, Reference, as_reference
from taut.controller import Controller, compile
from taut.linear.judgement import Judgement, judge_start
from taut.loop import AnyPlant, Loop, ModelPlant, check_fit, duration_of_ticks, require_no_reference, state_at_start
from taut.maths.constraints.rows import Surface
from taut.maths.model import Chain, PayloadValues
from taut.maths.snapshot import Snapshot
from taut.plant.contact import each_contact
from taut.plant.rigid import RigidPlant
from taut.record.info import Around, Change, PartInfo, RunInfo, Shape, Stability, Thing, numbers, versions
from taut.record.progress import Progress
from taut.record.run import Run
from taut.runtime.events import Event, Schedule, listed
from taut.runtime.host import PlantBase
from taut.runtime.ongoing import FusedRun, HostedRun
from taut.trace.pose import Pose

Plant: TypeAlias = ModelPlant | PlantBase


def run(
    ctrl: Controller | Loop | Sequence[Phase],
    plant: Plant | None = None,
    ref: object = None,
    *,
    duration: float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    seed: int = 0,
    events: Iterable[Event] | None = None,
    log: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
) -> Run:
    """Run a controller against a plant and record every tick.

    Model plants are fused with the controller into one native loop; engines are stepped tick by tick. A run that
    diverges, or in which the plant or a function of yours (a source, a trajectory, a guard, a law in plain Python)
    raises, ends with that outcome and keeps what came before.

    Args:
        ctrl: A controller from `taut.compile`, or a whole `taut.Loop` (then leave plant, ref and duration out); or a
            task, a list of `taut.Phase`, which is compiled for the plant's arm and what it adds, at 1000 Hz.
        plant: `taut.RigidPlant`, `taut.MujocoPlant`, ...
        ref: A sample, hold, trajectory, stream or chunk; a hold of the first state if left out. None for a task.
        duration: [s].
        q0: (n,) true positions at the start [rad | m]; the plant arm's home by default.
        v0: (n,) true velocities at the start [rad/s | m/s]; zero by default.
        seed: Seed of every random number in the run, below 2^64.
        events: Parameters that change at stated times: taut.Event(t=, set=).
        log: File (.mcap) that is written while the run goes on, at most 0.2 s behind. Where writing fails, such as on
            a full disk, the run goes on without it, and the outcome counts the missing ticks.
        progress: Show progress; by default on a terminal when the run takes a while.

    Returns:
        The record, with one row per control tick, both ends included.

    Warns:
        StabilityWarning: The sampled loop is unstable at the start pose; `run.info.stability` has the direction, the
            spectral radius, and the largest gain that is stable. On a real arm it is a RangeError.

    Raises:
        MatchError: Controller and plant do not fit.
        UsageError, ShapeError, RangeError: Something about the reference, the state or an event.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=2.205, kd=2.0), arm)
        >>> out = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.5]), duration=5.0)
        >>> out.outcome.ok, bool(abs(out.q[-1, 0] - 0.5) < 1e-3)
        (True, True)
    """
    made, target, reference, length = what_to_run(ctrl, plant, ref, duration)
    return simulated(
        made, target, reference, length, q0=q0, v0=v0, seed=seed, events=events, log=log, progress=progress
    )  # fmt: skip


def simulated(
    made: Controller | Loop,
    target: Plant,
    reference: Reference,
    length: float,  # [s]
    *,
    q0: ArrayLike | None,
    v0: ArrayLike | None,
    seed: int,
    events: Iterable[Event] | None = None,
    log: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
    judged: bool = True,
) -> Run:
    """The run of what `what_to_run` gives; a sweep leaves out the judgement of its start."""
    seed = whole_number("seed", seed, maximum=MAX_SEED)
    side, ticks = made.side, round(length * made.side.rate) + 1
    changes = listed(events or ())
    q, v = state_at_start(target.arm, q0, v0)
    law = side.law.bound(subtree(made.parameters, "law"))  # with the gains of this run
    parameters = _arrays({**target.parameters, **made.parameters})
    schedule = Schedule(side, target, parameters, changes, ticks)
    verdict = judge_start(made, target, q, schedule.at(0)) if judged else "not judged: a sample of a sweep"
    stability = _judged(verdict, target)
    going: FusedRun | HostedRun
    if isinstance(made, Loop):
        going = FusedRun(made, q, v, seed, schedule)
    else:
        assert isinstance(target, PlantBase)
        going = HostedRun(made, target, reference, ticks, q, v, seed, schedule)
    going.tape.unstable = stability.message if stability.stable is False else ""
    going.tape.info = info_of(
        side, law, target.name, target.arm, q, made.parameters,
        duration=length,
        seed=seed,
        events=tuple(
            Change(t=event.t, set=_arrays(event.set)) for event in sorted(changes, key=lambda event: event.t)
        ),
        parameters=parameters,
        stability=stability,
        around=around_info(target, q, length),
    )  # fmt: skip
    return _recorded(going, log, progress)


def info_of(
    side: LawSide, law: Law | Task, plant: str, arm: Arm, q: Float64Array, gains: Mapping[str, Any], **more: Any
) -> RunInfo:
    """What is known of a run of a law on a plant of that name with this arm, which starts at q; and more by name."""
    return RunInfo(
        rate=side.rate,
        law=repr(law),
        arm=side.arm.name,
        controller_arm=_undrawn(side.arm),
        plant_arm=_undrawn(arm),
        plant=plant,
        sensing=str(side.sensing),
        command_limits="none" if side.limits is None else str(side.limits),
        versions=versions(),
        limits=_limits(side.arm),
        **_of_tool(law, side, q, gains),
        **more,
    )


def _arrays(values: Mapping[str, ArrayLike]) -> dict[str, Float64Array]:
    return {path: np.array(value, dtype=np.float64) for path, value in values.items()}


def _undrawn(arm: Arm) -> Arm:
    """An arm without what is only drawn of it."""
    return dataclasses.replace(arm, visuals=(), source="", notes=())


def _limits(arm: Arm) -> dict[str, dict[str, float]]:
    """Effort and velocity limits by joint, of those that have one."""
    return {
        name: {
            joint: float(limit) for joint, limit in zip(arm.joint_names, values, strict=True) if np.isfinite(limit)
        }
        for name, values in (("effort", arm.effort), ("velocity", arm.velocity))
    }


def _of_tool(law: Law | Task, side: LawSide, q: Float64Array, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Tool and impedance of the law with the gains of the run, at the start; of each part or phase of it too."""
    payload = {name: np.array(value) for name, value in subtree(parameters, "model.payload").items()}
    x = Snapshot(side.model, q=q, v=np.zeros(len(q)), payload=PayloadValues.of(payload))
    whole = _part(law, x)
    out: dict[str, Any] = {"tool": whole.tool, "impedance": whole.impedance}
    if isinstance(law, SideBySide):
        seen = law.seen(x)
        out["parts"] = {
            name: dataclasses.replace(_part(part, seen[name]), joints=seen[name].arm.joint_names)
            for name, part in law.parts.items()
        }
    if isinstance(law, Task):
        out["phases"] = {
            name: dataclasses.replace(_part(law.laws[name], x), follows=law.follows(name)) for name in law.phases
        }
    return out


def _part(law: Law | Task, x: Snapshot) -> PartInfo:
    frame, impedance = law.controlled_frame, None
    if isinstance(law, Law) and frame in (None, x.arm.tool):  # F_ext is taken at the arm's tool
        impedance = law.apparent_impedance(x)
    return PartInfo(tool=Chain.of(x.model, frame), impedance=impedance)


def _judged(verdict: Judgement | str, plant: Plant) -> Stability:
    """The judgement at the start; an unstable loop is a warning, or a RangeError where the plant is a real arm."""
    if isinstance(verdict, str):
        return Stability(stable=None, message=verdict)
    if not verdict.stable:
        if isinstance(plant, PlantBase) and plant.real:
            raise RangeError(f"{verdict.message} (plant '{plant.name}' is a real arm: nothing was sent)", name="law")
        warn(verdict.message, StabilityWarning)
    return Stability(**{field.name: getattr(verdict, field.name) for field in dataclasses.fields(Stability)})


def _recorded(going: FusedRun | HostedRun, log: str | os.PathLike[str] | None, progress: bool | None) -> Run:
    """Run to the end, with a log file and a bar where they are asked for."""
    from taut.record.log.writing import open_log

    tape = going.tape
    with Progress(len(tape.inputs["t"]), progress) as bar:
        if log is None:
            kept, outcome = going.go(bar.advance, None)
            outcome = tape.explained(outcome)
        else:
            with open_log(log) as file:
                kept, outcome = going.go(bar.advance, file)
                outcome = file.finish(tape.explained(outcome))
    return tape.piece(0, kept, outcome)


def what_to_run(
    ctrl: Controller | Loop | Sequence[Phase], plant: Plant | None, ref: object, duration: float | None
) -> tuple[Controller | Loop, Plant, Reference, float]:
    """Controller or loop, plant, reference and duration [s] of what `run` is given; UsageError for anything else."""
    if isinstance(ctrl, Loop):
        if plant is not None or ref is not None or duration is not None:
            raise UsageError("a Loop has its plant, reference and duration already; pass run(loop) alone")
        return ctrl, ctrl.plant, ctrl.ref, ctrl.duration
    if not isinstance(ctrl, (Controller, list, tuple)):
        raise UsageError(
            "run takes a controller from taut.compile, a taut.Loop, or a list of taut.Phase; got "
            f"{type(ctrl).__name__}"
        )
    if not isinstance(plant, (ModelPlant, PlantBase)):
        raise UsageError(
            "run needs a plant: taut.run(ctrl, taut.RigidPlant(arm), ref, duration=5.0), or a taut.PlantBase; got "
            f"{'none' if plant is None else type(plant).__name__}",
            name="plant",
        )
    if duration is None:
        raise UsageError("run needs a duration in seconds: taut.run(..., duration=5.0)", name="duration")
    made = ctrl if isinstance(ctrl, Controller) else compile(ctrl, plant.arm, adds=plant.adds)
    if isinstance(plant, ModelPlant):
        loop = Loop(made, plant, ref, duration=duration)
        return loop, plant, loop.ref, loop.duration
    check_fit(made.side, plant)
    require_no_reference(made.side, ref)
    reference: Reference = Hold() if ref is None else as_reference(ref)
    return made, plant, reference, duration_of_ticks(duration, made.side.dt)


BOARD: Final = (0.2, 0.35, 0.3, 1.0)
HOLLOW: Final = (0.2, 0.35, 0.3, 0.35)  # what the tool is inside of lets it be seen
SURFACE_HALF_WIDTH: Final = 0.25  # [m] of a surface to each side of the tool
THICKNESS: Final = 0.005  # [m] half of what is drawn
PERIOD: Final = 0.02  # [s] between two places of a surface that moves


def around_info(plant: AnyPlant, q: Float64Array, duration: float) -> Around:
    """Objects around the arm, for films."""
    if isinstance(plant, PlantBase):
        return plant.around()
    return _of_model(plant, q, duration) if isinstance(plant, RigidPlant) else Around()


def _of_model(plant: RigidPlant, q: Float64Array, duration: float) -> Around:
    """The surfaces that contacts and walls declare."""
    things: list[Thing] = []
    missing: list[str] = []
    x = Snapshot(plant.model, q=q, v=np.zeros(len(q)))
    for contact in () if plant.contact is None else each_contact(plant.contact):
        for piece in contact.constraint.pieces:
            if piece.surface is not None:
                things.append(_thing(piece.surface, x.T(piece.frames[0]).p, duration))
            else:
                missing.append(f"a constraint of {piece.count} rows that declares no surface")
    values = {} if plant.environment is None else plant.environment.parameters()
    for point, normal in _walls(values):
        wall = Surface(kind="plane", point=point, axis=normal / np.linalg.norm(normal))
        things.append(_thing(wall, x.T().p, duration))
    return Around(things=tuple(things), missing=tuple(missing))


def _walls(values: Mapping[str, Float64Array]) -> Iterator[tuple[Float64Array, Float64Array]]:
    """Points and normals of the walls among what touches the tool."""
    for path, normal in values.items():
        place = path.removesuffix("normal") + "point"
        if path.endswith("normal") and place in values:
            yield values[place], normal


def _thing(surface: Surface, p: Float64Array, duration: float) -> Thing:
    """A surface as it is drawn near a point p."""
    n, rgba = surface.axis, HOLLOW if surface.inside else BOARD
    if surface.kind == "sphere":
        ball = Shape(kind="sphere", size=(surface.radius, 0.0, 0.0), rgba=rgba)
        return Thing(shapes=(ball,), p=numbers(surface.point))
    along = float(n @ (p - surface.point))
    if surface.kind == "cylinder":
        pipe = Shape(kind="cylinder", size=(surface.radius, SURFACE_HALF_WIDTH, 0.0), rgba=rgba)
        return Thing(shapes=(pipe,), p=numbers(surface.point + along * n), wxyz=_along(n))
    board = Shape(kind="box", size=(SURFACE_HALF_WIDTH, SURFACE_HALF_WIDTH, THICKNESS), rgba=rgba)
    times: tuple[float, ...] = ()
    shifts: tuple[tuple[float, ...], ...] = ()
    if surface.displacement is not None:
        times = numbers(np.linspace(0.0, duration, max(2, round(duration / PERIOD) + 1)))
        shifts = tuple(numbers(surface.displacement(t) * n) for t in times)
    at = p - (along + THICKNESS) * n  # the board's face is the plane
    return Thing(shapes=(board,), p=numbers(at), wxyz=_along(n), times=times, shifts=shifts)


def _along(z: Float64Array) -> tuple[float, ...]:
    """Quaternion wxyz of axes whose z looks along a unit vector."""
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return numbers(Pose.of(np.column_stack([x, np.cross(z, x), z]), np.zeros(3)).wxyz)
