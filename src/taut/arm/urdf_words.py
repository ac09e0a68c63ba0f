"""The words URDF knows, and the slips that look like them.

Vendors put elements and attributes of their own into URDF files, and those are fine. A misspelt known word is
not: left out, it would change the arm in silence.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from typing import Final

from taut.arm.xml import Element

__all__ = ["INERTIA", "slips"]

INERTIA: Final = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
ELEMENTS: Final = {
    "robot": ("link", "joint"),
    "link": ("inertial", "visual", "collision"),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
}
ATTRIBUTES: Final = {
    "link": ("name",),
    "joint": ("name", "type"),
    "origin": ("xyz", "rpy"),
    "mass": ("value",),
    "inertia": INERTIA,
    "parent": ("link",),
    "child": ("link",),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "velocity", "effort"),
    "dynamics": ("damping", "friction"),
    "mimic": ("joint", "multiplier", "offset"),
}
LIKE: Final = 0.75  # difflib's ratio from which a word is taken for another


def slips(element: Element) -> Iterator[tuple[str, str, int]]:
    """Words in an element that are most likely misspelt: (word, sentence, line).

    Only where the known word itself is missing: `limits` beside a `limit` is a vendor's own.
    """
    for child in element.children:
        like = _meant(child.tag, ELEMENTS.get(element.tag, ()), {other.tag for other in element.children})
        if like is not None:
            yield child.tag, f"<{element.tag}> has an unknown <{child.tag}>; did you mean <{like}>?", child.line
    for attribute in element.attributes:
        like = _meant(attribute, ATTRIBUTES.get(element.tag, ()), set(element.attributes))
        if like is not None:
            text = f"<{element.tag}> has an unknown attribute '{attribute}'; did you mean '{like}'?"
            yield attribute, text, element.line


def _meant(word: str, known: tuple[str, ...], present: set[str]) -> str | None:
    if word in known:
        return None
    close = [other for other in known if sorted(other) == sorted(word.lower())]  # xzy for xyz
    close = close or difflib.get_close_matches(word.lower(), known, n=1, cutoff=LIKE)
    return close[0] if close and close[0] not in present else None
