"""One joint with dry friction under PD control along a ramp, integrated with SciPy from event to event."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

import taut
from taut.base.types import Float64Array

TIGHT = {"rtol": 1e-10, "atol": 1e-12}


@dataclass(frozen=True, kw_only=True)
class Pulled:
    """M a = kp (speed t - q) + kd (speed - v) - friction: a mass that a spring pulls along at constant speed."""

    M: float
    kp: float
    kd: float
    speed: float
    viscous: float
    coulomb: float
    static: float
    stribeck: float
    shape: float = 2.0

    def pull(self, t: float, q: float, v: float) -> float:
        return self.kp * (self.speed * t - q) + self.kd * (self.speed - v)

    def dry(self, v: float) -> float:
        if self.stribeck == 0.0:
            return self.coulomb
        return self.coulomb + (self.static - self.coulomb) * float(np.exp(-((abs(v) / self.stribeck) ** self.shape)))

    def events(self, until: float) -> tuple[Float64Array, Float64Array]:
        """Times at which the joint breaks away, and at which it sticks again."""
        t, q, slips, sticks = 0.0, 0.0, [], []
        while t < until:
            # At rest the pull grows until it breaks the joint away.
            t = (self.static - self.kd * self.speed) / (self.kp * self.speed) + q / self.speed
            if t >= until:
                break
            slips.append(t)

            def slide(t: float, y: Float64Array) -> list[float]:
                return [y[1], (self.pull(t, y[0], y[1]) - self.dry(y[1]) - self.viscous * y[1]) / self.M]

            def stops(t: float, y: Float64Array) -> float:
                return float(y[1])

            stops.terminal, stops.direction = True, -1.0  # type: ignore[attr-defined]
            # Stribeck friction at v = 0 balances the pull exactly; the smallest push sets it going.
            y0 = [q, 1e-9]
            done = solve_ivp(slide, (t, until + 10.0), y0, events=stops, method="LSODA", max_step=0.01, **TIGHT)
            if not done.t_events[0].size:
                break
            t, q = float(done.t_events[0][-1]), float(done.y_events[0][-1][0])
            if t >= until:
                break
            sticks.append(t)
        return np.array(slips), np.array(sticks)


def measured_events(run: taut.Run, rest: float = 1e-10) -> tuple[Float64Array, Float64Array]:
    """The same of a run: ticks at which a joint at rest begins to move, and at which it comes to rest."""
    moving = np.abs(run.v[:, 0]) > rest
    change = np.flatnonzero(moving[1:] != moving[:-1]) + 1
    return run.t[change[moving[change]]], run.t[change[~moving[change]]]
