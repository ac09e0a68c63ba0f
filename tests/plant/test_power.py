"""Power in is power out, plus each named loss, plus what is stored: in every step of the integrator, and over a run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import taut
from taut.base.types import Float64Array
from taut.plant.motion import WORK

CLOSES = 1e-9  # of the sum of all parts' magnitudes
DT = 1e-4

GEARED = taut.load_arm("panda").with_gears(ratio=[100.0] * 4 + [50.0] * 3, motor_inertia=2e-5)
ROUGH = GEARED.with_friction(
    taut.Friction(viscous=0.5, coulomb=1.0, static=1.5, stribeck=0.05, load_motor=0.05, load_external=0.02)
)
ELECTRIC = taut.drives.ElectricMotor(
    torque_constant=0.05, resistance=1.2, inductance=1e-3, voltage=48.0, current=15.0
)
PLAIN: dict[str, Any] = {"bandwidth": 2000.0, "ripple": taut.drives.Ripple(amplitude=0.05, periods=6)}
SOFT = taut.drives.Transmission(stiffness=3e3, damping=2.0, efficiency=0.85)
PLAY = taut.drives.Transmission(stiffness=5e3, damping=1.0, backlash=0.002, efficiency=0.9)
MIXED = taut.drives.Transmission(
    stiffness=[np.inf, 3e3, np.inf, 3e3, 3e3, np.inf, 3e3], damping=[0, 1, 0, 1, 1, 0, 1]
)

CASES: dict[str, tuple[taut.Arm, dict[str, Any]]] = {
    "ideal": (taut.load_arm("panda"), {}),
    "rotors": (GEARED, {}),
    "friction": (ROUGH, {}),
    "lossy gears": (ROUGH, {"transmission": taut.drives.Transmission(efficiency=[0.8] * 4 + [0.5] * 3)}),
    "lag and ripple": (ROUGH, PLAIN),
    "a motor's curve": (ROUGH, {"motor": taut.drives.Motor(peak=1.0, stall=1.2, no_load=300.0), "bandwidth": 500.0}),
    "electric": (ROUGH, {"motor": ELECTRIC, **PLAIN}),
    "electric without inductance": (ROUGH, {"motor": taut.drives.ElectricMotor(torque_constant=0.05, resistance=1.2), **PLAIN}),
    "elastic": (ROUGH, {"transmission": SOFT, "motor": ELECTRIC, "bandwidth": 3000.0}),
    "play": (ROUGH, {"transmission": PLAY}),
    "some joints elastic": (ROUGH, {"transmission": MIXED}),
    "inner loop": (ROUGH, {"torque_loop": taut.drives.TorqueLoop(kp=0.5, ki=50.0), "bandwidth": 2000.0}),
}  # fmt: skip
LOSSES = ("viscous", "dry", "gears", "copper")


def plant_of(name: str, **options: Any) -> taut.RigidPlant:
    arm, drives = CASES[name]
    return taut.RigidPlant(arm, actuation=taut.drives.Actuation(**drives), energy=True, substeps=10, **options)


def parameters_of(plant: taut.RigidPlant) -> dict[str, Any]:
    return {path: value.copy() if value.ndim else value[()] for path, value in plant.parameters.items()}


def parts(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Float64Array]:
    """(n,) [J] of each part in a step."""
    n = len(after["q"])
    work = {name: np.zeros(n) for name in WORK}
    return work | {name[5:]: after[name] - before[name] for name in after if name.startswith("work.")}


def steps(name: str, count: int = 60) -> Any:
    """(before, after) of steps under torques that change every ten steps, from a moving start."""
    plant = plant_of(name)
    rng, p = np.random.default_rng(3), parameters_of(plant)
    arm = plant.arm
    memory = plant.start(arm.home + 0.1, rng.normal(scale=0.5, size=arm.n), p, 10 * DT)
    weight = memory["tau"].copy()
    for k in range(count):
        if k % 10 == 0:
            memory = plant.command(weight + rng.normal(scale=8.0, size=arm.n), memory, k * DT)
        after = plant.advance(memory, p, DT)
        yield plant, p, memory, after
        memory = after


@pytest.mark.part(2)
@pytest.mark.bars
@pytest.mark.parametrize("name", CASES)
def test_power_in_is_power_out_plus_each_loss_plus_what_is_stored(name: str, bar: Any) -> None:
    worst = 0.0
    for _, _, before, after in steps(name):
        w = parts(before, after)
        gone = sum(w[k] for k in ("rotor", "viscous", "dry", "gears", "spring", "damping", "link", "integration"))
        scale = sum(np.abs(value) for value in w.values())
        worst = max(worst, float((np.abs(w["motor"] - gone) / np.maximum(scale, 1e-300)).max()))
        assert (np.abs(w["motor"] - gone) <= CLOSES * scale).all()
        if "work.electric" in after:
            taken = w["copper"] + w["magnetic"] + w["motor"] + w["conversion"]
            assert (np.abs(w["electric"] - taken) <= CLOSES * scale).all()
    bar(f"power balance of a step, {name}: what is missing, relative", worst)


@pytest.mark.part(1)
@pytest.mark.parametrize("name", CASES)
def test_what_is_done_on_the_links_is_what_their_motion_takes(name: str) -> None:
    """The link's part comes from the motor's end; inverse dynamics of the links alone is the other end."""
    for plant, _, before, after in steps(name):
        a = (after["v"] - before["v"]) / DT
        bare = plant.arm.with_joints(rotor_inertia=0.0)
        torque = taut.snapshot(bare, before["q"], before["v"]).inverse_dynamics(a)
        scale = np.abs(after["tau"]).max()
        np.testing.assert_allclose(after["tau_link"], torque, rtol=0.0, atol=1e-8 * scale)
        link = parts(before, after)["link"]
        np.testing.assert_allclose(link, torque * (after["q"] - before["q"]), rtol=0.0, atol=1e-8 * scale * DT)


@pytest.mark.part(2)
@pytest.mark.parametrize("name", CASES)
def test_losses_only_take(name: str) -> None:
    lost = dict.fromkeys(LOSSES, 0.0)
    for _, _, before, after in steps(name):
        w = parts(before, after)
        for part in LOSSES:
            assert (w[part] >= -1e-15).all(), part
            lost[part] += float(w[part].sum())
    _, drives = CASES[name]
    assert (lost["copper"] > 0.0) is (type(drives.get("motor")) is taut.drives.ElectricMotor)
    assert (lost["gears"] > 0.0) is ("transmission" in drives and drives["transmission"].lossy)


def test_stored_parts_are_those_of_the_states() -> None:
    for plant, p, before, after in steps("elastic"):
        w = parts(before, after)
        rotor = plant.arm.rotor_inertia
        kinetic = 0.5 * rotor * (after["v_motor"] ** 2 - before["v_motor"] ** 2)
        np.testing.assert_allclose(w["rotor"], kinetic, rtol=0.0, atol=1e-14)
        wound = [m["q_motor"] - m["q"] for m in (before, after)]
        elastic = 0.5 * p["actuation.transmission.stiffness"] * (wound[1] ** 2 - wound[0] ** 2)
        np.testing.assert_allclose(w["spring"], elastic, rtol=0.0, atol=1e-13)
        magnetic = 0.5 * p["actuation.motor.inductance"] * (after["current"] ** 2 - before["current"] ** 2)
        np.testing.assert_allclose(w["magnetic"], magnetic, rtol=0.0, atol=1e-14)


class TestElectricMotor:
    @pytest.mark.parametrize("saturated", [False, True])
    def test_current_heat_and_mean_torque_are_those_of_the_winding(self, saturated: bool) -> None:
        """One step under a held voltage and speed, against SciPy on L di/dt = V - R i - k omega."""
        arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_gears(ratio=20.0, motor_inertia=1e-4)
        motor = taut.drives.ElectricMotor(torque_constant=0.05, resistance=1.2, inductance=2e-3, voltage=24.0)
        plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(motor=motor, bandwidth=800.0), energy=True)
        p, dt, k = parameters_of(plant), 1e-3, 0.05 * 20.0
        memory = plant.start(np.zeros(1), np.array([2.0]), p, dt)
        memory["current"] = np.array([1.5])
        memory = plant.command(np.array([30.0 if saturated else 1.0]), memory, 0.0)
        after = plant.advance(memory, p, dt)
        target = memory["held"][0] / k
        goal = target + (1.5 - target) * np.exp(-800.0 * dt)
        left = np.exp(-1.2 * dt / 2e-3)
        voltage = min(24.0, k * 2.0 + 1.2 * (goal - 1.5 * left) / (1.0 - left))
        assert bool(voltage == 24.0) is saturated

        def winding(t: float, y: Float64Array) -> list[float]:
            return [(voltage - 1.2 * y[0] - k * 2.0) / 2e-3, y[0], 1.2 * y[0] ** 2]

        i, charge, heat = solve_ivp(winding, (0.0, dt), [1.5, 0.0, 0.0], rtol=1e-12, atol=1e-14).y[:, -1]
        assert after["current"][0] == pytest.approx(i, rel=1e-9)
        assert after["tau"][0] == pytest.approx(k * charge / dt, rel=1e-9)
        assert after["work.copper"][0] == pytest.approx(heat, rel=1e-9)
        assert after["work.electric"][0] == pytest.approx(voltage * charge, rel=1e-9)
        if not saturated:
            assert i == pytest.approx(goal, rel=1e-9)

    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_under_full_voltage_it_runs_up_to_its_no_load_speed(self) -> None:
        arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_joints(viscous=0.0)
        motor = taut.drives.ElectricMotor(torque_constant=0.5, resistance=1.0, inductance=1e-3, voltage=12.0)
        push = taut.compile(taut.laws.PID(kp=1.0), arm)
        run = taut.run(
            push,
            taut.RigidPlant(arm, actuation=taut.drives.Actuation(motor=motor)),
            taut.JointMotion(q=[1e3]),
            duration=30.0,
        )
        assert run.v[-1, 0] == pytest.approx(24.0, rel=1e-3)
        assert run.tau[30, 0] == pytest.approx(6.0 * (1.0 - run.v[30, 0] / 24.0), rel=0.02)

    def test_a_motor_that_is_driven_gives_power_back(self) -> None:
        """Braking a load from speed: the supply is charged where copper leaves something."""
        arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0])
        motor = taut.drives.ElectricMotor(torque_constant=2.0, resistance=0.1)
        brake = taut.compile(taut.laws.GravityCompensation(kd=2.0), arm)
        plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(motor=motor), energy=True)
        run = taut.run(brake, plant, duration=1.0, v0=[10.0])
        taken, heat = run.extra["work.electric"][-1, 0], run.extra["work.copper"][-1, 0]
        assert taken < -10.0
        assert heat > 0.1


def run_of(name: str, rate: float) -> tuple[taut.Run, taut.RigidPlant]:
    plant = plant_of(name)
    arm = plant.arm
    # Made for a tenth of a millisecond and less, so that the law's own sampling does not show.
    ctrl = taut.compile(taut.laws.PID(kp=60.0, kd=8.0), arm, rate=rate)
    return taut.run(ctrl, plant, taut.JointMotion(q=arm.home + 0.2), duration=0.3), plant


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["rotors", "friction", "electric", "elastic", "lossy gears"])
def test_the_energy_balance_of_a_run_converges_with_the_order_of_the_integrator(name: str) -> None:
    """Semi-implicit Euler is of first order: half the step, half of what is missing."""
    missing = []
    for rate in (500.0, 1000.0, 2000.0):
        run, plant = run_of(name, rate)
        assert run.outcome.ok
        bare = plant.arm.with_joints(rotor_inertia=0.0)
        x0, x1 = (taut.snapshot(bare, run.q[k], run.v[k]) for k in (0, -1))
        stored = (x1.kinetic_energy + x1.potential_energy) - (x0.kinetic_energy + x0.potential_energy)
        done = run.extra["work.link"][-1].sum()
        missing.append(abs(done - stored))
    assert missing[2] < 0.05 * abs(stored) + 0.05
    ratios = np.array(missing[:-1]) / np.array(missing[1:])
    assert ((ratios > 1.7) & (ratios < 2.4)).all(), ratios
    integration = [np.abs(run_of(name, rate)[0].extra["work.integration"][-1].sum()) for rate in (500.0, 1000.0)]
    assert integration[0] > 1.5 * integration[1] or max(integration) < 1e-9


def test_keeping_account_changes_no_motion() -> None:
    arm, drives = CASES["elastic"]
    ctrl = taut.compile(taut.laws.PID(kp=60.0, kd=8.0), arm)
    ref = taut.JointMotion(q=arm.home + 0.2)
    one, other = (
        taut.run(
            ctrl,
            taut.RigidPlant(arm, actuation=taut.drives.Actuation(**drives), substeps=4, energy=e),
            ref,
            duration=0.2,
        )
        for e in (False, True)
    )
    np.testing.assert_allclose(one.q, other.q, rtol=0.0, atol=1e-12)
