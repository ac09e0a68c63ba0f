"""taut.laws: every law of the library, by name."""

from __future__ import annotations

from taut.base.errors import unknown_name
from taut.control.admittance import Admittance
from taut.control.combine import Sum
from taut.control.constraint_estimate import NormalEstimate
from taut.control.force import ForceControl
from taut.control.friction import FrictionCompensation
from taut.control.hybrid import HybridMotionForce
from taut.control.impedance import Impedance, Stiffness
from taut.control.joint import (
    PID,
    ComputedTorque,
    FeedForward,
    GravityCompensation,
    GravityPID,
    VelocityPI,
)
from taut.control.nullspace import LimitAvoidance, Manipulability, Posture
from taut.control.side_by_side import SideBySide
from taut.control.stiction import Dither, RaisedGains
from taut.control.task import TaskComputedTorque
from taut.control.task_drive import TaskPosition, TaskVelocity
from taut.control.via_joint_space import ViaJointSpace
from taut.control.virtual_objects import VirtualBall, VirtualGroove, VirtualWall

__all__ = [
    "PID",
    "FeedForward",
    "ComputedTorque",
    "GravityPID",
    "GravityCompensation",
    "FrictionCompensation",
    "Dither",
    "RaisedGains",
    "VelocityPI",
    "ViaJointSpace",
    "TaskComputedTorque",
    "TaskVelocity",
    "TaskPosition",
    "Impedance",
    "Stiffness",
    "Admittance",
    "HybridMotionForce",
    "NormalEstimate",
    "ForceControl",
    "VirtualWall",
    "VirtualGroove",
    "VirtualBall",
    "Posture",
    "LimitAvoidance",
    "Manipulability",
    "Sum",
    "SideBySide",
]


def __getattr__(name: str) -> object:
    raise AttributeError(str(unknown_name("taut.laws", "law", name, __all__)), name=name, obj=None)
