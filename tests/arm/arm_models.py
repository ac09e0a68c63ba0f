"""Small models as text, for the tests of this folder; each line has a number that the tests know."""

from __future__ import annotations

from dataclasses import dataclass

DUO = """\
<?xml version="1.0"?>
<robot name="duo">
  <link name="base"/>
  <link name="upper">
    <inertial>
      <origin xyz="0.2 0 0" rpy="0 0 0"/>
      <mass value="2.0"/>
      <inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="fore">
    <inertial>
      <mass value="1.0"/>
      <inertia ixx="0.004" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="tool"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/>
    <child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0 0 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="3" effort="40"/>
    <dynamics damping="0.1" friction="0.2"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/>
    <child link="fore"/>
    <origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/>
    <limit velocity="3" effort="20"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="fore"/>
    <child link="tool"/>
    <origin xyz="0.3 0 0"/>
  </joint>
</robot>
"""

PAIR = """\
<mujoco model="pair">
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper" pos="0 0 0.3">
      <inertial mass="2" pos="0.2 0 0" diaginertia="0.01 0.03 0.03"/>
      <joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.1"/>
      <geom name="shell" type="box" size="0.2 0.03 0.03" pos="0.2 0 0"/>
      <body name="fore" pos="0.4 0 0">
        <inertial mass="1" pos="0.1 0 0" diaginertia="0.004 0.02 0.02"/>
        <joint name="elbow" axis="0 1 0"/>
        <site name="tip" pos="0.3 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder_motor" joint="shoulder" forcerange="-40 40"/>
  </actuator>
</mujoco>
"""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A broken model: what is replaced in the sound one, or the whole text, and what is said about it."""

    title: str
    problems: list[tuple[str, str | None, int | None, str]]  # object, attribute, line, message
    old: str = ""
    new: str = ""
    text: str = ""

    def written(self, sound: str) -> str:
        if self.text:
            return self.text
        assert self.old in sound, self.title
        return sound.replace(self.old, self.new, 1)
