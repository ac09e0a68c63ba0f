"""Laws, plants and trajectories that the tests of this folder share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import taut
from taut.base.types import Float64Array

Array = Float64Array
TINY = 2.0**-60  # a power of two, so that what is hidden in a torque with it comes back exactly


class TorqueOf(taut.Law):
    """The torque that stands in the reference's acceleration."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(wanted=ref.a)


class Seen(taut.Law):
    """The reference's torque, and what the law sees, hidden in terms that move nothing."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(
            wanted=ref.a,
            q=x.q * TINY,
            v=x.v * TINY,
            tau=x.tau_meas * TINY,
            ref=ref.q * TINY,
            t=x.t * TINY + 0.0 * x.q,
        )


class Pushed(taut.Law):
    """Answers a force at the tool, and remembers its sum: a law that needs a sensor, and memory with a start."""

    kp: taut.Gain  # [N m/rad]
    F_sum: taut.Memory = taut.Memory(0.0)

    def start(self, x: taut.Snapshot, ref: taut.JointMotion) -> dict[str, object]:
        return {"q_first": x.q}

    def command(self, x: taut.Snapshot, ref: taut.JointMotion, memory: Any, dt: float) -> Any:
        F_sum = memory.F_sum + x.F_ext * dt
        torque = taut.Torque(P=self.kp @ (memory.q_first - x.q), yielding=-0.1 * (x.J().T @ F_sum), D=-2.0 * x.v)
        return torque, {"F_sum": F_sum, "q_first": memory.q_first}


def seen(run: taut.Run, name: str) -> Array:
    return run.terms[name] / TINY


class Spring(taut.environments.Environment):
    """A spring with damping between the tool and where it starts."""

    k: taut.environments.Field = taut.environments.Field(300.0, unit="N/m")
    b: taut.environments.Field = taut.environments.Field(5.0, unit="N s/m")

    def start(self, T_WE: taut.Pose) -> dict[str, Any]:
        return {"anchor": T_WE.p}

    def wrench(
        self, T_WE: taut.Pose, twist: Array, t: Any, memory: Mapping[str, Any], parameters: Mapping[str, Any], dt: Any
    ) -> tuple[Array, dict[str, Any]]:
        force = parameters["k"] * (memory["anchor"] - T_WE.p) - parameters["b"] * twist[:3]
        return taut.math.array([*force, 0.0, 0.0, 0.0]), {"anchor": memory["anchor"]}


class AtOnly:
    """A trajectory without rows: a simulation has to ask for each time on its own."""

    def __init__(self, inner: taut.trajectories.Sine) -> None:
        self._inner = inner
        self.asked: list[float] = []

    def at(self, t: float) -> taut.JointMotion:
        self.asked.append(t)
        return self._inner.at(t)


class HandPlant(taut.PlantBase):
    """A plant with a state of its own in plain Python, as an engine or a robot has: a point mass at each joint."""

    def __init__(self, n: int = 2, mass: float = 1.0, fails_at: int | None = None, measures: str = "v") -> None:
        super().__init__(taut.load_arm(f"planar{n}"))
        self.adds, self.measures = ("gravity", "coriolis"), frozenset(measures.split())
        self._values = {"plant.mass": np.asarray(mass)}
        self._fails_at = fails_at
        self.commands: list[Array] = []

    @property
    def parameters(self) -> Mapping[str, Array]:
        return dict(self._values)

    def checked_parameter(self, path: str, value: Any) -> Array:
        if not float(value) > 0.0:
            raise taut.errors.RangeError(f"{path} must be > 0; got {value!r}")
        return np.asarray(float(value))

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        for path, value in values.items():
            self._values[path] = self.checked_parameter(path, value)

    def reset(self, q: Array, v: Array, dt: float, seed: int = 0) -> None:
        self.q, self.v, self.dt, self.ticks = np.array(q), np.array(v), dt, 0
        self.commands.clear()

    def state(self) -> tuple[Array, Array]:
        return self.q.copy(), self.v.copy()

    def advance(self, command: Array) -> Array:
        self.commands.append(command.copy())
        self.v = self.v + self.dt * command / self._values["plant.mass"]
        self.q = self.q + self.dt * self.v
        self.ticks += 1
        return command

    def trouble(self) -> tuple[str, int | None] | None:
        return ("the point masses flew apart", 1) if self.ticks == self._fails_at else None

    def extra(self) -> dict[str, Any]:
        return {"mass": self._values["plant.mass"]}
