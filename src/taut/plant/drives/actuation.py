"""The drives between command and arm: delay, amplifier, motor, gear. Pure functions with parameters and memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, finite_scalar, require_at_least
from taut.base.errors import RangeError, UsageError
from taut.base.front_door import public_name
from taut.base.paths import flatten
from taut.base.quantity import Quantity, keep_quantities
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.plant.drives.motor import ElectricMotor, Motor, TorqueLoop
from taut.plant.drives.transmission import Transmission
from taut.trace import math as tm

__all__ = ["Actuation", "Ripple", "delayed", "lagged", "mean_lagged"]

Values = Mapping[str, Any]
MOST_TAPS: Final = 1000


@dataclass(frozen=True, kw_only=True, eq=False)
class Ripple:
    """Torque ripple: a motor's torque constant that changes along its turn.

    Law:          tau = (1 + amplitude sin(periods gear q)) tau_motor

    Args:
        amplitude: Share of the torque, in [0, 1).
        periods: Periods in one turn of the motor, a whole number: slots, or magnets.
    """

    title: ClassVar[str] = "actuation.ripple"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "amplitude": Quantity(unit="1", rule=">= 0"),
        "periods": Quantity(unit="1", rule="> 0"),
    }

    amplitude: ArrayLike
    periods: ArrayLike

    def __post_init__(self) -> None:
        keep_quantities(self)
        amplitude, periods = np.asarray(self.amplitude), np.asarray(self.periods)
        if np.any(amplitude >= 1.0):
            raise RangeError(
                f"actuation.ripple.amplitude must be below 1, a share of the torque; got {float(amplitude.max()):g}; "
                "5 % is 0.05",
                name="amplitude",
            )
        if np.any(periods != np.round(periods)):
            raise RangeError(
                "actuation.ripple.periods must be a whole number: after one turn of the motor its torque is the same "
                f"again; got {float(periods[periods != np.round(periods)].flat[0]):g}",
                name="periods",
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Actuation:
    """The drives between command and arm (figure 10.1 a): each part is ideal where it is left out.

    A torque command goes through a pure delay, an inner torque loop, steps of the amplifier's resolution, the motor's
    speed-torque limits, the lag of amplifier and current loop, ripple, and the transmission. The delay is the
    controller's; everything else acts in each step of the integrator.

    A velocity command is what a drive's own loop follows as a first-order lag, a position command as a critically
    damped second-order one; these drives are stiff, so that the arm's dynamics and its load do not show, and have
    a bandwidth and a delay only.

    Args:
        bandwidth: [rad/s] of amplifier and current loop, or of the drive.
        delay: [s], a whole number of the controller's periods.
        resolution: Smallest step of the torque at the joint [N m | N].
        motor: What the motor can do: `taut.drives.Motor` or `taut.drives.ElectricMotor`.
        ripple: Of the motor's torque.
        transmission: Losses, play and elasticity of the gear. Its ratio is the Arm's: `arm.with_gears`.
        torque_loop: An inner loop on the joint torque sensor.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint").with_gears(ratio=100.0, motor_inertia=1e-5)
        >>> drives = taut.drives.Actuation(
        ...     bandwidth=2000.0,
        ...     motor=taut.drives.Motor(peak=0.5, stall=0.6, no_load=500.0),
        ...     transmission=taut.drives.Transmission(efficiency=0.8),
        ... )
        >>> sorted(taut.RigidPlant(arm, actuation=drives).parameters)[:3]
        ['actuation.bandwidth', 'actuation.motor.no_load', 'actuation.motor.peak']
    """

    title: ClassVar[str] = "actuation"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "bandwidth": Quantity(unit="rad/s", rule="> 0", instead="for an ideal torque drive leave it out"),
        "resolution": Quantity(unit="N m | N", rule="> 0", instead="for an ideal amplifier leave it out"),
    }

    bandwidth: ArrayLike | None = None
    delay: float = 0.0
    resolution: ArrayLike | None = None
    motor: Motor | ElectricMotor | None = None
    ripple: Ripple | None = None
    transmission: Transmission | None = None
    torque_loop: TorqueLoop | None = None

    def __post_init__(self) -> None:
        keep_quantities(self)
        delay = finite_scalar("actuation.delay", self.delay, unit="s")
        require_at_least("actuation.delay", np.asarray(delay), 0.0, unit="s")
        for name, kinds in PARTS.items():
            part = getattr(self, name)
            if part is not None and not isinstance(part, kinds):
                words = " or ".join(f"{public_name(kind)}(...)" for kind in kinds)
                raise UsageError(f"actuation.{name} must be {words}; got {type(part).__name__}", name=name)

    @property
    def acts(self) -> bool:
        """Whether there is anything in it that acts in each step: all but the delay."""
        return self.bandwidth is not None or bool(self.for_torque_only)

    @property
    def for_torque_only(self) -> tuple[str, ...]:
        """The parts that are there which only a torque command goes through."""
        return tuple(name for name in ("resolution", *PARTS) if getattr(self, name) is not None)

    def check_size(self, arm: Arm) -> None:
        """Each number must be a scalar or have one entry per joint.

        Raises:
            ShapeError: One has another size.
        """
        for name, values in self.parameters().items():
            if np.ndim(values):
                finite_array(f"actuation.{name}", values, shape=(arm.n,), joints=arm.joint_names, allow_infinite=True)

    def checked(self, path: str, value: Float64Array) -> None:
        """Refuse a new value of a parameter that the drives could not have been made with.

        Raises:
            RangeError: It is out of range.
            UsageError: It does not go together with the others.
        """
        head, _, rest = path.partition(".")
        changed: dict[str, Any] = {rest or head: value}
        dataclasses.replace(getattr(self, head) if rest else self, **changed)

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by path: those that are there."""
        out: dict[str, Any] = {}
        for name in ("bandwidth", "resolution"):
            if getattr(self, name) is not None:
                out[name] = np.asarray(getattr(self, name))
        for name in ("motor", "ripple", "torque_loop"):
            part = getattr(self, name)
            if part is not None:
                out[name] = {key: value for key, value in vars(part).items() if value is not None}
        if self.transmission is not None:
            out["transmission"] = self.transmission.parameters()
        return flatten(out)

    def taps(self, dt: float) -> int:
        """The delay in controller periods.

        Raises:
            RangeError: It is not a whole number of them.
        """
        taps = self.delay / dt
        whole = abs(taps - round(taps)) <= 1e-6
        if not whole or round(taps) > MOST_TAPS:
            other = "a higher control rate, or taut.analysis.SampledLoop(delay=...), which takes any"
            way_out = "" if whole else f"; a part of a period needs {other}"
            raise RangeError(
                f"actuation.delay must be a whole number of control periods of {dt:g} s, at most {MOST_TAPS}; "
                f"got {self.delay:g} s{way_out}",
                name="actuation.delay",
                value=self.delay,
            )
        return round(taps)


PARTS: Final[Mapping[str, tuple[type, ...]]] = {
    "motor": (Motor, ElectricMotor),
    "ripple": (Ripple,),
    "transmission": (Transmission,),
    "torque_loop": (TorqueLoop,),
}


def delayed(command: Vector, line: Any) -> tuple[Vector, Any]:
    """The command of some ticks ago, and the delay line (taps, n) after this tick."""
    if line is None:
        return command, None
    rows = [command, *(line[i] for i in range(len(line)))]
    return rows[-1], tm.stack(rows[:-1])


def lagged(command: Vector, output: Vector, bandwidth: Any, dt: Any) -> Vector:
    """(n,) output of a first-order lag after dt, exact for a command that is held."""
    moved: Vector = output + (1.0 - tm.exp(-bandwidth * dt)) * (command - output)
    return moved


def mean_lagged(command: Vector, state: Vector, bandwidth: Any, dt: Any) -> tuple[Vector, Vector]:
    """(n,) mean over dt of a first-order lag's output for a command that is held, exact; and the output after dt."""
    left = tm.exp(-bandwidth * dt)
    mean: Vector = command + (state - command) * ((1.0 - left) / (bandwidth * dt))
    after: Vector = command + (state - command) * left
    return mean, after
