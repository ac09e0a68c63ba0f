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
    """How the law sees the link, and how late its torque comes."""

    rate: float
    kind: int
    taps: int = 0
    exact: bool = False

    def sampled(self, kp: float, kd: float, ki: float) -> taut.analysis.SampledErrorDynamics:
        return taut.analysis.second_order(M=0.5, kp=kp, kd=kd, ki=ki).sampled(
            rate=self.rate,
            delay=self.taps / self.rate,
            velocity=KINDS[self.kind],
            integrator="exact" if self.exact else "semi-implicit-euler",
        )

    def error(self, kp: float, kd: float, ki: float, ticks: int) -> np.ndarray:
        """(ticks,) the error of a run of taut from one at rest, in parts of it."""
        ctrl, plant = compiled(self.rate, self.kind), plant_of(self.taps / self.rate, self.exact)
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
def plant_of(delay: float, exact: bool) -> taut.RigidPlant:
    return taut.RigidPlant(
        table(),
        friction=None,
        integrator="rk4" if exact else "semi-implicit-euler",
        actuation=taut.drives.Actuation(delay=delay),
    )
