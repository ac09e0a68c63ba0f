"""Transmissions: what lies between a motor and its joint. Losses, play, and elasticity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import entry_names, finite_array, read_only, require_at_least, require_positive
from taut.base.errors import RangeError, UsageError
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.trace import math as tm

__all__ = ["Transmission"]

Values = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Transmission:
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

    efficiency: ArrayLike = 1.0
    stiffness: ArrayLike | None = None
    damping: ArrayLike = 0.0
    backlash: ArrayLike = 0.0

    def __post_init__(self) -> None:
        where = "actuation.transmission"
        efficiency = finite_array(f"{where}.efficiency", self.efficiency)
        bad = np.argwhere(np.atleast_1d((efficiency <= 0.0) | (efficiency > 1.0)))
        if len(bad):
            index = [int(bad[0][0])] if efficiency.ndim else []
            raise RangeError(
                f"{entry_names(f'{where}.efficiency', index)} must be above 0 and at most 1: gears give back no more "
                f"than they get; got {float(efficiency[tuple(index)]):g}; 80 % is 0.8",
                name="efficiency",
                value=float(efficiency[tuple(index)]),
                rule="(0, 1]",
            )
        kept = {"efficiency": efficiency}
        for name, unit in (("damping", "N m s/rad | N s/m"), ("backlash", "rad | m")):
            kept[name] = finite_array(f"{where}.{name}", getattr(self, name), unit=unit)
            require_at_least(f"{where}.{name}", kept[name], 0.0, unit=unit)
        if self.stiffness is not None:
            kept["stiffness"] = finite_array(f"{where}.stiffness", self.stiffness, allow_infinite=True)
            require_positive(f"{where}.stiffness", kept["stiffness"], unit="N m/rad | N/m")
        for name in ("backlash", "damping"):
            rigid = np.inf if self.stiffness is None else kept["stiffness"]
            if np.any((kept[name] > 0.0) & np.isinf(rigid)):
                raise UsageError(
                    f"{where}.{name} needs a stiffness, that of the teeth or of the elastic part: 1e4 N m/rad, say",
                    name=name,
                )
        for name, values in kept.items():
            object.__setattr__(self, name, read_only(values))

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
        """Run-time parameters by name: those that are there."""
        out: dict[str, Any] = {}
        if self.lossy:
            out["efficiency"] = self.efficiency
        if self.stiffness is not None:
            out |= {"stiffness": self.stiffness, "damping": self.damping}
        if self.has_play:
            out["backlash"] = self.backlash
        return out

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
