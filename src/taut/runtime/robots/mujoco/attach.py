"""Finding an arm inside a model of the user's: joints and actuators by name, and whether it is the Arm."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from taut.arm.description import BASE, Arm
from taut.arm.parts import inertia_entries
from taut.base.checks import one_of
from taut.base.errors import MatchError, RangeError, UnknownNameError, UsageError, quoted_list, unknown_name
from taut.base.types import Float64Array
from taut.maths import dynamics as dyn
from taut.maths.adds import Adds
from taut.maths.model import PayloadValues, RigidBody, model_of
from taut.runtime.robots.mujoco.attached import Actuator, UserDrives
from taut.runtime.robots.mujoco.rig import Rig, index
from taut.trace.pose import Pose

if TYPE_CHECKING:
    import mujoco

__all__ = ["Inertias", "attached"]

Inertias = Literal["same", "any"]
MAX_DISTANCE: Final = 1e-3  # [m] of an axis or a centre of mass; files round their numbers
MAX_ROTATION: Final = 1e-3  # [rad] of an axis
MAX_RELATIVE: Final = 1e-3  # relative, of masses, moments of inertia and rotor inertia
MAX_GRAVITY_DIFFERENCE: Final = 1e-3  # [m/s^2]
FINITE: Final = {
    "body": ("body_mass", "body_inertia", "body_pos", "body_quat"),
    "joint": ("dof_armature", "dof_damping", "dof_frictionloss", "jnt_axis", "jnt_pos"),
}


def attached(
    model: mujoco.MjModel, data: mujoco.MjData, arm: Arm, prefix: str, *, bridge: bool, inertias: Inertias
) -> tuple[Rig, UserDrives]:
    """The arm in the user's simulation, and its actuators. Nothing in model or data is changed.

    Raises:
        UsageError: Not a model, its data and an arm.
        UnknownNameError: A joint that the model does not have.
        MatchError: The model's arm is another one, or its actuators do not take torques.
        RangeError: The model or its state is not finite.
    """
    _check_arguments(model, data, arm, prefix)
    one_of("inertias", inertias, ("same", "any"))
    joints = _joints(model, arm, prefix)
    _check_tree(model, arm, joints)
    _check_finite(model, data)
    owner = _owners(model, joints)
    T_body_tool, body = _tool_in_body(model, data, arm, joints)
    dofs = [int(model.jnt_dofadr[j]) for j in joints]
    tool_joint = arm.frame().body
    rig = Rig(
        arm=arm,
        model=model,
        data=data,
        joints=tuple(joints),
        q=index([int(model.jnt_qposadr[j]) for j in joints]),
        v=index(dofs),
        dofs=tuple(dofs),
        tool_bodies=index([b for b in range(model.nbody) if owner[b] == tool_joint] or [body]),
        tool_body=body,
        p_tool=np.array(T_body_tool.p, dtype=np.float64),
        adds=_gravcomp(model, owner),
    )
    _compare(rig, owner, inertias=inertias == "same")
    actuators = list(_actuators(model, rig, bridge=bridge))
    if inertias == "same":
        _compare_rotors(rig, actuators)
    return rig, UserDrives(rig, actuators)


def _check_arguments(model: object, data: object, arm: object, prefix: object) -> None:
    import mujoco

    if not isinstance(model, mujoco.MjModel):
        raise UsageError(f"attach takes a mujoco.MjModel; got {type(model).__name__}", name="model")
    if not isinstance(data, mujoco.MjData):
        raise UsageError(f"attach takes the mujoco.MjData of the model; got {type(data).__name__}", name="data")
    if data.signature != model.signature or data.qpos.size != model.nq:
        raise MatchError("data must be made from this very model: mujoco.MjData(model); it is another's", name="data")
    if not isinstance(arm, Arm):
        raise UsageError(f"attach takes an Arm from taut.load_arm; got {type(arm).__name__}", name="arm")
    if not isinstance(prefix, str):
        raise UsageError(f"prefix must be text, such as 'left/'; got {prefix!r}", name="prefix")


def _joints(model: mujoco.MjModel, arm: Arm, prefix: str) -> list[int]:
    """Ids of the arm's joints."""
    import mujoco

    names = [model.joint(j).name for j in range(model.njnt)]
    out = []
    for joint in arm.joints:
        name = prefix + joint.name
        if name not in names:
            raise _no_joint(arm, prefix, name, [n for n in names if n])
        j = names.index(name)
        wanted = mujoco.mjtJoint.mjJNT_SLIDE if joint.kind == "prismatic" else mujoco.mjtJoint.mjJNT_HINGE
        if int(model.jnt_type[j]) != int(wanted):
            kind = mujoco.mjtJoint(int(model.jnt_type[j])).name.removeprefix("mjJNT_").lower()
            raise MatchError(
                f"joint '{name}' is {joint.kind} in arm '{arm.name}' and of type {kind} in the model; "
                "attach the arm that the model has",
                joint=joint.name,
            )
        out.append(j)
    return out


