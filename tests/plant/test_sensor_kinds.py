"""Each kind of sensor: what it reads, its faults with the stated size, on the side where it stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import mujoco
import numpy as np
import pytest
from plant_laws import TINY, Array, run
from refusals import refused

import taut
from taut.maths.model import model_of
from taut.plant.sensors import Sensors

ARM = taut.load_arm("planar2")
GEARED = ARM.with_gears(ratio=[100.0, 50.0], motor_inertia=1e-6)
STILL = ("gravity",)
HOLD = taut.JointMotion(q=[0.0, 0.0])
F_PUSH = np.array([12.0, -3.0, 7.0, 0.4, 0.2, -0.9])  # [N, N m], world axes


class Push(taut.environments.Environment):
    """A constant wrench, in world axes."""

    F: taut.environments.Field = taut.environments.Field(tuple(F_PUSH), unit="N, N m", shape=6)

    def wrench(
        self, T_WE: taut.Pose, twist: Array, t: Any, memory: Mapping[str, Any], parameters: Mapping[str, Any], dt: Any
    ) -> tuple[Array, dict[str, Any]]:
        return parameters["F"], {}


class Feels(taut.Law):
    """What the law sees at the tool and of the torques, hidden in terms that move nothing."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(
            wanted=ref.a,
            f0=x.F_ext[0:2] * TINY,
            f1=x.F_ext[2:4] * TINY,
            f2=x.F_ext[4:6] * TINY,
            tau=x.tau_meas * TINY,
        )


