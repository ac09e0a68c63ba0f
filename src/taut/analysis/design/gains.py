"""Gains of every law from a specification, for the worst of some poses."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.linalg import eigh

from taut import laws
from taut.analysis.design.asked import BAND, Asked, plain, six_by_six
from taut.analysis.design.place import at_tool
from taut.analysis.design.tool_gains import admittance, damped, impedance, stiffness
from taut.arm.description import Arm
from taut.base.checks import require_positive, rounded_up
from taut.base.errors import RangeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.control.law import Law
from taut.linear.second_order import second_order
from taut.maths.snapshot import Snapshot

__all__ = ["Case", "gains_for"]

INNER: Final = 5.0  # times as fast as the model is the law that follows it
SWING: Final = ("zeta", "overshoot", "omega_n", "settling", "bandwidth")


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A law to find gains for, where, and of what it may know.

    Args:
        law: With any gains.
        arm: The arm.
        at: The arm at rest at each pose.
        asked: The specification.
        b: (n,) viscous friction that counts as damping.
        coupled: Whether gains may be matrices, like M.
        rate: [Hz].
    """

    law: Law
    arm: Arm
    at: tuple[Snapshot, ...]
    asked: Asked
    b: Float64Array
    coupled: bool
    rate: float

    @property
    def name(self) -> str:
        """Of the law."""
        return type(self.law).__name__

    def of(self, law: Law, **changed: Any) -> Case:
        """The same for another law."""
        return dataclasses.replace(self, law=law, **changed)

    @property
    def heaviest(self) -> Float64Array:
        """(n,) the largest inertia that each joint has at any of the poses, rotors included."""
        return np.asarray(np.max([np.diag(np.asarray(x.M)) for x in self.at], axis=0))


def gains_for(case: Case) -> Law:
    """The law with the gains that were asked for.

    Raises:
        UsageError: A law without error dynamics of its own, or a specification that does not determine them.
        RangeError: A specification that cannot be met.
    """
    kind = type(case.law)
    if kind not in RECIPES:
        raise UsageError(f"{case.name} {WITHOUT.get(kind, OTHERS)}", name="law")
    if case.coupled and kind not in COUPLED:
        raise UsageError(
            f"coupled=True is for PID and GravityPID, whose gains do not know the mass matrix; {case.name} does "
            "without; leave it out",
            name="coupled",
        )
    return RECIPES[kind](case)


def _replaced(law: Law, **gains: Any) -> Law:
    return dataclasses.replace(law, **gains)


# -------------------------------------------------------------------- joints


def _torque_gains(case: Case) -> Law:
    """kp = M_ii omega_n^2, kd = 2 zeta omega_n M_ii - b: each joint with the inertia that it has by itself."""
    case.asked.only(case.name, *SWING, "K", "integral")
    if case.coupled:
        return _matrix_gains(case)
    M, n = case.heaviest, case.arm.n
    if case.asked.K is not None:
        pairs = _of_stiffness(case, M)
    else:
        zeta, omega = case.asked.swing(case.name)
        omega = _per_joint("omega_n", omega, n) * _hurry(case, zeta)
        pairs = [(M[i] * omega[i] ** 2, 2.0 * zeta * omega[i] * M[i] - case.b[i]) for i in range(n)]
        _require_more_than_friction(case, zeta, M, omega)
    kp, kd = (np.array(each) for each in zip(*pairs, strict=True))
    ki = case.asked.integral * (case.b + kd) * kp / M
    return _replaced(case.law, kp=kp, kd=kd, ki=ki)


def _require_more_than_friction(case: Case, zeta: float, M: Float64Array, omega: Float64Array) -> None:
    """A damping ratio that the friction of no joint has alone."""
    alone = case.b / (2.0 * omega * M)
    i = int(np.argmax(alone))
    if zeta < alone[i]:
        raise RangeError(
            f"zeta must be at least {rounded_up(float(alone[i]))}, which the friction of joint "
            f"'{case.arm.joint_names[i]}' alone gives with omega_n = {omega[i]:.4g} rad/s; got {zeta:.4g}; a larger "
            f"{'K' if case.asked.K is not None else 'omega_n'} allows less",
            name="zeta",
            joint=case.arm.joint_names[i],
            value=zeta,
        )


