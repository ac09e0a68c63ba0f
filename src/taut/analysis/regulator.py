"""Linear-quadratic regulator of an arm at a pose, by the exact model of its sampled loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.analysis.design.design import pose_of
from taut.arm.description import Arm
from taut.base.checks import instance_of, rate_in_hertz
from taut.base.errors import RangeError, UsageError
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.control.laws.joint import StateFeedback
from taut.controller.compile import compile
from taut.linear.joint_loop import joint_matrix
from taut.linear.linear_system import Complex, LinearSystem, names
from taut.linear.linearise import linearise
from taut.loop import Loop
from taut.maths.model import Adds
from taut.maths.snapshot import snapshot
from taut.plant.rigid import RigidPlant

INSIDE: Final = 1e-9  # [-] below one, of the modulus of a pole that is within the unit circle


@dataclass(frozen=True, kw_only=True, eq=False)
class Lqr(Result):
    """A linear-quadratic regulator at a pose."""

    law: StateFeedback  # to compile and run
    K: Float64Array  # (n, 2 n) gains of positions, then of velocities: tau = tau_0 - K (x - x_0)
    P: Float64Array  # (2 n, 2 n) the cost that is left from a state, x^T P x
    system: LinearSystem  # the closed loop from tick to tick
    arm: str  # its name
    q: Float64Array  # (n,) the pose [rad | m]

    @property
    def poles(self) -> Complex:
        """(2 n,) poles of the closed loop in z [-]."""
        return self.system.poles

    def content(self) -> Content:
        """The modes of the closed loop."""
        rows = [(abs(mode.pole), mode.omega_n, mode.zeta) for mode in self.system.modes]
        table = Table(title="modes", columns=("|z| [-]", "omega_n [rad/s]", "zeta [-]"), rows=rows)
        return Content(
            title=f"linear-quadratic regulator of {self.arm} at {1.0 / self.system.period:g} Hz",
            summary=[f"pose [rad | m]: {np.round(self.q, 4).tolist()}"],
            tables=[table],
        )


def lqr(
    arm: Arm,
    *,
    Q: ArrayLike,
    R: ArrayLike,
    at: ArrayLike | None = None,
    rate: float = 1000.0,
    plant: RigidPlant | None = None,
) -> Lqr:
    """Linear-quadratic regulator at a pose: the gain that minimises a sum of squares over all ticks.

    Law:          u = tau - tau_0 = -K x, x = [q - q_0, v]; K minimises sum x^T Q x + u^T R u over x[k+1] = A x + B u,
                  which is `taut.linearise` of the arm under that torque: exact, with zero-order hold and gravity
    Closed loop:  x[k+1] = (A - B K) x, stable at the pose if Q weighs every motion; on the real arm as far as its
                  dynamics are those of the pose

    Args:
        arm: The arm that the law knows.
        Q: (2 n,), (2 n, 2 n) or one weight, of positions, then velocities: 1 / (admissible error)^2 is a start.
        R: (n,) or (n, n) weights of torques, or a number: 1 / (admissible torque)^2 is a start.
        at: (n,) the pose [rad | m]; home if left out.
        rate: [Hz].
        plant: Plant of the model, with friction or a payload; the arm without friction if left out.

    Raises:
        ShapeError, RangeError: Weights of another size, that are not symmetric, or not positive; a pose beyond the
            limits; no solution, as where Q leaves out a motion that does not come to rest by itself.
        UsageError: A plant with states besides q and v, such as a delay, which this law does not feed back.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> found = lqr(arm, Q=[400.0, 400.0, 1.0, 1.0], R=0.01, at=[0.3, 0.8])
        >>> found.K.shape, bool(np.abs(found.poles).max() < 1.0)
        ((2, 4), True)

    References:
        Astrom and Wittenmark, Computer-controlled systems (1997), section 11.2.
    """
    from scipy.linalg import solve_discrete_are

    instance_of("plant", plant, RigidPlant | None, "a taut.RigidPlant")
    q, rate, n = pose_of(arm, at), rate_in_hertz(rate), arm.n
    weights = joint_matrix("Q", Q, 2 * n, minimum=0.0), joint_matrix("R", R, n, above=0.0)
    plant = RigidPlant(arm, friction=None, integrator="rk4") if plant is None else plant
    held = np.zeros(n) if Adds.of(plant.adds).gravity else np.asarray(snapshot(arm, q).g)
    free = StateFeedback(K_q=np.zeros((n, n)), K_v=np.zeros((n, n)), tau_0=held)
    lin = linearise(Loop(compile(free, arm, rate=rate, adds=plant.adds), plant, duration=1.0), at=q)
    states = (*names("plant.q", n), *names("plant.v", n))
    others = [name for name in lin.states if name not in states]
    if others:
        raise UsageError(
            f"lqr feeds back positions and velocities, and the plant has other states too: {', '.join(others[:4])}; "
            "take a plant without delay, elasticity and lag, or taut.tune",
            name="plant",
        )
    A, B = lin.A, lin.B[:, list(lin.columns("disturbance.command"))]
    try:
        P = solve_discrete_are(A, B, *weights)
        K = np.linalg.solve(weights[1] + B.T @ P @ B, B.T @ P @ A)
        closed = LinearSystem(A=A - B @ K, dt=1.0 / rate, states=states)
    except np.linalg.LinAlgError:
        closed = None
    if closed is None or closed.radius > 1.0 - INSIDE:
        raise RangeError(
            "Q must weigh every motion that does not come to rest by itself, positions above all, or no gain "
            f"that ends it is the best; got the diagonal {np.diag(weights[0]).tolist()}",
            name="Q",
        )
    law = StateFeedback(K_q=K[:, :n], K_v=K[:, n:], tau_0=held)
    return Lqr(law=law, K=K, P=P, system=closed, arm=arm.name, q=q)
