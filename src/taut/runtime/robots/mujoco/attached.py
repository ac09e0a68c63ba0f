"""AttachedPlant: an arm inside a MuJoCo simulation of the user's own, and the actuators of that."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from taut.base.errors import MatchError, UsageError
from taut.base.types import Float64Array
from taut.plant.actuation import Actuation
from taut.plant.sensors import Sensors
from taut.record.film.surroundings import POSES, Around
from taut.runtime.host import PlantBase
from taut.runtime.robots.mujoco.rig import Guard, Health, Rig, Wrench
from taut.runtime.robots.mujoco.scene import SceneView

if TYPE_CHECKING:
    import mujoco

__all__ = ["Actuator", "AttachedPlant", "PlantInMujoco", "UserDrives", "whole_steps"]

CUT: Final = 1e-9  # relative to the command: less than this is rounding


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
        """(n,) torques for the next step; before every one of MuJoCo's where `per_step`."""
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
        """(n,) the torques that acted in the last step."""
        tau = np.zeros(self._n)
        tau[self._joints] = np.clip(self._gear * self._force[self._out], *self._limits)
        tau[self._free] = self._applied[self._free_dofs]
        return tau

    def prepare(self) -> None:
        """See that torques reach the arm, before a run."""
        _check_enabled(self._model, self._actuators)

    def take(self) -> None:
        """Before the steps of a period: remember what is the user's."""
        self._users = self._ctrl[self._at], self._applied[self._free_dofs]  # copies

    def release(self) -> None:
        """After the steps: put that back."""
        self._ctrl[self._at], self._applied[self._free_dofs] = self._users


def _cut_off(command: Float64Array, acted: Float64Array) -> Float64Array:
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


class PlantInMujoco(PlantBase):
    """An arm in a simulation by MuJoCo, ours or the user's.

    Args:
        rig: The arm in the simulation.
        name: What messages call it.
        view: What stands around the arm; None for nothing.
    """

    def __init__(self, rig: Rig, name: str, view: SceneView | None) -> None:
        import mujoco

        super().__init__(rig.arm)
        self.adds = rig.adds
        self._rig, self._name, self._view = rig, name, view
        self._qpos, self._qvel = rig.data.qpos, rig.data.qvel  # views, looked up once
        self._health, self._guard, self._wrench = Health(rig), Guard(rig.model.opt), Wrench(rig)
        self._mj_step = mujoco.mj_step
        self._substeps = 1
        self._silence()

    def _silence(self) -> None:
        """Nothing has acted yet."""
        n = self.arm.n
        self._tau, self._cut, self._F_ext, self._told = np.zeros(n), np.zeros(n), np.zeros(6), False

    @property
    def name(self) -> str:
        """What messages call it."""
        return self._name

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model."""
        return self._rig.model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's state, and what it computed last."""
        return self._rig.data

    def state(self) -> tuple[Float64Array, Float64Array]:
        """(n,) the true position and velocity."""
        return self._qpos[self._rig.q].copy(), self._qvel[self._rig.v].copy()

    def _put_state(self, q: Float64Array, v: Float64Array) -> None:
        self._qpos[self._rig.q], self._qvel[self._rig.v] = q, v
        self._health.start()
        self._silence()

    def trouble(self) -> tuple[str, int | None] | None:
        """What went wrong in the last period, in words, and the joint; None if nothing did."""
        return self._health.trouble()

    def _poses(self) -> dict[str, Float64Array]:
        """The column of the bodies of the scene that move, if there are some."""
        return {} if self._view is None or not self._view.moves else {POSES: self._view.poses(self._rig.data)}

    def around(self) -> Around:
        """What stands around the arm, for films."""
        return Around() if self._view is None else self._view.around

    def _warn_of_cut(self, limits: str, instead: str) -> None:
        """Warn, once in a run, that joints do not get all the torque that was asked for."""
        if self._told or not self._cut.any():
            return
        self._told = True
        i = int(np.argmax(np.abs(self._cut)))
        warnings.warn(
            f"{self.name}: joint '{self.arm.joint_names[i]}' got {self._tau[i]:.4g} of the "
            f"{self._tau[i] + self._cut[i]:.4g} {self.arm.joints[i].effort_unit} asked for, because of {limits}; the "
            f"run's column tau_cut has what was cut off; give {instead}",
            RuntimeWarning,
            stacklevel=3,
        )

    def __repr__(self) -> str:
        return self.name


