"""Sensors at the joints: positions, velocities and torques, at the link or at the motor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from taut.arm.description import Arm
from taut.base.checks import one_of
from taut.base.quantity import Quantity, keep_quantities
from taut.base.types import Array, ArrayLike
from taut.maths.model import Model
from taut.plant.sensors.readings import Side, at_side, reading

__all__ = ["SIDES", "Encoder", "Tachometer", "TorqueSensor"]

Values = Mapping[str, Any]
SIDES: Final[tuple[Side, ...]] = ("link", "motor")
STEP: Final = "leave it out where there are no steps"


@dataclass(frozen=True, kw_only=True, eq=False)
class Encoder:
    """A position sensor of every joint. An encoder has steps; a potentiometer or a resolver has noise instead.

    Model:
        reading = resolution round((shaft + offset + noise) / resolution), with standard normal noise in every tick
        The shaft is the link, or the motor behind a gear: then the numbers are those of the motor's shaft, and the
        joint sees each of them divided by the gear ratio, `arm.gear`. Either way the reading is in joint units.

    The noise is white from tick to tick: its standard deviation is the same at every rate, so that its density grows
    as the rate falls.

    Args:
        resolution: (n,) or scalar, the step [rad | m at the link, rad at the motor]; None for none, and among
            several 0 for joints without steps.
        offset: (n,) or scalar, what it reads at zero [the same].
        noise: (n,) or scalar, standard deviation [the same].
        side: "link" or "motor"; by default the link, and the motor where it is `Sensors(motor=...)`.

    Raises:
        RangeError: A resolution of zero or below, negative noise, NaN.

    Example:
        >>> Encoder(resolution=2e-5).resolution.tolist()
        2e-05

    References:
        Chapter, section 10.1 control system overview.
    """

    title: ClassVar[str] = "encoder"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "resolution": Quantity(unit="rad | m", rule="> 0 somewhere", instead=STEP),
        "offset": Quantity(unit="rad | m"),
        "noise": Quantity(unit="rad | m", rule=">= 0"),
    }

    resolution: ArrayLike | None = None
    offset: ArrayLike = 0.0
    noise: ArrayLike = 0.0
    side: Side | None = None

    def __post_init__(self) -> None:
        keep_quantities(self)
        _check_side(self.side)

    def size(self, arm: Arm) -> int:
        """Entries of a reading."""
        return arm.n

    def read(self, model: Model, true: Values, noise: Array | None, parameters: Values) -> tuple[Array, Any]:
        """(n,) positions in joint units [rad | m]."""
        return _at_shaft("q", self.side, model, true, noise, parameters), None


@dataclass(frozen=True, kw_only=True, eq=False)
class Tachometer:
    """A velocity sensor of every joint.

    Model:
        reading = shaft + offset + noise, with standard normal noise in every tick; the shaft is that of the link, or
        of the motor behind a gear, as for `Encoder`

    Args:
        offset: (n,) or scalar, what it reads at rest [rad/s | m/s at the link, rad/s at the motor].
        noise: (n,) or scalar, standard deviation [the same].
        side: "link" or "motor"; by default the link, and the motor where it is `Sensors(motor_velocity=...)`.

    Raises:
        RangeError: Negative noise, NaN.

    References:
        Chapter, section 10.1 control system overview.
    """

    title: ClassVar[str] = "tachometer"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "offset": Quantity(unit="rad/s | m/s"),
        "noise": Quantity(unit="rad/s | m/s", rule=">= 0"),
    }

    offset: ArrayLike = 0.0
    noise: ArrayLike = 0.0
    side: Side | None = None

    def __post_init__(self) -> None:
        keep_quantities(self)
        _check_side(self.side)

    def size(self, arm: Arm) -> int:
        """Entries of a reading."""
        return arm.n

    def read(self, model: Model, true: Values, noise: Array | None, parameters: Values) -> tuple[Array, Any]:
        """(n,) velocities in joint units [rad/s | m/s]."""
        return _at_shaft("v", self.side, model, true, noise, parameters), None


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueSensor:
    """A torque sensor of every joint, in joint units; a prismatic joint's is a force.

    Model:
        reading = resolution round((tau + bias + noise) / resolution)
        At the link tau is what the transmission gives to it, as a strain gauge behind gear and friction has it; at
        the motor it is the motor's own torque times the gear ratio, as its current tells. What is read in a tick is
        that of the last step of the integrator.

    Args:
        resolution: (n,) or scalar, the step [N m | N]; None for none, and among several 0 for joints without steps.
        bias: (n,) or scalar, what it reads without load [N m | N].
        noise: (n,) or scalar, standard deviation [N m | N].
        side: "link" or "motor".

    Raises:
        RangeError: A resolution of zero or below, negative noise, NaN.

    References:
        Chapter, section 10.1 control system overview.
    """

    title: ClassVar[str] = "torque_sensor"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "resolution": Quantity(unit="N m | N", rule="> 0 somewhere", instead=STEP),
        "bias": Quantity(unit="N m | N"),
        "noise": Quantity(unit="N m | N", rule=">= 0"),
    }

    resolution: ArrayLike | None = None
    bias: ArrayLike = 0.0
    noise: ArrayLike = 0.0
    side: Side = "link"

    def __post_init__(self) -> None:
        keep_quantities(self)
        one_of("side", self.side, SIDES)

    def size(self, arm: Arm) -> int:
        """Entries of a reading."""
        return arm.n

    def read(
        self,
        model: Model,  # noqa: ARG002
        true: Values,
        noise: Array | None,
        parameters: Values,
    ) -> tuple[Array, Any]:
        """(n,) torques [N m | N]."""
        tau = true.get("tau_link", true["tau"]) if self.side == "link" else true["tau"]
        return reading(tau, noise, parameters, "bias"), None


def _at_shaft(
    name: str, side: Side | None, model: Model, true: Values, noise: Array | None, parameters: Values
) -> Array:
    """A reading of q or v in joint units, with the faults of a sensor on the link or on the motor's shaft."""
    x = at_side(name, side or "link", true)
    if side != "motor" or not parameters:
        return reading(x, noise, parameters, "offset")
    gear = model.arm.gear
    seen: Array = reading(gear * x, noise, parameters, "offset") / gear
    return seen


def _check_side(side: Side | None) -> None:
    if side is not None:
        one_of("side", side, SIDES)
