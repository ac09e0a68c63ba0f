"""Force control in runs: the pole, wrong models, steps, loss of contact, gain borders, friction, sensors that fail."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut

L = taut.laws
ARMS = ("panda", "ur10", "xarm7")
F_DES = np.array([5.0, -3.0, -10.0, 0.3, 0.2, -0.1])
# Rotation about the tool's own axis moves next to nothing in all three arms.
KDAMP = [40.0, 40.0, 40.0, 2.0, 2.0, 0.1]
STIFF, DAMPED = [2e4, 2e4, 2e4, 500.0, 500.0, 5.0], [400.0, 400.0, 400.0, 6.0, 6.0, 0.05]
FREE = {"environment.spring.stiffness": [0.0] * 6, "environment.damper.damping": [0.0] * 6}
KFP, KFI = 0.5, 3.0
MOST = {"e_int_max": (2.0, 0.05)}
Bar = Callable[[str, object], None]


@cache
def arm_of(name: str) -> taut.Arm:
    return taut.load_arm(name)


@cache
def controller(name: str, feedback: Any = "wrench") -> taut.Controller:
    gains = {} if feedback == "none" else {"kfp": KFP, "kfi": KFI, **MOST}
    law: taut.Law = L.ForceControl(kdamp=KDAMP, feedback=feedback, **gains)
    return taut.compile(law if feedback == "none" else L.LossOfContact(law=law), arm_of(name))


@cache
def loop(name: str, feedback: Any = "wrench", duration: float = 3.0) -> taut.Loop:
    held = taut.environments.Environments(
        spring=taut.environments.Spring(stiffness=STIFF), damper=taut.environments.Damper(damping=DAMPED)
    )
    plant = taut.RigidPlant(arm_of(name), friction=None, environment=held, substeps=4)
    return taut.Loop(controller(name, feedback), plant, taut.TaskForce(F_app=F_DES), duration=duration)


def run(name: str, events: Any = (), feedback: Any = "wrench", **more: Any) -> taut.Run:
    return taut.run(loop(name, feedback), events=events, **more)


def loaded(mass: float) -> taut.Event:
    return taut.Event(t=0.0, set={"plant.payload.mass": mass})


# -------------------------------------------------------------------- MATHS, section 1


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ARMS)
def test_the_error_falls_with_the_pole_kfi_over_one_plus_kfp_and_not_with_the_chapters(name: str) -> None:
    out = run(name, [loaded(0.5)])  # which the law does not know: a wrong gravity model
    error = F_DES + out.extra["F_ext"]
    late = (out.t > 0.8) & (out.t < 2.0)
    pole = np.polyfit(out.t[late], np.log(np.abs(error[late, 2])), 1)[0]
    assert pole == pytest.approx(-KFI / (1.0 + KFP), rel=0.02)
    assert abs(pole + KFI / KFP) > 3.0  # eq. 10.37
    assert np.abs(error[out.t > 0.2, 2]).max() > 1.5
    assert np.abs(error[-1, :3]).max() < 0.03  # and the integral takes it all out
    assert out.outcome.message == "completed: 3001 ticks, 3 s"


def test_what_g_does_not_know_stays_without_feedback_and_with_that_of_joint_torques() -> None:
    missing = 0.5 * 9.81 * np.array([0.0, 0.0, 1.0])
    for feedback, share in (("none", 1.0), ("joint_torque", 1.0), ("wrench", 0.0)):
        out = run("panda", [loaded(0.5)], feedback)
        left = (F_DES + out.extra["F_ext"])[-1, :3]
        np.testing.assert_allclose(left, share * missing, atol=0.03), feedback


@pytest.mark.part(2)
@pytest.mark.parametrize("name", ARMS)
def test_joint_torques_serve_as_feedback_where_the_model_is_right(name: str) -> None:
    out = run(name, feedback="joint_torque")
    np.testing.assert_allclose(-out.extra["F_ext"][-1], F_DES, atol=0.01)
    assert out.metrics.contact_lost_time == 0.0


@pytest.mark.parametrize("name", ARMS)
def test_a_step_of_force_comes_to_rest_where_it_was_asked_for(name: str) -> None:
    out = run(name)
    applied = -out.extra["F_ext"] / F_DES
    assert (np.abs(applied[out.t > 1.5] - 1.0) < 0.02).all()
    assert applied[:, :3].max() < 1.5
    assert out.between(1.5, 3.0).metrics.force_error_rms < 0.02


# -------------------------------------------------------------------- loss of contact


@pytest.mark.parametrize("name", ARMS)
def test_when_contact_is_lost_the_tool_is_no_faster_than_the_bound_and_the_run_says_so(name: str) -> None:
    out = run(name, [taut.Event(t=1.0, set=FREE)])
    speed, turning = np.linalg.norm(out.task.twist[:, :3], axis=1), np.linalg.norm(out.task.twist[:, 3:], axis=1)
    x = taut.snapshot(arm_of(name), out.q[out.t <= 1.0][-1])
    linear, angular = controller(name).law.law.speed_bound(F_app=F_DES, x=x, rate=1000.0)  # type: ignore[attr-defined]
    assert 0.3 * linear < speed.max() <= linear
    assert turning.max() <= angular
    assert "the tool met less than was asked for, contact was lost in" in out.outcome.message
    assert "first at t = 1.051 s" in out.outcome.message
    assert out.metrics.contact_lost_time == pytest.approx(1.949)


EVERY = [
    "panda",
    "ur10",
    "kinova",
    "xarm7",
    *(pytest.param(n, marks=pytest.mark.long) for n in ("fr3", "ur3", "ur5", "z1")),
]
DAMPER = np.array([40.0] * 3 + [2.0] * 3)


def free_run(
    name: str, F_app: Any, plant: Any, *, rate: float = 1000.0, q0: Any = None, duration: float = 1.0
) -> Any:
    """A tool that meets nothing, and at some of its poses V and D^-1."""
    arm = arm_of(name)
    law = L.ForceControl(feedback="none", kdamp=(40.0, 2.0))
    out = taut.run(taut.compile(law, arm, rate=rate), plant, taut.TaskForce(F_app=F_app), duration=duration, q0=q0)
    assert out.outcome.ok
    seen = []
    for k in range(0, len(out.t), len(out.t) // 50):
        x = taut.snapshot(arm, out.q[k])
        mobility = x.J() @ np.linalg.solve(x.M, x.J().T)
        seen.append((x, out.task.twist[k], np.diag(1.0 / DAMPER) + mobility / rate))
    return law, out, seen


def axes() -> list[Any]:
    """A force along each axis and a moment about each."""
    return [np.eye(6)[i] * (4.0 if i < 3 else 0.1) for i in range(6)]


def within_the_bound(name: str, plant: Any, rate: float = 1000.0, **more: Any) -> float:
    """The largest speed or angular speed of its bound at the poses that the tool goes through, over the six axes."""
    worst = 0.0
    for F_app in axes():
        law, out, seen = free_run(name, F_app, plant, rate=rate, **more)
        bounds = np.max([law.speed_bound(F_app=F_app, x=x, rate=rate) for x, _, _ in seen], axis=0)
        speeds = [np.linalg.norm(out.task.twist[:, k : k + 3], axis=1).max() for k in (0, 3)]
        worst = max(worst, *(speeds / bounds))
    return float(worst)


@pytest.mark.part(1)
@pytest.mark.parametrize("name", EVERY)
def test_the_bound_of_the_speed_holds_in_the_sampled_loop_along_every_axis(name: str) -> None:
    worst = within_the_bound(name, taut.RigidPlant(arm_of(name), friction=None))
    assert 0.95 < worst < 1.001  # and it is no more than what the tool reaches


@pytest.mark.part(1)
@pytest.mark.parametrize(("name", "rate"), [("ur10", 250.0), ("xarm7", 250.0), ("panda", 4000.0), ("z1", 4000.0)])
def test_so_it_does_at_other_rates(name: str, rate: float) -> None:
    worst = within_the_bound(name, taut.RigidPlant(arm_of(name), friction=None), rate, duration=0.5)
    assert 0.9 < worst < 1.001


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["xarm7", "z1"])
def test_so_it_does_with_the_friction_of_the_arm(name: str) -> None:
    assert within_the_bound(name, taut.RigidPlant(arm_of(name)), duration=0.5) < 1.0


@pytest.mark.long
@pytest.mark.parametrize("name", ["panda", "ur10"])
def test_so_it_does_in_mujoco(name: str) -> None:
    worst = within_the_bound(name, taut.MujocoPlant(arm_of(name), friction=None), duration=0.3)
    assert 0.9 < worst < 1.001


@pytest.mark.part(1)
@pytest.mark.parametrize("name", EVERY)
def test_from_any_pose_it_holds_in_the_mean_square(name: str) -> None:
    """V . D V in the mean, against the largest w . D^-1 w, whatever Lambda does on the way."""
    arm, plant = arm_of(name), taut.RigidPlant(arm_of(name), friction=None)
    rng = np.random.default_rng(3)
    lower, upper = np.maximum(arm.lower, -2.0), np.minimum(arm.upper, 2.0)
    for F_app in (axes()[0], axes()[4]):
        q0 = lower + (upper - lower) * rng.uniform(0.15, 0.85, arm.n)
        _, _, seen = free_run(name, F_app, plant, q0=q0, duration=1.5)
        used = np.mean([V @ np.linalg.solve(inverse, V) for _, V, inverse in seen])
        assert used <= 1.001 * max(F_app @ inverse @ F_app for _, _, inverse in seen)


@pytest.mark.parametrize(("kfp", "kfi", "stable"), [(0.55, 0.0, True), (0.66, 0.0, False), (0.3, 500.0, True), (0.3, 720.0, False)])  # fmt: skip
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_joint_torques_off_contact_bear_kfp_as_far_as_the_damping_leaves_it(kfp: Any, kfi: Any, stable: Any) -> None:
    """kfp + kfi dt / 2 + d / 2 < 1, d the largest eigenvalue of D dt Lambda^-1: 0.79 on a UR10."""
    arm = arm_of("ur10")
    x = taut.snapshot(arm, arm.home)
    S = 1e-3 * x.J() @ np.linalg.solve(x.M, x.J().T) * DAMPER
    d = np.linalg.eigvals(np.linalg.solve(np.eye(6) + S, S)).real.max()
    assert (kfp + 0.5e-3 * kfi + 0.5 * d < 1.0) == stable
    law = L.ForceControl(feedback="joint_torque", kfp=kfp, kfi=kfi, kdamp=(40.0, 2.0), e_int_max=(1e6, 1e6))
    press = taut.TaskForce(F_app=[1.0, -1.0, -2.0, 0.05, 0.02, 0.02])
    out = taut.run(taut.compile(law, arm), taut.RigidPlant(arm, friction=None), press, duration=0.3)
    turns = np.abs(np.diff(out.task.twist, n=2, axis=0)).max(axis=1)  # from tick to tick
    assert (turns[-20:].max() < 0.05 * turns[:20].max()) == stable


def test_damping_far_above_what_a_held_torque_could_be_is_stable_at_any_pose() -> None:
    arm = arm_of("xarm7")
    ctrl = taut.compile(L.ForceControl(feedback="none", kdamp=(1e4, 1e3)), arm)
    out = taut.run(ctrl, taut.RigidPlant(arm, friction=None), taut.TaskForce(F_app=F_DES), duration=2.0, v0=[0.5] * 7)
    assert out.outcome.ok
    assert np.abs(out.task.twist[-1, :3]).max() < 0.01
    assert np.abs(out.task.twist[-1, 3:]).max() < 1.0  # 0.1 N m for one tick on 1.4e-4 kg m^2


def test_without_damping_nothing_bounds_it() -> None:
    arm = taut.load_arm("gantry3")
    ctrl = taut.compile(L.ForceControl(feedback="none"), arm)
    out = taut.run(
        ctrl, taut.RigidPlant(arm, friction=None), taut.TaskForce(F_app=[0, 0, -10.0, 0, 0, 0]), duration=0.5
    )
    np.testing.assert_allclose(out.v[:, 2], -10.0 / 3.0 * out.t, atol=1e-9)


def test_a_run_that_never_meets_anything_says_so() -> None:
    out = run("panda", [taut.Event(t=0.0, set=FREE)])
    assert "contact was lost in 2951 of 3001 ticks, first at t = 0.05 s" in out.outcome.message


def test_the_free_motion_does_not_run_away() -> None:
    out = run("panda", v0=0.3 * np.linspace(1.0, -1.0, 7))
    assert np.abs(out.v[-1]).max() < 1e-3
    assert np.abs(out.q - out.q[0]).max() < 0.3


# -------------------------------------------------------------------- how large gains may be


@pytest.mark.parametrize(("gains", "stable"), [((0.95, 0.0), True), ((1.05, 0.0), False), ((0.5, 900.0), True), ((0.5, 1100.0), False)])  # fmt: skip
def test_on_a_rigid_contact_kfp_and_half_of_kfi_dt_are_below_one(gains: Any, stable: bool) -> None:
    arm = arm_of("panda")
    x = taut.snapshot(arm, arm.home)
    J = x.J()
    A = J @ np.linalg.solve(x.M, J.T)
    ctrl = taut.compile(L.ForceControl(kfp=gains[0], kfi=gains[1], null=None, e_int_max=(1e6, 1e6)), arm)
    F_ext, sizes = -0.9 * F_DES, []
    for _ in range(300):
        tau = ctrl.step(arm.home, np.zeros(7), taut.TaskForce(F_app=F_DES), F_ext=F_ext)
        F_ext = -np.linalg.solve(A, J @ np.linalg.solve(x.M, tau - x.g))  # eq. 10.42 with A = I, at rest
        sizes.append(np.linalg.norm(F_DES + F_ext))
    assert (sizes[-1] < 0.1 * sizes[0]) == stable
    assert (sizes[-1] > 10.0 * sizes[0]) != stable


@pytest.mark.parametrize(("kfp", "kfi", "stable"), [(0.9, 0.0, True), (1.05, 0.0, False), (0.5, 900.0, True), (0.5, 1100.0, False)])  # fmt: skip
def test_so_it_is_in_a_plant_with_a_rigid_floor(kfp: float, kfi: float, stable: bool) -> None:
    arm = arm_of("gantry3")
    floor = taut.Constraint.plane(point=taut.snapshot(arm, arm.home).T().p, normal=[0.0, 0.0, 1.0])
    law = L.ForceControl(kfp=kfp, kfi=kfi, kdamp=(20.0, 1.0), null=None, e_int_max=(1e6, 1e6))
    plant = taut.RigidPlant(arm, friction=None, contact=taut.RigidContact(constraint=floor))
    press = taut.TaskForce(F_app=[0, 0, -10.0, 0, 0, 0])
    out = taut.run(taut.compile(law, arm), plant, press, duration=0.2)
    left = np.abs(out.extra["F_ext"][100:, 2] - 10.0).max()
    assert (left < 0.1) == stable
    assert (left > 5.0) != stable


@pytest.mark.parametrize(("substeps", "lag"), [(1, 1.0), (10, 0.55)])
@pytest.mark.parametrize(("kfp", "kdamp", "b"), [(0.5, 50.0, 0.0), (2.0, 50.0, 20.0)])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_on_a_springy_contact_the_lag_of_the_force_takes_kfp_k_lag_from_the_damping(
    substeps: int, lag: float, kfp: float, kdamp: float, b: float
) -> None:
    arm = arm_of("gantry3")
    ctrl = taut.compile(L.ForceControl(kfp=kfp, kdamp=(kdamp, 1.0), null=None), arm)
    border = (kdamp + (1.0 + kfp) * b) / (kfp * lag * 1e-3)
    held = taut.environments.Environments(
        spring=taut.environments.Spring(stiffness=border), damper=taut.environments.Damper(damping=b)
    )
    plant = taut.RigidPlant(arm, friction=None, environment=held, substeps=substeps)
    press = taut.Loop(ctrl, plant, taut.TaskForce(F_app=[0, 0, -10.0, 0, 0, 0]), duration=4.0)
    for share, grows in ((0.9, False), (1.1, True)):
        stiffness = taut.Event(t=0.0, set={"environment.spring.stiffness": share * border})
        out = taut.run(press, events=[stiffness])
        error = np.abs(out.extra["F_ext"][:, 2] - 10.0) if out.outcome.ok else np.full(4001, np.inf)
        assert (error[3000:].max() > error[1000:2000].max()) == grows, (share, substeps)


# -------------------------------------------------------------------- sensors that fail


def pressing(wrench: taut.sensors.WrenchSensor, events: Any = (), **wrist: Any) -> taut.Run:
    arm = arm_of("gantry3")
    law = L.ForceControl(kfp=0.2, kfi=3.0, kdamp=(100.0, 1.0))
    sensing = taut.Sensing(wrist=taut.sensors.Wrist(**wrist)) if wrist else None
    held = taut.environments.Environments(
        spring=taut.environments.Spring(stiffness=5000.0), damper=taut.environments.Damper(damping=100.0)
    )
    plant = taut.RigidPlant(arm, friction=None, environment=held, sensors=taut.sensors.Sensors(wrench=wrench))
    press = taut.TaskForce(F_app=[0, 0, -10.0, 0, 0, 0])
    return taut.run(taut.compile(law, arm, sensing=sensing), plant, press, duration=3.0, events=events)


def test_a_sensor_at_the_end_of_its_range_is_told_and_the_integral_is_bounded() -> None:
    out = pressing(taut.sensors.WrenchSensor(range=(6.0, 1.0)), range=(6.0, 1.0))
    assert "the sensor of F_ext was at its range in" in out.outcome.message
    pushed = -out.extra["F_ext"][-1, 2]
    assert 10.0 < -pushed <= 10.0 + 0.2 * 4.0 + 3.0 * 20.0  # it presses on, as far as e_int_max lets it


def test_the_weight_of_the_tool_is_an_error_of_force_until_sensing_takes_it_out() -> None:
    tool = taut.Payload(mass=0.5)
    biased = pressing(taut.sensors.WrenchSensor(tool=tool))
    known = pressing(taut.sensors.WrenchSensor(tool=tool), mass=0.5)
    assert biased.between(2.0, 3.0).metrics.force_error_rms == pytest.approx(0.5 * 9.81, rel=0.02)
    assert known.between(2.0, 3.0).metrics.force_error_rms < 0.05


# -------------------------------------------------------------------- rigid contacts


@pytest.mark.part(1)
@pytest.mark.parametrize("frame", ["world", "tool"])
def test_on_a_rigid_contact_a_force_that_swings_up_is_refused_and_one_that_settles_is_not(frame: Any) -> None:
    """Only directions that the contact bears count: a plane bears no moment."""
    arm = arm_of("panda")
    floor = taut.Constraint.plane(point=[0.0, 0.0, 0.4], normal=[0.0, 0.0, 1.0])
    plant = taut.RigidPlant(arm, friction=None, contact=taut.RigidContact(constraint=floor))
    ref, q = taut.TaskForce(F_app=[0.0, 0.0, -10.0, 0.0, 0.0, 0.0]), taut.dynamics.onto(floor, arm, arm.home)

    law = L.ForceControl(kfp=(0.9, 1.5), kfi=(1.0, 1.0), kdamp=(300.0, 10.0), frame=frame)

    def loop_of(**more: Any) -> taut.Loop:
        return taut.Loop(taut.compile(law, arm, **more), plant, ref, duration=0.1)

    def last(loop: taut.Loop, kfp: float, kfi: float) -> float:
        loop.parameters["law.kfp"], loop.parameters["law.kfi"] = (kfp, 1.5), (kfi, 1.0)
        return float(np.abs(taut.run(loop, q0=q).extra["contact.lam"][-20:, 0] + 10.0).max())

    bare = loop_of()
    assert last(bare, 0.9, 1.0) < 0.1
    assert last(bare, 0.5, 900.0) < 0.1
    for kfp, kfi in ((1.05, 0.0), (0.5, 1100.0)):
        with refused(taut.errors.RangeError) as caught:
            last(bare, kfp, kfi)
        assert caught.value.name == "law.kfp"
    if frame == "world":
        assert last(loop_of(sensing=taut.Sensing(F_ext=taut.sensors.LowPass(cutoff=20.0))), 1.05, 1.0) < 1.0


# -------------------------------------------------------------------- 1000 seeded starts


@pytest.mark.bars
def test_contact_and_retreat_leave_no_torque_jump_above_the_rate_limit(share: Callable[[int], int], bar: Bar) -> None:
    arm = arm_of("planar3")
    most = np.array([300.0, 200.0, 100.0])  # [N m/s]
    law = L.ForceControl(kfp=0.3, kfi=8.0, kdamp=(60.0, 3.0), e_int_max=(3.0, 0.2))
    ctrl = taut.compile(law, arm, limits=taut.Limits(tau_dot=most))
    wall = taut.environments.StiffWall(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0], stiffness=5e3, damping=60.0)
    down, up = [0, 0, -12.0, 0, 0, 0], [0, 0, 8.0, 0, 0, 0]
    ramp = taut.chunk([0.6, 0.601], [taut.TaskForce(F_app=down), taut.TaskForce(F_app=up)])
    one = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None, environment=wall), ramp, duration=0.8)
    rng, touched, worst = np.random.default_rng(41), 0, 0.0
    for seed in range(share(1000)):
        q0 = rng.uniform([-0.8, 0.4, 0.4], [0.8, 1.6, 1.6])
        p = taut.snapshot(arm, q0).T().p
        place = [*p[:2], p[2] - rng.uniform(0.0, 0.02)]
        out = taut.run(one, q0=q0, seed=seed, events=[taut.Event(t=0.0, set={"environment.point": place})])
        assert out.outcome.ok
        touched += bool(out.extra["F_ext"].any())
        steps = np.abs(np.diff(out.tau, axis=0)).max(axis=0)
        worst = max(worst, float((steps / (most * 1e-3)).max()))
        assert (steps <= most * 1e-3 * (1.0 + 1e-9)).all()
    assert touched > 0.9 * share(1000)
    bar("force: starts of contact and retreat, torque jumps above the rate limit", f"{share(1000)}, 0")
    bar("force: largest change of torque in a tick, of the rate limit", f"{worst:.6f}")
