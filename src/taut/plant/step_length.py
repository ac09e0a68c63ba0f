"""How long a step of the integrator may be, against what moves fast in the drives and in what touches the tool."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import RangeError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.maths.dynamics import jacobian, mass_matrix
from taut.maths.model import PayloadValues, model_of
from taut.plant.drives.actuation import Actuation
from taut.plant.drives.drivetrain import Drivetrain
from taut.plant.environments.environment import Environment, ReadyEnvironment

__all__ = ["require_short_contact", "require_short_steps"]

WayOut = Callable[[float], str]
Values = Mapping[str, Any]


def require_short_steps(
    train: Drivetrain, actuation: Actuation, parameters: Values, dt: float, way_out: WayOut
) -> None:
    """Refuse steps that are too long for a motor, an inner loop or a transmission, with the arm at home.

    Args:
        train: Rotors and transmissions.
        actuation: The drives.
        parameters: The plant's parameters by path, as the run begins with them.
        dt: Length of a step [s].
        way_out: The words for so many times as many steps.

    Raises:
        RangeError: They are; the sentence says what is enough.
    """
    if actuation.motor is None and actuation.torque_loop is None and not train.compliant:
        return
    n = train.arm.n
    p = {path: np.broadcast_to(value, (n,)) for path, value in subtree(parameters, "actuation").items()}
    rotor = np.broadcast_to(parameters.get("plant.rotor_inertia", 0.0), (n,))
    links = mass_matrix(model_of(train.arm.with_joints(rotor_inertia=0.0)), train.arm.home)
    geared = np.diag(np.linalg.inv(links + np.diag(rotor))).copy()  # acceleration per torque of each motor
    for i in train.compliant:
        geared[i] = 1.0 / rotor[i]
    if actuation.motor is not None:
        _check_motor(
            train.arm, actuation.motor.braking(train.arm.gear, subtree(p, "motor")) * geared * dt, dt, way_out
        )
    if actuation.torque_loop is not None:
        share = 1.0 - rotor * geared  # of the motor's torque that a rigid gear passes on at once
        share[list(train.compliant)] = 0.0
        _check_torque_loop(train.arm, p, share, dt, way_out)
    if train.compliant:
        joints = list(train.compliant)
        # A gear that a motor drives passes the rotor's inertia on in its efficiency's measure.
        light = rotor * p.get("transmission.efficiency", 1.0)
        both = 1.0 / light[joints] + np.diag(np.linalg.inv(links))[joints]
        _check_springs(train.arm, joints, subtree(p, "transmission"), both, dt, way_out)


def require_short_contact(
    environment: Environment | None,
    train: Drivetrain,
    q: Float64Array,
    parameters: Values,
    dt: float,
    way_out: WayOut,
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
        dt: Length of a step [s].
        way_out: The words for so many times as many steps.
        driven: Whether stiff drives move the arm, so that no environment does.

    Raises:
        RangeError: They are; the sentence says what is enough.
    """
    if not isinstance(environment, ReadyEnvironment):
        return
    mobility = np.zeros((6, 6)) if driven else _mobility(train, q, parameters)
    omega, damping = environment.rates(mobility, subtree(parameters, "environment"))
    a, b = (omega * dt) ** 2, damping * dt
    fast = 0.5 * (b + np.sqrt(b * b + 2.0 * a))
    if fast <= 1.0 + 1e-9:
        return
    raise RangeError(
        f"environment: what touches the tool oscillates at {omega:.3g} rad/s and is braked at {damping:.3g} 1/s, too "
        f"fast for steps of {dt:g} s; give the plant {way_out(fast)}, or a softer environment",
        name="environment",
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


def _check_motor(arm: Arm, fast: Float64Array, dt: float, way_out: WayOut) -> None:
    """Its torque falls with speed, as a damper's does, and is that of the speed when a step begins."""
    i = int(np.argmax(fast))
    if fast[i] <= 1.0:
        return
    enough = way_out(fast[i])
    raise RangeError(
        f"the motor of joint '{arm.joint_names[i]}' loses torque with speed so steeply that its joint answers "
        f"in {dt / fast[i]:.3g} s, too fast for steps of {dt:g} s; give the plant {enough}, or the joint its "
        "rotor's inertia, by gears",
        name="motor",
    )


def _check_torque_loop(arm: Arm, p: Values, share: Float64Array, dt: float, way_out: WayOut) -> None:
    """It reads what the motor gave in the last step, which alternates where kp share is too large.

    A lag of left = exp(-omega dt) over a step, and mean = (1 - left) / (omega dt), has a root at -1 for
    kp share (1 + left - 2 mean) = 1 + left; without a lag for kp share = 1.
    """
    left, mean, kp = np.zeros(arm.n), np.zeros(arm.n), p["torque_loop.kp"]
    if "bandwidth" in p:
        left = np.exp(-p["bandwidth"] * dt)
        mean = (1.0 - left) / (p["bandwidth"] * dt)
    most = (1.0 + left) / np.maximum(share * (1.0 + left - 2.0 * mean), 1e-300)
    i = int(np.argmax(kp / most))
    if kp[i] < most[i]:
        return
    slower = f"the plant {way_out(2.0)}" if "bandwidth" in p else "the drive a bandwidth"
    raise RangeError(
        f"actuation.torque_loop.kp of joint '{arm.joint_names[i]}' must be below {most[i]:.3g} for steps of {dt:g} "
        f"s, since the loop reads the torque of the step before; lower it, or give {slower}",
        name="torque_loop",
    )


def _check_springs(arm: Arm, joints: list[int], p: Values, both: Float64Array, dt: float, way_out: WayOut) -> None:
    """The oscillation of motor against link, whose accelerations per torque are `both` together."""
    K, D = p["stiffness"][joints], p["damping"][joints]
    omega = np.sqrt(K * both)
    fast = np.maximum(omega, 2.0 * D * both) * dt
    i = int(np.argmax(fast))
    if fast[i] <= 1.0:
        return
    raise RangeError(
        f"the transmission of joint '{arm.joint_names[joints[i]]}' oscillates at {omega[i]:.3g} rad/s, too fast "
        f"for steps of {dt:g} s; give the plant {way_out(fast[i])}, a softer spring or less damping",
        name="stiffness",
    )
