"""What MujocoPlant reports of the world at its tool: the sign, the frame, and what is no part of it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from mujoco_arms import idle, torso

import taut
from taut.arm.description import Arm
from taut.maths import dynamics as dyn
from taut.maths.model import model_of

G = 9.81
STIFF = taut.laws.GravityPID(kp=[600, 600, 600, 600, 250, 150, 50], kd=[50, 50, 50, 50, 30, 20, 5])


def panda() -> Arm:
    return taut.load_arm("panda")


def tool(arm: Arm) -> np.ndarray:
    return np.asarray(dyn.pose(model_of(arm), arm.home).p)


def hold(plant: taut.MujocoPlant, arm: Arm, ref: np.ndarray | None = None, duration: float = 2.0) -> taut.Run:
    """Hold a pose with the controller's model of the arm."""
    return taut.run(
        taut.compile(STIFF, arm), plant, taut.JointMotion(q=arm.home if ref is None else ref), duration=duration
    )


def test_a_mass_that_hangs_on_the_tool_pulls_it_down() -> None:
    arm = panda()
    x, y, z = tool(arm)
    ball = f"""<body name="ball" pos="{x} {y} {z}"><freejoint/>
                 <geom size="0.03" mass="1" contype="0" conaffinity="0"/></body>
               <equality><weld body1="payload" body2="ball" relpose="0 0 0 1 0 0 0" solref="0.002 1"/></equality>"""
    out = hold(taut.MujocoPlant(arm, scene=ball), arm)
    assert np.abs(out.extra["F_ext"][-1] - [0, 0, -G, 0, 0, 0]).max() < 1e-6
    # The same mass as the plant's own payload bends the arm as much and is no external force.
    own = hold(taut.MujocoPlant(arm.with_payload(1.0)), arm)
    assert not own.extra["F_ext"].any()
    assert np.abs(own.q[-1] - out.q[-1]).max() < 1e-4
    assert np.abs(out.q[-1] - arm.home).max() > 1e-3


def test_a_wall_pushes_back_with_the_sign_of_the_wall_on_the_arm() -> None:
    arm, radius = panda(), 0.01
    x, _, z = tool(arm)
    wall = f'<geom type="box" size="0.05 1 1" pos="{x + 0.05 + radius + 0.002} 0 {z}" friction="0"/>'
    plant = taut.MujocoPlant(arm, scene=wall, tool_radius=radius)
    pushing = arm.home + np.array([0.0, 0.05, 0.0, 0.1, 0.0, 0.0, 0.0])
    out = hold(plant, arm, pushing)
    F_ext = out.extra["F_ext"]
    assert not F_ext[0].any()
    assert F_ext[-1, 0] < -10.0  # [N], along -x
    assert np.abs(F_ext[-1, 1:3]).max() < 1e-3  # MuJoCo's least friction is 1e-5
    assert np.abs(F_ext[-1, 3:]).max() < 1e-3  # the push goes through the middle of the sphere
    # At rest the drives carry weight and push: tau + J^T F_ext = g.
    g = dyn.gravity_torque(model_of(arm), out.q[-1])
    J = dyn.jacobian(model_of(arm), out.q[-1])
    assert np.abs(out.tau[-1] + J.T @ F_ext[-1] - g).max() < 1e-2  # [N m], of 40; it still settles


def test_a_tool_with_a_length_touches_with_its_side_and_with_the_edge_of_its_end() -> None:
    arm, radius, length = panda(), 0.01, 0.06
    x, _, z = tool(arm)
    # A ledge beside the tool, 30 mm above its end: only the side of a cylinder reaches it, after 2 mm.
    ledge = f'<geom type="box" size="0.05 1 0.01" pos="{x + 0.05 + radius + 0.002} 0 {z + 0.03}" friction="0"/>'
    pushing = arm.home + np.array([0.0, 0.05, 0.0, 0.1, 0.0, 0.0, 0.0])
    cylinder = hold(
        taut.MujocoPlant(arm, scene=ledge, tool_radius=radius, tool_length=length), arm, pushing, duration=0.5
    )
    sphere = hold(taut.MujocoPlant(arm, scene=ledge, tool_radius=radius), arm, pushing, duration=0.5)
    first = int(np.argmax(cylinder.extra["F_ext"].any(axis=1)))
    assert cylinder.extra["F_ext"][first, 0] < -5.0
    assert not sphere.extra["F_ext"][: first + 20].any()


