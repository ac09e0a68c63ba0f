"""The drives between command and motor: resolution, ripple, speed-torque limits, an inner torque loop."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut

FREE = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_joints(viscous=0.0)  # M = 0.5 kg m^2


def held(arm: taut.Arm, tau: float, duration: float = 0.2, v0: float = 0.0, **drives: Any) -> taut.Run:
    law = taut.compile(taut.laws.PID(kp=1e-9), arm)
    plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(**drives))
    return taut.run(law, plant, taut.JointMotion(q=[1e9 * tau]), duration=duration, q0=[0.0], v0=[v0])


def test_a_torque_comes_in_steps_of_the_amplifier() -> None:
    law = taut.compile(taut.laws.PID(kp=1.0), FREE)
    ramp = taut.trajectories.Samples(times=[0.0, 1.0], q=[[-1.0], [1.0]])
    plant = taut.RigidPlant(FREE, actuation=taut.drives.Actuation(resolution=0.25))
    run = taut.run(law, plant, ramp, duration=0.5, q0=[0.0])
    np.testing.assert_array_equal(run.tau, 0.25 * np.floor(run.command / 0.25 + 0.5))
    assert len(np.unique(run.tau)) >= 4


def test_ripple_goes_with_the_turns_of_the_motor() -> None:
    arm = FREE.with_gears(ratio=7.0, motor_inertia=1e-5)
    run = held(arm, 2.0, duration=0.5, ripple=taut.drives.Ripple(amplitude=0.1, periods=4))
    np.testing.assert_allclose(run.tau, 2.0 * (1.0 + 0.1 * np.sin(4.0 * 7.0 * run.q)), rtol=1e-7)
    assert run.tau.max() > 2.19
    assert run.tau.min() < 1.81


def test_an_electric_motor_has_its_ripple_too() -> None:
    """The amplifier gives the current that the motor's nominal constant asks for."""
    arm = FREE.with_gears(ratio=7.0, motor_inertia=1e-5)
    motor = taut.drives.ElectricMotor(torque_constant=0.1, resistance=1.0)
    run = held(arm, 2.0, duration=0.5, motor=motor, ripple=taut.drives.Ripple(amplitude=0.1, periods=4))
    np.testing.assert_allclose(run.tau, 2.0 * (1.0 + 0.1 * np.sin(4.0 * 7.0 * run.q)), rtol=1e-7)
    assert run.tau.max() > 2.19


@pytest.mark.parametrize("inductance", [None, 1e-3])
def test_an_arm_that_is_too_heavy_for_its_amplifier_begins_with_no_more_than_its_current(inductance: Any) -> None:
    arm = taut.load_arm("one_joint")
    motor = taut.drives.ElectricMotor(torque_constant=0.1, resistance=1.0, inductance=inductance, current=2.0)
    law = taut.compile(taut.laws.GravityCompensation(), arm)
    plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(motor=motor, bandwidth=50.0))
    run = taut.run(law, plant, taut.JointMotion(q=[0.0]), duration=0.02, q0=[0.0])
    assert run.command[0, 0] == pytest.approx(0.981)
    np.testing.assert_allclose(run.tau, 0.2, rtol=1e-9)


