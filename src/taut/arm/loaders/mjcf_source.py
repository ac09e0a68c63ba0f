"""An MJCF document made safe for MuJoCo and compiled by it: includes resolved, files and extensions removed.

One element a line traces MuJoCo's messages to the user's files. Checked here is what MuJoCo accepts in silence:
numbers not finite or huge, reversed ranges.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

from taut.arm.loaders.visuals import OutsideError, file_inside
from taut.arm.loaders.xml import (
    MAX_BYTES,
    MAX_ELEMENT_DEPTH,
    MAX_ELEMENTS,
    BadNumberError,
    Element,
    is_not_finite,
    numbers,
    read_xml,
)
from taut.arm.rules import MAX_LINKS
from taut.base.errors import FileError, ModelError, Problem

if TYPE_CHECKING:
    import mujoco

MeshShape = tuple[str, tuple[float, float, float]]
"""Name and scale of the mesh of a geom, which MuJoCo was not shown."""

MAX_FILES: Final = 50
MAX_ATTRIBUTE: Final = 200_000  # characters
MOST: Final = {"body": MAX_LINKS, "joint": MAX_LINKS, "geom": 5000, "site": 2000, "default": 1000}
WRITE_OUT: Final = "let MuJoCo write the model out: mujoco.MjSpec.from_file(MODEL).to_xml()"
REFUSED: Final = {  # elements that repeat, fetch or run something
    "replicate": f"<replicate> is not read; {WRITE_OUT}",
    "attach": f"<attach> is not read; {WRITE_OUT}",
    "model": f"<model> is not read; {WRITE_OUT}",
    "composite": "<composite> makes soft bodies, which an arm has none of; take it out",
    "flexcomp": "<flexcomp> makes soft bodies, which an arm has none of; take it out",
    "flex": "<flex> makes soft bodies, which an arm has none of; take it out",
    "plugin": "<plugin> runs code that is not in the file; take it out",
}
# Not needed to know the arm, and able to name files, to ask for memory, or to fail for reasons of their own.
DROPPED: Final = frozenset(
    {
        "size",
        "visual",
        "statistic",
        "sensor",
        "contact",
        "custom",
        "deformable",
        "skin",
        "texture",
        "layer",
        "light",
        "camera",
    }
)
KEPT_OPTIONS: Final = {
    "option": ("gravity", "density", "viscosity"),
    "flag": ("gravity",),
    "key": ("name", "qpos"),
    "material": ("name", "class", "rgba"),
    "hfield": ("name",),
}
WORDS: Final = frozenset(  # attributes that are names, not numbers
    {"name", "class", "childclass", "model", "mesh", "material", "hfield", "file", "body", "body1", "body2"}
    | {"joint", "joint1", "joint2", "jointinparent", "tendon", "tendon1", "tendon2"}
    | {"site", "site1", "site2", "refsite", "cranksite", "slidersite"}
)
NUMBERED: Final = frozenset(
    {"body", "frame", "inertial", "joint", "geom", "site", "option", "key", "mesh"}
    | {"general", "motor", "position", "velocity", "intvelocity", "damper"}
)
FORCE_RANGES: Final = ("actuatorfrcrange", "forcerange", "ctrlrange")
NOT_NEGATIVE: Final = {"joint": ("stiffness",), "option": ("timestep", "density", "viscosity")}
PLACEHOLDER: Final = 0.01  # [m] radius of the sphere that stands for a mesh
_LINE = re.compile(r"line (\d+)")
ESCAPED: Final = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
)


@dataclass(kw_only=True)
class MjcfSource:
    """What MuJoCo gets, and what was taken out of it."""

    text: str = ""
    lines: list[Element] = field(default_factory=list)  # the element on each line of the text
    meshes: dict[str, str] = field(default_factory=dict)  # name of a mesh: its file, relative to the model's folder
    problems: list[Problem] = field(default_factory=list)

    def write(
        self,
        element: Element,
        attributes: Callable[[Element], Mapping[str, str]],
        kept: Callable[[Element], bool] = lambda _: True,
    ) -> None:
        """Add an element to the text, one tag on each line; it is at most MAX_ELEMENT_DEPTH deep."""
        tags: list[str] = []

        def write(inner: Element) -> None:
            named = (f' {name}="{value.translate(ESCAPED)}"' for name, value in attributes(inner).items())
            tags.append(f"<{inner.tag}{''.join(named)}>\n")
            self.lines.append(inner)
            for child in filter(kept, inner.children):
                write(child)
            tags.append(f"</{inner.tag}>\n")
            self.lines.append(inner)

        write(element)
        self.text += "".join(tags)

    def at(self, line: int) -> Element | None:
        """The element that stands on a line of the text, counted from 1."""
        return self.lines[line - 1] if 0 < line <= len(self.lines) else None

    def named(self, name: str) -> Element | None:
        """The first element of that name, for where MuJoCo gives no line."""
        return next((element for element in self.lines if name and element.get("name") == name), None)


def prepare(root: Element, path: Path) -> MjcfSource:
    """The safe text of a document whose root element has been read already."""
    source = MjcfSource()
    whole = _Includes(path, source.problems).resolved(root)
    source.problems.extend(_problems(whole, str(path)))
    source.meshes = dict(_mesh_files(whole))
    source.write(whole, _attributes, _kept)
    return source


class _Includes:
    """Puts the content of included files in place; only files in the model's own folder."""

    def __init__(self, path: Path, problems: list[Problem]) -> None:
        self._path = path
        self._problems = problems
        self._seen = {path.resolve()}
        self._elements = 0
        self._bytes = 0

    def resolved(self, element: Element, depth: int = 0) -> Element:
        if depth > MAX_ELEMENT_DEPTH:
            raise self._too_much("depth", f"its elements are more than {MAX_ELEMENT_DEPTH} deep, includes counted")
        children: list[Element] = []
        for child in element.children:
            if child.tag == "include":
                children.extend(self.resolved(inner, depth + 1) for inner in self._included(child))
            else:
                children.append(self.resolved(child, depth + 1))
        self._elements += 1
        if self._elements > MAX_ELEMENTS:
            raise self._too_much("elements", f"it has more than {MAX_ELEMENTS} elements, includes counted")
        return Element(element.tag, element.attributes, element.line, element.file, children, element.text)

    def _too_much(self, attribute: str, text: str) -> ModelError:
        return ModelError(str(self._path), [Problem(object=self._path.name, attribute=attribute, message=text)])

    def _included(self, include: Element) -> list[Element]:
        name = include.get("file") or ""
        if not name:
            self._report(include, "it names no file; give it file=")
            return []
        try:
            file = file_inside(self._path.parent, name)
        except (OutsideError, OSError, RuntimeError) as wrong:
            reason = str(wrong) if isinstance(wrong, OutsideError) else "is no file name"
            self._report(include, f"'{name}' is not followed: it {reason}")
            return []
        if file in self._seen:
            self._report(include, f"'{name}' is included twice, or includes itself; keep one")
            return []
        self._seen.add(file)
        self._bytes += file.stat().st_size if os.path.isfile(file) else 0  # noqa: PTH113  (names too long for a file)
        if len(self._seen) > MAX_FILES or self._bytes > MAX_BYTES:
            most = f"{MAX_FILES} files and {MAX_BYTES // 2**20} MB"
            self._report(include, f"'{name}' is one file too many; at most {most} are included")
            return []
        try:
            root = read_xml(file, "included file", shown=name)
        except FileError as wrong:
            self._report(include, str(wrong))
            return []
        except ModelError as wrong:
            self._problems.extend(wrong.problems)
            return []
        if root.tag not in ("mujoco", "mujocoinclude"):
            self._report(include, f"'{name}' is no part of an MJCF: its root element is <{root.tag}>")
            return []
        return root.children

    def _report(self, include: Element, text: str) -> None:
        message = f"<include>: {text}"
        self._problems.append(Problem(object="include", attribute="file", message=message, line=include.line))


