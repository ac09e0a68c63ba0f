"""Where gains become too large: predicted by theory, and searched for in simulation.

One joint, the chapter's link on a table, under PID. Six effects, each with the gain at its border by a formula, by
eigenvalues where the loop is linear, and by bisection over runs of taut.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

import taut
from taut.base.types import Float64Array

M, b = 0.5, 0.1  # [kg m^2], [N m s/rad] of the link
RATE = 1000.0  # [Hz]
LINK = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0])
B = 0.25  # [kg m^2] of a rotor, as the joint feels it
GEARED = LINK.with_gears(ratio=50.0, motor_inertia=1e-4)
KICK = 1e-3  # [rad] off the goal, far below everything that is not linear
HOME = taut.JointMotion(q=[0.0])

# ---------------------------------------------------------------- the search


def border(too_large: Callable[[float], bool], low: float, high: float, steps: int = 10) -> float:
    """The gain between two, of which the second is too large, by bisection: within (high - low) / 2^steps."""
    assert not too_large(low)
    assert too_large(high)
    for _ in range(steps):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if too_large(middle) else (middle, high)
    return 0.5 * (low + high)


def grows(run: taut.Run) -> bool:
    """Whether what a kick set off is larger at the end of a run than in its middle; speeds, as fast swings do not drift."""
    tenths = [np.abs(part).max() for part in np.array_split(run.v[:, 0], 10)]
    return not run.outcome.ok or bool(tenths[9] > tenths[5])


def critically_damped(inertia: float) -> Callable[[float], dict[str, float]]:
    """Gains by kd: the chapter's, without overshoot."""
    return lambda kd: {"law.kp": kd * kd / (4.0 * inertia), "law.kd": kd}


def after_a_kick(
    plant: taut.RigidPlant, gains: Callable[[float], dict[str, float]], duration: float, **options: Any
) -> Callable[[float], bool]:
    """Whether a gain makes the loop unstable."""
    ctrl = taut.compile(taut.laws.PID(kp=1.0, kd=1.0), plant.arm, **options)

    def unstable(gain: float) -> bool:
        for path, value in gains(gain).items():
            ctrl.parameters[path] = value
        return grows(taut.run(ctrl, plant, HOME, duration=duration, q0=[KICK]))

    return unstable


# ---------------------------------------------------------------- eigenvalues of a sampled loop


def spectral_radius(
    A: Float64Array,
    rates: Float64Array,
    kp: float,
    kd: float,
    rate: float,
    *,
    at: int = 0,
    taps: int = 0,
    differenced: bool = False,
) -> float:
    """Largest eigenvalue of x_dot = A x + rates u with u = -kp x[at] - kd x[at + 1], sampled, held and late by taps.

    The state is x, the position of the tick before, and the commands under way.
    """
    n, dt = len(A), 1.0 / rate
    step = expm(np.block([[A, rates], [np.zeros((1, n + 1))]]) * dt)  # exact for an input that is held
    law = np.zeros((1, n + 1 + taps))
    law[0, at] = -kp
    if differenced:
        law[0, at] -= kd / dt
        law[0, n] = kd / dt
    else:
        law[0, at + 1] = -kd
    loop = np.zeros((n + 1 + taps, n + 1 + taps))
    loop[:n, :n], loop[n, at] = step[:n, :n], 1.0
    if taps:
        loop[:n, -1:] = step[:n, n:]
        loop[n + 1 : n + 2] = law
        loop[n + 2 :, n + 1 : -1] = np.eye(taps - 1)
    else:
        loop[:n] += step[:n, n:] @ law
    return float(np.abs(np.linalg.eigvals(loop)).max())


RIGID = np.array([[0.0, 1.0], [0.0, -b / M]]), np.array([[0.0], [1.0 / M]])


