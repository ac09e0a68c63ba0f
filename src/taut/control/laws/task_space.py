"""Task space of a law: the error of a pose, the axes of the gains, the spring and its bound, targets out of reach.

`TaskSpace.of(law)` has the arguments `tool`, `error`, `coordinates`, `frame` and `error_max` of a law in one value.
Everything is in the axes of the gains, or, with another error than "decoupled", in the coordinates of that error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from taut.base.errors import MatchError, RangeError, count_of
from taut.base.fields import Choice, Part
from taut.base.types import Array, Float64Array, Matrix, Vector, Vector3, Wrench
from taut.control.closed_loop import ClosedLoop, PlacedGains
from taut.control.command import Terms
from taut.control.gains import Gain, GainValue
from taut.control.law import Law
from taut.control.laws.task_error import ERRORS, Coordinates, ErrorKind, GainFrame, TaskError, task_error
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.singularity import TOP_SPEED, Asked, Beyond, distance_beyond, spheres
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotated
from taut.maths.task_inertia import TaskInertia
from taut.trace import math as tm
from taut.trace.linalg import LTDL, times_square_root

if TYPE_CHECKING:
    from taut.control.tasks.task import Task

EASED: Final = (0.05, 0.3)  # of the reach, and [rad]: largest error that counts, out of reach
RATE: Final = 5.0  # [1/s] at which joints settle under a spring to a target out of reach
HEAVY: Final = 10.0  # times the arm's mass: largest apparent mass in any direction of the tool
LOST: Final = 1e-9  # of the largest singular value: below it the arm cannot move in a direction


def task_gain(default: Any = ..., *, unit: str, accepts: Iterable[str] = ("pair", "matrix"), **more: Any) -> Gain:
    """A gain on the error of a task: (linear, angular), one for each direction, or a matrix."""
    given = {} if default is ... else {"default": default}
    return Gain(**given, unit=unit, shape=more.pop("shape", "dimensions"), accepts=accepts, **more)


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskSpace:
    """Frame, error, axes and bound of a law of the tool."""

    tool: str | None = None
    error: ErrorKind = "decoupled"
    frame: GainFrame = "world"
    coordinates: Coordinates | None = None
    error_max: GainValue | None = None

    @classmethod
    def of(cls, law: Any) -> Self:
        """That of a law with these arguments; what it does not have is left as it is."""
        own = vars(law)
        return cls(**{name: own[name] for name in cls.__dataclass_fields__ if name in own})

    def at(self, x: Snapshot, ref: TaskMotion | None = None) -> TaskError:
        """The error X, its rate V, and J in the coordinates of the error; of an arm that is to rest without `ref`."""
        ref = TaskMotion.at_rest(x, self.tool) if ref is None else ref
        return task_error(x, ref, self.tool, kind=self.error, coordinates=self.coordinates, frame=self.frame)

    @property
    def bound(self) -> Bound | None:
        """Bound of the spring, if there is one."""
        return None if self.error_max is None else Bound.of(self.error_max)

    def spring(self, K: GainValue, error: TaskError) -> Terms:
        """The force of the spring in the axes of the gains, and what its bound takes of it."""
        whole = Terms(P=K @ error.X)
        return whole if self.bound is None else whole + Terms(bound=self.bound.force(K, error.X) - K @ error.X)

    def energy(self, K: GainValue, error: TaskError) -> Any:
        """Energy of the spring [J]."""
        X = error.X if self.bound is None else self.bound.stretch(error.X)
        return 0.5 * (X @ (K @ X))

    def measured_wrench(self, x: Snapshot, inertia: TaskInertia) -> Wrench:
        """(k,) F_ext in the coordinates of the error, by the exact adjoint."""
        F, T = wrench_at(x, self.tool), x.T(self.tool)
        if self.error == "body":
            return rotated(T.R.T, F)
        if self.error == "space":
            return wrench_moved(F, T.p)
        if self.error == "coordinates":
            out: Array = inertia.wrench(x.J(self.tool).T @ F)
            return out
        return F

    @property
    def asked(self) -> Asked | None:
        """The part of the pose that the error determines: all of it, its position, or None where that is unknown."""
        if self.coordinates is None:
            return "pose"
        return "position" if self.coordinates == Coordinates.position() else None

    def beyond_reach(self, x: Snapshot, ref: TaskMotion) -> Beyond | None:
        """How clearly a target is out of reach; None where the error does not determine it."""
        found = None if self.asked is None else spheres(x.model, self.tool, self.asked)
        return Beyond.of(found, ref.p, ref.R) if found else None


class TaskLaw(Law, abstract=True):
    """Base of laws that follow a motion of the tool with an error of task space: what these have in common."""

    reference = TaskMotion
    error: Choice[ErrorKind] = Choice(*ERRORS)
    coordinates: Part[Coordinates | None] = Part(Coordinates, optional=True)
    error_max: Gain = Gain(unit="m, rad", shape=2, accepts=("pair",), above=0.0, optional=True)
    tool: str | None = None

    def check(self) -> None:
        if (self.error == "coordinates") != (self.coordinates is not None):
            self.refuse("coordinates", "is for error 'coordinates', which needs it; give both or neither")
        if self.space.frame != "world" and self.error != "decoupled":
            self.refuse("frame", f"is for error 'decoupled'; '{self.error}' has axes of its own; leave frame out")
        if self.error_max is not None and self.error == "coordinates":
            self.refuse("error_max", "bounds the errors of a pose, and 'coordinates' has others; leave it out")

    @property
    def space(self) -> TaskSpace:
        """Frame, error, axes and bound in one value."""
        return TaskSpace.of(self)

    @property
    def dimensions(self) -> int:
        """Entries of the error: 6, or those of the coordinates."""
        coordinates: Coordinates | None = self.__dict__["coordinates"]
        return 6 if coordinates is None else coordinates.size


def modal_damping(inertia: LTDL, K: Matrix, zeta: Any, V: Vector) -> Vector:
    """(k,) B V, damping ratio zeta in each mode: B = 2 zeta U (U^-1 K U^-T)^(1/2) U^T for inertia = U U^T.

    Source: Albu-Schaffer, Ott and Hirzinger (2003), IEEE ICRA, double diagonalisation.
    """
    U, scale = inertia.root(), np.sqrt(inertia.weights())
    inside = np.outer(scale, scale) * inertia.half(inertia.half(K).T)
    out: Vector = 2.0 * zeta * (U @ times_square_root(inside, U.T @ V))
    return out


def wrench_at(x: Snapshot, tool: str | None) -> Wrench:
    """(6,) the measured wrench at the origin of a frame of the link that carries the sensor, world axes [N, N m]."""
    F = x.F_ext
    if tool is None or tool == x.arm.tool:
        return F
    return wrench_moved(F, x.T().p - x.T(tool).p)


def wrench_moved(F: Wrench, r: Vector3) -> Wrench:
    """(6,) the same wrench at another point, from which r leads to where it stands, in its axes."""
    return tm.array([*F[:3], *(F[3:] + tm.cross(r, F[:3]))])


def check_sensor(x: Snapshot, tool: str | None) -> None:
    """A wrist sensor measures wrenches on the link of the arm's tool, and on no other. Raises MatchError."""
    if x.model.placement(tool)[0] != x.model.placement(None)[0]:
        raise MatchError(
            f"the wrist sensor of '{x.arm.name}' is at its tool '{x.arm.tool}', and '{tool}' is on another link, of "
            "which it knows nothing; control a frame of the tool's link, or load the arm with that tool",
            name="tool",
        )


