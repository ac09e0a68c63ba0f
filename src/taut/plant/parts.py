"""What the plants of taut are made of: options checked together, and the run-time parameters by path."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from taut.arm.description import COMMANDS, Arm, CommandKind
from taut.arm.friction import AT_REST, check_at_rest
from taut.arm.parts import checked_payload_entry
from taut.base.checks import finite_array, in_compiled_shape, read_only, require_range
from taut.base.errors import RangeError, ShapeError, UsageError, unknown_name
from taut.base.fields import Choice, Declared, Part, Plain
from taut.base.paths import PlantParameters, flatten, subtree
from taut.base.types import ArrayLike, Float64Array
from taut.maths.dynamics import jacobian, mass_matrix
from taut.maths.model import Adds, PayloadValues, links_of
from taut.plant.actuation import Actuation
from taut.plant.contact import Contacts
from taut.plant.drivetrain import Drivetrain, FrictionLaw, require_rotors
from taut.plant.environments.environment import Environment, require_environment
from taut.plant.sensors import Sensors
from taut.trace import math as tm
from taut.trace.scalar import active_graph

Values = Mapping[str, Any]

STIFFNESS: Final = "actuation.transmission.stiffness"  # which is infinite for a joint that is rigid
ROTOR: Final = "plant.rotor_inertia"
FRICTION: Final = "plant.friction."
ROUNDING: Final = 1e-9  # [-] of the length of a step
OF_WRENCHES: Final = ((6,), (6, 6))  # one number of these is of the position alone


class Steps(NamedTuple):
    """The steps of an integrator in a control period."""

    period: float  # [s]
    number: int

    @property
    def dt(self) -> float:
        """Length of a step [s]."""
        return self.period / self.number

    def shorter(self, factor: float) -> str:
        """How to take so many times as many steps."""
        count = math.ceil(factor * self.number * (1.0 - ROUNDING))
        return f"steps of {self.period / count:.9g} s (substeps={count}, or the timestep of MuJoCo)"

    def require(self, fast: float, name: str, what: str, instead: str) -> None:
        """RangeError for steps in which something moves by more than its own time: `fast` is their ratio."""
        if fast > 1.0 + ROUNDING:
            raise RangeError(
                f"{what}, too fast for steps of {self.dt:g} s; give the plant {self.shorter(fast)}, or {instead}",
                name=name,
            )


class PlantParts(Declared):
    """A true arm, its drives and sensors, and what touches it.

    Args:
        name: What messages call the plant.
        arm: The arm.
        friction: "arm" for its own, None for none, or a law of the user's.
        takes: The command.
        adds: What the plant adds to it itself.
        actuation: The drives.
        sensors: The sensors.
        environment: What touches the tool.
        contacts: What holds the arm rigidly.
        smooth: Whether the integrator needs smooth forces.
        scene: Whether an engine knows of more that may touch the tool, and moves the arm where drives are stiff.
        link_payloads: Whether each link may carry a payload of its own.

    Raises:
        UsageError, ShapeError: What does not go together, or is of another kind or size.
    """

    name: Plain[str] = Plain(str)
    arm: Part[Arm] = Part(Arm)
    friction: Plain[Any] = Plain(optional=True)
    takes: Choice[CommandKind] = Choice(*COMMANDS, "mit")
    adds: Part[Adds] = Part(Adds)
    actuation: Part[Actuation] = Part(Actuation)
    sensors: Part[Sensors] = Part(Sensors)
    environment: Part[Environment | None] = Part(Environment, optional=True)
    contacts: Part[Contacts | None] = Part(Contacts, optional=True)
    smooth: Plain[bool] = Plain(bool, default=False)
    scene: Plain[bool] = Plain(bool, default=False)
    link_payloads: Plain[bool] = Plain(bool, default=False)

    def check(self) -> None:
        """What goes together."""
        if not isinstance(self.friction, FrictionLaw) and self.friction not in ("arm", None):
            self.refuse(
                "friction",
                f"must be 'arm', None or a taut.drives.FrictionLaw; got {self.friction!r}; another friction is the "
                "arm's: arm.with_friction(...)",
            )
        if self.environment is not None:
            require_environment("environment", self.environment)
        if self.stiff:
            self._check_drives()
        if self.actuation.inner_rate is not None and self.takes != "mit":
            raise UsageError(
                f"actuation.inner_rate is of motors that take 'mit', and this plant takes {self.takes}; leave it out",
                name="inner_rate",
            )
        names = self.arm.joint_names
        self.actuation.check_size(names, "actuation.")
        if self.actuation.motor is not None:
            others = {"inner_rate": self.actuation.inner_rate, "adds": self.adds.names, "rk4": self.smooth}
            there = [name for name in self.actuation.for_torque_only if name != "motor"]
            there += [name for name, value in others.items() if value]
            self.actuation.motor.check_with(self.arm, self.takes, there)
        self.sensors.check_arm(self.arm, touched=self.touched)
        if isinstance(self.friction, FrictionLaw):
            self.friction.check_size(names, FRICTION)
            if self.adds.friction:
                raise UsageError("the plant adds the arm's friction, and has a law of its own; keep one", name="adds")
        require_rotors(self.arm, self.drivetrain.compliant)
        if self.actuation.torque_loop is not None and getattr(self.sensors.torque, "side", "") != "link":
            raise UsageError(
                "actuation.torque_loop reads the torque sensor at the link, behind gear and friction; give the plant "
                "one, sensors.torque, or leave the loop out",
                name="torque_loop",
            )
        if self.contacts is not None:
            self.contacts.check_points()
        if self.smooth:
            self._check_smooth()

    def _check_drives(self) -> None:
        """Drives that take velocities or positions have a bandwidth and a delay, and nothing that is for torques."""
        if self.actuation.bandwidth is None:
            raise UsageError(
                f"a plant that takes {self.takes} needs the bandwidth of its drives, actuation.bandwidth: 50, say",
                name="actuation",
            )
        for_torques = {f"actuation.{name}": True for name in self.actuation.for_torque_only} | {
            "adds": bool(self.adds.names),
            "contact": self.contacts is not None,
            "a friction law of your own": isinstance(self.friction, FrictionLaw),
        }
        for name, there in for_torques.items():
            if there:
                raise UsageError(
                    f"{name} is for torque commands; this plant takes {self.takes}, which its drives follow by "
                    "themselves",
                    name=name,
                )

    def _check_smooth(self) -> None:
        train = self.drivetrain
        sticks = "dry friction" if train.friction is not None and train.friction.dry else "gears that lose power"
        rough = {
            sticks: train.dry,
            "elastic transmissions or backlash": bool(train.compliant),
            "a contact": self.contacts is not None,
        }
        for what, there in rough.items():
            if there:
                raise UsageError(
                    f'integrator="rk4" is for smooth forces, and this plant has {what}; use '
                    'integrator="semi-implicit-euler", or "discrete" of a MujocoPlant',
                    name="integrator",
                )

    @property
    def stiff(self) -> bool:
        """Whether its drives follow a motion, whatever torque it takes."""
        return self.takes in ("velocity", "position")

    def held_at_start(self, q: Any, weight: Any) -> Any:
        """What stands at drives of torques until the first command: they carry the weight (n,)."""
        if self.takes != "mit":
            return weight
        zero, motor = tm.zeros(self.arm.n), self.actuation.motor
        return tm.stack([q, zero, zero if motor is None else zero + motor.kp_at_start, zero, weight])

    @cached_property
    def drivetrain(self) -> Drivetrain:
        """Rotors, friction and transmissions."""
        friction: Any = self.friction
        if friction == "arm":
            friction = None if self.adds.friction else self.arm.friction
        return Drivetrain(arm=self.arm, friction=friction, transmission=self.actuation.transmission)

    @property
    def touched(self) -> bool:
        """Whether a sensor at the wrist has anything to measure."""
        held = self.contacts is not None and self.contacts.measured
        return self.scene or held or self.environment is not None

    @cached_property
    def values(self) -> PlantParameters:
        """Run-time parameters by path, as the plant was made with them: those that are there."""
        payload = self.arm.payload
        plant: dict[str, Any] = {
            "payload": {"mass": np.asarray(payload.mass), "com": payload.com, "inertia": payload.inertia},
            "friction": self.drivetrain.parameters(),
        }
        if self.link_payloads:
            plant["payload"]["links"] = np.zeros((self.arm.n, 10))
        if self.arm.rotor_inertia.any():
            plant["rotor_inertia"] = self.arm.rotor_inertia
        below = {
            "plant": plant,
            "actuation": self.actuation.parameters(),
            "sensors": self.sensors.parameters(),
            "environment": {} if self.environment is None else self.environment.parameters(),
            "contact": {} if self.contacts is None else self.contacts.parameters(),
        }
        values = {path: read_only(value) for path, value in flatten(below).items()}
        return PlantParameters(f"plant '{self.name}'", "parameter", values)

    def checked(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value of a parameter, checked like the first one and in its shape."""
        if path not in self.values:
            raise unknown_name(f"plant '{self.name}'", "parameter", path, self.values)
        shape, new = self.values[path].shape, self._checked(path, value)
        if path.startswith("environment.") and shape in OF_WRENCHES and new.ndim == 0:
            raise ShapeError(f"{path} has shape {shape}; got one number, which is of the position alone", name=path)
        return in_compiled_shape(path, new, shape)

    def _checked(self, path: str, value: ArrayLike) -> Float64Array:
        """By the declaration of what has it."""
        if path.startswith(("plant.payload.", "sensors.wrench.tool.")):
            return checked_payload_entry(path, value)
        head, _, rest = path.partition(".")
        owner = self.contacts if head == "contact" else getattr(self, head, None)
        if path.startswith(FRICTION):
            owner, rest = self.drivetrain.friction, path.removeprefix(FRICTION)
        if isinstance(owner, Declared):
            new = owner.checked_parameter(rest, value, name=path, joints=self.arm.joint_names)
            owner.changed(rest, new, name=path)
            if path == STIFFNESS:
                self._check_kept_apart(new)
            return new
        new = finite_array(path, value)
        if path == f"{FRICTION}stribeck_shape":
            require_range(path, new, above=0.0)
        else:
            require_range(path, new, minimum=0.0, joints=self.arm.joint_names if new.shape == (self.arm.n,) else None)
        if path == ROTOR and new.shape in ((), (self.arm.n,)):
            require_rotors(self.arm, self.drivetrain.compliant, np.broadcast_to(new, (self.arm.n,)))
        return new

    def _check_kept_apart(self, stiffness: Float64Array) -> None:
        """RangeError for another rigid joint than when the plant was made."""
        for i, value in enumerate(np.broadcast_to(stiffness, (self.arm.n,))):
            if np.isinf(value) == (i in self.drivetrain.compliant):
                was = "elastic" if np.isinf(value) else "rigid"
                raise RangeError(
                    f"{STIFFNESS} of joint '{self.arm.joint_names[i]}' got {value:g}, and the plant was made with "
                    f"this joint {was}; make another plant for that, or give one number per joint",
                    name=STIFFNESS,
                    joint=self.arm.joint_names[i],
                    value=float(value),
                )

    @staticmethod
    def check_together(values: Mapping[str, ArrayLike]) -> None:
        """RangeError for values by path that do not go together: less friction at rest than in motion."""
        for at_rest, moving in AT_REST.items():
            rest = values.get(FRICTION + at_rest)
            if rest is not None:
                check_at_rest(rest, values.get(FRICTION + moving, 0.0), at_rest, prefix=FRICTION)

    def require_short_steps(self, parameters: Values, steps: Steps) -> None:
        """RangeError for steps too long for a motor, an inner loop or a transmission, with the arm at home."""
        if active_graph() is not None:  # it is for numbers
            return
        train, actuation = self.drivetrain, self.actuation
        _require_whole_inner_steps(actuation, steps)
        if actuation.motor is None and actuation.torque_loop is None and not train.compliant:
            return
        n, names = train.arm.n, train.arm.joint_names
        p = {path: np.broadcast_to(value, (n,)) for path, value in subtree(parameters, "actuation").items()}
        rotor = np.broadcast_to(parameters.get("plant.rotor_inertia", 0.0), (n,))
        links = mass_matrix(links_of(train.arm), train.arm.home)
        geared = np.diag(np.linalg.inv(links + np.diag(rotor))).copy()  # acceleration per torque of each motor
        for i in train.compliant:
            geared[i] = 1.0 / rotor[i]
        if actuation.motor is not None:
            # Its torque falls with speed, as a damper's does, and is that of the speed when a step begins.
            fast = actuation.motor.braking(train.arm.gear, subtree(p, "motor")) * geared * steps.dt
            i = int(np.argmax(fast))
            steps.require(
                fast[i],
                "motor",
                f"the motor of joint '{names[i]}' loses torque with speed so steeply that its joint answers in "
                f"{steps.dt / max(fast[i], 1e-300):.3g} s",
                "the joint its rotor's inertia, by gears",
            )
            omega = np.sqrt(actuation.motor.stiffness(subtree(p, "motor")) * geared)
            i = int(np.argmax(omega))
            steps.require(
                omega[i] * steps.dt,
                "motor",
                f"the springs of joint '{names[i]}' oscillate at {omega[i]:.3g} rad/s",
                "softer springs",
            )
        if actuation.torque_loop is not None:
            share = 1.0 - rotor * geared  # of the motor's torque that a rigid gear passes on at once
            share[list(train.compliant)] = 0.0
            _require_slow_torque_loop(names, p, share, steps)
        if train.compliant:
            joints = list(train.compliant)
            # A gear that a motor drives passes the rotor's inertia on in its efficiency's measure.
            light = rotor * p.get("transmission.efficiency", 1.0)
            both = (
                1.0 / light[joints] + np.diag(np.linalg.inv(links))[joints]
            )  # acceleration of motor and link per torque
            omega = np.sqrt(p["transmission.stiffness"][joints] * both)
            fast = np.maximum(omega, 2.0 * p["transmission.damping"][joints] * both) * steps.dt
            i = int(np.argmax(fast))
            steps.require(
                fast[i],
                "stiffness",
                f"the transmission of joint '{names[joints[i]]}' oscillates at {omega[i]:.3g} rad/s",
                "a softer spring or less damping",
            )

    def require_short_contact(self, q: Float64Array, parameters: Values, steps: Steps) -> None:
        """RangeError for steps that are too long for a ready-made environment, at the start of a run.

        An oscillation of omega with damping delta, both taken at the beginning of a step, is stable in semi-implicit
        Euler while omega^2 dt^2 + 2 delta dt < 4. Half of that is let through, since the tool's inertia changes.
        """
        assert self.environment is not None
        if active_graph() is not None:  # it is for numbers
            return
        stiff = self.stiff and not self.scene  # drives that nothing moves
        mobility = np.zeros((6, 6)) if stiff else self._mobility(q, parameters)
        omega, damping = self.environment.rates(mobility, subtree(parameters, "environment"))
        a, b = (omega * steps.dt) ** 2, damping * steps.dt
        steps.require(
            0.5 * (b + np.sqrt(b * b + 2.0 * a)),
            "environment",
            f"environment: what touches the tool oscillates at {omega:.3g} rad/s and is damped at {damping:.3g} 1/s",
            "a softer environment",
        )

    def _mobility(self, q: Float64Array, parameters: Values) -> Float64Array:
        """(6, 6) acceleration of the tool per wrench; the rotor of a compliant joint moves by itself."""
        train = self.drivetrain
        n = train.arm.n
        rotor = np.broadcast_to(parameters.get("plant.rotor_inertia", 0.0), (n,))
        model = links_of(train.arm)
        M = mass_matrix(model, q, PayloadValues.of(subtree(parameters, "plant.payload")))
        M = M + np.diag([rotor[i] if i in train.rigid else 0.0 for i in range(n)])
        J = jacobian(model, q)
        mobility: Float64Array = J @ np.linalg.solve(M, J.T)
        return mobility


