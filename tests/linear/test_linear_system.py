"""One linear system: poles, responses, hold and delay, margins, against closed forms, SciPy and python-control."""

from __future__ import annotations

import itertools
import math

import control
import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

import taut
from taut.errors import RangeError, ShapeError, UnknownNameError, UsageError
from taut.linear.joint_loop import second_order
from taut.linear.performance import powers

JOINT = {"M": 0.5, "b": 0.1, "kp": 2.205, "kd": 2.0}  # of the chapter's one-joint arm, figure 10.6


def sorted_poles(poles: np.ndarray) -> np.ndarray:
    return np.sort_complex(np.asarray(poles)[np.abs(poles) > 1e-6])


def test_the_chapter_s_critically_damped_joint_has_its_exact_double_pole_and_settling_time() -> None:
    critical = taut.error_dynamics(**JOINT)
    assert critical.poles.tolist() == [-2.1, -2.1]
    assert critical.zeta.tolist() == [1.0, 1.0]
    step = critical.step()
    assert step.settling_time * 2.1 == pytest.approx(5.833922, abs=1e-6)  # (1 + x) exp(-x) = 0.02
    assert step.overshoot == 0.0
    assert math.isnan(step.peak_time)
    assert critical.decay_rate == pytest.approx(2.1)


@pytest.mark.parametrize("zeta", [0.1, 0.3, 0.7, 0.9])
def test_an_underdamped_step_is_that_of_the_closed_form(zeta: float) -> None:
    step = taut.error_dynamics(zeta=zeta, omega_n=10.0).step()
    damped = math.sqrt(1.0 - zeta**2)
    assert step.overshoot == pytest.approx(100.0 * math.exp(-math.pi * zeta / damped), rel=1e-9)
    assert step.peak_time == pytest.approx(math.pi / (10.0 * damped), rel=1e-8)
    t = step.settling_time
    e = math.exp(-zeta * 10.0 * t) * (math.cos(10.0 * damped * t) + zeta / damped * math.sin(10.0 * damped * t))
    assert abs(e) == pytest.approx(0.02, rel=1e-9)


@pytest.mark.part(1)
@pytest.mark.parametrize("ki", [0.0, 40.0])
@pytest.mark.parametrize("rate", [None, 200.0])
def test_python_control_has_the_same_poles_step_and_margins(rate: float | None, ki: float) -> None:
    joint = taut.error_dynamics(M=0.5, b=0.1, kp=50.0, kd=5.0, ki=ki, rate=rate)
    there = joint.to_control()
    again = taut.LinearSystem.from_control(there)
    assert again.inputs == tuple(name.replace(".", "_") for name in joint.inputs)
    np.testing.assert_allclose(sorted_poles(joint.poles), sorted_poles(there.poles()), atol=1e-9)
    position = there[joint.rows("q[0]")[0], joint.columns("ref.q[0]")[0]]
    info, step = control.step_info(position, T=20.0, T_num=None if rate else 20001), joint.step()
    assert step.settling_time == pytest.approx(info["SettlingTime"], abs=6e-3)
    assert step.overshoot == pytest.approx(info["Overshoot"], abs=0.05)
    assert step.rise_time == pytest.approx(info["RiseTime"], abs=6e-3)
    i, k = joint.columns("disturbance.command[0]"), joint.rows("command[0]")
    B, C = joint.B[:, i], joint.C[k]
    loop = control.ss(joint.A - B @ C, B, -C, 0.0, joint.dt or 0)  # opened where the disturbance adds
    gain, phase, *_ = control.stability_margins(loop)[:6]
    margins = joint.margins()
    assert margins.phase == pytest.approx(phase, abs=1e-3)
    if gain and np.isfinite(gain) and gain > 1.0:
        assert margins.gain[1] == pytest.approx(gain, rel=1e-3)
    disk, *_ = control.disk_margins(loop, np.geomspace(0.01, np.pi * (rate or 1e3), 20000))
    assert margins.disk.alpha == pytest.approx(disk, abs=1e-3)
    omega = np.geomspace(0.1, 500.0, 7)
    np.testing.assert_allclose(
        joint.frequency_response(omega, input="ref.q[0]", output="q[0]"), position(
            1j * omega if rate is None else np.exp(1j * omega * joint.dt)), rtol=1e-9,
    )  # fmt: skip


