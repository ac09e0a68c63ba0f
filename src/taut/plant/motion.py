"""How a rigid arm moves in one step: under stiff drives, or under torques that motors, gears and friction pass on.

Work is accounted for by each part of a step, joint by joint: torque times the displacement dt v+ of its joint.
`integration` is what a step of finite length adds; it tends to zero with dt.

    electric = copper + magnetic + motor + conversion                          where the motor is an electric one
    motor    = rotor + viscous + dry + gears + spring + damping + link + integration
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np

from taut.base.paths import subtree
from taut.base.types import Array, Vector
from taut.maths import dynamics as dyn
from taut.maths.dynamics import compensation
from taut.maths.friction import dry_friction, friction_torque
from taut.maths.model import Model, PayloadValues, links_of, model_of
from taut.plant.actuation import MotorStep, aim
from taut.plant.contact_step import ContactStep, contact_step
from taut.plant.drivetrain import FrictionLaw, FrictionLimits
from taut.plant.environments.environment import WRENCH, joint_forces, touch
from taut.plant.parts import PlantParts
from taut.trace import math as tm

Values = Mapping[str, Any]
WORK_OF_IT: Final = "work.environment"  # [J] done on the arm by what touches it
WORK: Final = {
    "electric": "taken from the supply",
    "copper": "heat of the windings",
    "magnetic": "stored in the windings",
    "conversion": "of the step: the back-EMF is that of its start",
    "motor": "done by the motors, and by what the plant adds",
    "rotor": "stored in the rotors' motion",
    "viscous": "lost to viscous friction",
    "dry": "lost to dry friction",
    "gears": "lost in the gears",
    "spring": "stored in elastic transmissions",
    "damping": "lost in elastic transmissions",
    "link": "done on the links",
    "integration": "of the step: from torques of its start and ways of its end",
}


def payload_of(parameters: Values) -> PayloadValues:
    """What the tool carries, by a plant's parameters."""
    return PayloadValues.of(subtree(parameters, "plant.payload"))


