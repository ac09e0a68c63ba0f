"""Design: the result of `taut.design`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.analysis.design.achieved import Limit, Requirement, Steps
from taut.analysis.design.specification import Specification
from taut.base.plot_style import INK, SMALL, WIDTH, colour, prepared
from taut.base.result import Content, Result, Table
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.linear.linear_system import LinearSystem

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Design"]

HEIGHT: Final = 3.2  # [inch] of a picture


@dataclass(frozen=True, kw_only=True, eq=False)
class Design(Result):
    """A law with its gains, what was asked for and what the sampled loop has, and the limits of the loop.

    Args:
        law: The law with its gains.
        specification: What was asked for.
        requirements: A row for each number that was asked for, in each direction, at each pose.
        limits: Of the loop, the worst of all poses.
        arm: Name of the arm.
        rate: [Hz].
        poses: (k, n) [rad | m].
        systems: The linear model of the sampled loop at each pose.
        directions: Names of the directions.
        steps: Unit steps at the first pose where something is missed, or at the first; None for an unstable loop.
        unstable: Why the loop is unstable; empty where it is stable.
    """

    law: Law
    specification: Specification
    requirements: tuple[Requirement, ...]
    limits: tuple[Limit, ...]
    arm: str
    rate: float
    poses: Float64Array
    systems: tuple[LinearSystem, ...]
    directions: tuple[str, ...]
    steps: Steps | None
    unstable: str

    @property
    def stable(self) -> bool:
        """Whether the sampled loop is stable at all poses."""
        return not self.unstable

    @property
    def met(self) -> bool:
        """Whether the loop is stable and has all that was asked for."""
        return self.stable and all(each.met for each in self.requirements)

    def got(self, name: str) -> Float64Array:
        """What the loop has of a number that was asked for, in each direction at each pose."""
        return np.array([each.got for each in self.requirements if each.name == name])

    def limit(self, name: str) -> Limit:
        """The limit of a name; the smallest, where each direction has one.

        Raises:
            KeyError: There is none.
        """
        found = [each for each in self.limits if each.name == name]
        if not found:
            raise KeyError(name)
        return min(found, key=lambda each: each.value)

    def content(self) -> Content:
        """The description of the design."""
        missed = [each for each in self.requirements if not each.met]
        several = len(self.poses) > 1
        faults = [self.unstable] if self.unstable else []
        for name in dict.fromkeys(each.name for each in missed if self.stable):
            rows = [each for each in missed if each.name == name]
            places = ", ".join(dict.fromkeys(f"{each.direction} ({each.got:.4g})" for each in rows))
            faults.append(f"{name} is missed: {places}; asked for {rows[0].asked:.4g} {rows[0].unit}".rstrip())
        asked = Table(
            title="asked and got",
            columns=("number", "direction", *(["pose"] * several), "unit", "asked", "got", "met"),
            rows=[
                (each.name, each.direction, *([each.pose] * several), each.unit, each.asked, each.got, each.met)
                for each in self.requirements
            ],
            note="by the linear model of the sampled loop about its equilibrium",
        )
        limits = Table(
            title="limits",
            columns=("limit", "of", "value", "unit"),
            rows=[(each.name, each.where, each.value, each.unit) for each in self.limits],
        )
        gains = Table(
            title="gains",
            columns=("gain", "value"),
            rows=[
                (f"{path}[{i}]" if np.ndim(value) == 2 else path, ", ".join(f"{x:.5g}" for x in np.atleast_1d(row)))
                for path, value in self.law.parameters().items()
                for i, row in enumerate(np.asarray(value) if np.ndim(value) == 2 else [value])
            ],
        )
        words = ", ".join(
            f"{name} = {np.asarray(value).tolist()}" for name, value in self.specification.given.items()
        )
        return Content(
            title=f"{type(self.law).__name__} on {self.arm} at {self.rate:g} Hz, for {words}",
            faults=faults,
            tables=[gains, asked, *([limits] if self.limits else [])],
            figures={} if self.steps is None else {"steps": self._steps},
            settings={"poses": str(np.round(self.poses, 4).tolist()), "rate [Hz]": f"{self.rate:g}"},
        )

    def json(self) -> dict[str, Any]:
        """The result as plain data, with the gains by path."""
        gains = {path: np.asarray(value).tolist() for path, value in self.law.parameters().items()}
        return {**super().json(), "met": self.met, "stable": self.stable, "gains": gains}

    def _steps(self) -> Figure:
        """The error of a unit step in each direction, and the largest command that it takes of a joint."""
        from matplotlib.figure import Figure

        steps = self.steps
        assert steps is not None
        figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        left, right = figure.subplots(1, 2)
        prepared(left, f"{type(self.law).__name__} on {self.arm}: error after a step", "e / e(0)", "t [s]")
        prepared(right, "command of a unit step, largest joint", "[N m | N], of drives [rad/s | m/s]", "t [s]")
        for i, name in enumerate(self.directions):
            left.plot(steps.t, steps.e[:, i], color=colour(i), linewidth=1.3, label=name)
            command = np.abs(steps.command[:, :, i]).max(axis=1)
            right.plot(steps.t, command, color=colour(i), linewidth=1.3)
        left.axhspan(-0.02, 0.02, color=INK, alpha=0.08, linewidth=0.0)
        left.legend(fontsize=SMALL, frameon=False, labelcolor=INK)
        return figure
