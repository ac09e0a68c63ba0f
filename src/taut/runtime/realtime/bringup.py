"""Bring-up of a robot: what is read, compared and tried before a law acts on it for the first time."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.arm.catalogue import CATALOGUE, installed_package
from taut.arm.description import Arm
from taut.arm.load import load_arm
from taut.base.errors import FileError, TautError, UsageError
from taut.base.result import Cell, Content, Result, Table
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain
from taut.control.law import Law
from taut.control.laws.via_mit import ViaMit
from taut.control.sensing import Sensing
from taut.control.trajectories.reference import JointMotion
from taut.controller import Controller, compile
from taut.maths.snapshot import Snapshot, snapshot
from taut.record.plain import plain
from taut.runtime.realtime.robot import LOAD_HINT, SAME_LOAD, Robot
from taut.runtime.robots.driver import DriverError
from taut.trace import math as tm

READ: Final = 2.0  # [s] in which a robot is only read
SHADOW: Final = 1.0  # [s] in which a law runs and nothing is sent
NAMES: Final = {"m_ee": "mass of the end effector [kg]"}  # of facts that have a unit
MISSED: Final = 0.05  # [-] of the periods that may be missed, and by which the rate may be off
SAME_PLACE: Final = 1e-3  # [m], [rad] between the tool that the robot reports and a frame of the arm
PUSH: Final = 0.5  # [N m | N] largest torque beside gravity in the test of signs
PROBE_STEPS: Final = 10  # in which it is reached
PROBE_STEP: Final = 0.2  # [s], in which a joint of 10 kg m^2 moves before the last one
PROBE_BANDWIDTH: Final = 10.0  # [rad/s] by which joints are held meanwhile
MOVED: Final = 2e-3  # [rad | m] a joint has broken away
CAUGHT: Final = 4e-3  # [rad | m] the law itself holds it again
DRIFT: Final = 0.03  # [rad | m] a joint that moves so far is given back to the robot
SPEED: Final = 0.1  # [-] of the speed limits, of every motion
COMPARED: Final = 3  # at which torques are compared
ASIDE: Final = 0.02  # [rad | m] before each of them, to either side
EXCURSION: Final = 0.4  # [rad | m] of them around the start
RESIDUAL: Final = (0.5, 0.01)  # [N m | N], [-] of the effort limit, allowed between measured torque and the model's
PUSH_OVER: Final = 2e-3  # [rad/s | m/s] a joint that was pushed has come to rest again
SETTLE: Final = 3.0  # [s] that this may take
HELD: Final = 10.0  # [s] likewise, where the motors alone begin to hold the arm
AVERAGED: Final = 0.3  # [s] over which a torque at rest is averaged
Ask = Callable[[str], bool]


class Probe(Law):
    """Gravity compensation that holds each joint with at most half a newton metre, and adds a torque.

    Law:          tau = h + clip(held M_ii (omega^2 e - 2 omega v) + (1 - held) torque, -0.5, 0.5),   omega = 10 rad/s
                  e from the place where it is held; held = 1 also of a joint that is 4 mrad or mm away from it
    Closed loop:  of a held joint, M diagonal and no clip: e_ddot + 20 e_dot + 100 e = 0
    """

    torque: Gain = Gain(unit="N m | N", minimum=-PUSH, maximum=PUSH)
    held: Gain = Gain(minimum=0.0, maximum=1.0)
    place: Gain = Gain(unit="rad | m", minimum=-np.inf)

    def command(self, x: Snapshot, ref: JointMotion) -> Command:  # noqa: ARG002  (its place is a gain, of each push)
        omega = PROBE_BANDWIDTH
        error = x.difference(self.place.as_array())
        hold: Vector = tm.array([x.M[i, i] for i in range(x.n)]) * (omega**2 * error - 2.0 * omega * x.v)
        near: Vector = tm.array([tm.where(abs(e) < CAUGHT, 1.0, 0.0) for e in error])
        free = (1.0 - self.held.as_array()) * near  # in the tick in which it has gone too far, it is held again
        probe = tm.clip((1.0 - free) * hold + free * self.torque.as_array(), -PUSH, PUSH)
        return Torque(Terms(nonlinear=x.h, probe=probe))


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """A step of a bring-up: what was found, whether it is as it should be, and the numbers."""

    name: str
    found: str
    ok: bool = True
    table: Table | None = None
    missing: str = ""  # what could not be compared


@dataclass(frozen=True, kw_only=True, eq=False)
class BringUp(Result):
    """Result of a bring-up: its steps, up to the first one that failed or was declined."""

    robot: str
    arm: str
    steps: tuple[Step, ...]

    @property
    def passed(self) -> bool:
        """True where every step was taken and is as it should be."""
        return all(step.ok for step in self.steps)

    @property
    def missing(self) -> tuple[str, ...]:
        """What could not be compared."""
        return tuple(dict.fromkeys(step.missing for step in self.steps if step.missing))

    def content(self) -> Content:
        passed = f"passed{'; not compared: ' * bool(self.missing)}{', '.join(self.missing)}"
        return Content(
            title=f"bring-up of {self.robot} with arm '{self.arm}': {passed if self.passed else 'not passed'}",
            faults=[f"{step.name}: {step.found}" for step in self.steps if not step.ok],
            summary=[f"{step.name}: {step.found}" for step in self.steps if step.ok],
            tables=[step.table for step in self.steps if step.table is not None],
        )


def bring_up(
    robot: Robot,
    ctrl: Controller | None = None,
    ref: object = None,
    *,
    start: ArrayLike | None = None,
    ask: Callable[[str], bool],
    say: Callable[[str], None] = lambda _: None,
) -> BringUp:
    """Read a robot, compare it with its model, let a law run in shadow, then test each joint and move slowly.

    Nothing is sent before the signs are tested. Each step begins when `ask` gives True to its question; the first
    one that fails is the last.

    Args:
        robot: Connected, and not controlled.
        ctrl: The controller that is to act later, for `robot.rate` and `robot.adds`; one that holds if left out.
        ref: Its reference; a hold if left out.
        start: (n,) where the arm is to go [rad | m]; home if left out.
        ask: Given a sentence on what comes next: whether to do it.
        say: Takes what each step found, as soon as it is known.
    """
    goal = robot.arm.home if start is None else np.asarray(start, dtype=np.float64)
    steps = list[Step]()
    for question, step in _steps(robot, robot.holder if ctrl is None else ctrl, ref, goal):
        if not ask(question):
            steps.append(Step(name=question, found="declined", ok=False))
            break
        try:
            steps.append(step())
        except TautError as error:
            steps.append(Step(name=question, found=str(error), ok=False))
        finally:
            if robot.link.word("control") and robot.link.alive:
                robot.stop()  # which ends when the arm stands, also after Ctrl-C
        say(f"{steps[-1].name}: {steps[-1].found}")
        if not steps[-1].ok:
            break
    return BringUp(robot=robot.info.name, arm=robot.arm.name, steps=tuple(steps))


def _steps(
    robot: Robot, ctrl: Controller, ref: object, goal: Float64Array
) -> Iterator[tuple[str, Callable[[], Step]]]:
    """What is asked before each step, and the step."""
    yield f"read the robot for {READ:g} s; nothing is sent", partial(_read, robot)
    yield "compare its tool with the arm's frames; nothing is sent", partial(_kinematics, robot)
    yield "compare its load with the arm's; nothing is sent", partial(_load, robot)
    rivals = _rivals(robot)
    measured = _Torques(robot)
    how = "nothing is sent"
    if not robot.info.holds:
        how = "motors are enabled and hold by themselves: take the support away, the arm sinks until they carry it"
    yield f"compare its torques with the arm's gravity; {how}", partial(_gravity, measured, rivals, False)
    yield f"let the law run in shadow for {SHADOW:g} s; nothing is sent", partial(_shadow, robot, ctrl, ref)
    yield (
        f"test the sign of each joint with at most {PUSH:g} N m; it moves by some {1e3 * MOVED:g} mrad, keep clear",
        partial(_signs, robot),
    )
    yield (
        f"move slowly to the start, at {100 * SPEED:g} % of the speed limits, by up to "
        f"{np.abs(robot.arm.difference(goal, robot.q)).max():.2f} rad; keep clear",
        partial(_move, robot, goal),
    )
    if rivals:
        yield (
            f"move slowly to {COMPARED} poses within {EXCURSION:g} rad of the start, at which {_named(rivals)} would "
            "need other torques; keep clear",
            partial(_poses, measured, rivals, goal),
        )


def _named(rivals: dict[str, Arm]) -> str:
    return ", ".join(f"'{name}'" for name in rivals)


def _read(robot: Robot) -> Step:
    before = robot.status.lost
    robot.wait(READ)
    run, arm = robot.run(), robot.arm
    times = run.extra["loop.time"]
    last = times >= times[-1] - READ
    period, lost = np.diff(times[last]), robot.status.lost - before
    rate = 1.0 / period.mean()
    rows: list[list[Cell]] = [
        ["rate [Hz]", float(rate)],
        ["period, 99.9th percentile [ms]", float(1e3 * np.percentile(period, 99.9))],
        ["periods missed", lost],
        ["std of q, largest [rad | m]", float(run.q[last].std(axis=0).max())],
        ["std of v, largest", float(run.v[last].std(axis=0).max())],
    ]
    facts = robot.info.facts.items()
    known = {name: value for name, value in facts if value != "" and isinstance(value, str | float | int)}
    rows += [[NAMES.get(name, name.replace("_", " ")), value] for name, value in known.items()]
    outside = [
        name for name, q, low, high in zip(arm.joint_names, run.q[-1], arm.lower, arm.upper, strict=True)
        if not low <= q <= high
    ]  # fmt: skip
    found = f"{rate:.1f} states a second, {lost} of {round(READ * robot.rate)} missed"
    few = abs(rate / robot.rate - 1.0) <= MISSED and lost <= MISSED * READ * robot.rate
    if not few:
        bound = f"{100 * MISSED:g} %"
        found += f"; the rate must be within {bound} of {robot.rate:g} Hz, and at most {bound} may be missed: "
        found += "take a quieter machine, a wired connection, a real-time kernel"
    if outside:
        found += f"; outside the arm's limits: {', '.join(outside)}"
    errors = robot.info.facts.get("errors")
    if errors:
        found += f"; the robot reports {errors}: clear it, as by robot.recover(), and begin again"
    ok = few and not (outside or errors)
    return Step(name="states", found=found, ok=ok, table=Table(columns=["state", "value"], rows=rows))


def _kinematics(robot: Robot) -> Step:
    """The tool that the robot reports, beside the nearest frame of the arm."""
    pose = robot.info.facts.get("T_BE")
    if pose is None:
        return Step(name="kinematics", found="the robot reports no pose of its tool", missing="pose of the tool")
    arm = robot.arm
    x, T_BW = snapshot(arm, np.asarray(robot.info.facts.get("q", robot.q))), arm.T_WB.inverse()
    T = np.asarray(pose, dtype=np.float64).reshape(4, 4)
    near = {}
    for name in arm.frame_names:
        at = T_BW @ x.T(name)
        turn = np.clip((np.trace(at.R.T @ T[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)
        near[name] = float(np.linalg.norm(at.p - T[:3, 3])), float(np.arccos(turn))
    frame, (away, angle) = min(near.items(), key=lambda one: one[1][0] + one[1][1])
    found = f"its tool is {1e3 * away:.2f} mm and {angle:.4f} rad from frame '{frame}'"
    ok = away <= SAME_PLACE and angle <= SAME_PLACE
    if not ok:
        found += ", the nearest; the arm is another one, or its tool stands elsewhere on the robot"
    elif frame != arm.tool:
        found += f"; the arm's tool is '{arm.tool}'"
    return Step(name="kinematics", found=found, ok=ok)


def _load(robot: Robot) -> Step:
    known, own = robot.info.load, robot.arm.payload
    if known is None:
        return Step(name="load", found=f"the robot reports none; the arm carries {own.mass:g} kg", missing="load")
    found = f"the robot compensates {known[0]:g} kg at {list(known[1])} m; the arm carries {own.mass:g} kg"
    ok = abs(known[0] - own.mass) <= SAME_LOAD
    return Step(name="load", found=found if ok else f"{found}; {LOAD_HINT}", ok=ok)


class _Torques:
    """Torques measured at rest, pose by pose."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.poses, self.torques = list[Float64Array](), list[Float64Array]()

    @property
    def known(self) -> bool:
        return "tau_meas" in self.robot.info.measures

    def take(self) -> None:
        """Those of the pose where the arm rests."""
        self._keep([self._at_rest()])

    def take_at(self, q: Float64Array) -> None:
        """Those at q, reached from either side: what dry friction holds has two signs then."""
        found = list[Float64Array]()
        for aside in (-ASIDE, ASIDE):
            self.near(q + aside)
            self.near(q)
            found.append(self._at_rest())
        self._keep(found)

    def near(self, q: Float64Array) -> None:
        """Move to q, or as near as dry friction allows under a wrong model; it is compared where it rests."""
        try:
            self.robot.move_to(q, speed=SPEED)
        except DriverError as error:
            if error.kind != "rejected":
                raise
            self.robot.check()

    def _at_rest(self) -> Float64Array:
        """(2, n) pose and torques."""
        self.robot.wait(AVERAGED)
        run, count = self.robot.run(), round(AVERAGED * self.robot.rate)
        return np.array([run.q[-count:].mean(axis=0), run.tau[-count:].mean(axis=0)])

    def _keep(self, found: list[Float64Array]) -> None:
        q, tau = np.mean(found, axis=0)
        self.poses.append(q)
        self.torques.append(tau)

    def residual(self, arm: Arm) -> Float64Array:
        """(k, n) measured torques less the gravity of an arm."""
        return np.array([tau - snapshot(arm, q, 0.0 * q).g for q, tau in zip(self.poses, self.torques, strict=True)])


