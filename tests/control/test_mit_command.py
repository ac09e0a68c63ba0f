"""Motors with a loop of their own: the five numbers of a MitCommand, by hand, exactly sampled, and in runs."""

from __future__ import annotations

import numpy as np
import pytest
from refusals import refused, warned
from scipy.linalg import expm

import taut
from taut import RigidPlant
from taut.errors import MatchError, RangeError, UsageError
from taut.laws import GravityPID, Impedance, MitCommand, ViaMit


class Frames(taut.Law):
    """A law of one's own that gives the five numbers.

    Law:          q and v of the reference, kp and kd of the law, the arm's weight as feed-forward
    """

    kp: taut.Gain = taut.Gain(unit="N m/rad")
    kd: taut.Gain = taut.Gain(unit="N m s/rad")

    def command(self, x, ref):
        return MitCommand(q=ref.q, v=ref.v, kp=self.kp, kd=self.kd, tau=taut.Terms(gravity=x.g))


def inner(rate, **more):
    return taut.drives.Actuation(inner_rate=rate, **more)


@pytest.mark.parametrize(("rate", "motor"), [(100.0, (60.0, 6.0)), (100.0, (0.0, 3.0)), (50.0, (20.0, 2.0))])
def test_the_linear_model_of_the_two_rates_is_that_of_the_matrix_exponential(rate, motor):
    arm, at, n = taut.load_arm("planar2"), np.array([0.3, 0.8]), 2
    law = ViaMit(law=GravityPID(kp=40.0, kd=4.0), kp_motor=motor[0], kd_motor=motor[1])
    plant = RigidPlant(arm, friction=None, integrator="rk4", takes="mit", substeps=40, actuation=inner(10.0 * rate))
    lin = taut.linearise(taut.Loop(taut.compile(law, arm, rate=rate), plant, duration=1.0), at=at)
    x = taut.snapshot(arm, at)
    slope = np.stack([(x.at(at + d, 0 * at).g - x.at(at - d, 0 * at).g) / 2e-6 for d in 1e-6 * np.eye(n)], axis=1)
    T, inverse, zero = 0.1 / rate, np.linalg.inv(x.M), np.zeros((n, n))
    A = np.block([[zero, np.eye(n), zero], [-inverse @ slope, zero, inverse], [zero, zero, zero]])
    A, B = (m := expm(A * T))[: 2 * n, : 2 * n], m[: 2 * n, 2 * n :]
    K = np.hstack([k * np.eye(n) for k in motor])
    tick = K - np.hstack([40.0 * np.eye(n) - slope, 4.0 * np.eye(n)])  # the law knows the weight where it is
    whole = np.eye(2 * n)
    for _ in range(10):
        whole = (A - B @ K) @ whole + B @ tick
    ours, exact = (np.sort_complex(np.linalg.eigvals(m)) for m in (lin.A, whole))
    np.testing.assert_allclose(ours, exact, atol=2e-8)


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["ur10", "panda"])
def test_a_pd_in_the_motors_is_the_pd_at_the_motors_rate(name, share):
    """With the reference at rest both are the same torques at the same times."""
    arm, rng = taut.load_arm(name), np.random.default_rng(5)
    for _ in range(share(30)):
        M = np.diag(np.asarray(taut.snapshot(arm, arm.home).M))
        law = taut.laws.PID(kp=M * rng.uniform(20.0, 300.0), kd=M * rng.uniform(10.0, 40.0))
        goal = taut.JointMotion(q=arm.home + rng.uniform(-0.2, 0.2, arm.n))
        mit = RigidPlant(arm, takes="mit", substeps=20, actuation=inner(1000.0))
        two = taut.run(taut.compile(ViaMit(law=law), arm, rate=100.0), mit, goal, duration=0.3)
        one = taut.run(taut.compile(law, arm, rate=1000.0), RigidPlant(arm, substeps=2), goal, duration=0.3)
        np.testing.assert_allclose(two.q, one.q[::10], atol=1e-9)


@pytest.mark.part(1)
@pytest.mark.parametrize("engine", ["native", "float"])
def test_the_five_numbers_give_the_torque_of_the_law_in_the_tick(engine):
    arm = taut.load_arm("panda")
    law, T = Impedance(K=(800.0, 30.0), zeta=0.7), taut.snapshot(arm, arm.home + 0.05).T()
    plain = taut.compile(law, arm, rate=100.0, engine=engine)
    mit = taut.compile(ViaMit(law=law, kp_motor=30.0, kd_motor=np.arange(1.0, 8.0)), arm, rate=100.0, engine=engine)
    rng = np.random.default_rng(1)
    for _ in range(4):
        q, v = arm.home + 0.1 * rng.standard_normal(7), 0.2 * rng.standard_normal(7)
        rows, tau = mit.step(q, v, taut.TaskMotion(pose=T)), plain.step(q, v, taut.TaskMotion(pose=T))
        assert rows.shape == (5, 7)
        np.testing.assert_allclose(rows[2] * (rows[0] - q) + rows[3] * (rows[1] - v) + rows[4], tau, atol=1e-10)
        np.testing.assert_allclose(sum(mit.terms.values()), tau, atol=1e-10)
    assert mit.kind == "mit"


