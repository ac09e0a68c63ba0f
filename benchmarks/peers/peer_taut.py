"""taut itself: what the peers are compared with, and how its cost grows."""

from __future__ import annotations

import dataclasses
import functools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from worker import Case, Task

sys.path.insert(0, str(Path(__file__).parents[1]))

import rivals
from timing import BareLoop, empty_cache

import taut
from taut.codegen.program import Block, Program, trace
from taut.loop import DT
from taut.trace.graph import Op

RUN_TICKS = 2000
POSTURE = taut.laws.Posture(q=rivals.ARM.home)
TASK_GAINS = {"kp": [100.0, 100.0, 100.0, 64.0, 64.0, 64.0], "kd": [20.0, 20.0, 20.0, 16.0, 16.0, 16.0]}


@functools.cache
def arm_of(robot: str) -> taut.Arm:
    """The Panda of the other benchmarks, or a chain of n hinges; "_loaded" with the payload.

    Gravity is the standard one, since dynibo has no other.
    """
    name = robot.removesuffix("_loaded")
    arm = rivals.ARM if name == "panda" else rivals.chain(int(name.removeprefix("chain")))
    arm = dataclasses.replace(arm, gravity=[0.0, 0.0, -9.80665])
    if name == robot:
        return arm
    return arm.with_payload(rivals.PAYLOAD_MASS, rivals.PAYLOAD_COM, rivals.PAYLOAD_INERTIA)


def computed_torque(task: Task) -> taut.Law:
    return taut.laws.ComputedTorque(kp=task.kp, kd=task.kd)


def joint_samples(task: Task, robot: str) -> list[tuple[Any, ...]]:
    rows = task.states(robot)
    return [(q, v, taut.JointMotion(q=q_des, v=v_des, a=a_des)) for q, v, q_des, v_des, a_des in rows]


def task_samples(task: Task) -> list[tuple[Any, ...]]:
    return [
        (q, v, taut.TaskMotion(pose=taut.Pose(p, R=R), twist=V, acceleration=a))
        for (q, v, *_), (p, R, V, a) in zip(task.states("panda"), task.targets(), strict=True)
    ]


def steps_of(ctrl: taut.Controller, rows: list[tuple[Any, ...]]) -> Case:
    step = ctrl.step
    return Case(lambda: [step(q, v, ref) for q, v, ref in rows], len(rows), "ctrl.step(q, v, ref)")


def tick(task: Task, robot: str) -> Case:
    return steps_of(taut.compile(computed_torque(task), arm_of(robot)), joint_samples(task, robot))


def bound_tick(task: Task, robot: str) -> Case:
    """The kernel on arrays that stay in their places: at the first state."""
    bound = taut.compile(computed_torque(task), arm_of(robot)).bind()
    bound.q[:], bound.v[:], bound.ref.q[:], bound.ref.v[:], bound.ref.a[:] = task.states(robot)[0]

    def call() -> Any:
        for _ in range(20):
            bound.tick()
        return bound.tau

    return Case(call, 20, "bound tick()")


def task_tick(task: Task) -> Case:
    law = taut.laws.Impedance(K=(800.0, 30.0), B=(50.0, 3.0), null=POSTURE)
    return steps_of(taut.compile(law, arm_of("panda")), task_samples(task))


def motion(task: Task, robot: str) -> taut.trajectories.Sine:
    center, amplitude, omega = task.sine(robot)
    return taut.trajectories.Sine(center=center, amplitude=amplitude, frequency=omega / (2.0 * np.pi))


def closed(task: Task, robot: str, ticks: int) -> taut.Loop:
    plant = taut.RigidPlant(arm_of(robot + "_loaded"), friction=None)
    ctrl = taut.compile(computed_torque(task), arm_of(robot))
    return taut.Loop(ctrl, plant, motion(task, robot), duration=ticks * ctrl.dt)


def run(task: Task, robot: str) -> Case:
    """Joint positions at all ticks."""
    loop, (q0, v0, _) = closed(task, robot, RUN_TICKS), task.motion(robot)(0.0)
    how = "taut.run, everything recorded; semi-implicit Euler"
    return Case(lambda: taut.run(loop, q0=q0, v0=v0, progress=False).q, RUN_TICKS, how)


def bare_loop(task: Task, robot: str) -> Case:
    """The fused loop without a record: joint positions at the end."""
    ctrl = taut.compile(computed_torque(task), arm_of(robot))
    plant = taut.RigidPlant(arm_of(robot + "_loaded"), friction=None)
    return Case(BareLoop(ctrl, plant, motion(task, robot), RUN_TICKS).run, RUN_TICKS, "the same loop, nothing recorded")


def sweep(task: Task, samples: int, ticks: int, real: str, workers: int = 1) -> Case:
    """RMS error of each sample: other gains and another payload in each."""
    loop, (q0, v0, _) = closed(task, "panda", ticks - 1), task.motion("panda")(0.0)
    paths = ("law.kp", "law.kd", "plant.payload.mass")
    columns = np.resize(task.gains, (samples, 3)).T
    vary = {path: column.tolist() for path, column in zip(paths, columns, strict=True)}
    options = {"samples": samples, "q0": q0, "v0": v0, "metrics": ["rms_error"], "workers": workers, "real": real}
    how = f"taut.sweep(metrics=['rms_error'], workers={workers}), {real}; semi-implicit Euler"

    def call() -> Any:
        return taut.sweep(loop, vary, progress=False, **options).table["rms_error"]

    return Case(call, samples * ticks, how)


