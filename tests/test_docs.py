"""Everything documented is executed: Python blocks of the pages in order, commands, docstring examples."""

from __future__ import annotations

import doctest
import importlib
import importlib.util
import os
import pkgutil
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import matplotlib as mpl
import pytest

import taut
from taut.cli.main import main

ROOMS = ("analysis", "drives", "dynamics", "environments", "guards", "laws", "sensors", "trajectories")

REPOSITORY = Path(__file__).parents[1]
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
WHOLE = bool(os.environ.get("TAUT_BARS"))  # `make bars`
FILE = re.compile(r"# (\w+\.py)\n")  # begins a block that is a file of its own
BLOCK = re.compile(r"^```(python|console)\n(.*?)^```", re.MULTILINE | re.DOTALL)
mpl.use("Agg")


def blocks(page: Path, kind: str) -> list[str]:
    """Blocks of a page; those with torch and JAX where they are installed, as they are for `make test-extras`."""
    absent = [name for name in ("jax", "torch") if importlib.util.find_spec(name) is None]
    found = [text for word, text in BLOCK.findall(page.read_text(encoding="utf-8")) if word == kind]
    return [text for text in found if not any(f"import {name}" in text for name in absent)]


@pytest.mark.part(20)
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=lambda page: page.name)
def test_the_python_on_the_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # The blocks of a page are one file, so that units can be read from the comments of its laws.
    text = "\n".join(block for block in blocks(page, "python") if not FILE.match(block))
    for block in blocks(page, "python"):
        if name := FILE.match(block):
            (tmp_path / name[1]).write_text(block, encoding="utf-8")
    file = tmp_path / f"page_{page.stem.lower()}.py"
    file.write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.import_module(file.stem)


@pytest.mark.part(5)
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "console")], ids=lambda page: page.name)
def test_the_commands_on_the_page_succeed(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for line in "".join(blocks(page, "console")).splitlines():
        words = shlex.split(line.removeprefix("$ "))
        assert words[0] == "taut"
        assert main(words[1:]) == 0, line
        assert capsys.readouterr().out


def modules() -> list[str]:
    """All but front doors, whose names are tested where they are defined."""
    return sorted(
        module.name
        for module in pkgutil.walk_packages(taut.__path__, "taut.")
        if not module.name.endswith("__main__") and module.name.removeprefix("taut.") not in ROOMS
    )


@pytest.mark.parametrize("name", modules())
def test_the_examples_in_docstrings_give_what_they_say(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(name)
    result = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert result.failed == 0


@pytest.mark.long
def test_the_site_builds_without_warnings(tmp_path: Path) -> None:
    builder = "html" if WHOLE else "dummy"  # which reads and links all, and writes nothing
    sphinx = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going"]
    words = [*sphinx, "-b", builder, "docs", str(tmp_path / "site")]
    done = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "site" / "index.html").exists() == WHOLE


def test_the_law_in_the_readme_has_fewer_than_fifteen_lines() -> None:
    law = next(block for block in blocks(PAGES[0], "python") if block.startswith("class"))
    lines = [line for line in law.splitlines() if line.strip()]
    assert len(lines) < 15
    assert len(blocks(PAGES[0], "python")[0].splitlines()) <= 16


def test_every_page_is_in_the_index_and_every_front_door_in_the_api() -> None:
    index = (REPOSITORY / "docs" / "index.md").read_text(encoding="utf-8")
    for page in (REPOSITORY / "docs").glob("*.md"):
        assert page.stem == "index" or re.search(rf"^{page.stem}$", index, re.MULTILINE), page.stem
    doors = {f"taut.{name}" for name in taut.__all__ if isinstance(getattr(taut, name), ModuleType)} | {"taut"}
    pages = (REPOSITORY / "docs" / "api").glob("*.md")
    assert doors == {door for page in pages for door in re.findall(r"public-names:: (\S+)", page.read_text())}


def test_every_scenario_has_its_picture_in_the_gallery() -> None:
    for file in (REPOSITORY / "src" / "taut" / "scenarios" / "files").glob("*.toml"):
        assert (REPOSITORY / "docs" / "images" / f"{file.stem}.png").is_file(), file.stem


def test_what_took_the_place_of_a_renamed_name_is_there() -> None:
    page = (REPOSITORY / "docs" / "renamed.md").read_text(encoding="utf-8")
    now = "\n".join(line.partition(" | ")[2] for line in page.splitlines() if line.startswith("| "))
    doors = [taut, *(getattr(taut, name) for name in ROOMS)]
    public = {name: getattr(door, name) for door in doors for name in door.__all__}
    paths = [(taut, path[1:]) for path in re.findall(r"\btaut((?:\.\w+)+)", now)]
    paths += [(public.get(name), path) for name, path in re.findall(r"`([A-Z]\w+)\.(\w+)", now)]
    assert len(paths) > 100
    for thing, path in paths:
        for name in path.split("."):
            assert name in {*dir(thing), *getattr(thing, "__dataclass_fields__", {})}, path
            thing = getattr(thing, name, None)


START_EACH = """
import runpy, sys
for name in sys.argv[1:]:
    path = list(sys.path)
    runpy.run_path(name)
    sys.path[:] = path
    for key, module in list(sys.modules.items()):
        if "/tests/" in str(getattr(module, "__file__", "")):
            del sys.modules[key]
"""


def test_benchmarks_that_import_from_tests_start() -> None:
    """As a user starts them, without the folders that pytest adds; none leaves a path or a module to the next."""
    files = sorted((REPOSITORY / "benchmarks").glob("*.py"))
    names = [str(file) for file in files if '"tests"' in file.read_text(encoding="utf-8")]
    assert len(names) >= 5
    subprocess.run([sys.executable, "-c", START_EACH, *names], check=True, cwd=REPOSITORY / "benchmarks", timeout=100)
