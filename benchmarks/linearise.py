"""Draw docs/images/linearise_*.png, and print the table of docs/linearise.md: what a linear model costs.

Times are user time of this process; the differences are those of the same native kernel.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
from pathlib import Path

import numpy as np

os.environ["TAUT_CACHE_DIR"] = tempfile.mkdtemp()  # so that compiling is measured
sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "analysis"))

from sine_sweep import measured_Z

import taut
from taut.codegen.loop import StepLoop
from taut.linear.linearise import rest_of
from taut.linear.period import LoopMap, Point, loop_map
from taut.loop import Loop

IMAGES = Path(__file__).parent.parent / "docs" / "images"
REPEATS = 10
TICKS = 3000
STEPS = np.logspace(-9, -3, 13)


def user() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_utime


def loops() -> dict[str, Loop]:
    arm = taut.load_arm("panda")
    laws, plain = taut.laws, taut.RigidPlant(arm, friction=None)
    late = taut.RigidPlant(
        arm,
        friction=None,
        substeps=4,
        environment=taut.environments.Push(),
        actuation=taut.drives.Actuation(delay=1e-3, bandwidth=800.0),
    )
    inner = laws.TaskComputedTorque(kp=400.0, kd=40.0)
    admittance = laws.Admittance(D=(5.0, 0.1), B=(100.0, 3.0), K=(500.0, 30.0), inner=inner)
    filtered = taut.Sensing(velocity=taut.sensors.Difference(cutoff=60.0))
    return {
        "computed torque": Loop(
            taut.compile(laws.ComputedTorque(kp=100.0, kd=20.0, ki=50.0), arm), plain, duration=0.01
        ),
        "impedance": Loop(taut.compile(laws.Impedance(K=(800.0, 30.0), zeta=0.7), arm), plain, duration=0.01),
        "admittance, filters, delay, lag, 4 substeps": Loop(
            taut.compile(admittance, arm, sensing=filtered), late, duration=0.01
        ),
    }


def differences(made: LoopMap, point: Point, step: float, states: list[int]) -> np.ndarray:
    """(k, k) by central differences of the same native kernel."""
    coordinates = made.state_coordinates
    values = coordinates.read(point.memory, point.memory[np.newaxis])[0]
    steps = step * (1.0 + np.abs(values[states]))
    ways = coordinates.basis(point.memory)[states] * steps[:, np.newaxis]
    kernel = StepLoop(made.period, (point.inputs, point.parameters, point.memory), engine="native")
    after, record = point.memory + np.concatenate([ways, -ways]), np.zeros((1, kernel.outputs.size))
    for memory in after:
        assert kernel.run(point.inputs[np.newaxis], point.parameters, memory, record) == 1
    up, down = np.split(coordinates.read(point.memory, after)[:, states], 2)
    return ((up - down) / (2.0 * steps[:, np.newaxis])).T


def main() -> None:
    print("| Panda | states | loop [s] | derivative [s] | model [ms] | direction / difference | 1e-9 | best | 1e-3 |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    for name, loop in loops().items():
        begin = user()
        taut.run(loop)
        compiled = user() - begin
        begin = user()
        lin = taut.linearise(loop)
        derived = user() - begin
        begin = user()
        for _ in range(REPEATS):
            taut.linearise(loop)
        each = (user() - begin) / REPEATS
        made = loop_map(loop)
        point = rest_of(loop, made, None, 0.5).at
        states = [made.state_coordinates.names.index(state) for state in lin.states]
        size = np.abs(lin.A).max()
        errors = [np.abs(differences(made, point, h, states) - lin.A).max() / size for h in STEPS]
        best = int(np.argmin(errors))
        ratio = _ratio(made, point)
        print(
            f"| {name} | {len(lin.states)} | {compiled:.2f} | {derived:.2f} | {1e3 * each:.1f} | "
            f"{ratio:.2f} | {errors[0]:.0e} | {errors[best]:.0e} | {errors[-1]:.0e} |"
        )
    _pictures()


def _ratio(made: LoopMap, point: Point) -> float:
    """Time of an exact direction over that of a central difference: two ticks of the kernel that runs use."""
    example = (point.inputs, point.parameters, point.memory)
    kernel = StepLoop(made.period, example, engine="native")
    rows = np.tile(point.inputs, (TICKS, 1))
    record, memory = np.zeros((TICKS, kernel.outputs.size)), point.memory.copy()
    begin = user()
    assert kernel.run(rows, point.parameters, memory, record) == TICKS
    tick = (user() - begin) / TICKS
    given = [
        np.hstack([np.tile(flat, (TICKS, 1)), np.zeros((TICKS, block.size - len(flat)))])
        for flat, block in zip(
            (point.inputs, point.parameters, point.memory),
            (made.tangent.inputs, made.tangent.parameters, made.tangent.memory),
            strict=True,
        )
    ]
    begin = user()
    made.tangent.rows(*given)
    return (user() - begin) / TICKS / (2.0 * tick)


def _pictures() -> None:
    arm = taut.load_arm("panda")
    laws = taut.laws
    late = taut.RigidPlant(
        arm, friction=None, actuation=taut.drives.Actuation(delay=2e-3, bandwidth=300.0), substeps=4
    )
    sensing = taut.Sensing(velocity=taut.sensors.Difference(cutoff=60.0))
    law = laws.ComputedTorque(kp=100.0, kd=20.0, ki=50.0)
    lin = taut.linearise(Loop(taut.compile(law, arm, sensing=sensing), late, duration=1.0))
    lin.plot().savefig(IMAGES / "linearise_loop.png", dpi=110)
    law = laws.Impedance(K=(800.0, 30.0), zeta=0.7)
    tool = taut.analysis.tool_impedance(Loop(taut.compile(law, arm), late, duration=1.0), direction=[0.0, 0.0, 1.0])
    omega = 2.0 * np.pi * np.array([0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0])
    figure = tool.plot()
    measured = abs(measured_Z(tool, omega))
    figure.axes[0].loglog(omega / (2.0 * np.pi), measured, "o", markersize=4.0, label="measured, sine sweep")
    figure.axes[0].legend()
    figure.savefig(IMAGES / "linearise_tip.png", dpi=110)


if __name__ == "__main__":
    main()
