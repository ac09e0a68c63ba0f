"""What stands around an arm in films: where it was, from a log too, and in sight."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from PIL import Image
from scipy.integrate import solve_ivp

import taut
from taut.record import scene
from taut.record.film import poses_of
from taut.record.info import POSES, Around, Mesh, Shape, Thing
from taut.record.plain import plain, restored
from taut.record.scene import points_of, view_of

SIZE = (96, 72)
PLACES = 1e-9  # [m]
EULER = 2e-3  # [rad] of 200 steps of 1 ms from rest, against an integrator without steps


def test_what_moves_in_a_scene_is_recorded_where_it_was(pressing_task: taut.Run) -> None:
    found = pressing_task.info.around
    board, tool, flap = found.things  # in the order of MuJoCo's bodies: world, tool, scene
    assert not found.missing
    assert [shape.kind for thing in found.things for shape in thing.shapes] == ["box", "sphere", "box"]
    assert board.shapes[0].rgba == (1.0, 0.0, 1.0, 1.0)
    assert tool.on_tool
    assert flap.row == 0
    origin = taut.snapshot(pressing_task.arm, pressing_task.q[0]).T().p - [0.0, 0.0, 0.011]
    np.testing.assert_allclose(board.shapes[0].p, origin - [0.0, 0.0, 0.05], atol=PLACES)
    poses = pressing_task.extra[POSES][:, 0]
    np.testing.assert_allclose(poses[:, :3], np.tile(np.add(origin, [0.2, -0.2, 0.2]), (len(poses), 1)), atol=PLACES)
    m, c = 0.1, 0.1  # [kg], [m]
    inertia = m * (0.2**2 + 0.04**2) / 12.0 + m * c**2
    t = pressing_task.t
    fall = solve_ivp(
        lambda _, y: [y[1], (m * 9.81 * c * np.cos(y[0]) - 0.01 * y[1]) / inertia], (0.0, t[-1]), [0.0, 0.0], t_eval=t
    )
    angle = 2.0 * np.arctan2(poses[:, 5], poses[:, 3])
    np.testing.assert_allclose(angle, fall.y[0], atol=EULER)
    assert angle[-1] > 0.5


def test_the_scene_of_a_film_stands_as_that_of_the_plant(pressing_task: taut.Run, tmp_path: Path) -> None:
    again = taut.load_run(pressing_task.save(tmp_path / "run.mcap"))
    arm, ticks = pressing_task.arm, np.array([0, 100, 200])
    for run in (pressing_task, again):
        found = run.info.around
        points = points_of(arm, run.q[ticks])
        model, places, problem = scene.scene(arm, view_of(arm, points), SIZE, found)
        assert not problem
        data = mujoco.MjData(model)
        for k, moving in enumerate(poses_of(run, found, ticks)):
            data.qpos[places] = run.q[ticks[k]]
            data.mocap_pos, data.mocap_quat = moving[:, :3], moving[:, 3:]
            mujoco.mj_kinematics(model, data)
            by_colour = {tuple(model.geom_rgba[i]): data.geom_xpos[i] for i in range(model.ngeom)}
            row = pressing_task.extra[POSES][ticks[k], 0]
            R = taut.Pose(row[:3], wxyz=row[3:]).R
            np.testing.assert_allclose(by_colour[0.0, 1.0, 1.0, 1.0], row[:3] + R @ [0.1, 0.0, 0.0], atol=1e-7)
            touching = data.geom_xpos[[i for i in range(model.ngeom) if model.geom_size[i, 0] == 0.01]]
            np.testing.assert_allclose(touching[0], points[k, -1], atol=PLACES)


def test_a_film_from_a_log_shows_the_scene(pressing_task: taut.Run, tmp_path: Path) -> None:
    run = taut.load_run(pressing_task.save(tmp_path / "run.mcap"))
    try:
        path = run.video(tmp_path / "run.gif", fps=5, size=SIZE, arm=pressing_task.arm)
    except taut.errors.MissingExtraError:
        pytest.skip("this machine has no OpenGL")
    flaps = []
    for picture in pictures(path):
        red, green, blue = picture.transpose(2, 0, 1)
        assert ((red - green > 60) & (blue - green > 60)).sum() > 30  # the board
        flaps.append((green - red > 60) & (blue - red > 60))
    assert min(flap.sum() for flap in flaps) > 5
    assert (flaps[0] != flaps[1]).sum() > 5


def pictures(path: Path) -> list[np.ndarray[Any, Any]]:
    """Those of a GIF."""
    out = []
    with Image.open(path) as film:
        for k in range(film.n_frames):  # type: ignore[attr-defined]
            film.seek(k)
            out.append(np.asarray(film.convert("RGB")).astype(int))
    return out


def test_what_moves_as_is_known_beforehand_is_where_it_is_then(make_run: Any) -> None:
    shape = Shape(kind="sphere", size=(0.1, 0.0, 0.0))
    thing = Thing(shapes=(shape,), p=(1.0, 2.0, 3.0), times=(0.0, 1.0), shifts=((0.0, 0.0, 0.0), (0.0, 0.0, 0.4)))
    found = Around(things=(Thing(shapes=(shape,)), thing))
    run = make_run(np.arange(5) * 0.25, np.zeros((5, 1)))
    poses = poses_of(run, found, np.array([0, 1, 4]))
    np.testing.assert_allclose(poses[:, 0, :3], [[1.0, 2.0, 3.0], [1.0, 2.0, 3.1], [1.0, 2.0, 3.4]])


def test_what_is_around_reads_back_from_plain_values() -> None:
    mesh = Mesh(vertices=np.array([[0.0, 0.5, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.25]]), faces=np.array([[0, 1, 2]]))
    shapes = (Shape(kind="mesh", size=(0.0, 0.0, 0.0), mesh=0), Shape(kind="box", size=(1.0, 2.0, 3.0)))
    thing = Thing(shapes=shapes, p=(1.0, 2.0, 3.0), row=0, times=(0.0, 1.0), shifts=((0.0, 0.0, 0.0),) * 2)
    found = Around(things=(thing,), meshes=(mesh,), missing=("a",))
    again = restored(Around, json.loads(json.dumps(plain(found))), "around")
    assert again.things == (thing,)
    assert again.missing == ("a",)
    np.testing.assert_array_equal(again.meshes[0].vertices, mesh.vertices)
    np.testing.assert_array_equal(again.meshes[0].faces, mesh.faces)
