"""Limit cycles by describing functions against closed forms and simulation; regions of attraction against statics."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from cycle_cases import KINDS, case
from refusals import refused

import taut
from taut.base.types import Float64Array

RANGE = (1e-3, 10.0)


def relay(y: Float64Array, _: Float64Array) -> Float64Array:
    return -np.sign(y)


def chain(gain: float = 1.0, dt: float | None = None) -> taut.LinearSystem:
    """gain / (s (s + 1) (s + 2))."""
    system = taut.LinearSystem(A=[[0, 1, 0], [0, 0, 1], [0, -2, -3]], B=[[0], [0], [gain]], C=[[1, 0, 0]])
    return system if dt is None else system.zoh(dt)


@pytest.mark.part(1)
@pytest.mark.parametrize("gain", [0.1, 3.0])
def test_a_relay_swings_as_the_textbook_says(gain: float) -> None:
    (cycle,) = taut.analysis.limit_cycles(chain(gain), {"u[0]": ("y[0]", relay)}, amplitudes=RANGE).cycles
    assert cycle.omega == pytest.approx(math.sqrt(2.0), rel=1e-6)
    assert cycle.period == pytest.approx(2.0 * math.pi / math.sqrt(2.0), rel=1e-6)
    assert cycle.amplitudes["y[0]"] == pytest.approx(4.0 / math.pi * gain / 6.0, rel=1e-4)
    assert cycle.stable


def test_a_sampled_relay_swings_more_slowly_and_wider() -> None:
    slow = taut.analysis.limit_cycles(chain(dt=0.2), {"u[0]": ("y[0]", relay)}, amplitudes=RANGE).cycles[0]
    assert slow.omega < 1.41
    assert slow.amplitudes["y[0]"] > 0.2122
    # against a simulation of the same sampled relay
    system, x, seen = chain(dt=0.2), np.array([0.1, 0.0, 0.0]), []
    for _ in range(2000):
        x = system.A @ x - system.B[:, 0] * np.sign(x[0])
        seen.append(x[0])
    crossings = np.flatnonzero((np.array(seen[:-1]) < 0.0) & (np.array(seen[1:]) >= 0.0))
    assert np.diff(crossings).mean() * 0.2 == pytest.approx(slow.period, rel=0.1)
    assert np.abs(seen[1000:]).max() == pytest.approx(slow.amplitudes["y[0]"], rel=0.15)


def test_a_dead_zone_around_an_unstable_gain_has_an_unstable_cycle() -> None:
    """Gain 9 of a loop whose limit is 6, beyond a dead zone of 1: small motions decay, large ones grow."""

    def dead(y: Float64Array, _: Float64Array) -> Float64Array:
        return -9.0 * (y - np.clip(y, -1.0, 1.0))

    (cycle,) = taut.analysis.limit_cycles(chain(), {"u[0]": ("y[0]", dead)}, amplitudes=(1.01, 100.0)).cycles
    x, share = 1.0 / cycle.amplitudes["y[0]"], 6.0 / 9.0  # 1 - 2/pi (asin x + x sqrt(1 - x^2)) = share
    assert 1.0 - 2.0 / math.pi * (math.asin(x) + x * math.sqrt(1.0 - x * x)) == pytest.approx(share, abs=1e-4)
    assert not cycle.stable
    assert "no stable limit cycle" in str(taut.analysis.LimitCycles(cycles=(cycle,)))


def test_coulomb_friction_alone_makes_no_cycle() -> None:
    joint = taut.error_dynamics(M=0.5, b=0.1, kp=100.0, kd=10.0, rate=1000.0)
    elements = {"disturbance.command[0]": ("v[0]", lambda v, _: -0.4 * np.sign(v))}
    assert not taut.analysis.limit_cycles(joint, elements, amplitudes=(1e-4, 10.0)).cycles


@pytest.mark.bars
def test_no_cycle_of_one_element_is_missed(share: Callable[[int], int], bar: Callable[[str, object], None]) -> None:
    """Nine kinds of elements in random chains: relays, gaps, steps, backlash, friction; against closed-loop roots."""
    count, pairs, cases = 0, 0, share(250)
    for seed in range(cases):
        one = case(seed)
        element = {"u[0]": ("y[0]", one.element)}
        found = taut.analysis.limit_cycles(one.system, element, amplitudes=one.amplitudes).cycles
        known = one.apart(one.cycles())
        for omega, amplitude, stable in known:
            near = [c for c in found if abs(math.log(c.amplitudes["y[0]"] / amplitude)) < 0.01 and c.stable == stable]
            assert any(abs(math.log(c.omega / omega)) < 0.03 for c in near), (seed, one.kind, omega, amplitude)
        assert len(found) >= len(known)
        count, pairs = count + len(known), pairs + (len({stable for *_, stable in known}) == 2)
    assert count >= cases // 3
    assert pairs or cases < 250
    name = f"limit cycles of one element of {len(KINDS)} kinds in random chains, by closed-loop roots; not found"
    bar(name, f"0 of {count}, in {pairs} cases stable and unstable ones")


def test_jumps_between_the_samples_of_a_sine_are_located() -> None:
    """A relay with a dead zone d: A^4 - g^2 A^2 + g^2 d^2 = 0 with g = 4 c |G| / pi, one stable and one not."""

    def with_gap(y: Float64Array, _: Float64Array) -> Float64Array:
        return -np.sign(y) * (np.abs(y) > 0.5)

    cycles = taut.analysis.limit_cycles(chain(10.0), {"u[0]": ("y[0]", with_gap)}, amplitudes=(0.501, 100.0)).cycles
    g = 4.0 / math.pi * 10.0 / 6.0
    both = [math.sqrt(0.5 * g * (g + sign * math.sqrt(g * g - 1.0))) for sign in (-1.0, 1.0)]
    assert sorted((cycle.amplitudes["y[0]"], cycle.stable) for cycle in cycles) == [
        (pytest.approx(both[0], rel=1e-5), False), (pytest.approx(both[1], rel=1e-5), True)
    ]  # fmt: skip


@pytest.mark.part(1)
@pytest.mark.parametrize("seed", [8, 19, 36])
def test_an_element_in_two_parts_makes_the_same_cycles(seed: int) -> None:
    """One of y and one of 3 y, at two inputs that act alike, against the sum of both at one."""
    one, other = case(seed), case(seed + 9)
    system = one.system
    B, C = np.tile(system.B, 2), np.vstack([system.C, 3.0 * system.C])
    two = taut.LinearSystem(A=system.A, B=B, C=C)
    elements = {"u[0]": ("y[0]", one.element), "u[1]": ("y[1]", other.element)}
    both = {"u[0]": ("y[0]", lambda y, rate: one.element(y, rate) + other.element(3.0 * y, 3.0 * rate))}
    low, high = max(one.amplitudes[0], other.amplitudes[0]), one.amplitudes[1]
    expected = taut.analysis.limit_cycles(system, both, amplitudes=(low, high)).cycles
    found = taut.analysis.limit_cycles(two, elements, amplitudes=(low, high)).cycles
    assert [(c.omega, c.amplitudes["y[0]"]) for c in found] == [
        (pytest.approx(c.omega, rel=1e-3), pytest.approx(c.amplitudes["y[0]"], rel=1e-3)) for c in expected
    ]
    assert [c.stable for c in found] == [c.stable for c in expected]


def test_what_cannot_be_looked_at_is_refused() -> None:
    for elements, error in (
        ({}, taut.errors.UsageError),
        ({"u": ("y[0]", relay), "w": ("y[0]", relay)}, taut.errors.UnknownNameError),
        ({"u[0]": ("y[0]", 3.0)}, taut.errors.ShapeError),
        ({"u[0]": ("y[0]", lambda y, rate: y * np.nan)}, taut.errors.RangeError),
    ):
        with pytest.raises(error):
            taut.analysis.limit_cycles(chain(), elements, amplitudes=RANGE)  # type: ignore[arg-type]
    with pytest.raises(taut.errors.RangeError):
        taut.analysis.limit_cycles(chain(), {"u[0]": ("y[0]", relay)}, amplitudes=(1.0, 0.1))


def upright(limit: float, duration: float = 6.0) -> taut.Loop:
    """The chapter's link held upright, its torque limited to less than its weight needs when it lies."""
    arm = taut.load_arm("one_joint")
    law = taut.laws.PID(kp=20.0, kd=8.0) + taut.laws.GravityCompensation()
    ctrl = taut.compile(law, arm, limits=taut.Limits(tau=limit))
    ref = taut.JointMotion(q=[0.5 * math.pi])
    return taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), ref, duration=duration)


