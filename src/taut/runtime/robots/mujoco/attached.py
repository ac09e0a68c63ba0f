"""AttachedPlant: an arm found inside a MuJoCo simulation of the user's, compared with the Arm, and driven there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import instance_of
from taut.base.errors import MatchError, UsageError, unknown_name
from taut.base.types import Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import Adds, PayloadValues, model_of
from taut.plant.actuation import Actuation
from taut.plant.sensors import Sensors
from taut.runtime.robots.mujoco.rig import PlantInMujoco, Rig, index, whole_steps
from taut.runtime.robots.mujoco.scene import SceneView
from taut.trace.pose import Pose

if TYPE_CHECKING:
    import mujoco

MAX_DISTANCE: Final = 1e-3  # [m] of an axis; files round their numbers
MAX_ROTATION: Final = 1e-3  # [rad] of an axis
MAX_RELATIVE: Final = 1e-3  # relative, of inertias and torques of gravity
MAX_GRAVITY_DIFFERENCE: Final = 1e-3  # [m/s^2]
COMPARED_POSES: Final = 3  # at which the dynamics are compared
TRUNCATION: Final = 1e-9  # relative to the command: less than this is rounding


class AttachedPlant(PlantInMujoco):
    """An arm inside a simulation of the user's, see `taut.MujocoPlant.attach`.

    It takes torques and has ideal drives and sensors. Friction, limits and parameters are those of the user's model.
    Controls and applied forces have the run's values during the steps of a period only, so that nothing goes on
    pushing the arm after a run, however it ends. `motors` are the model's by joint; joints without one get their
    torque through qfrc_applied.
    """

    measures = frozenset({"v", "tau_meas", "F_ext"})

    def __init__(self, rig: Rig, motors: dict[int, int], name: str) -> None:
        super().__init__(rig, name, SceneView(rig, tool=False))
        model, numbers = rig.model, list(motors.values())
        self.friction: Literal["arm"] = "arm"
        self.actuation, self.sensors = Actuation(), Sensors()
        self._joints = np.array(list(motors), dtype=np.intp)
        self._at, self._out = model.actuator_ctrladr[numbers], model.actuator_outadr[numbers]
        self._gear, self._gain = model.actuator_gear[self._out, 0], model.actuator_gainprm[numbers, 0]
        rows = [rig.joints[i] for i in motors]
        limited = np.asarray(model.jnt_actfrclimited)[rows][:, np.newaxis] != 0
        between = np.where(limited, model.jnt_actfrcrange[rows], (-np.inf, np.inf))
        self._range = between.T  # what the joint lets through
        self._free = np.setdiff1d(np.arange(rig.arm.n), self._joints)  # joints without a motor
        self._free_dofs = np.array(rig.dofs, dtype=np.intp)[self._free]

    def __reduce__(self) -> tuple[Any, ...]:
        raise UsageError(
            "an attached plant drives a simulation of yours, so it cannot be copied or pickled; attach another one "
            "to the copy: taut.MujocoPlant.attach(model, data, arm)"
        )

    def reset(self, q: Float64Array, v: Float64Array, dt: float, seed: int = 0) -> None:  # noqa: ARG002
        """Put the arm into a state, for periods of dt [s], multiples of the time step. Nothing else moves."""
        self._substeps = whole_steps(self.name, dt, float(self.model.opt.timestep), "model.opt.timestep")
        self._put_state(q, v)

    def measure(self) -> dict[str, Float64Array]:
        """Positions, velocities, what the actuators gave, and the wrench at the tool in the last step."""
        q, v = self.state()
        return {"q": q, "v": v, "tau_meas": self._tau.copy(), "F_ext": self._F_ext.copy()}

    def advance(self, command: Float64Array) -> Float64Array:
        """One control period under a command (n,); (n,) the torque that acted on the joints."""
        ctrl, applied, free = self.data.ctrl, self.data.qfrc_applied, self._free_dofs
        users = ctrl[self._at], applied[free]  # copies
        tau = command.copy()
        try:
            ctrl[self._at] = command[self._joints] / self._gear / self._gain
            applied[free] = command[self._free]
            with self._guard:
                self._mj_step(self.model, self.data, self._substeps)
            tau[self._joints] = np.clip(self._gear * self.data.actuator_force[self._out], *self._range)
        finally:
            ctrl[self._at], applied[free] = users
        self._tau, self._F_ext = tau, self._wrench.of_environment()
        cut = command - tau
        self._cut = np.where(np.abs(cut) > TRUNCATION * np.maximum(1.0, np.abs(command)), cut, 0.0)
        self._warn_of_cut("its actuator's limits", "the controller limits=taut.Limits(tau=...)")
        return tau

    def extra(self) -> dict[str, Any]:
        """(6,) F_ext of the last step; (n,) tau_cut, what the actuators cut off; (m, 7) poses of bodies that move."""
        return {"F_ext": self._F_ext, "tau_cut": self._cut, **self._poses()}


def attached(model: mujoco.MjModel, data: mujoco.MjData, arm: Arm, prefix: str) -> AttachedPlant:
    """The arm in the user's simulation, with its motors there. Nothing in model or data is changed."""
    import mujoco

    for name, value, kind in (
        ("model", model, mujoco.MjModel),
        ("data", data, mujoco.MjData),
        ("arm", arm, Arm),
        ("prefix", prefix, str),
    ):
        instance_of(name, value, kind, f"of type {kind.__name__}")
    if data.signature != model.signature or data.qpos.size != model.nq:
        raise MatchError("data must be made from this very model: mujoco.MjData(model); it is another's", name="data")
    joints = [_joint(model, arm, i, prefix) for i in range(arm.n)]
    _check_tree(model, arm, joints)
    owner = _owners(model, joints)
    tool = arm.frame().body
    body = 0 if tool < 0 else int(model.jnt_bodyid[joints[tool]])
    here = _at(model, data, [int(model.jnt_qposadr[j]) for j in joints], arm.home)
    T_WM = Pose.of(here.xmat[body].reshape(3, 3).copy(), here.xpos[body].copy())
    rig = Rig(
        arm=arm,
        model=model,
        data=data,
        joints=tuple(joints),
        tool_bodies=index([b for b in range(model.nbody) if owner[b] == tool] or [body]),
        tool_body=body,
        p_tool=np.array((T_WM.inverse() @ dyn.pose(model_of(arm), arm.home)).p, dtype=np.float64),
        adds=_gravcomp(model, [b for b in range(model.nbody) if owner[b] is not None and model.body_mass[b] > 0.0]),
    )
    _compare_axes(rig, here)
    _compare_dynamics(rig)
    return AttachedPlant(rig, _motors(rig), f"MujocoPlant.attach({prefix}{arm.name})")


