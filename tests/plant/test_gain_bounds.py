"""Practical bounds on feedback gains (section 10.2.1.1): where theory puts them, simulation has them too."""

from __future__ import annotations

import gain_borders as bounds
import numpy as np
import pytest

import taut
from taut.scenarios.scenario import load_scenario

SEARCH = 1e-3  # what ten halvings leave of the border, and a run of some seconds of its growth


@pytest.mark.part(1)
@pytest.mark.parametrize("differenced", [False, True], ids=["tachometer", "differenced"])
@pytest.mark.parametrize("taps", [2, 5, 10])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_delay_bounds_kd_where_the_sampled_loop_says(taps: int, differenced: bool) -> None:
    predicted = bounds.delay_predicted(taps, differenced=differenced)
    assert bounds.delay_simulated(taps, differenced=differenced) == pytest.approx(predicted, rel=2.0 * SEARCH)
    formula = bounds.delay_formula(taps / bounds.RATE, differenced=differenced)
    assert formula == pytest.approx(predicted, rel=0.03 if differenced else 0.01)


@pytest.mark.part(2)
@pytest.mark.parametrize("differenced", [False, True], ids=["tachometer", "differenced"])
@pytest.mark.parametrize("rate", [50.0, 100.0, 500.0])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_servo_rate_bounds_kd_where_the_sampled_loop_says(rate: float, differenced: bool) -> None:
    predicted = bounds.rate_predicted(rate, differenced=differenced)
    assert bounds.rate_simulated(rate, differenced=differenced) == pytest.approx(predicted, rel=2.0 * SEARCH)


@pytest.mark.parametrize("rate", [50.0, 100.0, 500.0])
def test_that_is_where_one_tick_of_the_damper_turns_the_motion_round(rate: float) -> None:
    """And 30 % lower where velocities are differenced."""
    assert bounds.rate_formula(rate) == pytest.approx(bounds.rate_predicted(rate), rel=1e-3)
    assert bounds.rate_predicted(rate, differenced=True) == pytest.approx(0.703 * bounds.rate_formula(rate), rel=1e-2)


class TestElasticity:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("damping", [2.0, 4.0])
    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_an_elastic_joint_bounds_kd_where_the_sampled_loop_says(self, damping: float) -> None:
        predicted = bounds.elasticity_predicted(damping)
        assert bounds.elasticity_simulated(damping) == pytest.approx(predicted, rel=2.0 * SEARCH)
        assert bounds.elasticity_formula(damping) == pytest.approx(predicted, rel=0.01)

    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_what_grows_is_the_swing_of_motor_against_link(self) -> None:
        spring = taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=bounds.STIFFNESS, damping=2.0))
        plant = taut.RigidPlant(bounds.GEARED, actuation=spring, substeps=20)
        kd = 1.2 * bounds.elasticity_predicted(2.0)
        law = taut.laws.PID(kp=kd * kd / 3.0, kd=kd)
        run = taut.run(taut.compile(law, bounds.GEARED), plant, bounds.HOME, duration=6.0, q0=[bounds.KICK])
        v = run.v[4000:, 0]
        period = np.diff(np.flatnonzero((v[1:] > 0.0) & (v[:-1] <= 0.0))).mean() / bounds.RATE
        omega = np.sqrt(bounds.STIFFNESS * (1.0 / bounds.M + 1.0 / bounds.B))
        assert 2.0 * np.pi / period == pytest.approx(omega, rel=0.02)

    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_sensors_at_the_motor_meet_the_servo_rate_first_and_with_the_rotor_alone(self) -> None:
        predicted = bounds.elasticity_predicted(3.0, side="motor")
        assert predicted == pytest.approx(2.0 * bounds.B * bounds.RATE, rel=1e-3)
        assert bounds.elasticity_simulated(3.0, side="motor") == pytest.approx(predicted, rel=0.01)
        assert predicted > 30.0 * bounds.elasticity_predicted(3.0)


@pytest.mark.part(2)
@pytest.mark.parametrize(("step", "within"), [(0.3, 0.01), (0.5, 0.06), (1.0, 0.11)])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_motor_at_its_limit_bounds_ki_by_what_it_leaves_of_the_damping(step: float, within: float) -> None:
    """Without anti-windup. The describing function has the first harmonic only: good to 10 %, and on the safe side."""
    formula, simulated = bounds.saturation_formula(step), bounds.saturation_simulated(step)
    assert formula < simulated < (1.0 + within) * formula
    kp, kd = bounds.KP_KD_SATURATED
    assert simulated < 0.8 * (bounds.b + kd) * kp / bounds.M  # the chapter's bound, of a motor without limits


def test_limits_that_know_the_motor_keep_the_integral_from_winding_up() -> None:
    motor = taut.drives.Actuation(motor=taut.drives.Motor(peak=bounds.PEAK))
    plant = taut.RigidPlant(bounds.LINK, integrator="rk4", actuation=motor)
    law = taut.laws.PID(kp=bounds.KP_KD_SATURATED[0], kd=bounds.KP_KD_SATURATED[1], ki=800.0)
    for limits, settles in ((taut.Limits(tau=bounds.PEAK), True), (None, False)):
        run = taut.run(taut.compile(law, bounds.LINK, limits=limits), plant, bounds.HOME, duration=40.0, q0=[0.5])
        assert bool(np.abs(run.q[-3000:]).max() < 1e-6) is settles


