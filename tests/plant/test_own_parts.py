"""Parts of a user's own, each one class that uses public names only: environment, friction law, motor, sensor, plant."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
import taut.math as tm
from taut.codegen.noise import Noise, noise_block
from taut.drives import Field, FlexibleLink, FrictionLaw, MotorInput, MotorModel, MotorStep
from taut.environments import Environment
from taut.errors import UsageError

LINK = taut.load_arm("one_joint").with_joints(viscous=0.0)
BENT = FlexibleLink(length=1.0, EI=1.0, density=1.0, hub_inertia=0.1)


class HuntCrossley(Environment):
    """A wall without a jump of the force at first contact.

    Law:          N = stiffness d^1.5 max(1 + restitution d_dot, 0) with the depth d >= 0
    """

    stiffness: Field = Field(unit="N/m^1.5", above=0.0)
    restitution: Field = Field(0.0, unit="s/m", minimum=0.0)
    height: Field = Field(unit="m")

    def wrench(
        self, T_WE: taut.Pose, twist: Any, t: Any, memory: Any, parameters: Mapping[str, Any], dt: Any
    ) -> tuple[Any, dict[str, Any]]:
        depth = tm.maximum(parameters["height"] - T_WE.p[2], 0.0)
        damping = tm.maximum(1.0 - parameters["restitution"] * twist[2], 0.0)
        N = parameters["stiffness"] * depth * tm.sqrt(depth + 1e-18) * damping
        return tm.array([0.0, 0.0, N, 0.0, 0.0, 0.0]), {}


class Screw(FrictionLaw):
    """Dry friction that differs by direction, and viscous friction."""

    forward: Field = Field(unit="N m", shape="n", minimum=0.0)
    backward: Field = Field(unit="N m", shape="n", minimum=0.0)
    slope: Field = Field(0.0, unit="N m s/rad", shape="n", minimum=0.0)

    def limits(self, v: Any, at_rest: Any, tau_motor: Any, tau_load: Any, p: Mapping[str, Any]) -> tuple[Any, Any]:
        return p["forward"] + 0.0 * v, p["backward"] + 0.0 * v

    def viscous(self, p: Mapping[str, Any]) -> Any:
        return p["slope"]


class Hot(MotorModel):
    """A motor whose torque falls as its windings get warm.

    Law:          tau = asked / (1 + loss heat),  heat+ = heat + dt asked^2
    """

    loss: Field = Field(unit="1/((N m)^2 s)", shape="n", minimum=0.0)

    def start(self, tau: Any, gear: Any, bandwidth: Any, p: Mapping[str, Any]) -> dict[str, Any]:
        return {"heat": 0.0 * tau}

    def step(self, x: MotorInput) -> MotorStep:
        heat = x.memory["heat"]
        after = {"heat": heat + x.dt * x.tau * x.tau}
        return MotorStep(tau=x.ripple * x.tau / (1.0 + x.p["loss"] * heat), memory=after)


class Resolver(taut.sensors.Sensor):
    """A position sensor whose reading has two periods in a turn of the joint, and noise.

    Law:          reading = q + ripple sin(2 q) + noise n
    """

    ripple: Field = Field(unit="rad", shape="n", minimum=0.0)
    noise: Field = Field(0.0, unit="rad", shape="n", minimum=0.0)

    def read(self, model: Any, true: Any, p: Mapping[str, Any], noise: Any) -> Any:
        return true["q"] + p["ripple"] * tm.sin(2.0 * true["q"]) + p["noise"] * noise


class Push(taut.Law):
    """The torque that its reference has for an acceleration."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(push=ref.a + 0.0 * x.q)


def pushed(
    torque: float, *, engine: Any = "auto", duration: float = 0.2, plant: Any = None, **options: Any
) -> taut.Run:
    made = plant or taut.RigidPlant(LINK, adds=("gravity",), **options)
    ctrl = taut.compile(Push(), LINK, adds=("gravity",), engine=engine)
    run = taut.run(ctrl, made, taut.JointMotion(q=[0.0], a=[torque]), duration=duration, q0=[0.0])
    assert run.outcome.ok, run.outcome
    return run


