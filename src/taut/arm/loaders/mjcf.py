"""MJCF to links and joints, through MuJoCo's own compiler; no mesh, texture or other file is opened.

A link's frame is MuJoCo's body frame; a joint whose anchor is not its origin has a frame of its own, by its name.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.loaders.mjcf_source import Compiled, compiled, prepare
from taut.arm.loaders.tree import Tree, TreeJoint, TreeLink
from taut.arm.loaders.visuals import MeshPaths, mjcf_visuals
from taut.arm.loaders.xml import Element
from taut.arm.parts import Body, Joint, JointKind
from taut.base.errors import ModelError, Problem, quoted_list
from taut.base.types import Float64Array
from taut.trace.pose import Pose, axis_angle

if TYPE_CHECKING:
    import mujoco

WORLD: Final = "world"


def mjcf_tree(root: Element, path: Path) -> Tree:
    """The links and joints of an MJCF document whose root element has been read already."""
    source = prepare(root, path)
    if source.problems:
        raise ModelError(str(path), source.problems)
    result = compiled(source, path)
    tree = Tree(name=root.get("model") or path.stem, source=str(path), line=root.line, link_word="body")
    links = _Builder(tree, result, str(path)).build()
    meshes = MeshPaths(path.parent)
    for body, visual in mjcf_visuals(result, source.meshes, meshes):
        links[body].visuals.append(visual)
    tree.notes.extend(meshes.notes())
    return tree


class _Builder:
    """Turns a compiled model into links, joints and frames."""

    def __init__(self, tree: Tree, result: Compiled, main: str) -> None:
        self._tree = tree
        self._result = result
        self._model = result.model
        self._main = main
        self._taken: set[str] = set()
        self._links: list[str] = []  # by body id
        self._actuators = _Actuators(result.model)

    def build(self) -> list[TreeLink]:
        """Fill the tree; the link of each body, by id."""
        m = self._model
        self._refuse_loops()
        for i in range(m.nbody):
            name = WORLD if i == 0 else m.body(i).name or f"body{i}"
            self._links.append(self._unique(name))
        bodies = [self._body(i) for i in range(m.nbody)]
        for i in range(m.nsite):
            name = self._unique(m.site(i).name or f"site{i}")
            pose = _pose(m.site_pos[i], m.site_quat[i])
            self._tree.frames.append((name, self._links[m.site_bodyid[i]], pose))
        self._tree.gravity = _gravity(m)
        self._home()
        self._tree.notes.extend(_left_out(m))
        self._tree.notes.extend(self._actuators.notes)
        return bodies

    def _unique(self, name: str) -> str:
        """Frames share one set of names; in MuJoCo a body, a joint and a site may have the same one."""
        while name in self._taken:
            name = f"{name}_"
        self._taken.add(name)
        return name

    def _line(self, element: Element | None) -> int | None:
        return element.line if element is not None and element.file == self._main else None

    def _body(self, i: int) -> TreeLink:
        m, name = self._model, self._links[i]
        line = self._line(self._result.bodies[i])
        link = TreeLink(name=name, line=line)
        if m.body_mass[i] > 0.0 or m.body_inertia[i].any():
            pose = _pose(m.body_ipos[i], m.body_iquat[i])
            I = pose.R @ np.diag(m.body_inertia[i]) @ pose.R.T
            link.inertia = Body(mass=float(m.body_mass[i]), com=pose.p, inertia=I)
        self._tree.links.append(link)
        if i > 0:
            self._hang(i, name, line)
        return link

    def _hang(self, i: int, name: str, line: int | None) -> None:
        """Join a body to its parent, through its joints where it has any."""
        m = self._model
        parent = self._links[m.body_parentid[i]]
        T_parent_body = _pose(m.body_pos[i], m.body_quat[i])
        first, count = int(m.body_jntadr[i]), int(m.body_jntnum[i])
        if count == 0:
            self._tree.joints.append(TreeJoint.fixed(parent, name, T_parent_body))
            return
        # T(q) = T_parent_body * [shift to the anchor, turn by q - ref, shift back] for each joint in turn
        T_parent_joint = T_parent_body
        for k, j in enumerate(range(first, first + count)):
            anchor = np.array(m.jnt_pos[j], dtype=np.float64)
            shift = Pose(anchor)
            last = k == count - 1
            child = name if last and not anchor.any() else self._between(j, name, line, last=last)
            self._joint(j, parent, child, T_parent_joint @ shift)
            if child == name:
                return
            parent, T_parent_joint = child, shift.inverse()
        self._tree.joints.append(TreeJoint.fixed(parent, name, T_parent_joint))

    def _between(self, j: int, body: str, line: int | None, *, last: bool) -> str:
        """A link without mass at the anchor of a joint: before another joint, or off the body's origin."""
        joint = self._joint_name(j)
        link = TreeLink(name=self._unique(joint), line=line, is_frame=last)
        if not last:
            way_out = (
                "write one body for each joint, inside one another, each with its own <inertial>, or hold all but "
                f"one of them still: load_arm(..., locked={{'{joint}': 0.0}})"
            )
            text = f"body '{body}' has several joints that move, and taut has a body for each joint: {way_out}"
            link.if_massless = Problem(object=body, attribute="joint", message=text, line=line)
        self._tree.links.append(link)
        return link.name

    def _joint(self, j: int, parent: str, child: str, T_parent_joint: Pose) -> None:
        import mujoco

        m = self._model
        kinds: dict[int, JointKind] = {
            int(mujoco.mjtJoint.mjJNT_FREE): "floating",
            int(mujoco.mjtJoint.mjJNT_BALL): "ball",
            int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
            int(mujoco.mjtJoint.mjJNT_HINGE): "revolute" if m.jnt_limited[j] else "continuous",
        }
        kind = kinds[int(m.jnt_type[j])]
        name, line = self._joint_name(j), self._line(self._result.joints[j] or self._result.bodies[m.jnt_bodyid[j]])
        joint, mimic = Joint(name=name, kind=kind, placement=T_parent_joint), None
        if kind not in ("floating", "ball"):
            dof, axis = int(m.jnt_dofadr[j]), np.array(m.jnt_axis[j], dtype=np.float64)
            ref, mimic = float(m.qpos0[m.jnt_qposadr[j]]), self._coupled(j)
            low, high = m.jnt_range[j] if m.jnt_limited[j] else (-math.inf, math.inf)
            joint = Joint(
                name=name,
                kind=kind,
                placement=T_parent_joint @ _motion(kind, axis, -ref),
                axis=axis,
                lower=float(low),
                upper=float(high),
                effort=self._actuators.effort(j),
                viscous=float(m.dof_damping[dof]) + self._actuators.damping.get(j, 0.0),
                coulomb=float(m.dof_frictionloss[dof]),
                gear=self._actuators.gear(j),
                rotor_inertia=float(m.dof_armature[dof]) + self._actuators.inertia.get(j, 0.0),
            )
        self._tree.joints.append(TreeJoint(joint=joint, parent=parent, child=child, mimic=mimic, line=line))

    def _joint_name(self, j: int) -> str:
        return self._model.jnt(j).name or f"joint{j}"

    def _coupled(self, j: int) -> str | None:
        """The joint that an equality ties this one to; "" for a constant."""
        import mujoco

        m = self._model
        for e in range(m.neq):
            tied = int(m.eq_type[e]) == int(mujoco.mjtEq.mjEQ_JOINT) and bool(m.eq_active0[e])
            if tied and int(m.eq_obj1id[e]) == j:
                other = int(m.eq_obj2id[e])
                return "" if other < 0 else self._joint_name(other)
        return None

    def _refuse_loops(self) -> None:
        import mujoco

        m = self._model
        for e in range(m.neq):
            if int(m.eq_type[e]) == int(mujoco.mjtEq.mjEQ_JOINT) or not m.eq_active0[e]:
                continue
            kind = mujoco.mjtEq(int(m.eq_type[e])).name.removeprefix("mjEQ_").lower()
            name = m.eq(e).name
            called = f"equality '{name}'" if name else "an equality"
            way_out = "take it out and state the closure as a constraint"
            text = f"{called} of type {kind} closes a loop, and an arm is a tree: {way_out}"
            self._tree.problem(name or "equality", kind, text, self._line(self._result.equalities[e]))

    def _home(self) -> None:
        """The key frame 'home', where the file has one."""
        m = self._model
        for joint in self._tree.movable.values():
            if m.nkey == 0 or joint.kind not in ("revolute", "continuous", "prismatic"):
                continue
            j = next(j for j in range(m.njnt) if self._joint_name(j) == joint.name)
            value = float(m.key_qpos[0, m.jnt_qposadr[j]])
            if joint.lower <= value <= joint.upper:
                self._tree.home[joint.name] = value
            else:
                self._tree.notes.append(f"the key frame 'home' puts joint '{joint.name}' out of its limits")


