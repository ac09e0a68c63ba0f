"""The call path: whatever is passed, the answer is right or a sentence; nothing leaks; nothing outlives what it needs."""

from __future__ import annotations

import gc
import math
import subprocess
import sys
import threading
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused, warned

import taut
from taut import TautError
from taut.codegen import call, kernel
from taut.codegen.call import offsets, slot_offsets
from taut.errors import NumericalError, RangeError, ShapeError, UsageError

ARM = taut.load_arm("planar2")
LAW = taut.laws.PID(kp=10.0, kd=1.0, ki=2.0)
REF = taut.JointMotion(q=[0.3, -0.2])
Q, V = np.array([0.1, 0.2]), np.array([1.0, 2.0])
CALLS = 20_000
ROUNDING = 1e-14


@pytest.fixture
def ctrl() -> taut.Controller:
    """A controller whose memory has started."""
    ctrl = taut.compile(LAW, ARM)
    ctrl.step(Q, V, REF)
    return ctrl


def misaligned(x: Any) -> Any:
    out = np.frombuffer(bytearray(8 * len(x) + 1), dtype=np.uint8)[1:].view(np.float64)
    out[:] = x
    return out


def read_only(x: Any) -> Any:
    out = np.array(x)
    out.flags.writeable = False
    return out


class Subclass(np.ndarray):
    """An array of a kind of its own."""


