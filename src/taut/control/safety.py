"""Safety of a robot's loop: limits, checks of sensors and commands, and the controlled stop, as one pure function."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import instance_of
from taut.base.errors import RangeError, UsageError
from taut.base.fields import Declared, Field
from taut.base.paths import subtree
from taut.base.types import Float64Array, Vector
from taut.control.faults import CODES, FAULTS
from taut.control.lawside import HELD, KNOWN, LawSide, Tick
from taut.control.limits import RATE_PER_EFFORT, left
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot, measurement_shapes
from taut.trace import math as tm
from taut.trace.graph import LARGEST

BRAKE_PER_SPEED: Final = 5.0  # [1/s] default deceleration over the speed limit: at rest within 0.2 s
STOP_BANDWIDTH: Final = 60.0  # [rad/s] of the position loop of a controlled stop, at most
STOP_BANDWIDTH_PER_RATE: Final = 0.06  # [-] likewise, of the rate
STOP_STIFFNESS_PER_EFFORT: Final = 5.0  # [1/rad] likewise: the effort limit at 0.2 rad
SOFT_GAIN: Final = 10.0  # [1/s] admissible speed towards a limit in its soft zone, over the distance
SOFT_DAMPING: Final = 50.0  # [1/s] deceleration over the speed above that
CONSISTENCY_TIME: Final = 0.02  # [s] over which positions and velocities are compared
CONSISTENCY: Final = (0.1, 0.3)  # [-] allowed difference: of the speed limit, and of the speed
JUMP: Final = (2.0, 0.005)  # [-], [rad | m] allowed step of a position: of the speed limit in a period, and besides
OUTWARD: Final = 1e-3  # [rad/s | m/s] slower is at rest: an arm beyond a limit may be moved back
NEVER: Final = 1e9  # [s] time-out of a reference that does not go stale
SIGNALS: Final = (
    "valid",
    "age",
    "hold_after",
    "stop_after",
    "hold",
    "recover",
    "begin",
    "over",
    "changed",
    "fault",
    "lost",
)
"""Numbers that the loop gives to each tick.

valid: 1 where there is a sample; age [s] of a stream's sample; hold_after, stop_after [s] its time-outs; hold,
recover: 1 where it is asked for; begin: 1 in the first tick of a law; over [s]: time in which its command, or that
of changed parameters, comes in; changed: 1 where parameters have; fault: code of what the loop itself saw, or 0;
lost: periods missed before this tick.
"""


class SafetyLimits(Declared):
    """Limits of a robot's loop. Torque, torque rate and the soft zone cut the command; the others end in a stop.

    The controlled stop brakes each joint with `deceleration` and then holds it there, with the model's gravity. It
    acts in the tick of the fault, which is latched until `robot.recover()`. Where no limit is stated nothing is
    checked.

    Args:
        tau: Largest torque [N m | N], one number or one per joint.
        tau_dot: Largest change of torque per second [N m/s | N/s]; magnitudes win over rates.
        v: Largest speed of the joints [rad/s | m/s].
        lower, upper: Positions [rad | m]; a joint that could not be braked before them any more is stopped.
        soft: Zone before these in which the speed towards them is damped to 10/s times the distance [rad | m].
        deceleration: Of the controlled stop [rad/s^2 | m/s^2].
        tool_speed: Largest speed of the tool [m/s].
        tool_force: Largest force of the environment at the tool [N]; of a measured or observed F_ext.
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

    @classmethod
    def of(cls, arm: Arm, **limits: Any) -> SafetyLimits:
        """Those of an arm: its effort, speed and position limits, and ten times the effort limit per second.

        Further limits by name stand in their places.
        """
        instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
        finite = np.isfinite(arm.velocity)
        own: dict[str, Any] = {"tau": arm.effort, "tau_dot": RATE_PER_EFFORT * arm.effort, "v": arm.velocity}
        own |= {"lower": arm.lower, "upper": arm.upper}
        own["deceleration"] = np.where(finite, BRAKE_PER_SPEED * np.where(finite, arm.velocity, 1.0), BRAKE_PER_SPEED)
        room = 0.25 * (arm.upper - arm.lower)
        own["soft"] = np.minimum(0.1, np.where(np.isfinite(room), room, 0.1))
        return cls(**{**own, **limits})


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """One check in a tick."""

    code: int
    holds: Any  # whether it is violated
    index: Any  # of the joint, or of the measurement
    value: Any


