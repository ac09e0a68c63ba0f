"""What the joints of a scenario's arm are made of: friction, gears and rotors, in [arm] and in [plant]."""

from __future__ import annotations

from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.arm.friction import AT_REST, FRICTION_FIELDS, Friction
from taut.base.checks import finite_array
from taut.base.types import Float64Array
from taut.scenarios.toml import Section

__all__ = ["friction_word", "joints_changed"]


def friction_word(section: Section, *words: str) -> str | None:
    """The word that `friction` is, if it is no table."""
    word = section.peek("friction")
    if isinstance(word, dict):
        return None
    if word is not None and word not in words:
        known = ", ".join(f'"{each}"' for each in words)
        table = section.below("friction")
        raise section.error(f"friction must be {known} or a table of its numbers, [{table}]; got {word!r}")
    return section.text("friction", None)  # type: ignore[no-any-return]


def joints_changed(section: Section, arm: Arm) -> Arm:
    """The arm with the friction, gears and rotors of a section. Each number is one, one per joint, or by joint name.

    Args:
        section: [arm] or [plant].
        arm: The arm without them. A table of friction takes the place of all of its friction; gears and rotors that
            are given by joint name leave the other joints as they are.
    """
    if isinstance(section.peek("friction"), dict):
        arm = _with_friction(section.section("friction"), arm)
    return _with_rotors(section, arm)


def _with_friction(section: Section, arm: Arm) -> Arm:
    """A joint that is not named has none; at rest it has what it has in motion."""
    section.only(*FRICTION_FIELDS)
    columns: dict[str, Float64Array] = {}
    for name in FRICTION_FIELDS:
        if name in section:
            others = columns.get(AT_REST.get(name, ""), np.array(2.0 if name == "stribeck_shape" else 0.0))
            columns[name] = _column(section, name, arm, others)
    with section.blamed():
        return arm.with_friction(Friction(**columns))


def _with_rotors(section: Section, arm: Arm) -> Arm:
    """gears = { ratio, motor_inertia }, or with rotor_inertia, as the joint feels it, beside it."""
    rotor = _by_joint(section, "rotor_inertia") if "rotor_inertia" in section else section.take("rotor_inertia", None)
    if "gears" in section:
        gears = section.section("gears")
        ratio = _by_joint(gears, "ratio")
        if rotor is None:
            inertia = _by_joint(gears, "motor_inertia")
            gears.done()
            with gears.blamed():
                arm = arm.with_gears(ratio, inertia)
        elif "motor_inertia" in gears:
            raise gears.error(f"motor_inertia and rotor_inertia of [{gears.above}] say the same; keep one")
        else:
            gears.done()
            with gears.blamed("ratio"):
                arm = arm.with_joints(gear=ratio)
    section.take("gears", None)  # known, so that a misspelt one is compared with it
    with section.blamed("rotor_inertia"):
        return arm if rotor is None else arm.with_joints(rotor_inertia=rotor)


def _by_joint(section: Section, key: str) -> Any:
    """A number, an array, or numbers by joint name."""
    if not isinstance(section.peek(key), dict):
        return section.numbers(key)
    table = section.section(key)
    return {joint: table.number(joint) for joint in table.left}


def _column(section: Section, key: str, arm: Arm, others: Float64Array) -> Float64Array:
    """One number or (n,) of a key; `others` are those of joints that it does not name."""
    given = _by_joint(section, key)
    with section.blamed(key):
        if isinstance(given, dict):
            column = np.broadcast_to(others, (arm.n,)).copy()
            for joint, value in given.items():
                column[arm.joint_index(joint)] = value
            return column
        numbers = finite_array(key, given)
        if numbers.ndim:
            finite_array(key, given, shape=(arm.n,), joints=arm.joint_names)
        return numbers
