"""Iterative learning control: an input that is learned from trial to trial of one repeated motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.parts import short_way
from taut.base.checks import instance_of, whole_number
from taut.base.errors import RangeError, UsageError, count_of
from taut.base.fields import Declared, Field, Whole
from taut.base.plot_style import WIDTH, colour, prepared
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.reference import JointMotion, known_rows
from taut.control.trajectories.samples import Learned
from taut.controller import Controller
from taut.linear.judgement import without_dry_friction
from taut.linear.lifted import Lifted
from taut.linear.linearise import linearise
from taut.linear.period import model_in_place_of
from taut.loop import Loop, duration_of_ticks, state_at_start
from taut.plant.rigid import RigidPlant
from taut.record.run import Run
from taut.runtime.events import Event
from taut.runtime.simulate import Plant, run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAME_START: Final = 1e-3  # [rad | m, per second] within which all trials start alike
NO_LEAD: Final = 1e-9  # [-] of the largest Markov parameter: the input has not reached the joints yet
SAME_RESPONSE: Final = 1e-6  # [-] of the largest response: two models are the same
NOT_ABOVE_ONE: Final = 1e-9  # [-] rounding of a norm that is one
MAX_MISS: Final = 0.9  # [-] of the predicted change of the error: nearly all of it, the loop is another one
JUDGED: Final = 0.1  # [-] of the error of trial 1: a smaller change may be noise or stick-slip
MAX_DROOP: Final = 3.0  # [rad | m] of an arm whose weight the law does not know, which the learned input lifts


class LearningLaw(Declared):
    """Base of learning laws u+ = F (Q u + K (e, e_dot)), over all samples of a trial.

    The Q-filter F runs forwards and backwards from a zero state: no phase lag, and a norm of at most one.

    Args:
        cutoff: Of the Q-filter [Hz], a Butterworth filter; no filter if left out.
        order: Of the Butterworth filter, in each direction.
    """

    cutoff: Field = Field(unit="Hz", above=0.0, optional=True, run_time=False)
    order: Whole = Whole(2, minimum=1, maximum=10)

    def maps(self, G: Lifted) -> tuple[Lifted, Lifted]:
        """Q, and K of the errors of positions and velocities, from the response G of the positions to the input."""
        raise NotImplementedError

    @property
    def is_one(self) -> bool:
        """Whether nothing of the input is forgotten, F Q = 1, so that the error itself can vanish."""
        return self.cutoff is None

    def filtered(self, G: Lifted, rate: float) -> tuple[Lifted, Lifted]:
        """F Q and F K at a rate [Hz]."""
        Q, K = self.maps(G)
        if self.cutoff is None:
            return Q, K
        from scipy.signal import butter, sosfilt

        if self.cutoff >= 0.5 * rate:
            self.refuse("cutoff", f"must be below half the rate, {0.5 * rate:g} Hz; got {self.cutoff:g}", RangeError)
        h = sosfilt(butter(self.order, self.cutoff, fs=rate, output="sos"), np.eye(1, G.samples)[0])
        forwards = Lifted.causal(h[:, np.newaxis, np.newaxis] * np.eye(G.symbol.shape[2]))
        F = forwards.T @ forwards
        return F @ Q, F @ K


class PDLearning(LearningLaw):
    """PD-type learning; P-type with Ld = 0.

    Law:          u+ = F (u + Lp e + Ld e_dot), e of the first tick that an input reaches
    Closed loop:  u+ - u_inf = F (1 - L G) (u - u_inf), e = r - G u

    Args:
        Lp: Learning gain of the error [1/s^2]; kp of the law underneath is a good first choice.
        Ld: Learning gain of its rate [1/s]; kd of the law underneath.

    References:
        Arimoto, Kawamura and Miyazaki (1984). Bristow, Tharayil and Alleyne, A survey of iterative learning control,
        IEEE Control Systems Magazine 26 (2006).
    """

    Lp: Field = Field(unit="1/s^2", shape="n", minimum=0.0, run_time=False)
    Ld: Field = Field(0.0, unit="1/s", shape="n", minimum=0.0, run_time=False)

    def check(self) -> None:
        if not np.any(self.Lp) and not np.any(self.Ld):
            self.refuse("", "needs Lp or Ld above zero; without them nothing is learned", RangeError)

    def maps(self, G: Lifted) -> tuple[Lifted, Lifted]:
        one = np.eye(G.symbol.shape[2])
        return Lifted.constant(one, G.samples), Lifted.constant(np.hstack([one * self.Lp, one * self.Ld]), G.samples)


class NormOptimal(LearningLaw):
    """Norm-optimal learning.

    Law:          u+ minimises |e+|^2 + effort |u+|^2 + change |u+ - u|^2, with e+ = e - G (u+ - u)
                  u+ = (G'G + effort + change)^-1 ((G'G + change) u + G' e)
    Closed loop:  e+ = change (G G' + change)^-1 e for effort = 0: the modelled loop's error falls in every trial

    Args:
        change: Weight of the change of the input [s^4], small against 1 / kp^2 of a computed torque underneath: less
            learns faster, and follows noise and model errors more.
        effort: Weight of the input [s^4]; what it forgets remains as an error.

    References:
        Amann, Owens and Rogers, Iterative learning control using optimal feedback and feedforward actions,
        International Journal of Control 65 (1996).
    """

    change: Field = Field(1e-8, unit="s^4", above=0.0, run_time=False)
    effort: Field = Field(0.0, unit="s^4", minimum=0.0, run_time=False)

    @property
    def is_one(self) -> bool:
        return self.cutoff is None and self.effort == 0.0

    def maps(self, G: Lifted) -> tuple[Lifted, Lifted]:
        one = np.eye(G.symbol.shape[2])
        change, both = (
            Lifted.constant(weight * one, G.samples) for weight in (self.change, self.effort + self.change)
        )
        inverse = (G.T @ G + both).inverse()
        Q = inverse @ (G.T @ G + change) if self.effort else Lifted.constant(one, G.samples)
        return Q, inverse @ G.T @ _positions(G)


def _positions(G: Lifted) -> Lifted:
    """The map from positions and velocities to positions alone."""
    n = G.symbol.shape[2]
    return Lifted.constant(np.eye(n, 2 * n), G.samples)


@dataclass(frozen=True, kw_only=True, eq=False)
class Convergence:
    """The convergence test for one model of the loop: sigma_max of Q (1 - L G), or of 1 - G L where Q = 1."""

    model: str  # the arm, and the pose about which the loop was linearised
    factor: float  # over the samples of the trial: by at least so much the distance falls from trial to trial
    long_trial: float  # the largest over all frequencies, a bound for trials of any length
    frequency: float  # [Hz] where it is largest

    @property
    def ok(self) -> bool:
        """Whether learning converges."""
        return self.factor <= 1.0 + NOT_ABOVE_ONE


@dataclass(frozen=True, kw_only=True, eq=False)
class Learning(Result):
    """A learned input, and how the error fell."""

    law: LearningLaw
    tests: tuple[Convergence, ...]  # made before the first trial, one for each model
    rms: tuple[float, ...]  # [rad | m] of each trial: root of the mean over time of the squared error of all joints
    reference: Learned  # with the input of the best trial, `reference.u` [rad/s^2 | m/s^2]: for later runs and trials
    lead: int  # ticks between an input and its first effect on the joints
    errors_fall: bool  # whether a passed test promises that no error is larger than the one before (Q = 1)
    limited: tuple[float, ...]  # [s] of each trial, in which limits cut the torque: the modelled loop has none
    unit: str  # of the error
    faults: tuple[str, ...]  # why the trials ended early, or the test that failed

    @property
    def factor(self) -> float:
        """The largest factor of all models."""
        return max(test.factor for test in self.tests)

    @property
    def best(self) -> int:
        """The trial with the smallest error, from 0 on, whose input is kept."""
        return int(np.argmin(self.rms))

    @property
    def promise(self) -> str:
        """What the convergence test promises, in words."""
        if self.faults:
            passed = all(test.ok for test in self.tests)
            return "nothing is promised: the " + ("trials went otherwise" if passed else "convergence test failed")
        if self.errors_fall:
            return "for the modelled loop no trial is worse than the one before (Q = 1)"
        return (
            f"for the modelled loop the input comes nearer to its limit by the factor {self.factor:.4g} at least in "
            "each trial; the error may rise on its way" + ("" if self.law.is_one else ", and a part of it stays")
        )

    def content(self) -> Content:
        """The promise, the errors, the tests."""
        end = f"RMS error from {self.rms[0]:.4g} to {self.rms[self.best]:.4g} {self.unit} in trial {self.best + 1}"
        rows = [(test.model, test.factor, test.long_trial, test.frequency, test.ok) for test in self.tests]
        cut = f"limits, which the modelled loop lacks, cut the torque for up to {max(self.limited):.4g} s of a trial"
        trials = [(k, *both) for k, both in enumerate(zip(self.rms, self.limited, strict=True), 1)]
        columns = ("model", "over the trial [-]", "long trials [-]", "largest at [Hz]", "converges")
        return Content(
            title=f"iterative learning control by {self.law!r}: {count_of(len(self.rms), 'trial')}",
            summary=(self.promise, end, *([cut] if any(self.limited) else [])),
            faults=self.faults,
            tables=[
                Table(title="convergence test: sigma_max of Q (1 - L G)", columns=columns, rows=rows),
                Table(title="trials", columns=("trial", f"RMS error [{self.unit}]", "limits acted [s]"), rows=trials),
            ],
            notes=[f"an input reaches the joints after {count_of(self.lead, 'tick')}"],
            figures={"RMS error by trial": self._figure},
        )

    def _figure(self) -> Figure:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(WIDTH, 3.0), dpi=150, layout="constrained")
        ax = prepared(figure.subplots(), f"{self.law!r}", f"RMS error [{self.unit}]", "trial")
        ax.semilogy(range(1, len(self.rms) + 1), self.rms, "o-", color=colour(0), markersize=4.0)
        return figure


def learn(
    ctrl: Controller,
    plant: Plant,
    ref: object,
    *,
    by: LearningLaw,
    duration: float,
    trials: int = 10,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    seed: int = 0,
    events: Iterable[Event] | Callable[[int], Iterable[Event]] = (),
    arms: Sequence[Arm] = (),
    anyway: bool = False,
) -> Learning:
    """Learn an input for a repeated motion, from trial to trial: iterative learning control.

    Law:          u+ = F (Q u + K (e, e_dot)), u [rad/s^2] added to the acceleration of the reference
    Closed loop:  e = r - G u in each trial, r the error without learning; see the learning law

    G is the response of the sampled loop, linearised with the controller's arm and the plant's drives and sensors
    about the middle, the start and the end of the motion: the convergence test is made before the first trial. What
    repeats is learned, such as payload, friction and gravity; noise and what changes from trial to trial are not.
    Each trial is a run that begins anew, learns from what the sensors show, and reports true errors.

    Args:
        ctrl: A controller whose law uses the reference's acceleration: `ComputedTorque`, or `PID` + `FeedForward`.
        plant: `taut.RigidPlant`, `taut.MujocoPlant`, ...
        ref: A sample or trajectory of joints; `result.reference`, to go on.
        by: `PDLearning` or `NormOptimal`.
        duration: Of a trial [s].
        trials: Their number.
        q0: (n,) where each trial starts [rad | m]; where the reference starts if left out.
        v0: (n,) [rad/s | m/s], likewise.
        seed: Of the noise in the first trial; each trial has another.
        events: Of each trial, or a function of the number of the trial, from 0 on, for what changes.
        arms: Further arms that the plant may have, such as with a payload: the test is made for each.
        anyway: Run even if the convergence test fails, or the error changes otherwise than that loop predicts.

    Raises:
        RangeError: The convergence test fails.
        UsageError: A law or reference that learning is not for; an unstable loop; a plant that does not start alike.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
        >>> plant = taut.RigidPlant(arm.with_payload(0.5))
        >>> ref = taut.trajectories.Quintic(q0=[0.0, 0.0], q1=[0.8, -0.6], duration=0.4)
        >>> found = taut.analysis.learn(ctrl, plant, ref, by=NormOptimal(), duration=0.5, trials=4)
        >>> found.rms[3] < 0.1 * found.rms[0], found.promise
        (True, 'for the modelled loop no trial is worse than the one before (Q = 1)')

    References:
        Norrlof and Gunnarsson, Time and frequency domain convergence properties in iterative learning control,
        International Journal of Control 75 (2002).
    """
    instance_of("ctrl", ctrl, Controller, "a controller from taut.compile")
    instance_of("by", by, LearningLaw, "a learning law, such as taut.analysis.NormOptimal()")
    instance_of("plant", plant, Plant, "a plant, such as taut.RigidPlant(arm)")
    trials = whole_number("trials", trials, minimum=1)
    side, n = ctrl.side, ctrl.side.arm.n
    ticks = round(duration_of_ticks(duration, side.dt) / side.dt) + 1
    motion = known_motion(ctrl, ref, ticks)
    q0, v0 = state_at_start(side.arm, motion.q[0] if q0 is None else q0, motion.v[0] if v0 is None else v0)
    models = _models(ctrl, plant, motion.q[[ticks // 2, 0, -1]], arms, ticks)
    by.check_size(side.arm.joint_names, "by.")
    Q, K = by.filtered(models[0].G, side.rate)
    of_errors = by.is_one and not K.symbol[:, :, n:].any()  # which then fall themselves
    tests = tuple(model.test(Q, K, of_errors=of_errors, rate=side.rate) for model in models)
    faults = _failure(tests, by, anyway)
    lead, u = models[0].lead, np.zeros((ticks, n))
    first, references, rms, limited = None, [], [], []
    errors, predicted = [], np.zeros((ticks, n))  # as sensors show them, of each trial; the next change
    for trial in range(trials):
        reference = Learned(motion=ref, u=u, period=side.dt)
        happens = events(trial) if callable(events) else events
        done = run(ctrl, plant, reference, duration=duration, q0=q0, v0=v0, seed=seed + trial, events=happens)
        if not done.outcome.ok:
            faults.append(f"trial {trial + 1} ended early: {done.outcome.message}")
            break
        first = first or done
        _require_same_start(first, done, trial)
        references.append(reference)
        rms.append(float(done.metrics.overall("rms_error")))
        limited.append(float(np.nan_to_num(done.metrics.overall("saturation_time"))))
        errors.append(short_way(motion.q - done.extra.get("sensed.q", done.q), done.continuous))
        faults += [] if faults else _otherwise(errors, predicted, side.arm.joint_names)
        if faults and not anyway:
            break
        both = np.hstack([errors[-1], motion.v - done.extra.get("sensed.v", done.v)])
        u, before = np.vstack([Q.act(u[: ticks - lead]) + K.act(both[lead:]), np.zeros((lead, n))]), u
        predicted[lead:] = models[0].G.act((before - u)[: ticks - lead])
    if not rms:
        raise UsageError(f"{faults[-1]}; learning needs a law that follows its reference without it", name="ctrl")
    return Learning(
        law=by,
        tests=tests,
        rms=tuple(rms),
        reference=references[int(np.argmin(rms))],
        lead=lead,
        errors_fall=of_errors or (by.is_one and all(model.decoupled for model in models)),
        limited=tuple(limited),
        unit=" | ".join(dict.fromkeys(side.arm.units)),
        faults=tuple(faults),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Model:
    """Response of the joints to the input over a trial, from the first tick that it reaches."""

    name: str
    lead: int
    G: Lifted  # of positions
    both: Lifted  # of positions and velocities

    @property
    def decoupled(self) -> bool:
        """Whether no joint follows the input of another."""
        size = np.abs(self.G.symbol).max(axis=0)
        return bool((size - np.diag(np.diag(size))).max() <= SAME_RESPONSE * size.max())

    def test(self, Q: Lifted, K: Lifted, *, of_errors: bool, rate: float) -> Convergence:
        """sigma_max of the map from one trial to the next, of the error or of the input."""
        change = Q - self.G @ K @ _positions(self.G).T if of_errors else Q - K @ self.both
        gains = change.gains()
        k = int(np.argmax(gains))
        frequency = 0.5 * rate * k / (len(gains) - 1)
        return Convergence(model=self.name, factor=change.norm(), long_trial=float(gains[k]), frequency=frequency)


def known_motion(ctrl: Controller, ref: object, ticks: int) -> JointMotion:
    """The reference at every tick of a trial."""
    side = ctrl.side
    if side.task is not None or side.law.reference is not JointMotion:
        which = "has phases" if side.task is not None else f"follows {side.law.reference.described()}"
        raise UsageError(
            f"an input is found for one law of joint motion; {side.title} {which}; use a law of joints, such as "
            "taut.laws.ComputedTorque",
            name="ctrl",
        )
    return known_rows("ref", ref, side.dt * np.arange(ticks, dtype=np.float64), side.arm.n)


def _models(
    ctrl: Controller, plant: Plant, poses: Float64Array, arms: Sequence[Arm], ticks: int
) -> tuple[_Model, ...]:
    """The response of the controller's arm at some poses, and of further arms; each that differs once."""
    known = plant if isinstance(plant, RigidPlant) else model_in_place_of(plant, ctrl.side)
    out: list[_Model] = []
    for arm in (ctrl.side.arm, *arms):
        model = replace(known, arm=arm, friction=None if known.friction is None else "arm")
        loop = Loop(ctrl, model, duration=ctrl.side.dt)
        changes = without_dry_friction(ctrl.side, loop.parameters)
        for path in sorted(changes, key=lambda path: path.endswith("static")):  # never less than in motion
            loop.parameters[path] = changes[path]
        for pose in poses:
            name = f"arm '{arm.name}' at q = {np.round(pose, 3).tolist()}"
            new = _model(name, loop, pose, ticks, out[0].lead if out else None)
            if not any(
                np.abs(new.G.symbol - one.G.symbol).max() <= SAME_RESPONSE * np.abs(one.G.symbol).max() for one in out
            ):
                out.append(new)
    return tuple(out)


def _model(name: str, loop: Loop, pose: Float64Array, ticks: int, lead: int | None) -> _Model:
    """The Markov parameters of a loop about a pose, as lifted maps."""
    lin, title = linearise(loop, at=pose, within=MAX_DROOP), loop.side.title
    if not lin.stable:
        raise UsageError(
            f"learning needs a stable loop; {title}, {name}, is {lin.unstable_because}; change its gains", name="ctrl"
        )
    columns, rows = lin.columns("ref.a"), [*lin.rows("q"), *lin.rows("v")]
    x, h = lin.B[:, columns], np.zeros((ticks, len(rows), len(columns)))
    h[0] = lin.D[np.ix_(rows, columns)]
    for k in range(1, ticks):
        h[k], x = lin.C[rows] @ x, lin.A @ x
    size = np.abs(h[:, : len(columns)]).max(axis=(1, 2))
    if not size.any():
        raise unused_acceleration(title)
    first = int(np.argmax(size > NO_LEAD * size.max())) if lead is None else lead
    both = h[first:]
    return _Model(name=name, lead=first, G=Lifted.causal(both[:, : len(columns)]), both=Lifted.causal(both))


def unused_acceleration(title: str) -> UsageError:
    """The error of a law that an input cannot reach."""
    return UsageError(
        f"{title} does not use the reference's acceleration, to which the input is added; take "
        "taut.laws.ComputedTorque, or add + taut.laws.FeedForward() to a taut.laws.PID",
        name="ctrl",
    )


def _failure(tests: Sequence[Convergence], by: LearningLaw, anyway: bool) -> list[str]:
    """The sentence on the test that fails most, if any; RangeError unless learning goes on anyway."""
    worst = max(tests, key=lambda test: test.factor)
    if worst.ok:
        return []
    text = f"the convergence test must give at most 1; got {worst.factor:.4g} ({worst.model}; largest at "
    text += f"{worst.frequency:.3g} Hz)"
    if not anyway:
        hint = f"{'set a' if by.cutoff is None else 'lower the'} cutoff of the Q-filter, change the gains"
        if tests[0].ok:
            hint = f"{tests[0].model} passes; change the law or the model (masses, rotor_inertia of light joints)"
        raise RangeError(f"{text}; {hint}, or set anyway=True", name="by", value=worst.factor, rule="at most 1")
    return [text]


def _otherwise(errors: Sequence[Float64Array], predicted: Float64Array, joints: Sequence[str]) -> list[str]:
    """The sentence on a last trial that the linear loop does not predict, if it does not."""
    missed = np.linalg.norm(errors[-1] - errors[max(len(errors) - 2, 0)] - predicted, axis=0)
    size, miss = np.linalg.norm(predicted), np.linalg.norm(missed)
    if size <= JUDGED * np.linalg.norm(errors[0]) or miss <= MAX_MISS * size:
        return []
    return [
        f"the error of trial {len(errors)} must change within {100 * MAX_MISS:g} % of what the linear loop predicts"
        f"; {100 * miss / size:.0f} % is missed, most in '{joints[int(np.argmax(missed))]}': a law that adapts or is "
        "not linear over this error, a limit, friction on a light joint, a push that does not repeat; change the law "
        "or the model, or go on with anyway=True"
    ]


def _require_same_start(first: Run, done: Run, trial: int) -> None:
    """UsageError if a trial did not start as the first one did: something was carried over."""
    one, other = ({"q": each.q, "v": each.v, **each.extra} for each in (first, done))
    for name in ("q", "v", "scene.poses"):
        off = float(np.abs(one[name][0] - other[name][0]).max(initial=0.0)) if name in one else 0.0
        if off > SAME_START:
            raise UsageError(
                f"every trial must start in the same state, within {SAME_START:g}; {name} of trial {trial + 1} "
                f"starts {off:.3g} away from that of trial 1: the plant carries it over; its reset() must reset it",
                name="plant",
                value=off,
            )
