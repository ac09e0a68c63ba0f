"""The loop's process: it has the robot's driver, compiled ticks and their layout, and nothing of the user's law.

The main thread is in native code, which calls the driver; another one takes messages of the parent. Started as
`python -m taut.runtime.realtime.process FD`, with one end of a socket pair.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import gc
import importlib
import importlib.util
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

from taut.base.errors import TautError
from taut.base.types import Float64Array
from taut.codegen import native
from taut.codegen.servo_loop import LOOP, PLANT, SET, STATUS, servo_code, struct_of
from taut.control.faults import CODES
from taut.runtime.realtime.ring import Ring
from taut.runtime.realtime.sets import FUNCTIONS, PLANT_FUNCTIONS
from taut.runtime.realtime.shared import Shared
from taut.runtime.robots.driver import DriverError, NativeCalls, RobotDriver

PRIORITY: Final = 80  # of SCHED_FIFO
REST: Final = 2.0  # [s] for the controlled stop where the parent is gone
CALLBACK: Final = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)


class PythonDriver:
    """A driver, as the native loop calls it."""

    user = 0

    def __init__(self, driver: RobotDriver) -> None:
        self.driver = driver
        self.failure: BaseException | None = None
        self.native: NativeCalls | None = None

    def bind(self, measured: Mapping[str, Float64Array], command: Float64Array) -> tuple[int, int]:
        """Addresses of read and write on these arrays."""
        driver, target = self.driver, command
        self.native = driver.native()
        if self.native is not None:
            self.user = self.native.user
            return self.native.read, self.native.write
        read, write = driver.read, driver.write

        def reading(_: int, __: int) -> int:
            try:
                read(measured)
            except BaseException as error:  # whatever it is must end the motion
                self.failure = error
                return 1
            return 0

        def writing(_: int, address: int) -> int:
            try:
                ctypes.memmove(target.ctypes.data, address, target.nbytes)
                write(target)
            except BaseException as error:
                self.failure = error
                return 2
            return 0

        self._kept = CALLBACK(reading), CALLBACK(writing)
        found = [int(ctypes.cast(one, ctypes.c_void_p).value or 0) for one in self._kept]
        return found[0], found[1]


class PlantDriver:
    """A model plant in native code."""

    failure: BaseException | None = None

    def __init__(self, given: Mapping[str, Any]) -> None:
        code = native.link(given["code"], PLANT_FUNCTIONS)
        blocks = [given["parameters"].copy(), given["memory"].copy(), given["memory"].copy(), np.zeros(1)]
        parameters, memory, new, outputs = blocks
        inputs = np.zeros(given["input_size"])
        pointers = {"inputs": inputs, "parameters": parameters, "memory": memory, "new": new, "outputs": outputs}
        values = {**given["layout"], **{name: array.ctypes.data for name, array in pointers.items()}}
        self._words = struct_of(PLANT, {**values, **{name: code[name] for name in PLANT_FUNCTIONS}})
        self._kept = code, pointers
        self.user = int(self._words.ctypes.data)

    def bind(self, measured: Mapping[str, Float64Array], command: Float64Array) -> tuple[int, int]:  # noqa: ARG002
        code = servo_code()
        return code["plant_read"], code["plant_write"]


class LoadedSet:
    """A compiled tick in this process."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.code = native.link(given["code"], FUNCTIONS)
        sizes = given["layout"]
        self.ring, self.controls = Ring.attach(given["ring"]), Shared.attach(given["controls"])
        blocks = {name: np.zeros(max(1, sizes[f"{name[:-1] if name != 'memory' else name}_size"]))
                  for name in ("inputs", "memory", "outputs")}  # fmt: skip
        blocks["memory"][:] = given["memory"]
        blocks["parameters"], blocks["new"] = given["parameters"].copy(), blocks["memory"].copy()
        blocks["scratch"] = np.zeros(max(len(block) for block in blocks.values()) + sizes["reference_size"])
        rotations = given["rotations"]
        for first in rotations:  # a rotation that nobody has written yet
            blocks["inputs"][first : first + 9] = np.eye(3).ravel()
        at, base = given["places"], self.controls.address
        values: dict[str, Any] = {
            **sizes,
            **{name: block.ctypes.data for name, block in blocks.items()},
            **{name: self.code[name] for name in FUNCTIONS},
            **{name: base + 8 * at[name] for name in ("reference", "new_parameters", "tables", "table_rows")},
            "table_count": at["table_count"],
            "controls": base,
            "ring": self.ring.header.ctypes.data,
            "rows": self.ring.rows.ctypes.data,
            "capacity": self.ring.capacity,
            **{name: given[name] for name in ("number", "begins", "sends")},
        }
        self.words = struct_of(SET, values)
        self.blocks = blocks
        self.address = int(self.words.ctypes.data)


