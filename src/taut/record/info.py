"""RunInfo and Outcome: what a run was made with and how it ended, as data that a log keeps."""

from __future__ import annotations

import functools
import math
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import metadata
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from taut.arm.description import BASE, Arm
from taut.arm.rules import indefinite
from taut.base.errors import printable
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.closed_loop import ApparentImpedance
from taut.maths.model import Adds, Chain
from taut.maths.snapshot import measurement_shapes

POSES: Final = "scene.poses"  # column of a run: (m, 7) position [m] and quaternion wxyz of each thing that moves
PACKAGES: Final = ("numpy", "llvmlite", "mujoco")
PAYLOAD_SHAPES: Final[Mapping[str, tuple[int, ...]]] = {"mass": (), "com": (3,), "inertia": (6,)}


OutcomeKind: TypeAlias = Literal["completed", "diverged", "stopped"]
ShapeKind: TypeAlias = Literal["plane", "box", "sphere", "ellipsoid", "cylinder", "capsule", "mesh"]
Numbers: TypeAlias = tuple[float, ...]


def numbers(values: Any) -> Numbers:
    """An array as the numbers of a shape or a thing."""
    return tuple(float(x) for x in values)


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A geometric shape of a thing."""

    kind: ShapeKind
    size: Numbers  # (3,) [m] halves, as MuJoCo has them: of a cylinder radius and half its length
    p: Numbers = (0.0, 0.0, 0.0)  # [m] in the thing
    wxyz: Numbers = (1.0, 0.0, 0.0, 0.0)
    rgba: Numbers = (0.5, 0.5, 0.5, 1.0)
    mesh: int = -1  # number of its mesh


@dataclass(frozen=True, kw_only=True)
class Thing:
    """Shapes with one common pose: at rest in the world, fixed to the tool, or moving."""

    shapes: tuple[Shape, ...]
    p: Numbers = (0.0, 0.0, 0.0)  # [m] in the world, where it rests or begins
    wxyz: Numbers = (1.0, 0.0, 0.0, 0.0)
    row: int | None = None  # of the column, where its pose is recorded
    on_tool: bool = False  # at the arm's tool, and in its axes
    times: Numbers = ()  # [s] of a motion that is known beforehand
    shifts: tuple[Numbers, ...] = ()  # (3,) [m] each, in the world: where it is then, from where it begins

    @property
    def moves(self) -> bool:
        """Whether it moves by itself."""
        return self.row is not None or bool(self.times)


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A triangle mesh."""

    vertices: Float64Array  # (m, 3) [m]
    faces: Float64Array  # (f, 3) whole numbers


