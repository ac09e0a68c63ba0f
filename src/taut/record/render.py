"""Pictures of a scene by MuJoCo's renderer, in a process of its own.

Which OpenGL works is found out by trying, and a failed try leaves traces in its process: modules half imported,
environment variables, sometimes a crash. So each try runs this file in a process of its own, without taut: it gets a
folder with `scene.mjb` and `frames.npz`, says `ready`, and writes pictures as bytes to its standard output.
"""

from __future__ import annotations

import itertools
import os
import platform
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, TypeAlias

import numpy as np

START_TIMEOUT: Final = 120.0  # [s] until the first picture can be drawn
READY: Final = b"ready\n"
TRAIL: Final = (0.84, 0.37, 0.0, 0.9)
REFERENCE: Final = (0.2, 0.2, 0.2, 0.55)
MAX_PIECES: Final = 400  # of a trail


Numbers: TypeAlias = np.ndarray[Any, np.dtype[np.float64]]
Picture: TypeAlias = np.ndarray[Any, np.dtype[np.uint8]]


class NoRendererError(Exception):
    """No picture can be drawn; the text says why."""


@dataclass(frozen=True, kw_only=True)
class Frames:
    """What is drawn: the same numbers for every backend."""

    qpos: Numbers  # (k, n) in the order of the model
    moving: Numbers  # (k, m, 7) position [m] and quaternion wxyz of the bodies that move by themselves
    tool: Numbers  # (k, 3) [m] where the tool goes
    wanted: Numbers  # (k, 3) [m] where it should, or (0, 3)
    camera: Numbers  # (6,) centre [m], distance [m], azimuth [deg], elevation [deg]
    size: tuple[int, int]


def backends() -> list[str]:
    """Values of MUJOCO_GL to try, in order; a user's own choice is the only one."""
    chosen = os.environ.get("MUJOCO_GL", "")
    if chosen:
        return [chosen]
    if platform.system() != "Linux":
        return [""]
    screen = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return ["egl", "osmesa", *(["glfw"] if screen else [])]


@contextmanager
def opened(folder: Path, model: Any, frames: Frames) -> Iterator[Iterator[Picture]]:
    """One picture (height, width, 3) per frame, by the first backend that works; files go to an empty folder."""
    import mujoco

    mujoco.mj_saveModel(model, str(folder / "scene.mjb"), None)
    np.savez(folder / "frames.npz", allow_pickle=False, **vars(frames))
    reasons = []
    for backend in backends():
        with (folder / "errors.txt").open("w+b") as errors, _started(folder, backend, errors) as process:
            if _can_draw(process):
                yield _pictures(process, errors, len(frames.qpos), frames.size)
                return
            reasons.append(f"{backend or 'default'}: {_last_words(process, errors)}")
    raise NoRendererError("; ".join(reasons))


@contextmanager
def _started(folder: Path, backend: str, errors: IO[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """The other process, until the context ends."""
    environment = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
    if backend:
        environment["MUJOCO_GL"] = backend
    command = [sys.executable, "-P", __file__, str(folder)]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors, env=environment
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def _can_draw(process: subprocess.Popen[bytes]) -> bool:
    """Wait until it can draw, or until it has ended."""
    assert process.stdout is not None
    timer = threading.Timer(START_TIMEOUT, process.kill)
    timer.start()
    try:
        return process.stdout.read(len(READY)) == READY
    finally:
        timer.cancel()


def _pictures(
    process: subprocess.Popen[bytes], errors: IO[bytes], count: int, size: tuple[int, int]
) -> Iterator[Picture]:
    assert process.stdout is not None
    width, height = size
    for _ in range(count):
        data = process.stdout.read(width * height * 3)
        if len(data) < width * height * 3:
            raise NoRendererError(_last_words(process, errors))
        yield np.frombuffer(data, dtype=np.uint8).reshape(height, width, 3)


def _last_words(process: subprocess.Popen[bytes], errors: IO[bytes]) -> str:
    process.kill()
    process.wait()
    errors.seek(0)
    lines = errors.read().decode(errors="replace").strip().splitlines()
    return lines[-1].strip() if lines else "it ended without a message"


def draw_all(folder: Path, out: IO[bytes]) -> None:
    """Write READY, then the bytes of each picture."""
    import mujoco

    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    with np.load(folder / "frames.npz", allow_pickle=False) as read:
        frames = {name: read[name] for name in read.files}
    width, height = (int(x) for x in frames["size"])
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance = frames["camera"][:3], frames["camera"][3]
    camera.azimuth, camera.elevation = frames["camera"][4:]
    renderer = mujoco.Renderer(model, height=height, width=width)
    picture = np.empty((height, width, 3), dtype=np.uint8)
    renderer.update_scene(data, camera)
    renderer.render(out=picture)  # whatever can go wrong has gone wrong by now
    out.write(READY)
    for k, qpos in enumerate(frames["qpos"]):
        data.qpos = qpos
        data.mocap_pos, data.mocap_quat = frames["moving"][k, :, :3], frames["moving"][k, :, 3:]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        renderer.update_scene(data, camera)
        _trail(renderer.scene, frames["wanted"], REFERENCE, height / 320.0)
        _trail(renderer.scene, frames["tool"][: k + 1], TRAIL, height / 160.0)
        renderer.render(out=picture)
        out.write(picture.tobytes())
    out.flush()
    renderer.close()


def _trail(scene: Any, points: Any, rgba: tuple[float, ...], width: float) -> None:
    """A line through points, so many pixels wide, as decoration of the scene."""
    import mujoco

    points = points[:: max(1, -(-len(points) // MAX_PIECES))]
    stroke = mujoco.mjtGeom.mjGEOM_LINE
    for a, b in itertools.pairwise(points):
        if scene.ngeom >= scene.maxgeom or not np.any(a != b):
            continue
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, stroke, np.zeros(3), np.zeros(3), np.zeros(9), np.array(rgba, dtype=np.float32))
        mujoco.mjv_connector(geom, stroke, width, a, b)
        scene.ngeom += 1


if __name__ == "__main__":
    with suppress(BrokenPipeError):  # nobody wants to see more
        draw_all(Path(sys.argv[1]), sys.stdout.buffer)