class TestResolution:
    @pytest.mark.parametrize("resolution", [1e-3, 2e-4])
    def test_one_step_of_an_encoder_asks_for_all_a_motor_has_where_kd_is_too_large(self, resolution: float) -> None:
        assert bounds.resolution_simulated(resolution) == pytest.approx(
            bounds.resolution_formula(resolution), rel=0.02
        )

    @pytest.mark.parametrize(("kd", "resolution", "speed"), [(5.0, 1e-3, 0.05), (5.0, 1e-3, 0.3), (20.0, 1e-4, 0.02)])
    def test_chatter_is_a_pulse_of_kd_resolution_over_dt_at_every_step(
        self, kd: float, resolution: float, speed: float
    ) -> None:
        """Pulses come speed / resolution times a second, and each goes up and down: 2 kd speed / dt in all."""
        tau = bounds.creeping(kd, resolution, speed).tau[500:, 0]
        chatter = np.abs(np.diff(tau)).sum() * bounds.RATE / (len(tau) - 1)
        assert chatter == pytest.approx(2.0 * kd * speed * bounds.RATE, rel=0.02)
        share = speed / bounds.RATE / resolution  # of ticks with a step
        deviation = kd * resolution * bounds.RATE * np.sqrt(share * (1.0 - share))
        assert tau.std() == pytest.approx(deviation, rel=0.02)


class TestBacklash:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("coulomb", [0.1, 0.2, 0.4])
    def test_friction_ends_the_limit_cycle_below_a_gain(self, coulomb: float) -> None:
        """To 5 %: nearer to the border what is left of a cycle takes minutes to die out."""
        assert bounds.backlash_simulated(coulomb) == pytest.approx(bounds.backlash_formula(coulomb), rel=0.05)

    @pytest.mark.long
    @pytest.mark.parametrize("kp", [60.0, 100.0, 140.0])
    def test_above_it_amplitude_and_period_are_those_of_harmonic_balance(self, kp: float) -> None:
        predicted, simulated = bounds.cycle_predicted(kp), bounds.cycle_simulated(kp)
        assert predicted is not None
        assert simulated is not None
        assert simulated[0] == pytest.approx(predicted[0], rel=0.1)
        assert simulated[1] == pytest.approx(predicted[1], rel=0.02)

    @pytest.mark.long
    def test_harmonic_balance_misses_the_slow_cycles_next_to_the_border(self) -> None:
        """There the link mostly flies, and its wind-up is no sine; the formula of the border does not need one."""
        assert bounds.cycle_predicted(24.0) is None
        assert bounds.cycle_predicted(28.0) is not None
        third, fourth = (np.abs(part).max() for part in np.array_split(bounds.hunting(24.0, duration=80.0).v, 4)[2:])
        assert fourth == pytest.approx(third, rel=1e-2)

    def test_without_play_the_same_gains_are_quiet(self) -> None:
        arm = bounds.GEARED.with_friction(taut.Friction(viscous=bounds.b, coulomb=bounds.COULOMB))
        spring = taut.drives.Transmission(**{**bounds.TEETH, "backlash": 0.0})
        sensors = taut.sensors.Sensors(velocity=taut.sensors.Tachometer(side="motor"))
        plant = taut.RigidPlant(
            arm, actuation=taut.drives.Actuation(transmission=spring), sensors=sensors, substeps=4
        )
        ctrl = taut.compile(taut.laws.PID(kp=100.0, kd=bounds.KD_PLAY), arm)
        run = taut.run(ctrl, plant, bounds.HOME, duration=20.0, q0=[0.05])
        assert np.abs(run.v[-5000:]).max() < 1e-4

    def test_the_scenario_shows_this_joint(self) -> None:
        scenario = load_scenario("backlash_cycle")
        case = scenario.cases["backlash"]
        for label, kp in (("high gain", 100.0), ("low gain", 15.0)):
            run = case.experiment.run(case.experiment.controller(case.laws[label]))
            np.testing.assert_array_equal(run.q, bounds.hunting(kp).q)


def test_in_the_scenario_the_borders_lie_between_the_modest_and_the_large_gains() -> None:
    cases = load_scenario("gain_bounds").cases
    assert set(cases) == {"ideal", "saturation", "resolution", "delay", "servo rate", "backlash", "elasticity"}
    borders = {
        "resolution": ("kd", bounds.resolution_formula(1e-3)),
        "delay": ("kd", bounds.delay_predicted(5)),
        "servo rate": ("kd", bounds.rate_predicted(100.0)),
        "backlash": ("kp", bounds.backlash_formula(0.5)),
        "elasticity": ("kd", bounds.elasticity_predicted(3.0)),
    }
    for name, (gain, border) in borders.items():
        modest, large = (cases[name].laws[f"{size} gains"].parameters()[gain] for size in ("modest", "large"))
        assert modest < border < large, name
    for size, below in (("modest", True), ("large", False)):
        kp, kd, ki = (cases["saturation"].laws[f"{size} gains"].parameters()[gain] for gain in ("kp", "kd", "ki"))
        left = bounds.what_a_limit_leaves(float(kp) * 0.5 / bounds.PEAK)
        assert bool(ki < kp / bounds.M * (bounds.b + kd * left)) is below
        assert ki < kp / bounds.M * (bounds.b + kd)  # both are within the chapter's bound
