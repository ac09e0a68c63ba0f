"""Designs: placed poles against closed forms and python-control, asked and got against simulation, limits, refusals."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from scipy.linalg import eigh

import taut
from taut.control.law import Law

control = pytest.importorskip("control")
laws = taut.laws
SAMPLED = 0.02  # [-] of a damping ratio: what 1 kHz takes or adds at 10 rad/s
FITTED = 0.01  # [-] of a number read off a simulated step
ALIKE = 1e-3  # [-] of a step: the nonlinear loop against the linear one
SMALL = 1e-4  # [rad | m] of a step for which a loop is as good as linear


def gain(d: taut.analysis.Design, name: str) -> np.ndarray:
    return np.asarray(d.law.parameters()[name])


def loop_poles(x: taut.Snapshot, K: np.ndarray, D: np.ndarray) -> np.ndarray:
    """(2 n,) poles of M q_ddot + D q_dot + K q = 0 in joints [1/s]."""
    M, n = np.asarray(x.M), x.n
    return np.linalg.eigvals(
        np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    )


# -------------------------------------------------------------------- gains by closed forms


def test_gains_of_a_single_joint_are_those_of_the_chapter() -> None:
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0])  # which the chapter leaves out here
    d = taut.design(laws.PID, arm, zeta=1.0, omega_n=2.1)  # M = 0.5
    assert gain(d, "kp") == pytest.approx([2.205], rel=1e-14)
    assert gain(d, "kd") == pytest.approx([2.1], rel=1e-14)
    assert d.met


@pytest.mark.part(1)
@pytest.mark.parametrize(
    "asked",
    [{"overshoot": 10.0, "settling": 0.4}, {"zeta": 1.0, "settling": 0.3}, {"overshoot": 0.0, "omega_n": 10.0},
     {"zeta": 3.0, "omega_n": 20.0}],
)  # fmt: skip
def test_what_is_asked_is_what_python_control_sees(asked: dict[str, float]) -> None:
    d = taut.design(laws.ComputedTorque, taut.load_arm("one_joint"), **asked)  # type: ignore[arg-type]
    kp, kd = (float(gain(d, name)[0]) for name in ("kp", "kd"))
    system = control.tf([kp], [1.0, kd, kp])
    t = np.linspace(0.0, 3.0, 30_001)
    y = control.step_response(system, t).outputs
    omega_n = math.sqrt(float(np.prod(system.poles()).real))
    seen = {
        "overshoot": 100.0 * max(float(y.max()) - 1.0, 0.0),
        "settling": float(t[np.flatnonzero(np.abs(y - 1.0) > 0.02)[-1]]),
        "omega_n": omega_n,
        "zeta": -0.5 * float(np.sum(system.poles()).real) / omega_n,
    }
    for name, value in asked.items():
        assert seen[name] == pytest.approx(value, rel=1e-3, abs=1e-3)
        assert d.got(name)[0] == pytest.approx(value, rel=0.05, abs=0.2)
    assert d.met


def test_joints_get_their_own_inertia_or_all_of_it_rotors_included() -> None:
    arm, q = taut.load_arm("planar2").with_gears({"joint2": 50.0}, 2e-4), [0.3, 0.8]
    M = np.asarray(taut.snapshot(arm, q).M)
    assert M[1, 1] > 0.5  # of which 50^2 2e-4 is the rotor
    asked: dict[str, Any] = {"at": q, "zeta": 0.7, "omega_n": 9.0, "integral": 0.1}
    apart = taut.design(laws.GravityPID, arm, **asked)
    assert gain(apart, "kp") == pytest.approx(81.0 * np.diag(M), rel=1e-13)
    assert gain(apart, "kd") == pytest.approx(2.0 * 0.7 * 9.0 * np.diag(M), rel=1e-13)
    assert gain(apart, "ki") == pytest.approx(0.1 * 2.0 * 0.7 * 9.0**3 * np.diag(M), rel=1e-12)
    alike = taut.design(laws.GravityPID, arm, coupled=True, **asked)
    assert gain(alike, "kp") == pytest.approx(81.0 * M, rel=1e-12)
    assert gain(alike, "ki") == pytest.approx(0.1 * 2.0 * 0.7 * 9.0**3 * M, rel=1e-12)


def test_coupled_joints_miss_what_matrices_meet() -> None:
    arm, q = taut.load_arm("planar2"), [0.3, 0.8]
    asked: dict[str, Any] = {"at": q, "zeta": 0.7, "omega_n": 9.0}
    apart, alike = (taut.design(laws.GravityPID, arm, coupled=c, **asked) for c in (False, True))
    M = np.asarray(taut.snapshot(arm, q).M)
    modes = 0.7 * np.sqrt(eigh(np.diag(np.diag(M)), M, eigvals_only=True))  # zeta_k = zeta sqrt(lambda_k)
    assert apart.got("zeta").min() == pytest.approx(modes.min(), rel=SAMPLED)
    assert not apart.met
    assert alike.met
    assert alike.got("zeta") == pytest.approx(0.7, rel=SAMPLED)


@pytest.mark.long
def test_impedance_keeps_its_stiffness_and_stiffness_control_gets_damping_for_every_mode() -> None:
    arm = taut.load_arm("panda")
    x = taut.snapshot(arm, arm.home)
    for law in (laws.Impedance, laws.Stiffness):
        d = taut.design(law, arm, at=arm.home, K=(800, 30), zeta=0.7, rate=1000.0)
        assert np.ravel(gain(d, "K")).tolist() == [800.0] * 3 + [30.0] * 3
        if law is laws.Stiffness:
            J = np.asarray(x.J())
            poles = loop_poles(x, J.T @ np.diag(gain(d, "K")) @ J, gain(d, "kd"))
            swinging = poles[np.abs(poles.imag) > 1e-6 * np.abs(poles)]
            assert -swinging.real / np.abs(swinging) == pytest.approx(0.7, rel=1e-6)
        assert d.met
        assert d.got("K") == pytest.approx([800.0] * 3 + [30.0] * 3, rel=1e-6)


def test_impedance_from_a_speed_has_the_arms_own_inertia() -> None:
    arm, q = taut.load_arm("planar3"), [0.3, 0.8, 0.4]
    d = taut.design(laws.Impedance, arm, at=q, zeta=0.7, omega_n=10.0)
    assert gain(d, "zeta") == 0.7
    x = taut.snapshot(arm, q)
    J = np.asarray(x.J())[[0, 2, 4]]
    Lambda = np.linalg.inv(J @ np.linalg.solve(np.asarray(x.M), J.T))
    assert gain(d, "K")[np.ix_([0, 2, 4], [0, 2, 4])] == pytest.approx(100.0 * Lambda, rel=1e-9)
    assert d.met


# -------------------------------------------------------------------- asked, got, met against simulation


SIMULATED: list[tuple[str, Callable[[], Any], str, dict[str, Any]]] = [
    ("PID", lambda: laws.PID, "one_joint", {"zeta": 1.0, "omega_n": 10.0}),
    ("GravityPID", lambda: laws.GravityPID, "ur10", {"overshoot": 5.0, "settling": 0.5}),
    ("ComputedTorque", lambda: laws.ComputedTorque, "xarm7", {"zeta": 0.7, "omega_n": 10.0, "integral": 0.1}),
    ("FeedForward", lambda: laws.FeedForward() + laws.PID(kp=1.0), "gantry3", {"zeta": 0.5, "omega_n": 12.0}),
    ("VelocityPI", lambda: laws.VelocityPI, "gantry3", {"zeta": 1.0, "omega_n": 10.0}),
]


def off_in_simulation(d: taut.analysis.Design, arm: taut.Arm, q: np.ndarray, joint: int, takes: str) -> float:
    """[-] of the step: how far a small one of the nonlinear loop is off the one that is reported."""
    assert d.steps is not None
    drives = taut.drives.Actuation(bandwidth=None if takes == "torque" else 1e4)
    plant = taut.RigidPlant(
        arm, friction=None if takes == "torque" else "arm", takes=takes,  # type: ignore[arg-type]
        actuation=drives, integrator="rk4" if takes == "torque" else "semi-implicit-euler",
    )  # fmt: skip
    rest, target = d.system.point.q, q.copy()
    target[joint] += SMALL
    ctrl, seconds = taut.compile(d.law, arm), float(d.steps.t[-1])
    run = taut.run(ctrl, plant, taut.JointMotion(q=target), q0=rest, duration=seconds, progress=False)
    count = min(len(run.q), len(d.steps.t))
    y = (run.q[:count, joint] - rest[joint]) / SMALL
    return float(np.abs(1.0 - y - d.steps.e[:count, joint]).max())


@pytest.mark.long
@pytest.mark.parametrize(("name", "make", "arm_name", "asked"), SIMULATED, ids=[row[0] for row in SIMULATED])
def test_steps_of_the_nonlinear_loop_are_those_that_the_design_reports(
    name: str, make: Callable[[], Any], arm_name: str, asked: dict[str, Any]
) -> None:
    arm = taut.load_arm(arm_name)
    d = taut.design(make(), arm, **asked)
    takes = "velocity" if name == "VelocityPI" else "torque"
    for joint in (0, arm.n - 1):
        assert off_in_simulation(d, arm, arm.home, joint, takes) < ALIKE


ARMS = ("planar2", "ur10", "panda", "kinova", "xarm7")  # the last two were in no trial


@pytest.mark.bars
def test_reported_steps_are_those_of_the_nonlinear_loop_on_five_arms_at_five_poses(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    rng = np.random.default_rng(5)
    cases = [(name, k) for k in range(5) for name in ARMS][: share(25)]
    kinds: list[tuple[Any, str, dict[str, Any]]] = [
        (laws.GravityPID, "torque", {"zeta": 0.7, "omega_n": 10.0, "coupled": True}),
        (laws.ComputedTorque, "torque", {"zeta": 1.0, "settling": 0.5}),
        (laws.GravityPID, "torque", {"overshoot": 5.0, "omega_n": 8.0}),
        (laws.VelocityPI, "velocity", {"zeta": 0.7, "omega_n": 10.0}),
    ]
    worst, count = 0.0, 0
    for name, k in cases:
        arm = taut.load_arm(name)
        low, high = (np.clip(limit, arm.home - 0.4, arm.home + 0.4) for limit in (arm.lower, arm.upper))
        q = rng.uniform(low, high)
        for law, takes, asked in kinds if len(cases) == 25 else kinds[:1]:
            d = taut.design(law, arm, at=q, **asked)
            assert d.met or not asked.get("coupled", law is not laws.GravityPID)
            worst = max(worst, off_in_simulation(d, arm, q, k % arm.n, takes))
            count += 1
    assert worst < ALIKE
    bar(
        f"design: {count} steps of the nonlinear loop of {len(kinds)} laws on 5 arms, off the reported",
        f"{worst:.1e}",
    )


def test_a_step_of_the_tool_is_the_one_that_is_reported() -> None:
    arm, q = taut.load_arm("planar3"), [0.3, 0.8, 0.4]
    d = taut.design(laws.Impedance, arm, at=q, K=(400.0, 20.0), zeta=0.5)
    assert d.steps is not None
    T = taut.snapshot(arm, q).T()
    ref = taut.TaskMotion(pose=taut.Pose(np.asarray(T.p) + SMALL * np.eye(3)[0], R=np.asarray(T.R)))
    plant = taut.RigidPlant(arm, friction=None, integrator="rk4")
    run = taut.run(taut.compile(d.law, arm), plant, ref, q0=q, duration=float(d.steps.t[-1]), progress=False)
    J = np.asarray(taut.snapshot(arm, q).J())
    e = 1.0 - (run.q - q) @ J[0] / SMALL
    count = min(len(e), len(d.steps.t))
    assert np.abs(e[:count] - d.steps.e[:count, 0]).max() < ALIKE


MET: list[tuple[Callable[[], Any], str, dict[str, Any]]] = [
    (lambda: laws.TaskVelocity, "gantry3", {"settling": 0.4}),
    (lambda: laws.TaskPosition, "gantry3", {"omega_n": 10.0}),
    (lambda: laws.GravityCompensation, "one_joint", {"omega_n": 2.0}),
    (lambda: laws.VelocityPI, "gantry3", {"omega_n": [5.0, 10.0, 20.0]}),
    (lambda: laws.ComputedTorque, "ur3", {"omega_n": [8.0, 9.0, 10.0, 11.0, 12.0, 13.0], "zeta": 0.8}),
    (lambda: laws.TaskComputedTorque, "ur3", {"omega_n": (8.0, 12.0), "zeta": 0.8}),
    (lambda: laws.TaskComputedTorque, "kinova", {"omega_n": 10.0, "zeta": 1.0}),
    (lambda: laws.Impedance(K=(1.0, 1.0), zeta=1.0, D=(4.0, 0.3)), "planar3", {"omega_n": 12.0, "zeta": 0.6}),
    (lambda: laws.Impedance(K=(1.0, 1.0), zeta=1.0, frame="tool"), "planar3", {"K": (400.0, 20.0), "zeta": 0.7}),
    (lambda: taut.via_joint_space(laws.ComputedTorque(kp=1.0, kd=1.0)), "panda", {"zeta": 1.0, "omega_n": 10.0}),
    (
        lambda: laws.Admittance(D=(2.0, 0.1), B=(1.0, 1.0), inner=laws.TaskComputedTorque(kp=2500.0, kd=100.0)),
        "gantry3",
        {"zeta": 1.0, "omega_n": 10.0},
    ),
]


@pytest.mark.part(2)
@pytest.mark.parametrize(("make", "name", "asked"), MET)
def test_what_can_be_is_met(make: Callable[[], Any], name: str, asked: dict[str, Any]) -> None:
    at = [0.3, 0.8, 0.4] if name == "planar3" else None
    d = taut.design(make(), taut.load_arm(name), at=at, **asked)
    assert {each.name for each in d.requirements} == set(asked)
    assert d.met, [each for each in d.requirements if not each.met]


def test_a_stiffness_that_the_weight_changes_is_reported() -> None:
    arm = taut.load_arm("one_joint")
    d = taut.design(laws.PID, arm, at=[-1.2], zeta=1.0, K=10.0)
    q = d.system.point.q[0]
    g = [float(taut.snapshot(arm, [q + s * 1e-5]).g[0]) for s in (1.0, -1.0)]
    assert d.got("K")[0] == pytest.approx(10.0 + (g[0] - g[1]) / 2e-5, rel=1e-5)
    assert not d.met


def test_the_weight_that_a_pid_does_not_carry_is_its_droop() -> None:
    arm = taut.load_arm("planar2")
    d = taut.design(laws.PID, arm, at=[0.3, 0.8], zeta=1.0, omega_n=5.0)
    run = taut.run(
        taut.compile(d.law, arm), taut.RigidPlant(arm, friction=None), taut.JointMotion(q=[0.3, 0.8]), duration=8.0,
        q0=[0.3, 0.8], progress=False,
    )  # fmt: skip
    assert d.limit("droop").value == pytest.approx(float(np.abs(run.q[-1] - [0.3, 0.8]).max()), rel=1e-4)
    with pytest.raises(KeyError):
        taut.design(laws.GravityPID, arm, at=[0.3, 0.8], zeta=1.0, omega_n=5.0).limit("droop")


# -------------------------------------------------------------------- laws of force


def test_a_force_on_a_contact_has_the_poles_of_its_cubic() -> None:
    arm = taut.load_arm("gantry3")
    asked: dict[str, Any] = {"force": 1.0, "zeta": 0.7, "contact": (1e5, 1e3), "rate": 4000.0}
    d = taut.design(laws.ForceControl, arm, **asked)
    assert np.diag(gain(d, "kfi")) == pytest.approx(1.0)
    m = np.diag(np.asarray(taut.snapshot(arm, arm.home).M))
    assert gain(d, "kdamp")[:3] == pytest.approx(2.0 * 0.7 * np.sqrt(1e5 * m), rel=1e-9)
    slow = [
        -float(roots[roots.imag == 0.0][0].real)
        for mass in m
        for roots in [np.roots([mass, 1.4 * math.sqrt(1e5 * mass), 1e5, 1e5])]
    ]
    assert d.got("force") == pytest.approx(slow, rel=FITTED)
    assert d.got("zeta") == pytest.approx(0.7, rel=0.05)
    assert d.met


@pytest.mark.parametrize(("kfp", "delay"), [(0.0, 0.0), (0.3, 0.0), (0.3, 2e-3)])
def test_a_hybrid_force_has_the_pole_of_the_tick(kfp: float, delay: float) -> None:
    """e_k = -lam_(k-1), u = kfp e + kfi sum(e) dt, lam a delay later; simulated against the constraint."""
    arm = taut.load_arm("gantry3")
    z = float(taut.snapshot(arm, arm.home).T().p[2])
    law = laws.HybridMotionForce(
        constraint=lambda T: T.p[2] - z, motion=laws.TaskComputedTorque(kp=1.0, kd=1.0), kfp=kfp or None, kfi=1.0
    )
    plant = taut.RigidPlant(arm, friction=None, integrator="rk4", actuation=taut.drives.Actuation(delay=delay))
    d = taut.design(law, arm, zeta=1.0, omega_n=10.0, force=5.0, plant=plant)
    assert gain(d, "kfi") == pytest.approx(5.0 * (1.0 + kfp))
    (row,) = (each for each in d.requirements if each.name == "force")
    errors = [0.0, 1.0]  # of a force that the law does not know, from tick to tick
    late, total, commands = round(delay * 1e3), 0.0, [0.0] * (round(delay * 1e3) + 1)
    for _ in range(400):
        e = -errors[-1]
        total += 1e-3 * e
        commands.append(kfp * e + 5.0 * (1.0 + kfp) * total)
        errors.append(1.0 + commands[-1 - late])
    decay = math.log(errors[-100] / errors[-1]) / (99.0 * 1e-3)
    assert row.got == pytest.approx(decay, rel=1e-3)
    too_fast = 2100.0 * (1.0 - kfp) / (1.0 + kfp)  # kfp + kfi dt / 2 < 1
    if not late:
        assert not taut.design(law, arm, zeta=1.0, omega_n=10.0, force=too_fast).met


# -------------------------------------------------------------------- the servo rate, and limits


def test_what_the_rate_takes_is_missed_and_what_it_cannot_bear_is_blamed() -> None:
    arm = taut.load_arm("planar2")
    slow = taut.design(laws.ComputedTorque, arm, at=[0.3, 0.8], zeta=0.3, omega_n=10.0, rate=500.0)
    assert slow.met
    late = taut.RigidPlant(arm, friction=None, integrator="rk4", actuation=taut.drives.Actuation(delay=8e-3))
    d = taut.design(laws.ComputedTorque, arm, at=[0.3, 0.8], zeta=0.3, omega_n=30.0, rate=500.0, plant=late)
    assert d.stable
    assert not d.met
    assert d.got("zeta").max() < 0.6 * 0.3
    ctrl = taut.compile(laws.ComputedTorque(kp=150.0**2, kd=300.0), arm, rate=100.0)
    plant = taut.RigidPlant(arm, friction=None, integrator="rk4")
    loop = taut.Loop(ctrl, plant, duration=1.0)
    unstable = taut.design(laws.ComputedTorque, arm, zeta=1.0, omega_n=150.0, rate=100.0)
    assert not unstable.stable
    assert not unstable.met
    assert unstable.system.radius == pytest.approx(taut.linearise(loop, at=arm.home).radius, rel=1e-4)
    assert np.isnan(unstable.got("zeta")).all()
    factor = unstable.limit("largest factor")
    assert factor.where == "law.kd"
    for share, stable in ((0.98, True), (1.05, False)):
        loop.parameters["law.kd"] = 300.0 * factor.value * share
        assert taut.linearise(loop, at=arm.home).stable == stable
    assert unstable.unstable in str(unstable)


def test_a_low_pass_in_the_velocity_is_judged() -> None:
    sensing = taut.Sensing(velocity=taut.sensors.LowPass(cutoff=5.0))
    d = taut.design(laws.ComputedTorque, taut.load_arm("one_joint"), zeta=0.7, omega_n=30.0, sensing=sensing)
    assert d.got("zeta")[0] < 0.5 * 0.7
    assert not d.met


def test_the_largest_step_is_the_one_that_takes_all_the_torque() -> None:
    arm = taut.load_arm("planar2").with_joints(effort=[60.0, 30.0])
    q = np.array([0.3, 0.8])
    for law in (laws.ComputedTorque, laws.PID):
        d = taut.design(law, arm, at=q, zeta=0.7, omega_n=40.0)  # small steps, as good as linear
        ctrl = taut.compile(d.law, arm, limits=taut.Limits(tau=arm.effort))
        plant, rest = taut.RigidPlant(arm, friction=None), d.system.point.q
        limit = d.limit("largest step")
        for share, cut in ((0.97, False), (1.03, True)):
            saturated = []
            for i in range(2):
                ref = q.copy()
                ref[i] += share * next(
                    each.value for each in d.limits if f"{each.where} ".startswith(f"joint{i + 1} ")
                )
                run = taut.run(ctrl, plant, taut.JointMotion(q=ref), q0=rest, duration=0.3, progress=False)
                saturated.append(float(np.nanmax(run.metrics.saturation_time)) > 0.0)
            assert all(saturated) if cut else not any(saturated)
        assert limit.unit == "rad"


def test_the_delay_margin_is_where_a_delay_makes_the_loop_unstable() -> None:
    arm = taut.load_arm("planar2")
    d = taut.design(laws.GravityPID, arm, at=[0.3, 0.8], zeta=0.7, omega_n=10.0, rate=200.0)
    periods = math.floor(d.limit("delay margin").value * 200.0)
    for late, stable in ((periods, True), (periods + 1, False)):
        plant = taut.RigidPlant(
            arm, friction=None, integrator="rk4", actuation=taut.drives.Actuation(delay=late / 200.0)
        )
        loop = taut.Loop(taut.compile(d.law, arm, rate=200.0), plant, duration=1.0)
        assert taut.linearise(loop, at=[0.3, 0.8]).stable == stable
    assert d.limit("gain margin").value > 1.0


# -------------------------------------------------------------------- a law of one's own, refusals, the result


class Spring(taut.Law):
    """A spring and a damper of one's own, with the weight compensated."""

    kp: taut.Gain
    kd: taut.Gain

    def closed_loop(self, x: Any) -> Any:
        def gains(g: Any) -> Spring:
            return Spring(kp=g.K, kd=g.D)

        return laws.ClosedLoop.of_joints(x, gains, inertia=x.M, stiffness=True, decentralised=True)

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=self.kp @ x.difference(ref.q), D=-(self.kd @ x.v), gravity=x.g)


