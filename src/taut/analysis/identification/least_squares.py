"""Weighted least squares of the torques in recorded runs, with Stribeck friction where they show it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d
from scipy.signal import butter, sosfiltfilt

from taut.analysis.identification.regression import ArmRegression, linear_text
from taut.base.errors import NumericalError, RangeError, UsageError, warn
from taut.base.types import Float64Array
from taut.record.run import Run

POSITION_CUTOFF: Final = 20.0  # [Hz] of the filter of positions, before they are differentiated
TORQUE_CUTOFF: Final = 5.0  # [Hz] of that of torques and regressor
SAMPLE: Final = 1.0 / (2.0 * TORQUE_CUTOFF)  # [s] between samples that are kept: residuals are white; test_coverage
ORDER: Final = 4  # of both filters, which act forwards and backwards
MIN_RATE: Final = 5.0 * POSITION_CUTOFF  # [Hz] of a record
END: Final = 2.0 * SAMPLE  # [s] left out at both ends of a run, where the filters begin
OVER_NOISE: Final = 10.0  # speed of a joint that moves, over the noise of the speed
OVER_STOP: Final = 0.04  # the same over its RMS speed: about a stop the filtered speed is wrong
MIN_SHARE: Final = 0.5  # of a sample in which a joint moves; friction of one that rests takes any value
MAX_CONDITION: Final = 100.0  # of the regressor with columns of length 1; test_too_little_excitation
DOUBTFUL_CONDITION: Final = 30.0
UNCERTAIN: Final = 0.2  # standard deviation over size, above which a parameter is named
MAX_LAG: Final = 0.2  # correlation of successive residuals that is still white
SIGNIFICANT: Final = 4.0  # standard deviations by which a payload, or more friction at rest, must differ from none
STRIBECK: Final = np.geomspace(0.005, 0.2, 9)  # [rad/s | m/s] speeds with which the search begins
LOW_SPEED: Final = 0.5  # of the RMS speed, above which the Stribeck effect looks like other friction
GAUSS_NEWTON: Final = 8  # steps of it; each at most halves or doubles the speed


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Samples of a run. Both sides of tau = Y x are zero while a joint rests that friction may hold."""

    t: Float64Array  # (k,) [s]
    Y: Float64Array  # (k, n, b)
    tau: Float64Array  # (k, n) less the known torques
    known: Float64Array  # (k, n)
    share: Float64Array  # (k, n) of the sample in which the joint moves, or has no friction; NaN if it is too little
    moves: NDArray[np.bool_]  # (n,) beyond the noise
    speed: Float64Array  # (n,) RMS [rad/s | m/s]
    filtered: Callable[[Callable[[Float64Array], Float64Array], list[int]], Float64Array]
    """(k, s) a function of the speeds of some joints, at full rate, through the filter of the torques."""

    @classmethod
    def of(cls, run: Run, regression: ArmRegression) -> Samples:
        """Y at full rate from filtered positions; Y and tau through the same filter, without a lag."""
        _require_free(run, regression)
        rate = run.rate
        q = np.asarray(run.extra.get("sensed.q", run.q))
        q = np.where(np.isin(np.arange(run.n), run.continuous), np.unwrap(q, axis=0), q)
        smooth = sosfiltfilt(butter(ORDER, POSITION_CUTOFF, fs=rate, output="sos"), q, axis=0)
        v, a = np.gradient(smooth, 1.0 / rate, axis=0), np.zeros_like(q)
        a[1:-1] = (smooth[2:] - 2.0 * smooth[1:-1] + smooth[:-2]) * rate**2
        end = round(END * rate)
        noise = np.std((q - smooth)[end:-end], axis=0) * np.sqrt(2.0 * POSITION_CUTOFF / rate)  # of white noise
        noise = OVER_NOISE * noise * 2.0 * np.pi * POSITION_CUTOFF / np.sqrt(3.0)  # [rad/s | m/s]
        speed = np.sqrt(np.mean(v[end:-end] ** 2, axis=0))
        moving = np.full(q.shape, 1.0)
        if "friction" in regression.what or regression.arm.friction.dry:
            goes = np.abs(v) > np.maximum(noise, OVER_STOP * speed)
            moving = minimum_filter1d(np.where(goes, 1.0, 0.0), 4 * round(rate / POSITION_CUTOFF) + 1, axis=0)
        rows = slice(end, len(q) - end, round(rate * SAMPLE))
        low = butter(ORDER, TORQUE_CUTOFF, fs=rate, output="sos")

        def kept(x: Float64Array, joints: slice | list[int] = slice(None)) -> Float64Array:
            mask = moving[:, joints]
            masked = x * mask.reshape(*mask.shape, *[1] * (x.ndim - 2))
            return np.asarray(sosfiltfilt(low, masked, axis=0)[rows])

        share = kept(np.full(q.shape, 1.0))
        used = share > MIN_SHARE
        Y, known = regression.at(smooth, v, a)
        known = kept(known) * used
        return cls(
            t=run.t[rows],
            Y=kept(Y) * used[:, :, np.newaxis],
            tau=kept(_torques(run)) * used - known,
            known=known,
            share=np.where(used, share, np.nan),
            moves=speed > noise,
            speed=speed,
            filtered=lambda function, joints: kept(function(v[:, joints]), joints) * used[:, joints],
        )


def _torques(run: Run) -> Float64Array:
    """(k, n) torques of the motors at the times of the ticks.

    Column tau has those of the period that follows a tick, a sensor gives those of the period before it. A torque
    that is held acts on average in the middle of its period, in an integrator with one step in a period at its
    beginning; T v+ - (q+ - q) = delay (v+ - v) shows which.
    """
    T, tau, t = 1.0 / run.rate, np.asarray(run.tau), run.t
    dv, late = np.diff(run.v, axis=0), T * run.v[1:] - np.diff(run.q, axis=0)
    size = float(np.sum(dv**2))
    delay = float(np.clip(np.sum(late * dv) / size, 0.0, 0.5 * T)) if size > 0.0 else 0.0
    if "sensed.tau_meas" in run.extra:
        tau, delay = np.asarray(run.extra["sensed.tau_meas"]), delay - T
    return np.stack([np.interp(t, t + delay, column) for column in tau.T], axis=1)


def _require_free(run: Run, regression: ArmRegression) -> None:
    """Refuse a run that is too short or slow for the filters, has contact, or in which the plant changes."""
    run.require_arm(regression.arm)
    if run.rate < MIN_RATE or len(run) < 4.0 * END * run.rate:
        raise RangeError(
            f"identify takes runs of {MIN_RATE:g} Hz or more that last {4.0 * END:g} s or more; got {len(run)} ticks "
            f"at {run.rate:g} Hz; record longer, and at a higher rate",
            name="runs",
        )
    touched = np.asarray(run.extra["F_ext"]).any(axis=1) if "F_ext" in run.extra else np.zeros(len(run), dtype=bool)
    changed = [
        event.t
        for event in run.info.events
        if run.t[0] < event.t <= run.t[-1] and any(path.startswith("plant.") for path in event.set)
    ]
    if touched.any() or changed:
        what, t = ("the plant changes", changed[0]) if changed else ("a contact begins", run.t[int(touched.argmax())])
        raise UsageError(
            f"identify takes motion of one arm in free space, and {what} at t = {t:.4g} s; give the part before or "
            "after: run.between(start, end)",
            name="runs",
        )


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
        least = SIGNIFICANT * np.sqrt(np.diag(fit.covariance))[len(self.names) :]
        sound = [e > sd and found[i] < largest[i] for e, sd, i in zip(excess, least, found, strict=False)]
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
