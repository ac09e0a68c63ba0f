"""What lies between a motor and its link: rotor, friction, losses, play and elasticity, joint by joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Final

import numpy as np

from taut.arm.description import Arm, Friction
from taut.base.errors import UsageError
from taut.base.fields import Declared, Field
from taut.base.paths import subtree
from taut.base.types import Float64Array, Matrix, Vector
from taut.maths.friction import FrictionValues, dry_limit
from taut.trace import math as tm

Values = Mapping[str, Any]
SIDES: Final = 3  # times that the side which drives each gear is looked up; a fourth one changes nothing on a Panda
RESTS: Final = 1e-9  # [rad/s | m/s] of a joint that friction holds: in MuJoCo it is not exactly zero
UNLOADED: Final = 1e-9  # [N m | N] of the weight on a joint: less is rounding, whose sign is by chance


class Transmission(Declared):
    """Gears that lose power, have backlash, or are elastic. The ratio itself and the rotor are the Arm's.

    Model:        power: the motor drives, P_out = efficiency P_in; the load drives, P_in = efficiency P_out back
                  as a friction of the gear: |f| <= (1 - efficiency) |tau_in| against motion that the motor drives,
                  |f| <= (1 / efficiency - 1) |tau_in| against motion that the load drives; at rest it sticks
                  tau_in = tau - B a_motor is what reaches the gear: the motor's torque less what accelerates its
                  rotor, so that M a = efficiency (tau - B a) + ... where the motor drives. Of a motor without torque
                  a load has the rotor alone to accelerate; further load friction is taut.Friction(load_external=...)
                  backlash and elasticity: tau_link = K z(delta) + D delta_dot where the teeth touch,
                  delta = q_motor - q, z(delta) = delta beyond +-backlash / 2, else 0; the rotor then has a motion of
                  its own, B a_motor = tau - friction - tau_link, and friction acts on its side

    Args:
        efficiency: Of the gears, in (0, 1]; 1 for none lost.
        stiffness: K [N m/rad | N/m] at the joint; rigid if left out, and np.inf for a joint that is.
        damping: D [N m s/rad | N s/m] of the spring, or of teeth that touch.
        backlash: Play of the joint with its motor held [rad | m], from tooth to tooth. Needs a stiffness, of teeth.

    Raises:
        RangeError: An efficiency outside (0, 1], a stiffness that is not above zero, a negative number.
        UsageError: Backlash or damping without a stiffness.

    References:
        Chapter, section 10.2.1.5 the effect of gearing. Spong, Modeling and control of elastic joint robots, Journal
        of Dynamic Systems, Measurement and Control 109 (1987). Nordin and Gutman, Controlling mechanical systems with
        backlash: a survey, Automatica 38 (2002).
    """

    efficiency: Field = Field(
        1.0, unit="1", shape="n", above=0.0, maximum=1.0, hint="gears give back no more than they get; 80 % is 0.8"
    )
    stiffness: Field = Field(unit="N m/rad | N/m", shape="n", above=0.0, infinite=True, optional=True)
    damping: Field = Field(0.0, unit="N m s/rad | N s/m", shape="n", minimum=0.0)
    backlash: Field = Field(0.0, unit="rad | m", shape="n", minimum=0.0)

    def check(self) -> None:
        """Backlash and damping are of something elastic."""
        rigid = np.inf if self.stiffness is None else self.stiffness
        for name in ("backlash", "damping"):
            if np.any((getattr(self, name) > 0.0) & np.isinf(rigid)):
                self.refuse(name, "needs a stiffness, that of the teeth or of the elastic part: 1e4 N m/rad, say")

    @property
    def lossy(self) -> bool:
        """Whether power is lost in the gears."""
        return bool(np.any(np.asarray(self.efficiency) < 1.0))

    @property
    def has_play(self) -> bool:
        """Whether there is backlash."""
        return bool(np.any(self.backlash))

    def compliant(self, n: int) -> tuple[int, ...]:
        """The joints whose motor and link move apart."""
        if self.stiffness is None:
            return ()
        return tuple(int(i) for i in np.flatnonzero(np.isfinite(np.broadcast_to(self.stiffness, (n,)))))

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name: those of what it has."""
        own = Declared.parameters(self)
        there = {"efficiency": self.lossy, "damping": self.stiffness is not None, "backlash": self.has_play}
        return {name: x for name, x in own.items() if there.get(name, True)}

    def loss_limits(self, tau: Vector, p: Values) -> tuple[Vector, Vector]:
        """(n,) largest friction of gears that tau reaches, against positive and against negative motion."""
        driving = (1.0 - p["efficiency"]) * tm.abs(tau)
        driven = driving / p["efficiency"]
        forward = tau > 0.0
        return tm.where(forward, driving, driven), tm.where(forward, driven, driving)

    def beyond_play(self, delta: Vector, p: Values) -> Vector:
        """(n,) z, the wind-up that is left when the play is taken up."""
        if not self.has_play:
            return delta
        half = 0.5 * p["backlash"]
        return delta - tm.clip(delta, -half, half)  # type: ignore[no-any-return]

    def torque(self, delta: Vector, rate: Vector, p: Values) -> Vector:
        """(n,) the torque on the link; teeth push, and never pull."""
        z = self.beyond_play(delta, p)
        if not self.has_play:
            return p["stiffness"] * z + p["damping"] * rate  # type: ignore[no-any-return]
        spring = p["stiffness"] * z + tm.where(z != 0.0, p["damping"] * rate, 0.0)
        play = p["backlash"] > 0.0
        pushing = tm.where(z > 0.0, tm.maximum(spring, 0.0), tm.minimum(spring, 0.0))
        return tm.where(play, pushing, spring)  # type: ignore[no-any-return]


