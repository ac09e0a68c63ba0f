"""Identification: planted values back from runs with noise, honest intervals, and motions that excite."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused, warned

import taut
from taut.analysis.identification.regression import ArmRegression, possible_bodies
from taut.maths.regressor import pseudo_inertia

NOISE = {"position": 2e-5, "torque": 0.05}  # [rad], [N m], white at 1 kHz
FRICTION = taut.Friction(viscous=0.3, coulomb=0.4)
BOX = {"mass": 2.0, "com": [0.0, 0.0, 0.05], "inertia": [2.0 * 0.1**2 / 6.0] * 3 + [0.0] * 3}
PLANTED = dict.fromkeys(("h_x", "h_y", "I_xy", "I_xz", "I_yz"), 0.0) | {
    "m": 2.0,
    "h_z": 0.1,
    "I_xx": 0.005 + BOX["inertia"][0],  # type: ignore[index]
    "I_yy": 0.005 + BOX["inertia"][0],  # type: ignore[index]
    "I_zz": BOX["inertia"][0],  # type: ignore[index]
    "viscous": 0.3,
    "coulomb": 0.4,
}


class RecordTorque(taut.Law):
    """No torque; a law that uses the torque sensors has them recorded."""

    def command(self, x: Any, ref: Any) -> taut.Torque:
        return taut.Torque(none=0.0 * x.tau_meas)


def plant_of(true: taut.Arm, kind: Any = taut.RigidPlant, **options: Any) -> Any:
    """With noise of the torques; positions have noise, and in MuJoCo the steps of an encoder of 17 bits."""
    steps = {"resolution": 2.0 * np.pi / 2**17} if kind is taut.MujocoPlant else {"noise": NOISE["position"]}
    torque = taut.sensors.TorqueSensor(noise=NOISE["torque"], side="motor")
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(**steps), torque=torque)
    return kind(true, sensors=sensors, **options)


def recorded(arm: taut.Arm, plant: Any, motion: Any, *, duration: float = 20.0, seed: int = 0) -> taut.Run:
    return taut.run(follower(arm), plant, motion, duration=duration, seed=seed)


@functools.cache
def follower(arm: taut.Arm) -> taut.Controller:
    return taut.compile(taut.laws.ComputedTorque(kp=2500.0, kd=100.0) + RecordTorque(), arm)


@functools.cache
def arm_of(name: str) -> taut.Arm:
    arm = taut.load_arm(name)
    return arm.with_joints(rotor_inertia=0.3) if name in ("ur10", "kinova") else arm  # as geared motors have


@functools.cache
def motion_of(name: str, *what: Any, amplitude: float = 0.3) -> Any:
    return taut.analysis.excitation(arm_of(name), what=what or ("payload", "friction"), amplitude=amplitude)


def loaded(arm: taut.Arm, **box: Any) -> taut.Arm:
    return arm.with_payload(**(BOX | box)).with_friction(FRICTION)


def deviations(found: taut.analysis.Identification, planted: Any = PLANTED) -> np.ndarray:
    """Errors of the estimates in standard deviations."""
    return np.array([(each.value - planted[name.split(".")[1]]) / each.std for name, each in found.estimates.items()])


# -------------------------------------------------------------------- the regression


@pytest.mark.parametrize(
    "what", [("payload",), ("links",), ("rotors",), ("friction",), ("links", "rotors", "friction")]
)
def test_known_torques_and_columns_are_the_torques_of_the_arm(what: Any) -> None:
    arm = loaded(taut.load_arm("ur10")).with_joints(rotor_inertia=0.3)
    q, v, a = np.random.default_rng(1).standard_normal((3, 4, arm.n))
    regression = ArmRegression(arm, what)
    Y, known = regression.at(q, v, a)
    expected = [
        taut.snapshot(arm, *state).inverse_dynamics(each) + 0.3 * state[1] + 0.4 * np.sign(state[1])
        for *state, each in zip(q, v, a, strict=True)
    ]
    np.testing.assert_allclose(known + Y @ (regression.K @ regression.nominal), expected, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize(("name", "links", "all_"), [("planar2", 6, 10), ("ur5", 36, 48), ("panda", 43, 57)])
def test_base_parameters_have_the_known_number(name: str, links: int, all_: int) -> None:
    arm = taut.load_arm(name)
    assert len(ArmRegression(arm, ("links",)).base) == links
    assert len(ArmRegression(arm, ("links", "friction")).base) == all_


def test_base_parameters_are_named_sums() -> None:
    found = ArmRegression(taut.load_arm("planar2"), ("links", "rotors"))
    assert found.combinations == {
        "joint1.h_x": "joint1.h_x + 0.5 joint2.m",
        "joint1.I_yy": "joint1.I_yy + 0.25 joint2.m + joint1.rotor_inertia",
    }
    assert "joint2.I_xx" in found.without_effect


# -------------------------------------------------------------------- planted values


@pytest.mark.parametrize("kind", [taut.RigidPlant, pytest.param(taut.MujocoPlant, marks=pytest.mark.long)])
def test_a_panda_with_2_kg_gives_payload_and_friction_back(kind: Any) -> None:
    arm = arm_of("panda")
    found = taut.analysis.identify(recorded(arm, plant_of(loaded(arm), kind), motion_of("panda")), arm)
    mass = found.estimates["payload.m"]
    assert abs(mass.value - 2.0) < 1e-3
    assert 1.96 * mass.std < 6e-4
    assert found.condition < 10.0
    assert np.abs(deviations(found)).max() < 4.0
    assert found.arm.payload.com == pytest.approx(BOX["com"], abs=1e-3)
    before, after = found.residual
    assert (after < 0.03 * before).all()
    for name in ("viscous", "coulomb"):
        assert getattr(found.arm, name) == pytest.approx(PLANTED[name], abs=0.02)
    assert set(found.without_slow_motion) <= set(arm.joint_names)


@pytest.mark.long
@pytest.mark.parametrize("name", ["planar2", "ur10", "panda"])
def test_intervals_of_95_percent_cover_95_percent(
    name: str, share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    arm = arm_of(name)
    plant, motion = plant_of(loaded(arm)), motion_of(name)
    runs = (recorded(arm, plant, motion, seed=100 + seed) for seed in range(share(60)))
    errors = [deviations(taut.analysis.identify(run, arm)) for run in runs]
    covered = float(np.mean(np.abs(errors) < 1.96))
    bar(f"identify: coverage of the 95 % intervals on a {name}", round(covered, 3))
    assert 0.89 < covered < 0.99
    assert np.sqrt(np.mean(np.square(errors))) < 1.25


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["ur10", "kinova", "planar2"])
def test_other_arms_give_payload_and_friction_back(name: str) -> None:
    arm = arm_of(name)
    found = taut.analysis.identify(recorded(arm, plant_of(loaded(arm)), motion_of(name), seed=3), arm)
    assert np.abs(deviations(found)).max() < 4.5
    assert found.arm.payload.mass == pytest.approx(2.0, abs=2e-3)
    if name == "planar2":  # what a plane does not show stays as it was
        assert set(found.without_effect) == {f"payload.{x}" for x in ("h_y", "I_xx", "I_zz", "I_xy", "I_xz", "I_yz")}


def test_rotor_inertia_is_found_beside_payload_and_friction() -> None:
    arm, what = arm_of("ur10"), ("payload", "friction", "rotors")
    run = recorded(arm, plant_of(loaded(arm)), motion_of("ur10", *what))
    found = taut.analysis.identify(run, arm.with_joints(rotor_inertia=0.2), what=what)
    assert found.arm.rotor_inertia == pytest.approx(0.3, abs=0.01)
    assert np.abs(deviations(found, PLANTED | {"rotor_inertia": 0.3})).max() < 4.5


def test_links_are_found_as_base_parameters_and_the_arm_is_possible() -> None:
    arm, what = arm_of("planar2"), ("links", "friction")
    true = arm.perturbed(seed=1, mass=0.1, com=0.005, inertia=0.1).with_friction(FRICTION)
    found = taut.analysis.identify(
        recorded(arm, plant_of(true), motion_of("planar2", *what, amplitude=0.8)), arm, what=what
    )
    regression = ArmRegression(true, what)
    expected = dict(
        zip([regression.names[j] for j in regression.base], regression.K @ regression.nominal, strict=True)
    )
    errors = [(each.value - expected[name]) / each.std for name, each in found.estimates.items()]
    assert np.abs(errors).max() < 4.0
    x, y = (taut.snapshot(which, [0.3, -0.8], [1.0, 0.5]) for which in (found.arm, true))
    np.testing.assert_allclose(x.M, y.M, rtol=0.01)
    np.testing.assert_allclose(x.g, y.g, rtol=0.002)


def test_static_friction_and_stribeck_speed_are_found_in_slow_reversals() -> None:
    arm = arm_of("planar2")
    true = arm.with_friction(taut.Friction(viscous=0.3, coulomb=0.4, static=0.6, stribeck=0.05))
    slow = taut.trajectories.Sine(center=arm.home, amplitude=0.3, frequency=0.03)
    runs = [recorded(arm, plant_of(true), motion_of("planar2", "friction"))]
    runs += [recorded(arm, plant_of(true), slow, duration=60.0, seed=1)]
    found = taut.analysis.identify(runs, arm, what=["friction"])
    planted = {"viscous": 0.3, "coulomb": 0.4, "static": 0.6, "stribeck": 0.05}
    assert {name.split(".")[1] for name in found.estimates} == set(planted)
    assert np.abs(deviations(found, planted)).max() < 4.0
    assert found.arm.friction.static == pytest.approx(0.6, abs=0.01)
    assert found.without_slow_motion == ()


def test_fast_motion_does_not_show_static_friction() -> None:
    arm = arm_of("planar2")
    true = arm.with_friction(taut.Friction(viscous=0.3, coulomb=0.4, static=0.6, stribeck=0.005))
    fast = taut.trajectories.Sine(center=arm.home, amplitude=0.3, frequency=[0.6, 0.8])
    found = taut.analysis.identify(recorded(arm, plant_of(true), fast), arm, what=["friction"])
    assert found.without_slow_motion == arm.joint_names
    assert found.arm.friction.static == pytest.approx(found.arm.coulomb)
    assert "slow reversals" in str(found)


def test_a_random_motion_gives_the_intervals_that_are_known_and_no_static_friction() -> None:
    """An independent simulation has m +- 0.0003, I_xx about joint 7 0.1389 +- 0.0007, b +- 0.0035, c +- 0.0014, condition 6.3."""
    arm, order = arm_of("panda"), np.arange(1, 6)[:, np.newaxis]
    rng = np.random.default_rng(0)
    draws = [rng.uniform(0.05, 0.15, (5, 7)) * rng.choice([-1.0, 1.0], (5, 7)) for _ in range(3)]
    cosines, sines = draws[1:]  # of which an excess of friction near stops is not significant
    cosines[0] -= np.sum(cosines * order**2, axis=0)  # at rest at both ends
    sines[0] -= np.sum(sines * order, axis=0)
    cosines, sines = (0.3 * part / np.abs(part).max() for part in (cosines, sines))
    motion = taut.trajectories.Fourier(q0=arm.home, cosines=cosines, sines=sines, frequency=0.1, duration=20.0)
    found = taut.analysis.identify(recorded(arm, plant_of(loaded(arm)), motion), arm)
    assert np.abs(deviations(found)).max() < 4.0
    assert 1.96 * found.estimates["payload.m"].std < 5e-4
    assert found.condition < 10.0


@pytest.mark.parametrize("options", [{}, {"substeps": 10}])
def test_where_in_its_period_a_torque_acts_does_not_bias_friction(options: Any) -> None:
    """Half a period of 1 ms is 0.02 N m s/rad of viscous friction, by the stiffness of gravity."""
    arm = arm_of("planar2")
    true = loaded(arm, mass=10.0, inertia=[0.02] * 3 + [0.0] * 3)
    found = taut.analysis.identify(recorded(arm, plant_of(true, **options), motion_of("planar2")), arm)
    assert found.arm.viscous == pytest.approx(0.3, abs=0.03)
    assert found.arm.viscous[0] == pytest.approx(0.3, abs=2.5 * found.estimates["joint1.viscous"].std)


@pytest.mark.part(1)
@pytest.mark.parametrize(("kp", "kd"), [(400.0, 40.0), (2500.0, 100.0)])
def test_a_start_in_which_the_payload_drops_biases_nothing(kp: float, kd: float) -> None:
    """At t = 0 the acceleration jumps, which filtered positions do not show: I_xx was off by 5 and 7 deviations."""
    arm = taut.load_arm("ur10")
    law = taut.laws.ComputedTorque(kp=kp, kd=kd) + RecordTorque()
    motion = taut.analysis.excitation(arm, what=("payload",), amplitude=0.3, duration=10.0)
    run = taut.run(taut.compile(law, arm), plant_of(arm.with_payload(**BOX)), motion, duration=10.0)
    assert np.abs(deviations(taut.analysis.identify(run, arm, what=["payload"]))).max() < 3.0


def test_without_noise_the_numbers_are_exact() -> None:
    arm = arm_of("planar2")
    found = taut.analysis.identify(recorded(arm, taut.RigidPlant(loaded(arm)), motion_of("planar2")), arm)
    assert found.arm.payload.mass == pytest.approx(2.0, abs=1e-4)
    assert found.arm.viscous == pytest.approx(0.3, abs=1e-3)
    assert found.arm.coulomb == pytest.approx(0.4, abs=1e-3)


def test_a_log_gives_what_the_run_gave(tmp_path: Path) -> None:
    arm = arm_of("planar2")
    run = recorded(arm, plant_of(loaded(arm)), motion_of("planar2"))
    before, after = (
        taut.analysis.identify(each, arm) for each in (run, taut.load_run(run.save(tmp_path / "a.mcap")))
    )
    assert {n: e.value for n, e in before.estimates.items()} == {n: e.value for n, e in after.estimates.items()}


def test_the_identified_arm_follows_better_and_the_verdict_bounds_it() -> None:
    arm = arm_of("planar2")
    true = loaded(arm)
    found = taut.analysis.identify(recorded(arm, plant_of(true), motion_of("planar2")), arm)
    law = taut.laws.ComputedTorque(kp=100.0, kd=20.0) + taut.laws.FrictionCompensation()
    ctrl = taut.compile(law, found.arm)
    verdict = found.verdict(ctrl, error=2e-3)
    assert verdict.ok
    assert not found.verdict(ctrl, error=1e-5).ok
    motion = taut.trajectories.Sine(center=arm.home, amplitude=0.3, frequency=[0.2, 0.3])
    plant = taut.RigidPlant(true)
    errors = [
        taut.run(taut.compile(law, a), plant, motion, q0=arm.home, duration=10.0).error for a in (arm, found.arm)
    ]
    before, after = (np.sqrt(np.mean(np.square(e[2000:]), axis=0)) for e in errors)  # type: ignore[index]
    assert (after < 0.05 * before).all()
    assert (after < verdict.bounds).all()


# -------------------------------------------------------------------- possible bodies


def test_torques_without_gravity_are_pointed_out() -> None:
    arm = arm_of("planar2")
    law = taut.laws.ComputedTorque(kp=2500.0, kd=100.0) + RecordTorque()
    ctrl, plant = taut.compile(law, arm, adds=("gravity",)), plant_of(loaded(arm), adds=("gravity",))
    found = taut.analysis.identify(taut.run(ctrl, plant, motion_of("planar2"), duration=20.0), arm)
    assert not found.physical
    assert "does the plant add gravity itself" in found.content().faults[0]


def test_an_impossible_estimate_is_replaced_by_the_nearest_possible_body() -> None:
    regression = ArmRegression(taut.load_arm("panda"), ("payload",))
    estimate = np.array([2.0, 0.0, 0.0, 0.1, 0.009, 0.009, -0.001, 0.0, 0.0, 0.0])
    sd = np.array([0.001, *[0.001] * 3, *[0.001] * 6])
    x, distance = possible_bodies(regression, estimate, np.diag(sd**2))
    assert np.linalg.eigvalsh(pseudo_inertia(x))[0] > 0.0
    assert 0.8 < distance < 3.0
    np.testing.assert_allclose(x[:4], estimate[:4], atol=2e-3)
    possible = estimate.copy()
    possible[6] = 0.002
    kept, none = possible_bodies(regression, possible, np.diag(sd**2))
    assert none == 0.0
    np.testing.assert_allclose(kept, possible, rtol=1e-14, atol=1e-15)


# -------------------------------------------------------------------- motions that excite


@pytest.mark.parametrize("name", ["planar2", "ur10", "gantry3"])
def test_a_motion_starts_and_ends_at_rest_at_home_within_all_limits(name: str) -> None:
    arm = taut.load_arm(name)
    limits = {"amplitude": 0.2, "speed": 0.4, "acceleration": 0.5}
    motion = taut.analysis.excitation(arm, what=("friction",), duration=10.0, **limits)
    rows = motion.rows(np.linspace(0.0, 10.0, 5001))
    for k in (0, -1):
        np.testing.assert_allclose([rows.q[k] - arm.home, rows.v[k], rows.a[k]], 0.0, atol=1e-12)
    for value, limit in zip((rows.q - arm.home, rows.v, rows.a), limits.values(), strict=True):
        assert np.abs(value).max() < limit * 1.001
    assert (rows.q < arm.upper).all()
    assert (rows.q > arm.lower).all()


def test_the_search_improves_on_random_motions_and_repeats_itself() -> None:
    arm = arm_of("planar2")

    def condition(motion: Any) -> float:
        rows = motion.rows(np.linspace(0.0, 10.0, 200))
        W = ArmRegression(arm, ("payload", "friction")).at(rows.q, rows.v, rows.a)[0].reshape(400, -1)
        return float(np.linalg.cond(W / np.linalg.norm(W, axis=0)))

    first, again, other = (taut.analysis.excitation(arm, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.sines, again.sines)
    assert condition(first) == pytest.approx(condition(other), rel=0.3)
    rng = np.random.default_rng(0)
    random = [
        taut.trajectories.Fourier(q0=arm.home, cosines=c, sines=s, frequency=0.1, duration=10.0)
        for c, s in 0.1 * rng.standard_normal((20, 2, 5, 2))
    ]
    assert condition(first) < 0.6 * np.median([condition(each) for each in random])


def test_a_motion_leaves_torque_in_reserve() -> None:
    arm = arm_of("planar2").with_joints(effort=[45.0, 12.0])
    motion = taut.analysis.excitation(arm, amplitude=1.5, speed=10.0)
    rows = motion.rows(np.linspace(0.0, 10.0, 2001))
    tau = [taut.snapshot(arm, q, v).inverse_dynamics(a) for q, v, a in zip(rows.q, rows.v, rows.a, strict=True)]
    assert (np.abs(tau) < arm.effort).all()


def test_a_fourier_series_has_the_derivatives_it_gives() -> None:
    rng, t, h = np.random.default_rng(0), np.linspace(0.1, 4.9, 40), 1e-5
    c, s = rng.standard_normal((2, 3, 2))
    motion = taut.trajectories.Fourier(q0=[0.1, 0.2], cosines=c, sines=s, frequency=0.2, duration=5.0)
    at, ahead, behind = (motion.rows(t + step) for step in (0.0, h, -h))
    np.testing.assert_allclose((ahead.q - behind.q) / (2.0 * h), at.v, atol=1e-7)
    np.testing.assert_allclose((ahead.v - behind.v) / (2.0 * h), at.a, atol=1e-6)
    np.testing.assert_allclose(motion.at(5.0).q, [0.1, 0.2], atol=1e-12)
    assert not motion.at(6.0).v.any()


# -------------------------------------------------------------------- refusals


def little(amplitude: Sequence[float], frequency: Any, what: Any = ("payload", "friction")) -> None:
    arm = arm_of("planar2")
    motion = taut.trajectories.Sine(center=arm.home, amplitude=amplitude, frequency=frequency)
    taut.analysis.identify(recorded(arm, plant_of(arm), motion, duration=10.0), arm, what=what)


def test_too_little_excitation_is_refused_in_one_sentence() -> None:
    with refused(taut.errors.NumericalError):
        little([0.0, 0.0], 0.2)
    with refused(taut.errors.NumericalError) as caught:
        little([0.3, 0.0], 0.2)
    assert caught.value.joint == "joint2"
    with refused(taut.errors.NumericalError) as seen:
        little([0.01, 0.01], 0.2, ["payload"])
    assert seen.value.value > 100.0
    with warned(RuntimeWarning):
        little([0.3, 0.3], 0.2, ["payload"])


def test_a_joint_that_sticks_is_told_from_a_motion_that_leaves_it_out() -> None:
    arm = arm_of("planar2")
    motion = taut.trajectories.Sine(center=arm.home, amplitude=0.3, frequency=[0.4, 0.6])
    plant = taut.RigidPlant(arm.with_friction(taut.Friction(coulomb=[0.1, 30.0])))
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    with refused(taut.errors.NumericalError) as caught:
        taut.analysis.identify(taut.run(ctrl, plant, motion, duration=5.0), arm)
    assert caught.value.joint == "joint2"


@pytest.mark.parametrize("name", ["ur10", pytest.param("xarm7", marks=pytest.mark.long)])
def test_a_law_that_is_stiff_about_light_wrists_moves_them(name: str) -> None:
    """Of 5e-4 and 1e-4 kg m^2, against 0.4 N m; as docs/identification.md says."""
    arm = taut.load_arm(name)
    light = np.arange(arm.n) > 2
    law = taut.laws.ComputedTorque(kp=np.where(light, 4e4, 2500.0), kd=np.where(light, 400.0, 100.0))
    motion = taut.analysis.excitation(arm, duration=10.0)
    plant = taut.RigidPlant(loaded(arm, mass=1.0))
    found = taut.analysis.identify(taut.run(taut.compile(law, arm), plant, motion, duration=10.0), arm)
    assert found.arm.payload.mass == pytest.approx(1.0, abs=1e-4)
    assert found.arm.coulomb == pytest.approx(0.4, abs=1e-3)


def test_records_that_do_not_fit_are_refused() -> None:
    arm = arm_of("planar2")
    motion = motion_of("planar2")
    identify, errors = taut.analysis.identify, taut.errors
    run = recorded(arm, taut.RigidPlant(arm), motion, duration=3.0)
    with refused(errors.RangeError):
        identify(run.between(0.0, 0.9), arm)
    with refused(errors.RangeError):
        identify(run.between(0.0, 0.1), arm)
    with refused(errors.RangeError):
        identify(dataclasses.replace(run, info=dataclasses.replace(run.info, rate=50.0)), arm)
    with refused(errors.MatchError):
        identify(run, taut.load_arm("planar3"))
    for runs in ([], 3, "run.mcap", [1]):
        with refused(errors.UsageError):
            identify(runs, arm)  # type: ignore[arg-type]
    law = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    event = taut.Event(t=1.0, set={"plant.payload.mass": 1.0})
    changed = taut.run(law, taut.RigidPlant(arm), motion, duration=3.0, events=[event])
    with refused(errors.UsageError):
        identify(changed, arm)
    push = taut.environments.Push(peak=[10.0, 0.0, 0.0], t=1.0, duration=0.5)
    pushed = taut.run(law, taut.RigidPlant(arm, environment=push), motion, duration=3.0)
    with refused(errors.UsageError):
        identify(pushed, arm)
    for what in ((), ("payload", "links"), ["mass"]):
        with refused(errors.TautError):
            identify(run, arm, what=what)


def test_motions_that_cannot_be_are_refused() -> None:
    arm, make = arm_of("planar2"), taut.analysis.excitation
    for options in (
        {"duration": 15.0},
        {"amplitude": 0.0},
        {"speed": [1.0, 1.0, 1.0]},
        {"harmonics": 1},
        {"seed": -1},
        {"what": 3},
    ):
        with refused(taut.TautError):
            make(arm, **options)  # type: ignore[arg-type]
    with refused(taut.TautError):
        make(arm.with_joints(lower=[0.0, -1.0], upper=[arm.home[0], 2.0]))
    with refused(taut.TautError):
        make(arm.with_joints(effort=1.0))


def test_the_result_prints_its_numbers_and_draws_its_torques() -> None:
    arm = arm_of("planar2")
    found = taut.analysis.identify(recorded(arm, plant_of(loaded(arm)), motion_of("planar2")), arm)
    low, high = found.estimates["payload.m"].interval
    assert low < 2.0 < high
    assert "payload 2 kg" in str(found)
    rows = found.json()["tables"]["estimates"]
    assert {row["parameter"]: row["value"] for row in rows} == {n: e.value for n, e in found.estimates.items()}
    texts = [line.split() for line in str(found).splitlines() if line.startswith(("payload.", "joint"))]
    for name, value, interval, *_ in texts[: len(rows)]:
        assert float(value) == pytest.approx(found.estimates[name].value, abs=0.05 * float(interval)), name
    assert len(found.plot().axes) == 2
    with refused(taut.errors.UnknownNameError):
        found.estimates["payload.mas"]
