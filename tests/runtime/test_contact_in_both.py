"""The same constraints and contacts in RigidPlant, where they are rigid, and in MuJoCo, where they are nearly."""

from __future__ import annotations

import mujoco
import numpy as np

import taut
from taut.base.types import Float64Array

Array = Float64Array
PANDA = taut.load_arm("panda")
Q0 = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.7, 0.8])
AT = taut.snapshot(PANDA, Q0)
STIFF = 'solref="0.002 1" solimp="0.9999 0.9999 0.001"'

GANTRY = """
<mujoco>
  <option timestep="0.0002" gravity="0 0 -9.81" cone="elliptic" impratio="100" noslip_iterations="20"/>
  <worldbody>
    <geom type="plane" size="5 5 1" friction="0.4 0 0" condim="3" solref="0.0004 1" solimp="0.9999 0.9999 0.0001"/>
    <body pos="0 0 0.05">
      <joint type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="12" diaginertia="1 1 1"/>
      <body>
        <joint type="slide" axis="0 1 0"/><inertial pos="0 0 0" mass="6" diaginertia="1 1 1"/>
        <body>
          <joint type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/>
          <geom type="sphere" size="0.05" friction="0.4 0 0" condim="3" mass="0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


class Pushed(taut.Law):
    """A constant torque."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(push=ref.a)


def test_a_tool_that_is_pinned_to_the_world_moves_and_pulls_as_in_mujoco() -> None:
    p = np.asarray(AT.T().p)
    post = f'<body name="post" pos="{p[0]} {p[1]} {p[2]}"><site name="pin"/></body>'
    anchor = f'{post}<equality><connect site1="{PANDA.tool}" site2="pin" {STIFF}/></equality>'
    tau = taut.JointMotion(q=Q0, a=AT.g + np.array([3.0, -4.0, 2.0, 3.0, -1.0, 1.0, 0.1]))
    ctrl = taut.compile(Pushed(), PANDA, rate=2000.0)
    ours = taut.run(ctrl, taut.RigidPlant(PANDA, friction=None, contact=taut.Constraint(lambda T: T.p - p)), tau, duration=0.2, q0=Q0)  # fmt: skip
    theirs = taut.run(ctrl, taut.MujocoPlant(PANDA, friction=None, scene=anchor), tau, duration=0.2, q0=Q0)
    assert np.abs(ours.q[-1] - Q0).max() > 0.1
    np.testing.assert_allclose(ours.q, theirs.q, atol=2e-3)
    last = slice(50, None)
    size = np.abs(theirs.extra["F_ext"][last]).max()
    np.testing.assert_allclose(ours.extra["F_ext"][last], theirs.extra["F_ext"][last], atol=0.02 * size)


def mujocos(v0: Array, push: Array, duration: float) -> tuple[Array, Array]:
    model = mujoco.MjModel.from_xml_string(GANTRY)
    data = mujoco.MjData(model)
    data.qvel[:], data.ctrl = v0, []
    data.qfrc_applied[:] = push
    for _ in range(round(duration / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return data.qpos.copy(), data.qvel.copy()


def test_a_tool_slides_and_stops_on_a_floor_as_in_mujoco() -> None:
    arm = taut.load_arm("gantry3")
    floor = taut.Constraint.plane(point=[0.0, 0.0, -0.2], normal=[0.0, 0.0, 1.0])
    plant = taut.RigidPlant(arm, friction=None, contact=taut.RigidContact(constraint=floor, friction=0.4))
    ctrl = taut.compile(Pushed(), arm, rate=5000.0)
    for v0, push in (([0.4, 0.3, 0.0], [0.0, 0.0, 0.0]), ([0.0, 0.0, 0.0], [10.0, 12.0, -5.0])):
        ours = taut.run(ctrl, plant, taut.JointMotion(q=np.zeros(3), a=push), duration=0.1, v0=v0)
        q, v = mujocos(np.array(v0), np.array(push), 0.1)
        # MuJoCo's friction gives way a little, also across the sliding.
        np.testing.assert_allclose(ours.q[-1, :2], q[:2], atol=0.02 * np.linalg.norm(q[:2]))
        np.testing.assert_allclose(ours.v[-1, :2], v[:2], atol=0.02 * np.linalg.norm(v[:2]))
