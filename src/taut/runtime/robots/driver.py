"""RobotDriver: the interface between the real-time loop and a robot, and what a robot declares about itself."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from taut.base.checks import finite_scalar, instance_of, one_of, rate_in_hertz, vector, whole_number
from taut.base.errors import TautError
from taut.base.types import Float64Array
from taut.maths.model import Adds
from taut.maths.snapshot import MEASUREMENTS


class DriverError(TautError, RuntimeError):
    """A robot or its connection that fails while the loop runs; it ends the motion and is latched.

    Args:
        message: One sentence: what the robot reported and how to go on.
        kind: `disconnected`, `silent`, `robot_error` (the robot stopped itself), `rejected` (a command that it did
            not take) or `busy` (another client has it).
        name, joint, value, rule: As of every TautError; the name is the kind unless given.
    """

    def __init__(
        self,
        message: str,
        *,
        kind: str = "robot_error",
        name: str | None = None,
        joint: str | None = None,
        value: object = None,
        rule: str | None = None,
    ) -> None:
        super().__init__(message, name=name or kind, joint=joint, value=value, rule=rule)
        self.kind = kind


@dataclass(frozen=True, kw_only=True)
class RobotInfo:
    """Declaration of a robot, made by its driver when it is connected. Plain data."""

    name: str  # in messages: "Franka at 172.16.0.2"
    n: int  # number of joints
    rate: float  # [Hz] of its states and commands
    takes: Literal["torque", "velocity", "position", "mit"]
    measures: tuple[str, ...] = ("v",)  # besides q: v, tau_meas, F_ext (our sign, base axes), q_motor, v_motor
    adds: tuple[str, ...] = ()  # gravity, coriolis, friction: what it adds to a torque command itself
    paced_by: Literal["robot", "host"] = "host"  # "robot": its blocking read keeps the time
    silence: float = 0.0  # [s] without commands after which it stops itself; 0 where it never does
    delay: float = 0.0  # [s] whole periods, from a measured state to the command that acts on it
    at_rest: float = 0.0  # [rad/s | m/s] what its velocities show at rest, by their resolution
    torque_rate: float = 0.0  # [N m/s | N/s] of commands, beyond which it stops itself; 0 where it takes any
    gains: tuple[float, float] = (math.inf, math.inf)  # largest kp, kd of "mit" commands [N m/rad, N m s/rad]
    holds: bool = True  # the arm while it is not controlled; else from call("hold") to close: call("enabled")
    joint_names: tuple[str, ...] = ()  # where it knows them
    load: tuple[float, tuple[float, float, float]] | None = None  # that it compensates: [kg], centre at the tool [m]
    facts: Mapping[str, Any] = field(
        default_factory=dict
    )  # further plain values, for bring-up: q and T_BE (16,), ...

    def __post_init__(self) -> None:
        instance_of("name", self.name, str, "a text")
        whole_number("n", self.n, minimum=1)
        rate_in_hertz(self.rate)
        one_of("takes", self.takes, ("torque", "velocity", "position", "mit"))
        for name in self.measures:
            one_of("measures", name, ("v", *MEASUREMENTS))
        Adds.of(self.adds)
        one_of("paced_by", self.paced_by, ("robot", "host"))
        instance_of("holds", self.holds, bool, "true or false")
        for name, unit in {
            "silence": "s",
            "delay": "s",
            "at_rest": "rad/s | m/s",
            "torque_rate": "N m/s | N/s",
        }.items():
            finite_scalar(name, getattr(self, name), unit=unit, minimum=0.0)
        if self.load is not None:
            finite_scalar("load", self.load[0], unit="kg", minimum=0.0)
            vector("load", self.load[1], 3, unit="m")


@dataclass(frozen=True, kw_only=True)
class NativeCalls:
    """Read and write of a driver in native code, of which the loop calls nothing in Python."""

    read: int  # address of i64 read(user, double *measured): not 0 ends the motion
    write: int  # address of i64 write(user, double *command), likewise
    user: int
    failure: Callable[[], DriverError]  # why one of them was not 0


class RobotDriver(ABC):
    """A robot on a wire. It lives in the loop's process, which imports it by module and class name.

    The order of calls is open, then any number of (read)*, begin, (read, write)*, end, and at last close. Between
    begin and end every period has one read and one write. Nothing is sent before begin. Any exception ends the
    motion: the loop calls end, and reports a DriverError as it is and everything else by its text.

    Args:
        address: What stands behind `scheme://`, such as "172.16.0.2" or "127.0.0.1:4000".
        options: Further keyword arguments of a driver: plain values, given to `taut.connect(..., options={})`.
    """

    @abstractmethod
    def open(self) -> RobotInfo:
        """Connect and report what is there; nothing moves and no control begins."""

    @abstractmethod
    def read(self, measured: Mapping[str, Float64Array]) -> None:
        """Write the newest state into the arrays q (n,) and each of `measures`, in place: measured["q"][:] = q.

        What was never written is NaN, and a fault.

        A robot that keeps time blocks until its next state; else the newest state that has arrived is taken, and one
        that stays away longer than the driver allows is a DriverError(kind="silent").
        """

    @abstractmethod
    def begin(self) -> None:
        """Take control; the next read gives the state from which commands begin."""

    @abstractmethod
    def write(self, command: Float64Array) -> None:
        """Send one command: (n,), or (5, n) rows q, v, kp, kd and tau for motors of the MIT type."""

    @abstractmethod
    def end(self) -> None:
        """Give control back, from any state and after any error; the robot holds itself or brakes."""

    def native(self) -> NativeCalls | None:
        """What the loop calls in place of read and write, between open and close; None for Python."""
        return None

    def recover(self) -> None:  # noqa: B027  (most robots need nothing)
        """Clear the robot's own errors, so that begin may follow."""

    def set_load(self, mass: float, com: Float64Array, inertia: Float64Array) -> None:  # noqa: ARG002
        """Tell the robot its load: mass [kg], centre [m] and (3, 3) inertia [kg m^2] in the tool's frame."""
        raise DriverError("this robot takes no load", kind="rejected")

    def call(self, name: str, arguments: Mapping[str, Any]) -> Any:  # noqa: ARG002
        """Whatever else a robot offers between motions, such as its gripper or collision thresholds; plain data."""
        raise DriverError(f"this robot has no function '{name}'", kind="rejected")

    @abstractmethod
    def close(self) -> None:
        """End the connection; called once, also after a failed open."""
