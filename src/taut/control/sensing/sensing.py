"""Sensing: from what the sensors give to what the law sees, and what is known of a wrist sensor."""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import RangeError, UsageError
from taut.base.fields import Declared, Field, Part, Plain
from taut.base.paths import subtree
from taut.base.types import Array, Vector, Wrench
from taut.control.sensing.filters import Difference, Kalman, LowPass, Measured, Notch, VelocitySource, check_filter
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.trace import math as tm

if TYPE_CHECKING:
    from taut.maths.wrist import SensorPlace

__all__ = ["FILTERED", "VELOCITIES", "Sensing", "SATURATED", "Wrist"]

Values = Mapping[str, Any]
Velocity: TypeAlias = Literal["measured", "difference"] | LowPass | Difference | Kalman
VELOCITIES: Final[tuple[Literal["measured", "difference"], ...]] = ("measured", "difference")
SATURATED: Final = "saturated.F_ext"  # 1.0 in a tick whose reading is at the end of the sensor's range
WRENCH: Final = "N, N m"
AT_END: Final = 1.0 - 1e-9  # of the range: turning a reading into the world and back rounds
SAME: Final = 1e-9  # of a reading's size: two that differ by less are one; noise of a sensor is far above that
FILTERED: Final = ("F_ext", "tau_meas")  # measurements that may have a low-pass of their own


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
        self._place(arm)

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
        from taut.maths.wrist import load_wrench

        R_WE = dyn.pose(model_of(arm), q).R
        place = self._place(arm)
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

    def _place(self, arm: Arm) -> SensorPlace:
        """Where the sensor stands, from the tool."""
        from taut.maths.wrist import sensor_place

        return sensor_place(arm, self.frame, "sensing.wrist")

    def _reading(self, arm: Arm, q: Vector, F_W: Wrench) -> Array:
        """(6,) in the sensor's own axes, where a frozen one stands still while the arm moves."""
        return self._place(arm).in_sensor(F_W, dyn.pose(model_of(arm), q).R)

    @staticmethod
    def _again(reading: Array, memory: Values) -> Any:
        """Whether it is the reading before, all six numbers of it."""
        change, size = tm.abs(reading - memory["reading"]), tm.abs(reading)
        most, largest = change[0], size[0]
        for i in (1, 2, 3, 4, 5):
            most, largest = tm.maximum(most, change[i]), tm.maximum(largest, size[i])
        return most <= SAME * largest