def _of_stiffness(case: Case, M: Float64Array) -> list[tuple[float, float]]:
    """kp and kd of joints whose stiffness is given."""
    asked = case.asked
    K = _joint_stiffness(case)
    if (
        len(asked.speeds) > 1
        or (asked.speeds and asked.speeds != ("settling",))
        or (asked.speeds and asked.damping is not None)
    ):
        raise UsageError(
            f"K and the inertia of a joint determine omega_n already, so that K goes with zeta, overshoot or "
            f"settling alone; leave out {asked.speeds[-1]}",
            name=asked.speeds[-1],
        )
    if asked.damping is None and not asked.speeds:
        raise UsageError(f"{case.name} with K needs its damping: zeta or overshoot, or settling", name="zeta")
    omega, made = np.sqrt(K / M), []
    if asked.damping is not None:
        _require_more_than_friction(case, asked.damping, M, omega)
    for i in np.argsort(omega).tolist():  # the slowest first, which needs the most time
        settling = (
            None if not asked.speeds else float(_per_joint("settling", np.asarray(asked.settling), case.arm.n)[i])
        )
        d = second_order(M=M[i], b=float(case.b[i]), kp=float(K[i]), zeta=asked.damping, settling=settling)
        made.append((i, (d.kp, d.kd)))
    return [pair for _, pair in sorted(made)]


def _joint_stiffness(case: Case) -> Float64Array:
    """(n,) of joints, each of which must have some."""
    K = _per_joint("K", np.asarray(case.asked.K, dtype=np.float64), case.arm.n)
    require_positive("K", K, unit="N m/rad | N/m", joints=case.arm.joint_names)
    return K


def _hurry(case: Case, zeta: float) -> float:
    """How much faster than for the heaviest pose, so that the lighter ones settle in time too.

    A lighter joint is damped more: above zeta = 1 it settles later, though its omega_n is higher.
    """
    if case.asked.settling is None or zeta == 0.0:
        return 1.0
    M = case.heaviest
    worst = 1.0
    for x in case.at:
        for light, heavy in zip(np.diag(np.asarray(x.M)), M, strict=True):
            ratio = float(np.sqrt(heavy / light))
            alone = second_order(omega_n=1.0, zeta=zeta).settling_time
            worst = max(worst, second_order(omega_n=ratio, zeta=zeta * ratio).settling_time / alone)
    return worst


def _matrix_gains(case: Case) -> Law:
    """kp = omega_n^2 M, kd = 2 zeta omega_n M - b: all directions alike at the heaviest pose, the others faster."""
    zeta, omega = case.asked.swing(case.name)
    if case.asked.K is not None or omega.ndim:
        raise UsageError("coupled=True takes one speed for all joints, and no K", name="omega_n")
    inertias = [np.asarray(x.M) for x in case.at]
    chosen = max(inertias, key=lambda M: float(np.trace(M)))
    M = chosen * max(float(eigh(each, chosen, eigvals_only=True)[-1]) for each in inertias)
    w = float(omega)
    kp, kd = w**2 * M, 2.0 * zeta * w * M - np.diag(case.b)
    if np.linalg.eigvalsh(kd)[0] < 0.0:
        raise RangeError(
            f"zeta = {zeta:.4g} with omega_n = {w:.4g} rad/s is less damping than the friction of the joints has; "
            "ask for more of either",
            name="zeta",
            value=zeta,
        )
    return _replaced(case.law, kp=kp, kd=kd, ki=case.asked.integral * 2.0 * zeta * w**3 * M)


def _acceleration_gains(case: Case) -> Law:
    """kp = omega_n^2, kd = 2 zeta omega_n, whatever the inertia; of K, what the lightest pose needs."""
    case.asked.only(case.name, *SWING, "K", "integral")
    zeta, omega = case.asked.damping, np.zeros(())
    if case.asked.K is None:
        zeta, omega = case.asked.swing(case.name)
    else:
        if case.asked.speeds or zeta is None:
            raise UsageError(
                f"K and the inertia determine omega_n of {case.name}: K goes with zeta or overshoot alone", name="K"
            )
        K = _joint_stiffness(case)
        lightest = np.min([np.diag(np.asarray(x.M)) for x in case.at], axis=0)
        omega = np.sqrt(K / lightest)
    assert zeta is not None
    if omega.ndim:
        omega = _per_joint("omega_n", omega, case.arm.n)
    kp, kd = omega**2, 2.0 * zeta * omega
    return _replaced(case.law, kp=kp, kd=kd, ki=case.asked.integral * kp * kd)


