"""Whether an impedance controller is stable and passive, as it samples the arm."""

from __future__ import annotations

from typing import Final

import numpy as np

from taut.analysis.tool.limits import StiffnessCheck, checked_band
from taut.analysis.tool.stiffness import OF_JOINTS
from taut.base.checks import finite_array, require_at_least
from taut.base.errors import ShapeError, UsageError
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.control.command import Torque
from taut.control.describe import all_laws
from taut.control.law import Law, call, initial_memory
from taut.control.laws.friction import FrictionCompensation
from taut.control.laws.impedance import Impedance, Stiffness
from taut.control.laws.virtual_objects import VirtualBall, VirtualGroove, VirtualWall
from taut.control.sensing.velocity import Kalman
from taut.control.tasks.task import Task
from taut.controller import Controller
from taut.linear.sampled import SampledLoop
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot

__all__ = ["check_impedance", "impedance_of"]

VIRTUAL: Final = (VirtualBall, VirtualGroove, VirtualWall)
HAND: Final = 20.0  # [Hz]: faster than hands and pushes move a tool
STEP: Final = 1e-6  # [rad | m], [rad/s | m/s] of the differences that give the law's feedback
ROUNDING: Final = 1e-7  # of the largest stiffness or damping, below which differences know none
NO_DRY: Final = 1e12  # [rad/s | m/s] of speed over which dry friction is compensated: none is


def impedance_of(law: Law | Task) -> tuple[Impedance | Stiffness, str] | None:
    """The one law of impedance in a law, and its path; None where there is none, or more than one."""
    found = [(law, "law")] if isinstance(law, (Impedance, Stiffness)) else []
    for name, child in law.children().items():
        inner = impedance_of(child)
        if inner is not None:
            found.append((inner[0], inner[1].replace("law", f"law.{name}", 1)))
    return found[0] if len(found) == 1 else None


def check_impedance(
    ctrl: Controller,
    q: ArrayLike | None = None,
    *,
    delay: float = 0.0,
    band: float = HAND,
    damping: ArrayLike | None = None,
) -> StiffnessCheck:
    """Stability and passivity of an impedance controller at a pose, with gains, payload and sensing as they are now.

    Law:          M dv/dt + damping v = -(K_q dq + B_q v) held for a period, with the feedback of the whole law,
                  K_q = -d(tau - g)/dq and B_q = -d tau/dv: J^T K J and J^T B J of Impedance, J^T K J and kd of
                  Stiffness; a damper of the law acts once in a period, and is no physical damping

    Exact for small motions about rest at the reference, with gravity compensated, in the coordinates of the joints,
    so that motion in the null space counts too. Dry friction and its compensation are left out. Passive is: with
    every passive environment at the joints, which for redundant arms is more than at the tool.

    Args:
        ctrl: A controller with an `Impedance` or `Stiffness` law.
        q: (n,) positions [rad | m]; home if left out.
        delay: [s] from the tick to the torque, beyond the zero-order hold.
        band: [Hz] of the motions that must get no energy out of it.
        damping: (n,) or a number, viscous friction of the joints [N m s/rad | N s/m]; the arm's own if left out, 0
            for a verdict that relies on none. The verdict names it in `relies_on`.

    Raises:
        UsageError: No such law, one with an inertia D, virtual objects beside it, a Kalman filter, feedback that is
            no spring and damper.
        ShapeError, RangeError: A number that has no meaning, by name.

    Example:
        >>> import taut
        >>> ctrl = taut.compile(taut.laws.Impedance(K=(800.0, 30.0), zeta=0.7), taut.load_arm("panda"))
        >>> taut.analysis.check_impedance(ctrl).stable
        True
    """
    if not isinstance(ctrl, Controller):  # callers without a type checker
        raise UsageError(f"a controller from taut.compile is needed; got {type(ctrl).__name__}", name="ctrl")
    found = impedance_of(ctrl.law)
    if found is None:
        raise UsageError(
            f"check_impedance is for a controller with one Impedance or Stiffness law; this one has "
            f"{type(ctrl.law).__name__}",
            name="ctrl",
        )
    objects = [type(each).__name__ for _, each in all_laws(ctrl.law, "law") if isinstance(each, VIRTUAL)]
    if objects:
        raise UsageError(
            f"check_impedance knows no virtual objects, and {objects[0]} adds a spring of its own; ask "
            "taut.analysis.check_stiffness_at(arm, q, K=...) with the stiffness of both together",
            name="ctrl",
        )
    if isinstance(found[0], Impedance) and found[0].has("D"):
        raise UsageError(
            "check_impedance speaks of the arm's own inertia; with D the loop goes through the wrist sensor too",
            name="D",
        )
    velocity = ctrl.side.sensing.velocity
    if isinstance(velocity, Kalman):
        raise UsageError("check_impedance knows no Kalman filter; use a low-pass of the same delay", name="sensing")
    arm = ctrl.arm
    at = arm.home if q is None else finite_array("q", q, shape=(arm.n,), joints=arm.joint_names)
    friction = arm.viscous if damping is None else finite_array("damping", damping, unit="N m s/rad | N s/m")
    if friction.shape not in ((), (arm.n,)):
        raise ShapeError(f"damping must be a number or ({arm.n},); got shape {friction.shape}", name="damping")
    require_at_least("damping", friction, 0.0, unit="N m s/rad | N s/m")
    M, K, B = _feedback(ctrl, at)
    loop = SampledLoop(
        mass=M,
        K=K,
        B=B,
        damping=np.broadcast_to(friction, (arm.n,)),
        rate=ctrl.rate,
        delay=delay,
        velocity=velocity,
    )
    return StiffnessCheck(loop=loop, band=checked_band(min(band, 0.5 * loop.rate), loop.rate), damping=OF_JOINTS)


