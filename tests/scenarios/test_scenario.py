"""Scenarios that can run: what they make, and how they end."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from story_names import STORIES

import taut
from taut.cli.main import main
from taut.scenarios.reading import read_toml
from taut.scenarios.scenario import built_in_scenarios, load_scenario
from taut.scenarios.sections import read_control, read_plant

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

MIXED = """<robot name="mixed">
<link name="base"/>
<link name="upper"><inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="slide"><inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/></joint>
<joint name="push" type="prismatic"><parent link="upper"/><child link="slide"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="50" velocity="1"/></joint>
</robot>
"""

# A machine without OpenGL draws its films, and says so.
WITHOUT_OPENGL = pytest.mark.filterwarnings("ignore:.* is a schematic drawing:RuntimeWarning")


def changed(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new)


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
    file.write_text(changed("max = 3.0", "max = 1e-6\nwindow = [0.01, 0.02]"))
    assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().out
    assert "missed: PD: peak_error must be <= 1e-06; got " in said
    assert "passed: 0 of 1 pass criteria (windows: 0.01 to 0.02 s)" in said


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_run_that_diverges_exits_with_one_and_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "case.toml"
    file.write_text(changed("kd = [8, 4]", "kd = 1e6"))
    assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 1
    assert "PD: the simulation diverged at t = " in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
class TestALawThatFailsInTheFirstTick:
    """There is nothing to draw and nothing to film, but how it ended must be heard."""

    ENDLESS = changed("kp = 50", "kp = 1e300").replace("q = [0.2, 0.3]", "q = [3e8, 3e8]")
    LAW = """
import taut


class Endless(taut.Law):
    kp: taut.Gain

    def command(self, x, ref):
        return taut.Torque(P=self.kp @ (ref.q - x.q) / x.t)
