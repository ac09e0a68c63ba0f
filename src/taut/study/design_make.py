"""A design made of gains: tried at all poses, its limits read off, and what is nearest where something cannot be."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, Final, Literal

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.control import laws
from taut.control.law import Law
from taut.loop import Loop
from taut.maths.snapshot import Snapshot
from taut.plant.rigid import RigidPlant
from taut.study.design_contact import force_gains, pressed, require_force_stable
from taut.study.design_directions import Direction, directions_of
from taut.study.design_force import force_directions
from taut.study.design_gains import Case, gains_for
from taut.study.design_limits import DesignLimit, Tried, steps_of, torque_limits
from taut.study.design_result import Achieved, AtPose, Design
from taut.study.design_stiffness import stiffnesses
from taut.study.design_trial import Bench, Numbers, Response, zeta_seen
from taut.study.linear_loop import LinearLoop
from taut.study.sampled import VelocityKind

__all__ = ["Maker"]

HALVINGS: Final = 40
SLOWEST: Final = 1e-7  # of an error in a tick: less cannot be told from none, for rounding splits a pair so far
STAYS: Final = 1e-12  # of the fastest pole: one that is slower is of what nothing draws back
LEAST_FACTOR: Final = 1e-16  # of what was asked: slower is not searched
LEAST: Final = 0.5  # of a damping ratio that the book has: what a sampled loop must keep
MOST: Final = 0.9  # what one that is named as possible keeps
BELOW: Final = 0.99  # of a border: what is named as possible


_Tried = tuple[AtPose, tuple[Direction, ...], tuple[Response, ...]]


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
        self._require_pace()
        models = [self.bench.linear(np.asarray(x.q)) for x in self.case.at]
        if not all(lin.stable for lin in models):
            self._refuse_unstable(models)
        tried = [self._at(x, lin) for x, lin in zip(self.case.at, models, strict=True)]
        if _kept(tried) < LEAST:
            self._refuse_undamped(_kept(tried))
        poses = tuple(pose for pose, _, _ in tried)
        k = min(range(len(poses)), key=lambda i: (poses[i].zeta[0], -poses[i].settling))
        x, lin, (_, directions, predicted) = self.case.at[k], models[k], tried[k]
        steps = steps_of(directions, step)
        designed = tuple(Numbers.designed(d.dynamics) for d in directions)
        read_off = Tried(
            bench=self.bench, arm=self.case.arm, x=x, lin=lin, directions=directions, designed=designed,
            predicted=predicted, steps=steps, plant=self.plant,
        )  # fmt: skip
        if step is not None:
            self._require_torque(next(iter(torque_limits(read_off)), None))
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

    def _at(self, x: Snapshot, lin: LinearLoop) -> _Tried:
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
        return pose, directions, predicted

    # ---------------------------------------------------------------- what cannot be

    def _require_pace(self) -> None:
        """What takes less of an error away in a tick than rounding sets poles apart cannot be told from standing."""
        poles = [d.dynamics.poles for x in self.case.at for d in self._directions(x)]
        rates = [rate for s in poles for rate in -s.real if rate > STAYS * np.abs(s).max()]
        slowest = float(min(rates, default=math.inf)) / self.bench.ctrl.rate
        if slowest < SLOWEST:
            raise RangeError(
                f"{self._what} cannot be tried at {self._where}: its slowest pole takes {slowest:.2g} of an error "
                f"away in a tick, and rounding hides less than {SLOWEST:g}; ask for a faster design, or a lower rate",
                name=next(iter(self.case.asked.speeds), "K"),
                value=slowest,
                rule=f">= {SLOWEST:g} in a tick",
            )

    def _faster(self, factor: float) -> list[LinearLoop] | None:
        """The models of a design that is so much faster; None where one is not stable."""
        case = dataclasses.replace(self.case, asked=self.case.asked.faster(factor))
        try:
            law = gains_for(case)
            self.bench.set_gains(law)
            models = [self.bench.linear(np.asarray(x.q)) for x in self.case.at]
        except RangeError:
            return None
        return models if all(lin.stable for lin in models) else None

    def _stable(self, factor: float) -> bool:
        return self._faster(factor) is not None

    def _damped(self, factor: float) -> bool:
        """Whether nearly all of the damping is there with a design that is so much faster."""
        models = self._faster(factor)
        if models is None:
            return False
        return _kept([self._at(x, lin) for x, lin in zip(self.case.at, models, strict=True)]) >= MOST

    def _refuse_undamped(self, kept: float) -> None:
        raise RangeError(
            f"{self._what} cannot be met: the sampled loop keeps {100.0 * kept:.2g} % of the damping ratio at "
            f"{self._where}; {self._nearest(self._damped, f'keeps {100.0 * MOST:g} % of it')}",
            name=next(iter(self.case.asked.speeds), "K"),
            value=kept,
            rule=f">= {LEAST:g} of the damping ratio",
        )

    @property
    def _what(self) -> str:
        return ", ".join(f"{name} = {_plain(value)}" for name, value in self.case.asked.given.items())

    @property
    def _where(self) -> str:
        delay = float(self.bench.plant.actuation.delay)
        velocity = self.bench.ctrl.side.sensing.velocity
        cutoff = None if isinstance(velocity, str) else getattr(velocity, "cutoff", None)
        parts = [f"{self.bench.ctrl.rate:g} Hz"]
        if delay:
            parts.append(f"{1e3 * delay:g} ms of delay")
        if cutoff is not None:
            parts.append(f"a low-pass of {float(np.min(cutoff)):g} Hz in the velocity")
        if not self.bench.motion.exact:
            parts.append(f"{self.bench.motion.steps}, as plant= has it,")
        return " and ".join(parts)

    def _nearest(self, good: Callable[[float], bool], what: str) -> str:
        """The way out: the fastest design that is good."""
        factor = _largest(good)
        if factor is None:
            return f"no slower design {what} either; raise the rate, or ask for another damping"
        slower = self.case.asked.faster(factor).given
        names = [*self.case.asked.speeds] or [name for name in ("K", "force") if name in slower]
        return f"the nearest that {what} has " + " and ".join(f"{name} = {_plain(slower[name])}" for name in names)

    def _refuse_unstable(self, models: list[LinearLoop]) -> None:
        radius = max(lin.radius for lin in models)
        raise RangeError(
            f"{self._what} cannot be met: at {self._where} the sampled loop grows by the factor {radius:.4g} in a "
            f"tick; {self._nearest(self._stable, 'is stable')}",
            name=next(iter(self.case.asked.speeds), "K"),
            value=radius,
            rule="stable",
        )

    def _require_torque(self, torque: DesignLimit | None) -> None:
        """A step that was asked for must be there without saturation."""
        if torque is None or torque.ok:
            return
        factor = math.sqrt(torque.limit / torque.value) * BELOW
        slower = self.case.asked.faster(factor).given
        names = [*self.case.asked.speeds] or ["K"]
        can = " and ".join(f"{name} = {_plain(slower[name])}" for name in names)
        raise RangeError(
            f"step = {torque.value:g} cannot be met: {torque.sentence}; {can} can, or a step of "
            f"{BELOW * torque.limit:.3g}",
            name="step",
            value=torque.value,
            rule=f"<= {torque.limit:.4g}",
        )

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


def _kept(tried: list[_Tried]) -> float:
    """The least share of a damping ratio that the sampled loop keeps of what the book has, over all poses.

    More than one counts as one: what creeps in the book and creeps less in the loop has lost nothing.
    """
    least = math.inf
    for _, directions, predicted in tried:
        for d, response in zip(directions, predicted, strict=True):
            book = Numbers.designed(d.dynamics).zeta
            if book > 0.0:
                least = min(least, response.numbers.zeta / min(book, 1.0))
    return least


def _largest(stable: Callable[[float], bool]) -> float | None:
    """The largest factor on the speed at which a design is stable, a little below the border; None for none."""
    low, high = 0.5, 1.0
    while not stable(low):
        low, high = 0.5 * low * low, low
        if low < LEAST_FACTOR:
            return None
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
        if high / low < 1.0 + 1e-3:
            break
    return BELOW * low


def _plain(value: object) -> str:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0:
        return f"{float(array):.4g}"
    if array.ndim == 1:
        return f"({', '.join(f'{x:.4g}' for x in array)})"
    return f"a matrix of {array.shape[0]} rows"
