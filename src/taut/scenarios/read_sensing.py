"""Sensing of a scenario: velocity, notch, wrist, F_ext and tau_meas in [control]."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from taut.arm.description import Arm
from taut.base.errors import quoted_list
from taut.control.sensing.filters import LowPass, Notch
from taut.control.sensing.sensing import FILTERED, VELOCITIES, Sensing
from taut.control.sensing.velocity import Difference, Kalman
from taut.control.sensing.wrist import Wrist
from taut.scenarios.toml import Section

__all__ = ["SENSED", "read_sensing"]

SENSED: Final = ("velocity", "notch", "wrist", *FILTERED)  # the keys of [control] that are read here
PARTS: Final[Mapping[str, Any]] = {"notch": Notch, "wrist": Wrist} | dict.fromkeys(FILTERED, LowPass)
KINDS: Final[Mapping[str, Any]] = {"low-pass": LowPass, "difference": Difference, "kalman": Kalman}
KEYS: Final[Mapping[str, tuple[str, ...]]] = {
    "low-pass": ("cutoff", "order"),
    "difference": ("cutoff", "order"),
    "kalman": ("acceleration_noise", "position_noise"),
    "notch": ("frequency", "width", "depth"),
    "wrist": ("bias", "mass", "com", "range", "repeats", "frame"),
}
REQUIRED: Final = {
    "low-pass": ("cutoff",), "difference": (), "kalman": KEYS["kalman"], "notch": ("frequency", "width"),
    "wrist": (),
}  # fmt: skip


def read_sensing(section: Section, arm: Arm, rate: float) -> Sensing:
    """velocity = "measured", "difference" or a table { kind, ... }; tables notch, wrist, F_ext and tau_meas.

    Args:
        section: [control].
        arm: The controllers' arm.
        rate: Ticks per second [Hz].
    """
    parts: dict[str, Any] = {"velocity": "measured"}
    given = section.peek("velocity")
    if isinstance(given, dict):
        table = section.section("velocity")
        kind = table.word("kind", tuple(KINDS))
        parts["velocity"] = _part(table, "velocity", kind, KINDS[kind], arm, rate)
    elif isinstance(given, str) and given in KINDS and given not in VELOCITIES:
        numbers = ", ".join(f"{name} = ..." for name in REQUIRED[given])
        raise section.error(f'velocity = "{given}" needs its numbers: {{ kind = "{given}", {numbers} }}')
    elif given is not None and given not in VELOCITIES:
        raise section.error(
            f"velocity must be one of {quoted_list(VELOCITIES)}, or a table with kind = one of "
            f"{quoted_list(KINDS)}; got {given!r}"
        )
    else:
        parts["velocity"] = section.word("velocity", VELOCITIES, "measured")
    for name in SENSED[1:]:
        if name in section:
            kind = "low-pass" if name in FILTERED else name
            parts[name] = _part(section.section(name), name, kind, PARTS[name], arm, rate)
    return Sensing(**parts)


def _part(table: Section, name: str, kind: str, cls: Any, arm: Arm, rate: float) -> Any:
    """A part of sensing from its table, which fits the arm and the rate."""
    values = table.fields(KEYS[kind], REQUIRED[kind])
    with table.blamed():
        made = cls(**values)
        Sensing(**{name: made}).check_fit(arm, rate)
        return made
