"""Draw the pictures of docs/compare.md and print its tables.

Run it in this folder: `python compare.py [FOLDER]`.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np

import taut

IMAGES = Path(__file__).parent.parent / "docs" / "images"


class Student(taut.Law):
    """Computed torque that leaves out the Coriolis torque."""

    kp: taut.Gain  # [1/s^2]
    kd: taut.Gain  # [1/s]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        """tau = M(q) (a_des + kp e + kd e_dot) + g(q)."""
        a = taut.Terms(feedforward=ref.a, P=self.kp @ x.difference(ref.q), D=self.kd @ (ref.v - x.v))
        return taut.Torque(x.M @ a + taut.Terms(nonlinear=x.g))


def main() -> None:
    """Draw, and print."""
    mpl.use("Agg")
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    start = time.process_time()
    told = taut.compare(on="panda_payload", by="rms_error", model=taut.analysis.WrongModel(mass=0.1, payload=1.0))
    print(told)
    told.plot().savefig(folder / "compare.png", dpi=150)
    print(f"user time {time.process_time() - start:.1f} s\n")
    print(taut.analysis.grade(Student(kp=100.0, kd=20.0), "ComputedTorque(kp=100, kd=20)", swing()))


def swing() -> taut.Loop:
    """A Panda whose joints swing by 0.4 rad."""
    arm = taut.load_arm("panda")
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    ref = taut.trajectories.Sine(center=arm.home, amplitude=np.full(7, 0.4), frequency=0.8, phase=0.0)
    return taut.Loop(ctrl, taut.RigidPlant(arm), ref, duration=2.0)


if __name__ == "__main__":
    main()
