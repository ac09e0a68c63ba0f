"""Connecting to a robot, or to a model plant that runs as one in real time."""

from __future__ import annotations

import dataclasses
import os
import pickle
import sys
from collections.abc import Mapping
from functools import partial
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm, Payload
from taut.base.checks import finite_array, instance_of, rate_in_hertz
from taut.base.errors import MatchError, UsageError
from taut.base.types import ArrayLike
from taut.codegen import native
from taut.control.law import Law
from taut.control.laws.joint import ComputedTorque, JointPosition, VelocityPI
from taut.control.laws.via_mit import ViaMit
from taut.control.observer import MomentumObserver
from taut.control.safety import SafetyLimits
from taut.control.sensing import Sensing
from taut.controller import Controller, compile
from taut.loop import ModelPlant
from taut.maths.model import Adds
from taut.maths.snapshot import snapshot
from taut.runtime.realtime.link import Link, driver_of
from taut.runtime.realtime.logger import LogProcess, log_folder
from taut.runtime.realtime.robot import Robot, freed
from taut.runtime.realtime.sets import compiled_plant
from taut.runtime.robots.can import CanMotors
from taut.runtime.robots.driver import RobotDriver, RobotInfo

NO_MOTORS: Final = "motors= is for an address can://CHANNEL; leave it out"
OBSERVER: Final = (50.0, 0.1)  # [1/s], and of the rate: bandwidth where a threshold of contact is stated
# The law by which move_to moves, for up to 40 times the inertia of the model: files leave rotor inertia out.
HOLD: Final = {"kp": 400.0, "kd": 40.0, "ki": 400.0}
FASTEST: Final = 1000.0  # [rad/s^2] of a joint at its effort limit; one that is lighter is held as if it were not


def connect(
    robot: str | ModelPlant | type[RobotDriver],
    arm: Arm | None = None,
    *,
    limits: SafetyLimits | None = None,
    motors: CanMotors | None = None,
    address: str | None = None,
    options: Mapping[str, Any] | None = None,
    rate: float | None = None,
    q0: ArrayLike | None = None,
    together: Robot | None = None,
    log: str | os.PathLike[str] | None = None,
) -> Robot:
    """Connect to a robot, or run a model plant as one in real time. Nothing moves yet.

    Args:
        robot: An address (franka://172.16.0.2, udp://127.0.0.1:4000, ur://..., can://...), a model plant such as
            `taut.RigidPlant`; or a driver of your own: a class in a file, a RobotDriver, or "FILE.py:CLASS".
        arm: The robot's model; that of a plant if left out.
        limits: `taut.SafetyLimits.of(arm)` unless given.
        motors: Of an arm at can://, `taut.robots.CanMotors(types=[...])`.
        address: Given to a driver of your own.
        options: Further keyword arguments of a driver; plain values.
        rate: Of a model plant [Hz]; 1000 unless given. A robot has its own.
        q0: (n,) where a model plant is [rad | m]; home unless given.
        together: A robot that is connected: a fault of either stops both.
        log: A folder, made where it is not there: every law that acts leaves a file in it, TIME-LAW.mcap, which
            another process writes while it acts. `taut.load_run`, `taut report` and `taut replay` read them.

    Raises:
        UsageError, MatchError: Something that does not fit; nothing was sent.
        DriverError: The robot cannot be reached, or is not ready.
        FileError: No files can be made in the folder of the log.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> with taut.connect(taut.RigidPlant(arm)) as robot:
        ...     law = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
        ...     ctrl = taut.compile(law, arm, rate=robot.rate, adds=robot.adds)
        ...     robot.start(ctrl)
        ...     robot.wait(0.1)
        ...     run = robot.stop()
        >>> bool(abs(run.q[-1] - arm.home).max() < 1e-3)
        True
    """
    plant = robot if isinstance(robot, ModelPlant) else None
    if (
        plant is None
        and not isinstance(robot, str)
        and not (isinstance(robot, type) and issubclass(robot, RobotDriver))
    ):
        raise UsageError(
            "connect takes an address such as franka://172.16.0.2, a model plant such as taut.RigidPlant(arm), or a "
            f"class of your own, a RobotDriver; got {type(robot).__name__}", name="robot",
        )  # fmt: skip
    if sys.platform != "linux" or not native.available():
        raise UsageError(f"a robot's loop needs Linux and llvmlite (pip install llvmlite); here is {sys.platform}")
    arm = plant.arm if arm is None and plant is not None else arm
    instance_of("arm", arm, Arm, "an Arm from taut.load_arm, the model of the robot")
    assert arm is not None
    limits = SafetyLimits.of(arm) if limits is None else limits
    instance_of("limits", limits, SafetyLimits, "taut.SafetyLimits, such as taut.SafetyLimits.of(arm)")
    limits.check_size(arm.joint_names, "limits.")
    limits.require_within(arm)
    hello: dict[str, Any] = {}
    if plant is None:
        for name, value in {"rate": rate, "q0": q0}.items():
            if value is not None:
                raise UsageError(f"{name} is for a model plant, and a robot has its own; leave it out", name=name)
    if not isinstance(robot, ModelPlant):
        hello = hello_of(robot, arm, limits=limits, motors=motors, address=address, options=options)
    elif motors is not None:
        raise UsageError(NO_MOTORS, name="motors")
    folder, logs = None if log is None else log_folder(log), None
    if together is not None:
        instance_of("together", together, Robot, "a robot from taut.connect")
        together.check()
    link = Link(together.link if together is not None else None)
    try:
        info = link.open(hello if plant is None else _model(plant, q0, 1000.0 if rate is None else rate))
        if info.n != arm.n:
            raise MatchError(
                f"{info.name} has {info.n} joints and arm '{arm.name}' has {arm.n}; load the arm that is connected",
                name="arm",
            )
        if plant is None and "F_ext" in info.measures and not np.allclose(arm.T_WB.R, np.eye(3)):
            raise MatchError(
                f"{info.name} measures F_ext in the axes of its base, and the base of arm '{arm.name}' is rotated in "
                "the world (T_WB); state how it is mounted by arm.with_gravity(...), without T_WB",
                name="T_WB",
            )
        logs = None if folder is None else LogProcess(folder, link.status.name)
        return Robot(link, info, arm, limits, partial(_holder, limits=limits), logs, together)
    except BaseException:
        freed(link, logs, [])
        raise


