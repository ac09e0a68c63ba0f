"""What of a URDF link can be drawn. Never needed to control an arm: what is wrong here is left out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath

from taut.arm.loaders.tree import TreeVisual
from taut.arm.loaders.xml import BadNumberError, Element, numbers
from taut.arm.meshes import SHOWABLE, MeshPaths
from taut.trace.pose import Pose

__all__ = ["Colour", "colours_of", "visuals_of"]

Colour = tuple[float, float, float, float]
GREY: Colour = (0.8, 0.8, 0.8, 1.0)


def colours_of(robot: Element) -> dict[str, Colour]:
    """The named materials that stand at the top of the file."""
    found = ((material.get("name"), _colour(material)) for material in robot.all("material"))
    return {name: colour for name, colour in found if name and colour is not None}


def visuals_of(link: Element, meshes: MeshPaths, colours: Mapping[str, Colour]) -> list[TreeVisual]:
    """The shapes of <visual> where all of them can be drawn, else those of <collision>, else what is left."""
    shapes = link.all("visual")
    shown = _drawn(shapes, meshes, colours)
    if len(shown) < len(shapes):
        shown = _drawn(link.all("collision"), meshes, colours) or shown
    if shapes and not shown:
        for shape in shapes:
            meshes.drop_unshowable(*_mesh_names(shape))
    return shown


def _mesh_names(shape: Element) -> list[str]:
    return [mesh.get("filename") or "" for geometry in shape.all("geometry") for mesh in geometry.all("mesh")]


def _drawn(shapes: list[Element], meshes: MeshPaths, colours: Mapping[str, Colour]) -> list[TreeVisual]:
    found = []
    for shape in shapes:
        try:
            visual = _visual(shape, meshes, colours)
        except BadNumberError:
            continue
        if visual is not None:
            found.append(visual)
    return found


def _visual(shape: Element, meshes: MeshPaths, colours: Mapping[str, Colour]) -> TreeVisual | None:
    geometry = next((child for element in shape.all("geometry") for child in element.children), None)
    if geometry is None:
        return None
    origin = next(iter(shape.all("origin")), None)
    placement = Pose.identity()
    if origin is not None:
        xyz, rpy = (numbers(origin.get(name) or "0 0 0", 3) for name in ("xyz", "rpy"))
        placement = Pose(xyz, rpy=rpy)
    material = next(iter(shape.all("material")), None)
    rgba = GREY
    if material is not None:
        rgba = _colour(material) or colours.get(material.get("name") or "", GREY)
    if geometry.tag == "mesh":
        name = geometry.get("filename") or ""
        if PurePosixPath(name).suffix.lower() not in SHOWABLE:
            return None
        file = meshes.resolve(name)
        scale = numbers(geometry.get("scale") or "1 1 1", 3)
        return TreeVisual(placement=placement, shape="mesh", size=scale, file=file, rgba=rgba) if file else None
    if geometry.tag == "box":
        return TreeVisual(placement=placement, shape="box", size=_sizes(geometry, "size", 3), rgba=rgba)
    if geometry.tag == "cylinder":
        size = (*_sizes(geometry, "radius", 1), *_sizes(geometry, "length", 1))
        return TreeVisual(placement=placement, shape="cylinder", size=size, rgba=rgba)
    if geometry.tag == "sphere":
        return TreeVisual(placement=placement, shape="sphere", size=_sizes(geometry, "radius", 1), rgba=rgba)
    return None


def _sizes(geometry: Element, attribute: str, count: int) -> tuple[float, ...]:
    values = numbers(geometry.get(attribute) or "", count)
    if min(values) <= 0.0:
        raise BadNumberError("must be > 0")
    return values


def _colour(material: Element) -> Colour | None:
    for colour in material.all("color"):
        try:
            r, g, b, a = (min(max(value, 0.0), 1.0) for value in numbers(colour.get("rgba") or "", 4))
        except BadNumberError:
            return None
        return (r, g, b, a)
    return None
