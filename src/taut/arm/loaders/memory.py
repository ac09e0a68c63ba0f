"""Arms from the textbook's screw axes, which have the angular part first, and from Pinocchio models."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.loaders.tree import Tree, TreeJoint, TreeLink, assemble
from taut.arm.parts import Body, Joint, JointKind
from taut.base.checks import SYMMETRY_TOLERANCE, finite_array
from taut.base.errors import RangeError, ShapeError
from taut.base.types import ArrayLike, Float64Array
from taut.trace import math as tm
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from taut.arm.description import Arm

UNIT: Final = 1e-6  # how far a screw axis may be from unit length and from zero pitch
BASE: Final = "base"
TOOL: Final = "tool"


def arm_from_screws(
    arm_class: type[Arm], Mlist: ArrayLike, Glist: ArrayLike, Slist: ArrayLike, gravity: ArrayLike, name: str
) -> Arm:
    """The arm of `Arm.from_screws`. Frames `link1` ... `linkn` are the textbook's; joint i has the axes of link i.

    Its origin is the point of its axis nearest to that frame's origin, or the origin itself if it is prismatic.
    """
    S = finite_array("Slist", Slist)
    if S.ndim != 2 or S.shape[0] != 6 or S.shape[1] == 0:
        raise ShapeError(
            f"Slist must have shape (6, n), one screw axis (omega, v) in each column; got shape {S.shape}",
            name="Slist",
        )
    n = S.shape[1]
    M = finite_array("Mlist", Mlist, shape=(n + 1, 4, 4))
    G = finite_array("Glist", Glist, shape=(n, 6, 6))
    tree = Tree(name=name, source="screw axes", tool=TOOL)
    tree.links.append(TreeLink(name=BASE))
    T_0_link, parent = Pose.identity(), BASE
    for i in range(n):
        T_0_before = T_0_link
        T_0_link = T_0_link @ _pose_of(f"Mlist[{i}]", M[i])
        kind, axis, point = _axis(tree, i, S[:, i], T_0_link.p)
        T_0_joint = Pose.of(T_0_link.R, point)
        moved, link = f"<joint{i + 1}>", f"link{i + 1}"
        tree.links.append(TreeLink(name=moved, is_frame=False))
        tree.links.append(TreeLink(name=link, inertia=_inertia(f"Glist[{i}]", G[i])))
        place = T_0_before.inverse() @ T_0_joint
        joint = Joint(name=f"joint{i + 1}", kind=kind, placement=place, axis=T_0_link.R.T @ axis)
        tree.joints.append(TreeJoint(joint=joint, parent=parent, child=moved))
        tree.joints.append(TreeJoint.fixed(moved, link, T_0_joint.inverse() @ T_0_link))
        parent = link
    tree.links.append(TreeLink(name=TOOL))
    tree.joints.append(TreeJoint.fixed(parent, TOOL, _pose_of(f"Mlist[{n}]", M[n])))
    return assemble(arm_class, tree, gravity=gravity)


def _pose_of(name: str, T: Float64Array) -> Pose:
    try:
        return Pose.from_matrix(T)
    except RangeError as wrong:
        raise RangeError(f"{name} must be a pose: {wrong}", name=name, rule="a pose") from wrong


def _axis(tree: Tree, i: int, S: Float64Array, near: Float64Array) -> tuple[JointKind, Float64Array, Float64Array]:
    """Kind of joint, unit axis, and the point of the axis nearest to `near`, all in the space frame."""
    omega, v = S[:3], S[3:]
    turn, slide = float(np.linalg.norm(omega)), float(np.linalg.norm(v))
    if abs(turn - 1.0) <= UNIT:
        pitch = float(omega @ v) / turn**2
        if abs(pitch) > UNIT * max(1.0, slide):
            _problem(tree, i, f"its pitch omega . v must be 0, for an arm has no helical joints; got {pitch:.6g} m")
        on_axis = np.cross(omega, v)
        return "revolute", omega, on_axis + omega * float(omega @ (near - on_axis))
    if turn > UNIT:
        way_out = f"divide the column by {turn:.6g}: its positions grow by that factor, its torques shrink by it"
        _problem(tree, i, f"|omega| must be 1 (revolute) or 0 (prismatic); got {turn:.6g}; {way_out}")
    elif abs(slide - 1.0) > UNIT:
        _problem(tree, i, f"|v| must be 1 where omega is 0 (prismatic); got {slide:.6g}")
    return "prismatic", v, near


def _problem(tree: Tree, i: int, text: str) -> None:
    tree.problem(f"joint{i + 1}", f"Slist[:, {i}]", f"joint 'joint{i + 1}': Slist[:, {i}]: {text}")


def _inertia(name: str, G: Float64Array) -> Body:
    """Body of G = [[I_com - m [c][c], m [c]], [-m [c], m 1]], angular part first, link frame, com at c."""
    scale = max(float(np.abs(G).max()), np.finfo(float).tiny)
    m = float(np.trace(G[3:, 3:])) / 3.0
    mc = np.array([G[2, 4], G[0, 5], G[1, 3]])
    mc_skew = tm.skew(mc)
    expected = np.block([[G[:3, :3], mc_skew], [mc_skew.T, m * np.eye(3)]])
    if np.abs(G - expected).max() > SYMMETRY_TOLERANCE * scale or not np.allclose(
        G, G.T, rtol=0.0, atol=SYMMETRY_TOLERANCE * scale
    ):
        raise RangeError(
            f"{name} must be a spatial inertia, angular part first: [[I, m [c]], [-m [c], m 1]] with I "
            "symmetric and c the centre of mass, most often diag(Ixx, Iyy, Izz, m, m, m); "
            "a matrix with the linear part first has its blocks the other way round",
            name=name,
            rule="a spatial inertia",
        )
    c = mc / m if m > 0.0 else mc
    S = tm.skew(c)
    I = G[:3, :3] + m * S @ S
    return Body(mass=m, com=c, inertia=0.5 * (I + I.T))


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


def pinocchio_tree(model: Any) -> Tree:
    """A Pinocchio model; rotor inertia is `armature`, or rotorInertia rotorGearRatio^2 where that is zero."""
    tree = Tree(name=model.name or "arm", source="a Pinocchio model")
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


def _joint(tree: Tree, model: Any, i: int, name: str) -> Joint:
    joint, placement = model.joints[i], _pose(model.jointPlacements[i])
    type_name = joint.shortname()
    kind = KINDS.get(type_name)
    if kind is None:
        tree.problem(
            name,
            "type",
            f"joint '{name}': {type_name} is not one of an arm's joints (hinges and slides); "
            "build the model without it: pinocchio.buildReducedModel",
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


def _frames(model: Any, links: list[str]) -> Iterator[tuple[str, str, Pose]]:
    """The model's frames; where a body and a joint share a name, the first one."""
    taken = set(links)
    for frame in model.frames:
        if frame.name not in taken:
            taken.add(frame.name)
            yield frame.name, links[frame.parentJoint], _pose(frame.placement)


def _leaves(model: Any, links: list[str]) -> list[str]:
    """The frames at the ends: those that carry no other one; the last joints where there are no frames."""
    carrying = {frame.parentFrame for frame in model.frames[1:]}
    leaves = [f.name for i, f in enumerate(model.frames) if i and i not in carrying and f.parentJoint > 0]
    if leaves:
        return list(dict.fromkeys(leaves))
    parents = {model.parents[i] for i in range(1, model.njoints)}
    return [links[i] for i in range(1, model.njoints) if i not in parents]
