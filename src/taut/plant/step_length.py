"""How long a step of the integrator may be, against what moves fast in the drives and in what touches the tool."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from taut.base.errors import RangeError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.maths.dynamics import jacobian, mass_matrix
from taut.maths.model import PayloadValues, model_of
from taut.plant.drives.actuation import Actuation
from taut.plant.drives.drivetrain import Drivetrain
from taut.plant.environments.environment import Environment

__all__ = ["Steps", "require_short_contact", "require_short_steps"]

ROUNDING: Final = 1e-9  # [-] of the length of a step

Values = Mapping[str, Any]


class Steps(NamedTuple):
    """The steps of an integrator in a control period."""

    period: float  # [s]
    number: int

    @property
    def dt(self) -> float:
        """Length of a step [s]."""
        return self.period / self.number

    def shorter(self, factor: float) -> str:
        """How to take so many times as many steps."""
        count = math.ceil(factor * self.number * (1.0 - ROUNDING))
        return f"steps of {self.period / count:.9g} s (substeps={count}, or the timestep of MuJoCo)"

    def require(self, fast: float, name: str, what: str, instead: str) -> None:
        """Refuse steps in which something moves by more than its own time.

        Args:
            fast: Length of a step over that time [-].
            name: Of what is too fast.
            what: The beginning of the sentence.
            instead: Another way to fix it.

        Raises:
            RangeError: They are too long.
        """
        if fast > 1.0 + ROUNDING:
            raise RangeError(
                f"{what}, too fast for steps of {self.dt:g} s; give the plant {self.shorter(fast)}, or {instead}",
                name=name,
            )


def require_short_steps(train: Drivetrain, actuation: Actuation, parameters: Values, steps: Steps) -> None:
    """Refuse steps that are too long for a motor, an inner loop or a transmission, with the arm at home.

    Args:
        train: Rotors and transmissions.
        actuation: The drives.
        parameters: The plant's parameters by path, as the run begins with them.
        steps: The steps.

    Raises:
        RangeError: They are; the sentence says what is enough.
    """
    if actuation.motor is None and actuation.torque_loop is None and not train.compliant:
        return
    n, names = train.arm.n, train.arm.joint_names
    p = {path: np.broadcast_to(value, (n,)) for path, value in subtree(parameters, "actuation").items()}
    rotor = np.broadcast_to(parameters.get("plant.rotor_inertia", 0.0), (n,))
    links = mass_matrix(model_of(train.arm.with_joints(rotor_inertia=0.0)), train.arm.home)
    geared = np.diag(np.linalg.inv(links + np.diag(rotor))).copy()  # acceleration per torque of each motor
    for i in train.compliant:
        geared[i] = 1.0 / rotor[i]
    if actuation.motor is not None:
        # Its torque falls with speed, as a damper's does, and is that of the speed when a step begins.
        fast = actuation.motor.braking(train.arm.gear, subtree(p, "motor")) * geared * steps.dt
        i = int(np.argmax(fast))
        steps.require(
            fast[i],
            "motor",
            f"the motor of joint '{names[i]}' loses torque with speed so steeply that its joint answers in "
            f"{steps.dt / max(fast[i], 1e-300):.3g} s",
            "the joint its rotor's inertia, by gears",
        )
    if actuation.torque_loop is not None:
        share = 1.0 - rotor * geared  # of the motor's torque that a rigid gear passes on at once
        share[list(train.compliant)] = 0.0
        _require_slow_torque_loop(names, p, share, steps)
    if train.compliant:
        joints = list(train.compliant)
        # A gear that a motor drives passes the rotor's inertia on in its efficiency's measure.
        light = rotor * p.get("transmission.efficiency", 1.0)
        both = (
            1.0 / light[joints] + np.diag(np.linalg.inv(links))[joints]
        )  # acceleration of motor and link per torque
        omega = np.sqrt(p["transmission.stiffness"][joints] * both)
        fast = np.maximum(omega, 2.0 * p["transmission.damping"][joints] * both) * steps.dt
        i = int(np.argmax(fast))
        steps.require(
            fast[i],
            "stiffness",
            f"the transmission of joint '{names[joints[i]]}' oscillates at {omega[i]:.3g} rad/s",
            "a softer spring or less damping",
        )


def require_short_contact(
    environment: Environment,
    train: Drivetrain,
    q: Float64Array,
    parameters: Values,
    steps: Steps,
    *,
    driven: bool = False,
) -> None:
    """Refuse steps that are too long for a ready-made environment, at the start of a run.

    An oscillation of omega with damping delta, both taken at the beginning of a step, is stable in semi-implicit
    Euler while omega^2 dt^2 + 2 delta dt < 4. Half of that is let through, since the tool's inertia changes.

    Args:
        environment: What touches the tool.
        train: Rotors and transmissions.
        q: (n,) positions at the start.
        parameters: The plant's parameters by path, as the run begins with them.
        steps: The steps.
        driven: Whether stiff drives move the arm, so that no environment does.

    Raises:
        RangeError: They are; the sentence says what is enough.
    """
    mobility = np.zeros((6, 6)) if driven else _mobility(train, q, parameters)
    omega, damping = environment.rates(mobility, subtree(parameters, "environment"))
    a, b = (omega * steps.dt) ** 2, damping * steps.dt
    steps.require(
        0.5 * (b + np.sqrt(b * b + 2.0 * a)),
        "environment",
        f"environment: what touches the tool oscillates at {omega:.3g} rad/s and is braked at {damping:.3g} 1/s",
        "a softer environment",
    )


def _mobility(train: Drivetrain, q: Float64Array, parameters: Values) -> Float64Array:
    """(6, 6) acceleration of the tool per wrench; the rotor of a compliant joint moves by itself."""
    n = train.arm.n
    rotor = np.broadcast_to(parameters.get("plant.rotor_inertia", 0.0), (n,))
    model = model_of(train.arm.with_joints(rotor_inertia=0.0))
    M = mass_matrix(model, q, PayloadValues.of(subtree(parameters, "plant.payload")))
    M = M + np.diag([rotor[i] if i in train.rigid else 0.0 for i in range(n)])
    J = jacobian(model, q)
    mobility: Float64Array = J @ np.linalg.solve(M, J.T)
    return mobility


def _require_slow_torque_loop(names: Sequence[str], p: Values, share: Float64Array, steps: Steps) -> None:
    """It reads what the motor gave in the last step, which alternates where kp share is too large.

    A lag of left = exp(-omega dt) over a step, and mean = (1 - left) / (omega dt), has a root at -1 for
    kp share (1 + left - 2 mean) = 1 + left; without a lag for kp share = 1.
    """
    kp = p["torque_loop.kp"]
    left, mean = np.zeros_like(kp), np.zeros_like(kp)
    if "bandwidth" in p:
        left = np.exp(-p["bandwidth"] * steps.dt)
        mean = (1.0 - left) / (p["bandwidth"] * steps.dt)
    largest = (1.0 + left) / np.maximum(share * (1.0 + left - 2.0 * mean), 1e-300)
    i = int(np.argmax(kp / largest))
    if kp[i] < largest[i]:
        return
    slower = f"the plant {steps.shorter(2.0)}" if "bandwidth" in p else "the drive a bandwidth"
    raise RangeError(
        f"actuation.torque_loop.kp of joint '{names[i]}' must be below {largest[i]:.3g} for steps of {steps.dt:g} "
        f"s, since the loop reads the torque of the step before; lower it, or give {slower}",
        name="torque_loop",
    )
