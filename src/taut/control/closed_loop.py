"""The error dynamics, and the impedance of the tool, that a law states at a pose: matrices."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Float64Array, Matrix6
from taut.maths.snapshot import Snapshot

if TYPE_CHECKING:
    from taut.control.law import Law

MIN_TOOL_MOBILITY: Final = (
    1e-2  # [-] of the largest singular value of J: with less the tool hardly moves in a direction
)
MATRIX_ROUNDING: Final = 1e-12  # [-] of the largest entry of a matrix


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedGains:
    """Matrices of a closed loop with placed poles: K and Ki, (k,) or (k, k); D, of n joints where joints are damped.

    `zeta` is the damping ratio of every mode, 1 for single poles; `force` the pole of the force [1/s], or None.
    """

    K: Float64Array
    D: Float64Array
    Ki: Float64Array
    zeta: float = 1.0
    force: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoop:
    """Closed loop of a law about rest, in the coordinates of its error: the matrices K, D and Ki are its gains.

    Closed loop:  inertia e_ddot + D e_dot + K e + Ki int(e) = 0,  e_dot = J v_e
                  with single poles  inertia e_dot + D e = 0

    Args:
        x: The arm at rest.
        J: (k, n) rate of the error over the joint velocities.
        names: (k,) of the coordinates: joints, or axes of the tool.
        units: (k,) "rad" or "m".
        gains: The law with other gains.
        inertia: (k, k) that the gains meet; 1 for accelerations or velocities; None for (J M^-1 J^T)^-1.
        stiffness: Whether K is a stiffness [N m/rad | N/m], and may be specified.
        single_pole: One pole in each direction: "never"; "possible" where K may be zero; "always" without K.
        decentralised: Whether gains are one number for each joint, unless matrices are asked for.
        damps_joints: Whether D is that of the joints, with M for the inertia and J^T K J for K.
        contact: (k, k) of a law of force: K is this times the stiffness of the contact.
        alone: The part of the law that moves the arm off contact; None for all of it.
        force: (kfp, kfi), (m, m) each, of a law that feeds back the force against m constraint rows.
    """

    x: Snapshot
    J: Float64Array
    names: Sequence[str]
    units: Sequence[str]
    gains: Callable[[PlacedGains], Law]
    inertia: Float64Array | None = None
    stiffness: bool = False
    single_pole: Literal["never", "possible", "always"] = "never"
    decentralised: bool = False
    damps_joints: bool = False
    contact: Float64Array | None = None
    alone: Law | None = None
    force: tuple[Float64Array, Float64Array] | None = None

    @classmethod
    def of_joints(cls, x: Snapshot, gains: Callable[[PlacedGains], Law], *, inertia: Any = None,
                  **options: Any) -> ClosedLoop:  # fmt: skip
        """That of a law of joints; its inertia is the identity if none is given."""
        M = np.eye(x.n) if inertia is None else np.asarray(inertia, dtype=np.float64)
        return cls(
            x=x, J=np.eye(x.n), names=x.arm.joint_names, units=x.arm.units, gains=gains, inertia=M, **options
        )  # fmt: skip

    def held_by(self, law: Callable[[Law, PlacedGains], Law], **changed: Any) -> ClosedLoop:
        """The same closed loop of a law around it, whose gains `law` sets; `changed` are fields that differ."""
        return dataclasses.replace(self, gains=lambda placed: law(self.gains(placed), placed), **changed)

    @cached_property
    def basis(self) -> Float64Array:
        """(k, r) orthonormal directions of the error that the arm can move in; RangeError near singularities."""
        moving = np.flatnonzero((np.abs(self.J) > MATRIX_ROUNDING).any(axis=1))
        left, sizes, _ = np.linalg.svd(self.J[moving])
        r = min(len(moving), self.x.n)
        if sizes[r - 1] < MIN_TOOL_MOBILITY * sizes[0]:
            axis = self.names[int(moving[np.argmax(np.abs(left[:, r - 1]))])]
            fraction = sizes[r - 1] / sizes[0]
            raise RangeError(
                f"'{self.x.arm.name}' is singular at q = {np.round(self.x.q, 4).tolist()}, or nearly so: its "
                f"tool can hardly move along {axis}, with {fraction:.2g} of the largest singular value; "
                "choose another pose",
                name="at",
                value=float(fraction),
                rule=f">= {MIN_TOOL_MOBILITY:g} of the largest singular value",
            )
        basis = np.zeros((len(self.J), r))
        basis[moving] = np.eye(r) if r == len(moving) else left[:, :r]
        return basis

    @cached_property
    def rows(self) -> Float64Array:
        """(r, n) motion along the directions per joint motion."""
        return np.asarray(self.basis.T @ self.J)

    @cached_property
    def mobility(self) -> Float64Array:
        """(n, r) joint velocities of a unit force along each direction after a unit of time."""
        return np.linalg.solve(np.asarray(self.x.M), self.rows.T)

    @cached_property
    def motions(self) -> Float64Array:
        """(n, r) joint motions along one direction each, dynamically consistent: no free motion takes part."""
        return np.asarray(self.mobility @ np.linalg.inv(self.rows @ self.mobility))

    @cached_property
    def apparent(self) -> Float64Array:
        """(r, r) inertia along the directions."""
        own = np.linalg.inv(self.rows @ self.mobility) if self.inertia is None else self.inside(self.inertia)
        return np.asarray(0.5 * (own + own.T))

    def inside(self, C: Float64Array) -> Float64Array:
        """(r, r) a symmetric matrix (k, k) along the directions."""
        return np.asarray(self.basis.T @ C @ self.basis)

    def outside(self, C: Float64Array) -> Float64Array:
        """(k, k) of a matrix (r, r) along the directions; where the arm never moves, the mean of the others."""
        k, r = self.basis.shape
        rest = np.eye(k) - self.basis @ self.basis.T
        X = self.basis @ C @ self.basis.T + (float(np.trace(C)) / r) * rest
        X = np.where(np.abs(X) < MATRIX_ROUNDING * np.abs(X).max(), 0.0, X)
        return np.asarray(0.5 * (X + X.T))

    @property
    def axes(self) -> list[int]:
        """(r,) the coordinate that each direction moves most."""
        return [int(i) for i in np.abs(self.basis).argmax(axis=0)]

    @property
    def directions(self) -> list[str]:
        """(r,) a name for each direction."""
        names = [self.names[i] for i in self.axes]
        return [name if names.count(name) == 1 else f"{name} ({names[: k + 1].count(name)})"
                for k, name in enumerate(names)]  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class ApparentImpedance:
    """Impedance of the tool: D x_ddot + B x_dot + K x = F_ext of its deviation, in world axes; eq. 10.48."""

    D: Matrix6  # [kg, kg m^2]
    B: Matrix6  # [N s/m, N m s/rad]
    K: Matrix6  # [N/m, N m/rad]

    def response(
        self, t: Float64Array, F_ext: Float64Array, x0: Float64Array, v0: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Deviations and rates, (k, 6), under F_ext (k, 6), linear between ticks: eq. 10.48, midpoint rule."""
        x, v = np.zeros((len(t), 6)), np.zeros((len(t), 6))
        x[0], v[0] = x0, v0
        solvers: dict[float, Float64Array] = {}
        for i, step in enumerate(np.diff(t)):
            h = float(round(step, 12))
            if h not in solvers:
                solvers[h] = np.asarray(np.linalg.inv(self.D + 0.5 * h * self.B + 0.25 * h * h * self.K), np.float64)
            middle = 0.5 * (F_ext[i] + F_ext[i + 1])
            mean = solvers[h] @ (self.D @ v[i] + 0.5 * h * (middle - self.K @ x[i]))
            x[i + 1], v[i + 1] = x[i] + h * mean, 2.0 * mean - v[i]
        return x, v
