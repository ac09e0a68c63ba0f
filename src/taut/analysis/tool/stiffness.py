"""Which stiffness is safe at the tool of an arm, at a pose."""

from __future__ import annotations

import dataclasses
from typing import Final, Literal

import numpy as np

from taut.analysis.tool.limits import StiffnessCheck, StiffnessLimits, check_stiffness, checked_band
from taut.arm.description import Arm
from taut.base.checks import finite_array, one_of, require_at_least
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.linear.sampled import SampledLoop, VelocityKind, square
from taut.maths.snapshot import snapshot

__all__ = ["check_stiffness_at", "direction_of", "safe_stiffness"]

Frame = Literal["world", "tool"]
FRAMES: Final[tuple[Frame, ...]] = ("world", "tool")
REACH: Final = 1e-6  # of the Jacobian: below it a direction cannot be moved in
NO_DAMPING: Final = 1e-12  # [N m s/rad], in place of none
OF_JOINTS: Final = "viscous friction of the joints"


def safe_stiffness(
    arm: Arm,
    q: ArrayLike,
    direction: ArrayLike,
    *,
    B: float = 0.0,
    rate: float = 1000.0,
    delay: float = 0.0,
    velocity: VelocityKind = "measured",
    tool: str | None = None,
    frame: Frame = "world",
    damping: ArrayLike | None = None,
    band: float | None = None,
) -> StiffnessLimits:
    """How stiff a virtual spring at the tool may be, along one direction at a pose.

    Law:          mass = 1 / (d^T J M^-1 J^T d), damping = 1 / (d^T J D^-1 J^T d), the others as `stiffness_limits`
                  The damping is the least that joints of damping D have against a motion along d: exact for arms
                  without a joint too many, on the safe side for others.

    At rest, with gravity compensated, and no load in the spring.

    Args:
        arm: The arm.
        q: (n,) positions [rad | m].
        direction: (3,) of a motion along it, or (6,) of a translation or a rotation; any length.
        B: Of the virtual damper along it [N s/m | N m s/rad].
        rate: [Hz].
        delay: [s] from the tick to the torque, beyond the hold.
        velocity: "measured", "difference", `taut.sensors.LowPass(...)`, `taut.sensors.Difference(cutoff=...)`.
        tool: The frame that the spring holds; the arm's tool if left out.
        frame: Whose axes the direction is in, "world" or "tool".
        damping: (n,) or a number, viscous friction of the joints; the arm's own if left out.
        band: [Hz] of the motions for `passive_in_band`; half the rate if left out.

    Raises:
        RangeError: The arm cannot move along it at this pose, or a number that has no meaning.
        ShapeError, UsageError, UnknownNameError: Another shape, kind or name.

    Example:
        >>> import taut
        >>> limits = taut.analysis.safe_stiffness(taut.load_arm("planar2"), [0.3, 0.8], [1.0, 0.0, 0.0], delay=1e-3)
        >>> round(limits.stable), round(limits.passive)
        (175, 175)

    References:
        Khatib, A unified approach for motion and force control (1987), for the mass. Colgate and Schenkel (1997).
    """
    way = direction_of(direction)
    mobility, looseness = _mobilities(arm, q, tool, frame, damping)
    moved, lost = float(way @ mobility @ way), float(way @ looseness @ way)
    if moved <= REACH * float(np.abs(mobility).max()):
        raise RangeError(
            f"arm '{arm.name}' cannot move its tool along {np.round(way, 4).tolist()} at this pose; choose another "
            "direction or pose",
            name="direction",
        )
    loop = SampledLoop(
        mass=1.0 / moved, damping=_of_looseness(1.0 / lost), K=1.0, B=B, rate=rate, delay=delay, velocity=velocity
    )
    unit = "N/m" if way[:3].any() else "N m/rad"
    return StiffnessLimits(loop=loop, band=checked_band(band, loop.rate), unit=unit, damping=OF_JOINTS)


