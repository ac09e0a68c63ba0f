"""What the doctor advises: numbers that take the fault away when they are applied, and words that say what is so."""

from __future__ import annotations

import dataclasses
import functools
import re
from typing import Any

import diagnosis_runs as runs
import numpy as np
import pytest

import taut
from taut.analysis.diagnosis.line import line_of

L = taut.laws
RATE = 200.0


def off(name: str, size: float) -> np.ndarray:
    """A start beside home."""
    arm = runs.arm_of(name)
    return np.asarray(arm.home + size * np.random.default_rng(17).uniform(-1.0, 1.0, arm.n))


def held(name: str, law: taut.Law, *, rate: float = 1000.0, size: float = 0.03, **more: Any) -> taut.Run:
    """An arm that is to come home."""
    arm = runs.arm_of(name)
    home: Any = taut.JointMotion(q=arm.home)
    if not isinstance(law, (L.ComputedTorque, L.GravityPID)):
        home = taut.TaskMotion(pose=runs.pose_of(name))
    limits = taut.Limits.of(arm) if np.isfinite(arm.effort).all() else None
    ctrl = taut.compile(law, arm, rate=rate, limits=limits)
    plant = taut.RigidPlant(arm, substeps=max(1, round(1000.0 / rate)), **more)
    return taut.run(ctrl, plant, home, duration=2.0, q0=off(name, size), progress=False)


def joint_gains(name: str, kp: float, kd: float, ki: float = 0.0) -> taut.Law:
    """PD of each joint, by its inertia."""
    m = runs.inertia(name)
    return L.GravityPID(kp=kp * m, kd=kd * m, ki=ki * m)


CURES: dict[str, tuple[Any, dict[str, Any], str]] = {
    "damping of computed torque": (lambda n, d, i: L.ComputedTorque(kp=484.0, kd=1.32 * d), {}, "D"),
    "damping of joints": (lambda n, d, i: joint_gains(n, 484.0, 1.32 * d), {}, "D"),
    "damping of a task": (lambda n, d, i: L.TaskComputedTorque(kp=484.0, kd=1.32 * d), {}, "D"),
    "integral of computed torque": (lambda n, d, i: L.ComputedTorque(kp=225.0, kd=15.0, ki=3900.0 * i), {}, "I"),
    "rate of computed torque": (
        lambda n, d, i: L.ComputedTorque(kp=100.0, kd=1.1 * 2.0 * RATE * d),
        {"rate": RATE, "size": 1e-3},
        "D",
    ),
    "delay of a task": (
        lambda n, d, i: L.TaskComputedTorque(kp=800.0 * d**2, kd=170.0 * d),
        {"size": 1e-3, "actuation": taut.drives.Actuation(delay=0.012)},
        "delay",
    ),
}
CASES = [(cure, arm) for cure in CURES for arm in ("ur5", "two_link")]
CASES = [(cure, arm) for cure, arm in CASES if not (arm == "two_link" and cure.endswith("of a task"))]


@pytest.mark.parametrize(("cure", "arm"), CASES)
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_what_is_advised_for_an_oscillation_ends_it(cure: str, arm: str) -> None:
    """The factor that the remedy says, on the law's own gain: then nothing swings any more."""
    law, more, term = CURES[cure]
    found = taut.doctor(held(arm, law(arm, 1.0, 1.0), **more)).findings[0]
    assert (found.name, found.term) == ("oscillates", term)
    told = re.search(r"(?:damping|kd|ki,?)(?: to)? ([\d.e-]+)(?: times| of what it is)", found.remedy)
    assert told is not None, found.remedy
    factor = float(told[1])
    after = taut.doctor(held(arm, law(arm, factor, factor), **more)).findings
    assert not any(each.name == "oscillates" for each in after)


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_the_damping_of_a_law_of_accelerations_is_told_in_times_of_its_own() -> None:
    """zeta is 0.03: 23.3 times as much is 0.7, in whatever joint the swing shows most."""
    found = taut.doctor(held("ur5", L.ComputedTorque(kp=484.0, kd=1.32))).findings[0]
    times = re.search(r"raise the damping ([\d.]+) times", found.remedy)
    assert times is not None
    assert float(times[1]) == pytest.approx(0.7 / 0.03, rel=0.01)
    found = taut.doctor(held("two_link", L.ComputedTorque(kp=100.0, kd=440.0), rate=RATE, size=1e-3)).findings[0]
    assert "it is 440 1/s of the inertia that it moves, and a sampled loop bears 2 / T = 400 1/s" in found.remedy


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_an_integral_is_told_with_its_unit_and_bound() -> None:
    """kp kd of computed torque is the bound of ki, whatever the inertia is."""
    found = taut.doctor(held("ur5", L.ComputedTorque(kp=225.0, kd=15.0, ki=3900.0))).findings[0]
    told = re.search(r"it is ([\d.]+) N m/\(rad s\), and it must stay under .* = ([\d.]+)", found.remedy)
    assert told is not None
    assert float(told[1]) / float(told[2]) == pytest.approx(3900.0 / (225.0 * 15.0), rel=0.02)