"""

    def scenario(self, tmp_path: Path, outputs: str) -> list[str]:
        file = tmp_path / "case.toml"
        file.write_text(self.ENDLESS.replace('plot = "x.png"', outputs))
        return ["run", str(file), "--out", str(tmp_path / "out")]

    def test_it_exits_with_one_and_says_how_it_ended_and_what_was_not_made(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        outputs = 'plot = "x.png"\nvideo = "x.gif"\nlog = "x.mcap"'
        assert main(self.scenario(tmp_path, outputs)) == 1
        said = capsys.readouterr()
        assert said.err == ""
        assert "PD: the law gives " in said.out
        assert "at t = 0 s (tick 0)" in said.out
        assert "no plot: there is nothing to plot: no law got through its first tick" in said.out
        assert "no video: there is nothing to film: the law did not get through its first tick" in said.out
        assert "missed: PD: peak_error counts only in a run that goes to its end; this one diverged" in said.out
        assert {path.name for path in (tmp_path / "out").iterdir()} == {"x.mcap", "case.json"}

    def test_it_says_the_same_as_json(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert main([*self.scenario(tmp_path, 'plot = "x.png"'), "--json"]) == 1
        result = json.loads(capsys.readouterr().out)
        assert result["ok"] is False
        assert result["outcomes"]["PD"]["kind"] == "diverged"
        assert list(result["skipped"]) == ["plot"]
        assert list(result["outputs"]) == ["metrics"]

    def test_the_laws_that_ran_are_drawn_without_it(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        words = self.scenario(tmp_path, 'plot = "x.png"')
        file = tmp_path / "case.toml"
        file.write_text(file.read_text() + '[laws.good]\nlaw = "GravityPID"\nkp = 0\nkd = 0\n')
        assert main(words) == 1
        assert (tmp_path / "out" / "x.png").stat().st_size > 0
        assert "PD: the law gives " in capsys.readouterr().out

    def test_a_law_of_the_users_own_too(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (tmp_path / "case.toml").write_text(GOOD)
        (tmp_path / "endless.py").write_text(self.LAW)
        place = f"{tmp_path / 'endless.py'}:Endless"
        words = ["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "out"), "--law", place, "--gain", "kp=1"]
        assert main(words) == 1
        assert "t = 0 s (tick 0)" in capsys.readouterr().out


class TestFilesAreWholeOrNotThere:
    def run(self, tmp_path: Path, *flags: str) -> int:
        (tmp_path / "case.toml").write_text(
            GOOD.replace('plot = "x.png"', 'plot = "x.png"\nlog = "x.mcap"\nvideo = "x.gif"')
        )
        return main(["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "out"), *flags])

    @pytest.mark.parametrize("name", ["x.png", "x.gif", "x.mcap", "case.json"])
    def test_a_name_that_a_folder_has_is_refused_before_the_run(
        self, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        (tmp_path / "out" / name).mkdir(parents=True)
        assert self.run(tmp_path) == 2
        said = capsys.readouterr()
        assert said.err.endswith(f"'{tmp_path / 'out' / name}' is a folder; name a file in it\n")
        assert said.err.count("\n") == 1
        assert [path.name for path in (tmp_path / "out").iterdir()] == [name]

    def test_a_folder_that_is_a_file_is_refused_before_the_run(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        (tmp_path / "out").write_text("mine")
        for folder in (tmp_path / "out", tmp_path / "out" / "below"):
            assert self.run(tmp_path, "--out", str(folder)) == 2
            assert f"taut: the folder '{folder}' cannot be made: " in capsys.readouterr().err
        assert (tmp_path / "out").read_text() == "mine"

    def test_a_folder_with_a_name_of_5000_letters_is_refused(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert self.run(tmp_path, "--out", "a" * 5000) == 2
        assert "File name too long" in capsys.readouterr().err

    @pytest.mark.part(1)
    @WITHOUT_OPENGL
    @pytest.mark.parametrize(("kind", "name"), [("plot", "x.png"), ("log", "x.mcap")])
    def test_a_full_disk_leaves_what_was_there_and_the_result_is_told(
        self,
        kind: str,
        name: str,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / name).write_text("before")
        replace = Path.replace

        def full(self: Path, target: Path) -> Path:
            if Path(target).name == name:
                raise OSError(28, "No space left on device")
            return replace(self, target)

        monkeypatch.setattr(Path, "replace", full)
        assert self.run(tmp_path) == 1
        said = capsys.readouterr()
        file = tmp_path / "out" / name
        assert f"no {kind}: {kind} '{file}' cannot be written: No space left" in said.out
        assert "completed" in said.out
        assert file.read_text() == "before"
        names = {"x.png", "x.gif", "x.mcap", "case.json"}
        assert {path.name for path in (tmp_path / "out").iterdir()} == names

    def test_without_outputs_the_command_says_where_the_metrics_went(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        Path("case.toml").write_text(changed('[outputs]\nplot = "x.png"', ""))
        assert main(["run", "case.toml"]) == 0
        assert f"metrics  {Path('out/case/case.json')}" in capsys.readouterr().out
        assert json.loads(Path("out/case/case.json").read_text())["PD"]["peak_error"]["overall"] < 3.0


class TestJointsInRadAndJointsInM:
    """Nothing adds rad to m: each unit has its numbers, its columns and its pictures."""

    def write(self, tmp_path: Path, figure: str = "") -> list[str]:
        (tmp_path / "mixed.urdf").write_text(MIXED)
        head, _, _ = GOOD.partition("[[pass]]")
        text = head.replace('"planar2"', '"mixed.urdf"') + '[laws.second]\nlaw = "PID"\nkp = 1\n' + figure
        (tmp_path / "case.toml").write_text(text)
        return ["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "out")]

    def test_the_table_has_a_row_for_each_unit_and_the_laws_are_compared(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(self.write(tmp_path)) == 0
        lines = capsys.readouterr().out.splitlines()
        for title in ("RMS error [rad]", "RMS error [m]", "final error [m]", "effort [N^2 s]", "peak torque [N m]"):
            assert any(line.startswith(title) for line in lines), title
        assert (tmp_path / "out" / "x.png").stat().st_size > 0

    def test_a_figure_of_one_joint_is_compared(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        figure = '[[pass]]\nlaw = "PD"\njoint = "push"\nmetric = "peak_error"\n'
        assert main(self.write(tmp_path, figure + "max = 0.4\n")) == 0
        assert main(self.write(tmp_path, figure + "max = 0.2\n")) == 1
        assert "missed: PD: peak_error of joint 'push' must be <= 0.2; got 0.3" in capsys.readouterr().out

    def test_a_figure_of_a_joint_without_a_step_has_no_meaning(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        words = self.write(tmp_path, '[[pass]]\nlaw = "PD"\njoint = "turn"\nmetric = "overshoot"\nmax = 9\n')
        file = tmp_path / "case.toml"
        file.write_text(file.read_text().replace("q = [0.2, 0.3]", "q = [0.0, 0.3]"))
        assert main(words) == 1
        assert "missed: PD: overshoot of joint 'turn' has no meaning in this run" in capsys.readouterr().out

    def test_a_figure_that_needs_one_number_is_missed(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        words = self.write(tmp_path, '[[pass]]\nlaw = "PD"\nmetric = "peak_error"\nmax = 0.4\n')
        assert main(words) == 1
        assert "peak_error has no one number for joints in rad and joints in m together" in capsys.readouterr().out

    def test_energy_and_time_are_of_all_joints(self, tmp_path: Path) -> None:
        figures = "".join(
            f'[[pass]]\nlaw = "PD"\nmetric = "{name}"\nmin = 0\n' for name in ("energy", "settling_time")
        )
        assert main(self.write(tmp_path, figures)) == 0


class TestFilesLieBesideTheScenario:
    """Whatever the current folder is."""

    def test_models_scenes_and_samples_are_found(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "here" / "models").mkdir(parents=True)
        (tmp_path / "elsewhere").mkdir()
        (tmp_path / "here" / "models" / "mixed.urdf").write_text(MIXED)
        (tmp_path / "here" / "s.csv").write_text("t,q1,q2\n0,0,0\n1,0.1,0.2\n")
        (tmp_path / "here" / "scene.xml").write_text("<mujoco/>")
        old = 'kind = "set-point"\nq = [0.2, 0.3]'
        text = (
            changed('"planar2"', '"models/mixed.urdf"')
            .replace(old, 'kind = "samples"\nfile = "s.csv"')
            .replace("peak_error", "energy")
            .replace('kind = "rigid"', 'kind = "mujoco"\nmodel = "models/mixed.urdf"\nscene = "scene.xml"')
        )
        (tmp_path / "here" / "case.toml").write_text(text)
        for folder, name in (
            ("elsewhere", "../here/case.toml"),
            ("here", "case.toml"),
            ("here/models", "../case.toml"),
        ):
            monkeypatch.chdir(tmp_path / folder)
            assert load_scenario(name).experiment.arm.name == "mixed"
        assert main(["run", "../case.toml", "--out", "o"]) == 0
        assert (tmp_path / "here" / "models" / "o" / "case.json").is_file()

    def test_a_whole_path_stays_what_it_is(self, tmp_path: Path) -> None:
        (tmp_path / "mixed.urdf").write_text(MIXED)
        (tmp_path / "here").mkdir()
        file = tmp_path / "here" / "case.toml"
        file.write_text(changed('"planar2"', f"'{tmp_path / 'mixed.urdf'}'").replace("peak_error", "energy"))
        assert load_scenario(str(file)).experiment.arm.name == "mixed"

    def test_the_name_of_an_arm_is_no_file(self, tmp_path: Path) -> None:
        (tmp_path / "planar2").mkdir()
        (tmp_path / "case.toml").write_text(GOOD)
        assert load_scenario(str(tmp_path / "case.toml")).experiment.arm.name == "planar2"


class TestNamesThatMeanSomethingElsewhere:
    def test_a_title_and_a_label_are_text_for_the_table_and_the_plot(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "case.toml"
        file.write_text(
            changed('title = "a test"', 'title = "[/b] and [bold]"')
            .replace("[laws.PD]", "[laws.'$\\frac{$ [/b]']")
            .replace('law = "PD"', "law = '$\\frac{$ [/b]'")
            + '[laws."$x^$"]\nlaw = "PID"\nkp = 1\n'
        )
        assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 0
        said = capsys.readouterr().out
        assert "[/b] and [bold]" in said
        assert "$\\frac{$ [/b]" in said

    def test_a_label_with_a_line_end_stays_in_one_line_of_a_message(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        file = tmp_path / "case.toml"
        file.write_text(GOOD.replace("[laws.PD]", '[laws."a\\nb\\u001b[31m"]').replace("kp = 50", "kp = -1"))
        assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert r"'a\nb\x1b[31m' with an invisible character" in said
        assert said.count("\n") == 1

    def test_an_editors_mark_at_the_start_is_no_part_of_the_text(self, tmp_path: Path) -> None:
        file = tmp_path / "case.toml"
        file.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
        assert load_scenario(str(file)).title == "a test"


class TestFromHome:
    """relative_to_home moves a reference by the home pose of the plant's arm, and changes nothing else."""

    def reference(self, tmp_path: Path, text: str) -> Any:
        old = '[reference]\nkind = "set-point"\nq = [0.2, 0.3]\n'
        file = tmp_path / "case.toml"
        file.write_text(changed(old, f"[reference]\n{text}\n"))
        scenario = load_scenario(str(file))
        return scenario.experiment.reference, scenario.experiment.plant.arm.home

    def test_a_set_point(self, tmp_path: Path) -> None:
        reference, home = self.reference(
            tmp_path, 'kind = "set-point"\nq = [0.2, 0.3]\nv = [1, 2]\nrelative_to_home = true'
        )
        np.testing.assert_allclose(reference.q - home, [0.2, 0.3], rtol=1e-12)
        np.testing.assert_array_equal(reference.v, [1.0, 2.0])

    def test_home_itself(self, tmp_path: Path) -> None:
        for relative in ("true", "false"):
            text = f'kind = "cubic"\nq0 = "home"\nq1 = [1, 1]\nduration = 1\nrelative_to_home = {relative}'
            reference, home = self.reference(tmp_path, text)
            np.testing.assert_array_equal(reference.q0, home)
            np.testing.assert_array_equal(reference.q1, home * (relative == "true") + 1.0)

    def test_a_scalar_that_stands_for_all_joints(self, tmp_path: Path) -> None:
        text = 'kind = "sine"\ncenter = 0.1\namplitude = [1, 1]\nfrequency = 1\nrelative_to_home = true'
        reference, home = self.reference(tmp_path, text)
        np.testing.assert_array_equal(reference.center, home + 0.1)
        np.testing.assert_array_equal(reference.amplitude, [1.0, 1.0])

    def test_a_file_of_samples(self, tmp_path: Path) -> None:
        (tmp_path / "s.csv").write_text("t,q1,q2\n0,0,0\n1,0.1,0.2\n")
        reference, home = self.reference(tmp_path, 'kind = "samples"\nfile = "s.csv"\nrelative_to_home = true')
        np.testing.assert_allclose(reference.q - home, [[0.0, 0.0], [0.1, 0.2]], rtol=1e-12)
        np.testing.assert_allclose(reference.v, [[0.1, 0.2]] * 2, rtol=1e-12)


