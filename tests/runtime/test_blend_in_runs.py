"""Blend in runs: what events change comes in smoothly, fused and hosted, and is recorded."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from runtime_laws import HandPlant

import taut

ARM = taut.load_arm("planar2")
L = taut.laws
GOAL = taut.JointMotion(q=[0.5, 0.3])
LAW = L.PID(kp=20.0, kd=2.0, ki=5.0)
PLANTS: dict[str, Callable[[], Any]] = {
    "fused": lambda: taut.RigidPlant(ARM, adds=("gravity", "coriolis")),
    "hosted": lambda: HandPlant(),
}
SHAKY = taut.sensors.Sensors(position=taut.sensors.Encoder(noise=1e-3), velocity=taut.sensors.Tachometer(noise=1e-2))
CHANGE = taut.Event(t=0.1, set={"law.kp": 60.0, "law.ki": 0.0})


def run(plant: Any, *events: taut.Event, engine: Any = "native", **limits: Any) -> taut.Run:
    made = taut.Limits(**limits) if limits else None
    ctrl = taut.compile(LAW, ARM, limits=made, adds=plant.adds, engine=engine)
    out = taut.run(ctrl, plant, GOAL, duration=0.3, events=events)
    assert out.outcome.ok
    np.testing.assert_allclose(sum(out.terms.values()), out.command, rtol=0.0, atol=1e-12)
    return out


@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize("make", PLANTS.values(), ids=PLANTS)
class TestInARun:
    @pytest.mark.part(1)
    def test_an_event_makes_no_jump_and_acts_in_full_later(self, make: Callable[[], Any], engine: Any) -> None:
        hard, soft = run(make(), CHANGE, engine=engine), run(make(), CHANGE, engine=engine, blend=0.05)
        same = run(make(), engine=engine, blend=0.05)
        jump = np.abs(hard.command[100] - hard.command[99]).max()
        assert jump > 1.0
        np.testing.assert_allclose(soft.command[100], same.command[100], rtol=0.0, atol=1e-11)
        assert np.abs(np.diff(soft.command[90:], axis=0)).max() < 0.3 * jump
        np.testing.assert_array_equal(soft.terms["blend"][151:], 0.0)
        assert np.abs(soft.terms["blend"][100:140]).min(axis=0).max() > 0.1
        assert soft.terms["I"][200:].any() == np.False_

    def test_the_run_begins_softly(self, make: Callable[[], Any], engine: Any) -> None:
        out = run(make(), engine=engine, blend=0.1)
        np.testing.assert_allclose(out.command[0], 0.0, atol=1e-14)  # the plant adds gravity: nothing holds the arm
        np.testing.assert_array_equal(out.terms["blend"][101:], 0.0)
        assert (out.terms["blend"][1:99] != 0.0).all()

    def test_what_happens_to_the_plant_is_no_change_of_the_controller(
        self, make: Callable[[], Any], engine: Any
    ) -> None:
        plant = make()
        path = "plant.mass" if isinstance(plant, HandPlant) else "plant.payload.mass"
        out = run(plant, taut.Event(t=0.2, set={path: 2.0}), engine=engine, blend=0.05)
        np.testing.assert_array_equal(out.terms["blend"][60:], 0.0)

    def test_both_at_once_are_told_apart(self, make: Callable[[], Any], engine: Any) -> None:
        plant = make()
        path = "plant.mass" if isinstance(plant, HandPlant) else "plant.payload.mass"
        both = taut.Event(t=0.1, set={path: 2.0, "law.kp": 60.0})
        out, same = run(plant, both, engine=engine, blend=0.05), run(make(), engine=engine, blend=0.05)
        np.testing.assert_allclose(out.command[100], same.command[100], rtol=0.0, atol=1e-11)

    def test_an_event_at_the_start_is_there_from_the_start(self, make: Callable[[], Any], engine: Any) -> None:
        out = run(make(), taut.Event(t=0.0, set={"law.kp": 60.0}), engine=engine, blend=0.05)
        np.testing.assert_allclose(out.terms["P"][0], 60.0 * (GOAL.q - ARM.home), rtol=1e-12)
        np.testing.assert_allclose(out.command[0], 0.0, atol=1e-12)


def test_fused_and_float_and_mujoco_take_up_the_same() -> None:
    arm = taut.load_arm("planar3")
    law = L.GravityPID(kp=40.0, kd=6.0, ki=5.0)
    events = [taut.Event(t=0.15, set={"law.kp": 120.0, "model.payload.mass": 0.5})]
    runs = []
    for plant in (taut.RigidPlant(arm), taut.MujocoPlant(arm)):
        ctrl = taut.compile(law, arm, limits=taut.Limits(blend=0.1))
        runs.append(taut.run(ctrl, plant, taut.JointMotion(q=arm.home + 0.2), duration=0.4, events=events))
    np.testing.assert_allclose(runs[0].terms["blend"], runs[1].terms["blend"], rtol=0.0, atol=2e-2)
    assert np.abs(runs[0].terms["blend"][160]).max() > 0.5
    for out in runs:
        assert np.abs(np.diff(out.command, axis=0)).max() < 1.0


def test_an_event_with_noisy_sensors_takes_up_the_change_and_not_the_noise() -> None:
    plant = taut.RigidPlant(ARM, adds=("gravity", "coriolis"), sensors=SHAKY)
    ctrl = taut.compile(LAW, ARM, limits=taut.Limits(blend=0.05), adds=plant.adds)
    soft, same = (taut.run(ctrl, plant, GOAL, duration=0.2, events=events, seed=3) for events in ([CHANGE], []))
    np.testing.assert_allclose(soft.command[:101], same.command[:101], rtol=0.0, atol=1e-11)


def test_a_sensor_that_gets_worse_is_felt_at_once() -> None:
    """An event that changes the gains too: the blend takes up what the gains do, and not what the sensor does."""
    plant = taut.RigidPlant(
        ARM, adds=("gravity", "coriolis"), sensors=taut.sensors.Sensors(position=taut.sensors.Encoder(noise=1e-4))
    )
    ctrl = taut.compile(LAW, ARM, limits=taut.Limits(blend=0.05), adds=plant.adds)
    worse = {"sensors.position.noise": 0.1}
    both, sensor = (
        taut.run(ctrl, plant, GOAL, duration=0.15, events=[taut.Event(t=0.1, set=values)], seed=3)
        for values in ({**worse, "law.kp": 60.0}, worse)
    )
    np.testing.assert_allclose(both.command[100], sensor.command[100], rtol=0.0, atol=1e-11)
    assert np.abs(sensor.command[100] - sensor.command[99]).max() > 0.2
