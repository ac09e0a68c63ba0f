"""The directions in which a law's error dynamics stand each by itself at a pose, and what they are in each."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.linalg import eigh

from taut import laws
from taut.analysis.design.coupled import Coupled
from taut.analysis.design.place import AtTool, at_tool
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.linear.error_dynamics import ErrorDynamics
from taut.linear.joint_gains import JointGains
from taut.maths.snapshot import Snapshot, snapshot

__all__ = ["Direction", "designed_part", "directions_of", "fed_forward", "numbered", "weight_gradient"]

FREE: Final = 1e-9  # of the largest stiffness over inertia: a motion that no spring draws back
ALIKE: Final = 1e-9  # of stiffnesses over inertias
NUDGE: Final = 1e-4  # [rad | m] of a difference of gravity torques
ROUNDED: Final = 1e-9  # of the largest gravity torque: a smaller gradient is rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class Direction:
    """One of them.

    Args:
        name: The joint, the direction of the tool, or the mode.
        unit: Of its coordinate, rad or m.
        row: (n,) how far a motion of the joints goes along it.
        column: (n,) the motion of the joints that goes along it by 1, and along no other one.
        dynamics: Its error dynamics in continuous time, by the gains and the inertia there.
        axis: Number of the joint or of the axis of the tool that it moves most.
        per_unit: What a motion by 1 makes of `unit`: the stiffness of a contact, where that is a force.
        step: (n,) the step of a reference of joints that ends in `column`, where it is another one: under weight that
            the law does not compensate.
        coupled: Those of all joints, where friction or unlike gains couple them so that this direction has none by
            itself; `dynamics` is then what a motion along it alone would have.
    """

    name: str
    unit: str
    row: Float64Array
    column: Float64Array
    dynamics: ErrorDynamics
    axis: int
    per_unit: float = 1.0
    step: Float64Array | None = None
    coupled: Coupled | None = None

    @property
    def settling(self) -> float:
        """[s] within which it settles in continuous time."""
        alone = self.dynamics.settling_time
        return alone if self.coupled is None else max(alone, self.coupled.longest)

    def error(self, dt: float, steps: int) -> Float64Array:
        """(steps + 1,) of a step of 1 in continuous time."""
        if self.coupled is None:
            return self.dynamics.response(np.linspace(0.0, steps * dt, steps + 1))[0]
        return np.asarray(self.coupled.response(self.column, dt, steps)[0] @ self.row)


def designed_part(law: Law) -> Law:
    """The law in a law whose gains are designed."""
    if isinstance(law, laws.ViaJointSpace):
        return designed_part(law.inner)
    if isinstance(law, laws.HybridMotionForce):
        return designed_part(law.motion)
    if isinstance(law, laws.Sum):
        return next(part for part in law.children().values() if type(part) in DIRECTIONS)
    return law


def directions_of(law: Law, x: Snapshot, b: Float64Array, G: Float64Array | None = None) -> tuple[Direction, ...]:
    """Those of a law about the equilibrium of a snapshot; none of laws of force, and of those without a stiffness.

    Args:
        law: The law.
        x: The arm at rest.
        b: (n,) the friction that counts.
        G: (n, n) the weight's gradient dg/dq where it adds to kp, as the law does not compensate it there.
    """
    part: Any = designed_part(law)
    kp = _matrix(part.kp, x.n) if G is not None else np.eye(x.n)
    if G is not None and np.linalg.eigvalsh(kp + G)[0] > 0.0:  # else it falls over, and is refused for it
        part = dataclasses.replace(part, kp=kp + G)
    found = DIRECTIONS[type(part)](part, x, b)
    if G is not None and not fed_forward(law) and not np.any(part.ki.as_array()):
        ends = np.asarray(np.linalg.solve(kp, kp + G), dtype=np.float64)
        found = tuple(dataclasses.replace(d, step=np.asarray(ends @ d.column)) for d in found)
    whole = COUPLED[type(part)](part, x, b) if found and type(part) in COUPLED else None
    if whole is None:
        return found
    return tuple(d if whole.apart(d.column) else dataclasses.replace(d, coupled=whole) for d in found)


def fed_forward(law: Law) -> bool:
    """Whether the weight is compensated where the reference is, so that its gradient draws at an error."""
    beside = isinstance(law, laws.Sum) and any(isinstance(part, laws.FeedForward) for part in law.children().values())
    return beside and isinstance(designed_part(law), laws.PID)


def weight_gradient(x: Snapshot) -> Float64Array:
    """(n, n) dg/dq [N m/rad], which adds to kp where the weight is not compensated at the joints' own position."""
    q, columns = np.asarray(x.q), []
    for nudge in NUDGE * np.eye(x.n):
        up, down = (np.asarray(snapshot(x.arm, at).g) for at in (q + nudge, q - nudge))
        columns.append((up - down) / (2.0 * NUDGE))
    G = np.column_stack(columns)
    G[np.abs(G) < ROUNDED * max(float(np.abs(x.g).max()), 1e-300)] = 0.0
    return np.asarray(0.5 * (G + G.T))


