"""A scene to look at: an arm, what is around it, a floor and a light as a MuJoCo model that is never simulated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.description import BASE, Arm, Visual
from taut.arm.loaders.mjspec import Meshes, add_links, add_shape, bones
from taut.base.errors import FileError
from taut.base.types import Float64Array
from taut.maths import dynamics
from taut.maths.model import Chain, model_of
from taut.record.info import Around
from taut.trace.pose import Pose

if TYPE_CHECKING:
    import mujoco

FIELD_OF_VIEW: Final = 45.0  # [deg] of the camera, upwards
VIEW_MARGIN: Final = 1.25  # of the picture around the arm
FLOOR_ROOM: Final = 0.25  # of the radius: room under an arm that would reach into the ground
SMALLEST: Final = 0.05  # [m] radius of what is looked at
PARALLEL_SINE: Final = 1e-3

LINK_THICKNESS: Final = 0.03  # of a drawn link, in parts of what is looked at
LINK: Final = (0.88, 0.88, 0.90, 1.0)
JOINT: Final = (0.0, 0.45, 0.70, 1.0)
TOOL: Final = (0.84, 0.37, 0.0, 1.0)
SKY: Final = ([1.0, 1.0, 1.0], [0.86, 0.90, 0.94])
TILES: Final = ([0.86, 0.89, 0.92], [0.77, 0.81, 0.86])
BARE: Final = (0.8, 0.8, 0.8, 1.0)  # colour of a visual that has none of its own


@dataclass(frozen=True, kw_only=True)
class View:
    """A camera that looks at a point; the z axis of the world points up in the picture."""

    centre: Float64Array  # (3,) [m]
    radius: float  # [m] of a ball about the centre that is all seen
    azimuth: float  # [deg] of the direction of view, from x towards y
    elevation: float  # [deg] of the direction of view, upwards
    floor: float  # [m] height of the floor

    def distance(self, width: int, height: int) -> float:
        """[m] from the camera to the centre, so that a picture of this size shows the ball."""
        half = math.radians(0.5 * FIELD_OF_VIEW)
        half = min(half, math.atan(math.tan(half) * width / height))
        return self.radius / math.sin(half)


def points_of(arm: Arm, q: Float64Array) -> Float64Array:
    """(k, n + 2, 3) [m]: the base, the joints and the tool at joint positions (k, n). Point i + 1 is joint i."""
    model = model_of(arm)
    out = np.empty((len(q), arm.n + 2, 3))
    out[:, 0], out[:, -1] = arm.T_WB.p, Chain.of(model, None).poses(q)[1]
    for k, row in enumerate(q):
        out[k, 1:-1] = [p for _, p in dynamics.link_poses(model, row)]
    return out


def view_of(arm: Arm, points: Float64Array, camera: tuple[float, float] | None = None) -> View:
    """A view of all that an arm does, through (k, n + 2, 3) points [m]; camera: azimuth, elevation [deg]."""
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    centre = 0.5 * (low + high)
    radius = max(SMALLEST, float(np.linalg.norm(points - centre, axis=-1).max()))
    azimuth, elevation = _direction(arm) if camera is None else camera
    buried = points[:, 1:-1, 2].min() < 0.02 * radius or points[:, -1, 2].min() < -0.02 * radius
    floor = min(0.0, float(low[2])) - FLOOR_ROOM * radius if buried else 0.0
    return View(centre=centre, radius=VIEW_MARGIN * radius, azimuth=azimuth, elevation=elevation, floor=floor)


def _direction(arm: Arm) -> tuple[float, float]:
    """Azimuth and elevation [deg]: across the plane of an arm that moves in one, else from ahead and above."""
    links = dynamics.link_poses(model_of(arm), np.zeros(arm.n))
    axes = np.array([R[:, 2] for (R, _), joint in zip(links, arm.joints, strict=True) if joint.kind != "prismatic"])
    if not len(axes) or np.abs(np.cross(axes, axes[0])).max() > PARALLEL_SINE:
        return 145.0, -20.0
    axis = axes[0]
    if abs(axis[2]) > 0.7:
        return 90.0, -60.0
    ahead = axis if axis[1] > 0.0 or (axis[1] == 0.0 and axis[0] < 0.0) else -axis  # x goes to the right
    return math.degrees(math.atan2(ahead[1], ahead[0])), -8.0


def scene(arm: Arm, view: View, size: tuple[int, int], around: Around | None = None) -> tuple[Any, Float64Array, str]:
    """A compiled model of the arm in its surroundings, (n,) the places of its joints in qpos, and what is not shown.

    Bodies without visuals get capsules from joint to joint; what moves by itself becomes a mocap body, in its order.
    """
    shown = [visual for visual in arm.visuals if visual.shape != "mesh" or Path(visual.file).is_file()]
    problem = "" if len(shown) == len(arm.visuals) else "some of their files are not there"
    try:
        model = _spec(arm, shown, view, size, around).compile()
    except (ValueError, FileError) as cause:  # a mesh that MuJoCo, or nobody, can read
        problem = f"MuJoCo cannot show them: {str(cause).splitlines()[0]}"
        model = _spec(arm, [], view, size, around).compile()
    places = np.array([model.joint(_joint_name(i)).qposadr[0] for i in range(arm.n)])
    return model, places, problem


def _joint_name(i: int) -> str:
    return f"joint {i}"  # names of an arm may be anything; these cannot clash with each other


def _spec(arm: Arm, visuals: list[Visual], view: View, size: tuple[int, int], around: Around | None) -> mujoco.MjSpec:
    import mujoco

    spec = mujoco.MjSpec()
    _look(spec, view, size)
    _surroundings(spec, view)
    base = spec.worldbody.add_body(name="base", pos=arm.T_WB.p, quat=arm.T_WB.wxyz)
    names = [(f"body {i}", _joint_name(i)) for i in range(arm.n)]
    bodies = {BASE: base} | {i: body for i, (body, _) in enumerate(add_links(arm, base, Pose.identity(), names))}
    meshes = Meshes()
    for visual in visuals:
        geom = add_shape(spec, bodies[visual.body], visual.placement, visual, meshes)
        geom.rgba = LINK if visual.rgba == BARE else visual.rgba
    drawn = {visual.body for visual in visuals}
    radius = LINK_THICKNESS * view.radius
    for i, body in bodies.items():
        if i != BASE:
            body.explicitinertial, body.mass, body.inertia = True, 1.0, [0.01, 0.01, 0.01]  # nothing falls here
        if i not in drawn and (i != BASE or not drawn):
            _draw_bones(arm, i, body, radius)
    tool = arm.frame()
    _geom(bodies[tool.body], "SPHERE", pos=tool.placement.p, size=[0.8 * radius, 0.0, 0.0], rgba=TOOL)
    if around is not None:
        _put_around(spec, around, bodies[tool.body], tool.placement)
    return spec


def _put_around(spec: mujoco.MjSpec, around: Around, carrier: Any, T_tool: Pose) -> None:
    """Everything that stands around the arm."""
    import mujoco

    for i, mesh in enumerate(around.meshes):
        made = spec.add_mesh(
            name=f"around {i}", uservert=mesh.vertices.ravel(), userface=mesh.faces.astype(np.int32).ravel()
        )
        made.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # a surface has no volume
    for thing in around.things:
        if thing.on_tool:
            body = carrier.add_body(pos=T_tool.p, quat=T_tool.wxyz)
        else:
            body = spec.worldbody.add_body(pos=thing.p, quat=thing.wxyz, mocap=thing.moves)
        for shape in thing.shapes:
            at = {"pos": shape.p, "quat": shape.wxyz, "rgba": shape.rgba}
            if shape.kind == "mesh":
                _geom(body, "MESH", meshname=f"around {shape.mesh}", **at)
            else:
                _geom(body, shape.kind.upper(), size=shape.size, **at)


def _look(spec: mujoco.MjSpec, view: View, size: tuple[int, int]) -> None:
    """Size, smoothness and lights of the pictures."""
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.global_.fovy = FIELD_OF_VIEW
    # Without a graphics card several samples a pixel, or shadows, take twice as long, and a film as long as it shows.
    spec.visual.quality.offsamples = 0
    spec.visual.headlight.ambient = [0.32, 0.32, 0.32]
    spec.visual.headlight.diffuse = [0.3, 0.3, 0.3]
    spec.visual.headlight.specular = [0.1, 0.1, 0.1]
    spec.stat.extent = 2.0 * view.radius  # near and far planes
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
    light.diffuse, light.specular, light.castshadow = [0.42, 0.42, 0.42], [0.1, 0.1, 0.1], False


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
