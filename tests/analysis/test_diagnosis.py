"""The doctor: planted faults are found first with their term, healthy runs are left alone, numbers are right."""

from __future__ import annotations

import dataclasses
import functools
import json
import re
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import diagnosis_runs as runs
import numpy as np
import pytest

import taut
from taut.analysis.diagnosis.case import Case
from taut.analysis.diagnosis.finding import FAULTS, Number
from taut.analysis.diagnosis.line import line_of
from taut.analysis.diagnosis.model import model_of_run
from taut.cli.main import main
from taut.record.outcome import Outcome
from taut.scenarios.scenario import built_in_scenarios, load_scenario

Bar = Callable[[str, object], None]
HELD_BACK = ("kinova", "z1")  # no threshold was chosen by them
MODEL_PLANT_ONLY = ("late", "leaning_board")  # stepped by hand; a contact of its own
BESIDE = {"play": {"jumps at start"}, "underdamped": {"jumps at start"}}  # whose arms start off their targets
CASES = [(fault, arm, "rigid") for fault in runs.FAULTS for arm in runs.ARMS]
CASES += [(fault, "panda", "mujoco") for fault in runs.FAULTS if fault not in MODEL_PLANT_ONLY]
SOUND = [(law, arm, "rigid") for law in runs.HEALTHY for arm in runs.ARMS]
SOUND += [(law, "panda", "mujoco") for law in runs.HEALTHY if law not in ("healthy_force", "healthy_hybrid")]


def planted(fault: str, arm: str, kind: str, seed: int = 7) -> runs.Planted:
    rng = np.random.default_rng([list(runs.FAULTS).index(fault), runs.ARMS.index(arm), seed])
    return runs.FAULTS[fault](arm, rng, kind)


def healthy(law: str, arm: str, kind: str, seed: int = 3) -> taut.Run:
    rng = np.random.default_rng([list(runs.HEALTHY).index(law), runs.ARMS.index(arm), seed])
    return runs.HEALTHY[law](arm, rng, kind)


@functools.cache
def heavy() -> taut.Run:
    """A Panda that carries 1.5 kg of which its controller does not know."""
    arm = taut.load_arm("panda")
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    return taut.run(ctrl, taut.RigidPlant(arm.with_payload(1.5)), duration=0.5)


def some(cases: list[tuple[str, str, str]], count: int) -> list[tuple[str, str, str]]:
    """A seeded choice; all if as many are asked for."""
    picked = np.random.default_rng(0).permutation(len(cases))[:count]
    return [cases[i] for i in sorted(picked)]


def few(count: int, share: Callable[[int], int]) -> int:
    """All in `make bars`, else a thirtieth: each has a loop of its own to compile."""
    return count if share(count) == count else share(count) // 3


# -------------------------------------------------------------------- bars


@pytest.mark.bars
def test_a_planted_fault_is_found_first_with_the_term_responsible(share: Callable[[int], int], bar: Bar) -> None:
    wrong: dict[bool, list[str]] = {True: [], False: []}
    chosen = some(CASES, few(len(CASES), share))
    for fault, arm, kind in chosen:
        case = planted(fault, arm, kind)
        found = taut.doctor(case.run).findings
        first = (found[0].name, found[0].term) if found else ("nothing", "")
        if first != (case.fault, case.term):
            wrong[arm in HELD_BACK].append(f"{fault} on {arm} ({kind}): {first[0]} {first[1]}")
        for later in found[1:]:
            if later.follows is None and later.name not in BESIDE.get(fault, ()):
                wrong[arm in HELD_BACK].append(f"{fault} on {arm} ({kind}): {later.name} beside it")
    held = sum(arm in HELD_BACK for _, arm, _ in chosen)
    for back, count in ((False, len(chosen) - held), (True, held)):
        arms = "kinova and z1, held back" if back else "four arms"
        bar(
            f"the doctor: faults found first, nothing false beside them, {arms}",
            f"{count - len(wrong[back])} of {count}",
        )
    assert wrong == {True: [], False: []}


@pytest.mark.bars
def test_healthy_runs_raise_no_alarm(share: Callable[[int], int], bar: Bar) -> None:
    chosen = some(SOUND, few(len(SOUND), share))
    alarms = []
    for law, arm, kind in chosen:
        diagnosis = taut.doctor(healthy(law, arm, kind))
        if not diagnosis.healthy:
            alarms.append(f"{law} on {arm} ({kind}): {diagnosis}")
    bar("the doctor: false alarms in healthy runs", f"{len(alarms)} of {len(chosen)}")
    assert not alarms


