"""Whether the spring and damper of an impedance law are safe, as the controller samples them."""

from __future__ import annotations

from typing import Final

import numpy as np

from taut.base.checks import finite_array
from taut.base.errors import UsageError
from taut.base.linalg import factor_spd
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.control.compliance import Compliance, modal_damping
from taut.control.describe import all_laws
from taut.control.impedance import Impedance, Stiffness
from taut.control.law import Law
from taut.control.task_reference import TaskMotion
from taut.control.velocity import Kalman
from taut.control.virtual_objects import VirtualBall, VirtualGroove, VirtualWall
from taut.controller import Controller
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot
from taut.study.limits import StiffnessCheck, check_stiffness

__all__ = ["check_impedance", "impedance_of"]

VIRTUAL: Final = (VirtualBall, VirtualGroove, VirtualWall)
HAND: Final = 20.0  # [Hz]: faster than hands and pushes move a tool
REACH: Final = 1e-6  # of the Jacobian: below it a direction cannot be moved in
NO_DAMPING: Final = 1e-12  # [N m s/rad], in place of none


def impedance_of(law: Law) -> tuple[Impedance | Stiffness, str] | None:
    """The one law of impedance in a law, and its path; None where there is none, or more than one."""
    found = [(law, "law")] if isinstance(law, (Impedance, Stiffness)) else []
    for name, child in law.children().items():
        inner = impedance_of(child)
        if inner is not None:
            found.append((inner[0], inner[1].replace("law", f"law.{name}", 1)))
    return found[0] if len(found) == 1 else None


def check_impedance(
    ctrl: Controller, q: ArrayLike | None = None, *, delay: float = 0.0, band: float = HAND
) -> StiffnessCheck:
    """Whether the stiffness of an impedance controller is safe at a pose, with gains, payload and sensing as now.

    At rest at the reference, with gravity compensated; the damping of the arm's own viscous friction counts.

    Args:
        ctrl: A controller with an `Impedance` or `Stiffness` law.
        q: (n,) positions [rad | m]; home if left out.
        delay: [s] from the tick to the torque, beyond the hold.
        band: [Hz] of the motions that must get no energy out of it.

    Raises:
        UsageError: No such law, one that feels an inertia D, virtual objects beside it, a Kalman filter.

    Example:
        >>> import taut
        >>> ctrl = taut.compile(taut.laws.Impedance(K=(800.0, 30.0), zeta=0.7), taut.load_arm("panda"))
        >>> taut.check_impedance(ctrl).stable
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
            "taut.check_stiffness_at(arm, q, K=...) with the stiffness of both together",
            name="ctrl",
        )
    law, path = found
    own = f"{path}."
    values = {p[len(own) :]: v for p, v in ctrl.parameters.items() if p.startswith(own)}
    law = law.bound(values)  # type: ignore[assignment]  # the same class
    assert isinstance(law, (Impedance, Stiffness))
    if isinstance(law, Impedance) and law.has("D"):
        raise UsageError(
            "check_impedance speaks of the arm's own inertia; with D the loop goes through the wrist sensor too",
            name="D",
        )
    velocity = ctrl.side.sensing.velocity
    if isinstance(velocity, Kalman):
        raise UsageError("check_impedance knows no Kalman filter; use a low-pass of the same delay", name="sensing")
    arm = ctrl.arm
    q = arm.home if q is None else finite_array("q", q, shape=(arm.n,), joints=arm.joint_names)
    payload = PayloadValues.of(subtree(ctrl.parameters, "model.payload"))
    x = Snapshot(ctrl.side.model, q=q, v=np.zeros(arm.n), payload=payload)
    ref = TaskMotion.at_rest(x, law.tool)
    felt = Compliance.of(law.error, law.frame, x, ref, law.tool, law.coordinates)
    J = felt.error.J
    mobility = felt.matrix_inwards(J @ x.M_factors.solve(J.T))
    sizes, axes = np.linalg.eigh(_symmetric(mobility))
    U = axes[:, sizes > REACH**2 * sizes[-1]]  # (k, r) the ways that the tool can move
    Lambda = np.linalg.inv(U.T @ mobility @ U)
    K, B = _spring_and_damper(law, x, U, Lambda)
    joints = np.maximum(arm.viscous + _joint_damping(law, arm.n), NO_DAMPING)
    damping = np.linalg.inv(U.T @ felt.matrix_inwards((J / joints) @ J.T) @ U)
    damping = np.zeros_like(damping) if np.abs(damping).max() < 1e3 * NO_DAMPING else damping
    return check_stiffness(
        _symmetric(Lambda),
        K=_symmetric(K),
        B=_symmetric(B),
        damping=_symmetric(damping),
        rate=ctrl.rate,
        delay=delay,
        velocity=velocity,
        band=min(band, 0.5 * ctrl.rate),
    )


def _symmetric(matrix: Float64Array) -> Float64Array:
    return np.asarray(0.5 * (matrix + matrix.T))


def _joint_damping(law: Impedance | Stiffness, n: int) -> Float64Array:
    """(n,) of a Stiffness law; a matrix counts by its diagonal."""
    if isinstance(law, Impedance):
        return np.zeros(n)
    kd = np.asarray(law.kd.as_array())
    return np.diag(kd) if kd.ndim == 2 else kd * np.ones(n)


def _spring_and_damper(
    law: Impedance | Stiffness, x: Snapshot, U: Float64Array, Lambda: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """(r, r) each, in the ways U (k, r) that the tool can move, with the inertia Lambda there."""
    size, r = law.dimensions, U.shape[1]
    if isinstance(law, Stiffness):
        return U.T @ np.asarray(law.K.matrix(size)) @ U, np.zeros((r, r))
    K = U.T @ np.asarray(law.gain_at("K", x).matrix(size)) @ U
    if law.has("B"):
        return K, U.T @ np.asarray(law.gain_at("B", x).matrix(size)) @ U
    factors, zeta = factor_spd(Lambda), law.zeta.as_array()
    return K, np.column_stack([modal_damping(factors, K, zeta, column) for column in np.eye(r)])
