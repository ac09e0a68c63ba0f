"""What a tool under impedance control does when it is pushed, against its equation 10.46 as it is sampled."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from impedance_tools import Kick, Shaker, deviation, inertia, poses_of
from refusals import refused
from scipy.linalg import expm

import taut

ARMS = ["panda", "ur10", "xarm7"]
K = np.array([800.0, 800.0, 800.0, 30.0, 30.0, 30.0])
T = 1e-3
SMALL = [0.2, 0.2, 0.2, 0.005, 0.005, 0.005]
STATIC = 0.01  # MATHS section 3
SWEPT = 0.02


def at(arm: taut.Arm, q: Any) -> taut.TaskMotion:
    return taut.TaskMotion(pose=taut.snapshot(arm, q).T())


def impedance(**gains: Any) -> taut.Law:
    return taut.laws.Impedance(**({"K": K, "zeta": 0.7} | gains))


def shaken(arm: taut.Arm, law: taut.Law, q: Any, duration: float = 4.0, **shaker: Any) -> taut.Loop:
    plant = taut.RigidPlant(arm, friction=None, environment=Shaker(**shaker))
    return taut.Loop(taut.compile(law, arm), plant, at(arm, q), duration=duration)


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ARMS)
def test_a_constant_wrench_moves_the_tool_by_the_wrench_over_the_stiffness(name: str) -> None:
    arm = taut.load_arm(name)
    q = poses_of(arm, 1, 3)[0]
    F = np.array([4.0, -3.0, 2.0, 0.1, 0.2, -0.15])
    run = taut.run(shaken(arm, impedance(zeta=1.0), q, constant=F), q0=q)
    x = deviation(run, taut.snapshot(arm, q).T(), every=4000)[-1]
    assert np.abs(x - F / K).max() <= STATIC * np.abs(F / K).max()


def response(arm: taut.Arm, loop: taut.Loop, q: Any, frequency: float) -> Any:
    """(6,) complex amplitude of the deviation over the last whole cycles."""
    loop.parameters["environment.frequency"] = frequency
    run = taut.run(loop, q0=q)
    pose = taut.snapshot(arm, q).T()
    every = 5
    x = deviation(run, pose, every)
    t = run.t[::every]
    cycles = max(1.0, np.floor(2.0 * frequency))
    last = t > t[-1] - cycles / frequency
    wave = np.exp(2j * np.pi * frequency * t[last])
    design = np.column_stack([wave.real, wave.imag, np.ones(last.sum())])
    fit = np.linalg.lstsq(design, x[last], rcond=None)[0]
    return fit[0] - 1j * fit[1]


def predicted(Lam: Any, B: Any, frequency: float, F: Any) -> Any:
    """The deviation of the loop as it is sampled: v+ = v + T a, x+ = x + T v+, the wrench a sine."""
    inverse, eye = np.linalg.inv(Lam), np.eye(6)
    a_x, a_v = -inverse @ np.diag(K), -inverse @ B
    A = np.block([[eye + T * T * a_x, T * (eye + T * a_v)], [T * a_x, eye + T * a_v]])
    b = np.concatenate([T * T * inverse @ F, T * inverse @ F])
    z = np.exp(2j * np.pi * frequency * T)
    return np.linalg.solve(z * np.eye(12) - A, b)[:6] * -1j  # sin is the imaginary part


def modal(Lam: Any, zeta: float) -> Any:
    """B with the damping ratio zeta in each mode, by SciPy."""
    from scipy.linalg import eigh

    values, vectors = eigh(np.diag(K), Lam)
    back = np.linalg.inv(vectors)
    return back.T @ np.diag(2.0 * zeta * np.sqrt(values)) @ back


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ARMS)
def test_a_swept_sine_meets_the_sampled_impedance_in_every_direction(name: str) -> None:
    arm = taut.load_arm(name)
    q = poses_of(arm, 1, 4)[0]
    Lam = inertia(arm, q)
    F = np.array([0.5, 0.4, -0.3, 0.02, -0.02, 0.01])
    loop = shaken(arm, impedance(), q, amplitude=F)
    omega = np.sqrt(K[2] / Lam[2, 2])
    for factor in (0.25, 1.0, 2.0, 4.0):
        frequency = factor * omega / (2.0 * np.pi)
        measured, wanted = response(arm, loop, q, frequency), predicted(Lam, modal(Lam, 0.7), frequency, F)
        for part in (slice(0, 3), slice(3, 6)):
            assert np.abs(measured[part] - wanted[part]).max() <= SWEPT * np.abs(wanted[part]).max()


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ARMS)
def test_the_damping_ratio_is_the_asked_one_in_every_mode_at_five_poses(name: str) -> None:
    arm = taut.load_arm(name)
    zeta = 0.35
    ctrl = taut.compile(impedance(zeta=zeta), arm)
    plant = taut.RigidPlant(arm, friction=None)
    for q in poses_of(arm, 5, 5):
        Lam = inertia(arm, q)
        from scipy.linalg import eigh

        values, vectors = eigh(np.diag(K), Lam)
        ref = at(arm, q)
        loop = taut.Loop(ctrl, plant, ref, duration=0.5)
        for mode in range(0, 6, 2):
            # Start at rest, off along one mode: it decays alone, as its own oscillator, sampled.
            x0 = 2e-4 * vectors[:, mode] / np.abs(vectors[:, mode]).max()
            J = taut.snapshot(arm, q).J()
            run = taut.run(loop, q0=q + np.linalg.pinv(J) @ x0)
            y = deviation(run, ref.pose) @ (Lam @ vectors[:, mode])
            fit = np.linalg.lstsq(np.column_stack([y[1:-1], y[:-2]]), y[2:], rcond=None)[0]
            poles = np.log(np.roots([1.0, -fit[0], -fit[1]]).astype(complex)) / T
            w = np.sqrt(values[mode])
            step = np.array(
                [[1.0 - T * T * w * w, T * (1.0 - 2.0 * zeta * w * T)], [-T * w * w, 1.0 - 2.0 * zeta * w * T]]
            )
            sampled = np.log(np.linalg.eigvals(step).astype(complex)) / T
            got, wanted = (-p.real.mean() / np.abs(p).mean() for p in (poles, sampled))
            assert got == pytest.approx(wanted, rel=0.01)
            assert wanted == pytest.approx(zeta, rel=0.1)


@pytest.mark.part(1)
@pytest.mark.parametrize("error", ["decoupled", "body", "space"])
def test_a_wrist_sensor_makes_any_inertia_felt(error: str) -> None:
    arm = taut.load_arm("panda")
    q = poses_of(arm, 1, 6)[0]
    D, B = np.diag([2.0, 3.0, 4.0, 0.1, 0.2, 0.1]), np.diag([60.0, 60.0, 60.0, 3.0, 3.0, 3.0])
    if error == "space":  # about the world's origin: rotations there move the tool far
        D, B = 4.0 * np.eye(6), 60.0 * np.eye(6)
    law = impedance(D=D, B=B, zeta=None, error=error)
    F = np.array([2.0, -1.0, 1.5, 0.05, 0.1, -0.05])
    run = taut.run(shaken(arm, law, q, duration=1.0, amplitude=F, frequency=1.0), q0=q)
    pose = taut.snapshot(arm, q).T()
    x, R = deviation(run, pose), pose.R
    turn = np.kron(np.eye(2), R.T) if error == "body" else np.eye(6)
    if error == "space":
        P = taut.math.skew(pose.p)
        turn = np.block([[np.eye(3), P], [np.zeros((3, 3)), np.eye(3)]])
    moved = np.zeros((len(run.t), 12))
    back = np.linalg.inv(turn)
    Lam = back.T @ inertia(arm, q) @ back
    F_own = np.outer(np.sin(2.0 * np.pi * run.t), back.T @ F)
    for k in range(len(run.t) - 1):
        seen = F_own[max(k - 1, 0)]  # the sensor gives the wrench of the last step
        a = np.linalg.solve(D, seen - B @ moved[k, 6:] - K * moved[k, :6]) + np.linalg.solve(Lam, F_own[k] - seen)
        moved[k + 1, 6:] = moved[k, 6:] + T * a
        moved[k + 1, :6] = moved[k, :6] + T * moved[k + 1, 6:]
    wanted = moved[:, :6] @ back.T
    for part in (slice(0, 3), slice(3, 6)):
        assert np.abs(x - wanted)[:, part].max() <= 0.01 * np.abs(wanted[:, part]).max()


def test_the_acceleration_of_the_tick_before_serves_below_twice_the_inertia_and_is_refused_above() -> None:
    arm = taut.load_arm("panda")
    q = arm.home
    Lam = inertia(arm, q)
    ref, plant = (
        at(arm, q),
        taut.RigidPlant(arm, friction=None, environment=Kick(wrench_most=SMALL, duration=0.05)),
    )
    for factor in (0.5, 1.9):
        law = impedance(K=(200.0, 2.0), D=factor * Lam, B=(30.0, 0.3), zeta=None, feedback="acceleration")
        run = taut.run(taut.compile(law, arm), plant, ref, duration=4.0)
        assert run.outcome.ok
        assert np.abs(run.v[-1]).max() <= 0.02 * np.abs(run.v).max()
    with refused(taut.errors.RangeError):
        taut.compile(impedance(K=(200.0, 2.0), D=2.1 * Lam, feedback="acceleration"), arm).needs  # noqa: B018


ALGEBRAIC = {"K": (200.0, 2.0), "B": (30.0, 0.3), "zeta": None, "feedback": "acceleration"}


def test_a_new_inertia_that_the_loop_does_not_bear_is_refused_where_the_arm_is() -> None:
    arm = taut.load_arm("panda")
    Lam, ref = inertia(arm, arm.home), at(arm, arm.home)
    ctrl = taut.compile(impedance(D=Lam, **ALGEBRAIC), arm, engine="float")
    ctrl.parameters["law.D"] = 3.0 * Lam  # nobody knows yet where the arm will be
    ctrl.parameters["law.D"] = Lam
    ctrl.step(arm.home, np.zeros(7), ref)
    with refused(taut.errors.RangeError):
        ctrl.parameters["law.D"] = 3.0 * Lam
    assert np.array_equal(ctrl.parameters["law.D"], Lam)
    share = 0.6
    ctrl.parameters["law.B"] = share * np.array([30.0] * 3 + [0.3] * 3)
    ctrl.parameters["law.D"] = share * 3.0 * Lam
    with refused(taut.errors.RangeError):
        ctrl.parameters["law.B"] = np.full(6, 2e4)
    ctrl.reset()
    ctrl.parameters["law.B"] = np.full(6, 2e4)


@pytest.mark.part(1)
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")  # of gains that are refused next
@pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
def test_an_event_that_asks_for_it_ends_the_run_before_it_and_keeps_what_was(plant: Any) -> None:
    arm = taut.load_arm("panda")
    Lam, ref = inertia(arm, arm.home), at(arm, arm.home)
    ctrl = taut.compile(impedance(D=Lam, **ALGEBRAIC), arm)
    change = {"law.D": 3.0 * Lam}
    run = taut.run(ctrl, plant(arm, friction=None), ref, duration=0.1, events=[taut.Event(t=0.05, set=change)])
    assert (run.outcome.kind, len(run), run.outcome.tick) == ("stopped", 50, 49)
    assert run.outcome.message.startswith("stopped at t = 0.05 s, before the event that sets law.D: feedback=")
    with refused(taut.errors.RangeError):
        taut.run(ctrl, plant(arm, friction=None), ref, duration=0.1, events=[taut.Event(t=0.0, set=change)])
    allowed = [taut.Event(t=0.05, set={"law.D": 1.5 * Lam})]
    assert taut.run(ctrl, plant(arm, friction=None), ref, duration=0.1, events=allowed).outcome.ok


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_above_twice_the_inertia_the_loop_does_diverge(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = taut.load_arm("panda")
    Lam = inertia(arm, arm.home)
    monkeypatch.setattr(taut.laws.Impedance, "check_state", lambda *_: None)
    law = impedance(K=(200.0, 2.0), D=2.1 * Lam, B=(10.0, 0.05), zeta=None, feedback="acceleration")
    plant = taut.RigidPlant(arm, friction=None, environment=Kick(wrench_most=SMALL, duration=0.05))
    run = taut.run(taut.compile(law, arm), plant, at(arm, arm.home), duration=1.0)
    assert not run.outcome.ok or np.abs(run.v).max() > 10.0


@pytest.mark.part(1)
@pytest.mark.parametrize("frame", ["world", "task", "tool"])
def test_stiffness_has_the_axes_that_it_is_given_in(frame: str) -> None:
    arm = taut.load_arm("panda")
    q = poses_of(arm, 1, 8)[0]
    T_WE = taut.snapshot(arm, q).T()
    six = np.array([200.0, 600.0, 1500.0, 20.0, 30.0, 40.0])
    F = np.array([0.3, -0.2, 0.4, 0.02, -0.01, 0.015])  # small: a spring of the tool turns with it
    run = taut.run(shaken(arm, impedance(K=six, zeta=1.0, frame=frame), q, constant=F), q0=q)
    x = deviation(run, T_WE, every=4000)[-1]
    R = np.eye(3) if frame == "world" else T_WE.R
    turn = np.kron(np.eye(2), R)
    wanted = turn @ ((turn.T @ F) / six)
    assert np.abs(x - wanted).max() <= 0.02 * np.abs(wanted).max()


def test_a_tracking_error_falls_with_stiffness_as_predicted() -> None:
    arm = taut.load_arm("panda")
    heavy = arm.with_payload(0.5)  # what the controller does not know
    line = taut.snapshot(arm, arm.home).T()
    ref = taut.TaskMotion(pose=line)
    for k in (400.0, 1600.0):
        law = impedance(K=(k, 60.0), zeta=1.0)
        run = taut.run(taut.compile(law, arm), taut.RigidPlant(heavy, friction=None), ref, duration=4.0)
        sag = deviation(run, line, every=4000)[-1][2]
        assert sag == pytest.approx(-0.5 * 9.81 / k, rel=0.1)


def test_a_moving_reference_is_followed_without_error_by_an_exact_model() -> None:
    arm = taut.load_arm("panda")
    T0 = taut.snapshot(arm, arm.home).T()

    class Wave:
        def at(self, t: float) -> taut.TaskMotion:
            w, A = 2.0 * np.pi * 0.5, 0.05
            p, v, a = A * (1.0 - np.cos(w * t)), A * w * np.sin(w * t), A * w * w * np.cos(w * t)
            pose = taut.Pose([T0.p[0], T0.p[1] + p, T0.p[2]], R=T0.R)
            return taut.TaskMotion(pose=pose, twist=[0, v, 0, 0, 0, 0], acceleration=[0, a, 0, 0, 0, 0])

    errors = []
    for k in (100.0, 1600.0):
        run = taut.run(
            taut.compile(impedance(K=(k, 60.0)), arm), taut.RigidPlant(arm, friction=None), Wave(), duration=2.0
        )
        errors.append(np.abs(run.task.position_error).max())
    assert errors[0] <= 2e-3  # what a step of 1 ms leaves
    assert errors[1] <= 0.5 * errors[0]


# ------------------------------------------------------------------ energy


def work_on_the_arm(run: taut.Run) -> Any:
    """[J] what the environment has given until each tick."""
    return run.extra["work.environment"]


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("frame", ["world", "tool"])
def test_it_gives_back_no_more_than_it_got(name: str, frame: str) -> None:
    arm = taut.load_arm(name)
    q = poses_of(arm, 1, 9)[0]
    stiff = np.array([300.0, 900.0, 1500.0, 20.0, 60.0, 40.0])
    law = impedance(
        K=stiff, B=1.5 * stiff * T + np.array([2.0] * 3 + [0.1] * 3), zeta=None, frame=frame, coriolis="keep"
    )
    plant = taut.RigidPlant(
        arm, friction=None, environment=Shaker(amplitude=[8.0, 5.0, -6.0, 0.5, 0.4, -0.6], frequency=1.7)
    )
    run = taut.run(taut.compile(law, arm), plant, at(arm, q), q0=q, duration=5.0)
    assert run.outcome.ok
    assert work_on_the_arm(run).min() >= -1e-6


@pytest.mark.part(1)
@pytest.mark.parametrize(("share", "gives"), [(0.0, True), (1.5, False)])
def test_a_held_torque_gives_energy_without_damping_and_none_with_k_dt_and_more(share: float, gives: bool) -> None:
    arm = taut.load_arm("panda")
    q = poses_of(arm, 1, 9)[0]
    stiff, dt = np.array([1000.0] * 3 + [40.0] * 3), 0.01
    law = impedance(K=stiff, B=share * stiff * dt, zeta=None, coriolis="keep", null=None)
    shaker = Shaker(amplitude=[8.0, 5.0, -6.0, 0.05, 0.04, -0.06], frequency=1.7)
    # Many steps in a period, in which the torque is held: one step alone would hide what the hold does.
    plant = taut.RigidPlant(arm, friction=None, substeps=50, environment=shaker)
    run = taut.run(taut.compile(law, arm, rate=1.0 / dt), plant, at(arm, q), q0=q, duration=5.0)
    least = np.nanmin(work_on_the_arm(run))
    assert least < -1.0 if gives else least >= -1e-6


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_stiff_spring_without_damping_does_gain_energy_from_being_sampled() -> None:
    arm = taut.load_arm("panda")
    law = impedance(K=(20000.0, 1000.0), B=(0.0, 0.0), zeta=None, null=None)
    plant = taut.RigidPlant(
        arm, friction=None, environment=Kick(wrench_most=[5.0, 3.0, 4.0, 0.0, 0.0, 0.0], duration=0.02)
    )
    ctrl = taut.compile(law, arm, rate=100.0)
    run = taut.run(ctrl, plant, at(arm, arm.home), duration=1.0)
    assert not run.outcome.ok or np.abs(run.v[-1]).max() > 1.0


@pytest.mark.part(1)
@pytest.mark.parametrize("tank", [0.1, 0.02])
def test_a_tank_bounds_what_a_stiffer_spring_brings_in(tank: float) -> None:
    arm = taut.load_arm("panda")
    T0 = taut.snapshot(arm, arm.home).T()
    law = taut.laws.EnergyTank(law=impedance(K=(200.0, 20.0), zeta=0.7), capacity=tank, settle=0.02)
    plant = taut.RigidPlant(arm, friction=None, environment=Shaker(constant=[0.0, 0.0, 20.0, 0.0, 0.0, 0.0]))
    event = taut.Event(t=2.0, set={"law.K": (2000.0, 20.0)})
    run = taut.run(taut.compile(law, arm), plant, taut.TaskMotion(pose=T0), duration=2.2, events=[event])
    z = deviation(run, T0)[:, 2]
    assert z[1990] == pytest.approx(0.1, rel=0.02)
    needed = 0.5 * 1800.0 * 0.1**2
    assert needed > tank
    work = work_on_the_arm(run)
    speed = np.array(
        [taut.snapshot(arm, q, v).kinetic_energy for q, v in zip(run.q[2000:], run.v[2000:], strict=True)]
    )
    # What the arm gave away to the world and has as motion comes from the first spring and the tank.
    given = work[1999] - work[1999:].min()
    assert given + speed.max() <= 0.5 * 200.0 * 0.1**2 + tank + 0.02
    jump = np.abs(np.diff(run.tau[1998:2003], axis=0)).max()
    assert jump < 12.0


def test_without_a_tank_the_same_change_throws_the_arm() -> None:
    arm = taut.load_arm("panda")
    T0 = taut.snapshot(arm, arm.home).T()
    plant = taut.RigidPlant(arm, friction=None, environment=Shaker(constant=[0.0, 0.0, 20.0, 0.0, 0.0, 0.0]))
    event = taut.Event(t=2.0, set={"law.K": (2000.0, 20.0)})
    run = taut.run(
        taut.compile(impedance(K=(200.0, 20.0)), arm), plant, taut.TaskMotion(pose=T0), duration=2.2, events=[event]
    )
    energy = [taut.snapshot(arm, q, v).kinetic_energy for q, v in zip(run.q[2000:], run.v[2000:], strict=True)]
    assert max(energy) > 1.0  # [J], where the tanks of the test above hold 0.1 and 0.02


def test_a_stiffness_that_depends_on_the_pose_is_no_source_of_energy_with_a_tank() -> None:
    arm = taut.load_arm("panda")
    T0 = taut.snapshot(arm, arm.home).T()
    x0 = float(T0.p[0])

    def stiff_on_one_side(T: taut.Pose) -> Any:
        return [taut.math.where(T.p[0] > x0, 3000.0, 300.0), 30.0]

    spring = impedance(K=(300.0, 30.0), B=(8.0, 1.0), zeta=None)
    law = taut.laws.EnergyTank(law=spring, stiffness=stiff_on_one_side, capacity=0.05, settle=0.005)
    plant = taut.RigidPlant(arm, friction=None, environment=Shaker(amplitude=[10.0, 10.0, 0, 0, 0, 0], frequency=1.3))
    run = taut.run(taut.compile(law, arm), plant, taut.TaskMotion(pose=T0), duration=6.0)
    assert run.outcome.ok
    assert work_on_the_arm(run).min() >= -0.05 - 1e-3


def test_expm_is_what_a_free_mode_does() -> None:
    # The tools of this file against the exact solution: an oscillator sampled at 1 ms tends to its matrix exponential.
    w, zeta = 10.0, 0.7
    exact = expm(np.array([[0.0, 1.0], [-w * w, -2.0 * zeta * w]]) * T)
    step = np.array([[1.0 - T * T * w * w, T * (1.0 - 2.0 * zeta * w * T)], [-T * w * w, 1.0 - 2.0 * zeta * w * T]])
    assert np.abs(exact - step).max() <= 0.01


def test_a_run_keeps_the_energy_of_the_tank() -> None:
    arm = taut.load_arm("planar3")
    position = taut.Coordinates(function=lambda T: taut.math.array([T.p[0], T.p[2]]))
    spring = taut.laws.Impedance(
        K=[100.0, 100.0], B=[10.0, 10.0], error="coordinates", coordinates=position, null=None
    )
    law = taut.laws.EnergyTank(law=spring, capacity=0.5)
    events = [taut.Event(t=0.05, set={"law.K": [400.0, 400.0]})]
    target = taut.TaskMotion(pose=taut.snapshot(arm, np.add(arm.home, 0.1)).T())
    run = taut.run(taut.compile(law, arm), taut.RigidPlant(arm), target, duration=0.1, events=events)
    energy = run.extra["law.energy"]
    assert energy[:50] == pytest.approx(0.5, abs=1e-9)
    assert 0.0 <= energy[-1] < 0.4  # what the stiffer spring has cost
    panda = taut.load_arm("panda")
    without = taut.run(taut.compile(impedance(), panda), taut.RigidPlant(panda), at(panda, panda.home), duration=0.01)
    assert "law.energy" not in without.extra
