"""The log process: what it writes of a ring, whatever kills it and whatever the disk does, is exact or counted."""

from __future__ import annotations

import contextlib
import functools
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.codegen.servo_loop import STATUS, STATUS_WORDS
from taut.control.faults import CODES
from taut.control.safety import SafeSide
from taut.record.log.reading import intact_parts
from taut.runtime.realtime import logger
from taut.runtime.realtime.acting import Acting
from taut.runtime.realtime.logger import LogProcess
from taut.runtime.realtime.ring import HEAD, Ring
from taut.runtime.realtime.robot import HOLD
from taut.runtime.realtime.sets import ServoSet
from taut.runtime.realtime.shared import Shared

SMALL = 400  # rows of a ring that overflows soon
SOON = 20.0  # [s] for what happens within milliseconds on a machine that does nothing else


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + SOON
    while not condition():
        assert time.monotonic() < end
        time.sleep(2e-3)


@functools.cache
def servo_set() -> ServoSet:
    arm = taut.load_arm("planar2")
    side = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm).side
    return ServoSet(SafeSide(side=side, limits=taut.SafetyLimits.of(arm), measures=("v",)))


class Loop:
    """A loop that writes rows into a ring as the native one does, when it is asked to."""

    def __init__(self, folder: Path, capacity: int) -> None:
        made = servo_set()
        self.arm = made.safe.side.arm
        self.acting = Acting(made, HOLD, {}, number=1, sends=True, over=0.1)
        self.acting.ring.close()
        self.ring = self.acting.ring = Ring.create(capacity, made.row_size)
        self.folder, self.rng = folder, np.random.default_rng(0)
        self.rows = np.zeros((0, made.row_size))
        self.read: dict[Path, tuple[int, list[taut.Run]]] = {}
        self.closed = False
        self.status = Shared.create(STATUS_WORDS)
        self.log = LogProcess(logger.log_folder(folder), self.status.name)
        self.log.follow(self.acting, "loop", self.arm, "Computed torque")

    def tick(self, count: int, *, sent: bool = True, fault: float = 0.0) -> None:
        rows = self.rng.standard_normal((count, self.ring.width))
        head = len(self.rows)
        for path, values in (
            ("loop.tick", np.arange(head, head + count)), ("t", 0.001 * np.arange(head, head + count)),
            ("loop.sent", float(sent)), ("loop.lost", 0.0), ("safe.fault", fault), ("safe.index", -1.0),
        ):  # fmt: skip
            self.acting.column(rows, path)[...] = values
        self.rows = np.vstack([self.rows, rows])
        for k, row in enumerate(rows, start=head):
            self.ring.rows[k % self.ring.capacity] = row
            self.ring.header[HEAD] = k + 1

    def written(self) -> None:
        """Wait until all is in files."""
        until(lambda: self.ring.header[logger.SAFE] == len(self.rows))

    def files(self) -> list[taut.Run]:
        """Each run of ticks of every file, in order; each has what the ring had, to the last bit."""
        runs = list[taut.Run]()
        for file in sorted(self.folder.glob("*.mcap")):
            size = file.stat().st_size
            if self.read.get(file, (0, []))[0] != size:
                self.read[file] = size, list(self._checked(file))
            runs += self.read[file][1]
        return runs

    def _checked(self, file: Path) -> Iterator[taut.Run]:
        with contextlib.suppress(taut.errors.FileError):  # one that a kill left without a whole description
            for run in intact_parts(file):
                ticks = ticks_of(run)
                assert (np.diff(ticks) == 1).all()
                expected = self.acting.layout.of_run(self.rows[ticks])
                for name, values in run.arrays().items():
                    assert values.tobytes() == expected[name].tobytes(), name
                yield run

    def ticks(self) -> list[int]:
        """All ticks that are in files, each once."""
        return sorted(set(np.concatenate([[], *(ticks_of(run) for run in self.files())]).astype(int).tolist()))

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            self.log.close()
            self.acting.close()


def ticks_of(run: taut.Run) -> Any:
    return run.extra["loop.tick"].astype(int)


@pytest.fixture
def loop(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Loop]:
    made = Loop(tmp_path / "logs", getattr(request, "param", 8192))
    yield made
    made.close()