def _require_whole_inner_steps(actuation: Actuation, steps: Steps) -> None:
    """RangeError unless the period of the motors' loop is a whole part of the controller's, and of whole steps."""
    if actuation.inner_rate is None:
        return
    rate, control, fine = float(actuation.inner_rate), 1.0 / steps.period, 1.0 / steps.dt
    for ratio, rule in (
        (rate / control, f"a whole multiple of the control rate, {control:g} Hz"),
        (fine / rate, f"the rate of the integrator's steps, {fine:g} Hz, divided by a whole number"),
    ):
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * ratio:
            raise RangeError(
                f"actuation.inner_rate must be {rule}; got {rate:g} Hz; change it, or the substeps of the plant",
                name="actuation.inner_rate",
                value=rate,
            )


def _require_slow_torque_loop(names: Sequence[str], p: Values, share: Float64Array, steps: Steps) -> None:
    """RangeError where the torque loop, which reads the torque of the last step, alternates: kp share is too large.

    A lag of left = exp(-omega dt) over a step, and mean = (1 - left) / (omega dt), has a root at -1 for
    kp share (1 + left - 2 mean) = 1 + left; without a lag for kp share = 1.
    """
    kp = p["torque_loop.kp"]
    left, mean = np.zeros_like(kp), np.zeros_like(kp)
    if "bandwidth" in p:
        left = np.exp(-p["bandwidth"] * steps.dt)
        mean = (1.0 - left) / (p["bandwidth"] * steps.dt)
    largest = (1.0 + left) / np.maximum(share * (1.0 + left - 2.0 * mean), 1e-300)
    i = int(np.argmax(kp / largest))
    steps.require(
        kp[i] / largest[i] + ROUNDING,
        "torque_loop",
        f"actuation.torque_loop of joint '{names[i]}' has kp = {kp[i]:.3g}, and must be below {largest[i]:.3g}, "
        "since the loop reads the torque of the step before",
        "the loop a lower kp, or the drive a bandwidth",
    )
