"""Friction compensation: its law by hand, never too much where it could drive the arm, and the loops that it leaves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

import taut
from taut import Friction
from taut.arm.friction import FRICTION_FIELDS
from taut.errors import RangeError, UsageError
from taut.laws import PID, ComputedTorque, FrictionCompensation

SAME = 1e-12  # the same formula in another order, relative to the largest torque
FULL = Friction(
    viscous=[0.4, 0.2, 0.1],
    coulomb=[0.7, 0.1, 0.3],
    static=[1.1, 0.4, 0.5],
    stribeck=[0.1, 0.0, 0.3],
    stribeck_shape=[2.0, 2.0, 1.3],
    load_motor=[0.05, 0.02, 0.0],
    load_external=[0.02, 0.1, 0.0],
    load_motor_static=[0.1, 0.02, 0.2],
)
ARM = taut.load_arm("planar3").with_friction(FULL).with_payload(2.0)
LINK = taut.load_arm("one_joint", gravity=[0.0, 0.0, 0.0])  # 0.5 kg m^2
WIDTH = 0.02
STUCK = 1e-15  # [rad] rounding of a joint that sticks


def given_torque(
    arm: taut.Arm, law: taut.Law, q: np.ndarray, v: np.ndarray, ref: taut.JointMotion, engine: str = "float"
) -> np.ndarray:
    return taut.compile(law, arm, engine=engine).step(q, v, ref)  # type: ignore[arg-type]


def by_hand(i: int, v: float, tau: float, at: str) -> float:
    """The law of the docstring for joint i of ARM, whose motion takes the torque tau without friction."""
    f = {name: float(np.asarray(getattr(FULL, name))[i]) for name in FRICTION_FIELDS}
    fall = max(f["stribeck"], 3.0 * WIDTH) if at == "ref" else f["stribeck"]
    s = math.exp(-((abs(v) / fall) ** f["stribeck_shape"])) if fall else 0.0
    load = (f["load_external"] + f["load_motor"]) * abs(tau)
    excess = abs(f["load_external_static"] - f["load_external"] + f["load_motor_static"] - f["load_motor"]) * abs(tau)
    d = f["coulomb"] + s * (f["static"] - f["coulomb"]) + load + s * excess
    return f["viscous"] * v + d * math.tanh(v / WIDTH)


@pytest.mark.parametrize("at", ["ref", "meas"])
@pytest.mark.parametrize("engine", ["float", "native"])
def test_it_is_the_law_of_the_docstring(at: str, engine: str) -> None:
    rng = np.random.default_rng(3)
    for scale in (0.0, 0.005, 0.05, 1.0):
        q, q_des, a = rng.standard_normal((3, 3))
        v, v_des = scale * rng.standard_normal((2, 3))
        law = FrictionCompensation(at=at, width=WIDTH, share=0.8)
        got = given_torque(ARM, law, q, v, taut.JointMotion(q=q_des, v=v_des, a=a), engine)
        x = taut.snapshot(ARM, q_des, v_des) if at == "ref" else taut.snapshot(ARM, q, v)
        tau, at_speed = x.inverse_dynamics(a), v_des if at == "ref" else v
        wanted = [0.8 * by_hand(i, at_speed[i], tau[i], at) for i in range(3)]
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=SAME * max(1.0, np.abs(wanted).max()))


def test_without_static_friction_it_is_what_it_was() -> None:
    arm = taut.load_arm("planar2").with_joints(viscous=[0.3, 0.1], coulomb=[0.5, 0.2])
    v = np.array([0.02, -0.4])
    got = given_torque(arm, FrictionCompensation(), np.zeros(2), np.zeros(2), taut.JointMotion(q=[0.0, 0.0], v=v))
    np.testing.assert_array_equal(got, arm.viscous * v + arm.coulomb * np.tanh(v / 0.01))


@settings(max_examples=150, deadline=None, derandomize=True)
@given(v=st.floats(-2.0, 2.0), stribeck=st.floats(0.0, 1.0), static=st.floats(0.5, 3.0), share=st.floats(0.0, 1.0))
def test_at_the_measured_speed_it_is_never_more_than_the_friction_that_is_there(
    v: float, stribeck: float, static: float, share: float
) -> None:
    friction = Friction(coulomb=0.5, static=static, stribeck=stribeck)
    law = FrictionCompensation(at="meas", share=share)
    ref = taut.JointMotion(q=[0.0], v=[1.0])
    tau = float(given_torque(LINK.with_friction(friction), law, np.zeros(1), np.array([v]), ref)[0])
    fall = math.exp(-((v / stribeck) ** 2)) if stribeck > 1e-6 else 0.0
    assert abs(tau) <= (0.5 + (static - 0.5) * fall) * (1.0 + SAME)
    assert abs(tau) <= static  # the break-away torque
    assert tau * v >= 0.0


@pytest.mark.part(1)
@pytest.mark.parametrize("stribeck", [0.0, 0.2])
def test_along_the_reference_static_friction_is_given_where_it_starts(stribeck: float) -> None:
    arm = LINK.with_friction(Friction(coulomb=0.5, static=1.5, stribeck=stribeck))

    def dry(v: float) -> float:
        ref = taut.JointMotion(q=[0.0], v=[v])
        law = FrictionCompensation(width=0.01)
        return float(given_torque(arm, law, np.zeros(1), np.zeros(1), ref)[0]) - float(arm.viscous[0]) * v

    speeds = np.geomspace(1e-4, 3.0, 200)
    given = np.array([dry(v) for v in speeds])
    assert dry(0.0) == 0.0
    assert given.max() > 0.5 + 0.6 * (1.5 - 0.5)
    assert given.max() <= 1.5
    assert speeds[given.argmax()] < max(0.05, stribeck)
    assert given[-1] == pytest.approx(0.5, abs=1e-9)
    assert dry(-0.015) == -dry(0.015)


class TestTheLoopThatItLeaves:
    """The chapter's link, 0.5 kg m^2, flat."""

    @pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
    def test_of_viscous_friction_the_part_that_is_not_given_damps(self, share: float) -> None:
        """M e_ddot + (kd + (1 - share) b) e_dot + kp e = 0: the logarithmic decrement of a free swing."""
        arm = LINK.with_joints(viscous=0.8, coulomb=0.0)
        law = PID(kp=50.0, kd=0.5) + FrictionCompensation(at="meas", share=share)
        ctrl = taut.compile(law, arm, rate=10000.0)
        run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.0]), duration=3.0, q0=[0.01])
        q = run.q[:, 0]
        tops = [i for i in range(1, len(q) - 1) if q[i - 1] < q[i] >= q[i + 1]]
        period = np.diff(run.t[tops]).mean()
        damping = 2.0 * 0.5 * np.log(q[tops[0]] / q[tops[-1]]) / (period * (len(tops) - 1))
        assert damping == pytest.approx(0.5 + (1.0 - share) * 0.8, rel=0.01)

    def test_of_friction_along_the_reference_nothing_is_left_where_the_joint_follows(self) -> None:
        """Coulomb and viscous friction, a sine that turns: beside the turns the error falls by far."""
        arm = LINK.with_joints(viscous=0.4, coulomb=0.5)
        ref = taut.trajectories.Sine(center=[0.0], amplitude=0.5, frequency=0.5)
        errors = {}
        for name, law in {
            "alone": ComputedTorque(kp=100.0, kd=20.0),
            "compensated": ComputedTorque(kp=100.0, kd=20.0) + FrictionCompensation(width=0.002),
        }.items():
            start = ref.at(0.0)
            ctrl = taut.compile(law, arm, rate=2000.0)
            run = taut.run(ctrl, taut.RigidPlant(arm), ref, duration=6.0, q0=start.q, v0=start.v)
            errors[name] = run.metrics.overall("rms_error")
        assert errors["alone"] > 0.01  # mu / (M kp) alone is 0.01 rad
        assert errors["compensated"] < 0.05 * errors["alone"]

    def test_at_the_measured_speed_a_joint_that_sticks_gets_nothing(self) -> None:
        arm = LINK.with_joints(viscous=0.0, coulomb=0.5)
        law = PID(kp=1.0) + FrictionCompensation(at="meas")
        ref = taut.JointMotion(q=[0.4])
        run = taut.run(taut.compile(law, arm), taut.RigidPlant(arm), ref, duration=0.5)
        assert np.abs(run.q).max() < STUCK  # 0.4 N m of 0.5 N m

    def test_along_the_reference_a_joint_breaks_away_that_feedback_leaves(self) -> None:
        arm = LINK.with_joints(viscous=0.0, coulomb=0.5)
        ref = taut.trajectories.Sine(center=[0.0], amplitude=0.02, frequency=0.5)
        moved = {}
        for share in (0.0, 0.9):
            law = PID(kp=10.0, kd=2.0) + FrictionCompensation(share=share, width=0.002)
            run = taut.run(taut.compile(law, arm), taut.RigidPlant(arm), ref, duration=4.0)
            moved[share] = float(np.ptp(run.q))
        assert moved[0.0] < STUCK
        assert moved[0.9] > 0.01


class TestWhatIsRefused:
    @pytest.mark.parametrize("share", [1.2, [0.5, 1.5]])
    def test_more_than_all_of_it(self, share: float) -> None:
        with refused(RangeError):
            FrictionCompensation(share=share)

    def test_more_than_all_of_it_while_it_runs(self) -> None:
        ctrl = taut.compile(FrictionCompensation(), LINK)
        with refused(RangeError):
            ctrl.parameters["law.share"] = 1.1

    def test_a_point_that_is_none(self) -> None:
        with refused(UsageError):
            FrictionCompensation(at="both")
