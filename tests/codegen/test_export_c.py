"""Exported C: compiled with every warning an error, it gives what Python gives; its names are taut's paths."""

from __future__ import annotations

import ctypes
import dataclasses
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import taut
from taut.codegen.c import SINGLE, Struct
from taut.codegen.program import Block
from taut.scenarios.scenario import load_scenario

L, TM = taut.laws, taut.math
CC = shutil.which("cc")
COMPILERS = {"gcc": ("gcc", "-O1"), "clang": ("clang", "-O0")}  # clang warns alike at any level
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
compiled = pytest.mark.skipif(CC is None, reason="needs a C compiler: apt-get install gcc")


class Bare(taut.Law):
    """A law of a user without memory, that needs neither velocity nor model, and uses every function."""

    ignores_reference = True
    default: taut.Gain = taut.Gain(unit="N m")  # a keyword of C

    def command(self, x: taut.Snapshot, ref: object) -> taut.Torque:
        q, k = x.q, self.default
        a = TM.tanh(q) + TM.exp(-q * q) + TM.log(2.0 + q * q) + TM.atan2(q, 1.0 + q * q)
        b = TM.asin(0.1 * q) + TM.acos(0.1 * q) + TM.floor(3.0 * q) + TM.maximum(q, TM.minimum(0.2, q * q))
        return taut.Torque(P=k * TM.where((q > 0.0) & ~(q > 0.5), a, b))


def board(arm: taut.Arm) -> taut.Constraint:
    return taut.Constraint.plane(point=taut.snapshot(arm, arm.home).T().p, normal=[0.0, 0.0, 1.0])


LAWS: dict[str, Callable[[taut.Arm], taut.Law]] = {
    "computed torque": lambda arm: L.ComputedTorque(kp=100.0, kd=20.0, ki=5.0),
    "PID": lambda arm: L.PID(kp=100.0, kd=20.0, ki=5.0),
    "impedance": lambda arm: L.Impedance(K=(400.0, 20.0), zeta=1.0),
    "hybrid": lambda arm: L.HybridMotionForce(
        constraint=board(arm), motion=L.TaskComputedTorque(kp=400.0, kd=40.0), kfi=5.0, kdamp=10.0
    ),
    "adaptive": lambda arm: L.Adaptive(lam=5.0, k=10.0, gamma=1.0, max_payload=3.0),
    "MIT": lambda arm: L.ViaMit(law=L.PID(kp=100.0, kd=10.0), kp_motor=10.0, kd_motor=1.0),
    "sum": lambda arm: L.PID(kp=9.0) + L.FrictionCompensation(at="ref"),
    "bare": lambda arm: Bare(default=2.0),
}
ARM_OF = {"hybrid": "xarm7", "impedance": "panda", "adaptive": "ur10", "sum": "panda"}


def controller(name: str) -> taut.Controller:
    arm = taut.load_arm(ARM_OF.get(name, "planar2"))
    if name == "sum":
        arm = arm.with_friction(taut.Friction(viscous=0.3, coulomb=0.3))
    limits = taut.Limits.of(arm, rate=True, blend=0.5) if name == "impedance" else None
    sensing = taut.Sensing(velocity=taut.sensors.Difference(cutoff=60.0)) if name == "PID" else None
    return taut.compile(LAWS[name](arm), arm, limits=limits, sensing=sensing)


def build(ctrl: taut.Controller, folder: Path, *flags: str, real: str = "double") -> ctypes.CDLL:
    """The exported code as a library."""
    taut.export_c(ctrl, folder, real=real)
    library = folder / "ctrl.so"
    command = [str(CC), *STRICT, "-O1", "-shared", "-fPIC", *flags, "-o", str(library), str(folder / "ctrl.c"), "-lm"]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return ctypes.CDLL(str(library))


def pointers(*blocks: np.ndarray) -> list[ctypes.c_void_p]:
    return [ctypes.c_void_p(block.ctypes.data) for block in blocks]


# -------------------------------------------------------------------- numbers


