"""Limit cycles by describing functions against closed forms and simulation; regions of attraction against statics."""

from __future__ import annotations

import math

import numpy as np
import pytest
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
