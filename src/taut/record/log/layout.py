"""The header of a log, and one tick of a run as a ROS 2 message of constant size.

The message taut/msg/Tick on the topic /run has t and every column: q, v, tau, command, terms_P, reference_q,
extra_F_ext, ... These are numbers of fixed count alone, so that thousands are written and read at a time by NumPy.

References:
    OMG, DDS-XTypes 1.3, section 7.4 (plain CDR, version 1).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Final, Literal, TypeAlias, cast

import numpy as np

from taut.base.types import Array, Float64Array
from taut.control.trajectories.compound import Compound
from taut.record.info import RunInfo, check_info
from taut.record.run import Run

__all__ = ["Header", "TickLayout", "columns_of"]

FORMAT: Final = 2
CDR_HEAD: Final = b"\x00\x01\x00\x00"  # little-endian plain CDR
MAX_COLUMNS: Final = 2000
MAX_AXES: Final = 8
MAX_AXIS: Final = 2**31  # [-] size of an axis
MAX_PARTS: Final = 64  # of a reference of several

_RULER = "=" * 80
Shape: TypeAlias = tuple[int, ...]
Unit = Literal["rad", "m"]
Kind = Literal["torque", "velocity", "position"]


@dataclass(frozen=True, kw_only=True)
class PartKind:
    """One of the samples that a reference of several holds."""

    name: str
    kind: str
    joints: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Header:
    """The columns of a run, and what it was made with."""

    format: int = FORMAT
    joint_names: tuple[str, ...]
    units: tuple[Unit, ...]
    continuous: tuple[int, ...]
    kind: Kind
    terms: tuple[str, ...]
    reference: str  # name of the sample's class
    parts: tuple[PartKind, ...]  # of a sample of several
    fields: Mapping[str, Shape]  # of the reference
    extra: Mapping[str, Shape]
    info: RunInfo

    @classmethod
    def of(cls, run: Run) -> Header:
        """The header of a run, or of a piece of one."""
        sample = type(run.reference)
        parts = sample.parts if issubclass(sample, Compound) else ()
        return cls(
            joint_names=run.joint_names,
            units=cast("tuple[Unit, ...]", run.units),
            continuous=run.continuous,
            kind=cast("Kind", run.kind),
            terms=tuple(run.terms),
            reference=sample.__name__.partition("[")[0],
            parts=tuple(PartKind(name=part.name, kind=part.kind.__name__, joints=part.joints) for part in parts),
            fields={name: np.shape(getattr(run.reference, name))[1:] for name in sample.fields(run.n)},
            extra={name: np.shape(value)[1:] for name, value in run.extra.items()},
            info=run.info,
        )

    def check(self, max_numbers: int) -> None:
        """Require of a header that was read that its parts fit each other.

        Args:
            max_numbers: In one tick: the file has no room for more.

        Raises:
            ValueError: They do not.
        """
        n = len(self.joint_names)
        shapes = (*self.fields.values(), *self.extra.values())
        few = len(self.terms) + len(shapes) <= MAX_COLUMNS and len(self.parts) <= MAX_PARTS
        small = all(len(shape) <= MAX_AXES and all(0 <= size <= MAX_AXIS for size in shape) for shape in shapes)
        if not few or not small or sum(map(prod, self.shapes().values())) > max_numbers:
            raise ValueError("it has more numbers in a tick than the file has room for")
        unique = all(len(set(names)) == len(names) for names in (self.joint_names, self.terms))
        if not n or len(self.units) != n or not unique or not all(0 <= i < n for i in self.continuous):
            raise ValueError("its header does not fit its joints")
        check_info(self.info, self.joint_names)

    def shapes(self) -> dict[str, Shape]:
        """Shape of one row of every column."""
        n = (len(self.joint_names),)
        out: dict[str, Shape] = {"t": (), **dict.fromkeys(("q", "v", "tau", "command"), n)}
        out |= {f"terms.{name}": n for name in self.terms}
        out |= {f"reference.{name}": shape for name, shape in self.fields.items()}
        return out | {f"extra.{name}": shape for name, shape in self.extra.items()}


class TickLayout:
    """One tick as the message taut/msg/Tick: doubles, one behind the other.

    Args:
        header: Of the log.
    """

    def __init__(self, header: Header) -> None:
        self.shapes = header.shapes()
        self.joints = header.joint_names
        sized = [(name, "<f8", shape) for name, shape in self.shapes.items() if prod(shape)]
        self.dtype = np.dtype([("cdr", f"V{len(CDR_HEAD)}"), *sized])

    def schema(self) -> str:
        """The definition of the message. What has a number for each joint has them by the names of the joints."""
        lines = []
        names = _identifiers(self.shapes)
        for name, shape in self.shapes.items():
            if shape == (len(self.joints),):
                lines.append(f"taut/Joints {names[name]}")
            elif prod(shape):
                lines.append(f"float64{f'[{prod(shape)}]' if shape else ''} {names[name]}")
        joints = [f"float64 {name}" for name in _identifiers(self.joints).values()]
        return "\n".join([*lines, _RULER, "MSG: taut/Joints", *joints, ""])

    def rows(self, columns: Mapping[str, Float64Array]) -> Array:
        """(k,) messages of the ticks with these columns (k, ...)."""
        out = np.zeros(len(columns["t"]), dtype=self.dtype)
        out["cdr"] = np.void(CDR_HEAD)
        for name in (self.dtype.names or ())[1:]:
            out[name] = columns[name]
        return out

    def columns(self, blocks: Sequence[Array]) -> dict[str, Float64Array]:
        """The inverse of `rows`, of several blocks, each (k,)."""
        ticks = sum(map(len, blocks))
        return {
            name: np.concatenate([np.zeros((0, *shape)), *(block[name] for block in blocks)])
            if prod(shape)
            else np.zeros((ticks, *shape))
            for name, shape in self.shapes.items()
        }


def _identifiers(names: Iterable[str]) -> dict[str, str]:
    """Names as ROS takes them for fields: small letters, digits and single underscores; equal ones get a number."""
    out: dict[str, str] = {}
    for name in names:
        word = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
        word = word if word[:1].isalpha() else f"x{word}"
        out[name] = word if word not in out.values() else f"{word}_{len(out)}"
    return out


def columns_of(run: Run) -> dict[str, Float64Array]:
    """Every array of a run by the names that `Header.shapes` has."""
    out = {"t": run.t, "q": run.q, "v": run.v, "tau": run.tau, "command": run.command}
    out |= {f"terms.{name}": value for name, value in run.terms.items()}
    out |= {f"reference.{name}": getattr(run.reference, name) for name in type(run.reference).fields(run.n)}
    return out | {f"extra.{name}": value for name, value in run.extra.items()}
