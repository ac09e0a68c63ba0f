"""The arms of a scenario: [arm], which the controllers believe, and [plant], which is true."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.arm.builtin import BUILT_IN, COMMANDS, one_joint_tree
from taut.arm.catalogue import CATALOGUE, PATTERN
from taut.arm.change import joints_replaced
from taut.arm.description import Arm
from taut.arm.friction import AT_REST, FRICTION_FIELDS, Friction
from taut.arm.load import OpenedModel, arm_of, load_arm, open_model
from taut.base.checks import finite_array
from taut.base.errors import TautError, UsageError
from taut.base.types import Float64Array
from taut.scenarios.reading import arguments, read, reads, value
from taut.scenarios.toml import Table, file_beside
from taut.trace.pose import Pose

__all__ = ["OF_TRUE_ARM", "friction_word", "pose_of", "read_arm", "read_true_arm"]

OF_ARM: Final = ("model", "link", "tool_offset")  # and what `arm_of` takes
OF_CHANGES: Final = ("bodies", "friction", "gears", "rotor_inertia", "perturbed", "joint_values", "payload")
OF_TRUE_ARM: Final = ("model", *OF_CHANGES)


@reads(Pose)
def pose_of(table: Table, key: str) -> Pose:
    """A pose, { p = [0.4, 0.0, 0.3], rpy = [3.14, 0.0, 0.0] }; what is left out is zero."""
    below = table.table(key)
    return below_pose(below)


def below_pose(table: Table) -> Pose:
    """The pose of a table."""
    made: Pose = read(
        Pose, table if "p" in table else Table(table.file, table.path, {**table.values, "p": [0.0] * 3})
    )
    return made


def read_arm(table: Table, folder: Path) -> Arm:
    """The controllers' model of the arm, from [arm]; a file of it is looked for in `folder`."""
    choices = {name: argument for name, argument in arguments(arm_of).items() if name != "opened"}
    table.only([*OF_ARM, *choices, *OF_CHANGES])
    opened = _opened(table, folder)
    given = {name: value(argument, table, name) for name, argument in choices.items() if name in table}
    arm = _assembled(table, opened, given)
    if friction_word(table, "none") == "none":
        arm = arm.with_friction(Friction())
    if "tool_offset" in table:
        offset = pose_of(table, "tool_offset")
        with table.blamed("tool_offset"):
            arm = arm.with_tool(arm.tool, offset)
    return _changed(table, arm)


def read_true_arm(table: Table, believed: Arm, folder: Path) -> Arm:
    """The plant's arm: the believed one, or another model, with the changes that [plant] states."""
    if "model" not in table:
        return _changed(table, believed)
    name = table.text("model")
    with table.blamed("model"):
        arm = load_arm(_model(name, folder))
    return _changed(table, arm)


# -------------------------------------------------------------------- the model


def _model(name: str, folder: Path) -> str:
    """A name that taut knows, else the path of a file."""
    path = Path(name)
    if PATTERN.match(name) and not os.path.exists(folder / path):  # noqa: PTH110
        raise UsageError(
            f"'{name}' is a model of the package robot_descriptions, which downloads it when asked, and a scenario "
            "downloads nothing; name the path of its file",
            name="model",
        )
    is_file = bool(path.suffix) or len(path.parts) > 1 or os.path.exists(folder / path)  # noqa: PTH110  (long names)
    known = (*BUILT_IN, *CATALOGUE)
    return str(file_beside("model", name, folder)) if name and is_file and name not in known else name


def _opened(table: Table, folder: Path) -> OpenedModel:
    """The model of [arm], and the chapter's link with other numbers: link = { M, m, r, b }."""
    table.need("model")
    model = table.text("model")
    if "link" not in table:
        with table.blamed("model"):
            return open_model(_model(model, folder))
    if model != "one_joint":
        raise table.error(f"is for the model 'one_joint'; got model '{model}'", "link")
    return OpenedModel(tree=read(one_joint_tree, table.table("link")), commands=COMMANDS)


def _assembled(table: Table, opened: OpenedModel, given: Mapping[str, Any]) -> Arm:
    """The arm with all that is given, else an error that names the first key with which it cannot be."""
    with table.blamed("model"):
        try:
            return arm_of(opened, **given)
        except TautError:
            tried: dict[str, Any] = {}
            for key, each in given.items():
                tried[key] = each
                with table.blamed(key):
                    arm_of(opened, **tried)
            raise


# -------------------------------------------------------------------- its changes


def _changed(table: Table, arm: Arm) -> Arm:
    """The arm with the changes that a table states."""
    bodies = table.table("bodies")
    for joint in bodies.values:
        arm = read(arm.with_body, bodies.table(joint), joint=joint)
    if isinstance(table.get("friction"), dict):
        arm = _with_friction(table.table("friction"), arm)
    arm = _with_rotors(table, arm)
    if "perturbed" in table:
        arm = read(arm.perturbed, table.table("perturbed"))
    values = table.table("joint_values")
    with values.blamed():
        arm = joints_replaced(arm, values.values)
    return read(arm.with_payload, table.table("payload")) if "payload" in table else arm


def friction_word(table: Table, *words: str) -> str | None:
    """The word that `friction` is, if it is no table."""
    word = table.get("friction")
    if word is None or isinstance(word, dict) or (isinstance(word, str) and word in words):
        return None if isinstance(word, dict) else word
    known = ", ".join(f'"{each}"' for each in words)
    raise table.error(
        f"must be {known} or a table of its numbers, [{table.below('friction')}]; got {word!r}", "friction"
    )


def _with_friction(table: Table, arm: Arm) -> Arm:
    """A joint that is not named has none; at rest it has what it has in motion."""
    table.only(FRICTION_FIELDS)
    columns: dict[str, Float64Array] = {}
    for name in FRICTION_FIELDS:
        if name in table:
            others = columns.get(AT_REST.get(name, ""), np.array(2.0 if name == "stribeck_shape" else 0.0))
            with table.blamed(name):
                columns[name] = _column(name, table.get(name), arm, others)
    with table.blamed():
        return arm.with_friction(Friction(**columns))


def _column(name: str, given: Any, arm: Arm, others: Float64Array) -> Float64Array:
    """One number, or (n,); `others` are those of joints that are not named."""
    if isinstance(given, dict):
        column = np.broadcast_to(others, (arm.n,)).copy()
        for joint, number in given.items():
            column[arm.joint_index(joint)] = finite_array(joint, number, shape=())
        return column
    numbers = finite_array(name, given)
    return finite_array(name, given, shape=(arm.n,), joints=arm.joint_names) if numbers.ndim else numbers


def _with_rotors(table: Table, arm: Arm) -> Arm:
    """gears = { ratio, motor_inertia }, or with rotor_inertia, as the joint feels it, beside it."""
    rotor = table.get("rotor_inertia")
    if "gears" in table:
        gears = table.table("gears")
        if rotor is None:
            arm = read(arm.with_gears, gears)
        else:
            gears.only(("ratio", "motor_inertia"))
            if "motor_inertia" in gears:
                raise gears.error(f"and rotor_inertia of [{table.path}] say the same; keep one", "motor_inertia")
            gears.need("ratio")
            with gears.blamed("ratio"):
                arm = arm.with_joints(gear=gears.get("ratio"))
    with table.blamed("rotor_inertia"):
        return arm if rotor is None else arm.with_joints(rotor_inertia=rotor)
