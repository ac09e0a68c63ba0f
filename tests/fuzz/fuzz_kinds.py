"""What is fuzzed: for each kind of file some sound ones, how their meaning is changed, and how they are read."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import sys
import tempfile
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_logs import write_log
from fuzz_mutants import mutated, of_json, of_rows, of_toml, of_values, of_xml
from numpy.random import Generator

import taut
from taut.arm.report import check_model
from taut.maths.dynamics import mass_matrix
from taut.maths.model import Adds, model_of
from taut.record.info import ServoInfo
from taut.record.log.reading import intact_parts

sys.path.insert(0, str(Path(__file__).parents[1] / "arm"))
from arm_models import DUO, PAIR
from arm_urdf_text import as_urdf

POSES = 100
EXAMINED = 25  # one log in so many is judged by the doctor, too


class NotDefiniteError(Exception):
    """An arm was accepted whose mass matrix is not positive definite."""


Reader = Callable[[Path], object]
Maker = Callable[[int, Generator, Path], Path]


# -------------------------------------------------------------------- models


MJCF = """<mujoco model="arm"><compiler angle="radian"/><option timestep="0.002" gravity="0 0 -9.81"/>
<default><joint damping="0.1" armature="0.01"/><geom density="800"/></default>
<worldbody><body name="base"><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
<body name="a" pos="0 0 0.3" quat="1 0 0 0"><joint name="j1" axis="0 0 1" range="-2 2" stiffness="0"/>
<inertial pos="0.1 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>
<body name="b" pos="0.3 0 0" euler="0 0.1 0"><joint name="j2" axis="0 1 0" range="-1 1" frictionloss="0.2"/>
<geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.03"/>
<body name="c" pos="0.25 0 0"><joint name="slide" type="slide" axis="1 0 0" range="0 0.2"/>
<geom type="box" size="0.05 0.02 0.02" mass="0.4"/><site name="tool" pos="0.1 0 0"/></body></body></body></body></worldbody>
<actuator><motor name="m1" joint="j1" gear="50" ctrlrange="-1 1"/><position joint="j2" kp="10" forcerange="-5 5"/>
</actuator><keyframe><key name="home" qpos="0.1 0.2 0.05"/></keyframe></mujoco>"""


@functools.cache
def urdfs() -> tuple[bytes, ...]:
    arms = [as_urdf(taut.load_arm(name)).encode() for name in ("planar3", "gantry3")]
    return (DUO.encode(), *arms)


@functools.cache
def mjcfs() -> tuple[bytes, ...]:
    return (MJCF.encode(), PAIR.encode())


def read_model(path: Path) -> None:
    """Load, and look at M at random poses; the report is for a terminal."""
    report = check_model(path)
    if not report.text().replace("\n", "").isprintable():
        raise AssertionError("the report commands a terminal")
    try:
        arm = taut.load_arm(path)
    except taut.errors.UsageError as ask:  # several ends
        arm = taut.load_arm(path, tool=str(ask.value))
    _require_definite(arm)


_SEEN: set[bytes] = set()


def _require_definite(arm: taut.Arm) -> None:
    bodies = np.array([[body.mass, *body.com, *np.ravel(body.inertia)] for body in arm.bodies])
    joints = np.array([[*joint.placement.p, *joint.placement.R.ravel(), *joint.axis] for joint in arm.joints])
    known = b"".join(array.tobytes() for array in (bodies, joints, arm.rotor_inertia, arm.lower, arm.upper))
    if known in _SEEN:
        return
    _SEEN.add(known)
    rng = np.random.default_rng(1)
    low = np.where(np.isfinite(arm.lower), arm.lower, -np.pi)
    high = np.where(np.isfinite(arm.upper), arm.upper, np.pi)
    model = model_of(arm)
    for q in rng.uniform(low, np.maximum(low, high), (POSES, arm.n)):
        M = np.asarray(mass_matrix(model, q), dtype=np.float64)
        if not np.isfinite(M).all() or np.linalg.eigvalsh(M)[0] <= 0.0:
            raise NotDefiniteError(f"M at {q.tolist()} has eigenvalues {np.linalg.eigvalsh(M).tolist()}")


# -------------------------------------------------------------------- tables, scenarios, servos


SERVOS = (
    {"kt": 1.2, "R": 2.7, "armature": 0.028, "q_offset": -0.05, "friction_base": 0.05, "friction_viscous": 0.06}
    | {"model": "m1", "actuator": "sts3215"},
    {
        "kt": 2.2,
        "R": 2.0,
        "armature": 0.026,
        "friction_base": 0.05,
        "friction_viscous": 0.01,
        "friction_stribeck": 0.08,
    }
    | {"load_friction_motor": 0.1, "load_friction_external": 0.2, "load_friction_motor_stribeck": 0.05, "alpha": 1.3}
    | {"load_friction_external_stribeck": 0.1, "load_friction_motor_quad": 0.01, "load_friction_external_quad": 0.02}
    | {"dtheta_stribeck": 0.2, "max_torque": 3.0, "model": "m6"},
)
SMALL = ("one_joint_pid", "gantry_decentralised", "feedforward_error", "ur10_velocity", "touch_and_press", "two_arms")
SMALL_TOO = ("panda_payload", "backlash_cycle", "policy_10hz", "slow_reversal", "wheel_tool", "gain_bounds")


@functools.cache
def scenarios() -> tuple[bytes, ...]:
    folder = resources.files("taut.scenarios") / "files"
    return tuple((folder / f"{name}.toml").read_bytes() for name in (*SMALL, *SMALL_TOO))


def tables() -> tuple[bytes, ...]:
    rows = [f"{0.01 * k},{0.1 * k},{-0.2 * k},0.5" for k in range(20)]
    poses = [f"{0.01 * k},0.4,{0.01 * k},0.3,1,0,0,0" for k in range(20)]
    heads = "t,q1,q2,q3", "t,x,y,z,qw,qx,qy,qz"
    return tuple("\n".join([head, *lines]).encode() for head, lines in zip(heads, (rows, poses), strict=True))


def read_scenario(path: Path) -> None:
    from taut.scenarios.scenario import load_scenario

    load_scenario(str(path))


def read_table(path: Path) -> None:
    kind = taut.trajectories.TaskSamples if b"qw" in path.read_bytes()[:100] else taut.trajectories.Samples
    motion = kind.from_csv(path)
    motion.at(0.05)


def read_servo(path: Path) -> None:
    servo = taut.load_servo(path, voltage=7.4)
    if not f"{servo.name} {servo.notes}".isprintable():
        raise AssertionError("a servo's name commands a terminal")
    taut.load_arm("planar2").with_servo(servo)


# -------------------------------------------------------------------- logs


@functools.cache
def runs() -> tuple[taut.Run, ...]:
    arm = taut.load_arm("planar2")
    law = taut.laws.GravityPID(kp=100.0, kd=20.0)
    changed = [taut.Event(t=0.02, set={"model.payload.mass": 0.5})]
    plain = taut.run(
        taut.compile(law, arm, limits=taut.Limits(tau=80.0)), taut.RigidPlant(arm), duration=0.3, events=changed
    )
    task = [
        taut.Phase(law, taut.JointMotion(q=[0.5, 0.5]), name="go", timeout=0.1, otherwise="stay"),
        taut.Phase(taut.laws.ComputedTorque(kp=100.0, kd=20.0), name="stay"),
    ]
    panda = taut.load_arm("panda")
    led = taut.compile(taut.laws.Impedance(K=(800.0, 30.0), B=(60.0, 4.0)), panda)
    kp = np.where(plain.t < 0.1, 100.0, 120.0)[:, None] * np.ones(2)
    servo = ServoInfo(digest="0" * 128, measures=("v",), limits={"tau": np.full(2, 80.0)}, adds=Adds(gravity=True))
    columns = {"parameters.law.kp": kp, "loop.tick": np.arange(len(plain.t)) + 5.0}
    of_robot = dataclasses.replace(
        plain, extra={**plain.extra, **columns}, info=dataclasses.replace(plain.info, servo=servo, events=())
    )
    return (
        plain,
        taut.run(task, taut.RigidPlant(arm), duration=0.3),
        taut.run(led, taut.RigidPlant(panda), duration=0.3),
        of_robot,
    )


@functools.cache
def logs() -> tuple[bytes, ...]:
    with tempfile.TemporaryDirectory() as folder:
        return tuple(run.save(Path(folder) / "run.mcap").read_bytes() for run in runs())


def read_log(path: Path) -> None:
    run, *_ = intact_parts(path)
    if not f"{run!r} {run.outcome} {run.joint_names} {list(run.terms)}".isprintable():
        raise AssertionError("a log commands a terminal")
    if len(path.read_bytes()) % EXAMINED == 0 and len(run) > 2:
        from taut.record.report import faults_of

        faults_of(run)
        str(taut.doctor(run))


def _make_log(index: int, rng: Generator, path: Path) -> Path:
    """Half of them with good checksums and other values, half with other bytes."""
    which = index % len(runs())
    if rng.random() < 0.5:
        path.write_bytes(mutated(logs()[which], lambda data, rng: data, rng))
        return path

    def change(values: dict[str, Any]) -> Any:
        for _ in range(int(rng.choice([1, 1, 2]))):
            values = of_values(values, rng)
        return values

    keep: Any = dict
    first = rng.random() < 0.8
    return write_log(runs()[which], path, change if first else keep, keep if first else change)


# -------------------------------------------------------------------- all of them


def _of_text(seeds: Callable[[], tuple[bytes, ...]], meaning: Callable[[bytes, Generator], bytes]) -> Maker:
    def make(index: int, rng: Generator, path: Path) -> Path:
        path.write_bytes(mutated(seeds()[index % len(seeds())], meaning, rng))
        return path

    return make


KINDS: dict[str, tuple[str, Maker, Reader]] = {
    "URDF": ("model.urdf", _of_text(urdfs, of_xml), read_model),
    "MJCF": ("model.xml", _of_text(mjcfs, of_xml), read_model),
    "scenario": ("case.toml", _of_text(scenarios, of_toml), read_scenario),
    "CSV": ("table.csv", _of_text(tables, of_rows), read_table),
    "MCAP": ("run.mcap", _make_log, read_log),
    "servo JSON": (
        "servo.json",
        _of_text(lambda: tuple(json.dumps(s).encode() for s in SERVOS), of_json),
        read_servo,
    ),
}


@functools.cache
def warm(kind: str) -> None:
    """Read the sound files of a kind, so that what is imported or compiled once is not counted to a mutant."""
    name, make, read = KINDS[kind]
    with tempfile.TemporaryDirectory() as folder:
        if kind == "MCAP":
            for run in runs():
                taut.doctor(taut.load_run(run.save(Path(folder) / name)))
            return
        for number in range(30):
            with contextlib.suppress(taut.TautError):
                read(make(number, np.random.default_rng(number), Path(folder) / name))