def _second(M: float, kp: float, kd: float, ki: float, b: float = 0.0) -> ErrorDynamics:
    return ErrorDynamics.of_gains(JointGains(M=M, b=b, kp=kp, kd=kd, ki=ki))


def numbered(name: str, found: list[Direction]) -> str:
    """A name that none of those found has: "x", "x (2)"."""
    same = sum(each.name == name or each.name.startswith(f"{name} (") for each in found)
    return f"{name} ({same + 1})" if same else name


def _matrix(gain: Any, n: int) -> Float64Array:
    return np.asarray(gain.matrix(n), dtype=np.float64)


def _joints(x: Snapshot, dynamics: Callable[[int], ErrorDynamics]) -> tuple[Direction, ...]:
    eye = np.eye(x.n)
    return tuple(
        Direction(name=name, unit=x.arm.units[i], row=eye[i], column=eye[i], dynamics=dynamics(i), axis=i)
        for i, name in enumerate(x.arm.joint_names)
    )


def _of_accelerations(law: Any, x: Snapshot, b: Float64Array) -> tuple[Direction, ...]:
    kp, kd, ki = (np.diag(_matrix(gain, x.n)) for gain in (law.kp, law.kd, law.ki))
    M = np.diag(np.asarray(x.M))
    return _joints(x, lambda i: _second(1.0, kp[i], kd[i], ki[i], float(b[i] / M[i])))


def _of_torques(law: Any, x: Snapshot, b: Float64Array) -> tuple[Direction, ...]:
    """The modes of kp and M, which joints share; the joints where all modes are alike."""
    M = np.asarray(x.M)
    kp, kd, ki = (_matrix(gain, x.n) for gain in (law.kp, law.kd, law.ki))
    squares, modes = eigh(kp, M)  # modes^T M modes = 1
    if squares[-1] - squares[0] <= ALIKE * squares[-1]:
        w, damping = float(squares[0]), eigh(kd + np.diag(b), M, eigvals_only=True)
        if damping[-1] - damping[0] <= ALIKE * max(damping[-1], 1e-300):
            integral = float(eigh(ki, M, eigvals_only=True)[-1])
            return _joints(x, lambda _: _second(1.0, w, float(damping[0]), integral))
    found: list[Direction] = []
    for square, mode in zip(squares, modes.T, strict=True):
        shares = np.abs(mode * (M @ mode))
        i = int(np.argmax(shares))
        kd_, ki_, b_ = (float(mode @ C @ mode) for C in (kd, ki, np.diag(b)))
        scaled = mode / mode[i]
        found.append(
            Direction(
                name=x.arm.joint_names[i] if x.n == 1 else numbered(f"mode of {x.arm.joint_names[i]}", found),
                unit=x.arm.units[i],
                row=M @ mode * mode[i],
                column=scaled,
                dynamics=_second(1.0, float(square), kd_, ki_, b_),
                axis=i,
            )
        )
    return tuple(found)


