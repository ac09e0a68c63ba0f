"""How a torque command gets into MuJoCo: our motors, the user's actuators, or a force applied to the joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import MatchError
from taut.base.types import Array, Float64Array
from taut.codegen import native as native_code
from taut.codegen.function import native
from taut.maths.adds import Adds, compensation
from taut.maths.model import PayloadValues, model_of
from taut.runtime.robots.mujoco.rig import Rig, index

if TYPE_CHECKING:
    import mujoco

__all__ = ["Actuator", "Compensation", "Drives", "Motors", "UserDrives", "cut_off"]

CUT: Final = 1e-9  # relative to the command: less than this is rounding


class Drives(Protocol):
    """Takes joint torques into the simulation."""

    @property
    def per_step(self) -> bool:
        """Whether `write` must be called again before every step of MuJoCo."""
        ...

    def write(self, tau: Float64Array) -> None:
        """(n,) torques for the next step."""
        ...

    def acted(self) -> Float64Array:
        """(n,) the torques that acted in the last step."""
        ...

    def prepare(self) -> None:
        """See that torques reach the arm, before a run."""
        ...

    def take(self) -> None:
        """Before the steps of a period: remember what belongs to somebody else."""
        ...

    def release(self) -> None:
        """After the steps: put that back."""
        ...


class Motors:
    """The motors of a model that we built: one for each joint, gear 1, no limit."""

    per_step = False

    def __init__(self, rig: Rig) -> None:
        model, data = rig.model, rig.data
        self._ctrl: Float64Array = data.ctrl
        self._force: Float64Array = data.qfrc_actuator
        names = rig.arm.joint_names
        self._at = index([int(model.actuator_ctrladr[model.actuator(name).id]) for name in names])
        self._v = rig.v

    def write(self, tau: Float64Array) -> None:
        self._ctrl[self._at] = tau

    def acted(self) -> Float64Array:
        return self._force[self._v].copy()

    def prepare(self) -> None:
        self._ctrl[self._at] = 0.0

    def take(self) -> None:
        """Nobody else has a say in a model that we built."""

    def release(self) -> None:
        """So the command stays, for a viewer to show."""


@dataclass(frozen=True, kw_only=True)
class Actuator:
    """An actuator of the user's on one of the arm's joints: torque = gear (gain ctrl + bias).

    gain and bias are each affine in the actuator's length gear q and its velocity gear v.
    """

    name: str
    number: int  # in the model
    joint: int  # index in the arm
    ctrl: int  # address of its control
    out: int  # address of its force
    gear: float
    gain: tuple[float, float, float]  # constant, per length, per velocity
    bias: tuple[float, float, float]
    rotor: float  # inertia that it adds to the joint [kg m^2 | kg]

    @property
    def is_motor(self) -> bool:
        """Whether its force is proportional to its control alone."""
        return not any(self.gain[1:]) and not any(self.bias)


class UserDrives:
    """The actuators of the user's model; joints without one get their torque through qfrc_applied.

    Controls and applied forces are the user's: they have the run's values during the steps of a period only, so that
    nothing goes on pushing the arm after a run, however it ends.
    """

    def __init__(self, rig: Rig, actuators: list[Actuator]) -> None:
        data = rig.data
        self._model, self._actuators = rig.model, tuple(actuators)
        self._ctrl: Float64Array = data.ctrl
        self._force: Float64Array = data.actuator_force
        self._applied: Float64Array = data.qfrc_applied
        self._qpos: Float64Array = data.qpos
        self._qvel: Float64Array = data.qvel
        self._n = rig.arm.n
        self._joints = np.array([a.joint for a in actuators], dtype=np.intp)
        self._at = np.array([a.ctrl for a in actuators], dtype=np.intp)
        self._out = np.array([a.out for a in actuators], dtype=np.intp)
        self._gear = np.array([a.gear for a in actuators], dtype=np.float64)
        self._gain = np.array([a.gain for a in actuators], dtype=np.float64).reshape(-1, 3).T
        self._bias = np.array([a.bias for a in actuators], dtype=np.float64).reshape(-1, 3).T
        self._q = np.array([int(rig.model.jnt_qposadr[rig.joints[a.joint]]) for a in actuators], dtype=np.intp)
        self._v = np.array([rig.dofs[a.joint] for a in actuators], dtype=np.intp)
        self._free = np.setdiff1d(np.arange(self._n), self._joints)  # joints without an actuator
        self._free_dofs = np.array(rig.dofs, dtype=np.intp)[self._free]
        self.per_step = not all(a.is_motor for a in actuators)
        limits = [_joint_limit(rig.model, rig.joints[a.joint]) for a in actuators]
        self._limits = np.array(limits, dtype=np.float64).reshape(-1, 2).T
        self.take()

    def write(self, tau: Float64Array) -> None:
        if self._free.size:
            self._applied[self._free_dofs] = tau[self._free]
        force = tau[self._joints] / self._gear
        if not self.per_step:
            self._ctrl[self._at] = force / self._gain[0]
            return
        length, speed = self._gear * self._qpos[self._q], self._gear * self._qvel[self._v]
        gain, bias = (c[0] + c[1] * length + c[2] * speed for c in (self._gain, self._bias))
        self._ctrl[self._at] = (force - bias) / gain

    def acted(self) -> Float64Array:
        tau = np.zeros(self._n)
        tau[self._joints] = np.clip(self._gear * self._force[self._out], *self._limits)
        tau[self._free] = self._applied[self._free_dofs]
        return tau

    def prepare(self) -> None:
        _check_enabled(self._model, self._actuators)

    def take(self) -> None:
        self._users = self._ctrl[self._at], self._applied[self._free_dofs]  # copies

    def release(self) -> None:
        self._ctrl[self._at], self._applied[self._free_dofs] = self._users


def cut_off(command: Float64Array, acted: Float64Array) -> Float64Array:
    """(n,) the part of a command that did not act; zero where it is rounding."""
    cut = command - acted
    return np.where(np.abs(cut) > CUT * np.maximum(1.0, np.abs(command)), cut, 0.0)


def _check_enabled(model: mujoco.MjModel, actuators: tuple[Actuator, ...]) -> None:
    import mujoco

    off = int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    groups = int(model.opt.disableactuator)
    for actuator in actuators:
        group = int(model.actuator_group[actuator.number])
        if off or (0 <= group < 31 and groups >> group & 1):
            how = "<flag actuation>" if off else f"actuator group {group}"
            raise MatchError(
                f"actuator '{actuator.name}' is disabled in the model, by {how}, so that no torque would reach the "
                "arm; enable it in model.opt",
                name=actuator.name,
            )


def _joint_limit(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    """What the joint lets through of its actuators' forces."""
    if not model.jnt_actfrclimited[joint]:
        return -np.inf, np.inf
    low, high = model.jnt_actfrcrange[joint]
    return float(low), float(high)


class Compensation:
    """What a plant adds to every torque command itself, by the Arm's own formulas: gravity and Coriolis torques."""

    def __init__(self, arm: Arm, adds: Adds) -> None:
        self._adds, self._model = adds, model_of(arm)
        n = arm.n
        self._call: Any = self._torque
        if native_code.available():
            self._call = native(self._torque, q=n, v=n, mass=(), com=3, inertia=6)

    def torque(self, q: Float64Array, v: Float64Array, payload: tuple[Float64Array, ...]) -> Float64Array:
        """(n,) at a state, for a payload of (mass, com, inertia)."""
        total: Float64Array = self._call(q, v, *payload)
        return total

    def _torque(self, q: Array, v: Array, mass: Any, com: Array, inertia: Array) -> Array:
        return compensation(self._model, self._adds, q, v, PayloadValues(mass=mass, com=com, inertia=inertia))
