"""A run against a plant with a state of its own, tick by tick: the same order of things as in a fused run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runtime_laws import Array, HandPlant, Seen, TorqueOf, seen

import taut
from taut.runtime import ongoing

ARM = taut.load_arm("planar2")
PUSH = taut.trajectories.Sine(center=[0.0, 0.0], amplitude=[1.0, 2.0], frequency=3.0)


class Senses(HandPlant):
    """Also gives the torque of the last period."""

    def __init__(self, **options: Any) -> None:
        super().__init__(measures="v tau_meas", **options)

    def measure(self) -> dict[str, Array]:
        return {**super().measure(), "tau_meas": self.commands[-1] if self.commands else np.zeros(2)}


def test_each_row_has_the_state_at_the_tick_and_the_torque_of_the_period_that_follows() -> None:
    plant = Senses()
    ctrl = taut.compile(Seen(), ARM, rate=100.0, adds=plant.adds)
    out = taut.run(ctrl, plant, PUSH, duration=0.1, q0=[0.1, 0.2], v0=[0.5, 0.0])
    np.testing.assert_array_equal(out.q[0], [0.1, 0.2])
    np.testing.assert_array_equal(out.v[0], [0.5, 0.0])
    np.testing.assert_array_equal(seen(out, "t")[:, 0], out.t)
    np.testing.assert_array_equal(seen(out, "q"), out.q)
    np.testing.assert_array_equal(seen(out, "tau")[1:], out.tau[:-1])
    np.testing.assert_allclose(out.command, [PUSH.at(t).a for t in out.t], rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(out.tau, out.command)
    np.testing.assert_allclose(np.diff(out.v, axis=0), 0.01 * out.tau[:-1], rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(out.extra["mass"], np.ones(11))
    assert out.outcome.message == "completed: 11 ticks, 0.1 s"


@pytest.mark.parametrize("engine", ["native", "float"])
def test_it_is_what_a_controllers_own_steps_give(engine: Any) -> None:
    plant, law = HandPlant(mass=0.5), taut.laws.PID(kp=20.0, kd=2.0, ki=30.0)
    limits = taut.Limits(tau=5.0, tau_dot=200.0)
    goal = taut.JointMotion(q=[0.5, -0.3])
    out = taut.run(taut.compile(law, ARM, limits=limits, adds=plant.adds, engine=engine), plant, goal, duration=0.5)
    ctrl = taut.compile(law, ARM, limits=limits, adds=plant.adds, engine=engine)
    plant.reset(ARM.home, np.zeros(2), ctrl.dt)
    for k in range(len(out)):
        q, v = plant.state()
        np.testing.assert_allclose(out.q[k], q, rtol=1e-12)
        tau = ctrl.step(q, v, goal)
        np.testing.assert_allclose(out.command[k], tau, rtol=1e-12)
        np.testing.assert_allclose(sum(term[k] for term in out.terms.values()), tau, rtol=1e-12)
        plant.advance(tau)


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_the_controller_is_left_alone() -> None:
    plant = HandPlant()
    ctrl = taut.compile(taut.laws.PID(kp=3.0, ki=1.0), ARM, adds=plant.adds)
    events = [taut.Event(t=0.0, set={"law.kp": 9.0})]
    taut.run(ctrl, plant, PUSH, duration=0.1, events=events)
    assert ctrl.ticks == 0
    assert ctrl.parameters["law.kp"] == 3.0


class TestTrouble:
    def test_ends_the_run_with_its_words_after_the_tick_that_had_it(self) -> None:
        plant = HandPlant(fails_at=6)
        out = taut.run(taut.compile(TorqueOf(), ARM, adds=plant.adds), plant, PUSH, duration=0.1)
        assert (len(out), out.outcome.kind, out.outcome.tick, out.outcome.joint) == (6, "diverged", 5, "joint2")
        assert out.outcome.message == (
            "the simulation diverged at t = 0.005 s (tick 5), joint 'joint2': the point masses flew apart"
        )
        np.testing.assert_array_equal(out.tau, out.command)

    @pytest.mark.parametrize("engine", ["native", "float"])
    def test_of_the_law_leaves_no_row_without_a_command(self, engine: Any, tmp_path: Path) -> None:
        """In tick 4 the law divides by zero: four rows are whole, and nothing of the fifth is kept."""

        class Breaks(taut.Law):
            def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
                return taut.Torque(P=1.0 / (x.t - 0.004) + 0.0 * x.q)

        plant, log = HandPlant(), tmp_path / "run.mcap"
        out = taut.run(taut.compile(Breaks(), ARM, adds=plant.adds, engine=engine), plant, duration=0.1, log=log)
        assert (len(out), out.outcome.kind, out.outcome.tick) == (4, "diverged", 3)
        assert out.outcome.message.endswith("(t = 0.004 s, tick 4)")
        assert "Breaks gives numbers that are not finite in tick 4" in out.outcome.message
        np.testing.assert_array_equal(out.tau, out.command)
        assert len(plant.commands) == 4
        again = taut.load_run(log)
        assert (len(again), again.outcome.kind) == (4, "diverged")

    def test_in_the_very_first_tick_leaves_an_empty_run(self) -> None:
        class Breaks(taut.Law):
            def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
                return taut.Torque(P=1.0 / (x.q - 0.25))

        plant = HandPlant()
        out = taut.run(taut.compile(Breaks(), ARM, adds=plant.adds), plant, duration=0.1, q0=[0.25, 0.0])
        assert (len(out), out.outcome.kind) == (0, "diverged")
        assert not plant.commands
        assert np.isnan(out.metrics.overall("rms_error"))

    def test_of_other_kinds_is_no_divergence(self) -> None:
        """What the law's own code raises is a mistake in it; the run stops there, and what came before is kept."""

        class Wrong(taut.Law):
            count: taut.Memory = taut.Memory(0.0)

            def command(self, x: taut.Snapshot, ref: taut.JointMotion, memory: Any, dt: float) -> Any:
                if float(np.asarray(x.t)) > 0.002:
                    raise KeyError("a table of mine")
                return taut.Torque(P=0.0 * x.q), {"count": memory.count}

        plant = HandPlant()
        ctrl = taut.compile(Wrong(), ARM, adds=plant.adds, engine="float")
        out = taut.run(ctrl, plant, duration=0.1)
        assert (len(out), out.outcome.kind, out.outcome.tick) == (3, "stopped", 2)
        assert "a table of mine" in out.outcome.message


@pytest.mark.parametrize("ticks", [2, 500])
@pytest.mark.parametrize("period", [0.0, 1e-3, ongoing.LOG_PERIOD])
def test_a_log_that_is_written_while_it_goes_on_has_every_row_once(
    ticks: int, period: float, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(ongoing, "LOG_PERIOD", period)
    plant, log = HandPlant(), tmp_path / "run.mcap"
    ctrl = taut.compile(taut.laws.PID(kp=1.0), ARM, adds=plant.adds)
    out = taut.run(ctrl, plant, PUSH, duration=(ticks - 1) * 1e-3 + 1e-9, log=log)
    again = taut.load_run(log)
    assert len(out) == len(again) == ticks
    for name, column in out.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], column, err_msg=name)
