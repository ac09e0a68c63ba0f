"""Admittance control: what a hand feels at a UR10 in torque, velocity and position mode; what is refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.control.law import Law
from taut.maths import dynamics
from taut.maths.model import model_of

UR10 = taut.load_arm("ur10").with_joints(viscous=0.0, coulomb=0.0)
HOME = taut.snapshot(UR10, UR10.home).T()
HOLD = taut.TaskMotion(pose=HOME)
RATE, BANDWIDTH, DELAY = 500.0, 60.0, 0.008  # [Hz], [rad/s], [s]
D, B = 10.0, 20.0  # [kg], [N s/m]
WITHIN = 0.05  # what is felt, of what was asked for


class Wave(taut.environments.Environment):
    """A hand whose wrench is a sine of time."""

    amplitude: taut.environments.Field = taut.environments.Field(unit="N, N m", shape=6)
    frequency: taut.environments.Field = taut.environments.Field(1.0, unit="Hz")
    phase: float = 0.0

    def wrench(
        self, T_WE: Any, twist: Any, t: Any, memory: Any, parameters: Mapping[str, Any], dt: Any
    ) -> tuple[Any, dict[str, Any]]:
        angle = 2.0 * math.pi * parameters["frequency"] * t + self.phase
        return parameters["amplitude"] * taut.math.sin(angle), {}


def steady(*wrench: float) -> Wave:
    return Wave(amplitude=wrench, frequency=0.0, phase=0.5 * math.pi)


DRIVES = taut.drives.Actuation(bandwidth=BANDWIDTH, delay=DELAY)
INNER: dict[str, Law] = {
    "velocity": taut.laws.TaskVelocity(kp=2.0, lead=1.0 / BANDWIDTH + DELAY + 0.5 / RATE),
    "position": taut.laws.TaskPosition(kp=2.0, lead=2.0 / BANDWIDTH + DELAY + 1.0 / RATE),
    "torque": taut.laws.TaskComputedTorque(kp=1600.0, kd=80.0),
}


def plant(mode: str, environment: Any, arm: taut.Arm = UR10) -> taut.RigidPlant:
    if mode == "torque":
        return taut.RigidPlant(arm, environment=environment)
    return taut.RigidPlant(arm, takes=mode, actuation=DRIVES, environment=environment)  # type: ignore[arg-type]


def law(mode: str, **more: Any) -> Law:
    return taut.laws.Admittance(**({"D": (D, 1.0), "B": (B, 2.0), "inner": INNER[mode]} | more))


def led(mode: str, environment: Any, duration: float, ref: Any = HOLD, **more: Any) -> taut.Run:
    rate = 1000.0 if mode == "torque" else RATE
    ctrl = taut.compile(law(mode, **more), UR10, rate=rate)
    run = taut.run(ctrl, plant(mode, environment), ref, duration=duration)
    assert run.outcome.ok
    return run


def _pose(q: Any) -> Any:
    T = dynamics.pose(model_of(UR10), q)
    return taut.math.array([*T.p, *T.R.reshape(9)])


POSE = taut.native(_pose, q=6)


def poses(run: taut.Run) -> list[taut.Pose]:
    return [taut.Pose.of(y[3:].reshape(3, 3), y[:3]) for y in map(POSE, run.q)]


def felt(run: taut.Run, frequency: float) -> complex:
    """F / V along x in the last whole periods."""
    w = 2.0 * math.pi * frequency
    periods = math.floor((run.t[-1] - 2.5) * frequency)
    keep = run.t > run.t[-1] - periods / frequency
    t = run.t[keep]
    x = np.array([T.p[0] for T in poses(run)])[keep]

    def phasor(y: np.ndarray) -> complex:
        shapes = np.stack([np.cos(w * t), np.sin(w * t), np.ones_like(t), t], axis=1)
        c, s, *_ = np.linalg.lstsq(shapes, y, rcond=None)[0]
        return complex(c, -s)

    return phasor(run.extra["F_ext"][keep, 0]) / (1j * w * phasor(x))


@pytest.mark.parametrize("mode", ["velocity", "position", "torque"])
class TestAUR10LedByAHand:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("frequency", [0.2, 0.6, 2.0])
    def test_feels_like_the_mass_that_was_asked_for(self, mode: str, frequency: float) -> None:
        w = 2.0 * math.pi * frequency
        wave = Wave(amplitude=(0.03 * w * abs(1j * w * D + B), 0, 0, 0, 0, 0), frequency=frequency)
        run = led(mode, wave, 2.5 + math.ceil(2.0 * frequency) / frequency)
        Z = felt(run, frequency)
        assert Z.imag / w == pytest.approx(D, rel=WITHIN)
        assert abs(Z) == pytest.approx(abs(1j * w * D + B), rel=WITHIN)

    @pytest.mark.part(1)
    def test_feels_like_the_damper_and_the_spring_that_were_asked_for(self, mode: str) -> None:
        push = steady(6.0, 0.0, -3.0, 0.0, 0.5, 0.0)
        run = led(mode, push, 6.0, K=(300.0, 30.0), B=(160.0, 16.0))
        end = poses(run)[-1]
        np.testing.assert_allclose(end.p - HOME.p, [0.02, 0.0, -0.01], atol=2e-4)
        turn = end.R @ HOME.R.T
        np.testing.assert_allclose([turn[0, 2], turn[1, 0]], [math.sin(0.5 / 30.0), 0.0], atol=3e-4)
        run = led(mode, steady(0.0, 4.0, 0.0, 0.0, 0.0, 0.0), 4.0)
        late = poses(run)[-1].p - poses(run)[-501 if mode != "torque" else -1001].p
        np.testing.assert_allclose(late, [0.0, 4.0 / B, 0.0], atol=2e-2 * 4.0 / B)

    @pytest.mark.part(1)
    def test_follows_a_reference_that_moves(self, mode: str) -> None:
        class Line:
            def at(self, t: float) -> taut.TaskMotion:
                a = 2.0 * math.pi * 0.25
                x, v, rate = (
                    0.05 * (1.0 - math.cos(a * t)),
                    0.05 * a * math.sin(a * t),
                    0.05 * a * a * math.cos(a * t),
                )
                pose = taut.Pose.of(HOME.R, HOME.p + np.array([0.0, x, 0.0]))
                return taut.TaskMotion(pose=pose, twist=[0, v, 0, 0, 0, 0], acceleration=[0, rate, 0, 0, 0, 0])

        run = led(mode, steady(*[0.0] * 6), 4.0, ref=Line(), K=(300.0, 30.0), B=(100.0, 10.0))
        wanted = np.stack([Line().at(t).p for t in run.t])
        assert np.abs(np.stack([T.p for T in poses(run)]) - wanted).max() < 1.5e-3


class TestAContact:
    """A spring k that a UR10 in velocity mode leans on needs B > k t, with t the lags between hand and motion."""

    @pytest.mark.part(1)
    @pytest.mark.parametrize("D", [10.0, 40.0])
    @pytest.mark.parametrize(
        ("cutoff", "led", "lag"),
        [(None, True, 0.0), (30.0, True, 1.0 / (2.0 * math.pi * 30.0)), (None, False, 1.0 / BANDWIDTH + DELAY + 0.5 / RATE)],
    )  # fmt: skip
    @pytest.mark.parametrize(("share", "grows"), [(0.75, True), (1.25, False)])
    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_is_stable_with_as_much_damping_as_its_lags_take(
        self, D: float, cutoff: float | None, led: bool, lag: float, share: float, grows: bool
    ) -> None:
        k = 500.0
        B = share * k * (1.5 / RATE + lag)
        inner = INNER["velocity"] if led else taut.laws.TaskVelocity(kp=2.0)
        sensing = None if cutoff is None else taut.Sensing(F_ext=taut.sensors.LowPass(cutoff=cutoff))
        law = taut.laws.Admittance(D=(D, 1.0), B=(B, 2.0), inner=inner)
        rest = HOME.p + np.array([2e-3, 0.0, 0.0])
        spring = taut.environments.Spring(stiffness=[k, 0, 0, 0, 0, 0], at=rest)
        run = taut.run(
            taut.compile(law, UR10, rate=RATE, sensing=sensing), plant("velocity", spring), HOLD, duration=8.0
        )
        x = np.array([T.p[0] for T in poses(run)]) - rest[0]
        assert (np.abs(x[-1000:]).max() > np.abs(x[1000:2000]).max()) == grows


@pytest.mark.long
def test_in_mujoco_a_hand_feels_the_spring_that_was_asked_for() -> None:
    inner = taut.laws.TaskComputedTorque(kp=900.0, kd=60.0)
    law = taut.laws.Admittance(D=(5.0, 0.5), B=(120.0, 12.0), K=(400.0, 40.0), inner=inner)
    ctrl = taut.compile(law, UR10)
    plant = taut.MujocoPlant(UR10, environment=steady(0.0, 8.0, 0.0, 0.0, 0.0, 0.0))
    run = taut.run(ctrl, plant, HOLD, duration=3.0)
    assert run.outcome.ok
    np.testing.assert_allclose(poses(run)[-1].p - HOME.p, [0.0, 0.02, 0.0], atol=3e-4)


class TestTheTwoForms:
    def test_the_chapters_is_impedance_control_with_a_wrist_sensor(self) -> None:
        """Where the model is exact: the same torque, at any state."""
        rng = np.random.default_rng(0)
        gains: dict[str, Any] = {"D": (8.0, 0.8), "B": (50.0, 5.0), "K": (200.0, 20.0)}
        inner = taut.laws.TaskComputedTorque(kp=100.0, kd=20.0, null=None)
        mine = taut.compile(taut.laws.Admittance(model="measured", inner=inner, **gains), UR10)
        theirs = taut.compile(taut.laws.Impedance(null=None, **gains), UR10)
        for _ in range(5):
            q, v, F = UR10.home + 0.05 * rng.standard_normal(6), 0.1 * rng.standard_normal(6), rng.standard_normal(6)
            torques = [ctrl.step(q, v, HOLD, F_ext=F) for ctrl in (mine, theirs)]
            np.testing.assert_allclose(*torques, rtol=0.0, atol=1e-9 * np.abs(torques[1]).max())

    def test_the_chapters_drifts_under_a_load_that_it_does_not_know_and_the_own_model_does_not(self) -> None:
        heavy = UR10.with_payload(0.5)
        away = {}
        for model in ("own", "measured"):
            ctrl = taut.compile(law("torque", model=model), UR10)
            run = taut.run(ctrl, plant("torque", steady(*[0.0] * 6), heavy), HOLD, duration=2.0)
            away[model] = float(np.linalg.norm(taut.snapshot(UR10, run.q[-1]).T().p - HOME.p))
        assert away["own"] < 5e-3
        assert away["measured"] > 10.0 * away["own"]

    def test_without_the_wrench_in_the_torque_a_hand_would_push_past_the_model(self) -> None:
        """The term is there, and it is the measured wrench."""
        ctrl = taut.compile(law("torque"), UR10)
        F = np.array([5.0, 0.0, -2.0, 0.3, 0.0, 0.1])
        ctrl.step(UR10.home, np.zeros(6), HOLD, F_ext=F)
        J = taut.snapshot(UR10, UR10.home).J()
        np.testing.assert_allclose(ctrl.terms["wrench"], -J.T @ F, rtol=1e-12, atol=1e-12)


class TestTheWrench:
    def test_is_taken_at_the_frame_that_is_controlled(self) -> None:
        """A force at the tool, felt at the wrist behind it, turns the virtual mass too."""
        arm = taut.load_arm("panda", tool="panda_hand_tcp")
        inner = taut.laws.TaskVelocity(kp=1.0, tool="panda_link8")
        gains: dict[str, Any] = {"D": (2.0, 0.5), "B": (0.0, 0.0), "tool": "panda_link8"}
        ctrl = taut.compile(taut.laws.Admittance(inner=inner, **gains), arm)
        x = taut.snapshot(arm, arm.home)
        lever, force = x.T().p - x.T("panda_link8").p, np.array([1.0, 2.0, 3.0])
        ref = taut.TaskMotion(pose=x.T("panda_link8"))
        ctrl.step(arm.home, np.zeros(7), ref, F_ext=np.append(force, np.zeros(3)))
        ctrl.step(arm.home, np.zeros(7), ref, F_ext=np.zeros(6))
        expected = np.append(force / 2.0, np.cross(lever, force) / 0.5) * 1e-3
        np.testing.assert_allclose(x.J("panda_link8") @ (ctrl.terms["feedforward"]), expected, rtol=2e-2, atol=2e-5)

    def test_is_bounded_in_its_spring(self) -> None:
        away = taut.TaskMotion(pose=taut.Pose.of(HOME.R, HOME.p + np.array([0.4, 0.0, 0.0])))
        ctrl = taut.compile(law("torque", K=(500.0, 50.0), error_max=(0.02, 0.1), model="measured"), UR10)
        ctrl.step(UR10.home, np.zeros(6), away, F_ext=np.zeros(6))
        J, a = taut.snapshot(UR10, UR10.home).J(), 500.0 * 0.4 / math.sqrt(1.0 + (0.4 / 0.02) ** 2) / D
        x = taut.snapshot(UR10, UR10.home)
        np.testing.assert_allclose((J @ np.linalg.solve(x.M, ctrl.terms["feedforward"]))[0], a, rtol=1e-9)

    def test_that_is_no_number_is_refused(self) -> None:
        ctrl = taut.compile(law("velocity"), UR10, rate=RATE)
        bad = np.array([0.0, 0.0, np.nan, 0.0, 0.0, 0.0])
        with refused(taut.errors.RangeError):
            ctrl.step(UR10.home, np.zeros(6), HOLD, F_ext=bad)

    def test_without_a_sensor_is_told(self) -> None:
        ctrl = taut.compile(law("velocity"), UR10, rate=RATE)
        free = taut.RigidPlant(UR10, takes="velocity", actuation=DRIVES)
        with refused(taut.errors.MatchError):
            taut.run(ctrl, free, HOLD, duration=0.1)
        with refused(taut.TautError):
            ctrl.step(UR10.home, np.zeros(6), HOLD)


class TestRefused:
    @pytest.mark.parametrize(
        "gains",
        [
            {"D": None},
            {"D": (0.0, 1.0)},
            {"D": 2.0},
            {"B": (1.0, 1.0), "zeta": 0.7},
            {"B": None},
            {"B": None, "zeta": 0.7},
            {"inner": taut.laws.PID(kp=1.0)},
            {"inner": 3.0},
            {"tool": "tool0"},
            {"model": "mine"},
            {"frame": "base"},
            {"error_max": 0.1},
            {"error_max": (0.0, 0.1)},
        ],
    )  # fmt: skip
    def test_what_has_no_meaning(self, gains: dict[str, Any]) -> None:
        given = {"D": (D, 1.0), "B": (B, 2.0), "inner": INNER["velocity"]} | gains
        with refused(taut.TautError):
            taut.laws.Admittance(**{name: value for name, value in given.items() if value is not None})

    def test_an_inertia_that_turns_round_within_a_tick(self) -> None:
        with refused(taut.errors.RangeError):
            taut.compile(law("velocity", D=(0.01, 1.0)), UR10, rate=RATE)
        taut.compile(law("velocity", D=(0.0201, 1.0)), UR10, rate=RATE)
        ctrl = taut.compile(law("velocity"), UR10, rate=RATE)
        with refused(taut.errors.RangeError):
            ctrl.parameters["law.D"] = (0.01, 1.0)

    def test_the_chapters_form_where_its_sampled_loop_grows(self) -> None:
        with refused(taut.errors.RangeError):
            taut.compile(law("torque", model="measured", K=(2000.0, 200.0), B=(0.5, 0.05)), UR10)

    def test_the_chapters_form_for_a_velocity_drive(self) -> None:
        with refused(taut.errors.UsageError):
            taut.compile(law("velocity", model="measured"), UR10, rate=RATE)

    def test_feedback_that_is_faster_than_the_rate(self) -> None:
        with refused(taut.errors.RangeError):
            taut.compile(taut.laws.TaskPosition(kp=600.0), UR10, rate=RATE)
