"""Run: what happened, tick by tick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from taut.arm.description import Arm
from taut.base.types import Float64Array
from taut.control.reference import Sample
from taut.record.outcome import Outcome

__all__ = ["Run"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """A recorded run. All arrays have one row per control tick; row k stands at time t[k].

    q and v are the true state at the tick, `command` and `terms` what the controller made of what it measured then,
    and tau what acted on the joints during the period that follows.
    """

    t: Float64Array  # (k,) [s]
    q: Float64Array  # (k, n) [rad | m]
    v: Float64Array  # (k, n) [rad/s | m/s]
    tau: Float64Array  # (k, n) [N m | N]
    command: Float64Array  # (k, n) in the unit of the command's kind
    terms: Mapping[str, Float64Array]  # (k, n) each; they add up to the command
    reference: Sample  # the wanted sample, with fields (k, n)
    outcome: Outcome
    joint_names: tuple[str, ...]
    units: tuple[str, ...]  # of each entry of q: rad or m
    continuous: tuple[int, ...] = ()  # joints that wrap
    kind: str = "torque"  # of the command
    extra: Mapping[str, Float64Array] = field(default_factory=dict)  # further columns, such as F_ext (k, 6)
    info: Mapping[str, Any] = field(default_factory=dict)  # law, arm, plant, parameters, events, seed: plain values
    arm: Arm | None = None  # the plant's arm, to draw; None in a run that was loaded from a file

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def rate(self) -> float:
        """Ticks per second [Hz]."""
        return float(self.info["rate"])

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        end = float(self.t[-1]) if len(self) else 0.0
        return f"Run({len(self)} ticks, {end:g} s, {self.n} joints, {self.outcome.kind})"
