"""Runs of the same controller and plant, one after another: what is kept of them changes no number."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.base.fields import Plain

ARM = taut.load_arm("planar2")
LAW = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
SINE = taut.trajectories.Sine(center=ARM.home, amplitude=0.2, frequency=0.5)


def same(a: taut.Run, b: taut.Run) -> None:
    """Every column, bit for bit."""
    one, other = a.arrays(), b.arrays()
    assert one.keys() == other.keys()
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)
    assert a.outcome == b.outcome  # its message too


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"duration": 0.3},
        {"ref": taut.trajectories.Sine(center=ARM.home, amplitude=0.1, frequency=1.0)},
        {"ref": taut.JointMotion(q=ARM.home)},
        {"q0": ARM.home + 0.1},
        {"seed": 7},
        {"events": [taut.Event(t=0.1, set={"law.kp": 50.0, "plant.payload.mass": 1.0})]},
    ],
    ids=str,
)
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_run_is_that_of_a_fresh_controller_whatever_ran_before(change: dict[str, Any], noise: float) -> None:
    sensors = taut.sensors.Sensors(velocity=taut.sensors.Tachometer(noise=noise))
    plant = taut.RigidPlant(ARM, sensors=sensors)
    ctrl = taut.compile(LAW, ARM)
    given = {"ref": SINE, "duration": 0.2, "q0": ARM.home}
    for _ in range(2):
        taut.run(ctrl, plant, **given)
    again, once_more = (taut.run(ctrl, plant, **given | change) for _ in range(2))
    fresh = taut.run(taut.compile(LAW, ARM), dataclasses.replace(plant), **given | change)
    same(again, fresh)
    same(once_more, fresh)


def test_gains_that_changed_between_runs_act() -> None:
    ctrl, plant = taut.compile(LAW, ARM), taut.RigidPlant(ARM)
    taut.run(ctrl, plant, SINE, duration=0.2)
    ctrl.parameters["law.kp"] = 30.0
    other = taut.compile(taut.laws.ComputedTorque(kp=30.0, kd=20.0), ARM)
    fresh = taut.run(other, taut.RigidPlant(ARM), SINE, duration=0.2)
    np.testing.assert_array_equal(taut.run(ctrl, plant, SINE, duration=0.2).q, fresh.q)
    ctrl.parameters["law.kd"] = 5000.0
    with pytest.warns(taut.errors.StabilityWarning):  # judged with the gains of this run
        taut.run(ctrl, plant, SINE, duration=0.002)


def test_the_second_run_traces_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    ctrl, plant = taut.compile(LAW, ARM), taut.RigidPlant(ARM)
    taut.run(ctrl, plant, SINE, duration=0.2)
    monkeypatch.setattr("taut.codegen.loop.trace", lambda *_: pytest.fail("traced again"))
    taut.run(ctrl, plant, duration=0.1)


def test_a_record_is_its_own() -> None:
    loop = taut.Loop(taut.compile(LAW, ARM), taut.RigidPlant(ARM), SINE, duration=0.2)
    first, second = taut.run(loop), taut.run(loop)
    wanted = second.reference.q.copy()
    first.reference.q[...], second.reference.q[...] = 9.0, 9.0
    np.testing.assert_array_equal(taut.run(loop).reference.q, wanted)


@dataclasses.dataclass(frozen=True, eq=False)
class Weighted(taut.RigidPlant):
    """A plant of the user's own, whose numbers may be another's."""

    numbers: dict[str, float] = dataclasses.field(default_factory=dict)

    def command(self, command: Any, memory: Any, t: Any) -> Any:
        return super().command(self.numbers["factor"] * command, memory, t)


class Floor(taut.environments.Environment):
    """A part of the user's own."""

    numbers: Plain[dict[str, float]] = Plain(dict)

    def wrench(self, T_WE: Any, twist: Any, t: Any, memory: Any, parameters: Any, dt: Any) -> Any:
        return np.array([self.numbers["factor"], 0.0, 0.0, 0.0, 0.0, 0.0]), {}


class Scaled(taut.Law):
    """A law of the user's own."""

    kp: taut.Gain
    numbers: Plain[dict[str, float]] = Plain(dict)

    def command(self, x: Any, ref: Any) -> Any:
        return taut.Torque(P=self.kp @ (self.numbers["factor"] * x.difference(ref.q)), D=-20.0 * x.v)


class Walk(taut.trajectories.Sine):
    """A motion of the user's own."""

    def rows(self, times: Any) -> Any:
        rows = super().rows(times)
        return taut.JointMotion.of({"q": rows.q + 0.01 * NUMBERS["factor"], "v": rows.v, "a": rows.a})


NUMBERS = {"factor": 1.0}


@pytest.mark.parametrize(
    ("law", "plant", "ref"),
    [
        (LAW, Weighted(ARM, numbers=NUMBERS), SINE),
        (LAW, taut.RigidPlant(ARM, environment=Floor(numbers=NUMBERS)), SINE),
        (Scaled(kp=100.0, numbers=NUMBERS), taut.RigidPlant(ARM), SINE),
        (LAW, taut.RigidPlant(ARM), Walk(center=ARM.home, amplitude=0.2, frequency=0.5)),
    ],
    ids=["plant", "environment", "law", "motion"],
)
def test_what_a_user_wrote_may_change_between_runs(law: Any, plant: Any, ref: Any) -> None:
    ctrl = taut.compile(law, ARM)
    NUMBERS["factor"] = 1.0
    first = taut.run(ctrl, plant, ref, duration=0.2)
    NUMBERS["factor"] = 0.5
    assert np.abs(taut.run(ctrl, plant, ref, duration=0.2).q - first.q).max() > 1e-6


def test_a_loop_keeps_its_plant() -> None:
    loop = taut.Loop(taut.compile(LAW, ARM), taut.RigidPlant(ARM), SINE, duration=0.2)
    with refused(taut.errors.UsageError):
        loop.plant = taut.RigidPlant(ARM)
    with refused(taut.errors.RangeError):
        loop.duration = -3.0
