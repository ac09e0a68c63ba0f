"""Filters of what is measured, by the bilinear transform, and where velocities come from: a sensor or positions.

Their coefficients are computed in every tick from their parameters, which may change at any time: the filters
remember inputs and outputs, so that a change moves nothing that stands still.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Final, Literal, Protocol

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import entry_names
from taut.base.errors import RangeError
from taut.base.fields import Choice, Declared, Field, Part
from taut.base.types import Array, Float64Array, Vector
from taut.trace import math as tm

__all__ = [
    "Difference",
    "Filter",
    "Kalman",
    "LowPass",
    "Measured",
    "Notch",
    "VelocitySource",
    "check_filter",
    "kalman_gains",
]

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


# -------------------------------------------------------------------- where velocities come from


class VelocitySource(Protocol):
    """What sensing needs of a way to a velocity."""

    needs_velocity: ClassVar[bool]
    """Whether it reads a measured velocity."""

    def start(self, q: Vector, v: Vector) -> dict[str, Any]:
        """Memory at the first tick."""
        ...

    def velocity(
        self, arm: Arm, q: Vector, v: Vector, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Vector, dict[str, Any]]:
        """(n,) the velocity that the law sees, and the new memory."""
        ...


class Measured(Declared):
    """The measured velocity, through a low-pass if there is one."""

    needs_velocity: ClassVar[bool] = True
    low_pass: Part[LowPass | None] = Part(LowPass, optional=True, inline=True)

    def start(self, q: Vector, v: Vector) -> dict[str, Any]:  # noqa: ARG002
        """Memory at the first tick."""
        return {} if self.low_pass is None else self.low_pass.start(v)

    def velocity(
        self,
        arm: Arm,  # noqa: ARG002
        q: Vector,  # noqa: ARG002
        v: Vector,
        memory: Values,
        parameters: Values,
        dt: Any,
    ) -> tuple[Vector, dict[str, Any]]:
        """(n,) the velocity that the law sees, and the new memory."""
        return (v, {}) if self.low_pass is None else self.low_pass.filtered(v, memory, parameters, dt)


class Difference(Declared):
    """Differences of positions of successive ticks, through a low-pass that takes the jitter of their steps.

    Law:          v = (q - q_prev) / dt, with q_prev the first position in the first tick, then `LowPass`
                  The short way round for continuous joints. Differencing delays by half a period; one step of an
                  encoder in one tick is a velocity of resolution / dt.

    Args:
        cutoff: Scalar or one per joint [Hz] of the low-pass, below half the controller's rate; None for none.
        order: 1 or 2.

    Raises:
        RangeError: A cut-off of zero or below, or at half the rate or above.

    References:
        Chapter, section 10.1 control system overview, and the pseudocode of figures 10.8 and 10.13.
    """

    needs_velocity: ClassVar[bool] = False
    cutoff: Field = Field(unit="Hz", shape="n", above=0.0, optional=True, hint="leave it out for no low-pass")
    order: Choice[Literal[1, 2]] = Choice(1, 2)

    def check(self) -> None:
        if self.cutoff is None and self.order != 1:
            self.refuse("order", "is that of the low-pass; give cutoff too")

    def start(self, q: Vector, v: Vector) -> dict[str, Any]:  # noqa: ARG002
        """Memory at the first tick: at rest."""
        if self.cutoff is None:
            return {"q": q}
        rest = tm.zeros(len(q))
        return {"q": q, **low_pass_start(rest, rest, self.order)}

    def velocity(
        self,
        arm: Arm,
        q: Vector,
        v: Vector,  # noqa: ARG002
        memory: Values,
        parameters: Values,
        dt: Any,
    ) -> tuple[Vector, dict[str, Any]]:
        """(n,) the velocity that the law sees, and the new memory."""
        rate: Vector = arm.difference(q, memory["q"]) / dt
        if self.cutoff is None:
            return rate, {"q": q}
        smooth, after = low_pass(rate, memory, parameters["cutoff"], self.order, dt)
        return smooth, {"q": q, **after}


class Kalman(Declared):
    """A steady Kalman filter of each joint's position and velocity, from measured positions alone.

    Law:          prediction  q- = q_hat + v_hat dt,  v- = v_hat
                  correction  q_hat = q- + alpha (q - q-),  v_hat = v- + (beta / dt) (q - q-);  the law sees v_hat
                  with the steady gains of the model  dv = a dt,  a white of density acceleration_noise^2,
                  measured with white noise of standard deviation position_noise:
                  lam = acceleration_noise dt^(3/2) / position_noise,  w = (lam + sqrt(lam^2/3 + 16)) / 2,
                  y = 2 / (w + sqrt(w^2 - 4)),  alpha = 1 - y^2,  beta = lam y

    The model knows neither the arm's dynamics nor the torque: an acceleration that lasts leaves an error of velocity,
    a constant velocity none. It starts at the first position, at rest. The gains follow from the parameters in every
    tick, so that these may change at any time.

    Args:
        acceleration_noise: Scalar or one per joint: how much the joint accelerates, as the square root of a
            spectral density [rad/s^2/sqrt(Hz) | m/s^2/sqrt(Hz)]. More follows faster.
        position_noise: Scalar or one per joint: standard deviation of a measured position [rad | m]; that of the
            steps of an encoder is resolution / sqrt(12). More smooths more.

    Raises:
        RangeError: A number of zero or below.

    Example:
        >>> alpha, beta = kalman_gains(1.0, 1.0, 1.0)
        >>> round(float(alpha), 4), round(float(beta), 4)
        (0.7567, 0.4932)

    References:
        Bar-Shalom, Li and Kirubarajan, Estimation with applications to tracking and navigation (2001), section 6.5;
        the root in closed form is ours. Kalata, The tracking index (1984), for the name.
    """

    needs_velocity: ClassVar[bool] = False
    acceleration_noise: Field = Field(unit="rad/s^2/sqrt(Hz) | m/s^2/sqrt(Hz)", shape="n", above=0.0)
    position_noise: Field = Field(
        unit="rad | m", shape="n", above=0.0, hint="of exact positions take the velocity 'difference'"
    )

    def start(self, q: Vector, v: Vector) -> dict[str, Any]:  # noqa: ARG002
        """Memory at the first tick: at rest."""
        return {"q_hat": q, "v_hat": tm.zeros(len(q))}

    def velocity(
        self,
        arm: Arm,
        q: Vector,
        v: Vector,  # noqa: ARG002
        memory: Values,
        parameters: Values,
        dt: Any,
    ) -> tuple[Vector, dict[str, Any]]:
        """(n,) the velocity that the law sees, and the new memory."""
        alpha, beta = kalman_gains(parameters["acceleration_noise"], parameters["position_noise"], dt)
        predicted = memory["q_hat"] + memory["v_hat"] * dt
        surprise = arm.difference(q, predicted)
        v_hat: Vector = memory["v_hat"] + (beta / dt) * surprise
        return v_hat, {"q_hat": predicted + alpha * surprise, "v_hat": v_hat}


def kalman_gains(acceleration_noise: Any, position_noise: Any, dt: Any) -> tuple[Array, Array]:
    """Steady gains alpha and beta of a constant-velocity model with white acceleration, in closed form.

    With y = sqrt(1 - alpha) and beta = lam y, the steady Riccati equation is (1/y - y)^2 - lam (1/y + y) +
    lam^2 / 6 = 0, a quadratic in w = y + 1/y. The roots are written without differences of near numbers.

    Args:
        acceleration_noise: Square root of the acceleration's spectral density.
        position_noise: Standard deviation of a measured position.
        dt: Period [s].

    References:
        Bar-Shalom, Li and Kirubarajan (2001), section 6.5.3: alpha = sqrt(2 beta + beta^2/12) - beta/2 and
        beta^2 = lam^2 (1 - alpha).
    """
    lam = acceleration_noise * dt * tm.sqrt(dt) / position_noise
    root = tm.sqrt(lam * lam / 3.0 + 16.0)
    above = 0.5 * (lam + (lam * lam / 3.0) / (root + 4.0))  # w - 2
    sum_ = above + 2.0 + tm.sqrt(above * (above + 4.0))  # w + sqrt(w^2 - 4) = 2 / y
    y = 2.0 / sum_
    return (1.0 - y) * (1.0 + y), lam * y


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
