"""Designs: one motion in one report, that of the exact hold or of the plant that is given; and what they say of it."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import taut

laws = taut.laws
M = 0.5  # [kg m^2] of one_joint
STEPPED = "1 step of semi-implicit Euler in a period, as plant="


@pytest.fixture(scope="module")
def arm() -> taut.Arm:
    return taut.load_arm("one_joint")


@pytest.fixture(scope="module")
def planar() -> taut.Arm:
    return taut.load_arm("planar2")


def held(kp: float, kd: float, rate: float) -> np.ndarray:
    """Poles in z of M x-ddot = -kp x - kd v under a force that is held: by SciPy's exponential."""
    whole = expm(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0 / M], [0.0, 0.0, 0.0]]) / rate)
    return np.linalg.eigvals(whole[:2, :2] - whole[:2, 2:] @ np.array([[kp, kd]]))


def stepped(kp: float, kd: float, rate: float) -> np.ndarray:
    """The same of one step of semi-implicit Euler a period."""
    T = 1.0 / rate
    row = np.array([-kp * T / M, 1.0 - kd * T / M])
    return np.linalg.eigvals(np.array([[1.0 + T * row[0], T * row[1]], row]))


def damping(z: np.ndarray) -> float:
    s = np.log(z.astype(complex))
    return float(-s.real.sum() / (2.0 * math.sqrt(float(np.prod(s).real))))


@pytest.mark.parametrize(
    ("integrator", "poles"),
    [(None, held), ("rk4", held), ("semi-implicit-euler", stepped)],
    ids=["no plant", "rk4", "Euler"],
)
def test_everything_in_a_report_is_of_one_motion(arm: taut.Arm, integrator: Any, poles: Any) -> None:
    plant = None if integrator is None else taut.RigidPlant(arm, friction=None, integrator=integrator)
    d = taut.design(laws.PID, arm, zeta=0.5, omega_n=40.0, rate=250.0, plant=plant)
    zeta = damping(poles(M * 1600.0, M * 40.0, 250.0))
    for numbers in (d.achieved[0].predicted, d.achieved[0].simulated):
        assert numbers.zeta == pytest.approx(zeta, rel=1e-4)
    assert abs(held(M * 1600.0, M * 40.0, 250.0) - stepped(M * 1600.0, M * 40.0, 250.0)).min() > 1e-3
    least = d.limit("rate").limit
    assert (
        abs(poles(M * 1600.0, M * 40.0, 1.001 * least)).max()
        < 1.0
        < abs(poles(M * 1600.0, M * 40.0, 0.999 * least)).max()
    )
    assert (STEPPED in d.motion) is (poles is stepped)
    assert d.motion in str(d)
    assert d.json()["motion"] == d.motion
    assert d.report_page().settings["predicted and simulated"] == d.motion


def test_a_delay_of_whole_periods_may_be_the_last_that_is_stable(arm: taut.Arm) -> None:
    d = taut.design(laws.PID, arm, zeta=1.0, omega_n=10.0, rate=20.0, plant=taut.RigidPlant(arm))
    told = d.limit("delay")
    assert (told.value, told.limit) == (0.0, 0.0)
    assert told.ok


def test_refusals_are_of_the_same_motion(arm: taut.Arm) -> None:
    with pytest.raises(taut.errors.RangeError, match=r"grows by the factor 8.558 in a tick") as refused:
        taut.design(laws.PID, arm, zeta=1.0, omega_n=3000.0)
    assert refused.value.value == pytest.approx(abs(held(M * 9e6, M * 6000.0, 1000.0)).max(), rel=1e-6)
    with pytest.raises(taut.errors.RangeError, match=rf"at 1000 Hz and {STEPPED} has it.* grows by the factor 13.37"):
        taut.design(laws.PID, arm, zeta=1.0, omega_n=3000.0, plant=taut.RigidPlant(arm))
    with pytest.raises(
        taut.errors.RangeError, match=r"at 20 Hz the sampled loop grows by the factor 1.003 in a tick"
    ):
        taut.design(laws.PID, arm, zeta=0.05, omega_n=5.0, rate=20.0)
    hardly = taut.design(laws.PID, arm, zeta=1.0, omega_n=10.0, rate=11.0)  # stable from 10 Hz on, and hardly damped
    assert not hardly.met
    assert hardly.achieved[0].predicted.zeta < 0.5


