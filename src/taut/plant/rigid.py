"""RigidPlant: a rigid arm with drives, friction, sensors and an environment, as pure functions.

Written like a law, so that it runs on floats, is fused with a controller into one native loop, and differentiated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np

from taut.arm.description import COMMANDS, Arm, CommandKind, Payload
from taut.base import math as tm
from taut.base.checks import finite_array, one_of
from taut.base.errors import RangeError, ShapeError, UsageError, quoted_list, unknown_name
from taut.base.paths import subtree
from taut.base.types import Array, ArrayLike, Float64Array, Vector
from taut.maths import dynamics as dyn
from taut.maths.adds import Adds
from taut.maths.compensation import compensation
from taut.maths.friction import SWEEPS, dry_friction
from taut.maths.friction_law import friction_torque
from taut.maths.model import Model, PayloadValues, model_of
from taut.plant import drive
from taut.plant.actuation import Actuation, delayed, lagged
from taut.plant.drivetrain import Drivetrain
from taut.plant.environment import Environment
from taut.plant.numbers import PlantNumbers, require_torque_sensor
from taut.plant.sensors import Sensors
from taut.plant.transmission import require_rotors
from taut.plant.work import work_of_step, work_parts

__all__ = ["RigidPlant"]

Integrator = Literal["semi-implicit-euler", "rk4"]
INTEGRATORS: Final[tuple[Integrator, ...]] = ("semi-implicit-euler", "rk4")
Values = Mapping[str, Any]
MOST_SUBSTEPS: Final = 1000
STAGES: Final = {"actuation": Actuation, "sensors": Sensors}


@dataclass(frozen=True, eq=False)
class RigidPlant:
    """A rigid arm in free space, or touching an environment at its tool.

    Model:
        (M + rotors) a + C v + g + b v + friction = tau + J^T F_ext
        semi-implicit Euler: v+ = v + dt a with b v taken at v+, q+ = q + dt v+; dry friction really sticks, and
        depends on speed and load as they are when a step begins.
        rk4: fourth order in smooth motion; dry friction and elastic transmissions are refused.
        A joint with an elastic transmission or backlash has a motor that moves by itself: see taut.Transmission.

    Frames:
        F_ext is the wrench of the environment on the arm, force first, in world axes at the tool's origin. Like the
        joint torques, what the sensor gives in a tick is that of the last step of the integrator; a run records
        what acted in the step that follows the tick.

    Args:
        arm: The true arm; make it differ from the controller's and there is a modelling error.
        friction: "arm" for the arm's own friction (`arm.with_friction`), None for none.
        integrator: "semi-implicit-euler" or "rk4".
        substeps: Steps of the integrator in one control period.
        takes: The command: "torque", "velocity" or "position". The last two are stiff drives, which need
            `actuation=Actuation(bandwidth=...)`.
        actuation: The drives: delay, amplifier, motor, gear; ideal if left out.
        sensors: What is measured, and how well; ideal sensors if left out.
        environment: What touches the tool, if anything; then the wrench is measured too.
        adds: What the plant adds to a torque command itself: "gravity", "coriolis", and "friction", which cancels the
            arm's own, so that none is left.
        sweeps: Of projected Gauss-Seidel in each step, for joints that dry friction holds together. What a further
            one would change is the run's column friction_residual [N m | N].
        energy: Keep account of the work of each part of the drives: columns work.motor, work.dry, ... [J], see
            `taut.plant.work`.

    Raises:
        UsageError: Options that do not go together, or are of another kind.
        ShapeError: Sensors for another number of joints.
    """

    arm: Arm
    friction: Literal["arm"] | None = "arm"
    integrator: Integrator = field(default="semi-implicit-euler", kw_only=True)
    substeps: int = field(default=1, kw_only=True)
    takes: CommandKind = field(default="torque", kw_only=True)
    actuation: Actuation = field(default_factory=Actuation, kw_only=True)
    sensors: Sensors = field(default_factory=Sensors, kw_only=True)
    environment: Environment | None = field(default=None, kw_only=True)
    adds: Adds | Iterable[str] | Mapping[str, Payload | None] = field(default=(), kw_only=True)
    sweeps: int = field(default=SWEEPS, kw_only=True)
    energy: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.arm, Arm):
            raise UsageError(f"a plant takes an Arm from taut.load_arm; got {type(self.arm).__name__}", name="arm")
        one_of("integrator", self.integrator, INTEGRATORS)
        one_of("takes", self.takes, COMMANDS)
        if self.friction not in ("arm", None):
            raise UsageError(f"friction must be 'arm' or None; got {self.friction!r}", name="friction")
        for name in ("substeps", "sweeps"):
            number = getattr(self, name)
            if isinstance(number, bool) or not isinstance(number, int):
                raise UsageError(f"{name} must be a whole number; got {number!r}", name=name)
            if not 1 <= number <= MOST_SUBSTEPS:
                raise RangeError(f"{name} must be between 1 and {MOST_SUBSTEPS}; got {number}", name=name)
        if not isinstance(self.energy, bool):
            raise UsageError(f"energy must be True or False; got {self.energy!r}", name="energy")
        for name, kind in STAGES.items():
            if not isinstance(getattr(self, name), kind):
                got = type(getattr(self, name)).__name__
                raise UsageError(f"{name} must be taut.{kind.__name__}(...); got {got}", name=name)
        self.sensors.check(self.arm, touched=self.environment is not None)
        if self.environment is not None and not isinstance(self.environment, Environment):
            raise UsageError(
                "environment must have parameters(), start(T_WE) and wrench(...), see taut.Environment; got "
                f"{type(self.environment).__name__}",
                name="environment",
            )
        adds = Adds.of(self.adds)
        object.__setattr__(self, "adds", adds)
        self.actuation.check_size(self.arm)
        require_rotors(self.arm, self.drivetrain.compliant)
        require_torque_sensor(self.actuation, self.sensors)
        if self.integrator == "rk4":
            self._check_smooth()
        if self.takes != "torque":
            if self.actuation.bandwidth is None:
                raise UsageError(
                    f"a plant that takes {self.takes} needs the bandwidth of its drives: "
                    "actuation=taut.Actuation(bandwidth=50.0)  # rad/s",
                    name="actuation",
                )
            only = self.actuation.for_torque_only
            if only:
                raise UsageError(
                    f"actuation.{only[0]} is for torque commands; this plant takes {self.takes}, which its drives "
                    "follow by themselves",
                    name=only[0],
                )
            if self.energy:
                raise UsageError(f"energy is for torque commands; this plant takes {self.takes}", name="energy")
            if adds.names:
                raise UsageError(f"adds is for torque commands; this plant takes {self.takes}", name="adds")
            if self.environment is not None:
                raise UsageError(
                    f"a plant that takes {self.takes} has stiff drives, which an environment cannot move; "
                    "leave environment out",
                    name="environment",
                )

    def _check_smooth(self) -> None:
        if self.drivetrain.dry:
            what = "gears that lose power" if not self._has("coulomb", "static") else "dry friction"
            raise UsageError(
                f"rk4 needs smooth forces, and arm '{self.arm.name}' has {what}; use semi-implicit-euler, or "
                "friction=None",
                name="integrator",
            )
        if self.drivetrain.compliant:
            raise UsageError(
                "rk4 moves the arm alone, and an elastic transmission or backlash moves the motors too; use "
                "semi-implicit-euler",
                name="integrator",
            )
        if self.energy:
            raise UsageError("energy is kept account of by semi-implicit-euler only", name="energy")

    def _has(self, *names: str) -> bool:
        return any(name in self.drivetrain.parameters() for name in names)

    @cached_property
    def drivetrain(self) -> Drivetrain:
        """Rotors, friction and transmissions."""
        left = self.friction == "arm" and not Adds.of(self.adds).friction
        friction = self.arm.friction if left else None
        return Drivetrain(arm=self.arm, friction=friction, transmission=self.actuation.transmission)

    @cached_property
    def _work_parts(self) -> tuple[str, ...]:
        return work_parts(self.drivetrain, self.actuation.motor) if self.energy else ()

    # ---------------------------------------------------------------- what it declares

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return f"RigidPlant({self.arm.name})"

    @property
    def measures(self) -> frozenset[str]:
        """What it measures besides positions."""
        return self.sensors.measures(touched=self.environment is not None)

    @property
    def distorts(self) -> frozenset[str]:
        """The measurements that differ from the truth."""
        return self.sensors.distorts(touched=self.environment is not None)

    @property
    def noise(self) -> dict[str, tuple[int, ...]]:
        """Standard normal numbers that it needs in every tick, by name."""
        return self.sensors.noise(self.arm, touched=self.environment is not None)

    @property
    def model(self) -> Model:
        """The constants of the true arm."""
        return model_of(self.arm)

    @cached_property
    def link_model(self) -> Model:
        """The same without its rotors, whose inertia is a parameter."""
        return model_of(self.arm.with_joints(rotor_inertia=0.0))

    @property
    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by path: plant.payload.mass, actuation.bandwidth, ..."""
        out = self._numbers.values()
        if self.environment is not None:
            out |= {f"environment.{name}": value for name, value in self.environment.parameters().items()}
        return out

    @cached_property
    def _numbers(self) -> PlantNumbers:
        return PlantNumbers(arm=self.arm, drivetrain=self.drivetrain, actuation=self.actuation, sensors=self.sensors)

    def checked_parameter(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value of a parameter, checked like the first one and in its shape.

        Raises:
            UnknownNameError: There is no such parameter.
            ShapeError: Another shape.
            RangeError: NaN, infinite or negative.
        """
        known = self.parameters
        if path not in known:
            raise unknown_name(f"plant '{self.name}'", "parameter", path, known)
        if not path.startswith("environment."):
            return self._numbers.checked(path, value)
        shape, new = known[path].shape, finite_array(path, value)
        if new.shape not in ((), shape):
            raise ShapeError(
                f"{path} has shape {shape}; got shape {new.shape}; make the plant with a value of the new shape",
                name=path,
            )
        return np.broadcast_to(new, shape)

    def check_together(self, values: Mapping[str, ArrayLike]) -> None:
        """Refuse values by path that do not go together, each of which is right by itself.

        Raises:
            RangeError: Less friction at rest than in motion.
        """
        self._numbers.check_together(values)

    # ---------------------------------------------------------------- the pure functions

    def start(self, q: Vector, v: Vector, parameters: Values, dt: float) -> dict[str, Any]:
        """Memory by path at the start of a run, from the true state.

        The drives hold the arm against gravity until the first command arrives, as its brakes did before; that is
        also what a limit of the torque rate starts from.
        """
        n = self.arm.n
        rest = np.zeros(n)
        full = dyn.gravity_torque(self.model, q, self._payload(parameters))
        weight = full - self._compensation(q, rest, parameters)
        memory: dict[str, Any] = {"q": q, "v": v, "tau": weight, "held": weight, "tau_link": full}
        if self.takes == "torque":
            memory |= drive.start(self.actuation, self.arm, weight, parameters)
            memory |= self.drivetrain.start(q, v, full, parameters)
            if self.drivetrain.dry and len(self.drivetrain.rigid) > 1:
                memory["friction_residual"] = 0.0
            memory |= {f"work.{name}": tm.zeros(n) for name in self._work_parts}
            self._check_step(dt / self.substeps)
        taps = self.actuation.taps(dt)
        if taps:
            memory["delay"] = tm.stack([{"torque": weight, "velocity": rest, "position": q}[self.takes]] * taps)
        if self.environment is not None:
            touched = self.environment.start(dyn.pose(self.model, q))
            memory |= {f"environment.{name}": value for name, value in touched.items()}
            memory["t"] = 0.0
            memory["F_ext"], _ = self._touch(q, v, memory, parameters, 0.0, dt / self.substeps)
        if self.sensors.tip is not None:
            memory["a"] = rest
        return memory

    def measure(self, memory: Values, noise: Values, parameters: Values) -> dict[str, Any]:
        """What the sensors give, by measurement: q, v, tau_meas, F_ext, ..."""
        return self.sensors.read(self.model, memory, noise, subtree(parameters, "sensors"))

    def extra(self, before: Values, after: Values) -> dict[str, Any]:
        """What a run records of a tick, besides motion and torques: from memory at the tick and after the first step.

        F_ext and friction_residual are those of that step, work.* what was done until the tick.
        """
        out = {name: after[name] for name in ("F_ext", "friction_residual") if name in after}
        return out | {name: value for name, value in before.items() if name.startswith("work.")}

    def command(self, command: Vector, memory: Values, t: Any) -> dict[str, Any]:
        """Memory after a command came in at time t: the delay line, and what stands at the drives until the next."""
        held, line = delayed(command, memory.get("delay"))
        out = dict(memory)
        if self.environment is not None:
            out["t"] = t
        if line is not None:
            out["delay"] = line
        out["held"] = held
        return out

    def advance(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]:
        """Memory after one step of the integrator, dt long, under what stands at the drives."""
        step = self._torque_step if self.takes == "torque" else self._driven_step
        out = step(memory, parameters, dt)
        if self.sensors.tip is not None:
            out["a"] = (out["v"] - memory["v"]) / dt
        return out

    def _driven_step(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]:
        """Stiff drives: their loop decides the motion, and the torque is what that takes."""
        q, v, wanted = memory["q"], memory["v"], memory["held"]
        omega = parameters["actuation.bandwidth"]
        if self.takes == "velocity":
            v_new = lagged(wanted, v, omega, dt)
            # The exact integral of the exponential approach.
            q_new = q + wanted * dt + (v - wanted) * ((1.0 - tm.exp(-omega * dt)) / omega)
        else:
            # Critically damped: e(t) = (e0 + (v + omega e0) t) exp(-omega t), exact over the step.
            e = -self.arm.difference(wanted, q)  # a continuous joint goes the short way round
            wanted = q - e
            rate = v + omega * e
            decay = tm.exp(-omega * dt)
            q_new = wanted + (e + rate * dt) * decay
            v_new = (rate - omega * (e + rate * dt)) * decay
        a = (v_new - v) / dt
        tau = link = dyn.inverse_dynamics(self.link_model, q, v, a, self._payload(parameters))
        if "plant.rotor_inertia" in parameters:
            tau = tau + parameters["plant.rotor_inertia"] * a
        friction = self.drivetrain.friction
        if friction is not None:
            load: Any = np.zeros(self.arm.n)
            if friction.loaded:
                load = -dyn.bias(self.link_model, q, v, self._payload(parameters))
            tau = tau - friction_torque(self.drivetrain.values(parameters), v, tau, load)
        return {**memory, "q": q_new, "v": v_new, "tau": tau, "tau_link": link}

    def _check_step(self, dt: float) -> None:
        """Refuse steps that are too long for a transmission."""
        if self.drivetrain.compliant:
            assert self.actuation.transmission is not None
            M = dyn.mass_matrix(self.link_model, self.arm.home)
            self.actuation.transmission.check_step(
                self.arm, dt, np.linalg.inv(M), lambda more: f"substeps={more * self.substeps}"
            )

    def _torque_step(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]:
        q, v, t = memory["q"], memory["v"], memory.get("t", 0.0)
        train, out = self.drivetrain, dict(memory)
        q_m, v_m = memory.get("q_motor", q), memory.get("v_motor", v)
        added = self._compensation(q, v, parameters)
        given = drive.driven(self.actuation, self.arm, memory, q_m, v_m, parameters, dt, added)
        out |= given.memory
        out["tau"] = given.tau
        tau = given.tau + added
        force: Any = 0.0
        if self.environment is not None:
            wrench, touched = self._touch(q, v, memory, parameters, t, dt)
            out["F_ext"], out["t"] = wrench, t + dt
            out |= {f"environment.{name}": value for name, value in touched.items()}
            force = dyn.jacobian(self.model, q).T @ wrench
        values, rotor = train.values(parameters), parameters.get("plant.rotor_inertia")
        b, spring = values.viscous, tau
        if self.integrator == "rk4":
            q_new, v_new = self._rk4(q, v, given.tau, memory, parameters, t, dt)
            f: Any = np.zeros(self.arm.n)
            limits = None
        else:
            payload = self._payload(parameters)
            load = force - dyn.bias(self.model, q, v, payload)
            if train.compliant:
                spring = train.spring(q, v, memory, parameters)
            M = dyn.mass_matrix(self.link_model, q, payload)
            rhs = train.merged(tau if b is None else tau - b * v, spring) + load
            for i in train.rigid:
                M[i, i] = M[i, i] + _entry(rotor, i) + dt * _entry(b, i)
            factors = tm.factor_spd(M)
            v_new = v + dt * factors.solve(rhs)
            limits, f, at_rest = None, np.zeros(self.arm.n), np.zeros(self.arm.n)
            if train.dry:
                limits = train.limits(values, memory, parameters, v_m, tau, train.merged(load, -spring))
            if limits is not None and train.rigid:
                stop = None if train.compliant else -(rhs + M @ v / dt)
                stuck = dry_friction(
                    factors, v_new, limits.low, limits.high, memory["friction"], dt,
                    joints=train.rigid, stop=stop, sweeps=self.sweeps,
                )  # fmt: skip
                v_new, f, at_rest = stuck.v, stuck.f, stuck.at_rest
                if "friction_residual" in memory:
                    out["friction_residual"] = stuck.residual
            q_new = q + dt * v_new
            if train.compliant:
                moved = train.rotors(memory, tau, spring, b, limits, rotor, dt)
                f, at_rest = train.merged(f, moved.f), train.merged(at_rest, moved.at_rest)
                out["v_motor"] = train.merged(v_new, moved.v)
                out["q_motor"] = train.merged(q_new, q_m + dt * moved.v)
            if limits is not None:
                out["friction"] = f
                if train.remembers_rest:
                    out["at_rest"] = at_rest
        v_end = out.get("v_motor", v_new)
        lost = tm.zeros(self.arm.n) if b is None else b * v_end
        out["tau_link"] = tau + f - lost  # what of the motor's torque arrives behind the gear
        if rotor is not None:
            out["tau_link"] = out["tau_link"] - rotor * (v_end - v_m) / dt
        out["v"], out["q"] = v_new, q_new
        if self.energy:
            work = work_of_step(
                train, memory, out, (out.get("q_motor", q_new) - q_m, q_new - q),
                tau=tau, given=given.tau, f=f, limits=limits, lost=lost, through=out["tau_link"], spring=spring,
                rotor=rotor, parameters=parameters, electric=given.work, dt=dt,
            )  # fmt: skip
            out |= {f"work.{name}": memory[f"work.{name}"] + work[name] for name in self._work_parts}
        return out

    def _compensation(self, q: Vector, v: Vector, parameters: Values) -> Array:
        """(n,) what the plant adds to a torque command itself, friction apart."""
        return compensation(self.model, Adds.of(self.adds), q, v, self._payload(parameters))

    def _payload(self, parameters: Values) -> PayloadValues:
        return PayloadValues.of(subtree(parameters, "plant.payload"))

    def _touch(
        self, q: Vector, v: Vector, memory: Values, parameters: Values, t: Any, dt: Any
    ) -> tuple[Array, dict[str, Any]]:
        assert self.environment is not None
        before = subtree(memory, "environment")
        wrench, after = self.environment.wrench(
            dyn.pose(self.model, q),
            dyn.twist(self.model, q, v),
            t,
            before,
            subtree(parameters, "environment"),
            dt,
        )
        who = type(self.environment).__name__
        if np.shape(wrench) != (6,):
            raise ShapeError(
                f"{who}.wrench must give shape (6,), force first; got shape {np.shape(wrench)}", name=who
            )
        if set(after) != set(before):
            raise UsageError(
                f"{who}.wrench must give back the memory that {who}.start made, {quoted_list(sorted(before))}; got "
                f"{quoted_list(sorted(after)) or 'none'}",
                name=who,
            )
        return wrench, after

    def _rk4(
        self, q: Vector, v: Vector, tau: Vector, memory: Values, parameters: Values, t: Any, dt: Any
    ) -> tuple[Vector, Vector]:
        payload, rotor = self._payload(parameters), parameters.get("plant.rotor_inertia")

        def rates(q: Vector, v: Vector, t: Any) -> tuple[Vector, Vector]:
            force = tau + self._compensation(q, v, parameters)
            if "plant.friction.viscous" in parameters:
                force = force - parameters["plant.friction.viscous"] * v
            if self.environment is not None:
                wrench, _ = self._touch(q, v, memory, parameters, t, dt)
                force = force + dyn.jacobian(self.model, q).T @ wrench
            return v, dyn.forward_dynamics(self.link_model, q, v, force, payload, damping=rotor)

        half = 0.5 * dt
        v1, a1 = rates(q, v, t)
        v2, a2 = rates(q + half * v1, v + half * a1, t + half)
        v3, a3 = rates(q + half * v2, v + half * a2, t + half)
        v4, a4 = rates(q + dt * v3, v + dt * a3, t + dt)
        sixth = dt / 6.0
        return q + sixth * (v1 + 2.0 * (v2 + v3) + v4), v + sixth * (a1 + 2.0 * (a2 + a3) + a4)


def _entry(value: Any, i: int) -> Any:
    """Of a scalar or of one number per joint; nothing is zero."""
    if value is None:
        return 0.0
    return value[i] if np.ndim(value) else value
