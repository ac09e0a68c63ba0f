"""Natural constraints of a hybrid law: what is refused where a run starts, and what a motion asks along them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from taut.base.errors import RangeError, UsageError
from taut.base.types import Float64Array, Vector, Vector3, Wrench
from taut.control.laws.task_space import wrench_moved
from taut.control.trajectories.force_reference import HybridMotion, Pressing
from taut.control.trajectories.reference import Hold, Reference, Sample
from taut.control.trajectories.samples import Chunk
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.rows import ConstraintRows
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotation_exp, rotation_log
from taut.trace import math as tm

DEPENDENT: Final = 3e-4  # of the largest singular value, rows of length 1; below it rounding is beyond 1e-9
OUT_OF_RANGE: Final = 0.01  # [-] of a wrench, which a stream may state where the tool is, and not where it should be
REFERENCE_INSTANTS: Final = 64  # at a motion before it is followed


def check_constraint(constraint: Constraint, x: Snapshot) -> None:
    """Rows must be independent, with gradients, and of joints that can move against them. Raises RangeError."""
    rows = constraint.at(x)
    where = f"at the pose of '{x.arm.name}' there"
    sizes = np.linalg.norm(np.asarray(rows.A_q if rows.A is None else rows.A, dtype=np.float64), axis=1)
    for row, size in enumerate(sizes):
        if not np.isfinite(size) or size < 1e-12:
            got = "zero" if np.isfinite(size) else "not a number"
            raise RangeError(
                f"row {row} of the constraint must have a gradient, and it is {got} {where}: write a function that "
                "changes at the rate of a distance or an angle where it is zero, such as norm(d) - r, not its square "
                "at d = 0",
                name="constraint",
                value=float(size),
            )
    values = np.linalg.svd(np.asarray(rows.A_q, dtype=np.float64) / sizes[:, None], compute_uv=False)
    if rows.count > x.n or values[-1] < DEPENDENT * max(1.0, values[0]):
        raise RangeError(
            f"the {rows.count} rows of the constraint must be independent, and {where} they are not, or its joints "
            f"cannot press against each (singular values of A J: {', '.join(f'{value:.3g}' for value in values)}); "
            "leave out what says the same twice, or start from another pose",
            name="constraint",
        )


def check_place(constraint: Constraint, x: Snapshot, tolerance: float) -> None:
    """A run starts on its constraint, within the tolerance. Raises RangeError."""
    phi = np.asarray(constraint.at(x).phi, dtype=np.float64)
    advice = "start from taut.dynamics.onto(constraint, arm, q), or approach first"
    _check_on(phi, constraint.one_sided, tolerance, "q0", "a hybrid run must start on its constraint, and", advice)


def check_reference(constraint: Constraint, x: Snapshot, ref: Reference, tool: str | None, tolerance: float) -> None:
    """A known reference must ask for admissible forces and keep to the constraint, within the tolerance.

    Checked are samples of a chunk, 64 instants of a trajectory.
    """
    of_tool, here = of_one_body(constraint, x, tool), constraint.at(x).A
    for t, sample in known_samples(ref):
        if not isinstance(sample, HybridMotion):
            return
        presses = ref.presses if isinstance(ref, Pressing) else bool(np.any(sample.press))
        _check_force(constraint, sample, presses=presses)
        A, F_app = here, np.asarray(sample.F_app, dtype=np.float64)
        known = not isinstance(ref, Chunk)
        if of_tool and isinstance(sample.motion, TaskMotion):
            assert constraint.frame is not None
            pose, now = sample.motion.pose @ x.T(tool).inverse() @ x.T(*constraint.frame), float(x.t) + t
            A, known = constraint.of_twist(pose, now)[0], True
            subject = f"the motion must keep to the constraint, and at t = {t:g} s"
            phi = constraint.of_pose(pose, now)
            _check_on(phi, constraint.one_sided, tolerance, "ref", subject, "give poses with phi = 0")
        if known and A is not None and np.any(F_app):
            _check_admitted(np.asarray(A, dtype=np.float64), F_app, constraint.one_sided, t)


def _check_force(constraint: Constraint, sample: HybridMotion, *, presses: bool) -> None:
    """What a sample says of forces fits the constraint, wherever the arm is."""
    given, count = int(np.asarray(sample.given)[0]), constraint.count
    if given not in (0, count):
        raise UsageError(f"lam must have one entry for each row of the constraint, {count}; got {given}", name="lam")
    _check_pressed(constraint.one_sided, np.asarray(sample.lam, dtype=np.float64), "lam")
    if constraint.frame is None and np.any(sample.F_app):
        raise UsageError(
            "F_app is for a constraint of the tool; of joints or of several frames give lam=", name="F_app"
        )
    if presses and (constraint.frame is None or constraint.moments[0] or not constraint.surface):
        raise UsageError(
            "press is a force into a surface, and the first row of the constraint is of none; put the surface first, "
            "with one_sided=True, or give lam=",
            name="press",
        )


def _check_on(
    phi: Float64Array, one_sided: Sequence[bool], tolerance: float, name: str, subject: str, advice: str
) -> None:
    """Where an arm is, or is to be, is on the constraint."""
    row = int(np.argmax(np.abs(phi)))
    if abs(phi[row]) > tolerance:
        side = "into" if phi[row] < 0.0 and one_sided[row] else "off"
        raise RangeError(
            f"{subject} it is {abs(phi[row]):.4g} {side} it in row {row}, more than the tolerance of {tolerance:g}; "
            f"{advice}",
            name=name,
            value=float(phi[row]),
            rule=f"<= {tolerance:g}",
        )


def _check_admitted(A: Float64Array, F: Float64Array, one_sided: Sequence[bool], t: float) -> None:
    """A wrench is one that a constraint admits."""
    lam = np.asarray(np.linalg.lstsq(A.T, F, rcond=None)[0], dtype=np.float64)
    admitted = A.T @ lam
    if np.linalg.norm(F - admitted) > OUT_OF_RANGE * np.linalg.norm(F):
        raise RangeError(
            f"F_app must lie in the range of A^T, for the constraint admits nothing else; at t = {t:g} s it admits "
            f"{(np.round(admitted, 3) + 0.0).tolist()} of {np.round(F, 3).tolist()}",
            name="F_app",
        )
    _check_pressed(one_sided, lam, "F_app")


def _check_pressed(one_sided: Sequence[bool], lam: Float64Array, name: str) -> None:
    """No one-sided row is pulled at."""
    for row, side in enumerate(one_sided):
        if side and lam[row] > 0.0:
            raise RangeError(
                f"{name} must press on a contact, lam <= 0 [N], and pulls at row {row} with lam = {lam[row]:.4g}; "
                "change its sign",
                name=name,
                value=float(lam[row]),
                rule="lam <= 0",
            )


def known_samples(ref: Reference) -> Iterator[tuple[float, Sample | None]]:
    """What is known of a reference before it is followed: time [s] and sample."""
    if isinstance(ref, (Hold, Sample)):
        yield 0.0, ref.sample if isinstance(ref, Hold) else ref
        return
    at, length = getattr(ref, "at", None), getattr(ref, "duration", None)
    times = np.zeros(1)
    if isinstance(ref, Chunk):
        times = np.asarray(ref.times)
    elif isinstance(length, (int, float)) and np.isfinite(length):
        times = np.linspace(0.0, float(length), REFERENCE_INSTANTS)
    if at is not None:
        yield from ((float(t), at(float(t))) for t in times)


def of_one_body(constraint: Constraint, x: Snapshot, tool: str | None) -> bool:
    """Whether a constraint is one of a frame that moves as one body with the tool."""
    return constraint.frame is not None and x.model.placement(*constraint.frame)[0] == x.model.placement(tool)[0]


def along_constraint(
    x: Snapshot, rows: ConstraintRows, frame: str | None, ref: TaskMotion, tool: str | None
) -> TaskMotion:
    """The same motion of the tool along the constraint where the tool is: what it asks against the rows is taken out.

    Law:          A e' = 0, A (V_des' - V) = 0, A V_des-dot' + curvature = 0
                  (e', V_des', V_des-dot') the nearest to what was asked, a metre counting as much as a radian
    Closed loop:  V-dot = a, the acceleration of the law of motion: A a is what the constraint asks already, so that P
                    changes nothing in it, whatever Lambda is
                  to first order where rotations are among the rows, and where gains are the same in all directions
                    that a row mixes

    P is orthogonal in the product of Lambda^-1 only: of an acceleration a it leaves a - Lambda^-1 A^T S (A a + ...),
    so that what the reference asks against a surface would move the tool along it and turn it. Of a force P takes A^T
    c out exactly. Errors are those of the constraint's frame, in world axes.
    """
    A, T = rows.A, x.T(frame)
    assert A is not None
    d, factors = _lever(x, frame, tool), rows.factors
    asked = ref if d is None else _at_point(ref, d)

    def against(six: Vector) -> Vector:
        out: Vector = A.T @ factors.solve(A @ six)
        return out

    off = against(tm.array([*(asked.p - T.p), *rotation_log(asked.R @ x.T(tool).R.T)]))
    made = TaskMotion.of(
        {
            "p": asked.p - off[:3],
            "R": rotation_exp(-off[3:]) @ asked.R,
            "twist": asked.twist - against(asked.twist - x.twist(frame)),
            "acceleration": asked.acceleration - A.T @ factors.solve(A @ asked.acceleration + rows.curvature),
        }
    )
    return made if d is None else _at_point(made, -d)


def without_reaction(x: Snapshot, rows: ConstraintRows, frame: str | None) -> Snapshot:
    """The snapshot with F_ext less the constraint's reaction: friction along it, and the push of a hand.

    A law that answers F_ext with an acceleration (`Impedance` with D) would make motion along it of the contact
    force.
    """
    A = rows.A
    assert A is not None
    factors = rows.factors

    def along(F: Wrench) -> Wrench:
        r = x.T().p - x.T(frame).p
        there = wrench_moved(F, r)
        return wrench_moved(there - A.T @ factors.solve(A @ there), -r)

    return x.feeling(along)


def _lever(x: Snapshot, frame: str | None, tool: str | None) -> Vector3 | None:
    """(3,) from the tool to the origin of the frame, in the tool's axes; None where they are one point."""
    _, R, p = x.model.placement(tool)
    d: Vector3 = R.T @ (x.model.placement(frame)[2] - p)
    return d if np.any(d) else None


def _at_point(ref: TaskMotion, d: Vector3) -> TaskMotion:
    """The motion of another point of the same body, d from its origin in its own axes."""
    r, omega, alpha = ref.R @ d, ref.twist[3:], ref.acceleration[3:]
    v = tm.cross(omega, r)
    return TaskMotion.of(
        {
            "p": ref.p + r,
            "R": ref.R,
            "twist": tm.array([*(ref.twist[:3] + v), *omega]),
            "acceleration": tm.array([*(ref.acceleration[:3] + tm.cross(alpha, r) + tm.cross(omega, v)), *alpha]),
        }
    )
