"""RigidContact: what holds the arm of a plant rigidly, or stops it: constraints of section 10.4 as mechanics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Protocol, Self, runtime_checkable

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import RangeError, UsageError
from taut.base.fields import Declared, Field, Part, Parts
from taut.base.paths import subtree
from taut.base.types import Float64Array, Vector
from taut.control.combine import all_laws
from taut.control.laws.constraints import check_constraint
from taut.control.lawside import LawSide
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.impulses import Touch
from taut.maths.constraints.rows import Piece
from taut.maths.model import model_of
from taut.maths.snapshot import Snapshot, snapshot
from taut.plant.actuation import Actuation
from taut.trace.scalar import active_graph

Values = Mapping[str, Any]
CLOSED: Final = 1e-6  # [m | rad] within which a run may start in contact; the first step takes it away
START_SPEED_TOLERANCE: Final = 1e-6  # [m/s | rad/s] at which a run may start against what holds both ways
ROUNDING: Final = 1e-9  # [-] of a loop gain
TURNS: Final = 1e-9  # of A: a contact at the tool's origin has no moments about it


class RigidContact(Declared):
    """Something rigid that holds a plant's arm, or that it can touch: a constraint, with friction and impact.

    Model:
        M a + h + A_q^T lam = tau + friction,   A_q a + bias = 0                                   eqs. 10.40 to 10.42
        one-sided rows: phi >= 0, lam <= 0, phi lam = 0; the contact pushes and does not pull
        friction in the two directions across the gradient at the contact's point, a round cone: it holds the point,
        |f| <= friction |F_n|, or it brakes its sliding with f = -friction |F_n| v / |v|
        impact: where the gap closes at a speed u, friction times the impulse acting too, it opens at restitution u;
        rebounds whose flight would be shorter than two steps do not take place

    A step's positions are those with phi = 0 at its end, its velocities those with A_q v + dphi/dt = 0 there, each by
    impulses of the constraint (as RATTLE does): no drift, and a frictionless contact keeps the energy. The instant at
    which a gap closes within a step is interpolated.

    A two-sided row beside one-sided ones of the same function, as the two tilts of `plane(face=...)`, holds as long
    as one of them touches; a tilt at landing decays to zero in 20 ms, as of a face that lies down. The corners of a
    face as four one-sided rows can tip over an edge, which a `face` cannot.

    Columns of a run:
        contact.lam (k,), the multipliers at the tick, at the same state and torque, without correction of drift; of a
        gap that closes in the step, impulse / dt. contact.on (k,), 1.0 for rows that act after the step.
        contact.drift, the largest absolute phi of touching rows at the tick. contact.correction, the difference of
        the step's impulses / dt and lam. contact.slip (c, 3) [m/s], sliding velocities of points with friction at
        the tick.

    Args:
        constraint: What holds: a taut.Constraint.
        friction: Coulomb's mu, of contacts at a point: each function is a number that depends on the origin of a
            frame and not on its orientation, such as a plane, a sphere, a cylinder. None for none. The surface rests
            across its gradient, however it moves along it.
        restitution: Speed after an impact over that before, from 0 to 1. None for 0.

    Raises:
        UsageError: No constraint; friction where there is no point of contact, restitution where nothing can open.
        RangeError: Negative, a restitution above 1.

    Example:
        >>> import taut
        >>> board = taut.Constraint.plane(point=[0.0, 0.0, 0.3], normal=[0.0, 0.0, 1.0])
        >>> plant = taut.RigidPlant(taut.load_arm("panda"), contact=RigidContact(constraint=board, friction=0.3))
        >>> plant.parameters["contact.friction"].item()
        0.3

    References:
        Section 10.4.1; Andersen, J. Computational Physics 52 (1983), RATTLE; Stewart and Trinkle, Int. J. Numerical
        Methods in Engineering 39 (1996).
    """

    constraint: Part[Constraint] = Part(Constraint)
    friction: Field = Field(unit="1", minimum=0.0, optional=True)
    restitution: Field = Field(unit="1", minimum=0.0, maximum=1.0, optional=True)

    def check(self) -> None:
        """Only what is one-sided opens again."""
        if self.restitution is not None and not any(self.constraint.one_sided):
            self.refuse("restitution", "is for a constraint with one_sided=True, and this one holds both ways")


def each_contact(given: object) -> tuple[RigidContact, ...]:
    """Contacts from what a plant is given: one, a bare constraint, or a sequence of them."""
    if isinstance(given, Constraint):
        return (RigidContact(constraint=given),)
    if isinstance(given, RigidContact):
        return (given,)
    if isinstance(given, (tuple, list)) and given:
        return tuple(contact for part in given for contact in each_contact(part))
    raise UsageError(
        "contact must be a taut.RigidContact(constraint=...), a taut.Constraint, or several of them in a tuple; got "
        f"{'an empty one' if isinstance(given, (tuple, list)) else type(given).__name__}",
        name="contact",
    )


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where the rows of one function of a constraint stand among all rows."""

    contact: int  # which of the contacts
    piece: Piece
    rows: tuple[int, ...]
    touches: tuple[Touch, ...]

    @property
    def fixed(self) -> bool:
        """Whether its rows hold always, without friction."""
        return not any(self.piece.one_sided) and not self.touches[0].tangents


