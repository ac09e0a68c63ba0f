"""The doctor: planted faults are found with their term, healthy runs are left alone, numbers are right."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import re
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import diagnosis_runs as runs
import numpy as np
import pytest
from refusals import refused

import taut
from taut.analysis import CHECKS, Check, ExaminedRun, Finding, Threshold
from taut.analysis.diagnosis.checks import SHARED
from taut.analysis.diagnosis.spectrum import fit_sinusoid
from taut.cli.main import main
from taut.record.info import Outcome
from taut.scenarios.scenario import built_in_scenarios, load_scenario

Bar = Callable[[str, object], None]
L = taut.laws
MODEL_PLANT_ONLY = ("late", "leaning_board")  # a clock and a contact of their own
BESIDE = {
    "play": {"torque jump at the start"},
    "underdamped": {"torque jump at the start"},
}  # start off their targets
CASES = [(fault, arm, "rigid") for fault in runs.FAULTS for arm in runs.ARMS]
CASES += [(fault, "panda", "mujoco") for fault in runs.FAULTS if fault not in MODEL_PLANT_ONLY]
SOUND = [(law, arm, "rigid") for law in runs.HEALTHY for arm in runs.ARMS]
SOUND += [(law, "panda", "mujoco") for law in runs.HEALTHY if law not in ("healthy_force", "healthy_hybrid")]


@functools.cache
def heavy() -> taut.Run:
    """A Panda that carries 1.5 kg which its controller does not know."""
    arm = taut.load_arm("panda")
    ctrl = taut.compile(L.ComputedTorque(kp=100.0, kd=20.0), arm)
    return taut.run(ctrl, taut.RigidPlant(arm.with_payload(1.5)), duration=0.5)


def names(run: taut.Run) -> list[tuple[str, str]]:
    """The findings of a run that are not a consequence of another."""
    return [(each.name, each.term) for each in taut.doctor(run).findings if not each.follows]


def some(cases: list[tuple[str, str, str]], share: Callable[[int], int]) -> list[tuple[str, str, str]]:
    """All in `make bars`, else a seeded thirtieth: each has a loop of its own to compile."""
    count = len(cases) if share(len(cases)) == len(cases) else share(len(cases)) // 3
    picked = np.random.default_rng(0).permutation(len(cases))[:count]
    return [cases[i] for i in sorted(picked)]


# -------------------------------------------------------------------- bars


@pytest.mark.bars
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")  # some are, with dry friction left out
def test_a_planted_fault_is_found_with_the_term_responsible(share: Callable[[int], int], bar: Bar) -> None:
    """First in nearly all runs, and first or second in all; with nothing else beside it that is no consequence."""
    chosen, first, missed = some(CASES, share), 0, []
    for fault, arm, kind in chosen:
        rng = np.random.default_rng([list(runs.FAULTS).index(fault), runs.ARMS.index(arm), 7])
        run, *planted = runs.FAULTS[fault](arm, rng, kind)
        found = taut.doctor(run).findings
        named = [[each.name, each.term] for each in found]
        beside = {each.name for each in found[1:] if not each.follows} - BESIDE.get(fault, set())
        first += named[:1] == [planted] and not beside
        if planted not in named[:2]:
            missed.append(f"{fault} on {arm} ({kind}): {named}")
    bar("the doctor: faults found first, nothing false beside them", f"{first} of {len(chosen)}")
    assert not missed
    assert first >= 0.98 * len(chosen)


@pytest.mark.bars
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")  # some are, with dry friction left out
def test_healthy_runs_raise_no_alarm(share: Callable[[int], int], bar: Bar) -> None:
    chosen, alarms = some(SOUND, share), []
    for law, arm, kind in chosen:
        rng = np.random.default_rng([list(runs.HEALTHY).index(law), runs.ARMS.index(arm), 3])
        diagnosis = taut.doctor(runs.HEALTHY[law](arm, rng, kind))
        if not diagnosis.healthy:
            alarms.append(f"{law} on {arm} ({kind}): {diagnosis}")
    bar("the doctor: false alarms in healthy runs", f"{len(alarms)} of {len(chosen)}")
    assert not alarms


SCENARIOS = {  # all other runs have no finding, nor has panda_geared's payload that is picked up during the run
    ("backlash_cycle", "backlash", "high gain"): ("backlash", "transmission"),
    ("backlash_cycle", "no backlash", "low gain"): ("steady-state error", "P"),  # its friction is behind a spring
    ("cabinet_door", "", "hybrid"): ("wrong surface", "constraint"),
    ("feedforward_error", "", "feedback"): ("gravity not compensated", "P"),  # PID alone lags under the weight
    ("flexible_joints", "exact", "fast torque loop"): (
        "torque jump at the start",
        "torque_loop",
    ),  # it starts at once
    ("flexible_joints", "0.1 kg more", "fast torque loop"): ("torque jump at the start", "torque_loop"),
    ("flexible_joints", "0.1 kg more", "linearisation"): ("effort limit exceeded", "command"),
    ("friction_overcompensated", "30 % too much", "at meas"): ("stick-slip", "friction"),
    ("gain_bounds", "resolution", "modest gains"): ("chatter", "D"),  # 980 N m/s of 10 N m
    ("gain_bounds", "resolution", "large gains"): ("chatter", "D"),
    ("gain_bounds", "saturation", "large gains"): ("saturation", "torque"),
    ("gain_bounds", "delay", "large gains"): ("oscillation", "delay"),
    ("gain_bounds", "servo rate", "large gains"): ("oscillation", "D"),
    ("gain_bounds", "backlash", "large gains"): ("backlash", "transmission"),
    ("gain_bounds", "elasticity", "large gains"): ("oscillation", "transmission"),
    ("kinova_identifies", "old model", "computed torque"): ("wrong payload", "nonlinear"),
    ("one_joint_pid", "", "PD"): ("gravity not compensated", "P"),
    ("panda_backlash", "stretched", "computed torque"): ("backlash", "transmission"),
    ("panda_learns", "not learned", "computed torque"): ("wrong payload", "nonlinear"),
    ("panda_learns", "learned in ten trials", "computed torque"): ("wrong payload", "nonlinear"),  # the model stays
    ("panda_lqr", "0.05 rad away", "LQR"): ("torque jump at the start", "P"),  # from rest away from the goal
    ("panda_lqr", "0.05 rad away", "computed torque"): ("torque jump at the start", "P"),
    ("panda_lqr", "0.6 rad away", "LQR"): ("torque jump at the start", "P"),
    ("panda_lqr", "0.6 rad away", "computed torque"): ("torque jump at the start", "P"),
    ("panda_lqr", "another pose", "LQR"): ("torque jump at the start", "P"),
    ("panda_lqr", "another pose", "computed torque"): ("torque jump at the start", "P"),
    ("panda_payload", "", "PID"): ("gravity not compensated", "P"),
    ("panda_payload", "", "PD + gravity"): ("wrong payload", "gravity"),
    ("panda_payload", "", "feedforward + PD"): ("wrong payload", "nonlinear"),
    ("panda_payload", "", "computed torque"): ("wrong payload", "nonlinear"),
    ("panda_robust", "2 kg", "computed torque"): ("wrong payload", "nonlinear"),
    ("panda_robust", "2 kg", "observer"): ("wrong payload", "nonlinear"),
    ("panda_robust", "2 kg", "PID"): ("wrong payload", "nonlinear"),
    ("panda_robust", "2 kg", "robust"): ("wrong payload", "nonlinear"),
    ("panda_springs", "computed torque, rotors", "task"): ("effort limit exceeded", "command"),  # without limits
    ("panda_springs", "springs, stiff", "task"): ("effort limit exceeded", "command"),
    ("so101_servo", "", "PD"): ("gravity not compensated", "P"),
    ("so101_servo", "", "PD + f meas"): ("gravity not compensated", "P"),
    ("so101_servo", "", "PD + f ref"): ("gravity not compensated", "P"),
    ("wrist_alignment", "", "plain"): ("singularity", "feedforward"),
    ("wrist_alignment", "", "robust"): ("singularity", "singularity"),
    ("wrong_board", "nothing is done", "hybrid"): ("wrong surface", "constraint"),
    ("wrong_board", "low gains", "hybrid"): ("wrong surface", "constraint"),
    ("wrong_board", "compliant tool", "hybrid"): ("wrong surface", "constraint"),
    ("z1_mit_motors", "torques at 100 Hz", "soft"): ("stiction", "friction"),
    ("z1_mit_motors", "torques at 100 Hz", "stiff"): ("oscillation", "D"),
    ("z1_mit_motors", "in the motors at 5 kHz", "soft"): ("stiction", "friction"),
}
QUICK = ("gain_bounds", "ur10_velocity")


def of_scenario(scenario: str) -> dict[tuple[str, str, str], tuple[str, str] | None]:
    """The first finding of each run of a built-in scenario, of a spread of two."""
    out: dict[tuple[str, str, str], tuple[str, str] | None] = {}
    for trial, one in load_scenario(scenario).trials.items():
        if one.spread is not None and len(out) == 2:
            break
        experiment = one.experiment.prepared(one.laws[trial.law])
        diagnosis = taut.doctor(experiment.run(experiment.controller(one.laws[trial.law])))
        assert not diagnosis.problems, trial
        found = diagnosis.findings
        out[scenario, trial.case, trial.law] = (found[0].name, found[0].term) if found else None
    return out


@pytest.mark.bars
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_every_scenario_is_judged_as_what_it_shows(share: Callable[[int], int], bar: Bar) -> None:
    slow = [name for name in built_in_scenarios() if name not in QUICK]
    chosen = [*QUICK, *(slow if share(len(slow)) == len(slow) else ())]
    found = {key: first for name in chosen for key, first in of_scenario(name).items()}
    bar("the doctor: runs of scenarios judged as what they show", f"{len(found)} of {len(found)}")
    assert found == {key: SCENARIOS.get(key) for key in found}


# -------------------------------------------------------------------- the table of checks


def test_the_page_prints_the_table_of_thresholds() -> None:
    page = (Path(__file__).parents[2] / "docs" / "doctor.md").read_text(encoding="utf-8")
    of = [("several", each) for each in SHARED] + [
        (check.name, each) for check in CHECKS for each in check.thresholds
    ]
    for name, each in of:
        unit = "" if each.unit == "1" else " " + each.unit.replace("|", "\\|")
        assert f"| {name} | {each.name} | {each.value:g}{unit} | {each.reason} |" in page
    assert len(of) <= 25
    assert len({each.name for _, each in of}) == len(of)


def test_the_page_lists_every_check_with_what_it_needs() -> None:
    page = (Path(__file__).parents[2] / "docs" / "doctor.md").read_text(encoding="utf-8")
    for check in CHECKS:
        needs = ", ".join(check.needs) or "-"
        assert re.search(rf"^\| {re.escape(check.name)} \| .* \| {needs} \|$", page, re.MULTILINE), check.name
        assert set(check.follows) <= {each.name for each in CHECKS}


def too_fast(run: ExaminedRun) -> Finding | None:
    """A check of a user's own."""
    speed = np.abs(run.run.v).max(axis=0)
    i = int(speed.argmax())
    too = speed[i] > run.threshold["joint speed"]
    return run.finding("command", i, 1.0, {"speed": (speed[i], "rad/s")}) if too else None


