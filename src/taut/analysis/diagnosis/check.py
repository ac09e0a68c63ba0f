"""A check of the doctor: the run that it sees, what it needs, its thresholds, and the finding that it gives."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

from taut.analysis.diagnosis.model import ArmModel, Fit, external_torque, fit_residual, stretched_length
from taut.analysis.diagnosis.spectrum import Oscillation, find_oscillation
from taut.arm.parts import short_way
from taut.base.errors import UsageError
from taut.base.plot_style import INK, WIDTH, colour, line, prepared
from taut.base.types import Array, Float64Array
from taut.codegen.program import failure
from taut.control.limits import LIMIT_TERMS
from taut.control.trajectories.force_reference import HybridMotion, TaskForce
from taut.control.trajectories.task_reference import TaskMotion
from taut.record.metrics import RESTING
from taut.record.run import Run
from taut.record.tool import expected_deviation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Need = Literal["length", "torque", "error", "effort", "model"]
TITLE_LETTERS: Final = 100  # of a line of a figure's title
MODEL_TERMS: Final = frozenset(
    {"gravity", "nonlinear", "feedforward", "friction", "inertia", "curvature", "chain", "force_nonlinear", "force"}
    | {"wrench", "sensor", "lead", "dither"}
)
"""Terms that a law takes from its model, its reference, a measured wrench or a clock; the others are feedback."""
ROUNDING: Final = 1e-9
PINNED_TICKS: Final = 3  # at the largest torque: fewer may be a peak


class Number(NamedTuple):
    """A number with its unit."""

    value: float
    unit: str = ""

    def __str__(self) -> str:
        whole = 999.5 <= abs(self.value) < 1e6 or (abs(self.value) < 1e6 and float(self.value).is_integer())
        return f"{self.value:{'.0f' if whole else '.3g'}} {'' if self.unit == '1' else self.unit}".rstrip()


@dataclass(frozen=True)
class Threshold:
    """A threshold of a check, which reads it as `run.threshold[name]`, with its unit ("1" of a ratio) and reason."""

    name: str
    value: float
    unit: str
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """A fault that a check found in a run.

    A check's test makes it by `run.finding(...)`; the check adds its name and its sentences.

    Args:
        term: The responsible term of the command, as in `run.terms`; or "delay" (between command and torque),
            "friction", "transmission", "contact", "constraint", "period".
        joint: The joint where it is worst; None where it concerns the whole arm.
        fraction: 0 to 1: the part of the feedback effort that it explains, or of what `of` names.
        evidence: The numbers that it was found by.
        t: (k,) time of its figure [s].
        signals: (k,) by name with unit: what its figure shows.
        follows: The findings that bring it about; in a diagnosis, the one that it is a consequence of, or none.
        of: What `fraction` is a part of.
        name: The check.
        cause: What happened, in a sentence.
        remedy: What to do about it, in a sentence.
        note: What else is known of it.
        part: The phases of a task, or the one of laws side by side, in which it was found.
    """

    term: str
    joint: str | None
    fraction: float
    evidence: Mapping[str, Number]
    t: Float64Array
    signals: Mapping[str, Float64Array]
    follows: tuple[str, ...] = ()
    of: str = "the feedback effort"
    name: str = ""
    cause: str = ""
    remedy: str = ""
    note: str = ""
    part: str | None = None

    def plot(self) -> Figure:
        """The signals over time as a matplotlib Figure."""
        from matplotlib.figure import Figure

        lines = textwrap.wrap(f"{self.name}: {self.cause}".replace("$", r"\$"), TITLE_LETTERS)
        figure = Figure(figsize=(WIDTH, 0.4 + 1.7 * len(self.signals)), dpi=150, layout="constrained")
        figure.suptitle("\n".join(lines), fontsize=9.0, color=INK, x=0.01, ha="left")
        axes = figure.subplots(len(self.signals), 1, sharex=True, squeeze=False)[:, 0]
        for i, (name, y) in enumerate(self.signals.items()):
            ax = prepared(axes[i], "", name, "t [s]" if i == len(axes) - 1 else "")
            line(ax, self.t, y, colour(i))
            ax.margins(x=0.01)
        return figure

    def __str__(self) -> str:
        where = "" if self.joint is None else f" at '{self.joint}'"
        where += "" if self.part is None else f" in {self.part}"
        after = f", a consequence of '{self.follows[0]}'" if self.follows else ""
        return (
            f"{self.name}{where} (term {self.term}, {100.0 * self.fraction:.0f} % of {self.of}{after}): "
            f"{self.cause}; remedy: {self.remedy}{self.note}"
        )


@dataclass(frozen=True, kw_only=True)
class Check:
    """A check of the doctor.

    Args:
        name: What its finding is called.
        test: A function of the run that gives a `Finding` where the fault is there, else None.
        needs: What it needs to know of a run; where a run lacks it, the check is left out and a note says so.
        thresholds: The numbers that the test compares with.
        cause: What happened, in a sentence. {joint}, {term} and the names of the evidence are replaced.
        remedy: What to do about it, likewise; or by term, with "" for all other terms.
        follows: Names of findings that bring this one about: it then stands behind them.

    Example:
        >>> import numpy as np, taut
        >>> from taut.analysis import CHECKS, Check, Threshold
        >>> def too_fast(run):
        ...     speed = np.abs(run.run.v).max(axis=0)
        ...     i = int(speed.argmax())
        ...     if speed[i] < run.threshold["joint speed"]:
        ...         return None
        ...     return run.finding("command", i, 1.0, {"speed": (speed[i], "rad/s")})
        >>> mine = Check(
        ...     name="too fast",
        ...     test=too_fast,
        ...     thresholds=(Threshold(name="joint speed", value=0.5, unit="rad/s", reason="a person stands near"),),
        ...     cause="'{joint}' moves at {speed}",
        ...     remedy="give the motion more time",
        ... )
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
        >>> path = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + [0.5, 0.0], duration=1.0)
        >>> run = taut.run(ctrl, taut.RigidPlant(arm), path, duration=1.5)
        >>> taut.doctor(run, checks=[*CHECKS, mine]).findings[0].cause
        "'joint1' moves at 0.935 rad/s"
    """

    name: str
    test: Callable[[ExaminedRun], Finding | None]
    cause: str
    remedy: str | Mapping[str, str]
    needs: tuple[Need, ...] = ()
    thresholds: tuple[Threshold, ...] = ()
    follows: tuple[str, ...] = ()

    def examine(self, run: ExaminedRun) -> Finding | None:
        """The finding of a run that has what the check needs, with its sentences; None where there is no fault."""
        try:
            found = self.test(run)
        except Exception as error:
            raise self._refusal(f"it raises {failure(error)}") from error
        if found is None:
            return None
        if not isinstance(found, Finding):
            raise self._refusal(f"got {found!r}")
        values = {"joint": found.joint, "term": found.term, **found.evidence}
        remedy = self.remedy if isinstance(self.remedy, str) else self.remedy.get(found.term, self.remedy.get("", ""))
        try:
            cause, remedy = self.cause.format_map(values), (found.remedy or remedy).format_map(values)
        except KeyError as missing:
            raise UsageError(
                f"check '{self.name}' names {missing}; its finding has {', '.join(values)}", name="cause"
            ) from missing
        return dataclasses.replace(found, name=self.name, cause=cause, remedy=remedy, follows=self.follows)

    def _refusal(self, got: str) -> UsageError:
        return UsageError(f"test of check '{self.name}' must return run.finding(...) or None; {got}", name="test")


@dataclass(frozen=True, kw_only=True, eq=False)
class ExaminedRun:
    """A run as the doctor's checks see it.

    Args:
        run: The recorded run, without gaps; of a task one visit to a phase, of laws side by side one of them.
        model: The model that its controller had; None where it is not known.
        threshold: The thresholds of all checks by name, and those that they share.
        ran_away: Whether the loop left its limits for good, so that the end of the run was cut off.
    """

    run: Run
    model: ArmModel | None
    threshold: Mapping[str, float]
    ran_away: bool = False

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.run.n

    @property
    def dt(self) -> float:
        """The nominal period [s]."""
        return 1.0 / self.run.rate

    @property
    def of_torque(self) -> bool:
        """Whether the law commands torques."""
        return self.run.kind == "torque"

    @cached_property
    def end(self) -> slice:
        """The last ticks of the run, whose mean is its end."""
        return self._tail(1)

    def _tail(self, back: int) -> slice:
        size = max(1, len(self.run) // 10)
        return slice(len(self.run) - back * size, len(self.run) - (back - 1) * size)

    @cached_property
    def resting(self) -> Array:
        """(k, n) whether a joint is at rest."""
        return np.asarray(np.abs(self.run.v) < RESTING)

    @cached_property
    def length(self) -> float:
        """[m] of the stretched arm, from the first joint to the tool: 1 rad of a joint moves the tool as far."""
        return 1.0 if self.run.info.tool is None else stretched_length(self.run.info.tool) or 1.0

    @property
    def of_task(self) -> bool:
        """Whether the reference is a motion of the tool."""
        return isinstance(self.run.reference.motion, TaskMotion) and self.run.info.tool is not None

    @property
    def presses(self) -> bool:
        """Whether the law controls a contact force."""
        return isinstance(self.run.reference, HybridMotion | TaskForce)

    @cached_property
    def error(self) -> Float64Array | None:
        """(k, n) error of the joints [rad | m], desired minus actual; of a task J^+ X_e.

        Of an impedance: against the pose to which the measured wrench should have moved the tool. None of a law that
        controls a force, whose error of motion is only known along its constraint.
        """
        if self.run.error is not None or self.presses or not self.of_task:
            return None if self.presses else self.run.error
        task = self.run.task
        if task.position_error is None or task.rotation_error is None:
            return None
        X = np.concatenate([task.position_error, task.rotation_error], axis=1)
        promised = expected_deviation(self.run)
        X = X if promised is None else X + promised
        return np.asarray(np.einsum("kij,kj->ki", np.linalg.pinv(task.J, rcond=1e-2), X))

    @cached_property
    def tolerance(self) -> Float64Array:
        """(n,) error of a joint that is tolerated: a fraction of its commanded motion, and 1 mm at the tool."""
        at_tool = self.threshold["error at the tool"]
        smallest = np.array([at_tool if unit == "m" else at_tool / self.length for unit in self.run.units])
        if self.error is None:
            return smallest
        q = getattr(self.run.reference.motion, "q", None)
        path = self.run.q if q is None else short_way(np.asarray(q) - self.run.q[0], self.run.continuous)
        commanded = np.abs(self.error[0]) + np.ptp(path, axis=0)
        return np.asarray(np.maximum(self.threshold["error"] * commanded, smallest))

    @cached_property
    def off_target(self) -> Array:
        """(k, n) whether the error of a joint is above its tolerance; everywhere where no error is known."""
        return np.ones(self.run.q.shape, bool) if self.error is None else np.abs(self.error) > self.tolerance

    @cached_property
    def reference_speed(self) -> Float64Array:
        """(k, m) speed of the reference, of joints or of the tool; zeros where it rests."""
        motion = self.run.reference.motion
        for name in ("v", "twist"):
            if getattr(motion, name, None) is not None:
                return np.asarray(getattr(motion, name), dtype=np.float64).reshape(len(self.run), -1)
        return np.zeros((len(self.run), 1))

    @cached_property
    def error_rate(self) -> Float64Array | None:
        """(k, n) time derivative of the error, which damping acts on; None where it is not known."""
        v = getattr(self.run.reference.motion, "v", None)
        if v is not None:
            return np.asarray(v - self.run.v, dtype=np.float64)
        return None if np.any(self.reference_speed) else -self.run.v

    @cached_property
    def settled(self) -> Array:
        """(n,) whether a joint has settled: its reference rests, and its error changes by less than a tenth.

        The change is the difference of the means of the last two tenths of the run, relative to the larger of the
        remaining error and the tolerance.
        """
        ends = self._tail(2)
        if self.error is None or ends.start < 0 or np.any(self.reference_speed[ends.start :]):
            return np.zeros(self.n, bool)
        last = self.error[self.end]
        size = np.maximum(np.abs(last.mean(axis=0)), self.tolerance)
        change = np.abs(last.mean(axis=0) - self.error[ends].mean(axis=0))
        return np.asarray((change < 0.1 * size) & (np.ptp(last, axis=0) < 0.2 * size))

    @cached_property
    def steady_error(self) -> Float64Array:
        """(n,) mean error at the end of the run, of joints that have settled; else zero."""
        if self.error is None:
            return np.zeros(self.n)
        return np.where(self.settled, self.error[self.end].mean(axis=0), 0.0)

    @cached_property
    def feedback_terms(self) -> dict[str, Float64Array]:
        """(k, n) by name: the terms of the command that act on an error."""
        others = {*MODEL_TERMS, *LIMIT_TERMS, "blend"}
        return {name: value for name, value in self.run.terms.items() if name not in others}

    @cached_property
    def feedback(self) -> Float64Array:
        """(k, n) their sum."""
        return np.asarray(sum(self.feedback_terms.values(), np.zeros_like(self.run.q)))

    @cached_property
    def cut(self) -> Float64Array:
        """(k, n) what the limits of the controller added to the command."""
        return np.asarray(sum(self.cuts.values(), np.zeros_like(self.run.q)) - self.cuts.get("torque", 0.0))

    @cached_property
    def cuts(self) -> dict[str, Float64Array]:
        """(k, n) by limit, what it took; "torque" of the drives: torques that stay at their largest."""
        run = self.run
        out = {name: run.terms[name] for name in LIMIT_TERMS if name in run.terms}
        if self.of_torque:
            largest = np.abs(run.tau) >= (1.0 - ROUNDING) * np.max(np.abs(run.tau), axis=0)
            at = largest & (np.abs(run.command) > 1.01 * np.abs(run.tau))
            out["torque"] = np.where(at & (at.sum(axis=0) >= PINNED_TICKS), run.tau - run.command, 0.0)
        return out

    @cached_property
    def arm_effort(self) -> Float64Array:
        """(n,) effort limits of the arm, inf where none is known."""
        known = self.run.info.limits.get("effort", {})
        return np.array([known.get(joint, np.inf) for joint in self.run.joint_names], dtype=np.float64)

    @cached_property
    def effort_limit(self) -> Float64Array | None:
        """(n,) effort limits of the arm, else of the controller; None where not all are known."""
        limit = self.arm_effort
        own = np.asarray(self.run.info.parameters.get("limits.tau", np.inf), dtype=np.float64)
        if own.shape in ((), (self.n,)):
            limit = np.where(np.isfinite(limit), limit, own)
        return limit if self.of_torque and np.isfinite(limit).all() else None

    @cached_property
    def scale(self) -> Float64Array:
        """(n,) what torques are compared with: the effort limit of each joint, or else its largest torque."""
        if self.effort_limit is not None:
            return self.effort_limit
        largest = np.max(np.abs(self.run.tau), axis=0)
        return np.asarray(np.maximum(largest, ROUNDING * max(float(largest.max()), 1.0)))

    @cached_property
    def effort(self) -> float:
        """Sum of squares of the feedback, each joint relative to its scale."""
        return self.energy(self.feedback) or 1.0

    def energy(self, torque: Float64Array) -> float:
        """Sum of squares of torques, each joint relative to its scale."""
        return float(np.sum((torque / self.scale) ** 2))

    def fraction_of(self, part: Float64Array) -> float:
        """0 to 1: how much of the feedback a part of it, (k, n), explains."""
        return float(np.clip(1.0 - self.energy(self.feedback - part) / self.effort, 0.0, 1.0))

    @cached_property
    def fit(self) -> Fit | None:
        """Least-squares fit of the torque beyond the model; None without a model, or with an unmeasured contact."""
        contact = any(name.startswith("contact.") for name in self.run.extra) and "F_ext" not in self.run.extra
        if self.model is None or not self.of_torque or contact or len(self.run) < 2:
            return None
        return fit_residual(self.model, self.scale, self.threshold)

    @cached_property
    def external(self) -> Float64Array:
        """(k, n) J^T F_ext of the measured wrench; zeros where none was measured."""
        return external_torque(self.run, self.run.info.tool if self.model is None else self.model.tool)

    @cached_property
    def steps(self) -> Float64Array:
        """(k - 1, n) displacement of each joint in a period, for the work of what acts during it."""
        return np.asarray(short_way(np.diff(self.run.q, axis=0), self.run.continuous))

    def finding(
        self,
        term: str,
        joint: int | None,
        fraction: float,
        evidence: Mapping[str, tuple[float, str]],
        *,
        signals: Mapping[str, Float64Array] | None = None,
        window: slice | None = None,
        of: str = "the feedback effort",
        remedy: str = "",
        note: str = "",
    ) -> Finding:
        """A finding of this run, to which its check adds the name and the sentences.

        Args:
            term: As of `Finding`.
            joint: Index of the joint where it is worst; None where it concerns the whole arm.
            fraction: As of `Finding`.
            evidence: Value and unit by name; "joint" and "torque" stand for the unit of the joint and of its torque.
            signals: (k,) by name with unit: its figure; error, feedback, term and command of the joint if left out.
            window: The ticks that it shows; all if left out.
            of: What `fraction` is a part of.
            remedy: What to do about it, where the sentence of the check does not do.
            note: Added to the remedy.
        """
        run, i, shown = self.run, joint or 0, slice(None) if window is None else window
        units = {"joint": run.units[i], "torque": run.effort_units[i]}
        if signals is None:
            torques = {"feedback": self.feedback, term: run.terms.get(term)} if self.of_torque else {}
            kinds = [({"error": self.error}, run.units), (torques, run.effort_units)]
            kinds += [({"command": run.command}, run.command_units)]
            signals = {
                f"{name} [{unit[i]}]": x[:, i] for kind, unit in kinds for name, x in kind.items() if x is not None
            }
        return Finding(
            term=term,
            joint=None if joint is None else run.joint_names[joint],
            fraction=min(1.0, float(fraction)),
            evidence={name: Number(float(value), units.get(unit, unit)) for name, (value, unit) in evidence.items()},
            t=run.t[shown],
            signals={name: y[shown] for name, y in signals.items()},
            of=of,
            remedy=remedy,
            note=note,
        )

    def at_all_ticks(self, sampled: Float64Array) -> Float64Array:
        """(k, n) of values (ticks, n) at the ticks that the model looks at."""
        assert self.model is not None
        at = self.run.t[self.model.ticks]
        return np.column_stack([np.interp(self.run.t, at, column) for column in sampled.T])

    @cached_property
    def oscillation(self) -> Oscillation | None:
        """The oscillation of the feedback, classified by the work on it; None where there is none."""
        return find_oscillation(self) if self.of_torque else None


NEEDS: Final[Mapping[Need, tuple[str, Callable[[ExaminedRun], bool]]]] = {
    "length": ("the run is too short", lambda run: len(run.run) >= run.threshold["duration"] * run.run.rate),
    "torque": ("the law does not command torques", lambda run: run.of_torque),
    "error": ("the error of the joints is not known", lambda run: run.error is not None),
    "effort": ("the effort limits of the arm are not known", lambda run: run.effort_limit is not None),
    "model": ("the arm (arm= or --arm), or a contact force on it, is not known", lambda run: run.fit is not None),
}
"""What a check may need: why it was left out where a run does not have it, and whether it does."""
