"""Batches: lanes with the bits of one controller, on the arrays of a simulator, and what they refuse."""

from __future__ import annotations

import copy
import math
import pickle
import signal
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut import Gain, Memory, Torque
from taut.errors import MissingExtraError, RangeError, ShapeError, UnknownNameError, UsageError

L = taut.laws
TICKS = 4


class Everything(taut.Law):
    """A law with time, memory that starts from what is measured, a force and a matrix gain.

    Law:          tau = K (q_des - q) + J^T F_ext + t + first + count
    """

    K: Gain = Gain()
    first: Memory = Memory(0.0)
    count: Memory = Memory(0.0)

    def start(self, x: Any, ref: Any) -> Any:
        return {"first": x.q + 0.1 * x.t}

    def command(self, x: Any, ref: Any, memory: Any, dt: Any) -> Any:
        terms = {
            "P": self.K @ (ref.q - x.q),
            "force": x.J().T @ x.F_ext,
            "time": x.t + 0.0 * x.q,
            "first": memory.first,
        }
        return Torque(**terms, count=memory.count + 0.0 * x.q), {"first": memory.first, "count": memory.count + x.v}


def of(law: Any, arm: str, **options: Any) -> Any:
    return lambda: taut.compile(law, taut.load_arm(arm), **options)


LIMITS = taut.Limits(tau=[20.0, 8.0], tau_dot=[2e3, 1e3], blend=0.1)
CASES = {
    "limits": (of(L.PID(kp=[90.0, 40.0], kd=3.0, ki=5.0), "planar2", limits=LIMITS), "law.kp"),
    "difference": (
        of(L.GravityPID(kp=50.0, kd=5.0), "gantry3", sensing=taut.Sensing(velocity="difference")),
        "law.kp",
    ),
    "everything": (of(Everything(K=np.diag([3.0, 2.0])), "planar2"), "law.K"),
    "payload": (of(L.ComputedTorque(kp=100.0, kd=20.0, ki=9.0), "ur5"), "model.payload.mass"),
    "mit": (of(L.ViaMit(law=L.PID(kp=20.0)), "planar2"), "law.kp"),
}


def states(ctrl: Any, n: int, seed: int = 0) -> dict[str, Any]:
    """Arrays of all that a tick takes, by the arguments of `step`."""
    rng, joints = np.random.default_rng(seed), ctrl.arm.n
    given = {"q": ctrl.arm.home + 0.2 * rng.standard_normal((n, joints))}
    sizes = {"F_ext": 6}
    given |= {name: 0.3 * rng.standard_normal((n, sizes.get(name, joints))) for name in ctrl.side.takes}
    ref = {name: 0.3 * rng.standard_normal((n, *shape)) for name, shape in ctrl.law.reference.fields(joints).items()}
    return {**given, "ref": ref}


def gains(ctrl: Any, path: str, n: int) -> Any:
    base = np.asarray(ctrl.side.parameters[path]) + (1.0 if path.endswith("mass") else 0.0)
    return np.multiply.outer(np.linspace(0.5, 2.0, n), base)


@pytest.mark.parametrize("case", CASES)
def test_each_lane_has_the_bits_of_a_controller(case: str) -> None:
    n = 11  # no multiple of any number of lanes
    ctrl, path = CASES[case][0](), CASES[case][1]
    batch, values = ctrl.batch(n), gains(ctrl, path, n)
    batch.parameters[path] = values
    ticks = [states(ctrl, n, seed) for seed in range(TICKS)]
    commands = np.array([batch.step(**given) for given in ticks])
    assert batch.finite.all()
    for lane in range(n):
        ctrl.reset()
        ctrl.parameters[path] = values[lane]
        for k, given in enumerate(ticks):
            one = {name: value[lane] for name, value in given.items() if name != "ref"}
            ref = taut.JointMotion(**{name: value[lane] for name, value in given["ref"].items()})
            np.testing.assert_array_equal(commands[k, lane], ctrl.step(**one, ref=ref))
        for name, value in ctrl.memory.items():
            np.testing.assert_array_equal(batch.memory[name][lane], value)


