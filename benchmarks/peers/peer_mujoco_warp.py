"""MuJoCo Warp (`pip install mujoco-warp`): made for NVIDIA GPUs, and this benchmark is of processors."""

from __future__ import annotations

import mujoco_warp  # noqa: F401  # that it imports
import warp
from worker import Case, Task


def sweep(task: Task, **case: object) -> Case:  # noqa: ARG001
    warp.init()
    count = warp.get_cuda_device_count()
    raise RuntimeError(f"it installs and imports; made for CUDA devices, of which there are {count} here: not run")


CASES = {"sweep": sweep}
