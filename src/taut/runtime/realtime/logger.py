"""The log process of a robot's loop: it copies rows from shared memory to MCAP files, and nothing waits for it.

Each stretch of ticks whose commands went out, or of a shadow, makes one file without gaps. What cannot be written
stays in the ring and is tried again, in another file; what is overwritten there by then is counted. Started as
`python -m taut.runtime.realtime.logger FD FOLDER`, and again where it dies: the ring outlives it.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import itertools
import os
import queue
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

import numpy as np
from numpy.typing import NDArray

from taut.base.types import Float64Array
from taut.codegen.servo_loop import STATUS, STATUS_WORDS
from taut.control.faults import CODES, Fault, fault_of
from taut.record.log.files import cannot_write
from taut.record.log.writing import CDR_HEAD, Header, Log, TickLayout
from taut.runtime.realtime.ring import DROPPED, ENDED, ERRNO, HEAD, LOGGER, SAFE, Ring, Rows, outcome_of
from taut.runtime.realtime.shared import Shared, environment

if TYPE_CHECKING:
    from taut.arm.description import Arm
    from taut.runtime.realtime.acting import Acting

PAUSE: Final = 0.02  # [s] between two looks at the rings
CHUNK_TIME: Final = 0.1  # [s] after which what has come is in the file
SYNCHRONISED: Final = 10  # chunks after which it is on the disk
AGAIN: Final = 0.1  # [s] after a refused write
IDLE: Final = 0.5  # [s] without a row after which a file ends
REFUSED: Final = 5.0  # [s] for a disk that refuses, once there are no more rows
RESTART: Final = 1.0  # [s] between two starts of the process
WATCH: Final = 0.05  # [s] between two looks of the parent at the process
LOG_CLOSING: Final = 10.0  # [s] for the log process to end
MAX_TITLE: Final = 60  # letters of a law in a file's name


@dataclass(frozen=True, kw_only=True, eq=False)
class Following:
    """A law whose ring is followed."""

    ring: str
    rows: Rows
    header: Header
    title: str
    shadow: bool
    status: str  # shared memory of the loop's state
    number: int  # of the law

    def meant(self, rows: Float64Array) -> NDArray[np.bool_]:
        """(k,) rows whose commands went out, or all of a shadow."""
        return (self.rows.column(rows, "loop.sent") > 0.5) | self.shadow

    def give_up(self, ring: Ring) -> None:
        """Count what has not been written as lost."""
        rows, lost = ring.read(int(ring.header[SAFE]), ring.capacity)
        ring.header[DROPPED] += lost + self.meant(rows).sum()
        ring.header[SAFE] = ring.header[HEAD]


class Book:
    """The log of one ring, in one file after the other."""

    def __init__(self, law: Following, folder: Path) -> None:
        self._law, self._folder, self.ring = law, folder, Ring.attach(law.ring)
        self._words, self._status = self.ring.header, np.zeros(STATUS_WORDS, dtype=np.int64)
        with contextlib.suppress(FileNotFoundError):  # the loop is gone
            self._status = Shared.attach(law.status).words
        self._words[LOGGER] = os.getpid()
        # Where the numbers of a message stand in a row: a row of these numbers is written as one. -1: nowhere, NaN.
        numbers = TickLayout(law.header).rows(law.rows.of_run(np.arange(float(self.ring.width))[None]))
        self._places = np.nan_to_num(np.frombuffer(numbers.tobytes()[len(CDR_HEAD) :]), nan=-1.0).astype(np.int64)
        self._next = self._head = int(self._words[SAFE])  # row to read; rows that have been seen
        self._moved = self._flushed = time.monotonic()
        self._again, self._chunks, self._orphan = 0.0, 0, False
        self._forget()

    def _forget(self) -> None:
        """There is no file now; the next one begins with the next row."""
        self._log: Log | None = None
        self._first, self._counts, self._fault = self._next, np.zeros(3), cast("Fault | None", None)

    def step(self, *, parent: bool) -> bool:
        """Copy what has come; False where no more will. `parent` is False where nobody ends rings any more."""
        now, ended, head = time.monotonic(), bool(self._words[ENDED]), int(self._words[HEAD])
        if now < self._again:
            return True
        if head > self._head:
            self._head, self._moved = head, now
        idle = now > self._moved + IDLE
        self._orphan = not (parent or ended)
        ended = ended or (idle and not parent)
        try:
            self._copy()
            if idle or ended:
                self._finish()
            elif self._log is not None and now > self._flushed + CHUNK_TIME:
                self._chunks += 1
                self._log.flush(to_disk=self._chunks % SYNCHRONISED == 0)
                self._flushed = now
            self._words[SAFE] = self._safe
        except OSError as cause:
            self._abandon(cause, now)
            if ended and now > self._moved + REFUSED:
                self._law.give_up(self.ring)
        return not (ended and self._words[SAFE] == self._words[HEAD])

    @property
    def _safe(self) -> int:
        """Rows that are in a file, or not meant for one, or lost."""
        return self._next if self._log is None else self._first + self._log.safe_ticks

    def _copy(self) -> None:
        rows, lost = self.ring.read(self._next, self.ring.capacity)
        if lost:
            self._finish()
            self._words[DROPPED] += lost
            self._words[SAFE] = self._next = self._next + lost
        meant = self._law.meant(rows)
        edges = [0, *(np.flatnonzero(np.diff(meant)) + 1).tolist(), len(rows)] if len(rows) else []
        for first, end in itertools.pairwise(edges):
            if meant[first : first + 1].any():
                self._append(rows[first:end])
            else:
                self._finish()
            self._next += end - first

    def _append(self, rows: Float64Array) -> None:
        if self._log is None:
            now = datetime.datetime.now()
            name = f"{now:%Y%m%d-%H%M%S}.{now.microsecond // 1000:03d}-{self._law.title}.mcap"
            self._first, self._log = self._next, Log(self._folder / name, mode="xb")
        t = self._law.rows.column(rows, "t")
        self._log.append(lambda: self._law.header, t, lambda _: self._messages(rows))
        self._counts += self._law.rows.counts(rows)
        self._fault = self._fault or self._law.rows.fault(rows)

    def _messages(self, rows: Float64Array) -> bytes:
        out = np.empty((len(rows), len(CDR_HEAD) + 8 * len(self._places)), dtype=np.uint8)
        out[:, : len(CDR_HEAD)] = np.frombuffer(CDR_HEAD, dtype=np.uint8)
        known = np.column_stack([rows, np.full(len(rows), np.nan)])
        out[:, len(CDR_HEAD) :] = np.take(known, self._places, axis=1).view(np.uint8)
        return out.tobytes()

    def _finish(self) -> None:
        """End the file, if there is one."""
        if self._log is not None:
            dropped, why = int(self._words[DROPPED]), int(self._words[ERRNO])
            outcome = outcome_of(self._counts, self._fault or self._of_driver(), dropped, why)
            if self._orphan and outcome.ok:
                outcome = replace(outcome, kind="stopped", message=f"its program was killed; {outcome.message}")
            self._log.finish(outcome)
            self._log.close()
            self._forget()

    def _of_driver(self) -> Fault | None:
        """The fault that ended the loop of this law: its rows know none of the driver and of the watchdog."""
        words = {name: int(self._status[STATUS[name]]) for name in ("fault", "control", "running", "ticks")}
        code = words["fault"] or CODES["process_died"] * words["control"]  # no more rows, and still in control
        return fault_of(code, words["ticks"]) if code and words["running"] == self._law.number else None

    def _abandon(self, cause: OSError, now: float) -> None:
        """Leave the file as it is; what is not safely in it goes into another one."""
        reason = cause.__cause__ if isinstance(cause.__cause__, OSError) else cause
        self._words[ERRNO] = reason.errno or errno.EIO
        self._words[SAFE] = self._next = self._safe
        self._again = now + AGAIN
        if self._log is not None:
            self._log.close()
            if self._log.safe_ticks == 0 and not isinstance(reason, FileExistsError):
                self._log.path.unlink(missing_ok=True)
            self._forget()


def log_folder(path: str | os.PathLike[str]) -> Path:
    """A folder for logs, made where it is not there. Raises FileError."""
    folder = Path(path).absolute()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as cause:
        raise cannot_write("log folder", folder, cause) from cause
    return folder


class LogProcess:
    """The parent's end of the log process, which it starts again where it dies."""

    def __init__(self, folder: Path, status: str) -> None:
        self._folder, self._status, self._closed = folder, status, False
        self._rings: list[Ring] = []
        self._followed: list[tuple[Ring, Following]] = []  # that are not done
        self._waiting: queue.SimpleQueue[tuple[Ring, Following]] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._watch, daemon=True, name="taut log")
        self._start()

    def _start(self) -> None:
        self._started = time.monotonic()
        ours, theirs = socket.socketpair()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "taut.runtime.realtime.logger", str(theirs.fileno()), str(self._folder)],
                pass_fds=[theirs.fileno()], env=environment(), stdin=subprocess.DEVNULL,
            )  # fmt: skip
        self._mail = Connection(ours.detach())

    def follow(self, acting: Acting, robot: str, arm: Arm, title: str) -> None:
        """Log a law, from its first tick on, until its ring has ended."""
        header = Header.of(acting.run(robot, arm, None, np.zeros((0, acting.ring.width))))
        title = re.sub("[^A-Za-z0-9]+", "_", title)[:MAX_TITLE]
        law = Following(
            ring=acting.ring.name, rows=acting.layout, header=header, title=title, shadow=not acting.sends,
            status=self._status, number=acting.number,
        )  # fmt: skip
        self._rings.append(acting.ring)
        self._waiting.put((acting.ring, law))  # the thread sends it: a process that is stalled takes nothing
        if not self._thread.is_alive():
            self._thread.start()
            end = time.monotonic() + LOG_CLOSING
            while acting.ring.header[LOGGER] == 0 and time.monotonic() < end:
                time.sleep(PAUSE)  # until it is there

    @property
    def dropped(self) -> int:
        """Ticks that are in no file, and will not be."""
        return sum(int(ring.header[DROPPED]) for ring in self._rings)

    def _watch(self) -> None:
        """Send what is to be followed, and start the process again where it died."""
        while not self._closed:
            new = []
            with contextlib.suppress(queue.Empty):
                new = [self._waiting.get(timeout=WATCH)]
            if self.process.poll() is not None and time.monotonic() > self._started + RESTART:
                self._mail.close()
                self._start()
                new, self._followed = [*self._not_done(), *new], []
            self._followed += new
            for _, law in new:
                with contextlib.suppress(OSError):  # it died: the next one is sent it again
                    self._mail.send(law)

    def _not_done(self) -> list[tuple[Ring, Following]]:
        return [(ring, law) for ring, law in self._followed if not ring.done]

    def close(self) -> None:
        """Let it write what there is, and end it; what a disk refuses until then is lost and counted."""
        self._closed = True
        if self._thread.is_alive():
            self._thread.join(LOG_CLOSING)
        while not self._waiting.empty():
            self._followed.append(self._waiting.get())
        for ring in self._rings:
            ring.header[ENDED] = 1
        self._mail.close()
        try:
            self.process.wait(LOG_CLOSING)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            for ring, law in self._not_done():
                law.give_up(ring)
        for _, law in self._not_done():  # it died
            book = Book(law, self._folder)
            while book.step(parent=False):
                time.sleep(PAUSE)


def main() -> None:
    """Log what the parent sends, until it is gone and all is written."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    mail, folder, parent = Connection(int(sys.argv[1])), Path(sys.argv[2]), True
    books = list[Book]()
    while parent or books:
        try:
            while parent and mail.poll(PAUSE):
                law = mail.recv()
                with contextlib.suppress(FileNotFoundError):  # a ring that is gone
                    books.append(Book(law, folder))
        except (EOFError, OSError):
            parent = False
        if not parent:
            time.sleep(PAUSE)
        books = [book for book in books if book.step(parent=parent)]


if __name__ == "__main__":
    main()