class Driven(taut.Law):
    """PD with gravity compensation whose damping has the wrong sign.

    Law:          tau = kp e - kd e_dot + g
    Closed loop:  M e_ddot - kd e_dot + kp e = 0
    """

    kp: taut.Gain
    kd: taut.Gain

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=self.kp @ x.difference(ref.q), D=-(self.kd @ (ref.v - x.v)), gravity=x.g)


class OneSpring(taut.Law):
    """PD with gravity compensation, with the spring of the second joint turned round.

    Law:          tau = s kp e + kd e_dot + g, with s = -1 at the second joint
    Closed loop:  M e_ddot + kd e_dot + s kp e = 0
    """

    kp: taut.Gain
    kd: taut.Gain

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        s = np.where(np.arange(x.n) == 1, -1.0, 1.0)
        return taut.Torque(P=s * (self.kp @ x.difference(ref.q)), D=self.kd @ (ref.v - x.v), gravity=x.g)


def along(name: str, law: type[taut.Law], kd: float) -> tuple[taut.analysis.Finding, ...]:
    """Along a way, from rest: the error begins at nothing."""
    arm, m = runs.arm_of(name), runs.inertia(name)
    way = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + np.linspace(0.3, 0.1, arm.n), duration=0.6)
    ctrl = taut.compile(law(kp=100.0 * m, kd=kd * m), arm, limits=taut.Limits.of(arm))
    return taut.doctor(taut.run(ctrl, taut.RigidPlant(arm), way, duration=1.5, progress=False)).findings


@pytest.mark.parametrize("name", ["gantry3", "two_link"])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_damping_that_drives_is_a_wrong_sign(name: str) -> None:
    first, *others = along(name, Driven, 4.0)
    assert (first.name, first.term) == ("wrong sign", "D")
    assert "turn the sign of the damping round" in first.remedy
    assert all(each.follows == "wrong sign" for each in others)


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_of_one_spring_that_is_turned_its_own_joint_is_told() -> None:
    """Others are pushed off their targets by it, and theirs are the first in the list."""
    arm = runs.arm_of("ur5")
    found = along("ur5", OneSpring, 10.0)[0]
    assert (found.name, found.term, found.joint) == ("wrong sign", "P", arm.joint_names[1])
    assert found.evidence["P over error"].value < 0.0
    assert found.evidence["P over error"].unit == "N m/rad"


@pytest.mark.parametrize("name", ["gantry3", "one_joint"])
@pytest.mark.parametrize("delay", [0.002, 0.008])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_loop_that_runs_away_within_two_periods_is_told_what_feeds_it(name: str, delay: float) -> None:
    """3.5 times what the delay bears: a tenth of it is left at a phase margin of 60 degrees."""
    kd = 3.5 * 0.5 * np.pi / (delay + 0.5e-3)
    arm = runs.arm_of(name)
    ctrl = taut.compile(L.ComputedTorque(kp=0.05 * kd**2, kd=kd), arm)
    way = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.2, duration=1.0)
    run = taut.run(ctrl, taut.RigidPlant(arm, actuation=taut.drives.Actuation(delay=delay)), way, duration=1.0)
    told = taut.doctor(run)
    assert [(each.name, each.term) for each in told.findings if each.follows is None] == [("oscillates", "delay")]
    times = re.search(r"lower the damping to ([\d.]+) of what it is", told.findings[0].remedy)
    assert times is not None
    assert float(times[1]) == pytest.approx(1.0 / 10.5, rel=0.15)


