"""Impedance and admittance of a loop at its tool: specified by the law, predicted, and measured by a sine sweep."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.paths import subtree
from taut.base.result import Cell, Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.loop import StepLoop
from taut.control.combine import Sum, bare, title
from taut.control.gains import GainValue
from taut.control.law import Law
from taut.control.laws.apparent import felt_impedance
from taut.control.laws.friction import FrictionCompensation
from taut.control.laws.impedance import Stiffness
from taut.control.laws.joint import PID, ComputedTorque, FeedForward, GravityCompensation, GravityPID
from taut.control.laws.task import TaskComputedTorque
from taut.control.laws.via_joint_space import ViaJointSpace
from taut.linear.equilibrium import WITHIN
from taut.linear.judgement import uncertain_eigenvalues
from taut.linear.linear_system import LinearSystem
from taut.linear.linearise import linearise, rest_of
from taut.linear.period import loop_map, small_rotations
from taut.loop import Loop
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot
from taut.plant.environments.environment import WRENCH
from taut.trace.derivative import jacobian

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ToolImpedance", "tool_impedance"]

Complex = NDArray[np.complex128]
Admittance = Callable[[Complex], Complex]
"""(k, 6, 6) the tool's response X / F in world axes at s (k,) [1/s]."""

HERTZ: Final = 2.0 * np.pi
REACH: Final = 1e-6  # of the Jacobian: below it the tool cannot move in a direction
NO_MOTION: Final = 1e-12  # of the largest response: rounding
INSIDE: Final = 1e-9  # of the largest entry

# Of a sine sweep.
AMPLITUDE: Final = 1e-4  # [m | rad] of the tool
HIGHEST: Final = 0.999  # of half the rate: at half of it all ticks may fall on zeros of the sine
PERIODS: Final = 4  # that are fitted
TRANSIENT: Final = 1e-5  # of the transient at the start, when the fit begins
BLOCK: Final = 4096  # ticks between two visits of Python
MAX_TICKS: Final = 2_000_000
NO_DECAY: Final = 1.0 - 1e-9  # modulus of a pole that does not decay

# Of a figure.
FIGURE_HEIGHT: Final = 4.6
DECADES: Final = 4.0
CURVE_POINTS: Final = 400