@dataclass(frozen=True, kw_only=True, eq=False)
class Around:
    """Everything that stands around the arm, to be drawn."""

    things: tuple[Thing, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    missing: tuple[str, ...] = ()  # what stands there too and has no shape here, in words

    def __bool__(self) -> bool:
        return bool(self.things or self.missing)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a run ended: completed, diverged, or stopped for a stated reason."""

    kind: OutcomeKind
    message: str
    tick: int  # the last tick that was recorded
    joint: str | None = None
    dropped: int = 0  # ticks that are in the record and not in the log, which could not be written

    @property
    def ok(self) -> bool:
        """Whether the run went to its end."""
        return self.kind == "completed"

    def __str__(self) -> str:
        return printable(self.message, lines=True)  # an exception's words may be in it

    def json(self) -> dict[str, Any]:
        """As plain values."""
        values = {"kind": self.kind, "message": self.message, "tick": self.tick, "joint": self.joint}
        return values if not self.dropped else {**values, "dropped": self.dropped}


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """Parameters that took new values in a run."""

    t: float  # [s]
    set: Mapping[str, Float64Array]  # by path


@dataclass(frozen=True, kw_only=True)
class Stability:
    """The judgement of the sampled loop at the start; `stable` is None where it could not be judged."""

    stable: bool | None
    message: str
    radius: float | None = None  # [-] spectral radius of the one-period map
    joints: Mapping[str, float] = field(default_factory=dict)  # fractions of the least stable mode
    tool: Mapping[str, float] = field(default_factory=dict)
    largest: Mapping[str, float] = field(default_factory=dict)  # largest stable factor on gains
    relies_on: tuple[str, ...] = ()
    plant: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class PartInfo:
    """One of the laws side by side, or one phase of a task."""

    tool: Chain
    impedance: ApparentImpedance | None = None
    joints: tuple[str, ...] = ()  # of laws side by side: its own
    follows: str | None = None  # of a phase: the part of the reference


@dataclass(frozen=True, kw_only=True)
class ScenarioInfo:
    """The scenario that a run is one of."""

    name: str
    law: str
    case: str = ""
    text: str = ""
    built_in: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoInfo:
    """The compiled tick of a robot's loop, with which each row of its record can be computed again."""

    digest: str  # of its program
    measures: tuple[str, ...]  # by the robot, besides q
    limits: Mapping[str, Float64Array]  # fields of its `taut.SafetyLimits`
    adds: Adds  # by the robot, to its commands
    at_rest: float = 0.0  # [rad/s | m/s] what its velocities show at rest
    torque_rate: float = 0.0  # [N m/s | N/s] that it allows; 0 where it takes any


@dataclass(frozen=True, kw_only=True, eq=False)
class RunInfo:
    """What a run was made with; what is left out is not known, as of a run that `taut.run` did not make."""

    rate: float | None = None  # [Hz]
    duration: float | None = None  # [s]
    seed: int | None = None
    law: str = ""
    arm: str = ""  # name of the controller's arm
    plant: str = ""
    sensing: str = ""
    command_limits: str = ""
    parameters: Mapping[str, Float64Array] = field(default_factory=dict)  # by path
    events: tuple[Change, ...] = ()
    stability: Stability | None = None
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # "effort", "velocity" by joint
    tool: Chain | None = None  # the joints that carry the frame that the law controls
    impedance: ApparentImpedance | None = None  # what the law promises at the tool where F_ext is measured
    parts: Mapping[str, PartInfo] = field(default_factory=dict)  # of laws side by side
    phases: Mapping[str, PartInfo] = field(default_factory=dict)  # of a task
    around: Around = field(default_factory=Around)  # what stood around the arm, to draw
    scenario: ScenarioInfo | None = None
    versions: Mapping[str, str] = field(default_factory=dict)  # of the programs that made the run
    controller_arm: Arm | None = None  # without what is only drawn, as the plant's
    plant_arm: Arm | None = None
    servo: ServoInfo | None = None  # of a robot


def with_parameters(info: RunInfo, columns: Mapping[str, Float64Array], t: Float64Array) -> RunInfo:
    """The info of a record with the parameters tick by tick, in columns parameters.*: their values and changes."""
    values, found = {p: x for p, x in subtree(columns, "parameters").items() if len(x)}, dict[int, Any]()
    for path, x in values.items():
        for k in np.flatnonzero((np.diff(x.reshape(len(x), -1), axis=0) != 0.0).any(axis=1)) + 1:
            found.setdefault(int(k), {})[path] = x[k]
    changes = tuple(Change(t=float(t[k]), set=found[k]) for k in sorted(found))
    return replace(info, parameters={path: x[0] for path, x in values.items()} or info.parameters, events=changes)


def check_info(info: RunInfo, joints: Sequence[str]) -> None:
    """Require (ValueError) that the parts of an info that was read fit each other and the joints of the run."""
    for name, right in _rules(info, joints):
        if not right:
            raise ValueError(f"info.{name} is not what taut.run records")


def _rules(info: RunInfo, joints: Sequence[str]) -> Iterator[tuple[str, bool]]:
    n = len(joints)
    yield "rate", info.rate is None or 0.0 < info.rate < math.inf
    yield "seed", info.seed is None or info.seed >= 0
    yield "tool", info.tool is None or _reaches(info.tool, n)
    yield "impedance", _has_mass(info.impedance)
    for part in info.parts.values():
        yield "parts", bool(part.joints) and set(part.joints) <= set(joints) and _reaches(part.tool, len(part.joints))
        yield "parts", len(set(part.joints)) == len(part.joints) and _has_mass(part.impedance)
    for phase in info.phases.values():
        yield "phases", _reaches(phase.tool, n) and _has_mass(phase.impedance)
    yield "parameters", _payload_fits(info.parameters)
    yield "events", all(_payload_fits(event.set) for event in info.events)
    yield "controller_arm", _is_possible(info.controller_arm, n)
    yield "plant_arm", _is_possible(info.plant_arm, n)
    yield "servo", info.servo is None or set(info.servo.measures) <= set(measurement_shapes(n))


def _reaches(chain: Chain, n: int) -> bool:
    return chain.n == n and all(0 <= link.joint < n for link in chain.links)


def _has_mass(impedance: ApparentImpedance | None) -> bool:
    return impedance is None or bool(np.linalg.eigvalsh(impedance.D)[0] > 0.0)


def _payload_fits(values: Mapping[str, Float64Array]) -> bool:
    shapes = {f"model.payload.{name}": shape for name, shape in PAYLOAD_SHAPES.items()}
    return all(np.shape(values[path]) == shape for path, shape in shapes.items() if path in values)


def _is_possible(arm: Arm | None, n: int) -> bool:
    """Whether an arm is a tree whose mass matrix is positive definite."""
    if arm is None:
        return True
    fits = arm.n == n == len(arm.bodies) and arm.home.shape == (n,) and arm.tool in arm.frame_names
    tree = all(BASE <= joint.parent < i for i, joint in enumerate(arm.joints))
    if not (fits and tree and all(BASE <= frame.body < n for frame in arm.frames)):
        return False
    with np.errstate(invalid="ignore", over="ignore"):  # a mass may be negative or huge
        return indefinite(arm) is None


@functools.cache
def versions() -> Mapping[str, str]:
    """The versions of taut and of what it computes with, and the kind of machine."""
    from taut.base import __version__

    found = {"taut": __version__}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    found["Python"] = platform.python_version()
    found["platform"] = f"{platform.system()} {platform.machine()}"
    return found
