"""A process beside the loop's, for what the vendor's client may wait for: a robot's first answer, and the gripper.

pylibfranka keeps the interpreter's lock while it waits, and it waits without a time limit where a robot takes a
connection and does not answer. This file runs as a script and needs nothing of taut; each line of its input is a
request as JSON.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import sys
from importlib import import_module
from typing import Any

WIDTH_TOLERANCE = 5e-3  # [m] by which a width may exceed the largest one: homing only estimates it
END_WITH_PARENT = 1, 9  # prctl(PR_SET_PDEATHSIG, SIGKILL)


def main(address: str) -> None:
    """Say "{}", and answer each [name, arguments] by {"succeeded": ..., **state} or {"error": [class, text]}."""
    ctypes.CDLL(None).prctl(*END_WITH_PARENT)
    client: Any = import_module("pylibfranka")
    print("{}", flush=True)  # ready
    gripper: Any = None
    for line in sys.stdin:
        name, arguments = json.loads(line)
        answer: dict[str, Any] = {}
        try:
            if name == "arm":
                client.Robot(address, client.RealtimeConfig.kIgnore)
                with contextlib.suppress(OSError):  # the client gave this thread the highest priority there is
                    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            else:
                gripper = gripper or client.Gripper(address)
                largest = gripper.read_once().max_width
                if name in ("move", "grasp") and arguments[0] > largest + WIDTH_TOLERANCE:
                    rule = f"width must be <= {largest:g} m, the gripper's max_width, which homing finds"
                    raise ValueError(f"{rule}; got {arguments[0]:g}")
                answer["succeeded"] = name == "look" or getattr(gripper, name)(*arguments)
                state = gripper.read_once()
                answer |= {key: getattr(state, key) for key in ("width", "max_width", "is_grasped", "temperature")}
        except Exception as error:
            answer = {"error": [type(error).__name__, str(error)]}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