def _rivals(robot: Robot) -> dict[str, Arm]:
    """Arms of the catalogue with the same kinematics, which torques alone tell apart."""
    own, out = robot.arm, dict[str, Arm]()
    poses = [own.home, own.home + np.linspace(0.1, 0.3, own.n)]  # where two tools lie alike, as of one robot
    tools = [snapshot(own, q).T().p for q in poses]
    for name, entry in CATALOGUE.items():
        if name == own.name or len(entry.home) != own.n or installed_package(entry) is None:
            continue
        arm = load_arm(name, T_WB=own.T_WB).with_payload(own.payload.mass, own.payload.com, own.payload.inertia)
        away = [snapshot(arm, q).T().p - p for q, p in zip(poses, tools, strict=True)]
        if np.abs(away).max() <= SAME_PLACE:
            out[name] = arm
    return out


def _gravity(measured: _Torques, rivals: dict[str, Arm], last: bool) -> Step:
    """Measured torques beside gravity: within a bound, and no other arm fits better."""
    arm = measured.robot.arm
    if not measured.known:
        return Step(name="gravity", found="the robot measures no torques", missing="torques")
    if not last:
        if not measured.robot.info.holds:
            measured.robot.call("hold")
            _come_to_rest(measured.robot, HELD)
        measured.take()
    residual = np.abs(measured.residual(arm)).max(axis=0)
    bound = np.maximum(RESIDUAL[0], RESIDUAL[1] * np.where(np.isfinite(arm.effort), arm.effort, 0.0))
    bound = bound + arm.friction.static
    i = int(np.argmax(residual / bound))
    names, units = arm.joint_names, ["N" if unit == "m" else "N m" for unit in arm.units]
    rows: list[list[Cell]] = [[name, float(r), float(b)] for name, r, b in zip(names, residual, bound, strict=True)]
    table = Table(title="torque at rest less gravity", columns=["joint", "largest [N m | N]", "allowed"], rows=rows)
    rms = {
        name: float(np.sqrt(np.mean(measured.residual(one) ** 2))) for name, one in {arm.name: arm, **rivals}.items()
    }
    found = f"{residual[i]:.2f} {units[i]} from the arm's at joint '{names[i]}', at most {bound[i]:.2f}"
    best = min(rms, key=lambda name: rms[name])
    ok = bool((residual <= bound).all())
    if last and best != arm.name:
        ok, found = False, f"{found}; '{best}' fits better: {rms[best]:.3f} N m RMS, '{arm.name}' {rms[arm.name]:.3f}"
    elif not ok:
        motors = "sign, offset or ranges of its motors are wrong, or " if measured.robot.info.takes == "mit" else ""
        found += f"; {motors}the arm or its load is another one"
    elif last:
        found += "; RMS " + ", ".join(f"{x:.3f} N m of '{name}'" for name, x in rms.items())
    return Step(name="gravity", found=found, ok=ok, table=table)


