"""Speed limits: what drives a joint beyond its limit is taken away, what slows it down is not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

import taut
from taut.control.limits import LIMIT_TERMS, Limits, room

L = taut.laws
PANDA = taut.load_arm("panda")
ARM = taut.load_arm("planar2")
MARGIN = 1e-3  # of a speed limit, by which it is passed with an exact model: rounding, and h that changes in a tick
engines = pytest.mark.parametrize("engine", ["native", "float"])


class Asked(taut.Law):
    """The torque that stands in the reference's acceleration."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(asked=ref.a)


def wanting(tau: Any) -> taut.JointMotion:
    return taut.JointMotion(q=np.zeros(len(tau)), a=tau)


class TestTheRoom:
    V, GAIN, DT = np.asarray(2.0), np.asarray(100.0), 1e-3

    @settings(max_examples=200, deadline=None, derandomize=True)
    @given(st.floats(0.0, 50.0), st.floats(0.0, 50.0))
    def test_falls_with_the_speed_and_is_none_at_the_limit(self, a: float, b: float) -> None:
        of_a, of_b = (room(np.array([x]), self.V, self.GAIN, self.DT)[0] for x in (a, b))
        assert (of_a - of_b) * (a - b) <= 0.0
        assert np.sign(of_a) == np.sign(2.0 - a)

    def test_special_points(self) -> None:
        def at(speed: float) -> float:
            return float(room(np.array([speed]), self.V, self.GAIN, self.DT)[0])

        assert at(2.0) == 0.0
        assert at(0.0) == pytest.approx(2.0 / self.DT)  # to the limit in a tick
        assert at(1.9) == pytest.approx(100.0 * 0.1 * 2.0 / 1.9)
        assert at(3.0) == pytest.approx(-100.0)
        assert float(room(np.array([1.0]), np.asarray(np.inf), self.GAIN, self.DT)[0]) == np.inf


