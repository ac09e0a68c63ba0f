"""Error dynamics as an object: how an error dies away, in numbers, from a polynomial, poles, a matrix or gains."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from taut.base.checks import finite_array, finite_scalar
from taut.base.errors import ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.linear import characteristic
from taut.linear.error_numbers import ErrorNumbers
from taut.linear.joint_gains import JointGains
from taut.linear.linear_response import NEVER, StepShape, companion, step_shape
from taut.linear.routh_table import RouthTable, routh
from taut.linear.second_order_response import shape, swing

if TYPE_CHECKING:
    pass

__all__ = ["CASES", "Case", "ErrorDynamics"]

Case = Literal["overdamped", "critically damped", "underdamped"]
CASES: Final[tuple[Case, ...]] = ("overdamped", "critically damped", "underdamped")
EQUAL: Final = 1e-10  # of a coefficient: what conversions between kinds of systems leave of no difference
Complex = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorDynamics(ErrorNumbers):
    """Linear error dynamics a_n e^(n) + ... + a_1 e_dot + a_0 e = 0: poles, response, and what the chapter reads off.

    Print it for a report. `taut.analysis.second_order` makes it of gains and specifications; `from_poles`,
    `from_matrix` and
    `of` of what else is at hand.

    Law:          e^(k) stand with a_k; with `integral` the lowest stands with int(e), as ki does in eq. 10.12
    Closed loop:  chi(s) E = reference(s) X_des + disturbance(s) Tau_dist,  chi the characteristic polynomial

    Args:
        coefficients: (n + 1,) of the characteristic polynomial, from the highest power of s down.
        integral: Whether the lowest coefficient is that of the error's integral, which starts at zero.
        reference: Numerator of the error over the desired position, from the highest power down; None if not known.
        disturbance: Numerator of the error over a disturbance torque; None if not known.
        joint: The gains it was made of; of second-order dynamics, or of third order with `integral`, those of
            equation 10.19 if left out.
        setpoint: Numerator of the actual over the desired position, if that has zeros of its own: a step is then one
            of the desired position, after which the error starts with the derivatives that these give it.

    Raises:
        ShapeError, RangeError: Coefficients that make no dynamics.


    References:
        Chapter, section 10.2.1.1, equations 10.8 to 10.14.
    """

    coefficients: ArrayLike
    integral: bool = False
    reference: ArrayLike | None = None
    disturbance: ArrayLike | None = None
    joint: JointGains | None = None
    setpoint: ArrayLike | None = None

    def __post_init__(self) -> None:
        given = finite_array("coefficients", self.coefficients)
        routh(given)  # refuses what is no polynomial
        object.__setattr__(self, "coefficients", given)
        for name in ("reference", "disturbance", "setpoint"):
            value = getattr(self, name)
            if value is not None:
                numerator = finite_array(name, value)
                if numerator.ndim != 1 or not 0 < len(numerator) <= len(given):
                    raise ShapeError(
                        f"{name} must be a numerator of at most {len(given)} coefficients, as many as the "
                        f"characteristic polynomial has; got shape {numerator.shape}",
                        name=name,
                    )
                object.__setattr__(self, name, numerator)
        if self.setpoint is not None and (len(self._s) > self.order or not self._s[-1]):
            raise ShapeError("setpoint must have fewer zeros than there are poles, and none at zero", name="setpoint")
        if self.integral and self.order < 2:
            raise UsageError("integral=True needs dynamics of the second order or higher", name="integral")

    # ---------------------------------------------------------------- ways in

    @classmethod
    def of_gains(cls, joint: JointGains) -> ErrorDynamics:
        """Of a joint under PID, or under feedback linearisation."""
        return cls(
            coefficients=joint.coefficients,
            integral=joint.ki > 0.0,
            reference=joint.reference,
            disturbance=joint.disturbance,
            joint=joint,
        )

    @classmethod
    def from_poles(cls, poles: ArrayLike, *, integral: bool = False) -> ErrorDynamics:
        """Of the roots of the characteristic equation: its kp, kd and ki are those of equation 10.19 that place them.

        Args:
            poles: (n,) real, or complex in conjugate pairs [1/s].
            integral: Whether the lowest coefficient is that of the error's integral.

        """
        return cls(coefficients=characteristic.from_poles(poles), integral=integral)

    @classmethod
    def from_matrix(cls, A: ArrayLike) -> ErrorDynamics:
        """Of the state matrix of x_dot = A x, by its characteristic polynomial, which is computed exactly.

        Polynomials of high order hold their roots badly: `taut.analysis.locus` and `taut.analysis.stability_map`
        take a large matrix
        as it is.

        Args:
            A: (n, n) [1/s].

        """
        return cls(coefficients=characteristic.from_matrix(A))

    @property
    def _s(self) -> Float64Array:
        made: Float64Array = np.asarray(self.setpoint)
        return made

    # ---------------------------------------------------------------- the polynomial and its roots

    @property
    def order(self) -> int:
        """Of the characteristic polynomial."""
        return len(self._a) - 1

    @property
    def _a(self) -> Float64Array:
        made: Float64Array = np.asarray(self.coefficients)
        return made

    @cached_property
    def poles(self) -> Complex:
        """(n,) the roots of the characteristic equation [1/s], the slowest first.

        Of the second order by the formula of section 10.2.1.1, whose discriminant is exact.
        """
        return characteristic.roots(self._a)

    @property
    def s_poles(self) -> Complex:
        """(n,) its poles, which are in s [1/s]."""
        return self.poles

    @cached_property
    def routh(self) -> RouthTable:
        """Routh's table; print it."""
        return routh(self._a)

    @property
    def stable(self) -> bool:
        """Whether every error dies away, by Routh's table."""
        return self.routh.stable

    @property
    def dt(self) -> None:
        """None: in continuous time."""
        return

    @property
    def time_constants(self) -> Float64Array:
        """(n,) -1 / Re(s) of each pole [s], the slowest first; infinite on the imaginary axis, negative beyond it."""
        rates = -self.poles.real
        made: Float64Array = np.divide(1.0, rates, out=np.full(len(rates), np.inf), where=rates != 0.0)
        return made

    @property
    def time_constant(self) -> float:
        """Of the slowest pole [s]; infinite if an error does not die away."""
        return float(self.time_constants[0]) if self.stable else math.inf

    # ---------------------------------------------------------------- second order

    def _second(self, what: str) -> None:
        if self.order != 2:
            raise UsageError(
                f"{what} is a number of second-order error dynamics, and these are of order {self.order}; "
                "damping_ratios and natural_frequencies have one for each pole",
                name=what,
            )

    @cached_property
    def _sigma(self) -> float:
        return float(self._a[1] / (2.0 * self._a[0]))

    @cached_property
    def _excess(self) -> float:
        return characteristic.excess(self._a)

    @property
    def zeta(self) -> float:
        """Damping ratio, of the second order: eq. 10.9; NaN without a restoring term."""
        self._second("zeta")
        a2, a1, a0 = self._a.tolist()
        return a1 / (2.0 * math.copysign(math.sqrt(a0 * a2), a2)) if a0 * a2 > 0.0 else math.nan

    @property
    def omega_n(self) -> float:
        """Natural frequency [rad/s], of the second order: eq. 10.9; NaN without a restoring term."""
        self._second("omega_n")
        ratio = float(self._a[2] / self._a[0])
        return math.sqrt(ratio) if ratio > 0.0 else math.nan

    @property
    def omega_d(self) -> float:
        """Damped natural frequency [rad/s], of the second order; 0 where nothing swings."""
        self._second("omega_d")
        return math.sqrt(max(-self._excess, 0.0))

    @property
    def case(self) -> Case:
        """Which of the chapter's three solutions: by the roots, which are unequal, equal or complex."""
        self._second("case")
        excess = self._excess
        return "overdamped" if excess > 0.0 else "underdamped" if excess < 0.0 else "critically damped"

    # ---------------------------------------------------------------- gains

    @cached_property
    def gains(self) -> JointGains:
        """The joint and the gains: those it was made of, else those of equation 10.19.

        Raises:
            UsageError: Not of the second order, nor of the third with an integral.
            RangeError: A gain would be negative.
        """
        if self.joint is not None:
            return self.joint
        if self.order != 2 + self.integral:
            raise UsageError(
                "dynamics of the second order, or of the third with integral=True, have the gains kp, kd and ki; "
                f"these are of order {self.order}",
                name="gains",
            )
        kd, kp, *ki = (self._a[1:] / self._a[0]).tolist()
        return JointGains(kp=kp, kd=kd, ki=ki[0] if ki else 0.0)

    def replaced(self, **numbers: float) -> ErrorDynamics:
        """The same joint with other numbers: M, b, kp, kd, ki."""
        unknown = sorted(set(numbers) - {"M", "b", "kp", "kd", "ki"})
        if unknown:
            raise UsageError(
                f"replaced() takes M, b, kp, kd and ki; got {', '.join(repr(name) for name in unknown)}",
                name=unknown[0],
            )
        changed: dict[str, Any] = dict(numbers)
        return ErrorDynamics.of_gains(replace(self.gains, **changed))

    # ---------------------------------------------------------------- response

    def response(self, t: ArrayLike, e0: float = 1.0, v0: float | None = None) -> tuple[Float64Array, Float64Array]:
        """Error and its rate after a start, exactly.

        Of the second order in the closed form of section 10.2.1.1, one formula for all three cases; of others by the
        matrix exponential. Higher derivatives and the integral start at zero, but for those that follow.

        Args:
            t: (k,) or a number [s], from the start.
            e0: Error at the start [rad | m].
            v0: Its rate at the start [rad/s | m/s]; if left out zero, or with `setpoint` what a step of e0 gives it.

        Returns:
            e and v, of the shape of t.

        """
        times = finite_array("t", t, unit="s")
        e0 = finite_scalar("e0", e0, unit="rad")
        if v0 is not None and self.order - self.integral < 2:
            raise UsageError("first-order dynamics start at any e0, and v0 follows from it; leave v0 out", name="v0")
        stepped = v0 is None
        v0 = 0.0 if v0 is None else finite_scalar("v0", v0, unit="rad/s")
        flat = np.ravel(times)
        if self.order == 2 and not self.integral and not (stepped and self.setpoint is not None):
            e, v = swing(self._sigma, float(self._a[2] / self._a[0]), self._excess, e0, v0, flat)
        else:
            A, scale = self._chain
            o = int(self.integral)
            start = np.zeros(self.order)
            start[o] = e0
            if self.order - o > 1:
                start[o + 1] = v0 / scale
            left = 0.0
            if stepped and self.setpoint is not None:
                gain = float(self._s[-1] / self._a[-1])
                start, left = e0 * gain * self._set_off, e0 * (1.0 - gain)
            states = np.array([expm(A * each) @ start for each in flat]).reshape(-1, self.order)
            e, v = left + states[:, o], states @ A[o]
        return e.reshape(times.shape), v.reshape(times.shape)

    @cached_property
    def _chain(self) -> tuple[Float64Array, float]:
        return companion(self._a, self.poles)

    @cached_property
    def _set_off(self) -> Float64Array:
        """(n,) by how much a step of the desired position is still to go, of 1, and its derivatives, in `_chain`.

        Those of the step response of T are its Markov parameters: T(s) = h_1 / s + h_2 / s^2 + ...
        """
        w, n = self._chain[1], self.order
        a, b = self._a / self._a[0], np.concatenate([np.zeros(n - len(self._s)), self._s]) / self._a[0]
        h: list[float] = []
        for k in range(n - 1):
            h.append(float(b[k] - sum(a[i + 1] * h[k - 1 - i] for i in range(k))))
        gain = float(self._s[-1] / self._a[-1])
        return np.array([1.0, *(-x / gain / w ** (k + 1) for k, x in enumerate(h))])

    @cached_property
    def step(self) -> StepShape:
        """Overshoot, settling, rise and peak of the error after a step: e(0) = 1, v(0) = 0, integral zero.

        With `setpoint` after one of the desired position, and of what is still to go to where it ends.
        """
        if not self.stable:
            return NEVER
        if self.setpoint is not None:
            return step_shape(self._chain[0], self._set_off, np.eye(self.order)[0])
        if self.order == 2 and not self.integral:
            zeta = self.zeta if self._excess else 1.0
            overshoot, settling, rise, peak = shape(zeta)
            w = self.omega_n
            return StepShape(overshoot=overshoot, settling_time=settling / w, rise_time=rise / w, peak_time=peak / w)
        A, _ = self._chain
        at = np.eye(self.order)[int(self.integral)]
        return step_shape(A, at, at)

    @property
    def settling_by_rule(self) -> float:
        """[s] the chapter's rule of thumb, four of the slowest time constants."""
        return 4.0 * self.time_constant
