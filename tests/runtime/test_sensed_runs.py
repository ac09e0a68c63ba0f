"""Sensors and sensing in runs: one pipeline on every engine and plant, recorded as the law saw it, stopped by NaN."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from runtime_laws import TINY, Array, HandPlant, Seen, TorqueOf, seen

import taut
from taut.base.paths import subtree
from taut.codegen.noise import Noise, noise_block
from taut.loop import check_fit

ARM = taut.load_arm("planar2")
LOOSE = taut.laws.PID(kp=1.0, kd=0.01)
SWAY = taut.trajectories.Sine(center=[0.2, -0.1], amplitude=[1.0, 2.0], frequency=3.0)
PD = taut.laws.PID(kp=[40.0, 20.0], kd=[8.0, 4.0])
POOR = taut.sensors.Sensors(
    position=taut.sensors.Encoder(resolution=1e-4, noise=2e-4, offset=0.01),
    velocity=taut.sensors.Tachometer(noise=0.01, offset=0.02),
)
SENSINGS: dict[str, taut.Sensing] = {
    "measured": taut.Sensing(),
    "low-pass": taut.Sensing(velocity=taut.sensors.LowPass(cutoff=[30.0, 40.0], order=2)),
    "difference": taut.Sensing(velocity="difference"),
    "difference and low-pass": taut.Sensing(velocity=taut.sensors.Difference(cutoff=30.0)),
    "kalman": taut.Sensing(velocity=taut.sensors.Kalman(acceleration_noise=30.0, position_noise=[1e-3, 5e-4])),
    "notch": taut.Sensing(
        velocity=taut.sensors.Difference(cutoff=60.0, order=2), notch=taut.sensors.Notch(frequency=18.0, width=4.0)
    ),
}
every = pytest.mark.parametrize("sensing", SENSINGS.values(), ids=SENSINGS)
engines = pytest.mark.parametrize("engine", ["native", "float"])


class SeenV(taut.Law):
    """The reference's torque, and what the law sees of positions and velocities."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(wanted=ref.a, q=x.q * TINY, v=x.v * TINY)


class Motors(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=10.0 * (ref.q - x.q_motor) - x.v_motor)


class Tip(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=10.0 * (ref.q - x.q) + 0.1 * x.a_tip[:2])


class Forces(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=0.1 * x.tau_meas, F=x.J().T @ x.F_ext)


# -------------------------------------------------------------------- one pipeline


@every
def test_the_fused_loop_is_the_float_loop(sensing: taut.Sensing) -> None:
    runs = []
    for engine in ("native", "float"):
        ctrl = taut.compile(PD, ARM, sensing=sensing, engine=engine)  # type: ignore[arg-type]
        runs.append(taut.run(ctrl, taut.RigidPlant(ARM, sensors=POOR), SWAY, duration=0.1, seed=4))
    fused, plain = runs
    for name, column in plain.arrays().items():
        np.testing.assert_allclose(fused.arrays()[name], column, rtol=0.0, atol=1e-9, err_msg=name)


@every
@engines
def test_a_fused_loop_a_hosted_run_and_ones_own_steps_see_the_same(sensing: taut.Sensing, engine: Any) -> None:
    plant = taut.RigidPlant(ARM, sensors=POOR, adds=("gravity",))
    ctrl = taut.compile(SeenV(), ARM, sensing=sensing, adds=plant.adds, engine=engine)
    out = taut.run(ctrl, plant, SWAY, duration=0.05, seed=5, v0=[0.3, -0.2])
    numbers = dict(taut.Loop(ctrl, plant, SWAY, duration=0.05).parameters)
    # The same noise, drawn by hand from the run's seed.
    block = noise_block({"q": (2,), "v": (2,)})
    Noise(block, "float").fill(rows := np.zeros((51, block.size)), 0, 5)
    noise = subtree(block.views(rows), "noise")
    memory = plant.start(out.q[0], out.v[0], numbers, ctrl.dt)
    for k in range(51):
        drawn = {name: rows[k] for name, rows in noise.items()}
        measured = plant.measure(memory, drawn, numbers)
        given = [measured["q"], *([measured["v"]] if sensing.needs_velocity else [])]
        tau = ctrl.step(*given, ref=SWAY.at(k * ctrl.dt))
        for name in ("q", "v"):
            scale = max(1.0, float(np.abs(seen(out, name)[k]).max()))
            np.testing.assert_allclose(ctrl.terms[name] / TINY, seen(out, name)[k], rtol=0.0, atol=1e-9 * scale)
        memory = plant.advance(plant.command(tau, memory, k * ctrl.dt), numbers, ctrl.dt)
    hand = HandPlant()
    hosted = taut.run(
        taut.compile(SeenV(), ARM, sensing=sensing, adds=hand.adds, engine=engine), hand, SWAY, duration=0.05
    )
    again = taut.compile(SeenV(), ARM, sensing=sensing, adds=hand.adds, engine=engine)
    for k in range(len(hosted)):
        given = [hosted.q[k], *([hosted.v[k]] if sensing.needs_velocity else [])]
        again.step(*given, ref=SWAY.at(hosted.t[k]))
        np.testing.assert_allclose(again.terms["v"], hosted.terms["v"][k], rtol=0.0, atol=1e-9 * TINY * 100.0)