def _no_joint(arm: Arm, prefix: str, name: str, names: list[str]) -> UnknownNameError:
    if not any(other.startswith(prefix) for other in names):
        found = sorted({n.removesuffix(j) for n in names for j in arm.joint_names if n.endswith(j)})
        way_out = f"use prefix={found[0]!r}" if len(found) == 1 else f"it has the prefixes {quoted_list(found)}"
        if not found:
            way_out = f"its joints are {quoted_list(names)}"
        return UnknownNameError(
            f"the model has no joint whose name begins with '{prefix}'; {way_out}",
            name="prefix",
            value=prefix,
            rule="a prefix",
        )
    return unknown_name("the model", "joint", name, names, hint=f"arm '{arm.name}' has it")


def _check_tree(model: mujoco.MjModel, arm: Arm, joints: list[int]) -> None:
    """The arm's joints hang on each other as in the Arm, and nothing else moves between them and the world."""
    index_of = {j: i for i, j in enumerate(joints)}
    for i, j in enumerate(joints):
        name, body = arm.joint_names[i], int(model.jnt_bodyid[j])
        parent, others = BASE, [k for k in _joints_of(model, body) if k != j]
        while not others:
            body = int(model.body_parentid[body])
            if body == 0:
                break
            found = _joints_of(model, body)
            if len(found) == 1 and found[0] in index_of:
                parent = index_of[found[0]]
                break
            others = found
        if others:
            raise MatchError(
                f"joint '{_called(model, others[0])}' of the model moves joint '{name}', and arm '{arm.name}' has no "
                "such joint there; attach an arm that has it, or take the joint out of the model",
                joint=name,
            )
        if parent != arm.joints[i].parent:
            raise MatchError(
                f"joint '{name}' hangs on {_name_of(arm, parent)} in the model and on "
                f"{_name_of(arm, arm.joints[i].parent)} in arm '{arm.name}'; attach the arm that the model has",
                joint=name,
            )


def _joints_of(model: mujoco.MjModel, body: int) -> list[int]:
    first = int(model.body_jntadr[body])
    return list(range(first, first + int(model.body_jntnum[body])))


def _name_of(arm: Arm, joint: int) -> str:
    return "the base" if joint == BASE else f"'{arm.joint_names[joint]}'"


def _called(model: mujoco.MjModel, joint: int) -> str:
    return str(model.joint(joint).name) or f"joint{joint}"