@settings(deadline=None, max_examples=25)
@given(
    delay=st.floats(0.0, 0.031),
    decay=st.floats(0.0, 20.0),
    stiffness=st.floats(-50.0, 500.0),
    seed=st.integers(0, 99),
)
def test_a_hold_with_any_delay_is_the_exact_motion_between_ticks(
    delay: float, decay: float, stiffness: float, seed: int
) -> None:
    plant = taut.LinearSystem(A=[[0.0, 1.0], [-stiffness, -decay]], B=[[0.0], [1.0]], C=[[1.0, 0.0]], D=[[0.3]])
    dt, inputs = 0.01, np.random.default_rng(seed).normal(size=12)
    sampled = plant.zoh(dt, delay)
    x, seen = np.zeros(len(sampled.A)), []
    for u in inputs:
        seen.append(sampled.C[0] @ x + sampled.D[0] * u)
        x = sampled.A @ x + sampled.B[:, 0] * u
    # The same by small steps of SciPy's own discretisation, between the moments at which the delayed input changes.
    moments = np.unique(np.round(np.concatenate([dt * np.arange(13), dt * np.arange(13) + delay]), 12))
    state = np.zeros(2)
    positions = {0.0: state[0]}
    for t, later in itertools.pairwise(moments):
        k = int(np.floor((0.5 * (t + later) - delay) / dt))
        u = inputs[k] if 0 <= k < len(inputs) else 0.0
        A, B, *_ = scipy.signal.cont2discrete((plant.A, plant.B, np.eye(2), np.zeros((2, 1))), later - t)
        state = A @ state + B[:, 0] * u
        positions[round(later, 12)] = state[0]
    for k, y in enumerate(seen):
        past = k - delay / dt
        direct = 0.3 * inputs[int(np.floor(past + 1e-9))] if past > -1e-9 else 0.0
        assert y[0] == pytest.approx(positions[round(dt * k, 12)] + direct, abs=1e-9 * (1.0 + abs(y[0])))


def test_the_sampled_damping_bound_is_two_masses_a_period() -> None:
    for factor, stable in ((0.999, True), (1.001, False)):
        assert taut.error_dynamics(M=0.5, kp=0.0, kd=factor * 2.0 * 0.5 * 1000.0, rate=1000.0).stable is stable


@pytest.mark.parametrize(
    ("A", "stable"),
    [
        ([[0.0, 1.0], [-50.0, 0.0]], False),  # sustained oscillation
        ([[0.0, 1.0], [-50.0, -1e-3]], True),
        ([[0.0, 1.0], [0.0, -1.0]], True),  # a position that stays where it is put
        ([[0.0, 1.0], [0.0, 0.0]], False),  # drift
        ([[-1e-9, 0.0], [0.0, -1e4]], True),  # slow, but it decays
        ([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]], False),
    ],
)
@pytest.mark.parametrize("sampled", [False, True])
def test_free_positions_are_stable_and_drift_and_sustained_oscillation_are_not(
    A: list[list[float]], stable: bool, sampled: bool
) -> None:
    system = taut.LinearSystem(A=A)
    system = system.zoh(1e-3) if sampled else system
    assert system.stable is stable
    assert bool(system.unstable_because) is not stable


def test_modes_name_their_states() -> None:
    system = taut.error_dynamics(M=np.diag([1.0, 0.1]), kp=[100.0, 1000.0], kd=[2.0, 40.0])
    slow, *fast = system.modes
    assert slow.omega_n == pytest.approx(10.0)
    assert slow.zeta == pytest.approx(0.1)
    assert set([*slow.participation][:2]) == {"plant.q[0]", "plant.v[0]"}
    assert sum(slow.participation.values()) == pytest.approx(1.0)
    assert {mode.s.imag for mode in fast} == {0.0}


def test_a_free_motion_that_the_output_does_not_show_leaves_its_response_finite() -> None:
    system = taut.LinearSystem(A=np.diag([1.0, 0.5]), B=[[1.0], [1.0]], C=[[0.0, 1.0], [1.0, 0.0]], dt=0.1)
    hidden, shown = (system.dc_gain(input="u[0]", output=name) for name in ("y[0]", "y[1]"))
    assert hidden == pytest.approx(2.0)
    assert shown == np.inf


