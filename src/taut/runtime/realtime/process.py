"""The loop's process: it has the robot's driver, compiled ticks and their layout, and nothing of the user's law.

The main thread is in native code, which calls the driver; another one takes messages of the parent. Its first act is
to fork the watchdog, which has nothing but the status and ends it where it does not tick. Started as
`python -m taut.runtime.realtime.process FD`, with one end of a socket pair.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import gc
import importlib
import inspect
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.base.checks import instance_of
from taut.base.errors import TautError, UsageError
from taut.base.types import Float64Array
from taut.codegen import native
from taut.codegen.program import Block
from taut.codegen.servo_loop import FUNCTIONS, LOOP, PLANT, PLANT_FUNCTIONS, SET, STATUS, servo_code, struct_of
from taut.control.faults import CODES
from taut.maths.snapshot import measurement_shapes
from taut.runtime.realtime.ring import Ring
from taut.runtime.realtime.shared import Shared
from taut.runtime.robots.driver import DriverError, NativeCalls, RobotDriver, RobotInfo

WATCHDOG: Final = (0.07, 3.0)  # [s], [periods] without a tick: after the longer one the process is ended, 5 ms later
PRIORITY: Final = 80  # of SCHED_FIFO
WARM_UP: Final = 200  # ticks of a set before it may act
LEAD: Final = (1e-4, 0.1)  # [s], [periods] before a deadline at which the loop wakes, the shorter; a tenth of a core
MAX_SHARE: Final = 0.5  # of a period that a tick may take
STOP_TIME: Final = 2.0  # [s] for the controlled stop where nobody waits for it
PAGE: Final = 512  # [doubles]
STANDING: Final = 0.01  # [rad/s | m/s]
PARENT: Final = 0.1  # [s] between two looks at whether the parent is there
CALLBACK: Final = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)
# It keeps the interpreter's lock: for this a driver that waits under the lock, such as Franka's, would be timed too.
KERNEL: Final = ctypes.PYFUNCTYPE(None, *[ctypes.c_void_p] * 5)


class PlantDriver(RobotDriver):
    """A model plant in native code."""

    def __init__(self, given: Mapping[str, Any], info: RobotInfo) -> None:
        self._info = info
        code, memory = native.link(given["code"], PLANT_FUNCTIONS), given["memory"]
        blocks = [
            np.zeros(given["input_size"]),
            given["parameters"].copy(),
            memory.copy(),
            memory.copy(),
            np.zeros(1),
        ]
        pointers = zip(("inputs", "parameters", "memory", "new", "outputs"), blocks, strict=True)
        values = {**given["layout"], **{name: array.ctypes.data for name, array in pointers}}
        self._words = struct_of(PLANT, {**values, **{name: code[name] for name in PLANT_FUNCTIONS}})
        self._kept = code, blocks

    def open(self) -> RobotInfo:
        return self._info

    def native(self) -> NativeCalls:
        code, user = servo_code(), int(self._words.ctypes.data)
        return NativeCalls(
            read=code["plant_read"], write=code["plant_write"], user=user, failure=lambda: DriverError("no failure")
        )

    def end(self) -> None:
        self._words[PLANT["wrote"]] = 0  # it stands still as long as nobody moves it on

    def read(self, measured: Mapping[str, Float64Array]) -> None: ...
    def write(self, command: Float64Array) -> None: ...
    def begin(self) -> None: ...
    def close(self) -> None: ...


class Calls:
    """A driver's read and write as the native loop calls them."""

    def __init__(self, driver: RobotDriver, measured: Mapping[str, Float64Array], command: Float64Array) -> None:
        self.error: BaseException | None = None
        self._native = driver.native()
        if self._native is not None:
            self.user, self.read, self.write = self._native.user, self._native.read, self._native.write
            return
        read, write = driver.read, driver.write

        def reading(_: int, __: int) -> int:
            try:
                read(measured)
            except BaseException as error:  # whatever it is must end the motion
                self.error = error
                return 1
            return 0

        def writing(_: int, address: int) -> int:
            try:
                ctypes.memmove(command.ctypes.data, address, command.nbytes)
                write(command)
            except BaseException as error:
                self.error = error
                return 2
            return 0

        self._kept = CALLBACK(reading), CALLBACK(writing)
        self.user = 0
        self.read, self.write = (int(ctypes.cast(one, ctypes.c_void_p).value or 0) for one in self._kept)

    def failure(self) -> BaseException | None:
        """Why one of them failed."""
        return self.error if self._native is None else self._native.failure()


