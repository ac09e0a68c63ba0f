"""Hybrid motion-force control: section 10.4 of the chapter, equations 10.39 to 10.45."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any, ClassVar, Final, Literal

import numpy as np

from taut.base.errors import UsageError
from taut.base.fields import Choice, Field, Part, Plain
from taut.base.types import Float64Array, Vector
from taut.control.closed_loop import ClosedLoop, PlacedGains
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, Memory, MemoryView
from taut.control.law import Law, call
from taut.control.laws.constraints import (
    along_constraint,
    check_constraint,
    check_place,
    check_reference,
    of_one_body,
    without_reaction,
)
from taut.control.laws.force import (
    E_INT_MAX,
    asked_multipliers,
    check_force_pole,
    damping_force,
    misses,
    of_wrench,
)
from taut.control.laws.task_space import check_sensor, wrench_at
from taut.control.trajectories.force_reference import MAX_MULTIPLIERS, HybridMotion, hybrid_kind
from taut.control.trajectories.reference import Reference, Sample
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.multipliers import Constrained
from taut.maths.constraints.rows import ConstraintRows
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

ForceFeedback = Literal["wrench", "joint_torque"]
TOUCHING: Final = 1.0  # [N] on a tool that counts as in contact


def natural(constraint: Any) -> Any:
    """Natural constraints, also of a function of the pose."""
    return Constraint(constraint) if callable(constraint) and not isinstance(constraint, Constraint) else constraint


class HybridMotionForce(Law):
    """Hybrid motion-force control: a motion along constraints, and forces against them.

    Law:          tau = J^T (P F_motion + (I - P) F_force + gamma + eta - F_curved)                     eq. 10.45
                  F_motion = Lambda (a_des + kp X_e + ki int(X_e) + kd V_e), or what else `motion` is     eq. 10.31
                  F_force  = A^T (lam_des + kfp lam_e + kfi int(lam_e) - D (A V + phi_t))                 eq. 10.38
                  D = (kdamp^-1 + dt A Lambda^-1 A^T)^-1, the damping kdamp when the tick ends, as of `ForceControl`
                  F_curved = A^T S (A-dot V + ...), the term `curvature`, which the chapter leaves out
                  P = I - A^T S A Lambda^-1, S = (A Lambda^-1 A^T)^-1                                     eq. 10.44
                  with A X_e = 0, A V_e = 0, A a_des = -(A-dot V + ...): what violates the constraint of the tool is
                    removed from the tool's reference, at the tool's pose, before `motion` sees it
    Closed loop:  along the constraints that of `motion`: V-dot is the acceleration that it commands, for any Lambda,
                    and wherever the surface really is. A reference that satisfies the constraint is unchanged; on a
                    flat constraint this is eq. 10.45 exactly, on a curved one it differs by the part of the reference
                    normal to the tangent at the tool, in proportion to the error along it;
                    an inertia D of `motion` responds to F_ext along the constraint, not to the contact force;
                    for a law in joint space, or a constraint of another link than the tool's, P Lambda of the
                    command: a command against the constraint also causes motion along it;
                    for a tool in a closed chain, in the directions that the chain leaves free: the term `chain`
                  against them lam = F_force's, in a rigid contact: (1 + kfp) lam_e + kfi int(lam_e) = const, with the
                    pole -kfi / (1 + kfp), not the -kfi / kfp of eq. 10.36; the measured force is a tick old, so that
                    kfp + kfi dt / 2 < 1, or the loop is unstable; a RigidPlant refuses it, elsewhere a run reports
                  with curvature=False lam is off by S A-dot V: m v^2 / r on a surface of radius r

    lam_meas is (A A^T)^-1 A F_app of the wrist sensor: friction along a surface at the tool's origin is not part
    of it. With feedback="joint_torque" it is eq. 10.42 with the measured torques, and what the model does not
    know, such as a payload, counts as a force. Without kfp and kfi no force is measured, and lam_des is fed forward,
    eq. 10.34. A one-sided row is never commanded to pull. The integral stops (anti-windup) where torque limits cut
    the force, or a contact would have to pull, and the error would increase it; it is bounded by e_int_max. The part
    of a desired wrench that the constraint does not admit is ignored. Where the normal is uncertain, use
    `taut.laws.NormalEstimate`.

    With kdamp the speed y = A V + phi_t against the rows is bounded from rest where contact is lost, as that of
    `ForceControl`: y . D y <= w . D^-1 w, w = (1 + kfp) lam_des + kfi e_int_max; of several rows as long as they are
    pressed, since damping does not pull at a one-sided row. With joint torques, which show the law's own force a tick
    late, kfp + kfi dt / 2 + d / 2 < 1 is needed off contact, d the largest eigenvalue of D dt A Lambda^-1 A^T: 1/2
    for what kfp and kfi have serves any kdamp. Without kdamp the speed is unbounded; `taut.laws.LossOfContact` around
    this law lets the force go.

    Frames:
        The constraint is in world axes; what it says of the tool is said at the tool's origin.

    Args:
        constraint: `taut.Constraint`, or a function of the pose such as lambda T: T.p[2] - 0.1.
        motion: The law of the motion, such as `TaskComputedTorque`, or one of joints, less its forces on the rows.
        kfp: Proportional gain of the force: a number or one per row.
        kfi: Integral gain.
        e_int_max: Largest integral of the force error; 20 N s, and 2 N m s for a moment, if left out.
        kdamp: Damping of motion against the constraint, such as of a tool that has lost its contact.
        feedback: With kfp or kfi, what measures the force: "wrench" or "joint_torque".
        curvature: Whether the term of that name is in the law.
        tolerance: How far phi may be from zero where a run starts [m, rad].

    Raises:
        UsageError: No constraint, or no law of motion that gives torques.
        MatchError: A wrist sensor that knows nothing of the constraint's frame.

    Example:
        >>> import taut
        >>> law = HybridMotionForce(
        ...     constraint=lambda T: T.p[2] - 0.1, motion=taut.laws.TaskComputedTorque(kp=100.0, kd=20.0), kfi=5.0
        ... )
        >>> law.rows
        1

    References:
        Section 10.4 hybrid motion-force control. Raibert and Craig (1981), ASME J. Dynamic Systems 102; Khatib
        (1987), IEEE Journal of Robotics and Automation 3 (1).
    """

    reference: ClassVar[type[Sample]] = HybridMotion
    needs_contact: ClassVar[bool] = True
    constraint: Part[Constraint] = Part(Constraint, convert=natural)
    motion: Law
    kfp: Gain = Gain(unit="1", shape="rows", optional=True)
    kfi: Gain = Gain(unit="1/s", shape="rows", optional=True)
    e_int_max: Gain = Gain(unit="N s, N m s", shape="rows", accepts=("scalar",), above=0.0, optional=True)
    kdamp: Gain = Gain(unit="N s/m, N m s/rad", shape="rows", optional=True)
    feedback: Choice[ForceFeedback] = Choice("wrench", "joint_torque")
    curvature: Plain[bool] = Plain(bool, default=True)
    tolerance: Field = Field(0.01, unit="m, rad", minimum=0.0, infinite=True, run_time=False)
    e_int = Memory(unit="N s, N m s")
    lam = Memory(unit="N, N m", record=True, doc="multipliers by eq. 10.42 of what is commanded")
    phi = Memory(unit="m, rad", record=True)

    def check(self) -> None:
        motion = self.motion
        if issubclass(motion.reference, HybridMotion):
            self.refuse("motion", f"must be a law such as TaskComputedTorque; got {type(motion).__name__}")
        if self.rows > MAX_MULTIPLIERS:
            self.refuse("constraint", f"must have up to {MAX_MULTIPLIERS} rows; it has {self.rows}")
        if self.measures and self.feedback == "wrench" and self.constraint.frame is None:
            self.refuse(
                "feedback",
                "'wrench' is for a constraint of one frame of the tool's link; for one of joints or of several "
                "frames take 'joint_torque', or leave kfp and kfi out",
            )
        self.__dict__["reference"] = hybrid_kind(motion.reference)

    @property
    def rows(self) -> int:
        """k, the number of rows of the constraint."""
        return self.constraint.count

    @property
    def measures(self) -> bool:
        """Whether forces are fed back."""
        return self.kfp is not None or self.kfi is not None

    def seen_by(self, child: str, x: Snapshot, ref: Any) -> tuple[Snapshot, Any]:
        return x, ref.motion if child == "motion" and isinstance(ref, HybridMotion) else ref

    def at_rest(self, x: Snapshot) -> Sample:
        return self.reference.at_rest(x, self.motion.controlled_frame)

    def check_rate(self, rate: float) -> None:
        """The slow mode of the force, -kfi / (1 + kfp), must be slower than the rate on any contact."""
        check_force_pole(*self._force_gains(), rate)

    def force_loop_gain(self, dt: float, touch: object) -> float:  # noqa: ARG002
        """Largest eigenvalue of kfp + kfi dt / 2, 0 without force feedback: unstable on rigid contacts from 1 on."""
        kfp, kfi = self._force_gains()
        return float(np.max(np.abs(np.linalg.eigvals(kfp + 0.5 * dt * kfi))))

    def _force_gains(self) -> tuple[Float64Array, Float64Array]:
        """(k, k) kfp and kfi, zero where they are left out."""
        gains = (np.zeros((self.rows, self.rows)) if k is None else k.matrix(self.rows) for k in (self.kfp, self.kfi))
        kfp, kfi = (np.asarray(gain, dtype=np.float64) for gain in gains)
        return kfp, kfi

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_constraint(self.constraint, x)
        if self.measures and self.feedback == "wrench":
            (frame,) = self.constraint.frame or (None,)
            check_sensor(x, frame)

    def check_reference(self, x: Snapshot, ref: Reference, rate: float) -> None:  # noqa: ARG002
        """The run starts on the constraint, forces can be applied against it, and the motion keeps to it."""
        check_place(self.constraint, x, self.tolerance)
        check_reference(self.constraint, x, ref, self.motion.controlled_frame, self.tolerance)

    def touches(self, x: Snapshot) -> Any:
        """Whether phi is within the tolerance and, for one-sided rows with a sensor, a force is on it."""
        rows = self.constraint.at(x)
        near = [tm.abs(value) <= self.tolerance for value in rows.phi]
        if self.measures and self.feedback == "wrench" and any(rows.one_sided):
            F = x.F_ext[:3]
            near.append(F @ F > TOUCHING * TOUCHING)
        return functools.reduce(lambda a, b: a & b, near)

    def contact_state(self, x: Snapshot) -> str:
        """How far the arm is from its constraint, and the force where one is measured, in words."""
        phi = np.asarray(self.constraint.at(x).phi, dtype=np.float64)
        row = int(np.argmax(np.abs(phi)))
        said = f"phi of row {row} of its constraint is {phi[row]:.3g}, and the tolerance is {self.tolerance:g}"
        if self.measures and self.feedback == "wrench":
            said += f"; {np.linalg.norm(x.F_ext[:3]):.3g} N measured, and contact is more than {TOUCHING:g} N"
        return said

    def closed_loop(self, x: Snapshot) -> ClosedLoop | None:
        """That of its motion, along the constraint; against it (I + kfp) lam_e + kfi int(lam_e) = const."""
        motion, eye, (kfp, kfi) = self.motion.closed_loop(x), np.eye(self.rows), self._force_gains()

        def gains(motion: Law, g: PlacedGains) -> Law:
            fed: dict[str, Any] = {} if g.force is None else {"kfi": g.force * (eye + kfp)}
            return replace(self, motion=motion, **fed)

        return motion and motion.held_by(gains, alone=motion.alone or self.motion, force=(kfp, kfi))

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        return self.controlled(x, ref, memory, dt, self.constraint.at(x))

    def controlled(
        self, x: Snapshot, ref: Any, memory: MemoryView, dt: float, rows: ConstraintRows
    ) -> tuple[Command, dict[str, Any]]:
        """The command with these rows of the constraint."""
        held = Constrained.of(rows, x.M_factors)
        command, motion = call(self.motion, *self._along(x, rows, ref.motion), memory["motion"], dt)
        if not isinstance(command, Torque):
            raise UsageError(
                f"motion holds a law that gives torques, and {type(self.motion).__name__} gives a {command.kind}",
                name="motion",
            )
        lam, e_int = self._multipliers(x, rows, held, ref, memory.e_int + tm.zeros(rows.count), dt)
        falling, curved = held.of_bias(rows.bias - rows.curvature), held.of_bias(rows.curvature)
        force = lam + Terms(force_nonlinear=-falling)
        if self.curvature:
            force = force + Terms(curvature=-curved)
        tau = command.terms.mapped(held.along) + Terms(nonlinear=held.against(x.h)) + force.mapped(held.pressing)
        if rows.A is None and self.motion.reference is TaskMotion:
            tau = tau + Terms(
                chain=held.along(held.brought_along(x, self.motion.controlled_frame, command.terms.total))
            )
        return Torque(tau), {
            "motion": motion,
            "lam": lam.total if self.curvature else lam.total + curved,
            "phi": rows.phi,
            "e_int": e_int,
        }

    def _along(self, x: Snapshot, rows: ConstraintRows, motion: Sample) -> tuple[Snapshot, Sample]:
        """What the law of motion sees and follows: of a tool that is constrained, without what is against that."""
        tool = self.motion.controlled_frame
        if not isinstance(motion, TaskMotion) or not of_one_body(self.constraint, x, tool):
            return x, motion
        assert self.constraint.frame is not None
        (frame,) = self.constraint.frame
        seen = without_reaction(x, rows, frame) if of_one_body(self.constraint, x, None) else x
        return seen, along_constraint(x, rows, frame, motion, tool)

    def _multipliers(
        self, x: Snapshot, rows: ConstraintRows, held: Constrained, ref: Any, e_int: Vector, dt: Any
    ) -> tuple[Terms, Vector]:
        """(k,) the multipliers to apply, as terms, and the integral after this tick."""
        wanted = asked_multipliers(self.constraint, rows, ref)
        lam, e = Terms(force=wanted), wanted - self.measured(x, rows, held) if self.measures else None
        if self.kfp is not None:
            lam = lam + Terms(force_P=self.kfp @ e)
        if self.kdamp is not None:
            mobility = rows.A_q @ held.Minv_AT
            lam = lam + Terms(force_D=-damping_force(self.kdamp.matrix(rows.count), mobility, rows.rate(x.v), dt))
        if self.kfi is not None:
            pushed = (lam + Terms(force_I=self.kfi @ e_int)).total
            e_int = self._integral(x, rows, held, pushed, e_int, e, dt)
            lam = lam + Terms(force_I=self.kfi @ e_int)
        if any(rows.one_sided):
            total = [tm.minimum(y, 0.0) if side else y for y, side in zip(lam.total, rows.one_sided, strict=True)]
            lam = lam.up_to(tm.array(total), "one_sided")
        return lam, e_int

    def _integral(
        self, x: Snapshot, rows: ConstraintRows, held: Constrained, lam: Vector, e_int: Vector, e: Any, dt: Any
    ) -> Vector:
        """(k,) the integral after a tick; rests where limits cut, or a contact would be pulled at, if e pushes on."""
        cut = held.of_bias(held.Minv_AT.T @ x.tau_cut)
        pulls = tm.where(np.array(rows.one_sided), lam, 0.0)
        grown = tm.where((cut * e > 0.0) | ((pulls > 0.0) & (e > 0.0)), e_int, e_int + e * dt)
        most: Any = np.where(self.constraint.moments, E_INT_MAX[1], E_INT_MAX[0])
        if self.e_int_max is not None:
            most = self.e_int_max.as_array()
        out: Vector = tm.clip(grown, -most, most)
        return out

    def measured(self, x: Snapshot, rows: ConstraintRows, held: Constrained) -> Vector:
        """(k,) the multipliers that are measured."""
        if self.feedback == "joint_torque":
            return held.lam(x.tau_meas - x.inverse_dynamics(np.zeros(x.n)))  # of all that acts on the links
        (frame,) = self.constraint.frame or (None,)
        return of_wrench(rows, -wrench_at(x, frame))

    def missing(self, x: Snapshot, ref: Any, contact: Any) -> Vector:
        """(k,) 1 for a one-sided row that is pressed with more than `contact` and gives less, else 0."""
        rows = self.constraint.at(x)
        held = Constrained.of(rows, x.M_factors)
        wanted, measured = asked_multipliers(self.constraint, rows, ref), self.measured(x, rows, held)
        least = np.where(self.constraint.moments, contact[1], contact[0])
        gone = [misses(-y, z * y, c) if side else 0.0
                for y, z, c, side in zip(wanted, measured, least, rows.one_sided, strict=True)]  # fmt: skip
        return tm.array(gone)
