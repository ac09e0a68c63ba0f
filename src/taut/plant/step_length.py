"""How long a step of the integrator may be, against what moves fast in the drives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.maths.dynamics import mass_matrix
from taut.maths.model import model_of
from taut.plant.actuation import Actuation
from taut.plant.drivetrain import Drivetrain

__all__ = ["require_short_steps"]

WayOut = Callable[[int], str]


def require_short_steps(train: Drivetrain, actuation: Actuation, dt: float, way_out: WayOut) -> None:
    """Refuse steps that are too long for a motor, an inner loop or a transmission, with the arm at home.

    Args:
        train: Rotors and transmissions.
        actuation: The drives.
        dt: Length of a step [s].
        way_out: The words for so many times as many steps.

    Raises:
        RangeError: They are; the sentence says what is enough.
    """
    if actuation.motor is None and actuation.torque_loop is None and not train.compliant:
        return
    rotor = train.arm.rotor_inertia
    links = mass_matrix(model_of(train.arm.with_joints(rotor_inertia=0.0)), train.arm.home)
    geared = np.diag(np.linalg.inv(links + np.diag(rotor))).copy()  # acceleration per torque of each motor
    for i in train.compliant:
        geared[i] = 1.0 / rotor[i]
    _check_motor(train, actuation, dt, geared, way_out)
    _check_torque_loop(train, actuation, dt, geared, way_out)
    _check_springs(train, dt, np.diag(np.linalg.inv(links)), way_out)


def _check_motor(train: Drivetrain, actuation: Actuation, dt: float, mobility: Float64Array, way_out: WayOut) -> None:
    """Its torque falls with speed, as a damper's does, and is that of the speed when a step begins."""
    if actuation.motor is None:
        return
    fast = actuation.motor.braking(train.arm.gear) * mobility * dt
    i = int(np.argmax(fast))
    if fast[i] <= 1.0:
        return
    enough = way_out(int(np.ceil(fast[i])))
    raise RangeError(
        f"the motor of joint '{train.arm.joint_names[i]}' loses torque with speed so steeply that its joint answers "
        f"in {dt / fast[i]:.3g} s, too fast for steps of {dt:g} s; give the plant {enough}, or the joint its "
        "rotor's inertia: arm.with_gears(ratio=, motor_inertia=)",
        name="motor",
    )


def _check_torque_loop(
    train: Drivetrain, actuation: Actuation, dt: float, mobility: Float64Array, way_out: WayOut
) -> None:
    """It reads what the motor gave in the last step, which alternates where kp share is too large.

    A lag of left = exp(-omega dt) over a step, and mean = (1 - left) / (omega dt), has a root at -1 for
    kp share (1 + left - 2 mean) = 1 + left; without a lag for kp share = 1.
    """
    if actuation.torque_loop is None:
        return
    arm = train.arm
    share = 1.0 - arm.rotor_inertia * mobility  # of the motor's torque that a rigid gear passes on at once
    share[list(train.compliant)] = 0.0
    left, mean = np.zeros(arm.n), np.zeros(arm.n)
    if actuation.bandwidth is not None:
        steps = np.asarray(actuation.bandwidth) * dt + np.zeros(arm.n)
        left = np.exp(-steps)
        mean = (1.0 - left) / steps
    most = (1.0 + left) / np.maximum(share * (1.0 + left - 2.0 * mean), 1e-300)
    kp = np.asarray(actuation.torque_loop.kp) + np.zeros(arm.n)
    i = int(np.argmax(kp / most))
    if kp[i] < most[i]:
        return
    slower = "the drive a bandwidth" if actuation.bandwidth is None else f"the plant {way_out(2)}"
    raise RangeError(
        f"actuation.torque_loop.kp of joint '{arm.joint_names[i]}' must be below {most[i]:.3g} for steps of {dt:g} "
        f"s, since the loop reads the torque of the step before; lower it, or give {slower}",
        name="torque_loop",
    )


def _check_springs(train: Drivetrain, dt: float, mobility: Float64Array, way_out: WayOut) -> None:
    """The swing of motor against link."""
    if not train.compliant:
        return
    assert train.transmission is not None
    joints, n = list(train.compliant), train.arm.n
    both = 1.0 / train.arm.rotor_inertia[joints] + mobility[joints]
    K = np.broadcast_to(np.asarray(train.transmission.stiffness), (n,))[joints]
    D = np.broadcast_to(np.asarray(train.transmission.damping), (n,))[joints]
    omega = np.sqrt(K * both)
    fast = np.maximum(omega, 2.0 * D * both) * dt
    i = int(np.argmax(fast))
    if fast[i] <= 1.0:
        return
    raise RangeError(
        f"the transmission of joint '{train.arm.joint_names[joints[i]]}' swings at {omega[i]:.3g} rad/s, too fast "
        f"for steps of {dt:g} s; give the plant {way_out(int(np.ceil(fast[i])))}, a softer spring or less damping",
        name="stiffness",
    )
