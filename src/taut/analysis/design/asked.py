"""What a design asks for: damping, speed and stiffness, each from whichever of the usual numbers is given."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import brentq

from taut.base.checks import finite_array, finite_scalar, require_at_least, require_positive
from taut.base.errors import RangeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.linear.second_order import second_order
from taut.linear.second_order_response import overshoot_of, settling_angle, zeta_of_overshoot

__all__ = ["BAND", "SPEEDS", "Asked", "bandwidth_ratio", "plain", "six_by_six"]

SPEEDS: Final = {"omega_n": "rad/s", "settling": "s", "bandwidth": "rad/s"}
MATRICES: Final = {"K": "N/m, N m/rad", "D": "kg, kg m^2", "contact": "N/m, N m/rad"}
MOST_ZETA: Final = 1e3
BAND: Final = 50.0  # of an error and its 2 %


def bandwidth_ratio(zeta: float) -> float:
    """Bandwidth over natural frequency: where omega_n^2 / (s^2 + 2 zeta omega_n s + omega_n^2) is 3 dB down.

    Example:
        >>> round(bandwidth_ratio(1.0), 4), round(bandwidth_ratio(0.5**0.5), 4)
        (0.6436, 1.0)
    """
    half = 1.0 - 2.0 * zeta**2
    return math.sqrt(1.0 / (math.hypot(half, 1.0) - half) if half < 0.0 else half + math.hypot(half, 1.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Asked:
    """The numbers of a specification, checked one by one; None for what is not asked.

    Args:
        zeta: Damping ratio.
        overshoot: Of a step [%].
        omega_n: Natural frequency [rad/s]: a number, or one per direction.
        settling: Exact 2 % settling time [s], likewise.
        bandwidth: [rad/s], likewise.
        K: Stiffness.
        D: Inertia to be felt at the tool.
        contact: Stiffness of what is pressed on.
        force: Pole of the force [1/s].
        integral: Share of the largest ki.

    Raises:
        UsageError: Numbers that say the same thing twice.
        RangeError, ShapeError: A number that has no meaning.
    """

    zeta: float | None = None
    overshoot: float | None = None
    omega_n: ArrayLike | None = None
    settling: ArrayLike | None = None
    bandwidth: ArrayLike | None = None
    K: ArrayLike | None = None
    D: ArrayLike | None = None
    contact: ArrayLike | None = None
    force: float | None = None
    integral: float = 0.0

    def __post_init__(self) -> None:
        for name, unit in SPEEDS.items():
            value = getattr(self, name)
            if value is not None:
                array = finite_array(name, value, unit=unit)
                require_positive(name, array, unit=unit)
                object.__setattr__(self, name, array)
        for name, unit in MATRICES.items():
            value = getattr(self, name)
            if value is not None:
                array = finite_array(name, value, unit=unit)
                if array.ndim < 2:
                    require_at_least(name, array, 0.0, unit=unit)
                object.__setattr__(self, name, array)
        for name, unit in (("zeta", ""), ("overshoot", "%"), ("force", "1/s"), ("integral", "")):
            value = getattr(self, name)
            if value is None:
                continue
            number = finite_scalar(name, value, unit=unit)
            if name == "zeta" and number <= 0.0:
                raise RangeError(
                    "zeta must be > 0: without damping a swing goes on for ever, and a loop that holds its torque "
                    f"through a period makes it grow; got {number:g}; zeta = 1 is critical damping",
                    name="zeta",
                    value=number,
                    rule="> 0",
                )
            if name == "force":  # a pole at zero takes no error away
                require_positive(name, np.array(number), unit=unit)
            require_at_least(name, np.array(number), 0.0, unit=unit)
            object.__setattr__(self, name, number)
        if self.zeta is not None and self.overshoot is not None:
            raise UsageError(
                f"zeta and overshoot say the same thing twice: zeta = {self.zeta:g} overshoots by "
                f"{overshoot_of(self.zeta):.3g} %, and an overshoot of {self.overshoot:g} % is zeta = "
                f"{_zeta_of(self.overshoot):.3g}; leave one of them out",
                name="overshoot",
            )
        if self.overshoot is not None:
            _zeta_of(self.overshoot)
        if not 0.0 <= self.integral < 1.0:
            raise RangeError(
                "integral is the share of the largest ki, (b + kd) kp / M, from 0 up to below 1, where the loop "
                f"swings for ever; got {self.integral:g}",
                name="integral",
                value=self.integral,
            )

    @property
    def given(self) -> dict[str, object]:
        """What is asked, by name."""
        every = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {
            name: value
            for name, value in every.items()
            if value is not None and not (name == "integral" and not value)
        }

    @property
    def speeds(self) -> tuple[str, ...]:
        """Which speeds are given."""
        return tuple(name for name in SPEEDS if getattr(self, name) is not None)

    @property
    def damping(self) -> float | None:
        """The damping ratio, by either name."""
        return self.zeta if self.overshoot is None else _zeta_of(self.overshoot)

    def only(self, law: str, *names: str) -> None:
        """Refuse what has no meaning for a law.

        Raises:
            UsageError: Something else is asked.
        """
        wrong = [name for name in self.given if name not in names]
        if wrong:
            raise UsageError(
                f"{wrong[0]} has no meaning for {law}, whose design takes {', '.join(names)}; leave it out",
                name=wrong[0],
            )

    # ---------------------------------------------------------------- speed and damping

    def swing(self, law: str) -> tuple[float, Float64Array]:
        """Damping ratio and natural frequency of second-order error dynamics.

        Raises:
            UsageError: Too little, or the same thing twice.
            RangeError: What no second-order dynamics can do.
        """
        names, zeta = self.speeds, self.damping
        way_out = f"as in taut.design(taut.laws.{law}, arm, zeta=1.0, omega_n=10.0)"
        if len(names) == 2 and zeta is None and "omega_n" in names:
            return self._of_two(names)
        if len(names) > 1:
            other = "" if zeta is None else " beside a damping"
            raise UsageError(
                f"{' and '.join(names)}{other} determine one speed more than once; leave out {names[-1]}",
                name=names[-1],
            )
        if zeta is None or not names:
            missing = "its damping: zeta or overshoot" if names else "its speed: omega_n, settling or bandwidth"
            raise UsageError(f"{law} needs {missing}; {way_out}", name="zeta" if names else "omega_n")
        return zeta, self.frequency(zeta)

    def frequency(self, zeta: float) -> Float64Array:
        """Natural frequency with a damping ratio, of the one speed that is given."""
        (name,) = self.speeds
        value: Float64Array = np.asarray(getattr(self, name), dtype=np.float64)
        if name == "omega_n":
            return value
        if name == "bandwidth":
            return np.asarray(value / bandwidth_ratio(zeta))
        if zeta == 0.0:
            raise RangeError("zeta must be > 0 for a settling time: without damping nothing settles", name="zeta")
        return np.asarray(settling_angle(zeta) / value)

    def _of_two(self, names: tuple[str, ...]) -> tuple[float, Float64Array]:
        """The damping ratio at which omega_n has the settling time or the bandwidth too."""
        omega = np.asarray(self.omega_n, dtype=np.float64)
        other = next(name for name in names if name != "omega_n")
        value = np.asarray(getattr(self, other), dtype=np.float64)
        if omega.ndim or value.ndim:
            raise UsageError(
                f"omega_n with {other} gives one damping ratio for all; give one number of each, or zeta", name=other
            )
        if other == "settling":
            return second_order(omega_n=float(omega), settling=float(value)).zeta, omega
        ratio = float(value / omega)
        most, least = bandwidth_ratio(0.0), bandwidth_ratio(MOST_ZETA)
        if not least < ratio <= most:
            rule = f"at most {most:.4g} omega_n = {most * float(omega):.4g} rad/s, which it is without damping"
            if ratio <= least:
                rule = (
                    f"more than {least:.4g} omega_n = {least * float(omega):.4g} rad/s, which it is with zeta = "
                    f"{MOST_ZETA:g}"
                )
            raise RangeError(
                f"bandwidth must be {rule}; got {float(value):g} rad/s", name="bandwidth", value=float(value)
            )
        return float(brentq(lambda z: bandwidth_ratio(z) - ratio, 0.0, MOST_ZETA, xtol=1e-14)), omega

    def pole(self, law: str) -> Float64Array:
        """The pole of first-order error dynamics [1/s].

        Raises:
            UsageError: None or two of them.
        """
        names = [name for name in ("bandwidth", "settling") if getattr(self, name) is not None]
        if len(names) != 1:
            raise UsageError(
                f"{law} needs one of bandwidth [rad/s] and settling [s]; got {' and '.join(names) or 'none'}",
                name="bandwidth",
            )
        value = np.asarray(getattr(self, names[0]), dtype=np.float64)
        return value if names[0] == "bandwidth" else np.asarray(math.log(BAND) / value)


def _zeta_of(overshoot: float) -> float:
    if overshoot >= 100.0:
        raise RangeError(
            f"overshoot must be below 100 %, which is that of no damping; got {overshoot:g}",
            name="overshoot",
            value=overshoot,
        )
    return zeta_of_overshoot(overshoot)


def six_by_six(name: str, value: ArrayLike | None, size: int = 6) -> Float64Array:
    """(k, k) of (linear, angular), of one number per direction, or of a matrix.

    Raises:
        UsageError: One number for metres and radians, or another shape.
    """
    given = np.asarray(value, dtype=np.float64)
    if given.ndim == 0 and size == 6:
        raise UsageError(
            f"{name} needs one number for metres and one for radians, {name}=(linear, angular), or six, or (6, 6); "
            f"got {float(given):g} alone",
            name=name,
        )
    if given.shape == (2,) and size == 6:
        given = np.repeat(given, 3)
    if given.shape in ((), (size,)):
        given = np.diag(np.broadcast_to(given, (size,)))
    if given.shape != (size, size):
        shapes = "(linear, angular), six numbers or (6, 6)" if size == 6 else f"{size} numbers or ({size}, {size})"
        got = f"{len(given)} numbers" if given.ndim == 1 else f"shape {given.shape}"
        raise UsageError(f"{name} must be {shapes}; got {got}", name=name)
    return np.array(given)


def plain(value: object) -> str:
    """What was asked for, in words of four digits."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0:
        return f"{float(array):.4g}"
    if array.ndim == 1:
        return f"({', '.join(f'{x:.4g}' for x in array)})"
    return f"a matrix of {array.shape[0]} rows"
