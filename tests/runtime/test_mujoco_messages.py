"""Every sentence with which MujocoPlant refuses something; each was read once by somebody."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco_arms import MOTORS, PAIR, cell, idle, pair
from refusals import refused

import taut

ARM = taut.load_arm("planar2")


def is_refused(act: Callable[[], object], kind: type[taut.TautError]) -> None:
    with refused(kind) as caught:
        act()
    assert type(caught.value) is kind


# -------------------------------------------------------------------- arguments


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"friction": "no"}, taut.errors.UsageError),
        ({"limits": True}, taut.errors.UsageError),
        ({"timestep": 0.0}, taut.errors.RangeError),
        ({"timestep": np.nan}, taut.errors.RangeError),
        ({"tool_radius": -1.0}, taut.errors.RangeError),
        ({"tool_length": 0.0}, taut.errors.RangeError),
        ({"scene_at": [0, 0, 0]}, taut.errors.UsageError),
        ({"scene_at": taut.Pose.identity()}, taut.errors.UsageError),
        ({"tool_radius": "a"}, taut.errors.ShapeError),
        ({"adds": ("gravty",)}, taut.errors.UnknownNameError),
        ({"scene": 3}, taut.errors.UsageError),
    ],
)
def test_options_are_checked(options: dict[str, object], kind: type[taut.TautError]) -> None:
    is_refused(lambda: taut.MujocoPlant(ARM, **options), kind)


def test_a_plant_takes_an_arm() -> None:
    is_refused(lambda: taut.MujocoPlant("panda"), taut.errors.UsageError)


def test_a_control_period_that_does_not_fit_is_refused() -> None:
    plant = taut.MujocoPlant(ARM, timestep=0.0004)
    is_refused(lambda: taut.run(idle(ARM), plant, duration=0.1), taut.errors.MatchError)
    plant = taut.MujocoPlant(ARM, timestep=0.01)
    is_refused(lambda: taut.run(idle(ARM), plant, duration=0.1), taut.errors.MatchError)


@pytest.mark.parametrize(
    ("path", "value", "kind"),
    [
        ("plant.payload.mas", 1.0, taut.errors.UnknownNameError),
        ("plant.payload.mass", -1.0, taut.errors.RangeError),
        ("plant.payload.mass", np.nan, taut.errors.RangeError),
        ("plant.payload.com", [0.0, np.inf, 0.0], taut.errors.RangeError),
        ("plant.payload.inertia", [1.0, 1.0, 3.0, 0.0, 0.0, 0.0], taut.errors.RangeError),
        ("plant.friction.viscous", [0.1, -0.1], taut.errors.RangeError),
    ],
)
def test_parameters_are_checked_before_a_run_begins(path: str, value: object, kind: type[taut.TautError]) -> None:
    plant = taut.MujocoPlant(ARM)
    before = dict(plant.parameters)
    is_refused(lambda: plant.set_parameters({path: value}), kind)
    assert plant.parameters == before
    if kind is not taut.errors.UnknownNameError:
        events = [taut.Event(t=1.0, set={path: value})]
        is_refused(lambda: taut.run(idle(ARM), plant, duration=2.0, events=events), kind)
        assert plant.data.time == 0.0


# -------------------------------------------------------------------- scenes


@pytest.mark.parametrize(
    "scene",
    [
        "<geom size='0.1'/> and a text",
        "<geom size='nan'/>",
        "<geom size='0.1' pos='0 inf 0'/>",
        "<geom size='-1'/>",
        "<body>\n<bodi/></body>",
        "<mujoco><option gravity='0 0 0'/></mujoco>",
        "<custom/>",
        "<replicate count='1000000000'><geom size='1'/></replicate>",
        "<asset><mesh name='m' file='m.stl'/></asset>",
        "<asset><texture name='t' type='2d' builtin='flat' width='100000' height='2'/></asset>",
        "<sensor>\n<user dim='1000000000'/></sensor>",
        "<body name='cup'><geom/></body>\n<equality>\n<weld body1='payload' body2='cop'/></equality>",
        "<actuator><motor name='m' joint='door'/></actuator>",
        "<asset><mesh name='m' builtin='sphere' params='50'/></asset>",
        "<body name='link1'><geom size='1'/></body>",
        "<!DOCTYPE x [<!ENTITY a 'b'>]><geom size='1'/>",
        "<geom size='1'",
    ],
)
def test_scenes_are_checked(scene: str) -> None:
    is_refused(lambda: taut.MujocoPlant(ARM, scene=scene), taut.errors.ModelError)


def test_a_scene_file_cannot_reach_out_of_its_folder(tmp_path: Path) -> None:
    secret = tmp_path / "secret.stl"
    secret.write_text("solid")
    inside = tmp_path / "scene"
    inside.mkdir()
    (inside / "link.stl").symlink_to(secret)
    file = inside / "scene.xml"
    for name in (
        "../secret.stl",
        str(secret),
        "link.stl",
        "file://x.stl",
        "missing.stl",
    ):
        file.write_text(f'<mujoco>\n<asset>\n<mesh name="m" file="{name}"/></asset></mujoco>')
        is_refused(lambda: taut.MujocoPlant(ARM, scene=file), taut.errors.ModelError)
    file.write_text(
        f'<mujoco><compiler meshdir="{tmp_path}"/><asset><mesh name="m" file="secret.stl"/></asset></mujoco>'
    )
    is_refused(lambda: taut.MujocoPlant(ARM, scene=file), taut.errors.ModelError)


def test_a_scene_that_is_no_file_is_refused(tmp_path: Path) -> None:
    is_refused(lambda: taut.MujocoPlant(ARM, scene=tmp_path), taut.errors.FileError)
    is_refused(lambda: taut.MujocoPlant(ARM, scene="nowhere.xml"), taut.errors.FileError)


# -------------------------------------------------------------------- attach


@pytest.fixture
def arm(tmp_path: Path) -> taut.Arm:
    return pair(tmp_path)


def attach(text: str, arm: taut.Arm, prefix: str = "left_") -> taut.MujocoPlant:
    model = mujoco.MjModel.from_xml_string(text)
    return taut.MujocoPlant.attach(model, mujoco.MjData(model), arm, prefix)


def test_attach_takes_a_model_its_data_and_an_arm(arm: taut.Arm) -> None:
    model, other = (mujoco.MjModel.from_xml_string(text) for text in (cell(), "<mujoco/>"))
    data, call = mujoco.MjData(model), taut.MujocoPlant.attach
    is_refused(lambda: call("m", data, arm), taut.errors.UsageError)
    for arguments in ((model, model, arm), (model, data, None), (model, data, arm, 1)):
        is_refused(lambda given=arguments: call(*given), taut.errors.UsageError)
    is_refused(lambda: call(other, data, arm), taut.errors.MatchError)


def test_joints_are_found_by_name_or_the_nearest_are_named(arm: taut.Arm) -> None:
    text = cell(left=PAIR.format("left_", 1).replace("left_elbow", "left_elbov"), actuators="")
    is_refused(lambda: attach(text, arm), taut.errors.UnknownNameError)


@pytest.mark.parametrize(
    ("old", "new", "kind"),
    [
        ('name="left_elbow"', 'name="left_elbow" type="slide"', taut.errors.MatchError),
        (
            '<joint name="left_elbow"',
            '<joint name="left_twist" axis="1 0 0"/><joint name="left_elbow"',
            taut.errors.MatchError,
        ),
        ('mass="2"', 'mass="2.1"', taut.errors.MatchError),
        ('mass="1" pos="0.1 0 0"', 'mass="1" pos="0.12 0 0"', taut.errors.MatchError),
        ("0.01 0.03 0.03 0.001", "0.01 0.034 0.03 0.001", taut.errors.MatchError),
        ('armature="0.02"', 'armature="0.2"', taut.errors.MatchError),
        ('axis="0 1 0"', 'axis="0 -1 0"', taut.errors.MatchError),
        ('pos="1 0 0.6"', 'pos="1 0.5 0.6" euler="0 0 90"', taut.errors.MatchError),
    ],
)
def test_another_arm_is_refused_with_numbers(arm: taut.Arm, old: str, new: str, kind: type[taut.TautError]) -> None:
    text = PAIR.format("left_", 1)
    assert old in text
    is_refused(lambda: attach(cell(left=text.replace(old, new, 1)), arm), kind)


def test_an_arm_on_something_that_moves_is_refused(arm: taut.Arm) -> None:
    cart = f'<body name="cart"><freejoint name="cart"/><geom size="0.1"/>{PAIR.format("left_", 1)}</body>'
    is_refused(lambda: attach(cell(left=cart), arm), taut.errors.MatchError)


def test_another_gravity_is_refused(arm: taut.Arm) -> None:
    is_refused(lambda: attach(cell(), arm.with_gravity((0, 0, -1.62))), taut.errors.MatchError)


A = '<general name="a" joint="left_shoulder" gear="5" gainprm="3"/>'


@pytest.mark.parametrize(
    "actuator",
    [
        '<position name="p" joint="left_shoulder" kp="50" kv="2"/>',
        '<general name="p" joint="left_shoulder" dyntype="filter" dynprm="0.1"/>',
        '<motor name="p" joint="left_shoulder" delay="0.01" nsample="20"/>',
        '<general name="p" joint="left_shoulder" gainprm="0"/>',
        A + '<motor name="p" joint="left_shoulder"/>',
    ],
)
def test_actuators_that_take_no_torque_are_refused(arm: taut.Arm, actuator: str) -> None:
    is_refused(lambda: attach(cell(MOTORS.replace(A, actuator)), arm), taut.errors.MatchError)


@pytest.mark.parametrize(("field", "body"), [("body_mass", "left_fore"), ("body_ipos", "left_upper")])
def test_an_arm_whose_model_is_not_finite_is_another_arm(arm: taut.Arm, field: str, body: str) -> None:
    model = mujoco.MjModel.from_xml_string(cell())
    getattr(model, field)[model.body(body).id] = np.nan
    is_refused(lambda: taut.MujocoPlant.attach(model, mujoco.MjData(model), arm, "left_"), taut.errors.MatchError)


def test_a_scene_that_is_not_finite_ends_the_run(arm: taut.Arm) -> None:
    plant = attach(cell(), arm)
    plant.data.qpos[plant.model.joint("box").qposadr[0]] = np.nan
    assert taut.run(idle(arm), plant, duration=0.1).outcome.kind == "diverged"


def test_gravcomp_on_a_part_of_the_arm_is_refused(arm: taut.Arm) -> None:
    text = PAIR.format("left_", 1).replace('name="left_upper"', 'name="left_upper" gravcomp="1"')
    is_refused(lambda: attach(cell(left=text), arm), taut.errors.MatchError)


def test_an_attached_arm_has_no_parameters(arm: taut.Arm) -> None:
    plant = attach(cell(), arm)
    assert not plant.parameters
    events = [taut.Event(t=0.0, set={"plant.payload.mass": 1.0})]
    is_refused(lambda: taut.run(idle(arm), plant, duration=0.1, events=events), taut.errors.UnknownNameError)
