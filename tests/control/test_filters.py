"""Filters against SciPy's, and the Kalman filter against the Riccati equation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from refusals import refused

import taut
from taut.base.types import Float64Array
from taut.control.sensing import kalman_gains

Array = Float64Array
RATE = 1000.0
DT = 1.0 / RATE
EXACT = 1e-11  # of numbers of size one, over some thousand ticks


def through(part: Any, signal: Array, numbers: dict[str, Any] | None = None, dt: float = DT) -> Array:
    """A signal (k, n) through a filter, tick by tick."""
    values = part.parameters() if numbers is None else numbers
    memory, out = part.start(signal[0]), []
    for u in signal:
        y, memory = part.filtered(u, memory, values, dt)
        out.append(y)
    return np.array(out)


def response(part: Any, frequencies: Array, ticks: int = 2**14) -> Array:
    """The sampled frequency response, from an impulse that comes after rest."""
    impulse = np.zeros((ticks, 1))
    impulse[1] = 1.0
    answer = through(part, impulse)[1:, 0]
    phases = np.exp(-2.0j * np.pi * frequencies[:, np.newaxis] * DT * np.arange(len(answer)))
    return np.asarray(phases @ answer)


class TestLowPass:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("order", [1, 2])
    @pytest.mark.parametrize("cutoff", [2.0, 30.0, 200.0, 480.0])
    def test_is_three_decibels_down_at_its_cutoff_exactly(self, order: Any, cutoff: float) -> None:
        part = taut.sensors.LowPass(cutoff=cutoff, order=order)
        gains = np.abs(response(part, np.array([0.0, cutoff, 499.999])))
        np.testing.assert_allclose(gains[:2], [1.0, np.sqrt(0.5)], rtol=1e-7)
        if cutoff < 200.0:
            assert gains[2] < 1e-4

    @pytest.mark.parametrize("order", [1, 2])
    def test_is_scipys_butterworth_on_a_random_signal(self, order: Any) -> None:
        signal = np.random.default_rng(0).standard_normal((2000, 3)) + 5.0
        b, a = scipy.signal.butter(order, 30.0, fs=RATE)
        start = scipy.signal.lfilter_zi(b, a)[:, np.newaxis] * signal[0]
        wanted, _ = scipy.signal.lfilter(b, a, signal, axis=0, zi=start)
        got = through(taut.sensors.LowPass(cutoff=30.0, order=order), signal)
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=EXACT)

    @pytest.mark.parametrize("order", [1, 2])
    def test_has_a_cutoff_for_each_entry(self, order: Any) -> None:
        signal = np.random.default_rng(1).standard_normal((500, 2))
        both = through(taut.sensors.LowPass(cutoff=[10.0, 100.0], order=order), signal)
        for i, cutoff in enumerate((10.0, 100.0)):
            alone = through(taut.sensors.LowPass(cutoff=cutoff, order=order), signal[:, [i]])
            np.testing.assert_allclose(both[:, [i]], alone, rtol=0.0, atol=EXACT)

    @pytest.mark.parametrize("order", [1, 2])
    def test_keeps_still_what_stands_still_however_its_cutoff_jumps(self, order: Any) -> None:
        part = taut.sensors.LowPass(cutoff=30.0, order=order)
        memory = part.start(np.array([2.5]))
        for cutoff in (30.0, 400.0, 0.01, 30.0):
            y, memory = part.filtered(np.array([2.5]), memory, {"cutoff": np.asarray(cutoff)}, DT)
            assert y[0] == 2.5

    @pytest.mark.parametrize("order", [1, 2])
    def test_delays_a_ramp_as_its_docstring_says(self, order: Any) -> None:
        ramp = np.arange(5000.0)[:, np.newaxis] * DT
        behind = (ramp - through(taut.sensors.LowPass(cutoff=5.0, order=order), ramp))[-1, 0]
        delay = {1: 1.0, 2: np.sqrt(2.0)}[order] / (2.0 * np.pi * 5.0)
        np.testing.assert_allclose(behind, delay, rtol=1e-3)  # prewarping moves it by (pi 5/1000)^2 / 3


class TestNotch:
    def test_is_scipys_notch_where_it_has_no_bottom(self) -> None:
        signal = np.random.default_rng(2).standard_normal((2000, 2))
        signal[0] = 0.0
        b, a = scipy.signal.iirnotch(18.0, 18.0 / 4.0, fs=RATE)
        wanted = scipy.signal.lfilter(b, a, signal, axis=0)
        got = through(taut.sensors.Notch(frequency=18.0, width=4.0, depth=400.0), signal)
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=EXACT)

    @pytest.mark.part(1)
    @pytest.mark.parametrize(
        ("frequency", "width", "depth"), [(18.0, 4.0, 40.0), (120.0, 60.0, 6.0), (3.0, 1.0, 20.0)]
    )
    def test_has_its_depth_at_its_frequency_and_passes_the_rest(
        self, frequency: float, width: float, depth: float
    ) -> None:
        part = taut.sensors.Notch(frequency=frequency, width=width, depth=depth)
        gains = np.abs(response(part, np.array([0.0, frequency, 499.999])))
        np.testing.assert_allclose(gains, [1.0, 10.0 ** (-depth / 20.0), 1.0], rtol=1e-5)

    def test_is_as_wide_as_it_says(self) -> None:
        part, w0, width = taut.sensors.Notch(frequency=80.0, width=30.0, depth=300.0), 80.0, 30.0
        frequencies = np.linspace(40.0, 140.0, 1001)
        inside = frequencies[np.abs(response(part, frequencies, ticks=1000)) < np.sqrt(0.5)]
        np.testing.assert_allclose(inside[-1] - inside[0], width, atol=0.21)
        assert inside[0] < w0 < inside[-1]

    def test_can_be_of_some_joints_alone(self) -> None:
        signal = np.random.default_rng(3).standard_normal((300, 2))
        got = through(taut.sensors.Notch(frequency=[0.0, 18.0], width=4.0), signal)
        np.testing.assert_array_equal(got[:, 0], signal[:, 0])
        alone = through(taut.sensors.Notch(frequency=18.0, width=4.0), signal[:, [1]])
        np.testing.assert_allclose(got[:, [1]], alone, rtol=0.0, atol=EXACT)

    def test_keeps_still_what_stands_still_however_it_is_changed(self) -> None:
        part = taut.sensors.Notch(frequency=18.0, width=4.0)
        memory = part.start(np.array([2.5]))
        for frequency in (18.0, 200.0, 1.0):
            numbers = {"frequency": np.asarray(frequency), "width": np.asarray(9.0), "depth": np.asarray(30.0)}
            y, memory = part.filtered(np.array([2.5]), memory, numbers, DT)
            assert y[0] == 2.5

    def test_takes_a_vibration_out_of_a_motion_that_it_leaves(self) -> None:
        t = DT * np.arange(4000.0)
        slow = np.sin(2.0 * np.pi * 0.5 * t)
        got = through(
            taut.sensors.Notch(frequency=18.0, width=4.0), (slow + 0.1 * np.sin(36.0 * np.pi * t))[:, np.newaxis]
        )
        # What is left of the vibration is a hundredth; the motion is late by width / (2 pi frequency^2), 2 ms.
        assert np.abs(got[1000:, 0] - slow[1000:]).max() < 0.001 + np.pi * 0.002 * 1.1


class TestKalman:
    CASES = ((1.0, 1.0, 1.0), (10.0, 1e-5, 1e-3), (1e-3, 1.0, 1e-3), (100.0, 1e-6, 1e-2), (3e3, 1e-3, 2e-3))

    @staticmethod
    def model(noise: float, dt: float) -> tuple[Array, Array, Array]:
        F, H = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[1.0, 0.0]])
        return F, H, noise**2 * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])

    @pytest.mark.parametrize(("noise", "sigma", "dt"), CASES)
    def test_gains_solve_the_riccati_equation(self, noise: float, sigma: float, dt: float) -> None:
        F, H, Q = self.model(noise, dt)
        P = scipy.linalg.solve_discrete_are(F.T, H.T, Q, np.array([[sigma**2]]))
        K = (P @ H.T)[:, 0] / (P[0, 0] + sigma**2)
        alpha, beta = kalman_gains(noise, sigma, dt)
        np.testing.assert_allclose([alpha, beta / dt], K, rtol=1e-6)

    def test_is_a_plain_kalman_filter_that_has_settled(self) -> None:
        noise, sigma = 50.0, 1e-4
        F, H, Q = self.model(noise, DT)
        P = scipy.linalg.solve_discrete_are(F.T, H.T, Q, np.array([[sigma**2]]))
        measured = np.cumsum(np.random.default_rng(4).standard_normal(500)) * 1e-4 + 0.3
        state, wanted = np.array([measured[0], 0.0]), []
        for z in measured:
            state, prior = F @ state, F @ (P - np.outer(P[:, 0], P[0]) / (P[0, 0] + sigma**2)) @ F.T + Q
            gain = prior[:, 0] / (prior[0, 0] + sigma**2)
            state = state + gain * (z - state[0])
            wanted.append(state[1])
        part, arm = taut.sensors.Kalman(acceleration_noise=noise, position_noise=sigma), taut.load_arm("one_joint")
        numbers = {"acceleration_noise": np.asarray(noise), "position_noise": np.asarray(sigma)}
        memory, got = part.start(measured[:1]), []
        for z in measured:
            v, memory = part.filtered(np.array([z]), memory, numbers, DT, arm.difference)
            got.append(v[0])
        np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-9)

    def test_errs_as_the_riccati_equation_says_on_motion_of_its_model(self) -> None:
        noise, sigma, ticks = 50.0, 1e-4, 40_000
        F, _, Q = self.model(noise, DT)
        P = scipy.linalg.solve_discrete_are(F.T, np.array([[1.0], [0.0]]), Q, np.array([[sigma**2]]))
        after = P[1, 1] - P[1, 0] ** 2 / (P[0, 0] + sigma**2)
        rng = np.random.default_rng(5)
        kicks = rng.multivariate_normal(np.zeros(2), Q, size=ticks)
        state, alpha_beta, truth, seen = np.zeros(2), kalman_gains(noise, sigma, DT), [], []
        q_hat, v_hat = 0.0, 0.0
        for kick in kicks:
            state = F @ state + kick
            predicted = q_hat + v_hat * DT
            surprise = state[0] + sigma * rng.standard_normal() - predicted
            q_hat, v_hat = predicted + alpha_beta[0] * surprise, v_hat + alpha_beta[1] / DT * surprise
            truth.append(state[1])
            seen.append(v_hat)
        errors = np.array(seen[500:]) - truth[500:]
        np.testing.assert_allclose(errors.std(), np.sqrt(after), rtol=0.05)

    def test_follows_a_constant_velocity_without_error(self) -> None:
        part, arm = taut.sensors.Kalman(acceleration_noise=5.0, position_noise=1e-4), taut.load_arm("one_joint")
        numbers = {"acceleration_noise": np.asarray(5.0), "position_noise": np.asarray(1e-4)}
        memory, v = part.start(np.zeros(1)), np.zeros(1)
        for k in range(3000):
            v, memory = part.filtered(np.array([0.7 * k * DT]), memory, numbers, DT, arm.difference)
        np.testing.assert_allclose(v, 0.7, rtol=1e-9)


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (lambda: taut.sensors.LowPass(cutoff=0.0), taut.errors.RangeError),
        (lambda: taut.sensors.LowPass(cutoff=[3.0, -1.0]), taut.errors.RangeError),
        (lambda: taut.sensors.LowPass(cutoff=np.nan), taut.errors.RangeError),
        (lambda: taut.sensors.LowPass(cutoff="fast"), taut.errors.ShapeError),
        (lambda: taut.sensors.LowPass(cutoff=np.ones((2, 2))), taut.errors.ShapeError),
        (lambda: taut.sensors.LowPass(cutoff=3.0, order=3), taut.errors.UsageError),  # type: ignore[arg-type]
        (lambda: taut.sensors.Difference(cutoff=0.0), taut.errors.RangeError),
        (lambda: taut.sensors.Difference(order=2), taut.errors.UsageError),
        (lambda: taut.sensors.Notch(frequency=0.0, width=1.0), taut.errors.RangeError),
        (lambda: taut.sensors.Notch(frequency=[0.0, 0.0], width=1.0), taut.errors.RangeError),
        (lambda: taut.sensors.Notch(frequency=[3.0, -3.0], width=1.0), taut.errors.RangeError),
        (lambda: taut.sensors.Notch(frequency=3.0, width=0.0), taut.errors.RangeError),
        (lambda: taut.sensors.Notch(frequency=3.0, width=1.0, depth=-3.0), taut.errors.RangeError),
        (lambda: taut.sensors.Kalman(acceleration_noise=0.0, position_noise=1.0), taut.errors.RangeError),
        (lambda: taut.sensors.Kalman(acceleration_noise=1.0, position_noise=0.0), taut.errors.RangeError),
    ],
    ids=range(15),
)  # fmt: skip
def test_what_is_no_filter_is_refused_in_words(make: Any, kind: type[taut.TautError]) -> None:
    with refused(kind):
        make()
