"""Where the power of the drives goes: the work of each part of a step, joint by joint.

A torque's work is its product with the way that its joint goes in the step, dt v+, as the integrator moves it. What a
step of finite length adds to that has a name too: `integration`, which tends to zero with dt.

    electric = copper + magnetic + motor + conversion                          where the motor is an electric one
    motor    = rotor + viscous + dry + gears + spring + damping + link + integration
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from taut.base.paths import subtree
from taut.base.types import Vector
from taut.plant.drives.drivetrain import Drivetrain, FrictionLimits
from taut.plant.drives.motor import MotorModel
from taut.trace import math as tm

__all__ = ["WORK", "work_of_step", "work_parts"]

Values = Mapping[str, Any]

WORK: Final = {
    "electric": "taken from the supply",
    "copper": "heat of the windings",
    "magnetic": "stored in the windings",
    "conversion": "of the step: the back-EMF is that of its start",
    "motor": "done by the motors, and by what the plant adds",
    "rotor": "stored in the rotors' motion",
    "viscous": "lost to viscous friction",
    "dry": "lost to dry friction",
    "gears": "lost in the gears",
    "spring": "stored in elastic transmissions",
    "damping": "lost in elastic transmissions",
    "link": "done on the links",
    "integration": "of the step: from torques of its start and ways of its end",
}


def work_parts(train: Drivetrain, motor: MotorModel | None) -> tuple[str, ...]:
    """The names that a drivetrain and its motors have, in the order of `WORK`."""
    there = {"motor", "link", "integration"}
    if motor is not None:
        there |= set(motor.work)
    if train.arm.rotor_inertia.any():
        there.add("rotor")
    if train.friction is not None:
        there |= {"viscous"} if train.viscous else set()
        there |= {"dry"} if train.friction.dry else set()
    there |= {"gears"} if train.lossy else set()
    there |= {"spring", "damping"} if train.compliant else set()
    return tuple(name for name in WORK if name in there)


def work_of_step(
    train: Drivetrain,
    before: Values,
    after: Values,
    ways: tuple[Vector, Vector],
    *,
    tau: Vector,
    given: Vector,
    f: Vector,
    limits: FrictionLimits | None,
    lost: Vector,
    through: Vector,
    spring: Vector,
    rotor: Any,
    parameters: Values,
    electric: Mapping[str, Vector],
    dt: Any,
) -> dict[str, Vector]:
    """(n,) [J] of each part in one step.

    Args:
        train: The drivetrain.
        before: The plant's memory before the step.
        after: Its velocities after it: "v", and "v_motor" where some joint is compliant.
        ways: (n,) of the motors and of the links [rad | m].
        tau: (n,) torque of the motors, with what the plant adds.
        given: (n,) the motors' own.
        f: (n,) dry friction and losses of the gears, against motion.
        limits: Their limits.
        lost: (n,) viscous friction.
        through: (n,) what arrives behind the gears.
        spring: (n,) torque of compliant joints on their links.
        rotor: Rotor inertia at the joint; None where there is none.
        parameters: Current values by path.
        electric: Work of the supply.
        dt: Length of the step [s].
    """
    motor_way, link_way = ways
    v_m = before.get("v_motor", before["v"])
    v_end = after.get("v_motor", after["v"])
    gain = v_end - v_m
    out: dict[str, Vector] = dict(electric)
    out["conversion"] = given * (v_m * dt - motor_way)
    out["motor"] = tau * motor_way
    out["viscous"] = lost * motor_way
    of_law = f if limits is None else limits.share_of_law(f)
    out["dry"] = -of_law * motor_way
    out["gears"] = -(f - of_law) * motor_way
    out["link"] = train.merged(through, spring) * link_way
    out["integration"] = tm.zeros(train.arm.n)
    if rotor is not None:
        stored = 0.5 * rotor * (v_end * v_end - v_m * v_m)
        out["rotor"] = stored
        out["integration"] = rotor * gain * motor_way / dt - stored
    if train.compliant:
        assert train.transmission is not None
        p = subtree(parameters, "actuation.transmission")
        K = train.merged(tm.zeros(train.arm.n), p["stiffness"] + tm.zeros(train.arm.n))
        delta = before["q_motor"] - before["q"]
        z = train.transmission.beyond_play(delta, p)
        z_end = train.transmission.beyond_play(delta + motor_way - link_way, p)
        stored = 0.5 * K * (z_end * z_end - z * z)
        wound = motor_way - link_way
        out["spring"] = stored
        out["damping"] = (spring - K * z) * wound
        out["integration"] = out["integration"] + K * z * wound - stored
    return out
