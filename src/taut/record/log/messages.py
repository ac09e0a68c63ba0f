"""Which topics a log has, and how one tick of a run looks as bytes: ROS 2 messages of constant size.

A message that always has the same joints is always as long, and its numbers stand in the same places. So a tick is
built once, as a template with holes for numbers, and thousands are written at a time by NumPy.

| topic | message | numbers |
|---|---|---|
| /joint_states | JointState | q, v, tau |
| /reference | JointState | the wanted q and v, where the reference has them |
| /reference/NAME | Float64MultiArray | every other field of the reference, such as a |
| /command | JointState | the command, as effort, velocity or position |
| /terms/NAME | JointState | a term of the command, in the same place |
| /extra/NAME | Float64MultiArray | a further column, such as F_ext |
| /time | Float64 | t, exactly; stamps are rounded to nanoseconds |

The description of a run says all that follows from it, so that writing and reading share this file.

References:
    OMG, DDS-XTypes 1.3, section 7.4 (plain CDR, version 1). ROS 2 interface definitions (common_interfaces).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import prod
from typing import Any, Final

import numpy as np

from taut.base.types import Array, Float64Array
from taut.record.run import Run

__all__ = ["SCHEMAS", "Description", "TickLayout", "columns_of"]

RECORD_HEAD: Final = 31  # bytes of an MCAP message before its data
MESSAGE: Final = 5  # opcode
PLACE: Final = {"torque": "effort", "velocity": "velocity", "position": "position"}  # of a command in a JointState

Shapes = Mapping[str, tuple[int, ...]]
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


# -------------------------------------------------------------------- a run


@dataclass(frozen=True, kw_only=True)
class Description:
    """What the columns of a run are: enough to write and to read its log."""

    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    continuous: tuple[int, ...]
    kind: str
    terms: tuple[str, ...]
    reference: str  # name of the sample's class
    fields: Shapes  # of the reference
    extra: Shapes

    @classmethod
    def of(cls, run: Run) -> Description:
        """Of a run, or a piece of one."""
        sample = run.reference
        return cls(
            joint_names=run.joint_names,
            units=run.units,
            continuous=run.continuous,
            kind=run.kind,
            terms=tuple(run.terms),
            reference=type(sample).__name__,
            fields={name: np.shape(getattr(sample, name))[1:] for name in type(sample).fields(run.n)},
            extra={name: np.shape(value)[1:] for name, value in run.extra.items()},
        )

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of one row of every column."""
        n = (len(self.joint_names),)
        out: dict[str, tuple[int, ...]] = {"t": (), **dict.fromkeys(("q", "v", "tau", "command"), n)}
        out |= {f"terms.{name}": n for name in self.terms}
        out |= {f"reference.{name}": shape for name, shape in self.fields.items()}
        return out | {f"extra.{name}": shape for name, shape in self.extra.items()}

    def topics(self) -> tuple[Topic, ...]:
        """All topics, in the order in which they stand in a tick."""
        joints, place = self.joint_names, PLACE[self.kind]
        out = [
            Topic("/time", NUMBER, number("t")),
            Topic("/joint_states", JOINT_STATE, joint_state(joints, position="q", velocity="v", effort="tau")),
            Topic("/command", JOINT_STATE, joint_state(joints, **{place: "command"})),
        ]
        out += [
            Topic(f"/terms/{name}", JOINT_STATE, joint_state(joints, **{place: f"terms.{name}"}))
            for name in self.terms
        ]
        other = dict(self.fields)
        n = (len(joints),)
        if other.get("q") == n and other.get("v") == n:
            del other["q"], other["v"]
            message = joint_state(joints, position="reference.q", velocity="reference.v")
            out.append(Topic("/reference", JOINT_STATE, message))
        out += [_array_topic(f"/reference/{name}", f"reference.{name}", shape) for name, shape in other.items()]
        out += [_array_topic(f"/extra/{name}", f"extra.{name}", shape) for name, shape in self.extra.items()]
        return tuple(out)