def hello_of(
    robot: str | type[RobotDriver],
    arm: Arm,
    *,
    limits: SafetyLimits | None = None,
    motors: CanMotors | None = None,
    address: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """What the loop's process gets of a robot: driver, address and options. Arguments as of `connect`."""
    instance_of("options", options or {}, Mapping, "a mapping of names to values")
    found = driver_of(robot, address)
    on_can = isinstance(robot, str) and robot.startswith("can://")
    if on_can and motors is None:
        raise UsageError(
            f"{robot} needs the motors of the arm: taut.connect('{robot}', arm, "
            "motors=taut.robots.CanMotors(types=...)), or on the command line a robot file with [motors]",
            name="motors",
        )
    if motors is not None and not on_can:
        raise UsageError(NO_MOTORS, name="motors")
    if on_can and options:
        raise UsageError(
            f"{robot} takes no options; its values are those of motors=taut.robots.CanMotors(...), in a robot file "
            f"those of [motors]; got {', '.join(options)}",
            name="options",
        )
    of_motors = {} if motors is None else motors.options(arm, SafetyLimits.of(arm) if limits is None else limits)
    try:
        pickle.dumps(options)
    except Exception as cause:
        raise UsageError(f"options must be plain values, for another process: {cause}", name="options") from cause
    return {**found, "options": {**(options or {}), **of_motors}}


def _model(plant: ModelPlant, q0: ArrayLike | None, rate: float) -> dict[str, Any]:
    """What the loop's process gets of a model plant at rest at q0."""
    n, rate = plant.arm.n, rate_in_hertz(rate)
    joints = plant.arm.joint_names
    q = plant.arm.home if q0 is None else finite_array("q0", q0, shape=(n,), joints=joints)
    made = compiled_plant(plant, q, np.zeros(n), rate)
    info = RobotInfo(
        name=plant.name, n=n, rate=rate, takes=plant.takes,  # type: ignore[arg-type]
        measures=tuple(name for name in made["measured"] if name != "q"), adds=Adds.of(plant.adds).names,
    )  # fmt: skip
    return {"plant": made, "info": dataclasses.asdict(info), "measured": made["measured"]}


def _holder(info: RobotInfo, arm: Arm, limits: SafetyLimits) -> Controller:
    """The controller that holds, and by which move_to moves."""
    most = np.where(np.isfinite(arm.effort), arm.effort, 0.0) / FASTEST
    share = np.clip(most / np.diag(snapshot(arm, arm.home).M), 1.0, max(1.0, 0.4 * info.rate / HOLD["kd"]))
    joints: Law = ComputedTorque(**{name: gain * share for name, gain in HOLD.items()})
    laws: dict[str, Law] = {
        "torque": joints,
        "velocity": VelocityPI(kp=5.0),
        "position": JointPosition(),
        "mit": ViaMit(law=joints, kp_motor=0.0, kd_motor=0.0),
    }
    observer = None
    if limits.contact is not None:
        torque: Any = "measured" if "tau_meas" in info.measures and info.takes != "torque" else "applied"
        observer = MomentumObserver(bandwidth=min(OBSERVER[0], OBSERVER[1] * info.rate), torque=torque)
    sensing = Sensing(observer=observer, velocity="measured" if "v" in info.measures else "difference")
    return compile(laws[info.takes], arm, rate=info.rate, adds=_adds(info), sensing=sensing)


def _adds(info: RobotInfo) -> Any:
    """What a robot adds, with the load whose gravity it knows."""
    if info.load is None or "gravity" not in info.adds:
        return tuple(info.adds)
    return {**dict.fromkeys(info.adds), "gravity": Payload(mass=info.load[0], com=np.array(info.load[1]))}