SCENARIOS = {  # of all others nothing is said
    ("backlash_cycle", "backlash", "high gain"): ("backlash", "transmission"),
    ("backlash_cycle", "no backlash", "low gain"): ("sags", "P"),  # its friction is behind a spring
    ("cabinet_door", "", "hybrid"): ("wrong surface", "constraint"),
    ("feedforward_error", "", "feedback"): ("gravity not compensated", "P"),  # PID alone lags under the weight
    ("friction_overcompensated", "30 % too much", "at meas"): ("stick-slip", "friction"),
    ("gain_bounds", "resolution", "modest gains"): ("chatters", "D"),  # 980 N m/s of 10 N m
    ("gain_bounds", "resolution", "large gains"): ("chatters", "D"),
    ("gain_bounds", "saturation", "large gains"): ("saturates", "torque"),
    ("gain_bounds", "delay", "large gains"): ("oscillates", "delay"),
    ("gain_bounds", "servo rate", "large gains"): ("oscillates", "D"),
    ("gain_bounds", "backlash", "large gains"): ("backlash", "transmission"),
    ("gain_bounds", "elasticity", "large gains"): ("oscillates", "transmission"),
    ("one_joint_pid", "", "PD"): ("gravity not compensated", "P"),
    ("panda_payload", "", "PID"): ("gravity not compensated", "P"),
    ("panda_payload", "", "PD + gravity"): ("wrong payload", "gravity"),
    ("panda_payload", "", "feedforward + PD"): ("wrong payload", "nonlinear"),
    ("panda_geared", "direct, 2 kg", "feedforward + PID"): ("wrong payload", "nonlinear"),
    ("panda_payload", "", "computed torque"): ("wrong payload", "nonlinear"),
    ("so101_servo", "", "PD"): ("gravity not compensated", "P"),
    ("so101_servo", "", "PD + f meas"): ("gravity not compensated", "P"),
    ("so101_servo", "", "PD + f ref"): ("gravity not compensated", "P"),
    ("wrist_alignment", "", "plain"): ("loses rank", "feedforward"),
    ("wrist_alignment", "", "robust"): ("loses rank", "singularity"),
    ("wrong_board", "nothing is done", "hybrid"): ("wrong surface", "constraint"),
    ("wrong_board", "low gains", "hybrid"): ("wrong surface", "constraint"),
    ("wrong_board", "compliant tool", "hybrid"): ("wrong surface", "constraint"),
}
QUICK = ("gain_bounds", "ur10_velocity")
FEW = 2  # runs of a spread, which are much alike


def said_of(scenario: str) -> dict[tuple[str, str, str], tuple[str, str] | None]:
    """What the doctor says first of each run of a built-in scenario."""
    out: dict[tuple[str, str, str], tuple[str, str] | None] = {}
    for trial, one in load_scenario(scenario).trials.items():
        if one.spread is not None and len(out) == FEW:
            break
        ctrl = taut.compile(
            one.laws[trial.law],
            one.arm,
            rate=one.rate,
            sensing=one.sensing,
            limits=one.limits,
            adds=one.plant.adds,
        )
        run = taut.run(
            ctrl,
            one.plant,
            None if ctrl.side.task is not None else one.reference,
            duration=one.duration,
            q0=one.q0,
            v0=one.v0,
            seed=one.seed,
            events=one.events,
            progress=False,
        )
        told = taut.doctor(run)
        assert not told.problems, trial
        found = told.findings
        out[scenario, trial.case, trial.law] = (found[0].name, found[0].term) if found else None
    return out


@pytest.mark.parametrize("scenario", QUICK)
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_scenarios_are_judged_as_what_they_show(scenario: str) -> None:
    found = said_of(scenario)
    assert found == {key: SCENARIOS.get(key) for key in found}


@pytest.mark.bars
def test_every_scenario_is_judged_as_what_it_shows(share: Callable[[int], int], bar: Bar) -> None:
    slow = [name for name in built_in_scenarios() if name not in QUICK]
    chosen = np.random.default_rng(1).permutation(slow)[: few(len(slow), share) or 1]
    found = {key: said for name in chosen for key, said in said_of(name).items()}
    bar("the doctor: runs of scenarios judged as what they show", f"{len(found)} of {len(found)}")
    assert found == {key: SCENARIOS.get(key) for key in found}


