"""What a design runs into in the plant's transmissions: play and elasticity."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from taut.study.design_limits import DesignLimit, Tried

__all__ = ["gear_limits"]

SOFT: Final = 0.5  # of a flexible joint's frequency with its motor held: what a design should stay below


def gear_limits(tried: Tried) -> Iterator[DesignLimit]:
    """Play and elasticity of the plant's transmissions."""
    gear = None if tried.plant is None else tried.plant.actuation.transmission
    if gear is None or tried.plant is None:
        return
    arm, n = tried.plant.arm, tried.x.n
    if gear.has_play:
        play = np.broadcast_to(np.asarray(gear.backlash), (n,))
        i = int(np.argmax(play))
        yield DesignLimit(
            name="backlash", value=float(play[i]), limit=0.0, unit=arm.units[i], ok=False,
            sentence=(
                f"'{arm.joint_names[i]}' has {play[i]:.2g} {arm.units[i]} of play, within which no gain holds it: it "
                "swings about there where the encoder is at the link, and stays off where it is at the motor"
            ),
        )  # fmt: skip
    soft = gear.compliant(n)
    if not soft:
        return
    link = np.diag(np.asarray(tried.x.M)) - tried.arm.rotor_inertia
    held = np.array([np.sqrt(float(np.broadcast_to(np.asarray(gear.stiffness), (n,))[i]) / link[i]) for i in soft])
    fastest = max((each.omega_n for each in tried.designed), default=0.0)
    i = int(np.argmin(held))
    yield DesignLimit(
        name="elastic joint", value=fastest, limit=SOFT * float(held[i]), unit="rad/s", ok=fastest <= SOFT * held[i],
        sentence=(
            f"'{arm.joint_names[soft[i]]}' swings at {held[i]:.4g} rad/s with its motor held; a design up to half of "
            f"that, {SOFT * held[i]:.4g} rad/s, does not feel it much, and this one has {fastest:.4g} rad/s"
        ),
    )  # fmt: skip
