"""Laws of joint motion, and against friction: sections 10.2.1 and 10.2.2 of the chapter.

A closed loop is stated in continuous time, as the chapter states it; a sampled one tends to it as dt falls. `e` is
desired minus actual, f(v) the friction of the plant: b v for viscous, mu sign(v) for dry friction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from taut.base.errors import MatchError, ShapeError
from taut.base.fields import Choice, Field, Part
from taut.base.types import Array, Vector
from taut.control.closed_loop import ClosedLoop
from taut.control.command import Command, Position, Terms, Torque, Velocity
from taut.control.gains import Gain, Integral, MemoryView
from taut.control.law import Law, call
from taut.control.sensing import check_frequencies
from taut.control.trajectories.reference import JointMotion, Sample
from taut.maths.friction import FrictionValues, friction_torque
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

RAISED: Final = ("kp", "kd")
INTEGRAL: Final = "e_int"
SPREAD: Final = 3.0  # widths over which an excess that drops at once acts: tanh is near 1 there


class PID(Law):
    """PID control, each joint on its own: the decentralised controller. P, PI and PD by the gains.

    Law:          tau = kp e + ki int(e) + kd e_dot                                     eq. 10.6, figure 10.8
    Closed loop:  M e_ddot + (b + kd) e_dot + kp e + ki int(e) = tau_dist, one joint at a set-point    eq. 10.12
                  tau_dist is what it takes to hold the joint, such as gravity; a motion adds M a_des + b v_des
                  stable for 0 <= ki < (b + kd) kp / M
                  a constant disturbance then leaves no error with ki > 0, and the error tau_dist / kp without

    The integral includes this tick's error, as in the chapter's pseudocode. Where limits cut the torque `integral`
    keeps it from winding up.

    References:
        Section 10.2.1.1 PID control; section 10.2.2.1 decentralised multi-joint control.
    """

    kp: Gain = Gain(unit="N m/rad | N/m")
    kd: Gain = Gain(0.0, unit="N m s/rad | N s/m")
    ki: Gain = Gain(0.0, unit="N m/(rad s) | N/(m s)")
    integral: Part[Integral] = Part(Integral, default=Integral())

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """M e_ddot + kd e_dot + kp e + ki int(e) = 0, each joint with its own inertia unless gains are matrices."""
        return ClosedLoop.of_joints(
            x, lambda g: replace(self, kp=g.K, kd=g.D, ki=g.Ki), inertia=x.M, stiffness=True, decentralised=True
        )

    def command(
        self, x: Snapshot, ref: JointMotion, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        e, e_dot = x.difference(ref.q), ref.v - x.v
        e_int, integral = self.integral.step(memory.integral, e, dt, ki=self.ki, cut=lambda: x.tau_cut)
        return Torque(P=self.kp @ e, I=self.ki @ e_int, D=self.kd @ e_dot), {"integral": integral}


class FeedForward(Law):
    """Feedforward control: the model's torques along the desired motion. Use it with feedback: + PID(...).

    Law:          tau = M(q_des) a_des + h(q_des, v_des)                                eq. 10.16, figure 10.9
    Closed loop:  M(q) e_ddot = (M(q) - M(q_des)) a_des + h(q, v) - h(q_des, v_des) + f(v), with an exact model
                  near the motion M e_ddot + (dh/dv) e_dot + d(M a_des + h)/dq e = f(v)
                  from an exact start it follows exactly, but for friction
                  an error oscillates where the arm hangs, and grows where it stands upright

    References:
        Section 10.2.1.2 feedforward control.
    """

    def command(self, x: Snapshot, ref: JointMotion) -> Command:
        desired = x.at(ref.q, ref.v)
        return Torque(desired.M @ Terms(feedforward=ref.a) + Terms(nonlinear=desired.h))


class ComputedTorque(Law):
    """Joint-space feedback linearisation (computed torque).

    Law:          tau = M(q) (a_des + kp e + ki int(e) + kd e_dot) + h(q, v)            eq. 10.19, 10.21
    Closed loop:  e_ddot + kd e_dot + kp e + ki int(e) = 0, with an exact model and no friction    eq. 10.17
                  omega_n = sqrt(kp), zeta = kd / (2 sqrt(kp)) for ki = 0; stable for 0 <= ki < kd kp
                  friction, which h has none of, puts M(q)^-1 f(v) on the right
                  + FrictionCompensation(at="meas") takes it away, but for dry friction at rest
                  a sampled loop tends to this as dt falls

    References:
        Section 10.2.1.3 feedforward plus feedback linearisation; section 10.2.2.2 centralised control.
    """

    kp: Gain = Gain(unit="1/s^2")
    kd: Gain = Gain(unit="1/s")
    ki: Gain = Gain(0.0, unit="1/s^3")
    integral: Part[Integral] = Part(Integral, default=Integral())

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """e_ddot + kd e_dot + kp e + ki int(e) = 0."""
        return ClosedLoop.of_joints(x, lambda g: replace(self, kp=g.K, kd=g.D, ki=g.Ki))

    def command(
        self, x: Snapshot, ref: JointMotion, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        e, e_dot = x.difference(ref.q), ref.v - x.v
        e_int, integral = self.integral.step(
            memory.integral,
            e,
            dt,
            ki=self.ki,
            cut=lambda: x.tau_cut,
            lost=lambda: tm.solve_spd(x.M_factors, x.tau_cut),
        )
        a = Terms(feedforward=ref.a, P=self.kp @ e, I=self.ki @ e_int, D=self.kd @ e_dot)
        return Torque(x.M @ a + Terms(nonlinear=x.h)), {"integral": integral}


class StateFeedback(Law):
    """Linear feedback of all positions and velocities to all torques, as `taut.analysis.lqr` designs it.

    Law:          tau = tau_0 + K_q (q_des - q) + K_v (v_des - v)
    Closed loop:  near the pose at which tau_0 holds the arm M e_ddot + (K_v + b) e_dot + (K_q + dg/dq) e = 0; each
                  joint answers to the errors of the others; away from that pose the error of tau_0 remains

    Args:
        K_q: (n, n) torques over position errors.
        K_v: (n, n) torques over velocity errors.
        tau_0: Torque that holds the arm at the pose of the design.

    References:
        Astrom and Wittenmark, Computer-controlled systems (1997), section 4.2.
    """

    K_q: Field = Field(unit="N m/rad | N/m", shape=("n", "n"))
    K_v: Field = Field(unit="N m s/rad | N s/m", shape=("n", "n"))
    tau_0: Gain = Gain(unit="N m | N", accepts=("scalar",), minimum=-math.inf)

    def check(self) -> None:
        for name in ("K_q", "K_v"):
            shape = np.shape(getattr(self, name))
            if shape != (shape[0],) * 2 or self.tau_0.shape not in ((), shape[:1]):
                self.refuse(
                    name, f"must be square, with a row for each entry of tau_0; got shape {shape}", ShapeError
                )

    def command(self, x: Snapshot, ref: JointMotion) -> Command:
        e, e_dot = x.difference(ref.q), ref.v - x.v
        return Torque(P=self.K_q @ e, D=self.K_v @ e_dot, gravity=self.tau_0 * np.ones(x.n))


class GravityPID(Law):
    """PID control with gravity compensation (known elsewhere as joint impedance control).

    Law:          tau = kp e + ki int(e) + kd e_dot + g(q)                              eq. 10.22
    Closed loop:  M a + C v = kp e - kd v, for a set-point, ki = 0, an exact g and no friction    eq. 10.23
                  V = e . kp e / 2 + v . M v / 2 falls at the rate v . kd v                        eq. 10.25, 10.27
                  globally asymptotically stable for kp > 0 and kd > 0, where no joint wraps, in continuous time;
                    held over a tick, kd diverges where M^-1 kd dt has an eigenvalue above 2
                  viscous friction adds to kd; dry friction leaves an error of up to mu / kp

    References:
        Section 10.2.2.2 centralised multi-joint control, equations 10.22 to 10.27.
    """

    kp: Gain = Gain(unit="N m/rad | N/m")
    kd: Gain = Gain(unit="N m s/rad | N s/m")
    ki: Gain = Gain(0.0, unit="N m/(rad s) | N/(m s)")
    integral: Part[Integral] = Part(Integral, default=Integral())

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """M e_ddot + kd e_dot + kp e + ki int(e) = 0, each joint with its own inertia unless gains are matrices."""
        return ClosedLoop.of_joints(
            x, lambda g: replace(self, kp=g.K, kd=g.D, ki=g.Ki), inertia=x.M, stiffness=True, decentralised=True
        )

    def command(
        self, x: Snapshot, ref: JointMotion, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        e, e_dot = x.difference(ref.q), ref.v - x.v
        e_int, integral = self.integral.step(memory.integral, e, dt, ki=self.ki, cut=lambda: x.tau_cut)
        tau = Torque(P=self.kp @ e, I=self.ki @ e_int, D=self.kd @ e_dot, gravity=x.g)
        return tau, {"integral": integral}


class GravityCompensation(Law):
    """Gravity compensation with joint damping: hand guiding.

    Law:          tau = g(q) - kd v                              eq. 10.22 with kp = ki = 0 and v_des = 0
    Closed loop:  M a + C v + kd v + f(v) = tau_ext, with an exact g: the arm floats, and follows a hand

    References:
        Section 10.2.2.2 centralised multi-joint control.
    """

    ignores_reference = True
    kd: Gain = Gain(0.0, unit="N m s/rad | N s/m")

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """M v_dot + kd v = 0."""
        return ClosedLoop.of_joints(
            x, lambda g: replace(self, kd=g.D), inertia=x.M, single_pole="always", decentralised=True
        )

    def command(self, x: Snapshot, ref: Sample) -> Command:  # noqa: ARG002
        return Torque(gravity=x.g, D=-(self.kd @ x.v))


class VelocityPI(Law):
    """Velocity-input control: feedforward plus PI, for arms whose drives close the velocity loop.

    Law:          v_cmd = v_des + kp e + ki int(e)                    published edition, section 11.3
    Closed loop:  e_dot + kp e + ki int(e) = 0, where the drives follow v_cmd exactly

    References:
        Lynch and Park, Modern Robotics (2017), section 11.3 motion control with velocity inputs.
    """

    kp: Gain = Gain(unit="1/s")
    ki: Gain = Gain(0.0, unit="1/s^2")
    integral: Part[Integral] = Part(Integral, default=Integral())

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """e_ddot + kp e_dot + ki e = 0; with ki = 0 one pole, e_dot + kp e = 0."""
        return ClosedLoop.of_joints(x, lambda g: replace(self, kp=g.D, ki=g.K), single_pole="possible")

    def command(
        self, x: Snapshot, ref: JointMotion, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        e = x.difference(ref.q)
        e_int, integral = self.integral.step(memory.integral, e, dt, ki=self.ki, cut=lambda: x.tau_cut)
        return Velocity(feedforward=ref.v, P=self.kp @ e, I=self.ki @ e_int), {"integral": integral}


class JointPosition(Law):
    """The reference's joint positions as they are, for arms whose drives close the position loop.

    Law:          q_cmd = q_des                                       the servos of an industrial arm
    Closed loop:  that of the drives
    """

    def command(self, x: Snapshot, ref: JointMotion) -> Command:  # noqa: ARG002
        return Position(reference=ref.q)


class FrictionCompensation(Law):
    """The model's joint friction as feedforward; add it to a law whose h is C v + g.

    Law:          tau = share (viscous v* + d(v*) tanh(v* / width)), v* the desired or the measured velocity
                  d(v) = coulomb + (static - coulomb) exp(-(|v| / stribeck)^shape) + (load_external + load_motor) |T|
                  T = M a_des + C v* + g, the torque of the load; its static excess decays like that of `static`
                  an excess that drops at once (stribeck = 0) acts over 3 widths with at="ref", not with at="meas"
    Closed loop:  with exact parameters f(v) - tau takes the place of f(v)
                  at="ref": viscous friction becomes -b e_dot: it damps errors and does not resist the motion
                  static friction is applied where the reference starts or reverses, and helps the joint break away
                  at="meas": no friction is left, and so no damping, but for dry friction at rest, |v| < width
                  it never exceeds the friction that is present, and so never the break-away torque
                  share < 1 leaves the rest of the friction to feedback

    Overcompensation drives the joint: with at="meas" it turns slow motion into a limit cycle, so a share of 0.8 to
    0.9 is usual where friction is not known well. The friction that the compensating torque itself causes through the
    load is neglected: too little by a factor 1 - load_motor.

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
        load = self._load(x, ref) if values.loaded else 0.0
        if values.falls and self.at == "ref":
            fall = SPREAD * self.width.as_array()
            known = 0.0 if values.stribeck is None else values.stribeck
            values = replace(values, stribeck=tm.maximum(known, fall))
        return Torque(friction=self.share @ -friction_torque(values, v, load, -load, self.width))

    def _load(self, x: Snapshot, ref: JointMotion) -> Vector:
        """(n,) torques of the motion without friction, whoever provides them [N m | N]."""
        along = x.at(ref.q, ref.v) if self.at == "ref" else x
        a = ref.a if isinstance(ref, JointMotion) else tm.zeros(x.n)  # a law of task space asks for none of joints
        return along.inverse_dynamics(a)