class Contacts(Declared):
    """The contacts of a plant, their rows one after the other; the tangents of friction come after all of them."""

    arm: Part[Arm] = Part(Arm)
    parts: Parts[tuple[RigidContact, ...]] = Parts(RigidContact)  # type: ignore[arg-type]  # a tuple of them

    @cached_property
    def count(self) -> int:
        """Rows of the constraints."""
        return sum(part.constraint.count for part in self.parts)

    @cached_property
    def one_sided(self) -> tuple[bool, ...]:
        """Of each row."""
        return tuple(side for part in self.parts for side in part.constraint.one_sided)

    @cached_property
    def places(self) -> tuple[Place, ...]:
        """Of each function."""
        out: list[Place] = []
        first, tangent = 0, self.count
        for c, part in enumerate(self.parts):
            for piece in part.constraint.pieces:
                rows = tuple(range(first, first + piece.count))
                first += piece.count
                sides = tuple(i for i, side in zip(rows, piece.one_sided, strict=True) if side)
                normal, *others = sides or rows[:1]
                beside = tuple(i for i in rows if i not in (normal, *others))
                tangents = () if part.friction is None else (tangent, tangent + 1)
                tangent += len(tangents)
                touch = Touch(normal=normal, one_sided=bool(sides), beside=beside, tangents=tangents)
                touches = (touch, *(Touch(normal=i, one_sided=True) for i in others))
                out.append(Place(contact=c, piece=piece, rows=rows, touches=touches))
        return tuple(out)

    @cached_property
    def touches(self) -> tuple[tuple[Place, Touch], ...]:
        """The rows that touch together, with the function that they are of."""
        return tuple((place, touch) for place in self.places for touch in place.touches)

    @cached_property
    def tilts(self) -> tuple[int, ...]:
        """Rows of a face that hold both ways as long as it touches."""
        return tuple(i for _, touch in self.touches if touch.one_sided for i in touch.beside)

    @cached_property
    def rubbing(self) -> tuple[tuple[Place, Touch], ...]:
        """The contacts with friction."""
        return tuple((place, touch) for place, touch in self.touches if touch.tangents)

    @cached_property
    def size(self) -> int:
        """Rows with those of friction."""
        return self.count + 2 * len(self.rubbing)

    @property
    def measured(self) -> bool:
        """Whether a sensor at the wrist measures any of it."""
        return any(self.at_tool(place) for place in self.places)

    def at_tool(self, place: Place) -> bool:
        """Whether it acts on the body that carries the tool."""
        frames, model = place.piece.frames, model_of(self.arm)
        return len(frames) == 1 and model.placement(frames[0])[0] == model.placement(None)[0]

    def declared_parts(self) -> dict[str, Declared]:
        """The contacts by their number, of which a single one has none in its paths."""
        return {str(c): part for c, part in enumerate(self.parts)}

    def _below(self, name: str) -> str:
        return "" if len(self.parts) == 1 else f"{name}."

    def _with_parts(self, parts: Mapping[str, Any]) -> Self:
        return self._replaced({"parts": tuple(({**self.declared_parts(), **parts}).values())})

    def value(self, c: int, name: str, parameters: Values) -> Any:
        """Of one contact; None where there is none."""
        return parameters.get(f"contact.{self._below(str(c))}{name}")

    def check_points(self) -> None:
        """UnknownNameError for frames that the arm lacks; UsageError for friction without a point of contact."""
        x = self._snapshot(self.arm.home, np.zeros(self.arm.n))
        for part in self.parts:
            part.constraint.at(x)
        for place, touch in self.rubbing:
            self._check_point(place, touch, x)

    def _check_point(self, place: Place, touch: Touch, x: Snapshot) -> None:
        rows, ones = place.piece.at(x), sum(place.piece.one_sided)
        why = ""
        if rows.A is None:
            why = "it is of joints" if not place.piece.frames else "it is of several frames"
        elif ones > 1 or (not ones and len(place.rows) > 1):
            why = f"it has {len(place.rows)} rows"
        else:
            A = np.asarray(rows.A, dtype=np.float64)[touch.normal - place.rows[0]]
            if not np.isfinite(A).all() or np.linalg.norm(A[3:]) > TURNS * np.linalg.norm(A[:3]):
                why = "it depends on how the tool is turned"
        if why:
            raise UsageError(
                f"contact.friction needs a point of contact, the origin of a frame, and this constraint has none: "
                f"{why}; give a function of T.p alone, such as Constraint.plane, with frame= at the point, or leave "
                "friction out",
                name="friction",
            )

    def check_start(self, q: Vector, v: Vector) -> None:
        """RangeError for a start off a two-sided row, against it, or behind a one-sided one; or dependent rows."""
        if active_graph() is not None:  # it is for numbers
            return
        x = self._snapshot(q, v)
        for place in self.places:
            rows = place.piece.at(x)
            speed = np.asarray(rows.A_q @ v + rows.phi_t, dtype=np.float64)
            for i, phi in enumerate(np.asarray(rows.phi, dtype=np.float64)):
                which = "the constraint" if self.count == 1 else f"row {place.rows[i]} of the constraint"
                if place.rows[i] not in self.tilts:
                    _check_row(which, float(phi), float(speed[i]), one_sided=rows.one_sided[i])
            touching = [phi <= CLOSED for phi, side in zip(rows.phi, rows.one_sided, strict=True) if side]
            if place.fixed or (len(place.rows) == 1 and all(touching)):
                check_constraint(Constraint.of([place.piece]), x)
        held = [place.piece for place in self.places if place.fixed]
        if len(held) > 1:
            check_constraint(Constraint.of(held), x)

    def _snapshot(self, q: Vector, v: Vector) -> Snapshot:
        return Snapshot(model_of(self.arm), q=q, v=v)