def _feedback(ctrl: Controller, q: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """(n, n) each: M, and stiffness and damping that the law gives the joints at rest at its reference."""
    values = dict(ctrl.parameters)
    for path, law in all_laws(ctrl.law, "law"):
        if isinstance(law, FrictionCompensation):
            values[f"{path}.width"] = np.asarray(NO_DRY)
    law = ctrl.side.single_law.bound(subtree(values, "law"))
    payload = PayloadValues.of(subtree(values, "model.payload"))
    n = ctrl.arm.n

    def seen(q: Float64Array, v: Float64Array) -> Snapshot:
        return Snapshot(ctrl.side.model, q=q, v=v, payload=payload)

    start = seen(q, np.zeros(n))
    ref = law.at_rest(start)
    memory = initial_memory(law, start, ref)

    def feedback(dq: Float64Array, v: Float64Array) -> Float64Array:
        x = seen(q + dq, v)
        command, _ = call(law, x, ref, memory, ctrl.side.dt)
        assert isinstance(command, Torque)
        return np.asarray(x.h - command.total, dtype=np.float64)

    steps, none = STEP * np.eye(n), np.zeros(n)
    K = np.column_stack([(feedback(e, none) - feedback(-e, none)) / (2.0 * STEP) for e in steps])
    B = np.column_stack([(feedback(none, e) - feedback(none, -e)) / (2.0 * STEP) for e in steps])
    return np.asarray(start.M, dtype=np.float64), _spring(K, "stiffness", least=0.0), _spring(B, "damping")


def _spring(matrix: Float64Array, what: str, least: float | None = None) -> Float64Array:
    """A symmetric matrix without the rounding of differences.

    Raises:
        UsageError: It is not symmetric, or pushes away.
    """
    size = float(np.abs(matrix).max())
    skew = float(np.abs(matrix - matrix.T).max())
    sizes, axes = np.linalg.eigh(0.5 * (matrix + matrix.T))
    sizes[np.abs(sizes) < ROUNDING * size] = 0.0
    if skew > 100.0 * ROUNDING * size or (least is not None and sizes[0] < least):
        raise UsageError(
            f"check_impedance is for feedback that is a spring and a damper; the {what} of this law at the joints is "
            f"{'not symmetric' if skew > 100.0 * ROUNDING * size else 'negative in a direction'}; use taut.linearise",
            name="ctrl",
        )
    return np.asarray((axes * sizes) @ axes.T)
