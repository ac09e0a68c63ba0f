"""A peg of 20 mm goes into a hole of 20.4 mm that is somewhere within 2 mm and 2 degrees, and how chance is spread."""

from __future__ import annotations

import dataclasses
import json
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.cli.main import main
from taut.scenarios.run import run_scenario
from taut.scenarios.scenario import Outputs, Scenario, built_in_scenarios, load_scenario

HOLE = built_in_scenarios()["peg"].with_name("peg_hole.xml")
PEG = {"tool_radius": 0.01, "tool_length": 0.06}
NOTHING: dict[str, Any] = {"plot": None, "video": None, "log": None}


@pytest.fixture(scope="module")
def peg() -> Scenario:
    return load_scenario("peg")


def some(scenario: Scenario, runs: int) -> Scenario:
    """The first runs of a spread, without files."""
    outputs: Outputs = dataclasses.replace(
        scenario.outputs,
        **NOTHING,
        shown=next(iter(scenario.trials)).law,
        shown_case=next(iter(scenario.trials)).case,
    )
    cases = dict(list(scenario.cases.items())[:runs])
    return dataclasses.replace(scenario, cases=cases, outputs=outputs)


# -------------------------------------------------------------------- the hole


def test_the_radial_clearance_of_the_hole_is_nowhere_more_than_0_2_mm() -> None:
    root = ET.parse(HOLE).getroot()
    geom, mesh, wedges = root.find("default/geom"), root.find("asset/mesh"), root.findall("worldbody/body/geom")
    assert geom is not None
    assert mesh is not None
    corners = np.array(mesh.attrib["vertex"].split(), dtype=np.float64).reshape(-1, 3)
    margin, half = float(geom.attrib["margin"]), np.pi / len(wedges)
    face = corners[:, 0].min() - margin
    assert 0.16e-3 < face - PEG["tool_radius"] < 0.2e-3
    assert 0.1995e-3 < face / np.cos(half) - PEG["tool_radius"] < 0.2e-3
    # Wedges meet without a gap, all round, down to 40 mm; the chamfer is as deep as wide.
    np.testing.assert_allclose(np.abs(corners[:, 1]), corners[:, 0] * np.tan(half), rtol=1e-6)
    angles = [2.0 * np.arctan2(*[float(w.attrib["quat"].split()[i]) for i in (3, 0)]) for w in wedges]
    np.testing.assert_allclose(np.diff(angles), 2.0 * half, atol=1e-8)
    inner = corners[corners[:, 0] < 11.5e-3]
    np.testing.assert_allclose(sorted(set(inner[:, 2])), [-0.04, -1e-3, 0.0])


def test_a_peg_that_is_pressed_with_30_newtons_sinks_in_by_less_than_a_micrometre(peg: Scenario) -> None:
    arm = peg.experiment.arm
    T = taut.snapshot(arm, arm.home).T()
    beside = taut.Pose(T.p + np.array([0.015, 0.0, -1e-4]))  # over the steel, half of the peg over the hole
    plant = taut.MujocoPlant(arm, scene=HOLE, scene_at=beside, **PEG)
    ctrl = taut.compile(taut.laws.Impedance(K=(3000, 30), zeta=1.0), arm)
    out = taut.run(
        ctrl, plant, taut.TaskMotion(pose=taut.Pose(T.p - [0, 0, 0.0101], R=T.R)), duration=0.8, q0=arm.home
    )
    assert out.extra["F_ext"][-1, 2] == pytest.approx(30.0, abs=0.1)
    assert abs(out.task.p[-1, 2] - beside.p[2]) < 1e-6


# -------------------------------------------------------------------- the story