class FeelsTip(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(wanted=ref.a, a=(x.a_tip[0] + x.a_tip[1] + x.a_tip[2]) * TINY + 0.0 * x.q)


class SeesMotors(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(wanted=ref.a, q=x.q_motor * TINY, v=x.v_motor * TINY)


def read(sensors: Sensors, true: Mapping[str, Any], arm: taut.Arm = ARM, **noise: Array) -> dict[str, Any]:
    """What sensors give of stated truths."""
    return sensors.read(model_of(arm), {"tau": np.zeros(arm.n), **true}, noise, sensors.parameters())


# -------------------------------------------------------------------- encoders and tachometers


class TestAnEncoder:
    TRUE: ClassVar = {"q": np.array([0.7123, -1.2345]), "v": np.array([0.31, -0.22])}

    def test_at_the_motor_has_its_steps_on_the_motors_shaft(self) -> None:
        step = 2.0 * np.pi / 4096
        seen = read(Sensors(position=taut.sensors.Encoder(resolution=step, side="motor")), self.TRUE, GEARED)["q"]
        shaft = GEARED.gear * self.TRUE["q"]
        np.testing.assert_allclose(seen, step * np.round(shaft / step) / GEARED.gear, rtol=1e-15)
        assert (np.abs(seen - self.TRUE["q"]) <= 0.5 * step / GEARED.gear + 1e-15).all()
        assert np.abs(seen - self.TRUE["q"]).max() > 0.0

    def test_at_the_link_has_its_steps_at_the_link_whatever_the_gear(self) -> None:
        seen = read(Sensors(position=taut.sensors.Encoder(resolution=0.01, side="link")), self.TRUE, GEARED)["q"]
        np.testing.assert_allclose(seen, [0.71, -1.23], rtol=1e-12)

    def test_at_the_motor_reads_the_motor_where_it_is_elsewhere_than_the_link(self) -> None:
        true = {**self.TRUE, "q_motor": np.array([0.72, -1.25]), "v_motor": np.array([1.0, 2.0])}
        at_motor = Sensors(
            position=taut.sensors.Encoder(side="motor"), velocity=taut.sensors.Tachometer(side="motor")
        )
        for sensors, q, v in ((at_motor, "q_motor", "v_motor"), (Sensors(), "q", "v")):
            seen = read(sensors, true, GEARED)
            np.testing.assert_array_equal(seen["q"], true[q])
            np.testing.assert_array_equal(seen["v"], true[v])
        both = read(Sensors(motor=taut.sensors.Encoder(), motor_velocity=taut.sensors.Tachometer()), true, GEARED)
        for name in ("q", "v", "q_motor", "v_motor"):
            np.testing.assert_array_equal(both[name], true[name])

    def test_at_the_motor_has_offset_and_noise_of_the_shaft_too(self) -> None:
        position = taut.sensors.Encoder(offset=0.5, noise=[0.1, 0.2], side="motor")
        tacho = taut.sensors.Tachometer(offset=[1.0, 2.0], noise=0.3, side="motor")
        normal = np.array([1.0, -2.0])
        seen = read(Sensors(position=position, velocity=tacho), self.TRUE, GEARED, q=normal, v=normal)
        np.testing.assert_allclose(seen["q"], self.TRUE["q"] + (0.5 + np.array([0.1, -0.4])) / GEARED.gear)
        np.testing.assert_allclose(seen["v"], self.TRUE["v"] + ([1.0, 2.0] + 0.3 * normal) / GEARED.gear)

    def test_is_a_potentiometer_with_noise_and_an_offset(self) -> None:
        plant = taut.RigidPlant(
            ARM, adds=STILL, sensors=Sensors(position=taut.sensors.Encoder(noise=[1e-3, 4e-3], offset=0.02))
        )
        ctrl = taut.compile(taut.laws.PID(kp=0.0, kd=0.0), ARM, adds=plant.adds)
        out = taut.run(ctrl, plant, HOLD, duration=10.0)
        off = out.extra["sensed.q"] - out.q
        np.testing.assert_allclose(off.std(axis=0), [1e-3, 4e-3], rtol=0.03)  # known to 0.7 % of itself
        np.testing.assert_allclose(off.mean(axis=0), [0.02, 0.02], atol=4.0 * 4e-5)

    def test_of_the_motor_in_a_run(self) -> None:
        step = 2.0 * np.pi / 500
        sensors = Sensors(
            motor=taut.sensors.Encoder(resolution=step), motor_velocity=taut.sensors.Tachometer(noise=5.0)
        )
        plant = taut.RigidPlant(GEARED, adds=STILL, sensors=sensors)
        out = run(plant, HOLD, law=SeesMotors(), v0=[0.4, -0.3], duration=5.0)
        shaft = out.extra["sensed.q_motor"] * GEARED.gear / step
        np.testing.assert_allclose(shaft, np.round(shaft), rtol=0.0, atol=1e-9)
        assert (np.abs(out.extra["sensed.q_motor"] - out.q) <= 0.5 * step / GEARED.gear + 1e-12).all()
        spread = (out.extra["sensed.v_motor"] - out.v).std(axis=0)
        np.testing.assert_allclose(spread, 5.0 / GEARED.gear, rtol=0.05)


class TestBehindAnElasticGear:
    K = np.array([300.0, 150.0])  # [N m/rad]

    @pytest.mark.long
    def test_motor_and_link_are_seen_apart_and_the_spring_between_them_is_the_torque_at_the_link(self) -> None:
        spring = taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=self.K))
        steps = 2.0 * np.pi / 2**20
        sensors = Sensors(
            position=taut.sensors.Encoder(resolution=steps, side="link"),
            motor=taut.sensors.Encoder(resolution=steps),
            motor_velocity=taut.sensors.Tachometer(),
        )
        arm = ARM.with_gears(ratio=100.0, motor_inertia=1e-5)
        plant = taut.RigidPlant(arm, friction=None, actuation=spring, sensors=sensors)
        wave = taut.trajectories.Sine(center=[0.0, 0.0], amplitude=[3.0, 1.0], frequency=2.0)
        out = run(plant, wave, law=SeesMotors(), rate=1e4, duration=0.5)
        q_motor, wound = out.extra["sensed.q_motor"], out.extra["sensed.q_motor"] - out.extra["sensed.q"]
        assert (np.abs(wound).max(axis=0) > 0.002).all()
        shaft = q_motor * arm.gear / steps
        np.testing.assert_allclose(shaft, np.round(shaft), rtol=0.0, atol=1e-6)
        rate = (q_motor[2:] - q_motor[:-2]) * 0.5e4
        assert np.abs(out.extra["sensed.v_motor"][1:-1] - rate).max() < 0.01 * np.abs(rate).max()
        # The link seen from its end of the spring: its own dynamics take what the spring gives.
        v = (out.q[2:] - out.q[:-2]) * 0.5e4
        a = (out.q[2:] - 2.0 * out.q[1:-1] + out.q[:-2]) * 1e8
        bare = arm.with_joints(rotor_inertia=0.0)
        needed = [taut.snapshot(bare, q, w).inverse_dynamics(b) for q, w, b in zip(out.q[1:-1], v, a, strict=True)]
        felt = self.K * wound[1:-1]
        assert np.abs(felt - needed).max() < 0.02 * np.abs(felt).max()


