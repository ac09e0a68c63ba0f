"""Controller: a law compiled for one arm and one rate."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, Sequence
from typing import Any, Final, Literal, NoReturn

import numpy as np

from taut.arm.angles import require_radians
from taut.arm.description import Arm, Payload
from taut.base.checks import finite_array, float_array, one_of, rate_in_hertz
from taut.base.errors import NumericalError, RangeError, TautError, UsageError, count_of, unknown_name
from taut.base.named import Named
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.codegen import native
from taut.codegen.call import Argument
from taut.codegen.kernel import Blocks, FloatKernel, Kernel, NativeKernel, verified
from taut.codegen.layout import Block
from taut.codegen.program import Program, Values, failure, trace
from taut.control.describe import PARAMETER_UNITS, all_laws, section, short, summary, title
from taut.control.law import Law
from taut.control.lawside import HELD, TOLD, LawSide, Probe, WildTerm, wild_term
from taut.control.limits import Limits, take_up
from taut.control.sensing.sensing import Sensing
from taut.control.tasks.phase import Phase
from taut.control.tasks.phases import Phases
from taut.control.tasks.task_steps import TaskSteps
from taut.control.trajectories.reference import Sample, Trajectory
from taut.maths.adds import Adds
from taut.maths.snapshot import AT_TOOL, MEASUREMENTS, measurement_shapes

__all__ = ["BoundKernel", "Controller", "compile", "take_up_change"]

Engine = Literal["auto", "native", "float"]
ENGINES: Final[tuple[Engine, ...]] = ("auto", "native", "float")
DT: Final = "dt"  # the period stands beside the parameters, so that code serves every rate


def compile(
    law: Law | Sequence[Phase],
    arm: Arm,
    *,
    rate: float = 1000.0,
    sensing: Sensing | None = None,
    limits: Limits | None = None,
    adds: Adds | Iterable[str] | Mapping[str, Payload | None] = (),
    engine: Engine = "auto",
) -> Controller:
    """A controller: the law for this arm, as native code.

    Args:
        law: A law of `taut.laws`, a sum of them, or one of your own; or a task, a list of `taut.Phase`.
        arm: The controller's model of the arm, payload included.
        rate: Ticks per second [Hz].
        sensing: Where the velocity comes from, measured by default; filters of what is measured.
        limits: What a torque command is cut to; no limit unless given.
        adds: What the plant adds itself ("gravity", "coriolis", "friction"): `plant.adds`. It is left out.
        engine: "native" for machine code, "float" for plain Python, "auto" for the first that is there.

    Raises:
        UsageError: Not a law, not an arm, or a law whose command does not fit its memory.
        ShapeError: A gain, limit or cut-off of another size than the arm.
        RangeError: A cut-off at half the rate or above.
        MatchError: Two laws that add the same, limits on a command that is no torque.
        TraceError: Law code that cannot be traced; the message names file and line.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.PID(kp=10.0, kd=1.0), arm, rate=500.0)
        >>> ctrl.step(np.zeros(2), np.zeros(2), taut.JointMotion(q=[0.1, 0.0])).tolist()
        [1.0, 0.0]
    """
    if isinstance(law, (list, tuple)):
        law = Phases.of(law)
    if isinstance(law, Phase):
        raise UsageError("a task is a list of phases: taut.compile([taut.Phase(...)], arm)", name="law")
    if not isinstance(law, Law):  # callers without a type checker
        raise UsageError(
            f"compile takes a law such as taut.laws.PID(kp=...), with its gains; got {law!r}", name="law"
        )
    if not isinstance(arm, Arm):
        raise UsageError(f"compile takes an Arm from taut.load_arm; got {type(arm).__name__}", name="arm")
    if sensing is not None and not isinstance(sensing, Sensing):
        raise UsageError(f"sensing must be a taut.Sensing; got {type(sensing).__name__}", name="sensing")
    if limits is not None and not isinstance(limits, Limits):
        raise UsageError(f"limits must be a taut.Limits; got {type(limits).__name__}", name="limits")
    rate = rate_in_hertz(rate)
    side = LawSide(
        law=law,
        arm=arm,
        rate=rate,
        sensing=sensing or Sensing(),
        limits=limits,
        adds=Adds.of(adds),
    )
    return Controller(side, _engine(engine))


def _engine(engine: Engine) -> Literal["native", "float"]:
    one_of("engine", engine, ENGINES)
    if engine == "float":
        return "float"
    if native.available():
        return "native"
    if engine == "native":
        raise UsageError(
            "engine='native' needs llvmlite, which is not installed; pip install llvmlite, or engine='float'",
            name="engine",
        )
    native.warn_of_plain_python()
    return "float"


class Controller:
    """A law with its sensing and limits, compiled for one arm. Made by `taut.compile`.

    One thread at a time steps a controller and writes into its bound arrays; each thread needs one of its own. A tick
    that begins while another thread is in the middle of one is refused.
    """

    def __init__(self, side: LawSide, engine: Literal["native", "float"]) -> None:
        self.side = side
        self._kernel = _kernel_of(side, engine, slow=self._slow, first=self._first, failed=self._failed)
        self.parameters = Parameters(side, self._kernel)
        self._inputs = self._kernel.blocks.views("inputs")
        self._command = self._kernel.blocks.views("outputs")["command"]
        self._memory = self._kernel.blocks.views("memory")
        self._torque_at_start: Float64Array | None = None
        self._task: TaskSteps | None = None
        # The builtin stands before the method that documents it; before that of a task, what places its samples.
        vars(self)["step"] = self._kernel.step
        if isinstance(side.law, Phases):
            fields = [field for field in self._kernel.blocks.layout["inputs"].fields if field.path in _wanted(side)]
            first, end = fields[0].offset, fields[-1].offset + fields[-1].size
            self._task = TaskSteps(side, side.law, self._memory, self._kernel.blocks.inputs[first:end])
            vars(self)["step"] = self._task.around(self._kernel.step, self._slow)

    def recording_kernel(self, sensed: tuple[str, ...] = (), ticks: int | None = None) -> Kernel:
        """A kernel of the same law with blocks of its own, that gives every term in every tick: for simulations.

        Args:
            sensed: Measurements that it gives too, as the law sees them.
            ticks: How often it is called, any number if left out: for few it is compiled quickly.
        """
        kernel: Kernel

        def first() -> None:
            kernel.start()
            kernel.tick()

        def failed() -> None:
            raise _not_finite(self.side, kernel)

        kernel = _kernel_of(
            self.side,
            self._kernel.engine,
            slow=None,
            first=first,
            failed=failed,
            record=True,
            sensed=sensed,
            level=native.level_for(ticks),
        )
        kernel.blocks.parameters[:] = self._kernel.blocks.parameters
        return kernel

    # ---------------------------------------------------------------- what it is

    @property
    def law(self) -> Law:
        """The law, with the gains it was compiled with."""
        return self.side.law

    @property
    def arm(self) -> Arm:
        """The controller's model of the arm."""
        return self.side.arm

    @property
    def rate(self) -> float:
        """Ticks per second [Hz]."""
        return self.side.rate

    @property
    def dt(self) -> float:
        """Nominal period [s]."""
        return self.side.dt

    @property
    def adds(self) -> Adds:
        """What the plant is expected to add itself."""
        return self.side.adds

    @property
    def needs(self) -> tuple[str, ...]:
        """What must be measured beyond positions."""
        return self.side.needs

    @property
    def kind(self) -> str:
        """The kind of command: torque, velocity or position."""
        return self.side.probe.kind

    @property
    def engine(self) -> Literal["native", "float"]:
        """The engine it runs on: native or float."""
        return self._kernel.engine

    @property
    def operations(self) -> int:
        """Number of arithmetic operations in a tick; 0 in the float engine, which is not traced."""
        return self._kernel.operations

    @property
    def program(self) -> Program:
        """The traced tick, for other targets: `taut.to_casadi(ctrl.program)`."""
        if self._kernel.program is not None:
            return self._kernel.program
        layout = self._kernel.blocks.layout
        functions = _Functions(self.side, record=False)
        return trace(functions.tick, layout["inputs"], layout["parameters"], layout["memory"])

    @property
    def ticks(self) -> int:
        """Ticks since the start."""
        return self._kernel.count

    def __repr__(self) -> str:
        return f"Controller({self.law!r}, {self.arm!r}, rate={self.rate:g})"

    def __reduce__(self) -> NoReturn:
        raise UsageError(
            "a controller holds machine code, so it cannot be copied or pickled; copy its law and compile again: "
            "taut.compile(ctrl.law, ctrl.arm, rate=ctrl.rate)"
        )

    # ---------------------------------------------------------------- running it

    def step(
        self,
        q: ArrayLike,
        v: ArrayLike | None = None,
        ref: Sample | None = None,
        *,
        F_ext: ArrayLike | None = None,
        F_app: ArrayLike | None = None,
        tau_meas: ArrayLike | None = None,
        q_motor: ArrayLike | None = None,
        v_motor: ArrayLike | None = None,
        a_tip: ArrayLike | None = None,
    ) -> Vector:
        """One tick: what is measured and wanted in, the command out.

        Args:
            q: (n,) measured positions [rad | m].
            v: (n,) measured velocities [rad/s | m/s]; left out where sensing makes them from positions.
            ref: One sample of the reference.
            F_ext: (6,) measured wrench of the environment on the arm at the tool, force first, world axes; where
                the law needs it.
            F_app: (6,) the same with the opposite sign, of the arm on the environment; one of the two.
            tau_meas: (n,) measured joint torques [N m | N]; this and what follows where the law needs it.
            q_motor: (n,) measured positions of the motors, in joint units: motor angle / gear [rad | m].
            v_motor: (n,) measured velocities of the motors, in joint units [rad/s | m/s].
            a_tip: (3,) proper acceleration of the tool's origin, in the tool's axes [m/s^2].

        Returns:
            (n,) the command, a new array.

        Raises:
            ShapeError: An array of another shape.
            RangeError: NaN or infinity in what is measured or wanted.
            UsageError: Something that is missing, or that this controller does not take.
            NumericalError: The law gave NaN or infinity; its memory stays as it was before the tick.
        """
        others = {"F_ext": F_ext, "tau_meas": tau_meas, "q_motor": q_motor, "v_motor": v_motor, "a_tip": a_tip}
        command: Vector = self._slow(q, v, ref, F_app=F_app, **others)
        return command

    def _slow(self, *args: Any, **kwargs: Any) -> Any:
        """A tick with whatever was passed: checked in words, converted, started where needed."""
        given, ref = self._arguments(args, kwargs)
        self._check_given(given)
        kernel = self._kernel
        with kernel.alone:
            if self._task is not None:
                going = self._going
                self._task.place(kernel.count if going else 0, going, given, ref, self.parameters.views)
            self._take(given, ref)
            kernel.tick()
            return self._command.copy()

    @property
    def _going(self) -> bool:
        """Whether memory has started, if only to wait for a change of parameters."""
        return self._kernel.ready or self.parameters.changed

    def _arguments(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[dict[str, Any], Any]:
        known = ("q", "v", "ref", "F_app", *MEASUREMENTS)
        positional: tuple[str, ...] = known[:3]
        if len(args) == 2 and isinstance(args[1], Sample):
            positional = ("q", "ref")
        if len(args) > len(positional):
            raise UsageError(f"step takes {', '.join(positional)}; got {len(args)} positional arguments")
        given = dict(zip(positional, args, strict=False))
        for name, value in kwargs.items():
            if name not in known:
                raise unknown_name("step", "argument", name, known)
            if name in given:
                raise UsageError(f"step got {name} twice", name=name)
            given[name] = value
        if given.get("F_app") is not None:
            if given.get("F_ext") is not None:
                raise UsageError("step takes F_ext or F_app, not both: one is minus the other", name="F_app")
            given["F_ext"] = -finite_array("F_app", given.pop("F_app"), shape=(6,), unit="N, N m")
        given.pop("F_app", None)
        ref = given.pop("ref", None)
        return {name: value for name, value in given.items() if value is not None}, ref

    def _take(self, given: dict[str, Any], ref: Any) -> None:
        """Check everything, then write everything; the sample of a task is there already."""
        if self._task is None and not isinstance(ref, self.law.reference):
            hint = "; for a trajectory pass ref.at(t)" if isinstance(ref, Trajectory) else ""
            got = "none" if ref is None else type(ref).__name__
            raise UsageError(f"step needs ref, a taut.{self.law.reference.described()}; got {got}{hint}", name="ref")
        joints = self.arm.joint_names
        wanted = _wanted(self.side) if self._task is None else {}
        taken = given | {path: getattr(ref, path[4:]) for path in wanted}
        checked = {
            path: float_array(
                path, value, shape=self._inputs[path].shape, joints=joints if path not in AT_TOOL else None
            )
            for path, value in taken.items()
        }
        self.side.check_finite(checked, self._kernel.count if self._going else 0)
        for path, value in checked.items():
            self._inputs[path][...] = value

    def _check_given(self, given: dict[str, Any]) -> None:
        """What is measured must be what is asked for."""
        for name in ("q", *self.needs):
            if name not in given:
                raise UsageError(f"step needs {name}{_WHY.get(name, '')}; got none", name=name)
        for name in given:
            if name not in ("q", *self.side.takes):
                raise UsageError(
                    f"step got {name}, which this controller does not use"
                    f"{'; its sensing makes v from positions' if name == 'v' else ''}; leave it out",
                    name=name,
                )

    def _first(self) -> None:
        """The first tick of all, or the first one after a change of parameters that a blend takes up."""
        with self._kernel.alone:
            if self.parameters.changed:
                self._carry_on()
            else:
                self._start()

    def _carry_on(self) -> None:
        """A tick that takes up the jump which the new parameters would make."""
        kernel, memory = self._kernel, self._kernel.blocks.memory.copy()
        kernel.resume()
        take_up_change(kernel, self.parameters.at_tick(kernel.count))
        try:
            kernel.tick()
        except TautError:
            kernel.blocks.memory[:] = memory
            kernel.clear()  # nothing has happened yet: the next tick takes up the same change
            raise
        self.parameters.changed = False

    def _start(self) -> None:
        """A tick before memory has started: start it from the inputs, and from the torque that the plant holds."""
        for path in ("q", "ref.q"):  # in the first tick alone: nothing must stop an arm that moves already
            if path in self._inputs:
                require_radians(path, self._inputs[path], self.arm)
        ref = self.law.reference.of(subtree({path: np.array(value) for path, value in self._inputs.items()}, "ref"))
        self.side.check_start(self._inputs["q"].copy(), self.parameters, ref)
        if TOLD in self._inputs:
            told = self._torque_at_start
            self._inputs[TOLD][...] = told is not None
            self._inputs[HELD][...] = 0.0 if told is None else told
        self._kernel.start()
        self.parameters.forget()
        try:
            self._kernel.tick()
        except TautError:
            self._kernel.clear()  # nothing has happened yet: the next tick is the first one
            raise
        self._torque_at_start = None

    def _failed(self) -> None:
        raise _not_finite(self.side, self._kernel)

    def reset(self, tau_applied: ArrayLike | None = None) -> None:
        """Forget everything: the next tick starts memory from what is measured then.

        Args:
            tau_applied: (n,) the command that the plant holds now, from which a rate limit and a blend start: what
                the controller before this one gave last. The model's gravity torque if left out.

        Raises:
            UsageError: A torque for a controller that does not remember one.
        """
        if tau_applied is not None:
            if "limits.tau_applied" not in self.side.probe.shapes:
                raise UsageError(
                    "reset(tau_applied=) is for controllers that limit the torque rate or blend, or whose law asks "
                    "for x.tau_applied; this one does none of these",
                    name="tau_applied",
                )
            tau_applied = finite_array(
                "tau_applied", tau_applied, shape=(self.arm.n,), unit="N m | N", joints=self.arm.joint_names
            )
        self._torque_at_start = tau_applied
        self.parameters.changed = False
        self._kernel.clear()

    def bind(self) -> BoundKernel:
        """The controller's own arrays, to write measurements into and read the command from, for fast loops.

        Example:
            >>> import taut
            >>> ctrl = taut.compile(taut.laws.PID(kp=10.0), taut.load_arm("planar2"))
            >>> k = ctrl.bind()
            >>> k.q[:], k.ref.q[:] = [0.0, 0.1], 0.2
            >>> k.tick()
            >>> k.command.round(6).tolist()
            [2.0, 1.0]
        """
        if self._task is not None:
            raise UsageError(
                "bind is for a law, whose reference is written from outside; the references of a task are made as "
                "its phases begin: take ctrl.step",
                name="bind",
            )
        return BoundKernel(self._kernel, self.law.reference)

    @property
    def phase(self) -> str:
        """The phase of a task that the coming tick belongs to; "stop" where the task has stopped.

        Raises:
            UsageError: The controller is of a law, not of a task.
        """
        if self._task is None:
            raise UsageError("a controller of one law has no phases; compile a list of taut.Phase", name="phase")
        return self._task.name(self._going)

    # ---------------------------------------------------------------- looking inside

    @property
    def terms(self) -> Mapping[str, Vector]:
        """The named terms of the last tick, computed when asked for; they add up to the command.

        Raises:
            UsageError: There was no tick yet.
        """
        outputs = self._last_tick("terms", _Functions(self.side, record=True))
        return Named(f"the controller's {title(self.law)}", "term", subtree(outputs, "terms"))

    @property
    def sensed(self) -> Mapping[str, Float64Array]:
        """What the law saw in the last tick, by measurement, computed when asked for: after all filters.

        With `taut.sensors.Wrist(range=...)` also saturated.F_ext: 1.0 if the reading was at the end of its range.

        Raises:
            UsageError: There was no tick yet.
        """
        names = ("q", "v", *(name for name in self.side.takes if name != "v"))
        outputs = self._last_tick("sensed", _Functions(self.side, record=True, sensed=names))
        seen = subtree(outputs, "sensed") | {name: outputs[name] for name in self.side.sensing.tells}
        return Named("the controller's sensing", "measurement", seen)

    def _last_tick(self, what: str, functions: _Functions) -> dict[str, Float64Array]:
        """The last tick once more, on floats, with all that it can give."""
        if self.ticks == 0:
            kind = "terms" if what == "terms" else "measurements"
            raise UsageError(f"there are no {kind} before the first tick; call step first", name=what)
        blocks = self._kernel.blocks
        inputs = blocks.layout["inputs"].views(blocks.seen.copy())
        inputs["t"][...] = (self.ticks - 1) * self.dt
        parameters = blocks.layout["parameters"].views(self.parameters.at_tick(self.ticks))
        memory = blocks.layout["memory"].views(blocks.before)
        with np.errstate(all="ignore"):
            outputs, _ = functions.tick(inputs, parameters, memory)
        return {name: np.array(value, dtype=np.float64) for name, value in outputs.items()}

    @property
    def memory(self) -> Mapping[str, Float64Array]:
        """What is remembered after the last tick, by path: law.e_int, limits.tau_applied. Copies.

        Raises:
            UsageError: There was no tick yet.
        """
        if self.ticks == 0:
            raise UsageError("there is no memory before the first tick; call step first", name="memory")
        views = self._kernel.blocks.views("memory")
        return Named("the controller", "memory entry", {path: view.copy() for path, view in views.items()})

    def explain(self) -> None:
        """Print the law, its gains with units, the closed loop it yields, and what a tick costs."""
        print(self.explanation())

    def explanation(self) -> str:
        """What `explain` prints."""
        side = self.side
        lines = [f"{title(side.law)} for arm '{side.arm.name}' ({count_of(side.arm.n, 'joint')}) at {side.rate:g} Hz"]
        for name, law in all_laws(side.law):
            lines += ["", f"{name}: {summary(type(law))}"] if name else []
            for head in ("Law", "Closed loop"):
                texts = section(type(law), head)
                lines += [f"  {head + ':' if not i else '':13}{text}" for i, text in enumerate(texts)]
        lines += ["", "parameters"]
        units = {f"law.{path}": unit for path, unit in side.law.units().items()} | PARAMETER_UNITS
        width = max(24, *(len(path) for path in self.parameters))
        for path, value in self.parameters.items():
            unit = f"  [{units[path]}]" if path in units else ""
            lines.append(f"  {path:{width}} {short(value)}{unit}")
        if isinstance(side.law, Phases):
            lines += ["", *(f"phase          {line}" for line in side.law.plan())]
        lines += ["", f"terms          {', '.join(side.probe.terms)}"]
        lines += [f"sensing        {side.sensing.summary}"] if side.sensing.alters else []
        lines.append(f"needs          {', '.join(('q', *side.needs))}")
        if side.adds.names:
            lines.append(f"left out       {', '.join(side.adds.names)} (the plant adds them)")
        cost = f"{self.operations} operations a tick" if self.operations else "not traced"
        lines.append(f"engine         {self.engine}, {cost}")
        return "\n".join(lines)


_WHY: Final = {
    "v": ", measured velocities, unless compiled with sensing=taut.Sensing(velocity='difference')",
    "F_ext": ", which the law asks for: pass F_ext= or F_app=",
} | {name: f", which the law asks for: pass {name}=" for name in MEASUREMENTS if name != "F_ext"}


# -------------------------------------------------------------------- what is compiled


class _Functions:
    """What is compiled of a law side: its tick and its start, as functions of blocks."""

    def __init__(self, side: LawSide, *, record: bool, sensed: tuple[str, ...] = ()) -> None:
        self._side = side
        self._record = record
        self._sensed = sensed

    def tick(self, inputs: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:
        tick = self._side.tick(self.measured(inputs), self.sample(inputs), memory, parameters, parameters[DT])
        terms = {f"terms.{name}": value for name, value in tick.terms.items()} if self._record else {}
        sensed = {f"sensed.{name}": tick.seen[name] for name in self._sensed}
        told = {name: tick.seen[name] for name in self._side.sensing.tells} if self._record else {}
        kept = {column: tick.memory[path] for column, path in self._side.recorded.items()} if self._record else {}
        return {"command": tick.command, **terms, **sensed, **told, **kept}, tick.memory

    def start(self, inputs: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:  # noqa: ARG002
        return self._side.start(self.measured(inputs), self.sample(inputs), parameters), {}

    def measured(self, inputs: Values) -> dict[str, Any]:
        zero = np.zeros(self._side.arm.n)
        return {"v": zero, **{name: inputs[name] for name in inputs if not name.startswith("ref.")}}

    def sample(self, inputs: Values) -> Sample:
        return self._side.law.reference.of(subtree(inputs, "ref"))


def _wanted(side: LawSide) -> dict[str, tuple[int, ...]]:
    """The inputs that the sample fills, by path."""
    return {f"ref.{name}": shape for name, shape in side.law.reference.fields(side.arm.n).items()}


def _kernel_of(
    side: LawSide,
    engine: Literal["native", "float"],
    *,
    slow: Callable[..., Any] | None,
    first: Callable[[], None],
    failed: Callable[[], Any],
    record: bool = False,
    sensed: tuple[str, ...] = (),
    level: int | None = None,
) -> Kernel:
    """A law side as a kernel with blocks of its own; without `slow` it is for `tick` alone."""
    n, probe = side.arm.n, _probed(side)
    sizes = measurement_shapes(n)
    ref_fields = _wanted(side)
    held = {TOLD: (), HELD: (n,)} if "limits.tau_applied" in probe.shapes else {}
    terms = {f"terms.{name}": (n,) for name in probe.terms} if record else {}
    sensed_sizes = {f"sensed.{name}": sizes[name] for name in sensed}
    kept = {column: probe.shapes[path] for column, path in side.recorded.items()} if record else {}
    told = dict.fromkeys(side.sensing.tells, ()) if record else {}
    inputs = Block.of({"t": (), "q": (n,), **{name: sizes[name] for name in side.takes}, **ref_fields, **held})
    parameters = Block.of({path: value.shape for path, value in side.parameters.items()} | {DT: ()})
    memory = Block.of(probe.shapes)
    blocks = Blocks(inputs, parameters, memory, Block.of({"command": (n,), **terms, **sensed_sizes, **told, **kept}))
    parameters.pack({**side.parameters, DT: side.dt}, blocks.parameters)
    for path, shape in ref_fields.items():
        if shape == (3, 3):  # a rotation that nobody has written yet
            inputs.views(blocks.inputs)[path][...] = np.eye(3)
    functions = _Functions(side, record=record, sensed=sensed)
    if engine == "float":
        return FloatKernel(
            functions.tick, functions.start, blocks, time="t", dt=side.dt, slow=slow, first=first, failed=failed
        )
    program = trace(functions.tick, inputs, parameters, memory)
    starter = trace(functions.start, inputs, parameters, Block())
    v = ("v",) if side.sensing.needs_velocity else ()
    plain, given = slow is not None, not isinstance(side.law, Phases)  # a task makes its samples itself
    arguments = [Argument((name,)) for name in ("q", *v)]
    arguments += [Argument(tuple(ref_fields), is_object=True)] if given else []
    return NativeKernel(
        program,
        starter,
        blocks,
        arguments=arguments if plain else None,
        keywords=tuple(name for name in side.takes if name != "v"),
        reference=side.law.reference if plain and given else None,
        time="t",
        dt=side.dt,
        guarded=True,
        slow=slow,
        first=first,
        failed=failed,
        verify=verified(type(side.law).__name__, functions.tick, program, lambda: _random_samples(side, blocks)),
        level=level,
    )


def _probed(side: LawSide) -> Probe:
    """What a first run on plain numbers shows; a law that fails there is told in a sentence."""
    try:
        with np.errstate(all="ignore"):
            return side.probe
    except TautError:
        raise
    except Exception as cause:
        name = title(side.law)
        raise UsageError(f"{name} fails on plain numbers, at rest at home: {failure(cause)}", name=name) from cause


def _random_samples(side: LawSide, blocks: Blocks) -> list[tuple[Float64Array, Float64Array, Float64Array]]:
    """Three states near home, at which compiled code is compared with the float run."""
    rng = np.random.default_rng(0)
    samples = []
    task = side.law if isinstance(side.law, Phases) else None
    for k in range(3 if task is None else max(3, 2 * len(task.names))):
        inputs, memory = (0.3 * rng.standard_normal(block.size) for block in (blocks.inputs, blocks.memory))
        views = blocks.layout["inputs"].views(inputs)
        for name in ("q", "q_motor", "ref.q"):
            if name in views:
                views[name] += side.arm.home
        if task is not None:  # each phase in its first tick and in another one
            held = blocks.layout["memory"].views(memory)
            held["law.next"][...], held["law.ticks"][...] = k // 2 % len(task.names), k % 2
        samples.append((inputs, blocks.parameters.copy(), memory))
    return samples


def _not_finite(side: LawSide, kernel: Kernel) -> TautError:
    """The error that says which number is not finite."""
    joints, blocks = side.arm.joint_names, kernel.blocks
    try:
        side.check_finite(blocks.views("inputs"), kernel.count)
        side.check_reading(blocks.views("inputs"), blocks.views("memory"), kernel.count)
    except RangeError as error:
        return error
    law = title(side.law)
    bad = np.flatnonzero(~np.isfinite(blocks.views("outputs")["command"]))
    term = _wild_term(side, kernel) if bad.size else None
    joint = joints[term.joint if term is not None else int(bad[0])] if bad.size else None
    who = f"the {side.probe.kind} of joint '{joint}'" if joint is not None else "its new memory"
    who += "" if term is None else f", of which the term '{term.name}' is {term.value}"
    return NumericalError(
        f"{law} gives numbers that are not finite in tick {kernel.count}: {who}; its memory stays as it was "
        "before that tick",
        name=law if term is None else f"terms.{term.name}",
        joint=joint,
        value=None if term is None else term.value,
    )


def _wild_term(side: LawSide, kernel: Kernel) -> WildTerm | None:
    """The term of the tick that failed which is not finite, seen in the tick once more on floats."""
    views = (kernel.blocks.views(name) for name in ("inputs", "parameters", "memory"))
    copies = ({path: value.copy()[()] for path, value in view.items()} for view in views)
    try:
        with np.errstate(all="ignore"):
            outputs, _ = _Functions(side, record=True).tick(*copies)
    except Exception:  # plain Python raises where compiled code gives infinity: then the joint has to do
        return None
    return wild_term(subtree(outputs, "terms"))


# -------------------------------------------------------------------- parameters and bound arrays


class Parameters(MutableMapping[str, Float64Array]):
    """Run-time parameters by path. A new value is checked like the first one and acts from the next tick.

    What has a meaning in some poses only is checked at that of the last tick.
    """

    def __init__(self, side: LawSide, kernel: Kernel) -> None:
        self._side = side
        self._kernel = kernel
        self.views = kernel.blocks.views("parameters")
        """The numbers that the compiled code reads."""
        self._kept: tuple[int, Float64Array] | None = None  # a tick, and the values that it was computed with
        self.changed = False
        """Whether a blend has to take up the jump of a new value in the next tick."""

    def forget(self) -> None:
        """Memory starts anew, and ticks count from zero again."""
        self._kept = None

    def at_tick(self, tick: int) -> Float64Array:
        """All parameters as the last tick saw them, flat."""
        if self._kept is not None and self._kept[0] == tick:
            return self._kept[1]
        return self._kernel.blocks.parameters

    def __getitem__(self, path: str) -> Float64Array:
        if path not in self._side.parameters:
            raise unknown_name("the controller", "parameter", path, self._side.parameters)
        value = self.views[path].copy()
        value.flags.writeable = False
        return value

    def __setitem__(self, path: str, value: ArrayLike) -> None:
        checked = self._side.checked_parameter(path, value)
        if self._kernel.ready or self.changed:  # then it is known where the arm was in the last tick
            blocks = self._kernel.blocks
            q = blocks.layout["inputs"].views(blocks.seen)["q"].copy()
            self._side.check_change(q, self.views, {path: checked})
        if self._kept is None or self._kept[0] != self._kernel.count:
            self._kept = (self._kernel.count, self._kernel.blocks.parameters.copy())
        self.views[path][...] = checked
        if self._kernel.ready and self._side.blends((path,)):
            self.changed = True
            self._kernel.clear()

    def __contains__(self, path: object) -> bool:
        return path in self._side.parameters

    def get(self, path: str, default: Any = None) -> Any:
        """The value of a parameter, or the default where there is no such parameter."""
        return self[path] if path in self._side.parameters else default

    def __delitem__(self, path: str) -> None:
        raise UsageError(f"parameter '{path}' cannot be removed; set it", name=path)

    def __iter__(self) -> Iterator[str]:
        return iter(self._side.parameters)

    def __len__(self) -> int:
        return len(self._side.parameters)

    def __repr__(self) -> str:
        return "{" + ", ".join(f"'{path}': {short(value)}" for path, value in self.items()) + "}"

    def __reduce__(self) -> NoReturn:
        raise UsageError(
            "the parameters of a controller are what its machine code reads, so they cannot be copied or pickled; "
            "take dict(ctrl.parameters), and parameters.update(...) of another controller"
        )


def take_up_change(kernel: Kernel, before: Float64Array) -> None:
    """Change memory so that the next tick commands what it would have with the parameters of before.

    Args:
        kernel: Of a controller that blends; its inputs are those of the next tick.
        before: Parameters, flat.
    """
    asked = [kernel.preview(values)["limits.asked"] for values in (before, kernel.blocks.parameters)]
    take_up(kernel.blocks.views("memory"), *asked)


class BoundKernel:
    """A controller's arrays: write `q`, `v`, `ref.q`, ..., call `tick()`, read `command`. Nothing is allocated."""

    __slots__ = ("F_ext", "a_tip", "command", "q", "q_motor", "ref", "tau_meas", "tick", "v", "v_motor")

    def __init__(self, kernel: Kernel, reference: type[Sample]) -> None:
        inputs, empty = kernel.blocks.views("inputs"), np.zeros(0)
        self.q: Float64Array = inputs["q"]
        self.v: Float64Array = inputs.get("v", empty)
        self.F_ext: Float64Array = inputs.get("F_ext", empty)
        self.tau_meas: Float64Array = inputs.get("tau_meas", empty)
        self.q_motor: Float64Array = inputs.get("q_motor", empty)
        self.v_motor: Float64Array = inputs.get("v_motor", empty)
        self.a_tip: Float64Array = inputs.get("a_tip", empty)
        self.ref: Any = reference.of(subtree(inputs, "ref"))
        self.command: Float64Array = kernel.blocks.views("outputs")["command"]
        self.tick = kernel.tick

    def __setattr__(self, name: str, value: object) -> None:
        if name in self.__slots__ and hasattr(self, name):
            raise UsageError(
                f"{name} of a bound kernel is what the compiled code works on; write into it: k.{name}[:] = ...",
                name=name,
            )
        super().__setattr__(name, value)

    def __reduce__(self) -> NoReturn:
        raise UsageError(
            "bound arrays are those of one controller, so they cannot be copied or pickled; compile its law again "
            "and bind that: taut.compile(ctrl.law, ctrl.arm, rate=ctrl.rate).bind()"
        )
