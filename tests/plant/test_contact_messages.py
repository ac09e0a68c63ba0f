"""Rigid contacts that cannot be, and runs that cannot begin, are refused in a sentence."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from plant_laws import run

import taut
from taut import math as tm

ARM = taut.load_arm("gantry3")
PLANAR = taut.load_arm("planar2")
FLOOR = taut.Constraint.plane(point=[0.0, 0.0, -0.2], normal=[0.0, 0.0, 1.0])
BOTH = taut.Constraint.plane(point=[0.0, 0.0, -0.2], normal=[0.0, 0.0, 1.0], one_sided=False)
NO_POINT = (
    "contact.friction needs a point of contact, the origin of a frame, and this constraint has none: {}; give a function "
    "of T.p alone, such as Constraint.plane, with frame= at the point, or leave friction out"
)


def contact(constraint: taut.Constraint = FLOOR, **numbers: object) -> taut.RigidContact:
    return taut.RigidContact(constraint=constraint, **numbers)  # type: ignore[arg-type]


def rubbing(constraint: taut.Constraint) -> taut.RigidPlant:
    return taut.RigidPlant(ARM, contact=contact(constraint, friction=0.3))


CASES: list[tuple[Callable[[], object], type[taut.TautError], str]] = [
    (
        lambda: contact("floor"),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "contact.constraint must be a taut.Constraint; got str",
    ),
    (lambda: contact(friction=-0.1), taut.errors.RangeError, "contact.friction must be >= 0 [1]; got -0.1"),
    (
        lambda: contact(friction=[0.1, 0.2]),
        taut.errors.ShapeError,
        "contact.friction must be one number; got shape (2,)",
    ),
    (
        lambda: contact(restitution=1.2),
        taut.errors.RangeError,
        "contact.restitution must be <= 1, for an impact gives no energy; got 1.2",
    ),
    (
        lambda: contact(BOTH, restitution=0.5),
        taut.errors.UsageError,
        "contact.restitution is for one-sided constraints, and this one holds both ways; leave it out, or give the "
        "constraint one_sided=True",
    ),
    (
        lambda: taut.RigidPlant(ARM, contact=0.3),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "contact must be a taut.RigidContact(constraint=...), a taut.Constraint, or several of them in a tuple; got float",
    ),
    (
        lambda: taut.RigidPlant(ARM, contact=()),
        taut.errors.UsageError,
        "contact must be a taut.RigidContact(constraint=...), a taut.Constraint, or several of them in a tuple; got an "
        "empty one",
    ),
    (
        lambda: taut.RigidPlant(ARM, contact=FLOOR, integrator="rk4"),
        taut.errors.UsageError,
        "rk4 needs smooth forces, and a contact stops the arm at once; use semi-implicit-euler",
    ),
    (
        lambda: taut.RigidPlant(
            ARM, contact=FLOOR, takes="position", actuation=taut.drives.Actuation(bandwidth=50.0)
        ),
        taut.errors.UsageError,
        "contact is for torque commands, for stiff drives do not give way to it; this plant takes position; give "
        "environment=taut.environments.StiffWall(...), or takes='torque'",
    ),
    (
        lambda: taut.RigidPlant(ARM, contact=taut.Constraint(lambda T: T.p[2], frames=("gantry",))),
        taut.errors.UnknownNameError,
        "the arm has no frame 'gantry'",
    ),
    (
        lambda: contact(torsion=0.02),
        taut.errors.UsageError,
        "contact.torsion is the radius of a moment of friction, and this contact has none; give friction= too, or "
        "leave it out",
    ),
    (
        lambda: contact(friction=0.3, torsion=-0.02),
        taut.errors.RangeError,
        "contact.torsion must be >= 0 [m]; got -0.02",
    ),
    (
        lambda: rubbing(taut.Constraint.of_joints(lambda q: q[0], one_sided=True)),
        taut.errors.UsageError,
        NO_POINT.format("it is of joints"),
    ),
    (
        lambda: rubbing(taut.Constraint(lambda a, b: a.p[2] - 2.0 * b.p[2], frames=(None, None))),
        taut.errors.UsageError,
        NO_POINT.format("it is of several frames"),
    ),
    (
        lambda: rubbing(taut.Constraint.line(point=[0.0, 0.0, 0.0], axis=[1.0, 0.0, 0.0])),
        taut.errors.UsageError,
        NO_POINT.format("it has 2 rows"),
    ),
    (
        lambda: rubbing(taut.Constraint(lambda T: (T.R @ tm.array([0.1, 0.0, 0.0]) + T.p)[2], one_sided=True)),
        taut.errors.UsageError,
        NO_POINT.format("it depends on how the tool is turned"),
    ),
    (
        lambda: taut.RigidPlant(ARM, contact=contact(friction=0.3)).checked_parameter("contact.friction", -1.0),
        taut.errors.RangeError,
        "contact.friction must be >= 0 [1]; got -1.0",
    ),
    (
        lambda: run(taut.RigidPlant(ARM, contact=FLOOR), q0=[0.0, 0.0, -0.1]),
        taut.errors.RangeError,
        "a run must start where contact= lets the arm be, and the constraint has phi = -0.1 there, not phi >= 0; start "
        "from q0=taut.dynamics.onto(constraint, arm, q), the nearest state that keeps to it",
    ),
    (
        lambda: run(taut.RigidPlant(ARM, contact=(FLOOR, BOTH)), q0=[0.0, 0.0, 0.2]),
        taut.errors.RangeError,
        "a run must start where contact= lets the arm be, and row 1 of the constraint has phi = 0.2 there, not phi = 0; "
        "start from q0=taut.dynamics.onto(constraint, arm, q), the nearest state that keeps to it",
    ),
    (
        lambda: run(taut.RigidPlant(ARM, contact=BOTH), v0=[0.0, 0.0, -0.3]),
        taut.errors.RangeError,
        "a run must start with a motion that contact= allows, and at v0 the constraint has d phi/dt = -0.3; leave v0 "
        "out, or take from it what moves against the constraint",
    ),
    (
        lambda: run(taut.RigidPlant(ARM, contact=(BOTH, BOTH))),
        taut.errors.RangeError,
        "the 2 rows of the constraint must be independent",
    ),
    (
        lambda: run(taut.RigidPlant(ARM, contact=taut.Constraint(lambda T: T.p[0] ** 2))),
        taut.errors.RangeError,
        "row 0 of the constraint must have a gradient, and it is zero",
    ),
    (
        lambda: run(taut.RigidPlant(PLANAR, contact=taut.Constraint(lambda T: T.p[1]))),
        taut.errors.RangeError,
        "the joints of 'planar2' cannot press against each row of the constraint",
    ),
]


@pytest.mark.parametrize(("make", "error", "text"), CASES, ids=[str(k) for k in range(len(CASES))])
def test_what_cannot_be_is_told(make: Callable[[], object], error: type[Exception], text: str) -> None:
    with pytest.raises(error) as caught, np.errstate(all="ignore"):
        make()
    assert str(caught.value).startswith(text)
