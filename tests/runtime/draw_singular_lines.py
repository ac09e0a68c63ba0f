"""Draw the lines of `singular_lines.json`, with seeds: `python draw_singular_lines.py [ARM]` prints those of an arm.

A line starts where the arm is regular, and is kept only if inverse kinematics can follow it to its border, or to its end.
It takes minutes.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from singular_lines import BEGIN, RAMP, SPEED, kinematics

import taut
from taut.base.types import Float64Array

Array = Float64Array
TRIES = 3000
D4, D6 = 0.163941, 0.0922  # [m] of a UR10: how near the wrist gets to the first axis; tool before the wrist
ELBOW = {"ur10": 2, "panda": 3, "xarm7": 3}
WRIST = {"ur10": 4, "panda": 5, "xarm7": 5}
BENT = {
    "ur10": (0.3, -0.9, 1.2, -1.2, -1.57, 0.2),
    "panda": (0.0, 0.5, 0.0, -1.8, 0.0, 1.6, 0.7),
    "xarm7": (0.0, 0.4, 0.0, 1.2, 0.0, 1.2, 0.0),
}
STRAIGHT = {
    "ur10": BENT["ur10"],
    "panda": (0.0, 0.6, 0.0, 0.0, 0.0, 1.3, 0.7),
    "xarm7": (0.0, 0.6, 0.0, 0.0, 0.0, 0.9, 0.0),
}
INSIDE, HALF = 0.3, 0.3  # [m]


def reached(arm: taut.Arm, q: Array, p: Array, R: Array) -> Array | None:
    """A pose by damped Newton steps; None if they do not get there."""
    for _ in range(200):
        at, turned, J = kinematics(arm)(q)
        e = np.append(p - at, Rotation.from_matrix(R @ turned.T).as_rotvec())
        if np.abs(e).max() < 1e-11:
            return q
        step = J.T @ np.linalg.solve(J @ J.T + min(1e-3, float(e @ e)) * np.eye(6), e)
        q = q + step * min(1.0, 0.2 / np.abs(step).max())
    return None


def followed(arm: taut.Arm, q: Array | None, points: Array, R: Array) -> Array | None:
    """Poses one after the other."""
    for p in points:
        q = None if q is None else reached(arm, q, p, R)
    return q


def least(arm: taut.Arm, q: Array) -> float:
    return float(np.linalg.svd(kinematics(arm)(q)[2], compute_uv=False)[-1])


def elbow(arm: taut.Arm, seed: int, beyond: float) -> dict[str, Any]:
    """Out along the lost direction of a straight arm, so far beyond its border, and back."""
    for k in range(TRIES):
        rng = np.random.default_rng([seed, k])
        q = np.array(STRAIGHT[arm.name]) + rng.uniform(-0.35, 0.35, arm.n)
        q[ELBOW[arm.name]] = 0.0
        p, R, J = kinematics(arm)(q)
        u = np.linalg.svd(J)[0][:3, -1]
        if np.linalg.norm(u) < 0.3:
            continue
        d, bent = u / np.linalg.norm(u), q.copy()
        bent[ELBOW[arm.name]] += 0.3
        ways = {}
        for side in (1.0, -1.0):
            start = followed(arm, bent, p - side * d * np.linspace(0.05, INSIDE, 6)[:, None], R)
            if start is not None:
                ways[side] = start
        if len(ways) == 1:
            ((side, q0),) = ways.items()
            turn = (INSIDE + beyond) / SPEED + RAMP
            again = BEGIN + (2.0 * turn - _time(INSIDE) if beyond else turn)
            return _line(q0, side * d, INSIDE + beyond, back=True, again=again)
    raise RuntimeError("no line")


def _time(s: float) -> float:
    """When a line has gone so far [s]."""
    return s / SPEED + 0.5 * RAMP


def wrist(arm: taut.Arm, seed: int, tilt: float = 0.05) -> dict[str, Any]:
    """Sideways to the arm through nearly aligned wrist axes, so that the wrist is bent at both ends."""
    for k in range(TRIES):
        rng = np.random.default_rng([seed, k])
        q = np.array(BENT[arm.name]) + rng.uniform(-0.25, 0.25, arm.n)
        q[WRIST[arm.name]] = 0.0
        p, R, J = kinematics(arm)(q)
        R = Rotation.from_rotvec(rng.uniform(-tilt, tilt, 3)).as_matrix() @ R
        d = rng.choice([-1, 1]) * J[:3, 0] / np.linalg.norm(J[:3, 0]) + 0.35 * rng.standard_normal(3)
        d /= np.linalg.norm(d)
        ends = [_end(arm, q, p + side * d * HALF * np.linspace(0.2, 1.0, 6)[:, None], R) for side in (-1.0, 1.0)]
        if ends[0] is not None and ends[1] is not None:
            return _line(ends[0], d, 2.0 * HALF, back=False, again=BEGIN + _time(HALF))
    raise RuntimeError("no line")


def _end(arm: taut.Arm, middle: Array, points: Array, R: Array) -> Array | None:
    """The end of a line from its middle, with the wrist bent to one side or the other and the elbow far from straight."""
    for bend in (0.3, -0.3):
        q = middle.copy()
        q[WRIST[arm.name]] = bend
        end = followed(arm, q, points, R)
        if end is not None and least(arm, end) > 0.12 and np.abs(end - middle).max() < 2.0:
            return end if abs(end[ELBOW[arm.name]]) >= 0.6 else None
    return None


def shoulder(arm: taut.Arm, seed: int, half: float = 0.5) -> dict[str, Any]:
    """The wrist of a UR10 straight over its first axis, or some centimetres beside."""
    for k in range(TRIES):
        rng = np.random.default_rng([seed, k])
        q = np.array([rng.uniform(-3, 3), -1.2, 1.6, -1.9, -1.57, 0]) + rng.uniform(-0.3, 0.3, 6)
        _, R, J = kinematics(arm)(q)
        way = rng.uniform(-np.pi, np.pi)
        d = np.array([np.cos(way), np.sin(way), 0.0])
        height, beside = rng.uniform(0.55, 0.85), rng.uniform(-0.04, 0.04)
        centre = -half * d + beside * np.array([-d[1], d[0], 0.0]) + np.array([0.0, 0.0, height])
        p0 = centre + D6 * J[3:, 5]
        q0 = reached(arm, q, p0, R)
        if q0 is None or np.abs(q0).max() > 4.0 or least(arm, q0) < 0.12 or abs(q0[4]) < 0.5:
            continue
        near = followed(arm, q0, p0 + d * np.linspace(0.03, half - 0.25, 6)[:, None], R)
        if near is None or least(arm, near) < 0.08:
            continue
        turned = q0.copy()
        turned[0] += np.pi
        if reached(arm, turned, p0 + 2.0 * half * d, R) is not None:
            again = BEGIN + _time(half + float(np.sqrt(D4**2 - beside**2)))
            return _line(q0, d, 2.0 * half, back=False, again=again)
    raise RuntimeError("no line")


def _line(q0: Array, d: Array, length: float, *, back: bool, again: float) -> dict[str, Any]:
    return {"q0": q0.tolist(), "d": d.tolist(), "length": length, "back": back, "again": round(again, 3)}


def main() -> None:
    """Print all lines of an arm."""
    arm = taut.load_arm(sys.argv[1] if len(sys.argv) > 1 else "ur10")
    count = 16 if arm.name == "ur10" else 8
    found = {"wrist": [wrist(arm, seed) for seed in range(count)]}
    if arm.name == "ur10":
        found["shoulder"] = [shoulder(arm, seed) for seed in range(count)]
    found["beyond"] = [elbow(arm, seed, 0.1) for seed in range(count)]
    found["elbow"] = [elbow(arm, seed, 0.0) for seed in range(count)]
    print(json.dumps({arm.name: found}, indent=1))


if __name__ == "__main__":
    main()
