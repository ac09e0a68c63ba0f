"""NumPy with MuJoCo (`pip install mujoco`), contacts and constraints switched off."""

from __future__ import annotations

import mujoco
import numpy as np
from worker import Array, Case, Task, impedance, ticks, tool_ticks


def model_of(task: Task, robot: str, payload: bool = False) -> mujoco.MjModel:
    """Bodies, hinges and a site at the tool; with a payload, that as a body of its own."""
    data = task.robots[robot]
    spec = mujoco.MjSpec()
    spec.option.timestep = task.dt
    spec.option.gravity = data["gravity"]
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    body = spec.worldbody
    for joint, link in zip(data["joints"], data["bodies"], strict=True):
        I = np.array(link["inertia"])
        inertial = {
            "mass": link["mass"],
            "ipos": link["com"],
            "fullinertia": [*np.diag(I), I[0, 1], I[0, 2], I[1, 2]],
        }
        body = body.add_body(pos=joint["p"], quat=joint["wxyz"], explicitinertial=True, **inertial)
        body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0])
    place = {"pos": data["tool"]["p"], "quat": data["tool"]["wxyz"]}
    body.add_site(name="tool", **place)
    if payload:
        mass, com, I = (task.payload[name] for name in ("mass", "com", "inertia"))
        body.add_body(name="payload", mass=float(mass), ipos=com, inertia=np.diag(I), explicitinertial=True, **place)
    return spec.compile()


def tick(task: Task, robot: str) -> Case:
    model, kp, kd = model_of(task, robot), task.kp, task.kd
    data = mujoco.MjData(model)

    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        data.qpos[:], data.qvel[:] = q, v
        data.qacc[:] = a_des + kp * (q_des - q) + kd * (v_des - v)
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse.copy()

    return ticks(task, robot, law, "mj_inverse")


def tool_tick(task: Task) -> Case:
    model = model_of(task, "panda")
    data, n, site = mujoco.MjData(model), model.nv, model.site("tool").id
    body = model.site_bodyid[site]
    M, J, Jdot = np.zeros((n, n)), np.zeros((6, n)), np.zeros((6, n))

    def law(q: Array, v: Array, *target: Array) -> Array:
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_step1(model, data)
        mujoco.mj_fullM(model, data, M)
        p, R = data.site_xpos[site], data.site_xmat[site].reshape(3, 3)
        mujoco.mj_jacSite(model, data, J[:3], J[3:], site)
        mujoco.mj_jacDot(model, data, Jdot[:3], Jdot[3:], p, body)
        return impedance(task, M, data.qfrc_bias, J, Jdot @ v, p, R, q, v, target)

    return tool_ticks(task, law, "mj_step1, mj_fullM, qfrc_bias, mj_jacSite, mj_jacDot")


def closed_loop(task: Task, robot: str) -> Case:
    """The law's model is the arm without the payload; the plant is another model with it."""
    model, plant, kp, kd = model_of(task, robot), model_of(task, robot + "_loaded"), task.kp, task.kd
    own, data = mujoco.MjData(model), mujoco.MjData(plant)
    steps, wanted = 400, task.motion(robot)

    def call() -> Array:
        data.qpos[:], data.qvel[:], _ = wanted(0.0)
        for k in range(steps):
            q_des, v_des, a_des = wanted(k * task.dt)
            own.qpos[:], own.qvel[:] = data.qpos, data.qvel
            own.qacc[:] = a_des + kp * (q_des - own.qpos) + kd * (v_des - own.qvel)
            mujoco.mj_inverse(model, own)
            data.qfrc_applied[:] = own.qfrc_inverse
            mujoco.mj_step(plant, data)
        return data.qpos.copy()

    return Case(call, steps, "mj_inverse, mj_step; loop in Python")


CASES = {"tick": tick, "impedance": tool_tick, "loop": closed_loop}
