"""Servos: friction, rotor and motor constants that somebody identified, all seen at the output.

Their parameter files are the JSON of the package better-actuator-models (BAM), one object of numbers by name. Its
models of friction m1 to m5 are exactly a `Friction`; what m6 and the test bench add has no place in it and is named
in the notes.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.friction import FRICTION_FIELDS, Friction
from taut.arm.rules import MAX_ROTOR, OTHER_UNIT
from taut.base.checks import finite_array, finite_scalar, positive_scalar, readable_file, require_range
from taut.base.errors import ModelError, Problem, ShapeError, UsageError, quoted_list, unknown_name
from taut.base.types import ArrayLike, Float64Array

if TYPE_CHECKING:
    from taut.arm.description import Arm

__all__ = ["Servo", "load_servo", "matched_ratio", "reflected_inertia", "with_servos"]

MAX_BYTES: Final = 64 * 1024  # the largest such file met so far has 1 kB
SLOWEST: Final = 10.0  # [s] of a servo's own time constant; a wrong unit of its inertia makes hours of it

BASE: Final = {"friction_base": "N m", "friction_viscous": "N m s/rad"}
STRIBECK: Final = {"friction_stribeck": "N m", "dtheta_stribeck": "rad/s", "alpha": "1"}
LOAD: Final = {"load_friction_base": "1"}
DIRECTED: Final = {"load_friction_motor": "1", "load_friction_external": "1"}
EXCESS: Final = {"load_friction_motor_stribeck": "1", "load_friction_external_stribeck": "1"}
QUADRATIC: Final = {"load_friction_motor_quad": "1/(N m)", "load_friction_external_quad": "1/(N m)"}
NEEDED: Final[Mapping[str, Mapping[str, str]]] = {  # what each model of friction consists of
    "m1": BASE,
    "m2": BASE | STRIBECK,
    "m3": BASE | LOAD,
    "m4": BASE | STRIBECK | LOAD | {"load_friction_stribeck": "1"},
    "m5": BASE | STRIBECK | DIRECTED | EXCESS,
    "m6": BASE | STRIBECK | DIRECTED | EXCESS | QUADRATIC,
}
ARMATURE: Final = {"armature": "kg m^2"}
MOTOR: Final = {"kt": "N m/A", "R": "ohm"}
POSITIVE: Final = ("kt", "R", "dtheta_stribeck", "alpha")
LEFT_OUT: Final = {  # what else such files have, and what it is
    "q_offset": "the offset of the test bench that the servo was measured on [rad]",
    "error_gain_ratio": "a factor of the servo's own position controller",
    "max_velocity": "the speed limit of the servo's own position controller [rad/s]",
    "current_limit": "the current limit of the servo's own controller [A]",
    "ratio": "a factor of the servo's own position controller",
    "max_torque": "the torque limit of the servo's own controller [N m]",
}
WORDS: Final = ("model", "actuator")


@dataclass(frozen=True, kw_only=True, eq=False)
class Servo:
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
        notes: What was left out of the source, and what is to be doubted.

    Raises:
        ShapeError: Not one number each.
        RangeError: A negative number, or no finite one.

    Example:
        The Feetech STS3215 of the SO-101, as published with better-actuator-models 1.0.2, model m1:

        >>> sts3215 = Servo(
        ...     friction=Friction(coulomb=0.0524, viscous=0.0591), rotor_inertia=0.0284,
        ...     torque_constant=1.212, resistance=2.676, voltage=7.4,
        ... )
        >>> round(sts3215.stall_torque, 2), round(sts3215.no_load_speed, 2)
        (3.35, 6.11)
    """

    friction: Friction
    rotor_inertia: float
    torque_constant: float | None = None
    resistance: float | None = None
    voltage: float | None = None
    name: str = ""
    model: str = ""
    source: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.friction, Friction):  # callers without a type checker
            raise UsageError(
                f"a servo's friction must be a taut.Friction; got {type(self.friction).__name__}", name="friction"
            )
        for name in FRICTION_FIELDS:
            if np.ndim(getattr(self.friction, name)):
                shape = np.shape(getattr(self.friction, name))
                raise ShapeError(f"a servo's friction.{name} must be one number; got shape {shape}", name=name)
        rotor = finite_scalar("rotor_inertia", self.rotor_inertia, unit="kg m^2", minimum=0.0)
        object.__setattr__(self, "rotor_inertia", rotor)
        for name, unit in (("torque_constant", "N m/A"), ("resistance", "ohm"), ("voltage", "V")):
            if getattr(self, name) is not None:
                value = positive_scalar(name, getattr(self, name), unit=unit)
                object.__setattr__(self, name, value)

    @property
    def stall_torque(self) -> float:
        """The motor's torque at rest under its full voltage, of which friction takes a part [N m].

        Raises:
            UsageError: The torque constant, the resistance or the voltage is not known.
        """
        kt, R, u = self._known("stall torque", "torque_constant", "resistance", "voltage")
        return kt * u / R

    @property
    def no_load_speed(self) -> float:
        """The speed at which the motor has no torque left under its full voltage [rad/s].

        Raises:
            UsageError: The torque constant or the voltage is not known.
        """
        kt, u = self._known("no-load speed", "torque_constant", "voltage")
        return u / kt

    def _known(self, what: str, *names: str) -> list[float]:
        missing = [name for name in names if getattr(self, name) is None]
        if missing:
            raise UsageError(
                f"the {what} of a servo needs its {quoted_list(missing)}; give it: {_way_out(missing)}",
                name=missing[0],
            )
        return [float(getattr(self, name)) for name in names]


