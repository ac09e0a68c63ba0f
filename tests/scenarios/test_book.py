"""The book: its numbers against solutions of their own, its command, and what it leaves in a folder."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import control
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import taut
from taut.base.types import Float64Array
from taut.book import contents
from taut.book.multi_joint import A, Q, V
from taut.book.page import Entry, Page, Row, row
from taut.cli.main import main

M, MASS, R, B, G = 0.5, 1.0, 0.1, 0.1, 9.81
KP, KD, KI = 2.205, 2.0, 1.0
SLIPS = {  # MATHS section 1, by where the book has them
    "eq-10.36", "eq-10.37", "eq-10.10", "eq-10.27", "fig-10.5", "sec-10.2.3", "eq-10.42", "eq-10.44", "eq-10.49",
    "eq-10.31", "fig-10.14", "fig-10.12",
}  # fmt: skip
pytestmark = pytest.mark.xdist_group("book")  # one computation serves all
KINDS = ("motion", "impedance", "force")
NO_PICTURE = {"fig-10.8", "fig-10.9", "fig-10.13"}  # pseudocode


@pytest.fixture(scope="module")
def book() -> list[Page]:
    return [entry.page() for entry in contents.CONTENTS]


def rows_of(book: list[Page], name: str) -> list[Row]:
    return [each for page in book if page.entry.id == name for each in page.rows]


def computed(book: list[Page], name: str, quantity: str) -> float:
    every = rows_of(book, name)
    found = [each.computed for each in every if each.quantity.endswith(quantity)]
    found = found or [each.computed for each in every if quantity in each.quantity]
    assert len(found) == 1, (quantity, [each.quantity for each in rows_of(book, name)])
    return found[0]


def allowed(each: Row) -> float:
    return max(0.03 * abs(each.expected), 0.01 if each.expected == 0.0 else 0.0, 1e-11)


@pytest.mark.long
class TestTheWhole:
    def test_every_number_is_what_is_expected(self, book: list[Page]) -> None:
        missed = [f"{page.entry.id}: {each}" for page in book for each in page.rows if not each.ok]
        assert not missed

    def test_every_equation_and_every_figure_but_the_photograph_is_in_it(self, book: list[Page]) -> None:
        there = {page.entry.id for page in book}
        assert {f"eq-10.{k}" for k in range(1, 51)} <= there
        assert {f"fig-10.{k}" for k in range(1, 18)} - there == {"fig-10.15"}
        pictures = {page.entry.id for page in book if page.figure is not None}
        assert {name for name in there if name.startswith("fig")} - pictures == NO_PICTURE

    def test_every_slip_of_the_chapter_is_named(self, book: list[Page]) -> None:
        named = {page.entry.id for page in book for each in page.rows if each.states.startswith("slip")}
        assert named == SLIPS

    def test_what_is_expected_is_near_enough_to_mean_something(self, book: list[Page]) -> None:
        """No row may be right by being vague: 3 % of a number, or 0.01 of its unit about zero."""
        vague = [(page.entry.id, each) for page in book for each in page.rows if each.within > allowed(each)]
        assert not vague

    def test_its_content_is_whole(self, book: list[Page]) -> None:
        content = contents.Book(pages=book).content()
        assert [len(table.rows) for table in content.tables] == [len(page.rows) for page in book]
        assert all(table.note for table in content.tables if "slip" in str(table))
        assert len(content.figures) == 13


# -------------------------------------------------------------------- the link, by a Runge-Kutta of our own


def rk4(torque: Callable[..., float], q0: float, duration: float, steps: int = 4000) -> Float64Array:
    """(steps + 1, 4) angle, rate, integral of the error and of tau^2."""
    h = duration / steps

    def rate(t: float, y: Float64Array) -> Float64Array:
        tau, e = torque(t, *y[:3])
        return np.array([y[1], (tau - MASS * G * R * math.cos(y[0]) - B * y[1]) / M, e, tau**2])

    out = [np.array([q0, 0.0, 0.0, 0.0])]
    for k in range(steps):
        t, y = k * h, out[-1]
        a = rate(t, y)
        b = rate(t + 0.5 * h, y + 0.5 * h * a)
        c = rate(t + 0.5 * h, y + 0.5 * h * b)
        d = rate(t + h, y + h * c)
        out.append(y + h / 6.0 * (a + 2.0 * b + 2.0 * c + d))
    return np.array(out)


@pytest.mark.long
class TestOneJoint:
    def test_the_gains_of_figure_10_6_are_critically_damped(self, book: list[Page]) -> None:
        assert computed(book, "eq-10.9", "critical damping") == pytest.approx(2.205, rel=1e-12)
        assert computed(book, "eq-10.14", "bound of Ki") == pytest.approx(9.261, rel=1e-12)

    def test_pd_and_pid_in_gravity(self, book: list[Page]) -> None:
        e = 0.0
        for _ in range(200):  # Kp e = m g r cos(e), by iteration
            e = 0.5 * e + 0.5 * MASS * G * R * math.cos(e) / KP
        assert computed(book, "eq-10.11", "at rest") == pytest.approx(e, rel=1e-6)
        assert computed(book, "fig-10.6", "PD: error in the end") == pytest.approx(e, rel=1e-6)
        assert computed(book, "eq-10.11", "ten times as large") < 0.11 * e
        y = rk4(lambda t, q, v, s: (-KP * q + KI * s - KD * v, -q), -0.5 * math.pi, 12.0)
        assert computed(book, "fig-10.6", "PID: least error") == pytest.approx(-y[:, 0].max(), rel=1e-3)
        assert computed(book, "fig-10.6", "PID: overshoot") == pytest.approx(
            200.0 / math.pi * y[:, 0].max(), rel=1e-3
        )
        assert computed(book, "fig-10.6", "torque of Ki") == pytest.approx(KI * y[-1, 2], rel=1e-3)

    def test_the_tasks_of_figure_10_10(self, book: list[Page]) -> None:
        for number, centre in ((1, -0.5 * math.pi), (2, 0.5 * math.pi)):

            def torque(t: float, q: float, v: float, s: float, c: float = centre) -> tuple[float, float]:
                wanted = c - math.cos(t)
                tau = M * math.cos(t) + MASS * G * 0.08 * math.cos(wanted) + B * math.sin(t)
                return tau, wanted - q

            y = rk4(torque, centre - 1.0, math.pi)
            wanted = centre - np.cos(np.linspace(0.0, math.pi, len(y)))
            largest = np.abs(wanted - y[:, 0]).max()
            assert computed(book, "fig-10.10", f"Task {number}: largest error") == pytest.approx(largest, rel=1e-3)

    def test_both_readings_of_figure_10_12(self, book: list[Page]) -> None:
        def wanted(t: float) -> float:
            return 0.5 * math.pi - math.cos(t)

        def linearising(share: float) -> Callable[..., tuple[float, float]]:
            def torque(t: float, q: float, v: float, s: float) -> tuple[float, float]:
                e, e_dot = wanted(t) - q, math.sin(t) - v
                a = math.cos(t) + share * (KP * e + KI * s + KD * e_dot)
                return M * a + MASS * G * 0.08 * math.cos(q) + B * v, e

            return torque

        def feedback(t: float, q: float, v: float, s: float) -> tuple[float, float]:
            return KP * (wanted(t) - q) + KI * s + KD * (math.sin(t) - v), wanted(t) - q

        for name, torque in (
            ("fb", feedback),
            ("ff+fb, gains as accelerations", linearising(1.0)),
            ("ff+fb, gains as torques", linearising(2.0)),
        ):
            y = rk4(torque, 0.5 * math.pi - 1.0, math.pi)
            error = 0.5 * math.pi - np.cos(np.linspace(0.0, math.pi, len(y))) - y[:, 0]
            rms = math.sqrt(np.mean(error**2))
            mine = [each for each in rows_of(book, "fig-10.12") if each.quantity == f"{name}: RMS error"]
            assert mine[0].computed == pytest.approx(rms, rel=1e-3)
            assert computed(book, "fig-10.12", f"{name}: integral of tau^2") == pytest.approx(y[-1, 3], rel=2e-3)
        for each in rows_of(book, "fig-10.12"):
            if " over that of " in each.quantity:
                assert each.computed < 1.0, each.quantity  # the chapter's claims

    def test_roots_and_their_crossing_are_those_of_python_control(self, book: list[Page]) -> None:
        poles = control.tf([1.0], [M, B + KD, 5.0]).poles()
        assert computed(book, "eq-10.10", "real part of the roots") == pytest.approx(poles[0].real)
        assert computed(book, "eq-10.10", "imaginary part of the roots") == pytest.approx(abs(poles[0].imag))
        gain, _, crossing, _ = control.margin(control.tf([1.0], [M, B + KD, KP, 0.0]))  # Ki around an integral loop
        assert computed(book, "fig-10.7", "Ki at which the roots cross") == pytest.approx(gain, rel=1e-6)
        assert computed(book, "fig-10.7", "imaginary part there") == pytest.approx(crossing, rel=1e-6)

    def test_settling_is_not_four_time_constants(self, book: list[Page]) -> None:
        assert computed(book, "sec-10.2.1.1", "settling time, zeta = 1") == pytest.approx(5.83, abs=0.005)
        assert computed(book, "sec-10.2.1.1", "settling time, zeta = 0.78") == pytest.approx(3.61, abs=0.01)

    def test_the_delay_that_destabilises_is_that_of_the_phase_margin(self, book: list[Page]) -> None:
        _, phase, _, crossover = control.margin(control.tf([KD, KP], [M, B, 0.0]))
        border = math.radians(phase) / crossover
        assert computed(book, "sec-10.2.1.1", "up to which PD") == pytest.approx(border - 0.005, rel=2e-3)

    def test_gains_have_bounds_that_the_simple_model_does_not_know(self, book: list[Page]) -> None:
        border = computed(book, "sec-10.2.1.1", "stable at 100 Hz")
        held = control.c2d(control.tf([1.0], [M, B, 0.0]), 0.01)
        for omega_n, stable in ((0.9999 * border, True), (1.0001 * border, False)):
            kp, kd = M * omega_n**2, 2.0 * M * omega_n - B
            law = control.tf([kp + 100.0 * kd, -100.0 * kd], [1.0, 0.0], 0.01)  # Kd (theta - theta before) / T
            assert (np.abs(control.feedback(held, law).poles()).max() < 1.0) == stable
        assert computed(book, "eq-10.14", "loses stability") == pytest.approx(9.261, rel=1e-3)

    def test_an_integral_leaves_the_error_of_a_sine(self, book: list[Page]) -> None:
        for ki in (0.0, 1.0):
            error = control.tf([M, B, 0.0, 0.0], [M, B + KD, KP, ki])
            wanted = 0.5 * abs(error(2.0j))
            assert computed(book, "sec-10.2.1.1", f"Ki = {ki:g}") == pytest.approx(wanted, rel=2e-3)

    def test_higher_rates_stop_paying(self, book: list[Page]) -> None:
        assert computed(book, "sec-10.1", "1000 Hz over that at 100 Hz") < 0.2
        assert 0.8 < computed(book, "sec-10.1", "5000 Hz over that at 1000 Hz") < 1.0
        assert 0.95 < computed(book, "sec-10.1", "5000 Hz over that at 2000 Hz") < 1.0
        left = (
            MASS
            * G
            * 0.02
            / (M * 400.0)
            * math.sqrt(np.mean(np.cos(0.8 * np.sin(np.linspace(0.0, 2.0 * math.pi))) ** 2))
        )
        assert computed(book, "sec-10.1", "RMS error at 5000 Hz") == pytest.approx(left, rel=0.05)  # of the model's r

    def test_a_low_pass_takes_the_jitter_of_an_encoder(self, book: list[Page]) -> None:
        """One tick in twenty shows 1 rad/s and all others none."""
        alone = computed(book, "sec-10.1", "jitter, differenced")
        assert alone == pytest.approx(math.sqrt(0.05 * (1.0 - 0.05)), rel=1e-3)
        assert computed(book, "sec-10.1", "jitter, with a low-pass") < 0.2 * alone

    def test_a_dither_makes_dry_friction_viscous(self, book: list[Page]) -> None:
        """By SciPy's solver, with friction b tanh(v / 20 um/s) in the place of the sign, and no static friction."""
        A, mu, omega, push, width = 1.5, 0.3, 80.0 * math.pi, 0.1, 2e-5

        def rate(t: float, y: Float64Array) -> list[float]:
            return [y[1], (A * math.sin(omega * t) + push - mu * math.tanh(y[1] / width)) / M]

        times = [10 / 40.0, 16 / 40.0]
        solved = solve_ivp(rate, (0.0, times[1]), [0.0, 0.0], "LSODA", times, rtol=1e-8, atol=1e-12, max_step=1e-4)
        drift = (solved.y[0, 1] - solved.y[0, 0]) / (times[1] - times[0])
        assert computed(book, "sec-10.2.1.4", "mean speed under 0.1 N m, with dither") == pytest.approx(
            drift, rel=0.02
        )
        assert computed(book, "sec-10.2.1.4", "no dither") == 0.0
        moved = [each.computed for each in rows_of(book, "sec-10.2.1.4") if each.unit == "0 or 1"]
        assert moved == [0.0, 1.0, 0.0, 1.0]

    def test_gears(self, book: list[Page]) -> None:
        assert computed(book, "sec-10.2.1.5", "that is the link's") == pytest.approx(99.9, abs=0.01)
        assert computed(book, "sec-10.2.1.5", "the motor's inertia over") == pytest.approx(10.0)
        assert computed(book, "sec-10.2.1.5", "inertia matched") == pytest.approx(math.sqrt(1000.0))
        assert computed(book, "sec-10.2.1.5", "accelerates the motor there") == pytest.approx(0.5)


