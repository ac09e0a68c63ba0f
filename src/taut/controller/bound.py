"""BoundKernel: a controller's own arrays, for fast loops."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np

from taut.base.errors import UsageError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.kernel import Kernel
from taut.control.trajectories.reference import Sample

__all__ = ["BoundKernel"]


class BoundKernel:
    """A controller's arrays: write `q`, `v`, `ref.q`, ..., call `tick()`, read `command`. Nothing is allocated."""

    __slots__ = ("F_ext", "a_tip", "command", "q", "q_motor", "ref", "tau_meas", "tick", "v", "v_motor")

    def __init__(self, kernel: Kernel, reference: type[Sample]) -> None:
        inputs, empty = kernel.blocks.views("inputs"), np.zeros(0)
        self.q: Float64Array = inputs["q"]
        self.v: Float64Array = inputs.get("v", empty)
        self.F_ext: Float64Array = inputs.get("F_ext", empty)
        self.tau_meas: Float64Array = inputs.get("tau_meas", empty)
        self.q_motor: Float64Array = inputs.get("q_motor", empty)
        self.v_motor: Float64Array = inputs.get("v_motor", empty)
        self.a_tip: Float64Array = inputs.get("a_tip", empty)
        self.ref: Any = reference.of(subtree(inputs, "ref"))
        self.command: Float64Array = kernel.blocks.views("outputs")["command"]
        self.tick = kernel.tick

    def __setattr__(self, name: str, value: object) -> None:
        if name in self.__slots__ and hasattr(self, name):
            raise UsageError(
                f"{name} of a bound kernel is what the compiled code works on; write into it: k.{name}[:] = ...",
                name=name,
            )
        super().__setattr__(name, value)

    def __reduce__(self) -> NoReturn:
        raise UsageError(
            "bound arrays are those of one controller, so they cannot be copied or pickled; compile its law again "
            "and bind that: taut.compile(ctrl.law, ctrl.arm, rate=ctrl.rate).bind()"
        )
