"""Sampled error dynamics against runs of taut, SciPy and python-control."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import cont2discrete
from servo_runs import Servo

import taut
from taut.linear.sampled import VelocityKind

CLOSE = 0.05  # poles nearer than this share of their size are compared by the polynomial's coefficients
WITHIN = 0.005


SERVOS = [
    Servo(rate=1000.0, kind=0), Servo(rate=100.0, kind=1), Servo(rate=100.0, kind=2, exact=True),
    Servo(rate=1000.0, kind=3, taps=2), Servo(rate=100.0, kind=0, taps=1, exact=True),
]  # fmt: skip


def fitted(e: np.ndarray, order: int) -> np.ndarray:
    """(order + 1,) the polynomial in z of which a sequence is the response: linear prediction by least squares."""
    rows = np.lib.stride_tricks.sliding_window_view(e, order + 1)
    rows = rows / np.abs(rows).max(axis=1, keepdims=True)
    left, size = rows[:, :order], np.linalg.norm(rows[:, :order], axis=0)
    tail = np.linalg.lstsq(left / size, -rows[:, order], rcond=1e-15)[0] / size
    return np.concatenate([[1.0], tail[::-1]])


class TestAgainstRuns:
    @pytest.mark.parametrize("servo", SERVOS, ids=str)
    @pytest.mark.parametrize("ki", [0.0, 30.0])
    def test_the_response_is_that_of_a_run_tick_by_tick(self, servo: Servo, ki: float) -> None:
        e = servo.error(20.0, 4.0, ki, 60)
        np.testing.assert_allclose(servo.sampled(20.0, 4.0, ki).response(60), e, rtol=0.0, atol=1e-10)

    @pytest.mark.bars
    def test_the_poles_are_those_fitted_from_runs(
        self, share: Callable[[int], int], bar: Callable[[str, object], None]
    ) -> None:
        rng = np.random.default_rng(0)
        worst, polynomials, count = 0.0, 0, share(200)
        for i in range(count):
            servo = SERVOS[i % len(SERVOS)]
            omega_n = rng.uniform(0.02, 0.12) * servo.rate / (1.0 + servo.taps)
            zeta = rng.uniform(0.3, 1.4) / (2.0 if servo.kind > 1 and omega_n > 30.0 else 1.0)
            pd = taut.analysis.second_order(M=0.5, omega_n=omega_n, zeta=zeta)
            ki = rng.choice([0.0, 0.2]) * pd.largest_ki
            d = servo.sampled(pd.kp, pd.kd, ki)
            some = d.poles[np.abs(d.poles) > 1e-9]
            poly = fitted(servo.error(pd.kp, pd.kd, ki, 60), len(some))
            distances = np.abs(some[:, np.newaxis] - some) + np.diag(np.full(len(some), np.inf))
            if (distances.min(axis=1) < CLOSE * np.abs(some)).any():
                polynomials += 1
                expected = np.poly(some).real
                off = np.abs(poly - expected).max() / np.abs(expected).max()
            else:
                roots = np.roots(poly)
                off = (np.abs(some[:, np.newaxis] - roots).min(axis=1) / np.abs(some)).max()
            worst = max(worst, off)
            assert off < WITHIN, (servo, pd, ki)
        bar(
            "one_joint under PID at 100 Hz and 1 kHz, delayed, differenced, filtered: worst difference of poles "
            f"predicted and fitted from runs, of {count}",
            f"{100.0 * worst:.2g} %, {polynomials} by coefficients",
        )

    @pytest.mark.parametrize("servo", SERVOS, ids=str)
    @pytest.mark.parametrize("ki", [0.0, 20.0])
    def test_settling_is_the_first_tick_from_which_on_a_run_is_within_two_percent(
        self, servo: Servo, ki: float
    ) -> None:
        d = servo.sampled(20.0, 4.0, ki)
        assert d.settling_ticks is not None
        e = servo.error(20.0, 4.0, ki, 3 * d.settling_ticks)
        assert int(np.flatnonzero(np.abs(e) > 0.02)[-1]) + 1 == d.settling_ticks
        assert 100.0 * max(-e.min(), 0.0) == pytest.approx(d.overshoot, abs=1e-8)


class TestClosedForms:
    def test_the_hold_splits_the_double_pole_as_known(self) -> None:
        """MATHS: kp 100, kd 20 at 1 kHz are -9.36 and -10.79, under semi-implicit Euler -9.09 and -11.11."""
        d = taut.analysis.second_order(omega_n=10.0, zeta=1.0)
        np.testing.assert_allclose(d.sampled(rate=1000.0).s_poles, [-9.36, -10.79], atol=0.005)
        euler = d.sampled(rate=1000.0, integrator="semi-implicit-euler")
        np.testing.assert_allclose(euler.s_poles, [-9.09, -11.11], atol=0.005)

    def test_the_matrix_with_an_integral_is_that_of_scipy(self) -> None:
        M, b, kp, kd, ki, T = 0.5, 0.1, 20.0, 4.0, 30.0, 0.01
        Ad, Bd, *_ = cont2discrete(
            (np.array([[0, 1], [0, -b / M]]), np.array([[0], [1 / M]]), np.eye(2), np.zeros((2, 1))), T
        )
        gain = np.array([[kp + ki * T, kd]])
        closed = np.block([[Ad - Bd @ gain, -Bd * ki], [np.array([[T, 0.0]]), np.eye(1)]])
        d = taut.analysis.second_order(M=M, b=b, kp=kp, kd=kd, ki=ki).sampled(rate=1.0 / T)
        np.testing.assert_allclose(np.sort_complex(d.poles), np.sort_complex(np.linalg.eigvals(closed)), rtol=1e-10)

    def test_it_tends_to_the_book_as_the_rate_grows(self) -> None:
        book = taut.analysis.second_order(M=0.5, b=0.1, kp=20.0, kd=4.0, ki=30.0)
        off = []
        for rate in (100.0, 1000.0, 10_000.0):
            s = book.sampled(rate=rate).s_poles
            off.append(float(np.abs(s - book.poles).max()))
        assert off[0] > 5.0 * off[1] > 25.0 * off[2]
        assert book.sampled(rate=10_000.0).settling_time == pytest.approx(book.settling_time, rel=0.01)

    def test_stable_in_the_book_unstable_at_100_hz(self) -> None:
        d = taut.analysis.second_order(M=0.5, kd=120.0, zeta=1.0)
        at = d.sampled(rate=100.0)
        assert d.stable
        assert not at.stable
        assert at.lowest_stable_rate == pytest.approx(120.0, rel=1e-6)  # kd / (2 M): docs/gain_bounds.md
        assert d.sampled(rate=1000.0).lowest_stable_rate == pytest.approx(120.0, rel=1e-6)
        assert at.largest_stable_delay == 0.0
        assert at.settling_time == math.inf
        assert "largest pole 1.5" in str(at)
        assert "in the book stable" in str(at)
        assert "from 120 Hz on" in str(at)

    @pytest.mark.parametrize("velocity", ["measured", "difference"])
    @pytest.mark.parametrize("ki", [0.0, 20.0])
    def test_the_borders_have_stable_and_unstable_sides(self, velocity: str, ki: float) -> None:
        d = taut.analysis.second_order(M=0.5, b=0.1, kp=20.0, kd=4.0, ki=ki).sampled(
            rate=200.0, velocity=velocity, delay=3e-3
        )
        rate, delay = d.lowest_stable_rate, d.largest_stable_delay
        assert 3e-3 < delay < 0.5
        assert d.replaced(rate=1.001 * rate).stable
        assert not d.replaced(rate=0.999 * rate).stable
        assert d.replaced(delay=0.9999 * delay).stable
        assert not d.replaced(delay=1.0001 * delay).stable

    def test_a_delay_of_the_continuous_loop_is_met_as_the_rate_grows(self) -> None:
        """The phase margin over its crossing, of kp 100 and kd 20 on a double integrator."""
        w = math.sqrt(200.0 + math.sqrt(200.0**2 + 100.0**2))  # |L| = 1
        margin = math.atan2(20.0 * w, 100.0) / w
        d = taut.analysis.second_order(omega_n=10.0, zeta=1.0).sampled(rate=2000.0)
        assert d.largest_stable_delay == pytest.approx(margin - 0.5 / 2000.0, rel=2e-3)

    def test_a_delay_of_hundreds_of_periods_is_a_border_too(self) -> None:
        d = taut.analysis.second_order(omega_n=1.0, zeta=1.0).sampled(rate=300.0, velocity="difference")
        assert 150.0 < d.largest_stable_delay * 300.0 < 250.0
        assert d.replaced(delay=0.9999 * d.largest_stable_delay).stable
        assert not d.replaced(delay=1.0001 * d.largest_stable_delay).stable

    def test_a_delay_of_thousands_of_periods_is_that_of_the_continuous_loop(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Its poles are so near to z = 1 that the polynomials of the loop do not hold them."""
        M, kp, kd, ki, cutoff, T = 0.5, 1.0, 1.0, 1e-3, 2.0 * math.pi * 50.0, 1e-4

        def response(w: float) -> complex:
            s = 1j * w
            late = np.exp(-0.5 * s * T)  # of the hold, and of the difference
            return late * (kp + ki / s + kd * s * late * cutoff / (s + cutoff)) / (M * s**2)

        w = float(brentq(lambda w: abs(response(w)) - 1.0, 0.1, 100.0, xtol=1e-14))
        made = []
        matrix = taut.analysis.SampledLoop.matrix
        monkeypatch.setattr(taut.analysis.SampledLoop, "matrix", lambda *given: made.append(1) or matrix(*given))
        d = taut.analysis.second_order(M=M, kp=kp, kd=kd, ki=ki).sampled(
            rate=1.0 / T, velocity=taut.sensors.Difference(cutoff=50.0)
        )
        assert d.largest_stable_delay == pytest.approx((np.angle(response(w)) + math.pi) / w, rel=1e-6)
        assert d.largest_stable_delay * d.rate > 5000.0
        assert len(made) < 40

    @pytest.mark.parametrize(
        "velocity",
        ["measured", "difference", taut.sensors.LowPass(cutoff=20.0), taut.sensors.Difference(cutoff=20.0)],
    )
    def test_a_delay_is_a_border_wherever_the_phase_crosses(self, velocity: VelocityKind) -> None:
        rng = np.random.default_rng(3)
        found = []
        for _ in range(6):
            omega_n, zeta, share = rng.uniform(3.0, 60.0), rng.uniform(0.05, 1.5), rng.choice([0.0, 0.3])
            book = taut.analysis.second_order(M=0.5, b=rng.choice([0.0, 0.4]), omega_n=omega_n, zeta=zeta + 0.1)
            d = book.replaced(ki=share * book.largest_ki).sampled(rate=200.0, velocity=velocity)
            most = d.largest_stable_delay
            if most == 0.0:
                assert not d.stable
                continue
            found.append(most * d.rate)
            assert d.replaced(delay=most * (1.0 - 1e-7)).stable
            assert not d.replaced(delay=most * (1.0 + 1e-7)).stable
            assert all(d.replaced(delay=share * most).stable for share in rng.uniform(0.0, 1.0, 3))  # the first one
        assert min(found) < 2.0 < 10.0 < max(found)

    def test_the_response_around_the_loop_has_its_poles_for_roots(self) -> None:
        """At poles on the unit circle, of a loop at its border; and for several directions."""
        rng = np.random.default_rng(1)
        M, B = (a @ a.T + np.eye(2) for a in rng.normal(size=(2, 2, 2)))
        loop = taut.analysis.SampledLoop(
            mass=M,
            damping=0.1,
            K=40.0 * M,
            B=2.0 * B,
            Ki=3.0,
            rate=100.0,
            delay=4e-3,
            velocity=taut.sensors.Difference(cutoff=20.0),
        )
        at_border = loop.with_stiffness(loop.largest_stable())
        z = at_border.poles()[0]
        assert abs(z) == pytest.approx(1.0, abs=1e-9)
        sizes = np.linalg.svd(np.eye(2) + at_border.loop_response(np.array([np.angle(z)]))[0], compute_uv=False)
        assert sizes[1] < 1e-7 * sizes[0]

    def test_nothing_that_does_not_pull_is_stable(self) -> None:
        d = taut.analysis.second_order(M=0.5, kp=0.0, kd=4.0).sampled(rate=100.0)
        assert (d.stable, d.lowest_stable_rate, d.largest_stable_delay) == (False, math.inf, 0.0)
        undamped = taut.analysis.second_order(kp=4.0, kd=0.0).sampled(rate=100.0, integrator="semi-implicit-euler")
        assert not undamped.stable

    def test_no_rate_and_no_delay_help_where_the_book_is_unstable(self) -> None:
        d = taut.analysis.second_order(M=0.5, kp=1.0, kd=1.0, ki=3.0).sampled(rate=1000.0)
        assert (d.lowest_stable_rate, d.largest_stable_delay) == (math.inf, 0.0)
        assert "at no rate with this delay; at this rate with no delay" in str(d)

    def test_a_low_pass_bounds_the_rates_that_are_searched(self) -> None:
        d = taut.analysis.second_order(M=0.5, omega_n=1.0, zeta=1.0).sampled(
            rate=1000.0, velocity=taut.sensors.LowPass(cutoff=100.0)
        )
        assert d.lowest_stable_rate == pytest.approx(200.0)

    def test_under_euler_delays_are_whole_periods(self) -> None:
        d = taut.analysis.second_order(omega_n=10.0, zeta=1.0).sampled(rate=1000.0, integrator="semi-implicit-euler")
        periods = d.largest_stable_delay * 1000.0
        assert periods == pytest.approx(round(periods))
        assert d.replaced(delay=d.largest_stable_delay).stable
        assert not d.replaced(delay=d.largest_stable_delay + 1e-3).stable