def _shadow(robot: Robot, ctrl: Controller, ref: object) -> Step:
    robot.shadow(ctrl, ref)
    robot.wait(SHADOW)
    run = robot.run()
    largest = np.abs(run.command).max(axis=0)
    i = int(np.argmax(largest))
    limited = int((np.abs(run.extra["safe.limited"]).max(axis=1) > 0.0).sum())
    found = (
        f"{len(run)} ticks without a fault; its command is at most {largest[i]:.4g} at joint "
        f"'{robot.arm.joint_names[i]}', and would be limited in {limited} ticks"
    )
    return Step(name="shadow", found=found)


def _signs(robot: Robot) -> Step:
    """Push each joint to either side: it must give way to that side, or stick."""
    arm = robot.arm
    if robot.info.takes not in ("torque", "mit"):
        found = f"the robot takes {robot.info.takes} commands: the slow motion shows them"
        return Step(name="signs", found=found, missing="signs of torques")
    law: Law = Probe(torque=np.zeros(arm.n), held=np.ones(arm.n), place=robot.q)
    if robot.info.takes == "mit":
        law = ViaMit(law=law, kp_motor=0.0, kd_motor=0.0)
    sensing = Sensing(velocity="measured" if "v" in robot.info.measures else "difference")
    ctrl = compile(law, arm, rate=robot.rate, adds=robot.adds, sensing=sensing)
    path = next(p for p in ctrl.parameters if p.endswith("torque")).rpartition(".")[0]
    robot.start(ctrl, JointMotion(q=robot.q), over=0.0)
    rows = list[list[Cell]]()
    wrong = list[str]()
    for i, name in enumerate(arm.joint_names):
        away = [_push(robot, path, i, sign) for sign in (1.0, -1.0)]
        rows.append([name, *(None if tau is None else tau for tau, _ in away)])
        if any(tau is not None and sign * moved < 0.0 for (tau, moved), sign in zip(away, (1.0, -1.0), strict=True)):
            wrong.append(name)
            break
    stuck = [str(row[0]) for row in rows if row[1] is None and row[2] is None]
    found = f"{len(rows) - len(stuck)} of {arm.n} joints gave way to the side they were pushed to"
    if stuck:
        found += f"; {', '.join(stuck)} did not move: more friction than {PUSH:g} N m, signs not known"
    if wrong:
        found = f"joint '{wrong[0]}' moves against its torque: check the sign of its torque or of its encoder"
    table = Table(title="break-away torque", columns=["joint", "to + [N m | N]", "to - [N m | N]"], rows=rows)
    missing = f"signs of {', '.join(stuck)}" if stuck else ""
    return Step(name="signs", found=found, ok=not wrong, table=table, missing=missing)


