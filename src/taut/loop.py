"""Loop: sensors -> sensing -> law -> limits -> actuation -> plant, as one pure function.

This is what is fused into native code, swept, linearised and tuned. Every parameter of every stage has a path.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Protocol

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, positive_scalar, require_at_least
from taut.base.errors import MatchError, ShapeError, UsageError, unknown_name
from taut.base.paths import subtree
from taut.base.types import Array, ArrayLike, Float64Array, Vector
from taut.control.lawside import LawSide, checked_payload_entry, in_compiled_shape
from taut.control.reference import Hold, Reference, as_reference
from taut.maths.adds import Adds

__all__ = ["AnyPlant", "Loop", "ModelPlant", "check_fit"]

Values = Mapping[str, Any]
DT: Final = "dt"
STAGES: Final = ("sensors", "actuation", "environment")  # their parameters keep their own names


class AnyPlant(Protocol):
    """What every plant declares: a model, an engine, or a robot."""

    @property
    def name(self) -> str: ...
    @property
    def arm(self) -> Arm: ...
    @property
    def takes(self) -> str: ...
    @property
    def measures(self) -> frozenset[str]: ...
    @property
    def adds(self) -> Any: ...


class ModelPlant(AnyPlant, Protocol):
    """A plant that is a pure function, so that it can be fused with a controller."""

    @property
    def substeps(self) -> int: ...
    @property
    def noise(self) -> dict[str, tuple[int, ...]]: ...
    def parameters(self) -> dict[str, Float64Array]: ...
    def start(self, q: Vector, v: Vector, dt: float) -> dict[str, Any]: ...
    def measure(self, memory: Values, noise: Values, parameters: Values) -> dict[str, Any]: ...
    def command(self, command: Vector, memory: Values, parameters: Values, t: Any, dt: Any) -> dict[str, Any]: ...
    def advance(self, memory: Values, parameters: Values, dt: Any) -> dict[str, Any]: ...


class HasLawSide(Protocol):
    """A controller, as far as a loop needs it."""

    @property
    def side(self) -> LawSide: ...
    @property
    def parameters(self) -> Mapping[str, Float64Array]: ...
    @property
    def engine(self) -> str: ...


def check_fit(side: LawSide, plant: AnyPlant) -> None:
    """A controller and a plant that do not fit are refused when they meet.

    Raises:
        MatchError: Another kind of command; a quantity that is not measured, or compensated twice or not at all.
        ShapeError: Another number of joints.
    """
    law, probe = type(side.law).__name__, side.probe
    if side.arm.n != plant.arm.n:
        raise ShapeError(
            f"plant '{plant.name}' has {plant.arm.n} joints and the controller's arm '{side.arm.name}' has "
            f"{side.arm.n}"
        )
    names = side.arm.joint_names, plant.arm.joint_names
    if names[0] != names[1] and sorted(names[0]) == sorted(names[1]):
        raise MatchError(
            f"plant '{plant.name}' has its joints in another order than the controller's arm: {', '.join(names[1])} "
            f"against {', '.join(names[0])}"
        )
    if probe.kind != plant.takes:
        raise MatchError(
            f"{law} gives a {probe.kind} and plant '{plant.name}' takes a {plant.takes}; choose a law for "
            f"{plant.takes} commands, or a plant with takes='{probe.kind}'"
        )
    for name in side.needs:
        if name not in plant.measures:
            raise MatchError(
                f"{law} needs {name}, which plant '{plant.name}' does not measure; it measures "
                f"{', '.join(sorted(plant.measures)) or 'positions only'}"
                + ("; sensing=taut.Sensing(velocity='difference') needs positions only" if name == "v" else ""),
                name=name,
            )
    _check_adds(law, side.adds, probe.used, plant)


def _check_adds(law: str, left_out: Adds, used: frozenset[str], plant: AnyPlant) -> None:
    added = Adds.of(plant.adds)
    for what in ("gravity", "coriolis", "friction"):
        if what not in used or (what in left_out.names) == (what in added.names):
            continue
        if what in added.names:
            raise MatchError(
                f"plant '{plant.name}' adds {what} itself and the law {law} adds it too; compile with "
                "adds=plant.adds, use a law that does not add it, or a plant with adds=()",
                name=what,
            )
        raise MatchError(
            f"the controller was compiled to leave {what} to the plant, and plant '{plant.name}' does not add it; "
            "compile with adds=plant.adds",
            name=what,
        )
    if left_out.gravity and added.gravity and "gravity" in used and left_out.load is not added.load:
        raise MatchError(
            f"plant '{plant.name}' compensates the gravity of another payload than the controller was told; "
            "compile with adds=plant.adds",
            name="gravity",
        )


class Loop:
    """A closed loop: a controller and a model plant that follow a reference for a while.

    Args:
        ctrl: A controller from `taut.compile`.
        plant: A model plant such as `taut.RigidPlant`.
        ref: A sample, hold, trajectory, stream or chunk; a hold of the first state if left out.
        duration: Length of the run [s].

    Raises:
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
        self.side = ctrl.side
        self.engine = ctrl.engine
        self.plant = plant
        check_fit(self.side, plant)
        self.ref: Reference = Hold() if ref is None else as_reference(ref)
        self.duration = positive_scalar("duration", duration, unit="s")
        own = {f"{_prefix(path)}{path}": value for path, value in plant.parameters().items()}
        self.parameters = LoopParameters(self.side, {**ctrl.parameters, **own})

    @property
    def dt(self) -> float:
        """Control period [s]."""
        return self.side.dt

    @property
    def ticks(self) -> int:
        """Number of control ticks, both ends included."""
        return round(self.duration * self.side.rate) + 1

    # ---------------------------------------------------------------- layout

    def input_shapes(self) -> dict[str, tuple[int, ...]]:
        """What each tick gets from outside: time, the reference, noise."""
        reference = self.side.law.reference.fields(self.side.arm.n)
        shapes: dict[str, tuple[int, ...]] = {"t": ()}
        shapes |= {f"ref.{name}": shape for name, shape in reference.items()}
        return shapes | {f"noise.{name}": shape for name, shape in self.plant.noise.items()}

    def parameter_shapes(self) -> dict[str, tuple[int, ...]]:
        """All parameters, and the period."""
        return {path: value.shape for path, value in self.parameters.items()} | {DT: ()}

    # ---------------------------------------------------------------- the pure functions

    def start(self, q: Vector, v: Vector, inputs: Values, parameters: Values) -> dict[str, Any]:
        """Memory by path in the first tick: of the plant at its true state, and of the law side."""
        memory = self.plant.start(q, v, self.dt)
        own = _of_plant(parameters)
        measured = {**self.plant.measure(memory, subtree(inputs, "noise"), own), "t": inputs["t"]}
        law = self.side.start(measured, self._sample(inputs), parameters)
        return {f"plant.{path}": value for path, value in memory.items()} | law

    def step(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        """One control period: (what is recorded, memory after it)."""
        dt, own = parameters[DT], _of_plant(parameters)
        plant = subtree(memory, "plant")
        measured = {**self.plant.measure(plant, subtree(inputs, "noise"), own), "t": inputs["t"]}
        law = {path: value for path, value in memory.items() if not path.startswith("plant.")}
        tick = self.side.tick(measured, self._sample(inputs), law, parameters, dt)
        plant = self.plant.command(tick.command, plant, own, inputs["t"], dt)
        plant = self.plant.advance(plant, own, dt / self.plant.substeps)
        before = subtree(memory, "plant")
        record = {"q": before["q"], "v": before["v"], "command": tick.command, "tau": plant["tau"]}
        if "F_ext" in plant:
            record["F_ext"] = plant["F_ext"]
        record |= {f"terms.{name}": value for name, value in tick.terms.items()}
        return record, {f"plant.{path}": value for path, value in plant.items()} | tick.memory

    def substep(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:  # noqa: ARG002
        """One further step of the integrator in the same control period."""
        plant = self.plant.advance(
            subtree(memory, "plant"), _of_plant(parameters), parameters[DT] / self.plant.substeps
        )
        return {}, {**memory, **{f"plant.{path}": value for path, value in plant.items()}}

    def _sample(self, inputs: Values) -> Any:
        return self.side.law.reference.of(subtree(inputs, "ref"))


def _prefix(path: str) -> str:
    return "" if path.partition(".")[0] in STAGES else "plant."


def _of_plant(parameters: Values) -> dict[str, Any]:
    """The plant's own parameters, with the names it knows them by."""
    stages = {path: value for path, value in parameters.items() if path.partition(".")[0] in STAGES}
    return {**subtree(parameters, "plant"), **stages}


class LoopParameters(dict[str, Float64Array]):
    """Parameters of a loop by path; a new value is checked like the first one."""

    def __init__(self, side: LawSide, values: Mapping[str, Float64Array]) -> None:
        super().__init__(values)
        self._side = side

    def __setitem__(self, path: str, value: ArrayLike) -> None:
        super().__setitem__(path, self.checked(path, value))

    def checked(self, path: str, value: ArrayLike) -> Array:
        """A new value of a parameter, in the shape it has.

        Raises:
            UnknownNameError: There is no such parameter.
            ShapeError: Another shape.
            RangeError: NaN, infinite or negative.
        """
        if path not in self:
            raise unknown_name("the loop", "parameter", path, self)
        if path in self._side.parameters:
            return self._side.checked_parameter(path, value)
        shape = self[path].shape
        if path.startswith("plant.payload."):
            return in_compiled_shape(path, checked_payload_entry(path, value), shape)
        new = in_compiled_shape(path, finite_array(path, value), shape)
        if not path.startswith("environment."):
            require_at_least(path, new, 0.0)
        return new

    def update(self, *args: Any, **kwargs: Any) -> None:
        for path, value in dict(*args, **kwargs).items():
            self[path] = value

    def __delitem__(self, path: str) -> None:
        raise UsageError(f"parameter '{path}' cannot be removed; set it", name=path)


def state_at_start(arm: Arm, q0: ArrayLike | None, v0: ArrayLike | None) -> tuple[Float64Array, Float64Array]:
    """The true state at the start of a run, checked: home and at rest by default."""
    names = arm.joint_names
    q = arm.home if q0 is None else finite_array("q0", q0, shape=(arm.n,), joints=names, unit="rad | m")
    v = np.zeros(arm.n) if v0 is None else finite_array("v0", v0, shape=(arm.n,), joints=names, unit="rad/s | m/s")
    return q, v
