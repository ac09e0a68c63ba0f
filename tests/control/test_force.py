"""ForceControl and TaskForce as functions: the chapter's equations by hand, estimates, memory, and every message."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.control.laws.force import wrench_of_torques
from taut.maths.snapshot import Snapshot
from taut.maths.task_inertia import TaskInertia

L = taut.laws
PANDA = taut.load_arm("panda")
RNG = np.random.default_rng(5)
F_DES = np.array([5.0, -3.0, -10.0, 0.3, 0.2, -0.1])
F_EXT = np.array([-4.0, 2.0, 8.0, -0.2, -0.1, 0.3])
KFP, KFI = np.linspace(0.2, 0.7, 6), np.linspace(1.0, 6.0, 6)
KDAMP = np.array([50.0, 60.0, 70.0, 2.0, 1.5, 1.0])
Q = np.array(PANDA.home) + 0.3 * np.sin(np.arange(7))
V = 0.2 * np.cos(np.arange(7))


def stepped(law: taut.Law, arm: taut.Arm = PANDA, ticks: int = 1, ref: Any = None, **measured: Any) -> Any:
    """A controller after some ticks at Q, V, and its last command."""
    ctrl = taut.compile(law, arm, engine=measured.pop("engine", "float"), limits=measured.pop("limits", None))
    q, v = (Q, V) if arm is PANDA else (np.array(arm.home), np.zeros(arm.n))
    for _ in range(ticks):
        tau = ctrl.step(q, v, ref or taut.TaskForce(F_app=F_DES), **measured)
    return ctrl, np.array(tau)


def both(R: Any) -> Any:
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = R
    return out


# -------------------------------------------------------------------- the law


def test_without_feedback_it_is_eq_10_34() -> None:
    _, tau = stepped(L.ForceControl(feedback="none", null=None))
    x = taut.snapshot(PANDA, Q, V)
    np.testing.assert_allclose(tau, x.g + x.J().T @ F_DES, atol=1e-12)


@pytest.mark.parametrize("frame", ["world", "tool"])
def test_with_feedback_it_is_eq_10_38_in_the_axes_of_the_gains(frame: Any) -> None:
    law = L.ForceControl(kfp=KFP, kfi=KFI, kdamp=KDAMP, frame=frame, null=None, e_int_max=(1.0, 1.0))
    ctrl, tau = stepped(law, ticks=3, F_ext=F_EXT)
    x = taut.snapshot(PANDA, Q, V)
    W = both(x.T().R) if frame == "tool" else np.eye(6)
    F_e = W.T @ (F_DES + F_EXT)  # F_app is -F_ext
    e_int = 3 * 1e-3 * F_e
    mobility = W.T @ x.J() @ np.linalg.solve(x.M, x.J().T) @ W
    damping = np.linalg.solve(np.diag(1.0 / KDAMP) + 1e-3 * mobility, W.T @ x.twist())
    np.testing.assert_allclose((damping / (KDAMP * (W.T @ x.twist())))[:3], 1.0, atol=0.1)
    F = W @ (W.T @ F_DES + KFP * F_e + KFI * e_int - damping)
    np.testing.assert_allclose(tau, x.g + x.J().T @ F, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(ctrl.memory["law.integral.e_int"], e_int, atol=1e-15)
    np.testing.assert_allclose(ctrl.terms["P"], x.J().T @ W @ (KFP * F_e), atol=1e-12)
    assert set(ctrl.terms) == {"feedforward", "P", "I", "D", "gravity"}


def test_matrix_gains_couple_forces_and_moments() -> None:
    A = RNG.normal(size=(6, 6))
    K = 0.1 * (A @ A.T)
    _, tau = stepped(L.ForceControl(kfp=K, null=None), F_ext=F_EXT)
    x = taut.snapshot(PANDA, Q, V)
    np.testing.assert_allclose(tau, x.g + x.J().T @ (F_DES + K @ (F_DES + F_EXT)), atol=1e-12)


def test_a_wrench_in_the_axes_of_the_tool_turns_with_it() -> None:
    x = taut.snapshot(PANDA, Q, V)
    _, tau = stepped(L.ForceControl(feedback="none", null=None), ref=taut.TaskForce(F_app=F_DES, frame="tool"))
    np.testing.assert_allclose(tau, x.g + x.J(axes="E").T @ F_DES, atol=1e-12)


def test_a_hold_of_nothing_asks_for_no_force() -> None:
    ctrl = taut.compile(L.ForceControl(feedback="none"), PANDA)
    out = taut.run(ctrl, taut.RigidPlant(PANDA, friction=None), taut.hold(), duration=0.1)
    assert np.abs(out.q - PANDA.home).max() < 1e-12
    assert not out.reference.F_world.any()


def test_the_null_law_moves_no_tool() -> None:
    law = L.ForceControl(feedback="none", null=L.Posture(kp=100.0, q=np.array(PANDA.home) + 0.5))
    ctrl, _ = stepped(law)
    x = taut.snapshot(PANDA, Q, V)
    assert np.abs(ctrl.terms["null"]).max() > 0.5
    np.testing.assert_allclose(x.J() @ np.linalg.solve(x.M, ctrl.terms["null"]), 0.0, atol=1e-9)


# -------------------------------------------------------------------- F_app from joint torques


def measured(tau_meas: Any) -> Snapshot:
    x = taut.snapshot(PANDA, Q, V)
    return Snapshot(x.model, q=Q, v=V, payload=x._payload, measured={"tau_meas": tau_meas})


def test_torques_give_the_wrench_at_rest_and_the_free_motion_does_not_show_in_it() -> None:
    x = taut.snapshot(PANDA, Q, V)
    J, M = x.J(), x.M
    inertia = TaskInertia.of(J, x.M_factors)
    free = np.linalg.svd(J)[2][-1]  # an acceleration that the tool does not feel
    tau = x.h + M @ (40.0 * free) + J.T @ F_DES
    np.testing.assert_allclose(wrench_of_torques(measured(tau), inertia), F_DES, atol=1e-9)
    plain = np.linalg.pinv(J.T) @ (tau - x.h)  # by the usual pseudoinverse it does
    assert np.abs(plain - F_DES).max() > 1.0
    # An acceleration of the tool itself shows as Lambda a, in either.
    a = RNG.normal(size=7)
    seen = wrench_of_torques(measured(x.h + M @ a + J.T @ F_DES), inertia)
    np.testing.assert_allclose(seen - F_DES, inertia.Lambda @ J @ a, atol=1e-9)


def test_feedback_of_joint_torques_needs_them_and_no_wrist() -> None:
    ctrl = taut.compile(L.ForceControl(kfp=0.5, feedback="joint_torque"), PANDA, engine="float")
    assert set(ctrl.needs) == {"v", "tau_meas"}
    x = taut.snapshot(PANDA, PANDA.home)
    tau = ctrl.step(PANDA.home, np.zeros(7), taut.TaskForce(F_app=F_DES), tau_meas=np.array(x.g + x.J().T @ F_DES))
    np.testing.assert_allclose(tau, x.g + x.J().T @ F_DES, atol=1e-8)


# -------------------------------------------------------------------- the integral


def test_the_integral_is_cut_at_the_length_of_each_part() -> None:
    law = L.ForceControl(kfi=5.0, null=None, e_int_max=(0.05, 0.004))
    ctrl, _ = stepped(law, ticks=20, F_ext=F_EXT)
    e_int, F_e = ctrl.memory["law.integral.e_int"], F_DES + F_EXT
    assert np.linalg.norm(e_int[3:]) == pytest.approx(0.004)
    np.testing.assert_allclose(e_int[:3], 20e-3 * F_e[:3])  # 0.045 N s: not yet
    np.testing.assert_allclose(e_int[3:] / 0.004, F_e[3:] / np.linalg.norm(F_e[3:]))


def test_what_limits_cut_does_not_wind_the_integral_up() -> None:
    limits = taut.Limits(tau=np.abs(taut.snapshot(PANDA, Q, V).g) + 0.5)
    wound = {
        scheme: stepped(
            L.ForceControl(kfi=50.0, integral=L.Integral(anti_windup=scheme, **more), null=None),
            ticks=400,
            F_ext=np.zeros(6),
            limits=limits,
            engine="native",
        )[0].memory["law.integral.e_int"]
        for scheme, more in (("none", {}), ("clamping", {}), ("back-calculation", {"tracking": 200.0}))
    }
    np.testing.assert_allclose(wound["none"], 0.4 * F_DES)
    for scheme, most in (("clamping", 0.3), ("back-calculation", 0.6)):
        assert np.linalg.norm(wound[scheme][:3]) < most * np.linalg.norm(wound["none"][:3]), scheme


# -------------------------------------------------------------------- contact


@pytest.mark.parametrize(("F_app", "lost"), [([0, 0, -9.0], False), ([0, 0, -0.9], True), ([9.0, 0, 0], True), ([0, 0, 9.0], True)])  # fmt: skip
def test_contact_is_lost_when_less_than_counts_is_there_along_what_is_asked_for(F_app: Any, lost: bool) -> None:
    law = L.LossOfContact(law=L.ForceControl(kfp=0.1, null=None), patience=0.003)
    ref = taut.TaskForce(F_app=[0, 0, -10.0, 0, 0, 0])
    told = [
        bool(stepped(law, ticks=ticks, ref=ref, F_app=np.array([*F_app, 0, 0, 0]))[0].memory["law.lost"])
        for ticks in (1, 3, 4, 5)
    ]
    assert told == ([False, False, True, True] if lost else [False] * 4)


def test_a_moment_that_meets_nothing_is_lost_too_and_none_is_where_none_is_asked_for() -> None:
    law = L.LossOfContact(law=L.ForceControl(kfp=0.1, null=None), patience=0.0)
    turned = taut.TaskForce(F_app=[0, 0, 0, 0, 0, 1.0])
    assert stepped(law, ref=turned, F_ext=np.zeros(6))[0].memory["law.lost"] == 1.0
    assert stepped(law, ref=taut.TaskForce(F_app=np.zeros(6)), F_ext=np.zeros(6))[0].memory["law.lost"] == 0.0


def test_the_bound_of_the_speed_is_the_formula_for_damping_that_is_alike_in_all_directions() -> None:
    """At a rate at which the mass of an arm counts for nothing, and on a gantry of 3 kg, whose axes are on their own."""
    law = L.ForceControl(kfp=0.5, kfi=3.0, kdamp=(60.0, 2.0), e_int_max=(2.0, 1e-9))
    x = taut.snapshot(PANDA, Q)
    linear, angular = law.speed_bound(F_app=[0, 0, -10.0, 0, 0, 0], x=x, rate=1e12)
    assert linear == pytest.approx((1.5 * 10.0 + 3.0 * 2.0) / 60.0)
    assert angular == pytest.approx((1.5 * 10.0 + 3.0 * 2.0) / np.sqrt(60.0 * 2.0))
    gantry = taut.load_arm("gantry3")
    bare = L.ForceControl(feedback="none", kdamp=(60.0, 2.0))
    linear, _ = bare.speed_bound(F_app=[0, 0, 6.0, 0, 0, 0], x=taut.snapshot(gantry, np.zeros(3)), rate=200.0)
    assert linear == pytest.approx(np.sqrt((1.0 / 60.0 + 1.0 / (3.0 * 200.0)) ** 2) * 6.0)


@pytest.mark.parametrize(
    "gains",
    [
        {},
        {"kdamp": [40.0, 40.0, 40.0, 2.0, 2.0, 0.0]},
        {"kdamp": (40.0, 2.0), "kfp": 0.3, "feedback": "joint_torque"},
    ],
)
def test_no_bound_of_the_speed_is_stated_where_none_is_known(gains: Any) -> None:
    x = taut.snapshot(PANDA, Q)
    assert L.ForceControl(**gains).speed_bound(F_app=F_DES, x=x, rate=1000.0) == (np.inf, np.inf)


def test_the_bound_of_the_speed_is_in_the_axes_of_the_gains() -> None:
    x = taut.snapshot(PANDA, Q)
    R = x.T().R
    gains = {"kfp": 0.5, "kfi": 3.0, "kdamp": KDAMP, "feedback": "wrench"}
    tool = L.ForceControl(frame="tool", **gains).speed_bound(F_app=F_DES, x=x, rate=1000.0)
    turned = {**gains, "kdamp": both(R) @ np.diag(KDAMP) @ both(R).T}
    world = L.ForceControl(**turned).speed_bound(F_app=both(R) @ F_DES, x=x, rate=1000.0)
    np.testing.assert_allclose(tool, world, rtol=1e-12)


def test_directions_that_an_arm_never_has_count_for_nothing() -> None:
    arm = taut.load_arm("planar3")
    law = L.ForceControl(kfp=0.5, kfi=5.0, null=None)
    ref = taut.TaskForce(F_app=[3.0, 2.0, 7.0, 0.5, 0.5, 0.4])
    ctrl, _ = stepped(law, arm, ref=ref, F_ext=np.zeros(6))
    J = taut.snapshot(arm, arm.home).J()
    still = ~J.any(axis=1)
    assert still.any()
    assert not ctrl.memory["law.integral.e_int"][still].any()
    assert ctrl.memory["law.integral.e_int"][~still].all()


# -------------------------------------------------------------------- samples


def test_a_chunk_of_forces_goes_straight_between_them_and_rests_outside() -> None:
    ahead = taut.chunk([0.0, 1.0], [taut.TaskForce(F_app=np.zeros(6)), taut.TaskForce(F_app=F_DES, frame="tool")])
    np.testing.assert_allclose(ahead.at(0.25).F_tool, 0.25 * F_DES)
    np.testing.assert_allclose(ahead.at(2.0).F_tool, F_DES)
    assert not ahead.at(0.5).F_world.any()


def test_a_wrench_may_be_that_of_the_environment_on_the_arm() -> None:
    np.testing.assert_array_equal(taut.TaskForce(F_ext=F_DES).F_world, -F_DES)
    assert repr(taut.TaskForce(F_app=[1, 0, 0, 0, 0, 0], frame="tool")) == (
        "TaskForce(F_app=[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], frame='tool')"
    )
    assert repr(taut.TaskForce(F_ext=[0, 0, 0, 0, 0, 1])) == "TaskForce(F_app=[0.0, 0.0, 0.0, 0.0, 0.0, -1.0])"


def test_a_stream_a_hold_and_a_trajectory_of_forces_run() -> None:
    arm = taut.load_arm("gantry3")
    ctrl = taut.compile(L.ForceControl(feedback="none", kdamp=(50.0, 1.0)), arm)
    plant = taut.RigidPlant(arm, friction=None, environment=taut.environments.Spring(stiffness=1000.0))
    press = taut.TaskForce(F_app=[0, 0, 5.0, 0, 0, 0])

    class Ramp:
        def at(self, t: float) -> taut.TaskForce:
            return taut.TaskForce(F_app=[0, 0, 5.0 * min(1.0, t), 0, 0, 0])

    for ref in (press, taut.hold(press), taut.stream(period=0.1, source=lambda x: press), Ramp()):
        out = taut.run(ctrl, plant, ref, duration=3.0)
        assert out.extra["F_ext"][-1, 2] == pytest.approx(-5.0, abs=1e-3)


# -------------------------------------------------------------------- messages


def asked(F: Any = F_DES, **more: Any) -> Any:
    return taut.TaskForce(**({"F_app": F} | more))


MESSAGES: Any = [
    lambda: asked(10.0),
    lambda: asked([10.0, 1.0]),
    lambda: asked([0, 0, np.nan, 0, 0, 0]),
    lambda: asked(F_ext=F_DES),
    lambda: taut.TaskForce(),
    lambda: asked(frame="body"),
    lambda: L.ForceControl(kdamp=(50.0, 1.0)).speed_bound(F_app=F_DES, x=taut.snapshot(PANDA, Q), rate=0.0),
    lambda: L.ForceControl(kdamp=50.0),
    lambda: L.ForceControl(e_int_max=20.0),
    lambda: L.LossOfContact(law=L.ForceControl(), contact=1.0),
    lambda: L.ForceControl(e_int_max=[1.0] * 6),
    lambda: L.ForceControl(kfp=-0.5),
    lambda: L.ForceControl(feedback="motor"),
    lambda: L.ForceControl(feedback="none", kfp=0.5),
    lambda: L.ForceControl(null=L.PID(kp=1.0)),
    lambda: taut.compile(L.ForceControl(kfi=3000.0), PANDA),
    lambda: taut.compile(L.ForceControl(tool="panda_link3"), PANDA),
    lambda: stepped(L.ForceControl(kfp=0.1), F_ext=F_EXT, F_app=F_EXT),
    lambda: stepped(L.ForceControl(kfp=0.1)),
    lambda: stepped(L.ForceControl(kfp=0.1), F_ext=np.full(6, np.nan)),
    lambda: stepped(L.ForceControl(kfp=0.1), ref=taut.JointMotion(q=PANDA.home), F_ext=F_EXT),
    lambda: taut.run(taut.compile(L.ForceControl(kfp=0.1), PANDA), taut.RigidPlant(PANDA), duration=0.1),
]  # fmt: skip


@pytest.mark.parametrize("make", MESSAGES)
def test_bad_input_is_one_sentence(make: Any) -> None:
    with refused(taut.TautError):
        make()
