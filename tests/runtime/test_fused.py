"""A fused run is what a hand-written loop of controller and plant gives, tick by tick, on whatever engine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runtime_laws import Array, Pushed, Seen, Spring, TorqueOf, seen

import taut
from taut.codegen import loop as codegen_loop
from taut.codegen import native
from taut.control.tasks.feed import ReferenceFeed
from taut.record.plain import plain

# The same formulas in the same order but for the compiler's: relative to the largest number of the column.
SAME = 1e-12

PLANAR = taut.load_arm("planar2")
PANDA = taut.load_arm("panda")


def wave(arm: taut.Arm) -> taut.trajectories.Sine:
    return taut.trajectories.Sine(center=arm.home, amplitude=0.1, frequency=np.linspace(0.5, 1.5, arm.n))


def by_hand(
    ctrl: taut.Controller, plant: taut.RigidPlant, ref: Any, ticks: int, q0: Array, v0: Array
) -> dict[str, Array]:
    """The loop that a person would write, on plain floats."""
    dt, own = ctrl.dt, plant.parameters
    memory = plant.start(np.array(q0), np.array(v0), own, dt)
    rows: dict[str, list[Array]] = {name: [] for name in ("q", "v", "command", "tau")}
    for k in range(ticks):
        measured = plant.measure(memory, {}, own)
        forces = {name: measured[name] for name in ctrl.needs if name != "v"}
        v = (measured["v"],) if ctrl.side.sensing.needs_velocity else ()
        command = ctrl.step(measured["q"], *v, ref=ref.at(k * dt), **forces)
        after = plant.command(command, memory, k * dt)
        after = plant.advance(after, own, dt / plant.substeps)
        tau = after["tau"]
        for _ in range(plant.substeps - 1):
            after = plant.advance(after, own, dt / plant.substeps)
        for name, value in (("q", memory["q"]), ("v", memory["v"]), ("command", command), ("tau", tau)):
            rows[name].append(np.array(value))
        memory = after
    return {name: np.array(column) for name, column in rows.items()}


Case = tuple[taut.Law, taut.Arm, dict[str, Any], dict[str, Any]]
DRIVES = taut.drives.Actuation(bandwidth=60.0, delay=0.002)
CASES: dict[str, Case] = {
    "PID with integral and limits": (
        taut.laws.PID(kp=300.0, kd=20.0, ki=50.0),
        PLANAR,
        {"limits": taut.Limits(tau=[30.0, 5.0], tau_dot=2e3)},
        {},
    ),
    "computed torque, differenced velocity": (
        taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=10.0),
        PANDA.perturbed(seed=1, mass=0.1),
        {"sensing": taut.Sensing(velocity="difference")},
        {},
    ),
    "gravity, friction, lag and delay": (
        taut.laws.GravityPID(kp=[60.0] * 4 + [2.0] * 3, kd=[6.0] * 4 + [0.1] * 3) + taut.laws.FrictionCompensation(),
        PANDA.with_joints(coulomb=0.3),
        {},
        {"actuation": taut.drives.Actuation(bandwidth=500.0, delay=0.002), "substeps": 3},
    ),
    "feedforward on rk4 with what the plant adds": (
        taut.laws.FeedForward() + taut.laws.PID(kp=50.0, kd=5.0),
        PLANAR.with_payload(1.0, com=[0.0, 0.0, 0.1]),
        {"adds": ("gravity", "coriolis")},
        {"integrator": "rk4", "substeps": 2, "adds": ("gravity", "coriolis")},
    ),
    "a law of one's own with memory, at a spring": (
        Pushed(kp=80.0),
        PLANAR,
        {},
        {"environment": Spring(), "substeps": 2},
    ),
    "velocity drives": (
        taut.laws.VelocityPI(kp=5.0, ki=2.0),
        PLANAR,
        {},
        {"takes": "velocity", "actuation": DRIVES},
    ),
}


@pytest.mark.parametrize("name", CASES)
class TestAFusedRun:
    @pytest.mark.part(2)
    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_is_the_loop_that_a_person_would_write(self, name: str) -> None:
        law, arm, control, options = CASES[name]
        plant = taut.RigidPlant(arm if "perturbed" not in name else PANDA, **options)
        ctrl = taut.compile(law, arm, rate=500.0, **control)
        q0, v0 = arm.home + 0.05, np.full(arm.n, 0.1)
        out = taut.run(ctrl, plant, wave(arm), duration=0.3, q0=q0, v0=v0)
        assert out.outcome.ok
        hand = by_hand(ctrl, plant, wave(arm), len(out), q0, v0)
        for column, expected in hand.items():
            got = getattr(out, column)
            assert np.abs(got - expected).max() <= SAME * np.abs(expected).max(), column

    @pytest.mark.part(2)
    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_is_the_same_in_the_float_engine(self, name: str) -> None:
        law, arm, control, options = CASES[name]
        runs = []
        for engine in ("native", "float"):
            ctrl = taut.compile(law, arm, rate=500.0, engine=engine, **control)
            runs.append(taut.run(ctrl, taut.RigidPlant(arm, **options), wave(arm), duration=0.1))
        native, plain = (run.arrays() for run in runs)
        assert native.keys() == plain.keys()
        for column, expected in plain.items():
            scale = max(np.abs(expected).max(), 1e-3)
            assert np.abs(native[column] - expected).max() <= SAME * scale, column

    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_has_terms_that_add_up_to_the_command(self, name: str) -> None:
        law, arm, control, options = CASES[name]
        ctrl = taut.compile(law, arm, rate=500.0, **control)
        out = taut.run(ctrl, taut.RigidPlant(arm, **options), wave(arm), duration=0.1, q0=arm.home + 0.3)
        total = sum(out.terms.values())
        assert np.abs(total - out.command).max() <= 1e-13 * max(np.abs(term).max() for term in out.terms.values())


class TestTheOrderOfATick:
    """Row k has the state at t[k], what was seen and commanded then, and the torque of the period that follows."""

    def test_in_a_run(self) -> None:
        arm = taut.load_arm("gantry3").with_joints(viscous=0.0)
        push = taut.trajectories.Sine(center=np.zeros(3), amplitude=[1.0, 2.0, 3.0], frequency=3.0)
        ctrl = taut.compile(Seen(), arm, rate=100.0, adds=("gravity",))
        at_motors = taut.sensors.Sensors(torque=taut.sensors.TorqueSensor(side="motor"))
        plant = taut.RigidPlant(arm, adds=("gravity",), sensors=at_motors)
        out = taut.run(ctrl, plant, push, duration=0.2, q0=[0.1, 0.2, 0.3])
        np.testing.assert_array_equal(out.t, np.arange(21) * 0.01)
        np.testing.assert_array_equal(seen(out, "t")[:, 0], out.t)
        np.testing.assert_array_equal(out.q[0], [0.1, 0.2, 0.3])
        np.testing.assert_array_equal(seen(out, "q"), out.q)
        np.testing.assert_array_equal(seen(out, "v"), out.v)
        for k, t in enumerate(out.t):
            np.testing.assert_allclose(out.command[k], push.at(t).a, rtol=0.0, atol=1e-15)
            np.testing.assert_array_equal(seen(out, "ref")[k], push.at(t).q)
            np.testing.assert_array_equal(out.reference.q[k], push.at(t).q)
        np.testing.assert_array_equal(out.tau, out.command)
        np.testing.assert_array_equal(seen(out, "tau")[1:], out.tau[:-1])
        # Semi-implicit Euler: v[k+1] = v[k] + dt tau[k] / m, q[k+1] = q[k] + dt v[k+1].
        masses = np.array([21.0, 9.0, 3.0])
        np.testing.assert_allclose(np.diff(out.v, axis=0), 0.01 * out.tau[:-1] / masses, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(np.diff(out.q, axis=0), 0.01 * out.v[1:], rtol=0.0, atol=1e-14)

    def test_both_ends_are_included(self) -> None:
        ctrl = taut.compile(taut.laws.PID(kp=1.0), PLANAR, rate=1000.0)
        for duration, ticks in ((1.0, 1001), (0.0301, 31), (0.001, 2)):
            assert len(taut.run(ctrl, taut.RigidPlant(PLANAR), duration=duration)) == ticks

    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_the_controller_is_left_alone(self) -> None:
        ctrl = taut.compile(taut.laws.PID(kp=3.0, ki=2.0), PLANAR)
        taut.run(ctrl, taut.RigidPlant(PLANAR), duration=0.1, events=[taut.Event(t=0.0, set={"law.kp": 9.0})])
        assert ctrl.ticks == 0
        assert ctrl.parameters["law.kp"] == 3.0


class TestDefaults:
    def test_are_home_at_rest_and_a_hold_of_the_first_state(self) -> None:
        ctrl = taut.compile(taut.laws.GravityPID(kp=100.0, kd=10.0), PANDA)
        out = taut.run(ctrl, taut.RigidPlant(PANDA), duration=0.1)
        np.testing.assert_array_equal(out.q[0], PANDA.home)
        assert not out.v[0].any()
        np.testing.assert_array_equal(out.reference.q, np.broadcast_to(PANDA.home, out.q.shape))
        np.testing.assert_allclose(out.q, out.reference.q, rtol=0.0, atol=1e-9)
        moved = taut.run(ctrl, taut.RigidPlant(PANDA), duration=0.01, q0=PANDA.home + 0.1)
        np.testing.assert_array_equal(moved.reference.q[-1], PANDA.home + 0.1)

    def test_run_of_a_loop_is_run_of_its_parts(self) -> None:
        ctrl, plant = taut.compile(taut.laws.PID(kp=100.0, kd=10.0), PLANAR), taut.RigidPlant(PLANAR)
        goal = taut.JointMotion(q=[0.1, 0.2])
        of_loop = taut.run(taut.Loop(ctrl, plant, goal, duration=0.5), q0=[0.0, 0.0])
        of_parts = taut.run(ctrl, plant, goal, duration=0.5, q0=[0.0, 0.0])
        np.testing.assert_array_equal(of_loop.q, of_parts.q)
        assert plain(of_loop.info) == plain(of_parts.info)

    def test_the_record_says_how_it_was_made(self) -> None:
        ctrl = taut.compile(taut.laws.PID(kp=1.0), PLANAR, rate=200.0)
        events = [taut.Event(t=0.1, set={"law.kp": 2.0})]
        out = taut.run(ctrl, taut.RigidPlant(PLANAR), duration=0.5, seed=7, events=events)
        info = {
            key: plain(getattr(out.info, key))
            for key in ("rate", "duration", "seed", "law", "arm", "plant", "events")
        }
        assert info == {
            "rate": 200.0,
            "duration": 0.5,
            "seed": 7,
            "law": "PID(kp=1.0)",
            "arm": "planar2",
            "plant": "RigidPlant(planar2)",
            "events": [{"t": 0.1, "set": {"law.kp": 2.0}}],
        }
        assert out.outcome.message == "completed: 101 ticks, 0.5 s"
        assert (out.outcome.ok, out.outcome.tick) == (True, 100)


def test_the_float_engine_runs_a_law_that_cannot_work_with_zeros() -> None:
    """A stiffness that is solved with: what a run records must not be tried out at a gain of zero."""

    class Soft(taut.Law):
        K: taut.Gain  # [rad/(N m)]

        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
            return taut.Torque(P=taut.math.solve(self.K.matrix(2), ref.q - x.q))

    runs = []
    for engine in ("native", "float"):
        ctrl = taut.compile(Soft(K=0.02), PLANAR, engine=engine)  # type: ignore[arg-type]
        runs.append(taut.run(ctrl, taut.RigidPlant(PLANAR), wave(PLANAR), duration=0.05))
    np.testing.assert_allclose(runs[0].q, runs[1].q, rtol=1e-12)


class TestLongRuns:
    def test_cross_the_borders_of_blocks_without_a_seam(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Nine thousand ticks are three blocks; cut otherwise the run is the same to the last bit."""
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=5.0), PLANAR)
        plant, ref = taut.RigidPlant(PLANAR, substeps=2), wave(PLANAR)
        whole = taut.run(ctrl, plant, ref, duration=9.0)
        assert len(whole) > 2 * ReferenceFeed.block
        for block in (1 << 20, 999):
            monkeypatch.setattr(ReferenceFeed, "block", block)
            np.testing.assert_array_equal(taut.run(ctrl, plant, ref, duration=9.0).q, whole.q)

    def test_keep_one_number_per_tick_and_column(self) -> None:
        """A tenth of the ten minutes: what is kept is what is recorded, so that 600 000 ticks stay under 1.5 GB."""
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=5.0), PANDA)
        out = taut.run(ctrl, taut.RigidPlant(PANDA), wave(PANDA), duration=60.0)
        assert len(out) == 60001
        base = {id(array.base) if array.base is not None else id(array): array for array in out.arrays().values()}
        owners = {
            id(a if a.base is None else a.base): (a if a.base is None else a.base).nbytes for a in base.values()
        }
        assert sum(owners.values()) * 10.0 < 0.75e9
        np.testing.assert_allclose(out.q[-1], out.reference.q[-1], atol=1e-3)