def _way_out(missing: list[str]) -> str:
    """A file has no voltage, and a loader asks for it; what else is missing only the one who has the servo knows."""
    if missing == ["voltage"]:
        return "taut.load_servo(path, voltage=...), or taut.Servo(...)"
    return f"dataclasses.replace(servo, {', '.join(f'{name}=...' for name in missing)}), or taut.Servo(...)"


def with_servos(arm: Arm, servos: Servo | Mapping[str, Servo]) -> Arm:
    """The arm with the friction and the rotors of servos, in all of its joints or in those that are named."""
    by_joint = dict(servos) if isinstance(servos, Mapping) else dict.fromkeys(arm.joint_names, servos)
    columns: dict[str, Float64Array] = {
        name: np.array(getattr(arm.friction, name), dtype=np.float64) for name in FRICTION_FIELDS
    }
    columns["rotor_inertia"], columns["gear"] = arm.rotor_inertia.copy(), arm.gear.copy()
    for name, servo in by_joint.items():
        i = arm.joint_index(name)
        if not isinstance(servo, Servo):  # callers without a type checker
            raise UsageError(
                f"with_servo takes a taut.Servo, or one by joint name; got {type(servo).__name__}", name=name
            )
        if arm.joints[i].kind == "prismatic":
            raise UsageError(
                f"joint '{name}' is prismatic, and a servo's numbers are those of a rotation; give the joint its own "
                "friction and rotor inertia, with_joints(...)",
                name=name,
            )
        for field in FRICTION_FIELDS:
            columns[field][i] = float(np.asarray(getattr(servo.friction, field)))
        columns["rotor_inertia"][i] = servo.rotor_inertia
        columns["gear"][i] = 1.0  # all of a servo's numbers are those of its output
    return arm.with_joints(**columns)


# -------------------------------------------------------------------- parameter files


def load_servo(path: str | os.PathLike[str], *, voltage: float | None = None) -> Servo:
    """A servo from a parameter file of the package better-actuator-models.

    The models m1 (viscous and Coulomb), m2 (Stribeck), m3 (load), m4 (load and Stribeck) and m5 (load, motor's and
    external torque apart) become a `Friction` exactly. m6 adds two terms in the square of the load; they are left
    out, and a note says how much they are.

    Args:
        path: The JSON file.
        voltage: Of the supply [V], which such files do not have; an STS3215 of the SO-101 runs on 7.4.

    Raises:
        FileError: The file cannot be read.
        ModelError: It is no such file, or its numbers break rules; `problems` has each.
        RangeError: A voltage that is not above zero.

    References:
        Duclusaud, Passault, Padois and Ly, Extended friction models for the physics simulation of servo
        actuators (2024).
    """
    file = readable_file("servo", path)
    data, twice = _object(file)
    model = data.get("model")
    problems = [
        Problem(object=file.name, attribute=key, message=f"'{key}' is there twice; delete one") for key in twice
    ]
    if not isinstance(model, str) or model not in NEEDED:
        rule = f"a servo file names its model of friction, {quoted_list(NEEDED)}"
        text = f"it has no 'model'; {rule}" if model is None else f"'model' is {_shown(model)}; {rule}"
        raise ModelError(str(file), [*problems, Problem(object=file.name, attribute="model", message=text)])
    problems += _file_problems(file.name, model, data)
    if problems:
        raise ModelError(str(file), problems)
    values = {key: float(value) for key, value in data.items() if key not in WORDS}
    servo = Servo(
        friction=_friction(model, values),
        rotor_inertia=values["armature"],
        torque_constant=values.get("kt"),
        resistance=values.get("R"),
        voltage=voltage,
        name=str(data.get("actuator", file.stem)),
        model=model,
        source=str(file),
    )
    return _noted(servo, values)


