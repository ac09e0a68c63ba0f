"""Wrist: what a controller knows of its wrist sensor, and what it makes of the readings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import RangeError
from taut.base.fields import Declared, Field, Plain
from taut.base.types import Array, Vector, Wrench
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.maths.wrist import load_wrench, sensor_place
from taut.trace import math as tm

__all__ = ["SATURATED", "Wrist"]

Values = Mapping[str, Any]
SATURATED: Final = "saturated.F_ext"  # 1.0 in a tick whose reading is at the end of the sensor's range
WRENCH: Final = "N, N m"
AT_END: Final = 1.0 - 1e-9  # of the range: turning a reading into the world and back rounds
SAME: Final = 1e-9  # of a reading's size: two that differ by less are one; noise of a sensor is far above that


class Wrist(Declared):
    """What is known of a sensor between arm and tool, so that a law sees contact alone as `x.F_ext`.

    Law:          F_ext = reading - bias - weight of the tool - weight of the controller's payload
                  A weight is m g with the moment c x m g, turned by the measured positions. Inertia forces of a tool
                  that accelerates stay in; a low-pass, `Sensing(F_ext=taut.sensors.LowPass(...))`, comes after.

    Every number is a run-time parameter: sensing.wrist.bias, sensing.wrist.mass, ... The payload is the one that the
    laws count with, model.payload.*: one number for its weight in the joints and in the sensor.

    Frames:
        bias, com and range are of the sensor's own axes and origin, those of `frame`, force first. What goes in and
        comes out is in world axes at the tool's origin.

    Args:
        bias: (6,) or (force, moment), what the sensor reads without load [N, N m].
        mass: [kg] of the tool beyond the sensor, 0 for one that weighs nothing; None for a sensor whose readings have
            no weight in them, neither the tool's nor the payload's.
        com: (3,) centre of mass of that tool [m].
        range: (6,) or (force, moment), where the sensor ends [N, N m], infinity for no end. A tick at the end of it
            is reported: column saturated.F_ext of a run and its outcome, `ctrl.sensed`. The law then sees what the
            sensor gives, which is less than what is there.
        repeats: A reading that is the same in so many ticks in a row is a fault, like NaN: no command leaves the
            tick. For a sensor with noise; None for not to look.
        frame: Where the sensor stands: a frame of the tool's body; the tool's own if None.

    Raises:
        ShapeError: One number for forces and moments, a centre of mass that is no vector.
        RangeError: A negative mass, a range of zero or below, NaN.
        UsageError: A centre of mass without a mass.

    Example:
        >>> wrist = Wrist(bias=[1.2, -0.4, 3, 0.02, 0, 0.01], mass=0.73, com=[0.0, 0.0, 0.06], range=(200.0, 10.0))
        >>> list(wrist.parameters())
        ['bias', 'mass', 'com', 'range']

    References:
        Kubus, Kroeger and Wahl, On-line rigid object recognition and pose estimation based on inertial parameters,
        IROS (2007): the load beyond a wrist sensor. Chapter, section 10.3 force control.
    """

    bias: Field = Field((0.0,) * 6, unit=WRENCH, shape=6, accepts=("pair",))
    mass: Field = Field(unit="kg", minimum=0.0, optional=True)
    com: Field = Field(unit="m", shape=3, optional=True)
    range: Field = Field(
        unit=WRENCH,
        shape=6,
        accepts=("pair",),
        above=0.0,
        infinite=True,
        optional=True,
        hint="leave it out for a sensor without end",
    )
    repeats: Plain[int | None] = Plain(int, optional=True)
    frame: str | None = None

    def check(self) -> None:
        if self.mass is None and self.com is not None:
            self.refuse("com", "is that of the tool, whose mass is missing; give mass too")
        if self.mass is not None and self.com is None:
            self.__dict__["com"] = np.zeros(3)
        if self.repeats is not None and self.repeats < 2:
            self.refuse("repeats", f"must be >= 2 ticks; got {self.repeats}", RangeError)

    # ---------------------------------------------------------------- what it declares

    @property
    def takes_out(self) -> str:
        """What it takes out of a reading, in words."""
        return "bias" if self.mass is None else "bias, tool and payload"

    def check_fit(self, arm: Arm) -> None:
        """Whether it fits an arm.

        Raises:
            UnknownNameError, UsageError: A frame that does not exist, or that does not move with the tool.
        """
        sensor_place(arm, self.frame, "sensing.wrist")

    # ---------------------------------------------------------------- the pure functions

    def start(self, arm: Arm, q: Vector, F_W: Wrench) -> dict[str, Any]:
        """Memory at the first tick, which reads this."""
        if self.repeats is None:
            return {}
        return {"reading": self._reading(arm, q, F_W), "repeats": -1.0}  # to which the first tick adds one

    def corrected(
        self, arm: Arm, q: Vector, F_W: Wrench, parameters: Values, payload: PayloadValues
    ) -> tuple[Array, Any]:
        """(6,) what touches the tool, and 1.0 where the reading is at the end of its range; None without a range.

        Args:
            arm: The arm, whose gravity it is.
            q: (n,) measured positions, by which the reading was turned into the world.
            F_W: (6,) the reading, in world axes at the tool's origin.
            parameters: Its numbers by name.
            payload: What the tool carries, by the controller's model.
        """
        R_WE = dyn.pose(model_of(arm), q).R
        place = sensor_place(arm, self.frame, "sensing.wrist")
        cut = None
        if "range" in parameters:
            beyond = tm.abs(place.in_sensor(F_W, R_WE)) - AT_END * parameters["range"]
            most = beyond[0]
            for each in beyond[1:]:
                most = tm.maximum(most, each)
            cut = tm.where(most >= 0.0, 1.0, 0.0)
        known = parameters["bias"]
        if "mass" in parameters:
            tool = PayloadValues(mass=parameters["mass"], com=parameters["com"], inertia=np.zeros(6)).body()
            load = tool + place.from_tool(payload.body())
            known = known + load_wrench(load, (R_WE @ place.R_ES).T @ arm.gravity)
        return F_W - place.in_world(known, R_WE), cut

    def remembered(self, arm: Arm, q: Vector, F_W: Wrench, memory: Values) -> dict[str, Any]:
        """New memory: the reading, and how often it was the one before; NaN once that is a fault.

        A tick whose memory is not finite did not happen, and no command leaves it.
        """
        if self.repeats is None:
            return {}
        reading = self._reading(arm, q, F_W)
        again = self._again(reading, memory)
        count = tm.where(again, memory["repeats"] + 1.0, 0.0)
        return {"reading": reading, "repeats": count + tm.log(tm.where(count < self.repeats - 1.5, 1.0, -1.0))}

    def check_reading(self, arm: Arm, q: Vector, F_W: Wrench, memory: Values, tick: int) -> None:
        """Refuse a reading that repeats too often; what the law side does where a tick was not finite.

        Raises:
            RangeError: It does.
        """
        if self.repeats is None or not memory:
            return
        if bool(self._again(self._reading(arm, q, F_W), memory)) and memory["repeats"] + 1.0 > self.repeats - 1.5:
            raise RangeError(
                f"F_ext must change from tick to tick; got the same reading in {self.repeats} ticks in a row, the "
                f"last of them tick {tick}; the sensor is frozen or unplugged, or it has no noise: then leave "
                "sensing.wrist.repeats out",
                name="F_ext",
                rule="changes",
            )

    def _reading(self, arm: Arm, q: Vector, F_W: Wrench) -> Array:
        """(6,) in the sensor's own axes, where a frozen one stands still while the arm moves."""
        return sensor_place(arm, self.frame, "sensing.wrist").in_sensor(F_W, dyn.pose(model_of(arm), q).R)

    @staticmethod
    def _again(reading: Array, memory: Values) -> Any:
        """Whether it is the reading before, all six numbers of it."""
        change, size = tm.abs(reading - memory["reading"]), tm.abs(reading)
        most, largest = change[0], size[0]
        for i in (1, 2, 3, 4, 5):
            most, largest = tm.maximum(most, change[i]), tm.maximum(largest, size[i])
        return most <= SAME * largest
