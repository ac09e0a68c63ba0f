"""The sampled loop of a mass under a virtual spring and damper: its exact matrix, and when it is stable.

A continuous arm meets a law that sees it once in a period and holds its force until the next. What follows is exact
for the linear loop: hold, delay, differenced velocity, low-pass and integral included.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import butter, freqz, tf2ss

from taut.base.checks import (
    finite_array,
    finite_scalar,
    one_of,
    positive_scalar,
    read_only,
    require_at_least,
    symmetric_psd,
)
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.control.sensing.filters import LowPass, check_filter
from taut.control.sensing.velocity import Difference

__all__ = ["INTEGRATORS", "Integrator", "SampledLoop", "VelocityKind", "largest_factor", "square"]

VelocityKind = Literal["measured", "difference"] | LowPass | Difference
Integrator = Literal["exact", "semi-implicit-euler"]
INTEGRATORS: Final[tuple[Integrator, ...]] = ("exact", "semi-implicit-euler")
VELOCITIES: Final = ("measured", "difference")
MOST_DELAY: Final = 1000.0  # periods
ROUNDING: Final = 1e-10  # of an eigenvalue's modulus
WHOLE: Final = 1e-9  # a delay this near to whole periods is whole
RANK: Final = 1e-9  # stiffness below this part of the largest is none
PER_DECADE: Final = 12  # of the search for the first unstable gain
HALVINGS: Final = 50


def square(name: str, value: ArrayLike, n: int | None = None, unit: str = "") -> Float64Array:
    """(n, n) of a number, of one number per direction, or of a symmetric matrix.

    Args:
        name: What messages call it.
        value: The numbers.
        n: Directions; as many as `value` has if left out.
        unit: For messages.

    Raises:
        ShapeError: Another shape.
        RangeError: NaN, infinite, or a matrix that is not symmetric.
    """
    given = finite_array(name, value, unit=unit)
    size = (given.shape[0] if given.ndim else 1) if n is None else n
    if given.shape not in ((), (size,), (size, size)):
        raise ShapeError(
            f"{name} must be a number, ({size},) or ({size}, {size}); got shape {given.shape}", name=name, value=value
        )
    matrix = given if given.ndim == 2 else np.diag(np.broadcast_to(given, (size,)))
    if not np.allclose(matrix, matrix.T, rtol=0.0, atol=1e-9 * max(float(np.abs(matrix).max(initial=0.0)), 1e-300)):
        skew = float(np.abs(matrix - matrix.T).max())
        raise RangeError(
            f"{name} must be a symmetric matrix; it differs from its transpose by {skew:g}",
            name=name,
            value=skew,
            rule="symmetric",
        )
    return read_only(0.5 * (matrix + matrix.T))


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledLoop:
    """A mass with its own damper under a virtual spring and damper that see it once in a period.

    Model:        mass a + damping v = -u(t - delay) + F_ext
    Law:          u_k = K x_k + B v_k + Ki s_k, held for T = 1 / rate; v_k is measured in the tick, or
                  (x_k - x_{k-1}) / T, each with a low-pass if there is one, made discrete like
                  `taut.sensors.LowPass`;
                  s_k = s_{k-1} + T x_k, as the laws here integrate

    Args:
        mass: A number, (n,) or (n, n) [kg | kg m^2]: of an arm at its tool, Lambda.
        damping: Physical damping, likewise [N s/m | N m s/rad].
        K: Stiffness of the virtual spring, likewise [N/m | N m/rad].
        B: Damping of the virtual damper, likewise [N s/m | N m s/rad]; a negative one takes away.
        Ki: Of the integral, likewise [N/(m s) | N m/(rad s)].
        rate: [Hz].
        delay: [s] from the tick to the force, beyond the hold; any number of periods, whole or not.
        velocity: "measured", "difference", `taut.sensors.LowPass(...)` of the measured,
            `taut.sensors.Difference(cutoff=...)`.
        integrator: "exact" for a continuous mass, "semi-implicit-euler" as `RigidPlant` steps it.
        substeps: Of that integrator in a period.

    Raises:
        ShapeError, RangeError, UsageError: A number that has no meaning, by name.

    Example:
        >>> loop = SampledLoop(mass=1.0, damping=2.0, K=1000.0, rate=1000.0)
        >>> loop.stable, SampledLoop(mass=1.0, damping=2.0, K=5000.0, rate=1000.0).stable
        (True, False)

    References:
        Astrom and Wittenmark, Computer-controlled systems (1997), sections 2.3 and 3.2 for the fractional delay.
    """

    mass: ArrayLike
    damping: ArrayLike = 0.0
    K: ArrayLike = 0.0
    B: ArrayLike = 0.0
    Ki: ArrayLike = 0.0
    rate: float = 1000.0
    delay: float = 0.0
    velocity: VelocityKind = "measured"
    integrator: Integrator = "exact"
    substeps: int = 1

    def __post_init__(self) -> None:
        numbers = {name: np.asarray(getattr(self, name)) for name in ("mass", "damping", "K", "B", "Ki")}
        sizes = [value.shape[0] for value in numbers.values() if value.ndim]
        n = max(sizes, default=1)
        for name, unit in (
            ("mass", "kg"), ("damping", "N s/m"), ("K", "N/m"), ("B", "N s/m"), ("Ki", "N/(m s)")
        ):  # fmt: skip
            matrix = square(name, getattr(self, name), n, unit)
            if name in ("damping", "K", "Ki"):
                symmetric_psd(name, matrix, unit=unit)
            object.__setattr__(self, name, matrix)
        smallest = float(np.linalg.eigvalsh(np.asarray(self.mass))[0])
        if smallest <= 0.0:
            raise RangeError(
                f"mass must be positive definite [kg]; its smallest eigenvalue is {smallest:g}",
                name="mass",
                value=smallest,
                rule="positive definite",
            )
        object.__setattr__(self, "rate", positive_scalar("rate", self.rate, unit="Hz"))
        object.__setattr__(self, "delay", finite_scalar("delay", self.delay, unit="s"))
        require_at_least("delay", np.array(self.delay), 0.0, unit="s")
        if self.delay * self.rate > MOST_DELAY:
            raise RangeError(
                f"delay must be at most {MOST_DELAY:g} periods of {1.0 / self.rate:g} s; got {self.delay:g} s",
                name="delay",
                value=self.delay,
            )
        self._check_words(n)

    def _check_words(self, n: int) -> None:
        velocity = self.velocity
        if not isinstance(velocity, (LowPass, Difference)) and velocity not in VELOCITIES:
            raise UsageError(
                "velocity must be 'measured', 'difference', taut.sensors.LowPass(...) or "
                "taut.sensors.Difference(...); got "
                f"{velocity!r}",
                name="velocity",
            )
        if isinstance(velocity, (LowPass, Difference)):
            check_filter(velocity, "velocity", self.rate, n)
            if len(np.unique(np.asarray(velocity.cutoff))) > 1:
                raise UsageError("velocity.cutoff must be one number here, for all directions", name="velocity")
        one_of("integrator", self.integrator, INTEGRATORS)
        if isinstance(self.substeps, bool) or not isinstance(self.substeps, int) or self.substeps < 1:
            raise RangeError(f"substeps must be a whole number >= 1; got {self.substeps!r}", name="substeps")
        if self.integrator == "exact" and self.substeps != 1:
            raise UsageError("substeps are for integrator='semi-implicit-euler'; leave them out", name="substeps")
        if self.integrator != "exact" and self.periods[1]:
            raise UsageError(
                "a delay of part of a period is for integrator='exact'; RigidPlant delays by whole periods",
                name="delay",
            )

    # ---------------------------------------------------------------- its parts

    @property
    def T(self) -> float:
        """The period [s]."""
        return 1.0 / self.rate

    @property
    def n(self) -> int:
        """Number of directions."""
        return len(np.asarray(self.mass))

    @property
    def differenced(self) -> bool:
        """Whether the law knows positions only."""
        return self.velocity == "difference" or isinstance(self.velocity, Difference)

    def with_stiffness(self, factor: float) -> SampledLoop:
        """The same loop with `factor` times K, and times Ki."""
        return dataclasses.replace(self, K=factor * np.asarray(self.K), Ki=factor * np.asarray(self.Ki))

    @property
    def integrates(self) -> bool:
        """Whether the law has an integral."""
        return bool(np.any(np.asarray(self.Ki)))

    @cached_property
    def periods(self) -> tuple[int, float]:
        """The delay as whole periods and the part of one that is left, in [0, 1)."""
        periods = self.delay * self.rate
        whole = round(periods) if abs(periods - round(periods)) < WHOLE else math.floor(periods)
        return whole, 0.0 if whole == round(periods) and abs(periods - whole) < WHOLE else periods - whole

    @cached_property
    def _filter(self) -> tuple[Float64Array, Float64Array] | None:
        """Numerator and denominator of the velocity's low-pass."""
        if isinstance(self.velocity, str) or self.velocity.cutoff is None:
            return None
        cutoff = float(np.atleast_1d(np.asarray(self.velocity.cutoff))[0])
        b, a = butter(self.velocity.order, cutoff, fs=self.rate)
        return np.asarray(b), np.asarray(a)

    def filter_response(self, theta: Float64Array) -> NDArray[np.complex128]:
        """Of the velocity's low-pass at the angles theta = omega T [rad]; one without a filter."""
        if self._filter is None:
            return np.ones(len(theta), dtype=np.complex128)
        return np.asarray(freqz(*self._filter, worN=theta)[1], dtype=np.complex128)

    def loop_response(self, theta: Float64Array) -> NDArray[np.complex128]:
        """(k, n, n) the loop broken at its force, at the angles theta = omega T [rad]: one tick's u over the force.

        Of its delay only the part of a period counts, so that it is exp(1j d theta) times that of a loop that is d
        whole periods later. It stays exact where slow loops have all their poles next to z = 1.
        """
        n, T, part = self.n, self.T, self.periods[1]
        move, eye = self._period, np.eye(n)
        z = np.exp(1j * theta)[:, np.newaxis, np.newaxis]
        w = (2j * np.sin(0.5 * theta) * np.exp(0.5j * theta))[:, np.newaxis, np.newaxis]  # z - 1
        v_f, dx_f = (move[f"{name}_new"] + (move[f"{name}_old"] / z if part else 0.0) for name in ("v", "dx"))
        lost = w * eye + (eye - move["v_v"])
        v = v_f / lost if n == 1 else np.linalg.solve(lost, v_f)
        x = (move["dx_v"] @ v + dx_f) / w
        seen = x * (w / z) / T if self.differenced else v
        seen = seen * self.filter_response(theta)[:, np.newaxis, np.newaxis]
        spring = np.asarray(self.K) + np.asarray(self.Ki) * T * z / w
        return np.asarray(spring @ x + np.asarray(self.B) @ seen)

    # ---------------------------------------------------------------- the matrix

    @cached_property
    def _period(self) -> dict[str, Float64Array]:
        """What one period makes of velocity and force: v and dx by v, by the force before (old), and after (new)."""
        n, T = self.n, self.T
        mass, damping = np.asarray(self.mass), np.asarray(self.damping)
        eye, none = np.eye(n), np.zeros((n, n))
        if self.integrator == "exact":
            part = self.periods[1]
            before = _moved(mass.tobytes(), damping.tobytes(), part * T)
            after = _moved(mass.tobytes(), damping.tobytes(), (1.0 - part) * T)
        else:
            h = T / self.substeps
            factor = np.linalg.inv(mass + h * damping)
            v_v, v_f = factor @ mass, factor * h
            step = np.block([[eye, h * v_v, h * v_f], [none, v_v, v_f], [none, none, eye]])
            before, after = np.eye(3 * n), np.linalg.matrix_power(step, self.substeps)
        free = np.block([[eye, none], [none, eye], [none, none]])
        by_state = after @ before @ free  # with no force
        old = after @ np.vstack([before[: 2 * n, 2 * n :], none])
        new = after[:, 2 * n :]
        return {
            "dx_v": by_state[:n, n:], "v_v": by_state[n : 2 * n, n:],
            "dx_old": old[:n], "v_old": old[n : 2 * n],
            "dx_new": new[:n], "v_new": new[n : 2 * n],
        }  # fmt: skip

    def matrix(self, factor: float = 1.0) -> Float64Array:
        """(N, N) from one tick to the next: of the positions that the spring feels, the velocities, and all memory.

        Directions without stiffness and integral have no position in it, so that drifting along them counts for
        nothing.

        Args:
            factor: On K and Ki.
        """
        n, K, B, Ki, move = self.n, np.asarray(self.K), np.asarray(self.B), np.asarray(self.Ki), self._period
        sizes, basis = np.linalg.eigh(_scaled(K) + _scaled(Ki))
        R = basis[:, sizes > RANK * max(float(sizes[-1]), 1e-300)]  # (n, r) what the spring feels
        whole, part = self.periods
        old = whole + (1 if part else 0)
        coefficients = (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)))
        if self._filter is not None:
            coefficients = tuple(np.asarray(each) for each in tf2ss(*self._filter))  # type: ignore[assignment]
        a, b, c, d = (np.kron(each, np.eye(n)) for each in coefficients)
        widths = {"y": R.shape[1], "v": n, "dx": n if self.differenced else 0, "filter": len(a), "u": old * n}
        widths["s"] = R.shape[1] if self.integrates else 0
        at = np.cumsum([0, *widths.values()])
        eye = np.eye(int(at[-1]))
        now = {name: eye[at[i] : at[i + 1]] for i, name in enumerate(widths)}
        raw = now["dx"] * self.rate if self.differenced else now["v"]
        u = factor * K @ R @ now["y"] + B @ (c @ now["filter"] + d @ raw)
        if self.integrates:
            now["s"] = now["s"] + self.T * now["y"]
            u = u + factor * Ki @ R @ now["s"]
        line = [u, *(now["u"][i * n : (i + 1) * n] for i in range(old))]
        new_force, old_force = -line[whole], -line[old]
        dx = move["dx_v"] @ now["v"] + move["dx_new"] @ new_force
        v = move["v_v"] @ now["v"] + move["v_new"] @ new_force
        if part:
            dx, v = dx + move["dx_old"] @ old_force, v + move["v_old"] @ old_force
        then = [now["y"] + R.T @ dx, v, *([dx] if self.differenced else [])]
        then += [a @ now["filter"] + b @ raw, *line[:old], now["s"]]
        made: Float64Array = np.vstack(then)
        return made

    def poles(self) -> NDArray[np.complex128]:
        """The eigenvalues of its matrix, the largest modulus first."""
        poles = np.asarray(np.linalg.eigvals(self.matrix()), dtype=np.complex128)
        return poles[np.argsort(-np.abs(poles))]

    @property
    def radius(self) -> float:
        """The largest modulus of its poles."""
        return _radius(self.matrix())

    @property
    def stable(self) -> bool:
        """Whether what is set off does not grow."""
        return self.radius <= 1.0 + ROUNDING

    def largest_stable(self) -> float:
        """The factor on K and Ki up to which it is stable; 0 if none is, infinite if both are zero.

        The first border from below: a loop that is stable again above it is not counted.
        """
        mass, K = np.asarray(self.mass), np.asarray(self.K) + np.asarray(self.Ki) * self.T
        largest = float(np.abs(np.asarray(np.linalg.eigvals(np.linalg.solve(mass, K)))).max())
        if largest == 0.0:
            return math.inf if self.stable else 0.0
        without = self.matrix(0.0)
        spring = self.matrix(1.0) - without  # K and Ki turn up once in every entry

        def stable(factor: float) -> bool:
            return _radius(without + factor * spring) <= 1.0 + ROUNDING

        scale = self.rate**2 / largest  # at this factor the spring turns the mass round in a period
        return largest_factor(stable, 1e-7 * scale, 100.0 * scale)