def test_a_task_law_in_single_precision_differs_by_its_rounding() -> None:
    arm = taut.load_arm("xarm7")
    ctrl, n = taut.compile(L.Impedance(K=(500.0, 30.0), B=(40.0, 4.0)), arm), 13
    rng, x = np.random.default_rng(0), taut.snapshot(arm, arm.home)
    q = arm.home + 0.2 * rng.standard_normal((n, 7))
    v = 0.3 * rng.standard_normal((n, 7))
    ref = taut.TaskMotion(pose=x.T(), twist=[0.1, 0.0, 0.0, 0.0, 0.2, 0.0])
    exact = ctrl.batch(n).step(q, v, ref)
    few = ctrl.batch(n, real="float").step(q.astype(np.float32), v.astype(np.float32), ref)
    assert few.dtype == np.float32
    assert np.abs(few - exact).max() < 1e-4 * np.abs(exact).max()
    np.testing.assert_array_equal(exact[3], taut.compile(ctrl.law, arm).step(q[3], v[3], ref))


def test_arrays_are_read_and_written_where_they_are() -> None:
    ctrl = taut.compile(L.PID(kp=7.0, kd=2.0), taut.load_arm("planar3"))
    for n in range(1, 19):
        state = np.random.default_rng(n).standard_normal((n, 11))
        room = np.full((n + 2, 8), 5.0)
        out = room[1:-1, 2:5]
        goal = np.array([1.0, 2.0, 3.0])
        ref = {"q": goal, "v": state[:, 7:10], "a": np.zeros(3)}
        batch = ctrl.batch(n)
        assert batch.step(state[:, :3], state[:, 3:6], ref, out=out) is out
        expected = 7.0 * (goal - state[:, :3]) + 2.0 * (state[:, 7:10] - state[:, 3:6])
        np.testing.assert_allclose(out, expected, rtol=0.0, atol=1e-13)
        out[...] = 5.0
        np.testing.assert_array_equal(room, np.full((n + 2, 8), 5.0))
        state[:, :3] += 1.0  # the simulator goes on in the same arrays
        np.testing.assert_allclose(batch.step(state[:, :3], state[:, 3:6], ref), expected - 7.0, rtol=0.0, atol=1e-13)


def test_a_command_takes_the_place_of_a_measurement_or_stands_beside_it() -> None:
    ctrl, n = taut.compile(L.PID(kp=7.0, kd=2.0), taut.load_arm("planar2")), 9
    state, ref = np.random.default_rng(0).standard_normal((n, 6)), taut.JointMotion(q=[0.3, 0.2])
    q, v, expected = state[:, :2], state[:, 2:4], ctrl.batch(n).step(state[:, :2], state[:, 2:4], ref)
    for out in (state[:, 4:], q, state[:, :2]):  # the last is the same place by another array
        given = state.copy()
        np.testing.assert_array_equal(ctrl.batch(n).step(q, v, ref, out=out), expected)
        state[...] = given


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("real", ["double", "float"])
def test_a_lane_that_is_not_finite_is_reported_and_disturbs_no_other(bad: float, real: Any) -> None:
    ctrl, n, wrong = taut.compile(L.PID(kp=7.0, kd=2.0, ki=3.0), taut.load_arm("planar2")), 21, [0, 9, 20]
    given = {name: value for name, value in states(ctrl, n).items() if name != "ref"}
    given = {name: value.astype(np.float32 if real == "float" else np.float64) for name, value in given.items()}
    sick = {name: value.copy() for name, value in given.items()}
    sick["q"][wrong, 1] = bad
    well, ill = (ctrl.batch(n, real=real) for _ in range(2))
    ref = taut.JointMotion(q=[0.3, 0.2])
    others = np.delete(np.arange(n), wrong)
    for k, now in enumerate((given, sick, given)):
        expected, command = well.step(**given, ref=ref), ill.step(**now, ref=ref)
        np.testing.assert_array_equal(command[others], expected[others])
        assert ill.finite[others].all()
        assert ill.finite[wrong].all() == (k != 1)
        assert np.isnan(command[wrong]).all() == (k == 1)
    e_int = "law.integral.e_int"
    np.testing.assert_array_equal(ill.memory[e_int][others], well.memory[e_int][others])
    np.testing.assert_array_equal(ill.memory["lane.ticks"][wrong], 2.0)
    np.testing.assert_allclose(ill.memory[e_int][wrong], 2.0 / 3.0 * well.memory[e_int][wrong], rtol=1e-6)
    ill.memory[e_int][4] = bad  # neither does a memory
    assert np.flatnonzero(~np.isfinite(ill.step(**given, ref=ref)).all(axis=1)).tolist() == [4]
    assert np.flatnonzero(~ill.finite).tolist() == [4]


