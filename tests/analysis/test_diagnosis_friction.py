"""The doctor on arms with dry friction, without limits, and from a log: what it says holds for the arm that there is."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import taut
from taut.cli.main import main

L = taut.laws
STEP = 0.3  # [rad]
SMALL = 0.05  # [rad] which one joint of most arms follows, and the others do not


def with_friction(name: str, own: float = 0.0) -> Iterator[tuple[np.ndarray, taut.Run]]:
    """Runs of an arm with 1 and 3 N m of dry friction that its controller does not know, beside a part of its own."""
    arm = taut.load_arm(name)
    M = np.diag(np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).M))
    ctrl = taut.compile(L.GravityPID(kp=100.0 * M, kd=20.0 * M), arm)
    for coulomb in (1.0, 3.0):
        dry = coulomb + own * arm.coulomb
        plant = taut.RigidPlant(arm.with_friction(taut.Friction(coulomb=dry, viscous=own * arm.viscous)))
        for way in (SMALL, STEP):
            path = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + way, duration=1.0)
            for ref in (path, taut.JointMotion(q=arm.home + way)):
                yield dry, taut.run(ctrl, plant, ref, duration=3.0, progress=False)


WHOLE = bool(os.environ.get("TAUT_BARS"))  # `make bars`
ARMS = [(name, 0.0) for name in ("xarm7", "kinova", "panda", "fr3", "ur3", "ur5", "ur10", "z1")] + [("xarm7", 1.0)]


@pytest.mark.bars
@pytest.mark.parametrize(
    ("name", "own"), ARMS if WHOLE else [pair for pair in ARMS if pair[0] in ("xarm7", "kinova")]
)
def test_the_torque_that_breaks_a_joint_away_is_its_dry_friction(name: str, own: float) -> None:
    """Nothing but friction is planted: no load is found, and no joint rests against more than its friction."""
    fitted = 0
    for dry, run in with_friction(name, own):
        found = [each for each in taut.doctor(run).findings if each.name != "jumps at start"]
        assert [each.name for each in found] == ["sticks"], run
        planted = dry[run.joint_names.index(str(found[0].joint))]
        numbers = {key: number.value for key, number in found[0].evidence.items()}
        assert numbers["torque that does not move it"] <= 1.001 * planted
        if "dry friction fitted" in numbers:
            fitted += 1
            assert numbers["dry friction fitted"] == pytest.approx(planted, rel=0.01)
    assert fitted >= 3  # of eight runs


def test_a_joint_that_creeps_to_where_friction_holds_it_has_no_load() -> None:
    """It is not at rest yet, and what its spring balances is the friction that its motion showed."""
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0])
    ctrl = taut.compile(L.PID(kp=12.0, kd=30.0), arm)
    plant = taut.RigidPlant(arm.with_friction(taut.Friction(coulomb=0.8)))
    run = taut.run(ctrl, plant, taut.JointMotion(q=arm.home + 0.6), duration=12.0)
    assert abs(run.v[-1, 0]) > 1e-4
    (found,) = taut.doctor(run, arm=arm).findings
    assert found.name == "sticks"
    assert found.evidence["dry friction fitted"].value == pytest.approx(0.8, rel=0.01)


# -------------------------------------------------------------------- torques that an arm does not have


@pytest.mark.parametrize("mujoco", [False, True])
def test_torques_beyond_the_limits_of_an_arm_are_found_and_no_long_blend_is_advised(mujoco: bool) -> None:
    arm = taut.load_arm("panda")
    T = taut.snapshot(arm, arm.home).T()
    ctrl = taut.compile(L.Impedance(K=(50_000.0, 300.0), zeta=0.7), arm)
    plant = taut.MujocoPlant(arm) if mujoco else taut.RigidPlant(arm)
    goal = taut.TaskMotion(pose=taut.Pose(T.p + np.array([0.1, 0.0, 0.0]), R=T.R))
    run = taut.run(ctrl, plant, goal, duration=1.0)
    jump, beyond = taut.doctor(run).findings
    assert (jump.name, beyond.name, beyond.follows) == ("jumps at start", "beyond limits", "jumps at start")
    assert "blend" not in jump.remedy
    i = arm.joint_names.index(str(beyond.joint))
    assert beyond.evidence["largest torque"].value == np.abs(run.tau[:, i]).max() > 50.0 * arm.effort[i]
    assert beyond.evidence["effort limit of the arm"].value == arm.effort[i]
    assert "limits=taut.Limits.of(arm)" in beyond.remedy
    limited = taut.run(taut.compile(ctrl.law, arm, limits=taut.Limits.of(arm)), plant, goal, duration=1.0)
    assert "beyond limits" not in [each.name for each in taut.doctor(limited).findings]


@pytest.mark.parametrize("times", [0.4, 0.9, 2.0])
def test_a_blend_is_advised_where_a_short_one_takes_the_jump_away(times: float) -> None:
    arm = taut.load_arm("ur5")
    inertia = float(np.asarray(taut.snapshot(arm, arm.home, np.zeros(6)).M)[0, 0])
    off = times * arm.effort[0] / (400.0 * inertia)
    goal = taut.JointMotion(q=arm.home + off * (np.arange(6) == 0))
    law = L.ComputedTorque(kp=400.0, kd=40.0)
    jump = taut.doctor(taut.run(taut.compile(law, arm), taut.RigidPlant(arm), goal, duration=1.0)).findings[0]
    assert jump.name == "jumps at start"
    blend = re.search(r"taut\.Limits\(blend=([\d.]+)\)", jump.remedy)
    assert (blend is not None) == (times < 1.0)
    if blend is not None:
        assert float(blend[1]) <= 0.2
        ctrl = taut.compile(law, arm, limits=taut.Limits(blend=float(blend[1])))
        after = taut.doctor(taut.run(ctrl, taut.RigidPlant(arm), goal, duration=1.0)).findings
        assert "jumps at start" not in [each.name for each in after]


# -------------------------------------------------------------------- one answer to one run


def test_a_run_its_log_and_the_command_get_one_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An arm of a file, with gears: its log holds it, and another arm is said to be another."""
    text = taut.load_arm("planar2")
    arm = taut.load_arm("planar2").with_gears(100.0, 2e-4)
    M = np.diag(np.asarray(taut.snapshot(arm, arm.home, np.zeros(2)).M))
    ctrl = taut.compile(L.GravityPID(kp=400.0 * M, kd=[4.0 * M[0], 0.8 * M[1]]), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=arm.home + 0.2), duration=2.0)
    told = taut.doctor(run)
    assert [each.name for each in told.findings][:1] == ["oscillates"]
    log = run.save(tmp_path / "run.mcap")
    assert taut.doctor(taut.load_run(log)).json() == told.json()
    main(["doctor", str(log)])
    assert told.findings[0].remedy in capsys.readouterr().out
    assert taut.doctor(run, arm=arm).findings[0].remedy == told.findings[0].remedy
    other = taut.doctor(run, arm=text)
    assert "gear, rotor_inertia" in other.model
    assert "gear" not in taut.doctor(run, arm=arm).model


