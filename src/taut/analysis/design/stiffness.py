"""A stiffness that was asked for, against that of the loop at rest: what a small force moves the tool by."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut import laws
from taut.analysis.design.directions import Direction
from taut.analysis.design.disturbed import disturbed
from taut.analysis.design.limits import DesignLimit
from taut.analysis.design.place import at_tool
from taut.analysis.design.trial import Bench
from taut.base.types import ArrayLike, Float64Array
from taut.control.law import Law
from taut.linear.linearise import Linearisation
from taut.maths.snapshot import Snapshot
from taut.plant.disturbance import TORQUE, WRENCH

__all__ = ["STATIC", "Stiff", "static_limits", "stiffnesses"]

STATIC: Final = 0.01  # of a stiffness at rest
SMALL: Final = 1e-4  # [m | rad] by which a force moves what is as stiff as asked
STUCK: Final = 1e-6  # of that: it does not move
MOVABLE: Final = 1e-9  # of a direction: the arm cannot move there
OF_TOOL: Final = (laws.Impedance, laws.Stiffness, laws.Admittance)


@dataclass(frozen=True, kw_only=True, eq=False)
class Stiff:
    """How stiff one direction is: a force along it over the way that it moves along it, while all others may give.

    Args:
        direction: The joint, or the direction of the tool in the axes of the gains.
        unit: N/m, or N m/rad.
        asked: By itself, K_ii.
        designed: By all of K, 1 / (K^-1)_ii in the motions that the arm can make: more than K_ii where it cannot
            give way along one direction without another.
        predicted: By the linear model of the sampled loop.
        simulated: At the end of a run of the nonlinear sampled loop under a small constant force.
    """

    direction: str
    unit: str
    asked: float
    designed: float
    predicted: float
    simulated: float


def stiffnesses(
    bench: Bench, x: Snapshot, lin: Linearisation, directions: tuple[Direction, ...], K: ArrayLike | None
) -> tuple[Stiff, ...]:
    """Those of a law that was asked for a stiffness; none with an integral, which gives nowhere in the end.

    Args:
        bench: The law in the plant that the design is for.
        x: The arm at rest.
        lin: The linear model there.
        directions: Of its error.
        K: (n,) of the joints; None for what the law has at the tool.
    """
    if bench.integral or not directions:
        return ()
    found = _of_tool(bench, x) if isinstance(bench.law, OF_TOOL) else None if K is None else _of_joints(x, K)
    if found is None:
        return ()
    names, units, rows, alone, asked = found
    if not names:
        return ()
    forces = asked[:, np.newaxis] * SMALL * rows  # (k, n) on the joints
    path = WRENCH if "F_ext" in bench.ctrl.needs else TORQUE  # a law that feels the force must measure it
    values = forces if path == TORQUE else np.linalg.lstsq(np.asarray(x.J()).T, forces.T, rcond=None)[0].T
    C, B = lin.C[list(lin.rows("q"))], lin.B[:, list(lin.columns(path))]
    states = np.linalg.lstsq(np.eye(len(lin.A)) - lin.A, B @ values.T, rcond=None)[0]
    moved = (C @ states).T
    ticks = bench.ticks(directions)
    without, *seen = (
        record["q"][-1] for record in disturbed(bench.loop, bench.resting(lin.q - lin.moved), path, values, ticks)
    )
    return tuple(
        Stiff(
            direction=names[i],
            unit=units[i],
            asked=float(alone[i]),
            designed=float(asked[i]),
            predicted=_over(asked[i] * SMALL, rows[i] @ moved[i]),
            simulated=_over(asked[i] * SMALL, rows[i] @ (q - without)),
        )
        for i, q in enumerate(seen)
    )


def _over(force: float, way: float) -> float:
    return float(force / way) if abs(way) > STUCK * SMALL else math.inf


_Found = tuple[list[str], list[str], Float64Array, Float64Array, Float64Array]


def _of_joints(x: Snapshot, K: ArrayLike) -> _Found:
    units = ["N/m" if unit == "m" else "N m/rad" for unit in x.arm.units]
    each = np.asarray(np.broadcast_to(K, (x.n,)), dtype=np.float64)
    return list(x.arm.joint_names), units, np.eye(x.n), each, each


def _of_tool(bench: Bench, x: Snapshot) -> _Found:
    """Directions that the arm can move in, each with the stiffness that all of K gives it."""
    law: Any = bench.law
    place = at_tool(law, x)
    whole = np.asarray(law.K.matrix(len(place.U)), dtype=np.float64)
    K = place.inside(whole)
    sizes, ways = np.linalg.eigh(K)
    held = sizes > MOVABLE * sizes[-1]
    give = (place.U @ ways[:, held]) @ np.diag(1.0 / sizes[held]) @ (place.U @ ways[:, held]).T
    drawn, movable = (np.linalg.norm(rows, axis=1) for rows in (place.U @ ways[:, held], place.U))
    kept = [i for i in range(len(give)) if movable[i] > MOVABLE and drawn[i] > (1.0 - MOVABLE) * movable[i]]
    units = ["N m/rad" if len(place.names) == 6 and i > 2 else "N/m" for i in kept]
    stiff = np.array([1.0 / give[i, i] for i in kept])
    return [place.names[i] for i in kept], units, place.J[kept], np.diag(whole)[kept], stiff


def _wanted(each: Stiff) -> str:
    """What there should be, and what was asked for where that is less."""
    if abs(each.designed / each.asked - 1.0) <= STATIC:
        return f"{each.designed:.4g} were asked for"
    return (
        f"K has {each.asked:.4g} along it by itself and {each.designed:.4g} with the other directions, without which "
        "the arm cannot move there"
    )


def static_limits(stiffness: tuple[Stiff, ...], law: Law) -> Iterator[DesignLimit]:
    """Of a stiffness that was asked for, what a force at rest finds."""
    if not stiffness:
        return
    worst = max(stiffness, key=lambda each: abs(each.designed / each.predicted - 1.0))
    ok = abs(worst.designed / worst.predicted - 1.0) <= STATIC
    why = "; M couples the joints of a law of accelerations, GravityPID keeps them apart"
    yield DesignLimit(
        name="at rest", value=worst.predicted, limit=worst.designed, unit=worst.unit, ok=ok,
        sentence=(
            f"a force along {worst.direction} finds {worst.predicted:.4g} {worst.unit}, where {_wanted(worst)}"
            f"{'' if ok or isinstance(law, OF_TOOL) else why}"
        ),
    )  # fmt: skip
