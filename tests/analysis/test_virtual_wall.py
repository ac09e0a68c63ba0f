"""Stability and passivity of a virtual wall: closed forms, eigenvalues, passive environments and runs agree."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import haptic_borders as haptic
import numpy as np
import pytest
from passive_things import Hand, Thing, radius, random_thing, worst_thing

import taut
from taut.base.types import Float64Array
from taut.linear.performance import powers

check_virtual_wall = taut.analysis.check_virtual_wall
WITHIN = 0.01  # of the eigenvalues' stability limit: what the bar asks for
HANDS = {
    "spring": Hand(m=0.2, b=2.0, K=1.0),
    "damper": Hand(m=0.2, b=2.0, K=1.0, B=0.5),
    "negative damper": Hand(m=0.2, b=2.0, K=1.0, B=-0.5),
    "one period late": Hand(m=0.2, b=2.0, K=1.0, B=0.5, delay=1e-3),
    "half a period late": Hand(m=0.2, b=2.0, K=1.0, delay=5e-4),
    "low-pass": Hand(m=0.2, b=2.0, K=1.0, B=1.5, cutoff=50.0),
    "late low-pass": Hand(m=0.2, b=2.0, K=1.0, B=0.5, cutoff=50.0, delay=3e-4),
}


def wall_of(hand: Hand) -> taut.analysis.StiffnessCheck:
    velocity = "difference" if hand.differenced else "measured"
    if hand.cutoff is not None:
        low_pass = taut.sensors.Difference if hand.differenced else taut.sensors.LowPass
        velocity = low_pass(cutoff=hand.cutoff)
    return check_virtual_wall(
        mass=hand.m, damping=hand.b, K=hand.K, B=hand.B, rate=hand.rate, delay=hand.delay, velocity=velocity
    )


def passive_limit(hand: Hand) -> float:
    """Stiffness [N/m]."""
    return wall_of(dataclasses.replace(hand, K=1.0)).passive_limit


def stable_formula(b: float, B: float, delay: float = 0.0, T: float = 1e-3) -> float:
    return (b + B) / (0.5 * T + delay)


class TestTheSampledLoop:
    @pytest.mark.parametrize("differenced", [False, True])
    @pytest.mark.parametrize("cutoff", [None, 40.0])
    @pytest.mark.parametrize("delay", [0.0, 1e-3, 0.4e-3, 2.7e-3])
    def test_has_the_poles_of_a_loop_written_down_otherwise(
        self, differenced: bool, cutoff: float | None, delay: float
    ) -> None:
        hand = Hand(m=0.3, b=0.7, K=900.0, B=4.0, delay=delay, differenced=differenced, cutoff=cutoff)
        assert wall_of(hand).system.radius == pytest.approx(radius(hand, Thing()), abs=1e-12)

    @pytest.mark.parametrize("velocity", ["measured", "difference"])
    def test_moves_as_a_run_of_taut_does(self, velocity: str) -> None:
        """Its free response is the run: position and velocity, tick by tick, two periods of delay included."""
        display = haptic.Display(B=0.8, taps=2, velocity=velocity)
        wall = check_virtual_wall(
            mass=display.mass, damping=display.damping, K=300.0, B=0.8, delay=2e-3, velocity=velocity
        )
        run = haptic.pressed(display, 300.0, 0.05)
        start = np.zeros(len(wall.system.states))
        start[wall.system.state_places("plant.v")] = run.v[0, 0]
        q, v = (powers(row, wall.system.A, 50) @ start for row in wall.system.C[:2])
        np.testing.assert_allclose(v, run.v[:50, 0], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(q, run.q[:50, 0] - run.q[0, 0], rtol=0.0, atol=1e-13)

    def test_of_many_directions_has_the_poles_of_each(self) -> None:
        masses, K, b = np.array([2.0, 0.5, 0.1]), np.array([900.0, 300.0, 20.0]), np.array([1.0, 2.0, 0.1])
        turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
        full = {"mass": masses, "K": K, "damping": b, "B": 0.1 * b}
        options = {"rate": 500.0, "delay": 1e-3, "velocity": "difference"}
        whole = check_virtual_wall(**{n: turn @ np.diag(v) @ turn.T for n, v in full.items()}, **options)
        each = [check_virtual_wall(**{n: v[i] for n, v in full.items()}, **options).system.poles for i in range(3)]
        got, expected = (np.sort(np.abs(x)) for x in (whole.system.poles, np.concatenate(each)))
        np.testing.assert_allclose(got[got > 1e-3], expected[expected > 1e-3], rtol=1e-9)

    def test_directions_without_stiffness_may_drift(self) -> None:
        assert check_virtual_wall(mass=np.eye(2), K=[100.0, 0.0], damping=1.0).stable
        assert check_virtual_wall(mass=np.eye(2), K=[100.0, 0.0], B=1.0).stable

    def test_a_matrix_is_passive_where_its_weakest_direction_is(self) -> None:
        turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
        K, b = np.array([1000.0, 3000.0, 200.0]), 2.0
        wall = check_virtual_wall(mass=np.eye(3), K=turn @ np.diag(K) @ turn.T, damping=b)
        assert wall.passive_limit == pytest.approx(2.0 * b / 1e-3 / 3000.0, rel=1e-6)
        assert wall.damping_margin == pytest.approx(b - 3000.0 * 0.5e-3, rel=1e-6)
        assert wall.passive
        assert wall.relies_on == ("physical damping",)

    def test_the_direction_is_that_of_the_stiffest_spring(self) -> None:
        wall = check_virtual_wall(mass=np.eye(2), K=[100.0, 5000.0], damping=1.0)
        assert (wall.stable, wall.limit) == (False, pytest.approx(0.4, rel=1e-3))
        assert next(iter(wall.direction.items())) == ("direction 2", pytest.approx(1.0))


class TestClosedForms:
    @pytest.mark.parametrize(("delay", "B"), [(0.0, 0.0), (0.0, 3.0), (1e-3, 0.0), (1e-3, 3.0), (2.5e-3, 1.0)])
    @pytest.mark.parametrize("velocity", ["measured", "difference"])
    def test_for_light_loops_the_formula_is_right_to_two_percent(self, delay: float, B: float, velocity: str) -> None:
        b = 1.0
        mass = (b + B) * (1e-3 + delay) / 0.02
        wall = check_virtual_wall(mass=mass, damping=b, B=B, delay=delay, velocity=velocity)
        assert wall.limit == pytest.approx(stable_formula(b, B, delay), rel=0.02)

    @pytest.mark.parametrize(("heavy", "least", "most"), [(0.2, 1.2, 1.25), (0.6, 1.8, 1.9)])
    def test_for_heavy_ones_with_differenced_velocity_it_errs_on_the_unsafe_side(
        self, heavy: float, least: float, most: float
    ) -> None:
        """B T / m of 0.2 to 0.6: the formula is 22 to 85 % too high."""
        wall = check_virtual_wall(mass=1.0, B=heavy * 1000.0, velocity="difference")
        assert least < stable_formula(0.0, heavy * 1000.0) / wall.limit < most

    @pytest.mark.parametrize("B", [0.0, 0.4, -0.4, 1.9])
    def test_without_delay_and_filter_the_passive_limit_is_colgates(self, B: float) -> None:
        wall = check_virtual_wall(mass=0.2, damping=2.0, B=B, velocity="difference")
        assert wall.passive_limit == pytest.approx(2.0 * (2.0 - abs(B)) / 1e-3, rel=1e-6)

    @pytest.mark.parametrize("taps", [1, 2, 5])
    def test_whole_periods_of_delay_are_colgates_general_condition(self, taps: int) -> None:
        T, b, B = 1e-3, 2.0, 0.5
        theta = np.linspace(1e-4, np.pi, 200001)
        z = np.exp(-1j * theta)

        def needed(K: float) -> float:
            H = (K + B * (1.0 - z) / T) * z**taps
            return float((0.5 * T * ((1.0 - z) * H).real / (1.0 - np.cos(theta))).max())

        wall = check_virtual_wall(mass=0.2, damping=b, B=B, delay=taps * T, velocity="difference")
        assert needed(wall.passive_limit) == pytest.approx(b, rel=1e-6)
        assert (b - B) / (0.5 * T + taps * T) < wall.passive_limit

    def test_of_part_of_a_period_the_closed_formula_is_not_on_the_safe_side(self) -> None:
        wall = check_virtual_wall(mass=0.2, damping=2.0, delay=0.5e-3)
        assert wall.passive_limit == pytest.approx(1888.54, rel=1e-4)  # by b / (T/2 + delay) 2000

    def test_in_a_band_a_measured_damper_helps(self) -> None:
        """b + B sin(theta)/theta - K T (1 - cos(theta))/theta^2 > 0 for all theta up to the band's."""
        options = {"mass": 0.2, "damping": 2.0, "B": 5.0}
        assert check_virtual_wall(**options).passive_limit == 0.0
        theta = np.linspace(1e-4, 2.0 * np.pi * 0.02, 1001)
        most = ((2.0 + 5.0 * np.sin(theta) / theta) * theta**2 / (1e-3 * (1.0 - np.cos(theta)))).min()
        assert check_virtual_wall(**options, band=20.0).passive_limit == pytest.approx(most, rel=1e-5)


