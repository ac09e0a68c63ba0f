"""Force control: section 10.3 of the chapter, equations 10.34, 10.35 and 10.38."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

import numpy as np

from taut.base.checks import positive_scalar, vector
from taut.base.fields import Choice, Part
from taut.base.types import ArrayLike, Matrix, Rotation, Vector, Wrench
from taut.control.closed_loop import ClosedLoop, PlacedGains
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, GainValue, Integral, MemoryView, require_at_most
from taut.control.law import Law
from taut.control.laws.null_space import Posture, check_null, with_null_space
from taut.control.laws.task_error import inwards, outwards
from taut.control.laws.task_space import bounded_inertia, check_sensor, task_gain, tool_loop, wrench_at
from taut.control.trajectories.force_reference import HybridMotion, TaskForce
from taut.control.trajectories.task_reference import FRAMES, Axes
from taut.maths import dynamics as dyn
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.rows import ConstraintRows
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotated_matrix
from taut.maths.task_inertia import TaskInertia
from taut.trace import math as tm

if TYPE_CHECKING:
    from taut.plant.contact import RigidTouch

Feedback = Literal["wrench", "joint_torque", "none"]
ANY: Final = ("scalar", "pair", "matrix")
STILL: Final = 1e-12  # [m, 1] of a Jacobian's entry: below it that is rounding

E_INT_MAX: Final = (20.0, 2.0)  # [N s, N m s] default bound of the integral of a force's error


class ForceControl(Law):
    """Force control: feedforward of the desired wrench, PI of its error, velocity damping; forces and moments.

    Law:          tau = g(q) + J^T (F_des + kfp F_e + kfi int(F_e) - kdamp V)           eq. 10.34, 10.35, 10.38
                  F_e = F_des - F_app, with F_app = -F_ext of a wrist sensor, or from joint torque sensors
                  feedback="none" is eq. 10.34; kfp and kfi make eq. 10.35, kdamp eq. 10.38
                  the damping is implicit, with V of the free arm at the end of the tick: D V with
                    D = (kdamp^-1 + dt Lambda^-1)^-1, stable for any kdamp at any pose: kdamp in series with
                    Lambda / dt, the strongest damper that a torque held over a tick can be
    Closed loop:  (I + kfp) F_e + kfi int(F_e) = D V + errors of g: at rest F_e decays with the pole
                    -kfi / (1 + kfp), to zero whatever the error of g                  eq. 10.36, 10.37 corrected
                  on a contact of stiffness k and damping b the arm oscillates as m s^2 + c s + (1 + kfp) k with
                    c = D + (1 + kfp) b - kfp k lag, which needs c > 0 and kfi < (1 + kfp) c / m; the lag is
                    dt / 2 of the hold and the age of the measured force
                  on a rigid contact, with a force that is a tick old, stable where kfp + kfi dt / 2 < 1
                  without contact V tends to D^-1 ((I + kfp) F_des + kfi int(F_e)): that of kdamp and dt Lambda^-1
                    in addition, which dominates in directions of small apparent inertia; see `speed_bound`

    With feedback="joint_torque" F_app = J_bar^T (tau_meas - C v - g), J_bar = M^-1 J^T Lambda: J^-T for six joints,
    for more the one pseudoinverse in which accelerations of the free motion do not show as a force. It is right at
    rest, a tick old, and as good as g: an unknown payload is taken for contact, and only a wrist sensor lets the
    integral take it out. Friction of gears does not show in it.

    `taut.laws.LossOfContact` around this law reports that contact is lost. The speed is bounded then. Proof: let w =
    (I + kfp) F_des + kfi int(F_e), bounded by e_int_max, E = v . M v / 2, g exact, and a passive null law. A tick
    under f = w - D V adds dt (V . f + f . dt Lambda^-1 f / 2) <= dt (w . D^-1 w - V . D V) / 2 to E, as
    dt Lambda^-1 <= D^-1: over any time T the mean of V . D V is at most max w . D^-1 w + 2 E(0) / T. About a pose
    y = D^1/2 V goes to (I - S) y + S D^-1/2 w, with S = D^1/2 dt Lambda^-1 D^1/2 symmetric, its eigenvalues in
    [0, 1): from rest V . D V <= max w . D^-1 w at every instant, for w along one line.

    With joint torques the law takes its own force, a tick old, for F_app, also where the tool is free. There it is
    stable where kfp + kfi dt / 2 + d / 2 < 1, d the largest eigenvalue of D dt Lambda^-1: 1/2 for what kfp and kfi
    have serves any kdamp. With a wrist sensor any kdamp is stable off contact.

    Frames:
        frame= names the axes of the gains and the integral, "world" or "tool"; F_des has a frame of its own. All at
        the origin of the tool that is controlled.

    Args:
        kfp: Proportional gain: one number, (linear, angular), (6,) or (6, 6).
        kfi: Integral gain, likewise.
        kdamp: Damping of the tool: (linear, angular), (6,) or (6, 6); none if left out, and then nothing bounds the
            speed when contact is lost.
        e_int_max: (linear, angular) the largest length of each part of the integral.
        feedback: "wrench", "joint_torque" or "none".
        frame: "world" or "tool".
        null: A law for the motion that the task leaves free, `Posture()` if not said, None for none.
        integral: What keeps the integral from winding up where limits cut torques.
        tool: The frame that is controlled; the arm's tool if left out.

    Raises:
        ShapeError: One number for N and N m.
        RangeError: An integral that is unstable at this rate.

    Example:
        >>> import taut
        >>> law = ForceControl(kfp=0.5, kfi=5.0, kdamp=(100.0, 5.0))
        >>> ctrl = taut.compile(law, taut.load_arm("panda"))
        >>> ctrl.needs
        ('v', 'F_ext')
        >>> x = taut.snapshot(ctrl.arm, ctrl.arm.home)
        >>> v, omega = law.speed_bound(F_app=[0, 0, -10.0, 0, 0, 0], x=x, rate=1000.0)
        >>> round(v, 3)  # [m/s]: (1.5 * 10 N + 5 / s * 20 N s) / (100 N s/m), the moment's integral, dt Lambda^-1
        1.895

    References:
        Section 10.3 force control. Khatib (1987), IEEE Journal of Robotics and Automation 3 (1), on J_bar.
    """

    reference = TaskForce
    needs_contact: ClassVar[bool] = True
    feedback: Choice[Feedback] = Choice("wrench", "joint_torque", "none")
    kfp: Gain = task_gain(0.0, unit="1", shape=6, accepts=ANY)
    kfi: Gain = task_gain(0.0, unit="1/s", shape=6, accepts=ANY)
    kdamp: Gain = task_gain(unit="N s/m, N m s/rad", shape=6, optional=True)
    e_int_max: Gain = Gain(E_INT_MAX, unit="N s, N m s", shape=2, accepts=("pair",), above=0.0)
    frame: Choice[Axes] = Choice(*FRAMES)
    null: Law | None = Posture()
    integral: Part[Integral] = Part(Integral, default=Integral())
    tool: str | None = None
    recorded = ("integral.e_int",)

    def check(self) -> None:
        check_null(self)
        for name in () if self.measures else ("kfp", "kfi", "e_int_max"):
            if name in self.specified:
                self.refuse(name, "is for a force that is fed back, and feedback is 'none'; leave it out")

    @property
    def measures(self) -> bool:
        """Whether there is feedback."""
        return self.feedback != "none"

    def check_rate(self, rate: float) -> None:
        """The slow mode of the closed loop, -kfi / (1 + kfp), must be slower than the rate on any contact."""
        if self.measures:
            check_force_pole(self.kfp.matrix(6), self.kfi.matrix(6), rate)

    def force_loop_gain(self, dt: float, touch: RigidTouch | None) -> float:
        """Largest eigenvalue of (kfp + kfi dt / 2) P on a rigid contact; unstable from 1 on (force a tick old)."""
        if touch is None or not self.measures:
            return 0.0
        x, pressing = touch.x, touch.pressing(self.tool)
        gain = _numbers(self.kfp) + 0.5 * dt * _numbers(self.kfi)
        if self.frame == "tool":
            gain = np.asarray(rotated_matrix(x.T(self.tool).R, gain), dtype=np.float64)
        return float(np.max(np.abs(np.linalg.eigvals(gain @ pressing))))

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        """The wrist sensor must be on the link that is controlled."""
        if self.feedback == "wrench":
            check_sensor(x, self.tool)

    def speed_bound(self, *, F_app: ArrayLike, x: Snapshot, rate: float) -> tuple[float, float]:
        """Bounds of the tool's speed and angular speed in the sampled loop when contact is lost [m/s, rad/s].

        V . D V <= w . D^-1 w part by part, with w = (I + kfp) F_des + kfi e_int_max: at every instant about the pose
        x, from rest; through other poses in the mean square. Infinite where kdamp damps fewer than six directions,
        and for kfp of joint torques, for which no bound is known.

        Args:
            F_app: (6,) the desired wrench in the axes of the gains [N, N m].
            x: The arm at the pose, such as taut.snapshot(arm, q).
            rate: Of the control loop [Hz].
        """
        F = vector("F_app", F_app, 6, unit="N, N m")
        rate = positive_scalar("rate", rate, unit="Hz")
        kfp, kdamp = _numbers(self.kfp) if self.measures else np.zeros((6, 6)), np.zeros((6, 6))
        if self.kdamp is not None:
            kdamp = _numbers(self.kdamp)
        if np.linalg.matrix_rank(kdamp) < 6 or (self.feedback == "joint_torque" and kfp.any()):
            return np.inf, np.inf
        T, J = x.T(self.tool), x.J(self.tool)
        mobility = J @ x.M_factors.solve(J.T)
        if self.frame == "tool":
            mobility = rotated_matrix(T.R.T, mobility)
        inverse = np.linalg.inv(kdamp) + np.asarray(mobility, dtype=np.float64) / rate
        root = np.linalg.cholesky(inverse).T  # |root w|^2 = w . D^-1 w
        size = float(np.linalg.norm(root @ (F + kfp @ F)))
        if self.measures:
            most = np.asarray(self.e_int_max.as_array(), dtype=np.float64)
            added = root @ _numbers(self.kfi)
            size += sum(m * float(np.linalg.norm(added[:, k : k + 3], 2)) for m, k in zip(most, (0, 3), strict=True))
        linear, angular = (float(np.linalg.norm(inverse[k : k + 3, k : k + 3], 2)) ** 0.5 for k in (0, 3))
        return float(linear * size), float(angular * size)

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """Lambda F_e-ddot + kdamp F_e-dot + (I + kfp) k F_e + kfi k int(F_e) = 0 on a contact of stiffness k."""
        fed = np.eye(6) + self.kfp.matrix(6)

        def gains(g: PlacedGains) -> Law:
            return replace(self, kdamp=g.D, kfi=self.kfi if g.force is None else g.force * fed)

        return tool_loop(self, x, gains, contact=fed)

    def command(
        self, x: Snapshot, ref: TaskForce, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        T, J = x.T(self.tool), x.J(self.tool)
        R = T.R if self.frame == "tool" else None
        inertia = bounded_inertia(x, J)
        F_des = ref.in_world(T.R)
        w = Terms(feedforward=inwards(R, F_des))
        e_int = memory.integral.e_int
        if self.measures:
            F_e = inwards(R, _movable(x, self.tool, F_des - self._applied(x, inertia)))
            e_int = self._integral(x, memory, F_e, R, inertia, dt)
            w = w + Terms(P=self.kfp @ F_e, I=self.kfi @ e_int)
        if self.kdamp is not None:
            mobility = inertia.mobility if R is None else rotated_matrix(R.T, inertia.mobility)
            w = w + Terms(D=-damping_force(self.kdamp.matrix(6), mobility, inwards(R, J @ x.v), dt))
        tau = J.T @ w.mapped(functools.partial(outwards, R)) + Terms(gravity=x.g)
        tau, null = with_null_space(self, tau, x, ref, memory, dt, inertia, 6)
        return Torque(tau), {"integral": {"e_int": e_int}, **null}

    def _integral(
        self, x: Snapshot, memory: MemoryView, F_e: Wrench, R: Rotation | None, inertia: TaskInertia, dt: Any
    ) -> Vector:
        """The integral after this tick, each part no longer than e_int_max."""
        grown, _ = self.integral.step(
            memory.integral, F_e, dt, ki=self.kfi, cut=lambda: inwards(R, inertia.wrench(x.tau_cut))
        )
        out = []
        for part, most in ((grown[:3], self.e_int_max[0]), (grown[3:], self.e_int_max[1])):
            out.extend(tm.minimum(most / tm.maximum(tm.norm(part), 1e-12), 1.0) * part)
        return tm.array(out)

    def missing(self, x: Snapshot, ref: TaskForce, contact: Any) -> Vector:
        """(2,) 1 where more force, or moment, than `contact` is asked for and less is measured along it, else 0."""
        F_des, F_app = ref.in_world(x.T(self.tool).R), self._applied(x, bounded_inertia(x, x.J(self.tool)))
        parts = [(F_des[k : k + 3], F_app[k : k + 3]) for k in (0, 3)]
        return tm.array([misses(tm.norm(F), F @ got, least) for (F, got), least in zip(parts, contact, strict=True)])

    def _applied(self, x: Snapshot, inertia: TaskInertia) -> Wrench:
        """(6,) F_app as it is measured."""
        return -wrench_at(x, self.tool) if self.feedback == "wrench" else wrench_of_torques(x, inertia)


def wrench_of_torques(x: Snapshot, inertia: TaskInertia) -> Wrench:
    """F_app (6,) at the tool, world axes, J_bar^T (tau_meas - C v - g): plant's gravity included, friction not."""
    return inertia.wrench(x.tau_meas - x.inverse_dynamics(np.zeros(x.n)))