@dataclass(frozen=True)
class Topic:
    """One channel of the log."""

    name: str
    schema: str
    message: Template

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of the run that it carries."""
        return tuple(hole for hole in self.message.holes if hole not in ("sec", "nanosec"))

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Its message as a NumPy structure."""
        return _structure(self.message.holes, len(self.message.data))


def _array_topic(topic: str, column: str, shape: tuple[int, ...]) -> Topic:
    labels = [f"axis{i}" for i in range(len(shape))]
    return Topic(topic, MULTI_ARRAY, multi_array(column, shape, labels))


def _structure(places: Mapping[str, tuple[Any, int]], size: int) -> np.dtype[np.void]:
    """Named fields at given offsets."""
    return np.dtype(
        {
            "names": list(places),
            "formats": [kind for kind, _ in places.values()],
            "offsets": [offset for _, offset in places.values()],
            "itemsize": size,
        }
    )


class TickLayout:
    """One tick of a run as bytes: a message of every topic, one behind the other.

    Channel i + 1 carries topic i. The layout serves both ways: rows of a run become an array of `dtype`, and back.

    Args:
        description: What the run has.
    """

    def __init__(self, description: Description) -> None:
        self.description = description
        self.topics = description.topics()
        template = bytearray()
        self.offsets: list[int] = []  # of each message's record in the tick
        places: dict[str, tuple[Any, int]] = {}
        for channel, topic in enumerate(self.topics, start=1):
            start = len(template)
            self.offsets.append(start)
            head = Template(data=bytearray())
            head.data += MESSAGE.to_bytes(1, "little")
            head.data += (RECORD_HEAD - 9 + len(topic.message.data)).to_bytes(8, "little")
            head.data += channel.to_bytes(2, "little")
            places |= {
                f"{channel}.head": ("(11,)u1", start),
                f"{channel}.sequence": ("<u4", start + 11),
                f"{channel}.log_time": ("<u8", start + 15),
                f"{channel}.publish_time": ("<u8", start + 23),
            }
            template += head.data + bytes(RECORD_HEAD - 11)
            for name, (kind, offset) in topic.message.holes.items():
                stamp = name in ("sec", "nanosec")
                places[f"{channel}.{name}" if stamp else name] = (kind, start + RECORD_HEAD + offset)
            template += topic.message.data
        self.places = frozenset(places)
        self.template = np.frombuffer(bytes(template), dtype=np.uint8)
        self.dtype = _structure(places, len(template))

    @property
    def size(self) -> int:
        """Bytes of one tick."""
        return int(self.template.size)

    def fill(self, rows: Array, columns: Mapping[str, Float64Array], first: int, times: Array) -> None:
        """Write ticks into `rows`, which hold the template.

        Args:
            rows: (k,) of `dtype`.
            columns: (k, ...) by name.
            first: Number of the first tick.
            times: (k,) [ns] stamps.
        """
        sequence = np.arange(first, first + len(rows), dtype=np.uint32)
        for channel, topic in enumerate(self.topics, start=1):
            rows[f"{channel}.sequence"] = sequence
            rows[f"{channel}.log_time"] = rows[f"{channel}.publish_time"] = times
            if "sec" in topic.message.holes:
                rows[f"{channel}.sec"], rows[f"{channel}.nanosec"] = np.divmod(times, 1_000_000_000)
        for name in self.description.shapes():
            if name in self.places:  # an array without entries has no place
                rows[name][...] = columns[name].reshape(rows[name].shape)

    def fits(self, rows: Array) -> bool:
        """Whether every record of every tick is where it should be."""
        return all(
            bool((rows[f"{i}.head"] == self.template[start : start + 11]).all())
            for i, start in enumerate(self.offsets, start=1)
        )


def columns_of(run: Run) -> dict[str, Float64Array]:
    """Every array of a run by the names that `Description.shapes` has."""
    fields = {name: getattr(run.reference, name) for name in type(run.reference).fields(run.n)}
    out = {"t": run.t, "q": run.q, "v": run.v, "tau": run.tau, "command": run.command}
    out |= {f"terms.{name}": value for name, value in run.terms.items()}
    out |= {f"reference.{name}": value for name, value in fields.items()}
    return out | {f"extra.{name}": value for name, value in run.extra.items()}
