"""The drives between command and arm: lags and delays against closed forms, and what the plant adds itself."""

from __future__ import annotations

import numpy as np
import pytest
from plant_laws import TINY, Array, PositionOf, Seen, TorqueOf, run, seen

import taut

DT = 1e-3
EXACT = 1e-12  # drives are integrated in closed form, so that only rounding is left at the ticks


def step_of(q: float = 0.0, v: float = 0.0, a: float = 0.0, n: int = 2) -> taut.JointMotion:
    return taut.JointMotion(q=[q] * n, v=[v] * n, a=[a] * n)


class TestVelocityDrives:
    @pytest.mark.parametrize("substeps", [1, 7])
    def test_follow_a_step_as_a_first_order_lag(self, substeps: int) -> None:
        omega, speed = 40.0, 0.7
        plant = taut.RigidPlant(
            taut.load_arm("planar2"),
            takes="velocity",
            actuation=taut.drives.Actuation(bandwidth=omega),
            substeps=substeps,
        )
        out = run(plant, step_of(v=speed), duration=0.3, q0=[0.2, -0.1])
        fading = np.exp(-omega * out.t)[:, np.newaxis]
        np.testing.assert_allclose(out.v, speed * (1.0 - fading) + 0.0 * out.v, rtol=0.0, atol=EXACT)
        way = speed * (out.t[:, np.newaxis] - (1.0 - fading) / omega)
        np.testing.assert_allclose(out.q - out.q[0], way + 0.0 * out.q, rtol=0.0, atol=EXACT)

    def test_the_delay_comes_first(self) -> None:
        plant = taut.RigidPlant(
            taut.load_arm("planar2"), takes="velocity", actuation=taut.drives.Actuation(bandwidth=50.0, delay=0.004)
        )
        out = run(plant, step_of(v=1.0), duration=0.1)
        late = np.maximum(out.t - 0.004, 0.0)[:, np.newaxis]
        np.testing.assert_allclose(out.v, 1.0 - np.exp(-50.0 * late) + 0.0 * out.v, rtol=0.0, atol=EXACT)

    def test_a_velocity_at_the_start_dies_out_under_no_command(self) -> None:
        plant = taut.RigidPlant(
            taut.load_arm("planar2"), takes="velocity", actuation=taut.drives.Actuation(bandwidth=30.0)
        )
        out = run(plant, step_of(), duration=0.2, v0=[1.0, -2.0])
        np.testing.assert_allclose(out.v, np.exp(-30.0 * out.t)[:, np.newaxis] * [1.0, -2.0], rtol=0.0, atol=EXACT)


class TestPositionDrives:
    @pytest.mark.parametrize("substeps", [1, 5])
    def test_follow_a_step_with_critical_damping(self, substeps: int) -> None:
        omega = 30.0
        plant = taut.RigidPlant(
            taut.load_arm("planar2"),
            takes="position",
            actuation=taut.drives.Actuation(bandwidth=omega, delay=0.002),
            substeps=substeps,
        )
        out = run(plant, step_of(q=1.0), duration=0.4, q0=[0.0, 0.4])
        t = np.maximum(out.t - 0.002, 0.0)[:, np.newaxis]
        left = np.array([1.0, 0.6])
        np.testing.assert_allclose(out.q, 1.0 - left * (1.0 + omega * t) * np.exp(-omega * t), rtol=0.0, atol=EXACT)
        np.testing.assert_allclose(out.v, left * omega**2 * t * np.exp(-omega * t), rtol=0.0, atol=omega * EXACT)

    def test_do_not_move_while_the_first_command_is_on_its_way(self) -> None:
        plant = taut.RigidPlant(
            taut.load_arm("planar2"), takes="position", actuation=taut.drives.Actuation(bandwidth=30.0, delay=0.05)
        )
        out = run(plant, step_of(q=1.0), duration=0.05, q0=[0.3, 0.4])
        np.testing.assert_array_equal(out.q, np.broadcast_to([0.3, 0.4], out.q.shape))

    @pytest.mark.parametrize(("takes", "ripple"), [("velocity", 1e-9), ("position", 1e-3)])
    def test_the_torque_is_what_the_motion_takes(self, takes: str, ripple: float) -> None:
        """On a ramp that the drives follow: inverse dynamics, and the friction of the way it goes.

        A position command is a staircase, so that the speed has a ripple of (omega dt)^2 / 12.
        """
        arm = taut.load_arm("planar2").with_joints(viscous=[0.3, 0.2], coulomb=[0.5, 0.4]).with_payload(1.0)
        plant = taut.RigidPlant(arm, takes=takes, actuation=taut.drives.Actuation(bandwidth=50.0))
        speed = np.array([0.5, -0.4])
        ramp = taut.trajectories.Samples(times=[0.0, 1.0], q=[[0.0, 0.0], speed.tolist()])
        out = run(plant, ramp, duration=0.9, q0=[0.0, 0.0], v0=speed)
        x = taut.snapshot(arm, out.q[-2], out.v[-2])
        np.testing.assert_allclose(out.v[-2], speed, rtol=0.0, atol=ripple)
        np.testing.assert_allclose(out.tau[-2], x.h + arm.viscous * speed + [0.5, -0.4], rtol=0.0, atol=10.0 * ripple)

    @pytest.mark.parametrize("takes", ["velocity", "position"])
    def test_a_torque_sensor_at_the_link_is_behind_friction_and_rotor(self, takes: str) -> None:
        arm = taut.load_arm("planar2").with_friction(taut.Friction(viscous=2.0, coulomb=3.0))
        arm = arm.with_gears(ratio=100.0, motor_inertia=1e-5)
        read, v = {}, np.array([1.0, -1.0])
        for side in ("link", "motor"):
            sensors = taut.sensors.Sensors(torque=taut.sensors.TorqueSensor(side=side))  # type: ignore[arg-type]
            plant = taut.RigidPlant(
                arm, takes=takes, actuation=taut.drives.Actuation(bandwidth=50.0), sensors=sensors
            )
            p = {path: np.asarray(value) for path, value in plant.parameters.items()}
            before = plant.start(arm.home, v, p, DT)
            after = plant.advance(plant.command(arm.home, before, 0.0), p, DT)
            read[side] = plant.measure(after, {}, p)["tau_meas"]
        a = (after["v"] - before["v"]) / DT
        np.testing.assert_allclose(
            read["motor"] - read["link"],
            arm.viscous * v + 3.0 * np.sign(v) + arm.rotor_inertia * a,
            rtol=0.0,
            atol=1e-12,
        )