# -------------------------------------------------------------------- torques


class TestATorqueSensor:
    TRUE: ClassVar = {
        "q": np.zeros(2),
        "v": np.zeros(2),
        "tau": np.array([3.0, -4.0]),
        "tau_link": np.array([2.5, -3.1]),
    }

    def test_reads_the_link_or_the_motor(self) -> None:
        for side in ("link", "motor"):
            seen = read(Sensors(torque=taut.sensors.TorqueSensor(side=side)), self.TRUE)["tau_meas"]
            np.testing.assert_array_equal(seen, self.TRUE["tau_link" if side == "link" else "tau"])
        rigid = {name: value for name, value in self.TRUE.items() if name != "tau_link"}
        np.testing.assert_array_equal(read(Sensors(), rigid)["tau_meas"], rigid["tau"])

    def test_has_bias_noise_and_steps_in_this_order(self) -> None:
        sensor = taut.sensors.TorqueSensor(bias=[0.2, 0.0], noise=0.3, resolution=0.5)
        seen = read(Sensors(torque=sensor), self.TRUE, tau_meas=np.array([1.0, -1.0]))["tau_meas"]
        np.testing.assert_allclose(seen, [3.0, -3.5])  # of 2.5 + 0.2 + 0.3 and -3.1 - 0.3

    def test_has_the_stated_spread_in_a_run(self) -> None:
        sensors = Sensors(torque=taut.sensors.TorqueSensor(noise=[0.05, 0.2], bias=-0.1, side="motor"))
        plant = taut.RigidPlant(ARM, adds=STILL, sensors=sensors, environment=Push(F=(0.0,) * 6))
        out = run(plant, HOLD, law=Feels(), duration=10.0)
        off = out.extra["sensed.tau_meas"][1:] - out.tau[:-1]
        np.testing.assert_allclose(off.std(axis=0), [0.05, 0.2], rtol=0.03)
        np.testing.assert_allclose(off.mean(axis=0), [-0.1, -0.1], atol=4.0 * 0.2 / 100.0)


# -------------------------------------------------------------------- the wrench