def _inverse(values: Complex) -> Complex:
    """(k,) 1 / values, infinite where they are zero and zero where they are infinite."""
    out = np.zeros(len(values), dtype=np.complex128)
    out[values == 0.0] = np.inf
    some = np.isfinite(values) & (values != 0.0)
    out[some] = 1.0 / values[some]
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolImpedance(Result):
    """Response of a loop to a force at its tool along one direction, with the tool free in all others.

    Law:          X = Y F, F = Z X, with Y = d^T Y_tool d of the six by six response of the tool and Z = 1 / Y

    Specified is the law's closed loop in continuous time: of `Impedance` and `Admittance` D s^2 + B s + K, of
    ComputedTorque M (s^2 + kd s + kp + ki / s) through J, and so on, without drives, filters and friction. Predicted
    is the sampled loop as it is simulated, exactly: with zero-order hold, delay, filters, drives and integrator.
    Measured is a sine sweep in simulation, on request. Quantisation and noise are in neither.

    Args:
        loop: The loop.
        lin: Its linear model.
        direction: (6,) unit vector in world axes: a force, or a moment.
        specified: s (k,) to (k, 6, 6) the response of the law's closed loop; None where it has no closed form.

    References:
        Section 10.5. Hogan, Impedance control, J. Dynamic Systems, Measurement and Control 107 (1985).
    """

    loop: Loop
    lin: LinearSystem
    direction: Float64Array
    specified: Admittance | None

    @property
    def unit(self) -> str:
        """Of Z."""
        return "N/m" if self.direction[:3].any() else "N m/rad"

    def Y(self, omega: ArrayLike) -> Complex:
        """(k,) predicted admittance X / F [m/N | rad/(N m)].

        Raises:
            RangeError: A frequency beyond half the rate, or negative.
        """
        lin, d = self.lin, self.direction
        rows = [*lin.rows("tip.p"), *lin.rows("tip.rotation")]
        columns = lin.columns("disturbance.wrench")
        B, C, D = lin.B[:, columns] @ d, d @ lin.C[rows], d @ lin.D[np.ix_(rows, columns)] @ d
        return lin.response(omega, B[:, np.newaxis], C[np.newaxis], np.array([[D]]))[:, 0, 0]

    def Z(self, omega: ArrayLike) -> Complex:
        """(k,) predicted impedance F / X [N/m | N m/rad]; infinite where the tool does not move, as of stiff drives.

        Raises:
            RangeError: A frequency beyond half the rate, or negative.
        """
        Y = self.Y(omega)
        size = float(np.abs(self.Y(np.geomspace(1e-5, 1.0, 5)[:-1] * np.pi / self.lin.period)).max())
        return _inverse(np.where(np.abs(Y) < NO_MOTION * size, 0.0, Y))

    def specified_Z(self, omega: ArrayLike) -> Complex:
        """(k,) impedance of the law's closed loop in continuous time.

        Raises:
            UsageError: The law has none in closed form.
            RangeError: A frequency that is not above zero, or beyond half the rate.
        """
        if self.specified is None:
            raise UsageError(
                f"{title(self.loop.side.law)} specifies no impedance at the arm's tool in closed form; use Z",
                name="specified",
            )
        s = np.asarray(1j * self._above_zero(omega), dtype=np.complex128)
        return _inverse(np.asarray(self.specified(s) @ self.direction @ self.direction, dtype=np.complex128))

    def measured_Z(self, omega: ArrayLike) -> Complex:
        """(k,) by a sine sweep in simulation, one run for each frequency: the motion fitted over whole periods.

        The force is one that moves the tool by 0.1 mm or 0.1 mrad, and 1 where it does not move.

        Args:
            omega: (k,) or one [rad/s], above zero and below half the rate.

        Raises:
            RangeError: A frequency without meaning; a loop whose deviations grow. One that drifts is measured.
        """
        w = self._above_zero(omega)
        z, uncertainty = uncertain_eigenvalues(self.lin.A)
        if (np.abs(z) > 1.0 + uncertainty).any():
            raise RangeError(
                f"the loop must not grow, or no sine settles; it is {self.lin.unstable_because}",
                name="loop",
                value=self.lin.radius,
                rule="not growing",
            )
        Z = np.abs(self.Z(w))
        amplitudes = np.where(np.isfinite(Z), AMPLITUDE * Z, 1.0)
        return _inverse(_sine_sweep(self.loop, self.lin, self.direction, w, amplitudes))

    def _above_zero(self, omega: ArrayLike) -> Float64Array:
        w = np.atleast_1d(finite_array("omega", omega, unit="rad/s"))
        highest = HIGHEST * np.pi / self.lin.period
        if w.ndim != 1 or not ((w > 0.0) & (w <= highest)).all():
            raise RangeError(
                f"omega must be one frequency or (k,) of them, above 0 and at most {highest:.6g} rad/s, below half "
                f"the rate; got {w}",
                name="omega",
                value=w,
            )
        return w

    def content(self) -> Content:
        """Size of the impedance over frequency, and its Bode diagram."""
        omega = HERTZ * np.array([0.1, 1.0, 3.0, 10.0, 30.0])
        omega = omega[omega < HIGHEST * np.pi / self.lin.period]
        rows: list[list[Cell]] = [[w / HERTZ, abs(z)] for w, z in zip(omega.tolist(), self.Z(omega), strict=True)]
        columns = ["frequency [Hz]", f"|Z| [{self.unit}]"]
        if self.specified is not None:
            columns += [f"specified [{self.unit}]", "difference [%]"]
            for row, z in zip(rows, np.abs(self.specified_Z(omega)).tolist(), strict=True):
                row += [z, 100.0 * (float(row[1] or 0.0) / z - 1.0) if z else None]
        return Content(
            title="tool impedance along a direction",
            tables=[Table(columns=columns, rows=rows)],
            figures={"Bode diagram of the impedance": self.plot},
        )

    def plot(self, measured: ArrayLike | None = None) -> Figure:
        """Bode diagram of Z: specified and predicted.

        Args:
            measured: (k,) frequencies [rad/s] at which it shows a sine sweep too.
        """
        from matplotlib.figure import Figure

        from taut.base.plot_style import DASHED, INK, SMALL, WIDTH, colour, prepared

        figure = Figure(figsize=(WIDTH, FIGURE_HEIGHT), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True)
        prepared(above, "impedance at the tool, Z = F / X", f"|Z| [{self.unit}]")
        prepared(below, "", "phase of Z [deg]", "frequency [Hz]")
        omega = HIGHEST * np.pi / self.lin.period * np.logspace(-DECADES, 0.0, CURVE_POINTS)
        curves: list[tuple[Float64Array, Complex, str, dict[str, Any]]] = [
            (omega, self.Z(omega), "predicted, of the sampled loop", {"color": colour(0)})
        ]
        if self.specified is not None:
            curves.append((omega, self.specified_Z(omega), "specified", {"color": INK, "linestyle": DASHED}))
        if measured is not None:
            w = np.atleast_1d(np.asarray(measured, dtype=np.float64))
            style = {"color": colour(1), "linestyle": "none", "marker": "o", "markersize": 4.0}
            curves.append((w, self.measured_Z(w), "measured, sine sweep", style))
        predicted = np.unwrap(np.angle(curves[0][1]))
        for w, Z, name, style in curves:
            phase, near = np.angle(Z), np.interp(w, omega, predicted)
            above.loglog(w / HERTZ, np.abs(Z), linewidth=1.4, label=name, **style)
            whole = 2.0 * np.pi * np.round((near - phase) / (2.0 * np.pi))
            below.semilogx(w / HERTZ, np.degrees(phase + whole), linewidth=1.4, **style)
        above.legend(fontsize=SMALL, frameon=False)
        return figure


