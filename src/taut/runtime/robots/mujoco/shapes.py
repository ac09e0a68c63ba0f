"""Shapes of the arm: to look at, and to touch a scene with. None of them has mass."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from taut.arm.description import BASE, Arm
from taut.arm.loaders.mjspec import Bone, Meshes, add_shape, bones

if TYPE_CHECKING:
    import mujoco

__all__ = ["LOOKS", "TOUCHES", "TOUCHING", "Looks", "Shapes", "Touch"]

Touch = Literal["tool", "links"]
TOUCHES: Final[tuple[Touch, ...]] = ("tool", "links")
Looks = Literal["plain", "meshes"]
LOOKS: Final[tuple[Looks, ...]] = ("plain", "meshes")

BONE: Final = 0.02  # [m] radius of a link that has no shape to show
GREY: Final = (0.7, 0.7, 0.7, 1.0)
SHOWN: Final = 2  # the group of what is looked at
TOUCHING: Final = 3  # the group of what touches, which MuJoCo's viewers hide until asked


class Shapes:
    """Puts geoms onto the bodies of an arm.

    Args:
        arm: The arm.
        spec: What its model is compiled from.
        bodies: The MuJoCo body of each of the arm's.
        tool: Name of the body at the tool.
    """

    def __init__(self, arm: Arm, spec: mujoco.MjSpec, bodies: Sequence[mujoco.MjsBody], tool: str) -> None:
        import mujoco

        self._arm, self._spec, self._bodies, self._tool = arm, spec, bodies, tool
        self._kinds: Any = mujoco.mjtGeom

    def touch(self, what: Touch, tool_radius: float, tool_length: float | None, link_radius: float) -> None:
        """What can touch the scene. It answers to contacts and starts none, so that the arm never meets itself."""
        _make_touching(self._tool_shape(tool_radius, tool_length))
        if what == "links":
            for bone in self._bones():
                _make_touching(self._capsule(bone, link_radius))

    def _tool_shape(self, radius: float, length: float | None) -> mujoco.MjsGeom:
        """A sphere about the tool's origin, or a cylinder along its z axis that ends there."""
        body = self._spec.body(self._tool)
        if length is None:
            return body.add_geom(type=self._kinds.mjGEOM_SPHERE, size=[radius, 0.0, 0.0])
        middle = [0.0, 0.0, -0.5 * length]
        return body.add_geom(type=self._kinds.mjGEOM_CYLINDER, size=[radius, 0.5 * length, 0.0], pos=middle)

    def show(self, looks: Looks) -> None:
        """The arm's own shapes, and bones for bodies that have none; nothing touches them."""
        seen, meshes = {BASE}, Meshes()
        for visual in self._arm.visuals:
            if visual.shape == "mesh" and looks != "meshes":
                continue
            body, T = self._spec.worldbody, self._arm.T_WB @ visual.placement
            if visual.body != BASE:
                body, T = self._bodies[visual.body], visual.placement
            _make_shown(add_shape(self._spec, body, T, visual, meshes), visual.rgba)
            seen.add(visual.body)
        for bone in self._bones():
            if bone[0] not in seen:
                _make_shown(self._capsule(bone, BONE), GREY)

    def _bones(self) -> Iterator[Bone]:
        """Those of the links that move."""
        return (bone for bone in bones(self._arm) if bone[0] != BASE)

    def _capsule(self, bone: Bone, radius: float) -> mujoco.MjsGeom:
        """A capsule along a bone; a sphere where it has no length."""
        body, start, end = bone
        length = float(np.linalg.norm(end - start))
        if length < 1e-6:
            return self._bodies[body].add_geom(type=self._kinds.mjGEOM_SPHERE, size=[radius, 0.0, 0.0], pos=start)
        geom = self._bodies[body].add_geom(type=self._kinds.mjGEOM_CAPSULE, size=[radius, 0.0, 0.0])
        geom.fromto = [*start, *end]
        return geom


def _make_touching(geom: mujoco.MjsGeom) -> None:
    geom.contype, geom.conaffinity = 0, 1
    geom.friction = [0.0, 0.0, 0.0]  # MuJoCo takes the larger of two: that of what is touched
    geom.mass, geom.group = 0.0, TOUCHING


def _make_shown(geom: mujoco.MjsGeom, rgba: tuple[float, float, float, float]) -> None:
    geom.contype, geom.conaffinity = 0, 0
    geom.mass, geom.group, geom.rgba = 0.0, SHOWN, rgba