def test_winding_up_is_found_though_the_error_began_the_other_way() -> None:
    """The first ticks have an error of 1e-9 rad of the other sign: that is no return to the target."""
    arm = runs.arm_of("gantry3")
    need = 5.77 * 0.6 / 0.25 * float(np.asarray(taut.snapshot(arm, arm.home, np.zeros(3)).M)[0, 0])
    law = L.ComputedTorque(kp=100.0, kd=20.0, ki=[150.0, 0.0, 0.0], integral=taut.laws.Integral(anti_windup="none"))
    limits = taut.Limits(tau=[0.4 * need, np.inf, np.inf])
    way = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + np.array([0.6, 0.0, 0.0]), duration=0.5)
    start = arm.home + np.array([1e-9, 0.0, 0.0])
    run = taut.run(taut.compile(law, arm, limits=limits), taut.RigidPlant(arm), way, duration=3.0, q0=start)
    assert run.error is not None
    assert run.error[0, 0] < 0.0
    found = taut.doctor(run).findings
    assert [(each.name, each.follows) for each in found] == [("winds up", None), ("saturates", "winds up")]


def test_a_joint_that_never_moved_has_no_friction_to_be_fitted() -> None:
    """Of what holds it, only the torque that did not move it is known."""
    arm = runs.arm_of("gantry3")
    m = runs.inertia("gantry3")
    true = arm.with_friction(taut.Friction(coulomb=[0.3 * m[0], 10.0 * m[1], 0.0]))
    way = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + np.array([0.3, 0.04, 0.0]), duration=1.2)
    run = taut.run(taut.compile(joint_gains("gantry3", 100.0, 20.0), arm), taut.RigidPlant(true), way, duration=2.0)
    assert np.all(run.q[:, 1] == arm.home[1])
    found = taut.doctor(run).findings[0]
    assert (found.name, found.joint) == ("sticks", "y")
    assert 100.0 * m[1] * 0.04 < found.evidence["torque that does not move it"].value < 10.0 * m[1]
    assert "dry friction fitted" not in found.evidence


def test_a_sensor_that_was_unplugged_is_told_and_the_rest_is_judged() -> None:
    arm = runs.arm_of("gantry3")
    ctrl = taut.compile(L.GravityPID(kp=400.0, kd=80.0), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm, environment=taut.environments.Push()), duration=1.0)
    F = np.array(run.extra["F_ext"])
    F[700:] = np.nan
    told = taut.doctor(dataclasses.replace(run, extra={**run.extra, "F_ext": F}))
    assert told.problems == ("it has 301 tick(s) without a number, in F_ext; judged from 0 to 0.699 s",)
    assert not told.findings
    F[:] = np.nan
    told = taut.doctor(dataclasses.replace(run, extra={**run.extra, "F_ext": F}))
    assert not told.findings
    assert "1001 tick(s) without a number, in F_ext, and no stretch of 16 ticks without" in told.problems[0]


def test_a_late_clock_has_a_share_of_the_periods() -> None:
    arm = runs.arm_of("one_joint")
    run = taut.run(taut.compile(joint_gains("one_joint", 100.0, 20.0), arm), taut.RigidPlant(arm), duration=1.0)
    t = run.t + 2e-3 * (np.arange(len(run)) // 20)
    told = taut.doctor(dataclasses.replace(run, t=t))
    assert "runs late (term period, 5 % of the periods)" in str(told)
    assert "% of the largest torque" in str(told)  # of an arm without limits of effort
    assert "% of the effort" not in str(told)


def test_gravity_that_is_given_twice_is_no_payload_of_less_than_nothing() -> None:
    """The least squares that a payload's fit begins with end at its bound, and just below it by rounding."""
    arm, T = runs.arm_of("fr3"), runs.pose_of("fr3")
    line = taut.trajectories.Line(T0=T, T1=runs.shifted(T, [0.04, -0.03, 0.02]), duration=1.2)
    ctrl = taut.compile(L.TaskComputedTorque(kp=225.0, kd=30.0), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm.with_gravity([0.0, 0.0, 0.0])), line, duration=2.2)
    assert [each.name for each in taut.doctor(run).findings] == ["gravity twice"]