# -------------------------------------------------------------------- several joints, by Pinocchio


def se3(pose: taut.Pose) -> pin.SE3:
    return pin.SE3(np.array(pose.R), np.array(pose.p))


@pytest.fixture(scope="module")
def model() -> tuple[pin.Model, pin.Data, int]:
    arm = taut.load_arm("panda")
    made, ids = pin.Model(), {-1: 0}
    for i, (joint, body) in enumerate(zip(arm.joints, arm.bodies, strict=True)):
        hinge = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        ids[i] = made.addJoint(ids[joint.parent], hinge, se3(joint.placement), joint.name)
        inertia = pin.Inertia(body.mass, np.array(body.com), np.array(body.inertia))
        made.appendBodyToJoint(ids[i], inertia, pin.SE3.Identity())
    tool = arm.frame()
    frame = made.addFrame(pin.Frame("tool", ids[tool.body], 0, se3(tool.placement), pin.OP_FRAME))
    return made, made.createData(), frame


@pytest.mark.long
class TestThePanda:
    def test_torques_of_joint_laws(self, book: list[Page], model: tuple[pin.Model, pin.Data, int]) -> None:
        m, data, _ = model
        friction = np.array([0.5, 0.5, 0.4, 0.4, 0.2, 0.2, 0.1]) * V
        tau = pin.rnea(m, data, Q, V, A) + friction
        assert computed(book, "eq-10.20", "the Panda: length") == pytest.approx(np.linalg.norm(tau), rel=1e-9)
        e, e_dot = np.full(7, 0.05), np.full(7, -0.1)
        tau = pin.rnea(m, data, Q, V, A + 100.0 * e + 0.05 * e + 20.0 * e_dot)
        assert computed(book, "eq-10.21", "length") == pytest.approx(np.linalg.norm(tau), rel=1e-9)
        tau = pin.computeGeneralizedGravity(m, data, Q) + 80.0 * e + 0.03 * e + 12.0 * e_dot
        assert computed(book, "eq-10.22", "length") == pytest.approx(np.linalg.norm(tau), rel=1e-9)

    def test_torques_that_press(self, book: list[Page], model: tuple[pin.Model, pin.Data, int]) -> None:
        m, data, frame = model
        J = pin.computeFrameJacobian(m, data, Q, frame, pin.LOCAL_WORLD_ALIGNED)
        F = np.array([5.0, -3.0, -10.0, 0.3, 0.2, -0.1])
        g = pin.computeGeneralizedGravity(m, data, Q)
        assert computed(book, "eq-10.33", "length") == pytest.approx(np.linalg.norm(g + J.T @ F), rel=1e-9)
        assert computed(book, "eq-10.34", "length") == pytest.approx(np.linalg.norm(g + J.T @ F), rel=1e-9)
        asked = F + (0.5 + 0.003) * 0.2 * F
        assert computed(book, "eq-10.35", "length") == pytest.approx(np.linalg.norm(g + J.T @ asked), rel=1e-9)

    def test_the_torque_of_an_impedance(self, book: list[Page], model: tuple[pin.Model, pin.Data, int]) -> None:
        m, data, frame = model
        M_, h = pin.crba(m, data, Q), pin.nonLinearEffects(m, data, Q, V)
        pin.forwardKinematics(m, data, Q, V, np.zeros(7))
        Jdot_v = pin.getFrameClassicalAcceleration(m, data, frame, pin.LOCAL_WORLD_ALIGNED).vector
        J = pin.computeFrameJacobian(m, data, Q, frame, pin.LOCAL_WORLD_ALIGNED)
        Lambda = np.linalg.inv(J @ np.linalg.solve(M_, J.T))
        X = np.array([0.02, -0.01, 0.03, 0.0, 0.0, 0.0])
        twist = np.array([0.1, 0.2, -0.1, 0.0, 0.0, 0.0])
        K, B_ = np.array([400.0] * 3 + [10.0] * 3), np.array([20.0] * 3 + [0.5] * 3)
        tau = J.T @ (K * X + B_ * (twist - J @ V) - Lambda @ Jdot_v) + h
        assert computed(book, "eq-10.49", "length") == pytest.approx(np.linalg.norm(tau), rel=1e-6)

    def test_a_target_that_spins_moves_the_poles_of_what_is_fed_as_it_is(self, book: list[Page]) -> None:
        for name, kd in (("transported", 16.0), ("fed as it is", 16.0 + 3.0j)):
            s = np.roots([1.0, kd, 100.0])
            s = s[np.argsort(s.imag)]
            for i in (0, 1):  # a tick of 1 ms moves them by a percent or two
                assert computed(book, "sec-10.2.3", f"{name}: pole {i + 1}, real") == pytest.approx(
                    s[i].real, rel=0.03
                )
                assert computed(book, "sec-10.2.3", f"{name}: pole {i + 1}, imag") == pytest.approx(
                    s[i].imag, rel=0.03
                )

    def test_errors_of_body_and_space_lead_along_a_screw(
        self, book: list[Page], model: tuple[pin.Model, pin.Data, int]
    ) -> None:
        m, data, frame = model
        pin.forwardKinematics(m, data, np.array(taut.load_arm("panda").home))
        one = pin.updateFramePlacement(m, data, frame).copy()
        shift = np.array([0.05, 0.15, -0.05])
        other = pin.SE3(one.rotation @ pin.exp3(np.array([0.0, 0.7, 0.4])), one.translation + shift)
        screw = pin.log6(one.inverse() * other)
        way = (
            np.array([(one * pin.exp6(s * screw)).translation for s in np.linspace(0.0, 1.0, 201)]) - one.translation
        )
        far = np.linalg.norm(np.cross(way, shift / np.linalg.norm(shift)), axis=1).max()
        for kind in ("body", "space"):
            assert computed(book, "sec-10.2.3", f"{kind}: farthest from a straight line") == pytest.approx(
                far, rel=0.01
            )
        assert computed(book, "sec-10.2.3", "decoupled: farthest from a straight line") < 0.01 * far

    def test_error_energy_falls_by_what_the_damping_takes(self, book: list[Page]) -> None:
        assert computed(book, "eq-10.27", "both at their worst") < 1e-6
        lost = computed(book, "eq-10.27", "V lost in 0.4 s")
        assert lost == pytest.approx(80.1 - computed(book, "eq-10.25", "V after 0.4 s"), rel=1e-9)  # 80.1 J by hand

    def test_gears_decouple_two_links(self, book: list[Page]) -> None:
        direct, geared = (computed(book, "sec-10.2.2.1", f"goal of another, at most, G = {G}") for G in (1, 100))
        assert direct > 0.5
        assert geared < 0.01

    def test_a_flexible_transmission_raises_the_order(self, book: list[Page]) -> None:
        assert computed(book, "sec-10.6", "flexible") - computed(book, "sec-10.6", "rigid") == 2
        two = control.tf([5.0, 2000.0], [1.0, 5.0 * 3.0, 2000.0 * 3.0])  # 1 / M + 1 / G^2 I_motor = 3
        assert computed(book, "sec-10.6", "imaginary part") == pytest.approx(two.poles()[0].imag, rel=1e-3)


