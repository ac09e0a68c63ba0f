"""A robot on UDP in native code: a read keeps the newest of the packets that have arrived, a write sends one.

A packet is words of 64 bits, the lowest byte first: a head (four letters, version, kind, number of joints), the
session, a sequence number, a time and a mode; then doubles. `UDP` are the words that these functions work on.
"""

from __future__ import annotations

import functools
from typing import Final

from taut.codegen.native import NativeModule, compiled
from taut.codegen.servo_loop import HELPERS, SYMBOLS, WordCode, numbered, symbols_of

UDP: Final = numbered(
    "socket",
    "wait",  # [ns] for a state; 0 where the host keeps the time
    "step",  # [s] by which a read without a state extrapolates the last one
    "state_head", "listen_head", "command_head", "session",
    "packet", "state_size",  # where packets are received; doubles of a state
    "n", "kept",  # the newest state
    "sent", "command_size", "out",  # the packet that is sent, its doubles, its sequence number
    "controls",  # whether commands go out; otherwise every read asks for a state
    "limit",  # reads in a row without a state that end the motion
    "newest", "window",  # sequence number, and which of the 64 up to it have arrived
    "mode", "missed",  # of the newest state; reads in a row without one
    "received", "lost", "late", "doubled", "malformed", "extrapolated", "round_trip",
)  # fmt: skip
HEADER: Final = 5  # words before the doubles of a packet
BUFFER: Final = 1024  # words for a packet
MAX_PACKETS: Final = 64  # that a read takes: a flood delays no tick
MAX_AHEAD: Final = 2**20  # by which a sequence number may run ahead
NAMES: Final = ("udp_read", "udp_write")
_DONTWAIT, _NOSIGNAL, _IN = 0x40, 0x4000, 1 << 32
_DECLARED: Final = """
declare i64 @recv(i32, ptr, i64, i32)
declare i64 @send(i32, ptr, i64, i32)
declare i32 @ppoll(ptr, i64, ptr, ptr)
"""


def _post() -> str:
    """`void post(udp, head, doubles)`: send a packet; what the network refuses is lost."""
    w = WordCode()
    w.line("entry:")
    packet, number = w.load("%udp", UDP["sent"], "ptr"), w.add(w.load("%udp", UDP["out"]), 1)
    w.store("%udp", UDP["out"], number)
    now = w.put("call i64 @now()")
    for i, word in enumerate(("%head", w.load("%udp", UDP["session"]), number, now, "0")):
        w.store(packet, i, word)
    size = w.put(f"mul i64 {w.add('%doubles', HEADER)}, 8")
    socket = w.put(f"trunc i64 {w.load('%udp', UDP['socket'])} to i32")
    flags = _DONTWAIT | _NOSIGNAL
    w.line(f" {w.name()} = call i64 @send(i32 {socket}, ptr {packet}, i64 {size}, i32 {flags})", " ret void")
    return w.function("internal void @post(ptr %udp, i64 %head, i64 %doubles) nounwind")