def test_velocity_filters_are_those_of_the_sensing() -> None:
    """The closed loop of a law with a filter is the chain of its difference equations."""
    rate, order = 500.0, 2
    for velocity, position in (
        (taut.sensors.LowPass(cutoff=40.0, order=order), False),
        (taut.sensors.Difference(cutoff=40.0, order=order), True),
        ("difference", True),
    ):
        joint = taut.error_dynamics(M=0.5, b=0.1, kp=50.0, kd=5.0, ki=30.0, rate=rate, velocity=velocity)
        x = np.zeros(len(joint.A))
        x[:2] = 0.3, -0.2
        if position:
            x[joint.state_places("sensing.q_last")] = 0.1
        plant = taut.LinearSystem(A=[[0.0, 1.0], [0.0, -0.2]], B=[[0.0], [2.0]]).zoh(1.0 / rate)
        b, a = (np.ones(1), np.ones(1)) if velocity == "difference" else scipy.signal.butter(order, 40.0, fs=rate)
        ticks, state, raw, q_last, e_int, q = 60, x[:2], [], 0.1, 0.0, []
        for _ in range(ticks):
            q.append(state[0])
            raw.append((state[0] - q_last) * rate if position else state[1])
            q_last, e_int = state[0], e_int - state[0] / rate
            seen = scipy.signal.lfilter(b, a, raw)[-1]
            state = plant.A @ state + plant.B[:, 0] * (-50.0 * state[0] - 5.0 * seen + 30.0 * e_int)
        response = powers(joint.C[joint.rows("q[0]")[0]], joint.A, ticks) @ x
        np.testing.assert_allclose(response, q, rtol=1e-9, atol=1e-12)


def test_a_specification_gives_the_gains_and_the_response_that_was_specified() -> None:
    fast = taut.error_dynamics(M=0.5, b=0.1, settling=0.3, overshoot=5.0).step()
    assert fast.settling_time == pytest.approx(0.3, rel=1e-9)
    assert fast.overshoot == pytest.approx(5.0, rel=1e-9)
    assert second_order(**JOINT).zeta == pytest.approx(1.0, rel=1e-12)
    assert second_order(**JOINT).largest_ki == pytest.approx(9.261)


@pytest.mark.parametrize(
    ("numbers", "error"),
    [
        ({"zeta": 0.7}, UsageError),
        ({"zeta": 0.7, "overshoot": 3.0}, UsageError),
        ({"zeta": 0.7, "omega_n": 10.0, "kd": 3.0}, UsageError),
        ({"zeta": -0.7, "omega_n": 10.0}, RangeError),
        ({"M": 1.0, "b": 5.0, "zeta": 0.01, "omega_n": 1.0}, RangeError),
        ({"kp": 1.0, "delay": 1e-3}, UsageError),
        ({"kp": 1.0, "velocity": "fast", "rate": 100.0}, UsageError),
        ({"M": [[1.0, 2.0], [2.0, 1.0]], "kp": 1.0}, RangeError),
        ({"M": np.eye(2), "kp": [1.0, 2.0, 3.0]}, ShapeError),
    ],
)
def test_numbers_without_meaning_are_refused(numbers: dict[str, float], error: type[Exception]) -> None:
    with pytest.raises(error):
        taut.error_dynamics(**numbers)


def test_systems_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ShapeError):
        taut.LinearSystem(A=np.eye(2), B=np.eye(3))
    with pytest.raises(RangeError):
        taut.LinearSystem(A=[[np.nan]])
    with pytest.raises(UnknownNameError):
        taut.error_dynamics(kp=1.0).frequency_response(1.0, input="ref.q[0]", output="tool")
    with pytest.raises(RangeError):
        taut.error_dynamics(kp=1.0, rate=10.0).frequency_response(40.0, input="ref.q[0]", output="q[0]")
    with pytest.raises(UsageError):
        taut.error_dynamics(kp=1.0, rate=10.0).zoh(0.1)
    with pytest.raises(UsageError):
        taut.LinearSystem(A=[[0.0]], B=[[1.0]]).feedback(taut.LinearSystem(A=[[0.0]]))


def test_its_content_has_modes_margins_and_step_and_its_figure_is_drawn() -> None:
    for system in (taut.error_dynamics(**JOINT), taut.error_dynamics(**JOINT, ki=1.0, rate=100.0)):
        content = system.content()
        assert [table.title for table in content.tables] == ["modes", "margins", "step response"]
        assert str(system)
        assert len(system.plot().axes) == 5  # step response, poles, two of Bode, Nyquist
    assert taut.error_dynamics(M=0.5, kp=1.0, kd=0.0).content().faults
