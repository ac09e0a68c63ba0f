"""Simulation: run a controller against a plant and record what happens."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import whole_number
from taut.base.errors import RangeError, StabilityWarning, UsageError, warn
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.control.tasks.phase import Phase
from taut.control.trajectories.reference import Hold, Reference, as_reference
from taut.controller import Controller, compile
from taut.linear.judgement import Judgement, judge_start
from taut.loop import Loop, ModelPlant, check_fit, duration_of_ticks, require_no_reference, state_at_start
from taut.record.info import Change, RunInfo, Stability, versions
from taut.record.progress import Progress
from taut.record.run import Run
from taut.runtime.events import Event, sorted_events
from taut.runtime.fused import FusedRun
from taut.runtime.host import HostPlant, RealArm
from taut.runtime.hosted import HostedRun
from taut.runtime.info import around_info, tool_info

__all__ = ["run"]

Plant: TypeAlias = ModelPlant | HostPlant


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
    diverges ends with that outcome, and keeps what came before. So does one in which a function of yours (a source, a
    trajectory, a guard, a law in plain Python) or the plant raises after the first tick.

    Args:
        ctrl: A controller from `taut.compile`, or a whole `taut.Loop` (then leave plant, ref and duration out); or a
            task, a list of `taut.Phase`, which is compiled for the plant's arm and what it adds, at 1000 Hz.
        plant: `taut.RigidPlant`, `taut.MujocoPlant`, ...
        ref: A sample, hold, trajectory, stream or chunk; a hold of the first state if left out. None for a task,
            whose phases have their own.
        duration: [s].
        q0: (n,) true positions at the start; the plant arm's home by default.
        v0: (n,) true velocities at the start; zero by default.
        seed: Seed of every random number in the run.
        events: Parameters that change at stated times: taut.Event(t=, set=).
        log: File (.mcap) that is written while the run goes on, at most 0.2 s behind. Where it cannot be written any
            more, such as on a full disk, the run goes on without it, and the outcome counts the ticks it lacks.
        progress: Show progress; by default on a terminal when the run takes a while.

    Returns:
        The record, with one row per control tick, both ends included.

    Warns:
        StabilityWarning: The sampled loop is unstable at the start pose; the outcome and `run.info.stability` name
            the direction, the spectral radius, and the largest gain that is stable.

    Raises:
        RangeError: The same, of a plant that is a real arm.
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
    seed = whole_number("seed", seed)
    if not isinstance(ctrl, (Controller, Loop)):
        ctrl = _of_task(ctrl, plant)
    target, reference, length = _what_to_run(ctrl, plant, ref, duration)
    ticks = round(length * ctrl.side.rate) + 1
    due = sorted_events(events, ctrl.side.rate, ticks)
    q, v = state_at_start(target.arm, q0, v0)
    law = ctrl.side.law.bound(subtree(ctrl.parameters, "law"))  # with the gains of this run
    going: FusedRun | HostedRun
    at_once = {path: value for tick, event in due if tick == 0 for path, value in event.set.items()}
    if isinstance(target, ModelPlant):
        loop = (
            ctrl
            if isinstance(ctrl, Loop)
            else Loop(ctrl, target, None if ref is None else reference, duration=length)
        )
        parameters = _arrays(loop.parameters)
        going = FusedRun(loop, q, v, seed, due)
        stability = _judged(judge_start(loop, target, q, at_once), target)
    else:
        assert isinstance(ctrl, Controller)
        parameters = _arrays({**ctrl.parameters, **target.parameters})
        stability = _judged(judge_start(ctrl, target, q, at_once), target)
        going = HostedRun(ctrl, target, reference, ticks, q, v, seed, due)
    going.tape.unstable = stability.message if stability.stable is False else ""
    going.tape.info = RunInfo(
        rate=ctrl.side.rate,
        duration=length,
        seed=seed,
        law=repr(law),
        arm=ctrl.side.arm.name,
        controller_arm=_undrawn(ctrl.side.arm),
        plant_arm=_undrawn(target.arm),
        plant=target.name,
        events=tuple(Change(t=event.t, set=_arrays(event.set)) for _, event in due),
        sensing=str(ctrl.side.sensing),
        command_limits="none" if ctrl.side.limits is None else str(ctrl.side.limits),
        parameters=parameters,
        stability=stability,
        versions=versions(),
        around=around_info(target, q, length),
        **tool_info(law, ctrl.side, q, ctrl.parameters),
    )
    return _recorded(going, log, progress)


def _arrays(values: Mapping[str, ArrayLike]) -> dict[str, Float64Array]:
    return {path: np.array(value, dtype=np.float64) for path, value in values.items()}


def _undrawn(arm: Arm) -> Arm:
    """An arm without what is only drawn of it."""
    return dataclasses.replace(arm, visuals=(), source="", notes=())


def _judged(verdict: Judgement | str, plant: Plant) -> Stability:
    """The judgement of the start, after a warning where the loop is unstable.

    Raises:
        RangeError: It is, and the plant is a real arm.
    """
    if isinstance(verdict, str):
        return Stability(stable=None, message=verdict)
    if not verdict.stable:
        if isinstance(plant, RealArm) and plant.real:
            raise RangeError(f"{verdict.message} (plant '{plant.name}' is a real arm: nothing was sent)", name="law")
        warn(verdict.message, StabilityWarning)
    return Stability(**verdict.record())


def _of_task(task: Sequence[Phase], plant: Plant | None) -> Controller:
    """The controller of a task, for the arm of a plant.

    Raises:
        UsageError: No list of phases, or no plant.
    """
    if not isinstance(task, (list, tuple)):
        raise UsageError(
            "run takes a controller from taut.compile, a taut.Loop, or a list of taut.Phase; got "
            f"{type(task).__name__}"
        )
    if plant is None or not hasattr(plant, "advance"):
        raise UsageError("run needs a plant: taut.run([taut.Phase(...)], taut.RigidPlant(arm), duration=5.0)")
    return compile(task, plant.arm, adds=plant.adds)


def _recorded(going: FusedRun | HostedRun, log: str | os.PathLike[str] | None, progress: bool | None) -> Run:
    """Run to the end, with a log file and a bar where they are asked for."""
    from taut.record.log.writing import RunLog, open_log

    tape = going.tape
    with Progress(len(tape.inputs["t"]), progress) as bar:
        if log is None:
            kept, outcome = going.go(bar.advance, None)
            outcome = tape.explained(outcome)
        else:
            with RunLog(open_log(log)) as file:
                kept, outcome = going.go(bar.advance, file)
                outcome = file.finish(tape.explained(outcome))
    return tape.piece(0, kept, outcome)


def _what_to_run(
    ctrl: Controller | Loop, plant: Plant | None, ref: object, duration: float | None
) -> tuple[Plant, Reference, float]:
    if isinstance(ctrl, Loop):
        if plant is not None or ref is not None or duration is not None:
            raise UsageError("a Loop has its plant, reference and duration already; pass run(loop) alone")
        return ctrl.plant, ctrl.ref, ctrl.duration
    if plant is None:
        raise UsageError("run needs a plant: taut.run(ctrl, taut.RigidPlant(arm), ref, duration=5.0)", name="plant")
    if duration is None:
        raise UsageError("run needs a duration in seconds: taut.run(..., duration=5.0)", name="duration")
    if not hasattr(plant, "advance"):
        raise UsageError(f"run takes a plant such as taut.RigidPlant(arm); got {type(plant).__name__}", name="plant")
    check_fit(ctrl.side, plant)
    require_no_reference(ctrl.side, ref)
    reference: Reference = Hold() if ref is None else as_reference(ref)
    return plant, reference, duration_of_ticks(duration, ctrl.side.dt)
