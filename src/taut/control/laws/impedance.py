"""Impedance control: section 10.5 of the chapter, equations 10.46 to 10.49."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from taut.base.errors import RangeError
from taut.base.fields import Choice
from taut.base.types import Float64Array, Vector
from taut.control.closed_loop import ApparentImpedance, ClosedLoop
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, GainValue, MemoryView
from taut.control.law import Law
from taut.control.laws.null_space import Posture, check_free, check_null, with_null_space
from taut.control.laws.task_error import FRAMES, GainFrame, TaskError
from taut.control.laws.task_space import (
    LOST,
    RATE,
    TaskLaw,
    bounded_inertia,
    check_damping,
    check_directions,
    check_sensor,
    eased,
    modal_damping,
    task_gain,
    tool_loop,
    within_speed,
)
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot
from taut.maths.task_inertia import TaskInertia
from taut.trace import math as tm
from taut.trace.linalg import factor_spd

Feedback = Literal["wrench", "acceleration"]
Coriolis = Literal["cancel", "keep"]


class Impedance(TaskLaw):
    """Impedance control: the tool answers a wrench like a mass, a damper and a spring.

    Law:          without D   tau = J^T (Lambda (a_des - J-dot v) + B V_e + K X_e) + h
                  feedback="wrench", D with a wrist sensor:  a = D^-1 (F_ext + B V_e + K X_e)
                    tau = J^T (Lambda (a_des + a - J-dot v) - F_ext) + h
                  feedback="acceleration", the chapter's form, with V-dot of the tick before:
                    tau = J^T (Lambda (V-dot - J-dot v) + D (a_des - V-dot) + B V_e + K X_e) + h          eq. 10.49
    Closed loop:  D V_e-dot + B V_e + K X_e = -F_ext, with an exact model and no friction; without D the arm's own
                    Lambda(q) stands in its place                                              eq. 10.46, 10.48
                  with X_des at rest the deviation x = -X_e obeys D x_ddot + B x_dot + K x = F_ext
                  a tracking error is what F_ext makes, K^-1 F_ext at rest, and what the model does not know
                  feedback="acceleration" is an algebraic loop, closed a tick late: stable where the eigenvalues of
                    Lambda^-1 (D + B dt / 2) are above 0 and below 2, and refused elsewhere: where a run starts, and
                    where the arm is when gains change
                  a sampled loop is passive at constant gains and X_des with B and friction of K dt / 2 and more
                  coriolis="keep" leaves C v where it is: then without D the energy of arm and spring falls at the
                    rate V . B V, which that of the cancelled form does about rest only

    The wrench of the spring is the gradient of X_e . K X_e / 2, so that a stiffness that differs by direction gains
    nothing along a closed path; it is K X_e itself where X_e is along an axis of K. With zeta= the damping is
    designed at each pose from K and the apparent inertia, D or Lambda(q): zeta is the damping ratio of each mode.

    Without error_max, to a target that is certainly out of reach, the torque is that of the spring alone, eased to
    0.05 of the reach, 0.3 rad, on joints that settle at 5/s within their speed limits: the term `reach`, else zero.

    Frames:
        frame= names the axes of K, B and D: "world", "task" (of the reference pose) or "tool".

    Args:
        K: Stiffness: (linear, angular), (6,) or (6, 6). A new K acts at once, energy included (see `EnergyTank`).
        B: Damping, likewise; or zeta.
        zeta: Damping ratio of every mode, in place of B.
        D: Apparent inertia, likewise; that of the arm if left out.
        feedback: With D, what makes the difference: "wrench", a wrist sensor, or "acceleration".
        error: "decoupled", "body", "space" or "coordinates": see `taut.laws.TaskComputedTorque`.
        coordinates: With error="coordinates": what is controlled.
        error_max: (2,) largest error of the spring [m, rad], which stays conservative; the term `bound`.
        coriolis: "cancel" or "keep".
        null: A law for the motion that the task leaves free; None to leave it free.
        tool: The frame that is controlled; the arm's tool if left out.

    References:
        Section 10.5 impedance control. Hogan (1985), ASME J. Dynamic Systems 107.
    """

    K: Gain = task_gain(unit="N/m, N m/rad")
    B: Gain = task_gain(unit="N s/m, N m s/rad", optional=True)
    zeta: Gain = Gain(unit="1", shape="scalar", optional=True)
    D: Gain = task_gain(unit="kg, kg m^2", optional=True)
    feedback: Choice[Feedback] = Choice("wrench", "acceleration")
    frame: Choice[GainFrame] = Choice(*FRAMES)
    coriolis: Choice[Coriolis] = Choice("cancel", "keep")
    null: Law | None = Posture()

    def check(self) -> None:
        super().check()
        check_null(self)
        check_damping(self, self.K, self.B, self.zeta, self.D)
        if self.D is None and self.feedback != "wrench":
            self.refuse("feedback", f"'{self.feedback}' is for an apparent inertia D; give D, or leave feedback out")

    def check_state(self, x: Snapshot, rate: float) -> None:
        """The loop of feedback="acceleration" is stable; a wrist sensor is on the link that is controlled."""
        c = self.space.at(x)
        check_directions(x, self.tool, c.J)
        check_free(self, x, self.dimensions)
        if self.D is not None:
            (check_sensor(x, self.tool) if self.feedback == "wrench" else self._check_loop(x, c, self.D, rate))

    def _check_loop(self, x: Snapshot, c: TaskError, inertia: GainValue, rate: float) -> None:
        """0 < eig(Lambda^-1 (D + B dt / 2)) < 2, which feedback="acceleration" needs."""
        D = inertia.matrix(self.dimensions)
        inverse = c.J @ x.M_factors.solve(c.J.T)
        B = self.damping_matrix(c, bounded_inertia(x, c.J))
        sizes, axes = np.linalg.eigh(0.5 * (inverse + inverse.T))
        U = axes[:, sizes > LOST * sizes[-1]]  # the directions that the arm can move in at all
        ratios = np.linalg.eigvals(U.T @ inverse @ U @ (U.T @ c.matrix_outwards(D + B * (0.5 / rate)) @ U))
        low, high = float(np.min(ratios.real)), float(np.max(ratios.real))
        if not 0.0 < low <= high < 2.0:
            raise RangeError(
                "feedback='acceleration' uses the acceleration of the tick before, which is stable where the "
                "eigenvalues of Lambda^-1 (D + B dt / 2) are above 0 and below 2; at this pose they are "
                f"{low:.3g} to {high:.3g}; make D and B smaller, or positive in every direction, or take "
                "feedback='wrench' with a wrist sensor",
                name="D",
                value=high,
                rule="0 < eig(Lambda^-1 (D + B dt / 2)) < 2",
            )

    def start(self, x: Snapshot, ref: TaskMotion) -> Mapping[str, Any]:
        if self.D is None or self.feedback == "wrench":
            return {}
        return {"V_last": self.space.at(x, ref).J @ x.v}

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """D V_e-dot + B V_e + K X_e = 0, with the arm's own inertia where D is not given."""
        D = None if self.D is None else self.D.matrix(self.dimensions)
        return tool_loop(self, x, lambda g: replace(self, K=g.K, B=None, zeta=g.zeta), inertia=D, stiffness=True)

    def apparent_impedance(self, x: Snapshot) -> ApparentImpedance | None:
        """D, B and K at this state; with the decoupled error."""
        if self.error != "decoupled":
            return None
        c = self.space.at(x)
        inertia = bounded_inertia(x, c.J)
        D = c.matrix_inwards(inertia.Lambda) if self.D is None else self.D.matrix(6)
        return c.impedance(D, self.damping_matrix(c, inertia), self.K.matrix(6))

    def command(self, x: Snapshot, ref: TaskMotion, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        c, after = self.space.at(x, ref), dict[str, Any]()
        inertia = bounded_inertia(x, c.J)
        wrench = self.space.spring(self.K, c).mapped(c.wrench) + Terms(D=self.damping(c, inertia))
        desired, motion = c.acceleration, Terms(feedforward=c.acceleration)
        if self.coriolis == "cancel":
            motion = motion + Terms(nonlinear=-c.Jdot_v)
        if self.D is None:
            F = wrench.mapped(c.outwards) + inertia.Lambda @ motion
        elif self.feedback == "wrench":
            F_ext, D = self.space.measured_wrench(x, inertia), factor_spd(self.D.matrix(self.dimensions))
            a = (wrench + Terms(sensor=c.inwards(F_ext))).mapped(D.solve).mapped(c.outwards)
            F = inertia.Lambda @ (a + motion) - Terms(sensor=F_ext)
        else:  # eq. 10.49, with V-dot of the tick before
            after["V_last"] = V = c.J @ x.v
            V_dot = (V - memory.V_last) / dt
            F = wrench.mapped(c.outwards) + Terms(inertia=c.outwards(self.D @ c.inwards(desired - V_dot)))
            F = F + inertia.Lambda @ (motion + Terms(inertia=V_dot) - Terms(feedforward=desired))
        tau, weight = self._within_reach(x, ref, c, inertia, F)
        tau = tau + Terms(nonlinear=x.h if self.coriolis == "cancel" else x.g)
        tau, null = with_null_space(self, tau, x, ref, memory, dt, inertia, self.dimensions, weight)
        return Torque(tau), {**after, **null}

    def damping(self, c: TaskError, inertia: TaskInertia) -> Vector:
        """(k,) B V_e in the axes of the gains, with B as it is given, or designed from zeta."""
        return self._times_B(c, inertia, c.V)

    def damping_matrix(self, c: TaskError, inertia: TaskInertia) -> Float64Array:
        """(k, k) B in the axes of the gains."""
        columns = [self._times_B(c, inertia, axis) for axis in np.eye(self.dimensions)]
        return np.asarray(np.column_stack(columns), dtype=np.float64)

    def energy(self, x: Snapshot, ref: TaskMotion) -> Any:
        """Energy of the spring and of the apparent inertia [J], which changes with K and D."""
        c = self.space.at(x, ref)
        own = self.space.energy(self.K, c)
        return own if self.D is None else own + 0.5 * (c.V @ (self.D @ c.V))

    def dissipation(self, x: Snapshot, ref: TaskMotion) -> Any:
        """Power that damping takes from the arm [W], at most what it turns into heat; a moving X_des adds nothing."""
        c = self.space.at(x, ref)
        wrench = self.damping(c, bounded_inertia(x, c.J))
        return tm.minimum(c.V @ wrench, -(c.inwards(c.J @ x.v) @ wrench))

    def _times_B(self, c: TaskError, inertia: TaskInertia, V: Vector) -> Vector:
        if self.B is not None:
            out: Vector = self.B @ V
            return out
        D = c.matrix_inwards(inertia.Lambda) if self.D is None else self.D.matrix(self.dimensions)
        return modal_damping(factor_spd(D), self.K.matrix(self.dimensions), self.zeta.as_array(), V)

    def _within_reach(
        self, x: Snapshot, ref: TaskMotion, c: TaskError, inertia: TaskInertia, F: Terms
    ) -> tuple[Terms, Any]:
        """The torque of F, eased and damped towards a target out of reach without error_max; the weight of `null`."""
        away = self.space.beyond_reach(x, ref)
        if away is None or self.error_max is not None:
            return c.J.T @ F, 1.0
        pull = eased(away, away.clear, c.X) * c.outwards(c.wrench(self.K @ c.X))
        bounded = F.total + away.clear * (within_speed(x, inertia, pull) - F.total)
        tau = c.J.T @ F.up_to(bounded, "reach") + Terms(reach=-(away.clear * RATE) * (x.M @ x.v))
        return tau, 1.0 - away.clear


class Stiffness(TaskLaw):
    """Stiffness control: a spring alone, with the arm's weight compensated.

    Law:          tau = J^T K X_e + g(q) - kd v                                  eq. 10.49 with K only
    Closed loop:  M a + C v + kd v = J^T (K X_e + F_ext): F_ext = -K X_e at rest
                  the energy of arm and spring falls at the rate v . kd v, and stays with kd = 0

    To a target that is certainly out of reach the spring is eased, without error_max, to 0.05 of the reach, 0.3 rad:
    the term `reach`, else zero.

    Frames:
        frame= names the axes of K: "world", "task" (of the reference pose) or "tool".

    Args:
        K: Stiffness: (linear, angular), (6,) or (6, 6).
        kd: Joint damping.
        error: "decoupled", "body", "space" or "coordinates": see `taut.laws.TaskComputedTorque`.
        coordinates: With error="coordinates": what is controlled.
        error_max: (2,) largest error that the spring answers [m, rad]; what it takes is the term `bound`.
        tool: The frame that is controlled; the arm's tool if left out.

    References:
        Section 10.5 impedance control. Salisbury (1980), IEEE CDC, active stiffness control.
    """

    K: Gain = task_gain(unit="N/m, N m/rad")
    kd: Gain = Gain(0.0, unit="N m s/rad | N s/m")
    frame: Choice[GainFrame] = Choice(*FRAMES)

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """M q_ddot + kd q_dot + J^T K X_e = 0."""
        return tool_loop(self, x, lambda g: replace(self, K=g.K, kd=g.D), stiffness=True, damps_joints=True)

    def command(self, x: Snapshot, ref: TaskMotion) -> Command:
        c, away = self.space.at(x, ref), self.space.beyond_reach(x, ref)
        wrench = self.space.spring(self.K, c).mapped(c.wrench).mapped(c.outwards)
        if away is not None and self.error_max is None:
            wrench = wrench.up_to(eased(away, away.clear, c.X) * wrench.total, "reach")
        return Torque(c.J.T @ wrench + Terms(gravity=x.g, D=-(self.kd @ x.v)))
