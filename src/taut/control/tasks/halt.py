"""Halt: what holds an arm where a task has stopped."""

from __future__ import annotations

from typing import Any, ClassVar, Final

from taut.control.command import Command, Position, Terms, Torque, Velocity
from taut.control.gains import Gain
from taut.control.law import Law, MemoryView
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["Halt"]

MADE_BY: Final = {kind.kind: kind for kind in (Torque, Velocity, Position)}


class Halt(Law):
    """Holds the arm where it was when this law began.

    Law:          tau = M (kp (q_0 - q) - kd v) + h, with q_0 where it began; as a velocity 0, as a position q_0
    Closed loop:  e_ddot + kd e_dot + kp e = 0, e = q_0 - q
                  moving when it began, the arm comes to rest and goes back; nothing of an earlier push is kept up
    """

    ignores_reference: ClassVar[bool] = True

    kp: Gain = Gain(100.0)  # [1/s^2]
    kd: Gain = Gain(20.0)  # [1/s]
    kind: str = "torque"

    def start(self, x: Snapshot, ref: Any) -> dict[str, Any]:  # noqa: ARG002
        return {"q": tm.array(x.q)}

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: Any) -> tuple[Command, dict[str, Any]]:  # noqa: ARG002
        made, after = MADE_BY[self.kind], {"q": memory.q}
        if made is Torque:
            a = Terms(P=self.kp @ x.difference(memory.q), D=-(self.kd @ x.v))
            return Torque(x.M @ a + Terms(nonlinear=x.h)), after
        return made(Terms(hold=tm.zeros(x.n) if made is Velocity else memory.q)), after
