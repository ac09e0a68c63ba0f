"""What an Arm is made of: joints, bodies, frames, shapes to draw, and the payload."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from taut.base.checks import entry_names, finite_array, finite_scalar, read_only, symmetric_psd, vector
from taut.base.errors import RangeError
from taut.base.types import Array, ArrayLike, Float64Array, Matrix, Matrix3, Point3
from taut.trace import math as tm
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from taut.arm.description import Arm

JointKind = Literal["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "ball"]
CommandKind = Literal["torque", "velocity", "position", "mit"]
Shape = Literal["mesh", "box", "cylinder", "sphere"]
COMMANDS: Final[tuple[CommandKind, ...]] = ("torque", "velocity", "position")
BASE: Final = -1
STANDARD_GRAVITY: Final = (0.0, 0.0, -9.81)  # [m/s^2] in the world
TURN: Final = 2.0 * math.pi


@dataclass(frozen=True, kw_only=True)
class Body:
    """The rigid body of one joint; `com` and `inertia` in the body frame, `inertia` about the centre of mass."""

    mass: float  # [kg]
    com: Point3  # [m]
    inertia: Matrix3  # [kg m^2]
    links: tuple[str, ...] = ()  # the links that were lumped into it

    def __post_init__(self) -> None:
        _keep(self, com=read_only(self.com), inertia=read_only(self.inertia))


@dataclass(frozen=True, kw_only=True)
class Joint:
    """One joint [rad, N m | m, N]. Those of an Arm are revolute, continuous or prismatic; a file may have others."""

    name: str
    kind: JointKind
    parent: int = BASE  # the joint that moves the parent body; BASE at the root
    placement: Pose = field(default_factory=Pose.identity)  # in the parent's body frame, at q = 0
    axis: Point3 = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))  # unit vector in the joint's frame
    lower: float = -np.inf  # [rad | m]
    upper: float = np.inf  # [rad | m]
    velocity: float = np.inf  # largest speed [rad/s | m/s]
    effort: float = np.inf  # largest torque or force [N m | N]
    viscous: float = 0.0  # friction per speed [N m s/rad | N s/m]
    coulomb: float = 0.0  # dry friction in motion [N m | N]
    static: float | None = None  # dry friction at rest [N m | N]; as in motion if None
    stribeck: float = 0.0  # speed over which it falls [rad/s | m/s]; 0 for at once
    stribeck_shape: float = 2.0  # exponent of the fall
    load_motor: float = 0.0  # dry friction per torque of the motor
    load_external: float = 0.0  # dry friction per torque of the load
    load_motor_static: float | None = None  # the same at rest; as in motion if None
    load_external_static: float | None = None
    gear: float = 1.0  # turns of the motor per turn of the joint; rad/m for a prismatic one
    rotor_inertia: float = 0.0  # seen at the joint, G^2 I_motor [kg m^2 | kg]

    def __post_init__(self) -> None:
        _keep(self, placement=self.placement.kept(), axis=read_only(self.axis))

    @property
    def unit(self) -> str:
        """Unit of the joint's position."""
        return "m" if self.kind == "prismatic" else "rad"

    @property
    def effort_unit(self) -> str:
        """Unit of the joint's torque or force."""
        return "N" if self.kind == "prismatic" else "N m"


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A named frame that is fixed to a body."""

    name: str
    body: int  # index of the joint that moves it; BASE where nothing does
    placement: Pose  # in the body's frame

    def __post_init__(self) -> None:
        _keep(self, placement=self.placement.kept())


@dataclass(frozen=True, kw_only=True)
class Visual:
    """Something to draw: a mesh file or a primitive, fixed to a body. Never needed to control an arm."""

    body: int = BASE
    placement: Pose  # in the body's frame
    shape: Shape
    size: tuple[float, ...]  # mesh: scale xyz; box: edges xyz [m]; cylinder: radius, length; sphere: radius
    file: str = ""
    rgba: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)

    def __post_init__(self) -> None:
        _keep(self, placement=self.placement.kept())


@dataclass(frozen=True, kw_only=True)
class Payload:
    """Payload of the tool, a run-time parameter: it changes between ticks without compiling.

    Frames: `com` and `inertia` are in the tool frame; `inertia` is about the payload's centre of mass.

    Args:
        mass: [kg], >= 0.
        com: (3,) [m].
        inertia: (6,) [kg m^2] in the order xx, yy, zz, xy, xz, yz, or (3, 3).

    Example:
        >>> Payload(mass=1.0, com=[0.0, 0.0, 0.05]).mass
        1.0
    """

    mass: float = 0.0
    com: Float64Array = field(default_factory=lambda: np.zeros(3))
    inertia: Float64Array = field(default_factory=lambda: np.zeros(6))

    def __post_init__(self) -> None:
        mass = finite_scalar("payload.mass", self.mass, unit="kg", minimum=0.0)
        com = vector("payload.com", self.com, 3, unit="m")
        six = finite_array("payload.inertia", self.inertia, unit="kg m^2")
        if six.shape == (3, 3):
            symmetric_psd("payload.inertia", six, unit="kg m^2")
            six = inertia_entries(six)
        inertia = vector("payload.inertia", six, 6, unit="kg m^2")
        _check_moments(inertia)
        _keep(self, mass=mass, com=com, inertia=inertia)


def _keep(part: Body | Joint | Frame | Visual | Payload, **values: object) -> None:
    """Put values into a frozen part: its own copies, so that no caller's array changes it later."""
    for name, value in values.items():
        object.__setattr__(part, name, value)


