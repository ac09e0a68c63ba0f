"""Impedance at the tool: against closed forms, what laws promise, and sine sweeps."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from sine_sweep import measured_Z

import taut

laws, Plant = taut.laws, taut.RigidPlant
Z_AXIS = [0.0, 0.0, 1.0]


def weightless(name: str) -> taut.Arm:
    return taut.load_arm(name, gravity=(0.0, 0.0, 0.0))


def loop_of(law: taut.Law, arm: taut.Arm, plant: taut.RigidPlant | None = None, **options: object) -> taut.Loop:
    ctrl = taut.compile(law, arm, **options)  # type: ignore[arg-type]
    return taut.Loop(ctrl, plant or Plant(arm, friction=None), duration=0.5)


@pytest.fixture(scope="module")
def impedance() -> taut.Loop:
    return loop_of(laws.Impedance(K=(800.0, 30.0), zeta=0.7), taut.load_arm("panda"))


def test_the_impedance_of_one_axis_is_the_sampled_mass_damper_and_spring() -> None:
    """Semi-implicit Euler: Z = m (z - 1)^2 / (T^2 z) + B (z - 1) / (T z) + K."""
    arm, K, B, T = weightless("gantry3"), 900.0, 60.0, 1e-3
    J = taut.snapshot(arm, arm.home).J()
    for i in range(3):
        way = J[:3, i]
        m = float(taut.snapshot(arm, arm.home).M[i, i])
        tip = taut.analysis.tool_impedance(loop_of(laws.PID(kp=K, kd=B), arm), direction=way)
        omega = np.array([0.1, 3.0, 30.0, 300.0, 3000.0])
        z = np.exp(1j * omega * T)
        assert tip.Z(omega) == pytest.approx(m * (z - 1.0) ** 2 / (T * T * z) + B * (z - 1.0) / (T * z) + K, rel=1e-9)
        assert tip.Y(omega) * tip.Z(omega) == pytest.approx(np.ones(5))
        assert tip.unit == "N/m"


def test_an_impedance_law_gives_what_it_promises(impedance: taut.Loop) -> None:
    """MATHS.md: static within 1 %; within 2 % of the asked Z where omega_n T <= 0.02 and zeta >= 0.7."""
    for way in ([1.0, 0.0, 0.0], Z_AXIS, [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]):
        tip = taut.analysis.tool_impedance(impedance, direction=way)
        assert abs(tip.Z(1e-3)[0] / tip.specified_Z(1e-3)[0] - 1.0) < 1e-4
        natural = np.sqrt((800.0 if len(way) == 3 else 30.0) / 1.0)
        omega = np.linspace(0.1, natural, 10)
        assert np.abs(tip.Z(omega) / tip.specified_Z(omega) - 1.0).max() < 0.02


@pytest.mark.long
def test_a_sweep_measures_what_is_predicted(impedance: taut.Loop) -> None:
    tip = taut.analysis.tool_impedance(impedance, direction=Z_AXIS)
    omega = np.array([5.0, 40.0, 400.0])
    assert pytest.approx(tip.Z(omega), rel=1e-3) == measured_Z(tip, omega)
    turned = taut.analysis.tool_impedance(impedance, direction=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    assert turned.unit == "N m/rad"
    assert pytest.approx(turned.Z(30.0), rel=1e-3) == measured_Z(turned, 30.0)
    tip.plot()


def test_a_sweep_of_a_late_loop_with_filters_too() -> None:
    arm = taut.load_arm("planar2")
    plant = Plant(arm, friction=None, substeps=4, actuation=taut.drives.Actuation(delay=2e-3, bandwidth=300.0))
    sensing = taut.Sensing(velocity=taut.sensors.Difference(cutoff=80.0))
    loop = loop_of(laws.GravityPID(kp=60.0, kd=5.0, ki=30.0), arm, plant, sensing=sensing)
    tip = taut.analysis.tool_impedance(loop, at=[0.4, 0.9], direction=[1.0, 0.0, 0.0])
    omega = np.array([2.0, 20.0, 200.0])
    assert pytest.approx(tip.Z(omega), rel=2e-3) == measured_Z(tip, omega)


def test_a_force_moves_the_tool_by_the_admittance() -> None:
    """Delta X = Y Delta F, in a run with a spring's pull and no frequency in it."""
    arm = taut.load_arm("planar2")
    q = np.array([0.4, 0.9])
    ctrl = taut.compile(laws.GravityPID(kp=60.0, kd=12.0), arm)
    force = np.array([0.02, 0.0, 0.0])
    push = taut.environments.Push(peak=force, t=0.0, duration=100.0, shape="rectangular")
    run = taut.run(ctrl, Plant(arm, friction=None, environment=push), taut.JointMotion(q=q), duration=6.0, q0=q)
    moved = taut.snapshot(arm, run.q[-1]).T().p - taut.snapshot(arm, q).T().p
    loop = taut.Loop(ctrl, Plant(arm, friction=None), taut.JointMotion(q=q), duration=1.0)
    tip = taut.analysis.tool_impedance(loop, at=q, direction=[1.0, 0.0, 0.0])
    assert moved[0] == pytest.approx(tip.Y(0.0)[0].real * force[0], abs=2e-7)


