"""Exports: every number comes back from every format."""

from __future__ import annotations

import builtins
import csv
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io
from scipy.io import loadmat

import taut
from taut.record.log.layout import columns_of


def test_arrays_have_every_number_by_name(noisy_run: taut.Run) -> None:
    arrays = noisy_run.arrays()
    assert list(arrays)[:8] == ["t", "q", "v", "tau", "command", "terms.P", "terms.D", "terms.torque_limit"]
    assert arrays["q"] is noisy_run.q
    assert arrays["extra.F_ext"].shape == (250, 6)


def test_a_csv_reads_back_exactly(noisy_run: taut.Run, tmp_path: Path) -> None:
    path = noisy_run.to_csv(tmp_path / "run.csv")
    with path.open(encoding="utf-8", newline="") as file:
        header, *lines = csv.reader(file)
    expected = np.hstack([array.reshape(250, -1) for array in columns_of(noisy_run).values()])
    assert np.array([[float(word) for word in line] for line in lines]).tobytes() == expected.tobytes()
    assert list(pd.read_csv(path).columns) == header
    assert header[:5] == ["t [s]", "q.shoulder [rad]", "q.slide [m]", "q.gelenk-ü [rad]", "v.shoulder [rad/s]"]
    assert "tau.slide [N]" in header
    assert "terms.P.shoulder [N m]" in header
    assert "reference.a.slide [m/s^2]" in header
    assert header[-7:] == [
        *(f"extra.F_ext.{i} [N]" for i in range(3)),
        *(f"extra.F_ext.{i} [N m]" for i in range(3, 6)),
        "extra.contact",
    ]
    assert len(set(header)) == len(header)


def test_a_pandas_table_has_the_same_names_and_numbers(noisy_run: taut.Run) -> None:
    table = noisy_run.to_pandas()
    np.testing.assert_array_equal(table["q.slide"], noisy_run.q[:, 1])
    np.testing.assert_array_equal(table["terms.torque_limit.shoulder"], noisy_run.terms["torque_limit"][:, 0])
    np.testing.assert_array_equal(table["extra.F_ext.5"], noisy_run.extra["F_ext"][:, 5])
    np.testing.assert_array_equal(table.index, noisy_run.t)
    assert table.attrs["units"]["v.slide"] == "m/s"


def test_a_mat_file_reads_back_as_a_struct(noisy_run: taut.Run, tmp_path: Path) -> None:
    read = loadmat(noisy_run.to_mat(tmp_path / "run.mat"), simplify_cells=True)["run"]
    np.testing.assert_array_equal(read["q"], noisy_run.q)
    np.testing.assert_array_equal(read["terms"]["P"], noisy_run.terms["P"])
    np.testing.assert_array_equal(read["extra"]["F_ext"], noisy_run.extra["F_ext"])
    np.testing.assert_array_equal(read["t"], noisy_run.t)
    assert list(read["joint_names"]) == list(noisy_run.joint_names)
    assert list(read["units"]) == ["rad", "m", "rad"]


def test_a_run_without_ticks_can_be_exported(make_run: Any, tmp_path: Path) -> None:
    run = make_run([], np.zeros((0, 2)), terms={"P": np.zeros((0, 2))})
    assert len(run.to_csv(tmp_path / "run.csv").read_text().splitlines()) == 1
    assert run.to_pandas().shape == (0, 16)
    run.to_mat(tmp_path / "run.mat")


def test_joints_with_commas_in_their_names_stay_one_column(make_run: Any, tmp_path: Path) -> None:
    run = make_run([0.0], [[1.0, 2.0]], joint_names=("a,b", 'c"d'))
    table = pd.read_csv(run.to_csv(tmp_path / "run.csv"))
    assert list(table.columns)[1:3] == ["q.a,b [rad]", 'q.c"d [rad]']


@pytest.mark.parametrize("method", ["to_csv", "to_mat"])
def test_a_wrong_suffix_or_folder_gets_one_sentence(noisy_run: taut.Run, method: str, tmp_path: Path) -> None:
    suffix = method.replace("to_", ".")
    with pytest.raises(taut.errors.FileError, match=rf"must end in {suffix}; got 'run.doc'"):
        getattr(noisy_run, method)(tmp_path / "run.doc")
    with pytest.raises(taut.errors.FileError, match="which does not exist; create it first"):
        getattr(noisy_run, method)(tmp_path / "no" / f"run{suffix}")


def test_nothing_half_written_is_left_behind(
    noisy_run: taut.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mat"
    path.write_bytes(b"old")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(scipy.io, "savemat", full)
    with pytest.raises(
        taut.errors.FileError, match=r"MATLAB file '.*run.mat' cannot be written: No space left on device"
    ):
        noisy_run.to_mat(path)
    assert [file.name for file in tmp_path.iterdir()] == ["run.mat"]
    assert path.read_bytes() == b"old"


def test_a_missing_pandas_is_named_with_its_remedy(noisy_run: taut.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *others: Any) -> Any:
        if name == "pandas":
            raise ImportError(name)
        return real(name, *others)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(taut.errors.MissingExtraError) as refused:
        noisy_run.to_pandas()
    assert str(refused.value) == (
        "run.to_pandas() needs the package 'pandas', which is not installed; pip install pandas installs it"
    )


def test_work_has_its_unit(tmp_path: Path) -> None:
    arm = taut.load_arm("planar2").with_friction(taut.Friction(coulomb=0.5))
    ctrl = taut.compile(taut.laws.PID(kp=20.0, kd=2.0), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm, energy=True), taut.JointMotion(q=arm.home), duration=0.01)
    header = run.to_csv(tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "extra.work.dry.1 [J]" in header
