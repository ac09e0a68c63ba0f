"""Laws of flexible joints: a motor and its link with a spring between them, as behind a harmonic drive.

    Links:   M(q) a + C v + g = tau_J,   tau_J = K (q_motor - q) + D (v_motor - v)      Spong (1987)
    Motors:  B a_motor + tau_J = tau

B is the rotor inertia of the controller's arm, which rigid laws count as part of M; these laws use the model of the
links alone. K is a parameter of each law, `stiffness`: a Field and no Gain, so that the judgement of a loop never
proposes a lower one. q_motor and v_motor are measured on the motor's side of the spring, in joint units; tau_J is the
joint torque sensor.
"""

from __future__ import annotations

from typing import Any, Final, Self

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, finite_scalar, positive_scalar
from taut.base.errors import MatchError, RangeError
from taut.base.fields import Field
from taut.base.types import Array, ArrayLike, Vector
from taut.control.closed_loop import ClosedLoop
from taut.control.combine import Wrapper
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, MemoryView, require_at_most
from taut.control.law import Law
from taut.control.trajectories.reference import SmoothMotion
from taut.maths.model import model_of
from taut.maths.snapshot import Snapshot, snapshot
from taut.trace import math as tm

SPRING: Final = "N m/rad | N/m"


def with_rotors(x: Snapshot, inertia: ArrayLike) -> Snapshot:
    """The snapshot of the same arm with other rotors, (n,) or a scalar [kg m^2 | kg]; 0 is the links alone."""
    model = model_of(x.arm.with_joints(rotor_inertia=inertia))
    return x.of_model(model, x.measured, elsewhere=x.elsewhere)


def spring_torque(links: Snapshot, q: Vector, v: Vector, a: Vector, j: Any, s: Any) -> tuple[Vector, Vector, Vector]:
    """The spring torque that moves the links along a path with these derivatives, and its two rates, (n,) each."""

    def tau(t: Array) -> Vector:
        dt = t[0]
        q_t, v_t, a_t = (x + dt * (x_1 + 0.5 * dt * x_2) for x, x_1, x_2 in ((q, v, a), (v, a, j), (a, j, s)))
        return links.at(q_t, v_t).inverse_dynamics(a_t)

    def rate(t: Array) -> Vector:
        return tm.jacobian(tau, t)[:, 0]

    links.used.update(("gravity", "coriolis"))
    now = np.zeros(1)
    return tau(now), rate(now), tm.jacobian(rate, now)[:, 0]


def desired_motor(x: Snapshot, ref: Any, K: Any) -> tuple[Vector, Vector, Vector]:
    """q_des + tau_J / K of the motors, its rate, and tau_J + B a_motor, with which the links follow a reference."""
    tau, rate, second = spring_torque(with_rotors(x, 0.0), ref.q, ref.v, ref.a, ref.j, ref.s)
    return ref.q + tau / K, ref.v + rate / K, tau + x.arm.rotor_inertia * (ref.a + second / K)


def check_whole_torque(law: Law, x: Snapshot) -> None:
    """MatchError where the plant adds gravity or Coriolis torques: these laws give all that the motors do."""
    if np.any(x.at(x.q + 0.3, x.v + 1.0).added):  # a state in which both show
        raise MatchError(
            f"{type(law).__name__} gives the whole torque of the motors, and the plant adds a part of it itself; use "
            "a plant with adds=(), or a law of rigid joints",
            name="adds",
        )


def check_rotors(law: type[Law], x: Snapshot) -> None:
    """MatchError for a motor without inertia, which would follow any torque at once."""
    for joint, inertia in zip(x.arm.joint_names, x.arm.rotor_inertia, strict=True):
        if not inertia > 0.0:
            raise MatchError(
                f"{law.__name__} needs the rotor inertia of each joint, and the model's joint '{joint}' has "
                "none; give the arm gears: arm.with_gears(ratio=100.0, motor_inertia=1e-4)",
                joint=joint,
                name="rotor_inertia",
            )


