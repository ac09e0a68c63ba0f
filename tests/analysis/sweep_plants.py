"""Plants for sweeps in processes: they end their process, hang or raise where a run starts at certain places."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import taut


class Deadly(taut.PlantBase):
    """A sliding mass. Starts near 1 end its process, near 2 hang, near 3 raise; near 4 they end it once."""

    def __init__(self, arm: taut.Arm, folder: str) -> None:
        super().__init__(arm)
        self.folder = folder

    def reset(self, q: Any, v: Any, dt: float, seed: int) -> None:
        self.q, self.v, self.dt = q.copy(), v.copy(), dt
        place = round(float(q[0]), 1)
        with (Path(self.folder) / "begun").open("a") as file:
            file.write(f"{q[0]}\n")
        once = Path(self.folder) / "once"
        if place == 1.0 or (place == 4.0 and not once.exists()):
            once.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if place == 2.0:
            time.sleep(60.0)
        if place == 3.0:
            raise RuntimeError("the plant fails")

    def state(self) -> tuple[Any, Any]:
        return self.q, self.v

    def advance(self, command: Any) -> Any:
        self.v = self.v + self.dt * command / 2.0
        self.q = self.q + self.dt * self.v
        return command
