"""A slow stream of chunks, followed at 1 kHz: with blend= the reference does not jump where a new chunk begins."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused
from runtime_laws import HandPlant, TorqueOf

import taut
from taut.base.types import Float64Array

ARM = taut.load_arm("planar2")
CENTRE = np.array([0.3, -0.6])


class Policy:
    """Gives a chunk of five positions each 100 ms, each chunk from a noisy idea of where to go."""

    def __init__(self, task: bool = False) -> None:
        self.rng, self.task = np.random.default_rng(5), task

    def __call__(self, x: taut.Snapshot) -> Any:
        off = 0.02 * self.rng.standard_normal(2)
        times = 0.05 * np.arange(5)
        q = CENTRE + off + 0.3 * np.sin(2.0 * (x.t + times))[:, np.newaxis]
        if not self.task:
            return taut.chunk(times, q)
        return taut.chunk(times, [taut.Pose([*row, 0.0], rpy=[row[0], 0.0, 2.0 * row[1]]) for row in q])


class Follows(taut.Law):
    """A soft spring of the tool's position in the plane."""

    reference = taut.TaskMotion
    k: taut.Gain  # [N/m]

    def command(self, x: taut.Snapshot, ref: taut.TaskMotion) -> taut.Torque:
        e, e_dot = ref.p - x.T().p, ref.twist[:3] - x.twist()[:3]
        return taut.Torque(task=x.J().T[:, :3] @ (self.k @ e + 5.0 * e_dot))


def run(blend: float | None, task: bool = False, plant: Any = None, duration: float = 0.5) -> taut.Run:
    law: Any = Follows(k=50.0) if task else TorqueOf()
    made = plant or taut.RigidPlant(ARM, adds=("gravity", "coriolis"))
    ctrl = taut.compile(law, ARM, adds=made.adds)
    return taut.run(ctrl, made, taut.stream(period=0.1, source=Policy(task), blend=blend), duration=duration)


def jumps(rows: Float64Array) -> Float64Array:
    """Largest change from one tick to the next."""
    return np.abs(np.diff(rows, axis=0)).reshape(len(rows) - 1, -1).max(axis=1)


PLANTS: dict[str, Callable[[], Any]] = {
    "fused": lambda: taut.RigidPlant(ARM, adds=("gravity", "coriolis")),
    "hosted": lambda: HandPlant(),
}


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_positions_and_velocities_of_joints_do_not_jump(plant: Callable[[], Any]) -> None:
    hard, soft = run(None, plant=plant()), run(0.05, plant=plant())
    at_new = np.arange(99, 499, 100)
    assert jumps(hard.reference.q)[at_new].min() > 5e-3
    assert jumps(soft.reference.q).max() < 3e-3  # 0.04 rad in 50 ms go at 1.5 rad/s
    assert jumps(soft.reference.v)[at_new].max() < 0.1
    # Once the fade is over, the reference is the chunk's own.
    for k in (0, 99, 160, 199, 260):
        np.testing.assert_allclose(soft.reference.q[k], hard.reference.q[k], atol=1e-12)


def test_pose_twist_and_acceleration_of_the_tool_do_not_jump() -> None:
    hard, soft = run(None, task=True), run(0.05, task=True)
    at_new = np.arange(99, 499, 100)
    for name in ("p", "R"):
        assert jumps(getattr(hard.reference, name))[at_new].min() > 5e-3
        assert jumps(getattr(soft.reference, name)).max() < 8e-3
    assert jumps(soft.reference.twist)[at_new].max() < 0.25 * jumps(soft.reference.twist).max()
    np.testing.assert_allclose(soft.reference.R[190], hard.reference.R[190], atol=1e-12)
    # The recorded twist is the rate of the recorded pose, in the fade too: central differences at 1 ms.
    slope = (soft.reference.p[2:] - soft.reference.p[:-2]) / 2e-3
    np.testing.assert_allclose(soft.reference.twist[1:-1, :3], slope, atol=0.02)


def test_a_fade_that_is_not_over_when_the_next_chunk_comes_goes_on_smoothly() -> None:
    soft = run(0.25, task=True)
    assert jumps(soft.reference.p).max() < 2e-3
    slope = (soft.reference.p[2:] - soft.reference.p[:-2]) / 2e-3
    np.testing.assert_allclose(soft.reference.twist[1:-1, :3], slope, atol=0.02)


def test_samples_one_by_one_are_blended_too() -> None:
    def source(x: taut.Snapshot) -> taut.JointMotion:
        return taut.JointMotion(q=np.full(2, np.floor(x.t / 0.1 + 0.5)))

    plant = taut.RigidPlant(ARM, adds=("gravity", "coriolis"))
    ctrl = taut.compile(TorqueOf(), ARM, adds=plant.adds)
    out = taut.run(ctrl, plant, taut.stream(period=0.1, source=source, blend=0.1), duration=0.3)
    quintic = taut.trajectories.Quintic(q0=[0.0], q1=[1.0], duration=0.1)
    for k in range(100, 200, 9):
        np.testing.assert_allclose(out.reference.q[k], quintic.at((k - 100) * 1e-3).q[0], atol=1e-12)
        np.testing.assert_allclose(out.reference.v[k], quintic.at((k - 100) * 1e-3).v[0], atol=1e-10)


def test_a_blend_that_is_none_is_refused() -> None:
    for blend in (0.0, np.nan):
        with refused(taut.errors.RangeError):
            taut.stream(period=0.1, blend=blend)