def two_masses(K: float, D: float) -> tuple[Float64Array, Float64Array]:
    """Link (q, v) and motor (q, v) on a spring; the friction is the motor's."""
    of_link = [-K / M, -D / M, K / M, D / M]
    of_motor = [K / B, D / B, -K / B, -(D + b) / B]
    A = np.array([[0.0, 1.0, 0.0, 0.0], of_link, [0.0, 0.0, 0.0, 1.0], of_motor])
    return A, np.array([[0.0], [0.0], [0.0], [1.0 / B]])


def marginal(radius: Callable[[float], float], low: float, high: float) -> float:
    """The gain at which a loop is on the border of stability."""
    return float(brentq(lambda gain: radius(gain) - 1.0, low, high, rtol=1e-10))


# ---------------------------------------------------------------- delay


def delay_formula(delay: float, *, differenced: bool = False) -> float:
    """kd at kp = kd^2 / 4M: where |L| = 1 the phase of (kd s + kp) / (M s^2) leaves 1.295 M / kd for all delays.

    With omega = x kd / M: |L| = 1 is x^4 = x^2 + 1/16, so x = 1.0290, and atan(4 x) / x = 1.2948. A held torque is
    late by half a period, and so is a differenced velocity; which has the larger part of kd s + kp.
    """
    x = math.sqrt(0.5 * (1.0 + math.sqrt(1.25)))
    return math.atan(4.0 * x) / x * M / (delay + (1.0 if differenced else 0.5) / RATE)


def delay_predicted(taps: int, *, differenced: bool = False) -> float:
    guess = delay_formula(taps / RATE, differenced=differenced)
    return critical(RATE, 0.5 * guess, 1.5 * guess, taps=taps, differenced=differenced)


def delay_simulated(taps: int, *, differenced: bool = False) -> float:
    plant = taut.RigidPlant(LINK, integrator="rk4", actuation=taut.drives.Actuation(delay=taps / RATE))
    guess = delay_formula(taps / RATE, differenced=differenced)
    unstable = after_a_kick(plant, critically_damped(M), 3.0, sensing=velocities(differenced))
    return border(unstable, 0.6 * guess, 1.3 * guess)


def critical(rate: float, low: float, high: float, **options: Any) -> float:
    """The marginal kd of the rigid joint with critically damped gains."""
    return marginal(lambda kd: spectral_radius(*RIGID, kd * kd / (4.0 * M), kd, rate, **options), low, high)


def velocities(differenced: bool) -> taut.Sensing:
    return taut.Sensing(velocity="difference" if differenced else "measured")


# ---------------------------------------------------------------- servo rate


def rate_formula(rate: float) -> float:
    """2 M / dt: a damper held for one tick turns the motion round; at this border kp has no part, nor has b."""
    return 2.0 * M * rate


def rate_predicted(rate: float, *, differenced: bool = False) -> float:
    guess = rate_formula(rate)
    return critical(rate, 0.5 * guess, 1.5 * guess, differenced=differenced)


def rate_simulated(rate: float, *, differenced: bool = False) -> float:
    guess = rate_formula(rate)
    plant = taut.RigidPlant(LINK, integrator="rk4")
    options = {"rate": rate, "sensing": velocities(differenced)}
    return border(after_a_kick(plant, critically_damped(M), 1000.0 / rate, **options), 0.5 * guess, 1.3 * guess)


# ---------------------------------------------------------------- elasticity

STIFFNESS = 2000.0  # [N m/rad]


def elasticity_formula(D: float) -> float:
    """Sensors at the link: kd pushes the swing of motor against link by kd / (M + B); D (1/M + 1/B) and b damp it."""
    return D * (M + B) ** 2 / (M * B) + b * M / B


def elasticity_predicted(D: float, *, side: str = "link") -> float:
    A, rates = two_masses(STIFFNESS, D)
    kp = critically_damped(M + B)
    at = 2 if side == "motor" else 0
    low, high = elasticity_range(D, side)
    return marginal(lambda kd: spectral_radius(A, rates, kp(kd)["law.kp"], kd, RATE, at=at), low, high)


