"""Error dynamics of joints: the chapter's numbers, and runs of taut on the chapter's link."""

from __future__ import annotations

import math

import numpy as np
import pytest
from refusals import refused
from scipy.optimize import brentq
from servo_runs import KINDS, Servo, table

import taut
from taut.linear.performance import BAND, powers

CHAPTER = {"M": 0.5, "b": 0.1, "kp": 2.205, "kd": 2.0}


@pytest.mark.parametrize("kp", [20.0, 51.005, 200.0])
def test_figure_10_5_has_three_cases(kp: float) -> None:
    zeta = taut.error_dynamics(M=0.5, b=0.1, kp=kp, kd=10.0).zeta
    expected = taut.analysis.second_order(M=0.5, b=0.1, kp=kp, kd=10.0).zeta
    assert expected == pytest.approx(10.1 / (2.0 * math.sqrt(kp * 0.5)))
    assert zeta == pytest.approx(np.full(2, min(expected, 1.0)))


def test_the_rule_of_four_time_constants_is_not_the_settling_time() -> None:
    d = taut.error_dynamics(**CHAPTER)
    assert 4.0 / d.decay_rate == pytest.approx(1.905, abs=1e-3)
    assert d.step().settling_time == pytest.approx(2.778, abs=1e-3)


def test_the_bound_on_ki_is_where_it_becomes_unstable() -> None:
    bound = taut.analysis.second_order(**CHAPTER).largest_ki
    assert bound == pytest.approx(9.261)
    for factor in (1.0 - 1e-9, 1.0 + 1e-9):
        stable = taut.error_dynamics(**CHAPTER, ki=factor * bound).stable
        assert stable is (factor < 1.0)
        assert taut.analysis.routh([0.5, 2.1, 2.205, factor * bound]).stable is stable


def test_a_constant_disturbance_leaves_an_error_that_an_integral_removes() -> None:
    push = {"input": "disturbance.command[0]", "output": "e[0]"}
    assert taut.error_dynamics(**CHAPTER).dc_gain(**push) == pytest.approx(-1.0 / 2.205)
    assert taut.error_dynamics(**CHAPTER, ki=1.0).dc_gain(**push) == pytest.approx(0.0, abs=1e-12)


def test_an_integral_does_not_remove_the_error_along_a_sine() -> None:
    """Of ref.q and its velocity, both of which the law follows."""
    w = 2.0 * math.pi * 0.5
    s = 1j * w
    for ki, expected in (
        (0.0, (0.5 * s**2 + 0.1 * s) / (0.5 * s**2 + 2.1 * s + 2.205)),
        (1.0, (0.5 * s**3 + 0.1 * s**2) / (0.5 * s**3 + 2.1 * s**2 + 2.205 * s + 1.0)),
    ):
        d = taut.error_dynamics(**CHAPTER, ki=ki)
        position, velocity = (
            d.frequency_response(w, input=name, output="e[0]")[0] for name in ("ref.q[0]", "ref.v[0]")
        )
        assert abs(position + s * velocity) == pytest.approx(abs(expected))


@pytest.mark.parametrize("zeta", [0.02, 0.2, 0.5286, 0.77, 0.7797, 0.78, 0.95, 1.0, 3.0, 50.0])
def test_settling_is_the_last_time_outside_two_percent(zeta: float) -> None:
    w = 3.0

    def error(t: float) -> float:
        if zeta == 1.0:
            return (1.0 + w * t) * math.exp(-w * t)
        root = np.sqrt(complex(zeta**2 - 1.0))
        slow, fast = w * (-zeta + root), w * (-zeta - root)
        return float(((fast * np.exp(slow * t) - slow * np.exp(fast * t)) / (fast - slow)).real)

    t = taut.error_dynamics(zeta=zeta, omega_n=w).step().settling_time
    assert abs(error(t)) == pytest.approx(BAND, rel=1e-8)
    later = np.linspace(t, 3.0 * t, 3000)[1:]
    assert max(abs(error(each)) for each in later.tolist()) < BAND


def test_what_does_not_settle_says_so() -> None:
    for numbers in ({"kp": 4.0}, {"kp": 1.0, "kd": 1.0, "ki": 3.0}, {"kp": 0.0, "kd": 1.0}):
        step = taut.error_dynamics(M=0.5, **numbers).step()
        assert step.settling_time == math.inf
        assert math.isnan(step.overshoot)


@pytest.mark.parametrize("velocity", range(len(KINDS)))
@pytest.mark.parametrize(("ki", "taps"), [(0.0, 0), (30.0, 3)])
def test_the_response_at_a_servo_rate_is_that_of_a_run_tick_by_tick(velocity: int, ki: float, taps: int) -> None:
    servo, ticks = Servo(rate=200.0, kind=velocity, taps=taps), 120
    d = servo.sampled(20.0, 4.0, ki)
    start = np.zeros(len(d.A))
    start[d.state_places("plant.q")] = 1.0
    if "sensing.q_last[0]" in d.states:
        start[d.state_places("sensing.q_last")] = 1.0
    response = powers(d.C[d.rows("q[0]")[0]], d.A, ticks) @ start
    np.testing.assert_allclose(response, servo.error(20.0, 4.0, ki, ticks), atol=1e-8)


def test_settling_at_a_servo_rate_is_the_first_tick_from_which_a_run_stays_within_two_percent() -> None:
    servo = Servo(rate=100.0, kind=1, taps=1)
    e = servo.error(20.0, 4.0, 0.0, 400)
    outside = np.flatnonzero(np.abs(e) > BAND)
    assert servo.sampled(20.0, 4.0, 0.0).step().settling_time == pytest.approx((outside[-1] + 1) / 100.0)


