"""A safe MJCF text through MuJoCo's compiler, without any file."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from taut.arm.loaders.mjcf_source import MjcfSource
from taut.arm.loaders.xml import Element
from taut.base.errors import ModelError, Problem

if TYPE_CHECKING:
    import mujoco

__all__ = ["Compiled", "MeshShape", "compiled"]

IN_OUR_WORDS: Final = (  # what MuJoCo says of things that the other formats can have too
    (
        "must be larger than mjMINVAL",
        "inertial",
        "a joint moves it, and it has no mass or no inertia; give it an <inertial>, or geoms with mass",
    ),
    ("axis too small", "axis", "axis must not be zero: a joint that moves needs a direction"),
    ("zero quaternion", "quat", "quat must not be zero; it is (w, x, y, z)"),
    ("range[0] should be smaller", "range", "it is limited, and has no range; give it one"),
    ("invalid qpos size", "qpos", "its qpos must have one entry for each entry of q that MuJoCo counts"),
)
_LINE = re.compile(r"line (\d+)")


@dataclass(frozen=True, kw_only=True)
class MeshShape:
    """The mesh of a geom, which MuJoCo was not shown."""

    name: str
    scale: tuple[float, float, float]


@dataclass(kw_only=True)
class Compiled:
    """What MuJoCo made of the text, and the elements that it came from."""

    model: mujoco.MjModel
    bodies: list[Element | None]  # by id
    joints: list[Element | None]
    equalities: list[Element | None]
    meshes: dict[int, MeshShape]  # by id of the geom


def compiled(source: MjcfSource, path: Path) -> Compiled:
    """Parse and compile.

    Raises:
        ModelError: What MuJoCo refuses, traced back to the element; a mass that only a mesh would give.
    """
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
            raise ModelError(str(path), [_refused(str(cause), source, path)]) from cause
    return Compiled(
        model=model,
        bodies=_elements(spec.bodies, source),
        joints=_elements(spec.joints, source),
        equalities=_elements(spec.equalities, source),
        meshes={geom.id: shape for geom, shape in shapes},
    )


def _refused(text: str, source: MjcfSource, path: Path) -> Problem:
    """MuJoCo's sentence, with the element, the attribute and the line in the user's file."""
    found = _LINE.search(text)
    element = source.at(int(found[1])) if found else None
    said = re.sub(r"^(XML )?(Error: )*(Schema violation: )?", "", (text.splitlines() or [""])[0])
    if element is None:
        element = next((source.named(word) for word in re.findall(r"'([^']+)'", said)), None)
    if element is None:
        return Problem(object=path.name, attribute=None, message=f"MuJoCo refuses the model: {said}")
    name = element.get("name")
    where = "" if element.file == str(path) else f" in '{element.file}'"
    called = f"{element.tag} '{name}'" if name else f"<{element.tag}>"
    attribute = _attribute(said, element)
    for phrase, ours, sentence in IN_OUR_WORDS:
        if phrase in said:
            attribute, said = ours, sentence
            break
    else:
        said = f"MuJoCo refuses it: {said}"
    return Problem(
        object=name or element.tag, attribute=attribute, message=f"{called}{where}: {said}", line=element.line
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
        line = _LINE.search(item.info)
        if 0 <= item.id < len(found):
            found[item.id] = source.at(int(line[1])) if line else source.named(item.name)
    return found


def _needs_file(geom: mujoco.MjsGeom, source: MjcfSource) -> bool:
    return geom.meshname in source.meshes


def _masses_from_meshes(spec: mujoco.MjSpec, source: MjcfSource) -> Iterator[Problem]:
    """Moving bodies whose inertia MuJoCo would compute from a mesh file."""
    import mujoco

    mode = mujoco.mjtInertiaFromGeom(spec.compiler.inertiafromgeom)
    low, high = spec.compiler.inertiagrouprange
    lost = False
    for body in spec.bodies:
        if mode == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE:
            continue
        if body.explicitinertial and mode == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO:
            continue
        for geom in body.geoms:
            weightless = geom.mass == 0.0 or (math.isnan(geom.mass) and geom.density == 0.0)
            if not _needs_file(geom, source) or weightless or not low <= geom.group <= high:
                continue
            if _moves(body, spec):
                yield _mass_problem(body, geom, source)
                break
            lost = True
    if lost and spec.compiler.settotalmass > 0.0:
        text = "settotalmass of <compiler> needs the masses of mesh files, which are never opened; take it out"
        line = next((element.line for element in source.lines if element.get("settotalmass")), None)
        yield Problem(object="compiler", attribute="settotalmass", message=text, line=line)


def _mass_problem(body: mujoco.MjsBody, geom: mujoco.MjsGeom, source: MjcfSource) -> Problem:
    line = _LINE.search(body.info)
    element = source.at(int(line[1])) if line else None
    return Problem(
        object=body.name or "body",
        attribute="inertial",
        message=f"body '{body.name}': its mass would come from the mesh '{geom.meshname}', and meshes are never "
        "opened; give it an <inertial> (MuJoCo's compiled model has the numbers: body_mass, body_ipos, "
        "body_iquat, body_inertia)",
        line=None if element is None else element.line,
    )


def _moves(body: mujoco.MjsBody, spec: mujoco.MjSpec) -> bool:
    while body is not None and body != spec.worldbody:
        if body.joints:
            return True
        body = body.parent
    return False


PLACEHOLDER: Final = 0.01  # [m] radius of the sphere that stands for a mesh


def _without_meshes(spec: mujoco.MjSpec, source: MjcfSource) -> list[tuple[mujoco.MjsGeom, MeshShape]]:
    """Put spheres for meshes, and make what remains compile to every body of the file."""
    import mujoco

    scales = {mesh.name: (float(mesh.scale[0]), float(mesh.scale[1]), float(mesh.scale[2])) for mesh in spec.meshes}
    shapes = []
    for geom in spec.geoms:
        if not _needs_file(geom, source):
            continue
        shapes.append((geom, MeshShape(name=geom.meshname, scale=scales.get(geom.meshname, (1.0, 1.0, 1.0)))))
        geom.type = mujoco.mjtGeom.mjGEOM_SPHERE
        geom.size = [PLACEHOLDER, 0.0, 0.0]
        geom.meshname = ""
        geom.fromto = [math.nan] * 6
    for mesh in list(spec.meshes):
        if mesh.name in source.meshes:
            spec.delete(mesh)
    return shapes
