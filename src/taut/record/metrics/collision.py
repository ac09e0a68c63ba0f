"""Thresholds of collision detection, from what a wrong model alone makes of a motion."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.signal import lfilter

from taut.base.checks import instance_of, read_only
from taut.base.errors import UsageError, quoted_list, warn
from taut.base.types import Array, Float64Array
from taut.codegen.program import over_rows
from taut.control.laws.other_topics.robust import Uncertainty, friction_and_error
from taut.control.observer import MomentumObserver
from taut.maths import dynamics as dyn
from taut.maths.model import body_of, links_of, model_of
from taut.record.run import Run
from taut.trace import math as tm

LOW_THRESHOLD: Final = 1e-3  # of a joint's torque limit: below it are those of rounding and of the integrator
MARGIN_OF_THRESHOLD: Final = 1.5  # [-] of the largest estimate without contact: what other runs of the motion may add
TAU_EXT: Final = "sensed.tau_ext"


def collision_threshold(run: Run, uncertainty: Uncertainty | None = None) -> Float64Array:
    """(n,) thresholds for `taut.guards.collision` of a motion [N m | N]: 1.5 times its largest estimate per joint.

    Law:          1.5 max over t of (|r_i| + sum over l of |h * Y_l pi_l|_i + h * friction error_i + disturbance_i)
                  r the estimate in the run, Y_l pi_l the torque of what is unknown of a body along its motion,
                  h the observer's low-pass: what the same observer makes of it

    Of a run of the same motion, at the same speed and bandwidth, in which nothing touched the arm. Without intervals
    it must be one of the real arm, or of a plant that differs from the model as the arm may: an exact model gives
    thresholds of rounding and of the integrator, which any real arm exceeds; so does a joint in which the plant
    differs little. With intervals a plant that is the model will do, and they hold for every arm in them, as far as
    it moves as in the run and noise, delays and drives are those of the run: 1.5 is for what differs. Dry friction,
    known or not, adds its limit where a joint rests. A run of the real arm counts its own error twice.

    Args:
        run: A run whose sensing has a `taut.sensors.MomentumObserver`.
        uncertainty: Intervals of masses, payload and friction about the controller's arm, as of `taut.laws.Robust`.

    Warns:
        RuntimeWarning: Thresholds below a thousandth of the torque limits (without one: of the largest torque).

    Raises:
        UsageError: A run without an observer, or with contact; with intervals, a run that does not hold its arms.
        RangeError, ShapeError, MatchError: Intervals without width, or for another arm.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> sensing = taut.Sensing(observer=taut.sensors.MomentumObserver(bandwidth=50.0))
        >>> ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm, sensing=sensing)
        >>> plant = taut.RigidPlant(arm.with_payload(0.2, com=[0.0, 0.0, 0.0]))
        >>> motion = taut.trajectories.Sine(center=arm.home, amplitude=0.3, frequency=0.5)
        >>> run = taut.run(ctrl, plant, motion, duration=2.0)
        >>> bool((collision_threshold(run) > 1.0).all())
        True
        >>> exact = taut.run(ctrl, taut.RigidPlant(arm), motion, duration=2.0)
        >>> unknown = taut.laws.Uncertainty(payload=(0.0, 0.2))
        >>> bool((collision_threshold(exact, unknown) > 1.0).all())
        True

    References:
        Haddadin, De Luca and Albu-Schaeffer (2017), section V: thresholds of detection.
    """
    instance_of("run", run, Run, "a taut.Run")
    if TAU_EXT not in run.extra:
        raise UsageError(
            "the run has no estimate of external torques; compile with "
            "sensing=taut.Sensing(observer=taut.sensors.MomentumObserver(bandwidth=...))",
            name="run",
        )
    if run.first_contact is not None:
        raise UsageError(
            f"the run has contact from t = {run.first_contact:.6g} s on, and a threshold is of the motion without; "
            "take a run of it in free space",
            name="run",
        )
    estimate = np.abs(run.extra[TAU_EXT])
    if uncertainty is not None:
        instance_of("uncertainty", uncertainty, Uncertainty, "a taut.laws.Uncertainty")
        estimate = estimate + _largest_error(run, uncertainty)
    threshold = MARGIN_OF_THRESHOLD * estimate.max(axis=0)
    limits, largest = run.info.limits.get("effort", {}), float(np.abs(run.tau).max())
    bounds = [LOW_THRESHOLD * limits.get(joint, largest) for joint in run.joint_names]
    low = [run.joint_names[i] for i in np.flatnonzero(threshold < bounds)]
    if low:
        warn(
            f"thresholds of {quoted_list(low)} are below {LOW_THRESHOLD:g} of the torque limits: the run shows next "
            "to no external torque there, so that any trips them; take a plant that differs from the model in these "
            "joints too, as by friction, noise or a payload off the axis, or set them yourself"
        )
    return read_only(threshold)


def _largest_error(run: Run, uncertainty: Uncertainty) -> Float64Array:
    """(k, n) largest estimate by arms in the intervals, along the motion of a run [N m | N]."""
    (arm, _), T, at = run.arms, 1.0 / run.rate, run.info.parameters
    gain, width = (np.broadcast_to(at[f"sensing.observer.{name}"], run.n) for name in ("bandwidth", "width"))
    model, bare = model_of(arm), links_of(arm)
    uncertainty.check_arm(model)
    known = uncertainty.middle(
        model, [body_of(np.zeros(10))] * run.n
    )  # of its payload, beyond what the observer knows

    def torques(q: Array, v: Array, a: Array) -> dict[str, Array]:
        middle = dyn.newton_euler(bare, known, q, v, a)
        return {"torques": tm.stack([middle, *uncertainty.torques(model, q, v, v, a)])}

    a = np.diff(run.v, axis=0, prepend=run.v[:1]) / T  # mean of the period before
    torque = over_rows(torques, q=run.n, v=run.n, a=run.n)(q=run.q, v=run.v, a=a)["torques"]
    friction, error = friction_and_error(*uncertainty.friction(arm.friction), run.v, run.v, width)
    dry = np.abs(friction + MomentumObserver.friction(arm, run.v, run.tau, {"width": width})) + error
    torque = np.concatenate([torque, dry[:, np.newaxis]], axis=1)
    low = [lfilter([K], [1.0, K - 1.0], torque[..., i], axis=0) for i, K in enumerate(gain * T)]
    return np.asarray(np.abs(np.stack(low, axis=2)).sum(axis=1) + uncertainty.disturbance)
