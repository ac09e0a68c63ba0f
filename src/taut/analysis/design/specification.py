"""Specification of a design, and the gains that place the poles of a law's closed loop accordingly."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from scipy.linalg import eigh

from taut.base.errors import RangeError, UsageError
from taut.base.fields import Declared, Field
from taut.base.types import Float64Array
from taut.control.closed_loop import ClosedLoop, PlacedGains
from taut.control.law import Law
from taut.linear.joint_loop import second_order

SETTLED_RATIO: Final = 50.0  # [-] of a step and the 2 % within which it has settled
FREE: Final = 1e-9  # [-] of the largest stiffness over inertia: a motion that no spring draws back


class Specification(Declared):
    """The numbers that a design asks for; None for those that it does not.

    Speeds and stiffnesses are a number, one for each direction, or (linear, angular) at the tool; K and contact also
    matrices.

    Raises:
        RangeError, ShapeError: A number outside of its range.
        UsageError: Two numbers for the same thing, or none.
    """

    zeta: Field = Field(above=0.0, run_time=False, optional=True, hint="zeta = 1 is critical damping")
    overshoot: Field = Field(unit="%", minimum=0.0, run_time=False, optional=True)
    omega_n: Field = Field(unit="rad/s", shape="n", above=0.0, optional=True)
    settling: Field = Field(unit="s", shape="n", above=0.0, optional=True)
    K: Field = Field(unit="N/m, N m/rad", shape="n", accepts=("matrix",), minimum=0.0, optional=True)
    contact: Field = Field(unit="N/m, N m/rad", shape="n", accepts=("matrix",), above=0.0, optional=True)
    force: Field = Field(unit="1/s", above=0.0, run_time=False, optional=True)
    integral: Field = Field(0.0, minimum=0.0, run_time=False)

    def check(self) -> None:
        for names in (("zeta", "overshoot"), ("omega_n", "settling", "K")):
            given = [name for name in names if getattr(self, name) is not None]
            if len(given) > 1:
                raise UsageError(
                    f"{' and '.join(given)} determine the same number; give one of {', '.join(names)}", name=given[-1]
                )
        for name, limit in (("overshoot", 100.0), ("integral", 1.0)):
            value = getattr(self, name)
            if value is not None and value >= limit:
                rule = f"must be below {limit:g}, where the loop oscillates without damping; got {value:g}"
                self.refuse(name, rule, RangeError)

    @property
    def given(self) -> dict[str, Any]:
        """The specified numbers, by name."""
        every = {name: getattr(self, name) for name in self.declared}
        return {name: value for name, value in every.items() if value is not None and (name != "integral" or value)}

    @property
    def damping_ratio(self) -> float | None:
        """Damping ratio, also of a specified overshoot."""
        return self.zeta if self.overshoot is None else second_order(omega_n=1.0, overshoot=self.overshoot).zeta

    def frequencies(self, loop: ClosedLoop) -> Float64Array:
        """(k,) natural frequency of each coordinate; the single pole where no damping is given [rad/s]."""
        if self.omega_n is not None:
            return per_coordinate("omega_n", self.omega_n, loop)
        zeta = self.damping_ratio
        angle = math.log(SETTLED_RATIO) if zeta is None else second_order(zeta=zeta, settling=1.0).omega_n
        return angle / per_coordinate("settling", self.settling, loop)

    def check_fit(self, law: str, loop: ClosedLoop) -> None:
        """Refuse a specification that does not determine a law's closed loop, or asks for what it has not."""
        single = self.damping_ratio is None and loop.single_pole != "never"
        speeds = ("contact",) if loop.contact is not None else ("omega_n", "settling", *(("K",) * loop.stiffness))
        takes = [*speeds]
        takes += ["zeta", "overshoot"] if loop.single_pole != "always" else []
        takes += ["force"] if loop.contact is not None or loop.force is not None else []
        takes += ["integral"] if loop.contact is None and loop.single_pole == "never" else []
        wrong = [name for name in self.given if name not in takes]
        if wrong:
            raise UsageError(
                f"{wrong[0]} does not apply to {law}, whose design takes {', '.join(takes)}; leave it out",
                name=wrong[0],
            )
        if not any(name in self.given for name in speeds):
            raise UsageError(f"{law} needs one of {', '.join(speeds)}", name=speeds[0])
        undamped = loop.single_pole != "always" and self.damping_ratio is None
        if undamped and (not single or self.K is not None):
            raise UsageError(f"{law} needs its damping: zeta or overshoot", name="zeta")


