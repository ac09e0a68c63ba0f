"""Both options of section 10.2.3 on the same paths: via joint space, and in task space itself.

    python benchmarks/task_options.py

prints the table of docs/task_space.md. One run of each law on each path, an exact model at 1 kHz, no limiter; tick
times are medians of interleaved rounds.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import numpy as np

import taut

KP, KD = 400.0, 40.0
ROUNDS, TICKS = 15, 4000


def laws() -> dict[str, taut.Law]:
    """The two options, and the second one without what it does at singularities."""
    task = taut.laws.TaskComputedTorque
    return {
        "via_joint_space(ComputedTorque)": taut.via_joint_space(taut.laws.ComputedTorque(kp=KP, kd=KD)),
        "TaskComputedTorque": task(kp=KP, kd=KD),
        'TaskComputedTorque(singularity="plain")': task(kp=KP, kd=KD, singularity="plain"),
    }


def circle(arm: taut.Arm) -> Any:
    T0 = taut.snapshot(arm, arm.home).T()
    return (
        taut.trajectories.Circle(T0=T0, centre=T0.act([0.0, -0.15, 0.0]), axis=[1, 0, 0], duration=3.0),
        arm.home,
        3.5,
    )


def to_a_limit(arm: taut.Arm) -> Any:
    """Up until a joint is at its end, and back."""
    T0 = taut.snapshot(arm, arm.home).T()
    there = taut.Pose(T0.p, R=T0.R @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    turned = taut.Pose(T0.p, R=there.R @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    times, poses = [0.0, 1.5, 2.5, 4.0, 5.0], [T0, there, turned, there, T0]
    return taut.trajectories.TaskSamples(times=times, poses=poses), arm.home, 6.0


def through_alignment(arm: taut.Arm) -> Any:
    """A straight line along which the wrist comes into alignment."""
    q0 = arm.home.copy()
    q0[4] = -0.25  # the wrist's middle joint, whose zero is the singularity
    T0 = taut.snapshot(arm, q0).T()
    q1 = q0.copy()
    q1[4] = 0.25
    T1 = taut.snapshot(arm, q1).T()
    return (
        taut.trajectories.Line(T0=T0, T1=taut.Pose(T1.p, R=T1.R), velocity=(0.25, 1.0), acceleration=(1.0, 4.0)),
        q0,
        3.0,
    )


PATHS = {"circle": circle, "to a joint limit and back": to_a_limit, "through wrist alignment": through_alignment}
WHERE = {"circle": "panda", "to a joint limit and back": "panda", "through wrist alignment": "ur10"}


def tick_times(kernels: dict[str, Any]) -> dict[str, float]:
    """[us] of each bound kernel, medians of rounds in turn."""
    found: dict[str, list[float]] = {name: [] for name in kernels}
    for _ in range(ROUNDS):
        for name, kernel in kernels.items():
            start = time.perf_counter()
            for _ in range(TICKS):
                kernel.tick()
            found[name].append((time.perf_counter() - start) / TICKS * 1e6)
    return {name: statistics.median(times) for name, times in found.items()}


def main() -> None:
    """Print the table."""
    arm = taut.load_arm("panda")
    ref = taut.TaskMotion(pose=taut.snapshot(arm, arm.home).T())
    kernels = {}
    for name, law in laws().items():
        ctrl = taut.compile(law, arm)
        ctrl.step(arm.home, np.zeros(arm.n), ref)
        kernels[name] = ctrl.bind()
    times = tick_times(kernels)
    print(
        "| path | law | tick [us] | RMS [mm] | last [mm] | peak torque / limit | peak speed / limit "
        "| past a limit [rad] |"
    )
    print("|---|---|--:|--:|--:|--:|--:|--:|")
    for path, make in PATHS.items():
        arm = taut.load_arm(WHERE[path])
        motion, q0, duration = make(arm)
        for name, law in laws().items():
            plant = taut.RigidPlant(arm, friction=None)
            run = taut.run(taut.compile(law, arm), plant, motion, duration=duration, q0=q0)
            error = np.linalg.norm(run.task.position_error, axis=1) * 1e3
            past = np.maximum(np.maximum(run.q - arm.upper, arm.lower - run.q), 0.0).max()
            print(
                f"| {path} | `{name}` | {times[name]:.1f} | {np.sqrt(np.mean(error**2)):.3f} | {error[-1]:.3f} | "
                f"{np.abs(run.tau / arm.effort).max():.2f} | {np.abs(run.v / arm.velocity).max():.2f} | {past:.3f} |"
                f"{'' if run.outcome.ok else ' ' + run.outcome.kind}"
            )


if __name__ == "__main__":
    main()