@pytest.mark.part(1)
@pytest.mark.parametrize("limit", [0.3, 0.6])
def test_a_limited_torque_holds_as_far_as_statics_allow(limit: float) -> None:
    found = taut.analysis.region_of_attraction(upright(limit), q=1.2, at=[0.5 * math.pi], samples=80)
    border = math.asin(limit / 0.981) / 1.2
    nearest_lost, furthest_back = found.radius, float(found.distance[found.attracted].max())
    assert furthest_back < border * 1.05
    assert nearest_lost > border * 0.95
    low, high = found.interval
    assert low < border < high  # starts are uniform in the one direction


def test_a_global_law_brings_back_every_start() -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(taut.laws.GravityPID(kp=50.0, kd=20.0), arm)
    loop = taut.Loop(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=arm.home), duration=4.0)
    found = taut.analysis.region_of_attraction(loop, q=[1.0, 2.0], v=2.0, samples=20)
    assert found.attracted.all()
    assert found.radius == math.inf
    again = taut.analysis.region_of_attraction(loop, q=[1.0, 2.0], v=2.0, samples=20)
    np.testing.assert_array_equal(found.q, again.q)


def test_a_loop_that_does_not_rest_has_no_region() -> None:
    with refused(taut.errors.UsageError):
        taut.analysis.region_of_attraction(upright(0.3), q=1.0, at=[0.0], samples=5)
    with refused(taut.errors.ShapeError):
        taut.analysis.region_of_attraction(upright(0.3), q=[1.0, 1.0], samples=5)
