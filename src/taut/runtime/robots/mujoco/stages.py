"""Native code that runs beside MuJoCo: the forces on its joints before each step, and sensors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm, CommandKind, Friction
from taut.base.paths import subtree
from taut.base.types import Array, Float64Array, Vector
from taut.codegen.engine import Steps, best_engine
from taut.codegen.loop import StepLoop
from taut.codegen.noise import Noise, noise_block
from taut.codegen.program import Block
from taut.maths import dynamics as dyn
from taut.maths.dynamics import compensation
from taut.maths.model import Model, PayloadValues, links_of, model_of
from taut.plant.actuation import aim
from taut.plant.environments.environment import touch
from taut.plant.parts import PlantParts
from taut.plant.parts import Steps as Division
from taut.plant.sensors import Sensors
from taut.runtime.robots.mujoco.rig import Rig
from taut.trace import math as tm

Values = Mapping[str, Any]
AHEAD: Final = 256  # ticks whose noise is drawn at once
HELD: float = 1.0 - 1e-9  # of its limit: what friction is less than holds a joint


class Stage(ABC):
    """A pure function of inputs, parameters and memory, in native code from the first run on."""

    _loop: StepLoop | None = None

    @abstractmethod
    def _step(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        """Outputs, and the memory after it."""

    def _begin(self, inputs: Values, parameters: Values, memory: Values, dt: float) -> None:
        """Prepare for a run, from inputs at which the function can be taken, with steps of dt [s]."""
        values = {**parameters, "dt": dt}
        if self._loop is None:
            self._inputs, self._parameters, self._memory = (
                Block.of({path: np.shape(value) for path, value in part.items()}) for part in (inputs, values, memory)
            )
            blocks = self._inputs, self._parameters, self._memory
            example = self._inputs.pack(inputs), self._parameters.pack(values), self._memory.pack(memory)
            self._loop = StepLoop(Steps(self._step, *blocks), example, engine=best_engine())
            self._row, self._out = np.zeros((1, self._inputs.size)), np.zeros((1, self._loop.outputs.size))
            self._seen = {path: view[0, ...] for path, view in self._inputs.views(self._row).items()}
            self._given = {path: view[0, ...] for path, view in self._loop.outputs.views(self._out).items()}
        self._h, self.sane = dt, True
        self._flat = self._memory.pack(memory)
        self.memory = self._memory.views(self._flat)
        self.take(parameters)

    def take(self, parameters: Values) -> None:
        """New values of the parameters, by path, in a run or between two."""
        if self._loop is not None:
            self._values = self._parameters.pack({**parameters, "dt": self._h})

    def _call(self, inputs: Values) -> dict[str, Float64Array]:
        """The outputs, which the next call overwrites; memory goes on by a step."""
        assert self._loop is not None
        for path, value in inputs.items():
            self._seen[path][...] = value
        done = self._loop.run(self._row, self._values, self._flat, self._out)
        self.sane = self.sane and done == 1
        return self._given


INNER: Final = 10.0  # bandwidths of the drive: how fast its inner loop is


@dataclass(frozen=True, kw_only=True, eq=False)
class Follower:
    """A drive's inner loop, for a simulator that moves the arm: torques that make it follow what the drive aims at.

    Law:          tau = M (u_dot + kd (u - v) + kp e) + h + b v+, within the effort of the joints
                  u   the speed of `aim` in a step, e the error of position that is left
                  kp, kd: both poles of e at `INNER` bandwidths, exactly for steps of dt of semi-implicit Euler
    Closed loop:  in free motion v (where velocities are taken) or q (positions) is that of `aim`, to rounding; a
                  torque outside moves a joint as a spring of stiffness kp M and a damper kd M would
                  A joint at its effort waits: e grows no more, and what it aims at stays with it.
    """

    arm: Arm
    takes: CommandKind
    model: Model

    def start(self, q: Vector, v: Vector, parameters: Values, steps: Division) -> dict[str, Any]:
        """Memory at the start, at (q, v); RangeError for steps too long: the loop sees contacts one step late."""
        bandwidth = np.broadcast_to(parameters["actuation.bandwidth"], (self.arm.n,))
        i = int(np.argmax(bandwidth))
        steps.require(
            INNER * float(bandwidth[i]) * steps.dt,
            "actuation.bandwidth",
            f"the inner loop of the drive of joint '{self.arm.joint_names[i]}', {bandwidth[i]:g} rad/s, is {INNER:g} "
            "times as fast",
            "slower drives",
        )
        return {"drive.q": q, "drive.v": v, "drive.u": v}

    def torque(self, memory: Values, q: Vector, v: Vector, parameters: Values, dt: Any) -> tuple[Vector, Vector, Any]:
        """(n,) torques for a step of dt at q and v, the part that the effort cuts off, and memory after it."""
        bandwidth, held = parameters["actuation.bandwidth"], memory["held"]
        before, u = memory["drive.q"], memory["drive.u"]
        target, speed = aim(self.takes, self.arm, held, before, memory["drive.v"], bandwidth, dt)
        if self.takes == "velocity":
            u_new, target = speed, before + dt * speed
        else:
            u_new = (target - before) / dt
        left = tm.exp(-INNER * bandwidth * dt)
        kd, kp = (1.0 - left * left) / dt, ((1.0 - left) / dt) ** 2
        a = (u_new - u) / dt + kd * (u - v) + kp * (before - q)
        payload = PayloadValues.of(subtree(parameters, "plant.payload"))
        wanted = dyn.inverse_dynamics(self.model, q, v, a, payload)
        if "plant.rotor_inertia" in parameters:
            wanted = wanted + parameters["plant.rotor_inertia"] * a
        if "plant.friction.viscous" in parameters:
            wanted = wanted + parameters["plant.friction.viscous"] * (v + dt * a)
        tau = _within(wanted, self.arm.effort)
        cut = wanted - tau
        waits = cut * (u_new - v) > 0.0
        after = {"drive.q": tm.where(waits, before + dt * v, target), "drive.v": speed, "drive.u": u_new}
        return tau, cut, after


def _within(tau: Vector, effort: Float64Array) -> Vector:
    """(n,) torques, none larger than its joint has."""
    parts = [tm.clip(tau[i], -most, most) if np.isfinite(most) else tau[i] for i, most in enumerate(effort)]
    return tm.array(parts)


class ForceStage(Stage):
    """Forces on MuJoCo's joints in each of its steps: drives, gears and friction, and an environment at the tool.

    MuJoCo knows a dry friction that is the same at rest and in motion. Its limit is given anew before each step, as
    the law says at that speed and load; where it differs with the direction, its middle goes with the motor's torque.
    A joint whose transmission gives way or has play has its rotor here, and gets the torque of spring and teeth.
    An environment acts as generalised forces J^T F.
    """

    def __init__(self, rig: Rig, parts: PlantParts) -> None:
        import mujoco

        self._rig, self._parts, self._train = rig, parts, parts.drivetrain
        self._model = model_of(rig.arm)
        self._links = links_of(rig.arm)
        self._follower: Follower | None = None
        if parts.stiff:
            self._follower = Follower(arm=rig.arm, takes=parts.takes, model=self._links)
        self._rigid = np.array(self._train.rigid, dtype=np.intp)
        self._dofs = np.array(rig.dofs, dtype=np.intp)
        self._joint_of = np.full(rig.model.nv, -1, dtype=np.intp)  # of a degree of freedom: the arm's joint, or none
        self._joint_of[self._dofs] = np.arange(rig.arm.n)
        self._dry = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)

    def _step(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        train, dt = self._train, parameters["dt"]
        q, v, outside = inputs["q"], inputs["v"], inputs["F_ext"]
        q_m, v_m = memory.get("q_motor", q), memory.get("v_motor", v)
        touched = self._touched(inputs, parameters, memory)
        if touched is not None:
            outside = outside + touched[0]
        payload = PayloadValues.of(subtree(parameters, "plant.payload"))
        added = compensation(self._model, self._parts.adds, q, v, payload)
        cut: Any = np.zeros(self._rig.arm.n)
        if self._follower is None:
            given = self._parts.actuation.step(self._rig.arm, memory, q_m, v_m, parameters, dt, added)
            asked, after = given.tau, given.memory
        else:
            asked, cut, after = self._follower.torque(memory, q, v, parameters, dt)
        out = {**memory, **after}
        tau = asked + added
        load: Any = np.zeros(self._rig.arm.n)
        if train.lossy or (isinstance(train.friction, Friction) and np.any(train.friction.load_external_static)):
            load = dyn.jacobian(self._model, q).T @ outside - dyn.bias(self._model, q, v, payload)
        spring = train.spring(q, v, memory, parameters) if train.compliant else tau
        values = train.values(parameters)
        onto, half, limits = tau, np.zeros(self._rig.arm.n), None
        if train.dry:
            M = dyn.mass_matrix(self._links, q, payload)
            limits = train.limits(values, memory, parameters, v_m, tau, train.merged(load, -spring), M, dt)
            half = 0.5 * (limits.low + limits.high)
            onto = tau + 0.5 * (limits.high - limits.low)
        if train.compliant:
            moved = train.rotors(memory, tau, spring, values.viscous, limits, parameters["plant.rotor_inertia"], dt)
            out["v_motor"] = train.merged(v, moved.v)
            out["q_motor"] = train.merged(q, q_m + dt * moved.v)
            out["tau_link"] = train.merged(memory["tau_link"], spring)
            if limits is not None and train.remembers_rest:
                out["at_rest"] = train.merged(memory["at_rest"], moved.at_rest)
            onto = train.merged(onto, spring)
            half = train.merged(half, np.zeros(self._rig.arm.n))
        forces = {"tau": asked, "onto": onto, "half": half, "cut": cut}
        if touched is not None:
            forces |= {"wrench": touched[0], "of_wrench": dyn.jacobian(self._model, q).T @ touched[0]}
            out |= {f"environment.{name}": value for name, value in touched[1].items()}
        return forces, out

    def _touched(self, inputs: Values, parameters: Values, memory: Values) -> tuple[Array, dict[str, Any]] | None:
        """(6,) what the environment exerts in a step, and its memory after it."""
        environment = self._parts.environment
        if environment is None:
            return None
        before, numbers = subtree(memory, "environment"), subtree(parameters, "environment")
        return touch(
            environment, self._model, inputs["q"], inputs["v"], before, numbers, inputs["t"], parameters["dt"]
        )

    def start(self, q: Float64Array, v: Float64Array, parameters: Values, dt: float, steps: int) -> None:
        """Memory at the start of a run, for control periods of dt [s], each of so many steps."""
        arm, parts, division = self._rig.arm, self._parts, Division(dt, steps)
        payload = PayloadValues.of(subtree(parameters, "plant.payload"))
        full = dyn.gravity_torque(self._model, q, payload)
        weight = full - compensation(self._model, parts.adds, q, np.zeros(arm.n), payload)
        memory = {"held": parts.held_at_start(q, weight), "tau_link": full}
        if self._follower is None:
            memory |= parts.actuation.start(arm, q, weight, parameters)
        else:
            memory |= self._follower.start(q, v, parameters, division)
        started = self._train.start(q, v, full, parameters)
        memory |= {name: value for name, value in started.items() if name != "friction"}
        parts.require_short_steps(parameters, division)
        if parts.environment is not None:
            parts.require_short_contact(q, parameters, division)
            touched = parts.environment.start(dyn.pose(self._model, q))
            memory |= {f"environment.{name}": value for name, value in touched.items()}
        first = {"q": q, "v": v, "F_ext": np.zeros(6), "t": 0.0}
        self._begin({**first, "v": np.zeros(arm.n)}, parameters, memory, division.dt)
        self.work = 0.0
        kept = self._flat.copy()
        self._call(first)  # the wrench that a sensor gives in the first tick
        self._flat[:] = kept

    def hold(self, command: Float64Array, t: float) -> None:
        """A control period begins at time t [s], with the command that stands at the drives."""
        self.memory["held"][...], self._t = command, t

    def before(self, q: Float64Array, v: Float64Array, F_ext: Float64Array) -> Float64Array:
        """(n,) the torques for MuJoCo's next step; friction limits and forces from outside are put into it."""
        given = self._call({"q": q, "v": v, "F_ext": F_ext, "t": self._t})
        self._t += self._h
        self._rig.model.dof_frictionloss[self._dofs] = given["half"]
        if "of_wrench" in given:
            self._rig.data.qfrc_applied[self._rig.v] = given["of_wrench"]
        self._v = v.copy()
        return given["onto"]

    def after(self, q: Float64Array, v: Float64Array) -> None:
        """Take over the motion and friction of MuJoCo's step, on which the next step depends, and add up the work."""
        rigid, f, model = self._rigid, self._friction(), self._rig.model
        if self._train.compliant:
            self.memory["q_motor"][rigid], self.memory["v_motor"][rigid] = q[rigid], v[rigid]
        lost = model.dof_damping[self._dofs] * v + model.dof_armature[self._dofs] * (v - self._v) / self._h
        self.memory["tau_link"][rigid] = (self._given["onto"] + f - lost)[rigid]  # friction and rotors take theirs
        if "at_rest" in self.memory:
            self.memory["at_rest"][rigid] = (np.abs(f) < HELD * self._given["half"])[rigid]
        if "of_wrench" in self._given:  # that of the mean speed, as in RigidPlant
            self.work += 0.5 * self._h * float(self._given["of_wrench"] @ (self._v + v))

    def _friction(self) -> Float64Array:
        """(n,) MuJoCo's dry friction in the last step."""
        data, f = self._rig.data, np.zeros(self._rig.arm.n)
        rows = np.arange(data.ne, data.ne + data.nf)
        rows = rows[data.efc_type[rows] == self._dry]
        joints = self._joint_of[data.efc_id[rows]]
        f[joints[joints >= 0]] = data.efc_force[rows[joints >= 0]]
        return f

    def last(self, name: str) -> Float64Array:
        """Copy of an output of the last step: (n,) `tau` of the motors, (n,) `cut` by their effort, (6,) `wrench`."""
        value: Float64Array = self._given[name].copy()
        return value


