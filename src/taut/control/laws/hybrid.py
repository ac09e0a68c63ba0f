"""Hybrid motion-force control: section 10.4 of the chapter, equations 10.39 to 10.45."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ClassVar, Final, Literal

import numpy as np

from taut.base.checks import float_array, one_of
from taut.base.errors import RangeError, UsageError
from taut.base.types import Vector
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, Memory
from taut.control.law import Law, MemoryView, call
from taut.control.laws.along_constraint import along_constraint, asked_pose, at_frame, felt_along, of_one_body
from taut.control.laws.compliance import check_sensor, wrench_at
from taut.control.laws.constraint_checks import (
    check_constraint,
    check_forces,
    check_motion,
    check_place,
    check_surface,
)
from taut.control.laws.constraint_estimate import NEVER, NormalEstimate, turn_between, turned_rows
from taut.control.laws.contact_loss import CONTACT, E_INT_MAX, PATIENCE, counted, taken_back
from taut.control.laws.damping import damping_force
from taut.control.laws.integral import check_force_pole
from taut.control.laws.row_forces import asked_multipliers, braking, gentler, missed, of_wrench, per_row, swung
from taut.control.trajectories.hybrid_motion import MOST_ROWS, HybridMotion, hybrid_kind
from taut.control.trajectories.reference import Reference, Sample
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.impulses import choose
from taut.maths.constraints.multipliers import Constrained
from taut.maths.constraints.rows import ConstraintRows
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["HybridMotionForce"]

ForceFeedback = Literal["wrench", "joint_torque"]
TOUCHING: Final = 1.0  # [N] on a tool that counts as in contact
FEEDBACKS: Final[tuple[ForceFeedback, ...]] = ("wrench", "joint_torque")


class HybridMotionForce(Law):
    """Hybrid motion-force control: a motion along constraints, and forces against them.

    Law:          tau = J^T (P F_motion + (I - P) F_force + gamma + eta - F_curved)                     eq. 10.45
                  F_motion = Lambda (a_des + kp X_e + ki int(X_e) + kd V_e), or what else `motion` is     eq. 10.31
                  F_force  = A^T (lam_des + kfp lam_e + kfi int(lam_e) - D (A V + phi_t))                 eq. 10.38
                  D = (kdamp^-1 + dt A Lambda^-1 A^T)^-1, the damping kdamp when the tick ends, as of `ForceControl`
                  F_curved = A^T S (A-dot V + ...), the term `curvature`, which the chapter leaves out
                  P = I - A^T S A Lambda^-1, S = (A Lambda^-1 A^T)^-1                                     eq. 10.44
                  with A X_e = 0, A V_e = 0, A a_des = -(A-dot V + ...): what a reference of the tool asks against a
                    constraint of the tool is taken out of it, where the tool is, before `motion` sees it
    Closed loop:  along the constraints that of `motion`: V-dot is what it asks for along them, whatever Lambda is,
                    and wherever the surface really is. A reference that keeps to the constraint is not changed, and
                    on a flat one eq. 10.45 is as it stands; on a curved one it differs by what the reference asks
                    against the tangent at the tool, in the measure of the error along it
                    an inertia D of `motion` feels what is along the constraint of F_ext, and not the contact's force
                    of a law of joints, or a constraint that is not one of the tool's link, P Lambda of what it asks:
                    what is asked against the constraint comes out as motion along it as well
                    of a tool in a closed chain, in the directions that the chain leaves to it: the term `chain`
                  against them lam = F_force's, in a rigid contact: (1 + kfp) lam_e + kfi int(lam_e) = const, with the
                    pole -kfi / (1 + kfp), not the -kfi / kfp of eq. 10.36; the measured force is a tick old, so that
                    kfp + kfi dt / 2 < 1, or the loop swings up; a RigidPlant refuses it, elsewhere a run tells
                  with curvature=False lam is off by S A-dot V: m v^2 / r on a surface of radius r

    lam_meas is (A A^T)^-1 A F_app of the wrist sensor: friction along a surface at the tool's origin does not count
    as pressing. With feedback="joint_torque" it is eq. 10.42 with the measured torques, and what the model does not
    know, such as a payload, counts as a force. Without kfp and kfi no force is measured, and lam_des is fed forward,
    eq. 10.34. A one-sided row is never asked to pull. The integral rests where limits of the torque cut the force, or
    a contact would be pulled at, and the error pushes further that way; it is cut at e_int_max.

    Loss of contact: of a one-sided row, less than `contact` is measured while more is asked for. Longer than
    `patience`, memory `lost` is 1; the metric contact_lost_time and the outcome tell. With kdamp the speed y = A V +
    phi_t against the rows is bounded from rest, y . D y <= w . D^-1 w with w = (1 + kfp) lam_des + kfi e_int_max, as
    that of `ForceControl`: one row moves at no more than (1 / kdamp + dt A Lambda^-1 A^T) w. Of several rows that
    holds as long as they are pressed: damping does not pull at a one-sided row either. With joint torques, which show
    the law's own force a tick late, kfp + kfi dt / 2 + d / 2 < 1 is needed off contact, d the largest eigenvalue of D
    dt A Lambda^-1 A^T: 1/2 for what kfp and kfi have serves any kdamp. Without kdamp, the force goes within the
    patience to twice `contact` and the integral rests, motion against the row is braked within 0.02 s, term `lost`,
    and contact that is there again is taken up within the patience.

    The outcome of a run tells too where a motion was asked for that is off the constraint by more than the tolerance,
    which is followed along it only, and a force that it does not bear, of which only the rest is applied.

    Frames:
        The constraint is in world axes; what it says of the tool is said at the tool's origin.

    Args:
        constraint: `taut.Constraint`, or a function of the pose such as lambda T: T.p[2] - 0.1.
        motion: The law of the motion, such as `TaskComputedTorque`, `Impedance`, or one of joints; the forces that
            it would make against the constraints are taken out.
        kfp: Proportional gain of the force: a number or one per row.
        kfi: Integral gain.
        e_int_max: Largest integral of the force error; 20 N s, and 2 N m s for a moment, if left out.
        kdamp: Damping of motion against the constraint, such as of a tool that has lost its contact.
        contact: Force of a row that counts as contact; 1 N, and 0.1 N m for a moment, if left out.
        patience: Time without it after which contact is lost.
        feedback: With kfp or kfi, what measures the force: "wrench" or "joint_torque".
        curvature: Whether the term of that name is in the law.
        tolerance: How far phi may be from zero where a run starts [m, rad].
        estimate: `taut.laws.NormalEstimate()` where it is not well known where the surface faces: the law is then
            that of the constraint turned as force and motion show it.

    Raises:
        UsageError: No constraint, or no law of motion that gives torques; an estimate of what is no surface.
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

    reference = HybridMotion
    needs_contact: ClassVar[bool] = True
    constraint: Constraint | Callable[..., Any]
    motion: Law
    kfp: Gain = Gain(optional=True, size="rows")  # [1]
    kfi: Gain = Gain(optional=True, size="rows")  # [1/s]
    e_int_max: Gain = Gain(optional=True, size="rows", minimum=1e-9)  # [N s, N m s]
    kdamp: Gain = Gain(optional=True, size="rows")  # [N s/m, N m s/rad]
    contact: Gain = Gain(optional=True, size="rows", minimum=1e-9)  # [N, N m]
    patience: Gain = Gain(PATIENCE, size=0)  # [s]
    feedback: ForceFeedback = "wrench"
    curvature: bool = True
    tolerance: float = 0.01
    estimate: Law | None = None
    e_int: Memory = Memory(0.0)  # [N s, N m s]
    lam: Memory = Memory(0.0)  # multipliers by eq. 10.42 of what is commanded [N, N m]
    phi: Memory = Memory(0.0)  # [m, rad]
    share: Memory = Memory(1.0)  # of the force that is applied, without kdamp
    alone: Memory = Memory(0.0)  # [s] since there was contact
    lost: Memory = Memory(0.0)  # 1 where contact is lost
    bounded: Memory = Memory(0.0)  # 1 where the integral is at its bound
    e_last: Memory = Memory(0.0)  # [N, N m] the error of the force a tick ago
    turned: Memory = Memory(0.0)  # ticks in which it turned round, one after the other
    swings: Memory = Memory(0.0)  # 1 where those are many
    slipped: Memory = Memory(0.0)  # [m, rad] how far the motion went against rows of velocities
    astray: Memory = Memory(0.0)  # 1 where the motion is off the constraint
    dependent: Memory = Memory(0.0)  # (k,) 1 where a row is dependent on later ones
    unborne: Memory = Memory(0.0)  # 1 where the constraint does not bear what is asked for

    recorded: ClassVar[tuple[str, ...]] = (
        "lam",
        "phi",
        "lost",
        "bounded",
        "swings",
        "astray",
        "unborne",
        "dependent",
    )
    notices: ClassVar[tuple[tuple[str, str], ...]] = (
        ("lost", "the tool met less than was asked for, contact was lost"),
        ("bounded", "the integral of the force error was at its bound e_int_max"),
        (
            "swings",
            "the force error turned round, as it does where kfp + kfi dt / 2 is not under 1 at a rigid contact,",
        ),
        ("astray", "the motion asked for, off the constraint by more than the tolerance, was followed only along it"),
        ("dependent", "rows of the constraint said the same as later ones, and were left out"),
        ("unborne", "a part of the force asked for, which the constraint does not bear, was left out"),
    )

    def __post_init__(self) -> None:
        if not isinstance(self.constraint, Constraint):
            if not callable(self.constraint):
                raise UsageError(
                    "constraint must be a function of the pose, such as lambda T: T.p[2] - 0.1, or a taut.Constraint"
                    f"; got {type(self.constraint).__name__}",
                    name="constraint",
                )
            object.__setattr__(self, "constraint", Constraint(self.constraint))
        one_of("feedback", self.feedback, FEEDBACKS)
        if not isinstance(self.curvature, bool):  # callers without a type checker
            raise UsageError(f"curvature must be True or False; got {self.curvature!r}", name="curvature")
        object.__setattr__(self, "tolerance", _tolerance(self.tolerance))
        if self.rows > MOST_ROWS:
            raise UsageError(
                f"a hybrid law takes constraints of up to {MOST_ROWS} rows; these have {self.rows}", name="constraint"
            )
        if not isinstance(self.motion, Law) or issubclass(self.motion.reference, HybridMotion):
            raise UsageError(
                "motion holds a law such as taut.laws.TaskComputedTorque(kp=100.0, kd=20.0); got "
                f"{type(self.motion).__name__}",
                name="motion",
            )
        if self.measures and self.feedback == "wrench" and self.natural.frame is None:
            raise UsageError(
                "feedback='wrench' is for a constraint of one frame of the tool's link; for one of joints or of "
                "several frames take feedback='joint_torque', or leave kfp and kfi out",
                name="feedback",
            )
        if self.estimate is not None:
            self._check_estimate()
        object.__setattr__(self, "reference", hybrid_kind(self.motion.reference))

    def _check_estimate(self) -> None:
        if not isinstance(self.estimate, NormalEstimate):
            raise UsageError(
                f"estimate holds taut.laws.NormalEstimate(); got {type(self.estimate).__name__}", name="estimate"
            )
        if self.natural.frame is None or self.motion.reference is not TaskMotion:
            raise UsageError(
                "estimate is for a surface that one frame touches, and a motion of that frame, such as "
                "TaskComputedTorque; leave it out",
                name="estimate",
            )

    @property
    def natural(self) -> Constraint:
        """The natural constraints, whatever they were given as."""
        assert isinstance(self.constraint, Constraint)
        return self.constraint

    @property
    def rows(self) -> int:
        """k, the number of rows of the constraint."""
        return self.natural.count

    @property
    def measures(self) -> bool:
        """Whether forces are fed back."""
        return self.gives("kfp") or self.gives("kfi")

    def seen_by(self, child: str, x: Snapshot, ref: Sample) -> tuple[Snapshot, Sample]:
        return x, ref.motion if child == "motion" and isinstance(ref, HybridMotion) else ref

    def at_rest(self, x: Snapshot) -> Sample:
        return self.reference.at_rest(x, self.motion.controlled_frame)

    def check_rate(self, rate: float) -> None:
        """The slow mode of the force, -kfi / (1 + kfp), must be slower than the rate on any contact."""
        if self.gives("kfi"):
            k = self.rows
            check_force_pole(self.kfp.matrix(k) if self.gives("kfp") else np.zeros((k, k)), self.kfi.matrix(k), rate)

    def force_loop_gain(self, dt: float, touch: object) -> float:  # noqa: ARG002
        """The largest eigenvalue of kfp + kfi dt / 2: from 1 on, a force a tick old is unstable on rigid contacts.

        0 where no force is fed back.
        """
        k = self.rows
        gains = [
            np.asarray(gain.matrix(k), dtype=np.float64) * factor
            for name, factor in (("kfp", 1.0), ("kfi", 0.5 * dt))
            if (gain := self.gains().get(name)) is not None
        ]
        return float(np.max(np.abs(np.linalg.eigvals(sum(gains))))) if gains else 0.0

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        check_constraint(self.natural, x)
        if (self.measures and self.feedback == "wrench") or self.estimate is not None:
            frame = self.natural.frame
            check_sensor(x, None if frame is None else frame[0])
        if self.estimate is not None:
            check_surface(self.natural, x, self.motion.controlled_frame)

    def check_reference(self, x: Snapshot, ref: Reference, rate: float) -> None:  # noqa: ARG002
        """The run starts on the constraint, forces can be applied against it, and the motion keeps to it.

        Raises:
            RangeError: A start or a motion off the constraint, a force that no contact can bear.
        """
        check_place(self.natural, x, self.tolerance)
        check_forces(self.natural, x, ref)
        self._check_motion(x, ref)

    def check_reference_later(self, x: Snapshot, ref: Reference, rate: float) -> None:  # noqa: ARG002
        """The same of a phase that begins elsewhere, as far as it is known: the motion keeps to the constraint.

        Raises:
            RangeError: A motion off the constraint, a force that the contact cannot bear at any place.
        """
        check_forces(self.natural, x, ref, later=True)
        self._check_motion(x, ref, later=True)

    def _check_motion(self, x: Snapshot, ref: Reference, *, later: bool = False) -> None:
        """Not of a law that estimates the surface: it goes along that, whatever the motion asks for against it."""
        if self.estimate is None:
            check_motion(self.natural, x, ref, self.motion.controlled_frame, self.tolerance, later=later)

    def touches(self, x: Snapshot) -> Any:
        """Whether the arm keeps to the constraint: phi within the tolerance, and a force on it where one is measured.

        Without a sensor, and for what holds both ways, phi alone tells.
        """
        rows = self.natural.at(x)
        near = [tm.abs(value) <= self.tolerance for value in rows.phi]
        if self.measures and self.feedback == "wrench" and any(rows.one_sided):
            F = x.F_ext[:3]
            near.append(F @ F > TOUCHING * TOUCHING)
        return functools.reduce(lambda a, b: a & b, near)

    def contact_state(self, x: Snapshot) -> str:
        """How far the arm is from its constraint, of what the tolerance is, and the force where one is measured."""
        rows = self.natural.at(x)
        phi = np.asarray(rows.phi, dtype=np.float64)
        row = int(np.argmax(np.abs(phi)))
        unit = "" if rows.A is None else " m" if np.any(np.asarray(rows.A)[row, :3]) else " rad"
        limit = f"the tolerance is {self.tolerance:g}{unit}"
        said = f"{abs(phi[row]):.3g}{unit} off row {row} of its constraint, and {limit}"
        if self.measures and self.feedback == "wrench" and any(rows.one_sided):
            said += f"; {np.linalg.norm(x.F_ext[:3]):.3g} N measured, and contact is more than {TOUCHING:g} N"
        return said

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, object]]:
        rows, estimated = self.natural.at(x), None
        if isinstance(self.estimate, NormalEstimate):
            rows, estimated = self._estimated(self.estimate, x, rows, memory["estimate"], dt)
        held = Constrained.of(rows, x.M_factors)
        command, motion = call(self.motion, *self._along(x, rows, ref.motion), memory["motion"], dt)
        if not isinstance(command, Torque):
            raise UsageError(
                f"motion holds a law that gives torques, and {type(self.motion).__name__} gives a {command.kind}",
                name="motion",
            )
        lam, of_force = self._multipliers(x, rows, held, ref, memory, dt)
        falling, curved = held.felt(rows.bias - rows.curvature), held.felt(rows.curvature)
        force = lam + Terms(force_nonlinear=-falling)
        if self.curvature:
            force = force + Terms(curvature=-curved)
        tau = command.terms.mapped(held.along) + Terms(nonlinear=held.against(x.h)) + force.mapped(held.pressing)
        if rows.A is None and self.motion.reference is TaskMotion:
            tau = tau + Terms(
                chain=held.along(held.brought_along(x, self.motion.controlled_frame, command.terms.total))
            )
        told = lam.total if self.curvature else lam.total + curved
        after: dict[str, object] = {"motion": motion, "lam": told, "phi": rows.phi, **of_force}
        after |= self._astray(x, ref.motion, memory.slipped + tm.zeros(rows.count), dt)
        after["dependent"] = tm.array([tm.where(gone, 1.0, 0.0) for gone in held.mobility.dropped])
        if estimated is not None:
            after["estimate"] = estimated
        return Torque(tau), after

    def _estimated(
        self, estimate: NormalEstimate, x: Snapshot, stated: ConstraintRows, memory: Any, dt: Any
    ) -> tuple[ConstraintRows, dict[str, object]]:
        """The rows as they are turned by the estimate of the first one's normal, and its memory."""
        assert self.natural.frame is not None
        assert stated.A is not None
        V = x.twist(*self.natural.frame)
        size = tm.sqrt(stated.A[0, :3] @ stated.A[0, :3] + NEVER)
        n_0 = stated.A[0, :3] / size
        over = V[:3] + ((stated.A[0, 3:] @ V[3:] + stated.phi_t[0]) / size) * n_0
        tilt = estimate.updated(memory["tilt"], n_0, over, x.F_ext[:3], dt)
        n = n_0 + tilt
        n = n / tm.sqrt(n @ n + NEVER)
        return turned_rows(self.natural, x, turn_between(n_0, n)), {"tilt": tilt, "normal": n}

    def _along(self, x: Snapshot, rows: ConstraintRows, motion: Sample) -> tuple[Snapshot, Sample]:
        """What the law of motion sees and follows: of a tool that is constrained, without what is against that."""
        tool = self.motion.controlled_frame
        if not isinstance(motion, TaskMotion) or not of_one_body(self.natural, x, tool):
            return x, motion
        assert self.natural.frame is not None
        (frame,) = self.natural.frame
        felt = felt_along(x, rows, frame) if of_one_body(self.natural, x, None) else x
        return felt, along_constraint(x, rows, frame, motion, tool)

    def _astray(self, x: Snapshot, motion: Sample, slipped: Vector, dt: Any) -> dict[str, object]:
        """1 where the motion asks for what is off the constraint by more than the tolerance, else 0.

        That is a pose, or a way against rows of velocities. Not of a law that estimates the surface: it goes along
        that, whatever the motion asks for against it.
        """
        tool = self.motion.controlled_frame
        if self.estimate is not None or not isinstance(motion, TaskMotion) or not of_one_body(self.natural, x, tool):
            return {"astray": 0.0, "slipped": slipped}
        assert self.natural.frame is not None
        (frame,) = self.natural.frame
        T = asked_pose(x, frame, motion, tool)
        slipped = slipped + dt * self.natural.slip_of(T, at_frame(x, frame, motion, tool).twist)
        off = [tm.abs(y) for y in (*self.natural.phi_of(T, x.t), *slipped)]
        return {"astray": tm.where(functools.reduce(tm.maximum, off) > self.tolerance, 1.0, 0.0), "slipped": slipped}

    def _multipliers(
        self, x: Snapshot, rows: ConstraintRows, held: Constrained, ref: Any, memory: MemoryView, dt: Any
    ) -> tuple[Terms, dict[str, object]]:
        """(k,) the multipliers to apply, as terms; and the memory of the force after this tick."""
        zero = tm.zeros(rows.count)
        after: dict[str, object] = {name: getattr(memory, name) for name in ("alone", "lost", "turned", "swings")}
        after |= {name: getattr(memory, name) + zero for name in ("e_int", "e_last", "share")}
        wanted, unborne = asked_multipliers(self.natural, rows, ref)
        after |= {"bounded": memory.bounded, "unborne": unborne}
        lam, missing, contact = Terms(force=wanted), [0.0] * rows.count, self._per_row("contact", CONTACT)
        if self.measures:
            measured = self._measured(x, rows, held)
            e, patience = wanted - measured, self.patience.as_array()
            missing = missed(rows, wanted, measured, contact)
            after |= swung(e, memory.e_last + zero, memory.turned, contact)
            after |= counted(memory.alone, functools.reduce(tm.maximum, missing), patience, dt)
            if self.fades:
                after["share"] = taken_back(memory.share + zero, tm.array(missing), patience, dt)
        if self.gives("kfp"):
            lam = lam + Terms(force_P=self.kfp @ e)
        if self.gives("kdamp"):
            mobility = rows.A_q @ held.Minv_AT
            lam = lam + Terms(force_D=-damping_force(self.kdamp.matrix(rows.count), mobility, rows.rate(x.v), dt))
        if self.gives("kfi"):
            e_int = memory.e_int + zero
            pushed = (lam + Terms(force_I=self.kfi @ e_int)).total
            e_int, after["bounded"] = self._integral(x, rows, held, pushed, e_int, e, missing, dt)
            after["e_int"] = e_int
            lam = lam + Terms(force_I=self.kfi @ e_int)
        if self.fades:
            lam = lam.up_to(gentler(rows, lam.total, memory.share + zero, contact), "lost")
        if any(rows.one_sided):
            total = tm.array(
                [tm.minimum(y, 0.0) if side else y for y, side in zip(lam.total, rows.one_sided, strict=True)]
            )
            lam = lam.up_to(total, "one_sided")
        if self.fades:
            lam = lam + Terms(lost=held.felt(braking(rows, rows.rate(x.v), memory.share + zero, dt)))
        return lam, after

    def _integral(
        self,
        x: Snapshot,
        rows: ConstraintRows,
        held: Constrained,
        lam: Vector,
        e_int: Vector,
        e: Any,
        missing: list[Any],
        dt: Any,
    ) -> tuple[Vector, Any]:
        """(k,) the integral after this tick, and 1 where its bound cut it.

        It rests where limits cut the force, or a contact would be pulled at, and the error pushes further that way;
        and where a contact misses that nothing but the integral's rest keeps from being pressed for ever more.
        """
        cut = held.felt(held.Minv_AT.T @ x.tau_cut)
        grown: Vector = tm.where(cut * e > 0.0, e_int, e_int + e * dt)
        if any(rows.one_sided):
            rests = [
                ((y > 0.0) & (z > 0.0)) | (misses > 0.5 if self.fades else False) if side else False
                for y, z, misses, side in zip(lam, e, missing, rows.one_sided, strict=True)
            ]
            grown = tm.array([choose(rest, old, new) for rest, old, new in zip(rests, e_int, grown, strict=True)])
        most = self._per_row("e_int_max", E_INT_MAX)
        kept = tm.clip(grown, -most, most)
        return kept, tm.where(functools.reduce(tm.maximum, tm.abs(grown) - most) > 0.0, 1.0, 0.0)

    def _per_row(self, gain: str, default: tuple[float, float]) -> Vector:
        """(k,) a gain, or where it was not given what stands for forces and for moments."""
        if not self.gives(gain):
            return per_row(self.natural, default)
        given: Vector = getattr(self, gain).as_array() + tm.zeros(self.rows)
        return given

    @property
    def fades(self) -> bool:
        """Whether the force is taken back with a contact that is lost: where no kdamp bounds the speed."""
        return self.measures and not self.gives("kdamp") and any(self.natural.one_sided)

    def _measured(self, x: Snapshot, rows: ConstraintRows, held: Constrained) -> Vector:
        """(k,) the multipliers that are measured."""
        if self.feedback == "joint_torque":
            return held.lam(x.tau_meas - x.inverse_dynamics(np.zeros(x.n)))  # of all that acts on the links
        (frame,) = self.natural.frame or (None,)
        return of_wrench(rows, -wrench_at(x, frame))


def _tolerance(value: object) -> float:
    number = float(float_array("tolerance", value, shape=()))  # type: ignore[arg-type]  # checked inside
    if not number >= 0.0:
        raise RangeError(
            f"tolerance must be >= 0 [m, rad]; got {number!r}", name="tolerance", value=number, rule=">= 0"
        )
    return number
