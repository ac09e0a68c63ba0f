"""Other engines' views of an Arm, for the tests of this folder."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin

from taut.arm.description import BASE, Arm
from taut.trace.pose import Pose


def se3(pose: Pose) -> pin.SE3:
    return pin.SE3(np.array(pose.R), np.array(pose.p))


def pinocchio_of(arm: Arm) -> pin.Model:
    """The same arm as a Pinocchio model, built joint by joint; a continuous joint has one entry of q."""
    model = pin.Model()
    ids: dict[int, int] = {BASE: 0}
    for i, (joint, body) in enumerate(zip(arm.joints, arm.bodies, strict=True)):
        slide = joint.kind == "prismatic"
        made = (pin.JointModelPrismaticUnaligned if slide else pin.JointModelRevoluteUnaligned)(np.array(joint.axis))
        ids[i] = model.addJoint(ids[joint.parent], made, se3(joint.placement), joint.name)
        inertia = pin.Inertia(body.mass, np.array(body.com), np.array(body.inertia))
        model.appendBodyToJoint(ids[i], inertia, pin.SE3.Identity())
    for frame in arm.frames:
        placement = se3(frame.placement)
        model.addFrame(pin.Frame(frame.name, ids[frame.body], 0, placement, pin.FrameType.OP_FRAME))
    model.armature = np.array(arm.rotor_inertia)
    model.gravity.linear = np.array(arm.gravity)
    return model


def random_q(arm: Arm, rng: np.random.Generator) -> np.ndarray:
    low = np.where(np.isfinite(arm.lower), arm.lower, -2.0)
    high = np.where(np.isfinite(arm.upper), arm.upper, 2.0)
    return rng.uniform(low, high)


def assert_same_as_mujoco(arm: Arm, m: mujoco.MjModel, seed: int = 0) -> None:
    """Mass matrix, bias forces and frames of an Arm, against MuJoCo's own, at random states."""
    rng = np.random.default_rng(seed)
    model = pinocchio_of(arm)
    data, d = model.createData(), mujoco.MjData(m)
    qpos = [int(m.joint(name).qposadr[0]) for name in arm.joint_names]
    dofs = [int(m.joint(name).dofadr[0]) for name in arm.joint_names]
    for _ in range(5):
        q, v = random_q(arm, rng), rng.normal(size=arm.n)
        d.qpos[qpos], d.qvel[dofs] = q, v
        mujoco.mj_forward(m, d)
        M = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, d, M)
        np.testing.assert_allclose(pin.crba(model, data, q), M[np.ix_(dofs, dofs)], atol=1e-10, rtol=1e-10)
        bias = pin.nonLinearEffects(model, data, q, v)
        np.testing.assert_allclose(bias, d.qfrc_bias[dofs], atol=1e-9, rtol=1e-9)
        pin.framesForwardKinematics(model, data, q)
        for i in range(1, m.nbody):
            if m.body(i).name in arm.frame_names:
                _assert_pose(data.oMf[model.getFrameId(m.body(i).name)], d.xpos[i], d.xmat[i])
        for i in range(m.nsite):
            if m.site(i).name in arm.frame_names:
                _assert_pose(data.oMf[model.getFrameId(m.site(i).name)], d.site_xpos[i], d.site_xmat[i])


def _assert_pose(T: pin.SE3, p: np.ndarray, R: np.ndarray) -> None:
    np.testing.assert_allclose(T.translation, p, atol=1e-10)
    np.testing.assert_allclose(T.rotation, np.reshape(R, (3, 3)), atol=1e-10)
