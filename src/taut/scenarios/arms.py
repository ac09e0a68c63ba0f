"""The arms of a scenario: [arm], which the controllers assume, and [plant], which is true."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from taut.arm.builtin import BUILT_IN, one_joint_tree
from taut.arm.catalogue import CATALOGUE, PATTERN
from taut.arm.change import joints_replaced
from taut.arm.description import Arm
from taut.arm.friction import Friction
from taut.arm.load import arm_of, load_arm, open_model
from taut.scenarios.reading import Table, read
from taut.trace.pose import Pose

__all__ = ["OF_TRUE_ARM", "friction_word", "read_arm", "read_true_arm"]

CHANGES: Final = ("bodies", "friction", "gears", "perturbed", "joint_values", "payload")
OF_TRUE_ARM: Final = ("model", *CHANGES)


def read_arm(table: Table) -> Arm:
    """The controllers' model of the arm, from [arm]."""
    table.need("model")
    model, link = table.text("model"), table.table("link")
    if not link.values:
        with table.blamed("model"):
            tree = open_model(_model(table))
    elif model == "one_joint":
        tree = read(one_joint_tree, link)
    else:
        raise table.error(f"is for the model 'one_joint'; got model '{model}'", "link")
    others = ("model", "link", "tool_offset", *CHANGES)
    arm: Arm = read(arm_of, table, others=others, blame="model", tree=tree)
    if friction_word(table, "none") == "none":
        arm = arm.with_friction(Friction())
    if "tool_offset" in table:
        offset = read(Pose, table.table("tool_offset"))
        with table.blamed("tool_offset"):
            arm = arm.with_tool(arm.tool, offset)
    return _changed(table, arm)


def read_true_arm(table: Table, assumed: Arm) -> Arm:
    """The plant's arm: the assumed one, or another model, with the changes that [plant] states."""
    if "model" not in table:
        return _changed(table, assumed)
    with table.blamed("model"):
        arm = load_arm(_model(table))
    return _changed(table, arm)


def _model(table: Table) -> str:
    """A name that taut knows, else the path of a file."""
    name = table.text("model")
    path = Path(name)
    there = os.path.exists(table.folder / path)  # noqa: PTH110  (long names)
    if not there and PATTERN.match(name):
        raise table.error(
            f"'{name}' is of the package robot_descriptions, which downloads it when asked, and a scenario downloads "
            "nothing; name the path of its file",
            "model",
        )
    is_file = (
        name and name not in BUILT_IN and name not in CATALOGUE and (path.suffix or len(path.parts) > 1 or there)
    )
    return str(table.file_of("model", "model")) if is_file else name


def friction_word(table: Table, *words: str) -> str | None:
    """The word that `friction` is, if it is no table."""
    return None if isinstance(table.get("friction"), dict) else table.choice("friction", words)


def _changed(table: Table, arm: Arm) -> Arm:
    """The arm with the changes that a table states."""
    bodies = table.table("bodies")
    for joint in bodies.values:
        arm = read(arm.with_body, bodies.table(joint), joint=joint)
    if isinstance(table.get("friction"), dict):
        below = table.table("friction")
        friction = read(Friction, below)
        with below.blamed():
            arm = arm.with_friction(friction)
    if "gears" in table:
        arm = read(arm.with_gears, table.table("gears"))
    if "perturbed" in table:
        arm = read(arm.perturbed, table.table("perturbed"))
    values = table.table("joint_values")
    with values.blamed():
        arm = joints_replaced(arm, values.values)
    return read(arm.with_payload, table.table("payload")) if "payload" in table else arm
