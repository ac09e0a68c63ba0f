"""Friction compensation: the model's friction, given by the controller so that the arm moves as if it had none."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np

from taut.base.checks import one_of
from taut.base.errors import MatchError
from taut.base.types import Vector
from taut.control.command import Command, Torque
from taut.control.gains import Gain
from taut.control.law import Law
from taut.control.trajectories.reference import JointMotion
from taut.maths.friction_law import FrictionValues, dry_limit
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["FrictionCompensation"]

FRICTION_POINTS: Final = ("ref", "meas")
SPREAD: Final = 3.0  # widths over which an excess that falls at once is given: tanh is near 1 there, and s is too


class FrictionCompensation(Law):
    """The model's joint friction as feedforward; add it to a law whose h is C v + g.

    Law:          tau = share (viscous v* + d(v*) tanh(v* / width)), v* the desired or the measured velocity
                  d(v) = coulomb + (static - coulomb) exp(-(|v| / stribeck)^shape) + (load_external + load_motor) |T|
                  T = M a_des + C v* + g, what carries the load; its own excess at rest fades like the static one
                  an excess that falls at once is given over 3 widths with at="ref", and not at all with at="meas"
    Closed loop:  friction that is known exactly leaves f(v) - tau in the place of f(v)
                  at="ref": of viscous friction -b e_dot, so that it damps errors and does not hold back the motion
                  static friction is given where the reference starts or turns, and helps the joint break away
                  at="meas": none of it, and so no damping; of dry friction what is at rest, |v| < width
                  it is never more than the friction that is there, and so never more than the break-away torque
                  share < 1 leaves that part of friction, which feedback takes

    What is given too much drives the joint: with at="meas" it turns slow motion into a limit cycle, so that a share
    of 0.8 to 0.9 is practice where friction is not known well. What friction itself adds to the motor's torque, and
    with it to the load, is left out: too little by a factor 1 - load_motor.

    References:
        Section 10.2.1.4 a closer look at friction; the chapter's h in figures 10.10 and 10.12 includes b v.
        Armstrong-Helouvry, Dupont and Canudas de Wit, A survey of models, analysis tools and compensation methods
        for the control of machines with friction, Automatica 30 (1994), section 6.
    """

    at: str = "ref"
    width: Gain = Gain(0.01, minimum=1e-9)  # [rad/s | m/s]
    share: Gain = Gain(1.0, maximum=1.0)  # [1]

    def __post_init__(self) -> None:
        one_of("at", self.at, FRICTION_POINTS)
        object.__setattr__(self, "ignores_reference", self.at == "meas")

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        """The model must have friction."""
        friction = x.arm.friction
        if not friction.dry and not np.any(friction.viscous):
            raise MatchError(
                f"FrictionCompensation has nothing to compensate: arm '{x.arm.name}' has no friction; state it with "
                "arm.with_friction(taut.Friction(...)), or leave the law out",
                name="friction",
            )

    def command(self, x: Snapshot, ref: JointMotion) -> Command:
        values = FrictionValues.fixed(x.friction)
        v = ref.v if self.at == "ref" else x.v
        tau: Any = tm.zeros(x.n)
        if values.viscous is not None:
            tau = tau + values.viscous * v
        if values.dry:
            load = self._load(x, ref) if values.loaded else 0.0
            if values.falls and self.at == "ref":
                fall = SPREAD * self.width.as_array()
                known = 0.0 if values.stribeck is None else values.stribeck
                values = dataclasses.replace(values, stribeck=tm.maximum(known, fall))
            tau = tau + dry_limit(values, v, None, load, -load) * tm.tanh(v / self.width)
        return Torque(friction=self.share @ tau)

    def _load(self, x: Snapshot, ref: JointMotion) -> Vector:
        """(n,) torques that the motion takes without friction, whoever gives them [N m | N]."""
        along = x.at(ref.q, ref.v) if self.at == "ref" else x
        a = ref.a if isinstance(ref, JointMotion) else tm.zeros(x.n)  # a law of task space asks for none of joints
        return along.inverse_dynamics(a)
