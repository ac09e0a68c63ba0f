"""Safety of a robot's loop: limits, checks of sensors and commands, and the controlled stop, as one pure function."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import instance_of
from taut.base.errors import RangeError, UsageError
from taut.base.fields import Declared, Field
from taut.base.paths import subtree
from taut.base.types import Float64Array, Vector
from taut.control.faults import CODES
from taut.control.lawside import HELD, KNOWN, LawSide, Tick
from taut.control.limits import RATE_PER_EFFORT, left
from taut.control.trajectories.compound import PhaseSample
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot, measurement_shapes, snapshot
from taut.trace import math as tm
from taut.trace.graph import LARGEST

BRAKE_PER_SPEED: Final = 5.0  # [1/s] default deceleration over the speed limit: at rest within 0.2 s
STOP_BANDWIDTH: Final = (20.0, 0.05)  # [rad/s], [-] of a controlled stop: at most this, and this part of the rate
LAG: Final = 0.03  # [s] that a torque within its rate may be behind what the stop asks before that begins anew
FULL_TORQUE: Final = 0.5  # [s] in which a torque within its rate gets everywhere, or laws oscillate
LONGEST_STOP: Final = 2.0  # [s] of the deceleration in it: robot.stop() waits for 3
EASE: Final = 0.05  # [s] in which its deceleration rises; at the end the speed falls by 1/e in that time
SOFT_GAIN: Final = 10.0  # [1/s] admissible speed towards a limit in its soft zone, over the distance
SOFT_DAMPING: Final = (50.0, 0.25)  # [1/s], [-] deceleration over the speed above that, and of the rate
CONSISTENCY_TIME: Final = 0.02  # [s] over which positions and velocities are compared
CONSISTENCY: Final = (0.1, 0.3)  # [-] allowed difference: of the speed limit, and of the speed
JUMP: Final = (2.0, 0.005)  # [-] of the speed limit in a period, [rad | m] besides: a position beyond its speeds
BELIEVED: Final = 10.0  # [-] of the speed limit, up to which a speed is
PLAUSIBLE: Final = 1e6  # [any unit] a measurement beyond is as good as none
SUDDEN: Final = 10.0  # [-] times the deceleration: change of a speed beyond is none from which a stop begins
FOLLOWS: Final = 1.1  # [-] of the speed limit, which commands of speed and position keep, that a joint may reach
OUTWARD: Final = 5e-3  # [rad/s | m/s] slower is at rest: an arm beyond a limit may be moved back
REFERENCE_STEP: Final = 0.1  # [rad | m | -] of a reference's positions (and elements of R) in a tick
POSITIONS: Final = ("q", "p", "R")  # fields of a reference that may not jump
OF_ARM: Final = {"tau": "effort", "v": "velocity", "lower": "lower", "upper": "upper"}  # limits that an arm has too
NO_TIME_OUT: Final = 1e9  # [s] time-out of a reference that does not go stale
SIGNALS: Final = (
    "valid", "age", "hold_after", "stop_after", "hold", "recover", "begin", "over", "changed", "fault", "lost",
    "control",
)  # fmt: skip
"""Numbers that the loop gives to each tick.