def require_rotors(arm: Arm, joints: tuple[int, ...], rotor_inertia: Float64Array | None = None) -> None:
    """UsageError for a motor that moves apart from its link without a rotor; `rotor_inertia` is the arm's if None."""
    rotor = arm.rotor_inertia if rotor_inertia is None else rotor_inertia
    for i in joints:
        if rotor[i] <= 0.0:
            raise UsageError(
                f"joint '{arm.joint_names[i]}' has an elastic transmission or backlash, so its motor moves by itself "
                "and needs a rotor: give the arm gears or rotor_inertia",
                name="stiffness",
            )


@dataclass(frozen=True, kw_only=True)
class FrictionLimits:
    """(n,) the largest friction torques of a step [N m | N]."""

    law: tuple[Vector, Vector]  # of the friction law, against motion in the positive and in the negative direction
    low: Vector  # the first, losses of the gears included
    high: Vector  # the second

    def share_of_law(self, f: Vector) -> Vector:
        """(n,) the part of a friction torque that is the law's, the rest is the gears'."""
        most = tm.where(f < 0.0, self.low, self.high)
        dry = self.law[0] if self.law[0] is self.law[1] else tm.where(f < 0.0, *self.law)
        return f * dry / tm.where(most > 0.0, most, 1.0)  # type: ignore[no-any-return]


@dataclass(frozen=True, kw_only=True)
class RotorStep:
    """What the rotors of compliant joints do in one step; (n,) arrays, of which the other joints' are theirs."""

    v: Vector
    f: Vector
    at_rest: Vector


class FrictionLaw(Declared):
    """Base of a friction law of your own: declared fields, and the largest friction torques as a pure function.

    The plant sees to the rest: that joints really stick, alone and together, and the account of energy. Each `Field`
    is a parameter of the plant by its path, plant.friction.NAME.

    Example:
        >>> import taut
        >>> from taut.drives import Field, FrictionLaw
        >>> class Screw(FrictionLaw):
        ...     forward: Field = Field(unit="N m", shape="n", minimum=0.0)
        ...     backward: Field = Field(unit="N m", shape="n", minimum=0.0)
        ...
        ...     def limits(self, v, at_rest, tau_motor, tau_load, p):
        ...         return p["forward"] + 0.0 * v, p["backward"] + 0.0 * v
        >>> plant = taut.RigidPlant(taut.load_arm("one_joint"), friction=Screw(forward=0.5, backward=0.2))
        >>> float(plant.parameters["plant.friction.forward"])
        0.5
    """

    dry: ClassVar[bool] = True
    """Whether there is dry friction; where there is none, `limits` is not asked."""
    falls: ClassVar[bool] = False
    """Whether friction differs between rest and motion, so that `at_rest` is a condition and not None."""

    def limits(
        self, v: Vector, at_rest: Any, tau_motor: Vector, tau_load: Vector, p: Values
    ) -> tuple[Vector, Vector]:
        """(n,) the largest dry friction against motion in the positive and in the negative direction, both >= 0.

        Args:
            v: (n,) speeds of the motors when a step begins [rad/s | m/s].
            at_rest: (n,) whether a joint rested; None where `falls` is False.
            tau_motor: (n,) torques of the motors [N m | N].
            tau_load: (n,) what weight, motion and contact put on the joints [N m | N].
            p: Current values of the fields by name.
        """
        raise NotImplementedError

    def viscous(self, p: Values) -> Any:  # noqa: ARG002
        """(n,) or scalar, friction per speed [N m s/rad | N s/m]; None for none."""
        return None


