"""What a design runs into: torque, rate and speed of a step, the servo rate, delay, encoders, ki, gears, coupling."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.linalg import eigh

from taut import laws
from taut.analysis.design.directions import Direction, designed_part, fed_forward, weight_gradient
from taut.analysis.design.trial import Bench, Numbers, Response
from taut.analysis.tool.impedance import check_impedance
from taut.arm.description import Arm
from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.control.limits import RATE_PER_EFFORT
from taut.linear.linear_loop import LinearLoop
from taut.linear.margins import common_delay
from taut.linear.sampled import largest_factor
from taut.maths.snapshot import Snapshot
from taut.plant.rigid import RigidPlant

__all__ = ["RESTS", "DesignLimit", "Tried", "growth", "largest_steps", "limits_of", "steps_of"]

KEPT: Final = 0.1  # of the damping ratio: what sampling, or an integral, may take
COUNT: Final = 0.01  # of the effort limit: a torque that an encoder's step may make
STEP_JOINT: Final = {"rad": 0.1, "m": 0.05}
PRESS: Final = {"N": 10.0, "N m": 1.0}
EVERY: Final = 1e-12
ROUGH: Final = 20  # halvings of a stability limit
TWICE: Final = 2.0  # times the slowest rate that can be tried: below it no limit is looked for
STANDS: Final = 1e-6  # of the modulus of a pole at 1, which rounding splits
ROUNDS: Final = 1e-9  # of a period
RESTS: Final = 1e-9  # [rad | m] of a steady-state error: rounding
PULLED: Final = 0.2  # of kp: what the weight's gradient may add or take, a tenth of omega_n
NONE: Final = 1e-9  # of a growth in a tick: rounding
VISIBLE: Final = 5e-4  # likewise, which four digits show
LASTING: Final = 1e-6  # [1/s] a pole that is slower is one that stays


@dataclass(frozen=True, kw_only=True)
class DesignLimit:
    """One limit, and how near the design is.

    Args:
        name: Of what: "torque", "torque rate", "speed", "damping", "rate", "delay", "gain margin", "encoder", "ki",
            "integral", "weight", "coupling", "stiffness", "at rest", "force pole", "decay", "backlash",
            "elastic joint", "on plant".
        value: What the design has or needs.
        limit: What there is; infinite for none.
        unit: Of both.
        ok: Whether the design keeps to it.
        sentence: That in words.
    """

    name: str
    value: float
    limit: float
    unit: str
    ok: bool
    sentence: str


def growth(radius: float) -> str:
    """How a loop grows in a tick, with the digits that tell it from 1."""
    if radius - 1.0 < NONE:
        return "does not die away"
    return f"grows by the factor {radius:.4g}" if radius - 1.0 > VISIBLE else f"grows by 1 + {radius - 1.0:.2g}"


def steps_of(law: str, directions: tuple[Direction, ...], step: Float64Array | None) -> Float64Array:
    """(k,) the step in each direction: what was asked for, or 0.1 rad and 0.05 m; of a force 10 N and 1 N m.

    Of a force it is the motion that the contact makes of it.

    Raises:
        UsageError: A step of a law that follows none, or one number for metres and radians.
    """
    if step is None:
        return np.array([PRESS[d.unit] / d.per_unit if d.unit in PRESS else STEP_JOINT[d.unit] for d in directions])
    if not directions:
        raise UsageError(
            f"step has no meaning for {law}, which draws the arm nowhere here; leave it out", name="step"
        )
    units = {d.unit for d in directions}
    if step.ndim == 0 and len(units) > 1:
        first, second = ("N", "N m") if "N" in units else ("m", "rad")
        raise UsageError(
            f"step needs one number in {first} and one in {second} for {law}, as in "
            f"step=({PRESS.get(first) or STEP_JOINT[first]:g}, {PRESS.get(second) or STEP_JOINT[second]:g}); got "
            f"{float(step):g} alone",
            name="step",
        )
    pair = np.broadcast_to(step, (2,))
    return np.array([float(pair[0 if d.unit in ("m", "N") else 1]) / d.per_unit for d in directions])


@dataclass(frozen=True, kw_only=True, eq=False)
class Tried:
    """What the limits are read off, at the pose that is designed for.

    Args:
        bench: The law in the plant that the design is for.
        arm: The arm.
        q: (n,) of the reference.
        x: At the equilibrium of the loop.
        lin: The linear model there.
        directions: Of the error.
        designed: In each, in continuous time.
        predicted: In each, a step of the sampled loop.
        steps: (k,) the steps that limits are told for.
        plant: The user's own, if there is one.
    """

    bench: Bench
    arm: Arm
    q: Float64Array
    x: Snapshot
    lin: LinearLoop
    directions: tuple[Direction, ...]
    designed: tuple[Numbers, ...]
    predicted: tuple[Response, ...]
    steps: Float64Array
    plant: RigidPlant | None


def limits_of(tried: Tried) -> tuple[DesignLimit, ...]:
    """All that have a meaning for the law and the arm."""
    found: list[DesignLimit] = []
    if tried.bench.kind == "torque":
        found += _torque_limits(tried)
    if tried.directions:
        found += [*_speed(tried), *_damping(tried), *_rate(tried), *_delay(tried)]
    found += [
        *_slow(tried),
        *_margins(tried),
        *_encoder(tried),
        *_integral(tried),
        *_weight(tried),
        *_coupling(tried),
    ]
    return (*found, *_stiffness(tried))


def _holding(tried: Tried) -> Float64Array:
    """(n,) torques of the law at rest, none where the plant carries the weight."""
    return np.zeros(tried.x.n) if tried.bench.carried else np.asarray(tried.x.g)


def _torque_limits(tried: Tried) -> Iterator[DesignLimit]:
    """Of the torque and of its rate, for the stated steps."""
    arm = tried.arm
    if not np.isfinite(arm.effort).any():
        yield DesignLimit(
            name="torque", value=0.0, limit=math.inf, unit="N m", ok=True,
            sentence=f"'{arm.name}' states no torque limits",
        )  # fmt: skip
        return
    if not tried.directions:
        return
    found = largest_steps(tried)
    k = min(range(len(found)), key=lambda i: found[i][0] / float(tried.steps[i]))
    (most, joint), d, size = found[k], tried.directions[k], float(tried.steps[k])
    ok = most >= size
    yield DesignLimit(
        name="torque", value=size * d.per_unit, limit=most * d.per_unit, unit=d.unit, ok=ok,
        sentence=(
            f"a step of {size * d.per_unit:.3g} {d.unit} along {d.name} "
            f"{'keeps within the limits' if ok else 'saturates'}; one of {most * d.per_unit:.3g} {d.unit} takes all "
            f"that joint '{arm.joint_names[joint]}' has"
        ),
    )  # fmt: skip
    times = [_ramp(tried, k) for k in range(len(tried.directions))]
    k = max(range(len(times)), key=lambda i: times[i][0])
    (seconds, joint), d, size = times[k], tried.directions[k], float(tried.steps[k])
    ok = seconds <= tried.lin.dt
    yield DesignLimit(
        name="torque rate", value=seconds, limit=tried.lin.dt, unit="s", ok=ok,
        sentence=(
            f"a step of {size * d.per_unit:.3g} {d.unit} along {d.name} jumps at joint '{arm.joint_names[joint]}' by "
            f"what a limit of {RATE_PER_EFFORT:g} times the effort per second lets through in {seconds:.3g} s"
            f"{'' if ok else '; follow a trajectory instead'}"
        ),
    )  # fmt: skip


def largest_steps(tried: Tried) -> list[tuple[float, int]]:
    """Of each direction the largest step within the limits of torque, or of the speed of drives, and the joint."""
    found = []
    for response in tried.predicted:
        effort, used, hold = tried.arm.effort, response.command, _holding(tried)
        if tried.bench.kind != "torque":
            effort, used, hold = tried.arm.velocity, response.v, np.zeros(tried.x.n)
        left = np.where(used > 0.0, effort - hold, effort + hold)
        room = np.divide(left, np.abs(used), out=np.full(used.shape, np.inf), where=np.abs(used) > EVERY)
        found.append((float(room.min()), int(np.argmin(room.min(axis=0)))))
    return found


def _ramp(tried: Tried, k: int) -> tuple[float, int]:
    """How long a limit of the torque rate takes for the largest change in a tick, and the joint."""
    command = tried.predicted[k].command * tried.steps[k]
    change = np.abs(np.diff(command, axis=0, prepend=np.zeros((1, tried.x.n)))).max(axis=0)
    seconds = change / (RATE_PER_EFFORT * tried.arm.effort)
    return float(seconds.max()), int(np.argmax(seconds))


def _speed(tried: Tried) -> Iterator[DesignLimit]:
    arm = tried.arm
    worst, joint, step = 0.0, 0, ""
    for d, response, size in zip(tried.directions, tried.predicted, tried.steps, strict=True):
        use = np.abs(response.v).max(axis=0) * size / arm.velocity
        if use.max() > worst:
            worst, joint = float(use.max()), int(np.argmax(use))
            step = f"{size * d.per_unit:.3g} {d.unit} along {d.name}"
    if worst > 0.0:
        yield DesignLimit(
            name="speed", value=worst * float(arm.velocity[joint]), limit=float(arm.velocity[joint]),
            unit=f"{arm.units[joint]}/s", ok=worst <= 1.0,
            sentence=(
                f"a step of {step} takes {100.0 * worst:.3g} % of the speed that joint "
                f"'{arm.joint_names[joint]}' has"
            ),
        )  # fmt: skip


def _damping(tried: Tried) -> Iterator[DesignLimit]:
    """What the servo rate makes of the damping."""
    damping = [response.numbers.zeta for response in tried.predicted]
    lost = [(book.zeta - seen) / max(book.zeta, KEPT) for seen, book in zip(damping, tried.designed, strict=True)]
    at = int(np.argmax(lost if max(lost) > KEPT else np.abs(lost)))
    book, seen = tried.designed[at].zeta, damping[at]
    yield DesignLimit(
        name="damping", value=seen, limit=book, unit="", ok=bool(lost[at] <= KEPT),
        sentence=(
            f"at {tried.bench.ctrl.rate:g} Hz zeta is {seen:.4g} along {tried.directions[at].name}, in "
            f"continuous time {book:.4g}"
        ),
    )  # fmt: skip


def _rate(tried: Tried) -> Iterator[DesignLimit]:
    """The servo rate from which on the whole loop is stable, a delay of as many periods included."""
    bench, rate, slowest = tried.bench, tried.bench.ctrl.rate, tried.bench.motion.slowest_rate
    if bench.kind != "torque" or rate < TWICE * slowest:
        return
    rest = bench.resting(tried.q)

    def stable(factor: float) -> bool:
        return bench.radius_at(rest, tried.lin, rate / factor) <= 1.0 + STANDS

    factor = largest_factor(stable, 1.0, rate / slowest, halvings=ROUGH)
    least = slowest if math.isinf(factor) else rate / factor
    found = f"at {least:.4g} Hz too" if math.isinf(factor) else f"from {least:.4g} Hz on"
    yield DesignLimit(
        name="rate", value=rate, limit=least, unit="Hz", ok=True,
        sentence=f"the loop of all joints is stable {found}; the rate is {rate:g} Hz",
    )  # fmt: skip


def _delay(tried: Tried) -> Iterator[DesignLimit]:
    """The largest delay of whole periods with which the whole loop is stable."""
    if tried.bench.kind != "torque":
        return
    delay, lin, dt = float(tried.bench.plant.actuation.delay), tried.lin, tried.lin.dt
    angles = np.abs(np.angle(lin.poles[np.abs(lin.poles) > EVERY])) / dt
    more = common_delay(lin.input_sensitivity, dt, angles)
    most = math.inf if math.isinf(more) else delay + max(math.ceil(more - ROUNDS) - 1, 0) * dt
    yield DesignLimit(
        name="delay", value=delay, limit=most, unit="s", ok=True,
        sentence=(
            "the loop of all joints is stable "
            f"{'with any delay' if math.isinf(most) else f'up to {1e3 * most:.4g} ms of whole periods'} from tick to "
            f"torque, where there are {1e3 * delay:.4g} ms"
        ),
    )  # fmt: skip


def _slow(tried: Tried) -> Iterator[DesignLimit]:
    """Of a law of force, the pole with which its integral takes the rest of an error away; of one that lets float."""
    law = tried.bench.law
    if isinstance(law, laws.GravityCompensation):
        rates = [mode.s.real for mode in tried.lin.modes if abs(mode.s) > LASTING]
        if rates:
            yield DesignLimit(
                name="decay", value=-max(rates), limit=0.0, unit="1/s", ok=True,
                sentence=f"the speed that a push leaves dies away with {-max(rates):.4g} 1/s or faster, M coupled",
            )  # fmt: skip
    if not isinstance(law, laws.ForceControl) or not tried.directions:
        return
    book = min(float(np.abs(d.dynamics.poles).min()) for d in tried.directions)
    seen = min(float(np.abs(p.poles).min()) for p in tried.predicted)
    yield DesignLimit(
        name="force pole", value=seen, limit=book, unit="1/s", ok=abs(seen / book - 1.0) < KEPT,
        sentence=f"an error of the force dies away with {seen:.4g} 1/s on this contact, {book:.4g} 1/s in "
            "continuous time",
    )  # fmt: skip


def _margins(tried: Tried) -> Iterator[DesignLimit]:
    """Of the whole loop, broken at all commands at once."""
    if tried.bench.kind != "torque" or not tried.directions:
        return
    disk = tried.lin.margins.disk
    low, high = disk.gain
    yield DesignLimit(
        name="gain margin", value=high, limit=1.0, unit="", ok=high > 1.0,
        sentence=(
            f"all torques at once may be {low:.3g} to {high:.3g} times what is commanded, or {disk.phase:.3g} deg "
            "late, each in another way"
        ),
    )  # fmt: skip


def _torque(unit: str) -> str:
    """The unit of what moves a joint."""
    return "N" if unit == "m" else "N m"


def _encoder(tried: Tried) -> Iterator[DesignLimit]:
    """What one count of an encoder makes of the torque, where the law sees it first."""
    if tried.bench.kind != "torque":
        return
    lin, arm = tried.lin, tried.arm
    columns = [lin.states.index(f"plant.q[{i}]") for i in range(arm.n)]
    slope = np.abs(lin.C[np.ix_(list(lin.rows("command")), columns)])  # (n, n) [N m/rad]
    share = slope / arm.effort[:, np.newaxis]
    if not np.isfinite(share).all() or not share.any():
        return
    i, j = np.unravel_index(int(np.argmax(share)), share.shape)
    fine = COUNT / float(share[i, j])
    given = None if tried.plant is None else tried.plant.sensors.position.resolution
    if given is None:
        yield DesignLimit(
            name="encoder", value=0.0, limit=fine, unit=arm.units[j], ok=True,
            sentence=(
                f"an encoder with steps of {fine:.2g} {arm.units[j]} at '{arm.joint_names[j]}' would move the torque "
                f"of '{arm.joint_names[i]}' by 1 % of its limit with each"
            ),
        )  # fmt: skip
        return
    at_motor = tried.plant is not None and tried.plant.sensors.position.side == "motor"
    steps = np.broadcast_to(np.asarray(given), (arm.n,)) / (arm.gear if at_motor else 1.0)
    flicker = slope * steps
    i, j = np.unravel_index(int(np.argmax(flicker / arm.effort[:, np.newaxis])), share.shape)
    part = float(flicker[i, j] / arm.effort[i])
    yield DesignLimit(
        name="encoder", value=float(steps[j]), limit=COUNT / part * float(steps[j]), unit=arm.units[j],
        ok=part <= COUNT,
        sentence=(
            f"one count of '{arm.joint_names[j]}', {steps[j]:.2g} {arm.units[j]}, moves the torque of "
            f"'{arm.joint_names[i]}' by {flicker[i, j]:.2g} {_torque(arm.units[i])}, {100.0 * part:.2g} % of its "
            "limit"
        ),
    )  # fmt: skip


def _integral(tried: Tried) -> Iterator[DesignLimit]:
    """0 <= ki < (b + kd) kp / M."""
    gains = [(d, d.dynamics.joint) for d in tried.directions if d.dynamics.joint is not None]
    if not gains or not any(hasattr(part, "ki") for part in _laws(tried)):
        return
    d, joint = max(gains, key=lambda pair: pair[1].ki / pair[1].largest_ki if pair[1].largest_ki else math.inf)
    most = joint.largest_ki
    if joint.ki:
        yield _changed(d)
    yield DesignLimit(
        name="ki", value=joint.ki, limit=most, unit="per unit of inertia", ok=joint.ki < most,
        sentence=(
            f"ki is {joint.ki:.4g} per unit of inertia, of {most:.4g} that (b + kd) kp / M allows ({d.name})"
            if joint.ki
            else "ki = 0; integral=1 is the bound (b + kd) kp / M, which swings for ever; 0.05 to 0.2 are usual"
        ),
    )  # fmt: skip


def _changed(d: Direction) -> DesignLimit:
    """What an integral makes of the damping that was asked for, which is that of the gains without it."""
    without, book = Numbers.designed(d.dynamics.replaced(ki=0.0)), Numbers.designed(d.dynamics)
    ok = book.zeta >= (1.0 - KEPT) * without.zeta
    return DesignLimit(
        name="integral", value=book.zeta, limit=without.zeta, unit="", ok=ok,
        sentence=(
            f"what was asked for is that without ki: along {d.name} ki makes zeta {book.zeta:.4g} of "
            f"{without.zeta:.4g}, an overshoot of {book.overshoot:.3g} % of {without.overshoot:.3g} %, a settling "
            f"time of {book.settling:.4g} s of {without.settling:.4g} s"
            f"{'' if ok else '; ask for a smaller integral='}"
        ),
    )  # fmt: skip


def _laws(tried: Tried) -> list[Any]:
    law = tried.bench.law
    return [*law.children().values()] if isinstance(law, laws.Sum) else [law]


def _weight(tried: Tried) -> Iterator[DesignLimit]:
    """What the weight does that the law does not compensate: a steady-state error, and its gradient beside kp."""
    law, arm = tried.bench.law, tried.arm
    if not tried.bench.uncompensated:
        return
    part: Any = designed_part(law)
    kp, G = np.asarray(part.kp.matrix(tried.x.n)), weight_gradient(tried.x)
    shares = 1.0 + eigh(G, 0.5 * (kp + kp.T), eigvals_only=True)
    worst = float(shares[np.argmax(np.abs(shares - 1.0))])
    kept = abs(worst - 1.0) <= PULLED
    added = f"dg/dq adds to kp, and makes {worst:.3g} of it in one motion of the joints"
    if fed_forward(law):
        if G.any():
            yield DesignLimit(
                name="weight", value=worst, limit=1.0, unit="of kp", ok=kept,
                sentence=(
                    f"FeedForward compensates the weight at the reference: off it {added}; GravityPID compensates it "
                    "where the arm is"
                ),
            )  # fmt: skip
        return
    g, droop = np.asarray(tried.x.g), np.abs(tried.lin.moved)
    i = int(np.argmax(droop))
    rests = bool(droop[i] <= RESTS)
    sentence = (
        f"the weight of {g[i]:.3g} {_torque(arm.units[i])} at '{arm.joint_names[i]}' leaves a steady-state error of "
        f"{droop[i]:.3g} {arm.units[i]}; GravityPID, FeedForward() + PID or integral= help"
    )
    if rests:
        carried = "in the end the integral carries the weight" if tried.bench.integral else "no weight acts here"
        sentence = f"{carried}, without a steady-state error"
    out = np.flatnonzero((tried.lin.q < arm.lower) | (tried.lin.q > arm.upper))
    if out.size:
        sentence += f"; '{arm.joint_names[out[0]]}' would be beyond its limits there"
    yield DesignLimit(
        name="weight", value=0.0 if rests else float(droop[i]), limit=0.0, unit=arm.units[i],
        ok=rests and kept and not out.size, sentence=f"{sentence}; about it {added}" if G.any() else sentence,
    )  # fmt: skip


def _coupling(tried: Tried) -> Iterator[DesignLimit]:
    """How far apart the modes of joints are that a decentralised law takes for alike."""
    parts = [part for part in _laws(tried) if isinstance(part, (laws.PID, laws.GravityPID))]
    if not parts or len(tried.designed) < 2:
        return
    low, high = (pick(each.zeta for each in tried.designed) for pick in (min, max))
    if high - low < KEPT:
        return
    mixed, way_out = "M and dg/dq couple" if tried.bench.uncompensated else "M couples", "coupled=True"
    if tried.bench.uncompensated or isinstance(tried.bench.law, laws.Sum):  # for which it is not enough, or not taken
        way_out = "GravityPID with coupled=True"
    yield DesignLimit(
        name="coupling", value=low, limit=high, unit="", ok=False,
        sentence=(
            f"{mixed} the joints: their modes have zeta from {low:.3g} to {high:.3g} where each by itself has the "
            f"one that was asked for; {way_out} makes gains with which they are alike"
        ),
    )  # fmt: skip


def _stiffness(tried: Tried) -> Iterator[DesignLimit]:
    law: Any = tried.bench.law
    if not isinstance(law, (laws.Impedance, laws.Stiffness)) or vars(law).get("D") is not None:
        return
    check = check_impedance(tried.bench.ctrl, tried.x.q, delay=float(tried.bench.plant.actuation.delay))
    held = "" if tried.bench.motion.exact else "of an arm that moves all the time, not in the steps of plant=: "
    yield DesignLimit(
        name="stiffness", value=1.0, limit=check.stable_up_to, unit="K", ok=check.stable,
        sentence=f"{held}{check.sentences[0]}; {check.sentences[2]}",
    )  # fmt: skip