def _owners(root: Element) -> Iterator[tuple[str, Element]]:
    """Each element with how it is called in a message: its own name, or that of what holds it."""
    stack = [("model", root)]
    while stack:
        owner, element = stack.pop()
        if element.tag not in DROPPED:
            own = element.get("name")
            called = f"{element.tag} '{own}'" if own else owner
            yield called, element
            stack.extend((called, child) for child in reversed(element.children))


def _problems(root: Element, main: str) -> Iterator[Problem]:
    counts = dict.fromkeys(MOST, 0)
    for owner, element in _owners(root):
        found: list[tuple[str | None, str]] = []
        if element.tag in REFUSED:
            found.append((element.tag, REFUSED[element.tag]))
        found.extend(_number_problems(element))
        if element.get("settotalmass"):
            found.append(("settotalmass", "settotalmass is not read; scale the masses themselves"))
        if element.tag in counts:
            counts[element.tag] += 1
        for attribute, text in found:
            where = "" if element.file == main else f" in '{element.file}'"
            yield Problem(
                object=owner.partition("'")[2].removesuffix("'") or owner,
                attribute=attribute,
                message=f"{owner}{where}: {text}",
                line=element.line,
            )
    for tag, most in MOST.items():
        if counts[tag] > most:
            text = f"the model has {counts[tag]} <{tag}> elements; {most} at most are read"
            yield Problem(object="model", attribute=tag, message=text, line=root.line)