def _movable(x: Snapshot, tool: str | None, F: Wrench) -> Wrench:
    """A wrench without the directions in which the arm never moves, as a planar one: its bearings carry them."""
    anywhere = dyn.jacobian(x.model, np.cos(1.7 * np.arange(x.n) + 0.3), tool)  # what is zero here is so in any pose
    return tm.array([F[i] if np.any(np.abs(row) > STILL) else 0.0 for i, row in enumerate(anywhere)])


def _numbers(gain: GainValue) -> Matrix:
    return np.asarray(gain.matrix(6), dtype=np.float64)


def damping_force(kdamp: Matrix, mobility: Matrix, rate: Vector, dt: Any) -> Vector:
    """(k,) D rate, D = (kdamp^-1 + dt mobility)^-1: kdamp times the rate that this force alone leaves after the tick.

    mobility = J M^-1 J^T. kdamp itself diverges on light links where kdamp mobility dt > 2; D mobility dt is in [0,
    1).
    """
    out: Vector = tm.solve(tm.eye(len(mobility)) + dt * (kdamp @ mobility), kdamp @ rate)
    return out


def check_force_pole(kfp: Matrix, kfi: Matrix, rate: float) -> None:
    """The slow mode of a fed-back force, -kfi / (1 + kfp), must be slower than the rate [Hz] on any contact."""
    gains = [np.asarray(gain, dtype=np.float64) for gain in (kfp, kfi)]
    fastest = np.linalg.solve(np.eye(len(gains[0])) + gains[0], gains[1])
    require_at_most(
        "kfi / (1 + kfp)",
        np.abs(np.linalg.eigvals(fastest)),
        2.0 * rate,
        "1/s",
        "twice the rate, or the force oscillates on any contact; a pole of 1 to 20 1/s is usual",
    )


def misses(asked: Any, along: Any, least: Any) -> Any:
    """1 where more than `least` [N, N m] is asked for and less is measured along it (dot product), else 0."""
    return tm.where(asked > least, tm.where(along < least * asked, 1.0, 0.0), 0.0)


def of_wrench(rows: ConstraintRows, F_app: Vector) -> Vector:
    """(k,) the multipliers of a wrench of the arm on the environment: (A A^T)^-1 A F_app."""
    assert rows.A is not None
    out: Vector = rows.factors.solve(rows.A @ F_app)
    return out


def asked_multipliers(constraint: Constraint, rows: ConstraintRows, ref: HybridMotion) -> Vector:
    """(k,) the multipliers that are asked for by lam, by press into the surface of the first row, and by F_app."""
    lam: Vector = ref.lam[: rows.count]
    if rows.A is not None:
        lam = lam + of_wrench(rows, ref.F_app)
        if constraint.surface:
            gradient = rows.A[0, :3]
            press = -ref.press[0] / tm.sqrt(gradient @ gradient + 1e-24)
            lam = lam + tm.array([press, *([0.0] * (rows.count - 1))])
    return lam
