"""Scenarios: every key that is wrong is refused with file, section, key and way out, before anything is written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import taut
from taut.apps.cli import main
from taut.apps.scenario import built_in_scenarios, load_scenario

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
kind = "set-point"
q = [0.2, 0.3]
[run]
duration = 0.2
[outputs]
plot = "x.png"
[[pass]]
law = "PD"
metric = "peak_error"
max = 3.0
"""


def changed(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new)


BROKEN = {
    "a misspelt section": (changed("[control]", "[contrl]"), " has no key 'contrl'; did you mean 'control'?"),
    "a misspelt key": (changed("rate = 500", "rat = 500"), ": [control] has no key 'rat'; did you mean 'rate'?"),
    "a gain that the law does not have": (
        changed("kd = [8, 4]", "kd = 1\nkpp = 3"),
        ": [laws.PD] has no key 'kpp'; did you mean 'kp'?",
    ),
    "a negative gain": (changed("kp = 50", "kp = -50"), ": [laws.PD] kp must be >= 0 [N m/rad]; got -50.0"),
    "a gain that is no number": (
        changed("kp = 50", "kp = true"),
        ": [laws.PD] kp must be real numbers [N m/rad]; got an array of bool",
    ),
    "a missing gain": (changed("kd = [8, 4]", ""), ": [laws.PD] GravityPID needs kd [N m s/rad]"),
    "a gain of another size": (
        changed("kd = [8, 4]", "kd = [8, 4, 2]"),
        "kd must be a scalar, (2,) or (2, 2) for 2 joints; got shape (3,)",
    ),
    "an unknown law": (
        changed('"GravityPID"', '"GravityPDI"'),
        ": [laws.PD] taut.laws has no law 'GravityPDI'; did you mean 'GravityPID'?",
    ),
    "an unknown arm": (
        changed('"planar2"', '"planer2"'),
        ": [arm] taut has no arm 'planer2'; did you mean 'planar2' or 'planar3'? (taut arms lists them; a file is "
        "named with its suffix, .urdf or .xml)",
    ),
    "a rate of zero": (changed("rate = 500", "rate = 0"), "rate must be > 0 [Hz]; got 0"),
    "a rate that is text": (changed("rate = 500", 'rate = "fast"'), ": [control] rate must be a number; got 'fast'"),
    "a rate that is not finite": (changed("rate = 500", "rate = inf"), ": [control] rate must be finite; got inf"),
    "another kind of plant": (
        changed('"rigid"', '"soft"'),
        ": [plant] kind must be one of 'rigid', 'mujoco'; got 'soft'",
    ),
    "another kind of reference": (
        changed('"set-point"', '"circle"'),
        ": [reference] kind must be one of 'hold', 'set-point', 'cubic', 'jerk-limited', 'quintic', 'samples', "
        "'sine', 'spline', 'trapezoidal'; got 'circle'",
    ),
    "a reference for other joints": (
        changed("q = [0.2, 0.3]", "q = [0.2]"),
        "ref.q must have shape (2,); the reference gives (1,)",
    ),
    "a reference with NaN": (
        changed("q = [0.2, 0.3]", "q = [0.2, nan]"),
        ": [reference] ref.q[1] must be finite [rad | m]; got nan",
    ),
    "a missing duration": (changed("duration = 0.2", ""), ": [run] needs the key 'duration'"),
    "a negative duration": (changed("duration = 0.2", "duration = -1"), "duration must be > 0 [s]; got -1.0"),
    "no laws": (changed('[laws.PD]\nlaw = "GravityPID"\nkp = 50\nkd = [8, 4]', "[laws]"), ": [laws] needs one law"),
    "no plant": (changed('[plant]\nkind = "rigid"', ""), " needs the key 'plant'"),
    "a section that is no table": (changed("[control]\nrate = 500", "control = 500"), ""),
    "a file name that leaves the folder": (
        changed('"x.png"', '"../x.png"'),
        ": [outputs] plot must be a file name ending in .png or .pdf or .svg; got '../x.png'",
    ),
    "another file type": (
        changed('plot = "x.png"', 'video = "x.avi"'),
        ": [outputs] video must be a file name ending in .gif or .mp4; got 'x.avi'",
    ),
    "a law that is not there in a pass figure": (
        changed('[[pass]]\nlaw = "PD"', '[[pass]]\nlaw = "PID"'),
        ": [pass 1] law must be one of 'PD'; got 'PID'",
    ),
    "an unknown metric": (
        changed('"peak_error"', '"peak_eror"'),
        "a run has no metric 'peak_eror'; did you mean 'peak_error'",
    ),
    "a pass figure without a bound": (changed("max = 3.0", ""), ": [pass 1] needs min, max or both"),
    "an event on an unknown parameter": (
        GOOD + '[[event]]\nt = 0.1\nset = { "law.kq" = 1.0 }\n',
        "the loop has no parameter 'law.kq'; did you mean 'law.kp'",
    ),
    "no TOML": ("title = 'open", " is no valid TOML: "),
    "an empty file": ("", " is empty"),
    "deep brackets": ("x = " + "[" * 5000, "is no valid TOML"),
}


