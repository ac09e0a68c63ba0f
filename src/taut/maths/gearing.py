"""How much of the inertia at a joint is its motor's rotor, at a pose."""

from __future__ import annotations

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.maths.snapshot import snapshot

__all__ = ["rotor_share"]


def rotor_share(arm: Arm, q: ArrayLike | None = None) -> Float64Array:
    """(n,) the part of each joint's inertia that is its geared rotor, from 0 to 1; the rest is links and payload.

    Law:  G^2 I_motor / M_ii(q), with the mass matrix M, rotors included. One half is inertia matched. The nearer to
        1, the less a joint feels of a load and of the other joints: its dynamics are those of its own motor.

    Args:
        arm: The arm, its rotors from `with_gears`, a file, or `with_joints(rotor_inertia=...)`.
        q: (n,) positions [rad | m]; the home pose if left out.

    Raises:
        UsageError: Not an arm.
        ShapeError: Wrong number of entries.
        RangeError: NaN or infinite entries.

    Example:
        A link of 0.5 kg m^2 with a rotor of 1e-3 kg m^2 behind a gear of 100: 10 of 10.5 kg m^2 are the rotor.

        >>> import taut
        >>> rotor_share(taut.load_arm("one_joint").with_gears(100.0, 1e-3)).round(4).tolist()
        [0.9524]

    References:
        Chapter, section 10.2.1.5 the effect of gearing, and 10.2.2.1 for what follows for decentralised control.
    """
    if not isinstance(arm, Arm):  # callers without a type checker
        raise UsageError(f"rotor_share takes an Arm from taut.load_arm; got {type(arm).__name__}", name="arm")
    M = snapshot(arm, arm.home if q is None else q).M
    share: Float64Array = arm.rotor_inertia / np.diag(M)
    return share
