"""The words URDF knows, and the slips that look like them.

Vendors put elements and attributes of their own into URDF files, and those are fine. A misspelt known word is
not: left out, it would change the arm in silence.
"""

from __future__ import annotations

import difflib
from collections.abc import Container, Iterator
from typing import Final

from taut.arm.loaders.xml import Element

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
MAX_ATTRIBUTES: Final = 50  # an element with more is a vendor's own
LIKE: Final = 0.75  # difflib's ratio from which a word is taken for another


def slips(element: Element) -> Iterator[tuple[str, str, int]]:
    """Words in an element that are most likely misspelt: (word, sentence, line).

    Only where the known word itself is missing: `limits` beside a `limit` is a vendor's own.
    """
    tags = {child.tag: child.line for child in element.children}
    for tag, line in tags.items():
        like = _meant(tag, ELEMENTS.get(element.tag, ()), tags)
        if like is not None:
            yield tag, f"<{element.tag}> has an unknown <{tag}>; did you mean <{like}>?", line
    if len(element.attributes) > MAX_ATTRIBUTES:
        return
    for attribute in element.attributes:
        like = _meant(attribute, ATTRIBUTES.get(element.tag, ()), element.attributes)
        if like is not None:
            text = f"<{element.tag}> has an unknown attribute '{attribute}'; did you mean '{like}'?"
            yield attribute, text, element.line


def _meant(word: str, known: tuple[str, ...], present: Container[str]) -> str | None:
    if word in known:
        return None
    close = [other for other in known if sorted(other) == sorted(word.lower())]  # xzy for xyz
    close = close or difflib.get_close_matches(word.lower(), known, n=1, cutoff=LIKE)
    return close[0] if close and close[0] not in present else None
