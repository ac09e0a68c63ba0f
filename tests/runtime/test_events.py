"""Events: parameters that take new values at stated times, at the right tick, all or none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused
from runtime_laws import Array, HandPlant

import taut
from taut.runtime.events import listed

ARM = taut.load_arm("planar2")
ONES = taut.JointMotion(q=[1.0, 1.0])


class Level(taut.Law):
    """A torque that is its gain, so that a run shows the gain of every tick."""

    level: taut.Gain = taut.Gain(0.0, unit="N m")
    other: taut.Gain = taut.Gain(0.0)  # [N m]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(level=self.level @ ref.q, other=self.other @ ref.q)


def levels(
    *events: taut.Event, duration: float = 0.01, plant: Any = None, engine: str = "native"
) -> tuple[Array, Array]:
    """Both gains in every tick."""
    made = taut.RigidPlant(ARM, adds=("gravity",)) if plant is None else plant
    ctrl = taut.compile(Level(), ARM, adds=made.adds, engine=engine)  # type: ignore[arg-type]
    out = taut.run(ctrl, made, ONES, duration=duration, events=events)
    assert out.outcome.ok
    return out.terms["level"][:, 0], out.terms["other"][:, 0]


def at(t: float, level: float) -> taut.Event:
    return taut.Event(t=t, set={"law.level": level})


PLANTS: dict[str, Callable[[], Any]] = {
    "fused": lambda: taut.RigidPlant(ARM, adds=("gravity", "coriolis")),
    "hosted": lambda: HandPlant(),
}


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
class TestAnEventActs:
    @pytest.mark.parametrize(
        ("t", "tick"),
        [
            (0.0, 0),
            (0.003, 3),
            (0.0030000001, 4),  # off the grid: from the tick after it
            (0.0029999, 3),
            (0.0005, 1),
            (0.01, 10),  # the last tick
            (3 * 0.001, 3),  # not 0.003 in floats, and meant to be
        ],
    )
    def test_from_the_tick_at_or_just_after_its_time(self, plant: Callable[[], Any], t: float, tick: int) -> None:
        got, _ = levels(at(t, 5.0), plant=plant())
        np.testing.assert_array_equal(got, np.where(np.arange(11) >= tick, 5.0, 0.0))

    def test_in_order_of_time_whatever_the_order_given(self, plant: Callable[[], Any]) -> None:
        got, _ = levels(at(0.008, 3.0), at(0.002, 1.0), at(0.005, 2.0), plant=plant())
        np.testing.assert_array_equal(got, [0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3])

    def test_at_the_same_tick_in_the_order_given(self, plant: Callable[[], Any]) -> None:
        both = taut.Event(t=0.0035, set={"law.level": 2.0, "law.other": 7.0})
        got, other = levels(at(0.004, 1.0), both, at(0.0039, 3.0), plant=plant())
        assert (got[3], got[4], other[3], other[4]) == (0.0, 3.0, 0.0, 7.0)

    def test_for_as_long_as_the_run_and_no_longer(self, plant: Callable[[], Any]) -> None:
        made = plant()
        levels(at(0.002, 5.0), plant=made)
        got, _ = levels(plant=made)
        assert not got.any()


def test_what_acts_at_time_zero_is_there_when_memory_starts() -> None:
    """A rate limit starts from the gravity torque of the payload that the event brings."""
    ctrl = taut.compile(taut.laws.GravityPID(kp=0.0, kd=0.0), ARM, limits=taut.Limits(tau_dot=1.0))
    load = {"model.payload.mass": 3.0, "plant.payload.mass": 3.0}
    out = taut.run(ctrl, taut.RigidPlant(ARM), duration=0.01, events=[taut.Event(t=0.0, set=load)])
    g = taut.snapshot(ARM, ARM.home, payload=taut.Payload(mass=3.0)).g
    np.testing.assert_allclose(out.tau[0], g, rtol=1e-12)
    np.testing.assert_allclose(out.terms["rate_limit"][0], 0.0, atol=1e-12)


def test_many_events_act_one_by_one_and_fast() -> None:
    """Five thousand changes in as many ticks; looking all of them up in every tick would take minutes."""
    changes = [at(k * 1e-3, float(k % 2)) for k in range(5001)]
    got, _ = levels(*changes, duration=5.0, plant=PLANTS["fused"]())
    np.testing.assert_array_equal(got, np.arange(5001) % 2)


def test_the_float_engine_does_the_same() -> None:
    got, _ = levels(at(0.0, 1.0), at(0.0042, 2.0), engine="float")
    np.testing.assert_array_equal(got, [1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 2])


# -------------------------------------------------------------------- refused


@pytest.mark.parametrize(
    "make",
    [
        lambda: taut.Event(t=-0.1, set={"law.kp": 1.0}),
        lambda: taut.Event(t=np.nan, set={"law.kp": 1.0}),
        lambda: taut.Event(t=True, set={"law.kp": 1.0}),
        lambda: taut.Event(t=1.0, set={}),
        lambda: taut.Event(t=1.0, set=["law.kp"]),
        lambda: listed([{"t": 1.0}]),
        lambda: listed(5),
    ],
    ids=range(7),
)
def test_what_is_no_event_is_refused_in_words(make: Callable[[], object]) -> None:
    with refused(taut.TautError):
        make()


BAD: list[tuple[taut.Event, type[taut.TautError]]] = [
    (taut.Event(t=0.005, set={"law.levl": 1.0}), taut.errors.UnknownNameError),
    (taut.Event(t=0.005, set={"law.level": -1.0}), taut.errors.RangeError),
    (taut.Event(t=0.005, set={"law.level": np.nan}), taut.errors.RangeError),
    (taut.Event(t=0.0101, set={"law.level": 1.0}), taut.errors.RangeError),
    (taut.Event(t=0.005, set={"law.level": 1.0, "plant.none": 1.0}), taut.errors.UnknownNameError),
    (taut.Event.push(t=0.005, peak=[5.0, 0.0, 0.0]), taut.errors.UnknownNameError),
]  # fmt: skip


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
@pytest.mark.parametrize(("event", "kind"), BAD, ids=range(len(BAD)))
def test_a_wrong_event_is_refused_before_anything_happens(
    plant: Callable[[], Any], event: taut.Event, kind: type[taut.TautError], tmp_path: Any
) -> None:
    made = plant()
    ctrl = taut.compile(Level(), ARM, adds=made.adds)
    log = tmp_path / "run.mcap"
    with refused(kind):
        taut.run(ctrl, made, ONES, duration=0.01, events=[at(0.0, 1.0), event], log=log)
    assert not log.exists()
    assert ctrl.parameters["law.level"] == 0.0
    if isinstance(made, HandPlant):
        assert not made.commands


def test_a_plants_own_parameter_is_checked_before_the_run_too() -> None:
    made = HandPlant()
    ctrl = taut.compile(Level(), ARM, adds=made.adds)
    with refused(taut.errors.RangeError):
        taut.run(ctrl, made, ONES, duration=0.01, events=[taut.Event(t=0.005, set={"plant.mass": 0.0})])
    assert not made.commands
