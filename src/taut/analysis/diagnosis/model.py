"""The model that a controller believed in, and what a run's torques say of it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import MatchError, UsageError
from taut.base.types import Float64Array
from taut.codegen.function import native
from taut.maths import dynamics as dyn
from taut.maths.chain import Chain
from taut.maths.model import PayloadValues, model_of
from taut.record.info import DYNAMICS, TOOL, arm_from_json, arm_json, differences
from taut.record.metrics import MOVING
from taut.record.run import Run

__all__ = ["ENOUGH", "ArmModel", "model_of_run"]

SAME: Final = 1e-9  # of kinematics: what counts as the same arm
MOST_TICKS: Final = 600  # that a fit looks at, evenly spread
PAYLOAD: Final = {"mass": slice(0, 1), "com": slice(1, 4), "inertia": slice(4, 10)}  # columns
ENOUGH: Final = 0.05  # of the ticks: fewer in motion say nothing of friction
LEAST_MOTION: Final = 32  # ticks in motion that say something of friction, however few they are


def model_of_run(run: Run, arm: Arm | None) -> tuple[ArmModel | None, str]:
    """The model that the run's controller had, and in words where it comes from.

    Args:
        run: The run.
        arm: The arm, where the caller knows it.

    Raises:
        UsageError: It is none.
        MatchError: It has other joints than the run.
    """
    if arm is not None:
        if not isinstance(arm, Arm):  # callers without a type checker
            raise UsageError(f"doctor takes arm= from taut.load_arm; got {type(arm).__name__}", name="arm")
        if arm.joint_names != run.joint_names:
            raise MatchError(
                f"the run is of joints {', '.join(run.joint_names)}, and arm '{arm.name}' has "
                f"{', '.join(arm.joint_names)}; give the arm that the controller was compiled for",
                name="arm",
            )
        of_log = _of_log(run)
        apart = () if of_log is None else differences(arm_json(of_log), arm_json(arm))
        other = (
            f"; the controller's in the log has another {', '.join(apart)}, and is used without it" if apart else ""
        )
        return ArmModel(run=run, arm=arm), f"the arm that was given{other}"
    name = run.info.get("arm")
    of_controller = f"arm '{name}' of the controller, with the masses, gravity and gears that the log has"
    for known, words in ((_of_log(run), of_controller), (run.arm, "the arm of the plant")):
        if known is not None and _same_kinematics(run, known):
            return ArmModel(run=run, arm=known), words
    return None, "none, so that gravity and payload were not looked at; give the controller's arm, arm= or --arm"


def _of_log(run: Run) -> Arm | None:
    """The controller's arm, as the run keeps it: the same for a run in memory and for its log."""
    known = run.info.get(DYNAMICS, {})
    return arm_from_json(known["controller"]) if isinstance(known, Mapping) and "controller" in known else None


def _same_kinematics(run: Run, arm: Arm) -> bool:
    """Whether an arm has the run's joints, and puts the tool where the run's chain does."""
    if arm.joint_names != run.joint_names:
        return False
    if TOOL not in run.info:
        return True
    there = Chain.of_json(run.info[TOOL])
    if there.frame not in arm.frame_names:
        return False
    R, p = there.poses(run.q[:1])
    R_here, p_here = Chain.of(model_of(arm), there.frame).poses(run.q[:1])
    return bool(np.abs(R - R_here).max() < SAME and np.abs(p - p_here).max() < SAME)


@functools.lru_cache(maxsize=16)
def _native_torques(arm: Arm) -> Callable[..., Float64Array]:
    """(n,) M a + C v + g of an arm with a payload, in native code."""
    model, n = model_of(arm), arm.n

    def torques(q: Any, v: Any, a: Any, mass: Any, com: Any, inertia: Any) -> Any:
        return dyn.inverse_dynamics(model, q, v, a, PayloadValues(mass=mass, com=com, inertia=inertia))

    return native(torques, q=n, v=n, a=n, mass=(), com=3, inertia=6)


