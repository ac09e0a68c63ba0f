"""Blend: starts, new gains, new payloads and new laws come in without a jump."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.control.limits import left

L = taut.laws
PANDA = taut.load_arm("panda")
ARM = taut.load_arm("planar2")
Q, V = np.array([0.4, -0.7]), np.array([0.2, -0.1])
REF = taut.JointMotion(q=[0.6, -0.2])
SOON = taut.Limits(blend=0.05)
ROUNDING = 1e-12  # relative to the largest torque
engines = pytest.mark.parametrize("engine", ["native", "float"])


def blending(engine: Any = "native", law: taut.Law | None = None, **limits: Any) -> taut.Controller:
    made = law or L.GravityPID(kp=50.0, kd=5.0, ki=20.0)
    return taut.compile(made, ARM, limits=taut.Limits(**({"blend": 0.05} | limits)), engine=engine)


def twin() -> taut.Controller:
    return taut.compile(L.GravityPID(kp=50.0, kd=5.0, ki=20.0), ARM)


class TestTheShape:
    def test_goes_from_one_to_nothing_without_a_slope_at_either_end(self) -> None:
        phase = np.linspace(0.0, 1.0, 100001)
        shape = left(phase)
        assert shape[0] == 1.0
        assert shape[-1] == 0.0
        slope = np.gradient(shape, phase)
        assert abs(slope[0]) < 1e-4 > abs(slope[-1])
        assert slope.min() == pytest.approx(-1.5, abs=1e-6)
        assert left(7.0) == 0.0


@engines
class TestAtTheStart:
    def test_the_command_begins_at_the_torque_that_holds_the_arm(self, engine: Any) -> None:
        ctrl = blending(engine)
        np.testing.assert_allclose(ctrl.step(Q, V, REF), taut.snapshot(ARM, Q).g, rtol=ROUNDING)

    def test_or_at_what_it_is_told(self, engine: Any) -> None:
        ctrl = blending(engine)
        ctrl.reset(tau_applied=[7.0, -3.0])
        np.testing.assert_allclose(ctrl.step(Q, V, REF), [7.0, -3.0], rtol=ROUNDING)

    def test_and_is_that_of_the_law_when_the_time_is_over_and_exactly(self, engine: Any) -> None:
        ctrl, plain = blending(engine), taut.compile(L.GravityPID(kp=50.0, kd=5.0, ki=20.0), ARM, engine=engine)
        apart = [np.abs(ctrl.step(Q, V, REF) - plain.step(Q, V, REF)).max() for _ in range(60)]
        assert apart[49] > 0.0
        assert apart[51:] == [0.0] * 9
        assert (np.diff(apart) <= 0.0).all()
        np.testing.assert_array_equal(ctrl.terms["blend"], [0.0, 0.0])

    def test_the_blend_is_a_term_that_adds_up(self, engine: Any) -> None:
        ctrl = blending(engine, tau=3.0)
        for _ in range(10):
            tau = ctrl.step(Q, V, REF)
        assert np.abs(ctrl.terms["blend"]).min() > 0.1
        assert np.abs(ctrl.terms["torque_limit"]).max() > 0.1
        np.testing.assert_allclose(sum(ctrl.terms.values()), tau, rtol=1e-12)


CHANGES: dict[str, dict[str, Any]] = {
    "a gain": {"law.kp": 150.0},
    "the gain of an integral": {"law.ki": 80.0},
    "several gains": {"law.kp": 10.0, "law.kd": 20.0, "law.ki": 0.0},
    "the payload": {"model.payload.mass": 3.0, "model.payload.com": [0.0, 0.1, 0.0]},
}


@engines
@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
class TestAChangeOfParameters:
    @pytest.mark.part(1)
    def test_is_not_felt_in_its_tick_and_acts_in_full_after_its_time(
        self, engine: Any, change: dict[str, Any]
    ) -> None:
        ctrl, unchanged = blending(engine), blending(engine)
        for _ in range(80):
            for one in (ctrl, unchanged):
                one.step(Q, V, REF)
        for path, value in change.items():
            ctrl.parameters[path] = value
        moved = Q + 0.001
        tau, wanted = ctrl.step(moved, V, REF), unchanged.step(moved, V, REF)
        np.testing.assert_allclose(tau, wanted, rtol=ROUNDING, atol=1e-11)
        np.testing.assert_allclose(sum(ctrl.terms.values()), tau, rtol=1e-12)
        for _ in range(51):
            tau = ctrl.step(moved, V, REF)
        law = sum(value for name, value in ctrl.terms.items() if name != "blend")
        np.testing.assert_array_equal(ctrl.terms["blend"], 0.0)
        assert np.abs(tau - unchanged.step(moved, V, REF)).max() > 0.1
        np.testing.assert_allclose(tau, law, rtol=1e-12)

    @pytest.mark.part(1)
    def test_in_the_middle_of_another_one_takes_up_what_is_left(self, engine: Any, change: dict[str, Any]) -> None:
        ctrl, unchanged = blending(engine), blending(engine)
        for k in range(70):
            if k == 60:
                for one in (ctrl, unchanged):
                    one.parameters["law.kd"] = 30.0
            for one in (ctrl, unchanged):
                one.step(Q, V, REF)
        for path, value in change.items():
            ctrl.parameters[path] = value
        np.testing.assert_allclose(ctrl.step(Q, V, REF), unchanged.step(Q, V, REF), rtol=ROUNDING, atol=1e-11)

    def test_and_back_within_one_tick_is_no_change(self, engine: Any, change: dict[str, Any]) -> None:
        ctrl, unchanged = blending(engine), blending(engine)
        for one in (ctrl, unchanged):
            one.step(Q, V, REF)
        before = {path: ctrl.parameters[path] for path in change}
        for values in (change, before):
            for path, value in values.items():
                ctrl.parameters[path] = value
        np.testing.assert_allclose(ctrl.step(Q, V, REF), unchanged.step(Q, V, REF), rtol=ROUNDING, atol=1e-11)


@engines
class TestATick:
    def test_that_fails_after_a_change_is_as_if_it_had_not_been(self, engine: Any) -> None:
        ctrl, unchanged = blending(engine), blending(engine)
        for one in (ctrl, unchanged):
            for _ in range(3):
                one.step(Q, V, REF)
        bound = ctrl.bind()
        ctrl.parameters["law.kp"] = 500.0
        bound.q[:] = np.nan
        for _ in range(2):
            with refused(taut.errors.RangeError):
                bound.tick()
        with pytest.raises(taut.errors.ShapeError):
            ctrl.step(np.zeros(3), V, REF)
        assert ctrl.ticks == 3
        np.testing.assert_allclose(ctrl.step(Q, V, REF), unchanged.step(Q, V, REF), rtol=ROUNDING, atol=1e-11)

    def test_after_a_reset_starts_anew_whatever_was_changed_before(self, engine: Any) -> None:
        ctrl = blending(engine)
        ctrl.step(Q, V, REF)
        ctrl.parameters["law.kp"] = 500.0
        ctrl.reset(tau_applied=[1.0, 2.0])
        np.testing.assert_allclose(ctrl.step(Q, V, REF), [1.0, 2.0], rtol=1e-9)
        assert ctrl.ticks == 1

    def test_on_bound_arrays_takes_a_change_up_too(self, engine: Any) -> None:
        ctrl, unchanged = blending(engine), blending(engine)
        bound = [one.bind() for one in (ctrl, unchanged)]
        for k in range(5):
            if k == 4:
                ctrl.parameters["law.kp"] = 500.0
            for one in bound:
                one.q[:], one.v[:], one.ref.q[:] = Q, V, REF.q
                one.tick()
        np.testing.assert_allclose(bound[0].command, bound[1].command, rtol=ROUNDING, atol=1e-11)
        assert ctrl.ticks == unchanged.ticks == 5

    def test_compiles_nothing_when_a_parameter_changes(self, engine: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        ctrl = blending(engine)
        ctrl.step(Q, V, REF)

        def refused(*_: Any, **__: Any) -> None:
            raise AssertionError("it traces or compiles")

        monkeypatch.setattr("taut.codegen.kernel.compiled", refused)
        monkeypatch.setattr("taut.codegen.kernel.trace", refused)
        ctrl.parameters["law.kp"] = 500.0
        ctrl.step(Q, V, REF)
        ctrl.parameters["limits.blend"] = 0.01
        ctrl.step(Q, V, REF)


def test_the_time_itself_may_change_in_the_middle() -> None:
    ctrl = blending()
    before = [ctrl.step(Q, V, REF) for _ in range(20)]
    ctrl.parameters["limits.blend"] = 0.5
    after = [ctrl.step(Q, V, REF) for _ in range(20)]
    steps = np.abs(np.diff(before + after, axis=0)).max(axis=1)
    assert steps[19] < 1.1 * steps[18]
    assert steps[20:].max() < 0.2 * steps[18]


@engines
def test_a_limit_that_changes_acts_at_once_and_leaves_the_blend_alone(engine: Any) -> None:
    ctrl, unchanged = blending(engine, tau=50.0), blending(engine, tau=50.0)
    for k in range(60):
        if k == 20:
            ctrl.parameters["limits.tau"] = 49.0
        np.testing.assert_array_equal(ctrl.step(Q, V, REF), unchanged.step(Q, V, REF))
    ctrl.parameters["limits.tau"] = 1.0
    np.testing.assert_array_equal(np.abs(ctrl.step(Q, V, REF)), 1.0)


@engines
def test_what_sensing_makes_is_blended_too(engine: Any) -> None:
    """The start, and another cutoff of a filter, with the velocity that the filter gives."""
    sensing = taut.Sensing(velocity=taut.sensors.LowPass(cutoff=200.0))
    law, limits = L.GravityPID(kp=50.0, kd=5.0), taut.Limits(blend=0.05)
    ctrl, unchanged = (taut.compile(law, ARM, limits=limits, sensing=sensing, engine=engine) for _ in range(2))
    np.testing.assert_allclose(ctrl.step(Q, V, REF), taut.snapshot(ARM, Q).g, rtol=ROUNDING)
    unchanged.step(Q, V, REF)
    for k in range(30):
        for one in (ctrl, unchanged):
            one.step(Q, V + 0.1 * k, REF)
    ctrl.parameters["sensing.velocity.cutoff"] = 20.0
    moved = unchanged.step(Q, V + 9.0, REF)
    np.testing.assert_allclose(ctrl.step(Q, V + 9.0, REF), moved, rtol=ROUNDING, atol=1e-11)
    assert np.abs(ctrl.terms["blend"]).max() > 1.0


def test_engines_agree_through_changes_of_everything() -> None:
    rng = np.random.default_rng(1)
    ctrls = [blending(engine, tau=8.0, tau_dot=500.0) for engine in ("native", "float")]
    for k in range(200):
        if k % 17 == 5:
            gain = rng.uniform(0.0, 100.0)
            for ctrl in ctrls:
                ctrl.parameters[("law.kp", "law.ki", "model.payload.mass", "limits.tau")[k % 4]] = gain + 1.0
        q, v = Q + 0.01 * rng.standard_normal(2), rng.standard_normal(2)
        taus = [ctrl.step(q, v, REF) for ctrl in ctrls]
        np.testing.assert_allclose(*taus, rtol=0.0, atol=1e-10)


@engines
def test_a_velocity_command_begins_at_rest(engine: Any) -> None:
    ctrl = taut.compile(L.VelocityPI(kp=3.0), ARM, limits=taut.Limits(v=0.3, blend=0.1), engine=engine)
    first = ctrl.step(Q, ref=REF)
    np.testing.assert_allclose(first, 0.0, atol=1e-15)
    for _ in range(200):
        last = ctrl.step(Q, ref=REF)
    np.testing.assert_allclose(last, [0.3, 0.3])
    np.testing.assert_allclose(ctrl.terms["speed_limit"], 0.3 - 3.0 * (REF.q - Q), rtol=1e-12)


def test_another_law_takes_over_at_the_last_command() -> None:
    """PID hands over to computed torque on a moving Panda at 1 kHz, both stepped by hand."""
    dt, ref = 1e-3, taut.trajectories.Quintic(q0=PANDA.home, q1=PANDA.home + 0.2, duration=0.3)
    first = taut.compile(
        L.GravityPID(kp=np.array([300.0] * 4 + [30.0] * 3), kd=np.array([30.0] * 4 + [2.0] * 3)), PANDA
    )
    second = taut.compile(L.ComputedTorque(kp=400.0, kd=40.0), PANDA, limits=taut.Limits(blend=0.1))
    sudden = taut.compile(L.ComputedTorque(kp=400.0, kd=40.0), PANDA)
    q, v, taus = PANDA.home, np.zeros(7), []
    for k in range(420):
        if k == 150:
            jump = np.abs(sudden.step(q, v, ref.at(k * dt)) - taus[-1]).max()
            second.reset(tau_applied=taus[-1])
        taus.append((first if k < 150 else second).step(q, v, ref.at(k * dt)))
        x = taut.snapshot(PANDA, q, v)
        v = v + dt * x.forward_dynamics(taus[-1])
        q = q + dt * v
    steps = np.abs(np.diff(taus, axis=0)).max(axis=1)
    assert jump > 3.0
    assert steps[149] == pytest.approx(0.0, abs=1e-12)
    assert steps[150:].max() < 0.1 * jump
    assert np.abs(q - ref.at(0.3).q).max() < 5e-3


def test_limits_that_are_no_blend_are_refused_in_words() -> None:
    for blend in (0.0, np.inf, [0.1, 0.2]):
        with refused(taut.TautError):
            taut.Limits(blend=blend)


# -------------------------------------------------------------------- the bar

STATES = 10_000


@pytest.mark.bars
def test_no_start_switch_gain_or_payload_makes_a_torque_jump(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    """Panda at random states: with a blend alone the tick of a change gives what it would have without it; with a
    rate limit no step is larger than it."""
    rng, n = np.random.default_rng(9), PANDA.n
    laws = (L.PID(kp=100.0, kd=10.0, ki=30.0), L.ComputedTorque(kp=100.0, kd=20.0, ki=30.0))
    blend = [taut.compile(law, PANDA, limits=taut.Limits(blend=0.2)) for law in laws]
    twins = [taut.compile(law, PANDA, limits=taut.Limits(blend=0.2)) for law in laws]
    rate = [taut.compile(law, PANDA, limits=taut.Limits.of(PANDA, rate=True, blend=0.2)) for law in laws]
    allowed = 10.0 * PANDA.effort * 1e-3
    worst, steepest, count = 0.0, 0.0, share(STATES)
    for k in range(count):
        q, v = rng.uniform(PANDA.lower, PANDA.upper), rng.uniform(-1.0, 1.0, n)
        ref = taut.JointMotion(q=q + 0.3 * rng.standard_normal(n), v=rng.standard_normal(n))
        held, one = rng.uniform(-PANDA.effort, PANDA.effort), k % 2
        path = ("law.kp", "law.kd", "law.ki", "model.payload.mass")[k % 4 if k % 8 < 4 else rng.integers(4)]
        old, new = rng.uniform(0.0, 200.0, 2) if path != "model.payload.mass" else rng.uniform(0.0, 5.0, 2)
        for ctrl, same in ((blend[one], twins[one]), (rate[one], None)):
            following = rate if same is None else blend
            ctrl.reset(tau_applied=held)
            ctrl.parameters[path] = old
            taus = [held, ctrl.step(q, v, ref)]  # the start
            taus.append(ctrl.step(q + 1e-3 * v, v, ref))
            if same is not None:
                same.reset(tau_applied=held)
                same.parameters[path] = old
                for moved in (q, q + 1e-3 * v):
                    same.step(moved, v, ref)
            ctrl.parameters[path] = new
            taus.append(ctrl.step(q + 2e-3 * v, v, ref))  # the change
            if same is not None:
                unchanged = same.step(q + 2e-3 * v, v, ref)
                worst = max(worst, np.abs(taus[1] - held).max(), np.abs(taus[3] - unchanged).max())
            other = following[1 - one]
            other.reset(tau_applied=taus[-1])
            after = other.step(q + 2e-3 * v, v, ref)  # the other law takes over
            if same is None:
                steps = np.abs(np.diff([*taus, after], axis=0))
                steepest = max(steepest, float((steps / allowed).max()))
            else:
                worst = max(worst, np.abs(after - taus[-1]).max())
            if same is not None:
                same.parameters[path] = new
    bar(f"row 9: torque step of a start, switch, gain, payload with a blend, {count} states", f"{worst:.1e} N m")
    bar(f"row 9: the same with a torque rate limit, {count} states, largest step / limit", f"{steepest:.9f}")
    assert worst < 1e-9
    assert steepest <= 1.0 + 1e-9
