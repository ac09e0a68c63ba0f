"""Trajectories: end conditions, limits, derivatives, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.base.types import Float64Array

Q0, Q1 = np.array([0.0, 1.0, -0.5]), np.array([1.0, -1.0, -0.5])
STEP = 1e-5
CENTRAL = 1e-5  # error of a central difference of these curves at STEP

CURVES = {
    "cubic": taut.trajectories.Cubic(q0=Q0, q1=Q1, duration=2.0),
    "quintic": taut.trajectories.Quintic(q0=Q0, q1=Q1, duration=2.0),
    "trapezoidal": taut.trajectories.Trapezoidal(q0=Q0, q1=Q1, velocity=1.2, acceleration=3.0),
    "short trapezoidal": taut.trajectories.Trapezoidal(q0=Q0, q1=Q1, velocity=10.0, acceleration=3.0),
    "jerk-limited": taut.trajectories.JerkLimited(q0=Q0, q1=Q1, velocity=1.2, acceleration=3.0, jerk=20.0),
    "spline": taut.trajectories.Spline(times=[0.0, 0.7, 2.0], points=[Q0, [0.3, 0.4, 0.5], Q1]),
}


@pytest.fixture(params=list(CURVES))
def curve(request: pytest.FixtureRequest) -> taut.trajectories.Quintic:
    return CURVES[request.param]


def test_it_starts_and_ends_at_rest_at_its_ends_and_stays_there(curve: taut.trajectories.Quintic) -> None:
    for t, q in ((-1.0, Q0), (0.0, Q0), (curve.duration, Q1), (curve.duration + 5.0, Q1)):
        sample = curve.at(t)
        np.testing.assert_allclose(sample.q, q, atol=1e-9)
        np.testing.assert_allclose(sample.v, 0.0, atol=1e-9)
    for t in (-1.0, curve.duration + 5.0):
        np.testing.assert_array_equal(curve.at(t).a, 0.0)


def test_velocity_and_acceleration_are_the_derivatives(curve: taut.trajectories.Quintic) -> None:
    # Off the instants at which the acceleration or the jerk of a curve jumps.
    for t in np.linspace(0.013, curve.duration - 0.017, 23):
        before, now, after = curve.at(t - STEP), curve.at(t), curve.at(t + STEP)
        np.testing.assert_allclose(now.v, (after.q - before.q) / (2 * STEP), atol=CENTRAL)
        if not np.allclose(before.a, after.a, atol=1e-2):
            continue
        np.testing.assert_allclose(now.a, (after.v - before.v) / (2 * STEP), atol=1e-3)


def test_many_times_at_once_are_the_same_as_one_by_one(curve: taut.trajectories.Quintic) -> None:
    times = np.linspace(-0.2, curve.duration + 0.2, 41)
    rows = curve.rows(times)
    for k, t in enumerate(times):
        one = curve.at(float(t))
        for name in ("q", "v", "a"):
            np.testing.assert_array_equal(getattr(rows, name)[k], getattr(one, name))


@pytest.mark.parametrize("name", ["trapezoidal", "short trapezoidal", "jerk-limited"])
def test_limits_hold_and_the_slowest_joint_reaches_one(name: str) -> None:
    curve = CURVES[name]
    rows = curve.rows(np.linspace(0.0, curve.duration, 2001))
    speed, acceleration = np.abs(rows.v).max(), np.abs(rows.a).max()
    limit = float(np.max(curve.velocity))
    assert speed <= limit + 1e-9
    assert acceleration <= 3.0 + 1e-9
    assert speed > limit - 1e-6 or acceleration > 3.0 - 1e-6


def test_a_jerk_limited_curve_keeps_its_jerk() -> None:
    curve = CURVES["jerk-limited"]
    rows = curve.rows(np.linspace(0.0, curve.duration, 4001))
    jerk = np.diff(rows.a, axis=0) / (curve.duration / 4000)
    assert np.abs(jerk).max() <= 20.0 * (1 + 1e-6)


def test_a_quintic_has_zero_acceleration_at_both_ends_and_a_cubic_does_not() -> None:
    quintic, cubic = CURVES["quintic"], CURVES["cubic"]
    for t in (0.0, 2.0):
        np.testing.assert_allclose(quintic.at(t).a, 0.0, atol=1e-9)
    np.testing.assert_allclose(cubic.at(0.0).a, 6.0 * (Q1 - Q0) / 4.0)


def test_a_spline_goes_through_its_points_with_continuous_acceleration() -> None:
    curve = CURVES["spline"]
    np.testing.assert_allclose(curve.at(0.7).q, [0.3, 0.4, 0.5], atol=1e-12)
    np.testing.assert_allclose(curve.at(0.7 - 1e-9).a, curve.at(0.7 + 1e-9).a, atol=1e-6)


def test_a_trapezoid_that_does_not_move_takes_no_time() -> None:
    curve = taut.trajectories.Trapezoidal(q0=Q0, q1=Q0, velocity=1.0, acceleration=1.0)
    assert curve.duration == 0.0
    np.testing.assert_array_equal(curve.at(0.5).q, Q0)


def test_a_sine_is_the_one_of_its_formula() -> None:
    curve = taut.trajectories.Sine(center=[1.0, 2.0], amplitude=[0.5, 0.25], frequency=2.0, phase=[0.0, 1.0])
    t, w = 0.3, 4.0 * np.pi
    phase = np.array([0.0, 1.0])
    sample = curve.at(t)
    np.testing.assert_allclose(sample.q, [1.0, 2.0] + np.array([0.5, 0.25]) * np.sin(w * t + phase))
    np.testing.assert_allclose(sample.v, w * np.array([0.5, 0.25]) * np.cos(w * t + phase))
    np.testing.assert_allclose(sample.a, -(w**2) * np.array([0.5, 0.25]) * np.sin(w * t + phase))


class TestSamples:
    times = np.array([0.0, 0.5, 1.0])
    q = np.array([[0.0, 1.0], [1.0, 1.0], [4.0, 0.0]])

    def test_positions_are_linear_in_between_and_held_outside(self) -> None:
        samples = taut.trajectories.Samples(times=self.times, q=self.q)
        np.testing.assert_allclose(samples.at(0.25).q, [0.5, 1.0])
        np.testing.assert_allclose(samples.at(9.0).q, [4.0, 0.0])
        np.testing.assert_array_equal(samples.at(9.0).v, 0.0)

    def test_a_csv_file_reads_back_what_was_written(self, tmp_path: Path) -> None:
        file = tmp_path / "path.csv"
        rows = ["t,q1,q2,v1,v2"] + [f"{t},{q[0]},{q[1]},0.5,-0.5" for t, q in zip(self.times, self.q, strict=True)]
        file.write_text("\n".join(rows) + "\n")
        samples = taut.trajectories.Samples.from_csv(file)
        np.testing.assert_array_equal(samples.q, self.q)
        np.testing.assert_array_equal(samples.at(0.5).v, [0.5, -0.5])

    @pytest.mark.parametrize("rates", ["", "v", "a", "va"])
    def test_a_csv_file_may_leave_out_either_rate(self, tmp_path: Path, rates: str) -> None:
        given = {"v": np.array([[3.0, 4.0]] * 3), "a": np.array([[5.0, 6.0], [7.0, 8.0], [9.0, 0.0]])}
        columns = ["t", *(f"{letter}{i}" for letter in f"q{rates}" for i in (1, 2))]
        table = np.column_stack([self.times, self.q, *(given[letter] for letter in rates)])
        np.savetxt(tmp_path / "path.csv", table, delimiter=",", header=",".join(columns), comments="")
        samples = taut.trajectories.Samples.from_csv(tmp_path / "path.csv")
        np.testing.assert_array_equal(samples.q, self.q)
        v = given["v"] if "v" in rates else np.gradient(self.q, self.times, axis=0)
        np.testing.assert_array_equal(samples.v, v)
        np.testing.assert_array_equal(samples.a, given["a"] if "a" in rates else np.gradient(v, self.times, axis=0))

    @pytest.mark.parametrize(
        "text",
        [
            "",
            "q1,q2\n0,1\n",
            "t,q1,v2\n0,1,2\n",
            "t,q1,q1\n0,1,2\n",
            "t,q1,a1,v1\n0,1,2,3\n",
            "t,q1,q2,a1\n0,1,2,3\n",
            "t,q1,tau1\n0,1,2\n",
            "t,q1,\n0,1,2\n",
            "t,v1,a1\n0,1,2\n",
            "t\n0\n",
            "t,q1\n0,x\n",
            "t,q1\n0,1,2\n",
            "t,q1\n",
            "t,q1\n0,1\n0,2\n",
            "t,q1\n0,nan\n",
        ],
    )
    def test_a_wrong_csv_file_is_refused_in_words(self, tmp_path: Path, text: str) -> None:
        file = tmp_path / "path.csv"
        file.write_text(text)
        with refused(taut.TautError):
            taut.trajectories.Samples.from_csv(file)


@pytest.mark.parametrize(
    "make",
    [
        lambda: taut.trajectories.Quintic(q0=[0.0], q1=[1.0], duration=0.0),
        lambda: taut.trajectories.Quintic(q0=[0.0], q1=[1.0, 2.0], duration=1.0),
        lambda: taut.trajectories.Quintic(q0=[np.nan], q1=[1.0], duration=1.0),
        lambda: taut.trajectories.Trapezoidal(q0=[0.0], q1=[1.0], velocity=0.0, acceleration=1.0),
        lambda: taut.trajectories.Spline(times=[0.0, 0.0], points=[[0.0], [1.0]]),
        lambda: taut.trajectories.Spline(times=[0.0], points=[[0.0]]),
        lambda: taut.trajectories.Samples(times=[0.0, 1.0], q=[[0.0]]),
        lambda: taut.chunk([0.0, 0.1], [[0.0]]),
        lambda: taut.chunk([0.1, 0.0], [[0.0], [1.0]]),
        lambda: taut.stream(period=0.0),
        lambda: taut.hold([0.0]),
        lambda: taut.JointMotion(q=[[0.0]]),
        lambda: taut.JointMotion(q=[0.0], v=[1.0, 2.0]),
    ],
)
def test_what_makes_no_reference_is_refused_in_words(make: object) -> None:
    with refused(taut.TautError):
        make()  # type: ignore[operator]


def test_without_ruckig_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "ruckig", None)
    with refused(taut.errors.MissingExtraError):
        taut.trajectories.JerkLimited(q0=[0.0], q1=[1.0], velocity=1.0, acceleration=1.0, jerk=1.0)


def test_a_chunk_blends_samples_and_then_holds() -> None:
    targets: list[Float64Array] = [np.array([0.0]), np.array([1.0]), np.array([3.0])]
    chunk = taut.chunk([0.0, 0.1, 0.3], targets)
    np.testing.assert_allclose(chunk.at(0.05).q, [0.5])
    np.testing.assert_allclose(chunk.at(0.2).q, [2.0])
    np.testing.assert_allclose(chunk.at(5.0).q, [3.0])
    np.testing.assert_array_equal(chunk.at(5.0).v, [0.0])


def test_a_chunk_rests_before_its_first_time_and_after_its_last() -> None:
    chunk = taut.chunk([0.1, 0.2], [[0.0], [1.0]])
    moving = taut.JointMotion(q=[1.0], v=[2.0], a=[3.0])
    alone = taut.chunk([0.1], [moving])
    for t, q in ((0.0, 0.0), (0.0999, 0.0), (0.2001, 1.0), (9.0, 1.0)):
        np.testing.assert_array_equal(chunk.at(t).q, [q])
        np.testing.assert_array_equal(chunk.at(t).v, [0.0])
        np.testing.assert_array_equal(alone.at(t).q, [1.0])
        np.testing.assert_array_equal([alone.at(t).v, alone.at(t).a], [[0.0], [0.0]])
    np.testing.assert_allclose([chunk.at(t).v for t in (0.1, 0.15, 0.2)], [[10.0], [10.0], [10.0]])
    np.testing.assert_array_equal([alone.at(0.1).v, alone.at(0.1).a], [[2.0], [3.0]])


@pytest.mark.parametrize("count", [1, 2, 5])
def test_every_trajectory_gives_one_row_for_each_time(count: int) -> None:
    times = np.linspace(0.0, 1.0, count)
    others = {
        "chunk": taut.chunk([0.0, 1.0], [Q0, Q1]),
        "sine": taut.trajectories.Sine(center=Q0, amplitude=1.0, frequency=1.0),
        "samples": taut.trajectories.Samples(times=[0.0, 1.0], q=[Q0, Q1]),
    }
    for name, curve in (CURVES | others).items():
        rows, one = curve.rows(times), curve.at(0.5)
        for field in ("q", "v", "a"):
            assert getattr(rows, field).shape == (count, 3), name
            assert getattr(one, field).shape == (3,), name


@pytest.mark.parametrize("t", ["a", [0.0, 0.5], np.nan, None])
def test_a_time_that_is_none_is_refused(t: Any) -> None:
    for motion in (
        taut.trajectories.Cubic(q0=[0.0], q1=[1.0], duration=1.0),
        taut.trajectories.Sine(center=0.0, amplitude=[1.0], frequency=1.0),
    ):
        with refused(taut.TautError):
            motion.at(t)


def test_limits_that_ruckig_cannot_work_with_are_told() -> None:
    with refused(taut.errors.NumericalError):
        taut.trajectories.JerkLimited(q0=[0.0], q1=[1e300], velocity=1e-300, acceleration=1e-300, jerk=1e-300)