class SensorStage(Stage):
    """Readings of an arm's sensors, from the true state."""

    def __init__(self, arm: Arm, sensors: Sensors) -> None:
        self._sensors, self._model = sensors, model_of(arm)
        self._block = noise_block(sensors.noise(arm, touched=True))
        self._rows = np.zeros((AHEAD, self._block.size))

    def _step(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:  # noqa: ARG002
        true = {path: value for path, value in inputs.items() if not path.startswith("noise.")}
        return self._sensors.read(self._model, true, subtree(inputs, "noise"), subtree(parameters, "sensors")), {}

    def start(self, seed: int, true: Values, parameters: Values) -> None:
        """Prepare for a run whose noise comes from this seed: the numbers that a model plant gets too."""
        self._noise, self._seed, self._tick = Noise(self._block, best_engine()), seed, 0
        still = {name: value if name == "q" else np.zeros_like(value) for name, value in true.items()}
        self._begin(still | self._block.views(self._block.zeros()), parameters, {}, 0.0)

    @property
    def saturating(self) -> tuple[str, ...]:
        """Outputs of `read` that report whether a sensor is at the end of its range."""
        return tuple(path for path in self._given if path.startswith("saturated."))

    def read(self, true: Values) -> dict[str, Float64Array]:
        """Readings in this tick, with fresh noise."""
        row = self._tick % AHEAD
        if row == 0:
            self._noise.fill(self._rows, self._tick, self._seed)
        self._tick += 1
        noise = self._block.views(self._rows[row])
        return {name: np.array(value) for name, value in self._call({**true, **noise}).items()}
