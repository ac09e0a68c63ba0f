"""LinearLoop: a loop about one point, exactly, as four matrices with names; its poles, modes and responses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import scipy.linalg

from taut.base.checks import finite_array
from taut.base.errors import UsageError, missing_extra, unknown_name
from taut.base.types import ArrayLike, Float64Array
from taut.linear.frequency import Complex, at_a_pole, checked_frequencies
from taut.linear.margins import Margins, margins_of
from taut.plant.disturbance import COMMAND

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.record.report.page import Page

__all__ = ["LinearLoop", "Mode"]

AT_ONCE: Final = 1e-6  # a pole of this modulus is gone in a period
ROUNDING: Final = 1e-8  # of a modulus of one
SWINGS: Final = 1e-11  # of the modulus of a pole away from one, which stands alone
TWICE: Final = 1e-6  # two poles that are nearer are one, which rounding sets apart; slow ones beside it are not
NEAR_ONE: Final = 1e-5  # beyond one, where six digits of a modulus say nothing
SPLIT: Final = 1e-5  # by how much rounding sets three equal poles apart
REAL: Final = 1e-7  # an imaginary part below this share is rounding, of a pole that comes more than once
FEW: Final = 8  # frequencies for which a factorisation each is quicker than one for all
TELLS: Final = 0.05  # the least share of a state that a report names


@dataclass(frozen=True, kw_only=True, eq=False)
class Mode:
    """One way in which a loop comes back, or does not.

    Args:
        z: Its pole from tick to tick; of a pair the one above the axis.
        s: log(z) / dt [1/s], the pole of the continuous motion through the ticks.
        participation: Share of each state in it, by name, the largest first; they sum to one.
        joint: The joint whose position and velocity have most of it; None where no joint has any.
    """

    z: complex
    s: complex
    participation: Mapping[str, float]
    joint: str | None

    @property
    def omega_n(self) -> float:
        """Natural frequency [rad/s]."""
        return abs(self.s)

    @property
    def zeta(self) -> float:
        """Damping ratio; 1 or -1 for real poles, NaN for one at z = 1."""
        return float(-self.s.real / abs(self.s)) if self.s else float("nan")


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearLoop:
    """A closed loop about one point: x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k), for small deviations.

    States, inputs and outputs are deviations from where the loop is, by path and index: "plant.q[0]",
    "law.e_int[2]"; a rotation has three, a small rotation vector in world axes. An input holds until the next tick.
    Inputs: the reference, "disturbance.command" (on what the law commands, before the drives), "disturbance.torque"
    (on the joints), "disturbance.wrench" (on the tool, force first, world axes), noise (1 is one standard deviation),
    parameters. Outputs: q, v and the tool's pose and twist (world axes) as they truly are at the tick, and the
    command of the law. Against a reference that stays, the error of an output is minus its deviation.

    Args:
        A: (n, n).
        B: (n, m).
        C: (p, n).
        D: (p, m).
        dt: Period [s].
        states: Names of the n states.
        inputs: Names of the m inputs.
        outputs: Names of the p outputs.
        joints: Names of the arm's joints.
        q: Joint positions where it stands [rad | m].
        t: Time there [s]; 0 at an equilibrium.
        moved: What joints went from `at=` to the equilibrium; zero along a run.
        sides: Sentences: on which side of what the linearisation stands.
        left_out: States that no linear model needs, with the reason.
        drifting: States that go on changing there without any effect, and by how much in a period.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0)
        >>> lin = taut.linearise(loop, at=arm.home)
        >>> [round(mode.s.real, 2) for mode in lin.modes], lin.states
        ([-9.09, -11.11], ('plant.q[0]', 'plant.v[0]'))

    References:
        Astrom and Wittenmark, Computer-controlled systems (1997), chapter 3.
    """

    A: Float64Array
    B: Float64Array
    C: Float64Array
    D: Float64Array
    dt: float
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    joints: tuple[str, ...]
    q: Float64Array
    t: float = 0.0
    moved: Float64Array
    sides: tuple[str, ...] = ()
    left_out: Mapping[str, str]
    drifting: Mapping[str, float]

    # ---------------------------------------------------------------- poles

    @cached_property
    def poles(self) -> Complex:
        """(n,) eigenvalues of A, the largest modulus first."""
        poles = np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)
        return poles[np.argsort(-np.abs(poles), kind="stable")]

    @property
    def radius(self) -> float:
        """The largest modulus of the poles; 0 without states."""
        return float(np.abs(self.poles).max(initial=0.0))

    @cached_property
    def stable(self) -> bool:
        """Whether all that is set off dies away or stays where it is put: poles within the unit circle, or at one.

        A pole at one, as of a motion that a law leaves free, must not be coupled to another, and may be beyond one by
        what rounding moves several such poles; a swing that goes on for ever, or grows at all, is not stable.
        """
        swings = np.abs(self.poles[np.abs(self.poles - 1.0) > SPLIT])
        if self.radius > 1.0 + ROUNDING or (swings > 1.0 - SWINGS).any():
            return False
        return all(self._bounded(z) for z in self.poles if abs(z) > 1.0 - ROUNDING)

    @property
    def _undamped(self) -> float | None:
        """[rad/s] of a swing that neither grows nor dies away but for rounding; None where there is none."""
        on = (np.abs(np.abs(self.poles) - 1.0) < SWINGS) & (np.abs(self.poles - 1.0) > SPLIT)
        return float(np.abs(np.angle(self.poles[on])).max()) / self.dt if on.any() else None

    def _bounded(self, z: complex) -> bool:
        """Whether a pole on the unit circle has as many eigenvectors as it is many."""
        many = int((np.abs(self.poles - z) < TWICE).sum())
        sizes = np.linalg.svd(self.A - z * np.eye(len(self.A)), compute_uv=False)
        return int((sizes < ROUNDING * max(1.0, float(sizes[0]))).sum()) >= many

    @property
    def why(self) -> str:
        """Why it is not stable, in words; nothing where it is."""
        if self.stable:
            return ""
        more = self.radius - 1.0
        if more > NEAR_ONE:
            return f"the largest pole has modulus {self.radius:.6g}"
        if more > ROUNDING or (np.abs(self.poles[np.abs(self.poles - 1.0) > SPLIT]) > 1.0 + SWINGS).any():
            return f"the largest pole has modulus 1 + {more:.2g}"
        if self._undamped is not None:
            return f"a swing at {self._undamped:.4g} rad/s goes on for ever, without damping"
        adrift = [mode for mode in self.modes if abs(abs(mode.z) - 1.0) < SWINGS and not self._bounded(mode.z)]
        names = dict.fromkeys(
            name for mode in adrift or self.modes[:1] for name, x in mode.participation.items() if x > TELLS
        )
        return f"what is set off drifts on for ever, for nothing draws it back: {', '.join([*names][:4])}"

    @cached_property
    def modes(self) -> tuple[Mode, ...]:
        """The modes, the slowest first; one for each pair, without those that are gone in a period."""
        if not len(self.A):
            return ()
        z, left, right = scipy.linalg.eig(self.A, left=True, right=True)
        z = np.where(np.abs(z.imag) < REAL * np.abs(z), z.real + 0j, z)
        shares = np.abs(left) * np.abs(right)
        shares /= shares.sum(axis=0)
        found = [self._mode(z[k], shares[:, k]) for k in range(len(z)) if z[k].imag >= 0.0 and abs(z[k]) > AT_ONCE]
        return tuple(sorted(found, key=lambda mode: (-mode.s.real, mode.s.imag)))

    def _mode(self, z: complex, shares: Float64Array) -> Mode:
        order = np.argsort(-shares)
        of_joints = np.zeros(len(self.joints))
        for name, share in zip(self.states, shares, strict=True):
            head, _, index = name.partition("[")
            if head in ("plant.q", "plant.v", "plant.q_motor", "plant.v_motor"):
                of_joints[int(index[:-1])] += share
        joint = self.joints[int(np.argmax(of_joints))] if of_joints.any() else None
        participation = {self.states[i]: float(shares[i]) for i in order if shares[i] > 0.0}
        return Mode(z=complex(z), s=complex(np.log(complex(z)) / self.dt), participation=participation, joint=joint)

    # ---------------------------------------------------------------- responses

    def columns(self, name: str) -> tuple[int, ...]:
        """Places of an input, by its name or that of a group: "ref.q[1]", "ref.q", "disturbance.wrench".

        Raises:
            UnknownNameError: There is none.
        """
        return _places("input", name, self.inputs)

    def rows(self, name: str) -> tuple[int, ...]:
        """Places of an output: "tip.p[2]", "q", "command".

        Raises:
            UnknownNameError: There is none.
        """
        return _places("output", name, self.outputs)

    def frequency_response(self, omega: ArrayLike, *, input: str, output: str) -> Complex:
        """The response to a sine that holds from tick to tick: C (z I - A)^-1 B + D at z = exp(j omega dt).

        Args:
            omega: (k,) or one [rad/s], up to pi / dt.
            input: Of one input, or of a group of them.
            output: Likewise.

        Returns:
            (k,) where both are single ones, else (k, outputs, inputs); infinite at a pole that the input sets off
            and the output shows.

        Raises:
            UnknownNameError: No such input or output.
            RangeError: A frequency beyond half the rate, or negative.
        """
        w = checked_frequencies(omega, self.dt)
        rows, columns = self.rows(output), self.columns(input)
        out = self.response(w, self.B[:, columns], self.C[list(rows)], self.D[np.ix_(rows, columns)])
        single = input in self.inputs and output in self.outputs
        return out[:, 0, 0] if single else out

    def response(self, omega: Float64Array, B: Float64Array, C: Float64Array, D: Float64Array) -> Complex:
        """(k, p, m) of other inputs and outputs at the same states."""
        z = np.exp(1j * omega * self.dt)
        out = np.zeros((len(z), len(C), B.shape[1]), dtype=np.complex128)
        near = np.abs(z[:, np.newaxis] - self.poles).min(axis=1, initial=np.inf) < SPLIT
        for k in np.flatnonzero(near):
            out[k] = at_a_pole(self.A, B, C, z[k]) + D
        out[~near] = self._regular(z[~near], B, C) + D
        return out

    def _regular(self, z: Complex, B: Float64Array, C: Float64Array) -> Complex:
        """(k, p, m) C (z I - A)^-1 B where that is."""
        if len(z) <= FEW:
            each = [C @ np.linalg.solve(one * np.eye(len(self.A)) - self.A, B) for one in z]
            return np.array(each, dtype=np.complex128).reshape(len(z), len(C), B.shape[1])
        T, Q = self._schur
        n, k, m = len(T), len(z), B.shape[1]
        right = Q.conj().T @ B
        solved = np.zeros((n, k, m), dtype=np.complex128)
        for i in range(n - 1, -1, -1):  # (z I - T) solved = right, from the last row on, at all frequencies at once
            below = T[i, i + 1 :] @ solved[i + 1 :].reshape(n - i - 1, k * m)
            solved[i] = (right[i] + below.reshape(k, m)) / (z - T[i, i])[:, np.newaxis]
        out: Complex = ((C @ Q) @ solved.reshape(n, k * m)).reshape(len(C), k, m).transpose(1, 0, 2)
        return out

    @cached_property
    def _schur(self) -> tuple[Complex, Complex]:
        """A = Q T Q^H with T triangular, so that each frequency costs one substitution."""
        T, Q = scipy.linalg.schur(self.A, output="complex")
        return T, Q

    def input_sensitivity(self, omega: ArrayLike) -> Complex:
        """(k, n, n) S = (I + L)^-1 at the commands: what is left of a disturbance of them, all loops closed."""
        w = checked_frequencies(omega, self.dt)
        loop = self.frequency_response(w, input=COMMAND, output="command")
        return np.asarray(np.eye(len(self.joints)) + loop)

    def sensitivity(self, omega: ArrayLike, *, joint: str | int = 0) -> Complex:
        """(k,) S = 1 / (1 + L) of the loop that is broken at one joint's command, with the others closed.

        Args:
            omega: (k,) or one [rad/s].
            joint: Name or index.

        Raises:
            UnknownNameError: No such joint.
        """
        i = self.joint_index(joint)
        return self.input_sensitivity(omega)[:, i, i]

    def joint_index(self, joint: str | int) -> int:
        """Which joint a name or an index is.

        Raises:
            UnknownNameError: None.
        """
        if isinstance(joint, (int, np.integer)) and not isinstance(joint, bool) and 0 <= joint < len(self.joints):
            return int(joint)
        if joint in self.joints:
            return self.joints.index(str(joint))
        raise unknown_name("the loop", "joint", str(joint), self.joints)

    @cached_property
    def margins(self) -> Margins:
        """How far the loop is from instability, broken at each joint's command, and at all of them at once."""
        angles = np.abs(np.angle(self.poles[np.abs(self.poles) > AT_ONCE])) / self.dt
        return margins_of(self.input_sensitivity, self.joints, self.dt, angles, stable=self.stable)

    def free_response(self, ticks: int, state: ArrayLike) -> Float64Array:
        """(ticks, outputs) from a deviation of the states, without inputs.

        Raises:
            UsageError: Not a number of ticks.
            ShapeError: Not one number for each state.
        """
        if isinstance(ticks, bool) or not isinstance(ticks, (int, np.integer)) or ticks < 1:
            raise UsageError(f"ticks must be a whole number of at least 1; got {ticks!r}", name="ticks")
        x = np.array(finite_array("state", state, shape=(len(self.states),)))
        out = np.zeros((ticks, len(self.outputs)))
        for k in range(ticks):
            out[k] = self.C @ x
            x = self.A @ x
        return out

    # ---------------------------------------------------------------- elsewhere

    def to_control(self) -> Any:
        """The loop as a `control.StateSpace` of python-control, with its period and names.

        Raises:
            MissingExtraError: python-control is not installed.
        """
        try:
            import control
        except ImportError:
            raise missing_extra("LinearLoop.to_control", "control", "control") from None
        dots = {ord("."): "_"}  # which python-control keeps for the names of systems
        named = {
            "states": [name.translate(dots) for name in self.states],
            "inputs": [name.translate(dots) for name in self.inputs],
            "outputs": [name.translate(dots) for name in self.outputs],
        }
        return control.ss(self.A, self.B, self.C, self.D, self.dt, **named)

    def report_page(self) -> Page:
        """What `taut.report` makes of it."""
        from taut.analysis.design.report import page_of_linear_loop

        return page_of_linear_loop(self)

    def plot(self) -> Figure:
        """Poles in the planes of z and s, the sensitivity of each joint, the tool's compliance."""
        from taut.linear.linear_plot import plot

        return plot(self)

    def __str__(self) -> str:
        n = len(self.states)
        where = f"t = {self.t:g} s" if self.t else "equilibrium"
        lines = [f"{n} states, {1.0 / self.dt:g} Hz, {where} at q = {np.round(self.q, 4).tolist()}"]
        if np.abs(self.moved).max(initial=0.0) > ROUNDING:
            i = int(np.argmax(np.abs(self.moved)))
            lines.append(f"joint '{self.joints[i]}' went {self.moved[i]:.4g} from at= until the loop rested")
        lines.append("stable" if self.stable else f"UNSTABLE: {self.why}")
        lines += ["", "   s [1/s]               omega_n [rad/s]    zeta   in"]
        for mode in self.modes:
            parts = [f"{name} {100.0 * x:.0f} %" for name, x in mode.participation.items() if x > TELLS][:4]
            s = f"{mode.s.real:.4g}" + (f" +- {mode.s.imag:.4g} j" if mode.s.imag else "")
            zeta = "-" if math.isnan(mode.zeta) else f"{mode.zeta:.3f}"
            lines.append(f"   {s:<22} {mode.omega_n:<15.4g} {zeta:>7}   {', '.join(parts)}")
        gone = int((np.abs(self.poles) <= AT_ONCE).sum())
        if gone:
            lines.append(f"   and {gone} pole{'s' if gone > 1 else ''} at z = 0, gone in a period each")
        lines += ["", str(self.margins.table())]
        if self.sides or self.drifting:
            lines += ["", *(f"* {sentence}" for sentence in self.sides)]
            lines += [
                f"* {name} changes by {x:.3g} in each period, without effect" for name, x in self.drifting.items()
            ]
        return "\n".join(lines)


def _places(kind: str, name: str, names: Sequence[str]) -> tuple[int, ...]:
    found = tuple(i for i, known in enumerate(names) if known == name or known.startswith(f"{name}["))
    if not found:
        groups = dict.fromkeys(known.partition("[")[0] for known in names)
        raise unknown_name("the linear loop", kind, name, [*groups, *names])
    return found