def test_a_check_of_ones_own_is_one_function() -> None:
    limit = Threshold(name="joint speed", value=1e-3, unit="rad/s", reason="a person stands beside it")
    mine = Check(
        name="too fast",
        test=too_fast,
        thresholds=(limit,),
        cause="'{joint}' moves at {speed}",
        remedy={"P": "unused", "": "give {term} more time"},
        follows=("wrong payload",),
    )
    payload, fast = taut.doctor(heavy(), checks=[*CHECKS, mine]).findings
    assert (payload.name, fast.name, fast.follows) == ("wrong payload", "too fast", ("wrong payload",))
    assert fast.cause == f"'{fast.joint}' moves at {fast.evidence['speed']}"
    assert fast.remedy == "give command more time"
    fast.plot().savefig(BytesIO(), format="png")
    needs = dataclasses.replace(mine, needs=("error", "length"))
    short = heavy().between(0.0, 0.1)
    assert taut.doctor(short, checks=[needs]).notes == ("too fast: the run is too short",)
    wrong = dataclasses.replace(mine, cause="{velocity}")
    with refused(taut.errors.UsageError):
        taut.doctor(heavy(), checks=[wrong])


# -------------------------------------------------------------------- numbers against what was planted


@functools.cache
def computed_torque(name: str) -> taut.Controller:
    """Of an arm that carries nothing."""
    return taut.compile(L.ComputedTorque(kp=100.0, kd=20.0), runs.arm_of(name))