@every
@pytest.mark.parametrize("hosted", [False, True], ids=["fused", "hosted"])
def test_the_source_of_a_stream_sees_what_the_law_sees(sensing: taut.Sensing, hosted: bool) -> None:
    plant: Any = HandPlant() if hosted else taut.RigidPlant(ARM, sensors=POOR)
    asked: list[tuple[Array, Array]] = []

    def source(x: taut.Snapshot) -> taut.JointMotion:
        asked.append((np.array(x.q), np.array(x.v)))
        return taut.JointMotion(q=x.q, a=[3.0, -1.0])

    ctrl = taut.compile(SeenV(), ARM, sensing=sensing, adds=plant.adds)
    events = (
        []
        if sensing.velocity == "difference"
        else [
            taut.Event(t=0.01, set={path: values / 2.0})
            for path, values in ctrl.parameters.items()
            if path.startswith("sensing.")
        ]
    )
    out = taut.run(
        ctrl, plant, taut.stream(period=0.003, source=source), duration=0.03, v0=[0.3, -0.2], events=events
    )
    for i, name in enumerate(("q", "v")):
        wanted = seen(out, name)[::3]
        np.testing.assert_allclose(
            np.array([x[i] for x in asked]), wanted, rtol=0.0, atol=1e-9 * np.abs(wanted).max()
        )


