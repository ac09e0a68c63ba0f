"""Sensors: steps of the encoder, noise that has the stated spread, and one seed, one run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plant_laws import Seen, run, seen

import taut
from taut.control.tasks.feed import ReferenceFeed

ARM = taut.load_arm("planar2")
STILL = ("gravity",)  # so that the arm stays where it is, and only the sensors speak


def sensors(
    resolution: Any = None, noise_q: Any = 0.0, noise_v: Any = 0.0, offset: Any = 0.0, side: Any = None
) -> taut.sensors.Sensors:
    position = taut.sensors.Encoder(resolution=resolution, noise=noise_q, offset=offset, side=side)
    return taut.sensors.Sensors(position=position, velocity=taut.sensors.Tachometer(noise=noise_v))


def measured(seed: int = 0, duration: float = 1.0, **options: Any) -> taut.Run:
    plant = taut.RigidPlant(ARM, adds=STILL, sensors=sensors(**options))
    return run(plant, taut.JointMotion(q=[0.0, 0.0]), law=Seen(), q0=[0.3, -0.7], seed=seed, duration=duration)


class TestTheEncodersSteps:
    def test_are_rounded_to_the_nearest(self) -> None:
        plant = taut.RigidPlant(ARM, adds=STILL, sensors=sensors(resolution=0.01))
        out = run(plant, taut.JointMotion(q=[0.0, 0.0]), law=Seen(), v0=[1.0, -0.3])
        q = seen(out, "q")
        np.testing.assert_allclose(q / 0.01, np.round(q / 0.01), rtol=0.0, atol=1e-9)
        assert np.abs(q - out.q).max() <= 0.005 + 1e-12
        assert np.abs(np.mean(q - out.q)) < 1e-3
        np.testing.assert_array_equal(seen(out, "v"), out.v)  # the tachometer has none

    def test_are_none_for_a_joint_whose_resolution_is_zero(self) -> None:
        out = measured(resolution=[0.0, 0.1])
        np.testing.assert_array_equal(seen(out, "q")[:, 0], out.q[:, 0])
        np.testing.assert_allclose(seen(out, "q")[:, 1], -0.7, rtol=1e-12)

    def test_can_be_switched_off_in_a_run_joint_by_joint(self) -> None:
        plant = taut.RigidPlant(ARM, adds=STILL, sensors=sensors(resolution=[0.25, 0.25]))
        off = [taut.Event(t=0.5, set={"sensors.position.resolution": [0.0, 0.25]})]
        out = run(plant, taut.JointMotion(q=[0.0, 0.0]), law=Seen(), q0=[0.3, -0.7], events=off)
        np.testing.assert_allclose(seen(out, "q")[499], [0.25, -0.75])
        np.testing.assert_allclose(seen(out, "q")[500], [0.3, -0.75])

    def test_come_after_the_noise(self) -> None:
        out = measured(resolution=0.01, noise_q=0.1)
        q = seen(out, "q")
        np.testing.assert_allclose(q / 0.01, np.round(q / 0.01), rtol=0.0, atol=1e-9)
        assert 0.09 < np.std(q[:, 0]) < 0.11


class TestNoise:
    def test_has_the_stated_spread_and_no_mean(self) -> None:
        out = measured(duration=10.0, noise_q=[1e-3, 4e-3], noise_v=2e-2)
        off_q, off_v = seen(out, "q") - out.q, seen(out, "v") - out.v
        # Over 10001 ticks a spread is known to 0.7 %, a mean to a hundredth of the spread; four times that here.
        np.testing.assert_allclose(off_q.std(axis=0), [1e-3, 4e-3], rtol=0.03)
        np.testing.assert_allclose(off_v.std(axis=0), [2e-2, 2e-2], rtol=0.03)
        assert (np.abs(off_q.mean(axis=0)) < 0.04 * np.array([1e-3, 4e-3])).all()
        assert (np.abs(off_v.mean(axis=0)) < 0.04 * 2e-2).all()

    def test_is_new_in_every_tick_joint_and_measurement(self) -> None:
        out = measured(duration=10.0, noise_q=1.0, noise_v=1.0)
        columns = np.hstack([seen(out, "q") - out.q, seen(out, "v") - out.v])
        later = np.roll(columns, 1, axis=0)
        correlation = np.corrcoef(np.hstack([columns, later]).T)
        assert np.abs(correlation - np.eye(8)).max() < 0.05

    def test_is_the_same_for_the_same_seed_and_another_for_another(self) -> None:
        one, again, other = (measured(seed, noise_q=0.1, noise_v=0.1) for seed in (3, 3, 4))
        np.testing.assert_array_equal(seen(one, "q"), seen(again, "q"))
        np.testing.assert_array_equal(one.tau, again.tau)
        assert np.abs(seen(one, "q") - seen(other, "q")).min() > 0.0
        assert abs(np.corrcoef(seen(one, "v")[:, 0], seen(other, "v")[:, 0])[0, 1]) < 0.15

    def test_of_one_measurement_does_not_depend_on_whether_another_has_some(self) -> None:
        alone, both = measured(noise_v=0.1), measured(noise_v=0.1, noise_q=0.1)
        np.testing.assert_array_equal(seen(alone, "v"), seen(both, "v"))

    @pytest.mark.parametrize("block", [1, 7, 1000])
    def test_does_not_depend_on_how_a_run_is_cut_into_blocks(
        self, block: int, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        whole = measured(noise_q=0.1, noise_v=0.1)
        monkeypatch.setattr(ReferenceFeed, "block", block)
        np.testing.assert_array_equal(seen(measured(noise_q=0.1, noise_v=0.1), "q"), seen(whole, "q"))

    def test_does_not_depend_on_events(self) -> None:
        plant = taut.RigidPlant(ARM, adds=STILL, sensors=sensors(noise_q=0.1, noise_v=0.1))
        hold = taut.JointMotion(q=[0.0, 0.0])
        events = [taut.Event(t=t, set={"plant.payload.mass": 0.0}) for t in (0.0, 0.001, 0.25, 0.2501, 0.9)]
        plain, cut = (run(plant, hold, law=Seen(), seed=5, events=e) for e in (None, events))
        np.testing.assert_array_equal(seen(plain, "q"), seen(cut, "q"))

    def test_scales_with_its_parameter_in_a_run(self) -> None:
        plant = taut.RigidPlant(ARM, adds=STILL, sensors=sensors(noise_q=0.1))
        louder = [taut.Event(t=0.5, set={"sensors.position.noise": 1.0})]
        out = run(plant, taut.JointMotion(q=[0.0, 0.0]), law=Seen(), events=louder)
        off = seen(out, "q") - out.q
        assert 0.08 < off[:500].std() < 0.12
        assert 0.8 < off[500:].std() < 1.2

    def test_does_not_touch_the_true_state(self) -> None:
        plain, noisy = measured(), measured(noise_q=0.1, noise_v=0.1, resolution=0.01)
        np.testing.assert_array_equal(plain.q, noisy.q)

    def test_is_the_same_in_the_float_engine(self) -> None:
        plant = taut.RigidPlant(ARM, adds=STILL, sensors=sensors(noise_q=0.1, noise_v=0.1, resolution=[0.0, 0.01]))
        hold = taut.JointMotion(q=[0.0, 0.0])
        fast, slow = (run(plant, hold, law=Seen(), duration=0.05, engine=e) for e in ("native", "float"))
        np.testing.assert_allclose(seen(fast, "q"), seen(slow, "q"), rtol=1e-12)
