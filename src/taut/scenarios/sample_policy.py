"""A stand-in for a learned policy: chunks of poses along a smooth random way, no two of which agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.base.checks import finite_array, positive_scalar, whole_number
from taut.base.errors import RangeError
from taut.base.types import Array, Float64Array
from taut.control.trajectories.samples import Chunk, chunk
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotation_exp
from taut.trace.pose import Pose

__all__ = ["SamplePolicy"]

TONES: Final = 3
BAND: Final = (0.1, 0.5)  # [Hz]
ONSET: Final = 0.7  # [s] in which it gets going


@dataclass(frozen=True, kw_only=True, eq=False)
class SamplePolicy:
    """Chunks of poses about a pose: each period a new one, from where the way is then, a little off the one before.

    Args:
        T: The pose that it moves about.
        period: [s] between chunks.
        ahead: How many periods a chunk reaches.
        size: (linear, angular) RMS of the way in each direction [m, rad].
        disagreement: (linear, angular) standard deviation of a chunk from the way, in each direction [m, rad].
        seed: Of way and disagreement.

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite.
    """

    T: Pose
    period: float = 0.1
    ahead: int = 4
    size: tuple[float, float] = (0.08, 0.2)
    disagreement: tuple[float, float] = (0.003, 0.01)
    seed: int = 0

    def __post_init__(self) -> None:
        positive_scalar("period", self.period, unit="s")
        for name in ("size", "disagreement"):
            pair = finite_array(name, getattr(self, name), shape=(2,), unit="m, rad")
            if pair.min() < 0.0:
                raise RangeError(f"{name} must be >= 0 [m, rad]; got {pair.tolist()}", name=name)
        for name, least in (("ahead", 1), ("seed", 0)):
            whole_number(name, getattr(self, name), minimum=least)

    def __call__(self, x: Snapshot) -> Chunk:
        """The chunk of the period in which the snapshot is taken."""
        number = round(float(x.t) / self.period)
        noise = np.random.default_rng([self.seed, 1 + number]).standard_normal(6)
        off = noise * np.repeat(self.disagreement, 3) if number else np.zeros(6)  # it starts where the tool is
        times = self.period * np.arange(self.ahead + 1, dtype=np.float64)
        way = self._way(number * self.period + times) + off
        return chunk(times, [self._pose(row) for row in way])

    def _way(self, t: Float64Array) -> Float64Array:
        """(k, 6) offsets from T, from rest at t = 0 on [m, rad]."""
        rng = np.random.default_rng([self.seed, 0])
        f, phase = rng.uniform(*BAND, (TONES, 6)), rng.uniform(0.0, 2.0 * np.pi, (TONES, 6))
        waves = np.sin(2.0 * np.pi * f * t[:, np.newaxis, np.newaxis] + phase).sum(axis=1) * np.sqrt(2.0 / TONES)
        going: Float64Array = -np.expm1(-((t / ONSET) ** 2))
        out: Float64Array = going[:, np.newaxis] * waves * np.repeat(self.size, 3)
        return out

    def _pose(self, offset: Float64Array) -> Pose:
        turned: Array = rotation_exp(offset[3:]) @ self.T.R
        return Pose(self.T.p + offset[:3], R=turned)
