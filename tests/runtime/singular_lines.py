"""Straight lines of the tool through singularities of real arms: MATHS of the case, as trajectories.

`singular_lines.json` holds where each begins; `draw_singular_lines.py` drew them.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import taut
from taut.base.types import Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import model_of

Array = Float64Array
SPEED = 0.25  # [m/s]
RAMP = 0.25  # [s] from rest to speed
BEGIN = 0.2  # [s] at rest first
AFTER = 3.0  # [s] at rest at the end
FILE = Path(__file__).with_name("singular_lines.json")


@dataclass(frozen=True, kw_only=True)
class Line:
    """The tool goes `length` along d at constant speed, and back if asked, without turning."""

    q0: Array  # (n,) where the arm starts, exactly on the line
    p0: Array  # (3,)
    R: Array  # (3, 3)
    d: Array  # (3,)
    length: float  # [m]
    back: bool
    again: float  # [s] when the line can be followed again

    @property
    def once(self) -> float:
        """Time of one way [s]."""
        return self.length / SPEED + RAMP

    @property
    def duration(self) -> float:
        """[s]."""
        return round(BEGIN + self.once * (2 if self.back else 1) + AFTER, 3)

    def progress(self, t: Array) -> tuple[Array, Array, Array]:
        """Way, speed and acceleration along d."""
        s, v, a = _ways(t - BEGIN, self.once)
        if not self.back:
            return s, v, a
        s2, v2, a2 = _ways(t - BEGIN - self.once, self.once)
        return s - s2, v - v2, a - a2

    def rows(self, times: Array) -> taut.TaskMotion:
        s, v, a = self.progress(times)
        k, still = len(times), np.zeros((len(times), 3))
        return taut.TaskMotion.of(
            {
                "p": self.p0 + s[:, None] * self.d,
                "R": np.broadcast_to(self.R, (k, 3, 3)),
                "twist": np.hstack([v[:, None] * self.d, still]),
                "acceleration": np.hstack([a[:, None] * self.d, still]),
            }
        )

    def at(self, t: float) -> taut.TaskMotion:
        rows = self.rows(np.array([t]))
        return taut.TaskMotion.of({name: getattr(rows, name)[0] for name in ("p", "R", "twist", "acceleration")})


def _ways(t: Array, T: float) -> tuple[Array, Array, Array]:
    """A trapezoid of speed from 0 to T."""
    t = np.clip(t, 0.0, T)
    rate = SPEED / RAMP
    up, down = np.minimum(t, RAMP), np.clip(t - (T - RAMP), 0.0, RAMP)
    level = np.clip(t - RAMP, 0.0, T - 2.0 * RAMP)
    moving = (t > 0.0) & (t < T)
    a = rate * ((t < RAMP) & moving) - rate * ((t > T - RAMP) & moving)
    return 0.5 * rate * up**2 + SPEED * (level + down) - 0.5 * rate * down**2, rate * (up - down), a


@functools.cache
def kinematics(arm: taut.Arm) -> Any:
    """A native function q -> (p, R, J)."""
    model = model_of(arm)

    def numbers(q: Any) -> Any:
        T = dyn.pose(model, q, None)
        return taut.math.array([*T.p, *T.R.ravel(), *dyn.jacobian(model, q, None, "W").ravel()])

    native = taut.native(numbers, q=arm.n)

    def parts(q: Array) -> tuple[Array, Array, Array]:
        out = native(np.ascontiguousarray(q))
        return out[:3], out[3:12].reshape(3, 3), out[12:].reshape(6, arm.n)

    return parts


def lines(arm: taut.Arm, kind: str) -> list[Line]:
    """The lines of one kind that were drawn for an arm."""
    found = []
    for entry in json.loads(FILE.read_text(encoding="utf-8"))[arm.name][kind]:
        q0 = np.array(entry["q0"])
        p0, R, _ = kinematics(arm)(q0)
        numbers = {"length": entry["length"], "back": entry["back"], "again": entry["again"]}
        found.append(Line(q0=q0, p0=p0, R=R, d=np.array(entry["d"]), **numbers))
    return found


class OneLoop:
    """A law on one arm, compiled once, run along many lines."""

    def __init__(self, law: taut.Law, arm: taut.Arm, plant: taut.Arm | None = None) -> None:
        self.arm, self._line = arm, None
        self._loop: taut.Loop | None = None
        self._ctrl = taut.compile(law, arm, rate=1000.0)
        self._plant = taut.RigidPlant(plant or arm, friction=None)

    def rows(self, times: Array) -> taut.TaskMotion:
        assert self._line is not None
        return self._line.rows(times)

    def at(self, t: float) -> taut.TaskMotion:
        assert self._line is not None
        return self._line.at(t)

    def run(self, line: Any, q0: Array | None = None, duration: float = 8.0) -> taut.Run:
        self._line = line
        if self._loop is None:
            self._loop = taut.Loop(self._ctrl, self._plant, self, duration=duration)
        return taut.run(self._loop, q0=line.q0 if q0 is None else q0, progress=False)


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One run along one line."""

    torque: float  # largest, in parts of the joint's effort
    speed: float  # largest, in parts of the joint's limit
    rms: float  # [m] of the position, over the line and 3 s after it
    turn: float  # [rad] RMS of the orientation
    recovery: float  # [s] from when the line can be followed again until the error stays under 1 mm
    finished: bool


def errors(run: taut.Run, arm: taut.Arm, line: Any) -> tuple[Array, Array, Array]:
    """Of each tick: error of position [m], of orientation [rad], smallest singular value of J."""
    wanted = line.rows(run.t)
    parts = [kinematics(arm)(q) for q in run.q]
    p, R, J = (np.array([part[i] for part in parts]) for i in range(3))
    cosine = 0.5 * (np.einsum("kij,kij->k", wanted.R, R) - 1.0)
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.linalg.norm(wanted.p - p, axis=1), turn, np.linalg.svd(J, compute_uv=False)[:, -1]


def measured(run: taut.Run, arm: taut.Arm, line: Line) -> Measured:
    error, turn, _ = errors(run, arm, line)
    on = run.t <= line.duration
    late = run.t[error > 1e-3]
    return Measured(
        torque=float((np.abs(run.tau) / arm.effort).max()),
        speed=float((np.abs(run.v) / arm.velocity).max()),
        rms=float(np.sqrt(np.mean(error[on] ** 2))),
        turn=float(np.sqrt(np.mean(turn[on] ** 2))),
        recovery=float(late[-1] - line.again) if len(late) else -line.again,
        finished=run.outcome.ok,
    )
