"""Impedance and admittance of a loop at its tool: specified by the law, and predicted by the linear model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.checks import finite_array, require_range
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.paths import subtree
from taut.base.result import Cell, Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.control.combine import Sum, bare, title
from taut.control.gains import GainValue
from taut.control.law import Law
from taut.control.laws.impedance import Stiffness
from taut.control.laws.joint import (
    PID,
    ComputedTorque,
    FeedForward,
    FrictionCompensation,
    GravityCompensation,
    GravityPID,
)
from taut.control.laws.task import TaskComputedTorque
from taut.control.laws.via_joint_space import ViaJointSpace
from taut.linear.linear_system import Complex, LinearSystem
from taut.linear.linearise import WITHIN, linearise
from taut.loop import Loop
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot
from taut.trace.derivative import jacobian

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ToolImpedance", "tool_impedance"]

HERTZ: Final = 2.0 * np.pi
REACH: Final = 1e-6  # of the Jacobian: below it the tool cannot move in a direction
NO_MOTION: Final = 1e-12  # of the largest response: rounding
INSIDE: Final = 1e-9  # of the largest entry

HIGHEST: Final = 0.999  # of half the rate, up to which specified and predicted are compared
FIGURE_HEIGHT: Final = 4.6  # [inch]
DECADES: Final = 4.0  # of a figure, below half the rate
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
    Quantisation and noise are in neither.

    Args:
        loop: The loop.
        lin: Its linear model.
        direction: (6,) unit vector in world axes: a force, or a moment.
        specified: The law's closed loop in continuous time; None where it has no closed form.

    References:
        Section 10.5. Hogan, Impedance control, J. Dynamic Systems, Measurement and Control 107 (1985).
    """

    loop: Loop
    lin: LinearSystem
    direction: Float64Array
    specified: _ClosedForm | None

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
            RangeError: A frequency that is not above zero.
        """
        if self.specified is None:
            raise UsageError(
                f"{title(self.loop.side.law)} specifies no impedance at the arm's tool in closed form; use Z",
                name="specified",
            )
        w = np.atleast_1d(finite_array("omega", omega, unit="rad/s"))
        require_range("omega", w, above=0.0, unit="rad/s")
        return _inverse(self.specified.admittance(w, self.direction))

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

    def plot(self) -> Figure:
        """Bode diagram of Z: specified and predicted."""
        from matplotlib.figure import Figure

        from taut.base.plot_style import DASHED, INK, SMALL, WIDTH, colour, prepared

        figure = Figure(figsize=(WIDTH, FIGURE_HEIGHT), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True)
        prepared(above, "impedance at the tool, Z = F / X", f"|Z| [{self.unit}]")
        prepared(below, "", "phase of Z [deg]", "frequency [Hz]")
        omega = HIGHEST * np.pi / self.lin.period * np.logspace(-DECADES, 0.0, CURVE_POINTS)
        curves: list[tuple[str, Complex, str, Any]] = [
            ("predicted, of the sampled loop", self.Z(omega), colour(0), "-")
        ]
        if self.specified is not None:
            curves.append(("specified", self.specified_Z(omega), INK, DASHED))
        for name, Z, ink, style in curves:
            above.loglog(omega / HERTZ, np.abs(Z), linewidth=1.4, label=name, color=ink, linestyle=style)
            phase = np.degrees(np.unwrap(np.angle(Z)))
            below.semilogx(omega / HERTZ, phase, linewidth=1.4, color=ink, linestyle=style)
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
    return ToolImpedance(loop=loop, lin=lin, direction=d, specified=_closed_form(law, x, reach))


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


@dataclass(frozen=True, kw_only=True, eq=False)
class _ClosedForm:
    """outwards (inertia s^2 + damping s + stiffness + integral / s)^-1 outwards^T of some coordinates of the tool."""

    outwards: Float64Array
    inertia: Float64Array
    damping: Float64Array
    stiffness: Float64Array
    integral: Float64Array | float = 0.0

    def admittance(self, omega: Float64Array, direction: Float64Array) -> Complex:
        """(k,) the response X / F along a direction at (k,) frequencies [rad/s]."""
        s = 1j * omega[:, np.newaxis, np.newaxis]
        polynomial = self.inertia * s * s + self.damping * s + self.stiffness + self.integral / s
        way = self.outwards.T @ direction
        return np.asarray(np.linalg.solve(polynomial, way[:, np.newaxis].astype(complex))[:, :, 0] @ way)


def _closed_form(law: Law, x: Snapshot, reach: Float64Array) -> _ClosedForm | None:
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
    while isinstance(law, ViaJointSpace) and law.tool in (None, x.arm.tool):  # the inner law's reference rests
        law = law.inner
    if isinstance(law, Sum):
        parts = [part for part in law.parts.values() if not isinstance(part, (FrictionCompensation, FeedForward))]
        return _closed_form(parts[0], x, reach) if len(parts) == 1 else None
    if getattr(law, "tool", None) not in (None, x.arm.tool):
        return None
    if isinstance(law, TaskComputedTorque):
        return _of_task(law, x, reach)
    if isinstance(law, (PID, GravityPID, GravityCompensation, ComputedTorque, Stiffness)):
        return _of_joints(law, x)
    apparent = law.apparent_impedance(x)
    if apparent is None:
        return None
    matrices = apparent.D, apparent.B, apparent.K
    if vars(bare(law)).get("D") is not None and not all(_stays(C, reach) for C in matrices):
        return None
    D, B, K = (reach.T @ C @ reach for C in matrices)
    return _ClosedForm(outwards=reach, inertia=D, damping=B, stiffness=K)


def _of_joints(law: Law, x: Snapshot) -> _ClosedForm | None:
    J, M = np.asarray(x.J(), dtype=np.float64), np.asarray(x.M, dtype=np.float64)
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
    return _ClosedForm(outwards=J, inertia=M, damping=kd, stiffness=kp, integral=ki)


def _of_task(law: TaskComputedTorque, x: Snapshot, reach: Float64Array) -> _ClosedForm | None:
    """Only where the errors are the tool's displacement: of all six directions, or with one number for all."""
    gains = [_matrix(law, name, 6) for name in ("kp", "kd", "ki")]
    alike = all(np.array_equal(gain, gain[0, 0] * np.eye(6)) for gain in gains)
    if law.dimensions != 6 or (not alike and (law.error != "decoupled" or reach.shape[1] < 6)):
        return None
    rows = reach.T @ np.asarray(x.J(), dtype=np.float64)
    Lambda = np.linalg.inv(rows @ np.linalg.solve(np.asarray(x.M, dtype=np.float64), rows.T))
    kp, kd, ki = (Lambda @ reach.T @ gain @ reach for gain in gains)
    return _ClosedForm(outwards=reach, inertia=Lambda, damping=kd, stiffness=kp, integral=ki)


def _stays(gain: Float64Array, reach: Float64Array) -> bool:
    """A gain maps the motions that the tool can make to themselves."""
    out = gain @ reach
    return bool(np.abs(out - reach @ (reach.T @ out)).max() <= INSIDE * np.abs(gain).max())


def _matrix(law: Law, name: str, n: int) -> Float64Array:
    """(n, n) a gain, zero where a law has none."""
    gain = getattr(law, name, None)
    return np.asarray(gain.matrix(n), dtype=np.float64) if isinstance(gain, GainValue) else np.zeros((n, n))
