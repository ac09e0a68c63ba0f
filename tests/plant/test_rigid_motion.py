"""RigidPlant in free motion: against SciPy's integrator of eighth order, and the orders that its own two claim."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plant_laws import Array, accelerations, energy, run
from scipy.integrate import solve_ivp

import taut


def exact(arm: taut.Arm, duration: float, v0: Array, *, friction: bool = False) -> tuple[Array, Array]:
    """q and v at the end of a free swing from home."""
    state = np.concatenate([arm.home, v0])
    done = solve_ivp(accelerations(arm, friction), (0.0, duration), state, method="DOP853", rtol=1e-12, atol=1e-13)
    assert done.success
    return done.y[: arm.n, -1], done.y[arm.n :, -1]


def error(arm: taut.Arm, expected: tuple[Array, Array], duration: float, v0: Array, **options: Any) -> float:
    """Largest difference at the end, of positions and velocities."""
    rate = options.pop("rate", 1000.0)
    out = run(taut.RigidPlant(arm, **options), duration=duration, v0=v0, rate=rate)
    return float(max(np.abs(out.q[-1] - expected[0]).max(), np.abs(out.v[-1] - expected[1]).max()))


SWINGS = {
    # name -> duration [s], largest error of rk4 in steps of 1/16 ms [rad, rad/s]; without friction these arms whirl
    # at 30 to 70 rad/s after a second, and double an error every few hundredths of one
    "one_joint": (3.0, 1e-11),
    "gantry3": (1.0, 1e-11),
    "planar3": (1.0, 1e-8),
    "panda": (1.0, 1e-8),
    "kinova": (0.5, 1e-8),
}


@pytest.mark.part(1)
@pytest.mark.parametrize("name", SWINGS)
def test_a_free_swing_is_what_scipy_says(name: str) -> None:
    duration, most = SWINGS[name]
    arm = taut.load_arm(name).with_payload(0.2, com=[0.0, 0.01, 0.02], inertia=[1e-4, 1e-4, 1e-4, 0, 0, 0])
    v0 = 0.5 * np.random.default_rng(1).normal(size=arm.n)
    expected = exact(arm, duration, v0)
    assert error(arm, expected, duration, v0, friction=None, integrator="rk4", substeps=16) < most


def test_viscous_friction_and_rotor_inertia_are_what_scipy_says() -> None:
    arm = taut.load_arm("planar3").with_joints(viscous=[0.8, 0.5, 0.2], rotor_inertia=[0.3, 0.2, 0.1])
    v0 = np.array([1.0, -2.0, 3.0])
    expected = exact(arm, 1.0, v0, friction=True)
    assert error(arm, expected, 1.0, v0, integrator="rk4") < 1e-9
    # Without friction it would be another motion altogether.
    assert error(arm, expected, 1.0, v0, integrator="rk4", friction=None) > 0.1


class TestTheOrderOfConvergence:
    """Errors fall by 2 and by 16 when the step is halved, whoever halves it: the rate or the sub-steps."""

    @pytest.mark.part(2)
    @pytest.mark.parametrize(("integrator", "order", "within"), [("semi-implicit-euler", 1, 0.1), ("rk4", 4, 0.3)])
    @pytest.mark.parametrize("friction", [None, "arm"])
    def test_by_substeps(self, integrator: str, order: int, within: float, friction: str | None) -> None:
        arm = taut.load_arm("planar3").with_joints(viscous=[0.8, 0.5, 0.2])
        v0 = np.array([1.0, -2.0, 3.0])
        expected = exact(arm, 0.5, v0, friction=friction is not None)
        options: dict[str, Any] = {"integrator": integrator, "friction": friction, "rate": 100.0}
        coarse, fine = (error(arm, expected, 0.5, v0, substeps=s, **options) for s in (8, 16))
        assert np.log2(coarse / fine) == pytest.approx(order, abs=within)

    @pytest.mark.part(1)
    @pytest.mark.parametrize("integrator", ["semi-implicit-euler", "rk4"])
    def test_sub_steps_at_a_lower_rate_are_steps_at_a_higher_one(self, integrator: str) -> None:
        arm = taut.load_arm("panda")
        v0 = 0.3 * np.arange(7.0)
        often, seldom = (
            run(taut.RigidPlant(arm, integrator=integrator, substeps=s), duration=0.2, v0=v0, rate=r)
            for s, r in ((1, 1000.0), (5, 200.0))
        )
        np.testing.assert_allclose(seldom.q, often.q[::5], rtol=0.0, atol=1e-12)

    def test_both_integrators_tend_to_the_same_motion(self) -> None:
        arm = taut.load_arm("panda")
        v0 = np.full(7, 0.5)
        ends = [
            run(taut.RigidPlant(arm, integrator=i, substeps=s), duration=0.1, v0=v0).q[-1]
            for i, s in (("semi-implicit-euler", 50), ("rk4", 1))
        ]
        assert np.abs(ends[0] - ends[1]).max() < 1e-4  # the first order error of 20 us steps


class TestEnergy:
    def test_of_a_free_arm_stays_to_the_order_of_rk4(self) -> None:
        arm = taut.load_arm("panda")
        out = run(taut.RigidPlant(arm, friction=None, integrator="rk4"), duration=5.0, v0=np.full(7, 0.3))
        E = energy(arm, out.q[::50], out.v[::50])
        kinetic = 0.5 * max(v @ taut.snapshot(arm, q).M @ v for q, v in zip(out.q[::50], out.v[::50], strict=True))
        assert np.abs(E - E[0]).max() < 1e-5 * kinetic

    def test_of_a_pendulum_does_not_drift_under_semi_implicit_euler(self) -> None:
        """The method is symplectic for M constant: the error swings with the pendulum and stays bounded."""
        arm = taut.load_arm("one_joint", home=[0.0])
        out = run(taut.RigidPlant(arm, friction=None), duration=60.0)
        swing = 0.981 * 2.0  # [J] m g r, up and down
        first, last = (energy(arm, out.q[part], out.v[part]) for part in (slice(0, 4000, 10), slice(-4000, None, 10)))
        most = np.abs(first - first[0]).max()
        assert np.abs(last - first[0]).max() < 1.05 * most < 0.01 * swing

    def test_grows_by_the_work_of_the_torque(self) -> None:
        arm = taut.load_arm("planar3")
        push = taut.trajectories.Sine(
            center=np.zeros(3), amplitude=[0.5, 0.2, 0.05], frequency=0.5
        )  # a in it is the torque
        out = run(taut.RigidPlant(arm, friction=None, integrator="rk4", substeps=8), push, duration=0.5)
        work = np.cumsum(out.tau[:-1] * np.diff(out.q, axis=0), axis=0).sum(axis=1)
        E = energy(arm, out.q[1::20], out.v[1::20])
        gained = E - energy(arm, out.q[:1], out.v[:1])
        np.testing.assert_allclose(gained, work[::20], rtol=0.0, atol=1e-9)


def test_strong_viscous_friction_is_stable_at_a_millisecond() -> None:
    """xarm7 ships a damping of 10 N m s/rad; taken explicitly it diverges, since dt b is many times the inertia."""
    arm = taut.load_arm("xarm7").with_joints(coulomb=0.0)
    M = taut.snapshot(arm, arm.home).M
    assert 1e-3 * np.max(np.linalg.eigvals(np.linalg.solve(M, np.diag(arm.viscous))).real) > 2.0
    out = run(taut.RigidPlant(arm), duration=1.0, v0=np.full(7, 2.0))
    stiff = solve_ivp(
        accelerations(arm, friction=True),
        (0.0, 1.0),
        np.concatenate([arm.home, np.full(7, 2.0)]),
        method="Radau",
        rtol=1e-9,
        atol=1e-11,
    )
    # The fast modes are gone after a few steps; what is left is the slow sinking, to first order in the step.
    assert np.abs(out.q[-1] - stiff.y[:7, -1]).max() < 2e-3
    assert np.abs(out.v[-1] - stiff.y[7:, -1]).max() < 2e-3


def test_a_payload_that_changes_in_flight_is_felt_at_once() -> None:
    arm = taut.load_arm("gantry3").with_joints(viscous=0.0)
    heavier = [taut.Event(t=0.1, set={"plant.payload.mass": 3.0})]
    hold = taut.JointMotion(q=np.zeros(3), a=[6.0, 0.0, 3.0 * 9.81])  # 6 N along x, the carriage's weight along z
    out = run(taut.RigidPlant(arm), hold, duration=0.2, events=heavier)
    before, after = out.v[100] / 0.1, (out.v[-1] - out.v[100]) / 0.1
    np.testing.assert_allclose(before, [6.0 / 21.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(after, [6.0 / 24.0, 0.0, -3.0 * 9.81 / 6.0], atol=1e-9)
