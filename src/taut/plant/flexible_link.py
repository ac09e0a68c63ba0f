"""FlexibleLink: one link that bends, on a motor, by assumed modes; a plant of pure functions, as the rigid arm is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import Any, ClassVar, Final

import numpy as np

from taut.arm.builtin import one_joint
from taut.arm.description import Arm
from taut.base.checks import finite_scalar, require_range, whole_number
from taut.base.errors import unknown_name
from taut.base.paths import PlantParameters
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.plant.parts import Steps
from taut.trace import math as tm

Values = Mapping[str, Any]
ROOTS: Final = (1.8751040687119611, 4.694091132974175, 7.854757438237613)  # of cosh x cos x = -1: clamped-free beams
UNITS: Final = {"length": "m", "EI": "N m^2", "density": "kg/m", "hub_inertia": "kg m^2"}
MAY_BE_ZERO: Final = {"tip_mass": "kg", "zeta": "-"}
LARGEST: Final = 1e6  # of a parameter; the smallest is its inverse
MAX_SUBSTEPS: Final = 1000


@dataclass(frozen=True, eq=False)
class FlexibleLink:
    """A motor that moves a link which bends: a uniform beam clamped to its hub, in a horizontal plane.

    Model:
        y(x) = x theta + sum phi_i(x) eta_i, with phi_i the modes of the clamped beam, int rho phi_i^2 dx = 1
        [[J, a^T], [a, I + m phi phi^T]] [theta'', eta''] + [0, 2 zeta omega eta' + omega^2 eta] = [tau, 0]
        J = hub_inertia + rho L^3 / 3 + m L^2, a_i = rho int x phi_i dx + m L phi_i(L); small deflections
        rk4 under the held torque. With one mode and zeta = 0 the zeros from torque to tool are at +-2.6953 omega_1,
        whatever hub and tip mass: one is unstable.

    The joint's q is the angle y(L) / L at which the tool is seen from the hub, so that errors are those of the tool;
    q_motor is the hub's angle theta, which a law in `taut.laws.MotorSide` feeds back (collocated).

    Args:
        length: L of the beam [m].
        EI: Its bending stiffness [N m^2].
        density: rho, its mass per length [kg/m].
        hub_inertia: Of hub and rotor [kg m^2].
        tip_mass: m, a point mass at the tool [kg].
        zeta: Damping ratio of each mode of the clamped beam, at most 1 [-].
        modes: 1 to 3.
        substeps: Steps of the integrator in one control period.

    Raises:
        RangeError: A parameter out of its range; when a run starts, steps too long for the fastest mode.

    Example:
        >>> import taut
        >>> link = FlexibleLink(length=1.0, EI=5.0, density=0.5, hub_inertia=0.1)
        >>> pd = taut.laws.MotorSide(law=taut.laws.ComputedTorque(kp=25.0, kd=8.0))
        >>> lin = taut.linearise(taut.Loop(taut.compile(pd, link.arm), link, duration=1.0))
        >>> lin.stable, lin.s_zeros(input="disturbance.command", output="q[0]")[:2].real.round(1).tolist()
        (True, [-29.2, 30.8])

    References:
        De Luca and Siciliano, Inversion-based nonlinear control of robot arms with flexible links, Journal of
        Guidance, Control, and Dynamics 16 (1993).
    """

    _: KW_ONLY
    length: float
    EI: float
    density: float
    hub_inertia: float
    tip_mass: float = 0.0
    zeta: float = 0.01
    modes: int = 1
    substeps: int = 1

    name: ClassVar[str] = "FlexibleLink"
    takes: ClassVar[str] = "torque"
    measures: ClassVar[frozenset[str]] = frozenset({"v", "q_motor", "v_motor"})
    distorts: ClassVar[frozenset[str]] = frozenset()
    adds: ClassVar[tuple[str, ...]] = ()
    noise: ClassVar[dict[str, tuple[int, ...]]] = {}
    parameters: ClassVar[Mapping[str, Float64Array]] = PlantParameters("plant 'FlexibleLink'", "parameter", {})

    def __post_init__(self) -> None:
        for name, unit in (UNITS | MAY_BE_ZERO).items():
            value = finite_scalar(name, getattr(self, name), unit=unit)
            lowest, highest = 0.0 if name in MAY_BE_ZERO else 1.0 / LARGEST, 1.0 if name == "zeta" else LARGEST
            require_range(name, np.asarray(value), unit=unit, minimum=lowest, maximum=highest)
            object.__setattr__(self, name, value)
        whole_number("modes", self.modes, minimum=1, maximum=len(ROOTS))
        whole_number("substeps", self.substeps, minimum=1, maximum=MAX_SUBSTEPS)

    @cached_property
    def arm(self) -> Arm:
        """The rigid link of the same inertia: the model of laws."""
        J, r = float(self.mass_matrix[0, 0]), self.length
        return one_joint(M=J, m=0.5 * J / r**2, r=r, b=0.0).with_gravity([0.0, 0.0, 0.0])

    @cached_property
    def mode_shapes(self) -> Float64Array:
        """(modes,) phi_i(L), the deflection of the tool in each mode [kg^-0.5]."""
        return np.array([2.0, -2.0, 2.0])[: self.modes] / math.sqrt(self.density * self.length)

    @cached_property
    def mass_matrix(self) -> Float64Array:
        """(1 + modes, 1 + modes) of the hub's angle and the modes."""
        L, rho, m, phi = self.length, self.density, self.tip_mass, self.mode_shapes
        M = np.eye(1 + self.modes)
        M[0, 0] = self.hub_inertia + rho * L**3 / 3.0 + m * L**2
        M[0, 1:] = M[1:, 0] = 2.0 * np.sqrt(rho * L) * L / np.array(ROOTS[: self.modes]) ** 2 + m * L * phi
        M[1:, 1:] += m * np.outer(phi, phi)
        return M

    @cached_property
    def matrices(self) -> tuple[Float64Array, Float64Array]:
        """A (2 N, 2 N) and B (2 N,) of x' = A x + B tau, with x = [q, q_motor, eta_2, ...] and its rates."""
        N = 1 + self.modes
        omega = (np.array([0.0, *ROOTS[: self.modes]]) / self.length) ** 2 * np.sqrt(self.EI / self.density)
        S = np.eye(N)  # [q, theta, eta_2, ...] = S [theta, eta_1, eta_2, ...]
        S[:2, 0], S[:2, 1:] = 1.0, [self.mode_shapes / self.length, np.zeros(self.modes)]
        mobility, back = S @ np.linalg.inv(self.mass_matrix), np.linalg.inv(S)
        A = np.eye(2 * N, k=N)
        A[N:] = -mobility @ np.hstack([np.diag(omega**2) @ back, np.diag(2.0 * self.zeta * omega) @ back])
        return A, np.concatenate([np.zeros(N), mobility[:, 0]])

    def start(self, q: Vector, v: Vector, parameters: Values, dt: float) -> dict[str, Any]:  # noqa: ARG002
        """Memory by path at the start of a run, from the true state: straight, without vibration."""
        steps, fastest = Steps(dt, self.substeps), float(np.abs(np.linalg.eigvals(self.matrices[0])).max())
        what = f"the fastest of {self.modes} modes oscillates at {fastest:.3g} rad/s"
        steps.require(fastest * steps.dt, "substeps", what, "the link fewer modes")
        rest, zero = tm.zeros(self.modes - 1), tm.zeros(1)
        return {"q": q, "v": v, "q_motor": q, "v_motor": v, "eta": rest, "eta_rate": rest, "tau": zero}

    def measure(self, memory: Values, noise: Values, parameters: Values) -> dict[str, Any]:  # noqa: ARG002
        """What the sensors give: tool and hub."""
        return {name: memory[name] for name in ("q", "v", "q_motor", "v_motor")}

    def command(self, command: Vector, memory: Values, t: Any) -> dict[str, Any]:  # noqa: ARG002
        """Memory after a command came in."""
        return {**memory, "tau": command}

    def advance(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]:  # noqa: ARG002
        """Memory after one step of rk4, which is a Taylor series of a linear system under a held torque."""
        A, B = self.matrices
        x = tm.array([x for name in ("q", "q_motor", "eta", "v", "v_motor", "eta_rate") for x in memory[name]])
        change = dt * (A @ x + B * memory["tau"][0])
        x = x + change
        for k in (2.0, 3.0, 4.0):
            change = dt / k * (A @ change)
            x = x + change
        N = 1 + self.modes
        out = {**memory, "q": x[:1], "q_motor": x[1:2], "eta": x[2:N]}
        return out | {"v": x[N : N + 1], "v_motor": x[N + 1 : N + 2], "eta_rate": x[N + 2 :]}

    def extra(self, before: Values, after: Values) -> dict[str, Any]:  # noqa: ARG002
        """No further columns; q_motor is recorded where a law measures it, as sensed.q_motor."""
        return {}

    def checked_parameter(self, path: str, value: ArrayLike) -> Float64Array:  # noqa: ARG002
        """No parameter changes in a run."""
        raise unknown_name(f"plant '{self.name}'", "parameter", path, self.parameters)

    def check_together(self, values: Mapping[str, ArrayLike]) -> None:
        """No values that could contradict each other."""
