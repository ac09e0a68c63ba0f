"""A hybrid design in contact: how an error of the force dies away against each row of what the tool touches."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from taut.analysis.design.asked import BAND
from taut.analysis.design.disturbed import disturbed
from taut.analysis.design.limits import KEPT, DesignLimit
from taut.analysis.design.trial import Numbers, numbers_of_poles
from taut.arm.description import Arm
from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.control.sensing.sensing import Sensing
from taut.controller import compile
from taut.laws import HybridMotionForce
from taut.linear.loop_map import loop_map, starting
from taut.loop import Loop
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.projection import onto
from taut.maths.snapshot import snapshot
from taut.plant.contact import RigidContact
from taut.plant.disturbance import TORQUE
from taut.plant.drives.actuation import Actuation
from taut.plant.rigid import RigidPlant
from taut.record.step import step_response

__all__ = ["Pressed", "force_gains", "force_limits", "pressed", "require_force_stable"]

LONGER: Final = 2.5  # times the settling time that was designed for
SHORTEST, LONGEST = 50, 40_000  # ticks
UNKNOWN: Final = 1e-2  # [N | N m] of a force that nobody told the law of
ENDED: Final = 1e-9  # of a pole in z: a delay that ends by itself
HELD: Final = 1e-9  # of the first error: below it an error is rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class Pressed:
    """The force against one row of a constraint: how an error of it dies away.

    Args:
        direction: Whether it is a force or a moment, and the number of the row.
        unit: N or N m.
        designed: By the gains, in continuous time: the pole -kfi / (1 + kfp).
        predicted: Of the sampled loop on a rigid contact, where the measured force is a tick old.
        simulated: In the nonlinear sampled loop, held by the constraint, after a force that the law does not know.
    """

    direction: str
    unit: str
    designed: Numbers
    predicted: Numbers
    simulated: Numbers


def pressed(
    law: HybridMotionForce,
    arm: Arm,
    q: Float64Array,
    *,
    rate: float,
    delay: float,
    sensing: Sensing,
    friction: Literal["arm"] | None,
) -> tuple[Float64Array, tuple[Pressed, ...]]:
    """Where it was tried, the pose nearest to q on the constraint, and each row.

    Law:          lam_e of a force step that the law does not know: (1 + kfp) lam_e + kfi int(lam_e) = const, from
                  const / (1 + kfp) with the pole -kfi / (1 + kfp)

    The constraint is held both ways here, so that no press is needed to keep it.

    Raises:
        RangeError: No pose near q keeps to the constraint within the limits of the joints, or it is singular there.
    """
    held = both_ways(law.constraint)
    law = dataclasses.replace(law, constraint=held)
    at = _on(held, arm, q)
    ctrl = compile(law, arm, rate=rate, sensing=sensing)
    plant = RigidPlant(
        arm, friction=friction, actuation=Actuation(delay=delay), contact=RigidContact(constraint=held)
    )
    kfp, kfi = force_gains(law)
    late = round(delay * rate)
    books = [float(kfi[i, i] / (1.0 + kfp[i, i])) for i in range(law.rows)]
    rows = [i for i, pole in enumerate(books) if pole > 0.0]
    ticks = int(np.clip(LONGER * math.log(BAND) / min(books[i] for i in rows) * rate, SHORTEST, LONGEST))
    errors = _simulated(Loop(ctrl, plant, duration=ticks / rate), at, held, ticks)
    found, order = [], late + 1 + bool(np.any(kfp))
    for i in rows:
        pole, moment = books[i], held.moments[i]
        ideal = _predicted(kfp, kfi, rate, late, i, ticks)
        scale = 1.0 + kfp[i, i]
        found.append(
            Pressed(
                direction=f"{'moment' if moment else 'force'} of row {i}",
                unit="N m" if moment else "N",
                designed=Numbers(zeta=1.0, omega_n=pole, overshoot=0.0, settling=math.log(BAND) / pole),
                predicted=_numbers(ideal * scale, rate, order),
                simulated=_numbers(errors[i] * scale, rate, order),
            )
        )
    return at, tuple(found)


def _on(held: Constraint, arm: Arm, q: Float64Array) -> Float64Array:
    """(n,) the pose nearest to q on the constraint.

    Raises:
        RangeError: There is none, or it is outside of the limits of the joints.
    """
    at = onto(held, arm, q)
    outside = np.flatnonzero((at < arm.lower) | (at > arm.upper))
    if outside.size:
        i = int(outside[0])
        raise RangeError(
            f"the pose on the constraint that is nearest to q = {np.round(q, 4).tolist()} has {at[i]:.4g} for "
            f"'{arm.joint_names[i]}', which goes from {arm.lower[i]:g} to {arm.upper[i]:g} {arm.units[i]}; give at= "
            "a pose on the constraint or near it",
            name="at",
            joint=arm.joint_names[i],
            value=float(at[i]),
            rule="within the limits",
        )
    return at


def require_force_stable(law: HybridMotionForce, rate: float, delay: float) -> None:
    """The force loop must be stable on a rigid contact, where what is measured is a tick old.

    Raises:
        RangeError: It is not.
    """
    kfp, kfi = force_gains(law)
    late, force = round(delay * rate), float(np.max(np.diag(kfi) / (1.0 + np.diag(kfp))))
    radius = _radius(kfp, kfi, rate, late)
    if radius < 1.0:
        return
    where = f"{rate:g} Hz" + (f" and {1e3 * delay:g} ms of delay" if delay else "")
    alone = _radius(kfp, 0.0 * kfi, rate, late) >= 1.0
    way_out = "and so it does with kfp alone, which must be below 1; lower kfp"
    raise RangeError(
        f"force = {force:g} cannot be met: at {where} an error of the force grows by the factor {radius:.4g} in a "
        "tick on a rigid contact, where the measured force is a tick old"
        f"{f', {way_out}' if alone else '; ask for a slower force, or a higher rate'}",
        name="force",
        value=radius,
        rule="stable",
    )


def force_limits(forces: tuple[Pressed, ...], rate: float) -> Iterator[DesignLimit]:
    """Of a hybrid law: what the servo rate makes of the pole of the force on a rigid contact."""
    if not forces:
        return
    worst = max(forces, key=lambda each: abs(each.predicted.omega_n / each.designed.omega_n - 1.0))
    book, seen = worst.designed.omega_n, worst.predicted.omega_n
    ok = abs(seen / book - 1.0) < KEPT and worst.predicted.zeta > 1.0 - KEPT
    how = "" if worst.predicted.zeta > 1.0 - KEPT else f", and swings with zeta = {worst.predicted.zeta:.3g},"
    yield DesignLimit(
        name="force pole", value=seen, limit=book, unit="1/s", ok=ok,
        sentence=(
            f"at {rate:g} Hz an error of the {worst.direction} dies away with {seen:.4g} 1/s{how} on a rigid "
            f"contact, {book:.4g} 1/s in continuous time"
        ),
    )  # fmt: skip


def both_ways(constraint: Constraint) -> Constraint:
    """The same constraint, held both ways."""
    return Constraint.of(
        [
            dataclasses.replace(piece, one_sided=(False,) * piece.count)  # type: ignore[type-var]
            if any(piece.one_sided)
            else piece
            for piece in constraint.pieces
        ]
    )


def force_gains(law: HybridMotionForce) -> tuple[Float64Array, Float64Array]:
    """(k, k) kfp and kfi, zero where a law has none."""
    k = law.rows
    given: list[Any] = [
        getattr(law, name).matrix(k) if getattr(law, name) is not None else np.zeros((k, k))
        for name in ("kfp", "kfi")
    ]
    return np.asarray(given[0], dtype=np.float64), np.asarray(given[1], dtype=np.float64)


# -------------------------------------------------------------------- the law from tick to tick


def _matrix(kfp: Float64Array, kfi: Float64Array, rate: float, late: int) -> Float64Array:
    """From one tick to the next: the force of a tick ago, the integral, and what is under way.

    Law:  e_k = -lam_(k-1),  s_k = s_(k-1) + e_k / rate,  u_k = kfp e_k + kfi s_k,  lam_k = u_(k-late)
    """
    k = len(kfp)
    eye, none = np.eye(k), np.zeros((k, k))
    u = np.hstack([-(kfp + kfi / rate), kfi])
    rows = [np.hstack([-eye / rate, eye] + [none] * late)]
    if not late:
        return np.vstack([u, *rows])
    line = [np.hstack([none, none] + [eye if i == j else none for i in range(late)]) for j in range(late)]
    return np.vstack([line[-1], *rows, np.hstack([u] + [none] * late), *line[:-1]])


def _radius(kfp: Float64Array, kfi: Float64Array, rate: float, late: int) -> float:
    A = _matrix(kfp, kfi, rate, late)
    if not np.any(kfi):  # an integral that acts on nothing stays
        keep = np.r_[0 : len(kfp), 2 * len(kfp) : len(A)]
        A = A[np.ix_(keep, keep)]
    return float(np.abs(np.linalg.eigvals(A)).max())


def _predicted(kfp: Float64Array, kfi: Float64Array, rate: float, late: int, row: int, ticks: int) -> Float64Array:
    """(ticks,) the force that is too much against a row, from the tick on in which one of 1 comes, unknown."""
    A = _matrix(kfp, kfi, rate, late)
    state, out = np.zeros(len(A)), np.zeros(ticks)
    for tick in range(ticks):
        state = A @ state
        state[row] += 1.0  # the unknown, which stays
        out[tick] = state[row]
    return out


def _numbers(e: Float64Array, rate: float, order: int) -> Numbers:
    """What fits an error that begins at 1, but for the first ticks."""
    t = np.arange(len(e)) / rate
    zeta, omega_n = numbers_of_poles(_slow(_poles(e, order), rate))
    step = step_response(t, np.concatenate([[1.0], e[1:]]))
    return Numbers(zeta=zeta, omega_n=omega_n, overshoot=step.overshoot, settling=step.settling_time)


def _poles(e: Float64Array, order: int) -> NDArray[np.complex128]:
    """In z, by linear prediction of as many terms as the loop has states."""
    live = int(np.flatnonzero(np.abs(e) > HELD * np.abs(e).max())[-1]) + 1
    rows = np.lib.stride_tricks.sliding_window_view(e[: max(live, 2 * order + 1)], order + 1)
    rows = rows / np.abs(rows).max(axis=1, keepdims=True)
    tail = np.linalg.lstsq(rows[:, :order], -rows[:, order], rcond=1e-13)[0]
    return np.asarray(np.roots(np.concatenate([[1.0], tail[::-1]])), dtype=np.complex128)


def _slow(z: NDArray[np.complex128], rate: float) -> NDArray[np.complex128]:
    """[1/s] the slowest pole, and its partner if it swings."""
    s = np.log(z[np.abs(z) > ENDED]) * rate
    slowest = s[np.argmax(s.real)]
    return np.array([slowest] if slowest.imag == 0.0 else [slowest, slowest.conjugate()])


# -------------------------------------------------------------------- the loop itself


def _simulated(loop: Loop, q: Float64Array, held: Constraint, ticks: int) -> Float64Array:
    """(k, ticks) the same of runs of the loop: what a force that the law does not know adds to each multiplier."""
    A_q = np.asarray(held.at(snapshot(loop.plant.arm, q)).A_q, dtype=np.float64)
    start = starting(loop, loop_map(loop), q)
    without, *seen = (record["contact.lam"] for record in disturbed(loop, start, TORQUE, UNKNOWN * A_q, ticks))
    return np.array([(lam - without)[:, i] / UNKNOWN for i, lam in enumerate(seen)])
