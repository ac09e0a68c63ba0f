"""Lines, screws, circles and samples of task space: the poses they go through, their rates, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from scipy.spatial.transform import Rotation, Slerp
from task_motion_tools import AXIS, POSES, START, assert_exact_rates, away

import taut

T = 2.0
INSIDE = np.linspace(0.013, T - 0.017, 23)  # off the instants at which an acceleration jumps
FIELDS = ("p", "R", "twist", "acceleration")
SCALINGS = ("quintic", "cubic", "trapezoidal")


def straight(T1: taut.Pose, **options: Any) -> taut.trajectories.Line:
    return taut.trajectories.Line(T0=START, T1=T1, **({"duration": T} | options))


def ring(**options: Any) -> taut.trajectories.Circle:
    given: dict[str, Any] = {"centre": START.p + np.array([0.0, 0.1, 0.0]), "axis": [1.0, 0.0, 0.0], "duration": T}
    return taut.trajectories.Circle(T0=START, **(given | options))


@pytest.fixture(params=SCALINGS)
def scaling(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.parametrize("make", [straight], ids=["line"])
@pytest.mark.parametrize("T1", POSES.values(), ids=POSES)
class TestFromPoseToPose:
    def test_it_goes_from_rest_to_rest_and_stays_there(self, make: Any, T1: taut.Pose, scaling: str) -> None:
        motion = make(T1, scaling=scaling)
        for t, pose in ((-1.0, START), (0.0, START), (T, T1), (T + 5.0, T1)):
            sample = motion.at(t)
            np.testing.assert_allclose(sample.p, pose.p, atol=1e-14)
            np.testing.assert_allclose(sample.R, pose.R, atol=1e-14)
            np.testing.assert_allclose(sample.twist, 0.0, atol=1e-14)
        for t in (-1.0, T + 5.0):
            np.testing.assert_array_equal(motion.at(t).acceleration, 0.0)

    def test_twist_and_acceleration_are_the_rates_of_the_pose(self, make: Any, T1: taut.Pose, scaling: str) -> None:
        assert_exact_rates(make(T1, scaling=scaling), INSIDE)

    def test_many_times_at_once_are_the_same_as_one_by_one(self, make: Any, T1: taut.Pose) -> None:
        motion, times = make(T1), np.linspace(-0.2, T + 0.2, 11)
        rows = motion.rows(times)
        for k, t in enumerate(times):
            for name in FIELDS:
                np.testing.assert_allclose(getattr(rows, name)[k], getattr(motion.at(float(t)), name), atol=1e-15)


class TestLine:
    def test_the_origin_goes_straight_and_the_orientation_is_slerp(self) -> None:
        T1 = POSES["generic"]
        rows = straight(T1).rows(INSIDE)
        s = np.linalg.norm(rows.p - START.p, axis=1) / np.linalg.norm(T1.p - START.p)
        np.testing.assert_allclose(rows.p, START.p + s[:, np.newaxis] * (T1.p - START.p), atol=1e-15)
        slerp = Slerp([0.0, 1.0], Rotation.from_matrix([START.R, T1.R]))
        np.testing.assert_allclose(rows.R, slerp(s).as_matrix(), atol=1e-14)

    @pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], AXIS, [0.0, -0.6, 0.8]])
    @pytest.mark.parametrize("off", [0.0, 1e-12, -1e-12])
    def test_a_rotation_by_pi_goes_the_way_that_is_stated(self, axis: Any, off: float) -> None:
        lead = np.asarray(axis) * np.sign(next(x for x in axis if x))
        for sign in (1.0, -1.0):
            motion = straight(away(sign * (np.pi + off) * np.asarray(axis)))
            half = Rotation.from_matrix(START.R.T @ motion.at(0.5 * T).R).as_rotvec()
            np.testing.assert_allclose(half, 0.5 * np.pi * lead, atol=1e-9)
            np.testing.assert_allclose(motion.at(T).R, motion.T1.R, atol=1e-14)


class TestCircle:
    @pytest.mark.parametrize("orientation", ["keep", "turn"])
    @pytest.mark.parametrize("angle", [2.0 * np.pi, -0.5, 7.0, 0.0])
    def test_it_stays_on_the_circle_with_exact_rates(self, orientation: str, angle: float, scaling: str) -> None:
        motion = ring(angle=angle, orientation=orientation, scaling=scaling)
        assert_exact_rates(motion, INSIDE, second=1e-4)  # seven radians in two seconds: larger third derivatives
        rows = motion.rows(INSIDE)
        spokes = rows.p - START.p - [0.0, 0.1, 0.0]
        np.testing.assert_allclose(np.linalg.norm(spokes, axis=1), 0.1, atol=1e-14)
        np.testing.assert_allclose(spokes @ [1.0, 0.0, 0.0], 0.0, atol=1e-14)
        end = START.R if orientation == "keep" else Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix() @ START.R
        np.testing.assert_allclose(motion.at(T).R, end, atol=1e-13)

    def test_it_goes_about_its_axis_by_the_right_hand_rule(self) -> None:
        quarter = ring(angle=0.5 * np.pi).at(T)
        np.testing.assert_allclose(quarter.p, START.p + np.array([0.0, 0.1, -0.1]), atol=1e-15)

    def test_an_axis_of_any_length_will_do(self) -> None:
        for size in (1e-300, 1e-3, 1e300):
            np.testing.assert_allclose(ring(axis=[size, 0.0, 0.0]).at(0.7).p, ring().at(0.7).p, atol=1e-15)


class TestLimits:
    @pytest.mark.parametrize(
        "limits",
        [
            ((0.1, 9.0), (9.0, 9.0)),
            ((9.0, 0.2), (9.0, 9.0)),
            ((9.0, 9.0), (0.3, 9.0)),
            ((9.0, 9.0), (9.0, 0.3)),
            ((0.3, 0.9), (0.6, 2.0)),
        ],
    )
    @pytest.mark.parametrize(
        "make",
        [
            lambda **o: straight(POSES["generic"], **o),
            lambda **o: ring(orientation="turn", **o),
        ],
        ids=["line", "circle"],
    )
    def test_the_fastest_motion_reaches_one_of_them_and_keeps_all(self, make: Any, limits: Any, scaling: str) -> None:
        motion = make(duration=None, velocity=limits[0], acceleration=limits[1], scaling=scaling)
        rows = motion.rows(np.linspace(0.0, motion.duration, 4001))
        parts = [
            np.linalg.norm(x[:, part], axis=1).max()
            for x in (rows.twist, rows.acceleration)
            for part in (slice(3), slice(3, 6))
        ]
        used = np.array(parts) / np.array([*limits[0], *limits[1]])
        assert used.max() <= 1.0 + 1e-9
        # A trapezoid on a curve leaves room for both parts of its acceleration.
        least = 0.7 if scaling == "trapezoidal" and not isinstance(motion, taut.trajectories.Line) else 0.999
        assert used.max() > least

    def test_a_motion_to_where_it_is_takes_no_time_and_rests(self, scaling: str) -> None:
        motion = straight(START, duration=None, velocity=(1.0, 1.0), acceleration=(1.0, 1.0), scaling=scaling)
        assert motion.duration == 0.0
        assert not motion.rows(np.linspace(-1.0, 1.0, 5)).twist.any()
        np.testing.assert_allclose(motion.at(0.3).R, START.R, atol=1e-15)


WAY = [
    START,
    away([0.3, 0.0, 0.0], [0.1, 0.0, 0.0]),
    away([0.3, 1.0, 0.0], [0.1, 0.1, 0.0]),
    away([0.0, 0.4, 2.0], [0.0, 0.1, 0.2]),
]
KNOTS = [0.0, 0.6, 1.1, 2.0]


class TestSamples:
    @pytest.mark.parametrize("count", [2, 3, 4])
    def test_they_go_through_their_poses_with_exact_rates(self, count: int) -> None:
        motion = taut.trajectories.TaskSamples(times=KNOTS[:count], poses=WAY[:count])
        for t, pose in zip(KNOTS[:count], WAY, strict=False):
            np.testing.assert_allclose(motion.at(t).p, pose.p, atol=1e-14)
            np.testing.assert_allclose(motion.at(t).R, pose.R, atol=1e-13)
        assert_exact_rates(motion, INSIDE)

    def test_a_spline_starts_and_ends_at_rest_and_its_acceleration_is_continuous(self) -> None:
        motion = taut.trajectories.TaskSamples(times=KNOTS, poses=WAY)
        assert motion.duration == 2.0
        for t in (-0.5, 0.0, 2.0, 2.5):
            np.testing.assert_allclose(motion.at(t).twist, 0.0, atol=1e-14)
        for t in KNOTS[1:-1]:
            near, far = motion.at(t - 1e-9), motion.at(t + 1e-9)
            np.testing.assert_allclose(near.twist, far.twist, atol=1e-6)
            np.testing.assert_allclose(near.acceleration, far.acceleration, atol=1e-5)

    @pytest.mark.parametrize("order", ["xyzw", "wxyz", "rpy"])
    def test_a_csv_file_says_the_order_of_its_rotation_in_the_header(self, order: str, tmp_path: Path) -> None:
        names = {"xyzw": "qx, qy, qz, qw", "wxyz": "qw, qx, qy, qz", "rpy": "roll, pitch, yaw"}[order]
        lines = [f"t, x, y, z, {names}"]
        lines += [
            ", ".join(map(repr, [t, *pose.p.tolist(), *getattr(pose, order).tolist()]))
            for t, pose in zip(KNOTS, WAY, strict=True)
        ]
        file = tmp_path / "way.csv"
        file.write_text("\n".join(lines))
        read = taut.trajectories.TaskSamples.from_csv(file)
        given = taut.trajectories.TaskSamples(times=KNOTS, poses=WAY)
        for name in FIELDS:
            np.testing.assert_allclose(
                getattr(read.rows(INSIDE), name), getattr(given.rows(INSIDE), name), atol=1e-11
            )


POINT = {"T0": START, "T1": START}
NOT_A_POSE: Any = [0.4, 0.0, 0.3]
REFUSED: list[tuple[Any, type[Exception]]] = [
    (lambda: taut.trajectories.Line(T0=NOT_A_POSE, T1=START, duration=1.0), taut.errors.UsageError),
    (lambda: taut.trajectories.Line(**POINT), taut.errors.UsageError),
    (lambda: taut.trajectories.Line(**POINT, velocity=(1.0, 1.0)), taut.errors.UsageError),
    (lambda: ring(acceleration=(1.0, 1.0)), taut.errors.UsageError),
    (lambda: taut.trajectories.Line(**POINT, velocity=0.5, acceleration=(1.0, 1.0)), taut.errors.ShapeError),
    (lambda: taut.trajectories.Line(**POINT, velocity=(0.5, 0.0), acceleration=(1.0, 1.0)), taut.errors.RangeError),
    (lambda: taut.trajectories.Line(**POINT, duration=0.0), taut.errors.RangeError),
    (lambda: taut.trajectories.Line(**POINT, duration=1.0, scaling="min-jerk"), taut.errors.UsageError),
    (
        lambda: straight(POSES["pure translation"], duration=0.1, velocity=(0.1, 1.0), acceleration=(1.0, 1.0)),
        taut.errors.UsageError,
    ),
    (lambda: ring(axis=[0.0, 0.0, 0.0]), taut.errors.RangeError),
    (lambda: ring(centre=START.p), taut.errors.RangeError),
    (lambda: ring(centre=[0.41, 0.0, 0.3]), taut.errors.RangeError),
    (lambda: ring(angle=-360), taut.errors.RangeError),
    (lambda: ring(orientation="free"), taut.errors.UsageError),
    (lambda: straight(START).at(np.nan), taut.errors.RangeError),
    (lambda: taut.trajectories.TaskSamples(times=[0.0], poses=[NOT_A_POSE]), taut.errors.UsageError),
    (lambda: taut.trajectories.TaskSamples(times=[0.0, 1.0], poses=[START]), taut.errors.ShapeError),
    (lambda: taut.trajectories.TaskSamples(times=[0.0, 0.0], poses=[START, START]), taut.errors.RangeError),
    (lambda: taut.trajectories.TaskSamples(times=[], poses=[]), taut.errors.ShapeError),
]


@pytest.mark.parametrize(("make", "kind"), REFUSED, ids=range(len(REFUSED)))
def test_bad_input_is_refused_in_one_sentence(make: Any, kind: type[Exception]) -> None:
    with refused(kind):
        make()


@pytest.mark.parametrize(
    "text",
    [
        "x, y\n",
        "t, x, y, z\n0, 1, 2, 3\n",
        "t, x, y, z, roll, pitch\n",
        "t, x, y, z, qx, qy, qz, qw\n0, 1, 2, 3, 0, 0, 0, 2\n",
    ],
)
def test_a_csv_file_that_holds_no_poses_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "way.csv"
    file.write_text(text)
    with refused(taut.errors.FileError):
        taut.trajectories.TaskSamples.from_csv(file)
