"""One thread at a time steps a controller: another one gets its own torque or an error, never a torque of the first."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import taut

ARM = taut.load_arm("planar2")
LAW = taut.laws.PID(kp=10.0, kd=1.0)
REF = taut.JointMotion(q=[0.0, 0.0])
Q, V = np.array([0.3, -0.2]), np.zeros(2)


class Blocks:
    """Numbers that are read in the middle of a tick, where the reader waits until it is let go."""

    def __init__(self) -> None:
        self.reached, self.go = threading.Event(), threading.Event()

    def wait(self) -> None:
        self.reached.set()
        assert self.go.wait(60.0)

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        self.wait()
        return np.array(Q)


def in_the_middle(step: Callable[[], Any], blocks: Blocks, others: Callable[[], None]) -> Any:
    """What `step` gives in another thread, in the middle of which `others` is called here."""
    found: list[Any] = []
    thread = threading.Thread(target=lambda: found.append(step()))
    thread.start()
    assert blocks.reached.wait(60.0)
    try:
        others()
    finally:
        blocks.go.set()
        thread.join()
    return found[0]


def refused(step: Callable[[], object]) -> None:
    with pytest.raises(taut.errors.UsageError) as caught:
        step()
    assert caught.value.name == "step"


@pytest.mark.parametrize("started", [False, True])
@pytest.mark.parametrize("engine", ["native", "float"])
def test_what_begins_in_the_middle_of_another_threads_tick_is_refused(engine: Any, started: bool) -> None:
    ctrl, blocks = taut.compile(LAW, ARM, engine=engine), Blocks()
    if started:
        ctrl.step(Q, V, REF)

    def others() -> None:
        refused(lambda: ctrl.step([9.0, 9.0], [0.0, 0.0], REF))  # lists
        refused(lambda: ctrl.step(np.full(2, 9.0), V, REF))  # plain arrays

    got = in_the_middle(lambda: ctrl.step(blocks, V, REF), blocks, others)
    np.testing.assert_allclose(got, -10.0 * Q, rtol=1e-12)
    np.testing.assert_allclose(ctrl.step(Q, V, REF), -10.0 * Q, rtol=1e-12)
    assert ctrl.ticks == 2 + started


def test_a_bound_tick_in_plain_python_is_refused_too() -> None:
    blocks = Blocks()

    class Waits(taut.Law):
        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
            if x.q[0] == 7.0:
                blocks.wait()
            return taut.Torque(P=ref.q - x.q)

    k = taut.compile(Waits(), ARM, engine="float").bind()
    k.tick()
    k.q[:] = 7.0
    in_the_middle(k.tick, blocks, lambda: refused(k.tick))
    np.testing.assert_array_equal(k.command, [-7.0, -7.0])


def test_a_step_of_a_task_is_refused_too() -> None:
    blocks = Blocks()

    def source(x: taut.Snapshot) -> taut.JointMotion:
        if x.q[0] == 7.0:
            blocks.wait()
        return taut.JointMotion(q=[0.0, 0.0])

    task = [taut.Phase(LAW, taut.stream(period=0.001, source=source), name="only")]
    ctrl, seven = taut.compile(task, ARM), np.full(2, 7.0)
    ctrl.step(Q, V)
    got = in_the_middle(lambda: ctrl.step(seven, V), blocks, lambda: refused(lambda: ctrl.step(Q, V)))
    np.testing.assert_allclose(got, -10.0 * seven, rtol=1e-12)


@pytest.mark.parametrize("engine", ["native", "float"])
def test_a_tick_that_fails_lets_the_next_thread_in(engine: Any) -> None:
    ctrl = taut.compile(LAW, ARM, engine=engine)
    ctrl.step(Q, V, REF)
    for wrong in ([np.nan, 0.0], [0.0]):
        with pytest.raises(taut.TautError):
            ctrl.step(wrong, V, REF)
    found: list[Any] = []
    thread = threading.Thread(target=lambda: found.append(ctrl.step(Q, V, REF)))
    thread.start()
    thread.join()
    np.testing.assert_allclose(found[0], -10.0 * Q, rtol=1e-12)


@pytest.fixture
def hasty() -> Iterator[None]:
    """Threads take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.parametrize("lists", [True, False], ids=["lists", "arrays"])
def test_no_thread_gets_the_torque_of_another_one(lists: bool, hasty: None) -> None:
    ctrl = taut.compile(LAW, ARM)
    ctrl.step(Q, V, REF)
    right, wrong = [0] * 4, [0] * 4

    def steps(number: int) -> None:
        q = np.array([0.1 * number, -0.2 * number])
        given = q.tolist() if lists and number else q  # one of them with plain arrays
        for _ in range(500):
            try:
                tau = ctrl.step(given, V, REF)
            except taut.errors.UsageError:
                continue
            right[number] += 1
            wrong[number] += not np.allclose(tau, -10.0 * q, rtol=1e-12)

    threads = [threading.Thread(target=steps, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(right) > 0
    assert not any(wrong)
