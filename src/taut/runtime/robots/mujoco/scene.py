"""A scene for a MujocoPlant, an MJCF fragment from anywhere: checked, read by us alone, and shown in films.

Files that it names are read here, from the fragment's own folder only, and handed over as bytes.
"""

from __future__ import annotations

import os
import re
import warnings
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.loaders.mjcf_source import MjcfSource, refused
from taut.arm.loaders.visuals import OutsideError, file_inside
from taut.arm.loaders.xml import MAX_BYTES, Element, is_not_finite, parse_xml
from taut.base.checks import readable_file
from taut.base.errors import ModelError, Problem, UsageError, quoted_list
from taut.base.types import Float64Array
from taut.record.info import Around, Mesh, Shape, ShapeKind, Thing, numbers
from taut.runtime.robots.mujoco.rig import Guard, Rig
from taut.trace.pose import Pose

if TYPE_CHECKING:
    import mujoco

IN_WORLD: Final = frozenset({"body", "geom", "site", "light", "camera", "frame"})
SECTIONS: Final = frozenset(
    {"worldbody", "asset", "default", "contact", "equality", "tendon", "actuator", "sensor", "compiler", "visual"}
)
REFUSED: Final = {
    "option": "the options are the plant's: gravity is the arm's, timestep and integrator are its arguments",
    "keyframe": "key frames would set the arm too; place things by pos and quat",
    "include": "write the scene in one file",
    "replicate": "write the copies out",
    "attach": "write the scene in one file",
    "model": "write the scene in one file",
    "plugin": "it runs code that is not in the file",
    "extension": "it runs code that is not in the file",
    "composite": "soft bodies are not supported",
    "flexcomp": "soft bodies are not supported",
    "flex": "soft bodies are not supported",
    "skin": "soft bodies are not supported",
}
NAMES: Final = frozenset(  # attributes that are names, not numbers; the same with a digit behind
    {"name", "class", "childclass", "mesh", "material", "texture", "hfield", "body", "joint", "site", "geom"}
    | {"tendon", "actuator", "target", "objname", "refname", "refsite", "jointinparent", "camera", "file"}
    | {"cranksite", "slidersite", "sidesite", "subtree", "sensor"}
)
COUNTS: Final = frozenset(  # what MuJoCo makes room for
    {"nrow", "ncol", "width", "height", "dim", "num", "nsample", "actdim", "resolution", "gridsize"}
)
MOST: Final = 4096
MAX_ASSETS: Final = 256 * 2**20  # bytes of files, in all
_LINE: Final = re.compile(r"line (\d+)")

