"""Bad values and common misuse, at every door of the library: refused at the call, in one sentence that names the thing."""

from __future__ import annotations

import copy
import dataclasses
import math
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.loop import check_fit

ARM = taut.load_arm("planar2")
HOME = taut.JointMotion(q=ARM.home)
ROTATION = np.eye(3)
LIMITED = taut.load_arm("planar2").with_joints(lower=-2.9, upper=2.9)

NAN, INF = math.nan, math.inf
NO_NUMBER: tuple[Any, ...] = ("abc", 1j, [[1.0], [1.0, 2.0]], object(), np.datetime64("2026-01-01"), {"a": 1.0})
NOT_FINITE: tuple[Any, ...] = (NAN, INF, -INF)
VECTOR_2: tuple[Any, ...] = ([NAN, 0.0], [0.0, INF], [1.0, 2.0, 3.0], [[1.0], [2.0]], [], *NO_NUMBER[:3])
VECTOR_3: tuple[Any, ...] = ([NAN, 0.0, 0.0], [0.0, 0.0, -INF], [1.0, 2.0], 1.0, *NO_NUMBER[:3])
GAIN: tuple[Any, ...] = (*NOT_FINITE, -1.0, [1.0, -1.0], [1.0, NAN], [1.0] * 3, np.eye(3), None, *NO_NUMBER)


def controller() -> taut.Controller:
    return taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), ARM, limits=taut.Limits(tau=50.0, tau_dot=1e4))


CTRL = controller()
CTRL.step(ARM.home, [0.0, 0.0], HOME)


class GravityTwice(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=ref.q - x.q, nonlinear=x.h, gravity=x.g)


class GravityOnce(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=ref.q - x.q, gravity=x.g)