def test_an_environment_of_the_plant_adds_its_impedance() -> None:
    arm = weightless("gantry3")
    plant = Plant(arm, friction=None, environment=taut.environments.Spring(stiffness=100.0))
    loop = loop_of(laws.PID(kp=900.0, kd=60.0), arm, plant)
    loop.parameters["environment.stiffness"] = 300.0
    assert taut.analysis.tool_impedance(loop, direction=Z_AXIS).Z(0.0)[0].real == pytest.approx(1200.0)


def test_a_law_with_a_steady_state_error_is_measured_where_it_rests() -> None:
    """The reference is held at at=, and the tool hangs below: not once more below."""
    loop = loop_of(laws.PID(kp=60.0, kd=12.0), taut.load_arm("planar2"))
    tip = taut.analysis.tool_impedance(loop, at=[0.4, 0.9], direction=[1.0, 0.0, 0.0])
    assert np.abs(tip.lin.point.moved).max() > 0.1
    omega = np.array([2.0, 20.0])
    assert pytest.approx(tip.Z(omega), rel=1e-4) == measured_Z(tip, omega)


def test_what_no_force_moves_is_infinitely_hard() -> None:
    arm = taut.load_arm("planar2")
    drives = Plant(arm, takes="velocity", friction=None, actuation=taut.drives.Actuation(bandwidth=100.0))
    tip = taut.analysis.tool_impedance(
        loop_of(laws.VelocityPI(kp=10.0), arm, drives), at=[0.4, 0.9], direction=Z_AXIS
    )
    omega = np.array([0.0, 1.0, 100.0])
    assert np.isinf(tip.Z(omega)).all()
    assert np.abs(measured_Z(tip, omega[1:])).min() > 1e12
    free = taut.analysis.tool_impedance(
        loop_of(laws.GravityCompensation(kd=1.0), arm), at=[0.4, 0.9], direction=[1.0, 0.0, 0.0]
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert free.Z(0.0)[0] == 0.0
        assert np.isinf(free.Y(0.0)[0])
    integral = planar_tip(kp=60.0, kd=5.0, ki=30.0)
    assert np.isinf(integral.Z(0.0)[0])
    assert np.isfinite(integral.Z(1e-3)[0])


@pytest.mark.long
def test_motion_control_is_hard_to_move_and_force_control_easy() -> None:
    arm = taut.load_arm("panda")
    free = Plant(arm, friction=None, environment=taut.environments.Push())
    loops = {
        "force": loop_of(laws.ForceControl(kfp=1.0, kdamp=(50.0, 5.0), feedback="wrench"), arm, free),
        "motion": loop_of(laws.ComputedTorque(kp=900.0, kd=60.0), arm),
        "impedance": loop_of(laws.Impedance(K=(300.0, 20.0), zeta=0.7), arm),
    }
    sizes = {
        name: abs(taut.analysis.tool_impedance(loop, direction=Z_AXIS).Z(1.0)[0]) for name, loop in loops.items()
    }
    assert sorted(sizes, key=sizes.__getitem__) == ["force", "impedance", "motion"]


def test_its_table_has_the_specified_impedance_beside_the_predicted(impedance: taut.Loop) -> None:
    ((row, *_),) = taut.analysis.tool_impedance(impedance, direction=Z_AXIS).json()["tables"].values()
    assert list(row) == ["frequency [Hz]", "|Z| [N/m]", "specified [N/m]", "difference [%]"]
    assert row["|Z| [N/m]"] == pytest.approx(row["specified [N/m]"], rel=0.01)


planar = taut.load_arm("planar2")


def tip_of(law: taut.Law) -> taut.analysis.ToolImpedance:
    return taut.analysis.tool_impedance(loop_of(law, taut.load_arm("planar2")), direction=Z_AXIS, within=2.0)


def planar_tip(**gains: float) -> taut.analysis.ToolImpedance:
    arm = taut.load_arm("planar2")
    return taut.analysis.tool_impedance(
        loop_of(laws.GravityPID(**gains), arm), at=[0.4, 0.9], direction=[1.0, 0.0, 0.0]
    )


MISUSE: dict[str, tuple[Callable[[], object], str]] = {
    "direction": (
        lambda: taut.analysis.tool_impedance(
            loop_of(laws.GravityPID(kp=60.0, kd=5.0), taut.load_arm("planar2")), at=[0.4, 0.9], direction=[0, 1.0, 0]
        ),
        "direction",
    ),
    "two numbers": (lambda: taut.analysis.tool_impedance(loop_of(laws.PID(kp=9.0), planar), direction=[1, 0]), "direction"),
    "no direction": (lambda: taut.analysis.tool_impedance(loop_of(laws.PID(kp=9.0), planar), direction=[0, 0, 0]), "direction"),
    "nothing specified": (
        lambda: tip_of(laws.Stiffness(K=(800.0, 30.0), kd=5.0)).specified_Z(1.0), "specified"
    ),
    "another tool": (
        lambda: tip_of(laws.Impedance(K=(800.0, 30.0), zeta=1.0, tool="link2")).specified_Z(1.0),
        "specified",
    ),
    "specified at rest": (lambda: tip_of(laws.Impedance(K=(800.0, 30.0), zeta=1.0)).specified_Z(0.0), "omega"),
}  # fmt: skip


@pytest.mark.part(1)
@pytest.mark.parametrize("case", MISUSE)
def test_bad_input_is_refused_by_name(case: str) -> None:
    call, name = MISUSE[case]
    with pytest.raises(taut.TautError) as caught:
        call()
    assert caught.value.name == name
