"""load_arm: one way in, for a name, a URDF file or an MJCF file."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

from taut.arm.builtin import BUILT_IN
from taut.arm.description import Arm
from taut.arm.loaders.tree import Tree, assemble, rest_position
from taut.base.checks import readable_file
from taut.base.errors import FileError, ModelError, Problem, UsageError, unknown_name
from taut.base.types import ArrayLike, Float64Array
from taut.trace.pose import Pose

SUFFIXES: Final = (".urdf", ".xml", ".mjcf")


class PinocchioModel(Protocol):
    """What is read of a pinocchio.Model, whose joints, placements, inertias and frames have no types."""

    name: str
    njoints: int
    nq: int
    names: Sequence[str]
    parents: Sequence[int]
    joints: Sequence[Any]
    jointPlacements: Sequence[Any]
    inertias: Sequence[Any]
    frames: Sequence[Any]
    gravity: Any
    lowerPositionLimit: Float64Array
    upperPositionLimit: Float64Array
    velocityLimit: Float64Array
    effortLimit: Float64Array
    friction: Float64Array
    damping: Float64Array
    armature: Float64Array
    rotorInertia: Float64Array
    rotorGearRatio: Float64Array


def load_arm(
    model: str | os.PathLike[str] | PinocchioModel | Tree,
    *,
    tool: str | None = None,
    T_WB: Pose | None = None,
    locked: Mapping[str, float | None] | None = None,
    joints: Iterable[str] | None = None,
    home: Mapping[str, float] | ArrayLike | None = None,
    gravity: ArrayLike | None = None,
) -> Arm:
    """A robot arm, by name, from a file, or from a Pinocchio model. `Arm.from_screws` takes the textbook's lists.

    Args:
        model: A name (`taut arms` lists them), the path of a .urdf or an MJCF .xml file, or a pinocchio.Model.
        tool: Frame of payload and tasks; by default the catalogue's, or the only frame at an end.
        T_WB: Pose of the base in the world; at its origin by default.
        locked: Position [rad | m] of each locked joint, besides the catalogue's grippers; None sets a joint free.
        joints: The only joints that move; all others are locked at home.
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
        >>> load_arm("planar3", joints=["joint1", "joint2"]).n
        2
    """
    if T_WB is not None and not isinstance(T_WB, Pose):
        raise UsageError(f"T_WB must be a taut.Pose; got {type(T_WB).__name__}", name="T_WB")
    if tool is not None and not isinstance(tool, str):
        raise UsageError(f"tool must be the name of a frame; got {type(tool).__name__}", name="tool")
    tree = open_model(model)
    start: Mapping[str, float] | ArrayLike = tree.home if home is None else home
    if isinstance(start, Mapping):
        _require_names("home", start)
        start = {**tree.home, **start}
    held = _held_joints(tree, locked, joints, start if isinstance(start, Mapping) else tree.home)
    chosen = dataclasses.replace(tree, locked=held, tool=tree.tool if tool is None else tool)
    return assemble(Arm, chosen, T_WB=T_WB, gravity=gravity, home=start)


def _held_joints(
    tree: Tree,
    locked: Mapping[str, float | None] | None,
    joints: Iterable[str] | None,
    home: Mapping[str, float],
) -> dict[str, float]:
    """The joints that are held: the catalogue's, the caller's, and all that `joints` leaves out."""
    if locked is not None and not isinstance(locked, Mapping):
        raise UsageError(
            f"locked must be joint names with positions, {{'joint': 0.0}}; got {type(locked).__name__}", name="locked"
        )
    locked, movable = locked or {}, tree.movable
    _require_names("locked", locked)
    held = dict(tree.locked)
    for name, position in locked.items():
        if position is not None:
            held[name] = position
        elif name in movable:
            held.pop(name, None)
        else:
            raise unknown_name(f"model '{tree.name}'", "joint", name, movable)
    if joints is None:
        return held
    keep = [joints] if isinstance(joints, str) or not isinstance(joints, Iterable) else list(joints)
    if not keep:
        raise UsageError("joints must name one joint at least; got none", name="joints")
    _require_names("joints", keep)
    for name in keep:
        if name not in movable:
            raise unknown_name(f"model '{tree.name}'", "joint", name, movable)
        if name in locked and name in held:
            raise UsageError(f"joint '{name}' is both in joints= and in locked=; take it out of one", name=name)
    at_home = {name: home.get(name, rest_position(joint)) for name, joint in movable.items()}
    return {name: position for name, position in (at_home | held).items() if name not in keep}


def _require_names(argument: str, names: Iterable[object]) -> None:
    for name in names:
        if not isinstance(name, str):
            raise UsageError(
                f"{argument} must name joints; got {name!r}, which is no name", name=argument, value=name
            )


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

    from taut.arm.catalogue import CATALOGUE, PATTERN, described, entry_tree  # with the readers of files

    if isinstance(model, str) and model in CATALOGUE:
        return entry_tree(CATALOGUE[model])
    path = Path(model)
    if not isinstance(model, str) or path.suffix or len(path.parts) > 1 or _is_there(path):
        return _read(path, {})
    if PATTERN.match(model):
        return _read(*described(model))
    hint = "taut arms lists them; a file is named with its suffix, .urdf or .xml"
    raise unknown_name("taut", "arm", model, [*BUILT_IN, *CATALOGUE], hint=hint)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that is too long for a file
        return False


def _read(path: Path, packages: Mapping[str, Path]) -> Tree:
    """A file, by what its root element says it is."""
    try:
        file = readable_file("model", path)
    except OSError as cause:
        if isinstance(cause, FileError):
            raise
        raise FileError(f"model '{path}' cannot be opened: {cause.strerror}", name=str(path)) from cause
    if file.suffix.lower() not in SUFFIXES:
        way_out = "; expand it first: xacro MODEL.xacro > MODEL.urdf" if file.suffix == ".xacro" else ""
        raise FileError(
            f"model '{file}' is no .urdf and no MJCF .xml file, and taut reads arms from no others{way_out}",
            name=str(file),
        )
    from taut.arm.loaders.xml import read_xml

    root = read_xml(file)
    if root.tag == "robot":
        from taut.arm.loaders.urdf import urdf_tree

        return urdf_tree(root, file, packages)
    if root.tag == "mujoco":
        from taut.arm.loaders.mjcf import mjcf_tree  # with what it needs, for those who have such a file

        return mjcf_tree(root, file)
    way_out = "; convert it to URDF" if root.tag == "sdf" else ""
    text = f"its root element is <{root.tag}>; a robot model begins with <robot> (URDF) or <mujoco> (MJCF){way_out}"
    raise ModelError(str(file), [Problem(object=file.name, attribute=root.tag, message=text, line=root.line)])
