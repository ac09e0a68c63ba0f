"""What stood around an arm in a run, for its films: a scene, or the surfaces that a model plant has."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, Protocol, TypeAlias, runtime_checkable

import numpy as np

from taut.base.types import Array, Float64Array
from taut.loop import AnyPlant
from taut.maths.constraints.constraint import Constraint
from taut.maths.snapshot import Snapshot
from taut.plant.contact import each_contact
from taut.plant.rigid import RigidPlant
from taut.record.film.surroundings import Around, Mesh, Shape, Thing
from taut.record.info import AROUND
from taut.trace.pose import Pose

__all__ = ["around_info"]

Phi: TypeAlias = Callable[[Float64Array, float], float]
"""One row of a constraint, of the position of its frame [m] and the time [s]; the frame does not turn."""

BOARD: Final = (0.2, 0.35, 0.3, 1.0)
HOLLOW: Final = (0.2, 0.35, 0.3, 0.35)  # what the tool is inside of lets it be seen
REACH: Final = 0.25  # [m] of a surface to each side of the tool
THICK: Final = 0.005  # [m] half of what is drawn
STEP: Final = 1e-5  # [m] of differences
CLOSE: Final = 1e-6  # [m] of a plane, a ball, a pipe
CELLS: Final = 14  # along each side of a surface that is none of these
AROUND_IT: Final = 0.05 * np.array(  # [m] places near the tool, none of which is special
    [[1, 0.2, 0.1], [-0.8, 0.5, 0.3], [0.1, 1, -0.2], [0.3, -0.9, 0.4], [-0.2, 0.3, 1], [0.5, 0.1, -0.9], [0, 0, 0]]
)
OFTEN: Final = 0.02  # [s] between two places of a surface that moves


@runtime_checkable
class HasAround(Protocol):
    """A plant that knows what stands around its arm."""

    def around(self) -> Around: ...


def around_info(plant: AnyPlant, q: Float64Array, duration: float) -> dict[str, Any]:
    """The entry of run.info about what stands around the arm, where there is anything.

    Args:
        plant: The plant.
        q: (n,) positions at the start [rad | m].
        duration: [s] of the run.
    """
    found = Around()
    if isinstance(plant, HasAround):
        found = plant.around()
    elif isinstance(plant, RigidPlant):
        found = _of_model(plant, q, duration)
    return {AROUND: found.json()} if found else {}


def _of_model(plant: RigidPlant, q: Float64Array, duration: float) -> Around:
    """The surfaces of contacts and walls."""
    things: list[Thing] = []
    meshes: list[Mesh] = []
    missing: list[str] = []
    x = Snapshot(plant.model, q=q, v=np.zeros(len(q)))
    for contact in () if plant.contact is None else each_contact(plant.contact):
        for piece in contact.constraint.pieces:
            one = Constraint.of([piece])
            if one.frame is None or not (one.count == 1 or one.one_sided[0]):
                missing.append(f"what holds the arm by {one!r}")
                continue
            T = x.T(one.frame[0])
            found = _surface(_first_row(one, T), T.p, duration, meshes)
            if isinstance(found, Thing):
                things.append(found)
            else:
                missing.append(f"what holds the arm by {one!r}, {found}")
    values = {} if plant.environment is None else plant.environment.parameters()
    for point, normal in _walls(values):
        n = normal / np.linalg.norm(normal)
        p = x.T().p
        things.append(_board(p - n * float(n @ (p - point)), n))
    return Around(things=tuple(things), meshes=tuple(meshes), missing=tuple(missing))


def _walls(values: Mapping[str, Float64Array]) -> Iterator[tuple[Float64Array, Float64Array]]:
    """Points and normals of the walls among what touches the tool."""
    for path, normal in values.items():
        place = path.removesuffix("normal") + "point"
        if path.endswith("normal") and place in values:
            yield values[place], normal


def _first_row(one: Constraint, T: Pose) -> Phi:
    return lambda p, t: float(one.of_pose(Pose.of(T.R, p), t)[0])


def _surface(phi: Phi, p: Float64Array, duration: float, meshes: list[Mesh]) -> Thing | str:
    """Where a row is zero, near p: a plane, a ball or a pipe if it is one, else a mesh; why not, in words."""
    places = p + AROUND_IT
    feet, normals = [], []
    for place in places:
        g = _gradient(phi, place)
        size = float(np.linalg.norm(g))
        if size > CLOSE:  # not at the centre of a ball
            feet.append(place - phi(place, 0.0) / size**2 * g)
            normals.append(g / size)
    if len(feet) < len(places) - 1 or not np.isfinite(feet).all():
        return "which is no surface in space"
    f, n = np.array(feet), np.array(normals)
    moves = abs(phi(p, 0.37 * duration) - phi(p, 0.0)) > CLOSE or abs(phi(p, 0.71 * duration) - phi(p, 0.0)) > CLOSE
    if np.ptp(n, axis=0).max() < 1e2 * CLOSE and np.abs((f - f[-1]) @ n[-1]).max() < CLOSE:
        board = _board(f[-1], n[-1])
        return _moving(board, phi, p, n[-1], duration) if moves else board
    if moves:
        return "which moves and is no plane"
    return _round(f, n) or _patch(phi, f[-1], n[-1], meshes)


def _gradient(phi: Phi, p: Float64Array) -> Float64Array:
    steps = STEP * np.eye(3)
    return np.array([(phi(p + step, 0.0) - phi(p - step, 0.0)) / (2.0 * STEP) for step in steps])


def _board(point: Float64Array, normal: Float64Array) -> Thing:
    """A board whose face is at a point."""
    at = point - THICK * normal
    shape = Shape(kind="box", size=(REACH, REACH, THICK), rgba=BOARD)
    return Thing(shapes=(shape,), p=_numbers(at), wxyz=_along(normal))


def _moving(board: Thing, phi: Phi, p: Float64Array, normal: Float64Array, duration: float) -> Thing:
    """The same, as it moves along its normal."""
    times = np.linspace(0.0, duration, max(2, round(duration / OFTEN) + 1))
    slope = _gradient(phi, p) @ normal
    shifts = [_numbers((phi(p, 0.0) - phi(p, float(t))) / slope * normal) for t in times]
    return Thing(shapes=board.shapes, p=board.p, wxyz=board.wxyz, times=_numbers(times), shifts=tuple(shifts))


def _round(feet: Float64Array, normals: Float64Array) -> Thing | None:
    """A ball or a pipe, where all normals go through its centre or its axis."""
    _, sizes, axes = np.linalg.svd(normals)
    flat = sizes[-1] < 1e2 * CLOSE  # normals across an axis
    onto = axes[:2] if flat else np.eye(3)
    f, n = feet @ onto.T, normals @ onto.T
    k, d = f.shape
    system = np.column_stack([np.tile(np.eye(d), (k, 1)), n.reshape(-1)])  # f = centre + radius n
    answer, *_ = np.linalg.lstsq(system, f.reshape(-1), rcond=None)
    radius = float(answer[-1])
    if np.abs(system @ answer - f.reshape(-1)).max() > 1e2 * CLOSE or abs(radius) < CLOSE:
        return None
    rgba = BOARD if radius > 0.0 else HOLLOW
    if not flat:
        ball = Shape(kind="sphere", size=(abs(radius), 0.0, 0.0), rgba=rgba)
        return Thing(shapes=(ball,), p=_numbers(answer[:-1]))
    axis = axes[2]
    centre = answer[:-1] @ onto + axis * float(axis @ feet[-1])
    pipe = Shape(kind="cylinder", size=(abs(radius), REACH, 0.0), rgba=rgba)
    return Thing(shapes=(pipe,), p=_numbers(centre), wxyz=_along(axis))


def _patch(phi: Phi, foot: Float64Array, normal: Float64Array, meshes: list[Mesh]) -> Thing | str:
    """A mesh of what can be seen of the surface along its normal at a foot."""
    R = Pose(wxyz=_along(normal)).R
    side = np.linspace(-REACH, REACH, CELLS + 1)
    points = np.array([_onto(phi, foot + R @ [u, w, 0.0], normal) for u in side for w in side])
    good = np.isfinite(points).all(axis=1)
    corners = [i * (CELLS + 1) + j for i in range(CELLS) for j in range(CELLS)]
    cells = [(a, a + CELLS + 1, a + CELLS + 2, a + 1) for a in corners]
    cells = [cell for cell in cells if good[list(cell)].all()]
    if not cells:
        return "which could not be followed"
    faces = [face for a, b, c, d in cells for face in ((a, b, c), (a, c, d))]
    below = len(points)
    under = [(below + a, below + c, below + b) for a, b, c in faces]
    points = np.where(good[:, np.newaxis], points, foot) - foot
    both = np.vstack([points, points - 2.0 * THICK * normal])
    meshes.append(Mesh(vertices=both, faces=np.array([*faces, *under], dtype=np.int32)))
    shape = Shape(kind="mesh", size=(0.0, 0.0, 0.0), rgba=BOARD, mesh=len(meshes) - 1)
    return Thing(shapes=(shape,), p=_numbers(foot))


def _onto(phi: Phi, p: Float64Array, normal: Float64Array) -> Array:
    """The point above or below p that is on the surface; NaN where there is none near."""
    s = 0.0
    for _ in range(4):
        here = phi(p + s * normal, 0.0)
        slope = (phi(p + (s + STEP) * normal, 0.0) - here) / STEP
        s -= here / slope if abs(slope) > 1e-3 else np.nan
        if not abs(s) < REACH:
            return np.full(3, np.nan)
    return p + s * normal if abs(here) < 1e2 * STEP else np.full(3, np.nan)


def _along(z: Float64Array) -> tuple[float, ...]:
    """Quaternion wxyz of axes whose z looks along a unit vector."""
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return _numbers(Pose.of(np.column_stack([x, np.cross(z, x), z]), np.zeros(3)).wxyz)


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(float(x) for x in values)