@pytest.mark.part(2)
@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize(("torque", "net"), [(1.0, 0.5), (-1.0, -0.8), (0.4, 0.0), (-0.19, 0.0), (-0.25, -0.05)])
def test_a_friction_law_of_ones_own_differs_by_direction_and_sticks(torque: float, net: float, engine: str) -> None:
    run = pushed(torque, engine=engine, friction=Screw(forward=0.5, backward=0.2))
    M = float(np.asarray(taut.snapshot(LINK, [0.0]).M)[0, 0])
    assert run.v[-1, 0] == pytest.approx(net / M * run.t[-1], abs=1e-12)


def test_its_numbers_are_parameters_by_path_and_are_checked() -> None:
    plant = taut.RigidPlant(LINK, friction=Screw(forward=0.5, backward=0.2, slope=0.1))
    assert {path for path in plant.parameters if "friction" in path} == {
        "plant.friction.forward",
        "plant.friction.backward",
        "plant.friction.slope",
    }
    with pytest.raises(taut.errors.RangeError) as caught:
        plant.checked_parameter("plant.friction.backward", -1.0)
    assert caught.value.name == "plant.friction.backward"
    with pytest.raises(taut.errors.ShapeError):
        taut.RigidPlant(LINK, friction=Screw(forward=[0.5, 0.1], backward=0.2))
    with pytest.raises(taut.errors.UsageError):
        taut.RigidPlant(LINK, friction=taut.Friction(coulomb=1.0))  # type: ignore[arg-type]  # that is the arm's


def test_friction_takes_what_it_takes_in_the_account_of_energy() -> None:
    run = pushed(1.0, friction=Screw(forward=0.5, backward=0.2, slope=0.3), energy=True)
    parts = {name: run.extra[f"work.{name}"][-1, 0] for name in ("motor", "dry", "viscous", "link", "integration")}
    assert parts["dry"] == pytest.approx(0.5 * run.q[-1, 0], rel=1e-6)
    total = parts["dry"] + parts["viscous"] + parts["link"] + parts["integration"]
    assert parts["motor"] == pytest.approx(total, rel=1e-9)


@pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
def test_a_motor_of_ones_own_remembers(plant: Any) -> None:
    made = plant(LINK, adds=("gravity",), friction=None, actuation=taut.drives.Actuation(motor=Hot(loss=2.0)))
    run = pushed(1.0, plant=made, duration=0.5)
    M = float(np.asarray(taut.snapshot(LINK, [0.0]).M)[0, 0])
    expected = np.log1p(2.0 * run.t[-1]) / 2.0 / M  # the integral of 1 / (1 + 2 t)
    assert run.v[-1, 0] == pytest.approx(expected, rel=2e-3)
    assert made.parameters["actuation.motor.loss"] == 2.0


@pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
def test_an_environment_of_ones_own_pushes_back_as_its_law_says(plant: Any) -> None:
    arm = taut.load_arm("gantry3").with_joints(viscous=50.0)
    law = taut.laws.GravityPID(kp=500.0, kd=100.0)
    start = np.array([0.0, 0.0, 0.0])
    height = float(taut.snapshot(arm, start).T().p[2])
    made = plant(arm, environment=HuntCrossley(stiffness=1e5, restitution=0.5, height=height + 0.01))
    run = taut.run(taut.compile(law, arm), made, taut.JointMotion(q=start), duration=3.0, q0=start)
    x = taut.snapshot(arm, run.q[-1])
    depth = height + 0.01 - float(x.T().p[2])
    assert run.extra["F_ext"][-1, 2] == pytest.approx(1e5 * depth**1.5, rel=1e-3)
    with pytest.raises(taut.errors.RangeError) as caught:
        made.checked_parameter("environment.stiffness", 0.0)
    assert caught.value.name == "environment.stiffness"


