"""Virtual walls, grooves and balls: forces that are gradients, borders without jumps, passivity of sampled ones."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.control.law import Law
from taut.maths.model import model_of
from taut.maths.snapshot import Snapshot

PANDA = taut.load_arm("panda")
TIP = taut.snapshot(PANDA, PANDA.home).T().p
RATE = 1000.0

WALL_AT, GROOVE_AT = TIP + np.array([0.0, 0.0, 0.01]), TIP + np.array([0.01, 0.0, 0.02])
BALL_AT, BOWL_AT = TIP + np.array([0.02, 0.01, 0.0]), TIP + np.array([0.1, 0.05, 0.0])


def made(name: str, B: float = 0.0) -> Law:
    if name == "wall":
        return taut.laws.VirtualWall(point=WALL_AT, normal=[0.2, -0.1, 2.0], K=900.0, B=B)
    if name == "groove":
        return taut.laws.VirtualGroove(point=GROOVE_AT, direction=[1.0, 2.0, 0.5], K=900.0, B=B)
    if name == "ball":
        return taut.laws.VirtualBall(center=BALL_AT, radius=0.1, K=900.0, B=B)
    return taut.laws.VirtualBall(center=BOWL_AT, radius=0.05, K=900.0, B=B, inside=True)


OBJECTS = {name: made(name) for name in ("wall", "groove", "ball", "bowl")}


def torque(law: Law, q: np.ndarray, v: np.ndarray | None = None, arm: taut.Arm = PANDA) -> np.ndarray:
    ctrl = taut.compile(law, arm, engine="float")
    return np.asarray(ctrl.step(q, np.zeros(arm.n) if v is None else v, taut.JointMotion(q=q)))


def force(law: Law, q: np.ndarray, v: np.ndarray | None = None) -> np.ndarray:
    """(3,) at the tool, from the torque: J is regular here."""
    return np.asarray(np.linalg.pinv(taut.snapshot(PANDA, q).J().T) @ torque(law, q, v))[:3]


def push_out(name: str, p: np.ndarray) -> np.ndarray:
    """(3,) the force of the spring, in closed form."""
    if name == "wall":
        n = np.array([0.2, -0.1, 2.0]) / np.linalg.norm([0.2, -0.1, 2.0])
        return 900.0 * max(0.0, float(n @ (WALL_AT - p))) * n
    if name == "groove":
        u = np.array([1.0, 2.0, 0.5]) / np.linalg.norm([1.0, 2.0, 0.5])
        r = p - GROOVE_AT
        return np.asarray(-900.0 * (r - u * (u @ r)))
    center, radius = (BALL_AT, 0.1) if name == "ball" else (BOWL_AT, 0.05)
    r = p - center
    far = float(np.linalg.norm(r))
    depth = max(0.0, radius - far) if name == "ball" else -max(0.0, far - radius)
    return np.asarray(900.0 * depth * r / far)


@pytest.mark.parametrize("name", list(OBJECTS))
class TestTheForce:
    @pytest.mark.parametrize("seed", range(3))
    def test_is_that_of_its_formula_at_the_tools_origin(self, name: str, seed: int) -> None:
        q = PANDA.home + 0.03 * np.random.default_rng(seed).standard_normal(7)
        x = taut.snapshot(PANDA, q)
        expected = x.J()[:3].T @ push_out(name, x.T().p)
        np.testing.assert_allclose(torque(OBJECTS[name], q), expected, atol=1e-9)

    def test_does_no_work_along_a_closed_path(self, name: str) -> None:
        """A closed path of the joints through inside and outside: the integral of tau . dq, by the trapezoidal rule."""
        law = taut.native(_torque_of(OBJECTS[name]), q=7)
        rng = np.random.default_rng(5)
        a, b = 0.08 * rng.standard_normal((2, 7))
        s = np.linspace(0.0, 2.0 * math.pi, 20_001)[:-1]
        q = PANDA.home + np.outer(np.sin(s), a) + np.outer(np.cos(s) - 1.0, b)
        dq = (np.outer(np.cos(s), a) - np.outer(np.sin(s), b)) * (s[1] - s[0])
        power = np.array([law(each) for each in q]) * dq
        assert abs(power.sum()) < 1e-5 * np.abs(power).sum()
        assert np.abs(power).sum() > 0.05

    def test_has_a_damper_that_takes_power_and_never_more_than_its_direction_allows(self, name: str) -> None:
        damped = made(name, B=40.0)
        rng = np.random.default_rng(6)
        for _ in range(20):
            q, v = PANDA.home + 0.03 * rng.standard_normal(7), 0.3 * rng.standard_normal(7)
            more = torque(damped, q, v) - torque(OBJECTS[name], q, v)
            assert more @ v <= 1e-12
            if name in ("wall", "ball", "bowl"):
                total, plain = force(damped, q, v), push_out(name, taut.snapshot(PANDA, q).T().p)
                assert total @ plain >= -1e-9


def _torque_of(law: Law) -> Any:
    def of(q: Any) -> Any:
        x = Snapshot(model_of(PANDA), q=q, v=np.zeros(7))
        return law.command(x, taut.JointMotion(q=PANDA.home)).total  # type: ignore[attr-defined]

    return of


class TestTheBorder:
    def test_has_no_jump_in_force_and_none_in_damping(self) -> None:
        """Steps of 1e-9 m across it change the force by no more than K and B / fade times the step allow."""
        arm = taut.load_arm("gantry3")
        wall = taut.laws.VirtualWall(point=[0.0, 0.0, -0.2], normal=[0, 0, 1], K=2000.0, B=300.0, fade=2e-3)
        tip = taut.snapshot(arm, np.zeros(3)).T().p[2]
        z = np.linspace(-1e-8, 1e-8, 21) + (-0.2 - tip)
        down = np.array([0.0, 0.0, -0.5])
        forces = np.array([torque(wall, np.array([0.0, 0.0, each]), down, arm)[2] for each in z])
        assert np.abs(np.diff(forces)).max() <= (2000.0 + 300.0 * 0.5 / 2e-3) * 1e-9 * 1.01
        assert forces[-1] == 0.0 < forces[0]

    def test_of_a_wall_never_pulls_what_leaves_it(self) -> None:
        arm = taut.load_arm("gantry3")
        wall = taut.laws.VirtualWall(point=[0.0, 0.0, 0.0], normal=[0, 0, 1], K=100.0, B=500.0)
        for z in (-0.25, -0.1, -0.01):
            assert torque(wall, np.array([0.0, 0.0, z]), np.array([0.0, 0.0, 2.0]), arm)[2] == 0.0


class TestAddedToOthers:
    def test_to_gravity_compensation_and_to_laws_of_joints_and_of_the_task(self) -> None:
        wall = OBJECTS["wall"]
        for law in (
            taut.laws.GravityCompensation(),
            taut.laws.PID(kp=1.0),
            taut.laws.Impedance(K=(500.0, 50.0), zeta=0.7),
        ):
            ctrl = taut.compile(law + wall, PANDA)
            assert {"wall", "wall_damping"} <= set(ctrl.side.probe.terms)
            assert "law.VirtualWall.K" in ctrl.parameters

    def test_its_numbers_change_in_the_run(self) -> None:
        ctrl = taut.compile(taut.laws.GravityCompensation() + OBJECTS["wall"], PANDA)
        ref = taut.JointMotion(q=PANDA.home)
        ctrl.step(PANDA.home, np.zeros(7), ref)
        first = ctrl.terms["wall"].copy()
        ctrl.parameters["law.VirtualWall.K"] = 1800.0
        ctrl.step(PANDA.home, np.zeros(7), ref)
        np.testing.assert_allclose(ctrl.terms["wall"], 2.0 * first, rtol=1e-12)
        with refused(taut.errors.RangeError):
            ctrl.parameters["law.VirtualWall.normal"] = [0.0, 0.0, 0.0]

    def test_a_hand_slides_along_a_groove_and_not_out_of_it(self) -> None:
        arm = PANDA.with_joints(viscous=1.0, coulomb=0.0)
        groove = taut.laws.VirtualGroove(point=TIP, direction=[0.0, 1.0, 0.0], K=3000.0, B=30.0)
        law = taut.laws.GravityCompensation(kd=1.0) + groove
        push = taut.environments.Push(peak=[10.0, 10.0, 0.0], t=0.0, duration=0.8)
        run = taut.run(taut.compile(law, arm), taut.RigidPlant(arm, environment=push), duration=0.8)
        way = taut.snapshot(arm, run.q[-1]).T().p - TIP
        assert abs(way[1]) > 0.03
        assert np.hypot(way[0], way[2]) < 0.01


# -------------------------------------------------------------------- sampled walls, and energy


ARMS: dict[str, taut.Arm] = {
    "gantry3": taut.load_arm("gantry3").with_joints(viscous=2.0),
    "panda": PANDA.with_joints(viscous=4.0, coulomb=0.0),
    "ur10": taut.load_arm("ur10").with_joints(viscous=2.0, coulomb=0.0),
}


def damping_at_the_tip(arm: taut.Arm) -> float:
    """[N s/m] of the joints' friction, along z: the least that a motion of the tip in z has."""
    J = taut.snapshot(arm, arm.home).J()[2]
    return float(1.0 / (J @ np.diag(1.0 / arm.viscous) @ J))