# -------------------------------------------------------------------- what a law was asked for


def board(lean: float, point: np.ndarray) -> taut.Constraint:
    """A board that leans by an angle about y."""
    return taut.Constraint.plane(point=point, normal=[np.sin(lean), 0.0, np.cos(lean)])


def pressed_on(true: float) -> taut.Run:
    """A Panda that strokes 6 cm along x, on a board that leans and of which its law says that it does not."""
    arm = runs.arm_of("panda")
    T = taut.snapshot(arm, arm.home).T()
    law = taut.laws.HybridMotionForce(
        constraint=board(0.0, T.p), motion=taut.laws.TaskComputedTorque(kp=225.0, kd=30.0), kfp=0.3, kfi=10.0
    )
    stroke = taut.trajectories.Line(T0=T, T1=taut.Pose(T.p + np.array([0.06, 0.0, 0.0]), R=T.R), duration=1.0)
    plant = taut.RigidPlant(arm, contact=taut.RigidContact(constraint=board(true, T.p)))
    return taut.run(taut.compile(law, arm), plant, taut.pressing(stroke, 8.0), duration=1.3)


def test_a_board_that_leans_is_found_with_its_angle() -> None:
    found = taut.doctor(pressed_on(0.12)).findings
    assert [(f.name, f.term) for f in found] == [("wrong surface", "constraint")]
    tilt = found[0].evidence["tilt along the stroke"]
    assert tilt.value == pytest.approx(np.degrees(0.12), rel=0.02)


def test_the_error_of_a_hybrid_law_is_that_along_its_constraint() -> None:
    """A step along a board of 5 mm, and of 5 mm into it: only the first is an error, by J^+ of what it is."""
    arm = runs.arm_of("panda")
    T = taut.snapshot(arm, arm.home).T()
    law = taut.laws.HybridMotionForce(
        constraint=board(0.0, T.p), motion=taut.laws.TaskComputedTorque(kp=100.0, kd=20.0), tolerance=0.02
    )
    plant = taut.RigidPlant(arm, contact=taut.RigidContact(constraint=board(0.0, T.p)))
    goal = taut.TaskMotion(pose=taut.Pose(T.p + np.array([0.005, 0.0, -0.005]), R=T.R))
    run = taut.run(taut.compile(law, arm), plant, taut.pressing(goal, 5.0), duration=0.1)
    error = Case(run=run, model=model_of_run(run, arm)[0]).error
    assert error is not None
    asked = run.task.J[0] @ error[0]
    assert asked[:3] == pytest.approx([0.005, 0.0, 0.0], abs=1e-6)


def test_an_arm_with_other_links_is_known_from_its_log(tmp_path: Path) -> None:
    """A heavier link that the controller knows of is no payload, though the catalogue's arm has none."""
    arm = taut.load_arm("planar3").with_friction(taut.Friction()).with_body("joint3", mass=3.0)
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=arm.home + 0.05), duration=1.5)
    read = taut.load_run(run.save(tmp_path / "run.mcap"))
    told = taut.doctor(read)
    assert told.findings == ()
    assert "with the masses, gravity and gears that the log has" in told.model
    assert told.looked_at["torque beyond the model"].value < 0.1
    old = dataclasses.replace(read, info={key: v for key, v in read.info.items() if key != "dynamics"})
    assert "torque beyond the model" not in taut.doctor(old).looked_at  # which arm it was is not guessed by its name


def test_laws_side_by_side_are_judged_by_the_error_of_each(tmp_path: Path) -> None:
    """One of two has next to no damping; a log of them is read back."""
    arm = taut.load_arm("gantry3").with_friction(taut.Friction())
    first, *rest = arm.joint_names
    law = taut.SideBySide(
        one=(taut.laws.GravityPID(kp=400.0, kd=2.0), [first]),
        others=(taut.laws.GravityPID(kp=400.0, kd=80.0), rest),
    )
    ref = taut.together(one=taut.JointMotion(q=arm.home[:1] + 0.05), others=taut.JointMotion(q=arm.home[1:]))
    run = taut.run(taut.compile(law, arm), taut.RigidPlant(arm), ref, duration=2.5)
    read = taut.load_run(run.save(tmp_path / "run.mcap"))
    found = taut.doctor(read).findings
    assert (found[0].name, found[0].term, found[0].joint) == ("oscillates", "D", first)
    assert np.array_equal(read.part("one").error, run.part("one").error)