@dataclass(frozen=True, kw_only=True)
class _Moved:
    """An arm after a step, and what moved it."""

    q: Vector
    v: Vector
    f: Vector  # dry friction, and losses of the gears
    spring: Vector  # what compliant joints put on their links
    limits: FrictionLimits | None = None
    contact: ContactStep | None = None
    memory: dict[str, Any] = field(default_factory=dict)  # of friction, rotors and contacts


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Steps of an arm with its drives, friction and environment, as pure functions of the plant's memory."""

    parts: PlantParts
    energy: bool  # keeps account of work

    @cached_property
    def model(self) -> Model:
        """The constants of the arm."""
        return model_of(self.parts.arm)

    @cached_property
    def link_model(self) -> Model:
        """The same without its rotors, whose inertia is a parameter."""
        return links_of(self.parts.arm)

    @cached_property
    def work(self) -> tuple[str, ...]:
        """The parts of the work that are accounted for, in the order of `WORK`."""
        if not self.energy:
            return ()
        train, motor = self.parts.drivetrain, self.parts.actuation.motor
        there = {
            **dict.fromkeys(("motor", "link", "integration"), True),
            **dict.fromkeys(() if motor is None else motor.work, True),
            "rotor": self.parts.arm.rotor_inertia.any(),
            "viscous": train.viscous,
            "dry": train.friction is not None and train.friction.dry,
            "gears": train.lossy,
            **dict.fromkeys(("spring", "damping"), train.compliant),
        }
        return tuple(name for name in WORK if there.get(name))

    def compensation(self, q: Vector, v: Vector, parameters: Values) -> Array:
        """(n,) what the plant adds to a torque command itself, friction apart."""
        return compensation(self.model, self.parts.adds, q, v, payload_of(parameters))

    def touch(
        self, q: Vector, v: Vector, memory: Values, parameters: Values, t: Any, dt: Any
    ) -> tuple[Array, dict[str, Any]]:
        """(6,) F_ext at a state, and the environment's memory after it."""
        assert self.parts.environment is not None
        before, numbers = subtree(memory, "environment"), subtree(parameters, "environment")
        return touch(self.parts.environment, self.model, q, v, before, numbers, t, dt)

    def _outside(
        self, q: Vector, v: Vector, memory: Values, parameters: Values, t: Any, dt: Any
    ) -> tuple[Array | None, Array | None, dict[str, Any]]:
        """(6,) F_ext and the (n,) forces of joints from outside, None where there are none; the memory after it."""
        wrench: Array | None = parameters.get(WRENCH)
        touched: dict[str, Any] = {}
        if self.parts.environment is not None:
            contact_wrench, touched = self.touch(q, v, memory, parameters, t, dt)
            wrench = contact_wrench if wrench is None else contact_wrench + wrench
        return wrench, joint_forces(self.model, q, wrench, parameters), touched

    @staticmethod
    def _touched(memory: Values, wrench: Array, touched: Values, t: Any) -> dict[str, Any]:
        """Memory of what touches the tool after a step; its work is added by who knows the way."""
        after = {f"environment.{name}": x for name, x in touched.items()}
        return {"F_ext": wrench, "t": t, WORK_OF_IT: memory[WORK_OF_IT], **after}

    def step(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]:
        """Memory after a step under what stands at the drives."""
        taken = self._driven_step if self.parts.stiff else self._torque_step
        return taken(memory, parameters, dt)

    def _driven_step(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]:
        """Stiff drives: their loop decides the motion, and the torque is what that takes."""
        q, v = memory["q"], memory["v"]
        q_new, v_new = aim(
            self.parts.takes, self.parts.arm, memory["held"], q, v, parameters["actuation.bandwidth"], dt
        )
        a = (v_new - v) / dt
        out, t = dict(memory), memory.get("t", 0.0)
        wrench, outside, touched = self._outside(q, v, memory, parameters, t, dt)
        force: Any = np.zeros(self.parts.arm.n) if outside is None else outside
        if self.parts.environment is not None:
            assert wrench is not None
            out |= self._touched(memory, wrench, touched, t + dt)
            out[WORK_OF_IT] = memory[WORK_OF_IT] + 0.5 * dt * (force @ (v + v_new))
        tau = link = dyn.inverse_dynamics(self.link_model, q, v, a, payload_of(parameters)) - force
        if "plant.rotor_inertia" in parameters:
            tau = tau + parameters["plant.rotor_inertia"] * a
        friction = self.parts.drivetrain.friction
        if friction is not None:
            assert not isinstance(friction, FrictionLaw)  # which is for torque commands
            load: Any = np.zeros(self.parts.arm.n)
            if friction.loaded:
                load = force - dyn.bias(self.link_model, q, v, payload_of(parameters))
            tau = tau - friction_torque(self.parts.drivetrain.values(parameters), v, tau, load)
        return out | {"q": q_new, "v": v_new, "tau": tau, "tau_link": link}

    def _torque_step(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]:
        q, v, t = memory["q"], memory["v"], memory.get("t", 0.0)
        q_m, v_m = memory.get("q_motor", q), memory.get("v_motor", v)
        added = self.compensation(q, v, parameters)
        given = self.parts.actuation.step(self.parts.arm, memory, q_m, v_m, parameters, dt, added)
        out = {**memory, **given.memory, "tau": given.tau}
        tau = given.tau + added
        wrench, force, touched = self._outside(q, v, memory, parameters, t, dt)
        if self.parts.environment is not None:
            assert wrench is not None
            out |= self._touched(memory, wrench, touched, t + dt)
        if self.parts.smooth:
            q_new, v_new, done = self._rk4(q, v, given.tau, memory, parameters, t, dt)
            moved = _Moved(q=q_new, v=v_new, f=np.zeros(self.parts.arm.n), spring=tau)
        else:
            moved = self._euler(tau, force, memory, parameters, dt)
            done = 0.0 if force is None else 0.5 * dt * (force @ (v + moved.v))
            if moved.contact is not None:
                done = done + 0.5 * (moved.contact.impulse @ (v + moved.v))
                out["t"] = t + dt
                if "F_ext" in memory:
                    contact_wrench = moved.contact.wrench
                    out["F_ext"] = contact_wrench if wrench is None else wrench + contact_wrench
        if WORK_OF_IT in memory:
            out[WORK_OF_IT] = memory[WORK_OF_IT] + done
        out |= {**moved.memory, "q": moved.q, "v": moved.v}
        b, rotor = self.parts.drivetrain.values(parameters).viscous, parameters.get("plant.rotor_inertia")
        v_end = out.get("v_motor", moved.v)
        lost = tm.zeros(self.parts.arm.n) if b is None else b * v_end
        out["tau_link"] = tau + moved.f - lost  # what of the motor's torque arrives behind the gear
        if rotor is not None:
            out["tau_link"] = out["tau_link"] - rotor * (v_end - v_m) / dt
        if self.work:
            done = self._work(memory, out, given, moved, tau, lost, parameters, dt)
            out |= {f"work.{name}": memory[f"work.{name}"] + done[name] for name in self.work}
        return out

    def _work(
        self,
        memory: Values,
        after: Values,
        given: MotorStep,
        moved: _Moved,
        tau: Vector,
        lost: Vector,
        parameters: Values,
        dt: Any,
    ) -> dict[str, Vector]:
        """(n,) [J] of each part in one step; tau is the motors' torque with what the plant adds, lost is viscous."""
        train, rotor, f = self.parts.drivetrain, parameters.get("plant.rotor_inertia"), moved.f
        q, v_m, v_end = memory["q"], memory.get("v_motor", memory["v"]), after.get("v_motor", moved.v)
        motor_way, link_way = after.get("q_motor", moved.q) - memory.get("q_motor", q), moved.q - q
        of_law = f if moved.limits is None else moved.limits.share_of_law(f)
        out: dict[str, Vector] = {
            **given.work,
            "conversion": given.tau * (v_m * dt - motor_way),
            "motor": tau * motor_way,
            "viscous": lost * motor_way,
            "dry": -of_law * motor_way,
            "gears": -(f - of_law) * motor_way,
            "link": train.merged(after["tau_link"], moved.spring) * link_way,
            "integration": tm.zeros(self.parts.arm.n),
        }
        if rotor is not None:
            stored = 0.5 * rotor * (v_end * v_end - v_m * v_m)
            out |= {"rotor": stored, "integration": rotor * (v_end - v_m) * motor_way / dt - stored}
        if train.compliant:
            assert train.transmission is not None
            p = subtree(parameters, "actuation.transmission")
            K = train.merged(tm.zeros(self.parts.arm.n), p["stiffness"] + tm.zeros(self.parts.arm.n))
            delta, wound = memory["q_motor"] - q, motor_way - link_way
            z = train.transmission.beyond_play(delta, p)
            z_end = train.transmission.beyond_play(delta + motor_way - link_way, p)
            stored = 0.5 * K * (z_end * z_end - z * z)
            out |= {"spring": stored, "damping": (moved.spring - K * z) * wound}
            out["integration"] = out["integration"] + K * z * wound - stored
        return out

    def _euler(self, tau: Vector, force: Vector | None, memory: Values, parameters: Values, dt: Any) -> _Moved:
        """Semi-implicit Euler, with viscous friction at the end of the step and dry friction that sticks."""
        q, v, train = memory["q"], memory["v"], self.parts.drivetrain
        payload, values = payload_of(parameters), train.values(parameters)
        b, rotor = values.viscous, parameters.get("plant.rotor_inertia")
        load = -dyn.bias(self.model, q, v, payload)
        if force is not None:
            load = load + force
        spring = train.spring(q, v, memory, parameters) if train.compliant else tau
        M = dyn.mass_matrix(self.link_model, q, payload)
        limits, borne = None, memory.get("contact.load")
        if train.dry:
            v_m, loads = memory.get("v_motor", v), train.merged(load, -spring)
            held = 0.0 if borne is None else train.merged(borne, tm.zeros(self.parts.arm.n))
            limits = train.limits(values, memory, parameters, v_m, tau, loads, M, dt, held)
        rhs = train.merged(tau if b is None else tau - b * v, spring) + load
        for i in train.rigid:
            M[i, i] = M[i, i] + _entry(rotor, i) + dt * _entry(b, i)
        factors = tm.factor_spd(M)
        v_new = v + dt * factors.solve(rhs)
        after: dict[str, Any] = {}
        f, at_rest = np.zeros(self.parts.arm.n), np.zeros(self.parts.arm.n)
        if limits is not None and train.rigid:
            # The forces of rigid contacts, friction takes as of the last step; these then act with what it is.
            slowed = v_new
            if borne is not None:
                slowed = v_new + dt * factors.solve(borne)
            pushed = rhs if borne is None else rhs + borne
            stop = None if train.compliant else -(pushed + M @ v / dt)
            stuck = dry_friction(
                factors, slowed, limits.low, limits.high, memory["friction"], dt, joints=train.rigid, stop=stop
            )
            f, at_rest = stuck.f, stuck.at_rest
            v_new = stuck.v if borne is None else v_new + dt * factors.solve(f)
            if "friction_residual" in memory:
                after["friction_residual"] = stuck.residual
        q_new, contact = q + dt * v_new, None
        if self.parts.contacts is not None:
            t = memory["t"]
            contact = contact_step(self.parts.contacts, self.model, factors, q, v, v_new, t, memory, parameters, dt)
            q_new, v_new = contact.q, contact.v
            after |= contact.memory
        if train.compliant:
            rotors = train.rotors(memory, tau, spring, b, limits, rotor, dt)
            f, at_rest = train.merged(f, rotors.f), train.merged(at_rest, rotors.at_rest)
            after["v_motor"] = train.merged(v_new, rotors.v)
            after["q_motor"] = train.merged(q_new, memory["q_motor"] + dt * rotors.v)
        if limits is not None:
            after["friction"] = f
            if train.remembers_rest:
                after["at_rest"] = at_rest
        return _Moved(q=q_new, v=v_new, f=f, spring=spring, limits=limits, contact=contact, memory=after)

    def _rk4(
        self, q: Vector, v: Vector, tau: Vector, memory: Values, parameters: Values, t: Any, dt: Any
    ) -> tuple[Vector, Vector, Any]:
        """Positions and velocities after the step, and what the environment did in it [J]."""
        payload, rotor = payload_of(parameters), parameters.get("plant.rotor_inertia")

        def rates(q: Vector, v: Vector, t: Any) -> tuple[Vector, Vector, Any]:
            power: Any = 0.0
            force = tau + self.compensation(q, v, parameters)
            if "plant.friction.viscous" in parameters:
                force = force - parameters["plant.friction.viscous"] * v
            _, outside, _ = self._outside(q, v, memory, parameters, t, dt)
            if outside is not None:
                power, force = outside @ v, force + outside
            return v, dyn.forward_dynamics(self.link_model, q, v, force, payload, damping=rotor), power

        half = 0.5 * dt
        v1, a1, p1 = rates(q, v, t)
        v2, a2, p2 = rates(q + half * v1, v + half * a1, t + half)
        v3, a3, p3 = rates(q + half * v2, v + half * a2, t + half)
        v4, a4, p4 = rates(q + dt * v3, v + dt * a3, t + dt)
        sixth = dt / 6.0
        q_new, v_new = q + sixth * (v1 + 2.0 * (v2 + v3) + v4), v + sixth * (a1 + 2.0 * (a2 + a3) + a4)
        return q_new, v_new, sixth * (p1 + 2.0 * (p2 + p3) + p4)


def _entry(value: Any, i: int) -> Any:
    """Of a scalar or of one number per joint; nothing is zero."""
    if value is None:
        return 0.0
    return value[i] if np.ndim(value) else value
