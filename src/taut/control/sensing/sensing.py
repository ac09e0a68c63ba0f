"""Sensing: from what the sensors give to what the law sees."""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Any, Final, Literal, TypeAlias

from taut.arm.description import Arm
from taut.base.errors import UsageError
from taut.base.fields import Declared, Part, Plain
from taut.base.paths import subtree
from taut.control.sensing.filters import LowPass, Notch, check_filter
from taut.control.sensing.velocity import Difference, Kalman, Measured, VelocitySource
from taut.control.sensing.wrist import SATURATED, Wrist
from taut.maths.model import PayloadValues

__all__ = ["FILTERED", "VELOCITIES", "Sensing"]

Values = Mapping[str, Any]
Velocity: TypeAlias = Literal["measured", "difference"] | LowPass | Difference | Kalman
VELOCITIES: Final[tuple[Literal["measured", "difference"], ...]] = ("measured", "difference")
FILTERED: Final = ("F_ext", "tau_meas")  # measurements that may have a low-pass of their own


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