# -------------------------------------------------------------------- numbers against what was planted


def test_the_mass_of_a_payload_is_that_which_hangs_there() -> None:
    found = taut.doctor(heavy()).findings[0]
    assert found.evidence["beyond it"].value == pytest.approx(1.5, rel=1e-3)  # its friction, 0.003 N m s/rad, is left
    assert found.share > 0.9
    assert "arm.with_payload(1.5)" in found.remedy


@functools.cache
def computed_torque(name: str) -> taut.Controller:
    """Of an arm that carries nothing, for runs with loads that nobody declared."""
    return taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), runs.arm_of(name))


def carried(name: str, mass: float, com: list[float], duration: float = 1.0, way: float = 0.0) -> taut.Run:
    """An arm that holds still, or goes by an angle, with a payload that nobody declared."""
    arm = runs.arm_of(name)
    there = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + way, duration=1.0)
    return taut.run(computed_torque(name), taut.RigidPlant(arm.with_payload(mass, com=com)), there, duration=duration)


LOADS = [
    ("panda", 2.0, [0.02, 0.0, 0.06], 3.0, 0.0),
    ("panda", 1.0, [0.05, 0.0, 0.1], 3.0, 0.0),
    ("panda", 2.0, [0.05, 0.0, 0.1], 1.0, 0.0),
    ("panda", 2.0, [0.02, 0.0, 0.06], 2.0, 0.3),
    ("ur10", 4.0, [0.03, -0.04, 0.08], 1.0, 0.0),
    ("xarm7", 1.0, [0.0, 0.03, 0.07], 1.5, 0.3),
]


@pytest.mark.parametrize(("name", "mass", "com", "duration", "way"), LOADS)
def test_a_load_is_found_alone_with_its_mass_and_centre(
    name: str, mass: float, com: list[float], duration: float, way: float
) -> None:
    """It drives a light wrist, whose residual is then larger than its torque: that says nothing of its sign."""
    found = taut.doctor(carried(name, mass, com, duration, way)).findings
    assert [finding.name for finding in found] == ["wrong payload"]
    numbers = {key: number.value for key, number in found[0].evidence.items()}
    assert numbers["beyond it"] == pytest.approx(mass, rel=2e-3)
    centre = np.array([numbers[f"centre {axis}"] for axis in "xyz"])
    assert centre == pytest.approx(com, abs=1e-3)
    assert 3e-4 < numbers["standard error of the centre"] < 0.03


def test_a_payload_is_fitted_beyond_the_one_that_was_declared() -> None:
    arm = runs.arm_of("panda")
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm.with_payload(1.0, com=[0.0, 0.0, 0.05]))
    run = taut.run(ctrl, taut.RigidPlant(arm.with_payload(2.0, com=[0.05, 0.0, 0.1])), duration=1.0)
    (found,) = taut.doctor(run).findings
    assert "arm.with_payload(2, com=(0.050, 0.000, 0.100)), com in m" in found.remedy
    assert found.evidence["beyond it"].value == pytest.approx(1.0, abs=2e-3)
    gone = taut.run(ctrl, taut.RigidPlant(arm), duration=1.0)
    (found,) = taut.doctor(gone).findings
    assert "arm.with_payload(0)," in found.remedy  # a negative mass is refused
    assert "centre x" not in found.evidence


def test_where_a_centre_is_along_gravity_is_not_known_from_an_arm_at_rest() -> None:
    """Gravity turns a payload about what is across it alone."""
    run = carried("panda", 2.0, [0.03, 0.0, 0.1], 4.0).between(3.0, 4.0)
    found = taut.doctor(run).findings[0]
    unknown = re.search(r"its centre along \((.*?)\) of the tool frame is not known from this run", found.remedy)
    assert unknown is not None
    arm = runs.arm_of("panda")
    up = taut.snapshot(arm, run.q[-1], np.zeros(7)).T().R.T @ [0.0, 0.0, 1.0]
    assert [float(x) for x in unknown[1].split(",")] == pytest.approx(-np.asarray(up), abs=0.01)
    assert found.evidence["centre x"].value == pytest.approx(0.03, abs=0.01)
    assert found.evidence["standard error of the centre"].value > 0.05