def test_a_law_of_ones_own_is_designed_by_the_closed_loop_that_it_states() -> None:
    d = taut.design(Spring, taut.load_arm("gantry3"), zeta=0.7, omega_n=10.0)
    assert d.met
    assert isinstance(d.law, Spring)


@pytest.mark.parametrize(
    ("law", "asked", "error", "name"),
    [
        (laws.PID, {"zeta": 0.7}, taut.errors.UsageError, "omega_n"),
        (laws.PID, {"omega_n": 10.0}, taut.errors.UsageError, "zeta"),
        (laws.PID, {"zeta": 0.7, "overshoot": 5.0, "omega_n": 9.0}, taut.errors.UsageError, "overshoot"),
        (laws.PID, {"zeta": 0.7, "settling": 0.3, "omega_n": 9.0}, taut.errors.UsageError, "settling"),
        (laws.PID, {"zeta": 0.7, "K": 50.0, "omega_n": 9.0}, taut.errors.UsageError, "K"),
        (laws.PID, {"zeta": 0.7, "omega_n": math.nan}, taut.errors.RangeError, "omega_n"),
        (laws.PID, {"zeta": -0.7, "omega_n": 9.0}, taut.errors.RangeError, "zeta"),
        (laws.PID, {"zeta": 0.7, "omega_n": 9.0, "integral": 1.0}, taut.errors.RangeError, "integral"),
        (laws.PID, {"zeta": 0.7, "omega_n": 9.0, "force": 1.0}, taut.errors.UsageError, "force"),
        (laws.PID, {"overshoot": 100.0, "omega_n": 9.0}, taut.errors.RangeError, "overshoot"),
        (laws.PID, {"zeta": 0.7, "omega_n": [9.0, 9.0]}, taut.errors.UsageError, "omega_n"),
        (laws.PID, {"zeta": 0.7, "omega_n": 9.0, "at": [0.1, 0.2]}, taut.errors.ShapeError, "at"),
        (laws.PID, {"zeta": 0.7, "omega_n": 9.0, "plant": "mujoco"}, taut.errors.UsageError, "plant"),
        (laws.ComputedTorque, {"zeta": 0.7, "K": 9.0}, taut.errors.UsageError, "K"),
        (laws.ComputedTorque, {"zeta": 0.7, "omega_n": 9.0, "coupled": True}, taut.errors.UsageError, "coupled"),
        (laws.FeedForward, {"zeta": 0.7, "omega_n": 9.0}, taut.errors.UsageError, "law"),
        (laws.Dither, {"zeta": 0.7}, taut.errors.UsageError, "law"),
        (laws.HybridMotionForce, {"zeta": 0.7}, taut.errors.UsageError, "law"),
        (laws.Admittance, {"zeta": 0.7, "omega_n": 9.0}, taut.errors.UsageError, "law"),
        (laws.Impedance, {"zeta": 0.7, "K": 800.0}, taut.errors.UsageError, "K"),
        (laws.Impedance, {"K": (800.0, 30.0)}, taut.errors.UsageError, "zeta"),
        (laws.ForceControl, {"force": 5.0}, taut.errors.UsageError, "contact"),
        (laws.ForceControl, {"force": 5.0, "contact": (1e4, 1e2)}, taut.errors.UsageError, "zeta"),
        (laws.TaskVelocity, {"zeta": 0.7, "omega_n": 3.0}, taut.errors.UsageError, "zeta"),
        (laws.PID(kp=1.0) + laws.GravityPID(kp=1.0, kd=1.0), {"zeta": 0.7}, taut.errors.UsageError, "law"),
    ],
)  # fmt: skip
def test_what_says_too_little_or_too_much_is_refused_by_name(
    law: type[Law] | Law, asked: dict[str, Any], error: type[Exception], name: str
) -> None:
    with pytest.raises(error) as refused:
        taut.design(law, taut.load_arm("one_joint"), **asked)
    assert refused.value.name == name  # type: ignore[attr-defined]