def carried(name: str, mass: float, com: list[float], duration: float = 1.0, angle: float = 0.0) -> taut.Run:
    """An arm that holds still, or moves by an angle, with a payload that was not declared."""
    arm = runs.arm_of(name)
    path = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + angle, duration=1.0)
    return taut.run(computed_torque(name), taut.RigidPlant(arm.with_payload(mass, com=com)), path, duration=duration)


@pytest.mark.part(1)
@pytest.mark.parametrize(
    ("name", "mass", "com", "duration", "angle"),
    [
        ("panda", 2.0, [0.05, 0.0, 0.1], 1.0, 0.0),
        ("panda", 2.0, [0.02, 0.0, 0.06], 2.0, 0.3),
        ("ur10", 4.0, [0.03, -0.04, 0.08], 1.0, 0.0),
    ],
)
def test_a_payload_is_found_alone_with_its_mass_and_centre(
    name: str, mass: float, com: list[float], duration: float, angle: float
) -> None:
    found = taut.doctor(carried(name, mass, com, duration, angle)).findings
    assert [finding.name for finding in found] == ["wrong payload"]
    numbers = {key: number.value for key, number in found[0].evidence.items()}
    assert numbers["beyond the declared"] == pytest.approx(mass, rel=2e-3)
    assert [numbers[f"centre {axis}"] for axis in "xyz"] == pytest.approx(com, abs=1e-3)
    assert 3e-4 < numbers["standard error of the centre"] < 0.03