@pytest.mark.long
def test_both_plants_and_all_engines_move_alike():
    arm = taut.load_arm("z1")
    law = ViaMit(law=GravityPID(kp=40.0, kd=1.5))
    ref = taut.trajectories.Sine(center=arm.home, amplitude=0.1, frequency=0.5)
    drives = inner(1000.0, delay=0.01)
    plants = [
        RigidPlant(arm, takes="mit", substeps=50, actuation=drives),
        taut.MujocoPlant(arm, takes="mit", timestep=1 / 5000, actuation=drives),
    ]
    runs = [
        taut.run(taut.compile(law, arm, rate=100.0, engine=engine), plant, ref, duration=0.3)
        for plant in plants
        for engine in ("native", "float")
    ]
    for run in runs[1:]:
        np.testing.assert_allclose(run.q, runs[0].q, atol=1e-8)
    assert runs[0].kind == "torque"
    assert runs[0].extra["mit"].shape == (31, 5, 6)


@pytest.mark.long
def test_the_run_judges_the_two_rates_as_they_are():
    """100 Hz are too slow for these gains, and so is an inner loop of 500 Hz for a Z1's wrist; 5 kHz are not."""
    arm = taut.load_arm("z1")
    law = GravityPID(kp=80.0, kd=4.0)
    for rate, stable in ((100.0, False), (500.0, False), (5000.0, True)):
        drives = inner(rate)
        for plant in (
            RigidPlant(arm, takes="mit", substeps=50, actuation=drives),
            taut.MujocoPlant(arm, takes="mit", timestep=1 / 5000, actuation=drives),
        ):
            ctrl = taut.compile(ViaMit(law=law), arm, rate=100.0)
            if stable:
                assert taut.run(ctrl, plant, duration=0.2).outcome.ok
            else:
                with warned(taut.errors.StabilityWarning):
                    taut.run(ctrl, plant, duration=0.02)


def test_a_design_places_the_gains_in_the_motors():
    arm = taut.load_arm("one_joint")
    slow = taut.design(GravityPID, arm, zeta=0.7, omega_n=60.0, rate=100.0)
    fast = taut.design(ViaMit(law=GravityPID(kp=1.0, kd=1.0)), arm, zeta=0.7, omega_n=60.0, rate=100.0)
    assert fast.met
    assert not slow.met
    ctrl = taut.compile(fast.law, arm, rate=100.0)
    np.testing.assert_allclose(ctrl.step(arm.home, 0 * arm.home, taut.JointMotion(q=arm.home))[2], fast.law.law.kp)


def test_limits_are_those_of_the_torque_in_the_tick():
    arm = taut.load_arm("one_joint")
    law = ViaMit(law=GravityPID(kp=50.0, kd=10.0))
    ctrl = taut.compile(law, arm, rate=100.0, limits=taut.Limits(tau=3.0, tau_dot=50.0))
    for _ in range(10):
        q, v, kp, kd, tau = ctrl.step([0.0], [0.5], taut.JointMotion(q=[1.0]))
    assert (kp * (q - 0.0) + kd * (v - 0.5) + tau).round(9).tolist() == [3.0]
    assert ctrl.terms["torque_limit"][0] + ctrl.terms["rate_limit"][0] == pytest.approx(3.0 - 45.0 - 0.981)


def test_a_law_of_ones_own_gives_them_and_continuous_joints_go_the_short_way():
    arm = taut.load_arm("kinova").subset(["j2s6s200_joint_1"])
    assert arm.continuous == (0,)
    run = taut.run(
        taut.compile(Frames(kp=50.0, kd=10.0), arm, rate=100.0),
        RigidPlant(arm, takes="mit", substeps=10),
        taut.JointMotion(q=[3.0]),
        q0=[-3.0],
        duration=2.0,
    )
    assert np.abs(np.sin(0.5 * (run.q[-1] - 3.0))) < 1e-3
    assert -3.4 < run.q.min() < run.q.max() < -2.9
    assert {"P", "D", "gravity"} <= set(run.terms)


def test_phases_of_a_task_and_laws_side_by_side_send_them():
    arm = taut.load_arm("planar2")
    law = ViaMit(law=GravityPID(kp=50.0, kd=5.0))
    goal = taut.JointMotion(q=[0.5, 0.5])
    task = [
        taut.Phase(law, goal, timeout=0.4, otherwise="own", name="there"),
        taut.Phase(Frames(kp=30.0, kd=5.0), taut.hold(), timeout=0.2, name="own"),
    ]
    plant = RigidPlant(arm, takes="mit", substeps=20)
    run = taut.run(taut.compile(task, arm, rate=100.0), plant, duration=1.0)
    assert run.outcome.kind == "stopped" or run.outcome.ok
    kp = run.extra["mit"][:, 2, 0]
    assert (kp[5], kp[45], kp[80]) == (50.0, 30.0, 0.0)
    both = taut.laws.SideBySide(a=(law, ["joint1"]), b=(Frames(kp=7.0, kd=1.0), ["joint2"]))
    ref = taut.together(a=taut.JointMotion(q=[0.1]), b=taut.JointMotion(q=[0.2]))
    rows = taut.compile(both, arm).step([0.0, 0.0], [0.0, 0.0], ref)
    assert rows[2].tolist() == [50.0, 7.0]
    assert rows[0].tolist() == [0.0, 0.2]