class TestSpeedTorqueCurve:
    CURVE = taut.drives.Motor(peak=0.5, stall=0.8, no_load=300.0)
    ARM = FREE.with_gears(ratio=10.0, motor_inertia=1e-6)

    @pytest.mark.parametrize(
        ("v", "asked", "given"),
        [
            (0.0, 100.0, 5.0),  # 10 times the peak
            (0.0, -100.0, -5.0),
            (0.0, 3.0, 3.0),
            (20.0, 100.0, 10.0 * 0.8 * (1.0 - 200.0 / 300.0)),
            (20.0, -100.0, -5.0),  # braking is not limited by the supply
            (-20.0, -100.0, -10.0 * 0.8 * (1.0 - 200.0 / 300.0)),
            (30.0, 100.0, 0.0),  # no torque is left at the no-load speed
            (36.0, 100.0, 10.0 * 0.8 * (1.0 - 360.0 / 300.0)),  # beyond it the motor brakes
            (60.0, 100.0, -5.0),  # no more than its peak
        ],
    )
    def test_is_the_motor_s_seen_through_the_gear(self, v: float, asked: float, given: float) -> None:
        run = held(self.ARM, asked, duration=0.001, v0=v, motor=self.CURVE)
        assert run.tau[0, 0] == pytest.approx(given, rel=1e-6, abs=1e-9)

    def test_holds_behind_a_lag_too(self) -> None:
        run = held(self.ARM, 100.0, duration=12.0, motor=self.CURVE, bandwidth=100.0)
        limit = np.clip(10.0 * 0.8 * (1.0 - 10.0 * run.v / 300.0), -5.0, 5.0)
        assert (run.tau <= limit + 1e-9).all()
        assert run.v[-1, 0] == pytest.approx(30.0, rel=0.02)

    def test_is_changed_in_a_run(self) -> None:
        law = taut.compile(taut.laws.PID(kp=1e-9), self.ARM)
        plant = taut.RigidPlant(self.ARM, actuation=taut.drives.Actuation(motor=self.CURVE))
        weaker = [taut.Event(t=0.01, set={"actuation.motor.peak": 0.2})]
        run = taut.run(law, plant, taut.JointMotion(q=[1e11]), duration=0.02, q0=[0.0], events=weaker)
        assert run.tau[9, 0] == pytest.approx(5.0)
        assert run.tau[10, 0] == pytest.approx(2.0)


class TestTorqueLoop:
    """A geared joint with friction, held still behind the sensor by a stiff spring."""

    ARM = FREE.with_gears(ratio=100.0, motor_inertia=2e-5).with_friction(taut.Friction(coulomb=2.0, viscous=1.0))
    STIFF = taut.drives.Transmission(stiffness=5e3, damping=5.0)

    def error(self, loop: taut.drives.TorqueLoop | None, tau: float = 5.0) -> float:
        """What is missing of a torque that presses the link against a wall, a second after it grew there slowly."""
        wall = Wall()
        drives = taut.drives.Actuation(transmission=self.STIFF, torque_loop=loop, bandwidth=2000.0)
        plant = taut.RigidPlant(self.ARM, actuation=drives, environment=wall, substeps=10)
        law = taut.compile(taut.laws.PID(kp=1e-9), self.ARM)
        slowly = taut.trajectories.Samples(times=[0.0, 1.0, 2.0], q=[[0.0], [1e9 * tau], [1e9 * tau]])
        run = taut.run(law, plant, slowly, duration=2.0, q0=[0.0])
        assert run.outcome.ok
        J = taut.snapshot(self.ARM, run.q[-1]).J()
        return float(tau + J[:, 0] @ run.extra["F_ext"][-1])

    def test_without_it_friction_takes_its_part(self) -> None:
        assert self.error(None) == pytest.approx(2.0, abs=0.3)

    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_its_integral_leaves_nothing(self) -> None:
        assert abs(self.error(taut.drives.TorqueLoop(kp=0.5, ki=100.0))) < 0.02

    def test_its_proportional_part_leaves_a_share(self) -> None:
        assert abs(self.error(taut.drives.TorqueLoop(kp=4.0))) < 0.5 * abs(self.error(None))

    @pytest.mark.long
    def test_its_integral_does_not_wind_up_behind_a_motor_at_its_limit(self) -> None:
        loop = taut.drives.TorqueLoop(ki=50.0)
        drives = taut.drives.Actuation(
            transmission=self.STIFF, torque_loop=loop, motor=taut.drives.Motor(peak=0.04), bandwidth=2000.0
        )
        plant = taut.RigidPlant(self.ARM, actuation=drives, environment=Wall(), substeps=10)
        p = {path: value.copy() if value.ndim else value[()] for path, value in plant.parameters.items()}
        memory = plant.start(np.zeros(1), np.zeros(1), p, 1e-3)
        for k in range(150):
            memory = plant.command(np.array([10.0]), memory, k * 1e-3)
            for _ in range(10):
                memory = plant.advance(memory, p, 1e-4)
        assert memory["tau"][0] == pytest.approx(4.0)  # 100 times its peak
        assert abs(memory["torque_loop"][0]) < 5.0

    @pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
    def test_leaves_what_the_plant_adds_itself(self, plant: Any) -> None:
        """The sensor has the weight that the plant holds; the loop must not take it for friction's doing."""
        arm = taut.load_arm("one_joint").with_gears(ratio=100.0, motor_inertia=2e-5)
        drives = taut.drives.Actuation(torque_loop=taut.drives.TorqueLoop(kp=0.5, ki=50.0))
        floats = plant(arm, actuation=drives, adds=("gravity",))
        law = taut.compile(taut.laws.GravityCompensation(kd=0.1), arm, adds=floats.adds)
        run = taut.run(law, floats, taut.JointMotion(q=[0.5]), duration=0.5, q0=[0.5])
        np.testing.assert_allclose(run.q, 0.5, rtol=0.0, atol=1e-9)