KINDS: dict[str, Callable[[Any], Any]] = {
    "float64": lambda x: np.array(x),
    "float32": lambda x: np.array(x, dtype=np.float32),
    "float16": lambda x: np.array(x, dtype=np.float16),
    "long double": lambda x: np.array(x, dtype=np.longdouble),
    "int": lambda x: np.array([1, -2]),
    "a list": lambda x: list(x),
    "a tuple": lambda x: tuple(x),
    "not contiguous": lambda x: np.array([x[0], 0.0, x[1], 0.0])[::2],
    "backwards": lambda x: np.array(x)[::-1],
    "a column of a matrix": lambda x: np.array([[x[0], 1.0], [x[1], 2.0]])[:, 0],
    "a row of a Fortran matrix": lambda x: np.array([[x[0], x[1]], [1.0, 2.0]], order="F")[0],
    "read-only": read_only,
    "a subclass": lambda x: np.array(x).view(Subclass),
    "a memory view": lambda x: memoryview(np.array(x)),
    "bytes swapped": lambda x: np.array(x).astype(">f8"),
    "misaligned": misaligned,
    "an object array": lambda x: np.array(list(x), dtype=object),
    "NumPy numbers": lambda x: [np.float64(x[0]), np.float32(x[1])],
    "a slice of a bigger array": lambda x: np.array([9.0, x[0], x[1], 9.0])[1:3],
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("place", ["q", "v"])
def test_every_kind_of_array_gives_the_right_torque(ctrl: taut.Controller, kind: str, place: str) -> None:
    memory = 2 * (REF.q - Q) * ctrl.dt  # two ticks at Q: one before, and this one where only v changes
    given = KINDS[kind](Q if place == "q" else V)
    q = np.asarray(given, dtype=np.float64) if place == "q" else Q
    v = np.asarray(given, dtype=np.float64) if place == "v" else V
    if place == "q":
        memory = (REF.q - Q + REF.q - q) * ctrl.dt
    tau = ctrl.step(given, V, REF) if place == "q" else ctrl.step(Q, given, REF)
    assert type(tau) is np.ndarray
    np.testing.assert_allclose(tau, 10.0 * (REF.q - q) - v + 2.0 * memory, rtol=0.0, atol=ROUNDING)


WRONG: dict[str, tuple[Any, type[TautError]]] = {
    "None": (None, UsageError),
    "a text": ("ab", ShapeError),
    "too long": (np.zeros(3), ShapeError),
    "too short": ([0.0], ShapeError),
    "a column": (np.zeros((2, 1)), ShapeError),
    "a row": (np.zeros((1, 2)), ShapeError),
    "a number": (1.0, ShapeError),
    "0-d": (np.array(1.0), ShapeError),
    "NaN": (np.array([0.0, math.nan]), RangeError),
    "infinity": ([math.inf, 0.0], RangeError),
    "complex": (np.zeros(2) * 1j, ShapeError),
    "truth values": (np.array([True, False]), ShapeError),
    "ragged": ([[1.0], [1.0, 2.0]], ShapeError),
    "a dict": ({}, ShapeError),
    "the reference": (REF, ShapeError),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_no_measurement_gets_one_sentence_and_changes_nothing(ctrl: taut.Controller, what: str) -> None:
    value, kind = WRONG[what]
    twin = taut.compile(LAW, ARM)
    twin.step(Q, V, REF)
    with refused(kind):
        ctrl.step(value, V, REF)
    assert ctrl.ticks == 1
    np.testing.assert_array_equal(ctrl.step(Q, V, REF), twin.step(Q, V, REF))


SENTENCES: list[tuple[str, Callable[[Any], Any], type[TautError]]] = [
    ("nothing", lambda step: step(), UsageError),
    ("no reference", lambda step: step(Q, V), UsageError),
    ("a list for a reference", lambda step: step(Q, V, [0.1, 0.2]), UsageError),
    ("a trajectory", lambda step: step(Q, V, taut.trajectories.Quintic(q0=[0.0, 0.0], q1=[1.0, 1.0], duration=1.0)), UsageError),
    ("a reference of another arm", lambda step: step(Q, V, taut.JointMotion(q=[1.0, 2.0, 3.0])), ShapeError),
    ("no velocity", lambda step: step(Q, None, REF), UsageError),
    ("too many", lambda step: step(Q, V, REF, REF), UsageError),
    ("misspelt", lambda step: step(Q, V, rf=REF), taut.errors.UnknownNameError),
    ("twice", lambda step: step(Q, V, REF, q=Q), UsageError),
    ("a wrench that is not used", lambda step: step(Q, V, REF, F_ext=np.zeros(6)), UsageError),
    ("a wrench in both signs", lambda step: step(Q, V, REF, F_ext=np.zeros(6), F_app=np.zeros(6)), UsageError),
]  # fmt: skip


@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize(("what", "call_it", "kind"), SENTENCES, ids=[case[0] for case in SENTENCES])
def test_arguments_that_do_not_fit_get_one_sentence(
    engine: Any, what: str, call_it: Callable[[Any], Any], kind: type[TautError]
) -> None:
    ctrl = taut.compile(LAW, ARM, engine=engine)
    for _ in range(2):  # in the first tick and later
        with refused(kind):
            call_it(ctrl.step)
        ctrl.step(Q, V, REF)


def test_keywords_are_as_good_as_places(ctrl: taut.Controller) -> None:
    twin = taut.compile(LAW, ARM)
    twin.step(Q, V, REF)
    np.testing.assert_array_equal(ctrl.step(q=Q, v=V, ref=REF), twin.step(Q, V, REF))
    np.testing.assert_array_equal(ctrl.step(Q, ref=REF, v=V), twin.step(Q, V, REF))


def test_a_reference_with_odd_arrays_takes_the_slow_way_to_the_same_torque(ctrl: taut.Controller) -> None:
    twin = taut.compile(LAW, ARM)
    twin.step(Q, V, REF)
    odd = taut.JointMotion.of({"q": np.array([0.3, 0.0, -0.2])[::2], "v": np.zeros(2, np.float32), "a": [0, 0]})
    np.testing.assert_allclose(ctrl.step(Q, V, odd), twin.step(Q, V, REF), rtol=ROUNDING)


def test_a_reference_with_nothing_in_it_is_told(ctrl: taut.Controller) -> None:
    empty = object.__new__(taut.JointMotion)
    with pytest.raises((TautError, AttributeError)):
        ctrl.step(Q, V, empty)
    assert ctrl.step(Q, V, REF).shape == (2,)


# -------------------------------------------------------------------- references are counted


def counts(*objects: Any) -> list[int]:
    return [sys.getrefcount(x) for x in objects]


def test_no_call_leaks_or_loses_a_reference(ctrl: taut.Controller) -> None:
    tick = ctrl.bind().tick
    kept = (Q, V, REF, REF.q, None, np.float64, np.dtype(np.float64), np.ndarray, ctrl.step, tick, ctrl)
    wrong, text = np.zeros(3), "no numbers"
    gc.collect()
    before = counts(*kept, wrong, text)
    for _ in range(2000):
        ctrl.step(Q, V, REF)
        tick()
        ctrl.step(list(Q), V, ref=REF)
        for bad in (wrong, text):
            with pytest.raises(TautError):
                ctrl.step(bad, V, REF)
    after = counts(*kept, wrong, text)
    # One leak a call would be 2000 and more. None, not yet immortal in Python 3.11, wanders with the interpreter.
    assert all(abs(b - a) < 1000 for a, b in zip(before, after, strict=True)), (before, after)


def test_an_answer_is_an_ordinary_array_that_is_freed(ctrl: taut.Controller) -> None:
    tau = ctrl.step(Q, V, REF)
    assert sys.getrefcount(tau) == 2
    assert tau.flags.owndata
    assert tau.flags.writeable
    assert tau.flags.aligned
    assert tau.dtype is np.dtype(np.float64)
    tau[0] = 5.0
    assert ctrl.step(Q, V, REF)[0] != 5.0


def growth(work: Callable[[], Any]) -> tuple[int, int]:
    """Blocks and bytes that many calls leave behind."""
    for _ in range(100):
        work()
    gc.collect()
    tracemalloc.start()
    blocks, (size, _) = sys.getallocatedblocks(), tracemalloc.get_traced_memory()
    for _ in range(CALLS):
        work()
    left = sys.getallocatedblocks() - blocks, tracemalloc.get_traced_memory()[0] - size
    tracemalloc.stop()
    return left


FEW_BLOCKS, FEW_BYTES = 50, 5000  # of the measuring itself; one object a call would be CALLS blocks


def test_a_bound_tick_allocates_nothing(ctrl: taut.Controller) -> None:
    tick = ctrl.bind().tick
    tick()
    gc.collect()
    tracemalloc.start()
    tracemalloc.clear_traces()
    size, _ = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    for _ in range(1000):
        tick()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak - size < 500  # the range's own numbers; one array would be 112 bytes and more in each tick
    blocks, size = growth(tick)
    assert blocks < FEW_BLOCKS
    assert size < FEW_BYTES


def test_a_step_leaves_nothing_but_its_answer(ctrl: taut.Controller) -> None:
    blocks, size = growth(lambda: ctrl.step(Q, V, REF))
    assert blocks < FEW_BLOCKS
    assert size < FEW_BYTES


def test_compiling_again_and_again_leaves_nothing_in_python() -> None:
    def once() -> None:
        taut.compile(LAW, ARM).step(Q, V, REF)

    for _ in range(5):
        once()
    gc.collect()
    before = sys.getallocatedblocks()
    for _ in range(20):
        once()
    gc.collect()
    assert sys.getallocatedblocks() - before < 20 * 20  # a controller is some thousand blocks


# -------------------------------------------------------------------- lifetimes


def test_builtins_work_when_everything_else_is_gone() -> None:
    ctrl = taut.compile(LAW, ARM)
    step, bound = ctrl.step, ctrl.bind()
    wanted = taut.compile(LAW, ARM)
    del ctrl
    gc.collect()
    for k in range(3):
        np.testing.assert_array_equal(step(Q * k, V, REF), wanted.step(Q * k, V, REF))
    with pytest.raises(RangeError):
        step([math.nan, 0.0], V, REF)
    bound.q[:], bound.v[:] = 3.0 * Q, V
    tick = bound.tick
    command = bound.command
    del step, bound
    gc.collect()
    tick()
    np.testing.assert_array_equal(command, wanted.step(3.0 * Q, V, REF))


@pytest.mark.long
def test_controllers_in_cycles_are_collected() -> None:
    """CPython reads a builtin's definition when it goes; it must not have gone before."""
    code = (
        "import gc, numpy as np, taut\n"
        "arm = taut.load_arm('planar2')\n"
        "junk = []\n"
        "for k in range(60):\n"
        "    ctrl = taut.compile(taut.laws.PID(kp=10.0), arm)\n"
        "    ctrl.me, ctrl.tick = ctrl, ctrl.bind().tick\n"
        "    ctrl.step(np.zeros(2), np.zeros(2), taut.JointMotion(q=[0.1, 0.2]))\n"
        "    del ctrl\n"
        "    gc.collect()\n"
        "    junk.append([bytearray(b'\\xff' * 32) for _ in range(50)])\n"
        "print('alive')\n"
    )
    done = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "alive"


def test_several_threads_use_one_controller_without_memory() -> None:
    ctrl = taut.compile(taut.laws.GravityCompensation(kd=1.0), ARM)
    ctrl.step(Q, V, REF)
    plain = taut.compile(taut.laws.GravityCompensation(kd=1.0), ARM, engine="float")
    wrong: list[Any] = []

    def work(k: int) -> None:
        q, v = Q * k, V - k
        wanted = expected[k]
        wrong.extend(k for _ in range(3000) if np.abs(ctrl.step(q, v, REF) - wanted).max() > 1e-12)

    expected = [plain.step(Q * k, V - k, REF) for k in range(4)]
    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    assert ctrl.ticks == 4 * 3000 + 1


# -------------------------------------------------------------------- where memory lies otherwise


@pytest.fixture
def unknown_layout(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a NumPy whose arrays lie in memory otherwise."""
    for module in (call, kernel):
        monkeypatch.setattr(module, "offsets", lambda: None)


@pytest.mark.usefixtures("unknown_layout")
def test_the_way_through_ctypes_gives_the_same() -> None:
    slow = taut.compile(LAW, ARM, limits=taut.Limits(tau=1.5, tau_dot=800.0))
    assert not isinstance(slow.step, type(len))
    fast = taut.compile(LAW, ARM, limits=taut.Limits(tau=1.5, tau_dot=800.0), engine="float")
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v = rng.standard_normal((2, 2))
        np.testing.assert_allclose(slow.step(q, v, REF), fast.step(q, v, REF), rtol=1e-12)
        assert slow.ticks == fast.ticks
        for name, term in fast.terms.items():
            np.testing.assert_allclose(slow.terms[name], term, rtol=1e-12, atol=1e-12)
    with refused(RangeError):
        slow.step([math.nan, 0.0], v, REF)
    bound = slow.bind()
    bound.q[:] = math.nan
    with refused(RangeError):
        bound.tick()
    native = taut.native(lambda a: 2.0 * a, a=2)
    assert native(Q).tolist() == (2.0 * Q).tolist()
    assert native.call([1, 2]).tolist() == [2.0, 4.0]


def test_an_unknown_layout_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    offsets.cache_clear()
    monkeypatch.setattr(call, "_as_expected", lambda at, array: False)
    with warned(RuntimeWarning):
        assert offsets() is None
    assert offsets() is None
    offsets.cache_clear()


def test_the_layout_is_found_by_looking() -> None:
    found = offsets()
    assert found is not None
    assert found.data == object.__basicsize__
    assert slot_offsets(taut.JointMotion, ("q", "v", "a")) is not None

    class WithoutSlots:
        pass

    assert slot_offsets(WithoutSlots, ("q",)) is None


# -------------------------------------------------------------------- numbers that are not finite


def exploding_law() -> taut.Law:
    class Explodes(taut.Law):
        kp: taut.Gain
        total: taut.Memory = taut.Memory(0.0)

        def command(self, x: Any, ref: Any, memory: Any, dt: Any) -> Any:
            total = memory.total + x.q
            return taut.Torque(P=self.kp @ (1.0 / (x.q - 3.0)), I=total), {"total": total}

    return Explodes(kp=1.0)


@pytest.mark.parametrize("engine", ["native", "float"])
def test_a_law_that_gives_infinity_is_refused_and_its_memory_stays(engine: Any) -> None:
    ctrl = taut.compile(exploding_law(), ARM, engine=engine)
    ctrl.step([1.0, 1.0], V, REF)
    terms = ctrl.terms
    for _ in range(2):
        with refused(NumericalError):
            ctrl.step(np.array([1.0, 3.0]), V, REF)
        assert ctrl.ticks == 1
        for name, term in terms.items():  # those of the last good tick
            np.testing.assert_array_equal(ctrl.terms[name], term)
    np.testing.assert_allclose(ctrl.step([1.0, 1.0], V, REF), [1.5, 1.5], rtol=ROUNDING)


@pytest.mark.parametrize("engine", ["native", "float"])
def test_a_first_tick_that_fails_is_still_the_first(engine: Any) -> None:
    ctrl = taut.compile(LAW, ARM, sensing=taut.Sensing(velocity="difference"), engine=engine)
    bound = ctrl.bind()
    bound.q[:] = math.nan
    bound.ref.q[:] = REF.q
    for _ in range(2):
        with refused(RangeError):
            bound.tick()
    assert ctrl.ticks == 0
    with refused(UsageError):
        ctrl.terms  # noqa: B018
    tau = ctrl.step(Q, REF)  # differenced against itself: no velocity
    np.testing.assert_allclose(tau, (10.0 + 2.0 * ctrl.dt) * (REF.q - Q), rtol=ROUNDING)


class Felt(taut.Law):
    """Gives back what two sensors measure: a law whose measurements come by keyword."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(force=x.F_ext[:2], torque=2.0 * x.tau_meas, goal=ref.q)


@pytest.mark.parametrize("order", ["F_ext first", "tau_meas first", "built at run time"])
def test_measurements_by_keyword_are_right_in_any_order(order: str) -> None:
    ctrl = taut.compile(Felt(), ARM)
    F, tau = np.arange(6.0), np.array([10.0, 20.0])
    given = {"F_ext": F, "tau_meas": tau}
    if order == "tau_meas first":
        given = {"tau_meas": tau, "F_ext": F}
    elif order == "built at run time":  # names that are equal to the known ones, and others in memory
        given = {"".join(name): value for name, value in ((["F_", "ext"], F), (["tau_", "meas"], tau))}
    for _ in range(3):
        assert ctrl.step(Q, REF, **given) == pytest.approx(F[:2] + 2.0 * tau + REF.q, rel=ROUNDING)


def test_measurements_by_keyword_are_checked_like_others() -> None:
    ctrl = taut.compile(Felt(), ARM)
    F, tau = np.arange(6.0), np.array([10.0, 20.0])
    ctrl.step(Q, REF, F_ext=F, tau_meas=tau)
    with refused(ShapeError):
        ctrl.step(Q, REF, F_ext=F[:5], tau_meas=tau)
    with refused(RangeError):
        ctrl.step(Q, REF, F_ext=F * np.nan, tau_meas=tau)
    with refused(UsageError):
        ctrl.step(Q, REF, F_ext=F)
    assert ctrl.step(Q, REF, F_app=-F, tau_meas=tau) == pytest.approx(F[:2] + 2.0 * tau + REF.q, rel=ROUNDING)


def test_keywords_leave_nothing_behind() -> None:
    ctrl = taut.compile(Felt(), ARM)
    F, tau = np.arange(6.0), np.array([10.0, 20.0])
    ctrl.step(Q, REF, F_ext=F, tau_meas=tau)
    before = [sys.getrefcount(x) for x in (F, tau, REF)]
    for _ in range(1000):
        ctrl.step(Q, REF, F_ext=F, tau_meas=tau)
    assert [sys.getrefcount(x) for x in (F, tau, REF)] == before


def test_a_law_without_a_reference_is_stepped_without_one() -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(taut.laws.GravityCompensation(), arm)
    for _ in range(2):
        assert ctrl.step(arm.home, [0.0, 0.0]) == pytest.approx(
            ctrl.step(arm.home, [0.0, 0.0], taut.JointMotion(q=arm.home))
        )