class TestTorqueDrives:
    def test_lag_a_step_exactly_at_the_ticks(self) -> None:
        omega = 200.0
        plant = taut.RigidPlant(taut.load_arm("planar2"), actuation=taut.drives.Actuation(bandwidth=omega))
        out = run(plant, step_of(a=3.0), duration=0.05)
        # tau[k] acts in the period after tick k, and is the mean of the lag in it, from the arm's weight.
        fading = (np.exp(-omega * out.t) * (1.0 - np.exp(-omega * DT)) / (omega * DT))[:, np.newaxis]
        expected = 3.0 + (taut.snapshot(plant.arm, plant.arm.home).g - 3.0) * fading
        np.testing.assert_allclose(out.tau, expected, rtol=0.0, atol=10.0 * EXACT)

    def test_turn_a_continuous_joint_the_short_way_round(self) -> None:
        arm = taut.load_arm("kinova")
        start, goal = np.array(arm.home), np.array(arm.home)
        start[0], goal[0] = 3.1, -3.1
        plant = taut.RigidPlant(arm, takes="position", actuation=taut.drives.Actuation(bandwidth=30.0))
        out = taut.run(taut.compile(PositionOf(), arm), plant, taut.JointMotion(q=goal), duration=1.0, q0=start)
        assert np.ptp(out.q[:, 0]) < 0.09
        np.testing.assert_allclose(out.q[-1, 0], 2.0 * np.pi - 3.1, atol=1e-6)

    @pytest.mark.parametrize("substeps", [1, 10])
    def test_give_the_impulse_of_the_lag_however_the_period_is_cut(self, substeps: int) -> None:
        """One free joint behind a slow drive: v(t) = (a / M) (t - (1 - exp(-omega t)) / omega), without gravity."""
        omega, dt = 100.0, 0.01
        arm = taut.load_arm("one_joint", gravity=[0.0, 0.0, 0.0])
        plant = taut.RigidPlant(
            arm, friction=None, substeps=substeps, actuation=taut.drives.Actuation(bandwidth=omega)
        )
        out = taut.run(taut.compile(TorqueOf(), arm, rate=1.0 / dt), plant, step_of(a=1.0, n=1), duration=0.1)
        expected = (out.t - (1.0 - np.exp(-omega * out.t)) / omega) / 0.5
        np.testing.assert_allclose(out.v[:, 0], expected, rtol=0.0, atol=1e-13)

    @pytest.mark.parametrize("taps", [0, 1, 3])
    def test_a_delay_is_a_whole_number_of_ticks(self, taps: int) -> None:
        plant = taut.RigidPlant(taut.load_arm("planar2"), actuation=taut.drives.Actuation(delay=taps * DT))
        wave = taut.trajectories.Sine(center=[0.0, 0.0], amplitude=1.0, frequency=5.0)
        out = run(plant, wave, duration=0.02)
        np.testing.assert_array_equal(out.tau[taps:], out.command[: len(out) - taps])
        weight = taut.snapshot(plant.arm, plant.arm.home).g
        np.testing.assert_allclose(out.tau[:taps], np.broadcast_to(weight, (taps, 2)), rtol=1e-14)

    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")  # gravity compensated late has no stiffness
    @pytest.mark.parametrize("adds", [(), ("gravity",)])
    def test_hold_the_arm_until_the_first_command_arrives(self, adds: tuple[str, ...]) -> None:
        """A compensated arm behind a lag and a delay stays where it is, with a payload that an event brings too."""
        arm = taut.load_arm("ur10")
        plant = taut.RigidPlant(arm, adds=adds, actuation=taut.drives.Actuation(bandwidth=50.0, delay=0.005))
        load = [taut.Event(t=0.0, set={"plant.payload.mass": 3.0, "model.payload.mass": 3.0})]
        law = taut.laws.GravityPID(kp=0.0, kd=0.0)
        out = run(plant, taut.JointMotion(q=arm.home), law=law, duration=0.5, events=load)
        assert np.abs(out.q - arm.home).max() < 1e-9
        np.testing.assert_allclose(out.tau[0], out.command[0], rtol=1e-12, atol=1e-12)

    def test_sensors_on_the_motors_give_the_torque_of_the_last_period(self) -> None:
        plant = taut.RigidPlant(
            taut.load_arm("planar2"), sensors=taut.sensors.Sensors(torque=taut.sensors.TorqueSensor(side="motor"))
        )
        wave = taut.trajectories.Sine(center=[0.0, 0.0], amplitude=1.0, frequency=5.0)
        out = run(plant, wave, law=Seen(), duration=0.02)
        np.testing.assert_array_equal(seen(out, "tau")[1:], out.tau[:-1])
        np.testing.assert_allclose(seen(out, "tau")[0], taut.snapshot(plant.arm, plant.arm.home).g, rtol=1e-14)

    def test_sensors_behind_friction_and_rotor_give_what_arrives_there(self) -> None:
        arm = taut.load_arm("planar2").with_gears(ratio=50.0, motor_inertia=1e-4)
        arm = arm.with_friction(taut.Friction(viscous=0.3, coulomb=0.5))
        wave = taut.trajectories.Sine(center=[0.0, 0.0], amplitude=1.0, frequency=5.0)
        out = run(taut.RigidPlant(arm), wave, law=Seen(), duration=0.02)
        np.testing.assert_allclose(seen(out, "tau")[0], taut.snapshot(arm, arm.home).g, rtol=1e-14)
        links = arm.with_joints(rotor_inertia=0.0)
        for k in range(len(out) - 1):
            a = (out.v[k + 1] - out.v[k]) / 1e-3
            needed = taut.snapshot(links, out.q[k], out.v[k]).inverse_dynamics(a)
            np.testing.assert_allclose(seen(out, "tau")[k + 1], needed, rtol=0.0, atol=1e-7)

    def test_sensors_of_stiff_drives_give_the_torque_of_the_motion_too(self) -> None:
        class Feels(taut.Law):
            def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Velocity:
                return taut.Velocity(wanted=ref.v, tau=x.tau_meas * TINY)

        plant = taut.RigidPlant(
            taut.load_arm("planar2"), takes="velocity", actuation=taut.drives.Actuation(bandwidth=50.0), substeps=2
        )
        out = run(plant, step_of(v=0.3), law=Feels(), duration=0.02)
        felt = seen(out, "tau")
        np.testing.assert_allclose(felt[0], taut.snapshot(plant.arm, plant.arm.home).g, rtol=1e-12)
        # What is recorded acts in the first sub-step after a tick, what is measured in the last one before it.
        assert np.abs(felt[1:] - out.tau[:-1]).max() < 0.1 * np.abs(out.tau).max()
        assert felt[1:, 0].min() > 1.0

    def test_bandwidth_is_a_parameter_that_events_change(self) -> None:
        plant = taut.RigidPlant(taut.load_arm("planar2"), actuation=taut.drives.Actuation(bandwidth=1.0))
        faster = [taut.Event(t=0.01, set={"actuation.bandwidth": 1e4})]
        out = run(plant, step_of(a=3.0), duration=0.02, events=faster)
        assert out.tau[9, 0] == pytest.approx(out.tau[0, 0], rel=0.02)
        assert out.tau[11, 0] == pytest.approx(3.0, rel=1e-3)


