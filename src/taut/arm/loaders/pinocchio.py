"""An arm from a Pinocchio model that is in memory. Pinocchio itself is not imported here."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from taut.arm.loaders.tree import LinkInertia, Tree, TreeJoint, TreeKind, TreeLink, Words, assemble
from taut.base.errors import UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from taut.arm.description import Arm

__all__ = ["PinocchioModel", "arm_from_pinocchio", "pinocchio_tree"]


class Placement(Protocol):
    """pinocchio.SE3."""

    @property
    def rotation(self) -> Float64Array: ...
    @property
    def translation(self) -> Float64Array: ...


class SpatialInertia(Protocol):
    """pinocchio.Inertia: `inertia` is about the centre of mass, at `lever`."""

    @property
    def mass(self) -> float: ...
    @property
    def lever(self) -> Float64Array: ...
    @property
    def inertia(self) -> Float64Array: ...


class JointData(Protocol):
    """pinocchio.JointData: S is the joint's motion subspace, linear part first."""

    @property
    def S(self) -> Float64Array: ...


class JointModel(Protocol):
    """pinocchio.JointModel."""

    @property
    def idx_q(self) -> int: ...
    @property
    def idx_v(self) -> int: ...
    def shortname(self) -> str:
        """Its type."""
        ...

    def createData(self) -> JointData:
        """What `calc` fills."""
        ...

    def calc(self, data: JointData, q: Float64Array, /) -> None:
        """Kinematics at q, which has the size of the whole model's."""
        ...


class FrameModel(Protocol):
    """pinocchio.Frame."""

    @property
    def name(self) -> str: ...
    @property
    def parentJoint(self) -> int: ...
    @property
    def parentFrame(self) -> int: ...
    @property
    def placement(self) -> Placement: ...


class MotionVector(Protocol):
    """pinocchio.Motion."""

    @property
    def linear(self) -> Float64Array: ...


class PinocchioModel(Protocol):
    """What is read of a pinocchio.Model."""

    name: str
    njoints: int
    nq: int
    names: Sequence[str]
    parents: Sequence[int]
    joints: Sequence[JointModel]
    jointPlacements: Sequence[Placement]
    inertias: Sequence[SpatialInertia]
    frames: Sequence[FrameModel]
    gravity: MotionVector
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
KINDS: Final[dict[str, TreeKind]] = {
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


def arm_from_pinocchio(
    arm_class: type[Arm], model: PinocchioModel, tool: str | None, gravity: ArrayLike | None
) -> Arm:
    """The arm of a Pinocchio model; see `Arm.from_pinocchio`."""
    if not hasattr(model, "jointPlacements"):
        raise UsageError(f"model must be a pinocchio.Model; got {type(model).__name__}", name="model")
    return assemble(arm_class, pinocchio_tree(model), tool=tool, gravity=gravity)


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
        tree.links.append(
            TreeLink(
                name=links[i],
                inertia=LinkInertia(
                    mass=float(inertia.mass),
                    com=np.array(inertia.lever, dtype=np.float64),
                    inertia=np.array(inertia.inertia, dtype=np.float64),
                ),
            )
        )
        tree.joints.append(_joint(tree, model, i, links[model.parents[i]], links[i]))
    tree.frames.extend(_frames(model, links))
    tree.leaves = _leaves(model, links)
    return tree


def _joint(tree: Tree, model: PinocchioModel, i: int, parent: str, child: str) -> TreeJoint:
    joint = model.joints[i]
    type_name = joint.shortname()
    kind = KINDS.get(type_name)
    made = TreeJoint(name=child, kind=kind or "fixed", parent=parent, child=child)
    made.origin = _pose(model.jointPlacements[i])
    if kind is None:
        tree.problem(
            child,
            "type",
            f"joint '{child}': {type_name} is not one of an arm's joints (hinges and slides); "
            f"build the model without it, {WORDS.hold}",
        )
    elif kind in ("revolute", "continuous", "prismatic"):
        _fill(made, model, joint)
    return made


def _fill(made: TreeJoint, model: PinocchioModel, joint: JointModel) -> None:
    """Axis, limits and friction of a joint with one degree of freedom."""
    data = joint.createData()
    joint.calc(data, np.zeros(model.nq))
    S = np.asarray(data.S, dtype=np.float64).reshape(6)
    made.axis = S[:3] if made.kind == "prismatic" else S[3:]
    q, v = joint.idx_q, joint.idx_v
    if made.kind != "continuous":  # those have the cosine and sine of the angle in q
        made.lower = _unlimited(model.lowerPositionLimit[q])
        made.upper = _unlimited(model.upperPositionLimit[q])
    made.velocity = _unlimited(model.velocityLimit[v])
    made.effort = _unlimited(model.effortLimit[v])
    made.viscous = float(model.damping[v])
    made.coulomb = float(model.friction[v])
    ratio = abs(float(model.rotorGearRatio[v]))
    made.gear = ratio if ratio > 0.0 else 1.0  # zero stands for none
    armature = float(model.armature[v])
    made.rotor_inertia = armature or float(model.rotorInertia[v] * model.rotorGearRatio[v] ** 2)


def _unlimited(value: float) -> float:
    return math.copysign(math.inf, value) if abs(value) > NO_LIMIT else float(value)


def _pose(placement: Placement) -> Pose:
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