class Sensing(Declared):
    """How the law gets what it sees from what the sensors give.

    Positions and measured velocities go through the notch first; velocities are made from what it lets through.
    Every number is a run-time parameter: sensing.velocity.cutoff, sensing.notch.frequency, ...

    Args:
        velocity: "measured" takes the velocity that the plant measures, `taut.sensors.LowPass(cutoff=)` filters it;
            "difference" differences positions of successive ticks, `taut.sensors.Difference(cutoff=)` with a
            low-pass; `taut.sensors.Kalman(...)` estimates it from positions.
        notch: Takes a vibration out of positions and velocities.
        wrist: What is known of the wrist's sensor: bias and load are taken out of the measured wrench, its range and
            its faults are watched.
        F_ext: Low-pass of the measured wrench, for a law that uses it; after what `wrist` does.
        tau_meas: Low-pass of the measured joint torques, for a law that uses them.

    Raises:
        UsageError: Something else.

    Example:
        >>> sensing = Sensing(velocity=Difference(cutoff=30.0), notch=Notch(frequency=18.0, width=4.0))
        >>> list(sensing.parameters())
        ['velocity.cutoff', 'notch.frequency', 'notch.width', 'notch.depth']

    References:
        Chapter, section 10.1 control system overview, and the pseudocode of figures 10.8 and 10.13.
    """

    velocity: Plain[Velocity] = Plain(default="measured")
    notch: Part[Notch | None] = Part(Notch, optional=True)
    wrist: Part[Wrist | None] = Part(Wrist, optional=True)
    F_ext: Part[LowPass | None] = Part(LowPass, optional=True)
    tau_meas: Part[LowPass | None] = Part(LowPass, optional=True)

    def check(self) -> None:
        word = isinstance(self.velocity, str)
        if self.velocity not in VELOCITIES if word else not isinstance(self.velocity, (LowPass, Difference, Kalman)):
            words = ", ".join(map(repr, VELOCITIES))
            self.refuse("velocity", f"must be {words}, a LowPass, Difference or Kalman; got {self.velocity!r}")

    @property
    def _source(self) -> VelocitySource:
        if isinstance(self.velocity, LowPass):
            return Measured(low_pass=self.velocity)
        if isinstance(self.velocity, (Difference, Kalman)):
            return self.velocity
        return Measured() if self.velocity == "measured" else Difference()

    # ---------------------------------------------------------------- what it declares

    @property
    def needs_velocity(self) -> bool:
        """Whether a measured velocity is used."""
        return self._source.needs_velocity

    @property
    def needs(self) -> tuple[str, ...]:
        """Measurements beyond q and v that it changes, which the law must use."""
        return tuple(name for name in FILTERED if self._changed_by(name))

    def _changed_by(self, name: str) -> list[str]:
        """The fields that change a measurement."""
        ways = ("wrist", "F_ext") if name == "F_ext" else (name,)
        return [way for way in ways if getattr(self, way) is not None]

    @property
    def tells(self) -> tuple[str, ...]:
        """What it gives beside measurements: 1.0 in a tick in which a sensor is at the end of its range."""
        return (SATURATED,) if self.wrist is not None and self.wrist.range is not None else ()

    @property
    def alters(self) -> frozenset[str]:
        """Measurements that the law sees otherwise than they are measured."""
        of_notch = {"q", "v"} if self.notch is not None else set()
        return frozenset({*of_notch, *self.needs, *(() if self.velocity == "measured" else ("v",))})

    # ---------------------------------------------------------------- checks

    def check_fit(self, arm: Arm, rate: float) -> None:
        """Whether it fits an arm and a rate [Hz].

        Raises:
            ShapeError: A number that is neither a scalar nor one per joint or axis.
            RangeError: A frequency at half the rate or above.
            UnknownNameError, UsageError: A wrist sensor at a frame that does not exist, or that leaves the tool.
        """
        for name, part in self.declared_parts().items():
            if isinstance(part, Wrist):
                part.check_fit(arm)
            else:
                check_filter(part, f"sensing.{name}", rate, 6 if name == "F_ext" else arm.joint_names)

    def check_used(self, used: Set[str], law: str) -> None:
        """What changes a measurement that the law does not use would be a number that changes nothing.

        Raises:
            UsageError: There is such a number.
        """
        for name in self.needs:
            for way in self._changed_by(name):
                if name not in used:
                    does = "corrects" if way == "wrist" else "filters"
                    raise UsageError(
                        f"sensing {does} {name}, which {law} does not use; leave {way} out of the sensing",
                        name=f"sensing.{way}",
                    )

    def check_reading(self, arm: Arm, measured: Values, memory: Values, tick: int) -> None:
        """Whether a tick that was not finite had a sensor's fault.

        Raises:
            RangeError: It had.
        """
        if self.wrist is not None:
            self.wrist.check_reading(arm, measured["q"], measured["F_ext"], subtree(memory, "wrist"), tick)

    # ---------------------------------------------------------------- the pure functions

    def start(self, arm: Arm, measured: Values, parameters: Values, payload: PayloadValues) -> dict[str, Any]:
        """Memory by path at the first tick: as if what is measured then had always been constant.

        Args:
            arm: The arm.
            measured: What the sensors give.
            parameters: By path below "sensing".
            payload: What the tool carries, by the controller's model.
        """
        q, v = measured["q"], measured["v"]
        memory = _below("velocity", self._source.start(q, v))
        if self.notch is not None:
            memory |= _below("notch.q", self.notch.start(q))
            if self.needs_velocity:
                memory |= _below("notch.v", self.notch.start(v))
        if self.wrist is not None:
            memory |= _below("wrist", self.wrist.start(arm, q, measured["F_ext"]))
        corrected = {**measured, **self._wrench(arm, measured, parameters, payload)}
        for name in self._filters:
            memory |= _below(name, getattr(self, name).start(corrected[name]))
        return memory

    @property
    def _filters(self) -> list[str]:
        return [name for name in FILTERED if getattr(self, name) is not None]

    def _wrench(self, arm: Arm, measured: Values, parameters: Values, payload: PayloadValues) -> dict[str, Any]:
        """The measured wrench without what the wrist knows of it, and whether it is at the end of its range."""
        if self.wrist is None:
            return {}
        own = subtree(parameters, "wrist")
        F_ext, cut = self.wrist.corrected(arm, measured["q"], measured["F_ext"], own, payload)
        return {"F_ext": F_ext} if cut is None else {"F_ext": F_ext, SATURATED: cut}

    def see(
        self, arm: Arm, measured: Values, memory: Values, parameters: Values, payload: PayloadValues, dt: Any
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """What the law sees, by measurement, and the new memory; with it what `tells` names.

        Args:
            arm: The arm, which knows the joints that turn without end.
            measured: What the sensors give.
            memory: By path, as `start` gives it.
            parameters: By path below "sensing".
            payload: What the tool carries, by the controller's model.
            dt: [s].
        """
        after: dict[str, Any] = {}
        q, v = measured["q"], measured["v"]
        if self.notch is not None:
            own = subtree(parameters, "notch")
            q, new = self.notch.filtered(q, subtree(memory, "notch.q"), own, dt, arm.difference)
            after |= _below("notch.q", new)
            if self.needs_velocity:
                v, new = self.notch.filtered(v, subtree(memory, "notch.v"), own, dt)
                after |= _below("notch.v", new)
        v, new = self._source.velocity(arm, q, v, subtree(memory, "velocity"), subtree(parameters, "velocity"), dt)
        after |= _below("velocity", new)
        if self.wrist is not None:
            new = self.wrist.remembered(arm, measured["q"], measured["F_ext"], subtree(memory, "wrist"))
            after |= _below("wrist", new)
        seen = {**measured, **self._wrench(arm, measured, parameters, payload), "q": q, "v": v}
        for name in self._filters:
            low_pass = getattr(self, name)
            seen[name], new = low_pass.filtered(seen[name], subtree(memory, name), subtree(parameters, name), dt)
            after |= _below(name, new)
        return seen, after

    @property
    def summary(self) -> str:
        """What it does, in one line."""
        source = self.velocity if isinstance(self.velocity, str) else type(self.velocity).__name__
        said = [f"v by {source}"] if self.velocity != "measured" else []
        said += ["Notch of q and v"] if self.notch is not None else []
        said += [] if self.wrist is None else [f"F_ext without {self.wrist.takes_out}"]
        return ", ".join([*said, *(f"LowPass of {name}" for name in self._filters)]) or "as measured"


def _below(head: str, values: Values) -> dict[str, Any]:
    return {f"{head}.{name}": value for name, value in values.items()}