def _floating(case: Case) -> Law:
    """kd = M_ii pole - b: what a push leaves of speed dies away with that pole, at the heaviest pose."""
    case.asked.only(case.name, "bandwidth", "settling")
    pole = _per_joint(
        case.asked.speeds[0] if case.asked.speeds else "bandwidth", case.asked.pole(case.name), case.arm.n
    )
    kd, alone = case.heaviest * pole - case.b, case.b / case.heaviest
    i = int(np.argmax(alone / pole))
    if alone[i] > pole[i]:
        (name,) = case.asked.speeds
        least, got = (alone, pole) if name == "bandwidth" else (math.log(BAND) / alone, math.log(BAND) / pole)
        bound = (
            f"at least {rounded_up(float(least[i]))} rad/s"
            if name == "bandwidth"
            else f"at most {least[i] * 0.999:.4g} s"
        )
        raise RangeError(
            f"{name} must be {bound}, which the friction of joint '{case.arm.joint_names[i]}' alone gives; got "
            f"{got[i]:.4g}",
            name=name,
            joint=case.arm.joint_names[i],
            value=float(got[i]),
        )
    return _replaced(case.law, kd=kd)


def _velocity_gains(case: Case) -> Law:
    """kp = pole; with zeta kp = 2 zeta omega_n and ki = omega_n^2."""
    if case.asked.damping is None:
        case.asked.only(case.name, "bandwidth", "settling")
        return _replaced(case.law, kp=case.asked.pole(case.name), ki=0.0)
    case.asked.only(case.name, *SWING)
    zeta, omega = case.asked.swing(case.name)
    return _replaced(case.law, kp=2.0 * zeta * omega, ki=omega**2)


def _first_order(case: Case) -> Law:
    """kp = pole, which the servo rate bounds: in one tick no more than all of an error can go."""
    case.asked.only(case.name, "bandwidth", "settling")
    pole = case.asked.pole(case.name)
    fastest = float(np.max(pole))
    if fastest > case.rate:
        (name,) = case.asked.speeds
        raise RangeError(
            f"{name} = {plain(getattr(case.asked, name))} cannot be met: at {case.rate:g} Hz a pole of {case.rate:g} "
            f"1/s takes all of an error away in one tick, and this would be one of {fastest:.4g} 1/s; ask for a "
            "slower design, or a higher rate",
            name=name,
            value=fastest,
            rule=f"<= {case.rate:g} 1/s",
        )
    return _replaced(case.law, kp=pole)


def _per_joint(name: str, values: Float64Array, n: int) -> Float64Array:
    if values.shape not in ((), (n,)):
        raise UsageError(
            f"{name} must be a number or one for each of {n} joints; got shape {values.shape}", name=name
        )
    return np.array(np.broadcast_to(values, (n,)))


# -------------------------------------------------------------------- the tool


def _task_gains(case: Case) -> Law:
    case.asked.only(case.name, *SWING, "integral")
    zeta, omega = case.asked.swing(case.name)
    for x in case.at:
        at_tool(case.law, x)  # refuses singular poses
    kp, kd = omega**2, 2.0 * zeta * omega
    return _replaced(case.law, kp=kp, kd=kd, ki=case.asked.integral * kp * kd)


def _impedance(case: Case) -> Law:
    case.asked.only(case.name, *SWING, "K", "D")
    return _replaced(case.law, **impedance(case.law, case.at, case.asked))


def _stiffness(case: Case) -> Law:
    case.asked.only(case.name, "zeta", "overshoot", "K")
    return _replaced(case.law, **stiffness(case.law, case.at, case.asked))


def _admittance(case: Case) -> Law:
    """Of the virtual mass, damper and spring; the law that follows them is made five times as fast if it is ours."""
    case.asked.only(case.name, *SWING, "K", "D")
    gains, fastest = admittance(case.asked)
    inner: Any = vars(case.law)["inner"]
    if inner is PLACEHOLDER:
        inner = gains_for(
            case.of(laws.TaskComputedTorque(kp=1.0, kd=1.0), asked=Asked(zeta=1.0, omega_n=INNER * fastest))
        )
    return _replaced(case.law, inner=inner, **gains)


PLACEHOLDER: Final = laws.TaskComputedTorque(kp=1.0, kd=1.0)
"""The inner law of an Admittance that was given as a class."""