def test_a_link_with_other_numbers_keeps_what_else_is_said_of_the_arm(tmp_path: Path) -> None:
    file = tmp_path / "case.toml"
    file.write_text(
        '[arm]\nmodel = "one_joint"\nlink = { r = 0.05 }\nhome = [0.3]\ngravity = [0, 0, -1.6]\nT_WB = { p = [0, 0, 2] }\n'
        '[laws.PD]\nlaw = "PID"\nkp = 1\n[plant]\n[run]\nduration = 0.1\n'
    )
    arm = load_scenario(str(file)).experiment.arm
    assert arm.bodies[0].com.tolist() == [0.05, 0.0, 0.0]
    assert arm.home.tolist() == [0.3]
    assert arm.gravity.tolist() == [0.0, 0.0, -1.6]
    assert arm.T_WB.p.tolist() == [0.0, 0.0, 2.0]


def test_the_state_events_and_changes_of_the_true_arm_reach_the_run(tmp_path: Path) -> None:
    file = tmp_path / "case.toml"
    file.write_text(
        changed(
            'kind = "rigid"', 'kind = "rigid"\nfriction = "none"\npayload = { mass = 2.0 }\nsubsteps = 2'
        ).replace("duration = 0.2", "duration = 0.2\nq0 = [0.1, 0.2]\nv0 = [0.0, 1.0]\nseed = 5")
        + '[[event]]\nt = 0.1\nset = { "plant.payload.mass" = 0.5 }\n'
    )
    scenario = load_scenario(str(file))
    plant = scenario.experiment.plant
    assert isinstance(plant, taut.RigidPlant)
    assert plant.arm.payload.mass == 2.0
    assert plant.friction is None
    assert plant.substeps == 2
    assert scenario.experiment.arm.payload.mass == 0.0
    np.testing.assert_array_equal(scenario.experiment.q0, [0.1, 0.2])
    assert scenario.experiment.seed == 5
    assert scenario.experiment.events[0].set == {"plant.payload.mass": 0.5}


