"""What tuning asks of a run: costs by name, and what is to be kept within, as numbers of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.errors import TautError, UsageError, unknown_name
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.trajectories.reference import JointMotion, Sample
from taut.control.trajectories.task_reference import TaskMotion
from taut.loop import Loop
from taut.maths import dynamics as dyn
from taut.maths.model import model_of
from taut.maths.spatial import rotation_log
from taut.record.run import Run
from taut.trace import math as tm

__all__ = ["COSTS", "Raised", "Tick", "asked", "named_costs", "of_run", "stage_of", "traced"]

COSTS: Final = {
    "tracking": "mean square of the error of joints [rad^2 | m^2], or of the tool's position [m^2]",
    "turning": "mean square of the angle of the tool's rotation error [rad^2]",
    "effort": "mean square of the torques [(N m)^2]",
    "speed": "mean square of the joint speeds [(rad/s)^2]",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Tick:
    """One tick of a loop, as a cost for gradients sees it; numbers or symbols.

    Args:
        t: [s].
        q: (n,) true positions [rad | m].
        v: (n,) true velocities [rad/s | m/s].
        tau: (n,) torques [N m | N].
        command: (n,) what the controller commands.
        ref: The sample that is followed.
        loop: The loop.
    """

    t: Any
    q: Any
    v: Any
    tau: Any
    command: Any
    ref: Any
    loop: Loop

    @property
    def e(self) -> Any:
        """(n,) error of joints, desired minus actual [rad | m]; of a task (3,) that of the tool's position [m]."""
        motion = self.ref.motion
        if isinstance(motion, JointMotion):
            return self.loop.plant.arm.difference(motion.q, self.q)
        return motion.p - self.pose.p

    @property
    def turned(self) -> Any:
        """(3,) rotation vector of the tool's rotation error [rad]."""
        return rotation_log(self.ref.motion.R @ self.pose.R.T)

    @property
    def pose(self) -> Any:
        """T_WE of the frame that the law controls."""
        return dyn.pose(model_of(self.loop.plant.arm), self.q, self.loop.side.law.controlled_frame)


class Raised(Exception):  # noqa: N818  # no error of taut's: what a cost of the user's raised, and where it is judged
    """A cost raised, or gave no number; the text says what.

    Args:
        what: In words: "the cost raised ZeroDivisionError".
        text: What the error said.
    """

    def __init__(self, what: str, text: str) -> None:
        super().__init__(text)
        self.what = what


def asked(cost: Callable[[Any], Any], x: Any) -> float:
    """What a cost says.

    Raises:
        Raised: It raises, or what it gives is no number.
    """
    try:
        value = cost(x)
    except Exception as wrong:
        raise Raised(f"the cost raised {type(wrong).__name__}", str(wrong) or "without a word") from wrong
    try:
        return float(value)
    except (TypeError, ValueError, TautError) as wrong:
        raise Raised("the cost was no number", f"it must be one, and is {type(value).__name__}") from wrong


def named_costs(loop: Loop, cost: str | Mapping[str, float]) -> dict[str, float]:
    """Weights of the costs that are named.

    Raises:
        UnknownNameError: There is none such.
        UsageError: It has no meaning for what the loop follows.
    """
    weights = {cost: 1.0} if isinstance(cost, str) else {name: float(weight) for name, weight in cost.items()}
    for name in weights:
        if name not in COSTS:
            raise unknown_name("taut.tune", "cost", name, COSTS)
    kind: type[Sample] = loop.side.law.reference
    if "turning" in weights and not issubclass(kind, TaskMotion):
        raise UsageError(
            f"cost 'turning' is of the tool's rotation, and this law follows a {kind.__name__}", name="cost"
        )
    if "tracking" in weights and not issubclass(kind, (JointMotion, TaskMotion)):
        raise UsageError(
            f"cost 'tracking' is of a motion, and this law follows a {kind.described()}; give a function", name="cost"
        )
    return weights


def of_run(run: Run, weights: Mapping[str, float]) -> float:
    """The named costs of a run, each as a mean over its ticks."""
    total = 0.0
    for name, weight in weights.items():
        if name == "tracking":
            rows = run.error if run.error is not None else run.task.position_error
        elif name == "turning":
            rows = run.task.rotation_error
        else:
            rows = run.tau if name == "effort" else run.v
        assert rows is not None
        total += weight * float(np.mean(np.sum(np.asarray(rows) ** 2, axis=1)))
    return total


def stage_of(loop: Loop, cost: Callable[[Tick], Any] | Mapping[str, float]) -> Callable[[Any, Any], Any]:
    """(inputs, what a tick records) -> its share of the cost, for tracing."""

    def stage(inputs: Any, record: Any) -> Any:
        tick = Tick(
            t=inputs["t"],
            q=record["q"],
            v=record["v"],
            tau=record["tau"],
            command=record["command"],
            ref=loop.side.law.reference.of(subtree(inputs, "ref")),
            loop=loop,
        )
        if not isinstance(cost, Mapping):
            return cost(tick)
        total: Any = 0.0
        for name, weight in cost.items():
            rows = {
                "tracking": lambda: tick.e,
                "turning": lambda: tick.turned,
                "effort": lambda: tick.tau,
                "speed": lambda: tick.v,
            }[name]()
            total = total + weight * (tm.array(list(rows)) @ tm.array(list(rows)))
        return total

    return stage


def traced(cost: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A cost of a tick that says so where it goes with numbers and not with symbols.

    Raises:
        UsageError: It raises what is no error of taut's.
    """

    def checked(tick: Any) -> Any:
        try:
            return cost(tick)
        except TautError:
            raise
        except Exception as wrong:
            raise UsageError(
                f"method='gradient' traces the cost, and it raised {type(wrong).__name__}: {wrong}; write it with "
                "taut.math, or take method='search'",
                name="cost",
            ) from wrong

    return checked


def largest(rows: Float64Array, limits: Float64Array) -> float:
    """The largest share of a limit in rows (k, n)."""
    share = np.abs(rows) / limits
    return float(share.max(initial=0.0))
