"""Calibration of a wrist sensor: the numbers back from readings, how well they are known, and when they are not."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

import taut
from taut.base.types import Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of

Array = Float64Array
BIAS = np.array([4.0, -7.0, 12.0, 0.3, -0.5, 0.2])
TOOL = taut.Payload(mass=0.73, com=(0.01, -0.02, 0.06), inertia=(1e-3, 1e-3, 5e-4, 0.0, 0.0, 0.0))
NOISE = (0.1, 0.005)
SIX = np.repeat(NOISE, 3)
G = np.array([0.0, 0.0, -9.81])
ARMS = ["planar2", "panda", "ur10", "kinova", "z1", "xarm7"]  # the last two no other test of this looked at


def by_hand(R: Array, mass: float = TOOL.mass, com: Any = TOOL.com, g: Array = G) -> Array:
    """Bias and weight in the sensor's axes, written out."""
    weight = mass * (R.T @ g)
    return BIAS + np.concatenate([weight, np.cross(com, weight)])


def turned(*rpys: tuple[float, float, float]) -> list[taut.Pose]:
    return [taut.Pose(rpy=rpy) for rpy in rpys]


SPREAD_OUT = turned((0, 0, 0), (1.2, 0, 0), (0, 1.1, 0), (-1.0, 0.5, 0.3), (2.2, 0.1, 1.0))


def read_by(poses: list[taut.Pose], seed: int | None = None, **options: Any) -> Array:
    F = np.array([by_hand(np.asarray(T.R), **options) for T in poses])
    return F if seed is None else F + SIX * np.random.default_rng(seed).standard_normal(F.shape)


# -------------------------------------------------------------------- the numbers