class TestASpeedLimit:
    LIMITS = taut.Limits.of(PANDA, speed=True)

    @pytest.mark.part(2)
    @pytest.mark.parametrize("seed", range(6))
    @pytest.mark.parametrize("with_rate", [False, True])
    def test_holds_for_steps_under_pid_on_a_panda_with_a_load(self, seed: int, with_rate: bool) -> None:
        rng, arm = np.random.default_rng(seed), PANDA.with_payload(2.0)
        law = L.GravityPID(kp=np.array([600.0] * 4 + [60.0] * 3), kd=np.array([30.0] * 4 + [3.0] * 3), ki=20.0)
        limits = taut.Limits.of(arm, rate=with_rate, speed=True)
        goal = arm.home + rng.uniform(-1.0, 1.0, 7) * [1.5, 1.0, 1.5, 0.8, 1.5, 1.0, 1.5]
        ctrl = taut.compile(law, arm, limits=limits)
        out = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=goal), duration=2.0)
        fastest = np.abs(out.v).max(axis=0) / arm.velocity
        assert fastest.max() <= 1.0 + (0.01 if with_rate else MARGIN)
        assert fastest.max() > 0.9
        assert (np.abs(out.command) <= arm.effort).all()
        assert np.abs(out.error[-1]).max() < 0.05
        assert np.any(out.terms["speed_limit"] != 0.0, axis=1).sum() > 20

    def test_lets_a_single_joint_come_up_to_it_as_the_docstring_says(self) -> None:
        arm = taut.load_arm("one_joint").with_joints(viscous=[0.0])
        ctrl = taut.compile(Asked(), arm, limits=taut.Limits(v=1.0, v_gain=50.0))
        out = taut.run(ctrl, taut.RigidPlant(arm), wanting([5.0]), duration=0.3)
        late = (out.t > 0.2) & (out.t < 0.27)
        left = 1.0 - out.v[late, 0]
        assert (left > 0.0).all()
        np.testing.assert_allclose(-np.diff(np.log(left)) / 1e-3, -np.log(1.0 - 0.05) / 1e-3, rtol=1e-2)

    def test_neither_drops_nor_drives_a_loaded_joint_at_its_limit(self) -> None:
        q, v = PANDA.home, PANDA.velocity * np.array([1, -1, 1, -1, 1, -1, 1])
        ctrl = taut.compile(Asked(), PANDA, limits=taut.Limits(v=PANDA.velocity))
        x = taut.snapshot(PANDA, q, v)
        tau = ctrl.step(q, v, wanting(x.M @ (30.0 * np.sign(v)) + x.h))
        np.testing.assert_allclose(x.forward_dynamics(tau), 0.0, atol=1e-9)

    def test_brakes_a_joint_that_is_too_fast_whatever_is_asked(self) -> None:
        ctrl = taut.compile(Asked(), PANDA, limits=taut.Limits(v=PANDA.velocity, v_gain=20.0))
        v = np.array([3.0, 0.0, 0.0, 0.0, 0.0, 0.0, -4.0])
        x = taut.snapshot(PANDA, PANDA.home, v)
        on = x.M @ np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0, -50.0]) + x.h
        a = x.forward_dynamics(ctrl.step(PANDA.home, v, wanting(on)))
        np.testing.assert_allclose(a[[0, 6]], [-20.0 * (3.0 - 2.175), 20.0 * (4.0 - 2.61)], rtol=1e-9)

    @engines
    def test_never_cuts_what_slows_the_arm_down(self, engine: Any) -> None:
        rng = np.random.default_rng(3)
        ctrl = taut.compile(Asked(), ARM, limits=taut.Limits(v=2.0, v_gain=30.0), engine=engine)
        for _ in range(100):
            q, v = rng.uniform(-2.0, 2.0, 2), rng.uniform(-2.0, 2.0, 2)
            x = taut.snapshot(ARM, q, v)
            braking = x.M @ (-np.sign(v) * rng.uniform(0.0, 1e4, 2)) + x.h
            np.testing.assert_array_equal(ctrl.step(q, v, wanting(braking)), braking)

    @engines
    def test_cuts_nothing_of_a_joint_at_rest_that_would_not_break_it_in_a_tick(self, engine: Any) -> None:
        ctrl = taut.compile(Asked(), ARM, limits=taut.Limits(v=2.0), engine=engine)
        x = taut.snapshot(ARM, [0.3, 0.4])
        most = x.M @ np.array([1990.0, -1990.0]) + x.h
        np.testing.assert_array_equal(ctrl.step([0.3, 0.4], [0.0, 0.0], wanting(most)), most)
        more = x.M @ np.array([2500.0, -1000.0]) + x.h
        a = x.forward_dynamics(ctrl.step([0.3, 0.4], [0.0, 0.0], wanting(more)))
        np.testing.assert_allclose(a, [2000.0, -1000.0], rtol=1e-9)

    def test_leaves_the_rest_of_the_arm_alone_where_it_can(self) -> None:
        ctrl = taut.compile(Asked(), PANDA, limits=taut.Limits(v=2.0, v_gain=50.0))
        v = np.array([0.0, 0.0, 0.0, 1.99, 0.0, 0.0, 0.0])
        x = taut.snapshot(PANDA, PANDA.home, v)
        wanted = np.array([1.0, -2.0, 3.0, 40.0, -5.0, 6.0, -7.0])
        a = x.forward_dynamics(ctrl.step(PANDA.home, v, wanting(x.M @ wanted + x.h)))
        np.testing.assert_allclose(a, [1.0, -2.0, 3.0, 50.0 * 0.01 * 2.0 / 1.99, -5.0, 6.0, -7.0], atol=1e-9)

    def test_counts_from_what_the_plant_adds_itself(self) -> None:
        ctrl = taut.compile(Asked(), ARM, limits=taut.Limits(v=1.0), adds=("gravity", "coriolis"))
        on = taut.snapshot(ARM, [0.3, 0.4]).M @ np.array([50.0, 50.0])
        tau = ctrl.step([0.3, 0.4], [1.0, 1.0], wanting(on))
        np.testing.assert_allclose(tau, 0.0, atol=1e-9)
        with refused(taut.errors.MatchError):
            taut.run(ctrl, taut.RigidPlant(ARM), duration=0.1)
        with refused(taut.errors.MatchError):
            taut.run(ctrl, taut.RigidPlant(ARM, adds=("gravity",)), duration=0.1)

    def test_asks_for_a_velocity_even_where_the_law_does_not(self) -> None:
        ctrl = taut.compile(Asked(), ARM, limits=taut.Limits(v=1.0))
        assert ctrl.needs == ("v",)
        assert taut.compile(Asked(), ARM, limits=taut.Limits(tau=1.0)).needs == ()
        by_position = taut.compile(
            Asked(), ARM, limits=taut.Limits(v=1.0), sensing=taut.Sensing(velocity="difference")
        )
        assert by_position.needs == ()
        by_position.step([0.0, 0.0], ref=wanting([9.0, 9.0]))
        x = taut.snapshot(ARM, [0.001, 0.001], [1.0, 1.0])
        tau = by_position.step([0.001, 0.001], ref=wanting(x.M @ np.array([50.0, 50.0]) + x.h))
        np.testing.assert_allclose(x.forward_dynamics(tau), 0.0, atol=1e-6)

    def test_is_a_parameter(self) -> None:
        ctrl = taut.compile(Asked(), ARM, limits=taut.Limits(v=1.0))
        assert ctrl.parameters["limits.v_gain"] == 100.0
        ctrl.parameters["limits.v"] = 0.5
        x = taut.snapshot(ARM, [0.0, 0.0], [0.5, 0.5])
        tau = ctrl.step([0.0, 0.0], [0.5, 0.5], wanting(x.M @ np.array([50.0, 50.0]) + x.h))
        np.testing.assert_allclose(x.forward_dynamics(tau), 0.0, atol=1e-9)
        with refused(taut.errors.RangeError):
            ctrl.parameters["limits.v_gain"] = 1001.0


