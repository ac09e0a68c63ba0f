"""Kernels of a GPU: their PTX, run instruction by instruction, has the bits of lanes of the CPU; and what is refused."""

from __future__ import annotations

import gc
import importlib
import math
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ptx_machine import Driver
from refusals import refused

import taut
from taut.codegen import cuda
from taut.errors import MissingExtraError, RangeError, ShapeError, UsageError
from taut.maths.spatial import rotation_exp

L = taut.laws
N = 37  # no multiple of any number of lanes or threads


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Iterator[Driver]:
    driver = Driver()
    for name, module in driver.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    cuda.gpu.cache_clear()
    yield driver
    cuda.gpu.cache_clear()


class OnGpu:
    """An array that states that it is on the GPU, by DLPack of today or as before version 1.0."""

    def __init__(self, array: Any, *, versioned: bool = True, number: int = 0) -> None:
        self.array, self.versioned, self.number, self.streams = array, versioned, number, list[Any]()

    def __dlpack_device__(self) -> tuple[int, int]:
        return 2, self.number

    def __dlpack__(self, *, stream: Any = None, **more: Any) -> Any:
        if more and not self.versioned:
            raise TypeError("__dlpack__() got an unexpected keyword argument 'max_version'")
        self.streams.append(stream)
        if not self.versioned:
            return self.array.__dlpack__()
        capsule = self.array.__dlpack__(max_version=(1, 0))
        assert cuda._NAME(capsule) == b"dltensor_versioned"
        return capsule


class Stated(OnGpu):
    """Before version 1.0, with the other interface, which states that it may be written."""

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        return {"data": (self.array.ctypes.data, False)}


def everything(ctrl: Any, n: int, seed: int, dtype: Any) -> dict[str, Any]:
    """Arrays of all that a tick takes, by the arguments of `step`."""
    rng, joints = np.random.default_rng(seed), ctrl.arm.n
    given = {"q": ctrl.arm.home + 0.2 * rng.standard_normal((n, joints))}
    sizes = {"F_ext": 6}
    given |= {name: 0.3 * rng.standard_normal((n, sizes.get(name, joints))) for name in ctrl.side.takes}
    fields = ctrl.law.reference.fields(joints)
    ref = {name: 0.3 * rng.standard_normal((n, *shape)) for name, shape in fields.items()}
    if "R" in fields:
        ref["R"] = np.array([rotation_exp(row) for row in rng.standard_normal((n, 3))])
    return {
        **{name: x.astype(dtype) for name, x in given.items()},
        "ref": {k: x.astype(dtype) for k, x in ref.items()},
    }


CASES: dict[str, tuple[Any, str, dict[str, Any], str]] = {
    "limits": (
        L.PID(kp=[90.0, 40.0], kd=3.0, ki=5.0), "planar2",
        {"limits": taut.Limits(tau=[20.0, 8.0], tau_dot=[2e3, 1e3], blend=0.1)}, "law.kp",
    ),
    "difference": (L.GravityPID(kp=50.0, kd=5.0), "gantry3", {"sensing": taut.Sensing(velocity="difference")}, "law.kp"),
    "payload": (L.ComputedTorque(kp=100.0, kd=20.0, ki=9.0), "ur5", {}, "model.payload.mass"),
    "mit": (L.ViaMit(law=L.PID(kp=20.0)), "planar2", {}, "law.kp"),
    "impedance": (L.Impedance(K=(400.0, 20.0), zeta=1.0), "xarm7", {}, "law.K"),
    "force": (
        L.Admittance(inner=L.TaskComputedTorque(kp=900.0, kd=60.0), D=(2.0, 0.1), K=(100.0, 5.0), zeta=1.0),
        "ur5", {}, "law.K",
    ),
}  # fmt: skip


