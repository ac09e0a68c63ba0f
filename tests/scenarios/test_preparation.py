"""[preparation] of scenarios: what is learned, identified or inverted in a file is what Python finds, and no other case has it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.analysis import PDLearning, learn, stable_inversion
from taut.scenarios.run import run_scenario
from taut.scenarios.scenario import Scenario, load_scenario

ARM = """
title = "a test"
[arm]
model = "xarm7"
friction = "none"
joint_values.rotor_inertia = 0.1
[laws.CT]
law = "ComputedTorque"
kp = 100
kd = 20
[plant]
kind = "rigid"
payload = { mass = 0.7, com = [0.0, 0.02, 0.05] }
friction = { viscous = 0.3, coulomb = 0.2 }
[reference]
kind = "quintic"
relative_to_home = true
q0 = [0, 0, 0, 0, 0, 0, 0]
q1 = [0.3, -0.2, 0.3, 0.4, -0.3, 0.3, 0.4]
duration = 0.6
[run]
duration = 0.8
[cases.plain]
"""
LEARNED = """
[cases.learned.preparation]
kind = "learning"
trials = 4
by = { kind = "pd", Lp = 60.0, Ld = [15, 15, 15, 15, 15, 15, 15], cutoff = 20.0 }
"""
PID = "[laws.PID]\nlaw = 'PID'\nkp = 50\nkd = 10\n[plant]"


def scenario(tmp_path: Path, text: str) -> Scenario:
    file = tmp_path / "case.toml"
    file.write_text(text, encoding="utf-8")
    return load_scenario(str(file))


def run(one: Scenario, tmp_path: Path) -> dict[str, taut.Run]:
    """The run of the only law in each case."""
    runs = run_scenario(one, tmp_path / "out", say=lambda _: None).runs
    return {trial.case: done for trial, done in runs.items()}


def test_a_file_learns_the_reference_that_python_learns(tmp_path: Path) -> None:
    one = scenario(tmp_path, ARM + LEARNED)
    runs, experiment = run(one, tmp_path), one.cases["plain"].experiment
    ctrl = experiment.controller(one.laws["CT"])
    by = PDLearning(Lp=60.0, Ld=15.0, cutoff=20.0)
    found = learn(ctrl, experiment.plant, experiment.reference, by=by, duration=0.8, trials=4)
    again = taut.run(ctrl, experiment.plant, found.reference, duration=0.8)
    np.testing.assert_array_equal(runs["learned"].q, again.q)
    np.testing.assert_array_equal(
        runs["plain"].q, taut.run(ctrl, experiment.plant, experiment.reference, duration=0.8).q
    )
    rms = {case: np.sqrt(np.mean(np.sum(done.error**2, axis=1))) for case, done in runs.items()}
    assert rms["plain"] == pytest.approx(found.rms[0])
    assert rms["learned"] == pytest.approx(found.rms[-1])
    assert rms["learned"] < 0.1 * rms["plain"]


def test_each_law_learns_its_own_reference_and_comparison_has_it(tmp_path: Path) -> None:
    stiff = "[laws.stiff]\nlaw = 'ComputedTorque'\nkp = 400\nkd = 40\n[plant]"
    optimal = (
        "[cases.learned.preparation]\nkind = 'learning'\ntrials = 4\nby = { kind = 'norm-optimal', change = 1e-7 }\n"
    )
    one = scenario(tmp_path, (ARM + optimal).replace("[plant]", stiff, 1))
    learned = one.cases["learned"]
    inputs = [learned.experiment.prepared(law).reference.u for law in learned.laws.values()]  # type: ignore[union-attr]
    assert np.abs(inputs[0] - inputs[1]).max() > 0.03 * np.abs(inputs[0]).max()
    table = {case: taut.compare(on=one, case=case, noise=False, model=None) for case in ("plain", "learned")}
    for law in ("CT", "stiff"):
        plain, less = (table[case].entries[law].number("rms_error") for case in ("plain", "learned"))
        assert less < 0.2 * plain
    assert "learning" in table["learned"].settings["preparation"]
    assert "preparation" not in table["plain"].settings


def test_the_arm_that_is_identified_is_the_plants_and_the_controllers() -> None:
    one = load_scenario("kinova_identifies")
    true = one.experiment.plant.arm
    law = one.cases["identified"].laws["computed torque"]
    ready = one.cases["identified"].experiment.prepared(law)
    assert ready.arm.payload.mass == pytest.approx(true.payload.mass, abs=0.002)
    np.testing.assert_allclose(ready.arm.coulomb, true.coulomb, atol=0.02)
    np.testing.assert_allclose(ready.arm.viscous, true.viscous, atol=0.02)
    assert ready.reference is one.cases["identified"].experiment.reference
    assert ready.controller(law).arm is ready.arm
    assert ready.prepared(law) is ready
    assert one.cases["old model"].experiment.prepared(law) is one.cases["old model"].experiment


def test_a_file_inverts_the_reference_that_python_inverts() -> None:
    one = load_scenario("flexible_link_inversion")
    link = taut.drives.FlexibleLink(length=1.0, EI=5.0, density=0.5, hub_inertia=0.1)
    ctrl = taut.compile(taut.laws.MotorSide(law=taut.laws.ComputedTorque(kp=25.0, kd=8.0)), link.arm)
    move = taut.trajectories.Septic(q0=[0.0], q1=[0.5], duration=0.8)
    wanted = stable_inversion(ctrl, link, move, lead=0.16)
    case = one.cases["inverted, lead 0.16 s"]
    found: Any = case.experiment.prepared(case.laws["computed torque on the hub"]).reference
    assert isinstance(one.experiment.plant, taut.drives.FlexibleLink)
    np.testing.assert_allclose(one.experiment.arm.bodies[0].mass, link.arm.bodies[0].mass)
    np.testing.assert_allclose(found.a, wanted.a, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(found.q, wanted.q)


def test_what_only_shows_before_a_run_is_refused_with_its_section(tmp_path: Path) -> None:
    unfit = {
        "a law that does not use the acceleration": (ARM + LEARNED).replace("[plant]", PID, 1),
        "a motion that does not end": (ARM + "[cases.bent.preparation]\nkind = 'inversion'\nlead = 0.1\n").replace(
            '"quintic"', '"set-point"'
        ).replace("q0 = [0, 0, 0, 0, 0, 0, 0]", "").replace("q1 =", "q =").replace("duration = 0.6", ""),
        "an excitation that is too short": ARM + "[cases.found.preparation]\nkind = 'identification'\nduration = 1.0\nfrequency = 1.0\n",
    }  # fmt: skip
    for text in unfit.values():
        one = scenario(tmp_path, text)
        with refused(taut.errors.ScenarioError):
            run_scenario(one, tmp_path / "out", say=lambda _: None)


def test_a_task_has_no_preparation(tmp_path: Path) -> None:
    phases = "[[phases]]\nname = 'go'\nlaw = { law = 'ComputedTorque', kp = 100, kd = 20 }\n"
    text = "title = 't'\n[arm]\nmodel = 'planar2'\n[plant]\n[run]\nduration = 1.0\n" + phases
    with refused(taut.errors.ScenarioError):
        scenario(tmp_path, text + "[preparation]\nkind = 'inversion'\nlead = 0.1\n")


def test_what_is_prepared_in_all_cases_is_prepared_for_the_plant_of_each(tmp_path: Path) -> None:
    text = ARM.replace("[cases.plain]", "[preparation]" + LEARNED.partition("preparation]")[2])
    runs = run(scenario(tmp_path, text + "[cases.light]\n[cases.heavy.plant]\npayload.mass = 2.0\n"), tmp_path)
    errors = {case: np.abs(done.error).max() for case, done in runs.items()}
    assert max(errors.values()) < 0.03
    accelerations = [done.reference.a for done in runs.values()]
    assert np.abs(accelerations[0] - accelerations[1]).max() > 1.0
    assert list(runs) == ["light", "heavy"]


def test_an_arm_identified_in_one_case_is_not_that_of_the_next(tmp_path: Path) -> None:
    """The same law in cases with other friction: the controller is compiled for the arm of each."""
    text = """
