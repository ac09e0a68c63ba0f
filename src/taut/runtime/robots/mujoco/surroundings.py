"""What of a MuJoCo model is not the arm, for films: its shapes, and where the bodies are that move."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.types import Float64Array
from taut.record.film.surroundings import Around, Mesh, Shape, ShapeKind, Thing
from taut.runtime.robots.mujoco.rig import Rig

if TYPE_CHECKING:
    import mujoco

__all__ = ["SceneView"]

KINDS: Final[dict[str, ShapeKind]] = {
    "PLANE": "plane",
    "BOX": "box",
    "SPHERE": "sphere",
    "ELLIPSOID": "ellipsoid",
    "CYLINDER": "cylinder",
    "CAPSULE": "capsule",
    "MESH": "mesh",
}
HIDDEN: Final = 3  # the first group of geoms that MuJoCo's viewers hide
MOST_MOVING: Final = 32  # bodies, each of which takes 7 numbers of every tick
MOST_VERTICES: Final = 50_000  # of all meshes: some MB in a log


class SceneView:
    """Everything of a model but the links of its arm.

    Args:
        rig: The arm in the model.
        tool: Whether the body of the tool is the plant's own, at the tool's frame; its shapes, hidden or not, are
            those that touch.
    """

    def __init__(self, rig: Rig, *, tool: bool = True) -> None:
        import mujoco

        self._model, self._data = model, data = rig.model, mujoco.MjData(rig.model)
        mujoco.mj_kinematics(model, data)
        self._meshes: dict[int, int] = {}
        self._missing: dict[str, int] = {}
        carried = {int(model.jnt_bodyid[j]) for j in rig.joints}
        things: list[Thing] = []
        moving: list[int] = []
        left_out = 0
        for body in range(model.nbody):
            root = int(model.body_weldid[body])
            on_tool = tool and body == rig.tool_body
            if root in carried and not on_tool:
                continue
            touches = on_tool or (tool and int(model.body_parentid[body]) == rig.tool_body)
            shapes = self._shapes(body, rig.own_geoms if body == 0 else 0, hidden=touches)
            if not shapes:
                continue
            row = None
            if root and not on_tool:
                if len(moving) == MOST_MOVING:
                    left_out += 1
                    continue
                row = len(moving)
                moving.append(body)
            p, wxyz = (data.xpos[body], data.xquat[body]) if not on_tool else (np.zeros(3), [1.0, 0.0, 0.0, 0.0])
            things.append(Thing(shapes=shapes, p=_numbers(p), wxyz=_numbers(wxyz), row=row, on_tool=on_tool))
        missing = [f"{count} of its geoms, {kind}" for kind, count in self._missing.items()]
        missing += [f"{left_out} of its moving bodies, beyond {MOST_MOVING}"] if left_out else []
        meshes = tuple(_mesh(model, number) for number in self._meshes)
        self.around = Around(things=tuple(things), meshes=meshes, missing=tuple(missing))
        self._moving = np.array(moving, dtype=np.intp)

    @property
    def moves(self) -> bool:
        """Whether there is anything whose pose is to be recorded."""
        return bool(len(self._moving))

    def poses(self, data: mujoco.MjData) -> Float64Array:
        """(m, 7) position [m] and quaternion wxyz of the bodies that move, as the last step found them."""
        return np.hstack([data.xpos[self._moving], data.xquat[self._moving]])

    def _shapes(self, body: int, skipped: int, *, hidden: bool) -> tuple[Shape, ...]:
        """The shapes of a body that a viewer shows."""
        import mujoco

        model, first = self._model, int(self._model.body_geomadr[body])
        out = []
        for geom in range(first + skipped, first + int(model.body_geomnum[body])):
            material = int(model.geom_matid[geom])
            rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
            if rgba[3] == 0.0 or (int(model.geom_group[geom]) >= HIDDEN and not hidden):
                continue
            name = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_")
            if name not in KINDS or (name == "MESH" and not self._has_room(int(model.geom_dataid[geom]))):
                what = f"of kind {name.lower()}" if name not in KINDS else "whose meshes are too large for a log"
                self._missing[what] = self._missing.get(what, 0) + 1
                continue
            mesh = -1 if name != "MESH" else self._meshes.setdefault(int(model.geom_dataid[geom]), len(self._meshes))
            out.append(
                Shape(
                    kind=KINDS[name],
                    size=_numbers(model.geom_size[geom]),
                    p=_numbers(model.geom_pos[geom]),
                    wxyz=_numbers(model.geom_quat[geom]),
                    rgba=_numbers(rgba),
                    mesh=mesh,
                )
            )
        return tuple(out)

    def _has_room(self, mesh: int) -> bool:
        count = sum(int(self._model.mesh_vertnum[number]) for number in {*self._meshes, mesh})
        return count <= MOST_VERTICES


def _mesh(model: mujoco.MjModel, number: int) -> Mesh:
    vertex, face = int(model.mesh_vertadr[number]), int(model.mesh_faceadr[number])
    vertices = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[number])]
    faces = model.mesh_face[face : face + int(model.mesh_facenum[number])]
    return Mesh(vertices=np.round(vertices.astype(np.float64), 6), faces=np.array(faces, dtype=np.float64))


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(float(x) for x in values)
