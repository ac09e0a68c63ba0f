"""Hybrid control where things go wrong in a run: nothing to press on, motions and forces that no constraint bears."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut import Constraint, Pose
from taut.base.types import Float64Array
from taut.laws import HybridMotionForce, LossOfContact, TaskComputedTorque

Array = Float64Array
ARM = taut.load_arm("kinova")
T = taut.snapshot(ARM, ARM.home).T()
BOARD = Constraint(lambda now: now.p[2] - T.p[2], one_sided=True)
STAY = taut.TaskMotion(pose=T)
NOWHERE = taut.environments.StiffWall(point=T.p - [0.0, 0.0, 3.0], normal=[0.0, 0.0, 1.0], stiffness=1e4)
KFP, KFI, E_INT_MAX, KDAMP = 0.3, 10.0, 0.4, 60.0
LIMITS = taut.Limits(tau_dot=1000.0)


def motion() -> TaskComputedTorque:
    return TaskComputedTorque(kp=400.0, kd=40.0)


def law(constraint: Constraint = BOARD, **more: Any) -> HybridMotionForce:
    return HybridMotionForce(constraint=constraint, motion=motion(), **({"kfp": KFP, "kfi": KFI} | more))


@pytest.fixture(scope="module")
def faded() -> taut.Controller:
    return taut.compile(LossOfContact(law=law()), ARM, limits=LIMITS)


def run(ctrl: taut.Controller, ref: Any, *, duration: float = 0.3, **plant: Any) -> taut.Run:
    return taut.run(ctrl, taut.RigidPlant(ARM, friction=None, **plant), ref, duration=duration)


def against(out: taut.Run) -> Array:
    """(k,) speed of the tool along the normal [m/s]."""
    return np.asarray(out.task.twist)[:, 2]


# -------------------------------------------------------------------- nothing to press on


def test_with_nothing_to_press_on_the_force_is_taken_back_and_the_run_tells(faded: taut.Controller) -> None:
    out = run(faded, taut.pressing(STAY, 5.0), environment=NOWHERE, duration=1.0)
    assert "; the tool met less than was asked for, contact was lost in 951 of 1001 ticks" in out.outcome.message
    assert out.metrics.contact_lost_time == pytest.approx(0.95, abs=2e-3)
    assert np.abs(against(out)).max() < 0.35  # it was 7 m/s after 0.3 s, and growing
    lost = out.extra["law.lost"] > 0.0
    assert np.abs(against(out)[lost][200:]).max() < 0.2
    assert out.t[np.argmax(lost)] == pytest.approx(0.05)


@pytest.mark.long
def test_with_kdamp_the_speed_stays_below_what_the_damping_holds() -> None:
    """|D^-1 ((1 + kfp) F_d + kfi e_int_max)| with D^-1 = 1 / kdamp + dt A Lambda^-1 A^T."""
    ctrl = taut.compile(law(kdamp=KDAMP, e_int_max=E_INT_MAX), ARM)
    out = run(ctrl, taut.pressing(STAY, 5.0), environment=NOWHERE, duration=1.0)
    x = taut.snapshot(ARM, ARM.home)
    mobility = (x.J() @ np.linalg.solve(x.M, x.J().T))[2, 2]
    bound = ((1.0 + KFP) * 5.0 + KFI * E_INT_MAX) * (1.0 / KDAMP + 1e-3 * mobility)
    speed = np.abs(against(out))
    assert 0.9 * bound < speed.max() < 1.001 * bound


LIGHT = [
    pytest.param(name, axis, marks=[pytest.mark.long] * (axis == 1 or name in ("ur3", "panda")))
    for name in ("ur10", "ur3", "kinova", "xarm7", "panda")
    for axis in (0, 1)
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "axis"), LIGHT)
def test_damping_beside_the_tool_is_stable_off_contact_on_light_directions_too(name: str, axis: int) -> None:
    """A face beside the tool: one of its rows is rotation about the last link, which next to nothing resists."""
    arm = taut.load_arm(name)
    x = taut.snapshot(arm, arm.home)
    T, kdamp, lam = x.T(), np.array([40.0, 2.0, 2.0]), np.array([-4.0, 0.1, 0.1])
    normal = T.R[:, axis]
    face = Constraint.plane(point=T.p, normal=normal, face=T.R.T @ -normal)
    ctrl = taut.compile(HybridMotionForce(constraint=face, motion=motion(), kdamp=kdamp), arm)
    press = taut.pressing(taut.TaskMotion(pose=T), lam=lam)
    out = taut.run(ctrl, taut.RigidPlant(arm, friction=None), press, duration=0.5)
    assert out.outcome.ok
    A = np.asarray(face.at(x).A)
    inverse = np.diag(1.0 / kdamp) + 1e-3 * A @ x.J() @ np.linalg.solve(x.M, x.J().T) @ A.T
    rate = np.asarray(out.task.twist) @ A.T
    assert (np.einsum("ti,ij,tj->t", rate, np.linalg.inv(inverse), rate) < 1.01 * lam @ inverse @ lam).all()


@pytest.mark.part(1)
@pytest.mark.parametrize(("kfp", "stable"), [(0.55, True), (0.66, False)])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_joint_torques_off_contact_bear_kfp_as_far_as_the_damping_leaves_it(kfp: float, stable: bool) -> None:
    """kfp + kfi dt / 2 + d / 2 < 1, d the largest eigenvalue of D dt A Lambda^-1 A^T: 0.79 beside the tool of a UR10."""
    arm = taut.load_arm("ur10")
    x = taut.snapshot(arm, arm.home)
    T, kdamp = x.T(), np.array([40.0, 2.0, 2.0])
    normal = T.R[:, 0]
    face = Constraint.plane(point=T.p, normal=normal, face=T.R.T @ -normal, one_sided=False)
    A = np.asarray(face.at(x).A)
    S = 1e-3 * kdamp[:, np.newaxis] * (A @ x.J() @ np.linalg.solve(x.M, x.J().T) @ A.T)
    d = np.linalg.eigvals(np.linalg.solve(np.eye(3) + S, S)).real.max()
    assert (kfp + 0.5 * d < 1.0) == stable
    gains = {"kfp": kfp, "kdamp": kdamp, "feedback": "joint_torque"}
    ctrl = taut.compile(HybridMotionForce(constraint=face, motion=motion(), **gains), arm)  # type: ignore[arg-type]
    press = taut.pressing(taut.TaskMotion(pose=T), lam=[-4.0, 0.1, 0.1])
    out = taut.run(ctrl, taut.RigidPlant(arm, friction=None), press, duration=0.3)
    turns = np.abs(np.diff(out.task.twist, n=2, axis=0)).max(axis=1)  # from tick to tick
    assert (turns[-20:].max() < 0.05 * turns[:20].max()) == stable


def test_the_damping_against_a_row_is_that_of_the_end_of_the_tick() -> None:
    ctrl = taut.compile(law(kfp=None, kfi=None, kdamp=KDAMP), ARM, engine="float")
    x = taut.snapshot(ARM, ARM.home, 0.1 * np.ones(ARM.n))
    ctrl.step(x.q, x.v, taut.pressing(STAY, 5.0))
    A = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]) @ x.J()
    D = 1.0 / (1.0 / KDAMP + 1e-3 * (A @ np.linalg.solve(x.M, A.T)).item())
    np.testing.assert_allclose(ctrl.terms["force_D"], -D * (A @ x.v) @ A, rtol=1e-9, atol=1e-9)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_contact_that_comes_back_is_taken_up_within_the_rate_limit(faded: taut.Controller) -> None:
    """A wall that was off for a while; the force comes back to what was asked for, and no torque jumps."""
    wall = taut.environments.StiffWall(point=T.p, normal=[0.0, 0.0, 1.0], stiffness=2e4, damping=300.0)
    away = taut.Event(t=0.3, set={"environment.stiffness": 1e-3, "environment.damping": 0.0})
    back = taut.Event(t=0.45, set={"environment.stiffness": 2e4, "environment.damping": 300.0})
    plant = taut.RigidPlant(ARM, friction=None, environment=wall, substeps=4)
    out = taut.run(faded, plant, taut.pressing(STAY, 5.0), duration=1.6, events=[away, back])
    assert out.outcome.ok
    assert out.metrics.contact_lost_time > 0.05
    assert out.extra["F_ext"][299, 2] == pytest.approx(5.0, abs=0.1)
    assert out.extra["F_ext"][-1, 2] == pytest.approx(5.0, abs=0.2)
    assert np.abs(np.diff(out.command, axis=0)).max() <= 1000.0 * 1e-3 * (1.0 + 1e-9)


def test_the_force_goes_and_comes_without_a_jump(faded: taut.Controller) -> None:
    """Force against a wall that vanishes and is there again: the command takes the whole patience each time."""
    faded.reset()
    q, v, ref = np.array(ARM.home), np.zeros(ARM.n), taut.pressing(STAY, 5.0)
    lam = []
    for k in range(400):
        there = 0.0 if 100 <= k < 250 else 5.0
        faded.step(q, v, ref, F_ext=np.array([0.0, 0.0, there, 0.0, 0.0, 0.0]))
        lam.append(float(faded.memory["law.lam"][0]))
    steps = np.abs(np.diff(lam))
    assert steps[np.arange(399) != 99].max() < (1.0 + KFP) * 5.0 / 50.0 * 1.1  # 50 ticks of patience
    assert steps[99] == pytest.approx(KFP * 5.0, abs=0.06)  # what kfp makes of the force that is gone
    np.testing.assert_allclose([lam[99], lam[200], lam[399]], [-5.0, -2.0, -5.0], atol=0.06)


def test_rows_that_hold_both_ways_are_always_there() -> None:
    line = Constraint.line(point=T.p, axis=[1.0, 0.0, 0.0])
    both = LossOfContact(law=law(line))
    ctrl = taut.compile(both, ARM, engine="float")
    ref = taut.pressing(STAY, lam=[3.0, -4.0])
    for _ in range(80):
        ctrl.step(ARM.home, np.zeros(ARM.n), ref, F_ext=np.zeros(6))
    assert ctrl.memory["law.lost"] == 0.0
    assert ctrl.memory["law.applied"].tolist() == [1.0, 1.0]
    np.testing.assert_allclose(ctrl.memory["law.e_int"], 80e-3 * np.array([3.0, -4.0]))


def test_an_integral_has_a_bound_where_none_is_given_as_that_of_force_control() -> None:
    """20 N s for a row that is a force, 2 N m s for one that is a moment."""
    face = Constraint.plane(point=T.p, normal=[0.0, 0.0, 1.0], face=T.R.T @ [0.0, 0.0, -1.0])
    assert face.moments == (False, True, True)
    assert Constraint.grasp("a", "b").moments == (False, False, False, True, True, True)
    assert Constraint.knife_edge(sideways=[0.0, 1.0, 0.0]).moments == (False,)
    ctrl = taut.compile(law(face, kdamp=100.0), ARM, rate=100.0, engine="float")
    ref = taut.pressing(STAY, lam=[-1000.0, 100.0, 100.0])
    for _ in range(5):
        ctrl.step(ARM.home, np.zeros(ARM.n), ref, F_ext=np.zeros(6))
    np.testing.assert_allclose(ctrl.memory["law.e_int"], [-20.0, 2.0, 2.0])


# -------------------------------------------------------------------- what is asked for


def test_a_stream_into_the_surface_is_told_and_followed_along_it(faded: taut.Controller) -> None:
    def dive(x: Any) -> Any:
        return taut.pressing(taut.TaskMotion(pose=Pose(T.p - [0.0, 0.0, 0.09 * x.t], R=T.R)), 5.0)

    out = run(faded, taut.stream(period=0.05, source=dive), contact=BOARD, duration=0.3)
    assert "left out a part of what was asked for: the motion must keep to the constraint" in out.outcome.message
    assert "at t = 0.15 s it is 0.0135 into it" in out.outcome.message
    assert np.abs(out.task.p - T.p).max() < 1e-4
    quiet = run(faded, taut.stream(period=0.05, source=lambda x: taut.pressing(STAY, 5.0)), contact=BOARD)
    assert quiet.outcome.message == "completed: 301 ticks, 0.3 s"


@pytest.mark.part(1)
@pytest.mark.parametrize(
    ("forces", "told"),
    [
        ({"F_app": [3.0, 0.0, -5.0, 0.0, 0.0, 0.0]}, True),
        ({"F_app": [0.01, 0.0, -5.0, 0.0, 0.0, 0.0]}, False),  # where the tool is, not where it should be
        ({"F_app": [0.0, 0.0, 5.0, 0.0, 0.0, 0.0]}, True),
        ({"lam": [2.0]}, True),
        ({"lam": [-2.0]}, False),
        ({"lam": [-2.0, 0.0]}, True),
        ({"press": 2.0}, False),
        ({}, False),
    ],
)
def test_a_streamed_force_that_the_constraint_does_not_bear_is_told_and_left_out(
    faded: taut.Controller, forces: Any, told: bool
) -> None:
    out = run(
        faded, taut.stream(period=0.05, source=lambda x: taut.pressing(STAY, **forces)), contact=BOARD, duration=0.1
    )
    assert ("left out a part of what was asked for" in out.outcome.message) == told
    if "F_app" in forces and forces["F_app"][2] < 0.0:
        pressed = run(faded, taut.pressing(STAY, 5.0), contact=BOARD, duration=0.1)
        np.testing.assert_allclose(out.terms["force"][60:], pressed.terms["force"][60:], atol=1e-6)


# -------------------------------------------------------------------- gains that are too high


def test_gains_that_swing_up_on_a_rigid_contact_are_refused_there_and_told_elsewhere() -> None:
    high = taut.compile(law(kfp=1.5), ARM)
    with refused(taut.errors.RangeError):
        run(high, taut.pressing(STAY, 5.0), contact=BOARD)
    filtered = taut.compile(law(kfp=1.5), ARM, sensing=taut.Sensing(F_ext=taut.sensors.LowPass(cutoff=50.0)))
    assert run(filtered, taut.pressing(STAY, 5.0), contact=BOARD, duration=0.05).outcome.ok
    assert law(kfp=[1.0]).force_loop_gain(1e-3, None) == pytest.approx(1.005)
    assert HybridMotionForce(constraint=BOARD, motion=motion()).force_loop_gain(1e-3, None) == 0.0


# -------------------------------------------------------------------- rows that become dependent


@pytest.mark.long
def test_rows_that_become_dependent_are_left_out() -> None:
    """A plane and a saddle z = 10 x y meet along x = 0, and at y = 0 they touch: their gradients are one."""
    centre = T.p + np.array([0.0, 0.05, 0.0])

    def meeting(now: Pose) -> Any:
        d = now.p - centre
        return taut.math.array([d[2], d[2] - 10.0 * d[0] * d[1]])

    both = Constraint(meeting)
    ctrl = taut.compile(HybridMotionForce(constraint=both, motion=motion()), ARM)
    way = taut.pressing(taut.trajectories.Line(T0=T, T1=Pose(centre, R=T.R), duration=0.3))
    out = run(ctrl, way, contact=both, duration=0.5)
    assert np.abs(out.command).max() < 1.2 * np.abs(out.command[0]).max()
    assert np.abs(out.task.p[-1] - centre).max() < 1e-3
    # exactly there, with a motion that both rows cannot have
    ctrl.step(ARM.home, np.zeros(ARM.n), taut.pressing(STAY))
    x = taut.snapshot(ARM, taut.dynamics.onto(BOARD, ARM, out.q[-1]), np.full(ARM.n, 0.1))
    tau = ctrl.step(x.q, x.v, taut.pressing(taut.TaskMotion(pose=x.T())))
    assert np.abs(tau).max() < 100.0
