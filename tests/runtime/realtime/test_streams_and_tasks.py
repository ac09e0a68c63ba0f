"""References of a robot's loop: streams, chunks, sources that fail, and tasks of phases in contact."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refusals import refused
from test_fault_table import stated
from test_robot import compiled, limits, patient
from virtual_robot import Setup, VirtualRobot

import taut
from taut.robots import Robot, RobotError
from taut.runtime.realtime import sets
from taut.runtime.realtime.feeding import Feeder, references_of

ARM = taut.load_arm("planar2")
L = taut.laws
DRIFT = np.array([0.05, 0.0])
SOFT = L.ComputedTorque(kp=100.0, kd=20.0)


@pytest.fixture(scope="module")
def plant() -> Iterator[Robot]:
    with patient(taut.connect(taut.RigidPlant(ARM), limits=limits())) as robot:
        yield robot


@pytest.fixture
def robot(plant: Robot) -> Iterator[Robot]:
    yield plant
    plant.recover()


def test_a_program_streams_samples_and_chunks_and_stops(robot: Robot) -> None:
    here = robot.q
    robot.start(compiled(robot, SOFT), taut.stream(period=0.2))
    with refused(taut.errors.UsageError):
        robot.stream(period=0.1)
    send = robot.stream(period=0.2)
    robot.wait(0.1)  # nothing was sent yet: it holds
    for k in range(6):
        send(taut.JointMotion(q=here + 0.005 * k))
        robot.wait(0.03)
    send(taut.chunk([0.0, 0.1], [here + 0.03, here + DRIFT]))
    for wrong in (
        [0.1, 0.2],
        taut.JointMotion(q=[0.1]),
        taut.TaskMotion(pose=taut.Pose([0.0, 0.0, 0.0])),
        taut.JointMotion(q=here + 1.5),
        taut.chunk([0.0, 0.1, 0.101], [here, here, here + 1.5]),
    ):
        with refused(taut.TautError):
            send(wrong)  # type: ignore[arg-type]
    with pytest.raises(RobotError) as found:
        robot.wait(2.0)
    assert found.value.fault.name == "stream_stopped"
    run = found.value.run
    q, age = run.extra["ref.q"], run.extra["signal.age"]
    assert {*np.round((q[:, 0] - here[0]) / 0.005, 6)} >= {0.0, 1.0, 2.0, 3.0, 4.0, 5.0}
    np.testing.assert_allclose(q[-1], here + DRIFT, atol=1e-12)  # the chunk was followed to its end
    assert len(np.unique(q[:, 0])) > 30
    held = age > 0.4
    np.testing.assert_array_equal(run.reference.v[held], 0.0)
    k = int(np.argmax(run.extra["safe.fault"] > 0))
    assert age[k - 1] <= 0.6 < age[k]
    with pytest.raises(RobotError):
        send(taut.JointMotion(q=here))
    with refused(taut.errors.UsageError):
        robot.recover()
        robot.start(compiled(robot, SOFT))
        send(taut.JointMotion(q=here))


class Fed:
    """A law on a virtual robot, fed as its own thread would, between two ticks."""

    def __init__(self, stream: taut.trajectories.Steady, monkeypatch: pytest.MonkeyPatch) -> None:
        of = Setup(taut.compile(SOFT, ARM, rate=1000.0), stated(ARM))
        self.robot = VirtualRobot(of)
        clock = SimpleNamespace(monotonic_ns=lambda: self.robot.clock.ns)
        monkeypatch.setattr(sets, "time", clock)  # a sample's age is that of the virtual clock
        references = references_of(of.ctrl, stream, ARM.home, None)
        self.feeder = Feeder(self.robot.start(references=references), references)

    def run(self, ticks: int) -> None:
        for _ in range(ticks):
            self.robot.run(1)
            self.feeder.step()


def test_a_source_is_asked_each_period_with_what_was_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, here = list[tuple[float, Any, Any]](), ARM.home

    def source(x: taut.Snapshot) -> Any:
        asked.append((round(float(x.t), 6), x.q.copy(), x.v.copy()))
        if len(asked) == 5:
            fed.robot.run(30)  # slow once
        return taut.chunk([0.0, 0.06], [here + 0.002 * len(asked), here + 0.002 * (len(asked) + 3)])

    fed = Fed(taut.stream(period=0.02, source=source, blend=0.01), monkeypatch)
    fed.run(300)
    times = [t for t, _, _ in asked]
    assert times == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08, 0.111, *(0.02 * k for k in range(6, 17))])
    q, v, ref = (fed.robot.rows(name) for name in ("q", "v", "ref.q"))
    for t, q_seen, v_seen in asked:
        np.testing.assert_array_equal(q_seen, q[round(1000 * t)])
        np.testing.assert_array_equal(v_seen, v[round(1000 * t)])
    steps = np.abs(np.diff(ref, axis=0))[2:]
    assert steps[:80].max() < 0.0006  # blended: an answer 0.002 away comes in within 10 ms
    np.testing.assert_allclose(ref[39], here + 0.002 * 2 + 0.1 * 0.019, atol=1e-9)  # the second chunk, 19 ms old
    assert fed.robot.acting.fault() is None


@pytest.mark.parametrize("failure", ["raises", "gives a number", "gives NaN"])
def test_a_source_that_fails_ends_in_a_stop(failure: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def source(x: taut.Snapshot) -> Any:
        if x.t < 0.1:
            return taut.JointMotion(q=ARM.home)
        if failure == "raises":
            raise ZeroDivisionError("a bug in the policy")
        return 3.0 if failure == "gives a number" else taut.JointMotion(q=[np.nan, 0.0])

    fed = Fed(taut.stream(period=0.02, source=source), monkeypatch)
    fed.run(200)
    assert fed.feeder.error is not None
    with refused(taut.TautError):
        raise fed.feeder.error
    fault = fed.robot.acting.fault()
    assert fault is not None
    assert fault.name == "stream_stopped"
    assert fault.tick - fed.robot._began in (140, 141)  # the last answer at 80 ms, and three periods


def test_an_arm_is_held_and_another_law_starts_behind_a_source_that_failed(robot: Robot) -> None:
    ctrl = taut.compile(SOFT, ARM, rate=robot.rate, adds=robot.adds)
    robot.start(ctrl, taut.stream(period=2.0, source=lambda _: 1 / 0))
    with pytest.raises(taut.errors.UsageError, match="ZeroDivisionError"):
        robot.wait(2.0)
    robot.hold()
    robot.start(ctrl)
    robot.wait(0.1)
    robot.stop()


@pytest.mark.part(1)
def test_a_task_approaches_presses_and_retreats(robot: Robot) -> None:
    """Against a rigid wall; each path is made where its phase begins, the second one from a stream's source."""
    at = np.asarray(taut.snapshot(ARM, ARM.home).T().p) + np.array([0.01, 0.0, 0.0])
    wall = taut.Constraint.plane(point=at, normal=[-1.0, 0.0, 0.0])
    plant = taut.RigidPlant(ARM, contact=taut.RigidContact(constraint=wall))
    begun = dict[str, Any]()

    def to(name: str, change: Any) -> Any:
        def path(x: taut.Snapshot) -> Any:
            begun[name] = x.q.copy()
            return taut.trajectories.Quintic(q0=x.q, q1=x.q + change, duration=0.6)

        return path

    def deeper(x: taut.Snapshot) -> taut.JointMotion:
        return taut.JointMotion(q=begun["approach"] + [-0.06, -0.02])

    stiff = L.GravityPID(kp=200.0, kd=20.0)
    touch = taut.guards.lasting(lambda x: taut.guards.contact(x, 1.0), ticks=2)
    task = [
        taut.Phase(stiff, to("approach", [-0.05, -0.05]), name="approach", until=touch, timeout=2.0),
        taut.Phase(
            L.GravityPID(kp=100.0, kd=15.0),
            taut.stream(period=0.2, source=deeper),
            name="press",
            until=lambda x: x.elapsed > 0.2,
        ),
        taut.Phase(stiff, to("retreat", [0.05, 0.05]), name="retreat", until=lambda x: x.elapsed > 0.7),
        taut.Phase(SOFT, name="rest"),
    ]
    with patient(taut.connect(plant, limits=limits())) as pressing:
        ctrl = compiled(pressing, task, limits=taut.Limits(blend=0.02))
        pressing.start(ctrl)
        pressing.wait(1.9)
        run = pressing.stop()
    phase, force = run.extra["phase"], np.linalg.norm(run.extra["F_ext"][:, :3], axis=1)
    assert [int(k) for k in np.unique(phase)] == [0, 1, 2, 3]
    assert (np.diff(phase) >= 0.0).all()
    assert force[phase == 1].max() > 3.0
    assert not force[phase == 3].any()
    np.testing.assert_allclose(run.reference.q[phase == 2][-1], begun["retreat"] + 0.05, atol=1e-9)
    assert not run.extra["safe.fault"].any()


