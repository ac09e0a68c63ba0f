"""What was computed before something broke is there: in the record, with an outcome, and in the log."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runtime_laws import HandPlant

import taut
from taut.record.log import writing as log_module
from taut.runtime import ongoing

ARM = taut.load_arm("planar2")
PID = taut.laws.PID(kp=20.0, kd=4.0)
BREAKS = 37  # the first tick in which something raises
PLANTS: dict[str, Callable[[], Any]] = {
    "rigid": lambda: taut.RigidPlant(ARM),
    "mujoco": lambda: taut.MujocoPlant(ARM),
    "hand": HandPlant,
}


def source(x: taut.Snapshot) -> taut.JointMotion:
    if x.t > 0.0365:
        raise ValueError("mine")
    return taut.JointMotion(q=[0.1, 0.2])


class Breaks:
    """A trajectory of its own."""

    def at(self, t: float) -> taut.JointMotion:
        if t > 0.0365:
            raise ValueError("mine")
        return taut.JointMotion(q=[0.1, 0.2])


class Raises(taut.Law):
    """A law that raises, which plain Python can and compiled code cannot."""

    kp: taut.Gain

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        if x.t > 0.0365:
            raise ValueError("mine")
        return taut.Torque(P=self.kp @ (ref.q - x.q))


def phase(reference: object) -> list[taut.Phase]:
    return [taut.Phase(PID, reference, name="only")]


CASES: dict[str, tuple[Any, object, str]] = {
    "source": (PID, taut.stream(period=0.001, source=source), "native"),
    "source, float": (PID, taut.stream(period=0.001, source=source), "float"),
    "trajectory": (PID, Breaks(), "native"),
    "law": (Raises(kp=20.0), taut.JointMotion(q=[0.1, 0.2]), "float"),
    "source of a phase": (phase(taut.stream(period=0.001, source=source)), None, "native"),
    "trajectory of a phase": (phase(Breaks()), None, "native"),
}


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
@pytest.mark.parametrize(("law", "ref", "engine"), CASES.values(), ids=CASES)
def test_what_raises_ends_the_run_with_an_outcome_and_the_record(
    law: Any, ref: object, engine: Any, plant: Callable[[], Any], tmp_path: Path
) -> None:
    made, log = plant(), tmp_path / "run.mcap"
    ctrl = taut.compile(law, ARM, adds=made.adds, engine=engine)
    out = taut.run(ctrl, made, ref, duration=0.1, log=log)
    assert (len(out), out.outcome.kind, out.outcome.tick) == (BREAKS, "stopped", BREAKS - 1)
    assert "ValueError: mine" in out.outcome.message
    whole = taut.run(ctrl, plant(), ref, duration=(BREAKS - 1) * 1e-3)
    np.testing.assert_array_equal(out.q, whole.q)
    np.testing.assert_array_equal(out.tau, whole.tau)
    again = taut.load_run(log)
    assert again.outcome == out.outcome
    np.testing.assert_array_equal(again.q, out.q)


def at_once(x: taut.Snapshot) -> taut.JointMotion:
    raise ValueError("mine")


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_what_raises_in_the_first_tick_ends_the_run_before_it(plant: Callable[[], Any], tmp_path: Path) -> None:
    made, ref = plant(), taut.stream(period=0.01, source=at_once)
    ctrl = taut.compile(PID, ARM, adds=made.adds)
    out = taut.run(ctrl, made, ref, duration=0.1, log=tmp_path / "run.mcap")
    assert (len(out), out.outcome.kind, out.outcome.tick) == (0, "stopped", -1)
    assert "ValueError: mine" in out.outcome.message
    assert taut.load_run(tmp_path / "run.mcap").outcome == out.outcome


@pytest.mark.parametrize("what", ["state", "measure", "advance", "trouble", "extra"])
def test_a_plant_that_raises_is_no_loss_either(what: str) -> None:
    """As a robot does whose connection breaks."""

    class Broken(HandPlant):
        def __getattribute__(self, name: str) -> Any:
            if name == what and vars(self).get("ticks", 0) >= BREAKS:
                raise ConnectionError("the cable is out")
            return super().__getattribute__(name)

    plant = Broken()
    out = taut.run(taut.compile(PID, ARM, adds=plant.adds), plant, duration=0.1)
    assert out.outcome.kind == "stopped"
    assert "the cable is out" in out.outcome.message
    assert len(out) in (BREAKS, BREAKS - 1)  # what fails after the step takes the row with it
    assert np.isfinite(out.q).all()


# -------------------------------------------------------------------- logs that cannot be written


def run_with(path: Path, plant: Any, ref: object = None) -> taut.Run:
    return taut.run(taut.compile(PID, ARM, adds=plant.adds), plant, ref, duration=0.1, log=path)


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
class TestALogThatCannotBeWritten:
    def test_because_the_disk_is_full(self, plant: Callable[[], Any], tmp_path: Path) -> None:
        path = tmp_path / "run.mcap"
        path.symlink_to("/dev/full")
        out = run_with(path, plant())
        assert (out.outcome.kind, out.outcome.tick, out.outcome.dropped) == ("completed", 100, 101)
        assert "No space left on device" in out.outcome.message

    def test_because_a_pipe_is_closed(
        self, plant: Callable[[], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(ongoing, "LOG_PERIOD", 0.0)
        path = tmp_path / "run.mcap"
        os.mkfifo(path)
        reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        asked: list[float] = []

        def closing(x: taut.Snapshot) -> taut.JointMotion:
            asked.append(float(x.t))
            if len(asked) == 6:
                os.close(reader)
            return taut.JointMotion(q=[0.1, 0.2])

        out = run_with(path, plant(), taut.stream(period=0.01, source=closing))
        assert (out.outcome.kind, len(out)) == ("completed", 101)
        assert 0 < out.outcome.dropped <= 101
        assert "Broken pipe" in out.outcome.message

    def test_because_there_are_no_file_descriptors(
        self, plant: Callable[[], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        most, begin = resource.getrlimit(resource.RLIMIT_NOFILE), log_module.Log._begin

        def greedy(log: log_module.Log, rows: taut.Run) -> Any:
            resource.setrlimit(resource.RLIMIT_NOFILE, (3, most[1]))
            return begin(log, rows)

        monkeypatch.setattr(log_module.Log, "_begin", greedy)
        try:
            out = run_with(tmp_path / "run.mcap", plant())
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, most)
        assert (out.outcome.kind, out.outcome.dropped) == ("completed", 101)
        assert "Too many open files" in out.outcome.message
        assert out.q.shape == (101, 2)


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Files may have so many bytes and no more."""
    most, before = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, most[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, most)
        signal.signal(signal.SIGXFSZ, before)


