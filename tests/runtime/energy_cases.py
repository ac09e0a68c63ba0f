"""Arms under impedance control that are pushed, or touch passive things: seeded cases on both sides of the passive region.

The region: K and X_ref constant, and with T the period either physical damping at the tip b >= K T / 2 + |B|, against
every passive thing, or B >= K T, against pushes below 20 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from impedance_tools import Shaker, poses_of

import taut
from taut.base.types import Float64Array

Array = Float64Array
RATE = 200.0  # [Hz], at which springs that people ask for meet the border
STEPS = 25  # of the plant in a period: one step alone would hide what the hold of a torque does
DURATION = 3.0  # [s]
VISCOUS = 4.0  # [N m s/rad] of each joint, where the arm has physical damping
FASTEST = 18.0  # [Hz] of pushes
SLOW, FAST = 4.0, 50.0  # [rad/s] of what is felt on a spring
PUSHED, HELD = "pushed", "held"
THINGS = ("spring", "damper", "handle", "wall", "hard wall", "all")


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run, and what was said before it."""

    kind: str
    thing: str
    inside: bool  # of the region, by its formula
    stable: bool  # by the report
    safe: bool  # by the report: no energy below 20 Hz, or none for any passive thing
    least: float  # [J] what was given to the arm, at its least, and what it had at the start
    grew: bool  # ended faster than it ever was in the first third
    finished: bool

    @property
    def gave(self) -> bool:
        """Whether more energy came out than had gone in."""
        return not self.finished or self.grew or self.least < -1e-6


class Bench:
    """One arm, compiled once, with everything that may touch it."""

    def __init__(self, name: str) -> None:
        self.arm = taut.load_arm(name).with_friction(taut.Friction(viscous=VISCOUS))
        law = taut.laws.Impedance(K=np.ones(6), B=np.ones(6), coriolis="keep", null=None)
        self._free = taut.compile(law, self.arm.with_friction(taut.Friction()), rate=RATE)
        # Of a measured velocity no damping bounds what resonances far above the rate can do; of a differenced one it does.
        self._damped = taut.compile(law, self.arm, rate=RATE, sensing=taut.Sensing(velocity="difference"))

    @cached_property
    def _pushed(self) -> taut.Loop:
        plant = taut.RigidPlant(self.arm, friction=None, substeps=STEPS, environment=Shaker())
        return taut.Loop(self._free, plant, taut.hold(), duration=DURATION)

    @cached_property
    def _held(self) -> taut.Loop:
        things = taut.environments.Environments(
            spring=taut.environments.Spring(stiffness=(0.0, 0.0)),
            damper=taut.environments.Damper(damping=(0.0, 0.0)),
            handle=taut.environments.Hand(mass=1e-6),
            wall=taut.environments.StiffWall(point=[0.0, 0.0, -9.0], normal=[0.0, 0.0, 1.0], stiffness=1e4),
        )
        plant = taut.RigidPlant(self.arm, substeps=STEPS, environment=things)
        return taut.Loop(self._damped, plant, taut.hold(), duration=DURATION)

    def case(self, seed: int) -> Case:
        rng = np.random.default_rng(seed)
        kind = (PUSHED, HELD)[seed % 2]
        inside = bool(rng.uniform() < 0.6)
        q = poses_of(self.arm, 1, 1000 + seed)[0]
        x = taut.snapshot(self.arm, q)
        J = x.J()
        light = 1.0 / np.diag(J @ np.linalg.solve(x.M, J.T))  # what is felt along each axis
        K = light * (SLOW * (FAST / SLOW) ** rng.uniform(0.0, 1.0, 6)) ** 2
        numbers: dict[str, Any] = {}
        v, thing = np.zeros(self.arm.n), "push"
        if kind == PUSHED:
            B = rng.uniform(1.0, 2.0, 6) * K / RATE
            if not inside:  # too little of it, or far too much
                B = (
                    rng.uniform(0.0, 0.4, 6) * K / RATE
                    if rng.uniform() < 0.7
                    else rng.uniform(2.5, 4.0) * light * RATE
                )
            way = rng.normal(size=6)
            numbers["amplitude"] = way / np.linalg.norm(way) * np.array([10.0] * 3 + [0.2] * 3)
            numbers["frequency"] = 0.2 * (FASTEST / 0.2) ** rng.uniform()
        else:
            B = rng.uniform(0.0, 0.5, 6) * K / RATE * rng.integers(0, 2)
            b = np.linalg.inv(
                J / VISCOUS @ J.T
            )  # the least damping that the joints have against a motion of the tool
            most = 1.0 / np.linalg.eigvals(np.linalg.solve(b, np.diag(0.5 * K / RATE + B))).real.max()
            factor = most * (rng.uniform(0.3, 1.0) if inside else rng.uniform(3.0, 30.0))
            K, B = factor * K, factor * B
            thing = THINGS[int(rng.integers(len(THINGS)))]
            V = rng.normal(size=6) * ([0.15] * 3 + [0.3] * 3)
            v = np.linalg.pinv(J) @ V
            numbers |= self._things(rng, thing, x.T(), V)
        loop, ctrl = (self._pushed, self._free) if kind == PUSHED else (self._held, self._damped)
        if kind == HELD:
            for path, value in self._nothing.items():
                loop.parameters[path] = value
        for path, value in numbers.items():
            loop.parameters[f"environment.{path}"] = value
        for path, value in (("law.K", K), ("law.B", B)):
            loop.parameters[path] = ctrl.parameters[path] = value
        check = taut.analysis.check_stiffness(ctrl, q, band=20.0 if kind == PUSHED else None)
        run = taut.run(loop, q0=q, v0=v, progress=False)
        stored = 0.5 * v @ x.M @ v
        speed = np.abs(run.v).max(axis=1)
        third = len(speed) // 3
        return Case(
            kind=kind,
            thing=thing,
            inside=inside,
            stable=check.stable,
            safe=check.passive,
            least=float(np.nanmin(run.extra["work.environment"]) + stored),
            grew=kind == HELD and bool(speed[-third:].max() > speed[:third].max()),
            finished=run.outcome.ok,
        )

    @cached_property
    def _nothing(self) -> dict[str, Any]:
        return {path: value for path, value in self._held.parameters.items() if path.startswith("environment.")}

    @staticmethod
    def _things(rng: np.random.Generator, thing: str, T: taut.Pose, V: Array) -> dict[str, Any]:
        out: dict[str, Any] = {}
        if thing in ("spring", "all"):
            out["spring.stiffness"] = [10.0 ** rng.uniform(1.0, 3.5)] * 3 + [10.0 ** rng.uniform(-1.0, 1.0)] * 3
        if thing in ("damper", "all"):
            out["damper.damping"] = [10.0 ** rng.uniform(-1.0, 1.0)] * 3 + [10.0 ** rng.uniform(-3.0, -1.5)] * 3
        if thing in ("handle", "all"):
            out |= {"handle.mass": 10.0 ** rng.uniform(-1.0, 0.7), "handle.stiffness": 10.0 ** rng.uniform(0.0, 3.0)}
        if "wall" in thing or thing == "all":
            normal = -V[:3] / np.linalg.norm(V[:3])
            hard = 3e4 if thing == "hard wall" else 10.0 ** rng.uniform(2.5, 4.0)
            out |= {"wall.point": T.p - 0.004 * normal, "wall.normal": normal, "wall.stiffness": hard}
        return out