@pytest.mark.parametrize("ahead", [0.0, 0.3])
def test_a_phase_in_another_space_begins_where_the_one_before_ended(ahead: float) -> None:
    """Only what a phase follows may not jump: joints are where the task began in the table of the second one."""
    goal = ARM.home + np.array([-0.3, 0.2])
    T = taut.snapshot(ARM, goal).T()
    line = taut.TaskMotion(pose=taut.Pose.of(T.R, T.p + ahead * np.eye(3)[2]))
    task = [
        taut.Phase(
            SOFT, taut.trajectories.Quintic(q0=ARM.home, q1=goal, duration=0.8), name="move",
            until=lambda x: x.elapsed > 0.9,
        ),
        taut.Phase(L.Impedance(K=(500.0, 10.0), zeta=1.0), line, name="stay", timeout=0.5),
    ]  # fmt: skip
    of = Setup(taut.compile(task, ARM, rate=1000.0), stated(ARM))
    virtual = VirtualRobot(of)
    virtual.start(references=references_of(of.ctrl, None, ARM.home, None))
    virtual.run(1200)
    fault = virtual.acting.fault()
    assert [int(k) for k in np.unique(virtual.rows("phase"))] == [0, 1]
    assert (fault.name if fault else "") == ("reference_jump" if ahead else "")


def test_references_that_do_not_fit(robot: Robot) -> None:
    ctrl = compiled(robot, SOFT)
    sine = taut.trajectories.Sine(center=robot.q, amplitude=[0.1, 0.1], frequency=1.0)
    for ref, more in (
        (sine, {}),
        (sine, {"duration": 1e9}),
        (taut.stream(period=0.02, blend=0.1), {}),
        (taut.TaskMotion(pose=taut.Pose([0.3, 0.0, 0.0])), {}),
        (3.0, {}),
    ):
        with refused(taut.TautError):
            robot.start(ctrl, ref, **more)  # type: ignore[arg-type]
    task = compiled(robot, [taut.Phase(SOFT, name="one", until=lambda x: x.elapsed > 0.1)])
    with refused(taut.TautError):
        robot.start(task, taut.hold())
    assert robot.status.state == "idle"