@pytest.mark.long
class TestTheEnvironment:
    def test_motion_control_is_stiff_and_force_control_soft(self, book: list[Page]) -> None:
        for f in (0.5, 5.0):
            sizes = [computed(book, "sec-10.5", f"{kind} control: |Z| at {f:g} Hz") for kind in KINDS]
            assert sizes == sorted(sizes, reverse=True)

    def test_each_of_two_kinds_is_good_at_what_the_other_is_not(self, book: list[Page]) -> None:
        stable = {each.quantity: bool(each.computed) for each in rows_of(book, "sec-10.5") if each.unit == "0 or 1"}
        assert stable == {
            "impedance control shows a low impedance: stable": True,
            "admittance control shows a low impedance: stable": False,
            "impedance control shows a stiff impedance: stable": False,
            "admittance control shows a stiff impedance: stable": True,
        }

    def test_what_presses_on_nothing_runs_away_unless_it_is_damped(self, book: list[Page]) -> None:
        assert computed(book, "eq-10.38", "for 2.5 s") == pytest.approx(0.2, rel=1e-3)
        assert computed(book, "eq-10.38", "Kdamp = 0") == pytest.approx(25.0 / 21.0, rel=1e-9)

    def test_the_pole_of_force_is_minus_two_and_not_minus_six(self, book: list[Page]) -> None:
        assert computed(book, "eq-10.37", "pole") == pytest.approx(-2.0, rel=0.01)
        assert computed(book, "eq-10.36", "at rest") == pytest.approx(0.5 * 9.81 / 1.5, rel=2e-3)

    def test_curvature_takes_2_7_of_10_newton(self, book: list[Page]) -> None:
        assert computed(book, "eq-10.42", "presses less by") == pytest.approx(2.7, rel=1e-9)

    def test_a_mass_a_damper_and_a_spring(self, book: list[Page]) -> None:
        t = np.array([0.0, 0.1, 0.2, 0.4])
        fine = np.linspace(0.0, 0.4, 401)
        _, x = control.step_response(control.tf([10.0], [2.0, 20.0, 400.0]), fine)
        for at in t[1:]:
            wanted = x[int(np.searchsorted(fine, at - 1e-9))]
            assert computed(book, "eq-10.46", f"{at:g} s after") == pytest.approx(wanted, rel=5e-3)
        for w in (1.5, 90.0):
            wanted = abs(2.0 * (1j * w) ** 2 + 20.0 * 1j * w + 400.0)
            mine = [each for each in rows_of(book, "eq-10.47") if each.quantity.startswith(f"|Z| at {w:g} rad/s,")]
            assert [each.computed for each in mine] == pytest.approx([wanted, wanted], rel=0.01)

    def test_a_display_is_as_stiff_as_its_characteristic_polynomial_allows(self, book: list[Page]) -> None:
        held = control.c2d(control.tf([1.0], [0.2, 1.0, 0.0]), 1e-3)
        for K, stable in ((0.999 * 2995.0, True), (1.001 * 2995.1, False)):
            law = control.tf([K + 500.0, -500.0], [1.0, 0.0], 1e-3)  # K x + B (x - x before) / T
            assert (np.abs(control.feedback(held, law).poles()).max() < 1.0) == stable
        assert computed(book, "fig-10.17", "at 1000 Hz") == pytest.approx(2995.02, abs=0.1)


