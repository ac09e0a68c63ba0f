"""The state of a controller between its ticks, and the parameters that may change there."""

from __future__ import annotations

from enum import Enum
from typing import NoReturn

import numpy as np

from taut.arm.parts import require_radians
from taut.base.checks import finite_array
from taut.base.errors import UsageError
from taut.base.paths import Parameters, subtree
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.kernel import Kernel
from taut.control.lawside import HELD, KNOWN, LawSide
from taut.controller.kernel import not_finite


class State(Enum):
    """States of a controller, each with the first action of its next tick."""

    FRESH = "it starts the memory from what is measured"
    RUNNING = "nothing: it goes on with the memory that there is"
    CHANGED = "it takes up the jump that new parameters would make"


class StateMachine:
    """The state of a controller between its ticks: the only place that changes it.

    FRESH    -- the first tick -->                                RUNNING
    RUNNING  -- a new parameter whose jump a blend takes up -->   CHANGED
    CHANGED  -- the next tick -->                                 RUNNING
    any      -- reset -->                                         FRESH

    A tick that fails leaves the state, and the memory, as they were. Only in RUNNING the generated code takes a tick
    by itself; in the other states it calls `first`.
    """

    kernel: Kernel  # given once, before the first tick

    def __init__(self, side: LawSide) -> None:
        self._side = side
        self.state = State.FRESH
        self._torque_at_start: Float64Array | None = None  # what the plant holds, for the first tick
        self._last: tuple[int, Float64Array] | None = None  # a tick, and the parameters of the tick before it

    @property
    def started(self) -> bool:
        """True after the first tick, when there is a memory to go on with."""
        return self.state is not State.FRESH

    def _enter(self, state: State) -> None:
        self.state = state
        if state is State.RUNNING:
            self.kernel.resume()
        else:
            self.kernel.clear()

    def reset(self, tau_applied: ArrayLike | None) -> None:
        """Forget everything; the first tick is given the torque that the plant holds, if it is known."""
        if tau_applied is not None:
            if "limits.tau_applied" not in self._side.probe.shapes:
                raise UsageError(
                    "reset(tau_applied=) is for controllers that limit the torque rate or blend, or whose law asks "
                    "for x.tau_applied; this one does none of these",
                    name="tau_applied",
                )
            arm = self._side.arm
            tau_applied = finite_array(
                "tau_applied", tau_applied, shape=(arm.n,), unit="N m | N", joints=arm.joint_names
            )
        self._torque_at_start = tau_applied
        self._enter(State.FRESH)

    def change(self, path: str, value: Float64Array) -> None:
        """Give a parameter a new value, which acts from the next tick on."""
        kernel = self.kernel
        if self._last is None or self._last[0] != kernel.count:
            self._last = (kernel.count, kernel.blocks.parameters.copy())
        kernel.blocks.views("parameters")[path][...] = value
        if self.state is State.RUNNING and self._side.blends((path,)):
            self._enter(State.CHANGED)

    def parameters_of_last_tick(self) -> Float64Array:
        """All parameters as the last tick used them, flat."""
        if self._last is not None and self._last[0] == self.kernel.count:
            return self._last[1]
        return self.kernel.blocks.parameters

    def first(self) -> None:
        """A tick in another state than RUNNING."""
        with self.kernel.alone:
            state, memory = self.state, self.kernel.blocks.memory.copy()
            try:
                if state is State.CHANGED:
                    self._enter(State.RUNNING)
                    take_up_change(self.kernel, self.parameters_of_last_tick())
                else:
                    self._start()
                self.kernel.tick()
            except Exception:
                self.kernel.blocks.memory[:] = memory
                self._enter(state)  # nothing has happened yet
                raise
            self._torque_at_start = None

    def failed(self) -> NoReturn:
        """Raise the error of a tick whose numbers are not finite."""
        raise not_finite(self._side, self.kernel)

    def _start(self) -> None:
        """Start memory from the inputs, and from the torque that the plant holds."""
        inputs, side = self.kernel.blocks.views("inputs"), self._side
        for path in ("q", "ref.q"):  # in the first tick alone: nothing must stop an arm that moves already
            if path in inputs:
                require_radians(path, inputs[path], side.arm)
        ref = side.law.reference.of(subtree({path: np.array(value) for path, value in inputs.items()}, "ref"))
        side.check_start(inputs["q"].copy(), self.kernel.blocks.views("parameters"), ref)
        if KNOWN in inputs:
            known = self._torque_at_start
            inputs[KNOWN][...] = known is not None
            inputs[HELD][...] = 0.0 if known is None else known
        self.kernel.start()
        self._last = None
        self._enter(State.RUNNING)


def take_up_change(kernel: Kernel, before: Float64Array) -> None:
    """Change memory so that the next tick commands what it would have with the parameters of before."""
    from taut.control.limits import take_up

    asked = [kernel.preview(values)["limits.asked"] for values in (before, kernel.blocks.parameters)]
    take_up(kernel.blocks.views("memory"), *asked)


class ControllerParameters(Parameters):
    """Parameters of a controller from the next tick on; what depends on the pose is checked at that of the last."""

    def __init__(self, side: LawSide, machine: StateMachine) -> None:
        self.views = machine.kernel.blocks.views("parameters")
        """The numbers that the compiled code reads."""
        super().__init__("the controller", {path: self.views[path] for path in side.parameters})
        self._side, self._machine = side, machine

    def __setitem__(self, path: str, value: ArrayLike) -> None:
        checked = self._side.checked_parameter(path, value)
        if self._machine.started:  # then it is known where the arm was in the last tick
            blocks = self._machine.kernel.blocks
            q = blocks.layout["inputs"].views(blocks.seen)["q"].copy()
            self._side.check_change(q, self.views, {path: checked})
        self._machine.change(path, checked)

    def __repr__(self) -> str:
        return "{" + ", ".join(f"'{path}': {short(value)}" for path, value in self.items()) + "}"

    def __reduce__(self) -> NoReturn:
        raise UsageError(
            "the parameters of a controller are what its machine code reads, so they cannot be copied or pickled; "
            "take dict(ctrl.parameters), and parameters.update(...) of another controller"
        )


def short(value: Float64Array) -> str:
    """A parameter's value in one line."""
    if value.ndim == 0:
        return f"{float(value):g}"
    return np.array2string(value, precision=6, separator=", ", threshold=20).replace("\n", " ")
