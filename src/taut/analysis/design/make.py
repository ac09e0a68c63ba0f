"""A design made of gains: tried at all poses, with what was asked for beside what the loop has, and its limits."""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from taut import laws
from taut.analysis.design.contact import force_gains, pressed, require_force_stable
from taut.analysis.design.directions import Direction, directions_of, weight_gradient
from taut.analysis.design.force import force_directions
from taut.analysis.design.gains import Case
from taut.analysis.design.limits import Tried, steps_of
from taut.analysis.design.refusals import no_rest, require_pace, require_stable
from taut.analysis.design.requirements import Requirement, of_force_and_step, of_motion
from taut.analysis.design.result import Achieved, AtPose, Design
from taut.analysis.design.stiffness import stiffnesses
from taut.analysis.design.trial import Bench, Numbers, Response, zeta_seen
from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.control.trajectories.reference import JointMotion
from taut.linear.linearise import Linearisation
from taut.linear.sampled import VelocityKind
from taut.loop import Loop
from taut.maths.snapshot import Snapshot, snapshot
from taut.plant.rigid import RigidPlant

__all__ = ["Maker"]


class _Found(NamedTuple):
    """What a model about the equilibrium at a pose has."""

    pose: AtPose
    x: Snapshot
    lin: Linearisation
    directions: tuple[Direction, ...]
    predicted: tuple[Response, ...]
    requirements: tuple[Requirement, ...]


class Maker:
    """What makes a design of gains: the law on its bench, at the poses."""

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
        require_pace(
            self.case.asked, self.bench, [d.dynamics.poles for x in self.case.at for d in self._directions(x)]
        )
        found = [self._at(np.asarray(x.q)) for x in self.case.at]
        k = min(range(len(found)), key=lambda i: (found[i].pose.zeta[0], -found[i].pose.settling))
        (pose, x, lin, directions, predicted, requirements), asked = found[k], self.case.asked
        designed = self.bench.designed(directions)
        steps = steps_of(type(self.law).__name__, directions, step)
        tried = Tried(
            bench=self.bench, arm=self.case.arm, q=pose.q, x=x, lin=lin, directions=directions, designed=designed,
            predicted=predicted, steps=steps, plant=self.plant,
        )  # fmt: skip
        simulated = self.bench.simulated(pose.q, x, directions)
        on_plant = self._on_plant(pose.q, x, directions, steps)
        stiffness = stiffnesses(self.bench, x, lin, directions, asked.K)
        contact = self._in_contact(x)
        requirements += of_force_and_step(asked, tried, stiffness, contact.get("forces", ()), step=step is not None)
        part = self.bench.law
        return Design(
            law=self.law,
            achieved=tuple(
                Achieved(
                    direction=d.name, unit=d.unit, designed=ideal, predicted=p.numbers, simulated=s.numbers,
                    on_plant=real,
                )
                for d, ideal, p, s, real in zip(directions, designed, predicted, simulated, on_plant, strict=True)
            ),
            requirements=requirements,
            q=pose.q,
            poses=tuple(each.pose for each in found),
            asked=asked.given,
            arm=self.case.arm,
            rate=self.bench.ctrl.rate,
            alone="" if part is self.law else type(part).__name__,
            step=steps,
            responses=simulated,
            tried=tried,
            stiffness=stiffness,
            **contact,
        )  # fmt: skip

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
        G = weight_gradient(x) if self.bench.uncompensated else None
        return directions_of(self.bench.law, x, self.case.b, G)

    def _at(self, q: Float64Array) -> _Found:
        """The model about the equilibrium with the reference at a pose.

        Raises:
            RangeError: There is none, or it is not stable.
        """
        try:
            lin = self.bench.linear(q)
        except RangeError as error:
            if not self.bench.uncompensated:
                raise
            raise no_rest(self.case.asked, q, error) from error
        require_stable(self.case.asked, self.bench, lin)
        x = snapshot(self.case.arm, lin.q)
        directions = self._directions(x)
        predicted = self.bench.predicted(lin, x, directions)
        part = self.bench.law
        size = x.n if part.reference is JointMotion else getattr(part, "dimensions", 6)
        requirements = of_motion(self.case.asked, size, directions, predicted, lin, several=len(self.case.at) > 1)
        numbers = [each.numbers for each in predicted]
        zetas = [each.zeta for each in numbers] or [math.nan]
        pose = AtPose(
            q=np.array(q),
            zeta=(float(np.min(zetas)), float(np.max(zetas))),
            settling=max((each.settling for each in numbers), default=math.nan),
            stable=lin.stable,
            met=all(each.met for each in requirements),
        )
        return _Found(pose=pose, x=x, lin=lin, directions=directions, predicted=predicted, requirements=requirements)

    # ---------------------------------------------------------------- the user's plant

    def _on_plant(
        self, q: Float64Array, x: Snapshot, directions: tuple[Direction, ...], steps: Float64Array
    ) -> tuple[Numbers | None, ...]:
        if self.plant is None:
            return (None,) * len(directions)
        loop = Loop(self.bench.for_plant(self.case.arm, self.plant), self.plant, duration=1.0)
        ticks = self.bench.ticks(directions)
        found = []
        for d, size in zip(directions, steps, strict=True):
            run = self.bench.step(loop, q, x, d, float(size), ticks)
            found.append(zeta_seen(run, x, d, float(size)))
        return tuple(found)