@dataclass(frozen=True, kw_only=True, eq=False)
class SafeSide:
    """A law side under safety limits: the tick that a robot's loop repeats.

    Its memory has `safe.*`, the same for every law, then `held.*`, the sample to hold, then that of the law side.
    """

    side: LawSide
    limits: SafetyLimits
    measures: tuple[str, ...]  # by the robot, besides positions

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
        if limits.contact is not None and self.side.sensing.observer is None:
            raise UsageError(
                "limits.contact needs an observer: compile the law with "
                "sensing=taut.Sensing(observer=taut.sensors.MomentumObserver(bandwidth=...))",
                name="contact",
            )

    @property
    def memory_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the memory by path; those of `safe` come first."""
        n, fields = self.side.arm.n, self.side.law.reference.fields(self.side.arm.n)
        return (
            {f"safe.{name}": shape for name, shape in safe_shapes(n).items()}
            | {f"held.{name}": shape for name, shape in fields.items()}
            | dict(self.side.probe.shapes)
        )

    def start(
        self, inputs: Mapping[str, Any], parameters: Mapping[str, Any], memory: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Memory in the first tick of a law: it starts from what is measured and from the torque that is sent."""
        measured, _ = self._good(inputs, subtree(memory, "safe"), subtree(inputs, "signal"), self.side.dt)
        rest = self._at_rest(measured)
        held = {KNOWN: 1.0, HELD: memory["safe.tau"]}
        law = self.side.start({**measured, "t": inputs["t"], **held}, rest, parameters)
        out = {path: memory[path] for path in memory if path.startswith("safe.")}
        out |= {f"held.{name}": getattr(rest, name) for name in self.side.law.reference.fields(self.side.arm.n)}
        return {**out, **law}

    def tick(
        self, inputs: Mapping[str, Any], parameters: Mapping[str, Any], memory: Mapping[str, Any], dt: Any
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """One tick: (outputs, new memory). It is finite whatever is measured, and whatever the law gives."""
        side, safe, signal = self.side, subtree(memory, "safe"), subtree(inputs, "signal")
        n = side.arm.n
        measured, sensors = self._good(inputs, safe, signal, dt)
        residual = measured.pop("residual")
        x = Snapshot(side.model, q=measured["q"], v=measured["v"], payload=self._payload(parameters), adds=side.adds)
        bad_sensor = reduce(lambda a, b: a | b, [one.holds for one in sensors])

        fresh = (signal["valid"] > 0.5) & (signal["age"] <= signal["hold_after"])
        begins = np.bool_(False) if side.task is None else memory["law.ticks"] < 0.5
        rest, kind = self._at_rest(measured), side.law.reference
        fields = kind.fields(n)
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

        # Checks, in the order in which the first one found is the one that is latched.
        found = [*sensors, culprit, *self._checks(x, measured, safe, tick), *self._of_loop(signal)]
        code, index, value = _first(found)
        recovers = signal["recover"] > 0.5
        latched = tm.where(recovers, 0.0, safe["fault"])
        new_fault = (latched < 0.5) & (code > 0.5)
        fault = tm.where(new_fault, code, latched)
        asked = tm.where(started, 1.0, safe["mode"])
        runs = (asked > 0.5) & (fault < 0.5) & (signal["hold"] < 0.5)
        blind = tm.where(recovers, 0.0, tm.maximum(safe["blind"], tm.where(bad_sensor & (fault > 0.5), 1.0, 0.0)))

        stop, stopping = self._stop(x, safe, (safe["mode"] > 0.5) | recovers, blind, dt)
        chosen = tm.where(runs, wanted, stop)
        chosen = chosen + self._soft(x, blind) if self._torques else chosen
        sent = self._limited(chosen, safe["tau"], dt)
        sent = tm.where(tm.abs(sent) <= LARGEST, sent, safe["tau"])

        law_memory = {path: tm.where(good_law, tick.memory[path], own[path]) for path in own}
        if "limits.tau_applied" in law_memory:  # what really goes out, for anti-windup and observers
            law_memory["limits.tau_applied"] = sent
        new = {
            "q": measured["q"], "v": measured["v"], "tau": sent, "law": command, "bump": bump, "phase": phase,
            "mode": tm.where(runs, 1.0, 0.0), "fault": fault, "blind": blind, "residual": residual,
            "index": tm.where(new_fault, index, safe["index"]), "value": tm.where(new_fault, value, safe["value"]),
            "started": 1.0, **stopping,
        }  # fmt: skip
        out = {"command": sent}
        if tick.mit is not None:
            zero = tm.zeros(n)
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
        return out, {f"safe.{k}": v for k, v in new.items()} | {f"held.{k}": v for k, v in held.items()} | law_memory

    @property
    def _torques(self) -> bool:
        return self.side.probe.kind == "torque"

    def _payload(self, parameters: Mapping[str, Any]) -> Any:
        return PayloadValues.of(subtree(parameters, "model.payload"))

    def _at_rest(self, measured: Mapping[str, Any]) -> Any:
        side = self.side
        return side.law.at_rest(Snapshot(side.model, q=measured["q"], v=np.zeros(side.arm.n)))

    def _good(
        self, inputs: Mapping[str, Any], safe: Mapping[str, Any], signal: Mapping[str, Any], dt: Any
    ) -> tuple[dict[str, Any], list[Finding]]:
        """Measurements that can be used, and what was wrong with them.

        NaN and infinity are replaced, by the last good value of q and v; where a position jumped, and as long as
        positions cannot be trusted, all of them are the last good ones.
        """
        out: dict[str, Any] = {}
        conditions: list[Any] = []
        for name, shape in self.measured.items():
            fine = tm.abs(inputs[name]) <= LARGEST
            out[name] = tm.where(fine, inputs[name], safe[name] if name in ("q", "v") else np.zeros(shape))
            conditions += [~x for x in fine]
        values = [x for name in self.measured for x in inputs[name]]
        wrong, index, value = _among(conditions, values)
        value = tm.where(tm.abs(value) <= LARGEST, value, LARGEST)  # a latched value is finite
        found = [Finding(code=CODES["sensor_not_finite"], holds=wrong, index=index, value=value)]
        moved, periods = self.side.arm.difference(out["q"], safe["q"]), dt * (1.0 + signal["lost"])
        recovers, blind = signal["recover"] > 0.5, safe["blind"] > 0.5
        known = (safe["started"] > 0.5) & ~blind & ~recovers
        frozen = blind & ~recovers
        if self._v_max is not None:
            excess = tm.abs(moved) - JUMP[0] * self._v_max * periods - JUMP[1]
            jumped, index, value = _among([(x > 0.0) & known for x in excess], list(tm.abs(moved)))
            found.append(Finding(code=CODES["sensor_jump"], holds=jumped, index=index, value=value))
            frozen = frozen | jumped
        out["q"] = tm.where(frozen, safe["q"], out["q"])
        moved = tm.where(frozen | (safe["started"] < 0.5), 0.0, moved)
        if "v" not in self.measures:
            out["v"] = moved / periods
        gain = tm.minimum(periods / CONSISTENCY_TIME, 1.0)
        residual = (1.0 - gain) * safe["residual"] + gain * (moved / periods - 0.5 * (out["v"] + safe["v"]))
        out["residual"] = residual = tm.where(known & ~frozen, residual, 0.0 * residual)
        if self._v_max is not None and "v" in self.measures:
            excess = tm.abs(residual) - CONSISTENCY[0] * self._v_max - CONSISTENCY[1] * tm.abs(out["v"])
            wrong, index, value = _among([x > 0.0 for x in excess], list(tm.abs(residual)))
            found.append(Finding(code=CODES["sensor_inconsistent"], holds=wrong, index=index, value=value))
        return out, found

    @cached_property
    def _v_max(self) -> Float64Array | None:
        """(n,) speed limits, huge where there is none; None where none is stated."""
        if self.limits.v is None or not np.isfinite(self.limits.v).any():
            return None
        return np.broadcast_to(np.where(np.isfinite(self.limits.v), self.limits.v, LARGEST), (self.side.arm.n,))

    def _finite(self, tick: Tick, own: Mapping[str, Any]) -> tuple[Vector, Any, Finding]:
        """The law's command, or zero where it or its memory is not finite."""
        conditions = [~(tm.abs(x) <= LARGEST) for x in tick.command]
        wrong, index, _ = _among(conditions, list(tick.command))
        memory = [x for path in own for x in np.ravel(tm.array(tick.memory[path]))]
        wild = reduce(lambda a, b: a | b, [~(tm.abs(x) <= LARGEST) for x in memory], wrong)
        command = tm.where(tm.abs(tick.command) <= LARGEST, tick.command, 0.0)
        return command, ~wild, Finding(code=CODES["law_not_finite"], holds=wild, index=index, value=LARGEST)

    def _checks(self, x: Snapshot, measured: Mapping[str, Any], safe: Mapping[str, Any], tick: Tick) -> list[Finding]:
        """Limits of motion and force. Each is checked where it is stated."""
        limits, n, out = self.limits, self.side.arm.n, list[Finding]()

        def of_joints(name: str, excess: Any, value: Any = None) -> None:
            holds, index, found = _among([y > 0.0 for y in excess], list(excess if value is None else value))
            out.append(Finding(code=CODES[name], holds=holds, index=index, value=found))

        def single(name: str, excess: Any) -> None:
            out.append(Finding(code=CODES[name], holds=excess > 0.0, index=-1.0, value=excess))

        brake = self.deceleration
        for limit, sign in ((limits.upper, 1.0), (limits.lower, -1.0)):
            if limit is None or not np.isfinite(limit).any():
                continue
            limit = np.broadcast_to(np.where(np.isfinite(limit), limit, sign * LARGEST), (n,))
            outward = sign * x.v
            room = sign * (limit - x.q)
            remaining = room - 0.5 * outward * outward / brake
            of_joints("position", tm.where(outward > OUTWARD, -remaining, -1.0 + 0.0 * room), room)
        if self._v_max is not None:
            of_joints("speed", tm.abs(x.v) - self._v_max)
        if limits.tool_speed is not None:
            single("tool_speed", tm.norm(x.twist()[:3]) - float(limits.tool_speed))
        if limits.box is not None:
            p, low, high = x.T().p, limits.box[0], limits.box[1]
            outside = tm.maximum(tm.array(low - p), tm.array(p - high))
            single("workspace", reduce(tm.maximum, list(outside)))
        if limits.power is not None and self._torques:
            single("power", safe["tau"] @ x.v - float(limits.power))
        if limits.tool_force is not None:
            single("force", tm.norm(measured["F_ext"][:3]) - float(limits.tool_force))
        if limits.contact is not None:
            estimate = tick.memory["sensing.observer.tau_ext"]
            of_joints("contact", tm.abs(estimate) - limits.contact)
        return out

    def _of_loop(self, signal: Mapping[str, Any]) -> list[Finding]:
        """What the loop saw itself: a stream that stopped, missed periods, a robot that failed."""
        stale = (signal["valid"] > 0.5) & (signal["age"] > signal["stop_after"])
        return [
            Finding(code=CODES["stream_stopped"], holds=stale, index=-1.0, value=signal["age"]),
            Finding(
                code=CODES["deadline"], holds=signal["lost"] > self.limits.missed, index=-1.0, value=signal["lost"]
            ),
            *(
                Finding(
                    code=code,
                    holds=(signal["fault"] > code - 0.5) & (signal["fault"] < code + 0.5),
                    index=-1.0,
                    value=0.0,
                )
                for code in FAULTS
                if code >= CODES["disconnected"]
            ),
        ]

    @cached_property
    def deceleration(self) -> Float64Array:
        """(n,) of the controlled stop [rad/s^2 | m/s^2]."""
        given = self.limits.deceleration
        return np.broadcast_to(BRAKE_PER_SPEED if given is None else given, (self.side.arm.n,))

    def _stop(
        self, x: Snapshot, safe: Mapping[str, Any], enters: Any, blind: Any, dt: Any
    ) -> tuple[Any, dict[str, Any]]:
        """The command of the controlled stop, and its reference.

        Law:          tau = M a_ref + K (q_ref - q) + D (v_ref - v) + h; v_ref goes to zero with `deceleration`
        Closed loop:  M e'' + D e' + K e = 0 for each joint by itself, as far as M is diagonal; K is at most
                      (60 rad/s)^2 M_ii, D = 2 sqrt(K M_ii)

        Where positions cannot be trusted, it is the gravity torque at the last good ones, with damping.
        """
        n, brake = x.n, self.deceleration
        q_from, v_from = tm.where(enters, x.q, safe["q_stop"]), tm.where(enters, x.v, safe["v_stop"])
        first = safe["started"] < 0.5
        q_from, v_from = tm.where(first, x.q, q_from), tm.where(first, x.v, v_from)
        change = tm.clip(v_from, -brake * dt, brake * dt)
        v_ref = v_from - change
        q_ref = q_from + 0.5 * dt * (v_from + v_ref)
        stopping = {"q_stop": q_ref, "v_stop": v_ref}
        kind = self.side.probe.kind
        if kind == "velocity":
            return tm.where(blind > 0.5, 0.0 * v_ref, v_ref), stopping
        if kind == "position":
            return tm.where(blind > 0.5, safe["tau"], q_ref), stopping
        inertia = tm.array([x.M[i, i] for i in range(n)])
        bandwidth = min(STOP_BANDWIDTH, STOP_BANDWIDTH_PER_RATE * self.side.rate)
        stiffness = bandwidth**2 * inertia
        effort = self.side.arm.effort if self.limits.tau is None else np.broadcast_to(self.limits.tau, (n,))
        if np.isfinite(effort).all():
            stiffness = tm.minimum(stiffness, tm.array(STOP_STIFFNESS_PER_EFFORT * np.asarray(effort)))
        damping = 2.0 * tm.sqrt(stiffness * inertia)
        servo = x.M @ (-change / dt) + stiffness * (q_ref - x.q) + damping * (v_ref - x.v)
        return x.h + tm.where(blind > 0.5, -damping * x.v, servo), stopping

    def _soft(self, x: Snapshot, blind: Any) -> Any:
        """(n,) torque that damps the motion towards a position limit in the zone before it."""
        limits, n, a = self.limits, x.n, 0.0 * x.q
        inertia = tm.array([x.M[i, i] for i in range(n)])
        for limit, sign in ((limits.upper, 1.0), (limits.lower, -1.0)):
            if limit is None or not np.isfinite(limit).any():
                continue
            limit = np.broadcast_to(np.where(np.isfinite(limit), limit, sign * LARGEST), (n,))
            room = sign * (limit - x.q)
            too_fast = tm.maximum(sign * x.v - SOFT_GAIN * tm.maximum(room, 0.0), 0.0)
            a = a - sign * tm.where((room < limits.soft) & (blind < 0.5), SOFT_DAMPING * too_fast, 0.0)
        return inertia * a

    def _limited(self, command: Vector, before: Vector, dt: Any) -> Vector:
        """The command within its rate, and then within its magnitude, which wins."""
        limits, kind = self.limits, self.side.probe.kind
        if kind == "position":
            if limits.v is not None:
                step = np.asarray(limits.v) * dt
                command = tm.clip(command, before - step, before + step)
            low = -LARGEST if limits.lower is None else np.maximum(limits.lower, -LARGEST)
            high = LARGEST if limits.upper is None else np.minimum(limits.upper, LARGEST)
            within: Vector = tm.clip(command, low, high)
            return within
        rate, most = (None, limits.v) if kind == "velocity" else (limits.tau_dot, limits.tau)
        if kind == "velocity" and limits.deceleration is not None:
            rate = 2.0 * np.asarray(limits.deceleration)
        if rate is not None:
            step = np.minimum(rate, LARGEST) * dt
            command = tm.clip(command, before - step, before + step)
        if most is not None:
            most = np.minimum(most, LARGEST)
            command = tm.clip(command, -most, most)
        return command


def safe_shapes(n: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the memory below "safe", which goes on from law to law."""
    joints = ("q", "v", "tau", "law", "bump", "residual", "q_stop", "v_stop")
    numbers = ("phase", "mode", "fault", "index", "value", "blind", "started")
    return dict.fromkeys(joints, (n,)) | dict.fromkeys(numbers, ())


def _among(conditions: list[Any], values: list[Any]) -> tuple[Any, Any, Any]:
    """Whether one of them holds, the index of the first one, and its value."""
    holds: Any = np.bool_(False)
    index: Any = -1.0
    value: Any = 0.0
    for i in reversed(range(len(conditions))):
        holds = holds | conditions[i]
        index, value = tm.where(conditions[i], float(i), index), tm.where(conditions[i], values[i], value)
    return holds, index, value


def _pick(index: Any, values: Any) -> Any:
    """The entry of an index that is not known beforehand."""
    out: Any = 0.0
    for i in range(len(values)):
        out = tm.where((index > i - 0.5) & (index < i + 0.5), values[i], out)
    return out


def _first(found: list[Finding]) -> tuple[Any, Any, Any]:
    """Code, index and value of the first finding that holds; 0 without one."""
    code: Any = 0.0
    index: Any = -1.0
    value: Any = 0.0
    for one in reversed(found):
        code = tm.where(one.holds, float(one.code), code)
        index, value = tm.where(one.holds, one.index, index), tm.where(one.holds, one.value, value)
    return code, index, value
