"""The Lyapunov function of eq. 10.24 along runs: its rate against eq. 10.27 and against its own differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import taut

laws, Plant = taut.laws, taut.RigidPlant
TIGHT = 1e-6  # relative: what the design issue asks for


def run_of(law: taut.Law, arm: taut.Arm, plant: taut.RigidPlant | None = None, **options: object) -> taut.Run:
    given = {"ref": taut.JointMotion(q=arm.home + 0.3), "duration": 0.3} | options
    return taut.run(taut.compile(law, arm), plant or Plant(arm, friction=None), **given)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["one_joint", "planar2", "gantry3", "double_pendulum"])
def test_it_falls_at_the_rate_of_the_damping(name: str) -> None:
    arm = taut.load_arm(name)
    v0 = np.cos(np.arange(arm.n))
    found = taut.lyapunov(run_of(laws.GravityPID(kp=60.0, kd=9.0), arm, v0=v0))
    assert found.worst < TIGHT
    assert np.abs(found.rate).max() > 1.0


def test_a_panda_with_matrices_of_gains() -> None:
    arm = taut.load_arm("panda")
    random = np.random.default_rng(0)
    kp, kd = (
        scale * (np.eye(7) + 0.1 * (x + x.T))
        for scale, x in zip((80.0, 6.0), random.normal(size=(2, 7, 7)), strict=True)
    )
    found = taut.lyapunov(run_of(laws.GravityPID(kp=kp @ kp.T / 80.0, kd=kd @ kd.T / 6.0), arm, v0=0.5 * np.ones(7)))
    assert found.worst < TIGHT


def test_its_differences_are_its_rate_and_get_there_as_the_tick_shrinks() -> None:
    """The slope of V itself, by central differences of its values: off by the hold, which halves with the tick."""
    arm, off = taut.load_arm("planar2"), []
    for rate in (2000.0, 4000.0):
        ctrl = taut.compile(laws.GravityPID(kp=60.0, kd=9.0), arm, rate=rate)
        plant = Plant(arm, friction=None, integrator="rk4", substeps=2)
        found = taut.lyapunov(taut.run(ctrl, plant, taut.JointMotion(q=arm.home + 0.3), duration=0.3))
        slope = (found.V[2:] - found.V[:-2]) * (0.5 * rate)
        off.append(np.abs(slope - found.expected[1:-1]).max() / np.abs(found.expected).max())
    assert off[0] < 0.02
    assert off[1] == pytest.approx(0.5 * off[0], rel=0.1)


def test_viscous_friction_and_a_law_without_a_spring() -> None:
    arm = taut.load_arm("planar2").with_friction(taut.Friction(viscous=0.4))
    found = taut.lyapunov(run_of(laws.GravityCompensation(kd=1.0), arm, Plant(arm), ref=None, v0=[1.0, -1.0]))
    assert found.worst < TIGHT
    assert pytest.approx(found.kinetic) == found.V
    assert found.falls


def test_a_payload_that_the_law_does_not_know_shows() -> None:
    arm = taut.load_arm("planar2")
    found = taut.lyapunov(run_of(laws.GravityPID(kp=60.0, kd=9.0), arm, Plant(arm.with_payload(0.5), friction=None)))
    assert found.worst > 0.01


planar = taut.load_arm("planar2")
MISUSE: dict[str, tuple[Callable[[], object], str]] = {
    "law": (
        lambda: taut.lyapunov(run_of(laws.ComputedTorque(kp=60.0, kd=9.0), planar)),
        "eq. 10.24 is for PD control with gravity compensation, GravityPID or GravityCompensation; this run is of "
        "ComputedTorque",
    ),
    "integral": (
        lambda: taut.lyapunov(run_of(laws.GravityPID(kp=60.0, kd=9.0, ki=1.0), planar)),
        "eq. 10.24 is for ki = 0; this run has law.ki = 1.0",
    ),
    "reference": (
        lambda: taut.lyapunov(
            run_of(
                laws.GravityPID(kp=60.0, kd=9.0),
                planar,
                ref=taut.Quintic(q0=planar.home, q1=planar.home + 0.1, duration=0.2),
            )
        ),
        "eq. 10.24 is for a set-point, and the reference of this run moves",
    ),
    "dry": (
        lambda: taut.lyapunov(
            run_of(
                laws.GravityPID(kp=60.0, kd=9.0),
                planar,
                Plant(planar.with_friction(taut.Friction(coulomb=0.1))),
            )
        ),
        "eq. 10.27 knows no dry friction, and the plant has plant.friction.coulomb; run it with friction=None",
    ),
    "no run": (lambda: taut.lyapunov(3), "lyapunov takes a taut.Run; got int"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("case", MISUSE)
def test_bad_input_gets_one_sentence(case: str) -> None:
    call, text = MISUSE[case]
    with pytest.raises(taut.TautError) as caught:
        call()
    assert str(caught.value) == text
