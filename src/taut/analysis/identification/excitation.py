"""taut.analysis.excitation: a motion of all joints that makes parameters of an arm identifiable."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.linalg import block_diag, null_space

from taut.analysis.identification.regression import ArmRegression, Unknown
from taut.arm.description import Arm
from taut.base.checks import per_joint, positive_scalar, require_range, whole_number
from taut.base.errors import RangeError
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.joint import ACCELERATION, POSITION, SPEED, Fourier

RANGE: Final = 0.9  # of the room of a joint about home that the motion takes
USED: Final = 0.5  # of the arm's limits of speed and torque that the motion takes
UNLIMITED_SPEED: Final = 2.0  # [rad/s | m/s] where the arm has no limit
COARSE, DENSE = 8, 80  # samples in a period of the highest harmonic: to search; to meet limits
RANDOM: Final = 40  # motions about the best one so far
SPREADS: Final = np.geomspace(1.0, 0.1, 10)  # of these, in one round after the other
TORQUE_WEIGHT: Final = 100.0  # of torques beyond the limit, against the logarithm of the condition number
SMALLER: Final = 1.05  # at least, where torques of the motion are too large
MAX_HARMONICS: Final = 50  # the search keeps some ten thousand numbers for each
HIGHEST_FIRST: Final = 1000.0  # [Hz] of a first harmonic; no arm follows it
SINGULAR: Final = 1e-12  # smallest eigenvalue of a regressor whose condition number still counts


def excitation(
    arm: Arm,
    *,
    duration: float = 20.0,
    what: Sequence[Unknown] = ("payload", "friction"),
    harmonics: int = 5,
    frequency: float = 0.1,
    amplitude: ArrayLike = 0.3,
    speed: ArrayLike | None = None,
    acceleration: ArrayLike = np.inf,
    seed: int = 0,
) -> Fourier:
    """A motion that excites parameters of an arm: a Fourier series with the smallest condition number that was found.

    It starts and ends at home, at rest in velocity and acceleration, and stays within 90 % of the room about home,
    half of the speeds and, by the model, half of the torque that is left at home. Collisions are not considered.

    Args:
        arm: The arm, with a payload like the expected one.
        duration: Whole periods of the first harmonic [s].
        what: What is to be identified, as for `taut.analysis.identify`.
        harmonics: Number of them, 2 to 50.
        frequency: Of the first harmonic [Hz].
        amplitude: (n,) or scalar, largest distance from home [rad | m].
        speed: (n,) or scalar [rad/s | m/s]; half of the arm's limits if left out.
        acceleration: (n,) or scalar [rad/s^2 | m/s^2]; torques are limited in any case.
        seed: Of the random motions with which the search begins.

    Raises:
        RangeError: A duration that is no whole number of periods; a limit <= 0; no room or torque left at home.

    Example:
        >>> import taut
        >>> motion = excitation(taut.load_arm("one_joint"), duration=10.0, amplitude=0.2)
        >>> motion.duration.item(), bool(abs(motion.at(4.0).q[0]) <= 0.2)
        (10.0, True)

    References:
        Swevers et al. (1997), IEEE Trans. Robotics and Automation 13 (5): Fourier series.
    """
    regression = ArmRegression(arm, what)
    duration, frequency = positive_scalar("duration", duration, unit="s"), positive_scalar("frequency", frequency)
    require_range("frequency", frequency, unit="Hz", maximum=HIGHEST_FIRST)
    harmonics = whole_number("harmonics", harmonics, minimum=2, maximum=MAX_HARMONICS)
    periods = duration * frequency
    if abs(periods - round(periods)) > 1e-9 or periods < 0.5:
        raise RangeError(
            f"duration must be whole periods of the first harmonic, {1.0 / frequency:g} s each; got {duration:g}",
            name="duration",
            value=duration,
        )
    fastest = np.where(np.isfinite(arm.velocity), USED * arm.velocity, UNLIMITED_SPEED)
    limits = ("amplitude", amplitude, POSITION), ("speed", fastest if speed is None else speed, SPEED)
    reach, *rates = (
        per_joint(name, given, arm.joint_names, unit=unit, above=0.0, infinite=True)
        for name, given, unit in (*limits, ("acceleration", acceleration, ACCELERATION))
    )
    up, down = (np.minimum(reach, RANGE * room) for room in (arm.upper - arm.home, arm.home - arm.lower))
    search, dense = (
        _Search(regression, harmonics, frequency, (up, down, *rates), count) for count in (COARSE, DENSE)
    )
    rng = np.random.default_rng(whole_number("seed", seed))
    best = rng.standard_normal((1, search.size))
    for size in SPREADS:  # by costs alone, which jump where the speed at a sample changes its sign
        points = np.vstack([best, best + size * rng.standard_normal((RANDOM, search.size))])
        best = points[[int(np.argmin(search.costs(points)))]]
    cosines, sines = np.split(dense.within_torques(dense.coefficients(best))[0], 2)
    return Fourier(q0=arm.home, cosines=cosines, sines=sines, frequency=frequency, duration=duration)


class _Search:
    """Motions as points (size,) without constraints: each joint is scaled to the first limit that it meets.

    Rest at both ends is two linear conditions on the coefficients of each joint, which a basis satisfies.
    """

    def __init__(
        self,
        regression: ArmRegression,
        harmonics: int,
        frequency: float,
        limits: tuple[Float64Array, ...],  # (n,) each: upwards, downwards, of speed, of acceleration
        samples: int,  # in a period of the highest harmonic
    ) -> None:
        self._regression, self._limits, arm = regression, limits, regression.arm
        order = np.arange(1, harmonics + 1)
        omega = 2.0 * np.pi * frequency * order
        self._basis = block_diag(null_space(order[np.newaxis] ** 2.0), null_space(order[np.newaxis] * 1.0))
        t = np.arange(samples * harmonics) / (samples * harmonics * frequency)
        c, s = np.cos(np.outer(t, omega)), np.sin(np.outer(t, omega))
        parts = (c - 1.0, s), (-s * omega, c * omega), (-c * omega**2, -s * omega**2)
        self._parts = [np.hstack(part) for part in parts]  # (samples, 2 h) each: of positions, speeds, accelerations
        self.size = 2 * (harmonics - 1) * arm.n
        self._x, rest = regression.K @ regression.nominal, np.zeros((1, arm.n))
        Y, known = regression.at(arm.home[np.newaxis], rest, rest)
        self._weight = (known + Y @ self._x)[0]
        self._torque = USED * (arm.effort - np.abs(self._weight))
        for what, room in (("room about home", np.minimum(*limits[:2])), ("torque left at home", self._torque)):
            if (room <= 0.0).any():
                joint = arm.joint_names[int(np.argmin(room))]
                raise RangeError(
                    f"joint '{joint}' has no {what} to move with; give the arm another home, or less payload",
                    name="arm",
                    joint=joint,
                )

    def coefficients(self, points: Float64Array) -> Float64Array:
        """(k, 2 h, n) cosines and sines within the limits."""
        found = self._basis @ points.reshape(len(points), -1, self._regression.arm.n)
        q, v, a = (part @ found for part in self._parts)
        sizes = (q.max(axis=1), -q.min(axis=1), np.abs(v).max(axis=1), np.abs(a).max(axis=1))
        used = np.max([size / limit for size, limit in zip(sizes, self._limits, strict=True)], axis=0)[:, np.newaxis]
        return np.asarray(found / used)

    def _regressors(self, coefficients: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(k, samples, n, b) columns, and (k, samples, n) torques beyond those at home over their limit."""
        q, v, a = (part @ coefficients for part in self._parts)
        flat = (x.reshape(-1, x.shape[2]) for x in (self._regression.arm.home + q, v, a))
        Y, known = self._regression.at(*flat)
        used = np.abs(known + Y @ self._x - self._weight) / self._torque
        return Y.reshape(*q.shape, -1), used.reshape(q.shape)

    def within_torques(self, coefficients: Float64Array) -> Float64Array:
        """Coefficients of one motion, made smaller where the torques need it."""
        while (used := float(self._regressors(coefficients)[1].max())) > 1.0:
            coefficients = coefficients / max(used, SMALLER)
        return coefficients

    def costs(self, points: Float64Array) -> Float64Array:
        """(k,) logarithm of the condition number, and torques beyond their limit."""
        Y, used = self._regressors(self.coefficients(points))
        W = Y.reshape(len(points), -1, Y.shape[-1])
        unit = W / np.linalg.norm(W, axis=1, keepdims=True)
        sizes = np.linalg.eigvalsh(np.swapaxes(unit, 1, 2) @ unit)
        condition = 0.5 * np.log(sizes[:, -1] / np.maximum(sizes[:, 0], SINGULAR))
        excess = np.maximum(used - 1.0, 0.0).reshape(len(points), -1)
        return np.asarray(condition + TORQUE_WEIGHT * np.mean(excess**2, axis=1))
