"""load_arm: one way in, for a name, a URDF file or an MJCF file."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

from taut.arm.builtin import BUILT_IN
from taut.arm.description import Arm
from taut.arm.loaders.tree import Tree, assemble
from taut.base.checks import instance_of, readable_file
from taut.base.errors import FileError, ModelError, Problem, UsageError, unknown_name
from taut.base.types import ArrayLike
from taut.trace.pose import Pose

SUFFIXES: Final = (".urdf", ".xml", ".mjcf")


class PinocchioModel(Protocol):
    """A pinocchio.Model, recognised by one of its attributes; it has no types."""

    jointPlacements: Sequence[Any]


def load_arm(
    model: str | os.PathLike[str] | PinocchioModel | Tree,
    *,
    tool: str | None = None,
    T_WB: Pose | None = None,
    locked: Mapping[str, float | None] | None = None,
    home: Mapping[str, float] | ArrayLike | None = None,
    gravity: ArrayLike | None = None,
) -> Arm:
    """A robot arm, by name, from a file, or from a Pinocchio model. `Arm.from_screws` takes the textbook's lists.

    Args:
        model: A name (`taut arms` lists them), the path of a .urdf or an MJCF .xml file, or a pinocchio.Model.
        tool: Frame of payload and tasks; by default the catalogue's, or the only frame at an end.
        T_WB: Pose of the base in the world; at its origin by default.
        locked: Position [rad | m] of each locked joint, besides the catalogue's grippers; None sets a joint free.
        home: A pose to start from, by joint name or one entry per joint [rad | m].
        gravity: (3,) [m/s^2] in the world; by default the file's, or 9.81 downwards.

    Raises:
        ModelError: The model breaks rules; `problems` has each with object, attribute and line.
        FileError: The file cannot be read.
        UnknownNameError: No such arm, frame or joint.
        MissingExtraError: The arm's package is not installed.
        RangeError: A position out of limits, or not finite.
        UsageError: A wrong type, or a tool that must be named.

    Example:
        >>> load_arm("planar2").joint_names
        ('joint1', 'joint2')
        >>> load_arm("planar3", locked={"joint3": 0.0}).n
        2
    """
    instance_of("T_WB", T_WB, Pose | None, "a taut.Pose")
    instance_of("tool", tool, str | None, "the name of a frame")
    if locked is not None and not isinstance(locked, Mapping):
        raise UsageError(
            f"locked must be joint names with positions, {{'joint': 0.0}}; got {type(locked).__name__}", name="locked"
        )
    tree = open_model(model)
    chosen = dataclasses.replace(
        tree, locked={**tree.locked, **(locked or {})}, tool=tree.tool if tool is None else tool
    )
    if home is None or isinstance(home, Mapping):
        home = {**tree.home, **(home or {})}
    return assemble(Arm, chosen, T_WB=T_WB, gravity=gravity, home=home)


def open_model(model: str | os.PathLike[str] | PinocchioModel | Tree) -> Tree:
    """Find and read a model; problems of the model itself are kept in the tree."""
    if isinstance(model, Arm):
        raise UsageError("model is an Arm already; its methods (with_tool, mounted, subset, ...) give changed copies")
    if isinstance(model, Tree):
        return model
    if not isinstance(model, (str, os.PathLike)):
        if hasattr(model, "jointPlacements"):
            from taut.arm.loaders.memory import pinocchio_tree

            return pinocchio_tree(model)
        raise UsageError(f"model must be a name or a path; got {type(model).__name__}", name="model")
    if not str(model) or "\0" in str(model):
        raise UsageError(f"model must be a name or a path; got {model!r}", name="model")
    if isinstance(model, str) and model in BUILT_IN:
        return BUILT_IN[model]()

    from taut.arm.catalogue import CATALOGUE, entry_tree  # with the readers of files

    if isinstance(model, str) and model in CATALOGUE:
        return entry_tree(CATALOGUE[model])
    path = Path(model)
    if not isinstance(model, str) or path.suffix or len(path.parts) > 1 or _is_there(path):
        return _read(path)
    hint = "taut arms lists them; a file is named with its suffix, .urdf or .xml"
    raise unknown_name("taut", "arm", model, [*BUILT_IN, *CATALOGUE], hint=hint)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that is too long for a file
        return False


def _read(path: Path) -> Tree:
    """A file, by what its root element says it is."""
    file = readable_file("model", path)
    if file.suffix.lower() not in SUFFIXES:
        way_out = "; expand it first: xacro MODEL.xacro > MODEL.urdf" if file.suffix == ".xacro" else ""
        raise FileError(
            f"model '{file}' is neither a .urdf nor an MJCF .xml file{way_out}",
            name=str(file),
        )
    from taut.arm.loaders.xml import read_xml

    root = read_xml(file)
    if root.tag == "robot":
        from taut.arm.loaders.urdf import urdf_tree

        return urdf_tree(root, file)
    if root.tag == "mujoco":
        from taut.arm.loaders.mjcf import mjcf_tree  # with what it needs, for those who have such a file

        return mjcf_tree(root, file)
    way_out = "; convert it to URDF" if root.tag == "sdf" else ""
    text = f"its root element is <{root.tag}>; a robot model begins with <robot> (URDF) or <mujoco> (MJCF){way_out}"
    raise ModelError(str(file), [Problem(object=file.name, attribute=root.tag, message=text, line=root.line)])