def _read() -> str:
    """`i64 udp_read(udp, measured)`: 0, or 1 where the robot is silent or has stopped by itself."""
    w = WordCode()

    def count(name: str, by: str | int = 1) -> None:
        w.store("%udp", UDP[name], w.add(w.load("%udp", UDP[name]), by))

    w.line("entry:", " %poll = alloca i64", " %time = alloca [2 x i64]")
    controls = w.test("ne", w.load("%udp", UDP["controls"]), 0)
    w.branch(controls, "wait", "ask")
    w.line("ask:")
    head = w.load("%udp", UDP["listen_head"])
    w.line(f" call void @post(ptr %udp, i64 {head}, i64 0)", " br label %wait", "wait:")
    word = w.load("%udp", UDP["socket"])
    socket, waited = w.put(f"trunc i64 {word} to i32"), w.load("%udp", UDP["wait"])
    w.store("%poll", 0, w.put(f"or i64 {word}, {_IN}"))
    w.store("%time", 0, "0")
    w.store("%time", 1, waited)
    w.line(f" {w.name()} = call i32 @ppoll(ptr %poll, i64 1, ptr %time, ptr null)")
    packet, kept = (w.load("%udp", UDP[name], "ptr") for name in ("packet", "kept"))
    doubles, n = w.load("%udp", UDP["state_size"]), w.load("%udp", UDP["n"])
    size, room = w.put(f"mul i64 {w.add(doubles, HEADER)}, 8"), 8 * BUFFER
    w.line(" br label %next", "next:")
    w.line(" %i = phi i64 [0, %wait], [%j, %keep], [%j, %old], [%j, %malformed]")
    w.line(" %new = phi i1 [false, %wait], [true, %keep], [%new, %old], [%new, %malformed]", " %j = add i64 %i, 1")
    w.branch(w.test("sgt", "%i", MAX_PACKETS - 1), "done", "take")
    w.line("take:")
    got = w.put(f"call i64 @recv(i32 {socket}, ptr {packet}, i64 {room}, i32 {_DONTWAIT})")
    w.branch(w.test("slt", got, 0), "done", "look")
    w.line("look:")
    good = w.test("eq", got, size)
    for i, name in enumerate(("state_head", "session")):
        good = w.both(good, w.test("eq", w.load(packet, i), w.load("%udp", UDP[name])))
    number = w.load(packet, 2)
    newest, window = w.load("%udp", UDP["newest"]), w.load("%udp", UDP["window"])
    ahead = w.put(f"sub i64 {number}, {newest}")
    good = w.both(good, w.both(w.test("sgt", number, 0), w.test("sle", ahead, MAX_AHEAD)))
    w.branch(good, "sort", "malformed")
    w.line("malformed:")
    count("malformed")
    w.line(" br label %next", "sort:")
    w.branch(w.test("sgt", ahead, 0), "keep", "old")
    w.line("keep:")
    count("received")
    count("lost", w.add(ahead, -1))
    near = w.test("slt", ahead, 64)
    shifted = w.put(f"shl i64 {window}, {w.choose(near, ahead, '0')}")
    w.store("%udp", UDP["window"], w.put(f"or i64 {w.choose(near, shifted, '0')}, 1"))
    w.store("%udp", UDP["newest"], number)
    w.store("%udp", UDP["mode"], w.load(packet, 4))
    sent, slowest = w.load(packet, 3), w.load("%udp", UDP["round_trip"])
    trip = w.choose(w.test("sgt", sent, 0), w.put(f"sub i64 {w.put('call i64 @now()')}, {sent}"), "0")
    w.store("%udp", UDP["round_trip"], w.choose(w.test("sgt", trip, slowest), trip, slowest))
    w.copy_blocks(w.at(packet, HEADER), kept, doubles)
    w.line(" br label %next", "old:")  # counted as lost when a newer one came; it is not, the first time
    behind = w.put(f"sub i64 0, {ahead}")
    near = w.test("slt", behind, 64)
    bit = w.put(f"shl i64 1, {w.choose(near, behind, '0')}")
    again = w.both(near, w.test("ne", w.put(f"and i64 {window}, {bit}"), 0))
    w.store("%udp", UDP["window"], w.choose(near, w.put(f"or i64 {window}, {bit}"), window))
    count("doubled", w.truth(again, "i64"))
    count("late", w.truth(w.put(f"xor i1 {again}, true"), "i64"))
    count("lost", w.choose(w.both(near, w.put(f"xor i1 {again}, true")), "-1", "0"))
    w.line(" br label %next", "done:")
    missed = w.choose("%new", "0", w.add(w.load("%udp", UDP["missed"]), 1))
    w.store("%udp", UDP["missed"], missed)
    w.branch("%new", "give", "extrapolate")
    w.line("extrapolate:")  # q = q + v step: the last state held at constant velocity
    count("extrapolated")
    step = w.load("%udp", UDP["step"], "double")
    w.line(" br label %joint", "joint:", " %k = phi i64 [0, %extrapolate], [%l, %joint]", " %l = add i64 %k, 1")
    q, v = (w.doubles(kept, at) for at in ("%k", w.add("%k", n)))
    moved = w.put(f"fmul double {w.put(f'load double, ptr {v}')}, {step}")
    moved = w.put(f"fadd double {w.put(f'load double, ptr {q}')}, {moved}")
    w.line(f" store double {moved}, ptr {q}")
    w.branch(w.test("slt", "%l", n), "joint", "give")
    w.line("give:")
    w.copy_blocks(kept, "%measured", doubles)
    silent = w.test("sge", missed, w.load("%udp", UDP["limit"]))
    stopped = w.both(controls, w.test("sgt", w.load("%udp", UDP["mode"]), 1))
    w.line(f" ret i64 {w.truth(w.put(f'or i1 {silent}, {stopped}'), 'i64')}")
    return w.function("i64 @udp_read(ptr %udp, ptr %measured) nounwind")


def _write() -> str:
    """`i64 udp_write(udp, command)`: always 0; a robot that cannot be reached is silent to the read."""
    w = WordCode()
    w.line("entry:")
    size, packet = w.load("%udp", UDP["command_size"]), w.load("%udp", UDP["sent"], "ptr")
    w.copy_blocks("%command", w.at(packet, HEADER), size)
    head = w.load("%udp", UDP["command_head"])
    w.line(f" call void @post(ptr %udp, i64 {head}, i64 {size})", " ret i64 0")
    return w.function("i64 @udp_write(ptr %udp, ptr %command) nounwind")


def _text() -> str:
    return "\n".join([HELPERS, _DECLARED, _post(), _read(), _write()])


@functools.cache
def udp_code() -> NativeModule:
    """The read and the write, linked into this process."""
    return compiled(b"udp link", _text, NAMES, symbols=symbols_of((*SYMBOLS, "send", "recv", "ppoll")))
