"""Section 10.2.1: the closed loops of a single joint, as they really follow in a sampled simulation.

The simulated loop is compared with the loop discretised as it is simulated: zero-order hold of the torque, semi-implicit
Euler with viscous friction taken implicitly. That it tends to the chapter's continuous design is a test of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from runtime_laws import Array
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import taut
from taut.arm.builtin import one_joint

M, MGR, B = 0.5, 1.0 * 9.81 * 0.1, 0.1  # the chapter's link: kg m^2, N m, N m s/rad
VERTICAL = taut.load_arm("one_joint")
FLAT = taut.load_arm("one_joint", gravity=[0.0, 0.0, 0.0])
ZERO = taut.JointMotion(q=[0.0])
FITTED = 1e-6  # a fit to a run without noise; the demand is 1 %


def loop_matrix(dt: float, kp: float, kd: float, ki: float = 0.0, b: float = B) -> Array:
    """One tick of (q, v, integral of e) around the goal 0 without gravity.

    tau = -kp q - kd v + ki (e_int - q dt);  v+ = v + dt (tau - b v) / (M + dt b);  q+ = q + dt v+
    """
    D = M + dt * b
    v = np.array([-dt * (kp + ki * dt) / D, 1.0 - dt * (kd + b) / D, dt * ki / D])
    return np.array([np.array([1.0, 0.0, 0.0]) + dt * v, v, [-dt, 0.0, 1.0]])


def poles(A: Array, dt: float) -> Array:
    """Eigenvalues of a tick as poles in continuous time, slowest first."""
    s = np.log(np.linalg.eigvals(A).astype(complex)) / dt
    return s[np.argsort(-s.real)]


def fitted(q: Array, order: int, dt: float) -> Array:
    """Poles of the linear recurrence that a response obeys, by least squares."""
    columns = np.column_stack([q[i : len(q) - order + i] for i in range(order)])
    c = np.linalg.lstsq(columns, q[order:], rcond=None)[0]
    s = np.log(np.roots([1.0, *(-c[::-1])]).astype(complex)) / dt
    return s[np.argsort(-s.real)]


def response(
    law: taut.Law, arm: taut.Arm = FLAT, rate: float = 1000.0, duration: float = 2.0, **options: Any
) -> taut.Run:
    options.setdefault("q0", [0.01])
    return taut.run(taut.compile(law, arm, rate=rate), taut.RigidPlant(arm), ZERO, duration=duration, **options)


class TestPD:
    """Equation 10.8: M e_ddot + (b + kd) e_dot + kp e = 0, and figure 10.5's three kinds of roots."""

    @pytest.mark.parametrize(
        ("kp", "kd"),
        [(2.205, 2.0), (20.0, 2.0), (1.0, 2.0), (51.0, 10.0), (50.0, 9.9), (11.3, 10.0)],
        ids=["critical", "underdamped", "overdamped", "critical 10", "double pole -10", "zeta 2"],
    )
    @pytest.mark.parametrize("rate", [1000.0, 200.0])
    def test_has_the_poles_of_the_sampled_loop(self, kp: float, kd: float, rate: float) -> None:
        out = response(taut.laws.PID(kp=kp, kd=kd), rate=rate)
        expected = poles(loop_matrix(1.0 / rate, kp, kd)[:2, :2], 1.0 / rate)
        np.testing.assert_allclose(fitted(out.q[:, 0], 2, 1.0 / rate), expected, rtol=FITTED)

    def test_splits_a_double_pole_as_the_square_root_of_the_tick(self) -> None:
        """kp 100, kd 20 for unit inertia at 1 kHz: -9.09 and -11.11 instead of -10 twice."""
        found = fitted(response(taut.laws.ComputedTorque(kp=100.0, kd=20.0), b_free()).q[:, 0], 2, 1e-3)
        np.testing.assert_allclose(found.real, [-9.09, -11.11], atol=0.005)

    def test_tends_to_the_design_as_the_tick_falls(self) -> None:
        """Away from double poles to first order: ten times the rate, a tenth of the error."""
        design = np.roots([M, B + 2.0, 20.0])[0]
        errors = []
        for rate in (100.0, 1000.0, 10000.0):
            found = fitted(response(taut.laws.PID(kp=20.0, kd=2.0), rate=rate).q[:, 0], 2, 1.0 / rate)
            errors.append(np.abs(found - design).min() / np.abs(design))
        assert errors[2] < 1e-3
        np.testing.assert_allclose(np.array(errors[:2]) / errors[1:], 10.0, rtol=0.1)

    def test_overshoots_as_the_chapter_says(self) -> None:
        """exp(-pi zeta / sqrt(1 - zeta^2)), at a rate at which the sampled loop is the design to 0.1 %."""
        zeta = (B + 2.0) / (2.0 * np.sqrt(20.0 * M))
        out = response(taut.laws.PID(kp=20.0, kd=2.0), rate=20000.0, duration=4.0, q0=[-1.0])
        expected = 100.0 * np.exp(-np.pi * zeta / np.sqrt(1.0 - zeta**2))
        assert out.metrics.overshoot[0] == pytest.approx(expected, rel=1e-3)


