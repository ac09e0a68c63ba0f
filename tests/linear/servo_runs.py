"""The chapter's link without friction on a table, under PID at a rate, and what runs of taut make of an error."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

import taut

KINDS = ("measured", "difference", taut.sensors.LowPass(cutoff=20.0), taut.sensors.Difference(cutoff=20.0))
START = 1e-3  # [rad]


@dataclass(frozen=True, kw_only=True)
class Servo:
    """Velocity estimate of the law, and delay of its torque."""

    rate: float
    kind: int
    taps: int = 0

    def sampled(self, kp: float, kd: float, ki: float) -> taut.LinearSystem:
        delay, velocity = self.taps / self.rate, KINDS[self.kind]
        return taut.error_dynamics(M=0.5, kp=kp, kd=kd, ki=ki, rate=self.rate, delay=delay, velocity=velocity)

    def error(self, kp: float, kd: float, ki: float, ticks: int) -> np.ndarray:
        """(ticks,) the error of a run of taut from one at rest, in parts of it."""
        ctrl, plant = compiled(self.rate, self.kind), plant_of(self.taps / self.rate)
        ctrl.parameters["law.kp"], ctrl.parameters["law.kd"], ctrl.parameters["law.ki"] = kp, kd, ki
        run = taut.run(ctrl, plant, taut.JointMotion(q=[0.0]), duration=ticks / self.rate, q0=[-START])
        return -run.q[:ticks, 0] / START


@cache
def table() -> taut.Arm:
    return taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0])


@cache
def compiled(rate: float, kind: int) -> taut.Controller:
    law = taut.laws.PID(kp=1.0, kd=1.0, ki=1.0)
    return taut.compile(law, table(), rate=rate, sensing=taut.Sensing(velocity=KINDS[kind]))


@cache
def plant_of(delay: float) -> taut.RigidPlant:
    return taut.RigidPlant(
        table(),
        friction=None,
        integrator="rk4",
        actuation=taut.drives.Actuation(delay=delay),
    )