def test_readings_without_noise_give_back_every_number() -> None:
    found = taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), poses=SPREAD_OUT)
    np.testing.assert_allclose(found.bias, BIAS, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose([found.mass, *found.com], [TOOL.mass, *TOOL.com], rtol=0.0, atol=1e-13)
    assert max(found.mass_std, *found.com_std, *found.bias_std, *found.residual) < 1e-12
    assert found.poses == 5


def test_the_numbers_are_those_of_numpys_least_squares() -> None:
    F = read_by(SPREAD_OUT, seed=1)
    found = taut.analysis.calibrate_wrist(F, poses=SPREAD_OUT)
    A, y = [], []
    for T, row in zip(SPREAD_OUT, F, strict=True):  # all ten at once, with m c as unknown
        g = np.asarray(T.R).T @ G
        A.append(np.block([
            [np.eye(3), np.zeros((3, 3)), g[:, np.newaxis], np.zeros((3, 3))],
            [np.zeros((3, 3)), np.eye(3), np.zeros((3, 1)), np.cross(np.eye(3), g).T],
        ]))  # fmt: skip
        y.append(row)
        np.testing.assert_allclose(A[-1][3:, 7:] @ [1.0, 2.0, 3.0], np.cross([1.0, 2.0, 3.0], g), atol=1e-12)
    x = np.linalg.lstsq(np.vstack(A), np.concatenate(y), rcond=None)[0]
    np.testing.assert_allclose([*found.bias, found.mass, *found.com * found.mass], x, rtol=0.0, atol=1e-12)


def test_the_stated_uncertainty_is_that_of_many_calibrations() -> None:
    many = [taut.analysis.calibrate_wrist(read_by(SPREAD_OUT, seed=k), poses=SPREAD_OUT) for k in range(400)]
    for name in ("bias", "mass", "com"):
        values = np.array([getattr(found, name) for found in many])
        stated = np.sqrt(np.mean([np.square(getattr(found, f"{name}_std")) for found in many], axis=0))
        np.testing.assert_allclose(values.std(axis=0), stated, rtol=0.12)  # of 400 draws: 3.5 % each
        truth = {"bias": BIAS, "mass": TOOL.mass, "com": TOOL.com}[name]
        assert (np.abs(values.mean(axis=0) - truth) < 4.0 * stated / 20.0).all(), name


def test_a_sensor_without_a_tool_gives_its_bias_alone() -> None:
    found = taut.analysis.calibrate_wrist(read_by(SPREAD_OUT, seed=3, mass=0.0), poses=SPREAD_OUT)
    assert (found.mass, found.com.tolist(), np.isinf(found.com_std).all()) == (0.0, [0.0] * 3, True)
    np.testing.assert_allclose(found.bias, read_by(SPREAD_OUT, seed=3, mass=0.0).mean(axis=0), rtol=1e-12)
    assert 0.0 < found.mass_std < 0.05
    exact = taut.analysis.calibrate_wrist(read_by(SPREAD_OUT, mass=0.0), poses=SPREAD_OUT)
    assert exact.mass == 0.0
    taut.Sensing(wrist=found.wrist)


def test_gravity_may_point_anywhere() -> None:
    g = np.array([3.0, -2.0, 8.0])
    found = taut.analysis.calibrate_wrist(read_by(SPREAD_OUT, g=g), poses=SPREAD_OUT, gravity=g)
    np.testing.assert_allclose([found.mass, *found.com], [TOOL.mass, *TOOL.com], rtol=1e-12)


def test_each_number_stands_in_the_table_with_its_uncertainty() -> None:
    found = taut.analysis.calibrate_wrist(read_by(SPREAD_OUT, seed=0), poses=SPREAD_OUT)
    rows = found.json()["tables"][""]
    assert [row["quantity"].split()[0] for row in rows] == ["mass", *["com"] * 3, *["bias"] * 6]
    assert [row["standard deviation"] for row in rows[1:4]] == pytest.approx(found.com_std)


# -------------------------------------------------------------------- readings of plants


class Feels(taut.Law):
    """Holds still, and asks for the wrench so that a run records it."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(
            hold=x.M @ (100.0 * x.difference(ref.q) - 20.0 * x.v) + x.h, none=0.0 * x.q + 0.0 * x.F_ext[0]
        )


def plant_of(kind: str, arm: taut.Arm, wrench: taut.sensors.WrenchSensor) -> Any:
    sensors = taut.sensors.Sensors(wrench=wrench)
    if kind == "mujoco":
        return taut.MujocoPlant(arm, sensors=sensors, friction=None)
    return taut.RigidPlant(arm, sensors=sensors, friction=None)


@pytest.mark.parametrize(("name", "kind"), [("panda", "rigid"), ("xarm7", "mujoco")])
def test_a_noisy_sensor_is_calibrated_in_suggested_poses_and_its_law_then_feels_contact_alone(
    name: str, kind: str
) -> None:
    arm = taut.load_arm(name)
    plant = plant_of(kind, arm, taut.sensors.WrenchSensor(bias=BIAS, noise=NOISE, tool=TOOL))
    ctrl = taut.compile(Feels(), arm)
    poses, readings, stood = taut.analysis.calibration_poses(arm, count=6), [], []
    for k, q in enumerate(poses):
        out = taut.run(ctrl, plant, taut.JointMotion(q=q), q0=q, duration=0.05, seed=k)
        readings.append(out.extra["sensed.F_ext"][1:])
        stood.append(out.q[1:])
    F, q = np.vstack(readings), np.vstack(stood)
    found = taut.analysis.calibrate_wrist(F, arm=arm, q=q, axes="world", range=(200.0, 20.0))
    for got, truth, std in (
        (found.bias, BIAS, found.bias_std),
        (found.mass, TOOL.mass, found.mass_std),
        (found.com, TOOL.com, found.com_std),
    ):
        assert (np.abs(got - truth) < 4.0 * np.asarray(std)).all()
    assert found.mass_std < 2e-3  # [kg], of 300 readings with 0.1 N
    np.testing.assert_allclose(found.residual, SIX, rtol=0.2)
    sensing = taut.Sensing(wrist=found.wrist, F_ext=taut.sensors.LowPass(cutoff=5.0))
    free = taut.run(
        taut.compile(Feels(), arm, sensing=sensing), plant, taut.JointMotion(q=poses[3]), q0=poses[3], duration=0.3
    )
    felt = free.extra["sensed.F_ext"][200:].mean(axis=0)
    assert np.abs(felt[:3]).max() < 0.15  # [N], of 14 N that the sensor reads
    assert np.abs(felt[3:]).max() < 0.02  # [N m]


USERS = """<mujoco><option gravity="0.3 -0.2 -9.7"/><worldbody><body pos="0 0 0.5">
  <joint name="a" axis="0 0 1"/><geom size="0.05" mass="2"/>
  <body pos="0.3 0 0"><joint name="b" axis="0 1 0"/><geom size="0.05" mass="1.5"/>
   <body pos="0.3 0 0" euler="10 20 30"><joint name="c" axis="1 0 0"/><geom size="0.04" mass="1"/>
    <body name="wrist" pos="0.1 0.02 -0.03" euler="-30 40 10"/>
   </body></body></body></worldbody></mujoco>"""


def test_mujocos_own_force_sensor_at_a_users_tool_is_calibrated() -> None:
    """Nothing of taut's plants: a tool body in an MjSpec, and the sensors of the site between arm and tool."""
    spec = mujoco.MjSpec.from_string(USERS)
    wrist = spec.body("wrist")
    wrist.add_site(name="ft", quat=[0.5, 0.5, -0.5, 0.5])
    tool = wrist.add_body(name="gripper", pos=[0.01, 0.02, 0.05], quat=[0.8, 0.6, 0.0, 0.0])
    tool.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.03, 0.04], pos=[0.0, 0.01, 0.03], mass=0.55)
    tool.add_geom(size=[0.02, 0.0, 0.0], pos=[0.05, 0.0, 0.0], mass=0.2)
    for kind in ("FORCE", "TORQUE"):
        spec.add_sensor(
            name=kind,
            type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname="ft",
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    rng, readings, poses = np.random.default_rng(11), [], []
    for _ in range(6):
        data.qpos[:] = rng.uniform(-1.5, 1.5, 3)
        mujoco.mj_forward(model, data)
        data.qfrc_applied[:] = data.qfrc_bias  # at rest: what gravity asks for
        mujoco.mj_forward(model, data)
        assert np.abs(data.qacc).max() < 1e-9
        readings.append(BIAS - data.sensordata)  # parent on child, the arm on the tool: the other sign
        site = data.site("ft")
        poses.append(taut.Pose(p=site.xpos, R=site.xmat.reshape(3, 3)))
    found = taut.analysis.calibrate_wrist(readings, poses=poses, gravity=model.opt.gravity)
    R, p = poses[-1].R, poses[-1].p
    centre = data.subtree_com[model.body("gripper").id]
    np.testing.assert_allclose(found.mass, 0.75, rtol=1e-9)
    np.testing.assert_allclose(found.com, R.T @ (centre - p), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.bias, BIAS, rtol=0.0, atol=1e-9)
    with pytest.raises(taut.errors.RangeError) as caught:
        taut.analysis.calibrate_wrist(-np.array(readings), poses=poses, gravity=model.opt.gravity)
    assert caught.value.value == pytest.approx(-0.75)


def test_a_sensor_at_the_flange_is_calibrated_in_its_own_frame() -> None:
    panda = taut.load_arm("panda")
    arm = panda.with_tool(panda.tool, taut.Pose(p=[0.02, 0.0, 0.11], rpy=[0.3, -0.7, 1.1]), name="tip")
    plant = plant_of("rigid", arm, taut.sensors.WrenchSensor(bias=BIAS, tool=TOOL, frame=panda.tool))
    numbers, poses = plant.parameters, taut.analysis.calibration_poses(arm, count=4, frame=panda.tool)
    F = [plant.measure(plant.start(q, np.zeros(7), numbers, 1e-3), {}, numbers)["F_ext"] for q in poses]
    found = taut.analysis.calibrate_wrist(F, arm=arm, q=poses, axes="world", frame=panda.tool)
    np.testing.assert_allclose(found.bias, BIAS, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(found.com, TOOL.com, rtol=0.0, atol=1e-12)
    assert found.wrist.frame == panda.tool
    in_sensor = [by_hand(np.asarray(taut.snapshot(arm, q).T(panda.tool).R), g=arm.gravity) for q in poses]
    again = taut.analysis.calibrate_wrist(in_sensor, arm=arm, q=poses, frame=panda.tool)
    np.testing.assert_allclose(again.com, found.com, rtol=0.0, atol=1e-12)


# -------------------------------------------------------------------- poses


@pytest.mark.parametrize("name", ARMS)
def test_suggested_poses_are_within_limits_can_be_held_and_tell_all_numbers(name: str) -> None:
    arm = taut.load_arm(name)
    poses = taut.analysis.calibration_poses(arm, count=7)
    assert poses.shape == (7, arm.n)
    np.testing.assert_array_equal(poses[0], arm.home)
    np.testing.assert_array_equal(poses, taut.analysis.calibration_poses(arm, count=7))
    assert (poses >= arm.lower).all()
    assert (poses <= arm.upper).all()
    assert np.abs(poses - arm.home).max() <= 1.5
    load = PayloadValues(mass=arm.payload.mass, com=arm.payload.com, inertia=arm.payload.inertia)
    for q in poses[1:]:
        assert (np.abs(dyn.gravity_torque(model_of(arm), q, load)) <= arm.effort).all()
    found = taut.analysis.calibrate_wrist(
        [by_hand(np.asarray(taut.snapshot(arm, q).T().R), g=arm.gravity) for q in poses], arm=arm, q=poses
    )
    assert found.condition < 2.5
    assert min(found.spread) > 0.4


def test_suggested_poses_do_better_than_drawn_ones() -> None:
    arm = taut.load_arm("panda")
    chosen = taut.analysis.calibration_poses(arm, count=5)
    rng, drawn = np.random.default_rng(0), []
    for _ in range(20):
        q = np.clip(arm.home + rng.uniform(-1.5, 1.5, (5, 7)), arm.lower, arm.upper)
        F = [by_hand(np.asarray(taut.snapshot(arm, row).T().R)) for row in q]
        drawn.append(taut.analysis.calibrate_wrist(F, arm=arm, q=q).condition)
    F = [by_hand(np.asarray(taut.snapshot(arm, row).T().R)) for row in chosen]
    condition = taut.analysis.calibrate_wrist(F, arm=arm, q=chosen).condition
    assert condition < 1.05 * min(drawn)
    assert condition < 0.9 * np.median(drawn)


# -------------------------------------------------------------------- what is not determined


def message(make: Callable[[], object], kind: type[taut.TautError]) -> str:
    with pytest.raises(kind) as caught:
        make()
    return str(caught.value)


@pytest.mark.parametrize("poses", [turned((0, 0, 0)), turned(*[(0, 0, yaw) for yaw in (0.0, 0.7, 2.0, 3.0)])])
def test_poses_that_do_not_turn_against_gravity_are_refused_with_what_would_help(poses: list[taut.Pose]) -> None:
    F = read_by(poses)
    k = len(poses)
    text = message(lambda: taut.analysis.calibrate_wrist(F, poses=poses), taut.errors.NumericalError)
    assert f"the {k} poses" in text
    assert "such as (1.00, 0.00, 0.00)" in text


def test_two_directions_of_gravity_leave_the_centre_open_along_a_line_and_the_pose_that_is_named_helps() -> None:
    poses = turned((0, 0, 0), (1.0, 0, 0), (1.0, 0, 0))  # gravity along -z, and turned in the plane of y and z
    text = message(lambda: taut.analysis.calibrate_wrist(read_by(poses), poses=poses), taut.errors.NumericalError)
    assert "com along (0.00, 0.88, -0.48)" in text
    assert "gravity points along (1.00, 0.00, 0.00)" in text
    # What is said to be open is open: a centre moved along that line, with another bias moment, reads the same.
    u = [np.asarray(T.R).T @ G for T in poses]
    along = (u[1] - u[0]) / np.linalg.norm(u[1] - u[0])
    np.testing.assert_allclose(np.abs(along), [0.0, 0.88, 0.48], atol=5e-3)
    shift = [np.cross(0.1 * along, TOOL.mass * row) for row in u]
    np.testing.assert_allclose(shift, [shift[0]] * 3, rtol=0.0, atol=1e-14)
    more = [*poses, taut.Pose(rpy=(0.0, np.pi / 2, 0.0))]
    found = taut.analysis.calibrate_wrist(read_by(more), poses=more)
    np.testing.assert_allclose(found.com, TOOL.com, rtol=0.0, atol=1e-12)


CASES: list[tuple[Callable[[], object], type[taut.TautError], str]] = [
    (lambda: taut.analysis.calibrate_wrist([1.0] * 6, poses=SPREAD_OUT), taut.errors.ShapeError, "wrenches"),
    (lambda: taut.analysis.calibrate_wrist([[np.nan] * 6], poses=SPREAD_OUT), taut.errors.RangeError, "wrenches"),
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT)), taut.errors.UsageError, "arm"),
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), arm=taut.load_arm("planar2")), taut.errors.UsageError, "q"),
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), arm=taut.load_arm("planar2"), q=[[0.0, 0.0]]), taut.errors.ShapeError, "q"),
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), arm=taut.load_arm("planar2"), poses=SPREAD_OUT), taut.errors.UsageError, "poses"),
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), arm="panda", q=[0.0]), taut.errors.UsageError, "arm"),  # type: ignore[arg-type]
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), poses=SPREAD_OUT, frame="tool"), taut.errors.UsageError, "frame"),
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), poses=SPREAD_OUT, axes="world"), taut.errors.UsageError, "axes"),
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), poses=SPREAD_OUT, axes="tool"), taut.errors.UsageError, "axes"),  # type: ignore[arg-type]
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), poses=SPREAD_OUT[:3]), taut.errors.ShapeError, "poses"),
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), poses=[np.eye(4)] * 5), taut.errors.UsageError, "poses"),  # type: ignore[list-item]
    (lambda: taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), poses=SPREAD_OUT, gravity=[0.0] * 3), taut.errors.RangeError, "gravity"),
    (lambda: taut.analysis.calibrate_wrist(np.clip(read_by(SPREAD_OUT), -9.0, 9.0), poses=SPREAD_OUT, range=(9.0, 9.0)), taut.errors.RangeError, "wrenches"),
    (lambda: taut.analysis.calibration_poses(taut.load_arm("planar2"), count=2), taut.errors.RangeError, "count"),
    (lambda: taut.analysis.calibration_poses(taut.load_arm("planar2"), count=2.5), taut.errors.RangeError, "count"),  # type: ignore[arg-type]
    (lambda: taut.analysis.calibration_poses(taut.load_arm("planar2"), travel=0.0), taut.errors.RangeError, "travel"),
    (lambda: taut.analysis.calibration_poses(taut.load_arm("gantry3")), taut.errors.NumericalError, "arm"),
    (lambda: taut.analysis.calibration_poses(taut.load_arm("planar2").with_joints(effort=1e-3)), taut.errors.NumericalError, "arm"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "kind", "name"), CASES, ids=range(len(CASES)))
def test_bad_input_is_refused_by_name(make: Callable[[], object], kind: type[taut.TautError], name: str) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert (caught.value.name or "").startswith(name)


def test_the_result_makes_a_wrist_whose_other_numbers_are_replaced() -> None:
    wrist = dataclasses.replace(
        taut.analysis.calibrate_wrist(read_by(SPREAD_OUT), poses=SPREAD_OUT).wrist, range=(200.0, 10.0)
    )
    assert wrist.range is not None
    np.testing.assert_allclose(wrist.bias, BIAS, rtol=0.0, atol=1e-12)
