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
        "constraint",
    ),
    (lambda: contact(friction=-0.1), taut.errors.RangeError, "friction"),
    (
        lambda: contact(friction=[0.1, 0.2]),
        taut.errors.ShapeError,
        "friction",
    ),
    (
        lambda: contact(restitution=1.2),
        taut.errors.RangeError,
        "restitution",
    ),
    (
        lambda: contact(BOTH, restitution=0.5),
        taut.errors.UsageError,
        "restitution",
    ),
    (
        lambda: taut.RigidPlant(ARM, contact=0.3),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "contact",
    ),
    (
        lambda: taut.RigidPlant(ARM, contact=()),
        taut.errors.UsageError,
        "contact",
    ),
    (
        lambda: taut.RigidPlant(ARM, contact=FLOOR, integrator="rk4"),
        taut.errors.UsageError,
        "integrator",
    ),
    (
        lambda: taut.RigidPlant(
            ARM, contact=FLOOR, takes="position", actuation=taut.drives.Actuation(bandwidth=50.0)
        ),
        taut.errors.UsageError,
        "contact",
    ),
    (
        lambda: taut.RigidPlant(ARM, contact=taut.Constraint(lambda T: T.p[2], frames=("gantry",))),
        taut.errors.UnknownNameError,
        "gantry",
    ),
    (
        lambda: rubbing(taut.Constraint.of_joints(lambda q: q[0], one_sided=True)),
        taut.errors.UsageError,
        "friction",
    ),
    (
        lambda: rubbing(taut.Constraint(lambda a, b: a.p[2] - 2.0 * b.p[2], frames=(None, None))),
        taut.errors.UsageError,
        "friction",
    ),
    (
        lambda: rubbing(taut.Constraint.line(point=[0.0, 0.0, 0.0], axis=[1.0, 0.0, 0.0])),
        taut.errors.UsageError,
        "friction",
    ),
    (
        lambda: rubbing(taut.Constraint(lambda T: (T.R @ tm.array([0.1, 0.0, 0.0]) + T.p)[2], one_sided=True)),
        taut.errors.UsageError,
        "friction",
    ),
    (
        lambda: taut.RigidPlant(ARM, contact=contact(friction=0.3)).checked_parameter("contact.friction", -1.0),
        taut.errors.RangeError,
        "contact.friction",
    ),
    (
        lambda: run(taut.RigidPlant(ARM, contact=FLOOR), q0=[0.0, 0.0, -0.1]),
        taut.errors.RangeError,
        "q0",
    ),
    (
        lambda: run(taut.RigidPlant(ARM, contact=(FLOOR, BOTH)), q0=[0.0, 0.0, 0.2]),
        taut.errors.RangeError,
        "q0",
    ),
    (
        lambda: run(taut.RigidPlant(ARM, contact=BOTH), v0=[0.0, 0.0, -0.3]),
        taut.errors.RangeError,
        "v0",
    ),
    (
        lambda: run(taut.RigidPlant(ARM, contact=(BOTH, BOTH))),
        taut.errors.RangeError,
        "constraint",
    ),
    (
        lambda: run(taut.RigidPlant(ARM, contact=taut.Constraint(lambda T: T.p[0] ** 2))),
        taut.errors.RangeError,
        "constraint",
    ),
    (
        lambda: run(taut.RigidPlant(PLANAR, contact=taut.Constraint(lambda T: T.p[1]))),
        taut.errors.RangeError,
        "constraint",
    ),
]


@pytest.mark.parametrize(("make", "error", "name"), CASES, ids=[str(k) for k in range(len(CASES))])
def test_what_cannot_be_is_told(make: Callable[[], object], error: type[taut.TautError], name: str) -> None:
    with pytest.raises(error) as caught, np.errstate(all="ignore"):
        make()
    assert caught.value.name == name
