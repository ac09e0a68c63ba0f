"""Filtered samples of recorded runs, at which tau = Y x is solved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d
from scipy.signal import butter, sosfiltfilt

from taut.analysis.identification.regression import ArmRegression
from taut.base.errors import RangeError, UsageError
from taut.base.types import Float64Array
from taut.record.run import Run

POSITION_CUTOFF: Final = 20.0  # [Hz] of the filter of positions, before they are differentiated
TORQUE_CUTOFF: Final = 5.0  # [Hz] of that of torques and regressor
SAMPLE: Final = 1.0 / (2.0 * TORQUE_CUTOFF)  # [s] between samples that are kept: residuals are white; test_coverage
ORDER: Final = 4  # of both filters, which act forwards and backwards
MIN_RATE: Final = 5.0 * POSITION_CUTOFF  # [Hz] of a record
END: Final = 2.0 * SAMPLE  # [s] left out at both ends of a run, where the filters begin
MOVING: Final = 10.0  # speed of a joint that moves, over the noise of the speed
SLOW: Final = 0.04  # the same over its RMS speed: about a stop the filtered speed is wrong
MIN_SHARE: Final = 0.5  # of a sample in which a joint moves; friction of one that rests takes any value


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
        noise = MOVING * noise * 2.0 * np.pi * POSITION_CUTOFF / np.sqrt(3.0)  # [rad/s | m/s]
        speed = np.sqrt(np.mean(v[end:-end] ** 2, axis=0))
        moving = np.full(q.shape, 1.0)
        if "friction" in regression.what or regression.arm.friction.dry:
            goes = np.abs(v) > np.maximum(noise, SLOW * speed)
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
