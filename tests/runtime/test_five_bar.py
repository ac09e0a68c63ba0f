"""A planar five-bar, a closed chain cut open into a tree: two motors move it, in RigidPlant and in MuJoCo alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import taut
from taut.base.types import Float64Array
from taut.control.command import Command, Terms, Torque
from taut.control.gains import MemoryView
from taut.control.law import Law, call
from taut.control.trajectories.force_reference import hybrid_kind

Array = Float64Array
LINK = """<link name="{name}"><inertial><origin xyz="{com} 0 0"/><mass value="1"/>
<inertia ixx="1e-3" iyy="8e-3" izz="8e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{x} 0 0"/><axis xyz="0 1 0"/></joint>"""
END = """<link name="{side}_end"/><joint name="{side}_tip" type="fixed"><parent link="{side}_fore"/>
<child link="{side}_end"/><origin xyz="0.3 0 0"/></joint>"""
MOTORS, LOOSE = [0, 2], [1, 3]
PIN = taut.Constraint.pin("left_end", "right_end", directions=[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> taut.Arm:
    """Two branches of two links each on one base."""
    text = ""
    for side, foot in (("left", -0.1), ("right", 0.1)):
        for part, parent, x in (("upper", "base", foot), ("fore", f"{side}_upper", 0.3)):
            text += LINK.format(name=f"{side}_{part}", com=0.15)
            text += JOINT.format(name=f"{side}_{part}_joint", parent=parent, child=f"{side}_{part}", x=x)
        text += END.format(side=side)
    file = tmp_path_factory.mktemp("five_bar") / "five_bar.urdf"
    file.write_text(f'<robot name="five_bar"><link name="base"/>{text}</robot>')
    return taut.load_arm(file, tool="left_end", home=[-2.0, 1.0, -1.1, -1.0])


@pytest.fixture(scope="module")
def way(arm: taut.Arm) -> Any:
    """Both motors go to and fro; the loose joints are where the loop closes."""
    q, rows, times = taut.dynamics.onto(PIN, arm, arm.home), [], np.linspace(0.0, 1.0, 81)
    start = q
    for t in times:
        swing = 0.5 * (1.0 - np.cos(2.0 * np.pi * t)) * np.array([0.3, -0.2])
        held = taut.Constraint.of_joints(lambda y, at=start[MOTORS] + swing: y[MOTORS] - at, rows=2)
        q = taut.dynamics.onto(PIN + held, arm, q)
        rows.append(q)
    return taut.trajectories.Spline(times=times, points=rows)


class TwoMotors(Law):
    """A hybrid law whose loose joints have no torque: their part is what the chain itself can bear, A^T lam."""

    reference = hybrid_kind(taut.JointMotion)
    hybrid: Law

    def command(self, x: taut.Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, object]]:
        command, after = call(self.hybrid, x, ref, memory["hybrid"], dt)
        A = PIN.at(x).A_q
        loose = taut.math.array([command.terms.total[i] for i in LOOSE])
        a, b, c, d = A[0, 1], A[1, 1], A[0, 3], A[1, 3]  # A_loose^T lam = -loose
        lam = taut.math.array([b * loose[1] - d * loose[0], c * loose[0] - a * loose[1]]) / (a * d - b * c)
        return Torque(command.terms + Terms(bears=A.T @ lam)), {"hybrid": after}


def law() -> TwoMotors:
    motion = taut.laws.ComputedTorque(kp=400.0, kd=40.0)
    return TwoMotors(hybrid=taut.laws.HybridMotionForce(constraint=PIN, motion=motion))


def test_two_motors_move_the_loop_in_both_plants_alike(arm: taut.Arm, way: Any) -> None:
    ctrl, target = taut.compile(law(), arm), taut.pressing(way, lam=[0.0, 0.0])
    rigid = taut.run(ctrl, taut.RigidPlant(arm, friction=None, contact=PIN), target, duration=1.0, q0=way.at(0.0).q)
    scene = """<equality><connect body1="left_fore" body2="right_fore" anchor="0.3 0 0" solref="0.004 1"
    solimp="0.9999 0.9999 0.001"/></equality>"""
    plant = taut.MujocoPlant(arm, friction=None, scene=scene)
    plant.model.eq_data[0, 3:6] = [0.3, 0.0, 0.0]  # MuJoCo takes it from the open chain at zero
    real = taut.run(ctrl, plant, target, duration=1.0, q0=way.at(0.0).q)
    for found in (rigid, real):
        assert found.outcome.ok
        assert np.abs(found.tau[:, LOOSE]).max() < 1e-9 * np.abs(found.tau).max()
        assert np.ptp(found.q[:, MOTORS], axis=0) == pytest.approx([0.3, 0.2], abs=0.01)
        assert np.abs(found.error).max() < 1e-3  # type: ignore[arg-type]
    assert rigid.extra["contact.drift"].max() < 1e-9
    assert np.abs(real.q - rigid.q).max() < 2e-5
    assert np.abs(real.tau - rigid.tau).max() < 1e-4 * np.abs(rigid.tau).max()
