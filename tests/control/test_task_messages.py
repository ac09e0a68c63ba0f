"""What task-space laws refuse, and in which words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

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


CASES: list[tuple[Callable[[], Any], type[Exception], str]] = [
    (
        lambda: task(tool="panda_hand_tpc"),
        taut.errors.UnknownNameError,
        "the arm has no frame 'panda_hand_tpc'; did you mean 'panda_hand_tcp' or 'panda_hand'? "
        "(13 frames: taut check MODEL lists them)",
    ),
    (lambda: task(tool="nope"), taut.errors.UnknownNameError, "the arm has no frame 'nope'; it has 'panda_link0', "),
    (lambda: task(tool=3), taut.errors.UnknownNameError, "a frame of the arm is named by a text; got 3"),
    (
        lambda: task(null=L.Manipulability(tool="nope")),
        taut.errors.UnknownNameError,
        "the arm has no frame 'nope'; it has 'panda_link0', ",
    ),
    (
        lambda: task(kp=[1.0, 2.0, 3.0]),
        taut.errors.ShapeError,
        "kp must be a number, (linear, angular), (6,) or (6, 6) [1/s^2]; got shape (3,)",
    ),
    (
        lambda: task(kd=np.eye(7)),
        taut.errors.ShapeError,
        "kd must be a number, (linear, angular), (6,) or (6, 6) [1/s]; got shape (7, 7)",
    ),
    (lambda: task(kp=(100.0, -1.0)), taut.errors.RangeError, "kp[1] must be >= 0 [1/s^2]; got -1.0"),
    (lambda: task(ki=np.nan), taut.errors.RangeError, "ki must be finite [1/s^3]; got nan"),
    (
        lambda: task(kp=-np.eye(6)),
        taut.errors.RangeError,
        "kp must be positive semidefinite [1/s^2]; its smallest eigenvalue is -1",
    ),
    (
        lambda: task(error="twist"),
        taut.errors.UsageError,
        "error must be one of 'decoupled', 'body', 'space', 'coordinates'; got 'twist'",
    ),
    (
        lambda: task(error="coordinates"),
        taut.errors.UsageError,
        "coordinates is for error 'coordinates', which needs it; give both or neither",
    ),
    (
        lambda: task(coordinates=Coordinates.position()),
        taut.errors.UsageError,
        "coordinates is for error 'coordinates', which needs it; give both or neither",
    ),
    (
        lambda: task(error="coordinates", coordinates=lambda T: T.p),
        taut.errors.UsageError,
        "coordinates must be a Coordinates; got function",
    ),
    (
        coordinates(3),
        taut.errors.UsageError,
        "function must be a function; got 3",
    ),
    (
        coordinates(lambda T: T.p[0]),
        taut.errors.ShapeError,
        "function must give 1 to 6 numbers, (k,); it gives shape ()",
    ),
    (
        coordinates(lambda T: [*T.p, *T.p, 1.0]),
        taut.errors.ShapeError,
        "function must give 1 to 6 numbers, (k,); it gives shape (7,)",
    ),
    (
        coordinates(lambda T: [T.p[0], [1.0]]),
        taut.errors.ShapeError,
        "function must give 1 to 6 numbers, (k,); it gives shape ()",
    ),
    (
        coordinates(lambda T: T.p, angles=(3,)),
        taut.errors.ShapeError,
        "angles must be entries 0 to 2; got (3,)",
    ),
    (
        coordinates(lambda T: T.p, angles=(1.5,)),
        taut.errors.UsageError,
        "angles must be a tuple of entries, such as (2,); got (1.5,)",
    ),
    (
        coordinates(lambda T: T.p, angles=1),
        taut.errors.UsageError,
        "angles must be a tuple of entries, such as (2,); got 1",
    ),
    (
        lambda: task(error="coordinates", coordinates=Coordinates.position(), kp=(100.0, 50.0)),
        taut.errors.ShapeError,
        "kp must be a number, (3,) or (3, 3) [1/s^2]; got shape (2,)",
    ),
    (
        lambda: task(error="coordinates", coordinates=Coordinates.position(), error_max=(0.1, 0.1)),
        taut.errors.UsageError,
        "error_max bounds the errors of a pose, and 'coordinates' has others; leave it out",
    ),
    (
        lambda: task(error_max=0.1),
        taut.errors.ShapeError,
        "error_max must be (linear, angular) [m, rad]; got 0.1 alone",
    ),
    (
        lambda: task(error_max=np.eye(2)),
        taut.errors.ShapeError,
        "error_max must be (linear, angular) [m, rad]; got shape (2, 2)",
    ),
    (
        lambda: task(error_max=(0.1, 0.0)),
        taut.errors.RangeError,
        "error_max[1] must be > 0 [m, rad]; got 0.0",
    ),
    (
        lambda: task(error_max=(0.1, 0.1)).parameters.__setitem__("law.error_max", (0.0, 0.1)),
        taut.errors.RangeError,
        "law.error_max[0] must be > 0 [m, rad]; got 0.0",
    ),
    (
        lambda: task(null=L.Posture),
        taut.errors.UsageError,
        "null must be a Law; got <class 'taut.control.laws.null_space.Posture'>",
    ),
    (
        lambda: task(null=L.PID(kp=1.0, kd=1.0)),
        taut.errors.UsageError,
        "null must be a law that follows no reference, such as taut.laws.Posture(); PID follows a JointMotion",
    ),
    (
        lambda: task(null=Weight()),
        taut.errors.UsageError,
        "null: Weight compensates gravity, which the law around it adds already; use a law without, such as "
        "taut.laws.Posture()",
    ),
    (
        lambda: task(null=L.GravityCompensation()),
        taut.errors.UsageError,
        "null: GravityCompensation compensates gravity, which the law around it adds already; use a law without, "
        "such as taut.laws.Posture()",
    ),
    (
        lambda: task(null=Speed()),
        taut.errors.UsageError,
        "null must be a law that gives a torque, and Speed gives a velocity",
    ),
    (
        lambda: taut.compile(L.TaskComputedTorque(kp=1.0, kd=1.0, null=L.Posture(kp=2.0)), taut.load_arm("ur10")),
        taut.errors.MatchError,
        "null=Posture(...) is for motion that the task leaves free, and with 6 joints 'ur10' has none beside 6 "
        "directions; leave null out",
    ),
    (
        lambda: taut.compile(L.Impedance(K=(1.0, 1.0), zeta=1.0, null=L.Posture()), taut.load_arm("planar3")),
        taut.errors.MatchError,
        "null=Posture(...) is for motion that the task leaves free, and with 3 joints 'planar3' has none beside 6 "
        "directions; leave null out",
    ),
    (
        lambda: task(null=L.Posture(q=[0.0, 0.0])),
        taut.errors.ShapeError,
        "null.q must be a number or (7,) [rad | m] for 7 joints; got shape (2,)",
    ),
    (lambda: L.Posture(q=[0.0, np.nan]), taut.errors.RangeError, "q[1] must be finite [rad | m]; got nan"),
    (
        lambda: L.LimitAvoidance(margin=np.eye(7)),
        taut.errors.ShapeError,
        "margin must be a number or (n,) [rad | m]; got shape (7, 7)",
    ),
    (lambda: L.LimitAvoidance(margin=0.0), taut.errors.RangeError, "margin must be > 0 [rad | m]; got 0.0"),
    (
        lambda: L.Manipulability(most=np.eye(7)),
        taut.errors.ShapeError,
        "most must be a number or (n,) [1/rad | 1/m]; got shape (7, 7)",
    ),
    (
        lambda: taut.compile(L.Manipulability(), taut.load_arm("planar3")),
        taut.errors.UsageError,
        "Manipulability is for arms of 6 joints and more; 'planar3' has 3, and its measure is zero",
    ),
    (
        lambda: task(integral=taut.laws.Integral(anti_windup="back-calculation", tracking=1e5), ki=1.0),
        taut.errors.RangeError,
        "tracking must be <= 1000 [1/s], or the integral oscillates; got 100000",
    ),
    (
        lambda: step(taut.JointMotion(q=PANDA.home)),
        taut.errors.UsageError,
        "step needs ref, a taut.TaskMotion; got JointMotion",
    ),
    (
        lambda: taut.TaskMotion(pose=np.eye(4)),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "ref.pose must be a taut.Pose; got ndarray",
    ),
    (
        lambda: taut.TaskMotion(pose=taut.Pose([0.0, np.nan, 0.0])),
        taut.errors.RangeError,
        "p[1] must be finite [m]; got nan",
    ),
    (
        lambda: taut.TaskMotion(pose=taut.Pose([0.0, 0.0, 0.0], xyzw=[0.0, 0.0, 0.0, 1.1])),
        taut.errors.RangeError,
        "xyzw must have length 1; its length is 1.1; divide it by its length",
    ),
    (
        lambda: taut.TaskMotion(pose=T, twist=[0.0, 0.0, 0.0]),
        taut.errors.ShapeError,
        "ref.twist must have shape (6,) [m/s, rad/s]; got shape (3,)",
    ),
    (
        lambda: taut.TaskMotion(pose=T, acceleration=[np.inf] * 6),
        taut.errors.RangeError,
        "ref.acceleration[0] must be finite; got inf",
    ),
    (
        lambda: taut.TaskMotion(pose=T, frame="base"),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "frame must be one of 'world', 'tool'; got 'base'",
    ),
]


@pytest.mark.parametrize(("act", "kind", "text"), CASES, ids=[text[:60] for _, _, text in CASES])
def test_is_said_in_one_sentence(act: Callable[[], Any], kind: type[Exception], text: str) -> None:
    with pytest.raises(kind) as caught:
        act()
    assert str(caught.value).startswith(text) if text.endswith(", ") else str(caught.value) == text
    assert isinstance(caught.value, taut.TautError)


def test_a_goal_where_coordinates_are_singular_is_refused_and_costs_nothing() -> None:
    coordinates = Coordinates.position_and_rpy()
    pose = taut.Pose(T.p, R=np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
    ctrl = taut.compile(L.TaskComputedTorque(kp=100.0, kd=20.0, error="coordinates", coordinates=coordinates), PANDA)
    with pytest.raises(taut.errors.NumericalError, match="gives numbers that are not finite in tick 0"):
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