def per_coordinate(name: str, value: Any, loop: ClosedLoop) -> Float64Array:
    """(k,) of a number, of (linear, angular), or of one for each."""
    values, k = np.asarray(value, dtype=np.float64), len(loop.J)
    if values.shape == (2,) and k == 6 and set(loop.units) == {"m", "rad"}:
        return np.repeat(values, 3)
    if values.shape not in ((), (k,)):
        raise UsageError(
            f"{name} must be a number, one for each of {k} directions, or (linear, angular) at the tool; got shape "
            f"{values.shape}",
            name=name,
        )
    return np.array(np.broadcast_to(values, (k,)))


def square(name: str, value: Any, loop: ClosedLoop) -> Float64Array:
    """(k, k) of a stiffness: a matrix, or numbers along its diagonal; one for metres and radians is refused."""
    values, k = np.asarray(value, dtype=np.float64), len(loop.J)
    if values.shape == (k, k):
        return values
    if values.ndim == 0 and len(set(loop.units)) > 1 and len(loop.J) == 6:
        raise UsageError(
            f"{name} needs one number for metres and one for radians, {name}=(linear, angular), or six, or (6, 6); "
            f"got {float(values):g} alone",
            name=name,
        )
    return np.diag(per_coordinate(name, values, loop))


def place_poles(loop: ClosedLoop, specification: Specification, *, coupled: bool) -> Law:
    """The law whose closed loop has the poles that are asked for.

    Law:    K = S inertia S with S = diag(omega_n), or as it is asked for; D = 2 zeta (inertia K)^(1/2): the same zeta
            in every mode; Ki = integral D inertia^-1 K. Single poles: D = inertia omega_n.
    """
    zeta, M = specification.damping_ratio, loop.apparent
    if loop.decentralised and not coupled:
        M = np.diag(np.diag(M))
    if loop.single_pole == "always" or zeta is None:
        S = loop.inside(np.diag(specification.frequencies(loop)))
        K, D = np.zeros_like(M), 0.5 * (S @ M + M @ S)
    else:
        if specification.K is not None:
            K = loop.inside(square("K", specification.K, loop))
        elif loop.contact is not None:
            K = loop.inside(loop.contact @ square("contact", specification.contact, loop))
        else:
            S = loop.inside(np.diag(specification.frequencies(loop)))
            K = S @ M @ S
        inertia = np.asarray(loop.x.M) if loop.damps_joints else M
        D = damping_of(inertia, loop.rows.T @ K @ loop.rows if loop.damps_joints else K, zeta)
    Ki = specification.integral * D @ np.linalg.solve(M, K) if specification.integral else np.zeros_like(K)
    return loop.gains(
        PlacedGains(
            K=compact(loop.outside(K) if specification.K is None else square("K", specification.K, loop)),
            D=compact(D if loop.damps_joints else loop.outside(D)),
            Ki=compact(loop.outside(0.5 * (Ki + Ki.T))),
            zeta=1.0 if zeta is None else zeta,
            force=specification.force,
        )
    )


def damping_of(inertia: Float64Array, K: Float64Array, zeta: float) -> Float64Array:
    """The damping that gives every mode the ratio zeta; modes without stiffness decay like the slowest with one."""
    if is_diagonal(inertia) and is_diagonal(K) and np.diag(K).all():
        return np.diag(2.0 * zeta * np.sqrt(np.diag(inertia) * np.diag(K)))
    squares, modes = eigh(K, inertia)  # modes^T inertia modes = identity
    drawn = squares > FREE * max(float(squares[-1]), 1e-300)
    omega = np.sqrt(np.where(drawn, squares, squares[drawn].min() if drawn.any() else 0.0))
    across = inertia @ modes
    D = across @ np.diag(2.0 * zeta * omega) @ across.T
    return np.asarray(0.5 * (D + D.T))


def is_diagonal(C: Float64Array) -> bool:
    """Whether nothing is beside the diagonal."""
    return not np.any(C - np.diag(np.diag(C)))


def compact(C: Float64Array) -> Float64Array:
    """(k,) the diagonal of a diagonal matrix; else the matrix."""
    return np.diag(C).copy() if is_diagonal(C) else C
