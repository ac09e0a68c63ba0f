"""Model: the constants of an Arm in the form the dynamics compute with.

Joint axes are rotated onto z, so that a rotation has two unknown numbers, and the part of each body that is symmetric
about its joint axis is moved to the body before it (Khalil's minimal set of inertial parameters). Joint torques stay
exactly the same; on the Panda one operation in seven vanishes.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import BASE, Arm, Payload
from taut.arm.parts import inertia_entries, inertia_matrix
from taut.base.errors import UsageError, unknown_name
from taut.base.types import Array, Float64Array, Matrix, Matrix3, Point3, Vector3
from taut.trace import math as tm
from taut.trace.pose import snapped

Z = np.array([0.0, 0.0, 1.0])
COMPONENTS: Final = ("gravity", "coriolis", "friction")  # torques that a plant may add
REGROUPING_ROUNDING = 1e-14  # relative size under which a regrouped number is rounding


@dataclass(frozen=True, kw_only=True)
class RigidBody:
    """Mass, first and second moment of mass about the origin of the body frame: linear in the mass."""

    m: Any  # [kg]
    h: Vector3  # (3,) m times centre of mass [kg m]
    I: Matrix  # (3, 3) about the origin [kg m^2]

    def __add__(self, other: RigidBody) -> RigidBody:
        return RigidBody(m=self.m + other.m, h=self.h + other.h, I=self.I + other.I)

    def __sub__(self, other: RigidBody) -> RigidBody:
        return RigidBody(m=self.m - other.m, h=self.h - other.h, I=self.I - other.I)

    def seen_from(self, R: Matrix, p: Vector3) -> RigidBody:
        """The same body in the frame in which this one has orientation R and origin p."""
        h = R @ self.h
        # R I R^T - [p] [h] - [h] [p] - m [p] [p], six entries of it: with u = h + m p / 2 the rest is
        # 2 (p . u) 1 - p u^T - u p^T.
        half, rows = (R @ self.I).tolist(), R.tolist()
        P = np.outer(p, h + (0.5 * self.m) * p).tolist()
        I: list[list[Any]] = [[0.0] * 3 for _ in range(3)]
        for i in range(3):
            for j in range(i + 1):
                turned = half[i][0] * rows[j][0] + half[i][1] * rows[j][1] + half[i][2] * rows[j][2]
                moved = 2.0 * (P[i - 1][i - 1] + P[i - 2][i - 2]) if i == j else -(P[i][j] + P[j][i])
                I[i][j] = I[j][i] = turned + moved
        return RigidBody(m=self.m, h=h + self.m * p, I=tm.array(I))


def body_of(parameters: Array) -> RigidBody:
    """The body of ten parameters, see `taut.maths.regressor`."""
    return RigidBody(m=parameters[0], h=parameters[1:4], I=inertia_matrix(parameters[4:]))


@dataclass(frozen=True, kw_only=True)
class PayloadValues:
    """Payload as numbers or symbols; see `taut.Payload` for frames and units."""

    mass: Any
    com: Vector3
    inertia: Array  # (6,) xx, yy, zz, xy, xz, yz
    links: Array | None = None  # (n, 10) what each link carries besides: ten parameters, see `taut.maths.regressor`

    @classmethod
    def of(cls, values: Mapping[str, Any] | Payload) -> PayloadValues:
        """From parameters called mass, com and inertia, or a payload's own."""
        if isinstance(values, Payload):
            values = vars(values)
        return cls(mass=values["mass"], com=values["com"], inertia=values["inertia"], links=values.get("links"))

    @classmethod
    def of_body(cls, body: RigidBody) -> PayloadValues:
        """The payload that a body in the tool frame is; its centre is NaN where its mass is not positive."""
        com = body.h / body.m if body.m > 0.0 else np.full(3, np.nan)
        about = body - cls(mass=body.m, com=com, inertia=np.zeros(6)).body()
        return cls(mass=body.m, com=com, inertia=inertia_entries(about.I))

    def body(self) -> RigidBody:
        S = tm.skew(self.com)
        I = inertia_matrix(self.inertia) - self.mass * (S @ S)
        return RigidBody(m=self.mass, h=self.mass * self.com, I=I)


