"""Scenarios of the task: references of the tool, poses, laws with pairs of gains and with a law of their own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.cli.main import main
from taut.scenarios.scenario import load_scenario

URDF_HEAD = '<robot name="six"><link name="base"/>'


def urdf() -> str:
    """Three slides and a wrist, whose tool stands 0.1 m behind the last joint."""
    parts, before = [URDF_HEAD], "base"
    axes = ["1 0 0", "0 1 0", "0 0 1"]
    for i, (kind, axis) in enumerate([*(("prismatic", a) for a in axes), *(("revolute", a) for a in axes[::-1])]):
        link = f"link{i + 1}"
        inertia = '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
        parts.append(f'<link name="{link}"><inertial><mass value="1"/>{inertia}</inertial></link>')
        parts.append(
            f'<joint name="joint{i + 1}" type="{kind}"><parent link="{before}"/><child link="{link}"/>'
            f'<axis xyz="{axis}"/><limit lower="-2" upper="2" velocity="9" effort="99"/></joint>'
        )
        before = link
    parts.append(
        '<link name="hand"/><joint name="fixed" type="fixed"><parent link="link6"/><child link="hand"/><origin xyz="0 0 0.1"/></joint></robot>'
    )
    return "".join(parts)


TCT: dict[str, Any] = {"law": "TaskComputedTorque", "kp": [400.0, 400.0], "kd": 40.0}
HOME = [0.1, 0.2, 0.3, 0.4, 0.2, -0.3]
LIMITS = {"velocity": [0.5, 1.0], "acceleration": [2.0, 4.0]}
POSE = {"p": [0.15, 0.2, 0.35], "rpy": [-0.3, 0.3, 0.4]}
REFERENCES: dict[str, dict[str, Any]] = {
    "pose": {"kind": "pose", "pose": "home"},
    "line": {"kind": "line", "T1": POSE, "duration": 0.3},
    "line from home": {
        "kind": "line",
        "relative_to_home": True,
        "T1": {"p": [0.05, 0, 0]},
        **LIMITS,
        "scaling": "trapezoidal",
    },
    "circle": {
        "kind": "circle",
        "relative_to_home": True,
        "centre": [0.05, 0, 0],
        "axis": [0, 0, 1],
        "orientation": "turn",
        "angle": 1.0,
        "duration": 0.3,
    },
    "samples": {
        "kind": "task-samples",
        "relative_to_home": True,
        "times": [0, 0.2, 0.4],
        "poses": [{}, {"p": [0.02, 0, 0]}, {"rpy": [0, 0, 0.2]}],
    },
    "samples in a file": {
        "kind": "task-samples",
        "relative_to_home": True,
        "file": "way.csv",
    },
    "hold": {"kind": "hold"},
}


def text_of(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {text_of(x)}" for key, x in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(text_of, value)) + "]"
    return json.dumps(value)


def written(folder: Path, reference: dict[str, Any], laws: dict[str, Any] | None = None, **more: Any) -> Path:
    (folder / "six.urdf").write_text(urdf())
    (folder / "way.csv").write_text("t, x, y, z, roll, pitch, yaw\n0, 0, 0, 0, 0, 0, 0\n0.2, 0.02, 0, 0, 0, 0, 0.1\n")
    whole: dict[str, Any] = {
        "arm": {"model": "six.urdf", "tool": "hand", "home": HOME},
        "laws": laws or {"TCT": TCT},
        "plant": {"kind": "rigid"},
        "reference": reference,
        "run": {"duration": 0.4},
    }
    whole |= more
    file = folder / "task.toml"
    lines = [f"{key} = {text_of(value)}" for key, value in whole.items()]
    file.write_text("\n".join(lines))
    return file


@pytest.mark.parametrize("reference", REFERENCES.values(), ids=REFERENCES)
def test_every_reference_of_the_task_is_followed_from_home(reference: dict[str, Any], tmp_path: Path) -> None:
    figures = [
        {"law": "TCT", "metric": "task_peak", "max": 3e-3},
        {"law": "TCT", "metric": "task_peak_rotation", "max": 2e-2},
    ]
    file = written(tmp_path, reference, **{"pass": figures})
    assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 0
    metrics = json.loads((tmp_path / "out" / "task.json").read_text())["TCT"]
    assert metrics["task_rms"]["unit"] == "m"
    assert metrics["rms_error"]["overall"] is None


def test_home_is_the_pose_of_the_tool_and_relative_poses_are_in_world_axes_from_it(tmp_path: Path) -> None:
    T = taut.snapshot(load_scenario(str(written(tmp_path, {"kind": "hold"}))).experiment.arm, HOME).T()
    moved = {"kind": "pose", "relative_to_home": True, "pose": {"p": [0.1, 0, 0], "rpy": [0, 0, 0.2]}}
    made: Any = load_scenario(str(written(tmp_path, moved))).experiment.reference
    np.testing.assert_allclose(made.p, T.p + np.array([0.1, 0, 0]), atol=1e-15)
    np.testing.assert_allclose(made.R, taut.Pose(rpy=[0, 0, 0.2]).R @ T.R, atol=1e-15)
    here: Any = load_scenario(str(written(tmp_path, {"kind": "pose", "pose": "home"}))).experiment.reference
    np.testing.assert_array_equal(here.R, T.R)


def test_home_is_that_of_the_frame_that_the_laws_control(tmp_path: Path) -> None:
    file = written(tmp_path, {"kind": "pose", "pose": "home"}, {"TCT": {**TCT, "tool": "link6"}})
    scenario = load_scenario(str(file))
    made: Any = scenario.experiment.reference
    np.testing.assert_allclose(made.p, taut.snapshot(scenario.experiment.arm, HOME).T("link6").p)


def test_gains_are_pairs_and_a_law_may_hold_one_or_none(tmp_path: Path) -> None:
    laws = {
        "TCT": {**TCT, "null": {"law": "Posture", "kp": 10.0, "kd": 6.0}},
        "Z": {"law": "Impedance", "K": [800, 30], "zeta": 0.7, "null": "none"},
    }
    read: Any = load_scenario(str(written(tmp_path, {"kind": "hold"}, laws, arm={"model": "panda"}))).laws
    np.testing.assert_array_equal(read["TCT"].kp.as_array(), np.full(6, 400.0))
    assert isinstance(read["TCT"].null, taut.laws.Posture)
    assert float(read["TCT"].null.kd) == 6.0
    np.testing.assert_array_equal(read["Z"].K.as_array(), [800, 800, 800, 30, 30, 30])
    assert read["Z"].null is None


def refused(file: Path, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["run", str(file), "--out", str(file.parent / "out")]) == 2
    assert not (file.parent / "out").exists()
    return capsys.readouterr().err.strip().partition("task.toml': ")[2]


LINE = REFERENCES["line"]
SET_POINT = {"kind": "set-point", "q": HOME}
BROKEN: dict[str, tuple[dict[str, Any], str]] = {
    "a pose that is an array": (
        {**LINE, "T1": [1, 2, 3]},
        "[reference] T1 must be a table: [reference.T1]; got [1, 2, 3]",
    ),
    "a pose in words": (
        {"kind": "pose", "pose": "up"},
        "[reference] pose must be a table: [reference.pose]; got 'up'",
    ),
    "no pose": ({"kind": "pose"}, "[reference] needs the key 'pose'"),
    "a pose without an orientation": (
        {**LINE, "T1": {"p": [0, 0, 0]}},
        "[reference.T1] needs its orientation: one of 'xyzw', 'wxyz', 'rpy', 'R'",
    ),
    "a pose without a position": ({**LINE, "T1": {"rpy": [0, 0, 0]}}, "[reference.T1] needs its position p"),
    "a pose with two rotations": (
        {**LINE, "T1": {**POSE, "xyzw": [0, 0, 0, 1]}},
        "[reference.T1] rpy: a pose takes one rotation",
    ),
    "a quaternion that is none": (
        {**LINE, "T1": {"p": [0, 0, 0], "xyzw": [0, 0, 0, 2]}},
        "[reference.T1] xyzw must have length 1; its length is 2; divide it by its length",
    ),
    "a misspelt rotation": (
        {**LINE, "T1": {"p": [0, 0, 0], "rpi": [0, 0, 0], "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}},
        "[reference.T1] has no key 'rpi'; did you mean 'rpy'?",
    ),
    "a line that takes no time": ({**LINE, "duration": 0}, "[reference] duration must be > 0 [s]; got 0.0"),
    "a line without a duration": (
        {"kind": "line", "T1": POSE},
        "[reference] kind: needs duration",
    ),
    "limits that are no pair": (
        {**LINE, "velocity": 0.5, "acceleration": [1, 1]},
        "[reference] velocity must be (linear, angular) [m/s, rad/s]; got 0.5",
    ),
    "a line with a duration and limits": (
        {**LINE, "velocity": [0.01, 1.0], "acceleration": [1, 1]},
        "[reference] kind: needs duration",
    ),
    "a key of a circle": ({**LINE, "angle": 1.0}, "[reference] has no key 'angle'"),
    "a centre in words": (
        {**REFERENCES["circle"], "centre": "here"},
        "[reference] centre must be numbers [m]; got 'here'",
    ),
    "a centre off the plane": (
        {**REFERENCES["circle"], "centre": [0.05, 0, 0.01]},
        "[reference] centre must be in the plane through T0 that the axis is normal to; it is 0.01 m off",
    ),
    "samples without poses": ({"kind": "task-samples", "times": [0, 1]}, "[reference] needs the key 'poses'"),
    "samples without a file": ({"kind": "task-samples", "file": "no.csv"}, "[reference] file: CSV file '"),
    "a reference of joints": (
        SET_POINT,
        "[reference] kind: the law follows TaskMotion; the reference gives JointMotion",
    ),
}


@pytest.mark.parametrize(("reference", "words"), BROKEN.values(), ids=BROKEN)
def test_a_reference_that_is_none_is_refused(
    reference: dict[str, Any], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(written(tmp_path, reference), capsys).startswith(words)


OTHERS: dict[str, tuple[dict[str, Any], str]] = {
    "a reference of the task for joints": (
        {"reference": LINE, "laws": {"PD": {"law": "PID", "kp": 10.0}}},
        "[reference] kind: the law follows JointMotion; the reference gives TaskMotion",
    ),
    "laws of two frames": (
        {"reference": LINE, "laws": {"a": TCT, "b": {**TCT, "tool": "link6"}}},
        "[reference] is for laws that control one frame, and these control link6 and the arm's tool; give them the same tool, or put them in scenarios of their own",
    ),
    "a joint of a metric of the tool": (
        {"reference": LINE, "pass": [{"law": "TCT", "metric": "peak_force", "max": 1, "joint": "joint1"}]},
        "[pass 1] metric 'peak_force' is of the tool; leave joint out",
    ),
    "a law in the place of a law in words": (
        {"reference": LINE, "laws": {"TCT": {**TCT, "null": "Posture"}}},
        "[laws.TCT] null must be a table: [laws.TCT.null]; got 'Posture'",
    ),
    "one number for metres and radians": (
        {"reference": LINE, "laws": {"Z": {"law": "Impedance", "K": 800, "zeta": 0.7}}},
        "[laws.Z] K must be (linear, angular), (6,) or (6, 6) [N/m, N m/rad]; got 800 alone",
    ),
}


@pytest.mark.parametrize(("parts", "words"), OTHERS.values(), ids=OTHERS)
def test_what_does_not_fit_together_is_refused(
    parts: dict[str, Any], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(written(tmp_path, **parts), capsys).startswith(words)


def test_a_force_that_nothing_records_reaches_no_bound(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path, LINE, **{"pass": [{"law": "TCT", "metric": "peak_force", "max": 30.0}]})
    assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 1
    assert "peak_force has no meaning in this run" in "".join(capsys.readouterr())


def test_columns_of_the_tool_stand_in_the_table_and_a_plot_compares_the_task(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    laws = {"TCT": TCT, "soft": {**TCT, "kp": [100.0, 100.0]}}
    outputs = {"columns": ["task_peak", "min_singular_value"], "plot": "plot.png"}
    file = written(tmp_path, LINE, laws, outputs=outputs)
    assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "task peak" in told
    assert "smallest singular" in told
    assert (tmp_path / "out" / "plot.png").stat().st_size > 10_000