def test_what_does_not_fit_is_refused_in_a_sentence():
    arm = taut.load_arm("planar2")
    law = ViaMit(law=GravityPID(kp=50.0, kd=5.0))
    mit = RigidPlant(arm, takes="mit", substeps=10)
    with refused(MatchError):
        taut.run(taut.compile(law, arm), RigidPlant(arm), duration=0.1)
    with refused(MatchError):
        taut.run(taut.compile(law.law, arm), mit, duration=0.1)
    with refused(MatchError):
        taut.compile(ViaMit(law=taut.laws.PID(kp=1.0)) + law, arm)
    with refused(UsageError):
        ViaMit(law=taut.laws.ComputedTorque(kp=100.0, kd=20.0))
    with refused(UsageError):
        ViaMit(law=GravityPID(kp=50.0 * np.eye(2), kd=5.0))
    with refused(UsageError):
        taut.compile(ViaMit(law=taut.laws.VelocityPI(kp=1.0), kp_motor=1.0, kd_motor=1.0), arm)
    with refused(UsageError):
        RigidPlant(arm, actuation=inner(1000.0))
    for rate in (1500.0, 3000.0):
        plant = RigidPlant(arm, takes="mit", substeps=10, actuation=inner(rate))
        with refused(RangeError):
            taut.run(taut.compile(law, arm), plant, duration=0.1)
    with refused(UsageError):
        taut.analysis.check_stiffness(taut.compile(law, arm))


def test_a_record_keeps_the_five_numbers(tmp_path):
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(ViaMit(law=GravityPID(kp=50.0, kd=5.0)), arm, rate=100.0)
    run = taut.run(ctrl, RigidPlant(arm, takes="mit", substeps=10), taut.JointMotion(q=[0.3, 0.3]), duration=0.2)
    run.save(tmp_path / "run.mcap")
    again = taut.load_run(tmp_path / "run.mcap")
    np.testing.assert_array_equal(again.extra["mit"], run.extra["mit"])
    np.testing.assert_allclose(run.tau, run.command, atol=1e-12)  # of the first step of each tick


@pytest.mark.part(1)
@pytest.mark.parametrize(("rate", "taps"), [(500.0, 3), (100.0, 1)])
def test_of_a_pd_in_the_motors_a_delay_of_the_commands_is_cancelled(rate, taps):
    """The motors' targets are what the torque was computed of: the poles are those without delay, and zeros."""
    arm, at, law = taut.load_arm("one_joint"), np.array([0.3]), ViaMit(law=taut.laws.PID(kp=60.0, kd=6.0))
    poles = []
    for delay in (0, taps):
        plant = RigidPlant(
            arm.with_gravity([0.0, 0.0, 0.0]),
            takes="mit",
            substeps=20,
            actuation=inner(20.0 * rate, delay=delay / rate),
        )
        loop = taut.Loop(taut.compile(law, plant.arm, rate=rate), plant, taut.JointMotion(q=at), duration=1.0)
        found = taut.linearise(loop, at=at).poles
        poles.append(np.sort_complex(found[np.abs(found) > 1e-2]))
        assert taut.analysis.judge(loop, at=at, gains=["law.kd"]).stable
    np.testing.assert_allclose(poles[1], poles[0], atol=1e-7)


def test_the_largest_gain_in_the_motors_does_not_depend_on_the_delay_of_the_commands():
    """And that of torques is an inertia over a period, where the state is a period old."""
    arm, rate = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_friction(taut.Friction()), 200.0
    largest = {}
    for motor, delay in ((True, 0), (True, 1), (False, 1)):
        pd = taut.laws.PID(kp=10.0, kd=10.0)
        law = ViaMit(law=pd) if motor else ViaMit(law=pd, kp_motor=0.0, kd_motor=0.0)
        plant = RigidPlant(arm, takes="mit", substeps=10, actuation=inner(2000.0, delay=delay / rate))
        loop = taut.Loop(taut.compile(law, arm, rate=rate), plant, duration=1.0)
        largest[motor, delay] = 10.0 * taut.analysis.judge(loop, gains=["law.kd"]).largest["law.kd"]
    assert largest[True, 1] == pytest.approx(largest[True, 0], rel=0.02)
    assert largest[True, 1] == pytest.approx(2.0 * 0.5 * 2000.0, rel=0.02)
    assert largest[False, 1] == pytest.approx(0.5 * rate, rel=0.02)
