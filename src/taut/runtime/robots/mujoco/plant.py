"""MujocoPlant: an arm in MuJoCo, built from the same Arm as everything else, or found in a model of the user's."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from taut.arm.description import Arm, CommandKind, Payload
from taut.base.checks import instance_of, positive_scalar, read_only
from taut.base.errors import UsageError
from taut.base.paths import PlantParameters, subtree
from taut.base.types import ArrayLike, Float64Array
from taut.maths.model import Adds
from taut.plant.actuation import OF_DRIVES, Actuation, delayed
from taut.plant.environments.environment import Environment
from taut.plant.motion import WORK_OF_IT
from taut.plant.parts import PlantParts
from taut.plant.sensors import Sensors
from taut.runtime.robots.mujoco.attached import AttachedPlant, attached
from taut.runtime.robots.mujoco.model import SpringTip, ToolShape, built, put_parameters, put_timestep
from taut.runtime.robots.mujoco.rig import PRESSED, Normals, PlantInMujoco, index, whole_steps
from taut.runtime.robots.mujoco.scene import SceneView, read_scene
from taut.runtime.robots.mujoco.stages import ForceStage, SensorStage
from taut.trace.pose import Pose

if TYPE_CHECKING:
    import mujoco

MAX_DEFAULT_TIMESTEP: Final = 1e-3  # [s] of a time step that nobody asked for


class MujocoPlant(PlantInMujoco):
    """An arm in MuJoCo, with whatever stands around it.

    Model:
        (M + rotors) a + C v + g + b v + friction = tau + J^T F_ext + joint limits
        by MuJoCo's integrator "discrete", which is semi-implicit Euler, v+ = v + dt a with b v and dry friction taken
        at v+, and q+ = q + dt v+: the scheme of RigidPlant, which it follows to rounding where nothing touches the
        arm. Dry friction really sticks.

    A tick, as in RigidPlant: q, v, the joint torques and the wrench of the last step are measured at t_k; the command
    that follows from them is held for a whole number of MuJoCo's time steps, which end at t_k+1.

    Joints are torque motors without limits of their own (limits belong to the controller), or drives: see `takes`.
    The Arm's position limits are MuJoCo's joint limits, which push back. `model` and `data` are MuJoCo's own, to look
    at and to add to; a run begins with the scene as it was built. Bodies have the names of their links, joints and
    motors those of the joints; the site has the tool's name and stands on the body "payload", with the sensors
    <tool>_force and <tool>_torque: what the arm exerts on tool and payload, in the tool's axes, as a sensor at the
    flange reads it.

    Frames:
        F_ext is the wrench of everything outside the arm on the body that carries the tool, of the last time step,
        force first, in world axes at the tool's origin: contacts, welds, data.xfrc_applied, `environment`. A wall
        pushes back with the sign of the wall on the arm. The weight and inertia of tool and payload are no part of
        it; a `taut.sensors.WrenchSensor(tool=...)` reads them too.

    Args:
        arm: The true arm; make it differ from the controller's and there is a modelling error.
        scene: An MJCF fragment, as text or a path: bodies, geoms, assets, what ties them together. Files come from
            its own folder only; options and key frames are refused. A surface that a tool presses on needs a contact
            whose force grows with the depth, priority="1" solimp="0 0.9 0.002 0.5 1"; MuJoCo's default pushes with
            nearly its whole force from the first micrometre, and so opens and closes every few ticks.
        scene_at: Pose of the scene's origin in the world; the world's own origin if left out.
        friction: "arm" for the arm's own viscous and dry friction, None for none.
        limits: "arm" for the arm's own position limits, None for none.
        timestep: [s] of MuJoCo, a whole part of the control period; by default the largest one up to 1 ms.
        takes: The command: "torque", "mit", "velocity" or "position"; "mit" as of RigidPlant, with an inner loop in
            every time step or at `actuation=Actuation(inner_rate=...)`. The last two are drives with
            `actuation=Actuation(bandwidth=...)` that follow the motion of RigidPlant's stiff ones by an inner torque
            loop, ten times as fast as the drive. It knows arm and payload, but not contacts and environments, which
            therefore move the arm a little, and gives no more than the joint's effort: the excess is the run's column
            tau_cut, with a warning.
        adds: What the plant adds to a torque command itself: "gravity", "coriolis", and "friction", which cancels the
            arm's own, so that none is left.
        tool_radius: [m] of the sphere at the tool's origin, the only part of the arm that touches anything; it has
            the friction of what it touches.
        tool_length: [m] of a cylinder of that radius in the sphere's place, such as a peg, along the tool's z axis,
            with its flat end at the tool's origin. It has no mass; that is the payload's.
        tip: A taut.environments.SpringTip that gives way and carries the sphere or cylinder; rigid if left out.
        actuation: The drives, as of RigidPlant: delay, amplifier, motor, gear; ideal if left out.
        sensors: What is measured, and how well; ideal sensors if left out.
        environment: What acts at the tool besides the scene, as of RigidPlant: a taut.environments.Push, Hand, ... It
            acts through data.qfrc_applied, which is then the plant's; the run's column work.environment [J] is its
            work.

    Columns of a run:
        F_ext (6,); with a scene contact.normal_force (3,), what of it is along the true normals of the contacts;
        scene.poses (m, 7), position [m] and quaternion wxyz of the scene's bodies that move and have shapes.

    Raises:
        UsageError: Options that do not go together.
        ModelError: A scene that is refused, with its line.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=2.205, kd=2.0), arm)
        >>> out = taut.run(ctrl, taut.MujocoPlant(arm), taut.JointMotion(q=[0.5]), duration=5.0)
        >>> out.outcome.ok, bool(abs(out.q[-1, 0] - 0.5) < 1e-3)
        (True, True)

    References:
        Todorov, Erez and Tassa, MuJoCo, IROS (2012); its manual on the integrator "discrete" and on noslip.
    """

    def __init__(
        self,
        arm: Arm,
        *,
        scene: str | os.PathLike[str] | None = None,
        scene_at: Pose | None = None,
        friction: Literal["arm"] | None = "arm",
        limits: Literal["arm"] | None = "arm",
        timestep: float | None = None,
        takes: CommandKind = "torque",
        adds: Adds | Iterable[str] | Mapping[str, Payload | None] = (),
        tool_radius: float = 0.01,
        tool_length: float | None = None,
        tip: SpringTip | None = None,
        actuation: Actuation | None = None,
        sensors: Sensors | None = None,
        environment: Environment | None = None,
    ) -> None:
        adds = Adds.of(adds)
        self.given = {name: value for name, value in locals().items() if name not in ("self", "arm", "__class__")}
        for name, value in (("friction", friction), ("limits", limits)):
            if value not in ("arm", None):
                raise UsageError(f"{name} must be 'arm' or None; got {value!r}", name=name)
        instance_of("tip", tip, SpringTip | None, "a taut.environments.SpringTip")
        instance_of("scene_at", scene_at, Pose | None, "a taut.Pose")
        if scene is None and scene_at is not None:
            raise UsageError("scene_at says where the scene stands, and there is none; give scene=", name="scene_at")
        drives, seen = actuation or Actuation(), sensors or Sensors()
        numbers = PlantParts(
            name=f"MujocoPlant({getattr(arm, 'name', '')})",
            arm=arm,
            friction=friction,
            takes=takes,
            adds=adds,
            actuation=drives,
            sensors=seen,
            environment=environment,
            scene=True,
        )
        tool = ToolShape(
            radius=positive_scalar("tool_radius", tool_radius, unit="m"),
            length=None if tool_length is None else positive_scalar("tool_length", tool_length, unit="m"),
            tip=tip,
        )
        self._timestep = None if timestep is None else positive_scalar("timestep", timestep, unit="s")
        around = None if scene is None else read_scene(scene)
        rig = built(numbers, tool, around, scene_at or Pose.identity(), limits=limits is not None)
        super().__init__(rig, numbers.name, None if scene is None else SceneView(rig))
        self._parts, self._values = numbers, numbers.values
        self.friction, self.takes, self.actuation, self.sensors = friction, takes, drives, seen
        self.measures, self.distorts = seen.measures(touched=True), seen.distorts(touched=True)
        self._forces, self._readings = ForceStage(rig, numbers), SensorStage(arm, seen)
        self._ctrl = rig.data.ctrl
        motors = (rig.model.actuator(name).id for name in arm.joint_names)
        self._motors = index([int(rig.model.actuator_ctrladr[motor]) for motor in motors])
        self._normals = None if scene is None else Normals(rig)

    @staticmethod
    def attach(
        model: mujoco.MjModel,
        data: mujoco.MjData,
        arm: Arm,
        prefix: str = "",
    ) -> AttachedPlant:
        """Drive an arm inside a simulation of your own.

        Joints are found by name, prefix + the Arm's. Each takes its torque through its motor if it has one, else
        through data.qfrc_applied; both have the user's values again after each control period. Other joints and
        actuators, time, options and callbacks are left alone; friction and joint limits are the model's. A run moves
        the arm to q0 (`plant.state()[0]` is its present position) and steps the whole scene on from there. What an
        actuator's limits cut off is the run's column tau_cut, with a warning.

        Frames:
            As above. F_ext counts all that the tool's joint carries, fingers too; their internal forces cancel.

        Args:
            model: The model; its timestep must be a whole part of the control period.
            data: Its data.
            arm: What the model's arm should be: compared in axes, gravity and inertias.
            prefix: What stands before the names of the joints in the model, such as "left/".

        Raises:
            UsageError: Not a model, its data and an arm.
            UnknownNameError: A joint that the model does not have.
            MatchError: Another arm, or actuators that do not take torques.
        """
        return attached(model, data, arm, prefix)

    def like(self, *, arm: Arm | None = None, sensors: Sensors | None = None) -> MujocoPlant:
        """A plant of the same arguments but these."""
        return MujocoPlant(arm or self.arm, **{**self.given, "sensors": sensors or self.sensors})

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy is built anew, of the same arguments and with the same parameters, and has a scene of its own."""
        return _rebuilt, ({"arm": self.arm, **self.given}, dict(self.parameters))

    def _silence(self) -> None:
        super()._silence()
        n = self.arm.n
        self._contact = np.zeros(6)
        self._ticks, self._dt, self._work = 0, 0.0, 0.0
        self._tau_link, self._a = np.zeros(n), np.zeros(n)
        self._saturated: dict[str, Float64Array] = {}

    @property
    def parameters(self) -> Mapping[str, Float64Array]:
        """Run-time parameters by path."""
        return self._values

    def checked_parameter(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value of a parameter, checked and in its shape. Raises UnknownNameError, ShapeError, RangeError."""
        return read_only(self._parts.checked(path, value))

    def check_together(self, values: Mapping[str, ArrayLike]) -> None:
        """RangeError for values by path that do not go together: less friction at rest than in motion."""
        self._parts.check_together(values)

    def set_parameters(self, values: Mapping[str, ArrayLike]) -> None:
        """Give parameters new values at once, which act from the next step."""
        checked = {path: self.checked_parameter(path, value) for path, value in values.items()}
        self.check_together({**self.parameters, **checked})
        self._values = PlantParameters(f"plant '{self.name}'", "parameter", {**self._values, **checked})
        put_parameters(self._rig, self._parts, self._values, checked)
        for stage in (self._forces, self._readings):
            stage.take(self._values)

    def reset(self, q: Float64Array, v: Float64Array, dt: float, seed: int = 0) -> None:
        """Put the arm into a state, and prepare for control periods of dt [s]; the noise comes from the seed.

        Raises:
            MatchError: dt is not a whole number of time steps, or the arm's actuators are disabled.
        """
        import mujoco

        rig = self._rig
        self._substeps = self.steps_in(dt)
        put_timestep(rig, dt / self._substeps)
        mujoco.mj_resetData(rig.model, rig.data)
        self._ctrl[self._motors] = 0.0
        self._put_state(q, v)
        self._line = None
        self._h, self._dt = dt / self._substeps, dt
        self._forces.start(q, v, self._values, dt, self._substeps)
        held, self._tau_link = (self._forces.memory[name].copy() for name in ("held", "tau_link"))
        self._tau = held if held.ndim == 1 else held[-1].copy()
        taps = self.actuation.taps(dt)
        if taps:
            first = {"velocity": np.zeros(len(q)), "position": q}.get(self.takes, held)
            self._line = np.stack([first] * taps)
        self._F_ext = self._from_outside()
        self._readings.start(seed, self._true(), self._values)
        self._saturated = {name: np.zeros(()) for name in self._readings.saturating}

    def steps_in(self, dt: float) -> int:
        """MuJoCo's time steps in a control period of dt [s]. MatchError where these are no whole number."""
        if self._timestep is None:
            return max(1, math.ceil(dt / MAX_DEFAULT_TIMESTEP * (1.0 - 1e-9)))
        return whole_steps(self.name, dt, self._timestep, "timestep")

    def measure(self) -> dict[str, Float64Array]:
        """Readings of the sensors, by measurement; forces and torques are those of the last step."""
        given = self._readings.read(self._true())
        self._saturated = {name: value for name, value in given.items() if name.startswith("saturated.")}
        return given

    def _true(self) -> dict[str, Float64Array]:
        """True values of all measured quantities, by name."""
        q, v = self.state()
        true = {"q": q, "v": v, "tau": self._tau, "tau_link": self._tau_link, "F_ext": self._F_ext}
        if self.sensors.needs_acceleration:
            true["a"] = self._a
        if self.sensors.weighs:
            true |= {f"payload.{name}": x for name, x in subtree(self._values, "plant.payload").items()}
        return true | {name: x for name, x in self._forces.memory.items() if name in ("q_motor", "v_motor")}

    def advance(self, command: Float64Array) -> Float64Array:
        """One control period under a command (n,), or (5, n) of a MitCommand; (n,) the torque that acted."""
        rig, forces = self._rig, self._forces
        held, self._line = delayed(command, self._line)
        self._work = forces.work
        forces.hold(held, self._ticks * self._dt)
        self._ticks += 1
        with self._guard:
            for _ in range(self._substeps):
                v = self._qvel[rig.v].copy()
                self._ctrl[self._motors] = forces.before(self._qpos[rig.q], v, self._contact)
                self._mj_step(rig.model, rig.data)
                forces.after(self._qpos[rig.q], self._qvel[rig.v])
        self._a = (self._qvel[rig.v] - v) / self._h
        self._tau, self._tau_link = forces.last("tau"), forces.memory["tau_link"].copy()
        self._contact = self._wrench.of_environment()
        self._F_ext = self._from_outside()
        if self._parts.stiff:
            self._cut = forces.last("cut")
            self._warn_of_cut("the effort of its joints", "slower motions, or an arm that has more")
        return self._tau

    def _from_outside(self) -> Float64Array:
        """(6,) what touched the tool in the last step, in the scene and besides it."""
        return self._contact if self._parts.environment is None else self._contact + self._forces.last("wrench")

    def trouble(self) -> tuple[str, int | None] | None:
        """Fault in the last period, in words, and the joint; None without one."""
        if not self._forces.sane:
            return "its drives, or what touches its tool, gave numbers that are not finite", None
        return super().trouble()

    def extra(self) -> dict[str, Any]:
        """(6,) F_ext of the last step; work of an environment until the tick; (n,) tau_cut of actuators or drives.

        With a scene (3,) `contact.normal_force` and (m, 7) `scene.poses`, see the class.
        """
        work = {} if self._parts.environment is None else {WORK_OF_IT: np.asarray(self._work)}
        normal = {} if self._normals is None else {PRESSED: self._normals.of_contacts()}
        cut = {"tau_cut": self._cut} if self._parts.stiff else {}
        drives = {name: x.copy() for name, x in self._forces.memory.items() if name.startswith(OF_DRIVES)}
        return {"F_ext": self._F_ext, **cut, **work, **normal, **drives, **self._saturated, **self._poses()}


def _rebuilt(made_of: Mapping[str, Any], values: Mapping[str, ArrayLike]) -> MujocoPlant:
    """A plant of these arguments, with these parameters."""
    plant = MujocoPlant(**made_of)
    plant.set_parameters(values)
    return plant
