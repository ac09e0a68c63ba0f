"""The program that draws the pictures of a film; `render` starts it. It imports nothing of taut.

Usage: painter.py FOLDER, with `scene.mjb` and `frames.npz` in it; see `render.Frames` for what they hold.
"""

from __future__ import annotations

import itertools
import sys
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

__all__ = ["READY", "TRAIL"]

READY: Final = b"ready\n"
TRAIL: Final = (0.84, 0.37, 0.0, 0.9)
WANTED: Final = (0.2, 0.2, 0.2, 0.55)
MOST_PIECES: Final = 400  # of a trail


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
        _trail(renderer.scene, frames["wanted"], WANTED, height / 320.0)
        _trail(renderer.scene, frames["tool"][: k + 1], TRAIL, height / 160.0)
        renderer.render(out=picture)
        out.write(picture.tobytes())
    out.flush()
    renderer.close()


def _trail(scene: Any, points: Any, rgba: tuple[float, ...], width: float) -> None:
    """A line through points, so many pixels wide, as decoration of the scene."""
    import mujoco

    points = points[:: max(1, -(-len(points) // MOST_PIECES))]
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
