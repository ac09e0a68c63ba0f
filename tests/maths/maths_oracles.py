"""Pinocchio's view of the arms that these tests look at, and arms that are awkward on purpose."""

from __future__ import annotations

import dataclasses
import functools
import xml.etree.ElementTree as ET
from importlib import metadata

import numpy as np
import pinocchio as pin

import taut
from taut.arm.catalogue import CATALOGUE
from taut.arm.parts import BASE, Body, Frame, Joint
from taut.base.types import Float64Array

NAMES = tuple(CATALOGUE)
Array = Float64Array


def se3(pose: taut.Pose) -> pin.SE3:
    return pin.SE3(np.array(pose.R), np.array(pose.p))


class Oracle:
    """An arm in Pinocchio: the quantities of `taut.dynamics` under the names that they have there.

    q has one entry per joint in the arm's order. Pinocchio wants branches one after the other, and cosine and sine of
    joints that wrap; it gets them here.
    """

    def __init__(self, model: pin.Model, tool: int, order: list[int] | None = None) -> None:
        self.model = model
        self.data = model.createData()
        self.tool = tool
        self.order = (
            np.arange(model.nv) if order is None else np.array(order)
        )  # Pinocchio's k-th is the arm's order[k]

    def q(self, q: Array) -> Array:
        out = np.zeros(self.model.nq)
        for joint, value in zip(list(self.model.joints)[1:], q[self.order], strict=True):
            out[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        return out

    def _vector(self, x: Array) -> Array:
        out = np.zeros(len(x))
        out[self.order] = x
        return out

    def _matrix(self, x: Array) -> Array:
        out = np.zeros((self.model.nv, self.model.nv))
        out[np.ix_(self.order, self.order)] = np.reshape(x, out.shape)
        return out

    def carry(self, payload: taut.Payload) -> None:
        """Add a payload in the tool frame to the body that carries it."""
        frame = self.model.frames[self.tool]
        xx, yy, zz, xy, xz, yz = payload.inertia
        I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        self.model.appendBodyToJoint(frame.parentJoint, pin.Inertia(payload.mass, payload.com, I), frame.placement)
        self.data = self.model.createData()

    def M(self, q: Array) -> Array:
        return self._matrix(pin.crba(self.model, self.data, self.q(q)))

    def h(self, q: Array, v: Array) -> Array:
        return self._vector(pin.nonLinearEffects(self.model, self.data, self.q(q), v[self.order]))

    def g(self, q: Array) -> Array:
        return self._vector(pin.computeGeneralizedGravity(self.model, self.data, self.q(q)))

    def C(self, q: Array, v: Array) -> Array:
        return self._matrix(pin.computeCoriolisMatrix(self.model, self.data, self.q(q), v[self.order]))

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        return self._vector(pin.rnea(self.model, self.data, self.q(q), v[self.order], a[self.order]))

    def forward_dynamics(self, q: Array, v: Array, tau: Array) -> Array:
        return self._vector(pin.aba(self.model, self.data, self.q(q), v[self.order], tau[self.order]))

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """Kinetic energy with that of the rotors, which Pinocchio 4.1 counts for some joints only, and potential."""
        Q, V, rotors = self.q(q), v[self.order], np.array(self.model.armature)
        self.model.armature = np.zeros(len(V))
        kinetic = pin.computeKineticEnergy(self.model, self.data, Q, V) + 0.5 * V @ (rotors * V)
        self.model.armature = rotors
        return float(kinetic), float(pin.computePotentialEnergy(self.model, self.data, Q))

    def pose(self, q: Array, frame: int | None = None) -> pin.SE3:
        pin.framesForwardKinematics(self.model, self.data, self.q(q))
        return pin.SE3(self.data.oMf[self.tool if frame is None else frame])  # a copy: the data change

    def J(self, q: Array, axes: str) -> Array:
        reference = pin.LOCAL_WORLD_ALIGNED if axes == "W" else pin.LOCAL
        found = pin.computeFrameJacobian(self.model, self.data, self.q(q), self.tool, reference)
        out = np.zeros((6, self.model.nv))
        out[:, self.order] = np.reshape(found, out.shape)  # one joint's comes as a vector
        return out

    def Jdot_v(self, q: Array, v: Array, axes: str) -> Array:
        """Acceleration of the tool with a = 0: of its origin in world axes, or of the twist's numbers in its own."""
        pin.forwardKinematics(self.model, self.data, self.q(q), v[self.order], np.zeros_like(v))
        if axes == "W":
            found = pin.getFrameClassicalAcceleration(self.model, self.data, self.tool, pin.LOCAL_WORLD_ALIGNED)
        else:
            found = pin.getFrameAcceleration(self.model, self.data, self.tool, pin.LOCAL)
        return np.array(found.vector)


@functools.cache
def _text(name: str) -> str:
    """The catalogue's file with the gripper's joints fixed; each is locked at zero, where fixed is the same."""
    entry = CATALOGUE[name]
    tree = ET.parse(str(metadata.distribution(entry.package).locate_file(entry.file)))
    for joint in tree.getroot().findall("joint"):
        if joint.attrib["name"] in entry.locked:
            assert entry.locked[joint.attrib["name"]] == 0.0
            joint.attrib["type"], joint.attrib["name"] = "fixed", joint.attrib["name"] + "_is_fixed"
    return ET.tostring(tree.getroot(), encoding="unicode")


def catalogue_oracle(name: str, arm: taut.Arm) -> Oracle:
    """The catalogue's file, read by Pinocchio on its own."""
    model = pin.buildModelFromXML(_text(name))
    names = list(model.names)[1:]
    assert sorted(names) == sorted(arm.joint_names)
    order = [arm.joint_names.index(joint) for joint in names]  # Pinocchio takes branches by their names
    model.armature = np.zeros(model.nv)
    return Oracle(model, model.getFrameId(arm.tool, pin.FrameType.BODY), order)


def oracle_of(arm: taut.Arm) -> Oracle:
    """An Arm joint by joint in Pinocchio, with its mounting, gravity, rotors and payload."""
    model = pin.Model()
    ids: dict[int, int] = {BASE: 0}
    order = _branch_by_branch(arm, BASE)
    for i in order:
        joint, body = arm.joints[i], arm.bodies[i]
        slides = joint.kind == "prismatic"
        made = (pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned)(np.array(joint.axis))
        placement = se3(joint.placement)
        if joint.parent == BASE:
            placement = se3(arm.T_WB) * placement
        ids[i] = model.addJoint(ids[joint.parent], made, placement, joint.name)
        inertia = pin.Inertia(body.mass, np.array(body.com), np.array(body.inertia))
        model.appendBodyToJoint(ids[i], inertia, pin.SE3.Identity())
    tool = arm.frame()
    place = se3(arm.T_WB) * se3(tool.placement) if tool.body == BASE else se3(tool.placement)
    at = model.addFrame(pin.Frame("<tool>", ids[tool.body], 0, place, pin.FrameType.BODY))
    model.gravity.linear = np.array(arm.gravity)
    model.armature = np.array(arm.rotor_inertia)[order]
    found = Oracle(model, at, order)
    if arm.payload.mass:
        found.carry(arm.payload)
    return found


def _branch_by_branch(arm: taut.Arm, parent: int) -> list[int]:
    children = [i for i, joint in enumerate(arm.joints) if joint.parent == parent]
    return [k for child in children for k in (child, *_branch_by_branch(arm, child))]


# -------------------------------------------------------------------- arms that are awkward on purpose


def rotation(rng: np.random.Generator) -> Array:
    q = rng.normal(size=4)
    return np.array(taut.Pose(wxyz=q / np.linalg.norm(q)).R)


def random_body(rng: np.random.Generator) -> Body:
    """A possible rigid body: the inertia of three point masses' worth of spread about a random centre."""
    second = np.diag(rng.uniform(0.001, 0.05, 3))
    R = rotation(rng)
    I = R @ (np.trace(second) * np.eye(3) - second) @ R.T
    return Body(mass=rng.uniform(0.2, 5.0), com=rng.uniform(-0.3, 0.3, 3), inertia=0.5 * (I + I.T))


def random_tree(
    rng: np.random.Generator, n: int, *, branches: bool = True, aligned: bool = False, rotors: bool = False
) -> taut.Arm:
    """A random arm: joints of all kinds about any axes, branches, tool and mounting anywhere, gravity any way."""
    joints, bodies = [], []
    for i in range(n):
        axis = rng.normal(size=3)
        if aligned:
            axis = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        parent = BASE if i == 0 else int(rng.integers(-1, i)) if branches else i - 1
        placement = taut.Pose(rng.uniform(-0.4, 0.4, 3), R=rotation(rng))
        if aligned:
            placement = taut.Pose(rng.integers(-1, 2, 3) * 0.3, rpy=rng.integers(-2, 3, 3) * np.pi / 2)
        joints.append(
            Joint(
                name=f"j{i}",
                kind=("revolute", "continuous", "prismatic")[rng.integers(3)],
                parent=parent,
                placement=placement,
                axis=axis / np.linalg.norm(axis),
                rotor_inertia=float(rng.uniform(0.0, 0.3)) if rotors else 0.0,
            )
        )
        bodies.append(random_body(rng))
    tool = Frame(name="tool", body=n - 1, placement=taut.Pose(rng.uniform(-0.2, 0.2, 3), R=rotation(rng)))
    return taut.Arm(
        name="random",
        joints=tuple(joints),
        bodies=tuple(bodies),
        frames=(tool,),
        tool="tool",
        home=np.zeros(n),
        gravity=rng.normal(size=3) * 6.0,
        T_WB=taut.Pose(rng.uniform(-1.0, 1.0, 3), R=rotation(rng)),
        payload=taut.Payload(
            mass=float(rng.uniform(0.1, 3.0)), com=rng.uniform(-0.1, 0.1, 3), inertia=random_body(rng).inertia * 0.1
        ),
    )


def torso(rng: np.random.Generator) -> taut.Arm:
    """Two arms of three joints on a torso that turns; the tool is on the right one."""
    arm = random_tree(rng, 7, branches=False)
    parents = (BASE, 0, 1, 2, 0, 4, 5)
    joints = tuple(dataclasses.replace(j, parent=p) for j, p in zip(arm.joints, parents, strict=True))
    return dataclasses.replace(arm, joints=joints)


def random_state(arm: taut.Arm, rng: np.random.Generator) -> tuple[Array, Array]:
    """A position within the limits, and a velocity."""
    low = np.where(np.isfinite(arm.lower), arm.lower, -3.0)
    high = np.where(np.isfinite(arm.upper), arm.upper, 3.0)
    return rng.uniform(low, high), rng.normal(size=arm.n)


def special_states(arm: taut.Arm, rng: np.random.Generator) -> dict[str, tuple[Array, Array]]:
    """States where formulas that are right elsewhere go wrong: zero, at rest, home, limits, stretched out."""
    q, v = random_state(arm, rng)
    low = np.where(np.isfinite(arm.lower), arm.lower, -np.pi)
    high = np.where(np.isfinite(arm.upper), arm.upper, np.pi)
    zero = np.zeros(arm.n)
    return {
        "random": (q, v),
        "fast": (q, 20.0 * v),
        "at rest": (q, zero),
        "at zero": (zero, v),  # most arms are stretched out and singular here
        "at home": (np.array(arm.home), v),
        "at the lower limits": (low, v),
        "at the upper limits": (high, v),
        "a quarter turn each": (np.full(arm.n, 0.5 * np.pi), v),
        "many turns away": (q + 200.0 * np.pi * (np.array(arm.units) == "rad"), v),
    }