class TestAWrenchSensor:
    POSE: ClassVar = {"q": np.array([0.9, 0.4, -0.3, -1.6, 0.5, 1.2, 0.1]), "v": np.zeros(7), "tau": np.zeros(7)}
    PANDA = taut.load_arm("panda")

    @property
    def R_WE(self) -> Array:
        return np.asarray(taut.snapshot(self.PANDA, self.POSE["q"]).T().R)

    def in_tool(self, F_W: Array) -> Array:
        return np.concatenate([self.R_WE.T @ F_W[:3], self.R_WE.T @ F_W[3:]])

    def seen(self, sensor: taut.sensors.WrenchSensor, **noise: Array) -> dict[str, Any]:
        return read(Sensors(wrench=sensor), {**self.POSE, "F_ext": F_PUSH}, self.PANDA, **noise)

    def test_has_bias_and_noise_in_the_axes_of_the_tool(self) -> None:
        bias, normal = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]), np.arange(6.0)
        seen = self.seen(taut.sensors.WrenchSensor(bias=bias, noise=(0.5, 0.01)), F_ext=normal)["F_ext"]
        noise = np.array([0.5, 0.5, 0.5, 0.01, 0.01, 0.01]) * normal
        np.testing.assert_allclose(self.in_tool(seen - F_PUSH), bias + noise, atol=1e-14)

    def test_is_cut_at_its_range_axis_by_axis_and_says_so(self) -> None:
        limit = np.array([np.inf, 5.0, 4.0, 0.5, 0.5, np.inf])
        seen = self.seen(taut.sensors.WrenchSensor(range=limit))
        wanted = np.clip(self.in_tool(F_PUSH), -limit, limit)
        np.testing.assert_allclose(self.in_tool(seen["F_ext"]), wanted, atol=1e-14)
        assert np.abs(wanted - self.in_tool(F_PUSH)).max() > 1.0
        assert seen["saturated.F_ext"] == 1.0
        wide = self.seen(taut.sensors.WrenchSensor(range=(100.0, 10.0)))
        np.testing.assert_allclose(wide["F_ext"], F_PUSH, rtol=1e-12)
        assert wide["saturated.F_ext"] == 0.0

    def test_has_the_stated_spread_in_a_run(self) -> None:
        sensors = Sensors(wrench=taut.sensors.WrenchSensor(noise=(0.5, 0.02), bias=[1.0, 0.0, 0.0, 0.0, 0.0, 0.1]))
        plant = taut.RigidPlant(ARM, adds=STILL, sensors=sensors, environment=Push(F=(0.0,) * 6))
        out = run(plant, HOLD, law=Feels(), q0=[0.5, 0.6], duration=10.0)
        R = taut.snapshot(ARM, [0.5, 0.6]).T().R
        off = np.hstack([out.extra["sensed.F_ext"][:, :3] @ R, out.extra["sensed.F_ext"][:, 3:] @ R])
        np.testing.assert_allclose(off.std(axis=0), [0.5] * 3 + [0.02] * 3, rtol=0.04)
        np.testing.assert_allclose(off.mean(axis=0), [1.0, 0.0, 0.0, 0.0, 0.0, 0.1], atol=4.0 * 0.5 / 100.0)
        np.testing.assert_array_equal(out.extra["F_ext"], np.zeros((len(out), 6)))

    def test_at_its_range_is_told_at_the_end_of_a_run(self) -> None:
        sensors = Sensors(wrench=taut.sensors.WrenchSensor(range=(10.0, 10.0)))
        plant = taut.RigidPlant(ARM, adds=STILL, sensors=sensors, environment=Push(F=(0.0,) * 6))
        push = [
            taut.Event(t=0.02, set={"environment.F": [0.0, 0.0, 20.0, 0.0, 0.0, 0.0]}),
            taut.Event(t=0.03, set={"environment.F": [0.0] * 6}),
        ]
        for engine in ("native", "float"):
            out = run(plant, HOLD, law=Feels(), duration=0.1, events=push, engine=engine)
            # What acts in a step is measured in the tick that follows.
            assert out.outcome.message == (
                "completed: 101 ticks, 0.1 s; the sensor of F_ext was at its range in 10 of 101 ticks, first at t = 0.021 s"
            )
            np.testing.assert_array_equal(np.flatnonzero(out.extra["saturated.F_ext"]), np.arange(21, 31))
            in_tool = out.extra["sensed.F_ext"][25, :3] @ taut.snapshot(ARM, out.q[25]).T().R
            np.testing.assert_allclose(np.abs(in_tool).max(), 10.0)
            assert out.extra["F_ext"][25, 2] == 20.0  # the truth stands beside it


# -------------------------------------------------------------------- the accelerometer


