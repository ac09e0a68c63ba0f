"""The cache of compiled code: found by the program's content, whole or not at all, never from a shared folder."""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Final

__all__ = ["cache_folder", "load", "store"]

MAGIC: Final = b"taut1\n"
DIGEST: Final = 32  # bytes of SHA-256
ENVIRONMENT: Final = "TAUT_CACHE_DIR"


def cache_folder() -> Path:
    """Where compiled code is kept; the variable TAUT_CACHE_DIR moves it."""
    given = os.environ.get(ENVIRONMENT)
    if given:
        return Path(given)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "taut" / "cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "taut"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "taut"


def _private(path: Path) -> bool:
    """Whether nobody else can write here: what is loaded from it will run."""
    if sys.platform == "win32":  # the folder stands in the user's own profile, with its access list
        return True
    info = path.lstat()
    mode = stat.S_IMODE(info.st_mode)
    ours = info.st_uid == os.getuid()
    return ours and not mode & (stat.S_IWGRP | stat.S_IWOTH) and not stat.S_ISLNK(info.st_mode)


def _usable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        usable = _private(folder)
    except OSError as cause:
        _warn_once(f"the cache folder '{folder}' cannot be used ({cause.strerror}); code is compiled each time")
        return False
    if not usable:
        _warn_once(
            f"the cache folder '{folder}' can be written by others, so no code is loaded from it; "
            f"chmod 700 it, or set {ENVIRONMENT}"
        )
    return usable


_WARNED: Final[set[str]] = set()


def _warn_once(text: str) -> None:
    if text not in _WARNED:
        _WARNED.add(text)
        warnings.warn(text, RuntimeWarning, stacklevel=4)


def load(key: bytes) -> bytes | None:
    """The entry of this key, or None where there is none that is whole and ours."""
    folder = cache_folder()
    if not folder.is_dir() or not _usable(folder):
        return None
    file = folder / key.hex()
    try:
        if not _private(file):
            return None
        data = file.read_bytes()
    except OSError:
        return None
    head = len(MAGIC) + DIGEST
    if not data.startswith(MAGIC) or hashlib.sha256(data[head:]).digest() != data[len(MAGIC) : head]:
        return None  # cut off or damaged: it is compiled again and replaced
    return data[head:]


def store(key: bytes, content: bytes) -> None:
    """Keep an entry. It appears whole or not at all, also with many processes at once."""
    folder = cache_folder()
    if not _usable(folder):
        return
    data = MAGIC + hashlib.sha256(content).digest() + content
    try:
        handle, name = tempfile.mkstemp(dir=folder, prefix="writing-")
    except OSError as cause:
        _warn_once(f"the cache folder '{folder}' cannot be written ({cause.strerror}); code is compiled each time")
        return
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        Path(name).replace(folder / key.hex())
    except OSError as cause:
        with contextlib.suppress(OSError):
            Path(name).unlink()
        _warn_once(f"the cache folder '{folder}' cannot be written ({cause.strerror}); code is compiled each time")
