"""What touches the tool, pushes and payloads in scenarios of both kinds of plant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.cli.main import main
from taut.scenarios.scenario import load_scenario

GOOD = """
[arm]
model = "gantry3"
[laws.PD]
law = "GravityPID"
kp = 2000
kd = [400, 300, 150]
[control]
rate = 1000
[plant]
kind = "KIND"
[reference]
kind = "hold"
[run]
duration = 0.6
[outputs]
log = "run.mcap"
"""


def written(folder: Path, kind: str, more: str) -> str:
    file = folder / "case.toml"
    file.write_text(GOOD.replace("KIND", kind) + more, encoding="utf-8")
    return str(file)


@pytest.mark.parametrize("kind", ["rigid", "mujoco"])
@pytest.mark.parametrize(
    ("text", "made"),
    [
        (
            'kind = "spring"\nstiffness = [300, 20]\nat = { p = [0.1, 0, 0], rpy = [0, 0, 1] }',
            taut.environments.Spring,
        ),
        ('kind = "spring"\nstiffness = 300\nat = [0.1, 0, 0]\nslack = 0.05', taut.environments.Spring),
        ('kind = "damper"\ndamping = 30', taut.environments.Damper),
        (
            'kind = "wall"\npoint = [0, 0, -0.3]\nnormal = [0, 0, 1]\nstiffness = 1e4\nfriction = 0.3',
            taut.environments.StiffWall,
        ),
        ('kind = "hand"\nmass = 0.5\ndamping = 3\nstiffness = 100', taut.environments.Hand),
        (
            'kind = "hand"\nmass = 0.5\ndamping = 3\nstiffness = 100\n'
            "motion = { amplitude = [0.02, 0, 0], frequency = 1 }\n"
            "force = { amplitude = 2, frequency = 3 }",
            taut.environments.Hand,
        ),
        ('kind = "push"\npeak = [10, 0, 0]\nt = 0.1\nduration = 0.2\nshape = "rectangular"', taut.environments.Push),
        ('push = { kind = "push" }\nsoft = { kind = "spring", stiffness = 200 }', taut.environments.Environments),
    ],
)
def test_each_kind_reaches_both_plants(text: str, made: Any, kind: str, tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, kind, f"[plant.environment]\n{text}\n"))
    plant: Any = scenario.experiment.plant
    if kind == "rigid":
        assert type(plant.environment) is made
    numbers = [path for path in plant.parameters if path.startswith("environment.")]
    assert numbers
    assert "F_ext" in plant.measures
    if "noise" in text:
        assert float(plant.parameters["environment.force.high"]) == 3.0
    if made is taut.environments.Environments:
        assert sorted(numbers)[-1] == "environment.soft.stiffness"


@pytest.mark.parametrize("kind", ["rigid", "mujoco"])
def test_pushes_payloads_and_gains_come_by_events(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    events = """
[plant.environment.poke]
kind = "push"
peak = [30, 0, 0]
duration = 0.05

[[event]]
t = 0.1
push = { of = "environment.poke" }

[[event]]
t = 0.2
set = { "plant.payload.mass" = 1.0 }

[[event]]
t = 0.3
set = { "plant.payload.mass" = 0.0, "law.kp" = 4000 }

[[event]]
t = 0.4
push = { of = "environment.poke", peak = [0, 20, 0], duration = 0.1 }
"""
    assert main(["run", written(tmp_path, kind, events), "--out", "out"]) == 0
    file = taut.load_run(tmp_path / "out" / "run.mcap").to_csv(tmp_path / "run.csv")
    names = file.read_text().splitlines()[0].split(",")
    table = dict(zip(names, np.loadtxt(file, delimiter=",", skiprows=1).T, strict=True))
    force = [table[f"extra.F_ext.{i}"] for i in range(3)]
    t = table["t"]
    pushed = [(0.1, 0.15, 0, 30.0), (0.4, 0.5, 1, 20.0)]
    for begin, end, axis, peak in pushed:
        inside = (t > begin - 1e-9) & (t < end - 1e-9)
        assert force[axis][inside].max() == pytest.approx(peak, rel=1e-2)
        assert force[axis][inside].sum() * 1e-3 == pytest.approx(peak * (end - begin) * 2.0 / np.pi, rel=1e-12)
        assert not force[axis][~inside].any()
    assert not force[2].any()
    z = table[next(name for name in names if name.startswith("q.z"))]
    assert z[t < 0.19].min() > -1e-9
    assert z.min() < -1e-3  # it sags under its load
