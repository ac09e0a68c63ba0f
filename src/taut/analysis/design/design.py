"""taut.design: from a specification to the gains of a law, what of it is met, and the limits."""

from __future__ import annotations

import math
from typing import Any, Final, Literal

import numpy as np

from taut import laws
from taut.analysis.design.asked import Asked
from taut.analysis.design.gains import PLACEHOLDER, RECIPES, Case, gains_for
from taut.analysis.design.make import Maker
from taut.analysis.design.place import poses_of
from taut.analysis.design.result import Achieved, AtPose, Design, Requirement
from taut.arm.description import Arm
from taut.base.checks import finite_array, finite_scalar, one_of, rate_in_hertz, require_at_least, require_positive
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.control.law import Law
from taut.linear.sampled import VelocityKind
from taut.maths.snapshot import Snapshot, snapshot
from taut.plant.rigid import RigidPlant

__all__ = ["Achieved", "AtPose", "Design", "Requirement", "design"]


def design(
    law: type[Law] | Law,
    arm: Arm,
    *,
    at: ArrayLike | None = None,
    zeta: float | None = None,
    omega_n: ArrayLike | None = None,
    settling: ArrayLike | None = None,
    overshoot: float | None = None,
    bandwidth: ArrayLike | None = None,
    K: ArrayLike | None = None,
    D: ArrayLike | None = None,
    contact: ArrayLike | None = None,
    force: float | None = None,
    integral: float = 0.0,
    coupled: bool = False,
    friction: Literal["arm"] | None = None,
    rate: float = 1000.0,
    delay: float = 0.0,
    velocity: VelocityKind = "measured",
    step: ArrayLike | None = None,
    plant: RigidPlant | None = None,
) -> Design:
    """Gains of a law from a specification, what of it the sampled loop has, and the limits that they run into.

    Law:          of joints in torque units   kp = M_ii omega_n^2, kd = 2 zeta omega_n M_ii - b, rotors included
                  of accelerations            kp = omega_n^2, kd = 2 zeta omega_n
                  of the tool's impedance     K and zeta as they are; K = omega_n^2 Lambda; D = K / omega_n^2
                  of first order              kp = bandwidth, or ln 50 / settling
                  of force                    kfi = (1 + kfp) pole
    Closed loop:  that of the law's own docstring; it is linearised about its equilibrium, with its zero-order hold,
                  delay, filters and the weight that it does not compensate, and simulated, with an arm that moves all
                  the time between ticks (exact hold), or in the steps of `plant`

    Ask for a damping (zeta or overshoot) and a speed (omega_n, settling or bandwidth), or for a stiffness. Critical
    damping is zeta=1. Over several poses gains are those of the worst one: the heaviest for joints in torque units,
    the one with the slowest or least damped mode for the tool.

    Args:
        law: A class of `taut.laws`; or a law whose gains are replaced, and whose other options are kept.
        arm: The arm that the law knows.
        at: (n,) one pose or (k, n) several [rad | m]; home if left out.
        zeta: Damping ratio.
        omega_n: Natural frequency [rad/s]: one number, one per joint, or (linear, angular) at the tool.
        settling: Exact 2 % settling time of a step [s], likewise.
        overshoot: Of a step [%], in place of zeta.
        bandwidth: Where position follows 3 dB less than at rest [rad/s], likewise; of first-order laws their pole.
        K: Stiffness: (linear, angular), (6,) or (6, 6) at the tool [N/m, N m/rad]; of joints a number or (n,).
        D: Inertia to be felt at the tool, likewise [kg, kg m^2].
        contact: Stiffness of what a law of force presses on, likewise [N/m, N m/rad].
        force: Pole of the force of `ForceControl` and `HybridMotionForce` [1/s].
        integral: ki as a share of the largest, (b + kd) kp / M.
        coupled: Whether PID and GravityPID may have matrices for gains, like M, so that all modes are alike.
        friction: "arm" where the arm's viscous friction is to count as damping; None for none.
        rate: [Hz].
        delay: [s] from the tick to the torque: whole periods.
        velocity: "measured", "difference", `taut.sensors.LowPass(...)`, `taut.sensors.Difference(cutoff=...)`.
        step: Step that is to keep within the torque limits: [rad | m], or (m, rad) at the tool. Left out, limits are
            told for 0.1 rad and 0.05 m.
        plant: A plant of your own, with whatever is wrong with it, on which steps are tried too. Its integrator moves
            the arm in all that is predicted, simulated and refused; "rk4" is the exact hold.

    Raises:
        UsageError: A specification that says too little, too much or what the law has not; a law without gains.
        RangeError: What contradicts itself, or whose sampled loop is not stable: which limit is in the way.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> d = taut.design(taut.laws.PID, arm, zeta=1.0, omega_n=10.0)
        >>> d.law
        PID(kp=[50.0], kd=[10.0], ki=[0.0])
        >>> round(d.achieved[0].simulated.zeta, 3)  # of the sampled loop
        1.002

    References:
        Chapter, sections 10.2.1.1 to 10.2.1.5, 10.2.2, 10.3 and 10.5. MATHS of sampled loops: Astrom and Wittenmark,
        Computer-controlled systems (1997).
    """
    given = _law_of(law)
    rows = poses_of(arm, at)
    asked = Asked(
        zeta=zeta, omega_n=omega_n, settling=settling, overshoot=overshoot, bandwidth=bandwidth, K=K, D=D,
        contact=contact, force=force, integral=integral,
    )  # fmt: skip
    rate = rate_in_hertz(rate)
    if friction is not None:
        one_of("friction", friction, ("arm",))
    b = np.array(arm.viscous) if friction == "arm" else np.zeros(arm.n)
    at_rest = tuple(snapshot(arm, q) for q in rows)
    _require_strength(arm, at_rest)
    case = Case(law=given, arm=arm, at=at_rest, asked=asked, b=b, coupled=coupled, rate=rate)
    steps = None if step is None else _checked_step(step)
    late = finite_scalar("delay", delay, unit="s")
    require_at_least("delay", np.array(late), 0.0, unit="s")
    _require_whole(late, rate)
    if plant is not None and not isinstance(plant, RigidPlant):  # callers without a type checker
        raise UsageError(f"plant must be a taut.RigidPlant; got {type(plant).__name__}", name="plant")
    maker = Maker(case, gains_for(case), rate=rate, delay=late, velocity=velocity, friction=friction, plant=plant)
    return maker.design(steps)


