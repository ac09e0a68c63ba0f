"""What a loop feels like at its tool: impedance and admittance, asked, predicted and measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.analysis.sweep import swept
from taut.analysis.tool.environment import TipEnvironment, environment_at, inverse, joined
from taut.analysis.tool.promised import AskedAdmittance, asked_admittance
from taut.analysis.tool.stiffness import direction_of
from taut.base.checks import finite_array, positive_scalar
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.control.describe import title
from taut.linear.frequency import Complex, checked_frequencies
from taut.linear.linear_loop import LinearLoop
from taut.linear.linearise import WITHIN, linearise
from taut.loop import Loop
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["TipMeasurement", "TipRanking", "TipResponse", "rank_tips", "tip_impedance"]

REACH: Final = 1e-6  # of the Jacobian: below it a direction cannot be moved in
SMALL: Final = 1e-4  # [m | rad] that a sweep moves the tool by
NOTHING: Final = 1e-12  # of the largest response: rounding
SLOW: Final = 1e-5  # of half the rate
MOST: Final = 0.999  # of half the rate
HERTZ: Final = 2.0 * np.pi


@dataclass(frozen=True, kw_only=True, eq=False)
class TipMeasurement:
    """A sine sweep in simulation: the tool's answer X / F along a direction."""

    omega: Float64Array  # (k,) [rad/s]
    Y: Complex  # (k,) [m/N | rad/(N m)]

    @property
    def Z(self) -> Complex:
        """(k,) F / X."""
        return inverse(self.Y)


