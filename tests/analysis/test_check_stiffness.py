"""Stability and passivity of arms under controllers, against runs, against the linearised loop and Colgate's bound."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import taut

check_stiffness = taut.analysis.check_stiffness
RATE = 100.0  # [Hz], where arms meet the limit at stiffness that people ask for
HANDS = 20.0  # [Hz] that hands do not exceed


def controller(arm: taut.Arm, **gains: Any) -> taut.Controller:
    return taut.compile(taut.laws.Impedance(**({"K": (3000.0, 100.0), "B": (30.0, 0.05)} | gains)), arm, rate=RATE)


def grows(arm: taut.Arm, ctrl: taut.Controller, factor: float, q: Any) -> bool:
    """A small deviation is larger at the end of a run than in its middle."""
    K = np.asarray(ctrl.law.parameters()["K"])
    plant = taut.RigidPlant(arm, friction=None, integrator="rk4", substeps=10)
    loop = taut.Loop(ctrl, plant, taut.TaskMotion(pose=taut.snapshot(arm, q).T()), duration=3.0)
    loop.parameters["law.K"] = factor * K
    run = taut.run(loop, q0=q + 1e-6 * np.cos(np.arange(arm.n)))
    parts = [np.abs(part).max() for part in np.array_split(run.v, 10)]
    return not run.outcome.ok or bool(parts[9] > parts[5])


@pytest.mark.long
@pytest.mark.parametrize("name", ["panda", "ur10", "xarm7"])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_runs_begin_to_grow_at_the_limit(name: str) -> None:
    arm = taut.load_arm(name).with_friction(taut.Friction())
    ctrl = controller(arm, B=(10.0, 0.005) if name == "xarm7" else (30.0, 0.05))  # its wrist is light
    check = check_stiffness(ctrl)
    assert check.limit > 0.0
    assert check.stable == (check.limit > 1.0)
    assert not grows(arm, ctrl, 0.97 * check.limit, arm.home)
    assert grows(arm, ctrl, 1.03 * check.limit, arm.home)


AWKWARD = {
    "ur10, kd of the wrist": ("ur10", taut.laws.Stiffness(K=(800.0, 30.0), kd=2.0), 0.0),
    "ur10 with friction": ("ur10", taut.laws.Stiffness(K=(800.0, 30.0), kd=2.0), 1.0),
    "kinova, kd of the wrist": ("kinova", taut.laws.Stiffness(K=(800.0, 30.0), kd=2.0), 0.1),
    "xarm7, B of the wrist": ("xarm7", taut.laws.Impedance(K=(800.0, 30.0), B=(60.0, 4.0)), 0.0),
    "panda": ("panda", taut.laws.Impedance(K=(800.0, 30.0), zeta=0.7), 0.0),
    "PID that droops": ("planar2", taut.laws.PID(kp=300.0, kd=40.0, ki=50.0), 0.1),
    "PID of acceleration": ("ur10", taut.laws.ComputedTorque(kp=400.0, kd=40.0), 0.0),
}


@pytest.mark.part(1)
@pytest.mark.parametrize("case", AWKWARD)
@pytest.mark.parametrize(
    "velocity", ["measured", taut.sensors.Difference(cutoff=60.0)], ids=["measured", "difference"]
)
def test_the_loop_is_that_of_the_simulated_plant(case: str, velocity: Any) -> None:
    """A damper of the law makes light wrists unstable; all directions count, and the friction of the joints."""
    name, law, viscous = AWKWARD[case]
    arm = taut.load_arm(name).with_friction(taut.Friction(viscous=viscous))
    if "droops" not in case:  # of which the sampled compensation of gravity is left out
        arm = arm.with_gravity([0.0, 0.0, 0.0])
    ctrl = taut.compile(law, arm, sensing=taut.Sensing(velocity=velocity))
    check = check_stiffness(ctrl)
    plant = taut.RigidPlant(arm, integrator="rk4", substeps=10)
    judged = taut.analysis.judge(taut.Loop(ctrl, plant, duration=1.0), at=arm.home)
    assert check.stable == judged.stable
    assert check.system.radius == pytest.approx(judged.radius, rel=1e-4 if "droops" in case else 2e-5)  # of RK4
    if not check.stable:
        assert next(iter(check.direction)) == next(iter(judged.joints))
        assert next(iter(check.tool_direction)) == next(iter(judged.tool))
        assert check.limit < 0.05  # the damper is to blame, not the stiffness


def test_a_verdict_names_the_friction_that_it_relies_on() -> None:
    arm = taut.load_arm("ur10").with_friction(taut.Friction(viscous=0.5))
    ctrl = taut.compile(taut.laws.Stiffness(K=(800.0, 30.0), kd=0.0), arm)
    check, bare = check_stiffness(ctrl), check_stiffness(ctrl, damping=0.0)
    assert (check.stable, bare.stable) == (True, False)
    assert check.relies_on == ("viscous friction of the joints",)
    assert bare.relies_on == ()


def test_a_change_of_a_gain_and_the_payload_of_now_count() -> None:
    arm = taut.load_arm("panda")
    ctrl = controller(arm)
    before = check_stiffness(ctrl)
    limit, mass = before.limit, np.linalg.norm(before.M)
    ctrl.parameters["law.K"] = (6000.0, 200.0)
    assert check_stiffness(ctrl).limit == pytest.approx(0.5 * limit, rel=3e-3)
    ctrl.parameters["model.payload.mass"] = 3.0
    loaded = check_stiffness(ctrl)
    carried = controller(arm.with_payload(mass=3.0), K=(6000.0, 200.0))
    assert pytest.approx(check_stiffness(carried).M, rel=1e-9) == loaded.M
    assert loaded.system.radius == pytest.approx(check_stiffness(carried).system.radius, rel=1e-7)
    assert np.linalg.norm(loaded.M) > 1.1 * mass


@pytest.mark.long
def test_axes_and_errors_of_the_law_count() -> None:
    arm = taut.load_arm("panda")
    six = [500.0, 1000.0, 3000.0, 20.0, 40.0, 80.0]
    q = arm.home + 0.3
    tool = check_stiffness(controller(arm, K=six, frame="tool"), q).limit
    body = check_stiffness(controller(arm, K=six, error="body"), q).limit
    world = check_stiffness(controller(arm, K=six), q).limit
    assert tool == pytest.approx(body, rel=2e-3)
    assert abs(tool - world) > 0.01 * tool


def test_passivity_is_colgates_at_the_joints() -> None:
    """b > T/2 lambda_max(J^T K J) + B, with velocity differenced and gravity compensated; in a band a damper helps."""
    arm = taut.load_arm("planar2").with_friction(taut.Friction(viscous=2.0))
    q, K, b, T = np.array([0.3, 0.8]), 400.0, 2.0, 1e-3
    J = taut.snapshot(arm, q).J()[:3]
    law = taut.laws.Stiffness(K=(K, 0.0), kd=0.1)
    check = check_stiffness(taut.compile(law, arm, sensing=taut.Sensing(velocity="difference")), q)
    stiffest = float(np.linalg.eigvalsh(J.T @ J)[-1]) * K
    assert check.passive
    assert check.damping_margin == pytest.approx(b - 0.1 - 0.5 * T * stiffest, rel=1e-5)
    assert check.passive_limit == pytest.approx((b - 0.1) / (0.5 * T * stiffest), rel=2e-3)
    measured = taut.compile(law, arm)
    assert not check_stiffness(measured, q).passive
    assert check_stiffness(measured, q, band=HANDS).passive


def test_a_damper_of_the_law_helps_in_a_band_and_an_unstable_loop_is_passive_in_none() -> None:
    arm = taut.load_arm("panda").with_friction(taut.Friction())
    bare, damped = (taut.compile(taut.laws.Stiffness(K=(500.0, 20.0), kd=kd), arm) for kd in (0.0, 2.0))
    assert not check_stiffness(bare, band=HANDS).passive
    assert check_stiffness(damped, band=HANDS).passive
    check = check_stiffness(controller(arm, K=(100.0, 5.0), B=(400.0, 20.0)), band=HANDS)
    assert check.damping_margin > 0.0
    assert not check.stable
    assert not check.passive
    assert check.passive_limit == 0.0


class WorldSpring(taut.Law):
    """A spring of the tool in world axes: a law of a user's own."""

    K: taut.Gain = taut.Gain(shape=3)

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        away = x.T().p - x.at(ref.q, ref.v).T().p
        return taut.Torque(spring=-x.J()[:3].T @ (self.K @ away))


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_the_limit_of_a_law_of_ones_own_is_that_of_runs() -> None:
    """A stiff spring along x and z at the tool of two links, undamped but for the joints: runs grow above it."""
    arm = taut.load_arm("planar2").with_gravity([0.0, 0.0, 0.0]).with_joints(viscous=[2.0, 1.0])
    q = [0.3, 0.8]
    ctrl = taut.compile(WorldSpring(K=[1.0, 1.0, 1.0]), arm)
    limit = check_stiffness(ctrl, q).limit
    for factor, expected in ((0.97, False), (1.03, True)):
        ctrl.parameters["law.K"] = np.full(3, factor * limit)
        run = taut.run(
            ctrl, taut.RigidPlant(arm, integrator="rk4"), taut.JointMotion(q=q), duration=4.0,
            q0=[q[0] + 1e-7, q[1] - 1e-7],
        )  # fmt: skip
        window = np.hanning(1000)[:, np.newaxis]
        middle, end = ((window * run.v[k : k + 1000] ** 2).sum() for k in (1500, 3000))
        assert bool(end > middle) is expected


