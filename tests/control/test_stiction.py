"""Dither, and gains raised near zero velocity: the closed loops that they state, and what they refuse."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut

L = taut.laws
LINK = taut.load_arm("one_joint").with_joints(viscous=[0.0], coulomb=[0.3])
ARM = taut.load_arm("planar2")
Q, V = np.array([0.4, -0.7]), np.array([0.02, -0.5])
REF = taut.JointMotion(q=[0.6, -0.2], v=[0.0, 0.1])
engines = pytest.mark.parametrize("engine", ["native", "float"])
MU, M = 0.3, 0.5


class Push(taut.Law):
    """A constant torque on top of the weight."""

    push: taut.Gain  # [N m]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(push=self.push @ np.ones(x.n), gravity=x.g)


class TestDither:
    @engines
    def test_is_a_sine_with_a_term_of_its_own(self, engine: Any) -> None:
        law = L.PID(kp=10.0) + L.Dither(amplitude=[0.5, 0.2], frequency=[40.0, 125.0])
        ctrl = taut.compile(law, ARM, engine=engine)
        for k in range(200):
            tau = ctrl.step(Q, V, REF)
            wave = [0.5 * np.sin(2.0 * np.pi * 40.0 * k * 1e-3), 0.2 * np.sin(2.0 * np.pi * 125.0 * k * 1e-3)]
            np.testing.assert_allclose(ctrl.terms["dither"], wave, atol=1e-12)
            np.testing.assert_allclose(tau, 10.0 * (REF.q - Q) + wave, atol=1e-12)

    def test_has_no_mean(self) -> None:
        ctrl = taut.compile(L.Dither(amplitude=1.0, frequency=50.0), ARM)
        assert abs(np.mean([ctrl.step(Q, ref=REF) for _ in range(1000)])) < 1e-12

    def test_stays_a_sine_after_hours(self) -> None:
        law, arm = L.Dither(amplitude=1.0, frequency=130.0), taut.load_arm("one_joint")
        x = taut.snapshot(arm, [0.0])
        later = taut.Snapshot(x.model, q=x.q, v=x.v, t=36_000.003)
        wave = law.command(later, REF).total  # type: ignore[attr-defined]
        np.testing.assert_allclose(wave, np.sin(2.0 * np.pi * ((130 * 36_000_003 % 1000) / 1000)), atol=1e-8)

    @pytest.mark.parametrize("push", [0.02, 0.1, 0.2])
    def test_lets_a_push_below_the_dry_friction_move_the_joint_as_the_docstring_says(self, push: float) -> None:
        A, f = 1.0, 50.0
        ctrl = taut.compile(Push(push=push) + L.Dither(amplitude=A, frequency=f), LINK, rate=8000.0)
        out = taut.run(ctrl, taut.RigidPlant(LINK), taut.hold(), q0=[0.0], duration=4.0)
        half = len(out.t) // 2
        drift = (out.q[-1, 0] - out.q[half, 0]) / (out.t[-1] - out.t[half])
        shaken = np.sqrt(A**2 - (4.0 * MU / np.pi) ** 2) / (2.0 * np.pi * f * M)
        assert drift == pytest.approx(shaken * np.sin(0.5 * np.pi * push / MU), rel=0.1)
        still = taut.compile(Push(push=push), LINK)
        stuck = taut.run(still, taut.RigidPlant(LINK), taut.hold(), q0=[0.0], duration=1.0)
        np.testing.assert_allclose(stuck.q, 0.0, atol=1e-12)

    def test_lets_a_joint_reach_a_goal_before_which_it_sticks(self) -> None:
        law, goal = L.GravityPID(kp=5.0, kd=2.0), taut.JointMotion(q=[0.1])
        plant = taut.RigidPlant(LINK)
        stuck = taut.run(taut.compile(law, LINK), plant, goal, q0=[0.0], duration=20.0)
        shaken = law + L.Dither(amplitude=1.0, frequency=30.0)
        freed = taut.run(taut.compile(shaken, LINK), plant, goal, q0=[0.0], duration=20.0)
        assert stuck.error[-1, 0] > 0.05
        assert np.abs(freed.error[-1000:, 0].mean()) < 0.002


class Springy(taut.Law):
    """A law of somebody else's: kp and kd are raised, K is not."""

    kp: taut.Gain  # [N m/rad]
    kd: taut.Gain  # [N m s/rad]
    K: taut.Gain  # [N m/rad]
    e_int: taut.Memory = taut.Memory(0.0)
    last: taut.Memory = taut.Memory(0.0)

    def command(self, x: taut.Snapshot, ref: taut.JointMotion, memory: Any, dt: float) -> Any:
        e = ref.q - x.q
        e_int = memory.e_int + e * dt
        torque = taut.Torque(
            P=self.kp @ e, D=-(self.kd @ x.v), K=self.K @ e, I=10.0 * e_int, last=memory.last + 0.0 * e
        )
        return torque, {"e_int": e_int, "last": e}


