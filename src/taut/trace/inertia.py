"""An inertia as six numbers, in the one order that files, payloads and messages have: xx, yy, zz, xy, xz, yz."""

from __future__ import annotations

from typing import Any

from taut.base.types import Array, Matrix
from taut.trace import math as tm

__all__ = ["inertia_entries", "inertia_matrix"]


def inertia_matrix(six: Any) -> Matrix:
    """(3, 3) from (6,), floats or symbols.

    Example:
        >>> inertia_matrix([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]).tolist()
        [[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]]
    """
    xx, yy, zz, xy, xz, yz = six
    return tm.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertia_entries(I: Matrix) -> Array:
    """(6,) from a symmetric (3, 3).

    Example:
        >>> inertia_entries(inertia_matrix([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])).tolist()
        [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    """
    return tm.array([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]])
