"""`make fuzz`: seeded mutants of every kind of file that taut reads; one table, and out/fuzz.json.

    python tests/fuzz/fuzz.py [COUNT] [KIND ...]

An input must be accepted or refused with an error of ours, within 2 s of processor time and 500 MB, and no model may
be accepted whose mass matrix is not positive definite at 100 random poses.
"""

from __future__ import annotations

import collections
import json
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from fuzz_kinds import KINDS, NotDefiniteError, warm

import taut

MAX_TIME = 2.0  # [s] of processor time
MAX_MEMORY = 500 * 2**20  # beyond what the process has before
HANG = 20  # [s] after which an input is given up
CHUNK = 250  # inputs that a process takes at a time


class HangError(Exception):
    """An input that took far too long."""


@dataclass
class Tally:
    """What a number of inputs came to."""

    accepted: int = 0
    refused: int = 0
    faults: list[str] = field(default_factory=list)  # kind of fault, number of the input, what happened
    slowest: float = 0.0  # [s]
    largest: int = 0  # [kB] memory that one took beyond what the process had

    def add(self, other: Tally) -> None:
        self.accepted += other.accepted
        self.refused += other.refused
        self.faults += other.faults
        self.slowest = max(self.slowest, other.slowest)
        self.largest = max(self.largest, other.largest)


def tried(kind: str, numbers: range, *, timed: bool = True) -> Tally:
    """Make and read the mutants of these numbers; each is the same whenever it is made."""
    name, make, read = KINDS[kind]
    tally = Tally()
    warm(kind)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number in numbers:
            path = make(number, np.random.default_rng([number, *kind.encode()]), Path(folder) / name)
            took = _judged(lambda path=path: read(path), tally, f"{kind} {number}")
            if timed and took > MAX_TIME:  # the machine may have been busy
                took = min(took, _judged(lambda path=path: read(path), Tally(), ""))
            if timed and took > MAX_TIME:
                tally.faults.append(f"slow: {kind} {number}: {took:.1f} s")
            tally.slowest = max(tally.slowest, took)
            if tally.largest > MAX_MEMORY // 1024 and not any("memory" in fault for fault in tally.faults):
                tally.faults.append(f"memory: {kind} {number}: {tally.largest // 1024} MB")
    return tally


def _judged(read: object, tally: Tally, name: str) -> float:
    began, before = time.process_time(), _memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    signal.alarm(HANG)
    try:
        read()  # type: ignore[operator]
        tally.accepted += 1
    except taut.TautError as refused:
        tally.refused += 1
        if not str(refused).replace("\n", "").replace("\t", "").isprintable():
            tally.faults.append(f"escape: {name}")
    except NotDefiniteError as wrong:
        tally.faults.append(f"indefinite: {name}: {str(wrong)[:200]}")
    except HangError:
        tally.faults.append(f"hang: {name}")
    except MemoryError:
        tally.faults.append(f"memory: {name}")
    except BaseException as foreign:
        if isinstance(foreign, KeyboardInterrupt):
            raise
        where = traceback.extract_tb(foreign.__traceback__)[-1]
        place = f"{Path(where.filename).name}:{where.lineno}"
        tally.faults.append(f"foreign: {name}: {type(foreign).__name__}: {str(foreign)[:100]} ({place})")
    finally:
        signal.alarm(0)
    tally.largest = max(tally.largest, _memory("VmHWM") - before)
    return time.process_time() - began


def _memory(what: str) -> int:
    """[kB] of this process, as Linux counts it."""
    return int(Path("/proc/self/status").read_text().partition(f"{what}:")[2].split()[0])


def _hang(*_: object) -> None:
    raise HangError


def _bounded() -> None:
    """Bounds of a process: a hang ends, and so does memory beyond what it begins with."""
    signal.signal(signal.SIGALRM, _hang)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    margin = MAX_MEMORY + 1500 * 2**20  # address space is not memory: libraries and arenas map more than they use
    resource.setrlimit(resource.RLIMIT_AS, (size + margin, resource.RLIM_INFINITY))


def _chunk(work: tuple[str, range]) -> tuple[str, Tally]:
    return work[0], tried(*work)


def main(count: int, kinds: list[str]) -> int:
    """All mutants of the kinds, on two processes; 1 where there is a fault."""
    os.nice(10)
    tallies = {kind: Tally() for kind in kinds}
    chunks = [(kind, range(first, min(first + CHUNK, count))) for first in range(0, count, CHUNK) for kind in kinds]
    out = Path("out")
    out.mkdir(exist_ok=True)
    with multiprocessing.get_context("spawn").Pool(2, _bounded) as pool:
        for done, (kind, tally) in enumerate(pool.imap_unordered(_chunk, chunks), start=1):
            tallies[kind].add(tally)
            for fault in tally.faults:
                print(fault, flush=True)
            report = {
                kind: {
                    "inputs": tally.accepted + tally.refused + sum(not f.startswith("slow") for f in tally.faults),
                    "accepted": tally.accepted,
                    "refused": tally.refused,
                    **collections.Counter(fault.partition(":")[0] for fault in tally.faults),
                    "slowest_s": round(tally.slowest, 2),
                    "memory_MB": tally.largest // 1024,
                    "faults": tally.faults,
                }
                for kind, tally in tallies.items()
            }
            (out / "fuzz.json").write_text(json.dumps(report, indent=1), encoding="utf-8")
            if done % 20 == 0:
                print(f"{done} of {len(chunks)} chunks", file=sys.stderr, flush=True)
    heads = ("inputs", "accepted", "refused", "foreign", "hang", "memory", "indefinite", "escape", "slow")
    print(f"{'kind':12}" + "".join(f"{head:>11}" for head in (*heads, "slowest s", "memory MB")))
    for kind, row in report.items():
        numbers = [str(row.get(head, 0)) for head in (*heads, "slowest_s", "memory_MB")]
        print(f"{kind:12}" + "".join(f"{number:>11}" for number in numbers))
    return int(any(tally.faults for tally in tallies.values()))


if __name__ == "__main__":
    words = sys.argv[1:]
    number = int(words.pop(0)) if words and words[0].isdecimal() else 10_000
    sys.exit(main(number, words or list(KINDS)))
