"""Models by the names of the package robot_descriptions, where that is installed; it downloads what it names."""

from __future__ import annotations

import importlib
import pkgutil
import re
from pathlib import Path
from types import ModuleType
from typing import Final

from taut.base.errors import FileError, MissingExtraError, unknown_name

__all__ = ["PATTERN", "described"]

PACKAGE: Final = "robot_descriptions"
PATTERN: Final = re.compile(r"[a-z0-9_]+_description\Z")


def described(name: str) -> tuple[Path, dict[str, Path]]:
    """The model file of that description, and the folders that stand for its package.

    Raises:
        MissingExtraError: robot_descriptions is not installed.
        UnknownNameError: It has no such description.
        FileError: The download failed, or the description has neither URDF nor MJCF.
    """
    try:
        package = importlib.import_module(PACKAGE)
    except ImportError as cause:
        raise MissingExtraError(
            f"the name '{name}' needs the package '{PACKAGE}', which is not installed; "
            f"pip install {PACKAGE} installs it, and taut arms lists the names that need no download",
            name=PACKAGE,
        ) from cause
    known = [module.name for module in pkgutil.iter_modules(package.__path__) if PATTERN.match(module.name)]
    if name not in known:
        raise unknown_name(PACKAGE, "description", name, known)
    module = _downloaded(name)
    for attribute in ("URDF_PATH", "MJCF_PATH"):
        path = getattr(module, attribute, None)
        if path is not None:
            folder = Path(getattr(module, "PACKAGE_PATH", Path(path).parent))
            return Path(path), {folder.name: folder}
    raise FileError(f"{PACKAGE} has neither URDF nor MJCF of '{name}'; name another description", name=name)


def _downloaded(name: str) -> ModuleType:
    try:
        return importlib.import_module(f"{PACKAGE}.{name}")
    except Exception as cause:  # it runs git, which fails in ways of its own
        said = next(iter(str(cause).strip().splitlines()), type(cause).__name__)
        raise FileError(
            f"{PACKAGE} could not supply '{name}': {said}; it downloads models: check the network, "
            "or give the path of a file",
            name=name,
        ) from cause
