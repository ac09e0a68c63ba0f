"""Loop: sensors -> sensing -> law -> limits -> actuation -> plant, as one pure function.

This is what is fused into native code, swept, linearised and tuned. Every parameter of every stage has a path.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np

from taut.arm.description import Arm, Payload
from taut.arm.parts import require_radians
from taut.base.checks import finite_array, instance_of, positive_scalar, read_only
from taut.base.errors import MatchError, RangeError, ShapeError, UsageError, count_of
from taut.base.fields import unchanging
from taut.base.paths import Parameters, subtree
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.control.combine import SideBySide, all_laws
from taut.control.lawside import LawSide
from taut.control.trajectories.reference import Hold, Reference, as_reference
from taut.maths.dynamics import pose
from taut.maths.model import Adds, model_of
from taut.maths.snapshot import ESTIMATES, MEASUREMENTS
from taut.plant.contact import check_force_feedback
from taut.plant.environments.environment import COMMAND, of_plant
from taut.plant.sensors import Sensors

__all__ = [
    "AnyPlant",
    "Loop",
    "ModelPlant",
    "check_fit",
    "require_no_reference",
    "sensed_of",
]

Values = Mapping[str, Any]
DT: Final = "dt"
PROVIDED_BY: Final[Mapping[str, str]] = {
    "v": "; sensing with the velocity 'difference' needs positions only",
    "F_ext": "; give the plant an environment or a contact, and a sensor of it, sensors.wrench",
    "tau_meas": "; give the plant a torque sensor, sensors.torque",
    "q_motor": "; give the plant encoders at the motors, sensors.motor",
    "v_motor": "; give the plant tachometers at the motors, sensors.motor_velocity",
    "a_tip": "; give the plant an accelerometer, sensors.tip",
}
"""How to provide a measurement, for messages."""
ONE_PLACE: Final = 1e-6  # [m] between the origins of frames that are the same point


class AnyPlant(Protocol):
    """Interface of every plant: a model, a physics engine, or a robot."""

    @property
    def name(self) -> str: ...
    @property
    def arm(self) -> Arm: ...
    @property
    def takes(self) -> str: ...
    @property
    def measures(self) -> frozenset[str]: ...
    @property
    def distorts(self) -> frozenset[str]: ...
    @property
    def adds(self) -> Any: ...
    @property
    def parameters(self) -> Mapping[str, Float64Array]: ...
    def checked_parameter(self, path: str, value: ArrayLike) -> Float64Array: ...
    def check_together(self, values: Mapping[str, ArrayLike]) -> None: ...


@runtime_checkable
class ModelPlant(AnyPlant, Protocol):
    """A plant of pure functions of the loop's parameters by path, so that it can be fused with a controller."""

    @property
    def substeps(self) -> int: ...
    @property
    def noise(self) -> dict[str, tuple[int, ...]]: ...
    def start(self, q: Vector, v: Vector, parameters: Values, dt: float) -> dict[str, Any]: ...
    def measure(self, memory: Values, noise: Values, parameters: Values) -> dict[str, Any]: ...
    def command(self, command: Vector, memory: Values, t: Any) -> dict[str, Any]: ...
    def advance(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]: ...
    def extra(self, before: Values, after: Values) -> dict[str, Any]: ...


@runtime_checkable
class HasSensors(Protocol):
    """A plant whose sensors are those of `taut.plant`."""

    @property
    def sensors(self) -> Sensors: ...


@runtime_checkable
class HasLawSide(Protocol):
    """A controller, as far as a loop needs it."""

    @property
    def side(self) -> LawSide: ...
    @property
    def parameters(self) -> Mapping[str, Float64Array]: ...
    @property
    def engine(self) -> str: ...