def test_reset_starts_the_lanes_of_a_mask() -> None:
    ctrl, n = taut.compile(Everything(K=1.0), taut.load_arm("planar2")), 9
    batch, ticks = ctrl.batch(n), [states(ctrl, n, seed) for seed in range(3)]
    for given in ticks[:2]:
        batch.step(**given)
    mask = np.arange(n) % 3 == 0
    saved = {path: value.copy() for path, value in batch.memory.items()}
    batch.reset(mask)
    command = batch.step(**ticks[2])
    np.testing.assert_array_equal(batch.memory["lane.ticks"], np.where(mask, 1.0, 3.0))
    fresh = ctrl.batch(n).step(**ticks[2])
    np.testing.assert_array_equal(command[mask], fresh[mask])
    assert (command[~mask] != fresh[~mask]).all()
    for path, value in saved.items():  # back to where all were before
        batch.memory[path][...] = value
    again = batch.step(**ticks[2])
    np.testing.assert_array_equal(again[~mask], command[~mask])
    assert (again[mask] != command[mask]).all()
    batch.reset()
    np.testing.assert_array_equal(batch.step(**ticks[2]), fresh)


def test_threads_change_no_bit() -> None:
    ctrl, n = taut.compile(L.ComputedTorque(kp=9.0, kd=6.0), taut.load_arm("planar2")), 60_001
    given = states(ctrl, n)
    one, many = (ctrl.batch(n, threads=k) for k in (1, 5))
    for _ in range(2):
        np.testing.assert_array_equal(many.step(**given), one.step(**given))