def raising(v: Any, factor: Any = 4.0, width: Any = 0.1) -> np.ndarray[Any, Any]:
    return 1.0 + (np.asarray(factor) - 1.0) * np.exp(-((np.asarray(v) / np.asarray(width)) ** 2))


INNER: dict[str, taut.Law] = {
    "PID": L.PID(kp=[10.0, 20.0], kd=2.0),
    "GravityPID": L.GravityPID(kp=10.0, kd=2.0),
    "ComputedTorque": L.ComputedTorque(kp=[10.0, 20.0], kd=2.0),
}


class TestRaisedGains:
    @engines
    @pytest.mark.parametrize("name", INNER)
    def test_are_those_of_the_law_times_the_stated_factor(self, name: str, engine: Any) -> None:
        law = L.RaisedGains(inner=INNER[name], factor=4.0, width=0.1)
        s = raising(V)
        by_hand = {key: gain.as_array() * s for key, gain in INNER[name].gains().items()}
        wanted = taut.compile(type(INNER[name])(**by_hand), ARM, engine=engine).step(Q, V, REF)
        np.testing.assert_allclose(taut.compile(law, ARM, engine=engine).step(Q, V, REF), wanted, rtol=1e-12)

    def test_a_matrix_stays_symmetric_and_is_raised_joint_by_joint(self) -> None:
        K = np.array([[20.0, 5.0], [5.0, 30.0]])
        law = L.RaisedGains(inner=L.PID(kp=K), factor=[4.0, 9.0], width=0.1)
        root = np.diag(np.sqrt(raising(V, [4.0, 9.0])))
        tau = taut.compile(law, ARM).step(Q, V, REF)
        np.testing.assert_allclose(tau, root @ K @ root @ (REF.q - Q), rtol=1e-12)

    @engines
    def test_the_integral_runs_faster_near_rest_and_does_not_breathe(self, engine: Any) -> None:
        law = L.RaisedGains(inner=L.PID(kp=1.0, ki=10.0), factor=5.0, width=0.1)
        ctrl = taut.compile(law, ARM, engine=engine)
        e = REF.q - Q
        for _ in range(100):
            ctrl.step(Q, np.zeros(2), REF)
        at_rest = ctrl.terms["I"]
        np.testing.assert_allclose(at_rest, 10.0 * e * 1e-3 * (99 * 5.0 + 1.0), rtol=1e-12)
        ctrl.step(Q, np.array([5.0, 5.0]), REF)
        np.testing.assert_allclose(ctrl.terms["I"] - at_rest, 5.0 * 10.0 * e * 1e-3, rtol=1e-9)

    def test_no_term_jumps_however_the_velocity_moves(self) -> None:
        law = L.RaisedGains(inner=L.PID(kp=10.0, kd=1.0, ki=10.0), factor=5.0, width=0.05)
        ctrl, seen = taut.compile(law, ARM), []
        speeds = np.concatenate([np.linspace(-0.3, 0.3, 601), np.linspace(0.3, -0.3, 601)])
        for v in speeds:
            ctrl.step(Q, np.array([v, -v]), REF)
            seen.append([ctrl.terms[name] for name in ("P", "I", "D")])
        steepest = np.abs(np.diff(seen, axis=0)).max()
        assert steepest < 10.0 * 4.0 * 0.86 / 0.05 * 1e-3 * 0.5 * 1.05  # kp (factor - 1) max|ds/dv| dv |e|

    def test_a_law_of_ones_own_has_kp_kd_and_e_int_raised_and_nothing_else(self) -> None:
        law = L.RaisedGains(inner=Springy(kp=10.0, kd=1.0, K=7.0), factor=3.0, width=0.1)
        ctrl, s, e = taut.compile(law, ARM), raising(V, 3.0), REF.q - Q
        for _ in range(2):
            ctrl.step(Q, V, REF)
        terms = ctrl.terms
        np.testing.assert_allclose(terms["P"], s * 10.0 * e)
        np.testing.assert_allclose(terms["D"], -s * V)
        np.testing.assert_allclose(terms["K"], 7.0 * e)
        np.testing.assert_allclose(terms["I"], 10.0 * 1e-3 * (s * e + e))
        np.testing.assert_allclose(terms["last"], e)

    def test_the_laws_of_a_sum_are_raised_too(self) -> None:
        pid = L.PID(kp=10.0, kd=1.0, ki=3.0)
        law = L.RaisedGains(inner=L.FeedForward() + pid, factor=3.0, width=0.1)
        other = L.FeedForward() + L.RaisedGains(inner=pid, factor=3.0, width=0.1)
        ours, theirs = taut.compile(law, ARM), taut.compile(other, ARM)
        for _ in range(3):
            np.testing.assert_allclose(ours.step(Q, V, REF), theirs.step(Q, V, REF), rtol=1e-12)
        assert "law.inner.PID.kp" in ours.parameters
        assert "law.RaisedGains.inner.kp" in theirs.parameters

    def test_gains_are_parameters_of_the_law_that_is_held(self) -> None:
        ctrl = taut.compile(L.RaisedGains(inner=L.PID(kp=10.0), factor=1.0), ARM)
        ctrl.parameters["law.inner.kp"] = 20.0
        ctrl.parameters["law.factor"] = 2.0
        np.testing.assert_allclose(ctrl.step(Q, np.zeros(2), REF), 40.0 * (REF.q - Q))
        with refused(taut.errors.RangeError):
            ctrl.parameters["law.factor"] = 0.5

    @pytest.mark.parametrize("factor", [2.0, 5.0])
    def test_leave_of_a_stuck_joints_error_what_the_docstring_says(self, factor: float) -> None:
        inner = L.GravityPID(kp=5.0, kd=2.0)
        ctrl = taut.compile(L.RaisedGains(inner=inner, factor=factor, width=0.05), LINK)
        out = taut.run(ctrl, taut.RigidPlant(LINK), taut.JointMotion(q=[0.2]), q0=[0.0], duration=20.0)
        assert 0.5 * MU / (factor * 5.0) < out.error[-1, 0] <= MU / (factor * 5.0) + 1e-9
        assert abs(out.v[-1, 0]) < 1e-9

    def test_its_explanation_names_both_laws(self) -> None:
        text = taut.compile(L.RaisedGains(inner=L.PID(kp=1.0), factor=2.0), ARM).explanation()
        assert text.startswith("RaisedGains for arm 'planar2' (2 joints) at 1000 Hz")
        assert "inner: PID control" in text
        assert "law.width" in text


