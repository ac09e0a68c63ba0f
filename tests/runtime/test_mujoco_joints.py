"""Motors, gears, friction and sensors in MuJoCo: what RigidPlant makes of them, and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused
from runtime_laws import Array

import taut

SAME = 1e-8  # [rad | rad/s | N m] between the two plants over a run: two engines, one scheme
PLANAR = taut.load_arm("planar2").with_gears(ratio=20.0, motor_inertia=2e-4)
ROUGH = PLANAR.with_friction(
    taut.Friction(viscous=0.2, coulomb=0.3, static=0.5, stribeck=0.1, load_motor=0.1, load_external=0.05)
)
KINETIC = PLANAR.with_friction(taut.Friction(coulomb=[0.4, 0.2], static=[0.8, 0.5], viscous=0.1))

CASES: dict[str, tuple[taut.Arm, dict[str, Any]]] = {
    "rotors": (PLANAR, {}),
    "Stribeck and load": (ROUGH, {}),
    "static and kinetic": (KINETIC, {}),
    "lossy gears": (ROUGH, {"transmission": taut.drives.Transmission(efficiency=[0.8, 0.6])}),
    "delay": (PLANAR, {"delay": 0.01}),
    "lag, steps and ripple": (
        ROUGH, {"bandwidth": 400.0, "resolution": 0.05, "ripple": taut.drives.Ripple(amplitude=0.05, periods=3)},
    ),
    "a motor's curve": (ROUGH, {"motor": taut.drives.Motor(peak=0.4, stall=0.5, no_load=100.0)}),
    "electric": (
        ROUGH,
        {"motor": taut.drives.ElectricMotor(torque_constant=0.2, resistance=1.0, inductance=1e-3, voltage=24.0), "bandwidth": 900.0},
    ),
    "elastic": (ROUGH, {"transmission": taut.drives.Transmission(stiffness=400.0, damping=0.5)}),
    "play": (ROUGH, {"transmission": taut.drives.Transmission(stiffness=800.0, damping=0.5, backlash=0.01)}),
    "one elastic joint": (ROUGH, {"transmission": taut.drives.Transmission(stiffness=[np.inf, 400.0], damping=[0.0, 0.5])}),
    "inner loop": (ROUGH, {"torque_loop": taut.drives.TorqueLoop(kp=0.3, ki=20.0), "bandwidth": 800.0}),
}  # fmt: skip


def both(arm: taut.Arm, drives: dict[str, Any], *, limits: Any = None, **options: Any) -> tuple[taut.Run, taut.Run]:
    """The same loop around a rigid plant and around MuJoCo, five steps in a control period."""
    law = taut.laws.PID(kp=[60.0, 30.0], kd=[6.0, 3.0])
    ctrl = taut.compile(law, arm, rate=200.0, sensing=options.pop("sensing", None))
    swing = taut.trajectories.Sine(center=arm.home, amplitude=[0.4, 0.3], frequency=[1.0, 1.7])
    common = {"actuation": taut.drives.Actuation(**drives), **options}
    rigid = taut.RigidPlant(arm, substeps=5, **common)
    mujoco = taut.MujocoPlant(arm, limits=limits, timestep=1e-3, **common)
    one, other = (taut.run(ctrl, plant, swing, duration=0.6, q0=arm.home + 0.1, seed=5) for plant in (rigid, mujoco))
    return one, other


@pytest.mark.part(2)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_an_arm_moves_as_in_a_rigid_plant(name: str) -> None:
    ours, theirs = both(*CASES[name])
    assert ours.outcome.ok
    assert theirs.outcome.ok
    assert np.abs(ours.v).max() > 0.3
    for column in ("q", "v"):
        np.testing.assert_allclose(
            getattr(theirs, column), getattr(ours, column), rtol=0.0, atol=SAME, err_msg=column
        )


def test_sensors_give_the_same_numbers_from_the_same_seed() -> None:
    sensors = taut.sensors.Sensors(
        position=taut.sensors.Encoder(resolution=1e-3, noise=2e-4, side="motor"),
        velocity=None,
        torque=taut.sensors.TorqueSensor(noise=0.01, bias=0.02),
        wrench=None,
    )
    ours, theirs = both(ROUGH, {"bandwidth": 500.0}, sensors=sensors, sensing=taut.Sensing(velocity="difference"))
    np.testing.assert_allclose(theirs.extra["sensed.q"], ours.extra["sensed.q"], rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(theirs.extra["sensed.v"], ours.extra["sensed.v"], rtol=0.0, atol=1e-3)


def test_a_sensor_at_its_range_is_said_in_a_run() -> None:
    sensors = taut.sensors.Sensors(
        tip=taut.sensors.Accelerometer(range=6.0), wrench=taut.sensors.WrenchSensor(range=(100.0, 10.0))
    )
    ctrl = taut.compile(taut.laws.PID(kp=60.0, kd=6.0), PLANAR, rate=500.0)
    swing = taut.trajectories.Sine(center=PLANAR.home, amplitude=0.3, frequency=1.0)
    out = taut.run(ctrl, taut.MujocoPlant(PLANAR, sensors=sensors), swing, duration=0.6)
    at_range = int(out.extra["saturated.a_tip"].sum())
    assert 0 < at_range < len(out)
    assert f"the sensor of a_tip was at its range in {at_range} of {len(out)} ticks" in out.outcome.message
    assert not out.extra["saturated.F_ext"].any()


class Felt(taut.Law):
    """Moves along, and shows what joint torque and tip acceleration are measured."""

    kp: taut.Gain  # [N m/rad]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        tiny = 1e-9
        tip = tiny * taut.math.array([x.a_tip[0], x.a_tip[2]])
        return taut.Torque(P=self.kp @ (ref.q - x.q), D=-3.0 * x.v, felt=tiny * x.tau_meas, tip=tip)


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")  # of the elastic one, which dry friction alone holds
@pytest.mark.parametrize("name", ["rotors", "Stribeck and load", "elastic", "static and kinetic"])
def test_torque_and_acceleration_are_measured_where_their_sensors_are(name: str) -> None:
    arm, drives = CASES[name]
    options: dict[str, Any] = {
        "actuation": taut.drives.Actuation(**drives), "sensors": taut.sensors.Sensors(tip=taut.sensors.Accelerometer(), wrench=None),
    }  # fmt: skip
    ctrl = taut.compile(Felt(kp=40.0), arm, rate=500.0)
    swing = taut.trajectories.Sine(center=arm.home, amplitude=0.3, frequency=1.0)
    plants = (
        taut.RigidPlant(arm, substeps=2, **options),
        taut.MujocoPlant(arm, limits=None, timestep=1e-3, **options),
    )
    ours, theirs = (taut.run(ctrl, plant, swing, duration=0.4) for plant in plants)
    for term in ("felt", "tip"):
        assert np.abs(ours.terms[term]).max() > 1e-9
        np.testing.assert_allclose(
            theirs.terms[term], ours.terms[term], rtol=0.0, atol=2e-6 * np.abs(ours.terms[term]).max()
        )


def loaded(model: str, share: float, duration: float) -> taut.Run:
    """An arm that only friction holds, with more of it at rest than in motion; gravity takes a share of that."""
    arm = taut.load_arm(model)
    static = np.maximum(np.abs(taut.snapshot(arm, arm.home).g) / share, 0.01)
    arm = arm.with_friction(taut.Friction(coulomb=0.6 * static, static=static, stribeck=0.05, viscous=0.1))
    idle = taut.compile(taut.laws.PID(kp=0.0), arm)
    return taut.run(idle, taut.MujocoPlant(arm, limits=None), duration=duration)


@pytest.mark.part(1)
@pytest.mark.bars
@pytest.mark.parametrize("model", ["one_joint", "panda"])
def test_a_link_loaded_below_break_away_does_not_creep(model: str, share: float, bar: Any) -> None:
    """A minute of it in `make bars`; six seconds here, in which it may creep a tenth."""
    seconds = share(60)
    run = loaded(model, 0.98, float(seconds))
    crept = float(np.abs(run.q - run.q[0]).max())
    bar(f"creep of {model} in MuJoCo at 98 % of break-away, 60 s [rad]", crept)
    assert crept < 1e-9 * seconds / 60.0


@pytest.mark.parametrize("model", ["one_joint", "panda"])
def test_it_slips_at_its_break_away_torque(model: str) -> None:
    assert np.abs(loaded(model, 0.99, 0.2).v).max() < 1e-9
    assert np.abs(loaded(model, 1.01, 0.2).v[-1]).max() > 1e-3


def test_parameters_of_every_part_change_in_a_run() -> None:
    arm, drives = ROUGH, {"motor": taut.drives.Motor(peak=5.0), "bandwidth": 500.0}
    plant = taut.MujocoPlant(arm, limits=None, actuation=taut.drives.Actuation(**drives))
    ctrl = taut.compile(taut.laws.PID(kp=60.0, kd=6.0), arm)
    goal = taut.JointMotion(q=arm.home + 0.5)
    changes: dict[str, Any] = {
        "actuation.motor.peak": 0.05, "plant.friction.static": 3.0, "plant.friction.viscous": 2.0,
        "plant.rotor_inertia": 1.0, "plant.payload.mass": 2.0,
    }  # fmt: skip
    plain = taut.run(ctrl, plant, goal, duration=0.1)
    for path, value in changes.items():
        changed = taut.run(ctrl, plant, goal, duration=0.1, events=[taut.Event(t=0.02, set={path: value})])
        assert np.abs(changed.q - plain.q).max() > 1e-6, path
        twin = taut.RigidPlant(arm, actuation=taut.drives.Actuation(**drives))
        rigid = taut.run(ctrl, twin, goal, duration=0.1, events=[taut.Event(t=0.02, set={path: value})])
        np.testing.assert_allclose(changed.q, rigid.q, rtol=0.0, atol=SAME, err_msg=path)
    again: Array = taut.run(ctrl, plant, goal, duration=0.1).q
    np.testing.assert_array_equal(again, plain.q)


@pytest.mark.parametrize("stiffness", [1e5, 1e6, 3e6])
def test_steps_that_are_too_long_for_a_spring_are_refused_with_what_is_enough(stiffness: float) -> None:
    stiff = taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=stiffness))
    ctrl = taut.compile(taut.laws.PID(kp=1.0), PLANAR)
    with pytest.raises(taut.errors.RangeError) as caught:
        taut.run(ctrl, taut.MujocoPlant(PLANAR, actuation=stiff), duration=0.01)
    words = str(caught.value)
    assert "too fast for steps of 0.001 s; give the plant steps of " in words
    enough = float(words.partition("give the plant steps of ")[2].partition(" s")[0])
    assert taut.run(ctrl, taut.MujocoPlant(PLANAR, actuation=stiff, timestep=enough), duration=0.01).outcome.ok


def test_what_does_not_go_together_is_refused_in_words() -> None:
    plant = taut.MujocoPlant(ROUGH)
    with refused(taut.errors.RangeError):
        plant.set_parameters({"plant.friction.static": 0.1})
    with refused(taut.errors.UsageError):
        taut.MujocoPlant(ROUGH, actuation=2.0)  # type: ignore[arg-type]
    with refused(taut.errors.UsageError):
        taut.MujocoPlant(
            taut.load_arm("planar2"),
            actuation=taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=1e3)),
        )
