"""Arms and scenes for the tests of MujocoPlant."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import taut
from taut.arm.description import BASE, Arm, Body, Frame, Joint
from taut.arm.load import load_arm
from taut.trace.pose import Pose


def body(mass: float, com: tuple[float, float, float], size: tuple[float, float, float]) -> Body:
    """A solid box, turned, so that its inertia is full."""
    x, y, z = size
    R = Pose(rpy=(0.3, -0.5, 0.8)).R
    I = R @ np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) @ R.T * mass / 12.0
    return Body(mass=mass, com=np.array(com), inertia=I)


def torso() -> Arm:
    """Two arms on a turning torso, awkward on purpose: listed breadth first, tilted and reversed axes, a slide, a
    continuous joint, rotor inertia, a mounting that is turned, and gravity that is not along z."""
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    z, minus_y = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
    joints = (
        Joint(name="waist", kind="continuous", parent=BASE, placement=Pose((0, 0, 0.2)), axis=z, viscous=0.4),
        Joint(name="left1", kind="revolute", parent=0, placement=Pose((0, 0.3, 0.4), rpy=(0.2, 0, 0)), axis=axis),
        Joint(name="right1", kind="revolute", parent=0, placement=Pose((0, -0.3, 0.4)), axis=minus_y, viscous=0.2),
        Joint(
            name="left2",
            kind="prismatic",
            parent=1,
            placement=Pose((0.2, 0, 0.1), rpy=(0, 0.7, 0)),
            axis=minus_y,
            rotor_inertia=0.3,
            viscous=2.0,
        ),
        Joint(name="right2", kind="revolute", parent=2, placement=Pose((0.3, 0, 0)), axis=-z, rotor_inertia=0.05),
    )
    bodies = (
        body(8.0, (0.01, 0.02, 0.2), (0.3, 0.2, 0.5)),
        body(2.0, (0.1, 0.0, 0.05), (0.3, 0.1, 0.1)),
        body(2.5, (0.15, 0.01, 0.0), (0.3, 0.1, 0.08)),
        body(1.0, (0.0, -0.1, 0.02), (0.05, 0.2, 0.05)),
        body(1.2, (0.1, 0.0, -0.03), (0.2, 0.06, 0.05)),
    )
    frames = (Frame(name="hand", body=3, placement=Pose((0.05, -0.2, 0.03), rpy=(0.4, 0.1, -1.0))),)
    return Arm(
        name="torso",
        joints=joints,
        bodies=bodies,
        frames=frames,
        tool="hand",
        home=np.array([0.3, -0.4, 0.5, 0.05, 0.7]),
        gravity=np.array([3.0, -1.0, -9.0]),
        T_WB=Pose((0.5, -0.2, 0.1), rpy=(0.1, 0.2, 0.3)),
    )


def states(arm: Arm, count: int = 3) -> list[tuple[np.ndarray, np.ndarray]]:
    """Random states about home."""
    rng = np.random.default_rng(7)
    return [(arm.home + 0.5 * rng.standard_normal(arm.n), rng.standard_normal(arm.n)) for _ in range(count)]


def idle(arm: Arm, rate: float = 1000.0) -> taut.Controller:
    """A controller that commands no torque."""
    return taut.compile(taut.laws.PID(kp=0.0), arm, rate=rate)


PAIR = """
  <body name="{0}upper" pos="{1} 0 0.6">
    <inertial mass="2" pos="0.2 0 0.01" fullinertia="0.01 0.03 0.03 0.001 0 0.002"/>
    <joint name="{0}shoulder" axis="0 1 0" damping="0.3" armature="0.02"/>
    <body name="{0}fore" pos="0.4 0 0" euler="0 0 20">
      <inertial mass="1" pos="0.1 0 0" diaginertia="0.004 0.02 0.02"/>
      <joint name="{0}elbow" axis="0 0.6 0.8" damping="0.1"/>
      <body name="{0}hand" pos="0.3 0 0">
        <inertial mass="0.3" pos="0.02 0 0" diaginertia="0.001 0.001 0.001"/>
        <geom name="{0}tip" type="sphere" size="0.03" mass="0"/>
        <site name="{0}tcp" pos="0.05 0 0" euler="0 30 0"/>
      </body>
    </body>
  </body>
"""
PAIR_ARM = f'<mujoco model="pair"><worldbody>{PAIR.format("", 0)}</worldbody></mujoco>'
CELL = """
<mujoco model="cell">
  <option timestep="0.001" integrator="{integrator}"/>
  <worldbody>
    <geom type="plane" size="3 3 0.1"/>
    <body name="box" pos="2 2 0.5"><freejoint name="box"/><geom type="box" size="0.05 0.05 0.05" mass="1"/></body>
    {left}
    <body name="door" pos="-2 0 1">
      <joint name="door" axis="0 0 1" damping="1"/><geom type="box" size="0.3 0.02 0.5" pos="0.3 0 0" mass="3"/>
    </body>
    {right}
    <body name="target" mocap="true" pos="0 2 1"/>
  </worldbody>
  <actuator>
    <motor name="door" joint="door"/>
    {actuators}
    <position name="right_shoulder" joint="right_shoulder" kp="200" kv="20"/>
    <position name="right_elbow" joint="right_elbow" kp="100" kv="10"/>
  </actuator>
</mujoco>
"""
MOTORS = """
    <motor name="b" joint="left_elbow" gear="-2"/>
    <general name="a" joint="left_shoulder" gear="5" gainprm="3"/>
"""


def pair(folder: Path) -> Arm:
    """The arm of the cell, with its tool at the site, where the left one stands."""
    file = folder / "pair.xml"
    file.write_text(PAIR_ARM)
    return load_arm(str(file), tool="tcp", T_WB=Pose((1.0, 0.0, 0.0)), home=[0.2, 0.4])


def cell(actuators: str = MOTORS, integrator: str = "Euler", left: str | None = None) -> str:
    """A scene with two arms, a box that falls, and a door with a motor of its own."""
    return CELL.format(
        left=PAIR.format("left_", 1) if left is None else left,
        right=PAIR.format("right_", -1),
        actuators=actuators,
        integrator=integrator,
    )
