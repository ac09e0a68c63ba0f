"""MujocoPlant.attach: an arm inside a simulation of the user's, with everything else left alone."""

from __future__ import annotations

import warnings
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco_arms import MOTORS, PAIR, cell, idle, pair
from refusals import refused, warned

import taut

SAME = 1e-9  # of rad after half a second; two codes with the same scheme differ by rounding
LAW = taut.laws.ComputedTorque(kp=60.0, kd=15.0)


def scene(text: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def attached(arm: taut.Arm, text: str) -> taut.MujocoPlant:
    return taut.MujocoPlant.attach(*scene(text), arm, "left_")


def reach(arm: taut.Arm, plant: taut.MujocoPlant | taut.RigidPlant, rate: float = 1000.0) -> taut.Run:
    ref = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + np.array([0.4, -0.6]), duration=0.4)
    return taut.run(taut.compile(LAW, arm, rate=rate), plant, ref, duration=0.5)


@pytest.mark.parametrize(
    "actuators", [MOTORS, MOTORS.replace('<motor name="b" joint="left_elbow" gear="-2"/>', ""), ""]
)
def test_an_attached_arm_runs_as_rigid_plant_does(tmp_path: Path, actuators: str) -> None:
    arm = pair(tmp_path)
    plant = attached(arm, cell(actuators))
    theirs, ours = reach(arm, plant), reach(arm, taut.RigidPlant(arm))
    assert np.abs(theirs.q - ours.q).max() < SAME
    assert np.abs(theirs.tau - theirs.command).max() < 1e-12
    assert not theirs.extra["tau_cut"].any()
    used = {plant.model.actuator(a).name for a in range(plant.model.nactuator)} & {"a", "b"}
    driven = plant.data.qfrc_actuator[[int(plant.model.joint(f"left_{j}").dofadr[0]) for j in arm.joint_names]]
    assert (driven != 0.0).sum() == len(used)  # the others get theirs through qfrc_applied


def test_everything_else_is_left_alone(tmp_path: Path) -> None:
    arm = pair(tmp_path)
    text = cell()
    model, data = scene(text)
    plant = taut.MujocoPlant.attach(model, data, arm, "left_")
    alone, other = scene(text)  # the same scene stepped by hand, with the left arm under the torques of the run
    names = ["box", "door", "right_shoulder", "right_elbow"]
    for m, d in ((model, data), (alone, other)):
        for _ in range(100):
            mujoco.mj_step(m, d)
        d.ctrl[m.actuator("door").id] = 0.7
        d.ctrl[m.actuator("right_shoulder").id] = 0.3
        d.qfrc_applied[m.joint("box").dofadr[0]] = 2.0
        d.mocap_pos[0] = [1.0, 2.0, 3.0]
        d.userdata[:] = 0.0
    before = {
        field: np.array(getattr(model, field))
        for field in ("body_mass", "jnt_range", "actuator_gainprm", "dof_solref")
    }
    flags, time = int(model.opt.disableflags), data.time
    out = reach(arm, plant)
    assert data.time == pytest.approx(time + len(out) * 1e-3)
    assert int(model.opt.disableflags) == flags
    assert model.opt.timestep == 0.001
    for field, value in before.items():
        assert np.array_equal(getattr(model, field), value)
    assert data.ctrl[model.actuator("door").id] == 0.7
    assert data.mocap_pos[0].tolist() == [1.0, 2.0, 3.0]
    rows = [int(alone.jnt_qposadr[alone.joint(f"left_{j}").id]) for j in arm.joint_names]
    dofs = [int(alone.jnt_dofadr[alone.joint(f"left_{j}").id]) for j in arm.joint_names]
    other.qpos[rows], other.qvel[dofs] = arm.home, 0.0
    for tau in out.command:
        other.ctrl[alone.actuator("a").id], other.ctrl[alone.actuator("b").id] = tau[0] / 15.0, tau[1] / -2.0
        mujoco.mj_step(alone, other)
    for name in names:
        assert np.abs(data.joint(name).qpos - other.joint(name).qpos).max() == 0.0
    assert abs(data.joint("right_shoulder").qpos[0] - 0.3) < 0.3  # its own servo holds it
    assert data.joint("box").qpos[2] < 0.5  # the box falls