@dataclass(frozen=True, kw_only=True)
class JointConstants:
    """One joint, with its axis on z."""

    parent: int
    prismatic: bool
    R: Float64Array  # (3, 3) orientation in the parent's body frame at q = 0
    p: Float64Array  # (3,) origin in the parent's body frame at q = 0
    rotor_inertia: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """All constants of an arm's kinematics and dynamics."""

    arm: Arm
    joints: tuple[JointConstants, ...]
    bodies: tuple[RigidBody, ...]  # regrouped
    links: tuple[RigidBody, ...]  # the Arm's own bodies, which give the same torques
    aligned: tuple[Float64Array, ...]  # (3, 3) of each body: orientation of our frame in the Arm's
    R_WB: Float64Array
    p_WB: Float64Array
    gravity_B: Float64Array  # (3,) gravity in the base frame

    @property
    def n(self) -> int:
        return len(self.joints)

    def placement(self, frame: str | None) -> tuple[int, Float64Array, Float64Array]:
        """Body of a frame, and its orientation and origin there."""
        found = self.arm.frame(frame)
        R, p = found.placement.R, found.placement.p
        if found.body == BASE:
            return BASE, snapped(R), p
        A = self.aligned[found.body]
        return found.body, snapped(A.T @ R), A.T @ p


@functools.lru_cache(maxsize=64)
def model_of(arm: Arm) -> Model:
    """The constants of an arm; kept, since a law asks for them at each trace."""
    aligned = tuple(_turn_onto_z(joint.axis) for joint in arm.joints)
    joints, bodies = [], []
    for joint, body, A in zip(arm.joints, arm.bodies, aligned, strict=True):
        before = np.eye(3) if joint.parent == BASE else aligned[joint.parent]
        joints.append(
            JointConstants(
                parent=joint.parent,
                prismatic=joint.kind == "prismatic",
                R=snapped(before.T @ joint.placement.R @ A),
                p=before.T @ joint.placement.p,
                rotor_inertia=joint.rotor_inertia,
            )
        )
        S = tm.skew(body.com)
        I = body.inertia - body.mass * (S @ S)
        bodies.append(RigidBody(m=body.mass, h=A.T @ (body.mass * body.com), I=A.T @ I @ A))
    return Model(
        arm=arm,
        joints=tuple(joints),
        bodies=_regrouped(joints, bodies),
        links=tuple(bodies),
        aligned=aligned,
        R_WB=snapped(arm.T_WB.R),
        p_WB=arm.T_WB.p,
        gravity_B=_rounded(snapped(arm.T_WB.R).T @ arm.gravity),
    )


@functools.lru_cache(maxsize=64)
def links_of(arm: Arm) -> Model:
    """The constants of an arm without its rotors."""
    return model_of(arm.with_joints(rotor_inertia=0.0))


def _turn_onto_z(axis: Float64Array) -> Float64Array:
    """A rotation whose third column is the axis; exact for axes along +-x, +-y, +-z."""
    k = int(np.argmax(np.abs(axis)))
    side = np.zeros(3)
    side[(k + 1) % 3] = 1.0
    x = side - axis * (axis @ side)
    x /= np.linalg.norm(x)
    return snapped(np.column_stack([x, np.cross(axis, x), axis]))


def _regrouped(joints: list[JointConstants], bodies: list[RigidBody]) -> tuple[RigidBody, ...]:
    out = list(bodies)
    for i in range(len(joints) - 1, -1, -1):
        joint, body = joints[i], out[i]
        if joint.prismatic:  # it never turns against its parent: all of I may go there
            moved = RigidBody(m=0.0, h=np.zeros(3), I=body.I)
            seen = RigidBody(m=0.0, h=np.zeros(3), I=joint.R @ body.I @ joint.R.T)
        else:
            Iyy = body.I[1, 1]
            moved = RigidBody(m=body.m, h=body.h[2] * Z, I=np.diag([Iyy, Iyy, 0.0]))
            seen = moved.seen_from(joint.R, joint.p)
        out[i] = RigidBody(m=body.m - moved.m, h=_rounded(body.h - moved.h), I=_rounded(body.I - moved.I))
        if joint.parent != BASE:
            out[joint.parent] = out[joint.parent] + seen
    return tuple(RigidBody(m=b.m, h=_rounded(b.h), I=_rounded(b.I)) for b in out)


def _rounded(x: Float64Array) -> Float64Array:
    """x with entries that are zero but for rounding set to zero."""
    scale = float(np.abs(x).max(initial=0.0))
    return np.where(np.abs(x) <= REGROUPING_ROUNDING * scale, 0.0, x)


