"""What all tests share."""

from __future__ import annotations

import gc
import hashlib
import json
import os
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

# Before NumPy is loaded: on busy cores the threads of a 3 x 3 product wait for each other, expm takes 10 ms, not 10 us.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import refusals

from taut.codegen import native
from taut.record.metrics import METRICS

gc.set_threshold(100_000, 20, 50)  # traces make many objects and few circles: a twentieth of the time goes otherwise
WHOLE = bool(os.environ.get("TAUT_BARS"))  # `make bars`
SLOW = Path(__file__).with_name("slow.txt")  # tests that take 0.6 s or more, where two run on two cores of 2026
DRAWN = 256 // 8  # of 256: an eighth of them, drawn by their names, runs in `make test`
BAR = "bar: "  # begins the names of properties that stand in the table of `make bars`

Bar = Callable[[str, object], None]


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compiled code goes into a folder of this test session, so that every law is compiled and verified anew."""
    base = (
        tmp_path_factory.getbasetemp()
    )  # of a process of its own in a folder of the session, where there are several
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "compiled"
    folder.mkdir(mode=0o700, exist_ok=True)
    os.environ["TAUT_CACHE_DIR"] = str(folder)
    return folder


@pytest.fixture(scope="session", autouse=True)
def quick_code() -> None:
    """Code is made at LLVM's quick level, in a fifth of the time: it gives the same numbers to the last bit.

    The tests of codegen, which show that, and `make bars` make it as users have it.
    """
    if not WHOLE:
        native.LEVEL = native.QUICK  # type: ignore[misc]  # which nothing but tests changes


@pytest.fixture(autouse=True)
def only_our_metrics() -> Iterator[None]:
    """The metrics that a test declares, as a user's file does, are gone after it."""
    before = dict(METRICS)
    yield
    METRICS.clear()
    METRICS.update(before)


@pytest.fixture(scope="session")
def share() -> Callable[[int], int]:
    """How many of n cases to take: all in `make bars`, else a twentieth."""
    return lambda n: n if WHOLE else max(1, n // 20)


@pytest.fixture
def bar(record_property: Callable[[str, object], None]) -> Bar:
    """Writes a figure into the table of `make bars`: bar("what was counted", figure)."""
    return lambda name, figure: record_property(BAR + name, figure)


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    left, slow = set(left_out(items)), set(SLOW.read_text(encoding="utf-8").split())
    for item in items:
        if "share" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.bars)
        name = item.nodeid.removeprefix("tests/").partition("[")[0]
        if name in slow and hashlib.sha256(name.encode()).digest()[0] >= DRAWN:
            item.add_marker(pytest.mark.long)
        if not WHOLE and (item.get_closest_marker("long") or item in left):
            item.add_marker(pytest.mark.skip(reason="make bars runs it"))


def left_out(items: list[pytest.Item]) -> Iterator[pytest.Item]:
    """Of the cases of a test marked `part(n)`, all but n: a draw by their names."""
    cases: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        if item.get_closest_marker("part") and not item.get_closest_marker("long"):
            cases[item.nodeid.partition("[")[0]].append(item)
    for some in cases.values():
        some.sort(key=lambda item: hashlib.sha256(item.nodeid.encode()).digest())
        yield from some[some[0].get_closest_marker("part").args[0] :]


def pytest_collection_finish() -> None:
    """Tests and modules stay: the collector need not look at them again."""
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    refusals.current = refusals.name_of(item)


def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> None:
    if call.when == "call" and call.excinfo is None:
        refusals.passed.add(refusals.name_of(item))


def pytest_sessionfinish(session: pytest.Session) -> None:
    if refusals.WRITE:
        config = session.config
        whole = config.args_source is config.ArgsSource.TESTPATHS and not (
            config.option.keyword or config.option.markexpr
        )
        refusals.write({refusals.name_of(item) for item in session.items} if whole else None)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """The table of `make bars`, also in out/bars.json."""
    if not WHOLE:
        return
    found: dict[str, object] = {}
    for report in terminalreporter.getreports("passed"):
        for name, figure in report.user_properties:
            if name.startswith(BAR):
                found[name.removeprefix(BAR)] = figure
    terminalreporter.write_sep("=", "bars")
    for name, figure in sorted(found.items()):
        terminalreporter.write_line(f"{name:<80} {figure}")
    out = Path("out")
    out.mkdir(exist_ok=True)
    (out / "bars.json").write_text(json.dumps(dict(sorted(found.items())), indent=1), encoding="utf-8")
    terminalreporter.write_line(f"figures in {out / 'bars.json'}")
