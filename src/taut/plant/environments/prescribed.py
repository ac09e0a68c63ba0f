"""What a hand wants over time: one frequency, or a band of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from taut.base.errors import RangeError, UsageError
from taut.base.quantity import Quantity
from taut.base.types import ArrayLike, Float64Array, Vector, Vector3
from taut.plant.environments.numbers import keep_axes
from taut.trace import math as tm

__all__ = ["BandNoise", "Oscillation", "Will"]

Values = Mapping[str, Any]
MOST_TONES = 64


@runtime_checkable
class Will(Protocol):
    """Three numbers over time, of phases that go on at rates: a change of a frequency makes no jump."""

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        ...

    def start(self) -> Float64Array:
        """(k,) phases at the start [rad]."""
        ...

    def rates(self, parameters: Values) -> Vector:
        """(k,) rates of the phases [rad/s]."""
        ...

    def value(self, phases: Vector, parameters: Values) -> Vector3:
        """(3,) what is wanted, in world axes."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Oscillation:
    """One frequency.

    Law:          wanted = amplitude sin(2 pi frequency t + phase)

    Args:
        amplitude: (3,) or scalar, in world axes [m] of a motion, [N] of a force.
        frequency: [Hz]. A change of it makes no jump.
        phase: [rad].
    """

    title: ClassVar[str] = "oscillation"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "amplitude": Quantity(unit="m | N"),
        "frequency": Quantity(unit="Hz", rule=">= 0"),
        "phase": Quantity(unit="rad"),
    }

    amplitude: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = 0.0

    def __post_init__(self) -> None:
        keep_axes(self, "amplitude")

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        return {name: np.asarray(getattr(self, name)) for name in self.quantities}

    def start(self) -> Float64Array:
        """(1,) phase at the start [rad]."""
        return np.zeros(1)

    def rates(self, parameters: Values) -> Vector:
        """(1,) [rad/s]."""
        return tm.array([2.0 * math.pi * parameters["frequency"]])

    def value(self, phases: Vector, parameters: Values) -> Vector3:
        """(3,) what is wanted, in world axes."""
        swing = tm.sin(phases[0] + parameters["phase"])
        return parameters["amplitude"] * swing + np.zeros(3)  # type: ignore[no-any-return]


@dataclass(frozen=True, kw_only=True, eq=False)
class BandNoise:
    """A band of frequencies with phases from a seed: smooth, and the same in every run.

    Law:          wanted_j = rms_j sqrt(2 / tones) sum_i sin(2 pi f_i t + phase_ij), one f_i in each of `tones` equal
                  parts of the band from low to high

    Args:
        rms: (3,) or scalar, in world axes [m] of a motion, [N] of a force.
        low: Lowest frequency [Hz].
        high: Highest frequency [Hz].
        seed: Of frequencies and phases.
        tones: How many frequencies.
    """

    title: ClassVar[str] = "noise"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "rms": Quantity(unit="m | N", rule=">= 0"),
        "low": Quantity(unit="Hz", rule=">= 0"),
        "high": Quantity(unit="Hz", rule="> 0", instead="it ends the band"),
    }

    rms: ArrayLike
    low: ArrayLike
    high: ArrayLike
    seed: int = 0
    tones: int = 8

    def __post_init__(self) -> None:
        keep_axes(self, "rms")
        if np.asarray(self.low) > np.asarray(self.high):
            raise RangeError(
                f"noise.low must be <= noise.high, {float(np.asarray(self.high)):g} [Hz]; got "
                f"{float(np.asarray(self.low)):g}",
                name="low",
            )
        for name, least, most in (("seed", 0, None), ("tones", 1, MOST_TONES)):
            number = getattr(self, name)
            if isinstance(number, bool) or not isinstance(number, int):
                raise UsageError(f"noise.{name} must be a whole number; got {number!r}", name=name)
            if number < least or (most is not None and number > most):
                rule = f">= {least}" if most is None else f"between {least} and {most}"
                raise RangeError(f"noise.{name} must be {rule}; got {number}", name=name)

    def _drawn(self) -> tuple[Float64Array, Float64Array]:
        """Places of the frequencies in the band, in [0, 1), and (tones, 3) phases [rad]."""
        rng = np.random.default_rng(self.seed)
        places = (np.arange(self.tones) + rng.random(self.tones)) / self.tones
        return places, rng.uniform(0.0, 2.0 * math.pi, (self.tones, 3))

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        return {name: np.asarray(getattr(self, name)) for name in self.quantities}

    def start(self) -> Float64Array:
        """(tones,) phases at the start [rad]."""
        return np.zeros(self.tones)

    def rates(self, parameters: Values) -> Vector:
        """(tones,) [rad/s]."""
        places, _ = self._drawn()
        band = parameters["high"] - parameters["low"]
        return 2.0 * math.pi * (parameters["low"] + band * places)  # type: ignore[no-any-return]

    def value(self, phases: Vector, parameters: Values) -> Vector3:
        """(3,) what is wanted, in world axes."""
        _, offsets = self._drawn()
        total = sum(tm.sin(phases[i] + offsets[i]) for i in range(self.tones))
        return parameters["rms"] * (math.sqrt(2.0 / self.tones) * total)  # type: ignore[no-any-return]
