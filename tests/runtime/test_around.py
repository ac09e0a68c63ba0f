"""What a plant says of what stands around its arm: surfaces in closed form, and the bodies of a MuJoCo model."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

import taut
from taut.record.info import POSES, Around, Thing
from taut.runtime.simulate import around_info

C = taut.Constraint
ARM = taut.load_arm("fr3")
T0 = taut.snapshot(ARM, ARM.home).T()
P = T0.p
CLOSE = 1e-6  # [m]


def around(**plant: Any) -> Around:
    return around_info(taut.RigidPlant(ARM, friction=None, **plant), ARM.home, 2.0)


def only(found: Around, kind: str) -> Thing:
    assert not found.missing
    (thing,) = found.things
    (shape,) = thing.shapes
    assert shape.kind == kind
    return thing


def axis(thing: Thing) -> np.ndarray[Any, Any]:
    return taut.Pose(wxyz=thing.wxyz).R[:, 2]


@pytest.mark.parametrize("normal", [[0, 0, 1], [0.6, 0.0, 0.8], [-1, 0, 0]])
def test_a_plane_is_a_board_whose_face_is_below_the_tool(normal: list[float]) -> None:
    n = np.array(normal, dtype=float)
    for constraint in (
        C.plane(point=P - 0.1 * n + np.cross(n, [0.0, 1.0, 0.3]), normal=n),
        C.plane(point=P - 0.1 * n, normal=n, face=T0.R.T @ -n),
    ):
        board = only(around(contact=taut.RigidContact(constraint=constraint)), "box")
        np.testing.assert_allclose(axis(board), n, atol=CLOSE)
        thick = board.shapes[0].size[2]
        np.testing.assert_allclose(np.array(board.p) + thick * n, P - 0.1 * n, atol=CLOSE)


def test_a_ball_and_a_pipe_stand_where_they_are_declared() -> None:
    ball = only(around(contact=C.sphere(center=P - [-0.1, -0.2, 0.3], radius=0.2)), "sphere")
    np.testing.assert_allclose(ball.p, P - [-0.1, -0.2, 0.3], atol=1e2 * CLOSE)
    assert ball.shapes[0].size[0] == pytest.approx(0.2, abs=1e2 * CLOSE)
    hollow = only(around(contact=C.sphere(center=P, radius=0.4, inside=True)), "sphere")
    assert hollow.shapes[0].rgba[3] < 0.5 < ball.shapes[0].rgba[3]
    u, point = np.array([0.6, 0.0, 0.8]), P - [0.0, -0.3, 0.0]
    pipe = only(around(contact=C.cylinder(point=point + 0.7 * u, axis=u, radius=0.15)), "cylinder")
    assert abs(axis(pipe) @ u) == pytest.approx(1.0, abs=CLOSE)
    np.testing.assert_allclose(np.cross(np.array(pipe.p) - point, u), 0.0, atol=1e2 * CLOSE)
    assert abs((np.array(pipe.p) - P) @ u) < 0.02  # beside the tool
    assert pipe.shapes[0].size[0] == pytest.approx(0.15, abs=1e2 * CLOSE)


def test_a_surface_that_sways_goes_with_its_time() -> None:
    board = only(around(contact=C.plane(point=P, normal=[0, 0, 1], sway=[0.0, 0.0, 0.1], period=1.6)), "box")
    wanted = 0.05 * (1.0 - np.cos(2.0 * np.pi * np.array(board.times) / 1.6))
    np.testing.assert_allclose(np.array(board.shifts)[:, 2], wanted, atol=CLOSE)
    assert board.times[-1] == 2.0


def test_walls_are_shown_and_what_has_no_surface_is_said() -> None:
    wall = taut.environments.StiffWall(point=P - [0.3, 0.0, 0.1], normal=[0.0, 0.0, 2.0], stiffness=1e3)
    board = only(
        around(environment=taut.environments.Environments(wall=wall, damper=taut.environments.Damper(damping=1.0))),
        "box",
    )
    np.testing.assert_allclose(np.add(board.p, (0.0, 0.0, board.shapes[0].size[2])), P - [0.0, 0.0, 0.1])
    assert not around()
    assert not around(environment=taut.environments.Spring(stiffness=(1e3, 10.0)))
    for constraint, rows in (
        (C.hinge(point=P - [0.0, -0.3, 0.0], axis=[0, 0, 1], T=T0), 5),
        (C(lambda T: T.p[2] - P[2], one_sided=True), 1),
    ):
        said = around(contact=taut.RigidContact(constraint=constraint)).missing
        assert said == (f"a constraint of {rows} rows that declares no surface",)


def scene_of(bodies: str, assets: str = "") -> Around:
    plant = taut.MujocoPlant(ARM, scene=f"<mujoco><asset>{assets}</asset><worldbody>{bodies}</worldbody></mujoco>")
    return plant.around()


def test_meshes_of_a_scene_stand_where_mujoco_has_them() -> None:
    mesh = '<mesh name="wedge" vertex="0 0 0  0.3 0 0  0 0.2 0  0 0 0.1" scale="1 2 1"/>'
    bodies = '<body pos="0.1 0.2 0.3" euler="20 30 40"><geom type="mesh" mesh="wedge" rgba="0 1 0 1"/></body>'
    found = scene_of(bodies, mesh)
    thing = next(thing for thing in found.things if not thing.on_tool)
    (shape,) = thing.shapes
    T = taut.Pose(thing.p, wxyz=thing.wxyz) @ taut.Pose(shape.p, wxyz=shape.wxyz)
    corners = np.array([T.R @ v + T.p for v in found.meshes[shape.mesh].vertices])
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><body name="b" {bodies[6:].split(">")[0]}/></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    R, p = data.body("b").xmat.reshape(3, 3), data.body("b").xpos
    wanted = np.array([R @ v + p for v in ([0, 0, 0], [0.3, 0, 0], [0, 0.4, 0], [0, 0, 0.1])])
    distances = np.linalg.norm(corners[:, np.newaxis] - wanted, axis=2)
    assert distances.min(axis=0).max() < 1e-6


def test_the_arm_is_not_of_the_scene() -> None:
    scene = '<mujoco><worldbody><geom type="box" size="0.1 0.1 0.1" pos="1 0 0"/></worldbody></mujoco>'
    plant = taut.MujocoPlant(taut.load_arm("z1"), scene=scene)
    assert [shape.kind for thing in plant.around().things for shape in thing.shapes] == ["box", "sphere"]


def test_what_a_viewer_hides_is_not_shown_and_what_cannot_be_is_said() -> None:
    found = scene_of(
        '<geom type="box" size="1 1 1" group="3"/><geom type="box" size="1 1 1" rgba="1 1 1 0"/>'
        '<geom type="hfield" hfield="hills"/>',
        '<hfield name="hills" nrow="2" ncol="2" size="1 1 1 1" elevation="0 1 1 0"/>',
    )
    assert [thing.on_tool for thing in found.things] == [True]
    assert found.missing == ("1 of its geoms, of kind hfield",)
    many = "".join(f'<body><joint name="j{i}"/><geom size="0.1"/></body>' for i in range(40))
    found = scene_of(many)
    assert sorted(thing.row for thing in found.things if thing.row is not None) == list(range(32))
    assert found.missing == ("8 of its moving bodies, beyond 32",)


def test_in_a_model_of_ones_own_all_but_the_links_is_shown() -> None:
    arm = taut.load_arm("planar2")
    xml = """
    <mujoco><option timestep="0.001"/><worldbody>
      <geom name="table" type="box" size="1 1 0.1" pos="0 0 -1"/>
      <body name="box" pos="2 0 0"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>
      {arm}
    </worldbody></mujoco>"""
    links = ""
    for joint, body in zip(reversed(arm.joints), reversed(arm.bodies), strict=True):
        p, wxyz = " ".join(map(repr, joint.placement.p.tolist())), " ".join(map(repr, joint.placement.wxyz.tolist()))
        inertia = body.inertia
        full = " ".join(repr(float(inertia[i, j])) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
        com = " ".join(map(repr, body.com.tolist()))
        links = (
            f'<body pos="{p}" quat="{wxyz}"><joint name="{joint.name}" axis="{" ".join(map(str, joint.axis))}"/>'
            f'<inertial mass="{body.mass!r}" pos="{com}" fullinertia="{full}"/>'
            f'<geom size="0.05" contype="0" conaffinity="0"/>{links}</body>'
        )
    model = mujoco.MjModel.from_xml_string(xml.replace("{arm}", links))
    model.opt.gravity[:] = arm.gravity
    data = mujoco.MjData(model)
    plant = taut.MujocoPlant.attach(model, data, arm)
    found = plant.around()
    assert [thing.row for thing in found.things] == [None, 0]
    ctrl = taut.compile(taut.laws.GravityPID(kp=10.0, kd=1.0), arm, adds=plant.adds)
    run = taut.run(ctrl, plant, taut.JointMotion(q=arm.home), duration=0.1)
    fall = run.extra[POSES][:, 0, 2]
    np.testing.assert_allclose(fall, 0.5 * arm.gravity[2] * run.t * (run.t + 0.001), atol=1e-9)
