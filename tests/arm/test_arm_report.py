"""What `taut check` and `taut arms` say."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arm_models import DUO
from arm_oracles import pinocchio_of, random_q

from taut.arm.builtin import BUILT_IN
from taut.arm.catalogue import CATALOGUE
from taut.arm.load import load_arm
from taut.arm.reach import reach
from taut.arm.report import arm_rows, check_model


def test_the_report_of_a_small_arm_reads_like_this() -> None:
    assert check_model("gantry3").text() == GANTRY


GANTRY = """\
gantry3: 3 joints, tool 'tool'
read from built in

joint  type       axis   lower  upper  velocity  effort  viscous  coulomb  rotor inertia  unit
x      prismatic  1 0 0  -0.5   0.5    1         400     5        0        0              m, N
y      prismatic  0 1 0  -0.4   0.4    1         200     5        0        0              m, N
z      prismatic  0 0 1  -0.3   0.3    1         150     5        0        0              m, N

moved by  mass [kg]  centre of mass [m]  links
x         12         0 0 0               x_carriage
y         6          0 0 0               y_carriage
z         3          0 0 0               z_carriage, tool

5 frames: base, x_carriage, y_carriage, z_carriage, tool
home: 0 0 0
gravity: 0 0 -9.81 m/s^2
moving mass 21 kg; reach 0.8124 m (tool from the first joint)
the real arm takes: torque, velocity, position

no problems"""


def test_a_broken_model_is_reported_with_what_could_be_read(tmp_path: Path) -> None:
    file = tmp_path / "duo.urdf"
    file.write_text(DUO.replace('effort="40"', 'effort="-40"').replace('velocity="3" effort="20"', 'effort="x"'))
    report = check_model(file)
    assert report.text() == (
        f"duo: 2 joints\nread from {file}\n\n"
        "joint     type        axis   lower  upper  velocity  effort  viscous  coulomb  rotor inertia  unit\n"
        "shoulder  revolute    0 1 0  -2     2      3         -40     0.1      0.2      0              rad, N m\n"
        "elbow     continuous  0 1 0  none   none   none      none    0        0        0              rad, N m\n\n"
        "2 problems\n"
        "  joint 'shoulder': effort limit must be > 0; got -40 (line 23)\n"
        "  joint 'elbow': effort of <limit> must be one number; got 'x' (line 31)"
    )
    values = report.json()
    assert values["ok"] is False
    assert values["problems"] == [
        {
            "object": "shoulder",
            "attribute": "effort",
            "line": 23,
            "message": "joint 'shoulder': effort limit must be > 0; got -40",
        },
        {
            "object": "elbow",
            "attribute": "effort",
            "line": 31,
            "message": "joint 'elbow': effort of <limit> must be one number; got 'x'",
        },
    ]
    assert [joint["name"] for joint in values["joints"]] == ["shoulder", "elbow"]
    assert values["total_mass"] is None


@pytest.mark.parametrize("name", [*BUILT_IN, *CATALOGUE])
def test_every_known_arm_has_a_sound_report_in_plain_json(name: str) -> None:
    report = check_model(name)
    values = json.loads(json.dumps(report.json(), allow_nan=False))
    arm = load_arm(name)
    assert values["ok"] is True
    assert values["name"] == name
    assert [joint["name"] for joint in values["joints"]] == list(arm.joint_names)
    assert values["total_mass"] == pytest.approx(arm.total_mass)
    assert 0.0 < values["reach"] < 3.0
    assert values["tool"] in {frame["name"] for frame in values["frames"]}
    assert report.text().endswith("no problems")


def test_no_limit_is_none_in_json_and_said_in_text() -> None:
    values = check_model("one_joint").json()
    assert values["joints"][0]["upper"] is None
    assert "no position limit on 'joint1'" in values["notes"]
    assert "note: no effort limit on 'joint1'" in check_model("one_joint").text()


def test_a_model_with_several_ends_can_be_looked_at(tmp_path: Path) -> None:
    file = tmp_path / "fork.urdf"
    left = '<link name="left"/><joint name="l" type="fixed"><parent link="fore"/><child link="left"/></joint>'
    file.write_text(DUO.replace("</robot>", f"{left}</robot>"))
    report = check_model(file)
    assert report.ok
    assert report.notes[0] == (
        "model 'duo' has 2 leaves ('tool', 'left'); say which frame is the tool: tool='tool'; here it is 'tool'"
    )


@pytest.mark.parametrize("model", ["pnda", "", "gone.urdf"])
def test_what_cannot_be_opened_is_one_problem(model: str) -> None:
    report = check_model(model)
    (problem,) = report.problems
    assert (problem.object, problem.attribute, problem.line) == (model, None, None)
    assert report.json()["joints"] == []
    assert "1 problem\n" in report.text()


def test_the_list_of_arms_has_all_of_them_with_joints_and_commands() -> None:
    rows = {row["name"]: row for row in arm_rows()}
    assert set(rows) == {*BUILT_IN, *CATALOGUE}
    for name, row in rows.items():
        arm = load_arm(name)
        assert (row["joints"], row["commands"], row["installed"]) == (arm.n, list(arm.commands), True)
    assert rows["panda"]["source"] == "example-robot-data"
    assert rows["fr3"]["source"] == "franky-sim"
    assert rows["planar2"]["source"] == "built in"


# -------------------------------------------------------------------- reach


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["panda", "kinova", "so101", "z1", "gantry3", "ur5"])
def test_no_pose_reaches_further_than_the_reach(name: str) -> None:
    arm = load_arm(name)
    far = reach(arm)
    model = pinocchio_of(arm)
    data, tool = model.createData(), model.getFrameId(arm.tool)
    origin = arm.joints[arm.ancestors(arm.frame().body)[0]].placement.p
    rng, best = np.random.default_rng(0), 0.0
    for _ in range(3000):
        pin.forwardKinematics(model, data, random_q(arm, rng))
        pin.updateFramePlacement(model, data, tool)
        best = max(best, float(np.linalg.norm(data.oMf[tool].translation - origin)))
    assert 0.85 * far < best <= far + 1e-9


def test_reach_in_closed_form() -> None:
    assert reach(load_arm("planar3")) == pytest.approx(0.9, abs=1e-9)
    assert reach(load_arm("one_joint")) == pytest.approx(0.1, abs=1e-12)
    assert reach(load_arm("gantry3")) == pytest.approx(math.sqrt(0.5**2 + 0.4**2 + 0.5**2))
    bent = load_arm("planar2").with_joints(lower=[-1.0, 1.0], upper=[1.0, 2.0])
    assert reach(bent) == pytest.approx(math.sqrt(0.5**2 + 0.4**2 + 2 * 0.5 * 0.4 * math.cos(1.0)))


def test_a_slide_without_end_reaches_without_bound() -> None:
    arm = load_arm("gantry3").with_joints(upper={"y": math.inf})
    assert reach(arm) == math.inf
