"""The picture of the page on the doctor: an oscillation that the integral feeds."""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

import taut
from taut.base.types import Float64Array

IMAGES = Path(__file__).parents[1] / "docs" / "images"


def integral() -> taut.Run:
    """ki over kd kp on a UR10."""
    arm = taut.load_arm("ur10")
    law = taut.laws.ComputedTorque(kp=225.0, kd=15.0, ki=4000.0)
    start: Float64Array = arm.home + 0.02
    ref = taut.JointMotion(q=arm.home)
    return taut.run(taut.compile(law, arm), taut.RigidPlant(arm), ref, duration=3.0, q0=start)


def main() -> None:
    """Draw, and print what was found."""
    mpl.use("Agg")
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    diagnosis = taut.doctor(integral())
    print(diagnosis)
    np.testing.assert_equal(diagnosis.findings[0].name, "oscillation")
    diagnosis.findings[0].plot().savefig(folder / "doctor.png", dpi=150)


if __name__ == "__main__":
    main()
