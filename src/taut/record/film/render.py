"""Pictures of a scene by MuJoCo's renderer, in a process of its own.

Which OpenGL works is found out by trying, and a failed try leaves traces in the process that made it: modules half
imported, environment variables, sometimes a crash. So each try has a process of its own, and the caller's stays as
it was. The process runs `painter`: it gets a folder with `scene.mjb` and `frames.npz`, says `ready` when it can draw,
and then writes one picture after the other, as bytes, to its standard output.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np

from taut.base.types import Float64Array
from taut.record.film import painter

__all__ = ["Frames", "NoRendererError", "Renderer", "backends", "check_mujoco", "opened"]

PATIENCE: Final = 120.0  # [s] until the first picture can be drawn
OFF: Final = ("off", "disable", "disabled", "false", "0")  # values of MUJOCO_GL


class NoRendererError(Exception):
    """No picture can be drawn; the text says why."""


@dataclass(frozen=True, kw_only=True)
class Frames:
    """What is drawn: the same numbers for every backend."""

    qpos: Float64Array  # (k, n) in the order of the model
    moving: Float64Array  # (k, m, 7) position [m] and quaternion wxyz of the bodies that move by themselves
    tool: Float64Array  # (k, 3) [m] where the tool goes
    wanted: Float64Array  # (k, 3) [m] where it should, or (0, 3)
    camera: Float64Array  # (6,) centre [m], distance [m], azimuth [deg], elevation [deg]
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


def check_mujoco() -> None:
    """See that MuJoCo can be imported: with an OpenGL that is broken, it may not.

    Raises:
        NoRendererError: It cannot.
    """
    try:
        import mujoco  # noqa: F401
    except Exception as cause:  # the bindings of OpenGL raise whatever they like
        raise NoRendererError(str(cause) or type(cause).__name__) from cause


def opened(folder: Path, model: Any, frames: Frames) -> Renderer:
    """A renderer with the first backend that works.

    Args:
        folder: An empty folder, for the files that the other process reads.
        model: A compiled MuJoCo model.
        frames: What to draw.

    Raises:
        NoRendererError: None works.
    """
    import mujoco

    mujoco.mj_saveModel(model, str(folder / "scene.mjb"), None)
    np.savez(folder / "frames.npz", allow_pickle=False, **vars(frames))
    reasons = []
    for backend in backends():
        if backend in OFF:
            raise NoRendererError(f"MUJOCO_GL is '{backend}'")
        renderer = Renderer(folder, backend, frames)
        reason = renderer.start()
        if reason is None:
            return renderer
        renderer.close()
        reasons.append(f"{backend or 'default'}: {reason}")
    raise NoRendererError("; ".join(reasons))


class Renderer:
    """The other process, seen from here. A context manager."""

    def __init__(self, folder: Path, backend: str, frames: Frames) -> None:
        self.backend = backend or "OpenGL"
        self._folder, self._frames = folder, frames
        environment = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
        if backend:
            environment["MUJOCO_GL"] = backend
        self._errors = (folder / "errors.txt").open("w+b")
        self._process = subprocess.Popen(
            [sys.executable, "-P", painter.__file__, str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=environment,
        )

    def start(self) -> str | None:
        """Wait until it can draw; None if it can, else why not."""
        timer = threading.Timer(PATIENCE, self._process.kill)
        timer.start()
        try:
            answer = self._read(len(painter.READY))
        finally:
            timer.cancel()
        return None if answer == painter.READY else self._last_words()

    def pictures(self) -> Iterator[np.ndarray[Any, np.dtype[np.uint8]]]:
        """One picture (height, width, 3) per frame.

        Raises:
            NoRendererError: The process ended before the last picture.
        """
        width, height = self._frames.size
        for _ in range(len(self._frames.qpos)):
            data = self._read(width * height * 3)
            if len(data) < width * height * 3:
                raise NoRendererError(self._last_words())
            yield np.frombuffer(data, dtype=np.uint8).reshape(height, width, 3)

    def _read(self, count: int) -> bytes:
        assert self._process.stdout is not None
        return self._process.stdout.read(count)

    def _last_words(self) -> str:
        self._process.kill()
        self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1].strip() if lines else "it ended without a word"

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._errors.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