def test_a_scene_stands_where_it_is_put() -> None:
    arm = panda()
    x, y, z = tool(arm)
    wall = '<geom type="box" size="0.05 1 1" pos="0.05 0 0" friction="0"/>'  # its face at the origin, along -x
    here = f'<geom type="box" size="0.05 1 1" pos="{x + 0.012 + 0.05} {y} {z}" friction="0"/>'
    pushing = arm.home + np.array([0.0, 0.05, 0.0, 0.1, 0.0, 0.0, 0.0])
    put = hold(taut.MujocoPlant(arm, scene=wall, scene_at=taut.Pose([x + 0.012, y, z])), arm, pushing, duration=0.5)
    written = hold(taut.MujocoPlant(arm, scene=here), arm, pushing, duration=0.5)
    assert put.extra["F_ext"][-1, 0] < -5.0
    np.testing.assert_allclose(put.extra["F_ext"], written.extra["F_ext"], atol=1e-6)
    # Turned by half a turn about z it is behind its face, where the tool pushes away from it.
    turned = taut.Pose([x - 0.012, y, z], rpy=[0.0, 0.0, np.pi])
    behind = hold(taut.MujocoPlant(arm, scene=wall, scene_at=turned), arm, pushing, duration=0.5)
    assert not behind.extra["F_ext"].any()


def test_the_sensor_at_the_site_says_what_f_ext_says_and_the_payloads_weight_and_inertia() -> None:
    arm = panda().with_payload(2.0, com=(0.0, 0.0, 0.1))
    x, y, z = tool(arm)
    floor = f'<geom type="box" size="1 1 0.05" pos="{x} {y} {z - 0.05 - 0.01 - 0.001}"/>'
    plant = taut.MujocoPlant(arm, scene=floor)
    out = hold(plant, arm, arm.home + np.array([0.0, 0.05, 0.0, -0.05, 0.0, 0.0, 0.0]), duration=0.3)
    F_ext = out.extra["F_ext"][-1]
    assert F_ext[2] > 5.0
    # Newton for tool and payload: sensor + F_ext = m (a - gravity), which is what MuJoCo calls its acceleration.
    a, payload = np.zeros(6), plant.model.body("payload").id
    mujoco.mj_objectAcceleration(plant.model, plant.data, mujoco.mjtObj.mjOBJ_BODY, payload, a, 0)
    R = plant.data.site(arm.tool).xmat.reshape(3, 3)
    assert np.abs(R @ plant.data.sensordata[:3] + F_ext[:3] - 2.0 * a[3:]).max() < 1e-9
    assert np.abs(a[3:] - [0, 0, G]).max() > 1e-3  # it moves


@pytest.mark.parametrize("name", ["panda", "torso"])
def test_a_push_at_any_point_of_the_last_body_is_the_wrench_at_the_tool(name: str) -> None:
    arm = (torso() if name == "torso" else panda()).with_payload(1.0, com=(0.1, 0.0, 0.2))
    plant = taut.MujocoPlant(arm)
    plant.reset(arm.home, 0.5 * np.ones(arm.n), 1e-3)
    wrench = np.array([3.0, -4.0, 5.0, 0.6, 0.7, -0.8])
    payload = plant.model.body("payload").id
    link = int(plant.model.body_parentid[payload])
    for body, point in ((payload, plant.data.xipos[payload]), (link, plant.data.xipos[link])):
        plant.data.xfrc_applied[:] = 0.0
        plant.data.xfrc_applied[body] = wrench  # at the body's centre of mass
        plant.advance(np.zeros(arm.n))
        p = plant.data.site(arm.tool).xpos
        expected = np.concatenate([wrench[:3], wrench[3:] + np.cross(point - p, wrench[:3])])
        assert np.abs(plant.measure()["F_ext"] - expected).max() < 1e-12


def test_a_push_on_another_link_is_no_wrench_at_the_tool() -> None:
    arm = panda()
    plant = taut.MujocoPlant(arm)
    plant.reset(arm.home, np.zeros(7), 1e-3)
    plant.data.xfrc_applied[plant.model.body("panda_link4").id] = 10.0
    plant.advance(np.zeros(7))
    assert not plant.measure()["F_ext"].any()


