"""From gains or a specification to second-order error dynamics, and to third order with an integral."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.optimize import brentq

from taut.base.checks import finite_scalar, positive_scalar, require_at_least, rounded_up
from taut.base.errors import RangeError, UsageError
from taut.linear.error_dynamics import ErrorDynamics
from taut.linear.joint_gains import JointGains
from taut.linear.second_order_response import FASTEST, settling_angle, zeta_of_overshoot

__all__ = ["second_order"]

UNITS: Final = {
    "kp": "N m/rad", "kd": "N m s/rad", "zeta": "", "omega_n": "rad/s", "settling": "s", "overshoot": "%",
}  # fmt: skip
SAME: Final = (("kp", "omega_n"), ("zeta", "overshoot"))  # each of a pair follows from the other


def second_order(
    *,
    M: float | None = None,
    b: float = 0.0,
    kp: float | None = None,
    kd: float | None = None,
    ki: float = 0.0,
    zeta: float | None = None,
    omega_n: float | None = None,
    settling: float | None = None,
    overshoot: float | None = None,
    feedforward: bool | None = None,
) -> ErrorDynamics:
    """Error dynamics of one joint: two of gains and specifications determine the rest.

    Law:          tau = kp e + ki int(e) + kd e_dot, with M a_des + b v_des if fed forward          eq. 10.6
    Closed loop:  M e_ddot + (b + kd) e_dot + kp e + ki int(e) = tau_dist                           eq. 10.12
                  zeta = (b + kd) / (2 sqrt(kp M)),  omega_n = sqrt(kp / M)                         eq. 10.9

    Without M the gains are in units of acceleration, as in equation 10.19, and the motion is fed forward. With ki the
    dynamics are of third order, and zeta, omega_n, settling and overshoot are those without it: first a good
    transient response, then a small ki, as the chapter advises.

    Args:
        M: Inertia [kg m^2 | kg].
        b: Viscous friction [N m s/rad | N s/m].
        kp: Proportional gain [N m/rad | N/m]; without M [1/s^2].
        kd: Derivative gain [N m s/rad | N s/m]; without M [1/s].
        ki: Integral gain [N m/(rad s) | N/(m s)]; without M [1/s^3].
        zeta: Damping ratio.
        omega_n: Natural frequency [rad/s].
        settling: Exact 2 % settling time of a step [s]; of several dampings that settle so, the largest.
        overshoot: Of a step [%]; 0 for critical damping, the least that has none.
        feedforward: Whether M a_des + b v_des is fed forward; if left out, only without M.

    Raises:
        UsageError: Too few of them, or such as determine one thing twice.
        RangeError: A number that has no meaning, or a specification that these cannot meet.


    References:
        Chapter, section 10.2.1.1, equations 10.8 to 10.14 and figures 10.4 to 10.7.
    """
    if M is None and b != 0.0:
        raise UsageError(
            "b is a friction [N m s/rad] and needs the inertia M= beside it; give M, or leave b out", name="b"
        )
    inertia = 1.0 if M is None else positive_scalar("M", M, unit="kg m^2")
    b = finite_scalar("b", b, unit="N m s/rad")
    require_at_least("b", np.array(b), 0.0, unit="N m s/rad")
    wanted = {"kp": kp, "kd": kd, "zeta": zeta, "omega_n": omega_n, "settling": settling, "overshoot": overshoot}
    given = _checked({name: value for name, value in wanted.items() if value is not None})
    found_kp, found_kd = _gains(inertia, b, given)
    joint = JointGains(
        M=inertia, b=b, kp=found_kp, kd=found_kd, ki=ki, fed_forward=M is None if feedforward is None else feedforward
    )
    return ErrorDynamics.of_gains(joint)


def _checked(given: Mapping[str, float]) -> dict[str, float]:
    """The two that determine it, each a number that has a meaning."""
    names = list(given)
    for one, other in SAME:
        if one in given and other in given:
            raise UsageError(
                f"{one} and {other} say the same thing twice, for each follows from the other; leave one of them out",
                name=one,
            )
    if len(names) != 2:
        got = " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names) or "none"
        word = "more than two" if len(names) > 2 else "too few"
        way_out = f"leave out {names[-1]}" if len(names) > 2 else f"add {_partners(names)}"
        raise UsageError(
            "two of kp, kd, zeta, omega_n, settling and overshoot determine second-order error dynamics; "
            f"got {word}: {got}; {way_out}",
            name=names[-1] if names else None,
        )
    made = {}
    for name, value in given.items():
        if name in ("kp", "kd", "zeta", "overshoot"):
            made[name] = finite_scalar(name, value, unit=UNITS[name])
            require_at_least(name, np.array(made[name]), 0.0, unit=UNITS[name])
        else:
            made[name] = positive_scalar(name, value, unit=UNITS[name])
    if made.get("overshoot", 1.0) >= 100.0:
        raise RangeError(
            f"overshoot must be below 100 %, which is that of no damping; got {made['overshoot']:g}",
            name="overshoot",
            value=made["overshoot"],
        )
    return made


def _partners(names: list[str]) -> str:
    same = {one: other for pair in SAME for one, other in (pair, pair[::-1])}
    free = [name for name in UNITS if name not in names and (not names or name != same.get(names[0]))]
    return f"one of {', '.join(free)}" if names else "two of them"


def _gains(M: float, b: float, given: Mapping[str, float]) -> tuple[float, float]:
    """kp and kd of the two that are given."""
    if "overshoot" in given:
        given = {**given, "zeta": zeta_of_overshoot(given["overshoot"])}
    if "settling" in given and "zeta" in given:
        if given["zeta"] == 0.0:
            raise RangeError("zeta must be > 0 for a settling time: without damping nothing settles", name="zeta")
        given = {**given, "omega_n": settling_angle(given["zeta"]) / given["settling"]}
    if "omega_n" in given:
        given = {**given, "kp": M * given["omega_n"] ** 2}
    if "settling" in given and "zeta" not in given:
        given = {**given, "zeta": _settling_zeta(M, b, given)}
    if "kd" in given and "kp" in given:
        return given["kp"], given["kd"]
    zeta = given["zeta"]
    if "kd" in given:
        if zeta == 0.0:
            raise RangeError(
                f"zeta must be > 0 where kd = {given['kd']:g} is given: no kp takes the damping away", name="zeta"
            )
        kp = (b + given["kd"]) ** 2 / (4.0 * M * zeta**2)
        return kp, given["kd"]
    kp = given["kp"]
    kd = 2.0 * zeta * math.sqrt(kp * M) - b
    if kd < 0.0:
        least = b / (2.0 * math.sqrt(kp * M)) if kp else math.inf
        raise RangeError(
            f"zeta must be at least {rounded_up(least)}, which the friction b = {b:g} alone gives with kp = {kp:.4g}"
            f"; got {zeta:.4g}; a larger kp or omega_n allows less",
            name="zeta",
            value=zeta,
        )
    return kp, kd


def _settling_zeta(M: float, b: float, given: Mapping[str, float]) -> float:
    """The largest damping ratio that settles in the time that is asked: by omega_n, or by kd."""
    time, least = given["settling"], settling_angle(FASTEST)
    if "kp" in given:
        if given["kp"] == 0.0:
            raise RangeError("kp must be > 0 for a settling time", name="kp", value=0.0)
        omega_n = math.sqrt(given["kp"] / M)
        asked, by_rate, what = time * omega_n, False, f"omega_n = {omega_n:.4g} rad/s"
    else:
        rate = (b + given["kd"]) / (2.0 * M)  # zeta omega_n
        if rate == 0.0:
            raise RangeError("kd must be > 0 for a settling time: without damping nothing settles", name="kd")
        asked, by_rate, what = time * rate, True, f"kd = {given['kd']:g}"
        least *= FASTEST
    if asked < least * (1.0 - 1e-12):
        raise RangeError(
            f"settling must be at least {rounded_up(time * least / asked)} s, which is the fastest for {what}, with "
            f"zeta = {FASTEST:.2f}; got {time:g} s",
            name="settling",
            value=time,
        )

    def late(zeta: float) -> float:
        return settling_angle(zeta) * (zeta if by_rate else 1.0) - asked

    low = FASTEST * (1.0 + 1e-12)  # just below it the last crossing is half a turn later
    if late(low) >= 0.0:
        return low
    return float(brentq(late, low, max(10.0, math.sqrt(asked) if by_rate else asked), xtol=1e-15, rtol=1e-14))
