"""Forces that are fed back a tick late on a rigid contact: where they swing up."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from taut.base.errors import RangeError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.describe import all_laws
from taut.control.laws.force import ForceControl
from taut.control.laws.hybrid import HybridMotionForce
from taut.control.lawside import LawSide
from taut.maths.snapshot import Snapshot, snapshot
from taut.plant.contact import Contacts
from taut.plant.drives.actuation import Actuation

__all__ = ["check_swing"]


@runtime_checkable
class HasContacts(Protocol):
    """A plant that rigid contacts may hold."""

    @property
    def contacts(self) -> Contacts | None: ...

    @property
    def actuation(self) -> Actuation: ...


def check_swing(
    side: LawSide, plant: object, q: Float64Array | None = None, parameters: Mapping[str, Any] | None = None
) -> None:
    """A force that is fed back a tick late through ideal drives, unfiltered, swings up on a rigid contact.

    F_app(t + dt) = P F(t) with F = ... - (kfp + kfi dt / 2) F_app(t): the largest eigenvalue of (kfp + kfi dt / 2) P
    must be under 1, where P is what of a wrench presses against the contact. For one number that is the number.

    Args:
        side: The law with its rate.
        plant: What it meets.
        q: (n,) where it meets it; without, only laws are checked that state the contact themselves.
        parameters: Its gains by path; those it was made with if left out.

    Raises:
        RangeError: It does.
    """
    if not isinstance(plant, HasContacts) or plant.contacts is None or plant.actuation.acts:
        return
    if side.sensing.F_ext is not None or side.sensing.tau_meas is not None:
        return
    whole = side.law if parameters is None else side.law.bound(subtree(parameters, "law"))
    for path, law in all_laws(whole, "law"):
        swing = 0.0
        if isinstance(law, HybridMotionForce):
            swing = law.swing(side.dt)
        elif isinstance(law, ForceControl) and q is not None and side.arm.n >= 6:
            x = snapshot(plant.contacts.arm, q)
            swing = law.swing(side.dt, x, _pressing(plant.contacts, x, law.tool))
        if swing >= 1.0 - 1e-9:
            raise RangeError(
                f"kfp + kfi dt / 2 must be under 1 on a rigid contact, where the measured force is a tick old, or it "
                f"swings up; {path} has {swing:.4g}; lower kfp, or filter what is measured",
                name=f"{path}.kfp",
                value=swing,
                rule="< 1",
            )


def _pressing(contacts: Contacts, x: Snapshot, tool: str | None) -> Float64Array:
    """(6, 6) what of a wrench at a tool stands against the contacts: A^T (A Lambda^-1 A^T)^-1 A Lambda^-1."""
    J = np.asarray(x.J(tool), dtype=np.float64)
    A = np.vstack([np.asarray(part.constraint.at(x).A_q, dtype=np.float64) for part in contacts.parts])
    A = A @ np.linalg.pinv(J)
    W = A @ J @ np.linalg.solve(np.asarray(x.M), J.T)
    out: Float64Array = A.T @ np.linalg.lstsq(W @ A.T, W, rcond=None)[0]
    return out
