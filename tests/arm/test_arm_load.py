"""load_arm: names, paths, locks, subsets, and one sentence for each thing that it cannot take."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from arm_models import DUO

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

HINT = " (taut arms lists them; a file is named with its suffix, .urdf or .xml)"


@pytest.mark.parametrize(
    ("model", "error", "message"),
    [
        ("pnda", UnknownNameError, f"taut has no arm 'pnda'; did you mean 'panda'?{HINT}"),
        ("Panda", UnknownNameError, f"taut has no arm 'Panda'; did you mean 'panda'?{HINT}"),
        ("UR5", UnknownNameError, f"taut has no arm 'UR5'; did you mean 'ur5'?{HINT}"),
        ("", UsageError, "model must be a name or a path; got ''"),
        (7, UsageError, "model must be a name or a path; got int"),
        (None, UsageError, "model must be a name or a path; got NoneType"),
        ("a\0b", UsageError, "model must be a name or a path; got 'a\\x00b'"),
    ],
)
def test_what_is_no_model_is_refused_in_one_sentence(model: object, error: type[TautError], message: str) -> None:
    with pytest.raises(error) as caught:
        load_arm(model)
    assert str(caught.value) == message


def test_an_arm_is_no_model_to_load() -> None:
    with pytest.raises(UsageError, match="model is an Arm already; its methods"):
        load_arm(load_arm("planar2"))


def test_wrong_files_are_refused_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "empty.urdf").write_text("")
    (tmp_path / "arm.stl").write_text("solid")
    (tmp_path / "arm.urdf.xacro").write_text("<robot/>")
    for name, rule in {
        "": f"model '{tmp_path}' is a folder; name a file in it",
        "empty.urdf": f"model '{tmp_path}/empty.urdf' is empty",
        "gone.urdf": f"model '{tmp_path}/gone.urdf' does not exist; '{tmp_path}' has 'empty.urdf'",
        "arm.stl": f"model '{tmp_path}/arm.stl' is neither a .urdf nor an MJCF .xml file",
        "arm.urdf.xacro": f"model '{tmp_path}/arm.urdf.xacro' is neither a .urdf nor an MJCF .xml file; expand it first: xacro MODEL.xacro > MODEL.urdf",
    }.items():
        with pytest.raises(FileError) as caught:
            load_arm(tmp_path / name)
        assert str(caught.value) == rule


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
    with pytest.raises(FileError, match=r"is neither a .urdf nor an MJCF .xml file"):
        load_arm(Path("planar2"))


# -------------------------------------------------------------------- what the caller adds


def test_the_base_stands_where_it_is_mounted() -> None:
    T_WB = Pose((0, 0, 1.5), rpy=(math.pi, 0, 0))
    assert load_arm("planar2", T_WB=T_WB).T_WB == T_WB
    with pytest.raises(UsageError, match=r"T_WB must be a taut.Pose; got list"):
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
    ("arguments", "error", "message"),
    [
        ({"tool": "tolo"}, UnknownNameError, "model 'planar2' has no frame 'tolo'; did you mean 'tool'? (4 frames: taut check MODEL lists them)"),
        ({"tool": 3}, UsageError, "tool must be the name of a frame; got int"),
        ({"locked": {"joint9": 0.0}}, UnknownNameError, "model 'planar2' has no joint 'joint9'; did you mean 'joint2' or 'joint1'?"),
        ({"locked": {"joint9": None}}, UnknownNameError, "model 'planar2' has no joint 'joint9'; did you mean 'joint2' or 'joint1'?"),
        ({"locked": {"joint1": math.nan}}, RangeError, "locked['joint1'] must be finite [rad]; got nan"),
        ({"locked": {"joint1": "up"}}, ShapeError, "locked['joint1'] must be one number [rad]; got 'up'"),
        ({"locked": {"<tool>": 0.0}}, UsageError, "joint '<tool>' is fixed in the file already; leave it out of locked="),
        ({"locked": ["joint1"]}, UsageError, "locked must be joint names with positions, {'joint': 0.0}; got list"),
        ({"locked": {"joint1": 0.0, "joint2": 0.0}}, ModelError, "built in: no joint moves; an arm needs one at least"),
        ({"locked": {3: 0.0}}, UnknownNameError, "a joint of model 'planar2' is named by a text; got 3"),
        ({"home": {1: 0.0}}, UnknownNameError, "a joint of model 'planar2' is named by a text; got 1"),
        ({"home": [0.0]}, ShapeError, "home must have shape (2,) (2 joints); got shape (1,)"),
        ({"home": [0.0, math.nan]}, RangeError, "home[1] (joint 'joint2') must be finite; got nan"),
        ({"home": {"joint3": 0.0}}, UnknownNameError, "model 'planar2' has no joint 'joint3'; did you mean 'joint2' or 'joint1'?"),
        ({"gravity": [0, 0]}, ShapeError, "gravity must have shape (3,) [m/s^2]; got shape (2,)"),
        ({"gravity": [0, 0, math.inf]}, RangeError, "gravity[2] must be finite [m/s^2]; got inf"),
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused_in_words(
    arguments: dict[str, object], error: type[TautError], message: str
) -> None:
    with pytest.raises(error) as caught:
        load_arm("planar2", **arguments)
    assert str(caught.value) == message


def test_positions_out_of_limits_are_refused() -> None:
    with pytest.raises(RangeError) as caught:
        load_arm("panda", home=np.zeros(7))
    assert str(caught.value) == (
        "home[3] (joint 'panda_joint4') must be within the joint's limits [-3.0718, -0.0698] [rad]; got 0.0"
    )
    assert caught.value.joint == "panda_joint4"
    with pytest.raises(RangeError, match=r"locked\['panda_joint4'\] must be within the joint's limits"):
        load_arm("panda", locked={"panda_joint4": 0.0})


def test_several_ends_make_the_tool_a_question(tmp_path: Path) -> None:
    file = tmp_path / "fork.urdf"
    left = '<link name="left"/><joint name="l" type="fixed"><parent link="fore"/><child link="left"/></joint>'
    on_base = '<link name="rail"/><joint name="r" type="fixed"><parent link="base"/><child link="rail"/></joint>'
    file.write_text(DUO.replace("</robot>", f"{left}{on_base}</robot>"))
    with pytest.raises(UsageError) as caught:
        load_arm(file)
    assert str(caught.value) == (
        "model 'duo' has 2 leaves ('tool', 'left'); say which frame is the tool: tool='tool'"
    )
    assert load_arm(file, tool="left").tool == "left"


def test_home_of_a_file_is_zero_or_the_middle_of_the_limits(tmp_path: Path) -> None:
    file = tmp_path / "duo.urdf"
    file.write_text(DUO.replace('lower="-2" upper="2"', 'lower="1" upper="2"'))
    np.testing.assert_allclose(load_arm(file).home, (1.5, 0.0))
