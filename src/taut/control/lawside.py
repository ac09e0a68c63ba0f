"""LawSide: sensing, law and limits as one pure function. A Controller compiles it; a Loop fuses it with a plant."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.parts import checked_payload_entry
from taut.base.checks import finite_array, in_compiled_shape
from taut.base.errors import MatchError, NumericalError, RangeError, ShapeError, UsageError, unknown_name
from taut.base.paths import flatten, subtree, unflatten
from taut.base.types import Array, ArrayLike, Float64Array, Vector
from taut.control.combine import all_laws, title
from taut.control.command import Command, MitCommand, Terms, Torque, as_array
from taut.control.law import Law, call
from taut.control.limits import Limits, anew, fresh_blend, limited
from taut.control.sensing import Sensing
from taut.control.trajectories.reference import Reference, Sample
from taut.maths import dynamics as dyn
from taut.maths.model import Adds, Model, PayloadValues, model_of
from taut.maths.snapshot import AT_TOOL, ESTIMATES, MEASUREMENTS, Snapshot, measurement_shapes
from taut.trace import math as tm
from taut.trace.graph import LARGEST

if TYPE_CHECKING:
    from taut.control.tasks.task import Task

KNOWN: Final = "held.known"  # inputs of the first tick: whether the torque that the plant holds is known, and it
HELD: Final = "held.tau_applied"
PAYLOAD_UNITS: Final = {"mass": "kg", "com": "m", "inertia": "kg m^2"}
ROUNDING: Final = 1e-9  # of torques, and relative to them
Memory = Mapping[str, Any]
"""Memory of the law side by path: law.e_int, sensing.velocity.q, limits.tau_applied."""


@dataclass(frozen=True, kw_only=True)
class Tick:
    """What one tick gives."""

    command: Vector  # (n,) what goes out, after limits
    memory: dict[str, Any]  # by path
    named: Terms  # before limits
    seen: Mapping[str, Vector]  # what the law saw, by measurement
    limiting: Mapping[str, Vector]  # (n,) what limits added to it, by name
    mit: Array | None = None  # (5, n) for motors with a loop of their own, whose torque in the tick is the command

    @property
    def sent(self) -> Array:
        """What the plant takes: the command, or (5, n) that of motors with a loop of their own."""
        return self.command if self.mit is None else self.mit

    def pushed(self, by: Vector) -> Array:
        """What the plant takes with a disturbance (n,) of it."""
        return self.command + by if self.mit is None else tm.stack([*self.mit[:4], self.mit[4] + by])

    @property
    def terms(self) -> dict[str, Vector]:
        """Each term by name; they add up to the command."""
        return {**self.named.parts, **self.limiting}


@dataclass(frozen=True, kw_only=True)
class Probe:
    """What a first run at the home pose shows of a law."""

    kind: str  # of the command; "torque" for motors with a loop of their own, as it is in the tick
    mit: bool  # whether it is for motors with a loop of their own
    used: frozenset[str]  # measurements and compensations that it asks for
    shapes: Mapping[str, tuple[int, ...]]  # of the memory, by path
    terms: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class LawSide:
    """A law, or a task, with sensing and limits on the controller's model; `adds` is what the plant adds."""

    law: Law | Task
    arm: Arm
    rate: float  # [Hz]
    sensing: Sensing
    limits: Limits | None
    adds: Adds

    @property
    def dt(self) -> float:
        """Nominal period [s]."""
        return 1.0 / self.rate

    @property
    def task(self) -> Task | None:
        """The task, if it is one."""
        return None if isinstance(self.law, Law) else self.law

    @property
    def single_law(self) -> Law:
        """The law, where one acts all the time; UsageError for a task."""
        if not isinstance(self.law, Law):
            raise UsageError(f"{self.title} has several laws; take a controller of one of them", name="law")
        return self.law

    @property
    def title(self) -> str:
        """Name of the law in messages."""
        return title(self.law)

    @property
    def laws(self) -> list[tuple[str, Law]]:
        """All laws by path: the law, or those of the phases, and the laws that they hold."""
        return list(all_laws(self.law, "law"))

    @cached_property
    def model(self) -> Model:
        """The constants of the controller's arm."""
        return model_of(self.arm)

    @cached_property
    def parameters(self) -> dict[str, Float64Array]:
        """Every run-time parameter, by path, with the values it was made with."""
        limits = {} if self._limits is None else self._limits.parameters()
        own = self._own_parameters
        law = {path: own[path] for path in own if path.startswith("law.")}
        return law | {f"limits.{name}": values for name, values in limits.items()} | own

    @cached_property
    def _own_parameters(self) -> dict[str, Float64Array]:
        """Those of law and model: all that a first run of the law needs."""
        out = {f"law.{path}": values for path, values in self.law.parameters().items()}
        out |= {f"sensing.{path}": values for path, values in self.sensing.parameters().items()}
        return out | {f"model.payload.{name}": np.asarray(getattr(self.arm.payload, name)) for name in PAYLOAD_UNITS}

    @cached_property
    def _limits(self) -> Limits | None:
        return None if self.limits is None else self.limits.completed(self.rate, self.probe.kind)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each run-time parameter by path."""
        parts: dict[str, Any] = {"law": self.law, "sensing": self.sensing, "limits": self._limits}
        out = {f"{head}.{path}": unit for head, part in parts.items() if part for path, unit in part.units().items()}
        return out | {f"model.payload.{name}": unit for name, unit in PAYLOAD_UNITS.items()}

    def blends(self, paths: Iterable[str]) -> bool:
        """Whether a blend takes up a change of these parameters: limits themselves act at once."""
        ours = self.parameters
        return "limits.blend" in ours and any(path in ours and not path.startswith("limits.") for path in paths)

    def checked_parameter(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value of a parameter, checked like the first one and in the compiled shape."""
        if path not in self.parameters:
            raise unknown_name("the controller", "parameter", path, self.parameters)
        head, _, rest = path.partition(".")
        if head == "law":
            changed = self.law.changed(rest, value, name=path)
            new = in_compiled_shape(path, changed.parameters()[rest], self.parameters[path].shape)
            changed.check_rates(self.rate)
        elif head in ("limits", "sensing"):
            part: Any = self._limits if head == "limits" else self.sensing
            joints = 6 if rest.startswith("F_ext.") else self.arm.joint_names
            new = part.checked_parameter(rest, value, name=path, joints=joints)
            part.changed(rest, new, name=path).check_fit(self.arm, self.rate)
        else:
            new = checked_payload_entry(path, value)
        return in_compiled_shape(path, new, self.parameters[path].shape)

    @cached_property
    def probe(self) -> Probe:
        """Shapes and needs of the law, from a first run on plain numbers at the home pose; may raise MatchError."""
        self.law.check_size(self.arm.joint_names)
        self.law.check_rates(self.rate)
        self.sensing.check_fit(self.arm, self.rate)
        if self.limits is not None:
            self.limits.check_fit(self.arm, self.rate)
        try:
            x, command, after = self._first_run(self.arm.home)
        except NumericalError:  # a law that inverts what is singular at home
            elsewhere = self.arm.home + 0.1 * np.cos(np.arange(self.arm.n))
            self.check_start(elsewhere, self._own_parameters)  # a law that knows why says it better
            x, command, after = self._first_run(elsewhere)
        mit = isinstance(command, MitCommand)
        command = _in_tick(command, x)
        self.check_start(x.q, self._own_parameters)
        total = as_array(command.total, f"the command of {type(self.law).__name__}")
        torque = isinstance(command, Torque)
        if torque and "gravity" in x.used:
            self._check_gravity_once(np.asarray(total), np.asarray(x.g))
        used = set(x.used)
        if self.sensing.observer is not None:
            self.sensing.observer.check_command(MitCommand.kind if mit else command.kind, self.title)
            used |= {"v", *self.sensing.observer.needs}
        self.sensing.check_used(used, self.title)
        added = () if self.limits is None else self.limits.terms(command, self.title)
        measured = self.measurements_at_rest(self.arm.home)
        at_rest = self.sensing_at_start(measured, self._own_parameters)
        at_rest |= self._observed(measured, np.zeros(self.arm.n), self._own_parameters, self.dt)
        limits: dict[str, Any] = fresh_blend(self.arm.n) if "blend" in added else {}
        follows = "tau_applied" in x.used or self.sensing.observer is not None
        if (torque and follows) or {"rate_limit", "blend"} & set(added):
            limits["tau_applied"] = np.zeros(self.arm.n)
        if self.limits is not None and "tau_cut" in x.used:
            limits["tau_cut"] = np.zeros(self.arm.n)
        memory = flatten({"law": after, "sensing": at_rest, "limits": limits})
        used |= {"v"} if "speed_limit" in added and torque else set()
        return Probe(
            kind=command.kind,
            mit=mit,
            used=frozenset(used),
            shapes={path: np.shape(as_array(value, path)) for path, value in memory.items()},
            terms=(*command.terms.parts, *added),
        )

    def _check_gravity_once(self, tau: Float64Array, g: Float64Array) -> None:
        """A user's law must not add gravity by x.h and by x.g: at rest, twice the gravity torque."""
        if np.abs(g).max() > ROUNDING and np.abs(tau - 2.0 * g).max() <= ROUNDING * np.abs(g).max():
            who = self.title
            raise MatchError(
                f"{who} adds gravity twice: at rest it gives 2 g, {np.round(tau, 4).tolist()}; x.h is "
                "C v + g, so add x.h or x.g, not both",
                name=who,
                rule="added once",
            )

    def _first_run(self, q: Float64Array) -> tuple[Snapshot, Command, dict[str, Any]]:
        """Two ticks at rest at q: what was asked for, the command, the memory."""
        measured, ref = self.measurements_at_rest(q), self.at_rest(q)
        x = self._snapshot(measured, self._own_parameters, {})
        law = self.law.bound(subtree(self._own_parameters, "law"))
        _, after = call(law, x, ref, law.initial_memory(x, ref), self.dt)
        command, after = call(law, x, ref, after, self.dt)
        return x, command, after

    @property
    def gives(self) -> str:
        """The kind of command that a plant must take."""
        return MitCommand.kind if self.probe.mit else self.probe.kind

    def at_rest(self, q: Float64Array) -> Sample:
        """The sample that asks to stay at joint positions q."""
        return self.law.at_rest(Snapshot(self.model, q=q, v=np.zeros(self.arm.n)))

    def check_start(self, q: Float64Array, parameters: Mapping[str, Any], ref: Reference | None = None) -> None:
        """The law and its reference must have a meaning where a run starts, or where its parameters change."""
        payload = _payload_of(parameters)
        x = Snapshot(self.model, q=q, v=np.zeros(self.arm.n), payload=payload, adds=self.adds)
        law = self.law.bound(subtree(parameters, "law"))
        law.check_states(x, self.rate)
        if ref is not None:
            law.check_references(x, ref, self.rate)

    def require_gains(self, q: Float64Array, parameters: Mapping[str, Any], most: tuple[float, float]) -> None:
        """RangeError for a law that sends motors, at rest at q (n,), a kp or kd beyond the largest ones."""
        if not self.probe.mit:
            return
        x = self._snapshot(self.measurements_at_rest(q), parameters, {})
        laws = (
            {"law": self.law} if self.task is None else {f"law.{name}": law for name, law in self.task.laws.items()}
        )
        for path, one in laws.items():
            with contextlib.suppress(NumericalError):  # of a phase that begins elsewhere
                law = one.bound(subtree(parameters, path))
                ref = law.at_rest(x)
                command, _ = call(law, x, ref, law.initial_memory(x, ref), self.dt)
                for name, limit in zip(("kp", "kd"), most, strict=True) if isinstance(command, MitCommand) else ():
                    gains = np.asarray(getattr(command, name))
                    if gains.max() > limit:
                        joint, gain = self.arm.joint_names[int(gains.argmax())], float(gains.max())
                        rule = f"must be at most {limit:g}, what its motor takes"
                        who = f"{name} that {path} sends to joint '{joint}'"
                        raise RangeError(f"{who} {rule}; got {gain:g}", name=name, joint=joint, value=gain)

    def check_change(self, q: Float64Array, before: Mapping[str, Any], new: Mapping[str, ArrayLike]) -> None:
        """New parameters must have a meaning at q (n,), those of a task where its phases begin; `before` has all."""
        ours = {path: self.checked_parameter(path, value) for path, value in new.items() if path in self.parameters}
        if self.task is None and any(path.startswith(("law.", "model.")) for path in ours):
            self.check_start(q, {**before, **ours})

    @cached_property
    def recorded(self) -> dict[str, str]:
        """Paths of the memory that a run keeps, as it is after each tick, by its column: law.ik_error."""
        of_task = {} if self.task is None else {"phase": "law.phase", "phase_ended": "law.ended"}
        if "law.energy" in self.probe.shapes and self.task is not None:
            of_task["energy"] = "law.energy"
        kept = (f"{path}.{name}" for path, law in self.laws for name in law.recorded)
        return of_task | {path: path for path in kept if path in self.probe.shapes}

    @cached_property
    def notices(self) -> dict[str, str]:
        """Sentence of a run's outcome where a recorded entry of the memory is not zero, by path."""
        return {f"{path}.{name}": text for path, law in self.laws for name, text in law.notices}

    @cached_property
    def needs(self) -> tuple[str, ...]:
        """Measurements that the law side needs, beyond positions."""
        return tuple(name for name in self.takes if name in self.probe.used)

    @cached_property
    def takes(self) -> tuple[str, ...]:
        """What a tick is given, beyond positions: all that is needed, and velocities where sensing reads them."""
        velocity, used = ("v",) if self.sensing.needs_velocity else (), self.probe.used
        return (*velocity, *(name for name in MEASUREMENTS if name in used and name not in self.sensing.estimates))

    def measurements_at_rest(self, q: Float64Array) -> dict[str, Any]:
        """Measurements of the arm at rest at q, with nothing touching it."""
        shapes = measurement_shapes(self.arm.n)
        at_rest = {name: np.zeros(shapes[name]) for name in (*MEASUREMENTS, *self.sensing.estimates)}
        upwards = -dyn.pose(self.model, q).R.T @ self.arm.gravity
        return {**at_rest, "v": np.zeros(self.arm.n), "q": q, "q_motor": q, "a_tip": upwards, "t": 0.0}

    def sense(
        self, measured: Mapping[str, Any], memory: Mapping[str, Any], parameters: Mapping[str, Any], dt: Any
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """What the law sees of measurements, and the new memory of sensing; memory and parameters by path."""
        own, payload = subtree(parameters, "sensing"), _payload_of(parameters)
        return self.sensing.see(self.arm, self._with_v(measured), memory, own, payload, dt)

    def sensing_at_start(self, measured: Mapping[str, Any], parameters: Mapping[str, Any]) -> dict[str, Any]:
        """Memory of sensing in the first tick, by path below "sensing"; the parameters are all of the law side."""
        own, payload = subtree(parameters, "sensing"), _payload_of(parameters)
        return self.sensing.start(self.arm, self._with_v(measured), own, payload)

    def _observed(
        self,
        seen: Mapping[str, Any],
        tau: Vector,
        parameters: Mapping[str, Any],
        dt: Any,
        memory: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        """The observer's memory under a torque tau (n,) that the plant holds, by path below "sensing"."""
        observer, own = self.sensing.observer, subtree(parameters, "sensing.observer")
        if observer is None:
            return {}
        new = observer.observe(self.arm, seen, tau, self.adds, own, _payload_of(parameters), dt, memory)
        return {f"observer.{name}": value for name, value in new.items()}

    def _estimated(self, q: Vector, tau_ext: Vector, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """What the law sees of an estimate, by name."""
        observer = self.sensing.observer
        if observer is None or "F_ext" not in observer.estimates or "F_ext" not in self.probe.used:
            return {"tau_ext": tau_ext}
        return {"tau_ext": tau_ext, "F_ext": observer.wrench(self.model, q, tau_ext, _payload_of(parameters))}

    def check_finite(self, inputs: Mapping[str, Any], tick: int) -> None:
        """The inputs of a tick (measurements, ref.q, ...) must be finite; RangeError names joint and tick."""
        n, joints = self.arm.n, self.arm.joint_names
        for name, values in inputs.items():
            of_joints = name not in AT_TOOL and np.shape(values) == (n,)
            try:
                finite_array(name, values, joints=joints if of_joints else None)
            except RangeError as error:
                raise RangeError(
                    f"{error} in tick {tick}", name=name, joint=error.joint, value=error.value, rule=error.rule
                ) from None

    def seen(
        self,
        measured: Mapping[str, Any],
        sensing: Mapping[str, Any] | None,
        parameters: Mapping[str, Any],
        t: float,
    ) -> Snapshot:
        """The law's snapshot at one instant [s], as plain numbers, for the source of a stream; copied.

        What an observer estimates is that of the tick before.
        """
        copies = {name: np.array(value, dtype=np.float64) for name, value in measured.items()}
        numbers = {path: np.array(value) for path, value in parameters.items()}
        before = self.sensing_at_start(copies, numbers) if sensing is None else sensing
        seen, _ = self.sense(copies, before, numbers, self.dt)
        if self.sensing.observer is not None:
            tau_ext = np.array(before.get("observer.tau_ext", np.zeros(self.arm.n)))
            seen |= self._estimated(seen["q"], tau_ext, numbers)
        return self._snapshot({**seen, "t": t}, numbers, {})

    def _with_v(self, measured: Mapping[str, Any]) -> Mapping[str, Any]:
        return measured if "v" in measured else {**measured, "v": np.zeros(self.arm.n)}

    def start(self, measured: Mapping[str, Any], ref: Sample, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """Memory by path in the first tick, from measurements; a blend begins with the last command.

        That is `measured[HELD]` where `measured[KNOWN]` is 1, else the gravity torque of the model, or zero velocity.
        """
        shapes, sensing = self.probe.shapes, self.sensing_at_start(measured, parameters)
        seen, _ = self.sense(measured, sensing, parameters, self.dt)
        n = self.arm.n
        rest = self._snapshot(seen, parameters, {}).g if self.probe.kind == Torque.kind else tm.zeros(n)
        held = tm.where(measured[KNOWN] > 0.5, measured[HELD], rest) if KNOWN in measured else rest
        limits = {**fresh_blend(n), "tau_applied": held, "tau_cut": tm.zeros(n)}
        if self.sensing.observer is not None:
            sensing |= self._observed(seen, held, parameters, self.dt)
            seen |= self._estimated(seen["q"], tm.zeros(n), parameters)
        x = self._snapshot(seen, parameters, limits if "limits.tau_applied" in shapes else {})
        law = self.law.bound(subtree(parameters, "law"))
        memory = flatten({"law": law.initial_memory(x, ref), "sensing": sensing, "limits": limits})
        filled = {path: _filled(as_array(memory[path], path), shape) for path, shape in shapes.items()}
        if "limits.bump" in shapes:
            asked = self.tick(measured, ref, filled, parameters, self.dt).memory["limits.asked"]
            filled["limits.bump"], filled["limits.phase"] = held - asked, as_array(0.0, "limits.phase")
        return filled

    def tick(
        self,
        measured: Mapping[str, Any],
        ref: Sample,
        memory: Memory,
        parameters: Mapping[str, Any],
        dt: Any,
    ) -> Tick:
        """One tick: sense, evaluate the law, limit."""
        nested = unflatten(memory)
        begins = None if self.task is None else self.task.begins(nested["law"])
        before = nested.get("limits", {})
        if begins is not None and "tau_cut" in before:  # what another law was cut is nothing for this one's integral
            before = {**before, "tau_cut": tm.where(begins, tm.zeros(self.arm.n), before["tau_cut"])}
        seen, sensing = self.sense(measured, subtree(memory, "sensing"), parameters, dt)
        if self.sensing.observer is not None:
            tau = before.get("tau_applied", np.zeros(self.arm.n))
            sensing |= self._observed(seen, tau, parameters, dt, nested["sensing"]["observer"])
            seen |= self._estimated(seen["q"], sensing["observer.tau_ext"], parameters)
        x = self._snapshot(seen, parameters, before)
        law = self.law.bound(subtree(parameters, "law"))
        given_by_law, after = call(law, x, ref, _nested_memory(law, nested.get("law", {})), dt)
        command = _in_tick(given_by_law, x)
        total = as_array(command.total, "command")
        applied, terms, held = total, {}, {}
        if self.limits is not None:
            given, moving = subtree(parameters, "limits"), x if command.kind == Torque.kind else None
            kept = before if begins is None or "blend" not in given else anew(before, total, begins)
            made = limited(total, kept, given, dt, moving)
            applied = tm.where(tm.abs(total) <= LARGEST, made.command, total)  # infinity is refused, never cut
            terms, held = made.terms, {**made.memory, "tau_cut": made.cut}
        held["tau_applied"] = applied
        new = flatten({"law": after, "sensing": sensing, "limits": held})
        shapes = self.probe.shapes
        return Tick(
            command=applied,
            memory={path: _shaped(as_array(new[path], path), path, shapes[path]) for path in shapes},
            named=command.terms,
            seen=seen,
            limiting=terms,
            mit=given_by_law.sent(x, applied) if isinstance(given_by_law, MitCommand) else None,
        )

    def _snapshot(
        self, seen: Mapping[str, Any], parameters: Mapping[str, Any], held: Mapping[str, Array]
    ) -> Snapshot:
        zero = np.zeros(self.arm.n)
        others = {name: seen[name] for name in (*MEASUREMENTS, *ESTIMATES) if name in seen}
        torques = {name: held.get(name, zero) for name in ("tau_applied", "tau_cut")}
        return Snapshot(
            self.model,
            q=seen["q"],
            v=seen["v"],
            t=seen["t"],
            payload=_payload_of(parameters),
            adds=self.adds,
            measured={**others, **torques},
        )


def _in_tick(command: Command, x: Snapshot) -> Command:
    """The command; of motors with a loop of their own the torque that they give in the tick."""
    return Torque(command.terms + command.feedback(x)) if isinstance(command, MitCommand) else command


def _payload_of(parameters: Mapping[str, Any]) -> PayloadValues:
    """Payload of the tool in the controller's model."""
    return PayloadValues.of(subtree(parameters, "model.payload"))


def _nested_memory(law: Law | Task, memory: Mapping[str, Any]) -> dict[str, Any]:
    """Memory with a place for every law that is held, also for those that remember nothing."""
    children = {name: _nested_memory(child, memory.get(name, {})) for name, child in law.children().items()}
    return {**memory, **children}


def _filled(value: Array, shape: tuple[int, ...]) -> Array:
    return value if value.shape == shape else np.broadcast_to(value, shape)


def _shaped(value: Array, path: str, shape: tuple[int, ...]) -> Array:
    if value.shape != shape:
        raise ShapeError(
            f"memory '{path}' has shape {shape} in one tick and {value.shape} in the next; it must keep its shape",
            name=path,
        )
    return value
