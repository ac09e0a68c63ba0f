"""Through singularities: four lines of a UR10 in three ways, other arms, starts at singular poses, arms of few joints."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from singular_lines import Line, Measured, OneLoop, errors, kinematics, lines, measured

import taut
from taut.base.types import Float64Array
from taut.maths.singularity import sizes_of

Array = Float64Array
KINDS = ("wrist", "shoulder", "beyond", "elbow")
GAINS = {"kp": 100.0, "kd": 20.0}
WAYS: dict[str, dict[str, Any]] = {
    "plain": {"singularity": "plain"},
    "constant damping": {"singularity": "plain", "damping": 0.05},
    "robust": {},
}


CALM = taut.laws.Posture(kp=0.0, kd=20.0)  # damping of the free motion, and no spring that pulls it back


@functools.cache
def loop(name: str, way: str) -> OneLoop:
    arm = taut.load_arm(name)
    return OneLoop(taut.laws.TaskComputedTorque(**GAINS, **WAYS[way], null=None if arm.n == 6 else CALM), arm)


@functools.cache
def table(way: str, kind: str, count: int, name: str = "ur10") -> list[Measured]:
    arm = taut.load_arm(name)
    return [measured(loop(name, way).run(line), arm, line) for line in lines(arm, kind)[:count]]


@pytest.mark.part(1)
@pytest.mark.bars
@pytest.mark.parametrize("kind", KINDS)
def test_a_ur10_goes_through_its_singularities_within_its_limits_and_comes_back(
    kind: str, share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    ours = table("robust", kind, share(16))
    assert all(one.finished for one in ours)
    assert max(one.torque for one in ours) <= 1.0
    assert max(one.speed for one in ours) <= 1.0
    assert max(one.recovery for one in ours) <= 2.0
    for way in WAYS:
        rows = table(way, kind, share(16))
        worst = [max(getattr(one, word) for one in rows) for word in ("torque", "speed", "rms", "recovery")]
        done = f"{sum(one.finished for one in rows)} of {len(rows)} finished"
        name = f"UR10 through singularities, {kind}, {way}: torque / effort, speed / limit, RMS error, recovery"
        bar(name, f"{worst[0]:.3g}, {worst[1]:.3g}, {1e3 * worst[2]:.3g} mm, {worst[3]:.2f} s; {done}")


@pytest.mark.bars
def test_it_beats_constant_damping_in_error_and_over_all_in_torque(share: Callable[[int], int]) -> None:
    peaks = {}
    for way in ("robust", "constant damping"):
        peaks[way] = max(one.torque for kind in KINDS for one in table(way, kind, share(16)))
    assert peaks["robust"] < peaks["constant damping"]
    for kind in KINDS:
        worst = [max(one.rms for one in table(way, kind, share(16))) for way in ("robust", "constant damping")]
        assert worst[0] < worst[1]


@pytest.mark.bars
def test_before_a_singularity_nothing_differs_from_the_plain_law(share: Callable[[int], int]) -> None:
    """Until J first moves something by less than 0.1, which is where the plain law is still itself."""
    arm = taut.load_arm("ur10")
    for kind in KINDS:
        for line in lines(arm, kind)[: share(16)]:
            robust, plain = (loop("ur10", way).run(line) for way in ("robust", "plain"))
            near = np.flatnonzero(errors(robust, arm, line)[2] < 0.1)
            first = min([*near[:1], len(plain.t)])
            assert first > 200
            assert np.abs(robust.q[:first] - plain.q[:first]).max() < 1e-8  # [rad], of an arm of 1.4 m


@pytest.mark.bars
@pytest.mark.parametrize("name", ["panda", pytest.param("xarm7", marks=pytest.mark.long)])
def test_arms_of_seven_joints_go_through_within_their_limits_and_come_back(
    name: str, share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    """Arms on which nothing was tuned, on lines that ask for no more speed than there is until the border."""
    arm, count = taut.load_arm(name), share(8)
    for kind in ("wrist", "beyond", "elbow"):
        ours = table("robust", kind, count, name)
        assert all(one.finished for one in ours)
        assert max(one.torque for one in ours) <= 1.0
        assert max(one.speed for one in ours) <= 1.0
        assert max(one.recovery for one in ours) <= 2.0
        damped = table("constant damping", kind, count, name)
        assert max(one.rms for one in ours) < max(one.rms for one in damped)
        given = 0.0  # torque of the plain law, where none but its motion is allowed
        for line in lines(arm, kind)[:count]:
            robust, plain = (loop(name, way).run(line) for way in ("robust", "plain"))
            near = np.flatnonzero(errors(robust, arm, line)[2] < sizes_of(arm).border)
            first = min([*near[:1], len(plain.t)])
            assert first > 200
            assert np.abs(robust.q[:first] - plain.q[:first]).max() < 1e-8
            assert (np.abs(plain.v[:first]) / arm.velocity).max() < 0.98
            given = max(given, float((np.abs(plain.tau[:first]) / arm.effort).max()))
        peak = max(one.torque for one in damped)
        if count == 8:
            assert (
                given > peak
            )  # so no such law has a lower peak than constant damping: docs/singularities.md says so
        bar(
            f"{name} through singularities, {kind}: torque / effort of the plain law before the border",
            f"{given:.4f}",
        )
        for way in WAYS:
            rows = table(way, kind, count, name)
            worst = [max(getattr(one, word) for one in rows) for word in ("torque", "speed", "rms", "recovery")]
            done = f"{sum(one.finished for one in rows)} of {len(rows)} finished"
            title = (
                f"{name} through singularities, {kind}, {way}: torque / effort, speed / limit, RMS error, recovery"
            )
            bar(title, f"{worst[0]:.3g}, {worst[1]:.3g}, {1e3 * worst[2]:.3g} mm, {worst[3]:.2f} s; {done}")


@dataclass(frozen=True, kw_only=True)
class Held:
    """A pose to hold, from t = `since` on; another before."""

    p: Array
    R: Array
    first: Array
    since: float

    def rows(self, times: Array) -> taut.TaskMotion:
        k, still = len(times), np.zeros((len(times), 6))
        p = np.where((times < self.since)[:, None], self.first, self.p)
        R = np.broadcast_to(self.R, (k, 3, 3))
        return taut.TaskMotion.of({"p": p, "R": R, "twist": still, "acceleration": still})

    def at(self, t: float) -> taut.TaskMotion:
        rows = self.rows(np.array([t]))
        return taut.TaskMotion.of({name: getattr(rows, name)[0] for name in ("p", "R", "twist", "acceleration")})


CANDLE = (0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0)


@pytest.mark.parametrize("q0", [CANDLE, (0.0,) * 6], ids=["candle", "stretched"])
@pytest.mark.parametrize("step", [(0.0, 0.0, -0.1), (0.1, 0.0, 0.0), (0.0, 0.1, -0.2)])
def test_it_starts_at_an_exactly_singular_pose_without_harm(q0: tuple[float, ...], step: tuple[float, ...]) -> None:
    arm = taut.load_arm("ur10")
    p, R, J = kinematics(arm)(np.array(q0))
    assert np.linalg.svd(J, compute_uv=False)[-1] < 1e-9
    target = p + np.array(step)
    run = loop("ur10", "robust").run(Held(p=target, R=R, first=target, since=0.0), q0=np.array(q0))
    assert run.outcome.ok
    assert (np.abs(run.tau) / arm.effort).max() < 1.0
    assert (np.abs(run.v) / arm.velocity).max() < 1.0
    assert np.abs(run.v[-1]).max() < 1e-3
    errors_at = [np.linalg.norm(target - kinematics(arm)(q)[0]) for q in (run.q[0], run.q[-1])]
    assert errors_at[1] < errors_at[0]


class Waiting:
    """A line out and back, with a rest at its far end."""

    def __init__(self, line: Line, rest: float) -> None:
        self.line, self.rest, self.q0 = line, rest, line.q0

    def rows(self, times: Array) -> taut.TaskMotion:
        turn = 0.2 + self.line.once
        return self.line.rows(np.where(times < turn + self.rest, np.minimum(times, turn), times - self.rest))

    def at(self, t: float) -> taut.TaskMotion:
        rows = self.rows(np.array([t]))
        return taut.TaskMotion.of({name: getattr(rows, name)[0] for name in ("p", "R", "twist", "acceleration")})


def test_it_comes_back_from_a_long_wait_beyond_its_reach() -> None:
    """At the border of its reach the arm comes to rest, straight to the last bit."""
    arm = taut.load_arm("ur10")
    line = lines(arm, "beyond")[0]
    rest = 8.0
    run = OneLoop(taut.laws.TaskComputedTorque(**GAINS, null=None), arm).run(
        Waiting(line, rest), duration=round(line.duration + rest, 3)
    )
    error, _, _ = errors(run, arm, Waiting(line, rest))
    assert run.outcome.ok
    assert (np.abs(run.tau) / arm.effort).max() < 1.0
    assert (np.abs(run.v) / arm.velocity).max() < 1.0
    assert np.abs(run.v[(run.t > 9.0) & (run.t < 9.5)]).max() < 1e-3
    assert error[run.t > line.again + rest + 2.0].max() < 1e-3


# -------------------------------------------------------------------- arms of few joints


@pytest.mark.parametrize("name", ["one_joint", "planar2", "planar3", "gantry3", "so101"])
def test_an_arm_of_few_joints_rests_at_the_least_squares_of_what_it_is_asked(name: str) -> None:
    arm = taut.load_arm(name)
    p, R, _ = kinematics(arm)(arm.home)
    target = taut.Pose(np.add(p, [0.02, 0.01, 0.03]), R=R)
    ctrl = taut.compile(taut.laws.TaskComputedTorque(**GAINS), arm, rate=1000.0)
    run = taut.run(ctrl, taut.RigidPlant(arm, friction=None), taut.TaskMotion(pose=target), duration=4.0)
    assert run.outcome.ok
    p, R, J = kinematics(arm)(run.q[-1])
    e = np.append(target.p - p, Rotation.from_matrix(target.R @ R.T).as_rotvec())
    weight = np.append(np.ones(3), np.full(3, sizes_of(arm).length ** 2))
    assert np.abs(run.v[-1]).max() < 1e-9
    assert np.abs(J.T @ (weight * e)).max() < 1e-9  # no motion of the joints lessens e . W e


class Wave:
    """A motion in the plane of planar3 with all three of its directions."""

    def __init__(self, T: taut.Pose) -> None:
        self.T = T

    def rows(self, t: Array) -> taut.TaskMotion:
        w, k = 2.0, len(t)
        way = np.stack([0.15 * np.sin(w * t), 0.0 * t, 0.15 * (np.cos(w * t) - 1.0)], axis=1)
        R = Rotation.from_rotvec(np.outer(0.4 * np.sin(w * t), [0.0, 1.0, 0.0])).as_matrix() @ self.T.R
        V, A = np.zeros((k, 6)), np.zeros((k, 6))
        V[:, 0], V[:, 2], V[:, 4] = 0.15 * w * np.cos(w * t), -0.15 * w * np.sin(w * t), 0.4 * w * np.cos(w * t)
        A[:, 0], A[:, 2] = -0.15 * w * w * np.sin(w * t), -0.15 * w * w * np.cos(w * t)
        A[:, 4] = -0.4 * w * w * np.sin(w * t)
        return taut.TaskMotion.of({"p": self.T.p + way, "R": R, "twist": V, "acceleration": A})

    def at(self, t: float) -> taut.TaskMotion:
        rows = self.rows(np.array([t]))
        return taut.TaskMotion.of({name: getattr(rows, name)[0] for name in ("p", "R", "twist", "acceleration")})


def test_three_joints_asked_for_six_directions_follow_as_if_asked_for_their_three() -> None:
    arm = taut.load_arm("planar3")
    in_plane = taut.Coordinates(
        function=lambda T: taut.math.array([T.p[0], T.p[2], taut.math.atan2(-T.R[2, 0], T.R[0, 0])]), angles=(2,)
    )
    three = taut.laws.TaskComputedTorque(
        **GAINS, error="coordinates", coordinates=in_plane, singularity="plain", null=None
    )
    p, R, _ = kinematics(arm)(arm.home)
    wave, q0 = Wave(taut.Pose(p, R=R)), np.add(arm.home, [0.02, -0.03, 0.01])
    runs = [
        taut.run(taut.compile(law, arm), taut.RigidPlant(arm, friction=None), wave, duration=4.0, q0=q0)
        for law in (taut.laws.TaskComputedTorque(**GAINS), three)
    ]
    assert np.abs(runs[0].q - runs[1].q).max() < 1e-6


def test_the_lines_are_what_they_are_said_to_be() -> None:
    """On each line the arm's starting pose is regular and, but for the wrist's, the middle or the far end is not."""
    arm = taut.load_arm("ur10")
    for kind in KINDS:
        found = lines(arm, kind)
        assert len(found) == 16
        for line in found:
            assert isinstance(line, Line)
            assert np.linalg.svd(kinematics(arm)(line.q0)[2], compute_uv=False)[-1] > 0.1
            assert abs(np.linalg.norm(line.d) - 1.0) < 1e-12