@pytest.mark.part(2)
@compiled
@pytest.mark.parametrize("compiler", [name for name in COMPILERS if shutil.which(name)])
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("name", LAWS)
def test_its_own_test_passes_with_every_warning_an_error(name: str, real: str, compiler: str, tmp_path: Path) -> None:
    files = taut.export_c(controller(name), tmp_path, prefix="arm_law", real=real)
    assert all("SPDX-License-Identifier: Apache-2.0" in file.read_text(encoding="utf-8") for file in files)
    cc, level = COMPILERS[compiler]
    words = ["make", "-s", "test", f"CC={cc}", f"CFLAGS={level} {' '.join(STRICT)}"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("16 ticks: at most ")


@compiled
@pytest.mark.parametrize("name", ["bare", "sum"])
def test_it_calls_math_and_nothing_that_allocates(name: str, tmp_path: Path) -> None:
    taut.export_c(controller(name), tmp_path)
    subprocess.run([str(CC), "-O1", "-c", "ctrl.c"], cwd=tmp_path, check=True)
    listed = subprocess.run(["nm", "-u", "ctrl.o"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    called = set(listed.split()) - {"U", "_GLOBAL_OFFSET_TABLE_"}
    copies = {"memcpy", "memset"}  # of structs, which any C has
    assert called <= copies | {"fabs", "floor", "fma", "ldexp", "logb", "sqrt"}


@pytest.mark.part(1)
@compiled
@pytest.mark.parametrize("name", ["computed torque", "impedance", "hybrid"])
def test_it_gives_the_bits_of_machine_code(name: str, tmp_path: Path) -> None:
    """With one rounding for products in sums, as machine code has; a hundred ticks near home, memory included."""
    ctrl = controller(name)
    code, kernel, side = build(ctrl, tmp_path, "-DTAUT_EXACT", "-fno-tree-slp-vectorize"), ctrl._kernel, ctrl.side
    layout = kernel.blocks.layout
    for block in layout.values():  # of these laws the members of the structs stand in the order of the blocks
        struct = Struct(block)
        assert [struct.place(i) for i in range(block.size)] == list(
            dict.fromkeys(map(struct.place, range(block.size)))
        )
    rng, home = np.random.default_rng(1), taut.snapshot(ctrl.arm, ctrl.arm.home).T()
    inputs, memory = kernel.blocks.inputs.copy(), np.zeros(layout["memory"].size)
    outputs, parameters = np.zeros(layout["outputs"].size), kernel.blocks.parameters
    views = layout["inputs"].views(inputs)
    k = ctrl.bind()
    for tick in range(100):
        views["t"][...] = tick * ctrl.dt
        k.q[:] = views["q"][...] = side.arm.home + (0.1 if tick else 0.0) * rng.standard_normal(side.arm.n)
        k.v[:] = views["v"][...] = rng.standard_normal(side.arm.n)
        if "ref.p" in views:
            k.ref.p[:] = views["ref.p"][...] = home.p
            k.ref.R[:] = views["ref.R"][...] = home.R
        k.tick()
        if tick == 0:
            code.ctrl_start(*pointers(inputs, parameters, memory))
        assert code.ctrl_step(*pointers(inputs, parameters, memory, outputs)) == 0
        np.testing.assert_array_equal(outputs[: k.command.size], k.command)
        np.testing.assert_array_equal(memory, kernel.blocks.memory)


@compiled
def test_a_blend_takes_up_a_gain_that_changes(tmp_path: Path) -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(L.PID(kp=100.0, kd=20.0), arm, limits=taut.Limits(blend=0.1))
    code, layout = build(ctrl, tmp_path, "-DTAUT_EXACT"), ctrl._kernel.blocks.layout
    rows = {name: np.zeros(layout[name].size) for name in layout}
    rows["parameters"][:] = ctrl._kernel.blocks.parameters
    inputs, memory = layout["inputs"].views(rows["inputs"]), rows["memory"]
    q, ref = np.array([0.1, -0.2]), taut.JointMotion(q=[0.3, 0.1])
    inputs["q"][:], inputs["ref.q"][:] = q, ref.q
    old = rows["parameters"].copy()
    for tick in range(60):
        inputs["t"][...] = tick * ctrl.dt
        if tick == 20:
            ctrl.parameters["law.kp"] = 300.0
            layout["parameters"].views(rows["parameters"])["law.kp"][...] = 300.0
            code.ctrl_change(*pointers(rows["inputs"], rows["parameters"], old, memory))
        if tick == 0:
            code.ctrl_start(*pointers(rows["inputs"], rows["parameters"], memory))
        assert code.ctrl_step(*pointers(rows["inputs"], rows["parameters"], memory, rows["outputs"])) == 0
        np.testing.assert_allclose(rows["outputs"], ctrl.step(q, np.zeros(2), ref), rtol=1e-14)


@compiled
def test_a_tick_without_numbers_leaves_everything_as_it_was(tmp_path: Path) -> None:
    ctrl = controller("computed torque")
    code, layout = build(ctrl, tmp_path), ctrl._kernel.blocks.layout
    inputs, parameters, memory, outputs = (np.full(layout[name].size, 0.1) for name in layout)
    kept = memory.copy(), outputs.copy()
    for path, view in layout["inputs"].views(inputs).items():
        for bad in (np.nan, np.inf):
            before = view.copy()
            view.flat[-1] = bad
            assert code.ctrl_step(*pointers(inputs, parameters, memory, outputs)) == 1, path
            view[...] = before
    layout["inputs"].views(inputs)["ref.q"][...] = 1e200
    parameters[0] = 1e200
    assert code.ctrl_step(*pointers(inputs, parameters, memory, outputs)) == 2
    np.testing.assert_array_equal(np.concatenate([memory, outputs]), np.concatenate(kept))


# -------------------------------------------------------------------- names


def test_members_are_the_paths_with_units(tmp_path: Path) -> None:
    taut.export_c(controller("impedance"), tmp_path)
    header = (tmp_path / "ctrl.h").read_text(encoding="utf-8")
    for line in (
        "double K[6];  /* law.K [N/m, N m/rad] */",
        "double mass;  /* model.payload.mass [kg] */",
        "double R[3][3];  /* ref.R [rotation: its columns are the tool's axes in the world] */",
        "double command[7];  /* command [N m | N] */",
        "double tau_applied[7];  /* limits.tau_applied [N m | N] */",
        "double phase;  /* limits.phase [1] */",
        'X("law.K", law.K, 6)',
        'X("model.payload.mass", model.payload.mass, 1)',
    ):
        assert line in header
    assert "panda_joint1 [rad]" in header


def test_words_of_c_and_digits_become_identifiers() -> None:
    words = {"law.default": (), "law.0.kp": (2,), "law.a-b": (3, 3), "law.nothing": (0,), "law.new": ()}
    struct = Struct(Block.of(words))
    assert struct.place(0) == "law.default_"
    assert struct.place(2) == "law._0.kp[1]"
    assert struct.place(11) == "law.a_b[2][2]"
    assert struct.place(12) == "law.new_"  # of C++
    assert list(struct.paths())[:2] == [("law.default", "law.default_", 1), ("law.0.kp", "law._0.kp", 2)]
    text = "\n".join(struct.definition("t", "float", {"law.default": "N m"}))
    assert "float default_;  /* law.default [N m] */" in text
    assert "nothing" not in text


def test_two_paths_of_one_name_in_c_are_refused() -> None:
    with refused(taut.errors.UsageError):
        Struct(Block.of({"law.a-b": (), "law.a_b": ()}))


def test_names_of_a_model_do_not_end_a_comment(tmp_path: Path) -> None:
    arm = dataclasses.replace(taut.load_arm("planar2"), name="*/ int evil; /*\nx")
    taut.export_c(taut.compile(L.PID(kp=1.0), arm), tmp_path)
    for name in ("ctrl.h", "ctrl.c", "ctrl_test.c"):
        head = (tmp_path / name).read_text(encoding="utf-8").split("\n")[:4]
        assert "\n".join(head).count("*/") == 1
        assert "arm '* / int evil; /*\\nx'" in head[1]


@pytest.mark.long
@compiled
def test_two_arms_side_by_side(tmp_path: Path) -> None:
    scenario = load_scenario("two_arms")
    taut.export_c(scenario.experiment.controller(scenario.laws["both"]), tmp_path)
    assert "double left_R[3][3];  /* ref.left_R [rotation: its" in (tmp_path / "ctrl.h").read_text(encoding="utf-8")
    flags = f"CFLAGS=-O1 {' '.join(STRICT)}"
    subprocess.run(["make", "-s", "test", flags], cwd=tmp_path, capture_output=True, check=True)


def test_single_precision_keeps_what_is_tiny_and_what_is_large() -> None:
    assert float.fromhex(SINGLE.number(1e-300)[:-1]) == float(np.finfo(np.float32).tiny)
    assert float.fromhex(SINGLE.number(1e300)[:-1]) == float(np.finfo(np.float32).max)
    assert SINGLE.number(0.0) == "0x0.0p+0F"
    assert SINGLE.number(-0.5) == "(-0x1.0000000000000p-1F)"


# -------------------------------------------------------------------- bad input


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(L.PID(kp=1.0), arm)
    task = taut.compile([taut.Phase(L.PID(kp=1.0, kd=1.0), taut.hold(), name="one")], arm)
    with refused(taut.TautError):
        taut.export_c(task, tmp_path)
    with refused(taut.TautError):
        taut.export_c(L.PID(kp=1.0), tmp_path)  # type: ignore[arg-type]
    for prefix in ("", "2law", "my law", "int"):
        with refused(taut.TautError):
            taut.export_c(ctrl, tmp_path, prefix=prefix)
    with refused(taut.TautError):
        taut.export_c(ctrl, tmp_path, real="half")  # type: ignore[arg-type]
    for folder in (None, 3, b"firmware"):
        with refused(taut.errors.UsageError):
            taut.export_c(ctrl, folder)  # type: ignore[arg-type]
    for name in ("", "firm\0ware"):
        with refused(taut.TautError):
            taut.export_c(ctrl, name)
    (tmp_path / "Makefile").write_text("all:\n", encoding="utf-8")
    with refused(taut.TautError):
        taut.export_c(ctrl, tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["Makefile"]


def test_what_taut_wrote_is_replaced(tmp_path: Path) -> None:
    ctrl = taut.compile(L.PID(kp=1.0), taut.load_arm("planar2"), engine="float")
    taut.export_c(ctrl, tmp_path)
    ctrl.parameters["law.kp"] = 4.0
    taut.export_c(ctrl, tmp_path)
    assert ".kp = 0x1.0000000000000p+2" in (tmp_path / "ctrl.c").read_text(encoding="utf-8")


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "firmware").write_text("", encoding="utf-8")
    with refused(taut.TautError):
        taut.export_c(taut.compile(L.PID(kp=1.0), taut.load_arm("planar2")), tmp_path / "firmware")
