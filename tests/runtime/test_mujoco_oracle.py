"""The MuJoCo model that is built from an Arm, against the Arm's own dynamics."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from mujoco_arms import states, torso

import taut
from taut.arm.builtin import BUILT_IN
from taut.arm.catalogue import CATALOGUE
from taut.arm.description import Arm
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of

TIGHT = 1e-8  # what the project promises; the largest error met is 1e-12
ARMS = [*BUILT_IN, *CATALOGUE, "torso"]


def load(name: str) -> Arm:
    return torso() if name == "torso" else taut.load_arm(name)


@pytest.mark.parametrize("name", ARMS)
def test_mass_matrix_bias_and_tool_jacobian_are_the_arms_own(name: str) -> None:
    arm = load(name).with_payload(0.7, com=(0.02, -0.03, 0.1), inertia=(3e-3, 2e-3, 4e-3, 1e-4, -2e-4, 3e-4))
    plant, constants = taut.MujocoPlant(arm), model_of(arm)
    load_values = PayloadValues(mass=arm.payload.mass, com=arm.payload.com, inertia=arm.payload.inertia)
    model, data, n = plant.model, plant.data, arm.n
    order = [int(model.jnt_dofadr[model.joint(joint).id]) for joint in arm.joint_names]
    M, Jp, Jr = np.zeros((n, n)), np.zeros((3, n)), np.zeros((3, n))
    for q, v in states(arm):
        plant.reset(q, v, 1e-3)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        mujoco.mj_jacSite(model, data, Jp, Jr, model.site(arm.tool).id)
        expected = dyn.mass_matrix(constants, q, load_values)
        scale = max(1.0, float(np.abs(expected).max()))
        assert np.abs(M[np.ix_(order, order)] - expected).max() < TIGHT * scale
        assert np.abs(data.qfrc_bias[order] - dyn.bias(constants, q, v, load_values)).max() < TIGHT * 100.0
        J = dyn.jacobian(constants, q)
        assert np.abs(np.vstack([Jp, Jr])[:, order] - J).max() < TIGHT
        T_WE = dyn.pose(constants, q)
        assert np.abs(data.site(arm.tool).xpos - T_WE.p).max() < TIGHT
        assert np.abs(data.site(arm.tool).xmat.reshape(3, 3) - T_WE.R).max() < TIGHT


@pytest.mark.parametrize("name", ["panda", "fr3", "z1", "gantry3", "torso"])
def test_friction_limits_and_rotors_are_the_arms_own(name: str) -> None:
    arm = load(name)
    model = taut.MujocoPlant(arm).model
    for joint in arm.joints:
        made = model.joint(joint.name)
        assert made.damping[0] == joint.viscous
        assert made.frictionloss[0] == joint.coulomb
        assert made.armature[0] == joint.rotor_inertia
        assert bool(model.jnt_limited[made.id]) == bool(np.isfinite(joint.lower))
        if np.isfinite(joint.lower):
            assert made.range.tolist() == [joint.lower, joint.upper]
    free = taut.MujocoPlant(arm, friction=None, limits=None).model
    assert not free.dof_damping.any()
    assert not free.dof_frictionloss.any()
    assert not free.jnt_limited.any()


def test_bodies_joints_motors_site_and_sensors_have_the_names_of_the_arm() -> None:
    arm = taut.load_arm("panda")
    model = taut.MujocoPlant(arm).model
    assert [model.joint(j).name for j in range(model.njnt)] == list(arm.joint_names)
    assert [model.actuator(a).name for a in range(model.nactuator)] == list(arm.joint_names)
    assert [model.body(b).name for b in range(model.nbody)] == [
        "world",
        *(f"panda_link{i}" for i in range(1, 8)),
        "payload",
    ]
    assert [model.sensor(s).name for s in range(model.nsensor)] == ["panda_hand_tcp_force", "panda_hand_tcp_torque"]


def test_shapes_have_no_mass_and_only_touching_ones_touch() -> None:
    arm = taut.load_arm("ur5")
    plain = taut.MujocoPlant(arm, scene='<geom size="0.1" pos="9 9 9"/>').model
    assert np.allclose(plain.body_mass.sum(), arm.total_mass)
    ours = plain.geom_bodyid != 0
    assert not plain.geom_contype[ours].any()  # two geoms of the arm never meet
    assert set(plain.geom_conaffinity[ours & (plain.geom_group == 3)]) == {1}
    assert set(plain.geom_conaffinity[ours & (plain.geom_group == 2)]) == {0}