def _number_problems(element: Element) -> Iterator[tuple[str, str]]:
    for attribute, text in element.attributes.items():
        where = f"{attribute} of <{element.tag}>"
        words = text.split()
        if len(text) > MAX_ATTRIBUTE:
            yield attribute, f"{where} must have at most {MAX_ATTRIBUTE} characters; got {len(text)}"
        elif attribute in WORDS:
            continue
        elif any(is_not_finite(word) for word in words):
            yield attribute, f"{where} must be finite; got {text!r}"
        elif element.tag in NUMBERED and words and words[0][0] in "+-.0123456789":
            try:
                values = numbers(text, bounded=attribute not in FORCE_RANGES)
            except BadNumberError as wrong:
                yield attribute, f"{where} {wrong}"
                continue
            if attribute in ("range", *FORCE_RANGES) and len(values) == 2 and any(values) and values[0] >= values[1]:
                low, high = values  # MuJoCo would take it for "no limit"
                yield attribute, f"{where} must go from low to high; got {low:g} to {high:g}; swap them"
            if attribute in NOT_NEGATIVE.get(element.tag, ()) and values[0] < 0.0:
                yield attribute, f"{where} must be >= 0; got {values[0]:g}"


def _mesh_files(root: Element) -> Iterator[tuple[str, str]]:
    compilers = [child for child in root.children if child.tag == "compiler"]
    folder, strip = "", False
    for compiler in compilers:
        folder = compiler.get("meshdir") or compiler.get("assetdir") or folder
        strip = compiler.get("strippath") == "true" or strip
    for asset in root.all("asset"):
        for mesh in asset.all("mesh"):
            file = mesh.get("file")
            if file is not None:
                inner = PurePosixPath(file).name if strip else file
                yield _mesh_name(mesh), str(PurePosixPath(folder) / inner) if folder else inner


def _mesh_name(mesh: Element) -> str:
    return mesh.get("name") or PurePosixPath(mesh.get("file") or "").stem


def _attributes(element: Element) -> dict[str, str]:
    kept = dict(element.attributes)
    if element.tag in KEPT_OPTIONS:
        kept = {name: value for name, value in kept.items() if name in KEPT_OPTIONS[element.tag]}
    if element.tag == "compiler":
        for name in ("meshdir", "texturedir", "assetdir", "strippath", "discardvisual", "fusestatic", "usethread"):
            kept.pop(name, None)
    elif element.tag == "mesh":
        if element.get("file") is not None or element.get("name") is not None:
            kept["name"] = _mesh_name(element)
        kept.pop("file", None)
    elif element.tag == "hfield":
        kept |= {"nrow": "2", "ncol": "2", "size": "1 1 1 1"}
    return kept


def _kept(element: Element) -> bool:
    return element.tag not in DROPPED and (element.tag != "key" or (element.get("name") or "").lower() == "home")


@dataclass(kw_only=True)
class Compiled:
    """What MuJoCo made of the text, and the elements that it came from."""

    model: mujoco.MjModel
    bodies: list[Element | None]  # by id
    joints: list[Element | None]
    equalities: list[Element | None]
    meshes: dict[int, MeshShape]  # of geoms, by id


def compiled(source: MjcfSource, path: Path) -> Compiled:
    """Parse and compile."""
    import mujoco

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # MuJoCo warns of what the rules of the tree refuse or allow
        try:
            spec = mujoco.MjSpec.from_string(source.text)
            problems = list(_masses_from_meshes(spec, source))
            if problems:
                raise ModelError(str(path), problems)
            shapes = _without_meshes(spec, source)
            model = spec.compile()
        except (ValueError, RuntimeError, mujoco.FatalError) as cause:
            if isinstance(cause, ModelError):
                raise
            raise ModelError(str(path), [refused(str(cause), source, str(path))]) from cause
    return Compiled(
        model=model,
        bodies=_elements(spec.bodies, source),
        joints=_elements(spec.joints, source),
        equalities=_elements(spec.equalities, source),
        meshes={geom.id: shape for geom, shape in shapes},
    )


