"""LinearSystem: a linear time-invariant system, continuous or sampled, whatever it was made from.

References:
    Astrom and Wittenmark, Computer-controlled systems (1997), sections 2.3 and 3.2 (hold, fractional delay).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.checks import finite_array, finite_scalar, positive_scalar, require_range
from taut.base.errors import UsageError, missing_extra, unknown_name
from taut.base.result import Cell, Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.linear.performance import Margins, StepInfo, frequency_grid, margins_of, step_response

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Complex = NDArray[np.complex128]
SINGULAR: Final = 1e-12  # [-] of the largest singular value: smaller ones are zero
CRITICAL: Final = 1e-14  # [-] of the discriminant of a double pole: rounding of the coefficients
UNDAMPED: Final = 1e-12  # [-] damping ratio below which an oscillation is sustained
RATE_ROUNDING: Final = 1e-13  # [-] of the fastest rate: a slower decay is none
WHOLE: Final = 1e-9  # [periods] a delay this near to whole periods is whole
INSTANT: Final = 1e-6  # [-] modulus in z of a mode that is over within a period
NEAR_POLE: Final = 1e-6  # [-] distance in z, or of the largest |s|, at which a response is taken from around a pole
AROUND: Final = 32  # points of the circle about a pole from which it is taken
GROWTH: Final = 1.5  # [-] of the response on half that circle over that on the circle: a pole that shows doubles it
TABLE_STATES: Final = 3  # states named for each mode in a table
SIGNALS: Final = ("states", "inputs", "outputs")
DISTURBANCE: Final = "disturbance."  # before the name of a law's output: the input that adds to it


def names(group: str, n: int) -> tuple[str, ...]:
    """("group[0]", ..., "group[n - 1]"): the names of a vector signal."""
    return tuple(f"{group}[{i}]" for i in range(n))


@dataclass(frozen=True, kw_only=True, eq=False)
class Mode:
    """One mode of a linear system: a real pole, or a complex pair."""

    pole: complex  # in z [-] if sampled, else in s [1/s]; of a pair the one with positive imaginary part
    s: complex  # [1/s]; log(z) / dt of a sampled system
    participation: Mapping[str, float]  # fraction of each state, by name, the largest first; they sum to one
    shape: Complex  # (n,) right eigenvector: the direction of the states
    resting: bool  # a position that nothing moves: z = 1 or s = 0

    @property
    def omega_n(self) -> float:
        """Natural frequency [rad/s]."""
        return abs(self.s)

    @property
    def zeta(self) -> float:
        """Damping ratio [-]; 1 or -1 of a real pole, NaN at s = 0."""
        return float(-self.s.real / abs(self.s)) if self.s else float("nan")


@dataclass(frozen=True, kw_only=True, eq=False)
class OperatingPoint:
    """The point of a loop about which it was linearised; empty for a system that is linear everywhere.

    Args:
        joints: Names of the n joints.
        q: (n,) joint positions [rad | m].
        moved: (n,) displacement of the joints from `at=` to the equilibrium (droop) [rad | m].
        branches: Sentences: non-smooth points, and the branch of each that the model is of.
        left_out: States without which the model is complete, with the reason.
    """

    joints: tuple[str, ...] = ()
    q: Float64Array = field(default_factory=lambda: np.zeros(0))
    moved: Float64Array = field(default_factory=lambda: np.zeros(0))
    branches: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, init=False, eq=False)
class LinearSystem(Result):
    """Linear time-invariant system with named signals, in continuous time or sampled.

    Law:          x_dot = A x + B u, y = C x + D u  where dt is None
                  x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k]  with a period dt

    Signals are named by group and index: "q[0]" and "q[1]" are the group "q", and methods take either.

    Args:
        A: (n, n).
        B: (n, m); no inputs if left out.
        C: (p, n); all states if left out.
        D: (p, m); zero if left out.
        dt: Period [s] of a sampled system; None in continuous time.
        states: n names; "x[0]", ... if left out.
        inputs: m names; "u[0]", ... if left out.
        outputs: p names; those of the states without C, else "y[0]", ... if left out.
        point: The point about which `taut.linearise` made it.

    Raises:
        ShapeError, RangeError: Matrices that do not fit together or are not finite, a period that is not positive.

    Example:
        >>> import taut
        >>> mass = taut.LinearSystem(A=[[0.0, 1.0], [-100.0, -20.0]], B=[[0.0], [1.0]], states=("q[0]", "v[0]"))
        >>> mass.stable, mass.poles.real.tolist(), mass.zoh(1e-3).dt
        (True, [-10.0, -10.0], 0.001)

    References:
        Astrom and Wittenmark, Computer-controlled systems (1997), chapters 2 and 3.
    """

    A: Float64Array
    B: Float64Array
    C: Float64Array
    D: Float64Array
    dt: float | None
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    point: OperatingPoint

    def __init__(
        self,
        *,
        A: ArrayLike,
        B: ArrayLike | None = None,
        C: ArrayLike | None = None,
        D: ArrayLike | None = None,
        dt: float | None = None,
        states: Sequence[str] = (),
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
        point: OperatingPoint | None = None,
    ) -> None:
        n = len(np.atleast_1d(np.asarray(A)))
        matrices = {"A": A, "B": np.zeros((n, 0)) if B is None else B, "C": np.eye(n) if C is None else C}
        m, p = np.atleast_2d(np.asarray(matrices["B"])).shape[1], len(np.atleast_1d(np.asarray(matrices["C"])))
        matrices["D"] = np.zeros((p, m)) if D is None else D
        signals = {"states": tuple(states) or names("x", n), "inputs": tuple(inputs) or names("u", m)}
        signals["outputs"] = tuple(outputs) or (signals["states"] if C is None else names("y", p))
        n, m, p = (len(signals[kind]) for kind in ("states", "inputs", "outputs"))
        for (name, matrix), shape in zip(matrices.items(), ((n, n), (n, m), (p, n), (p, m)), strict=True):
            object.__setattr__(self, name, finite_array(name, matrix, shape=shape))
        object.__setattr__(self, "dt", None if dt is None else positive_scalar("dt", dt, unit="s"))
        object.__setattr__(self, "point", OperatingPoint() if point is None else point)
        for name, value in signals.items():
            object.__setattr__(self, name, value)

    @cached_property
    def _resting_and_moving(self) -> tuple[int, Complex]:
        """The number of free positions, and the poles of the rest.

        A position that nothing moves is in the null space of A - I (of A in continuous time); another pole at z = 1
        is a drift. Counted by that space, a multiple pole needs no tolerance.
        """
        scale = balancing(self.A)
        A = self.A * scale / scale[:, np.newaxis]
        change = A - np.eye(len(A)) if self.dt else A
        _, sizes, rows = np.linalg.svd(change)
        free = int((sizes <= SINGULAR * max(float(sizes.max(initial=0.0)), float(self.dt is not None))).sum())
        if not free:
            return 0, _eigenvalues(A)
        moving = rows[: len(A) - free]  # orthonormal complement of the null space
        return free, _eigenvalues(moving @ A @ moving.T)

    @cached_property
    def poles(self) -> Complex:
        """(n,) eigenvalues of A, in z [-] or in s [1/s], the slowest decay first."""
        free, moving = self._resting_and_moving
        poles = np.concatenate([np.full(free, 1.0 if self.dt else 0.0), moving]).astype(np.complex128)
        s = self._in_s(poles)
        return poles[np.lexsort((-poles.imag, -s.real))]

    @property
    def s_poles(self) -> Complex:
        """(n,) poles in s [1/s]. Of a sampled system log(z) / dt, minus infinity for z = 0."""
        return self._in_s(self.poles)

    def _in_s(self, poles: Complex) -> Complex:
        if self.dt is None:
            return poles
        s = np.full(poles.shape, -np.inf, dtype=np.complex128)
        some = poles != 0.0
        s[some] = np.log(poles[some]) / self.dt
        return s

    def s_zeros(self, *, input: str, output: str) -> Complex:
        """Transmission zeros in s [1/s], the lowest frequency first; log(z) / dt of a sampled system.

        At a zero some input has no effect on the outputs: of torques on the motors to their positions, the
        frequencies at which the links alone would oscillate behind locked motors (anti-resonance). Feedback leaves
        them where they are. Sampling adds zeros at half the rate, and some near z = 0, which are left out.

        Args:
            input: One input or a group.
            output: As many outputs, or states by name: "plant.q_motor".

        Raises:
            UnknownNameError: No such input, output or state.
            UsageError: Not as many outputs as inputs.

        References:
            Astrom and Wittenmark, Computer-controlled systems (1997), section 2.8, zeros of sampled systems.
        """
        from scipy.linalg import eigvals

        columns, is_state = self.columns(input), any(output in (x, x.partition("[")[0]) for x in self.states)
        rows = self.state_places(output) if is_state else self.rows(output)
        if len(rows) != len(columns):
            raise UsageError(
                f"zeros are of as many outputs as inputs; got {len(rows)} of '{output}' and {len(columns)} of "
                f"'{input}'; take groups of one size, such as 'plant.q_motor' and 'disturbance.command'",
                name="output",
            )
        n, m = len(self.A), len(columns)
        C, D = (np.eye(n), np.zeros((n, len(self.inputs)))) if is_state else (self.C, self.D)
        B, C = self.B[:, columns], C[rows]
        scale = balancing(self.A)
        A, B, C = self.A * scale / scale[:, np.newaxis], B / scale[:, np.newaxis], C * scale
        pencil, left = np.block([[A, B], [C, D[np.ix_(rows, columns)]]]), np.diag([1.0] * n + [0.0] * m)
        size = np.abs(pencil).sum(axis=1, keepdims=True)
        top, bottom = eigvals(pencil / size, left / size, homogeneous_eigvals=True)
        finite = np.abs(bottom) > SINGULAR * np.abs(top)
        zeros = np.asarray(top[finite] / bottom[finite], dtype=np.complex128)
        zeros = self._in_s(zeros[np.abs(zeros) > INSTANT] if self.dt else zeros)
        return zeros[np.lexsort((zeros.imag, np.abs(zeros)))]

    @property
    def omega_n(self) -> Float64Array:
        """(n,) natural frequency of each pole [rad/s]."""
        return np.abs(self.s_poles)

    @property
    def zeta(self) -> Float64Array:
        """(n,) damping ratio of each pole [-]; 1 for z = 0, NaN for s = 0."""
        s = self.s_poles
        size = np.abs(s)
        ratio = np.divide(-s.real, size, out=np.full(len(s), np.nan), where=(size > 0.0) & np.isfinite(size))
        return np.where(np.isinf(s.real), 1.0, ratio)

    @property
    def period(self) -> float:
        """Period dt of a sampled system [s]; UsageError if continuous."""
        if self.dt is None:
            raise UsageError("the system is continuous, without a period; sample it with zoh(dt)", name="dt")
        return self.dt

    @property
    def radius(self) -> float:
        """Spectral radius of a sampled system [-], the largest modulus of its poles; UsageError if continuous."""
        return float(np.exp(self.period * self.s_poles.real.max(initial=-np.inf)))

    @property
    def decay_rate(self) -> float:
        """Slowest decay [1/s] of what moves: the distance to instability; negative for an unstable system."""
        return float(-self._in_s(self._resting_and_moving[1]).real.max(initial=-np.inf))

    @property
    def _fastest(self) -> float:
        """The fastest rate that the system knows [1/s]."""
        return 1.0 / self.dt if self.dt else float(np.abs(self.poles).max(initial=0.0))

    @cached_property
    def stable(self) -> bool:
        """Whether all deviations decay, but for positions that stay where they are put; a drift is not stable."""
        s = self._in_s(self._resting_and_moving[1])
        s = s[np.isfinite(s.real)]
        return bool((-s.real > UNDAMPED * np.abs(s) + RATE_ROUNDING * self._fastest).all())

    @property
    def unstable_because(self) -> str:
        """The reason why it is not stable, in words; empty where it is."""
        if self.stable:
            return ""
        worst = max(self._in_s(self._resting_and_moving[1]), key=lambda s: float(s.real))
        if abs(worst) <= NEAR_POLE * self._fastest and worst.real <= NEAR_POLE * self._fastest:
            return "marginally stable: a disturbance leaves a drift, for nothing restores or damps it"
        if abs(worst.real) <= UNDAMPED * abs(worst):
            return f"marginally stable: sustained oscillation at {abs(worst):.4g} rad/s without damping"
        kind = f"oscillation at {abs(worst.imag):.4g} rad/s" if worst.imag else "deviation"
        radius = "" if self.dt is None else f" (spectral radius {self.radius:.6g})"
        return f"unstable: {kind} that grows with {worst.real:.4g} 1/s{radius}"

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """The modes, the slowest first, one for each complex pair, without those that are over within a period."""
        import scipy.linalg

        if not len(self.A):
            return ()
        poles, left, right = scipy.linalg.eig(self.A, left=True, right=True)
        poles = np.where(np.abs(poles.imag) < 1e-7 * np.abs(poles), poles.real + 0j, poles)
        s, fractions = self._in_s(poles), np.abs(left) * np.abs(right)
        fractions /= fractions.sum(axis=0)
        shown = (poles.imag >= 0.0) & ((np.abs(poles) > INSTANT) if self.dt else True)
        resting = np.argsort(np.abs(s))[: self._resting_and_moving[0]]
        return tuple(
            Mode(
                pole=complex(poles[k]),
                s=complex(s[k]),
                participation={
                    self.states[i]: float(fractions[i, k])
                    for i in np.argsort(-fractions[:, k])
                    if fractions[i, k] > 0.0
                },
                shape=right[:, k],
                resting=k in resting,
            )
            for k in np.lexsort((s.imag, -s.real))
            if shown[k]
        )

    def zoh(self, dt: float, delay: float = 0.0) -> LinearSystem:
        """The system sampled every dt under a zero-order hold, with its inputs delayed, exactly.

        Law:    x[k+1] = Phi x[k] + Gamma_1 u[k-l-1] + Gamma_0 u[k-l],  delay = (l + f) dt, 0 <= f < 1

        Args:
            dt: Period [s].
            delay: [s] of the inputs; any number of periods. Past inputs become states "past.1.u[0]", ...

        Raises:
            UsageError: A sampled system.
            RangeError: A period that is not positive, a negative delay.
        """
        import scipy.linalg

        if self.dt is not None:
            raise UsageError(f"the system is sampled already, with the period {self.dt:g} s", name="dt")
        dt = positive_scalar("dt", dt, unit="s")
        delay = finite_scalar("delay", delay, unit="s", minimum=0.0)
        n, m = self.B.shape
        whole = int(np.floor(delay / dt + WHOLE))
        fraction = delay / dt - whole if delay / dt - whole > WHOLE else 0.0
        held = np.block([[self.A, self.B], [np.zeros((m, n + m))]])  # x and a constant u
        after, before = (np.asarray(scipy.linalg.expm(held * t))[:n] for t in ((1.0 - fraction) * dt, fraction * dt))
        count = whole + (fraction > 0.0)  # past inputs that are states
        new = np.zeros((n + count * m, n + count * m + m))  # by x, u[k-1], ..., u[k-count], u[k]
        column = [slice(n + count * m, None), *(slice(n + j * m, n + j * m + m) for j in range(count))]
        new[:n, :n] = after[:, :n] @ before[:, :n]
        new[:n, column[whole]] = after[:, n:]
        if fraction:
            new[:n, column[whole + 1]] = after[:, :n] @ before[:, n:]
        for j in range(count):
            new[n + j * m : n + (j + 1) * m, column[j]] = np.eye(m)
        C = np.hstack([self.C, np.zeros((len(self.C), count * m))])
        C[:, column[count]] = self.D if count else C[:, column[count]]  # the input that acts at a tick
        past = tuple(f"past.{j + 1}.{name}" for j in range(count) for name in self.inputs)
        return LinearSystem(
            A=new[:, : n + count * m], B=new[:, n + count * m :], C=C, D=None if count else self.D, dt=dt,
            states=(*self.states, *past), inputs=self.inputs, outputs=self.outputs,
        )  # fmt: skip

    def feedback(self, law: LinearSystem) -> LinearSystem:
        """The closed loop of this plant and a law.

        Closed loop:  the law's first inputs are the plant's outputs, its first outputs the plant's inputs

        Args:
            law: A system with the plant's period. Its further inputs are references, its further outputs are shown.

        Returns:
            Inputs: "disturbance." and the name of each law output that drives the plant, added to it; the references.
            Outputs: those of the plant, then those of the law, without what is added to them.

        Raises:
            UsageError: Signals or periods that do not fit, or a plant with a direct path D.
        """
        p, m = len(self.outputs), len(self.inputs)
        if (law.inputs[:p], law.outputs[:m], law.dt) != (self.outputs, self.inputs, self.dt) or self.D.any():
            raise UsageError(
                f"a law takes the plant's outputs ({', '.join(self.outputs)}) first and gives the plant's inputs "
                f"({', '.join(self.inputs)}) first, with the period {self.dt} of a plant without direct path D; got "
                f"inputs {', '.join(law.inputs)}, outputs {', '.join(law.outputs)} and the period {law.dt}",
                name="law",
            )
        By, Br, Dy, Dr = law.B[:, :p], law.B[:, p:], law.D[:, :p], law.D[:, p:]
        zeros = np.zeros
        return LinearSystem(
            A=np.block([[self.A + self.B @ Dy[:m] @ self.C, self.B @ law.C[:m]], [By @ self.C, law.A]]),
            B=np.block([[self.B, self.B @ Dr[:m]], [zeros((len(law.A), m)), Br]]),
            C=np.block([[self.C, zeros((p, len(law.A)))], [Dy @ self.C, law.C]]),
            D=np.block([[zeros((p, m + Dr.shape[1]))], [zeros((len(Dr), m)), Dr]]),
            dt=self.dt, states=(*self.states, *law.states),
            inputs=(*(DISTURBANCE + name for name in self.inputs), *law.inputs[p:]),
            outputs=(*self.outputs, *law.outputs),
        )  # fmt: skip

    @classmethod
    def from_control(cls, system: Any) -> LinearSystem:
        """From a system of python-control, with its period and the names of its signals.

        Args:
            system: `control.StateSpace`, `control.TransferFunction` or what `control.ss` takes.

        Raises:
            MissingExtraError: python-control is not installed.
            UsageError: Not such a system.
        """
        control = _control()
        if not isinstance(system, control.lti.LTI):
            raise UsageError(
                f"a system is a control.StateSpace or a control.TransferFunction; got {type(system).__name__}",
                name="system",
            )
        ss = control.ss(system)
        dt = None if ss.dt in (None, 0) else float(ss.dt)
        return cls(
            A=ss.A, B=ss.B, C=ss.C, D=ss.D, dt=dt, states=ss.state_labels, inputs=ss.input_labels,
            outputs=ss.output_labels,
        )  # fmt: skip

    def to_control(self) -> Any:
        """The system as `control.StateSpace`, names without dots: "ref_q[0]"; MissingExtraError if not installed."""
        labels = {kind: [name.replace(".", "_") for name in getattr(self, kind)] for kind in SIGNALS}
        return _control().ss(self.A, self.B, self.C, self.D, self.dt or 0, **labels)

    def columns(self, input: str) -> list[int]:
        """Indices of an input or of a group of inputs, by name; UnknownNameError if the system has none."""
        return _places("input", input, self.inputs)

    def rows(self, output: str) -> list[int]:
        """Places of an output, likewise."""
        return _places("output", output, self.outputs)

    def state_places(self, state: str) -> list[int]:
        """Places of a state, likewise."""
        return _places("state", state, self.states)

    def frequency_response(self, omega: ArrayLike, *, input: str, output: str) -> Complex:
        """Response to sines: C (z I - A)^-1 B + D at z = exp(j omega dt), or at s = j omega.

        Args:
            omega: (k,) or one [rad/s]; of a sampled system at most pi / dt.
            input: One input or a group.
            output: One output or a group.

        Returns:
            (k,) of single signals, else (k, outputs, inputs); infinite at a pole that is excited and observed.

        Raises:
            UnknownNameError: No such input or output.
            RangeError: A negative frequency, or one above half the rate.
        """
        out = self._response(omega, input, output)
        return out[:, 0, 0] if input in self.inputs and output in self.outputs else out

    def _response(self, omega: ArrayLike, input: str, output: str) -> Complex:
        """(k, outputs, inputs) of groups."""
        rows, columns = self.rows(output), self.columns(input)
        B, C, D = self.B[:, columns], self.C[rows], self.D[np.ix_(rows, columns)]
        w = np.ravel(finite_array("omega", omega, unit="rad/s"))
        half_rate = np.pi / self.dt * (1.0 + WHOLE) if self.dt else np.inf
        require_range("omega", w, unit="rad/s", minimum=0.0, maximum=half_rate)
        z = np.exp(1j * w * self.dt) if self.dt else 1j * w
        out = np.zeros((len(z), len(C), B.shape[1]), dtype=np.complex128)
        size = 1.0 if self.dt else max(self._fastest, 1e-300)
        near = np.abs(z[:, np.newaxis] - self.poles).min(axis=1, initial=np.inf) < NEAR_POLE * size
        out[~near] = self._transfer(z[~near], B, C) + D
        for k in np.flatnonzero(near):
            out[k] = self._beside_pole(complex(z[k]), B, C, size) + D
        return out

    @cached_property
    def _schur(self) -> tuple[Complex, Complex]:
        """A = Q T Q^H with T triangular, so that a frequency costs one substitution."""
        import scipy.linalg

        T, Q = scipy.linalg.schur(self.A, output="complex")
        return T, Q

    def _transfer(self, z: Complex, B: Float64Array, C: Float64Array) -> Complex:
        """(k, p, m) C (z I - A)^-1 B, at all z at once, from the last row of the triangle on."""
        T, Q = self._schur
        n, k, m = len(T), len(z), B.shape[1]
        right = Q.conj().T @ B
        solved = np.zeros((n, k, m), dtype=np.complex128)
        for i in range(n - 1, -1, -1):
            below = T[i, i + 1 :] @ solved[i + 1 :].reshape(n - i - 1, k * m)
            solved[i] = (right[i] + below.reshape(k, m)) / (z - T[i, i])[:, np.newaxis]
        return np.asarray(((C @ Q) @ solved.reshape(n, k * m)).reshape(len(C), k, m).transpose(1, 0, 2))

    def _beside_pole(self, z: complex, B: Float64Array, C: Float64Array, size: float) -> Complex:
        """(p, m) the response at a pole: infinite where it shows, else the mean over a circle about it (Cauchy)."""
        apart = np.abs(self.poles - z)
        others = apart[apart > NEAR_POLE * size]
        radius = 0.2 * min(float(others.min(initial=size)), size)
        circle = np.exp(2j * np.pi * (np.arange(AROUND) + 0.5) / AROUND)
        wide, close = (self._transfer(z + r * circle, B, C) for r in (radius, 0.5 * radius))
        out = np.asarray(close.mean(axis=0))
        one, two = (np.abs(values - out).max(axis=0) for values in (wide, close))
        least = 1e-9 * np.outer(np.linalg.norm(C, axis=1), np.linalg.norm(B, axis=0)) / size
        out[(two > GROWTH * one) & (two > least)] = np.inf
        return out

    def dc_gain(self, *, input: str, output: str) -> float | Float64Array:
        """Steady-state output per constant input of a stable system: a number, or of groups (outputs, inputs).

        Infinite where a constant input makes the output grow without bound.
        """
        gain = np.asarray(self.frequency_response(0.0, input=input, output=output)[0])
        return gain.real if gain.ndim else float(gain.real)

    def step(self, *, input: str = "ref.q[0]", output: str = "q[0]") -> StepInfo:
        """Overshoot, settling, rise and peak time of one output (of a sampled system at ticks) after a step."""
        (column, *more), (row, *others) = self.columns(input), self.rows(output)
        if more or others:
            raise UsageError(f"a step is of one input and one output; got '{input}' and '{output}'", name="input")
        rest = np.eye(len(self.A)) if self.dt else np.zeros_like(self.A)
        final = np.asarray(np.linalg.lstsq(rest - self.A, self.B[:, column], rcond=None)[0], dtype=np.float64)
        end = float(self.C[row] @ final + self.D[row, column])
        scale = float(np.abs(self.C[row] * final).max(initial=abs(self.D[row, column])))
        if not self.decay_rate > 0.0 or abs(end) <= SINGULAR * scale:
            return StepInfo.none(end)
        return step_response(self.A, final, self.C[row] / end, dt=self.dt, s_poles=self.s_poles, final=end)

    def sensitivity(
        self, omega: ArrayLike, *, input: str = "disturbance.command", output: str = "command"
    ) -> Complex:
        """(k, m, m) S = (I + L)^-1 of the loop opened where a group of inputs adds to one of outputs.

        Args:
            omega: (k,) [rad/s].
            input: What adds to the output; one name or a group.
            output: As many.
        """
        count, added = len(self.rows(output)), len(self.columns(input))
        if count != added:
            raise UsageError(
                f"the loop is opened where as many inputs add to outputs; got {added} and {count}", name="input"
            )
        return np.eye(count) + self._response(omega, input, output)

    def margins(self, *, input: str = "disturbance.command", output: str = "command") -> Margins:
        """Gain, phase and delay margin of each signal with the others closed, and the disk margin of all at once.

        Args:
            input: What adds to the output; one name or a group.
            output: Where the loop is opened; as many. Commands of a linearised arm are named by its joints.

        References:
            Seiler, Packard and Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40 (2020).
        """
        signals = tuple(self.outputs[i] for i in self.rows(output))
        if output == "command" and self.point.joints:
            signals = self.point.joints
        sensitivity = partial(self.sensitivity, input=input, output=output)
        return margins_of(sensitivity, signals, self.dt, self.omega_n, stable=self.stable)

    def peak_gain(self, *, input: str, output: str) -> Float64Array:
        """(outputs, inputs) largest gains of sines of any frequency; UsageError if unstable."""
        if not self.stable:
            raise UsageError(
                f"a largest gain is that of a stable loop; this one is {self.unstable_because}", name="loop"
            )
        omega = frequency_grid(self.dt, self.omega_n)
        return np.asarray(np.abs(self._response(omega, input, output)).max(axis=0))

    def content(self) -> Content:
        """Modes, margins and step as tables, and the figure of `plot`."""
        kind = "in continuous time" if self.dt is None else f"sampled at {1.0 / self.dt:.6g} Hz"
        summary = [f"stable: the slowest mode decays with {self.decay_rate:.4g} 1/s"] if self.stable else []
        if self.point.joints:
            q, moved = np.round(self.point.q, 4).tolist(), np.abs(self.point.moved).max()
            summary.append(f"about the equilibrium q = {q}, at most {moved:.3g} rad or m from at=")
        tables = [self._mode_table()]
        if "command" in {name.partition("[")[0] for name in self.outputs} and self.stable:
            tables.append(self.margins().table())
        if {"ref.q[0]"} <= {*self.inputs} and {"q[0]"} <= {*self.outputs} and self.stable:
            tables.append(self.step().table())
        return Content(
            title=f"linear system of {len(self.states)} states {kind}",
            summary=summary,
            faults=() if self.stable else (self.unstable_because,),
            tables=tables,
            notes=self.point.branches,
            figures={"step response, poles and margins": self.plot},
        )

    def _mode_table(self) -> Table:
        rows: list[list[Cell]] = []
        for mode in self.modes:
            parts = [f"{name} {100.0 * x:.0f} %" for name, x in [*mode.participation.items()][:TABLE_STATES]]
            time_constant = -1.0 / mode.s.real if mode.s.real else np.inf
            rows.append([mode.s.real, mode.s.imag, mode.omega_n, mode.zeta, time_constant, ", ".join(parts)])
        columns = ("Re s [1/s]", "Im s [1/s]", "omega_n [rad/s]", "zeta [-]", "time constant [s]", "states")
        return Table(title="modes", columns=columns, rows=rows)

    def plot(self) -> Figure:
        """Step response, poles, Bode and Nyquist diagram, as far as the system has their signals."""
        from taut.linear import plots

        return plots.figure_of(self)


def _eigenvalues(A: Float64Array) -> Complex:
    """(n,) eigenvalues; of two by section 10.2.1.1's formula, for rounding would split a critically damped pole."""
    size = float(np.abs(A).max(initial=0.0))
    if len(A) != 2 or not size:
        return np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
    (a, b), (c, d) = (A / size).tolist()
    half, square = 0.5 * (a + d), 0.25 * (a - d) ** 2 + b * c
    if abs(square) <= CRITICAL * max(half * half, abs(b * c)):
        return size * np.array([half, half], dtype=np.complex128)
    if square < 0.0:
        return np.asarray(size * (half + 1j * np.sqrt(-square) * np.array([1.0, -1.0])))
    far = half + np.copysign(np.sqrt(square), half)
    return size * np.array([far, (a * d - b * c) / far], dtype=np.complex128)


def balancing(A: Float64Array) -> Float64Array:
    """(n,) units of the states in which rows and columns of A have one size, so that rounding is of all alike."""
    from scipy.linalg import matrix_balance

    return np.asarray(matrix_balance(A, permute=False, separate=True)[1][0]) if len(A) else np.ones(0)


def _places(kind: str, name: str, known: Sequence[str]) -> list[int]:
    places = [i for i, one in enumerate(known) if name in (one, one.partition("[")[0])]
    if not places:
        raise unknown_name("the system", kind, name, known)
    return places


def _control() -> Any:
    try:
        import control
    except ImportError as cause:
        raise missing_extra("a system of python-control", "control", "control") from cause
    return control