class TestAnAccelerometer:
    @pytest.mark.parametrize("name", ["planar3", "gantry3", "ur5", "panda"])
    def test_reads_what_mujoco_says_a_sensor_at_the_tool_reads(self, name: str) -> None:
        arm = taut.load_arm(name)
        plant = taut.MujocoPlant(arm)
        model, data, answer = plant.model, plant.data, np.zeros(6)
        order = [int(model.jnt_dofadr[model.joint(joint).id]) for joint in arm.joint_names]
        rng = np.random.default_rng(8)
        for _ in range(5):
            q, v, a = arm.home + rng.standard_normal(arm.n), rng.standard_normal(arm.n), rng.standard_normal(arm.n)
            plant.reset(q, v, 1e-3)
            mujoco.mj_forward(model, data)
            data.qacc[order] = a
            mujoco.mj_rnePostConstraint(model, data)
            mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_SITE, model.site(arm.tool).id, answer, 1)
            seen = read(Sensors(tip=taut.sensors.Accelerometer()), {"q": q, "v": v, "a": a}, arm)["a_tip"]
            np.testing.assert_allclose(seen, answer[3:], atol=1e-9 * max(1.0, np.abs(answer).max()))

    def test_reads_the_weight_at_rest_and_nothing_in_free_fall(self) -> None:
        true = {"q": np.array([0.3, 0.4]), "v": np.zeros(2), "a": np.zeros(2)}
        tip = Sensors(tip=taut.sensors.Accelerometer())
        R = taut.snapshot(ARM, true["q"]).T().R
        np.testing.assert_allclose(R @ read(tip, true)["a_tip"], -ARM.gravity, atol=1e-14)
        gantry = taut.load_arm("gantry3")
        z = next(i for i in range(3) if abs(gantry.joints[i].axis[2]) > 0.5)
        falling = {"q": np.zeros(3), "v": np.zeros(3), "a": np.zeros(3)}
        x = taut.snapshot(gantry, [0.0] * 3)
        falling["a"][z] = gantry.gravity[2] / x.J()[2, z]
        np.testing.assert_allclose(read(tip, falling, gantry)["a_tip"], 0.0, atol=1e-12)

    @pytest.mark.part(1)
    @pytest.mark.parametrize("substeps", [1, 3])
    @pytest.mark.parametrize("integrator", ["semi-implicit-euler", "rk4"])
    def test_in_a_run_reads_the_second_derivative_of_the_tools_path(self, integrator: Any, substeps: int) -> None:
        plant = taut.RigidPlant(
            ARM,
            friction=None,
            integrator=integrator,
            substeps=substeps,
            sensors=Sensors(tip=taut.sensors.Accelerometer()),
        )
        errors = []
        for rate in (5e3, 1e4):
            out = run(plant, HOLD, law=FeelsTip(), v0=[1.0, -2.0], duration=0.2, rate=rate)
            tool = [taut.snapshot(ARM, q).T() for q in out.q]
            p = np.array([T.p for T in tool])
            second = (p[2:] - 2.0 * p[1:-1] + p[:-2]) * rate**2
            wanted = np.array([T.R.T @ (a - ARM.gravity) for T, a in zip(tool[1:-1], second, strict=True)])
            errors.append(np.abs(out.extra["sensed.a_tip"][6:-1] - wanted[5:]).max() / np.abs(wanted).max())
        # The joints' acceleration is that of the step before the tick: early by a step at most, so of first order.
        assert errors[1] < 0.01
        np.testing.assert_allclose(errors[0] / errors[1], 2.0, rtol=0.1)

    @pytest.mark.parametrize("takes", ["velocity", "position"])
    def test_works_on_stiff_drives_too(self, takes: Any) -> None:
        drives = taut.drives.Actuation(bandwidth=20.0)
        plant = taut.RigidPlant(ARM, takes=takes, actuation=drives, sensors=Sensors(tip=taut.sensors.Accelerometer()))
        inputs = plant.parameters
        memory = plant.start(np.zeros(2), np.zeros(2), inputs, 1e-3)
        memory = plant.command(np.array([0.5, 0.1]), memory, 0.0)
        after = plant.advance(memory, inputs, 1e-3)
        np.testing.assert_allclose(after["a"], (after["v"] - memory["v"]) / 1e-3)
        assert after["a"].any()

    def test_has_bias_noise_and_range(self) -> None:
        true = {"q": np.zeros(2), "v": np.zeros(2), "a": np.zeros(2)}
        ideal = read(Sensors(tip=taut.sensors.Accelerometer()), true)["a_tip"]
        bias, normal = np.array([0.1, 0.2, 0.3]), np.array([1.0, -1.0, 2.0])
        faulty = taut.sensors.Accelerometer(bias=bias, noise=0.05, range=[9.0, 20.0, 9.0])
        seen = read(Sensors(tip=faulty), true, a_tip=normal)
        np.testing.assert_allclose(seen["a_tip"], np.clip(ideal + bias + 0.05 * normal, [-9, -20, -9], [9, 20, 9]))
        plant = taut.RigidPlant(ARM, sensors=Sensors(tip=taut.sensors.Accelerometer(noise=0.5)), adds=STILL)
        out = run(plant, HOLD, law=FeelsTip(), duration=10.0)
        np.testing.assert_allclose((out.extra["sensed.a_tip"] - ideal).std(axis=0), 0.5, rtol=0.03)