# -------------------------------------------------------------------- what the plant adds itself


def zero_gravity_error(plant: taut.RigidPlant, arm: taut.Arm) -> Array:
    """Where PD without gravity compensation comes to rest, less where it should."""
    target = np.array([0.4, 0.7])
    out = run(plant, taut.JointMotion(q=target), law=taut.laws.PID(kp=200.0, kd=40.0), duration=3.0, q0=[0.3, 0.6])
    return target - out.q[-1]


class TestWhatThePlantAdds:
    def test_pid_alone_holds_against_gravity_where_the_plant_adds_it(self) -> None:
        arm = taut.load_arm("planar2").with_payload(1.5)
        np.testing.assert_allclose(zero_gravity_error(taut.RigidPlant(arm, adds=("gravity",)), arm), 0.0, atol=1e-6)
        assert np.abs(zero_gravity_error(taut.RigidPlant(arm), arm)).min() > 0.02

    @pytest.mark.parametrize("integrator", ["semi-implicit-euler", "rk4"])
    def test_without_gravity_and_coriolis_torques_a_free_arm_keeps_its_joint_speeds(self, integrator: str) -> None:
        """M a = 0: in joint space the arm goes straight on, for ever, whatever the integrator's order."""
        arm = taut.load_arm("panda").with_payload(2.0, com=[0.0, 0.1, 0.05])
        plant = taut.RigidPlant(arm, None, integrator=integrator, adds=("gravity", "coriolis"))
        v0 = np.linspace(-1.0, 1.0, 7)
        out = run(plant, duration=0.5, v0=v0)
        np.testing.assert_allclose(out.v, np.broadcast_to(v0, out.v.shape), rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(out.q, arm.home + np.outer(out.t, v0), rtol=0.0, atol=1e-10)

    def test_gravity_of_the_load_that_it_was_told_only(self) -> None:
        """Told of 1 kg and carrying 3, the plant leaves the law the weight of 2."""
        arm = taut.load_arm("gantry3").with_payload(3.0)
        plant = taut.RigidPlant(arm, adds={"gravity": taut.Payload(mass=1.0)})
        push = taut.JointMotion(q=np.zeros(3), a=[0.0, 0.0, 2.0 * 9.81])
        out = run(plant, push, duration=0.1)
        np.testing.assert_allclose(out.q[-1], 0.0, atol=1e-14)
        run_of_law = run(
            plant, taut.JointMotion(q=np.zeros(3)), law=taut.laws.GravityPID(kp=0.0, kd=0.0), duration=0.1
        )
        np.testing.assert_allclose(run_of_law.tau[:, 2], 2.0 * 9.81, rtol=1e-12)

    def test_friction_that_is_added_cancels_the_arms_own_sticking_too(self) -> None:
        arm = taut.load_arm("xarm7")
        v0 = np.full(7, 0.2)
        added = run(taut.RigidPlant(arm, adds=("friction",)), duration=0.2, v0=v0)
        none = run(taut.RigidPlant(arm, friction=None), duration=0.2, v0=v0)
        np.testing.assert_array_equal(added.q, none.q)
        full = run(taut.RigidPlant(arm), duration=0.2, v0=v0)
        assert np.abs(full.q - none.q).max() > 0.01
        assert "plant.friction.coulomb" not in taut.RigidPlant(arm, adds=("friction",)).parameters

    def test_the_recorded_torque_is_the_drives_alone(self) -> None:
        arm = taut.load_arm("planar2")
        out = run(taut.RigidPlant(arm, adds=("gravity",)), step_of(a=0.25), duration=0.01)
        np.testing.assert_array_equal(out.tau, np.full(out.tau.shape, 0.25))


def test_a_plant_without_lag_or_delay_gives_the_command_at_once() -> None:
    out = run(taut.RigidPlant(taut.load_arm("planar2")), step_of(a=1.0), law=TorqueOf(), duration=0.01)
    np.testing.assert_array_equal(out.tau, out.command)


def test_stiff_drives_need_more_torque_where_friction_grows_with_load() -> None:
    arm = taut.load_arm("planar2").with_joints(viscous=0.0)
    loaded = arm.with_friction(taut.Friction(coulomb=0.1, load_motor=0.05, load_external=0.02))
    drives = taut.drives.Actuation(bandwidth=200.0)
    command = taut.compile(taut.laws.VelocityPI(kp=20.0), arm)
    upwards = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.3, duration=0.2)
    plain, rough = (
        taut.run(command, taut.RigidPlant(a, takes="velocity", actuation=drives), upwards, duration=0.1)
        for a in (arm, loaded)
    )
    k = 50
    tau, v = plain.tau[k], plain.v[k]
    load = -taut.snapshot(arm, plain.q[k], plain.v[k]).h
    expected = tau + np.sign(v) * (0.1 + np.abs(0.02 * load - 0.05 * tau))
    np.testing.assert_allclose(rough.q, plain.q, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(rough.tau[k], expected, rtol=1e-9)