def b_free() -> taut.Arm:
    return FLAT.with_joints(viscous=0.0)


class TestFigure106:
    """kd = 2, kp = 2.205 (critical), ki = 1; from rest at -pi/2 to 0, in gravity."""

    PD = taut.laws.PID(kp=2.205, kd=2.0)
    PID = taut.laws.PID(kp=2.205, kd=2.0, ki=1.0)

    def run(self, law: taut.Law, duration: float = 30.0) -> taut.Run:
        return response(law, VERTICAL, duration=duration, q0=[-0.5 * np.pi])

    def test_pd_rests_where_the_spring_balances_gravity(self) -> None:
        """Equation 10.11: kp e = m g r cos(theta), e = -theta."""
        out = self.run(self.PD)
        e = brentq(lambda e: 2.205 * e - MGR * np.cos(-e), 0.0, 1.0)
        assert out.error[-1, 0] == pytest.approx(e, rel=1e-9)
        assert out.metrics.steady_state_error[0] == pytest.approx(100.0 * e / (0.5 * np.pi), rel=1e-6)

    def test_pid_leaves_no_error_and_overshoots(self) -> None:
        out = self.run(self.PID, duration=60.0)
        assert abs(out.error[-1, 0]) < 1e-6
        assert out.terms["I"][-1, 0] == pytest.approx(MGR, rel=1e-5)  # the integral holds the link
        assert out.metrics.overshoot[0] > 5.0  # "significant overshoot"
        assert self.run(self.PD).metrics.overshoot[0] < 0.2

    def test_is_the_motion_that_scipy_gives(self) -> None:
        """Equation 10.3 under 10.6, in continuous time; the sampled loop differs by the order of a tick."""

        def rates(_: float, x: Array) -> list[float]:
            q, v, e_int = x
            tau = -2.205 * q - 2.0 * v + 1.0 * e_int
            return [v, (tau - MGR * np.cos(q) - B * v) / M, -q]

        at = np.linspace(0.0, 10.0, 101)
        exact = solve_ivp(rates, (0.0, 10.0), [-0.5 * np.pi, 0.0, 0.0], t_eval=at, rtol=1e-10, atol=1e-12).y[0]
        ctrl = taut.compile(self.PID, VERTICAL, rate=10000.0)
        out = taut.run(ctrl, taut.RigidPlant(VERTICAL), ZERO, duration=10.0, q0=[-0.5 * np.pi])
        assert np.abs(out.q[::1000, 0] - exact).max() < 2e-4


class TestTheBoundOnTheIntegralGain:
    """Equation 10.14: stable for ki < (b + kd) kp / M; the sampled loop's own border is a little elsewhere."""

    KP, KD = 2.205, 2.0
    CHAPTER = (B + 2.0) * 2.205 / M

    def border(self, dt: float) -> float:
        return float(brentq(lambda ki: self.radius(dt, ki) - 1.0, 0.2 * self.CHAPTER, 2.0 * self.CHAPTER))

    def radius(self, dt: float, ki: float) -> float:
        return float(np.abs(np.linalg.eigvals(loop_matrix(dt, self.KP, self.KD, ki))).max())

    def growth(self, dt: float, ki: float) -> float:
        """Ratio of the amplitude late in the run to that early."""
        law = taut.laws.PID(kp=self.KP, kd=self.KD, ki=ki)
        out = response(law, rate=1.0 / dt, duration=80.0, q0=[0.001])
        late, early = out.q[out.t > 60.0], out.q[(out.t > 10.0) & (out.t < 30.0)]
        return float(np.abs(late).max() / np.abs(early).max())

    @pytest.mark.parametrize("dt", [1e-3, 1e-2, 4e-2])
    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_is_where_the_eigenvalues_of_the_tick_say(self, dt: float) -> None:
        border = self.border(dt)
        assert self.growth(dt, 0.99 * border) < 1.0 < self.growth(dt, 1.01 * border)

    def test_tends_to_the_chapters(self) -> None:
        off = [self.border(dt) / self.CHAPTER - 1.0 for dt in (1e-2, 1e-3)]
        assert abs(off[1]) < 5e-3
        assert off[0] / off[1] == pytest.approx(10.0, rel=0.2)

    def test_the_roots_of_a_stable_loop_are_those_of_the_tick(self) -> None:
        out = response(taut.laws.PID(kp=self.KP, kd=self.KD, ki=1.0), rate=100.0, duration=10.0)
        found, expected = fitted(out.q[:, 0], 3, 0.01), poles(loop_matrix(0.01, self.KP, self.KD, 1.0), 0.01)
        np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(expected), rtol=1e-5)


