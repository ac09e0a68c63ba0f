"""Workers of a sweep: threads that run chunks, in lanes or each through a process of its own.

A process that dies or hangs takes its chunk with it, which is then run sample by sample, and a sample twice at most:
each has one result, whatever happened. Started as `python -m taut.analysis.sweeps.workers`.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import IO, Any, Final

import numpy as np

from taut.analysis.sweeps.chunks import Results, Runner, Stopped, failed_results, runner_of
from taut.analysis.sweeps.plan import Plan
from taut.base.errors import UsageError

START: Final = 300.0  # [s] for a process to begin and compile the loop
SAMPLE_PATIENCE: Final = 60.0  # [s] for a sample, until it is known how long one takes
LONGEST: Final = 20.0  # times the longest sample so far
Chunk = tuple[int, int]
"""First sample and number of samples."""


class Died(Exception):  # noqa: N818  # a result of a sample
    """A process ended or was ended in the middle of a chunk."""


class InProcess(Runner):
    """A runner in a process of its own, which is begun anew where it has died."""

    def __init__(self, plan: Plan) -> None:
        self._plan, self._longest, self._stopped = plan, 0.0, False
        self._process: subprocess.Popen[bytes] | None = None

    def results(self, first: int, count: int, step: Callable[[], None] = lambda: None) -> Results:
        process = self._process or self._begin()
        self._send(process, (first, count))
        while True:
            began = time.monotonic()
            kind, what = self._answer(process, max(SAMPLE_PATIENCE, LONGEST * self._longest))
            step()
            if kind == "results":
                assert isinstance(what, Results)
                return what
            self._longest = max(self._longest, time.monotonic() - began)

    def stop(self) -> None:
        """End the process, and with it what it runs."""
        self._stopped = True
        if self._process is not None:
            self._process.kill()

    def close(self) -> int:
        """Wait for the end of the process: its exit status."""
        process, self._process = self._process, None
        if process is None:
            return 0
        process.kill()
        for pipe in (process.stdin, process.stdout):
            assert pipe is not None
            with contextlib.suppress(OSError):
                pipe.close()
        return process.wait()

    def _begin(self) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", __name__]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        self._process = process
        self._send(process, self._plan)
        kind, what = self._answer(process, START)
        if kind == "refused":
            raise UsageError(f"the loop cannot be made in another process: {what}", name="loop")
        return process

    def _send(self, process: subprocess.Popen[bytes], message: object) -> None:
        with contextlib.suppress(OSError):  # of a process that is gone, which the answer shows
            _write(process.stdin, message)

    def _answer(self, process: subprocess.Popen[bytes], limit: float) -> tuple[str, Any]:
        hung = threading.Event()

        def end() -> None:
            hung.set()
            process.kill()

        timer = threading.Timer(limit, end)
        timer.start()
        try:
            kind, what = _read(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            status = self.close()
            if self._stopped:
                raise Stopped from None
            how = f"did not answer for {limit:.3g} s" if hung.is_set() else f"ended with status {status}"
            raise Died(f"the process that ran it {how}") from None
        finally:
            timer.cancel()
        return kind, what


def _write(pipe: IO[bytes] | None, message: object) -> None:
    assert pipe is not None
    pickle.dump(message, pipe)
    pipe.flush()


def _read(pipe: IO[bytes] | None) -> Any:
    assert pipe is not None
    return pickle.load(pipe)


def each_once(plan: Plan, runner: Runner, chunk: Chunk, step: Callable[[], None]) -> Results:
    """The results of a chunk, sample by sample where its process dies; a sample that kills two has failed."""
    first, count = chunk
    try:
        return runner.results(first, count, step)
    except Died as death:
        if count > 1:
            return _together([each_once(plan, runner, (first + i, 1), step) for i in range(count)])
        try:
            return runner.results(first, 1, step)
        except Died:
            return failed_results(plan, first, 1, str(death))


def _together(parts: list[Results]) -> Results:
    def joined(tables: list[dict[str, Any]]) -> dict[str, Any]:
        filled = [table for table in tables if table]
        return {name: np.concatenate([t[name] for t in filled]) for name in filled[0]} if filled else {}

    messages = {k: text for part in parts for k, text in part.messages.items()}
    return Results(table=joined([p.table for p in parts]), rows=joined([p.rows for p in parts]), messages=messages)


def run_chunks(plan: Plan, shared: Runner | None, chunks: Iterable[Chunk], workers: int) -> Iterator[Results]:
    """The results of chunks, in the order in which they are done; on leaving, what still runs is ended.

    Args:
        plan: What runs.
        shared: The runner that all threads share; None for one in a process for each.
        chunks: Those that are to be run.
        workers: Number of threads.
    """
    waiting, lock, stop = iter(chunks), threading.Lock(), threading.Event()
    done: queue.Queue[Results | BaseException | None] = queue.Queue(maxsize=2 * workers)
    runners: list[InProcess] = []

    def step() -> None:
        if stop.is_set():
            raise Stopped

    def put(answer: Results | BaseException | None) -> None:
        while not stop.is_set():
            with contextlib.suppress(queue.Full):
                done.put(answer, timeout=0.1)
                return

    def work() -> None:
        try:
            runner = shared
            if runner is None:
                runner = own = InProcess(plan)
                runners.append(own)
            while True:
                with lock:
                    chunk = next(waiting, None)
                if chunk is None:
                    break
                put(each_once(plan, runner, chunk, step))
        except Stopped:
            pass
        except BaseException as error:
            put(error)
        put(None)

    threads = [threading.Thread(target=work, daemon=True) for _ in range(workers)]
    for thread in threads:
        thread.start()
    try:
        left = len(threads)
        while left:
            try:
                answer = done.get(timeout=0.1)
            except queue.Empty:  # so that Ctrl-C is seen
                continue
            if answer is None:
                left -= 1
            elif isinstance(answer, BaseException):
                raise answer
            else:
                yield answer
    finally:
        stop.set()
        for each in runners:
            each.stop()
        for thread in threads:
            thread.join()
        for each in runners:
            each.close()


def main() -> None:
    """The process of a worker: a plan, then chunks, on standard input; answers on standard output."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a user's code prints is no answer
    try:
        runner = runner_of(_read(sys.stdin.buffer))
    except Exception as error:
        _write(answers, ("refused", f"{type(error).__name__}: {error}"))
        return
    _write(answers, ("ready", None))
    while True:
        try:
            first, count = _read(sys.stdin.buffer)
        except EOFError:
            return
        _write(answers, ("results", runner.results(first, count, lambda: _write(answers, ("sample", None)))))


if __name__ == "__main__":
    main()
