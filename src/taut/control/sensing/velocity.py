"""Where velocities come from: a sensor, differences of positions, or a Kalman filter on them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Protocol

from taut.arm.description import Arm
from taut.base.fields import Choice, Declared, Field, Part
from taut.base.types import Array, Vector
from taut.control.sensing.filters import LowPass, low_pass, low_pass_start
from taut.trace import math as tm

__all__ = ["Difference", "Kalman", "Measured", "VelocitySource", "kalman_gains"]

Values = Mapping[str, Any]


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
