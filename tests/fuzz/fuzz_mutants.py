"""Mutants of files: of their bytes, of their words and numbers, and of what they mean."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable, Iterator
from typing import Any
from xml.etree import ElementTree

from numpy.random import Generator

NUMBERS = (
    *(
        "0",
        "-0.0",
        "-1",
        "1e-320",
        "1e-300",
        "1e-12",
        "1e6",
        "1e8",
        "9e9",
        "1e16",
        "1e300",
        "1e308",
        "1e999",
        "-1e300",
    ),
    *("nan", "inf", "-inf", "1_0", "0x10", "1e", "..", "2147483648", "18446744073709551616", "1" * 400, "true", "''"),
)
TEXTS = (
    "",
    " ",
    "\x1b]0;x\x07",
    "\u202eabc",
    "\x9b31m",
    "a" * 5000,
    "../../x",
    "\0",
    "${x}",
    "\U0001f600",
    "é",
    "x\ny",
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 2**62, 10**30, 0.0, 1e-320, 1e-300, -1e300, 1e308, float("nan"), float("inf")),
    *("", "x", "\x1b[2J", "\u202e", "home", "none", "a" * 3000),
    *([], {}, [[]], [0] * 1000, [1, [2]], {"a": {"b": []}}, [None], ["x"]),
)
NUMBER = re.compile(rb"[-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?")
WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]*")


def mutated(data: bytes, meaning: Callable[[bytes, Generator], bytes], rng: Generator) -> bytes:
    """A mutant: bytes, words or meaning are changed, sometimes more than once."""
    kinds = (_of_bytes, _of_words, meaning)
    for _ in range(int(rng.choice([1, 1, 1, 1, 2, 4]))):
        data = kinds[int(rng.choice(3, p=[0.25, 0.35, 0.4]))](data, rng)
    return data


def _of_bytes(data: bytes, rng: Generator) -> bytes:
    out = bytearray(data)
    if not out:
        return bytes(rng.integers(0, 256, 8, dtype="u1"))
    at, size = int(rng.integers(len(out))), int(rng.integers(1, 64))
    kind = int(rng.integers(7))
    if kind == 0:
        out[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        out[at] = int(rng.integers(256))
    elif kind == 2:
        del out[at : at + size]
    elif kind == 3:
        out[at:at] = rng.integers(0, 256, size, dtype="u1").tobytes()
    elif kind == 4:
        out[at:at] = out[at : at + size] * int(rng.integers(1, 50))
    elif kind == 5:
        del out[at:]
    else:
        other = int(rng.integers(len(out)))
        out[at : at + size] = out[other : other + size]
    return bytes(out)


def _of_words(data: bytes, rng: Generator) -> bytes:
    kind = int(rng.integers(4))
    found = list((WORD if kind == 3 else NUMBER).finditer(data))
    if not found:
        return _of_bytes(data, rng)
    one, other = found[int(rng.integers(len(found)))], found[int(rng.integers(len(found)))]
    if kind in (0, 1):
        new = str(rng.choice(NUMBERS)).encode()
    elif kind == 2:
        new = repr(float(one[0]) * 10.0 ** float(rng.uniform(-12, 12))).encode()
    else:
        new = other[0] if rng.random() < 0.6 else str(rng.choice(TEXTS)).encode("utf-8", "surrogatepass")
    return data[: one.start()] + new + data[one.end() :]


def of_xml(data: bytes, rng: Generator) -> bytes:
    """Elements and attributes deleted, doubled, moved, nested, renamed, with other values."""
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError):
        return _of_words(data, rng)
    parents = [(parent, child) for parent in root.iter() for child in parent]
    if not parents:
        return _of_words(data, rng)
    parent, child = parents[int(rng.integers(len(parents)))]
    other = parents[int(rng.integers(len(parents)))][1]
    kind = int(rng.integers(9))
    names = list(child.attrib)
    if kind == 0:
        parent.remove(child)
    elif kind == 1:
        parent.extend([copy.deepcopy(child)] * int(rng.choice([1, 2, 30])))
    elif kind == 2:
        other.append(copy.deepcopy(child))
    elif kind == 3:
        inner = child
        for _ in range(int(rng.choice([2, 50, 300]))):
            inner = ElementTree.SubElement(inner, child.tag, child.attrib)
    elif kind == 4:
        child.tag = other.tag
    elif not names:
        child.set("name", "x")
    else:
        name = names[int(rng.integers(len(names)))]
        if kind == 5:
            del child.attrib[name]
        elif kind == 6:
            values = child.attrib[name].split() or [""]
            values[int(rng.integers(len(values)))] = str(rng.choice(NUMBERS))
            child.set(name, " ".join(values))
        elif kind == 7:
            words = [each.attrib[key] for each in root.iter() for key in each.attrib]
            child.set(name, words[int(rng.integers(len(words)))])
        else:
            child.set(name, re.sub("[\0-\x08\x0b-\x1f]", "", str(rng.choice(TEXTS))))
    return ElementTree.tostring(root)


def places(values: Any) -> Iterator[tuple[Any, Any]]:
    """Every table or list in plain values, with each key or index in it."""
    for key in list(values) if isinstance(values, dict) else range(len(values)) if isinstance(values, list) else ():
        yield values, key
        yield from places(values[key])


def of_values(values: Any, rng: Generator) -> Any:
    """Plain values with one of them changed in place: deleted, doubled, swapped, nested, of another type or size."""
    found = list(places(values))
    if not found:
        return copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])
    where, key = found[int(rng.integers(len(found)))]
    other, its = found[int(rng.integers(len(found)))]
    kind = int(rng.integers(7))
    if kind == 0:
        del where[key]
    elif kind == 1:
        where[key] = copy.deepcopy(other[its])
    elif kind == 2 and isinstance(where, list):
        where.extend([copy.deepcopy(where[key])] * int(rng.choice([1, 7])))
    elif kind == 3 and isinstance(where, dict):
        where[str(rng.choice([*TEXTS, key + "_", key.upper()]))] = where.pop(key)
    elif kind == 4:
        for _ in range(int(rng.choice([1, 20]))):
            where[key] = [where[key]] if rng.random() < 0.5 else {"x": where[key]}
    elif kind == 5 and isinstance(where[key], (int, float)):
        where[key] = where[key] * 10.0 ** float(rng.uniform(-12, 12))
    else:
        where[key] = copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])
    return values


def of_json(data: bytes, rng: Generator) -> bytes:
    """JSON of other values."""
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        return _of_words(data, rng)
    return json.dumps(of_values(values, rng)).encode()


def of_toml(data: bytes, rng: Generator) -> bytes:
    """TOML of other values."""
    import tomllib

    try:
        values = tomllib.loads(data.decode())
    except (ValueError, RecursionError):
        return _of_words(data, rng)
    changed = of_values(values, rng)
    text = "\n".join(f"{json.dumps(key)} = {_toml(value)}" for key, value in changed.items() if value is not None)
    return text.encode("utf-8", "surrogatepass") if isinstance(changed, dict) else data


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(each) for each in value if each is not None) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value)


def of_rows(data: bytes, rng: Generator) -> bytes:
    """A CSV table with rows and columns deleted, doubled, swapped."""
    rows = [line.split(b",") for line in data.split(b"\n")]
    i, j = int(rng.integers(len(rows))), int(rng.integers(len(rows)))
    kind = int(rng.integers(5))
    if kind == 0:
        del rows[i]
    elif kind == 1:
        rows[i:i] = [rows[j]] * int(rng.choice([1, 40]))
    elif kind == 2:
        rows[i], rows[j] = rows[j], rows[i]
    elif kind == 3:
        rows[i] = rows[i] * int(rng.choice([0, 2, 30]))
    else:
        k = int(rng.integers(len(rows[0]))) if rows else 0
        rows = [row[:k] + row[k + 1 :] for row in rows]
    return b"\n".join(b",".join(row) for row in rows)
