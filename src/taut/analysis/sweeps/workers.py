"""Workers of a sweep: threads that run chunks, in lanes or each through a process of its own.

A process that dies or hangs takes its chunk with it, which is then run sample by sample, and a sample twice at most:
each has one result, whatever happened.
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
from collections.abc import Callable, Iterator, Sequence
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


class Child:
    """A Python process that answers on standard output to what it is sent on standard input.

    Args:
        module: Its `main` runs there.
        errors: File of what it prints; it prints where this process does if left out.
    """

    def __init__(self, module: str, errors: IO[bytes] | None = None) -> None:
        command = [sys.executable, "-c", f"from {module} import main; main()"]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=errors, env=environment)
        self.stopped = False

    def send(self, message: object) -> None:
        """Send a message; where the process is gone, the answer shows it."""
        with contextlib.suppress(OSError):
            write(self._process.stdin, message)

    def answer(self, limit: float = threading.TIMEOUT_MAX) -> tuple[str, Any]:
        """The next answer. Raises `Died`, with how, where the process ends, or is ended after `limit` [s]."""
        hung = threading.Event()

        def end() -> None:
            hung.set()
            self._process.kill()

        timer = threading.Timer(limit, end)
        timer.start()
        try:
            kind, what = read(self._process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            status = self.close()
            if self.stopped:
                raise Stopped from None
            how = f"did not answer for {limit:.3g} s" if hung.is_set() else f"ended with status {status}"
            raise Died(how) from None
        finally:
            timer.cancel()
        return kind, what

    def stop(self) -> None:
        """End the process, and with it what it runs."""
        self.stopped = True
        self._process.kill()

    def close(self) -> int:
        """End the process and wait for it: its exit status."""
        self._process.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with contextlib.suppress(OSError):
                pipe.close()
        return self._process.wait()


class InProcess(Runner):
    """A runner in a process of its own, which is begun anew where it has died."""

    def __init__(self, plan: Plan) -> None:
        self._plan, self._longest = plan, 0.0
        self._child: Child | None = None

    def results(self, first: int, count: int, step: Callable[[], None] = lambda: None) -> Results:
        child = self._child or self._begin()
        child.send((first, count))
        while True:
            began = time.monotonic()
            kind, what = self._answer(child, max(SAMPLE_PATIENCE, LONGEST * self._longest))
            step()
            if kind == "results":
                assert isinstance(what, Results)
                return what
            self._longest = max(self._longest, time.monotonic() - began)

    def stop(self) -> None:
        """End the process, and with it what it runs."""
        if self._child is not None:
            self._child.stop()

    def close(self) -> None:
        """Wait for the end of the process."""
        if self._child is not None:
            self._child.close()

    def _begin(self) -> Child:
        child = self._child = Child(__name__)
        child.send(self._plan)
        kind, what = self._answer(child, START)
        if kind == "refused":
            raise UsageError(f"the loop cannot be made in another process: {what}", name="loop")
        return child

    def _answer(self, child: Child, limit: float) -> tuple[str, Any]:
        try:
            return child.answer(limit)
        except Died as how:
            self._child = None
            raise Died(f"the process that ran it {how}") from None


def write(pipe: IO[bytes] | None, message: object) -> None:
    """Send a message to another process."""
    assert pipe is not None
    pickle.dump(message, pipe)
    pipe.flush()


def read(pipe: IO[bytes] | None) -> Any:
    """The next message of another process."""
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


def run_chunks(plan: Plan, shared: Runner | None, workers: int, chunks: Sequence[Chunk]) -> Iterator[Results]:
    """The results of chunks, in the order in which they are done; on leaving, what still runs is ended.

    Args:
        plan: What runs.
        shared: The runner that all threads share; None for one in a process for each.
        workers: Number of threads at most.
        chunks: Those that are to be run.
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

    threads = [threading.Thread(target=work, daemon=True) for _ in range(min(workers, len(chunks)))]
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


def messages() -> tuple[IO[bytes], IO[bytes]]:
    """Where a child reads what it is sent, and where it writes answers; Ctrl-C is for its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a user's code prints is no answer
    return sys.stdin.buffer, answers


def main() -> None:
    """The process of a worker: a plan, then chunks, on standard input; answers on standard output."""
    sent, answers = messages()
    try:
        runner = runner_of(read(sent))
    except Exception as error:
        write(answers, ("refused", f"{type(error).__name__}: {error}"))
        return
    write(answers, ("ready", None))
    while True:
        try:
            first, count = read(sent)
        except EOFError:
            return
        write(answers, ("results", runner.results(first, count, lambda: write(answers, ("sample", None)))))
