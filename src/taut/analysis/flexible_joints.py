"""Flexible joints and links: Tomei's condition for PD control of the motors, and stable inversion of a loop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.analysis.learning import known_motion, unused_acceleration
from taut.arm.description import Arm
from taut.base.checks import finite_array, finite_scalar, instance_of, read_only
from taut.base.errors import UsageError
from taut.base.result import Content, Result, Table
from taut.base.types import Array, ArrayLike, Float64Array
from taut.codegen.program import over_rows
from taut.control.laws.other_topics.flexible_joint import MotorSidePD
from taut.control.trajectories.samples import Samples
from taut.controller import Controller
from taut.linear.linear_system import LinearSystem
from taut.linear.linearise import linearise
from taut.loop import Loop, ModelPlant
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.maths.snapshot import snapshot
from taut.trace import math as tm

POSES: Final = 4000  # sampled: on six and seven joints the largest slope is then found within 1 %
FULL_TURN: Final = np.pi  # [rad] either way, of a joint without limits
DIED_OUT: Final = 1e-5  # [-] of the largest input of an inverse, at both ends of the window in which it is computed
LONGEST: Final = 2**16  # ticks of that window before and after the motion
STEADY: Final = 1e-6  # [-] of a step: an error that stays
REST_SPEED: Final = 1e-6  # [rad/s | m/s]


@dataclass(frozen=True, kw_only=True, eq=False)
class SetPointCondition(Result):
    """Check of K m kp / (K + m kp) > alpha for each joint, with alpha the largest slope of gravity."""

    joints: tuple[str, ...]
    alpha: float  # [N m/rad] largest |dg/dq| (2-norm) of the sampled poses
    series: Float64Array  # (n,) [N m/rad] stiffness of spring and gain in series

    @property
    def margin(self) -> float:
        """Smallest stiffness over alpha [-]: above 1 the set-point is globally asymptotically stable."""
        return float(self.series.min()) * (1.0 / self.alpha if self.alpha else np.inf)  # no number if both are zero

    @property
    def ok(self) -> bool:
        """The condition holds, as far as alpha is known."""
        return self.margin > 1.0

    def content(self) -> Content:
        """Verdict and stiffness of each joint."""
        i = int(np.argmin(self.series))
        found = (
            f"spring and gain in series give joint '{self.joints[i]}' {self.series[i]:.4g} N m/rad, "
            f"{self.margin:.3g} times alpha = {self.alpha:.4g} N m/rad, the largest slope of gravity"
        )
        weak = f"{found}: the proof does not hold; raise kp, or take a stiffer joint"
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

    Law:          K m kp / (K + m kp) > alpha for each joint, with m = M_ii(q_des), rotors included

    Sufficient for several joints, and less strict than Tomei's own form; for one joint also necessary.

    Args:
        law: The law.
        arm: The arm, with its payload.
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
    law.check_size(arm.joint_names)
    x = snapshot(arm, arm.home if at is None else finite_array("at", at, shape=(arm.n,), joints=arm.joint_names))
    model, payload = model_of(arm), PayloadValues.of(arm.payload)

    def steepness(q: Array) -> dict[str, Array]:
        return {"slope": tm.jacobian(lambda q: dyn.gravity_torque(model, q, payload), q)}

    lower, upper = (np.where(np.isfinite(end), end, np.sign(end) * FULL_TURN) for end in (arm.lower, arm.upper))
    sampled = np.random.default_rng(0).uniform(lower, upper, (POSES, arm.n))
    alpha = float(np.linalg.norm(over_rows(steepness, q=arm.n)(q=sampled)["slope"], 2, axis=(1, 2)).max())
    K, kp = law.stiffness, np.diag(x.M) * law.kp.as_array()
    series = np.broadcast_to(K * kp / (K + kp), (arm.n,))
    return SetPointCondition(joints=arm.joint_names, alpha=alpha, series=read_only(series))


def stable_inversion(ctrl: Controller, plant: ModelPlant, motion: object, *, lead: float) -> Samples:
    """The reference with which a loop follows a motion exactly in spite of unstable zeros, as of a flexible link.

    Law:          a_ref = a_des + u, u = G^-1 e in the frequency domain, with e the error of the loop without u and G
                  its response to u, both of the sampled loop by `taut.linearise` at the start of the motion
    Closed loop:  q = q_des at every tick, for a linear law and plant such as a `taut.drives.FlexibleLink`; elsewhere
                  to first order. The feedback stays that of the law, and so do its margins

    With an unstable zero z the bounded inverse begins before the motion, as exp(z t), and is cut off at `lead`: 5 / z
    leaves 0.7 % of the error of none. A wrong model leaves its error.

    Args:
        ctrl: A controller whose law uses the reference's acceleration: for a flexible link
            `taut.laws.MotorSide(law=taut.laws.ComputedTorque(...))`, whose feedback is that of the hub.
        plant: The model of the plant.
        motion: A trajectory of joints from rest to rest; of a flexible link q is the angle of the tool.
        lead: Time before the motion begins [s], in whole ticks.

    Returns:
        Samples at each tick, of the motion after its lead: positions and velocities are those of the motion.

    Raises:
        UsageError: A loop that is unstable, leaves a steady-state error or does not use the acceleration; a motion
            without an end, or not from rest to rest; an inverse that does not die out.

    References:
        Devasia, Chen and Paden, Nonlinear inversion-based output tracking, IEEE Trans. Automatic Control 41 (1996).
    """
    instance_of("ctrl", ctrl, Controller, "a controller from taut.compile")
    instance_of("plant", plant, ModelPlant, "a model plant, such as a taut.drives.FlexibleLink")
    dt, title, duration = ctrl.dt, ctrl.side.title, getattr(motion, "duration", None)
    ahead = round(finite_scalar("lead", lead, unit="s", minimum=0.0) / dt)
    if duration is None:
        raise UsageError(
            f"motion must end, and have a duration; got {motion!r}; take one from rest to rest, such as "
            "taut.trajectories.Septic",
            name="motion",
        )
    wanted = known_motion(ctrl, motion, math.ceil(float(duration) / dt) + 1)
    speed = float(np.abs(wanted.v[[0, -1]]).max())
    if speed > REST_SPEED:
        raise UsageError(f"motion must begin and end at rest; got {speed:.3g} [rad/s | m/s] there", name="motion")
    lin = linearise(Loop(ctrl, plant, duration=dt), at=wanted.q[0])
    if not lin.stable:
        raise UsageError(
            f"inversion needs a stable loop; {title} is {lin.unstable_because}; change its gains, or feed the motors "
            "back by taut.laws.MotorSide(law=...)",
            name="ctrl",
        )
    droop = np.abs(lin.dc_gain(input="ref.q", output="q") - np.eye(ctrl.arm.n)).max()
    if droop > STEADY:
        raise UsageError(
            f"inversion needs a loop without steady-state error; {title} leaves {droop:.3g} of a step, as gravity "
            "does in a spring; take a law that compensates it",
            name="ctrl",
        )
    tail = max(ahead, len(wanted.q))
    while tail <= LONGEST:
        q, v, a, u = _inverse(lin, title, wanted, tail)
        if np.abs(u[[0, -1]]).max() <= DIED_OUT * np.abs(u).max():
            ticks = slice(tail - ahead, None)
            return Samples(times=dt * np.arange(len(u[ticks])), q=q[ticks], v=v[ticks], a=(a + u)[ticks])
        tail *= 2
    raise UsageError(
        f"the inverse of the loop must die out within {LONGEST} ticks; lead and motion are longer, or a pole or zero "
        "is too near the stability limit: give the plant damping, or fewer modes",
        name="plant",
    )


def _inverse(lin: LinearSystem, title: str, wanted: Any, tail: int) -> list[Float64Array]:
    """q, v, a of a motion and the input u, (k, n) each: an odd number of ticks, rest for `tail` before and after."""
    from scipy.signal import dlsim

    ends = (tail, tail + (len(wanted.q) + 1) % 2), (0, 0)  # odd, for no response reaches half the rate
    q, v, a = np.pad(wanted.q, ends, "edge"), np.pad(wanted.v, ends), np.pad(wanted.a, ends)
    columns, rows = [i for name in "qva" for i in lin.columns(f"ref.{name}")], lin.rows("q")
    reference = np.hstack([q - q[0], v, a])
    _, moved, _ = dlsim((lin.A, lin.B[:, columns], lin.C[rows], lin.D[np.ix_(rows, columns)], lin.dt), reference)
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(q), lin.period)
    G = np.asarray(lin.frequency_response(omega, input="ref.a", output="q"))
    if not G.any():
        raise unused_acceleration(title)
    e = np.fft.rfft(q - q[0] - moved, axis=0)[:, :, np.newaxis]
    return [q, v, a, np.fft.irfft(np.linalg.solve(G, e)[:, :, 0], len(q), axis=0)]
