"""Gains of laws that make the tool feel like a mass, a damper and a spring."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from scipy.linalg import eigh

from taut.analysis.design.asked import Asked, six_by_six
from taut.analysis.design.place import AtTool, at_tool
from taut.base.errors import RangeError, UsageError
from taut.base.types import Float64Array
from taut.linear.poles import damping_ratios
from taut.maths.snapshot import Snapshot

__all__ = ["admittance", "damped", "impedance", "least_damping", "stiffness"]

FREE: Final = 1e-9  # of the largest stiffness over inertia: a motion that no spring draws back
BARELY: Final = 1e-6  # of a damping ratio
SCALINGS: Final = 60  # until it is there: what is added to a damping does not add to every ratio in the same measure


def damped(M: Float64Array, K: Float64Array, zeta: float) -> Float64Array:
    """The damping that gives every mode of an inertia and a stiffness the same damping ratio.

    Modes without stiffness are damped at the rate of the slowest that has one: 2 zeta omega_n.
    """
    squares, modes = eigh(K, M)  # modes^T M modes = 1
    held = squares > FREE * max(float(squares[-1]), 1e-300)
    omega = np.sqrt(np.where(held, squares, squares[held].min() if held.any() else 0.0))
    across = M @ modes
    B = across @ np.diag(2.0 * zeta * omega) @ across.T
    return np.asarray(0.5 * (B + B.T))


def least_damping(M: Float64Array, K: Float64Array, B: Float64Array) -> float:
    """The least damping ratio of M x_ddot + B x_dot + K x = 0, without the motions that no spring draws back."""
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, B)]])
    poles = np.linalg.eigvals(A)
    poles = poles[np.abs(poles) > 1e-6 * np.abs(poles).max()]
    return float(np.min(damping_ratios(poles)))


def _needs_damping(law: str, asked: Asked) -> float:
    if asked.damping is None:
        raise UsageError(f"{law} needs its damping: zeta or overshoot", name="zeta")
    return asked.damping


def impedance(law: Any, at: tuple[Snapshot, ...], asked: Asked) -> dict[str, Any]:
    """K, zeta and D: of stiffness, of inertia, or of speed, two of them; with the arm's own inertia one.

    Law:          K and zeta: they are the law's own. omega_n and zeta: K = omega_n^2 Lambda at the pose, and B
                  that damps every mode there with zeta. K, D or omega_n, two of them: D omega_n^2 = K
    """
    size = law.dimensions
    if asked.speeds and asked.damping is None:
        zeta, omega = asked.swing("Impedance")
    else:
        zeta, omega = _needs_damping("Impedance", asked), np.zeros(())
        if asked.speeds:
            zeta, omega = asked.swing("Impedance")
    places = [at_tool(law, x) for x in at]
    if asked.K is not None and asked.D is not None and asked.speeds:
        raise UsageError(
            f"K and D determine omega_n = sqrt(K / D) already; leave out {asked.speeds[0]}", name=asked.speeds[0]
        )
    gains: dict[str, Any] = {"zeta": zeta, "B": None}
    if asked.K is None and not asked.speeds:
        raise UsageError("Impedance needs K, or a speed: omega_n, settling or bandwidth", name="K")
    if asked.K is not None and not asked.speeds:
        six_by_six("K", asked.K, size)
        return gains | {"K": asked.K} | ({} if asked.D is None else {"D": asked.D})
    S = np.diag(_each(omega, size))
    if asked.K is None and asked.D is None:
        if law.D is not None:
            return gains | {"K": S @ law.D.matrix(size) @ S}
        K = _stiff_enough(places, S)
        candidates = [place.outside(damped(place.Lambda, place.inside(K), zeta)) for place in places]

        def worst(B: Float64Array) -> float:
            return min(least_damping(place.Lambda, place.inside(K), place.inside(B)) for place in places)

        return {"K": K, "B": _damped_enough(candidates, worst, zeta), "zeta": None}
    if asked.K is None:
        return gains | {"K": S @ six_by_six("D", asked.D, size) @ S, "D": asked.D}
    slow = np.linalg.inv(S)
    return gains | {"K": asked.K, "D": slow @ six_by_six("K", asked.K, size) @ slow}


def _stiff_enough(places: list[AtTool], S: Float64Array) -> Float64Array:
    """(k, k) K with which the slowest mode of every pose has the natural frequencies S."""
    wanted = [place.inside(S) @ place.Lambda @ place.inside(S) for place in places]
    mean = np.mean([place.outside(each) for place, each in zip(places, wanted, strict=True)], axis=0)
    slowest = [
        float(eigh(place.inside(mean), each, eigvals_only=True)[0])
        for place, each in zip(places, wanted, strict=True)
    ]
    return np.asarray(mean / min(slowest))


def _each(omega: Float64Array, size: int) -> Float64Array:
    """(k,) of a number, of (linear, angular), or of one for each."""
    if omega.shape == (2,) and size == 6:
        return np.repeat(omega, 3)
    if omega.shape not in ((), (size,)):
        raise UsageError(
            f"omega_n must be a number, (linear, angular) or ({size},); got shape {omega.shape}", name="omega_n"
        )
    return np.array(np.broadcast_to(omega, (size,)))


def stiffness(law: Any, at: tuple[Snapshot, ...], asked: Asked) -> dict[str, Any]:
    """K as asked, and kd (n, n) of the joints that damps every mode of J^T K J and M with zeta, at the worst pose."""
    if asked.K is None:
        raise UsageError("Stiffness needs K=(linear, angular), (6,) or (6, 6), and zeta", name="K")
    zeta = _needs_damping("Stiffness", asked)
    K = six_by_six("K", asked.K, law.dimensions)
    if not K.any():
        raise RangeError(
            "K of Stiffness must be > 0 in some direction, for it draws the arm nowhere", name="K", value=0.0
        )
    pairs = []
    for x in at:
        J = at_tool(law, x).J
        pairs.append((np.asarray(x.M), J.T @ K @ J))
    candidates = [damped(M, K_q, zeta) for M, K_q in pairs]

    def worst(kd: Float64Array) -> float:
        return min(least_damping(M, K_q, kd) for M, K_q in pairs)

    return {"K": asked.K, "kd": _damped_enough(candidates, worst, zeta)}


def _damped_enough(
    candidates: list[Float64Array], worst: Callable[[Float64Array], float], zeta: float
) -> Float64Array:
    """The damping with which the least damping ratio at all poses is zeta.

    Of several poses it is that of the one whose damping does best at the others, times what they lack.

    Args:
        candidates: That of each pose, in coordinates that all poses share.
        worst: The least damping ratio that a damping makes at any of them.
        zeta: The damping ratio that was asked for.
    """
    B = max(candidates, key=worst)
    for _ in range(SCALINGS if len(candidates) > 1 else 0):
        share = worst(B) / min(zeta, 1.0) if zeta else 1.0
        if share >= 1.0 - BARELY:
            break
        B = B / min(share, 1.0 - BARELY)
    return B


def admittance(asked: Asked) -> tuple[dict[str, Any], float]:
    """D, K, and B or zeta, of two of D, K and omega_n; or D and B of D and a pole. And the fastest frequency."""
    if asked.K is None and asked.damping is None:
        if asked.D is None:
            raise UsageError("Admittance needs D=(linear, angular), with a bandwidth or with K and zeta", name="D")
        pole = asked.pole("Admittance")
        B = six_by_six("D", asked.D) * np.sqrt(np.outer(_each(pole, 6), _each(pole, 6)))
        return {"D": asked.D, "B": B, "K": (0.0, 0.0), "zeta": None}, float(np.max(pole))
    zeta = _needs_damping("Admittance", asked)
    given = [name for name in ("D", "K") if getattr(asked, name) is not None] + list(asked.speeds)
    if len(given) != 2:
        raise UsageError(
            f"Admittance needs two of D, K and a speed, for D omega_n^2 = K; got {' and '.join(given) or 'none'}",
            name=given[-1] if given else "D",
        )
    if asked.speeds:
        S = np.diag(_each(asked.swing("Admittance")[1], 6))
        slow = np.linalg.inv(S)
        D = slow @ six_by_six("K", asked.K) @ slow if asked.D is None else six_by_six("D", asked.D)
        K = S @ D @ S
    else:
        D, K = six_by_six("D", asked.D), six_by_six("K", asked.K)
    squares = eigh(K, D, eigvals_only=True)
    if squares[0] <= 0.0:
        raise RangeError(
            "zeta damps the swing on K, and K has a direction without stiffness, which would have no damping; give "
            "D and a bandwidth, without K and zeta",
            name="K",
        )
    gains = {"D": D if asked.D is None else asked.D, "K": K if asked.K is None else asked.K, "zeta": zeta, "B": None}
    return gains, float(np.sqrt(squares[-1]))
