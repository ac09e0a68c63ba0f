"""Quantity: what a number of a sensor or a filter may be, checked alike when it is made and when it is changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, Protocol

import numpy as np

from taut.base.checks import entry_names, finite_array
from taut.base.errors import RangeError, ShapeError
from taut.base.types import ArrayLike, Float64Array

__all__ = ["FORCE_AND_MOMENT", "Quantified", "Quantity", "keep_quantities", "six_of"]

Rule = Literal["finite", ">= 0", "> 0", "> 0 somewhere"]
FORCE_AND_MOMENT: Final = "N, N m"


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One number, or one for each of several things.

    Args:
        unit: Its unit, for messages.
        rule: "finite" for any; "> 0 somewhere" for numbers whose zeros stand for none, which not all may be.
        instead: How to fix it, in a message about a number that is not above zero.
        infinite: Whether infinity is allowed.
    """

    unit: str
    rule: Rule = "finite"
    instead: str = ""
    infinite: bool = False

    def checked(self, name: str, value: ArrayLike, *, joints: Sequence[str] | None = None) -> Float64Array:
        """The value as floats, read-only.

        Args:
            name: What messages call it.
            value: A scalar, or one number for each.
            joints: Names of the entries, where they belong to joints.

        Raises:
            ShapeError: Not numbers, or a matrix.
            RangeError: NaN, infinite where it must not be, or against the rule.
        """
        values = finite_array(name, value, unit=self.unit, allow_infinite=self.infinite)
        if values.ndim > 1:
            raise ShapeError(f"{name} must be one number, or one for each; got shape {values.shape}", name=name)
        whose = joints if joints is not None and values.shape == (len(joints),) else None
        if self.rule == ">= 0":
            self._refuse(name, values, values < 0.0, ">= 0", whose)
        elif self.rule == "> 0":
            self._refuse(name, values, values <= 0.0, "> 0", whose)
        elif self.rule == "> 0 somewhere":
            if values.ndim == 0:
                self._refuse(name, values, values <= 0.0, "> 0", whose)
            self._refuse(name, values, values < 0.0, ">= 0", whose)
            if not values.any():
                raise RangeError(
                    f"{name} must be > 0 for one entry at least [{self.unit}]; got {values.tolist()}{self._way_out}",
                    name=name,
                    value=0.0,
                    rule="> 0 somewhere",
                )
        return values

    @property
    def _way_out(self) -> str:
        return f"; {self.instead}" if self.instead else ""

    def _refuse(self, name: str, values: Float64Array, wrong: Any, rule: str, joints: Sequence[str] | None) -> None:
        if not np.any(wrong):
            return
        index = [int(i) for i in np.argwhere(np.atleast_1d(wrong))[0]] if values.ndim else []
        value = float(values[tuple(index)])
        raise RangeError(
            f"{entry_names(name, index, joints)} must be {rule} [{self.unit}]; got {value!r}"
            f"{self._way_out if value == 0.0 else ''}",
            name=name,
            joint=joints[index[0]] if joints is not None and index else None,
            value=value,
            rule=rule,
        )


class Quantified(Protocol):
    """A frozen dataclass of quantities, some of which may be None."""

    title: ClassVar[str]
    """What messages call it."""
    quantities: ClassVar[Mapping[str, Quantity]]


def keep_quantities(thing: Quantified) -> None:
    """Check the fields of a frozen dataclass that is being made, and keep read-only copies of them."""
    for name, quantity in thing.quantities.items():
        value = getattr(thing, name)
        if value is not None:
            object.__setattr__(thing, name, quantity.checked(f"{thing.title}.{name}", value))


def six_of(name: str, quantity: Quantity, value: ArrayLike) -> Float64Array:
    """(6,) numbers of a wrench from (force, moment) or six; forces and moments have no number in common.

    Raises:
        ShapeError: Neither two nor six.
        RangeError: Against the quantity's rule.
    """
    values = quantity.checked(name, value)
    if values.shape not in ((2,), (6,)):
        raise ShapeError(
            f"{name} must be (force, moment) or six numbers [{quantity.unit}]; got shape {values.shape}", name=name
        )
    out = np.repeat(values, 3) if values.shape == (2,) else values
    out.flags.writeable = False
    return out