@lru_cache(maxsize=256)
def _moved(mass: bytes, damping: bytes, time: float) -> Float64Array:
    """(3n, 3n) what a time [s] makes of position, velocity and force; maps and loci over gains ask often for one."""
    n = math.isqrt(len(mass) // 8)
    M, b = (np.frombuffer(matrix, dtype=np.float64).reshape(n, n) for matrix in (mass, damping))
    eye, none = np.eye(n), np.zeros((n, n))
    rates = np.linalg.solve(M, np.hstack([-b, eye]))
    made: Float64Array = expm(np.block([[none, eye, none], [none, rates], [none, none, none]]) * time)
    made.flags.writeable = False
    return made


def _scaled(matrix: Float64Array) -> Float64Array:
    """In parts of its largest entry."""
    largest = float(np.abs(matrix).max())
    return matrix / largest if largest else matrix


def _radius(matrix: Float64Array) -> float:
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def largest_factor(
    good: Callable[[float], bool], low: float, high: float, per_decade: int = PER_DECADE, halvings: int = HALVINGS
) -> float:
    """The first border of what is good, from below, between two factors; 0 if the lower one is not good."""
    if not good(low):
        return 0.0
    count = round(per_decade * math.log10(high / low)) + 1
    for factor in np.geomspace(low, high, count)[1:].tolist():
        if not good(factor):
            high = factor
            break
        low = factor
    else:
        return math.inf
    for _ in range(halvings):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if good(middle) else (low, middle)
    return low
