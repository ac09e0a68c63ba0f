"""The watchdog: a process that ends the loop's process where it does not tick. `python -m ... STATUS PID SECONDS`."""

from __future__ import annotations

import ctypes
import signal
import sys

from taut.codegen.servo_loop import servo_code
from taut.control.faults import CODES
from taut.runtime.realtime.shared import Shared


def main() -> None:
    """Watch until the status is declared dead, or the loop's process had to be ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    status = Shared.attach(sys.argv[1])
    watch = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p, *[ctypes.c_int64] * 4)(servo_code()["watch"])
    print("watching", flush=True)
    watch(status.address, int(sys.argv[2]), round(1e9 * float(sys.argv[3])), CODES["silent"], CODES["watchdog"])


if __name__ == "__main__":
    main()
