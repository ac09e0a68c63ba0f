"""What a user would otherwise write: the same laws and loops in NumPy with Pinocchio, and with MuJoCo.

Everything works on the same Panda: the catalogue's file, gripper locked, joint damping off.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import taut
from taut.arm.description import Body, Frame, Joint

Vector = NDArray[np.float64]

ARM = taut.load_arm("panda").with_joints(viscous=0.0)
N = ARM.n
KP, KD, KI = np.full(N, 100.0), np.full(N, 20.0), np.full(N, 10.0)
DT = 1e-3
CENTER = np.array([0.0, -0.3, 0.0, -1.8, 0.0, 1.5, 0.7])
AMPLITUDE = 0.3
FREQUENCY = np.array([0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5])
PAYLOAD_MASS, PAYLOAD_COM, PAYLOAD_INERTIA = 1.0, np.array([0.0, 0.0, 0.05]), 0.001 * np.eye(3)


def pinocchio_model(payload: bool = False) -> pin.Model:
    """The arm as a Pinocchio model, joint by joint."""
    model = pin.Model()
    model.gravity.linear = ARM.gravity
    for i, (joint, body) in enumerate(zip(ARM.joints, ARM.bodies, strict=True)):
        placement = pin.SE3(joint.placement.R, joint.placement.p)
        assert np.allclose(joint.axis, (0.0, 0.0, 1.0))
        index = model.addJoint(joint.parent + 1, pin.JointModelRZ(), placement, joint.name)
        inertia = pin.Inertia(body.mass, body.com, body.inertia)
        if payload and i == N - 1:
            tool = ARM.frame().placement
            at_tool = pin.Inertia(PAYLOAD_MASS, PAYLOAD_COM, PAYLOAD_INERTIA)
            inertia = inertia + pin.SE3(tool.R, tool.p).act(at_tool)
        model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    return model


def chain(n: int) -> taut.Arm:
    """A chain of n hinges with alternating axes, offsets in all directions and full inertias."""
    joints, bodies = [], []
    for i in range(n):
        place = taut.Pose([0.05, 0.0, 0.3], rpy=[np.pi / 2.0 * (i % 2), 0.0, 0.0])
        joints.append(Joint(name=f"joint{i + 1}", kind="revolute", parent=i - 1, placement=place, axis=np.eye(3)[2]))
        inertia = np.array([[0.03, 0.002, 0.001], [0.002, 0.04, 0.003], [0.001, 0.003, 0.02]])
        bodies.append(Body(mass=2.0, com=np.array([0.02, 0.03, 0.1]), inertia=inertia))
    tool = Frame(name="tool", body=n - 1, placement=taut.Pose([0.0, 0.0, 0.1]))
    return taut.Arm(
        name=f"chain{n}",
        joints=tuple(joints),
        bodies=tuple(bodies),
        frames=(tool,),
        tool="tool",
        home=np.full(n, 0.3),
    )


class PinocchioLaw:
    """Computed torque as everybody writes it with Pinocchio: M @ a + h."""

    def __init__(self) -> None:
        self.model = pinocchio_model()
        self.data = self.model.createData()
        self.e_int = np.zeros(N)

    def natural(self, q: Vector, v: Vector, q_des: Vector, v_des: Vector, a_des: Vector) -> Vector:
        """M and h, then the law."""
        e = q_des - q
        self.e_int = self.e_int + e * DT
        M = pin.crba(self.model, self.data, q)
        h = pin.nonLinearEffects(self.model, self.data, q, v)
        return M @ (a_des + KP * e + KI * self.e_int + KD * (v_des - v)) + h

    def by_rnea(self, q: Vector, v: Vector, q_des: Vector, v_des: Vector, a_des: Vector) -> Vector:
        """The same by one recursion, rnea(q, v, a)."""
        e = q_des - q
        self.e_int = self.e_int + e * DT
        a = a_des + KP * e + KI * self.e_int + KD * (v_des - v)
        return pin.rnea(self.model, self.data, q, v, a)


def wanted(t: float) -> tuple[Vector, Vector, Vector]:
    """The sine that every loop follows."""
    omega = 2.0 * np.pi * FREQUENCY
    s, c = np.sin(omega * t), np.cos(omega * t)
    return CENTER + AMPLITUDE * s, AMPLITUDE * omega * c, -AMPLITUDE * omega**2 * s


def pinocchio_loop(ticks: int) -> Vector:
    """The closed loop in NumPy with Pinocchio, with a payload in the plant: the final joint positions."""
    law = PinocchioLaw()
    plant = pinocchio_model(payload=True)
    data = plant.createData()
    q, v, _ = wanted(0.0)
    for k in range(ticks):
        tau = law.natural(q, v, *wanted(k * DT))
        v = v + DT * pin.aba(plant, data, q, v, tau)
        q = q + DT * v
    return q


def mujoco_model() -> mujoco.MjModel:
    """The arm as a MuJoCo model without contacts: bodies and hinges, nothing else."""
    spec = mujoco.MjSpec()
    spec.option.timestep = DT
    spec.option.gravity = ARM.gravity
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    parents = [spec.worldbody]
    for joint, body in zip(ARM.joints, ARM.bodies, strict=True):
        child = parents[joint.parent + 1].add_body(
            name=joint.name + "_body",
            pos=joint.placement.p,
            quat=joint.placement.wxyz,
            mass=body.mass,
            ipos=body.com,
            fullinertia=[*np.diag(body.inertia), body.inertia[0, 1], body.inertia[0, 2], body.inertia[1, 2]],
            explicitinertial=True,
        )
        child.add_joint(name=joint.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis)
        parents.append(child)
    return spec.compile()


def mujoco_loop(model: mujoco.MjModel, data: mujoco.MjData, ticks: int) -> Vector:
    """MuJoCo stepping with a NumPy law that takes M and h from MuJoCo: the final joint positions."""
    q, v, _ = wanted(0.0)
    data.qpos[:], data.qvel[:] = q, v
    M = np.zeros((N, N))
    e_int = np.zeros(N)
    for k in range(ticks):
        mujoco.mj_step1(model, data)
        q_des, v_des, a_des = wanted(k * DT)
        e = q_des - data.qpos
        e_int = e_int + e * DT
        mujoco.mj_fullM(model, data, M)
        a = a_des + KP * e + KI * e_int + KD * (v_des - data.qvel)
        data.qfrc_applied[:] = M @ a + data.qfrc_bias
        mujoco.mj_step2(model, data)
    return data.qpos.copy()
