"""From an Arm to a MuJoCo model, number by number: what MuJoCo computes is what the Arm says."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from taut.arm.description import BASE, Arm, Payload
from taut.arm.loaders.mjspec import add_links
from taut.arm.parts import inertia_matrix
from taut.base.types import Float64Array
from taut.maths.adds import Adds
from taut.plant.drives.drivetrain import Drivetrain
from taut.runtime.robots.mujoco.health import Guard
from taut.runtime.robots.mujoco.rig import Rig, index
from taut.runtime.robots.mujoco.scene import Scene, attach_scene, refused
from taut.runtime.robots.mujoco.shapes import TOUCHING, Looks, Shapes, Touch
from taut.runtime.robots.mujoco.tool import SpringTip, add_tip
from taut.trace.pose import Pose

if TYPE_CHECKING:
    import mujoco

__all__ = ["INTEGRATORS", "Integrator", "ModelOptions", "built", "put_payload", "put_timestep"]

Integrator = Literal["discrete", "euler", "implicitfast", "implicit", "rk4"]
INTEGRATORS: Final[tuple[Integrator, ...]] = ("discrete", "euler", "implicitfast", "implicit", "rk4")

NOSLIP_ITERATIONS: Final = 200  # a Panda that its friction holds at half its limit needs 45
NOSLIP_TOLERANCE: Final = 1e-30  # of MuJoCo's cost; sweeps end when they gain nothing that floats can hold
HARDEST: Final = 0.9999  # the largest impedance that MuJoCo takes
STOP: Final = 0.99  # impedance of a joint limit: a Panda that leans on one sinks in by 1e-5 rad
AT_ONCE: Final = 1e9  # how many times faster than one step sliding is braked: at the end of the step it is at rest


@dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """How the model is built; see MujocoPlant."""

    drivetrain: Drivetrain
    limits: Literal["arm"] | None
    integrator: Integrator
    touch: Touch | None
    tool_radius: float  # [m]
    tool_length: float | None  # [m] of a cylinder; None for a sphere
    scene_at: Pose
    link_radius: float  # [m]
    looks: Looks
    tip: SpringTip | None


def built(arm: Arm, scene: Scene | None, options: ModelOptions, adds: Adds) -> Rig:
    """The arm in a world of its own, and the scene around it.

    Raises:
        ModelError: MuJoCo refuses the arm or the scene.
    """
    import mujoco

    builder = _Builder(arm, options)
    shapes = Shapes(arm, builder.spec, builder.bodies, builder.tip or builder.payload)
    shapes.show(options.looks)
    own = len(builder.spec.worldbody.geoms)
    if scene is not None:
        if options.touch is not None:
            shapes.touch(options.touch, options.tool_radius, options.tool_length, options.link_radius)
        attach_scene(builder.spec, scene, options.scene_at)
    try:
        with Guard(builder.spec.option), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that names of a scene have no prefix
            model = builder.spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as cause:
        raise refused(str(cause), scene, arm.source or arm.name) from cause
    data = mujoco.MjData(model)
    joints = tuple(int(model.joint(joint.name).id) for joint in arm.joints)
    dofs = tuple(int(model.jnt_dofadr[j]) for j in joints)
    payload = int(model.body(builder.payload).id)
    rows = [payload] if int(model.body_weldid[payload]) == 0 else [int(model.body_parentid[payload]), payload]
    rows += [] if builder.tip is None else [int(model.body(builder.tip).id)]
    put_payload(model, mujoco.MjData(model), payload, arm.payload)
    return Rig(
        arm=arm,
        model=model,
        data=data,
        joints=joints,
        q=index([int(model.jnt_qposadr[j]) for j in joints]),
        v=index(list(dofs)),
        dofs=dofs,
        tool_bodies=index(rows),
        tool_body=payload,
        p_tool=np.zeros(3),
        adds=adds,
        own_geoms=own,
    )


def put_payload(model: mujoco.MjModel, scratch: mujoco.MjData, body: int, payload: Payload) -> None:
    """Give the payload's body other inertia, and let MuJoCo compute what depends on it; scratch data is lost."""
    import mujoco

    moments, T_axes = _principal(inertia_matrix(payload.inertia), payload.com)
    model.body_mass[body] = payload.mass
    model.body_inertia[body] = moments
    model.body_ipos[body] = T_axes.p
    model.body_iquat[body] = T_axes.wxyz
    mujoco.mj_setConst(model, scratch)


