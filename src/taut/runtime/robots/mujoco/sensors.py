"""The sensors of an arm in MuJoCo: those of every plant, in native code, tick by tick."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.engine import Steps, best_engine
from taut.codegen.loop import StepLoop
from taut.codegen.program import Block
from taut.maths.model import model_of
from taut.plant.sensors.sensors import Sensors

__all__ = ["SensorStage"]

Values = Mapping[str, Any]


class SensorStage:
    """What the sensors of an arm give, from what is true.

    Args:
        arm: The true arm.
        sensors: Its sensors.
    """

    def __init__(self, arm: Arm, sensors: Sensors) -> None:
        self._arm, self._sensors, self._model = arm, sensors, model_of(arm)
        self._shapes = sensors.noise(arm, touched=True)
        self._loop: StepLoop | None = None

    def _read(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:  # noqa: ARG002
        true = {path: value for path, value in inputs.items() if not path.startswith("noise.")}
        return self._sensors.read(self._model, true, subtree(inputs, "noise"), parameters), {}

    def start(self, seed: int, true: Values, parameters: Values) -> None:
        """Prepare for a run whose noise comes from this seed: the numbers that a model plant gets too.

        Args:
            seed: Seed of the run.
            true: What is true in the first tick, by name.
            parameters: The plant's parameters by path.
        """
        self._noise = {name: np.random.default_rng([seed, *name.encode()]) for name in self._shapes}
        if self._loop is None:
            shapes = {name: np.shape(value) for name, value in true.items()}
            self._inputs = Block.of(shapes | {f"noise.{name}": shape for name, shape in self._shapes.items()})
            own = subtree(parameters, "sensors")
            self._parameters = Block.of({path: np.shape(value) for path, value in own.items()})
            example = self._inputs.zeros(), self._parameters.pack(own), np.zeros(0)
            self._inputs.views(example[0])["q"][...] = true["q"]
            steps = Steps(self._read, self._inputs, self._parameters, Block())
            self._loop = StepLoop(steps, example, engine=best_engine())
            self._row, self._out = np.zeros((1, self._inputs.size)), np.zeros((1, self._loop.outputs.size))
            self._seen = {path: view[0, ...] for path, view in self._inputs.views(self._row).items()}
            self._given = {path: view[0, ...] for path, view in self._loop.outputs.views(self._out).items()}
        self.take(parameters)

    @property
    def saturating(self) -> tuple[str, ...]:
        """What `read` gives besides measurements: whether those that have a range are at it."""
        assert self._loop is not None
        return tuple(path for path in self._given if path.startswith("saturated."))

    def take(self, parameters: Values) -> None:
        """New values of the parameters, by path, in a run or between two."""
        if self._loop is None:
            return
        self._flat = self._parameters.pack(subtree(parameters, "sensors"))

    def read(self, true: Values) -> dict[str, Float64Array]:
        """What the sensors give in this tick, with fresh noise."""
        assert self._loop is not None
        for name, value in true.items():
            self._seen[name][...] = value
        for name, generator in self._noise.items():
            self._seen[f"noise.{name}"][...] = generator.standard_normal(self._shapes[name])
        self._loop.run(self._row, self._flat, np.zeros(0), self._out)
        return {name: np.array(value) for name, value in self._given.items()}
