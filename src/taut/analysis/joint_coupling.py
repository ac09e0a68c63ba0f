"""Coupling of the joints of an arm: crosstalk of a loop, and whether decentralised control is enough."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.base.checks import positive_scalar
from taut.base.errors import UsageError
from taut.base.paths import subtree
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.linear.equilibrium import WITHIN
from taut.linear.linearise import linearise
from taut.linear.margins import frequency_grid
from taut.loop import Loop
from taut.maths.model import PayloadValues, model_of
from taut.maths.snapshot import Snapshot

__all__ = ["Coupling", "coupling"]

MIN_DROOP: Final = 1e-12  # [rad | m] of a droop
MAX_CROSSTALK: Final = 0.1  # [-] of decentralised control


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling(Result):
    """Coupling of the joints of a loop about a pose.

    Args:
        joints: Their names.
        inertia: 0 to 1, one less the smallest eigenvalue of D^-1/2 M D^-1/2, with D the diagonal of M, and M with
            rotors and payload: 0 for axes whose accelerations are decoupled.
        crosstalk: (n, n) largest gain over all frequencies from the reference of each joint (column) to each (row).
        droop: (n,) steady-state error of each joint under gravity [rad | m].
        max_crosstalk: Largest crosstalk of different joints at which decentralised control is enough.
        unit: Of the joints, all of one kind.
    """

    joints: tuple[str, ...]
    inertia: float
    crosstalk: Float64Array
    droop: Float64Array
    max_crosstalk: float
    unit: str

    @property
    def worst(self) -> tuple[float, str, str]:
        """The largest crosstalk of two joints, the joint that moves, and the one whose reference it was."""
        apart = np.where(np.eye(len(self.joints), dtype=bool), -1.0, self.crosstalk)
        i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
        return max(float(apart[i, j]), 0.0), self.joints[i], self.joints[j]

    @property
    def ok(self) -> bool:
        """Decentralised control is enough: no crosstalk of different joints is above `max_crosstalk`."""
        return self.worst[0] <= self.max_crosstalk

    def content(self) -> Content:
        """The verdict, and a table of the joints."""
        size, joint, other = self.worst
        verdict = f"decentralised control is {'enough' if self.ok else 'not enough'}"
        if len(self.joints) > 1:
            verdict += (
                f": joint '{joint}' follows up to {100.0 * size:.3g} % of the reference of '{other}', and the "
                f"limit is {100.0 * self.max_crosstalk:g} %"
            )
        apart = self.crosstalk - np.diag(np.diag(self.crosstalk))
        droop = np.where(np.abs(self.droop) > MIN_DROOP, self.droop, 0.0)
        rows = list(zip(self.joints, (100.0 * apart.max(axis=1)).tolist(), droop.tolist(), strict=True))
        return Content(
            title="coupling of the joints",
            summary=[verdict] if self.ok else [],
            faults=[] if self.ok else [verdict],
            tables=[Table(columns=("joint", "crosstalk [%]", f"droop under gravity [{self.unit}]"), rows=rows)],
            notes=[f"coupling of the inertia matrix {self.inertia:.3g} (0 is diagonal, 1 is singular)"],
        )


def coupling(
    loop: Loop, *, at: ArrayLike | None = None, max_crosstalk: float = MAX_CROSSTALK, within: float = WITHIN
) -> Coupling:
    """Coupling of the joints of an arm at a pose, in the sampled loop: whether decentralised control is enough.

    The dynamics are decoupled where each joint's acceleration depends on its own torque and state alone: in gantries,
    and nearly in arms with large gears, whose rotors are most of the diagonal of M, and where gravity is small
    beside the torques of the joints. How much that matters depends on the gains of the loop.

    Args:
        loop: A loop of a law of joints, with a reference that stays.
        at: (n,) joint positions to begin at [rad | m]; home if left out.
        max_crosstalk: Largest crosstalk of different joints at which decentralised control is enough.
        within: [rad | m] distance from `at` within which the equilibrium is searched.

    Raises:
        UsageError: A law that follows no joint positions; joints of metres beside joints of radians; an unstable
            loop.
        RangeError: No equilibrium near `at`.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("gantry3")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=1000.0, kd=100.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0)
        >>> taut.analysis.coupling(loop).ok
        True

    References:
        Section 10.2.2.1 decentralised multi-joint control; section 10.2.1.5 on gears.
    """
    max_crosstalk = positive_scalar("max_crosstalk", max_crosstalk)
    lin = linearise(loop, at=at, within=within)
    if "ref.q[0]" not in lin.inputs:
        raise UsageError(
            f"coupling is for laws that follow joint positions; {type(loop.side.law).__name__} does not", name="loop"
        )
    units = loop.plant.arm.units
    if len(set(units)) > 1:
        raise UsageError(
            "coupling compares joints of one kind, and this arm has some in rad and some in m, whose crosstalk "
            "has units; look at lin.frequency_response(omega, input='ref.q', output='q') of taut.linearise",
            name="loop",
        )
    if not lin.stable:
        raise UsageError(
            f"crosstalk is that of a stable loop; this one is {lin.unstable_because}; lower the gains",
            name="loop",
        )
    payload = PayloadValues.of(subtree(loop.parameters, "plant.payload"))
    arm, q = loop.plant.arm, lin.point.q
    M = np.array(Snapshot(model_of(arm), q=q, v=np.zeros(arm.n), payload=payload).M, dtype=float)
    root = np.sqrt(np.diag(M))
    scaled = M / np.outer(root, root)
    omega = frequency_grid(lin.period, np.abs(np.angle(lin.poles)) / lin.period)
    T = lin.frequency_response(omega, input="ref.q", output="q")
    return Coupling(
        joints=lin.point.joints,
        inertia=1.0 - float(np.linalg.eigvalsh(scaled)[0]),
        crosstalk=np.abs(T).max(axis=0),
        droop=lin.point.moved,
        max_crosstalk=max_crosstalk,
        unit=units[0],
    )
