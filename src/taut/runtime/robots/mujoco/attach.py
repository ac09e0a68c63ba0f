"""Finding an arm inside a model of the user's: its joints and actuators by name."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from taut.arm.description import BASE, Arm
from taut.base.checks import one_of
from taut.base.errors import MatchError, RangeError, UnknownNameError, UsageError, quoted_list, unknown_name
from taut.maths.adds import Adds
from taut.runtime.robots.mujoco.compare import compare, compare_rotors, owners, tool_in_body
from taut.runtime.robots.mujoco.drives import Actuator, UserDrives
from taut.runtime.robots.mujoco.rig import Rig, index

if TYPE_CHECKING:
    import mujoco

__all__ = ["Inertias", "attached"]

Inertias = Literal["same", "any"]
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
    owner = owners(model, joints)
    T_body_tool, body = tool_in_body(model, data, arm, joints)
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
    compare(rig, owner, inertias=inertias == "same")
    actuators = list(_actuators(model, rig, bridge=bridge))
    if inertias == "same":
        compare_rotors(rig, actuators)
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
