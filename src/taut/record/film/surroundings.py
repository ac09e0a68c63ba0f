"""What stands around an arm, to be seen in films: shapes that rest, move, or go with the tool, as plain values.

A run keeps it in its info, and the poses of what moves in a column, so that a log is filmed as the run was.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from taut.base.types import Float64Array
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = ["POSES", "Around", "Mesh", "Shape", "ShapeKind", "Thing", "pose", "poses_of"]

POSES: Final = "scene.poses"  # column of a run: (m, 7) position [m] and quaternion wxyz of each thing that moves

ShapeKind: TypeAlias = Literal["plane", "box", "sphere", "ellipsoid", "cylinder", "capsule", "mesh"]
Numbers: TypeAlias = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A shape on a thing."""

    kind: ShapeKind
    size: Numbers  # (3,) [m] halves, as MuJoCo has them: of a cylinder radius and half its length
    p: Numbers = (0.0, 0.0, 0.0)  # [m] in the thing
    wxyz: Numbers = (1.0, 0.0, 0.0, 0.0)
    rgba: Numbers = (0.5, 0.5, 0.5, 1.0)
    mesh: int = -1  # number of its mesh


@dataclass(frozen=True, kw_only=True)
class Thing:
    """What has one pose: at rest in the world, on the tool, or moving."""

    shapes: tuple[Shape, ...]
    p: Numbers = (0.0, 0.0, 0.0)  # [m] in the world, where it rests or begins
    wxyz: Numbers = (1.0, 0.0, 0.0, 0.0)
    row: int | None = None  # of the column, where its pose is recorded
    on_tool: bool = False  # at the arm's tool, and in its axes
    times: Numbers = ()  # [s] of a motion that is known beforehand
    shifts: tuple[Numbers, ...] = ()  # (3,) [m] each, in the world: where it is then, from where it begins

    @property
    def moves(self) -> bool:
        """Whether it does by itself."""
        return self.row is not None or bool(self.times)


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """Triangles."""

    vertices: Float64Array  # (m, 3) [m]
    faces: Float64Array  # (f, 3) whole numbers


@dataclass(frozen=True, kw_only=True, eq=False)
class Around:
    """All of it."""

    things: tuple[Thing, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    missing: tuple[str, ...] = ()  # what stands there too and has no shape here, in words

    def __bool__(self) -> bool:
        return bool(self.things or self.missing)


def poses_of(run: Run, found: Around, ticks: np.ndarray[Any, np.dtype[np.intp]]) -> Float64Array:
    """(k, m, 7) position [m] and quaternion wxyz of each thing that moves, in the order of the things."""
    out = []
    for thing in found.things:
        if thing.row is not None:
            out.append(np.asarray(run.extra[POSES])[ticks, thing.row])
        elif thing.times:
            shifts = np.asarray(thing.shifts)
            p = [np.interp(run.t[ticks], thing.times, shifts[:, i]) + thing.p[i] for i in range(3)]
            out.append(np.column_stack([*p, np.tile(thing.wxyz, (len(ticks), 1))]))
    return np.stack(out, axis=1) if out else np.zeros((len(ticks), 0, 7))


def pose(thing: Thing | Shape) -> Pose:
    """Of a thing in the world or on the tool, or of a shape on its thing."""
    return Pose(thing.p, wxyz=thing.wxyz)
