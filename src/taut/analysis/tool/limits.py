"""Which stiffness is safe: limits of stability and passivity of a virtual spring, in one direction or in all."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taut.analysis.tool.passivity import largest_passive, spare_damping, spare_damping_in_band
from taut.base.checks import finite_scalar, positive_scalar, rate_in_hertz
from taut.base.errors import RangeError
from taut.base.types import ArrayLike
from taut.linear.sampled import Integrator, SampledLoop, VelocityKind, square

__all__ = ["StiffnessCheck", "StiffnessLimits", "check_stiffness", "stiffness_limits"]


@dataclass(frozen=True, kw_only=True, eq=False)
class StiffnessLimits:
    """How stiff a virtual spring may be in one direction, by what of it; print it for a sentence of each.

    Args:
        loop: The sampled loop, with K = 1.
        band: [Hz] of the motions that `passive_in_band` speaks of.
        unit: Of a stiffness.
        damping: What the physical damping of the loop is.
    """

    loop: SampledLoop
    band: float
    unit: str = "N/m"
    damping: str = "physical damping"

    @cached_property
    def stable(self) -> float:
        """Up to which nothing that is set off grows, alone: by eigenvalues of the sampled loop."""
        return self.loop.largest_stable()

    @cached_property
    def passive(self) -> float:
        """Up to which no passive environment makes it unstable; 0 if there is none such."""
        return largest_passive(self.loop)

    @cached_property
    def passive_in_band(self) -> float:
        """Up to which no motion below `band` gets energy out of it."""
        return largest_passive(self.loop, self.band, everything=False)

    @property
    def formula_stable(self) -> float:
        """(b + B) / (T/2 + delay): right for light loops only, and elsewhere mostly too high."""
        b, B = self._dampings
        return max(b + B, 0.0) / (0.5 * self.loop.T + self.loop.delay)

    @property
    def formula_passive(self) -> float:
        """(b - abs(B)) / (T/2 + delay), from b > K (T/2 + delay) + abs(B), Colgate's where there is no delay."""
        b, B = self._dampings
        return max(b - abs(B), 0.0) / (0.5 * self.loop.T + self.loop.delay)

    @property
    def lightness(self) -> float:
        """(b + B) (T + delay) / m: formula_stable is within 2 % of `stable` up to 0.02, within 5 % up to 0.05."""
        b, B = self._dampings
        return (b + B) * (self.loop.T + self.loop.delay) / float(np.asarray(self.loop.mass)[0, 0])

    @property
    def _dampings(self) -> tuple[float, float]:
        return float(np.asarray(self.loop.damping)[0, 0]), float(np.asarray(self.loop.B)[0, 0])

    @property
    def sentences(self) -> tuple[str, ...]:
        """One for each limit."""
        unit, formula = self.unit, self.formula_stable
        off = f", {100.0 * (formula / self.stable - 1.0):+.1f} %" if 0.0 < self.stable < math.inf else ""
        stable = (
            f"stable by itself up to {_number(self.stable)} {unit}, by the eigenvalues of the sampled loop; "
            f"(b + B) / (T/2 + delay) says {_number(formula)} {unit}{off}"
            if self.stable > 0.0
            else "unstable with every stiffness: damping or delay alone are too much for this rate"
        )
        b, B = self._dampings
        if self.passive > 0.0:
            passive = f"stable with every passive environment up to {_number(self.passive)} {unit}"
        elif b == 0.0:
            passive = "no stiffness is stable with every passive environment: the arm has no damping of its own"
        elif B != 0.0 and not self.loop.differenced:
            passive = (
                "no stiffness is stable with every passive environment, for velocity is measured, and resonances "
                "above the rate live between its ticks"
            )
        else:
            passive = "no stiffness is stable with every passive environment: B needs more damping than the arm has"
        return (
            stable,
            f"{passive}; (b - |B|) / (T/2 + delay) says {_number(self.formula_passive)} {unit}",
            f"gives no energy to motion below {self.band:g} Hz up to {_number(self.passive_in_band)} {unit}",
            *([f"all of this relies on the {self.damping}, b = {b:.4g} {unit.replace('/', ' s/')}"] if b else []),
        )

    def __str__(self) -> str:
        return "\n".join(self.sentences)


