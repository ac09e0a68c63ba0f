"""Dry friction in motion: what should stick sticks for good, what should slip slips, and energy is never made."""

from __future__ import annotations

import numpy as np
import pytest
from plant_laws import Array, TorqueOf, energy, run

import taut

CREEP = 1e-9  # [rad] in ten seconds


def loaded_to(arm: taut.Arm, share: float, q: Array) -> taut.Arm:
    """The arm with dry friction of which its own weight at q takes this share; at least 1 N m."""
    g = np.abs(taut.snapshot(arm, q).g)
    return arm.with_joints(viscous=0.0, coulomb=np.maximum(g / share, 1.0))


def creep(arm: taut.Arm, q: Array, duration: float = 10.0, **options: int) -> Array:
    out = run(taut.RigidPlant(arm, **options), duration=duration, q0=q)
    return np.abs(out.q - out.q[0]).max(axis=0)


class TestALoadedLink:
    @pytest.mark.parametrize("share", [0.49, 0.99])
    @pytest.mark.parametrize("substeps", [1, 4])
    def test_stays_for_ten_seconds(self, share: float, substeps: int) -> None:
        q = np.array([0.3])
        arm = taut.load_arm("one_joint").with_joints(viscous=0.0, coulomb=9.81 * 0.1 * np.cos(0.3) / share)
        assert creep(arm, q, substeps=substeps) < CREEP

    def test_slips_when_it_is_loaded_beyond_its_limit_and_stops_where_it_can_be_held(self) -> None:
        arm = taut.load_arm("one_joint").with_joints(viscous=0.0, coulomb=9.81 * 0.1 * np.cos(0.3) / 1.01)
        out = run(taut.RigidPlant(arm), duration=10.0, q0=[0.3])
        assert out.q[-1, 0] < 0.25
        assert out.v[-1, 0] == pytest.approx(0.0, abs=1e-15)  # after some way down it is held again
        assert abs(out.q[-1, 0] - out.q[-1000, 0]) < CREEP

    def test_slips_with_the_acceleration_that_is_left(self) -> None:
        """M a = push - mu, at once and from rest."""
        arm = taut.load_arm("one_joint", gravity=[0.0, 0.0, 0.0]).with_joints(viscous=0.0, coulomb=2.0)
        out = run(taut.RigidPlant(arm), taut.JointMotion(q=[0.0], a=[3.0]), duration=0.5)
        np.testing.assert_allclose(out.v[:, 0], 2.0 * out.t, rtol=0.0, atol=1e-12)

    def test_stops_when_its_speed_is_used_up_and_stays(self) -> None:
        """Sliding to rest takes M v0 / mu seconds; the tick in which it stops is exact."""
        arm = taut.load_arm("one_joint", gravity=[0.0, 0.0, 0.0]).with_joints(viscous=0.0, coulomb=0.5)
        out = run(taut.RigidPlant(arm), duration=2.0, v0=[0.8005])
        moving = np.maximum(0.8005 - out.t, 0.0)
        np.testing.assert_allclose(out.v[:, 0], moving, rtol=0.0, atol=1e-12)
        assert np.abs(out.v[802:]).max() < 1e-30

    def test_does_not_chatter_under_a_push_that_turns_round_within_its_limit(self) -> None:
        arm = taut.load_arm("one_joint", gravity=[0.0, 0.0, 0.0]).with_joints(coulomb=1.0)
        out = run(
            taut.RigidPlant(arm), taut.trajectories.Sine(center=[0.0], amplitude=0.02, frequency=1.0), duration=2.0
        )
        assert 0.7 < np.abs(out.tau).max() < 1.0
        assert not np.abs(out.q).max() > CREEP


class TestACoupledArm:
    @pytest.mark.part(2)
    @pytest.mark.parametrize("name", ["planar3", "ur10", "panda"])
    @pytest.mark.parametrize("share", [0.49, 0.99])
    def test_stays_from_the_first_tick_on(self, name: str, share: float) -> None:
        arm = taut.load_arm(name)
        q = np.array(arm.home)
        assert creep(loaded_to(arm, share, q), q, duration=3.0).max() < CREEP

    def test_falls_when_one_joint_cannot_hold(self) -> None:
        arm = taut.load_arm("ur10")
        q = np.array(arm.home)
        held = loaded_to(arm, 0.9, q)
        weak = held.with_joints(coulomb={"shoulder_lift_joint": abs(taut.snapshot(arm, q).g[1]) / 1.05})
        assert creep(weak, q, duration=1.0)[1] > 0.01

    def test_what_sticks_stays_while_another_joint_moves(self) -> None:
        """The torque that the moving joint puts on the stuck ones changes all the time; ten sweeps a tick follow it."""
        arm = taut.load_arm("planar3", gravity=[0.0, 0.0, 0.0]).with_joints(coulomb=[0.5, 200.0, 200.0])
        push = taut.trajectories.Sine(center=np.zeros(3), amplitude=[1.0, 0.0, 0.0], frequency=0.5)
        out = run(taut.RigidPlant(arm), push, duration=3.0)
        moved = np.ptp(out.q, axis=0)
        assert moved[0] > 1.0
        assert moved[1:].max() < 1e-6

    @pytest.mark.part(1)
    @pytest.mark.parametrize("seed", range(3))
    def test_only_loses_energy(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        arm = taut.load_arm("planar3", gravity=[0.0, 0.0, 0.0]).with_joints(
            viscous=0.0, coulomb=rng.uniform(1.0, 3.0, 3)
        )
        out = run(taut.RigidPlant(arm, substeps=4), duration=2.0, v0=rng.normal(size=3))
        E = energy(arm, out.q, out.v)
        # The integrator's own error of first order, which without friction is 1e-3 of the energy here, is allowed for.
        assert (np.diff(E) < 1e-5 * E[0]).all()
        assert E[-1] < 1e-12 * E[0]

    def test_a_lawful_push_starts_it_without_a_jump(self) -> None:
        """From stuck to slipping the acceleration starts at zero when the push passes the limit."""
        arm = taut.load_arm("planar2", gravity=[0.0, 0.0, 0.0]).with_joints(viscous=0.0, coulomb=[1.0, 100.0])
        ramp = taut.trajectories.Samples(
            times=[0.0, 1.0], q=np.zeros((2, 2)), v=np.zeros((2, 2)), a=[[0.0, 0.0], [2.0, 0.0]]
        )
        out = run(taut.RigidPlant(arm), ramp, law=TorqueOf(), duration=1.0)
        assert np.abs(out.q[:500] - out.q[0]).max() < CREEP
        M = taut.snapshot(arm, arm.home).M[0, 0]
        expected = np.maximum(out.t - 0.5, 0.0) ** 2 / M  # v = integral of (2 t - 1) / M from 0.5 s on
        np.testing.assert_allclose(out.v[:, 0], expected, rtol=0.0, atol=2e-3 / M)
