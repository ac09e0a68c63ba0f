"""Natural constraints of a hybrid law: what is refused where a run starts, and what a motion asks along them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from taut.maths.constraints.rows import ConstraintRows, OfVelocity
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotation_exp, rotation_log
from taut.trace import math as tm

__all__ = [
    "along_constraint",
    "check_constraint",
    "check_forces",
    "check_motion",
    "check_place",
    "check_surface",
    "felt_along",
    "of_one_body",
]

DEPENDENT: Final = 3e-4  # of the largest singular value, rows of length 1; below it rounding is beyond 1e-9
OUT_OF_RANGE: Final = 0.01  # [-] of a wrench, which a stream may state where the tool is, and not where it should be
ELSEWHEN: Final = 0.1234567  # [s]
MIN_SHOWN_PART: Final = 1e-5  # of the wrench, in words
REFERENCE_INSTANTS: Final = 64  # at a motion before it is followed


def check_constraint(constraint: Constraint, x: Snapshot) -> None:
    """Its rows must be independent, and of joints that can move against them.

    Raises:
        RangeError: A gradient of zero or of NaN, rows that depend on each other.
    """
    rows = constraint.at(x)
    A = np.asarray(rows.A if rows.A is not None else rows.A_q, dtype=np.float64)
    where = f"at the pose of '{x.arm.name}' there"
    sizes = np.linalg.norm(A, axis=1)
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
    if len(A) > 1:
        values = np.linalg.svd(A / sizes[:, None], compute_uv=False)
        if len(A) > A.shape[1] or values[-1] < DEPENDENT * values[0]:
            raise RangeError(
                f"the {len(A)} rows of the constraint must be independent, and {where} they are not (singular values "
                f"{', '.join(f'{value:.3g}' for value in values)}); leave out what says the same twice",
                name="constraint",
            )
    A_q = np.asarray(rows.A_q, dtype=np.float64) / sizes[:, None]
    values = np.linalg.svd(A_q, compute_uv=False)
    if len(A_q) > x.n or values[-1] < DEPENDENT * max(1.0, values[0]):
        raise RangeError(
            f"the joints of '{x.arm.name}' cannot press against each row of the constraint {where}: A J has the "
            f"singular values {', '.join(f'{value:.3g}' for value in values)}; start from another pose",
            name="constraint",
        )


def check_surface(constraint: Constraint, x: Snapshot, tool: str | None) -> None:
    """What is to be estimated is the normal of a surface, at the frame that the motion is of.

    Raises:
        UsageError: The first row holds rotations only, or is of another frame.
    """
    (frame,) = constraint.frame or (None,)
    own, moved = (x.arm.tool if name is None else name for name in (frame, tool))
    if own != moved:
        raise UsageError(
            f"estimate needs motion and constraint to be of one frame, and these are of '{moved}' and '{own}'",
            name="estimate",
        )
    A = constraint.at(x).A
    if A is None or np.linalg.norm(np.asarray(A, dtype=np.float64)[0, :3]) < 1e-9 or _of_velocities(constraint):
        what = "is one of velocities" if _of_velocities(constraint) else "holds rotations only"
        raise UsageError(
            f"estimate is of a surface's normal, and the first row of the constraint {what}; put the surface first, "
            "or leave it out",
            name="estimate",
        )


def check_place(constraint: Constraint, x: Snapshot, tolerance: float) -> None:
    """A run starts on its constraint.

    Raises:
        RangeError: It is farther away than the tolerance.
    """
    phi = np.asarray(constraint.at(x).phi, dtype=np.float64)
    row = int(np.argmax(np.abs(phi)))
    if abs(phi[row]) > tolerance:
        which = "the constraint" if len(phi) == 1 else f"row {row} of the constraint"
        raise RangeError(
            f"a hybrid run must start on its constraint, and {which} has phi = {phi[row]:.4g} there, more than the "
            f"tolerance of {tolerance:g}; start from taut.dynamics.onto(constraint, arm, q), or approach first",
            name="q0",
            value=float(phi[row]),
            rule=f"<= {tolerance:g}",
        )


def check_forces(constraint: Constraint, x: Snapshot, ref: Reference, *, later: bool = False) -> None:
    """The forces of a reference are admissible.

    Args:
        constraint: The constraint.
        x: Where the reference is followed from.
        ref: The reference.
        later: Whether that is somewhere else than at x: then what depends on the place is not looked at.

    Raises:
        UsageError: press where there is no surface; more or fewer multipliers than rows.
        RangeError: A wrench outside the range of A^T, a pull at a contact.
    """
    for sample in ref.samples if isinstance(ref, Chunk) else [_first(ref)]:
        if isinstance(sample, HybridMotion):
            presses = ref.presses if isinstance(ref, Pressing) else bool(np.any(sample.press))
            _check_force(constraint, x, sample, presses, later=later or isinstance(ref, Chunk))


def _check_force(constraint: Constraint, x: Snapshot, sample: HybridMotion, presses: bool, *, later: bool) -> None:
    rows = constraint.at(x)
    lam = np.asarray(sample.lam, dtype=np.float64)
    given = int(np.asarray(sample.given)[0])
    if given not in (0, rows.count):
        raise UsageError(
            f"lam has {given} {'entry' if given == 1 else 'entries'}, and the constraint has {rows.count} "
            f"{'row' if rows.count == 1 else 'rows'}; give one for each row",
            name="lam",
        )
    _check_pressed(
        rows.one_sided,
        lam,
        "lam",
        lambda row: (
            f"lam[{row}] must be <= 0 [N], for the contact can be pressed and not pulled; got {lam[row]:g}; "
            "pressing is lam < 0, or press="
        ),
    )
    F = np.asarray(sample.F_app, dtype=np.float64)
    if rows.A is None:
        if presses or np.any(F):
            raise UsageError(
                f"{'press' if presses else 'F_app'} is for a constraint of the tool; of joints or of several frames "
                "give lam=, one for each row",
                name="press" if presses else "F_app",
            )
        return
    A = np.asarray(rows.A, dtype=np.float64)
    what = "holds rotations only" if constraint.surface else "holds both ways"
    if presses and (np.linalg.norm(A[0, :3]) < 1e-9 or not constraint.surface):
        raise UsageError(
            f"press is a force into a surface, and the first row of the constraint {what}; put the surface first, "
            "with one_sided=True, or give lam=",
            name="press",
        )
    if not later:
        _check_range(A, F, rows.one_sided)


def _of_velocities(constraint: Constraint) -> bool:
    return isinstance(constraint.pieces[0], OfVelocity)


def _check_range(A: Float64Array, F: Float64Array, one_sided: Sequence[bool], when: str = "") -> None:
    size = float(np.linalg.norm(F))
    if not size:
        return
    lam = np.asarray(np.linalg.lstsq(A.T, F, rcond=None)[0], dtype=np.float64)
    rest = F - A.T @ lam
    if np.linalg.norm(rest) > OUT_OF_RANGE * size:
        raise RangeError(
            f"F_app must lie in the range of A^T, for the constraint admits nothing else; of {_shown(F, size)} it "
            f"admits {_shown(F - rest, size)}{when}, and not {_shown(rest, size)}",
            name="F_app",
        )
    _check_pressed(
        one_sided,
        lam,
        "F_app",
        lambda row: (
            f"F_app must press on a contact, and {_shown(F, size)} pulls at row {row}{when}, lam = {lam[row]:.4g}; "
            "turn its sign"
        ),
    )


def _check_pressed(one_sided: Sequence[bool], lam: Float64Array, name: str, sentence: Callable[[int], str]) -> None:
    """No one-sided row is pulled at."""
    for row, side in enumerate(one_sided):
        if side and lam[row] > 0.0:
            raise RangeError(sentence(row), name=name, value=float(lam[row]), rule="lam <= 0")


def _shown(F: Float64Array, size: float) -> str:
    """A wrench without what is nothing beside its size."""
    some = np.where(np.abs(F) > MIN_SHOWN_PART * size, F, 0.0)
    return f"[{', '.join(f'{x:.4g}' for x in some)}]"


def check_motion(
    constraint: Constraint, x: Snapshot, ref: Reference, tool: str | None, tolerance: float, *, later: bool = False
) -> None:
    """A motion that is known before it is followed keeps to the constraint, which admits F_app all along.

    It is a motion of the link that is constrained: of a chunk its samples are looked at, of a trajectory 64 instants.
    Against a row of velocities, such as that of a wheel, its distance matters: the integral of A V.

    Args:
        constraint: The constraint.
        x: Where and when it is followed from.
        ref: The motion.
        tool: The frame that moves; None for the arm's tool.
        tolerance: Largest phi [m, rad].
        later: Whether it is followed from a later time on that is not known: then not against what moves by itself.

    Raises:
        RangeError: It leaves the constraint, or goes into it; or F_app leaves the range of A^T.
    """
    if not of_one_body(constraint, x, tool):
        return
    assert constraint.frame is not None
    beyond = x.T(tool).inverse() @ x.T(*constraint.frame)
    velocities = np.array([isinstance(piece, OfVelocity) for piece in constraint.pieces for _ in range(piece.count)])
    times, slipped, last = _times(ref), np.zeros(constraint.count), (0.0, np.zeros(constraint.count))
    for t in times:
        sample = _at(ref, t)
        if not isinstance(sample, HybridMotion) or not isinstance(sample.motion, TaskMotion):
            return
        pose, now = sample.motion.pose @ beyond, float(x.t) + t
        phi = constraint.of_pose(pose, now)
        if later and np.any(phi != constraint.of_pose(pose, now + ELSEWHEN)):
            return
        row = int(np.argmax(np.abs(phi)))
        if abs(phi[row]) > tolerance:
            which = "" if len(phi) == 1 else f" in row {row}"
            way = "into" if phi[row] < 0.0 and constraint.one_sided[row] else "off"
            raise RangeError(
                f"the motion must keep to the constraint, and at t = {t:g} s it is {abs(phi[row]):.4g} {way} it"
                f"{which}, more than the tolerance of {tolerance:g}; give poses with phi = 0",
                name="ref",
                value=float(phi[row]),
                rule=f"<= {tolerance:g}",
            )
        A, F_app = constraint.of_twist(pose, now)[0], np.asarray(sample.F_app, dtype=np.float64)
        if np.any(F_app):
            _check_range(A, F_app, constraint.one_sided, f" at t = {t:g} s")
        speed = np.where(velocities, A @ _moved_to(sample.motion, pose.p), 0.0)
        slipped = slipped + (0.5 * (t - last[0]) * (speed + last[1]) if t > 0.0 else 0.0)
        last = t, speed
        slip, when = (slipped, f"until t = {t:g} s") if len(times) > 1 else (speed, "in 1 s")
        _check_slip(slip, when, tolerance)


def _check_slip(way: Float64Array, when: str, tolerance: float) -> None:
    """A motion goes not far against rows of velocities: that of a trajectory, or in a second of what is held."""
    row = int(np.argmax(np.abs(way)))
    if abs(way[row]) > tolerance:
        raise RangeError(
            f"the motion must keep to the constraint, and {when} it goes {abs(way[row]):.4g} against row {row}, "
            f"which is one of velocities, more than the tolerance of {tolerance:g}; give twists with A V = 0, as "
            "along a blade",
            name="ref",
            value=float(way[row]),
            rule=f"<= {tolerance:g}",
        )


def _moved_to(motion: TaskMotion, p: Float64Array) -> Float64Array:
    """(6,) its twist at another point of the same body."""
    twist = np.asarray(motion.twist, dtype=np.float64)
    return np.concatenate([twist[:3] + np.cross(twist[3:], p - motion.p), twist[3:]])


def _times(ref: Reference) -> list[float]:
    """When to look at a motion before it is followed [s]; never where it has no known end."""
    if isinstance(ref, Chunk):
        return [float(t) for t in ref.times]
    if isinstance(ref, (Hold, Sample)):
        return [0.0]
    length = getattr(ref, "duration", None)
    if not isinstance(length, (int, float)) or not np.isfinite(length):
        return []
    return [float(t) for t in np.linspace(0.0, float(length), REFERENCE_INSTANTS)]


def _first(ref: Reference) -> Sample | None:
    if isinstance(ref, Hold):
        return ref.sample
    if isinstance(ref, Sample):
        return ref
    return ref.at(0.0) if isinstance(ref, (Chunk, Pressing)) or hasattr(ref, "at") else None


def _at(ref: Reference, t: float) -> Sample | None:
    if isinstance(ref, (Hold, Sample)):
        return _first(ref)
    at = getattr(ref, "at", None)
    return None if at is None else at(t)


def of_one_body(constraint: Constraint, x: Snapshot, tool: str | None) -> bool:
    """Whether a constraint is one of a frame that moves as one body with the tool."""
    return constraint.frame is not None and x.model.placement(*constraint.frame)[0] == x.model.placement(tool)[0]


def along_constraint(
    x: Snapshot, rows: ConstraintRows, frame: str | None, ref: TaskMotion, tool: str | None
) -> TaskMotion:
    """The same motion through where the tool is: what it asks for against the rows is taken out, and no more.

    Law:          A e' = 0, A (V_des' - V) = 0, A V_des-dot' + curvature = 0
                  (e', V_des', V_des-dot') the nearest to what was asked, a metre counting as much as a radian
    Closed loop:  V-dot = a, the acceleration that the law of motion asks for: A a is what the constraint asks
                    already, so that P changes nothing in it, whatever Lambda is
                  to first order where rotations are among the rows, and where gains are the same in all directions
                    that a row mixes

    P is orthogonal in the product of Lambda^-1 only. Of an acceleration a it leaves a - Lambda^-1 A^T S (A a + ...):
    what the reference asks against a surface, such as when it is on the stated one and the tool on the true one,
    would move the tool along it and turn it. Of a force, such as the spring of an Impedance, P takes A^T c out
    exactly; there it is a stiffness whose axes are not those of the surface that would.

    Frames:
        Errors are those of the frame that the constraint is of, in world axes.

    Args:
        x: The arm.
        rows: The constraint there, with A.
        frame: The frame that it is of.
        ref: Of the tool.
        tool: A frame of the same body.
    """
    A, T = rows.A, x.T(frame)
    assert A is not None
    d, asked = _lever(x, frame, tool), at_frame(x, frame, ref, tool)
    factors = rows.factors

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


def at_frame(x: Snapshot, frame: str | None, ref: TaskMotion, tool: str | None) -> TaskMotion:
    """What a motion of the tool asks of the origin of another frame of the same body; R stays that of the tool."""
    d = _lever(x, frame, tool)
    return ref if d is None else _at_point(ref, d)


def felt_along(x: Snapshot, rows: ConstraintRows, frame: str | None) -> Snapshot:
    """The same snapshot, whose F_ext is without the constraint's reaction: friction along it, and a hand that pushes.

    A law that answers F_ext with an acceleration, such as an `Impedance` with an inertia D, would answer the force of
    the contact as well, and P would make of that a motion along the contact.

    Args:
        x: The arm, whose tool is on the link of the frame.
        rows: The constraint there, with A.
        frame: The frame that it is of.
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
