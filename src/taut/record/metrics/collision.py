"""Thresholds of collision detection, from what a wrong model alone makes of a motion."""

from __future__ import annotations

from typing import Final

import numpy as np

from taut.base.checks import instance_of, read_only
from taut.base.errors import UsageError, quoted_list, warn
from taut.base.types import Float64Array
from taut.record.run import Run

LOW_THRESHOLD: Final = 1e-3  # of a joint's torque limit: below it are those of rounding and of the integrator
MARGIN_OF_THRESHOLD: Final = 1.5  # [-] of the largest estimate without contact: what other runs of the motion may add
TAU_EXT: Final = "sensed.tau_ext"


def collision_threshold(run: Run) -> Float64Array:
    """(n,) thresholds for `taut.guards.collision` of a motion [N m | N]: 1.5 times its largest estimate per joint.

    Of a run of the same motion, at the same speed and bandwidth, in which nothing touched the arm: on the real arm,
    or in simulation with a plant that differs from the model as the arm may. An exact model gives thresholds of
    rounding and of the integrator, which any real arm exceeds; so does a joint in which the plant differs little.

    Args:
        run: A run whose sensing has a `taut.sensors.MomentumObserver`.

    Warns:
        RuntimeWarning: Thresholds below a thousandth of the torque limits (without one: of the largest torque).

    Raises:
        UsageError: A run without an observer, or with contact.

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
    threshold = MARGIN_OF_THRESHOLD * np.abs(run.extra[TAU_EXT]).max(axis=0)
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
