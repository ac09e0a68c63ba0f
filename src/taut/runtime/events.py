"""Events: parameters that change at stated times of a run."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from taut.base.checks import finite_scalar
from taut.base.errors import RangeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.control.lawside import LawSide
from taut.loop import AnyPlant, LoopParameters
from taut.plant.environments.kinds import Push


@dataclass(frozen=True, kw_only=True)
class Event:
    """Parameters that take new values at time t, from the tick at or just after it, which must be one of the run.

    Args:
        t: [s].
        set: New values by path, such as {"plant.payload.mass": 1.0} or {"law.kp": 150.0}.

    Example:
        >>> Event(t=2.0, set={"plant.payload.mass": 1.0}).t
        2.0
    """

    t: float
    set: Mapping[str, ArrayLike]

    def __post_init__(self) -> None:
        if finite_scalar("event.t", self.t, unit="s") < 0.0:
            raise RangeError(f"event.t must be >= 0 [s]; got {self.t!r}", name="event.t")
        if not isinstance(self.set, Mapping) or not self.set:
            raise UsageError(
                f"an event sets one parameter at least: set={{'law.kp': 150.0}}; got {self.set!r}", name="set"
            )

    @classmethod
    def push(
        cls, *, t: float, peak: ArrayLike | None = None, duration: float | None = None, of: str = "environment"
    ) -> Event:
        """A push that begins at time t, given by the `taut.environments.Push` of the plant's environment.

        Args:
            t: [s].
            peak: (6,) the wrench at its peak, force first, in world axes [N, N m]; three numbers are a force. By
                default that of the Push.
            duration: [s]; by default that of the Push.
            of: Path of the Push: "environment", or "environment.NAME" where it is one of several.

        Raises:
            ShapeError, RangeError: A wrench of another shape, or not finite.

        Example:
            >>> Event.push(t=2.0, peak=[20.0, 0.0, 0.0]).set["environment.peak"].tolist()
            [20.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        """
        new: dict[str, ArrayLike] = {f"{of}.t": t}
        if peak is not None:
            new[f"{of}.peak"] = Push(peak=peak).peak
        if duration is not None:
            new[f"{of}.duration"] = duration
        return cls(t=t, set=new)


def listed(events: object) -> list[Event]:
    """Events as a list."""
    found: list[Event] = []
    for event in events if isinstance(events, Iterable) else [events]:
        if not isinstance(event, Event):
            raise UsageError(f"events must be a list of taut.Event(t=, set=); got {event!r} in it", name="events")
        found.append(event)
    return found


class Schedule:
    """The parameters that change in a run, checked, by tick; of two events in one tick the later in the list wins."""

    def __init__(
        self, side: LawSide, plant: AnyPlant, values: Mapping[str, Float64Array], events: Iterable[Event], ticks: int
    ) -> None:
        self._side = side
        self._values: dict[int, dict[str, Float64Array]] = {}
        parameters, all_values = LoopParameters(side, plant, values), dict(values)
        due = [(math.ceil(min(event.t * side.rate, ticks) - 1e-9), event) for event in listed(events)]
        for tick, event in sorted(due, key=lambda pair: pair[0]):
            if tick >= ticks:
                raise RangeError(
                    f"an event at t = {event.t:g} s would never act: the run ends at {(ticks - 1) / side.rate:g} s; "
                    "leave it out, or make the run longer",
                    name="events.t",
                    value=event.t,
                )
            new = {path: parameters.checked(path, value) for path, value in event.set.items()}
            all_values |= new
            plant.check_together(all_values)
            self._values.setdefault(tick, {}).update(new)
        self._ticks = sorted(self._values)

    @property
    def paths(self) -> set[str]:
        """The parameters that change."""
        return {path for values in self._values.values() for path in values}

    def at(self, tick: int) -> dict[str, Float64Array]:
        """The new values in a tick, by path."""
        return self._values.get(tick, {})

    def next(self, tick: int) -> int | None:
        """The first tick after `tick` in which a parameter changes."""
        later = bisect_right(self._ticks, tick)
        return self._ticks[later] if later < len(self._ticks) else None

    def check(self, tick: int, q: Float64Array, parameters: Mapping[str, Float64Array]) -> None:
        """RangeError where a change in a tick, other than the first, has no meaning at positions q."""
        if tick > 0 and self.at(tick):
            self._side.check_change(q, parameters, self.at(tick))
