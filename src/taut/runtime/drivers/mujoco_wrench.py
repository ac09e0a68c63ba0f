"""What touches the tool, out of MuJoCo's own bookkeeping of external forces."""

from __future__ import annotations

import numpy as np

from taut.base.types import Float64Array
from taut.runtime.drivers.mujoco_rig import Rig

__all__ = ["Wrench"]

NOTHING = np.zeros(6)
NOTHING.flags.writeable = False


class Wrench:
    """The wrench of everything outside the arm on the body that carries the tool.

    MuJoCo adds up contacts, equality constraints and xfrc_applied for each body, torque first, about the centre of
    mass of the whole tree. Weight and inertia are no part of it, as they are of what its force sensors give.
    """

    def __init__(self, rig: Rig) -> None:
        import mujoco

        self._rig, self._post = rig, mujoco.mj_rnePostConstraint
        data, body = rig.data, rig.tool_body
        self._forces: Float64Array = data.cfrc_ext
        self._nothing = np.zeros((len(self._forces[rig.tool_bodies]), 6)).tobytes()
        self._centre: Float64Array = data.subtree_com[rig.model.body_rootid[body]]
        self._p: Float64Array = data.xpos[body]
        self._R: Float64Array = data.xmat[body].reshape(3, 3)

    def of_environment(self) -> Float64Array:
        """(6,) F_ext of the last step, force first, in world axes at the tool's origin; read-only."""
        if not self._rig.data.flg_rnepost:  # no sensor of the model asked for it
            self._post(self._rig.model, self._rig.data)
        rows = self._forces[self._rig.tool_bodies]
        if rows.tobytes() == self._nothing:
            return NOTHING
        torque, force = np.split(rows.sum(axis=0), 2)
        arm = self._centre - self._p - self._R @ self._rig.p_tool  # from the tool's origin to that centre
        F_ext: Float64Array = np.concatenate([force, torque + np.cross(arm, force)])
        return F_ext
