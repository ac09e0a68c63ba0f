"""Wrist sensors in runs: nothing sags, contact is told from load, and a sensor that fails ends the run in words."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runtime_laws import Array, HandPlant

import taut
from taut.maths import dynamics as dyn
from taut.maths.model import model_of

G = 9.81
ARM = taut.load_arm("planar3")
TOOL = taut.Payload(mass=0.4, com=(0.0, 0.0, 0.03))
BIAS = np.array([2.0, -1.0, 3.0, 0.1, 0.0, -0.2])
LOAD = {"mass": 1.0, "com": (0.02, 0.0, 0.05)}
HELD = {f"model.payload.{name}": value for name, value in LOAD.items()}
engines = pytest.mark.parametrize("engine", ["native", "float"])
kinds = pytest.mark.parametrize("kind", ["rigid", "mujoco"])


class Soft(taut.Law):
    """GravityPID with small gains, which also asks for the wrench so that a run records it."""

    kp: taut.Gain = taut.Gain(2.0)  # [N m/rad]
    kd: taut.Gain = taut.Gain(1.0)  # [N m s/rad]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        none = 0.0 * x.q + 0.0 * x.F_ext[0]
        return taut.Torque(P=self.kp @ x.difference(ref.q), D=-(self.kd @ x.v), gravity=x.g, none=none)


class Pull(taut.environments.Environment):
    """A constant force at the tool, in world axes."""

    F: taut.environments.Field = taut.environments.Field((0.0,) * 6, unit="N, N m", shape=6)

    def wrench(
        self, T_WE: taut.Pose, twist: Array, t: Any, memory: Mapping[str, Any], parameters: Mapping[str, Any], dt: Any
    ) -> tuple[Array, dict[str, Any]]:
        return parameters["F"], {}


def plant_of(kind: str, arm: taut.Arm, scene: str | None = None, **wrench: Any) -> Any:
    sensors = taut.sensors.Sensors(wrench=taut.sensors.WrenchSensor(tool=TOOL, bias=BIAS, **wrench))
    if kind == "rigid":
        return taut.RigidPlant(arm, sensors=sensors, environment=Pull())
    return taut.MujocoPlant(arm, sensors=sensors, scene=scene)


def sensing(**more: Any) -> taut.Sensing:
    return taut.Sensing(wrist=taut.sensors.Wrist(bias=BIAS, mass=TOOL.mass, com=TOOL.com, **more))


# -------------------------------------------------------------------- what the tool carries


@pytest.mark.part(1)
@kinds
@pytest.mark.parametrize("name", ["planar3", "panda"])
def test_a_payload_that_the_model_knows_neither_sags_nor_shows_as_contact(name: str, kind: str) -> None:
    arm = taut.load_arm(name)
    laden = arm.with_payload(**LOAD)  # type: ignore[arg-type]
    plant = plant_of(kind, laden)
    law = Soft(kp=5.0, kd=2.0) if name == "planar3" else taut.laws.GravityPID(kp=5.0, kd=2.0) + Touched()
    hold = taut.JointMotion(q=arm.home)
    known, unknown = (
        taut.run(taut.compile(law, model, sensing=sensing()), plant, hold, duration=0.5) for model in (laden, arm)
    )
    assert np.abs(known.q - arm.home).max() < 1e-9
    np.testing.assert_allclose(known.extra["sensed.F_ext"], 0.0, atol=1e-9)
    # Not told, it sags, and the wrist feels the payload's weight as what pulls at the arm.
    assert np.abs(unknown.q[-1] - arm.home).max() > 0.02
    np.testing.assert_allclose(unknown.extra["sensed.F_ext"][0], weight(arm, arm.home), atol=1e-9)


class Touched(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(none=0.0 * x.q + 0.0 * x.F_ext[0])


def weight(arm: taut.Arm, q: Array) -> Array:
    """By hand: the payload's weight and its moment about the tool's origin, in world axes."""
    f = LOAD["mass"] * arm.gravity  # type: ignore[operator]
    return np.concatenate([f, np.cross(taut.snapshot(arm, q).T().R @ np.array(LOAD["com"]), f)])


@kinds
def test_a_payload_that_is_taken_in_the_run_is_one_number_for_joints_and_wrist(kind: str) -> None:
    plant = plant_of(kind, ARM)
    there = {f"plant.payload.{name}": value for name, value in LOAD.items()}
    events = [taut.Event(t=0.1, set={**there, **HELD}), taut.Event(t=0.3, set=dict.fromkeys(
        ("plant.payload.mass", "model.payload.mass"), 0.0))]  # fmt: skip
    out = taut.run(
        taut.compile(Soft(), ARM, sensing=sensing()), plant, duration=0.4, q0=[0.3, 0.4, -0.2], events=events
    )
    assert out.outcome.ok
    assert np.abs(out.q - out.q[0]).max() < 1e-9
    np.testing.assert_allclose(out.extra["sensed.F_ext"], 0.0, atol=1e-9)


@kinds
def test_a_mass_that_hangs_on_the_tool_is_contact_whatever_the_tool_carries(kind: str) -> None:
    arm = taut.load_arm("panda").with_payload(**LOAD)  # type: ignore[arg-type]
    x, y, z = taut.snapshot(arm, arm.home).T().p
    ball = f"""<body name="ball" pos="{x} {y} {z}"><freejoint/><geom size="0.03" mass="1.5" contype="0" conaffinity="0"/>
               </body><equality><weld body1="payload" body2="ball" relpose="0 0 0 1 0 0 0" solref="0.002 1"/></equality>"""
    plant = plant_of(kind, arm, scene=ball)
    events = [taut.Event(t=0.0, set={"environment.F": [0, 0, -1.5 * G, 0, 0, 0]})] if kind == "rigid" else []
    law = taut.laws.GravityPID(kp=[600, 600, 600, 600, 250, 150, 50], kd=[50, 50, 50, 50, 30, 20, 5]) + Touched()
    ctrl = taut.compile(law, arm, sensing=sensing())
    out = taut.run(ctrl, plant, taut.JointMotion(q=arm.home), duration=2.0, events=events)
    np.testing.assert_allclose(out.extra["sensed.F_ext"][-1], [0, 0, -1.5 * G, 0, 0, 0], atol=2e-3)
    # The joints say the same: what the law gives beyond gravity holds that weight.
    J = dyn.jacobian(model_of(arm), out.q[-1])
    np.testing.assert_allclose(out.terms["P"][-1], -J.T @ out.extra["F_ext"][-1], atol=2e-2)  # fmt: skip


@kinds
def test_inertia_of_the_tool_stays_in_as_the_docs_say(kind: str) -> None:
    plant = plant_of(kind, ARM)
    ctrl = taut.compile(Soft(), ARM, sensing=sensing())
    out = taut.run(ctrl, plant, taut.JointMotion(q=[0.0] * 3), v0=[2.0, -3.0, 1.0], duration=0.05)
    p = np.array([taut.snapshot(ARM, q).T().act(TOOL.com) for q in out.q])
    a = (p[2:] - 2.0 * p[1:-1] + p[:-2]) * 1e6  # of the tool's centre, by differences
    felt = out.extra["sensed.F_ext"][2:, :3]
    wanted = -TOOL.mass * a
    assert np.abs(wanted).max() > 1.0
    assert np.abs(felt - wanted).max() < 0.02 * np.abs(wanted).max()


@pytest.mark.part(1)
@kinds
@pytest.mark.parametrize(("D", "holds"), [((4.0, 0.02), True), ((4.0, 0.2), False)])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_an_inertia_far_above_the_arms_own_makes_the_tools_inertia_a_loop_as_the_docs_say(
    D: tuple[float, float], holds: bool, kind: str
) -> None:
    panda, gripper = taut.load_arm("panda"), taut.Payload(mass=0.73, com=(0.01, 0.0, 0.06))
    sensors = taut.sensors.Sensors(wrench=taut.sensors.WrenchSensor(noise=(0.1, 0.005), tool=gripper))
    plant: Any = (taut.RigidPlant if kind == "rigid" else taut.MujocoPlant)(panda, friction=None, sensors=sensors)
    known = taut.Sensing(wrist=taut.sensors.Wrist(mass=gripper.mass, com=gripper.com))
    law = taut.laws.Impedance(K=(400.0, 30.0), zeta=1.0, D=D)
    out = taut.run(taut.compile(law, panda, sensing=known), plant, duration=0.5)
    off = max(np.linalg.norm(taut.snapshot(panda, q).T().p - taut.snapshot(panda, panda.home).T().p) for q in out.q)
    assert (off < 1e-3) == holds, off
    if not holds:
        assert off > 0.05


# -------------------------------------------------------------------- faults


class Faulty:
    """A rigid plant whose wrist sensor fails after some time, as a pure function."""

    def __init__(self, fault: str, after: float) -> None:
        sensors = taut.sensors.Sensors(wrench=taut.sensors.WrenchSensor(tool=TOOL, bias=BIAS, noise=(0.1, 0.01)))
        self._plant = taut.RigidPlant(ARM, sensors=sensors, environment=Pull())
        self._fault, self._after = fault, after

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def measure(self, memory: Mapping[str, Any], noise: Mapping[str, Any], parameters: Mapping[str, Any]) -> Any:
        with np.errstate(all="ignore"):
            return self._failing(self._plant.measure(memory, noise, parameters), memory)

    def _failing(self, out: Mapping[str, Any], memory: Mapping[str, Any]) -> Any:
        tm, late = taut.math, memory["t"] > self._after
        F = out["F_ext"]
        if self._fault == "nan":  # of one entry
            wrong = 1e-300 * tm.log(tm.where(late, -1.0, 1.0))
            return {**out, "F_ext": tm.array([*F[:2], F[2] + wrong, *F[3:]])}
        return {**out, "F_ext": tm.array([*F[:5], F[5] + tm.exp(tm.where(late, 1e4, 0.0))])}


class FaultyHand(HandPlant):
    """The same as an engine or a robot: a state of its own, in plain Python."""

    def __init__(self, fault: str, after: int) -> None:
        super().__init__(n=3, measures="v F_ext")
        self._fault, self._after = fault, after
        self.distorts = frozenset({"F_ext"})

    def reset(self, q: Array, v: Array, dt: float, seed: int = 0) -> None:
        super().reset(q, v, dt, seed)
        self._rng = np.random.default_rng(seed)

    def measure(self) -> dict[str, Array]:
        F = 0.1 * self._rng.standard_normal(6)
        if self.ticks > self._after:
            R = taut.snapshot(self.arm, self.q).T().R
            if self._fault == "nan":
                F[2] = np.nan
            elif self._fault == "inf":
                F[5] = np.inf
            else:
                F[:3] += 300.0 * R[:, 0]
        return {**super().measure(), "F_ext": F}


FILTERED = taut.Sensing(wrist=sensing().wrist, F_ext=taut.sensors.LowPass(cutoff=30.0))
WORDS = {
    "nan": "F_ext[2] must be finite; got nan in tick {k}",
    "inf": "F_ext[5] must be finite; got inf in tick {k}",
}


@pytest.mark.part(1)
@engines
@pytest.mark.parametrize("hosted", [False, True], ids=["fused", "hosted"])
@pytest.mark.parametrize("fault", WORDS)
def test_a_sensor_that_fails_in_mid_run_ends_it_in_words_and_nothing_is_lost(
    fault: str, hosted: bool, engine: Any, tmp_path: Path
) -> None:
    plant: Any = FaultyHand(fault, after=20) if hosted else Faulty(fault, after=0.0205)
    whole: Any = FaultyHand("nan", after=1000) if hosted else Faulty("nan", after=1000.0)
    ctrl = taut.compile(Soft(), ARM, sensing=FILTERED, adds=plant.adds, engine=engine)
    hold = taut.trajectories.Sine(center=[0.2, 0.1, 0.0], amplitude=[0.3, 0.2, 0.1], frequency=2.0)
    out = taut.run(ctrl, plant, hold, duration=0.08, v0=[1.0, 0.5, -0.3], log=tmp_path / "run.mcap")
    k = 21  # the first bad reading
    words = WORDS[fault].format(k=k)
    assert out.outcome.kind == "diverged"
    assert out.outcome.message == f"{words} (t = {k * 1e-3:.6g} s)"
    assert (len(out), out.outcome.tick, out.outcome.joint) == (k, k - 1, None)
    assert all(np.isfinite(column).all() for column in out.arrays().values())
    # What came before is what a run without the fault has, in memory and in the log that was written meanwhile.
    good = taut.run(ctrl, whole, hold, duration=0.08, v0=[1.0, 0.5, -0.3])
    np.testing.assert_array_equal(out.q[:21], good.q[:21])
    again = taut.load_run(tmp_path / "run.mcap")
    np.testing.assert_array_equal(again.q, out.q)
    assert again.outcome.message == out.outcome.message
    if hosted:
        assert len(plant.commands) == k  # none in the tick whose reading was bad


@engines
@pytest.mark.parametrize("hosted", [False, True], ids=["fused", "hosted"])
def test_a_sensor_that_is_dead_from_the_start_ends_the_run_before_its_first_tick(hosted: bool, engine: Any) -> None:
    plant: Any = FaultyHand("nan", after=-1) if hosted else Faulty("nan", after=-1.0)
    ctrl = taut.compile(Soft(), ARM, sensing=FILTERED, adds=plant.adds, engine=engine)
    out = taut.run(ctrl, plant, taut.JointMotion(q=[0.0] * 3), duration=0.08)
    assert (len(out), out.outcome.tick) == (0, -1)
    assert out.outcome.message == "F_ext[2] must be finite; got nan in tick 0 (t = 0 s)"


@engines
def test_the_end_of_the_range_is_told_where_the_controller_alone_knows_it(engine: Any) -> None:
    plant = FaultyHand("saturated", after=20)
    wrist = taut.sensors.Wrist(range=(300.0, 20.0))
    ctrl = taut.compile(Soft(), ARM, sensing=taut.Sensing(wrist=wrist), adds=plant.adds, engine=engine)
    out = taut.run(ctrl, plant, taut.JointMotion(q=[0.0] * 3), duration=0.05)
    told = out.extra["saturated.F_ext"]
    assert out.outcome.ok
    n = int(told.sum())
    assert 5 < n < 30  # the noise takes it below its end in some
    first = int(np.flatnonzero(told)[0])
    assert first >= 21
    assert out.outcome.message == (
        f"completed: 51 ticks, 0.05 s; the sensor of F_ext was at its range in {n} of 51 ticks, first at "
        f"t = {first * 1e-3:.6g} s"
    )


@pytest.mark.part(1)
@kinds
@engines
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_plant_and_controller_agree_on_the_end_of_the_range(kind: str, engine: Any) -> None:
    plant = plant_of(kind, ARM.with_payload(20.0), range=(100.0, 50.0))
    law = Soft(kp=300.0, kd=30.0)
    ctrl = taut.compile(law, ARM.with_payload(20.0), sensing=sensing(range=(100.0, 50.0)), engine=engine)
    out = taut.run(ctrl, plant, taut.JointMotion(q=[0.5, 0.5, 0.5]), q0=[0.5, 0.5, 0.5], duration=0.05)
    assert out.extra["saturated.F_ext"].all()
    alone = taut.run(
        ctrl, plant_of(kind, ARM.with_payload(20.0)), taut.JointMotion(q=[0.5] * 3), q0=[0.5] * 3, duration=0.05
    )
    assert alone.extra["saturated.F_ext"].all()


@engines
def test_the_source_of_a_stream_sees_contact_alone_too(engine: Any) -> None:
    seen: list[Array] = []

    def source(x: taut.Snapshot) -> taut.JointMotion:
        seen.append(np.array(x.F_ext))
        return taut.JointMotion(q=[0.3, 0.4, -0.2])

    ctrl = taut.compile(Soft(), ARM, sensing=sensing(), engine=engine)
    out = taut.run(
        ctrl, plant_of("rigid", ARM), taut.stream(period=0.01, source=source), q0=[0.3, 0.4, -0.2], duration=0.03,
        events=[taut.Event(t=0.0, set={"environment.F": [0.0, 0.0, 5.0, 0.0, 0.0, 0.0]})],
    )  # fmt: skip
    np.testing.assert_allclose(seen, out.extra["sensed.F_ext"][::10], rtol=0.0, atol=1e-12)
    assert np.abs(seen[0] - [0.0, 0.0, 5.0, 0.0, 0.0, 0.0]).max() < 1e-12