# -------------------------------------------------------------------- what a plant declares


class TestAPlantWithSensors:
    def test_measures_what_has_a_sensor(self) -> None:
        bare = Sensors(velocity=None, torque=None)
        assert taut.RigidPlant(ARM, sensors=bare).measures == frozenset()
        full = Sensors(
            motor=taut.sensors.Encoder(),
            motor_velocity=taut.sensors.Tachometer(),
            tip=taut.sensors.Accelerometer(),
            wrench=None,
        )
        touched = taut.RigidPlant(ARM, sensors=full, environment=Push())
        assert touched.measures == {"v", "q_motor", "v_motor", "tau_meas", "a_tip"}

    def test_draws_noise_by_measurement_in_its_size(self) -> None:
        noisy = Sensors(
            position=taut.sensors.Encoder(noise=1e-3),
            velocity=taut.sensors.Tachometer(noise=1e-3),
            motor=taut.sensors.Encoder(noise=1e-3),
            motor_velocity=taut.sensors.Tachometer(noise=1e-3),
            torque=taut.sensors.TorqueSensor(noise=1e-3),
            wrench=taut.sensors.WrenchSensor(noise=(1.0, 0.1)),
            tip=taut.sensors.Accelerometer(noise=0.1),
        )
        plant = taut.RigidPlant(ARM, sensors=noisy, environment=Push())
        assert plant.noise == {
            "q": (2,), "v": (2,), "q_motor": (2,), "v_motor": (2,), "tau_meas": (2,), "F_ext": (6,), "a_tip": (3,),
        }  # fmt: skip
        assert plant.distorts == set(plant.noise)

    def test_has_parameters_of_what_is_there_alone(self) -> None:
        sensors = Sensors(
            position=taut.sensors.Encoder(resolution=[0.0, 1e-3], noise=0.0),
            torque=taut.sensors.TorqueSensor(bias=-0.5),
            wrench=taut.sensors.WrenchSensor(range=(100.0, np.inf), bias=[0.0] * 6),
            tip=taut.sensors.Accelerometer(range=np.inf),
        )
        parameters = taut.RigidPlant(ARM, sensors=sensors, environment=Push()).parameters
        there = {path: value.tolist() for path, value in parameters.items() if path.startswith("sensors.")}
        assert there == {
            "sensors.position.resolution": [0.0, 1e-3],
            "sensors.torque.bias": -0.5,
            "sensors.wrench.range": [100.0] * 3 + [np.inf] * 3,
        }

    def test_takes_new_numbers_like_the_first_ones(self) -> None:
        sensors = Sensors(
            velocity=taut.sensors.Tachometer(offset=1.0),
            wrench=taut.sensors.WrenchSensor(range=(100.0, 10.0), bias=(1.0, 1.0)),
            tip=taut.sensors.Accelerometer(bias=[1.0, 2.0, 3.0]),
        )
        plant = taut.RigidPlant(taut.load_arm("planar3"), sensors=sensors, environment=Push())
        assert plant.checked_parameter("sensors.velocity.offset", -2.0) == -2.0
        assert plant.checked_parameter("sensors.wrench.range", (50.0, 5.0)).tolist() == [50.0] * 3 + [5.0] * 3
        assert plant.checked_parameter("sensors.tip.bias", -1.0).tolist() == [-1.0] * 3
        with refused(taut.errors.RangeError):
            plant.checked_parameter("sensors.tip.bias", [0.0, np.nan, 0.0])
        with refused(taut.errors.RangeError):
            plant.checked_parameter("sensors.wrench.range", (50.0, 0.0))