KINDS: Final[dict[str, ShapeKind]] = {
    "PLANE": "plane",
    "BOX": "box",
    "SPHERE": "sphere",
    "ELLIPSOID": "ellipsoid",
    "CYLINDER": "cylinder",
    "CAPSULE": "capsule",
    "MESH": "mesh",
}
HIDDEN: Final = 3  # the first group of geoms that MuJoCo's viewers hide
MOST_MOVING: Final = 32  # bodies, each of which takes 7 numbers of every tick
MOST_VERTICES: Final = 50_000  # of all meshes: some MB in a log


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A scene that MuJoCo may read, and the files that it names as bytes."""

    path: str
    source: MjcfSource
    files: dict[str, bytes]


def read_scene(scene: str | os.PathLike[str]) -> Scene:
    """The scene in a text, which begins with <, or in a file."""
    if not isinstance(scene, (str, os.PathLike)):
        raise UsageError(
            f"scene must be an MJCF fragment as text, or the path of one; got {type(scene).__name__}", name="scene"
        )
    if isinstance(scene, str) and scene.lstrip().startswith("<"):
        source, folder, data = "scene", None, scene.encode()
    else:
        path = readable_file("scene", scene)
        source, folder = str(path), path.parent
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    root = _document(data, source)
    reader = _Reader(source, folder)
    reader.check(root)
    if reader.problems:
        raise ModelError(source, reader.problems)
    out = Scene(path=source, source=MjcfSource(), files=reader.files)
    out.source.write(root, lambda element: reader.renamed.get(id(element), element.attributes))
    return out


def _document(data: bytes, source: str) -> Element:
    """The fragment as a whole document: loose elements are put where they belong."""
    if data.lstrip().startswith((b"<?xml", b"<!DOCTYPE")):
        root = parse_xml(data, source)
    else:
        root = parse_xml(b"<mujoco>" + data + b"</mujoco>", source)
        if len(root.children) == 1 and root.children[0].tag == "mujoco":
            root.children[0].text.extend(root.text)
            root = root.children[0]
    if root.tag != "mujoco":
        root = Element("mujoco", {}, root.line, source, [root])
    loose = [child for child in root.children if child.tag in IN_WORLD]
    children = [child for child in root.children if child.tag not in IN_WORLD]
    if loose:
        children.append(Element("worldbody", {}, loose[0].line, source, loose))
    return Element("mujoco", {}, root.line, source, children, root.text)


class _Reader:
    """Checks every element, and reads the files that are named."""

    def __init__(self, source: str, folder: Path | None) -> None:
        self._source = source
        self._folder = folder
        self._size = 0
        self.problems: list[Problem] = []
        self.files: dict[str, bytes] = {}
        self.renamed: dict[int, dict[str, str]] = {}  # new attributes of an element, by its id

    def check(self, root: Element) -> None:
        folders = {"mesh": "", "texture": ""}
        for section in root.children:
            if section.tag not in SECTIONS and section.tag not in REFUSED:
                known = ", ".join(sorted(SECTIONS))
                self._problem(section, section.tag, f"a scene has no <{section.tag}>; its parts are {known}")
            if section.tag == "compiler":
                for kind in folders:
                    folders[kind] = section.get(f"{kind}dir") or section.get("assetdir") or folders[kind]
                gone = ("meshdir", "texturedir", "assetdir", "strippath", "usethread", "discardvisual")
                self.renamed[id(section)] = {k: v for k, v in section.attributes.items() if k not in gone}
        for element in root.walk():
            if element.text:  # as a text of any other kind has
                words = " ".join("".join(element.text).split())[:40]
                text = (
                    f"a scene is made of MJCF elements, such as <geom .../>; got the text {words!r} outside of them"
                )
                self._problem(element, element.tag, text)
            if element.tag in REFUSED:
                self._problem(element, element.tag, f"a scene has no <{element.tag}>: {REFUSED[element.tag]}")
            if element.tag == "mesh" and element.get("builtin") is not None:
                self._problem(
                    element, "builtin", "a mesh that MuJoCo makes itself is not read; use a geom of that shape"
                )
            for attribute, text in element.attributes.items():
                self._checknumbers(element, attribute, text)
            folder = folders["texture" if element.tag in ("texture", "layer") else "mesh"]
            self._take_files(element, folder)

    def _problem(self, element: Element, attribute: str, text: str) -> None:
        name, message = element.get("name") or element.tag, f"{_called(element)}: {text}"
        self.problems.append(Problem(object=name, attribute=attribute, message=message, line=element.line))

    def _checknumbers(self, element: Element, attribute: str, text: str) -> None:
        if _is_name(attribute):
            return
        words = text.split()
        if any(is_not_finite(word) for word in words):
            self._problem(element, attribute, f"{attribute} must be finite; got {text!r}")
        if attribute in COUNTS and not all(_is_count(word) for word in words):
            self._problem(element, attribute, f"{attribute} must be whole numbers up to {MOST}; got {text!r}")

    def _take_files(self, element: Element, folder: str) -> None:
        for attribute, name in element.attributes.items():
            if not attribute.startswith("file") or element.tag not in ("mesh", "hfield", "texture"):
                continue
            inner = str(PurePosixPath(folder) / name) if folder else name
            try:
                data = self._bytes(inner)
            except OutsideError as reason:
                self._problem(element, attribute, f"the file '{name}' is not read: it {reason}")
                continue
            known = f"{len(self.files)}_{PurePosixPath(name).name}"
            self.files[known] = data
            attributes = self.renamed.setdefault(id(element), dict(element.attributes))
            attributes[attribute] = known
            attributes.setdefault("name", PurePosixPath(name).stem)

    def _bytes(self, name: str) -> bytes:
        if self._folder is None:
            raise OutsideError("is named in a text, which has no folder; save the scene beside its files")
        try:
            path = file_inside(self._folder, name)
            if not path.is_file():
                raise OutsideError("is not there")
            with path.open("rb") as stream:
                data = stream.read(MAX_ASSETS - self._size + 1)
        except (OSError, RuntimeError) as cause:
            raise OutsideError("cannot be opened") from cause
        self._size += len(data)
        if self._size > MAX_ASSETS:
            raise OutsideError(f"makes more than {MAX_ASSETS // 2**20} MB of files, the most that is read")
        return data


def _is_count(word: str) -> bool:
    return word.isascii() and word.isdigit() and len(word) < 9 and int(word) <= MOST


def attach_scene(spec: mujoco.MjSpec, scene: Scene, at: Pose) -> None:
    """Put a scene into the world of a spec that has the arm already, with its origin at a pose."""
    import mujoco

    with Guard(spec.option), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns that names without a prefix may not be saved well
        try:
            child = mujoco.MjSpec.from_string(scene.source.text, assets=scene.files)
            wanted = _linked(child)
            spec.attach(child, frame=spec.worldbody.add_frame(pos=at.p, quat=at.wxyz), prefix="")
        except (ValueError, RuntimeError, mujoco.FatalError) as cause:
            raise ModelError(scene.path, [refused(str(cause), scene.source, scene.path)]) from cause
    # MuJoCo leaves out in silence what names a thing that it does not find.
    lost = [_lost(scene.source.lines[line - 1]) for line in sorted(wanted - _linked(spec))]
    if lost:
        raise ModelError(scene.path, lost)


def _linked(spec: mujoco.MjSpec) -> set[int]:
    """The lines of all that refers to something else by name."""
    kinds = (spec.equalities, spec.actuators, spec.sensors, spec.excludes, spec.pairs, spec.tendons)
    found = (_LINE.search(item.info) for kind in kinds for item in kind)
    return {int(line[1]) for line in found if line}


def _lost(element: Element) -> Problem:
    names = [value for attribute, value in element.attributes.items() if attribute != "name" and _is_name(attribute)]
    message = (
        f"{_called(element)}: it refers to something that neither the scene nor the arm has; it names "
        f"{quoted_list(names)}"
    )
    return Problem(object=element.get("name") or element.tag, attribute=None, message=message, line=element.line)


def _is_name(attribute: str) -> bool:
    return attribute.rstrip("0123456789") in NAMES


def _called(element: Element) -> str:
    name = element.get("name")
    return f"{element.tag} '{name}'" if name else f"<{element.tag}>"


class SceneView:
    """Everything of a model but the links of its arm; `tool` says that the tool's body is the plant's own."""

    def __init__(self, rig: Rig, *, tool: bool = True) -> None:
        import mujoco

        self._model, self._data = model, data = rig.model, mujoco.MjData(rig.model)
        mujoco.mj_kinematics(model, data)
        self._meshes: dict[int, int] = {}
        self._missing: dict[str, int] = {}
        carried = {int(model.jnt_bodyid[j]) for j in rig.joints}
        things: list[Thing] = []
        moving: list[int] = []
        left_out = 0
        for body in range(model.nbody):
            root = int(model.body_weldid[body])
            on_tool = tool and body == rig.tool_body
            if root in carried and not on_tool:
                continue
            touches = on_tool or (tool and int(model.body_parentid[body]) == rig.tool_body)
            shapes = self._shapes(body, hidden=touches)
            if not shapes:
                continue
            row = None
            if root and not on_tool:
                if len(moving) == MOST_MOVING:
                    left_out += 1
                    continue
                row = len(moving)
                moving.append(body)
            p, wxyz = (data.xpos[body], data.xquat[body]) if not on_tool else (np.zeros(3), [1.0, 0.0, 0.0, 0.0])
            things.append(Thing(shapes=shapes, p=numbers(p), wxyz=numbers(wxyz), row=row, on_tool=on_tool))
        missing = [f"{count} of its geoms, {kind}" for kind, count in self._missing.items()]
        missing += [f"{left_out} of its moving bodies, beyond {MOST_MOVING}"] if left_out else []
        meshes = tuple(_mesh(model, number) for number in self._meshes)
        self.around = Around(things=tuple(things), meshes=meshes, missing=tuple(missing))
        self._moving = np.array(moving, dtype=np.intp)

    @property
    def moves(self) -> bool:
        """True where the scene has bodies whose poses are recorded."""
        return bool(len(self._moving))

    def poses(self, data: mujoco.MjData) -> Float64Array:
        """(m, 7) position [m] and quaternion wxyz of the bodies that move, as the last step found them."""
        return np.hstack([data.xpos[self._moving], data.xquat[self._moving]])

    def _shapes(self, body: int, *, hidden: bool) -> tuple[Shape, ...]:
        """The shapes of a body that a viewer shows."""
        import mujoco

        model, first = self._model, int(self._model.body_geomadr[body])
        out = []
        for geom in range(first, first + int(model.body_geomnum[body])):
            material = int(model.geom_matid[geom])
            rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
            if rgba[3] == 0.0 or (int(model.geom_group[geom]) >= HIDDEN and not hidden):
                continue
            name = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_")
            if name not in KINDS or (name == "MESH" and not self._has_room(int(model.geom_dataid[geom]))):
                what = f"of kind {name.lower()}" if name not in KINDS else "whose meshes are too large for a log"
                self._missing[what] = self._missing.get(what, 0) + 1
                continue
            mesh = -1 if name != "MESH" else self._meshes.setdefault(int(model.geom_dataid[geom]), len(self._meshes))
            out.append(
                Shape(
                    kind=KINDS[name],
                    size=numbers(model.geom_size[geom]),
                    p=numbers(model.geom_pos[geom]),
                    wxyz=numbers(model.geom_quat[geom]),
                    rgba=numbers(rgba),
                    mesh=mesh,
                )
            )
        return tuple(out)

    def _has_room(self, mesh: int) -> bool:
        count = sum(int(self._model.mesh_vertnum[number]) for number in {*self._meshes, mesh})
        return count <= MOST_VERTICES


def _mesh(model: mujoco.MjModel, number: int) -> Mesh:
    vertex, face = int(model.mesh_vertadr[number]), int(model.mesh_faceadr[number])
    vertices = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[number])]
    faces = model.mesh_face[face : face + int(model.mesh_facenum[number])]
    return Mesh(vertices=np.round(vertices.astype(np.float64), 6), faces=np.array(faces, dtype=np.float64))