@pytest.mark.part(1)
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("case", CASES)
def test_each_thread_has_the_bits_of_a_lane(case: str, real: Any, driver: Driver) -> None:
    law, arm, options, path = CASES[case]
    ctrl = taut.compile(law, taut.load_arm(arm), **options)
    here, there = ctrl.batch(N, real=real), ctrl.batch(N, real=real, device="cuda")
    base = np.asarray(ctrl.side.parameters[path]) + (1.0 if path.endswith("mass") else 0.0)
    for batch in (here, there):
        batch.parameters[path] = np.multiply.outer(np.linspace(0.5, 2.0, N), base)
    out = np.zeros((N + 1, 40), dtype=here.dtype)
    shape = there._command.shape
    room = out[:N, : math.prod(shape)].reshape(N, *shape)
    for tick in range(4):
        given = everything(ctrl, N, tick, here.dtype)
        if tick == 1:
            given["q"][[0, 20, N - 1], 1] = [math.nan, math.inf, -math.inf]
        if tick == 2:
            mask = np.arange(N) % 3 == 0
            here.reset(mask)
            there.reset(OnGpu(mask))
        expected = here.step(**given)
        ref = {name: OnGpu(x, versioned=tick > 0) for name, x in given.pop("ref").items()}
        there.step(**{name: OnGpu(x) for name, x in given.items()}, ref=ref, out=OnGpu(room))
        np.testing.assert_array_equal(room, expected)
        np.testing.assert_array_equal(there.finite.numpy(), here.finite)
        assert here.finite.all() == (tick != 1)
        for name, value in here.memory.items():
            np.testing.assert_array_equal(there.memory[name].numpy(), value)
    assert not out[N].any()
    assert np.abs(expected).max() > 0.1
    for room_of, size in driver.memory.values():  # nothing was written beyond what is ours
        start = -room_of.ctypes.data % 8
        assert (room_of[start + size :] == 0xFF).all()


@pytest.mark.parametrize(("real", "tiny", "factor"), [("float", 1e-40, 0.0), ("double", 1e-320, 1.0)])
def test_what_is_below_normal_numbers_is_zero_in_single_precision(
    real: Any, tiny: float, factor: float, driver: Driver
) -> None:
    state = np.full((3, 2), tiny, dtype=np.float32 if real == "float" else np.float64)
    ref = taut.JointMotion(q=[0.0, 0.0])
    expected = of_pid().batch(3, real=real).step(state, state, ref)
    assert (expected == -factor * state).all()
    command = of_pid().batch(3, real=real, device="cuda").step(OnGpu(state), OnGpu(state), ref)
    np.testing.assert_array_equal(command.numpy(), expected)


def test_numbers_may_lie_any_one_distance_apart(driver: Driver) -> None:
    ctrl = taut.compile(L.PID(kp=7.0, kd=2.0), taut.load_arm("planar2"))
    batch, state = ctrl.batch(3, device="cuda"), np.random.default_rng(0).standard_normal((8, 3))
    out, goal = np.zeros((2, 3)), {name: OnGpu(np.zeros(2)) for name in "qva"}
    batch.step(OnGpu(state[:2].T), OnGpu(state[2:6:2].T), goal, out=OnGpu(out.T))
    np.testing.assert_allclose(out, -7.0 * state[:2] - 2.0 * state[2:6:2], rtol=1e-14)
    other = np.zeros((3, 2))
    batch.step(OnGpu(state[:2].T), OnGpu(state[2:6:2].T), goal, out=Stated(other, versioned=False))
    np.testing.assert_array_equal(other, out.T)
    made = batch.step(OnGpu(state[:2].T), OnGpu(state[2:6:2].T), goal)
    np.testing.assert_array_equal(made.numpy(), out.T)
    again = batch.step(made, made, taut.JointMotion(q=[0.0, 0.0]))  # what one batch makes, another one reads
    np.testing.assert_allclose(again.numpy(), -9.0 * out.T, rtol=1e-14)


def test_work_is_queued_on_the_stream_of_torch_and_what_makes_a_tensor_before_it(
    driver: Driver, monkeypatch: pytest.MonkeyPatch
) -> None:
    batch, q, ref = of_pid().batch(3, device="cuda"), OnGpu(np.ones((3, 2))), taut.JointMotion(q=[0.0, 0.0])
    batch.step(q, q, ref)
    assert set(driver.streams) == {1}
    assert q.streams == [1, 1]
    driver.streams.clear()
    torch = types.SimpleNamespace(
        cuda=types.SimpleNamespace(
            is_initialized=lambda: True, current_stream=lambda device: types.SimpleNamespace(cuda_stream=77)
        )
    )
    monkeypatch.setitem(sys.modules, "torch", torch)
    command = batch.step(q, q, ref)
    assert (command.numpy() == -1.0).all()
    assert set(driver.streams) == {77}
    assert q.streams[2:] == [77, 77]
    assert command.__cuda_array_interface__["stream"] == 77


def of_pid() -> Any:
    return taut.compile(L.PID(kp=1.0), taut.load_arm("planar2"))


def test_memory_is_given_back_and_a_sample_is_sent_once(driver: Driver) -> None:
    batch, q, ref = of_pid().batch(3, device="cuda"), OnGpu(np.ones((3, 2))), taut.JointMotion(q=[2.0, 2.0])
    first = batch.step(q, q, ref)
    before, queued = len(driver.memory), len(driver.streams)
    out = OnGpu(np.zeros((3, 2)))
    batch.step(q, q, ref, out=out)
    assert len(driver.streams) == queued + 1  # the kernel alone
    assert (out.array == first.numpy()).all()
    batch.step(q, q, taut.JointMotion(q=[3.0, 3.0]), out=out)
    assert (out.array == 2.0).all()
    assert len(driver.memory) == before
    about = first.__cuda_array_interface__
    assert about["data"] == (first.address, False)
    assert (about["shape"], about["strides"], about["typestr"]) == ((3, 2), (8, 24), "<f8")
    del batch, first
    gc.collect()
    assert not driver.memory
    assert driver.depth == 0


