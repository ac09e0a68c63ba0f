"""Time taut against what a user would otherwise write; all figures are ratios within one run.

Run it with `make bench`. It prints a table and writes the figures to out/bench.json.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import rivals
import task_rivals
from rich.console import Console
from rich.table import Table
from timing import BareLoop, empty_cache, interleaved

import taut
from taut.maths.model import model_of

TICKS = 2000
CHOICES = Path(__file__).parents[1] / "docs" / "choose.md"
CHOICE = re.compile(r"^\|[^|`]*\| `([^`]+)`.* ([\d.]+) \|$", re.MULTILINE)  # law and time of a row


def main() -> int:
    """Measure everything, print it, and name the targets that are missed."""
    console = Console(width=110)
    figures = {**tick_figures(), **other_figures(), **phase_figures(), **task_figures(), **loop_figures()}
    figures |= {**joint_figures(), **start_figures(), **long_run_figures()}
    table = Table("figure", "measured", "target", title="taut against NumPy + Pinocchio and MuJoCo, Panda, one core")
    missed = []
    for name, figure in figures.items():
        bar = figure.get("bar")
        ok = bar is None or (figure["value"] >= bar if figure["better"] == "more" else figure["value"] <= bar)
        missed += [] if ok else [name]
        sign = "" if bar is None else f"{'>=' if figure['better'] == 'more' else '<='} {bar:g} {figure['unit']}"
        table.add_row(name, f"{figure['value']:.3g} {figure['unit']}  {figure.get('note', '')}", sign)
    console.print(table)
    sizes = size_figures()
    table = Table(
        "joints", "operations", "compile, cold [ms]", "cached [ms]", "bound tick [us]", title="a chain of n hinges"
    )
    for row in sizes:
        table.add_row(*(f"{x:g}" for x in row))
    console.print(table)
    choices = choice_figures()
    table = Table("law", "bound tick [us]", "on the page", title="docs/choose.md: Panda, or UR10 by its drives")
    for law, tick, page in choices:
        table.add_row(law, f"{tick:.2f}", f"{page:g}")
    console.print(table)
    out = Path("out")
    out.mkdir(exist_ok=True)
    (out / "bench.json").write_text(json.dumps({"figures": figures, "sizes": sizes, "choices": choices}, indent=1))
    console.print(
        f"figures in {out / 'bench.json'}" + (f"; missed: {', '.join(missed)}" if missed else "; all targets met")
    )
    return 1 if missed else 0


def tick_figures() -> dict[str, dict]:
    """One tick of computed torque, and inverse dynamics alone, from Python."""
    arm = rivals.ARM
    law = taut.laws.ComputedTorque(kp=rivals.KP, kd=rivals.KD, ki=rivals.KI)
    ctrl = taut.compile(law, arm)
    other = rivals.PinocchioLaw()
    rng = np.random.default_rng(0)
    q, v, a = arm.home + 0.1 * rng.standard_normal(7), rng.standard_normal(7), rng.standard_normal(7)
    sample = taut.JointMotion(q=arm.home, v=v, a=a)
    expected = other.natural(q, v, sample.q, sample.v, sample.a)
    got = ctrl.step(q, v, sample)
    assert np.abs(got - expected).max() < 1e-10 * np.abs(expected).max(), "the two laws differ"
    sensing = taut.Sensing(observer=taut.sensors.MomentumObserver(bandwidth=50.0))
    bound, watched = ctrl.bind(), taut.compile(law, arm, sensing=sensing).bind()
    for each in (bound, watched):
        each.q[:], each.v[:] = q, v
        each.ref.q[:], each.ref.v[:], each.ref.a[:] = sample.q, sample.v, sample.a
    model = model_of(arm)
    rnea = taut.native(lambda q, v, a: taut.dynamics.inverse_dynamics(model, q, v, a), q=7, v=7, a=7).call
    assert np.abs(rnea(q, v, a) - pin.rnea(other.model, other.data, q, v, a)).max() < 1e-10
    timing = interleaved(
        {
            "natural": "natural(q, v, ref.q, ref.v, ref.a)",
            "rnea form": "by_rnea(q, v, ref.q, ref.v, ref.a)",
            "tick": "tick()",
            "watched": "watched()",
            "step": "step(q, v, ref)",
            "native rnea": "rnea(q, v, a)",
            "pin.rnea": "pin.rnea(model, data, q, v, a)",
        },
        {
            "natural": other.natural,
            "by_rnea": other.by_rnea,
            "tick": bound.tick,
            "watched": watched.tick,
            "step": ctrl.step,
            "rnea": rnea,
            "pin": pin,
            "model": other.model,
            "data": other.data,
            "q": q,
            "v": v,
            "a": a,
            "ref": sample,
        },
    )
    us = {name: f"({1e6 * t.median:.2f} us, +-{100 * t.spread:.0f} %)" for name, t in timing.items()}
    natural = timing["natural"]
    return {
        "bound tick, times faster than M @ a + h": {
            "value": timing["tick"].times_faster_than(natural),
            "unit": "x",
            "bar": 16.0,
            "better": "more",
            "note": f"{us['tick']} against {us['natural']}",
        },
        "bound tick, times faster than rnea(q, v, a)": {
            "value": timing["tick"].times_faster_than(timing["rnea form"]),
            "unit": "x",
            "better": "more",
            "note": f"against {us['rnea form']}",
        },
        "bound tick with a momentum observer, times one without": {
            "value": timing["tick"].times_faster_than(timing["watched"]),
            "unit": "x",
            "bar": 2.4,
            "better": "less",
            "note": us["watched"],
        },
        "ctrl.step, times faster than M @ a + h": {
            "value": timing["step"].times_faster_than(natural),
            "unit": "x",
            "bar": 6.0,
            "better": "more",
            "note": us["step"],
        },
        "native inverse dynamics, times faster than pin.rnea": {
            "value": timing["native rnea"].times_faster_than(timing["pin.rnea"]),
            "unit": "x",
            "bar": 6.0,
            "better": "more",
            "note": f"{us['native rnea']} against {us['pin.rnea']}",
        },
    }


def other_figures() -> dict[str, dict]:
    """One tick of laws of section 10.6, adaptive ones and those of flexible joints, against computed torque."""
    arm, computed = rivals.ARM, taut.laws.ComputedTorque(kp=100.0, kd=20.0)
    adaptive = partial(taut.laws.Adaptive, lam=10.0, k=10.0, gamma=5.0, max_payload=2.0)
    rubbing = arm.with_friction(taut.Friction(viscous=0.5, coulomb=0.3))
    geared, spring = arm.with_joints(rotor_inertia=[0.6] * 4 + [0.2] * 3), [4000.0] * 4 + [1500.0] * 3
    cases = {
        "computed torque": (computed, arm),
        "adaptive control, payload": (adaptive(), arm),
        "adaptive control, payload and friction": (adaptive(gamma_friction=400.0), rubbing),
        "adaptive control, all links": (adaptive(links="all"), arm),
        "composite adaptation": (adaptive(composite=10.0), arm),
        "MotorSidePD": (taut.laws.MotorSidePD(stiffness=spring, kp=100.0, kd=20.0), geared),
        "FastTorqueLoop": (taut.laws.FastTorqueLoop(law=computed, stiffness=spring, bandwidth=200.0), geared),
        "FlexibleJointLinearisation": (taut.laws.FlexibleJointLinearisation(stiffness=spring, omega=30.0), geared),
    }
    bound = {name: taut.compile(law, its).bind() for name, (law, its) in cases.items()}
    for each in bound.values():  # at home at rest, where the estimates stay what they are
        each.q[:] = each.ref.q[:] = arm.home
        each.q_motor[:] = arm.home[: len(each.q_motor)]
    timing = interleaved({name: each.tick for name, each in bound.items()})
    return {
        f"bound tick of {name}, times computed torque's": {
            "value": timing["computed torque"].times_faster_than(t),
            "unit": "x",
            "bar": 4.0 if name == "adaptive control, payload" else None,
            "better": "less",
            "note": f"({1e6 * t.median:.2f} us)",
        }
        for name, t in timing.items()
        if name != "computed torque"
    }


def phase_figures() -> dict[str, dict]:
    """A tick of a task of three phases from Python, its references computed ahead, against that of its law alone."""
    arm, v = rivals.ARM, np.zeros(7)
    sine = taut.trajectories.Sine(center=arm.home, amplitude=0.1, frequency=0.3)
    steady = taut.trajectories.Steady(T0=taut.snapshot(arm, arm.home).T(), velocity=[0.0, 0.0, 1e-6])
    cases = {"ComputedTorque": sine, "TaskComputedTorque": steady}
    figures = {}
    for name, ref in cases.items():
        law = getattr(taut.laws, name)(kp=100.0, kd=20.0)
        alone, task = taut.compile(law, arm), taut.compile([taut.Phase(law, ref, name=phase) for phase in "abc"], arm)
        timing = interleaved(
            {"alone": "alone(q, v, sample)", "task": "task(q, v)"},
            {"alone": alone.step, "task": task.step, "q": arm.home, "v": v, "sample": ref.at(0.0)},
        )
        figures[f"ctrl.step of a task of three phases, times that of {name}"] = {
            "value": timing["alone"].times_faster_than(timing["task"]),
            "unit": "x",
            "better": "less",
            "note": f"({1e6 * timing['task'].median:.2f} us)",
        }
    return figures


def task_figures() -> dict[str, dict]:
    """One tick of task-space laws with a posture in their null space, and what a user waits for them."""
    arm, other = rivals.ARM, task_rivals.PinocchioTask()
    posture = taut.laws.Posture(q=arm.home)
    rng = np.random.default_rng(0)
    T = taut.snapshot(arm, arm.home).T()
    height = T.p[2]
    floor = taut.Constraint(lambda T: T.p[2] - height)
    q, v = taut.dynamics.onto(floor, arm, arm.home + 0.1 * rng.standard_normal(7)), rng.standard_normal(7)
    upwards = taut.snapshot(arm, q).J()[2]
    v -= upwards * (upwards @ v) / (upwards @ upwards)  # a state, and below a motion, that keep to the floor
    V, a = rng.standard_normal(6), rng.standard_normal(6)
    V[2] = a[2] = 0.0
    pose = T @ taut.Pose([0.05, 0.02, -0.03], rpy=[0.2, 0.1, -0.3])
    goal = pin.SE3(pose.R, pose.p)
    on_floor = taut.TaskMotion(pose=taut.Pose([*pose.p[:2], height], R=pose.R), twist=V, acceleration=a)
    cases = {
        "task computed torque": (
            taut.laws.TaskComputedTorque(kp=task_rivals.KP, kd=task_rivals.KD, error="body", null=posture),
            taut.TaskMotion(pose=pose, twist=V, acceleration=a, frame="tool"),
            other.computed_torque,
        ),
        "impedance": (
            taut.laws.Impedance(K=(800.0, 30.0), B=(50.0, 3.0), null=posture),
            taut.TaskMotion(pose=pose, twist=V, acceleration=a),
            other.impedance,
        ),
        "hybrid motion-force": (
            taut.laws.HybridMotionForce(
                constraint=floor,
                motion=taut.laws.TaskComputedTorque(kp=task_rivals.KP, kd=task_rivals.KD, null=posture),
                kfp=task_rivals.KFP,
                kfi=task_rivals.KFI,
            ),
            taut.pressing(on_floor, lam=task_rivals.F_DES[2:3]),
            other.hybrid,
        ),
    }
    figures = {}
    for name, (law, ref, natural) in cases.items():
        colds = []
        for _ in range(5):
            with empty_cache():
                start = time.perf_counter()
                ctrl = taut.compile(law, arm)
                colds.append(time.perf_counter() - start)
        cold = float(np.median(colds))
        wanted = goal if name != "hybrid motion-force" else pin.SE3(on_floor.R, on_floor.p)
        expected = natural(q, v, wanted, V, a)
        measured = {"F_ext": task_rivals.F_EXT} if "F_ext" in ctrl.needs else {}
        assert np.abs(ctrl.step(q, v, ref, **measured) - expected).max() < 1e-9 * np.abs(expected).max(), (
            f"{name}: they differ"
        )
        bound = ctrl.bind()
        bound.q[:], bound.v[:] = q, v
        if measured:
            bound.F_ext[:] = task_rivals.F_EXT
        for field in type(ref).fields(arm.n):
            getattr(bound.ref, field)[...] = getattr(ref, field)
        timing = interleaved(
            {"natural": "natural(q, v, goal, V, a)", "tick": "tick()"},
            {"natural": natural, "q": q, "v": v, "goal": goal, "V": V, "a": a, "tick": bound.tick},
        )
        us = {case: f"{1e6 * t.median:.2f} us, +-{100 * t.spread:.0f} %" for case, t in timing.items()}
        figures[f"{name}, times faster than NumPy + Pinocchio"] = {
            "value": timing["tick"].times_faster_than(timing["natural"]),
            "unit": "x",
            "bar": 60.0 if name == "hybrid motion-force" else 50.0,
            "better": "more",
            "note": f"({us['tick']} against {us['natural']}; {ctrl.operations} operations)",
        }
        figures[f"{name}, cold trace and compile"] = {"value": cold, "unit": "s", "bar": 1.0, "better": "less"}
    return figures


def loop_figures() -> dict[str, dict]:
    """The fused closed loop with its own plant model against loops in Python."""
    law = taut.laws.ComputedTorque(kp=rivals.KP, kd=rivals.KD, ki=rivals.KI)
    ref = taut.trajectories.Sine(center=rivals.CENTER, amplitude=rivals.AMPLITUDE, frequency=rivals.FREQUENCY)
    loaded = rivals.ARM.with_payload(rivals.PAYLOAD_MASS, rivals.PAYLOAD_COM, rivals.PAYLOAD_INERTIA)
    ctrl = taut.compile(law, rivals.ARM)
    own = BareLoop(ctrl, taut.RigidPlant(loaded, friction=None), ref, TICKS)
    empty = BareLoop(ctrl, taut.RigidPlant(rivals.ARM, friction=None), ref, TICKS)
    assert np.abs(own.run() - rivals.pinocchio_loop(TICKS)).max() < 1e-9, "the two loops differ"
    model = rivals.mujoco_model()
    assert np.abs(empty.run() - rivals.mujoco_loop(model, mujoco.MjData(model), TICKS)).max() < 1e-6
    plant, duration = taut.RigidPlant(loaded, friction=None), (TICKS - 1) * ctrl.dt
    timing = interleaved(
        {
            "fused": own.run,
            "pinocchio": lambda: rivals.pinocchio_loop(TICKS // 10),
            "mujoco": lambda: rivals.mujoco_loop(model, mujoco.MjData(model), TICKS // 10),
            "taut.run": lambda: taut.run(ctrl, plant, ref, duration=duration, q0=rivals.CENTER),
        },
        budget=0.1,
    )
    per_step = {"fused": TICKS, "pinocchio": TICKS // 10, "mujoco": TICKS // 10, "taut.run": TICKS}
    speed = {name: 1e-6 * per_step[name] / t.median for name, t in timing.items()}
    ratio = {
        name: np.median(timing[name].rounds / per_step[name] / (timing["fused"].rounds / TICKS)) for name in per_step
    }
    return {
        "fused loop, times the steps of NumPy + Pinocchio": {
            "value": float(ratio["pinocchio"]),
            "unit": "x",
            "bar": 40.0,
            "better": "more",
            "note": f"({speed['fused']:.2f} against {speed['pinocchio']:.3f} million steps/s)",
        },
        "fused loop, times the steps of MuJoCo + NumPy": {
            "value": float(ratio["mujoco"]),
            "unit": "x",
            "bar": 32.0,
            "better": "more",
            "note": f"(against {speed['mujoco']:.3f} million steps/s)",
        },
        "taut.run of 2000 ticks, everything recorded": {
            "value": speed["taut.run"],
            "unit": "M steps/s",
            "better": "more",
            "note": "(of the same controller and plant again)",
        },
    }


def joint_figures() -> dict[str, dict]:
    """What real joints cost in the fused loop: gears, Stribeck friction, amplifiers, encoders, and more."""
    ideal = taut.load_arm("panda").with_joints(viscous=0.0, coulomb=0.0)
    friction = taut.Friction(viscous=0.5, coulomb=1.0, static=1.5, stribeck=0.05)
    arm = ideal.with_gears(ratio=100.0, motor_inertia=1e-6).with_friction(friction)
    law = taut.laws.ComputedTorque(kp=rivals.KP, kd=rivals.KD, ki=rivals.KI)
    ref = taut.trajectories.Sine(center=rivals.CENTER, amplitude=rivals.AMPLITUDE, frequency=rivals.FREQUENCY)
    measured, differenced = (
        taut.compile(law, ideal, sensing=taut.Sensing(velocity=v)) for v in ("measured", "difference")
    )
    encoder = taut.sensors.Encoder(resolution=1e-5)
    seen = taut.sensors.Sensors(position=encoder, velocity=None)
    noisy = taut.sensors.Sensors(position=taut.sensors.Encoder(resolution=1e-5, noise=1e-6), velocity=None)
    lag = {"bandwidth": 1000.0}
    soft = {"stiffness": 1e4, "damping": 1.0}

    def loop(ctrl: taut.Controller, plant: taut.RigidPlant) -> BareLoop:
        return BareLoop(ctrl, plant, ref, TICKS)

    def joints(sensors: taut.sensors.Sensors, substeps: int = 1, **drives: object) -> taut.RigidPlant:
        return taut.RigidPlant(
            arm, actuation=taut.drives.Actuation(**lag, **drives), sensors=sensors, substeps=substeps
        )

    loops = {
        "bare": loop(measured, taut.RigidPlant(ideal)),
        "encoders": loop(differenced, taut.RigidPlant(ideal, sensors=seen)),
        "friction": loop(measured, taut.RigidPlant(arm)),
        "all": loop(differenced, joints(seen)),
        "noise": loop(differenced, joints(noisy)),
        "elastic": loop(differenced, joints(seen, transmission=taut.drives.Transmission(**soft), substeps=4)),
        "play": loop(
            differenced, joints(seen, transmission=taut.drives.Transmission(**soft, backlash=1e-3), substeps=4)
        ),
    }
    timing = interleaved({name: own.run for name, own in loops.items()}, budget=0.1)
    share = {name: 100.0 * float(np.median(timing["bare"].rounds / t.rounds)) for name, t in timing.items()}

    def figure(name: str, note: str, bar: float | None = None) -> dict:
        speed = 1e-6 * TICKS / timing[name].median
        out = {"value": share[name], "unit": "%", "better": "more", "note": f"({speed:.2f} million steps/s; {note})"}
        return out if bar is None else {**out, "bar": bar}

    return {
        "steps of the bare loop that are left with encoders": figure("encoders", "quantised, differenced velocity"),
        "... with gears and Stribeck friction": figure("friction", "7 joints that stick and slip together"),
        "... with both, and amplifiers with a lag": figure("all", "every stage at once", bar=25.0),
        "... and seeded noise": figure("noise", "drawn before the loop, which is not timed"),
        "... and elastic joints": figure("elastic", "4 steps of the integrator in a period"),
        "... and play": figure("play", "4 steps of the integrator in a period"),
    }


def start_figures() -> dict[str, dict]:
    """What a user waits for: import, first compile, compile from the cache."""
    law = taut.laws.ComputedTorque(kp=rivals.KP, kd=rivals.KD, ki=rivals.KI)
    colds = []
    for _ in range(7):
        with empty_cache():
            start = time.perf_counter()
            taut.compile(law, rivals.ARM)
            colds.append(time.perf_counter() - start)
    cached = interleaved({"cached": lambda: taut.compile(law, rivals.ARM)}, budget=0.1)["cached"]
    code = "import time; t = time.perf_counter(); import taut; print(time.perf_counter() - t)"
    imports = [
        float(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True).stdout)
        for _ in range(7)
    ]
    return {
        "cold trace and compile": {"value": float(np.median(colds)), "unit": "s", "bar": 0.5, "better": "less"},
        "compile from the cache": {"value": 1e3 * cached.median, "unit": "ms", "bar": 30.0, "better": "less"},
        "import taut": {"value": float(np.median(imports)), "unit": "s", "bar": 0.3, "better": "less"},
    }


LONG_RUN = """
import resource, sys, taut
arm = taut.load_arm("panda")
ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=10.0), arm)
ref = taut.trajectories.Sine(center=arm.home, amplitude=0.1, frequency=0.3)
run = taut.run(ctrl, taut.RigidPlant(arm), ref, duration=600.0, log=sys.argv[1] or None, progress=False)
assert run.outcome.ok and len(run) == 600_001
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
"""


def long_run_figures() -> dict[str, dict]:
    """Ten minutes at 1 kHz with all terms, alone and with a log that is written meanwhile: peak of memory, time."""
    figures = {}
    for name, file in (("10-minute run", ""), ("10-minute run with log=", "run.mcap")):
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            done = subprocess.run(
                [sys.executable, "-c", LONG_RUN, file], cwd=folder, capture_output=True, check=True, text=True
            )
            seconds = time.perf_counter() - start
            size = sum(path.stat().st_size for path in Path(folder).iterdir()) / 1e6
        note = f"({seconds:.1f} s" + (f", a log of {size:.0f} MB)" if file else ")")
        figures[name] = {"value": float(done.stdout), "unit": "GB", "bar": 1.5, "better": "less", "note": note}
    return figures


def size_figures() -> list[list[float]]:
    """Operations, compile time and tick of computed torque for chains of 1 to 30 hinges."""
    rows = []
    for n in (1, 2, 3, 5, 7, 10, 15, 20, 30):
        arm = rivals.chain(n)
        law = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
        with empty_cache():
            start = time.perf_counter()
            ctrl = taut.compile(law, arm)
            cold = time.perf_counter() - start
            start = time.perf_counter()
            taut.compile(law, arm)
            cached = time.perf_counter() - start
        bound = ctrl.bind()
        bound.q[:] = bound.ref.q[:] = arm.home
        tick = interleaved({"tick": bound.tick}, rounds=7, budget=0.02)["tick"]
        rows.append([n, ctrl.operations, round(1e3 * cold), round(1e3 * cached, 1), round(1e6 * tick.median, 2)])
    return rows


def choice_figures() -> list[tuple[str, float, float]]:
    """Each law of docs/choose.md, its bound tick at home at rest, and the time that the page has [us]."""
    page, ticks = {}, {}
    for name, text in zip(("panda", "ur10"), CHOICES.read_text(encoding="utf-8").split("## Velocities"), strict=True):
        arm = taut.load_arm(name)
        T = taut.snapshot(arm, arm.home).T()
        for code, us in CHOICE.findall(text):
            law = eval(code, {"taut": taut, "laws": taut.laws, "arm": arm})
            bound = taut.compile(law, arm).bind()
            bound.q[:] = arm.home
            for field, value in {"q": arm.home, "p": T.p, "R": T.R}.items():
                if field in dir(bound.ref):
                    getattr(bound.ref, field)[:] = value
            page[code], ticks[code] = float(us), bound.tick
    timing = interleaved(ticks)
    return [(code, 1e6 * timing[code].median, us) for code, us in page.items()]


if __name__ == "__main__":
    sys.exit(main())
