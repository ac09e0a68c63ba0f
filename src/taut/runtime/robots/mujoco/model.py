"""From an Arm to a MuJoCo model, number by number: what MuJoCo computes is what the Arm says.

Shapes are to look at, and to touch a scene with; none of them has mass, but a tip that gives way.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from taut.arm.description import BASE, Arm, Payload
from taut.arm.loaders.mjspec import Bone, Meshes, add_links, add_shape, bones
from taut.arm.parts import inertia_matrix
from taut.base.checks import in_compiled_shape, read_only
from taut.base.fields import Declared, Field
from taut.base.types import ArrayLike, Float64Array
from taut.maths.model import Adds
from taut.plant.drivetrain import Drivetrain
from taut.plant.parts import PlantParts
from taut.runtime.robots.mujoco.rig import Guard, Rig, index
from taut.runtime.robots.mujoco.scene import Scene, attach_scene, refused
from taut.trace.pose import Pose

if TYPE_CHECKING:
    import mujoco

__all__ = [
    "INTEGRATORS",
    "LOOKS",
    "TOUCHES",
    "Integrator",
    "Looks",
    "ModelOptions",
    "Settings",
    "SpringTip",
    "Touch",
    "built",
    "put_timestep",
]

Integrator = Literal["discrete", "euler", "implicitfast", "implicit", "rk4"]
INTEGRATORS: Final[tuple[Integrator, ...]] = ("discrete", "euler", "implicitfast", "implicit", "rk4")
Touch = Literal["tool", "links"]
TOUCHES: Final[tuple[Touch, ...]] = ("tool", "links")
Looks = Literal["plain", "meshes"]
LOOKS: Final[tuple[Looks, ...]] = ("plain", "meshes")

NOSLIP_ITERATIONS: Final = 200  # a Panda that its friction holds at half its limit needs 45
NOSLIP_TOLERANCE: Final = 1e-30  # of MuJoCo's cost; sweeps end when they gain nothing that floats can hold
HARDEST: Final = 0.9999  # the largest impedance that MuJoCo takes
STOP: Final = 0.99  # impedance of a joint limit: a Panda that leans on one sinks in by 1e-5 rad
TIP_STOP: Final = (0.95, 0.99, 1e-3, 0.5, 2.0)  # impedance of the ends of a tip's way
AT_ONCE: Final = 1e9  # how many times faster than one step sliding is braked: at the end of the step it is at rest
BONE: Final = 0.02  # [m] radius of a link that has no shape to show
LINK: Final = 0.05  # [m] radius of a link that touches
GREY: Final = (0.7, 0.7, 0.7, 1.0)
VISUAL_GROUP: Final = 2  # the group of what is looked at
CONTACT_GROUP: Final = 3  # the group of what touches, which MuJoCo's viewers hide until asked

LOAD: Final = ("mass", "com", "inertia")


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
    mass: Field = Field(0.02, unit="kg", above=0.0, run_time=False, hint="0.01 is little")
    travel: Field = Field(0.02, unit="m", above=0.0, run_time=False, hint="for a rigid tool leave the tip out")


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
    looks: Looks
    tip: SpringTip | None


def built(arm: Arm, scene: Scene | None, options: ModelOptions, adds: Adds) -> Rig:
    """The arm in a world of its own, and the scene around it.

    Raises:
        ModelError: MuJoCo refuses the arm or the scene.
    """
    import mujoco

    builder = _Builder(arm, options)
    shapes = _Shapes(arm, builder.spec, builder.bodies, builder.tip or builder.payload)
    shapes.show(options.looks)
    own = len(builder.spec.worldbody.geoms)
    if scene is not None:
        if options.touch is not None:
            shapes.touch(options.touch, options.tool_radius, options.tool_length)
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
            _add_tip(spec.body(self.payload), options.tip, self.tip, options.tool_radius)
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
        body.add_site(name=self._arm.tool, size=[0.005] * 3, group=CONTACT_GROUP)
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


def _add_tip(tool: mujoco.MjsBody, tip: SpringTip, name: str, radius: float) -> mujoco.MjsBody:
    """The body of the tip, on that of the tool."""
    import mujoco

    mass = tip.mass
    body = tool.add_body(name=name)
    body.mass, body.inertia, body.explicitinertial = mass, [0.4 * mass * radius**2] * 3, True
    joint = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0.0, 0.0, -1.0])
    joint.stiffness, joint.damping = [tip.stiffness, 0.0, 0.0], [tip.damping, 0.0, 0.0]
    joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, [0.0, tip.travel]
    joint.solimp_limit = TIP_STOP
    return body


class _Shapes:
    """Puts geoms onto the bodies of an arm.

    Args:
        arm: The arm.
        spec: What its model is compiled from.
        bodies: The MuJoCo body of each of the arm's.
        tool: Name of the body at the tool.
    """

    def __init__(self, arm: Arm, spec: mujoco.MjSpec, bodies: Sequence[mujoco.MjsBody], tool: str) -> None:
        import mujoco

        self._arm, self._spec, self._bodies, self._tool = arm, spec, bodies, tool
        self._kinds: Any = mujoco.mjtGeom

    def touch(self, what: Touch, tool_radius: float, tool_length: float | None) -> None:
        """What can touch the scene. It answers to contacts and starts none, so that the arm never meets itself."""
        _make_touching(self._tool_shape(tool_radius, tool_length))
        if what == "links":
            for bone in self._bones():
                _make_touching(self._capsule(bone, LINK))

    def _tool_shape(self, radius: float, length: float | None) -> mujoco.MjsGeom:
        """A sphere about the tool's origin, or a cylinder along its z axis that ends there."""
        body = self._spec.body(self._tool)
        if length is None:
            return body.add_geom(type=self._kinds.mjGEOM_SPHERE, size=[radius, 0.0, 0.0])
        middle = [0.0, 0.0, -0.5 * length]
        return body.add_geom(type=self._kinds.mjGEOM_CYLINDER, size=[radius, 0.5 * length, 0.0], pos=middle)

    def show(self, looks: Looks) -> None:
        """The arm's own shapes, and bones for bodies that have none; nothing touches them."""
        seen, meshes = {BASE}, Meshes()
        for visual in self._arm.visuals:
            if visual.shape == "mesh" and looks != "meshes":
                continue
            body, T = self._spec.worldbody, self._arm.T_WB @ visual.placement
            if visual.body != BASE:
                body, T = self._bodies[visual.body], visual.placement
            _make_shown(add_shape(self._spec, body, T, visual, meshes), visual.rgba)
            seen.add(visual.body)
        for bone in self._bones():
            if bone[0] not in seen:
                _make_shown(self._capsule(bone, BONE), GREY)

    def _bones(self) -> Iterator[Bone]:
        """Those of the links that move."""
        return (bone for bone in bones(self._arm) if bone[0] != BASE)

    def _capsule(self, bone: Bone, radius: float) -> mujoco.MjsGeom:
        """A capsule along a bone; a sphere where it has no length."""
        body, start, end = bone
        length = float(np.linalg.norm(end - start))
        if length < 1e-6:
            return self._bodies[body].add_geom(type=self._kinds.mjGEOM_SPHERE, size=[radius, 0.0, 0.0], pos=start)
        geom = self._bodies[body].add_geom(type=self._kinds.mjGEOM_CAPSULE, size=[radius, 0.0, 0.0])
        geom.fromto = [*start, *end]
        return geom


