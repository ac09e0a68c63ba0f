"""Calibration of a wrist sensor: the numbers back from readings, how well they are known, and when they are not."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from refusals import refused

import taut
from taut.base.types import Float64Array

Array = Float64Array
BIAS = np.array([4.0, -7.0, 12.0, 0.3, -0.5, 0.2])
TOOL = taut.Payload(mass=0.73, com=(0.01, -0.02, 0.06), inertia=(1e-3, 1e-3, 5e-4, 0.0, 0.0, 0.0))
NOISE = (0.1, 0.005)
SIX = np.repeat(NOISE, 3)
PANDA = taut.load_arm("panda")


def by_hand(R: Array, mass: float = TOOL.mass, com: Any = TOOL.com, g: Array = PANDA.gravity) -> Array:
    """Bias and weight in the sensor's axes, written out."""
    weight = mass * (R.T @ g)
    return BIAS + np.concatenate([weight, np.cross(com, weight)])


def tilted(arm: taut.Arm, *wrist: tuple[float, float, float]) -> Array:
    """Poses about home, with other values of the last three joints."""
    q = np.tile(arm.home, (len(wrist), 1))
    q[:, -3:] += wrist
    return np.asarray(q)


SPREAD_OUT = tilted(PANDA, (0, 0, 0), (1.2, 0, 0), (0, 1.1, 0), (-1.0, 0.5, 0.3), (2.2, 0.1, 1.0))


def rotations(q: Array, arm: taut.Arm = PANDA, frame: str | None = None) -> list[Array]:
    return [np.asarray(taut.snapshot(arm, row).T(frame).R) for row in q]


def read_by(q: Array, seed: int | None = None, arm: taut.Arm = PANDA, **options: Any) -> Array:
    F = np.array([by_hand(R, g=arm.gravity, **options) for R in rotations(q, arm)])
    return F if seed is None else F + SIX * np.random.default_rng(seed).standard_normal(F.shape)


def calibrated(F: Array, q: Array = SPREAD_OUT, arm: taut.Arm = PANDA) -> taut.analysis.WristCalibration:
    return taut.analysis.calibrate_wrist(F, arm, q=q)


# -------------------------------------------------------------------- the numbers


