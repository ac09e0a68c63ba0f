"""A Franka driver that sends what it must not send, for tests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from taut.base.types import Float64Array
from taut.runtime.robots.franka import FrankaDriver


class PoisonedDriver(FrankaDriver):
    """`robot.call("poison", joint=2, value="nan")`: the next command has that torque."""

    poison: tuple[int, float] | None = None

    def write(self, command: Float64Array) -> None:
        if self.poison is not None:
            (joint, value), self.poison = self.poison, None
            command = command.copy()
            command[joint] = value
        super().write(command)

    def call(self, name: str, arguments: Mapping[str, Any]) -> Any:
        if name != "poison":
            return super().call(name, arguments)
        self.poison = arguments["joint"], float(arguments["value"])
        return None
