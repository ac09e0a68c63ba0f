"""How a run ended, in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

__all__ = ["Outcome"]

Kind = Literal["completed", "diverged", "stopped"]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a run ended: completed, diverged, or stopped for a stated reason."""

    kind: Kind
    message: str
    tick: int  # the last tick that was recorded
    joint: str | None = None
    dropped: int = 0  # ticks that are in the record and not in the log, which could not be written

    @property
    def ok(self) -> bool:
        """Whether the run went to its end."""
        return self.kind == "completed"

    def __str__(self) -> str:
        return self.message

    def json(self) -> dict[str, Any]:
        """As plain values."""
        plain = {"kind": self.kind, "message": self.message, "tick": self.tick, "joint": self.joint}
        return plain if not self.dropped else {**plain, "dropped": self.dropped}