def test_poses_that_cannot_be_are_refused_by_name() -> None:
    with pytest.raises(taut.errors.RangeError) as outside:
        taut.design(laws.PID, taut.load_arm("panda"), at=np.zeros(7), zeta=1.0, omega_n=5.0)
    assert outside.value.joint == "panda_joint4"
    with refused(taut.errors.RangeError) as singular:
        taut.design(laws.Impedance, taut.load_arm("planar3"), at=[0.3, 0.0, 0.0], zeta=1.0, K=(100.0, 1.0))
    assert singular.value.name == "at"
    with refused(taut.errors.UsageError):
        taut.design(laws.PID, "panda", zeta=1.0, omega_n=5.0)  # type: ignore[arg-type]


def test_a_design_describes_itself(tmp_path: Path) -> None:
    arm, q = taut.load_arm("planar2"), [0.3, 0.8]
    d = taut.design(laws.GravityPID, arm, at=q, overshoot=5.0, settling=0.5)
    found = json.loads(json.dumps(d.json(), allow_nan=False))
    assert found["met"] is False
    assert found["gains"]["kp"] == gain(d, "kp").tolist()
    assert [row["met"] for row in found["tables"]["asked and got"]] == [row.met for row in d.requirements]
    assert len(found["faults"]) == len({row.name for row in d.requirements if not row.met})
    assert all(fault in str(d) for fault in found["faults"])
    assert [ax.get_ylabel() for ax in d.plot().axes] == ["e / e(0)", "[N m]"]
    page = taut.report(d, tmp_path / "d.html").read_text(encoding="utf-8")
    assert "asked and got" in page
    assert "<img" in page
