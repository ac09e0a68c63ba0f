"""Tables: every number comes back."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.record.log import export


def test_arrays_have_every_number_by_name(noisy_run: taut.Run) -> None:
    arrays = noisy_run.arrays()
    assert list(arrays)[:8] == ["t", "q", "v", "tau", "command", "terms.P", "terms.D", "terms.torque_limit"]
    assert arrays["q"] is noisy_run.q
    assert arrays["extra.F_ext"].shape == (250, 6)


def test_a_csv_reads_back_exactly(noisy_run: taut.Run, tmp_path: Path) -> None:
    path = noisy_run.to_csv(tmp_path / "run.csv")
    with path.open(encoding="utf-8", newline="") as file:
        header, *lines = csv.reader(file)
    expected = np.hstack([array.reshape(250, -1) for array in noisy_run.arrays().values()])
    assert np.array([[float(word) for word in line] for line in lines]).tobytes() == expected.tobytes()
    assert header[:5] == ["t", "q.shoulder", "q.slide", "q.gelenk-ü", "v.shoulder"]
    assert {"tau.slide", "terms.P.shoulder", "reference.a.slide"} <= {*header}
    assert header[-7:] == [*(f"extra.F_ext.{i}" for i in range(6)), "extra.contact"]
    assert len(set(header)) == len(header)


def test_a_run_without_ticks_can_be_exported(make_run: Any, tmp_path: Path) -> None:
    run = make_run([], np.zeros((0, 2)), terms={"P": np.zeros((0, 2))})
    assert len(run.to_csv(tmp_path / "run.csv").read_text().splitlines()) == 1


def test_joints_with_commas_in_their_names_stay_one_column(make_run: Any, tmp_path: Path) -> None:
    run = make_run([0.0], [[1.0, 2.0]], joint_names=("a,b", 'c"d'))
    with run.to_csv(tmp_path / "run.csv").open(newline="") as file:
        header = next(csv.reader(file))
    assert header[1:3] == ["q.a,b", 'q.c"d']


def test_a_wrong_suffix_or_folder_gets_one_sentence(noisy_run: taut.Run, tmp_path: Path) -> None:
    with refused(taut.errors.FileError):
        noisy_run.to_csv(tmp_path / "run.doc")
    with refused(taut.errors.FileError):
        noisy_run.to_csv(tmp_path / "no" / "run.csv")


def test_nothing_half_written_is_left_behind(
    noisy_run: taut.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(b"old")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(export.csv, "writer", full)
    with pytest.raises(taut.errors.FileError, match=r"table '.*run.csv' cannot be written: No space left on device"):
        noisy_run.to_csv(path)
    assert [file.name for file in tmp_path.iterdir()] == ["run.csv"]
    assert path.read_bytes() == b"old"
