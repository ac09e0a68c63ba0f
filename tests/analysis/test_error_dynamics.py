"""Error dynamics against the chapter's numbers, 50-digit closed forms, SciPy and python-control."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from textwrap import indent

import numpy as np
import pytest
from exact_response import exact_response
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import taut
from taut.linear.second_order_response import FASTEST, settling_angle

CHAPTER = {"M": 0.5, "b": 0.1}


class TestTheChapter:
    """Section 10.2.1.1 and figures 10.4 to 10.7, number by number."""

    def test_figure_10_6_is_critically_damped(self) -> None:
        d = taut.analysis.second_order(**CHAPTER, kd=2.0, zeta=1.0)
        assert d.kp == 2.205
        assert d.case == "critically damped"
        assert d.poles.tolist() == [-2.1, -2.1]
        assert d.zeta == pytest.approx(1.0, rel=1e-15)
        assert d.overshoot == 0.0
        assert d.largest_ki == pytest.approx((0.1 + 2.0) * 2.205 / 0.5)

    def test_figure_10_6_with_the_integral_overshoots(self) -> None:
        d = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0, ki=1.0)
        assert d.order == 3
        assert d.coefficients.tolist() == [0.5, 2.1, 2.205, 1.0]  # eq. 10.14
        assert d.stable
        assert 26.0 < d.overshoot < 26.5  # "significant overshoot"

    def test_equation_10_9_and_the_roots(self) -> None:
        d = taut.analysis.second_order(**CHAPTER, kp=20.0, kd=3.0)
        zeta, omega_n = 3.1 / (2.0 * math.sqrt(20.0 * 0.5)), math.sqrt(20.0 / 0.5)
        assert (d.zeta, d.omega_n) == pytest.approx((zeta, omega_n), rel=1e-15)
        assert d.omega_d == pytest.approx(omega_n * math.sqrt(1.0 - zeta**2), rel=1e-14)
        expected = complex(-zeta * omega_n, d.omega_d)
        np.testing.assert_allclose(d.poles, [expected, expected.conjugate()], rtol=1e-14)
        np.testing.assert_allclose(d.time_constants, 1.0 / (zeta * omega_n), rtol=1e-14)

    @pytest.mark.parametrize(
        ("zeta", "case"), [(1.5, "overdamped"), (1.0, "critically damped"), (0.5, "underdamped")]
    )
    def test_figure_10_5_has_three_cases(self, zeta: float, case: str) -> None:
        d = taut.analysis.second_order(**CHAPTER, kd=10.0, zeta=zeta)
        assert d.case == case
        assert d.kp == pytest.approx(10.1**2 / (4.0 * 0.5 * zeta**2))  # zeta = 1: (b + Kd)^2 / (4 M)
        expected = 100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)) if zeta < 1.0 else 0.0
        assert d.overshoot == pytest.approx(expected, abs=1e-12)

    def test_overdamped_has_two_time_constants(self) -> None:
        d = taut.analysis.second_order(**CHAPTER, kd=10.0, zeta=1.5)
        w, z = d.omega_n, 1.5
        slow, fast = -z * w + w * math.sqrt(z**2 - 1.0), -z * w - w * math.sqrt(z**2 - 1.0)
        np.testing.assert_allclose(d.time_constants, [-1.0 / slow, -1.0 / fast], rtol=1e-13)

    def test_the_rule_of_four_time_constants_beside_the_exact_settling_time(self) -> None:
        """The slips: 5.83 / omega_n at zeta = 1, 3.61 at 0.78, and it is not unaffected beyond critical damping."""
        for zeta, exact in ((1.0, 5.83), (0.78, 3.60)):
            d = taut.analysis.second_order(omega_n=1.0, zeta=zeta)
            assert d.settling_time == pytest.approx(exact, abs=0.01)
            assert d.settling_by_rule == pytest.approx(4.0 / zeta, rel=1e-14)
        critical = taut.analysis.second_order(**CHAPTER, kd=10.0, zeta=1.0)
        beyond = critical.replaced(kp=2.0 * critical.kp)
        assert beyond.settling_by_rule == pytest.approx(critical.settling_by_rule)
        assert beyond.settling_time < 0.75 * critical.settling_time

    def test_the_bound_on_ki_is_where_it_turns_unstable(self) -> None:
        pd = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0)
        assert pd.replaced(ki=pd.largest_ki * (1.0 - 1e-12)).stable
        assert not pd.replaced(ki=pd.largest_ki * (1.0 + 1e-12)).stable

    def test_gravity_leaves_an_error_and_the_integral_takes_it_away(self) -> None:
        """Near theta = 0, equation 10.12 with tau_dist = m g r."""
        pd = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0)
        assert pd.steady_state_error("disturbance", 0.981) == pytest.approx(0.981 / 2.205)
        assert pd.replaced(ki=1.0).steady_state_error("disturbance", 0.981) == 0.0

    def test_figure_10_6_runs_end_where_the_statics_says(self) -> None:
        """From -pi/2 to 0 in gravity: Kp e = m g r cos(theta) is left by PD, and nothing by PID."""
        arm = taut.load_arm("one_joint")
        ctrl = taut.compile(taut.laws.PID(kp=2.205, kd=2.0, ki=0.0), arm, rate=1000.0)
        left = brentq(lambda e: 2.205 * e - 0.981 * math.cos(e), 0.0, 1.0)
        for ki, expected in ((0.0, left), (1.0, 0.0)):
            ctrl.parameters["law.ki"] = ki
            run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.0]), duration=20.0, q0=[-0.5 * math.pi])
            assert -run.q[-1, 0] == pytest.approx(expected, abs=2e-4)
        linear = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0).steady_state_error(
            "disturbance", 0.981 * math.cos(left)
        )
        assert linear == pytest.approx(left)

    def test_the_integral_does_not_take_away_the_error_of_a_sine(self) -> None:
        pd = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0)
        s = 2j * math.pi * 0.5
        without = abs((0.5 * s**2 + 0.1 * s) / (0.5 * s**2 + 2.1 * s + 2.205))
        having = abs((0.5 * s**3 + 0.1 * s**2) / (0.5 * s**3 + 2.1 * s**2 + 2.205 * s + 1.0))
        assert pd.sine_error(0.5) == pytest.approx(without)
        assert pd.replaced(ki=1.0).sine_error(0.5) == pytest.approx(having)
        assert having > 0.9 * without


class TestTheResponse:
    @pytest.mark.parametrize("off", [0.0, 1e-15, -1e-15, 1e-12, -1e-12, 1e-8, -1e-8, 1e-4, -1e-4, 0.3, -0.3, 20.0])
    @pytest.mark.parametrize(("e0", "v0"), [(1.0, 0.0), (0.3, -2.0), (0.0, 1.0)])
    def test_of_every_damping_is_that_of_fifty_digits(self, off: float, e0: float, v0: float) -> None:
        zeta, w = 1.0 + off, 7.3
        a = [0.5, zeta * w, 0.5 * w * w]
        t = np.array([0.0, 1e-9, 0.01, 0.13, 0.5, 1.0, 2.0, 4.0])
        e, v = taut.analysis.ErrorDynamics(coefficients=a).response(t, e0, v0)
        exact = np.array([exact_response(*a, e0, v0, each) for each in t])
        scale = abs(e0) + abs(v0) / w
        np.testing.assert_allclose(e, exact[:, 0], rtol=1e-11, atol=1e-14 * scale)
        np.testing.assert_allclose(v, exact[:, 1], rtol=1e-11, atol=1e-14 * scale * w)

    def test_of_a_hundred_million_times_critical_damping_is_a_slow_exponential(self) -> None:
        d = taut.analysis.second_order(omega_n=1.0, zeta=1e8)
        assert float(d.response(2e8)[0]) == pytest.approx(math.exp(-1.0), rel=1e-12)

    @pytest.mark.parametrize(
        ("coefficients", "integral"),
        [([0.5, 2.1, 2.205, 1.0], True), ([1.0, 6.0, 12.0, 8.0], False), ([2.0, 3.0], False)],
    )
    def test_of_other_orders_is_that_of_an_integrator(self, coefficients: list[float], integral: bool) -> None:
        d = taut.analysis.ErrorDynamics(coefficients=coefficients, integral=integral)
        n, a = d.order, np.array(coefficients)

        def rate(_: float, x: np.ndarray) -> np.ndarray:
            return np.append(x[1:], -(a[:0:-1] @ x) / a[0])

        start = np.zeros(n)
        start[int(integral)] = 1.3
        times = np.linspace(0.0, 5.0, 11)
        x = solve_ivp(rate, (0.0, 5.0), start, t_eval=times, rtol=1e-11, atol=1e-13).y
        e, v = d.response(times, 1.3)
        np.testing.assert_allclose(e, x[int(integral)], atol=1e-9)
        np.testing.assert_allclose(v, -1.5 * x[0] if n == 1 else x[int(integral) + 1], atol=1e-9)

    @pytest.mark.parametrize(
        "zeta", [0.02, 0.2, 0.5286, 0.77, 0.7797, 0.78, 0.95, 0.9999999, 1.0, 1.0000001, 3.0, 50.0]
    )
    def test_settling_is_the_last_time_at_two_percent(self, zeta: float) -> None:
        d = taut.analysis.second_order(omega_n=3.0, zeta=zeta)
        t = d.settling_time
        assert abs(float(d.response(t)[0])) == pytest.approx(0.02, rel=1e-9)
        later = np.linspace(t, 3.0 * t, 200_000)[1:]
        assert np.abs(d.response(later)[0]).max() < 0.02
        assert abs(float(d.response(t * (1.0 - 1e-6))[0])) > 0.02

    @pytest.mark.parametrize("zeta", [1e-6, 0.05, 0.4, 0.78, 1.0, 2.5])
    def test_the_search_for_any_order_finds_what_the_closed_form_says(self, zeta: float) -> None:
        d = taut.analysis.second_order(omega_n=5.0, zeta=zeta)
        far = taut.analysis.ErrorDynamics(coefficients=np.polymul(d.coefficients, [1.0, 1e7]))
        for name in ("settling_time", "overshoot", "rise_time", "peak_time"):
            expected, got = getattr(d, name), getattr(far, name)
            assert got == pytest.approx(expected, rel=1e-5, abs=1e-9, nan_ok=True), name

    def test_of_velocity_input_control_is_that_of_section_11_3(self) -> None:
        """e_dot + kp e + ki int(e) = 0 with a double pole: e = (1 - p t) exp(-p t), which overshoots by exp(-2)."""
        d = taut.analysis.ErrorDynamics(coefficients=[1.0, 20.0, 100.0], integral=True)
        t = np.linspace(0.0, 1.0, 11)
        np.testing.assert_allclose(d.response(t)[0], (1.0 - 10.0 * t) * np.exp(-10.0 * t), atol=1e-13)
        assert d.overshoot == pytest.approx(100.0 * math.exp(-2.0))
        assert d.step.peak_time == pytest.approx(0.2)

    def test_what_does_not_settle_says_so(self) -> None:
        for coefficients in ([1.0, 0.0, 4.0], [1.0, -1.0, 4.0], [1.0, 1.0, 1.0, 5.0]):
            d = taut.analysis.ErrorDynamics(coefficients=coefficients, reference=[1.0], disturbance=[1.0])
            assert d.settling_time == math.inf
            assert d.settling_by_rule == math.inf
            assert math.isnan(d.overshoot)
            assert d.steady_state_error() is None
            assert d.sine_error(1.0) is None
            assert "not stable" in str(d)


class TestSteadyState:
    @pytest.mark.parametrize(
        ("ki", "to", "expected"),
        [
            (0.0, "step", 0.0), (0.0, "ramp", 0.1 / 2.205), (0.0, "parabola", math.inf), (0.0, "disturbance", 1 / 2.205),
            (1.0, "ramp", 0.0), (1.0, "parabola", 0.1), (1.0, "disturbance", 0.0),
        ],
    )  # fmt: skip
    def test_is_the_final_value(self, ki: float, to: str, expected: float) -> None:
        d = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0, ki=ki)
        assert d.steady_state_error(to) == pytest.approx(expected)

    def test_is_what_simulation_tends_to(self) -> None:
        """A ramp and a parabola followed by PID, integrated."""
        for ki, power in ((0.0, 1), (1.0, 2)):
            d = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0, ki=ki)

            def rate(t: float, x: np.ndarray, ki: float = ki, power: int = power) -> list[float]:
                wanted, moving = t**power / power, t ** (power - 1)
                e = wanted - x[0]
                tau = 2.205 * e + ki * x[2] + 2.0 * (moving - x[1])
                return [x[1], (tau - 0.1 * x[1]) / 0.5, e]

            end = solve_ivp(rate, (0.0, 40.0), np.zeros(3), rtol=1e-10, atol=1e-12).y[0, -1]
            assert 40.0**power / power - end == pytest.approx(
                d.steady_state_error(("ramp", "parabola")[power - 1]), abs=1e-6
            )

    def test_feedback_linearisation_follows_any_motion(self) -> None:
        d = taut.analysis.second_order(omega_n=10.0, zeta=0.7)
        assert [d.steady_state_error(to) for to in ("step", "ramp", "parabola")] == [0.0, 0.0, 0.0]
        assert d.sine_error(3.0) == 0.0
        assert d.steady_state_error("disturbance") == pytest.approx(0.01)


class TestSpecifications:
    @pytest.mark.parametrize("joint", [CHAPTER, {"M": 3.0}, {}])
    @pytest.mark.parametrize(
        "pair",
        [("kp", "kd"), ("kp", "zeta"), ("kp", "overshoot"), ("kp", "settling"), ("kd", "zeta"), ("kd", "omega_n"),
         ("kd", "overshoot"), ("kd", "settling"), ("zeta", "omega_n"), ("zeta", "settling"),
         ("overshoot", "omega_n"), ("overshoot", "settling"), ("settling", "omega_n")],
    )  # fmt: skip
    def test_every_pair_gives_back_the_dynamics_it_was_read_from(
        self, joint: dict[str, float], pair: tuple[str, str]
    ) -> None:
        wanted = taut.analysis.second_order(**joint, omega_n=6.0, zeta=0.85)
        numbers = {
            "kp": wanted.kp, "kd": wanted.kd, "zeta": 0.85, "omega_n": 6.0,
            "settling": wanted.settling_time, "overshoot": wanted.overshoot,
        }  # fmt: skip
        got = taut.analysis.second_order(**joint, **{name: numbers[name] for name in pair})
        assert (got.kp, got.kd) == pytest.approx((wanted.kp, wanted.kd), rel=1e-9)

    def test_the_fastest_for_its_natural_frequency_is_found_at_its_border(self) -> None:
        best = settling_angle(FASTEST * (1.0 + 1e-12))
        d = taut.analysis.second_order(omega_n=1.0, settling=best)
        assert d.zeta == pytest.approx(FASTEST, rel=1e-6)

    @pytest.mark.parametrize(
        ("given", "sentence"),
        [
            ({}, "two of kp, kd, zeta, omega_n, settling and overshoot determine second-order error dynamics; got too few: none; add two of them"),
            ({"kp": 1.0}, "two of kp, kd, zeta, omega_n, settling and overshoot determine second-order error dynamics; got too few: kp; add one of kd, zeta, settling, overshoot"),
            ({"kp": 1.0, "kd": 1.0, "zeta": 1.0}, "two of kp, kd, zeta, omega_n, settling and overshoot determine second-order error dynamics; got more than two: kp, kd and zeta; leave out zeta"),
            ({"kp": 1.0, "omega_n": 1.0}, "kp and omega_n say the same thing twice, for each follows from the other; leave one of them out"),
            ({"zeta": 1.0, "overshoot": 5.0}, "zeta and overshoot say the same thing twice, for each follows from the other; leave one of them out"),
            ({"zeta": -1.0, "omega_n": 1.0}, r"zeta must be >= 0; got -1.0"),
            ({"zeta": 1.0, "omega_n": 0.0}, r"omega_n must be > 0 \[rad/s\]; got 0.0"),
            ({"overshoot": 100.0, "omega_n": 1.0}, "overshoot must be below 100 %, which is that of no damping; got 100"),
            ({"zeta": 0.0, "settling": 1.0}, "zeta must be > 0 for a settling time: without damping nothing settles"),
            ({"zeta": 0.0, "kd": 1.0}, "zeta must be > 0 where kd = 1 is given: no kp takes the damping away"),
            ({"omega_n": 1.0, "settling": 3.0}, r"settling must be at least 3.603 s, which is the fastest for omega_n = 1 rad/s, with zeta = 0.78; got 3 s"),
            ({"kd": 2.0, "settling": 1.0}, r"settling must be at least 2.809 s, which is the fastest for kd = 2, with zeta = 0.78; got 1 s"),
            ({"b": 1.0, "kp": 1.0, "kd": 1.0}, r"b is a friction \[N m s/rad\] and needs the inertia M= beside it; give M, or leave b out"),
            ({"M": 1.0, "b": 4.0, "omega_n": 1.0, "zeta": 1.0}, "zeta must be at least 2, which the friction b = 4 alone gives with kp = 1; got 1; a larger kp or omega_n allows less"),
            ({"M": -1.0, "kp": 1.0, "kd": 1.0}, r"M must be > 0 \[kg m\^2\]; got -1.0"),
            ({"kp": 1.0, "kd": 1.0, "ki": -1.0}, r"ki must be >= 0 \[N m/\(rad s\)\]; got -1.0"),
        ],
    )  # fmt: skip
    def test_what_does_not_determine_it_or_cannot_be_is_refused_in_a_sentence(
        self, given: dict[str, float], sentence: str
    ) -> None:
        with pytest.raises(taut.TautError, match=f"^{sentence}$"):
            taut.analysis.second_order(**given)


class TestWaysIn:
    def test_from_poles_places_them(self) -> None:
        d = taut.analysis.ErrorDynamics.from_poles([-4.0 + 3.0j, -4.0 - 3.0j, -2.0], integral=True)
        assert (d.kp, d.kd, d.ki) == pytest.approx((41.0, 10.0, 50.0))
        np.testing.assert_allclose(d.poles, [-2.0, -4.0 + 3.0j, -4.0 - 3.0j], rtol=1e-12)

    def test_from_a_matrix_keeps_double_poles_double(self) -> None:
        d = taut.analysis.ErrorDynamics.from_matrix([[0.0, 1.0], [-100.0, -20.0]])
        assert d.poles.tolist() == [-10.0, -10.0]
        rng = np.random.default_rng(0)
        A = rng.normal(size=(6, 6))
        np.testing.assert_allclose(
            taut.analysis.ErrorDynamics.from_matrix(A).coefficients, np.poly(A), rtol=1e-9, atol=1e-12
        )

    @pytest.mark.parametrize(
        ("make", "sentence"),
        [
            (lambda: taut.analysis.ErrorDynamics.from_poles([-1.0 + 1.0j]), "complex poles must come in conjugate pairs; give -a [+] jb and -a - jb"),
            (lambda: taut.analysis.ErrorDynamics.from_poles([math.nan]), r"poles must be finite \[1/s\]"),
            (lambda: taut.analysis.ErrorDynamics.from_matrix([[1.0, 2.0]]), r"A must be a square matrix; got shape \(1, 2\)"),
            (lambda: taut.analysis.ErrorDynamics(coefficients=[1.0, 2.0], reference=[1.0, 2.0, 3.0]), r"reference must be a numerator of at most 2 coefficients, as many as the characteristic polynomial has; got shape \(3,\)"),
            (lambda: taut.analysis.ErrorDynamics(coefficients=[1.0, 2.0], integral=True), "integral=True needs dynamics of the second order or higher"),
            (lambda: taut.analysis.ErrorDynamics(coefficients=[1.0, 2.0]).steady_state_error(), "a characteristic polynomial alone does not tell what a reference does; give reference=, the numerator of the error over it, or make the dynamics with taut.analysis.second_order"),
            (lambda: taut.analysis.ErrorDynamics(coefficients=[1.0, 2.0]).kp, "dynamics of the second order, or of the third with integral=True, have the gains kp, kd and ki; these are of order 1"),
            (lambda: taut.analysis.ErrorDynamics(coefficients=[1.0, 2.0]).response(1.0, v0=1.0), "first-order dynamics start at any e0, and v0 follows from it; leave v0 out"),
            (lambda: taut.analysis.ErrorDynamics(coefficients=[1.0, 2.0, 3.0, 1.0]).zeta, "zeta is a number of second-order error dynamics, and these are of order 3; damping_ratios and natural_frequencies have one for each pole"),
            (lambda: taut.analysis.second_order(kp=1.0, kd=1.0).replaced(mass=1.0), r"replaced\(\) takes M, b, kp, kd and ki; got 'mass'"),
        ],
    )  # fmt: skip
    def test_what_makes_no_dynamics_is_refused_in_a_sentence(self, make: object, sentence: str) -> None:
        with pytest.raises(taut.TautError, match=f"^{sentence}$"):
            make()  # type: ignore[operator]


class TestPythonControl:
    control = pytest.importorskip("control")

    @pytest.mark.parametrize(
        "given",
        [
            {"omega_n": 4.0, "zeta": 0.3},
            {"omega_n": 4.0, "zeta": 1.4},
            {**CHAPTER, "kp": 2.205, "kd": 2.0, "ki": 1.0},
        ],
    )
    def test_its_step_info_gives_our_numbers(self, given: dict[str, float]) -> None:
        d = taut.analysis.second_order(**given)
        times = np.linspace(0.0, 2.0 * d.settling_time, 40_001)
        info = self.control.step_info(d.to_control(), T=times)
        assert info["Overshoot"] == pytest.approx(d.overshoot, abs=1e-3)
        assert info["SettlingTime"] == pytest.approx(d.settling_time, abs=2.0 * times[1])
        assert info["RiseTime"] == pytest.approx(d.rise_time, abs=2.0 * times[1])
        np.testing.assert_allclose(np.sort_complex(d.to_control().poles()), np.sort_complex(d.poles), rtol=1e-9)

    def test_a_closed_loop_of_python_control_comes_in(self) -> None:
        plant, pid = self.control.tf([1.0], [0.5, 0.1, 0.0]), self.control.tf([2.0, 2.205, 1.0], [1.0, 0.0])
        closed = self.control.feedback(plant * pid)
        ours = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0, ki=1.0)
        for system in (closed, self.control.ss(closed)):
            d = taut.analysis.ErrorDynamics.of(system)
            np.testing.assert_allclose(d.poles, ours.poles, rtol=1e-6)
            assert d.steady_state_error("parabola") == pytest.approx(0.1, rel=1e-6)
            assert d.sine_error(0.5) == pytest.approx(ours.sine_error(0.5), rel=1e-9)

    @pytest.mark.parametrize(
        ("numerator", "denominator"),
        [
            ([2.205, 1.0], [0.5, 2.1, 2.205, 1.0]),  # PID whose derivative does not see the goal
            ([2.0, 2.205, 1.0], [0.5, 2.1, 2.205, 1.0]),  # one whose derivative does
            ([14.0, 100.0], [1.0, 14.0, 100.0]),
            ([14.0, 50.0], [1.0, 14.0, 100.0]),  # it ends at half of its goal
            ([3.0, 1.0], [1.0, 3.0, 3.0, 1.0]),
            ([-0.1, 1.0], [1.0, 2.0, 1.0]),  # it begins the wrong way
            ([1.0], [1.0, 3.0, 3.0, 1.0]),
            ([2.0, 1.0, 7.0, 5.0], [1.0, 6.0, 15.0, 20.0, 5.0]),
        ],
    )
    def test_a_step_of_what_comes_in_is_that_of_step_info(
        self, numerator: list[float], denominator: list[float]
    ) -> None:
        system = self.control.tf(numerator, denominator)
        d = taut.analysis.ErrorDynamics.of(system)
        times = np.linspace(0.0, 1.5 * d.settling_time, 60_001)
        info = self.control.step_info(system, T=times)
        assert d.overshoot == pytest.approx(info["Overshoot"], abs=2e-3)
        assert d.settling_time == pytest.approx(info["SettlingTime"], abs=3.0 * times[1])
        assert d.rise_time == pytest.approx(info["RiseTime"], abs=3.0 * times[1])
        y = self.control.step_response(system, times).outputs
        e, v = d.response(times[::600], 2.0)
        np.testing.assert_allclose(e, 2.0 * (1.0 - y[::600]), atol=1e-9)
        assert v[1:-1] == pytest.approx(-2.0 * np.gradient(y, times)[600:-1:600], abs=1e-5)
        back = d.to_control()
        np.testing.assert_allclose(back.num[0][0], system.num[0][0])
        np.testing.assert_allclose(back.den[0][0], system.den[0][0])

    def test_gains_go_out_and_come_in_again(self) -> None:
        d = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0, ki=1.0)
        again = taut.analysis.ErrorDynamics.of(d.to_control())
        assert again.step == d.step
        assert (again.ki, again.kp, again.kd) == pytest.approx((2.0, 4.41, 4.2))  # of an inertia of 1: over 0.5

    @pytest.mark.parametrize("of", ["reference", "disturbance"])
    def test_its_frequency_response_is_ours(self, of: str) -> None:
        d = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0, ki=1.0)
        omega = np.geomspace(0.1, 100.0, 20)
        theirs = self.control.frequency_response(d.to_control(of), omega).complex
        np.testing.assert_allclose(d.error_response(omega, of), np.ravel(theirs), rtol=1e-12)

    @pytest.mark.parametrize(
        ("system", "sentence"),
        [
            (3.0, r"a system is a control.TransferFunction or a control.StateSpace; got float"),
            (control.tf([1.0], [1.0, 0.5], 0.01), r"error dynamics are in continuous time, and this system has the period 0.01; taut.analysis.locus and taut.analysis.stability_map take it as it is"),
            (control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))), r"a closed loop from desired to actual position has one input and one output; this has 2 and 2; take one: system\[0, 0\]"),
            (control.tf([2.0], [1.0]), "a closed loop has poles, and no more zeros than these; got 0 poles and 0 zeros"),
        ],
    )  # fmt: skip
    def test_what_is_no_closed_loop_is_refused(self, system: object, sentence: str) -> None:
        with pytest.raises(taut.errors.UsageError, match=f"^{sentence}$"):
            taut.analysis.ErrorDynamics.of(system)

    def test_without_the_library_a_sentence_says_what_installs_it(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "control", None)
        with pytest.raises(
            taut.errors.MissingExtraError,
            match=r"a system of python-control needs the package 'control'.*\[control\]",
        ):
            taut.analysis.second_order(omega_n=1.0, zeta=1.0).to_control()


def test_reports_are_those_on_the_page() -> None:
    page = (Path(__file__).parents[2] / "docs" / "error_dynamics.md").read_text(encoding="utf-8")
    late = taut.analysis.second_order(**CHAPTER, kd=120.0, zeta=1.0).sampled(rate=100.0)
    for shown in (
        taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0, ki=1.0), taut.analysis.routh([1.0, 1.0, 2.0, 2.0, 3.0]), late,
    ):  # fmt: skip
        assert indent(str(shown), "    ") in page
    assert late.report() == str(late)


def test_reports_have_words_for_what_is_not() -> None:
    assert str(taut.analysis.second_order(kp=0.0, kd=0.0)).splitlines() == [
        "error dynamics s^2 = 0",
        "  not stable       2 roots on the imaginary axis",
        "  poles            0, 0 1/s",
        "  gains            kp = 0, kd = 0, ki = 0; no ki is stable with these",
    ]
    assert "settling, 2 %    2.608 s exactly; 4 tau: 2.667 s" in str(
        taut.analysis.ErrorDynamics(coefficients=[2.0, 3.0])
    )
    swinging = taut.analysis.second_order(omega_n=1.0, zeta=1e-9).sampled(
        rate=100.0, velocity=taut.sensors.LowPass(cutoff=20.0)
    )
    assert "not stable" in str(swinging.replaced(kd=0.0))


def test_its_picture_shows_both_settling_times_and_the_poles() -> None:
    for d in (
        taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0, ki=1.0),
        taut.analysis.ErrorDynamics(coefficients=[1.0, -1.0, 4.0]),
    ):
        left, right = d.plot().axes
        words = [text.get_text() for text in left.get_legend().get_texts()] if left.get_legend() else []
        assert words == (["settled, 6.43 s", "4 tau, 6.28 s"] if d.stable else [])
        shown = {line.get_marker(): line for line in right.lines}["x"]
        np.testing.assert_allclose(shown.get_xdata() + 1j * shown.get_ydata(), d.poles)
