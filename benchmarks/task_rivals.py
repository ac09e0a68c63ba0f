"""Task-space laws as everybody writes them in NumPy with Pinocchio; model and arm are those of `rivals`."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import rivals
from rivals import N, Vector

KP = np.array([100.0, 100.0, 100.0, 64.0, 64.0, 64.0])
KD = np.array([20.0, 20.0, 20.0, 16.0, 16.0, 16.0])
K = np.diag([800.0, 800.0, 800.0, 30.0, 30.0, 30.0])
B = np.diag([50.0, 50.0, 50.0, 3.0, 3.0, 3.0])
KFP, KFI, DT = 0.4, 5.0, 1e-3
A = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
F_DES, F_EXT = np.array([0.0, 0.0, -10.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 8.0, 0.0, 0.0, 0.0])
REST_KP, REST_KD = 10.0, 6.0


class PinocchioTask:
    """Computed torque and impedance of the tool, with a posture in the null space."""

    def __init__(self) -> None:
        self.model = rivals.pinocchio_model()
        tool = rivals.ARM.frame().placement
        self.tool = self.model.addFrame(pin.Frame("tool", N, 0, pin.SE3(tool.R, tool.p), pin.FrameType.OP_FRAME))
        self.data = self.model.createData()
        self.rest = np.array(rivals.ARM.home)

    def computed_torque(self, q: Vector, v: Vector, T_des: pin.SE3, V_des: Vector, a_des: Vector) -> Vector:
        """Body error log(T^-1 T_des); twist and acceleration of the target in its own axes."""
        model, data, frame = self.model, self.data, self.tool
        M, h = self._dynamics(q, v)
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
        Jdot_v = pin.getFrameAcceleration(model, data, frame, pin.LOCAL).vector
        T_e = data.oMf[frame].actInv(T_des)
        X_e = pin.log6(T_e).vector
        V = pin.Motion(J @ v)
        V_goal = T_e.act(pin.Motion(V_des))
        V_e = V_goal - V
        a_goal = T_e.act(pin.Motion(a_des)) + V_e.cross(V_goal)
        Minv = np.linalg.inv(M)
        Lambda = np.linalg.inv(J @ Minv @ J.T)
        F = Lambda @ (a_goal.vector + KP * X_e + KD * V_e.vector - Jdot_v)
        return J.T @ F + h + self._posture(q, v, M, J, Lambda, Minv)

    def impedance(self, q: Vector, v: Vector, T_des: pin.SE3, V_des: Vector, a_des: Vector) -> Vector:
        """World axes: error p_des - p and log of R_des R^T; twist and acceleration of the target in world axes."""
        model, data, frame = self.model, self.data, self.tool
        M, h = self._dynamics(q, v)
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        Jdot_v = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        T = data.oMf[frame]
        X_e = np.concatenate([T_des.translation - T.translation, pin.log3(T_des.rotation @ T.rotation.T)])
        V_e = V_des - J @ v
        Minv = np.linalg.inv(M)
        Lambda = np.linalg.inv(J @ Minv @ J.T)
        F = Lambda @ (a_des - Jdot_v) + B @ V_e + K @ X_e
        return J.T @ F + h + self._posture(q, v, M, J, Lambda, Minv)

    def hybrid(self, q: Vector, v: Vector, T_des: pin.SE3, V_des: Vector, a_des: Vector) -> Vector:
        """Eq. 10.45 on a floor, with A = (n, 0): world axes, a force fed back as PI, the integral's first tick."""
        model, data, frame = self.model, self.data, self.tool
        M, h = self._dynamics(q, v)
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        Jdot_v = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        T = data.oMf[frame]
        X_e = np.concatenate([T_des.translation - T.translation, pin.log3(T_des.rotation @ T.rotation.T)])
        V_e = V_des - J @ v
        Minv = np.linalg.inv(M)
        Lambda_inv = J @ Minv @ J.T
        Lambda = np.linalg.inv(Lambda_inv)
        P = np.eye(6) - A.T @ np.linalg.inv(A @ Lambda_inv @ A.T) @ A @ Lambda_inv
        F_e = F_DES + F_EXT
        F_force = F_DES + KFP * F_e + KFI * (F_e * DT)
        F = P @ (Lambda @ (a_des + KP * X_e + KD * V_e)) + (np.eye(6) - P) @ F_force - Lambda @ Jdot_v
        return J.T @ F + h + self._posture(q, v, M, J, Lambda, Minv)

    def _dynamics(self, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        model, data = self.model, self.data
        M = pin.crba(model, data, q)
        h = pin.nonLinearEffects(model, data, q, v)
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, np.zeros(N))
        pin.updateFramePlacements(model, data)
        return M, h

    def _posture(self, q: Vector, v: Vector, M: Vector, J: Vector, Lambda: Vector, Minv: Vector) -> Vector:
        tau = M @ (REST_KP * (self.rest - q) - REST_KD * v)
        return tau - J.T @ (Lambda @ (J @ (Minv @ tau)))