def _object(file: Path) -> tuple[dict[str, Any], list[str]]:
    """The one object of a file, and the names that stand twice in it."""
    twice: set[str] = set()

    def pairs(found: list[tuple[str, Any]]) -> dict[str, Any]:
        counts = Counter(name for name, _ in found)
        twice.update(name for name, count in counts.items() if count > 1)
        return dict(found)

    with file.open("rb") as stream:
        text = stream.read(MAX_BYTES + 1)
    if len(text) > MAX_BYTES:
        raise _refused(file, "size", f"the file is larger than {MAX_BYTES // 1024} kB; a servo file has 1 kB")
    try:
        data = json.loads(text.decode("utf-8"), object_pairs_hook=pairs)
    except UnicodeDecodeError as cause:
        raise _refused(file, "encoding", "the file is no text in UTF-8; a servo file is JSON") from cause
    except json.JSONDecodeError as cause:
        text_of = f"the file is not JSON: {cause.msg.lower()} in line {cause.lineno}, column {cause.colno}"
        raise _refused(file, "JSON", text_of, cause.lineno) from cause
    except (RecursionError, ValueError) as cause:  # too deep, or a whole number of thousands of digits
        raise _refused(
            file, "JSON", "the file is not JSON that a servo file could be: one object of numbers"
        ) from cause
    if not isinstance(data, dict):
        kind = "a list" if isinstance(data, list) else "one value"
        raise _refused(file, "JSON", f"the file holds {kind}; a servo file is one object of numbers by name")
    return data, sorted(twice)


def _refused(file: Path, attribute: str, message: str, line: int | None = None) -> ModelError:
    return ModelError(str(file), [Problem(object=file.name, attribute=attribute, message=message, line=line)])


def _file_problems(name: str, model: str, data: Mapping[str, Any]) -> Iterator[Problem]:
    needed = {**NEEDED[model], **ARMATURE}
    units = {**needed, **MOTOR}
    for key in needed:
        if key not in data:
            yield Problem(
                object=name, attribute=key, message=f"model {model} needs '{key}' [{units[key]}], which is missing"
            )
    for key, value in data.items():
        if key in WORDS:
            if not isinstance(value, str) or not value.isprintable():
                yield Problem(object=name, attribute=key, message=f"'{key}' must be a text; got {_shown(value)}")
        elif key not in units and key not in LEFT_OUT:
            yield Problem(object=name, attribute=key, message=_unknown(key, model, units))
        else:
            wrong = _wrong_number(key, value, units.get(key))
            if wrong is not None:
                yield Problem(object=name, attribute=key, message=wrong)


def _unknown(key: str, model: str, units: Mapping[str, str]) -> str:
    others = [other for other, needed in NEEDED.items() if key in needed]
    if others:
        return f"model {model} has no '{key}', which is of {' and '.join(others)}; is 'model' right?"
    return str(unknown_name("the file", "number", key, [*units, *LEFT_OUT])).replace(
        "has no number", "has an unknown"
    )


def _wrong_number(key: str, value: object, unit: str | None) -> str | None:
    tail = "" if unit is None else f" [{unit}]"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return f"'{key}' must be a number{tail}; got {_shown(value)}"
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        return f"'{key}' must be finite{tail}; got {number}"
    if unit is None:
        return None
    if key in POSITIVE and number <= 0.0:
        return f"'{key}' must be > 0{tail}; got {number:g}"
    return f"'{key}' must be >= 0{tail}; got {number:g}" if number < 0.0 else None


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _friction(model: str, values: Mapping[str, float]) -> Friction:
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