FORKS = """
import os, signal, sys, numpy as np, taut
ctrl = taut.compile(taut.laws.PID(kp=1.0), taut.load_arm("planar2"))
q = np.zeros((300_000, 2))
batch = ctrl.batch(len(q), threads=2)
ref = taut.JointMotion(q=[1.0, 2.0])
batch.step(q, q, ref)
child = os.fork()
if child == 0:
    signal.alarm(30)
    os._exit(0 if (batch.step(q, q, ref) == [1.0, 2.0]).all() else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no fork")
def test_a_process_that_forks_after_threads_ran_goes_on() -> None:
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", FORKS], timeout=60)
    assert done.returncode == 0, signal.Signals(-done.returncode) if done.returncode < 0 else done.returncode


def test_parameters_are_those_of_each_lane_or_of_all() -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(L.ComputedTorque(kp=[9.0, 8.0], kd=6.0), arm)
    ctrl.parameters["law.kd"] = 5.0
    batch = ctrl.batch(4)
    assert dict(batch.parameters).keys() == dict(ctrl.parameters).keys()
    assert batch.parameters["law.kd"] == 5.0
    batch.parameters["law.kd"] = [1.0, 2.0, 3.0, 4.0]
    batch.parameters["law.kp"] = 3.0
    np.testing.assert_array_equal(batch.parameters["law.kp"], [3.0, 3.0])
    inertia = np.zeros((4, 6))
    inertia[2] = [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]
    batch.parameters["model.payload.inertia"] = inertia
    zero = np.zeros((4, 2))
    command = batch.step(zero, zero, {"q": np.ones(2), "v": np.ones(2), "a": np.zeros(2)})
    loaded = taut.snapshot(arm.with_payload(0.0, inertia=inertia[2]), [0.0, 0.0])
    np.testing.assert_allclose(command[2], loaded.M @ [6.0, 6.0] + loaded.h, rtol=1e-12)
    accelerations = [taut.snapshot(arm, [0.0, 0.0]).M @ [3.0 + k, 3.0 + k] for k in (1.0, 2.0, 4.0)]
    np.testing.assert_allclose(command[[0, 1, 3]] - taut.snapshot(arm, [0.0, 0.0]).h, accelerations, rtol=1e-12)
    batch.parameters["law.kp"] = [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0], [1.0, 1.0]]


class OnTheGpu:
    """What an array in the memory of a GPU says of itself."""

    def __dlpack_device__(self) -> tuple[int, int]:
        return 2, 1


def test_arrays_that_cannot_be_read_where_they_are_are_refused() -> None:
    ctrl = taut.compile(L.PID(kp=1.0), taut.load_arm("planar2"))
    batch, q, ref = ctrl.batch(3), np.zeros((3, 2)), taut.JointMotion(q=[0.0, 0.0])
    frozen = np.zeros((3, 2))
    frozen.flags.writeable = False
    wrong: list[tuple[Any, dict[str, Any]]] = [
        (UsageError, {"q": OnTheGpu()}),
        (UsageError, {"q": [[0.0, 0.0]] * 3}),
        (UsageError, {"q": q.astype(np.float32)}),
        (UsageError, {"q": q.astype(">f8")}),
        (UsageError, {"v": np.zeros((2, 3)).T}),
        (UsageError, {"v": np.zeros((3, 4))[:, ::2]}),
        (UsageError, {"out": frozen}),
        (UsageError, {"out": np.broadcast_to(np.zeros(2), (3, 2))}),
        (ShapeError, {"q": np.zeros((4, 2))}),
        (ShapeError, {"v": np.zeros((3, 3))}),
        (ShapeError, {"out": np.zeros(2)}),
        (UsageError, {"v": None}),
        (UsageError, {"F_ext": np.zeros(6)}),
        (UsageError, {"ref": None}),
        (UsageError, {"ref": {"q": q}}),
        (UnknownNameError, {"ref": {"q": q, "v": q, "acc": q}}),
    ]
    for kind, change in wrong:
        with refused(kind):
            batch.step(**{"q": q, "v": q, "ref": ref, **change})
    rows, state = np.zeros((4, 2)), np.zeros((3, 4))
    shared = [
        {"q": rows[:3], "out": rows[1:]},
        {"q": rows[0], "out": rows[:3]},
        {"ref": {"q": state[:, :2], "v": q, "a": q}, "out": state[:, 1:3]},
        {"out": np.lib.stride_tricks.as_strided(rows, (3, 2), (0, 8))},
        {"out": np.lib.stride_tricks.as_strided(rows, (3, 2), (8, 8))},
    ]
    for change in shared:
        with refused(UsageError):
            batch.step(**{"q": q, "v": q, "ref": ref, **change})
        with pytest.raises(UsageError):  # again, where the batch has seen the arrays
            batch.step(**{"q": q, "v": q, "ref": ref, **change})
    for mask in (np.ones(2, dtype=bool), np.ones(3)):
        with refused(ShapeError):
            batch.reset(mask)
    assert batch.memory["lane.ticks"].tolist() == [0.0, 0.0, 0.0]


def test_parameters_that_mean_nothing_are_refused_with_their_lane() -> None:
    ctrl = taut.compile(L.PID(kp=[1.0, 2.0]), taut.load_arm("planar2"))
    batch = ctrl.batch(3)
    inertia = np.zeros((3, 6))
    inertia[1, 0] = 1.0
    wrong: list[tuple[Any, str, Any]] = [
        (RangeError, "law.kp", [[1.0, 2.0], [3.0, 4.0], [5.0, -6.0]]),
        (RangeError, "model.payload.mass", [1.0, math.nan, 1.0]),
        (RangeError, "model.payload.inertia", inertia),
        (ShapeError, "law.kp", np.ones((2, 2, 2))),
        (ShapeError, "law.kd", np.ones((3, 2))),
        (ShapeError, "law.kd", [[1.0, 2.0], [3.0]]),
        (ShapeError, "model.payload.com", np.ones((4, 3))),
        (UnknownNameError, "law.kq", 1.0),
    ]
    for kind, path, value in wrong:
        before = dict(batch.parameters)
        with refused(kind):
            batch.parameters[path] = value
        for name, kept in before.items():
            np.testing.assert_array_equal(batch.parameters[name], kept)


def test_a_batch_is_neither_copied_nor_pickled() -> None:
    batch = taut.compile(L.PID(kp=1.0), taut.load_arm("planar2")).batch(2)
    for make in (copy.copy, copy.deepcopy, pickle.dumps):
        with refused(UsageError):
            make(batch)


def test_batches_that_cannot_be_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(L.PID(kp=1.0), arm)
    for arguments in (
        {"n": 0},
        {"n": 2.5},
        {"n": 10**15},
        {"n": 3, "device": "gpu"},
        {"n": 3, "real": "half"},
        {"n": 3, "threads": 0},
    ):
        with refused((UsageError, RangeError)):
            ctrl.batch(**arguments)
    with refused(UsageError):
        taut.compile(L.PID(kp=1.0), arm, engine="float").batch(3)
    with refused(UsageError):
        taut.compile([taut.Phase(L.PID(kp=1.0), taut.hold())], arm).batch(3)
    monkeypatch.setitem(sys.modules, "torch", None)
    with refused(MissingExtraError):
        taut.tensors.differentiable(ctrl)
    for other in (arm, taut.compile(L.PID(kp=1.0), arm, engine="float")):
        with refused(UsageError):
            taut.tensors.differentiable(other)