def test_a_disk_that_gets_full_leaves_what_was_written_and_counts_the_rest(tmp_path: Path) -> None:
    path, plant = tmp_path / "run.mcap", taut.RigidPlant(ARM)
    ctrl = taut.compile(PID, ARM)
    taut.run(ctrl, plant, duration=2.0)  # its code is in the cache from here on
    free = taut.run(ctrl, plant, duration=2.0, log=tmp_path / "free.mcap")
    with largest_file((tmp_path / "free.mcap").stat().st_size // 2):
        out = taut.run(ctrl, plant, duration=2.0, log=path)
    assert (out.outcome.kind, len(out)) == ("completed", 2001)
    assert 0 < out.outcome.dropped < 2001
    assert free.outcome.dropped == 0
    np.testing.assert_array_equal(out.q, free.q)
    again = taut.load_run(path)
    assert len(again) >= 2001 - out.outcome.dropped
    np.testing.assert_array_equal(again.q, out.q[: len(again)])
    out.save(tmp_path / "saved.mcap")
    assert taut.load_run(tmp_path / "saved.mcap").outcome == out.outcome


def test_a_standard_error_that_nobody_reads_ends_the_bar_and_not_the_run(tmp_path: Path) -> None:
    code = """
import sys, taut
from taut.record import progress
progress.PATIENCE = 0.0
arm = taut.load_arm("planar2")
out = taut.run(taut.compile(taut.laws.PID(kp=20.0), arm), taut.RigidPlant(arm), duration=1.0, progress=True)
print(out.outcome.kind)
"""
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=full, check=False, timeout=60
        )
    assert done.stdout == b"completed\n"


# -------------------------------------------------------------------- how far a log is behind


@pytest.mark.part(2)
@pytest.mark.parametrize("period", [0.0005, 0.06, 0.19, 3.0])  # [s] of computing for a tick
@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_a_log_is_a_tick_or_a_fifth_of_a_second_behind(
    plant: Callable[[], Any], period: float, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """However long a tick takes: the clock of this test goes on by `period` in each."""
    now, written = [0.0], [0]
    behind: list[float] = []
    done: list[float] = []  # when each tick was done

    def ticks(count: int) -> None:
        for _ in range(count):
            now[0] += period
            done.append(now[0])

    def write(log: log_module.Log, rows: taut.Run, *_: object) -> None:
        behind.append(now[0] - done[written[0]])  # of the oldest row that is not written
        written[0] += len(rows)

    monkeypatch.setattr(ongoing, "monotonic", lambda: now[0])
    monkeypatch.setattr(log_module.Log, "write", write)
    run, tick = ongoing.FusedRun._block, ongoing.HostedRun._tick
    monkeypatch.setattr(ongoing.FusedRun, "_block", lambda self, k, end: (ticks(end - k), run(self, k, end))[1])
    monkeypatch.setattr(ongoing.HostedRun, "_tick", lambda self, k: (ticks(1), tick(self, k))[1])
    made = plant()
    out = taut.run(taut.compile(PID, ARM, adds=made.adds), made, duration=2.0, log=tmp_path / "run.mcap")
    assert written[0] == len(out) == 2001
    first = 16 * period if isinstance(made, taut.RigidPlant) else 0.0  # before it is known how long a tick takes
    assert behind[0] <= max(0.2, period, first)
    assert max(behind[1:]) <= max(0.2, period) + 1e-9


def test_blocks_of_another_length_change_no_number(tmp_path: Path) -> None:
    noisy = taut.RigidPlant(ARM, sensors=taut.sensors.Sensors(position=taut.sensors.Encoder(noise=1e-4)))
    ctrl = taut.compile(PID, ARM)
    free, logged = (taut.run(ctrl, noisy, duration=6.0, log=log) for log in (None, tmp_path / "run.mcap"))
    np.testing.assert_array_equal(free.q, logged.q)
    np.testing.assert_array_equal(free.tau, logged.tau)