def test_gains_on_the_gpu_are_checked(driver: Driver) -> None:
    batch, q = of_pid().batch(3, device="cuda"), OnGpu(np.zeros((3, 2)))
    ref = taut.JointMotion(q=[1.0, 1.0])
    batch.parameters["law.kp"] = OnGpu(np.array([[1.0, 5.0, 9.0], [2.0, 6.0, 9.0]]).T[:, 0])
    np.testing.assert_array_equal(batch.step(q, q, ref).numpy()[:, 1], [1.0, 5.0, 9.0])
    with refused(RangeError):
        batch.parameters["law.kp"] = OnGpu(np.array([1.0, -5.0, 9.0]))
    np.testing.assert_array_equal(batch.parameters["law.kp"], [1.0, 5.0, 9.0])
    batch.parameters["law.kp"] = 3.0
    assert (batch.step(q, q, ref).numpy() == 3.0).all()


# -------------------------------------------------------------------- sweeps

PLANAR = taut.load_arm("planar2")


def free() -> taut.Loop:
    ctrl = taut.compile(L.ComputedTorque(kp=100.0, kd=20.0), PLANAR)
    ref = taut.trajectories.Sine(center=PLANAR.home, amplitude=0.3, frequency=1.0)
    return taut.Loop(ctrl, taut.RigidPlant(PLANAR), ref, duration=0.019)


def noisy() -> taut.Loop:
    """Noise, friction that sticks, limits, and two steps of the integrator a tick."""
    encoder = taut.sensors.Encoder(resolution=1e-6, noise=1e-4)
    arm = PLANAR.with_friction(taut.Friction(viscous=0.1, coulomb=0.2, static=0.3, stribeck=0.1))
    ctrl = taut.compile(
        L.GravityPID(kp=[50.0, 40.0], kd=5.0, ki=20.0), PLANAR, limits=taut.Limits(tau=[4.0, 2.0], tau_dot=100.0),
        sensing=taut.Sensing(velocity=taut.sensors.Difference(cutoff=60.0)),
    )  # fmt: skip
    plant = taut.RigidPlant(arm, sensors=taut.sensors.Sensors(position=encoder, velocity=None), substeps=2)
    return taut.Loop(ctrl, plant, taut.JointMotion(q=PLANAR.home + 0.1), duration=0.019)


U = taut.uniform
SWEEPS: dict[str, tuple[Any, dict[str, Any], dict[str, Any]]] = {
    "gains, payload and state": (
        free, {"law.kp": U(50.0, 400.0), "plant.payload.mass": U(0.0, 2.0), "q0": U([-0.3, 0.2], [0.3, 1.0])}, {},
    ),
    "noise, friction, limits, sub-steps": (noisy, {"law.kp[1]": U(20.0, 80.0)}, {}),
    "a reference of each": (free, {"ref.amplitude": U(0.1, 0.4)}, {}),
    "some that diverge": (free, {"law.kd": np.where(np.arange(40) % 7, np.linspace(10.0, 30.0, 40), 1e30)}, {}),
    "whole runs": (free, {"law.kp": U(50.0, 400.0)}, {"metrics": ["settling_time", "rms_error"]}),
}  # fmt: skip


@pytest.mark.part(4)
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("case", SWEEPS)
def test_a_sweep_on_the_gpu_is_that_of_lanes(case: str, real: Any, driver: Driver) -> None:
    make, vary, more = SWEEPS[case]
    here, there = (taut.sweep(make(), vary, samples=40, real=real, device=name, **more) for name in ("cpu", "cuda"))
    assert here.table.keys() == there.table.keys()
    for name, column in here.table.items():
        np.testing.assert_array_equal(there.table[name], column, err_msg=name)
    assert len(np.unique(here.table["rms_error"])) > 20
    assert set(here.table["outcome"]) == {"completed"} | ({"diverged"} if "diverge" in case else set())
    gc.collect()
    assert not driver.memory


def test_sweeps_on_the_gpu_that_cannot_be_are_refused(driver: Driver) -> None:
    with refused(UsageError):
        taut.sweep(free(), {}, samples=2, device="gpu")
    with refused(UsageError):
        taut.sweep(free(), {}, samples=2, device="cuda", ray="auto")
    ctrl = taut.compile(L.PID(kp=1.0), PLANAR, engine="float")
    loop = taut.Loop(ctrl, taut.RigidPlant(PLANAR), taut.hold(), duration=0.01)
    with refused(UsageError):
        taut.sweep(loop, {}, samples=2, device="cuda")