class Process:
    """The loop's process, from its first message to its last."""

    def __init__(self, connection: Connection) -> None:
        self._mail = connection
        self._jobs: queue.Queue[tuple[str, Any]] = queue.Queue()
        self._sets: list[LoadedSet] = []
        self._lock = threading.Lock()
        self._gone = False  # the parent

    def run(self) -> None:
        """Take the first message, connect, and work until the parent ends it or is gone."""
        hello = self._mail.recv()
        self._status = Shared.attach(hello["status"])
        self._words = self._status.view
        notes = _prepared()  # first: threads of a driver inherit the priority
        try:
            self._driver, info = self._connected(hello)
        except BaseException as error:
            self._mail.send(("error", *_in_words(error)))
            return
        measured = Float64Block({**hello.get("measured", {})} or _shapes(info))
        self._measured = measured
        rows = 5 if info["takes"] == "mit" else 1
        self._command = np.zeros((5, info["n"]) if rows == 5 else info["n"])
        read, write = self._driver.bind(measured.views, self._command)
        partner = hello.get("partner")
        self._partner = Shared.attach(partner) if partner else None
        self._loop_words = struct_of(LOOP, {
            "status": self._status.address, "read": read, "write": write, "user": self._driver.user,
            "measured": measured.flat.ctypes.data, "period": round(1e9 / info["rate"]),
            "host_paced": int(info["paced_by"] == "host"),
            "partner": self._partner.address if self._partner else 0,
        })  # fmt: skip
        self._loop = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(servo_code()["loop"])
        self._mail.send(("info", info, notes))
        threading.Thread(target=self._take_mail, daemon=True).start()
        try:
            self._work()
        finally:
            if isinstance(self._driver, PythonDriver):
                with contextlib.suppress(BaseException):
                    self._driver.driver.close()

    def _connected(self, hello: Mapping[str, Any]) -> tuple[PythonDriver | PlantDriver, dict[str, Any]]:
        if "plant" in hello:
            return PlantDriver(hello["plant"]), hello["info"]
        module = _module(hello["module"], hello.get("file"))
        driver: RobotDriver = getattr(module, hello["class"])(hello["address"], **hello["options"])
        try:
            info = dataclasses.asdict(driver.open())
        except BaseException:
            with contextlib.suppress(BaseException):
                driver.close()
            raise
        return PythonDriver(driver), info

    def _take_mail(self) -> None:
        """Messages: a compiled tick is linked here, while the loop goes on; the rest waits for the loop to pause."""
        while True:
            try:
                kind, given = self._mail.recv()
            except (EOFError, OSError):
                self._gone = True
                self._words[STATUS["hold"]] = 1
                time.sleep(REST if self._words[STATUS["control"]] else 0.0)
                kind, given = "close", None
            try:
                if kind == "set":
                    self._install(LoadedSet(given))
                    continue
                if kind == "tables":
                    continue
            except BaseException as error:
                self._answer("error", *_in_words(error))
                continue
            self._jobs.put((kind, given))
            self._words[STATUS["quit"]] = 1
            if kind == "close":
                return

    def _install(self, made: LoadedSet) -> None:
        """Give the loop another tick; the one before it is kept until the next one has begun."""
        self._sets = [*self._sets[-1:], made]
        words = self._loop_words
        if words[LOOP["set"]] == 0:
            words[LOOP["set"]] = made.address
            self._words[STATUS["running"]] = int(made.words[SET["number"]])
            self._jobs.put(("go", None))
        else:
            words[LOOP["next"]] = made.address

    def _work(self) -> None:
        """Loop; where it pauses, do what was asked for, and go on."""
        going = False  # whether a failure has not ended the loop
        while True:
            wait = not (going and self._loop_words[LOOP["set"]])
            try:
                kind, given = self._jobs.get(block=wait)
            except queue.Empty:
                going = self._loop_once()
                continue
            self._words[STATUS["quit"]] = int(not self._jobs.empty())
            if kind == "close":
                self._end()
                return
            if kind == "go":
                going = True
                continue
            try:
                going = self._do(kind, given, going)
            except BaseException as error:
                going = going and kind not in ("begin",)
                self._answer("error", *_in_words(error))

    def _do(self, kind: str, given: Any, going: bool) -> bool:
        driver = self._driver.driver if isinstance(self._driver, PythonDriver) else None
        answer: Any = None
        if kind == "begin":
            if driver is not None:
                driver.begin()
            self._words[STATUS["recover"]] += 1  # the controlled stop holds where the arm is now
            self._words[STATUS["control"]] = 1
            self._fresh_time()
            self._words[STATUS["armed"]] = 1
            going = True
        elif kind == "end":
            self._end()
        elif kind == "recover":
            self._end()
            if driver is not None:
                driver.recover()
            self._driver.failure = None
            self._words[STATUS["external"]] = self._words[STATUS["fault"]] = 0
            self._words[STATUS["recover"]] += 1
            going = True
        elif kind == "load" and driver is not None:
            driver.set_load(*given)
        elif kind == "call" and driver is not None:
            answer = driver.call(*given)
        self._answer("done", kind, answer)
        return going

    def _end(self) -> None:
        """Give control back."""
        self._words[STATUS["armed"]] = 0
        if self._words[STATUS["control"]]:
            self._words[STATUS["control"]] = 0
            if isinstance(self._driver, PythonDriver):
                self._driver.driver.end()

    def _fresh_time(self) -> None:
        now = time.monotonic_ns()
        self._loop_words[LOOP["deadline"]] = self._loop_words[LOOP["last"]] = now
        self._words[STATUS["heartbeat"]] = now

    def _loop_once(self) -> bool:
        """The native loop until it pauses; False where read or write failed."""
        self._fresh_time()
        result = self._loop(self._loop_words.ctypes.data)
        if result == 0:
            return True
        self._words[STATUS["armed"]] = 0
        error = self._driver.failure
        if isinstance(self._driver, PythonDriver) and self._driver.native is not None:
            error = self._driver.native.failure()
        code = CODES.get(getattr(error, "kind", "driver"), CODES["driver"])
        self._words[STATUS["fault"]] = code
        if self._partner is not None:
            self._partner.view[STATUS["external"]] = CODES["partner"]
        ended = ""
        try:
            self._end()
        except BaseException as second:
            self._words[STATUS["control"]] = 0
            ended = f"; then {_in_words(second)[1]}"
        self._answer("fault", code, _in_words(error)[1] + ended)
        return False

    def _answer(self, *message: Any) -> None:
        with self._lock, contextlib.suppress(OSError, ValueError):
            self._mail.send(message)


