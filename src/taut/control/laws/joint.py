"""Laws of joint motion: sections 10.2.1 and 10.2.2 of the chapter.

A closed loop is stated in continuous time, as the chapter states it; a sampled one tends to it as dt falls. `e` is
desired minus actual, f(v) the friction of the plant: b v for viscous, mu sign(v) for dry friction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from taut.base.fields import Part
from taut.control.command import Command, Terms, Torque, Velocity
from taut.control.gains import Gain
from taut.control.integral import Integral
from taut.control.law import Law, MemoryView
from taut.control.trajectories.reference import JointMotion, Sample
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

if TYPE_CHECKING:
    from taut.control.closed_loop import ClosedLoop, PlacedGains

__all__ = [
    "PID",
    "ComputedTorque",
    "FeedForward",
    "GravityCompensation",
    "GravityPID",
    "VelocityPI",
]


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
        return _of_joints(
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
        return _of_joints(x, lambda g: replace(self, kp=g.K, kd=g.D, ki=g.Ki))

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
        return _of_joints(
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
        return _of_joints(x, lambda g: replace(self, kd=g.D), inertia=x.M, single_pole="always", decentralised=True)

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
        return _of_joints(x, lambda g: replace(self, kp=g.D, ki=g.K), single_pole="possible")

    def command(
        self, x: Snapshot, ref: JointMotion, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        e = x.difference(ref.q)
        e_int, integral = self.integral.step(memory.integral, e, dt, ki=self.ki, cut=lambda: x.tau_cut)
        return Velocity(feedforward=ref.v, P=self.kp @ e, I=self.ki @ e_int), {"integral": integral}


def _of_joints(x: Snapshot, gains: Callable[[PlacedGains], Law], **options: Any) -> ClosedLoop:
    """The closed loop of a law of joints; for a design alone, so that a controller does not load it."""
    from taut.control.closed_loop import ClosedLoop

    return ClosedLoop.of_joints(x, gains, **options)