def test_the_hold_splits_a_double_pole_and_tends_to_continuous_time_as_the_rate_grows() -> None:
    sampled = taut.error_dynamics(omega_n=10.0, zeta=1.0, rate=1000.0)
    assert sampled.s_poles.real == pytest.approx([-9.36, -10.79], abs=0.01)
    book = taut.error_dynamics(M=0.5, b=0.1, kp=20.0, kd=4.0, ki=30.0)
    off = []
    for rate in (100.0, 1000.0, 10_000.0):
        d = taut.error_dynamics(M=0.5, b=0.1, kp=20.0, kd=4.0, ki=30.0, rate=rate)
        off.append(float(np.abs(d.s_poles - book.poles).max()))
    assert off[0] > 5.0 * off[1] > 25.0 * off[2]
    assert d.step().settling_time == pytest.approx(book.step().settling_time, rel=0.01)


@pytest.mark.parametrize("velocity", KINDS)
def test_the_delay_margin_is_the_number_of_periods_after_which_the_loop_is_unstable(velocity: object) -> None:
    rng, rate = np.random.default_rng(3), 200.0
    counts = []
    for _ in range(6):
        gains = taut.analysis.second_order(M=0.5, omega_n=rng.uniform(3.0, 60.0), zeta=rng.uniform(0.05, 1.5))
        numbers = {"M": 0.5, "kp": gains.kp, "kd": gains.kd, "ki": rng.choice([0.0, 0.3]) * gains.largest_ki}
        d = taut.error_dynamics(**numbers, rate=rate, velocity=velocity)
        periods = math.floor(d.margins().delay * rate + 1e-9)
        if not d.stable:
            assert periods == 0
            continue
        counts.append(periods)
        for more, stable in ((0, True), (1, False)):
            late = taut.error_dynamics(**numbers, rate=rate, velocity=velocity, delay=(periods + more) / rate)
            assert late.stable is stable
    assert len(set(counts)) > 2


def test_a_delay_margin_of_thousands_of_periods_is_that_of_the_continuous_loop() -> None:
    """Poles next to z = 1: kp, kd and a small ki on a double integrator, differenced and filtered velocity."""
    M, kp, kd, ki, cutoff, T = 0.5, 1.0, 1.0, 1e-3, 2.0 * math.pi * 50.0, 1e-4

    def response(w: float) -> complex:
        s = 1j * w
        late = np.exp(-0.5 * s * T)  # of the hold, and of the difference
        return late * (kp + ki / s + kd * s * late * cutoff / (s + cutoff)) / (M * s**2)

    w = float(brentq(lambda w: abs(response(w)) - 1.0, 0.1, 100.0, xtol=1e-14))
    d = taut.error_dynamics(
        M=M, kp=kp, kd=kd, ki=ki, rate=1.0 / T, velocity=taut.sensors.Difference(cutoff=50.0)
    )  # fmt: skip
    assert d.margins().delay == pytest.approx((np.angle(response(w)) + math.pi) / w, rel=1e-5)
    assert d.margins().delay / T > 5000.0


def test_stable_in_continuous_time_and_unstable_at_100_hz() -> None:
    gains = {"M": 0.5, "kd": 120.0, "zeta": 1.0}
    assert taut.error_dynamics(**gains).stable
    for rate, stable in ((100.0, False), (119.99, False), (120.01, True)):  # kd / (2 M): docs/gain_bounds.md
        assert taut.error_dynamics(**gains, rate=rate).stable is stable
    assert taut.error_dynamics(**gains, rate=100.0).margins().delay == 0.0


def test_a_coupled_arm_is_as_many_loops_as_it_has_joints() -> None:
    """Directions of a matrix of inertia with the same gains per unit of inertia."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    M = root @ root.T + np.eye(3)
    whole = taut.error_dynamics(M=M, kp=100.0 * M, kd=14.0 * M, rate=500.0, delay=3e-3)
    alone = taut.error_dynamics(M=1.0, kp=100.0, kd=14.0, rate=500.0, delay=3e-3)
    np.testing.assert_allclose(np.sort(np.abs(whole.poles)), np.sort(np.repeat(np.abs(alone.poles), 3)), atol=1e-7)
    assert table().n == 1


def test_the_gains_of_a_specification_are_those_it_was_read_from() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        M, b = rng.uniform(0.1, 3.0), rng.choice([0.0, 0.1])
        zeta, omega_n = rng.uniform(0.8, 3.0), rng.uniform(2.0, 40.0)
        known = taut.analysis.second_order(M=M, b=b, zeta=zeta, omega_n=omega_n)
        settling = taut.error_dynamics(M=M, b=b, kp=known.kp, kd=known.kd).step().settling_time
        for pair in (
            {"kp": known.kp, "zeta": zeta}, {"kd": known.kd, "zeta": zeta}, {"settling": settling, "zeta": zeta},
            {"kd": known.kd, "omega_n": omega_n},
        ):  # fmt: skip
            made = taut.analysis.second_order(M=M, b=b, **pair)
            assert (made.kp, made.kd) == pytest.approx((known.kp, known.kd), rel=1e-6)


def test_an_inertia_that_is_none_is_refused_with_its_value() -> None:
    for numbers in ({}, {"kp": 1.0}, {"zeta": 1.0, "omega_n": 5.0}):
        with refused(taut.errors.RangeError):
            taut.error_dynamics(M=-1.0, **numbers)