def test_the_wrench_moves_the_arm_as_rigid_plants_environment_does() -> None:
    arm = torso()
    wrench = np.array([3.0, -4.0, 5.0, 0.6, 0.7, -0.8])
    plant = taut.MujocoPlant(arm)
    plant.reset(arm.home, np.zeros(5), 1e-3)
    plant.data.xfrc_applied[plant.model.body("payload").id] = wrench
    # xfrc_applied acts at the centre of mass; without a mass that is where the payload's com is said to be.
    r = np.asarray(plant.data.body("payload").xipos) - plant.data.site(arm.tool).xpos
    plant.advance(np.zeros(5))
    r = np.asarray(plant.data.body("payload").xipos) - plant.data.site(arm.tool).xpos
    at_tool = np.concatenate([wrench[:3], wrench[3:] + np.cross(r, wrench[:3])])
    constants = model_of(arm)
    M = dyn.mass_matrix(constants, arm.home) + 1e-3 * np.diag(arm.viscous)
    push = dyn.jacobian(constants, arm.home).T @ at_tool
    v = 1e-3 * np.linalg.solve(M, push - dyn.bias(constants, arm.home, np.zeros(5)))
    assert np.abs(plant.state()[1] - v).max() < 1e-12
    assert np.abs(plant.measure()["F_ext"] - at_tool).max() < 1e-12


def test_a_law_may_ask_for_the_wrench() -> None:
    class Yield(taut.Law):
        """tau = g - J^T F_ext: holds the arm against what pushes it."""

        reference = taut.JointMotion

        def command(self, x, ref):
            return taut.Torque(gravity=x.g, wrench=-(x.J().T @ x.F_ext))

    arm = taut.load_arm("planar3")
    plant = taut.MujocoPlant(arm, scene='<geom type="plane" size="3 3 1" pos="0 0 -5"/>')
    assert taut.run(taut.compile(Yield(), arm), plant, duration=0.1).outcome.ok


def test_links_touch_neither_the_scene_nor_each_other() -> None:
    arm = taut.load_arm("planar3")
    plant = taut.MujocoPlant(arm, scene='<geom type="plane" size="3 3 1" pos="0 0 -0.25"/>')
    taut.run(idle(arm), plant, duration=1.5)
    assert min(plant.data.body(f"link{i}").xpos[2] for i in (2, 3)) < -0.4
    folded = np.array([0.0, np.pi, np.pi])  # every link lies on the one before
    plant = taut.MujocoPlant(taut.load_arm("planar3", home=folded), scene='<geom size="0.1" pos="9 9 9"/>')
    taut.run(idle(arm), plant, duration=0.01)
    assert plant.data.ncon == 0


def test_a_free_body_of_the_scene_falls_and_is_back_in_the_next_run() -> None:
    arm = taut.load_arm("planar2")
    plant = taut.MujocoPlant(arm, scene='<body name="egg" pos="2 0 1"><freejoint/><geom size="0.1" mass="1"/></body>')
    for _ in range(2):
        taut.run(idle(arm), plant, duration=0.099)
        assert plant.data.body("egg").xpos[2] == pytest.approx(1.0 - 0.5 * G * 0.1 * 0.1, abs=1e-3)


def test_a_scene_file_brings_its_meshes_along(tmp_path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "wedge.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    file = tmp_path / "scene.xml"
    file.write_text(
        """<?xml version="1.0"?>
        <mujoco>
          <compiler meshdir="parts" angle="degree"/>
          <default><geom rgba="1 0 0 1"/><joint damping="7"/></default>
          <asset><mesh file="wedge.obj"/></asset>
          <worldbody>
            <geom type="mesh" mesh="wedge" pos="0 0 -3" euler="0 0 90"/>
            <body name="door" pos="3 0 0"><joint name="hinge" range="-90 90"/><geom size="0.1"/></body>
          </worldbody>
          <actuator><motor name="push" joint="hinge"/></actuator>
          <sensor><jointpos name="angle" joint="hinge"/></sensor>
        </mujoco>"""
    )
    arm = taut.load_arm("planar2")
    model = taut.MujocoPlant(arm, scene=file).model
    assert model.nmesh == 1
    assert model.joint("hinge").damping[0] == 7.0  # the scene's defaults are for the scene
    assert model.joint("joint1").damping[0] == arm.viscous[0]
    assert model.joint("hinge").range.tolist() == [-np.pi / 2, np.pi / 2]  # and so are its degrees
    assert {model.actuator(a).name for a in range(model.nactuator)} == {"joint1", "joint2", "push"}


def test_gravity_and_time_step_are_the_plants_whatever_the_scene() -> None:
    arm = taut.load_arm("planar2").with_gravity((1.0, 2.0, 3.0))
    plant = taut.MujocoPlant(arm, scene="<geom size='1'/>")
    assert plant.model.opt.gravity.tolist() == [1.0, 2.0, 3.0]
    assert int(plant.model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
