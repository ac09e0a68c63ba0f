"""The Controller: a law or a task, compiled for one arm and one rate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NoReturn

from taut.arm.description import Arm
from taut.base.errors import RangeError, UsageError
from taut.base.paths import Named, subtree
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.codegen.engine import Engine
from taut.codegen.kernel import Kernel
from taut.codegen.program import Program, trace
from taut.control.law import Law
from taut.control.lawside import LawSide
from taut.control.trajectories.reference import Sample
from taut.controller.calls import BoundKernel, checked_arguments, sample_arguments, step_arguments
from taut.controller.kernel import SideFunctions, kernel_of, recording_kernel, reference_shapes
from taut.controller.parameters import ControllerParameters, StateMachine
from taut.maths.model import Adds

if TYPE_CHECKING:
    from taut.control.tasks.feed import TaskSteps
    from taut.control.tasks.task import Task
    from taut.controller.batch import Batch, Device, RealName


class Controller:
    """A law with its sensing and limits, compiled for one arm. Made by `taut.compile`.

    One thread at a time steps a controller and writes into its bound arrays: a tick that begins while another thread
    is in one is refused. Each thread needs a controller of its own.
    """

    def __init__(self, side: LawSide, engine: Engine) -> None:
        self.side = side
        self._machine = machine = StateMachine(side)
        self._kernel = kernel_of(side, engine, slow=self._slow, first=machine.first, failed=machine.failed)
        machine.kernel = self._kernel
        self.parameters = ControllerParameters(side, machine)
        self._inputs = self._kernel.blocks.views("inputs")
        self._command = next(iter(self._kernel.blocks.views("outputs").values()))
        self._task: TaskSteps | None = None
        # The builtin stands before the method that documents it; before that of a task, what places its samples.
        vars(self)["step"] = self._kernel.step
        if side.task is not None:
            self._task = self._steps_of(side.task)
            vars(self)["step"] = self._task.around(self._kernel.step, self._slow)

    def _steps_of(self, task: Task) -> TaskSteps:
        from taut.control.tasks.feed import TaskSteps

        blocks, wanted = self._kernel.blocks, reference_shapes(self.side)
        fields = [field for field in blocks.layout["inputs"].fields if field.path in wanted]
        sample = blocks.inputs[fields[0].offset : fields[-1].offset + fields[-1].size]
        return TaskSteps(self.side, task, blocks.views("memory"), sample)

    def recording_kernel(self, sensed: tuple[str, ...] = (), ticks: int | None = None) -> Kernel:
        """A kernel of the same law with blocks of its own that gives every term in every tick: for simulations.

        It gives the measurements `sensed` too; for few `ticks` it is compiled quickly.
        """
        kernel = recording_kernel(self.side, self.engine, sensed, ticks)
        kernel.blocks.parameters[:] = self._kernel.blocks.parameters
        return kernel

    @property
    def law(self) -> Law | Task:
        """The law, with the gains it was compiled with; or the task."""
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
        """Components that the plant is expected to add itself."""
        return self.side.adds

    @property
    def needs(self) -> tuple[str, ...]:
        """Measurements that are needed besides positions."""
        return self.side.needs

    @property
    def kind(self) -> str:
        """The kind of command: torque, velocity, position or mit."""
        return self.side.gives

    @property
    def engine(self) -> Engine:
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
        functions = SideFunctions(self.side, record=False)
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
            (n,) the command, a new array; (5, n) q, v, kp, kd and tau of a law that gives a MitCommand.

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
        given, ref = step_arguments(self.side, args, kwargs)
        kernel, tick = self._kernel, self.ticks if self._machine.started else 0
        with kernel.alone:
            if self._task is not None:
                self._task.place(tick, self._machine.started, given, ref, self.parameters.views)
            else:
                given |= sample_arguments(self.side, ref)
            checked = checked_arguments(self.side, given, self._inputs, tick)
            for path, value in checked.items():  # nothing is written before all is checked
                self._inputs[path][...] = value
            kernel.tick()
            return self._command.copy()

    def reset(self, tau_applied: ArrayLike | None = None) -> None:
        """Start memory anew, in the next tick, from what is measured then.

        Args:
            tau_applied: (n,) the command that the plant has now, from which a rate limit and a blend start: the last
                one of the controller before. The model's gravity torque if left out.

        Raises:
            UsageError: A torque for a controller that does not remember one.
        """
        self._machine.reset(tau_applied)

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

    def batch(
        self, n: int, *, device: Device = "cpu", real: RealName = "double", threads: int | None = None
    ) -> Batch:
        """Controllers of this law for n arms, stepped together on arrays of NumPy, torch, JAX or Warp.

        It is for simulators of your own, whose arrays it reads and writes where they are. It starts with the
        parameters that this controller has now.

        Args:
            n: Number of lanes.
            device: Where arrays are and code runs; "cuda" is the first NVIDIA GPU of this machine.
            real: Type of all numbers, "double" for float64 or "float" for float32.
            threads: At most so many; as many as there are cores if left out. Where there is little to do, fewer run.

        Raises:
            UsageError: Another device or type, no GPU, a controller of a task, or one in the float engine.
            RangeError: More lanes than memory holds.
            MissingExtraError: device="cuda" without cuda-bindings.

        Example:
            >>> import numpy as np, taut
            >>> ctrl = taut.compile(taut.laws.PID(kp=10.0), taut.load_arm("planar2"))
            >>> batch = ctrl.batch(3)
            >>> batch.parameters["law.kp"] = [1.0, 2.0, 3.0]
            >>> batch.step(np.zeros((3, 2)), np.zeros((3, 2)), taut.JointMotion(q=[1.0, 2.0])).tolist()
            [[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]]
        """
        from taut.controller.batch import Batch

        try:
            return Batch(self, n, device, real, threads)
        except MemoryError as cause:
            raise RangeError(
                f"the arrays of {n:g} lanes need more memory than there is; make n smaller", name="n"
            ) from cause

    @property
    def phase(self) -> str:
        """The phase of a task that the coming tick belongs to, or "stop". UsageError for a controller of a law."""
        if self._task is None:
            raise UsageError("a controller of one law has no phases; compile a list of taut.Phase", name="phase")
        return self._task.name(self._machine.started)

    @property
    def terms(self) -> Mapping[str, Vector]:
        """The named terms of the last tick, computed on demand; they sum to the command. UsageError before a tick."""
        outputs = self._last_tick("terms", SideFunctions(self.side, record=True))
        return Named(f"the controller's {self.side.title}", "term", subtree(outputs, "terms"))

    @property
    def sensed(self) -> Mapping[str, Float64Array]:
        """The filtered measurements of the last tick as the law saw them, by name. UsageError before a tick.

        With `taut.sensors.Wrist(range=...)` also saturated.F_ext: 1.0 if the reading was at the end of its range.
        """
        used = self.side.probe.used | {"tau_ext"}
        estimated = (name for name in self.side.sensing.estimates if name in used)
        names = ("q", "v", *(name for name in self.side.takes if name != "v"), *estimated)
        outputs = self._last_tick("sensed", SideFunctions(self.side, record=True, sensed=names))
        seen = subtree(outputs, "sensed") | {name: outputs[name] for name in self.side.sensing.tells}
        return Named("the controller's sensing", "measurement", seen)

    def _last_tick(self, what: str, functions: SideFunctions) -> dict[str, Float64Array]:
        """The last tick once more, on floats, with all that it can give."""
        if self.ticks == 0:
            kind = "terms" if what == "terms" else "measurements"
            raise UsageError(f"there are no {kind} before the first tick; call step first", name=what)
        return functions.last_tick(self._kernel, self._machine.parameters_of_last_tick())

    @property
    def memory(self) -> Mapping[str, Float64Array]:
        """Copy of the memory after a tick, by path: law.e_int, limits.tau_applied. UsageError before the first."""
        if self.ticks == 0:
            raise UsageError("there is no memory before the first tick; call step first", name="memory")
        views = self._kernel.blocks.views("memory")
        return Named("the controller", "memory entry", {path: view.copy() for path, view in views.items()})

    def explain(self) -> None:
        """Print the law, its gains with units, the closed loop it yields, and what a tick costs."""
        print(self.explanation())

    def explanation(self) -> str:
        """The text that `explain` prints."""
        from taut.controller.explain import explanation

        return explanation(self)
