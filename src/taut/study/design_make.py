"""A design made of gains: tried at all poses, its limits read off, and what is nearest where something cannot be."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from taut.base.types import Float64Array
from taut.control import laws
from taut.control.law import Law
from taut.loop import Loop
from taut.maths.snapshot import Snapshot
from taut.plant.rigid import RigidPlant
from taut.study.design_contact import force_gains, pressed, require_force_stable
from taut.study.design_directions import Direction, directions_of
from taut.study.design_force import force_directions
from taut.study.design_gains import Case
from taut.study.design_limits import DesignLimit, Tried, step_limit, steps_of
from taut.study.design_refusals import LEAST, Refusals, TriedAt, kept_of
from taut.study.design_result import Achieved, AtPose, Design
from taut.study.design_stiffness import stiffnesses
from taut.study.design_trial import Bench, Numbers, zeta_seen
from taut.study.linear_loop import LinearLoop
from taut.study.sampled import VelocityKind

__all__ = ["Maker"]


class Maker:
    """What makes a design of gains: the bench, the poses, and what is nearest where something cannot be."""

    def __init__(
        self,
        case: Case,
        law: Law,
        *,
        rate: float,
        delay: float,
        velocity: VelocityKind,
        friction: Literal["arm"] | None,
        plant: RigidPlant | None,
    ) -> None:
        self.case, self.law, self.plant = case, law, plant
        self._how: dict[str, Any] = {"rate": rate, "delay": delay, "friction": friction}
        if isinstance(law, laws.HybridMotionForce):
            require_force_stable(law, rate, delay)
        self.bench = Bench(
            law, case.arm, rate=rate, delay=delay, velocity=velocity, friction=friction, at=case.at,
            contact=case.asked.contact, like=plant,
        )  # fmt: skip

    def design(self, step: Float64Array | None) -> Design:
        """Tried at all poses, its limits at the worst."""
        refusals = Refusals(self.case, self.bench, self._at)
        refusals.require_pace([d.dynamics.poles for x in self.case.at for d in self._directions(x)])
        models = [self.bench.linear(np.asarray(x.q)) for x in self.case.at]
        if not all(lin.stable for lin in models):
            raise refusals.unstable(models)
        tried = [self._at(x, lin) for x, lin in zip(self.case.at, models, strict=True)]
        if kept_of(tried) < LEAST:
            raise refusals.undamped(kept_of(tried))
        poses = tuple(pose for pose, _, _, _ in tried)
        k = min(range(len(poses)), key=lambda i: (poses[i].zeta[0], -poses[i].settling))
        x, lin, (_, directions, designed, predicted) = self.case.at[k], models[k], tried[k]
        read_off = self._read_off(x, lin, tried[k], step)
        steps = read_off.steps
        if step is not None:
            limit = step_limit(read_off)
            if not limit.ok:
                raise refusals.step(limit, step, lambda: self._step_limit(x, step))
        simulated = self.bench.simulated(x, directions)
        on_plant = self._on_plant(x, directions, steps)
        achieved = tuple(
            Achieved(
                direction=d.name, unit=d.unit, designed=book, predicted=p.numbers, simulated=s.numbers, on_plant=real
            )
            for d, book, p, s, real in zip(directions, designed, predicted, simulated, on_plant, strict=True)
        )
        part = self.bench.law
        return Design(
            law=self.law,
            achieved=achieved,
            q=np.array(x.q),
            poses=poses,
            asked=self.case.asked.given,
            arm=self.case.arm,
            rate=self.bench.ctrl.rate,
            weightless=self.bench.weightless,
            alone="" if part is self.law else type(part).__name__,
            step=steps,
            responses=simulated,
            tried=read_off,
            stiffness=stiffnesses(self.bench, x, lin, directions, self.case.asked.K),
            **self._in_contact(x),
        )

    def _read_off(self, x: Snapshot, lin: LinearLoop, tried: TriedAt, step: Float64Array | None) -> Tried:
        _, directions, designed, predicted = tried
        return Tried(
            bench=self.bench, arm=self.case.arm, x=x, lin=lin, directions=directions, designed=designed,
            predicted=predicted, steps=steps_of(type(self.law).__name__, directions, step), plant=self.plant,
        )  # fmt: skip

    def _step_limit(self, x: Snapshot, step: Float64Array) -> DesignLimit:
        """Of a step with the gains that the bench has."""
        lin = self.bench.linear(np.asarray(x.q))
        return step_limit(self._read_off(x, lin, self._at(x, lin), step))

    def _in_contact(self, x: Snapshot) -> dict[str, Any]:
        """Of a hybrid law that feeds the force back, what becomes of an error of it."""
        if not isinstance(self.law, laws.HybridMotionForce) or not np.any(force_gains(self.law)[1]):
            return {}
        q, forces = pressed(
            self.law, self.case.arm, np.asarray(x.q), sensing=self.bench.ctrl.side.sensing, **self._how
        )
        return {"q_contact": q, "forces": forces}

    def _directions(self, x: Snapshot) -> tuple[Direction, ...]:
        if isinstance(self.bench.law, laws.ForceControl):
            return () if self.bench.contact is None else force_directions(self.bench.law, x, self.bench.contact)
        return directions_of(self.bench.law, x, self.case.b)

    def _at(self, x: Snapshot, lin: LinearLoop) -> TriedAt:
        directions = self._directions(x)
        predicted = self.bench.predicted(lin, x, directions)
        numbers = [each.numbers for each in predicted]
        zetas = [each.zeta for each in numbers] or [math.nan]
        pose = AtPose(
            q=np.array(x.q),
            zeta=(float(np.min(zetas)), float(np.max(zetas))),
            settling=max((each.settling for each in numbers), default=math.nan),
            stable=lin.stable,
        )
        return pose, directions, self.bench.designed(directions), predicted

    # ---------------------------------------------------------------- the user's plant

    def _on_plant(
        self, x: Snapshot, directions: tuple[Direction, ...], steps: Float64Array
    ) -> tuple[Numbers | None, ...]:
        if self.plant is None:
            return (None,) * len(directions)
        loop = Loop(self.bench.for_plant(self.case.arm, self.plant), self.plant, duration=1.0)
        ticks = self.bench.ticks(directions)
        found = []
        for d, size in zip(directions, steps, strict=True):
            run = self.bench.step(loop, x, d, float(size), ticks)
            found.append(zeta_seen(run, x, d, float(size)))
        return tuple(found)
