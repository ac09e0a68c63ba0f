"""An MJCF document made safe for MuJoCo: includes resolved, files and extensions taken out, numbers checked.

MuJoCo gets one text in which nothing names a file, with one element on each line, so that the lines in its
messages can be traced back to the user's files.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Final

import numpy as np

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
from taut.arm.parts import inertia_matrix
from taut.arm.rules import MAX_LINKS, check_inertia
from taut.base.errors import FileError, ModelError, Problem

__all__ = ["MjcfSource", "prepare"]

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
COUNTS: Final = {
    "pos": 3,
    "quat": 4,
    "axisangle": 4,
    "xyaxes": 6,
    "zaxis": 3,
    "euler": 3,
    "mass": 1,
    "diaginertia": 3,
    "fullinertia": 6,
    "axis": 3,
    "range": 2,
    "armature": 1,
    "timestep": 1,
    "frictionloss": 1,
    "ref": 1,
    "actuatorfrcrange": 2,
    "forcerange": 2,
    "ctrlrange": 2,
    "gravity": 3,
}
ANY_COUNT: Final = frozenset({"size", "gear", "damping", "stiffness", "qpos", "polycoef", "rgba", "density", "scale"})
NUMBERED: Final = frozenset(
    {"body", "frame", "inertial", "joint", "geom", "site", "option", "key", "mesh"}
    | {"general", "motor", "position", "velocity", "intvelocity", "damper"}
)
RANGES: Final = ("range", "actuatorfrcrange", "forcerange", "ctrlrange")
NOT_NEGATIVE: Final = {
    "joint": ("armature", "frictionloss", "damping", "stiffness"),
    "option": ("timestep", "density", "viscosity"),
    "inertial": ("mass",),
    "geom": ("mass", "density"),
}


ESCAPED: Final = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
)


@dataclass(kw_only=True)
class MjcfSource:
    """What MuJoCo gets, and what was taken out of it."""

    text: str
    lines: list[Element]  # the element on each line of the text
    meshes: dict[str, str]  # name of a mesh -> its file, relative to the model's folder
    problems: list[Problem] = field(default_factory=list)

    def at(self, line: int) -> Element | None:
        """The element that stands on a line of the text, counted from 1."""
        return self.lines[line - 1] if 0 < line <= len(self.lines) else None

    def named(self, name: str) -> Element | None:
        """The first element of that name, for where MuJoCo gives no line."""
        return next((element for element in self.lines if name and element.get("name") == name), None)


def prepare(root: Element, path: Path) -> MjcfSource:
    """The safe text of a document whose root element has been read already.

    Raises:
        ModelError: It is no MJCF, or too deep or large.
    """
    if root.tag != "mujoco":
        text = f"its root element is <{root.tag}>; an MJCF file begins with <mujoco>"
        raise ModelError(str(path), [Problem(object=path.name, attribute=root.tag, message=text, line=root.line)])
    source = MjcfSource(text="", lines=[], meshes={})
    whole = _Includes(path, source.problems).resolved(root)
    source.problems.extend(_problems(whole, str(path)))
    source.meshes = dict(_mesh_files(whole))
    written: list[str] = []
    _write(whole, written, source.lines)
    source.text = "\n".join(written)
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


# -------------------------------------------------------------------- what can be wrong


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
    names: dict[tuple[str, str], Element] = {}
    counts = dict.fromkeys(MOST, 0)
    for owner, element in _owners(root):
        found: list[tuple[str | None, str]] = []
        if element.tag in REFUSED:
            found.append((element.tag, REFUSED[element.tag]))
        found.extend(_number_problems(element))
        if element.tag in ("body", "joint", "freejoint", "site") and element.get("name"):
            kind = "joint" if element.tag == "freejoint" else element.tag
            first = names.setdefault((kind, element.attributes["name"]), element)
            if first is not element:
                found.append(("name", f"this name is there twice (first in line {first.line}); rename one"))
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
    tag = element.tag
    values: dict[str, tuple[float, ...]] = {}
    for attribute, text in element.attributes.items():
        where = f"{attribute} of <{tag}>"
        if len(text) > MAX_ATTRIBUTE:
            yield attribute, f"{where} must have at most {MAX_ATTRIBUTE} characters; got {len(text)}"
            continue
        if tag in NUMBERED and (attribute in COUNTS or attribute in ANY_COUNT):
            try:
                values[attribute] = numbers(text, COUNTS.get(attribute), bounded=attribute not in RANGES)
            except BadNumberError as wrong:
                yield attribute, f"{where} {wrong}"
        elif attribute not in WORDS and any(is_not_finite(word) for word in text.split()):
            yield attribute, f"{where} must be finite; got {text!r}"
    for attribute in NOT_NEGATIVE.get(tag, ()):
        value = values.get(attribute, (0.0,))
        if value and value[0] < 0.0:
            yield attribute, f"{attribute} of <{tag}> must be >= 0; got {value[0]:g}"
    for attribute in RANGES:
        low, high = values.get(attribute, (0.0, 0.0))
        if low >= high and (low, high) != (0.0, 0.0):  # MuJoCo would take it for "no limit"
            yield attribute, f"{attribute} of <{tag}> must go from low to high; got {low:g} to {high:g}; swap them"
    if tag == "inertial":
        yield from _inertia_problems(element, values)


def _inertia_problems(element: Element, values: dict[str, tuple[float, ...]]) -> Iterator[tuple[str, str]]:
    for attribute in ("mass", "pos"):
        if element.get(attribute) is None:
            yield attribute, f"<inertial> has no {attribute}; give it one"
    if "diaginertia" in values:
        I = np.diag(values["diaginertia"])
    elif "fullinertia" in values:
        I = inertia_matrix(values["fullinertia"])
    else:
        if not {"diaginertia", "fullinertia"} & set(element.attributes):
            yield "diaginertia", "<inertial> has no diaginertia or fullinertia; give it one"
        return
    (mass,) = values.get("mass", (0.0,))
    wrong = check_inertia(mass, I) if mass > 0.0 else None
    if wrong is not None:
        yield wrong[0], f"{wrong[1]}; fix its <inertial>"


# -------------------------------------------------------------------- the safe text


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


def _write(element: Element, text: list[str], lines: list[Element]) -> None:
    """One tag on each line; `element` is at most MAX_ELEMENT_DEPTH deep."""
    attributes = "".join(f' {name}="{value.translate(ESCAPED)}"' for name, value in _attributes(element).items())
    text.append(f"<{element.tag}{attributes}>")
    lines.append(element)
    for child in element.children:
        if child.tag not in DROPPED and (child.tag != "key" or (child.get("name") or "").lower() == "home"):
            _write(child, text, lines)
    text.append(f"</{element.tag}>")
    lines.append(element)