def check_fit(side: LawSide, plant: AnyPlant) -> None:
    """MatchError, ShapeError or RangeError for a controller and a plant that do not fit, or unstable contact."""
    law = side.title
    if side.arm.n != plant.arm.n:
        raise ShapeError(
            f"plant '{plant.name}' has {count_of(plant.arm.n, 'joint')} and the controller's arm "
            f"'{side.arm.name}' has {side.arm.n}; both must be the same arm, or the same subset of its joints"
        )
    ours, theirs = (list(zip(arm.joint_names, arm.units, strict=True)) for arm in (side.arm, plant.arm))
    reordered = ours != theirs and sorted(ours) == sorted(theirs)
    if side.arm.units != plant.arm.units or reordered:
        theirs_in_words, ours_in_words = (
            ", ".join(f"{name} [{unit}]" for name, unit in joints) for joints in (theirs, ours)
        )
        raise MatchError(
            f"the joints of plant '{plant.name}' are {theirs_in_words}, and those of the controller's arm "
            f"'{side.arm.name}' are {ours_in_words}; both must be the same arm, with its joints in the same order"
        )
    if side.gives != plant.takes:
        wrapped = ", such as taut.laws.ViaMit(law=law)," if (side.gives, plant.takes) == ("torque", "mit") else ""
        raise MatchError(
            f"{law} gives {side.gives} commands and plant '{plant.name}' takes {plant.takes} commands; choose a law "
            f"for those,{wrapped[1:]} or a plant that takes '{side.gives}'",
            name="takes",
        )
    for name in side.needs:
        if name not in plant.measures:
            raise MatchError(
                f"{law} needs {name}, which plant '{plant.name}' does not measure; it measures "
                f"{', '.join(sorted(plant.measures)) or 'positions only'}{PROVIDED_BY.get(name, '')}",
                name=name,
            )
    _check_tool(side, plant)
    check_force_feedback(side, plant)
    _check_weight(side, plant)
    _check_adds(side, plant)
    for path, held in all_laws(side.law, "law"):
        if isinstance(held, SideBySide):  # each part knows some joints alone
            break
        held.check_plant(path, side.arm, plant.name, plant.parameters)


def require_no_reference(side: LawSide, ref: object) -> None:
    """UsageError for a reference beside those of the phases of a task."""
    if side.task is not None and ref is not None:
        raise UsageError(
            "each phase of a task has its own reference, as in taut.Phase(law, reference); leave ref out", name="ref"
        )


def sensed_of(side: LawSide, plant: AnyPlant) -> tuple[str, ...]:
    """The law's measurements that a run records as the law saw them: those that differ from the truth or lack it."""
    altered = side.sensing.alters | plant.distorts | {"q_motor", "v_motor", "a_tip"}
    used, always = side.probe.used, {"q", *ESTIMATES}
    names = ("q", "v", *MEASUREMENTS, *ESTIMATES)
    return tuple(name for name in names if name in altered and (name in always or name in used))


def _check_tool(side: LawSide, plant: AnyPlant) -> None:
    """MatchError for a wrench measured away from the controller's tool; tools of one name may differ in pose."""
    ours, theirs = side.arm, plant.arm
    if "F_ext" not in side.needs or ours.tool == theirs.tool:
        return
    apart = float(np.linalg.norm(pose(model_of(ours), ours.home).p - pose(model_of(theirs), ours.home).p))
    if apart > ONE_PLACE:
        raise MatchError(
            f"the controller takes F_ext for the wrench at its tool '{ours.tool}', and plant '{plant.name}' measures "
            f"it at '{theirs.tool}', {apart:.3g} m away at home; load both arms with the same tool=, and name "
            "another frame to control in the law, by its own tool=",
            name="tool",
            value=theirs.tool,
        )


def _check_weight(side: LawSide, plant: AnyPlant) -> None:
    """A weight is taken out of a wrench in which it is; of a plant that does not say, it is taken to be."""
    wrist = side.sensing.wrist
    if wrist is None or wrist.mass is None or not isinstance(plant, HasSensors) or plant.sensors.weighs:
        return
    raise MatchError(
        "the controller's sensing takes the weight of tool and payload out of F_ext, and the wrench sensor of plant "
        f"'{plant.name}' reads no weight; give it its tool, sensors.wrench.tool, or leave the mass out of "
        "sensing.wrist",
        name="wrist",
    )


def _check_adds(side: LawSide, plant: AnyPlant) -> None:
    """MatchError unless the law, and limits of rate and speed, leave out exactly what the plant adds."""
    added, left_out, used, counted = Adds.of(plant.adds), side.adds, side.probe.used, set[str]()
    if side.probe.kind == "torque":
        brakes = "limits.v_gain" in side.parameters
        counted |= {"gravity"} if brakes or "limits.tau_applied" in side.probe.shapes else set()
        counted |= {"coriolis"} if brakes else set()
    observed = set() if side.sensing.observer is None else side.sensing.observer.counts_on(side.arm)
    for what in ("gravity", "coriolis", "friction"):
        if what not in used | counted | observed or (what in left_out.names) == (what in added.names):
            continue
        if what in left_out.names:
            raise MatchError(
                f"the controller was compiled to leave {what} to the plant, and plant '{plant.name}' does not add "
                "it; compile with adds=plant.adds",
                name=what,
            )
        why = f", and the controller's {'observer assumes' if what in observed else 'limits assume'} that it does not"
        why = f" and the law {side.title} adds it too" if what in used else why
        law = " use a law that does not add it," if what in used else ""
        raise MatchError(
            f"plant '{plant.name}' adds {what} itself{why}; compile with adds=plant.adds,{law} or a plant with "
            "adds=()",
            name=what,
        )
    if left_out.gravity and added.gravity and "gravity" in used and not _same(left_out.load, added.load):
        raise MatchError(
            f"plant '{plant.name}' compensates the gravity of another payload than the controller assumes; "
            "compile with adds=plant.adds",
            name="gravity",
        )