@functools.lru_cache(maxsize=16)
def _native_mass(arm: Arm) -> Callable[..., Float64Array]:
    """(n, n) M of an arm with a payload, in native code."""
    model = model_of(arm)

    def mass_matrix(q: Any, mass: Any, com: Any, inertia: Any) -> Any:
        return dyn.mass_matrix(model, q, PayloadValues(mass=mass, com=com, inertia=inertia))

    return native(mass_matrix, q=arm.n, mass=(), com=3, inertia=6)


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmModel:
    """The arm that the controller believed in, with the payload that it was told, along a run."""

    run: Run
    arm: Arm

    @cached_property
    def payloads(self) -> Float64Array:
        """(k, 10) mass [kg], centre [m] and inertia [kg m^2] that the law was told, at every tick.

        The log has what it was told at the start, and when that was changed.
        """
        out = np.zeros((len(self.run), 10))
        sets: list[tuple[float, Mapping[str, Any]]] = [(-np.inf, self.run.info.get("parameters", {}))]
        sets += [(float(event["t"]), event["set"]) for event in self.run.info.get("events", ())]
        for t, values in sorted(sets, key=lambda pair: pair[0]):
            for name, columns in PAYLOAD.items():
                if f"model.payload.{name}" in values:
                    out[self.run.t >= t - 0.5 / self.run.rate, columns] = values[f"model.payload.{name}"]
        return out

    def payload(self, tick: int = -1) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Mass [kg], centre (3,) [m] and inertia (6,) [kg m^2] that the law was told."""
        row = self.payloads[tick]
        return np.array(row[0]), row[1:4].copy(), row[4:].copy()

    @cached_property
    def ticks(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        """The ticks that fits look at: all but the last, or some of them evenly spread.

        Where a run has little motion, all of that, for nothing else tells of friction.
        """
        count = len(self.run) - 1
        spread = np.linspace(0, count - 1, min(count, MOST_TICKS)).round().astype(np.intp)
        moving = np.flatnonzero((np.abs(self.run.v[:count]) > MOVING).any(axis=1))
        if LEAST_MOTION <= len(moving) < ENOUGH * count:
            few = np.linspace(0, len(moving) - 1, min(len(moving), MOST_TICKS)).round().astype(np.intp)
            spread = np.concatenate([spread, moving[few]])
        return np.unique(spread)

    def _each(self, payload: Float64Array, *, moving: bool) -> Float64Array:
        """(ticks, n) torques with a payload (10,), or (ticks, 10) one at each tick."""
        torques = _native_torques(self.arm)
        v, a = self.run.v[self.ticks], self.acceleration
        if not moving:
            v, a = np.zeros_like(v), np.zeros_like(a)
        columns = np.broadcast_to(payload, (len(v), 10))
        rows = zip(*(np.ascontiguousarray(x) for x in (self.run.q[self.ticks], v, a, columns)), strict=True)
        return np.array([torques(q, v, a, np.array(p[0]), p[1:4], p[4:]) for q, v, a, p in rows])

    @cached_property
    def acceleration(self) -> Float64Array:
        """(ticks, n) mean acceleration of the period behind each tick."""
        k = self.ticks
        period = (self.run.t[k + 1] - self.run.t[k])[:, np.newaxis]
        return np.asarray((self.run.v[k + 1] - self.run.v[k]) / period)

    @cached_property
    def gravity(self) -> Float64Array:
        """(ticks, n) g with the declared payload."""
        return self._each(self.payloads[self.ticks], moving=False)

    @cached_property
    def motion(self) -> Float64Array:
        """(ticks, n) M a + C v + g with the declared payload."""
        return self._each(self.payloads[self.ticks], moving=True)

    @cached_property
    def residual(self) -> Float64Array:
        """(ticks, n) tau + J^T F_ext - (M a + C v + g): what acted beyond what the model needs for the motion."""
        pushed = np.zeros_like(self.motion)
        if "F_ext" in self.run.extra:
            J = self.tool.jacobians(self.run.q[self.ticks])
            pushed = np.einsum("kij,ki->kj", J, self.run.extra["F_ext"][self.ticks])
        return np.asarray(self.run.tau[self.ticks] + pushed - self.motion)

    @cached_property
    def payload_columns(self) -> Float64Array:
        """(ticks, n, 10) torque of a payload by what it is linear in: its mass, moment and inertia at the tool."""
        unit = np.eye(10)
        empty = self._each(np.zeros(10), moving=True)
        at = self._each(unit[0], moving=True) - empty
        turning = [self._each(unit[4 + i], moving=True) - empty for i in range(6)]
        moments = []
        for i in range(3):
            one = self._each(unit[0] + unit[1 + i], moving=True) - empty - at
            moments.append(one - sum(turning[j] for j in range(3) if j != i))
        return np.stack([at, *moments, *turning], axis=2)

    @cached_property
    def length(self) -> float:
        """[m] from the first joint to the tool, were the arm stretched."""
        return float(sum(np.linalg.norm(p) for p in [*(link.p for link in self.tool.links[1:]), self.tool.p]))

    @cached_property
    def tool(self) -> Chain:
        """The arm's tool, at which F_ext is measured."""
        return Chain.of(model_of(self.arm), None)

    @cached_property
    def mass_matrices(self) -> Float64Array:
        """(k, n, n) M with the declared payload, at every tick."""
        return np.array([self.mass_matrix(k) for k in range(len(self.run))])

    def mass_matrix(self, tick: int) -> Float64Array:
        """(n, n) M with the declared payload."""
        return _native_mass(self.arm)(np.ascontiguousarray(self.run.q[tick]), *self.payload(tick))

    def inertia_felt(self, tick: int) -> Float64Array:
        """(n,) what each joint's torque moves with the others free: 1 / (M^-1)_ii [kg m^2 | kg]."""
        return np.asarray(1.0 / np.diag(np.linalg.inv(self.mass_matrix(tick))))