class _Actuators:
    """What the actuators give to each joint: effort, and through their gears inertia and damping of their rotors."""

    def __init__(self, m: mujoco.MjModel) -> None:
        import mujoco

        self._m = m
        self._efforts: dict[int, float] = {}
        self._gears: dict[int, set[float]] = {}  # of actuators that have a rotor
        self.inertia: dict[int, float] = {}  # seen at the joint [kg m^2 | kg]
        self.damping: dict[int, float] = {}  # seen at the joint [N m s/rad | N s/m]
        servos, elsewhere = [], []
        on_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        for a in range(m.nactuator):
            name = m.actuator(a).name or f"actuator{a}"
            if int(m.actuator_trntype[a]) not in on_joint:
                elsewhere.append(name)
                continue
            unbiased = int(m.actuator_biastype[a]) == int(mujoco.mjtBias.mjBIAS_NONE)
            gain = int(m.actuator_gaintype[a])
            if not unbiased:
                servos.append(name)
            largest = _smaller_side(m.actuator_forcerange[a]) if m.actuator_forcelimited[a] else math.inf
            if unbiased and gain == int(mujoco.mjtGain.mjGAIN_FIXED) and m.actuator_ctrllimited[a]:
                largest = min(largest, abs(m.actuator_gainprm[a, 0]) * _smaller_side(m.actuator_ctrlrange[a]))
            j, gear = int(m.actuator_trnid[a, 0]), abs(float(m.actuator_gear[m.actuator_outadr[a], 0]))
            self._efforts[j] = self._efforts.get(j, 0.0) + (gear * largest if gear else 0.0)
            self.damping[j] = self.damping.get(j, 0.0) + gear**2 * float(m.actuator_damping[a])
            if m.actuator_armature[a]:
                self.inertia[j] = self.inertia.get(j, 0.0) + gear**2 * float(m.actuator_armature[a])
                self._gears.setdefault(j, set()).add(gear)
        says = (
            ("actuators with their own gains or motors: {}; an Arm takes torques", servos),
            ("actuators that drive no joint are left out: {}", elsewhere),
        )
        self.notes = [text.format(quoted_list(names)) for text, names in says if names]

    def effort(self, j: int) -> float:
        """Largest torque [N m | N]; infinite where the file bounds neither the joint nor its actuators."""
        own = _smaller_side(self._m.jnt_actfrcrange[j]) if self._m.jnt_actfrclimited[j] else math.inf
        return min(own, self._efforts.get(j, math.inf))

    def gear(self, j: int) -> float:
        """Turns of the one rotor per turn of the joint; 1 where there is none. Other actuators' gear only scales."""
        gears = self._gears.get(j, set())
        return next(iter(gears)) if len(gears) == 1 and 0.0 not in gears else 1.0


