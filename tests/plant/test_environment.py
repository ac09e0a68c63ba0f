"""What touches the tool: a spring and damper of our own against closed forms, its sign, its instant, its memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from plant_laws import TINY, Array, run
from refusals import refused

import taut

GANTRY = taut.load_arm("gantry3").with_joints(viscous=0.0)
MASSES = np.array([21.0, 9.0, 3.0])  # what each slide moves [kg]
HOLD = taut.JointMotion(q=np.zeros(3))
WEIGHT = 3.0 * 9.81


class SpringDamper(taut.environments.Environment):
    """A spring between the tool and a point of the world; the point is where the tool starts, unless given."""

    k: taut.environments.Field = taut.environments.Field(300.0, unit="N/m")
    b: taut.environments.Field = taut.environments.Field(0.0, unit="N s/m")
    anchor: tuple[float, float, float] | None = None

    def start(self, T_WE: taut.Pose) -> dict[str, Any]:
        return {"anchor": T_WE.p if self.anchor is None else np.array(self.anchor)}

    def wrench(
        self,
        T_WE: taut.Pose,
        twist: Array,
        t: Any,
        memory: Mapping[str, Any],
        parameters: Mapping[str, Any],
        dt: Any,
    ) -> tuple[Array, dict[str, Any]]:
        force = parameters["k"] * (memory["anchor"] - T_WE.p) - parameters["b"] * twist[:3]
        return taut.math.array([*force, 0.0, 0.0, 0.0]), {"anchor": memory["anchor"]}


class Shaker(taut.environments.Environment):
    """A force along x that is a function of time."""

    amplitude: float = 5.0
    omega: float = 20.0

    def wrench(
        self, T_WE: Any, twist: Any, t: Any, memory: Any, parameters: Any, dt: Any
    ) -> tuple[Array, dict[str, Any]]:
        return taut.math.array([self.amplitude * taut.math.cos(self.omega * t), 0.0, 0.0, 0.0, 0.0, 0.0]), {}


class Feels(taut.Law):
    """No torque; what the law sees of the wrench, hidden in terms that move nothing."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(force=x.F_ext[:3] * TINY, moment=x.F_ext[3:] * TINY)


class TestASpringOnTheGantry:
    def test_carries_the_weight_at_its_static_deflection(self) -> None:
        plant = taut.RigidPlant(GANTRY.with_joints(viscous=40.0), environment=SpringDamper(k=300.0))
        out = run(plant, HOLD, duration=8.0)
        assert out.q[-1, 2] == pytest.approx(-WEIGHT / 300.0, rel=1e-6)
        # The environment pushes the arm up: F_ext is the wrench on the arm.
        np.testing.assert_allclose(out.extra["F_ext"][-1], [0, 0, WEIGHT, 0, 0, 0], rtol=1e-6, atol=1e-9)

    @pytest.mark.parametrize("axis", [0, 1, 2])
    def test_swings_at_its_natural_frequency(self, axis: int) -> None:
        omega = np.sqrt(300.0 / MASSES[axis])
        plant = taut.RigidPlant(GANTRY, integrator="rk4", environment=SpringDamper(k=300.0), adds=("gravity",))
        v0 = np.eye(3)[axis] * 0.2
        out = run(plant, HOLD, duration=3.0, v0=v0)
        np.testing.assert_allclose(out.q[:, axis], 0.2 / omega * np.sin(omega * out.t), rtol=0.0, atol=1e-9)

    def test_and_damper_decay_as_designed(self) -> None:
        k, b, m = 300.0, 12.0, 3.0
        zeta, omega = b / (2.0 * np.sqrt(k * m)), np.sqrt(k / m)
        plant = taut.RigidPlant(GANTRY, integrator="rk4", environment=SpringDamper(k=k, b=b), adds=("gravity",))
        out = run(plant, HOLD, duration=2.0, v0=[0.0, 0.0, 0.2])
        omega_d = omega * np.sqrt(1.0 - zeta**2)
        expected = 0.2 / omega_d * np.exp(-zeta * omega * out.t) * np.sin(omega_d * out.t)
        np.testing.assert_allclose(out.q[:, 2], expected, rtol=0.0, atol=1e-9)

    @pytest.mark.parametrize(("integrator", "order", "within"), [("semi-implicit-euler", 1, 0.1), ("rk4", 4, 0.1)])
    def test_is_integrated_to_the_integrators_order(self, integrator: str, order: int, within: float) -> None:
        def error(substeps: int) -> float:
            spring = SpringDamper(k=300.0, b=12.0)
            options: dict[str, Any] = {"integrator": integrator, "substeps": substeps, "adds": ("gravity",)}
            plant = taut.RigidPlant(GANTRY, environment=spring, **options)
            out = run(plant, HOLD, duration=0.5, rate=50.0, v0=[0.0, 0.0, 0.2])
            omega_d = np.sqrt(100.0 - 4.0)
            return float(abs(out.q[-1, 2] - 0.2 / omega_d * np.exp(-1.0) * np.sin(omega_d * 0.5)))

        assert np.log2(error(4) / error(8)) == pytest.approx(order, abs=within)

    def test_has_parameters_that_events_change(self) -> None:
        plant = taut.RigidPlant(GANTRY.with_joints(viscous=40.0), environment=SpringDamper(k=300.0))
        stiffer = [taut.Event(t=4.0, set={"environment.k": 600.0})]
        out = run(plant, HOLD, duration=8.0, events=stiffer)
        assert out.q[3999, 2] == pytest.approx(-WEIGHT / 300.0, rel=1e-3)
        assert out.q[-1, 2] == pytest.approx(-WEIGHT / 600.0, rel=1e-3)

    def test_remembers_where_the_tool_started(self) -> None:
        plant = taut.RigidPlant(GANTRY, integrator="rk4", environment=SpringDamper(k=300.0), adds=("gravity",))
        out = run(plant, HOLD, duration=0.5, q0=[0.1, -0.2, 0.05])
        np.testing.assert_allclose(out.q, np.broadcast_to([0.1, -0.2, 0.05], out.q.shape), atol=1e-14)


