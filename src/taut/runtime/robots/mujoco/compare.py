"""Whether an arm inside a model of the user's is the Arm: where its axes are, what its bodies weigh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.description import BASE, Arm
from taut.arm.parts import inertia_entries
from taut.base.errors import MatchError, quoted_list
from taut.base.types import Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, RigidBody, model_of
from taut.runtime.robots.mujoco.drives import Actuator
from taut.runtime.robots.mujoco.rig import Rig
from taut.trace.pose import Pose

if TYPE_CHECKING:
    import mujoco

__all__ = ["compare", "compare_rotors", "owners", "tool_in_body"]

MAX_DISTANCE: Final = 1e-3  # [m] of an axis or a centre of mass; files round their numbers
MAX_ROTATION: Final = 1e-3  # [rad] of an axis
MAX_RELATIVE: Final = 1e-3  # relative, of masses, moments of inertia and rotor inertia
MAX_GRAVITY_DIFFERENCE: Final = 1e-3  # [m/s^2]


def owners(model: mujoco.MjModel, joints: list[int]) -> list[int | None]:
    """For each body of the model, the joint of the arm that carries it; None if none does."""
    index_of = {int(model.jnt_bodyid[j]): i for i, j in enumerate(joints)}
    out: list[int | None] = [None] * model.nbody
    for body in range(1, model.nbody):  # parents come first
        out[body] = index_of.get(body, out[int(model.body_parentid[body])])
    return out


def _at_home(model: mujoco.MjModel, data: mujoco.MjData, arm: Arm, joints: list[int]) -> mujoco.MjData:
    """The user's simulation with the arm at home, in data of our own."""
    import mujoco

    scratch = mujoco.MjData(model)
    scratch.qpos[:] = data.qpos
    scratch.mocap_pos[:], scratch.mocap_quat[:] = data.mocap_pos, data.mocap_quat
    scratch.qpos[[int(model.jnt_qposadr[j]) for j in joints]] = arm.home
    mujoco.mj_kinematics(model, scratch)
    return scratch


def tool_in_body(model: mujoco.MjModel, data: mujoco.MjData, arm: Arm, joints: list[int]) -> tuple[Pose, int]:
    """Where the tool is in the body that its joint moves, and that body."""
    scratch = _at_home(model, data, arm, joints)
    frame = arm.frame()
    body = 0 if frame.body == BASE else int(model.jnt_bodyid[joints[frame.body]])
    T_WM = Pose.of(scratch.xmat[body].reshape(3, 3).copy(), scratch.xpos[body].copy())
    return T_WM.inverse() @ dyn.pose(model_of(arm), arm.home), body


def compare(rig: Rig, owner: list[int | None], *, inertias: bool) -> None:
    """Refuse another arm than the Arm.

    Raises:
        MatchError: An axis, a mass, an inertia or gravity differs; the message has both numbers.
    """
    import mujoco

    model, arm = rig.model, rig.arm
    scratch = _at_home(model, rig.data, arm, list(rig.joints))
    off = int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    gravity = np.zeros(3) if off else np.asarray(model.opt.gravity)
    if np.abs(gravity - arm.gravity).max() > MAX_GRAVITY_DIFFERENCE:
        raise MatchError(
            f"gravity is {_numbers(gravity)} in the model and {_numbers(arm.gravity)} m/s^2 for arm '{arm.name}'; "
            "use arm.with_gravity(model.opt.gravity)",
            name="gravity",
        )
    _compare_axes(rig, scratch)
    if inertias:
        _compare_inertias(rig, scratch, owner)


def _compare_axes(rig: Rig, scratch: mujoco.MjData) -> None:
    arm, constants = rig.arm, model_of(rig.arm)
    links = dyn.link_poses(constants, arm.home)
    rows = list(rig.joints)
    axes, anchors = scratch.xaxis[rows], scratch.xanchor[rows]
    ours = np.array([R[:, 2] for R, _ in links])
    points = np.array([p for _, p in links])
    for i, joint in enumerate(arm.joints):
        turned = float(np.linalg.norm(np.cross(axes[i], ours[i]))) if axes[i] @ ours[i] > 0.0 else 2.0
        apart = points[i] - anchors[i]
        distance = float(np.linalg.norm(apart - ours[i] * (apart @ ours[i])))
        if turned <= MAX_ROTATION and (joint.kind == "prismatic" or distance <= MAX_DISTANCE):
            continue
        mount = _mount(arm, np.vstack([anchors, anchors + axes]), np.vstack([points, points + ours]))
        if mount is not None:
            p, rpy = _numbers(mount.p), _numbers(mount.rpy)
            raise MatchError(
                f"arm '{arm.name}' stands elsewhere in the model: its base is at p={p}, rpy={rpy}; use "
                f"arm.mounted(taut.Pose(p={p}, rpy={rpy}))",
                name="T_WB",
            )
        raise MatchError(
            f"joint '{joint.name}' at the home pose has its axis at {_numbers(anchors[i])} along {_numbers(axes[i])} "
            f"in the model and at {_numbers(points[i])} along {_numbers(ours[i])} in arm '{arm.name}' (world, m): "
            "another arm, another zero of a joint, or another T_WB; load the Arm from the model's own file",
            joint=joint.name,
        )