@dataclass(frozen=True, kw_only=True, eq=False)
class Link:
    """One joint of a chain, with its axis on z."""

    joint: int
    prismatic: bool
    R: Matrix3  # orientation in the frame before, at q = 0
    p: Point3  # [m]


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """What is between the world and one frame of an arm: plain numbers, which a log can keep."""

    frame: str
    n: int  # joints of the arm, not all of which need be in the chain
    R_WB: Matrix3
    p_WB: Point3  # [m]
    links: tuple[Link, ...]
    R: Matrix3  # of the frame behind the last link
    p: Point3  # [m]

    @classmethod
    def of(cls, model: Model, frame: str | None) -> Chain:
        """The chain to a frame of an arm; to its tool if none is named."""
        body, R, p = model.placement(frame)
        links = []
        while body != BASE:
            joint = model.joints[body]
            links.append(Link(joint=body, prismatic=joint.prismatic, R=joint.R, p=joint.p))
            body = joint.parent
        name = model.arm.frame(frame).name
        return cls(frame=name, n=model.n, R_WB=model.R_WB, p_WB=model.p_WB, links=tuple(reversed(links)), R=R, p=p)

    def poses(self, q: Float64Array) -> tuple[Float64Array, Float64Array]:
        """R (k, 3, 3) and p (k, 3) of the frame in the world, at joint positions (k, n)."""
        return self._walked(q)[0]

    def jacobians(self, q: Float64Array) -> Float64Array:
        """(k, 6, n) Jacobians of the frame, linear part first, world axes: J_WE_W."""
        (_, p), axes = self._walked(q)
        J = np.zeros((len(q), 6, self.n))
        for link, (z, origin) in zip(self.links, axes, strict=True):
            J[:, :3, link.joint] = z if link.prismatic else np.cross(z, p - origin)
            if not link.prismatic:
                J[:, 3:, link.joint] = z
        return J

    def _walked(
        self, q: Float64Array
    ) -> tuple[tuple[Float64Array, Float64Array], list[tuple[Float64Array, Float64Array]]]:
        """The frame, and the axis and origin of each joint on the way, all in the world."""
        R, p = np.broadcast_to(self.R_WB, (len(q), 3, 3)), np.broadcast_to(self.p_WB, (len(q), 3))
        axes = []
        for link in self.links:
            p, R = p + R @ link.p, R @ link.R
            z, x = R[:, :, 2], q[:, link.joint]
            axes.append((z, p))
            if link.prismatic:
                p = p + z * x[:, np.newaxis]
            else:
                R = _turned_about_z(R, x)
        return (R @ self.R, p + R @ self.p), axes


def _turned_about_z(R: Float64Array, angle: Float64Array) -> Float64Array:
    c, s = np.cos(angle)[:, np.newaxis], np.sin(angle)[:, np.newaxis]
    x, y = R[:, :, 0], R[:, :, 1]
    return np.stack([c * x + s * y, c * y - s * x, R[:, :, 2]], axis=2)


@dataclass(frozen=True, kw_only=True)
class Adds:
    """Torques that the plant adds to every command."""

    gravity: bool = False  # of the arm, and of `load` where one is known to it
    coriolis: bool = False  # Coriolis and centripetal torques
    friction: bool = False  # the arm's own
    load: Payload | None = None  # whose gravity the plant adds; None is the controller's own payload

    @classmethod
    def of(cls, given: Adds | Iterable[str] | Mapping[str, Payload | None]) -> Adds:
        """From names such as ("gravity", "coriolis"), or {"gravity": Payload(...)}."""
        if isinstance(given, Adds):
            return given
        if isinstance(given, str):
            raise UsageError(f"adds must be a tuple of names; got {given!r}; write ({given!r},)", name="adds")
        if not isinstance(given, Iterable):  # callers without a type checker
            raise UsageError(f"adds must be a tuple of names such as ('gravity',); got {given!r}", name="adds")
        names = list(given)
        for name in names:
            if name not in COMPONENTS:
                raise unknown_name("what a plant adds", "component", str(name), COMPONENTS)
        load = None
        if isinstance(given, Mapping):
            for name, payload in given.items():
                if payload is None:
                    continue
                if name != "gravity" or not isinstance(payload, Payload):
                    raise UsageError(
                        f"adds[{name!r}] must be None{' or a taut.Payload' * (name == 'gravity')}; got {payload!r}",
                        name="adds",
                    )
                load = payload
        return cls(**dict.fromkeys(names, True), load=load)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for name in COMPONENTS if getattr(self, name))

    def __str__(self) -> str:
        return "{" + ", ".join(self.names) + "}"
