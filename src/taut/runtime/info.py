"""What a run keeps of its start: tool, impedance of the law, limits, and what stood around the arm for its films."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from taut.arm.description import Arm
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.control.laws.apparent import felt_impedance
from taut.control.lawside import LawSide
from taut.control.side_by_side import SideBySide
from taut.control.tasks.task import Task
from taut.loop import AnyPlant
from taut.maths.chain import Chain
from taut.maths.constraints.functions import Surface
from taut.maths.constraints.rows import OfPoses
from taut.maths.model import Model, PayloadValues
from taut.maths.snapshot import Snapshot
from taut.plant.contact import each_contact
from taut.plant.rigid import RigidPlant
from taut.record.info import Around, PartInfo, Shape, Thing
from taut.trace.pose import Pose

__all__ = ["around_info", "tool_info"]

BOARD: Final = (0.2, 0.35, 0.3, 1.0)
HOLLOW: Final = (0.2, 0.35, 0.3, 0.35)  # what the tool is inside of lets it be seen
SURFACE_HALF_WIDTH: Final = 0.25  # [m] of a surface to each side of the tool
THICKNESS: Final = 0.005  # [m] half of what is drawn
PERIOD: Final = 0.02  # [s] between two places of a surface that moves


@runtime_checkable
class HasAround(Protocol):
    """A plant that knows what stands around its arm."""

    def around(self) -> Around: ...


def around_info(plant: AnyPlant, q: Float64Array, duration: float) -> Around:
    """What stands around the arm.

    Args:
        plant: The plant.
        q: (n,) positions at the start [rad | m].
        duration: [s] of the run.
    """
    if isinstance(plant, HasAround):
        return plant.around()
    return _of_model(plant, q, duration) if isinstance(plant, RigidPlant) else Around()


def _of_model(plant: RigidPlant, q: Float64Array, duration: float) -> Around:
    """The surfaces that contacts and walls declare."""
    things: list[Thing] = []
    missing: list[str] = []
    x = Snapshot(plant.model, q=q, v=np.zeros(len(q)))
    for contact in () if plant.contact is None else each_contact(plant.contact):
        for piece in contact.constraint.pieces:
            if isinstance(piece, OfPoses) and piece.surface is not None:
                things.append(_thing(piece.surface, x.T(piece.frames[0]).p, duration))
            else:
                missing.append(f"a constraint of {piece.count} rows that declares no surface")
    values = {} if plant.environment is None else plant.environment.parameters()
    for point, normal in _walls(values):
        wall = Surface(kind="plane", point=point, axis=normal / np.linalg.norm(normal))
        things.append(_thing(wall, x.T().p, duration))
    return Around(things=tuple(things), missing=tuple(missing))


def _walls(values: Mapping[str, Float64Array]) -> Iterator[tuple[Float64Array, Float64Array]]:
    """Points and normals of the walls among what touches the tool."""
    for path, normal in values.items():
        place = path.removesuffix("normal") + "point"
        if path.endswith("normal") and place in values:
            yield values[place], normal


def _thing(surface: Surface, p: Float64Array, duration: float) -> Thing:
    """A surface as it is drawn near a point p."""
    n, rgba = surface.axis, HOLLOW if surface.inside else BOARD
    if surface.kind == "sphere":
        ball = Shape(kind="sphere", size=(surface.radius, 0.0, 0.0), rgba=rgba)
        return Thing(shapes=(ball,), p=_numbers(surface.point))
    along = float(n @ (p - surface.point))
    if surface.kind == "cylinder":
        pipe = Shape(kind="cylinder", size=(surface.radius, SURFACE_HALF_WIDTH, 0.0), rgba=rgba)
        return Thing(shapes=(pipe,), p=_numbers(surface.point + along * n), wxyz=_along(n))
    board = Shape(kind="box", size=(SURFACE_HALF_WIDTH, SURFACE_HALF_WIDTH, THICKNESS), rgba=rgba)
    times: tuple[float, ...] = ()
    shifts: tuple[tuple[float, ...], ...] = ()
    if surface.displacement is not None:
        times = _numbers(np.linspace(0.0, duration, max(2, round(duration / PERIOD) + 1)))
        shifts = tuple(_numbers(surface.displacement(t) * n) for t in times)
    at = p - (along + THICKNESS) * n  # the board's face is the plane
    return Thing(shapes=(board,), p=_numbers(at), wxyz=_along(n), times=times, shifts=shifts)


def _along(z: Float64Array) -> tuple[float, ...]:
    """Quaternion wxyz of axes whose z looks along a unit vector."""
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return _numbers(Pose.of(np.column_stack([x, np.cross(z, x), z]), np.zeros(3)).wxyz)


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(float(x) for x in values)


def tool_info(law: Law | Task, side: LawSide, q: Float64Array, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of RunInfo about tool and limits, by name.

    Args:
        law: The law with the gains of the run.
        side: The law side of the loop.
        q: (n,) positions at the start [rad | m].
        parameters: Parameters of the law side by path.
    """
    payload = {name: np.array(value) for name, value in subtree(parameters, "model.payload").items()}
    x = Snapshot(side.model, q=q, v=np.zeros(len(q)), payload=PayloadValues.of(payload))
    own = _of_law(law, side.model, x)
    out: dict[str, Any] = {"tool": own.tool, "impedance": own.impedance, "limits": _limits(side.arm)}
    if isinstance(law, SideBySide):
        seen = law.seen(x)
        out["parts"] = {
            name: _of_law(part, seen[name].model, seen[name], joints=seen[name].arm.joint_names)
            for name, part in law.parts.items()
        }
    if isinstance(law, Task):
        out["phases"] = {
            name: _of_law(law.laws[name], side.model, x, follows=law.follows(name)) for name in law.phases
        }
    return out


def _limits(arm: Arm) -> dict[str, dict[str, float]]:
    """Effort and velocity limits by joint, of those that have one."""
    return {
        name: {joint: float(most) for joint, most in zip(arm.joint_names, values, strict=True) if np.isfinite(most)}
        for name, values in (("effort", arm.effort), ("velocity", arm.velocity))
    }


def _of_law(
    law: Law | Task, model: Model, x: Snapshot, *, joints: tuple[str, ...] = (), follows: str | None = None
) -> PartInfo:
    frame = law.controlled_frame
    impedance = None
    if isinstance(law, Law) and frame in (None, model.arm.tool):  # F_ext is taken at the arm's tool
        impedance = felt_impedance(law, x)
    return PartInfo(tool=Chain.of(model, frame), impedance=impedance, joints=joints, follows=follows)
