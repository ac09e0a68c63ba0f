"""Which mesh files of a model may be shown: those inside the model's own folder or its catalogue's.

Meshes are decoration. Nothing here opens one, and a path that leads anywhere else is dropped with a note.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Final

__all__ = ["SHOWABLE", "MeshPaths", "OutsideError", "file_inside"]

SHOWABLE: Final = (".stl", ".obj")  # what MuJoCo can show
PACKAGE: Final = "package://"


class OutsideError(ValueError):
    """A name that leads out of its folder; the text completes "it ..."."""


class MeshPaths:
    """Resolves the mesh names of one model, and remembers why some were dropped.

    Args:
        folder: The folder of the model file; relative names start there.
        packages: Folders that stand for `package://NAME`.
    """

    def __init__(self, folder: Path, packages: Mapping[str, Path] | None = None) -> None:
        self._folder = folder
        self._packages = dict(packages or {})
        self._dropped: dict[str, list[str]] = {}

    def resolve(self, name: str) -> str:
        """The path of a mesh inside an allowed folder; "" where there is none."""
        try:
            return self._resolve(name)
        except (OSError, RuntimeError):  # too long, a loop of links, an odd character
            return self._drop("is no file name", name)

    def drop_unshowable(self, *names: str) -> None:
        """Remember the meshes of these that are of a type that cannot be shown."""
        for name in names:
            if PurePosixPath(name).suffix.lower() not in SHOWABLE:
                self._drop(f"is not {' or '.join(SHOWABLE)}", name)

    def notes(self) -> Iterator[str]:
        """What was dropped, one note for each reason."""
        for reason, names in self._dropped.items():
            more = f" ({len(names) - 1} more like it)" if len(names) > 1 else ""
            yield f"the mesh '{names[0]}' is not shown: it {reason}{more}"

    def _drop(self, reason: str, name: str) -> str:
        self._dropped.setdefault(reason, []).append(name if len(name) <= 60 else f"...{name[-57:]}")
        return ""

    def _resolve(self, name: str) -> str:
        root, path = self._folder, name
        if name.startswith(PACKAGE):
            package, _, path = name[len(PACKAGE) :].partition("/")
            if package not in self._packages:
                return self._drop("belongs to a package that is not known here", name)
            root = self._packages[package]
        try:
            file = file_inside(root, path)
        except OutsideError as reason:
            return self._drop(str(reason), name)
        return str(file) if file.is_file() else self._drop("is not there", name)


def file_inside(root: Path, name: str) -> Path:
    """The path of a file below `root`, given by a plain relative name; it need not exist.

    Raises:
        OutsideError: An address, an absolute path, `..`, or a link that leads out; the text says which.
    """
    if not name.isprintable() or any(character in name for character in ":\\"):
        raise OutsideError("is an address or an odd name, not a plain relative path")
    parts = PurePosixPath(name)
    if not name or parts.is_absolute() or ".." in parts.parts:
        raise OutsideError("leads out of the model's folder")
    root = root.resolve()
    file = (root / parts).resolve()  # follows links, so that one that leads outside shows
    if not file.is_relative_to(root):
        raise OutsideError("is a link that leads out of the model's folder")
    return file