@pytest.mark.parametrize("name", list(BROKEN))
def test_a_broken_scenario_is_refused_in_one_sentence(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, message = BROKEN[name]
    file, out = tmp_path / "case.toml", tmp_path / "out"
    file.write_text(text)
    assert main(["run", str(file), "--out", str(out)]) == 2
    said = capsys.readouterr()
    assert message in said.err
    assert said.err.startswith("taut: ")
    assert said.err.count("\n") == 1
    assert said.out == ""
    assert not list(out.glob("*")) if out.exists() else True


def test_a_file_that_is_no_text_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "case.toml"
    file.write_bytes(b"title = '\xff\xfe'")
    assert main(["run", str(file)]) == 2
    assert "is no UTF-8 text" in capsys.readouterr().err


def test_a_good_scenario_runs_and_makes_its_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = tmp_path / "case.toml", tmp_path / "out"
    file.write_text(GOOD)
    assert main(["run", str(file), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["scenario"] == "case"
    assert set(result) >= {"scenario", "metrics", "outputs"}
    assert {Path(path).name for path in result["outputs"].values()} == {"x.png", "case.json"}
    assert all(Path(path).stat().st_size > 0 for path in result["outputs"].values())


def test_a_missed_pass_figure_exits_with_one_and_says_which(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "case.toml"
    file.write_text(changed("max = 3.0", "max = 1e-6"))
    assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 1
    assert "missed: PD: peak_error must be <= 1e-06; got " in capsys.readouterr().out


def test_a_run_that_diverges_exits_with_one_and_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "case.toml"
    file.write_text(changed("kd = [8, 4]", "kd = 1e6"))
    assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 1
    assert "PD: the simulation diverged at t = " in capsys.readouterr().out


def test_the_state_events_and_changes_of_the_true_arm_reach_the_run(tmp_path: Path) -> None:
    file = tmp_path / "case.toml"
    file.write_text(
        changed(
            'kind = "rigid"', 'kind = "rigid"\nfriction = "none"\npayload = { mass = 2.0 }\nsubsteps = 2'
        ).replace("duration = 0.2", "duration = 0.2\nq0 = [0.1, 0.2]\nv0 = [0.0, 1.0]\nseed = 5")
        + '[[event]]\nt = 0.1\nset = { "plant.payload.mass" = 0.5 }\n'
    )
    scenario = load_scenario(str(file))
    plant = scenario.make_plant()
    assert isinstance(plant, taut.RigidPlant)
    assert plant.arm.payload.mass == 2.0
    assert plant.friction is None
    assert plant.substeps == 2
    assert scenario.arm.payload.mass == 0.0
    np.testing.assert_array_equal(scenario.q0, [0.1, 0.2])
    assert scenario.seed == 5
    assert scenario.events[0].set == {"plant.payload.mass": 0.5}


@pytest.mark.parametrize("name", [name for name in built_in_scenarios() if name != "panda_payload"])
def test_every_built_in_scenario_reaches_its_pass_figures(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", name, "--out", str(tmp_path)]) == 0, capsys.readouterr().out


def test_the_demo_makes_a_table_a_picture_a_film_and_a_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "panda_payload", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    for law in ("PID", "PD + gravity", "feedforward + PD", "computed torque"):
        assert law in said
    assert {path.suffix for path in tmp_path.iterdir()} == {".png", ".gif", ".mcap", ".json"}
    again = taut.load_run(tmp_path / "panda_payload.mcap")
    assert again.outcome.ok
    assert again.metrics.overall["rms_error"] < 0.02