def laws(task: Task) -> dict[str, tuple[taut.Law, Callable[[], list[tuple[Any, ...]]]]]:
    """Laws of growing size, and the samples of their references."""
    joints, tool = functools.partial(joint_samples, task, "panda"), functools.partial(task_samples, task)
    return {
        "PID": (taut.laws.PID(kp=100.0, ki=10.0, kd=20.0), joints),
        "GravityPID": (taut.laws.GravityPID(kp=100.0, ki=10.0, kd=20.0), joints),
        "ComputedTorque": (computed_torque(task), joints),
        "Impedance(K, B, null=None)": (taut.laws.Impedance(K=(800.0, 30.0), B=(50.0, 3.0), null=None), tool),
        "Impedance(K, B)": (taut.laws.Impedance(K=(800.0, 30.0), B=(50.0, 3.0), null=POSTURE), tool),
        "TaskComputedTorque": (taut.laws.TaskComputedTorque(**TASK_GAINS, error="body", null=POSTURE), tool),
        "Impedance(K, zeta)": (taut.laws.Impedance(K=(800.0, 30.0), zeta=0.7, null=POSTURE), tool),
    }


def law_tick(task: Task, name: str) -> Case:
    law, rows = laws(task)[name]
    ctrl = taut.compile(law, arm_of("panda"))
    case = steps_of(ctrl, rows())
    return Case(case.call, case.steps, str(ctrl.operations))


def compiling(task: Task, robot: str) -> Case:
    """Trace and compile with nothing in the cache."""
    law, arm = computed_torque(task), arm_of(robot)

    def call() -> int:
        with empty_cache():
            return taut.compile(law, arm).operations

    return Case(call, 1, "taut.compile, cold")


def graph(task: Task) -> Case:
    """The fused step as a module in plain Python, for JAX: taut_step.py in the folder of the task."""
    loop = closed(task, "panda", RUN_TICKS)
    inputs, parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
    values, row = parameters.pack({**loop.parameters, DT: loop.dt}), inputs.zeros()
    q0, v0, a0 = task.motion("panda")(0.0)
    for path, value in (("ref.q", q0), ("ref.v", v0), ("ref.a", a0)):
        inputs.views(row)[path][:] = value
    first = loop.start(q0, v0, inputs.views(row), parameters.views(values))
    memory = Block.of({path: np.shape(value) for path, value in first.items()})
    program = trace(lambda *blocks: ({}, loop.step(*blocks)[1]), inputs, parameters, memory)
    places = {field.path: (field.offset, field.size) for field in parameters.fields}
    state = memory.field("plant.q")
    text = [
        f"INPUTS = {list(inputs.shapes)}",
        f"PARAMETERS = {values.tolist()}",
        f"PLACES = {places}",
        f"MEMORY = {memory.pack(first).tolist()}",
        f"STATE = {(state.offset, state.size)}",
        *written(program),
    ]
    (task.folder / "taut_step.py").write_text("\n".join(text) + "\n")
    return Case(lambda: program.operations, 1, "operations of the step")


SIGNS = {Op.ADD: "+", Op.SUB: "-", Op.MUL: "*", Op.DIV: "/", Op.LT: "<", Op.LE: "<=", Op.EQ: "=="}
NAMES = {
    Op.NEG: "negative", Op.SQRT: "sqrt", Op.SIN: "sin", Op.COS: "cos", Op.ASIN: "arcsin", Op.ACOS: "arccos",
    Op.ATAN2: "arctan2", Op.EXP: "exp", Op.LOG: "log", Op.TANH: "tanh", Op.ABS: "abs", Op.FLOOR: "floor",
    Op.MIN: "minimum", Op.MAX: "maximum", Op.AND: "logical_and", Op.OR: "logical_or", Op.NOT: "logical_not",
    Op.SELECT: "where",
}  # fmt: skip


def written(program: Program) -> list[str]:
    """The program as `step(np, inputs, parameters, memory)`, one line for each operation."""
    nodes, lines = program.graph, ["def step(np, inputs, parameters, memory):"]
    for i in program.live:
        op = Op(nodes.ops[i])
        names = [f"x{k}" for k in nodes.operands(i)] if op not in (Op.CONST, Op.INPUT) else []
        if op == Op.CONST:
            value = repr(float(nodes.value[i]))
        elif op == Op.INPUT:
            value = "{}[{}]".format(*program.place_of_input(nodes.a[i]))
        elif op in SIGNS:
            value = f" {SIGNS[op]} ".join(names)
        else:
            value = f"np.{NAMES[op]}({', '.join(names)})"
        lines.append(f"    x{i} = {value}")
    return [*lines, f"    return [{', '.join(f'x{i}' for i in program.memory_nodes)}]"]


CASES: dict[str, Callable[..., Case]] = {
    "tick": tick,
    "bound_tick": bound_tick,
    "task_tick": task_tick,
    "run": run,
    "bare_loop": bare_loop,
    "sweep": sweep,
    "law_tick": law_tick,
    "compile": compiling,
    "graph": graph,
}