def stiffness_limits(
    *,
    mass: float,
    damping: float = 0.0,
    B: float = 0.0,
    rate: float = 1000.0,
    delay: float = 0.0,
    velocity: VelocityKind = "measured",
    integrator: Integrator = "exact",
    substeps: int = 1,
    band: float | None = None,
) -> StiffnessLimits:
    """How stiff a virtual spring u = K x + B v may be that sees a mass once in a period.

    Args:
        mass: [kg | kg m^2]
        damping: Physical damping b [N s/m | N m s/rad].
        B: Of the virtual damper, likewise.
        rate: [Hz].
        delay: [s] from the tick to the force, beyond the hold; whole periods or not.
        velocity: "measured", "difference", `taut.sensors.LowPass(...)`, `taut.sensors.Difference(cutoff=...)`.
        integrator: "exact" for the real world, "semi-implicit-euler" for what `RigidPlant` simulates.
        substeps: Of that integrator in a period.
        band: [Hz] of the motions for `passive_in_band`; half the rate if left out.

    Raises:
        RangeError, ShapeError, UsageError: A number that has no meaning, by name.

    Example:
        >>> import taut
        >>> limits = taut.analysis.stiffness_limits(mass=0.2, damping=1.0, B=0.5, velocity="difference")
        >>> round(limits.stable), round(limits.passive), round(limits.passive_in_band)
        (2995, 1000, 2404)
        >>> print(limits.sentences[1])
        stable with every passive environment up to 1000 N/m; (b - |B|) / (T/2 + delay) says 1000 N/m

    References:
        Colgate and Schenkel, Passivity of a class of sampled-data systems (1997). Chapter, section 10.5.1.
    """
    for name, value, unit in (("mass", mass, "kg"), ("damping", damping, "N s/m"), ("B", B, "N s/m")):
        finite_scalar(name, value, unit=unit)
    loop = SampledLoop(
        mass=mass, damping=damping, K=1.0, B=B, rate=rate, delay=delay, velocity=velocity,
        integrator=integrator, substeps=substeps,
    )  # fmt: skip
    return StiffnessLimits(loop=loop, band=checked_band(band, loop.rate))


@dataclass(frozen=True, kw_only=True, eq=False)
class StiffnessCheck:
    """Whether a virtual spring and damper are safe, in all directions at once; print it for a sentence of each.

    Args:
        loop: The sampled loop.
        band: [Hz] of the motions that `passive_in_band` speaks of.
        damping: What the physical damping of the loop is, for `relies_on`.
    """

    loop: SampledLoop
    band: float
    damping: str = "physical damping"

    @cached_property
    def relies_on(self) -> tuple[str, ...]:
        """The physical damping without which one of the verdicts would be another; empty where none is needed."""
        if not np.any(np.asarray(self.loop.damping)):
            return ()
        bare = dataclasses.replace(self, loop=dataclasses.replace(self.loop, damping=0.0))
        verdicts = [(check.stable, check.passive, check.passive_in_band) for check in (self, bare)]
        return (self.damping,) if verdicts[0] != verdicts[1] else ()

    @cached_property
    def stable(self) -> bool:
        """Whether no small deviation grows."""
        return self.loop.stable

    @cached_property
    def spare_damping(self) -> float:
        """Physical damping above what every passive environment needs; negative where one makes it unstable."""
        return spare_damping(self.loop)

    @cached_property
    def spare_in_band(self) -> float:
        """Physical damping above what keeps motion below `band` from getting energy out."""
        return spare_damping_in_band(self.loop, self.band)

    @property
    def passive(self) -> bool:
        """Whether no passive environment makes it unstable."""
        return self.spare_damping >= -self._rounding

    @property
    def passive_in_band(self) -> bool:
        """Whether it is stable, and no motion below `band` gets energy out of it."""
        return self.stable and self.spare_in_band >= -self._rounding

    @property
    def _rounding(self) -> float:
        return 1e-9 * float(np.abs(np.asarray(self.loop.damping)).max())

    @cached_property
    def stable_up_to(self) -> float:
        """The factor on K up to which it is stable."""
        return self.loop.largest_stable()

    @cached_property
    def passive_up_to(self) -> float:
        """The factor on K up to which no passive environment makes it unstable."""
        return largest_passive(self.loop)

    @cached_property
    def passive_in_band_up_to(self) -> float:
        """The factor on K up to which it is stable and no motion below `band` gets energy out of it."""
        return min(self.stable_up_to, largest_passive(self.loop, self.band, everything=False))

    @property
    def sentences(self) -> tuple[str, ...]:
        """One for each question, and one for the damping that the answers rely on."""
        answers = (
            _answer(self.stable, "stable by itself", "unstable by itself", self.stable_up_to),
            _answer(
                self.passive,
                "stable with every passive environment",
                "some passive environment makes it unstable",
                self.passive_up_to,
            ),
            _answer(
                self.passive_in_band,
                f"gives no energy to motion below {self.band:g} Hz",
                f"gives energy to some motion below {self.band:g} Hz",
                self.passive_in_band_up_to,
            ),
        )
        if not self.relies_on:
            return answers
        sizes = np.linalg.eigvalsh(np.asarray(self.loop.damping))
        bare = dataclasses.replace(self.loop, damping=0.0)
        return (
            *answers,
            f"this relies on the {self.damping}, {_number(sizes[0])} to {_number(sizes[-1])}; without it the loop is "
            f"{'stable' if bare.stable else 'unstable'} by itself",
        )

    def __str__(self) -> str:
        return "\n".join(self.sentences)


