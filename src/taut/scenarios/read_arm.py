"""The arms of a scenario: [arm], which the controllers believe, and [plant], which is true."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taut.arm.builtin import BUILT_IN, COMMANDS, one_joint_tree
from taut.arm.catalogue import CATALOGUE, PATTERN
from taut.arm.change import joints_replaced
from taut.arm.description import Arm
from taut.arm.friction import Friction
from taut.arm.load import OpenedModel, arm_of, load_arm, open_model
from taut.base.errors import TautError, UsageError
from taut.scenarios.read_joints import friction_word, joints_changed
from taut.scenarios.read_pose import pose_table
from taut.scenarios.toml import Section, file_beside

__all__ = ["read_arm", "read_true_arm"]


def read_arm(section: Section, folder: Path) -> Arm:
    """The controllers' model of the arm, from [arm]; a file of it is looked for in `folder`."""
    opened = _opened(section, folder)
    given = {
        "tool": section.text("tool", None),
        "T_WB": pose_table(section.section("T_WB")) if "T_WB" in section else section.take("T_WB", None),
        "gravity": section.numbers("gravity", None),
        "locked": section.take("locked", None),
        "joints": section.take("joints", None),
        "home": section.take("home", None),
    }
    arm = _assembled(section, opened, {key: value for key, value in given.items() if value is not None})
    if friction_word(section, "none") == "none":
        arm = arm.with_friction(Friction())
    if "tool_offset" in section:
        offset = pose_table(section.section("tool_offset"))
        with section.blamed("tool_offset"):
            arm = arm.with_tool(arm.tool, offset)
    section.take("tool_offset", None)  # known, so that a misspelt one is compared with it
    arm = _changed(section, arm)
    section.done()
    return arm


def read_true_arm(section: Section, believed: Arm, folder: Path) -> Arm:
    """The plant's arm: the believed one, or another model, with the changes that [plant] states."""
    if "model" not in section:
        section.take("model", None)
        return _changed(section, believed)
    name = section.text("model")
    with section.blamed("model"):
        arm = load_arm(_model(name, folder))
    return _changed(section, arm)


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
    return (
        str(file_beside("model", name, folder)) if name and is_file and name not in (*BUILT_IN, *CATALOGUE) else name
    )


def _opened(section: Section, folder: Path) -> OpenedModel:
    """The model of [arm], and the chapter's link with other numbers: link = { M, m, r, b }."""
    model = section.text("model")
    if "link" not in section:
        section.take("link", None)
        with section.blamed("model"):
            return open_model(_model(model, folder))
    if model != "one_joint":
        raise section.error(f"link is for the model 'one_joint'; got model '{model}'")
    link = section.section("link")
    numbers = {word: link.number(word, None) for word in ("M", "m", "r", "b")}
    link.done()
    with link.blamed():
        tree = one_joint_tree(**{word: number for word, number in numbers.items() if number is not None})
    return OpenedModel(tree=tree, commands=COMMANDS)


def _assembled(section: Section, opened: OpenedModel, given: Mapping[str, Any]) -> Arm:
    """The arm with all that is given, else an error that names the first key with which it cannot be."""
    with section.blamed("model"):
        try:
            return arm_of(opened, **given)
        except TautError:
            tried: dict[str, Any] = {}
            for key, value in given.items():
                tried[key] = value
                with section.blamed(key):
                    arm_of(opened, **tried)
            raise


def _changed(section: Section, arm: Arm) -> Arm:
    """The arm with the changes that a section states."""
    bodies = section.section("bodies")
    for joint in bodies.left:
        body = bodies.section(joint)
        change = {"mass": body.number("mass", None)}
        change |= {word: body.numbers(word, None) for word in ("com", "inertia")}
        body.done()
        with body.blamed():
            arm = arm.with_body(joint, **change)
    arm = joints_changed(section, arm)
    if "perturbed" in section:
        spread = section.section("perturbed")
        spread.only("seed", "mass", "com", "inertia", "friction")
        seed = spread.whole("seed")
        numbers = {word: spread.number(word, 0.0) for word in ("mass", "com", "inertia", "friction")}
        with spread.blamed():
            arm = arm.perturbed(seed=seed, **numbers)
    values = section.section("joint_values")
    with values.blamed():
        arm = joints_replaced(arm, {key: values.take(key) for key in values.left})
    if "payload" in section:
        load = section.section("payload")
        load.only("mass", "com", "inertia")
        mass, com = load.number("mass"), load.numbers("com", [0.0, 0.0, 0.0])
        inertia = load.numbers("inertia", [0.0] * 6)
        with load.blamed():
            arm = arm.with_payload(mass, com, inertia)
    for key in ("perturbed", "payload"):
        section.take(key, None)  # known, so that a misspelt one is compared with it
    return arm