def _mount(arm: Arm, there: Float64Array, here: Float64Array) -> Pose | None:
    """The mounting that would make the Arm's points the model's; None if there is none (Kabsch)."""
    if arm.n < 2:
        return None
    a, b = there - there.mean(axis=0), here - here.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))])
    R = Vt.T @ mirror @ U.T
    if np.abs(a - b @ R.T).max() > MAX_DISTANCE:
        return None
    T = Pose.of(R, there.mean(axis=0) - R @ here.mean(axis=0)) @ arm.T_WB
    return Pose.of(np.round(T.R, 9), np.round(T.p, 9))


def _compare_inertias(rig: Rig, scratch: mujoco.MjData, owner: list[int | None]) -> None:
    model, arm = rig.model, rig.arm
    constants = model_of(arm)
    links = dyn.link_poses(constants, arm.home)
    tool = arm.frame()
    for i, body in enumerate(arm.bodies):
        R, p = links[i]
        R = R @ constants.aligned[i].T  # from our axes to the Arm's own
        expected = _rigid(body.mass, p + R @ body.com, R @ body.inertia @ R.T)
        if tool.body == i and arm.payload.mass > 0.0:
            load, T = arm.payload, dyn.pose(constants, arm.home)
            carried = PayloadValues(mass=load.mass, com=load.com, inertia=load.inertia)
            expected = expected + carried.body().seen_from(T.R, T.p)
        carried_here = [b for b in range(model.nbody) if owner[b] == i]
        found = RigidBody(m=0.0, h=np.zeros(3), I=np.zeros((3, 3)))
        for b in carried_here:
            A = scratch.ximat[b].reshape(3, 3)
            moments = np.diag(model.body_inertia[b])
            found = found + _rigid(float(model.body_mass[b]), scratch.xipos[b], A @ moments @ A.T)
        names = [str(model.body(b).name) for b in carried_here]
        _compare_body(arm, i, names, found, expected)


def _rigid(mass: float, com: Float64Array, I: Float64Array) -> RigidBody:
    """A body about the world's origin."""
    here = RigidBody(m=mass, h=np.zeros(3), I=I)
    return here.seen_from(np.eye(3), com)


def _about_com(body: RigidBody) -> tuple[Float64Array, Float64Array]:
    com = body.h / body.m if body.m > 0.0 else np.zeros(3)
    moved = RigidBody(m=body.m, h=body.h, I=body.I).seen_from(np.eye(3), -com)
    return np.asarray(com, dtype=np.float64), np.asarray(moved.I, dtype=np.float64)


def _compare_body(arm: Arm, i: int, names: list[str], found: RigidBody, expected: RigidBody) -> None:
    who = f"body '{names[0]}'" + (f" with {quoted_list(names[1:], 3)}" if len(names) > 1 else "")
    (com, I), (com_arm, I_arm) = _about_com(found), _about_com(expected)
    if abs(found.m - expected.m) > MAX_RELATIVE * expected.m:
        what, there, here = "mass", f"{found.m:.6g} kg", f"{expected.m:.6g} kg"
    elif np.linalg.norm(com - com_arm) > MAX_DISTANCE:
        what, there, here = "centre of mass (world, home pose)", f"{_numbers(com)} m", f"{_numbers(com_arm)} m"
    elif np.abs(I - I_arm).max() > MAX_RELATIVE * np.trace(I_arm) + 1e-9:
        what = "inertia (xx, yy, zz, xy, xz, yz; world axes, home pose)"
        there, here = (f"{_numbers(inertia_entries(J))} kg m^2" for J in (I, I_arm))
    else:
        return
    raise MatchError(
        f"joint '{arm.joint_names[i]}': the {what} of {who} is {there} in the model and {here} in arm '{arm.name}'; "
        "load the Arm from the model's own file, or accept the difference with inertias='any'",
        joint=arm.joint_names[i],
    )


def compare_rotors(rig: Rig, actuators: list[Actuator]) -> None:
    """Refuse other rotor inertias than the Arm's; an actuator may bring some with it."""
    model, arm = rig.model, rig.arm
    total = np.array(model.dof_armature)[list(rig.dofs)]
    for a in actuators:
        total[a.joint] += a.rotor
    for i, name in enumerate(arm.joint_names):
        ours = float(arm.rotor_inertia[i])
        if abs(total[i] - ours) > MAX_RELATIVE * max(ours, 1e-6):
            raise MatchError(
                f"joint '{name}' has armature {total[i]:g} in the model and rotor inertia {ours:g} in arm "
                f"'{arm.name}'; use arm.with_joints(rotor_inertia=...), or accept the difference with inertias='any'",
                joint=name,
            )


def _numbers(values: Float64Array) -> str:
    return "[" + ", ".join(f"{float(x) + 0.0:.6g}" for x in values) + "]"
