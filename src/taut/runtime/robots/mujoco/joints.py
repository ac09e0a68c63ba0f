"""Motors, gears and friction of an arm in MuJoCo: the stages of RigidPlant, before and after each of its steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.arm.description import CommandKind, Friction
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.engine import Steps, best_engine
from taut.codegen.layout import Block
from taut.codegen.loop import StepLoop
from taut.maths import dynamics as dyn
from taut.maths.adds import Adds, compensation
from taut.maths.model import PayloadValues, model_of
from taut.plant.drives.actuation import Actuation
from taut.plant.drives.drivetrain import Drivetrain
from taut.plant.drives.stiff_drive import Follower
from taut.plant.step_length import Steps as Division
from taut.plant.step_length import require_short_steps
from taut.runtime.robots.mujoco.rig import Rig

__all__ = ["JointStage", "LinkTorque"]

Values = Mapping[str, Any]
HELD: float = 1.0 - 1e-9  # of its limit: what friction is less than holds a joint


class LinkTorque:
    """What arrives at the links of torques that were given to MuJoCo's joints: friction and rotors take theirs."""

    def __init__(self, rig: Rig) -> None:
        import mujoco

        self._rig = rig
        self._of_joints = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)
        self._dofs = np.array(rig.dofs, dtype=np.intp)
        self._place = np.full(rig.model.nv, -1, dtype=np.intp)  # of a degree of freedom: the arm's joint, or none
        self._place[self._dofs] = np.arange(rig.arm.n)

    def friction(self) -> Float64Array:
        """(n,) dry friction of the last step."""
        data = self._rig.data
        f = np.zeros(self._rig.arm.n)
        rows = np.arange(data.ne, data.ne + data.nf)
        rows = rows[data.efc_type[rows] == self._of_joints]
        joints = self._place[data.efc_id[rows]]
        f[joints[joints >= 0]] = data.efc_force[rows[joints >= 0]]
        return f

    def of_step(self, given: Float64Array, f: Float64Array, v: Float64Array, a: Float64Array) -> Float64Array:
        """(n,) of torques given, dry friction f, velocities v after the step and its accelerations."""
        model = self._rig.model
        arrived: Float64Array = given + f - model.dof_damping[self._dofs] * v - model.dof_armature[self._dofs] * a
        return arrived


