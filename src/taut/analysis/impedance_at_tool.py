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
from taut.control.closed_loop import ApparentImpedance
from taut.control.combine import bare, title
from taut.control.law import Law
from taut.linear.linear_system import Complex, LinearSystem
from taut.linear.linearise import WITHIN, linearise
from taut.loop import Loop
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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

    Specified is D s^2 + B s + K of `Impedance` and `Admittance`, without drives, filters and friction. Predicted is
    the sampled loop, exactly, with zero-order hold, delay, filters, drives and integrator. Neither has quantisation
    or noise.

    Args:
        lin: The linear model of the loop.
        direction: (6,) unit vector in world axes: a force, or a moment.
        specified: What `Impedance` or `Admittance` specifies, in the motions that the tool can make; None of others.

    References:
        Section 10.5. Hogan, Impedance control, J. Dynamic Systems, Measurement and Control 107 (1985).
    """

    loop: Loop
    lin: LinearSystem
    direction: Float64Array
    specified: ApparentImpedance | None

    @property
    def unit(self) -> str:
        """Of Z."""
        return "N/m" if self.direction[:3].any() else "N m/rad"

    def Y(self, omega: ArrayLike) -> Complex:
        """(k,) predicted admittance X / F [m/N | rad/(N m)]; RangeError above half the rate."""
        lin, d = self.lin, self.direction
        rows = [*lin.rows("tip.p"), *lin.rows("tip.rotation")]
        columns = lin.columns("disturbance.wrench")
        B, C, D = lin.B[:, columns] @ d, d @ lin.C[rows], d @ lin.D[np.ix_(rows, columns)] @ d
        along = LinearSystem(A=lin.A, B=B[:, np.newaxis], C=C[np.newaxis], D=[[float(D)]], dt=lin.dt)
        return along.frequency_response(omega, input="u[0]", output="y[0]")

    def Z(self, omega: ArrayLike) -> Complex:
        """(k,) predicted impedance F / X [N/m | N m/rad]; infinite where the tool does not move, as of stiff drives.

        Raises:
            RangeError: A negative frequency, or one above half the rate.
        """
        Y = self.Y(omega)
        size = float(np.abs(self.Y(np.geomspace(1e-5, 1.0, 5)[:-1] * np.pi / self.lin.period)).max())
        return _inverse(np.where(np.abs(Y) < NO_MOTION * size, 0.0, Y))

    def specified_Z(self, omega: ArrayLike) -> Complex:
        """(k,) impedance that the law specifies: D s^2 + B s + K, of the tool free in all other directions.

        Raises:
            UsageError: The law specifies none.
            RangeError: A frequency that is not above zero.
        """
        if self.specified is None:
            raise UsageError(
                f"{title(self.loop.side.law)} specifies no impedance at the arm's tool; use Z",
                name="specified",
            )
        w = np.atleast_1d(finite_array("omega", omega, unit="rad/s"))
        require_range("omega", w, above=0.0, unit="rad/s")
        s, law = 1j * w[:, np.newaxis, np.newaxis], self.specified
        Y = np.linalg.pinv(law.D * s * s + law.B * s + law.K, rcond=INSIDE) @ self.direction @ self.direction
        return _inverse(np.asarray(Y, dtype=np.complex128))

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
        RangeError: No equilibrium near `at`; a direction in which the tool cannot move.
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
    return ToolImpedance(loop=loop, lin=lin, direction=d, specified=_specified(law, x, reach))


def _unit_vector(direction: ArrayLike) -> Float64Array:
    """(6,) unit vector of a force or motion (3,), or of a translation or a rotation (6,), not both at once."""
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


def _specified(law: Law, x: Snapshot, reach: Float64Array) -> ApparentImpedance | None:
    """Impedance that a law specifies for the arm's tool on an orthonormal basis (6, r) of its motions.

    None for another tool than the arm's, or an inertia D whose motion would leave that basis.
    """
    if getattr(law, "tool", None) not in (None, x.arm.tool):
        return None
    apparent = law.apparent_impedance(x)
    if apparent is None:
        return None
    matrices = apparent.D, apparent.B, apparent.K
    if vars(bare(law)).get("D") is not None and not all(_stays(C, reach) for C in matrices):
        return None
    D, B, K = (reach @ reach.T @ C @ reach @ reach.T for C in matrices)
    return ApparentImpedance(D=D, B=B, K=K)


def _stays(gain: Float64Array, reach: Float64Array) -> bool:
    """A gain maps the motions that the tool can make to themselves."""
    out = gain @ reach
    return bool(np.abs(out - reach @ (reach.T @ out)).max() <= INSIDE * np.abs(gain).max())
