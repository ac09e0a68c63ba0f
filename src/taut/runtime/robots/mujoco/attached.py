"""AttachedPlant: an arm inside a MuJoCo simulation of the user's own, from `taut.MujocoPlant.attach`."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import MatchError, UsageError
from taut.base.types import Float64Array
from taut.plant.drives.actuation import Actuation
from taut.plant.sensors.sensors import Sensors
from taut.record.film.surroundings import POSES, Around
from taut.runtime.host import PlantBase
from taut.runtime.robots.mujoco.drives import UserDrives, cut_off
from taut.runtime.robots.mujoco.health import Guard, Health
from taut.runtime.robots.mujoco.rig import Rig
from taut.runtime.robots.mujoco.surroundings import SceneView
from taut.runtime.robots.mujoco.wrench import Wrench

if TYPE_CHECKING:
    import mujoco

__all__ = ["AttachedPlant", "warn_of_cut", "whole_steps"]


class AttachedPlant(PlantBase):
    """An arm inside a simulation of the user's, see `taut.MujocoPlant.attach`.

    It takes torques and has ideal drives and sensors. Friction, limits and parameters are those of the user's model.

    Args:
        rig: The arm in the simulation.
        drives: Its actuators there.
        name: What messages call it.
    """

    measures = frozenset({"v", "tau_meas", "F_ext"})

    def __init__(self, rig: Rig, drives: UserDrives, name: str) -> None:
        import mujoco

        self.arm, self._rig, self._drives, self._name = rig.arm, rig, drives, name
        self.adds = rig.adds  # gravity, of bodies that have gravcomp
        self.friction: Literal["arm"] = "arm"
        self.actuation, self.sensors = Actuation(), Sensors()
        self._health, self._guard = Health(rig), Guard(rig.model.opt)
        self._step, self._wrench, self._view = mujoco.mj_step, Wrench(rig), SceneView(rig, tool=False)
        self._substeps = 1
        self._silence()

    def __reduce__(self) -> tuple[Any, ...]:
        raise UsageError(
            "an attached plant drives a simulation of yours, so it cannot be copied or pickled; attach another one "
            "to the copy: taut.MujocoPlant.attach(model, data, arm)"
        )

    def _silence(self) -> None:
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

    def reset(self, q: Float64Array, v: Float64Array, dt: float, seed: int = 0) -> None:  # noqa: ARG002
        """Put the arm into a state, and prepare for control periods of dt [s]. Nothing else moves.

        Raises:
            MatchError: The control period is not a whole number of time steps, or the arm's actuators are disabled.
        """
        self._substeps = whole_steps(self.name, dt, float(self.model.opt.timestep), "model.opt.timestep")
        self._drives.prepare()
        self.data.qpos[self._rig.q], self.data.qvel[self._rig.v] = q, v
        self._health.start()
        self._silence()

    def state(self) -> tuple[Float64Array, Float64Array]:
        """(n,) the true position and velocity."""
        return self.data.qpos[self._rig.q].copy(), self.data.qvel[self._rig.v].copy()

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
                        self._step(self.model, self.data)
                else:
                    drives.write(command)
                    self._step(self.model, self.data, self._substeps)
            self._tau = drives.acted()
        finally:
            drives.release()
        self._F_ext = self._wrench.of_environment()
        self._cut = cut_off(command, self._tau)
        if not self._told and self._cut.any():
            self._told = True
            limits, instead = "its actuator's limits", "the controller limits=taut.Limits(tau=...)"
            warn_of_cut(self.name, self.arm, self._tau, self._cut, limits, instead)
        return self._tau

    def trouble(self) -> tuple[str, int | None] | None:
        """What went wrong in the last period, in words, and the joint; None if nothing did."""
        return self._health.trouble()

    def extra(self) -> dict[str, Any]:
        """(6,) F_ext of the last step; (n,) tau_cut, what the actuators cut off; (m, 7) poses of bodies that move."""
        seen = {POSES: self._view.poses(self.data)} if self._view.moves else {}
        return {"F_ext": self._F_ext, "tau_cut": self._cut, **seen}

    def around(self) -> Around:
        """What stands around the arm, for films."""
        return self._view.around

    def __repr__(self) -> str:
        return self.name


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


def warn_of_cut(name: str, arm: Arm, acted: Float64Array, cut: Float64Array, limits: str, instead: str) -> None:
    """Warn that joints do not get all the torque that was asked for."""
    i = int(np.argmax(np.abs(cut)))
    warnings.warn(
        f"{name}: joint '{arm.joint_names[i]}' got {acted[i]:.4g} of the {acted[i] + cut[i]:.4g} "
        f"{arm.joints[i].effort_unit} asked for, because of {limits}; the run's column tau_cut has what was cut off; "
        f"give {instead}",
        RuntimeWarning,
        stacklevel=3,
    )
