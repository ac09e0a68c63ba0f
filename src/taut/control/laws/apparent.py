"""What a law makes the tool feel like: the inertia, damping and stiffness of eq. 10.48, in numbers at one state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taut.base.types import Float64Array, Matrix6
from taut.control.combine import bare
from taut.control.gains import GainValue
from taut.control.law import Law
from taut.control.laws.admittance import Admittance
from taut.control.laws.impedance import Impedance
from taut.control.laws.task_space import TaskSpace, bounded_inertia, modal_damping
from taut.control.laws.wrappers import EnergyTank
from taut.maths.snapshot import Snapshot
from taut.trace.linalg import factor_spd

__all__ = ["FeltImpedance", "felt_impedance"]


@dataclass(frozen=True, kw_only=True, eq=False)
class FeltImpedance:
    """D x_ddot + B x_dot + K x = F_ext of the tool's deviation from its reference, in world axes."""

    D: Matrix6  # [kg, kg m^2]
    B: Matrix6  # [N s/m, N m s/rad]
    K: Matrix6  # [N/m, N m/rad]

    def response(
        self, t: Float64Array, F_ext: Float64Array, x0: Float64Array, v0: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """(k, 6) deviations and their rates under a wrench (k, 6): eq. 10.48 integrated by the midpoint rule.

        The wrench goes straight from each tick to the next.

        Args:
            t: (k,) [s].
            F_ext: (k, 6) wrench of the environment on the arm [N, N m].
            x0: (6,) deviation at the first tick [m, rad].
            v0: (6,) its rate [m/s, rad/s].
        """
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


def felt_impedance(law: Law, x: Snapshot) -> FeltImpedance | None:
    """What `Impedance` or `Admittance` makes the tool feel like about a state; None where a law promises nothing.

    Of the arm's own inertia, and of gains in axes that turn with the tool, it is what holds at this state.

    Args:
        law: The law.
        x: The state, in plain numbers.
    """
    if isinstance(law, EnergyTank) and law.stiffness is not None:
        return None
    law = bare(law)
    if isinstance(law, Impedance):
        if law.error != "decoupled":
            return None
        return _felt(law, x, law.K, law.B, law.D)
    if isinstance(law, Admittance):
        return _felt(law, x, law.K, law.B, law.D)
    return None


def _felt(
    law: Impedance | Admittance, x: Snapshot, K: GainValue, B: GainValue | None, D: GainValue | None
) -> FeltImpedance:
    axes = TaskSpace.of(law).at(x)
    stiffness = K.matrix(6)
    if D is not None:
        inertia = D.matrix(6)
    else:
        assert isinstance(law, Impedance)  # the other one always has D
        inertia = axes.matrix_inwards(bounded_inertia(x, axes.J).Lambda)
    if B is not None:
        damping = B.matrix(6)
    else:
        factors, zeta = factor_spd(inertia), law.zeta.as_array()
        damping = np.column_stack([modal_damping(factors, stiffness, zeta, axis) for axis in np.eye(6)])
    world = [np.asarray(axes.matrix_outwards(C), dtype=np.float64) for C in (inertia, damping, stiffness)]
    return FeltImpedance(D=world[0], B=world[1], K=world[2])
