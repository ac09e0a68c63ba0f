"""What task-space laws refuse, and in which words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut

L = taut.laws
PANDA = taut.load_arm("panda")
T = taut.snapshot(PANDA, PANDA.home).T()
HERE = taut.TaskMotion(pose=T)
Coordinates = taut.Coordinates


class Weight(taut.Law):
    """A law for the free motion that should not be: it adds gravity."""

    ignores_reference = True

    def command(self, x: Any, ref: Any) -> taut.Torque:
        return taut.Torque(gravity=x.g)


class Speed(taut.Law):
    """One that gives no torque."""

    ignores_reference = True

    def command(self, x: Any, ref: Any) -> taut.Velocity:
        return taut.Velocity(P=0.0 * x.q)


def task(**fields: Any) -> taut.Controller:
    law = L.TaskComputedTorque(**{"kp": 100.0, "kd": 20.0, **fields})
    return taut.compile(law, PANDA, engine="float")


def coordinates(function: Any, **more: Any) -> Callable[[], Any]:
    return lambda: task(error="coordinates", coordinates=Coordinates(function=function, **more))


def step(ref: Any) -> Any:
    return task().step(PANDA.home, np.zeros(7), ref)


CASES: list[tuple[Callable[[], Any], type[Exception]]] = [
    (lambda: task(tool="panda_hand_tpc"), taut.errors.UnknownNameError),
    (lambda: task(tool="nope"), taut.errors.UnknownNameError),
    (lambda: task(tool=3), taut.errors.UnknownNameError),
    (lambda: task(null=L.Manipulability(tool="nope")), taut.errors.UnknownNameError),
    (lambda: task(kp=[1.0, 2.0, 3.0]), taut.errors.ShapeError),
    (lambda: task(kd=np.eye(7)), taut.errors.ShapeError),
    (lambda: task(kp=(100.0, -1.0)), taut.errors.RangeError),
    (lambda: task(ki=np.nan), taut.errors.RangeError),
    (lambda: task(kp=-np.eye(6)), taut.errors.RangeError),
    (lambda: task(error="twist"), taut.errors.UsageError),
    (lambda: task(error="coordinates"), taut.errors.UsageError),
    (lambda: task(coordinates=Coordinates.position()), taut.errors.UsageError),
    (lambda: task(error="coordinates", coordinates=lambda T: T.p), taut.errors.UsageError),
    (coordinates(3), taut.errors.UsageError),
    (coordinates(lambda T: T.p[0]), taut.errors.ShapeError),
    (coordinates(lambda T: [*T.p, *T.p, 1.0]), taut.errors.ShapeError),
    (coordinates(lambda T: [T.p[0], [1.0]]), taut.errors.ShapeError),
    (coordinates(lambda T: T.p, angles=(3,)), taut.errors.ShapeError),
    (coordinates(lambda T: T.p, angles=(1.5,)), taut.errors.UsageError),
    (coordinates(lambda T: T.p, angles=1), taut.errors.UsageError),
    (lambda: task(error="coordinates", coordinates=Coordinates.position(), kp=(100.0, 50.0)), taut.errors.ShapeError),
    (
        lambda: task(error="coordinates", coordinates=Coordinates.position(), error_max=(0.1, 0.1)),
        taut.errors.UsageError,
    ),
    (lambda: task(error_max=0.1), taut.errors.ShapeError),
    (lambda: task(error_max=np.eye(2)), taut.errors.ShapeError),
    (lambda: task(error_max=(0.1, 0.0)), taut.errors.RangeError),
    (lambda: task(error_max=(0.1, 0.1)).parameters.__setitem__("law.error_max", (0.0, 0.1)), taut.errors.RangeError),
    (lambda: task(null=L.Posture), taut.errors.UsageError),
    (lambda: task(null=L.PID(kp=1.0, kd=1.0)), taut.errors.UsageError),
    (lambda: task(null=Weight()), taut.errors.UsageError),
    (lambda: task(null=L.GravityCompensation()), taut.errors.UsageError),
    (lambda: task(null=Speed()), taut.errors.UsageError),
    (
        lambda: taut.compile(L.TaskComputedTorque(kp=1.0, kd=1.0, null=L.Posture(kp=2.0)), taut.load_arm("ur10")),
        taut.errors.MatchError,
    ),
    (
        lambda: taut.compile(L.Impedance(K=(1.0, 1.0), zeta=1.0, null=L.Posture()), taut.load_arm("planar3")),
        taut.errors.MatchError,
    ),
    (lambda: task(null=L.Posture(q=[0.0, 0.0])), taut.errors.ShapeError),
    (lambda: L.Posture(q=[0.0, np.nan]), taut.errors.RangeError),
    (lambda: L.LimitAvoidance(margin=np.eye(7)), taut.errors.ShapeError),
    (lambda: L.LimitAvoidance(margin=0.0), taut.errors.RangeError),
    (lambda: L.Manipulability(most=np.eye(7)), taut.errors.ShapeError),
    (lambda: taut.compile(L.Manipulability(), taut.load_arm("planar3")), taut.errors.UsageError),
    (
        lambda: task(integral=taut.laws.Integral(anti_windup="back-calculation", tracking=1e5), ki=1.0),
        taut.errors.RangeError,
    ),
    (lambda: step(taut.JointMotion(q=PANDA.home)), taut.errors.UsageError),
    (lambda: taut.TaskMotion(pose=np.eye(4)), taut.errors.UsageError),
    (lambda: taut.TaskMotion(pose=taut.Pose([0.0, np.nan, 0.0])), taut.errors.RangeError),
    (lambda: taut.TaskMotion(pose=taut.Pose([0.0, 0.0, 0.0], xyzw=[0.0, 0.0, 0.0, 1.1])), taut.errors.RangeError),
    (lambda: taut.TaskMotion(pose=T, twist=[0.0, 0.0, 0.0]), taut.errors.ShapeError),
    (lambda: taut.TaskMotion(pose=T, acceleration=[np.inf] * 6), taut.errors.RangeError),
    (lambda: taut.TaskMotion(pose=T, frame="base"), taut.errors.UsageError),
]


@pytest.mark.parametrize(("act", "kind"), CASES, ids=range(len(CASES)))
def test_is_said_in_one_sentence(act: Callable[[], Any], kind: type[Exception]) -> None:
    with refused(kind) as caught:
        act()
    assert isinstance(caught.value, taut.TautError)


def test_a_goal_where_coordinates_are_singular_is_refused_and_costs_nothing() -> None:
    coordinates = Coordinates.position_and_rpy()
    pose = taut.Pose(T.p, R=np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
    ctrl = taut.compile(L.TaskComputedTorque(kp=100.0, kd=20.0, error="coordinates", coordinates=coordinates), PANDA)
    with refused(taut.errors.NumericalError):
        ctrl.step(PANDA.home, np.zeros(7), taut.TaskMotion(pose=pose))
    assert np.isfinite(ctrl.step(PANDA.home, np.zeros(7), HERE)).all()


def test_two_coordinates_take_one_gain_each() -> None:
    """A pair is (linear, angular) for six entries only."""
    flat = Coordinates(function=lambda T: T.p[:2])
    law = L.TaskComputedTorque(kp=(100.0, 50.0), kd=(20.0, 14.0), error="coordinates", coordinates=flat)
    assert law.parameters()["kp"].tolist() == [100.0, 50.0]
    ctrl = taut.compile(law, PANDA, engine="float")
    ctrl.parameters["law.kp"] = (80.0, 40.0)
    assert ctrl.parameters["law.kp"].tolist() == [80.0, 40.0]
    pair = taut.compile(L.TaskComputedTorque(kp=(100.0, 50.0), kd=20.0), PANDA, engine="float")
    assert pair.parameters["law.kp"].tolist() == [100.0] * 3 + [50.0] * 3
    pair.parameters["law.kp"] = (80.0, 40.0)
    assert pair.parameters["law.kp"].tolist() == [80.0] * 3 + [40.0] * 3
