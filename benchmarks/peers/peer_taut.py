"""taut itself: what the peers are compared with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from task import arm_of
from timing import BareLoop
from worker import Case, Task

import taut
from taut.codegen.program import Block, Program, trace
from taut.loop import DT

TICKS = 2000


def computed_torque(task: Task, robot: str) -> taut.Controller:
    return taut.compile(taut.laws.ComputedTorque(kp=task.kp, kd=task.kd), arm_of(robot))


def tick(task: Task, robot: str) -> Case:
    step = computed_torque(task, robot).step
    rows = [(q, v, taut.JointMotion(q=q_des, v=v_des, a=a_des)) for q, v, q_des, v_des, a_des in task.states(robot)]
    return Case(lambda: [step(*row) for row in rows], len(rows), "ctrl.step(q, v, ref)")


def impedance(task: Task) -> Case:
    par = task.impedance
    posture = taut.laws.Posture(q=par["rest"], kp=float(par["kp"]), kd=float(par["kd"]))
    law = taut.laws.Impedance(K=par["K"], B=par["B"], null=posture)
    step = taut.compile(law, arm_of("panda")).step
    rows = [
        (q, v, taut.TaskMotion(pose=taut.Pose(p, R=R), twist=V, acceleration=a))
        for (q, v, *_), (p, R, V, a) in zip(task.states("panda"), task.targets(), strict=True)
    ]
    return Case(lambda: [step(*row) for row in rows], len(rows), "ctrl.step(q, v, ref)")


def parts(task: Task, robot: str) -> tuple[taut.Controller, taut.RigidPlant, taut.trajectories.Sine]:
    """Controller, plant with the payload, and motion."""
    center, amplitude, omega = task.sine(robot)
    ref = taut.trajectories.Sine(center=center, amplitude=amplitude, frequency=omega / (2.0 * np.pi))
    return computed_torque(task, robot), taut.RigidPlant(arm_of(robot + "_loaded"), friction=None), ref


def closed(task: Task, robot: str, ticks: int) -> taut.Loop:
    return taut.Loop(*parts(task, robot), duration=ticks * task.dt)


def start(task: Task, robot: str) -> dict[str, Any]:
    q0, v0, _ = task.motion(robot)(0.0)
    return {"q0": q0, "v0": v0}


def run(task: Task, robot: str) -> Case:
    """Joint positions at all ticks."""
    loop, first = closed(task, robot, TICKS), start(task, robot)
    return Case(lambda: taut.run(loop, **first, progress=False).q, TICKS, "taut.run, everything recorded")


def bare_loop(task: Task, robot: str) -> Case:
    return Case(BareLoop(*parts(task, robot), TICKS).run, TICKS, "the fused loop, nothing recorded")


def sweep(task: Task, samples: int, ticks: int, real: str = "double") -> Case:
    """RMS error of each sample, on one core: other gains and another payload in each."""
    loop, first = closed(task, "panda", ticks - 1), start(task, "panda")
    paths = ("law.kp", "law.kd", "plant.payload.mass")
    vary = {path: column.tolist() for path, column in zip(paths, task.gains[:samples].T, strict=True)}

    def call() -> Any:
        found = taut.sweep(
            loop, vary, samples=samples, metrics=["rms_error"], workers=1, real=real, progress=False, **first
        )
        return found.table["rms_error"]

    return Case(call, samples * ticks, f"taut.sweep, {real}, one core")


class Word(np.lib.mixins.NDArrayOperatorsMixin):
    """A value of a program that is written down as Python, line by line, while NumPy's functions are called on it."""

    def __init__(self, text: str, lines: list[str]) -> None:
        self._text, self._lines = text, lines

    def __str__(self) -> str:
        return self._text

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *operands: Any) -> Word:
        assert method == "__call__"
        return self.written(ufunc.__name__, *operands)

    def written(self, function: str, *operands: Any) -> Word:
        name = f"x{len(self._lines)}"
        self._lines.append(f"    {name} = np.{function}({', '.join(map(str, operands))})")
        return Word(name, self._lines)


def write_graphs(task: Task) -> None:
    """The Panda's law and the step of its loop as straight-line Python: graphs.py in the task's folder."""
    ctrl, loop = computed_torque(task, "panda"), closed(task, "panda", TICKS)
    law = ctrl.program
    inputs, parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
    values, row = parameters.pack({**loop.parameters, DT: loop.dt}), inputs.zeros()
    for path, value in zip(("ref.q", "ref.v", "ref.a"), task.motion("panda")(0.0), strict=True):
        inputs.views(row)[path][:] = value
    q0, v0, _ = task.motion("panda")(0.0)
    first = loop.start(q0, v0, inputs.views(row), parameters.views(values))
    memory = Block.of({path: np.shape(value) for path, value in first.items()})
    step = trace(lambda *blocks: ({}, loop.step(*blocks)[1]), inputs, parameters, memory)
    head = {
        "TICK_INPUTS": list(law.inputs.shapes),
        "TICK_PARAMETERS": law.parameters.pack({**ctrl.parameters, DT: task.dt}).tolist(),
        "TICK_MEMORY": law.memory.zeros().tolist(),
        "INPUTS": list(inputs.shapes),
        "PARAMETERS": values.tolist(),
        "PLACES": {field.path: (field.offset, field.size) for field in (*parameters.fields, *memory.fields)},
        "MEMORY": memory.pack(first).tolist(),
    }
    rows = [f"{name} = {value}" for name, value in head.items()]
    rows += [*python("tick", law, outputs=True), *python("step", step, outputs=False)]
    (task.folder / "graphs.py").write_text("\n".join(rows) + "\n")


def python(name: str, program: Program, *, outputs: bool) -> list[str]:
    """A program as `name(np, inputs, parameters, memory)`, a line for each operation; outputs, or memory."""
    lines: list[str] = []
    count = program.inputs.size + program.parameters.size + program.memory.size
    symbols = [Word("{}[{}]".format(*program.place_of_input(i)), lines) for i in range(count)]
    ends = program.evaluated(symbols, lambda *operands: symbols[0].written("where", *operands))[0 if outputs else 1]
    head = f"def {name}(np, inputs, parameters, memory):"
    return [head, *lines, f"    return [{', '.join(map(str, ends))}]"]


CASES: Mapping[str, Callable[..., Case]] = {
    "tick": tick,
    "impedance": impedance,
    "run": run,
    "bare_loop": bare_loop,
    "sweep": sweep,
}
