"""From an Arm to a MuJoCo model, number by number.

The links are shown as lines between the joints; a sphere or a cylinder at the tool touches the scene. None of these
shapes has mass, but a tip that gives way.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.description import BASE
from taut.arm.loaders.mjcf_source import MjcfSource, refused
from taut.arm.loaders.mjspec import add_links, bones
from taut.arm.parts import inertia_matrix
from taut.base.errors import ModelError
from taut.base.fields import Declared, Field
from taut.base.types import Float64Array
from taut.plant.parts import PlantParts
from taut.runtime.robots.mujoco.rig import Guard, Rig, index
from taut.runtime.robots.mujoco.scene import Scene, attach_scene
from taut.trace.pose import Pose

if TYPE_CHECKING:
    import mujoco

NOSLIP_ITERATIONS: Final = 200  # a Panda that its friction holds at half its limit needs 45
NOSLIP_TOLERANCE: Final = 1e-30  # of MuJoCo's cost; sweeps end when they gain nothing that floats can hold
HARDEST: Final = 0.9999  # the largest impedance that MuJoCo takes
STOP: Final = 0.99  # impedance of a joint limit: a Panda that leans on one sinks in by 1e-5 rad
TIP_STOP: Final = (0.95, 0.99, 1e-3, 0.5, 2.0)  # impedance of the ends of a tip's travel
AT_ONCE: Final = 1e9  # how many times faster than one step sliding is braked: at the end of the step it is at rest
BONE: Final = 0.02  # [m] radius of a line between joints
GREY: Final = (0.7, 0.7, 0.7, 1.0)
VISUAL_GROUP: Final = 2  # the group of what is looked at
CONTACT_GROUP: Final = 3  # the group of what touches, which MuJoCo's viewers hide until asked


class SpringTip(Declared):
    """A tip on a spring, that is pushed back along the tool's z axis: what touches the scene in a MujocoPlant.

    Law:          mass z'' + damping z' + stiffness z = the force of what it touches along the tool's -z axis, with z
                  from 0, where the tip is at the tool's origin, to the end of its travel

    The law of the arm knows nothing of it: the tool's frame stays where it is. F_ext is what is touched on the tip.

    Args:
        stiffness: [N/m].
        damping: [N s/m].
        mass: [kg] of what moves, added to the plant's payload.
        travel: [m] to the stop.

    Raises:
        RangeError: A number that is not above zero, or a negative damping.
        ShapeError: More than one number.

    Example:
        >>> SpringTip(stiffness=1000.0).travel
        0.02
    """

    stiffness: Field = Field(unit="N/m", above=0.0, run_time=False, hint="for a rigid tool leave the tip out")
    damping: Field = Field(10.0, unit="N s/m", minimum=0.0, run_time=False)
    mass: Field = Field(0.02, unit="kg", above=0.0, run_time=False)
    travel: Field = Field(0.02, unit="m", above=0.0, run_time=False)


@dataclass(frozen=True, kw_only=True)
class ToolShape:
    """Shape at the tool that touches the scene; see MujocoPlant."""

    radius: float  # [m]
    length: float | None  # [m] of a cylinder; None for a sphere
    tip: SpringTip | None


def built(parts: PlantParts, tool: ToolShape, scene: Scene | None, scene_at: Pose, *, limits: bool) -> Rig:
    """The arm in a world of its own, and the scene around it."""
    import mujoco

    arm, builder = parts.arm, _Builder(parts, limits=limits)
    tip = None if tool.tip is None else builder.add_tip(tool.tip, tool.radius)
    for joint in arm.joints:
        motor = builder.spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
    builder.show_links()
    if scene is not None:
        builder.add_touching(tool, tip or builder.payload)
        attach_scene(builder.spec, scene, scene_at)
    try:
        with Guard(builder.spec.option), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that names of a scene have no prefix
            model = builder.spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as cause:
        source = MjcfSource() if scene is None else scene.source
        path = (arm.source or arm.name) if scene is None else scene.path
        raise ModelError(path, [refused(str(cause), source, path)]) from cause
    joints = tuple(int(model.joint(joint.name).id) for joint in arm.joints)
    payload = int(model.body(builder.payload).id)
    rows = [payload] if int(model.body_weldid[payload]) == 0 else [int(model.body_parentid[payload]), payload]
    rows += [] if tip is None else [int(model.body(tip).id)]
    rig = Rig(
        arm=arm,
        model=model,
        data=mujoco.MjData(model),
        joints=joints,
        tool_bodies=index(rows),
        tool_body=payload,
        p_tool=np.zeros(3),
        adds=parts.adds,
    )
    put_parameters(rig, parts, parts.values, parts.values)
    return rig


def put_parameters(rig: Rig, parts: PlantParts, values: Mapping[str, Float64Array], changed: Collection[str]) -> None:
    """Bring parameters of the plant that changed into the model, and let MuJoCo compute what depends on them."""
    import mujoco

    model, body, rigid = rig.model, rig.tool_body, list(parts.drivetrain.rigid)
    dofs = [rig.dofs[i] for i in rigid]  # a joint whose motor moves by itself has rotor and friction before MuJoCo
    for path, numbers in (
        ("plant.friction.viscous", model.dof_damping),
        ("plant.friction.coulomb", model.dof_frictionloss),
        ("plant.rotor_inertia", model.dof_armature),
    ):
        if path in changed:
            numbers[dofs] = np.broadcast_to(values[path], (rig.arm.n,))[rigid]
    if not any(path.startswith("plant.payload.") or path == "plant.rotor_inertia" for path in changed):
        return
    mass, com, inertia = (values[f"plant.payload.{name}"] for name in ("mass", "com", "inertia"))
    moments, T_axes = _principal(inertia_matrix(inertia), com)
    model.body_mass[body], model.body_inertia[body] = mass, moments
    model.body_ipos[body], model.body_iquat[body] = T_axes.p, T_axes.wxyz
    mujoco.mj_setConst(model, mujoco.MjData(model))


def put_timestep(rig: Rig, timestep: float) -> None:
    """Set the time step [s], and make dry friction and joint limits as hard as it allows.

    MuJoCo's own friction brakes over 20 ms and lets a loaded joint creep. The aim here is rest at the end of the
    step, where integrator "discrete" evaluates it, so that any stiffness is stable.
    """
    model, dofs, joints = rig.model, list(rig.dofs), list(rig.joints)
    model.opt.timestep = timestep
    model.dof_solref[dofs] = (
        -1.0,
        -AT_ONCE / timestep,
    )  # negative: stiffness, none, and damping
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

    def __init__(self, parts: PlantParts, *, limits: bool) -> None:
        import mujoco

        self._arm = arm = parts.arm
        self.spec = spec = mujoco.MjSpec()
        spec.modelname = arm.name
        spec.compiler.degree = False
        spec.compiler.usethread = False
        option = spec.option
        option.gravity = arm.gravity
        option.integrator = int(mujoco.mjtIntegrator.mjINT_DISCRETE)
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if parts.drivetrain.dry:
            option.noslip_iterations, option.noslip_tolerance = NOSLIP_ITERATIONS, NOSLIP_TOLERANCE
        self._names = {"world"}
        names = [
            (self._unique(body.links[0] if body.links else joint.name), joint.name)
            for joint, body in zip(arm.joints, arm.bodies, strict=True)
        ]
        links = add_links(arm, spec.worldbody, arm.T_WB, names)
        self._bodies = [body for body, _ in links]
        for i, (body, joint) in enumerate(links):
            self._fill(i, body, joint, limits=limits)
        self.payload = self._tool()

    def _unique(self, name: str) -> str:
        while name in self._names:
            name = f"{name}_"
        self._names.add(name)
        return name

    def _fill(self, i: int, body: mujoco.MjsBody, made: mujoco.MjsJoint, *, limits: bool) -> None:
        """Mass and limits."""
        import mujoco

        joint, inertial = self._arm.joints[i], self._arm.bodies[i]
        moments, T_axes = _principal(inertial.inertia, inertial.com)
        body.mass, body.inertia, body.ipos, body.iquat = inertial.mass, moments, T_axes.p, T_axes.wxyz
        body.explicitinertial = True
        body.simple = 0  # no shortcut that would rest on the payload having no mass
        limited = limits and bool(np.isfinite([joint.lower, joint.upper]).any())
        made.limited = mujoco.mjtLimited.mjLIMITED_TRUE if limited else mujoco.mjtLimited.mjLIMITED_FALSE
        if limited:
            made.range = np.clip([joint.lower, joint.upper], -1e8, 1e8)

    def _tool(self) -> str:
        """A body at the tool that is the payload, with the site, and the sensors of what the arm exerts on it."""
        import mujoco

        frame, name = self._arm.frame(), self._unique("payload")
        at_base = frame.body == BASE
        T = self._arm.T_WB @ frame.placement if at_base else frame.placement
        body = (self.spec.worldbody if at_base else self._bodies[frame.body]).add_body(
            name=name, pos=T.p, quat=T.wxyz
        )
        body.explicitinertial = True
        # Nothing that can be taken for the body's own frame, since the payload changes in the compiled model.
        body.mass, body.ipos, body.inertia = 0.0, [0.1, 0.2, 0.3], [0.0, 0.0, 0.0]
        body.iquat = [0.5, 0.5, 0.5, 0.5]
        body.simple, body.fuse = 0, 0
        body.add_site(name=self._arm.tool, size=[0.005] * 3, group=CONTACT_GROUP)
        for kind in ("force", "torque"):
            self.spec.add_sensor(
                name=f"{self._arm.tool}_{kind}",
                type=getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}"),
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=self._arm.tool,
            )
        return name

    def add_tip(self, tip: SpringTip, radius: float) -> str:
        """The body of the tip, on that of the tool."""
        import mujoco

        name, mass = self._unique("tip"), tip.mass
        body = self.spec.body(self.payload).add_body(name=name)
        body.mass, body.inertia, body.explicitinertial = mass, [0.4 * mass * radius**2] * 3, True
        joint = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, -1.0])
        joint.stiffness, joint.damping = [tip.stiffness, 0.0, 0.0], [tip.damping, 0.0, 0.0]
        joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, [0.0, tip.travel]
        joint.solimp_limit = TIP_STOP
        return name

    def show_links(self) -> None:
        """A capsule along each line between joints; nothing touches it."""
        import mujoco

        for body, start, end in bones(self._arm):
            if body != BASE and np.linalg.norm(end - start) >= 1e-6:
                geom = self._bodies[body].add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[BONE, 0.0, 0.0])
                geom.fromto = [*start, *end]
                geom.contype, geom.conaffinity = 0, 0
                geom.mass, geom.group, geom.rgba = 0.0, VISUAL_GROUP, GREY

    def add_touching(self, tool: ToolShape, name: str) -> None:
        """A sphere about the tool's origin or a cylinder along z ending there; it collides with the scene only."""
        import mujoco

        geom = self.spec.body(name).add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[tool.radius, 0.0, 0.0])
        if tool.length is not None:
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_CYLINDER, [tool.radius, 0.5 * tool.length, 0.0]
            geom.pos = [0.0, 0.0, -0.5 * tool.length]
        geom.contype, geom.conaffinity = 0, 1
        geom.friction = [0.0, 0.0, 0.0]  # MuJoCo takes the larger of two: that of what is touched
        geom.mass, geom.group = 0.0, CONTACT_GROUP
