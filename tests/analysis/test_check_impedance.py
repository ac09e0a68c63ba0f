"""Whether a spring at the tool is safe: what is said before a run, against what the run does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import taut

RATE = 100.0  # [Hz], where arms meet the limit at stiffness that people ask for


def controller(arm: taut.Arm, **gains: Any) -> taut.Controller:
    return taut.compile(taut.laws.Impedance(**({"K": (3000.0, 100.0), "B": (30.0, 0.05)} | gains)), arm, rate=RATE)


def grows(arm: taut.Arm, ctrl: taut.Controller, factor: float, q: Any) -> bool:
    """Whether a small deviation is larger at the end of a run than in its middle."""
    K = np.asarray(ctrl.law.parameters()["K"])
    plant = taut.RigidPlant(arm, friction=None, integrator="rk4", substeps=10)
    loop = taut.Loop(ctrl, plant, taut.TaskMotion(pose=taut.snapshot(arm, q).T()), duration=3.0)
    loop.parameters["law.K"] = factor * K
    run = taut.run(loop, q0=q + 1e-6 * np.cos(np.arange(arm.n)))
    parts = [np.abs(part).max() for part in np.array_split(run.v, 10)]
    return not run.outcome.ok or bool(parts[9] > parts[5])


@pytest.mark.parametrize("name", ["panda", "ur10", "xarm7"])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_the_limit_that_is_told_is_where_runs_begin_to_grow(name: str) -> None:
    arm = taut.load_arm(name).with_friction(taut.Friction())
    ctrl = controller(arm, B=(10.0, 0.005) if name == "xarm7" else (30.0, 0.05))  # its wrist is light
    check = taut.analysis.check_impedance(ctrl)
    limit = check.stable_up_to
    assert limit > 0.0
    assert check.stable == (limit > 1.0)
    assert not grows(arm, ctrl, 0.97 * limit, arm.home)
    assert grows(arm, ctrl, 1.03 * limit, arm.home)


def test_a_change_of_a_gain_changes_the_answer() -> None:
    arm = taut.load_arm("panda")
    ctrl = controller(arm)
    before = taut.analysis.check_impedance(ctrl).stable_up_to
    ctrl.parameters["law.K"] = (6000.0, 200.0)
    assert taut.analysis.check_impedance(ctrl).stable_up_to == pytest.approx(0.5 * before, rel=1e-3)


def test_a_payload_of_now_counts() -> None:
    arm = taut.load_arm("panda")
    ctrl = taut.compile(taut.laws.Impedance(K=(800.0, 30.0), B=(20.0, 1.0)), arm)
    ctrl.parameters["model.payload.mass"] = 3.0
    carried = taut.compile(ctrl.law, arm.with_payload(mass=3.0))
    assert taut.analysis.check_impedance(ctrl).loop.mass == pytest.approx(
        taut.analysis.check_impedance(carried).loop.mass, rel=1e-9
    )
    assert np.linalg.norm(taut.analysis.check_impedance(ctrl).loop.mass) > 1.1 * np.linalg.norm(
        taut.analysis.check_impedance(taut.compile(ctrl.law, arm)).loop.mass
    )


def test_axes_and_errors_of_the_law_are_those_of_the_answer() -> None:
    arm = taut.load_arm("panda")
    six = [500.0, 1000.0, 3000.0, 20.0, 40.0, 80.0]
    q = arm.home + 0.3
    tool = taut.analysis.check_impedance(controller(arm, K=six, frame="tool"), q).stable_up_to
    body = taut.analysis.check_impedance(controller(arm, K=six, error="body"), q).stable_up_to
    world = taut.analysis.check_impedance(controller(arm, K=six), q).stable_up_to
    assert tool == pytest.approx(body, rel=1e-6)
    assert abs(tool - world) > 0.01 * tool


def test_a_spring_with_joint_damping_is_a_case_of_its_own() -> None:
    arm = taut.load_arm("panda").with_friction(taut.Friction())
    bare, damped = (taut.compile(taut.laws.Stiffness(K=(500.0, 20.0), kd=kd), arm) for kd in (0.0, 2.0))
    assert not taut.analysis.check_impedance(bare).passive_in_band
    assert taut.analysis.check_impedance(damped).passive_in_band


def test_a_loop_that_is_unstable_by_itself_gives_energy_in_every_band() -> None:
    """Far too much damping: in its phase below 20 Hz it takes energy, and at half the rate it grows."""
    arm = taut.load_arm("panda").with_friction(taut.Friction())
    check = taut.analysis.check_impedance(controller(arm, K=(100.0, 5.0), B=(400.0, 20.0)))
    assert check.spare_in_band > 0.0
    assert not check.stable
    assert not check.passive_in_band
    assert check.passive_in_band_up_to == 0.0
    assert check.sentences[2] == "gives energy to some motion below 20 Hz, with any part of K"


def test_a_spring_of_a_sum_is_found() -> None:
    arm = taut.load_arm("panda")
    law = taut.laws.Impedance(K=(800.0, 30.0), zeta=0.7) + taut.laws.FrictionCompensation(at="meas")
    assert taut.analysis.check_impedance(taut.compile(law, arm)).stable


@pytest.mark.parametrize(
    ("law", "sentence"),
    [
        (taut.laws.TaskComputedTorque(kp=1.0, kd=1.0), "with one Impedance or Stiffness law; this one has TaskComp"),
        (
            taut.laws.Impedance(K=(1.0, 1.0), zeta=1.0)
            + taut.laws.VirtualWall(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0], K=1e6),
            "knows no virtual objects, and VirtualWall adds a spring of its own; ask taut.analysis.check_stiffness_at",
        ),
        (taut.laws.Impedance(K=(1.0, 1.0), zeta=1.0, D=(1.0, 1.0)), "with D the loop goes through the wrist sensor"),
    ],
)
def test_what_it_cannot_answer_is_refused(law: taut.Law, sentence: str) -> None:
    with pytest.raises(taut.errors.UsageError, match=sentence):
        taut.analysis.check_impedance(taut.compile(law, taut.load_arm("panda")))


@pytest.mark.parametrize("name", ["planar2", "so101"])
def test_arms_of_few_joints_are_judged_in_the_directions_that_they_have(name: str) -> None:
    arm = taut.load_arm(name)
    q = arm.home + 0.3
    law = taut.laws.Impedance(K=(50.0, 1.0), B=(1.0, 0.01))
    found = taut.analysis.check_impedance(taut.compile(law, arm), q)
    wanted = taut.analysis.check_stiffness_at(arm, q, K=(50.0, 1.0), B=(1.0, 0.01), band=20.0)
    assert found.passive_in_band_up_to == pytest.approx(wanted.passive_in_band_up_to, rel=1e-6, abs=1e-9)
    assert (found.stable, found.passive) == (wanted.stable, wanted.passive)


def test_something_else_than_a_controller_is_refused() -> None:
    with pytest.raises(taut.errors.UsageError, match="a controller from taut"):
        taut.analysis.check_impedance(3)  # type: ignore[arg-type]
