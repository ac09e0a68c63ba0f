"""Faults of a robot's loop: code, name, what it means, and how to go on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from taut.base.errors import UsageError


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault; the code is what the loop latches."""

    code: int
    name: str
    text: str  # {who}, {value} and {unit} are filled in
    remedy: str
    unit: str = ""


def _kinds() -> dict[int, FaultKind]:
    rows = (
        (10, "sensor_not_finite", "{who} read {value}", "check the sensor and its cable", ""),
        (11, "sensor_jump", "{who} jumped by {value} {unit} within a period", "check the encoder", "{u}"),
        (12, "sensor_inconsistent", "{who}: position and velocity contradict each other by {value} {unit}",
         "check sign and cable of the encoder, and that its values change", "{u}/s"),
        (20, "law_not_finite", "the law gave a number that is not finite for {who}", "see its last ticks", ""),
        (21, "reference_jump", "the reference of {who} jumped by {value} {unit} in a tick",
         "take a trajectory, or move_to its beginning", "rad | m"),
        (30, "position", "{who} could not be braked before its limit any more: {value} {unit} left",
         "move it back by hand, or slowly with move_to", "{u}"),
        (31, "speed", "{who} was faster than its limit by {value} {unit}",
         "lower the gains or the reference's speed", "{u}/s"),
        (32, "tool_speed", "the tool was faster than its limit by {value} {unit}",
         "lower the reference's speed", "m/s"),
        (33, "workspace", "the tool was {value} {unit} outside the workspace box",
         "move it back by hand", "m"),
        (34, "power", "the drives' power was above its limit by {value} {unit}",
         "lower the gains or the speed", "W"),
        (35, "force", "the force at the tool was above its limit by {value} {unit}",
         "free the tool", "N"),
        (36, "contact", "{who} met an external torque above its threshold by {value} {unit}",
         "free the arm", "{t}"),
        (40, "stream_stopped", "no sample of the stream arrived for {value} {unit}",
         "recover(), start the law again and send; or declare a longer period", "s"),
        (41, "deadline", "{value} periods in a row were missed",
         "see the record's timing; lower the rate or free the processor", ""),
        (50, "disconnected", "the robot is not connected any more", "connect again", ""),
        (51, "silent", "the robot sent nothing", "check cable and robot; connect again where the loop has ended",
         ""),
        (52, "robot_error", "the robot stopped by itself", "recover() when the cause is gone", ""),
        (53, "rejected", "the robot refused a command", "", ""),
        (54, "busy", "another client has the robot", "close it first", ""),
        (55, "driver", "the driver failed", "", ""),
        (60, "watchdog", "the loop hung, and its process was ended from outside", "connect again", ""),
        (61, "process_died", "the loop's process died", "connect again", ""),
        (62, "partner", "the robot that was started together with this one stopped",
         "see the other robot", ""),
        (63, "unwatched", "the watchdog does not look any more", "connect again", ""),
    )  # fmt: skip
    return {row[0]: FaultKind(*row) for row in rows}


FAULTS: Final = _kinds()
CODES: Final = {kind.name: code for code, kind in FAULTS.items()}


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A latched fault of a robot's loop."""

    code: int
    name: str
    message: str  # what happened, and how to go on
    tick: int  # of the loop since it connected
    joint: str | None = None
    value: float | None = None

    def __str__(self) -> str:
        return f"{self.name} ({self.code}) in tick {self.tick}: {self.message}"


def fault_of(
    code: int,
    tick: int,
    *,
    who: str = "",
    value: float = 0.0,
    units: tuple[str, str] = ("rad", "N m"),  # of the joint's position and effort
    detail: str = "",
    joint: str | None = None,
) -> Fault:
    """The fault of a code in words; `detail` is what a driver or the system reported."""
    kind = FAULTS.get(code)
    if kind is None:
        raise UsageError(f"there is no fault with the code {code}", name="code")
    unit = kind.unit.format(u=units[0], t=units[1])
    text = detail or kind.text.format(who=who or "the arm", value=f"{value:.4g}", unit=unit).replace("  ", " ")
    message = "; ".join(filter(None, (text, kind.remedy)))
    return Fault(code=code, name=kind.name, message=message, tick=tick, joint=joint, value=float(value))
