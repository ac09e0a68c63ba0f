"""The Lyapunov function of eq. 10.24 along runs: its rate against eq. 10.27 and against its own differences."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

import taut
from taut.arm.builtin import BUILT_IN
from taut.arm.catalogue import CATALOGUE

laws, Plant = taut.laws, taut.RigidPlant
TIGHT = 1e-6  # relative: what the design issue asks for
ARMS = (*BUILT_IN, *CATALOGUE)
FEW = ("planar3", "panda", "kinova")  # the last one has joints that wrap
OMEGA, RATE = 3.0, 4000.0  # [rad/s] of each joint's own inertia, [Hz]: a folded wrist takes no more damping in a tick


def run_of(law: taut.Law, arm: taut.Arm, plant: taut.RigidPlant | None = None, **options: object) -> taut.Run:
    given = {"ref": taut.JointMotion(q=arm.home + 0.3), "duration": 0.3} | options
    return taut.run(taut.compile(law, arm), plant or Plant(arm, friction=None), **given)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["one_joint", "planar2", "gantry3"])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_it_falls_at_the_rate_of_the_damping(name: str) -> None:
    arm = taut.load_arm(name)
    v0 = np.cos(np.arange(arm.n))
    found = taut.analysis.lyapunov(run_of(laws.GravityPID(kp=60.0, kd=9.0), arm, v0=v0))
    assert found.worst < TIGHT
    assert np.abs(found.rate).max() > 1.0


def test_a_panda_with_matrices_of_gains() -> None:
    arm = taut.load_arm("panda")
    random = np.random.default_rng(0)
    kp, kd = (
        scale * (np.eye(7) + 0.1 * (x + x.T))
        for scale, x in zip((80.0, 6.0), random.normal(size=(2, 7, 7)), strict=True)
    )
    found = taut.analysis.lyapunov(
        run_of(laws.GravityPID(kp=kp @ kp.T / 80.0, kd=kd @ kd.T / 6.0), arm, v0=0.5 * np.ones(7))
    )
    assert found.worst < TIGHT


def test_its_differences_are_its_rate_and_get_there_as_the_tick_shrinks() -> None:
    """The slope of V itself, by central differences of its values: off by the hold, which halves with the tick."""
    arm, off = taut.load_arm("planar2"), []
    for rate in (2000.0, 4000.0):
        ctrl = taut.compile(laws.GravityPID(kp=60.0, kd=9.0), arm, rate=rate)
        plant = Plant(arm, friction=None, integrator="rk4", substeps=2)
        found = taut.analysis.lyapunov(taut.run(ctrl, plant, taut.JointMotion(q=arm.home + 0.3), duration=0.3))
        slope = (found.V[2:] - found.V[:-2]) * (0.5 * rate)
        off.append(np.abs(slope - found.expected[1:-1]).max() / np.abs(found.expected).max())
    assert off[0] < 0.02
    assert off[1] == pytest.approx(0.5 * off[0], rel=0.1)


def test_in_a_tight_run_the_slope_of_its_values_is_minus_v_kd_v() -> None:
    """Central differences of V over shorter and shorter ticks; what the hold puts off by dt, dt^2, ... is taken out."""
    arm, each = taut.load_arm("planar2"), []
    for doubled in range(6):
        rate = 2000.0 * 2**doubled
        ctrl = taut.compile(laws.GravityPID(kp=60.0, kd=9.0), arm, rate=rate)
        plant = Plant(arm, friction=None, integrator="rk4")
        found = taut.analysis.lyapunov(
            taut.run(ctrl, plant, taut.JointMotion(q=arm.home + 0.3), duration=0.05, v0=[1.0, -1.0])
        )
        at = np.arange(10, 100, 10) * 2**doubled  # the same instants
        each.append(np.stack([(found.V[at + 1] - found.V[at - 1]) * (0.5 * rate), found.expected[at]]))
    order = 1
    while len(each) > 1:  # Richardson
        each = [(2**order * fine - coarse) / (2**order - 1) for coarse, fine in pairwise(each)]
        order += 1
    slope, damping = each[0]
    assert np.abs(slope - damping).max() < TIGHT * np.abs(damping).max()


@pytest.mark.long
@pytest.mark.bars
def test_from_every_state_of_every_arm_it_comes_to_rest_at_the_target(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    """Section 10.2.2.2: globally, with V falling in every tick and at the rate of the proof."""
    count = share(share(1000))
    arms = ARMS if count == 1000 else FEW
    left, rates = 0.0, 0.0
    for name in arms:
        arm, random = taut.load_arm(name), np.random.default_rng([0, *name.encode()])
        lower, upper = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
        fastest = np.minimum(arm.velocity, 3.0)
        poses = random.uniform(lower, upper, size=(20, arm.n))
        own = np.max([np.diag(taut.snapshot(arm, q).M) for q in poses], axis=0)
        ctrl = taut.compile(laws.GravityPID(kp=OMEGA**2 * own, kd=2.0 * OMEGA * own), arm, rate=RATE)
        loop = taut.Loop(ctrl, Plant(arm, friction=None), taut.JointMotion(q=arm.home), duration=4.0)
        for _ in range(count):
            q0, v0 = random.uniform(lower, upper), random.uniform(-fastest, fastest)
            run = taut.run(loop, q0=q0, v0=v0)
            assert run.outcome.kind == "completed", (name, q0, v0)
            found = taut.analysis.lyapunov(run)
            assert found.decreases, (name, q0, v0)
            left, rates = max(left, float(found.V[-1] / found.V[0])), max(rates, found.worst)
    assert left < 1e-4
    assert rates < TIGHT
    bar(
        f"PD with gravity compensation, {len(arms)} arms, {count} random states each: V falls in every tick; the most "
        "that is left of it after 4 s",
        f"{len(arms) * count} of {len(arms) * count}; {left:.1e}",
    )
    bar("the same: dV/dt against -v . Kd v, relative to the largest", f"{rates:.1e}")


def test_viscous_friction_and_a_law_without_a_spring() -> None:
    arm = taut.load_arm("planar2").with_friction(taut.Friction(viscous=0.4))
    found = taut.analysis.lyapunov(
        run_of(laws.GravityCompensation(kd=1.0), arm, Plant(arm), ref=None, v0=[1.0, -1.0])
    )
    assert found.worst < TIGHT
    assert pytest.approx(found.kinetic) == found.V
    assert found.decreases


@pytest.mark.parametrize("kd", [9.0, 0.0])
def test_a_payload_that_the_law_does_not_know_shows(kd: float) -> None:
    arm = taut.load_arm("planar2")
    found = taut.analysis.lyapunov(
        run_of(laws.GravityPID(kp=60.0, kd=kd), arm, Plant(arm.with_payload(0.5), friction=None))
    )
    assert found.worst > 0.01


def test_without_damping_its_rate_is_none_and_in_ticks_it_grows() -> None:
    arm = taut.load_arm("planar2")
    found = taut.analysis.lyapunov(run_of(laws.GravityCompensation(), arm, ref=None, v0=[1.0, 1.0], duration=0.5))
    assert found.worst == 0.0
    assert not found.decreases
    assert found.json()["faults"]


planar = taut.load_arm("planar2")
geared = planar.with_gears(ratio=100.0, motor_inertia=1e-4)
MISUSE: dict[str, tuple[Callable[[], object], str]] = {
    "law": (
        lambda: taut.analysis.lyapunov(run_of(laws.ComputedTorque(kp=60.0, kd=9.0), planar)),
        "run",
    ),
    "sum": (
        lambda: taut.analysis.lyapunov(
            run_of(laws.GravityPID(kp=60.0, kd=9.0) + laws.FrictionCompensation(), planar)
        ),
        "run",
    ),
    "events": (
        lambda: taut.analysis.lyapunov(
            run_of(laws.GravityPID(kp=60.0, kd=9.0), planar, events=[taut.Event(t=0.1, set={"law.kp": 80.0})])
        ),
        "run",
    ),
    "target speed": (
        lambda: taut.analysis.lyapunov(
            run_of(laws.GravityPID(kp=60.0, kd=9.0), planar, ref=taut.JointMotion(q=planar.home, v=[0.1, 0.0]))
        ),
        "run",
    ),
    "gears": (
        lambda: taut.analysis.lyapunov(
            run_of(
                laws.GravityPID(kp=60.0, kd=9.0),
                geared,
                Plant(
                    geared,
                    friction=None,
                    actuation=taut.drives.Actuation(transmission=taut.drives.Transmission(efficiency=0.8)),
                ),
            )
        ),
        "run",
    ),
    "integral": (
        lambda: taut.analysis.lyapunov(run_of(laws.GravityPID(kp=60.0, kd=9.0, ki=1.0), planar)),
        "run",
    ),
    "reference": (
        lambda: taut.analysis.lyapunov(
            run_of(
                laws.GravityPID(kp=60.0, kd=9.0),
                planar,
                ref=taut.trajectories.Quintic(q0=planar.home, q1=planar.home + 0.1, duration=0.2),
            )
        ),
        "run",
    ),
    "dry": (
        lambda: taut.analysis.lyapunov(
            run_of(
                laws.GravityPID(kp=60.0, kd=9.0),
                planar,
                Plant(planar.with_friction(taut.Friction(coulomb=0.1))),
            )
        ),
        "run",
    ),
    "no run": (lambda: taut.analysis.lyapunov(3), "run"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("case", MISUSE)
def test_bad_input_is_refused_by_name(case: str) -> None:
    call, name = MISUSE[case]
    with pytest.raises(taut.TautError) as caught:
        call()
    assert caught.value.name == name