@pytest.mark.long
def test_a_payload_is_fitted_beyond_the_one_that_was_declared() -> None:
    arm = runs.arm_of("panda")
    ctrl = taut.compile(L.ComputedTorque(kp=100.0, kd=20.0), arm.with_payload(1.0, com=[0.0, 0.0, 0.05]))
    run = taut.run(ctrl, taut.RigidPlant(arm.with_payload(2.0, com=[0.05, 0.0, 0.1])), duration=1.0)
    (found,) = taut.doctor(run).findings
    assert "arm.with_payload(2, com=(0.050, 0.000, 0.100))" in found.remedy
    assert found.evidence["beyond the declared"].value == pytest.approx(1.0, abs=2e-3)
    gone = taut.run(ctrl, taut.RigidPlant(arm), duration=1.0)
    (found,) = taut.doctor(gone).findings
    assert "arm.with_payload(0)" in found.remedy
    assert "centre x" not in found.evidence
    at_rest = carried("panda", 2.0, [0.03, 0.0, 0.1], 4.0).between(3.0, 4.0)  # gravity shows no centre along itself
    (found,) = taut.doctor(at_rest).findings
    assert found.evidence["standard error of the centre"].value > 0.05


def test_a_load_and_friction_are_two_faults() -> None:
    """Half a kilogram has next to no moment about the last wrist axis, which friction holds."""
    arm, q = taut.load_arm("ur5"), np.array([0.2, -1.2, 1.5, -1.0, 0.8, 0.3])
    plant = taut.RigidPlant(arm.with_payload(0.5).with_friction(taut.Friction(coulomb=1.0, viscous=1.0)))
    path = taut.trajectories.Quintic(q0=q, q1=q + 0.6, duration=1.0)
    run = taut.run(taut.compile(L.ComputedTorque(kp=100.0, kd=20.0), arm), plant, path, duration=3.0, q0=q)
    assert {each.name for each in taut.doctor(run).findings} == {"stiction", "wrong payload"}


@pytest.mark.parametrize("name", ["one_joint", "panda"])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_reversed_drive_is_found_by_its_torque(name: str) -> None:
    arm = runs.arm_of(name)
    found = taut.doctor(runs.turned_drive(name)).findings[0]
    assert (found.name, found.term, found.joint) == ("wrong sign", "command", arm.joint_names[max(arm.n - 2, 0)])
    assert found.evidence["residual over torque"].value == pytest.approx(2.0, rel=1e-9)


class DrivingDamping(taut.Law):
    """PD with gravity compensation whose damping has the wrong sign.

    Law:          tau = kp e - kd e_dot + g
    Closed loop:  M e_ddot - kd e_dot + kp e = 0
    """

    kp: taut.Gain
    kd: taut.Gain

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=self.kp @ x.difference(ref.q), D=-(self.kd @ (ref.v - x.v)), gravity=x.g)


class ReversedSpring(taut.Law):
    """PD with gravity compensation whose spring is reversed at the second joint.

    Law:          tau = s kp e + kd e_dot + g, with s = -1 at the second joint
    Closed loop:  M e_ddot + kd e_dot + s kp e = 0
    """

    kp: taut.Gain
    kd: taut.Gain

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        s = np.where(np.arange(x.n) == 1, -1.0, 1.0)
        return taut.Torque(P=s * (self.kp @ x.difference(ref.q)), D=self.kd @ (ref.v - x.v), gravity=x.g)


