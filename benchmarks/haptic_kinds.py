"""What impedance and admittance control are good at: ranges that one joint displays, searched for in runs of taut.

A light joint that is easily pushed back, and a geared one with friction; each under both kinds of control, in a
human hand and against a stiff spring. Imported by haptic_limits.py, which draws and prints what is found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import taut
from taut.arm.builtin import one_joint
from taut.base.types import Float64Array

RATE = 1000.0  # [Hz]
FREQUENCIES = (1.0, 2.0, 5.0)  # [Hz] of the hand's own will, at which the displayed impedance is measured
WITHIN = 0.10  # of the asked one
WALL = {"k": 400.0, "b": 8.0}  # [N m/rad], [N m s/rad] of a stiff rubber: at 0.3 m 4.4 kN/m
ZETA = 0.7
CUTOFF = 100.0  # [Hz] of the wrench sensor's low-pass
VELOCITY = 200.0  # [Hz] of the low-pass of differenced positions
DELAY = 1e-3  # [s] of the drives
HAND = {"m": 0.05, "b": 0.6, "k": 30.0}  # of an arm's lever of 0.3 m: 0.6 kg, 7 N s/m, 330 N/m
GRIP = {"b": 3.0, "k": 1000.0}  # between its mass and the joint
KICK = 0.5  # [rad/s]
AMPLITUDE = 0.1  # [rad] of the hand's will
Values = Mapping[str, Any]


def light() -> taut.Arm:
    """A link of 0.02 kg m^2 and hardly any friction: a haptic device."""
    return one_joint(M=0.02, m=0.5, r=0.1, b=0.02).with_gravity([0.0, 0.0, 0.0])


def geared() -> taut.Arm:
    """The same link behind a gear of 100: a rotor of 1 kg m^2 at the joint, and 2 N m of dry friction."""
    arm = light().with_gears(ratio=100.0, motor_inertia=1e-4)
    return arm.with_friction(taut.Friction(viscous=1.0, coulomb=2.0))


INERTIA = {"light": 0.02, "geared": 1.02}  # [kg m^2] of the whole joint


class DisplayImpedance(taut.Law):
    """Impedance control (10.49) of one joint; with a wrench sensor where D is not the joint's own inertia.

    Law:          tau = M a - F_ext,  a = (F_ext - B v - K q) / D
    Closed loop:  D a + B v + K q = F_ext, less the joint's friction times D / M
    """

    M: taut.Gain  # [kg m^2]
    K: taut.Gain  # [N m/rad]
    B: taut.Gain  # [N m s/rad]
    D: taut.Gain  # [kg m^2]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:  # noqa: ARG002
        force = (x.J().T @ x.F_ext) - (self.B @ x.v) - (self.K @ x.q)
        return taut.Torque(shaped=(self.M @ force) / (self.D @ np.ones(1)) - x.J().T @ x.F_ext)


class DisplayStiffness(taut.Law):
    """Impedance control without a wrench sensor: D is what the joint has, and is felt."""

    K: taut.Gain  # [N m/rad]
    B: taut.Gain  # [N m s/rad]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:  # noqa: ARG002
        return taut.Torque(spring=-(self.K @ x.q), damper=-(self.B @ x.v))


class DisplayAdmittance(taut.Law):
    """Admittance control (10.50) of one joint from its own model state, followed by a stiff inner loop.

    Law:          a_d = (F_ext - B v_d - K q_d) / D, integrated: v_d+ = v_d + a_d dt, q_d+ = q_d + v_d+ dt
                  tau = M a_d + kd (v_d - v) + kp (q_d - q) - F_ext
    Closed loop:  D a_d + B v_d + K q_d = F_ext, as far as the inner loop follows
    """

    M: taut.Gain  # [kg m^2]
    K: taut.Gain  # [N m/rad]
    B: taut.Gain  # [N m s/rad]
    D: taut.Gain  # [kg m^2]
    kp: taut.Gain  # [N m/rad]
    kd: taut.Gain  # [N m s/rad]

    def start(self, x: taut.Snapshot, ref: taut.JointMotion) -> dict[str, Any]:  # noqa: ARG002
        return {"q_d": x.q, "v_d": x.v}

    def command(self, x: taut.Snapshot, ref: Any, memory: Any, dt: Any) -> tuple[taut.Torque, dict[str, Any]]:  # noqa: ARG002
        F = x.J().T @ x.F_ext
        # Implicit in B and K, so that the model's own integration makes no energy.
        inertia = self.D @ np.ones(1) + dt * (self.B @ np.ones(1)) + dt * dt * (self.K @ np.ones(1))
        v_d = memory.v_d + dt * (F - self.B @ memory.v_d - self.K @ (memory.q_d + dt * memory.v_d)) / inertia
        q_d = memory.q_d + dt * v_d
        a_d = (v_d - memory.v_d) / dt
        tau = taut.Torque(
            model=self.M @ a_d, D=self.kd @ (memory.v_d - x.v), P=self.kp @ (memory.q_d - x.q), wrench=-F
        )
        return tau, {"q_d": q_d, "v_d": v_d}


class HumanHand(taut.environments.Environment):
    """A mass that wants to follow a sine, held to the joint by a grip. Moments about the joint's axis, -y."""

    amplitude: taut.environments.Field = taut.environments.Field(AMPLITUDE, unit="rad")
    omega: taut.environments.Field = taut.environments.Field(2.0 * np.pi, unit="rad/s")

    def start(self, T_WE: taut.Pose) -> dict[str, Any]:  # noqa: ARG002
        return {"z": 0.0, "w": 0.0}

    def wrench(
        self, T_WE: taut.Pose, twist: Any, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Any, dict[str, Any]]:
        x, v = taut.math.atan2(T_WE.R[2, 0], T_WE.R[0, 0]), -twist[4]
        z, w = memory["z"], memory["w"]
        omega, A = parameters["omega"], parameters["amplitude"]
        will, speed = A * taut.math.sin(omega * t), A * omega * taut.math.cos(omega * t)
        grip = GRIP["k"] * (z - x) + GRIP["b"] * (w - v)  # on the joint
        pull = HAND["k"] * (will - z) + HAND["b"] * (speed - w)
        w = w + dt * (pull - grip) / HAND["m"]
        return taut.math.array([0.0, 0.0, 0.0, 0.0, -grip, 0.0]), {"z": z + dt * w, "w": w}


