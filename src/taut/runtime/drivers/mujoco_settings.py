"""The parameters of a model that we built, and their way into it between two steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from taut.arm.description import Payload
from taut.base.checks import finite_array, read_only, require_at_least
from taut.base.types import ArrayLike, Float64Array
from taut.control.lawside import checked_payload_entry, in_compiled_shape
from taut.runtime.drivers.mujoco_model import put_payload
from taut.runtime.drivers.mujoco_rig import Rig

if TYPE_CHECKING:
    import mujoco

__all__ = ["Settings"]


class Settings:
    """The parameters of a model that we built, and their way into it."""

    def __init__(self, rig: Rig, friction: Literal["arm"] | None) -> None:
        arm, payload = rig.arm, rig.arm.payload
        self._rig = rig
        self._scratch: mujoco.MjData | None = None
        self.values: dict[str, Float64Array] = {
            "plant.payload.mass": read_only(np.asarray(payload.mass)),
            "plant.payload.com": payload.com,
            "plant.payload.inertia": payload.inertia,
        }
        if friction == "arm" and arm.viscous.any():
            self.values["plant.friction.viscous"] = arm.viscous
        if friction == "arm" and arm.coulomb.any():
            self.values["plant.friction.coulomb"] = arm.coulomb

    @property
    def load(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """The payload: mass, com, inertia."""
        mass, com, inertia = (self.values[f"plant.payload.{name}"] for name in ("mass", "com", "inertia"))
        return mass, com, inertia

    def checked(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value in the shape that the parameter has."""
        shape = self.values[path].shape
        if path.startswith("plant.payload."):
            new = in_compiled_shape(path, checked_payload_entry(path, value), shape)
            self._payload(path, new)
            return read_only(new)
        new = in_compiled_shape(path, finite_array(path, value), shape)
        require_at_least(path, new, 0.0, joints=self._rig.arm.joint_names)
        return read_only(new)

    def _payload(self, path: str, value: Float64Array) -> Payload:
        values = {name: self.values[f"plant.payload.{name}"] for name in ("mass", "com", "inertia")}
        values[path.rpartition(".")[2]] = value
        return Payload(mass=float(values["mass"]), com=values["com"], inertia=values["inertia"])

    def put(self, path: str, value: Float64Array) -> None:
        """Keep a checked value, and bring it into the model."""
        import mujoco

        self.values = {**self.values, path: value}
        rig, model = self._rig, self._rig.model
        if path.startswith("plant.payload."):
            if self._scratch is None:
                self._scratch = mujoco.MjData(model)
            put_payload(model, self._scratch, rig.tool_body, self._payload(path, value))
        elif path.endswith("viscous"):
            model.dof_damping[rig.v] = value
        else:
            model.dof_frictionloss[rig.v] = value