def _same(a: Payload | None, b: Payload | None) -> bool:
    if a is None or b is None:
        return a is b
    return a.mass == b.mass and np.array_equal(a.com, b.com) and np.array_equal(a.inertia, b.inertia)


class Kept:
    """What is made of a loop once, and kept: its code, the judgement of its start, and the rows of its reference."""

    code: Any = None
    verdict: Any = None
    rows: Any = None

    def __reduce__(self) -> tuple[type[Kept], tuple[()]]:
        return Kept, ()  # code is of its process


# Of each law side with the last plant: a loop of the same two, run after run, is not traced again. What is kept must
# not hold the side itself, which would never be released.
_KEPT: Final[WeakKeyDictionary[LawSide, tuple[ModelPlant, str, Kept]]] = WeakKeyDictionary()


def _kept(side: LawSide, plant: ModelPlant, engine: str) -> Kept:
    """What loops of a side and a plant have in common, where neither can change."""
    last = _KEPT.get(side)
    if last is None or last[0] is not plant or last[1] != engine:
        if not (unchanging(plant) and unchanging(side)):
            return Kept()
        last = _KEPT[side] = plant, engine, Kept()
    return last[2]


class Loop:
    """A closed loop: a controller and a model plant that follow a reference for a while.

    It starts with copies of the parameters that controller and plant have when it is made; `loop.parameters` changes
    them from then on.

    Args:
        ctrl: A controller from `taut.compile`.
        plant: A model plant such as `taut.RigidPlant`.
        ref: A sample, hold, trajectory, stream or chunk; a hold of the first state if left out.
        duration: Length of the run [s].

    Raises:
        UsageError: Not a controller, or not a model plant.
        MatchError: Controller and plant do not fit.
        RangeError: A duration that is not positive.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.PID(kp=2.205, kd=2.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.0]), duration=1.0)
        >>> loop.parameters["plant.payload.mass"] = 0.5
        >>> sorted(loop.parameters)[:3]
        ['law.kd', 'law.ki', 'law.kp']
    """

    def __init__(self, ctrl: HasLawSide, plant: ModelPlant, ref: object = None, *, duration: float) -> None:
        instance_of("ctrl", ctrl, HasLawSide, "a controller from taut.compile")
        if not isinstance(plant, ModelPlant):
            raise UsageError(
                f"a Loop takes a model plant such as taut.RigidPlant(arm); got {type(plant).__name__}; taut.run "
                "takes other plants too",
                name="plant",
            )
        self.side = ctrl.side
        self.engine: Literal["native", "float"] = "native" if ctrl.engine == "native" else "float"
        self.plant = plant
        check_fit(self.side, plant)
        require_no_reference(self.side, ref)
        self.ref: Reference
        self.ref, self.duration = ref, duration  # type: ignore[assignment]
        values = {**ctrl.parameters, **plant.parameters}
        names = {**self.side.parameters, **plant.parameters}  # in one order: code that is kept reads them by place
        self.parameters = LoopParameters(self.side, plant, {name: values[name] for name in names})
        self.kept = _kept(self.side, plant, self.engine)

    def __setattr__(self, name: str, value: object) -> None:
        if name == "ref":
            value = Hold() if value is None else as_reference(value)
        elif name == "duration":
            value = duration_of_ticks(value, self.side.dt)
        elif name in vars(self):
            raise UsageError(
                f"a Loop keeps its {name}; make another one, taut.Loop(ctrl, plant, ref, duration=...); numbers "
                "change by path, loop.parameters['plant.payload.mass'] = 1.0",
                name=name,
            )
        super().__setattr__(name, value)

    @property
    def dt(self) -> float:
        """Control period [s]."""
        return self.side.dt

    @property
    def ticks(self) -> int:
        """Number of control ticks, both ends included."""
        return round(self.duration * self.side.rate) + 1

    def input_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the inputs of each tick, by path: time, the reference, noise."""
        reference = self.side.law.reference.fields(self.side.arm.n)
        shapes: dict[str, tuple[int, ...]] = {"t": ()}
        shapes |= {f"ref.{name}": shape for name, shape in reference.items()}
        return shapes | {f"noise.{name}": shape for name, shape in self.plant.noise.items()}

    def parameter_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of all parameters and of the period, by path."""
        return {path: value.shape for path, value in self.parameters.items()} | {DT: ()}

    def start(self, q: Vector, v: Vector, inputs: Values, parameters: Values) -> dict[str, Any]:
        """Memory by path in the first tick: of the plant at its true state, and of the law side."""
        memory = self.plant_at_start(q, v, parameters)
        law = self.side.start(self.measured(memory, inputs, parameters), self._sample(inputs), parameters)
        return {f"plant.{path}": value for path, value in memory.items()} | law

    def plant_at_start(self, q: Vector, v: Vector, parameters: Values) -> dict[str, Any]:
        """The plant's memory by path in the first tick, from its true state."""
        return self.plant.start(q, v, parameters, self.dt)

    def measured(self, plant: Values, inputs: Values, parameters: Values) -> dict[str, Any]:
        """Readings of the sensors in a tick, from the plant's memory, and the time."""
        return {**self.plant.measure(plant, subtree(inputs, "noise"), parameters), "t": inputs["t"]}

    def step(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        """One control period: (what is recorded, memory after it). Inputs may have disturbances too."""
        dt, plant = parameters[DT], subtree(memory, "plant")
        measured = self.measured(plant, inputs, parameters)
        law = {path: value for path, value in memory.items() if not path.startswith("plant.")}
        tick = self.side.tick(measured, self._sample(inputs), law, parameters, dt)
        command = tick.pushed(inputs[COMMAND]) if COMMAND in inputs else tick.sent
        plant = self.plant.command(command, plant, inputs["t"])
        plant = self.plant.advance(plant, {**parameters, **of_plant(inputs)}, dt / self.plant.substeps)
        before = subtree(memory, "plant")
        record = {"q": before["q"], "v": before["v"], "command": tick.command, "tau": plant["tau"]}
        record |= {} if tick.mit is None else {"mit": tick.mit}
        record |= self.plant.extra(before, plant)
        record |= {name: value for name, value in measured.items() if name.startswith("saturated.")}
        record |= {name: tick.seen[name] for name in self.side.sensing.tells if name not in record}
        record |= {f"sensed.{name}": tick.seen[name] for name in sensed_of(self.side, self.plant)}
        record |= {f"terms.{name}": value for name, value in tick.terms.items()}
        record |= {column: tick.memory[path] for column, path in self.side.recorded.items()}
        return record, {f"plant.{path}": value for path, value in plant.items()} | tick.memory

    def substep(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        """One further step of the integrator in the same control period."""
        dt = parameters[DT] / self.plant.substeps
        plant = self.plant.advance(subtree(memory, "plant"), {**parameters, **of_plant(inputs)}, dt)
        return {}, {**memory, **{f"plant.{path}": value for path, value in plant.items()}}

    def _sample(self, inputs: Values) -> Any:
        return self.side.law.reference.of(subtree(inputs, "ref"))


class LoopParameters(Parameters):
    """Parameters of a loop by path; a new value is checked like the first one."""

    def __init__(self, side: LawSide, plant: AnyPlant, values: Mapping[str, Float64Array]) -> None:
        super().__init__("the loop", {path: read_only(value) for path, value in values.items()})
        self._side, self._plant = side, plant

    def __setitem__(self, path: str, value: ArrayLike) -> None:
        new = self.checked(path, value)
        self._plant.check_together({**self._values, path: new})
        self._values[path] = new

    def checked(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value of a parameter, in the shape it has, finite and not negative."""
        owner = self._side if self._known(path) in self._side.parameters else self._plant
        return read_only(owner.checked_parameter(path, value))


def duration_of_ticks(duration: object, dt: float) -> float:
    """The length of a run [s]: one control period dt at least, so that something can happen."""
    length = positive_scalar("duration", duration, unit="s")
    if length < (1.0 - 1e-9) * dt:
        raise RangeError(
            f"duration must be >= {dt:g} [s], one control period; got {length:g}",
            name="duration",
            value=length,
            rule=f">= {dt:g}",
        )
    return length


def state_at_start(arm: Arm, q0: ArrayLike | None, v0: ArrayLike | None) -> tuple[Float64Array, Float64Array]:
    """The true state at the start of a run, checked: home and at rest by default."""
    names = arm.joint_names
    q = arm.home if q0 is None else finite_array("q0", q0, shape=(arm.n,), joints=names, unit="rad | m")
    require_radians("q0", q, arm)
    v = np.zeros(arm.n) if v0 is None else finite_array("v0", v0, shape=(arm.n,), joints=names, unit="rad/s | m/s")
    return q, v