CASES: list[tuple[Callable[[], object], type[taut.TautError], str]] = [
    (lambda: taut.sensors.Encoder(resolution=0.0), taut.errors.RangeError, "resolution"),
    (lambda: taut.sensors.Encoder(resolution=[0.0, 0.0]), taut.errors.RangeError, "resolution"),
    (lambda: taut.sensors.Encoder(resolution=[0.1, -0.1]), taut.errors.RangeError, "resolution"),
    (lambda: taut.sensors.Encoder(resolution=np.nan), taut.errors.RangeError, "resolution"),
    (lambda: taut.sensors.Encoder(noise=-1.0), taut.errors.RangeError, "noise"),
    (lambda: taut.sensors.Encoder(offset="left"), taut.errors.ShapeError, "offset"),
    (lambda: taut.sensors.Encoder(side="both"), taut.errors.UsageError, "side"),  # type: ignore[arg-type]
    (lambda: taut.sensors.Tachometer(noise=[0.0, -1e-3]), taut.errors.RangeError, "noise"),
    (lambda: taut.sensors.TorqueSensor(resolution=0.0), taut.errors.RangeError, "resolution"),
    (lambda: taut.sensors.TorqueSensor(side=None), taut.errors.UsageError, "side"),  # type: ignore[arg-type]
    (lambda: taut.sensors.WrenchSensor(noise=0.5), taut.errors.ShapeError, "noise"),
    (lambda: taut.sensors.WrenchSensor(bias=[1.0, 2.0, 3.0]), taut.errors.ShapeError, "bias"),
    (lambda: taut.sensors.WrenchSensor(range=(100.0, 0.0)), taut.errors.RangeError, "range"),
    (lambda: taut.sensors.Accelerometer(range=0.0), taut.errors.RangeError, "range"),
    (lambda: taut.RigidPlant(ARM, sensors=Sensors(position=taut.sensors.Encoder(resolution=4096))), taut.errors.RangeError, "resolution"),
    (lambda: taut.RigidPlant(ARM, sensors=Sensors(motor=taut.sensors.Encoder(resolution=1e-3))).checked_parameter("sensors.motor.resolution", 7.0), taut.errors.RangeError, "sensors.motor.resolution"),
    (lambda: Sensors(position=None), taut.errors.UsageError, "position"),  # type: ignore[arg-type]
    (lambda: Sensors(velocity=taut.sensors.Encoder()), taut.errors.UsageError, "velocity"),  # type: ignore[arg-type]
    (lambda: Sensors(motor=taut.sensors.Encoder(side="link")), taut.errors.UsageError, "motor"),
    (lambda: Sensors(motor_velocity=taut.sensors.Tachometer(side="link")), taut.errors.UsageError, "motor_velocity"),
    (lambda: taut.RigidPlant(ARM, sensors=Sensors(tip=taut.sensors.Accelerometer(noise=[1.0, 1.0]))), taut.errors.ShapeError, "noise"),
    (lambda: taut.RigidPlant(ARM, sensors=Sensors(wrench=taut.sensors.WrenchSensor(noise=(1.0, 0.1)))), taut.errors.UsageError, "wrench"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "kind", "name"), CASES, ids=range(len(CASES)))
def test_what_is_no_sensor_is_refused_by_name(
    make: Callable[[], object], kind: type[taut.TautError], name: str
) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert caught.value.name == name