class MotorSidePD(Law):
    """PD control of the motors of flexible joints, with the feedforward of the links' motion.

    Law:          tau = m (kp (q_m,des - q_motor) + kd (v_m,des - v_motor)) + tau_J,des + B a_m,des
                  q_m,des = q_des + tau_J,des / K, with tau_J,des = M_links a_des + C v_des + g at the desired motion;
                  v_m,des and a_m,des are its rates, by the reference's jerk and snap; m = M_ii(q_des), B included
                  for a set-point: m (kp (q_des + g(q_des) / K - q_motor) - kd v_motor) + g(q_des)
    Closed loop:  of a set-point globally asymptotically stable, in continuous time, where for each joint
                  K m kp / (K + m kp) > alpha >= |dg/dq|: spring and gain in series are stiffer than gravity;
                  `taut.analysis.set_point_condition` gives the margin
                  with an exact model and start it follows a motion exactly; an error of the link decays as kd and D
                  damp the joint
                  held over a tick, m kd dt must stay well below 2 B, the rotor that it acts on

    Args:
        stiffness: K of each joint.
        kp: omega^2 of a rigid joint.
        kd: 2 zeta omega.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint").with_gears(ratio=100.0, motor_inertia=2e-5)
        >>> ctrl = taut.compile(taut.laws.MotorSidePD(stiffness=500.0, kp=100.0, kd=20.0), arm)
        >>> ctrl.step(q=[0.0], q_motor=[0.0], v_motor=[0.0], ref=taut.JointMotion(q=[0.0])).round(3).tolist()
        [1.118]

    References:
        Tomei, A simple PD controller for robots with elastic joints, IEEE Trans. Automatic Control 36 (10), 1991.
        De Luca, Feedforward/feedback laws for the control of flexible robots, IEEE ICRA (2000).
    """

    reference = SmoothMotion
    stiffness: Field = Field(unit=SPRING, shape="n", above=0.0)
    kp: Gain = Gain(unit="1/s^2", accepts=("scalar",))
    kd: Gain = Gain(unit="1/s", accepts=("scalar",))

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_whole_torque(self, x)

    def command(self, x: Snapshot, ref: SmoothMotion) -> Command:
        (q, v, tau), M = desired_motor(x, ref, self.stiffness), x.at(ref.q, ref.v).M
        m = tm.array([M[i, i] for i in range(x.n)])
        feedback = Terms(P=self.kp @ x.arm.difference(q, x.q_motor), D=self.kd @ (v - x.v_motor))
        return Torque(m * feedback + Terms(feedforward=tau))


class MotorSide(Wrapper):
    """A law of rigid joints on the measurements of the motors: what an arm without encoders on its links runs.

    Law:          that of the law, with q_motor and v_motor in the place of q and v
    Closed loop:  that of the law for the motors; the links hang on them by their springs, with the error tau_J / K
                  and their own oscillation, which D alone damps

    Args:
        law: A law of rigid joints.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint").with_gears(ratio=100.0, motor_inertia=2e-5)
        >>> ctrl = taut.compile(MotorSide(law=taut.laws.PID(kp=10.0)), arm)
        >>> ctrl.step(q=[0.0], q_motor=[0.1], v_motor=[0.0], ref=taut.JointMotion(q=[0.0])).tolist()
        [-1.0]

    References:
        De Luca and Book, Robots with flexible elements, Springer Handbook of Robotics.
    """

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        seen = {**x.measured, "q": x.q_motor, "v": x.v_motor}
        return self.inner(self.law, x.of_model(x.model, seen, elsewhere=True), ref, memory, dt)


class FastTorqueLoop(Wrapper):
    """Fast inner loop of the joint torque around any law of rigid joints: control by singular perturbation.

    Law:          tau = tau_J + B (a + (bandwidth^2 (tau_law - tau_J) - 2 bandwidth tau_J') / K)
                  a = M_links^-1 (tau_J - C v - g), tau_J measured, tau_J' = K (v_motor - v)
                  the law sees the links without rotors, which this loop moves
    Closed loop:  tau_J'' + 2 bandwidth tau_J' + bandwidth^2 (tau_J - tau_law) = 0, with an exact model and D = 0
                  the links follow tau_J, so the loop is that of the law and errors of order 1 / bandwidth
                    (Tikhonov's theorem), for a bandwidth well above that of the law
                  sampled, it needs bandwidth dt well below 1; a torque sensor's delay comes on top

    Args:
        law: Any law that gives torques, such as `taut.laws.ComputedTorque` or `Impedance`.
        stiffness: K of each joint.
        bandwidth: Of the torque, both poles.

    References:
        Spong, Modeling and control of elastic joint robots, J. Dynamic Systems, Measurement and Control 109 (1987).
        Kokotovic, Khalil and O'Reilly, Singular Perturbation Methods in Control (1986), section 1.3.
    """

    stiffness: Field = Field(unit=SPRING, shape="n", above=0.0)
    bandwidth: Gain = Gain(unit="rad/s", accepts=("scalar",), above=0.0)

    def check_rate(self, rate: float) -> None:
        require_at_most("bandwidth", self.bandwidth.as_array(), rate, "rad/s", "or the torque loop oscillates")

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_rotors(type(self), x)
        check_whole_torque(self, x)

    def closed_loop(self, x: Snapshot) -> ClosedLoop | None:
        return Wrapper.closed_loop(self, with_rotors(x, 0.0))

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        links, K, w = with_rotors(x, 0.0), self.stiffness, self.bandwidth.as_array()
        tau, after = self.inner_torque(links, ref, memory, dt)
        B, tau_J, rate = x.arm.rotor_inertia, x.tau_meas, self.stiffness * (x.v_motor - x.v)
        moved = tau_J + B * (links.forward_dynamics(tau_J) - (w * w * tau_J + 2.0 * w * rate) / K)
        return Torque((B * w * w / K) * tau + Terms(torque_loop=moved)), after


