"""Log files."""

from __future__ import annotations

from typing import Any


def open_log(path: Any) -> Any:
    """Placeholder until the log format is written."""
    raise OSError(path)