def test_an_arm_that_spins_at_a_limit_does_so_for_the_limit() -> None:
    """What the model asks for then jitters, which brings nothing about; no share is more than all."""
    arm = runs.arm_of("fr3")
    way = np.where(np.arange(7) == 0, 0.6, 0.0)
    need = 5.77 * 0.6 / 0.25 * float(np.asarray(taut.snapshot(arm, arm.home, np.zeros(7)).M)[0, 0])
    limits = taut.Limits(tau_dot=np.where(np.arange(7) == 0, 6.0 * need, np.inf))
    ctrl = taut.compile(L.ComputedTorque(kp=144.0, kd=24.0), arm, limits=limits)
    ref = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + way, duration=0.5)
    found = taut.doctor(taut.run(ctrl, taut.RigidPlant(arm), ref, duration=1.6)).findings
    assert (found[0].name, found[0].term) == ("saturates", "rate_limit")
    assert all(each.follows == "saturates" and each.share <= 1.0 for each in found[1:])


@functools.cache
def carrying(told: str) -> taut.analysis.Diagnosis:
    """A gantry to which 1.5 kg are given at 0.8 s, in the plant, in the law's model, or in both."""
    arm = runs.arm_of("gantry3")
    ctrl = taut.compile(joint_gains("gantry3", 144.0, 24.0), arm)
    way = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + np.array([0.3, -0.2, 0.1]), duration=1.5)
    values = {f"{whose}.payload.mass": 1.5 for whose in told.split()}
    events = [taut.Event(t=0.8, set=values)]
    return taut.doctor(taut.run(ctrl, taut.RigidPlant(arm), way, duration=3.0, events=events))


@pytest.mark.parametrize(("told", "beyond"), [("plant", 1.5), ("model", -1.5)])
def test_a_payload_that_is_taken_on_the_way_is_found_with_the_time(told: str, beyond: float) -> None:
    (found,) = carrying(told).findings
    assert found.name == "wrong payload"
    assert found.evidence["beyond it"].value == pytest.approx(beyond, rel=1e-3)
    since = re.search(r"beyond what the law was told, from ([\d.]+) s on", found.text)
    assert since is not None
    assert float(since[1]) == pytest.approx(0.8, abs=0.01)


def test_a_payload_that_is_taken_and_told_is_none_that_is_wrong() -> None:
    told = carrying("plant model")
    assert told.healthy
    assert told.looked_at["torque beyond the model"].value < 1e-6


def test_a_step_late_in_a_run_is_no_oscillation_that_grows() -> None:
    """A payload that is taken a second before the end: one swing of the feedback, fitted, would be a growing line."""
    arm = runs.arm_of("ur5")
    ctrl = taut.compile(joint_gains("ur5", 144.0, 24.0), arm)
    events = [taut.Event(t=2.2, set={"plant.payload.mass": 1.66})]
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=arm.home), duration=3.0, events=events)
    assert "oscillates" not in [each.name for each in taut.doctor(run).findings]


# -------------------------------------------------------------------- what does not follow, and what is none


def test_friction_that_holds_a_joint_follows_from_no_payload_that_hardly_moves_it() -> None:
    """Half a kilogram has next to no moment about the last wrist axis; each fault stands by what it explains."""
    arm = taut.load_arm("ur5")
    q = np.array([0.2, -1.2, 1.5, -1.0, 0.8, 0.3])
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    plant = taut.RigidPlant(arm.with_payload(0.5).with_friction(taut.Friction(coulomb=1.0, viscous=1.0)))
    run = taut.run(ctrl, plant, taut.trajectories.Quintic(q0=q, q1=q + 0.6, duration=1.0), duration=3.0, q0=q)
    found = taut.doctor(run).findings
    assert [(each.name, each.follows) for each in found] == [("sticks", None), ("wrong payload", None)]
    assert found[0].share > 0.3 > found[1].share