def elasticity_simulated(D: float, *, side: str = "link") -> float:
    spring = taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=STIFFNESS, damping=D))
    sensors = taut.sensors.Sensors(
        position=taut.sensors.Encoder(side=side), velocity=taut.sensors.Tachometer(side=side)
    )
    plant = taut.RigidPlant(GEARED, actuation=spring, sensors=sensors, substeps=20)
    return border(after_a_kick(plant, critically_damped(M + B), 6.0), *elasticity_range(D, side))


def elasticity_range(D: float, side: str) -> tuple[float, float]:
    """Where to search: sensors at the motor meet the servo rate first, and with the rotor's inertia alone."""
    guess = 2.0 * B * RATE if side == "motor" else elasticity_formula(D)
    return 0.7 * guess, 1.4 * guess


# ---------------------------------------------------------------- saturation

KP_KD_SATURATED = 50.0, 10.0
PEAK = 10.0  # [N m] of the motor


def what_a_limit_leaves(ratio: float) -> float:
    """Describing function of saturation: the share of a sine's first harmonic that a limit leaves, by amplitude / limit."""
    if ratio <= 1.0:
        return 1.0
    return 2.0 / math.pi * (math.asin(1.0 / ratio) + math.sqrt(1.0 - ratio**-2) / ratio)


def saturation_formula(step: float) -> float:
    """ki from rest at a step: the chapter's ki < (b + kd) kp / M with what the limit leaves of kd."""
    kp, kd = KP_KD_SATURATED
    return kp / M * (b + kd * what_a_limit_leaves(kp * step / PEAK))


def saturation_simulated(step: float) -> float:
    kp, kd = KP_KD_SATURATED
    plant = taut.RigidPlant(
        LINK, integrator="rk4", actuation=taut.drives.Actuation(motor=taut.drives.Motor(peak=PEAK))
    )
    ctrl = taut.compile(taut.laws.PID(kp=kp, kd=kd, ki=1.0, integral=taut.laws.Integral(anti_windup="none")), LINK)

    def winds_up(ki: float) -> bool:
        ctrl.parameters["law.ki"] = ki
        run = taut.run(ctrl, plant, HOME, duration=20.0, q0=[step])
        return not run.outcome.ok or bool(np.abs(run.q[-3000:]).max() > step)

    return border(winds_up, 0.5 * saturation_formula(step), 1.5 * saturation_formula(step))


# ---------------------------------------------------------------- resolution

SPEED = 0.002  # [rad/s] at which the joint creeps over its encoder's steps
KP_CREEP = 50.0


def resolution_formula(resolution: float, most: float = PEAK) -> float:
    """kd at which one step of the encoder, a velocity of resolution / dt, asks for all that the motor has."""
    return most / (resolution * RATE)


def creeping(kd: float, resolution: float, speed: float = SPEED, duration: float = 2.0) -> taut.Run:
    """A joint that creeps, with velocities from differences of its encoder's steps."""
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(resolution=resolution), velocity=None)
    plant = taut.RigidPlant(LINK, integrator="rk4", sensors=sensors)
    ctrl = taut.compile(taut.laws.PID(kp=KP_CREEP, kd=kd), LINK, sensing=taut.Sensing(velocity="difference"))
    times = np.array([0.0, duration])
    ref = taut.trajectories.Samples(times=times, q=np.array([[0.0], [speed * duration]]))
    return taut.run(ctrl, plant, ref, duration=duration, q0=[0.0], v0=[speed])


def resolution_simulated(resolution: float, most: float = PEAK) -> float:
    guess = resolution_formula(resolution, most)
    too_much = lambda kd: bool(np.abs(creeping(kd, resolution).tau).max() > most)  # noqa: E731
    return border(too_much, 0.7 * guess, 1.4 * guess)


# ---------------------------------------------------------------- backlash

TEETH = {"stiffness": 200.0, "damping": 1.0, "backlash": 0.02}
KD_PLAY, COULOMB = 4.0, 0.2  # [N m s/rad] on the motor's tachometer, [N m] at the motor