def test_readings_without_noise_give_back_every_number() -> None:
    found = calibrated(read_by(SPREAD_OUT))
    np.testing.assert_allclose(found.bias, BIAS, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose([found.mass, *found.com], [TOOL.mass, *TOOL.com], rtol=0.0, atol=1e-13)
    assert max(found.mass_std, *found.com_std, *found.bias_std, *found.residual) < 1e-12
    assert found.poses == 5


def test_the_numbers_are_those_of_numpys_least_squares() -> None:
    F = read_by(SPREAD_OUT, seed=1)
    found = calibrated(F)
    A, y = [], []
    for R, row in zip(rotations(SPREAD_OUT), F, strict=True):  # all ten at once, with m c as unknown
        g = R.T @ PANDA.gravity
        A.append(np.block([
            [np.eye(3), np.zeros((3, 3)), g[:, np.newaxis], np.zeros((3, 3))],
            [np.zeros((3, 3)), np.eye(3), np.zeros((3, 1)), np.cross(np.eye(3), g).T],
        ]))  # fmt: skip
        y.append(row)
        np.testing.assert_allclose(A[-1][3:, 7:] @ [1.0, 2.0, 3.0], np.cross([1.0, 2.0, 3.0], g), atol=1e-12)
    x = np.linalg.lstsq(np.vstack(A), np.concatenate(y), rcond=None)[0]
    np.testing.assert_allclose([*found.bias, found.mass, *found.com * found.mass], x, rtol=0.0, atol=1e-12)


def test_the_stated_uncertainty_is_that_of_many_calibrations() -> None:
    exact = read_by(SPREAD_OUT)
    noise = SIX * np.random.default_rng(0).standard_normal((400, *exact.shape))
    many = [calibrated(exact + each) for each in noise]
    for name in ("bias", "mass", "com"):
        values = np.array([getattr(found, name) for found in many])
        stated = np.sqrt(np.mean([np.square(getattr(found, f"{name}_std")) for found in many], axis=0))
        np.testing.assert_allclose(values.std(axis=0), stated, rtol=0.12)  # of 400 draws: 3.5 % each
        truth = {"bias": BIAS, "mass": TOOL.mass, "com": TOOL.com}[name]
        assert (np.abs(values.mean(axis=0) - truth) < 4.0 * stated / 20.0).all(), name


def test_a_sensor_without_a_tool_gives_its_bias_alone() -> None:
    found = calibrated(read_by(SPREAD_OUT, seed=3, mass=0.0))
    assert (found.mass, found.com.tolist(), np.isinf(found.com_std).all()) == (0.0, [0.0] * 3, True)
    np.testing.assert_allclose(found.bias, read_by(SPREAD_OUT, seed=3, mass=0.0).mean(axis=0), rtol=1e-12)
    assert 0.0 < found.mass_std < 0.05
    exact = calibrated(read_by(SPREAD_OUT, mass=0.0))
    assert exact.mass == 0.0
    taut.Sensing(wrist=found.wrist)


def test_gravity_may_point_anywhere() -> None:
    arm = PANDA.with_gravity([3.0, -2.0, 8.0])
    found = calibrated(read_by(SPREAD_OUT, arm=arm), arm=arm)
    np.testing.assert_allclose([found.mass, *found.com], [TOOL.mass, *TOOL.com], rtol=1e-12)


def test_each_number_stands_in_the_table_with_its_uncertainty() -> None:
    found = calibrated(read_by(SPREAD_OUT, seed=0))
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


@pytest.mark.part(1)
@pytest.mark.parametrize(("name", "kind"), [("panda", "rigid"), ("xarm7", "mujoco")])
def test_a_noisy_sensor_is_calibrated_and_its_law_then_feels_contact_alone(name: str, kind: str) -> None:
    arm = taut.load_arm(name)
    plant = plant_of(kind, arm, taut.sensors.WrenchSensor(bias=BIAS, noise=NOISE, tool=TOOL))
    ctrl = taut.compile(Feels(), arm)
    poses = tilted(arm, (0, 0, 0), (1.2, 0, 0), (0, 1.1, 0), (-1.0, 0.5, 0.3), (1.2, -1.0, 1.0), (0, -1.1, 0))
    readings, stood = [], []
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


def test_mujocos_own_force_sensor_at_a_users_tool_is_calibrated(tmp_path: Path) -> None:
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
    rng, readings, positions = np.random.default_rng(11), [], []
    for _ in range(6):
        data.qpos[:] = rng.uniform(-1.5, 1.5, 3)
        mujoco.mj_forward(model, data)
        data.qfrc_applied[:] = data.qfrc_bias  # at rest: what gravity asks for
        mujoco.mj_forward(model, data)
        assert np.abs(data.qacc).max() < 1e-9
        readings.append(BIAS - data.sensordata)  # parent on child, the arm on the tool: the other sign
        positions.append(data.qpos.copy())
    file = tmp_path / "users.xml"
    file.write_text(USERS)
    arm = taut.load_arm(file, tool="wrist")
    arm = arm.with_tool("wrist", taut.Pose(wxyz=[0.5, 0.5, -0.5, 0.5]), name="ft")
    found = taut.analysis.calibrate_wrist(readings, arm, q=positions)
    site = data.site("ft")
    centre = data.subtree_com[model.body("gripper").id]
    np.testing.assert_allclose(found.mass, 0.75, rtol=1e-9)
    np.testing.assert_allclose(found.com, site.xmat.reshape(3, 3).T @ (centre - site.xpos), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.bias, BIAS, rtol=0.0, atol=1e-9)
    with pytest.raises(taut.errors.RangeError) as caught:
        taut.analysis.calibrate_wrist(-np.array(readings), arm, q=positions)
    assert caught.value.value == pytest.approx(-0.75)


def test_a_sensor_at_the_flange_is_calibrated_in_its_own_frame() -> None:
    panda = PANDA
    arm = panda.with_tool(panda.tool, taut.Pose(p=[0.02, 0.0, 0.11], rpy=[0.3, -0.7, 1.1]), name="tip")
    plant = plant_of("rigid", arm, taut.sensors.WrenchSensor(bias=BIAS, tool=TOOL, frame=panda.tool))
    numbers, poses = plant.parameters, SPREAD_OUT
    F = [plant.measure(plant.start(q, np.zeros(7), numbers, 1e-3), {}, numbers)["F_ext"] for q in poses]
    found = taut.analysis.calibrate_wrist(F, arm=arm, q=poses, axes="world", frame=panda.tool)
    np.testing.assert_allclose(found.bias, BIAS, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(found.com, TOOL.com, rtol=0.0, atol=1e-12)
    assert found.wrist.frame == panda.tool
    in_sensor = [by_hand(R) for R in rotations(poses, arm, panda.tool)]
    again = taut.analysis.calibrate_wrist(in_sensor, arm=arm, q=poses, frame=panda.tool)
    np.testing.assert_allclose(again.com, found.com, rtol=0.0, atol=1e-12)


# -------------------------------------------------------------------- what is not determined


YAWS = np.outer([0.0, 0.7, 2.0, -1.0], np.eye(7)[0]) + PANDA.home  # about the vertical


@pytest.mark.parametrize(
    "q",
    [PANDA.home[np.newaxis], YAWS, tilted(PANDA, (0, 0, 0), (0, 1.0, 0), (0, 1.0, 0))],
    ids=["one", "yaw", "line"],
)
def test_poses_that_rotate_gravity_too_little_are_refused(q: Array) -> None:
    with refused(taut.errors.NumericalError):
        calibrated(read_by(q), q)


def test_a_third_direction_of_gravity_determines_the_centre() -> None:
    q = tilted(PANDA, (0, 0, 0), (0, 1.0, 0), (1.2, 0, 0))
    np.testing.assert_allclose(calibrated(read_by(q), q).com, TOOL.com, rtol=0.0, atol=1e-12)


READ = read_by(SPREAD_OUT)
CASES: list[tuple[Callable[[], object], type[taut.TautError], str]] = [
    (lambda: calibrated(np.ones(6)), taut.errors.ShapeError, "wrenches"),
    (lambda: calibrated(np.full((1, 6), np.nan)), taut.errors.RangeError, "wrenches"),
    (lambda: calibrated(READ, SPREAD_OUT[:3]), taut.errors.ShapeError, "q"),
    (lambda: calibrated(READ, arm="panda"), taut.errors.UsageError, "arm"),  # type: ignore[arg-type]
    (lambda: taut.analysis.calibrate_wrist(READ, PANDA, q=SPREAD_OUT, axes="tool"), taut.errors.UsageError, "axes"),  # type: ignore[arg-type]
    (lambda: calibrated(READ, arm=PANDA.with_gravity([0.0] * 3)), taut.errors.RangeError, "arm"),
    (
        lambda: taut.analysis.calibrate_wrist(np.clip(READ, -9.0, 9.0), PANDA, q=SPREAD_OUT, range=(9.0, 9.0)),
        taut.errors.RangeError,
        "wrenches",
    ),
]


@pytest.mark.parametrize(("make", "kind", "name"), CASES, ids=range(len(CASES)))
def test_bad_input_is_refused_by_name(make: Callable[[], object], kind: type[taut.TautError], name: str) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert (caught.value.name or "").startswith(name)


def test_the_result_makes_a_wrist_whose_other_numbers_are_replaced() -> None:
    wrist = dataclasses.replace(calibrated(READ).wrist, range=(200.0, 10.0))
    assert wrist.range is not None
    np.testing.assert_allclose(wrist.bias, BIAS, rtol=0.0, atol=1e-12)
