"""How the arm moves between the ticks while a design is tried: all the time, or in the steps of a plant."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.analysis.design.directions import weight_gradient
from taut.arm.description import Arm
from taut.base.types import Float64Array
from taut.maths.snapshot import Snapshot
from taut.plant.rigid import Integrator, RigidPlant

__all__ = ["Motion"]

LONGEST: Final = 5e-3  # [s] of a step of rk4, for what weight does
MOST: Final = 1000  # steps in a period
COARSE: Final = 1.0  # the same at slower ticks, for a stability limit within 1 %
SLOWEST: Final = 0.1  # [Hz] a servo rate below which none is tried
REACH: Final = 0.3  # of a step of rk4 times the fastest rate: its fifth order is below 1e-4 there


@dataclass(frozen=True, kw_only=True)
class Motion:
    """How the arm moves under a torque that is held for a period.

    Args:
        exact: Whether it moves all the time, as a real arm does: rk4 in steps that are short enough.
        integrator: Of the plant.
        substeps: Of it in a period.
        fastest: [1/s] of what friction, a spring at the tool and weight do to the arm; 0 where the steps are its own.
        driven: Whether it follows drives instead of torques.
    """

    exact: bool
    integrator: Integrator
    substeps: int
    fastest: float
    driven: bool

    @classmethod
    def like(
        cls,
        plant: RigidPlant | None,
        arm: Arm,
        at: Iterable[Snapshot],
        dt: float,
        contact: Float64Array | None,
        *,
        driven: bool,
    ) -> Motion:
        """That of a plant; the exact hold without one, or where it has rk4.

        Args:
            plant: The user's own, if there is one.
            arm: With the friction that counts.
            at: Where the design is tried.
            dt: The period [s].
            contact: (6, 6) of a spring at the tool.
            driven: Whether the command goes to drives.
        """
        if driven:  # whose steps are exact by themselves
            return cls(exact=True, integrator="semi-implicit-euler", substeps=1, fastest=0.0, driven=True)
        if plant is not None and plant.integrator != "rk4":
            return cls(exact=False, integrator=plant.integrator, substeps=plant.substeps, fastest=0.0, driven=False)
        fastest = max(_fastest(x, arm.viscous, contact) for x in at)
        wanted = math.ceil(dt * max(1.0 / LONGEST, fastest / REACH) * (1.0 - 1e-9))
        return cls(exact=True, integrator="rk4", substeps=min(max(wanted, 1), MOST), fastest=fastest, driven=False)

    @property
    def one_step(self) -> bool:
        """Whether what joints move by in a period is their speed at its end, times the period."""
        return self.driven or (not self.exact and self.substeps == 1)

    @property
    def slowest_rate(self) -> float:
        """[Hz] of ticks at which its steps are just short enough for what moves the arm between them."""
        return max(SLOWEST, self.fastest / (COARSE * self.substeps))

    @property
    def steps(self) -> str:
        """The steps of a plant, in words."""
        return f"{self.substeps} step{'s' * (self.substeps > 1)} of semi-implicit Euler in a period"

    @property
    def sentence(self) -> str:
        """All of it in words."""
        if self.driven:
            return "the arm follows drives that are as good as ideal"
        if self.exact:
            return "the arm moves all the time under a torque that is held from tick to tick (exact hold)"
        return f"the arm moves in {self.steps}, as plant= does; without plant=, or with its integrator='rk4', exactly"


def _fastest(x: Snapshot, viscous: Float64Array, contact: Float64Array | None) -> float:
    """[1/s] of what friction, weight and a spring at the tool do to the arm."""
    Minv, drawn, J = np.linalg.inv(np.asarray(x.M)), weight_gradient(x), np.asarray(x.J())
    if contact is not None:
        drawn = drawn + J.T @ contact @ J
    rubbed = float(np.abs(np.linalg.eigvals(Minv * viscous)).max())
    return max(rubbed, math.sqrt(float(np.abs(np.linalg.eigvals(Minv @ drawn)).max())))
