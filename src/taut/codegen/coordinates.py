"""Coordinates of a block: small changes of its numbers, with names; a rotation has three."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from taut.base.types import Float64Array
from taut.codegen.layout import Block
from taut.maths.spatial import rotation_exp
from taut.trace import math as tm

__all__ = ["BlockCoordinates", "small_turns"]

ROTATION: Final = "R"  # the last name in the path of a rotation
TURNS: Final = np.stack([np.asarray(tm.skew(e), dtype=np.float64) for e in np.eye(3)])  # about the axes


class BlockCoordinates:
    """Small changes of the numbers of a block: one for each entry, three for each rotation.

    A field named R with shape (3, 3) is a rotation; it changes by a small rotation vector in world axes.

    Args:
        block: The block.
        only: The fields to change; all if left out.
    """

    def __init__(self, block: Block, only: Iterable[str] | None = None) -> None:
        kept = None if only is None else set(only)
        self.block = block
        self.fields = [field for field in block.fields if kept is None or field.path in kept]
        self.places: dict[str, slice] = {}
        names: list[str] = []
        for field in self.fields:
            first = len(names)
            if _is_rotation(field.path, field.shape):
                names += [f"{field.path.rpartition('.')[0]}.rotation[{k}]".lstrip(".") for k in range(3)]
            elif field.shape == ():
                names.append(field.path)
            else:
                names += [f"{field.path}[{','.join(map(str, i))}]" for i in np.ndindex(field.shape)]
            self.places[field.path] = slice(first, len(names))
        self.names = tuple(names)

    def __len__(self) -> int:
        return len(self.names)

    def basis(self, at: Float64Array) -> Float64Array:
        """(k, size) what of the block each coordinate changes, and how fast."""
        out = np.zeros((len(self), self.block.size))
        for field in self.fields:
            rows, columns = self.places[field.path], slice(field.offset, field.offset + field.size)
            if _is_rotation(field.path, field.shape):
                R = at[columns].reshape(3, 3)
                out[rows, columns] = (TURNS @ R).reshape(3, 9)
            else:
                out[rows, columns] = np.eye(field.size)
        return out

    def read(self, at: Float64Array, ways: Float64Array) -> Float64Array:
        """(m, k) how fast the coordinates change, of m changes (m, size) of the block at a place."""
        out = np.zeros((len(ways), len(self)))
        for field in self.fields:
            rows, columns = self.places[field.path], slice(field.offset, field.offset + field.size)
            if _is_rotation(field.path, field.shape):
                out[:, rows] = small_turns(ways[:, columns].reshape(-1, 3, 3) @ at[columns].reshape(3, 3).T)
            else:
                out[:, rows] = ways[:, columns]
        return out

    def moved(self, at: Float64Array, by: Float64Array) -> Float64Array:
        """The block after a change that need not be small."""
        out = at + by @ self.basis(at)
        for field in self.fields:
            if _is_rotation(field.path, field.shape):
                columns = slice(field.offset, field.offset + field.size)
                turn = np.asarray(rotation_exp(by[self.places[field.path]]), dtype=np.float64)
                out[columns] = (turn @ at[columns].reshape(3, 3)).ravel()
        return out

    def difference(self, after: Float64Array, before: Float64Array) -> Float64Array:
        """What leads from one place to another: exact for numbers, to first order for rotations."""
        return np.asarray(self.read(before, (after - before)[np.newaxis])[0])


def small_turns(W: Float64Array) -> Float64Array:
    """(m, 3) the rotation vectors in the skew parts of matrices (m, 3, 3)."""
    entries = [W[:, 2, 1] - W[:, 1, 2], W[:, 0, 2] - W[:, 2, 0], W[:, 1, 0] - W[:, 0, 1]]
    return 0.5 * np.stack(entries, axis=1)


def _is_rotation(path: str, shape: tuple[int, ...]) -> bool:
    return shape == (3, 3) and path.rpartition(".")[2] == ROTATION
