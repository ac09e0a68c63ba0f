"""Progress of long work, on a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from types import TracebackType
from typing import Any, Final, Self, TypeVar

SECONDS_BEFORE_SHOWN: Final = 1.0  # [s] before anything is shown

T = TypeVar("T")


class Progress:
    """A bar on standard error that appears when the work takes a while; by default (None) on a terminal only."""

    def __init__(self, total: int, show: bool | None, what: str = "simulating") -> None:
        self._total = total
        self._show = (sys.stderr is not None and sys.stderr.isatty()) if show is None else show
        self._what = what
        self._bar: Any = None
        self._task: Any = None
        self._since = time.monotonic()
        self._done = 0

    def __enter__(self) -> Self:
        return self

    def advance(self, steps: int) -> None:
        """Some more steps are done."""
        self._done += steps
        if not self._show or (self._bar is None and time.monotonic() - self._since < SECONDS_BEFORE_SHOWN):
            return
        try:
            self._draw()
        except (OSError, ValueError):  # standard error is closed, or a pipe that nobody reads: the work goes on
            self._show = False

    def _draw(self) -> None:
        if self._bar is None:
            from rich.console import Console
            from rich.progress import Progress as Bar
            from rich.progress import TextColumn

            speed = TextColumn("{task.fields[rate]}")
            self._bar = Bar(*Bar.get_default_columns(), speed, console=Console(stderr=True), transient=True)
            self._bar.start()
            self._task = self._bar.add_task(self._what, total=self._total, rate="")
        rate = self._done / max(time.monotonic() - self._since, 1e-9)
        self._bar.update(self._task, completed=self._done, rate=f"{rate:,.3g} a second")

    def over(self, items: Iterable[T]) -> Iterator[T]:
        """The items; each is a step that is done when the next one is asked for."""
        for item in items:
            yield item
            self.advance(1)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            with suppress(OSError, ValueError):
                self._bar.stop()