class Dither(Law):
    """Dither: a fast torque of zero mean that smooths dry friction; add it to a law: PID(...) + Dither(...).

    Law:          tau = A sin(2 pi f t), each joint on its own
    Closed loop:  that of the law it is added to, with (2 mu / pi) asin(v / V) in place of dry friction mu sign(v)
                  on average, while |v| < V = sqrt(A^2 - (4 mu / pi)^2) / (2 pi f M), the amplitude of its velocity
                  near rest that is viscous friction (2 mu / (pi V)) v: no stiction, but damping
                  A must be well above the static friction, and f well above the bandwidth of the loop

    The frequency must be below half the controller's rate (Nyquist). A change of frequency during a run changes the
    phase at once; `Limits(blend=)` smooths the jump.

    References:
        Section 10.2.1.4 a closer look at friction. Armstrong-Helouvry, Dupont and Canudas de Wit (1994), section 4.
    """

    ignores_reference = True
    amplitude: Gain = Gain(unit="N m | N", accepts=("scalar",))
    frequency: Gain = Gain(unit="Hz", accepts=("scalar",), above=0.0)

    def check_rate(self, rate: float) -> None:
        check_frequencies(self, "Dither", rate)

    def command(self, x: Snapshot, ref: JointMotion) -> Command:  # noqa: ARG002
        cycles = np.ones(x.n) * (self.frequency.as_array() * x.t)
        wave = tm.sin(2.0 * np.pi * (cycles - tm.floor(cycles)))  # of what is left of whole turns: exact for hours
        return Torque(dither=self.amplitude @ wave)


