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

MAGIC: Final = b"taut2\n"  # then a digest of the rest: the key, and the content
DIGEST: Final = 32  # bytes of SHA-256
ENVIRONMENT: Final = "TAUT_CACHE_DIR"


def cache_folder() -> Path:
    """Where compiled code is kept; the variable TAUT_CACHE_DIR moves it."""
    given = os.environ.get(ENVIRONMENT)
    if given:
        return Path(given).expanduser()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "taut" / "cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "taut"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "taut"


def _private(info: os.stat_result) -> bool:
    """Whether nobody else can write a file or folder: what is loaded from it will run."""
    if sys.platform == "win32":  # the folder stands in the user's own profile, with its access list
        return True
    return info.st_uid == os.getuid() and not info.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _usable_folder(*, make: bool) -> Path | None:
    """The folder, if it is there and ours alone; otherwise one warning says why not."""
    try:
        folder = cache_folder()
        if not folder.exists():
            if not make:
                return None
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        info = folder.stat()
    except (OSError, RuntimeError) as cause:  # RuntimeError: a user without a home folder
        _warn_once(f"the cache folder{_named(cause)} cannot be used ({_reason(cause)}); code is compiled each time")
        return None
    if not stat.S_ISDIR(info.st_mode):
        _warn_once(f"the cache folder '{folder}' is no folder; code is compiled each time; set {ENVIRONMENT}")
        return None
    if not _private(info):
        _warn_once(
            f"the cache folder '{folder}' can be written by others, so no code is loaded from it; "
            f"chmod 700 it, or set {ENVIRONMENT}"
        )
        return None
    return folder


def _named(cause: Exception) -> str:
    return f" '{cause.filename}'" if isinstance(cause, OSError) and cause.filename else ""


def _reason(cause: Exception) -> str:
    return str((cause.strerror if isinstance(cause, OSError) else None) or cause)


_WARNED: Final[set[str]] = set()


def _warn_once(text: str) -> None:
    if text not in _WARNED:
        _WARNED.add(text)
        warnings.warn(text, RuntimeWarning, stacklevel=4)


def load(key: bytes) -> bytes | None:
    """The entry of this key, or None where there is none that is whole, ours, and stored under this key."""
    folder = _usable_folder(make=False)
    if folder is None:
        return None
    try:
        with (folder / key.hex()).open("rb") as file:
            if not _private(os.fstat(file.fileno())):
                return None
            data = file.read()
    except OSError:
        return None
    head = len(MAGIC) + DIGEST
    if not data.startswith(MAGIC) or hashlib.sha256(data[head:]).digest() != data[len(MAGIC) : head]:
        return None  # cut off or damaged: it is compiled again and replaced
    if not data.startswith(key, head):
        return None  # the entry of another key, copied to this name
    return data[head + len(key) :]


def store(key: bytes, content: bytes) -> None:
    """Keep an entry. It appears whole or not at all, also with many processes at once."""
    folder = _usable_folder(make=True)
    if folder is None:
        return
    body = key + content
    data = MAGIC + hashlib.sha256(body).digest() + body
    name: str | None = None
    try:
        handle, name = tempfile.mkstemp(dir=folder, prefix="writing-")
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        Path(name).replace(folder / key.hex())
    except OSError as cause:
        if name is not None:
            with contextlib.suppress(OSError):
                Path(name).unlink()
        _warn_once(f"the cache folder '{folder}' cannot be written ({_reason(cause)}); code is compiled each time")
