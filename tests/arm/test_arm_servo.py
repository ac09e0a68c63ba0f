"""Servos: parameter files against the package that made them, an arm with servos, and every broken file."""

from __future__ import annotations

import json
import sys
import types
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut import Friction, Servo
from taut.errors import FileError, ModelError, RangeError, ShapeError, UnknownNameError, UsageError
from taut.maths.friction import FrictionValues, dry_limit

WHEELS = Path(__file__).parents[2] / ".wheels"  # filled by set-up
WHEEL = WHEELS / "better_actuator_models-1.0.2-py3-none-any.whl"
SAME = 1e-12  # relative: static friction is a sum there and a difference here

# The STS3215 at 7.4 V of the SO-101, model m1, as published with better-actuator-models 1.0.2.
STS3215 = {
    "kt": 1.21164135295077,
    "R": 2.6761663274455603,
    "armature": 0.02840336348682085,
    "q_offset": -0.05116067663549731,
    "friction_base": 0.05239296084748866,
    "friction_viscous": 0.05908515565091076,
    "model": "m1",
    "actuator": "sts3215",
}
M6 = {
    "kt": 2.2,
    "R": 2.0,
    "armature": 0.026,
    "friction_base": 0.05,
    "friction_stribeck": 0.12,
    "load_friction_motor": 0.2,
    "load_friction_external": 0.02,
    "load_friction_motor_stribeck": 0.1,
    "load_friction_external_stribeck": 0.09,
    "load_friction_motor_quad": 0.01,
    "load_friction_external_quad": 0.001,
    "dtheta_stribeck": 1.7,
    "alpha": 1.14,
    "friction_viscous": 0.05,
    "model": "m6",
    "actuator": "mx106",
}


def written(folder: Path, content: Any, name: str = "servo.json") -> Path:
    file = folder / name
    file.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return file


def parameter_files() -> list[str]:
    assert WHEEL.is_file(), f"{WHEEL} is missing; 'make test' fills .wheels"
    return sorted(name for name in zipfile.ZipFile(WHEEL).namelist() if "/params/" in name)


@pytest.fixture(scope="module")
def bam() -> Iterator[Any]:
    """The package's own module of friction, out of its wheel; its actuators need other packages and are left out."""
    stubs = {"bam.actuators": types.ModuleType("bam.actuators"), "bam.actuator": types.ModuleType("bam.actuator")}
    stubs["bam.actuators"].actuators = {}  # type: ignore[attr-defined]
    stubs["bam.actuator"].Actuator = object  # type: ignore[attr-defined]
    sys.path.insert(0, str(WHEEL))
    sys.modules.update(stubs)
    try:
        import bam.model

        yield bam.model
    finally:
        sys.path.remove(str(WHEEL))
        for name in [name for name in sys.modules if name.partition(".")[0] == "bam"]:
            del sys.modules[name]


def its_model(bam: Any, data: dict[str, Any]) -> Any:
    model = bam.models[data["model"]]()
    model.set_actuator(types.SimpleNamespace(set_model=lambda _: None))
    model.load_parameters_from_dict(data)
    return model


class TestAgainstThePackage:
    """Every file that better-actuator-models 1.0.2 ships, its own friction budget beside ours."""

    @pytest.mark.parametrize("name", parameter_files())
    def test_the_largest_friction_is_the_packages(self, name: str, bam: Any, tmp_path: Path) -> None:
        text = zipfile.ZipFile(WHEEL).read(name).decode()
        data = json.loads(text)
        servo = taut.load_servo(written(tmp_path, text))
        assert (servo.model, servo.name) == (data["model"], data["actuator"])
        theirs = its_model(bam, data)
        if data["model"] == "m6":  # what cannot be said
            theirs.quadratic = False
        ours = FrictionValues.fixed(servo.friction)
        for v in (0.0, 0.03, -0.4, 2.0, -7.0):
            for motor, external in ((0.0, 0.0), (1.5, -1.5), (-2.0, 0.3), (0.4, 0.9), (0.0, -3.0)):
                wanted, damping = theirs.compute_frictions(motor, external, v)
                got = dry_limit(ours, np.array([v]), None, np.array([motor]), np.array([external]))
                assert got[0] == pytest.approx(wanted, rel=SAME)
                assert float(servo.friction.viscous) == damping
        assert servo.rotor_inertia == data["armature"]

    def test_the_terms_of_m6_in_the_square_of_the_load_are_left_out(self, tmp_path: Path) -> None:
        servo = taut.load_servo(written(tmp_path, M6))
        assert servo.notes == ("'load_friction_motor_quad', 'load_friction_external_quad' left out",)