def tool_impedance(
    loop: Loop, *, at: ArrayLike | None = None, direction: ArrayLike, within: float = WITHIN
) -> ToolImpedance:
    """Impedance Z(s) and admittance Y(s) of a loop at its tool, about an equilibrium.

    Args:
        loop: The loop, of any law; its plant a `taut.RigidPlant`.
        at: (n,) joint positions [rad | m]; home if left out.
        direction: (3,) of a force, or (6,) of a force or a moment; any length, in world axes.
        within: [rad | m] distance from `at` within which the equilibrium is searched.

    Raises:
        RangeError: No equilibrium near `at`; a direction along which the tool cannot move.
        UsageError: A plant that takes no force at its tool; a reference that moves.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("panda")
        >>> ctrl = taut.compile(taut.laws.Impedance(K=(800.0, 30.0), zeta=0.7), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0)
        >>> tool = taut.analysis.tool_impedance(loop, direction=[0.0, 0.0, 1.0])
        >>> abs(tool.Z(0.01)).round(2).tolist(), abs(tool.specified_Z(0.01)).round(2).tolist()
        ([800.0], [800.0])
    """
    d = _unit_vector(direction)
    lin = linearise(loop, at=at, within=within)
    if not any(name.startswith("disturbance.wrench") for name in lin.inputs):
        raise UsageError(
            f"tool_impedance needs a plant that takes a force at its tool, taut.RigidPlant(...); got "
            f"{loop.plant.name}",
            name="loop",
        )
    payload = PayloadValues.of(subtree(loop.parameters, "model.payload"))
    x = Snapshot(loop.side.model, q=lin.point.q, v=np.zeros(loop.side.arm.n), payload=payload)
    axes, sizes, _ = np.linalg.svd(np.asarray(x.J(), dtype=np.float64), full_matrices=False)
    reach = axes[:, sizes > REACH * sizes[0]]
    if np.linalg.norm(reach.T @ d) < REACH:
        raise RangeError(
            f"arm '{loop.side.arm.name}' cannot move its tool along {np.round(d, 4).tolist()} at this pose; choose "
            "another direction or pose",
            name="direction",
        )
    law = loop.side.single_law.bound(subtree(loop.parameters, "law"))
    return ToolImpedance(loop=loop, lin=lin, direction=d, specified=_specified_admittance(law, x, reach))


def _unit_vector(direction: ArrayLike) -> Float64Array:
    """(6,) unit vector of a force or motion, (3,), or of a translation or rotation, (6,).

    Raises:
        ShapeError, RangeError: Another shape, both at once, or zero.
    """
    given = finite_array("direction", direction)
    if given.shape not in ((3,), (6,)):
        raise ShapeError(f"direction must have shape (3,) or (6,); got shape {given.shape}", name="direction")
    six = np.concatenate([given, np.zeros(6 - len(given))])
    if six[:3].any() == six[3:].any():
        raise RangeError(
            f"direction must be a translation or a rotation, not zero and not both; got {six.tolist()}",
            name="direction",
            value=six,
        )
    return six / float(np.linalg.norm(six))


