"""Files that come into being whole: written aside, then put in place."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from taut.base.errors import FileError, UsageError


def checked_target(kind: str, path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> Path:
    """A path to write a file of a kind to, with one of the suffixes (with their dots), in a folder that exists."""
    if not isinstance(path, (str, os.PathLike)):
        raise UsageError(f"the {kind} needs the path of a file; got {type(path).__name__}", name="path", value=path)
    file = Path(path)
    rule = " or ".join(suffixes)
    if file.suffix.lower() not in suffixes:
        got = f"'{file.name}'" if file.name else f"'{path}'"
        raise FileError(f"the {kind}'s name must end in {rule}; got {got}", name=str(file), rule=rule)
    if "\0" in str(file):
        raise FileError(f"{kind} {str(path)!r} is no name of a file; it holds a NUL character", name=str(file))
    if file.is_dir():
        raise FileError(f"{kind} '{file}' is a folder; name a file in it", name=str(file))
    if not file.parent.is_dir():
        raise FileError(
            f"{kind} '{file}' needs the folder '{file.parent}', which does not exist; create it first",
            name=str(file),
        )
    taken = file if file.exists() else file.parent
    if not os.access(taken, os.W_OK):
        raise FileError(f"{kind} '{file}' cannot be written; '{taken}' is read-only for you", name=str(file))
    return file


def cannot_write(kind: str, path: Path, cause: OSError) -> FileError:
    """The error for a file that could not be written, such as on a full disk."""
    reason = cause.strerror or str(cause)
    return FileError(f"{kind} '{path}' cannot be written: {reason}; choose another place", name=str(path))


@contextmanager
def written_aside(kind: str, path: Path) -> Iterator[Path]:
    """A file beside `path` to write to, which takes its place if all went well, and is removed if not."""
    aside = path.with_name(f".{path.stem}.{secrets.token_hex(6)}{path.suffix}")
    try:
        yield aside
        aside.replace(path)
    except OSError as cause:
        if isinstance(cause, FileError):
            raise
        raise cannot_write(kind, path, cause) from cause
    finally:
        with suppress(FileNotFoundError):
            aside.unlink()
