"""What touches the tool of an arm in MuJoCo besides the scene: the environments of RigidPlant, before each step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.engine import Steps, best_engine
from taut.codegen.layout import Block
from taut.codegen.loop import StepLoop
from taut.maths import dynamics as dyn
from taut.maths.model import model_of
from taut.plant.drives.drivetrain import Drivetrain
from taut.plant.environments.environment import Environment, touch
from taut.plant.step_length import Steps as Division
from taut.plant.step_length import require_short_contact
from taut.runtime.robots.mujoco.rig import Rig

__all__ = ["EnvironmentStage"]

Values = Mapping[str, Any]


class EnvironmentStage:
    """An environment that acts at the tool in each of MuJoCo's steps, as generalised forces J^T F.

    Args:
        rig: The arm in its model, built by us.
        environment: What touches the tool.
        train: Rotors, friction and transmissions.
    """

    def __init__(self, rig: Rig, environment: Environment, train: Drivetrain) -> None:
        self._rig, self._environment, self._train = rig, environment, train
        self._model = model_of(rig.arm)
        self._loop: StepLoop | None = None

    def _step(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        """The wrench at a state, as a force on the joints, and memory after a step."""
        q, v, numbers = inputs["q"], inputs["v"], subtree(parameters, "environment")
        wrench, after = touch(self._environment, self._model, q, v, memory, numbers, inputs["t"], parameters["dt"])
        return {"wrench": wrench, "force": dyn.jacobian(self._model, q).T @ wrench}, after

    # ---------------------------------------------------------------- a run

    def start(self, q: Float64Array, v: Float64Array, parameters: Values, dt: float, steps: int) -> None:
        """Memory at the start of a run, for control periods of dt [s], each of so many steps.

        Raises:
            RangeError: Steps that are too long for it.
        """
        n, h = self._rig.arm.n, dt / steps
        require_short_contact(
            self._environment,
            self._train,
            q,
            parameters,
            Division(dt, steps),
        )
        values = self._values(parameters, h)
        memory = self._environment.start(dyn.pose(self._model, q))
        if self._loop is None:
            self._inputs = Block.of({"q": (n,), "v": (n,), "t": ()})
            self._parameters = Block.of({path: np.shape(value) for path, value in values.items()})
            self._memory = Block.of({path: np.shape(value) for path, value in memory.items()})
            example = self._inputs.zeros(), self._parameters.pack(values), self._memory.pack(memory)
            example[0][:n] = q
            functions = Steps(self._step, self._inputs, self._parameters, self._memory)
            self._loop = StepLoop(functions, example, engine=best_engine())
            self._row, self._out = np.zeros((1, self._inputs.size)), np.zeros((1, self._loop.outputs.size))
            self._seen = self._inputs.views(self._row)
            self._given = {path: view[0] for path, view in self._loop.outputs.views(self._out).items()}
        self._flat, self._h, self._t = self._memory.pack(memory), h, 0.0
        self.take(parameters)
        self.sane, self.work = True, 0.0
        kept = self._flat.copy()
        self.before(q, v)  # what a sensor gives in the first tick
        self._flat[:], self._t = kept, 0.0

    @staticmethod
    def _values(parameters: Values, h: float) -> dict[str, Any]:
        own = {path: value for path, value in parameters.items() if path.startswith("environment.")}
        return {**own, "dt": np.asarray(h)}

    def take(self, parameters: Values) -> None:
        """New values of the parameters, by path, in a run or between two."""
        if self._loop is not None:
            self._flat_parameters = self._parameters.pack(self._values(parameters, self._h))

    def at(self, t: float) -> None:
        """A control period begins at time t [s]."""
        self._t = t

    def before(self, q: Float64Array, v: Float64Array) -> Float64Array:
        """(n,) the force on the joints in MuJoCo's next step."""
        assert self._loop is not None
        self._seen["q"][0], self._seen["v"][0], self._seen["t"][0] = q, v, self._t
        done = self._loop.run(self._row, self._flat_parameters, self._flat, self._out)
        self.sane = self.sane and done == 1
        self._t += self._h
        self._v = v.copy()
        force: Float64Array = self._given["force"]
        return force

    def after(self, v: Float64Array) -> None:
        """What MuJoCo's step did: the work is that of the mean speed, as in RigidPlant."""
        self.work += 0.5 * self._h * float(self._given["force"] @ (self._v + v))

    @property
    def wrench(self) -> Float64Array:
        """(6,) F_ext in the last step."""
        wrench: Float64Array = self._given["wrench"].copy()
        return wrench
