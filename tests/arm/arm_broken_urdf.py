"""Broken URDF files, each with what must be said about it: object, attribute, line, and the whole message."""

from __future__ import annotations

from arm_models import DUO, Case

CASES: list[Case] = [
    Case(
        title="a negative mass",
        old='value="2.0"',
        new='value="-2.0"',
        problems=[
            ("upper", "mass", 7, "link 'upper': mass must be finite and >= 0 [kg]; got -2; fix its mass and inertia"),
        ],
    ),
    Case(
        title="a mass of zero on a link that moves",
        old='value="2.0"',
        new='value="0"',
        problems=[
            ("upper", "mass", 7, "link 'upper': mass must be > 0 [kg]; got 0; fix its mass and inertia"),
        ],
    ),
    Case(
        title="a mass that is NaN",
        old='value="2.0"',
        new='value="nan"',
        problems=[
            ("upper", "value", 7, "link 'upper': value of <mass> must be finite; got 'nan'"),
        ],
    ),
    Case(
        title="an infinite mass",
        old='value="2.0"',
        new='value="-INF"',
        problems=[
            ("upper", "value", 7, "link 'upper': value of <mass> must be finite; got '-INF'"),
        ],
    ),
    Case(
        title="a mass in words",
        old='value="2.0"',
        new='value="heavy"',
        problems=[
            ("upper", "value", 7, "link 'upper': value of <mass> must be one number; got 'heavy'"),
        ],
    ),
    Case(
        title="a mass with a decimal comma",
        old='value="2.0"',
        new='value="2,0"',
        problems=[
            (
                "upper",
                "value",
                7,
                "link 'upper': value of <mass> must be one number; got '2,0'; separate numbers by blanks",
            ),
        ],
    ),
    Case(
        title="two masses in one attribute",
        old='value="2.0"',
        new='value="2 0"',
        problems=[
            ("upper", "value", 7, "link 'upper': value of <mass> must be one number; got 2 ('2 0')"),
        ],
    ),
    Case(
        title="an empty mass",
        old='value="2.0"',
        new='value=""',
        problems=[
            ("upper", "value", 7, "link 'upper': value of <mass> must be one number; got none"),
        ],
    ),
    Case(
        title="a mass without value",
        old='<mass value="2.0"/>',
        new="<mass/>",
        problems=[
            ("upper", "value", 7, "link 'upper': <mass> has no value; give it one"),
        ],
    ),
    Case(
        title="a mass beyond any arm",
        old='value="2.0"',
        new='value="1e12"',
        problems=[
            ("upper", "value", 7, "link 'upper': value of <mass> must be within +-1e+09; got '1e12'"),
        ],
    ),
    Case(
        title="an inertial without mass",
        old='      <mass value="2.0"/>\n',
        new="",
        problems=[
            ("upper", "mass", 5, "link 'upper': its <inertial> has no <mass>; give it one"),
        ],
    ),
    Case(
        title="an inertial without inertia",
        old='      <inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/>\n',
        new="",
        problems=[
            ("upper", "inertia", 5, "link 'upper': its <inertial> has no <inertia>; give it one"),
        ],
    ),
    Case(
        title="a moment that is missing",
        old=' izz="0.03" ixy',
        new=" ixy",
        problems=[
            ("upper", "izz", 8, "link 'upper': <inertia> has no izz; give it one"),
        ],
    ),
    Case(
        title="a moment that is NaN",
        old='ixx="0.01"',
        new='ixx="NaN"',
        problems=[
            ("upper", "ixx", 8, "link 'upper': ixx of <inertia> must be finite; got 'NaN'"),
        ],
    ),
    Case(
        title="a broken triangle inequality",
        old='ixx="0.01" iyy="0.03" izz="0.03"',
        new='ixx="0.9" iyy="0.1" izz="0.2"',
        problems=[
            (
                "upper",
                "inertia",
                8,
                "link 'upper': inertia violates the triangle inequality (Ixx 0.9 > Iyy + Izz 0.3); fix its mass and inertia",
            ),
        ],
    ),
    Case(
        title="a broken triangle inequality in turned axes",
        old='ixx="0.01" iyy="0.03" izz="0.03" ixy="0"',
        new='ixx="0.03" iyy="0.03" izz="0.005" ixy="0.026"',
        problems=[
            (
                "upper",
                "inertia",
                8,
                "link 'upper': inertia violates the triangle inequality (principal moments 0.056 > 0.004 + 0.005); fix its mass and inertia",
            ),
        ],
    ),
    Case(
        title="a negative moment",
        old='ixx="0.01"',
        new='ixx="-0.01"',
        problems=[
            (
                "upper",
                "inertia",
                8,
                "link 'upper': inertia must be positive definite [kg m^2]; its smallest principal moment is -0.01; fix its mass and inertia",
            ),
        ],
    ),
    Case(
        title="an inertia of zero",
        old='ixx="0.01" iyy="0.03" izz="0.03"',
        new='ixx="0" iyy="0" izz="0"',
        problems=[
            (
                "upper",
                "inertia",
                8,
                "link 'upper': inertia must be positive definite [kg m^2]; its smallest principal moment is 0; fix its mass and inertia",
            ),
        ],
    ),
    Case(
        title="products of inertia that no body has",
        old='ixy="0" ixz="0" iyz="0"/>\n    </inertial>\n  </link>\n  <link name="fore">',
        new='ixy="0.02" ixz="0" iyz="0"/>\n    </inertial>\n  </link>\n  <link name="fore">',
        problems=[
            (
                "upper",
                "inertia",
                8,
                "link 'upper': inertia must be positive definite [kg m^2]; its smallest principal moment is -0.00236; fix its mass and inertia",
            ),
        ],
    ),
    Case(
        title="a link that moves and has no inertial",
        old='    <inertial>\n      <mass value="1.0"/>\n      <inertia ixx="0.004" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>\n    </inertial>\n',
        new="",
        problems=[
            (
                "fore",
                "mass",
                11,
                "link 'fore' is moved by joint 'elbow' and has no mass; give it mass and inertia",
            ),
        ],
    ),
    Case(
        title="two inertials",
        old='    </inertial>\n  </link>\n  <link name="fore">',
        new='    </inertial>\n    <inertial/>\n  </link>\n  <link name="fore">',
        problems=[
            ("upper", "inertial", 10, "link 'upper': <link> has two <inertial> (the first in line 5); delete one"),
        ],
    ),
    Case(
        title="two masses",
        old='      <mass value="2.0"/>',
        new='      <mass value="2.0"/>\n      <mass value="2.0"/>',
        problems=[
            ("upper", "mass", 8, "link 'upper': <inertial> has two <mass> (the first in line 7); delete one"),
        ],
    ),
    Case(
        title="an origin with two numbers",
        old='xyz="0 0 0.3"',
        new='xyz="0 0.3"',
        problems=[
            ("shoulder", "xyz", 21, "joint 'shoulder': xyz of <origin> must be 3 numbers; got 2 ('0 0.3')"),
        ],
    ),
    Case(
        title="an origin with four numbers",
        old='xyz="0 0 0.3"',
        new='xyz="0 0 0.3 1"',
        problems=[
            ("shoulder", "xyz", 21, "joint 'shoulder': xyz of <origin> must be 3 numbers; got 4 ('0 0 0.3 1')"),
        ],
    ),
    Case(
        title="angles that are NaN",
        old='xyz="0 0 0.3" rpy="0 0 0"',
        new='xyz="0 0 0.3" rpy="0 nan 0"',
        problems=[
            ("shoulder", "rpy", 21, "joint 'shoulder': rpy of <origin> must be finite; got '0 nan 0'"),
        ],
    ),
    Case(
        title="an origin with commas",
        old='xyz="0 0 0.3"',
        new='xyz="0, 0, 0.3"',
        problems=[
            (
                "shoulder",
                "xyz",
                21,
                "joint 'shoulder': xyz of <origin> must be 3 numbers; got '0, 0, 0.3'; separate numbers by blanks",
            ),
        ],
    ),
    Case(
        title="a misspelt attribute",
        old='<origin xyz="0.4 0 0"/>',
        new='<origin xzy="0.4 0 0"/>',
        problems=[
            ("elbow", "xzy", 29, "joint 'elbow': <origin> has an unknown attribute 'xzy'; did you mean 'xyz'?"),
        ],
    ),
    Case(
        title="two origins",
        old='<origin xyz="0.4 0 0"/>',
        new='<origin xyz="0.4 0 0"/>\n    <origin xyz="0.5 0 0"/>',
        problems=[
            ("elbow", "origin", 30, "joint 'elbow': <joint> has two <origin> (the first in line 29); delete one"),
        ],
    ),
    Case(
        title="an axis of zero",
        old='<axis xyz="0 1 0"/>\n    <limit lower',
        new='<axis xyz="0 0 0"/>\n    <limit lower',
        problems=[
            (
                "shoulder",
                "axis",
                22,
                "joint 'shoulder': axis must be finite and not zero: a joint that moves needs a direction",
            ),
        ],
    ),
    Case(
        title="an axis that is NaN",
        old='<axis xyz="0 1 0"/>\n    <limit lower',
        new='<axis xyz="0 nan 0"/>\n    <limit lower',
        problems=[
            ("shoulder", "xyz", 22, "joint 'shoulder': xyz of <axis> must be finite; got '0 nan 0'"),
        ],
    ),
    Case(
        title="an axis without numbers",
        old='<axis xyz="0 1 0"/>\n    <limit lower',
        new="<axis/>\n    <limit lower",
        problems=[
            ("shoulder", "xyz", 22, "joint 'shoulder': <axis> has no xyz; give it one"),
        ],
    ),
    Case(
        title="an axis with two numbers",
        old='<axis xyz="0 1 0"/>\n    <limit lower',
        new='<axis xyz="0 1"/>\n    <limit lower',
        problems=[
            ("shoulder", "xyz", 22, "joint 'shoulder': xyz of <axis> must be 3 numbers; got 2 ('0 1')"),
        ],
    ),
    Case(
        title="two axes",
        old='<axis xyz="0 1 0"/>\n    <limit lower',
        new='<axis xyz="0 1 0"/>\n    <axis xyz="0 0 1"/>\n    <limit lower',
        problems=[
            ("shoulder", "axis", 23, "joint 'shoulder': <joint> has two <axis> (the first in line 22); delete one"),
        ],
    ),
    Case(
        title="no limit at all",
        old='    <limit lower="-2" upper="2" velocity="3" effort="40"/>\n',
        new="",
        problems=[
            (
                "shoulder",
                "limit",
                18,
                "joint 'shoulder': it has no lower and upper and velocity and effort limit; a revolute joint needs <limit lower= upper= velocity= effort=>",
            ),
        ],
    ),
    Case(
        title="no lower limit",
        old=' lower="-2"',
        new="",
        problems=[
            (
                "shoulder",
                "lower",
                23,
                "joint 'shoulder': it has no lower limit; a revolute joint needs <limit lower= upper= velocity= effort=>",
            ),
        ],
    ),
    Case(
        title="no position limits",
        old=' lower="-2" upper="2"',
        new="",
        problems=[
            (
                "shoulder",
                "limit",
                23,
                "joint 'shoulder': it has no lower and upper limit; a revolute joint needs <limit lower= upper= velocity= effort=>",
            ),
        ],
    ),
    Case(
        title="limits in the wrong order",
        old='lower="-2" upper="2"',
        new='lower="2" upper="-2"',
        problems=[
            ("shoulder", "limit", 23, "joint 'shoulder': lower limit 2 must be below upper limit -2; swap them"),
        ],
    ),
    Case(
        title="limits that are equal",
        old='lower="-2" upper="2"',
        new='lower="0" upper="0"',
        problems=[
            (
                "shoulder",
                "limit",
                23,
                "joint 'shoulder': lower limit 0 must be below upper limit 0; make a joint that does not move a fixed one",
            ),
        ],
    ),
    Case(
        title="a limit that is NaN",
        old='upper="2"',
        new='upper="nan"',
        problems=[
            ("shoulder", "upper", 23, "joint 'shoulder': upper of <limit> must be finite; got 'nan'"),
        ],
    ),
    Case(
        title="a limit in degrees sign",
        old='upper="2"',
        new='upper="90°"',
        problems=[
            ("shoulder", "upper", 23, "joint 'shoulder': upper of <limit> must be one number; got '90°'"),
        ],
    ),
    Case(
        title="no effort limit",
        old=' effort="40"',
        new="",
        problems=[
            (
                "shoulder",
                "effort",
                23,
                "joint 'shoulder': it has no effort limit; a revolute joint needs <limit lower= upper= velocity= effort=>",
            ),
        ],
    ),
    Case(
        title="no effort",
        old='effort="40"',
        new='effort="0"',
        problems=[
            ("shoulder", "effort", 23, "joint 'shoulder': effort limit must be > 0; got 0"),
        ],
    ),
    Case(
        title="a negative effort",
        old='effort="40"',
        new='effort="-40"',
        problems=[
            ("shoulder", "effort", 23, "joint 'shoulder': effort limit must be > 0; got -40"),
        ],
    ),
    Case(
        title="no speed",
        old='velocity="3" effort="40"',
        new='velocity="0" effort="40"',
        problems=[
            ("shoulder", "velocity", 23, "joint 'shoulder': speed limit must be > 0; got 0"),
        ],
    ),
    Case(
        title="a negative speed of a continuous joint",
        old='velocity="3" effort="20"',
        new='velocity="-3" effort="20"',
        problems=[
            ("elbow", "velocity", 31, "joint 'elbow': speed limit must be > 0; got -3"),
        ],
    ),
    Case(
        title="a negative damping",
        old='damping="0.1"',
        new='damping="-0.1"',
        problems=[
            ("shoulder", "damping", 24, "joint 'shoulder': damping must be finite and >= 0; got -0.1"),
        ],
    ),
    Case(
        title="a negative friction",
        old='friction="0.2"',
        new='friction="-0.2"',
        problems=[
            ("shoulder", "friction", 24, "joint 'shoulder': friction must be finite and >= 0; got -0.2"),
        ],
    ),
    Case(
        title="an infinite damping",
        old='damping="0.1"',
        new='damping="inf"',
        problems=[
            ("shoulder", "damping", 24, "joint 'shoulder': damping of <dynamics> must be finite; got 'inf'"),
        ],
    ),
    Case(
        title="a misspelt damping",
        old='damping="0.1" friction',
        new='dampning="0.1" friction',
        problems=[
            (
                "shoulder",
                "dampning",
                24,
                "joint 'shoulder': <dynamics> has an unknown attribute 'dampning'; did you mean 'damping'?",
            ),
        ],
    ),
    Case(
        title="a misspelt element",
        old='<dynamics damping="0.1" friction="0.2"/>',
        new='<dynamic damping="0.1" friction="0.2"/>',
        problems=[
            (
                "shoulder",
                "dynamic",
                24,
                "joint 'shoulder': <joint> has an unknown <dynamic>; did you mean <dynamics>?",
            ),
        ],
    ),
    Case(
        title="an unknown joint type",
        old='type="revolute"',
        new='type="revolut"',
        problems=[
            ("shoulder", "type", 18, "joint 'shoulder': URDF has no joint type 'revolut'; did you mean 'revolute'?"),
        ],
    ),
    Case(
        title="a joint type of another format",
        old='type="revolute"',
        new='type="hinge"',
        problems=[
            (
                "shoulder",
                "type",
                18,
                "joint 'shoulder': URDF has no joint type 'hinge'; it has 'revolute', 'continuous', 'prismatic', 'fixed', 'floating', 'planar'",
            ),
        ],
    ),
    Case(
        title="no joint type",
        old=' type="revolute"',
        new="",
        problems=[
            (
                "shoulder",
                "type",
                18,
                "joint 'shoulder': it has no type; give it one of revolute, continuous, prismatic, fixed, floating, planar",
            ),
        ],
    ),
    Case(
        title="a floating joint",
        old='type="continuous"',
        new='type="floating"',
        problems=[
            (
                "elbow",
                "type",
                26,
                "joint 'elbow': a floating joint is not one of an arm; make it fixed, cut the model there, or hold it still: load_arm(..., locked={'elbow': 0.0})",
            ),
        ],
    ),
    Case(
        title="a planar joint",
        old='type="continuous"',
        new='type="planar"',
        problems=[
            (
                "elbow",
                "type",
                26,
                "joint 'elbow': a planar joint is not one of an arm; write it as two prismatic joints and a revolute one, or hold it still: load_arm(..., locked={'elbow': 0.0})",
            ),
        ],
    ),
    Case(
        title="no parent",
        old='    <parent link="base"/>\n',
        new="",
        problems=[
            (
                "shoulder",
                "parent",
                18,
                "joint 'shoulder': it has no <parent link=...>; a joint joins a parent link to a child link",
            ),
        ],
    ),
    Case(
        title="no child",
        old='    <child link="upper"/>\n',
        new="",
        problems=[
            (
                "shoulder",
                "child",
                18,
                "joint 'shoulder': it has no <child link=...>; a joint joins a parent link to a child link",
            ),
        ],
    ),
    Case(
        title="a parent without link",
        old='<parent link="base"/>',
        new="<parent/>",
        problems=[
            (
                "shoulder",
                "parent",
                19,
                "joint 'shoulder': it has no <parent link=...>; a joint joins a parent link to a child link",
            ),
        ],
    ),
    Case(
        title="two parents of one joint",
        old='<parent link="base"/>',
        new='<parent link="base"/>\n    <parent link="fore"/>',
        problems=[
            (
                "shoulder",
                "parent",
                20,
                "joint 'shoulder': <joint> has two <parent> (the first in line 19); delete one",
            ),
        ],
    ),
    Case(
        title="an unknown parent",
        old='<parent link="upper"/>',
        new='<parent link="uper"/>',
        problems=[
            ("elbow", "parent", 27, "joint 'elbow': its parent: the model has no link 'uper'; did you mean 'upper'?"),
        ],
    ),
    Case(
        title="an unknown child",
        old='<child link="upper"/>',
        new='<child link="elephant"/>',
        problems=[
            (
                "shoulder",
                "child",
                20,
                "joint 'shoulder': its child: the model has no link 'elephant'; it has 'base', 'fore', 'tool', 'upper'",
            ),
        ],
    ),
    Case(
        title="two links of one name",
        old='<link name="tool"/>',
        new='<link name="tool"/>\n  <link name="tool"/>',
        problems=[
            ("tool", "name", 18, "link 'tool' is there twice (first in line 17); rename one"),
        ],
    ),
    Case(
        title="two joints of one name",
        old='joint name="elbow"',
        new='joint name="shoulder"',
        problems=[
            ("shoulder", "name", 26, "joint 'shoulder' is there twice (first in line 18); rename one"),
        ],
    ),
    Case(
        title="a link without name",
        old='<link name="tool"/>',
        new='<link name="tool"/>\n  <link/>',
        problems=[
            ("link", "name", 18, "a link has no name; give it one"),
        ],
    ),
    Case(
        title="a joint with an empty name",
        old='joint name="elbow"',
        new='joint name=""',
        problems=[
            ("joint", "name", 26, "a joint has no name; give it one"),
        ],
    ),
    Case(
        title="two roots",
        old='<link name="tool"/>',
        new='<link name="tool"/>\n  <link name="table"/>',
        problems=[
            (
                "table",
                "parent",
                18,
                "the model has 2 roots ('base', 'table'); an arm has one base: join the others to it with fixed joints",
            ),
        ],
    ),
    Case(
        title="two parents of one link",
        old="</robot>",
        new='  <joint name="strut" type="fixed"><parent link="base"/><child link="fore"/></joint>\n</robot>',
        problems=[
            (
                "strut",
                "child",
                38,
                "joint 'strut': link 'fore' has two parents, also joint 'elbow'; an arm is a tree: cut the loop at one joint and state the closure as a constraint",
            ),
        ],
    ),
    Case(
        title="a cycle",
        old='<parent link="base"/>',
        new='<parent link="fore"/>',
        problems=[
            (
                "fore",
                "parent",
                11,
                "link 'fore' is on a closed chain; an arm is a tree: cut the loop at one joint and state the closure as a constraint",
            ),
        ],
    ),
    Case(
        title="a joint from a link to itself",
        old='<parent link="upper"/>',
        new='<parent link="fore"/>',
        problems=[
            ("elbow", "child", 28, "joint 'elbow': it joins link 'fore' to itself; name another child"),
        ],
    ),
    Case(
        title="a mimic joint",
        old='<limit velocity="3" effort="20"/>',
        new='<limit velocity="3" effort="20"/>\n    <mimic joint="shoulder" multiplier="2"/>',
        problems=[
            (
                "elbow",
                "mimic",
                32,
                "joint 'elbow': it mimics 'shoulder', and taut has no coupled joints; make it fixed, or hold it still: load_arm(..., locked={'elbow': 0.0})",
            ),
        ],
    ),
    Case(
        title="a mimic of nothing",
        old='<limit velocity="3" effort="20"/>',
        new='<limit velocity="3" effort="20"/>\n    <mimic joint="sholder"/>',
        problems=[
            (
                "elbow",
                "mimic",
                32,
                "joint 'elbow': it mimics 'sholder' (there is no such joint), and taut has no coupled joints; make it fixed, or hold it still: load_arm(..., locked={'elbow': 0.0})",
            ),
        ],
    ),
    Case(
        title="a mimic factor in words",
        old='<limit velocity="3" effort="20"/>',
        new='<limit velocity="3" effort="20"/>\n    <mimic joint="shoulder" multiplier="twice"/>',
        problems=[
            ("elbow", "multiplier", 32, "joint 'elbow': multiplier of <mimic> must be one number; got 'twice'"),
            (
                "elbow",
                "mimic",
                32,
                "joint 'elbow': it mimics 'shoulder', and taut has no coupled joints; make it fixed, or hold it still: load_arm(..., locked={'elbow': 0.0})",
            ),
        ],
    ),
    Case(
        title="a macro",
        old='<link name="tool"/>',
        new='<link name="tool"/>\n  <xacro:gripper parent="tool"/>',
        problems=[
            (
                "duo",
                "xacro:gripper",
                18,
                "robot 'duo': <xacro:gripper> is a macro; expand the file first: xacro MODEL.xacro > MODEL.urdf",
            ),
        ],
    ),
    Case(
        title="several things at once",
        text=DUO.replace('value="2.0"', 'value="-2.0"')
        .replace('effort="40"', 'effort="0"')
        .replace('xyz="0.4 0 0"', 'xyz="0.4 0"')
        .replace('ixx="0.004"', 'ixx="0.9"'),
        problems=[
            ("upper", "mass", 7, "link 'upper': mass must be finite and >= 0 [kg]; got -2; fix its mass and inertia"),
            (
                "fore",
                "inertia",
                14,
                "link 'fore', with 'tool' fixed to it: inertia violates the triangle inequality (Ixx 0.9 > Iyy + Izz 0.04); fix its mass and inertia",
            ),
            ("shoulder", "effort", 23, "joint 'shoulder': effort limit must be > 0; got 0"),
            ("elbow", "xyz", 29, "joint 'elbow': xyz of <origin> must be 3 numbers; got 2 ('0.4 0')"),
        ],
    ),
    Case(
        title="no links",
        text='<robot name="r"/>\n',
        problems=[
            ("r", "link", 1, "the model has no links; an arm needs a base and one link at least"),
        ],
    ),
    Case(
        title="nothing that moves",
        text=DUO.replace("revolute", "fixed").replace("continuous", "fixed"),
        problems=[
            ("duo", "joint", 2, "no joint moves; an arm needs one at least"),
        ],
    ),
    Case(
        title="another format",
        text='<?xml version="1.0"?>\n<sdf version="1.7"><model name="m"/></sdf>\n',
        problems=[
            (
                "m.urdf",
                "sdf",
                2,
                "its root element is <sdf>; a robot model begins with <robot> (URDF) or <mujoco> (MJCF); convert it to URDF",
            ),
        ],
    ),
    Case(
        title="a web page",
        text="<html><body>404</body></html>\n",
        problems=[
            (
                "m.urdf",
                "html",
                1,
                "its root element is <html>; a robot model begins with <robot> (URDF) or <mujoco> (MJCF)",
            ),
        ],
    ),
    Case(
        title="a file that is cut off",
        text=DUO[:700],
        problems=[
            ("m.urdf", "XML", 24, "the XML is damaged inside <joint>: unclosed token"),
        ],
    ),
    Case(
        title="a file that is cut off in a tag",
        text=DUO[:735],
        problems=[
            ("m.urdf", "XML", 26, "the XML is damaged inside <robot>: unclosed token"),
        ],
    ),
    Case(
        title="a tag that is never closed",
        old='    </inertial>\n  </link>\n  <link name="fore">',
        new='  </link>\n  <link name="fore">',
        problems=[
            ("m.urdf", "XML", 9, "the XML is damaged inside <inertial>: mismatched tag"),
        ],
    ),
    Case(
        title="two root elements",
        text=DUO + "<robot/>\n",
        problems=[
            ("m.urdf", "XML", 39, "the XML is damaged: junk after document element"),
        ],
    ),
    Case(
        title="an attribute twice",
        old='<mass value="2.0"/>',
        new='<mass value="2.0" value="3.0"/>',
        problems=[
            ("m.urdf", "XML", 7, "the XML is damaged inside <inertial>: duplicate attribute"),
        ],
    ),
    Case(
        title="a stray ampersand",
        old='name="duo"',
        new='name="this & that"',
        problems=[
            ("m.urdf", "XML", 2, "the XML is damaged: not well-formed (invalid token)"),
        ],
    ),
    Case(
        title="an entity that is not defined",
        old='<link name="tool"/>',
        new='<link name="tool"/>&tool;',
        problems=[
            ("m.urdf", "XML", 17, "the XML is damaged inside <robot>: undefined entity"),
        ],
    ),
    Case(
        title="an internal entity",
        old='<robot name="duo">',
        new='<!DOCTYPE robot [<!ENTITY m "2.0">]>\n<robot name="duo">',
        problems=[
            (
                "m.urdf",
                "DOCTYPE",
                2,
                "it has a DOCTYPE, which can declare entities; a robot model needs none: delete it",
            ),
        ],
    ),
    Case(
        title="an external entity",
        old='<robot name="duo">',
        new='<!DOCTYPE robot [<!ENTITY m SYSTEM "file:///etc/passwd">]>\n<robot name="duo">',
        problems=[
            (
                "m.urdf",
                "DOCTYPE",
                2,
                "it has a DOCTYPE, which can declare entities; a robot model needs none: delete it",
            ),
        ],
    ),
    Case(
        title="an external document type",
        old='<robot name="duo">',
        new='<!DOCTYPE robot SYSTEM "http://example.org/robot.dtd">\n<robot name="duo">',
        problems=[
            (
                "m.urdf",
                "DOCTYPE",
                2,
                "it has a DOCTYPE, which can declare entities; a robot model needs none: delete it",
            ),
        ],
    ),
    Case(
        title="a NUL byte",
        old='<link name="tool"/>',
        new='<link name="tool"/>\x00',
        problems=[
            ("m.urdf", "content", 17, "the file holds a NUL byte; it is no text file, or damaged"),
        ],
    ),
    Case(
        title="an unknown encoding",
        old='<?xml version="1.0"?>',
        new='<?xml version="1.0" encoding="klingon"?>',
        problems=[
            (
                "m.urdf",
                "encoding",
                1,
                "its text cannot be decoded (unknown encoding: klingon); save the file as UTF-8",
            ),
        ],
    ),
    Case(
        title="another encoding than it says",
        old='<?xml version="1.0"?>',
        new='<?xml version="1.0" encoding="utf-16"?>',
        problems=[
            ("m.urdf", "XML", 1, "the XML is damaged: encoding specified in XML declaration is incorrect"),
        ],
    ),
    Case(
        title="plain text",
        text="link base\njoint shoulder\n",
        problems=[
            ("m.urdf", "XML", 1, "the file is not XML; a robot model begins with <robot> (URDF) or <mujoco> (MJCF)"),
        ],
    ),
    Case(
        title="nothing but blanks",
        text="  \n\n",
        problems=[
            ("m.urdf", "content", 1, "the file holds nothing but blanks"),
        ],
    ),
]
