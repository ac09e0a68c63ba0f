"""The task side of a run: poses against the snapshot, errors against closed forms, and everything it is kept in."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from scipy.spatial.transform import Rotation

import taut
from taut.maths.model import Chain, model_of
from taut.record.metrics import METRICS
from taut.record.plain import plain, restored
from taut.record.run_plot import is_task_run

FIELDS = ("p", "R", "twist", "acceleration")


OF_JOINTS = ("overshoot", "settling_time", "steady_state_error", "rms_error", "peak_error", "final_error")
OF_TOOL = ("task_rms", "task_peak", "task_final", "task_rms_rotation", "task_peak_rotation", "min_singular_value")


def six_joints() -> taut.Arm:
    """Three slides and a wrist."""
    slides, hinges = np.vstack([np.zeros((3, 3)), np.eye(3)]), np.vstack([np.eye(3)[::-1], np.zeros((3, 3))])
    return taut.Arm.from_screws(np.stack([np.eye(4)] * 7), np.stack([np.eye(6)] * 6), np.hstack([slides, hinges]))


ARM = six_joints()


class Spring(taut.Law):
    """A spring and damper of the tool in the world, without the weight."""

    reference = taut.TaskMotion
    k: taut.Gain  # [N/m, N m/rad]
    tool: str | None = None

    def command(self, x: taut.Snapshot, ref: taut.TaskMotion) -> taut.Torque:
        T = x.T(self.tool)
        turned = T.R.T @ ref.R
        w = 0.5 * taut.math.array(
            [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
        )
        e = taut.math.array([*(ref.p - T.p), *(T.R @ w)])
        return taut.Torque(task=x.J(self.tool).T @ (self.k @ e + 20.0 * (ref.twist - x.twist(self.tool))), g=x.g)


T0 = taut.snapshot(ARM, np.zeros(6)).T()
LINE = taut.trajectories.Line(T0=T0, T1=taut.Pose([0.1, 0.05, -0.1], rpy=[0.1, -0.2, 0.3]), duration=0.3)


@pytest.fixture(scope="module")
def run() -> taut.Run:
    ctrl = taut.compile(Spring(k=200.0), ARM)
    return taut.run(ctrl, taut.RigidPlant(ARM), LINE, duration=0.5)


def test_a_chain_is_where_the_snapshot_says_for_every_frame_of_every_built_in_arm() -> None:
    rng = np.random.default_rng(0)
    arms = [ARM, *(taut.load_arm(name) for name in ("one_joint", "planar3", "gantry3"))]
    arms.append(taut.load_arm("planar2", T_WB=taut.Pose([0.1, 0.2, 0.3], rpy=[0.3, -0.4, 0.5])))
    for arm in arms:
        q, v = rng.standard_normal((2, 5, arm.n))
        for frame in arm.frame_names:
            chain = restored(Chain, plain(Chain.of(model_of(arm), frame)), "chain")
            assert chain.frame == frame
            R, p = chain.poses(q)
            J = chain.jacobians(q)
            for k in range(5):
                x = taut.snapshot(arm, q[k], v[k])
                np.testing.assert_allclose(R[k], x.T(frame).R, atol=1e-14)
                np.testing.assert_allclose(p[k], x.T(frame).p, atol=1e-14)
                np.testing.assert_allclose(J[k], x.J(frame), atol=1e-14)


class TestTaskSide:
    def test_it_is_what_the_snapshot_says_at_each_tick(self, run: taut.Run) -> None:
        task = run.task
        assert task.frame == "tool"
        assert repr(task) == "TaskSide(frame 'tool', 501 ticks)"
        for k in (0, 100, 300, 500):
            x = taut.snapshot(ARM, run.q[k], run.v[k])
            np.testing.assert_allclose(task.p[k], x.T().p, atol=1e-14)
            np.testing.assert_allclose(task.R[k], x.T().R, atol=1e-14)
            np.testing.assert_allclose(task.twist[k], x.twist(), atol=1e-13)
            least = np.linalg.svd(x.J())[1][-1]
            np.testing.assert_allclose(task.min_singular_value[k], least, atol=1e-13)
        assert task.min_singular_value.shape == (501,)

    def test_errors_are_wanted_minus_true_in_world_axes(self, run: taut.Run) -> None:
        position, rotation = run.task.position_error, run.task.rotation_error
        assert position is not None
        assert rotation is not None
        for k in (50, 250):
            sample = LINE.at(run.t[k])
            np.testing.assert_allclose(position[k], sample.p - run.task.p[k], atol=1e-14)
            expected = Rotation.from_matrix(sample.R @ run.task.R[k].T).as_rotvec()
            np.testing.assert_allclose(rotation[k], expected, atol=1e-12)
        assert np.abs(position).max() > 1e-4

    def test_a_law_that_controls_another_frame_is_measured_there(self) -> None:
        ctrl = taut.compile(Spring(k=200.0, tool="link3"), ARM)
        out = taut.run(ctrl, taut.RigidPlant(ARM), taut.hold(), duration=0.01, q0=[0.1, 0, 0, 0.5, 0, 0])
        assert out.task.frame == "link3"
        np.testing.assert_allclose(out.task.R, np.broadcast_to(np.eye(3), (11, 3, 3)), atol=1e-12)

    def test_it_is_there_for_joint_motions_too_without_errors(self) -> None:
        ctrl = taut.compile(taut.laws.PID(kp=1.0), ARM)
        out = taut.run(ctrl, taut.RigidPlant(ARM), taut.JointMotion(q=np.zeros(6)), duration=0.01)
        np.testing.assert_allclose(out.task.p[0], T0.p)
        assert out.task.position_error is None
        assert out.task.rotation_error is None
        assert all(np.isnan(out.metrics.overall(name)) for name in OF_TOOL)
        assert not is_task_run(out)

    def test_a_run_that_was_made_by_hand_says_that_it_does_not_know(self, make_run: Any) -> None:
        made = make_run([0.0, 1.0], [[0.0], [0.0]])
        with refused(taut.errors.UsageError):
            made.task  # noqa: B018


class TestMetrics:
    def test_they_are_norms_of_the_errors_and_joints_have_none(self, run: taut.Run) -> None:
        m, task = run.metrics, run.task
        position, rotation = (np.linalg.norm(x, axis=1) for x in (task.position_error, task.rotation_error))  # type: ignore[arg-type]
        assert m.task_rms == pytest.approx(np.sqrt(np.mean(position**2)))
        assert m.task_peak == pytest.approx(position.max())
        assert m.task_rms_rotation == pytest.approx(np.sqrt(np.mean(rotation**2)))
        assert m.task_peak_rotation == pytest.approx(rotation.max())
        assert m.min_singular_value == pytest.approx(task.min_singular_value.min())
        np.testing.assert_array_equal([m.final_x, m.final_y, m.final_z], task.p[-1])
        assert np.isnan([m.peak_force, m.peak_moment]).all()  # nothing recorded a force
        assert run.error is None
        for name in OF_JOINTS:
            assert np.isnan(m.overall(name))
            assert m.json()[name]["overall"] is None
        assert m.json()["task_peak"] == {"unit": "m", "overall": m.task_peak}
        assert m.unit("task_peak_rotation") == "rad"
        assert m.by_unit("task_peak", "joint1") == {"m": m.task_peak}

    def test_forces_are_measured_where_they_are_recorded(self, make_run: Any) -> None:
        F_ext = np.array([[0.0, 3.0, 4.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 2.0, -1.0, 2.0]])
        m = make_run([0.0, 1.0], [[0.0], [0.0]], extra={"F_ext": F_ext}).metrics
        assert (m.peak_force, m.peak_moment, m.moment_rms) == (5.0, 3.0, pytest.approx(np.sqrt(4.5)))
        assert (m.min_force, m.force_rms) == (1.0, pytest.approx(np.sqrt(13.0)))

    def test_what_a_tool_slips_is_along_its_own_y_axis(self, run: taut.Run) -> None:
        along = [R[:, 1] @ V[:3] for R, V in zip(run.task.R, run.task.twist, strict=True)]
        assert run.metrics.lateral_speed_rms == pytest.approx(np.sqrt(np.mean(np.square(along))))
        assert run.metrics.lateral_speed_rms > 1e-4

    def test_the_table_has_a_row_for_each_number_of_the_tool(self, run: taut.Run) -> None:
        rows = {row[0]: row[1] for row in run.metrics.content().tables[0].rows}
        for name in OF_TOOL:
            assert rows[METRICS[name].title] == run.metrics[name]

    def test_an_arm_that_is_stretched_out_has_none_of_its_smallest_singular_value(self) -> None:
        class Nothing(taut.Law):
            reference = taut.TaskMotion

            def command(self, x: taut.Snapshot, ref: taut.TaskMotion) -> taut.Torque:
                return taut.Torque(none=0.0 * x.q)

        arm = taut.load_arm("planar2")
        out = taut.run(taut.compile(Nothing(), arm), taut.RigidPlant(arm), duration=0.001, q0=[0.3, 0.0])
        assert out.metrics.min_singular_value == pytest.approx(
            np.linalg.svd(taut.snapshot(arm, [0.3, 0.0]).J())[1][-1], rel=1e-3
        )


class TestKept:
    def test_logs_read_back_exactly_with_their_task_side(self, run: taut.Run, tmp_path: Path) -> None:
        ctrl = taut.compile(Spring(k=200.0), ARM)
        direct = taut.run(ctrl, taut.RigidPlant(ARM), LINE, duration=0.5, log=tmp_path / "direct.mcap")
        for path in (run.save(tmp_path / "run.mcap"), tmp_path / "direct.mcap"):
            again = taut.load_run(path)
            assert isinstance(again.reference, taut.TaskMotion)
            for name in FIELDS:
                np.testing.assert_array_equal(getattr(again.reference, name), getattr(direct.reference, name))
            np.testing.assert_array_equal(again.task.p, run.task.p)
            assert again.metrics.json() == run.metrics.json()

    def test_tables_have_the_reference(self, run: taut.Run, tmp_path: Path) -> None:
        with run.to_csv(tmp_path / "run.csv").open() as file:
            rows = csv.DictReader(file)
            first = [row for _, row in zip(range(101), rows, strict=False)][100]
        assert float(first["reference.p.1"]) == run.reference.p[100, 1]  # type: ignore[attr-defined]
        assert float(first["reference.R.2.0"]) == run.reference.R[100, 2, 0]  # type: ignore[attr-defined]
        assert float(first["reference.twist.5"]) == run.reference.twist[100, 5]  # type: ignore[attr-defined]
        assert float(first["reference.acceleration.0"]) == run.reference.acceleration[100, 0]  # type: ignore[attr-defined]

    def test_a_stretch_of_a_run_keeps_its_task_side(self, run: taut.Run) -> None:
        part = run.between(0.1, 0.2)
        np.testing.assert_array_equal(part.task.p, run.task.p[100:201])
        assert part.metrics.task_peak <= run.metrics.task_peak

    def test_a_film_has_the_wanted_way_of_the_tool(self, run: taut.Run) -> None:
        from taut.record.film import _wanted

        ticks = np.array([0, 100, 300])
        np.testing.assert_allclose(_wanted(run, ARM, ticks), LINE.rows(run.t[ticks]).p)
        held = taut.run(taut.compile(Spring(k=200.0), ARM), taut.RigidPlant(ARM), duration=0.01)
        assert _wanted(held, ARM, np.array([0])).shape == (0, 3)


class TestDrawn:
    def test_a_plot_shows_the_tool_and_both_errors(self, run: taut.Run) -> None:
        figure = run.plot()
        titles = [ax.get_title(loc="left") for part in figure.subfigs for ax in part.axes]
        assert titles[:3] == ["tool and reference", "position error", "rotation error"]
        assert "velocity" in titles
        position, rotation = run.task.position_error, run.task.rotation_error
        assert position is not None
        assert rotation is not None
        for ax, values in zip(figure.subfigs[0].axes[1:], (position, rotation), strict=True):
            drawn = [line.get_ydata() for line in ax.lines if len(np.atleast_1d(line.get_ydata())) > 2]
            assert len(drawn) == 3
            for i, shown in enumerate(drawn):
                assert np.abs(np.asarray(shown)).max() == pytest.approx(
                    np.abs(values[:, i]).max(), rel=0.05, abs=1e-12
                )

    def test_runs_of_the_task_are_compared_by_their_errors(self, run: taut.Run) -> None:
        from taut.record.comparison_plot import compare

        soft = taut.run(taut.compile(Spring(k=50.0), ARM), taut.RigidPlant(ARM), LINE, duration=0.5)
        figure = compare({"stiff": run, "soft": soft})
        titles = [ax.get_title(loc="left") for part in figure.subfigs for ax in part.axes]
        assert titles[:2] == ["norm of the tool's position error", "angle of the tool's rotation error"]
        assert "task RMS [m]" in titles
        assert "rotation RMS [rad]" in titles


def test_a_run_that_was_touched_shows_force_and_moment() -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(taut.laws.GravityPID(kp=100.0, kd=10.0), arm)
    push = taut.environments.Push(peak=[5.0, 0.0, 0.0, 0.0, 0.0, 0.0], t=0.1, duration=0.1)
    pushed = taut.run(ctrl, taut.RigidPlant(arm, environment=push), duration=0.3).plot()
    free = taut.run(ctrl, taut.RigidPlant(arm), duration=0.3).plot()
    titles = [ax.get_title(loc="left") for ax in pushed.axes]
    assert {"force on the arm", "moment on the arm"} <= set(titles)
    assert "force on the arm" not in [ax.get_title(loc="left") for ax in free.axes]