class LoadedSet:
    """A compiled tick in this process."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.code = native.link(given["code"], FUNCTIONS)
        self.number: int = given["number"]
        sizes = given["layout"]
        self.ring, self.controls = Ring.attach(given["ring"]), Shared.attach(given["controls"])
        self.ring.rows.reshape(-1)[::PAGE] = 0.0  # its first write to a page would delay a tick
        blocks = {f"{name}s": np.zeros(max(1, sizes[f"{name}_size"])) for name in ("input", "output")}
        blocks |= {name: np.zeros(max(1, sizes["memory_size"])) for name in ("memory", "new")}
        blocks["parameters"] = given["parameters"].copy()
        blocks["scratch"] = np.zeros(max(len(block) for block in blocks.values()) + sizes["reference_size"])
        at, base = given["places"], self.controls.address
        values: dict[str, Any] = {
            **sizes,
            **{name: block.ctypes.data for name, block in blocks.items()},
            **{name: self.code[name] for name in FUNCTIONS},
            **{name: base + 8 * at[name] for name in ("new_parameters", "tables", "table_rows")},
            "table_count": at["table_count"],
            "controls": base,
            "ring": self.ring.header.ctypes.data,
            "rows": self.ring.rows.ctypes.data,
            "capacity": self.ring.capacity,
            **{name: given[name] for name in ("number", "begins", "sends")},
        }
        self.words = struct_of(SET, values)
        self.address, self.blocks = int(self.words.ctypes.data), blocks

    def warm_up(self, period: float) -> None:
        """Run the tick, whose numbers do not count; DriverError where it takes longer than the period [s] allows."""
        kernel, times = KERNEL(self.code["kernel"]), []
        arguments = [self.blocks[name].ctypes.data for name in ("inputs", "parameters", "memory", "new", "outputs")]
        for _ in range(WARM_UP):
            began = time.perf_counter()
            kernel(*arguments)
            times.append(time.perf_counter() - began)
        taken = sorted(times)[WARM_UP // 2]
        if taken > MAX_SHARE * period:
            raise DriverError(
                f"a tick takes {1e6 * taken:.0f} us here, more than half of the period of {1e6 * period:.0f} us; "
                "take a lower rate, or a smaller law",
                kind="rejected",
            )


class Process:
    """The loop's process, from its first message to its last."""

    def __init__(self, connection: Connection) -> None:
        self._mail = connection
        self._jobs: queue.Queue[tuple[str, Any, int]] = queue.Queue()  # kind, argument, number
        self._sets: list[LoadedSet] = []
        self._lock = threading.Lock()
        self._parent = os.getppid()

    def run(self) -> None:
        """Take the first message, connect, and work until the parent ends it or is gone."""
        kind, hello, self._hello = self._mail.recv()
        if kind == "close":
            return
        self._status, self._group = Shared.attach(hello["status"]), Shared.attach(hello["group"])
        self._words = self._status.view
        watchdog = self._watched()
        try:
            self._serve(hello, _real_time(PRIORITY))  # which threads of the driver inherit
        except BaseException as error:
            self._answer("error", self._hello, *_in_words(error))
        self._words[STATUS["dead"]] = 1
        os.waitpid(watchdog, 0)

    def _watched(self) -> int:
        """The watchdog. It is there before there is a robot, so that it shares no connection of it."""
        watch = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_void_p] * 2, *[ctypes.c_int64] * 3)(servo_code()["watch"])
        pid = os.getpid()
        self._words[STATUS["watched"]] = time.monotonic_ns()
        child = os.fork()
        if child == 0:
            os.closerange(3, os.sysconf("SC_OPEN_MAX"))
            _real_time(PRIORITY + 1)
            codes = CODES["silent"], CODES["watchdog"]
            watch(self._status.address, self._group.address, pid, *codes)
            os._exit(0)
        return child

    def _serve(self, hello: Mapping[str, Any], notes: list[str]) -> None:
        if "plant" in hello:
            driver: RobotDriver = PlantDriver(hello["plant"], RobotInfo(**hello["info"]))
        else:
            kind: Any = _driver_class(hello)
            try:
                given = inspect.signature(kind).bind(hello["address"], **hello["options"])
            except TypeError as cause:
                names = ", ".join(list(inspect.signature(kind).parameters)[1:]) or "none"
                raise UsageError(f"options of {kind.__name__}: {cause}; it takes {names}", name="options") from cause
            driver = kind(*given.args, **given.kwargs)
        self._driver = driver
        try:
            info = driver.open()
            instance_of("what open() returns", info, RobotInfo, "a taut.robots.RobotInfo")
            self._period = 1.0 / info.rate
            self._words[STATUS["patience"]] = round(1e9 * max(WATCHDOG[0], WATCHDOG[1] * self._period))
            shapes = measurement_shapes(info.n)
            block = Block.of(hello.get("measured") or {name: shapes[name] for name in ("q", *info.measures)})
            self._flat = np.full_like(block.zeros(), np.nan)  # what a driver never writes is no measurement
            self._measured = block.views(self._flat)
            self._calls = Calls(driver, self._measured, np.zeros((5, info.n) if info.takes == "mit" else info.n))
            self._loop_words = struct_of(LOOP, {
                "status": self._status.address, "read": self._calls.read, "write": self._calls.write,
                "user": self._calls.user, "measured": self._flat.ctypes.data, "group": self._group.address,
                "period": round(1e9 / info.rate), "host_paced": int(info.paced_by == "host"),
                "lead": round(1e9 * min(LEAD[0], LEAD[1] * self._period)),
            })  # fmt: skip
            self._loop = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(servo_code()["loop"])
            gc.collect()
            gc.freeze()
            gc.disable()
            sys.setswitchinterval(1e-4)
            self._answer("done", self._hello, (dataclasses.asdict(info), notes))
            threading.Thread(target=self._take_mail, daemon=True).start()
            self._work()
        finally:
            with contextlib.suppress(BaseException):
                driver.close()

    def _take_mail(self) -> None:
        """Messages: a compiled tick is linked here, while the loop goes on; the rest waits for the loop to pause."""
        _real_time(PRIORITY - 1)
        while True:
            try:
                while not self._mail.poll(PARENT):
                    if os.getppid() != self._parent:  # a child of the parent may hold the other end
                        raise EOFError
                kind, given, number = self._mail.recv()
            except (EOFError, OSError):
                kind, given, number = "close", None, 0
            if kind == "close":
                self._leave()
            try:
                if kind == "set":
                    made = LoadedSet(given)
                    made.warm_up(self._period)
                    if not given["control"]:
                        self._install(made)
                        self._answer("done", number, None)
                        continue
                    kind, given = "begin", made
            except BaseException as error:
                self._answer("error", number, *_in_words(error))
                continue
            self._jobs.put((kind, given, number))
            self._words[STATUS["quit"]] = 1

    def _leave(self) -> None:
        """The controlled stop, and then the end, also where the driver does not come to one."""
        self._words[STATUS["hold"]] = 1
        until, v = time.monotonic() + STOP_TIME, self._measured.get("v")
        while self._words[STATUS["control"]] and time.monotonic() < until:
            time.sleep(10 * self._period)
            if v is not None and np.abs(v).max() < STANDING:
                break
        self._jobs.put(("close", None, 0))
        self._words[STATUS["quit"]] = 1
        time.sleep(2.0 * STOP_TIME)
        os._exit(1)

    def _install(self, made: LoadedSet) -> None:
        """Give the loop another tick; those before it are kept until it has begun."""
        words, running = self._loop_words, self._words[STATUS["running"]]
        self._sets = [*(one for one in self._sets if one.number >= running), made]
        if words[LOOP["set"]] == 0:
            words[LOOP["set"]] = made.address
            self._words[STATUS["running"]] = made.number
            self._jobs.put(("go", None, 0))
        else:
            words[LOOP["next"]] = made.address

    def _work(self) -> None:
        """Loop; where it pauses, do what was asked for, and go on."""
        going = False  # whether a failure has not ended the loop
        while True:
            self._words[STATUS["quit"]] = 0  # before the look: what comes later sets it again
            if going and self._jobs.empty():
                going = self._loop_once()
                continue
            kind, given, number = self._jobs.get()
            if kind == "close":
                self._end()
                return
            if kind == "go":
                going = True
                continue
            try:
                answer = self._do(kind, given)
                going = going or kind in ("begin", "recover")
                self._answer("done", number, answer)
            except BaseException as error:
                self._answer("error", number, *_in_words(error))

    def _do(self, kind: str, given: Any) -> Any:
        words, driver = self._words, self._driver
        if kind == "begin":
            try:
                driver.begin()
            except BaseException:
                with contextlib.suppress(BaseException):
                    driver.end()
                raise
            self._fresh_time()
            words[STATUS["control"]] = 1
            self._install(given)
            words[STATUS["armed"]] = 1
        elif kind == "end":
            self._end()
        elif kind == "recover":
            self._end()
            driver.recover()
            self._calls.error = None
            words[STATUS["fault"]] = 0
            words[STATUS["recover"]] += 1
        elif kind == "load":
            driver.set_load(*given)
        elif kind == "call":
            return driver.call(*given)
        return None

    def _end(self) -> None:
        """Give control back."""
        self._words[STATUS["armed"]] = 0
        if self._words[STATUS["control"]]:
            self._words[STATUS["control"]] = 0
            self._driver.end()

    def _fresh_time(self) -> None:
        now = time.monotonic_ns()
        self._loop_words[LOOP["deadline"]] = self._loop_words[LOOP["last"]] = now
        self._words[STATUS["heartbeat"]] = now

    def _loop_once(self) -> bool:
        """The native loop until it pauses; False where read or write failed."""
        if not self._words[STATUS["control"]]:
            self._fresh_time()  # else a pause counts as what it is
        if self._loop(self._loop_words.ctypes.data) == 0:
            return True
        self._words[STATUS["armed"]] = 0
        error = self._calls.failure()
        code = CODES.get(getattr(error, "kind", "driver"), CODES["driver"])
        self._words[STATUS["fault"]] = code
        if self._words[STATUS["control"]]:
            self._group.view[0] = time.monotonic_ns()
        text = _in_words(error)[1]
        self._answer("fault", code, text)  # first: what follows may take its time
        try:
            self._end()
        except BaseException as second:
            self._answer("fault", code, f"{text}; then {_in_words(second)[1]}")
        return False

    def _answer(self, *message: Any) -> None:
        with self._lock, contextlib.suppress(OSError, ValueError):
            self._mail.send(message)


