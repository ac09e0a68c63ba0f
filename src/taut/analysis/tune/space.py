"""The parameters that are tuned, as numbers between 0 and 1 within their bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError, UsageError, unknown_name
from taut.base.types import ArrayLike, Float64Array
from taut.loop import Loop

__all__ = ["Space"]

AT_BOUND: Final = 1e-6  # of the way from bound to bound
FACTOR: Final = 10.0  # up and down from the start, where no bounds are given


class Space:
    """Parameters by path, one number for each entry, between bounds; on a logarithmic scale where these are positive.

    Args:
        loop: With the parameters as they are.
        paths: Which.
        bounds: By path (low, high), each a number or one per entry; a tenth and ten times what it is if left out.

    Raises:
        UnknownNameError: No such parameter.
        UsageError, ShapeError, RangeError: Bounds that are none, or that the start is outside of.
    """

    def __init__(
        self, loop: Loop, paths: Sequence[str], bounds: Mapping[str, tuple[ArrayLike, ArrayLike]] | None
    ) -> None:
        if isinstance(paths, str) or not paths:
            raise UsageError(
                f"paths must be names of parameters, such as ('law.kp', 'law.kd'); got {paths!r}", name="paths"
            )
        for path in paths:
            if path not in loop.parameters:
                raise unknown_name("the loop", "parameter", path, loop.parameters)
        for path in bounds or {}:
            if path not in paths:
                raise unknown_name("paths", "parameter to bound", path, paths)
        self.paths = tuple(dict.fromkeys(paths))
        self.shapes = {path: loop.parameters[path].shape for path in self.paths}
        low, high, start = [], [], []
        for path in self.paths:
            value = loop.parameters[path]
            if value.ndim > 1:
                raise ShapeError(
                    f"{path} is a matrix, of which taut.tune does not keep that it is symmetric and positive; give "
                    "the law one number per joint or direction",
                    name=path,
                )
            a, b = self._bounds(path, value, (bounds or {}).get(path))
            low.append(a)
            high.append(b)
            start.append(np.ravel(value))
        self.low, self.high = np.concatenate(low), np.concatenate(high)
        self.log = self.low > 0.0
        self.start = self.inside(np.concatenate(start))
        self.first = {path: np.array(loop.parameters[path]) for path in self.paths}

    def _bounds(
        self, path: str, value: Float64Array, given: tuple[ArrayLike, ArrayLike] | None
    ) -> tuple[Float64Array, Float64Array]:
        if given is None:
            if np.any(value <= 0.0):
                raise UsageError(
                    f"{path} is {float(np.min(value)):g}, from which no bounds follow; give bounds={{'{path}': (low, "
                    "high)}",
                    name="bounds",
                )
            return np.ravel(value) / FACTOR, np.ravel(value) * FACTOR
        if not isinstance(given, (tuple, list)) or len(given) != 2:
            raise UsageError(f"bounds of {path} must be (low, high); got {given!r}", name="bounds")
        pair = []
        for name, side in zip(("low", "high"), given, strict=True):
            array = finite_array(f"bounds['{path}'] {name}", side)
            if array.shape not in ((), value.shape):
                raise ShapeError(
                    f"bounds of {path} must be numbers, or of its shape {value.shape}; got shape {array.shape}",
                    name="bounds",
                )
            pair.append(np.array(np.broadcast_to(array, value.shape)).ravel())
        if np.any(pair[0] >= pair[1]):
            raise RangeError(f"bounds of {path} must have low < high; got {given!r}", name="bounds")
        outside = (np.ravel(value) < pair[0]) | (np.ravel(value) > pair[1])
        if np.any(outside):
            raise RangeError(
                f"{path} starts at {float(np.ravel(value)[outside][0]):g}, outside of its bounds {given!r}; change "
                "either",
                name="bounds",
            )
        return pair[0], pair[1]

    @property
    def size(self) -> int:
        """Number of numbers."""
        return len(self.low)

    def inside(self, values: Float64Array) -> Float64Array:
        """(m,) from 0 at the low bound to 1 at the high one."""
        low, high = np.where(self.log, self.low, 1.0), np.where(self.log, self.high, 2.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            logarithmic = np.log(np.where(self.log, values, 1.0) / low) / np.log(high / low)
        return np.where(self.log, logarithmic, (values - self.low) / (self.high - self.low))

    def values(self, x: Float64Array) -> Float64Array:
        """(m,) the way back."""
        x = np.clip(x, 0.0, 1.0)
        low, high = np.where(self.log, self.low, 1.0), np.where(self.log, self.high, 2.0)
        out = np.where(self.log, low * (high / low) ** x, self.low + x * (self.high - self.low))
        return np.clip(out, self.low, self.high)

    def at_bounds(self, values: Mapping[str, Float64Array]) -> list[str]:
        """A sentence for each parameter that a bound holds."""
        x, k, sentences = self.inside(np.concatenate([np.ravel(values[path]) for path in self.paths])), 0, []
        for path, shape in self.shapes.items():
            here = x[k : k + int(np.prod(shape))]
            k += len(here)
            for which, there in (("low", here <= AT_BOUND), ("high", here >= 1.0 - AT_BOUND)):
                some = "" if there.all() else f"[{', '.join(str(i) for i in np.flatnonzero(there))}]"
                if there.any():
                    sentences.append(
                        f"{path}{some} ends at the {which} bound; bounds={{'{path}': (low, high)}} moves it"
                    )
        return sentences

    def slopes(self, x: Float64Array) -> Float64Array:
        """(m,) how fast the values grow with x."""
        low, high = np.where(self.log, self.low, 1.0), np.where(self.log, self.high, 2.0)
        return np.where(self.log, self.values(x) * np.log(high / low), self.high - self.low)

    def by_path(self, x: Float64Array) -> dict[str, Float64Array]:
        """The values, by path and in their shapes."""
        values, out, k = self.values(x), {}, 0
        for path, shape in self.shapes.items():
            size = int(np.prod(shape))
            out[path] = values[k : k + size].reshape(shape)
            k += size
        return out

    def ways(self, x: Float64Array) -> dict[str, Float64Array]:
        """By path (m, ...) how each number between 0 and 1 changes the parameter."""
        slopes, out, k = np.diag(self.slopes(x)), {}, 0
        for path, shape in self.shapes.items():
            size = int(np.prod(shape))
            out[path] = slopes[:, k : k + size].reshape(self.size, *shape)
            k += size
        return out