def _require_whole(delay: float, rate: float) -> None:
    """A delay of whole control periods."""
    periods = delay * rate
    if abs(periods - round(periods)) > WHOLE:
        low = math.floor(periods) / rate
        raise RangeError(
            f"delay must be a whole number of control periods of {1.0 / rate:g} s; got {delay:g} s; give {low:g} or "
            f"{low + 1.0 / rate:g}",
            name="delay",
            value=delay,
            rule="whole periods",
        )


def _law_of(law: type[Law] | Law) -> Law:
    """A law with any gains, of a class or as it is given.

    Raises:
        UsageError: Neither, or a class that is nothing without what it holds.
    """
    if isinstance(law, Law):
        return law
    if not isinstance(law, type) or not issubclass(law, Law):
        raise UsageError(f"design takes a law of taut.laws, or its class; got {law!r}", name="law")
    kind: Any = law
    if law in (laws.HybridMotionForce, laws.ViaJointSpace, laws.Sum):
        way_out = {
            laws.HybridMotionForce: "taut.laws.HybridMotionForce(constraint=..., motion=taut.laws.TaskComputedTorque("
            "kp=1.0, kd=1.0))",
            laws.ViaJointSpace: "taut.via_joint_space(taut.laws.ComputedTorque(kp=1.0, kd=1.0))",
        }.get(law, "taut.laws.FeedForward() + taut.laws.PID(kp=1.0)")
        raise UsageError(
            f"{law.__name__} is nothing without what it holds: give a law, whose gains are replaced: {way_out}",
            name="law",
        )
    if law in ANY:
        made: Law = kind(**ANY[law])
        return made
    if law in RECIPES:
        return kind(kp=1.0)  # type: ignore[no-any-return]
    try:
        return kind()  # type: ignore[no-any-return]  # what has no gains is refused in words later
    except (TypeError, ValueError):
        raise UsageError(
            f"{law.__name__} has no error dynamics that taut.design knows; find its gains with taut.tune", name="law"
        ) from None


WHOLE: Final = 1e-6  # of a period: as near is a whole one
PAIR: Final = (1.0, 1.0)
ANY: Final[dict[type[Law], dict[str, Any]]] = {
    laws.GravityPID: {"kp": 1.0, "kd": 1.0},
    laws.ComputedTorque: {"kp": 1.0, "kd": 1.0},
    laws.TaskComputedTorque: {"kp": 1.0, "kd": 1.0},
    laws.GravityCompensation: {},
    laws.Impedance: {"K": PAIR, "zeta": 1.0},
    laws.Stiffness: {"K": PAIR},
    laws.Admittance: {"D": PAIR, "B": PAIR, "inner": PLACEHOLDER},
    laws.ForceControl: {},
}


def _checked_step(step: ArrayLike) -> Float64Array:
    given = finite_array("step", step, unit="rad | m")
    require_positive("step", given, unit="rad | m")
    if given.shape not in ((), (2,)):
        raise ShapeError(f"step must be a number or (m, rad) at the tool; got shape {given.shape}", name="step")
    return given


def _require_strength(arm: Arm, at: tuple[Snapshot, ...]) -> None:
    """An arm that cannot hold itself at a pose needs no gains there."""
    for x in at:
        g = np.abs(np.asarray(x.g))
        over = np.flatnonzero(g > arm.effort)
        if over.size:
            i = int(np.argmax(g / arm.effort))
            raise RangeError(
                f"'{arm.name}' cannot hold itself at q = {np.round(x.q, 4).tolist()}: its weight takes {g[i]:.4g} at "
                f"joint '{arm.joint_names[i]}', which has {arm.effort[i]:g}; choose another pose, or less payload",
                name="at",
                joint=arm.joint_names[i],
                value=float(g[i]),
                rule=f"<= {arm.effort[i]:g}",
            )
