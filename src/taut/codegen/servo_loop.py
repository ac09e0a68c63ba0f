"""The real-time loop in native code: wait, read, tick, write, record; and the watchdog of another process.

A loop that the host paces wakes a little before each deadline and computes once with the last inputs, to warm up.
What this writes, the tick writes again, from warm caches and to pages that are there. Then it waits for the deadline
on the clock: a processor that is awake is on time.

All words are 64 bits. `STATUS` lies in memory that the processes share; `LOOP` and `SET` belong to the loop's
process. A set is one compiled tick with its blocks; the loop takes another one between two ticks.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Mapping, Sequence
from typing import Any, Final

from taut.codegen.llvm import Writer
from taut.codegen.native import NativeModule, compiled

SYMBOLS: Final = ("clock_gettime", "clock_nanosleep", "getppid", "kill")
NAMES: Final = ("loop", "watch", "plant_read", "plant_write")
FUNCTIONS: Final = ("kernel", "start")  # of a set
PLANT_FUNCTIONS: Final = ("step", "substep", "measure")
PARTNER, UNWATCHED = 62, 63  # codes of `control.faults` that the loop finds itself
WATCH_EVERY: Final = 4_000_000  # [ns] between two looks of the watchdog
UNSEEN: Final = 500_000_000  # [ns] without a look after which the loop stops: nobody would stop it if it hung


def numbered(*names: str) -> dict[str, int]:
    """Places of words by name."""
    return {name: i for i, name in enumerate(names)}


STATUS: Final = numbered(
    "heartbeat",  # [ns] of the last tick
    "ticks",  # in total
    "where",  # the loop is in: 1 the read, 2 the tick, 3 the write; 0 outside
    "fault",  # code that a process latched, beside that of the ticks
    "armed",  # whether the watchdog watches
    "quit",  # ends the loop after a tick
    "hold",  # asks for the controlled stop
    "recover",  # counts the requests to recover
    "lost",  # periods missed in total
    "overruns",  # ticks whose computing took longer than a period
    "slowest",  # [ns] longest computing of a tick
    "running",  # number of the set that ticks
    "dead",  # ends the watchdog
    "control",  # whether commands go out
    "latched",  # code that the ticks latched
    "watched",  # [ns] of the watchdog's last look
    "patience",  # [ns] without a tick after which it acts
)
"""Words of the shared status."""
STATUS_WORDS: Final = 64

LOOP: Final = numbered(
    "status", "set", "next", "read", "write", "user", "measured", "period", "host_paced", "deadline", "last",
    "recovered",
    "lead",  # [ns] before a deadline at which it wakes and warms up
    "took",  # [ns] computing of the last tick
    "group",  # a word that robots share which stop together: when [ns] one of them stopped
    "known",  # the value of that word that was seen
)  # fmt: skip
SET: Final = numbered(
    "kernel", "start", "inputs", "parameters", "memory", "new", "outputs",  # functions and blocks
    "memory_size", "safe_size", "input_size", "output_size", "parameter_size", "reference_size", "measured_size",
    "t_at", "measured_at", "reference_at", "signals_at", "command_at", "fault_at",  # offsets in doubles
    "next_at", "ticks_at",  # of a task's phase in memory, or -1
    "ring", "rows", "capacity", "row_size",
    "controls", "new_parameters", "tables", "table_count", "table_rows",  # what the parent writes
    "scratch", "count", "number", "begins", "sends", "seen", "valid", "received", "dt",
)  # fmt: skip
CONTROLS: Final = numbered("parameters", "hold_after", "stop_after", "over")
"""Words at the beginning of what the parent writes: a sequence lock, and numbers."""
TABLE: Final = numbered(
    "lock",  # odd while the parent writes the next six
    "version", "first", "length",  # how often it was written; its rows
    "arrived",  # tick of the phase that the first row is for; -1: that in which the loop sees it
    "received",  # [ns]
    "stream",  # whether it grows stale
    "fixed",  # whether it is known before its phase begins
    "ticks", "voided", "seen", "began",  # of the loop: ticks of the phase; versions; tick of the first row
)  # fmt: skip
"""Words of a table of samples, one for each phase."""
ROW_HEAD: Final = ("tick", "time", "late", "compute", "driver", "lost", "sent")
"""Columns before inputs, parameters, memory and outputs in a row of the ring; times in seconds."""
PLANT: Final = numbered(
    "step", "substep", "repeats", "measure", "inputs", "parameters", "memory", "new", "outputs", "command_size",
    "memory_size", "count", "dt", "period", "wrote",
)  # fmt: skip
MAX_CATCH_UP: Final = 1000  # periods that a model plant moves on at once


class WordCode(Writer):
    """Lines with words by name."""

    def at(self, base: str, index: int | str) -> str:
        return self.put(f"getelementptr i64, ptr {base}, i64 {index}")

    def load(self, base: str, index: int | str, kind: str = "i64") -> str:
        return self.put(f"load {kind}, ptr {self.at(base, index)}")

    def store(self, base: str, index: int | str, value: str, kind: str = "i64") -> None:
        self.line(f" store {kind} {value}, ptr {self.at(base, index)}")

    def acquire(self, base: str, index: int) -> str:
        return self.put(f"load atomic i64, ptr {self.at(base, index)} acquire, align 8")

    def release(self, base: str, index: int, value: str) -> None:
        self.line(f" store atomic i64 {value}, ptr {self.at(base, index)} release, align 8")

    def doubles(self, base: str, offset: str) -> str:
        return self.put(f"getelementptr double, ptr {base}, i64 {offset}")

    def set_double(self, base: str, offset: str, value: str) -> None:
        self.line(f" store double {value}, ptr {self.doubles(base, offset)}")

    def copy_blocks(self, source: str, target: str, size: str) -> None:
        self.line(f" call void @copy(ptr {source}, ptr {target}, i64 {size})")

    def test(self, how: str, a: str, b: str | int) -> str:
        return self.put(f"icmp {how} i64 {a}, {b}")

    def even(self, whole: str) -> str:
        return self.test("eq", self.put(f"and i64 {whole}, 1"), 0)

    def both(self, a: str, b: str) -> str:
        return self.put(f"and i1 {a}, {b}")

    def choose(self, condition: str, a: str, b: str, kind: str = "i64") -> str:
        return self.put(f"select i1 {condition}, {kind} {a}, {kind} {b}")

    def truth(self, condition: str, kind: str = "double") -> str:
        return self.put(f"{'uitofp' if kind == 'double' else 'zext'} i1 {condition} to {kind}")

    def number(self, whole: str) -> str:
        return self.put(f"sitofp i64 {whole} to double")

    def add(self, a: str, b: str | int) -> str:
        return self.put(f"add i64 {a}, {b}")

    def seconds(self, nanoseconds: str) -> str:
        return self.put(f"fmul double {self.number(nanoseconds)}, 0x3E112E0BE826D695")  # 1e-9

    def branch(self, condition: str, yes: str, no: str) -> None:
        self.line(f" br i1 {condition}, label %{yes}, label %{no}")


HELPERS: Final = """
declare i32 @clock_gettime(i32, ptr)
declare i32 @clock_nanosleep(i32, i32, ptr, ptr)
declare i32 @getppid()
declare i32 @kill(i32, i32)
define internal i64 @now() {
 %t = alloca [2 x i64]
 %r = call i32 @clock_gettime(i32 1, ptr %t)
 %s = load i64, ptr %t
 %p = getelementptr i64, ptr %t, i64 1
 %n = load i64, ptr %p
 %m = mul i64 %s, 1000000000
 %x = add i64 %m, %n
 ret i64 %x
}
define internal void @wait(i64 %until) {
 %t = alloca [2 x i64]
 %p = getelementptr i64, ptr %t, i64 1
 %s = udiv i64 %until, 1000000000
 %n = urem i64 %until, 1000000000
 store i64 %s, ptr %t
 store i64 %n, ptr %p
 br label %again
again:
 %r = call i32 @clock_nanosleep(i32 1, i32 1, ptr %t, ptr null)
 %interrupted = icmp eq i32 %r, 4
 br i1 %interrupted, label %again, label %end
end:
 ret void
}
define internal i64 @spin(i64 %until) {
 br label %again
again:
 %t = call i64 @now()
 %early = icmp slt i64 %t, %until
 br i1 %early, label %again, label %end
end:
 ret i64 %t
}
define internal void @copy(ptr %from, ptr %to, i64 %n) {
entry:
 %none = icmp sle i64 %n, 0
 br i1 %none, label %end, label %body
body:
 %i = phi i64 [0, %entry], [%j, %body]
 %p = getelementptr i64, ptr %from, i64 %i
 %q = getelementptr i64, ptr %to, i64 %i
 %v = load i64, ptr %p
 store i64 %v, ptr %q
 %j = add i64 %i, 1
 %done = icmp sge i64 %j, %n
 br i1 %done, label %end, label %body
end:
 ret void
}
"""


def _compute() -> str:
    """`ptr compute(set)`: what the kernel reads, in the next row of the ring, which it returns; and the kernel.

    It writes that row, which nobody reads before the ring's head moves on, and the new memory and outputs, which
    nobody reads before a tick has written them again: alone it changes nothing.
    """
    w = WordCode()
    w.line("entry:")
    blocks = {name: w.load("%set", SET[name], "ptr") for name in ("inputs", "parameters", "memory", "new", "outputs")}
    ring, rows = w.load("%set", SET["ring"], "ptr"), w.load("%set", SET["rows"], "ptr")
    place = w.put(f"urem i64 {w.load(ring, 0)}, {w.load('%set', SET['capacity'])}")
    row = w.doubles(rows, w.put(f"mul i64 {place}, {w.load('%set', SET['row_size'])}"))
    target = w.doubles(row, str(len(ROW_HEAD)))
    for name, size in (("inputs", "input_size"), ("parameters", "parameter_size"), ("memory", "memory_size")):
        count = w.load("%set", SET[size])
        w.copy_blocks(blocks[name], target, count)
        target = w.doubles(target, count)
    arguments = ", ".join(f"ptr {block}" for block in blocks.values())
    w.line(f" call void {w.load('%set', SET['kernel'], 'ptr')}({arguments})", f" ret ptr {row}")
    return w.function("internal ptr @compute(ptr %set) nounwind")


def _tick() -> str:
    """`ptr tick(loop, now, lost)`: take what the parent wrote, run the kernel, keep its memory; the row in the ring.

    All that the kernel reads stands in the row: from any row its outputs, and the memory of the next one, can be
    computed again.
    """
    w = WordCode()
    w.line("entry:")
    status, old, new = (w.load("%loop", LOOP[name], "ptr") for name in ("status", "set", "next"))
    w.branch(w.put(f"icmp ne ptr {new}, null"), "swap", "going")
    w.line("swap:")
    memories = [w.load(one, SET["memory"], "ptr") for one in (old, new)]
    w.copy_blocks(memories[0], memories[1], w.load(new, SET["safe_size"]))
    w.store("%loop", LOOP["set"], new, "ptr")
    w.store("%loop", LOOP["next"], "null", "ptr")
    w.release(status, STATUS["running"], w.load(new, SET["number"]))
    w.line(" br label %going", "going:", f" %set = phi ptr [{old}, %entry], [{new}, %swap]")
    blocks = {name: w.load("%set", SET[name], "ptr") for name in ("inputs", "parameters", "memory", "new")}
    scratch, controls = w.load("%set", SET["scratch"], "ptr"), w.load("%set", SET["controls"], "ptr")
    inputs, memory = blocks["inputs"], blocks["memory"]
    count = w.load("%set", SET["count"])
    measured = w.doubles(inputs, w.load("%set", SET["measured_at"]))
    w.copy_blocks(w.load("%loop", LOOP["measured"], "ptr"), measured, w.load("%set", SET["measured_size"]))

    # Parameters, under a sequence lock: what is being written is taken in the next tick.
    size = w.load("%set", SET["parameter_size"])
    sequence = w.acquire(controls, CONTROLS["parameters"])
    w.branch(w.both(w.test("ne", sequence, w.load("%set", SET["seen"])), w.even(sequence)), "take", "parameters")
    w.line("take:")
    w.copy_blocks(w.load("%set", SET["new_parameters"], "ptr"), scratch, size)
    w.line(" fence acquire")
    w.branch(w.test("eq", w.acquire(controls, CONTROLS["parameters"]), sequence), "keep", "parameters")
    w.line("keep:")
    w.copy_blocks(scratch, blocks["parameters"], size)
    w.store("%set", SET["seen"], sequence)
    w.line(" br label %parameters", "parameters:")
    w.line(" %changed = phi double [0.0, %going], [0.0, %take], [1.0, %keep]")

    # The sample, under the table's sequence lock: what is being written is taken in the next tick.
    reference = w.doubles(inputs, w.load("%set", SET["reference_at"]))
    width, tables = w.load("%set", SET["reference_size"]), w.load("%set", SET["table_count"])
    next_at = w.load("%set", SET["next_at"])
    w.branch(w.test("sge", next_at, 0), "of_task", "lookup")
    w.line("of_task:")
    number = w.put(f"load double, ptr {w.doubles(memory, next_at)}")
    since = w.put(f"load double, ptr {w.doubles(memory, w.load('%set', SET['ticks_at']))}")
    phase, ticks = w.put(f"fptosi double {number} to i64"), w.put(f"fptosi double {since} to i64")
    w.line(" br label %lookup", "lookup:")
    w.line(f" %phase = phi i64 [0, %parameters], [{phase}, %of_task]")
    w.line(f" %ticks = phi i64 [{count}, %parameters], [{ticks}, %of_task]")
    w.branch(w.test("ult", "%phase", tables), "entries", "none")
    w.line("none:")
    w.store("%set", SET["valid"], "0")
    w.line(" br label %sampled", "entries:")
    entry = w.at(w.load("%set", SET["tables"], "ptr"), w.put(f"mul i64 %phase, {len(TABLE)}"))
    w.release(entry, TABLE["ticks"], "%ticks")
    w.branch(w.test("eq", "%ticks", 0), "void_it", "known")
    w.line("void_it:")
    fixed = w.test("ne", w.load(entry, TABLE["fixed"]), 0)
    void = w.choose(fixed, "0", w.acquire(entry, TABLE["version"]))
    for name in ("seen", "voided"):
        w.release(entry, TABLE[name], void)
    w.store("%set", SET["valid"], "0")
    w.line(" br label %known", "known:")
    lock = w.acquire(entry, TABLE["lock"])
    version = w.load(entry, TABLE["version"])
    w.branch(w.both(w.even(lock), w.test("ne", version, w.load(entry, TABLE["voided"]))), "row", "old")
    w.line("row:")
    arrived, received = w.load(entry, TABLE["arrived"]), w.load(entry, TABLE["received"])
    came = w.choose(w.test("sge", arrived, 0), arrived, "%ticks")
    began = w.choose(w.test("ne", version, w.load(entry, TABLE["seen"])), came, w.load(entry, TABLE["began"]))
    k, last = w.put(f"sub i64 %ticks, {began}"), w.add(w.load(entry, TABLE["length"]), -1)
    k = w.choose(w.test("slt", k, last), k, last)
    k = w.choose(w.test("sgt", k, 0), k, "0")
    row = w.put(f"mul i64 {w.add(w.load(entry, TABLE['first']), k)}, {width}")
    w.copy_blocks(w.doubles(w.load("%set", SET["table_rows"], "ptr"), row), scratch, width)
    w.line(" fence acquire")
    w.branch(w.test("eq", w.acquire(entry, TABLE["lock"]), lock), "fresh", "old")
    w.line("fresh:")
    w.copy_blocks(scratch, reference, width)
    w.store(entry, TABLE["began"], began)
    w.store(entry, TABLE["seen"], version)
    w.store("%set", SET["received"], received)
    w.store("%set", SET["valid"], "1")
    w.line(" br label %old", "old:")
    age = w.seconds(w.put(f"sub i64 %now, {w.load('%set', SET['received'])}"))
    grows = w.both(w.test("ne", w.load(entry, TABLE["stream"]), 0), w.put(f"fcmp ogt double {age}, 0.0"))
    age = w.choose(grows, age, "0.0", "double")
    w.line(" br label %sampled", "sampled:", f" %age = phi double [0.0, %none], [{age}, %old]")
    valid = w.number(w.load("%set", SET["valid"]))

    # Signals, in the order of `control.safety.SIGNALS`, and the time.
    first = w.test("eq", count, 0)
    begins = w.both(first, w.test("ne", w.load("%set", SET["begins"]), 0))
    asked, recovered = w.acquire(status, STATUS["recover"]), w.load("%loop", LOOP["recovered"])
    recovers = w.test("ne", asked, recovered)
    w.store("%loop", LOOP["recovered"], asked)
    given = {name: w.load(controls, CONTROLS[name], "double") for name in ("hold_after", "stop_after", "over")}
    # Another robot of the group stopped, or the watchdog does not look: only where commands go out.
    control = w.test("ne", w.acquire(status, STATUS["control"]), 0)
    group = w.load("%loop", LOOP["group"], "ptr")
    stopped, known = w.acquire(group, 0), w.load("%loop", LOOP["known"])
    w.store("%loop", LOOP["known"], w.choose(control, known, stopped))
    alone = w.test("sgt", w.put(f"sub i64 %now, {w.acquire(status, STATUS['watched'])}"), UNSEEN)
    alone = w.both(alone, w.test("ne", w.acquire(status, STATUS["armed"]), 0))
    outside = w.choose(w.both(control, w.test("ne", stopped, known)), str(PARTNER), "0")
    outside = w.choose(alone, str(UNWATCHED), outside)
    holds = w.truth(w.test("ne", w.acquire(status, STATUS["hold"]), 0))
    signals = [
        valid, "%age", given["hold_after"], given["stop_after"], holds, w.truth(recovers), w.truth(begins),
        given["over"], "%changed", w.number(outside), w.number("%lost"), w.truth(control),
    ]  # fmt: skip
    at = w.load("%set", SET["signals_at"])
    for i, value in enumerate(signals):
        w.set_double(inputs, w.add(at, i), value)
    time = w.put(f"fmul double {w.number(count)}, {w.load('%set', SET['dt'], 'double')}")
    w.set_double(inputs, w.load("%set", SET["t_at"]), time)

    w.branch(first, "begin", "step")
    w.line("begin:")
    size = w.load("%set", SET["memory_size"])
    starter = w.load("%set", SET["start"], "ptr")
    fixed = f"ptr {inputs}, ptr {blocks['parameters']}, ptr {memory}"
    w.line(f" call void {starter}({fixed}, ptr {blocks['new']}, ptr {scratch})")
    w.copy_blocks(scratch, memory, size)
    w.line(" br label %step", "step:")
    row = w.put("call ptr @compute(ptr %set)")
    w.copy_blocks(blocks["new"], memory, w.load("%set", SET["memory_size"]))
    w.store("%set", SET["count"], w.add(count, 1))
    w.line(f" ret ptr {row}")
    return w.function("internal ptr @tick(ptr %loop, i64 %now, i64 %lost) nounwind")


def _loop() -> str:
    """`i64 loop(loop)`: until it is asked to quit (0), or the read (1) or the write (2) fails."""
    w = WordCode()
    w.line("entry:")
    status, buffer, user = (w.load("%loop", LOOP[name], "ptr") for name in ("status", "measured", "user"))
    read, write = w.load("%loop", LOOP["read"], "ptr"), w.load("%loop", LOOP["write"], "ptr")
    period = w.load("%loop", LOOP["period"])
    w.line(" br label %again", "again:")
    w.branch(w.test("ne", w.load("%loop", LOOP["host_paced"]), 0), "sleep", "ask")
    w.line("sleep:")
    deadline = w.add(w.load("%loop", LOOP["deadline"]), period)
    lead = w.load("%loop", LOOP["lead"])
    w.line(f" call void @wait(i64 {w.put(f'sub i64 {deadline}, {lead}')})")
    spare = w.put(f"sub i64 {deadline}, {w.put('call i64 @now()')}")
    w.branch(w.test("sgt", spare, w.load("%loop", LOOP["took"])), "warm", "awake")
    w.line("warm:")
    w.put(f"call ptr @compute(ptr {w.load('%loop', LOOP['set'], 'ptr')})")
    w.line(" br label %awake", "awake:")
    late = w.put(f"sub i64 {w.put(f'call i64 @spin(i64 {deadline})')}, {deadline}")
    some = w.choose(w.test("sgt", late, 0), late, "0")
    missed = w.put(f"sdiv i64 {some}, {period}")
    w.store("%loop", LOOP["deadline"], w.add(deadline, w.put(f"mul i64 {missed}, {period}")))
    w.line(" br label %ask", "ask:")
    w.line(f" %missed = phi i64 [0, %again], [{missed}, %awake]", f" %behind = phi i64 [0, %again], [{late}, %awake]")
    w.release(status, STATUS["where"], "1")
    asked = w.put("call i64 @now()")
    failed = w.put(f"call i64 {read}(ptr {user}, ptr {buffer})")
    w.branch(w.test("ne", failed, 0), "unread", "got")
    w.line("got:")
    began = w.put("call i64 @now()")
    w.release(status, STATUS["where"], "2")
    # A robot that keeps time: what lies between two states beyond one period was missed.
    since = w.put(f"sub i64 {began}, {w.load('%loop', LOOP['last'])}")
    half = w.put(f"sdiv i64 {period}, 2")
    gaps = w.add(w.put(f"sdiv i64 {w.add(since, half)}, {period}"), -1)
    gaps = w.choose(w.test("sgt", gaps, 0), gaps, "0")
    host = w.test("ne", w.load("%loop", LOOP["host_paced"]), 0)
    lost = w.choose(host, "%missed", gaps)
    behind = w.choose(host, "%behind", w.put(f"sub i64 {since}, {period}"))
    w.store("%loop", LOOP["last"], began)
    w.release(status, STATUS["lost"], w.add(w.load(status, STATUS["lost"]), lost))
    row = w.put(f"call ptr @tick(ptr %loop, i64 {began}, i64 {lost})")
    ended = w.put("call i64 @now()")
    set_ = w.load("%loop", LOOP["set"], "ptr")
    outputs = w.load(set_, SET["outputs"], "ptr")
    sends = w.test("ne", w.load(set_, SET["sends"]), 0)
    w.branch(w.both(sends, w.test("ne", w.acquire(status, STATUS["control"]), 0)), "send", "sent")
    w.line("send:")
    w.release(status, STATUS["where"], "3")
    command = w.doubles(outputs, w.load(set_, SET["command_at"]))
    refused = w.put(f"call i64 {write}(ptr {user}, ptr {command})")
    w.branch(w.test("ne", refused, 0), "unwritten", "sent")
    w.line("sent:", " %went = phi double [0.0, %got], [1.0, %send]")
    over = w.put("call i64 @now()")
    w.release(status, STATUS["where"], "0")

    computing, reading = w.put(f"sub i64 {ended}, {began}"), w.put(f"sub i64 {began}, {asked}")
    driving = w.add(w.put(f"sub i64 {over}, {ended}"), reading)
    w.store("%loop", LOOP["took"], computing)
    slowest = w.load(status, STATUS["slowest"])
    w.store(status, STATUS["slowest"], w.choose(w.test("sgt", computing, slowest), computing, slowest))
    slow = w.truth(w.test("sgt", computing, period), "i64")
    w.store(status, STATUS["overruns"], w.add(w.load(status, STATUS["overruns"]), slow))
    ticks = w.load(status, STATUS["ticks"])
    times = (w.seconds(part) for part in (began, behind, computing, driving))
    values = [w.number(ticks), *times, w.number(lost), "%went"]
    for i, value in enumerate(values):
        w.set_double(row, str(i), value)
    size = w.load(set_, SET["output_size"])
    last = w.put(f"sub i64 {w.load(set_, SET['row_size'])}, {size}")
    w.copy_blocks(outputs, w.doubles(row, last), size)
    ring = w.load(set_, SET["ring"], "ptr")
    w.release(ring, 0, w.add(w.load(ring, 0), 1))
    w.release(status, STATUS["ticks"], w.add(ticks, 1))
    w.release(status, STATUS["heartbeat"], over)
    latched = w.put(f"load double, ptr {w.doubles(outputs, w.load(set_, SET['fault_at']))}")
    code = w.put(f"fptosi double {latched} to i64")
    before = w.load(status, STATUS["latched"])
    w.release(status, STATUS["latched"], code)
    stops = w.both(w.test("eq", before, 0), w.both(w.test("ne", code, 0), w.test("ne", code, PARTNER)))
    w.branch(w.both(stops, w.test("ne", w.acquire(status, STATUS["control"]), 0)), "tell", "going")
    w.line("tell:")
    w.release(w.load("%loop", LOOP["group"], "ptr"), 0, over)
    w.store("%loop", LOOP["known"], over)
    w.line(" br label %going", "going:")
    w.branch(w.test("ne", w.acquire(status, STATUS["quit"]), 0), "end", "again")
    w.line("end:", " ret i64 0", "unread:", " ret i64 1", "unwritten:", " ret i64 2")
    return w.function("i64 @loop(ptr %loop) nounwind")


def _watch() -> str:
    """`i64 watch(status, group, pid, silent, hung)`: end the parent where its loop does not tick."""
    w = WordCode()
    w.line("entry:", " br label %again", "again:")
    w.release("%status", STATUS["watched"], w.put("call i64 @now()"))
    w.line(f" call void @wait(i64 {w.add(w.put('call i64 @now()'), WATCH_EVERY)})")
    parent = w.put(f"sext i32 {w.put('call i32 @getppid()')} to i64")
    over = w.put(f"or i1 {w.test('ne', w.acquire('%status', STATUS['dead']), 0)}, {w.test('ne', parent, '%pid')}")
    w.branch(over, "end", "look")
    w.line("look:")
    beat = w.acquire("%status", STATUS["heartbeat"])
    now = w.put("call i64 @now()")
    late = w.test("sgt", w.put(f"sub i64 {now}, {beat}"), w.acquire("%status", STATUS["patience"]))
    w.branch(w.both(late, w.test("ne", w.acquire("%status", STATUS["armed"]), 0)), "late", "again")
    w.line("late:")
    code = w.choose(w.test("eq", w.acquire("%status", STATUS["where"]), 1), "%silent", "%hung")
    w.release("%status", STATUS["fault"], code)
    process = w.put("trunc i64 %pid to i32")
    w.line(f" {w.name()} = call i32 @kill(i32 {process}, i32 9)")
    w.release("%group", 0, now)
    w.line(f" ret i64 {code}", "end:")
    dead, armed = w.acquire("%status", STATUS["dead"]), w.acquire("%status", STATUS["armed"])
    w.branch(w.both(w.test("eq", dead, 0), w.test("ne", armed, 0)), "killed", "left")
    w.line("killed:")  # by somebody else, while it acted
    w.release("%group", 0, w.put("call i64 @now()"))
    w.line(" br label %left", "left:", " ret i64 0")
    return w.function("i64 @watch(ptr %status, ptr %group, i64 %pid, i64 %silent, i64 %hung) nounwind")


def _plant() -> str:
    """A model plant as a robot: its read and its write, which advances it by one period.

    A read that comes late finds it moved on by the periods that were missed, under the last command.
    """
    w = WordCode()
    parts = ("inputs", "parameters", "memory", "new")
    w.line("entry:")
    wrote, period = w.load("%plant", PLANT["wrote"]), w.load("%plant", PLANT["period"])
    since = w.put(f"sub i64 {w.put('call i64 @now()')}, {wrote}")
    most = w.put(f"sdiv i64 {w.put(f'mul i64 {period}, 3')}, 4")
    missed = w.put(f"sdiv i64 {w.put(f'sub i64 {since}, {most}')}, {period}")
    missed = w.choose(w.test("slt", missed, MAX_CATCH_UP), missed, str(MAX_CATCH_UP))
    missed = w.choose(w.test("ne", wrote, 0), missed, "0")
    w.store("%plant", PLANT["wrote"], "0")
    w.line(" br label %again", "again:", " %i = phi i64 [0, %entry], [%next, %late]")
    w.branch(w.test("slt", "%i", missed), "late", "measure")
    w.line("late:", " %next = add i64 %i, 1", " call void @advance(ptr %plant)", " br label %again", "measure:")
    fixed = ", ".join(f"ptr {w.load('%plant', PLANT[name], 'ptr')}" for name in parts)
    w.line(f" call void {w.load('%plant', PLANT['measure'], 'ptr')}({fixed}, ptr %measured)", " ret i64 0")
    reading = w.function("i64 @plant_read(ptr %plant, ptr %measured) nounwind")
    w.line("entry:")
    w.copy_blocks("%command", w.load("%plant", PLANT["inputs"], "ptr"), w.load("%plant", PLANT["command_size"]))
    w.line(" call void @advance(ptr %plant)")
    w.store("%plant", PLANT["wrote"], w.put("call i64 @now()"))
    w.line(" ret i64 0")
    writing = w.function("i64 @plant_write(ptr %plant, ptr %command) nounwind")
    w.line("entry:")
    inputs, parameters, memory, new = (w.load("%plant", PLANT[name], "ptr") for name in parts)
    size, count = w.load("%plant", PLANT["command_size"]), w.load("%plant", PLANT["count"])
    now = w.put(f"fmul double {w.number(count)}, {w.load('%plant', PLANT['dt'], 'double')}")
    w.set_double(inputs, size, now)
    w.store("%plant", PLANT["count"], w.add(count, 1))
    outputs = w.load("%plant", PLANT["outputs"], "ptr")
    fixed = f"ptr {inputs}, ptr {parameters}, ptr {memory}, ptr {new}, ptr {outputs}"
    w.line(f" call void {w.load('%plant', PLANT['step'], 'ptr')}({fixed})")
    w.copy_blocks(new, memory, w.load("%plant", PLANT["memory_size"]))
    repeats = w.load("%plant", PLANT["repeats"])
    w.line(" br label %again", "again:", " %i = phi i64 [0, %entry], [%next, %inner]")
    w.branch(w.test("slt", "%i", repeats), "inner", "end")
    w.line("inner:", " %next = add i64 %i, 1")
    w.line(f" call void {w.load('%plant', PLANT['substep'], 'ptr')}({fixed})")
    w.copy_blocks(new, memory, w.load("%plant", PLANT["memory_size"]))
    w.line(" br label %again", "end:", " ret void")
    return "\n".join([w.function("internal void @advance(ptr %plant) nounwind"), reading, writing])


def _text() -> str:
    return "\n".join([HELPERS, _compute(), _tick(), _loop(), _watch(), _plant()])


def symbols_of(names: Sequence[str]) -> dict[str, int]:
    """Addresses of functions of the C library, for code that calls them."""
    library = ctypes.CDLL(None)
    return {name: ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0 for name in names}


@functools.cache
def servo_code() -> NativeModule:
    """The loop, the watchdog and a model plant's read and write, linked into this process."""
    return servo_module(symbols_of(SYMBOLS))


def servo_module(symbols: Mapping[str, int]) -> NativeModule:
    """The same with other functions in place of the system's, such as a clock of one's own."""
    return compiled(b"servo loop", _text, NAMES, symbols=symbols)


def struct_of(names: dict[str, int], values: dict[str, int | float]) -> Any:
    """Words by name as they lie in memory."""
    import numpy as np

    words = np.zeros(len(names), dtype=np.int64)
    for name, value in values.items():
        if isinstance(value, float):
            words[names[name] : names[name] + 1].view(np.float64)[0] = value
        else:
            words[names[name]] = value
    return words