@pytest.mark.parametrize(
    ("name", "law", "kd", "term"), [("ur5", ReversedSpring, 10.0, "P"), ("gantry3", DrivingDamping, 4.0, "D")]
)
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_reversed_gain_is_found_with_its_term_and_joint(
    name: str, law: type[taut.Law], kd: float, term: str
) -> None:
    """Others are pushed off their targets by it, and theirs are the first in the list."""
    arm, m = runs.arm_of(name), runs.inertia(name)
    path = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + np.linspace(0.3, 0.1, arm.n), duration=0.6)
    ctrl = taut.compile(law(kp=100.0 * m, kd=kd * m), arm, limits=taut.Limits.of(arm))
    first, *others = taut.doctor(taut.run(ctrl, taut.RigidPlant(arm), path, duration=1.5)).findings
    assert (first.name, first.term) == ("wrong sign", term)
    assert term == "D" or first.joint == arm.joint_names[1]
    assert all(each.follows == ("wrong sign",) for each in others)


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_loop_that_runs_away_at_once_is_reported_by_its_judgement() -> None:
    """kd T / M is 4.6 at the last joint, where 2 is the stability limit: too few ticks for a fit of any kind."""
    arm = taut.load_arm("panda")
    ctrl = taut.compile(L.GravityPID(kp=300.0, kd=30.0), arm)
    path = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.3, duration=1.0)
    run = taut.run(ctrl, taut.RigidPlant(arm), path, duration=0.5)
    diagnosis = taut.doctor(run)
    found = diagnosis.findings[0]
    assert (found.name, found.term, found.joint) == ("oscillation", "D", "panda_joint7")
    assert found.evidence["spectral radius"].value == pytest.approx(run.info.stability.radius)
    assert "the largest gain that is stable is law.kd" in found.note
    assert any(problem.startswith("the loop ran away") for problem in diagnosis.problems)


@pytest.mark.parametrize(("growth", "omega"), [(-0.8, 40.0), (0.0, 25.0), (1.5, 90.0)])
def test_a_sinusoid_has_the_frequency_and_growth_that_it_was_made_with(growth: float, omega: float) -> None:
    t = np.arange(1500) * 1e-3
    line = fit_sinusoid(0.3 + 0.2 * t + np.exp(growth * t) * np.cos(omega * t + 0.4), 1e-3)
    assert line is not None
    assert line.omega == pytest.approx(omega, rel=1e-6)
    assert line.growth == pytest.approx(growth, abs=1e-5)
    assert line.fraction == pytest.approx(1.0, abs=1e-9)
    assert line.last == pytest.approx(np.exp(growth * 1.5), rel=1e-2)


def test_noise_and_a_decay_are_no_sinusoid_and_one_at_half_of_the_rate_is_as_large_as_it_shows() -> None:
    noise = fit_sinusoid(np.random.default_rng(0).normal(size=1000), 1e-3)
    assert noise is None or noise.fraction < 0.1
    decay = fit_sinusoid(np.exp(-5.0 * np.arange(1000) * 1e-3), 1e-3)
    assert decay is None or decay.zeta > 0.1 or decay.fraction < 0.5
    k = np.arange(76)
    fast = fit_sinusoid(0.003 * (-1.0) ** k * np.exp(-0.004 * k), 0.04)
    assert fast is not None
    assert fast.amplitude == pytest.approx(0.003 * np.exp(-0.004 * 37.5), rel=0.02)


@pytest.mark.parametrize(("kd", "ki", "term"), [(0.05, 0.0, "D"), (2.0, 220.0, "I"), (10.0, 1050.0, "I")])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_an_oscillation_has_the_frequency_and_damping_of_its_poles(kd: float, ki: float, term: str) -> None:
    """M s^3 + kd s^2 + kp s + ki = 0 with M = 0.5 kg m^2."""
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_friction(taut.Friction())
    ctrl = taut.compile(L.PID(kp=50.0, kd=kd, ki=ki), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.05]), duration=3.0)
    found = taut.doctor(run, arm=arm).findings[0]
    assert (found.name, found.term) == ("oscillation", term)
    s = max(np.roots([0.5, kd, 50.0, ki]), key=lambda root: root.imag)
    assert found.evidence["frequency"].value == pytest.approx(s.imag / (2.0 * np.pi), rel=5e-3)
    assert found.evidence["damping ratio"].value == pytest.approx(-s.real / abs(s), abs=5e-3)
    assert ("raise the damping" in found.remedy) == (term == "D")


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_late_torque_has_the_delay_of_the_drives() -> None:
    arm = runs.arm_of("ur10")
    ctrl = taut.compile(L.ComputedTorque(kp=500.0, kd=110.0), arm, limits=taut.Limits.of(arm))
    plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(delay=0.016))
    run = taut.run(ctrl, plant, taut.JointMotion(q=arm.home), duration=1.5, q0=arm.home + 1e-3)
    found = taut.doctor(run).findings[0]
    assert (found.name, found.term) == ("oscillation", "delay")
    assert found.evidence["delay"].value == pytest.approx(16.0, rel=0.05)


WHOLE = bool(os.environ.get("TAUT_BARS"))  # `make bars`


