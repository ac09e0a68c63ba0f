"""What the actuators of a compiled MJCF can give to each joint."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from taut.base.errors import quoted_list
from taut.base.types import Float64Array

if TYPE_CHECKING:
    import mujoco

__all__ = ["Efforts"]


class Efforts:
    """Largest torque or force of each joint: its own limit, and what its actuators can give."""

    def __init__(self, m: mujoco.MjModel) -> None:
        import mujoco

        self._m = m
        self._servos: list[str] = []
        self._elsewhere: list[str] = []
        self._actuators: dict[int, list[float]] = {}
        on_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        for a in range(m.nu):
            name = m.actuator(a).name or f"actuator{a}"
            if int(m.actuator_trntype[a]) not in on_joint:
                self._elsewhere.append(name)
                continue
            motor = int(m.actuator_biastype[a]) == int(mujoco.mjtBias.mjBIAS_NONE)
            if not motor:
                self._servos.append(name)
            fixed = motor and int(m.actuator_gaintype[a]) == int(mujoco.mjtGain.mjGAIN_FIXED)
            largest = math.inf
            if m.actuator_forcelimited[a]:
                largest = _smaller_side(m.actuator_forcerange[a])
            if fixed and m.actuator_ctrllimited[a]:
                largest = min(largest, abs(m.actuator_gainprm[a, 0]) * _smaller_side(m.actuator_ctrlrange[a]))
            gear = abs(float(m.actuator_gear[a, 0]))
            self._actuators.setdefault(int(m.actuator_trnid[a, 0]), []).append(gear * largest if gear else 0.0)

    def of(self, j: int) -> float:
        """[N m | N]; infinite where the file bounds neither the joint nor its actuators."""
        largest = sum(self._actuators[j]) if j in self._actuators else math.inf
        if self._m.jnt_actfrclimited[j]:
            largest = min(largest, _smaller_side(self._m.jnt_actfrcrange[j]))
        return largest

    def notes(self) -> Iterator[str]:
        if self._servos:
            yield f"actuators with their own servo gains: {quoted_list(self._servos)}; an Arm takes torques"
        if self._elsewhere:
            yield f"actuators that drive no joint are left out: {quoted_list(self._elsewhere)}"


def _smaller_side(both: Float64Array) -> float:
    """An Arm's effort limit is the same both ways; the smaller one is safe."""
    return float(min(abs(both[0]), abs(both[1])))