@pytest.mark.long
def test_the_benchmark_compares_and_times(driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    monkeypatch.setattr(driver, "cuDeviceGetName", lambda size, device: (0, b"none\0"), raising=False)
    benchmark = importlib.import_module("gpu")
    assert benchmark.main(n=33, samples=32, ticks=3, rounds=1, warps=1) == 0


# -------------------------------------------------------------------- refusals


class Gradient(OnGpu):
    def __dlpack__(self, **_: Any) -> Any:
        raise BufferError("Can't export tensors that require gradient, use tensor.detach()")


class Brain(OnGpu):
    """A tensor of bfloat16."""

    def __dlpack__(self, **more: Any) -> Any:
        capsule = super().__dlpack__(**more)
        cuda._Versioned.from_address(cuda._POINTER(capsule, b"dltensor_versioned")).tensor.code = 4
        return capsule


def test_tensors_that_cannot_be_read_where_they_are_are_refused(driver: Driver) -> None:
    batch, q, ref = of_pid().batch(3, device="cuda"), np.zeros((3, 2)), taut.JointMotion(q=[0.0, 0.0])
    frozen = np.zeros((3, 2))
    frozen.flags.writeable = False
    shifted = np.zeros(56, dtype=np.uint8)[4:52].view(np.float64).reshape(3, 2)
    wrong: list[tuple[Any, dict[str, Any]]] = [
        (UsageError, {"q": q}),
        (UsageError, {"ref": {"q": q, "v": q, "a": q}}),
        (UsageError, {"q": [[0.0, 0.0]] * 3}),
        (UsageError, {"q": OnGpu(q, number=1)}),
        (UsageError, {"q": Gradient(q)}),
        (UsageError, {"q": OnGpu(q.astype(np.float32))}),
        (UsageError, {"q": Brain(q.astype(np.float16))}),
        (UsageError, {"q": OnGpu(shifted)}),
        (UsageError, {"out": OnGpu(frozen)}),
        (UsageError, {"out": OnGpu(q, versioned=False)}),
        (ShapeError, {"q": OnGpu(np.zeros((4, 2)))}),
        (ShapeError, {"out": OnGpu(np.zeros(2))}),
    ]
    for kind, change in wrong:
        with refused(kind):
            batch.step(**{"q": OnGpu(q), "v": OnGpu(q), "ref": ref, **change})
    for mask in (OnGpu(np.ones(2, dtype=bool)), OnGpu(np.ones(3)), np.ones(3)):
        with refused(ShapeError):
            batch.reset(mask)
    uneven = taut.compile(L.TaskComputedTorque(kp=1.0, kd=1.0), taut.load_arm("ur5")).batch(3, device="cuda")
    fields = {name: OnGpu(np.zeros((3, *shape))) for name, shape in uneven.side.law.reference.fields(6).items()}
    fields["R"] = OnGpu(np.zeros((3, 3, 4))[:, :, :3])
    with refused(UsageError):
        uneven.step(OnGpu(np.zeros((3, 6))), OnGpu(np.zeros((3, 6))), fields)
    assert (batch.memory["lane.ticks"].numpy() == 0.0).all()


def test_a_machine_without_a_gpu_is_refused(monkeypatch: pytest.MonkeyPatch, driver: Driver) -> None:
    ctrl = of_pid()
    with refused(UsageError):
        ctrl.batch(3, device="cuda", threads=2)
    driver.devices = 0
    with refused(UsageError):
        ctrl.batch(3, device="cuda")

    def no_library(flags: int) -> Any:
        raise RuntimeError('"cuda" is an NVIDIA driver library and can only be found via system search.')

    monkeypatch.setattr(driver, "cuInit", no_library)
    with refused(UsageError):
        ctrl.batch(3, device="cuda")
    monkeypatch.setitem(sys.modules, "cuda.bindings", None)
    monkeypatch.setattr(cuda.ctypes, "CDLL", lambda name: name)
    with refused(MissingExtraError):
        ctrl.batch(3, device="cuda")

    def no_file(name: str) -> Any:
        raise OSError(name)

    monkeypatch.setattr(cuda.ctypes, "CDLL", no_file)
    with refused(UsageError):
        ctrl.batch(3, device="cuda")


def test_a_failure_of_the_driver_is_an_error_with_its_name(driver: Driver) -> None:
    with refused(taut.errors.TautError):
        of_pid().batch(10**8, device="cuda")
