"""Design: the gains of a law for a specification, what they run into, and what the loop then does."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from taut.analysis.design.contact import Pressed, force_limits
from taut.analysis.design.gears import gear_limits
from taut.analysis.design.limits import DesignLimit, Tried, limits_of
from taut.analysis.design.plant import plant_limits
from taut.analysis.design.requirements import Requirement
from taut.analysis.design.stiffness import Stiff, static_limits
from taut.analysis.design.trial import Numbers, Response
from taut.arm.description import Arm
from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.control.law import Law

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.record.report.page import Page

__all__ = ["Achieved", "AtPose", "Design", "Pressed", "Requirement", "Stiff"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Achieved:
    """One direction of a design: what was designed, and what the loop does.

    Args:
        direction: The joint, the direction of the tool, or the mode.
        unit: Of the error, rad or m; N or N m of a force.
        designed: By the gains and the inertia, in continuous time.
        predicted: By the exact linear model of the sampled loop.
        simulated: In the nonlinear sampled loop, after a small step.
        on_plant: In the plant that was given, after the stated step; None without one.
    """

    direction: str
    unit: str
    designed: Numbers
    predicted: Numbers
    simulated: Numbers
    on_plant: Numbers | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class AtPose:
    """A design at one of its poses.

    Args:
        q: (n,) [rad | m].
        zeta: The least and the largest damping ratio of its directions, predicted for the sampled loop.
        settling: The longest 2 % settling time of them [s].
        stable: Whether the sampled loop is.
        met: Whether the damping and the speed that were asked for are met there.
    """

    q: Float64Array
    zeta: tuple[float, float]
    settling: float
    stable: bool
    met: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """The gains of a law for a specification, what of it is met, the limits, and designed against achieved numbers.

    Print it for all of that; `taut.design` makes it.

    Args:
        law: The law with its gains.
        achieved: Each direction at the pose that is designed for: designed, predicted, simulated.
        requirements: Each number that was asked for in each direction there: asked, got, met.
        q: (n,) that pose, the worst of those asked for [rad | m].
        poses: All of them.
        asked: The specification.
        arm: The arm.
        rate: [Hz].
        alone: The name of the law that was tried by itself, where another one holds it; else empty.
        step: (k,) the steps that the limits speak of.
        responses: (k,) steps of the nonlinear loop, for the plot.
        tried: What the limits are read off.
        stiffness: Where one was asked for, what the loop has at rest.
        forces: Of a hybrid law that feeds the force back, each row of its constraint, tried in contact.
        q_contact: (n,) where that was, the pose nearest to q on the constraint; None without.
    """

    law: Law
    achieved: tuple[Achieved, ...]
    requirements: tuple[Requirement, ...]
    q: Float64Array
    poses: tuple[AtPose, ...]
    asked: dict[str, object]
    arm: Arm
    rate: float
    alone: str
    step: Float64Array
    responses: tuple[Response, ...] = field(repr=False)
    tried: Tried = field(repr=False)
    stiffness: tuple[Stiff, ...] = ()
    forces: tuple[Pressed, ...] = ()
    q_contact: Float64Array | None = None

    @property
    def met(self) -> bool:
        """Whether all that was asked for is met, at all poses."""
        return all(each.met for each in self.requirements) and all(pose.met for pose in self.poses)

    @property
    def motion(self) -> str:
        """How the arm moves between the ticks in what is predicted, simulated, refused and told as a limit."""
        return self.tried.bench.motion.sentence

    @cached_property
    def limits(self) -> tuple[DesignLimit, ...]:
        """What the gains run into, each with a sentence."""
        return (
            *limits_of(self.tried),
            *gear_limits(self.tried),
            *plant_limits(self.tried, tuple(each.on_plant for each in self.achieved), self.step),
            *static_limits(self.stiffness, self.tried.bench.law),
            *force_limits(self.forces, self.rate),
        )

    def limit(self, name: str) -> DesignLimit:
        """The limit of that name.

        Raises:
            UsageError: This design has none such.
        """
        for each in self.limits:
            if each.name == name:
                return each
        raise UsageError(
            f"this design has no limit '{name}'; it has {', '.join(each.name for each in self.limits)}", name=name
        )

    def report(self) -> str:
        """All of it in words; `print(d)` is the same."""
        from taut.analysis.design.words import report

        return report(self)

    def __str__(self) -> str:
        return self.report()

    def json(self) -> dict[str, Any]:
        """As plain values; null for what has no meaning."""
        from taut.analysis.design.words import as_json

        return as_json(self)

    def report_page(self) -> Page:
        """What `taut.report` makes of it."""
        from taut.analysis.design.report import page_of_design

        return page_of_design(self)

    def plot(self) -> Figure:
        """Steps of each direction, simulated over what was designed, and the torque that they take."""
        from taut.analysis.design.plot import plot

        return plot(self)
