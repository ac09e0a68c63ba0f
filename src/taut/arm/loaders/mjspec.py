"""An Arm inside a MuJoCo specification: a body for each joint, its visuals as geoms, the lines between its joints.

What the driver simulates and what a film shows are both built on this. Nothing here has mass, and nothing touches.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from taut.arm.description import Arm, Visual
from taut.arm.parts import BASE
from taut.base.checks import readable_file
from taut.base.types import Float64Array
from taut.trace.pose import Pose

if TYPE_CHECKING:
    import mujoco

Bone: TypeAlias = tuple[int, Float64Array, Float64Array]
"""Body, start and end [m] in its frame."""
Meshes: TypeAlias = dict[tuple[str, tuple[float, ...]], str]
"""Names of the meshes of a specification, by file and scale: a mesh that is shown often is there once."""


def add_links(
    arm: Arm, base: mujoco.MjsBody, T_base: Pose, names: Sequence[tuple[str, str]]
) -> list[tuple[mujoco.MjsBody, mujoco.MjsJoint]]:
    """One body and its joint for each of the arm's, named (body, joint), on `base` with T_base in its frame."""
    import mujoco

    made: list[tuple[mujoco.MjsBody, mujoco.MjsJoint]] = []
    for joint, (name, joint_name) in zip(arm.joints, names, strict=True):
        at_base = joint.parent == BASE
        T = T_base @ joint.placement if at_base else joint.placement
        body = (base if at_base else made[joint.parent][0]).add_body(name=name, pos=T.p, quat=T.wxyz)
        kind = mujoco.mjtJoint.mjJNT_SLIDE if joint.kind == "prismatic" else mujoco.mjtJoint.mjJNT_HINGE
        made.append((body, body.add_joint(name=joint_name, type=kind, axis=joint.axis)))
    return made


def add_shape(spec: mujoco.MjSpec, body: mujoco.MjsBody, T: Pose, visual: Visual, meshes: Meshes) -> mujoco.MjsGeom:
    """A visual as a geom that touches nothing, standing at T in a MuJoCo body."""
    import mujoco

    kinds, size = mujoco.mjtGeom, visual.size
    geom = body.add_geom(pos=T.p, quat=T.wxyz, contype=0, conaffinity=0)
    if visual.shape == "mesh":
        key = (visual.file, visual.size)
        if key not in meshes:
            path = readable_file("mesh", visual.file)
            meshes[key] = f"visual{len(meshes)}"
            file = f"{meshes[key]}{path.suffix}"
            spec.assets = {**spec.assets, file: path.read_bytes()}
            spec.add_mesh(name=meshes[key], file=file, scale=list(size))
        geom.type, geom.meshname = kinds.mjGEOM_MESH, meshes[key]
    elif visual.shape == "box":
        geom.type, geom.size = kinds.mjGEOM_BOX, [0.5 * edge for edge in size]
    elif visual.shape == "cylinder":
        geom.type, geom.size = kinds.mjGEOM_CYLINDER, [size[0], 0.5 * size[1], 0.0]
    else:
        geom.type, geom.size = kinds.mjGEOM_SPHERE, [size[0], 0.0, 0.0]
    return geom


def bones(arm: Arm) -> Iterator[Bone]:
    """Straight lines from each joint, and from the base, to the joints and the tool that its body carries."""
    for joint in arm.joints:
        yield joint.parent, np.zeros(3), joint.placement.p
    yield arm.frame().body, np.zeros(3), arm.frame().placement.p