def _noted(servo: Servo, values: Mapping[str, float]) -> Servo:
    notes = [f"{key} is left out: {LEFT_OUT[key]}" for key in values if key in LEFT_OUT]
    quadratic = max((values[key] for key in QUADRATIC if key in values), default=0.0)
    if quadratic > 0.0:
        text = (
            "the two terms of m6 in the square of the load, which act near rest, are left out: up to "
            f"{quadratic:.3g} N m per (N m)^2 of load"
        )
        if None not in (servo.torque_constant, servo.resistance, servo.voltage):
            stall = servo.stall_torque
            text += f", {quadratic * stall * stall:.3g} N m at the stall torque of {stall:.3g} N m"
        notes.append(text)
    missing = [key for key in MOTOR if key not in values]
    if missing:
        notes.append(f"the file has no {quoted_list(missing)}, without which its motor is not known in full")
    if _doubtful(servo):
        notes.append(f"armature {servo.rotor_inertia:.4g} [kg m^2] is hard to believe of a servo; {OTHER_UNIT}")
    return dataclasses.replace(servo, notes=tuple(notes))


def _doubtful(servo: Servo) -> bool:
    """Whether the rotor would take ages to reach its speed, T = I R / kt^2, or is larger than any."""
    if servo.rotor_inertia > MAX_ROTOR:
        return True
    if servo.torque_constant is None or servo.resistance is None:
        return False
    return servo.rotor_inertia * servo.resistance > SLOWEST * servo.torque_constant * servo.torque_constant


# -------------------------------------------------------------------- gears


def reflected_inertia(ratio: ArrayLike, motor_inertia: ArrayLike) -> Float64Array:
    """What a joint sees of a rotor through its gear: ratio^2 motor_inertia [kg m^2 | kg].

    Law:  K = (I_link + G^2 I_motor) v^2 / 2, since the rotor turns G times as fast as the link

    Args:
        ratio: G, turns of the motor per turn of the joint; rad/m for a prismatic joint.
        motor_inertia: Of the rotor about its own axis [kg m^2].

    Raises:
        RangeError: A ratio that is not above zero, or a negative inertia.

    Example:
        A link of 1 kg m^2 with a rotor of 1e-3 kg m^2: in direct drive 99.9 % of the inertia is the link's; behind
        a gear of 100 the rotor is ten times the link.

        >>> round(100.0 / (1.0 + float(reflected_inertia(1.0, 1e-3))), 1)
        99.9
        >>> round(float(reflected_inertia(100.0, 1e-3)), 9)
        10.0

    References:
        Chapter, section 10.2.1.5 the effect of gearing.
    """
    G, rotor = _two("ratio", ratio, "motor_inertia", motor_inertia)
    require_range("ratio", G, above=0.0)
    require_range("motor_inertia", rotor, minimum=0.0, unit="kg m^2")
    return np.asarray(G**2 * rotor)


def matched_ratio(link_inertia: ArrayLike, motor_inertia: ArrayLike) -> Float64Array:
    """The gear ratio that gives the link half of the torque, and the most acceleration: sqrt(I_link / I_motor).

    Law:  a(G) = G tau / (I_link + G^2 I_motor) is largest where I_link = G^2 I_motor: inertia matched

    Args:
        link_inertia: About the joint's axis [kg m^2].
        motor_inertia: Of the rotor about its own axis [kg m^2].

    Raises:
        RangeError: An inertia that is not above zero.

    Example:
        >>> round(float(matched_ratio(1.0, 1e-3)), 2)
        31.62

    References:
        Chapter, section 10.2.1.5 the effect of gearing.
    """
    link, rotor = _two("link_inertia", link_inertia, "motor_inertia", motor_inertia)
    require_range("link_inertia", link, above=0.0, unit="kg m^2")
    require_range("motor_inertia", rotor, above=0.0, unit="kg m^2")
    return np.asarray(np.sqrt(link / rotor))


def _two(name: str, a: ArrayLike, other: str, b: ArrayLike) -> tuple[Float64Array, Float64Array]:
    first, second = finite_array(name, a), finite_array(other, b)
    try:
        np.broadcast_shapes(first.shape, second.shape)
    except ValueError as cause:
        raise ShapeError(
            f"{name} and {other} must be one number each or one per joint; got shapes {first.shape} and "
            f"{second.shape}",
            name=other,
        ) from cause
    return first, second