@pytest.mark.long
@pytest.mark.bars
def test_every_peg_goes_in_to_20_mm_with_at_most_30_newtons(
    peg: Scenario, tmp_path: Path, share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    scenario = some(peg, share(peg.spread.runs))  # type: ignore[union-attr]
    result = run_scenario(scenario, tmp_path, say=lambda _: None)
    assert result.ok, result.missed
    depths, forces = [], []
    for k, one in enumerate(result.runs.values(), start=1):
        hole = peg.spread.place(k)  # type: ignore[union-attr]
        tip = hole.R.T @ (one.task.p[-1] - hole.p)
        depths.append(-tip[2])
        forces.append(one.metrics.peak_force)
        assert np.hypot(*tip[:2]) < 0.21e-3  # in the hole, and not beside it
    assert min(depths) > 0.020
    assert max(forces) <= 30.0
    bar("peg in a hole, 0.2 mm: runs", len(depths))
    bar("peg in a hole, 0.2 mm: least depth [mm]", round(1e3 * float(min(depths)), 2))
    bar("peg in a hole, 0.2 mm: largest force [N]", round(float(max(forces)), 1))


# -------------------------------------------------------------------- chance

WALL = '<geom type="box" size="0.05 1 1" pos="5 0 0"/>'
SPREAD = """title = "t"
[arm]
model = "planar2"
[laws.PD]
law = "PID"
kp = 10
kd = 2
[plant]
kind = "mujoco"
scene = "wall.xml"
scene_at = { p = [1.0, 2.0, 3.0], rpy = [0.0, 0.0, 0.3] }
[spread]
runs = 3
seed = 4
shift = 0.002
tilt = 0.03
[run]
duration = 0.05
[reference]
kind = "set-point"
q = [0.1, 0.2]
[outputs]
plot = "plot.png"
columns = ["peak_error", "final_z"]
[[pass]]
law = "PD"
metric = "peak_error"
max = 2.0
"""


def written(folder: Path, text: str = SPREAD) -> str:
    (folder / "wall.xml").write_text(WALL)
    file = folder / "chance.toml"
    file.write_text(text)
    return str(file)


def test_places_fill_their_discs_and_depend_on_the_seed_and_the_run_alone(tmp_path: Path) -> None:
    spread = load_scenario(written(tmp_path)).spread
    assert spread is not None
    places = [spread.place(k) for k in range(1, 1001)]
    shifts = np.array([place.p - spread.at.p for place in places])
    tilts = np.array([np.arccos(np.clip((place.R @ spread.at.R.T)[2, 2], -1.0, 1.0)) for place in places])
    for size, most in ((np.linalg.norm(shifts, axis=1), 0.002), (tilts, 0.03)):
        assert 0.99 * most < size.max() <= most * (1.0 + 1e-6)
        assert np.mean(size**2) == pytest.approx(0.5 * most**2, rel=0.06)  # as an even spread over a disc has it
    assert np.abs(shifts.mean(axis=0)).max() < 1e-4
    assert not shifts[:, 2].any()
    np.testing.assert_array_equal(spread.place(2).R, places[1].R)
    assert dataclasses.replace(spread, seed=5).place(2).p[0] != places[1].p[0]


def test_each_run_has_its_scene_elsewhere_and_is_a_run_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path)
    scenario = load_scenario(file)
    assert list(scenario.cases) == ["run 1", "run 2", "run 3"]
    for k, one in enumerate(scenario.cases.values(), start=1):
        plant: Any = one.experiment.plant
        geom = int(np.flatnonzero((plant.model.geom_size == [0.05, 1.0, 1.0]).all(axis=1))[0])
        plant.reset(one.experiment.arm.home, np.zeros(2), 1e-3)
        import mujoco

        mujoco.mj_forward(plant.model, plant.data)
        place = scenario.spread.place(k)  # type: ignore[union-attr]
        np.testing.assert_allclose(plant.data.geom_xpos[geom], place.p + place.R @ [5.0, 0.0, 0.0], atol=1e-12)
    assert main(["run", file, "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "passed: 3 of 3 pass criteria" in told
    metrics = json.loads((tmp_path / "out" / "chance.json").read_text())
    assert list(metrics) == ["run 1", "run 2", "run 3"]
    assert (tmp_path / "out" / "plot.png").stat().st_size > 10_000


def test_a_figure_that_one_run_misses_is_missed_and_the_run_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = SPREAD.replace("max = 2.0", 'max = 1e-6\ncase = "run 2"')
    assert main(["run", written(tmp_path, text), "--out", str(tmp_path / "out")]) == 1
    missed = [text for text in capsys.readouterr().out.splitlines() if text.startswith("missed")]
    assert len(missed) == 1
    assert missed[0].startswith("missed: run 2: PD: peak_error must be <= 1e-06")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("runs = 3", "runs = 1", "[spread] runs must be a whole number from 2 to 1000; got 1"),
        ("runs = 3", "runs = 3.5", "[spread] runs must be a whole number from 2 to 1000; got 3.5"),
        ("runs = 3", "", "[spread] needs the key 'runs'"),
        ("seed = 4", "seed = -1", "[spread] seed must be a whole number >= 0; got -1"),
        ("shift = 0.002", "shift = -0.1", "[spread] shift must be >= 0 [m]; got -0.1"),
        ("tilt = 0.03", "tilt = 2.0", "[spread] tilt must be <= 1.5708 [rad]; got 2"),
        ("shift = 0.002\ntilt = 0.03", "", "[spread] needs shift [m], tilt [rad] or both above zero"),
        ("tilt = 0.03", "tlit = 0.03", "[spread] has no key 'tlit'; did you mean 'tilt'?"),
        ('scene = "wall.xml"', "", '[spread] moves the scene; give [plant] kind = "mujoco" and scene'),
        (
            "[run]",
            "[cases.a.run]\nduration = 1\n[run]",
            "[spread] does not go with [cases]; put them in scenarios of their own",
        ),
        ("rpy = [0.0, 0.0, 0.3]", "rpy = 3", "[plant.scene_at] rpy must have shape (3,) [rad]"),
        ("scene_at = {", "tool_length = -1.0\nscene_at = {", "[plant] tool_length must be > 0 [m]; got -1.0"),
        ("[laws.PD]", "tool_offset = { p = 1 }\n[laws.PD]", "[arm.tool_offset] p must have shape (3,)"),
    ],
)
def test_chance_that_is_none_is_refused(
    old: str, new: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert old in SPREAD
    assert main(["run", written(tmp_path, SPREAD.replace(old, new, 1)), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.strip().partition("chance.toml': ")[2].startswith(words)


def test_the_tool_of_a_scenario_may_stand_off_a_frame(peg: Scenario) -> None:
    arm = taut.load_arm("panda")
    moved = taut.snapshot(arm, arm.home).T() @ taut.Pose([0.0, 0.0, 0.05])
    np.testing.assert_allclose(taut.snapshot(peg.experiment.arm, arm.home).T().p, moved.p, atol=1e-12)
