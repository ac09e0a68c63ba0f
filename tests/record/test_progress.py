"""Progress of long work: shown on a terminal when it takes a while, silent otherwise."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.record import film, progress, render


class Terminal(io.StringIO):
    """A standard error that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands until it is set."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize(
    ("terminal", "show", "seconds", "shown"),
    [(True, None, 2.0, True), (True, None, 0.5, False), (True, False, 2.0, False), (False, None, 2.0, False)],
    ids=["long", "short", "switched off", "no terminal"],
)
def test_a_bar_appears_on_a_terminal_after_a_second(
    clock: list[float],
    monkeypatch: pytest.MonkeyPatch,
    terminal: bool,
    show: bool | None,
    seconds: float,
    shown: bool,
) -> None:
    said = Terminal() if terminal else io.StringIO()
    monkeypatch.setattr("sys.stderr", said)
    monkeypatch.setenv("TERM", "xterm")
    with progress.Progress(10, show, "drawing") as bar:
        bar.advance(3)
        clock[0] += seconds
        bar.advance(4)
    assert ("drawing" in said.getvalue()) == shown
    assert ("70%" in said.getvalue()) == shown
    assert bool(said.getvalue()) == shown


def test_without_a_standard_error_nothing_is_shown(clock: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", None)
    with progress.Progress(2, None) as bar:
        clock[0] += 5.0
        bar.advance(2)


class Counting(progress.Progress):
    """Remembers what it was told."""

    made: list[Counting] = []  # noqa: RUF012

    def __init__(self, total: int, show: bool | None, what: str = "") -> None:
        super().__init__(total, False, what)
        self.total, self.asked, self.what, self.steps = total, show, what, []
        Counting.made.append(self)

    def advance(self, steps: int) -> None:
        self.steps.append(steps)


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[Counting]:
    monkeypatch.setattr(film, "Progress", Counting)
    monkeypatch.setattr(Counting, "made", [])
    return Counting.made


def test_a_film_shows_progress_picture_by_picture(
    make_run: Any, tmp_path: Path, counted: list[Counting], monkeypatch: pytest.MonkeyPatch
) -> None:
    blank = (np.zeros((32, 32, 3), dtype=np.uint8) for _ in range(10))
    monkeypatch.setattr(render, "opened", lambda *_: contextlib.nullcontext(blank))
    arm = taut.load_arm("one_joint")
    run = make_run(np.arange(100) * 0.01, np.zeros((100, 1)), arm=arm, joint_names=arm.joint_names)
    run.video(tmp_path / "run.gif", fps=10, size=(32, 32))
    (bar,) = counted
    assert (bar.total, bar.asked, bar.what, bar.steps) == (10, None, "drawing", [1] * 10)