class JointStage:
    """What stands between a torque command and MuJoCo's joints.

    MuJoCo knows a dry friction that is the same at rest and in motion. Its limit is given anew before each step, as
    the law says at that speed and load; where it differs with the direction, its middle goes with the motor's torque.
    A joint whose transmission gives way or has play has its rotor here, and gets the torque of spring and teeth.

    Args:
        rig: The arm in its model, built by us.
        actuation: The drives.
        train: Rotors, friction and transmissions.
        adds: What the plant adds to a torque command itself.
        takes: The command. Drives that take velocities or positions have an inner loop, which gives the torque.
    """

    def __init__(
        self, rig: Rig, actuation: Actuation, train: Drivetrain, adds: Adds, takes: CommandKind = "torque"
    ) -> None:
        self._rig, self._actuation, self._train, self._adds = rig, actuation, train, adds
        self._model = model_of(rig.arm)
        self._links = model_of(rig.arm.with_joints(rotor_inertia=0.0))
        self._follower: Follower | None = None
        if takes != "torque":
            self._follower = Follower(arm=rig.arm, takes=takes, model=self._links)
        self._rigid = np.array(train.rigid, dtype=np.intp)
        self._dofs = np.array(rig.dofs, dtype=np.intp)
        self._arrived = LinkTorque(rig)
        self._loop: StepLoop | None = None

    # ---------------------------------------------------------------- the pure function

    def _step(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        train, dt = self._train, parameters["dt"]
        q, v = inputs["q"], inputs["v"]
        q_m, v_m = memory.get("q_motor", q), memory.get("v_motor", v)
        payload = PayloadValues.of(subtree(parameters, "plant.payload"))
        added = compensation(self._model, self._adds, q, v, payload)
        cut: Any = np.zeros(self._rig.arm.n)
        if self._follower is None:
            given = self._actuation.step(self._rig.arm, memory, q_m, v_m, parameters, dt, added)
            asked, after = given.tau, given.memory
        else:
            asked, cut, after = self._follower.torque(memory, q, v, parameters, dt)
        out = {**memory, **after}
        tau = asked + added
        load: Any = np.zeros(self._rig.arm.n)
        if train.lossy or (isinstance(train.friction, Friction) and np.any(train.friction.load_external_static)):
            load = dyn.jacobian(self._model, q).T @ inputs["F_ext"] - dyn.bias(self._model, q, v, payload)
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
        return {"tau": asked, "onto": onto, "half": half, "cut": cut}, out

    # ---------------------------------------------------------------- a run

    def start(self, q: Float64Array, v: Float64Array, parameters: Values, dt: float, steps: int) -> None:
        """Memory at the start of a run, for control periods of dt [s], each of so many steps."""
        arm, h = self._rig.arm, dt / steps
        values = {**parameters, "dt": np.asarray(h)}
        payload = PayloadValues.of(subtree(parameters, "plant.payload"))
        full = dyn.gravity_torque(self._model, q, payload)
        weight = full - compensation(self._model, self._adds, q, np.zeros(arm.n), payload)

        memory = {"held": weight, "tau_link": full}
        if self._follower is None:
            memory |= self._actuation.start(arm, weight, parameters)
        else:
            memory |= self._follower.start(q, v, parameters, Division(dt, steps))
        started = self._train.start(q, v, full, parameters)
        memory |= {name: value for name, value in started.items() if name != "friction"}
        require_short_steps(self._train, self._actuation, parameters, Division(dt, steps))
        n = arm.n
        if self._loop is None:
            self._inputs = Block.of({"q": (n,), "v": (n,), "F_ext": (6,)})
            self._parameters = Block.of({path: np.shape(value) for path, value in values.items()})
            self._memory = Block.of({path: np.shape(value) for path, value in memory.items()})
            example = self._inputs.zeros(), self._parameters.pack(values), self._memory.pack(memory)
            example[0][:n] = q
            blocks = self._inputs, self._parameters, self._memory
            self._loop = StepLoop(Steps(self._step, *blocks), example, engine=best_engine())
            self._row, self._out = np.zeros((1, self._inputs.size)), np.zeros((1, self._loop.outputs.size))
        self._flat = self._memory.pack(memory)
        self._seen = {path: view[0] for path, view in self._inputs.views(self._row).items()}
        self._given = {path: view[0] for path, view in self._loop.outputs.views(self._out).items()}
        self.memory = self._memory.views(self._flat)
        self._h = h
        self.take(parameters)
        self.sane = True

    def take(self, parameters: Values) -> None:
        """New values of the parameters, by path, in a run or between two."""
        if self._loop is None:
            return
        self._flat_parameters = self._parameters.pack({**parameters, "dt": self._h})

    def before(self, q: Float64Array, v: Float64Array, F_ext: Float64Array) -> Float64Array:
        """(n,) the torques for MuJoCo's next step, whose friction limits are put into the model."""
        assert self._loop is not None
        self._seen["q"][...], self._seen["v"][...], self._seen["F_ext"][...] = q, v, F_ext
        done = self._loop.run(self._row, self._flat_parameters, self._flat, self._out)
        self.sane = self.sane and done == 1
        self._rig.model.dof_frictionloss[self._dofs] = self._given["half"]
        self._v = v.copy()
        onto: Float64Array = self._given["onto"]
        return onto

    def after(self, q: Float64Array, v: Float64Array) -> None:
        """What MuJoCo's step did that the next one depends on: motion, and friction."""
        rigid, f = self._rigid, self._arrived.friction()
        if self._train.compliant:
            self.memory["q_motor"][rigid], self.memory["v_motor"][rigid] = q[rigid], v[rigid]
        arrived = self._arrived.of_step(self._given["onto"], f, v, (v - self._v) / self._h)
        self.memory["tau_link"][rigid] = arrived[rigid]
        if "at_rest" in self.memory:
            self.memory["at_rest"][rigid] = (np.abs(f) < HELD * self._given["half"])[rigid]

    @property
    def tau(self) -> Float64Array:
        """(n,) torques of the motors in the last step."""
        tau: Float64Array = self._given["tau"].copy()
        return tau

    @property
    def cut(self) -> Float64Array:
        """(n,) what the effort of drives that follow by themselves cut off in the last step."""
        cut: Float64Array = self._given["cut"].copy()
        return cut
