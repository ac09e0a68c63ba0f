"""What stood around an arm in a run, for its films: a scene, or the surfaces that a model plant has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from taut.base.types import Float64Array
from taut.loop import AnyPlant
from taut.maths.constraints.functions import Surface
from taut.maths.constraints.rows import OfPoses
from taut.maths.snapshot import Snapshot
from taut.plant.contact import each_contact
from taut.plant.rigid import RigidPlant
from taut.record.film.surroundings import Around, Shape, Thing
from taut.trace.pose import Pose

__all__ = ["around_info"]

BOARD: Final = (0.2, 0.35, 0.3, 1.0)
HOLLOW: Final = (0.2, 0.35, 0.3, 0.35)  # what the tool is inside of lets it be seen
REACH: Final = 0.25  # [m] of a surface to each side of the tool
THICKNESS: Final = 0.005  # [m] half of what is drawn
PERIOD: Final = 0.02  # [s] between two places of a surface that moves


@runtime_checkable
class HasAround(Protocol):
    """A plant that knows what stands around its arm."""

    def around(self) -> Around: ...


def around_info(plant: AnyPlant, q: Float64Array, duration: float) -> Around:
    """What stands around the arm.

    Args:
        plant: The plant.
        q: (n,) positions at the start [rad | m].
        duration: [s] of the run.
    """
    if isinstance(plant, HasAround):
        return plant.around()
    return _of_model(plant, q, duration) if isinstance(plant, RigidPlant) else Around()


def _of_model(plant: RigidPlant, q: Float64Array, duration: float) -> Around:
    """The surfaces that contacts and walls declare."""
    things: list[Thing] = []
    missing: list[str] = []
    x = Snapshot(plant.model, q=q, v=np.zeros(len(q)))
    for contact in () if plant.contact is None else each_contact(plant.contact):
        for piece in contact.constraint.pieces:
            if isinstance(piece, OfPoses) and piece.surface is not None:
                things.append(_thing(piece.surface, x.T(piece.frames[0]).p, duration))
            else:
                missing.append(f"a constraint of {piece.count} rows that declares no surface")
    values = {} if plant.environment is None else plant.environment.parameters()
    for point, normal in _walls(values):
        wall = Surface(kind="plane", point=point, axis=normal / np.linalg.norm(normal))
        things.append(_thing(wall, x.T().p, duration))
    return Around(things=tuple(things), missing=tuple(missing))


def _walls(values: Mapping[str, Float64Array]) -> Iterator[tuple[Float64Array, Float64Array]]:
    """Points and normals of the walls among what touches the tool."""
    for path, normal in values.items():
        place = path.removesuffix("normal") + "point"
        if path.endswith("normal") and place in values:
            yield values[place], normal


def _thing(surface: Surface, p: Float64Array, duration: float) -> Thing:
    """A surface as it is drawn near a point p."""
    n, rgba = surface.axis, HOLLOW if surface.inside else BOARD
    if surface.kind == "sphere":
        ball = Shape(kind="sphere", size=(surface.radius, 0.0, 0.0), rgba=rgba)
        return Thing(shapes=(ball,), p=_numbers(surface.point))
    along = float(n @ (p - surface.point))
    if surface.kind == "cylinder":
        pipe = Shape(kind="cylinder", size=(surface.radius, REACH, 0.0), rgba=rgba)
        return Thing(shapes=(pipe,), p=_numbers(surface.point + along * n), wxyz=_along(n))
    board = Shape(kind="box", size=(REACH, REACH, THICKNESS), rgba=rgba)
    times: tuple[float, ...] = ()
    shifts: tuple[tuple[float, ...], ...] = ()
    if surface.displacement is not None:
        times = _numbers(np.linspace(0.0, duration, max(2, round(duration / PERIOD) + 1)))
        shifts = tuple(_numbers(surface.displacement(t) * n) for t in times)
    at = p - (along + THICKNESS) * n  # the board's face is the plane
    return Thing(shapes=(board,), p=_numbers(at), wxyz=_along(n), times=times, shifts=shifts)


def _along(z: Float64Array) -> tuple[float, ...]:
    """Quaternion wxyz of axes whose z looks along a unit vector."""
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return _numbers(Pose.of(np.column_stack([x, np.cross(z, x), z]), np.zeros(3)).wxyz)


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(float(x) for x in values)