class WithGravity(taut.Law):
    """By the recursion, which does not tell that it compensates gravity."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(model=x.inverse_dynamics(ref.a))


class Complex(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=(ref.q - x.q) * (1.0 + 1.0j))


class Remembering(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        self.e_int = ref.q - x.q
        return taut.Torque(P=self.e_int)


COMPENSATION = taut.laws.FrictionCompensation()
RUBBING = ARM.with_friction(taut.Friction(viscous=0.1))
LOOP = taut.Loop(CTRL, taut.RigidPlant(ARM), HOME, duration=0.01)


def simulate(**options: Any) -> Any:
    return taut.run(CTRL, taut.RigidPlant(ARM), HOME, **{"duration": 0.01, **options})


def tick(q: Any = (0.0, 0.0), v: Any = (0.0, 0.0), ref: Any = HOME, **more: Any) -> Any:
    return CTRL.step(q, v, ref, **more)


def gain(law: Any, name: str) -> Callable[[Any], Any]:
    return lambda value: taut.compile(law(**{"kp": 1.0, "kd": 1.0, name: value}), ARM)


def parameter(path: str) -> Callable[[Any], Any]:
    return lambda value: CTRL.parameters.__setitem__(path, value)


def joint_value(name: str) -> Callable[[Any], Any]:
    return lambda value: ARM.with_joints(**{name: value})


def event(path: str) -> Callable[[Any], Any]:
    return lambda value: simulate(events=[taut.Event(t=0.0, set={path: value})])


# What is called; the word that must stand in the message; the values that are refused.
DOORS: list[tuple[str, Callable[[Any], Any], tuple[Any, ...]]] = [
    *(
        (name, gain(law, name), GAIN)
        for law in (taut.laws.PID, taut.laws.ComputedTorque, taut.laws.GravityPID)
        for name in ("kp", "kd", "ki")
    ),
    *((f"law.{name}", parameter(f"law.{name}"), (*NOT_FINITE, -1.0, [1.0, 2.0], np.eye(2))) for name in ("kp", "kd")),
    ("limits.tau", parameter("limits.tau"), ([NAN, 1.0], [1.0, -1.0], [1.0] * 3)),
    ("model.payload.mass", parameter("model.payload.mass"), (*NOT_FINITE, -0.1, [1.0, 2.0], *NO_NUMBER)),
    ("model.payload.com", parameter("model.payload.com"), VECTOR_3),
    ("payload.inertia", parameter("model.payload.inertia"), ([NAN] * 6, [1.0] * 5, [-1.0, 1, 1, 0, 0, 0])),
    ("law.kp", event("law.kp"), (NAN, INF, -1.0, [1.0, 2.0])),
    ("plant.payload.mass", event("plant.payload.mass"), (NAN, INF, -1.0, [1.0, 2.0])),
    ("q", lambda value: tick(q=value), VECTOR_2),
    ("v", lambda value: tick(v=value), VECTOR_2),
    ("q", lambda value: tick(ref=taut.JointMotion(q=value)), VECTOR_2),
    ("v", lambda value: tick(ref=taut.JointMotion(q=[0.0, 0.0], v=value)), VECTOR_2),
    ("a", lambda value: tick(ref=taut.JointMotion(q=[0.0, 0.0], a=value)), VECTOR_2),
    ("F_ext", lambda value: tick(F_ext=value), ([0.0] * 6,)),  # which this law does not use
    (
        "ref",
        lambda value: tick(ref=value),
        (None, 1.0, [0.0, 0.0], taut.trajectories.Cubic(q0=0.0, q1=1.0, duration=1.0)),
    ),
    ("tau_applied", lambda value: CTRL.reset(tau_applied=value), VECTOR_2),
    ("q0", lambda value: simulate(q0=value), VECTOR_2),
    ("v0", lambda value: simulate(v0=value), VECTOR_2),
    ("duration", lambda value: simulate(duration=value), (*NOT_FINITE, 0.0, -1.0, *NO_NUMBER)),
    ("seed", lambda value: simulate(seed=value), (-1, 1.5, "x")),
    ("rate", lambda value: taut.compile(CTRL.law, ARM, rate=value), (*NOT_FINITE, 0.0, -1.0, *NO_NUMBER)),
    ("tau", lambda value: taut.compile(CTRL.law, ARM, limits=taut.Limits(tau=value)), (NAN, 0.0, -1.0, [1.0] * 3)),
    ("tau_dot", lambda value: taut.compile(CTRL.law, ARM, limits=taut.Limits(tau_dot=value)), (NAN, 0.0, [1.0] * 3)),
    ("p", lambda value: taut.Pose(p=value), VECTOR_3),
    ("rpy", lambda value: taut.Pose(rpy=value), VECTOR_3),
    (
        "R",
        lambda value: taut.Pose(R=value),
        (np.diag([1.0, 1.0, -1.0]), 2.0 * ROTATION, NAN * ROTATION, np.eye(2), ROTATION + 0.01, "R"),
    ),
    ("xyzw", lambda value: taut.Pose(xyzw=value), ([0.0] * 4, [0.0, 0.0, 0.0, 2.0], [NAN, 0, 0, 1], [0.0, 0.0, 1.0])),
    ("mass", lambda value: ARM.with_payload(value), (*NOT_FINITE, -1.0, [1.0, 2.0], None, *NO_NUMBER)),
    ("com", lambda value: ARM.with_payload(1.0, com=value), VECTOR_3),
    (
        "inertia",
        lambda value: ARM.with_payload(1.0, inertia=value),
        (-np.eye(3), np.diag([1.0, 1.0, 3.0]), NAN * np.eye(3), np.eye(2), [[1.0, 2, 0], [0, 1, 0], [0, 0, 1]]),
    ),
    ("gravity", lambda value: ARM.with_gravity(value), VECTOR_3),
    ("home", lambda value: taut.load_arm("planar2", home=value), VECTOR_2),
    *(
        (name, joint_value(name), (NAN, -1.0, [1.0] * 3, "x"))
        for name in ("viscous", "coulomb", "rotor_inertia", "effort", "velocity")
    ),
    (
        "resolution",
        lambda value: taut.RigidPlant(
            ARM, sensors=taut.sensors.Sensors(position=taut.sensors.Encoder(resolution=value))
        ),
        (NAN, 0.0, -1.0, [1.0] * 3, [0.0, 0.0], "x"),
    ),
    (
        "noise",
        lambda value: taut.RigidPlant(
            ARM, sensors=taut.sensors.Sensors(velocity=taut.sensors.Tachometer(noise=value))
        ),
        (INF, -1.0, [1.0] * 3, "x"),
    ),
    (
        "range",
        lambda value: taut.sensors.WrenchSensor(range=value),
        (NAN, 0.0, -1.0, 5.0, [1.0] * 3, (1.0, 0.0), "x"),
    ),
    ("range", lambda value: taut.sensors.Accelerometer(range=value), (NAN, 0.0, -1.0, "x")),
    (
        "cutoff",
        lambda value: taut.compile(
            CTRL.law, ARM, sensing=taut.Sensing(velocity=taut.sensors.Difference(cutoff=value))
        ),
        (NAN, INF, 0.0, -1.0, 500.0, [1.0] * 3, "x"),
    ),
    (
        "frequency",
        lambda value: taut.compile(
            CTRL.law, ARM, sensing=taut.Sensing(notch=taut.sensors.Notch(frequency=value, width=1.0))
        ),
        (NAN, INF, 0.0, -1.0, 500.0, [1.0] * 3, [0.0, 0.0], "x"),
    ),
    (
        "position_noise",
        lambda value: taut.compile(
            CTRL.law,
            ARM,
            sensing=taut.Sensing(velocity=taut.sensors.Kalman(acceleration_noise=1.0, position_noise=value)),
        ),
        (NAN, INF, 0.0, -1.0, [1.0] * 3, "x"),
    ),
    (
        "delay",
        lambda value: taut.RigidPlant(ARM, actuation=taut.drives.Actuation(delay=value)),
        (*NOT_FINITE, -1.0, "x"),
    ),
    (
        "bandwidth",
        lambda value: taut.RigidPlant(ARM, actuation=taut.drives.Actuation(bandwidth=value)),
        (NAN, 0.0, -1.0, "x"),
    ),
    ("substeps", lambda value: taut.RigidPlant(ARM, substeps=value), (0, -1, 1.5, NAN, "x")),
    ("t", lambda value: taut.Event(t=value, set={"law.kp": 1.0}), (*NOT_FINITE, -1.0, "x")),
    (
        "duration",
        lambda value: taut.trajectories.Cubic(q0=[0.0], q1=[1.0], duration=value),
        (*NOT_FINITE, 0.0, -1.0, "x"),
    ),
    ("q1", lambda value: taut.trajectories.Quintic(q0=[0.0, 0.0], q1=value, duration=1.0), VECTOR_2[:3]),
    ("frequency", lambda value: taut.trajectories.Sine(center=0.0, amplitude=1.0, frequency=value), (NAN, INF, "x")),
    (
        "times",
        lambda value: taut.trajectories.Samples(times=value, q=[[0.0], [1.0]]),
        ([0.0, 0.0], [1.0, 0.0], [0.0, NAN], [0.0]),
    ),
    ("period", lambda value: taut.stream(period=value), (*NOT_FINITE, 0.0, -1.0, "x")),
]

FIRST = {f"{number:02} {name}": (call, values[0]) for number, (name, call, values) in enumerate(DOORS)}
CASES = [
    pytest.param(name, call, value, id=f"{number} {name} {k}")
    for number, (name, call, values) in enumerate(DOORS)
    for k, value in enumerate(values)
]


def assert_one_sentence(error: taut.TautError) -> str:
    text = str(error)
    assert text
    assert "\n" not in text
    assert "Traceback" not in text
    return text


@pytest.mark.parametrize(("name", "call", "value"), CASES)
def test_a_bad_value_is_refused_at_the_call(name: str, call: Callable[[Any], Any], value: Any) -> None:
    with pytest.raises(taut.TautError) as caught:
        call(value)
    text = assert_one_sentence(caught.value)
    assert name in text
    assert any(word in text for word in ("got", "must", "takes", "needs", "has shape", "violates")), text


@pytest.mark.parametrize("title", FIRST)
def test_the_first_bad_value_is_refused_in_the_words_that_were_read(title: str) -> None:
    call, value = FIRST[title]
    with refused(taut.TautError):
        call(value)


@pytest.mark.bars
def test_bad_values_are_refused_by_the_hundred(bar: Callable[[str, object], None]) -> None:
    stopped = 0
    for _, call, values in DOORS:
        for value in values:
            try:
                call(value)
            except taut.TautError:
                stopped += 1
    bar("row 2: bad values refused at the call", f"{stopped} of {len(CASES)}")
    assert stopped == len(CASES) >= 200


def test_the_running_loop_is_not_touched() -> None:
    """After everything that a controller refuses it goes on exactly as one that was asked nothing."""
    calm, asked = controller(), controller()
    state = np.random.default_rng(0)
    for k, (path, value) in enumerate(refused_by_a_controller()):
        q, v = ARM.home + 0.1 * state.standard_normal(2), state.standard_normal(2)
        np.testing.assert_array_equal(calm.step(q, v, HOME), asked.step(q, v, HOME))
        give = asked.step if path == "step" else asked.parameters.__setitem__
        with pytest.raises(taut.TautError):
            give(*((value, v, HOME) if path == "step" else (path, value)))
        assert calm.ticks == asked.ticks == k + 1
        for name, kept in calm.parameters.items():
            np.testing.assert_array_equal(asked.parameters[name], kept)


def refused_by_a_controller() -> Iterator[tuple[str, Any]]:
    for name, _, values in DOORS:
        if f"model.{name}" in CTRL.parameters or name in CTRL.parameters:
            path = name if name in CTRL.parameters else f"model.{name}"
            yield from ((path, value) for value in values)
    yield from (("step", value) for value in VECTOR_2)


# -------------------------------------------------------------------- misuse: what it is, and what was meant

DEGREES = np.array([90.0, -45.0])
ON_LIMITED = taut.compile(taut.laws.PID(kp=1.0), LIMITED)


def run_limited(**options: Any) -> Any:
    return taut.run(ON_LIMITED, taut.RigidPlant(LIMITED), **{"duration": 0.01, **options})


def fresh() -> taut.Controller:
    return taut.compile(taut.laws.PID(kp=1.0), LIMITED)


def bound(q: Any, ref: Any) -> None:
    k = fresh().bind()
    k.q[:], k.ref.q[:] = q, ref
    k.tick()


MISUSE: dict[str, Callable[[], Any]] = {
    "degrees in q0": lambda: run_limited(q0=DEGREES),
    "degrees in a set-point": lambda: run_limited(ref=taut.JointMotion(q=DEGREES)),
    "degrees in a trajectory": lambda: run_limited(
        ref=taut.trajectories.Cubic(q0=LIMITED.home, q1=DEGREES, duration=1.0), duration=1.0
    ),
    "degrees from a policy": lambda: run_limited(
        ref=taut.stream(period=0.002, source=lambda x: taut.JointMotion(q=DEGREES))
    ),
    "degrees measured": lambda: fresh().step(DEGREES, [0.0, 0.0], HOME),
    "degrees wanted": lambda: fresh().step([0.0, 0.0], [0.0, 0.0], taut.JointMotion(q=DEGREES)),
    "degrees in a bound kernel": lambda: bound(DEGREES, LIMITED.home),
    "degrees wanted of a bound kernel": lambda: bound(LIMITED.home, DEGREES),
    "joint count of the gains": lambda: taut.compile(taut.laws.PID(kp=[1.0] * 7), ARM),
    "joint count of the state": lambda: tick(q=[0.0] * 7),
    "joint count of the plant": lambda: taut.run(CTRL, taut.RigidPlant(taut.load_arm("planar3")), duration=1.0),
    "an arm's name": lambda: taut.load_arm("plannar2"),
    "a file's name": lambda: taut.load_arm("panda.urfd"),
    "a law's name": lambda: taut.laws.ComputedTorqe,
    "a name of another module, in other letters": lambda: taut.laws.LQR,
    "a public name": lambda: taut.RigidPlnat,
    "a gain's name": lambda: taut.laws.PID(kP=1.0),
    "a parameter's path": lambda: CTRL.parameters["law.kP"],
    "a parameter's path to set": lambda: parameter("law.kpp")(1.0),
    "a path in an event": lambda: event("plant.payload.mas")(1.0),
    "a term of a controller": lambda: CTRL.terms["feedforwad"],
    "a term of a run": lambda: simulate().terms["nonlinar"],
    "a further column of a run": lambda: simulate().extra["F_ext"],
    "a metric": lambda: simulate().metrics.overall("rms"),
    "a frame's name": lambda: ARM.frame("tol"),
    "a joint's name": lambda: ARM.joint_index("joint3"),
    "a joint of a subset": lambda: ARM.subset(["joint7"]),
    "an argument of step": lambda: tick(F_ex=1.0),
    "a trajectory for a sample": lambda: tick(ref=taut.trajectories.Cubic(q0=[0.0], q1=[1.0], duration=1.0)),
    "links of an unknown mass": lambda: taut.laws.Uncertainty(links=1.2),
    "payload from a spread": lambda: taut.laws.Uncertainty(payload=(1.0, -1.0)),
    "friction without an interval": lambda: taut.laws.Uncertainty(coulomb=0.3),
    "a class for a law": lambda: taut.compile(taut.laws.PID, ARM),
    "a name for an arm": lambda: taut.compile(CTRL.law, "planar2"),
    "an arm for a plant": lambda: taut.run(CTRL, ARM, duration=1.0),
    "a law for a controller": lambda: taut.run(taut.laws.PID(kp=1.0), taut.RigidPlant(ARM), duration=1.0),
    "gravity twice in a sum": lambda: taut.compile(
        taut.laws.GravityPID(kp=1.0, kd=1.0) + taut.laws.GravityCompensation(), ARM
    ),
    "gravity twice with the plant": lambda: taut.run(
        taut.compile(taut.laws.GravityPID(kp=1.0, kd=1.0), ARM),
        taut.RigidPlant(ARM, adds=("gravity",)),
        duration=0.1,
    ),
    "gravity twice in a law": lambda: taut.compile(GravityTwice(), ARM),
    "gravity twice in a sum with an own law": lambda: taut.compile(GravityOnce() + WithGravity(), ARM),
    "a complex command": lambda: taut.compile(Complex(), ARM),
    "a complex command on floats": lambda: taut.compile(Complex(), ARM, engine="float"),
    "friction of an arm without any": lambda: taut.compile(COMPENSATION, taut.load_arm("so101")),
    "friction twice in a sum": lambda: taut.compile(COMPENSATION + COMPENSATION, RUBBING),
    "a rate in seconds": lambda: taut.compile(CTRL.law, ARM, rate=0.001),
    "a rate in seconds of a wall": lambda: taut.analysis.check_virtual_wall(mass=1.0, rate=0.002),
    "a rate in seconds of a design": lambda: taut.design(taut.laws.PID, ARM, zeta=1.0, omega_n=3.0, rate=0.01),
    "a rate in seconds of error dynamics": lambda: taut.error_dynamics(M=1.0, kp=1.0, kd=1.0, rate=0.01),
    "a run of no period": lambda: simulate(duration=1e-4),
    "a loop of no period": lambda: taut.Loop(CTRL, taut.RigidPlant(ARM), duration=9e-4),
    "a tolerance in percent": lambda: taut.analysis.grade(CTRL.law, CTRL.law, LOOP, tolerance=5),
    "a home in degrees": lambda: taut.load_arm("planar2", home=[90, 45]),
    "a sample by another name": lambda: HOME.theta,
    "a sample, no velocity": lambda: CTRL.step(ARM.home, HOME),
    "memory in a field": lambda: taut.compile(Remembering(), ARM, engine="float"),
    "a tool of the controller alone": lambda: taut.run(
        taut.compile(taut.laws.ForceControl(kfp=0.5, kfi=10.0), taut.load_arm("panda", tool="panda_link5")),
        taut.MujocoPlant(taut.load_arm("panda")),
        taut.TaskForce(F_app=[0.0, 0.0, -10.0, 0.0, 0.0, 0.0]),
        duration=0.1,
    ),
}


@pytest.mark.parametrize("title", MISUSE)
def test_misuse_is_told_with_what_was_meant(title: str) -> None:
    with refused((taut.TautError, AttributeError)) as caught:
        MISUSE[title]()
    assert_one_sentence(caught.value)


@pytest.mark.bars
def test_misuse_is_counted(bar: Callable[[str, object], None]) -> None:
    told = 0
    for call in MISUSE.values():
        try:
            call()
        except (taut.TautError, AttributeError):
            told += 1
    bar("row 15: misuse told with what was meant", f"{told} of {len(MISUSE)}")
    assert told == len(MISUSE)


@pytest.mark.parametrize("q", [[2.9, -2.9], [2.9 + 2.0 * np.pi, 0.0], [0.0, 3.5]])
def test_angles_that_could_be_meant_are_taken(q: list[float]) -> None:
    """Up to a turn beyond the limits: simulations start outside of them, and wrapped angles are a turn off."""
    assert run_limited(q0=q, ref=taut.JointMotion(q=q)).outcome.ok


@pytest.mark.parametrize(
    "law",
    [GravityOnce(), WithGravity(), taut.laws.GravityPID(kp=1.0, kd=1.0) + taut.laws.FrictionCompensation()],
    ids=["x.g", "inverse dynamics", "built in"],
)
@pytest.mark.parametrize("home", [[0.3, -0.2], [0.0, 0.0], [np.pi / 2.0, 0.0], [2.0 * np.pi, -9.0]])
@pytest.mark.parametrize("gravity", [[0.0, -9.81, 0.0], [0.0, 0.0, -9.81], [0.0, 0.0, 0.0]])
def test_a_law_that_adds_gravity_once_is_taken_wherever_home_is(
    law: taut.Law, home: list[float], gravity: list[float]
) -> None:
    arm = dataclasses.replace(RUBBING, home=np.array(home)).with_gravity(gravity)
    assert taut.compile(law, arm, engine="float").arm is arm


def test_a_tool_of_the_same_name_that_stands_elsewhere_is_an_error_of_the_model() -> None:
    arm = taut.load_arm("panda")
    longer = arm.with_tool("panda_hand", taut.Pose(p=[0.0, 0.0, 0.11]))
    believed = arm.with_tool("panda_hand", taut.Pose(p=[0.0, 0.0, 0.10]))
    law = taut.laws.ForceControl(kfp=0.5, kfi=10.0)
    check_fit(taut.compile(law, believed, engine="float").side, taut.MujocoPlant(longer))
    with pytest.raises(taut.errors.MatchError):
        check_fit(taut.compile(law, arm, engine="float").side, taut.MujocoPlant(longer))


def test_one_period_is_a_run() -> None:
    assert simulate(duration=0.001).t.tolist() == [0.0, 0.001]


def test_joints_without_limits_and_sliding_joints_may_be_anywhere() -> None:
    unlimited = ARM.with_joints(lower=-INF, upper=INF)
    assert taut.run(fresh_on(unlimited), taut.RigidPlant(unlimited), q0=[100.0, -100.0], duration=0.01).outcome.ok
    gantry = taut.load_arm("gantry3").with_joints(lower=-0.1, upper=0.1)
    assert taut.run(fresh_on(gantry), taut.RigidPlant(gantry), q0=[50.0, 0.0, 0.0], duration=0.01).outcome.ok


def test_an_arm_that_moves_already_is_not_stopped_by_a_far_angle() -> None:
    ctrl = fresh()
    ctrl.step([0.0, 0.0], [0.0, 0.0], HOME)
    assert np.isfinite(ctrl.step([30.0, 0.0], [0.0, 0.0], HOME)).all()


def fresh_on(arm: taut.Arm) -> taut.Controller:
    return taut.compile(taut.laws.PID(kp=1.0), arm)


def test_results_by_name_are_dicts_that_can_be_copied_and_sent() -> None:
    terms = simulate().terms
    for again in (pickle.loads(pickle.dumps(terms)), copy.deepcopy(terms)):
        assert set(again) == set(terms)
        with refused(taut.errors.UnknownNameError):
            again["nonlinar"]
    assert terms.get("nonlinar") is None