def _joint(model: mujoco.MjModel, arm: Arm, i: int, prefix: str) -> int:
    """Id of a joint of the arm."""
    import mujoco

    names = [model.joint(j).name for j in range(model.njnt)]
    joint, name = arm.joints[i], prefix + arm.joint_names[i]
    if name not in names:
        known = [other for other in names if other]
        raise unknown_name("the model", "joint", name, known, hint=f"arm '{arm.name}' has it; prefix={prefix!r}")
    j = names.index(name)
    wanted = mujoco.mjtJoint.mjJNT_SLIDE if joint.kind == "prismatic" else mujoco.mjtJoint.mjJNT_HINGE
    if int(model.jnt_type[j]) != int(wanted):
        kind = mujoco.mjtJoint(int(model.jnt_type[j])).name.removeprefix("mjJNT_").lower()
        raise MatchError(
            f"joint '{name}' is {joint.kind} in arm '{arm.name}' and of type {kind} in the model; "
            "attach the arm that the model has",
            joint=joint.name,
        )
    return j


def _check_tree(model: mujoco.MjModel, arm: Arm, joints: list[int]) -> None:
    """MatchError where a joint that the arm does not have moves the arm."""
    for name, j in zip(arm.joint_names, joints, strict=True):
        body = int(model.jnt_bodyid[j])
        while body:
            first = int(model.body_jntadr[body])
            for k in set(range(first, first + int(model.body_jntnum[body]))) - set(joints):
                raise MatchError(
                    f"joint '{model.joint(k).name or k}' of the model moves joint '{name}', and arm '{arm.name}' has "
                    "no such joint there; attach an arm that has it, or take the joint out of the model",
                    joint=name,
                )
            body = int(model.body_parentid[body])


def _owners(model: mujoco.MjModel, joints: list[int]) -> list[int | None]:
    """For each body of the model, the joint of the arm that carries it; None if none does."""
    index_of = {int(model.jnt_bodyid[j]): i for i, j in enumerate(joints)}
    out: list[int | None] = [None] * model.nbody
    for body in range(1, model.nbody):  # parents come first
        out[body] = index_of.get(body, out[int(model.body_parentid[body])])
    return out


def _gravcomp(model: mujoco.MjModel, bodies: list[int]) -> Adds:
    """A model whose arm has gravcomp carries its own weight, as a robot does that adds gravity itself."""
    values = set(np.asarray(model.body_gravcomp)[bodies].tolist())
    if values <= {0.0} or values == {1.0}:
        return Adds(gravity=1.0 in values)
    raise MatchError(
        f"gravcomp must be 0 or 1, the same for all bodies of an arm; got {sorted(values)}; set all of "
        "model.body_gravcomp alike",
        name="gravcomp",
    )