def test_what_sensing_does_is_the_same_in_mujoco() -> None:
    sensing = SENSINGS["notch"]
    plant = taut.MujocoPlant(ARM)
    out = taut.run(taut.compile(SeenV(), ARM, sensing=sensing), plant, SWAY, duration=0.05, v0=[0.4, 0.1])
    ctrl = taut.compile(SeenV(), ARM, sensing=sensing)
    for k in range(len(out)):
        ctrl.step(out.q[k], SWAY.at(out.t[k]))
        np.testing.assert_allclose(ctrl.terms["v"] / TINY, seen(out, "v")[k], rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(out.extra["sensed.v"], seen(out, "v"))
    np.testing.assert_array_equal(out.extra["sensed.q"], seen(out, "q"))


# -------------------------------------------------------------------- the record


class TestARecord:
    def test_has_what_the_law_saw_where_it_is_not_the_truth(self) -> None:
        for sensing, sensors, columns in (
            (taut.Sensing(), taut.sensors.Sensors(), set()),
            (taut.Sensing(), POOR, {"sensed.q", "sensed.v"}),
            (SENSINGS["difference"], taut.sensors.Sensors(), {"sensed.v"}),
            (SENSINGS["notch"], taut.sensors.Sensors(), {"sensed.q", "sensed.v"}),
            (
                taut.Sensing(),
                taut.sensors.Sensors(torque=taut.sensors.TorqueSensor(bias=1.0)),
                set(),
            ),  # which this law does not use
            (taut.Sensing(), taut.sensors.Sensors(position=taut.sensors.Encoder(side="motor")), {"sensed.q"}),
        ):
            ctrl = taut.compile(SeenV(), ARM, sensing=sensing)
            out = taut.run(ctrl, taut.RigidPlant(ARM, sensors=sensors), SWAY, duration=0.02)
            assert {name for name in out.extra if name.startswith("sensed.")} == columns
            for name in columns:
                np.testing.assert_array_equal(out.extra[name], seen(out, name.removeprefix("sensed.")))
        ctrl = taut.compile(Seen(), ARM)
        biased = taut.sensors.Sensors(torque=taut.sensors.TorqueSensor(bias=1.0, side="motor"))
        out = taut.run(ctrl, taut.RigidPlant(ARM, sensors=biased), SWAY, duration=0.02)
        np.testing.assert_allclose(out.extra["sensed.tau_meas"][1:], out.tau[:-1] + 1.0)

    @engines
    def test_of_a_hosted_run_has_it_too(self, engine: Any) -> None:
        plant = HandPlant()
        ctrl = taut.compile(SeenV(), ARM, sensing=SENSINGS["difference"], adds=plant.adds, engine=engine)
        out = taut.run(ctrl, plant, SWAY, duration=0.02)
        assert set(out.extra) == {"mass", "sensed.v"}
        np.testing.assert_array_equal(out.extra["sensed.v"], seen(out, "v"))

    def test_keeps_it_in_every_file(self, tmp_path: Path) -> None:
        sensors = taut.sensors.Sensors(
            position=taut.sensors.Encoder(resolution=1e-3), tip=taut.sensors.Accelerometer(range=30.0)
        )
        ctrl = taut.compile(Tip(), ARM)
        out = taut.run(ctrl, taut.RigidPlant(ARM, sensors=sensors), SWAY, duration=0.02)
        again = taut.load_run(out.save(tmp_path / "run.mcap"))
        for name in ("sensed.q", "sensed.a_tip", "saturated.a_tip"):
            np.testing.assert_array_equal(again.extra[name], out.extra[name])
        lines = out.to_csv(tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()
        header = " ".join(lines[:2])
        for word in ("extra.sensed.q.0", "extra.sensed.a_tip.2"):
            assert word in header


# -------------------------------------------------------------------- parameters


@pytest.mark.part(1)
@every
@engines
def test_its_numbers_change_in_a_run_without_a_compile(
    sensing: taut.Sensing, engine: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    ctrl = taut.compile(PD, ARM, sensing=sensing, engine=engine)
    loop = taut.Loop(ctrl, taut.RigidPlant(ARM, sensors=POOR), SWAY, duration=0.02)
    plain = taut.run(loop)
    monkeypatch.setattr("taut.codegen.loop.compiled", lambda *_: pytest.fail("compiled again"))
    monkeypatch.setattr("taut.codegen.loop.trace", lambda *_: pytest.fail("traced again"))
    paths = [path for path in loop.parameters if path.startswith(("sensing.", "sensors."))]
    assert len(paths) == 5 + len(sensing.parameters())
    for path in paths:
        before = loop.parameters[path]
        event = taut.Event(t=0.01, set={path: 0.5 * before})
        out = taut.run(loop, events=[event])
        np.testing.assert_array_equal(out.q[:11], plain.q[:11])
        seen_v = path.startswith("sensors.velocity") and not sensing.needs_velocity
        assert (np.abs(out.q[-1] - plain.q[-1]).max() > 1e-12) != seen_v, path
        loop.parameters[path] = 0.5 * before
        assert (np.abs(taut.run(loop).q[-1] - plain.q[-1]).max() > 1e-12) != seen_v, path
        loop.parameters[path] = before


def test_what_they_cannot_be_is_refused_before_a_run() -> None:
    ctrl = taut.compile(PD, ARM, sensing=SENSINGS["difference and low-pass"])
    plant = taut.RigidPlant(ARM, sensors=POOR)
    for path, value in (
        ("sensing.velocity.cutoff", 500.0),
        ("sensors.position.resolution", 0.0),
    ):  # fmt: skip
        for run in (
            lambda p=path, x=value: taut.run(
                ctrl, plant, SWAY, duration=0.02, events=[taut.Event(t=0.0, set={p: x})]
            ),
            lambda p=path, x=value: taut.Loop(ctrl, plant, SWAY, duration=0.02).parameters.__setitem__(p, x),
        ):
            with refused(taut.errors.RangeError):
                run()


# -------------------------------------------------------------------- a plant that lacks a sensor


LACKS: list[tuple[taut.Law, taut.sensors.Sensors]] = [
    (PD, taut.sensors.Sensors(velocity=None)),
    (Seen(), taut.sensors.Sensors(torque=None)),
    (Motors(), taut.sensors.Sensors()),
    (Motors(), taut.sensors.Sensors(motor=taut.sensors.Encoder())),
    (Tip(), taut.sensors.Sensors()),
    (Forces(), taut.sensors.Sensors()),
    (Forces(), taut.sensors.Sensors(wrench=None)),
]  # fmt: skip


@pytest.mark.parametrize(("law", "sensors"), LACKS, ids=range(len(LACKS)))
def test_a_sensor_that_is_missing_is_named_with_what_would_give_it(
    law: taut.Law, sensors: taut.sensors.Sensors
) -> None:
    with refused(taut.errors.MatchError):
        check_fit(taut.compile(law, ARM, engine="float").side, taut.RigidPlant(ARM, sensors=sensors))


@every
def test_an_arm_without_tachometers_runs_where_sensing_makes_velocities(sensing: taut.Sensing) -> None:
    bare = taut.sensors.Sensors(velocity=None, torque=None)
    ctrl = taut.compile(PD, ARM, sensing=sensing)
    if sensing.needs_velocity:
        with refused(taut.errors.MatchError):
            taut.run(ctrl, taut.RigidPlant(ARM, sensors=bare), SWAY, duration=0.02)
        return
    whole, without = (
        taut.run(ctrl, taut.RigidPlant(ARM, sensors=sensors), SWAY, duration=0.02)
        for sensors in (taut.sensors.Sensors(), bare)
    )
    np.testing.assert_array_equal(without.q, whole.q)


@engines
def test_a_law_that_uses_no_velocity_needs_no_tachometer(engine: Any) -> None:
    bare = taut.RigidPlant(ARM, sensors=taut.sensors.Sensors(velocity=None))
    out = taut.run(taut.compile(TorqueOf(), ARM, engine=engine), bare, SWAY, duration=0.02)
    assert out.outcome.ok


# -------------------------------------------------------------------- NaN


class Fails:
    """A rigid plant whose sensor of one measurement gives no number once the second joint is beyond 0.5 rad."""

    def __init__(self, name: str, **options: Any) -> None:
        self._plant, self._name = taut.RigidPlant(ARM, **options), name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def measure(self, memory: Mapping[str, Any], noise: Mapping[str, Any], parameters: Mapping[str, Any]) -> Any:
        out = self._plant.measure(memory, noise, parameters)
        wrong = 1e-300 * taut.math.log(0.5 - memory["q"][1])
        entries = [*out[self._name]]
        entries[-1] = entries[-1] + wrong
        return {**out, self._name: taut.math.array(entries)}


class Loses(HandPlant):
    """A plant in plain Python whose sensor gives no number in one tick."""

    def measure(self) -> dict[str, Array]:
        out = super().measure()
        out["q"][1] = np.nan if self.ticks == 7 else out["q"][1]
        return out


ALL = taut.sensors.Sensors(
    motor=taut.sensors.Encoder(), motor_velocity=taut.sensors.Tachometer(), tip=taut.sensors.Accelerometer()
)


@engines
@pytest.mark.parametrize(
    ("law", "name", "who"),
    [
        (LOOSE, "q", "q[1] (joint 'joint2')"),
        (LOOSE, "v", "v[1] (joint 'joint2')"),
        (Motors(), "q_motor", "q_motor[1] (joint 'joint2')"),
        (Tip(), "a_tip", "a_tip[2]"),
    ],
)
def test_a_sensor_that_gives_nan_ends_a_fused_run_by_its_name(
    law: taut.Law, name: str, who: str, engine: Any
) -> None:
    if name == "a_tip":

        class Whole(taut.Law):
            def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
                return taut.Torque(P=x.a_tip[2] + 0.0 * ref.q)

        law = Whole()
    plant: Any = Fails(name, sensors=ALL, adds=("gravity",), friction=None)
    sensing = taut.Sensing() if name == "v" else taut.Sensing(velocity=taut.sensors.Difference(cutoff=30.0))
    ctrl = taut.compile(law, ARM, sensing=sensing, adds=plant.adds, engine=engine)
    out = taut.run(ctrl, plant, taut.JointMotion(q=[0.0, 0.0]), duration=0.5, q0=[0.0, 0.35], v0=[0.0, 20.0])
    k = len(out)
    assert 3 < k < 30
    assert out.outcome.kind == "diverged"
    assert out.outcome.tick == k - 1
    assert out.outcome.message == f"{who} must be finite; got nan in tick {k} (t = {k * 1e-3:.6g} s)"
    assert out.outcome.joint == ("joint2" if "joint" in who else None)
    assert all(np.isfinite(column).all() for column in out.arrays().values())
    assert out.q[-1, 1] < 0.5


@engines
@every
def test_a_sensor_that_gives_nan_ends_a_hosted_run_by_its_name(sensing: taut.Sensing, engine: Any) -> None:
    plant = Loses()
    ctrl = taut.compile(PD, ARM, sensing=sensing, adds=plant.adds, engine=engine)
    out = taut.run(ctrl, plant, SWAY, duration=0.05)
    assert (len(out), out.outcome.kind, out.outcome.tick, out.outcome.joint) == (7, "diverged", 6, "joint2")
    assert out.outcome.message == "q[1] (joint 'joint2') must be finite; got nan in tick 7 (t = 0.007 s)"
    assert all(np.isfinite(column).all() for column in out.arrays().values())