def _driver_class(hello: Mapping[str, Any]) -> type[RobotDriver]:
    """The class of a driver, of a module or of a file of its own."""
    if "file" in hello:
        sys.path.insert(0, str(Path(hello["file"]).parent))  # as of a script, also for what it imports
    kind = getattr(importlib.import_module(hello["module"]), hello["class"], None)
    if not (isinstance(kind, type) and issubclass(kind, RobotDriver)):
        place = hello.get("file", hello["module"])
        raise UsageError(f"'{place}' has no class '{hello['class']}' that is a RobotDriver", name="robot")
    return kind


def _in_words(error: BaseException | None) -> tuple[str, str]:
    """Code and text of an error, as plain data."""
    if isinstance(error, DriverError):
        return error.kind, str(error)
    if isinstance(error, TautError):
        return "driver", str(error)
    return "driver", f"the driver raised {type(error).__name__}: {error}"


def _real_time(priority: int) -> list[str]:
    """Real-time priority of this thread, and locked memory: what the system did not allow, in words."""
    notes = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as cause:
        notes.append(f"no real-time priority ({cause.strerror}): periods may be late")
    if ctypes.CDLL(None, use_errno=True).mlockall(7) != 0:
        notes.append(f"memory is not locked ({os.strerror(ctypes.get_errno())}): a page fault may delay a tick")
    return notes


def main() -> None:
    """Serve the parent at the other end of the socket, whose number is the only argument."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it, and stops the arm
    Process(Connection(int(sys.argv[1]))).run()


if __name__ == "__main__":
    main()