def test_friction_and_slow_ticks_take_shorter_steps_of_the_same_motion(arm: taut.Arm) -> None:
    rubbed = arm.with_friction(
        taut.Friction(viscous=20.0, coulomb=0.3)
    )  # b / M = 40 / s, of which rk4 bears 2.8 in a step
    d = taut.design(laws.GravityPID, rubbed, zeta=2.5, omega_n=10.0, rate=20.0, friction="arm")
    gains = {name: float(np.ravel(d.law.parameters()[name])[0]) for name in ("kp", "kd")}
    exact = taut.analysis.second_order(M=M, b=20.0, **gains).sampled(rate=20.0)
    assert d.tried.lin.poles.real == pytest.approx(exact.poles.real, abs=1e-5)
    assert d.achieved[0].simulated.zeta == pytest.approx(d.achieved[0].predicted.zeta, rel=5e-3)


def test_speeds_beyond_reason_are_refused_with_what_is_true_of_them(arm: taut.Arm) -> None:
    for settling in (1e-9, 1e-4, 0.0058):
        with pytest.raises(taut.errors.RangeError, match=r"the sampled loop grows"):
            taut.design(laws.PID, arm, zeta=1.0, settling=settling)
    assert taut.design(laws.PID, arm, zeta=1.0, settling=0.0059).tried.lin.stable
    for settling in (1e6, 1e9):
        with pytest.raises(taut.errors.RangeError, match=r"cannot be tried at 1000 Hz: .* ask for a faster design"):
            taut.design(laws.PID, arm, zeta=1.0, settling=settling)
    d = taut.design(laws.PID, arm, zeta=1.0, settling=1e3)
    assert math.isnan(d.achieved[0].simulated.settling)
    assert "followed for 40 s, which is too short to show where it settles" in str(d)
    assert "never" not in str(d)


def test_no_damping_is_refused_and_no_overshoot_is_critical_damping(arm: taut.Arm) -> None:
    with pytest.raises(taut.errors.RangeError, match=r"zeta must be > 0: .* got 0; zeta = 1 is critical damping"):
        taut.design(laws.PID, arm, zeta=0.0, omega_n=10.0)
    assert taut.analysis.second_order(settling=1.0, overshoot=0.0).zeta == pytest.approx(1.0)


def test_a_swing_that_never_ends_is_not_stable(planar: taut.Arm) -> None:
    def of(kd: float) -> taut.analysis.Linearisation:
        ctrl = taut.compile(laws.GravityPID(kp=40.0, kd=kd), planar)
        return taut.linearise(taut.Loop(ctrl, taut.RigidPlant(planar, friction=None), duration=1.0))

    undamped = of(0.0)
    assert not undamped.stable
    assert undamped.margins.disk.alpha == 0.0
    fastest = max(mode.omega_n for mode in undamped.modes)
    assert f"UNSTABLE: a swing at {fastest:.4g} rad/s goes on for ever" in str(undamped)
    assert of(1e-4).stable


@pytest.mark.parametrize("law", [laws.PID, laws.VelocityPI])
def test_what_creeps_does_not_overshoot(arm: taut.Arm, law: Any) -> None:
    d = taut.design(law, arm, zeta=1.2, omega_n=10.0)
    if law is laws.PID:
        assert [each.overshoot for each in (d.achieved[0].predicted, d.achieved[0].simulated)] == [0.0, 0.0]
    first = taut.design(laws.VelocityPI, arm, bandwidth=10.0)
    assert first.achieved[0].simulated.overshoot == 0.0
    fast = taut.design(law, arm, zeta=0.5, omega_n=10.0)
    assert fast.achieved[0].simulated.overshoot > 15.0