class TestTheFileOfTheSo101:
    def test_it_is_a_friction_a_rotor_and_a_motor(self, tmp_path: Path) -> None:
        file = written(tmp_path, STS3215)
        servo = taut.load_servo(file, voltage=7.4)
        assert float(servo.friction.coulomb) == STS3215["friction_base"]
        assert float(servo.friction.viscous) == STS3215["friction_viscous"]
        assert not servo.friction.falls
        assert not servo.friction.loaded
        assert servo.rotor_inertia == STS3215["armature"]
        assert (servo.torque_constant, servo.resistance) == (STS3215["kt"], STS3215["R"])
        assert (servo.name, servo.model, servo.source) == ("sts3215", "m1", str(file))
        assert servo.notes == ("'q_offset' left out",)

    def test_in_one_line_it_is_in_every_joint(self, tmp_path: Path) -> None:
        arm = taut.load_arm("so101").with_servo(taut.load_servo(written(tmp_path, STS3215)))
        np.testing.assert_array_equal(arm.coulomb, np.full(5, STS3215["friction_base"]))
        np.testing.assert_array_equal(arm.rotor_inertia, np.full(5, STS3215["armature"]))
        M, before = (taut.snapshot(a, arm.home).M for a in (arm, taut.load_arm("so101")))
        np.testing.assert_allclose(M - before, STS3215["armature"] * np.eye(5), atol=1e-12)

    def test_or_in_those_that_are_named(self) -> None:
        servo = Servo(friction=Friction(coulomb=0.1, static=0.3, stribeck=0.2), rotor_inertia=0.01)
        arm = taut.load_arm("planar3").with_joints(coulomb=0.7, static=0.9, viscous=0.2)
        changed = arm.with_servo({"joint2": servo})
        assert changed.friction.static.tolist() == [0.9, 0.3, 0.9]
        assert changed.friction.stribeck.tolist() == [0.0, 0.2, 0.0]
        assert changed.viscous.tolist() == [0.2, 0.0, 0.2]
        assert changed.rotor_inertia.tolist() == [0.0, 0.01, 0.0]
        assert changed.effort.tolist() == arm.effort.tolist()

    def test_a_file_may_lack_the_motor(self, tmp_path: Path) -> None:
        lacking = {name: value for name, value in STS3215.items() if name != "R"}
        servo = taut.load_servo(written(tmp_path, lacking), voltage=24.0)
        assert (servo.resistance, servo.voltage) == (None, 24.0)


BROKEN: list[tuple[str, Any, str]] = [
    ("not JSON", "kt = 1.2", "the file is not JSON: Expecting value: line 1 column 1 (char 0) (line 1)"),
    (
        "cut off",
        '{"kt": 1.2, "R"',
        "the file is not JSON: Expecting ':' delimiter: line 1 column 16 (char 15) (line 1)",
    ),
    ("a list", [1.0, 2.0], "the file is no JSON object; a servo file is one object of numbers by name"),
    ("a number", "3.5", "the file is no JSON object; a servo file is one object of numbers by name"),
    ("nested", "[" * 20000, "the file is larger than 8 kB; a servo file has 1 kB"),
    (
        "digits",
        '{"kt": ' + "1" * 10000 + "}",
        "the file is larger than 8 kB; a servo file has 1 kB",
    ),
    ("huge", json.dumps(STS3215) + " " * 70000, "the file is larger than 8 kB; a servo file has 1 kB"),
    (
        "no model",
        {"kt": 1.0},
        "a servo file names its model of friction, 'm1', 'm2', 'm3', 'm4', 'm5'",
    ),
    (
        "another model",
        STS3215 | {"model": "m7"},
        "a servo file names its model of friction, 'm1', 'm2', 'm3', 'm4', 'm5'",
    ),
    (
        "a model that is a list",
        STS3215 | {"model": ["m1"]},
        "a servo file names its model of friction, 'm1', 'm2', 'm3', 'm4', 'm5'",
    ),
    (
        "a number missing",
        {k: v for k, v in STS3215.items() if k != "armature"},
        "model m1 needs 'armature', which is missing",
    ),
    (
        "a misspelt number",
        STS3215 | {"friction_visc": 0.1},
        "model m1 has no number 'friction_visc'; did you mean 'friction_viscous",
    ),
    (
        "a number of another model",
        STS3215 | {"alpha": 2.0},
        "model m1 has no number 'alpha'; it has 'friction_base', 'friction_visc",
    ),
    ("NaN", STS3215 | {"kt": float("nan")}, "kt must be finite [N m/A]; got nan"),
    ("infinite", STS3215 | {"R": float("inf")}, "R must be finite [ohm]; got inf"),
    (
        "too large",
        '{"model": "m1", "armature": 1e999, "friction_base": 0, "friction_viscous": 0}',
        "armature must be finite [kg m^2]; got inf",
    ),
    ("negative friction", STS3215 | {"friction_base": -0.1}, "friction_base must be >= 0 [N m]; got -0.1"),
    ("negative rotor", STS3215 | {"armature": -0.1}, "armature must be >= 0 [kg m^2]; got -0.1"),
    (
        "four hundred digits",
        '{"model": "m1", "armature": ' + "1" * 400 + ', "friction_base": 0, "friction_viscous": 0}',
        "armature must be finite [kg m^2]; got inf",
    ),
    ("zero", STS3215 | {"R": 0.0}, "R must be > 0 [ohm]; got 0.0"),
    ("no speed of the fall", M6 | {"dtheta_stribeck": 0.0}, "dtheta_stribeck must be > 0 [rad/s]; got 0.0"),
    ("a text", STS3215 | {"kt": "1.2"}, "kt must be one number [N m/A]; got '1.2'"),
    ("a truth value", STS3215 | {"kt": True}, "kt must be one number [N m/A]; got True"),
    ("nothing", STS3215 | {"kt": None}, "kt must be one number [N m/A]; got None"),
    (
        "a list of numbers",
        STS3215 | {"R": list(range(30))},
        "R must be one number [ohm]; got [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0,",
    ),
    ("an offset that is none", STS3215 | {"q_offset": "left"}, "q_offset must be one number; got 'left'"),
    ("a number twice", '{"kt": 1.0, "kt": 2.0, ' + json.dumps(STS3215)[1:], "'kt' is there twice; delete one"),
    ("an actuator that is none", STS3215 | {"actuator": 3}, "actuator must be a text; got 3.0"),
]