def _smaller_side(both: Float64Array) -> float:
    """An Arm's effort limit is the same both ways; the smaller one is safe."""
    return float(min(abs(both[0]), abs(both[1])))


def _motion(kind: JointKind, axis: Float64Array, q: float) -> Pose:
    return Pose(axis * q) if kind == "prismatic" else Pose(R=axis_angle(axis, q))


def _pose(p: Float64Array, wxyz: Float64Array) -> Pose:
    return Pose(np.array(p, dtype=np.float64), wxyz=np.array(wxyz, dtype=np.float64))


def _gravity(m: mujoco.MjModel) -> Float64Array:
    import mujoco

    off = int(m.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    return np.zeros(3) if off else np.array(m.opt.gravity, dtype=np.float64)


def _left_out(m: mujoco.MjModel) -> Iterator[str]:
    """What a MuJoCo model can have and an Arm has not."""
    springs = [
        m.jnt(j).name or f"joint{j}" for j in range(m.njnt) if m.jnt_stiffness[j] or m.jnt_stiffnesspoly[j].any()
    ]
    if springs:
        yield f"springs left out, on {quoted_list(springs)}"
    bodies = [m.body(i).name or f"body{i}" for i in range(m.nbody) if m.body_gravcomp[i] != 0.0]
    if bodies:
        yield f"gravcomp left out, on {quoted_list(bodies)}; a law compensates gravity"
    if m.ntendon:
        yield f"{m.ntendon} tendons left out" if m.ntendon > 1 else "1 tendon left out"