def bounded_inertia(x: Snapshot, J: Matrix) -> TaskInertia:
    """The arm's inertia at the tool, bounded where a direction is nearly lost."""
    return TaskInertia.bounded(J, x.M_factors, HEAVY * sum(body.mass for body in x.arm.bodies))


@dataclass(frozen=True, kw_only=True, eq=False)
class Bound:
    """Bounds of the linear and angular error; curves are 1 / error_max^2 [1/m^2, 1/rad^2], 0 for no bound."""

    curves: tuple[Any, Any]

    @classmethod
    def of(cls, error_max: GainValue) -> Self:
        """That of error_max=(linear, angular) [m, rad]."""
        return cls(curves=(1.0 / (error_max[0] * error_max[0]), 1.0 / (error_max[1] * error_max[1])))

    def error(self, X: Vector) -> Vector:
        """(k,) part by part X / sqrt(1 + r^2), which is shorter than error_max."""
        return _by_parts(X, [1.0 / root for root in self._roots(X)])

    def stretch(self, X: Vector) -> Vector:
        """(k,) Y, with the energy Y . K Y / 2 of the bounded spring: part by part X sqrt(2 / (1 + root))."""
        return _by_parts(X, [tm.sqrt(2.0 / (1.0 + root)) for root in self._roots(X)])

    def force(self, K: GainValue | Matrix, X: Vector) -> Wrench:
        """(k,) the gradient of that energy; with one stiffness for all directions of a part it is K error(X)."""
        whole, out = K @ self.stretch(X), []
        for places, root, bound in zip(_places(X), self._roots(X), self.curves, strict=False):
            part, own = X[places], whole[places]
            bend = 0.5 * bound / ((1.0 + root) * root)
            out.extend(tm.sqrt(2.0 / (1.0 + root)) * (own - bend * (part @ own) * part))
        return tm.array(out)

    def _roots(self, X: Vector) -> list[Any]:
        return [
            tm.sqrt(1.0 + (X[places] @ X[places]) * bound)
            for places, bound in zip(_places(X), self.curves, strict=False)
        ]