def teeth(deflection: Float64Array, rate: Float64Array) -> Float64Array:
    """Torque of elastic teeth with play, which push and never pull."""
    half = 0.5 * TEETH["backlash"]
    beyond = deflection - np.clip(deflection, -half, half)
    torque = TEETH["stiffness"] * beyond + np.where(beyond != 0.0, TEETH["damping"] * rate, 0.0)
    return np.where(beyond > 0.0, np.maximum(torque, 0.0), np.minimum(torque, 0.0))


@cache
def cycle_predicted(kp: float, coulomb: float = COULOMB) -> tuple[float, float] | None:
    """Amplitude of the link [rad] and period [s] of the limit cycle by harmonic balance; None if there is none.

    Link M s^2 q = teeth, motor (B s^2 + (b + kd) s) q_m = -teeth - coulomb sgn(v_m) - kp q.
    """
    joint = taut.LinearSystem(
        A=[[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1], [-kp / B, 0, 0, -(KD_PLAY + b) / B]],
        B=[[0, 0], [1 / M, 0], [0, 0], [-1 / B, 1 / B]],
        C=[[-1, 0, 1, 0], [0, 0, 0, 1]],
        inputs=("teeth", "friction"),
        outputs=("deflection", "v_motor"),
    )
    elements = {
        "teeth": ("deflection", teeth),
        "friction": ("v_motor", lambda v, _: -coulomb * np.sign(v)),
    }
    found = taut.analysis.limit_cycles(joint, elements, amplitudes=(0.501 * TEETH["backlash"], 0.2)).cycles
    if not found:
        return None
    phase = 2.0 * np.pi * np.arange(1024) / 1024
    A, omega = found[0].amplitudes["deflection"], found[0].omega
    torque = np.fft.fft(teeth(A * np.sin(phase), A * omega * np.cos(phase)))[1] / 512
    return float(abs(torque) / (M * omega**2)), found[0].period


def backlash_formula(coulomb: float = COULOMB) -> float:
    """kp below which friction ends every cycle: kp backlash / 2 = coulomb.

    With the motor at the goal the link can be half the play off: what kp makes of that must not move the motor.
    """
    return 2.0 * coulomb / TEETH["backlash"]


def hunting(kp: float, coulomb: float = COULOMB, duration: float = 20.0) -> taut.Run:
    """A geared joint with play, held by its link's encoder and its motor's tachometer."""
    arm = GEARED.with_friction(taut.Friction(viscous=b, coulomb=coulomb))
    drives = taut.drives.Actuation(transmission=taut.drives.Transmission(**TEETH))
    sensors = taut.sensors.Sensors(velocity=taut.sensors.Tachometer(side="motor"))
    plant = taut.RigidPlant(arm, actuation=drives, sensors=sensors, substeps=4)
    return taut.run(taut.compile(taut.laws.PID(kp=kp, kd=KD_PLAY), arm), plant, HOME, duration=duration, q0=[0.05])


def cycle_simulated(kp: float, coulomb: float = COULOMB) -> tuple[float, float] | None:
    """Amplitude and period of what is left after 15 s; None if the joint came to rest or swings within its play."""
    run = hunting(kp, coulomb)
    tail = run.q[3 * len(run) // 4 :, 0]
    ups = np.flatnonzero((tail[1:] > 0.0) & (tail[:-1] <= 0.0))
    if len(ups) < 3:
        return None
    return float(np.ptp(tail)) / 2.0, float(np.diff(ups).mean()) / RATE


def backlash_simulated(coulomb: float = COULOMB) -> float:
    """Below the border a link rolls ever slower between its teeth; above it keeps its speed."""

    def goes_on(kp: float) -> bool:
        third, fourth = (np.abs(part).max() for part in np.array_split(hunting(kp, coulomb, 240.0).v[:, 0], 4)[2:])
        return bool(fourth > 0.9 * third)

    return border(goes_on, 0.7 * backlash_formula(coulomb), 1.4 * backlash_formula(coulomb), steps=7)
