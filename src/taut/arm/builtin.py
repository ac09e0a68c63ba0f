"""Four small arms that can be checked by hand. The planar ones move in the vertical x-z plane, at zero along x."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.loaders.tree import Tree, TreeJoint, TreeLink, assemble
from taut.arm.parts import COMMANDS, Body, Joint, Visual
from taut.base.checks import finite_scalar, positive_scalar
from taut.base.errors import RangeError
from taut.trace.pose import Pose

RAISING: Final = (0.0, -1.0, 0.0)  # turning about -y takes x to z
ALONG_X: Final = (0.0, 0.5 * math.pi, 0.0)  # rpy of a cylinder, whose own axis is z
RADIUS: Final = 0.03  # [m] of rods
FRICTION: Final = 0.1  # [N m s/rad] viscous
BASE: Final = "base"
TOOL: Final = "tool"


def one_joint(*, M: float = 0.5, m: float = 1.0, r: float = 0.1, b: float = 0.1) -> Arm:
    """The chapter's link on one hinge: M a + m g r cos(theta) + b v = tau, with g = 9.81 m/s^2.

    theta = 0 is horizontal along x, theta > 0 raises it towards z. M [kg m^2] is about the hinge, above
    m r^2; r [m] is the distance of the centre of mass, where the frame `tool` is; b [N m s/rad] is viscous friction.

    Example:
        >>> arm = one_joint(r=0.08)
        >>> arm.bodies[0].com.tolist()
        [0.08, 0.0, 0.0]

    References:
        Lynch and Park, Modern Robotics (2017), section 10.2.1, figure 10.2, equation 10.4 and below.
    """
    return assemble(Arm, one_joint_tree(M=M, m=m, r=r, b=b))


def one_joint_tree(*, M: float = 0.5, m: float = 1.0, r: float = 0.1, b: float = 0.1) -> Tree:
    """The links and joints of `one_joint`."""
    M, m = positive_scalar("M", M, unit="kg m^2"), positive_scalar("m", m, unit="kg")
    r, b = finite_scalar("r", r, unit="m"), finite_scalar("b", b, unit="N m s/rad", minimum=0.0)
    about_com = M - m * r * r
    if about_com <= 0.0:
        raise RangeError(
            f"M must be above m r^2 [kg m^2], which a point mass at r has; got {M!r} with m r^2 = {m * r * r:g}",
            name="M",
            value=M,
            rule="> m r^2",
        )
    # Only the moment about y turns up in the motion; a link as thick as this is a possible body.
    inertia = np.diag([0.5 * about_com, about_com, about_com])
    tree = _planar("one_joint", lengths=[r], masses=[m], home=[0.0])
    tree.joints[0].joint = dataclasses.replace(tree.joints[0].joint, viscous=b)
    tree.links[1].inertia = Body(mass=m, com=np.array([r, 0.0, 0.0]), inertia=inertia)
    return tree


def planar2_tree() -> Tree:
    """Two rods of 0.5 and 0.4 m on two parallel hinges."""
    return _planar("planar2", lengths=[0.5, 0.4], masses=[4.0, 2.0], home=[math.pi / 6, math.pi / 2])


def planar3_tree() -> Tree:
    """Three rods of 0.4, 0.3 and 0.2 m on three parallel hinges: one more than a point in the plane needs."""
    home = [math.pi / 6, math.pi / 3, math.pi / 4]
    return _planar("planar3", lengths=[0.4, 0.3, 0.2], masses=[3.0, 2.0, 1.0], home=home)


def gantry3_tree() -> Tree:
    """Three slides, along x, y and z, whose tool hangs 0.2 m below the last: gravity acts on the third only."""
    tree = Tree(name="gantry3", source="built in", commands=COMMANDS, links=[TreeLink(name=BASE)])
    slides = [("x", 12.0, 0.5, 400.0), ("y", 6.0, 0.4, 200.0), ("z", 3.0, 0.3, 150.0)]
    parent, edge = BASE, 0.1
    for (axis, mass, travel, force), direction in zip(slides, np.eye(3), strict=True):
        link = f"{axis}_carriage"
        cube = Body(mass=mass, com=np.zeros(3), inertia=np.eye(3) * mass * edge**2 / 6.0)
        box = Visual(placement=Pose.identity(), shape="box", size=(edge, edge, edge))
        tree.links.append(TreeLink(name=link, inertia=cube, visuals=[box]))
        joint = Joint(
            name=axis,
            kind="prismatic",
            axis=direction,
            lower=-travel,
            upper=travel,
            velocity=1.0,
            effort=force,
            viscous=5.0,
        )
        tree.joints.append(TreeJoint(joint=joint, parent=parent, child=link))
        parent = link
    _end(tree, parent, Pose((0.0, 0.0, -0.2)))
    return tree


def _planar(name: str, *, lengths: Sequence[float], masses: Sequence[float], home: Sequence[float]) -> Tree:
    """Hinges without limits, each of which raises the links after it; the links are rods of 3 cm radius."""
    tree = Tree(name=name, source="built in", commands=COMMANDS, links=[TreeLink(name=BASE)])
    parent, offset = BASE, 0.0
    for i, (length, m) in enumerate(zip(lengths, masses, strict=True), start=1):
        link, middle = f"link{i}", (0.5 * length, 0.0, 0.0)
        across = m * (3.0 * RADIUS**2 + length**2) / 12.0
        rod = Body(mass=m, com=np.array(middle), inertia=np.diag([0.5 * m * RADIUS**2, across, across]))
        shape = Visual(placement=Pose(middle, rpy=ALONG_X), shape="cylinder", size=(0.02, max(abs(length), 0.01)))
        tree.links.append(TreeLink(name=link, inertia=rod, visuals=[shape]))
        place = Pose((offset, 0.0, 0.0))
        joint = Joint(name=f"joint{i}", kind="revolute", placement=place, axis=np.array(RAISING), viscous=FRICTION)
        tree.joints.append(TreeJoint(joint=joint, parent=parent, child=link))
        parent, offset = link, length
    _end(tree, parent, Pose((offset, 0.0, 0.0)))
    tree.home = {joint.name: q for joint, q in zip(tree.joints, home, strict=False)}
    return tree


def _end(tree: Tree, parent: str, T_parent_tool: Pose) -> None:
    tree.links.append(TreeLink(name=TOOL))
    tree.joints.append(TreeJoint.fixed(parent, TOOL, T_parent_tool))


BUILT_IN: Final[Mapping[str, Callable[[], Tree]]] = {
    "one_joint": one_joint_tree,
    "planar2": planar2_tree,
    "planar3": planar3_tree,
    "gantry3": gantry3_tree,
}
