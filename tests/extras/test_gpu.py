"""Kernels of a GPU: NVIDIA's assembler takes each, and where there is a GPU they have the bits of the CPU."""

from __future__ import annotations

import importlib.util
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.codegen import cuda
from taut.errors import TautError

L = taut.laws
ARCHITECTURES = ("sm_75", "sm_80", "sm_90", "sm_100", "sm_120")
TOOL = L.TaskComputedTorque(kp=900.0, kd=60.0)
LAWS: dict[str, tuple[Any, str]] = {
    "PID": (L.PID(kp=50.0, kd=5.0, ki=9.0), "one_joint"),
    "gravity": (L.GravityPID(kp=50.0, kd=5.0), "gantry3"),
    "computed torque": (L.ComputedTorque(kp=100.0, kd=20.0, ki=9.0), "panda"),
    "at the tool": (TOOL, "ur5"),
    "impedance with B": (L.Impedance(K=(400.0, 20.0), B=(40.0, 4.0)), "panda"),
    "impedance with zeta": (L.Impedance(K=(400.0, 20.0), zeta=1.0), "xarm7"),
    "admittance": (L.Admittance(inner=TOOL, D=(2.0, 0.1), K=(100.0, 5.0), zeta=1.0), "ur10"),
    "MIT": (L.ViaMit(law=L.PID(kp=20.0)), "planar2"),
}


def no_gpu() -> str:
    """Why nothing runs on a GPU here; "" where there is one."""
    try:
        cuda.gpu()
    except TautError as reason:
        return str(reason)
    return ""


WITHOUT = no_gpu()


@pytest.fixture(scope="module")
def ptxas() -> Path:
    found = importlib.util.find_spec("nvidia")
    folders = [] if found is None else [Path(folder) for folder in found.submodule_search_locations or ()]
    files = [file for folder in folders for file in folder.rglob("bin/ptxas")]
    if not files:
        pytest.skip("nvidia-cuda-nvcc, which has ptxas, is not installed")
    return files[0]


class Kept(Exception):  # noqa: N818
    """PTX that was to be loaded."""


class Nowhere:
    """In the place of the driver: keeps the PTX."""

    def functions(self, text: str, *names: str) -> Any:
        raise Kept(text)


def assembled(ptxas: Path, text: str, folder: Path) -> None:
    (folder / "kernel.ptx").write_text(text, encoding="utf-8")
    for architecture in ARCHITECTURES:
        command = [ptxas, f"-arch={architecture}", "--warning-as-error", "kernel.ptx", "-o", f"{architecture}.cubin"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert (folder / f"{architecture}.cubin").stat().st_size > 1000
    assert ".local" not in text  # all that a thread remembers within a tick is in registers, until ptxas spills some
    assert "call" not in text
    assert ".extern" not in text


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("law", LAWS)
def test_the_assembler_takes_the_kernels_of_a_batch(
    law: str, real: Any, ptxas: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, arm = LAWS[law]
    monkeypatch.setattr(cuda, "gpu", Nowhere)
    with pytest.raises(Kept) as kept:
        taut.compile(made, taut.load_arm(arm)).batch(100, device="cuda", real=real)
    assembled(ptxas, str(kept.value), tmp_path)


def loop(arm: taut.Arm) -> taut.Loop:
    ctrl = taut.compile(L.ComputedTorque(kp=100.0, kd=20.0), arm)
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(noise=1e-5))
    ref = taut.trajectories.Sine(center=arm.home, amplitude=0.3, frequency=1.0)
    return taut.Loop(ctrl, taut.RigidPlant(arm, sensors=sensors), ref, duration=0.199)


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_assembler_takes_the_kernel_of_a_sweep(
    real: Any, ptxas: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cuda, "gpu", Nowhere)
    with pytest.raises(Kept) as kept:
        taut.sweep(loop(taut.load_arm("panda")), {}, samples=100, device="cuda", real=real)
    assembled(ptxas, str(kept.value), tmp_path)


def test_every_function_of_the_driver_that_is_called_exists() -> None:
    driver = pytest.importorskip("cuda.bindings.driver")
    source = Path(cuda.__file__).read_text(encoding="utf-8")
    names = {
        word for word in source.replace('"', " ").replace(".", " ").replace("(", " ").split() if word[:3] == "cuM"
    }
    assert {"cuMemAlloc", "cuModuleLoadData"} <= names
    assert all(hasattr(driver, name) for name in (*names, "cuInit", "cuLaunchKernel", "cuStreamSynchronize"))


# -------------------------------------------------------------------- with a GPU


@pytest.mark.skipif(bool(WITHOUT), reason=f"there is no GPU: {WITHOUT}")
@pytest.mark.parametrize("law", LAWS)
def test_a_gpu_has_the_bits_of_the_cpu(law: str) -> None:
    torch = pytest.importorskip("torch")
    made, arm = LAWS[law]
    ctrl = taut.compile(made, taut.load_arm(arm))
    n, joints = 1000, ctrl.arm.n
    rng, ref = np.random.default_rng(0), ctrl.side.at_rest(ctrl.arm.home)
    here, there = ctrl.batch(n), ctrl.batch(n, device="cuda")
    sizes = {"F_ext": 6}
    for tick in range(3):
        given = {"q": ctrl.arm.home + 0.2 * rng.standard_normal((n, joints))}
        given |= {name: 0.3 * rng.standard_normal((n, sizes.get(name, joints))) for name in ctrl.side.takes}
        on_gpu = {name: torch.tensor(value, device="cuda") for name, value in given.items()}
        if tick == 1:
            mask = rng.uniform(size=n) < 0.5
            here.reset(mask)
            there.reset(torch.tensor(mask, device="cuda"))
        out = torch.empty((n, *here._command.shape), dtype=torch.float64, device="cuda")
        there.step(**on_gpu, ref=ref, out=out)
        np.testing.assert_array_equal(out.cpu().numpy(), here.step(**given, ref=ref))
        np.testing.assert_array_equal(torch.as_tensor(there.finite, device="cuda").cpu().numpy(), here.finite)
    for name, value in here.memory.items():
        np.testing.assert_array_equal(there.memory[name].numpy(), value)


@pytest.mark.skipif(bool(WITHOUT), reason=f"there is no GPU: {WITHOUT}")
def test_a_sweep_on_a_gpu_has_the_bits_of_the_cpu() -> None:
    made = loop(taut.load_arm("panda"))
    vary = {"law.kp": taut.uniform(50.0, 400.0), "plant.payload.mass": taut.uniform(0.0, 2.0)}
    here, there = (taut.sweep(made, vary, samples=1000, device=device) for device in ("cpu", "cuda"))
    for name, column in here.table.items():
        np.testing.assert_array_equal(there.table[name], column, err_msg=name)
