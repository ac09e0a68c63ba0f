"""The energy that a controller gives, as a guard: passive laws stay within their springs, active ones are stopped."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut import laws
from taut.maths.model import model_of

DT = 1e-3  # [s]
NEVER = 1e9  # [J]


class NegativeDamping(taut.Law):
    """A spring that is driven.

    Law:          tau = kp e + kd v + g
    """

    kp: taut.Gain = taut.Gain(unit="N m/rad")
    kd: taut.Gain = taut.Gain(unit="N m s/rad")

    def command(self, x: Any, ref: Any) -> taut.Torque:
        return taut.Torque(P=self.kp @ x.difference(ref.q), D=self.kd @ x.v, gravity=x.g)


class LateSpring(taut.Law):
    """A spring whose error comes ten ticks late, as through a network.

    Law:          tau = kp e(t - 10 ticks) - kd v + g
    """

    kp: taut.Gain = taut.Gain(unit="N m/rad")
    kd: taut.Gain = taut.Gain(unit="N m s/rad")
    line = taut.Memory(doc="errors, the oldest first")

    def start(self, x: Any, ref: Any) -> dict[str, Any]:
        return {"line": taut.math.stack([x.difference(ref.q)] * 10)}

    def command(self, x: Any, ref: Any, memory: Any, dt: float) -> tuple[taut.Torque, dict[str, Any]]:
        line = taut.math.stack([*memory.line[1:], x.difference(ref.q)])
        return taut.Torque(P=self.kp @ memory.line[0], D=-(self.kd @ x.v), gravity=x.g), {"line": line}


def guarded(law: taut.Law, arm: taut.Arm, bound: float, ref: Any, **options: Any) -> taut.Run:
    task = [taut.Phase(law, ref, unless=lambda x: taut.guards.energy(x, bound), name="move")]
    q0 = options.pop("q0", arm.home)
    return taut.run(taut.compile(task, arm), taut.RigidPlant(arm, **options), duration=0.6, q0=q0)


def stopped(run: taut.Run) -> bool:
    return [window.name for window in run.phases] != ["move"]


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["planar2", "ur10", "panda"])
@pytest.mark.parametrize("frictionless", [True, False])
def test_the_energy_is_the_work_of_the_torque_less_what_lifted_the_arm(name: str, frictionless: bool) -> None:
    arm = taut.load_arm(name)
    ref = taut.trajectories.Sine(center=arm.home, amplitude=0.2, frequency=0.7)
    options: dict[str, Any] = {"friction": None, "integrator": "rk4"} if frictionless else {}
    run = guarded(laws.ComputedTorque(kp=100.0, kd=20.0), arm, NEVER, ref, **options)
    work = np.concatenate([[0.0], np.cumsum(np.sum(run.tau[:-1] * np.diff(run.q, axis=0), axis=1))])
    weights = np.array([taut.dynamics.potential_energy(model_of(arm), q) for q in run.q])
    np.testing.assert_allclose(run.extra["energy"], work - (weights - weights[0]), atol=1e-6 * np.abs(work).max())
    assert run.metrics.energy.sum() == pytest.approx(work[-1])
    if frictionless:  # then it is the kinetic energy, apart from the integrator
        kinetic = [float(taut.snapshot(arm, run.q[k], run.v[k]).kinetic_energy) for k in (0, -1)]
        assert run.extra["energy"][-1] == pytest.approx(kinetic[1] - kinetic[0], rel=1e-3, abs=1e-4)


@pytest.mark.bars
def test_a_passive_law_never_gives_more_than_its_springs_held(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    """Random gains, starts and pushes on three arms; in many it gives more than half of that."""
    seeds, count, reached = share(120), 0, 0
    for name in ("planar2", "ur10", "panda"):
        arm = taut.load_arm(name)
        for seed in range(max(2, seeds // 3)):
            rng = np.random.default_rng(seed)
            kp = rng.uniform(30.0, 120.0)
            law = laws.GravityPID(kp=kp, kd=kp * rng.uniform(0.2, 1.0) * np.linspace(0.05, 0.004, arm.n))
            e = rng.uniform(-0.3, 0.3, arm.n)
            bound = 0.5 * kp * float(e @ e)
            push = taut.environments.Push(peak=[*rng.uniform(-20.0, 20.0, 3), 0.0, 0.0, 0.0], t=0.1, duration=0.2)
            options: dict[str, Any] = {"environment": push, "friction": None, "q0": arm.home + e}
            ref = taut.JointMotion(q=arm.home)
            peak = guarded(law, arm, NEVER, ref, **options).extra["energy"].max()  # one program for all
            assert peak <= 1.001 * bound, (name, seed)
            reached += peak > 0.5 * bound
            count += 1
    assert reached > count // 3
    bar("energy that GravityPID gives planar2, ur10 and panda under pushes, beyond its springs'", f"0 of {count}")


@pytest.mark.part(1)
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
@pytest.mark.parametrize("name", ["planar2", "panda"])
@pytest.mark.parametrize("law", [NegativeDamping(kp=100.0, kd=2.0), LateSpring(kp=300.0, kd=0.5)])
def test_an_active_law_is_stopped(name: str, law: taut.Law) -> None:
    arm = taut.load_arm(name)
    e = np.full(arm.n, 0.05)
    bound = 1.001 * 0.5 * float(law.parameters()["kp"]) * float(e @ e)  # what a passive spring would keep to
    run = guarded(law, arm, bound, taut.JointMotion(q=arm.home), q0=arm.home + e, friction=None)
    assert stopped(run)
    first = int(np.argmax(run.extra["energy"] > bound))

    assert 0 < first < len(run) - 1
    assert np.abs(run.v[-1]).max() < np.abs(run.v[first]).max()


def test_only_torques_have_an_energy_here() -> None:
    arm = taut.load_arm("planar2")
    task = [taut.Phase(laws.VelocityPI(kp=5.0), unless=lambda x: taut.guards.energy(x, 1.0))]
    with refused(taut.errors.MatchError):
        taut.compile(task, arm).needs  # noqa: B018
    with refused(taut.errors.RangeError):
        guarded(laws.GravityPID(kp=5.0, kd=1.0), arm, -1.0, taut.JointMotion(q=arm.home))
