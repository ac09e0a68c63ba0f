"""Shapes and array types, named once."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike as ArrayLike
from numpy.typing import NDArray

Float64Array: TypeAlias = NDArray[np.float64]
Array: TypeAlias = NDArray[Any]
"""Floats, or our traced scalars: what law code, dynamics and plants compute with."""

Point3: TypeAlias = Annotated[Float64Array, (3,)]
Matrix3: TypeAlias = Annotated[Float64Array, (3, 3)]
Matrix6: TypeAlias = Annotated[Float64Array, (6, 6)]
"""Floats of a shape that is checked where they are read from a file."""

Vector: TypeAlias = Array  # (n,)
Vector3: TypeAlias = Array  # (3,)
Matrix: TypeAlias = Array  # (m, n)
Rotation: TypeAlias = Array  # (3, 3)
Twist: TypeAlias = Array  # (6,) linear first [m/s, rad/s]
Wrench: TypeAlias = Array  # (6,) force first [N, N m]
