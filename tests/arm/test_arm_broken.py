"""Broken files are refused, and each problem has its object, attribute, line and sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from arm_broken_mjcf import CASES as MJCF
from arm_broken_urdf import CASES as URDF
from arm_models import DUO, PAIR, Case

from taut.arm.load import load_arm
from taut.arm.report import check_model
from taut.base.errors import ModelError

ALL = [pytest.param(case, DUO, "m.urdf", id=f"URDF: {case.title}") for case in URDF] + [
    pytest.param(case, PAIR, "m.xml", id=f"MJCF: {case.title}") for case in MJCF
]


def refused(file: Path) -> ModelError:
    with pytest.raises(ModelError) as caught:
        load_arm(file)
    return caught.value


@pytest.mark.parametrize(("case", "sound", "name"), ALL)
def test_a_broken_file_is_refused_with_object_attribute_and_line(
    case: Case, sound: str, name: str, tmp_path: Path
) -> None:
    file = tmp_path / name
    file.write_text(case.written(sound), encoding="utf-8")
    error = refused(file)
    got = [(p.object, p.attribute, p.line, p.message.replace(str(tmp_path), "{folder}")) for p in error.problems]
    assert got == case.problems
    assert str(error).startswith(f"{file}: {error.problems[0]}")
    assert error.__cause__ is None or not isinstance(error.__cause__, ModelError)


@pytest.mark.parametrize(("case", "sound", "name"), ALL)
def test_the_check_reports_a_broken_file_and_does_not_raise(
    case: Case, sound: str, name: str, tmp_path: Path
) -> None:
    file = tmp_path / name
    file.write_text(case.written(sound), encoding="utf-8")
    report = check_model(file)
    assert not report.ok
    assert len(report.problems) == len(case.problems)
    assert case.problems[0][3].split("{folder}")[0] in report.text()


def test_there_are_more_than_sixty_kinds_and_the_sound_models_are_accepted(tmp_path: Path) -> None:
    assert len(URDF) + len(MJCF) >= 150
    for text, name in ((DUO, "m.urdf"), (PAIR, "m.xml")):
        (tmp_path / name).write_text(text)
        assert load_arm(tmp_path / name).n == 2


@pytest.mark.bars
def test_broken_files_are_counted(tmp_path: Path, bar: Callable[[str, object], None]) -> None:
    told = 0
    for cases, sound, name in ((URDF, DUO, "m.urdf"), (MJCF, PAIR, "m.xml")):
        for case in cases:
            (tmp_path / name).write_text(case.written(sound), encoding="utf-8")
            problems = refused(tmp_path / name).problems
            told += all(problem.object and problem.line is not None for problem in problems)
    count = len(URDF) + len(MJCF)
    bar("row 20: broken URDF and MJCF files refused, naming object and line", f"{told} of {count}")
    assert told >= 0.9 * count  # of MuJoCo's own refusals a few know no line


def test_a_refused_file_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where it stands
    for case in MJCF:
        Path("m.xml").write_text(case.written(PAIR), encoding="utf-8")
        refused(Path("m.xml"))
    assert [p.name for p in tmp_path.iterdir()] == ["m.xml"]
