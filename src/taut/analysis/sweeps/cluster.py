"""Chunks of a sweep on the workers of a Ray cluster, which runs already: nothing here starts one.

A process of ours speaks with Ray, which waits for minutes where no cluster answers, and ends the process that speaks
with a cluster that is lost.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import pickle
import platform
import re
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import IO, Any, Final

from taut.analysis.sweeps.chunks import LaneRuns, Results, Runner, failed_results, runner_of
from taut.analysis.sweeps.plan import Plan
from taut.analysis.sweeps.workers import START, Child, Chunk, Died, InProcess, each_once, messages, read, write
from taut.base.errors import TautError, UsageError, missing_extra
from taut.record.info import versions

CONNECT: Final = 40.0  # [s] for a cluster to answer; Ray's own errors come within 35 s
FOR_EACH_CPU: Final = 2  # chunks in flight for each processor of the cluster: one runs, one is there
COUNT_PERIOD: Final = 5.0  # [s] between two counts of the processors, which come and go
AUTH: Final = "RAY_AUTH_MODE"
ADDRESS: Final = re.compile(r"(ray://)?[^\s/]+:\d+")


class ClusterError(TautError, ConnectionError):
    """A Ray cluster that does not answer, cannot run a sweep, or is lost."""


def check_ray(address: object) -> None:
    """Refuse what is no address, and a sweep on a cluster where Ray is not installed, without loading it."""
    if not isinstance(address, str) or (address != "auto" and not ADDRESS.fullmatch(address)):
        raise UsageError(
            f"ray must be 'auto', 'HOST:PORT' or 'ray://HOST:PORT', of a cluster that runs already; got {address!r}",
            name="ray",
        )
    if importlib.util.find_spec("ray") is None:
        raise missing_extra("a sweep with ray=", "ray", "ray")


def run_on_ray(plan: Plan, address: str, workers: int | None, chunks: list[Chunk]) -> Iterator[Results]:
    """The results of chunks, in the order in which they are done; on leaving, what still runs is ended.

    Args:
        plan: What runs.
        address: Of the cluster: "auto" for the one of this machine, "HOST:PORT", or "ray://HOST:PORT".
        workers: Chunks in flight at most; `FOR_EACH_CPU` for each processor of the cluster where it is None.
        chunks: Those that are to be run.

    Raises:
        ClusterError: No cluster answers, or it has no worker that can run the plan, or it is lost.
    """
    absent = f"no Ray cluster answers at '{address}', or it does not accept the token of this machine"
    idle = f"no worker of the Ray cluster at '{address}' began the sweep"
    lost = f"the Ray cluster at '{address}' was lost; files of out= keep what was done"
    with tempfile.TemporaryFile() as printed:
        child = Child(__name__, printed)
        try:
            child.send((address, workers, dict(versions()), pickle.dumps(plan), chunks))
            _answer(child, CONNECT, address, absent, printed)
            _answer(child, START, address, idle, printed)
            while (results := _answer(child, None, address, lost, printed)) is not None:
                yield results
        finally:
            child.close()


def _answer(child: Child, limit: float | None, address: str, trouble: str, printed: IO[bytes]) -> Any:
    try:
        kind, what = child.answer() if limit is None else child.answer(limit)
    except Died as death:
        printed.seek(0)
        last = printed.read().decode(errors="replace").strip().rpartition("\n")[2]
        raise ClusterError(
            f"{trouble}: Ray's client {death}{last and f' ({last})'}", name="ray", value=address
        ) from death
    if kind == "raised":
        raise what
    if kind in ("absent", "unfit"):
        raise ClusterError(what if kind == "unfit" else f"{trouble}: {what}", name="ray", value=address)
    return what


# -------------------------------------------------------------------- the process that speaks with Ray


def main() -> None:
    """Connect, and hand chunks to workers; answers are "ready" twice, then results, then None."""
    sent, answers = messages()
    address, workers, known, pickled, chunks = read(sent)
    os.environ.setdefault(AUTH, "token")
    try:
        if address != "auto":
            host, _, port = address.rpartition("/")[2].rpartition(":")
            socket.create_connection((host, int(port)), CONNECT / 2.0).close()
        import ray

        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
    except Exception as cause:
        write(answers, ("absent", _sentence(cause)))
        return
    write(answers, ("ready", None))
    with suppress(BrokenPipeError):  # of a parent that is gone
        for answer in _answers(ray, workers, known, pickled, chunks):
            write(answers, answer)


def _answers(
    ray: Any, workers: int | None, known: dict[str, str], pickled: bytes, chunks: list[Chunk]
) -> Iterator[tuple[str, Any]]:
    """The answers of workers.

    A chunk whose worker dies is run again sample by sample, and a sample that ends two workers has failed.
    """
    task = ray.remote(num_cpus=1, max_retries=0)(_work())
    given = known, [ray.put(pickled)]  # in a list, Ray hands on the reference
    yield ray.get(task.options(max_retries=3).remote(*given, None))
    waiting, again, looked, limit = iter(chunks), list[Chunk](), -COUNT_PERIOD, 1
    flying: dict[Any, Chunk] = {}
    died = set[Chunk]()
    while True:
        if workers is None and time.monotonic() > looked + COUNT_PERIOD:
            looked, limit = time.monotonic(), max(1, int(FOR_EACH_CPU * ray.cluster_resources().get("CPU", 0)))
        while len(flying) < (workers or limit):
            chunk = again.pop() if again else next(waiting, None)
            if chunk is None:
                break
            flying[task.remote(*given, chunk)] = chunk
        if not flying:
            break
        done, _ = ray.wait(list(flying), num_returns=1)
        chunk = first, count = flying.pop(done[0])
        try:
            yield ray.get(done[0])
        except ray.exceptions.RayError as error:
            if isinstance(error, ray.exceptions.RayTaskError) and not isinstance(error.cause, MemoryError):
                yield "raised", error.cause
            elif count > 1:
                again += [(first + i, 1) for i in range(count)]
            elif chunk not in died:
                died.add(chunk)
                again.append(chunk)
            else:
                reason = f"the Ray worker that ran it died: {_sentence(error)}"
                yield "results", failed_results(pickle.loads(pickled), first, 1, reason)
    yield "done", None


def _sentence(error: BaseException) -> str:
    first, _, _ = str(error).strip().replace(".\n", ". ").replace("\n", ". ").partition(". ")
    return f"{type(error).__name__}: {first}"


# -------------------------------------------------------------------- on a worker


def _work() -> Callable[..., tuple[str, Any]]:
    """What a worker does, as a function that is sent itself and not by its name, for nodes that have no taut."""

    def work(known: dict[str, str], plan: list[Any], chunk: Any) -> tuple[str, Any]:
        import platform

        try:
            from taut.analysis.sweeps.cluster import answer_of
        except ImportError as cause:
            return "unfit", f"node '{platform.node()}' has no taut, or another version: {cause}; install it there"
        return answer_of(known, plan[0], chunk)

    return work


def answer_of(known: dict[str, str], plan: Any, chunk: Chunk | None) -> tuple[str, Any]:
    """The answer of a worker: the results of a chunk, in the versions that the driver has."""
    own = versions()
    other = ", ".join(
        f"{name} {own.get(name)} and not {known[name]}" for name in known if own.get(name) != known[name]
    )
    if other:
        return "unfit", f"node '{platform.node()}' has {other}; install there what the driver has"
    try:
        runner = _runner(plan)
    except Exception as error:
        return "unfit", f"the loop cannot be made on node '{platform.node()}': {_sentence(error)}"
    return ("ready", None) if chunk is None else ("results", each_once(runner[0], runner[1], chunk, lambda: None))


@functools.cache  # a worker belongs to one sweep
def _runner(reference: Any) -> tuple[Plan, Runner]:
    """The plan and its runner in this worker: one in lanes, or one in a process that is ended where it hangs."""
    import ray

    plan = pickle.loads(ray.get(reference))
    runner = runner_of(plan)
    return plan, runner if isinstance(runner, LaneRuns) else InProcess(plan)