# -------------------------------------------------------------------- a contact that bounces


def wiped(contact: str) -> taut.Run:
    """A Panda that strokes over a box of MuJoCo with friction 0.4, and presses with 10 N."""
    arm = taut.load_arm("panda")
    T = taut.snapshot(arm, arm.home).T()
    x, y, z = T.p
    box = f'<geom type="box" size="0.4 0.4 0.01" pos="{x} {y} {z - 0.0201}" friction="0.4" {contact}/>'
    law = L.HybridMotionForce(
        constraint=taut.Constraint.plane(point=T.p, normal=[0.0, 0.0, 1.0]),
        motion=L.TaskComputedTorque(kp=400.0, kd=40.0),
        kfp=0.3,
        kfi=20.0,
        kdamp=100.0,
    )
    stroke = taut.trajectories.Line(T0=T, T1=taut.Pose(T.p + np.array([0.1, 0.05, 0.0]), R=T.R), duration=0.8)
    plant = taut.MujocoPlant(arm, scene=f"<mujoco><worldbody>{box}</worldbody></mujoco>")
    return taut.run(taut.compile(law, arm), plant, taut.pressing(stroke, 10.0), duration=1.0, progress=False)


def test_a_contact_that_bounces_is_found_and_its_remedy_ends_it() -> None:
    run = wiped("")
    assert np.ptp(run.extra["F_ext"][200:, 2]) > 15.0
    found = taut.doctor(run).findings[0]
    assert (found.name, found.term) == ("bounces", "contact")
    contact = re.search(r'priority="\d" solimp="[^"]*"', found.remedy)
    assert contact is not None
    calm = wiped(contact[0])
    assert np.ptp(calm.extra["F_ext"][200:, 2]) < 2.0
    assert taut.doctor(calm).healthy