def _check_finite(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    for owner, names in FINITE.items():
        for name in names:
            rows = np.asarray(getattr(model, name)).reshape(len(getattr(model, name)), -1)
            bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
            if bad.size:
                k = int(model.dof_jntid[bad[0]]) if name.startswith("dof_") else int(bad[0])
                of = model.body(k).name if owner == "body" else _called(model, k)
                raise RangeError(
                    f"model.{name} must be finite; got {rows[bad[0]].tolist()} for {owner} '{of}'", name=name
                )
    for name in ("qpos", "qvel"):
        values = getattr(data, name)
        if not np.isfinite(values).all():
            k = int(np.flatnonzero(~np.isfinite(values))[0])
            raise RangeError(
                f"data.{name} must be finite; got {values[k]} in entry {k}; mujoco.mj_resetData(model, data) gives a "
                "clean start",
                name=name,
            )


def _gravcomp(model: mujoco.MjModel, owner: list[int | None]) -> Adds:
    """A model whose arm has gravcomp carries its own weight, as a robot does that adds gravity itself."""
    ours = [b for b in range(model.nbody) if owner[b] is not None and model.body_mass[b] > 0.0]
    values = {float(model.body_gravcomp[b]) for b in ours}
    if values <= {0.0}:
        return Adds()
    if values == {1.0}:
        return Adds(gravity=True)
    odd = next(b for b in ours if model.body_gravcomp[b] != 1.0)
    raise MatchError(
        f"gravcomp must be 0 or 1, the same for all bodies of an arm; got {sorted(values)} (body "
        f"'{model.body(odd).name}' has {model.body_gravcomp[odd]:g}); set all of model.body_gravcomp alike",
        name="gravcomp",
    )


# -------------------------------------------------------------------- actuators


def _actuators(model: mujoco.MjModel, rig: Rig, *, bridge: bool) -> Iterator[Actuator]:
    import mujoco

    on_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    found: dict[int, str] = {}
    index_of = {j: i for i, j in enumerate(rig.joints)}
    for a in range(model.nactuator):
        if int(model.actuator_trntype[a]) not in on_joint or int(model.actuator_trnid[a, 0]) not in index_of:
            continue
        i = index_of[int(model.actuator_trnid[a, 0])]
        name = model.actuator(a).name or f"actuator{a}"
        if i in found:
            raise MatchError(
                f"joint '{rig.arm.joint_names[i]}' has two actuators in the model, '{found[i]}' and '{name}'; "
                "keep one of them",
                joint=rig.arm.joint_names[i],
            )
        found[i] = name
        actuator = _actuator(model, a, i, name, rig.arm)
        if not actuator.is_motor:
            _check_bridge(model, actuator, rig.arm, bridge=bridge)
        yield actuator


def _actuator(model: mujoco.MjModel, a: int, i: int, name: str, arm: Arm) -> Actuator:
    """The affine law of an actuator; refused where it has none."""
    import mujoco

    gain_type, bias_type = int(model.actuator_gaintype[a]), int(model.actuator_biastype[a])
    gear = float(model.actuator_gear[model.actuator_outadr[a], 0])
    affine_gain = gain_type == int(mujoco.mjtGain.mjGAIN_AFFINE)
    affine_bias = bias_type == int(mujoco.mjtBias.mjBIAS_AFFINE)
    reason = None
    if int(model.actuator_dyntype[a]) != int(mujoco.mjtDyn.mjDYN_NONE):
        reason = "has a state of its own (activation dynamics)"
    elif model.actuator_delay[a] > 0.0:
        reason = f"answers {model.actuator_delay[a]:g} s late"
    elif int(model.actuator_ctrlnum[a]) != 1 or int(model.actuator_outnum[a]) != 1:
        reason = "takes more than one control"
    elif not affine_gain and gain_type != int(mujoco.mjtGain.mjGAIN_FIXED):
        reason = f"has the gain {mujoco.mjtGain(gain_type).name}"
    elif not affine_bias and bias_type != int(mujoco.mjtBias.mjBIAS_NONE):
        reason = f"has the bias {mujoco.mjtBias(bias_type).name}"
    gain = tuple(float(x) for x in model.actuator_gainprm[a, :3])
    bias = tuple(float(x) for x in model.actuator_biasprm[a, :3])
    if reason is None and (gear == 0.0 or gain[0] == 0.0):
        reason = "has gear or gain zero, so that no torque comes through"
    if reason is not None:
        raise MatchError(
            f"actuator '{name}' of joint '{arm.joint_names[i]}' {reason}; a torque command cannot be sent through "
            "it: put a <motor> in its place",
            name=name,
            joint=arm.joint_names[i],
        )
    return Actuator(
        name=name,
        number=a,
        joint=i,
        ctrl=int(model.actuator_ctrladr[a]),
        out=int(model.actuator_outadr[a]),
        gear=gear,
        gain=(gain[0], gain[1], gain[2]) if affine_gain else (gain[0], 0.0, 0.0),
        bias=(bias[0], bias[1], bias[2]) if affine_bias else (0.0, 0.0, 0.0),
        rotor=gear**2 * float(model.actuator_armature[a]),
    )


def _check_bridge(model: mujoco.MjModel, actuator: Actuator, arm: Arm, *, bridge: bool) -> None:
    import mujoco

    joint = arm.joint_names[actuator.joint]
    if not bridge:
        parts = zip(actuator.bias, ("", " length", " speed"), strict=True)
        bias = "".join(f" {'-' if value < 0.0 else '+'} {abs(value):g}{what}" for value, what in parts if value)
        raise MatchError(
            f"actuator '{actuator.name}' of joint '{joint}' is a servo, force = {actuator.gain[0]:g} ctrl{bias}, and "
            "an arm takes torques; put a <motor> in its place, or pass bridge=True, which sends the control that "
            "makes this force the torque",
            name=actuator.name,
            joint=joint,
        )
    if int(model.opt.integrator) != int(mujoco.mjtIntegrator.mjINT_EULER):
        used = mujoco.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_")
        raise MatchError(
            f"bridge=True needs integrator Euler, which takes the servo '{actuator.name}' as it is at the start of a "
            f"step; the model has {used}, which changes its force within the step: set model.opt.integrator = "
            "mujoco.mjtIntegrator.mjINT_EULER",
            name=actuator.name,
            joint=joint,
        )


# -------------------------------------------------------------------- the same arm


def _owners(model: mujoco.MjModel, joints: list[int]) -> list[int | None]:
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


def _tool_in_body(model: mujoco.MjModel, data: mujoco.MjData, arm: Arm, joints: list[int]) -> tuple[Pose, int]:
    """Where the tool is in the body that its joint moves, and that body."""
    scratch = _at_home(model, data, arm, joints)
    frame = arm.frame()
    body = 0 if frame.body == BASE else int(model.jnt_bodyid[joints[frame.body]])
    T_WM = Pose.of(scratch.xmat[body].reshape(3, 3).copy(), scratch.xpos[body].copy())
    return T_WM.inverse() @ dyn.pose(model_of(arm), arm.home), body


def _compare(rig: Rig, owner: list[int | None], *, inertias: bool) -> None:
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


def _compare_rotors(rig: Rig, actuators: list[Actuator]) -> None:
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