def check_stiffness(
    Lambda: ArrayLike,
    *,
    K: ArrayLike,
    B: ArrayLike = 0.0,
    damping: ArrayLike = 0.0,
    rate: float = 1000.0,
    delay: float = 0.0,
    velocity: VelocityKind = "measured",
    integrator: Integrator = "exact",
    substeps: int = 1,
    band: float | None = None,
) -> StiffnessCheck:
    """Whether a virtual spring and damper u = K x + B v are safe for a mass that they see once in a period.

    Args:
        Lambda: (n, n), (n,) or a number [kg | kg m^2]: the inertia that they act on, at the tool of an arm.
        K: Stiffness, likewise.
        B: Damping, likewise.
        damping: Physical damping, likewise.
        rate: [Hz].
        delay: [s] from the tick to the force, beyond the hold.
        velocity: "measured", "difference", `taut.sensors.LowPass(...)`, `taut.sensors.Difference(cutoff=...)`.
        integrator: "exact" for the real world, "semi-implicit-euler" for what `RigidPlant` simulates.
        substeps: Of that integrator in a period.
        band: [Hz] of the motions for `passive_in_band`; half the rate if left out.

    Raises:
        RangeError, ShapeError, UsageError: A number that has no meaning, by name.

    Example:
        >>> import numpy as np, taut
        >>> check = taut.analysis.check_stiffness(np.diag([2.0, 0.5]), K=[3000.0, 100.0], damping=1.0)
        >>> check.stable, round(check.stable_up_to, 3), check.passive
        (False, 0.667, False)
    """
    mass = square("Lambda", Lambda, unit="kg")
    n = len(mass)
    matrices = {name: square(name, value, n) for name, value in (("K", K), ("B", B), ("damping", damping))}
    loop = SampledLoop(
        mass=mass, **matrices, rate=rate, delay=delay, velocity=velocity, integrator=integrator, substeps=substeps
    )
    return StiffnessCheck(loop=loop, band=checked_band(band, loop.rate))


def checked_band(band: float | None, rate: float) -> float:
    """A band in Hz, at most half the rate, which it is if left out; the rate is a user's."""
    rate_in_hertz(rate)
    if band is None:
        return 0.5 * rate
    value = positive_scalar("band", band, unit="Hz")
    if value > 0.5 * rate:
        raise RangeError(
            f"band must be at most {0.5 * rate:g} [Hz], half the rate; got {value:g}", name="band", value=value
        )
    return value


def _number(value: float) -> str:
    return "any" if math.isinf(value) else f"{value:.4g}"


def _answer(good: bool, yes: str, no: str, factor: float) -> str:
    if math.isinf(factor):
        return f"{yes}, with any multiple of K" if good else no
    if good:
        return f"{yes}, up to {factor:.3g} K" if factor > 0.0 else yes
    return f"{no}; up to {factor:.3g} K it is not so" if factor > 0.0 else f"{no}, with any part of K"