# -------------------------------------------------------------------- the law's closed loop in continuous time


def _specified_admittance(law: Law, x: Snapshot, reach: Float64Array) -> Admittance | None:
    """The admittance at the arm's tool of a law's closed loop about a state, its reference at rest there.

    Law:          Y = J (M s^2 + kd s + kp + ki / s)^-1 J^T of GravityPID, with dg/dq beside kp of PID,
                  Y = J (M (s^2 + kd s + kp + ki / s))^-1 J^T of ComputedTorque,
                  Y = J (M s^2 + kd s + J^T K J)^-1 J^T of Stiffness,
                  Y = (s^2 + kd s + kp + ki / s)^-1 Lambda^-1 of TaskComputedTorque,
                  Y = (D s^2 + B s + K)^-1 of Impedance and Admittance, in the directions that the tool can move in

    None where there is no closed form: laws for drives that do not yield, force control, gains that are functions,
    sums with anything but friction compensation or feedforward, another tool than the arm's, an inertia D for a tool
    that would have to leave the motions it can make.

    Args:
        law: The law, with its gains as they are.
        x: The state, of the arm as the law knows it, in plain numbers.
        reach: (6, r) an orthonormal basis of the motions that the tool can make.
    """
    while isinstance(law, ViaJointSpace):  # the reference of the inner law rests, wherever the arm is
        if law.tool not in (None, x.arm.tool):
            return None
        law = law.inner
    if isinstance(law, Sum):
        parts = [part for part in law.parts.values() if not isinstance(part, (FrictionCompensation, FeedForward))]
        return _specified_admittance(parts[0], x, reach) if len(parts) == 1 else None
    if getattr(law, "tool", None) not in (None, x.arm.tool):
        return None
    J, M = np.asarray(x.J(), dtype=np.float64), np.asarray(x.M, dtype=np.float64)
    mobility = np.asarray(J @ np.linalg.solve(M, J.T))  # Lambda^-1, of less rank where the tool cannot move
    if isinstance(law, (PID, GravityPID, GravityCompensation, ComputedTorque, Stiffness)):
        kp, kd, ki = (_matrix(law, name, x.n) for name in ("kp", "kd", "ki"))
        if isinstance(law, Stiffness):
            if law.error != "decoupled" or callable(law.K):
                return None
            axes = law.space.at(x)
            kp = J.T @ np.asarray(axes.matrix_outwards(law.K.matrix(6)), dtype=np.float64) @ J
        elif isinstance(law, ComputedTorque):
            kp, kd, ki = M @ kp, M @ kd, M @ ki
        elif isinstance(law, PID):
            kp = kp + jacobian(lambda q: x.at(q, np.zeros(x.n)).g, x.q)
        return lambda s: np.asarray(J @ _over(_polynomial(s, M, kd, kp, ki), J.T), dtype=np.complex128)
    if isinstance(law, TaskComputedTorque):
        return _of_task(law, reach, mobility)
    apparent, D = felt_impedance(law, x), vars(bare(law)).get("D")
    if apparent is None:
        return None
    if D is not None and not all(_stays(C, reach) for C in (apparent.D, apparent.B, apparent.K)):
        return None
    D, B, K = (reach.T @ matrix @ reach for matrix in (apparent.D, apparent.B, apparent.K))
    return lambda s: np.asarray(reach @ _over(_polynomial(s, D, B, K), reach.T), dtype=np.complex128)


def _stays(gain: Float64Array, reach: Float64Array) -> bool:
    """A gain maps the motions that the tool can make to themselves."""
    out = gain @ reach
    return bool(np.abs(out - reach @ (reach.T @ out)).max() <= INSIDE * np.abs(gain).max())


def _polynomial(
    s: Complex, D: Float64Array, B: Float64Array, K: Float64Array, I: Float64Array | None = None
) -> Complex:
    """(k, n, n) D s^2 + B s + K + I / s."""
    s = s[:, np.newaxis, np.newaxis]
    out: Complex = D * s * s + B * s + K
    return out if I is None or not I.any() else out + I / s


