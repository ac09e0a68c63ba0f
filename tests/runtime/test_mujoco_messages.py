"""Every sentence with which MujocoPlant refuses something; each was read once by somebody."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco_arms import MOTORS, PAIR, cell, idle, pair

import taut

ARM = taut.load_arm("planar2")


def said(act: Callable[[], object], kind: type[taut.TautError]) -> str:
    with pytest.raises(kind) as caught:
        act()
    assert type(caught.value) is kind
    return str(caught.value)


# -------------------------------------------------------------------- arguments


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"friction": "no"}, taut.errors.UsageError, "friction must be 'arm' or None; got 'no'"),
        ({"limits": True}, taut.errors.UsageError, "limits must be 'arm' or None; got True"),
        ({"timestep": 0.0}, taut.errors.RangeError, "timestep must be > 0 [s]; got 0.0"),
        ({"timestep": np.nan}, taut.errors.RangeError, "timestep must be finite [s]; got nan"),
        ({"tool_radius": -1.0}, taut.errors.RangeError, "tool_radius must be > 0 [m]; got -1.0"),
        ({"tool_length": 0.0}, taut.errors.RangeError, "tool_length must be > 0 [m]; got 0.0"),
        ({"scene_at": [0, 0, 0]}, taut.errors.UsageError, "scene_at must be a taut.Pose; got list"),
        (
            {"scene_at": taut.Pose.identity()},
            taut.errors.UsageError,
            "scene_at says where the scene stands, and there is none; give scene=",
        ),
        ({"tool_radius": "a"}, taut.errors.ShapeError, "tool_radius must be one number [m]; got 'a'"),
        (
            {"adds": ("gravty",)},
            taut.errors.UnknownNameError,
            "what a plant adds has no component 'gravty'; did you mean 'gravity'?",
        ),
        (
            {"scene": 3},
            taut.errors.UsageError,
            "scene must be an MJCF fragment as text, or the path of one; got int",
        ),
    ],
)
def test_options_are_checked(options: dict[str, object], kind: type[taut.TautError], words: str) -> None:
    assert said(lambda: taut.MujocoPlant(ARM, **options), kind) == words


def test_a_plant_takes_an_arm() -> None:
    words = "arm must be an Arm; got 'panda'"
    assert said(lambda: taut.MujocoPlant("panda"), taut.errors.UsageError) == words


def test_a_control_period_that_does_not_fit_is_refused() -> None:
    words = (
        "plant 'MujocoPlant(planar2)': the control period must be a whole number of time steps; 0.001 s is 2.5 times "
        "0.0004 s; use timestep=0.000333333333, or another rate"
    )
    plant = taut.MujocoPlant(ARM, timestep=0.0004)
    assert said(lambda: taut.run(idle(ARM), plant, duration=0.1), taut.errors.MatchError) == words
    plant = taut.MujocoPlant(ARM, timestep=0.01)
    assert "0.001 s is 0.1 times 0.01 s; use timestep=0.001" in said(
        lambda: taut.run(idle(ARM), plant, duration=0.1), taut.errors.MatchError
    )


@pytest.mark.parametrize(
    ("path", "value", "kind", "words"),
    [
        (
            "plant.payload.mas",
            1.0,
            taut.errors.UnknownNameError,
            "plant 'MujocoPlant(planar2)' has no parameter 'plant.payload.mas'; did you mean 'plant.payload.mass' or "
            "'plant.payload.com'?",
        ),
        ("plant.payload.mass", -1.0, taut.errors.RangeError, "plant.payload.mass must be >= 0 [kg]; got -1.0"),
        ("plant.payload.mass", np.nan, taut.errors.RangeError, "plant.payload.mass must be finite [kg]; got nan"),
        (
            "plant.payload.com",
            [0.0, np.inf, 0.0],
            taut.errors.RangeError,
            "plant.payload.com[1] must be finite [m]; got inf",
        ),
        (
            "plant.payload.inertia",
            [1.0, 1.0, 3.0, 0.0, 0.0, 0.0],
            taut.errors.RangeError,
            "payload.inertia violates the triangle inequality: principal moments 3 > 1 + 1 [kg m^2]; it is about the "
            "centre of mass, in the order xx, yy, zz, xy, xz, yz",
        ),
        (
            "plant.friction.viscous",
            [0.1, -0.1],
            taut.errors.RangeError,
            "plant.friction.viscous[1] (joint 'joint2') must be >= 0; got -0.1",
        ),
    ],
)
def test_parameters_are_checked_before_a_run_begins(
    path: str, value: object, kind: type[taut.TautError], words: str
) -> None:
    plant = taut.MujocoPlant(ARM)
    before = dict(plant.parameters)
    assert said(lambda: plant.set_parameters({path: value}), kind) == words
    assert plant.parameters == before
    if kind is not taut.errors.UnknownNameError:
        events = [taut.Event(t=1.0, set={path: value})]
        said(lambda: taut.run(idle(ARM), plant, duration=2.0, events=events), kind)
        assert plant.data.time == 0.0


# -------------------------------------------------------------------- scenes


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (
            "<geom size='0.1'/> and a text",
            "scene: <mujoco>: a scene is made of MJCF elements, such as <geom .../>; got the text 'and a text' outside of "
            "them (line 1)",
        ),
        ("<geom size='nan'/>", "scene: <geom>: size must be finite; got 'nan' (line 1)"),
        ("<geom size='0.1' pos='0 inf 0'/>", "scene: <geom>: pos must be finite; got '0 inf 0' (line 1)"),
        (
            "<geom size='-1'/>",
            "scene: <geom>: MuJoCo refuses it: size 0 must be positive in geom (line 1)",
        ),
        (
            "<body>\n<bodi/></body>",
            "scene: <bodi>: MuJoCo refuses it: unrecognized element (line 2)",
        ),
        (
            "<mujoco><option gravity='0 0 0'/></mujoco>",
            "scene: <option>: a scene has no <option>: the options are the plant's: gravity is the arm's, timestep and "
            "integrator are its arguments (line 1)",
        ),
        (
            "<custom/>",
            "scene: <custom>: a scene has no <custom>; its parts are actuator, asset, compiler, contact, default, "
            "equality, sensor, tendon, visual, worldbody (line 1)",
        ),
        (
            "<replicate count='1000000000'><geom size='1'/></replicate>",
            "scene: <replicate>: a scene has no <replicate>: write the copies out (line 1)",
        ),
        (
            "<asset><mesh name='m' file='m.stl'/></asset>",
            "scene: mesh 'm': the file 'm.stl' is not read: it is named in a text, which has no folder; save the scene "
            "beside its files (line 1)",
        ),
        (
            "<asset><texture name='t' type='2d' builtin='flat' width='100000' height='2'/></asset>",
            "scene: texture 't': width must be whole numbers up to 4096; got '100000' (line 1)",
        ),
        (
            "<sensor>\n<user dim='1000000000'/></sensor>",
            "scene: <user>: dim must be whole numbers up to 4096; got '1000000000' (line 2)",
        ),
        (
            "<body name='cup'><geom/></body>\n<equality>\n<weld body1='payload' body2='cop'/></equality>",
            "scene: <weld>: it refers to something that neither the scene nor the arm has; it names 'payload', 'cop' "
            "(line 3)",
        ),
        (
            "<actuator><motor name='m' joint='door'/></actuator>",
            "scene: motor 'm': it refers to something that neither the scene nor the arm has; it names 'door' (line 1)",
        ),
        (
            "<asset><mesh name='m' builtin='sphere' params='50'/></asset>",
            "scene: mesh 'm': a mesh that MuJoCo makes itself is not read; use a geom of that shape (line 1)",
        ),
        (
            "<body name='link1'><geom size='1'/></body>",
            "scene: body 'link1': MuJoCo refuses it: repeated name 'link1' in body (line 1)",
        ),
        (
            "<!DOCTYPE x [<!ENTITY a 'b'>]><geom size='1'/>",
            "scene: it has a DOCTYPE, which can declare entities; a robot model needs none: delete it (line 1)",
        ),
        (
            "<geom size='1'",
            "scene: the XML is damaged inside <mujoco>: not well-formed (invalid token) (line 1)",
        ),
    ],
)
def test_scenes_are_checked(scene: str, words: str) -> None:
    got = said(lambda: taut.MujocoPlant(ARM, scene=scene), taut.errors.ModelError)
    assert got == words


def test_a_scene_file_cannot_reach_out_of_its_folder(tmp_path: Path) -> None:
    secret = tmp_path / "secret.stl"
    secret.write_text("solid")
    inside = tmp_path / "scene"
    inside.mkdir()
    (inside / "link.stl").symlink_to(secret)
    file = inside / "scene.xml"
    for name, reason in (
        ("../secret.stl", "leads out of the model's folder"),
        (str(secret), "leads out of the model's folder"),
        ("link.stl", "is a link that leads out of the model's folder"),
        ("file://x.stl", "is an address or an odd name, not a plain relative path"),
        ("missing.stl", "is not there"),
    ):
        file.write_text(f'<mujoco>\n<asset>\n<mesh name="m" file="{name}"/></asset></mujoco>')
        got = said(lambda: taut.MujocoPlant(ARM, scene=file), taut.errors.ModelError)
        assert got == f"{file}: mesh 'm': the file '{name}' is not read: it {reason} (line 3)"
    file.write_text(
        f'<mujoco><compiler meshdir="{tmp_path}"/><asset><mesh name="m" file="secret.stl"/></asset></mujoco>'
    )
    assert "leads out of the model's folder" in said(
        lambda: taut.MujocoPlant(ARM, scene=file), taut.errors.ModelError
    )


def test_a_scene_that_is_no_file_is_refused(tmp_path: Path) -> None:
    assert "is a folder; name a file in it" in said(
        lambda: taut.MujocoPlant(ARM, scene=tmp_path), taut.errors.FileError
    )
    assert "does not exist" in said(lambda: taut.MujocoPlant(ARM, scene="nowhere.xml"), taut.errors.FileError)


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
    words = "model must be of type MjModel; got str"
    assert said(lambda: call("m", data, arm), taut.errors.UsageError) == words
    for arguments in ((model, model, arm), (model, data, None), (model, data, arm, 1)):
        said(lambda given=arguments: call(*given), taut.errors.UsageError)
    words = "data must be made from this very model: mujoco.MjData(model); it is another's"
    assert said(lambda: call(other, data, arm), taut.errors.MatchError) == words


def test_joints_are_found_by_name_or_the_nearest_are_named(arm: taut.Arm) -> None:
    text = cell(left=PAIR.format("left_", 1).replace("left_elbow", "left_elbov"), actuators="")
    words = (
        "the model has no joint 'left_elbow'; did you mean 'left_elbov' or 'right_elbow'? (arm 'pair' has it; "
        "prefix='left_')"
    )
    assert said(lambda: attach(text, arm), taut.errors.UnknownNameError) == words


@pytest.mark.parametrize(
    ("old", "new", "kind", "words"),
    [
        (
            'name="left_elbow"',
            'name="left_elbow" type="slide"',
            taut.errors.MatchError,
            "joint 'left_elbow' is continuous in arm 'pair' and of type slide in the model; attach the arm that the "
            "model has",
        ),
        (
            '<joint name="left_elbow"',
            '<joint name="left_twist" axis="1 0 0"/><joint name="left_elbow"',
            taut.errors.MatchError,
            "joint 'left_twist' of the model moves joint 'elbow', and arm 'pair' has no such joint there; attach an arm "
            "that has it, or take the joint out of the model",
        ),
        (
            'mass="2"',
            'mass="2.1"',
            taut.errors.MatchError,
            "joint 'shoulder': the inertia of what it moves is 0.501984 in the model and 0.497974 in arm 'pair' "
            "[kg m^2 | kg], at q = [0.2, 0.4]; load the Arm from the model's own file, with the payload and the rotors "
            "that it has there",
        ),
        (
            'mass="1" pos="0.1 0 0"',
            'mass="1" pos="0.12 0 0"',
            taut.errors.MatchError,
            "joint 'elbow': the inertia of what it moves",
        ),
        (
            "0.01 0.03 0.03 0.001",
            "0.01 0.034 0.03 0.001",
            taut.errors.MatchError,
            "joint 'shoulder': the inertia of what it moves",
        ),
        (
            'armature="0.02"',
            'armature="0.2"',
            taut.errors.MatchError,
            "joint 'shoulder': the inertia of what it moves",
        ),
        (
            'axis="0 1 0"',
            'axis="0 -1 0"',
            taut.errors.MatchError,
            "joint 'shoulder' at the home pose has its axis at [1, 0, 0.6] along [0, -1, 0] in the model and at "
            "[1, 0, 0.6] along [0, 1, 0] in arm 'pair' (world, m): another arm, another zero of a joint, or another "
            "base; load the Arm from the model's own file, and put it where it stands: arm.mounted(taut.Pose(...))",
        ),
        (
            'pos="1 0 0.6"',
            'pos="1 0.5 0.6" euler="0 0 90"',
            taut.errors.MatchError,
            "joint 'shoulder' at the home pose has its axis at [1, 0.5, 0.6]",
        ),
    ],
)
def test_another_arm_is_refused_with_numbers(
    arm: taut.Arm, old: str, new: str, kind: type[taut.TautError], words: str
) -> None:
    text = PAIR.format("left_", 1)
    assert old in text
    got = said(lambda: attach(cell(left=text.replace(old, new, 1)), arm), kind)
    assert got.startswith(words)


def test_an_arm_on_something_that_moves_is_refused(arm: taut.Arm) -> None:
    cart = f'<body name="cart"><freejoint name="cart"/><geom size="0.1"/>{PAIR.format("left_", 1)}</body>'
    words = (
        "joint 'cart' of the model moves joint 'shoulder', and arm 'pair' has no such joint there; attach an arm that "
        "has it, or take the joint out of the model"
    )
    assert said(lambda: attach(cell(left=cart), arm), taut.errors.MatchError) == words


def test_another_gravity_is_refused(arm: taut.Arm) -> None:
    words = (
        "gravity is [0, 0, -9.81] in the model and [0, 0, -1.62] m/s^2 for arm 'pair'; use "
        "arm.with_gravity(model.opt.gravity)"
    )
    assert said(lambda: attach(cell(), arm.with_gravity((0, 0, -1.62))), taut.errors.MatchError) == words


A = '<general name="a" joint="left_shoulder" gear="5" gainprm="3"/>'


NO_MOTOR = (
    "actuator 'p' of joint 'shoulder' is not a motor, whose torque is its control times a constant, so that no torque "
    "command can be sent through it; make it one: spec.actuator('p').set_to_motor() of its mujoco.MjSpec"
)


@pytest.mark.parametrize(
    ("actuator", "words"),
    [
        ('<position name="p" joint="left_shoulder" kp="50" kv="2"/>', NO_MOTOR),
        ('<general name="p" joint="left_shoulder" dyntype="filter" dynprm="0.1"/>', NO_MOTOR),
        ('<motor name="p" joint="left_shoulder" delay="0.01" nsample="20"/>', NO_MOTOR),
        ('<general name="p" joint="left_shoulder" gainprm="0"/>', NO_MOTOR),
        (
            A + '<motor name="p" joint="left_shoulder"/>',
            "joint 'shoulder' has two actuators, the second 'p'; keep one",
        ),
    ],
)
def test_actuators_that_take_no_torque_are_refused(arm: taut.Arm, actuator: str, words: str) -> None:
    assert said(lambda: attach(cell(MOTORS.replace(A, actuator)), arm), taut.errors.MatchError) == words


@pytest.mark.parametrize(("field", "body"), [("body_mass", "left_fore"), ("body_ipos", "left_upper")])
def test_an_arm_whose_model_is_not_finite_is_another_arm(arm: taut.Arm, field: str, body: str) -> None:
    model = mujoco.MjModel.from_xml_string(cell())
    getattr(model, field)[model.body(body).id] = np.nan
    assert "of what it moves is nan" in said(
        lambda: taut.MujocoPlant.attach(model, mujoco.MjData(model), arm, "left_"), taut.errors.MatchError
    )


def test_a_scene_that_is_not_finite_ends_the_run(arm: taut.Arm) -> None:
    plant = attach(cell(), arm)
    plant.data.qpos[plant.model.joint("box").qposadr[0]] = np.nan
    assert taut.run(idle(arm), plant, duration=0.1).outcome.kind == "diverged"


def test_gravcomp_on_a_part_of_the_arm_is_refused(arm: taut.Arm) -> None:
    text = PAIR.format("left_", 1).replace('name="left_upper"', 'name="left_upper" gravcomp="1"')
    words = (
        "gravcomp must be 0 or 1, the same for all bodies of an arm; got [0.0, 1.0]; set all of model.body_gravcomp "
        "alike"
    )
    assert said(lambda: attach(cell(left=text), arm), taut.errors.MatchError) == words


def test_an_attached_arm_has_no_parameters(arm: taut.Arm) -> None:
    plant = attach(cell(), arm)
    assert not plant.parameters
    events = [taut.Event(t=0.0, set={"plant.payload.mass": 1.0})]
    assert "no parameter 'plant.payload.mass'" in said(
        lambda: taut.run(idle(arm), plant, duration=0.1, events=events), taut.errors.UnknownNameError
    )