@pytest.mark.parametrize("name", ["one_joint", "panda", "ur10"])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_drive_that_is_turned_round_is_found_by_its_torque(name: str) -> None:
    arm = runs.arm_of(name)
    (found,) = taut.doctor(runs.turned_drive(name)).findings
    assert (found.name, found.term) == ("wrong sign", "command")
    assert found.joint == arm.joint_names[max(arm.n - 2, 0)]
    assert found.evidence["residual over torque"].value == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize("g", [9.81, 0.0])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_loop_that_runs_away_in_a_few_ticks_is_told_its_gain(g: float) -> None:
    """kd T / M is 4.6 at the last joint, where 2 is the border: no payload, and no sign, is to be had from that."""
    arm = taut.load_arm("panda")
    ctrl = taut.compile(taut.laws.GravityPID(kp=300.0, kd=30.0), arm)
    way = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.3, duration=1.0)
    told = taut.doctor(taut.run(ctrl, taut.RigidPlant(arm.with_gravity([0.0, 0.0, -g])), way, duration=0.5))
    assert [(f.name, f.term, f.joint) for f in told.findings] == [("oscillates", "D", "panda_joint7")]
    inertia = 1.0 / np.linalg.inv(np.asarray(taut.snapshot(arm, arm.home, np.zeros(7)).M))[6, 6]
    assert f"the damping of 'panda_joint7' is 30, and a sampled loop bears 2 M / T = {2e3 * inertia:.3g}" in (
        told.findings[0].remedy
    )
    assert any(problem.startswith("it ran away") for problem in told.problems)


def test_the_plants_parameters_are_not_read() -> None:
    """A record of a real arm has none."""
    run = heavy()
    law_side = {k: v for k, v in run.info["parameters"].items() if k.partition(".")[0] not in ("plant", "sensors")}
    blind = dataclasses.replace(run, info={**run.info, "parameters": law_side}, arm=None)
    assert taut.doctor(blind).json() == taut.doctor(run).json()


@pytest.mark.parametrize(("growth", "omega"), [(-0.8, 40.0), (0.0, 25.0), (1.5, 90.0)])
def test_a_line_has_the_frequency_and_growth_that_it_was_made_with(growth: float, omega: float) -> None:
    t = np.arange(1500) * 1e-3
    y = 0.3 + 0.2 * t + np.exp(growth * t) * np.cos(omega * t + 0.4)
    line = line_of(y, 1e-3)
    assert line is not None
    assert line.omega == pytest.approx(omega, rel=1e-6)
    assert line.growth == pytest.approx(growth, abs=1e-5)
    assert line.share == pytest.approx(1.0, abs=1e-9)
    assert line.last == pytest.approx(np.exp(growth * 1.5), rel=1e-2)


def test_a_signal_without_a_line_has_none_that_matters() -> None:
    noise = np.random.default_rng(0).normal(size=1000)
    line = line_of(noise, 1e-3)
    assert line is None or line.share < 0.1
    decay = line_of(np.exp(-5.0 * np.arange(1000) * 1e-3), 1e-3)
    assert decay is None or decay.zeta > 0.1 or decay.share < 0.5


def test_the_damping_that_is_advised_gives_the_damping_ratio_that_is_said() -> None:
    """One joint: the remedy's kd is 2 zeta sqrt(kp M) - so its poles have zeta = 0.7 but for friction."""
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_friction(taut.Friction())
    ctrl = taut.compile(taut.laws.PID(kp=50.0, kd=0.05), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.2]), duration=3.0)
    found = taut.doctor(run, arm=arm).findings[0]
    assert (found.name, found.term) == ("oscillates", "D")
    assert found.evidence["frequency"].value == pytest.approx(np.sqrt(50.0 / 0.5) / (2.0 * np.pi), rel=1e-3)
    assert f"to {2.0 * 0.7 * np.sqrt(50.0 * 0.5):.3g} N m s/rad" in found.remedy


@pytest.mark.parametrize("ki", [990.0, 1050.0, 1150.0, 1300.0])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_the_bound_of_the_integral_does_not_follow_ki(ki: float) -> None:
    """(b + kd) kp / M is 10 x 50 / 0.5 N m/(rad s), whether the swing dies out or grows; no spring is blamed for it."""
    arm = runs.arm_of("one_joint")
    ctrl = taut.compile(taut.laws.GravityPID(kp=50.0, kd=10.0, ki=ki), arm)
    found = taut.doctor(taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.3]), duration=4.0)).findings[0]
    assert (found.name, found.term) == ("oscillates", "I")
    assert float(found.remedy.rpartition("= ")[2]) == pytest.approx(1000.0, rel=2e-3)