class Wall(taut.environments.Environment):
    """A stiff spring at the tool along z."""

    k: taut.environments.Field = taut.environments.Field(2e5)
    b: taut.environments.Field = taut.environments.Field(500.0)

    def start(self, T_WE: taut.Pose) -> dict[str, Any]:
        return {"z": T_WE.p[2]}

    def wrench(self, T_WE: taut.Pose, twist: Any, t: Any, memory: Any, parameters: Any, dt: Any) -> Any:
        push = -parameters["k"] * (T_WE.p[2] - memory["z"]) - parameters["b"] * twist[2]
        return taut.math.array([0.0, 0.0, push, 0.0, 0.0, 0.0]), dict(memory)


@pytest.mark.part(1)
@pytest.mark.parametrize(
    "drives",
    [
        {"resolution": 0.01},
        {"ripple": taut.drives.Ripple(amplitude=[0.1, 0.2], periods=[2, 3])},
        {"motor": taut.drives.Motor(peak=[1.0, 0.5])},
        {"motor": taut.drives.ElectricMotor(torque_constant=0.5, resistance=1.0, inductance=1e-3, voltage=10.0, current=5.0)},
        {"torque_loop": taut.drives.TorqueLoop(kp=0.2, ki=5.0), "bandwidth": [300.0, 500.0]},
        {"transmission": taut.drives.Transmission(efficiency=0.7, stiffness=[300.0, np.inf], damping=[0.5, 0.0], backlash=[0.01, 0.0])},
    ],
    ids=lambda drives: "-".join(drives),
)  # fmt: skip
def test_every_part_runs_the_same_in_native_code_and_in_plain_python(drives: dict[str, Any]) -> None:
    arm = taut.load_arm("planar2").with_gears(ratio=10.0, motor_inertia=1e-4)
    arm = arm.with_friction(taut.Friction(viscous=0.2, coulomb=0.3, static=0.5, stribeck=0.1, load_motor=0.1))
    plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(**drives), substeps=3, energy=True)
    law = taut.laws.PID(kp=[60.0, 30.0], kd=[6.0, 3.0])
    runs = []
    for engine in ("native", "float"):
        ctrl = taut.compile(law, arm, rate=500.0, engine=engine)  # type: ignore[arg-type]
        runs.append(taut.run(ctrl, plant, taut.JointMotion(q=arm.home + 0.2), duration=0.1))
    for name in ("q", "v", "tau"):
        np.testing.assert_allclose(getattr(runs[0], name), getattr(runs[1], name), rtol=0.0, atol=1e-9)
    for name, column in runs[0].extra.items():
        np.testing.assert_allclose(column, runs[1].extra[name], rtol=0.0, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(
    ("make", "kind", "name"),
    [
        (lambda: taut.drives.Motor(stall=1.0), taut.errors.UsageError, "no_load"),
        (lambda: taut.drives.Motor(peak=-1.0), taut.errors.RangeError, "peak"),
        (lambda: taut.drives.ElectricMotor(torque_constant=0.1, resistance=0.0), taut.errors.RangeError, "resistance"),
        (lambda: taut.drives.ElectricMotor(torque_constant=0.1, resistance=1.0, inductance=0.0), taut.errors.RangeError, "inductance"),
        (lambda: taut.drives.TorqueLoop(), taut.errors.UsageError, "TorqueLoop"),
        (lambda: taut.drives.TorqueLoop(kp=-1.0), taut.errors.RangeError, "kp"),
        (lambda: taut.drives.Ripple(amplitude=5.0, periods=6), taut.errors.RangeError, "amplitude"),
        (lambda: taut.drives.Ripple(amplitude=0.05, periods=2.5), taut.errors.RangeError, "periods"),
        (lambda: taut.drives.Actuation(resolution=0.0), taut.errors.RangeError, "resolution"),
        (lambda: taut.drives.Actuation(motor=2.0), taut.errors.UsageError, "motor"),  # type: ignore[arg-type]
        (lambda: taut.RigidPlant(FREE, actuation=taut.drives.Actuation(motor=taut.drives.Motor(peak=[1.0, 2.0]))), taut.errors.ShapeError, "actuation.motor.peak"),
    ],
)  # fmt: skip
def test_what_no_drive_is_is_refused_by_its_name(make: Any, kind: type[taut.TautError], name: str) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert caught.value.name == name


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("actuation.motor.peak", 0.0),
        ("actuation.transmission.efficiency", 1.5),
        ("plant.rotor_inertia", -1.0),
        ("plant.friction.stribeck_shape", 0.0),
    ],
)  # fmt: skip
def test_a_new_value_is_checked_like_the_first_one(path: str, value: float) -> None:
    arm = FREE.with_gears(ratio=10.0, motor_inertia=1e-4)
    arm = arm.with_friction(taut.Friction(coulomb=0.1, static=0.2, stribeck=0.1, stribeck_shape=1.0))
    drives = taut.drives.Actuation(
        motor=taut.drives.Motor(peak=1.0), transmission=taut.drives.Transmission(efficiency=0.9)
    )
    loop = taut.Loop(taut.compile(taut.laws.PID(kp=1.0), arm), taut.RigidPlant(arm, actuation=drives), duration=1.0)
    with pytest.raises(taut.errors.RangeError) as caught:
        loop.parameters[path] = value
    assert caught.value.name == path


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("actuation.transmission.stiffness", np.inf),
        ("actuation.transmission.stiffness", 500.0),
        ("plant.rotor_inertia", 0.0),
    ],
)  # fmt: skip
@pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
def test_which_joints_give_way_does_not_change_in_a_run(plant: Any, path: str, value: float) -> None:
    arm = taut.load_arm("planar2").with_gears(ratio=50.0, motor_inertia=1e-4)
    drives = taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=[np.inf, 1e3]))
    made = plant(arm, actuation=drives)
    with refused(taut.TautError):
        made.checked_parameter(path, value)
    assert made.checked_parameter("actuation.transmission.stiffness", [np.inf, 500.0])[1] == 500.0
    assert made.checked_parameter("plant.rotor_inertia", [0.0, 0.1])[0] == 0.0


@pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
@pytest.mark.parametrize("sensor", [None, taut.sensors.TorqueSensor(side="motor")])
def test_an_inner_loop_needs_the_sensor_that_it_reads(plant: Any, sensor: Any) -> None:
    drives = taut.drives.Actuation(torque_loop=taut.drives.TorqueLoop(ki=5.0))
    with pytest.raises(taut.errors.UsageError) as caught:
        plant(FREE, actuation=drives, sensors=taut.sensors.Sensors(torque=sensor))
    assert caught.value.name == "torque_loop"


def test_rotors_make_the_arm_heavier_at_its_own_joint_alone() -> None:
    """Reflected inertia is G^2 I on the diagonal of M, in model and plant alike."""
    arm = taut.load_arm("planar2")
    geared = arm.with_gears(ratio=[50.0, 100.0], motor_inertia=1e-4)
    extra = taut.snapshot(geared, arm.home).M - taut.snapshot(arm, arm.home).M
    np.testing.assert_allclose(extra, np.diag([0.25, 1.0]), rtol=0.0, atol=1e-12)
    law = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), geared)
    plant = taut.RigidPlant(geared, friction=None)
    ref = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.3, duration=0.5)
    assert np.abs(taut.run(law, plant, ref, duration=0.5).metrics.peak_error).max() < 1e-3
    lighter = [taut.Event(t=0.0, set={"plant.rotor_inertia": 0.0})]
    assert np.abs(taut.run(law, plant, ref, duration=0.5, events=lighter).metrics.peak_error).max() > 5e-3