SENSED = """
[plant.sensors]
velocity = "none"
torque = { noise = 0.1, side = "motor" }
tip = { range = 50.0 }

[plant.sensors.position]
resolution = [0.0, 1e-4]
side = "motor"

[control.notch]
frequency = [18, 0]
width = 4
"""


@pytest.mark.part(1)
@pytest.mark.parametrize(
    ("written", "made"),
    [
        ('velocity = "difference"', "difference"),
        ('velocity = { kind = "difference", cutoff = 30, order = 2 }', taut.sensors.Difference(cutoff=30.0, order=2)),
        (
            'velocity = { kind = "kalman", acceleration_noise = [1, 2], position_noise = 1e-4 }',
            taut.sensors.Kalman(acceleration_noise=[1.0, 2.0], position_noise=1e-4),
        ),
    ],
)
def test_sensors_and_sensing_reach_the_run(
    written: str, made: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "case.toml"
    file.write_text(changed("rate = 500", f"rate = 500\n{written}") + SENSED)
    scenario = load_scenario(str(file))
    assert isinstance(scenario.experiment.plant, taut.RigidPlant)
    sensors = scenario.experiment.plant.sensors
    assert sensors.velocity is None
    assert np.asarray(sensors.position.resolution).tolist() == [0.0, 1e-4]
    assert sensors.position.side == "motor"
    assert sensors.torque is not None
    assert (sensors.torque.side, float(np.asarray(sensors.torque.noise))) == ("motor", 0.1)
    assert scenario.experiment.plant.measures == {"tau_meas", "a_tip"}
    assert scenario.experiment.sensing.notch is not None
    assert np.asarray(scenario.experiment.sensing.notch.frequency).tolist() == [18.0, 0.0]
    assert type(scenario.experiment.sensing.velocity) is type(made)
    wanted = taut.Sensing(velocity=made).parameters()
    got = scenario.experiment.sensing.parameters()
    for path, value in wanted.items():
        np.testing.assert_array_equal(got[path], value)
    assert getattr(scenario.experiment.sensing.velocity, "order", None) == getattr(made, "order", None)
    assert main(["run", str(file), "--out", str(tmp_path / "out")]) == 0
    assert "PD" in capsys.readouterr().out


def test_a_wrist_sensor_that_weighs_and_what_the_controller_knows_of_it_can_be_written(tmp_path: Path) -> None:
    file = tmp_path / "case.toml"
    file.write_text(TEXT_OF_WRIST)
    root = read_toml(file)
    arm = taut.load_arm("planar2")
    plant = read_plant(root.table("plant"), arm, 500.0)
    assert plant.parameters["sensors.wrench.tool.mass"] == 0.7
    assert plant.parameters["sensors.wrench.tool.com"].tolist() == [0.0, 0.0, 0.05]
    assert plant.parameters["sensors.wrench.noise"].tolist() == [0.1] * 3 + [0.01] * 3
    _, sensing, _ = read_control(root.table("control"), arm)
    wrist = sensing.wrist
    assert wrist is not None
    assert wrist.frame == "tool"
    got = {path: value.tolist() for path, value in sensing.parameters().items()}
    assert got == {
        "F_ext.cutoff": 30.0,
        "wrist.bias": [1.0, 2.0, 3.0, 0.0, 0.0, 0.1],
        "wrist.mass": 0.7,
        "wrist.com": [0.0, 0.0, 0.05],
        "wrist.range": [200.0] * 3 + [10.0] * 3,
    }


TEXT_OF_WRIST = """
[plant.sensors.wrench]
noise = [0.1, 0.01]
tool = { mass = 0.7, com = [0, 0, 0.05] }

[control.wrist]
bias = [1, 2, 3, 0, 0, 0.1]
mass = 0.7
com = [0, 0, 0.05]
range = [200, 10]
frame = "tool"

[control.F_ext]
cutoff = 30
"""


def test_a_low_pass_of_the_measured_velocity_can_be_written_too(tmp_path: Path) -> None:
    file = tmp_path / "case.toml"
    file.write_text(changed("rate = 500", 'rate = 500\nvelocity = { kind = "low-pass", cutoff = [30, 40] }'))
    velocity = load_scenario(str(file)).experiment.sensing.velocity
    assert isinstance(velocity, taut.sensors.LowPass)
    assert np.asarray(velocity.cutoff).tolist() == [30.0, 40.0]


ELSEWHERE = ("panda_payload", "peg", "wrong_board", *STORIES)  # each runs once, in the tests of its own


UNSTABLE = pytest.param(
    "gain_bounds", marks=pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
)  # it shows that


@pytest.mark.part(7)
@pytest.mark.parametrize(
    "name", [UNSTABLE if n == "gain_bounds" else n for n in built_in_scenarios() if n not in ELSEWHERE]
)
def test_every_built_in_scenario_reaches_its_pass_figures(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", name, "--out", str(tmp_path)]) == 0, capsys.readouterr().out


@WITHOUT_OPENGL
def test_the_demo_makes_a_table_a_picture_a_film_and_a_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a quarter of its time, for the sake of the film."""
    monkeypatch.setenv("COLUMNS", "160")
    text = built_in_scenarios()["panda_payload"].read_text(encoding="utf-8")
    assert text.count("duration = 6.0 ") == 1
    file = tmp_path / "panda_payload.toml"
    file.write_text(text.replace("duration = 6.0 ", "duration = 1.5 "))
    assert main(["run", str(file), "--out", str(tmp_path)]) == 0
    file.unlink()
    said = capsys.readouterr().out
    for law in ("PID", "PD + gravity", "feedforward + PD", "computed torque"):
        assert law in said
    assert {path.suffix for path in tmp_path.iterdir()} == {".png", ".gif", ".mcap", ".json"}
    again = taut.load_run(tmp_path / "panda_payload.mcap")
    assert again.outcome.ok
    assert again.metrics.overall("rms_error") < 0.02


def test_limits_in_words_and_in_a_table(tmp_path: Path) -> None:
    def limits(text: str) -> taut.Limits:
        file = tmp_path / "one.toml"
        changed_text = changed('model = "planar2"', 'model = "panda"').replace("kd = [8, 4]", "kd = 4")
        changed_text = changed_text.replace("q = [0.2, 0.3]", 'q = "home"')
        file.write_text(changed_text.replace("rate = 500", f"limits = {text}"), encoding="utf-8")
        found = load_scenario(str(file)).experiment.limits
        assert found is not None
        return found

    panda = taut.load_arm("panda")
    np.testing.assert_array_equal(limits('"arm"').tau, panda.effort)
    words = limits('{ of = "arm", rate = true, speed = true, blend = 0.2 }')
    np.testing.assert_array_equal(words.v, panda.velocity)
    np.testing.assert_array_equal(words.tau_dot, 10.0 * panda.effort)
    assert words.blend == 0.2
    assert (limits("{ blend = 0.1 }").blend, limits("{ blend = 0.1 }").tau) == (0.1, None)


def test_a_law_that_holds_a_law_and_one_that_is_added(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "one.toml"
    text = changed(
        'law = "GravityPID"\nkp = 50\nkd = [8, 4]\n',
        'law = ["RaisedGains", "Dither"]\n[laws.PD.Dither]\namplitude = 0.1\nfrequency = 40\n'
        '[laws.PD.RaisedGains]\nfactor = 3\nwidth = 0.2\n[laws.PD.RaisedGains.inner]\nlaw = "GravityPID"\nkp = 50\n'
        'kd = 4\nintegral = { anti_windup = "back-calculation", tracking = 20 }\n',
    )
    file.write_text(
        text.replace("max = 3.0", 'max = 3.0\n[[event]]\nt = 0.1\nset = { "law.Dither.frequency" = 60 }'),
        encoding="utf-8",
    )
    assert main(["run", str(file), "--out", str(tmp_path / "out"), "--json"]) == 0
    law = load_scenario(str(file)).laws["PD"]
    assert law.parameters()["RaisedGains.inner.integral.tracking"] == 20.0
    assert capsys.readouterr().out


LQR = """
[arm]
model = "planar2"
[laws.LQR]
law = "lqr"
Q = [400, 400, 1, 1]
R = 0.01
at = [0.3, 0.8]
[control]
rate = 500
[plant]
[reference]
kind = "set-point"
q = [0.3, 0.8]
[run]
duration = 0.1
"""


@pytest.mark.parametrize("adds", ["", 'adds = ["gravity"]'])
def test_an_lqr_of_a_file_is_that_of_python_for_the_arm_and_rate_of_the_file(adds: str, tmp_path: Path) -> None:
    file = tmp_path / "one.toml"
    file.write_text(LQR.replace("[plant]", f"[plant]\n{adds}"), encoding="utf-8")
    law: Any = load_scenario(str(file)).laws["LQR"]
    arm = taut.load_arm("planar2")
    model = taut.RigidPlant(arm, friction=None, integrator="rk4", adds=("gravity",) if adds else ())
    found = taut.analysis.lqr(arm, Q=[400.0, 400.0, 1.0, 1.0], R=0.01, at=[0.3, 0.8], rate=500.0, plant=model)
    np.testing.assert_allclose(np.hstack([law.K_q, law.K_v]), found.K, rtol=1e-12)
    weight = np.zeros(2) if adds else taut.snapshot(arm, [0.3, 0.8]).g
    np.testing.assert_allclose(law.tau_0.as_array(), weight, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("R = 0.01", "R = 0", "laws.LQR.R"),
        ("R = 0.01", "", "laws.LQR.R"),
        ("at", "kp", "laws.LQR.kp"),
        ('"lqr"', '"lqg"', "laws.LQR.law"),
        ('"set-point"', '"transition"', "reference.kind"),
    ],
)
def test_an_lqr_that_is_none_is_refused_by_its_key(old: str, new: str, key: str, tmp_path: Path) -> None:
    file = tmp_path / "one.toml"
    file.write_text(LQR.replace(old, new, 1), encoding="utf-8")
    with refused(taut.errors.ScenarioError) as caught:
        load_scenario(str(file))
    assert caught.value.name == key
