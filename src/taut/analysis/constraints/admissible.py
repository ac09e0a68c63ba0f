"""Whether a motion and forces may be chosen together against a rigid contact, and why not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.analysis.constraints.contact_modes import FrictionMargin, HeldRows, Mode
from taut.analysis.constraints.freedom_words import axis_words, rubbed
from taut.analysis.constraints.task_axes import TaskBasis
from taut.base.checks import finite_array
from taut.base.errors import UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.force_reference import HybridMotion
from taut.control.trajectories.reference import Sample, Trajectory
from taut.control.trajectories.task_reference import TaskMotion
from taut.linear.linear_words import written

__all__ = ["Admissible", "asked", "judged"]

SMALL: Final = 1e-6  # of the largest number of the motion, or of the forces


@dataclass(frozen=True, kw_only=True)
class Admissible:
    """Whether a motion and forces may be chosen; print it for the reasons.

    Args:
        reasons: Why not, a sentence each; none where they may.
        cones: Of each contact that sticks, how far the forces are inside its friction cone.
    """

    reasons: tuple[str, ...]
    cones: tuple[FrictionMargin, ...]

    @property
    def ok(self) -> bool:
        """Whether they may be chosen."""
        return not self.reasons

    def __str__(self) -> str:
        return "\n".join(self.reasons or ("may be chosen", *map(str, self.cones)))


def asked(
    A: Float64Array,
    motion: TaskMotion | HybridMotion | ArrayLike | None,
    F_app: ArrayLike | None,
    lam: ArrayLike | None,
    *,
    joints: bool,
) -> tuple[Float64Array | None, Float64Array | None]:
    """(m,) V and F_app, whatever they were given as.

    Args:
        A: (k, m) all rows of the constraint.
        motion: A sample, or V.
        F_app: The forces.
        lam: (k,) multipliers in their place.
        joints: Whether V is of joints.

    Raises:
        UsageError: Forces twice, a sample of another kind.
        ShapeError, RangeError: Other sizes, numbers that are not finite.
    """
    k, m = A.shape
    pressed = motion if isinstance(motion, HybridMotion) else None
    inner = motion if pressed is None else pressed.motion
    if isinstance(inner, Sample) and (joints or not isinstance(inner, TaskMotion)):
        wanted = f"{m} joint speeds" if joints else "a motion of the tool, such as taut.TaskMotion(pose=...)"
        raise UsageError(f"check takes {wanted}; got {type(inner).__name__}", name="motion")
    if isinstance(inner, Trajectory):
        raise UsageError("check takes a sample of a motion, such as ref.at(0.0); got a whole motion", name="motion")
    given = {"F_app": F_app is not None, "lam": lam is not None, "taut.pressing(...)": pressed is not None}
    words = [name for name, there in given.items() if there]
    if len(words) > 1:
        raise UsageError(f"check takes forces once; got {' and '.join(words)}", name=words[0])
    V = None
    if inner is not None:
        V = finite_array("motion", inner.twist if isinstance(inner, TaskMotion) else inner, shape=(m,))
    if pressed is not None:
        return V, _of_pressing(A, pressed)
    if lam is not None:
        return V, np.asarray(A.T @ finite_array("lam", lam, shape=(k,), unit="N, N m"))
    return V, None if F_app is None else finite_array("F_app", F_app, shape=(m,), unit="N, N m")


def _of_pressing(A: Float64Array, pressed: HybridMotion) -> Float64Array:
    gradient = float(np.linalg.norm(A[0, :3]))
    press = np.asarray(pressed.press, dtype=np.float64).item()
    if press and gradient < 1e-9:
        raise UsageError(
            "press is a force, and the first row of the constraint holds rotations only; give lam=", name="press"
        )
    lam = np.array(pressed.lam[: len(A)], dtype=np.float64)
    if press:
        lam[0] -= press / gradient
    return np.asarray(np.asarray(pressed.F_app, dtype=np.float64) + A.T @ lam)


def judged(
    names: Sequence[str],
    basis: TaskBasis,
    held: HeldRows,
    mode: Mode,
    friction: float,
    V: Float64Array | None,
    F_app: Float64Array | None,
) -> Admissible:
    """A motion and forces against the rows that hold.

    Raises:
        UsageError: Neither.
    """
    if V is None and F_app is None:
        raise UsageError("check takes a motion, forces, or both; got none", name="motion")
    reasons = [] if V is None else _of_motion(names, basis, held, mode, V)
    cones: tuple[FrictionMargin, ...] = ()
    if F_app is not None:
        lam = np.asarray(np.linalg.lstsq(held.A.T, F_app, rcond=None)[0]) if len(held.A) else np.zeros(0)
        cones = _cones(held, lam, friction) if mode == "stick" else ()
        reasons += _of_forces(names, basis, held, mode, F_app)
        reasons += _of_pulls(held, lam, SMALL * float(np.abs(F_app).max()))
        reasons += [str(cone) for cone in cones if not cone.inside]
    return Admissible(reasons=tuple(reasons), cones=cones)


def _of_motion(names: Sequence[str], basis: TaskBasis, held: HeldRows, mode: Mode, V: Float64Array) -> list[str]:
    motions, forces = axis_words(names, joints=basis.frame is None)
    along = basis.to_task @ V
    least = SMALL * max(float(np.abs(along).max()), float(np.abs(basis.right).max(initial=0.0)))
    rates = held.A @ V + held.phi_t
    leaves = any(rate > least for rate, side in zip(rates, held.one_sided, strict=True) if side)
    slips = mode == "stick" and bool(np.all(np.abs(rates[: len(held.given)]) <= least))
    found = []
    for row, right, axis in zip(basis.solved, basis.right, basis.held, strict=True):
        got = float(row @ along)
        if abs(got - right) <= least:
            continue
        sum_ = written(row, motions)
        way_out = "choose mode='slide'" if slips else f"choose {forces[axis]}"
        if leaves:
            way_out += ", or mode='apart' to leave the surface"
        found.append(
            f"{sum_} = {got:.4g} may not be chosen, for the environment says {sum_} = {right:.6g}; {way_out}"
        )
    for row in held.lifted:
        rate = float(row[:-1] @ V + row[-1])
        if rate < -least:
            found.append(
                f"the motion goes into the surface, d phi / dt = {rate:.4g}, where the tool touches it; move off it, "
                "or choose mode='slide'"
            )
    return found


def _of_forces(names: Sequence[str], basis: TaskBasis, held: HeldRows, mode: Mode, F_app: Float64Array) -> list[str]:
    motions, forces = axis_words(names, joints=basis.frame is None)
    along = basis.from_task.T @ F_app
    least = SMALL * float(np.abs(along).max())
    rubs = rubbed(basis, held.contacts if mode == "slide" else ())
    found = []
    for column, axis, rub in zip(basis.N.T, basis.free, rubs, strict=True):
        got = float(column @ along)
        if abs(got) <= least:
            continue
        sum_ = written(column, forces)
        why = "friction makes it while the contact slides" if rub else f"the environment says {sum_} = 0"
        way_out = f"choose {motions[axis]}, or mode='stick'" if rub else f"choose {motions[axis]}"
        found.append(f"{sum_} = {got:.4g} may not be chosen, for {why}; {way_out}")
    return found


def _of_pulls(held: HeldRows, lam: Float64Array, least: float) -> list[str]:
    return [
        f"the forces pull at a contact, lam[{held.given[i]}] = {lam[i]:.4g}, which can be pressed and not pulled; "
        "turn their sign"
        for i, side in enumerate(held.one_sided)
        if side and lam[i] > least
    ]


def _cones(held: HeldRows, lam: Float64Array, friction: float) -> tuple[FrictionMargin, ...]:
    first = len(held.given)
    return tuple(
        FrictionMargin(
            pressing=float(-lam[contact.row] * contact.size),
            tangential=float(np.linalg.norm(lam[first + 2 * i : first + 2 * i + 2])),
            friction=friction,
        )
        for i, contact in enumerate(held.contacts)
    )
