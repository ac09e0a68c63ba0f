"""Region of attraction of a loop, by sampling: from which states a run comes back to rest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from taut.base.checks import instance_of, per_joint, require_range, whole_number
from taut.base.errors import UsageError
from taut.base.result import Content, Result
from taut.base.types import ArrayLike, Float64Array
from taut.loop import Loop
from taut.runtime.simulate import run

BACK: Final = 0.02  # [-] of the spread within which a run has come back, at its end


@dataclass(frozen=True, kw_only=True, eq=False)
class Attraction(Result):
    """Starts of runs about a state of rest, and whether the runs came back.

    Args:
        rest: (n,) positions to which they come back [rad | m].
        q: (m, n) positions of the starts.
        v: (m, n) velocities of the starts.
        distance: (m,) of each start from rest, 1 at the edge of the spread.
        attracted: (m,) whether the run came back to within 2 % of the spread.
    """

    rest: Float64Array
    q: Float64Array
    v: Float64Array
    distance: Float64Array
    attracted: NDArray[np.bool_]

    @property
    def radius(self) -> float:
        """Distance of the nearest start that did not come back; infinite if all did."""
        return float(self.distance[~self.attracted].min(initial=math.inf))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the fraction of the spread that is attracted (Clopper and Pearson)."""
        found = binomtest(int(self.attracted.sum()), len(self.attracted)).proportion_ci()
        return float(found.low), float(found.high)

    def content(self) -> Content:
        """How many came back, and the nearest that did not."""
        m, came = len(self.attracted), int(self.attracted.sum())
        low, high = self.interval
        inside = int((self.distance < self.radius).sum())
        said = f"{came} of {m} starts came back to rest: {100.0 * low:.3g} to {100.0 * high:.3g} % of the spread"
        lost = f"the nearest start that did not is at {self.radius:.3g} of the spread; {inside} nearer ones came back"
        return Content(
            title="region of attraction by sampling",
            summary=(said,) if came == m else (),
            faults=() if came == m else (said, lost),
            notes=("found by simulated runs: starts between the samples are not proved",),
        )


def region_of_attraction(
    loop: Loop, *, q: ArrayLike, v: ArrayLike = 0.0, at: ArrayLike | None = None, samples: int = 200, seed: int = 0
) -> Attraction:
    """Region of attraction of a loop with a held reference: seeded starts about its rest, each simulated.

    Starts are uniform in an ellipsoid about rest with the spreads as its half axes; the rest is where a run from `at`
    ends.

    Args:
        loop: Its duration is that of each run: long enough to come back.
        q: Spread of positions, one number or (n,) [rad | m].
        v: Spread of velocities, one number or (n,) [rad/s | m/s]; 0 for starts at rest.
        at: (n,) positions from which the rest is found [rad | m]; home if left out.
        samples: Number of starts.
        seed: Seed of the starts.

    Raises:
        UsageError: The run from `at` does not come to rest.
        RangeError, ShapeError: A spread of positions <= 0, a negative one of velocities.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=50.0, kd=20.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=arm.home), duration=4.0)
        >>> str(region_of_attraction(loop, q=1.0, v=1.0, samples=20)).splitlines()[1]
        '20 of 20 starts came back to rest: 83.2 to 100 % of the spread'

    References:
        Khalil, Nonlinear systems (2002), section 8.2.
    """
    instance_of("loop", loop, Loop, "a taut.Loop")
    n, count = loop.plant.arm.n, whole_number("samples", samples, minimum=1)
    wide = per_joint("q", q, loop.plant.arm.joint_names, unit="rad | m", above=0.0)
    fast = per_joint("v", v, loop.plant.arm.joint_names, unit="rad/s | m/s")
    require_range("v", fast, minimum=0.0, unit="rad/s | m/s")
    settled = run(loop, q0=at)
    rest = settled.q[-1]
    if not settled.outcome.ok or np.any(np.abs(settled.q[-len(settled) // 10 :] - rest) > BACK * wide):
        raise UsageError("the run from `at` does not come to rest; make the loop stable, its reference held, or its "
                         "duration longer", name="loop")  # fmt: skip
    rng = np.random.default_rng(whole_number("seed", seed))
    moving = np.concatenate([np.ones(n), fast > 0.0]).astype(bool)
    starts = np.zeros((count, 2 * n))
    starts[:, moving] = rng.standard_normal((count, int(moving.sum())))
    distance = rng.uniform(size=count) ** (1.0 / moving.sum())
    starts *= (distance / np.linalg.norm(starts, axis=1))[:, np.newaxis]
    q0, v0 = rest + starts[:, :n] * wide, starts[:, n:] * fast
    back = []
    for start, speed in zip(q0, v0, strict=True):
        made = run(loop, q0=start, v0=speed)
        back.append(made.outcome.ok and bool(np.all(np.abs(made.q[-1] - rest) <= BACK * wide)))
    return Attraction(rest=rest, q=q0, v=v0, distance=distance, attracted=np.array(back))
