"""Calls of a controller that need Python: what was passed to `step`, checked; and the bound arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NoReturn

import numpy as np

from taut.base.checks import finite_array, float_array
from taut.base.errors import UsageError, unknown_name
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.kernel import Kernel
from taut.control.lawside import LawSide
from taut.control.trajectories.reference import Sample, Trajectory
from taut.maths.snapshot import AT_TOOL, MEASUREMENTS

WHY: Final = {
    "v": ", measured velocities, unless compiled with sensing=taut.Sensing(velocity='difference')",
    "F_ext": ", which the law asks for: pass F_ext= or F_app=",
} | {name: f", which the law asks for: pass {name}=" for name in MEASUREMENTS if name != "F_ext"}
"""Reason why a measurement is needed and, where there is one, the alternative, for messages."""


def step_arguments(side: LawSide, args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """The measurements by name, and the sample of the reference or None."""
    known = ("q", "v", "ref", "F_app", *MEASUREMENTS)
    positional: tuple[str, ...] = known[:3]
    if len(args) == 2 and isinstance(args[1], Sample):
        positional = ("q", "ref")
    if len(args) > len(positional):
        raise UsageError(f"step takes {', '.join(positional)}; got {len(args)} positional arguments")
    given = dict(zip(positional, args, strict=False))
    for name, value in kwargs.items():
        if name not in known:
            raise unknown_name("step", "argument", name, known)
        if name in given:
            raise UsageError(f"step got {name} twice", name=name)
        given[name] = value
    if given.get("F_app") is not None:
        if given.get("F_ext") is not None:
            raise UsageError("step takes F_ext or F_app, not both: one is minus the other", name="F_app")
        given["F_ext"] = -finite_array("F_app", given.pop("F_app"), shape=(6,), unit="N, N m")
    given.pop("F_app", None)
    ref = given.pop("ref", None)
    measured = {name: value for name, value in given.items() if value is not None}
    for name in ("q", *side.needs):
        if name not in measured:
            raise UsageError(f"step needs {name}{WHY.get(name, '')}; got none", name=name)
    for name in measured:
        if name not in ("q", *side.takes):
            raise UsageError(
                f"step got {name}, which this controller does not use"
                f"{'; its sensing makes v from positions' if name == 'v' else ''}; leave it out",
                name=name,
            )
    return measured, ref


def sample_arguments(side: LawSide, ref: Any) -> dict[str, Any]:
    """The fields of the sample that a law follows, by the path of the input."""
    kind = side.law.reference
    if ref is None and side.law.ignores_reference:
        return {}
    taken = kind.taken(ref)
    if taken is None:
        hint = "; for a trajectory pass ref.at(t)" if isinstance(ref, Trajectory) else ""
        got = "none" if ref is None else type(ref).__name__
        raise UsageError(f"step needs ref, a taut.{kind.described()}; got {got}{hint}", name="ref")
    return {f"ref.{field}": getattr(taken, field) for field in kind.fields(side.arm.n)}


def checked_arguments(
    side: LawSide, given: Mapping[str, Any], inputs: Mapping[str, Float64Array], tick: int
) -> dict[str, Float64Array]:
    """Arguments as arrays in the shapes of the inputs, by path."""
    joints = side.arm.joint_names
    checked = {
        path: float_array(path, value, shape=inputs[path].shape, joints=None if path in AT_TOOL else joints)
        for path, value in given.items()
    }
    side.check_finite(checked, tick)
    return checked


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
        self.command: Float64Array = next(iter(kernel.blocks.views("outputs").values()))
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
