"""Every link of a sound tree, sorted onto the bodies that the moving joints carry."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.friction import FRICTION_FIELDS
from taut.arm.parts import BASE, Body, Frame, Joint, JointKind, Visual
from taut.arm.rules import check_inertia, wrong_mass
from taut.base.errors import Problem, quoted_list
from taut.base.types import Float64Array
from taut.trace.pose import Pose, axis_angle

if TYPE_CHECKING:
    from taut.arm.loaders.tree import Tree, TreeJoint, TreeLink

__all__ = ["Lumps"]

MOVING_KINDS: Final[tuple[JointKind, ...]] = ("revolute", "continuous", "prismatic")


class Lumps:
    """Bodies, joints, frames and visuals of a tree, some of whose joints are locked.

    Joints stand in the order of a walk from the root: parents before children, each chain in one piece.
    """

    def __init__(self, tree: Tree, locked: Mapping[str, float]) -> None:
        self._tree = tree
        self._links = {link.name: link for link in tree.links}
        self._moving: list[TreeJoint] = []
        self._parents: list[int] = []
        self._placements: list[Pose] = []
        self._at: dict[str, tuple[int, Pose]] = {}  # link -> (body, T_body_link), in the order of the walk
        self._walk(locked)
        self._on_body: dict[int, list[TreeLink]] = {i: [] for i in range(len(self._moving))}
        for link, (body, _) in self._at.items():
            if body != BASE:
                self._on_body[body].append(self._links[link])

    def _walk(self, locked: Mapping[str, float]) -> None:
        children: dict[str, list[TreeJoint]] = {}
        for joint in self._tree.joints:
            children.setdefault(joint.parent, []).append(joint)
        has_parent = {joint.child for joint in self._tree.joints}
        root = next(link for link in self._links if link not in has_parent)
        self._at[root] = (BASE, Pose.identity())
        # Depth first and iterative. A joint is numbered when the walk reaches it, so that chains stay whole.
        stack = list(reversed(children.get(root, [])))
        while stack:
            joint = stack.pop()
            body, T_body_link = self._at[joint.parent]
            T_body_joint = T_body_link @ joint.origin
            if joint.kind == "fixed":
                self._at[joint.child] = (body, T_body_joint)
            elif joint.name in locked:
                self._at[joint.child] = (body, T_body_joint @ _held(joint, locked[joint.name]))
            else:
                self._moving.append(joint)
                self._parents.append(body)
                self._placements.append(T_body_joint)
                self._at[joint.child] = (len(self._moving) - 1, Pose.identity())
            stack.extend(reversed(children.get(joint.child, [])))

    def joints(self) -> tuple[Joint, ...]:
        """The moving joints."""
        return tuple(
            Joint(
                name=joint.name,
                kind=_moving_kind(joint),
                parent=parent,
                placement=placement,
                axis=_unit_axis(joint.axis),
                lower=joint.lower,
                upper=joint.upper,
                velocity=joint.velocity,
                effort=joint.effort,
                **{name: getattr(joint, name) for name in FRICTION_FIELDS},
                gear=joint.gear,
                rotor_inertia=joint.rotor_inertia,
            )
            for joint, parent, placement in zip(self._moving, self._parents, self._placements, strict=True)
        )

    def frames(self) -> tuple[Frame, ...]:
        """A frame for each link, and the file's own."""
        frames = [
            Frame(name=link, body=body, placement=pose)
            for link, (body, pose) in self._at.items()
            if self._links[link].is_frame
        ]
        for name, link, T_link_frame in self._tree.frames:
            body, T_body_link = self._at[link]
            frames.append(Frame(name=name, body=body, placement=T_body_link @ T_link_frame))
        return tuple(frames)

    def visuals(self) -> tuple[Visual, ...]:
        """What can be drawn, on the bodies."""
        return tuple(
            Visual(
                body=body,
                placement=T_body_link @ visual.placement,
                shape=visual.shape,
                size=visual.size,
                file=visual.file,
                rgba=visual.rgba,
            )
            for link, (body, T_body_link) in self._at.items()
            for visual in self._links[link].visuals
        )

    def moved(self, link: str) -> bool:
        """Whether any joint moves this link."""
        return self._at[link][0] != BASE

    def bodies(self) -> tuple[Body, ...]:
        """Mass properties, one body for each joint."""
        return tuple(self._lump(i) for i in range(len(self._moving)))

    def _lump(self, i: int) -> Body:
        """Mass, centre of mass and inertia of all links on one body, in that body's frame."""
        parts = []
        for link in self._on_body[i]:
            if link.inertia is not None and link.inertia.mass > 0.0:
                T = self._at[link.name][1]
                R = T.R
                parts.append((link.inertia.mass, T.act(link.inertia.com), R @ link.inertia.inertia @ R.T))
        links = tuple(link.name for link in self._on_body[i])
        mass = float(sum(m for m, _, _ in parts))
        if mass <= 0.0:
            return Body(mass=mass, com=np.zeros(3), inertia=np.zeros((3, 3)), links=links)
        com = np.sum([m * c for m, c, _ in parts], axis=0) / mass
        total = np.zeros((3, 3))
        for m, c, about_com in parts:
            d = c - com
            total += about_com + m * (float(d @ d) * np.eye(3) - np.outer(d, d))
        return Body(mass=mass, com=com, inertia=0.5 * (total + total.T), links=links)

    def problems(self) -> Iterator[Problem]:
        """Bodies that no joint can move: without mass, or with an inertia that no rigid body has."""
        for i in range(len(self._moving)):
            links = self._on_body[i]
            if any(link.unreadable or wrong_mass(link) for link in links):
                continue  # reported already
            body = self._lump(i)
            wrong = check_inertia(body.mass, body.inertia)
            if wrong is None:
                continue
            attribute, text = wrong
            owner = next((link for link in links if link.inertia is not None), None)
            if owner is None and links[0].if_massless is not None:
                yield links[0].if_massless
                continue
            yield Problem(
                object=(owner or links[0]).name,
                attribute=attribute,
                message=self._without_mass(i) if owner is None else self._wrong(owner, links, text),
                line=(owner or links[0]).lines.get(attribute, (owner or links[0]).line),
            )

    def _without_mass(self, i: int) -> str:
        link = f"{self._tree.words.link} '{self._on_body[i][0].name}'"
        return f"{link} is moved by joint '{self._moving[i].name}' and has no mass; {self._tree.words.no_mass}"

    def _wrong(self, owner: TreeLink, links: list[TreeLink], text: str) -> str:
        fixed = [link.name for link in links if link is not owner and link.is_frame]
        along = f", with {quoted_list(fixed, 3)} fixed to it" if fixed else ""
        return f"{self._tree.words.link} '{owner.name}'{along}: {text}; {self._tree.words.wrong_inertia}"


def _moving_kind(joint: TreeJoint) -> JointKind:
    for kind in MOVING_KINDS:
        if joint.kind == kind:
            return kind
    raise AssertionError(joint.kind)


def _unit_axis(axis: Float64Array) -> Float64Array:
    unit = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    nearest = np.round(unit)
    unit = np.where(np.abs(unit - nearest) < 1e-11, nearest, unit) + 0.0
    unit.flags.writeable = False
    return unit


def _held(joint: TreeJoint, q: float) -> Pose:
    """The motion of a joint that is held at q, as a pose; `assemble` has checked that q fits the joint."""
    if joint.kind not in MOVING_KINDS or q == 0.0:
        return Pose.identity()
    axis = _unit_axis(joint.axis)
    if joint.kind == "prismatic":
        return Pose(axis * q)
    return Pose(R=axis_angle(axis, q))