def test_sums_with_friction_compensation_and_late_torques_are_judged() -> None:
    arm = taut.load_arm("panda")
    law = taut.laws.Impedance(K=(800.0, 30.0), zeta=0.7) + taut.laws.FrictionCompensation(at="meas")
    ctrl = taut.compile(law, arm)
    assert check_stiffness(ctrl).stable
    limits = [check_stiffness(ctrl, delay=delay).limit for delay in (0.0, 0.4e-3, 1e-3)]
    assert limits[0] > limits[1] > limits[2]


def test_its_content_has_verdicts_and_limits() -> None:
    check = check_stiffness(taut.compile(taut.laws.Stiffness(K=(5000.0, 30.0), kd=2.0), taut.load_arm("ur10")))
    content = check.json()
    assert [row["holds"] for row in content["tables"][""]] == [check.stable, check.passive]
    assert content["faults"] == ["the loop is unstable by itself"]


REFUSED = {
    "no controller": (lambda: check_stiffness(3), taut.errors.UsageError, "ctrl"),  # type: ignore[arg-type]
    "wrist sensor": (
        lambda: check_stiffness(
            taut.compile(taut.laws.Impedance(K=(1.0, 1.0), zeta=1.0, D=(1.0, 1.0)), taut.load_arm("panda"))
        ),
        taut.errors.UsageError, "ctrl",
    ),
    "velocity": (
        lambda: check_stiffness(taut.compile(taut.laws.VelocityPI(kp=1.0), taut.load_arm("planar2"))),
        taut.errors.UsageError, "ctrl",
    ),
    "damping": (
        lambda: check_stiffness(controller(taut.load_arm("panda")), damping=[1.0, 2.0]),
        taut.errors.ShapeError, "damping",
    ),
    "pose": (lambda: check_stiffness(controller(taut.load_arm("panda")), [0.0]), taut.errors.ShapeError, "at"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_refused_by_name(case: str) -> None:
    call, kind, name = REFUSED[case]
    with pytest.raises(kind) as caught:
        call()
    assert caught.value.name == name


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["panda", "xarm7"])
def test_redundant_arms_are_passive_in_a_band_without_damping_of_the_null_space(name: str) -> None:
    arm = taut.load_arm(name).with_friction(taut.Friction())
    x = taut.snapshot(arm, arm.home)
    apparent = 1.0 / np.diag(x.J() @ np.linalg.solve(x.M, x.J().T))
    K = apparent * 10.0**2  # 10 rad/s along each axis
    law = taut.laws.Impedance(K=K, B=1.5 * K / 200.0, coriolis="keep", null=None)
    check = taut.analysis.check_stiffness(taut.compile(law, arm, rate=200.0), band=20.0)
    assert check.stable
    assert check.passive
    law = taut.laws.Impedance(K=K, B=0.2 * K / 200.0, coriolis="keep", null=None)
    assert not taut.analysis.check_stiffness(taut.compile(law, arm, rate=200.0), band=20.0).passive


@pytest.mark.parametrize("kd", [0.05, 0.5, 2.0])
def test_without_physical_damping_the_limit_is_twice_the_sampled_damping_a_period(kd: float) -> None:
    """K = 2 kd / T of a mass, however little the damping is: a slow growth is none of rounding."""
    ctrl = taut.compile(taut.laws.Stiffness(K=(2000.0, 30.0), kd=kd), taut.load_arm("gantry3"))
    check = check_stiffness(ctrl, damping=0.0)
    assert check.limit == pytest.approx(2.0 * kd * 1000.0 / 2000.0, rel=2e-3)
    assert check.stable == (kd == 2.0)


@pytest.mark.parametrize("name", ["gantry3", "ur5"])
def test_a_spring_without_any_damping_is_unstable_at_any_stiffness(name: str) -> None:
    ctrl = taut.compile(taut.laws.Stiffness(K=(20.0, 1.0), kd=0.0), taut.load_arm(name))
    check = check_stiffness(ctrl, damping=0.0)
    assert not check.stable
    assert check.limit < 1e-3