@engines
class TestOfAVelocityCommand:
    def test_it_is_cut_to_the_limit(self, engine: Any) -> None:
        ctrl = taut.compile(L.VelocityPI(kp=10.0), ARM, limits=taut.Limits(v=[0.5, 0.2]), engine=engine)
        v = ctrl.step([0.0, 0.0], ref=taut.JointMotion(q=[1.0, -0.01]))
        np.testing.assert_allclose(v, [0.5, -0.1])
        np.testing.assert_allclose(ctrl.terms["speed_limit"], [-9.5, 0.0])
        assert "limits.v_gain" not in ctrl.parameters

    def test_its_integral_does_not_wind_up(self, engine: Any) -> None:
        integrals = {}
        for scheme in ("none", "clamping", "back-calculation"):
            law = L.VelocityPI(
                kp=2.0,
                ki=5.0,
                integral=taut.laws.Integral(
                    anti_windup=scheme, **({"tracking": 10.0} if scheme == "back-calculation" else {})
                ),
            )
            ctrl = taut.compile(law, ARM, limits=taut.Limits(v=0.5), engine=engine)
            for _ in range(300):
                ctrl.step([0.0, 0.0], ref=taut.JointMotion(q=[2.0, 0.0]))
            integrals[scheme] = ctrl.terms["I"][0]
        assert integrals["none"] == pytest.approx(3.0)
        assert integrals["clamping"] < 0.05
        assert integrals["back-calculation"] < 0.0  # on its way to where ki e = tracking cut


