"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compiled code goes into a folder of this test session, so that every law is compiled and verified anew."""
    folder = tmp_path_factory.getbasetemp().parent / "compiled"
    folder.mkdir(mode=0o700, exist_ok=True)
    os.environ["TAUT_CACHE_DIR"] = str(folder)
    return folder