class StiffSpring(taut.environments.Environment):
    """A stiff spring to the ground with the damping of rubber."""

    def wrench(
        self,
        T_WE: Any,
        twist: Any,
        t: Any,  # noqa: ARG002
        memory: Any,  # noqa: ARG002
        parameters: Any,  # noqa: ARG002
        dt: Any,  # noqa: ARG002
    ) -> tuple[Any, dict[str, Any]]:
        x, v = taut.math.atan2(T_WE.R[2, 0], T_WE.R[0, 0]), -twist[4]
        return taut.math.array([0.0, 0.0, 0.0, 0.0, WALL["k"] * x + WALL["b"] * v, 0.0]), {}


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A joint under one kind of control."""

    arm: str  # light or geared
    control: str  # impedance, impedance with sensor, or admittance
    inner: float = 150.0  # [rad/s] of admittance's inner loop

    def __str__(self) -> str:
        return f"{self.arm}, {self.control}"

    def law(self) -> taut.Law:
        M = INERTIA[self.arm]
        if self.control == "impedance":
            return DisplayStiffness(K=1.0, B=1.0)
        if self.control == "impedance with sensor":
            return DisplayImpedance(M=M, K=1.0, B=1.0, D=M)
        gains = {"kp": M * self.inner**2, "kd": 2.0 * M * self.inner}
        return DisplayAdmittance(M=M, K=1.0, B=1.0, D=1.0, **gains)


def model(arm: str) -> taut.Arm:
    return {"light": light, "geared": geared}[arm]()


@cache
def controller(kind: Kind) -> taut.Controller:
    wrench = None if kind.control == "impedance" else taut.sensors.LowPass(cutoff=CUTOFF)
    sensing = taut.Sensing(velocity=taut.sensors.Difference(cutoff=VELOCITY), F_ext=wrench)
    return taut.compile(kind.law(), model(kind.arm), rate=RATE, sensing=sensing)


@cache
def loop(kind: Kind, environment: str, duration: float) -> taut.Loop:
    touched = {"hand": HumanHand, "wall": StiffSpring}[environment]()
    plant = taut.RigidPlant(
        model(kind.arm), environment=touched, substeps=10, actuation=taut.drives.Actuation(delay=DELAY)
    )
    return taut.Loop(controller(kind), plant, taut.JointMotion(q=[0.0]), duration=duration)


def asked(kind: Kind, K: float, D: float | None) -> dict[str, float]:
    """The parameters that ask for a spring K with inertia D, damped by ZETA; at K = 0 a mass alone."""
    inertia = INERTIA[kind.arm] if D is None else D
    out = {"K": K, "B": 2.0 * ZETA * math.sqrt(K * inertia)}
    return out if kind.control == "impedance" else {**out, "D": inertia}


def run(kind: Kind, environment: str, values: dict[str, float], duration: float, **options: Any) -> taut.Run:
    made = loop(kind, environment, duration)
    for name, value in values.items():
        made.parameters[f"law.{name}"] = value
    for name, value in options.pop("hand", {}).items():
        made.parameters[f"environment.{name}"] = value
    return taut.run(made, **options)


def settles(kind: Kind, values: dict[str, float]) -> bool:
    """Whether a kick dies out, in a hand that wants nothing and against the stiff spring.

    In the last fifth of 3 s it has less than a hundredth of its speed, or ever less where little damps it: what
    an inner loop hunts about dry friction is below that.
    """
    for environment in ("hand", "wall"):
        still = {"hand": {"amplitude": 0.0}} if environment == "hand" else {}
        out = run(kind, environment, values, 3.0, v0=[KICK], **still)
        if not out.outcome.ok or np.abs(out.q).max() > 2.0:
            return False
        speeds = [float(np.sqrt(np.mean(part**2))) for part in np.array_split(out.v[:, 0], 5)]
        if speeds[4] > 0.01 * KICK and speeds[4] > 0.98 * speeds[2]:
            return False
    return True


def error(kind: Kind, values: dict[str, float], D: float) -> float:
    """The largest relative error of |Z| from the asked one at the frequencies of a hand's will."""
    worst = 0.0
    for f in FREQUENCIES:
        duration = 12.0
        out = run(kind, "hand", values, duration, hand={"omega": 2.0 * np.pi * f, "amplitude": AMPLITUDE})
        if not out.outcome.ok:
            return math.inf
        last = slice(-1 - round(4.0 * RATE), -1)  # four seconds: whole periods
        tone = np.exp(-2j * np.pi * f * out.t[last])
        F = -(out.extra["F_ext"][last, 4] * tone).mean()
        x = (out.q[last, 0] * tone).mean()
        s = 2j * np.pi * f
        Z = D * s * s + values["B"] * s + values["K"]
        worst = max(worst, abs(abs(F / x) / abs(Z) - 1.0))
    return worst


