"""Poses for the calibration of a wrist sensor: within the limits, near home, and far apart in what gravity does."""

from __future__ import annotations

from typing import Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, finite_scalar
from taut.base.errors import NumericalError, RangeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.maths.wrist import sensor_place

__all__ = ["calibration_poses"]

CANDIDATES: Final = 400
SEED: Final = 0
MARGIN: Final = 0.05  # of a joint's range, kept from its limits
LOAD: Final = 0.9  # of a joint's torque limit that a pose may take to hold
TRAVEL: Final = 0.5  # weight of the way from the start against the logarithm of what a pose tells
LEAST: Final = 0.1  # rad, root mean square, of what gravity must turn
FLOOR: Final = 1e-3  # of what poses tell, so that the first of them count too


def calibration_poses(
    arm: Arm, *, count: int = 8, travel: float = 1.5, q: ArrayLike | None = None, frame: str | None = None
) -> Float64Array:
    """Poses in which a wrist sensor tells bias, mass and centre of its tool well.

    They are the poses for `taut.analysis.calibrate_wrist`.

    The first is where the arm stands. Each further one is the one of some hundred candidates around it that adds
    the most to the determinant of what the poses tell of the centre of mass, less a little for the way there. They
    keep from the limits of the joints and of their torques. They know nothing of what stands around the arm, nor of
    the arm's own links: look at them before a real arm goes there.

    Args:
        arm: The arm.
        count: Number of poses, 3 at least.
        travel: The most that a joint moves away from q [rad | m].
        q: (n,) where to start from; home if None.
        frame: Where the sensor stands: a frame of the tool's body; the tool's own if None.

    Returns:
        (count, n) positions [rad | m].

    Raises:
        RangeError: Fewer than three poses, no travel.
        NumericalError: The arm cannot turn its tool against gravity, or hardly hold itself: no poses would do.

    Example:
        >>> import taut
        >>> calibration_poses(taut.load_arm("planar3"), count=4).shape
        (4, 3)
    """
    if isinstance(count, bool) or not isinstance(count, int):
        raise UsageError(f"count must be a whole number; got {count!r}", name="count")
    if count < 3:
        raise RangeError(
            f"count must be >= 3: three directions of gravity tell all numbers; got {count}", name="count"
        )
    if finite_scalar("travel", travel, unit="rad | m") <= 0.0:
        raise RangeError(f"travel must be > 0 [rad | m]; got {travel!r}", name="travel")
    start = arm.home if q is None else finite_array("q", q, shape=(arm.n,), joints=arm.joint_names, unit="rad | m")
    place, model = sensor_place(arm, frame, "calibration_poses"), model_of(arm)
    near = _candidates(arm, start, travel)
    ways = np.array([(dyn.pose(model, row).R @ place.R_ES).T @ arm.gravity for row in near])
    u = ways / np.linalg.norm(arm.gravity)
    cost = TRAVEL * np.abs(near - start).max(axis=1) / travel
    if len(near) < count:
        raise NumericalError(
            f"arm '{arm.name}' can hold itself in {len(near) - 1} of {CANDIDATES} poses around where it stands, "
            f"which are too few to choose {count} from; start from another q=, or give less travel=",
            name="arm",
        )
    chosen = [0]
    for _ in range(count - 1):
        sets = np.array([u[[*chosen, i]] for i in range(len(near))])
        gain = np.linalg.slogdet(_information(sets) + FLOOR * np.eye(3))[1] - cost
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
    if np.linalg.eigvalsh(_information(u[chosen]))[0] < len(chosen) * LEAST**2:
        raise NumericalError(
            f"arm '{arm.name}' turns its tool by too little against gravity within {travel:g} rad of where it "
            "stands, so that readings of its wrist cannot tell mass and com from the bias; start from another q=, "
            "give more travel=, or measure the tool on a scale",
            name="arm",
        )
    return near[chosen]


def _candidates(arm: Arm, start: Float64Array, travel: float) -> Float64Array:
    """The start, and positions around it that the arm may hold."""
    rng = np.random.default_rng(SEED)
    span = np.where(np.isfinite(arm.upper - arm.lower), arm.upper - arm.lower, 0.0)
    low = np.maximum(arm.lower + MARGIN * span, start - travel)
    high = np.minimum(arm.upper - MARGIN * span, start + travel)
    low, high = np.minimum(low, start), np.maximum(high, start)  # for a start that is closer to a limit
    drawn = rng.uniform(low, high, size=(CANDIDATES, arm.n))
    drawn[: CANDIDATES // 2, : max(arm.n - 3, 0)] = start[: max(arm.n - 3, 0)]  # half of them turn the wrist alone
    payload = PayloadValues(mass=arm.payload.mass, com=arm.payload.com, inertia=arm.payload.inertia)
    model = model_of(arm)
    held = [row for row in drawn if (np.abs(dyn.gravity_torque(model, row, payload)) <= LOAD * arm.effort).all()]
    return np.vstack([start, *held])


def _information(u: Float64Array) -> Float64Array:
    """(..., 3, 3) what directions of gravity (..., k, 3) tell of a centre of mass beside an unknown bias."""
    off = u - u.mean(axis=-2, keepdims=True)
    S = np.swapaxes(off, -1, -2) @ off
    out: Float64Array = np.trace(S, axis1=-2, axis2=-1)[..., np.newaxis, np.newaxis] * np.eye(3) - S
    return out