def _push(robot: Robot, path: str, i: int, sign: float) -> tuple[float | None, float]:
    """The torque beside gravity with which a joint broke away, and its motion; None where it did not."""
    others = np.ones(robot.arm.n)
    others[i] = 0.0
    push, here = 1.0 - others, robot.q
    free = {f"{path}.held": others, f"{path}.place": here}
    found: tuple[float | None, float] = None, 0.0
    # As they are: to judge the loop again with each value would take longer than a step, in which nobody looks.
    send = partial(robot.acting.controls.set, over=PROBE_STEP)
    for torque in np.linspace(0.0, PUSH, PROBE_STEPS + 1)[1:]:
        send({**free, f"{path}.torque": sign * torque * push})
        until = time.monotonic() + PROBE_STEP
        while time.monotonic() < until:
            moved = robot.arm.difference(robot.q, here)
            if np.abs(moved).max() > DRIFT:
                j = int(np.argmax(np.abs(moved)))
                raise UsageError(
                    f"joint '{robot.arm.joint_names[j]}' ran away by {moved[j]:.3g} {robot.arm.units[j]} and was "
                    "given back to the robot: its torque or its encoder has the wrong sign, or the load, the "
                    "mounting or the arm is another one",
                    name="signs",
                )
            gone = float(robot.arm.difference(robot.q, here)[i])
            if abs(gone) > MOVED:
                found = float(torque), gone
                break
            robot.check()
            time.sleep(1.0 / robot.rate)
        if found[0] is not None:
            break
    send({f"{path}.torque": 0.0 * push, f"{path}.held": np.ones(robot.arm.n)})
    _come_to_rest(robot)
    return found