@pytest.mark.bars
@pytest.mark.parametrize("name", ["kinova", "panda", "fr3", "ur3", "ur10", "z1", "xarm7"] if WHOLE else ["kinova"])
def test_the_torque_that_does_not_move_a_joint_is_within_its_dry_friction(name: str) -> None:
    """Nothing but friction is planted: no load is found, and the fitted friction is the planted one."""
    arm, fitted = taut.load_arm(name), 0
    M = np.diag(np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).M))
    ctrl = taut.compile(L.GravityPID(kp=100.0 * M, kd=20.0 * M), arm)
    for coulomb in (1.0, 3.0):
        plant = taut.RigidPlant(arm.with_friction(taut.Friction(coulomb=coulomb, viscous=0.0)))
        path = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.3, duration=1.0)
        for ref in (path, taut.JointMotion(q=arm.home + 0.3)):
            run = taut.run(ctrl, plant, ref, duration=3.0, progress=False)
            found = [each for each in taut.doctor(run).findings if each.name != "torque jump at the start"]
            assert [each.name for each in found] == ["stiction"]
            numbers = {key: number.value for key, number in found[0].evidence.items()}
            assert numbers["torque without motion"] <= 1.001 * coulomb
            fitted += "fitted dry friction" in numbers
            assert numbers.get("fitted dry friction", coulomb) == pytest.approx(coulomb, rel=0.01)
    assert fitted


def test_winding_up_is_found_with_the_saturation_that_it_causes() -> None:
    """The first ticks have an error of 1e-9 rad of the other sign: that is no return to the target."""
    arm = runs.arm_of("gantry3")
    need = 5.77 * 0.6 / 0.25 * float(np.asarray(taut.snapshot(arm, arm.home, np.zeros(3)).M)[0, 0])
    law = L.ComputedTorque(kp=100.0, kd=20.0, ki=[150.0, 0.0, 0.0], integral=L.Integral(anti_windup="none"))
    limits = taut.Limits(tau=[0.4 * need, np.inf, np.inf])
    path = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + np.array([0.6, 0.0, 0.0]), duration=0.5)
    start = arm.home + np.array([1e-9, 0.0, 0.0])
    run = taut.run(taut.compile(law, arm, limits=limits), taut.RigidPlant(arm), path, duration=3.0, q0=start)
    found = taut.doctor(run).findings
    assert [(each.name, each.follows) for each in found] == [("wind-up", ()), ("saturation", ("wind-up",))]


def test_torques_beyond_the_limits_of_an_arm_are_found() -> None:
    arm = taut.load_arm("panda")
    T = taut.snapshot(arm, arm.home).T()
    law = L.Impedance(K=(50_000.0, 300.0), zeta=0.7)
    plant = taut.RigidPlant(arm)
    goal = taut.TaskMotion(pose=taut.Pose(T.p + np.array([0.1, 0.0, 0.0]), R=T.R))
    run = taut.run(taut.compile(law, arm), plant, goal, duration=1.0)
    jump, beyond = taut.doctor(run).findings
    assert (jump.name, beyond.name) == ("torque jump at the start", "effort limit exceeded")
    assert beyond.follows == ("torque jump at the start",)
    i = arm.joint_names.index(str(beyond.joint))
    assert beyond.evidence["largest torque"].value == np.abs(run.tau[:, i]).max() > 50.0 * arm.effort[i]
    limited = taut.run(taut.compile(law, arm, limits=taut.Limits.of(arm)), plant, goal, duration=1.0)
    assert "effort limit exceeded" not in [each.name for each in taut.doctor(limited).findings]


def pressed(plant: Callable[[taut.Arm, taut.Pose], Any], stroke: list[float], duration: float) -> taut.Run:
    """A Panda that presses with 8 N along a stroke on a surface that its law states to be level."""
    arm = runs.arm_of("panda")
    T = taut.snapshot(arm, arm.home).T()
    law = L.HybridMotionForce(
        constraint=taut.Constraint.plane(point=T.p, normal=[0.0, 0.0, 1.0]),
        motion=L.TaskComputedTorque(kp=225.0, kd=30.0),
        kfp=0.3,
        kfi=10.0,
    )
    line = taut.trajectories.Line(T0=T, T1=taut.Pose(T.p + np.array(stroke), R=T.R), duration=0.8)
    return taut.run(
        taut.compile(law, arm), plant(arm, T), taut.pressing(line, 8.0), duration=duration, progress=False
    )