class TestStepsThatAreTooLong:
    """What answers within a step is refused before it swings up, with how many steps are enough."""

    def is_refused(self, plant: taut.RigidPlant) -> None:
        with refused(taut.errors.RangeError):
            taut.run(taut.compile(taut.laws.PID(kp=1.0), plant.arm), plant, duration=0.1)

    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_for_the_steep_curve_of_a_motor_without_a_rotor(self) -> None:
        arm = FREE.with_joints(gear=200.0)
        motor = taut.drives.Motor(stall=0.5, no_load=30.0)
        self.is_refused(taut.RigidPlant(arm, actuation=taut.drives.Actuation(motor=motor)))
        enough = taut.RigidPlant(arm, actuation=taut.drives.Actuation(motor=motor), substeps=2)
        push = taut.compile(taut.laws.PID(kp=1.0), arm)
        run = taut.run(push, enough, taut.JointMotion(q=[1e4]), duration=1.0)
        assert run.v[-1, 0] == pytest.approx(30.0 / 200.0, rel=1e-3)

    def test_for_a_motor_under_a_voltage(self) -> None:
        arm = FREE.with_joints(gear=200.0)
        motor = taut.drives.ElectricMotor(torque_constant=0.1, resistance=0.5, voltage=24.0)
        self.is_refused(taut.RigidPlant(arm, actuation=taut.drives.Actuation(motor=motor)))
        free = taut.drives.ElectricMotor(
            torque_constant=0.1, resistance=0.5
        )  # a supply without end holds any current
        plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(motor=free))
        assert taut.run(taut.compile(taut.laws.PID(kp=1.0), arm), plant, duration=0.1).outcome.ok

    @pytest.mark.long
    def test_for_an_inner_loop_that_reads_the_step_before(self) -> None:
        loop = taut.drives.TorqueLoop(kp=1.5)
        self.is_refused(taut.RigidPlant(FREE, actuation=taut.drives.Actuation(torque_loop=loop)))
        fast = taut.RigidPlant(
            FREE, actuation=taut.drives.Actuation(torque_loop=taut.drives.TorqueLoop(kp=3.0), bandwidth=3000.0)
        )
        self.is_refused(fast)
        left, mean = np.exp(-3.0), (1.0 - np.exp(-3.0)) / 3.0
        most = (1.0 + left) / (1.0 + left - 2.0 * mean)
        for kp, stable in ((0.97 * most, True), (1.03 * most, False)):
            drives = taut.drives.Actuation(torque_loop=taut.drives.TorqueLoop(kp=kp), bandwidth=3000.0)
            plant = taut.RigidPlant(FREE, actuation=drives)
            p = {path: value.copy() if value.ndim else value[()] for path, value in plant.parameters.items()}
            mild = {**p, "actuation.torque_loop.kp": np.float64(0.1)}  # else the start is refused
            memory = plant.start(np.zeros(1), np.zeros(1), mild, 1e-3)
            for k in range(800):
                memory = plant.advance(plant.command(np.ones(1), memory, k * 1e-3), p, 1e-3)
            assert bool(abs(memory["tau"][0]) < 10.0) is stable

    def test_a_rotor_that_takes_most_of_the_torque_lets_the_loop_be_steeper(self) -> None:
        arm = FREE.with_gears(ratio=100.0, motor_inertia=2e-4)  # 2 kg m^2 before a link of 0.5
        loop = taut.drives.TorqueLoop(kp=4.5)  # a fifth of the torque arrives at once
        plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(torque_loop=loop))
        assert taut.run(taut.compile(taut.laws.PID(kp=1.0), arm), plant, duration=0.5).outcome.ok
        self.is_refused(
            taut.RigidPlant(arm, actuation=taut.drives.Actuation(torque_loop=taut.drives.TorqueLoop(kp=5.5)))
        )
