"""Weighted least squares of the torques in recorded runs, with Stribeck friction where they show it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Final

import numpy as np
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
END: Final = 6.0 * SAMPLE  # [s] left out at both ends: what filtered positions hide of an abrupt start dies out
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


class Samples:
    """Samples of a run. Both sides of tau = Y x are zero while a joint rests that friction may hold.

    Y is made at full rate from filtered positions; Y and tau pass the same filter, without a lag.
    """

    def __init__(self, run: Run, regression: ArmRegression) -> None:
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
        self.speed = np.sqrt(np.mean(v[end:-end] ** 2, axis=0))  # (n,) RMS [rad/s | m/s]
        self.moves = self.speed > noise  # (n,) beyond the noise
        self._v, self._moving = v, np.ones_like(v)
        if "friction" in regression.what or regression.arm.friction.dry:
            goes = np.abs(v) > np.maximum(noise, OVER_STOP * self.speed)
            self._moving = minimum_filter1d(goes * 1.0, 4 * round(rate / POSITION_CUTOFF) + 1, axis=0)
        self._rows = slice(end, len(q) - end, round(rate * SAMPLE))
        self._low = butter(ORDER, TORQUE_CUTOFF, fs=rate, output="sos")
        self._used = np.ones((1, run.n), dtype=np.bool_)
        share = self._filtered(np.ones_like(q))
        self._used = share > MIN_SHARE
        Y, known = regression.at(smooth, v, a)
        self.t = run.t[self._rows]  # (k,) [s]
        self.share = np.where(self._used, share, np.nan)  # (k, n) of the sample, while the joint moves; or too small
        self.Y, self.known = self._filtered(Y), self._filtered(known)  # (k, n, b), (k, n)
        self.tau = self._filtered(_torques(run)) - self.known  # (k, n)

    def _filtered(self, x: Float64Array, joints: slice = slice(None)) -> Float64Array:
        """(k, ...) of x (ticks, joints, ...) at full rate."""
        moving, used = (
            part[:, joints].reshape(len(part), -1, *[1] * (x.ndim - 2)) for part in (self._moving, self._used)
        )
        return np.asarray(sosfiltfilt(self._low, x * moving, axis=0)[self._rows] * used)

    def stribeck(self, joint: int, speed: float) -> Float64Array:
        """(k, 2) filtered exp(-(v / speed)^2) sgn(v) of a joint, and its slope by the speed."""
        v = self._v[:, [joint]]
        excess = np.sign(v) * np.exp(-((v / speed) ** 2))
        slope = excess * 2.0 * v**2 / speed**3
        return self._filtered(np.stack([excess, slope], axis=2), slice(joint, joint + 1))[:, 0]


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
    changed = [
        event.t
        for event in run.info.events
        if run.t[0] < event.t <= run.t[-1] and any(path.startswith("plant.") for path in event.set)
    ]
    what, t = ("the plant changes", changed[0]) if changed else ("a contact begins", run.first_contact)
    if t is not None:
        raise UsageError(
            f"identify takes motion of one arm in free space, and {what} at t = {t:.4g} s; give the part before or "
            "after: run.between(start, end)",
            name="runs",
        )


class Fit:
    """Torques of all samples as Y x, with weights 1 / residual of each joint from a first pass.

    With Stribeck speed and excess of static friction of some joints, x ends with static friction of these joints and
    their Stribeck speeds, about which the torques are linear; tau has what is not of x in it.
    """

    def __init__(
        self, samples: Sequence[Samples], names: Sequence[str], slow: Mapping[int, tuple[float, float]] | None = None
    ) -> None:
        self.samples, self.names, slow = samples, tuple(names), slow or {}
        Y, self.tau, share = (
            np.concatenate([getattr(part, name) for part in samples]) for name in ("Y", "tau", "share")
        )
        b, s, used = len(names), len(slow), np.isfinite(share)
        self.Y = np.concatenate([Y, np.zeros((*self.tau.shape, 2 * s))], axis=2)
        for k, (i, (speed, excess)) in enumerate(slow.items()):
            column, slope = self._stribeck(i, speed).T
            places = [self._coulomb(i), b + k, b + s + k]
            self.Y[:, i, places] += np.stack([-column, column, excess * slope], axis=1)
            self.tau[:, i] += excess * slope * speed
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

    def _stribeck(self, joint: int, speed: float) -> Float64Array:
        return np.concatenate([part.stribeck(joint, speed) for part in self.samples])

    def _coulomb(self, joint: int) -> int:
        """Number of the Coulomb friction of a joint; they come last, in the order of the joints."""
        return len(self.names) - int(self.tau.shape[1]) + joint

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

    def condition(self) -> float:
        """The condition number, refused above 100 with the direction that is excited least."""
        columns = self.Y.reshape(-1, self.Y.shape[2])
        length = np.linalg.norm(columns, axis=0)
        _, sizes, directions = np.linalg.svd(columns / np.where(length > 0.0, length, 1.0), full_matrices=False)
        condition = float(sizes[0] / max(sizes[-1], np.finfo(float).tiny))
        if condition <= DOUBTFUL_CONDITION:
            return condition
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
        warn(
            f"the condition number of the identification is {condition:.3g}; the motion hardly excites {weakest}; "
            "record a larger one, made for the same what by taut.analysis.excitation(arm, what=...), or several runs"
        )
        return condition

    def slow_friction(self) -> tuple[dict[int, tuple[float, float]], list[int]]:
        """Stribeck speed and excess of static friction of joints that show it, and joints of which nothing is shown.

        The record shows an excess at a Stribeck speed if its standard deviation is below 20 % of the Coulomb
        friction: it holds enough slow motion then.
        """
        Q = np.linalg.qr(self._W)[0].reshape(*self.tau.shape, -1)

        def beside(i: int, speed: float) -> tuple[Float64Array, Float64Array]:
            """Normal equations of the excess, and of it times a change of the speed, beside all other parameters."""
            C = self._stribeck(i, speed) * self.weights[i]
            others = Q[:, i].T @ C
            return C.T @ C - others.T @ others, C.T @ (self.residual[:, i] * self.weights[i])

        found, hidden = dict[int, tuple[float, float]](), list[int]()
        for i in range(self.tau.shape[1]):
            fastest = LOW_SPEED * max(part.speed[i] for part in self.samples)
            tried = [(speed, *beside(i, speed)) for speed in STRIBECK.tolist() if speed < fastest]
            needed = self._variance / (UNCERTAIN * self.x[self._coulomb(i)]) ** 2
            shown = [(b[0] / np.sqrt(A[0, 0] * self._variance), speed) for speed, A, b in tried if A[0, 0] > needed]
            gain, speed = max(shown, default=(np.inf, np.inf))
            if gain <= SIGNIFICANT:
                continue
            excess, deviation = 0.0, 0.0
            for _ in range(GAUSS_NEWTON if shown else 0):
                A, b = beside(i, speed)
                (excess, change), deviation = np.linalg.solve(A, b), np.sqrt(self._variance * np.linalg.inv(A)[0, 0])
                speed *= float(np.clip(1.0 + change / (excess * speed), 0.5, 2.0))
            if excess > SIGNIFICANT * deviation and speed < fastest:
                found[i] = speed, excess
            else:
                hidden.append(i)
        return found, hidden