valid: 1 where there is a sample; age [s] of a stream's sample; hold_after, stop_after [s] its time-outs; hold,
recover: 1 where it is asked for; begin: 1 in the first tick of a law; over [s]: time in which its command, or that
of changed parameters, comes in; changed: 1 where parameters have; fault: code of what the loop itself saw, or 0;
lost: periods missed before this tick; control: 1 where commands go out.
"""


class SafetyLimits(Declared):
    """Limits of a robot's loop. Torque, torque rate and the soft zone cut the command; the others end in a stop.

    The controlled stop brakes each joint with `deceleration` and then holds it there, with the model's gravity. It
    acts in the tick of the fault, which is latched until `robot.recover()`. Where no limit is stated nothing is
    checked.

    Args:
        tau: Largest torque [N m | N], one number or one per joint.
        tau_dot: Largest change of a law's torque per second [N m/s | N/s]; magnitudes win over rates. A stop keeps
            only the rate that the robot allows.
        v: Largest speed of the joints [rad/s | m/s].
        lower, upper: Positions [rad | m]; a joint that could not be braked before them any more is stopped.
        soft: Zone before these in which the speed towards them is damped to 10/s times the distance [rad | m].
        deceleration: Of the controlled stop [rad/s^2 | m/s^2], from v to rest within 2 s.
        tool_speed: Largest speed of the tool [m/s].
        tool_force: Largest force of the environment at the tool [N], of a measured F_ext.
        contact: Largest external torque of each joint [N m | N]; of an observer, `taut.Sensing(observer=...)`.
        power: Largest mechanical power of all drives together [W].
        box: Workspace of the tool's origin in the world: (2, 3) lower and upper corner [m].
        missed: Periods in a row that may be missed.
    """

    tau: Field = Field(unit="N m | N", shape="n", above=0.0, infinite=True, optional=True, run_time=False)
    tau_dot: Field = Field(unit="N m/s | N/s", shape="n", above=0.0, infinite=True, optional=True, run_time=False)
    v: Field = Field(unit="rad/s | m/s", shape="n", above=0.0, infinite=True, optional=True, run_time=False)
    lower: Field = Field(unit="rad | m", shape="n", infinite=True, optional=True, run_time=False)
    upper: Field = Field(unit="rad | m", shape="n", infinite=True, optional=True, run_time=False)
    soft: Field = Field(0.1, unit="rad | m", shape="n", minimum=0.0, run_time=False)
    deceleration: Field = Field(unit="rad/s^2 | m/s^2", shape="n", above=0.0, optional=True, run_time=False)
    tool_speed: Field = Field(unit="m/s", above=0.0, optional=True, run_time=False)
    tool_force: Field = Field(unit="N", above=0.0, optional=True, run_time=False)
    contact: Field = Field(unit="N m | N", shape="n", above=0.0, optional=True, run_time=False)
    power: Field = Field(unit="W", above=0.0, optional=True, run_time=False)
    box: Field = Field(unit="m", shape=(2, 3), optional=True, run_time=False)
    missed: Field = Field(20.0, above=0.0, run_time=False)

    def check(self) -> None:
        for low, high in ((self.lower, self.upper), (None, None) if self.box is None else self.box):
            if low is not None and high is not None and not np.all(np.asarray(low) < np.asarray(high)):
                self.refuse("", f"needs lower limits below upper ones; got {np.asarray(low)} and {np.asarray(high)}")
        if self.lower is not None and self.upper is not None:
            room = np.asarray(self.upper) - np.asarray(self.lower)
            if np.any(2.0 * np.asarray(self.soft) >= room):
                self.refuse(
                    "soft", f"must be below half of the range of every joint, {np.min(room) / 2:.4g}", RangeError
                )

    def require_within(self, arm: Arm) -> None:
        """RangeError for a finite limit beyond that of the arm, which would never act, a slow rate or stop."""
        for name, field in OF_ARM.items():
            given = getattr(self, name)
            if given is None:
                continue
            limit, own = np.broadcast_to(given, (arm.n,)), getattr(arm, field)
            slack = 1e-9 * np.abs(own)
            beyond = limit < own - slack if name == "lower" else limit > own + slack
            for i in np.flatnonzero(np.isfinite(limit) & np.isfinite(own) & beyond):
                most = "at least" if name == "lower" else "at most"
                raise RangeError(
                    f"limits.{name} of joint '{arm.joint_names[i]}' must be {most} that of arm '{arm.name}', "
                    f"{own[i]:.4g}; got {limit[i]:.4g}; where the robot allows that: arm.with_joints({field}=...), "
                    f"or joint_values = {{ {field} = ... }} in [arm]",
                    name=name, joint=arm.joint_names[i], value=float(limit[i]),
                )  # fmt: skip
        if self.tau_dot is not None:
            tau = np.broadcast_to(np.inf if self.tau is None else self.tau, (arm.n,))
            full = np.where(np.isfinite(tau), tau, np.abs(np.asarray(snapshot(arm, arm.home).g)))
            slow = float(np.max(full / np.asarray(self.tau_dot)))
            if slow > FULL_TORQUE:
                rule = f"limits.tau_dot must reach limits.tau, or gravity at home, within {FULL_TORQUE:g} s"
                raise RangeError(f"{rule}; it takes {slow:.4g} s", name="tau_dot", value=slow)
        if self.v is not None and self.deceleration is not None:
            v = np.where(np.isfinite(self.v), self.v, 0.0)
            longest = float(np.max(v / np.asarray(self.deceleration)))
            if longest > LONGEST_STOP:
                rule = f"limits.deceleration must brake from limits.v within {LONGEST_STOP:g} s"
                raise RangeError(f"{rule}; it takes {longest:.4g} s", name="deceleration", value=longest)

    @classmethod
    def of(cls, arm: Arm, **limits: Any) -> SafetyLimits:
        """Those of an arm: its effort, speed and position limits, and ten times the effort limit per second.

        Further limits by name stand in their places.
        """
        instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
        v, room = (np.where(np.isfinite(x), x, 1.0) for x in (arm.velocity, 0.25 * (arm.upper - arm.lower)))
        own: dict[str, Any] = {"tau": arm.effort, "tau_dot": RATE_PER_EFFORT * arm.effort, "v": arm.velocity}
        own |= {"lower": arm.lower, "upper": arm.upper, "soft": np.minimum(0.1, room)}
        return cls(**{**own, "deceleration": BRAKE_PER_SPEED * v, **limits})


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """One check in a tick."""

    code: Any
    holds: Any  # whether it is violated
    index: Any  # of the joint, or of the measurement; -1 where it is of none
    value: Any

    @classmethod
    def of(cls, name: str, conditions: Any, values: Any) -> Finding:
        """The first of several conditions that holds, with its index and value."""
        holds: Any = np.bool_(False)
        index: Any = -1.0
        value: Any = 0.0
        for i in reversed(range(len(conditions))):
            holds = holds | conditions[i]
            index, value = tm.where(conditions[i], float(i), index), tm.where(conditions[i], values[i], value)
        return cls(code=CODES[name], holds=holds, index=index, value=value)

    def only(self, where: Any) -> Finding:
        """The same, found nowhere else."""
        return replace(self, holds=self.holds & where)


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """Measurements of a tick that can be used, by name."""

    measured: dict[str, Any]
    lost: Any  # (n,) joints that are not measured any more
    residual: Any  # (n,) filtered difference of the speeds by position and by velocity [rad/s | m/s]
    findings: list[Finding]


@dataclass(frozen=True, kw_only=True, eq=False)
class SafeSide:
    """A law side under safety limits: the tick that a robot's loop repeats.

    Its memory has `safe.*`, the same for every law, then `held.*`, the sample to hold, and `last.*`, the positions of
    the one before, then that of the law side.
    """

    side: LawSide
    limits: SafetyLimits
    measures: tuple[str, ...]  # by the robot, besides positions
    at_rest: float = 0.0  # [rad/s | m/s] what measured velocities show at rest
    torque_rate: float = 0.0  # [N m/s | N/s] that the robot allows; 0 where it takes any

    @cached_property
    def measured(self) -> dict[str, tuple[int, ...]]:
        """Shapes of what is read, by name."""
        shapes = measurement_shapes(self.side.arm.n)
        return {name: shapes[name] for name in ("q", *self.measures)}

    def check(self) -> None:
        """UsageError, ShapeError or RangeError for limits that do not fit the arm, or what is measured."""
        arm, limits = self.side.arm, self.limits
        limits.check_size(arm.joint_names, "limits.")
        if limits.tool_force is not None and "F_ext" not in self.measures:
            raise UsageError(
                "limits.tool_force needs a measured F_ext, and this robot measures none; use contact=",
                name="tool_force",
            )
        if limits.power is not None and not self.torques:
            raise UsageError(
                "limits.power is for a robot that takes torques, and this one takes none; leave it out", name="power"
            )
        if limits.contact is not None and self.side.sensing.observer is None:
            raise UsageError(
                "limits.contact needs an observer: compile the law with "
                "sensing=taut.Sensing(observer=taut.sensors.MomentumObserver(bandwidth=...)), or state "
                "observer = { bandwidth = ... } in [control] of the scenario",
                name="contact",
            )

    def check_pose(self, q: Float64Array) -> None:
        """RangeError where the tool is outside the box, or torque limits do not carry the arm, at rest at q (n,)."""
        x = Snapshot(self.side.model, q=q, v=np.zeros(len(q)), adds=self.side.adds)
        if self.limits.box is not None:
            p, (low, high) = np.asarray(x.T().p, dtype=np.float64), np.asarray(self.limits.box)
            if np.any((p < low) | (p > high)):
                raise RangeError(
                    f"the tool is at {np.round(p, 4).tolist()} m, outside limits.box, {low.tolist()} to "
                    f"{high.tolist()}; move the arm by hand, or state another box", name="box",
                )  # fmt: skip
        if self.limits.tau is None or not self.torques:
            return
        g = np.abs(np.asarray(x.g))
        most = np.broadcast_to(self.limits.tau, g.shape)
        i = int(np.argmax(g - most))
        if g[i] > most[i]:
            joint = self.side.arm.joint_names[i]
            raise RangeError(
                f"limits.tau of joint '{joint}' is {most[i]:.4g}, and gravity takes {g[i]:.4g} here; raise it, or "
                "start where less is needed", name="tau", joint=joint, value=float(most[i]),
            )  # fmt: skip

    @property
    def memory_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the memory by path; those of `safe` come first."""
        n, fields = self.side.arm.n, self.side.law.reference.fields(self.side.arm.n)
        return (
            {f"safe.{name}": shape for name, shape in safe_shapes(n).items()}
            | {f"held.{name}": shape for name, shape in fields.items()}
            | {f"last.{name}": fields[name] for name in self.positions}
            | dict(self.side.probe.shapes)
        )

    @cached_property
    def positions(self) -> tuple[str, ...]:
        """Fields of the reference that may not jump."""
        return tuple(name for name in self.side.law.reference.fields(self.side.arm.n) if is_position(name))

    def start(
        self, inputs: Mapping[str, Any], parameters: Mapping[str, Any], memory: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Memory in the first tick of a law: it starts from what is measured and from the torque that is sent."""
        seen = self._seen(inputs, subtree(memory, "safe"), subtree(inputs, "signal"), self.side.dt)
        rest = self._at_rest(seen.measured)
        held = {KNOWN: 1.0, HELD: memory["safe.tau"]}
        law = self.side.start({**seen.measured, "t": inputs["t"], **held}, rest, parameters)
        out = {path: memory[path] for path in memory if path.startswith("safe.")}
        out |= {f"held.{name}": getattr(rest, name) for name in self.side.law.reference.fields(self.side.arm.n)}
        out |= {f"last.{name}": getattr(rest, name) for name in self.positions}
        return {**out, **law}

    def tick(
        self, inputs: Mapping[str, Any], parameters: Mapping[str, Any], memory: Mapping[str, Any], dt: Any
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """One tick: (outputs, new memory). It is finite whatever is measured, and whatever the law gives."""
        side, safe, signal = self.side, subtree(memory, "safe"), subtree(inputs, "signal")
        recovers, control = signal["recover"] > 0.5, signal["control"] > 0.5
        seen = self._seen(inputs, safe, signal, dt)
        measured = seen.measured
        x = Snapshot(side.model, q=measured["q"], v=measured["v"], payload=self._payload(parameters), adds=side.adds)

        fresh = (signal["valid"] > 0.5) & (signal["age"] <= signal["hold_after"])
        begins = np.bool_(False) if side.task is None else memory["law.ticks"] < 0.5
        rest, kind = self._at_rest(measured), side.law.reference
        fields = kind.fields(side.arm.n)
        keeps = fresh | begins
        held = {name: tm.where(keeps, getattr(rest, name), memory[f"held.{name}"]) for name in fields}
        sample = kind.of({name: tm.where(fresh, inputs[f"ref.{name}"], held[name]) for name in fields})

        own = {path: memory[path] for path in side.probe.shapes}
        tick = side.tick({**measured, "t": inputs["t"]}, sample, own, parameters, dt)
        command, good_law, culprit = self._finite(tick, own)

        # The blend: of the first tick of a law, and of new parameters.
        started, changed = signal["begin"] > 0.5, signal["changed"] > 0.5
        bump = safe["bump"] * left(safe["phase"])
        bump = tm.where(
            started, safe["tau"] - command, bump + tm.where(changed, safe["law"] - command, 0.0 * command)
        )
        phase = tm.where(started | changed, 0.0, tm.minimum(safe["phase"] + dt / signal["over"], 1.0))
        wanted = command + bump * left(phase)

        # Checks, in the order in which the first one found is the one that is latched. A law is checked while it is
        # to act, limits of motion and the loop while commands go out.
        latched = tm.where(recovers, 0.0, safe["fault"])
        acts = (tm.where(started, 1.0, safe["mode"]) > 0.5) & (latched < 0.5)
        of_motion = [*self._checks(x, safe, tick), *self._of_loop(signal)]
        last = {name: tm.where(begins, getattr(rest, name), memory[f"last.{name}"]) for name in self.positions}
        jumps = [one.only(acts & fresh & (signal["hold"] < 0.5)) for one in self._jumps(sample, last, memory)]
        found = [*seen.findings, culprit.only(acts), *(one.only(control) for one in (*jumps, *of_motion))]
        code, index, value = _first(found)
        new_fault = (latched < 0.5) & (code > 0.5)
        fault = tm.where(new_fault, code, latched)
        runs = acts & (fault < 0.5) & (signal["hold"] < 0.5)

        enters = (safe["mode"] > 0.5) | recovers | ~control | (safe["started"] < 0.5)
        stop, stopping = self._stop(x, safe, seen.lost, enters, dt)
        chosen = tm.where(runs, wanted, stop)
        chosen = chosen + self._soft(x, seen.lost) if self.torques else chosen
        chosen = tm.where(tm.abs(chosen) <= LARGEST, chosen, safe["tau"])
        sent = self._limited(chosen, tm.where(control, safe["tau"], chosen), runs, dt)
        # Without control the robot holds itself, and the next command begins from what that takes.
        sends = tm.where(control, sent, self._resting(x))

        law_memory = {path: tm.where(good_law, tick.memory[path], own[path]) for path in own}
        if "limits.tau_applied" in law_memory:  # what really goes out, for anti-windup and observers
            law_memory["limits.tau_applied"] = sends
        new = {
            "q": measured["q"], "v": measured["v"], "tau": sends, "law": command, "bump": bump, "phase": phase,
            "mode": tm.where(runs, 1.0, 0.0), "fault": fault, "blind": tm.where(seen.lost, 1.0, 0.0 * command),
            "residual": seen.residual, "index": tm.where(new_fault, index, safe["index"]),
            "value": tm.where(new_fault, value, safe["value"]), "started": 1.0, **stopping,
            "late": tm.where(runs, 0.0, self._late(chosen, sent)),
        }  # fmt: skip
        out = {"command": sent}
        if tick.mit is not None:
            zero = tm.zeros(x.n)
            stiff = tm.stack([*tick.mit[:4], tick.mit[4] + (sent - tick.command)])
            out = {"mit": tm.where(runs, stiff, tm.stack([x.q, zero, zero, zero, sent]))} | out
        out |= {f"safe.{name}": new[name] for name in ("mode", "fault", "index", "value")}
        out["safe.limited"] = sent - chosen
        out |= {
            f"terms.{name}": tm.where(runs & good_law, value, 0.0 * command) for name, value in tick.terms.items()
        }
        out["terms.safety"] = sent - tm.where(runs & good_law, command, 0.0 * command)
        out |= {column: law_memory[path] for column, path in side.recorded.items()}
        out |= {f"reference.{name}": getattr(sample, name) for name in fields}
        out |= {} if "v" in self.measures else {"v": measured["v"]}
        of_reference = {f"held.{k}": v for k, v in held.items()}
        of_reference |= {f"last.{name}": getattr(sample, name) for name in self.positions}
        return out, {f"safe.{k}": v for k, v in new.items()} | of_reference | law_memory

    @property
    def torques(self) -> bool:
        return self.side.probe.kind == "torque"

    def _payload(self, parameters: Mapping[str, Any]) -> Any:
        return PayloadValues.of(subtree(parameters, "model.payload"))

    def _at_rest(self, measured: Mapping[str, Any]) -> Any:
        side = self.side
        return side.law.at_rest(Snapshot(side.model, q=measured["q"], v=np.zeros(side.arm.n)))

    def _resting(self, x: Snapshot) -> Any:
        """(n,) command that keeps the arm where it is: gravity torque, zero speed, or the position."""
        return tm.array(x.g) if self.torques else x.q if self.side.probe.kind == "position" else tm.zeros(x.n)

    def _seen(self, inputs: Mapping[str, Any], safe: Mapping[str, Any], signal: Mapping[str, Any], dt: Any) -> Seen:
        """Measurements that can be used, and what was wrong with them.

        A joint whose position or velocity is not plausible, jumps, or contradicts the other one is lost: from that
        tick on, until `recover`, it is taken to move as the controlled stop asks it to. That begins with what was
        measured last; where position and velocity contradict each other, with the speed by position, as far as it is
        not above the measured one, so that no fault makes a joint faster.
        """
        out, bad = dict[str, Any](), dict[str, Any]()
        for name, shape in self.measured.items():
            fine = tm.abs(inputs[name]) <= PLAUSIBLE
            out[name], bad[name] = tm.where(fine, inputs[name], np.zeros(shape)), ~fine
        values = [tm.where(tm.abs(x) <= LARGEST, x, LARGEST) for name in bad for x in inputs[name]]
        findings = [Finding.of("sensor_not_finite", [x for name in bad for x in bad[name]], values)]
        recovers, ran = signal["recover"] > 0.5, safe["mode"] > 0.5
        known = (safe["started"] > 0.5) & ~recovers
        moved, periods = self.side.arm.difference(out["q"], safe["q"]), dt * (1.0 + signal["lost"])
        by_position = moved / periods
        if "v" not in self.measures:
            out["v"] = by_position
        speed = tm.abs(out["v"])
        lost = ((safe["blind"] > 0.5) & ~recovers) | bad["q"] | bad.get("v", bad["q"])
        residual, contrary = 0.0 * moved, np.zeros(self.side.arm.n) > 0.0
        if self._v_max is not None:
            # A joint that really is too fast moves as its speeds say.
            most = BELIEVED * self._v_max
            ways = [0.0 * moved, tm.clip(safe["v"], -most, most) * periods]
            ways += [tm.clip(out["v"], -most, most) * periods] if "v" in self.measures else []
            beyond = tm.maximum(moved - reduce(tm.maximum, ways), reduce(tm.minimum, ways) - moved)
            jumped = (beyond > JUMP[0] * self._v_max * periods + JUMP[1]) & known & ~lost
            findings.append(Finding.of("sensor_jump", jumped, tm.abs(moved)))
            lost = lost | jumped
        if self._v_max is not None and "v" in self.measures:
            gain = tm.minimum(periods / CONSISTENCY_TIME, 1.0)
            residual = (1.0 - gain) * safe["residual"] + gain * (by_position - 0.5 * (out["v"] + safe["v"]))
            residual = tm.where(known & ~lost, residual, 0.0)
            contrary = tm.abs(residual) > CONSISTENCY[0] * self._v_max + CONSISTENCY[1] * speed
            findings.append(Finding.of("sensor_inconsistent", contrary, tm.abs(residual)))
        lost = lost | contrary
        out["q"] = tm.where(lost, tm.where(ran, safe["q"], safe["q_stop"]), out["q"])
        begun = tm.where(contrary, tm.clip(by_position, -speed, speed), safe["v"])
        out["v"] = tm.where(lost, tm.where(ran, begun, safe["v_stop"]), out["v"])
        return Seen(measured=out, lost=lost, residual=residual, findings=findings)

    @cached_property
    def _v_max(self) -> Float64Array | None:
        """(n,) speed limits, huge where there is none; None where none is stated."""
        if self.limits.v is None or not np.isfinite(self.limits.v).any():
            return None
        return np.broadcast_to(np.where(np.isfinite(self.limits.v), self.limits.v, LARGEST), (self.side.arm.n,))

    def _finite(self, tick: Tick, own: Mapping[str, Any]) -> tuple[Vector, Any, Finding]:
        """The law's command, or zero where it or its memory is not finite."""
        fine = tm.abs(tick.command) <= LARGEST
        found = Finding.of("law_not_finite", ~fine, [LARGEST] * len(fine))
        memory = [x for path in own for x in np.ravel(tm.array(tick.memory[path]))]
        wild = reduce(lambda a, b: a | b, [~(tm.abs(x) <= LARGEST) for x in memory], found.holds)
        return tm.where(fine, tick.command, 0.0), ~wild, replace(found, holds=wild)

    def _checks(self, x: Snapshot, safe: Mapping[str, Any], tick: Tick) -> list[Finding]:
        """Limits of motion and force. Each is checked where it is stated."""
        limits, out = self.limits, list[Finding]()

        def of_joints(name: str, excess: Any) -> None:
            out.append(Finding.of(name, excess > 0.0, excess))

        def single(name: str, excess: Any) -> None:
            out.append(Finding(code=CODES[name], holds=excess > 0.0, index=-1.0, value=excess))

        for limit, sign in self._ends:
            outward, room = sign * x.v, sign * (limit - x.q)
            hardly = (outward > max(OUTWARD, self.at_rest)) & (room < self._stopping_distance(outward))
            out.append(Finding.of("position", hardly, room))
        if self._v_max is not None:
            of_joints("speed", tm.abs(x.v) - (1.0 if self.torques else FOLLOWS) * self._v_max)
        if limits.tool_speed is not None:
            single("tool_speed", tm.norm(x.twist()[:3]) - float(limits.tool_speed))
        if limits.box is not None:
            p, low, high = x.T().p, limits.box[0], limits.box[1]
            outside = tm.maximum(tm.array(low - p), tm.array(p - high))
            single("workspace", reduce(tm.maximum, list(outside)))
        if limits.power is not None and self.torques:
            single("power", safe["tau"] @ x.v - float(limits.power))
        if limits.tool_force is not None:
            single("force", tm.norm(tick.seen["F_ext"][:3]) - float(limits.tool_force))
        if limits.contact is not None:
            estimate = tick.memory["sensing.observer.tau_ext"]
            of_joints("contact", tm.abs(estimate) - limits.contact)
        return out

    def _of_loop(self, signal: Mapping[str, Any]) -> list[Finding]:
        """What the loop saw itself: a stream that stopped, missed periods, another robot or watchdog that failed."""
        stale = (signal["valid"] > 0.5) & (signal["age"] > signal["stop_after"])
        lost, fault = signal["lost"], signal["fault"]
        return [
            Finding(code=CODES["stream_stopped"], holds=stale, index=-1.0, value=signal["age"]),
            Finding(code=CODES["deadline"], holds=lost > self.limits.missed, index=-1.0, value=lost),
            Finding(code=fault, holds=fault > 0.5, index=-1.0, value=0.0),
        ]

    def _jumps(self, sample: Any, last: Mapping[str, Any], memory: Mapping[str, Any]) -> list[Finding]:
        """Positions of the reference that are further from those of the tick before than `REFERENCE_STEP`."""
        out, arm = list[Finding](), self.side.arm
        for name in self.positions:
            moved = tm.abs(np.ravel(tm.array(step_of(arm, name, getattr(sample, name), last[name]))))
            found = Finding.of("reference_jump", moved > REFERENCE_STEP, moved)
            followed = self._followed(name, memory)
            found = found if followed is True else found.only(followed)
            out.append(found if of_joints(arm, name, len(moved)) else replace(found, index=-1.0))
        return out

    def _followed(self, name: str, memory: Mapping[str, Any]) -> Any:
        """Whether the law, or that of the phase that acts, follows a field of the reference."""
        task = self.side.task
        if task is None or not issubclass(task.reference, PhaseSample):
            return True
        parts = [task.follows(phase) for phase in task.names]
        acts = [
            abs(memory["law.next"] - i) < 0.5 for i, part in enumerate(parts) if part and name.startswith(f"{part}_")
        ]
        return reduce(lambda a, b: a | b, acts, np.bool_(False))

    @cached_property
    def _ends(self) -> list[tuple[Float64Array, float]]:
        """Position limits (n,) that are stated, huge for joints without one, with the sign of their direction."""
        shape = (self.side.arm.n,)
        return [
            (np.broadcast_to(np.where(np.isfinite(limit), limit, sign * LARGEST), shape), sign)
            for limit, sign in ((self.limits.upper, 1.0), (self.limits.lower, -1.0))
            if limit is not None and np.isfinite(limit).any()
        ]

    @cached_property
    def deceleration(self) -> Float64Array:
        """(n,) of the controlled stop [rad/s^2 | m/s^2]."""
        given = self.limits.deceleration
        return np.broadcast_to(BRAKE_PER_SPEED if given is None else given, (self.side.arm.n,))

    def _stopping_distance(self, v: Any) -> Any:
        """(n,) in which the controlled stop brings a joint to rest."""
        brake = self.deceleration
        evenly = 0.5 * v * v / brake + 0.5 * brake * EASE**2
        return 0.5 * EASE * v + tm.where(v > brake * EASE, evenly, EASE * v)

    def _stop(
        self, x: Snapshot, safe: Mapping[str, Any], lost: Any, enters: Any, dt: Any
    ) -> tuple[Any, dict[str, Any]]:
        """The command of the controlled stop, and its reference.

        Law:          tau = M (a_ref + 2 omega (v_ref - v) + omega^2 (q_ref - q)) + h; q_ref follows v_ref, which goes
                      to zero with `deceleration`, or a part of it in the first and the last 0.05 s
        Closed loop:  e'' + 2 omega e' + omega^2 e = 0, with omega 20 rad/s or a twentieth of the rate

        It begins with the speed that is measured, as far as that can have come about since the tick before. A joint
        that is lost has no feedback. While the rate of the torque holds a joint's command back, the stop begins anew
        in each tick: feedback behind a rate that is too slow for it is unstable. Where commands are velocities or
        positions, these are v_ref and q_ref, which begin with the last command.
        """
        brake, kind, v_now = self.deceleration, self.side.probe.kind, tm.array(x.v)
        q_now = safe["tau"] if kind == "position" else x.q
        if kind == "velocity":
            v_now = safe["tau"]
        else:
            most = SUDDEN * brake * dt
            v_now = tm.where(lost, v_now, tm.clip(v_now, safe["v"] - most, safe["v"] + most))
        begins = enters | ((safe["late"] > 0.5) & ~lost)
        q_from, v_from = tm.where(begins, q_now, safe["q_stop"]), tm.where(begins, v_now, safe["v_stop"])
        ease = tm.minimum(tm.where(enters, 0.0, safe["ease"]) + dt / EASE, 1.0)
        change = tm.clip(min(1.0, self.side.dt / EASE) * v_from, -ease * brake * dt, ease * brake * dt)
        v_ref = v_from - change
        q_ref = q_from + 0.5 * dt * (v_from + v_ref)
        stopping = {"q_stop": q_ref, "v_stop": v_ref, "ease": ease}
        if kind != "torque":
            return (v_ref if kind == "velocity" else q_ref), stopping
        omega = min(STOP_BANDWIDTH[0], STOP_BANDWIDTH[1] * self.side.rate)
        feedback = omega**2 * x.difference(q_ref) + 2.0 * omega * (v_ref - x.v)
        return x.M @ (tm.where(lost, 0.0, feedback) - change / dt) + x.h, stopping

    def _soft(self, x: Snapshot, lost: Any) -> Any:
        """(n,) torque that damps the motion towards a position limit in the zone before it."""
        a = 0.0 * x.q
        for limit, sign in self._ends:
            room = sign * (limit - x.q)
            too_fast = tm.maximum(sign * x.v - SOFT_GAIN * tm.maximum(room, 0.0), 0.0)
            a = a - sign * tm.where((room < self.limits.soft) & ~lost, too_fast, 0.0)
        damping = min(SOFT_DAMPING[0], SOFT_DAMPING[1] * self.side.rate)
        return damping * tm.array([x.M[i, i] for i in range(x.n)]) * a

    def _late(self, asked: Vector, sent: Vector) -> Vector:
        """(n,) 1.0 for each joint whose torque needs longer than `LAG` to become what is asked for."""
        if not (self.torques and self.torque_rate):
            return tm.zeros(len(asked))
        late: Vector = tm.where(tm.abs(asked - sent) > LAG * self.torque_rate, 1.0, 0.0)
        return late

    def _limited(self, command: Vector, before: Vector, runs: Any, dt: Any) -> Vector:
        """The command within its rate, that of a stop within the robot's; then within its magnitude, which wins."""
        limits, kind = self.limits, self.side.probe.kind
        if kind == "position":
            if limits.v is not None:
                step = np.asarray(limits.v) * dt
                command = tm.clip(command, before - step, before + step)
            low = -LARGEST if limits.lower is None else np.maximum(limits.lower, -LARGEST)
            high = LARGEST if limits.upper is None else np.minimum(limits.upper, LARGEST)
            within: Vector = tm.clip(command, low, high)
            return within
        if kind == "velocity":
            most, stops = limits.v, LARGEST if limits.deceleration is None else 2.0 * np.asarray(limits.deceleration)
            rate = stops
        else:
            most, stops = limits.tau, self.torque_rate or LARGEST
            rate = stops if limits.tau_dot is None else np.minimum(limits.tau_dot, stops)
        if np.min(rate) < LARGEST:
            step = tm.where(runs, rate, stops) * dt
            command = tm.clip(command, before - step, before + step)
        if most is not None:
            most = np.minimum(most, LARGEST)
            command = tm.clip(command, -most, most)
        return command


def is_position(name: str) -> bool:
    """Whether a field of a reference, also of laws side by side, is one that may not jump."""
    return name.rpartition("_")[2] in POSITIONS


def of_joints(arm: Arm, name: str, size: int) -> bool:
    """Whether a field of a reference has a position for each joint."""
    return name.rpartition("_")[2] == "q" and size == arm.n


def step_of(arm: Arm, name: str, now: Any, last: Any) -> Any:
    """Difference (..., k) of a field of a reference; floats or symbols."""
    return arm.difference(now, last) if of_joints(arm, name, np.shape(now)[-1]) else now - last


def safe_shapes(n: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the memory below "safe", which goes on from law to law."""
    joints = ("q", "v", "tau", "law", "bump", "residual", "q_stop", "v_stop", "blind", "late")
    numbers = ("phase", "mode", "fault", "index", "value", "started", "ease")
    return dict.fromkeys(joints, (n,)) | dict.fromkeys(numbers, ())


def _first(found: list[Finding]) -> tuple[Any, Any, Any]:
    """Code, index and value of the first finding that holds; 0 without one."""
    code: Any = 0.0
    index: Any = -1.0
    value: Any = 0.0
    for one in reversed(found):
        code = tm.where(one.holds, 1.0 * one.code, code)
        index, value = tm.where(one.holds, one.index, index), tm.where(one.holds, one.value, value)
    return code, index, value
