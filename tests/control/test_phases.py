"""Tasks: which phase acts, what starts with it, and what is refused."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest
from refusals import refused

import taut
from taut.control.tasks.task import Task

PLANAR = taut.load_arm("planar3")
REST = np.array([0.5, 0.8, 0.6])
PD = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
PID = taut.laws.PID(kp=50.0, kd=10.0, ki=400.0)
Q = taut.JointMotion(q=REST)


class Spring(taut.Law):
    """A law that is there to press.

    Law:          tau = kp e
    Closed loop:  M a + h = kp e
    """

    needs_contact: ClassVar[bool] = True
    kp: taut.Gain

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=self.kp @ (ref.q - x.q))


class Rooted(taut.Law):
    """A law that is NaN where the first joint is beyond its reference.

    Law:          tau = sqrt(q_des - q)
    Closed loop:  none
    """

    e_int: taut.Memory = taut.Memory(0.0)

    def command(
        self, x: taut.Snapshot, ref: taut.JointMotion, memory: Any, dt: float
    ) -> tuple[taut.Torque, dict[str, Any]]:
        root = taut.math.sqrt(ref.q - x.q)
        return taut.Torque(P=root), {"e_int": memory.e_int + root}


def steps(ctrl: taut.Controller, ticks: int, q: np.ndarray = REST, **more: Any) -> list[str]:
    """The phase of each of some ticks at one state."""
    out = []
    for _ in range(ticks):
        out.append(ctrl.phase)
        ctrl.step(q, np.zeros(3), **more)
    return out


# -------------------------------------------------------------------- which phase acts


@pytest.mark.parametrize("engine", ["native", "float"])
def test_until_moves_on_unless_and_timeout_go_elsewhere(engine: Any) -> None:
    task = [
        taut.Phase(PD, name="a", until=lambda x: x.q[0] > 1.0, unless=lambda x: x.q[1] > 1.0, timeout=0.03),
        taut.Phase(PID, name="b", timeout=0.02, otherwise="c"),
        taut.Phase(PD, name="c", until=lambda x: x.q[2] > 1.0, unless=lambda x: x.q[2] > 1.0, otherwise=1),
    ]
    ctrl = taut.compile(task, PLANAR, rate=100.0, engine=engine)
    assert steps(ctrl, 5) == ["a", "a", "a", "stop", "stop"]  # three ticks of 0.01 s
    ctrl.reset()
    assert steps(ctrl, 2, np.array([0.0, 1.1, 0.0])) == ["a", "stop"]
    ctrl.reset()
    assert steps(ctrl, 1, np.array([1.1, 0.0, 0.0])) == ["a"]
    assert steps(ctrl, 2) == ["b", "b"]
    assert ctrl.phase == "c"
    assert steps(ctrl, 2, np.array([0.0, 0.0, 1.1])) == ["c", "b"]  # unless comes before until


def test_then_makes_a_loop_and_a_phase_is_entered_afresh() -> None:
    task = [
        taut.Phase(PID, Q, name="a", until=lambda x: x.elapsed > 0.015),
        taut.Phase(PD, name="b", until=lambda x: x.elapsed > 0.005, then="a"),
    ]
    ctrl = taut.compile(task, PLANAR, rate=100.0)
    seen = []
    for _ in range(8):
        at = ctrl.phase
        ctrl.step(REST - 0.1, np.zeros(3))
        seen.append((at, round(float(ctrl.terms["I"][0]), 9)))
    i = 400.0 * 0.1 * 0.01
    # The integral counts from zero in each visit, and is nothing while another law acts.
    visit = [("a", i), ("a", 2 * i), ("a", 3 * i), ("b", 0.0), ("b", 0.0)]
    assert seen == [(name, pytest.approx(value)) for name, value in [*visit, *visit[:3]]]


def test_a_guard_that_has_to_last_counts_ticks_on_end_and_from_the_begin_of_its_phase() -> None:
    touch = taut.guards.lasting(lambda x: taut.guards.contact(x, 2.0, direction=[0, 0, 2]), ticks=3)
    task = [taut.Phase(PD, name="a", until=touch), taut.Phase(PD, name="b", until=touch)]
    ctrl = taut.compile(task, PLANAR)
    on, off = np.array([0, 0, 2.1, 0, 0, 0]), np.array([5.0, 0, 1.9, 0, 0, 0])
    for F, phase in [
        (on, "a"),
        (on, "a"),
        (off, "a"),
        (on, "a"),
        (on, "a"),
        (on, "b"),
        (on, "b"),
        (on, "b"),
        (on, "stop"),
    ]:
        ctrl.step(REST, np.zeros(3), F_ext=F)
        assert ctrl.phase == phase


def test_guards_tell_where_the_arm_is() -> None:
    tool = taut.snapshot(PLANAR, REST).T()
    near = REST + np.array([1e-4, 0.0, 0.0])
    turned = taut.Pose(tool.p, R=tool.R @ taut.Pose([0, 0, 0], rpy=[0, 0, 0.02]).R)

    def holds(guard: Callable[[Any], Any], q: np.ndarray = REST, v: float = 0.0, ref: Any = None) -> bool:
        ctrl = taut.compile([taut.Phase(PD, ref, until=guard)], PLANAR, engine="float")
        ctrl.step(REST, np.zeros(3))
        if ctrl.phase == "stop":
            return True
        ctrl.step(q, np.full(3, v))
        return ctrl.phase == "stop"

    target = taut.JointMotion(q=near)
    assert holds(lambda x: taut.guards.settled(x, q=1.1e-4), ref=target)
    assert not holds(lambda x: taut.guards.settled(x, q=0.9e-4), ref=target)
    assert not holds(lambda x: taut.guards.settled(x, q=1.1e-4, v=0.01) & (x.elapsed > 0.0), v=0.02, ref=target)
    assert holds(lambda x: taut.guards.reached(x, turned, position=1e-9, rotation=0.021))
    assert not holds(lambda x: taut.guards.reached(x, turned, rotation=0.019))
    assert holds(lambda x: taut.guards.reached(x, taut.TaskMotion(pose=tool), position=1e-9))
    far = REST + np.array([0.0, 0.0, 0.1])  # the tool swings on the last link
    way = float(np.linalg.norm(taut.snapshot(PLANAR, far).T().p - tool.p))
    assert holds(lambda x: taut.guards.moved(x, way * 0.999), far)
    assert not holds(lambda x: taut.guards.moved(x, way * 1.001), far)


def test_a_guard_sees_the_snapshot_and_the_phase_and_a_law_the_snapshot_alone() -> None:
    seen: list[Any] = []

    def look(x: taut.guards.GuardView) -> Any:
        seen.append((type(x), x.elapsed, x.ref, x.begin.q, x.tool, x.T("tool").p, x.n))
        return x.q[0] > 10.0

    class Looks(taut.Law):
        """Law: tau = t."""

        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
            assert isinstance(x, taut.Snapshot)
            assert not any(hasattr(x, word) for word in ("elapsed", "ref", "begin"))
            return taut.Torque(P=0.0 * x.q)

    ctrl = taut.compile([taut.Phase(Looks(), Q, until=look)], PLANAR, engine="float")
    for k in range(3):
        ctrl.step(REST + 0.1 * k, np.zeros(3))
    kind, elapsed, ref, begin, tool, p, n = seen[-1]
    assert (kind, tool, n) == (taut.guards.GuardView, None, 3)
    assert float(elapsed) == pytest.approx(0.002)
    np.testing.assert_array_equal(ref.q, REST)
    np.testing.assert_array_equal(begin, REST)
    np.testing.assert_array_equal(p, taut.snapshot(PLANAR, REST + 0.2).T("tool").p)


def test_the_direction_of_a_contact_may_be_one_of_the_tool() -> None:
    def phase_after(F: list[float], **axes: Any) -> str:
        task = [taut.Phase(PD, until=lambda x: taut.guards.contact(x, 1.0, **axes), name="a")]
        ctrl = taut.compile(task, PLANAR, engine="float")
        ctrl.step(REST, np.zeros(3), F_ext=[*F, 0, 0, 0])
        return ctrl.phase

    R = taut.snapshot(PLANAR, REST).T().R
    along = (1.2 * R[:, 0]).tolist()
    assert phase_after(along, direction=[1, 0, 0], frame="tool") == "stop"
    assert phase_after((-R[:, 0]).tolist(), direction=[1, 0, 0], frame="tool") == "a"
    assert phase_after([0.0, -1.1, 0.0]) == "stop"  # without a direction any force counts
    task = [taut.Phase(PD, until=lambda x: taut.guards.no_contact(x, 1.0), name="a")]
    ctrl = taut.compile(task, PLANAR)
    assert steps(ctrl, 2, F_ext=[0, 2.0, 0, 0, 0, 0]) == ["a", "a"]
    assert [*steps(ctrl, 1, F_ext=[0, 0.5, 0, 0, 0, 0]), ctrl.phase] == ["a", "stop"]


# -------------------------------------------------------------------- what a phase follows


def test_without_a_reference_a_phase_holds_where_it_began() -> None:
    task = [taut.Phase(PD, name="a", until=lambda x: x.q[0] > 1.0), taut.Phase(PD, name="b")]
    ctrl = taut.compile(task, PLANAR)
    ctrl.step(REST, np.zeros(3))
    ctrl.step(REST + 1.0, np.zeros(3))
    assert np.abs(ctrl.terms["P"]).max() > 10.0  # the first phase wants back
    ctrl.step(REST + 1.0, np.zeros(3))
    assert not ctrl.terms["P"].any()
    np.testing.assert_allclose(ctrl.step(REST + 1.0, np.zeros(3)), taut.snapshot(PLANAR, REST + 1.0).g)


def test_times_of_a_trajectory_count_from_the_begin_of_its_phase_in_a_step_as_in_a_run() -> None:
    task = [
        taut.Phase(PD, name="wait", until=lambda x: x.elapsed > 0.1),
        taut.Phase(
            PD, lambda x: taut.trajectories.Quintic(q0=x.q, q1=x.q + 0.2, duration=0.2), name="go", timeout=0.3
        ),
    ]
    ctrl = taut.compile(task, PLANAR, rate=500.0)
    run = taut.run(ctrl, taut.RigidPlant(PLANAR), duration=0.6, q0=REST)
    go = run.phase("go")
    assert np.abs(np.asarray(go.reference.q)[0] - REST).max() < 1e-9
    assert np.abs(np.asarray(go.reference.q)[50] - REST - 0.1).max() < 1e-9  # 0.1 s later it is half way
    stepped = np.array([ctrl.step(q, v) for q, v in zip(run.q, run.v, strict=True)])
    assert np.abs(stepped - run.command).max() < 1e-9
    rest = run.phase("stop")
    assert np.abs(rest.q - rest.q[0]).max() < 0.01  # [rad] it came with a speed, by friction


def test_a_stream_without_a_source_is_given_sample_by_sample() -> None:
    task = [taut.Phase(PD, taut.stream(period=0.01), name="a", until=lambda x: x.elapsed > 0.0015), taut.Phase(PD)]
    ctrl = taut.compile(task, PLANAR)
    with refused(taut.errors.UsageError):
        ctrl.step(REST, np.zeros(3))
    for _ in range(3):
        ctrl.step(REST, np.zeros(3), taut.JointMotion(q=REST + 0.1))
    assert np.abs(ctrl.terms["P"]).max() > 0.1
    assert ctrl.phase == "phase2"
    with refused(taut.errors.UsageError):
        ctrl.step(REST, np.zeros(3), taut.JointMotion(q=REST))


def test_a_given_sample_of_another_size_is_refused_in_a_phase_too() -> None:
    ctrl = taut.compile([taut.Phase(PD, taut.stream(period=0.01))], PLANAR)
    for _ in range(2):
        with refused(taut.errors.ShapeError):
            ctrl.step(REST, np.zeros(3), taut.JointMotion(q=[0.1]))
        ctrl.step(REST, np.zeros(3), taut.JointMotion(q=REST))


def test_a_given_sample_is_followed_in_its_own_tick_whatever_the_way_of_the_call() -> None:
    other = taut.laws.TaskComputedTorque(kp=100.0, kd=20.0)  # so that the sample of the task has two parts
    ctrl = taut.compile([taut.Phase(PD, taut.stream(period=0.01), name="a"), taut.Phase(other)], PLANAR)
    alone, zero = taut.compile(PD, PLANAR), np.zeros(3)
    for k in range(6):
        ref = taut.JointMotion(q=REST + 0.1 * k)
        expected = alone.step(REST, zero, ref)
        got = ctrl.step(REST, zero, ref) if k % 2 else ctrl.step(REST.tolist(), zero, ref=ref)
        np.testing.assert_allclose(got, expected, rtol=1e-12)
        got = ctrl.step(REST.tolist(), zero, ref) if k % 2 else ctrl.step(REST, zero, ref)
        np.testing.assert_allclose(got, expected, rtol=1e-12)
        with refused(taut.errors.UsageError):
            ctrl.step(REST, zero)
        with refused(taut.errors.RangeError):
            ctrl.step(REST, zero, taut.JointMotion.of({"q": np.full(3, np.nan), "v": zero, "a": zero}))


def calls(function: Callable[[], object]) -> int:
    """How many Python functions a call runs, builtins not counted."""
    count = 0

    def see(_frame: Any, event: str, _arg: Any) -> None:
        nonlocal count
        count += event == "call"

    before = sys.getprofile()
    sys.setprofile(see)
    try:
        function()
    finally:
        sys.setprofile(before)
    return count


@pytest.mark.parametrize(
    "reference",
    [None, lambda x: taut.trajectories.Quintic(q0=x.q, q1=x.q + 0.2, duration=0.2)],
    ids=["hold", "trajectory"],
)
def test_a_tick_within_a_phase_runs_one_python_function(reference: Any) -> None:
    """Counted and not timed: samples are made ahead, and a tick copies one of them."""
    ctrl = taut.compile([taut.Phase(PD, reference)], PLANAR)
    zero = np.zeros(3)
    ctrl.step(REST, zero)
    seen = [calls(lambda: ctrl.step(REST, zero)) - 1 for _ in range(1000)]  # the lambda is one itself
    assert sorted(set(seen))[0] == 1
    assert seen.count(1) >= 990
    alone = taut.compile(PD, PLANAR)
    alone.step(REST, zero, Q)
    assert calls(lambda: alone.step(REST, zero, Q)) == 1


def test_an_odd_call_follows_the_same_reference_as_a_plain_one() -> None:
    """Lists, a failing tick, new parameters with a blend: the sample is that of the tick, whatever the way to it."""
    go = taut.Phase(
        PD,
        lambda x: taut.trajectories.Quintic(q0=x.q, q1=x.q + 0.2, duration=0.2),
        name="go",
        timeout=0.05,
        otherwise=1,
    )
    plain, odd = (taut.compile([go, taut.Phase(PD)], PLANAR, limits=taut.Limits(blend=0.01)) for _ in range(2))
    for k in range(80):
        q = REST + 0.001 * k
        if k == 10:
            for ctrl in (plain, odd):
                ctrl.parameters["law.go.kp"] = 50.0
        if k % 7 == 3:
            with refused(taut.errors.RangeError):
                odd.step(np.full(3, np.nan), np.zeros(3))
        expected = plain.step(q, np.zeros(3))
        got = odd.step(q.tolist(), v=[0.0, 0.0, 0.0]) if k % 3 else odd.step(q, np.zeros(3))
        np.testing.assert_array_equal(got, expected)
    assert odd.phase == plain.phase == "phase2"
    odd.reset()
    assert odd.phase == "go"
    fresh = taut.compile([go, taut.Phase(PD)], PLANAR, limits=taut.Limits(blend=0.01))
    fresh.parameters["law.go.kp"] = 50.0
    for _ in range(3):
        np.testing.assert_array_equal(odd.step(REST, np.zeros(3)), fresh.step(REST, np.zeros(3)))


def test_a_stream_with_a_source_is_asked_from_the_begin_of_its_phase() -> None:
    asked: list[float] = []

    def source(x: taut.Snapshot) -> taut.JointMotion:
        asked.append(round(float(x.t), 6))
        return taut.JointMotion(q=REST)

    task = [
        taut.Phase(PD, name="wait", until=lambda x: x.elapsed > 0.0045),
        taut.Phase(PD, taut.stream(period=0.004, source=source)),
    ]
    ctrl = taut.compile(task, PLANAR)
    run = taut.run(ctrl, taut.RigidPlant(PLANAR), duration=0.02, q0=REST)
    assert asked == [0.006, 0.01, 0.014, 0.018]
    asked.clear()
    for q, v in zip(run.q, run.v, strict=True):
        ctrl.step(q, v)
    assert asked == [0.006, 0.01, 0.014, 0.018]


def test_where_a_reference_fails_a_step_says_so_and_the_next_one_holds_the_arm() -> None:
    def late(t: float) -> taut.JointMotion:
        if t > 0.0105:
            raise LookupError("no more")
        return taut.JointMotion(q=REST)

    class Late:
        at = staticmethod(late)

    soon = taut.Phase(PD, name="a", until=lambda x: x.elapsed > 0.0005)
    cases: list[tuple[Any, int]] = [
        (lambda x: {}["b"], 2),
        (Late(), 13),
    ]
    for reference, ticks in cases:
        ctrl = taut.compile([soon, taut.Phase(PD, reference, name="b")], PLANAR)
        for _ in range(ticks):
            ctrl.step(REST, np.zeros(3))
        for _ in range(2):  # a sensor's fault is none of the reference
            with refused(taut.errors.RangeError):
                ctrl.step(np.full(3, np.nan), np.zeros(3))
        assert ctrl.phase == "b"
        with refused(taut.errors.UsageError):
            ctrl.step(REST, np.zeros(3))
        assert ctrl.phase == "stop"
        held = ctrl.step(REST, np.zeros(3))
        np.testing.assert_allclose(held, taut.snapshot(PLANAR, REST).g)


# -------------------------------------------------------------------- laws that do not act


@pytest.mark.parametrize("engine", ["native", "float"])
def test_nan_of_a_law_that_does_not_act_reaches_nothing(engine: Any) -> None:
    above = taut.JointMotion(q=REST + 1.0)
    task = [
        taut.Phase(PD, Q, name="a", until=lambda x: x.q[0] < 0.0),
        taut.Phase(Rooted(), above, name="b", until=lambda x: x.q[0] < 0.0),
    ]
    ctrl = taut.compile(task, PLANAR, engine=engine)
    beyond = REST + 0.1  # of the reference of `a`, which the other law would take a root of
    for _ in range(3):
        assert np.isfinite(ctrl.step(beyond, np.zeros(3))).all()
    assert all(np.isfinite(values).all() for values in ctrl.memory.values())
    ctrl.step(beyond - 1.0, np.zeros(3))
    ctrl.step(REST, np.zeros(3))
    assert ctrl.memory["law.b.e_int"] == pytest.approx(1.0)  # started when its phase did


def first_inverse(x: taut.Snapshot) -> Any:
    return taut.math.solve_spd(taut.math.array([[x.q[0], 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.ones(3))


class Inverts(taut.Law):
    """A law, and its start, that are singular where the first joint is at zero.

    Law:          tau = a^-1 1, a = q_1
    Closed loop:  none
    """

    def start(self, x: taut.Snapshot, ref: taut.JointMotion) -> dict[str, Any]:
        return {"first": first_inverse(x)}

    def command(self, x: taut.Snapshot, ref: taut.JointMotion, memory: Any, dt: float) -> Any:
        return taut.Torque(inverse=first_inverse(x)), {"first": memory.first}


def test_what_is_singular_in_a_phase_that_does_not_act_ends_nothing_in_either_engine() -> None:
    def singular(x: taut.Snapshot) -> Any:
        return first_inverse(x)[0] > 0.0

    task = [
        taut.Phase(PD, Q, name="a", until=lambda x: x.q[0] > 1.0),
        taut.Phase(Inverts(), name="b", unless=taut.guards.lasting(singular, ticks=3), otherwise="a"),
    ]
    native, plain = (taut.compile(task, PLANAR, engine=engine) for engine in ("native", "float"))
    at_zero, beyond = np.array([0.0, 0.8, 0.6]), np.array([2.0, 0.8, 0.6])
    for q in (at_zero, at_zero, beyond, beyond, beyond, beyond, at_zero):
        got = [ctrl.step(q, np.zeros(3)) for ctrl in (native, plain)]
        np.testing.assert_allclose(got[0], got[1], rtol=1e-9)
        assert native.phase == plain.phase
        assert native.terms["inverse"] == pytest.approx(plain.terms["inverse"])
    assert native.phase == "a"  # it was left after three ticks
    run = taut.run(plain, taut.RigidPlant(PLANAR), duration=0.003, q0=at_zero)
    assert run.outcome.ok
    alone = taut.compile([taut.Phase(Inverts(), name="b")], PLANAR, engine="float")
    with pytest.raises(taut.errors.NumericalError):
        alone.step(at_zero, np.zeros(3))


def test_the_torque_of_a_task_is_that_of_its_law() -> None:
    task = [taut.Phase(PD, Q, name="a", until=lambda x: x.q[0] > 1.0), taut.Phase(PID, Q, name="b")]
    ctrl, pd, pid = (taut.compile(one, PLANAR) for one in (task, PD, PID))
    q, v = REST + 0.6, np.array([0.1, -0.2, 0.3])
    np.testing.assert_allclose(ctrl.step(q, v), pd.step(q, v, Q), rtol=1e-12)
    np.testing.assert_allclose(ctrl.step(q, v), pid.step(q, v, Q), rtol=1e-12)
    ctrl.parameters["law.b.kp"] = 60.0
    pid.parameters["law.kp"] = 60.0
    np.testing.assert_allclose(ctrl.step(q, v), pid.step(q, v, Q), rtol=1e-12)
    assert sum(ctrl.terms.values()) == pytest.approx(pid.step(q, v, Q), rel=0.1)


def test_a_stopped_task_holds_the_arm_against_gravity_and_comes_to_rest() -> None:
    arm = taut.load_arm("one_joint")
    law = taut.laws.GravityPID(kp=2.0, kd=1.0)
    run = taut.run(
        [taut.Phase(law, taut.JointMotion(q=[1.0]), timeout=0.5)], taut.RigidPlant(arm), duration=3.0, q0=[0.0]
    )
    assert run.outcome.kind == "stopped"
    stop = run.phase("stop")
    assert abs(stop.v[0, 0]) > 0.1  # it was moving
    assert abs(stop.v[-1, 0]) < 1e-6
    assert abs(stop.q[-1, 0] - stop.q[0, 0]) < 1e-3


@pytest.mark.parametrize(("kind", "held"), [(taut.Velocity, 0.0), (taut.Position, REST)])
def test_a_stopped_task_of_another_command_stands_still(kind: Any, held: Any) -> None:
    class Own(taut.Law):
        """Law: u = q_des."""

        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> Any:
            return kind(P=ref.q)

    ctrl = taut.compile([taut.Phase(Own(), timeout=0.001)], PLANAR)
    ctrl.step(REST)
    np.testing.assert_array_equal(ctrl.step(REST), np.broadcast_to(held, 3))


# -------------------------------------------------------------------- contact


def test_a_law_that_needs_contact_never_starts_without() -> None:
    task = [
        taut.Phase(PD, Q, name="approach", until=lambda x: x.elapsed > 0.0005, timeout=1.0),
        taut.Phase(Spring(kp=5.0), taut.JointMotion(q=REST + 1.0), name="press", otherwise="retreat", contact=3.0),
        taut.Phase(PD, Q, name="retreat"),
    ]
    ctrl = taut.compile(task, PLANAR)
    touch, near = np.array([0, 3.1, 0, 0, 0, 0.0]), np.array([0, 2.9, 0, 0, 0, 0.0])
    assert steps(ctrl, 2, F_ext=near) == ["approach", "approach"]
    assert ctrl.phase == "press"
    held = ctrl.step(REST, np.zeros(3), F_ext=near)
    np.testing.assert_allclose(held, taut.snapshot(PLANAR, REST).g)  # nothing of the spring goes out
    assert ctrl.phase == "retreat"
    ctrl.reset()
    steps(ctrl, 2, F_ext=touch)
    np.testing.assert_allclose(ctrl.step(REST, np.zeros(3), F_ext=touch), 5.0)
    assert ctrl.phase == "press"  # what is lost later is for `unless`
    ctrl.step(REST, np.zeros(3), F_ext=near)
    assert ctrl.phase == "press"


def test_a_first_phase_without_contact_stops_in_words() -> None:
    plant = taut.RigidPlant(PLANAR, environment=taut.environments.Push(peak=[1.0, 0.0, 0.0]))
    run = taut.run([taut.Phase(Spring(kp=5.0), name="press")], plant, duration=0.01, q0=REST)
    assert run.outcome.kind == "stopped"
    assert "phases: press to 0.001 s: it needs contact and began without (" in run.outcome.message
    assert "(0 N measured, and contact is 1 N or more), stopped at 0.001 s" in run.outcome.message
    by_hand = [taut.Phase(Spring(kp=5.0), name="press", contact=lambda x: x.q[0] > 0.0)]
    assert taut.run(by_hand, taut.RigidPlant(PLANAR), duration=0.01, q0=REST).phases[0].ended is None


def test_force_and_hybrid_laws_need_contact_and_follow_their_own_samples_in_one_task() -> None:
    arm = taut.load_arm("panda")
    move = taut.laws.TaskComputedTorque(kp=100.0, kd=20.0)
    force = taut.laws.ForceControl(kfi=5.0, kdamp=(100.0, 5.0))
    height = float(taut.snapshot(arm, arm.home).T().p[2])
    hybrid = taut.laws.HybridMotionForce(constraint=lambda T: T.p[2] - height, motion=move, kfi=5.0)
    task = [
        taut.Phase(move, name="approach", until=lambda x: x.elapsed > -1.0),
        taut.Phase(force, taut.TaskForce(F_app=[0, 0, -5.0, 0, 0, 0]), name="press", until=lambda x: x.elapsed > 0.0),
        taut.Phase(hybrid, lambda x: taut.pressing(taut.TaskMotion(pose=x.T()), 5.0), name="slide"),
    ]
    assert [phase.needs_contact for phase in task] == [False, True, True]
    ctrl = taut.compile(task, arm, engine="float")
    alone = taut.compile(force, arm, engine="float")
    F, zero = np.array([0, 0, 3.0, 0, 0, 0]), np.zeros(7)
    ctrl.step(arm.home, zero, F_ext=F)
    np.testing.assert_allclose(
        ctrl.step(arm.home, zero, F_ext=F), alone.step(arm.home, zero, task[1].reference, F_ext=F), atol=1e-9
    )
    ctrl.step(arm.home, zero, F_ext=F)
    assert ctrl.phase == "slide"
    assert np.isfinite(ctrl.step(arm.home, zero, F_ext=F)).all()
    ctrl.reset()
    ctrl.step(arm.home, zero, F_ext=F)
    np.testing.assert_allclose(ctrl.step(arm.home, zero, F_ext=0.2 * F), taut.snapshot(arm, arm.home).g, atol=1e-9)
    assert ctrl.phase == "stop"


def test_a_hybrid_phase_never_starts_off_its_constraint() -> None:
    """Contact is to be on the surface, with a force where one is measured; a hinge needs no sensor for it."""
    arm = taut.load_arm("panda")
    T = taut.snapshot(arm, arm.home).T()
    move = taut.laws.TaskComputedTorque(kp=100.0, kd=20.0)
    axis = [*T.p[:2], T.p[2] - 0.2]
    hinge = taut.Constraint.hinge(point=axis, axis=[0.0, 1.0, 0.0], T=T)
    zero, F = np.zeros(7), np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    board = taut.Constraint(lambda T: T.p[2] - 0.1, one_sided=True)
    for constraint, sensor, away, expected in (
        (hinge, {}, 0.0, "slide"),
        (hinge, {}, 0.1, "stop"),
        (board, {"F_ext": F}, 0.0, "stop"),  # something touches, and it is not the board
    ):
        law = taut.laws.HybridMotionForce(constraint=constraint, motion=move, **({"kfi": 5.0} if sensor else {}))
        task = [
            taut.Phase(move, name="approach", until=lambda x: x.elapsed > -1.0),
            taut.Phase(law, lambda x: taut.pressing(taut.TaskMotion(pose=x.T())), name="slide"),
        ]
        ctrl = taut.compile(task, arm, engine="float")
        q = arm.home + away
        ctrl.step(q, zero, **sensor)
        ctrl.step(q, zero, **sensor)
        assert ctrl.phase == expected


# -------------------------------------------------------------------- bad input


def compiled(make: Callable[[], Any]) -> taut.Controller:
    return taut.compile(make(), PLANAR, engine="float")


def test_what_is_no_task_is_refused_in_a_sentence() -> None:
    a = taut.Phase(PD, name="a")
    wrist = taut.Phase(PD, name="touch", until=lambda x: taut.guards.contact(x, 2.0))
    tool = taut.TaskMotion(pose=taut.Pose([0, 0, 0]))
    Move, plant = taut.Phase, taut.RigidPlant(PLANAR)

    class Drive(taut.Law):
        """Law: v = 0."""

        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Velocity:
            return taut.Velocity(P=ref.q - x.q)

    cases: list[tuple[Callable[[], Any], type[Exception]]] = [
        (list, taut.errors.UsageError),
        (lambda: a, taut.errors.UsageError),
        (lambda: [a, PD], taut.errors.UsageError),
        (lambda: [a, a], taut.errors.UsageError),
        (lambda: [Move(PD, otherwise="b", name="a")], taut.errors.UnknownNameError),
        (lambda: [Move(PD, then="b", name="a")], taut.errors.UnknownNameError),
        (lambda: [Move(PD, otherwise=1)], taut.errors.UnknownNameError),
        (lambda: [Move(PD, otherwise=None)], taut.errors.UnknownNameError),  # type: ignore[arg-type]
        (lambda: [Move(PD, timeout=0.0)], taut.errors.RangeError),
        (lambda: [Move(PD, contact=0.0)], taut.errors.RangeError),
        (lambda: [Move(PD, contact=taut.guards.lasting(lambda x: x.t > 1, ticks=2))], taut.errors.UsageError),
        (lambda: [Move(7)], taut.errors.UsageError),  # type: ignore[arg-type]
        (lambda: [Move(PD, name="my phase")], taut.errors.UsageError),
        (lambda: [Move(PD, name="stop")], taut.errors.UsageError),
        (lambda: [Move(PD, until=True)], taut.errors.UsageError),  # type: ignore[arg-type]
        (lambda: [Move(PD, tool, name="a")], taut.errors.UsageError),
        (lambda: [Move(PD, "home", name="a")], taut.errors.UsageError),  # type: ignore[arg-type]
        (lambda: [Move(PD, until=lambda x: x.q)], taut.errors.UsageError),
        (lambda: [Move(PD, until=lambda x: x.q > 0.0)], taut.errors.ShapeError),
        (lambda: [Move(PD, unless=lambda x: None)], taut.errors.UsageError),
        (lambda: [Move(PD, until=lambda x: taut.guards.lasting(lambda x: x.t > 1, ticks=2))], taut.errors.UsageError),
        (lambda: [Move(PD, until=lambda x: x.elapsd > 1)], taut.errors.UsageError),
        (lambda: [Move(PD, until=lambda x: taut.guards.settled(x, position=1.0))], taut.errors.UsageError),
        (lambda: [Move(PD, until=lambda x: taut.guards.settled(x))], taut.errors.UsageError),
        (lambda: [Move(PD, until=lambda x: taut.guards.reached(x, 1.0, q=1.0))], taut.errors.UsageError),  # type: ignore[arg-type]
        (lambda: [Move(PD, until=lambda x: taut.guards.contact(x, 1.0, direction=[0, 0, 0]))], taut.errors.RangeError),
        (lambda: [Move(PD, until=lambda x: taut.guards.contact(x, -1.0))], taut.errors.RangeError),
        (lambda: [a, Move(taut.laws.PID(kp=np.ones(2)), name="b")], taut.errors.ShapeError),
        (lambda: [a, Move(Drive(), name="b")], taut.errors.MatchError),
        (lambda: taut.guards.lasting(7, ticks=1), taut.errors.UsageError),  # type: ignore[arg-type]
        (lambda: taut.guards.lasting(lambda x: x.t > 1, ticks=0), taut.errors.RangeError),
        (lambda: taut.run([a, wrist], plant, duration=1.0), taut.errors.MatchError),
        (lambda: [a, Move(PD, taut.JointMotion(q=[0.1]), name="b")], taut.errors.ShapeError),
        (lambda: [a, Move(PD, taut.hold(taut.JointMotion(q=[0.1])), name="b")], taut.errors.ShapeError),
        (lambda: [a, Move(PD, taut.trajectories.Quintic(q0=[0.0], q1=[1.0], duration=1.0), name="b")], taut.errors.ShapeError),
        (lambda: taut.run([a], plant, Q, duration=1.0), taut.errors.UsageError),
        (lambda: taut.run([Move(PD, taut.stream(period=0.1))], plant, duration=1.0), taut.errors.UsageError),
        (lambda: taut.run([Move(PD, lambda x: 7)], plant, duration=1.0), taut.errors.UsageError),  # type: ignore[arg-type, return-value]
        (lambda: taut.run([Move(PD, lambda x: tool)], plant, duration=1.0), taut.errors.UsageError),
        (lambda: taut.run([Move(PD, lambda x: 1 / 0)], plant, duration=1.0), taut.errors.UsageError),  # type: ignore[arg-type, return-value]
        (lambda: taut.compile([a], PLANAR).bind(), taut.errors.UsageError),
        (lambda: taut.compile(PD, PLANAR).phase, taut.errors.UsageError),
        (lambda: taut.compile([a], PLANAR).step(REST, np.zeros(3), Q), taut.errors.UsageError),
        (lambda: taut.compile([a], PLANAR).step(REST[:2], np.zeros(3)), taut.errors.ShapeError),
        (lambda: taut.compile([a], PLANAR).step(), taut.errors.UsageError),
        (lambda: taut.compile([wrist], PLANAR).step(REST, np.zeros(3)), taut.errors.UsageError),
        (lambda: taut.snapshot(PLANAR, REST).elapsed, AttributeError),
        (lambda: taut.trajectories.Steady(T0=taut.Pose([0, 0, 0])), taut.errors.RangeError),
    ]  # fmt: skip
    for make, kind in cases:
        with refused(kind):
            compiled(make)


def test_a_branch_in_a_guard_is_told_with_its_line() -> None:
    with refused(taut.errors.TraceError):
        taut.compile([taut.Phase(PD, until=lambda x: x.q[0] > 0.0 and x.q[1] > 0.0)], PLANAR, engine="native")


def test_explain_tells_what_follows_each_phase(capsys: pytest.CaptureFixture[str]) -> None:
    task = [
        taut.Phase(PD, name="a", until=taut.guards.lasting(lambda x: x.t > 1, ticks=2), timeout=2.0, otherwise="c"),
        taut.Phase(Spring(kp=1.0), name="b", unless=lambda x: x.t > 3),
        taut.Phase(PD, name="c"),
    ]
    taut.compile(task, PLANAR).explain()
    said = capsys.readouterr().out
    assert "the task of a, b, c for arm 'planar3'" in said
    assert "phase          a: until its guard for 2 ticks -> b; after 2 s -> c\n" in said
    assert "phase          b: unless its guard -> stop; without contact -> stop\n" in said
    assert "phase          c: to the end\n" in said
    assert "law.a.kp" in said


def test_a_steady_motion_has_the_rates_of_its_pose() -> None:
    steady = taut.trajectories.Steady(
        T0=taut.Pose([0.1, 0.2, 0.3], rpy=[0.3, 0, 0]), velocity=[0, 0.1, -0.02], angular=[0, 0, 0.5]
    )
    h = 1e-5
    for t in (0.0, 0.03, 0.0999, 0.5):
        before, now, after = (steady.at(t + d) for d in (-h if t else 0.0, 0.0, h))
        span = 2 * h if t else h
        np.testing.assert_allclose((after.p - before.p) / span, now.twist[:3], atol=1e-5)
        np.testing.assert_allclose((after.twist - before.twist) / span, now.acceleration, atol=2e-2)
        turn = (after.R @ before.R.T - before.R @ after.R.T)[1, 0] / 2 / span
        assert turn == pytest.approx(now.twist[5], abs=1e-4)
    assert steady.at(2.0).p[1] == pytest.approx(0.2 + 0.1 * (2.0 - 0.05))


def test_the_gains_of_a_task_have_the_names_of_its_phases() -> None:
    law = Task.of([taut.Phase(PD, name="a"), taut.Phase(PID)])
    assert not isinstance(law, taut.Law)
    assert list(law.parameters()) == [
        "a.kp",
        "a.kd",
        "a.ki",
        "phase2.kp",
        "phase2.kd",
        "phase2.ki",
        "stop.kp",
        "stop.kd",
    ]


def test_what_limits_cut_from_a_law_is_nothing_for_the_one_after_it() -> None:
    class Cut(taut.Law):
        """Law: tau = what was cut in the last tick."""

        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
            return taut.Torque(P=0.1 * x.tau_cut, ask=ref.q)

    ask = taut.JointMotion(q=np.full(3, 10.0))
    task = [taut.Phase(Cut(), ask, name="a", until=lambda x: x.elapsed > 0.0005), taut.Phase(Cut(), ask, name="b")]
    ctrl = taut.compile(task, PLANAR, limits=taut.Limits(tau=1.0))
    seen = []
    for _ in range(4):
        ctrl.step(REST, np.zeros(3))
        seen.append(float(ctrl.terms["P"][0]))
    assert seen == pytest.approx([0.0, 0.9, 0.0, 0.9])
