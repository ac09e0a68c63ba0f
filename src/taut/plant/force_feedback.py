"""Stability of force feedback with one tick of delay on a rigid contact."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from taut.base.errors import RangeError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.describe import all_laws
from taut.control.lawside import LawSide
from taut.maths.snapshot import Snapshot, snapshot
from taut.plant.contact import Contacts
from taut.plant.drives.actuation import Actuation

__all__ = ["RigidTouch", "check_force_feedback"]

ROUNDING: Final = 1e-9  # of a loop gain


@runtime_checkable
class HasContacts(Protocol):
    """A plant that rigid contacts may hold."""

    @property
    def contacts(self) -> Contacts | None: ...

    @property
    def actuation(self) -> Actuation: ...


class RigidTouch:
    """A tool at a rigid contact, in plain numbers.

    Args:
        contacts: The contacts.
        q: (n,) where the arm is.
    """

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
        """The largest eigenvalue of (kfp + kfi dt / 2) P at a rigid contact; 0 where that is not known.

        Args:
            dt: Control period [s].
            touch: The contact; None for the one that the law states itself.
        """
        ...


def check_force_feedback(
    side: LawSide, plant: object, q: Float64Array | None = None, parameters: Mapping[str, Any] | None = None
) -> None:
    """Force feedback through ideal drives, unfiltered, must be stable on a rigid contact, where it is a tick late.

    F_app(t + dt) = P F(t) with F = ... - (kfp + kfi dt / 2) F_app(t): the largest eigenvalue of (kfp + kfi dt / 2) P
    must be under 1, where P is the part of a wrench that presses on the contact. For one number that is the number.

    Args:
        side: The law with its rate.
        plant: What it meets.
        q: (n,) where it meets it; without, only laws are checked that state the contact themselves.
        parameters: Its gains by path; those it was made with if left out.

    Raises:
        RangeError: It is unstable.
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
