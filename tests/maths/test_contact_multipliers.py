"""Rigid contacts against Pinocchio's constrained dynamics and MuJoCo's constraints and contacts."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from maths_oracles import Oracle, catalogue_oracle

import taut
from taut import math as tm
from taut.base.types import Float64Array
from taut.maths.spatial import rotation_log

Array = Float64Array
WITHIN = 1e-6  # of max(1 N, |F|)
ARMS = ("panda", "ur5", "z1")


def held_point(T: taut.Pose) -> taut.Constraint:
    return taut.Constraint(lambda now: now.p - np.asarray(T.p))


def held_pose(T: taut.Pose) -> taut.Constraint:
    R = np.asarray(T.R)
    return taut.Constraint(lambda now: tm.array([*(now.p - np.asarray(T.p)), *rotation_log(now.R @ R.T)]))


def by_pinocchio(oracle: Oracle, kind: pin.ContactType, q: Array, v: Array, tau: Array) -> Array:
    """The forces of the world on the arm, in world axes, by Pinocchio's own constrained dynamics."""
    frame = oracle.model.frames[oracle.tool]
    T_WE = oracle.pose(q)
    held = pin.RigidConstraintModel(
        kind, oracle.model, frame.parentJoint, frame.placement, 0, T_WE, pin.ReferenceFrame.LOCAL
    )
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    models.append(held)
    datas.append(held.createData())
    pin.initConstraintDynamics(oracle.model, oracle.data, models, datas)
    settings = pin.ProximalSettings(1e-14, 0.0, 1)
    pin.constraintDynamics(
        oracle.model, oracle.data, oracle.q(q), v[oracle.order], tau[oracle.order], models, datas, settings
    )
    force, R = datas[0].contact_force, np.array(T_WE.rotation)
    linear = R @ np.array(force.linear)
    return linear if kind == pin.ContactType.CONTACT_3D else np.concatenate([linear, R @ np.array(force.angular)])


def multipliers(arm: taut.Arm, constraint: taut.Constraint, q: Array, v: Array, tau: Array) -> Array:
    """lam of a plant's step that begins in a state."""
    plant = taut.RigidPlant(arm, friction=None, contact=constraint)
    memory = plant.command(tau, plant.start(q, v, plant.parameters, 1e-3), 0.0)
    return np.asarray(plant.advance(memory, plant.parameters, 1e-3)["contact.lam"])


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("kind", ["point", "pose"])
def test_multipliers_are_those_of_pinocchio(name: str, kind: str) -> None:
    arm = taut.load_arm(name)
    arm = arm.with_joints(rotor_inertia=0.0)
    oracle, rng = catalogue_oracle(name, arm), np.random.default_rng(len(name))
    for _ in range(8):
        q = rng.uniform(np.maximum(arm.lower, -2.5), np.minimum(arm.upper, 2.5))
        x = taut.snapshot(arm, q)
        if np.linalg.svd(x.J(), compute_uv=False)[-1 if kind == "pose" else 2] < 0.05:
            continue
        constraint = held_point(x.T()) if kind == "point" else held_pose(x.T())
        A = np.asarray(constraint.at(x).A_q)
        v = rng.standard_normal(arm.n)
        v = v - np.linalg.pinv(A) @ (A @ v)
        tau = x.g + rng.uniform(-10.0, 10.0, arm.n)
        lam = multipliers(arm, constraint, q, v, tau)
        pin_kind = pin.ContactType.CONTACT_3D if kind == "point" else pin.ContactType.CONTACT_6D
        wanted = -by_pinocchio(oracle, pin_kind, q, v, tau)
        assert np.abs(lam - wanted).max() < WITHIN * max(1.0, float(np.abs(wanted).max()))