class Sees(taut.Law):
    """No torque; what is measured, in a term."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(seen=2.0**-60 * x.q)


@pytest.mark.part(2)
@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
def test_a_sensor_of_ones_own_is_what_the_law_sees(plant: Any, engine: Any) -> None:
    sensors = taut.sensors.Sensors(position=Resolver(ripple=0.01, noise=1e-3))
    made = plant(LINK, sensors=sensors)
    assert made.parameters["sensors.position.ripple"] == 0.01
    with refused(taut.errors.RangeError):
        made.checked_parameter("sensors.position.ripple", -1.0)
    ctrl = taut.compile(Sees(), LINK, engine=engine)
    louder = taut.Event(t=0.1, set={"sensors.position.noise": 0.0, "sensors.position.ripple": 0.02})
    run = taut.run(ctrl, made, duration=0.2, q0=[0.7], seed=3, events=[louder])
    Noise(noise_block({"q": (1,)}), "float").fill(noise := np.zeros((len(run), 1)), 0, 3)
    first = (run.t < 0.1 - 1e-9)[:, np.newaxis]
    expected = run.q + np.where(first, 0.01, 0.02) * np.sin(2.0 * run.q) + np.where(first, 1e-3, 0.0) * noise
    np.testing.assert_allclose(run.extra["sensed.q"], expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(run.terms["seen"] * 2.0**60, expected, rtol=0.0, atol=1e-12)


def test_a_sensor_that_gives_another_shape_is_refused() -> None:
    class Half(taut.sensors.Sensor):
        def read(self, model: Any, true: Any, p: Any, noise: Any) -> Any:
            return tm.array([0.0, 0.0])

    plant = taut.RigidPlant(LINK, sensors=taut.sensors.Sensors(position=Half()))
    with refused(taut.errors.ShapeError):
        taut.run(taut.compile(Sees(), LINK), plant, duration=0.1)


class Slider(taut.PlantBase):
    """A plant of a user's own: one mass on a rail with a motor that gives what it is asked for."""

    def __init__(self, arm: taut.Arm, mass: float) -> None:
        self.arm, self._mass = arm, np.asarray(mass)

    @property
    def parameters(self) -> dict[str, Any]:
        return {"plant.mass": self._mass}

    def checked_parameter(self, path: str, value: Any) -> Any:
        if path != "plant.mass" or not float(value) > 0.0:
            raise taut.errors.RangeError(f"{path} must be > 0 [kg]; got {value!r}", name=path)
        return np.asarray(value, dtype=float)

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        for path, value in values.items():
            self._mass = self.checked_parameter(path, value)

    def reset(self, q: Any, v: Any, dt: float, seed: int) -> None:
        self._q, self._v, self._dt = np.array(q), np.array(v), dt

    def state(self) -> tuple[Any, Any]:
        return self._q.copy(), self._v.copy()

    def advance(self, command: Any) -> Any:
        self._v = self._v + self._dt * command / self._mass
        self._q = self._q + self._dt * self._v
        return command

    def extra(self) -> dict[str, Any]:
        return {"kinetic": 0.5 * float(self._mass) * float(self._v @ self._v)}


@pytest.mark.parametrize("plant", [taut.RigidPlant(LINK), taut.MujocoPlant(LINK), BENT], ids=lambda plant: plant.name)
def test_the_parameters_of_a_plant_are_to_be_read(plant: Any) -> None:
    before = dict(plant.parameters)
    with refused(UsageError):
        plant.parameters["plant.payload.mass"] = 3.0
    for change in (plant.parameters.update, plant.parameters.setdefault, plant.parameters.pop):
        with pytest.raises(UsageError):
            change({"plant.payload.mass": 3.0})
    assert all(plant.parameters[path] is value and not value.flags.writeable for path, value in before.items())
    assert copy.deepcopy(plant.parameters).keys() == before.keys()