class JointTorqueFeedback(Wrapper):
    """Joint torque feedback that shapes the rotor inertia that the arm shows, around any law.

    Law:          tau = (B / B_des) tau_law + (1 - B / B_des) tau_J, tau_J measured
                  the law sees the arm with rotors of B_des
    Closed loop:  B_des a_motor + tau_J = tau_law: passive in continuous time where the law is
                  B / B_des > 1 also divides motor friction by that factor, and amplifies noise of the sensor by it
                  sampled, B / B_des has a limit of stability, the lower the stiffer the joint and the later the
                  torque, which `taut.linearise` shows

    Args:
        law: Any law that gives torques, such as `MotorSidePD`.
        inertia: B_des of each joint.

    References:
        Albu-Schaeffer, Ott and Hirzinger, A unified passivity-based control framework for position, torque and
        impedance control of flexible joint robots, International Journal of Robotics Research 26 (2007).
    """

    inertia: Field = Field(unit="kg m^2 | kg", shape="n", above=0.0, run_time=False)

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_rotors(type(self), x)

    def closed_loop(self, x: Snapshot) -> ClosedLoop | None:
        return Wrapper.closed_loop(self, with_rotors(x, self.inertia))

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        tau, after = self.inner_torque(with_rotors(x, self.inertia), ref, memory, dt)
        ratio = x.arm.rotor_inertia / self.inertia
        return Torque(ratio * tau + Terms(torque_feedback=(1.0 - ratio) * x.tau_meas)), after


class FullStateFeedback(Law):
    """Feedback of the full state of one flexible joint, with the feedforward of its motion.

    Law:          tau = k . (x_des - x) + tau_J,des + B a_m,des, with x = (q, v, q_motor, v_motor)
                  x_des and the torques along the reference as of `MotorSidePD`
    Closed loop:  the four poles that `placed` is given, exactly, also in the sampled loop, with M, K, D and the
                  slope of gravity at the pose for which it was made

    Args:
        stiffness: K of the joint, for x_des.
        feedback: (4,) k: of link position and velocity, motor position and velocity [N m/rad, N m s/rad, ...].

    References:
        Spong, Hutchinson and Vidyasagar, Robot Modeling and Control (2006), section 6.5, drive train dynamics.
    """

    reference = SmoothMotion
    stiffness: Field = Field(unit=SPRING, above=0.0)
    feedback: Gain = Gain(unit="N m/rad, N m s/rad", shape=4, accepts=(), minimum=-np.inf)

    @classmethod
    def placed(
        cls,
        arm: Arm,
        *,
        stiffness: float,
        poles: ArrayLike,
        rate: float,
        damping: float = 0.0,
        at: ArrayLike | None = None,
    ) -> Self:
        """The law whose sampled loop has four poles, by SciPy's placement on the zero-order-hold model.

        Args:
            arm: One joint with rotor inertia.
            stiffness: K of its spring [N m/rad | N/m].
            poles: Four in s [1/s], all different, conjugates in pairs.
            rate: [Hz].
            damping: D of its spring [N m s/rad | N s/m].
            at: Position for which it is made [rad | m]; home if left out.

        Raises:
            MatchError: More than one joint, or no rotor inertia.
            RangeError: A stiffness that is not positive, or poles that cannot be placed.
        """
        from scipy.signal import cont2discrete, place_poles

        K, D = positive_scalar("stiffness", stiffness, unit=SPRING), finite_scalar("damping", damping, minimum=0.0)
        dt = 1.0 / positive_scalar("rate", rate, unit="Hz")
        x = snapshot(arm, arm.home if at is None else finite_array("at", at, shape=(arm.n,)))
        check_one_joint(x)
        links = with_rotors(x, 0.0)
        M, B = float(links.M[0, 0]), float(arm.rotor_inertia[0])
        slope = float(tm.jacobian(lambda q: links.at(q, x.v).g, x.q)[0, 0])
        link, motor = np.array([-K - slope, -D, K, D]) / M, np.array([K, D, -K, -D]) / B
        A = np.array([[0.0, 1.0, 0.0, 0.0], link, [0.0, 0.0, 0.0, 1.0], motor])
        Ad, Bd, *_ = cont2discrete((A, np.array([[0.0], [0.0], [0.0], [1.0 / B]]), np.eye(4), np.zeros((4, 1))), dt)
        desired = np.asarray(poles, dtype=np.complex128)
        wrong = RangeError(
            "poles must be four [1/s], finite, with negative real parts, all different, and conjugates in pairs, "
            f"such as -20, -22, -24, -26; got {[x.real if x.imag == 0.0 else x for x in desired.tolist()]}",
            name="poles",
        )
        if np.any(desired.real >= 0.0):
            raise wrong
        try:
            gains = place_poles(Ad, Bd, np.exp(desired * dt)).gain_matrix[0]
        except ValueError as cause:
            raise wrong from cause
        return cls(stiffness=K, feedback=gains)

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_one_joint(x)
        check_whole_torque(self, x)

    def command(self, x: Snapshot, ref: SmoothMotion) -> Command:
        (q, v, tau), k = desired_motor(x, ref, self.stiffness), self.feedback.as_array()
        P = k[0] * x.difference(ref.q) + k[2] * x.arm.difference(q, x.q_motor)
        return Torque(P=P, D=k[1] * (ref.v - x.v) + k[3] * (v - x.v_motor), feedforward=tau)


