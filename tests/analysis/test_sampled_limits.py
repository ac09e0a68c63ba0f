"""Stability and passivity of a virtual wall: formulas, eigenvalues, passive things, and runs of taut agree."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import haptic_borders as haptic
import numpy as np
import pytest
from passive_things import Hand, Thing, radius, random_thing, worst_thing

import taut
from taut.analysis.tool.passivity import largest_passive, spare_damping

WITHIN = 0.01  # of the eigenvalues' border: what the bar asks for
HANDS = {
    "spring": Hand(m=0.2, b=2.0, K=1.0),
    "damper": Hand(m=0.2, b=2.0, K=1.0, B=0.5),
    "negative damper": Hand(m=0.2, b=2.0, K=1.0, B=-0.5),
    "one period late": Hand(m=0.2, b=2.0, K=1.0, B=0.5, delay=1e-3),
    "half a period late": Hand(m=0.2, b=2.0, K=1.0, delay=5e-4),
    "low-pass": Hand(m=0.2, b=2.0, K=1.0, B=1.5, cutoff=50.0),
    "late low-pass": Hand(m=0.2, b=2.0, K=1.0, B=0.5, cutoff=50.0, delay=3e-4),
}


def loop_of(hand: Hand) -> taut.analysis.SampledLoop:
    velocity = "difference" if hand.differenced else "measured"
    if hand.cutoff is not None:
        velocity = (
            taut.sensors.Difference(cutoff=hand.cutoff)
            if hand.differenced
            else taut.sensors.LowPass(cutoff=hand.cutoff)
        )
    return taut.analysis.SampledLoop(
        mass=hand.m, damping=hand.b, K=hand.K, B=hand.B, rate=hand.rate, delay=hand.delay, velocity=velocity
    )


class TestTheMatrix:
    @pytest.mark.parametrize("differenced", [False, True])
    @pytest.mark.parametrize("cutoff", [None, 40.0])
    @pytest.mark.parametrize("delay", [0.0, 1e-3, 0.4e-3, 2.7e-3])
    def test_has_the_poles_of_a_loop_written_down_otherwise(
        self, differenced: bool, cutoff: float | None, delay: float
    ) -> None:
        hand = Hand(m=0.3, b=0.7, K=900.0, B=4.0, delay=delay, differenced=differenced, cutoff=cutoff)
        assert loop_of(hand).radius == pytest.approx(radius(hand, Thing()), abs=1e-12)

    @pytest.mark.parametrize("integrator", ["exact", "semi-implicit-euler"])
    @pytest.mark.parametrize("velocity", ["measured", "difference"])
    def test_moves_as_a_run_of_taut_does(self, integrator: str, velocity: str) -> None:
        """Its powers are the run: position, velocity, difference and the forces under way, tick by tick."""
        display = haptic.Display(B=0.8, taps=2, velocity=velocity, integrator=integrator)
        limits = display.limits
        matrix = dataclasses.replace(limits.loop, K=300.0).matrix()
        run = haptic.pressed(display, 300.0, 0.05)
        state = np.zeros(len(matrix))
        state[1] = run.v[0, 0]
        sign = np.sign(matrix[0, 1])  # of the eigenvector that is the spring's direction
        for k in range(50):
            assert state[1] == pytest.approx(run.v[k, 0], abs=1e-12)
            assert sign * state[0] == pytest.approx(run.q[k, 0] - run.q[0, 0], abs=1e-13)
            state = matrix @ state

    def test_of_many_directions_has_the_poles_of_each(self) -> None:
        masses, K, b = np.array([2.0, 0.5, 0.1]), np.array([900.0, 300.0, 20.0]), np.array([1.0, 2.0, 0.1])
        turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
        full = {"mass": masses, "K": K, "damping": b, "B": 0.1 * b}
        options = {"rate": 500.0, "delay": 1e-3, "velocity": "difference"}
        whole = taut.analysis.SampledLoop(**{n: turn @ np.diag(v) @ turn.T for n, v in full.items()}, **options)
        each = [taut.analysis.SampledLoop(**{n: v[i] for n, v in full.items()}, **options).poles() for i in range(3)]
        got, expected = np.abs(whole.poles()), np.sort(np.abs(np.concatenate(each)))[::-1]
        np.testing.assert_allclose(got[got > 1e-3], expected[expected > 1e-3], rtol=1e-9)

    def test_directions_without_stiffness_may_drift(self) -> None:
        assert taut.analysis.SampledLoop(mass=np.eye(2), K=[100.0, 0.0], damping=1.0).stable
        assert taut.analysis.SampledLoop(mass=np.eye(2), K=[100.0, 0.0], B=1.0).stable


class TestClosedForms:
    @pytest.mark.parametrize(("delay", "B"), [(0.0, 0.0), (0.0, 3.0), (1e-3, 0.0), (1e-3, 3.0), (2.5e-3, 1.0)])
    @pytest.mark.parametrize("velocity", ["measured", "difference"])
    def test_for_light_loops_the_formula_is_right_to_two_percent(self, delay: float, B: float, velocity: str) -> None:
        b = 1.0
        mass = (b + B) * (1e-3 + delay) / 0.02
        limits = taut.analysis.stiffness_limits(mass=mass, damping=b, B=B, delay=delay, velocity=velocity)
        assert limits.lightness == pytest.approx(0.02)
        assert limits.formula_stable == pytest.approx((b + B) / (0.5e-3 + delay))
        assert limits.stable == pytest.approx(limits.formula_stable, rel=0.02)

    @pytest.mark.parametrize(("heavy", "least", "most"), [(0.2, 1.2, 1.25), (0.6, 1.8, 1.9)])
    def test_for_heavy_ones_with_differenced_velocity_it_errs_on_the_unsafe_side(
        self, heavy: float, least: float, most: float
    ) -> None:
        """B T / m of 0.2 to 0.6: the formula is 22 to 85 % too high."""
        limits = taut.analysis.stiffness_limits(mass=1.0, B=heavy * 1000.0, velocity="difference")
        assert least < limits.formula_stable / limits.stable < most

    @pytest.mark.parametrize("B", [0.0, 0.4, -0.4, 1.9])
    def test_without_delay_and_filter_the_passive_limit_is_colgates(self, B: float) -> None:
        limits = taut.analysis.stiffness_limits(mass=0.2, damping=2.0, B=B, velocity="difference")
        assert limits.passive == pytest.approx(2.0 * (2.0 - abs(B)) / 1e-3, rel=1e-6)
        assert limits.formula_passive == pytest.approx(limits.passive, rel=1e-6)

    @pytest.mark.parametrize("taps", [1, 2, 5])
    def test_whole_periods_of_delay_are_colgates_general_condition(self, taps: int) -> None:
        T, b, B = 1e-3, 2.0, 0.5
        theta = np.linspace(1e-4, np.pi, 200001)
        z = np.exp(-1j * theta)

        def needed(K: float) -> float:
            H = (K + B * (1.0 - z) / T) * z**taps
            return float((0.5 * T * ((1.0 - z) * H).real / (1.0 - np.cos(theta))).max())

        limits = taut.analysis.stiffness_limits(mass=0.2, damping=b, B=B, delay=taps * T, velocity="difference")
        assert needed(limits.passive) == pytest.approx(b, rel=1e-6)
        assert limits.formula_passive < limits.passive

    def test_of_part_of_a_period_the_closed_formula_is_not_on_the_safe_side(self) -> None:
        limits = taut.analysis.stiffness_limits(mass=0.2, damping=2.0, delay=0.5e-3)
        assert limits.formula_passive == pytest.approx(2000.0)
        assert limits.passive == pytest.approx(1888.54, rel=1e-4)

    def test_in_a_band_a_measured_damper_helps(self) -> None:
        """b + B sin(theta)/theta - K T (1 - cos(theta))/theta^2 > 0 for all theta up to the band's."""
        limits = taut.analysis.stiffness_limits(mass=0.2, damping=2.0, B=5.0, band=20.0)
        assert limits.passive == 0.0
        theta = np.linspace(1e-4, 2.0 * np.pi * 0.02, 1001)
        most = ((2.0 + 5.0 * np.sin(theta) / theta) * theta**2 / (1e-3 * (1.0 - np.cos(theta)))).min()
        assert limits.passive_in_band == pytest.approx(most, rel=1e-5)