class TestBrokenFiles:
    @pytest.mark.parametrize(
        ("content", "message"), [(c, m) for _, c, m in BROKEN], ids=[name for name, _, _ in BROKEN]
    )
    def test_each_is_told_in_a_sentence(self, content: Any, message: str, tmp_path: Path) -> None:
        file = written(tmp_path, content)
        with pytest.raises(ModelError) as told:
            taut.load_servo(file)
        assert str(told.value).startswith(f"{file}: {message}"), str(told.value)

    def test_all_that_is_wrong_is_kept(self, tmp_path: Path) -> None:
        with pytest.raises(ModelError) as told:
            taut.load_servo(written(tmp_path, STS3215 | {"kt": -1.0, "R": "2", "extra": 1.0}))
        assert [problem.attribute for problem in told.value.problems] == ["kt", "R", "extra"]

    def test_files_that_cannot_be_read(self, tmp_path: Path) -> None:
        with refused(FileError):
            taut.load_servo(tmp_path / "none.json")
        with refused(FileError):
            taut.load_servo(tmp_path)
        with refused(FileError):
            taut.load_servo(written(tmp_path, ""))
        file = tmp_path / "latin.json"
        file.write_bytes(b'{"actuator": "\xe9"}')
        with refused(ModelError):
            taut.load_servo(file)

    def test_a_voltage_is_above_zero(self, tmp_path: Path) -> None:
        with refused(RangeError):
            taut.load_servo(written(tmp_path, STS3215), voltage=0.0)


class TestServosThatCannotBe:
    def test_one_servo_has_one_number_of_each(self) -> None:
        with refused(ShapeError):
            Servo(friction=Friction(coulomb=[0.1, 0.2]), rotor_inertia=0.01)
        with refused(UsageError):
            Servo(friction=0.1, rotor_inertia=0.01)  # type: ignore[arg-type]
        with refused(RangeError):
            Servo(friction=Friction(), rotor_inertia=-0.01)
        with refused(RangeError):
            Servo(friction=Friction(), rotor_inertia=0.01, resistance=-2.0)

    def test_joints_that_take_no_servo(self) -> None:
        servo = Servo(friction=Friction(), rotor_inertia=0.01)
        with refused(UnknownNameError):
            taut.load_arm("planar2").with_servo({"joint9": servo})
        with refused(UsageError):
            taut.load_arm("planar2").with_servo(Friction())  # type: ignore[arg-type]
        with refused(UsageError):
            taut.Arm.from_screws(
                [np.eye(4), np.eye(4)], [np.diag([0.1, 0.1, 0.1, 1.0, 1.0, 1.0])], np.array([[0.0, 0, 0, 0, 0, 1]]).T
            ).with_servo(servo)