class AttachedPlant(PlantInMujoco):
    """An arm inside a simulation of the user's, see `taut.MujocoPlant.attach`.

    It takes torques and has ideal drives and sensors. Friction, limits and parameters are those of the user's model.

    Args:
        rig: The arm in the simulation.
        drives: Its actuators there.
        name: What messages call it.
    """

    measures = frozenset({"v", "tau_meas", "F_ext"})

    def __init__(self, rig: Rig, drives: UserDrives, name: str) -> None:
        super().__init__(rig, name, SceneView(rig, tool=False))
        self._drives = drives
        self.friction: Literal["arm"] = "arm"
        self.actuation, self.sensors = Actuation(), Sensors()

    def __reduce__(self) -> tuple[Any, ...]:
        raise UsageError(
            "an attached plant drives a simulation of yours, so it cannot be copied or pickled; attach another one "
            "to the copy: taut.MujocoPlant.attach(model, data, arm)"
        )

    def reset(self, q: Float64Array, v: Float64Array, dt: float, seed: int = 0) -> None:  # noqa: ARG002
        """Put the arm into a state, and prepare for control periods of dt [s]. Nothing else moves.

        Raises:
            MatchError: The control period is not a whole number of time steps, or the arm's actuators are disabled.
        """
        self._substeps = whole_steps(self.name, dt, float(self.model.opt.timestep), "model.opt.timestep")
        self._drives.prepare()
        self._put_state(q, v)

    def measure(self) -> dict[str, Float64Array]:
        """Positions, velocities, what the actuators gave, and the wrench at the tool in the last step."""
        q, v = self.state()
        return {"q": q, "v": v, "tau_meas": self._tau.copy(), "F_ext": self._F_ext.copy()}

    def advance(self, command: Float64Array) -> Float64Array:
        """One control period under a command (n,); (n,) the torque that acted on the joints."""
        drives = self._drives
        drives.take()
        try:
            with self._guard:
                if drives.per_step:
                    for _ in range(self._substeps):
                        drives.write(command)
                        self._mj_step(self.model, self.data)
                else:
                    drives.write(command)
                    self._mj_step(self.model, self.data, self._substeps)
            self._tau = drives.acted()
        finally:
            drives.release()
        self._F_ext = self._wrench.of_environment()
        self._cut = _cut_off(command, self._tau)
        self._warn_of_cut("its actuator's limits", "the controller limits=taut.Limits(tau=...)")
        return self._tau

    def extra(self) -> dict[str, Any]:
        """(6,) F_ext of the last step; (n,) tau_cut, what the actuators cut off; (m, 7) poses of bodies that move."""
        return {"F_ext": self._F_ext, "tau_cut": self._cut, **self._poses()}


def whole_steps(name: str, dt: float, timestep: float, setting: str) -> int:
    """The time steps in a control period.

    Raises:
        MatchError: It is not a whole number of them.
    """
    steps = dt / timestep
    if not 1 <= round(steps) <= 1000 or abs(steps - round(steps)) > 1e-9 * steps:
        raise MatchError(
            f"plant '{name}': the control period must be a whole number of time steps; {dt:g} s is {steps:.6g} times "
            f"{timestep:g} s; use {setting}={dt / max(1, math.ceil(steps)):.9g}, or another rate",
            name="timestep",
            value=timestep,
        )
    return round(steps)
