"""Loss of contact: less force than counts as contact where more is asked for, and what laws of force do about it."""

from __future__ import annotations

from typing import Any, Final

from taut.trace import math as tm

__all__ = ["CONTACT", "E_INT_MAX", "PATIENCE", "counted", "misses", "taken_back"]

CONTACT: Final = (1.0, 0.1)  # [N, N m] that count as contact, where nothing else is said
PATIENCE: Final = 0.05  # [s] without it after which contact is lost, likewise
E_INT_MAX: Final = (20.0, 2.0)  # [N s, N m s] the bound of the integral of a force's error, likewise


def misses(asked: Any, along: Any, least: Any) -> Any:
    """1 where more than `least` is asked for and less is there along it, else 0.

    Args:
        asked: The size of what is asked for [N, N m].
        along: What is there times what is asked for, as a dot product.
        least: What counts as contact.
    """
    return tm.where(asked > least, tm.where(along < least * asked, 1.0, 0.0), 0.0)


def counted(alone: Any, missing: Any, patience: Any, dt: Any) -> dict[str, object]:
    """Memory `alone`, how long contact has been missing [s], and `lost`, 1 where that is longer than the patience."""
    alone = tm.where(missing > 0.5, alone + dt, 0.0)
    return {"alone": alone, "lost": tm.where(alone > patience + 0.5 * dt, 1.0, 0.0)}


def taken_back(share: Any, missing: Any, patience: Any, dt: Any) -> Any:
    """The share of a force that is applied: it falls to 0 within the patience while contact misses, and rises so."""
    step = dt / tm.maximum(patience, dt)
    return tm.clip(share + tm.where(missing > 0.5, -step, step), 0.0, 1.0)