# -------------------------------------------------------------------- feedforward, figures 10.10 and 10.12

WRONG = one_joint(r=0.08)  # the controller's model: r-hat = 0.08 m, and r = 0.1 m
FEEDFORWARD = taut.laws.FeedForward() + taut.laws.FrictionCompensation()  # the chapter's h includes b v


def follow(law: taut.Law, center: float, model: taut.Arm = WRONG, rate: float = 1000.0) -> taut.Run:
    """theta_d = center - cos(t) for 0 <= t <= pi, from the right start."""
    ref = taut.trajectories.Sine(center=[center], amplitude=1.0, frequency=0.5 / np.pi, phase=-0.5 * np.pi)
    ctrl = taut.compile(law, model, rate=rate)
    start = ref.at(0.0)
    return taut.run(ctrl, taut.RigidPlant(VERTICAL), ref, duration=np.pi, q0=start.q, v0=start.v)


class TestFigure1010:
    TASK_1, TASK_2 = -0.5 * np.pi, 0.5 * np.pi

    def test_an_exact_model_follows_exactly(self) -> None:
        """To the order of the tick; ten times the rate, a tenth of the error."""
        errors = [np.abs(follow(FEEDFORWARD, self.TASK_1, VERTICAL, rate).error).max() for rate in (1e3, 1e4)]
        assert errors[0] < 2e-3
        assert errors[0] / errors[1] == pytest.approx(10.0, rel=0.1)

    def test_task_1_stays_close_and_task_2_does_not(self) -> None:
        """Unmodelled gravity is a spring to -pi/2 in task 1, and acts against the motion in task 2."""
        one, two = (np.abs(follow(FEEDFORWARD, task).error).max() for task in (self.TASK_1, self.TASK_2))
        assert one < 0.25
        assert two > 10.0 * one

    @pytest.mark.parametrize("task", [TASK_1, TASK_2])
    def test_is_the_motion_that_scipy_gives(self, task: float) -> None:
        def torque(t: float) -> float:
            q, v, a = task - np.cos(t), np.sin(t), np.cos(t)
            return float(M * a + 1.0 * 9.81 * 0.08 * np.cos(q) + B * v)

        def rates(t: float, x: Array) -> list[float]:
            return [x[1], (torque(t) - MGR * np.cos(x[0]) - B * x[1]) / M]

        out = follow(FEEDFORWARD, task, rate=10000.0)
        exact = solve_ivp(rates, (0.0, np.pi), [task - 1.0, 0.0], t_eval=out.t[::1000], rtol=1e-10, atol=1e-12).y[0]
        assert np.abs(out.q[::1000, 0] - exact).max() < 1e-3


class TestFigure1012:
    """Task 2: feedforward alone, feedback alone, and both. The PID gains of figure 10.6 read in both ways."""

    def both(self, reading: str) -> taut.Law:
        scale = (
            1.0 / M if reading == "torque gains" else 1.0
        )  # torque gains of 10.6 over M, or the same numbers in 10.19
        law = taut.laws.ComputedTorque(kp=2.205 * scale, kd=2.0 * scale, ki=1.0 * scale)
        return law + taut.laws.FrictionCompensation(at="meas")

    @pytest.mark.parametrize("reading", ["torque gains", "acceleration gains"])
    def test_both_track_better_than_either_with_less_effort_than_feedback_alone(self, reading: str) -> None:
        task = TestFigure1010.TASK_2
        laws = {"ff": FEEDFORWARD, "fb": taut.laws.PID(kp=2.205, kd=2.0, ki=1.0), "ff+fb": self.both(reading)}
        metrics = {name: follow(law, task).metrics.overall for name, law in laws.items()}
        for measure in ("rms_error", "peak_error"):
            assert metrics["ff+fb"](measure) < 0.3 * metrics["fb"](measure) < 0.3 * metrics["ff"](measure)
        assert metrics["ff+fb"]("effort") < 0.8 * metrics["fb"]("effort")


