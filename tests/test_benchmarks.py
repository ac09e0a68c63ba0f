"""Benchmarks against peers: they compare before they time, and their page shows what a run recorded."""

from __future__ import annotations

import ast
import json
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

REPOSITORY = Path(__file__).parents[1]
PEERS = REPOSITORY / "benchmarks" / "peers"


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    """The driver with its modules, which later tests do not find."""
    path, known = list(sys.path), set(sys.modules)
    sys.path[:0] = [str(PEERS), str(PEERS.parent)]
    yield import_module("bench")
    sys.path[:] = path
    for name in set(sys.modules) - known:
        if "/benchmarks/" in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.fixture(scope="module")
def task(driver: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("task")
    driver.write_task(folder, chains=(2,))
    return folder


TICK = {"kind": "tick", "robot": "chain2"}


def test_each_peer_has_the_cases_it_is_asked_for(driver: Any) -> None:
    """Of peers that are not installed here too: what they import from the worker exists."""
    worker = import_module("worker")
    for name, peer in driver.PEERS.items():
        tree = ast.parse((PEERS / f"peer_{name}.py").read_text(encoding="utf-8"))
        imported = [x for x in ast.walk(tree) if isinstance(x, ast.ImportFrom) and x.module == "worker"]
        assert {alias.name for each in imported for alias in each.names} <= set(dir(worker))
        [cases] = [
            x.value for x in tree.body if isinstance(x, ast.Assign | ast.AnnAssign) and "CASES" in ast.unparse(x)
        ]
        assert isinstance(cases, ast.Dict)
        assert {ast.literal_eval(key) for key in cases.keys if key} == set(peer.kinds)


def test_a_peer_is_timed_only_when_it_computes_the_same(driver: Any, task: Path, tmp_path: Path) -> None:
    """Pinocchio in a process of its own: a tick, a loop, another gain, and a case that it does not have."""
    own = driver.Cases(driver.Task(task), driver.CASES)
    other = driver.Process(Path(sys.executable), "peer_pinocchio", task, ["pin"])
    for case, columns in ((TICK, 2), ({"kind": "loop", "robot": "chain2"}, 3)):
        row = driver.compared(own, other, case, 2)
        assert row["difference"] < 1e-12
        assert np.shape(row["seconds"]) == (2, columns)
        assert np.all(np.array(row["seconds"]) > 0.0)
    data = json.loads((task / "task.json").read_text()) | {"kp": 100.1}
    (tmp_path / "task.json").write_text(json.dumps(data))
    changed = driver.Cases(driver.Task(tmp_path), driver.CASES)
    assert "differs" in driver.compared(changed, other, TICK)["error"]
    assert "KeyError" in driver.compared(own, other, {"kind": "no such case"})["error"]
    other.stop()
    assert "ended" in driver.compared(own, other, TICK)["error"]


def test_a_peer_that_does_not_start_is_recorded_in_its_words(
    driver: Any, task: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver, "installed", lambda *_: Path(sys.executable))
    peer = driver.Peer("a stranger", {"nobody_has_this": "1.0"})
    found = driver.measured("no_such_file", peer, None, task)
    assert found["error"].startswith("ModuleNotFoundError")
    assert found["rows"] == []


def record() -> dict[str, Any]:
    """A small record with numbers that one can check by hand."""
    rng = np.random.default_rng(0)
    own = 1e-6 * (1.0 + 0.1 * rng.random(7))

    def row(case: dict[str, Any], *slower: float) -> dict[str, Any]:
        turns = np.column_stack([own * slower[0], *(own * slower[0] / factor for factor in slower)])
        ready = {"how": "f(x)", "first": 0.1, "difference": 2e-16, "mates": [{"kind": "m"}] * len(slower)}
        return {"case": case, **ready, "seconds": turns.tolist()}

    panda, chain = {"robot": "panda"}, {"robot": "chain30"}
    loops = [row({"kind": "loop", **panda}, 8.0, 100.0), row({"kind": "loop", **chain}, 0.5, 4.0)]
    names = ("double lanes over the scalar loop, one core", "float lanes over the scalar loop, one core")
    return {
        "machine": {
            "processor": "an x86-64", "cores": 2, "system": "Linux", "python": "3.11", "load": 0.1,
            "versions": {"taut": "1.0"},
        },
        "rounds": 7,
        "lanes": {"double": 4, "float": 8},
        "ratios": dict(zip((*names, "two threads over one"), (3.5, 6.0, 1.9), strict=True)),
        "speeds": {"double": 8.0, "double, two threads, wall": 15.0, "taut.run": 0.6},
        "laws": [["PID", 63, 0.05]],
        "joints": [[30, 16077, 1795, 122.0, 3.11]],
        "samples": [[1000, 0.25]],
        "million": [50.0, 180.0],
        "peers": {
            "pinocchio": {"title": "P", "packages": {"pin": "4.1.0"}, "rows": [row({"kind": "tick", **panda}, 12.0), *loops]},
            "mujoco": {"title": "M", "packages": {}, "rows": [{"case": {"kind": "tick", **panda}, "error": "Oh: no"}]},
            "jax": {"title": "J", "packages": {"jax": "9"}, "error": "ERROR: no wheel", "rows": []},
        },
    }  # fmt: skip


def cells(text: str, heading: str) -> list[list[str]]:
    """The first table under a heading, without its head."""
    lines = text.split(f"## {heading}\n")[1].strip().split("\n\n")[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_the_page_shows_what_was_recorded(driver: Any) -> None:
    page, found = import_module("page"), record()
    text = page.written(f"words\n{page.START}old{page.END}\nmore", found)
    assert text.startswith("words\n")
    assert text.endswith("\nmore")
    assert page.written(text, found) == text
    ticks = cells(text, "Computed torque, one tick")
    assert [row[0] for row in ticks] == ["P", "M"]
    assert float(ticks[0][4]) == pytest.approx(12.0)
    assert ticks[1][1] == "`Oh: no`"
    [loop] = cells(text, "One loop")
    assert [float(x) for x in loop[4].split(";")] == pytest.approx([8.0, 100.0])
    assert "`loop chain30` (0.50 of" in text
    assert [row[-1] for row in cells(text, "Versions")] == ["ran", "ran", "`ERROR: no wheel`"]


def test_targets_are_judged_by_their_figures(driver: Any) -> None:
    page, found = import_module("page"), record()
    median = 1e6 * np.median(np.array(found["peers"]["pinocchio"]["rows"][1]["seconds"])[:, 0])
    figures = {name: (value, sign, target) for name, value, sign, target in page.targets(found)}
    value, sign, target = figures["two threads over one process of P"]
    assert (sign, target) == (">=", 400.0)
    assert value == pytest.approx(15.0 * median)
    met = [row[-1] for row in cells(page.figures(found), "Targets")]
    assert met == ["yes", "**no**", "yes", "**no**", "**no**", "yes", "**no**"]
    found["lanes"]["double"] = 8
    assert [target for _, _, _, target in page.targets(found)][:2] == [4.8, 9.5]