@pytest.mark.parametrize("name", ["planar2", "so101"])
def test_a_limit_below_the_weight_is_no_load_and_no_jump(name: str) -> None:
    """The command is cut from the first tick on: what holds the arm is the limit, and the reference starts at it."""
    arm = runs.arm_of(name)
    g = np.abs(np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).g))
    i = int(np.argmax(g))
    most = np.where(np.arange(arm.n) == i, 0.5 * g, np.inf)
    ctrl = taut.compile(runs.with_inertia(runs.inertia(name), 10.0), arm, limits=taut.Limits(tau=most))
    plant = taut.RigidPlant(arm.with_friction(taut.Friction(viscous=4.0 * runs.inertia(name))))
    told = taut.doctor(taut.run(ctrl, plant, taut.JointMotion(q=arm.home), duration=3.0))
    assert told.findings[0].name == "saturates"
    assert {f.name for f in told.findings} <= {"saturates", "oscillates"}


def test_an_integral_is_not_advised_to_a_law_that_has_one() -> None:
    arm = runs.arm_of("one_joint")
    stuck = taut.RigidPlant(arm.with_friction(taut.Friction(coulomb=0.8)))
    way = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.3, duration=1.0)
    for ki, advised in ((0.0, True), (1.0, False)):
        ctrl = taut.compile(taut.laws.GravityPID(kp=12.0, kd=5.0, ki=ki), arm)
        found = taut.doctor(taut.run(ctrl, stuck, way, duration=2.0)).findings[0]
        assert found.name == "sticks"
        assert ("an integral" in found.remedy) == advised


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_damping_that_comes_late_is_lowered_to_less() -> None:
    """The blow-up at the end of the run is no part of what the gain is read from: kd times what the mode moves."""
    arm = taut.load_arm("panda")
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=6400.0, kd=160.0), arm)
    way = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.3, duration=1.0)
    run = taut.run(ctrl, taut.RigidPlant(arm, actuation=taut.drives.Actuation(delay=0.008)), way, duration=2.0)
    assert run.outcome.kind == "diverged"
    found = taut.doctor(run).findings[0]
    assert (found.name, found.term) == ("oscillates", "delay")
    told = re.search(r"give the torque (.*?) ms late.*from (.*?) to (.*?) N m s/rad", found.remedy)
    assert told is not None
    late, now, most = map(float, told.groups())
    assert late == pytest.approx(8.0, rel=0.02)
    assert now / most == pytest.approx(160.0 / (np.pi / (6.0 * 0.0085)), rel=0.1)
    assert found.share > 0.25


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_the_bound_of_the_integral_is_that_of_the_chapter() -> None:
    """0 <= ki < (b + kd) kp / M, with b = 0."""
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_friction(taut.Friction())
    ctrl = taut.compile(taut.laws.PID(kp=50.0, kd=2.0, ki=220.0), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.0]), q0=[0.05], duration=4.0)
    found = taut.doctor(run, arm=arm).findings[0]
    assert (found.name, found.term) == ("oscillates", "I")
    bound = float(found.remedy.rpartition("= ")[2])
    assert bound == pytest.approx(2.0 * 50.0 / 0.5, rel=0.01)


# -------------------------------------------------------------------- the request


def test_a_finding_has_a_picture_and_plain_values() -> None:
    diagnosis = taut.doctor(heavy())
    figure = diagnosis.findings[0].plot()
    figure.savefig(BytesIO(), format="png")
    assert set(json.loads(json.dumps(diagnosis.json(), allow_nan=False))["findings"][0]) >= {
        "term",
        "remedy",
        "share",
    }
    assert all(finding.name in FAULTS for finding in diagnosis.findings)


