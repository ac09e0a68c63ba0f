"""Error dynamics at a servo rate: the gains of the book, seen once in a period."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.checks import finite_scalar
from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.linear.delay_margin import largest_delay
from taut.linear.error_dynamics import ErrorDynamics
from taut.linear.error_numbers import ErrorNumbers
from taut.linear.joint_gains import JointGains
from taut.linear.linear_response import NEVER, StepShape, powers, sampled_shape
from taut.linear.poles import in_s
from taut.linear.sampled import Integrator, SampledLoop, VelocityKind

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["SampledErrorDynamics"]

Complex = NDArray[np.complex128]
STEP: Final = 2.0**0.25  # of the search for a rate
MOST_STEPS: Final = 80  # of it: a factor of a million
MOST_PERIODS: Final = 500  # of delay that are searched
HALVINGS: Final = 40
ROUNDING: Final = 1e-12  # of a pole's modulus


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledErrorDynamics(ErrorNumbers):
    """One joint's error dynamics under a law that sees it once in a period and holds its torque until the next.

    Print it for a report. `ErrorDynamics.sampled` makes it.

    Closed loop:  that of `taut.analysis.SampledLoop`: hold, delay, differenced or filtered velocity and the
    integral's sum
                  are exact

    Args:
        continuous: The error dynamics of the book, with their gains.
        rate: [Hz].
        delay: [s] from the tick to the torque, beyond the hold.
        velocity: "measured", "difference", `taut.sensors.LowPass(...)`, `taut.sensors.Difference(cutoff=...)`.
        integrator: "exact" for a continuous joint, "semi-implicit-euler" as `RigidPlant` steps it.
        substeps: Of that integrator in a period.

    Raises:
        UsageError, RangeError, ShapeError: No gains, or a number that has no meaning, by name.

    Example:
        >>> import taut
        >>> d = taut.analysis.second_order(omega_n=10.0, zeta=1.0).sampled(rate=1000.0)
        >>> [round(float(s), 2) for s in d.s_poles.real]  # -10, -10 in the book
        [-9.36, -10.79]

    References:
        Chapter, section 10.2.1.1, practical bounds on feedback gains, and figure 10.8.
    """

    continuous: ErrorDynamics
    rate: float
    delay: float = 0.0
    velocity: VelocityKind = "measured"
    integrator: Integrator = "exact"
    substeps: int = 1

    def __post_init__(self) -> None:
        loop = self.loop  # its checks
        object.__setattr__(self, "rate", loop.rate)
        object.__setattr__(self, "delay", loop.delay)

    @property
    def gains(self) -> JointGains:
        """The joint and its gains."""
        return self.continuous.gains

    @cached_property
    def loop(self) -> SampledLoop:
        """The loop of which it is the error."""
        gains = self.gains
        return SampledLoop(
            mass=gains.M, damping=gains.b, K=gains.kp, B=gains.kd, Ki=gains.ki, rate=self.rate, delay=self.delay,
            velocity=self.velocity, integrator=self.integrator, substeps=self.substeps,
        )  # fmt: skip

    @property
    def dt(self) -> float:
        """The period [s]."""
        return self.loop.T

    @cached_property
    def matrix(self) -> Float64Array:
        """(N, N) of the state from one tick to the next: error, its rate, and all memory."""
        return self.loop.matrix()

    @cached_property
    def poles(self) -> Complex:
        """(N,) in z, the largest modulus first; those at zero are delays that end by themselves."""
        return self.loop.poles()

    @property
    def s_poles(self) -> Complex:
        """(N,) ln(z) / T of each pole [1/s], to compare with those of the book; minus infinity for z = 0."""
        return in_s(self.poles, self.dt)

    @property
    def radius(self) -> float:
        """The largest modulus of its poles."""
        return float(np.abs(self.poles[0]))

    @property
    def stable(self) -> bool:
        """Whether every error dies away: all poles within the unit circle."""
        return self._pulls and self.radius < 1.0 - ROUNDING

    @property
    def _pulls(self) -> bool:
        """Whether anything pulls at an error."""
        return self.gains.kp > 0.0 or self.gains.ki > 0.0

    def replaced(self, **numbers: float) -> SampledErrorDynamics:
        """The same with other numbers: M, b, kp, kd, ki, rate, delay."""
        own: dict[str, Any] = {name: numbers.pop(name) for name in ("rate", "delay") if name in numbers}
        known = {"M", "b", "kp", "kd", "ki"}
        if not set(numbers) <= known:
            raise UsageError(
                "replaced() takes M, b, kp, kd, ki, rate and delay; got "
                f"{', '.join(repr(name) for name in sorted(set(numbers) - known))}",
                name=min(set(numbers) - known),
            )
        continuous = self.continuous.replaced(**numbers) if numbers else self.continuous
        return replace(self, continuous=continuous, **own)

    # ---------------------------------------------------------------- response

    @property
    def _start(self) -> tuple[Float64Array, Float64Array]:
        """The state of a unit error at rest, and the row that reads the error: positions come first."""
        if not self._pulls:
            raise UsageError("nothing pulls at an error: kp and ki are zero", name="kp")
        first = np.eye(len(self.matrix))[0]
        return first, first

    def response(self, count: int, e0: float = 1.0) -> Float64Array:
        """(count,) the error at the ticks after a start at rest.

        Args:
            count: Ticks, the first at the start.
            e0: [rad | m].
        """
        start, c = self._start
        made: Float64Array = c @ powers(self.matrix, finite_scalar("e0", e0, unit="rad") * start, count)
        return made

    @cached_property
    def step(self) -> StepShape:
        """Overshoot, settling, rise and peak of the error at the ticks, after a step."""
        return sampled_shape(self.matrix, *self._start, self.dt) if self.stable else NEVER

    @property
    def settling_ticks(self) -> int | None:
        """Its number, from the start; None if it does not settle."""
        return round(self.settling_time * self.rate) if math.isfinite(self.settling_time) else None

    # ---------------------------------------------------------------- borders

    def _stable_at(self, **numbers: float) -> bool:
        return self.replaced(**numbers).stable

    @property
    def _slowest_rate(self) -> float:
        """At which its low-pass still has a meaning [Hz]."""
        cutoff = None if isinstance(self.velocity, str) else self.velocity.cutoff
        return 0.0 if cutoff is None else 2.0 * float(np.max(cutoff)) * (1.0 + 1e-9)

    @cached_property
    def lowest_stable_rate(self) -> float:
        """[Hz] where it becomes stable, or ceases to be: the border next to its rate, with these gains and delay.

        From there on, up to its own rate or where it has become stable, it is stable. A delay counts in seconds, with
        integrator="semi-implicit-euler" in periods. Infinite if no rate helps; with a low-pass at least twice its
        cut-off, below which it has no meaning.
        """
        periods = self.delay * self.rate
        whole = self.integrator != "exact"

        def stable(rate: float) -> bool:
            return self._stable_at(rate=rate, delay=periods / rate if whole else self.delay)

        rate, good = self.rate, self.stable
        for _ in range(MOST_STEPS):
            following = rate / STEP if good else rate * STEP
            if good and following < self._slowest_rate:
                if stable(self._slowest_rate):
                    return self._slowest_rate
                following = self._slowest_rate
            if not whole and following * self.delay > MOST_PERIODS:
                return math.inf
            if stable(following) != good:
                low, high = min(rate, following), max(rate, following)
                return _bisected(stable, low, high)[1]
            rate = following
        return 0.0 if good else math.inf

    @cached_property
    def largest_stable_delay(self) -> float:
        """[s] from the tick to the torque up to which it is stable at its rate: the first border from none.

        Zero if it is unstable without delay; whole periods with integrator="semi-implicit-euler".
        """
        if not self._pulls:
            return 0.0
        return largest_delay(self.loop, whole=self.integrator != "exact") * self.dt

    # ---------------------------------------------------------------- ways out

    def to_control(self) -> Any:
        """A `control.StateSpace` in discrete time: from a step of the desired position to the actual one.

        Raises:
            MissingExtraError: python-control is not installed.
        """
        from taut.linear.control_systems import state_space

        start, c = self._start
        eye = np.eye(len(start))
        return state_space(self.matrix, start[:, np.newaxis], (c @ (eye - self.matrix))[np.newaxis], self.dt)

    def report(self) -> str:
        """Everything of it in a few lines; `print(d)` is the same."""
        from taut.linear.error_words import of_sampled

        return of_sampled(self)

    def plot(self) -> Figure:
        """Its response at the ticks over that of the book, beside its poles in z."""
        from taut.linear.error_plots import of_sampled

        return of_sampled(self)


def _bisected(stable: Callable[[float], bool], low: float, high: float) -> tuple[float, float]:
    """The two sides of a border between an unstable and a stable number, whichever is lower."""
    rising = stable(high)
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if stable(middle) == rising else (middle, high)
    return low, high
