"""Laws of task-space motion: section 10.2.3 of the chapter; for torques, and for drives of velocity or position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np

from taut.base.fields import Choice, Part
from taut.base.types import Vector
from taut.control.closed_loop import ClosedLoop
from taut.control.command import Command, Position, Terms, Torque, Velocity
from taut.control.gains import Gain, GainValue, Integral, Memory, MemoryView, require_at_most
from taut.control.law import Law
from taut.control.laws.null_space import Posture, check_free, check_null, with_null_space
from taut.control.laws.task_error import TaskError, spatial, task_error
from taut.control.laws.task_space import TaskLaw, eased, task_gain, tool_loop
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.singularity import ResolvedMotion, resolve
from taut.maths.snapshot import Snapshot
from taut.maths.task_inertia import TaskInertia
from taut.trace import math as tm

Singularity = Literal["robust", "plain"]
ANY: Final = ("scalar", "pair", "matrix")


class TaskComputedTorque(TaskLaw):
    """Task-space feedback linearisation (computed torque of the end-effector).

    Law:          tau = J^T Lambda (a_des + kp X_e + ki int(X_e) + kd V_e - J-dot v) + h(q, v)          eq. 10.31
                  Lambda = (J M^-1 J^T)^-1, J^T (Lambda (.) + eta) with eta = J^-T h - Lambda J-dot v
    Closed loop:  V_e-dot + kd V_e + kp X_e + ki int(X_e) = 0, with an exact model and no friction, where V_e is
                  error="decoupled": p_des - p and the rotation vector of R_des R^T, world axes: the tool's origin
                    goes straight and its rotation turns about one axis; V_e = X_e-dot for the origin exactly, for the
                    rotation to first order at a target that does not turn
                  error="body": log(T^-1 T_des), the desired acceleration transported into the tool's frame,
                    Ad a_des + ad_{V_e} (Ad V_des): X_e-dot = V_e to first order about any target, turning or not
                  error="space": log(T_des T^-1): X_e-dot = V_e to first order at a resting target only
                  error="coordinates": y(T_des) - y(T), whose rate is V_e exactly: linear everywhere but where y
                    itself is singular
                  so omega_n = sqrt(kp), zeta = kd / (2 sqrt(kp)) for ki = 0
                  a sampled loop tends to this as dt falls

    The spring kp X_e may be bounded: error_max=(linear, angular) puts X_e / sqrt(1 + r^2) in the place of X_e,
    part by part, with r the length of the part over its error_max; what the bound takes is the term `bound`.

    Near singularities, with singularity="robust", the direction that is nearly lost is given up, joints are kept
    within their limits, and the remaining motion is damped at the rate kd: the term `singularity`. So it is towards a
    target that is certainly out of reach; without error_max one that is out by a tenth of the reach and more pulls no
    harder than 0.05 of the reach, 0.3 rad would. With "plain" Lambda is (J M^-1 J^T + damping I)^-1.

    Frames:
        World axes at the tool for "decoupled", the tool's own for "body", the world's origin for "space".

    Args:
        error: "decoupled", "body", "space" or "coordinates".
        coordinates: With error="coordinates": what is controlled.
        error_max: (2,) largest error that the spring answers [m, rad]; no bound if left out.
        null: Law of the free motion, by default `Posture()`, through the consistent projector I - J^T Lambda J M^-1.
        tool: The frame that is controlled; the arm's tool if left out.
        integral: What keeps the integral from winding up.
        singularity: "robust" or "plain".
        damping: With "plain", a constant damping [1/kg, 1/(kg m^2)].

    References:
        Section 10.2.3 task space motion control. Khatib (1987), IEEE Journal of Robotics and Automation 3 (1).
    """

    kp: Gain = task_gain(unit="1/s^2", accepts=ANY)
    kd: Gain = task_gain(unit="1/s", accepts=ANY)
    ki: Gain = task_gain(0.0, unit="1/s^3", accepts=ANY)
    integral: Part[Integral] = Part(Integral, default=Integral())
    null: Law | None = Posture()
    singularity: Choice[Singularity] = Choice("robust", "plain")
    damping: Gain = Gain(unit="1/kg, 1/(kg m^2)", shape="scalar", optional=True)
    limited = Memory(doc="how far the limits near a singularity still act")

    def check(self) -> None:
        super().check()
        check_null(self)
        if self.damping is not None and self.singularity != "plain":
            self.refuse("damping", "is for singularity 'plain'; leave one of the two out")

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_free(self, x, self.dimensions)

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """V_e-dot + kd V_e + kp X_e + ki int(X_e) = 0."""
        return tool_loop(self, x, lambda g: replace(self, kp=g.K, kd=g.D, ki=g.Ki), inertia=np.eye(self.dimensions))

    def command(self, x: Snapshot, ref: TaskMotion, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        error = self.space.at(x, ref)
        e_int, integral = self.integral.step(
            memory.integral, error.X, dt, ki=self.ki, cut=lambda: error.J @ tm.solve_spd(x.M_factors, x.tau_cut)
        )
        a = Terms(feedforward=error.acceleration, P=self.kp @ error.X, I=self.ki @ e_int, D=self.kd @ error.V)
        a = a + Terms(nonlinear=-error.Jdot_v)
        if self.space.bound is not None:
            a = a + Terms(bound=self.kp @ (self.space.bound.error(error.X) - error.X))
        if self.singularity == "plain":
            damping = 0.0 if self.damping is None else self.damping.as_array()[()]
            plain = TaskInertia.of(error.J, x.M_factors, damping)
            tau, limited = error.J.T @ (plain.Lambda @ a), memory.limited
            motion: TaskInertia | ResolvedMotion = plain
        else:
            a, resolved = self._resolved(x, ref, error, a, memory.limited)
            tau = resolved.scale * (x.M @ a.mapped(resolved.of).up_to(resolved.accelerations, "singularity"))
            motion, limited = resolved, resolved.held
        tau = tau + Terms(nonlinear=x.h)
        tau, null = with_null_space(self, tau, x, ref, memory, dt, motion, self.dimensions)
        return Torque(tau), {"integral": integral, "limited": limited, **null}

    def _resolved(
        self, x: Snapshot, ref: TaskMotion, error: TaskError, a: Terms, limited: Any
    ) -> tuple[Terms, ResolvedMotion]:
        """The acceleration of the task, and that of the joints, bounded near singularities and out of reach."""
        J, total, away = error.J, a.total, self.space.beyond_reach(x, ref)
        if away is not None and x.n >= self.dimensions and self.error_max is None:
            total = total - (1.0 - eased(away, away.far, error.X)) * (self.kp @ error.X)
        if self.error == "space":  # what is nearly lost, and how dear it is, is seen at the tool
            p, J = x.T(self.tool).p, x.J(self.tool)
            a, total = a.mapped(lambda b: spatial(-p, b)), spatial(-p, total)
        clear = 0.0 if away is None else away.clear
        return a, resolve(x, J, total, rate=settling(self.kd), held=limited, beyond=clear)


def settling(kd: GainValue) -> Any:
    """The rate at which joints come to rest where the task does not move them: the largest of kd, at least 1/s."""
    entries = kd.as_array()
    most: Any = 1.0
    for entry in np.diagonal(entries) if entries.ndim == 2 else entries.ravel():
        most = tm.maximum(most, entry)
    return most


class TaskVelocity(Law):
    """Task-space motion by joint velocities: feedforward plus P, for arms whose drives close the velocity loop.

    Law:          v_cmd = J^+ (V_des + lead a_des + kp X_e),  J^+ = J^T (J J^T + damping^2)^-1
    Closed loop:  X_e-dot + kp X_e = 0, where the drives follow v_cmd exactly and the tool can move
                  lead = 1 / bandwidth + t compensates the lag of a drive and a delay t to first order
                  stable for kp (1 / bandwidth + t) below about 1

    Damping keeps joint speeds finite at singularities: at most 1 / (2 damping) for each m/s or rad/s of the tool, and
    zero in a direction that is lost. X_e is the decoupled error, in world axes.

    Args:
        lead: What the drives lag by [s].
        tool: The frame that is controlled; the arm's tool if left out.

    References:
        Lynch and Park, Modern Robotics (2017), section 11.3; Wampler (1986), IEEE Trans. SMC 16 (1), on the damping.
    """

    reference = TaskMotion
    kp: Gain = task_gain(unit="1/s", shape=6, accepts=ANY)
    lead: Gain = Gain(0.0, unit="s", shape="scalar")
    damping: Gain = Gain(0.01, unit="m, 1", shape="scalar", above=0.0)
    tool: str | None = None

    def check_rate(self, rate: float) -> None:
        check_feedback(self.kp, rate)

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """X_e-dot + kp X_e = 0."""
        return tool_loop(self, x, lambda g: replace(self, kp=g.D), inertia=np.eye(6), single_pole="always")

    def command(self, x: Snapshot, ref: TaskMotion) -> Command:
        error = task_error(x, ref, self.tool)
        V = Terms(feedforward=ref.twist, lead=self.lead.as_array() * ref.acceleration, P=self.kp @ error.X)
        return Velocity(_joint_speeds(error.J, self.damping, V))


class TaskPosition(Law):
    """Task-space motion by joint positions: one damped Newton step of inverse kinematics a tick, for position drives.

    Law:          v_cmd = J^+(q_cmd) (V_des + kp X_e(q_cmd)),  J^+ = J^T (J J^T + damping^2)^-1
                  q_cmd integrates v_cmd; the command is q_cmd + lead v_cmd + lead^2 J^+ a_des / 2
    Closed loop:  X_e-dot + kp X_e = 0 for the commanded pose, whatever the arm does: there is no feedback
                  lead = 2 / bandwidth + t compensates the lag of a critically damped drive and a delay t

    q_cmd starts where the arm is. X_e is the decoupled error, in world axes.

    Args:
        lead: What the drives lag by [s].
        tool: The frame that is controlled; the arm's tool if left out.

    References:
        Section 10.2.3, equations 10.28 and 10.29; Wampler (1986), IEEE Trans. SMC 16 (1), on the damping.
    """

    reference = TaskMotion
    kp: Gain = task_gain(unit="1/s", shape=6, accepts=ANY)
    lead: Gain = Gain(0.0, unit="s", shape="scalar")
    damping: Gain = Gain(0.01, unit="m, 1", shape="scalar", above=0.0)
    tool: str | None = None
    q = Memory(unit="rad | m", doc="the positions that are commanded")

    def check_rate(self, rate: float) -> None:
        check_feedback(self.kp, rate)

    def start(self, x: Snapshot, ref: TaskMotion) -> Mapping[str, Vector]:  # noqa: ARG002
        return {"q": x.q}

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """X_e-dot + kp X_e = 0."""
        return tool_loop(self, x, lambda g: replace(self, kp=g.D), inertia=np.eye(6), single_pole="always")

    def command(self, x: Snapshot, ref: TaskMotion, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        error = task_error(x.at(memory.q, np.zeros(x.n)), ref, self.tool)
        V, lead = ref.twist + self.kp @ error.X, self.lead.as_array()
        speeds = _joint_speeds(error.J, self.damping, Terms(V=V, a=0.5 * lead * ref.acceleration))
        q = memory.q + dt * speeds.parts["V"]
        return Position(solution=q, lead=lead * speeds.total), {"q": q}


def _joint_speeds(J: Any, damping: GainValue, V: Terms) -> Terms:
    """J^+ V, by damped least squares."""
    factors = tm.factor_spd(J @ J.T + damping.as_array() ** 2 * tm.eye(6))
    return V.mapped(lambda part: J.T @ factors.solve(part))


def check_feedback(kp: GainValue, rate: float) -> None:
    """Feedback must not correct an error faster than the rate [Hz]."""
    values = np.asarray(kp.as_array(), dtype=np.float64)
    largest = np.linalg.eigvalsh(values) if values.ndim == 2 else values
    require_at_most("kp", largest, rate, "1/s", "the rate, with which the error is gone in one tick")