def check_one_joint(x: Snapshot) -> None:
    """MatchError for an arm of several joints, or a joint without a rotor."""
    if x.n != 1:
        raise MatchError(
            f"FullStateFeedback is of one joint, and '{x.arm.name}' has {x.n}; take MotorSidePD, or one joint alone: "
            "arm.subset",
            name="arm",
        )
    check_rotors(FullStateFeedback, x)


class FlexibleJointLinearisation(Law):
    """Feedback linearisation of flexible joints: links and motors together as chains of four integrators.

    Law:          tau = tau_J + B (a + K^-1 d^2/dt^2 inverse_dynamics(q(t), v(t), a(t))), the path with
                  a = M_links^-1 (tau_J - C v - g), its jerk j from tau_J' = K (v_motor - v) likewise, and the snap
                  s_des + 4 omega (j_des - j) + 6 omega^2 (a_des - a) + 4 omega^3 e_dot + omega^4 e
    Closed loop:  (d/dt + omega)^4 e = 0, with an exact model, exact measurements and D = 0; a sampled loop tends to
                  it, with an error that falls fast with omega, and is unstable where sqrt(K / M) dt is above 1
                  not robust: an error of the model in a enters with 6 omega^2, and slow poles are the unsafe ones;
                  friction of the motor, D and a late sensor are such errors

    Args:
        stiffness: K of each joint.
        omega: The four poles of each joint.

    References:
        Spong (1987). De Luca and Book, Springer Handbook of Robotics.
    """

    reference = SmoothMotion
    stiffness: Field = Field(unit=SPRING, shape="n", above=0.0)
    omega: Gain = Gain(unit="rad/s", accepts=("scalar",), above=0.0)

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_rotors(type(self), x)
        check_whole_torque(self, x)

    def command(self, x: Snapshot, ref: SmoothMotion) -> Command:
        links, none, B = with_rotors(x, 0.0), tm.zeros(x.n), x.arm.rotor_inertia
        K, w = self.stiffness, self.omega.as_array()
        a = links.forward_dynamics(x.tau_meas)
        _, without_jerk, _ = spring_torque(links, x.q, x.v, a, none, none)
        j = tm.solve_spd(links.M_factors, self.stiffness * (x.v_motor - x.v) - without_jerk)
        _, _, without_snap = spring_torque(links, x.q, x.v, a, j, none)
        snap = Terms(
            feedforward=ref.s + 4.0 * w * (ref.j - j) + 6.0 * w**2 * (ref.a - a),
            P=w**4 * x.difference(ref.q),
            D=4.0 * w**3 * (ref.v - x.v),
        )
        return Torque((B / K) * (links.M @ snap) + Terms(nonlinear=x.tau_meas + B * (a + without_snap / K)))