REFUSED: dict[str, Callable[[], object]] = {
    "a dither that is too fast": lambda: taut.compile(L.PID(kp=1.0) + L.Dither(amplitude=1.0, frequency=600.0), ARM),
    "at half the rate": lambda: taut.compile(L.Dither(amplitude=1.0, frequency=[1.0, 100.0]), ARM, rate=200.0),
    "a negative amplitude": lambda: L.Dither(amplitude=-1.0, frequency=1.0),
    "a matrix of frequencies": lambda: L.Dither(amplitude=1.0, frequency=np.eye(2)),
    "a dither without": lambda: L.Dither(amplitude=1.0),
    "a factor below one": lambda: L.RaisedGains(inner=L.PID(kp=1.0), factor=0.5),
    "a matrix of factors": lambda: L.RaisedGains(inner=L.PID(kp=1.0), factor=2.0 * np.eye(2)),
    "a width of zero": lambda: L.RaisedGains(inner=L.PID(kp=1.0), factor=2.0, width=0.0),
    "no gains": lambda: L.RaisedGains(inner=L.FeedForward(), factor=2.0),
    "no law": lambda: L.RaisedGains(inner=5.0, factor=2.0),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_is_refused_in_words(what: str) -> None:
    make = REFUSED[what]
    with refused(taut.TautError):
        make()


class TestRaisedBackCalculation:
    """Near rest the integral runs `factor` times as fast, and is driven back as much faster."""

    @staticmethod
    def compiled(factor: float, tracking: float) -> taut.Controller:
        inner = L.PID(
            kp=20.0, kd=2.0, ki=50.0, integral=taut.laws.Integral(anti_windup="back-calculation", tracking=tracking)
        )
        law = L.RaisedGains(inner=inner, factor=factor, width=10.0)
        return taut.compile(law, taut.load_arm("one_joint"), rate=1000.0, limits=taut.Limits(tau=1.0))

    def test_at_the_rate_it_is_steady(self) -> None:
        ctrl = self.compiled(4.0, 250.0)
        out = taut.run(ctrl, taut.RigidPlant(ctrl.arm), taut.JointMotion(q=[1.5]), duration=0.5)
        assert np.abs(np.diff(out.terms["I"][100:, 0])).max() < 0.05


def test_a_frequency_is_checked_when_it_changes_too() -> None:
    ctrl = taut.compile(L.PID(kp=1.0) + L.Dither(amplitude=1.0, frequency=60.0), ARM)
    with refused(taut.errors.RangeError):
        ctrl.parameters["law.Dither.frequency"] = 700.0
    assert ctrl.parameters["law.Dither.frequency"] == 60.0
    event = taut.Event(t=0.1, set={"law.Dither.frequency": 700.0})
    with refused(taut.errors.RangeError):
        taut.run(ctrl, taut.RigidPlant(ARM), duration=0.2, events=[event])


def test_a_dither_without_a_frequency_is_refused() -> None:
    with refused(taut.errors.RangeError):
        taut.laws.Dither(amplitude=1.0, frequency=0.0)