# -------------------------------------------------------------------- saturation


class TestAntiWindup:
    """A step of 3 rad under 0.5 N m: while the torque is cut the integral must not grow."""

    def run(self, scheme: Any, ki: float) -> taut.Run:
        law = taut.laws.PID(kp=5.0, kd=2.0, ki=ki, integral=taut.laws.Integral(anti_windup=scheme))
        ctrl = taut.compile(law, FLAT, limits=taut.Limits(tau=0.5))
        out = taut.run(ctrl, taut.RigidPlant(FLAT), ZERO, duration=40.0, q0=[-3.0])
        np.testing.assert_allclose(np.abs(out.tau).max(), 0.5, rtol=1e-12)
        return out

    def test_clamping_bounds_the_overshoot_where_none_winds_up(self) -> None:
        """The 22 % that are left are those of the saturated PD controller, which brakes too late."""
        clamped, wound, without = self.run("clamping", 1.0), self.run("none", 1.0), self.run("clamping", 0.0)
        assert clamped.metrics.overshoot[0] < without.metrics.overshoot[0] + 1.0
        assert wound.metrics.overshoot[0] > 2.5 * clamped.metrics.overshoot[0]
        assert abs(clamped.error[-1, 0]) < 1e-4

    def test_clamping_comes_to_rest_where_none_swings_ever_further(self) -> None:
        """ki = 4 is a fifth of what the linear loop can take."""
        assert abs(self.run("clamping", 4.0).error[-1, 0]) < 1e-9
        assert abs(self.run("none", 4.0).error[-1, 0]) > 3.0

    def test_without_limits_the_two_are_the_same_loop(self) -> None:
        runs = []
        for scheme in ("clamping", "none"):
            law = taut.laws.PID(kp=5.0, kd=2.0, ki=4.0, integral=taut.laws.Integral(anti_windup=scheme))  # type: ignore[arg-type]
            runs.append(response(law, duration=1.0, q0=[-3.0]).q)
        np.testing.assert_array_equal(runs[0], runs[1])


def test_velocity_control_has_the_pole_of_its_gain() -> None:
    """e_dot + kp e = 0, held over a tick and behind a drive of 2000 rad/s: the exact map of both."""
    kp, omega, dt = 8.0, 2000.0, 1e-2
    plant = taut.RigidPlant(FLAT, takes="velocity", actuation=taut.drives.Actuation(bandwidth=omega))
    ctrl = taut.compile(taut.laws.VelocityPI(kp=kp), FLAT, rate=1.0 / dt)
    out = taut.run(ctrl, plant, ZERO, duration=1.0, q0=[0.5])
    E = np.exp(-omega * dt)
    lag = (1.0 - E) / omega
    A = np.array([[1.0 - kp * (dt - lag), lag], [-kp * (1.0 - E), E]])
    states = np.column_stack([out.q[:, 0], out.v[:, 0]])
    np.testing.assert_allclose(states[1:], states[:-1] @ A.T, rtol=0.0, atol=1e-13)
    assert fitted(out.q[:, 0], 1, dt)[0].real == pytest.approx(-kp, rel=0.06)
    ctrl = taut.compile(taut.laws.VelocityPI(kp=kp), FLAT, rate=2000.0)
    often = taut.run(ctrl, plant, ZERO, duration=0.5, q0=[0.5])
    assert fitted(often.q[100:, 0], 1, 5e-4)[0].real == pytest.approx(-kp, rel=0.01)


def test_velocity_control_with_integral_removes_what_a_ramp_leaves() -> None:
    """Without feedforward a ramp leaves v / kp; the integral takes it away."""
    plant = taut.RigidPlant(FLAT, takes="velocity", actuation=taut.drives.Actuation(bandwidth=500.0))

    class Ramp:
        def at(self, t: float) -> taut.JointMotion:
            return taut.JointMotion(q=[0.4 * t])  # its v is left out on purpose

    for ki, expected in ((0.0, 0.4 / 8.0), (16.0, 0.0)):
        ctrl = taut.compile(taut.laws.VelocityPI(kp=8.0, ki=ki), FLAT)
        out = taut.run(ctrl, plant, Ramp(), duration=5.0, q0=[0.0])
        assert out.error[-1, 0] == pytest.approx(expected, abs=1e-3)