def put_timestep(rig: Rig, timestep: float) -> None:
    """Set the time step [s], and make dry friction and joint limits as hard as it allows.

    MuJoCo's own friction brakes over 20 ms and lets a loaded joint creep. Here the aim is rest at the end of the
    step: integrator "discrete" evaluates it there, so that any stiffness is stable; the others take one step's worth.
    """
    import mujoco

    model, dofs, joints = rig.model, list(rig.dofs), list(rig.joints)
    model.opt.timestep = timestep
    discrete = int(model.opt.integrator) == int(mujoco.mjtIntegrator.mjINT_DISCRETE)
    rate = (AT_ONCE if discrete else 1.0) / timestep
    model.dof_solref[dofs] = (-1.0, -rate)  # negative: stiffness, which friction has none of, and damping
    model.dof_solimp[dofs] = (HARDEST, HARDEST, 0.001, 0.5, 2.0)
    model.jnt_solref[joints] = (2.0 * timestep, 1.0)
    model.jnt_solimp[joints] = (STOP, STOP, 0.001, 0.5, 2.0)


def _principal(I: Float64Array, com: Float64Array) -> tuple[Float64Array, Pose]:
    """(3,) principal moments, and the pose of their axes at the centre of mass."""
    moments, axes = np.linalg.eigh(I)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    return np.maximum(moments, 0.0), Pose.of(axes, com)


class _Builder:
    """Writes an Arm into an MjSpec."""

    def __init__(self, arm: Arm, options: ModelOptions) -> None:
        import mujoco

        self._arm, self._options = arm, options
        self.spec = spec = mujoco.MjSpec()
        spec.modelname = arm.name
        spec.compiler.degree = False
        spec.compiler.usethread = False
        option = spec.option
        option.gravity = arm.gravity
        option.integrator = _integrator(options.integrator)
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if options.drivetrain.dry:
            option.noslip_iterations, option.noslip_tolerance = NOSLIP_ITERATIONS, NOSLIP_TOLERANCE
        self._names = {"world"}
        names = [
            (self._unique(body.links[0] if body.links else joint.name), joint.name)
            for joint, body in zip(arm.joints, arm.bodies, strict=True)
        ]
        links = add_links(arm, spec.worldbody, arm.T_WB, names)
        self.bodies = [body for body, _ in links]
        for i, (body, joint) in enumerate(links):
            self._fill(i, body, joint)
        self.payload = self._tool()
        self.tip = None if options.tip is None else self._unique("tip")
        if options.tip is not None and self.tip is not None:
            add_tip(spec.body(self.payload), options.tip, self.tip, options.tool_radius)
        for joint in arm.joints:
            spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()

    def _unique(self, name: str) -> str:
        while name in self._names:
            name = f"{name}_"
        self._names.add(name)
        return name

    def _holder(self, body: int) -> tuple[mujoco.MjsBody, Pose]:
        """The MuJoCo body of one of the arm's, and the pose of the arm's frame in it; the base is the world's."""
        if body == BASE:
            return self.spec.worldbody, self._arm.T_WB
        return self.bodies[body], Pose.identity()

    def _fill(self, i: int, body: mujoco.MjsBody, made: mujoco.MjsJoint) -> None:
        """Mass, rotor inertia, friction and limits."""
        import mujoco

        joint, inertial = self._arm.joints[i], self._arm.bodies[i]
        moments, T_axes = _principal(inertial.inertia, inertial.com)
        body.mass, body.inertia, body.ipos, body.iquat = inertial.mass, moments, T_axes.p, T_axes.wxyz
        body.explicitinertial = True
        body.simple = 0  # no shortcut that would rest on the payload having no mass
        train = self._options.drivetrain
        if i in train.rigid:  # else its motor moves by itself, and friction with it
            made.armature = joint.rotor_inertia
            if train.friction is not None:
                made.damping = [joint.viscous, 0.0, 0.0]
                made.frictionloss = joint.coulomb
        limited = self._options.limits == "arm" and bool(np.isfinite([joint.lower, joint.upper]).any())
        made.limited = mujoco.mjtLimited.mjLIMITED_TRUE if limited else mujoco.mjtLimited.mjLIMITED_FALSE
        if limited:
            made.range = np.clip([joint.lower, joint.upper], -1e8, 1e8)

    def _tool(self) -> str:
        """A body at the tool that is the payload, with the site, and the sensors of what the arm exerts on it."""
        import mujoco

        frame = self._arm.frame()
        holder, T_holder = self._holder(frame.body)
        T = T_holder @ frame.placement
        name = self._unique("payload")
        body = holder.add_body(name=name, pos=T.p, quat=T.wxyz)
        body.explicitinertial = True
        # Nothing that can be taken for the body's own frame, since the payload changes in the compiled model.
        body.mass, body.ipos, body.inertia = 0.0, [0.1, 0.2, 0.3], [0.0, 0.0, 0.0]
        body.iquat = [0.5, 0.5, 0.5, 0.5]
        body.simple, body.fuse = 0, 0
        body.add_site(name=self._arm.tool, size=[0.005] * 3, group=TOUCHING)
        for kind in ("force", "torque"):
            self.spec.add_sensor(
                name=f"{self._arm.tool}_{kind}",
                type=getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}"),
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=self._arm.tool,
            )
        return name


def _integrator(name: Integrator) -> int:
    import mujoco

    return int(getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}"))
