"""ROS 2 messages of constant size, as templates with holes for numbers.

A message that always has the same joints is always as long, and its numbers stand in the same places. So a message
is built once, here, and thousands are written at a time by NumPy.

References:
    OMG, DDS-XTypes 1.3, section 7.4 (plain CDR, version 1). ROS 2 interface definitions (common_interfaces).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from typing import Final

import numpy as np

__all__ = ["JOINT_STATE", "MULTI_ARRAY", "SCHEMAS", "NUMBER", "Template", "joint_state", "multi_array", "number"]

JOINT_STATE: Final = "sensor_msgs/msg/JointState"
MULTI_ARRAY: Final = "std_msgs/msg/Float64MultiArray"
NUMBER: Final = "std_msgs/msg/Float64"

_RULER = "=" * 80
_JOINT_STATE = f"""\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_RULER}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_RULER}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_MULTI_ARRAY = f"""\
std_msgs/MultiArrayLayout layout
float64[] data
{_RULER}
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
{_RULER}
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""
SCHEMAS: Final[Mapping[str, str]] = {
    JOINT_STATE: _JOINT_STATE,
    MULTI_ARRAY: _MULTI_ARRAY,
    NUMBER: "float64 data\n",
}
"""Definition of each message, with all it depends on, in the encoding `ros2msg`."""


@dataclass
class Template:
    """A message as bytes, little-endian, and where its holes are: name -> (NumPy type, offset)."""

    data: bytearray = field(default_factory=lambda: bytearray(b"\x00\x01\x00\x00"))  # little-endian plain CDR
    holes: dict[str, tuple[np.dtype[np.void] | str, int]] = field(default_factory=dict)

    def _align(self, size: int) -> None:
        self.data += bytes(-(len(self.data) - 4) % size)

    def u4(self, value: int) -> None:
        """An unsigned number of 4 bytes."""
        self._align(4)
        self.data += struct.pack("<I", value)

    def text(self, value: str) -> None:
        """A string."""
        raw = value.encode() + b"\x00"
        self.u4(len(raw))
        self.data += raw

    def hole(self, name: str, kind: str, count: int | None = None) -> None:
        """Room for a number, or an array of `count` numbers, of a NumPy type such as "<f8"."""
        size = np.dtype(kind).itemsize
        self._align(size)
        shape = "" if count is None else f"({count},)"
        self.holes[name] = (f"{shape}{kind}", len(self.data))
        self.data += bytes(size * (1 if count is None else count))

    def floats(self, name: str | None, count: int) -> None:
        """A sequence of doubles; an empty one without a name."""
        self.u4(0 if name is None else count)
        if name is not None and count:
            self.hole(name, "<f8", count)


def joint_state(joints: Sequence[str], **columns: str) -> Template:
    """sensor_msgs/msg/JointState.

    Args:
        joints: Names of the joints.
        columns: Name of the hole for position, velocity and effort; arrays that are left out are empty.
    """
    message = Template()
    message.hole("sec", "<i4")
    message.hole("nanosec", "<u4")
    message.text("")
    message.u4(len(joints))
    for joint in joints:
        message.text(joint)
    for part in ("position", "velocity", "effort"):
        message.floats(columns.get(part), len(joints))
    return message


def multi_array(column: str, shape: tuple[int, ...], labels: Sequence[str]) -> Template:
    """std_msgs/msg/Float64MultiArray of a shape, with a label for each of its axes."""
    message = Template()
    message.u4(len(shape))
    for i, (label, size) in enumerate(zip(labels, shape, strict=True)):
        message.text(label)
        message.u4(size)
        message.u4(prod(shape[i:]))
    message.u4(0)
    message.floats(column, prod(shape))
    return message


def number(column: str) -> Template:
    """std_msgs/msg/Float64."""
    message = Template()
    message.hole(column, "<f8")
    return message
