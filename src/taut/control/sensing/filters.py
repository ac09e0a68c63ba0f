"""Filters of what is measured: low-pass and notch, by the bilinear transform, exact at the frequencies they name.

Their coefficients are computed in every tick from their parameters, which may change at any time: the filters
remember inputs and outputs, so that a change moves nothing that stands still.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Literal, Protocol

import numpy as np

from taut.base.checks import entry_names
from taut.base.errors import RangeError
from taut.base.fields import Choice, Declared, Field
from taut.base.types import Array, Float64Array
from taut.trace import math as tm

__all__ = ["Filter", "LowPass", "Notch", "check_filter", "low_pass", "low_pass_start"]

Values = Mapping[str, Any]
DECIBEL: Final = math.log(10.0) / 20.0  # natural logarithm of an amplitude per decibel


class Filter(Protocol):
    """What sensing needs of a filter of one measurement."""

    def start(self, u: Array) -> dict[str, Any]:
        """Memory at the first tick, as if u had always been constant."""
        ...

    def filtered(self, u: Array, memory: Values, parameters: Values, dt: Any) -> tuple[Array, dict[str, Any]]:
        """The filter's output, and the new memory."""
        ...


class LowPass(Declared):
    """A Butterworth low-pass of first or second order. As a velocity it filters the measured one.

    Law:          order 1: H(s) = w / (s + w),  order 2: H(s) = w^2 / (s^2 + sqrt(2) w s + w^2),  w = 2 pi cutoff,
                  made discrete by the bilinear transform with prewarping: the sampled filter has the gain 1 at
                  standstill, 1/sqrt(2) (-3 dB) at the cut-off, exactly and at every rate, and 0 at half the rate
                  It starts at its first input, and delays slow signals by 1/w, the second order by sqrt(2)/w.

    Args:
        cutoff: Scalar, or one for each entry of what it filters [Hz]; below half the controller's rate.
        order: 1 or 2.

    Raises:
        RangeError: A cut-off of zero or below, or at half the rate or above.

    Example:
        >>> import taut
        >>> LowPass(cutoff=30.0).parameters()
        {'cutoff': array(30.)}

    References:
        Oppenheim and Schafer, Discrete-time signal processing (2010), section 7.2. Chapter, section 10.1.
    """

    cutoff: Field = Field(unit="Hz", shape="n", above=0.0, hint="leave the filter out for none")
    order: Choice[Literal[1, 2]] = Choice(1, 2)

    def start(self, u: Array) -> dict[str, Any]:
        """Memory at the first tick, as if u had always been constant."""
        return low_pass_start(u, u, self.order)

    def filtered(self, u: Array, memory: Values, parameters: Values, dt: Any) -> tuple[Array, dict[str, Any]]:
        """The filter's output, and the new memory."""
        return low_pass(u, memory, parameters["cutoff"], self.order, dt)