@pytest.mark.parametrize(
    "actuators", [MOTORS, MOTORS.replace('<motor name="b" joint="left_elbow" gear="-2"/>', "")], ids=["two", "one"]
)
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_run_leaves_controls_and_applied_forces_as_they_were(tmp_path: Path, actuators: str) -> None:
    arm = pair(tmp_path)
    plant = attached(arm, cell(actuators))
    data = plant.data
    data.ctrl[:] = 0.1 + np.arange(plant.model.nu)
    data.qfrc_applied[:] = 0.01 * np.arange(plant.model.nv)
    ctrl, applied = data.ctrl.copy(), data.qfrc_applied.copy()

    def breaks_off(x: taut.Snapshot) -> taut.JointMotion:
        if x.t > 0.05:
            raise KeyboardInterrupt
        return taut.JointMotion(q=x.q + 0.1)

    assert reach(arm, plant).outcome.ok
    assert np.array_equal(data.ctrl, ctrl)
    assert np.array_equal(data.qfrc_applied, applied)
    with pytest.raises(KeyboardInterrupt):
        taut.run(taut.compile(LAW, arm), plant, taut.stream(period=0.01, source=breaks_off), duration=1.0)
    wild = taut.run(taut.compile(taut.laws.PID(kp=1e7), arm), plant, taut.JointMotion(q=arm.home + 1.0), duration=1.0)
    assert wild.outcome.kind == "diverged"
    assert np.array_equal(data.ctrl, ctrl)
    assert np.array_equal(data.qfrc_applied, applied)


def test_a_run_starts_where_it_is_told_and_the_scene_goes_on(tmp_path: Path) -> None:
    arm = pair(tmp_path)
    plant = attached(arm, cell())
    first = taut.run(idle(arm), plant, duration=0.1)
    here, speed = plant.state()
    box = plant.data.joint("box").qpos.copy()
    second = taut.run(idle(arm), plant, duration=0.1, q0=here, v0=speed)
    assert np.array_equal(second.q[0], here)
    assert plant.data.joint("box").qpos[2] < box[2] < 0.5
    assert np.abs(first.q[-1] - second.q[0]).max() < 0.1


def test_f_ext_is_what_touches_the_tool(tmp_path: Path) -> None:
    arm = pair(tmp_path)
    plant = attached(arm, cell())
    plant.reset(arm.home, np.zeros(2), 1e-3)
    plant.advance(np.zeros(2))
    assert not plant.measure()["F_ext"].any()
    wrench = np.array([3.0, -4.0, 5.0, 0.6, 0.7, -0.8])
    hand = plant.model.body("left_hand").id
    plant.data.xfrc_applied[hand] = wrench
    plant.advance(np.zeros(2))
    arm_of_force = plant.data.xipos[hand] - plant.data.site("left_tcp").xpos
    expected = np.concatenate([wrench[:3], wrench[3:] + np.cross(arm_of_force, wrench[:3])])
    assert np.abs(plant.measure()["F_ext"] - expected).max() < 1e-12


def test_a_floor_pushes_the_tool_up(tmp_path: Path) -> None:
    arm = pair(tmp_path)
    plant = attached(arm, cell())
    out = taut.run(idle(arm), plant, duration=2.0)
    assert plant.data.geom("left_tip").xpos[2] < 0.05
    assert out.extra["F_ext"][-1, 2] > 1.0


