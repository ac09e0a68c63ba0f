"""An arm from a Pinocchio model that is in memory. Pinocchio itself is not imported here."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final, Protocol

import numpy as np

from taut.arm.loaders.tree import Tree, TreeJoint, TreeLink, Words
from taut.arm.parts import Body, Joint, JointKind
from taut.base.types import Float64Array
from taut.trace.pose import Pose

__all__ = ["PinocchioModel", "pinocchio_tree"]


class PinocchioModel(Protocol):
    """What is read of a pinocchio.Model, whose joints, placements, inertias and frames have no types."""

    name: str
    njoints: int
    nq: int
    names: Sequence[str]
    parents: Sequence[int]
    joints: Sequence[Any]
    jointPlacements: Sequence[Any]
    inertias: Sequence[Any]
    frames: Sequence[Any]
    gravity: Any
    lowerPositionLimit: Float64Array
    upperPositionLimit: Float64Array
    velocityLimit: Float64Array
    effortLimit: Float64Array
    friction: Float64Array
    damping: Float64Array
    armature: Float64Array
    rotorInertia: Float64Array
    rotorGearRatio: Float64Array


WORDS: Final = Words(
    no_mass="fix its entry of model.inertias",
    wrong_inertia="fix its entry of model.inertias",
    hold="or hold it still: pinocchio.buildReducedModel",
)
NO_LIMIT: Final = 1e300  # Pinocchio writes the largest float where there is no limit
KINDS: Final[dict[str, JointKind]] = {
    **{f"JointModelR{axis}": "revolute" for axis in "XYZ"},
    **{f"JointModelRUB{axis}": "continuous" for axis in "XYZ"},
    **{f"JointModelP{axis}": "prismatic" for axis in "XYZ"},
    "JointModelRevoluteUnaligned": "revolute",
    "JointModelRevoluteUnboundedUnaligned": "continuous",
    "JointModelPrismaticUnaligned": "prismatic",
    "JointModelFreeFlyer": "floating",
    "JointModelPlanar": "planar",
    "JointModelSpherical": "ball",
    "JointModelSphericalZYX": "ball",
}


def pinocchio_tree(model: PinocchioModel) -> Tree:
    """A Pinocchio model as links and joints.

    Rotor inertia is `armature`, which is what Pinocchio's own algorithms add to the mass matrix, or, where that
    is zero, rotorInertia times rotorGearRatio squared.
    """
    tree = Tree(name=model.name or "arm", source="a Pinocchio model", words=WORDS)
    tree.gravity = np.array(model.gravity.linear)
    links = [str(name) for name in model.names]
    tree.links.append(TreeLink(name=links[0]))
    for i in range(1, model.njoints):
        inertia = model.inertias[i]
        body = Body(mass=float(inertia.mass), com=inertia.lever, inertia=inertia.inertia)
        tree.links.append(TreeLink(name=links[i], inertia=body))
        parent = links[model.parents[i]]
        tree.joints.append(TreeJoint(joint=_joint(tree, model, i, links[i]), parent=parent, child=links[i]))
    tree.frames.extend(_frames(model, links))
    tree.leaves = _leaves(model, links)
    return tree


def _joint(tree: Tree, model: PinocchioModel, i: int, name: str) -> Joint:
    joint, placement = model.joints[i], _pose(model.jointPlacements[i])
    type_name = joint.shortname()
    kind = KINDS.get(type_name)
    if kind is None:
        tree.problem(
            name,
            "type",
            f"joint '{name}': {type_name} is not one of an arm's joints (hinges and slides); "
            f"build the model without it, {WORDS.hold}",
        )
    if kind not in ("revolute", "continuous", "prismatic"):
        return Joint(name=name, kind=kind or "fixed", placement=placement)
    data = joint.createData()
    joint.calc(data, np.zeros(model.nq))
    S = np.asarray(data.S, dtype=np.float64).reshape(6)
    q, v = joint.idx_q, joint.idx_v
    limits: dict[str, Any] = {
        "velocity": _unlimited(model.velocityLimit[v]),
        "effort": _unlimited(model.effortLimit[v]),
    }
    if kind != "continuous":  # those have the cosine and sine of the angle in q
        limits["lower"] = _unlimited(model.lowerPositionLimit[q])
        limits["upper"] = _unlimited(model.upperPositionLimit[q])
    ratio = abs(float(model.rotorGearRatio[v]))
    return Joint(
        name=name,
        kind=kind,
        placement=placement,
        axis=S[:3] if kind == "prismatic" else S[3:],
        viscous=float(model.damping[v]),
        coulomb=float(model.friction[v]),
        gear=ratio if ratio > 0.0 else 1.0,  # zero stands for none
        rotor_inertia=float(model.armature[v]) or float(model.rotorInertia[v] * model.rotorGearRatio[v] ** 2),
        **limits,
    )


def _unlimited(value: float) -> float:
    return math.copysign(math.inf, value) if abs(value) > NO_LIMIT else float(value)


def _pose(placement: Any) -> Pose:
    return Pose(np.array(placement.translation), R=np.array(placement.rotation))


def _frames(model: PinocchioModel, links: list[str]) -> Iterator[tuple[str, str, Pose]]:
    """The model's frames; where a body and a joint share a name, the first one."""
    taken = set(links)
    for frame in model.frames:
        if frame.name not in taken:
            taken.add(frame.name)
            yield frame.name, links[frame.parentJoint], _pose(frame.placement)


def _leaves(model: PinocchioModel, links: list[str]) -> list[str]:
    """The frames at the ends: those that carry no other one; the last joints where there are no frames."""
    carrying = {frame.parentFrame for frame in model.frames[1:]}
    leaves = [f.name for i, f in enumerate(model.frames) if i and i not in carrying and f.parentJoint > 0]
    if leaves:
        return list(dict.fromkeys(leaves))
    parents = {model.parents[i] for i in range(1, model.njoints)}
    return [links[i] for i in range(1, model.njoints) if i not in parents]
