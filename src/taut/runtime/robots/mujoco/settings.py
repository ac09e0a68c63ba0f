"""The parameters of a model that we built, and their way into it between two steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from taut.arm.description import Payload
from taut.base.checks import in_compiled_shape, read_only
from taut.base.types import ArrayLike, Float64Array
from taut.plant.parts import PlantParts
from taut.runtime.robots.mujoco.model import put_payload
from taut.runtime.robots.mujoco.rig import Rig

if TYPE_CHECKING:
    import mujoco

__all__ = ["Settings"]

LOAD = ("mass", "com", "inertia")


class Settings:
    """The parameters of a model that we built, and their way into it."""

    def __init__(self, rig: Rig, numbers: PlantParts) -> None:
        self._rig, self._numbers = rig, numbers
        self._scratch: mujoco.MjData | None = None
        # A joint whose motor moves by itself has rotor and friction in the stage before MuJoCo.
        self._rigid = list(numbers.drivetrain.rigid)
        self.values = {path: read_only(np.asarray(value)) for path, value in numbers.values.items()}

    @property
    def load(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """The payload: mass, com, inertia."""
        mass, com, inertia = (self.values[f"plant.payload.{name}"] for name in LOAD)
        return mass, com, inertia

    def checked(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value in the shape that the parameter has."""
        new = in_compiled_shape(path, self._numbers.checked(path, value), self.values[path].shape)
        if path.startswith("plant.payload."):
            self._payload(path, new)
        return read_only(new)

    def check_together(self, values: Mapping[str, ArrayLike]) -> None:
        """Refuse values by path that do not go together, each of which is right by itself."""
        self._numbers.check_together(values)

    def _payload(self, path: str, value: Float64Array) -> Payload:
        values = {name: self.values[f"plant.payload.{name}"] for name in LOAD}
        values[path.rpartition(".")[2]] = value
        return Payload(mass=float(values["mass"]), com=values["com"], inertia=values["inertia"])

    def put(self, path: str, value: Float64Array) -> None:
        """Keep a checked value, and bring it into the model."""
        self.values = {**self.values, path: value}
        rig, model = self._rig, self._rig.model
        dofs = [rig.dofs[i] for i in self._rigid]
        if path.startswith("plant.payload."):
            put_payload(model, self._somewhere(), rig.tool_body, self._payload(path, value))
        elif path == "plant.friction.viscous":
            model.dof_damping[dofs] = self._of_rigid(value)
        elif path == "plant.friction.coulomb":
            model.dof_frictionloss[dofs] = self._of_rigid(value)
        elif path == "plant.rotor_inertia":
            import mujoco

            model.dof_armature[dofs] = self._of_rigid(value)
            mujoco.mj_setConst(model, self._somewhere())

    def _of_rigid(self, value: Float64Array) -> Float64Array:
        return np.broadcast_to(value, (self._rig.arm.n,))[self._rigid]

    def _somewhere(self) -> mujoco.MjData:
        """Data for MuJoCo to compute constants in, which the run's own is not lost for."""
        import mujoco

        if self._scratch is None:
            self._scratch = mujoco.MjData(self._rig.model)
        return self._scratch
