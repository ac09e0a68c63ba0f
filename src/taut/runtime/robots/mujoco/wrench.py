"""What touches the tool, out of MuJoCo's own bookkeeping of external forces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from taut.base.types import Float64Array
from taut.runtime.robots.mujoco.rig import Rig

if TYPE_CHECKING:
    import mujoco

__all__ = ["PRESSED", "Normals", "Wrench"]

PRESSED: Final = "contact.normal_force"  # column of a run

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


class Normals:
    """The force of the contacts on the tool's body, of each along its own normal and without friction.

    What a weld of the scene ties to the tool counts as the tool, with all that it carries: a wheel in its fork.
    """

    def __init__(self, rig: Rig) -> None:
        import mujoco

        self._model, self._data, self._force_of = rig.model, rig.data, mujoco.mj_contactForce
        bodies = set(np.arange(rig.model.nbody)[rig.tool_bodies].tolist())
        bodies |= _welded(rig.model, bodies)
        self._ours: set[int] = {g for g in range(rig.model.ngeom) if int(rig.model.geom_bodyid[g]) in bodies}
        self._six = np.zeros(6)

    def of_contacts(self) -> Float64Array:
        """(3,) that force of the last step, world axes."""
        out, contacts = np.zeros(3), self._data.contact
        for i in range(self._data.ncon):
            first, second = contacts.geom[i]
            sign = (int(second) in self._ours) - (int(first) in self._ours)  # normals point from first to second
            if sign:
                self._force_of(self._model, self._data, i, self._six)
                out += sign * self._six[0] * contacts.frame[i, :3]
        return out


def _welded(model: mujoco.MjModel, bodies: set[int]) -> set[int]:
    """Bodies that welds of a scene tie to some, and those that they carry."""
    import mujoco

    pairs = [
        {int(model.eq_obj1id[i]), int(model.eq_obj2id[i])}
        for i in range(model.neq)
        if int(model.eq_type[i]) == mujoco.mjtEq.mjEQ_WELD and int(model.eq_objtype[i]) == mujoco.mjtObj.mjOBJ_BODY
    ]
    out = {body for pair in pairs if pair & bodies for body in pair - bodies if body}
    for body in range(1, model.nbody):  # parents come first
        if int(model.body_parentid[body]) in out:
            out.add(body)
    return out
