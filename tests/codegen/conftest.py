"""Tests of codegen take code as users have it, at LLVM's full level."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from taut.codegen import native

FULL = native.LEVEL


@pytest.fixture(scope="module", autouse=True)
def full_code() -> Iterator[None]:
    """What the other tests make at the quick level is made well here."""
    before = native.LEVEL
    native.LEVEL = FULL  # type: ignore[misc]
    yield
    native.LEVEL = before  # type: ignore[misc]
