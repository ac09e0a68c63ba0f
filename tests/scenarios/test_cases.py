"""Scenarios of real joints, and their cases: what is written reaches arms and plants, and each case runs by itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.cli.main import main
from taut.scenarios.scenario import load_scenario

GOOD = """
title = "a test"
[arm]
model = "planar2"
[laws.PD]
law = "GravityPID"
kp = 50
kd = [8, 4]
[control]
rate = 500
[plant]
kind = "rigid"
[reference]
kind = "sine"
center = "home"
amplitude = [0.2, 0.2]
frequency = 1.0
[run]
duration = 1.0
"""

FRICTION = """
[plant.friction]
coulomb = [0.3, 0.0]
static = [0.5, 0.0]
viscous = [0.1, 0.2]
"""

DRIVES = """
[plant.actuation]
bandwidth = 2000
resolution = 0.01
motor = { torque_constant = 0.05, resistance = 1.0, voltage = 48 }
ripple = { amplitude = 0.02, periods = 7 }
transmission = { efficiency = 0.8, stiffness = [1e3, 2e3], damping = 1.0, backlash = 1e-3 }
torque_loop = { kp = 2 }
"""

CASES = """
[cases."direct drive"]
[cases."G = 100".plant.gears]
ratio = 100
motor_inertia = 1e-5
"""


def write(tmp_path: Path, text: str) -> str:
    file = tmp_path / "case.toml"
    file.write_text(text)
    return str(file)


def run_json(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str], status: int = 0) -> Any:
    assert main(["run", write(tmp_path, text), "--out", str(tmp_path / "out"), "--json"]) == status
    return json.loads(capsys.readouterr().out)


# -------------------------------------------------------------------- joints


def test_friction_of_the_plant_takes_the_place_of_that_of_the_arm(tmp_path: Path) -> None:
    scenario = load_scenario(write(tmp_path, GOOD + FRICTION))
    true = scenario.experiment.plant.arm.friction
    assert np.asarray(true.coulomb).tolist() == [0.3, 0.0]
    assert np.asarray(true.static).tolist() == [0.5, 0.0]
    assert np.asarray(true.viscous).tolist() == [0.1, 0.2]
    assert np.asarray(true.stribeck_shape).tolist() == [2.0, 2.0]


def test_the_controllers_arm_keeps_the_friction_that_it_believes(tmp_path: Path) -> None:
    text = GOOD.replace('model = "planar2"', 'model = "planar2"\nfriction = { coulomb = 0.7 }') + FRICTION
    scenario = load_scenario(write(tmp_path, text))
    assert np.asarray(scenario.experiment.arm.friction.coulomb).tolist() == [0.7, 0.7]
    assert np.asarray(scenario.experiment.plant.arm.friction.coulomb).tolist() == [0.3, 0.0]


def test_an_arm_may_be_believed_without_friction(tmp_path: Path) -> None:
    text = GOOD.replace('model = "planar2"', 'model = "one_joint"\nfriction = "none"').replace("[8, 4]", "8")
    scenario = load_scenario(write(tmp_path, text.replace("amplitude = [0.2, 0.2]", "amplitude = [0.2]")))
    assert float(np.asarray(taut.load_arm("one_joint").friction.viscous)[0]) > 0.0
    assert not np.any(scenario.experiment.arm.friction.viscous)


def test_gears_and_rotors_reach_both_arms(tmp_path: Path) -> None:
    text = GOOD.replace(
        'model = "planar2"',
        'model = "planar2"\ngears = { ratio = { joint1 = 100.0 }, motor_inertia = 1e-5 }',
    ).replace('kind = "rigid"', 'kind = "rigid"\njoint_values = { gear = 50.0, rotor_inertia = [0.2, 0.1] }')
    scenario = load_scenario(write(tmp_path, text))
    assert scenario.experiment.arm.gear.tolist() == [100.0, 1.0]
    assert scenario.experiment.arm.rotor_inertia == pytest.approx([0.1, 0.0])
    assert scenario.experiment.plant.arm.gear.tolist() == [50.0, 50.0]
    assert scenario.experiment.plant.arm.rotor_inertia.tolist() == [0.2, 0.1]


@pytest.mark.parametrize("kind", ["rigid", "mujoco"])
def test_drives_reach_the_plant_with_all_their_parts(kind: str, tmp_path: Path) -> None:
    text = (
        GOOD.replace('kind = "rigid"', f'kind = "{kind}"\ngears = {{ ratio = 100, motor_inertia = 1e-5 }}') + DRIVES
    )
    plant = load_scenario(write(tmp_path, text)).experiment.plant
    values = plant.parameters
    assert values["actuation.motor.torque_constant"] == 0.05
    assert values["actuation.ripple.periods"] == 7.0
    assert values["actuation.transmission.stiffness"].tolist() == [1e3, 2e3]
    assert values["actuation.transmission.backlash"] == 1e-3
    assert values["actuation.torque_loop.kp"] == 2.0
    assert values["actuation.resolution"] == 0.01


def test_a_motor_without_electrical_numbers_is_a_curve(tmp_path: Path) -> None:
    text = GOOD + "[plant.actuation.motor]\npeak = 3.0\n"
    plant = load_scenario(write(tmp_path, text)).experiment.plant
    assert isinstance(plant, taut.RigidPlant)
    assert isinstance(plant.actuation.motor, taut.drives.Motor)


def test_substeps_and_energy_reach_the_plant(tmp_path: Path) -> None:
    text = GOOD.replace('kind = "rigid"', 'kind = "rigid"\nsubsteps = 2\nenergy = true')
    plant = load_scenario(write(tmp_path, text)).experiment.plant
    assert isinstance(plant, taut.RigidPlant)
    assert (plant.substeps, plant.energy) == (2, True)


def test_the_same_joints_move_alike_in_both_plants(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = GOOD + FRICTION + '[cases.rigid]\n[cases.mujoco.plant]\nkind = "mujoco"\ntimestep = 0.002\n'
    metrics = run_json(tmp_path, text, capsys)["metrics"]
    rigid, mujoco = (metrics[case]["PD"]["rms_error"]["joints"] for case in ("rigid", "mujoco"))
    assert mujoco == pytest.approx(rigid, rel=1e-6)


# -------------------------------------------------------------------- cases


def test_a_case_is_the_scenario_with_some_keys_replaced(tmp_path: Path) -> None:
    text = (
        GOOD
        + FRICTION
        + CASES
        + "[cases.'G = 100'.plant.friction]\nviscous = 0.4\n[cases.slow.control]\nrate = 100\n"
    )
    scenario = load_scenario(write(tmp_path, text))
    assert list(scenario.cases) == ["direct drive", "G = 100", "slow"]
    direct, geared, slow = scenario.cases.values()
    assert direct.experiment.plant.arm.rotor_inertia.tolist() == [0.0, 0.0]
    assert geared.experiment.plant.arm.rotor_inertia.tolist() == pytest.approx([0.1, 0.1])
    assert np.asarray(geared.experiment.plant.arm.friction.viscous).tolist() == [0.4, 0.4]
    assert np.asarray(geared.experiment.plant.arm.friction.coulomb).tolist() == [0.3, 0.0]
    assert (direct.experiment.rate, slow.experiment.rate) == (500.0, 100.0)
    assert not np.any(geared.experiment.arm.rotor_inertia)


def test_a_case_that_changes_nothing_runs_as_the_scenario_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = run_json(tmp_path, GOOD + FRICTION, capsys)
    with_case = run_json(tmp_path, GOOD + FRICTION + "[cases.same]\n", capsys)
    assert set(alone["metrics"]) == {"PD"}
    assert with_case["metrics"] == {"same": alone["metrics"]}
    assert with_case["outcomes"] == {"same": alone["outcomes"]}


def test_every_law_runs_in_every_case_and_all_results_say_which(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = GOOD + '[laws.PID]\nlaw = "PID"\nkp = 50\nkd = [8, 4]\n' + CASES + '[outputs]\nplot = "x.png"\n'
    assert main(["run", write(tmp_path, text), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    for label in ("direct drive: PD", "direct drive: PID", "G = 100: PD", "G = 100: PID"):
        assert label in said
    kept = json.loads((tmp_path / "out" / "case.json").read_text())
    assert {case: list(laws) for case, laws in kept.items()} == {
        "direct drive": ["PD", "PID"],
        "G = 100": ["PD", "PID"],
    }
    assert (tmp_path / "out" / "x.png").stat().st_size > 0


def test_a_pass_figure_is_for_its_case_or_for_all_of_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figure = '[[pass]]\nlaw = "PD"\nmetric = "peak_error"\n'
    metrics = run_json(tmp_path, GOOD + CASES, capsys)["metrics"]
    direct, geared = (metrics[case]["PD"]["peak_error"]["overall"] for case in ("direct drive", "G = 100"))
    assert direct != geared
    low, between = min(direct, geared), 0.5 * (direct + geared)
    worse = "direct drive" if direct > geared else "G = 100"
    better = "G = 100" if direct > geared else "direct drive"
    text = GOOD + CASES + figure + f"max = {between}\n"
    assert [each.partition(" must")[0] for each in run_json(tmp_path, text, capsys, 1)["missed"]] == [
        f"{worse}: PD: peak_error"
    ]
    run_json(tmp_path, text + f'case = "{better}"\n', capsys)
    run_json(tmp_path, GOOD + CASES + figure + f'max = {0.9 * low}\ncase = "{better}"\n', capsys, 1)


def test_a_law_of_the_users_own_runs_in_every_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    law = tmp_path / "rest.py"
    law.write_text(
        "import taut\n\n\nclass Rest(taut.Law):\n"
        "    k: taut.Gain\n\n    def command(self, x, ref):\n        return taut.Torque(P=self.k @ (ref.q - x.q))\n"
    )
    words = ["run", write(tmp_path, GOOD + CASES), "--out", str(tmp_path / "out"), "--json"]
    assert main([*words, "--law", f"{law}:Rest", "--gain", "k=5"]) == 0
    metrics = json.loads(capsys.readouterr().out)["metrics"]
    assert {case: list(laws) for case, laws in metrics.items()} == {
        case: [f"{law}:Rest"] for case in ("direct drive", "G = 100")
    }


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_run_that_diverges_names_its_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = GOOD + "[cases.calm]\n[cases.wild.laws.PD]\nkd = 1e6\n"
    assert main(["run", write(tmp_path, text), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().out
    assert "wild: PD: the simulation diverged at t = " in said
    assert "calm: PD: the" not in said


@pytest.mark.parametrize(("shown", "ratio"), [("", 100.0), ('shown_case = "direct drive"', 1.0)])
def test_the_log_is_of_the_case_that_is_shown(
    shown: str, ratio: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = run_json(tmp_path, GOOD + CASES + f'[outputs]\nlog = "x.mcap"\n{shown}\n', capsys)
    case = "G = 100" if ratio == 100.0 else "direct drive"
    again = taut.load_run(tmp_path / "out" / "x.mcap").metrics.json()
    assert again == result["metrics"][case]["PD"]


# -------------------------------------------------------------------- what is shown


def test_table_and_plot_show_the_metrics_and_the_joint_that_are_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outputs = '[outputs]\nplot = "x.png"\ncolumns = ["stuck_time", "reversal_error"]\njoint = "joint1"\n'
    text = GOOD + FRICTION + CASES + outputs
    assert main(["run", write(tmp_path, text), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "of joint 'joint1'" in said
    assert "RMS error" not in said
    numbers = json.loads((tmp_path / "out" / "case.json").read_text())["direct drive"]["PD"]
    for title, name in (("stuck [s]", "stuck_time"), ("reversal error [rad]", "reversal_error")):
        row = next(line for line in said.splitlines() if line.startswith(title))
        assert f"{numbers[name]['joints']['joint1']:.4g}" in row
    assert (tmp_path / "out" / "x.png").stat().st_size > 0
