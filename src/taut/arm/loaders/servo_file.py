"""Servo parameter files: the JSON of the package better-actuator-models (BAM), one object of numbers by name.

Its models of friction m1 to m5 are exactly a `Friction`; what m6 and the test bench add has no place in it and is
named in the notes.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from taut.arm.friction import Friction
from taut.arm.gears import MOST_ROTOR, OTHER_UNIT
from taut.arm.servo import Servo
from taut.base.checks import readable_file
from taut.base.errors import ModelError, Problem, quoted_list, unknown_name

__all__ = ["load_servo"]

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
    problems += _problems(file.name, model, data)
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


def _problems(name: str, model: str, data: Mapping[str, Any]) -> Iterator[Problem]:
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
    if servo.rotor_inertia > MOST_ROTOR:
        return True
    if servo.torque_constant is None or servo.resistance is None:
        return False
    return servo.rotor_inertia * servo.resistance > SLOWEST * servo.torque_constant * servo.torque_constant
