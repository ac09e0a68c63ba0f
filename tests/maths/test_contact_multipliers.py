"""Rigid contacts against Pinocchio's constrained dynamics and MuJoCo's constraints and contacts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

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


@pytest.mark.part(2)
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


# -------------------------------------------------------------------- 1000 poses each

CENTER = np.array([0.3, -0.2, 0.1])


def rolling(T: Any) -> Any:
    """A wheel on a plane: it presses along z, and does not slip sideways."""
    return tm.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [*T.R[:, 1], 0.0, 0.0, 0.0]])


def round_about(T: Any) -> Any:
    """Spheres about a point, whichever the tool is on."""
    d = T.p - CENTER
    return tm.array([*(d / tm.norm(d)), 0.0, 0.0, 0.0])


def hinged(T: Any) -> Any:
    """It turns about its own z axis only."""
    return tm.array([*np.eye(6)[:3], [0.0, 0.0, 0.0, *T.R[:, 0]], [0.0, 0.0, 0.0, *T.R[:, 1]]])


# Constraints of velocities: every pose is one of theirs, so that one compiled step serves for all, without any drift.
HELD: dict[str, tuple[Callable[[Any], Any], int]] = {
    "point": (lambda T: np.eye(6)[:3], 3),
    "pose": (lambda T: np.eye(6), 6),
    "wheel": (rolling, 2),
    "sphere": (round_about, 1),
    "hinge": (hinged, 5),
}


def stepped(arm: taut.Arm, constraint: taut.Constraint) -> Callable[[Array, Array, Array], Array]:
    """lam of a plant's step, in native code, from any state."""
    plant = taut.RigidPlant(arm, friction=None, contact=constraint)
    n, own = arm.n, plant.parameters
    start = plant.start(arm.home, np.zeros(n), own, 1e-3)

    def step(q: Any, v: Any, tau: Any) -> Any:
        memory = plant.command(tau, {**start, "q": q, "v": v}, 0.0)
        return plant.advance(memory, own, 1e-3)["contact.lam"]

    return taut.native(step, q=n, v=n, tau=n)


def by_equation_10_42(oracle: Oracle, A_of: Callable[[Array], Array], q: Array, v: Array, tau: Array) -> Array:
    """From Pinocchio's M, h, poses and Jacobians; A-dot by a difference of six neighbours."""
    s = 2e-3 / max(1.0, float(np.linalg.norm(v)))
    f = [A_of(q + j * s * v) @ v for j in (-3, -2, -1, 1, 2, 3)]
    bias = (-f[0] + 9 * f[1] - 45 * f[2] + 45 * f[3] - 9 * f[4] + f[5]) / (60 * s)
    A = A_of(q)
    W = np.linalg.solve(oracle.M(q), A.T)
    return np.asarray(np.linalg.solve(A @ W, W.T @ (tau - oracle.h(q, v)) + bias))


@pytest.mark.part(1)
@pytest.mark.bars
@pytest.mark.parametrize("name", ["panda", "ur10", "xarm7"])
def test_the_plants_multipliers_are_those_of_pinocchio_at_many_poses(
    name: str, share: Callable[[int], int], bar: Any
) -> None:
    arm = taut.load_arm(name).with_joints(rotor_inertia=0.0)
    oracle, rng, wanted, worst = catalogue_oracle(name, arm), np.random.default_rng(9), share(share(1000)), 0.0
    kinds = {"point": pin.ContactType.CONTACT_3D, "pose": pin.ContactType.CONTACT_6D}
    for kind, (function, k) in HELD.items():
        at, count = stepped(arm, taut.Constraint.pfaffian(function)), 0

        def A_of(q: Array, function: Callable[[Any], Any] = function, k: int = k) -> Array:
            T = oracle.pose(q)
            A = np.asarray(function(taut.Pose.of(T.rotation, T.translation)), dtype=np.float64).reshape(k, 6)
            return np.asarray(A @ oracle.J(q, "W"))

        while count < wanted:
            q = rng.uniform(np.maximum(arm.lower, -2.5), np.minimum(arm.upper, 2.5))
            A = A_of(q)
            if np.linalg.svd(A, compute_uv=False)[-1] < 0.05:
                continue  # an arm that cannot press
            count += 1
            v, tau = rng.standard_normal(arm.n), oracle.g(q) + rng.uniform(-10.0, 10.0, arm.n)
            v = v - np.linalg.pinv(A) @ (A @ v)
            known = [by_equation_10_42(oracle, A_of, q, v, tau)]
            if kind in kinds:
                known.append(-by_pinocchio(oracle, kinds[kind], q, v, tau))
            for lam in known:
                worst = max(worst, float(np.abs(at(q, v, tau) - lam).max() / max(1.0, np.abs(lam).max())))
    bar(
        f"plant, {name}: multipliers against Pinocchio, {wanted} poses at each of {len(HELD)} constraints",
        f"{worst:.1e}",
    )
    assert worst < WITHIN