def refused(text: str, source: MjcfSource, path: str) -> Problem:
    """MuJoCo's sentence, with the element, the attribute and the line in the user's file."""
    found = _LINE.search(text)
    element = source.at(int(found[1])) if found else None
    said = re.sub(r"^(XML )?(Error: )*(Schema violation: )?", "", (text.splitlines() or [""])[0])
    if element is None:
        element = next((source.named(word) for word in re.findall(r"'([^']+)'", said)), None)
    if element is None:
        return Problem(object=Path(path).name, attribute=None, message=f"MuJoCo refuses the model: {said}")
    name = element.get("name")
    where = "" if element.file == path else f" in '{element.file}'"
    called = f"{element.tag} '{name}'" if name else f"<{element.tag}>"
    return Problem(
        object=name or element.tag,
        attribute=_attribute(said, element),
        message=f"{called}{where}: MuJoCo refuses it: {said}",
        line=element.line,
    )


def _attribute(said: str, element: Element) -> str:
    """The attribute that MuJoCo means: it quotes the attribute or its value."""
    for word in re.findall(r"'([^']+)'", said):
        for attribute, value in element.attributes.items():
            if word in (attribute, value):
                return attribute
    return element.tag


def _elements(
    items: list[mujoco.MjsBody] | list[mujoco.MjsJoint] | list[mujoco.MjsEquality], source: MjcfSource
) -> list[Element | None]:
    found: list[Element | None] = [None] * len(items)
    for item in items:
        if 0 <= item.id < len(found):
            found[item.id] = _element(item.info, item.name, source)
    return found


def _element(said: str, name: str, source: MjcfSource) -> Element | None:
    """The element whose line MuJoCo names, or that has the name."""
    line = _LINE.search(said)
    return source.at(int(line[1])) if line else source.named(name)


def _masses_from_meshes(spec: mujoco.MjSpec, source: MjcfSource) -> Iterator[Problem]:
    """Moving bodies whose inertia MuJoCo would compute from a mesh file."""
    import mujoco

    mode = mujoco.mjtInertiaFromGeom(spec.compiler.inertiafromgeom)
    low, high = spec.compiler.inertiagrouprange
    for body in spec.bodies:
        if mode == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE:
            continue
        if body.explicitinertial and mode == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO:
            continue
        for geom in body.geoms:
            weightless = geom.mass == 0.0 or (math.isnan(geom.mass) and geom.density == 0.0)
            if geom.meshname not in source.meshes or weightless or not low <= geom.group <= high:
                continue
            if _moves(body, spec):
                element = _element(body.info, body.name, source)
                yield Problem(
                    object=body.name or "body",
                    attribute="inertial",
                    message=f"body '{body.name}': its mass would come from the mesh '{geom.meshname}', and meshes "
                    "are never opened; give it an <inertial> (MuJoCo's compiled model has the numbers: body_mass, "
                    "body_ipos, body_iquat, body_inertia)",
                    line=None if element is None else element.line,
                )
                break


def _moves(body: mujoco.MjsBody, spec: mujoco.MjSpec) -> bool:
    while body is not None and body != spec.worldbody:
        if body.joints:
            return True
        body = body.parent
    return False


def _without_meshes(spec: mujoco.MjSpec, source: MjcfSource) -> list[tuple[mujoco.MjsGeom, MeshShape]]:
    """Put spheres for meshes, and make what remains compile to every body of the file."""
    import mujoco

    scales = {mesh.name: (float(mesh.scale[0]), float(mesh.scale[1]), float(mesh.scale[2])) for mesh in spec.meshes}
    shapes = []
    for geom in spec.geoms:
        if geom.meshname not in source.meshes:
            continue
        shapes.append((geom, (geom.meshname, scales.get(geom.meshname, (1.0, 1.0, 1.0)))))
        geom.type = mujoco.mjtGeom.mjGEOM_SPHERE
        geom.size = [PLACEHOLDER, 0.0, 0.0]
        geom.meshname = ""
        geom.fromto = [math.nan] * 6
    for mesh in list(spec.meshes):
        if mesh.name in source.meshes:
            spec.delete(mesh)
    return shapes
