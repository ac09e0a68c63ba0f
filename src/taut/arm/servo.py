"""Servos and gears: identified friction, rotor and motor constants, as the joint sees them.

Parameter files of servos are the JSON of the package better-actuator-models (BAM).
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.friction import FRICTION_FIELDS, Friction
from taut.base.checks import finite_scalar, positive_scalar, readable_file
from taut.base.errors import ModelError, Problem, TautError, UsageError, quoted_list, unknown_name
from taut.base.fields import Declared, Field, Part

if TYPE_CHECKING:
    from taut.arm.description import Arm

MAX_BYTES: Final = 8 * 1024  # the largest such file met so far has 1 kB
BASE: Final = ("friction_base", "friction_viscous", "armature")
STRIBECK: Final = ("friction_stribeck", "dtheta_stribeck", "alpha")
DIRECTED: Final = ("load_friction_motor", "load_friction_external")
EXCESS: Final = ("load_friction_motor_stribeck", "load_friction_external_stribeck")
NEEDED: Final[Mapping[str, tuple[str, ...]]] = {  # what each model of friction consists of
    "m1": BASE,
    "m2": BASE + STRIBECK,
    "m3": (*BASE, "load_friction_base"),
    "m4": (*BASE, *STRIBECK, "load_friction_base", "load_friction_stribeck"),
    "m5": BASE + STRIBECK + DIRECTED + EXCESS,
    "m6": BASE + STRIBECK + DIRECTED + EXCESS,
}
MOTOR: Final = ("kt", "R")
POSITIVE: Final = (*MOTOR, "dtheta_stribeck", "alpha")
QUADRATIC: Final = ("load_friction_motor_quad", "load_friction_external_quad")
OF_CONTROLLER: Final = ("error_gain_ratio", "max_velocity", "current_limit", "ratio", "max_torque")
LEFT_OUT: Final = ("q_offset", *OF_CONTROLLER, *QUADRATIC)  # the test bench's offset, the servo's own controller, m6
UNITS: Final[Mapping[str, str]] = {
    "friction_base": "N m",
    "friction_viscous": "N m s/rad",
    "friction_stribeck": "N m",
    "dtheta_stribeck": "rad/s",
    "armature": "kg m^2",
    "kt": "N m/A",
    "R": "ohm",
}


class Servo(Declared):
    """A servo's friction, rotor and motor, all seen at its output. `arm.with_servo(servo)` puts it into joints.

    Law:  tau = torque_constant i, i = (u - torque_constant v) / resistance, for a voltage u and a speed v

    Args:
        friction: At the output, each number a scalar.
        rotor_inertia: Seen at the output, gear ratio squared times that of the rotor [kg m^2].
        torque_constant: [N m/A | V s/rad] at the output, if known.
        resistance: Of the winding [ohm], if known.
        voltage: Of the supply [V], if known; parameter files have none.
        name: What it is called.
        model: The model of friction that the numbers were fitted with.
        source: Where the numbers are from.
        notes: What was left out of the source.

    Raises:
        ShapeError: Not one number each.
        RangeError: A negative number, or no finite one.

    Example:
        The Feetech STS3215 of the SO-101, as published with better-actuator-models 1.0.2, model m1:

        >>> sts3215 = Servo(
        ...     friction=Friction(coulomb=0.0524, viscous=0.0591), rotor_inertia=0.0284,
        ...     torque_constant=1.212, resistance=2.676, voltage=7.4,
        ... )
        >>> round(sts3215.torque_constant * sts3215.voltage / sts3215.resistance, 2)  # stall torque [N m]
        3.35
    """

    friction: Part[Friction] = Part(Friction)
    rotor_inertia: Field = Field(unit="kg m^2", minimum=0.0, run_time=False)
    torque_constant: Field = Field(unit="N m/A", above=0.0, optional=True, run_time=False)
    resistance: Field = Field(unit="ohm", above=0.0, optional=True, run_time=False)
    voltage: Field = Field(unit="V", above=0.0, optional=True, run_time=False)
    name: str = ""
    model: str = ""
    source: str = ""
    notes: tuple[str, ...] = ()

    def check(self) -> None:
        for name in FRICTION_FIELDS:
            finite_scalar(f"friction.{name}", getattr(self.friction, name))


def with_servos(arm: Arm, servos: Servo | Mapping[str, Servo]) -> Arm:
    """The arm with the friction and the rotors of servos, in all of its joints or in those that are named."""
    by_joint = dict(servos) if isinstance(servos, Mapping) else dict.fromkeys(arm.joint_names, servos)
    for name, servo in by_joint.items():
        if not isinstance(servo, Servo):  # callers without a type checker
            raise UsageError(
                f"with_servo takes a taut.Servo, or one by joint name; got {type(servo).__name__}", name=name
            )
        if arm.joints[arm.joint_index(name)].kind == "prismatic":
            raise UsageError(
                f"joint '{name}' is prismatic, and a servo's numbers are those of a rotation; give the joint its own "
                "friction and rotor inertia, with_joints(...)",
                name=name,
            )
    values = {
        field: {name: float(np.asarray(getattr(servo.friction, field))) for name, servo in by_joint.items()}
        for field in FRICTION_FIELDS
    }
    values["rotor_inertia"] = {name: servo.rotor_inertia for name, servo in by_joint.items()}
    values["gear"] = dict.fromkeys(by_joint, 1.0)  # all of a servo's numbers are those of its output
    return arm.with_joints(**values)


def load_servo(path: str | os.PathLike[str], *, voltage: float | None = None) -> Servo:
    """A servo from a parameter file of the package better-actuator-models.

    The models m1 (viscous and Coulomb), m2 (Stribeck), m3 (load), m4 (load and Stribeck) and m5 (load, motor's and
    external torque apart) become a `Friction` exactly. Of m6 the two terms in the square of the load are left out.

    Args:
        path: The JSON file.
        voltage: Of the supply [V], which such files do not have; an STS3215 of the SO-101 runs on 7.4.

    Raises:
        FileError: The file cannot be read.
        ModelError: Not such a file, or its numbers break rules; `problems` has each.
        RangeError: A voltage <= 0.

    References:
        Duclusaud, Passault, Padois and Ly, Extended friction models for the physics simulation of servo
        actuators (2024).
    """
    file = readable_file("servo", path)
    data = _object(file)
    model = data.get("model")
    if not isinstance(model, str) or model not in NEEDED:
        text = f"a servo file names its model of friction, {quoted_list(NEEDED)}, as 'model'; got {str(model)[:40]!r}"
        raise _refused(file, "model", text)
    problems = list(_problems(file.name, model, data))
    if problems:
        raise ModelError(str(file), problems)
    left_out = [key for key in data if key in LEFT_OUT]
    return Servo(
        friction=_friction(model, data),
        rotor_inertia=float(data["armature"]),
        torque_constant=data.get("kt"),
        resistance=data.get("R"),
        voltage=voltage,
        name=data.get("actuator", file.stem),
        model=model,
        source=str(file),
        notes=(f"{quoted_list(left_out)} left out",) if left_out else (),
    )


def _object(file: Path) -> dict[str, Any]:
    """The one object of a file."""
    with file.open("rb") as stream:
        text = stream.read(MAX_BYTES + 1)
    if len(text) > MAX_BYTES:
        raise _refused(file, "size", f"the file is larger than {MAX_BYTES // 1024} kB; a servo file has 1 kB")

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        names = [name for name, _ in pairs]
        for name in names:
            if names.count(name) > 1:
                raise _refused(file, name, f"'{name}' is there twice; delete one")
        return dict(pairs)

    try:
        data = json.loads(text, object_pairs_hook=once, parse_int=float)
    except ModelError:
        raise
    except (RecursionError, ValueError) as cause:  # no JSON, no UTF-8, or too deep
        said = str(cause) if isinstance(cause, json.JSONDecodeError) else "its text is damaged or far too deep"
        raise _refused(file, "JSON", f"the file is not JSON: {said}", getattr(cause, "lineno", None)) from cause
    if not isinstance(data, dict):
        raise _refused(file, "JSON", "the file is no JSON object; a servo file is one object of numbers by name")
    return data


def _refused(file: Path, attribute: str, message: str, line: int | None = None) -> ModelError:
    return ModelError(str(file), [Problem(object=file.name, attribute=attribute, message=message, line=line)])


def _problems(name: str, model: str, data: Mapping[str, Any]) -> Iterator[Problem]:
    known = (*NEEDED[model], *MOTOR, *LEFT_OUT)
    for key in NEEDED[model]:
        if key not in data:
            yield Problem(object=name, attribute=key, message=f"model {model} needs '{key}', which is missing")
    for key, value in data.items():
        try:
            if key == "actuator" and not (isinstance(value, str) and value.isprintable()):
                raise UsageError(f"actuator must be a text; got {value!r}")
            if key in known:
                bounds = {"above": 0.0} if key in POSITIVE else {} if key in LEFT_OUT else {"minimum": 0.0}
                finite_scalar(key, value, unit=UNITS.get(key, ""), **bounds)
            elif key not in ("model", "actuator"):
                raise unknown_name(f"model {model}", "number", key, known)
        except TautError as wrong:
            yield Problem(object=name, attribute=key, message=str(wrong))


def _friction(model: str, values: Mapping[str, Any]) -> Friction:
    """The numbers of m1 to m5, and of m6 what is not quadratic."""
    coulomb = values["friction_base"]
    of: dict[str, float] = {"viscous": values["friction_viscous"], "coulomb": coulomb}
    if "friction_stribeck" in values:
        of |= {
            "static": coulomb + values["friction_stribeck"],
            "stribeck": values["dtheta_stribeck"],
            "stribeck_shape": values["alpha"],
        }
    if model in ("m3", "m4"):  # of the torque between motor and load, whichever way it goes
        both, excess = values["load_friction_base"], values.get("load_friction_stribeck", 0.0)
        for side in ("load_motor", "load_external"):
            of |= {side: both, f"{side}_static": both + excess}
    elif model in ("m5", "m6"):
        for side in ("motor", "external"):
            moving = values[f"load_friction_{side}"]
            of |= {
                f"load_{side}": moving,
                f"load_{side}_static": moving + values[f"load_friction_{side}_stribeck"],
            }
    return Friction(**of)


def reflected_inertia(ratio: float, motor_inertia: float) -> float:
    """Reflected inertia of a rotor at its joint: ratio^2 motor_inertia [kg m^2 | kg].

    Law:  K = (I_link + G^2 I_motor) v^2 / 2, since the rotor turns G times as fast as the link

    Args:
        ratio: G, turns of the motor per turn of the joint; rad/m for a prismatic joint.
        motor_inertia: Of the rotor about its own axis [kg m^2].

    Raises:
        RangeError: A ratio <= 0, or a negative inertia.

    Example:
        A link of 1 kg m^2 with a rotor of 1e-3 kg m^2: in direct drive 99.9 % of the inertia is the link's; behind
        a gear of 100 the rotor is ten times the link.

        >>> round(100.0 / (1.0 + reflected_inertia(1.0, 1e-3)), 1)
        99.9
        >>> round(reflected_inertia(100.0, 1e-3), 9)
        10.0

    References:
        Chapter, section 10.2.1.5 the effect of gearing.
    """
    G = positive_scalar("ratio", ratio)
    return G**2 * finite_scalar("motor_inertia", motor_inertia, minimum=0.0, unit="kg m^2")


def matched_ratio(link_inertia: float, motor_inertia: float) -> float:
    """The gear ratio that gives the link half of the torque, and the most acceleration: sqrt(I_link / I_motor).

    Law:  a(G) = G tau / (I_link + G^2 I_motor) is largest where I_link = G^2 I_motor: inertia matched

    Args:
        link_inertia: About the joint's axis [kg m^2].
        motor_inertia: Of the rotor about its own axis [kg m^2].

    Raises:
        RangeError: An inertia that is not above zero.

    Example:
        >>> round(matched_ratio(1.0, 1e-3), 2)
        31.62

    References:
        Chapter, section 10.2.1.5 the effect of gearing.
    """
    link = positive_scalar("link_inertia", link_inertia, unit="kg m^2")
    return math.sqrt(link / positive_scalar("motor_inertia", motor_inertia, unit="kg m^2"))
