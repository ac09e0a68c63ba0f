"""The texts of errors and warnings: tests assert what is refused; the words stand in messages.txt, which people read."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

MESSAGES = Path(__file__).with_name("messages.txt")
WRITE = os.environ.get("TAUT_MESSAGES") == "write"
# Words of Python and NumPy come after these, and differ by version.
FOREIGN = r"cannot be traced: \w+Error:|below the header,|is not what was written:"
said: dict[str, list[str]] = defaultdict(list)  # the texts of this session, by test
passed: set[str] = set()
current = ""  # the test that runs, set by conftest.py


def name_of(item: Any) -> str:
    return f"{item.path.stem}::{item.getmodpath()}"


class refused:  # noqa: N801 - used as pytest.raises is; no generator, whose frame would keep the error in a cycle
    """As pytest.raises; the text is the next one of this test in messages.txt."""

    def __init__(self, kind: Any) -> None:
        self._raises = pytest.raises(kind)

    def __enter__(self) -> pytest.ExceptionInfo[Any]:
        return self._raises.__enter__()

    def __exit__(self, *error: Any) -> bool:
        __tracebackhide__ = True
        stopped = self._raises.__exit__(*error)
        if stopped:
            assert_kept(error[1])
        return stopped


@contextmanager
def warned(kind: Any) -> Iterator[pytest.WarningsRecorder]:
    """As pytest.warns; the texts, each once, are the next ones of this test in messages.txt."""
    __tracebackhide__ = True
    with pytest.warns(kind) as told:
        yield told
    for message in {str(one.message): one.message for one in told if issubclass(one.category, kind)}.values():
        assert_kept(message)


def assert_kept(problem: BaseException) -> None:
    __tracebackhide__ = True
    text = portable(f"{type(problem).__name__}: {problem}")
    said[current].append(text)
    expected = kept().get(current, [])[len(said[current]) - 1 :]
    if not WRITE and [text] != expected[:1]:
        pytest.fail(f"{text}\nis not in messages.txt, but {expected[:1]}; TAUT_MESSAGES=write writes it anew")


def portable(text: str) -> str:
    """One line without what differs between machines: folders of tests, lines of code, digits beyond the fourth."""
    text = text.replace("\n", "\\n")
    text = re.sub(r"[^\s'\"]*/pytest-of-[^/]+/pytest-\d+(/popen-gw\d+)?(/[^\s/'\"]+\d)?", "TMP", text)
    text = re.sub(r"[^\s'\"(]*?(\w+\.py):\d+", r"\1:LINE", text)
    text = re.sub(r"127(\.\d+){3}", "127.0.0.1", text)
    text = re.sub(rf"({FOREIGN}) .*?(?= at |$)", r"\1 ...", text)
    return re.sub(r"\d+(\.\d+)?(e[-+]?\d+)?", lambda number: four_digits(number[0]), text)


def four_digits(number: str) -> str:
    if 0.0 < float(number) < 1e-12:
        return "0"  # what rounding left
    digits = number.partition("e")[0].replace(".", "").lstrip("0")
    return number if number.isdigit() or len(digits) <= 4 else f"{float(number):.4g}"


@cache
def kept() -> dict[str, list[str]]:
    blocks = MESSAGES.read_text(encoding="utf-8").strip().split("\n\n")
    return {test: texts for test, *texts in (block.split("\n    ") for block in blocks)}


def write(tests: set[str] | None) -> None:
    """The texts of this session instead of those of the tests that passed; where all tests are known, only theirs."""
    old = {test: texts for test, texts in kept().items() if test not in passed and (tests is None or test in tests)}
    new = old | said
    MESSAGES.write_text(
        "\n\n".join("\n    ".join([test, *new[test]]) for test in sorted(new)) + "\n", encoding="utf-8"
    )
