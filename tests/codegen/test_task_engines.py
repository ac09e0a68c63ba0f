"""Task-space computed torque in native code, as floats, and as it is written on Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import taut
from taut.base.types import Float64Array
from taut.maths.singularity import distance_beyond, spheres
from taut.maths.spatial import rotation_exp

L = taut.laws
PANDA = taut.load_arm("panda")
SAME = 1e-9  # of task laws, relative to the largest torque, with default damping
STATES = 1000
KP, KD = np.array([100.0, 90.0, 80.0, 70.0, 60.0, 50.0]), np.linspace(20.0, 14.0, 6)
POSITION = taut.Coordinates.position()
REST = np.array(PANDA.home)


class OnPinocchio:
    """The same law in NumPy; every error, with a posture in the null space."""

    def __init__(self) -> None:
        model = pin.Model()
        model.gravity.linear = np.array(PANDA.gravity)
        for joint, body in zip(PANDA.joints, PANDA.bodies, strict=True):
            placement = pin.SE3(np.array(joint.placement.R), np.array(joint.placement.p))
            axis = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
            index = model.addJoint(joint.parent + 1, axis, placement, joint.name)
            inertia = pin.Inertia(body.mass, np.array(body.com), np.array(body.inertia))
            model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
        tool = PANDA.frame().placement
        self.tool = model.addFrame(
            pin.Frame("tool", PANDA.n, 0, pin.SE3(np.array(tool.R), np.array(tool.p)), pin.FrameType.OP_FRAME)
        )
        self.model, self.data = model, model.createData()

    def torque(self, error: str, q: Float64Array, v: Float64Array, ref: taut.TaskMotion) -> Float64Array:
        model, data, frame = self.model, self.data, self.tool
        M, h = pin.crba(model, data, q).copy(), pin.nonLinearEffects(model, data, q, v).copy()
        M = np.triu(M) + np.triu(M, 1).T
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, np.zeros(7))
        pin.updateFramePlacements(model, data)
        T, T_des = data.oMf[frame], pin.SE3(np.array(ref.R), np.array(ref.p))
        twist, rate = np.array(ref.twist), np.array(ref.acceleration)
        if error in ("decoupled", "coordinates"):
            axes = pin.LOCAL_WORLD_ALIGNED
            X = np.append(T_des.translation - T.translation, pin.log3(T_des.rotation @ T.rotation.T))
            J = pin.getFrameJacobian(model, data, frame, axes)
            Jdot_v = pin.getFrameClassicalAcceleration(model, data, frame, axes).vector
            V_des, a_des = twist, rate
        elif error == "body":
            T_e = T.actInv(T_des)
            X = pin.log6(T_e).vector
            J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            Jdot_v = pin.getFrameAcceleration(model, data, frame, pin.LOCAL).vector
            turn = T_des.rotation.T
            V_D = pin.Motion(turn @ twist[:3], turn @ twist[3:])
            # The rate of the body twist's numbers: that of the origin's velocity less what the turning axes add.
            a_D = pin.Motion(turn @ rate[:3] - np.cross(V_D.angular, V_D.linear), turn @ rate[3:])
            V = T_e.act(V_D) - pin.Motion(J @ v)
            V_des, a_des = T_e.act(V_D).vector, (T_e.act(a_D) + V.cross(T_e.act(V_D))).vector
        else:
            X = pin.log6(T_des * T.inverse()).vector
            J = pin.getFrameJacobian(model, data, frame, pin.WORLD)
            Jdot_v = pin.getFrameAcceleration(model, data, frame, pin.WORLD).vector
            p, w = T_des.translation, twist[3:]
            V_des = np.append(twist[:3] + np.cross(p, w), w)
            a_des = np.append(rate[:3] + np.cross(p, rate[3:]) + np.cross(twist[:3], w), rate[3:])
        k = 3 if error == "coordinates" else 6
        X, J, Jdot_v, V_des, a_des = X[:k], J[:k], Jdot_v[:k], V_des[:k], a_des[:k]
        Minv = np.linalg.inv(M)
        Lambda = np.linalg.inv(J @ Minv @ J.T)
        F = Lambda @ (a_des + KP[:k] * X + KD[:k] * (V_des - J @ v) - Jdot_v)
        free = M @ (10.0 * (REST - q) - 6.0 * v)
        return J.T @ F + h + free - J.T @ (Lambda @ (J @ (Minv @ free)))


def law(error: Any) -> taut.Law:
    k = 3 if error == "coordinates" else 6
    more = {"coordinates": POSITION} if error == "coordinates" else {}
    return L.TaskComputedTorque(kp=KP[:k], kd=KD[:k], error=error, null=L.Posture(q=REST), **more)


def random_tick(rng: np.random.Generator) -> tuple[Float64Array, Float64Array, taut.TaskMotion]:
    """A state away from singularities, and a target up to 2 rad away and not out of reach."""
    while True:
        q, v = rng.uniform(PANDA.lower, PANDA.upper), rng.standard_normal(7)
        x = taut.snapshot(PANDA, q)
        w = rng.standard_normal(3)
        R = rotation_exp(rng.uniform(0.0, 2.0) * w / np.linalg.norm(w)) @ x.T().R
        pose = taut.Pose.of(R, x.T().p + 0.3 * rng.standard_normal(3))
        away = distance_beyond(spheres(x.model, None, "pose"), pose.p[None], R[None])[0]
        if np.linalg.svd(x.J(), compute_uv=False)[-1] > 0.1 and away < 0.0:
            break
    return q, v, taut.TaskMotion(pose=pose, twist=rng.standard_normal(6), acceleration=rng.standard_normal(6))


@pytest.mark.part(1)
@pytest.mark.parametrize("error", ["decoupled", "body", "space", "coordinates"])
def test_engines_and_pinocchio_give_the_same_torques(error: str, share: Callable[[int], int]) -> None:
    rng = np.random.default_rng(11)
    native, floats = (taut.compile(law(error), PANDA, engine=engine) for engine in ("native", "float"))
    other = OnPinocchio()
    for k in range(share(STATES)):
        q, v, ref = random_tick(rng)
        expected = other.torque(error, q, v, ref)
        size = np.abs(expected).max()
        assert np.abs(native.step(q, v, ref) - expected).max() < SAME * size
        if k % 10 == 0:  # a float tick takes its milliseconds
            native.reset()
            floats.reset()
            assert np.abs(native.step(q, v, ref) - floats.step(q, v, ref)).max() < SAME * size
