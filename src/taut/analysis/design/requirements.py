"""What was asked of a design, what the sampled loop has of it, and whether it is met."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.analysis.design.asked import BAND, SPEEDS, Asked
from taut.analysis.design.contact import Pressed
from taut.analysis.design.directions import Direction
from taut.analysis.design.limits import Tried, largest_steps
from taut.analysis.design.stiffness import STATIC, Stiff
from taut.analysis.design.trial import Response
from taut.linear.linearise import Linearisation

__all__ = ["Requirement", "of_force_and_step", "of_motion"]

TOLERANCE: Final = 0.05  # of a number that was asked for: within it it is met
OVERSHOOT: Final = 1.0  # [%] of the step that an overshoot may exceed what was asked for by besides
UNITS: Final = {"zeta": "", "overshoot": "%", **SPEEDS}
STAYS: Final = 1e-6  # [1/s] a pole that is slower stays


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """One number that was asked for, in one direction.

    Args:
        name: As it was asked for: "zeta", "overshoot", "omega_n", "settling", "bandwidth", "K", "force" or "step".
        direction: The joint, the direction of the tool, or the mode.
        unit: Of both numbers; empty for none.
        asked: The number that was asked for.
        got: That of the linear model of the sampled loop; NaN where a run is too short to show it. Of a step the
            largest that keeps within the limits of the joints.
        met: Whether it is within 5 %, a stiffness within 1 %; a settling time or an overshoot may be less. Over
            several poses damping and speed may be more.
    """

    name: str
    direction: str
    unit: str
    asked: float
    got: float
    met: bool

    @classmethod
    def of(
        cls, name: str, direction: str, unit: str, asked: float, got: float, *, several: bool = False
    ) -> Requirement:
        """With the verdict, `several` where the design is for other poses too; NaN is not met."""
        if name in ("settling", "overshoot"):
            met = got <= asked * (1.0 + TOLERANCE) + (OVERSHOOT if name == "overshoot" else 0.0)
        elif name == "step":
            met = got >= asked
        else:
            least = min(asked, 1.0) if name == "zeta" else asked  # two real poles have no less than 1
            met = got >= least * (1.0 - TOLERANCE) and (several or got <= asked * (1.0 + TOLERANCE))
        return cls(name=name, direction=direction, unit=unit, asked=float(asked), got=float(got), met=bool(met))


def of_motion(
    asked: Asked,
    size: int,
    directions: tuple[Direction, ...],
    predicted: tuple[Response, ...],
    lin: Linearisation,
    *,
    several: bool,
) -> tuple[Requirement, ...]:
    """Damping and speed at one of several poses, in each direction; of a law without any that of the slowest motion.

    A speed may be one number for each of `size` joints or coordinates of the tool.
    """
    found = []
    for name, unit in UNITS.items():
        if getattr(asked, name) is None:
            continue
        each = np.asarray(getattr(asked, name), dtype=np.float64)
        each = np.repeat(each, 3) if each.shape == (2,) and size == 6 else each  # (linear, angular)
        wanted = np.broadcast_to(each, (size,))
        rows = [(d.name, wanted[d.axis], _got(name, d, p)) for d, p in zip(directions, predicted, strict=True)]
        if not directions:
            slowest = min((-mode.s.real for mode in lin.modes if abs(mode.s) > STAYS), default=math.nan)
            got = math.log(BAND) / slowest if name == "settling" else slowest
            rows = [("the slowest motion", (np.max if name == "settling" else np.min)(wanted), got)]
        found += [Requirement.of(name, where, unit, number, got, several=several) for where, number, got in rows]
    return tuple(found)


def _got(name: str, d: Direction, response: Response) -> float:
    """That of a step; the bandwidth of a force is its slowest pole, as it is asked for."""
    if name == "bandwidth" and d.unit in ("N", "N m"):
        return float(np.abs(response.poles).min())
    return float(getattr(response.numbers, name))


def of_force_and_step(
    asked: Asked, tried: Tried, stiffness: tuple[Stiff, ...], forces: tuple[Pressed, ...], *, step: bool
) -> tuple[Requirement, ...]:
    """A stiffness, the pole of a force and a step, where they were asked for.

    A stiffness is met where it is what all of K makes of the motions that the arm has.
    """
    found: list[Requirement] = []
    for each in stiffness if asked.K is not None else ():
        met = abs(each.predicted / each.designed - 1.0) <= STATIC
        row = Requirement.of("K", each.direction, each.unit, each.asked, each.predicted)
        found.append(dataclasses.replace(row, met=met))
    directions = tried.directions
    if asked.force is not None:
        slow = [(d.name, np.abs(p.poles).min()) for d, p in zip(directions, tried.predicted, strict=True)]
        rows = [(each.direction, each.predicted.omega_n) for each in forces] or slow
        found += [Requirement.of("force", name, "1/s", asked.force, got) for name, got in rows]
    for d, size, (most, _) in zip(directions, tried.steps, largest_steps(tried), strict=True) if step else ():
        found.append(Requirement.of("step", d.name, d.unit, size * d.per_unit, most * d.per_unit))
    return tuple(found)
