"""Films: rendered where OpenGL works, refused where it does not, never half written."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from PIL import Image
from refusals import refused

import taut
from taut.maths import dynamics
from taut.maths.model import model_of
from taut.record import render, scene
from taut.record.info import RunInfo
from taut.record.scene import points_of, view_of

SIZE = (96, 72)
PLACES = 1e-9  # [m] between our kinematics and MuJoCo's


@pytest.fixture
def moving(make_run: Any) -> Any:
    """An arm that swings all its joints for a second."""

    def make(arm: taut.Arm, seconds: float = 1.0) -> taut.Run:
        t = np.arange(round(100 * seconds) + 1) * 0.01
        q = arm.home + 0.4 * np.outer(np.sin(2.0 * t), np.ones(arm.n))
        info = RunInfo(rate=100.0, arm=arm.name)
        return make_run(t, q, q_ref=q + 0.05, arm=arm, joint_names=arm.joint_names, units=arm.units, info=info)

    return make


@pytest.fixture
def without_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "off")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[render.Frames]:
    """A renderer that draws nothing, for what does not depend on the pictures; the list has what it is to draw."""
    asked: list[render.Frames] = []

    @contextlib.contextmanager
    def opened(_folder: Path, _model: Any, frames: render.Frames) -> Any:
        asked.append(frames)
        width, height = frames.size
        yield (np.full((height, width, 3), k % 256, dtype=np.uint8) for k in range(len(frames.qpos)))

    monkeypatch.setattr(render, "opened", opened)
    return asked


def pictures(path: Path) -> tuple[list[np.ndarray[Any, Any]], list[int]]:
    """The pictures of a GIF and how long each is shown [ms]."""
    out, times = [], []
    with Image.open(path) as film:
        for k in range(film.n_frames):  # type: ignore[attr-defined]
            film.seek(k)
            out.append(np.asarray(film.convert("RGB")))
            times.append(int(film.info["duration"]))
    return out, times


# -------------------------------------------------------------------- films


def test_a_film_shows_the_arm_moving_in_real_time(moving: Any, tmp_path: Path) -> None:
    run = moving(taut.load_arm("planar2"))
    before = dict(os.environ)
    try:
        path = run.video(tmp_path / "run.gif", size=SIZE)
    except taut.errors.MissingExtraError:
        pytest.skip("this machine has no OpenGL")
    frames, times = pictures(path)
    assert frames[0].shape == (72, 96, 3)
    assert len(frames) == 31
    assert sum(times) == pytest.approx(31 * 1000 / 30, abs=10)
    assert np.abs(frames[0].astype(int) - frames[15]).max() > 60
    assert frames[0].std() > 3.0
    assert dict(os.environ) == before
    assert [file.name for file in tmp_path.iterdir()] == ["run.gif"]


@pytest.mark.usefixtures("without_opengl")
def test_without_opengl_there_is_one_sentence_and_no_file(moving: Any, tmp_path: Path) -> None:
    run = moving(taut.load_arm("panda"), 0.3)
    path = tmp_path / "run.gif"
    with pytest.raises(
        taut.errors.MissingExtraError, match=r"needs OpenGL, and none works here \(off: .*; install EGL or"
    ):
        run.video(path, size=(200, 150))
    assert not list(tmp_path.iterdir())


def test_the_camera_looks_from_where_it_is_told(moving: Any, quick: list[render.Frames], tmp_path: Path) -> None:
    run = moving(taut.load_arm("panda"), 0.2)
    for camera in (None, (30.0, -60.0)):
        run.video(tmp_path / "run.gif", size=(32, 32), camera=camera)
    usual, turned = (frames.camera for frames in quick)
    assert (*turned[4:],) == (30.0, -60.0)
    np.testing.assert_array_equal(turned[:4], usual[:4])


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(("fps", "speed", "count"), [(10, 1.0, 6), (10, 2.0, 3), (20, 0.5, 21), (7, 1.0, 4)])
def test_the_number_of_pictures_follows_rate_and_speed(
    moving: Any, fps: int, speed: float, count: int, tmp_path: Path
) -> None:
    run = moving(taut.load_arm("one_joint"), 0.5)
    frames, times = pictures(run.video(tmp_path / "run.gif", fps=fps, speed=speed, size=(32, 32)))
    assert len(frames) == count
    assert sum(times) == pytest.approx(1000 * count / fps, abs=10)


@pytest.mark.usefixtures("quick")
def test_a_film_of_a_run_that_diverged_ends_before(moving: Any, tmp_path: Path) -> None:
    run = moving(taut.load_arm("one_joint"))
    run.q[50:] = 1e9
    run.q[60:] = np.nan
    frames, _ = pictures(run.video(tmp_path / "run.gif", fps=10, size=(32, 32)))
    assert len(frames) == 5


@pytest.mark.usefixtures("quick")
def test_a_loaded_run_is_filmed_with_an_arm(moving: Any, tmp_path: Path) -> None:
    arm = taut.load_arm("one_joint")
    run = taut.load_run(moving(arm, 0.2).save(tmp_path / "run.mcap"))
    assert run.video(tmp_path / "run.gif", size=(32, 32), arm=arm).exists()


# -------------------------------------------------------------------- the other process


def test_a_backend_that_fails_is_named_and_the_next_is_tried(
    moving: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = moving(taut.load_arm("one_joint"), 0.1)
    monkeypatch.setattr(render, "backends", lambda: ["nonsense", "off"])
    with pytest.raises(taut.errors.MissingExtraError, match=r"\(nonsense: .*MUJOCO_GL: nonsense.*; off: "):
        run.video(tmp_path / "run.gif", size=(32, 32))


def test_a_users_choice_of_backend_is_the_only_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert render.backends() == ["osmesa"]
    monkeypatch.delenv("MUJOCO_GL")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("platform.system", lambda: "Linux")
    assert render.backends() == ["egl", "osmesa"]
    monkeypatch.setenv("DISPLAY", ":0")
    assert render.backends() == ["egl", "osmesa", "glfw"]
    monkeypatch.setattr("platform.system", lambda: "Darwin")
    assert render.backends() == [""]


def test_a_renderer_that_dies_leaves_no_half_film(
    moving: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def dying() -> Any:
        yield np.zeros((32, 32, 3), dtype=np.uint8)
        raise render.NoRendererError("killed")

    monkeypatch.setattr(render, "opened", lambda *_: contextlib.nullcontext(dying()))
    with refused(taut.errors.FileError):
        moving(taut.load_arm("one_joint")).video(tmp_path / "run.gif", size=(32, 32))
    assert not list(tmp_path.iterdir())


# -------------------------------------------------------------------- the scene


@pytest.mark.parametrize("name", ["panda", "kinova", "z1", "gantry3", "one_joint", "upside down"])
def test_the_scene_and_the_skeleton_stand_where_the_dynamics_say(name: str) -> None:
    if name == "upside down":
        arm = taut.load_arm("kinova").mounted(taut.Pose([0.1, 0.2, 1.0], rpy=[np.pi, 0.0, 0.3]))
    else:
        arm = taut.load_arm(name)
    q = arm.home + 0.3 * np.sin(np.arange(arm.n) + 1.0)
    points = points_of(arm, q[np.newaxis])
    model, places, problem = scene.scene(arm, view_of(arm, points), SIZE)
    assert not problem
    data = mujoco.MjData(model)
    data.qpos[places] = q
    mujoco.mj_kinematics(model, data)
    drawn = np.array([data.body(f"body {i}").xpos for i in range(arm.n)])
    np.testing.assert_allclose(points[0, 1:-1], drawn, atol=PLACES)
    np.testing.assert_allclose(points[0, 0], data.body("base").xpos, atol=PLACES)
    tool = dynamics.pose(model_of(arm), q)
    np.testing.assert_allclose(points[0, -1], tool.p, atol=PLACES)
    seen = {model.geom(i).bodyid[0] for i in range(model.ngeom)}
    assert seen - {0}, "nothing is drawn"


def test_the_joints_of_a_branched_arm_find_their_places() -> None:
    """MuJoCo numbers the joints of a tree branch by branch, an Arm as it likes."""
    joints = taut.load_arm("planar3").joints
    arm = taut.load_arm("planar3")
    side = dataclasses.replace(joints[2], name="side", parent=0)
    branched = dataclasses.replace(
        arm, joints=(joints[0], joints[1], side, joints[2]), bodies=(*arm.bodies, arm.bodies[2]),
        frames=tuple(f for f in arm.frames if f.body < 2), tool=arm.frame_names[0], home=np.zeros(4), visuals=(),
    )  # fmt: skip
    q = np.array([0.1, 0.2, 0.3, 0.4])
    points = points_of(branched, q[np.newaxis])
    model, places, _ = scene.scene(branched, view_of(branched, points), SIZE)
    data = mujoco.MjData(model)
    data.qpos[places] = q
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(points[0, 1:-1], [data.body(f"body {i}").xpos for i in range(4)], atol=PLACES)


def test_the_view_holds_all_that_the_arm_does(moving: Any) -> None:
    for name in ("panda", "gantry3", "planar3", "one_joint"):
        run = moving(taut.load_arm(name))
        points = points_of(run.arm, run.q)
        view = view_of(run.arm, points)
        far = np.linalg.norm(points - view.centre, axis=-1).max()
        assert far <= view.radius <= 1.5 * far or view.radius < 0.1
        assert view.floor <= points[..., 2].min() + 1e-9
        assert view.distance(640, 480) == view.distance(480, 480) < view.distance(240, 480)


def test_an_arm_in_a_vertical_plane_is_seen_from_its_side() -> None:
    arm = taut.load_arm("planar2")
    view = view_of(arm, points_of(arm, np.zeros((1, 2))))
    assert view.azimuth == pytest.approx(90.0)  # looking along y, so that x goes to the right


def test_meshes_that_cannot_be_read_become_capsules(tmp_path: Path) -> None:
    arm = taut.load_arm("xarm7")
    broken = tmp_path / "broken.stl"
    broken.write_bytes(b"solid nonsense")
    bad = dataclasses.replace(arm.visuals[2], file=str(broken))
    view = view_of(arm, points_of(arm, arm.home[np.newaxis]))
    model, _, problem = scene.scene(dataclasses.replace(arm, visuals=(*arm.visuals[:2], bad)), view, SIZE)
    assert problem.startswith("MuJoCo cannot show them: ")
    assert model.nmesh == 0
    assert (model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE).sum() > 4
    gone = dataclasses.replace(bad, file=str(tmp_path / "none.stl"))
    model, _, problem = scene.scene(dataclasses.replace(arm, visuals=(*arm.visuals[:2], gone)), view, SIZE)
    assert problem == "some of their files are not there"
    assert model.nmesh > 0


# -------------------------------------------------------------------- messages


def test_every_wrong_request_gets_one_sentence(moving: Any, tmp_path: Path) -> None:
    run = moving(taut.load_arm("one_joint"))
    bare = dataclasses.replace(run, arm=None)
    path = tmp_path / "run.gif"
    wrong: list[tuple[Any, dict[str, Any]]] = [
        (run, {"path": tmp_path / "run.avi"}),
        (run, {"path": tmp_path / "no" / "run.gif"}),
        (run, {"path": tmp_path}),
        (bare, {}),
        (run, {"arm": taut.load_arm("planar2")}),
        (run, {"arm": "panda"}),
        (run, {"camera": (10.0,)}),
        (run, {"fps": 0}),
        (run, {"fps": 60}),
        (run, {"fps": 29.97}),
        (run, {"size": 640}),
        (run, {"size": (640, 8)}),
        (run, {"speed": 0.0}),
    ]  # fmt: skip
    for one, request in wrong:
        with refused(taut.TautError):
            one.video(**({"path": path} | request))
    assert not list(tmp_path.iterdir())


def test_a_run_without_ticks_cannot_be_filmed(make_run: Any, tmp_path: Path) -> None:
    arm = taut.load_arm("one_joint")
    run = make_run([], np.zeros((0, 1)), arm=arm, joint_names=arm.joint_names)
    with refused(taut.errors.UsageError):
        run.video(tmp_path / "run.gif")
