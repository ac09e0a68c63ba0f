"""Layout: where each named number stands. One layout for the call path, exported C, shared memory and tensors.

A block is a C struct of doubles: fields in order, arrays row by row, no padding.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any

import numpy as np

from taut.base.types import Float64Array

__all__ = ["Block", "Field"]


@dataclass(frozen=True)
class Field:
    """One named array in a block."""

    path: str
    shape: tuple[int, ...]
    offset: int

    @property
    def size(self) -> int:
        """Number of doubles."""
        return prod(self.shape)


@dataclass(frozen=True)
class Block:
    """Named arrays, one behind the other."""

    fields: tuple[Field, ...] = ()

    @classmethod
    def of(cls, shapes: Mapping[str, tuple[int, ...]]) -> Block:
        """A block with these fields, in this order."""
        fields, offset = [], 0
        for path, shape in shapes.items():
            field = Field(path, tuple(shape), offset)
            fields.append(field)
            offset += field.size
        return cls(tuple(fields))

    @cached_property
    def size(self) -> int:
        """Number of doubles."""
        return sum(field.size for field in self.fields)

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each field, by path."""
        return {field.path: field.shape for field in self.fields}

    def zeros(self) -> Float64Array:
        """Room for the block, with zeros."""
        return np.zeros(self.size)

    def views(self, flat: Float64Array) -> dict[str, Float64Array]:
        """Each field as an array that shares memory with `flat`, whose last axis is the block's."""
        lead = flat.shape[:-1]
        return {
            field.path: flat[..., field.offset : field.offset + field.size].reshape((*lead, *field.shape))
            for field in self.fields
        }

    def pack(self, values: Mapping[str, Any], out: Float64Array | None = None) -> Float64Array:
        """Values by path as one flat array."""
        flat = self.zeros() if out is None else out
        for field in self.fields:
            flat[field.offset : field.offset + field.size] = np.ravel(values[field.path])
        return flat

    def field(self, path: str) -> Field:
        """The field of that path."""
        return next(field for field in self.fields if field.path == path)
