"""A tip of the tool that gives way: passive compliance between the arm and what it touches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

from taut.base.errors import ShapeError
from taut.base.quantity import Quantity, keep_quantities
from taut.base.types import ArrayLike

if TYPE_CHECKING:
    import mujoco

__all__ = ["SpringTip", "add_tip"]

STOP: Final = (0.95, 0.99, 1e-3, 0.5, 2.0)  # impedance of the ends of the way


@dataclass(frozen=True, kw_only=True, eq=False)
class SpringTip:
    """A tip on a spring, that is pushed back along the tool's z axis: what touches the scene in a MujocoPlant.

    Law:          mass z'' + damping z' + stiffness z = the force of what it touches along the tool's -z axis, with z
                  from 0, where the tip is at the tool's origin, to the end of its travel

    The law of the arm knows nothing of it: the tool's frame stays where it is. F_ext is what is touched on the tip.

    Args:
        stiffness: [N/m].
        damping: [N s/m].
        mass: [kg] of what moves, added to the plant's payload.
        travel: [m] to the stop.

    Raises:
        RangeError: A number that is not above zero, or a negative damping.
        ShapeError: More than one number.

    Example:
        >>> SpringTip(stiffness=1000.0).travel.item()
        0.02
    """

    title: ClassVar[str] = "tip"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "stiffness": Quantity(unit="N/m", rule="> 0", instead="for a rigid tool leave the tip out"),
        "damping": Quantity(unit="N s/m", rule=">= 0"),
        "mass": Quantity(unit="kg", rule="> 0", instead="0.01 is little"),
        "travel": Quantity(unit="m", rule="> 0", instead="for a rigid tool leave the tip out"),
    }

    stiffness: ArrayLike
    damping: ArrayLike = 10.0
    mass: ArrayLike = 0.02
    travel: ArrayLike = 0.02

    def __post_init__(self) -> None:
        keep_quantities(self)
        for name in self.quantities:
            shape = getattr(self, name).shape
            if shape:
                raise ShapeError(f"tip.{name} must be one number; got shape {shape}", name=name)


def add_tip(tool: mujoco.MjsBody, tip: SpringTip, name: str, radius: float) -> mujoco.MjsBody:
    """The body of the tip, on that of the tool."""
    import mujoco

    mass = float(tip.mass)  # type: ignore[arg-type]  # checked when it was made
    body = tool.add_body(name=name)
    body.mass, body.inertia, body.explicitinertial = mass, [0.4 * mass * radius**2] * 3, True
    joint = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, -1.0])
    joint.stiffness, joint.damping = [float(tip.stiffness), 0.0, 0.0], [float(tip.damping), 0.0, 0.0]  # type: ignore[arg-type]
    joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, [0.0, float(tip.travel)]  # type: ignore[arg-type]
    joint.solimp_limit = STOP
    return body
