"""Condition under which PD control of the motors holds flexible joints at every set-point: Tomei's proof."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, instance_of, read_only
from taut.base.result import Content, Result, Table
from taut.base.types import Array, ArrayLike, Float64Array
from taut.codegen.program import over_rows
from taut.control.laws.other_topics.flexible_joint import MotorSidePD
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.maths.snapshot import snapshot
from taut.trace import math as tm

POSES: Final = 4000  # sampled: on six and seven joints the largest slope is then found within 1 %
FULL_TURN: Final = np.pi  # [rad] either way, of a joint without limits


@dataclass(frozen=True, kw_only=True, eq=False)
class SetPointCondition(Result):
    """Check of K m kp / (K + m kp) > alpha for each joint, with alpha the largest slope of gravity."""

    joints: tuple[str, ...]
    alpha: float  # [N m/rad] largest |dg/dq| (2-norm) of the sampled poses
    series: Float64Array  # (n,) [N m/rad] stiffness of spring and gain in series

    @property
    def margin(self) -> float:
        """Smallest stiffness over alpha [-]: above 1 the set-point is globally asymptotically stable."""
        return float(self.series.min() / self.alpha) if self.alpha else np.inf

    @property
    def ok(self) -> bool:
        """The condition holds, as far as alpha is known."""
        return self.margin > 1.0

    def content(self) -> Content:
        """Verdict and stiffness of each joint."""
        i = int(np.argmin(self.series))
        found = (
            f"the stiffness of spring and gain in series is {self.margin:.3g} times alpha = {self.alpha:.4g} N m/rad"
        )
        weak = (
            f"spring and gain in series give joint '{self.joints[i]}' {self.series[i]:.4g} N m/rad, and gravity's "
            f"slope alpha is up to {self.alpha:.4g}: the proof does not hold; raise kp, or take a stiffer joint"
        )
        rows = list(zip(self.joints, self.series.tolist(), strict=True))
        return Content(
            title="set-points of motor-side PD",
            summary=[found] if self.ok else [],
            faults=[] if self.ok else [weak],
            tables=[Table(columns=("joint", "in series [N m/rad]"), rows=rows)],
            notes=[f"alpha is the largest of {POSES} sampled poses, so ask for a margin"],
        )


def set_point_condition(law: MotorSidePD, arm: Arm, *, at: ArrayLike | None = None) -> SetPointCondition:
    """Condition for global asymptotic stability of a set-point under `taut.laws.MotorSidePD`, with its margin.

    Law:          [[K - alpha, -K], [-K, K + m kp]] > 0, which is K m kp / (K + m kp) > alpha for each joint:
                  K > alpha and m kp > alpha K / (K - alpha), with m = M_ii(q_des), rotors included

    Sufficient for several joints; for one joint also necessary at its steepest pose. Tomei's own form, the smallest
    eigenvalue of the matrix without alpha above alpha, is up to twice as strict.

    Args:
        law: The law, with its gains.
        arm: The arm, with its payload; dg/dq is sampled within its joint limits.
        at: Set-point, for m [rad | m]; home if left out.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2").with_joints(rotor_inertia=[0.3, 0.1])
        >>> law = taut.laws.MotorSidePD(stiffness=[1000.0, 400.0], kp=100.0, kd=20.0)
        >>> found = taut.analysis.set_point_condition(law, arm)
        >>> found.ok, round(found.alpha, 1), round(found.margin, 2)
        (False, 24.3, 0.81)

    References:
        Tomei, A simple PD controller for robots with elastic joints, IEEE Trans. Automatic Control 36 (10), 1991.
    """
    instance_of("law", law, MotorSidePD, "a taut.laws.MotorSidePD")
    x = snapshot(arm, arm.home if at is None else finite_array("at", at, shape=(arm.n,), joints=arm.joint_names))
    model, payload = model_of(arm), PayloadValues.of(arm.payload)

    def steepness(q: Array) -> dict[str, Array]:
        return {"slope": tm.jacobian(lambda q: dyn.gravity_torque(model, q, payload), q)}

    lower, upper = (np.where(np.isfinite(end), end, np.sign(end) * FULL_TURN) for end in (arm.lower, arm.upper))
    sampled = np.random.default_rng(0).uniform(lower, upper, (POSES, arm.n))
    alpha = float(np.linalg.norm(over_rows(steepness, q=arm.n)(q=sampled)["slope"], 2, axis=(1, 2)).max())
    K, kp = law.stiffness.as_array(), np.diag(x.M) * law.kp.as_array()
    series = np.broadcast_to(K * kp / (K + kp), (arm.n,))
    return SetPointCondition(joints=arm.joint_names, alpha=alpha, series=read_only(series))
