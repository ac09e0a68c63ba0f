"""A scene to look at: an arm, a floor and a light as a MuJoCo model that is never simulated."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.description import BASE, Arm, Visual
from taut.arm.mjspec import Meshes, add_links, add_shape, bones
from taut.base.errors import FileError
from taut.base.pose import Pose
from taut.base.types import Float64Array
from taut.record.skeleton import FIELD_OF_VIEW, View, upright

if TYPE_CHECKING:
    import mujoco

__all__ = ["scene"]

THICKNESS: Final = 0.03  # of a drawn link, in parts of what is looked at
LINK: Final = (0.88, 0.88, 0.90, 1.0)
JOINT: Final = (0.0, 0.45, 0.70, 1.0)
TOOL: Final = (0.84, 0.37, 0.0, 1.0)
SKY: Final = ([1.0, 1.0, 1.0], [0.86, 0.90, 0.94])
TILES: Final = ([0.86, 0.89, 0.92], [0.77, 0.81, 0.86])
BARE: Final = (0.8, 0.8, 0.8, 1.0)  # colour of a visual that has none of its own


def scene(arm: Arm, view: View, size: tuple[int, int]) -> tuple[Any, Float64Array, str]:
    """A compiled model of the arm in its surroundings.

    Bodies whose visuals can be shown get them; the others get capsules from joint to joint.

    Args:
        arm: The arm.
        view: What is looked at.
        size: Width and height of the pictures.

    Returns:
        The model; (n,) where each joint's position stands in qpos; what could not be shown, in words.
    """
    shown = [visual for visual in arm.visuals if visual.shape != "mesh" or Path(visual.file).is_file()]
    problem = "" if len(shown) == len(arm.visuals) else "some of their files are not there"
    try:
        model = _spec(arm, shown, view, size).compile()
    except (ValueError, FileError) as cause:  # a mesh that MuJoCo, or nobody, can read
        problem = f"MuJoCo cannot show them: {str(cause).splitlines()[0]}"
        model = _spec(arm, [], view, size).compile()
    places = np.array([model.joint(_joint_name(i)).qposadr[0] for i in range(arm.n)])
    return model, places, problem


def _joint_name(i: int) -> str:
    return f"joint {i}"  # names of an arm may be anything; these cannot clash with each other


def _spec(arm: Arm, visuals: list[Visual], view: View, size: tuple[int, int]) -> mujoco.MjSpec:
    import mujoco

    spec = mujoco.MjSpec()
    _look(spec, view, size)
    _surroundings(spec, view)
    T_base = Pose(R=upright(arm)) @ arm.T_WB
    base = spec.worldbody.add_body(name="base", pos=T_base.p, quat=T_base.wxyz)
    names = [(f"body {i}", _joint_name(i)) for i in range(arm.n)]
    bodies = {BASE: base} | {i: body for i, (body, _) in enumerate(add_links(arm, base, Pose.identity(), names))}
    meshes = Meshes()
    for visual in visuals:
        geom = add_shape(spec, bodies[visual.body], visual.placement, visual, meshes)
        geom.rgba = LINK if visual.rgba == BARE else visual.rgba
    drawn = {visual.body for visual in visuals}
    radius = THICKNESS * view.radius
    for i, body in bodies.items():
        if i != BASE:
            body.explicitinertial, body.mass, body.inertia = True, 1.0, [0.01, 0.01, 0.01]  # nothing falls here
        if i not in drawn and (i != BASE or not drawn):
            _draw_bones(arm, i, body, radius)
    tool = arm.frame()
    _geom(bodies[tool.body], "SPHERE", pos=tool.placement.p, size=[0.8 * radius, 0.0, 0.0], rgba=TOOL)
    return spec


def _look(spec: mujoco.MjSpec, view: View, size: tuple[int, int]) -> None:
    """Size, smoothness and lights of the pictures."""
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.global_.fovy = FIELD_OF_VIEW
    spec.visual.quality.offsamples, spec.visual.quality.shadowsize = 4, 2048
    spec.visual.map.shadowclip = 2.0  # at 1 the ground at the edge of the picture is dotted
    spec.visual.headlight.ambient = [0.32, 0.32, 0.32]
    spec.visual.headlight.diffuse = [0.3, 0.3, 0.3]
    spec.visual.headlight.specular = [0.1, 0.1, 0.1]
    spec.stat.extent = 2.0 * view.radius  # near and far planes, shadows
    spec.stat.center = view.centre


def _surroundings(spec: mujoco.MjSpec, view: View) -> None:
    """A sky, a floor of tiles, and the sun."""
    import mujoco

    sky, floor = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtTexture.mjTEXTURE_2D
    gradient, checker = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, mujoco.mjtBuiltin.mjBUILTIN_CHECKER
    for name, kind, pattern, (one, other) in (("sky", sky, gradient, SKY), ("floor", floor, checker, TILES)):
        spec.add_texture(name=name, type=kind, builtin=pattern, rgb1=one, rgb2=other, width=256, height=256)
    edge = 10.0 ** np.floor(np.log10(2.0 * view.radius)) / 2.0  # of a tile: 0.05, 0.5 or 5 m
    material = spec.add_material(name="floor", texrepeat=[0.5 / edge, 0.5 / edge], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    _geom(spec.worldbody, "PLANE", size=[0.0, 0.0, 1.0], pos=[0.0, 0.0, view.floor], material="floor")
    above = np.array([0.3, -0.4, 1.0]) * 3.0 * view.radius
    light = spec.worldbody.add_light(pos=view.centre + above, dir=-above)
    light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    light.diffuse, light.specular, light.castshadow = [0.42, 0.42, 0.42], [0.1, 0.1, 0.1], True


def _geom(body: Any, shape: str, **values: Any) -> Any:
    """Something to see, which touches nothing."""
    import mujoco

    return body.add_geom(type=getattr(mujoco.mjtGeom, f"mjGEOM_{shape}"), contype=0, conaffinity=0, **values)


def _draw_bones(arm: Arm, i: int, body: Any, radius: float) -> None:
    """Capsules from a body's origin to the joints it carries and to the tool, and a short drum for its own joint."""
    for holder, _, end in bones(arm):
        if holder == i and np.linalg.norm(end) > 0.5 * radius:
            _geom(body, "CAPSULE", fromto=[0.0, 0.0, 0.0, *end], size=[0.7 * radius, 0.0, 0.0], rgba=LINK)
    if i == BASE:
        return
    drum = 1.1 * radius * np.asarray(arm.joints[i].axis)
    slides = arm.joints[i].kind == "prismatic"
    shape, width = ("BOX", radius) if slides else ("CYLINDER", 0.0)
    _geom(body, shape, fromto=[*-drum, *drum], size=[radius, width, 0.0], rgba=JOINT)