@pytest.mark.long
def test_a_board_that_leans_is_found_with_its_angle() -> None:
    def plant(arm: taut.Arm, T: taut.Pose) -> Any:
        board = taut.Constraint.plane(point=T.p, normal=[np.sin(0.12), 0.0, np.cos(0.12)])
        return taut.RigidPlant(arm, contact=taut.RigidContact(constraint=board))

    (found,) = taut.doctor(pressed(plant, [0.06, 0.0, 0.0], 1.1)).findings
    assert (found.name, found.term) == ("wrong surface", "constraint")
    assert found.evidence["tilt along the path"].value == pytest.approx(np.degrees(0.12), rel=0.02)


@pytest.mark.long
def test_a_contact_that_bounces_is_found_and_its_remedy_ends_it() -> None:
    def wiped(contact: str) -> taut.Run:
        def plant(arm: taut.Arm, T: taut.Pose) -> Any:
            x, y, z = T.p
            box = f'<geom type="box" size="0.4 0.4 0.01" pos="{x} {y} {z - 0.0201}" friction="0.4" {contact}/>'
            return taut.MujocoPlant(arm, scene=f"<mujoco><worldbody>{box}</worldbody></mujoco>")

        return pressed(plant, [0.1, 0.05, 0.0], 1.0)

    found = taut.doctor(wiped("")).findings[0]
    assert (found.name, found.term) == ("contact bounce", "contact")
    contact = re.search(r'priority="\d" solimp="[^"]*"', found.remedy)
    assert contact is not None
    assert taut.doctor(wiped(contact[0])).healthy


# -------------------------------------------------------------------- what is examined, and what is not


def test_the_parameters_of_the_plant_are_not_read() -> None:
    """A record of a real arm has none."""
    run = heavy()
    law_side = {k: v for k, v in run.info.parameters.items() if k.partition(".")[0] not in ("plant", "sensors")}
    blind = dataclasses.replace(run, info=dataclasses.replace(run.info, parameters=law_side), arm=None)
    assert taut.doctor(blind).json() == taut.doctor(run).json()


def test_a_run_and_its_log_get_one_answer_for_an_arm_with_other_links(tmp_path: Path) -> None:
    """A heavier link that the controller knows is no payload, though the catalogue's arm does not have it."""
    arm = taut.load_arm("planar3").with_friction(taut.Friction()).with_body("joint3", mass=3.0)
    ctrl = taut.compile(L.ComputedTorque(kp=100.0, kd=20.0), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=arm.home + 0.05), duration=1.5)
    read = taut.load_run(run.save(tmp_path / "run.mcap"))
    diagnosis = taut.doctor(read)
    assert diagnosis.json() == taut.doctor(run).json()
    assert diagnosis.healthy
    unknown = dataclasses.replace(read, info=dataclasses.replace(read.info, controller_arm=None))
    assert any("wrong payload" in note for note in taut.doctor(unknown).notes)  # an arm is not guessed by its name


def test_laws_side_by_side_are_judged_by_the_error_of_each() -> None:
    arm = taut.load_arm("gantry3").with_friction(taut.Friction())
    first, *rest = arm.joint_names
    law = taut.SideBySide(
        one=(L.GravityPID(kp=400.0, kd=2.0), [first]), others=(L.GravityPID(kp=400.0, kd=80.0), rest)
    )
    ref = taut.together(one=taut.JointMotion(q=arm.home[:1] + 0.05), others=taut.JointMotion(q=arm.home[1:]))
    found = taut.doctor(taut.run(taut.compile(law, arm), taut.RigidPlant(arm), ref, duration=6.0)).findings[0]
    assert (found.name, found.term, found.joint) == ("oscillation", "D", first)


def test_a_task_is_examined_phase_by_phase(tmp_path: Path) -> None:
    """A spring with next to no damping in the second of two phases: found there, from a log too."""
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_friction(taut.Friction())
    kds, goals, times = {"near": 14.0, "far": 0.2}, {"near": 0.1, "far": 0.4}, {"near": 1.0, "far": 2.0}
    task = [
        taut.Phase(
            L.PID(kp=100.0, kd=kd),
            taut.JointMotion(q=[goals[name]]),
            until=lambda x, name=name: x.elapsed > times[name],
            name=name,
        )
        for name, kd in kds.items()
    ]
    run = taut.run(taut.compile(task, arm), taut.RigidPlant(arm), duration=3.1, progress=False)
    diagnosis = taut.doctor(run)
    assert [(f.name, f.term, f.part) for f in diagnosis.findings] == [("oscillation", "D", "phase 'far'")]
    assert "phase 'stop': 0.097 s are too short" in diagnosis.notes
    assert taut.doctor(run.phase("near")).healthy
    assert taut.doctor(taut.load_run(run.save(tmp_path / "task.mcap"))).json() == diagnosis.json()


