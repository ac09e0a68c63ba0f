"""Broken MJCF files, each with what must be said about it: object, attribute, line, and the whole message."""

from __future__ import annotations

from arm_models import PAIR, Case

INERTIAL = '<inertial mass="2" pos="0.2 0 0" diaginertia="0.01 0.03 0.03"/>'
SHOULDER = '<joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.1"/>'
MOTOR = '<motor name="shoulder_motor" joint="shoulder" forcerange="-40 40"/>'
SHELL_ASSET = """\
  <asset>
    <mesh name="shell" file="shell.stl"/>
  </asset>
  <worldbody>"""


CASES: list[Case] = [
    Case(
        title="a negative mass",
        old='mass="2"',
        new='mass="-2"',
        problems=[
            (
                "upper",
                "body",
                4,
                "body 'upper': MuJoCo refuses it: mass and inertia of moving bodies must be larger than mjMINVAL",
            ),
        ],
    ),
    Case(
        title="a mass that is NaN",
        old='mass="2"',
        new='mass="nan"',
        problems=[
            ("upper", "mass", 5, "body 'upper': mass of <inertial> must be finite; got 'nan'"),
        ],
    ),
    Case(
        title="a mass in words",
        old='mass="2"',
        new='mass="heavy"',
        problems=[
            ("inertial", "mass", 5, "<inertial>: MuJoCo refuses it: bad format in attribute 'mass'"),
        ],
    ),
    Case(
        title="no mass",
        old='mass="2" ',
        new="",
        problems=[
            ("inertial", "inertial", 5, "<inertial>: MuJoCo refuses it: required attribute missing: 'mass'"),
        ],
    ),
    Case(
        title="no place of the mass",
        old=' pos="0.2 0 0" diaginertia',
        new=" diaginertia",
        problems=[
            ("inertial", "inertial", 5, "<inertial>: MuJoCo refuses it: required attribute missing: 'pos'"),
        ],
    ),
    Case(
        title="no inertia",
        old=' diaginertia="0.01 0.03 0.03"',
        new="",
        problems=[
            (
                "upper",
                "body",
                4,
                "body 'upper': MuJoCo refuses it: mass and inertia of moving bodies must be larger than mjMINVAL",
            ),
        ],
    ),
    Case(
        title="a broken triangle inequality",
        old='diaginertia="0.01 0.03 0.03"',
        new='diaginertia="0.9 0.1 0.2"',
        problems=[
            (
                "upper",
                "body",
                4,
                "body 'upper': MuJoCo refuses it: inertia must satisfy A + B >= C; use 'balanceinertia' to fix",
            ),
        ],
    ),
    Case(
        title="a negative moment",
        old='diaginertia="0.01 0.03 0.03"',
        new='diaginertia="-0.01 0.03 0.03"',
        problems=[
            (
                "upper",
                "body",
                4,
                "body 'upper': MuJoCo refuses it: mass and inertia of moving bodies must be larger than mjMINVAL",
            ),
        ],
    ),
    Case(
        title="products of inertia that no body has",
        old='diaginertia="0.01 0.03 0.03"',
        new='fullinertia="0.01 0.03 0.03 0.1 0 0"',
        problems=[
            (
                "upper",
                "body",
                4,
                "body 'upper': MuJoCo refuses it: error 'inertia must have positive eigenvalues' in fullinertia",
            ),
        ],
    ),
    Case(
        title="two moments",
        old='diaginertia="0.01 0.03 0.03"',
        new='diaginertia="0.01 0.03"',
        problems=[
            (
                "inertial",
                "diaginertia",
                5,
                "<inertial>: MuJoCo refuses it: attribute 'diaginertia' does not have enough data",
            ),
        ],
    ),
    Case(
        title="a body that moves and has no mass",
        old='<inertial mass="2" pos="0.2 0 0" diaginertia="0.01 0.03 0.03"/>\n      <joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.1"/>\n      <geom name="shell" type="box" size="0.2 0.03 0.03" pos="0.2 0 0"/>',
        new='<joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.1"/>',
        problems=[
            (
                "upper",
                "body",
                4,
                "body 'upper': MuJoCo refuses it: mass and inertia of moving bodies must be larger than mjMINVAL",
            ),
        ],
    ),
    Case(
        title="a mass of zero",
        old='mass="2"',
        new='mass="0"',
        problems=[
            (
                "upper",
                "body",
                4,
                "body 'upper': MuJoCo refuses it: mass and inertia of moving bodies must be larger than mjMINVAL",
            ),
        ],
    ),
    Case(
        title="a place with two numbers",
        old='pos="0 0 0.3"',
        new='pos="0 0.3"',
        problems=[
            ("upper", "pos", 4, "body 'upper': MuJoCo refuses it: attribute 'pos' does not have enough data"),
        ],
    ),
    Case(
        title="a place that is NaN",
        old='pos="0 0 0.3"',
        new='pos="0 0 nan"',
        problems=[
            ("upper", "pos", 4, "body 'upper': pos of <body> must be finite; got '0 0 nan'"),
        ],
    ),
    Case(
        title="a quaternion of zero",
        old='pos="0 0 0.3"',
        new='pos="0 0 0.3" quat="0 0 0 0"',
        problems=[
            ("upper", "body", 4, "body 'upper': MuJoCo refuses it: zero quaternion is not allowed"),
        ],
    ),
    Case(
        title="an axis of zero",
        old='axis="0 1 0" range',
        new='axis="0 0 0" range',
        problems=[
            ("shoulder", "joint", 6, "joint 'shoulder': MuJoCo refuses it: axis too small in joint"),
        ],
    ),
    Case(
        title="an axis that is infinite",
        old='axis="0 1 0" range',
        new='axis="0 inf 0" range',
        problems=[
            ("shoulder", "axis", 6, "joint 'shoulder': axis of <joint> must be finite; got '0 inf 0'"),
        ],
    ),
    Case(
        title="limits in the wrong order",
        old='range="-2 2"',
        new='range="2 -2"',
        problems=[
            (
                "shoulder",
                "range",
                6,
                "joint 'shoulder': range of <joint> must go from low to high; got 2 to -2; swap them",
            ),
        ],
    ),
    Case(
        title="one limit",
        old='range="-2 2"',
        new='range="-2"',
        problems=[
            (
                "shoulder",
                "range",
                6,
                "joint 'shoulder': MuJoCo refuses it: attribute 'range' does not have enough data",
            ),
        ],
    ),
    Case(
        title="a limit without range",
        old=' range="-2 2"',
        new=' limited="true"',
        problems=[
            (
                "shoulder",
                "joint",
                6,
                "joint 'shoulder': MuJoCo refuses it: range[0] should be smaller than range[1] in joint",
            ),
        ],
    ),
    Case(
        title="a negative damping",
        old='damping="0.1"',
        new='damping="-0.1"',
        problems=[
            ("shoulder", "damping", 6, "joint 'shoulder': damping must be finite and >= 0; got -0.1"),
        ],
    ),
    Case(
        title="a negative rotor inertia",
        old='damping="0.1"',
        new='armature="-0.1"',
        problems=[
            ("shoulder", "armature", 6, "joint 'shoulder': rotor inertia must be finite and >= 0; got -0.1"),
        ],
    ),
    Case(
        title="a negative friction",
        old='damping="0.1"',
        new='frictionloss="-1"',
        problems=[
            ("shoulder", "friction", 6, "joint 'shoulder': friction must be finite and >= 0; got -1"),
        ],
    ),
    Case(
        title="a misspelt attribute",
        old='damping="0.1"',
        new='dampning="0.1"',
        problems=[
            ("shoulder", "dampning", 6, "joint 'shoulder': MuJoCo refuses it: unrecognized attribute: 'dampning'"),
        ],
    ),
    Case(
        title="an unknown element",
        old='<joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.1"/>',
        new='<hinge name="shoulder"/>',
        problems=[
            ("shoulder", "hinge", 6, "hinge 'shoulder': MuJoCo refuses it: unrecognized element"),
        ],
    ),
    Case(
        title="an unknown joint type",
        old='name="shoulder" axis',
        new='name="shoulder" type="rotary" axis',
        problems=[
            ("shoulder", "type", 6, "joint 'shoulder': MuJoCo refuses it: invalid keyword: 'rotary'"),
        ],
    ),
    Case(
        title="an unknown class",
        old='name="shoulder" axis',
        new='name="shoulder" class="big" axis',
        problems=[
            ("shoulder", "class", 6, "joint 'shoulder': MuJoCo refuses it: unknown default class name 'big'"),
        ],
    ),
    Case(
        title="a free joint",
        old='<joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.1"/>',
        new='<freejoint name="shoulder"/>',
        problems=[
            (
                "shoulder",
                "type",
                6,
                "joint 'shoulder': a floating joint is not one of an arm; make it fixed, cut the model there, or hold it still: load_arm(..., locked={'shoulder': 0.0})",
            ),
        ],
    ),
    Case(
        title="a ball joint",
        old='name="shoulder" axis="0 1 0" range="-2 2"',
        new='name="shoulder" type="ball"',
        problems=[
            (
                "shoulder",
                "type",
                6,
                "joint 'shoulder': a ball joint is not one of an arm; write it as three hinges, or hold it still: load_arm(..., locked={'shoulder': 0.0})",
            ),
        ],
    ),
    Case(
        title="two joints on one body",
        old='<joint name="elbow" axis="0 1 0"/>',
        new='<joint name="elbow" axis="0 1 0"/>\n        <joint name="twist" axis="1 0 0"/>',
        problems=[
            (
                "fore",
                "joint",
                8,
                "body 'fore' has several joints that move, and taut has a body for each joint: write one body for each joint, inside one another, each with its own <inertial>, or hold all but one of them still: load_arm(..., locked={'elbow': 0.0})",
            ),
        ],
    ),
    Case(
        title="two joints of one name",
        old='joint name="elbow"',
        new='joint name="shoulder"',
        problems=[
            ("shoulder", "name", 10, "joint 'shoulder': MuJoCo refuses it: repeated name 'shoulder' in joint"),
        ],
    ),
    Case(
        title="two bodies of one name",
        old='body name="fore"',
        new='body name="upper"',
        problems=[
            ("upper", "name", 8, "body 'upper': MuJoCo refuses it: repeated name 'upper' in body"),
        ],
    ),
    Case(
        title="an actuator of an unknown joint",
        old='joint="shoulder" force',
        new='joint="sholder" force',
        problems=[
            (
                "shoulder_motor",
                "joint",
                16,
                "motor 'shoulder_motor': MuJoCo refuses it: unknown transmission target 'sholder' for actuator id = 0",
            ),
        ],
    ),
    Case(
        title="a force range in the wrong order",
        old='forcerange="-40 40"',
        new='forcerange="40 -40"',
        problems=[
            (
                "shoulder_motor",
                "forcerange",
                16,
                "motor 'shoulder_motor': forcerange of <motor> must go from low to high; got 40 to -40; swap them",
            ),
        ],
    ),
    Case(
        title="a motor without force",
        old='forcerange="-40 40"',
        new='forcerange="0 0" forcelimited="true"',
        problems=[
            (
                "shoulder_motor",
                "motor",
                16,
                "motor 'shoulder_motor': MuJoCo refuses it: invalid force range for actuator",
            ),
        ],
    ),
    Case(
        title="a joint coupling",
        old="</mujoco>",
        new='  <equality>\n    <joint joint1="elbow" joint2="shoulder"/>\n  </equality>\n</mujoco>',
        problems=[
            (
                "elbow",
                "mimic",
                10,
                "joint 'elbow': it mimics 'shoulder', and taut has no coupled joints; make it fixed, or hold it still: load_arm(..., locked={'elbow': 0.0})",
            ),
        ],
    ),
    Case(
        title="a coupling to a constant",
        old="</mujoco>",
        new='  <equality>\n    <joint joint1="elbow"/>\n  </equality>\n</mujoco>',
        problems=[
            (
                "elbow",
                "mimic",
                10,
                "joint 'elbow': a coupling holds it, and taut has no coupled joints; make it fixed, or hold it still: load_arm(..., locked={'elbow': 0.0})",
            ),
        ],
    ),
    Case(
        title="a closed loop",
        old="</mujoco>",
        new='  <equality>\n    <connect name="pin" body1="fore" anchor="0 0 0"/>\n  </equality>\n</mujoco>',
        problems=[
            (
                "pin",
                "connect",
                19,
                "equality 'pin' of type connect closes a loop, and an arm is a tree: take it out and state the closure as a constraint",
            ),
        ],
    ),
    Case(
        title="a weld",
        old="</mujoco>",
        new='  <equality>\n    <weld body1="fore" body2="upper"/>\n  </equality>\n</mujoco>',
        problems=[
            (
                "equality",
                "weld",
                19,
                "an equality of type weld closes a loop, and an arm is a tree: take it out and state the closure as a constraint",
            ),
        ],
    ),
    Case(
        title="a key frame of another size",
        old="</mujoco>",
        new='  <keyframe>\n    <key name="home" qpos="0 0 0"/>\n  </keyframe>\n</mujoco>',
        problems=[
            (
                "home",
                "name",
                19,
                "key 'home': MuJoCo refuses it: keyframe 'home': invalid qpos size, expected 2, got 3",
            ),
        ],
    ),
    Case(
        title="a mass that only a mesh has",
        text=PAIR.replace(INERTIAL + "\n      ", "")
        .replace('type="box" size="0.2 0.03 0.03"', 'type="mesh" mesh="shell"')
        .replace("  <worldbody>", SHELL_ASSET),
        problems=[
            (
                "upper",
                "inertial",
                7,
                "body 'upper': its mass would come from the mesh 'shell', and meshes are never opened; give it an <inertial> (MuJoCo's compiled model has the numbers: body_mass, body_ipos, body_iquat, body_inertia)",
            ),
        ],
    ),
    Case(
        title="a mesh that is not declared",
        old='type="box" size="0.2 0.03 0.03"',
        new='type="mesh" mesh="shell"',
        problems=[
            ("shell", "name", 7, "geom 'shell': MuJoCo refuses it: mesh 'shell' not found in geom 0"),
        ],
    ),
    Case(
        title="a total mass",
        old='angle="radian"',
        new='angle="radian" settotalmass="4"',
        problems=[
            ("model", "settotalmass", 2, "model: settotalmass is not read; scale the masses themselves"),
        ],
    ),
    Case(
        title="a repetition",
        old='<geom name="shell" type="box" size="0.2 0.03 0.03" pos="0.2 0 0"/>',
        new='<geom name="shell" type="box" size="0.2 0.03 0.03" pos="0.2 0 0"/>\n      <replicate count="1000000" offset="0 0 1"><geom size="0.1"/></replicate>',
        problems=[
            (
                "upper",
                "replicate",
                8,
                "body 'upper': <replicate> is not read; let MuJoCo write the model out: mujoco.MjSpec.from_file(MODEL).to_xml()",
            ),
        ],
    ),
    Case(
        title="an attached model",
        old='<geom name="shell" type="box" size="0.2 0.03 0.03" pos="0.2 0 0"/>',
        new='<geom name="shell" type="box" size="0.2 0.03 0.03" pos="0.2 0 0"/>\n      <attach model="hand" body="palm" prefix="h"/>',
        problems=[
            (
                "upper",
                "attach",
                8,
                "body 'upper': <attach> is not read; let MuJoCo write the model out: mujoco.MjSpec.from_file(MODEL).to_xml()",
            ),
        ],
    ),
    Case(
        title="a model as an asset",
        old="  <worldbody>",
        new='  <asset>\n    <model name="hand" file="hand.xml"/>\n  </asset>\n  <worldbody>',
        problems=[
            (
                "hand",
                "model",
                4,
                "model 'hand': <model> is not read; let MuJoCo write the model out: mujoco.MjSpec.from_file(MODEL).to_xml()",
            ),
        ],
    ),
    Case(
        title="a plugin",
        old="  <worldbody>",
        new='  <extension>\n    <plugin plugin="mujoco.pid"/>\n  </extension>\n  <worldbody>',
        problems=[
            ("model", "plugin", 4, "model: <plugin> runs code that is not in the file; take it out"),
        ],
    ),
    Case(
        title="a soft body",
        old='<geom name="shell" type="box" size="0.2 0.03 0.03" pos="0.2 0 0"/>',
        new='<geom name="shell" type="box" size="0.2 0.03 0.03" pos="0.2 0 0"/>\n      <flexcomp name="cloth" type="grid" count="9 9 1"/>',
        problems=[
            (
                "cloth",
                "flexcomp",
                8,
                "flexcomp 'cloth': <flexcomp> makes soft bodies, which an arm has none of; take it out",
            ),
        ],
    ),
    Case(
        title="an include that climbs out",
        old="  <worldbody>",
        new='  <include file="../secret.xml"/>\n  <worldbody>',
        problems=[
            ("include", "file", 3, "<include>: '../secret.xml' is not followed: it leads out of the model's folder"),
        ],
    ),
    Case(
        title="an include of an absolute path",
        old="  <worldbody>",
        new='  <include file="/etc/passwd"/>\n  <worldbody>',
        problems=[
            ("include", "file", 3, "<include>: '/etc/passwd' is not followed: it leads out of the model's folder"),
        ],
    ),
    Case(
        title="an include of an address",
        old="  <worldbody>",
        new='  <include file="http://example.org/a.xml"/>\n  <worldbody>',
        problems=[
            (
                "include",
                "file",
                3,
                "<include>: 'http://example.org/a.xml' is not followed: it is an address or an odd name, not a plain relative path",
            ),
        ],
    ),
    Case(
        title="an include of nothing",
        old="  <worldbody>",
        new='  <include file="gone.xml"/>\n  <worldbody>',
        problems=[
            (
                "include",
                "file",
                3,
                "<include>: included file '{folder}/gone.xml' does not exist; '{folder}' has 'm.xml'",
            ),
        ],
    ),
    Case(
        title="an include of itself",
        old="  <worldbody>",
        new='  <include file="m.xml"/>\n  <worldbody>',
        problems=[
            ("include", "file", 3, "<include>: 'm.xml' is included twice, or includes itself; keep one"),
        ],
    ),
    Case(
        title="an include without file",
        old="  <worldbody>",
        new="  <include/>\n  <worldbody>",
        problems=[
            ("include", "file", 3, "<include>: it names no file; give it file="),
        ],
    ),
    Case(
        title="no body",
        text="<mujoco>\n  <worldbody/>\n</mujoco>\n",
        problems=[
            ("m", "joint", 1, "no joint moves; an arm needs one at least"),
        ],
    ),
    Case(
        title="nothing that moves",
        text=PAIR.replace(SHOULDER, "").replace('<joint name="elbow" axis="0 1 0"/>', "").replace(MOTOR, ""),
        problems=[
            ("pair", "joint", 1, "no joint moves; an arm needs one at least"),
        ],
    ),
    Case(
        title="global coordinates",
        old='angle="radian"',
        new='angle="radian" coordinate="global"',
        problems=[
            (
                "compiler",
                "compiler",
                2,
                "<compiler>: MuJoCo refuses it: global coordinates no longer supported. To convert existing models, load and save them in MuJoCo 2.3.3 or older",
            ),
        ],
    ),
    Case(
        title="an entity",
        old='<mujoco model="pair">',
        new='<!DOCTYPE mujoco [<!ENTITY a "b">]>\n<mujoco model="&a;">',
        problems=[
            (
                "m.xml",
                "DOCTYPE",
                1,
                "it has a DOCTYPE, which can declare entities; a robot model needs none: delete it",
            ),
        ],
    ),
    Case(
        title="a file that is cut off",
        text=PAIR[:400],
        problems=[
            ("m.xml", "XML", 9, "the XML is damaged inside <body>: unclosed token"),
        ],
    ),
    Case(
        title="gravity that is NaN",
        old="  <worldbody>",
        new='  <option gravity="0 0 nan"/>\n  <worldbody>',
        problems=[
            ("model", "gravity", 3, "model: gravity of <option> must be finite; got '0 0 nan'"),
        ],
    ),
    Case(
        title="a size that is NaN",
        old='size="0.2 0.03 0.03"',
        new='size="0.2 nan 0.03"',
        problems=[
            ("shell", "size", 7, "geom 'shell': size of <geom> must be finite; got '0.2 nan 0.03'"),
        ],
    ),
    Case(
        title="a geom of negative size",
        old='<inertial mass="2" pos="0.2 0 0" diaginertia="0.01 0.03 0.03"/>\n      <joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.1"/>\n      <geom name="shell" type="box" size="0.2 0.03 0.03" pos="0.2 0 0"/>',
        new='<joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.1"/>\n      <geom name="shell" type="box" size="-0.2 0.03 0.03" pos="0.2 0 0"/>',
        problems=[
            ("shell", "geom", 6, "geom 'shell': MuJoCo refuses it: size 0 must be positive in geom"),
        ],
    ),
]
