"""load_arm: names, paths, locks, subsets, and one sentence for each thing that it cannot take."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from arm_models import DUO
from refusals import refused

from taut.arm.load import load_arm
from taut.base.errors import (
    FileError,
    ModelError,
    RangeError,
    ShapeError,
    TautError,
    UnknownNameError,
    UsageError,
)
from taut.trace.pose import Pose


@pytest.mark.parametrize(
    ("model", "error"),
    [
        ("pnda", UnknownNameError),
        ("Panda", UnknownNameError),
        ("UR5", UnknownNameError),
        ("", UsageError),
        (7, UsageError),
        (None, UsageError),
        ("a\0b", UsageError),
    ],
)
def test_what_is_no_model_is_refused_in_one_sentence(model: object, error: type[TautError]) -> None:
    with refused(error):
        load_arm(model)


def test_an_arm_is_no_model_to_load() -> None:
    with refused(UsageError):
        load_arm(load_arm("planar2"))


def test_wrong_files_are_refused_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "empty.urdf").write_text("")
    (tmp_path / "arm.stl").write_text("solid")
    (tmp_path / "arm.urdf.xacro").write_text("<robot/>")
    for name in ("", "empty.urdf", "gone.urdf", "arm.stl", "arm.urdf.xacro"):
        with refused(FileError):
            load_arm(tmp_path / name)


def test_a_file_that_cannot_be_opened_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"cannot be opened: File name too long|does not exist"):
        load_arm("x" * 5000 + ".urdf")
    with pytest.raises(UnknownNameError):
        load_arm("x" * 5000)


def test_a_name_wins_over_a_file_of_that_name_and_a_path_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("planar2").write_text("not an arm")
    assert load_arm("planar2").n == 2
    with refused(FileError):
        load_arm(Path("planar2"))


# -------------------------------------------------------------------- what the caller adds


def test_the_base_stands_where_it_is_mounted() -> None:
    T_WB = Pose((0, 0, 1.5), rpy=(math.pi, 0, 0))
    assert load_arm("planar2", T_WB=T_WB).T_WB == T_WB
    with refused(UsageError):
        load_arm("planar2", T_WB=[0, 0, 1])


def test_a_caller_can_lock_joints_and_set_the_catalogues_free(tmp_path: Path) -> None:
    assert load_arm("panda", locked={"panda_joint7": 0.5}).n == 6
    free = load_arm("panda", locked={"panda_finger_joint1": None})
    assert free.joint_names[-1] == "panda_finger_joint1"
    assert free.n == 8


def test_a_locked_joint_is_where_it_was_locked() -> None:
    whole, less = load_arm("planar2"), load_arm("planar2", locked={"joint2": 0.7})
    np.testing.assert_allclose(less.frame().placement.p, (0.5 + 0.4 * math.cos(0.7), 0, 0.4 * math.sin(0.7)))
    assert less.total_mass == pytest.approx(whole.total_mass)


def test_what_is_locked_needs_no_limits(tmp_path: Path) -> None:
    file = tmp_path / "duo.urdf"
    file.write_text(DUO.replace('    <limit lower="-2" upper="2" velocity="3" effort="40"/>\n', ""))
    with pytest.raises(ModelError):
        load_arm(file)
    assert load_arm(file, locked={"shoulder": 0.0}).joint_names == ("elbow",)


def test_home_is_given_by_name_or_as_a_list() -> None:
    np.testing.assert_allclose(load_arm("planar2", home={"joint2": 0.3}).home, (math.pi / 6, 0.3))
    np.testing.assert_allclose(load_arm("planar2", home=[0.1, 0.2]).home, (0.1, 0.2))


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"tool": "tolo"}, UnknownNameError),
        ({"tool": 3}, UsageError),
        ({"locked": {"joint9": 0.0}}, UnknownNameError),
        ({"locked": {"joint9": None}}, UnknownNameError),
        ({"locked": {"joint1": math.nan}}, RangeError),
        ({"locked": {"joint1": "up"}}, ShapeError),
        ({"locked": {"<tool>": 0.0}}, UsageError),
        ({"locked": ["joint1"]}, UsageError),
        ({"locked": {"joint1": 0.0, "joint2": 0.0}}, ModelError),
        ({"locked": {3: 0.0}}, UnknownNameError),
        ({"home": {1: 0.0}}, UnknownNameError),
        ({"home": [0.0]}, ShapeError),
        ({"home": [0.0, math.nan]}, RangeError),
        ({"home": {"joint3": 0.0}}, UnknownNameError),
        ({"gravity": [0, 0]}, ShapeError),
        ({"gravity": [0, 0, math.inf]}, RangeError),
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused_in_words(arguments: dict[str, object], error: type[TautError]) -> None:
    with refused(error):
        load_arm("planar2", **arguments)


def test_positions_out_of_limits_are_refused() -> None:
    with refused(RangeError) as caught:
        load_arm("panda", home=np.zeros(7))
    assert caught.value.joint == "panda_joint4"
    with refused(RangeError):
        load_arm("panda", locked={"panda_joint4": 0.0})


def test_several_ends_make_the_tool_a_question(tmp_path: Path) -> None:
    file = tmp_path / "fork.urdf"
    left = '<link name="left"/><joint name="l" type="fixed"><parent link="fore"/><child link="left"/></joint>'
    on_base = '<link name="rail"/><joint name="r" type="fixed"><parent link="base"/><child link="rail"/></joint>'
    file.write_text(DUO.replace("</robot>", f"{left}{on_base}</robot>"))
    with refused(UsageError):
        load_arm(file)
    assert load_arm(file, tool="left").tool == "left"


def test_home_of_a_file_is_zero_or_the_middle_of_the_limits(tmp_path: Path) -> None:
    file = tmp_path / "duo.urdf"
    file.write_text(DUO.replace('lower="-2" upper="2"', 'lower="1" upper="2"'))
    np.testing.assert_allclose(load_arm(file).home, (1.5, 0.0))