def test_a_payload_that_is_declared_when_it_is_taken_is_no_fault() -> None:
    arm = runs.arm_of("gantry3")
    m = runs.inertia("gantry3")
    ctrl = taut.compile(L.GravityPID(kp=144.0 * m, kd=24.0 * m), arm)
    path = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + np.array([0.3, -0.2, 0.1]), duration=1.5)
    events = [taut.Event(t=0.8, set={f"{side}.payload.mass": 1.5 for side in ("plant", "model")})]
    assert taut.doctor(taut.run(ctrl, taut.RigidPlant(arm), path, duration=3.0, events=events)).healthy


def test_a_run_that_is_not_whole_is_examined_as_far_as_it_goes() -> None:
    run = heavy()
    broken = dataclasses.replace(run, outcome=Outcome(kind="diverged", message="it diverged", tick=500))
    assert taut.doctor(broken).problems == ("the run ended in a fault: it diverged",)
    assert "101 ticks, 0.101 s, are too short" in taut.doctor(run.between(0.0, 0.1)).problems[0]
    for count in (1, 2, 6, 15):
        few = taut.doctor(run.between(-1.0, (count - 1) * 1e-3))
        assert (few.findings, few.healthy) == ((), False)
        assert json.dumps(few.json(), allow_nan=False)
    kept = np.r_[0:100, 103:501]
    holes = dataclasses.replace(
        run,
        **{name: getattr(run, name)[kept] for name in ("t", "q", "v", "tau", "command")},
        terms={name: value[kept] for name, value in run.terms.items()},
        reference=type(run.reference).of({f: getattr(run.reference, f)[kept] for f in ("q", "v", "a")}),
        extra={name: value[kept] for name, value in run.extra.items()},
    )
    diagnosis = taut.doctor(holes)
    assert diagnosis.problems == ("gaps: 3 ticks are missing", "examined from 0.103 to 0.5 s")
    assert diagnosis.findings[0].name == "wrong payload"
    terms = {name: np.where(np.arange(501)[:, np.newaxis] < 400, x, np.nan) for name, x in run.terms.items()}
    unplugged = taut.doctor(dataclasses.replace(run, terms=terms))
    assert unplugged.problems[0].startswith("101 ticks have values that are no numbers")
    assert unplugged.findings[0].name == "wrong payload"


def test_what_is_not_a_run_is_refused() -> None:
    with refused(taut.errors.UsageError):
        taut.doctor("run.mcap")  # type: ignore[arg-type]
    with refused(taut.errors.MatchError):
        taut.doctor(heavy(), arm=taut.load_arm("ur10"))
    with refused(taut.errors.UsageError):
        taut.doctor(heavy(), checks=[too_fast])  # type: ignore[list-item]


@pytest.mark.parametrize(
    "test", [lambda run: 5, lambda run: run.run.nope, lambda run: {}["limit"]], ids=["number", "attribute", "key"]
)
def test_a_check_that_gives_no_finding_is_refused_by_its_name(test: Any) -> None:
    with refused(taut.errors.UsageError):
        taut.doctor(heavy(), checks=[Check(name="mine", test=test, cause="x", remedy="y")])


def test_a_diagnosis_is_text_data_and_figures() -> None:
    diagnosis = taut.doctor(heavy())
    diagnosis.plot().savefig(BytesIO(), format="png")
    (finding,) = diagnosis.findings
    assert str(finding) in str(diagnosis)
    tables = json.loads(json.dumps(diagnosis.json(), allow_nan=False))["tables"]
    assert [row["finding"] for row in tables["findings"]] == ["wrong payload"]
    values = {row["quantity"]: (row["value"], row["unit"]) for row in tables["evidence"]}
    assert values["beyond the declared"] == (finding.evidence["beyond the declared"].value, "kg")


def test_the_command_reads_a_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = heavy().save(tmp_path / "run.mcap")
    assert main(["doctor", str(log), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["tables"]["findings"][0]["finding"] == "wrong payload"
    assert not found["healthy"]
    short = heavy().between(0.0, 0.1).save(tmp_path / "short.mcap")
    assert main(["doctor", str(short)]) == 2
    assert "is no whole run: 101 ticks" in capsys.readouterr().err
    assert main(["doctor", str(heavy().to_csv(tmp_path / "run.csv"))]) == 2
    assert "it is no MCAP file" in capsys.readouterr().err
    assert main(["doctor", str(tmp_path / "none.mcap")]) == 2
    assert "does not exist" in capsys.readouterr().err