class TestTheInstant:
    @pytest.mark.parametrize("substeps", [1, 4])
    def test_a_run_records_the_wrench_at_the_tick(self, substeps: int) -> None:
        spring = SpringDamper(k=300.0, b=5.0, anchor=(0.1, 0.0, -0.2))
        out = run(taut.RigidPlant(GANTRY, environment=spring, substeps=substeps), HOLD, duration=0.3)
        tool = out.q - np.array([0.0, 0.0, 0.2])
        expected = 300.0 * (np.array([0.1, 0.0, -0.2]) - tool) - 5.0 * out.v
        np.testing.assert_allclose(out.extra["F_ext"][:, :3], expected, rtol=0.0, atol=1e-11)

    def test_a_sensor_gives_the_wrench_of_the_last_step_and_at_the_start_that_of_the_start(self) -> None:
        spring = SpringDamper(k=300.0, anchor=(0.1, 0.0, -0.2))
        out = run(taut.RigidPlant(GANTRY, environment=spring), HOLD, law=Feels(), duration=0.1)
        felt = out.terms["force"] / TINY
        np.testing.assert_allclose(felt[0], [300.0 * 0.1, 0.0, 0.0], rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(felt[1:], out.extra["F_ext"][:-1, :3])

    @pytest.mark.part(2)
    @pytest.mark.parametrize(("integrator", "within"), [("rk4", 1e-9), ("semi-implicit-euler", 2e-3)])
    @pytest.mark.parametrize("substeps", [1, 3])
    def test_a_force_that_is_a_function_of_time_gets_the_right_time(
        self, integrator: str, within: float, substeps: int
    ) -> None:
        """m a = F cos(w t) from rest: v = F / (m w) sin(w t). A time that is off by a step is off by 1 % here."""
        options: dict[str, Any] = {"integrator": integrator, "substeps": substeps, "adds": ("gravity",)}
        out = run(taut.RigidPlant(GANTRY, environment=Shaker(), **options), HOLD, duration=1.0)
        scale = 5.0 / (21.0 * 20.0)
        got = out.v[:, 0]
        np.testing.assert_allclose(got, scale * np.sin(20.0 * out.t), rtol=0.0, atol=within * scale * 10.0)

    def test_events_do_not_disturb_its_time(self) -> None:
        plant = taut.RigidPlant(GANTRY, integrator="rk4", environment=Shaker(), adds=("gravity",))
        events = [taut.Event(t=t, set={"plant.payload.mass": 0.0}) for t in (0.0, 0.123, 0.5)]
        plain, cut = (run(plant, HOLD, duration=1.0, events=e) for e in (None, events))
        np.testing.assert_array_equal(plain.v, cut.v)


def test_a_wrench_acts_at_the_tool_and_in_world_axes() -> None:
    """On an arm that is mounted askew: the joint torques of a force are J^T F, with the tool's own lever."""

    class Push(taut.environments.Environment):
        def wrench(self, *_: Any) -> tuple[Array, dict[str, Any]]:
            return np.array([3.0, -2.0, 5.0, 0.1, 0.2, -0.3]), {}

    arm = taut.load_arm("panda", T_WB=taut.Pose([0.1, 0.2, 0.3], rpy=[0.4, 0.5, 0.6])).with_joints(viscous=0.0)
    plant = taut.RigidPlant(arm, environment=Push(), adds=("gravity", "coriolis"))
    out = run(plant, duration=0.001)
    x = taut.snapshot(arm, arm.home)
    expected = 1e-3 * np.linalg.solve(x.M, x.J().T @ [3.0, -2.0, 5.0, 0.1, 0.2, -0.3])
    np.testing.assert_allclose(out.v[1], expected, rtol=0.0, atol=1e-12)


# -------------------------------------------------------------------- environments that are no pure functions


class Wrong(taut.environments.Environment):
    """An environment with one fault."""

    fault: str
    calls: Any = None

    def start(self, T_WE: taut.Pose) -> dict[str, Any]:
        return {"depth": 0.0}

    def wrench(
        self, T_WE: taut.Pose, twist: Array, t: Any, memory: Any, parameters: Any, dt: Any
    ) -> tuple[Any, dict[str, Any]]:
        self.calls.append(1)
        force = {"counts": float(len(self.calls)), "draws": np.random.default_rng().normal()}.get(self.fault, 1.0)
        wrench = taut.math.array([force, *([0.0] * (2 if self.fault == "shape" else 5))])
        return wrench, {} if self.fault == "memory" else dict(memory)


@pytest.mark.parametrize(
    "fault",
    [
        "counts",
        "draws",
        "shape",
        "memory",
    ],
)
def test_an_environment_with_a_fault_is_told(fault: str) -> None:
    plant = taut.RigidPlant(GANTRY, environment=Wrong(fault=fault, calls=[]))
    ctrl = taut.compile(taut.laws.PID(kp=1.0), GANTRY)
    with refused(taut.TautError):
        taut.run(ctrl, plant, HOLD, duration=0.01)


class Bare(taut.environments.Environment):
    """Nothing but the names that the base class has."""


class Gives(taut.environments.Environment):
    """An environment whose wrench gives what it should not."""

    acted: Any = None

    def wrench(self, *_: Any) -> Any:
        return self.acted


class Own(taut.environments.Environment):
    """A spring of the user's."""

    stiffness: taut.environments.Field = taut.environments.Field(30.0, unit="N/m")

    def start(self, T_WE: taut.Pose) -> dict[str, Any]:
        return {"p": T_WE.p}

    def wrench(self, T_WE: taut.Pose, twist: Any, t: Any, memory: Any, parameters: Any, dt: Any) -> Any:
        force = parameters["stiffness"] * (memory["p"] - T_WE.p)
        return taut.math.array([*force, 0.0, 0.0, 0.0]), memory


ENVIRONMENTS = {
    "bare": Bare(),
    "no memory after": Gives(acted=np.zeros(6)),
    "nothing": Gives(),
}


@pytest.mark.parametrize("together", [False, True])
@pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
class TestEnvironmentsOfTheUser:
    @pytest.mark.parametrize("environment", ENVIRONMENTS.values(), ids=ENVIRONMENTS)
    def test_that_lack_something_are_refused(self, environment: Any, plant: Any, together: bool) -> None:
        def go() -> None:
            given = taut.environments.Environments(mine=environment) if together else environment
            made = plant(GANTRY, environment=given)
            taut.run(taut.compile(taut.laws.PID(kp=1.0), GANTRY), made, HOLD, duration=0.01)

        with refused((taut.errors.UsageError, taut.errors.ShapeError)):
            go()

    @pytest.mark.part(2)
    def test_may_inherit_from_the_base_class(self, plant: Any, together: bool) -> None:
        own: Any = taut.environments.Environments(mine=Own()) if together else Own()
        ctrl = taut.compile(taut.laws.PID(kp=1.0, kd=1.0), GANTRY)
        mine = taut.run(ctrl, plant(GANTRY, environment=own), HOLD, duration=0.05)
        ready = taut.run(
            ctrl, plant(GANTRY, environment=taut.environments.Spring(stiffness=30.0)), HOLD, duration=0.05
        )
        np.testing.assert_allclose(mine.q, ready.q, rtol=0.0, atol=1e-12)
