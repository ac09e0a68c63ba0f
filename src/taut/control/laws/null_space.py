"""Laws for the motion that a task leaves free: posture, joint limits, manipulability.

They are laws of joint accelerations, tau = M a, that ask for no reference. Held in the field `null` of a task law
they act through its dynamically consistent projector; alone, or added to others, they act in full.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.arm.parts import require_radians
from taut.base.errors import MatchError, UsageError, count_of
from taut.base.fields import Field
from taut.base.types import Vector
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, Memory, MemoryView
from taut.control.law import Law, call
from taut.control.trajectories.reference import Sample
from taut.maths import dynamics as dyn
from taut.maths.singularity import ResolvedMotion
from taut.maths.snapshot import Snapshot
from taut.maths.task_inertia import TaskInertia
from taut.trace import math as tm


class Posture(Law):
    """Keep a posture: each joint is drawn to its place, as far as a task leaves it free.

    Law:          tau = M(q) (kp (q_rest - q) - kd v)
    Closed loop:  e_ddot + kd e_dot + kp e = 0 where it acts in full; projected, the same of the free motion alone

    Args:
        q: (n,) q_rest [rad | m]; where the arm starts if left out.

    References:
        Khatib (1987), IEEE Journal of Robotics and Automation 3 (1), section VI.
    """

    ignores_reference = True
    kp: Gain = Gain(10.0, unit="1/s^2")
    kd: Gain = Gain(6.0, unit="1/s")
    q: Field = Field(unit="rad | m", shape="n", optional=True, run_time=False)
    rest = Memory(unit="rad | m", doc="the posture that is kept")

    def start(self, x: Snapshot, ref: Sample) -> Mapping[str, Vector]:  # noqa: ARG002
        return {"rest": x.q if self.q is None else self.q * np.ones(x.n)}

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        """A posture that lies far beyond a joint's limits is meant in degrees."""
        if self.q is not None:
            require_radians("q", self.q * np.ones(x.n), x.arm)

    def command(self, x: Snapshot, ref: Sample, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:  # noqa: ARG002
        e = x.difference(memory.rest)
        return Torque(x.M @ Terms(P=self.kp @ e, D=-(self.kd @ x.v))), {"rest": memory.rest}


class LimitAvoidance(Law):
    """Keep away from joint limits: a spring that begins `margin` before each limit, with damping of its own.

    Law:          tau = M(q) (kp d - kd v s),  d how far a joint is into the margin, inwards, s = |d| / margin
    Closed loop:  none in the middle of the range; in the margin a damped spring with omega_n = sqrt(kp)

    Joints without limits are left alone. Held in `null` it gives way to the task, which may still drive a joint into
    its limit. In the middle of the range it damps nothing; add what does, as in LimitAvoidance() + Posture(kp=0.0).

    Args:
        margin: Width of the zone before a limit [rad | m].
    """

    ignores_reference = True
    kp: Gain = Gain(100.0, unit="1/s^2")
    kd: Gain = Gain(20.0, unit="1/s")
    margin: Gain = Gain(0.2, unit="rad | m", accepts=("scalar",), above=0.0)

    def command(self, x: Snapshot, ref: Sample) -> Command:  # noqa: ARG002
        lower, upper = x.arm.lower, x.arm.upper
        margin = self.margin.as_array() * np.ones(x.n)
        low = tm.maximum(np.where(np.isfinite(lower), lower, 0.0) + margin - x.q, 0.0) * np.isfinite(lower)
        high = tm.maximum(x.q - np.where(np.isfinite(upper), upper, 0.0) + margin, 0.0) * np.isfinite(upper)
        share = tm.minimum((low + high) / margin, 1.0)
        return Torque(x.M @ Terms(P=self.kp @ (low - high), D=-(self.kd @ (share * x.v))))


class Manipulability(Law):
    """Drive the free motion to where the tool moves well: up the gradient of the manipulability measure.

    Law:          tau = M(q) (gain d/dq log sqrt(det(J J^T)) - kd v)
    Closed loop:  the measure grows along the free motion, which comes to rest where it cannot grow more

    The gradient is exact, by differentiation, and goes to infinity at a singularity: `most` bounds each of its
    entries smoothly.

    Args:
        tool: The frame whose motion it is about; the arm's tool if left out.

    References:
        Yoshikawa (1985), International Journal of Robotics Research 4 (2).
    """

    ignores_reference = True
    gain: Gain = Gain(5.0, unit="1/s^2")
    kd: Gain = Gain(6.0, unit="1/s")
    most: Gain = Gain(5.0, unit="1/rad | 1/m", accepts=("scalar",), above=0.0)
    tool: str | None = None

    def command(self, x: Snapshot, ref: Sample) -> Command:  # noqa: ARG002
        def measure(q: Vector) -> Any:
            J = dyn.jacobian(x.model, q, self.tool)
            d = tm.factor_spd(J @ J.T + 1e-12 * tm.eye(6)).d
            total: Any = 0.0
            for pivot in d:
                total = total + tm.log(tm.maximum(pivot, 1e-300))
            return 0.5 * total

        if x.n < 6:
            raise UsageError(
                f"Manipulability is for arms of 6 joints and more; '{x.arm.name}' has {x.n}, and its measure is zero",
                name="Manipulability",
            )
        slope = tm.jacobian(measure, x.q)
        bounded = slope / tm.sqrt(1.0 + (slope / self.most.as_array()) ** 2)
        return Torque(x.M @ Terms(P=self.gain @ bounded, D=-(self.kd @ x.v)))


def check_null(law: Law) -> None:
    """The field `null` of a law: what moves the free motion follows no reference. Raises TautError."""
    null = vars(law)["null"]
    if null is not None and not null.ignores_reference:
        follows = f"{type(null).__name__} follows a {null.reference.__name__}"
        law.refuse("null", f"must be a law that follows no reference, such as taut.laws.Posture(); {follows}")


def check_free(law: Law, x: Snapshot, dimensions: int) -> None:
    """A given law for the free motion needs one; the default does nothing without. Raises MatchError."""
    null = vars(law)["null"]
    if "null" in law.specified and null is not None and x.n <= dimensions:
        raise MatchError(
            f"null={type(null).__name__}(...) is for motion that the task leaves free, and with "
            f"{count_of(x.n, 'joint')} '{x.arm.name}' has none beside {dimensions} directions; leave null out",
            name="null",
        )


def with_null_space(
    law: Law,
    tau: Terms,
    x: Snapshot,
    ref: Any,
    memory: MemoryView,
    dt: Any,
    inertia: TaskInertia | ResolvedMotion,
    dimensions: int,
    weight: Any = 1.0,
) -> tuple[Terms, dict[str, Any]]:
    """tau plus `weight` times the torque of the law in `null`, projected by `inertia`, and that law's new memory."""
    null: Law | None = vars(law)["null"]
    if null is None or x.n <= dimensions:
        return tau, {} if null is None else {"null": memory["null"]}
    own = x.with_own_record()
    command, after = call(null, own, ref, memory["null"], dt)
    if not isinstance(command, Torque):
        raise UsageError(
            f"null must be a law that gives a torque, and {type(null).__name__} gives a {command.kind}", name="null"
        )
    for name in sorted(own.used & {"gravity", "coriolis", "friction"}):
        raise UsageError(
            f"null: {type(null).__name__} compensates {name}, which the law around it adds already; use a law "
            "without, such as taut.laws.Posture()",
            name="null",
        )
    x.used.update(own.used)
    return tau + Terms(null=weight * inertia.project(command.total)), {"null": after}
