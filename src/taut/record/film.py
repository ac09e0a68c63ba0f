"""Films of a run: pictures by MuJoCo, as a GIF."""

from __future__ import annotations

import itertools
import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, positive_scalar, whole_number
from taut.base.errors import FileError, MissingExtraError, RangeError, UsageError, warn
from taut.base.types import Float64Array
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.model import Chain, model_of
from taut.record import render, scene
from taut.record.info import POSES, Around
from taut.record.log.files import checked_target, written_aside
from taut.record.progress import Progress

if TYPE_CHECKING:
    from taut.record.run import Run

Ticks: TypeAlias = np.ndarray[Any, np.dtype[np.intp]]

SUFFIXES: Final = (".gif",)
MAX_FPS: Final = 50  # [1/s] a GIF counts in hundredths of a second
SIZES: Final = (16, 4096)  # [pixel]
MAX_POSITION: Final = 1e6  # [rad | m] positions beyond this are not drawn: the run had diverged


def film(
    run: Run,
    path: str | os.PathLike[str],
    *,
    fps: int,
    size: tuple[int, int],
    speed: float,
    camera: tuple[float, float] | None,
    arm: Arm | None,
) -> Path:
    """Write a film of a run; see `Run.video`."""
    target = checked_target("video", path, SUFFIXES)
    size = _checked_size(size)
    whole_number("fps", fps, minimum=1, maximum=MAX_FPS)
    if camera is not None:
        finite_array("camera", camera, shape=(2,), unit="deg")
    shown = _checked_arm(run, arm)
    ticks = _ticks(run, positive_scalar("speed", speed) / fps)
    with ExitStack() as stack, written_aside("video", target) as aside:
        try:
            pictures, remark = _pictures(stack, run, shown, ticks, camera, size)
        except render.NoRendererError as cause:
            raise MissingExtraError(
                f"video '{target}' needs OpenGL, and none works here ({cause}); install EGL or OSMesa",
                name="OpenGL",
            ) from cause
        if remark:
            warn(f"video '{target}' {remark}")
        bar = stack.enter_context(Progress(len(ticks), None, "drawing"))
        images = bar.over(_captioned(pictures, run.t[ticks]))
        try:
            _write_gif(aside, images, fps)
        except render.NoRendererError as cause:
            raise FileError(f"video '{target}' broke off: {cause}; try again", name=str(target)) from cause
    return target


def _checked_size(size: tuple[int, int]) -> tuple[int, int]:
    try:
        width, height = (whole_number("an edge of size", edge, minimum=SIZES[0], maximum=SIZES[1]) for edge in size)
    except (TypeError, ValueError) as cause:
        words = f"size must be width and height in pixels, from {SIZES[0]} to {SIZES[1]}; got {size!r}"
        raise RangeError(words, name="size", value=size) from cause
    return width, height


def _checked_arm(run: Run, arm: Arm | None) -> Arm:
    shown = arm or run.arm or run.info.plant_arm
    if shown is None:
        raise UsageError("the run does not know its arm; pass arm=taut.load_arm(...)", name="arm")
    run.require_arm(shown)
    return shown


def _ticks(run: Run, period: float) -> Ticks:
    """The tick that each picture shows."""
    near = np.isfinite(run.q).all(axis=1) & (np.abs(run.q) < MAX_POSITION).all(axis=1)
    end = len(run) if near.all() else int(np.argmin(near))
    if not end:
        raise UsageError("there is nothing to film: the run has no ticks", name="run")
    count = math.floor((run.t[end - 1] - run.t[0]) / period + 1e-9) + 1
    times = run.t[0] + period * np.arange(count)
    ticks: Ticks = np.minimum(np.searchsorted(run.t[:end], times - 1e-9), end - 1)
    return ticks