@dataclass(frozen=True, kw_only=True, eq=False)
class Drivetrain:
    """Rotors, friction and transmissions of an arm."""

    arm: Arm
    friction: Friction | FrictionLaw | None
    transmission: Transmission | None

    @cached_property
    def compliant(self) -> tuple[int, ...]:
        """The joints whose motor and link move apart."""
        return () if self.transmission is None else self.transmission.compliant(self.arm.n)

    @cached_property
    def rigid(self) -> tuple[int, ...]:
        """The joints whose motor and link move together."""
        return tuple(i for i in range(self.arm.n) if i not in self.compliant)

    @property
    def dry(self) -> bool:
        """Whether anything sticks: dry friction, or gears that lose power."""
        return self.lossy or (self.friction is not None and self.friction.dry)

    @property
    def viscous(self) -> bool:
        """Whether there is viscous friction."""
        if isinstance(self.friction, FrictionLaw):
            return type(self.friction).viscous is not FrictionLaw.viscous
        return "viscous" in self.parameters()

    @property
    def lossy(self) -> bool:
        """Whether the gears lose power."""
        return self.transmission is not None and self.transmission.lossy

    @property
    def remembers_rest(self) -> bool:
        """Whether friction differs between rest and motion, so that rest is remembered."""
        return self.friction is not None and self.friction.falls

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters of the friction by name: those that are there."""
        if self.friction is None:
            return {}
        if isinstance(self.friction, FrictionLaw):
            return self.friction.parameters()
        return {name: getattr(self.friction, name) for name in FrictionValues.names(self.friction)}

    def values(self, parameters: Values) -> FrictionValues:
        """The friction's current values."""
        if self.friction is None:
            return FrictionValues()
        if isinstance(self.friction, FrictionLaw):
            return FrictionValues(viscous=self.friction.viscous(subtree(parameters, "plant.friction")))
        return FrictionValues.of(subtree(parameters, "plant.friction"), self.friction)

    def start(self, q: Vector, v: Vector, weight: Vector, parameters: Values) -> dict[str, Any]:
        """Memory at the start: springs and teeth carry the weight, friction nothing yet."""
        n = self.arm.n
        memory: dict[str, Any] = {}
        if self.dry:
            memory["friction"] = tm.zeros(n)
        if self.remembers_rest:
            memory["at_rest"] = tm.where(v == 0.0, 1.0, 0.0)
        if self.compliant:
            p = subtree(parameters, "actuation.transmission")
            wound = weight / _per_joint(p["stiffness"], n)
            if "backlash" in p:
                weighs = np.any(self.arm.gravity != 0.0)
                side = tm.where(weight >= -UNLOADED, 1.0, -1.0) if weighs else tm.sign(weight)
                wound = wound + 0.5 * p["backlash"] * side
            memory["q_motor"], memory["v_motor"] = q + wound, v + 0.0
        return memory

    def limits(
        self,
        values: FrictionValues,
        memory: Values,
        parameters: Values,
        v: Vector,
        tau: Vector,
        load: Vector,
        M: Matrix,
        dt: Any,
        contact: Any = 0.0,
    ) -> FrictionLimits:
        """The friction limits of a step, from the motors' speeds v, their torques and their loads, all at its start.

        The loss of the gears depends on the torque that reaches them, less that which accelerates the rotors: for
        that M is the mass matrix of the links, and contact what rigid contacts put on the joints.
        """
        at_rest = memory["at_rest"] > 0.5 if self.remembers_rest else None
        law = self._of_law(values, v, at_rest, tau, load, parameters)
        if not self.lossy:
            return FrictionLimits(law=law, low=law[0], high=law[1])
        assert self.transmission is not None
        rotor, p = parameters.get("plant.rotor_inertia"), subtree(parameters, "actuation.transmission")
        reaching = tau
        if rotor is not None:
            b = _per_joint(0.0 if values.viscous is None else values.viscous, self.arm.n)
            # The force of a contact that has just closed is not known yet: what rests in contact is taken to stay.
            free = 1.0 if "contact.on" not in memory else tm.where(memory["contact.on"].sum() > 0.0, 0.0, 1.0)
            reaching = tau - rotor * self._accelerations(M, tau, load + contact, law, v, free, rotor, b, p, dt)
        forth, back = self.transmission.loss_limits(reaching, p)
        return FrictionLimits(law=law, low=law[0] + forth, high=law[1] + back)

    def _of_law(
        self, values: FrictionValues, v: Vector, at_rest: Any, tau: Vector, load: Vector, parameters: Values
    ) -> tuple[Vector, Vector]:
        """(n,) the largest dry friction in both directions; the arm's own is the same in both."""
        if isinstance(self.friction, FrictionLaw) and self.friction.dry:
            return self.friction.limits(v, at_rest, tau, load, subtree(parameters, "plant.friction"))
        dry = dry_limit(values, v, at_rest, tau, load) if values.dry else tm.zeros(self.arm.n)
        return dry, dry

    def _accelerations(
        self, M: Matrix, tau: Vector, load: Vector, law: tuple[Vector, Vector], v: Vector, free: Any, rotor: Any,
        b: Vector, p: Values, dt: Any,
    ) -> Vector:  # fmt: skip
        """(n,) of the rotors in a step: M a = load - b v - dry + passed (tau - rotor a); none reverses.

        passed is the efficiency where the motor drives and its inverse where the load does. A free joint at rest
        moves where torques overcome its friction. One joint takes two solutions, coupled ones a third.
        """
        assert self.transmission is not None
        n, rotor = self.arm.n, _per_joint(rotor, self.arm.n)
        rigid = np.array([float(i in self.rigid) for i in range(n)])
        links = np.outer(rigid, rigid) * M
        forth, back = self.transmission.loss_limits(tau, p)
        a = sign = tm.zeros(n)
        for _ in range(SIDES):
            net = tau + load - (links - links * np.eye(n)) @ a
            begins = tm.where(net > law[0] + forth, 1.0, tm.where(net < -law[1] - back, -1.0, 0.0))
            sign = tm.where(tm.abs(v) > RESTS, tm.sign(v), free * begins)
            moves = tm.abs(sign)
            dry = sign * law[0] if law[0] is law[1] else tm.where(sign < 0.0, -law[1], sign * law[0])
            passed = tm.where(sign * (tau - rotor * a) > 0.0, p["efficiency"], 1.0 / p["efficiency"])
            left = np.outer(moves, moves) * links + tm.eye(n) * (passed * rotor + dt * b + (1.0 - moves))
            a = tm.solve_spd(left, moves * (load - b * v - dry + passed * tau))
        return tm.where(sign * (v + dt * a) > 0.0, a, -v / dt)  # type: ignore[no-any-return]

    def spring(self, q: Vector, v: Vector, memory: Values, parameters: Values) -> Vector:
        """(n,) what springs and teeth put on the links; of rigid joints zero."""
        assert self.transmission is not None
        joints = list(self.compliant)
        p = {
            name: value[joints] if np.ndim(value) else value
            for name, value in subtree(parameters, "actuation.transmission").items()
        }
        delta, rate = (memory["q_motor"] - q)[joints], (memory["v_motor"] - v)[joints]
        return self.spread(self.transmission.torque(delta, rate, p))

    def rotors(
        self, memory: Values, tau: Vector, spring: Vector, b: Any, limits: FrictionLimits | None, rotor: Any, dt: Any
    ) -> RotorStep:
        """Motors of the compliant joints after a step, b being their viscous friction."""
        v_m = memory["v_motor"]
        viscous = _per_joint(0.0 if b is None else b, self.arm.n)
        inertia = _per_joint(rotor, self.arm.n)
        v_new, f, at_rest = [], [], []
        for i in self.compliant:
            mass = inertia[i] + dt * viscous[i]
            free = (inertia[i] * v_m[i] + dt * (tau[i] - spring[i])) / mass
            stop, held, rests = -free * mass / dt, 0.0, 0.0
            if limits is not None:
                held = tm.clip(stop, -limits.low[i], limits.high[i])
                rests = tm.where((stop > -limits.low[i]) & (stop < limits.high[i]), 1.0, 0.0)
            f.append(held)
            at_rest.append(rests)
            v_new.append(free + dt * held / mass)
        return RotorStep(
            v=self.spread(tm.array(v_new)), f=self.spread(tm.array(f)), at_rest=self.spread(tm.array(at_rest))
        )

    def spread(self, of_compliant: Vector) -> Vector:
        """(n,) entries of the compliant joints, zero for the others."""
        out: list[Any] = [0.0] * self.arm.n
        for k, i in enumerate(self.compliant):
            out[i] = of_compliant[k]
        return tm.array(out)

    def merged(self, of_rigid: Vector, of_compliant: Vector) -> Vector:
        """(n,) the first one's entries for rigid joints, the second one's for compliant joints."""
        if not self.compliant:
            return of_rigid
        return tm.array([(of_compliant if i in self.compliant else of_rigid)[i] for i in range(self.arm.n)])


def _per_joint(value: Any, n: int) -> Any:
    return value if np.ndim(value) else np.broadcast_to(value, (n,))