title = "t"
[arm]
model = "planar2"
friction = { viscous = 0.1, coulomb = 0.1 }
[laws.CT]
law = ["ComputedTorque", "FrictionCompensation"]
ComputedTorque = { kp = 400, kd = 40 }
[plant]
kind = "rigid"
[reference]
kind = "sine"
relative_to_home = true
center = [0.2, 0.2]
amplitude = [0.2, 0.2]
frequency = 0.5
phase = -1.5707963267948966
[preparation]
kind = "identification"
what = ["friction"]
duration = 10.0
[run]
duration = 2.0
[cases.light.plant.friction]
coulomb = 0.2
[cases.heavy.plant.friction]
coulomb = 2.0
"""
    one = scenario(tmp_path, text)
    prepared, plain = run(one, tmp_path), one.cases["heavy"].experiment
    assert one.cases["heavy"].laws is one.cases["light"].laws
    guessed = plain.run(plain.controller(one.laws["CT"]))
    peaks = {case: np.abs(done.error).max() for case, done in prepared.items()}
    assert max(peaks.values()) < 0.1 * np.abs(guessed.error).max()
    first = scenario(tmp_path, text.replace("[preparation]", "[cases.found.preparation]"))
    np.testing.assert_array_equal(run(first, tmp_path)["heavy"].q, guessed.q)  # of a case without a preparation