def _come_to_rest(robot: Robot, within: float = SETTLE) -> None:
    """Wait until positions stay where they are: a velocity is zero at a reversal, too."""
    until, moving = time.monotonic() + within, True
    while moving and time.monotonic() < until:
        robot.wait(AVERAGED)
        moving = np.ptp(robot.run().q[-round(AVERAGED * robot.rate) :], axis=0).max() > PUSH_OVER * AVERAGED


def _move(robot: Robot, goal: Float64Array) -> Step:
    robot.move_to(goal, speed=SPEED)
    run = robot.run()
    assert isinstance(run.reference, JointMotion)
    error = np.abs(run.reference.q - run.q).max(axis=0)
    i = int(np.argmax(error))
    found = (
        f"the largest error on the way was {error[i]:.2g} {robot.arm.units[i]} at joint '{robot.arm.joint_names[i]}'"
    )
    if "success_rate" in robot.info.facts:  # of the last commands: there is one only while they are sent
        found += (
            f"; {100.0 * robot.call('state')['success_rate']:.0f} % of the last commands reached the robot in time"
        )
    return Step(name="slow motion", found=found)


def _poses(measured: _Torques, rivals: dict[str, Arm], goal: Float64Array) -> Step:
    """Compare torques where those of the rivals differ most."""
    arm = measured.robot.arm
    if not measured.known:
        return Step(name="gravity", found="the robot measures no torques", missing="torques")
    rng = np.random.default_rng(0)
    low, high = (
        np.maximum(goal - EXCURSION, arm.lower + EXCURSION),
        np.minimum(goal + EXCURSION, arm.upper - EXCURSION),
    )
    tried = list(rng.uniform(np.minimum(low, goal), np.maximum(high, goal), (200, arm.n)))

    def apart(q: Float64Array) -> float:
        g = snapshot(arm, q).g
        return min(float(np.abs(snapshot(one, q).g - g).max()) for one in rivals.values())

    for q in sorted(tried, key=apart)[-COMPARED:]:
        measured.take_at(q)
    measured.near(goal)
    return _gravity(measured, rivals, True)


def _file() -> Path:
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "taut" / "bringup.json"


def _key(hello: Mapping[str, Any], arm: Arm) -> str:
    """A robot, by what its driver gets, with this arm and load; a driver's file counts by its text."""
    text = Path(hello["file"]).read_text(encoding="utf-8") if "file" in hello else ""
    words = json.dumps([plain(hello), text, plain(arm)], sort_keys=True)
    return f"{hello['class']} {hello['address']} {arm.name} {hashlib.sha256(words.encode()).hexdigest()[:16]}"


def passed_before(hello: Mapping[str, Any], arm: Arm) -> bool:
    """True where a bring-up has passed for this driver, address and options (`hello_of`), Arm and load."""
    try:
        return _key(hello, arm) in json.loads(_file().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False


def remember(hello: Mapping[str, Any], arm: Arm) -> Path:
    """Keep that a bring-up has passed: the file. Raises FileError."""
    file = _file()
    try:
        known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else []
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        file.write_text(json.dumps(sorted({*known, _key(hello, arm)}), indent=1) + "\n", encoding="utf-8")
    except (OSError, ValueError) as cause:
        raise FileError(f"the file of bring-ups '{file}' cannot be written: {cause}", name=str(file)) from cause
    return file
