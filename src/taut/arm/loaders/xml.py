"""A small, safe XML reader: elements with attributes, text and line numbers, and nothing else.

A document type, and with it every entity, is refused before it can expand; size, depth and elements are bounded.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.parsers import expat

from taut.base.checks import readable_file
from taut.base.errors import ModelError, Problem, printable

MAX_BYTES: Final = 4 * 2**20  # the largest robot description met so far has 0.2 MB and 4000 elements
MAX_ELEMENT_DEPTH: Final = 200  # elements inside elements
MAX_ELEMENTS: Final = 20_000
MAX_WORDS: Final = 10_000  # characters in one attribute that holds numbers
MAX_MAGNITUDE: Final = 1e9  # a length, mass or inertia beyond this is a slip, and its square may overflow

NO_XML: Final = "the file is not XML; a robot model begins with <robot> (URDF) or <mujoco> (MJCF)"

_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?\Z")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)(?:\(.*\))?\Z", re.IGNORECASE)


class BadNumberError(ValueError):
    """Text that should be numbers and is not; its message says what is wrong, without naming the place."""


@dataclass(frozen=True, slots=True)
class Element:
    """One element of a file: tag, attributes, what is inside, and where it begins."""

    tag: str
    attributes: Mapping[str, str]
    line: int
    file: str
    children: list[Element] = field(default_factory=list)
    text: list[str] = field(default_factory=list)

    def get(self, attribute: str) -> str | None:
        """The value of an attribute, or None."""
        return self.attributes.get(attribute)

    def all(self, tag: str) -> list[Element]:
        """The children of that tag."""
        return [child for child in self.children if child.tag == tag]

    def walk(self) -> Iterator[Element]:
        """This element and everything inside, in the order of the file; without recursion."""
        stack = [self]
        while stack:
            element = stack.pop()
            yield element
            stack.extend(reversed(element.children))


def numbers(text: str, count: int | None = None, *, bounded: bool = True) -> tuple[float, ...]:
    """The `count` numbers in an attribute, finite, and of a plausible size if `bounded`; raises BadNumberError."""
    if len(text) > MAX_WORDS:
        raise BadNumberError(f"must be {_amount(count)}; got {len(text)} characters")
    words = text.split()
    for word in words:
        if is_not_finite(word):
            raise BadNumberError(f"must be finite; got {_shown(text)}")
        if not _NUMBER.match(word):
            way_out = "; separate numbers by blanks" if "," in word or ";" in word else ""
            raise BadNumberError(f"must be {_amount(count)}; got {_shown(text)}{way_out}")
    if count is not None and len(words) != count:
        got = f"{len(words)} ({_shown(text)})" if words else "none"
        raise BadNumberError(f"must be {_amount(count)}; got {got}")
    values = tuple(float(word) for word in words)
    for value in values:
        if abs(value) > (MAX_MAGNITUDE if bounded else 1e300):
            rule = f"within +-{MAX_MAGNITUDE:g}" if bounded else "finite"
            raise BadNumberError(f"must be {rule}; got {_shown(text)}")
    return values


def is_not_finite(word: str) -> bool:
    """Whether a word spells NaN or an infinity."""
    return _NOT_FINITE.match(word) is not None


def _amount(count: int | None) -> str:
    if count is None:
        return "numbers"
    return "one number" if count == 1 else f"{count} numbers"


def _shown(text: str) -> str:
    text = " ".join(text.split())
    return repr(text if len(text) <= 60 else f"{text[:57]}...")


def read_xml(path: Path, kind: str = "model", shown: str | None = None) -> Element:
    """The root element of a file, which messages call a `kind` and `shown`. Raises FileError, ModelError."""
    file = readable_file(kind, path)
    with file.open("rb") as stream:
        data = stream.read(MAX_BYTES + 1)
    return parse_xml(data, str(path) if shown is None else shown)


def parse_xml(data: bytes, source: str) -> Element:
    """The root element of a document. Raises ModelError with a line."""
    if len(data) > MAX_BYTES:
        raise _refused(source, "size", f"the file is larger than {MAX_BYTES // 2**20} MB, the most that is read")
    if not data.strip():
        raise _refused(source, "content", "the file holds nothing but blanks", 1)
    if b"\0" in data and not data.startswith((b"\xff\xfe", b"\xfe\xff")):  # UTF-16 has them
        line = data[: data.index(b"\0")].count(b"\n") + 1
        raise _refused(source, "content", "the file holds a NUL byte; it is no text file, or damaged", line)
    reader = _Reader(source)
    try:
        reader.parser.Parse(data, True)
    except expat.ExpatError as cause:
        markup = data.lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n\0").startswith(b"<")
        text = _not_well_formed(cause, reader.open_tag) if markup else NO_XML
        raise _refused(source, "XML", text, cause.lineno) from cause
    except ModelError:
        raise
    except (ValueError, LookupError) as cause:
        text = f"its text cannot be decoded ({cause}); save the file as UTF-8"
        raise _refused(source, "encoding", text, 1) from cause
    assert reader.root is not None  # expat reports a document without an element
    return reader.root


def _not_well_formed(cause: expat.ExpatError, open_tag: str | None) -> str:
    """What expat found, in words."""
    inside = "" if open_tag is None else f" inside <{open_tag}>"
    return f"the XML is damaged{inside}: {expat.ErrorString(cause.code)}"


def _refused(source: str, attribute: str, message: str, line: int | None = None) -> ModelError:
    return ModelError(source, [Problem(object=Path(source).name, attribute=attribute, message=message, line=line)])


class _Reader:
    """The handlers of one parser, with the bounds."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._open: list[Element] = []
        self._count = 0
        self.root: Element | None = None
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters
        self.parser.StartDoctypeDeclHandler = self._doctype

    @property
    def open_tag(self) -> str | None:
        return self._open[-1].tag if self._open else None

    def _refuse(self, attribute: str, message: str) -> ModelError:
        return _refused(self._source, attribute, message, self.parser.CurrentLineNumber)

    def _doctype(self, *_: object) -> None:
        # Entities, internal or external, can only be declared here.
        raise self._refuse(
            "DOCTYPE", "it has a DOCTYPE, which can declare entities; a robot model needs none: delete it"
        )

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise self._refuse("elements", f"it has more than {MAX_ELEMENTS} elements, the most that is read")
        for name, value in ((tag, tag), *attributes.items()):
            if not f"{name}{value}".isprintable():
                hidden = next(letter for letter in f"{name}{value}" if not letter.isprintable())
                text = f"{printable(name)} of <{printable(tag)}> has the invisible character {hidden!a}; delete it"
                raise self._refuse(printable(name), text)
        if len(self._open) >= MAX_ELEMENT_DEPTH:
            raise self._refuse("depth", f"its elements are more than {MAX_ELEMENT_DEPTH} deep, the most that is read")
        element = Element(tag, attributes, self.parser.CurrentLineNumber, self._source)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)

    def _end(self, _tag: str) -> None:
        self._open.pop()

    def _characters(self, data: str) -> None:
        if data.strip():
            self._open[-1].text.append(data)
