"""What a run keeps of its arm: the tool's kinematics, the impedance of the law, limits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.control.laws.apparent import felt_impedance
from taut.control.lawside import LawSide
from taut.control.side_by_side import SideBySide
from taut.control.tasks.task import Task
from taut.maths.chain import Chain
from taut.maths.model import Model, PayloadValues
from taut.maths.snapshot import Snapshot
from taut.record.info import PartInfo

__all__ = ["tool_info"]


def tool_info(law: Law | Task, side: LawSide, q: Float64Array, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of RunInfo about tool and limits, by name.

    Args:
        law: The law with the gains of the run.
        side: The law side of the loop.
        q: (n,) positions at the start [rad | m].
        parameters: Parameters of the law side by path.
    """
    payload = {name: np.array(value) for name, value in subtree(parameters, "model.payload").items()}
    x = Snapshot(side.model, q=q, v=np.zeros(len(q)), payload=PayloadValues.of(payload))
    own = _of_law(law, side.model, x)
    out: dict[str, Any] = {"tool": own.tool, "impedance": own.impedance, "limits": _limits(side.arm)}
    if isinstance(law, SideBySide):
        seen = law.seen(x)
        out["parts"] = {
            name: _of_law(part, seen[name].model, seen[name], joints=seen[name].arm.joint_names)
            for name, part in law.parts.items()
        }
    if isinstance(law, Task):
        out["phases"] = {
            name: _of_law(law.laws[name], side.model, x, follows=law.follows(name)) for name in law.phases
        }
    return out


def _limits(arm: Arm) -> dict[str, dict[str, float]]:
    """Effort and velocity limits by joint, of those that have one."""
    return {
        name: {joint: float(most) for joint, most in zip(arm.joint_names, values, strict=True) if np.isfinite(most)}
        for name, values in (("effort", arm.effort), ("velocity", arm.velocity))
    }


def _of_law(
    law: Law | Task, model: Model, x: Snapshot, *, joints: tuple[str, ...] = (), follows: str | None = None
) -> PartInfo:
    frame = law.controlled_frame
    impedance = None
    if isinstance(law, Law) and frame in (None, model.arm.tool):  # F_ext is taken at the arm's tool
        impedance = felt_impedance(law, x)
    return PartInfo(tool=Chain.of(model, frame), impedance=impedance, joints=joints, follows=follows)