def test_an_integral_that_takes_what_was_asked_is_marked(arm: taut.Arm) -> None:
    d = taut.design(laws.PID, arm, zeta=1.0, omega_n=10.0, integral=0.1)
    told = d.limit("integral")
    assert not told.ok
    pair = min(np.roots([1.0, 20.0, 100.0, 200.0]), key=lambda s: -s.real)
    assert told.value == pytest.approx(-pair.real / abs(pair))
    assert told.limit == pytest.approx(1.0)
    assert re.search(r"!! integral +what was asked for is that without ki", str(d))
    assert taut.design(laws.PID, arm, zeta=1.0, omega_n=10.0, integral=0.005).limit("integral").ok


def test_what_all_of_a_stiffness_makes_is_told_beside_what_was_asked_for(planar: taut.Arm) -> None:
    d = taut.design(laws.Impedance, planar, at=[0.3, 0.8], zeta=0.7, K=(400.0, 20.0))
    assert [each.asked for each in d.stiffness] == [400.0, 400.0, 20.0]
    assert "where K has 400 along it by itself and 413.6 with" in d.limit("at rest").sentence
    assert "designed is more than K where the arm cannot move along one direction without another" in str(d)
    (table,) = (each for each in d.report_page().tables if each.title == "Stiffness at rest")
    assert len(table.rows) == 3
    assert [each.direction for each in d.achieved] == ["about y", "about y (2)"]


def test_more_damping_than_designed_is_no_fault_and_no_limit_is_not_kept(arm: taut.Arm) -> None:
    d = taut.design(laws.ComputedTorque, arm, zeta=2.0, omega_n=10.0, rate=100.0)
    assert d.achieved[0].predicted.zeta > 1.1 * 2.0
    assert d.limit("damping").ok
    count = len(d.limits) - 1
    assert (
        f"It keeps to {count} of {count} limits; 'one_joint' states no torque limits." in d.report_page().summary[0]
    )
    late = taut.design(laws.ComputedTorque, arm, zeta=0.5, omega_n=10.0, delay=2e-2)
    assert not late.limit("damping").ok


def test_modes_of_one_joint_have_names_of_their_own() -> None:
    d = taut.design(laws.GravityPID, taut.load_arm("panda"), zeta=1.0, omega_n=10.0)
    names = [each.direction for each in d.achieved]
    assert len(set(names)) == 7
    assert "mode of panda_joint4 (2)" in names


def test_numbers_of_the_wrong_kind_name_the_way_out(arm: taut.Arm) -> None:
    with pytest.raises(
        taut.errors.UsageError, match=r"K must be \(linear, angular\), six numbers or \(6, 6\); got 3 numbers"
    ):
        taut.design(laws.Impedance, taut.load_arm("planar2"), at=[0.3, 0.8], zeta=0.7, K=(800.0, 30.0, 1.0))
    with pytest.raises(taut.errors.RangeError, match=r"^delay must be .* of 0.001 s; got 0.0005 s; give 0 or 0.001$"):
        taut.design(laws.PID, arm, zeta=1.0, omega_n=10.0, delay=5e-4)


def test_a_sampled_report_names_its_steps() -> None:
    book = taut.analysis.second_order(M=0.5, b=0.1, kd=120.0, zeta=1.0)
    first = str(book.sampled(rate=120.0, integrator="semi-implicit-euler")).splitlines()[0]
    assert first.endswith("at 120 Hz, velocity measured, in one step of semi-implicit-euler a period")
    assert str(book.sampled(rate=120.0)).splitlines()[0].endswith("at 120 Hz, velocity measured")