def displayed(kind: Kind, K: float, D: float | None) -> bool:
    """Whether it settles, and its |Z| is what was asked for within a tenth."""
    values = asked(kind, K, D)
    inertia = INERTIA[kind.arm] if D is None else D
    return settles(kind, values) and error(kind, values, inertia) <= WITHIN


def edge(good: Callable[[float], bool], inside: float, outside: float, steps: int = 7) -> float:
    """The border between a value that is good and one beyond, by halving their ratio."""
    if good(outside):
        return outside
    for _ in range(steps):
        middle = math.sqrt(inside * outside)
        inside, outside = (middle, outside) if good(middle) else (inside, middle)
    return inside


def stretch(good: Callable[[float], bool], values: Float64Array) -> tuple[float, float] | None:
    """The longest stretch of what is good on a grid, its ends refined; None if nothing is."""
    found = [good(float(value)) for value in values]
    if not any(found):
        return None
    runs, start = [], None
    for i, ok in enumerate([*found, False]):
        if ok and start is None:
            start = i
        if not ok and start is not None:
            runs.append((i - start, start, i - 1))
            start = None
    _, first, last = max(runs)
    low = values[first] if first == 0 else edge(good, values[first], values[first - 1])
    high = values[last] if last == len(values) - 1 else edge(good, values[last], values[last + 1])
    return float(low), float(high)


SPRINGS = np.geomspace(1.0, 1e5, 16)  # [N m/rad]
MASSES = np.geomspace(1e-3, 1.0, 10)  # [kg m^2]
D_OF_SPRINGS = 1.0  # [kg m^2] that admittance control gives its springs; the others have the joint's own
KINDS = tuple(
    Kind(arm=arm, control=control)
    for arm in ("light", "geared")
    for control in ("impedance", "impedance with sensor", "admittance")
)


def springs(kind: Kind) -> tuple[float, float] | None:
    """Stiffnesses that are displayed, least and largest."""
    D = D_OF_SPRINGS if kind.control == "admittance" else None
    return stretch(lambda K: displayed(kind, K, D), SPRINGS)


def masses(kind: Kind) -> tuple[float, float] | None:
    """Masses that are displayed, least and largest; without a sensor there is the joint's own only."""
    if kind.control == "impedance":
        own = INERTIA[kind.arm]
        return (own, own) if displayed(kind, 0.0, None) else None
    return stretch(lambda D: displayed(kind, 0.0, D), MASSES)