def _over(polynomial: Complex, right: Float64Array) -> Complex:
    """(k, n, m) polynomial^-1 right."""
    return np.asarray(np.linalg.solve(polynomial, right.astype(np.complex128)), dtype=np.complex128)


def _matrix(law: Law, name: str, n: int) -> Float64Array:
    """(n, n) a gain, zero where a law has none."""
    gain = getattr(law, name, None)
    if not isinstance(gain, GainValue):
        return np.zeros((n, n))
    return np.asarray(gain.matrix(n), dtype=np.float64)


def _of_task(law: TaskComputedTorque, reach: Float64Array, mobility: Float64Array) -> Admittance | None:
    """Only where the errors are the tool's displacement: of all six directions, or with one number for all."""
    if law.dimensions != 6:
        return None
    gains = [_matrix(law, name, 6) for name in ("kp", "kd", "ki")]
    alike = all(np.array_equal(gain, gain[0, 0] * np.eye(6)) for gain in gains)
    if not alike and (law.error != "decoupled" or reach.shape[1] < 6):
        return None
    kp, kd, ki = gains
    return lambda s: _over(_polynomial(s, np.eye(6), kd, kp, ki), mobility)


# -------------------------------------------------------------------- a sine sweep in simulation


def _sine_sweep(
    loop: Loop, lin: LinearSystem, direction: Float64Array, omega: Float64Array, amplitudes: Float64Array
) -> Complex:
    """(k,) X / F along a direction, by runs of the loop under a force that is held from tick to tick.

    Args:
        loop: The loop.
        lin: Its linear model: the runs begin at its equilibrium, and have settled by its slowest pole.
        direction: (6,) unit vector.
        omega: (k,) [rad/s].
        amplitudes: (k,) of the force [N | N m].

    Raises:
        RangeError: A run that would be too long, or that diverged.
    """
    map_ = loop_map(loop)
    # The reference is held at the start of the model's own search, not where a law with a steady-state error rests.
    within = WITHIN + float(np.abs(lin.point.moved).max())
    point = rest_of(loop, map_, lin.point.q - lin.point.moved, within).point
    period = StepLoop(map_.period, (point.inputs, point.parameters, point.memory), engine=loop.engine)
    decaying = np.abs(lin.poles)[np.abs(lin.poles) < NO_DECAY]
    settling = math.ceil(math.log(TRANSIENT) / math.log(decaying.max(initial=0.5)))
    rest = map_.recorded(map_.derivative(point))
    out = np.zeros(len(omega), dtype=np.complex128)
    for i, (w, amplitude) in enumerate(zip(omega, amplitudes, strict=True)):
        count = settling + math.ceil(PERIODS * 2.0 * math.pi / (w * lin.period))
        if count > MAX_TICKS:
            raise RangeError(
                f"a sweep at {w:.3g} rad/s would take {count * lin.period:.3g} s of simulation; the maximum is "
                f"{MAX_TICKS * lin.period:g} s; ask for higher frequencies, or damp slow modes of the loop",
                name="omega",
                value=float(w),
            )
        wave = amplitude * np.exp(1j * w * lin.period * np.arange(count))
        memory, displacement = point.memory.copy(), np.zeros(count)
        for k in range(0, count, BLOCK):
            part = wave[k : k + BLOCK]
            rows, record = np.tile(point.inputs, (len(part), 1)), np.zeros((len(part), period.outputs.size))
            map_.inputs.views(rows)[WRENCH][...] = part.imag[:, np.newaxis] * direction
            if period.run(rows, point.parameters, memory, record) < len(part):
                raise RangeError(f"the run of the sweep at {w:.3g} rad/s diverged", name="omega", value=float(w))
            views = period.outputs.views(record)
            rotation = small_rotations(views["tip.R"] @ rest["tip.R"].T)
            displacement[k : k + BLOCK] = np.hstack([views["tip.p"] - rest["tip.p"], rotation]) @ direction
        late = wave[settling:]
        basis = np.stack([late.imag, late.real, np.ones(len(late))], axis=1)
        in_phase, quadrature, _ = np.linalg.lstsq(basis, displacement[settling:], rcond=None)[0]
        out[i] = in_phase + 1j * quadrature
    return out
