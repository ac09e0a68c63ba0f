"""Joints under PID as linear systems: the chapter's error dynamics, in continuous time and at a servo rate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, Literal

import numpy as np
import scipy.linalg
import scipy.signal

from taut.base.checks import (
    finite_array,
    finite_scalar,
    positive_scalar,
    rate_in_hertz,
    require_range,
    symmetric,
    symmetric_psd,
)
from taut.base.errors import ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.control.sensing import Difference, LowPass, check_filter
from taut.linear.linear_system import LinearSystem, names

VelocityKind = Literal["measured", "difference"] | LowPass | Difference
MIN_DAMPING: Final = 1e-3  # [-] damping ratio of a joint that is to settle
MAX_OVERSHOOT: Final = 99.0  # [%] of a step; without damping it is 100 %


@dataclass(frozen=True, kw_only=True)
class SecondOrder:
    """Gains of a joint and the standard second-order form of its error dynamics.

    Closed loop:  M e_ddot + (b + kd) e_dot + kp e = 0, or e_ddot + 2 zeta omega_n e_dot + omega_n^2 e = 0   eq. 10.8

    Args:
        M: Inertia [kg m^2 | kg]; 1 for gains in units of acceleration.
        b: Viscous friction [N m s/rad | N s/m].
        kp: Proportional gain [N m/rad | N/m].
        kd: Derivative gain [N m s/rad | N s/m].
    """

    M: float
    b: float
    kp: float
    kd: float

    @property
    def omega_n(self) -> float:
        """Natural frequency sqrt(kp / M) [rad/s]: eq. 10.9."""
        return math.sqrt(self.kp / self.M)

    @property
    def zeta(self) -> float:
        """Damping ratio (b + kd) / (2 sqrt(kp M)) [-]: eq. 10.9; above 1 overdamped; NaN without kp."""
        return (self.b + self.kd) / (2.0 * math.sqrt(self.kp * self.M)) if self.kp else math.nan

    @property
    def largest_ki(self) -> float:
        """Integral gain (b + kd) kp / M below which the error dynamics with an integral are stable (Routh)."""
        return (self.b + self.kd) * self.kp / self.M


def second_order(
    *,
    M: float = 1.0,
    b: float = 0.0,
    kp: float | None = None,
    kd: float | None = None,
    zeta: float | None = None,
    omega_n: float | None = None,
    settling: float | None = None,
    overshoot: float | None = None,
) -> SecondOrder:
    """Gains of a joint from a damping and a speed, or from one of its gains and another number.

    Closed loop:  M e_ddot + (b + kd) e_dot + kp e = 0
                  zeta = (b + kd) / (2 sqrt(kp M)),  omega_n = sqrt(kp / M)                         eq. 10.9

    Args:
        M: Inertia [kg m^2 | kg]; 1 for gains in units of acceleration, as in equation 10.19.
        b: Viscous friction [N m s/rad | N s/m].
        kp: Proportional gain [N m/rad | N/m].
        kd: Derivative gain [N m s/rad | N s/m].
        zeta: Damping ratio [-].
        omega_n: Natural frequency [rad/s].
        settling: Exact 2 % settling time of a step [s].
        overshoot: Of a step [%]; 0 for critical damping.

    Raises:
        UsageError: Not two of them that determine the gains.
        RangeError: A number out of range, or a specification that cannot be met.

    Example:
        >>> second_order(M=0.5, b=0.1, kd=2.0, zeta=1.0).kp
        2.205
        >>> d = second_order(omega_n=10.0, zeta=0.7)
        >>> d.kp, d.kd
        (100.0, 14.0)

    References:
        Chapter, section 10.2.1.1, equations 10.8 to 10.10.
    """
    M, b = positive_scalar("M", M, unit="kg m^2"), finite_scalar("b", b, unit="N m s/rad", minimum=0.0)
    units = {"kp": "N m/rad", "kd": "N m s/rad", "zeta": "", "omega_n": "rad/s", "settling": "s", "overshoot": "%"}
    values = zip(units.items(), (kp, kd, zeta, omega_n, settling, overshoot), strict=True)
    given = {
        name: finite_scalar(
            name, value, unit=unit, minimum=0.0, above=0.0 if name in ("omega_n", "settling") else -math.inf
        )
        for (name, unit), value in values
        if value is not None
    }
    dampings = {*given} & {"zeta", "overshoot"}
    if len(given) != 2 or (len(dampings) != 1 and ("kd" not in given or "settling" in given)):
        raise UsageError(
            "a damping (zeta or overshoot) and one of omega_n, kp, kd and settling determine the gains, or kd with "
            f"kp or omega_n; got {', '.join(given) if given else 'none'}",
            name=[*given][-1] if given else None,
        )
    require_range("overshoot", given.get("overshoot", 0.0), unit="%", maximum=MAX_OVERSHOOT)
    zeta = given.get("zeta", math.nan)
    if "overshoot" in given:
        decrement = math.log(100.0 / given["overshoot"]) if given["overshoot"] else math.inf
        zeta = 1.0 / math.hypot(1.0, math.pi / decrement)  # of exp(-pi zeta / sqrt(1 - zeta^2))
    frequency = given.get("omega_n", math.nan)
    if dampings and {*given} & {"settling", "kd"}:
        require_range("zeta", zeta, minimum=MIN_DAMPING, hint="without damping nothing settles")
        frequency = (b + given.get("kd", math.nan)) / (2.0 * M * zeta)
    if "settling" in given:
        frequency = settling_angle(zeta) / given["settling"]
    kp = given.get("kp", M * frequency**2)
    kd = given.get("kd", 2.0 * zeta * math.sqrt(kp * M) - b)
    if kd < 0.0:  # the friction alone damps more
        require_range("zeta", zeta, minimum=b / (2.0 * math.sqrt(kp * M)) if kp else math.inf)
    return SecondOrder(M=M, b=b, kp=kp, kd=max(kd, 0.0))


@cache
def settling_angle(zeta: float) -> float:
    """omega_n times the exact 2 % settling time of a step of second-order dynamics, zeta > 0."""
    system = LinearSystem(A=[[0.0, 1.0], [-1.0, -2.0 * zeta]], B=[[0.0], [1.0]])
    return system.step(input="u[0]", output="x[0]").settling_time


def joint_matrix(
    name: str,
    value: ArrayLike,
    n: int,
    unit: str = "",
    *,
    minimum: float = -math.inf,
    above: float = -math.inf,
) -> Float64Array:
    """(n, n) matrix of one number, n numbers or a symmetric matrix; `minimum` and `above` bound its eigenvalues."""
    given = finite_array(name, value, unit=unit)
    if given.shape not in ((), (n,), (n, n)):
        raise ShapeError(f"{name} must be a number, ({n},) or ({n}, {n}); got shape {given.shape}", name=name)
    if given.ndim == 2:
        if max(minimum, above) == -math.inf:
            symmetric(name, given, unit=unit)
        else:
            symmetric_psd(name, given, unit=unit, definite=above == 0.0)
        return 0.5 * (given + given.T)
    require_range(name, given, unit=unit, minimum=minimum, above=above)
    return np.diag(np.broadcast_to(given, (n,)))


def pid(
    n: int,
    *,
    kp: ArrayLike,  # a number, (n,) or (n, n) [N m/rad | N/m]
    kd: ArrayLike = 0.0,  # likewise [N m s/rad | N s/m]
    ki: ArrayLike = 0.0,  # likewise [N m/(rad s) | N/(m s)]
    rate: float | None = None,  # [Hz]
    velocity: VelocityKind = "measured",
) -> LinearSystem:
    """PID of n joints as a system; inputs q, v, ref.q, ref.v, outputs command and e; continuous without a rate.

    Law:          command = kp e + ki int(e) + kd e_dot,  e = ref.q - q,  e_dot = ref.v - v              eq. 10.6
                  sampled: int(e) sums e dt, this tick's included; v as the controller estimates it
    """
    P, D = joint_matrix("kp", kp, n, "N m/rad"), joint_matrix("kd", kd, n, "N m s/rad")
    Ki = joint_matrix("ki", ki, n, "N m/(rad s)")
    if not isinstance(velocity, (LowPass, Difference)) and velocity not in ("measured", "difference"):
        raise UsageError(
            "velocity must be 'measured', 'difference', taut.sensors.LowPass(...) or "
            f"taut.sensors.Difference(...); got {velocity!r}",
            name="velocity",
        )
    differenced = velocity == "difference" or isinstance(velocity, Difference)
    a, b, c, d = _velocity_filter(n, rate, velocity)
    memories = {"sensing.q_last": n * differenced, "sensing.velocity": len(a), "law.e_int": n * bool(Ki.any())}
    # Rows of matrices by all states, and behind them q, v, ref.q and ref.v.
    m = sum(memories.values())
    rows = np.split(np.eye(m + 4 * n), np.cumsum([*memories.values(), n, n, n]))
    q_last, filtered, e_int, q, v, q_des, v_des = rows
    raw = (q - q_last) * (rate or 0.0) if differenced else v
    e, estimate = q_des - q, c @ filtered + d @ raw
    summed = e_int if rate is None or not len(e_int) else e_int + e / rate
    command = P @ e + D @ (v_des - estimate) + Ki[:, : len(e_int)] @ summed
    after = np.vstack([q[: len(q_last)], a @ filtered + b @ raw, (e if rate is None else summed)[: len(e_int)]])
    shown = np.vstack([command, e])
    return LinearSystem(
        A=after[:, :m], B=after[:, m:], C=shown[:, :m], D=shown[:, m:], dt=None if rate is None else 1.0 / rate,
        states=[each for name, count in memories.items() for each in names(name, count)],
        inputs=[each for name in ("q", "v", "ref.q", "ref.v") for each in names(name, n)],
        outputs=(*names("command", n), *names("e", n)),
    )  # fmt: skip


def _velocity_filter(n: int, rate: float | None, velocity: VelocityKind) -> tuple[Float64Array, ...]:
    """(A, B, C, D) of the low-pass of n velocities; a direct path alone where there is none."""
    if rate is None or isinstance(velocity, str) or velocity.cutoff is None:
        return np.zeros((0, 0)), np.zeros((0, n)), np.zeros((n, 0)), np.eye(n)
    check_filter(velocity, "velocity", rate, n)
    cutoffs = np.broadcast_to(np.asarray(velocity.cutoff, dtype=float), (n,))
    each = [scipy.signal.tf2ss(*scipy.signal.butter(velocity.order, cutoff, fs=rate)) for cutoff in cutoffs.tolist()]
    return tuple(scipy.linalg.block_diag(*parts) for parts in zip(*each, strict=True))


def error_dynamics(
    *,
    M: ArrayLike = 1.0,
    b: ArrayLike = 0.0,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    ki: ArrayLike = 0.0,
    zeta: float | None = None,
    omega_n: float | None = None,
    settling: float | None = None,
    overshoot: float | None = None,
    rate: float | None = None,
    delay: float = 0.0,
    velocity: VelocityKind = "measured",
) -> LinearSystem:
    """Joints of inertia M and viscous friction b under PID, in continuous time or sampled.

    Law:          tau = kp e + ki int(e) + kd e_dot                                                      eq. 10.6
    Closed loop:  M e_ddot + (b + kd) e_dot + kp e + ki int(e) = tau_dist                                eq. 10.12
                  stable for 0 <= ki < (b + kd) kp / M (Routh); sampled: exact zero-order hold and delay

    The gains are kp, kd and ki; or of one joint ki and two of kp, kd, zeta, omega_n, settling and overshoot, as in
    `taut.analysis.second_order`. Directions of a coupled arm at its tool are joints too, with Lambda in place of M.

    Args:
        M: Inertia, a number, (n,) or (n, n) [kg m^2 | kg]; 1 for gains in units of acceleration, as in eq. 10.19.
        b: Viscous friction, likewise [N m s/rad | N s/m].
        kp: Proportional gain, likewise [N m/rad | N/m].
        kd: Derivative gain, likewise [N m s/rad | N s/m]; 0 if left out beside kp alone.
        ki: Integral gain, likewise [N m/(rad s) | N/(m s)].
        zeta: Damping ratio of one joint [-].
        omega_n: Its natural frequency [rad/s].
        settling: Its exact 2 % settling time [s].
        overshoot: Its overshoot [%].
        rate: Servo rate [Hz]; None in continuous time.
        delay: [s] from the tick to the torque, beyond the hold; any number of periods.
        velocity: "measured", "difference", `taut.sensors.LowPass(...)`, `taut.sensors.Difference(cutoff=...)`.

    Returns:
        States plant.q, plant.v and the memories. Inputs disturbance.command [N m | N], ref.q, ref.v; outputs q, v,
        command, e.

    Raises:
        UsageError, RangeError, ShapeError: An invalid number, by name.

    Example:
        >>> import taut
        >>> d = taut.error_dynamics(M=0.5, b=0.1, kp=2.205, kd=2.0)  # figure 10.6
        >>> d.poles.real.round(6).tolist(), round(d.step().settling_time, 3)
        ([-2.1, -2.1], 2.778)
        >>> taut.error_dynamics(M=0.5, b=0.1, kd=120.0, zeta=1.0, rate=100.0).stable
        False

    References:
        Chapter, section 10.2.1.1, equations 10.8 to 10.14 and figures 10.4 to 10.8.
    """
    if any(value is not None for value in (zeta, omega_n, settling, overshoot)):
        joint: dict[str, Any] = {"M": M, "b": b, "kp": kp, "kd": kd}  # of one joint, as second_order checks
        found = second_order(**joint, zeta=zeta, omega_n=omega_n, settling=settling, overshoot=overshoot)
        kp, kd = found.kp, found.kd
    kd = 0.0 if kd is None else kd
    shapes = [np.asarray(value).shape for value in (M, b, kp, kd, ki) if value is not None]
    n = max((shape[0] for shape in shapes if shape), default=1)
    inertia = joint_matrix("M", M, n, "kg m^2", above=0.0)
    damping = joint_matrix("b", b, n, "N m s/rad", minimum=0.0)
    if kp is None:
        raise UsageError("kp is needed, or two of kp, kd, zeta, omega_n, settling and overshoot", name="kp")
    kp, ki = joint_matrix("kp", kp, n, "N m/rad", minimum=0.0), joint_matrix("ki", ki, n, "N m/(rad s)", minimum=0.0)
    if rate is None and (delay or velocity != "measured"):
        raise UsageError("a delay, and a differenced or filtered velocity, are those of a servo; give rate= [Hz]",
                         name="rate")  # fmt: skip
    eye, none = np.eye(n), np.zeros((n, n))
    plant = LinearSystem(
        A=np.block([[none, eye], [none, -np.linalg.solve(inertia, damping)]]),
        B=np.vstack([none, np.linalg.inv(inertia)]), C=np.eye(2 * n),
        states=(*names("plant.q", n), *names("plant.v", n)), inputs=names("command", n),
        outputs=(*names("q", n), *names("v", n)),
    )  # fmt: skip
    if rate is None:
        return plant.feedback(pid(n, kp=kp, kd=kd, ki=ki))
    rate = rate_in_hertz(rate)
    law = pid(n, kp=kp, kd=kd, ki=ki, rate=rate, velocity=velocity)
    return plant.zoh(1.0 / rate, delay).feedback(law)
