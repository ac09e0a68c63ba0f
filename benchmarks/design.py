"""Draw docs/images/design_impedance.png, and print the tables of docs/design.md.

Run it in this folder: `python design.py [FOLDER]`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import taut

IMAGES = Path(__file__).parent.parent / "docs" / "images"
BOUNDS = {"law.kp": (10.0, 1000.0), "law.kd": (5.0, 200.0), "law.ki": (0.0, 2000.0)}


def loops(first: int, count: int) -> dict[str, taut.Loop]:
    """Paths through random poses of a Panda with 1 kg that its law does not know; encoder noise 1e-5 rad."""
    arm = taut.load_arm("panda")
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(noise=1e-5), velocity=None)
    plant = taut.RigidPlant(arm.with_payload(1.0), friction=None, sensors=sensors)
    ctrl = taut.compile(
        taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=0.0),
        arm,
        limits=taut.Limits.of(arm, rate=True),
        sensing=taut.Sensing(velocity="difference"),
    )
    out = {}
    for k in range(first, first + count):
        rng = np.random.default_rng(k)
        low, high = arm.lower + 0.1, arm.upper - 0.1
        points = [arm.home, *(np.clip(arm.home + rng.uniform(-0.5, 0.5, 7), low, high) for _ in range(3))]
        out[f"path {k}"] = taut.Loop(
            ctrl, plant, taut.trajectories.Spline(times=[0.0, 1.0, 2.0, 3.0], points=np.array(points)), duration=3.0
        )
    return out


def main(folder: Path) -> None:
    arm = taut.load_arm("panda")
    d = taut.design(taut.laws.Impedance, arm, at=arm.home, K=(800, 30), zeta=0.7, rate=1000.0)
    print(d)
    d.plot().savefig(folder / "design_impedance.png", dpi=150)
    tuned = taut.tune(
        loops(1, 3),
        tuple(BOUNDS),
        bounds=BOUNDS,
        limits=taut.Limits.of(arm, rate=True),
        chatter=0.99,
        seeds=(0, 1, 2),
    )
    print(tuned)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES)
