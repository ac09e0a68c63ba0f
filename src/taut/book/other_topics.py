"""Section 10.6: what a flexible transmission adds to the dynamics of a joint."""

from __future__ import annotations

import numpy as np

from taut.book.models import FAST, M, link, looped
from taut.book.page import ROOTS, Shown, entry, row
from taut.control.laws.joint import PID
from taut.control.trajectories.reference import JointMotion
from taut.linear.linearise import linearise
from taut.plant.actuation import Actuation
from taut.plant.drivetrain import Transmission

__all__: list[str] = []

STIFFNESS, DAMPING = 2000.0, 5.0  # [N m/rad], [N m s/rad] between motor and link, chosen
GEAR, ROTOR = 100.0, 1e-4  # ratio, [kg m^2]


@entry("sec-10.6", "a flexible transmission", part="flexible")
def soft_joint() -> Shown:
    """The link, free, with a spring and a damper between it and its motor."""
    arm, rest = link(gravity=False, b=0.0).with_gears(GEAR, ROTOR), JointMotion(q=[0.0])
    free, drive = PID(kp=0.0, kd=0.0), Actuation(transmission=Transmission(stiffness=STIFFNESS, damping=DAMPING))
    stiff = linearise(looped(free, arm, rest, rate=FAST), at=[0.0])
    soft = linearise(looped(free, arm, rest, rate=FAST, actuation=drive, substeps=10), at=[0.0])
    mobility = 1.0 / M + 1.0 / (GEAR**2 * ROTOR)
    pole = np.roots([1.0, DAMPING * mobility, STIFFNESS * mobility])[0]
    found = max((mode.s for mode in soft.modes), key=lambda s: s.imag)
    source = f"{ROOTS} of s^2 + (d s + k)(1 / M + 1 / G^2 I_motor)"
    yield row("order of the dynamics, rigid", "", len(stiff.poles), 2, "M theta-ddot = tau")
    yield row(
        "order of the dynamics, flexible", "", len(soft.poles), 4, "two masses and a spring", states="increased"
    )
    yield row("oscillation of link against motor: real part", "1/s", found.real, pole.real, source, rel=1e-3)
    yield row(
        "oscillation of link against motor: imaginary part", "1/s", found.imag, abs(pole.imag), source, rel=1e-3
    )

    yield (
        "By taut.linearise. Chosen: a gear of 100, a rotor of 1e-4 kg m^2, 2000 N m/rad and 5 N m s/rad between "
        "motor and link; no law, no friction, no gravity."
    )