def test_python_control_gives_its_step_info() -> None:
    control = pytest.importorskip("control")
    d = taut.analysis.second_order(M=0.5, b=0.1, kp=20.0, kd=3.0, ki=10.0).sampled(
        rate=100.0, velocity="difference", delay=0.01
    )
    system = d.to_control()
    assert system.dt == 0.01
    info = control.step_info(system, T=np.arange(0, 4000) * 0.01)
    assert info["SettlingTime"] == pytest.approx(d.settling_time)
    assert info["Overshoot"] == pytest.approx(d.overshoot, rel=1e-6)
    np.testing.assert_allclose(np.sort(np.abs(system.poles())), np.sort(np.abs(d.poles)), atol=1e-9)


def test_an_integral_is_never_passive() -> None:
    """A slow motion gets energy out of it, whatever the damping."""
    from taut.analysis.tool.passivity import largest_passive, spare_damping

    loop = taut.analysis.SampledLoop(mass=1.0, damping=100.0, K=10.0, Ki=1.0, velocity="difference")
    assert spare_damping(loop) == -math.inf
    assert largest_passive(loop) == 0.0


def test_the_largest_factor_on_a_spring_with_an_integral_is_a_border() -> None:
    loop = taut.analysis.SampledLoop(mass=0.5, damping=0.1, K=20.0, B=4.0, Ki=30.0, rate=100.0)
    factor = loop.largest_stable()
    assert 1.0 < factor < math.inf
    assert loop.with_stiffness(0.999 * factor).stable
    assert not loop.with_stiffness(1.001 * factor).stable


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda d: d.sampled(rate=-1.0), r"rate must be > 0 \[Hz\]; got -1.0"),
        (lambda d: d.sampled(rate=100.0, velocity="guessed"), r"velocity must be 'measured', 'difference', taut.sensors.LowPass\(...\) or taut.sensors.Difference\(...\); got 'guessed'"),
        (lambda d: d.sampled(rate=100.0).replaced(zeta=1.0), r"replaced\(\) takes M, b, kp, kd, ki, rate and delay; got 'zeta'"),
        (lambda d: d.replaced(kp=0.0).sampled(rate=100.0).response(3), "nothing pulls at an error: kp and ki are zero"),
        (lambda d: taut.analysis.ErrorDynamics(coefficients=[1.0, 1.0, 1.0, 1.0]).sampled(rate=100.0), "dynamics of the second order, or of the third with integral=True, have the gains kp, kd and ki; these are of order 3"),
    ],
)  # fmt: skip
def test_what_has_no_meaning_is_refused_in_a_sentence(
    make: Callable[[taut.analysis.ErrorDynamics], object], sentence: str
) -> None:
    with pytest.raises(taut.TautError, match=f"^{sentence}$"):
        make(taut.analysis.second_order(M=0.5, kp=20.0, kd=4.0))


def test_its_picture_shows_the_ticks_over_the_book() -> None:
    d = taut.analysis.second_order(omega_n=10.0, zeta=0.5).sampled(rate=50.0)
    left, right = d.plot().axes
    ticks = next(line for line in left.lines if line.get_label() == "at the ticks")
    np.testing.assert_allclose(ticks.get_ydata(), d.response(len(ticks.get_ydata())))
    assert left.get_legend() is not None
    assert len(right.lines) >= 4


def test_the_legend_of_a_step_lies_over_no_tick() -> None:
    """At 125 Hz this one grows, and its last ticks stand where a legend usually does."""
    d = taut.analysis.second_order(M=0.5, b=0.1, kd=120.0, zeta=1.0).sampled(
        rate=125.0, integrator="semi-implicit-euler"
    )
    figure = d.plot()
    figure.canvas.draw()
    axes = figure.axes[0]
    (ticks,) = [line for line in axes.lines if line.get_label() == "at the ticks"]
    legend = axes.get_legend()
    assert legend is not None
    box = legend.get_window_extent()
    assert not any(box.contains(x, y) for x, y in axes.transData.transform(ticks.get_xydata()))