def _force(case: Case) -> Law:
    """kfi = (1 + kfp) pole; of the swing on a contact kdamp = 2 zeta (Lambda (1 + kfp) contact)^(1/2)."""
    case.asked.only(case.name, "bandwidth", "settling", "force", "zeta", "overshoot", "contact")
    law: Any = case.law
    pole = case.asked.force if case.asked.force is not None else case.asked.pole(case.name)
    fastest, most = float(np.max(pole)), 2.0 * case.rate
    if fastest >= most:
        name = "force" if case.asked.force is not None else "bandwidth"
        raise RangeError(
            f"{name}: a pole of the force of {fastest:g} 1/s cannot be met: at {case.rate:g} Hz one of {most:g} 1/s "
            "or more oscillates on any contact; 1 to 20 1/s are usual",
            name=name,
            value=fastest,
            rule=f"< {most:g} 1/s",
        )
    kfp = law.kfp.matrix(6)
    gains: dict[str, Any] = {"kfi": (np.eye(6) + kfp) @ (np.asarray(pole) * np.eye(6))}
    zeta, contact = case.asked.damping, case.asked.contact
    if zeta is not None and contact is None:
        raise UsageError(
            f"kdamp of {case.name} follows from zeta and contact together; add contact, the stiffness of what is "
            "pressed on",
            name="contact",
        )
    if contact is not None:
        _require_held(contact)
        if zeta is None and not law.kdamp is not None:
            raise UsageError(f"kdamp of {case.name} follows from zeta and contact together; add zeta", name="zeta")
    elif law.kdamp is not None:
        raise UsageError(
            f"{case.name} needs contact, the stiffness of what is pressed on, for an error of the force dies away on "
            "something only: contact=(1e4, 100.0)",
            name="contact",
        )
    if zeta is not None:
        spring = (np.eye(6) + kfp) @ six_by_six("contact", contact)
        places = [at_tool(case.law, x) for x in case.at]
        each = [p.outside(damped(p.Lambda, p.inside(spring), zeta)) for p in places]
        gains["kdamp"] = max(each, key=lambda B: float(np.trace(B)))
    elif contact is None:
        raise UsageError(
            f"{case.name} without kdamp has nothing that keeps it from swinging on a contact; add zeta and contact, "
            "the stiffness of what is pressed on: zeta=0.7, contact=(1e4, 100.0)",
            name="contact",
        )
    return _replaced(case.law, **gains)


def _require_held(contact: ArrayLike) -> None:
    """A contact that is stiff in every direction."""
    least = float(np.linalg.eigvalsh(six_by_six("contact", contact))[0])
    if least <= 0.0:
        raise RangeError(
            "contact must be stiff in every direction, > 0 [N/m, N m/rad], for a law of force floats where nothing "
            f"answers it; got {least:g}; a small stiffness will do, contact=(1e4, 1.0)",
            name="contact",
            value=least,
            rule="> 0",
        )


def _hybrid(case: Case) -> Law:
    """Those of the law of motion, and kfi = (1 + kfp) force."""
    law: Any = case.law
    motion = gains_for(case.of(law.motion, asked=dataclasses.replace(case.asked, force=None)))
    if case.asked.force is None:
        return _replaced(case.law, motion=motion)
    kfp = law.kfp.matrix(law.rows) if law.kfp is not None else np.zeros((law.rows, law.rows))
    return _replaced(case.law, motion=motion, kfi=case.asked.force * (np.eye(law.rows) + kfp))


def _via_joints(case: Case) -> Law:
    law: Any = case.law
    return _replaced(case.law, inner=gains_for(case.of(law.inner)))


def _sum(case: Case) -> Law:
    """Of the one part of a sum that has gains to find."""
    parts = case.law.children()
    found = [name for name, part in parts.items() if type(part) in RECIPES]
    if len(found) != 1:
        raise UsageError(
            f"a sum is designed where one of its parts has gains to find; of {' + '.join(parts)} "
            f"{' and '.join(found) or 'none'} has",
            name="law",
        )
    return case.law.with_children({**parts, found[0]: gains_for(case.of(parts[found[0]]))})


COUPLED: Final[tuple[type[Law], ...]] = (laws.PID, laws.GravityPID)
RECIPES: Final[dict[type[Law], Callable[[Case], Law]]] = {
    laws.PID: _torque_gains,
    laws.GravityPID: _torque_gains,
    laws.ComputedTorque: _acceleration_gains,
    laws.GravityCompensation: _floating,
    laws.VelocityPI: _velocity_gains,
    laws.TaskVelocity: _first_order,
    laws.TaskPosition: _first_order,
    laws.TaskComputedTorque: _task_gains,
    laws.Impedance: _impedance,
    laws.Stiffness: _stiffness,
    laws.Admittance: _admittance,
    laws.ForceControl: _force,
    laws.HybridMotionForce: _hybrid,
    laws.ViaJointSpace: _via_joints,
    laws.Sum: _sum,
}
OTHERS: Final = (
    "has no error dynamics that taut.design knows; find its gains with taut.tune, and look at its poles with "
    "taut.linearise"
)
WITHOUT: Final[dict[type[Law], str]] = {
    laws.FeedForward: (
        "has no gains: design the feedback beside it: taut.design(taut.laws.FeedForward() + taut.laws.PID(kp=1.0), "
        "arm, zeta=1.0, omega_n=10.0)"
    ),
    laws.SideBySide: "moves several arms: design the law of each on its own, with arm.subset(joints)",
}
