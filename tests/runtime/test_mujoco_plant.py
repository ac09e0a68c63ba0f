"""MujocoPlant in free space, against RigidPlant: two engines, one scheme."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco_arms import idle, torso
from refusals import refused

import taut
from taut.maths import dynamics as dyn
from taut.maths.model import model_of

SAME = 1e-9  # of rad and m after a second of swinging; two codes with the same scheme differ by rounding, about 1e-12
CHAOS = 1e-8  # with dry friction, where each transition from sliding to sticking passes rounding on


def load(name: str) -> taut.Arm:
    return torso() if name == "torso" else taut.load_arm(name)


def largest(a: taut.Run, b: taut.Run) -> float:
    assert len(a) == len(b)
    return float(max(np.abs(a.q - b.q).max(), np.abs(a.v - b.v).max()))


# -------------------------------------------------------------------- free swing


@pytest.mark.part(2)
@pytest.mark.parametrize("name", ["one_joint", "planar3", "gantry3", "panda", "ur10", "torso"])
def test_a_free_swing_is_rigid_plants_to_rounding(name: str) -> None:
    arm = load(name)
    v0 = 0.2 * np.ones(arm.n)
    ours = taut.run(idle(arm), taut.RigidPlant(arm), duration=1.0, v0=v0)
    theirs = taut.run(idle(arm), taut.MujocoPlant(arm, limits=None), duration=1.0, v0=v0)
    assert np.abs(ours.q - arm.home).max() > 0.05
    assert largest(ours, theirs) < SAME


def test_substeps_of_one_are_time_steps_of_the_other() -> None:
    arm = torso()
    ours = taut.run(idle(arm, 250.0), taut.RigidPlant(arm, substeps=8), duration=1.0)
    theirs = taut.run(idle(arm, 250.0), taut.MujocoPlant(arm, timestep=0.0005), duration=1.0)
    assert largest(ours, theirs) < SAME


# -------------------------------------------------------------------- dry friction


def test_dry_friction_is_rigid_plants() -> None:
    arm = taut.load_arm("fr3")
    ours = taut.run(idle(arm), taut.RigidPlant(arm), duration=1.0)
    theirs = taut.run(idle(arm), taut.MujocoPlant(arm, limits=None), duration=1.0)
    assert np.abs(ours.q - arm.home).max() > 1.0
    assert largest(ours, theirs) < CHAOS


def test_dry_friction_is_rigid_plants_where_joints_stick_and_slip_together() -> None:
    arm = taut.load_arm("z1")
    ours = taut.run(idle(arm), taut.RigidPlant(arm), duration=0.3)
    theirs = taut.run(idle(arm), taut.MujocoPlant(arm, limits=None), duration=0.3)
    assert np.abs(ours.q - arm.home).max() > 0.05
    assert largest(ours, theirs) < 1e-6


@pytest.mark.part(1)
@pytest.mark.parametrize("model", ["z1", "so101", "panda", "xarm7", "kinova"])
def test_joints_that_all_break_away_at_once_move_as_in_mujoco(model: str) -> None:
    """Gravity is a hundredth more than static friction in every joint; which of them slip decides the others."""
    arm = taut.load_arm(model)
    static = np.maximum(np.abs(dyn.gravity_torque(model_of(arm), arm.home)) / 1.01, 0.02)
    arm = arm.with_friction(taut.Friction(coulomb=0.6 * static, static=static, stribeck=0.05, viscous=0.1))
    ours = taut.run(idle(arm), taut.RigidPlant(arm), duration=0.3)
    theirs = taut.run(idle(arm), taut.MujocoPlant(arm, limits=None), duration=0.3)
    assert np.abs(ours.q - arm.home).max() > 0.05
    np.testing.assert_allclose(ours.q, theirs.q, rtol=0.0, atol=5e-9)


def loaded_to(share: float) -> taut.Arm:
    """A Panda whose dry friction is so large that gravity takes this share of it in every joint."""
    arm = taut.load_arm("panda")
    gravity = np.abs(dyn.gravity_torque(model_of(arm), arm.home))
    return arm.with_joints(coulomb=np.maximum(gravity / share, 0.02))


def test_an_arm_that_its_friction_can_hold_does_not_creep() -> None:
    arm = loaded_to(0.49)
    out = taut.run(idle(arm), taut.MujocoPlant(arm), duration=3.0)
    assert np.abs(out.q - arm.home).max() < 1e-15
    assert np.abs(out.v).max() < 1e-15


def test_an_arm_that_its_friction_cannot_hold_slides() -> None:
    arm = loaded_to(1.02)
    out = taut.run(idle(arm), taut.MujocoPlant(arm), duration=0.5)
    assert np.abs(out.q - arm.home).max() > 1e-3


# -------------------------------------------------------------------- closed loop


def test_a_closed_loop_runs_the_same_on_both_plants() -> None:
    model = taut.load_arm("panda")
    truth = model.perturbed(seed=3, mass=0.1, com=0.005).with_payload(1.0, com=(0.0, 0.0, 0.05))
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), model)
    ref = taut.trajectories.Quintic(q0=model.home, q1=model.home + 0.3, duration=0.8)
    ours = taut.run(ctrl, taut.RigidPlant(truth), ref, duration=1.0)
    theirs = taut.run(ctrl, taut.MujocoPlant(truth), ref, duration=1.0)
    assert largest(ours, theirs) < SAME
    assert np.abs(ours.tau - theirs.tau).max() < 1e-6  # [N m], of 60
    assert np.array_equal(theirs.tau, theirs.command)


def test_a_run_is_repeated_bit_by_bit() -> None:
    arm = taut.load_arm("fr3")
    plant = taut.MujocoPlant(
        arm, scene='<geom type="plane" size="1 1 1"/><body pos="1 0 1"><freejoint/><geom size=".1"/></body>'
    )
    a, b = (taut.run(idle(arm), plant, duration=0.7) for _ in range(2))
    assert np.array_equal(a.q, b.q)
    assert np.array_equal(a.extra["F_ext"], b.extra["F_ext"])


def test_measured_torque_is_that_of_the_last_tick() -> None:
    arm = taut.load_arm("planar2")
    plant = taut.MujocoPlant(arm)
    plant.reset(arm.home, np.zeros(2), 1e-3)
    np.testing.assert_allclose(plant.measure()["tau_meas"], taut.snapshot(arm, arm.home).g, rtol=1e-14)  # its brakes
    assert plant.measure()["F_ext"].tolist() == [0.0] * 6
    acted = plant.advance(np.array([1.0, -2.0]))
    assert acted.tolist() == [1.0, -2.0]
    arrived = acted - arm.viscous * plant.state()[1]  # a sensor behind the friction
    np.testing.assert_allclose(plant.measure()["tau_meas"], arrived, rtol=1e-12)


# -------------------------------------------------------------------- parameters


def test_a_payload_given_at_run_time_is_one_built_in() -> None:
    arm = torso()
    load = {"mass": 1.3, "com": [0.05, -0.1, 0.2], "inertia": [0.02, 0.03, 0.04, 0.003, -0.002, 0.001]}
    built = taut.run(idle(arm), taut.MujocoPlant(arm.with_payload(*load.values())), duration=0.5)
    plant = taut.MujocoPlant(arm)
    for name, value in load.items():
        plant.set_parameters({f"plant.payload.{name}": value})
    assert largest(taut.run(idle(arm), plant, duration=0.5), built) < 1e-12
    other = taut.MujocoPlant(arm.with_payload(*load.values())).model
    for constant in ("body_subtreemass", "dof_invweight0", "body_invweight0"):  # what contacts are scaled by
        assert np.allclose(getattr(plant.model, constant), getattr(other, constant), rtol=1e-12)
    plant.set_parameters({"plant.payload.inertia": np.zeros(6)})
    plant.set_parameters({"plant.payload.mass": 0.0})
    empty = taut.run(idle(arm), taut.RigidPlant(arm), duration=0.5)
    assert largest(taut.run(idle(arm), plant, duration=0.5), empty) < SAME
    assert largest(empty, built) > 1e-3


def test_a_payload_that_is_dropped_in_a_run_is_dropped_in_both_and_back_afterwards() -> None:
    arm = torso().with_payload(1.0, com=(0.0, 0.0, 0.1))
    plant = taut.MujocoPlant(arm)
    events = [taut.Event(t=0.2, set={"plant.payload.mass": 0.0, "plant.friction.viscous": [0.1] * 5})]
    ours = taut.run(idle(arm), taut.RigidPlant(arm), duration=0.5, events=events)
    theirs = taut.run(idle(arm), plant, duration=0.5, events=events)
    assert largest(ours, theirs) < SAME
    assert plant.parameters["plant.payload.mass"] == 1.0
    again = taut.run(idle(arm), plant, duration=0.5)
    assert largest(again, taut.run(idle(arm), taut.RigidPlant(arm), duration=0.5)) < SAME


def test_dry_friction_can_be_changed_in_a_run() -> None:
    arm = taut.load_arm("fr3")
    events = [taut.Event(t=0.1, set={"plant.friction.coulomb": 1e3})]
    out = taut.run(idle(arm), taut.MujocoPlant(arm), duration=0.3, events=events)
    assert np.abs(out.v[90]).max() > 0.1
    assert np.abs(out.v[150:]).max() < 1e-12


# -------------------------------------------------------------------- what the plant adds


@pytest.mark.part(1)
@pytest.mark.parametrize("load", [None, taut.Payload(mass=0.5, com=(0.0, 0.1, 0.0))])
def test_what_the_plant_adds_is_what_rigid_plant_adds(load: taut.Payload | None) -> None:
    arm = torso().with_payload(2.0)
    adds = {"gravity": load, "coriolis": None, "friction": None}
    ctrl = taut.compile(taut.laws.PID(kp=5.0, kd=0.5), arm, rate=500.0, adds=taut.RigidPlant(arm, adds=adds).adds)
    ref = taut.JointMotion(q=arm.home + 0.2)
    ours = taut.run(ctrl, taut.RigidPlant(arm, adds=adds, substeps=2), ref, duration=0.4)
    theirs = taut.run(ctrl, taut.MujocoPlant(arm, adds=adds, timestep=0.001), ref, duration=0.4)
    assert largest(ours, theirs) < SAME
    assert np.abs(ours.tau - theirs.tau).max() < SAME


def test_a_law_that_compensates_what_the_plant_adds_is_refused() -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(taut.laws.GravityPID(kp=10.0, kd=1.0), arm)
    with refused(taut.errors.MatchError):
        taut.run(ctrl, taut.MujocoPlant(arm, adds=("gravity",)), duration=0.1)


# -------------------------------------------------------------------- limits and time


def test_joint_limits_push_back() -> None:
    arm = taut.load_arm("panda")
    out = taut.run(idle(arm), taut.MujocoPlant(arm), duration=2.0)
    beyond = np.maximum(out.q - arm.upper, arm.lower - out.q).max()
    assert np.abs(out.v).max() > 20.0  # it slams into them
    assert 0.0 < beyond < 0.06
    free = taut.run(idle(arm), taut.MujocoPlant(arm, limits=None), duration=2.0)
    assert np.maximum(free.q - arm.upper, arm.lower - free.q).max() > 0.3


@pytest.mark.parametrize(
    ("rate", "timestep", "steps"), [(1000.0, None, 1), (4000.0, None, 1), (300.0, None, 4), (500.0, 0.001, 2)]
)
def test_a_control_period_is_a_whole_number_of_time_steps(rate: float, timestep: float | None, steps: int) -> None:
    arm = taut.load_arm("one_joint")
    plant = taut.MujocoPlant(arm, timestep=timestep)
    taut.run(idle(arm, rate), plant, duration=10.0 / rate)
    assert plant.model.opt.timestep == pytest.approx(1.0 / rate / steps, rel=1e-12)
    assert plant.data.time == pytest.approx(11.0 / rate, rel=1e-9)


# -------------------------------------------------------------------- what goes wrong


@pytest.mark.parametrize("kp", [1e5, 1e9, 1e200])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_run_that_diverges_ends_so_and_keeps_what_came_before(
    kp: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arm = taut.load_arm("panda")
    plant = taut.MujocoPlant(arm)
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=kp, kd=kp / 10.0), arm)
    out = taut.run(ctrl, plant, taut.JointMotion(q=arm.home + 0.1), duration=1.0)
    assert out.outcome.kind == "diverged"
    assert out.outcome.joint in arm.joint_names
    assert out.outcome.tick == len(out) - 1 < 20
    assert np.isfinite(out.q).all()
    assert plant.data.time == pytest.approx(len(out) * 1e-3)  # never put back to the start
    assert not list(tmp_path.iterdir())  # MuJoCo would leave MUJOCO_LOG.TXT


def test_a_plant_is_as_new_after_a_run_that_diverged() -> None:
    arm = taut.load_arm("planar2")
    plant = taut.MujocoPlant(arm)
    before = taut.run(idle(arm), plant, duration=0.2)
    bad = taut.compile(taut.laws.PID(kp=1e9), arm)
    assert not taut.run(bad, plant, taut.JointMotion(q=arm.home + 1.0), duration=0.2).outcome.ok
    assert largest(taut.run(idle(arm), plant, duration=0.2), before) == 0.0


def test_a_body_of_the_scene_that_diverges_ends_the_run() -> None:
    arm = taut.load_arm("planar2")
    scene = """<body name="wheel" pos="3 0 0"><joint name="hub"/><geom size="0.1"/></body>
               <actuator><general joint="hub" gainprm="0" biastype="affine" biasprm="1e13 0 0"/></actuator>"""
    out = taut.run(idle(arm), taut.MujocoPlant(arm, scene=scene), duration=0.1)
    assert out.outcome.kind == "diverged"
    assert out.outcome.joint is None
    assert "QACC at DOF 2" in out.outcome.message


def test_every_warning_of_mujoco_ends_a_run_in_words() -> None:
    arm = taut.load_arm("planar2")
    plant = taut.MujocoPlant(arm)
    seen = set()
    for kind in range(int(mujoco.mjtWarning.mjNWARNING)):
        plant.reset(arm.home, np.zeros(2), 1e-3)
        assert plant.trouble() is None
        plant.data.warning.number[kind] = 1
        words, _ = plant.trouble()
        seen.add(words)
        plant.reset(arm.home, np.zeros(2), 1e-3)
    assert len(seen) == int(mujoco.mjtWarning.mjNWARNING)
    assert not any("mjWARN" in words for words in seen)


def test_somebody_elses_listener_hears_mujocos_warnings() -> None:
    heard: list[str] = []
    arm = taut.load_arm("planar2")
    plant = taut.MujocoPlant(arm)
    mujoco.set_mju_user_warning(heard.append)
    try:
        taut.run(taut.compile(taut.laws.PID(kp=1e9), arm), plant, taut.JointMotion(q=arm.home + 1.0), duration=0.1)
        assert mujoco.get_mju_user_warning() == heard.append
    finally:
        mujoco.set_mju_user_warning(None)
    assert "The simulation is unstable" in heard[0]


def test_mujoco_is_loaded_when_a_plant_is_made_and_not_before() -> None:
    code = "import sys, taut; taut.MujocoPlant; assert 'mujoco' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