@dataclass(frozen=True, kw_only=True, eq=False)
class TipResponse:
    """How a loop answers a force at its tool along one direction, with the tool free in all others.

    Law:          X = Y F, F = Z X, with Y = d^T Y_tool d of the six by six response of the tool and Z = 1 / Y

    Asked is what the law's closed loop is in continuous time: of `Impedance` and `Admittance` D s^2 + B s + K, of
    ComputedTorque M (s^2 + kd s + kp + ki / s) through J, and so on; drives, filters and friction are not in it.
    Predicted is the sampled loop as it is simulated, exactly: with hold, delay, filters, drives, integrator. Measured
    is a sine sweep in simulation, on request. Steps of encoders and amplifiers, and noise, are in neither.

    Args:
        loop: The loop.
        lin: Its linear model.
        direction: (6,) unit vector in world axes: a force, or a moment.
        asked: s (k,) to (k, 6, 6) the response that the law promises; None where it promises none in closed form.
        reach: (6, r) the motions of the tool that the arm can make there.

    References:
        Section 10.5. Hogan, Impedance control, J. Dynamic Systems, Measurement and Control 107 (1985).
    """

    loop: Loop
    lin: LinearLoop
    direction: Float64Array
    asked: AskedAdmittance | None
    reach: Float64Array

    @property
    def unit(self) -> str:
        """Of Z."""
        return "N/m" if self.direction[:3].any() else "N m/rad"

    def Y(self, omega: ArrayLike) -> Complex:
        """(k,) predicted admittance X / F [m/N | rad/(N m)].

        Raises:
            RangeError: A frequency beyond half the rate, or negative.
        """
        w, d = checked_frequencies(omega, self.lin.dt), self.direction
        B, C, D = self._tool
        return self.lin.response(w, (B @ d)[:, np.newaxis], (d @ C)[np.newaxis], (d @ D @ d).reshape(1, 1))[:, 0, 0]

    def Z(self, omega: ArrayLike) -> Complex:
        """(k,) predicted impedance F / X [N/m | N m/rad]; infinite where the tool does not move, as of stiff drives.

        Raises:
            RangeError: A frequency beyond half the rate, or negative.
        """
        Y = self.Y(omega)
        size = float(np.abs(self.Y(np.geomspace(SLOW, 1.0, 5)[:-1] * np.pi / self.lin.dt)).max())
        return inverse(np.where(np.abs(Y) < NOTHING * size, 0.0, Y))

    def matrix(self, omega: ArrayLike) -> Complex:
        """(k, 6, 6) predicted response of the tool, position first, to a wrench, force first; in world axes."""
        return self.lin.response(checked_frequencies(omega, self.lin.dt), *self._tool)

    @property
    def _tool(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """B (n, 6) of a wrench, C (6, n) of the tool's position and rotation, D (6, 6)."""
        lin = self.lin
        rows = [*lin.rows("tip.p"), *lin.rows("tip.rotation")]
        columns = list(lin.columns("disturbance.wrench"))
        return lin.B[:, columns], lin.C[rows], lin.D[np.ix_(rows, columns)]

    def asked_Y(self, omega: ArrayLike) -> Complex:
        """(k,) what the law promises.

        Raises:
            UsageError: It promises nothing.
            RangeError: A frequency that is not above zero, or beyond half the rate.
        """
        if self.asked is None:
            raise UsageError(
                f"{title(self.loop.side.law)} promises no impedance at the arm's tool in closed form; tip.Z is what "
                "it has",
                name="asked",
            )
        w = checked_frequencies(omega, self.lin.dt)
        if (w == 0.0).any():
            raise RangeError("what is asked needs frequencies above zero; got 0", name="omega", value=0.0, rule="> 0")
        return np.asarray(
            self.asked(np.asarray(1j * w, dtype=np.complex128)) @ self.direction @ self.direction, dtype=np.complex128
        )

    def asked_Z(self, omega: ArrayLike) -> Complex:
        """(k,) 1 / asked_Y."""
        return inverse(self.asked_Y(omega))

    def measure(self, omega: ArrayLike, *, amplitude: float | None = None) -> TipMeasurement:
        """A sine sweep in simulation, one run for each frequency: the tool's motion fitted over whole periods.

        Args:
            omega: (k,) or one [rad/s], above zero and below half the rate.
            amplitude: Of the force [N | N m]; what moves the tool by 0.1 mm or 0.1 mrad if left out, and 1 where it
                does not move.

        Raises:
            RangeError: A frequency that has no meaning; an unstable loop, whose answer grows without end.
        """
        w = checked_frequencies(omega, self.lin.dt)
        if (w == 0.0).any():
            raise RangeError("a sweep needs frequencies above zero; got 0", name="omega", value=0.0, rule="> 0")
        if (w > MOST * np.pi / self.lin.dt).any():
            raise RangeError(
                f"a sweep needs frequencies below {MOST * np.pi / self.lin.dt:.6g} rad/s: at half the rate all ticks "
                f"may fall on zeros of the sine; got {w.max():g}",
                name="omega",
                value=float(w.max()),
            )
        if not self.lin.stable:
            raise RangeError(
                f"the loop is unstable ({self.lin.why}), so that no sine settles; measure a loop that is stable",
                name="loop",
                value=self.lin.radius,
            )
        if amplitude is None:
            Z = np.abs(self.Z(w))
            sizes = np.where(np.isfinite(Z), SMALL * Z, 1.0)
        else:
            sizes = np.full(len(w), positive_scalar("amplitude", amplitude, unit="N | N m"))
        return TipMeasurement(omega=w, Y=swept(self.loop, self.lin, self.direction, w, sizes))

    def with_environment(
        self, *, mass: float = 0.0, damping: ArrayLike = 0.0, stiffness: ArrayLike = 0.0, within: float = WITHIN
    ) -> LinearLoop:
        """The linear model of the loop with something at its tool: its poles are those of both together.

        The environment is a `taut.environments.Handle` where it has mass, else a spring and a damper to where the
        tool is;
        the plant simulates it in each of its steps. A handle's mass has a stiff grip, see there.

        Args:
            mass: [kg].
            damping: A number or (3,) in world axes [N s/m]; without mass also (linear, angular) [N s/m, N m s/rad],
                six or (6, 6).
            stiffness: Likewise [N/m, N m/rad].
            within: [rad | m] how far from here it may rest.

        Raises:
            RangeError: Numbers that have no meaning, or no equilibrium.
        """
        more = environment_at(self.loop, self.lin.q, mass, damping, stiffness)
        within = positive_scalar("within", within, unit="rad | m") + float(np.abs(self.lin.moved).max())
        return linearise(joined(self.loop, more), at=self.lin.q - self.lin.moved, within=within)

    def plot(self, measured: TipMeasurement | None = None) -> Figure:
        """Bode of Z: what is asked, what is predicted and, where there was a sweep, what was measured."""
        from taut.analysis.tool.plot import plot

        return plot(self, measured)

    def __str__(self) -> str:
        omega = HERTZ * np.array([0.1, 1.0, 3.0, 10.0, 30.0])
        omega = omega[omega < np.pi / self.lin.dt]
        predicted = np.abs(self.Z(omega))
        asked = None if self.asked is None else np.abs(self.asked_Z(omega))
        lines = [f"   Hz     |Z| [{self.unit}]" + ("" if asked is None else "   asked        off")]
        for k, w in enumerate(omega):
            line = f"{w / HERTZ:>5.3g}     {predicted[k]:<12.5g}"
            if asked is not None:
                line += f" {asked[k]:<12.5g} {100.0 * (predicted[k] / asked[k] - 1.0):+.2f} %"
            lines.append(line)
        return "\n".join(lines)


def tip_impedance(
    loop: Loop, *, at: ArrayLike | None = None, direction: ArrayLike, within: float = WITHIN
) -> TipResponse:
    """How a loop answers a force at its tool, about an equilibrium: its impedance Z(s) and admittance Y(s).

    Args:
        loop: The loop, of any law; its plant a `taut.RigidPlant`.
        at: (n,) joint positions [rad | m]; home if left out.
        direction: (3,) of a force, or (6,) of a force or a moment; any length, in world axes.
        within: [rad | m] how far from `at` the equilibrium may be.

    Raises:
        RangeError: No equilibrium near `at`; a direction that the tool cannot be moved along.
        UsageError: A plant that takes no force at its tool; a reference that moves.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("panda")
        >>> ctrl = taut.compile(taut.laws.Impedance(K=(800.0, 30.0), zeta=0.7), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0)
        >>> tip = taut.analysis.tip_impedance(loop, direction=[0.0, 0.0, 1.0])
        >>> abs(tip.Z(0.01)).round(2).tolist(), abs(tip.asked_Z(0.01)).round(2).tolist()
        ([800.0], [800.0])
    """
    way = direction_of(direction)
    lin = linearise(loop, at=at, within=within)
    if not any(name.startswith("disturbance.wrench") for name in lin.inputs):
        raise UsageError(
            f"tip_impedance needs a plant that takes a force at its tool, taut.RigidPlant(...); got "
            f"{loop.plant.name}",
            name="loop",
        )
    x = Snapshot(loop.side.model, q=lin.q, v=np.zeros(len(lin.q)), payload=_payload(loop))
    J = np.asarray(x.J(), dtype=np.float64)
    axes, sizes, _ = np.linalg.svd(J, full_matrices=False)
    reach = axes[:, sizes > REACH * sizes[0]]
    if np.linalg.norm(reach.T @ way) < REACH:
        raise RangeError(
            f"arm '{loop.side.arm.name}' cannot move its tool along {np.round(way, 4).tolist()} at this pose; choose "
            "another direction or pose",
            name="direction",
        )
    law = loop.side.single_law.bound(subtree(loop.parameters, "law"))
    return TipResponse(loop=loop, lin=lin, direction=way, asked=asked_admittance(law, x, reach), reach=reach)


def _payload(loop: Loop) -> PayloadValues:
    return PayloadValues.of(subtree(loop.parameters, "model.payload"))


# -------------------------------------------------------------------- laws side by side


@dataclass(frozen=True, kw_only=True, eq=False)
class TipRanking:
    """Loops by how hard their tool is to move, the hardest first; print it for a table.

    Args:
        names: Of the loops, in that order.
        omega: (k,) [rad/s].
        Z: (loops, k) predicted impedances [N/m | N m/rad].
        unit: Of Z.
    """

    names: tuple[str, ...]
    omega: Float64Array
    Z: Complex
    unit: str

    def __str__(self) -> str:
        width = max(len(name) for name in self.names)
        hertz = "".join(f"{w / HERTZ:>11.3g} Hz" for w in self.omega)
        lines = [f"{'|Z| [' + self.unit + ']':<{width}}{hertz}"]
        lines += [
            f"{name:<{width}}" + "".join(f"{abs(z):>14.4g}" for z in row)
            for name, row in zip(self.names, self.Z, strict=True)
        ]
        return "\n".join(lines)


def rank_tips(
    loops: Mapping[str, Loop | TipEnvironment],
    *,
    at: ArrayLike | None = None,
    direction: ArrayLike,
    omega: ArrayLike = (HERTZ,),
    within: float = WITHIN,
) -> TipRanking:
    """Which laws make the tool hard to move, and which easy: the size of Z along a direction, the highest first.

    Motion control is high and force control low: Delta X = Y Delta F, section 10.5.

    Args:
        loops: Loops by name, all with a reference that stays; and environments to compare them with.
        at: (n,) joint positions [rad | m]; home if left out.
        direction: (3,) of a force, or (6,) of a force or a moment, in world axes.
        omega: (k,) [rad/s]; they are ranked by the first.
        within: [rad | m] how far from `at` the equilibria may be.

    Raises:
        UsageError: No loop.
        ShapeError: No frequencies.
        RangeError: As of `tip_impedance`.
    """
    if not isinstance(loops, Mapping) or not loops:
        raise UsageError("rank_tips takes loops by name: {'motion': loop, ...}", name="loops")
    w = np.atleast_1d(finite_array("omega", omega, unit="rad/s"))
    if w.ndim != 1 or not len(w):
        raise ShapeError(f"omega must be one frequency or (k,) of them [rad/s]; got shape {w.shape}", name="omega")
    unit = "N/m" if direction_of(direction)[:3].any() else "N m/rad"
    Z: dict[str, Complex] = {}
    for name, each in loops.items():
        if isinstance(each, TipEnvironment):
            Z[name] = each.Z(w)
        else:
            Z[name] = tip_impedance(each, at=at, direction=direction, within=within).Z(w)
    names = tuple(sorted(Z, key=lambda name: -abs(Z[name][0])))
    return TipRanking(names=names, omega=w, Z=np.stack([Z[name] for name in names]), unit=unit)
