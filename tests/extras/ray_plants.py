"""A plant for sweeps on Ray, which the workers import by this module's name."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import taut


class EndsWorkers(taut.PlantBase):
    """A sliding mass. Starts near 1 end the Ray worker above this process, near 2 once only; near 3 they raise."""

    def __init__(self, arm: taut.Arm, folder: str) -> None:
        super().__init__(arm)
        self.folder = Path(folder)

    def reset(self, q: Any, v: Any, dt: float, seed: int) -> None:
        self.q, self.v, self.dt = q.copy(), v.copy(), dt
        with (self.folder / "begun").open("a") as file:
            file.write(f"{q[0]}\n")
        place, once = round(float(q[0]), 1), self.folder / "once"
        if place == 1.0 or (place == 2.0 and not once.exists()):
            once.touch()
            os.kill(os.getppid(), signal.SIGKILL)
            signal.pause()
        if place == 3.0:
            raise RuntimeError("the plant fails")

    def state(self) -> tuple[Any, Any]:
        return self.q, self.v

    def advance(self, command: Any) -> Any:
        self.v = self.v + self.dt * command / 2.0
        self.q = self.q + self.dt * self.v
        return command