def test_a_plant_of_ones_own_runs_with_events_and_columns() -> None:
    heavier = taut.Event(t=0.1, set={"plant.mass": 4.0})
    ctrl = taut.compile(Push(), LINK, adds=())
    plant = Slider(LINK, mass=2.0)
    run = taut.run(ctrl, plant, taut.JointMotion(q=[0.0], a=[1.0]), duration=0.2, q0=[0.0], events=[heavier])
    assert run.outcome.ok, run.outcome
    assert run.v[-1, 0] == pytest.approx(0.1 / 2.0 + 0.1 / 4.0, abs=1e-12)
    assert run.extra["kinetic"][-1] == pytest.approx(2.0 * run.v[-1, 0] ** 2, rel=0.02)


class Resting(taut.PlantBase):
    def reset(self, q: Any, v: Any, dt: float, seed: int) -> None:
        self.now = q.copy(), v.copy()

    def state(self) -> Any:
        return self.now

    def advance(self, command: Any) -> Any:
        return command


@pytest.mark.parametrize(
    ("method", "gives"),
    [
        ("advance", None),
        ("advance", np.zeros(3)),
        ("measure", {"q": np.zeros(2)}),
        ("measure", None),
    ],
)
def test_a_plant_that_gives_something_else_is_refused_by_its_method(method: str, gives: Any) -> None:
    arm = taut.load_arm("planar2")
    plant = type("Wrong", (Resting,), {method: lambda *_: gives})(arm)
    with refused(taut.errors.ShapeError):
        taut.run(taut.compile(taut.laws.PID(kp=1.0, kd=1.0), arm), plant, duration=0.01)


@pytest.mark.parametrize(
    ("method", "gives", "says"),
    [
        ("advance", None, "advance() must return the torques that acted with shape (2,); got none"),
        ("advance", np.zeros(3), "advance() must return the torques that acted with shape (2,); got shape (3,)"),
        ("advance", 0.0, "advance() must return the torques that acted with shape (2,); got shape ()"),
        ("advance", np.array([0.0, np.nan]), "advance() must return finite torques that acted; got [ 0. nan]"),
        ("measure", None, "measure() must return q with shape (2,); got none"),
        ("measure", {"q": np.zeros(2), "v": 0.0}, "measure() must return v with shape (2,); got shape ()"),
        ("measure", {"q": np.zeros(2), "v": np.full(2, np.nan)}, "v[0] (joint 'joint1') must be finite; got nan in"),
    ],
)
def test_a_plant_that_fails_later_ends_the_run_and_keeps_what_was_before(method: str, gives: Any, says: str) -> None:
    class Late(Resting):
        def _late(self, method: str, usual: Any) -> Any:
            self.calls = getattr(self, "calls", 0) + (method == at_fault)
            return gives if method == at_fault and self.calls > 5 else usual

        def advance(self, command: Any) -> Any:
            return self._late("advance", command)

        def measure(self) -> Any:
            return self._late("measure", super().measure())

    arm, at_fault = taut.load_arm("planar2"), method
    run = taut.run(taut.compile(taut.laws.PID(kp=1.0, kd=1.0), arm), Late(arm), duration=0.05)
    assert (run.outcome.ok, len(run), run.outcome.tick) == (False, 5, 4)
    assert "tick 5" in str(run.outcome)
    assert says in str(run.outcome)
    assert np.isfinite(run.tau).all()


def test_torques_that_are_no_numbers_are_refused_in_the_first_tick() -> None:
    arm = taut.load_arm("planar2")
    plant = type("Wrong", (Resting,), {"advance": lambda *_: np.full(2, np.nan)})(arm)
    with refused(taut.errors.RangeError):
        taut.run(taut.compile(taut.laws.PID(kp=1.0, kd=1.0), arm), plant, duration=0.01)