def _wanted(run: Run, arm: Arm, ticks: Ticks) -> Float64Array:
    """(k, 3) where the tool should be, if the reference moves; else (0, 3)."""
    if isinstance(motion := run.reference.motion, TaskMotion):
        p = motion.p
        return p[ticks] if np.any(p != p[0]) else np.zeros((0, 3))
    q = getattr(run.reference, "q", None)
    if q is None or not np.any(q != q[0]):
        return np.zeros((0, 3))
    return Chain.of(model_of(arm), None).poses(q[ticks])[1]


def _pictures(
    stack: ExitStack, run: Run, arm: Arm, ticks: Ticks, camera: tuple[float, float] | None, size: tuple[int, int]
) -> tuple[Iterator[render.Picture], str]:
    """Rendered pictures, and what there is to say about them; NoRendererError if none can be drawn."""
    folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="taut-video-"))
    try:
        import mujoco  # noqa: F401
    except Exception as cause:  # with an OpenGL that is broken its bindings raise whatever they like
        raise render.NoRendererError(str(cause) or type(cause).__name__) from cause
    around, q = run.info.around, run.q[ticks]
    points, moving = scene.points_of(arm, q), poses_of(run, around, ticks)
    view, tool = scene.view_of(arm, points, camera), points[:, -1]
    model, places, problem = scene.scene(arm, view, size, around)
    qpos = np.zeros_like(q)
    qpos[:, places] = q
    frames = render.Frames(
        qpos=qpos,
        moving=moving,
        tool=tool,
        wanted=_wanted(run, arm, ticks),
        camera=np.array([*view.centre, view.distance(*size), view.azimuth, view.elevation]),
        size=size,
    )
    pictures = stack.enter_context(render.opened(Path(folder), model, frames))
    remarks = [f"shows capsules in place of some visuals: {problem}"] if problem else []
    remarks += [f"does not show {' and '.join(around.missing)}"] if around.missing else []
    return pictures, "; it ".join(remarks)


def poses_of(run: Run, found: Around, ticks: Ticks) -> Float64Array:
    """(k, m, 7) position [m] and quaternion wxyz of each thing that moves, in the order of the things."""
    out = []
    for thing in found.things:
        if thing.row is not None:
            out.append(np.asarray(run.extra[POSES])[ticks, thing.row])
        elif thing.times:
            shifts = np.asarray(thing.shifts)
            p = [np.interp(run.t[ticks], thing.times, shifts[:, i]) + thing.p[i] for i in range(3)]
            out.append(np.column_stack([*p, np.tile(thing.wxyz, (len(ticks), 1))]))
    return np.stack(out, axis=1) if out else np.zeros((len(ticks), 0, 7))


def _captioned(pictures: Iterator[render.Picture], times: Float64Array) -> Iterator[Any]:
    """Pictures of Pillow's, with the time in a corner."""
    from PIL import Image, ImageDraw, ImageFont

    for picture, t in zip(pictures, times, strict=True):
        image = Image.fromarray(picture)
        letters = ImageFont.load_default(size=max(9.0, image.height / 28.0))
        place = (0.025 * image.width, 0.025 * image.width)
        ImageDraw.Draw(image).text(place, f"t = {t:.2f} s", fill=(40, 40, 40), font=letters)
        yield image


def _write_gif(path: Path, images: Iterator[Any], fps: int) -> None:
    """One palette for all pictures, so that nothing flickers; times that add up, though a GIF counts in 10 ms."""
    from PIL import Image

    first = next(images)
    palette = _palette(first)
    frames = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in itertools.chain([first], images)]
    ends = np.round(np.arange(len(frames) + 1) * 100.0 / fps)
    durations = [10 * int(length) for length in np.diff(ends)]
    frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0)


def _palette(first: Any) -> Any:
    """The colours of the first picture, and that of the trail, which is not there yet."""
    from PIL import Image

    most = 255
    own = first.quantize(colors=most, method=Image.Quantize.MEDIANCUT).getpalette()[: 3 * most]
    palette = Image.new("P", (1, 1))
    palette.putpalette([*own, *(round(255.0 * part) for part in render.TRAIL[:3])])
    return palette