def _of_velocities(law: Any, x: Snapshot, b: Float64Array) -> tuple[Direction, ...]:  # noqa: ARG001
    kp, ki = (np.diag(_matrix(gain, x.n)) for gain in (law.kp, law.ki))

    def dynamics(i: int) -> ErrorDynamics:
        tail = [ki[i]] if ki[i] else []
        return ErrorDynamics(coefficients=[1.0, kp[i], *tail], integral=bool(tail))

    return _joints(x, dynamics)


def _of_tool_velocities(law: Any, x: Snapshot, b: Float64Array) -> tuple[Direction, ...]:  # noqa: ARG001
    place = at_tool(law, x)
    kp = place.inside(_matrix(law.kp, len(place.U)))
    return _at_tool(place, np.eye(len(kp)), lambda k: ErrorDynamics(coefficients=[1.0, float(kp[k, k])]))


def _of_task(law: Any, x: Snapshot, b: Float64Array) -> tuple[Direction, ...]:
    place = at_tool(law, x)
    kp, kd, ki = (place.inside(_matrix(gain, len(place.U))) for gain in (law.kp, law.kd, law.ki))
    rubbed = np.linalg.solve(np.asarray(x.M), np.diag(b)) @ place.back
    ways = eigh(kp)[1]
    kp, kd, ki, own = (np.diag(ways.T @ C @ ways) for C in (kp, kd, ki, place.rows @ rubbed))
    return _at_tool(place, ways, lambda k: _second(1.0, kp[k], kd[k], ki[k], max(float(own[k]), 0.0)))


def _at_tool(
    place: AtTool, ways: Float64Array, dynamics: Callable[[int], ErrorDynamics], inertia: Float64Array | None = None
) -> tuple[Direction, ...]:
    """Motions (r,) of the tool in the columns of `ways`; modes of an inertia, or orthogonal ones."""
    back = place.back
    across = ways if inertia is None else inertia @ ways  # across^T ways = 1
    found: list[Direction] = []
    for k, way in enumerate(ways.T):
        i = int(np.argmax(np.abs(place.U @ way)))
        scale = float((place.U @ way)[i])
        linear = len(place.names) != 6 or i < 3
        found.append(
            Direction(
                name=numbered(place.names[i], found),
                unit="m" if linear else "rad",
                row=place.rows.T @ across[:, k] * scale,
                column=back @ way / scale,
                dynamics=dynamics(k),
                axis=i,
            )
        )
    return tuple(found)


def _of_felt(law: Any, x: Snapshot, b: Float64Array) -> tuple[Direction, ...]:
    """The modes of what the tool feels like: D, or the arm's own inertia, and K."""
    place, size = at_tool(law, x), len(_spread(law))
    K = place.inside(law.K.matrix(size))
    D = place.inside(law.D.matrix(size)) if law.D is not None else place.Lambda
    squares, modes = eigh(K, D)
    held = squares > FREE * max(float(squares[-1]), 1e-300)
    ways, squares = modes[:, held], squares[held]
    if law.zeta is not None:
        damping = 2.0 * float(law.zeta.as_array()) * np.sqrt(squares)
    else:
        B = place.inside(law.B.matrix(size))
        damping = np.diag(ways.T @ B @ ways)
    own = np.zeros((len(squares), len(squares)))
    if not law.D is not None:
        rubbed = place.back.T @ np.diag(b) @ place.back
        own = ways.T @ rubbed @ ways
    return _at_tool(
        place, ways, lambda k: _second(1.0, float(squares[k]), float(damping[k]), 0.0, float(own[k, k])), D
    )


def _spread(law: Any) -> range:
    return range(getattr(law, "dimensions", 6))


def _of_spring(law: Any, x: Snapshot, b: Float64Array) -> tuple[Direction, ...]:
    """The modes of J^T K J and M, of joints that a spring at the tool draws back."""
    place, M = at_tool(law, x), np.asarray(x.M)
    J, kd = place.J, _matrix(law.kd, x.n)
    squares, modes = eigh(J.T @ law.K.matrix(law.dimensions) @ J, M)
    found: list[Direction] = []
    for square, mode in zip(squares, modes.T, strict=True):
        if square <= FREE * squares[-1]:
            continue
        moved = J @ mode
        i = int(np.argmax(np.abs(moved)))
        found.append(
            Direction(
                name=numbered(place.names[i], found),
                unit="m" if len(place.names) != 6 or i < 3 else "rad",
                row=M @ mode * float(moved[i]),
                column=mode / float(moved[i]),
                dynamics=_second(1.0, float(square), float(mode @ kd @ mode), 0.0, float(mode @ np.diag(b) @ mode)),
                axis=i,
            )
        )
    return tuple(found)


