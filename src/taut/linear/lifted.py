"""Lifted maps: a sampled linear system over all samples of a trial at once, and by frequency."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from taut.base.errors import NumericalError
from taut.base.types import Float64Array
from taut.linear.linear_system import Complex

Samples: TypeAlias = Callable[[Float64Array], Float64Array]
RESIDUAL: Final = 1e-9  # [-] relative residual of an inverse
MAX_ITERATIONS: Final = 2000  # of conjugate gradients
NORM_TOLERANCE: Final = 1e-2  # [-] residual of the vector of a norm; the norm itself is then right within 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Lifted:
    """A linear map of the samples of a trial, (N, m) to (N, p), with its symbol, that of a trial without end."""

    samples: int  # N
    symbol: Complex  # (f, p, m) by frequency, from zero to half the rate in equal steps
    flat: Any  # SciPy's LinearOperator (N p, N m), of samples one behind the other

    @classmethod
    def causal(cls, h: Float64Array) -> Lifted:
        """The zero-state response of a system, from its impulse response h (N, p, m): a lower triangle of blocks."""
        return cls._of_symbol(np.fft.rfft(h, _padded(len(h)), axis=0), len(h))

    @classmethod
    def constant(cls, gains: Float64Array, samples: int) -> Lifted:
        """The same gains (p, m) in every sample."""
        symbol = np.broadcast_to(gains.astype(np.complex128), (_padded(samples) // 2 + 1, *gains.shape))
        return cls._made(symbol, samples, lambda x: x @ gains.T, lambda y: y @ gains)

    @classmethod
    def _of_symbol(cls, symbol: Complex, samples: int) -> Lifted:
        length = _padded(samples)

        def filtered(values: Complex, x: Float64Array) -> Float64Array:
            spectrum = values @ np.fft.rfft(x, length, axis=0)[:, :, np.newaxis]
            return np.asarray(np.fft.irfft(spectrum[:, :, 0], length, axis=0)[:samples])

        return cls._made(symbol, samples, lambda x: filtered(symbol, x), lambda y: filtered(_adjoint(symbol), y))

    @classmethod
    def _made(cls, symbol: Complex, samples: int, act: Samples, back: Samples) -> Lifted:
        """From the map of samples and its adjoint."""
        from scipy.sparse.linalg import LinearOperator

        flat = LinearOperator(
            tuple(samples * size for size in symbol.shape[1:]),
            matvec=lambda x: act(x.reshape(samples, -1)).ravel(),
            rmatvec=lambda y: back(y.reshape(samples, -1)).ravel(),
            dtype=np.float64,
        )
        return cls(samples=samples, symbol=symbol, flat=flat)

    def act(self, x: Float64Array) -> Float64Array:
        """(N, p) the map of samples (N, m)."""
        return np.asarray((self.flat @ x.ravel()).reshape(self.samples, -1))

    @property
    def T(self) -> Lifted:
        """The adjoint."""
        return Lifted(samples=self.samples, symbol=_adjoint(self.symbol), flat=self.flat.H)

    def __matmul__(self, other: Lifted) -> Lifted:
        return Lifted(samples=self.samples, symbol=self.symbol @ other.symbol, flat=self.flat @ other.flat)

    def __add__(self, other: Lifted) -> Lifted:
        return Lifted(samples=self.samples, symbol=self.symbol + other.symbol, flat=self.flat + other.flat)

    def __sub__(self, other: Lifted) -> Lifted:
        return Lifted(samples=self.samples, symbol=self.symbol - other.symbol, flat=self.flat - other.flat)

    def inverse(self) -> Lifted:
        """The inverse of a symmetric positive map, by conjugate gradients with its symbol as preconditioner."""
        from scipy.sparse.linalg import cg

        symbol: Complex = np.asarray(np.linalg.inv(self.symbol), dtype=np.complex128)
        near = Lifted._of_symbol(symbol, self.samples).flat

        def solved(x: Float64Array) -> Float64Array:
            y, failed = cg(self.flat, x.ravel(), rtol=RESIDUAL, maxiter=MAX_ITERATIONS, M=near)
            if failed:
                raise NumericalError(
                    f"a lifted system of {x.size} unknowns is not solved after {MAX_ITERATIONS} iterations; raise "
                    "the weights of the learning law",
                    name="inverse",
                )
            return np.asarray(y)

        return self._made(symbol, self.samples, solved, solved)

    def norm(self) -> float:
        """The largest singular value over the samples of the trial, by Lanczos' method."""
        from scipy.sparse.linalg import eigsh

        start = np.random.default_rng(0).standard_normal(self.flat.shape[1])
        largest = eigsh(self.flat.H @ self.flat, k=1, tol=NORM_TOLERANCE, v0=start, return_eigenvectors=False)
        return float(np.sqrt(max(0.0, largest[0])))

    def gains(self) -> Float64Array:
        """(f,) the largest singular value of the symbol by frequency."""
        return np.asarray(np.linalg.norm(self.symbol, ord=2, axis=(1, 2)))


def _padded(samples: int) -> int:
    """An even length that is quickly transformed, in which a response of so many samples does not wrap."""
    from scipy.fft import next_fast_len

    return 2 * int(next_fast_len(samples))


def _adjoint(symbol: Complex) -> Complex:
    return np.conj(np.swapaxes(symbol, 1, 2))