def test_a_fault_of_the_driver_is_the_outcome_of_the_law_that_acted(loop: Loop) -> None:
    loop.status.words[STATUS["running"]] = 2
    loop.status.words[STATUS["fault"]] = CODES["disconnected"]
    loop.tick(100)
    loop.tick(1, sent=False)
    loop.written()
    loop.status.words[STATUS["running"]] = 1  # this one
    loop.tick(100)
    loop.close()
    first, second = loop.files()
    assert first.outcome.ok
    assert second.outcome.kind == "stopped"
    assert second.outcome.message.startswith("disconnected (50) in tick 0: ")


small = pytest.mark.parametrize("loop", [SMALL], indirect=True)


def test_each_stretch_of_ticks_that_went_out_is_a_file_without_gaps(loop: Loop) -> None:
    for sent, count in ((False, 150), (True, 700), (False, 3), (True, 2), (True, 1000), (False, 10)):
        loop.tick(count, sent=sent)
        loop.written()
    loop.tick(500, fault=31.0)
    loop.close()
    first, second, third = loop.files()
    assert [len(first), len(second), len(third)] == [700, 1002, 500]
    assert [run.outcome.kind for run in (first, second, third)] == ["completed", "completed", "stopped"]
    assert third.outcome.message.startswith("speed (31) in tick 1865")
    assert loop.log.dropped == 0
    assert {file.name.partition("-")[2][11:] for file in loop.folder.iterdir()} == {"Computed_torque.mcap"}


@pytest.mark.part(1)
@pytest.mark.long
def test_a_killed_log_process_loses_nothing(loop: Loop, share: Callable[[int], int], bar: Any) -> None:
    """What is in files right after each kill, and in the end."""
    kills, behind = 160 if share(160) == 160 else 8, list[int]()
    for _ in range(kills):
        end = time.monotonic() + loop.rng.uniform(0.05, 0.4)
        while time.monotonic() < end:
            loop.tick(5)
            time.sleep(0.005)
        process = loop.log.process
        os.kill(process.pid, signal.SIGKILL)
        head = len(loop.rows)
        process.wait()
        behind.append(head - 1 - max(loop.ticks(), default=-1))
        loop.tick(1)
        until(lambda: loop.log.process.pid != process.pid)  # noqa: B023
        loop.written()
    loop.close()
    assert loop.ticks() == list(range(len(loop.rows)))
    assert loop.log.dropped == 0
    assert max(behind) <= 200
    title = "kill -9 of the log process: times; ticks that were in no file then, at most; in the end"
    bar(title, f"{kills}; {max(behind)}; 0")


@small
def test_a_log_process_that_is_killed_last_is_followed_by_another(loop: Loop) -> None:
    loop.tick(300)
    loop.log.process.kill()
    loop.close()
    assert loop.ticks() == list(range(300))


# -------------------------------------------------------------------- the disk


def limit(loop: Loop, what: int, value: int) -> None:
    resource.prlimit(loop.log.process.pid, what, (value, resource.prlimit(loop.log.process.pid, what)[1]))


DISKS: dict[str, tuple[Callable[[Loop], None], Callable[[Loop], None], bool]] = {
    "full": (
        lambda loop: limit(loop, resource.RLIMIT_FSIZE, 60_000),
        lambda loop: limit(loop, resource.RLIMIT_FSIZE, resource.RLIM_INFINITY),
        True,
    ),
    "stalled": (
        lambda loop: os.kill(loop.log.process.pid, signal.SIGSTOP),
        lambda loop: os.kill(loop.log.process.pid, signal.SIGCONT),
        False,
    ),
    "no file descriptors": (
        lambda loop: limit(loop, resource.RLIMIT_NOFILE, 3),
        lambda loop: limit(loop, resource.RLIMIT_NOFILE, 1000),
        True,
    ),
    "folder gone": (lambda loop: shutil.rmtree(loop.folder), lambda loop: loop.folder.mkdir(), True),
}


