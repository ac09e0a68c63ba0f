"""Every kind of law, on every arm with something to carry, and the same laws on Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

import taut
from taut.arm.catalogue import CATALOGUE
from taut.arm.parts import BASE
from taut.base.types import Float64Array

NATIVE = 1e-12  # relative to the largest torque or term: the bar for targets against the float run
PINOCCHIO = 1e-10  # relative to the largest torque: the bar against the law written on Pinocchio
TWO_ARMS = "baxter"  # 14 joints, whose dynamics are tested by themselves: here it would cost more than all others
NAMES = ("one_joint", "planar2", "planar3", "gantry3", *(name for name in CATALOGUE if name != TWO_ARMS))
L = taut.laws


def spd(n: int, seed: int) -> Float64Array:
    root = np.random.default_rng(seed).standard_normal((n, n))
    return root @ root.T / n + np.eye(n)


LAWS: dict[str, Callable[[int], taut.Law]] = {
    "PID": lambda n: L.PID(kp=spd(n, 1), kd=np.linspace(1.0, 2.0, n), ki=3.0),
    "FeedForward": lambda n: L.FeedForward(),
    "ComputedTorque": lambda n: L.ComputedTorque(kp=100.0 * spd(n, 2), kd=20.0, ki=np.full(n, 5.0)),
    "GravityPID": lambda n: L.GravityPID(kp=np.linspace(10.0, 20.0, n), kd=spd(n, 3), ki=1.0),
    "GravityCompensation": lambda n: L.GravityCompensation(kd=0.5),
    "FrictionCompensation": lambda n: L.FrictionCompensation(at="meas"),
    "VelocityPI": lambda n: L.VelocityPI(kp=spd(n, 4), ki=2.0),
    "PID + Dither": lambda n: (
        L.PID(
            kp=10.0, kd=1.0, ki=spd(n, 6), integral=taut.laws.Integral(anti_windup="back-calculation", tracking=10.0)
        )
        + L.Dither(amplitude=np.linspace(0.1, 0.2, n), frequency=130.0)
    ),
    "RaisedGains of ComputedTorque": lambda n: L.RaisedGains(
        inner=L.ComputedTorque(kp=spd(n, 7), kd=20.0, ki=np.full(n, 5.0)), factor=4.0, width=np.full(n, 0.5)
    ),
    "FeedForward + PID": lambda n: L.FeedForward() + L.PID(kp=10.0, kd=spd(n, 5)),
    "ComputedTorque + FrictionCompensation": lambda n: (
        L.ComputedTorque(kp=100.0, kd=20.0) + L.FrictionCompensation(at="ref")
    ),
}


def loaded(name: str) -> taut.Arm:
    """An arm that carries something, has friction, and stands askew."""
    arm = taut.load_arm(name, T_WB=taut.Pose(p=[0.1, 0.2, 0.3], rpy=[0.2, -0.1, 0.5]))
    return arm.with_payload(1.3, com=[0.01, -0.02, 0.05], inertia=np.diag([0.002, 0.003, 0.004])).with_joints(
        viscous=np.full(arm.n, 0.3), coulomb=np.full(arm.n, 0.2)
    )


class OnPinocchio:
    """An arm in Pinocchio, joint by joint."""

    def __init__(self, arm: taut.Arm) -> None:
        self.model = pin.Model()
        ids = {BASE: 0}
        for i, (joint, body) in enumerate(zip(arm.joints, arm.bodies, strict=True)):
            slides = joint.kind == "prismatic"
            made = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
            placement = self._se3(joint.placement)
            if joint.parent == BASE:
                placement = self._se3(arm.T_WB) * placement
            ids[i] = self.model.addJoint(ids[joint.parent], made(np.array(joint.axis)), placement, joint.name)
            inertia = pin.Inertia(body.mass, np.array(body.com), np.array(body.inertia))
            self.model.appendBodyToJoint(ids[i], inertia, pin.SE3.Identity())
        tool, load = arm.frame(), arm.payload
        xx, yy, zz, xy, xz, yz = load.inertia
        I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        carried = pin.Inertia(load.mass, np.array(load.com), I)
        self.model.appendBodyToJoint(ids[tool.body], carried, self._se3(tool.placement))
        self.model.gravity.linear = np.array(arm.gravity)
        self.model.armature = np.array(arm.rotor_inertia)
        self.data = self.model.createData()

    @staticmethod
    def _se3(pose: taut.Pose) -> Any:
        return pin.SE3(np.array(pose.R), np.array(pose.p))

    def M(self, q: Float64Array) -> Float64Array:
        return np.array(pin.crba(self.model, self.data, q)).reshape(len(q), len(q))

    def h(self, q: Float64Array, v: Float64Array) -> Float64Array:
        return np.array(pin.nonLinearEffects(self.model, self.data, q, v))

    def g(self, q: Float64Array) -> Float64Array:
        return np.array(pin.computeGeneralizedGravity(self.model, self.data, q))


PI_LAWS: dict[str, tuple[taut.Law, Callable[..., Float64Array]]] = {
    "computed torque": (
        L.ComputedTorque(kp=100.0, kd=20.0, ki=7.0),
        lambda p, q, v, r, e, e_int: p.M(q) @ (r.a + 100.0 * e + 20.0 * (r.v - v) + 7.0 * e_int) + p.h(q, v),
    ),
    "feedforward": (L.FeedForward(), lambda p, q, v, r, e, e_int: p.M(r.q) @ r.a + p.h(r.q, r.v)),
    "GravityPID": (
        L.GravityPID(kp=50.0, kd=5.0, ki=3.0),
        lambda p, q, v, r, e, e_int: 50.0 * e + 5.0 * (r.v - v) + 3.0 * e_int + p.g(q),
    ),
}