class Notch(Declared):
    """A notch in positions and velocities: it takes out a vibration, such as that of an elastic joint.

    Law:          H(s) = (s^2 + g b s + w^2) / (s^2 + b s + w^2),  w = 2 pi frequency, b = 2 pi width,
                  g = 10^(-depth / 20), made discrete so that the sampled filter has the gain g at the frequency, 1 at
                  standstill and at half the rate, and the width exactly; it starts without a transient

    It acts on what the law sees as q and v alike. Continuous joints are filtered the short way round, and what is
    taken from a position is counted from the sensor's own turn.

    Args:
        frequency: Scalar or one per joint [Hz], below half the controller's rate; among several 0 for joints
            without a notch.
        width: Scalar or one per joint [Hz]: between the two frequencies at which a notch without bottom has -3 dB.
        depth: Scalar or one per joint [dB], the attenuation at the frequency.

    Raises:
        RangeError: A number of zero or below, or a frequency at half the rate or above.

    References:
        Orfanidis, Introduction to signal processing (1996), section 11.3.
    """

    frequency: Field = Field(unit="Hz", shape="n", above=0.0, zero_for_none=True, hint="leave the notch out for none")
    width: Field = Field(unit="Hz", shape="n", above=0.0, hint="leave the notch out for none")
    depth: Field = Field(40.0, unit="dB", shape="n", above=0.0, hint="leave the notch out for none")

    def start(self, u: Array) -> dict[str, Any]:
        """Memory at the first tick, as if u had always been constant: last input, its change, two outputs."""
        rest = tm.zeros(len(u))
        return {"u": u, "du": rest, "y": rest, "y_prev": rest}

    def filtered(
        self,
        u: Array,
        memory: Values,
        parameters: Values,
        dt: Any,
        difference: Callable[[Array, Array], Array] = operator.sub,
    ) -> tuple[Array, dict[str, Any]]:
        """The notch's output, which is u less (1 - g) of the band around the frequency, and the new memory.

        Args:
            u: (n,) positions or velocities.
            memory: As `start` gives it.
            parameters: frequency [Hz], width [Hz], depth [dB].
            dt: [s].
            difference: How two inputs differ: the short way round for joints that turn.
        """
        frequency, some = parameters["frequency"], True
        if np.ndim(frequency):
            some = frequency > 0.0
            frequency = tm.where(some, frequency, 0.25 / dt)
        beta = tm.tan(math.pi * dt * parameters["width"])
        narrow = 1.0 / (1.0 + beta)
        du = difference(u, memory["u"])
        y = (1.0 - narrow) * (du + memory["du"])
        y = y + 2.0 * narrow * tm.cos(2.0 * math.pi * dt * frequency) * memory["y"]
        y = y - (2.0 * narrow - 1.0) * memory["y_prev"]
        out = u - (1.0 - tm.exp(-DECIBEL * parameters["depth"])) * y
        if some is not True:
            out = tm.where(some, out, u)
        return out, {"u": u, "du": du, "y": y, "y_prev": memory["y"]}


# -------------------------------------------------------------------- the low-pass as functions


def low_pass_start(u: Array, y: Array, order: int) -> dict[str, Any]:
    """Memory: the last inputs and outputs, as if u and y had always been constant."""
    first = {"u": u, "y": y}
    return first if order == 1 else {**first, "u_prev": u, "y_prev": y}


def low_pass(u: Array, memory: Values, cutoff: Array, order: int, dt: Any) -> tuple[Array, dict[str, Any]]:
    """Output of a Butterworth low-pass of order 1 or 2, and the new memory."""
    k = tm.tan(math.pi * dt * cutoff)
    u1, y1 = memory["u"], memory["y"]
    if order == 1:
        y = y1 + (k / (1.0 + k)) * ((u - y1) + (u1 - y1))
        return y, {"u": u, "y": y}
    u2, y2 = memory["u_prev"], memory["y_prev"]
    k2, root = k * k, math.sqrt(2.0) * k
    drive = k2 * ((u - y1) + 2.0 * (u1 - y1) + (u2 - y1))
    y = y1 + (drive + (1.0 - root + k2) * (y1 - y2)) / (1.0 + root + k2)
    return y, {"u": u, "y": y, "u_prev": u1, "y_prev": y1}


# -------------------------------------------------------------------- checks


def check_filter(part: Declared, path: str, rate: float, joints: Sequence[str] | int) -> None:
    """Every number of a filter is a scalar or one for each entry of what it filters, and below half the rate.

    Args:
        part: The filter.
        path: What messages call it.
        rate: Of the controller [Hz].
        joints: Names of the entries that it filters, or their number.

    Raises:
        ShapeError: Neither a scalar nor one for each.
        RangeError: A frequency at half the rate or above.
    """
    part.check_size(joints, f"{path}.")
    for name, unit in part.units().items():
        if unit == "Hz":
            names = None if isinstance(joints, int) else joints
            _below_nyquist(f"{path}.{name}", part.parameters()[name], rate, names)


def _below_nyquist(path: str, values: Float64Array, rate: float, entries: Sequence[str] | None) -> None:
    wrong = np.atleast_1d(values >= 0.5 * rate)
    if not wrong.any():
        return
    index = [int(i) for i in np.argwhere(wrong)[0]] if values.ndim else []
    value = float(values[tuple(index)])
    raise RangeError(
        f"{entry_names(path, index, entries)} must be < {0.5 * rate:g} [Hz], half the controller's rate of "
        f"{rate:g} Hz; got {value!r}; make it lower, or the rate higher",
        name=path,
        joint=entries[index[0]] if entries is not None and index else None,
        value=value,
        rule="below half the rate",
    )
