"""A link that bends: against quadrature, the matrix exponential and closed forms, and the figures of section 10.6."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused
from scipy.integrate import quad
from scipy.linalg import expm

import taut
from taut.base.types import Float64Array
from taut.drives import FlexibleLink
from taut.plant.flexible_link import ROOTS

LINK: dict[str, Any] = {"length": 1.0, "EI": 5.0, "density": 0.5, "hub_inertia": 0.1}
MOVE = taut.trajectories.Septic(q0=[0.0], q1=[0.5], duration=0.8)
CT = taut.laws.ComputedTorque(kp=25.0, kd=8.0)
ROW = 0.05  # of the figures of section 10.6


def on_hub(link: FlexibleLink, law: taut.Law = CT, **options: Any) -> taut.Controller:
    return taut.compile(taut.laws.MotorSide(law=law), link.arm, **options)


def zeros(link: FlexibleLink, output: str = "q[0]") -> Any:
    """From torque to an output, in continuous time."""
    return of_point(link, 1.0 if output == "q[0]" else 0.0).s_zeros(input="u[0]", output="y[0]")


def of_point(link: FlexibleLink, g: float) -> taut.LinearSystem:
    """From torque to theta + g (q - theta), a point between hub and tool."""
    A, B = link.matrices
    C = np.zeros((1, len(B)))
    C[0, :2] = g, 1.0 - g
    return taut.LinearSystem(A=A, B=B[:, np.newaxis], C=C)


def under_pd(link: FlexibleLink, g: float, kp: float, kd: float) -> taut.LinearSystem:
    """PD of that point, in continuous time, with the gains of a rigid link."""
    plant, J, N = of_point(link, g), float(link.mass_matrix[0, 0]), 1 + link.modes
    K = J * (kp * plant.C + kd * np.roll(plant.C, N, axis=1))
    return taut.LinearSystem(A=plant.A - plant.B @ K)


class TestModel:
    def test_the_mass_matrix_is_that_of_the_mode_shapes_by_quadrature(self) -> None:
        link = FlexibleLink(**LINK | {"length": 0.7}, tip_mass=0.3, modes=3)
        L, rho, m = 0.7, 0.5, 0.3

        def phi(i: int, x: float) -> float:
            b = ROOTS[i] / L
            ratio = (np.cosh(b * L) + np.cos(b * L)) / (np.sinh(b * L) + np.sin(b * L))
            shape = np.cosh(b * x) - np.cos(b * x) - ratio * (np.sinh(b * x) - np.sin(b * x))
            return float(shape / np.sqrt(rho * L))

        def entry(i: int, j: int) -> float:
            def product(x: float) -> float:
                return (phi(i - 1, x) if i else x) * (phi(j - 1, x) if j else x)

            return float(rho * quad(product, 0.0, L)[0] + m * product(L))

        M = [[entry(i, j) for j in range(4)] for i in range(4)]
        M[0][0] += 0.1
        assert np.allclose(link.mass_matrix, M, atol=1e-8)
        assert np.allclose(taut.snapshot(link.arm, [0.3]).M, M[0][0])
        assert np.allclose(taut.snapshot(link.arm, [0.3]).h, 0.0)

    @pytest.mark.parametrize("modes", [1, 3])
    def test_it_moves_as_the_matrix_exponential_says(self, modes: int) -> None:
        link = FlexibleLink(**LINK, tip_mass=0.2, modes=modes, substeps=2)
        push = taut.laws.StateFeedback(K_q=[[0.0]], K_v=[[0.0]], tau_0=[0.4])
        run = taut.run(taut.compile(push, link.arm), link, duration=0.5, q0=[0.2], v0=[0.3])
        A, B = link.matrices
        start = np.zeros(len(B))
        start[:2], start[1 + modes : 3 + modes] = 0.2, 0.3  # straight
        whole = expm(0.5 * np.block([[A, 0.4 * B[:, np.newaxis]], [np.zeros((1, len(B) + 1))]])) @ [*start, 1.0]
        assert np.isclose(run.q[-1, 0], whole[0], atol=1e-7 if modes > 1 else 1e-11)
        assert np.isclose(run.v[-1, 0], whole[1 + modes], atol=1e-4 if modes > 1 else 1e-9)

    def test_plain_python_gives_the_same_run(self) -> None:
        link = FlexibleLink(**LINK, modes=2)
        one, other = (
            taut.run(on_hub(link, engine=engine), link, MOVE, duration=0.05) for engine in ("native", "float")
        )
        assert np.allclose(one.q, other.q, atol=1e-14)
        assert np.allclose(one.tau, other.tau, atol=1e-12)


class TestZeros:
    @pytest.mark.parametrize(("modes", "expected"), [(1, 29.968), (2, 35.9), (3, 35.3)])
    def test_the_sampled_loop_shows_the_unstable_zero_of_the_tool(self, modes: int, expected: float) -> None:
        link = FlexibleLink(**LINK, zeta=0.0, modes=modes)
        lin = taut.linearise(taut.Loop(on_hub(link), link, duration=1.0))
        real = lin.s_zeros(input="disturbance.command", output="q[0]")[:2].real
        assert np.allclose(np.sort(real), [-expected, expected], rtol=1e-3 if modes == 1 else 2e-3)

    def test_with_one_mode_it_depends_on_nothing_but_the_clamped_beam(self) -> None:
        rng = np.random.default_rng(0)
        for _ in range(20):
            L, EI, rho, J, m = np.exp(rng.uniform(-1.5, 1.5, 5)).tolist()
            link = FlexibleLink(length=L, EI=EI, density=rho, hub_inertia=J, tip_mass=m, zeta=0.0)
            omega = ROOTS[0] ** 2 * np.sqrt(EI / (rho * L**4))
            expected = omega / np.sqrt(4.0 / ROOTS[0] ** 2 - 1.0)
            assert np.allclose(np.sort(zeros(link).real), [-expected, expected], rtol=1e-6)
        assert np.isclose(expected / omega, 2.6953, atol=5e-5)

    @pytest.mark.parametrize(("modes", "limit"), [(1, 0.8790), (2, 0.7570)])
    def test_a_point_nearer_to_the_hub_is_minimum_phase(self, modes: int, limit: float) -> None:
        link = FlexibleLink(**LINK, zeta=0.0, modes=modes)
        below, above = (of_point(link, g).s_zeros(input="u[0]", output="y[0]") for g in (limit - 1e-4, limit + 1e-4))
        assert np.abs(below.real).max() < 1e-4 * np.abs(below).max()
        assert above.real.max() > 1e-2 * np.abs(above).min()

    def test_minimum_phase_is_not_enough_for_pd(self) -> None:
        link, free = FlexibleLink(**LINK), FlexibleLink(**LINK, zeta=0.0)
        zero = of_point(free, 0.5333).s_zeros(input="u[0]", output="y[0]")
        assert np.isclose(np.abs(zero).max(), np.abs(np.linalg.eigvals(free.matrices[0])).max(), rtol=1e-3)
        assert under_pd(link, 0.5, 25.0, 8.0).stable
        assert not under_pd(link, 0.6, 25.0, 8.0).stable


class TestFeedback:
    def test_pd_of_the_hub_is_stable_for_any_gains_in_continuous_time(self, share: Callable[[int], int]) -> None:
        rng = np.random.default_rng(1)
        for _ in range(share(300)):
            link = FlexibleLink(
                **dict(zip(LINK, np.exp(rng.uniform(-1.5, 1.5, 4)).tolist(), strict=True)),
                tip_mass=float(rng.uniform(0.0, 1.0)), zeta=float(rng.uniform(0.0, 0.02)), modes=int(rng.integers(1, 4)),
            )  # fmt: skip
            assert under_pd(link, 0.0, *np.exp(rng.uniform(-3.0, 5.0, 2))).stable

    def test_pd_of_the_tool_is_unstable_at_the_same_gains(self) -> None:
        link = FlexibleLink(**LINK)
        lin = taut.linearise(taut.Loop(taut.compile(CT, link.arm), link, duration=1.0))
        assert np.isclose(lin.decay_rate, -4.9, rtol=ROW)
        assert np.isclose(under_pd(link, 1.0, 25.0, 8.0).decay_rate, lin.decay_rate, rtol=0.01)
        with pytest.warns(taut.StabilityWarning):
            taut.run(taut.compile(CT, link.arm), link, MOVE, duration=0.01)

    def test_slow_feedback_of_the_tool_is_stable_by_the_damping_of_the_link(self) -> None:
        link = FlexibleLink(**LINK)
        slow = taut.compile(taut.laws.ComputedTorque(kp=25.0, kd=0.2), link.arm)
        for ctrl, rate in ((slow, 0.12), (on_hub(link), 4.4)):
            assert np.isclose(taut.linearise(taut.Loop(ctrl, link, duration=1.0)).decay_rate, rate, rtol=ROW)


def errors(run: taut.Run, arrival: float) -> Float64Array:
    """Largest error of the tool, of the whole run and after arrival [mm]; L = 1 m."""
    e = 1e3 * np.abs(run.reference.q - run.q)[:, 0]  # type: ignore[attr-defined]
    return np.array([e.max(), e[run.t > arrival - 1e-9].max()])


class TestInversion:
    LINK = FlexibleLink(**LINK)
    Z = 30.787  # [1/s] unstable zero, with damping

    def followed(self, lead: float, link: FlexibleLink | None = None) -> Float64Array:
        reference = taut.analysis.stable_inversion(on_hub(self.LINK), self.LINK, MOVE, lead=lead)
        run = taut.run(on_hub(self.LINK), link or self.LINK, reference, duration=lead + 2.0)
        return errors(run, round(lead, 3) + 0.8)

    def test_a_rigid_law_on_the_hub_leaves_the_figures_of_the_table(self) -> None:
        run = taut.run(on_hub(self.LINK), self.LINK, MOVE, duration=2.0)
        assert np.allclose(errors(run, 0.8), [71.8, 41.0], rtol=ROW)

    @pytest.mark.part(2)
    @pytest.mark.parametrize(("k", "largest"), [(5, 0.056), (3, 0.41), (1, 3.1), (0, 8.2)])
    def test_what_a_shorter_lead_costs_is_the_table(self, k: int, largest: float) -> None:
        found = self.followed(k / self.Z)
        assert np.isclose(found[0], largest, rtol=ROW)
        assert found[1] < {5: 0.0036, 3: 0.011, 1: 0.07, 0: 0.18 * (1.0 + ROW)}[k]

    def test_the_whole_inverse_is_exact_at_the_ticks(self) -> None:
        assert self.followed(1.5)[0] < 1e-6  # [mm]; continuous inversion, held over a tick, leaves 0.0038

    def test_the_input_begins_as_the_unstable_zero_says_and_ends_with_the_motion(self) -> None:
        reference = taut.analysis.stable_inversion(on_hub(self.LINK), self.LINK, MOVE, lead=0.4)
        assert np.isclose(np.log(reference.a[300, 0] / reference.a[200, 0]), 0.1 * self.Z, rtol=1e-3)
        assert not reference.q[:401].any()
        assert reference.q[401, 0] > 0.0
        assert np.isclose(reference.duration - 0.4 - 0.8, 6.4, atol=2.0)
        assert np.abs(reference.a[-1]) < 1e-4

    def test_a_wrong_model_leaves_its_error(self) -> None:
        expected = {"EI": (4.75, 3.5), "tip_mass": (0.1, 69.0), "modes": (2, 0.16)}
        for name, (value, largest) in expected.items():
            assert np.isclose(self.followed(5 / self.Z, FlexibleLink(**LINK | {name: value}))[0], largest, rtol=ROW)
        assert np.isclose(self.followed(5 / self.Z, FlexibleLink(**LINK | {"EI": 4.0}))[0], 18.0, rtol=ROW)
        plain = taut.run(on_hub(self.LINK), FlexibleLink(**LINK, tip_mass=0.1), MOVE, duration=2.0)
        assert np.isclose(errors(plain, 0.8)[0], 118.0, rtol=ROW)

    def test_more_modes_and_a_tip_mass_too(self) -> None:
        link = FlexibleLink(**LINK, tip_mass=0.05, modes=2)
        run = taut.run(
            on_hub(link), link, taut.analysis.stable_inversion(on_hub(link), link, MOVE, lead=1.0), duration=3
        )
        assert errors(run, 1.8)[0] < 1e-5

    def test_an_elastic_joint_follows_its_link_exactly(self) -> None:
        plant, ctrl = elastic([0.0, 0.0, 0.0])
        fast = taut.trajectories.Septic(q0=[0.0], q1=[0.5], duration=0.4)
        plain, exact = (
            taut.run(ctrl, plant, ref, duration=1.0, q0=[0.0])
            for ref in (fast, taut.analysis.stable_inversion(ctrl, plant, fast, lead=0.1))
        )
        assert np.isclose(np.abs(plain.error).max(), 0.027, rtol=ROW)
        assert np.abs(exact.error).max() < 1e-9


def elastic(gravity: list[float]) -> tuple[taut.RigidPlant, taut.Controller]:
    arm = taut.load_arm("one_joint", gravity=gravity).with_joints(rotor_inertia=0.2).with_friction(taut.Friction())
    plant = taut.RigidPlant(
        arm,
        actuation=taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=500.0, damping=0.5)),
        sensors=taut.sensors.Sensors(motor=taut.sensors.Encoder(), motor_velocity=taut.sensors.Tachometer()),
        substeps=10,
    )
    law = taut.laws.MotorSide(law=taut.laws.ComputedTorque(kp=100.0, kd=20.0))
    return plant, taut.compile(law, arm)


class TestRefusals:
    @pytest.mark.parametrize(
        "change",
        [
            {"length": 0.0},
            {"EI": -1.0},
            {"hub_inertia": float("nan")},
            {"zeta": -0.1},
            {"zeta": 2.0},
            {"modes": 4},
            {"density": "a"},
        ],
        ids=lambda change: next(iter(change)),
    )
    def test_a_link_that_cannot_be(self, change: dict[str, Any]) -> None:
        with refused((taut.errors.RangeError, taut.errors.ShapeError)):
            FlexibleLink(**LINK | change)

    def test_steps_too_long_for_a_mode(self) -> None:
        stiff = FlexibleLink(**LINK | {"EI": 500.0}, modes=3)
        with refused(taut.errors.RangeError):
            taut.run(on_hub(stiff), stiff, MOVE, duration=0.1)

    def test_a_parameter_that_does_not_change_in_a_run(self) -> None:
        link = FlexibleLink(**LINK)
        with refused(taut.errors.UnknownNameError):
            taut.run(on_hub(link), link, MOVE, duration=0.1, events=[taut.Event(t=0.0, set={"plant.tip_mass": 1.0})])

    @pytest.mark.parametrize(
        "law", [CT, taut.laws.MotorSide(law=taut.laws.PID(kp=5.0, kd=2.0))], ids=["unstable", "no feedforward"]
    )
    def test_a_loop_without_an_inverse(self, law: taut.Law) -> None:
        link = FlexibleLink(**LINK)
        with refused(taut.errors.UsageError):
            taut.analysis.stable_inversion(taut.compile(law, link.arm), link, MOVE, lead=0.2)

    @pytest.mark.parametrize(
        "motion",
        [
            taut.trajectories.Sine(center=[0.0], amplitude=0.1, frequency=1.0),
            taut.trajectories.Samples(times=[0.0, 1.0], q=[[0.0], [1.0]], v=[[1.0], [1.0]]),
            taut.JointMotion(q=[0.5]),
            taut.trajectories.Septic(q0=[0.0, 0.0], q1=[0.5, 0.5], duration=1.0),
        ],
        ids=["without an end", "moving", "a sample", "of two joints"],
    )
    def test_a_motion_that_is_not_from_rest_to_rest(self, motion: Any) -> None:
        link = FlexibleLink(**LINK)
        with refused(taut.TautError):
            taut.analysis.stable_inversion(on_hub(link), link, motion, lead=0.2)

    def test_droop_in_a_spring_and_a_lead_before_the_start(self) -> None:
        plant, ctrl = elastic([0.0, 0.0, -9.81])
        with refused(taut.errors.UsageError):
            taut.analysis.stable_inversion(ctrl, plant, MOVE, lead=0.2)
        with refused(taut.errors.RangeError):
            taut.analysis.stable_inversion(ctrl, plant, MOVE, lead=-0.2)

    def test_an_inverse_that_does_not_die_out(self) -> None:
        link = FlexibleLink(**LINK, zeta=0.0, tip_mass=20.0)
        with refused(taut.errors.UsageError):
            taut.analysis.stable_inversion(on_hub(link), link, MOVE, lead=40.0)