def _make_touching(geom: mujoco.MjsGeom) -> None:
    geom.contype, geom.conaffinity = 0, 1
    geom.friction = [0.0, 0.0, 0.0]  # MuJoCo takes the larger of two: that of what is touched
    geom.mass, geom.group = 0.0, CONTACT_GROUP


def _make_shown(geom: mujoco.MjsGeom, rgba: tuple[float, float, float, float]) -> None:
    geom.contype, geom.conaffinity = 0, 0
    geom.mass, geom.group, geom.rgba = 0.0, VISUAL_GROUP, rgba


class Settings:
    """The parameters of a model that we built, and their way into it."""

    def __init__(self, rig: Rig, numbers: PlantParts) -> None:
        self._rig, self._numbers = rig, numbers
        self._scratch: mujoco.MjData | None = None
        # A joint whose motor moves by itself has rotor and friction in the stage before MuJoCo.
        self._rigid = list(numbers.drivetrain.rigid)
        self.values = {path: read_only(np.asarray(value)) for path, value in numbers.values.items()}

    @property
    def load(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """The payload: mass, com, inertia."""
        mass, com, inertia = (self.values[f"plant.payload.{name}"] for name in LOAD)
        return mass, com, inertia

    def checked(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value in the shape that the parameter has."""
        new = in_compiled_shape(path, self._numbers.checked(path, value), self.values[path].shape)
        if path.startswith("plant.payload."):
            self._payload(path, new)
        return read_only(new)

    def check_together(self, values: Mapping[str, ArrayLike]) -> None:
        """Refuse values by path that do not go together, each of which is right by itself."""
        self._numbers.check_together(values)

    def _payload(self, path: str, value: Float64Array) -> Payload:
        values = {name: self.values[f"plant.payload.{name}"] for name in LOAD}
        values[path.rpartition(".")[2]] = value
        return Payload(mass=float(values["mass"]), com=values["com"], inertia=values["inertia"])

    def put(self, path: str, value: Float64Array) -> None:
        """Keep a checked value, and bring it into the model."""
        self.values = {**self.values, path: value}
        rig, model = self._rig, self._rig.model
        dofs = [rig.dofs[i] for i in self._rigid]
        if path.startswith("plant.payload."):
            put_payload(model, self._somewhere(), rig.tool_body, self._payload(path, value))
        elif path == "plant.friction.viscous":
            model.dof_damping[dofs] = self._of_rigid(value)
        elif path == "plant.friction.coulomb":
            model.dof_frictionloss[dofs] = self._of_rigid(value)
        elif path == "plant.rotor_inertia":
            import mujoco

            model.dof_armature[dofs] = self._of_rigid(value)
            mujoco.mj_setConst(model, self._somewhere())

    def _of_rigid(self, value: Float64Array) -> Float64Array:
        return np.broadcast_to(value, (self._rig.arm.n,))[self._rigid]

    def _somewhere(self) -> mujoco.MjData:
        """Data for MuJoCo to compute constants in, which the run's own is not lost for."""
        import mujoco

        if self._scratch is None:
            self._scratch = mujoco.MjData(self._rig.model)
        return self._scratch
