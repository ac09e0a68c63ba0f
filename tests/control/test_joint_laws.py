"""The closed loops that the docstrings of the joint laws state, at random states and in short simulations.

M a + h(q, v) + f(v) = tau gives the acceleration that follows from a law's torque; f is the plant's friction.
"""

from __future__ import annotations

import numpy as np
import pytest

import taut

ROUNDING = 1e-9  # relative to the largest torque
ARMS = {
    "one_joint": taut.load_arm("one_joint"),
    "planar3": taut.load_arm("planar3").with_joints(coulomb=[0.3, 0.2, 0.1]),
    "gantry3": taut.load_arm("gantry3").with_joints(coulomb=[3.0, 2.0, 1.0]),
    "panda": taut.load_arm("panda").with_joints(viscous=0.5, coulomb=0.3),
}
UPRIGHT, HANGING = 0.5 * np.pi, -0.5 * np.pi
M, MGR, B = 0.5, 0.981, 0.1  # the chapter's link


class At:
    """A random state and wanted motion, and what a law makes of them."""

    def __init__(
        self, arm: taut.Arm, law: taut.Law, seed: int, *, at_rest: bool = False, friction: bool = True
    ) -> None:
        rng = np.random.default_rng(seed)
        self.arm, self.law, n = arm, law, arm.n
        self.q, self.v = arm.home + 0.3 * rng.standard_normal(n), 0.5 * rng.standard_normal(n)
        q_des, v_des, a_des = arm.home + 0.3 * rng.standard_normal(n), *rng.standard_normal((2, n))
        self.q_des, self.v_des, self.a_des = q_des, v_des * (not at_rest), a_des * (not at_rest)
        ref = taut.JointMotion(q=self.q_des, v=self.v_des, a=self.a_des)
        self.tau = taut.compile(law, arm, engine="float").step(self.q, self.v, ref)
        self.x = taut.snapshot(arm, q=self.q, v=self.v)
        self.wanted = taut.snapshot(arm, q=self.q_des, v=self.v_des)
        self.f = (arm.viscous * self.v + arm.coulomb * np.sign(self.v)) * friction
        self.a = np.linalg.solve(self.x.M, self.tau - self.x.h - self.f)
        self.e, self.e_dot, self.e_ddot = self.q_des - self.q, self.v_des - self.v, self.a_des - self.a

    def same(self, left: np.ndarray, right: np.ndarray) -> None:
        np.testing.assert_allclose(left, right, atol=ROUNDING * np.abs(self.tau).max(), rtol=0.0)


@pytest.fixture(params=list(ARMS))
def arm(request: pytest.FixtureRequest) -> taut.Arm:
    return ARMS[request.param]


