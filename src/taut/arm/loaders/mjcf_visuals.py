"""What of a compiled MJCF can be drawn: the geoms that MuJoCo shows by default. Never needed to control an arm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Final

from taut.arm.description import Shape
from taut.arm.loaders.mjcf_compile import Compiled
from taut.arm.loaders.tree import TreeVisual
from taut.arm.meshes import SHOWABLE, MeshPaths
from taut.trace.pose import Pose

__all__ = ["visuals_of"]

LAST_SHOWN_GROUP: Final = 2  # collision shapes live in the groups above


def visuals_of(result: Compiled, files: Mapping[str, str], meshes: MeshPaths) -> Iterator[tuple[int, TreeVisual]]:
    """Shapes to draw, each with the id of its body.

    Args:
        result: The compiled model.
        files: Mesh names with their files, relative to the model's folder.
        meshes: Where mesh files may be.
    """
    import mujoco

    m = result.model
    types = mujoco.mjtGeom
    for g in range(m.ngeom):
        if m.geom_group[g] > LAST_SHOWN_GROUP:
            continue
        shape: Shape
        size = tuple(float(s) for s in m.geom_size[g])
        kind = int(m.geom_type[g])
        file = ""
        if g in result.meshes:
            name = files[result.meshes[g].name]
            if PurePosixPath(name).suffix.lower() not in SHOWABLE:
                meshes.drop_unshowable(name)
                continue
            file = meshes.resolve(name)
            if not file:
                continue
            shape, size = "mesh", result.meshes[g].scale
        elif kind == int(types.mjGEOM_BOX):
            shape, size = "box", tuple(2.0 * s for s in size)
        elif kind in (int(types.mjGEOM_CYLINDER), int(types.mjGEOM_CAPSULE)):
            shape, size = "cylinder", (size[0], 2.0 * size[1])
        elif kind == int(types.mjGEOM_SPHERE):
            shape, size = "sphere", size[:1]
        else:
            continue
        yield (
            int(m.geom_bodyid[g]),
            TreeVisual(
                placement=Pose(m.geom_pos[g], wxyz=m.geom_quat[g]),
                shape=shape,
                size=size,
                file=file,
                rgba=_colour(result, g),
            ),
        )


def _colour(result: Compiled, g: int) -> tuple[float, float, float, float]:
    m = result.model
    material = int(m.geom_matid[g])
    given = m.geom_rgba[g] if material < 0 else m.mat_rgba[material]
    r, green, b, a = (min(max(float(value), 0.0), 1.0) for value in given)
    return r, green, b, a