def check_stiffness_at(
    arm: Arm,
    q: ArrayLike,
    *,
    K: ArrayLike,
    B: ArrayLike = 0.0,
    rate: float = 1000.0,
    delay: float = 0.0,
    velocity: VelocityKind = "measured",
    tool: str | None = None,
    frame: Frame = "world",
    damping: ArrayLike | None = None,
    band: float | None = None,
) -> StiffnessCheck:
    """Whether a virtual spring and damper at the tool are safe at a pose, in all the directions that it can move in.

    Law:          Lambda = (J M^-1 J^T)^-1 and damping = (J D^-1 J^T)^-1 in the directions that the arm can move in
                  at all, K and B likewise; the rest as `taut.analysis.check_stiffness`

    At rest, with gravity compensated, and no load in the spring.

    Args:
        arm: The arm.
        q: (n,) positions [rad | m].
        K: (linear, angular), (6,) or (6, 6) [N/m, N m/rad].
        B: Likewise [N s/m, N m s/rad], or 0.
        rate: [Hz].
        delay: [s] from the tick to the torque, beyond the hold.
        velocity: "measured", "difference", `taut.sensors.LowPass(...)`, `taut.sensors.Difference(cutoff=...)`.
        tool: The frame that the spring holds; the arm's tool if left out.
        frame: Whose axes K and B are in, "world" or "tool".
        damping: (n,) or a number, viscous friction of the joints; the arm's own if left out.
        band: [Hz] of the motions for `passive_in_band`; half the rate if left out.

    Raises:
        ShapeError, RangeError, UsageError, UnknownNameError: A number, shape, kind or name that has no meaning.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> check = taut.analysis.check_stiffness_at(arm, [0.3, 0.8], K=(400.0, 0.0), B=(5.0, 0.0), delay=1e-3)
        >>> check.stable, check.passive
        (True, False)
    """
    matrices = {"K": _six("K", K), "B": _six("B", B)}
    mobility, looseness = _mobilities(arm, q, tool, frame, damping)
    sizes, axes = np.linalg.eigh(mobility)
    U = axes[:, sizes > REACH**2 * sizes[-1]]  # (6, r) the ways that the tool can move
    inside = {name: U.T @ each @ U for name, each in matrices.items()}
    Lambda = np.linalg.inv(U.T @ mobility @ U)
    own = np.linalg.inv(U.T @ looseness @ U)
    own = np.zeros_like(own) if np.abs(own).max() < 1e3 * NO_DAMPING else own
    check = check_stiffness(
        0.5 * (Lambda + Lambda.T), K=_symmetric(inside["K"]), B=_symmetric(inside["B"]), damping=_symmetric(own),
        rate=rate, delay=delay, velocity=velocity, band=band,
    )  # fmt: skip
    return dataclasses.replace(check, damping=OF_JOINTS)


def _symmetric(matrix: Float64Array) -> Float64Array:
    return np.asarray(0.5 * (matrix + matrix.T))


def _of_looseness(damping: float) -> float:
    return 0.0 if damping < 1e3 * NO_DAMPING else damping


def _mobilities(
    arm: Arm, q: ArrayLike, tool: str | None, frame: Frame, damping: ArrayLike | None
) -> tuple[Float64Array, Float64Array]:
    """(6, 6) J M^-1 J^T and J D^-1 J^T."""
    if not isinstance(arm, Arm):  # callers without a type checker
        raise UsageError(f"an Arm from taut.load_arm is needed; got {type(arm).__name__}", name="arm")
    one_of("frame", frame, FRAMES)
    x = snapshot(arm, q)
    J = x.J(tool, axes="W" if frame == "world" else "E")
    given = arm.viscous if damping is None else finite_array("damping", damping, unit="N m s/rad | N s/m")
    if given.shape not in ((), (arm.n,)):
        raise ShapeError(f"damping must be a number or ({arm.n},); got shape {given.shape}", name="damping")
    require_at_least("damping", given, 0.0, unit="N m s/rad | N s/m")
    joints = np.maximum(np.broadcast_to(given, (arm.n,)), NO_DAMPING)
    return J @ np.linalg.solve(x.M, J.T), (J / joints) @ J.T


def direction_of(direction: ArrayLike) -> Float64Array:
    """(6,) unit vector of a force or motion, (3,), or of a translation or rotation, (6,).

    Raises:
        ShapeError, RangeError: Another shape, both at once, or zero.
    """
    given = finite_array("direction", direction)
    if given.shape not in ((3,), (6,)):
        raise ShapeError(f"direction must have shape (3,) or (6,); got shape {given.shape}", name="direction")
    way = np.concatenate([given, np.zeros(6 - len(given))])
    if way[:3].any() and way[3:].any():
        raise RangeError(
            f"direction must be a translation or a rotation, not both; got {way.tolist()}",
            name="direction",
            value=way,
        )
    length = float(np.linalg.norm(way))
    if length == 0.0:
        raise RangeError("direction must not be zero", name="direction", value=0.0)
    return way / length


def _six(name: str, value: ArrayLike) -> Float64Array:
    """(6, 6) of (linear, angular), six numbers or a matrix; 0 for none."""
    given = finite_array(name, value)
    if given.shape == () and not given:
        return np.zeros((6, 6))
    if given.shape == ():
        raise ShapeError(
            f"{name} must be (linear, angular), (6,) or (6, 6): one number cannot be both per metre and per radian; "
            f"got {float(given):g}",
            name=name,
            value=value,
        )
    return square(name, np.repeat(given, 3) if given.shape == (2,) else given, 6)
