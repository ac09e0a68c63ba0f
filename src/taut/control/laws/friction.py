"""Friction: compensation by the model, and laws against stiction: dither, and gains that are raised near rest."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.base.errors import MatchError, RangeError
from taut.base.fields import Choice
from taut.base.types import Array, Vector
from taut.control.command import Command, Torque
from taut.control.gains import Gain
from taut.control.law import Law, MemoryView, call
from taut.control.trajectories.reference import JointMotion
from taut.maths.friction import FrictionValues, dry_limit
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["Dither", "FrictionCompensation", "RaisedGains"]

RAISED: Final = ("kp", "kd")
INTEGRAL: Final = "e_int"
TRACKING: Final = "tracking"  # how fast limits drive an integral back [1/s]
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

    at: Choice[str] = Choice("ref", "meas")
    width: Gain = Gain(0.01, unit="rad/s | m/s", above=0.0)
    share: Gain = Gain(1.0, unit="1", maximum=1.0)

    def check(self) -> None:
        self.__dict__["ignores_reference"] = self.at == "meas"

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


class Dither(Law):
    """Dither: a fast torque of zero mean that smooths dry friction; add it to a law: PID(...) + Dither(...).

    Law:          tau = A sin(2 pi f t), each joint on its own
    Closed loop:  that of the law it is added to, with (2 mu / pi) asin(v / V) in place of dry friction mu sign(v)
                  on average, while |v| < V = sqrt(A^2 - (4 mu / pi)^2) / (2 pi f M), what the dither shakes it with
                  that is viscous friction (2 mu / (pi V)) v near rest, which holds no joint, but slows it down
                  it needs A well above the static friction, and f well above what the loop follows

    The frequency must be below half the rate of the controller, where a sampled sine is no sine any more. Another
    frequency in a run is another phase at once; `Limits(blend=)` takes the jump up.

    References:
        Section 10.2.1.4 a closer look at friction. Armstrong-Helouvry, Dupont and Canudas de Wit (1994), section 4.
    """

    ignores_reference = True
    amplitude: Gain = Gain(unit="N m | N", accepts=("scalar",))
    frequency: Gain = Gain(unit="Hz", accepts=("scalar",), above=0.0)

    def check_rate(self, rate: float) -> None:
        largest = float(np.max(self.frequency.as_array()))
        if largest >= rate / 2.0:
            raise RangeError(
                f"frequency of a Dither must be below {rate / 2.0:g} [Hz], half the rate of {rate:g} Hz; got "
                f"{largest:g}; lower it, or compile with a higher rate",
                name="frequency",
                value=largest,
            )

    def command(self, x: Snapshot, ref: JointMotion) -> Command:  # noqa: ARG002
        cycles = np.ones(x.n) * (self.frequency.as_array() * x.t)
        wave = tm.sin(2.0 * np.pi * (cycles - tm.floor(cycles)))  # of what is left of whole turns: exact for hours
        return Torque(dither=self.amplitude @ wave)


class RaisedGains(Law):
    """Larger gains near zero velocity, against sticking: holds a law and raises its gains where the arm rests.

    Law:          that of the law it holds, with s kp and s kd in place of kp and kd, and int(s e) in place of int(e)
                  s = 1 + (factor - 1) exp(-(v* / width)^2), joint by joint, v* the measured or the desired velocity
    Closed loop:  that of the law it holds where |v*| is some widths; at rest that with kp, kd and ki times the factor
                  there dry friction leaves an error of up to mu / (factor kp) in place of mu / kp
                  the integral changes faster near rest, and does not jump or breathe with v; neither does the torque
                  at="meas": v* changes with the motion, and s kp e is a stiffness that falls as the joint moves off

    It raises gains named kp and kd, also of the laws in a sum, and what is integrated into a memory named e_int;
    other gains are left as they are. A matrix K becomes S K S with S the root of diag(s).

    References:
        Section 10.2.1.4 a closer look at friction.
    """

    inner: Law
    factor: Gain = Gain(unit="1", accepts=("scalar",), minimum=1.0)
    width: Gain = Gain(0.05, unit="rad/s | m/s", accepts=("scalar",), above=0.0)
    at: Choice[str] = Choice("meas", "ref")

    def check(self) -> None:
        inner, follows = type(self.inner).__name__, self.inner.reference
        if not _raised(self.inner):
            self.refuse("inner", f"must have kp or kd, which are raised; {inner} has neither")
        if self.at == "ref" and follows is not JointMotion:
            self.refuse(
                "at",
                f"'ref' is for a law of JointMotion, and {inner} follows a {follows.__name__}; use 'meas'",
            )
        self.__dict__["reference"] = follows

    def check_rate(self, rate: float) -> None:
        """The integral is driven back faster too, and not faster than the rate [Hz]."""
        factor = float(np.max(self.factor.as_array()))
        rates = [gain for path, gain in self.inner.parameters().items() if path.rpartition(".")[2] == TRACKING]
        largest = max((float(np.max(gain)) for gain in rates), default=0.0)
        if factor * largest > rate:
            raise RangeError(
                f"tracking of a law whose gains are raised must be at most the rate over the factor, "
                f"{rate / factor:g} [1/s], or its integral would oscillate near rest; got {largest:g}",
                name="inner.tracking",
                value=largest,
            )

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        v = ref.v if self.at == "ref" else x.v
        ratio = v / self.width.as_array()
        s = 1.0 + (self.factor.as_array() - 1.0) * tm.exp(-ratio * ratio)
        raised = {path: _scaled(gain, s) for path, gain in _raised(self.inner).items()}
        inner = self.inner.bound({**self.inner.parameters(), **raised})
        before = memory["inner"]
        command, after = call(inner, x, ref, before, dt)
        return command, {"inner": _faster(before, after, s)}


def _raised(law: Law) -> dict[str, Array]:
    """The gains that are raised, by path."""
    return {path: gain for path, gain in law.parameters().items() if path.rpartition(".")[2] in RAISED}


def _scaled(gain: Array, s: Vector) -> Array:
    """s K joint by joint; a matrix stays symmetric and positive."""
    if gain.ndim < 2:
        out: Array = s * gain
        return out
    root = tm.sqrt(s)
    matrix: Array = root[:, np.newaxis] * gain * root
    return matrix


def _faster(before: Mapping[str, Any], after: Mapping[str, Any], s: Vector) -> dict[str, Any]:
    """Memory in which integrals have changed by s times as much."""
    out: dict[str, Any] = {}
    for name, value in after.items():
        if isinstance(value, Mapping):
            out[name] = _faster(before[name], value, s)
        else:
            out[name] = before[name] + s * (value - before[name]) if name == INTEGRAL else value
    return out
