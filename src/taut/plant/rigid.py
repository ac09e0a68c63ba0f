"""RigidPlant: a rigid arm with drives, friction, sensors and an environment, as pure functions.

Written like a law, so that it runs on floats, is fused with a controller into one native loop, and differentiated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np

from taut.arm.description import COMMANDS, Arm, CommandKind, Payload
from taut.base import math as tm
from taut.base.checks import finite_array, one_of, require_at_least, require_positive
from taut.base.errors import RangeError, ShapeError, UsageError, quoted_list, unknown_name
from taut.base.paths import flatten, subtree
from taut.base.types import Array, ArrayLike, Float64Array, Vector
from taut.control.lawside import checked_payload_entry
from taut.maths import dynamics as dyn
from taut.maths.adds import Adds
from taut.maths.friction import dry_friction
from taut.maths.model import Model, PayloadValues, model_of
from taut.plant.actuation import Actuation, delayed, lagged, mean_lagged
from taut.plant.environment import Environment
from taut.plant.sensors import Sensors

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
        semi-implicit Euler: v+ = v + dt a with b v taken at v+, q+ = q + dt v+; dry friction really sticks.
        rk4: fourth order in smooth motion; dry friction is refused.

    Frames:
        F_ext is the wrench of the environment on the arm, force first, in world axes at the tool's origin. Like the
        joint torques, what the sensor gives in a tick is that of the last step of the integrator; a run records
        what acted in the step that follows the tick.

    Args:
        arm: The true arm; make it differ from the controller's and there is a modelling error.
        friction: "arm" for the arm's own viscous and dry friction, None for none.
        integrator: "semi-implicit-euler" or "rk4".
        substeps: Steps of the integrator in one control period.
        takes: The command: "torque", "velocity" or "position". The last two are stiff drives, which need
            `actuation=Actuation(bandwidth=...)`.
        actuation: Bandwidth and delay of the drives.
        sensors: What is measured, and how well; ideal sensors if left out.
        environment: What touches the tool, if anything; then the wrench is measured too.
        adds: What the plant adds to a torque command itself: "gravity", "coriolis", and "friction", which cancels the
            arm's own, so that none is left.

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

    def __post_init__(self) -> None:
        if not isinstance(self.arm, Arm):
            raise UsageError(f"a plant takes an Arm from taut.load_arm; got {type(self.arm).__name__}", name="arm")
        one_of("integrator", self.integrator, INTEGRATORS)
        one_of("takes", self.takes, COMMANDS)
        if self.friction not in ("arm", None):
            raise UsageError(f"friction must be 'arm' or None; got {self.friction!r}", name="friction")
        if isinstance(self.substeps, bool) or not isinstance(self.substeps, int):
            raise UsageError(f"substeps must be a whole number; got {self.substeps!r}", name="substeps")
        if not 1 <= self.substeps <= MOST_SUBSTEPS:
            raise RangeError(f"substeps must be between 1 and {MOST_SUBSTEPS}; got {self.substeps}", name="substeps")
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
        if self.integrator == "rk4" and self._dry:
            raise UsageError(
                f"rk4 needs smooth forces, and arm '{self.arm.name}' has dry friction; use semi-implicit-euler, "
                "or friction=None",
                name="integrator",
            )
        if self.takes != "torque":
            if self.actuation.bandwidth is None:
                raise UsageError(
                    f"a plant that takes {self.takes} needs the bandwidth of its drives: "
                    "actuation=taut.Actuation(bandwidth=50.0)  # rad/s",
                    name="actuation",
                )
            if adds.names:
                raise UsageError(f"adds is for torque commands; this plant takes {self.takes}", name="adds")
            if self.environment is not None:
                raise UsageError(
                    f"a plant that takes {self.takes} has stiff drives, which an environment cannot move; "
                    "leave environment out",
                    name="environment",
                )

    @property
    def _lags(self) -> bool:
        return self.takes == "torque" and self.actuation.bandwidth is not None

    @property
    def _left(self) -> bool:
        """Whether any friction is left."""
        return self.friction == "arm" and not Adds.of(self.adds).friction

    @property
    def _dry(self) -> bool:
        return self._left and bool(self.arm.coulomb.any())

    @property
    def _viscous(self) -> bool:
        return self._left and bool(self.arm.viscous.any())

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

    @property
    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by path: plant.payload.mass, actuation.bandwidth, ..."""
        payload, friction = self.arm.payload, {}
        if self._viscous:
            friction["viscous"] = self.arm.viscous
        if self._dry:
            friction["coulomb"] = self.arm.coulomb
        load = {"mass": np.asarray(payload.mass), "com": payload.com, "inertia": payload.inertia}
        out: dict[str, Any] = {"plant": {"payload": load, "friction": friction}}
        out["actuation"] = self.actuation.parameters()
        out["sensors"] = self.sensors.parameters()
        if self.environment is not None:
            out["environment"] = self.environment.parameters()
        return flatten(out)

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
        if path.startswith("plant.payload."):
            return checked_payload_entry(path, value)
        if path.startswith("sensors."):
            return self.sensors.checked_parameter(path, value, self.arm)
        shape, new = known[path].shape, finite_array(path, value)
        if new.shape not in ((), shape):
            raise ShapeError(
                f"{path} has shape {shape}; got shape {new.shape}; make the plant with a value of the new shape",
                name=path,
            )
        if path == "actuation.bandwidth":
            require_positive(path, new, unit="rad/s")
        elif not path.startswith("environment."):
            joints = self.arm.joint_names if shape == (self.arm.n,) else None
            require_at_least(path, new, 0.0, joints=joints)
        return np.broadcast_to(new, shape)

    # ---------------------------------------------------------------- the pure functions

    def start(self, q: Vector, v: Vector, parameters: Values, dt: float) -> dict[str, Any]:
        """Memory by path at the start of a run, from the true state.

        The drives hold the arm against gravity until the first command arrives, as its brakes did before; that is
        also what a limit of the torque rate starts from.
        """
        n = self.arm.n
        rest = np.zeros(n)
        weight = dyn.gravity_torque(self.model, q, self._payload(parameters))
        weight = weight - self._compensation(q, rest, parameters)
        memory: dict[str, Any] = {"q": q, "v": v, "tau": weight, "held": weight}
        if self._lags:
            memory["motor"] = weight
        if self._dry:
            memory["friction"] = tm.zeros(n)
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
        tau = dyn.inverse_dynamics(self.model, q, v, a, self._payload(parameters))
        if self._viscous:
            tau = tau + parameters["plant.friction.viscous"] * v
        if self._dry:
            tau = tau + parameters["plant.friction.coulomb"] * tm.sign(v)
        return {**memory, "q": q_new, "v": v_new, "tau": tau}

    def _torque_step(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]:
        q, v, t = memory["q"], memory["v"], memory.get("t", 0.0)
        payload = self._payload(parameters)
        out = dict(memory)
        tau = memory["held"]
        if self._lags:
            tau, out["motor"] = mean_lagged(tau, memory["motor"], parameters["actuation.bandwidth"], dt)
        out["tau"] = tau
        if self.environment is not None:
            wrench, touched = self._touch(q, v, memory, parameters, t, dt)
            out["F_ext"], out["t"] = wrench, t + dt
            out |= {f"environment.{name}": value for name, value in touched.items()}
        if self.integrator == "rk4":
            out["q"], out["v"] = self._rk4(q, v, tau, memory, parameters, t, dt)
            return out
        tau = tau + self._compensation(q, v, parameters)
        if self.environment is not None:
            tau = tau + dyn.jacobian(self.model, q).T @ out["F_ext"]
        M = dyn.mass_matrix(self.model, q, payload)
        rhs = tau - dyn.bias(self.model, q, v, payload)
        if self._viscous:
            b = parameters["plant.friction.viscous"]
            rhs = rhs - b * v
            for i in range(self.arm.n):
                M[i, i] = M[i, i] + dt * b[i]
        factors = tm.factor_spd(M)
        v_new = v + dt * factors.solve(rhs)
        if self._dry:
            stop = -(rhs + M @ v / dt)
            v_new, out["friction"] = dry_friction(
                factors, v_new, parameters["plant.friction.coulomb"], memory["friction"], stop, dt
            )
        out["v"], out["q"] = v_new, q + dt * v_new
        return out

    def _compensation(self, q: Vector, v: Vector, parameters: Values) -> Array:
        """(n,) what the plant adds to a torque command itself, friction apart."""
        adds = Adds.of(self.adds)
        total: Array = np.zeros(self.arm.n)
        if adds.gravity:
            load = self._payload(parameters)
            if adds.load is not None:
                load = PayloadValues(mass=adds.load.mass, com=adds.load.com, inertia=adds.load.inertia)
            total = total + dyn.gravity_torque(self.model, q, load)
        if adds.coriolis:
            total = total + dyn.bias(self.model, q, v, self._payload(parameters), gravity=False)
        return total

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
        payload = self._payload(parameters)

        def rates(q: Vector, v: Vector, t: Any) -> tuple[Vector, Vector]:
            force = tau + self._compensation(q, v, parameters)
            if self._viscous:
                force = force - parameters["plant.friction.viscous"] * v
            if self.environment is not None:
                wrench, _ = self._touch(q, v, memory, parameters, t, dt)
                force = force + dyn.jacobian(self.model, q).T @ wrench
            return v, dyn.forward_dynamics(self.model, q, v, force, payload)

        half = 0.5 * dt
        v1, a1 = rates(q, v, t)
        v2, a2 = rates(q + half * v1, v + half * a1, t + half)
        v3, a3 = rates(q + half * v2, v + half * a2, t + half)
        v4, a4 = rates(q + dt * v3, v + dt * a3, t + dt)
        sixth = dt / 6.0
        return q + sixth * (v1 + 2.0 * (v2 + v3) + v4), v + sixth * (a1 + 2.0 * (a2 + a3) + a4)