class TestALoop:
    def test_is_traced_once_however_often_it_runs(self, monkeypatch: pytest.MonkeyPatch) -> None:
        loop = taut.Loop(taut.compile(taut.laws.PID(kp=50.0), PLANAR), taut.RigidPlant(PLANAR), duration=0.05)
        first = taut.run(loop)
        loop.parameters["law.kp"] = 80.0
        monkeypatch.setattr("taut.codegen.loop.trace", None)  # nothing may be traced any more
        second = taut.run(loop, v0=[0.1, 0.2])
        other = taut.compile(taut.laws.PID(kp=80.0), PLANAR)
        monkeypatch.undo()
        again = taut.run(other, taut.RigidPlant(PLANAR), duration=0.05, v0=[0.1, 0.2])
        np.testing.assert_array_equal(second.tau, again.tau)
        assert not np.array_equal(first.tau, second.tau)

    def test_tells_the_gains_that_it_ran_with(self) -> None:
        ctrl = taut.compile(taut.laws.PID(kp=50.0), PLANAR)
        ctrl.parameters["law.kp"] = 80.0
        assert taut.run(ctrl, taut.RigidPlant(PLANAR), duration=0.01).info.law == "PID(kp=80.0)"


class BreaksLater(taut.Law):
    """From 20 ms on the torque of the second joint is no number."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        wild = taut.math.sqrt(0.0205 - x.t)
        return taut.Torque(P=taut.math.array([x.g[0], x.g[1] + 1e-9 * wild]))


@pytest.mark.parametrize("engine", ["native", "float"])
def test_a_law_that_gives_no_number_is_told_and_not_the_simulation(engine: Any) -> None:
    for plant in (taut.RigidPlant(PLANAR), taut.MujocoPlant(PLANAR)):
        ctrl = taut.compile(BreaksLater(), PLANAR, engine=engine)
        out = taut.run(ctrl, plant, duration=0.1, v0=[3.0, 0.0])
        assert (out.outcome.kind, out.outcome.joint, out.outcome.tick) == ("diverged", "joint2", 20)
        assert "BreaksLater" in out.outcome.message or "the law gives nan for joint 'joint2'" in out.outcome.message
        assert "smaller gains" not in out.outcome.message


def test_code_made_anew_for_longer_runs_is_compared_where_the_first_began(monkeypatch: pytest.MonkeyPatch) -> None:
    """And not where it ended: at numbers like 1e19 rounding alone tells engines apart."""
    compared: list[Array] = []

    def verified(what: str, function: Any, program: Any, samples: Any, name: str = "kernel") -> Any:
        if name != "start":  # which has no memory yet
            compared.append(samples()[0][2].copy())
        return real(what, function, program, samples, name)

    real = codegen_loop.verified
    monkeypatch.setattr(codegen_loop, "verified", verified)
    monkeypatch.setattr(native, "LEVEL", 2)
    ctrl = taut.compile(taut.laws.PID(kp=317.0, kd=20.0), PLANAR)
    loop = taut.Loop(ctrl, taut.RigidPlant(PLANAR, substeps=7), wave(PLANAR), duration=0.3)  # made by no other test
    first = taut.run(loop)
    monkeypatch.setattr(native, "PATIENCE", 0)
    assert np.array_equal(taut.run(loop).q, first.q)
    assert len(compared) >= 2
    assert all(np.array_equal(memory, compared[0]) for memory in compared)


class TestDivergence:
    @pytest.fixture(params=["native", "float"])
    def diverged(self, request: pytest.FixtureRequest) -> taut.Run:
        """Damping beyond what a millisecond can take: each tick turns the velocity round and makes it larger."""
        ctrl = taut.compile(taut.laws.PID(kp=0.0, kd=[0.0, 4000.0]), PLANAR, engine=request.param)
        return taut.run(ctrl, taut.RigidPlant(PLANAR), duration=0.5, v0=[0.0, 0.1])

    def test_is_an_outcome_with_time_tick_and_joint(self, diverged: taut.Run) -> None:
        outcome = diverged.outcome
        assert (outcome.ok, outcome.kind, outcome.joint) == (False, "diverged", "joint2")
        t, speed = diverged.t[-1], abs(diverged.v[-1]).max()
        assert outcome.message == (
            f"the simulation diverged at t = {t:.6g} s (tick {len(diverged) - 1}): joint 'joint2' was at {speed:.3g} "
            "rad/s; try smaller gains, a higher rate or more substeps"
        )

    def test_keeps_every_row_that_is_finite_and_no_other(self, diverged: taut.Run) -> None:
        assert 5 < len(diverged) < 501
        assert diverged.outcome.tick == len(diverged) - 1
        for name, column in diverged.arrays().items():
            assert len(column) == len(diverged), name
            assert np.isfinite(column).all(), name
        # The native sine gives NaN beyond what its polynomials can reduce, so that it notices a few ticks earlier.
        assert np.abs(diverged.v[-1]).max() > 1e9
        assert diverged.metrics.overall("peak_torque") > 1e12

    def test_is_the_same_run_until_then_in_both_engines(self) -> None:
        runs = []
        for engine in ("native", "float"):
            ctrl = taut.compile(taut.laws.PID(kp=0.0, kd=[0.0, 4000.0]), PLANAR, engine=engine)
            runs.append(taut.run(ctrl, taut.RigidPlant(PLANAR), duration=0.5, v0=[0.0, 0.1]))
        np.testing.assert_allclose(runs[0].v[:6], runs[1].v[:6], rtol=1e-10)

    def test_in_the_first_tick_leaves_one_row(self) -> None:
        ctrl = taut.compile(TorqueOf(), PLANAR)
        push = taut.JointMotion(q=[0.0, 0.0], a=[1e308, 1e308])
        out = taut.run(ctrl, taut.RigidPlant(PLANAR, substeps=3), push, duration=0.1)
        assert (len(out), out.outcome.kind, out.outcome.tick) == (1, "diverged", 0)

    def test_of_a_command_that_is_not_finite_keeps_what_came_before(self) -> None:
        """1 / (x - x) is inf in tick 5: that row has no finite command, so the one before is the last."""

        class Breaks(taut.Law):
            def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
                return taut.Torque(P=1.0 / (x.t - 0.005) + 0.0 * x.q)

        for engine in ("native", "float"):
            ctrl = taut.compile(Breaks(), PLANAR, engine=engine)
            out = taut.run(ctrl, taut.RigidPlant(PLANAR), duration=0.01)
            assert (len(out), out.outcome.kind, out.outcome.tick) == (5, "diverged", 4)
            assert "at t = 0.005 s (tick 5)" in out.outcome.message

    @pytest.mark.parametrize(("bad", "rows"), [(0.0, 0), (0.005, 5), (4.1, 4100)])
    def test_leaves_a_log_with_the_rows_that_are_kept(self, bad: float, rows: int, tmp_path: Path) -> None:
        class Breaks(taut.Law):
            at: taut.Gain  # [s]

            def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
                return taut.Torque(P=1.0 / (x.t - self.at) + 0.0 * x.q)

        ctrl = taut.compile(Breaks(at=100.0), PLANAR)
        breaks, log = [taut.Event(t=0.0, set={"law.at": bad})], tmp_path / "run.mcap"
        plant = taut.RigidPlant(PLANAR, adds=("gravity",))
        out = taut.run(ctrl, plant, duration=5.0, events=breaks, log=log)
        assert (len(out), out.outcome.kind, out.outcome.tick) == (rows, "diverged", rows - 1)
        if rows:
            again = taut.load_run(log)
            assert (len(again), again.outcome.kind) == (rows, "diverged")
            np.testing.assert_array_equal(again.q, out.q)

    def test_of_law_memory_alone_is_divergence_too(self) -> None:
        class Grows(taut.Law):
            big: taut.Memory = taut.Memory(1.0)

            def command(self, x: taut.Snapshot, ref: taut.JointMotion, memory: Any, dt: float) -> Any:
                return taut.Torque(P=0.0 * x.q), {"big": memory.big * 1e100}

        out = taut.run(taut.compile(Grows(), PLANAR), taut.RigidPlant(PLANAR), duration=0.1)
        assert (len(out), out.outcome.kind) == (4, "diverged")


@pytest.mark.parametrize("engine", ["native", "float"])
def test_these_tests_see_a_tick_that_is_off_by_one(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The comparison by hand must fail when the loop commands one tick late."""
    law, arm, control, options = CASES["PID with integral and limits"]
    ctrl = taut.compile(law, arm, rate=500.0, engine=engine, **control)
    late = taut.RigidPlant(arm, actuation=taut.drives.Actuation(delay=0.002), **options)
    out = taut.run(ctrl, late, wave(arm), duration=0.1)
    hand = by_hand(ctrl, taut.RigidPlant(arm, **options), wave(arm), len(out), arm.home, np.zeros(arm.n))
    assert np.abs(out.q - hand["q"]).max() > 1e-4


def test_an_arm_that_leaves_its_limits_is_told() -> None:
    arm = PLANAR.with_joints(lower=-0.1, upper=2.0)
    goal = taut.JointMotion(q=[2.5, 0.5])
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    free, stopped = (
        taut.run(ctrl, plant, goal, duration=2.0) for plant in (taut.RigidPlant(arm), taut.MujocoPlant(arm))
    )
    assert free.outcome.ok
    assert "; joint 'joint1' went 0.5 rad beyond its limits, where a real one meets its stop" in free.outcome.message
    assert stopped.outcome.message == "completed: 2001 ticks, 2 s"