@small
@pytest.mark.parametrize("disk", DISKS)
def test_what_a_disk_does_not_take_is_counted_exactly(loop: Loop, disk: str) -> None:
    """A failure shorter than the ring loses nothing; of a longer one everything is in a file, or counted."""
    breaks, mends, refuses = DISKS[disk]
    loop.tick(10, sent=False)
    loop.written()
    breaks(loop)
    for _ in range(5):
        loop.tick(SMALL // 10)
        time.sleep(0.04)
    mends(loop)
    loop.written()
    assert loop.ticks() == list(range(10, 10 + SMALL // 2))
    loop.tick(10, sent=False)
    loop.written()
    breaks(loop)
    while loop.log.dropped < 2 * SMALL and disk != "stalled":
        loop.tick(50)
        time.sleep(0.005)
    loop.tick(4 * SMALL)
    mends(loop)
    loop.written()
    loop.tick(30)
    loop.close()
    meant = int((loop.acting.column(loop.rows, "loop.sent") > 0.5).sum())
    if disk == "folder gone":  # with what was in it
        meant -= SMALL // 2
    assert len(loop.ticks()) + loop.log.dropped == meant
    assert loop.ticks()[-1] == len(loop.rows) - 1
    assert loop.log.dropped > 3 * SMALL
    assert bool(loop.ring.header[logger.ERRNO]) == refuses
    assert "are not in the log: " in loop.files()[-1].outcome.message
    assert loop.files()[-1].outcome.dropped == loop.log.dropped


@small
@pytest.mark.parametrize("disk", ["full", "stalled"])
def test_a_disk_that_never_comes_back_delays_the_end_for_a_stated_time(
    loop: Loop, disk: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logger, "LOG_CLOSING", 0.3)
    loop.tick(100)
    loop.written()
    DISKS[disk][0](loop)
    loop.tick(SMALL + 100)
    begin = time.monotonic()
    loop.close()
    assert time.monotonic() - begin < 10.0
    assert len(loop.ticks()) + loop.log.dropped == len(loop.rows)
    assert loop.log.dropped >= 100


def test_a_folder_that_cannot_be_made_is_refused_before_anything_moves(tmp_path: Path) -> None:
    (tmp_path / "logs").touch()
    with refused(taut.errors.FileError):
        taut.connect(taut.RigidPlant(taut.load_arm("one_joint")), log=tmp_path / "logs")


# -------------------------------------------------------------------- parent and loop


SCRIPT = """
import sys, time, taut
arm = taut.load_arm("one_joint")
robot = taut.connect(taut.RigidPlant(arm), log=sys.argv[1])
robot.start(taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm))
print(robot.link.process.pid, flush=True)
time.sleep(60.0)
"""


@pytest.mark.part(1)
@pytest.mark.parametrize("victim", ["parent", "loop"])
def test_a_killed_parent_or_loop_leaves_whole_logs(
    victim: str, tmp_path: Path, share: Callable[[int], int], bar: Any
) -> None:
    """The log process outlives both, and ends the file."""
    kills, behind, rng = 20 if share(20) == 20 else 1, list[float](), np.random.default_rng(0)
    for k in range(kills):
        folder = tmp_path / str(k)
        command = [sys.executable, "-c", SCRIPT, str(folder)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as parent:
            assert parent.stdout is not None
            loop = int(parent.stdout.readline())
            time.sleep(rng.uniform(0.05, 0.4))
            killed = time.monotonic()
            os.kill(parent.pid if victim == "parent" else loop, signal.SIGKILL)
            if victim == "loop":
                until(lambda: all(map(is_whole, folder.iterdir())))  # noqa: B023
                parent.kill()
        until(lambda: all(map(is_whole, folder.iterdir())))  # noqa: B023
        runs = [taut.load_run(file) for file in sorted(folder.iterdir())]
        ticks = np.concatenate([ticks_of(run) for run in runs])
        assert (np.diff(ticks) == 1).all()
        assert all("outcome" not in run.outcome.message for run in runs)
        why = "its program was killed; " if victim == "parent" else "process_died (61)"
        assert runs[-1].outcome.message.startswith(why)
        behind.append(1e3 * max(0.0, killed - runs[-1].extra["loop.time"][-1]))
    assert max(behind) <= 200.0
    bar(f"kill -9 of the {victim}: times; ms without a row before it, at most", f"{kills}; {max(behind):.0f}")


def is_whole(file: Path) -> bool:
    """Whether an MCAP file has its end."""
    return file.read_bytes()[-8:] == b"\x89MCAP0\r\n"
