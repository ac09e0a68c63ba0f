"""Transmissions: what lies between a motor and its joint. Losses, backlash, and elasticity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import UsageError
from taut.base.fields import Declared, Field
from taut.base.types import Float64Array, Vector
from taut.trace import math as tm

__all__ = ["Transmission", "require_rotors"]

Values = Mapping[str, Any]


class Transmission(Declared):
    """Gears that lose power, have play, or give way. The ratio itself and the rotor stand in the Arm.

    Model:        power: the motor drives, P_out = efficiency P_in; the load drives, P_in = efficiency P_out back
                  as a friction of the gear: |f| <= (1 - efficiency) |tau_in| against motion that the motor drives,
                  |f| <= (1 / efficiency - 1) |tau_in| against motion that the load drives; at rest it sticks
                  tau_in = tau - B a_motor is what reaches the gear: the motor's torque less what accelerates its
                  rotor, so that M a = efficiency (tau - B a) + ... where the motor drives. Of a motor without torque
                  a load has the rotor alone to accelerate; what it holds besides is taut.Friction(load_external=...)
                  play and elasticity: tau_link = K z(delta) + D delta_dot where the teeth touch, delta = q_motor - q,
                  z(delta) = delta beyond +-backlash / 2, else 0; the rotor then has a motion of its own,
                  B a_motor = tau - friction - tau_link, and friction acts on its side

    Args:
        efficiency: Of the gears, in (0, 1]; 1 for none lost.
        stiffness: K [N m/rad | N/m] at the joint; rigid if left out, and np.inf for a joint that is.
        damping: D [N m s/rad | N s/m] of the spring, or of teeth that touch.
        backlash: Play of the joint with its motor held [rad | m], from tooth to tooth. Needs a stiffness, of teeth.

    Raises:
        RangeError: An efficiency outside (0, 1], a stiffness that is not above zero, a negative number.
        UsageError: Backlash or damping without a stiffness.

    References:
        Chapter, section 10.2.1.5 the effect of gearing. Spong, Modeling and control of elastic joint robots, Journal
        of Dynamic Systems, Measurement and Control 109 (1987). Nordin and Gutman, Controlling mechanical systems with
        backlash: a survey, Automatica 38 (2002).
    """

    efficiency: Field = Field(
        1.0, unit="1", shape="n", above=0.0, maximum=1.0, hint="gears give back no more than they get; 80 % is 0.8"
    )
    stiffness: Field = Field(unit="N m/rad | N/m", shape="n", above=0.0, infinite=True, optional=True)
    damping: Field = Field(0.0, unit="N m s/rad | N s/m", shape="n", minimum=0.0)
    backlash: Field = Field(0.0, unit="rad | m", shape="n", minimum=0.0)

    def check(self) -> None:
        """Backlash and damping are of something elastic."""
        rigid = np.inf if self.stiffness is None else self.stiffness
        for name in ("backlash", "damping"):
            if np.any((getattr(self, name) > 0.0) & np.isinf(rigid)):
                self.refuse(name, "needs a stiffness, that of the teeth or of the elastic part: 1e4 N m/rad, say")

    @property
    def lossy(self) -> bool:
        """Whether power is lost in the gears."""
        return bool(np.any(np.asarray(self.efficiency) < 1.0))

    @property
    def has_play(self) -> bool:
        """Whether there is backlash."""
        return bool(np.any(self.backlash))

    def compliant(self, n: int) -> tuple[int, ...]:
        """The joints whose motor and link move apart."""
        if self.stiffness is None:
            return ()
        return tuple(int(i) for i in np.flatnonzero(np.isfinite(np.broadcast_to(self.stiffness, (n,)))))

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name: those of what it has."""
        own = Declared.parameters(self)
        there = {"efficiency": self.lossy, "damping": self.stiffness is not None, "backlash": self.has_play}
        return {name: x for name, x in own.items() if there.get(name, True)}

    # ---------------------------------------------------------------- the pure functions

    def loss_limits(self, tau: Vector, p: Values) -> tuple[Vector, Vector]:
        """(n,) largest friction of gears that tau reaches, against positive and against negative motion."""
        driving = (1.0 - p["efficiency"]) * tm.abs(tau)
        driven = driving / p["efficiency"]
        forward = tau > 0.0
        return tm.where(forward, driving, driven), tm.where(forward, driven, driving)

    def beyond_play(self, delta: Vector, p: Values) -> Vector:
        """(n,) z, the wind-up that is left when the play is taken up."""
        if not self.has_play:
            return delta
        half = 0.5 * p["backlash"]
        return delta - tm.clip(delta, -half, half)  # type: ignore[no-any-return]

    def torque(self, delta: Vector, rate: Vector, p: Values) -> Vector:
        """(n,) the torque on the link; teeth push, and never pull."""
        z = self.beyond_play(delta, p)
        if not self.has_play:
            return p["stiffness"] * z + p["damping"] * rate  # type: ignore[no-any-return]
        spring = p["stiffness"] * z + tm.where(z != 0.0, p["damping"] * rate, 0.0)
        play = p["backlash"] > 0.0
        pushing = tm.where(z > 0.0, tm.maximum(spring, 0.0), tm.minimum(spring, 0.0))
        return tm.where(play, pushing, spring)  # type: ignore[no-any-return]


def require_rotors(arm: Arm, joints: tuple[int, ...], rotor_inertia: Float64Array | None = None) -> None:
    """A motor that moves apart from its link needs a rotor.

    Args:
        arm: The arm.
        joints: Those whose motor does.
        rotor_inertia: (n,) seen at the joints [kg m^2 | kg]; the arm's own if left out.

    Raises:
        UsageError: One has none.
    """
    rotor = arm.rotor_inertia if rotor_inertia is None else rotor_inertia
    for i in joints:
        if rotor[i] <= 0.0:
            raise UsageError(
                f"joint '{arm.joint_names[i]}' has an elastic transmission or backlash, so its motor moves by itself "
                "and needs a rotor: give the arm gears or rotor_inertia",
                name="stiffness",
            )
