"""What is left of an error once it has settled: after steps and ramps, and of sines."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from taut.base.checks import finite_array, finite_scalar, one_of, positive_scalar
from taut.base.errors import UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.linear import characteristic

__all__ = ["INPUTS", "ErrorLeft", "Input"]

Input = Literal["step", "ramp", "parabola", "disturbance"]
INPUTS: Final[tuple[Input, ...]] = ("step", "ramp", "parabola", "disturbance")
Complex = NDArray[np.complex128]


class ErrorLeft(ABC):
    """What the numerators of the error, and the characteristic polynomial, tell of what is left of it."""

    reference: ArrayLike | None
    disturbance: ArrayLike | None

    @property
    @abstractmethod
    def stable(self) -> bool:
        """Whether every error dies away."""

    @property
    @abstractmethod
    def _a(self) -> Float64Array:
        """(n + 1,) of the characteristic polynomial, from the highest power down."""

    def steady_state_error(self, to: Input = "step", size: float = 1.0) -> float | None:
        """What is left of the error in the end, by the final value theorem.

        Args:
            to: A "step", "ramp" or "parabola" (size t^2 / 2) of the desired position, or a constant "disturbance".
            size: Of it [rad, rad/s, rad/s^2 | N m].

        Returns:
            [rad | m]; infinite if the error grows for ever, None if it does not settle because the loop is unstable.

        Raises:
            UsageError: Not one of these, or its numerator is not known.

        Example:
            >>> import taut
            >>> pd = taut.analysis.second_order(M=0.5, b=0.1, kp=2.205, kd=2.0)
            >>> pd.steady_state_error("disturbance", 0.981), pd.replaced(ki=1.0).steady_state_error("disturbance")
            (0.444..., 0.0)
        """
        one_of("to", to, INPUTS)
        size = finite_scalar("size", size)
        numerator = self._numerator("disturbance" if to == "disturbance" else "reference")
        if not self.stable:
            return None
        power = {"step": 0, "ramp": 1, "parabola": 2, "disturbance": 0}[to]
        return characteristic.final_value(numerator, self._a, power, size)

    def sine_error(self, frequency: float, of: Literal["reference", "disturbance"] = "reference") -> float | None:
        """Amplitude of the error, once it has settled, over that of a sine that is followed or that disturbs.

        An integral takes away what a constant disturbance leaves, but not this.

        Args:
            frequency: [Hz].
            of: Whose sine.

        Returns:
            [rad/rad | rad/(N m)]; None if the loop is unstable.
        """
        omega = 2.0 * math.pi * positive_scalar("frequency", frequency, unit="Hz")
        one_of("of", of, ("reference", "disturbance"))
        return abs(complex(self.error_response(np.array([omega]), of)[0])) if self.stable else None

    def error_response(self, omega: ArrayLike, of: Literal["reference", "disturbance"] = "reference") -> Complex:
        """(k,) the error over the desired position, or over a disturbance, at angular frequencies.

        Args:
            omega: (k,) [rad/s].
            of: Over which.
        """
        s = 1j * finite_array("omega", omega, unit="rad/s")
        made: Complex = np.polyval(self._numerator(of), s) / np.polyval(self._a, s)
        return made

    def _numerator(self, name: str) -> Float64Array:
        value = getattr(self, name)
        if value is None:
            raise UsageError(
                f"a characteristic polynomial alone does not tell what a {name} does; give {name}=, the numerator of "
                "the error over it, or make the dynamics with taut.analysis.second_order",
                name=name,
            )
        made: Float64Array = np.asarray(value)
        return made
