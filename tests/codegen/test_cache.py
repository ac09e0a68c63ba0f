"""The cache of compiled code: found by content, whole or not at all, and never from a folder that others can write."""

from __future__ import annotations

import errno
import multiprocessing
import os
import stat
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused, warned

import taut
from taut import math as tm
from taut.codegen import llvm, native
from taut.trace.graph import Op

KEY = bytes(range(32))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test alone, which has warned of nothing yet."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("TAUT_CACHE_DIR", str(folder))
    monkeypatch.setattr(native, "_WARNED", set())
    return folder


def compile_one(factor: float = 2.0) -> Any:
    """A function, natively; it says whether its code came from the cache."""
    made = taut.native(lambda x: factor * tm.sin(x) + 1.0, x=3)
    x = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(made(x), factor * np.sin(x) + 1.0, rtol=1e-14)
    return made._kernel.module


def entries(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def test_code_is_compiled_once(folder: Path) -> None:
    assert not compile_one().cached
    assert compile_one().cached
    assert not compile_one(3.0).cached
    assert compile_one(3.0).cached
    assert len(entries(folder)) == 2


def test_gains_and_rates_need_no_new_code(folder: Path) -> None:
    arm = taut.load_arm("planar2")
    for kp, rate in ((10.0, 1000.0), (20.0, 500.0)):
        taut.compile(taut.laws.PID(kp=kp), arm, rate=rate)
    assert len(entries(folder)) == 1


def test_the_folder_and_its_entries_are_private(folder: Path) -> None:
    compile_one()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert all(stat.S_IMODE(entry.stat().st_mode) & 0o077 == 0 for entry in entries(folder))


def test_an_entry_that_is_cut_off_anywhere_is_made_anew(folder: Path) -> None:
    compile_one()
    [entry] = entries(folder)
    whole = entry.read_bytes()
    for length in [*range(0, len(whole), 1000), 5, 37, 38, len(whole) - 1]:
        entry.write_bytes(whole[:length])
        assert native.load(bytes.fromhex(entry.name)) is None
    assert not compile_one().cached
    assert entry.read_bytes() == whole
    assert compile_one().cached


def test_an_entry_with_a_flipped_bit_is_made_anew(folder: Path) -> None:
    compile_one()
    [entry] = entries(folder)
    whole = entry.read_bytes()
    for place in [*range(0, len(whole), len(whole) // 97), len(whole) - 1]:
        for bit in (0, 7):
            damaged = bytearray(whole)
            damaged[place] ^= 1 << bit
            entry.write_bytes(damaged)
            assert native.load(bytes.fromhex(entry.name)) is None
    assert not compile_one().cached
    assert entry.read_bytes() == whole


def test_an_entry_under_the_name_of_another_one_is_made_anew(folder: Path) -> None:
    """As a restore or a deduplication that mixes two names leaves it: whole, well sealed, and of other code."""
    compile_one()
    [first] = entries(folder)
    compile_one(3.0)
    [second] = set(entries(folder)) - {first}
    right = second.read_bytes()
    second.write_bytes(first.read_bytes())
    assert native.load(bytes.fromhex(second.name)) is None
    assert not compile_one(3.0).cached
    assert second.read_bytes() == right


def test_a_controller_does_not_run_the_code_of_another_arm(folder: Path) -> None:
    def torque(law: taut.Law) -> np.ndarray[Any, Any]:
        ctrl = taut.compile(law, taut.load_arm("planar2"))
        return ctrl.step([0.3, 0.4], [0.1, 0.2], taut.JointMotion(q=[0.0, 0.1]))

    right = torque(taut.laws.ComputedTorque(kp=100.0, kd=20.0))
    [entry] = entries(folder)
    torque(taut.laws.PID(kp=100.0, kd=20.0))
    [other] = set(entries(folder)) - {entry}
    entry.write_bytes(other.read_bytes())
    np.testing.assert_array_equal(torque(taut.laws.ComputedTorque(kp=100.0, kd=20.0)), right)


def test_an_entry_that_llvm_does_not_take_is_made_anew(folder: Path) -> None:
    compile_one()
    [entry] = entries(folder)
    native.store(bytes.fromhex(entry.name), b"no object code at all")
    assert not compile_one().cached
    assert compile_one().cached


def test_a_folder_in_the_place_of_an_entry_is_no_entry(folder: Path) -> None:
    compile_one()
    [entry] = entries(folder)
    entry.unlink()
    entry.mkdir()
    with pytest.warns(
        RuntimeWarning,
        match=r"^the cache folder '.*' cannot be written \(Is a directory\); code is compiled each time$",
    ):
        assert not compile_one().cached
    assert entries(folder) == [entry]


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_nothing_is_loaded_from_a_folder_that_others_can_write(folder: Path, mode: int) -> None:
    compile_one()
    folder.chmod(mode)
    with warned(RuntimeWarning):
        assert not compile_one().cached
    assert not compile_one(5.0).cached  # without another warning, which would be an error
    assert len(entries(folder)) == 1


def test_an_entry_that_others_can_write_is_not_loaded(folder: Path) -> None:
    compile_one()
    [entry] = entries(folder)
    entry.chmod(0o666)
    assert not compile_one().cached
    assert compile_one().cached  # replaced by one of our own


def test_a_folder_of_somebody_else_is_not_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compile_one()
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    with warned(RuntimeWarning):
        assert not compile_one().cached


@pytest.mark.parametrize("where", ["cache", "cache/below"])
def test_a_file_in_the_place_of_the_folder_costs_one_warning(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    folder.write_text("a file")
    monkeypatch.setenv("TAUT_CACHE_DIR", str(tmp_path / where))
    with pytest.warns(RuntimeWarning, match=r"cannot be (used|written) \(.*\); code is compiled"):
        assert not compile_one().cached
    assert not compile_one().cached  # without another warning, which would be an error
    assert folder.read_text() == "a file"


def test_a_folder_that_cannot_be_written_costs_one_warning(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compile_one()

    def refused(**_: Any) -> Any:  # a test may run as root, who may write everywhere
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(tempfile, "mkstemp", refused)
    assert compile_one().cached
    with pytest.warns(RuntimeWarning, match=os.strerror(errno.EROFS)):
        assert not compile_one(7.0).cached
    assert not compile_one(7.0).cached  # without another warning, which would be an error


def test_a_disk_that_is_full_leaves_nothing_behind(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compile_one()

    def full(self: Path, target: Path) -> Any:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.warns(RuntimeWarning, match=r"cannot be written \(No space left on device\)"):
        assert not compile_one(7.0).cached
    assert len(entries(folder)) == 1


def test_a_user_without_a_home_compiles_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in ("TAUT_CACHE_DIR", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(native, "_WARNED", set())
    monkeypatch.setattr(Path, "home", homeless)
    with warned(RuntimeWarning) as caught:
        assert not compile_one(11.0).cached
    assert len(caught) == 1


def test_the_variable_moves_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAUT_CACHE_DIR", str(tmp_path / "a" / "b"))
    compile_one()
    assert len(entries(tmp_path / "a" / "b")) == 1
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("TAUT_CACHE_DIR", "~/mine")
    assert native.cache_folder() == tmp_path / "mine"
    monkeypatch.delenv("TAUT_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    if sys.platform.startswith("linux"):
        assert native.cache_folder() == tmp_path / "xdg" / "taut"


@pytest.mark.parametrize("part", ["__version__", "LEVEL"])
def test_another_version_has_another_key(folder: Path, monkeypatch: pytest.MonkeyPatch, part: str) -> None:
    compile_one()
    native._platform_key.cache_clear()
    monkeypatch.setattr(native, part, 3 if part == "LEVEL" else "9.9")
    assert not compile_one().cached
    native._platform_key.cache_clear()


def test_another_processor_has_another_key(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import llvmlite.binding

    here = native._platform_key()
    native._platform_key.cache_clear()
    with monkeypatch.context() as other:
        other.setattr(llvmlite.binding, "get_host_cpu_name", lambda: "another")
        there = native._platform_key()
    native._platform_key.cache_clear()
    assert here != there
    assert native._platform_key() == here


def test_entries_are_kept_whole(folder: Path) -> None:
    assert native.load(KEY) is None
    for content in (b"", b"abc", bytes(100_000)):
        native.store(KEY, content)
        assert native.load(KEY) == content


# -------------------------------------------------------------------- many at once


def compile_in_a_process(path: str, start: Any, answers: Any) -> None:
    os.environ["TAUT_CACHE_DIR"] = path
    warnings.simplefilter("error")
    arm = taut.load_arm("planar3")
    start.wait()
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    tau = ctrl.step(arm.home, np.zeros(3), taut.JointMotion(q=np.full(3, 0.1)))
    answers.put(tau.tolist())


@pytest.mark.long
def test_eight_processes_compile_the_same_law_at_once(folder: Path) -> None:
    spawn = multiprocessing.get_context("spawn")
    start, answers = spawn.Barrier(8), spawn.Queue()
    processes = [spawn.Process(target=compile_in_a_process, args=(str(folder), start, answers)) for _ in range(8)]
    for process in processes:
        process.start()
    results = [answers.get(timeout=120.0) for _ in processes]
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * 8
    assert all(result == results[0] for result in results)
    assert len(entries(folder)) == 1  # and nothing half-written


# -------------------------------------------------------------------- the check of what is compiled


def test_a_kernel_that_is_wrong_is_refused_and_not_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arm = taut.load_arm("planar2")
    with monkeypatch.context() as broken:
        broken.setitem(llvm._OPERATION, Op.SUB, "fadd double {0}, {1}")  # type: ignore[arg-type]
        with refused(taut.errors.TraceError):
            taut.compile(taut.laws.PID(kp=1.0, kd=1.0), arm)
    assert entries(folder) == []
    taut.compile(taut.laws.PID(kp=1.0, kd=1.0), arm)
    assert len(entries(folder)) == 1


def test_wrong_memory_is_found_too(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stores = llvm._Body._stores

    def swapped(self: Any, block: str, nodes: tuple[int, ...]) -> None:
        stores(self, block, nodes[::-1] if block == "new" else nodes)

    monkeypatch.setattr(llvm._Body, "_stores", swapped)
    with refused(taut.errors.TraceError):
        taut.compile(taut.laws.PID(kp=1.0, ki=1.0), taut.load_arm("planar2"))
    assert entries(folder) == []


def test_a_kernel_that_gives_nan_is_found(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(llvm._OPERATION, Op.SELECT, "select {b} {0}, {t} {2}, {t} {1}")  # every angle is too far
    with refused(taut.errors.TraceError):
        taut.compile(taut.laws.GravityPID(kp=1.0, kd=1.0), taut.load_arm("planar2"))
    assert entries(folder) == []


def test_text_that_llvm_does_not_take_is_a_fault_of_ours(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(llvm, "number", lambda value: f"about {value}")
    with pytest.raises(taut.TautError, match=r"(?s)^LLVM refuses generated code; please report this: .*about 0"):
        compile_one(13.0)


def test_a_fresh_process_finds_what_another_one_compiled(folder: Path) -> None:
    code = (
        "import taut\n"
        "made = taut.native(lambda x: 2.0 * taut.math.sin(x) + 1.0, x=3)\n"
        "print(made._kernel.module.cached, made([0.0, 0.0, 0.0]).tolist())\n"
    )
    compile_one()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True [1.0, 1.0, 1.0]"
