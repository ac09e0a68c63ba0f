"""RigidPlant: a rigid arm with drives, friction, sensors and an environment, as pure functions.

It runs on floats, is fused with a controller into one native loop, and is differentiated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np

from taut.arm.description import Arm, CommandKind, Payload
from taut.base.checks import one_of, whole_number
from taut.base.errors import UsageError
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.maths import dynamics as dyn
from taut.maths.constraints.constraint import Constraint
from taut.maths.model import Adds, Model, model_of
from taut.maths.snapshot import Snapshot
from taut.plant.actuation import OF_DRIVES, Actuation, delayed
from taut.plant.contact import Contacts, RigidContact, each_contact
from taut.plant.contact_step import REPORTED, contact_start
from taut.plant.drivetrain import FrictionLaw
from taut.plant.environments.environment import Environment
from taut.plant.motion import WORK_OF_IT, Motion, payload_of
from taut.plant.parts import PlantParts, Steps
from taut.plant.sensors import Sensors
from taut.trace import math as tm

Integrator = Literal["semi-implicit-euler", "rk4"]
INTEGRATORS: Final[tuple[Integrator, ...]] = ("semi-implicit-euler", "rk4")
Values = Mapping[str, Any]
MAX_SUBSTEPS: Final = 1000


@dataclass(frozen=True, eq=False)
class RigidPlant:
    """A rigid arm in free space, touching an environment at its tool, or held by rigid contacts.

    Model:
        (M + rotors) a + C v + g + b v + friction = tau + J^T F_ext
        semi-implicit Euler: v+ = v + dt a with b v taken at v+, q+ = q + dt v+; dry friction really sticks, and
        depends on speed and load as they are when a step begins.
        rk4: fourth order in smooth motion; dry friction and elastic transmissions are refused.
        A joint with elasticity or backlash has a motor that moves by itself: see taut.drives.Transmission.

    Frames:
        F_ext is the wrench of the environment on the arm, force first, in world axes at the tool's origin. Like the
        joint torques, the sensor gives that of the last step of the integrator; a run records that of the next one.

    Args:
        arm: The true arm; make it differ from the controller's and there is a modelling error.
        friction: "arm" for the arm's own (`arm.with_friction`), None for none, or a `taut.drives.FrictionLaw`.
        integrator: "semi-implicit-euler" or "rk4".
        substeps: Steps of the integrator in one control period.
        takes: The command: "torque", "mit", "velocity" or "position". "mit" is for motors that make their torque of
            a `taut.laws.MitCommand` by themselves, in every step of the integrator or at
            `actuation=Actuation(inner_rate=...)`. The last two are stiff drives, which need
            `actuation=Actuation(bandwidth=...)`.
        actuation: The drives: delay, amplifier, motor, gear; ideal if left out.
        sensors: What is measured, and how well; ideal sensors if left out.
        environment: What touches the tool, if anything: a taut.environments.Spring, StiffWall, ..., or a class of
            your own, see `taut.environments.Environment`. The wrench is then measured too, and the run's column
            work.environment [J] is its work on the arm. Stiff drives do not give way to it.
        contact: What holds the arm rigidly, or stops it: a taut.RigidContact, a bare taut.Constraint, or several in a
            tuple. See `taut.RigidContact` for the physics and the columns.
        adds: What the plant adds to a torque command itself: "gravity", "coriolis", and "friction", which cancels the
            arm's own, so that none is left.
        energy: Keep account of the work of each part of the drives: columns work.motor, work.dry, ... [J], see
            `taut.plant.motion`.
        link_payloads: Give each link a payload too, plant.payload.links (n, 10): what it has beyond the arm's, by its
            ten inertial parameters about its joint. Zero at first; for many true arms in one compiled loop.

    Raises:
        UsageError, ShapeError: Options that do not go together, or are of another kind or size.
    """

    arm: Arm
    friction: Literal["arm"] | FrictionLaw | None = "arm"
    _: KW_ONLY
    integrator: Integrator = "semi-implicit-euler"
    substeps: int = 1
    takes: CommandKind = "torque"
    actuation: Actuation = field(default_factory=Actuation)
    sensors: Sensors = field(default_factory=Sensors)
    environment: Environment | None = None
    contact: RigidContact | Constraint | Sequence[RigidContact | Constraint] | None = None
    adds: Adds | Iterable[str] | Mapping[str, Payload | None] = ()
    energy: bool = False
    link_payloads: bool = False

    def __post_init__(self) -> None:
        one_of("integrator", self.integrator, INTEGRATORS)
        whole_number("substeps", self.substeps, minimum=1, maximum=MAX_SUBSTEPS)
        if not isinstance(self.energy, bool):
            raise UsageError(f"energy must be True or False; got {self.energy!r}", name="energy")
        object.__setattr__(self, "adds", Adds.of(self.adds))
        self.parts  # noqa: B018  (checked when they are put together)
        if self.energy and (self.integrator == "rk4" or self.parts.stiff):
            raise UsageError("energy is for torque commands, and for integrator semi-implicit-euler", name="energy")

    @cached_property
    def parts(self) -> PlantParts:
        """What it is made of."""
        contact = None if self.contact is None else Contacts(arm=self.arm, parts=each_contact(self.contact))
        return PlantParts(
            name=f"RigidPlant({getattr(self.arm, 'name', '')})",
            arm=self.arm,
            friction=self.friction,
            takes=self.takes,
            adds=Adds.of(self.adds),
            actuation=self.actuation,
            sensors=self.sensors,
            environment=self.environment,
            contacts=contact,
            smooth=self.integrator == "rk4",
            link_payloads=self.link_payloads,
        )

    @property
    def contacts(self) -> Contacts | None:
        """What holds the arm rigidly, in one order of rows."""
        return self.parts.contacts

    def like(self, *, arm: Arm | None = None, sensors: Sensors | None = None) -> RigidPlant:
        """A plant of the same arguments but these."""
        return dataclasses.replace(self, arm=arm or self.arm, sensors=sensors or self.sensors)

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return self.parts.name

    @cached_property
    def measures(self) -> frozenset[str]:
        """What it measures besides positions."""
        return self.sensors.measures(touched=self.parts.touched)

    @cached_property
    def distorts(self) -> frozenset[str]:
        """The measurements that differ from the truth."""
        return self.sensors.distorts(touched=self.parts.touched)

    @cached_property
    def noise(self) -> dict[str, tuple[int, ...]]:
        """Standard normal numbers that it needs in every tick, by name."""
        return self.sensors.noise(self.arm, touched=self.parts.touched)

    @property
    def model(self) -> Model:
        """The constants of the true arm."""
        return model_of(self.arm)

    @cached_property
    def _motion(self) -> Motion:
        return Motion(parts=self.parts, energy=self.energy)

    @property
    def parameters(self) -> Mapping[str, Float64Array]:
        """Run-time parameters by path: plant.payload.mass, actuation.bandwidth, ..."""
        return self.parts.values

    def checked_parameter(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value of a parameter, checked and in its shape. Raises UnknownNameError, ShapeError, RangeError."""
        return self.parts.checked(path, value)

    def check_together(self, values: Mapping[str, ArrayLike]) -> None:
        """RangeError for values by path that do not go together: less friction at rest than in motion."""
        self.parts.check_together(values)

    def start(self, q: Vector, v: Vector, parameters: Values, dt: float) -> dict[str, Any]:
        """Memory by path at the start of a run, from the true state.

        Until the first command the drives carry gravity; a limit of the torque rate starts from there.
        """
        n = self.arm.n
        rest = np.zeros(n)
        full = dyn.gravity_torque(self.model, q, payload_of(parameters))
        weight = full - self._motion.compensation(q, rest, parameters)
        memory: dict[str, Any] = {"q": q, "v": v, "tau": weight, "tau_link": full}
        memory["held"] = held = self.parts.held_at_start(q, weight)
        train, steps = self.parts.drivetrain, Steps(dt, self.substeps)
        if not self.parts.stiff:
            memory |= self.actuation.start(self.arm, q, weight, parameters)
            memory |= train.start(q, v, full, parameters)
            if train.dry and len(train.rigid) > 1:
                memory["friction_residual"] = 0.0
            memory |= {f"work.{name}": tm.zeros(n) for name in self._motion.work}
            self.parts.require_short_steps(parameters, steps)
        taps = self.actuation.taps(dt)
        if taps:
            memory["delay"] = tm.stack([{"velocity": rest, "position": q}.get(self.takes, held)] * taps)
        if self.environment is not None:
            touched = self.environment.start(dyn.pose(self.model, q))
            memory |= {f"environment.{name}": value for name, value in touched.items()}
            memory |= {"t": 0.0, WORK_OF_IT: 0.0}
            self.parts.require_short_contact(q, parameters, steps)
            memory["F_ext"], _ = self._motion.touch(q, v, memory, parameters, 0.0, steps.dt)
        if self.contacts is not None:
            memory |= self._touching(q, v, memory)
        if self.sensors.needs_acceleration:
            memory["a"] = rest
        return memory

    def _touching(self, q: Vector, v: Vector, memory: Values) -> dict[str, Any]:
        """Memory of rigid contacts at the start of a run."""
        assert self.contacts is not None
        self.contacts.check_start(q, v)
        x = Snapshot(self.model, q=q, v=v)
        out = contact_start(self.contacts, x, load="friction" in memory)
        if "t" not in memory:
            out |= {"t": 0.0, WORK_OF_IT: 0.0}
        if self.parts.touched and "F_ext" not in memory:
            out["F_ext"] = tm.zeros(6)
        return out

    def measure(self, memory: Values, noise: Values, parameters: Values) -> dict[str, Any]:
        """What the sensors give, by measurement: q, v, tau_meas, F_ext, ..."""
        true = {**memory, **{f"payload.{name}": x for name, x in subtree(parameters, "plant.payload").items()}}
        return self.sensors.read(self.model, true, noise, subtree(parameters, "sensors"))

    def extra(self, before: Values, after: Values) -> dict[str, Any]:
        """What a run records of a tick, besides motion and torques: from memory at the tick and after the first step.

        F_ext, friction_residual, contact.* and what drives report are those of that step, work.* is until the tick.
        """
        reported = ("F_ext", "friction_residual", *(f"contact.{name}" for name in REPORTED))
        out = {name: after[name] for name in after if name in reported or name.startswith(OF_DRIVES)}
        return out | {name: value for name, value in before.items() if name.startswith("work.")}

    def command(self, command: Vector, memory: Values, t: Any) -> dict[str, Any]:
        """Memory after a command came in at time t: the delay line, and what stands at the drives until the next."""
        held, line = delayed(command, memory.get("delay"))
        out = dict(memory)
        if "t" in memory:
            out["t"] = t
        if line is not None:
            out["delay"] = line
        out["held"] = held
        return out

    def advance(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]:
        """Memory after one step of the integrator, dt long, under what stands at the drives."""
        out = self._motion.step(memory, parameters, dt)
        if self.sensors.needs_acceleration:
            out["a"] = (out["v"] - memory["v"]) / dt
        return out
