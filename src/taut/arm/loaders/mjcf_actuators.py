"""What the actuators of a compiled MJCF give to each joint: effort, and the inertia and damping of their rotors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from taut.base.errors import quoted_list
from taut.base.types import Float64Array

if TYPE_CHECKING:
    import mujoco

__all__ = ["Efforts", "Rotors"]


class Efforts:
    """Largest torque or force of each joint: its own limit, and what its actuators can give."""

    def __init__(self, m: mujoco.MjModel) -> None:
        import mujoco

        self._m = m
        self._servos: list[str] = []
        self._elsewhere: list[str] = []
        self._motors: list[str] = []  # electrical ones
        self._actuators: dict[int, list[float]] = {}
        on_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        for a in range(m.nactuator):
            name = m.actuator(a).name or f"actuator{a}"
            if int(m.actuator_trntype[a]) not in on_joint:
                self._elsewhere.append(name)
                continue
            motor = int(m.actuator_biastype[a]) == int(mujoco.mjtBias.mjBIAS_NONE)
            if int(m.actuator_gaintype[a]) == int(mujoco.mjtGain.mjGAIN_DCMOTOR):
                self._motors.append(name)
            elif not motor:
                self._servos.append(name)
            fixed = motor and int(m.actuator_gaintype[a]) == int(mujoco.mjtGain.mjGAIN_FIXED)
            largest = math.inf
            if m.actuator_forcelimited[a]:
                largest = _smaller_side(m.actuator_forcerange[a])
            if fixed and m.actuator_ctrllimited[a]:
                largest = min(largest, abs(m.actuator_gainprm[a, 0]) * _smaller_side(m.actuator_ctrlrange[a]))
            gear = abs(_gear(m, a))
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
        if self._motors:
            yield (
                f"the electrical motors of {quoted_list(self._motors)} are left out, with their cogging and LuGre "
                "friction; an Arm takes torques, and Friction has static friction and the Stribeck effect"
            )
        if self._elsewhere:
            yield f"actuators that drive no joint are left out: {quoted_list(self._elsewhere)}"


class Rotors:
    """Inertia and damping that the actuators of each joint bring along, through the square of their gear."""

    def __init__(self, m: mujoco.MjModel) -> None:
        import mujoco

        self._inertia: dict[int, float] = {}
        self._damping: dict[int, float] = {}
        self._gears: dict[int, set[float]] = {}
        self._bent: list[str] = []  # with damping that is not linear
        on_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        for a in range(m.nactuator):
            if int(m.actuator_trntype[a]) not in on_joint:
                continue
            j, gear = int(m.actuator_trnid[a, 0]), abs(_gear(m, a))
            if m.actuator_armature[a]:
                self._inertia[j] = self._inertia.get(j, 0.0) + gear**2 * float(m.actuator_armature[a])
                self._gears.setdefault(j, set()).add(gear)
            self._damping[j] = self._damping.get(j, 0.0) + gear**2 * float(m.actuator_damping[a])
            if m.actuator_dampingpoly[a].any():
                self._bent.append(m.actuator(a).name or f"actuator{a}")

    def inertia(self, j: int) -> float:
        """Seen at the joint [kg m^2 | kg]."""
        return self._inertia.get(j, 0.0)

    def damping(self, j: int) -> float:
        """Seen at the joint [N m s/rad | N s/m]."""
        return self._damping.get(j, 0.0)

    def gear(self, j: int) -> float:
        """Turns of the one rotor per turn of the joint; 1 where there is none. Other actuators' gear only scales."""
        gears = self._gears.get(j, set())
        return next(iter(gears)) if len(gears) == 1 and 0.0 not in gears else 1.0

    def notes(self) -> Iterator[str]:
        if self._bent:
            yield f"damping that is not linear left out, of actuators {quoted_list(self._bent)}"


def _gear(m: mujoco.MjModel, a: int) -> float:
    return float(m.actuator_gear[m.actuator_outadr[a], 0])


def _smaller_side(both: Float64Array) -> float:
    """An Arm's effort limit is the same both ways; the smaller one is safe."""
    return float(min(abs(both[0]), abs(both[1])))