def test_a_fault_gaps_and_too_few_ticks_are_told_and_what_can_be_said_is() -> None:
    run = heavy()
    broken = dataclasses.replace(run, outcome=Outcome(kind="diverged", message="it diverged", tick=500))
    told = taut.doctor(broken)
    assert (told.problems, told.healthy) == (("it ended in a fault: it diverged",), False)
    short = run.between(0.0, 0.1)
    assert "101 ticks, 0.101 s, are too short" in taut.doctor(short).problems[0]
    arm = taut.load_arm("one_joint")
    for duration, late in ((0.6, True), (3.0, False)):
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=25.0, kd=10.0), arm)
        slow = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.2]), duration=duration)
        told = taut.doctor(slow)
        assert [finding.name for finding in told.findings if finding.name != "jumps at start"] == []
        assert ("0.601 s are too short: joint 'joint1' was on its way" in "".join(told.problems)) == late, told
        assert bool(told.problems) == late
    kept = np.r_[0:100, 103:501]
    holes = dataclasses.replace(
        run,
        **{name: getattr(run, name)[kept] for name in ("t", "q", "v", "tau", "command")},
        terms={name: value[kept] for name, value in run.terms.items()},
        reference=type(run.reference).of({f: getattr(run.reference, f)[kept] for f in ("q", "v", "a")}),
        extra={name: value[kept] for name, value in run.extra.items()},
    )
    diagnosis = taut.doctor(holes)
    assert "3 ticks are missing; judged from 0.103 to 0.5 s" in diagnosis.problems[0]
    assert diagnosis.findings[0].name == "wrong payload"


def test_what_is_no_run_is_refused() -> None:
    with pytest.raises(taut.errors.UsageError, match=r"doctor takes a Run from taut\.run or taut\.load_run; got str"):
        taut.doctor("run.mcap")  # type: ignore[arg-type]
    with pytest.raises(taut.errors.MatchError, match="the run is of joints panda_joint1"):
        taut.doctor(heavy(), arm=taut.load_arm("ur10"))


def test_a_run_of_a_few_ticks_is_answered() -> None:
    for few in (1, 2, 6, 15):
        told = taut.doctor(heavy().between(-1.0, (few - 1) * 1e-3))
        assert (told.findings, told.healthy) == ((), False)
        assert f"{few} ticks are too few" in told.problems[0]
        assert json.dumps(told.json(), allow_nan=False)


def test_a_task_is_looked_at_phase_by_phase(tmp_path: Path) -> None:
    """A spring with next to no damping in the second of two phases: found there, from a log too."""
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_friction(taut.Friction())
    kds, goals = {"near": 14.0, "far": 0.2}, {"near": 0.1, "far": 0.4}
    task = [
        taut.Phase(
            taut.laws.PID(kp=100.0, kd=kd),
            taut.JointMotion(q=[goals[name]]),
            until=lambda x, name=name: x.elapsed > {"near": 1.0, "far": 2.0}[name],
            name=name,
        )
        for name, kd in kds.items()
    ]
    run = taut.run(taut.compile(task, arm), taut.RigidPlant(arm), duration=3.1, progress=False)
    told = taut.doctor(run)
    assert [(f.name, f.term, f.phase) for f in told.findings] == [("oscillates", "D", "phase 'far'")]
    assert "in phase 'far' (term D" in str(told)
    assert "anything in phase 'stop', for 0.097 s are too short" in told.notes
    assert "phase 'near': peak error" in told.looked_at
    assert re.search(r"ticks \d+, ", str(taut.doctor(run.phase("near"))))
    assert [str(Number(x, "s")) for x in (2001.0, 999.7, 1674.6, 12.345, 3.0)] == [
        "2001 s",
        "1000 s",
        "1675 s",
        "12.3 s",
        "3 s",
    ]
    assert taut.doctor(run.phase("near")).healthy
    assert taut.doctor(taut.load_run(run.save(tmp_path / "task.mcap"))).json() == told.json()


def test_the_command_reads_a_log_and_draws_what_it_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = heavy().save(tmp_path / "run.mcap")
    assert main(["doctor", str(log), "--json", "--out", str(tmp_path / "found")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["findings"][0]["name"] == "wrong payload"
    assert [Path(path).name for path in told["pictures"]] == ["1_wrong_payload.png"]
    assert (tmp_path / "found" / "1_wrong_payload.png").stat().st_size > 1000
    short = heavy().between(0.0, 0.1).save(tmp_path / "short.mcap")
    assert main(["doctor", str(short)]) == 2
    out = capsys.readouterr()
    assert "wrong payload" in out.out
    assert "is no whole run: 101 ticks" in out.err
    assert main(["doctor", str(heavy().to_npz(tmp_path / "run.npz"))]) == 2
    assert "is a NumPy archive of a run's arrays, without its settings; give the log" in capsys.readouterr().err
    assert main(["doctor", str(tmp_path / "none.mcap")]) == 2
    assert "does not exist" in capsys.readouterr().err