def _check_moments(six: Float64Array) -> None:
    """Zero, as of a point mass, or a possible body's."""
    if not six.any():
        return
    I = inertia_matrix(six)
    symmetric_psd("payload.inertia", I, unit="kg m^2")
    small, middle, large = np.linalg.eigvalsh(I)
    if large > (small + middle) * (1.0 + 1e-6):
        raise RangeError(
            f"payload.inertia violates the triangle inequality: principal moments {large:.4g} > {small:.4g} + "
            f"{middle:.4g} [kg m^2]; it is about the centre of mass, in the order xx, yy, zz, xy, xz, yz",
            name="payload.inertia",
            rule="triangle inequality",
        )


def checked_payload_entry(path: str, value: ArrayLike) -> Float64Array:
    """A new mass, com or inertia of a payload, or what links carry, by the last name in its path."""
    name = path.rpartition(".")[2]
    if name == "links":
        return finite_array(path, value)
    if name == "mass":
        return np.asarray(finite_scalar(path, value, unit="kg", minimum=0.0))
    if name == "com":
        return vector(path, value, 3, unit="m")
    return Payload(inertia=vector(path, value, 6, unit="kg m^2")).inertia


def short_way(delta: Array, continuous: Sequence[int]) -> Array:
    """Differences of joint positions (..., n); those of continuous joints wrap to [-pi, pi). Floats or symbols."""
    if not continuous:
        return delta
    short, columns = tm.array(delta), list(continuous)
    angle = short[..., columns]
    short[..., columns] = angle - TURN * tm.floor((angle + math.pi) / TURN)
    return short


def require_radians(name: str, q: Float64Array, arm: Arm) -> None:
    """Refuse q, (n,) or (k, n), more than a turn beyond a joint's limits, where no motion leads: it is in degrees."""
    hinge = np.array([unit == "rad" for unit in arm.units])
    far = hinge & ((q < arm.lower - TURN) | (q > arm.upper + TURN))
    if not far.any():
        return
    *_, joint = index = [int(i) for i in np.argwhere(far)[0]]
    angle, who = float(q[tuple(index)]), arm.joint_names[joint]
    raise RangeError(
        f"{name}[{joint}] (joint '{who}') must be an angle in radians; got {angle:g}, and the joint turns from "
        f"{arm.lower[joint]:.4g} to {arm.upper[joint]:.4g} rad; if it is in degrees, np.radians(...) converts it",
        name=name,
        joint=who,
        value=angle,
        rule="radians",
    )


def require_few_turns(name: str, q: Float64Array, joints: Sequence[Joint]) -> None:
    """Refuse a written pose, (n,), with more than 1.5 turns of a joint without limits: it is in degrees."""
    for i, joint in enumerate(joints):
        if joint.kind != "prismatic" and abs(q[i]) > 1.5 * TURN and math.isinf(joint.upper - joint.lower):
            at = entry_names(name, [i], [each.name for each in joints])
            raise RangeError(
                f"{at} must be an angle in radians; got {q[i]:g}, which is {abs(q[i]) / TURN:.0f} turns; if it is in "
                "degrees, np.radians(...) converts it",
                name=at,
                joint=joint.name,
                value=float(q[i]),
                rule="radians",
            )


def inertia_matrix(six: Any) -> Matrix:
    """(3, 3) from the six numbers xx, yy, zz, xy, xz, yz, floats or symbols."""
    xx, yy, zz, xy, xz, yz = six
    return tm.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertia_entries(I: Matrix) -> Array:
    """(6,) xx, yy, zz, xy, xz, yz from a symmetric (3, 3)."""
    return tm.array([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]])
