"""Weighted least squares of torques, with Stribeck friction where the samples show it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Final

import numpy as np

from taut.analysis.identification.regression import linear_text
from taut.analysis.identification.samples import SAMPLE, Samples
from taut.base.errors import NumericalError, RangeError, warn
from taut.base.types import Float64Array

MAX_CONDITION: Final = 100.0  # of the regressor with columns of length 1; test_too_little_excitation
DOUBTFUL_CONDITION: Final = 30.0
UNCERTAIN: Final = 0.2  # standard deviation over size, above which a parameter is named
MAX_LAG: Final = 0.2  # correlation of successive residuals that is still white
SIGNIFICANT: Final = 4.0  # standard deviations by which a payload, or more friction at rest, must differ from none
STRIBECK: Final = np.geomspace(0.005, 0.2, 9)  # [rad/s | m/s] speeds with which the search begins
LOW_SPEED: Final = 0.5  # of the RMS speed, above which the Stribeck effect looks like other friction
GAUSS_NEWTON: Final = 8  # steps of it; each at most halves or doubles the speed


class Fit:
    """Torques of all samples as Y x, with weights 1 / residual of each joint from a first pass.

    With `speeds` by joint, of the Stribeck effect, the last parameters are the excess of static over Coulomb friction
    of these joints, and corrections of the speeds.
    """

    def __init__(
        self,
        samples: Sequence[Samples],
        names: Sequence[str],
        speeds: Mapping[int, float] | None = None,
        excess: Float64Array | None = None,  # (s,) with which the speeds are corrected
    ) -> None:
        self.samples, self.names, self.speeds = samples, tuple(names), dict(speeds or {})
        self.Y, self.tau = (np.concatenate([getattr(part, name) for part in samples]) for name in ("Y", "tau"))
        if excess is not None:
            joints = list(self.speeds)
            only = np.eye(self.tau.shape[1])[:, joints]
            columns, slopes = (c[:, :, np.newaxis] * only for c in self._stribeck(self.speeds))
            self.Y = np.concatenate([self.Y, columns, slopes * excess], axis=2)
        used = np.concatenate([np.isfinite(part.share) for part in samples])
        size = self.Y.shape[2]
        if used.sum() < 2 * size:
            raise RangeError(
                f"the record has {used.sum()} samples of {SAMPLE:g} s for {size} parameters; record 20 s or more",
                name="runs",
            )
        weights, count = np.ones(self.tau.shape[1]), np.maximum(used.sum(axis=0), 1)
        for _ in range(2):
            self.weights, W = weights, (self.Y * weights[:, np.newaxis]).reshape(-1, size)
            length = np.linalg.norm(W, axis=0)
            self._scale = np.where(length > 0.0, length, 1.0)
            self._W = W / self._scale
            self.x = np.linalg.lstsq(self._W, (self.tau * weights).ravel(), rcond=None)[0] / self._scale
            self.residual = self.tau - self.Y @ self.x
            rms = np.sqrt(np.sum(self.residual**2, axis=0) / count)
            weights = 1.0 / np.maximum(rms, np.finfo(float).eps * np.abs(self.tau).max())
        self._variance = float(np.sum((self.residual * self.weights) ** 2)) / (used.sum() - size)

    @cached_property
    def lag(self) -> float:
        """The largest correlation of successive residuals of a joint."""
        power = np.maximum(np.sum(self.residual**2, axis=0), np.finfo(float).tiny)
        pieces = np.split(self.residual, np.cumsum([len(part.t) for part in self.samples])[:-1])
        return float(np.max(sum(np.sum(r[1:] * r[:-1], axis=0) for r in pieces) / power))

    @cached_property
    def covariance(self) -> Float64Array:
        """Of the parameters; residuals that are not white widen it."""
        lag = self.lag if self.lag > MAX_LAG else 0.0
        widened = self._variance * (1.0 + lag) / (1.0 - lag)
        return np.asarray(widened * np.linalg.inv(self._W.T @ self._W) / np.outer(self._scale, self._scale))

    def estimates(self) -> tuple[Float64Array, Float64Array]:
        """Values and standard deviations; static friction and speeds in place of excess and corrections."""
        values, b, s = self.x.copy(), len(self.names), len(self.speeds)
        sums = np.eye(len(values))
        for k, i in enumerate(self.speeds):
            sums[b + k, self._coulomb(i)], values[b + s + k] = 1.0, self.speeds[i]
        return sums @ values, np.sqrt(np.diag(sums @ self.covariance @ sums.T))

    def _coulomb(self, joint: int) -> int:
        """Number of the Coulomb friction of a joint; they come last, in the order of the joints."""
        return len(self.names) - len(self.weights) + joint

    def condition(self) -> float:
        """The condition number, refused above 100 with the direction that is excited least."""
        columns = self.Y.reshape(-1, self.Y.shape[2])
        length = np.linalg.norm(columns, axis=0)
        _, sizes, directions = np.linalg.svd(columns / np.where(length > 0.0, length, 1.0), full_matrices=False)
        condition = float(sizes[0] / max(sizes[-1], np.finfo(float).tiny))
        direction = directions[-1] * np.sign(directions[-1][np.argmax(np.abs(directions[-1]))])
        largest = [i for i in np.argsort(-np.abs(direction))[:4] if abs(direction[i]) > 0.1]
        weakest = linear_text([(float(direction[i]), self.names[i]) for i in largest])
        if condition > MAX_CONDITION:
            raise NumericalError(
                f"too little excitation: the condition number is {condition:.3g}, more than {MAX_CONDITION:g}; the "
                f"motion hardly excites {weakest} (columns scaled to 1); record another or a larger motion, as of "
                "taut.analysis.excitation(arm), or leave a part out of what",
                name="runs",
                value=condition,
            )
        if condition > DOUBTFUL_CONDITION:
            warn(
                f"the condition number of the identification is {condition:.3g}; the motion hardly excites {weakest}"
            )
        return condition

    def with_slow_friction(self, joints: Sequence[int]) -> tuple[Fit, list[int]]:
        """The fit with Stribeck friction of the joints that show it, and the joints on which the record is silent.

        The record shows an excess at a Stribeck speed if its standard deviation is below 20 % of the Coulomb
        friction: it holds enough slow motion then.
        """
        Q = np.linalg.qr(self._W)[0].reshape(*self.tau.shape, -1)
        largest = LOW_SPEED * np.max([part.speed for part in self.samples], axis=0)
        found, best, hidden = dict[int, float](), dict[int, float](), set(joints)
        for speed in STRIBECK:
            slow = [i for i in joints if speed < largest[i]]
            columns = self._stribeck(dict.fromkeys(slow, float(speed)))[0] if slow else np.zeros((0, 0))
            for i, column in zip(slow, columns.T, strict=True):
                c = column * self.weights[i]
                beside = float(c @ c - np.sum((Q[:, i].T @ c) ** 2))  # of the column, what all others do not make
                if self._variance >= (UNCERTAIN * self.x[self._coulomb(i)]) ** 2 * beside:
                    continue
                hidden.discard(i)
                gain = float(c @ self.residual[:, i]) * self.weights[i] / np.sqrt(beside * self._variance)
                if gain > best.get(i, SIGNIFICANT):
                    found[i], best[i] = float(speed), gain
        fit, excess = self, np.ones(len(found))
        for _ in range(GAUSS_NEWTON if found else 0):
            fit = Fit(self.samples, self.names, found, excess)
            excess, steps = np.split(fit.x[len(self.names) :], 2)
            moved = {i: found[i] + step for i, step in zip(found, steps.tolist(), strict=True)}
            found = {i: min(max(moved[i], 0.5 * found[i]), 2.0 * found[i]) for i in found}
        sound = [e > 0.0 and at < largest[i] for e, (i, at) in zip(excess, found.items(), strict=True)]
        if all(sound):
            return fit, sorted(hidden)
        lost = [i for i, kept in zip(found, sound, strict=True) if not kept]
        fit, silent = self.with_slow_friction([i for i in joints if i not in lost])
        return fit, sorted({*silent, *lost})

    def _stribeck(self, speeds: Mapping[int, float]) -> tuple[Float64Array, Float64Array]:
        """(k, s) each: filtered exp(-(v / speed)^2) sgn(v) of some joints, and its slope by the speed."""
        joints, at = list(speeds), np.array(list(speeds.values()))

        def excess(v: Float64Array) -> Float64Array:
            return np.asarray(np.sign(v) * np.exp(-((v / at) ** 2)))

        def slope(v: Float64Array) -> Float64Array:
            return np.asarray(excess(v) * 2.0 * v**2 / at**3)

        columns, slopes = (
            np.concatenate([part.filtered(f, joints) for part in self.samples]) for f in (excess, slope)
        )
        return columns, slopes