def test_what_an_actuator_cuts_off_is_told_and_recorded(tmp_path: Path) -> None:
    arm = pair(tmp_path)
    weak = MOTORS.replace('gear="-2"', 'gear="-2" ctrlrange="-0.2 0.2"')
    plant = attached(arm, cell(weak))
    with warned(RuntimeWarning) as told:
        out = reach(arm, plant)
    assert len(told) == 1
    assert np.abs(out.tau[:, 1]).max() == pytest.approx(0.4)
    assert np.abs(out.extra["tau_cut"] - (out.command - out.tau)).max() < 1e-12
    assert np.abs(out.extra["tau_cut"][:, 1]).max() > 0.5
    limited = taut.compile(LAW, arm, limits=taut.Limits(tau=[100.0, 0.39]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        taut.run(limited, plant, taut.JointMotion(q=arm.home + 0.3), duration=0.2)


def test_a_joint_that_lets_less_through_cuts_too(tmp_path: Path) -> None:
    arm = pair(tmp_path)
    left = PAIR.format("left_", 1).replace('axis="0 0.6 0.8"', 'axis="0 0.6 0.8" actuatorfrcrange="-0.25 0.25"')
    plant = attached(arm, cell(left=left))
    with warned(RuntimeWarning):
        out = reach(arm, plant)
    assert np.abs(out.tau[:, 1]).max() == 0.25


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_diverging_run_ends_without_putting_the_scene_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arm = pair(tmp_path)
    plant = attached(arm, cell())
    out = taut.run(
        taut.compile(taut.laws.PID(kp=1e7, kd=1e5), arm), plant, taut.JointMotion(q=arm.home + 1.0), duration=1.0
    )
    assert out.outcome.kind == "diverged"
    assert out.outcome.joint in arm.joint_names
    assert plant.data.time == pytest.approx(len(out) * 1e-3)
    assert not int(plant.model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_a_model_with_gravcomp_is_a_plant_that_adds_gravity(tmp_path: Path) -> None:
    arm = pair(tmp_path)
    left = PAIR.format("left_", 1)
    for name in ("upper", "fore", "hand"):
        left = left.replace(f'name="left_{name}"', f'name="left_{name}" gravcomp="1"')
    plant = attached(arm, cell(left=left))
    assert plant.adds.names == ("gravity",)
    ctrl = taut.compile(LAW, arm, adds=plant.adds)
    theirs = taut.run(ctrl, plant, taut.JointMotion(q=arm.home + 0.2), duration=0.3)
    ours = taut.run(ctrl, taut.RigidPlant(arm, adds=("gravity",)), taut.JointMotion(q=arm.home + 0.2), duration=0.3)
    assert np.abs(theirs.q - ours.q).max() < SAME
    with refused(taut.errors.MatchError):
        taut.run(taut.compile(LAW, arm), plant, duration=0.1)


def test_a_payload_of_the_arm_counts_where_the_model_has_it_too(tmp_path: Path) -> None:
    arm = pair(tmp_path).with_payload(0.5, com=(0.0, 0.0, 0.1))
    with refused(taut.errors.MatchError):
        attached(arm, cell())
    cup = '<site name="left_tcp" pos="0.05 0 0" euler="0 30 0"/><body pos="0.05 0 0" euler="0 30 0"><inertial pos="0 0 0.1" mass="0.5" diaginertia="0 0 0"/></body>'
    left = PAIR.format("left_", 1).replace('<site name="left_tcp" pos="0.05 0 0" euler="0 30 0"/>', cup)
    theirs = reach(arm, attached(arm, cell(left=left)))
    assert np.abs(theirs.q - reach(arm, taut.RigidPlant(arm)).q).max() < SAME


def test_both_arms_of_a_cell_can_be_attached(tmp_path: Path) -> None:
    arm = pair(tmp_path)
    model, data = scene(
        cell().replace("<position", "<motor").replace(' kp="200" kv="20"', "").replace(' kp="100" kv="10"', "")
    )
    left = taut.MujocoPlant.attach(model, data, arm, "left_")
    right = taut.MujocoPlant.attach(model, data, arm.mounted(taut.Pose((-1.0, 0.0, 0.0))), "right_")
    for plant in (left, right):
        plant.reset(arm.home, np.zeros(2), 1e-3)
    left.advance(np.array([1.0, 2.0]))
    assert left.measure()["tau_meas"].tolist() == [1.0, 2.0]
    assert right.state()[0].tolist() != arm.home.tolist()  # one step moves the whole scene


def test_the_arm_of_a_published_simulator_can_be_driven() -> None:
    file = resources.files("franky_sim") / "assets" / "fr3.xml"
    spec = mujoco.MjSpec.from_file(str(file))
    for geom in [geom for geom in spec.geoms if geom.meshname]:
        spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    locked = {"finger_joint1": 0.0, "finger_joint2": 0.0}
    arm = taut.load_arm(str(file), tool="hand", locked=locked, home=[0.0, -0.8, 0.0, -2.2, 0.0, 1.6, 0.8])
    model = spec.compile()
    with refused(taut.errors.MatchError):
        taut.MujocoPlant.attach(model, mujoco.MjData(model), arm)
    for actuator in spec.actuators:
        actuator.set_to_motor()
    model = spec.compile()
    plant = taut.MujocoPlant.attach(model, mujoco.MjData(model), arm)
    law = taut.laws.GravityPID(kp=[600, 600, 600, 600, 250, 150, 50], kd=[50, 50, 50, 50, 30, 20, 5])
    out = taut.run(taut.compile(law, arm, rate=500.0), plant, taut.JointMotion(q=arm.home), duration=0.5)
    assert out.outcome.ok
    assert np.abs(out.q - arm.home).max() < 1e-3  # its own weight is carried to the gram
    with refused(taut.errors.MatchError):
        taut.MujocoPlant.attach(model, mujoco.MjData(model), taut.load_arm("fr3"))