def _none(law: Any, x: Snapshot, b: Float64Array) -> tuple[Direction, ...]:  # noqa: ARG001
    return ()


# -------------------------------------------------------------------- all joints together


def _with_torques(law: Any, x: Snapshot, b: Float64Array) -> Coupled:
    kp, kd, ki = (_matrix(gain, x.n) for gain in (law.kp, law.kd, law.ki))
    return Coupled(M=np.asarray(x.M), C=kd + np.diag(b), K=kp, Ki=ki)


def _with_accelerations(law: Any, x: Snapshot, b: Float64Array) -> Coupled:
    M = np.asarray(x.M)
    kp, kd, ki = (M @ _matrix(gain, x.n) for gain in (law.kp, law.kd, law.ki))
    return Coupled(M=M, C=kd + np.diag(b), K=kp, Ki=ki)


def _with_task(law: Any, x: Snapshot, b: Float64Array) -> Coupled:
    place = at_tool(law, x)
    of_tool = [place.Lambda @ place.inside(_matrix(gain, len(place.U))) for gain in (law.kp, law.kd, law.ki)]
    kp, kd, ki = (place.rows.T @ C @ place.rows for C in of_tool)
    return Coupled(M=np.asarray(x.M), C=kd + np.diag(b), K=kp, Ki=ki)


def _with_felt(law: Any, x: Snapshot, b: Float64Array) -> Coupled:
    """K and B at the tool; over D, what they make of its acceleration."""
    place, size = at_tool(law, x), len(_spread(law))
    K = place.inside(law.K.matrix(size))
    D = place.inside(law.D.matrix(size)) if law.D is not None else place.Lambda
    if law.zeta is not None:
        squares, modes = eigh(K, D)
        across = D @ modes
        B = across @ np.diag(2.0 * float(law.zeta.as_array()) * np.sqrt(np.maximum(squares, 0.0))) @ across.T
    else:
        B = place.inside(law.B.matrix(size))
    share = place.Lambda @ np.linalg.inv(D)
    K, B = (place.rows.T @ share @ C @ place.rows for C in (K, B))
    return Coupled(M=np.asarray(x.M), C=B + np.diag(b), K=K, Ki=np.zeros((x.n, x.n)))


def _with_spring(law: Any, x: Snapshot, b: Float64Array) -> Coupled:
    J = at_tool(law, x).J
    K = J.T @ np.asarray(law.K.matrix(law.dimensions)) @ J
    return Coupled(M=np.asarray(x.M), C=_matrix(law.kd, x.n) + np.diag(b), K=K, Ki=np.zeros((x.n, x.n)))


DIRECTIONS: Final[dict[type[Law], Callable[[Any, Snapshot, Float64Array], tuple[Direction, ...]]]] = {
    laws.PID: _of_torques,
    laws.GravityPID: _of_torques,
    laws.ComputedTorque: _of_accelerations,
    laws.GravityCompensation: _none,
    laws.VelocityPI: _of_velocities,
    laws.TaskVelocity: _of_tool_velocities,
    laws.TaskPosition: _of_tool_velocities,
    laws.TaskComputedTorque: _of_task,
    laws.Impedance: _of_felt,
    laws.Stiffness: _of_spring,
    laws.Admittance: _of_felt,
    laws.ForceControl: _none,
}
COUPLED: Final[dict[type[Law], Callable[[Any, Snapshot, Float64Array], Coupled]]] = {
    laws.PID: _with_torques,
    laws.GravityPID: _with_torques,
    laws.ComputedTorque: _with_accelerations,
    laws.TaskComputedTorque: _with_task,
    laws.Impedance: _with_felt,
    laws.Stiffness: _with_spring,
}