def _places(X: Vector) -> list[slice]:
    """The linear and the angular part; of three numbers the linear one alone."""
    return [slice(0, 3), slice(3, 6)][: len(X) // 3]


def _by_parts(X: Vector, shares: list[Any]) -> Vector:
    return tm.array([entry for places, share in zip(_places(X), shares, strict=True) for entry in share * X[places]])


def eased(away: Beyond, share: Any, X: Vector) -> Any:
    """Factor <= 1 of a spring to a target out of reach: 1 / sqrt(1 + r^2), r = |X| / EASED; 1 if share is 0."""
    length = (X[:3] @ X[:3]) * (1.0 / (EASED[0] * away.reach) ** 2)
    turn = (X[3:] @ X[3:]) * (1.0 / EASED[1] ** 2) if len(X) == 6 else 0.0
    return 1.0 / tm.sqrt(1.0 + share * (length + turn))


def within_speed(x: Snapshot, inertia: TaskInertia, F: Wrench) -> Wrench:
    """(k,) F, reduced until tau = J^T F - RATE M v + h settles at joint speeds M^-1 J^T F / RATE within limits."""
    most: Any = 1.0
    for speed, top in zip(inertia.joint_acceleration(F), x.arm.velocity, strict=True):
        if np.isfinite(top):
            most = tm.maximum(most, tm.abs(speed) * (1.0 / (TOP_SPEED * RATE * top)))
    out: Wrench = F / most
    return out


def far_away(law: Law | Task, x: Snapshot, rows: dict[str, Float64Array]) -> Float64Array | None:
    """(k,) lower bounds of the distance of a run's targets from reach [m]; None where the law follows no pose."""
    asked = _asked(law) if law.reference is TaskMotion and isinstance(law, Law) else None
    if asked is None:
        return None
    return distance_beyond(spheres(x.model, law.controlled_frame, asked), rows["p"], rows["R"])


def _asked(law: Law) -> Asked | None:
    """The part of the pose that a law, or the law that it holds, follows."""
    if "directions" in law.declared:
        return "pose" if vars(law)["directions"] == "all" else "position"
    if isinstance(law, TaskLaw):
        return law.space.asked
    inner = [each for each in law.children().values() if each.reference is TaskMotion and not each.ignores_reference]
    return _asked(inner[0]) if inner else "pose"


def check_damping(law: Law, K: GainValue, B: GainValue | None, zeta: GainValue | None, D: GainValue | None) -> None:
    """Exactly one of B and zeta; zeta needs a stiffness to oscillate on; D is divided by. Raises TautError."""
    if (B is None) == (zeta is None):
        law.refuse("zeta", "designs B from K and the inertia; give exactly one of B and zeta")
    if zeta is not None and smallest(K) <= 0.0:
        law.refuse("zeta", "needs a K with stiffness in every direction; give B instead", RangeError)
    if D is not None and smallest(D) <= 0.0:
        law.refuse("D", f"must be > 0 [kg, kg m^2] in every direction; got {smallest(D):.4g}", RangeError)


def smallest(gain: GainValue) -> float:
    """The smallest entry, or eigenvalue, of a gain."""
    values = np.asarray(gain.as_array(), dtype=np.float64)
    return float(np.linalg.eigvalsh(values)[0]) if values.ndim == 2 else float(values.min())


def check_directions(x: Snapshot, tool: str | None, J: Matrix) -> None:
    """An arm may lack one direction of its tool, besides those of a planar arm. Raises MatchError."""
    rows = [i for i in range(len(J)) if np.any(J[i] != 0.0)]
    sizes = np.linalg.svd(np.asarray(J, dtype=np.float64)[rows], compute_uv=False)
    body = x.model.placement(tool)[0]
    moving = len(x.arm.ancestors(body)) if body >= 0 else 0
    lost = len(rows) - min(len(rows), moving)
    if lost > 1 and len(rows) - int(np.sum(sizes > LOST * sizes[0])) > 1:
        name = tool or x.arm.tool
        raise MatchError(
            f"frame '{name}' of '{x.arm.name}' is moved by {count_of(moving, 'joint')}, and is asked for "
            f"{len(rows)} directions; control another frame, or what it can do: error='coordinates', "
            "coordinates=taut.Coordinates.position()",
            name="tool",
        )


AXES: Final = ("x", "y", "z", "about x", "about y", "about z")
UNITS: Final = ("m", "m", "m", "rad", "rad", "rad")


def tool_loop(law: Law, x: Snapshot, gains: Callable[[PlacedGains], Law], **options: Any) -> ClosedLoop:
    """Closed loop of a law with a `tool`, in the axes of its gains; `options` are fields of `ClosedLoop`."""
    error = TaskSpace.of(law).at(x)
    J = np.asarray(error.inwards(error.J), dtype=np.float64)
    six = len(J) == len(AXES)
    names, units = (AXES, UNITS) if six else (tuple(f"y{i}" for i in range(len(J))), ("m",) * len(J))
    return ClosedLoop(x=x, J=J, names=names, units=units, gains=gains, **options)
