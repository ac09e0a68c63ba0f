"""Lifted maps: a sampled linear system over all samples of a trial at once, and by frequency."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.errors import NumericalError
from taut.base.types import Float64Array
from taut.linear.linear_system import Complex

RESIDUAL: Final = 1e-9  # [-] relative residual of an inverse
MAX_ITERATIONS: Final = 2000  # of conjugate gradients
NORM_TOLERANCE: Final = 1e-2  # [-] residual of the vector of a norm; the norm itself is then right within 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Lifted:
    """A linear map of the samples of a trial, (N, m) to (N, p), with its symbol, that of a trial without end.

    Args:
        samples: N.
        symbol: (f, p, m) by frequency, from zero to half the rate in equal steps.
        act: The map of samples.
        back: Its adjoint.
    """

    samples: int
    symbol: Complex
    act: Callable[[Float64Array], Float64Array]
    back: Callable[[Float64Array], Float64Array]

    @classmethod
    def causal(cls, h: Float64Array) -> Lifted:
        """The zero-state response of a system, from its impulse response h (N, p, m): a lower triangle of blocks."""
        return cls._of_symbol(np.fft.rfft(h, _padded(len(h)), axis=0), len(h))

    @classmethod
    def constant(cls, gains: Float64Array, samples: int) -> Lifted:
        """The same gains (n,) in every sample."""
        n, count = len(gains), _padded(samples) // 2 + 1
        symbol = np.broadcast_to(np.diag(gains).astype(np.complex128), (count, n, n))
        return cls(samples=samples, symbol=symbol, act=lambda x: gains * x, back=lambda x: gains * x)

    @classmethod
    def _of_symbol(cls, symbol: Complex, samples: int) -> Lifted:
        length = _padded(samples)

        def filtered(values: Complex) -> Callable[[Float64Array], Float64Array]:
            def act(x: Float64Array) -> Float64Array:
                spectrum = values @ np.fft.rfft(x, length, axis=0)[:, :, np.newaxis]
                return np.asarray(np.fft.irfft(spectrum[:, :, 0], length, axis=0)[:samples])

            return act

        return cls(samples=samples, symbol=symbol, act=filtered(symbol), back=filtered(_adjoint(symbol)))

    @property
    def T(self) -> Lifted:
        """The adjoint."""
        return Lifted(samples=self.samples, symbol=_adjoint(self.symbol), act=self.back, back=self.act)

    def __matmul__(self, other: Lifted) -> Lifted:
        return Lifted(
            samples=self.samples,
            symbol=self.symbol @ other.symbol,
            act=lambda x: self.act(other.act(x)),
            back=lambda y: other.back(self.back(y)),
        )

    def __add__(self, other: Lifted) -> Lifted:
        return Lifted(
            samples=self.samples,
            symbol=self.symbol + other.symbol,
            act=lambda x: self.act(x) + other.act(x),
            back=lambda y: self.back(y) + other.back(y),
        )

    def __sub__(self, other: Lifted) -> Lifted:
        return self + Lifted.constant(np.full(other.symbol.shape[1], -1.0), self.samples) @ other

    def inverse(self) -> Lifted:
        """The inverse of a symmetric positive map, by conjugate gradients with its symbol as preconditioner."""
        from scipy.sparse.linalg import cg

        symbol: Complex = np.asarray(np.linalg.inv(self.symbol), dtype=np.complex128)
        map_, near = self._operator(self.act), self._operator(Lifted._of_symbol(symbol, self.samples).act)

        def solved(x: Float64Array) -> Float64Array:
            y, failed = cg(map_, x.ravel(), rtol=RESIDUAL, maxiter=MAX_ITERATIONS, M=near)
            if failed:
                raise NumericalError(
                    f"a lifted system of {x.size} unknowns is not solved after {MAX_ITERATIONS} iterations; raise "
                    "the weights of the learning law",
                    name="inverse",
                )
            return np.asarray(y).reshape(x.shape)

        return Lifted(samples=self.samples, symbol=symbol, act=solved, back=solved)

    def norm(self) -> float:
        """The largest singular value over the samples of the trial, by Lanczos' method."""
        from scipy.sparse.linalg import eigsh

        square = self._operator(lambda x: self.back(self.act(x)))
        start = np.random.default_rng(0).standard_normal(square.shape[0])
        largest = eigsh(square, k=1, tol=NORM_TOLERANCE, v0=start, return_eigenvectors=False)
        return float(np.sqrt(max(0.0, largest[0])))

    def gains(self) -> Float64Array:
        """(f,) the largest singular value of the symbol by frequency."""
        return np.asarray(np.linalg.norm(self.symbol, ord=2, axis=(1, 2)))

    def _operator(self, act: Callable[[Float64Array], Float64Array]) -> Any:
        """A square map of samples as an operator of SciPy."""
        from scipy.sparse.linalg import LinearOperator

        shape = (self.samples, self.symbol.shape[2])
        size = shape[0] * shape[1]
        return LinearOperator((size, size), matvec=lambda x: act(x.reshape(shape)).ravel(), dtype=np.float64)


def _padded(samples: int) -> int:
    """An even length that is quickly transformed, in which a response of so many samples does not wrap."""
    from scipy.fft import next_fast_len

    return 2 * int(next_fast_len(samples))


def _adjoint(symbol: Complex) -> Complex:
    return np.conj(np.swapaxes(symbol, 1, 2))