REFUSED: dict[str, Callable[[], object]] = {
    "v of zero": lambda: Limits(v=0.0),
    "v_gain alone": lambda: Limits(tau=1.0, v_gain=1.0),
    "v_gain without end": lambda: Limits(v=1.0, v_gain=np.inf),
    "v_gain above the rate": lambda: taut.compile(Asked(), ARM, rate=100.0, limits=Limits(v=1.0, v_gain=[10.0, 200.0])),
    "v of three": lambda: taut.compile(Asked(), ARM, limits=Limits(v=[1.0, 2.0, 3.0])),
    "v of an arm without": lambda: Limits.of(ARM.with_joints(effort=[1.0, 1.0], velocity=[np.inf, np.inf]), speed=True),
    "a torque rate of velocities": lambda: taut.compile(L.VelocityPI(kp=1.0), ARM, limits=Limits(v=1.0, tau_dot=1.0)),
    "v_gain of velocities": lambda: taut.compile(L.VelocityPI(kp=1.0), ARM, limits=Limits(v=1.0, v_gain=1.0)),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_speed_limit_is_refused_in_words(what: str) -> None:
    make = REFUSED[what]
    with refused(taut.TautError):
        make()


def test_limits_on_a_position_are_refused_in_words() -> None:
    class Place(taut.Law):
        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Position:
            return taut.Position(wanted=ref.q)

    with refused(taut.errors.MatchError):
        taut.compile(Place(), ARM, limits=Limits(v=1.0))


# -------------------------------------------------------------------- the bar

COMMANDS = 1_000_000


@pytest.mark.bars
def test_every_limit_holds_for_random_commands_and_states(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    """Native ticks of a Panda, one in fifty from a held torque outside the limits; each limit where none that wins
    over it acts."""
    limits = Limits.of(PANDA, rate=True, speed=True)
    count, rng, n = share(COMMANDS), np.random.default_rng(8), PANDA.n
    record = taut.compile(Asked(), PANDA, limits=limits).recording_kernel()
    inputs, outputs = record.blocks.views("inputs"), record.blocks.views("outputs")
    held = record.blocks.views("memory")["limits.tau_applied"]
    rows = {name: np.empty((count, n)) for name in ("asked", "out", "held", "v", *LIMIT_TERMS)}
    q = rng.uniform(PANDA.lower, PANDA.upper, (1000, n))
    rows["v"][:] = rng.uniform(-1.3, 1.3, (count, n)) * PANDA.velocity
    rows["v"][rng.random((count, n)) < 0.05] = 0.0
    rows["asked"][:] = rng.standard_normal((count, n)) * 10.0 ** rng.uniform(-3.0, 4.0, (count, n))
    jumps, jumped = rng.uniform(-3.0, 3.0, (count, n)) * PANDA.effort, rng.random(count) < 0.02
    record.start()
    for k in range(count):
        if jumped[k]:
            held[:] = jumps[k]
        inputs["q"][:], inputs["v"][:], inputs["ref.a"][:] = q[k % 1000], rows["v"][k], rows["asked"][k]
        rows["held"][k] = held
        record.tick()
        rows["out"][k] = outputs["command"]
        for name in LIMIT_TERMS:
            rows[name][k] = outputs[f"terms.{name}"]
    out, by_speed = rows["out"], (rows["speed_limit"] != 0.0).any(axis=1)
    by_torque = (rows["torque_limit"] != 0.0).any(axis=1)
    broken = int((np.abs(out) > PANDA.effort).sum())
    change = np.abs(out - rows["held"])[~by_speed & ~by_torque]
    broken += int((change > 10.0 * PANDA.effort * 1e-3 * (1.0 + 1e-9)).sum())
    added = rows["asked"] + sum(rows[name] for name in LIMIT_TERMS)
    untold = int((np.abs(added - out) > 1e-9 * np.maximum(1.0, np.abs(rows["asked"]))).sum())
    some = np.flatnonzero(by_speed)[:: max(1, int(by_speed.sum()) // 2000)]
    for k in some:  # the acceleration that follows, by another way than the limit's own
        x = taut.snapshot(PANDA, q[k % 1000], rows["v"][k])
        if (np.abs(out[k]) >= PANDA.effort * (1.0 - 1e-9)).any() or (np.abs(x.h) >= PANDA.effort).any():
            continue
        a, speed = x.forward_dynamics(out[k]), np.abs(rows["v"][k])
        most = room(speed, PANDA.velocity, np.asarray(100.0), 1e-3)
        over = a * np.sign(rows["v"][k]) - most
        broken += int((over > 1e-6 * np.maximum(1.0, np.abs(a))).sum())
    bar(f"row 8: limits broken, {count} random commands of a Panda, {int(by_speed.sum())} slowed", broken)
    bar(f"row 8: cuts that are not in the record, {count} random commands", untold)
    assert by_speed.sum() > count // 10 < by_torque.sum()
    assert (rows["rate_limit"] != 0.0).any(axis=1).sum() > count // 10
    assert broken == untold == 0
