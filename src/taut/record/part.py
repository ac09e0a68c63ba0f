"""One part of a run of laws side by side, as a run of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from taut.base.errors import UsageError, unknown_name
from taut.record.info import IMPEDANCE, PARTS

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = ["part_of"]


def part_of(run: Run, name: str) -> Run:
    """The joints, terms and reference of one of the laws side by side.

    Raises:
        UsageError: The run is not one of laws side by side.
        UnknownNameError: It has no such part.
    """
    parts: Mapping[str, Mapping[str, Any]] = run.info.get(PARTS, {})
    if not parts:
        raise UsageError("the run has no parts: its law is not taut.SideBySide", name="part")
    if name not in parts:
        raise unknown_name("the run", "part", name, parts)
    own = [run.joint_names.index(joint) for joint in parts[name]["joints"]]
    info = {key: value for key, value in run.info.items() if key not in (PARTS, IMPEDANCE)} | dict(parts[name])
    return dataclasses.replace(
        run,
        **{key: getattr(run, key)[:, own] for key in ("q", "v", "tau", "command")},
        terms={key: values[:, own] for key, values in run.terms.items()},
        extra={key: values for key, values in run.extra.items() if key == "F_ext" and IMPEDANCE in parts[name]},
        reference=getattr(run.reference, name),
        joint_names=tuple(run.joint_names[i] for i in own),
        units=tuple(run.units[i] for i in own),
        continuous=tuple(k for k, i in enumerate(own) if i in run.continuous),
        info=info,
        arm=None,
    )