# -------------------------------------------------------------------- the command


class TestTheCommand:
    def test_gives_rows_as_pinned(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["book", "eq-10.1", "eq-10.19", "--json", "--out", str(tmp_path)]) == 0
        rows = json.loads(capsys.readouterr().out)
        assert [each["id"] for each in rows] == ["eq-10.1", "eq-10.19"]
        assert all(list(each) == ["id", "quantity", "unit", "computed", "expected", "source"] for each in rows)
        assert rows[0]["computed"] == pytest.approx(0.5 * -0.4 + 0.981 * math.cos(0.7))

    def test_leaves_a_page_and_pictures(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["book", "fig-10.3", "eq-10.10", "--out", str(tmp_path / "deep" / "book")]) == 0
        said = capsys.readouterr().out
        folder = tmp_path / "deep" / "book"
        assert sorted(path.name for path in folder.iterdir()) == ["book.html", "fig-10.3.png"]
        assert all(str(path) in said for path in folder.iterdir())
        page = (folder / "book.html").read_text(encoding="utf-8")
        assert page.count("<img") == 1
        for text in (said, page):
            assert "slip: -zeta" in text
            assert "the chapter leaves the j out" in text

    def test_a_number_that_is_off_is_told_and_fails(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        wrong = [row("a number [m]", 1.1, 1.0, "by hand"), row("another", 2.0, 2.0, "by hand")]
        entry = Entry(id="eq-10.1", title="wrong", show=lambda: iter(wrong))
        monkeypatch.setattr(contents, "CONTENTS", (entry,))
        assert main(["book", "--out", str(tmp_path)]) == 1
        said = capsys.readouterr().out
        assert "+10 % (!)" in said
        assert [line for line in said.splitlines() if "missed" in line] == ["missed: eq-10.1: a number"]

    def test_wrong_requests_are_one_sentence(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main(["book", "eq-10.60"]) == 2
        told = capsys.readouterr().err
        assert told.startswith("taut: the book has no entry 'eq-10.60'; did you mean 'eq-10.6'")
        assert told.count("\n") == 1
        (tmp_path / "file").write_text("", encoding="utf-8")
        assert main(["book", "eq-10.1", "--out", str(tmp_path / "file")]) == 2
        told = capsys.readouterr().err
        assert told == f"taut: folder '{tmp_path / 'file'}' cannot be made: File exists; give another --out\n"

    def test_a_number_that_is_none_is_not_shown_as_one(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        wrong = [row("a number [m]", math.nan, 1.0, "by hand")]
        entry = Entry(id="eq-10.1", title="wrong", show=lambda: iter(wrong))
        monkeypatch.setattr(contents, "CONTENTS", [entry])
        assert main(["book", "--json", "--out", str(tmp_path)]) == 2
        told = capsys.readouterr()
        assert told.out == ""
        assert told.err == "taut: eq-10.1: a number is nan, and should be 1.0\n"
