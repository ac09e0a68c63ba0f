"""dataclasses.replace makes of every law one that differs in what was named, and in nothing else."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.base.fields import Field
from taut.control.combine import law_classes
from taut.control.gains import GainValue
from taut.scenarios.sections import law_of_text

laws = taut.laws
BACK = laws.Integral(anti_windup="back-calculation", tracking=5.0)
JOINT = laws.ComputedTorque(kp=100.0, kd=20.0)
TASK = laws.TaskComputedTorque(kp=(400.0, 100.0), kd=(40.0, 20.0))
TURNED = taut.Pose([0.1, 0.2, 0.3], rpy=[0.1, 0.2, 0.3])
BOARD = taut.Constraint.plane(point=[0.0, 0.0, 0.1], normal=np.array([0.0, 0.0, 2.0]))
HYBRID = laws.HybridMotionForce(constraint=BOARD, motion=TASK, kfi=3.0)
LAWS: dict[str, tuple[taut.Law, dict[str, Any]]] = {
    "PID": (laws.PID(kp=1.0, kd=2.0), {"kp": 3.0}),
    "FeedForward": (laws.FeedForward(), {}),
    "Adaptive": (laws.Adaptive(lam=10.0, k=10.0, gamma=5.0, max_payload=2.0), {"gamma": 2.0}),
    "ComputedTorque": (JOINT, {"kd": 30.0}),
    "GravityPID": (laws.GravityPID(kp=1.0, kd=2.0, integral=BACK), {"integral": laws.Integral(anti_windup="none")}),
    "GravityCompensation": (laws.GravityCompensation(), {}),
    "FrictionCompensation": (laws.FrictionCompensation(at="meas"), {}),
    "Dither": (laws.Dither(amplitude=0.1, frequency=50.0), {"amplitude": 0.2}),
    "Robust": (laws.Robust(lam=10.0, k=10.0, phi=0.1, uncertainty=laws.Uncertainty(links=0.1)), {"phi": 0.2}),
    "DisturbanceRejection": (laws.DisturbanceRejection(), {}),
    "CollisionReflex": (laws.CollisionReflex(), {"gain": 0.5}),
    "MotorSide": (laws.MotorSide(law=JOINT), {"law": laws.PID(kp=2.0, kd=2.0)}),
    "MotorSidePD": (laws.MotorSidePD(stiffness=1000.0, kp=100.0, kd=20.0), {"stiffness": 500.0}),
    "FastTorqueLoop": (laws.FastTorqueLoop(law=JOINT, stiffness=1000.0, bandwidth=200.0), {"bandwidth": 80.0}),
    "JointTorqueFeedback": (laws.JointTorqueFeedback(law=JOINT, inertia=0.1), {"inertia": 0.2}),
    "FullStateFeedback": (
        laws.FullStateFeedback(stiffness=1000.0, feedback=[1.0, 1.0, 1.0, 1.0]),
        {"feedback": [2.0, 1.0, 1.0, 1.0]},
    ),
    "FlexibleJointLinearisation": (
        laws.FlexibleJointLinearisation(stiffness=1000.0, omega=30.0),
        {"omega": 15.0},
    ),
    "VariableStiffness": (
        laws.VariableStiffness(
            springs=taut.drives.AntagonisticSprings(a=40.0, c_min=0.25, c_max=0.75), stiffness=80.0, slew=100.0
        ),
        {"stiffness": 120.0},
    ),
    "RaisedGains": (
        laws.RaisedGains(inner=laws.PID(kp=1.0, kd=2.0), factor=2.0),
        {"inner": laws.PID(kp=2.0, kd=2.0)},
    ),
    "VelocityPI": (laws.VelocityPI(kp=1.0), {"kp": 2.0}),
    "JointPosition": (laws.JointPosition(), {}),
    "ViaJointSpace": (taut.via_joint_space(JOINT), {"inner": laws.PID(kp=2.0, kd=2.0)}),
    "TaskComputedTorque": (TASK, {"kd": (50.0, 20.0)}),
    "TaskVelocity": (laws.TaskVelocity(kp=5.0), {"kp": 6.0}),
    "TaskPosition": (laws.TaskPosition(kp=5.0), {"lead": 0.1}),
    "Impedance": (laws.Impedance(K=(800.0, 30.0), zeta=0.7), {"zeta": 1.0}),
    "Stiffness": (laws.Stiffness(K=(800.0, 30.0)), {"kd": 2.0}),
    "Admittance": (laws.Admittance(inner=TASK, D=(4.0, 0.1), K=(100.0, 5.0), zeta=1.0), {"zeta": 0.5}),
    "HybridMotionForce": (HYBRID, {"kfi": 5.0}),
    "NormalEstimate": (laws.NormalEstimate(law=HYBRID), {"rate": 4.0}),
    "LossOfContact": (laws.LossOfContact(law=HYBRID), {"patience": 0.1}),
    "AppliedWrench": (
        laws.AppliedWrench(law=laws.Impedance(K=(8.0, 1.0), B=(1.0, 0.1)), speed=(0.1, 0.5)),
        {"speed": (0.2, 0.5)},
    ),
    "EnergyTank": (laws.EnergyTank(law=laws.Impedance(K=(8.0, 1.0), B=(1.0, 0.1)), capacity=1.0), {"settle": 0.3}),
    "ForceControl": (laws.ForceControl(kfp=0.5, kfi=3.0), {"kfi": 4.0}),
    "StateFeedback": (laws.StateFeedback(K_q=[[1.0]], K_v=[[2.0]], tau_0=0.0), {"tau_0": 1.0}),
    "ViaMit": (laws.ViaMit(law=laws.PID(kp=1.0, kd=2.0)), {"kp_motor": 0.5}),
    "VirtualWall": (laws.VirtualWall(point=[0, 0, 0.1], normal=[0, 0, 1], K=1000.0), {"K": 500.0}),
    "VirtualGroove": (
        laws.VirtualGroove(point=[0, 0, 0.1], direction=[0, 0, 1], K=1000.0),
        {"K": 500.0},
    ),
    "VirtualBall": (laws.VirtualBall(center=[0, 0, 0.1], radius=0.1, K=1000.0), {"K": 500.0}),
    "Posture": (laws.Posture(), {"kp": 5.0}),
    "LimitAvoidance": (laws.LimitAvoidance(), {}),
    "Manipulability": (laws.Manipulability(), {}),
    "Sum": (laws.GravityCompensation() + TASK, {}),
}


def plain(value: Any) -> Any:
    if isinstance(value, GainValue):
        value = value.as_array()
    return value.tolist() if isinstance(value, np.ndarray) else value


def shown(law: taut.Law) -> dict[str, Any]:
    return {name: plain(value) for name, value in vars(law).items()}


def test_no_law_is_left_out() -> None:
    assert {*LAWS, "SideBySide"} == set(law_classes(laws))  # whose arguments are the names of its laws


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_replaced_in_what_was_named_and_in_nothing_else(name: str) -> None:
    law, change = LAWS[name]
    same, other = dataclasses.replace(law), dataclasses.replace(law, **change)
    assert type(same) is type(other) is type(law)
    assert repr(same) == repr(law)
    assert shown(same) == shown(law)
    assert same.reference is law.reference
    assert same.ignores_reference == law.ignores_reference
    assert list(same.parameters()) == list(law.parameters())
    for field in change:
        assert repr(same) != repr(other), field


SHAPES: dict[str, taut.Law] = {
    "a law in a law in a law": laws.ViaMit(
        law=laws.RaisedGains(inner=laws.GravityPID(kp=[1.0, 2.0], kd=np.eye(2), integral=BACK), factor=2.0),
        kp_motor=[1.0, 2.0],
        kd_motor=0.0,
    ),
    "a sum in a wrapper": laws.ViaMit(law=laws.FeedForward() + laws.PID(kp=3.0), kp_motor=[0.0, 0.0], kd_motor=1.0),
    "side by side": laws.SideBySide(a=(laws.PID(kp=1.0), ["joint1"]), b=laws.Stiffness(K=(8.0, 1.0), tool="it's \"b\"")),
    "intervals": laws.Robust(
        lam=1.0, k=1.0, phi=0.1, uncertainty=laws.Uncertainty(links=[0.1, 0.0], viscous=([0.0, 0.0], [1.0, 2.0]))
    ),
    "coordinates": laws.TaskComputedTorque(kp=3.0, kd=[2.0, 3.0, 1.0], error="coordinates", coordinates=taut.Coordinates.position()),
    "constraints": laws.HybridMotionForce(
        constraint=BOARD + taut.Constraint.hinge(point=[0.0, 0.0, 0.1], axis=[0, 0, 1], T=TURNED), motion=TASK
    ),
    "two frames": laws.HybridMotionForce(
        constraint=taut.Constraint.grasp("left", second="right", T=TURNED), motion=TASK, feedback="joint_torque"
    ),
    "nothing": laws.Impedance(K=(8.0, 1.0), zeta=0.7, null=None),
    "a posture": laws.Impedance(K=np.eye(6), B=np.eye(6), null=laws.Posture(q=[0.1, 0.2], kp=[3.0, 0.0])),
}  # fmt: skip


def formed() -> Iterator[taut.Law]:
    """Each law, and with each of its gains as a number, a vector and a matrix, and as zeros of these shapes."""
    yield from [*SHAPES.values(), *(law for law, _ in LAWS.values())]
    for law, _ in LAWS.values():
        for name, field in law.declared.items():
            forms = [3.0, np.full(2, 3.0), 3.0 * np.eye(2), np.full(6, 3.0), 3.0 * np.eye(6)]
            for form in forms if isinstance(field, Field) else ():
                for value in (form, 0.0 * form):
                    with contextlib.suppress(taut.TautError):  # which this field does not take
                        yield dataclasses.replace(law, **{name: value})


def test_every_law_is_made_again_from_its_text_with_every_shape_of_its_gains() -> None:
    """The text is what a log has of it: paths and shapes of parameters, and exact numbers."""
    count = 0
    for law in formed():
        _, made = law_of_text(repr(law))
        assert repr(made) == repr(law)
        one, other = made.parameters(), law.parameters()
        assert list(one) == list(other)
        for path in one:
            np.testing.assert_array_equal(one[path], other[path], strict=True, err_msg=repr(law))
        count += 1
    assert count > 250


def test_a_part_is_replaced_as_a_whole() -> None:
    held = laws.GravityPID(kp=1.0, kd=2.0, ki=1.0, integral=BACK)
    assert held.parameters()["integral.tracking"] == 5.0
    clamped = dataclasses.replace(held, integral=laws.Integral())
    assert "integral.tracking" not in clamped.parameters()
    for wrong in ({"anti_windup": "back-calculation"}, {"tracking": 4.0}):
        with refused(taut.errors.UsageError):
            laws.Integral(**wrong)  # type: ignore[arg-type]
