"""What a law asks for is checked before limits: an infinite torque is refused, never cut to a full one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import taut

PLANAR = taut.load_arm("planar2")
LIMITS = {
    "magnitude": taut.Limits(tau=50.0),
    "rate": taut.Limits(tau_dot=500.0),
    "speed": taut.Limits(v=2.0),
    "all": taut.Limits(tau=50.0, tau_dot=500.0, v=2.0, blend=0.1),
}
BREAKS = 4  # the tick in which the law divides by zero, for joint 2


class Divides(taut.Law):
    """kp / (t - 4 ms) for joint 2: infinite in tick 4, and an arm at rest before that."""

    kp: taut.Gain

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        far = self.kp @ taut.math.array([0.0, 1e-9 / (0.004 - x.t)])
        return taut.Torque(P=far, gravity=x.g)


class Infinite(taut.Law):
    """Infinite wherever a joint does not move, with the sign of the reference."""

    kp: taut.Gain

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(P=self.kp @ (ref.q / x.v), gravity=x.g)


def is_of(error: taut.errors.NumericalError, term: str, joint: str) -> bool:
    return (error.name, error.joint) == (f"terms.{term}", joint) and not np.isfinite(error.value)  # type: ignore[call-overload]


@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize("limits", LIMITS.values(), ids=list(LIMITS))
class TestTheControllerRefusesIt:
    def test_in_a_step(self, limits: taut.Limits, engine: Any) -> None:
        ctrl = taut.compile(Infinite(kp=1.0), PLANAR, limits=limits, engine=engine)
        q, ref = np.array([0.5, 0.5]), taut.JointMotion(q=[0.1, -0.1])
        before = ctrl.step(q, np.ones(2), ref)
        memory = dict(ctrl.memory)
        for v in ([1.0, 0.0], np.array([1.0, 0.0])):  # lists and arrays
            with pytest.raises(taut.errors.NumericalError) as refused:
                ctrl.step(q, v, ref)
            assert is_of(refused.value, "P", "joint2")
        assert ctrl.ticks == 1
        for path, value in ctrl.memory.items():
            np.testing.assert_array_equal(value, memory[path])
        assert np.isfinite(before).all()
        assert np.isfinite(ctrl.step(q, np.ones(2), ref)).all()

    def test_in_the_first_tick(self, limits: taut.Limits, engine: Any) -> None:
        ctrl = taut.compile(Infinite(kp=1.0), PLANAR, limits=limits, engine=engine)
        with pytest.raises(taut.errors.NumericalError) as refused:
            ctrl.step([0.5, 0.5], [0.0, 1.0], taut.JointMotion(q=[0.1, -0.1]))
        assert is_of(refused.value, "P", "joint1")
        assert ctrl.ticks == 0

    def test_on_bound_arrays(self, limits: taut.Limits, engine: Any) -> None:
        k = taut.compile(Infinite(kp=1.0), PLANAR, limits=limits, engine=engine).bind()
        k.v[:], k.ref.q[:] = 1.0, 0.1
        k.tick()
        k.v[1] = 0.0
        with pytest.raises(taut.errors.NumericalError) as refused:
            k.tick()
        assert is_of(refused.value, "P", "joint2")

    @pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
    def test_in_a_run(self, plant: Any, limits: taut.Limits, engine: Any) -> None:
        out = taut.run(
            taut.compile(Divides(kp=1.0), PLANAR, limits=limits, engine=engine), plant(PLANAR), duration=0.1
        )
        outcome = out.outcome
        assert (outcome.kind, outcome.tick, outcome.joint, len(out)) == ("diverged", BREAKS - 1, "joint2", BREAKS)
        assert "'P'" in outcome.message
        assert all(np.isfinite(column).all() for column in out.arrays().values())


def test_overflow_is_an_infinity_too() -> None:
    ctrl = taut.compile(taut.laws.PID(kp=1e308), PLANAR, limits=LIMITS["magnitude"])
    with pytest.raises(taut.errors.NumericalError) as refused:
        ctrl.step([3.0, 0.0], [0.0, 0.0], taut.JointMotion(q=[-3.0, 0.0]))
    assert is_of(refused.value, "P", "joint1")


class InfiniteSpeed(taut.Law):
    """A velocity without bound."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Velocity:
        return taut.Velocity(P=ref.q / (x.q - 0.5))


@pytest.mark.parametrize("engine", ["native", "float"])
def test_an_infinite_velocity_is_not_cut_either(engine: Any) -> None:
    ctrl = taut.compile(InfiniteSpeed(), PLANAR, limits=taut.Limits(v=1.0), engine=engine)
    with pytest.raises(taut.errors.NumericalError) as refused:
        ctrl.step([0.1, 0.5], ref=taut.JointMotion(q=[0.1, -0.1]))
    assert is_of(refused.value, "P", "joint2")


@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize(
    "drive",
    [
        taut.drives.Actuation(motor=taut.drives.Motor(peak=50.0)),
        taut.drives.Actuation(motor=taut.drives.Motor(peak=50.0), delay=0.002),
    ],
    ids=["motor", "late motor"],
)
def test_a_drive_that_saturates_does_not_hide_it(drive: taut.drives.Actuation, engine: Any) -> None:
    """The motor's own limit would make 50 N m of infinity, and the run would complete."""
    for plant in (taut.RigidPlant(PLANAR, actuation=drive), taut.MujocoPlant(PLANAR, actuation=drive)):
        out = taut.run(taut.compile(Divides(kp=1.0), PLANAR, engine=engine), plant, duration=0.1)
        assert (out.outcome.kind, out.outcome.tick, out.outcome.joint) == ("diverged", BREAKS - 1, "joint2")
        assert "'P'" in out.outcome.message


@pytest.mark.parametrize("engine", ["native", "float"])
def test_limits_change_no_bit_of_a_finite_torque(engine: Any) -> None:
    """Signed zeros included: the check adds nothing to the command."""
    free = taut.compile(taut.laws.PID(kp=3.0), PLANAR, engine=engine)
    cut = taut.compile(taut.laws.PID(kp=3.0), PLANAR, limits=taut.Limits(tau=50.0), engine=engine)
    for q in ([0.0, 0.3], [-0.0, 7.0], [1e-300, 0.1]):
        args = (np.array(q), np.zeros(2), taut.JointMotion(q=[0.0, 0.0]))
        np.testing.assert_array_equal(np.clip(free.step(*args), -50.0, 50.0), cut.step(*args))
