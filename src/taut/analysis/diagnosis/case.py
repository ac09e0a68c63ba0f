"""What all tests of a diagnosis look at: a run's errors and what counts as one, its feedback, its model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from taut.analysis.diagnosis.fit import Fit, fit_of
from taut.analysis.diagnosis.hybrid import along_error
from taut.analysis.diagnosis.model import ArmModel
from taut.arm.angles import short_way
from taut.base.types import Float64Array
from taut.control.limiting import LIMIT_TERMS
from taut.control.trajectories.hybrid_motion import HybridMotion
from taut.control.trajectories.task_force import TaskForce
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.chain import Chain
from taut.record.info import PARTS, TOOL
from taut.record.run import Run
from taut.record.tool import expected_deviation, force_error

__all__ = ["MODEL_TERMS", "Case", "tail"]

MODEL_TERMS: Final = frozenset(
    {"gravity", "nonlinear", "feedforward", "friction", "inertia", "curvature", "chain", "force_nonlinear", "force"}
) | {"wrench", "sensor", "lead", "dither"}
"""Terms that a law takes from its model, its reference, a measured wrench or a clock; what is left is feedback."""
BAND: Final = 0.02  # of the motion asked for: the chapter's 2 %
FAR: Final = 0.2  # of the longest motion asked for: more than the slow end of an integral leaves
WAY: Final = 1e-3  # [m] at the tool, below which an error is none
TAIL: Final = 0.1  # of the run: what is called its end
PINNED: Final = 1e-9  # of its largest: torques that are as large
STAYS: Final = 3  # ticks at the largest torque: fewer may be a peak
EFFORT_SHARE: Final = 1e-9  # of the largest torque: below it a joint has done nothing


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A run without gaps, and the model that its controller believed in, where it is known."""

    run: Run
    model: ArmModel | None

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.run.n

    @cached_property
    def dt(self) -> float:
        """The nominal period [s]."""
        return 1.0 / self.run.rate

    @property
    def of_torque(self) -> bool:
        """Whether the law commands torques."""
        return self.run.kind == "torque"

    # ---------------------------------------------------------------- errors

    @cached_property
    def length(self) -> float:
        """[m] how far the tool is from the first joint at most, were the arm stretched: a joint's error in ways."""
        if TOOL not in self.run.info:
            return 1.0
        chain = Chain.of_json(self.run.info[TOOL])
        parts = [link.p for link in chain.links[1:]]
        return float(sum(np.linalg.norm(p) for p in [*parts, chain.p])) or 1.0

    @cached_property
    def of_task(self) -> bool:
        """Whether the reference is a motion of the tool."""
        return isinstance(self.run.reference.motion, TaskMotion) and TOOL in self.run.info

    @cached_property
    def of_hybrid(self) -> bool:
        """Whether the law keeps to a constraint, against which a motion is none of its errors."""
        return isinstance(self.run.reference, HybridMotion)

    @cached_property
    def error(self) -> Float64Array | None:
        """(k, n) error of the joints [rad | m]; of a task the joint motion that would take it away, J^+ X_e.

        Of a law that promises an impedance, against where the wrench that was measured should have taken the tool; of
        a hybrid law, what it has along its constraint; of laws side by side, each of its own. None where it is not
        known what a law was asked for.
        """
        if PARTS in self.run.info:
            return self._of_parts("error")
        if self.of_hybrid:
            return None if self.model is None else along_error(self.run, self.model.mass_matrices)
        if self.run.error is not None:
            return self.run.error
        if not self.of_task:
            return None
        task = self.run.task
        assert task.position_error is not None
        assert task.rotation_error is not None
        X = np.concatenate([task.position_error, task.rotation_error], axis=1)
        promised = expected_deviation(self.run)
        if promised is not None:
            X = X + promised
        inverse = np.linalg.pinv(task.J, rcond=1e-2)
        return np.asarray(np.einsum("kij,kj->ki", inverse, X))

    def _of_parts(self, name: str) -> Float64Array | None:
        """(k, n) the errors, or (n,) the tolerances, of laws side by side, in the columns of their joints."""
        out = np.zeros_like(self.run.q)
        for part in self.run.info[PARTS]:
            own = self.run.part(part)
            values = getattr(Case(run=own, model=None), name)
            if values is None:
                return None
            out[:, [self.run.joint_names.index(joint) for joint in own.joint_names]] = values
        return out if name == "error" else out[0]

    @cached_property
    def tolerance(self) -> Float64Array:
        """(n,) what counts as an error of a joint: 2 % of what it was asked to move, at least 1 mm at the tool."""
        if PARTS in self.run.info:
            of_parts = self._of_parts("tolerance")
            assert of_parts is not None
            return of_parts
        least = np.array([WAY if unit == "m" else WAY / self.length for unit in self.run.units])
        if self.error is None:
            return least
        return np.asarray(np.maximum(BAND * self.asked, least))

    @cached_property
    def asked(self) -> Float64Array:
        """(n,) how far each joint is asked to go: its error at the start, and what its reference covers."""
        assert self.error is not None
        wanted = getattr(self.run.reference.motion, "q", None)
        covered = self.run.q if wanted is None else short_way(np.asarray(wanted) - self.run.q[0], self.run.continuous)
        return np.asarray(np.abs(self.error[0]) + np.ptp(covered, axis=0))

    @cached_property
    def off(self) -> Float64Array:
        """(k, n) 1.0 where the error of a joint counts; where no motion is asked for, everywhere."""
        if self.error is None:
            return np.ones_like(self.run.q)
        return np.asarray(np.abs(self.error) > self.tolerance, dtype=np.float64)

    @cached_property
    def moving_reference(self) -> Float64Array:
        """(k, m) the speed that the reference asks for, of whatever it is about; zeros where it rests."""
        if PARTS in self.run.info:
            parts = [Case(run=self.run.part(part), model=None).moving_reference for part in self.run.info[PARTS]]
            return np.concatenate(parts, axis=1)
        for name in ("v", "twist"):
            value = getattr(self.run.reference.motion, name, None)
            if value is not None:
                return np.asarray(value, dtype=np.float64).reshape(len(self.run), -1)
        return np.zeros((len(self.run), 1))

    @cached_property
    def error_rate(self) -> Float64Array | None:
        """(k, n) how fast the error of each joint changes, which damping answers; None where that is not known."""
        if PARTS in self.run.info:
            return None
        wanted = getattr(self.run.reference.motion, "v", None)
        if wanted is not None:
            return np.asarray(wanted - self.run.v, dtype=np.float64)
        return None if np.any(self.moving_reference) else -self.run.v

    @cached_property
    def force_error(self) -> Float64Array | None:
        """(k, 6) error of the force that the arm applies, where one is asked for."""
        return force_error(self.run)

    @property
    def of_force(self) -> bool:
        """Whether the reference is a force and no motion."""
        return isinstance(self.run.reference, TaskForce)

    @cached_property
    def in_contact(self) -> bool:
        """Whether something that no column tells of may have pushed the arm."""
        told = "F_ext" in self.run.extra
        return any(name.startswith("contact.") for name in self.run.extra) and not told

    # ---------------------------------------------------------------- torques

    @cached_property
    def feedback_terms(self) -> dict[str, Float64Array]:
        """(k, n) by name, the terms that answer an error, and those of limits left out."""
        known = {*MODEL_TERMS, *LIMIT_TERMS, "blend"}
        return {name: value for name, value in self.run.terms.items() if name not in known}

    @cached_property
    def feedback(self) -> Float64Array:
        """(k, n) their sum."""
        return np.asarray(sum(self.feedback_terms.values(), np.zeros_like(self.run.q)))

    @cached_property
    def feedback_of_motion(self) -> Float64Array:
        """(k, n) the feedback without what presses against the constraint of a hybrid law."""
        pressed = [v for name, v in self.feedback_terms.items() if name.startswith("force_") or name == "one_sided"]
        return np.asarray(self.feedback - sum(pressed, np.zeros_like(self.run.q)))

    @cached_property
    def cut(self) -> Float64Array:
        """(k, n) what limits added to the command."""
        cuts = [self.run.terms[name] for name in LIMIT_TERMS if name in self.run.terms]
        return np.asarray(sum(cuts, np.zeros_like(self.run.q)))

    @cached_property
    def given(self) -> Float64Array:
        """(k, n) the feedback that limits left: what they took of the rest of the command is none of it."""
        against = np.clip(-self.cut * np.sign(self.feedback), 0.0, np.abs(self.feedback))
        return np.asarray(self.feedback - np.sign(self.feedback) * against)

    @cached_property
    def pinned(self) -> Float64Array:
        """(k, n) what the drives did not give at their own limit: torques that stay at their largest."""
        if not self.of_torque:
            return np.zeros_like(self.run.q)
        tau, command = self.run.tau, self.run.command
        at = (np.abs(tau) >= (1.0 - PINNED) * np.max(np.abs(tau), axis=0)) & (np.abs(command) > 1.01 * np.abs(tau))
        return np.where(at & (at.sum(axis=0) >= STAYS), tau - command, 0.0)

    @cached_property
    def arm_effort(self) -> Float64Array:
        """(n,) the arm's own effort limits, inf where none is known."""
        known = self.run.info.get("limits", {}).get("effort", {})
        return np.array([known.get(joint, np.inf) for joint in self.run.joint_names], dtype=np.float64)

    @cached_property
    def limits_of_effort(self) -> Float64Array | None:
        """(n,) the effort limit of each joint, the arm's, else the controller's; None where not all are known."""
        given = np.where(np.isfinite(self.arm_effort), self.arm_effort, np.nan)
        stated = np.asarray(self.run.info.get("parameters", {}).get("limits.tau", np.nan), dtype=np.float64)
        if stated.shape in ((), (self.n,)):
            given = np.where(np.isnan(given), stated, given)
        return given if self.of_torque and np.isfinite(given).all() else None

    @cached_property
    def size(self) -> Float64Array:
        """(n,) the effort limit of each joint, or else its largest torque: what its torques are weighed with."""
        if self.limits_of_effort is not None:
            return self.limits_of_effort
        most = np.max(np.abs(self.run.tau), axis=0)
        return np.asarray(np.maximum(most, EFFORT_SHARE * max(float(most.max()), 1.0)))

    @cached_property
    def fit(self) -> Fit | None:
        """What explains the torques beyond the model; None without one, or where they are not those of the arm."""
        if self.model is None or not self.of_torque or self.in_contact:
            return None
        return fit_of(self.model, self.size)

    @cached_property
    def pushed(self) -> Float64Array:
        """(k, n) J^T F_ext, what the measured wrench asks of the joints; zeros where none was measured."""
        if "F_ext" not in self.run.extra or self.tool is None:
            return np.zeros_like(self.run.q)
        return np.asarray(np.einsum("kij,ki->kj", self.tool.jacobians(self.run.q), self.run.extra["F_ext"]))

    @cached_property
    def tool(self) -> Chain | None:
        """The arm's tool, at which F_ext is measured: the model's, else the frame that the law controls."""
        if self.model is not None:
            return self.model.tool
        return Chain.of_json(self.run.info[TOOL]) if TOOL in self.run.info else None

    @cached_property
    def effort(self) -> float:
        """Sum of squares of the feedback over the run, each joint weighed by its size."""
        return float(np.sum((self.feedback / self.size) ** 2)) or 1.0

    def share_of(self, part: Float64Array) -> float:
        """How much of the feedback a part of it, (k, n), explains: 1 less what is left, in squares."""
        left = float(np.sum(((self.feedback - part) / self.size) ** 2))
        return float(np.clip(1.0 - left / self.effort, 0.0, 1.0))

    @cached_property
    def steps(self) -> Float64Array:
        """(k - 1, n) how far each joint goes in a period, for the work of what acts during it."""
        return np.asarray(short_way(np.diff(self.run.q, axis=0), self.run.continuous))

    # ---------------------------------------------------------------- the end

    @cached_property
    def asked_to_rest(self) -> bool:
        """Whether the reference rests in the last two tenths of the run."""
        return len(self.run) >= 2.0 / TAIL and not np.any(
            np.abs(self.moving_reference[tail(self.run, 2).start :]) > 0.0
        )

    @cached_property
    def on_its_way(self) -> int | None:
        """The joint that comes to rest later than the run ends: what is left falls by a tenth in a tenth of it."""
        if self.error is None or PARTS in self.run.info or not self.asked_to_rest:
            return None
        size = np.abs(self.error)
        before, now = size[tail(self.run, 2)].mean(axis=0), size[tail(self.run)].mean(axis=0)
        falls = (
            (now > np.maximum(FAR * self.asked, self.tolerance))
            & (now < 0.9 * before)
            & (size[-1] < now)
            & (self.settled == 0.0)
        )
        return int(np.argmax(np.where(falls, now / self.tolerance, 0.0))) if falls.any() else None

    @cached_property
    def settled(self) -> Float64Array:
        """(n,) 1.0 where a joint has come to rest: its reference rests, and its error changes by less than a tenth.

        A change is the difference of the means of the last two tenths of the run; it counts against the error that
        is left or what is tolerated, whichever is larger.
        """
        if self.error is None or not self.asked_to_rest:
            return np.zeros(self.n)
        last, before = tail(self.run), tail(self.run, 2)
        end = self.error[last].mean(axis=0)
        change = np.abs(end - self.error[before].mean(axis=0))
        swing = np.ptp(self.error[last], axis=0)
        calm = np.maximum(np.abs(end), self.tolerance)
        return np.asarray((change < 0.1 * calm) & (swing < 0.2 * calm), dtype=np.float64)

    @cached_property
    def steady_error(self) -> Float64Array:
        """(n,) the mean error of the last tenth of the run, of joints that have come to rest; else zero."""
        if self.error is None:
            return np.zeros(self.n)
        return np.asarray(self.settled * self.error[tail(self.run)].mean(axis=0))


def tail(run: Run, back: int = 1) -> slice:
    """The last tenth of a run, or the tenth so many tenths from its end."""
    size = max(1, round(TAIL * len(run)))
    return slice(len(run) - back * size, len(run) - (back - 1) * size)
