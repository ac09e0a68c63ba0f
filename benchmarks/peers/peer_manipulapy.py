"""ManipulaPy (`pip install ManipulaPy`) with its NumPy back end."""

from __future__ import annotations

import numpy as np
from ManipulaPy.control import ManipulatorController
from ManipulaPy.urdf_processor import URDFToSerialManipulator
from worker import Array, Case, Task, ticks


def tick(task: Task, robot: str) -> Case:
    data = task.robots[robot]
    model = URDFToSerialManipulator(task.urdf(robot), use_pybullet_limits=False)
    control, n, gravity = ManipulatorController(model.dynamics), len(data["joints"]), np.array(data["gravity"])
    kp, ki, kd = task.kp * np.ones(n), np.zeros(n), task.kd * np.ones(n)

    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        return control.computed_torque_control(q_des, v_des, a_des, q, v, gravity, task.dt, kp, ki, kd)

    return ticks(task, law, "ManipulatorController.computed_torque_control", robot)


CASES = {"tick": tick}