def most_energy(arm: taut.Arm, K: float, B: float) -> float:
    """[J] most that an arm has had more than at first, less what a push did on it, when it is thrown at a wall.

    Ten steps of the plant in a tick: a sampled wall gains its energy while its force is held.
    """
    x, model = taut.snapshot(arm, arm.home), model_of(arm)
    J = x.J()[2]
    thrown = -np.linalg.solve(x.M, J)
    wall = taut.laws.VirtualWall(point=x.T().p - np.array([0, 0, 1e-3]), normal=[0, 0, 1], K=K, B=B)
    ctrl = taut.compile(taut.laws.GravityCompensation() + wall, arm, rate=RATE)
    plant = taut.RigidPlant(
        arm, substeps=10, environment=taut.environments.Push(peak=[0.0, 0.0, -5.0], t=0.0, duration=1.0)
    )
    run = taut.run(ctrl, plant, duration=1.5, v0=0.2 * thrown / abs(J @ thrown))
    assert run.outcome.ok
    kinetic = taut.native(lambda q, v: taut.math.array([taut.dynamics.kinetic_energy(model, q, v)]), q=arm.n, v=arm.n)
    had = np.array([kinetic(q, v)[0] for q, v in zip(run.q, run.v, strict=True)])
    return float((had - run.extra["work.environment"]).max() - had[0])


@pytest.mark.parametrize("name", list(ARMS))
class TestASampledWall:
    @pytest.mark.parametrize("share", [0.0, 0.5])
    def test_never_gives_back_more_than_it_got_within_colgates_bound(self, name: str, share: float) -> None:
        """b = K T / 2 + B exactly, with a share of b for B."""
        b = damping_at_the_tip(ARMS[name])
        assert most_energy(ARMS[name], K=2.0 * RATE * b * (1.0 - share), B=share * b) <= 1e-6


@pytest.mark.parametrize("name", ["gantry3", "panda"])  # friction along the UR10's other joints takes what it gains
def test_a_wall_of_ten_times_that_stiffness_throws_the_arm_back_faster_than_it_came(name: str) -> None:
    b = damping_at_the_tip(ARMS[name])
    assert most_energy(ARMS[name], K=20.0 * RATE * b, B=0.0) > 1e-3