class RaisedGains(Law):
    """Larger gains near zero velocity, against sticking: holds a law and raises its gains where the arm rests.

    Law:          that of the law it holds, with s kp and s kd in place of kp and kd, and int(s e) in place of int(e)
                  s = 1 + (factor - 1) exp(-(v / width)^2), joint by joint, v the measured velocity
    Closed loop:  that of the law it holds where |v| is some widths; at rest that with kp, kd and ki times the factor
                  there dry friction leaves an error of up to mu / (factor kp) in place of mu / kp
                  the integral changes faster near rest; neither it nor the torque jumps with v
                  s kp e is a stiffness that decreases as the joint starts to move

    It raises gains named kp and kd, also of the laws in a sum, and what is integrated into a memory named e_int;
    other gains are left as they are. A matrix K becomes S K S with S the root of diag(s).

    References:
        Section 10.2.1.4 a closer look at friction.
    """

    inner: Law
    factor: Gain = Gain(unit="1", accepts=("scalar",), minimum=1.0)
    width: Gain = Gain(0.05, unit="rad/s | m/s", accepts=("scalar",), above=0.0)

    def check(self) -> None:
        if not _raised(self.inner):
            self.refuse("inner", f"must have kp or kd, which are raised; {type(self.inner).__name__} has neither")
        self.__dict__["reference"] = self.inner.reference

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        ratio = x.v / self.width.as_array()
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
