"""What touches the tool does the same in RigidPlant and in MuJoCo; pushes, payloads and gains come by events in both."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut

pytest.importorskip("mujoco")

PANDA = taut.load_arm("panda").with_joints(viscous=0.5, coulomb=0.0, rotor_inertia=0.2)
ROUNDING = 1e-11  # of two programs for the same equations, after some hundred steps
PLANTS: dict[str, Callable[..., Any]] = {"rigid": taut.RigidPlant, "mujoco": taut.MujocoPlant}


def run(plant: Any, law: taut.Law | None = None, duration: float = 0.5, **options: Any) -> taut.Run:
    chosen = taut.laws.GravityPID(kp=300.0, kd=30.0) if law is None else law
    out = taut.run(taut.compile(chosen, plant.arm, adds=plant.adds), plant, duration=duration, **options)
    assert out.outcome.ok, out.outcome
    return out


def tool(arm: taut.Arm = PANDA) -> taut.Pose:
    return taut.snapshot(arm, arm.home).T()


ENVIRONMENTS: dict[str, Any] = {
    "spring": taut.environments.Spring(stiffness=(400.0, 20.0), at=taut.Pose(tool().p + 0.05, R=tool().R)),
    "cord": taut.environments.Spring(stiffness=500.0, slack=0.02, at=tool().p + 0.05),
    "damper": taut.environments.Environments(
        damper=taut.environments.Damper(damping=(20.0, 0.5)),
        push=taut.environments.Push(peak=[20.0, 5.0, 0.0], t=0.0),
    ),
    "wall": taut.environments.StiffWall(
        point=tool().p + 0.002, normal=[0, 0, 1], stiffness=2e4, damping=200.0, friction=0.3
    ),
    "handle": taut.environments.Hand(mass=0.5, damping=5.0, stiffness=200.0, at=tool().p + 0.02),
    "hand": taut.environments.Hand(
        mass=0.5,
        damping=10.0,
        stiffness=200.0,
        motion=taut.environments.Oscillation(amplitude=[0.02, 0.0, 0.01], frequency=3.0),
        force=taut.environments.Oscillation(amplitude=3.0, frequency=8.0, phase=0.4),
    ),
    "push": taut.environments.Push(peak=[20.0, 0.0, -10.0, 0.0, 1.0, 0.0], t=0.1, duration=0.07),
}


class TestBothPlants:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("name", ENVIRONMENTS)
    def test_agree(self, name: str) -> None:
        ours, theirs = (run(make(PANDA, environment=ENVIRONMENTS[name])) for make in PLANTS.values())
        assert np.abs(ours.q - PANDA.home).max() > 1e-4
        np.testing.assert_allclose(theirs.q, ours.q, rtol=0.0, atol=ROUNDING)
        F = ours.extra["F_ext"]
        np.testing.assert_allclose(theirs.extra["F_ext"], F, rtol=0.0, atol=1e5 * ROUNDING)
        work = [each.extra["work.environment"] for each in (ours, theirs)]
        np.testing.assert_allclose(work[1], work[0], rtol=0.0, atol=ROUNDING * 1e3)
        assert np.abs(work[0]).max() > 1e-5

    def test_agree_in_steps_within_the_period_and_behind_drives(self) -> None:
        """Motors, gears that lose power, friction that grows with load: each step has the wrench of its own state."""
        arm = PANDA.with_gears(ratio=100.0, motor_inertia=1e-5)
        arm = arm.with_friction(taut.Friction(viscous=0.5, load_external=0.05))
        drives = taut.drives.Actuation(bandwidth=1000.0, transmission=taut.drives.Transmission(efficiency=0.9))
        environment = taut.environments.Environments(spring=ENVIRONMENTS["spring"], push=ENVIRONMENTS["push"])
        ours = run(taut.RigidPlant(arm, actuation=drives, environment=environment, substeps=2), duration=0.3)
        theirs = run(taut.MujocoPlant(arm, actuation=drives, environment=environment, timestep=5e-4), duration=0.3)
        np.testing.assert_allclose(theirs.q, ours.q, rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(
            theirs.extra["work.environment"], ours.extra["work.environment"], rtol=0.0, atol=1e-4
        )

    @pytest.mark.parametrize("plant", PLANTS)
    def test_measure_the_wrench_from_the_first_tick(self, plant: str) -> None:
        class Feels(taut.Law):
            def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
                return taut.Torque(gravity=x.g, force=[*(x.F_ext[:3] * 2.0**-60), 0.0, 0.0, 0.0, 0.0])

        out = run(PLANTS[plant](PANDA, environment=ENVIRONMENTS["cord"]), Feels(), duration=0.01)
        felt = out.terms["force"][:, :3] * 2.0**60
        stretch = 0.05 * np.sqrt(3.0) - 0.02
        np.testing.assert_allclose(felt[0], 500.0 * stretch / np.sqrt(3.0), rtol=1e-9)
        np.testing.assert_allclose(felt[1:], out.extra["F_ext"][:-1, :3], rtol=1e-12)

    def test_too_long_steps_are_refused_in_mujoco_with_its_word(self) -> None:
        wall = taut.environments.StiffWall(point=tool().p, normal=[0, 0, 1], stiffness=3e7)
        with refused(taut.errors.RangeError):
            run(taut.MujocoPlant(PANDA, environment=wall))

    def test_the_scene_keeps_its_own_contacts(self) -> None:
        """A table in MuJoCo and a push into it: the wrench is that of both, and at rest they carry each other."""
        arm = taut.load_arm("gantry3").with_joints(viscous=20.0)
        scene = '<mujoco><worldbody><geom type="box" size="1 1 0.05" pos="0 0 -0.27"/></worldbody></mujoco>'
        push = taut.environments.Push(peak=[0.0, 0.0, -20.0], t=0.0, duration=10.0, shape="rectangular")
        plant = taut.MujocoPlant(arm, scene=scene, environment=push, adds=("gravity",))
        out = run(plant, taut.laws.PID(kp=0.0, kd=0.0), duration=3.0)
        assert out.q[-1, 2] == pytest.approx(-0.01, abs=2e-3)
        assert abs(out.extra["F_ext"][-1, 2]) < 1e-2
        assert out.extra["F_ext"][5, 2] == pytest.approx(-20.0)
        assert out.extra["work.environment"][-1] == pytest.approx(-20.0 * out.q[-1, 2], rel=1e-3)


@pytest.mark.parametrize("plant", PLANTS)
class TestEvents:
    def test_take_a_payload_and_drop_it(self, plant: str) -> None:
        """The arm sags by K^-1 g of what it carries, and comes back."""
        events = [
            taut.Event(t=0.5, set={"plant.payload.mass": 2.0}),
            taut.Event(t=3.0, set={"plant.payload.mass": 0.0}),
        ]
        out = run(PLANTS[plant](PANDA), duration=6.0, events=events)
        q = out.q[2999]
        kp, load = 300.0, PANDA.with_payload(2.0)
        missing = taut.snapshot(load, q).g - taut.snapshot(PANDA, q).g
        assert np.abs(missing).max() > 5.0
        np.testing.assert_allclose(kp * (PANDA.home - q), missing, rtol=0.0, atol=2e-3 * np.abs(missing).max())
        np.testing.assert_allclose(out.q[-1], PANDA.home, rtol=0.0, atol=1e-4)
        assert out.q[499] == pytest.approx(PANDA.home, abs=1e-9)

    def test_push_once_more_with_other_gains(self, plant: str) -> None:
        """The second push is as large as the first; the arm, four times as stiff by then, gives way less."""
        made = PLANTS[plant](PANDA, environment=taut.environments.Push(peak=[0.0, 15.0, 0.0], duration=0.5))
        events = [
            taut.Event.push(t=0.2),
            taut.Event(t=1.5, set={"law.kp": 1200.0, "law.kd": 60.0}),
            taut.Event.push(t=2.0),
        ]
        out = run(made, duration=3.0, events=events)
        F = out.extra["F_ext"][:, 1]
        assert not F[:200].any()
        assert not F[750:2000].any()
        np.testing.assert_allclose(F[200:700], F[2000:2500], rtol=0.0, atol=1e-9)
        away = np.abs(out.q - PANDA.home).max(axis=1)
        assert 0.15 < away[2000:].max() / away[200:1500].max() < 0.45

    @pytest.mark.part(1)
    def test_change_what_touches_the_tool(self, plant: str) -> None:
        """The hand lets go: its stiffness and will fall to zero in the run, and its wrench with them."""
        hand = taut.environments.Hand(
            mass=0.3,
            damping=5.0,
            stiffness=200.0,
            motion=taut.environments.Oscillation(amplitude=[0.0, 0.05, 0.0], frequency=2.0),
        )
        let_go = taut.Event(t=1.0, set={"environment.stiffness": 0.0, "environment.motion.amplitude": 0.0})
        made = PLANTS[plant](PANDA, environment=hand)
        out = run(made, duration=3.0, events=[let_go])
        F = np.abs(out.extra["F_ext"][:, 1])
        assert F[:1000].max() > 3.0
        assert F[2500:].max() < 0.02
        assert made.parameters["environment.stiffness"] == 200.0  # events last as long as the run

    def test_that_no_environment_knows_are_refused(self, plant: str) -> None:
        made = PLANTS[plant](PANDA, environment=taut.environments.Environments(push=taut.environments.Push()))
        with refused(taut.errors.UnknownNameError):
            run(made, duration=0.1, events=[taut.Event.push(t=0.05)])
        run(made, duration=0.1, events=[taut.Event.push(t=0.05, peak=[1.0, 0.0, 0.0], of="environment.push")])


def test_the_work_that_was_done_is_a_column(tmp_path: Any) -> None:
    out = run(taut.RigidPlant(PANDA, environment=ENVIRONMENTS["push"]), duration=0.2)
    header = out.to_csv(tmp_path / "run.csv").read_text().splitlines()[0]
    assert "extra.work.environment" in header
    work = np.cumsum(
        [0.0]
        + [
            0.5e-3 * F @ taut.snapshot(PANDA, q).J() @ (v + v_end)
            for F, q, v, v_end in zip(out.extra["F_ext"][:-1], out.q[:-1], out.v[:-1], out.v[1:], strict=True)
        ]
    )
    np.testing.assert_allclose(out.extra["work.environment"], work, rtol=1e-10, atol=1e-14)


def test_an_environment_that_goes_wrong_in_mujoco_is_told() -> None:
    class Wild(taut.environments.Environment):
        def start(self, T_WE: taut.Pose) -> dict[str, Any]:
            return {"n": np.ones(())}

        def wrench(self, T: Any, V: Any, t: Any, memory: Any, p: Any, dt: Any) -> tuple[Any, dict[str, Any]]:
            return taut.math.array([0.0] * 6), {"n": memory["n"] * 1e300}

    ctrl = taut.compile(taut.laws.GravityPID(kp=1.0, kd=1.0), PANDA)
    out = taut.run(ctrl, taut.MujocoPlant(PANDA, environment=Wild()), duration=0.1)
    assert "gave numbers that are not finite" in out.outcome.message
    with refused(taut.errors.UsageError):
        taut.MujocoPlant(PANDA, environment=3.0)  # type: ignore[arg-type]