@pytest.mark.parametrize("seed", range(3))
class TestTheStatedLoop:
    def test_of_pid_along_a_motion_of_one_joint(self, seed: int) -> None:
        at = At(ARMS["one_joint"], taut.laws.PID(kp=3.0, kd=2.0), seed)
        disturbance = at.x.g + M * at.a_des + B * at.v_des
        at.same(M * at.e_ddot + (B + 2.0) * at.e_dot + 3.0 * at.e, disturbance)

    def test_of_feedforward(self, arm: taut.Arm, seed: int) -> None:
        at = At(arm, taut.laws.FeedForward(), seed)
        right = (at.x.M - at.wanted.M) @ at.a_des + at.x.h - at.wanted.h + at.f
        at.same(at.x.M @ at.e_ddot, right)

    def test_of_feedforward_near_the_motion(self, arm: taut.Arm, seed: int) -> None:
        rng, at = np.random.default_rng(seed), At(arm, taut.laws.FeedForward(), seed)
        e, e_dot = 1e-6 * rng.standard_normal((2, arm.n))

        def needed(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            x = taut.snapshot(arm, q=q, v=v)
            return x.M @ at.a_des + x.h

        # d(M a_des + h)/dq e and (dh/dv) e_dot as central differences along e and e_dot.
        stiffness = 0.5 * (needed(at.q_des + e, at.v_des) - needed(at.q_des - e, at.v_des))
        damping = 0.5 * (needed(at.q_des, at.v_des + e_dot) - needed(at.q_des, at.v_des - e_dot))
        x = taut.snapshot(arm, q=at.q_des - e, v=at.v_des - e_dot)
        e_ddot = at.a_des - np.linalg.solve(x.M, at.tau - x.h)
        np.testing.assert_allclose(x.M @ e_ddot + damping + stiffness, 0.0, atol=1e-9)

    def test_of_computed_torque(self, arm: taut.Arm, seed: int) -> None:
        law = taut.laws.ComputedTorque(kp=30.0, kd=7.0)
        at, free = At(arm, law, seed), At(arm, law, seed, friction=False)
        at.same(at.x.M @ (at.e_ddot + 7.0 * at.e_dot + 30.0 * at.e), at.f)
        free.same(free.e_ddot + 7.0 * free.e_dot + 30.0 * free.e, np.zeros(arm.n))

    def test_of_computed_torque_with_friction_compensation(self, arm: taut.Arm, seed: int) -> None:
        for where in ("meas", "ref"):
            law = taut.laws.ComputedTorque(kp=30.0, kd=7.0) + taut.laws.FrictionCompensation(at=where, width=1e-6)
            at = At(arm, law, seed)
            left = arm.coulomb * (np.sign(at.v) - np.sign(at.v if where == "meas" else at.v_des))
            left -= 0.0 if where == "meas" else arm.viscous * at.e_dot
            at.same(at.x.M @ (at.e_ddot + 7.0 * at.e_dot + 30.0 * at.e), left)

    def test_of_gravity_pid_at_a_set_point(self, arm: taut.Arm, seed: int) -> None:
        at = At(arm, taut.laws.GravityPID(kp=30.0, kd=7.0), seed, at_rest=True)
        at.same(at.x.M @ at.a + at.x.Cv, 30.0 * at.e - 7.0 * at.v - at.f)
        # V = e . kp e / 2 + v . M v / 2; M-dot = C + C^T for the Christoffel matrix.
        power = -30.0 * at.e @ at.v + at.v @ at.x.M @ at.a + at.v @ at.x.C @ at.v
        assert power == pytest.approx(-at.v @ (7.0 * at.v + at.f), rel=1e-6)

    def test_of_gravity_compensation(self, arm: taut.Arm, seed: int) -> None:
        at = At(arm, taut.laws.GravityCompensation(kd=2.0), seed)
        at.same(at.x.M @ at.a + at.x.Cv + 2.0 * at.v + at.f, np.zeros(arm.n))


@pytest.mark.parametrize("friction", [None, "arm"])
def test_feedforward_alone_grows_an_error_upright_and_swings_hanging(friction: None) -> None:
    """Near a set-point M s^2 + b s + dg/dq = 0: roots +-sqrt(m g r / M) upright, without friction."""
    arm, dt = taut.load_arm("one_joint"), 1e-4
    ctrl = taut.compile(taut.laws.FeedForward(), arm, rate=1.0 / dt)
    plant = taut.RigidPlant(arm, friction=friction)
    for at, stiffness in ((UPRIGHT, -MGR), (HANGING, MGR)):
        run = taut.run(ctrl, plant, taut.JointMotion(q=[at]), duration=4.0, q0=[at - 1e-3])
        s = np.roots([M, B if friction else 0.0, stiffness])
        c = np.linalg.solve([[1.0, 1.0], s], [1e-3, 0.0])
        expected = (np.exp(np.outer(run.t, s)) @ c).real
        # The sine of gravity and the tick bring 1 % at most over these four seconds.
        np.testing.assert_allclose(run.error[:, 0], expected, atol=0.01 * np.abs(expected).max())
    if friction is None:
        upright = taut.run(ctrl, plant, taut.JointMotion(q=[UPRIGHT]), duration=4.0, q0=[UPRIGHT - 1e-3])
        assert upright.error[-1, 0] == pytest.approx(0.136, abs=2e-3)


def test_dry_friction_leaves_gravity_pid_short_of_the_goal_by_its_share_of_the_spring() -> None:
    arm = taut.load_arm("one_joint").with_joints(coulomb=0.2, viscous=0.0)
    ctrl = taut.compile(taut.laws.GravityPID(kp=4.0, kd=1.0), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.0]), duration=20.0, q0=[0.6])
    assert np.abs(run.v[-1000:]).max() < 1e-12
    assert 0.0 < abs(run.error[-1, 0]) <= 0.2 / 4.0 * (1.0 + 1e-9)


@pytest.mark.parametrize("name", ["PID", "GravityPID", "GravityCompensation", "ComputedTorque", "VelocityPI"])
def test_gains_have_a_unit_for_joints_that_turn_and_one_for_those_that_slide(name: str) -> None:
    """As everywhere, what holds for hinges comes first: [rad | m], [N m | N]."""
    declared = getattr(taut.laws, name).declared
    for gain, unit in {name: field.unit for name, field in declared.items() if isinstance(field, taut.Gain)}.items():
        turn, _, slide = unit.partition(" | ")
        expected = turn.replace("N m", "N").replace("rad", "m")
        assert slide == ("" if expected == turn else expected), (name, gain)


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["ur10", "kinova"])
@pytest.mark.parametrize(("share", "stable"), [(0.97, True), (1.03, False)])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_the_damping_of_gravity_pid_is_held_over_a_tick_and_diverges_on_light_joints(
    name: str, share: float, stable: bool
) -> None:
    """Above 2 for an eigenvalue of M^-1 kd dt: kd = 1.05 N m s/rad on a UR10 without rotors at 1 kHz."""
    arm = taut.load_arm(name)
    light = np.linalg.eigvalsh(taut.snapshot(arm, arm.home).M).min()
    ctrl = taut.compile(taut.laws.GravityPID(kp=1e-3, kd=share * 2.0 * light / 1e-3), arm)
    plant, v0 = taut.RigidPlant(arm, friction=None), np.full(arm.n, 1e-4)
    out = taut.run(ctrl, plant, taut.JointMotion(q=arm.home), duration=0.5, v0=v0)
    assert (np.abs(out.v[-1]).max() < 1e-4) == stable
