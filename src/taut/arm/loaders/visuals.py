"""The drawable shapes of a model, and the mesh files that may be shown: those in its own or its catalogue's folder.

No mesh is opened; other paths are dropped with a note. Of a MJCF, geoms that MuJoCo shows by default are drawn.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

from taut.arm.loaders.xml import BadNumberError, Element, numbers
from taut.arm.parts import Shape, Visual
from taut.base.errors import count_of
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from taut.arm.loaders.mjcf_source import Compiled

SHOWABLE: Final = (".stl", ".obj")  # what MuJoCo can show
PACKAGE: Final = "package://"


class OutsideError(ValueError):
    """A name that leads out of its folder; the text completes "it ..."."""


class MeshPaths:
    """Resolves mesh names, relative to `folder` or as `package://NAME`, and remembers those that cannot be shown."""

    def __init__(self, folder: Path, packages: Mapping[str, Path] | None = None) -> None:
        self._roots = {"": folder, **(packages or {})}
        self.dropped: list[str] = []

    def resolve(self, name: str) -> str:
        """The path of a mesh inside an allowed folder; "" where there is none."""
        package, path = "", name
        if name.startswith(PACKAGE):
            package, _, path = name.removeprefix(PACKAGE).partition("/")
        with suppress(OSError, RuntimeError, OutsideError):  # too long, a loop of links, an odd character
            if package in self._roots and (file := file_inside(self._roots[package], path)).is_file():
                return str(file)
        self.dropped.append(name)
        return ""

    def notes(self) -> Iterator[str]:
        """What was dropped."""
        if self.dropped:
            first = self.dropped[0] if len(self.dropped[0]) <= 60 else f"...{self.dropped[0][-57:]}"
            yield (
                f"{count_of(len(self.dropped), 'mesh file')} not shown, such as '{first}': meshes are "
                f"{' and '.join(SHOWABLE)} files in the folder of the model or of its package"
            )


def file_inside(root: Path, name: str) -> Path:
    """The path below `root` of a plain relative name, existing or not; OutsideError if it leads out."""
    if not name.isprintable() or any(character in name for character in ":\\"):
        raise OutsideError("is an address or an odd name, not a plain relative path")
    parts = PurePosixPath(name)
    if not name or parts.is_absolute() or ".." in parts.parts:
        raise OutsideError("leads out of the model's folder")
    root = root.resolve()
    file = (root / parts).resolve()  # follows links, so that one that leads outside shows
    if not file.is_relative_to(root):
        raise OutsideError("is a link that leads out of the model's folder")
    return file


LAST_SHOWN_GROUP: Final = 2  # collision shapes live in the groups above


def mjcf_visuals(result: Compiled, files: Mapping[str, str], meshes: MeshPaths) -> Iterator[tuple[int, Visual]]:
    """Shapes to draw, each with the id of its body; `files` are those of meshes, relative to the model's folder."""
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
            name = files[result.meshes[g][0]]
            if PurePosixPath(name).suffix.lower() not in SHOWABLE:
                meshes.dropped.append(name)
                continue
            file = meshes.resolve(name)
            if not file:
                continue
            shape, size = "mesh", result.meshes[g][1]
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
            Visual(
                placement=Pose(m.geom_pos[g], wxyz=m.geom_quat[g]),
                shape=shape,
                size=size,
                file=file,
                rgba=_geom_colour(result, g),
            ),
        )


def _geom_colour(result: Compiled, g: int) -> tuple[float, float, float, float]:
    m = result.model
    material = int(m.geom_matid[g])
    given = m.geom_rgba[g] if material < 0 else m.mat_rgba[material]
    r, green, b, a = (min(max(float(value), 0.0), 1.0) for value in given)
    return r, green, b, a


Colour = tuple[float, float, float, float]
GREY: Colour = (0.8, 0.8, 0.8, 1.0)
SIZES: Final[Mapping[Shape, Mapping[str, int]]] = {  # how many numbers each attribute of a shape has
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
}


def colours_of(robot: Element) -> dict[str, Colour]:
    """The named materials that stand at the top of the file."""
    found = ((material.get("name"), _colour(material)) for material in robot.all("material"))
    return {name: colour for name, colour in found if name and colour is not None}


def urdf_visuals(link: Element, meshes: MeshPaths, colours: Mapping[str, Colour]) -> list[Visual]:
    """The shapes of <visual> where all of them can be drawn, else those of <collision>, else what is left."""
    shapes = link.all("visual")
    shown = _drawn(shapes, meshes, colours)
    if len(shown) < len(shapes):
        shown = _drawn(link.all("collision"), meshes, colours) or shown
    if shapes and not shown:
        names = [mesh.get("filename") or "" for shape in shapes for mesh in _children(shape.all("geometry"), "mesh")]
        meshes.dropped += [name for name in names if PurePosixPath(name).suffix.lower() not in SHOWABLE]
    return shown


def _children(elements: list[Element], tag: str) -> list[Element]:
    return [child for element in elements for child in element.all(tag)]


def _drawn(shapes: list[Element], meshes: MeshPaths, colours: Mapping[str, Colour]) -> list[Visual]:
    found = []
    for shape in shapes:
        try:
            visual = _visual(shape, meshes, colours)
        except BadNumberError:
            continue
        if visual is not None:
            found.append(visual)
    return found


def _visual(shape: Element, meshes: MeshPaths, colours: Mapping[str, Colour]) -> Visual | None:
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
        return Visual(placement=placement, shape="mesh", size=scale, file=file, rgba=rgba) if file else None
    for shape_of, counts in SIZES.items():
        if geometry.tag == shape_of:
            size = [value for name, count in counts.items() for value in _sizes(geometry, name, count)]
            return Visual(placement=placement, shape=shape_of, size=tuple(size), rgba=rgba)
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