def _motors(rig: Rig) -> dict[int, int]:
    """The motor of each joint of the arm that has one, by the joint."""
    import mujoco

    model, out = rig.model, dict[int, int]()
    on_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    for a in range(model.nactuator):
        if model.actuator_trntype[a] not in on_joint or model.actuator_trnid[a, 0] not in rig.joints:
            continue
        i, name = rig.joints.index(int(model.actuator_trnid[a, 0])), model.actuator(a).name or f"actuator{a}"
        joint = rig.arm.joint_names[i]
        if i in out:
            raise MatchError(f"joint '{joint}' has two actuators, the second '{name}'; keep one", joint=joint)
        plain = (
            model.actuator_dyntype[a] == int(mujoco.mjtDyn.mjDYN_NONE)
            and model.actuator_gaintype[a] == int(mujoco.mjtGain.mjGAIN_FIXED)
            and model.actuator_biastype[a] == int(mujoco.mjtBias.mjBIAS_NONE)
            and model.actuator_ctrlnum[a] == model.actuator_outnum[a] == 1
            and model.actuator_delay[a] == 0.0
            and model.actuator_gear[model.actuator_outadr[a], 0] * model.actuator_gainprm[a, 0] != 0.0
        )
        if not plain:
            raise MatchError(
                f"actuator '{name}' of joint '{joint}' is not a motor, whose torque is its control times a "
                "constant, so that no torque command can be sent through it; make it one: "
                f"spec.actuator('{name}').set_to_motor() of its mujoco.MjSpec",
                name=name,
                joint=joint,
            )
        out[i] = a
    return out


def _at(model: mujoco.MjModel, data: mujoco.MjData, at: Any, q: Float64Array) -> mujoco.MjData:
    """The user's simulation at rest with the arm at q, in data of our own."""
    import mujoco

    scratch = mujoco.MjData(model)
    scratch.qpos[:] = data.qpos
    scratch.mocap_pos[:], scratch.mocap_quat[:] = data.mocap_pos, data.mocap_quat
    scratch.qpos[at] = q
    mujoco.mj_fwdPosition(model, scratch)
    mujoco.mj_fwdVelocity(model, scratch)
    return scratch


def _compare_axes(rig: Rig, scratch: mujoco.MjData) -> None:
    """MatchError for an arm with another axis, at home."""
    arm, rows = rig.arm, list(rig.joints)
    links = dyn.link_poses(model_of(arm), arm.home)
    for joint, (R, p), axis, anchor in zip(
        arm.joints, links, scratch.xaxis[rows], scratch.xanchor[rows], strict=True
    ):
        ours, apart = np.asarray(R)[:, 2], np.asarray(p) - anchor
        rotation = float(np.linalg.norm(np.cross(axis, ours))) if axis @ ours > 0.0 else 2.0
        distance = float(np.linalg.norm(apart - ours * (apart @ ours)))
        if not (rotation <= MAX_ROTATION and (joint.kind == "prismatic" or distance <= MAX_DISTANCE)):  # or NaN
            raise MatchError(
                f"joint '{joint.name}' at the home pose has its axis at {_numbers(anchor)} along {_numbers(axis)} in "
                f"the model and at {_numbers(p)} along {_numbers(ours)} in arm '{arm.name}' (world, m): another arm, "
                "another zero of a joint, or another base; load the Arm from the model's own file, and put it where "
                "it stands: arm.mounted(taut.Pose(...))",
                joint=joint.name,
            )


def _compare_dynamics(rig: Rig) -> None:
    """MatchError for an arm with other inertias or another weight, at home or elsewhere; it names the joint."""
    import mujoco

    model, arm, ours, carried = rig.model, rig.arm, model_of(rig.arm), rig.arm.payload
    load = PayloadValues(mass=carried.mass, com=carried.com, inertia=carried.inertia)
    off = int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    gravity = np.zeros(3) if off else np.asarray(model.opt.gravity)
    if not np.abs(gravity - arm.gravity).max() <= MAX_GRAVITY_DIFFERENCE:  # or NaN
        raise MatchError(
            f"gravity is {_numbers(gravity)} in the model and {_numbers(arm.gravity)} m/s^2 for arm '{arm.name}'; "
            "use arm.with_gravity(model.opt.gravity)",
            name="gravity",
        )
    rng, dofs, full = np.random.default_rng(0), list(rig.dofs), np.zeros((model.nv, model.nv))
    for k in range(COMPARED_POSES):
        q = arm.home + min(k, 1) * rng.uniform(-1.0, 1.0, arm.n)
        there = _at(model, rig.data, rig.q, q)
        mujoco.mj_fullM(model, there, full)
        M, g = dyn.mass_matrix(ours, q, load), dyn.gravity_torque(ours, q, load)
        size = np.sqrt(np.outer(np.diag(M), np.diag(M)))
        for what, unit, found, expected, scale in (
            ("inertia", "kg m^2 | kg", full[np.ix_(dofs, dofs)], M, size),
            ("torque of gravity", "N m | N", there.qfrc_bias[dofs], g, np.abs(g).max()),
        ):
            wrong = np.argwhere(~(np.abs(found - expected) <= MAX_RELATIVE * scale + 1e-9))  # or NaN
            if len(wrong):
                at = tuple(wrong[np.argmax(wrong.min(axis=1))])
                joint = arm.joint_names[min(at)]
                raise MatchError(
                    f"joint '{joint}': the {what} of what it moves is {found[at]:.6g} in the model and "
                    f"{expected[at]:.6g} in arm '{arm.name}' [{unit}], at q = {_numbers(q)}; load the Arm from the "
                    "model's own file, with the payload and the rotors that it has there",
                    joint=joint,
                )


def _numbers(values: Any) -> str:
    return "[" + ", ".join(f"{float(x) + 0.0:.6g}" for x in values) + "]"
