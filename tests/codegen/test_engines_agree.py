"""Every law on every arm: native code gives what plain Python gives, and what the same law gives on Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import taut
from taut.arm.catalogue import CATALOGUE
from taut.arm.parts import BASE
from taut.base.types import Float64Array

NATIVE = 1e-12  # relative to the largest torque or term: the bar for targets against the float run
PINOCCHIO = 1e-10  # relative to the largest torque: the bar against the law written on Pinocchio
NAMES = ("one_joint", "planar2", "planar3", "gantry3", *CATALOGUE)
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


def states(arm: taut.Arm) -> list[tuple[Float64Array, Float64Array, taut.JointMotion]]:
    """Positions, velocities and references: random, at rest, stretched out, folded up, far away."""
    rng = np.random.default_rng(0)
    low = np.where(np.isfinite(arm.lower), arm.lower, -np.pi)
    high = np.where(np.isfinite(arm.upper), arm.upper, np.pi)
    zero, far = np.zeros(arm.n), 200.0 * np.pi * (np.array(arm.units) == "rad")
    positions = [
        rng.uniform(low, high),
        rng.uniform(low, high),
        zero,
        low,
        high,
        np.full(arm.n, np.pi / 2),
        far,
        arm.home,
    ]
    speeds = [rng.standard_normal(arm.n) for _ in positions]
    speeds[2], speeds[3] = zero, 20.0 * speeds[3]
    return [
        (q, v, taut.JointMotion(q=q + 0.1 * rng.standard_normal(arm.n), v=rng.standard_normal(arm.n), a=speeds[k]))
        for k, (q, v) in enumerate(zip(positions, speeds, strict=True))
    ]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", NAMES)
def test_native_code_agrees_with_plain_python(name: str, law: str) -> None:
    arm = loaded(name)
    torque = law != "VelocityPI"
    even = (NAMES.index(name) + list(LAWS).index(law)) % 2 == 0  # half of the matrix one way, half the other
    options: dict[str, Any] = {
        "limits": taut.Limits(tau=30.0, tau_dot=np.linspace(2e4, 4e4, arm.n)) if torque and even else None,
        "sensing": taut.Sensing(velocity="measured" if even else "difference"),
    }
    native, plain = (taut.compile(LAWS[law](arm.n), arm, engine=e, **options) for e in ("native", "float"))  # type: ignore[arg-type]
    for q, v, ref in states(arm):
        measured = (q, v, ref) if even else (q, ref)
        wanted, got = plain.step(*measured), native.step(*measured)
        wanted_terms, got_terms = plain.terms, native.terms
        scale = max(1.0, *(np.abs(term).max() for term in wanted_terms.values()))
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=NATIVE * scale)
        assert list(got_terms) == list(wanted_terms)
        for term, value in wanted_terms.items():
            np.testing.assert_allclose(got_terms[term], value, rtol=0.0, atol=NATIVE * scale)
        np.testing.assert_allclose(sum(got_terms.values()), got, rtol=0.0, atol=NATIVE * scale)


# -------------------------------------------------------------------- the same laws on Pinocchio


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


@pytest.mark.parametrize("law", PI_LAWS)
@pytest.mark.parametrize("name", NAMES)
def test_the_law_written_on_pinocchio_gives_the_same_torques(name: str, law: str) -> None:
    arm, (ours, theirs) = loaded(name), PI_LAWS[law]
    ctrl, oracle = taut.compile(ours, arm), OnPinocchio(arm)
    e_int = np.zeros(arm.n)
    turns = np.array([i in arm.continuous for i in range(arm.n)])
    for q, v, ref in states(arm):
        e = ref.q - q
        e = np.where(turns, (e + np.pi) % (2.0 * np.pi) - np.pi, e)
        e_int = e_int + e * ctrl.dt
        wanted = theirs(oracle, q, v, ref, e, e_int)
        got = ctrl.step(q, v, ref)
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=PINOCCHIO * np.abs(wanted).max())
