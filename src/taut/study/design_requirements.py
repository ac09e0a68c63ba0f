"""What was asked of a design, what the sampled loop has of it, and whether it is met."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.base.types import Float64Array
from taut.study.design_asked import BAND, SHAPES, SPEEDS, Asked
from taut.study.design_contact import Pressed
from taut.study.design_directions import Direction
from taut.study.design_stiffness import STATIC, Stiff
from taut.study.design_trial import Response
from taut.study.linear_loop import LinearLoop

__all__ = ["Requirement", "requirements_of", "force_requirements", "step_requirements", "stiffness_requirements"]

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


def requirements_of(
    asked: Asked,
    size: int,
    directions: tuple[Direction, ...],
    predicted: tuple[Response, ...],
    lin: LinearLoop,
    *,
    several: bool,
) -> tuple[Requirement, ...]:
    """Damping and speed at a pose, in each direction; of a law without directions that of the slowest motion.

    Args:
        asked: The specification.
        size: Joints, or coordinates of the tool, of which a speed may have one each.
        directions: Of the law's error at the pose.
        predicted: Steps of the linear model along them.
        lin: The linear model.
        several: Whether the design is for other poses too.
    """
    found = []
    for name in (*SHAPES, *SPEEDS):
        value = getattr(asked, name)
        if value is None:
            continue
        each = np.asarray(value, dtype=np.float64)
        each = np.repeat(each, 3) if each.shape == (2,) and size == 6 else each  # (linear, angular)
        wanted = np.broadcast_to(each, (size,))
        rows = [
            (d.name, float(wanted[d.axis]), _got(name, d, response))
            for d, response in zip(directions, predicted, strict=True)
        ]
        if not directions:
            slowest = min((-mode.s.real for mode in lin.modes if abs(mode.s) > STAYS), default=math.nan)
            rows = [("the slowest motion", float(wanted.flat[0]), math.log(BAND) / slowest)]
            if name != "settling":
                rows = [("the slowest motion", float(wanted.min()), slowest)]
        found += [
            Requirement(
                name=name, direction=direction, unit=UNITS[name], asked=number, got=got,
                met=_met(name, number, got, several=several),
            )
            for direction, number, got in rows
        ]  # fmt: skip
    return tuple(found)


def _got(name: str, d: Direction, response: Response) -> float:
    """That of a step; the bandwidth of a force is its slowest pole, as it is asked for."""
    if name == "bandwidth" and d.unit in ("N", "N m"):
        return float(np.abs(response.poles).min())
    return float(getattr(response.numbers, name))


def _met(name: str, asked: float, got: float, *, several: bool = False) -> bool:
    """Whether a number is what was asked for; NaN is not."""
    if name in ("settling", "overshoot"):
        return got <= asked * (1.0 + TOLERANCE) + (OVERSHOOT if name == "overshoot" else 0.0)
    least = min(asked, 1.0) if name == "zeta" else asked  # two real poles have no less than 1
    return got >= least * (1.0 - TOLERANCE) and (several or got <= asked * (1.0 + TOLERANCE))


def stiffness_requirements(stiffness: tuple[Stiff, ...]) -> tuple[Requirement, ...]:
    """Of a stiffness that was asked for: met where it is what all of K makes of the motions that the arm has."""
    return tuple(
        Requirement(
            name="K", direction=each.direction, unit=each.unit, asked=each.asked, got=each.predicted,
            met=abs(each.predicted / each.designed - 1.0) <= STATIC,
        )
        for each in stiffness
    )  # fmt: skip


def force_requirements(
    force: float, directions: tuple[Direction, ...], predicted: tuple[Response, ...], forces: tuple[Pressed, ...]
) -> tuple[Requirement, ...]:
    """Of the pole of a force that was asked for: of a law of force on its contact, of a hybrid one each row of it."""
    rows = [(each.direction, each.predicted.omega_n) for each in forces] or [
        (d.name, float(np.abs(response.poles).min())) for d, response in zip(directions, predicted, strict=True)
    ]
    return tuple(
        Requirement(name="force", direction=name, unit="1/s", asked=force, got=got, met=_met("force", force, got))
        for name, got in rows
    )


def step_requirements(
    directions: tuple[Direction, ...], steps: Float64Array, largest: Float64Array
) -> tuple[Requirement, ...]:
    """Of a step that was to keep within the limits of the joints, against the largest that does."""
    return tuple(
        Requirement(
            name="step", direction=d.name, unit=d.unit, asked=float(size) * d.per_unit, got=float(most) * d.per_unit,
            met=bool(size <= most),
        )
        for d, size, most in zip(directions, steps, largest, strict=True)
    )  # fmt: skip