class TestPassiveEnvironments:
    def test_none_of_a_thousand_makes_it_unstable_below_the_limit(
        self, share: Callable[[int], int], bar: Callable[[str, object], None]
    ) -> None:
        count, worst, above = share(1000), 0.0, 0
        for i, hand in enumerate(HANDS.values()):
            limit = largest_passive(loop_of(hand))
            rng = np.random.default_rng(i)
            for _ in range(count):
                thing = random_thing(rng, hand.m, hand.rate)
                worst = max(worst, radius(dataclasses.replace(hand, K=0.999 * limit), thing))
                above += radius(dataclasses.replace(hand, K=1.1 * limit), thing) > 1.0 + 1e-9
        assert worst <= 1.0 + 1e-9
        assert above > 0  # it is a test that can fail
        total = count * len(HANDS)
        bar(
            "virtual walls of 7 kinds, 0.1 % below their passive limit, each with 1000 passive things of masses and "
            "springs: unstable; 10 % above",
            f"0 of {total}; {above} of {total}",
        )

    @pytest.mark.parametrize("name", HANDS)
    def test_the_worst_one_does_just_above_it(self, name: str) -> None:
        """One per cent, three for a damper without filter: at half the rate 40 resonances leave 0.5 % of the sum."""
        hand, pairs = HANDS[name], 40 if "damper" in name else 12
        limit = largest_passive(loop_of(hand))
        above = dataclasses.replace(hand, K=(1.03 if "damper" in name else 1.01) * limit)
        worst = worst_thing(above, pairs=pairs, heavy=100.0)
        assert radius(above, worst) > 1.0 + 1e-9
        assert radius(dataclasses.replace(hand, K=0.99 * limit), worst) < 1.0

    def test_resonances_above_the_rate_beat_the_formula_where_velocity_is_measured(self) -> None:
        """Samples of a velocity say nothing of what is between them: b > K T/2 + |B| does not hold."""
        hand = Hand(m=0.2, b=2.0, K=0.9 * 2.0 * (2.0 - 1.5) / 1e-3, B=1.5, differenced=False)
        worst = worst_thing(hand, pairs=8, heavy=100.0)
        assert radius(hand, worst) > 1.0 + 1e-6
        assert radius(dataclasses.replace(hand, differenced=True), worst) < 1.0
        assert spare_damping(loop_of(hand)) == -np.inf

    @pytest.mark.parametrize("name", ["spring", "one period late"])
    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_runs_of_taut_with_it_have_their_border_there(self, name: str) -> None:
        limit = largest_passive(loop_of(HANDS[name]))
        predicted, simulated = haptic.borders_with_the_worst(HANDS[name], limit)
        assert simulated == pytest.approx(predicted, rel=WITHIN)
        assert predicted == pytest.approx(limit, rel=0.03)


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_runs_of_taut_have_the_borders_of_the_eigenvalues(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    worst = 0.0
    for display in haptic.displays(0, share(100)):
        worst = max(worst, abs(haptic.simulated(display) / display.limits.stable - 1.0))
    assert worst < WITHIN
    bar("largest stable stiffness of 100 virtual walls, runs against eigenvalues: largest difference", f"{worst:.2%}")


def test_semi_implicit_euler_without_substeps_flatters_a_wall() -> None:
    """RigidPlant's default takes the force of a tick at its end: that hides the hold, which bounds real walls."""
    flattered, real = (
        haptic.Display(B=0.5, integrator=word).limits.stable for word in ("semi-implicit-euler", "exact")
    )
    assert flattered > 100.0 * real
    many = taut.analysis.stiffness_limits(
        mass=0.2, damping=1.0, B=0.5, integrator="semi-implicit-euler", substeps=100
    )
    assert many.stable == pytest.approx(real, rel=0.02)


class TestEncoderSteps:
    """No eigenvalue knows them: a spring on steps hunts, and Coulomb friction of K step / 2 ends it (Abbott, Okamura)."""

    @pytest.mark.parametrize("K", haptic.STEP_STIFFNESSES)
    def test_a_spring_hunts_on_them_though_it_is_passive_without(self, K: float) -> None:
        assert taut.analysis.stiffness_limits(mass=haptic.MASS, damping=haptic.DAMPING).passive > K
        assert haptic.hunting(K, 0.0) > 0.3 * haptic.STEP

    @pytest.mark.parametrize("K", haptic.STEP_STIFFNESSES)
    def test_coulomb_friction_of_half_a_step_of_the_spring_ends_it(self, K: float) -> None:
        assert haptic.hunting(K, 0.5) > 1e-3 * haptic.STEP
        assert haptic.hunting(K, 1.1) < 1e-9