def _check_row(which: str, phi: float, speed: float, *, one_sided: bool) -> None:
    if phi < -CLOSED or (abs(phi) > CLOSED and not one_sided):
        rule = "phi >= 0" if one_sided else "phi = 0"
        raise RangeError(
            f"a run must start where contact= lets the arm be, and {which} has phi = {phi:.4g} there, not {rule}; "
            "start from q0=taut.dynamics.onto(constraint, arm, q), the nearest state that keeps to it",
            name="q0",
            value=phi,
            rule=rule,
        )
    if abs(speed) > START_SPEED_TOLERANCE and not one_sided:
        raise RangeError(
            f"a run must start with a motion that contact= allows, and at v0 {which} has d phi/dt = {speed:.4g}; "
            "leave v0 out, or take from it what moves against the constraint",
            name="v0",
            value=speed,
        )


@runtime_checkable
class HasContacts(Protocol):
    """A plant that rigid contacts may hold."""

    @property
    def contacts(self) -> Contacts | None: ...

    @property
    def actuation(self) -> Actuation: ...


class RigidTouch:
    """A tool at a rigid contact, in plain numbers, with the arm at q."""

    def __init__(self, contacts: Contacts, q: Float64Array) -> None:
        self._contacts = contacts
        self.x: Snapshot = snapshot(contacts.arm, q)

    def pressing(self, tool: str | None) -> Float64Array:
        """(6, 6) the part of a wrench at a tool that presses on it: A^T (A Lambda^-1 A^T)^-1 A Lambda^-1."""
        J = np.asarray(self.x.J(tool), dtype=np.float64)
        A = np.vstack([np.asarray(p.constraint.at(self.x).A_q, dtype=np.float64) for p in self._contacts.parts])
        A = A @ np.linalg.pinv(J)
        W = A @ J @ np.linalg.solve(np.asarray(self.x.M), J.T)
        out: Float64Array = A.T @ np.linalg.lstsq(W @ A.T, W, rcond=None)[0]
        return out


@runtime_checkable
class FeedsForceBack(Protocol):
    """A law that feeds a measured force back."""

    def force_loop_gain(self, dt: float, touch: RigidTouch | None) -> float:
        """The largest eigenvalue of (kfp + kfi dt / 2) P at a contact, the law's own for None; 0 if unknown."""
        ...


def check_force_feedback(
    side: LawSide, plant: object, q: Float64Array | None = None, parameters: Mapping[str, Any] | None = None
) -> None:
    """Force feedback through ideal drives, unfiltered, must be stable on a rigid contact, where it is a tick late.

    F_app(t + dt) = P F(t) with F = ... - (kfp + kfi dt / 2) F_app(t): the largest eigenvalue of (kfp + kfi dt / 2) P
    must be under 1, where P is the part of a wrench that presses on the contact; else a RangeError. Without q, only
    laws are checked that state the contact themselves.
    """
    if not isinstance(plant, HasContacts) or plant.contacts is None or plant.actuation.acts:
        return
    if side.sensing.F_ext is not None or side.sensing.tau_meas is not None:
        return
    touch = RigidTouch(plant.contacts, q) if q is not None and side.arm.n >= 6 else None
    whole = side.law if parameters is None else side.law.bound(subtree(parameters, "law"))
    for path, law in all_laws(whole, "law"):
        gain = law.force_loop_gain(side.dt, touch) if isinstance(law, FeedsForceBack) else 0.0
        if gain >= 1.0 - ROUNDING:
            raise RangeError(
                "kfp + kfi dt / 2 must be under 1 on a rigid contact, where the measured force is a tick old, or the "
                f"force loop is unstable; {path} has {gain:.4g}; lower kfp, or filter what is measured",
                name=f"{path}.kfp",
                value=gain,
                rule="< 1",
            )