class TestPassiveEnvironments:
    def test_none_of_a_thousand_makes_it_unstable_below_the_limit(
        self, share: Callable[[int], int], bar: Callable[[str, object], None]
    ) -> None:
        count, worst, above = share(1000), 0.0, 0
        for i, hand in enumerate(HANDS.values()):
            limit = passive_limit(hand)
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

    @pytest.mark.part(1)
    @pytest.mark.parametrize("name", HANDS)
    def test_the_worst_one_does_just_above_it(self, name: str) -> None:
        """One per cent, three for a damper without filter: at half the rate 40 resonances leave 0.5 % of the sum."""
        hand, pairs = HANDS[name], 40 if "damper" in name else 12
        limit = passive_limit(hand)
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
        assert wall_of(hand).damping_margin == -np.inf

    @pytest.mark.part(1)
    @pytest.mark.parametrize("name", ["spring", "one period late"])
    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_runs_of_taut_with_it_have_their_border_there(self, name: str) -> None:
        limit = passive_limit(HANDS[name])
        predicted, simulated = haptic.borders_with_the_worst(HANDS[name], limit)
        assert simulated == pytest.approx(predicted, rel=WITHIN)
        assert predicted == pytest.approx(limit, rel=0.03)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_runs_of_taut_have_the_borders_of_the_eigenvalues(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    worst = 0.0
    for display in haptic.displays(0, share(100)):
        worst = max(worst, abs(haptic.simulated(display) / display.limit - 1.0))
    assert worst < WITHIN
    bar("largest stable stiffness of 100 virtual walls, runs against eigenvalues: largest difference", f"{worst:.2%}")


def semi_implicit(K: float, substeps: int, m: float = 0.2, b: float = 1.0, B: float = 0.5) -> float:
    """Spectral radius of a wall that RigidPlant simulates by semi-implicit Euler, velocity measured."""
    h = 1e-3 / substeps
    free = np.array([[1.0, h * m / (m + h * b)], [0.0, m / (m + h * b)]])
    push = np.array([[h * h], [h]]) / (m + h * b)
    held = np.linalg.matrix_power(np.block([[free, push], [np.zeros((1, 2)), np.eye(1)]]), substeps)[:2]
    loop: Float64Array = held[:, :2] - held[:, 2:] @ np.array([[K, B]])
    return float(np.abs(np.linalg.eigvals(loop)).max())


def test_semi_implicit_euler_without_substeps_flatters_a_wall() -> None:
    """RigidPlant's default takes the force of a tick at its end, which hides the hold that limits real walls."""
    assert check_virtual_wall(mass=0.2, damping=1.0, B=0.5).limit == pytest.approx(3003.0, rel=1e-3)
    for substeps, limit in ((1, 801e3), (10, 3336.0)):
        assert semi_implicit(0.99 * limit, substeps) < 1.0 < semi_implicit(1.01 * limit, substeps)


class TestEncoderSteps:
    """No eigenvalue knows them: a spring on steps hunts, and Coulomb friction of K step / 2 ends it (Abbott, Okamura)."""

    @pytest.mark.parametrize("K", haptic.STEP_STIFFNESSES)
    def test_a_spring_hunts_on_them_though_it_is_passive_without(self, K: float) -> None:
        assert check_virtual_wall(mass=haptic.MASS, damping=haptic.DAMPING).passive_limit > K
        assert haptic.hunting(K, 0.0) > 0.3 * haptic.STEP

    @pytest.mark.parametrize("K", haptic.STEP_STIFFNESSES)
    def test_coulomb_friction_of_half_a_step_of_the_spring_ends_it(self, K: float) -> None:
        assert haptic.hunting(K, 0.5) > 1e-3 * haptic.STEP
        assert haptic.hunting(K, 1.1) < 1e-9


REFUSED: dict[str, tuple[dict[str, object], type[taut.TautError], str]] = {
    "no mass": ({"mass": 0.0}, taut.errors.RangeError, "mass"),
    "negative damping": ({"damping": -1.0}, taut.errors.RangeError, "damping"),
    "negative stiffness": ({"mass": [1.0, 1.0], "K": [-1.0, 2.0]}, taut.errors.RangeError, "K"),
    "not symmetric": ({"mass": [1.0, 1.0], "K": [[1.0, 2.0], [0.0, 1.0]]}, taut.errors.RangeError, "K"),
    "three of two": ({"mass": [1.0, 1.0], "K": [1.0, 2.0, 3.0]}, taut.errors.ShapeError, "mass"),
    "no rate": ({"rate": 0.0}, taut.errors.RangeError, "rate"),
    "negative delay": ({"delay": -1e-3}, taut.errors.RangeError, "delay"),
    "another velocity": ({"velocity": "differenced"}, taut.errors.UsageError, "velocity"),
    "a fast filter": ({"velocity": taut.sensors.LowPass(cutoff=600.0)}, taut.errors.RangeError, "velocity.cutoff"),
    "a wide band": ({"band": 600.0}, taut.errors.RangeError, "band"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_refused_by_name(case: str) -> None:
    words, kind, name = REFUSED[case]
    with pytest.raises(kind) as caught:
        check_virtual_wall(**{"mass": 1.0, **words}).stable  # noqa: B018
    assert caught.value.name == name
