"""A law of torques for MIT-type motors: gains that run in the motor, the rest as feed-forward."""

from __future__ import annotations

from typing import Any

from taut.control.combine import Wrapper
from taut.control.command import MitCommand
from taut.control.gains import Gain, GainValue, MemoryView
from taut.maths.snapshot import Snapshot


class ViaMit(Wrapper):
    """A law of torques by MIT-type motors, whose own gains act between the ticks of the controller.

    Law:          tau_k of the law in each tick; the motors make of it, at their own rate,
                  tau(t) = tau_k + kp (q_k - q(t)) + kd (v_k - v(t)), with q_k, v_k as measured in the tick
    Closed loop:  that of the law, sampled at the controller's rate, with the part kp, kd of its feedback at the
                  motors' rate: a law of joint PD with the same gains, such as GravityPID, acts as if it ran in the
                  motors

    In the tick the torque is the law's, whatever the motors' gains are; so it is for every law, of joints or of the
    tool. Between ticks the motors' gains stand for its feedback: the nearer they are to -d tau / d q and -d tau / d v
    of the law, joint by joint, the more the loop is that of the faster rate. A task has the wrapper around the law of
    each phase. Without new commands the motors brake and hold the arm near q_k.

    Args:
        law: A law that gives a torque.
        kp_motor: Stiffness that runs in the motors; the law's own kp [N m/rad] if left out, as of PID and GravityPID.
        kd_motor: Damping that runs in the motors; the law's own kd if left out.

    Raises:
        UsageError: No gains, and a law without gains kp and kd of a torque, or with matrices.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(ViaMit(law=taut.laws.GravityPID(kp=50.0, kd=10.0)), arm, rate=100.0)
        >>> q, v, kp, kd, tau = ctrl.step([0.1], [0.0], taut.JointMotion(q=[0.2]))
        >>> kp.tolist(), round(float(tau[0]), 3)
        ([50.0], 5.976)

    References:
        Katz, A low cost modular actuator for dynamic robots, MIT (2018).
    """

    kp_motor: Gain = Gain(unit="N m/rad | N/m", accepts=("scalar",), optional=True)
    kd_motor: Gain = Gain(unit="N m s/rad | N s/m", accepts=("scalar",), optional=True)

    def check(self) -> None:
        super().check()
        for name in ("kp", "kd"):
            if getattr(self, f"{name}_motor") is not None:
                continue
            field, gain = self.law.declared.get(name), getattr(self.law, name, None)
            if not (isinstance(gain, GainValue) and gain.ndim < 2 and getattr(field, "unit", "").startswith("N m")):
                self.refuse(
                    f"{name}_motor",
                    f"is needed: {type(self.law).__name__} has no {name} for each joint that is a torque, as PID and "
                    "GravityPID have",
                )

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: Any) -> tuple[MitCommand, dict[str, Any]]:
        tau, after = self.inner_torque(x, ref, memory, dt)
        gains = {name: getattr(self, f"{name}_motor") for name in ("kp", "kd")}
        own = {name: getattr(self.law, name) if gain is None else gain for name, gain in gains.items()}
        return MitCommand(q=x.q, v=x.v, tau=tau, **own), after