def test_gravity_is_told_of_a_joint_that_it_pulls_at() -> None:
    """Joint 5 is farthest off, and held by friction; what gravity holds back are joints 2 and 4."""
    arm = taut.load_arm("xarm7")
    inertia = np.diag(np.asarray(taut.snapshot(arm, arm.home).M))
    ctrl = taut.compile(taut.laws.PID(kp=400.0 * inertia, kd=40.0 * inertia), arm)
    path = taut.trajectories.Quintic(q0=arm.home, q1=np.add(arm.home, 0.3), duration=1.0)
    run = taut.run(ctrl, taut.RigidPlant(arm), path, duration=3.0)
    gravity, sticks = taut.doctor(run).findings
    assert (gravity.name, sticks.name, sticks.follows) == ("gravity not compensated", "sticks", None)
    assert gravity.joint in ("joint2", "joint4")
    assert gravity.evidence["gravity torque"].value > 5.0


def test_a_line_at_half_of_the_rate_is_as_large_as_it_shows() -> None:
    """There sine and cosine are one at the ticks: what a fit makes of each is not what the joint does."""
    k = np.arange(76)
    line = line_of(0.003 * (-1.0) ** k * np.exp(-0.004 * k), 0.04)
    assert line is not None
    assert line.omega == pytest.approx(np.pi / 0.04, rel=1e-3)
    assert line.amplitude == pytest.approx(0.003 * np.exp(-0.004 * 37.5), rel=0.02)
    arm = taut.load_arm("z1")
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=400.0, kd=40.0), arm, rate=25.0)
    path = taut.trajectories.Quintic(q0=arm.home, q1=np.add(arm.home, 0.2), duration=1.0)
    assert taut.doctor(taut.run(ctrl, taut.RigidPlant(arm, friction=None), path, duration=3.0)).healthy


@pytest.mark.parametrize(("name", "fed"), [("kinova", None), ("xarm7", "D"), ("z1", "D")])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_run_that_diverges_at_once_is_answered_with_how_it_ended(name: str, fed: str | None) -> None:
    """Where five ticks of it turn round, with what feeds it."""
    arm = taut.load_arm(name)
    ctrl = taut.compile(L.GravityPID(kp=100.0, kd=20.0), arm)
    plant = taut.RigidPlant(arm, friction=None)
    run = taut.run(ctrl, plant, taut.JointMotion(q=np.add(arm.home, 0.3)), duration=3.0)
    assert len(run) < 16
    told = taut.doctor(run)
    assert told.problems[0].startswith("it ended in a fault: the simulation diverged at t = ")
    assert [(each.name, each.term) for each in told.findings] == ([] if fed is None else [("oscillates", fed)])


def test_what_sticks_at_a_constant_target_is_not_advised_by_the_sign_of_the_reference() -> None:
    """FrictionCompensation(at='ref') gives nothing where the reference never moves."""
    arm = taut.load_arm("planar2")
    plant = taut.RigidPlant(arm.with_friction(taut.Friction(coulomb=1.0)))
    ctrl = taut.compile(taut.laws.GravityPID(kp=40.0, kd=12.0), arm)
    target = np.add(arm.home, 0.3)
    still = taut.run(ctrl, plant, taut.JointMotion(q=target), duration=3.0)
    moved = taut.run(ctrl, plant, taut.trajectories.Quintic(q0=arm.home, q1=target, duration=1.0), duration=3.0)
    remedies = [
        next(each.remedy for each in taut.doctor(run).findings if each.name == "sticks") for run in (still, moved)
    ]
    assert remedies[0].startswith("add an integral, RaisedGains or a Dither; kp alone would leave up to ")
    assert remedies[1].startswith("add FrictionCompensation(at='ref') with ")