class Float64Block:
    """Named arrays in one flat one."""

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        sizes = [int(np.prod(shape)) for shape in shapes.values()]
        self.flat = np.zeros(sum(sizes))
        ends = np.cumsum([0, *sizes])
        self.views = {
            name: self.flat[ends[i] : ends[i + 1]].reshape(shape) for i, (name, shape) in enumerate(shapes.items())
        }


def _shapes(info: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
    from taut.maths.snapshot import measurement_shapes

    shapes = measurement_shapes(info["n"])
    return {name: shapes[name] for name in ("q", *info["measures"])}


def _module(name: str, file: str | None) -> Any:
    if file is None:
        return importlib.import_module(name)
    spec = importlib.util.spec_from_file_location(f"taut_driver_{Path(file).stem}", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def _in_words(error: BaseException | None) -> tuple[str, str]:
    """Code and text of an error, as plain data."""
    if isinstance(error, DriverError):
        return error.kind, str(error)
    if isinstance(error, TautError):
        return "driver", str(error)
    return "driver", f"the driver raised {type(error).__name__}: {error}"


def _prepared() -> list[str]:
    """Real-time priority, locked memory, no collector: what the system did not allow, in words."""
    notes = []
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(1e-4)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError) as cause:
        notes.append(f"no real-time priority ({getattr(cause, 'strerror', cause)}): periods may be late")
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, "mlockall") or library.mlockall(3) != 0:
        notes.append(f"memory is not locked ({os.strerror(ctypes.get_errno())}): a page fault may delay a tick")
    return notes


def main() -> None:
    """Serve the parent at the other end of the socket, whose number is the only argument."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it, and stops the arm
    Process(Connection(int(sys.argv[1]))).run()


if __name__ == "__main__":
    main()
